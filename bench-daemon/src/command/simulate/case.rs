//! Simulates one profile with the model and with its simple-IR rest, and prepares the results of
//! `eis-bench simulate`.

use std::path::PathBuf;

use analysis::{
    forward::{
        Demand, ForwardError, Infeasible, Profile, ScaleBound, ScaleLimit, ScaleOptions, SimModel,
        SimOptions, SimState, Simulation, Summary, TRACE_BRANCHES, largest_scale, sensitivity,
        simulate,
    },
    given::GivenModel,
    map::{BAND_SIGMAS, ErrorSource, Outside},
    model::Erm,
    ocv::OcvCurve,
};
use serde::Serialize;

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
    /// Derivatives of the lowest voltage by ln R, ln R₁, ln C₁, … of the cell, V.
    slopes_v: Vec<f64>,
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
        dcir_ohm: Option<f64>,
    ) -> Result<Self, ForwardError> {
        let full = simulate(model, state, &profile, &options)?;
        let mut bare = model.simple_ir(state.soc);
        if let Some(dcir_ohm) = dcir_ohm {
            let cell = Erm {
                r_ohm: dcir_ohm,
                branches: Vec::new(),
            };
            bare = SimModel::pack(&cell, model.ocv.clone(), model.pack)?;
        }
        let dcir_ohm = dcir_ohm.unwrap_or_else(|| match (file.additions.is_empty(), &file.map) {
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
        // At the point where the run stopped, the voltage has no derivative and no minimum. With
        // additions or a map, the fit's parameters are incomplete.
        let linear = file.additions.is_empty() && file.map.is_none();
        let slopes_v = if full.summary.feasible && linear {
            slopes_v(file, model, state, &profile, &full, &options)?
        } else {
            Vec::new()
        };
        Ok(Self {
            profile,
            full,
            simple,
            limits,
            dcir_ohm,
            slopes_v,
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
        let per_percent = names
            .into_iter()
            .zip(&self.slopes_v)
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
            min_ccv_sigma_v: self
                .sigma_v(file.log_covariance.as_deref())
                .or_else(|| self.map_sigma_v(model)),
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
            notes: self.notes(file),
            trace,
        }
    }

    /// Notes without which the result would mislead.
    fn notes(&self, file: &GivenModel) -> Vec<String> {
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
        notes.extend(self.band_text(file));
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

    /// Describes the band of the map's error, in mV per cell.
    fn band_text(&self, file: &GivenModel) -> Option<String> {
        let error = file.map.as_ref()?.voltage_error.as_ref()?;
        let trace = &self.full.trace;
        let (mut sum_vs, mut all_s, mut most_v) = (0.0, 0.0, 0.0_f64);
        for (k, sigma_v) in trace.cell_sigma_v.iter().enumerate().skip(1) {
            let step_s = trace.time_s[k] - trace.time_s[k - 1];
            sum_vs += 0.5 * step_s * (sigma_v + trace.cell_sigma_v[k - 1]);
            all_s += step_s;
            most_v = most_v.max(*sigma_v);
        }
        let mean_v = sum_vs / all_s;
        let shown = match error.from {
            ErrorSource::HeldOut => "held-out logs show",
            ErrorSource::LeftOut => {
                "left-out pieces of the fitted logs show; other loads may be farther off"
            }
        };
        mean_v.is_finite().then(|| {
            format!(
                "{}: 95 % of the cell's voltages are expected within ± {:.0} mV of the prediction (mean; \
                at most ± {:.0} mV) above 10 % of charge and at the current of the trace, as {shown}",
                self.profile.name,
                1e3 * BAND_SIGMAS * mean_v,
                1e3 * BAND_SIGMAS * most_v
            )
        })
    }

    /// Standard deviation of the lowest voltage at the terminals by the error of the map, V.
    ///
    /// Under a power a lower voltage also takes more current, so that only a current has one.
    fn map_sigma_v(&self, model: &SimModel) -> Option<f64> {
        if self.profile.demand != Demand::Current || !self.full.summary.feasible {
            return None;
        }
        let trace = &self.full.trace;
        let rows = trace.ccv_v.iter().zip(&trace.cell_sigma_v);
        let (_, sigma_v) = rows.min_by(|a, b| a.0.total_cmp(b.0))?;
        Some(f64::from(model.pack.series) * sigma_v)
    }

    /// √(gᵀΣg) with the covariance of the logarithms.
    fn sigma_v(&self, covariance: Option<&[Vec<f64>]>) -> Option<f64> {
        let covariance = covariance?;
        let g = &self.slopes_v;
        if g.is_empty() || covariance.len() != g.len() {
            return None;
        }
        let rows = covariance
            .iter()
            .zip(g)
            .map(|(row, gi)| gi * row.iter().zip(g).map(|(c, gj)| c * gj).sum::<f64>());
        let variance: f64 = rows.sum();
        variance.is_finite().then(|| variance.max(0.0).sqrt())
    }
}

/// Derivatives of the lowest voltage at the terminals by the logarithms of the cell's parameters,
/// V.
fn slopes_v(
    file: &GivenModel,
    model: &SimModel,
    state: &SimState,
    profile: &Profile,
    run: &Simulation,
    options: &SimOptions,
) -> Result<Vec<f64>, ForwardError> {
    // Steps as fine as the ones that error control took on average, but not more than a quarter of
    // a million.
    let step_s = (run.summary.simulated_s / run.summary.steps.max(1) as f64)
        .max(profile.duration_s() / 2.5e5);
    let derivatives = sensitivity(model, state, profile, options.beyond, step_s)?;
    let Some(lowest) = derivatives
        .rows
        .iter()
        .min_by(|a, b| a.ccv_v.total_cmp(&b.ccv_v))
    else {
        return Ok(Vec::new());
    };
    let ratio = model.pack.ratio();
    let cell = &file.erm;
    let branches = cell
        .branches
        .iter()
        .flat_map(|b| [b.r_ohm * ratio, b.c_f / ratio]);
    let parameters = std::iter::once(cell.r_ohm * ratio).chain(branches);
    Ok(parameters
        .zip(&lowest.by_parameter)
        .map(|(value, slope)| value * slope)
        .collect())
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
