//! Simulates one profile with the model and with its simple-IR rest, and prepares the results of
//! `eis-bench simulate`.

use std::path::PathBuf;

use analysis::{
    forward::{
        Demand, ForwardError, Infeasible, Profile, RunBand, ScaleBound, ScaleLimit, ScaleOptions,
        SimModel, SimOptions, SimState, Simulation, Summary, TRACE_BRANCHES, largest_scale,
        simulate,
    },
    given::GivenModel,
    map::Outside,
    model::Erm,
    ocv::OcvCurve,
    pack::Pack,
};
use serde::Serialize;

use super::band::{Played, Uncertainty};
use crate::command::model_args;
use bench_plan::support::terminal::say;

/// A profile and its results.
#[derive(Debug)]
pub(super) struct Case {
    pub(super) profile: Profile,
    /// With all branches.
    pub(super) full: Simulation,
    /// With the DC resistance alone.
    pub(super) simple: Simulation,
    /// Largest factors of the two models; `None` for a load resistance.
    limits: Option<[ScaleLimit; 2]>,
    dcir_ohm: f64,
    pub(super) uncertainty: Uncertainty,
}

/// What the arguments say of the cells.
#[derive(Debug, Clone, Copy)]
pub(super) struct Assumed {
    /// DC resistance for the simple-IR model, Ω, in the place of the model's.
    pub(super) dcir_ohm: Option<f64>,
    /// Standard deviation of the resistance from cell to cell, as a share of it.
    pub(super) sigma_r: f64,
}

/// Effect of a parameter on the lowest voltage.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Parameter {
    parameter: String,
    change_v: f64,
}

impl Case {
    pub(super) fn run(
        file: &GivenModel,
        model: &SimModel,
        state: &SimState,
        profile: Profile,
        options: SimOptions,
        assumed: Assumed,
    ) -> Result<Self, ForwardError> {
        let full = simulate(model, state, &profile, &options)?;
        let mut bare = model.simple_ir(state.soc);
        if let Some(dcir_ohm) = assumed.dcir_ohm {
            let cell = Erm {
                r_ohm: dcir_ohm,
                branches: Vec::new(),
            };
            bare = SimModel::pack(&cell, model.ocv.clone(), model.pack)?;
        }
        let dcir_ohm =
            assumed
                .dcir_ohm
                .unwrap_or_else(|| match (file.additions.is_empty(), &file.map) {
                    (true, None) => file.erm.dc_resistance_ohm(),
                    _ => (bare.erm.r_ohm - model.pack.interconnect_ohm) / model.pack.ratio(),
                });
        let rest = SimState {
            soc: state.soc,
            v_rc_v: Vec::new(),
            temperature_degc: None,
        };
        let simple = simulate(&bare, &rest, &profile, &options)?;
        let scale = ScaleOptions {
            window: options.window,
            ..ScaleOptions::for_profile(&profile)
        };
        let limits = match profile.demand {
            Demand::Resistance => None,
            Demand::Power | Demand::Current => Some([
                largest_scale(model, state, &profile, &scale)?,
                largest_scale(&bare, &rest, &profile, &scale)?,
            ]),
        };
        let played = Played {
            state,
            profile: &profile,
            options: &options,
            run: &full,
        };
        let uncertainty = Uncertainty::of(file, model, &played, assumed.sigma_r)?;
        Ok(Self {
            profile,
            full,
            simple,
            limits,
            dcir_ohm,
            uncertainty,
        })
    }

    pub(super) fn output(
        &self,
        file: &GivenModel,
        model: &SimModel,
        trace: Option<PathBuf>,
    ) -> Output {
        let (full, simple) = (&self.full.summary, &self.simple.summary);
        let factor = |k: usize| self.limits.map(|l| l[k].factor);
        // For a power profile this is the peak of the profile itself; for other profiles the peak
        // does not follow from the factor.
        let asked = self.profile.peak();
        let peak = |k: usize| {
            factor(k)
                .filter(|_| self.profile.demand == Demand::Power)
                .zip(asked)
                .map(|(f, asked)| f * asked)
        };
        let names = file.erm.parameter_names();
        let per_percent =
            names
                .into_iter()
                .zip(&self.uncertainty.slopes_v)
                .map(|(parameter, slope)| Parameter {
                    parameter,
                    change_v: 0.01 * slope,
                });
        Output {
            profile: self.profile.name.clone(),
            model: format!("{}, {} RC", file.name, file.erm.branches.len()),
            pack: model.pack.name(),
            summary: full.clone(),
            first_infeasible: full.infeasible.first().copied(),
            min_ccv_sigma_v: self.uncertainty.lowest_sigma_v,
            band: self.uncertainty.band.clone(),
            min_ccv_per_percent_v: per_percent.collect(),
            largest_factor: factor(0),
            largest_factor_bound: self.limits.map(|l| l[0].bound),
            largest_peak_power_w: peak(0),
            simple_ir: SimpleIr {
                dcir_ohm: self.dcir_ohm,
                min_ccv_v: simple.min_ccv_v,
                max_ccv_v: simple.max_ccv_v,
                margin_low_v: simple.margin_low_v,
                margin_high_v: simple.margin_high_v,
                energy_j: simple.energy_j,
                feasible: simple.feasible,
                largest_factor: factor(1),
                largest_peak_power_w: peak(1),
            },
            freed_peak_power_w: peak(0)
                .zip(peak(1))
                .map(|(full, simple)| full.abs() - simple.abs()),
            notes: self.notes(file, model.pack),
            trace,
        }
    }

    /// Notes without which the result would mislead.
    fn notes(&self, file: &GivenModel, pack: Pack) -> Vec<String> {
        let (s, name) = (&self.full.summary, &self.profile.name);
        let mut notes = model_args::notes(file);
        if !file.additions.is_empty() {
            notes.push(
                "what the uncertainty of the fit does to the lowest voltage is not given \
            for a model with additions"
                    .to_owned(),
            );
        }
        if let Some(outside) = s.outside_map.filter(Outside::is_outside) {
            notes.push(format!(
                "{name}: {outside}; there the resistances are extrapolated"
            ));
        }
        let cell_a = s.most_current_a() / f64::from(pack.parallel);
        let remark = file.map.as_ref().and_then(|map| map.current_remark(cell_a));
        notes.extend(remark.map(|remark| format!("{name}: {remark}")));
        notes.extend(self.uncertainty.text(name, file));
        if let Some(degc) = self.full.end.temperature_degc {
            notes.push(format!("{name}: the cells end at {degc:.1} °C"));
        }
        let branches = self.full.trace.v_rc_v.len();
        if branches > TRACE_BRANCHES {
            notes.push(format!(
                "{name}: the trace file holds the voltages of {TRACE_BRANCHES} of \
            {branches} branches"
            ));
        }
        if let Some(end) = &s.tangent_end {
            notes.push(format!(
                "{name}: the run ends at {:.4} s: {:.1} W were asked for where {:.1} W are the \
                most (E²/4R), and the tangent has come down to 0 V; beyond it no \
                 cell has a voltage, and the tangent itself is singular as E → 0",
                end.time_s, end.power_w, end.available_w
            ));
        }
        if s.margin_low_v < 0.0 {
            notes.push(format!(
                "{name}: a cell falls {:.3} V below its lower limit",
                -s.margin_low_v
            ));
        }
        if s.margin_high_v < 0.0 {
            notes.push(format!(
                "{name}: a cell rises {:.3} V above its upper limit",
                -s.margin_high_v
            ));
        }
        if let Some(soc) = s.soc_min.filter(|soc| *soc < 0.0) {
            notes.push(format!(
                "{name}: SOC falls to {soc:.3}: more charge is taken than the cell \
            holds, and the OCV there is made up"
            ));
        }
        if let Some(soc) = s.soc_max.filter(|soc| *soc > 1.0) {
            notes.push(format!(
                "{name}: SOC rises to {soc:.3}: more charge is put in than the cell \
            holds, and the OCV there is made up"
            ));
        }
        notes
    }
}

/// One row per profile.
pub(super) fn print_table(outputs: &[Output]) {
    let width = outputs
        .iter()
        .map(|o| o.profile.chars().count())
        .max()
        .unwrap_or(0)
        .max("profile".len());
    say!(
        "{:width$}  {:>9}  {:>9}  {:>8}  {:>18}  {:>21}  {:>11}  {:>19}",
        "",
        "peak",
        "energy",
        "peak",
        "lowest CCV / V",
        "margin low / cell / V",
        "margin high",
        "largest peak / W"
    );
    say!(
        "{:width$}  {:>9}  {:>9}  {:>8}  {:>9} {:>8}  {:>11} {:>9}  {:>11}  {:>9} {:>9}",
        "profile",
        "power / W",
        "/ kJ",
        "current/A",
        "transient",
        "simple",
        "transient",
        "simple",
        "/ cell / V",
        "transient",
        "simple"
    );
    for o in outputs {
        let (s, r) = (&o.summary, &o.simple_ir);
        let most = |w: Option<f64>| w.map_or_else(|| "–".to_owned(), |w| format!("{w:.0}"));
        say!(
            "{:width$}  {:>9.1}  {:>9.3}  {:>9.1}  {:>9.3} {:>8.3}  {:>+11.3} {:>+9.3}  {:>+11.3}  \
            {:>9} {:>9}",
            o.profile,
            if s.peak_power_w > 0.0 {
                s.peak_power_w
            } else {
                s.lowest_power_w
            },
            1e-3 * s.energy_j,
            if s.peak_current_a > 0.0 {
                s.peak_current_a
            } else {
                s.lowest_current_a
            },
            s.min_ccv_v,
            r.min_ccv_v,
            s.margin_low_v,
            r.margin_low_v,
            s.margin_high_v,
            most(o.largest_peak_power_w),
            most(r.largest_peak_power_w)
        );
    }
}

/// Describes the gain of the transient model over the simple one.
pub(super) fn sentence(o: &Output) -> String {
    let (Some(full), Some(simple)) = (o.largest_factor, o.simple_ir.largest_factor) else {
        return format!("{}: a load resistance has no largest factor", o.profile);
    };
    let bound = match o.largest_factor_bound {
        Some(analysis::forward::ScaleBound::UpperVoltage) => "the upper voltage",
        Some(analysis::forward::ScaleBound::Power) => "the available power",
        Some(analysis::forward::ScaleBound::Nothing) => "nothing",
        _ => "the lower voltage",
    };
    let sigma = o.min_ccv_sigma_v.map_or_else(String::new, |s| {
        format!("; lowest CCV ± {:.1} mV (1σ of the model)", 1e3 * s)
    });
    let freed = o.freed_peak_power_w.map_or_else(String::new, |w| {
        format!(": the transient model frees {w:.0} W of peak power")
    });
    format!(
        "{}: may grow {full:.3}-fold (bound by {bound}), {simple:.3}-fold by simple \
        IR{freed}{sigma}",
        o.profile
    )
}

/// Whether a curve is used where only a voltage was given; for the caption.
pub(super) fn state_words(curve: Option<&OcvCurve>) -> &'static str {
    if curve.is_some() {
        "OCV by its curve"
    } else {
        "constant OCV"
    }
}

/// Report that `--json` prints for a profile.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Output {
    pub(super) profile: String,
    model: String,
    pack: String,
    #[serde(flatten)]
    pub(super) summary: Summary,
    /// Location of the first infeasible power; null if there is none.
    pub(super) first_infeasible: Option<Infeasible>,
    /// Standard deviation of the lowest voltage due to the model's fit or the error of its map; null if
    /// the model states neither.
    min_ccv_sigma_v: Option<f64>,
    /// Band that holds the whole voltage of a cell with 95 %; null if the model states no error.
    band: Option<RunBand>,
    /// Change of the lowest terminal voltage when one parameter of the cell rises by 1 %, V.
    min_ccv_per_percent_v: Vec<Parameter>,
    /// The largest factor of the profile within the window.
    largest_factor: Option<f64>,
    largest_factor_bound: Option<ScaleBound>,
    /// Peak power at that factor, W; for a profile that only charges the most negative one; null
    /// for no power profile.
    largest_peak_power_w: Option<f64>,
    pub(super) simple_ir: SimpleIr,
    /// How much more peak power, without sign, the transient model allows than the simple-IR model,
    /// W.
    freed_peak_power_w: Option<f64>,
    /// Notes on how to read the numbers.
    pub(super) notes: Vec<String>,
    /// Location of the trace; null without `--out`.
    pub(super) trace: Option<PathBuf>,
}

/// Results with the DC resistance alone.
#[derive(Debug, Clone, Serialize)]
pub(super) struct SimpleIr {
    /// DC resistance of a cell, Ω.
    pub(super) dcir_ohm: f64,
    min_ccv_v: f64,
    max_ccv_v: f64,
    margin_low_v: f64,
    margin_high_v: f64,
    energy_j: f64,
    feasible: bool,
    largest_factor: Option<f64>,
    largest_peak_power_w: Option<f64>,
}
