//! `eis-bench joint`: the extended Randles model from spectra and pulses together.

use crate::command::ocv;
use crate::command::printed::say_json;
use crate::command::units;
use bench_core::{operator::progress::Waiting, safety::failure::Failure};
use bench_evaluate::{files, support::present::significant};
use bench_plan::config::quantity::{Resistance, Voltage};
use bench_plan::support::terminal::{remark, say};
use std::path::{Path, PathBuf};

use analysis::{
    fit::{JointProvenance, MAX_RC, ModelFile, PackModel},
    formats::CurrentSign,
    joint::{
        JointFit, JointOptions, PooledSpectrum, PulseResult, Role, Study, StudyInput, StudyOptions,
        study,
    },
    ocv::{OcvCurve, OcvOptions, extract},
    pack::Pack,
    run_folder::MODEL,
    spectrum::SourcedSpectrum,
};

/// Arguments of `joint`.
#[derive(Debug, clap::Args)]
pub struct JointArgs {
    /// Spectra of cells without bias, all at the same frequencies; repeats and several cells give
    /// the uncertainty.
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    pub spectra: Vec<PathBuf>,
    /// Also use points of the spectra that the quality gate of their measurement refused.
    #[arg(long)]
    pub refused_points: bool,
    /// A series with pulses of current: the thesis' cycler CSV, BDF (CSV or Parquet), the bench's
    /// own.
    #[arg(long, value_name = "FILE")]
    pub series: PathBuf,
    /// The OCV curve, as `eis-bench ocv --out` writes it (`ocv.json`).
    #[arg(
        long,
        value_name = "JSON",
        conflicts_with = "ocv_from",
        required_unless_present = "ocv_from"
    )]
    pub ocv: Option<PathBuf>,
    /// A slow discharge to take the OCV curve from.
    #[arg(long, value_name = "FILE")]
    pub ocv_from: Option<PathBuf>,
    /// Resistance that converts the voltage under steady load to OCV, Ω.
    #[arg(long, default_value_t = 0.015, value_name = "OHM", value_parser = units::of::<Resistance>)]
    pub dcir_ohm: f64,
    /// Order: a number of RC pairs, or `auto` (1 to 6, by AICc).
    #[arg(long, default_value = "auto", value_name = "N|auto")]
    pub rc: String,
    /// OCV at which the spectra were measured, V.
    #[arg(long, default_value_t = 3.72, value_name = "V", value_parser = units::of::<Voltage>)]
    pub at_v: f64,
    /// Largest distance from --at-v of the pulses that are used, V; every second one is held out.
    #[arg(long, default_value_t = 0.2, value_name = "V", value_parser = units::of::<Voltage>)]
    pub within_v: f64,
    /// Direction of positive current in the series, `discharge` or `charge` [default: from the
    /// voltage and the file's columns]
    #[arg(long, value_name = "DIRECTION")]
    pub positive: Option<CurrentSign>,
    /// Seed of the starts.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Write `model.json` and plots into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Fits, compares, prints, and writes into a folder if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn joint(args: &JointArgs) -> Result<(), Failure> {
    let rc = order(&args.rc)?;
    let waiting = Waiting::on(format!("reading {} files", args.spectra.len() + 1));
    let spectra = spectra(&args.spectra, args.refused_points)?;
    let series = ocv::read(&args.series, args.positive)?;
    let (curve, ocv_from) = curve(args)?;
    let plain: Vec<_> = spectra.iter().map(|s| s.spectrum.clone()).collect();
    let fit = JointOptions::for_spectra(&plain, args.seed);
    let options = StudyOptions {
        ocv_window_v: (args.at_v, args.within_v),
        dcir_ohm: args.dcir_ohm,
        rc,
        fit,
    };
    let input = StudyInput {
        spectra: &spectra,
        series: &series,
        curve: &curve,
    };
    waiting.say(format!(
        "fitting {} spectra and the pulses together",
        spectra.len()
    ));
    let (study, pooled) =
        study(&input, &options).map_err(|error| Failure::Usage(error.to_string()))?;
    waiting.end();
    let job = Job {
        args,
        study: &study,
        pooled: &pooled,
        curve: &curve,
        ocv_from: &ocv_from,
        series: &series.name,
        fit: &options.fit,
    };
    if let Some(folder) = &args.out {
        job.write(folder, &spectra)?;
    }
    if args.json {
        return say_json(&study);
    }
    job.print();
    Ok(())
}

fn order(text: &str) -> Result<Option<usize>, Failure> {
    if text == "auto" {
        return Ok(None);
    }
    let order = text.parse().ok().filter(|rc| (1..=MAX_RC).contains(rc));
    order.map(Some).ok_or_else(|| {
        Failure::Usage(format!(
            "--rc: expected `auto` or a number from 1 to {MAX_RC}, found {text:?}"
        ))
    })
}

fn spectra(files: &[PathBuf], refused_points: bool) -> Result<Vec<SourcedSpectrum>, Failure> {
    let mut all = Vec::new();
    let mut passed_over = Vec::new();
    for file in files {
        for mut sourced in files::read_spectra(file)? {
            if sourced.origin.is_unbiased_cell() {
                files::leave_out_refused(&mut sourced, refused_points)?;
                all.push(sourced);
            } else {
                passed_over.push(sourced.spectrum.name);
            }
        }
    }
    if !passed_over.is_empty() {
        remark!(
            "not used, because they are controls or carry a direct current: {}",
            passed_over.join(", ")
        );
    }
    files::refuse_curves(&all)?;
    Ok(all)
}

fn curve(args: &JointArgs) -> Result<(OcvCurve, String), Failure> {
    if let Some(path) = &args.ocv {
        return Ok((files::read_curve(path)?, path.display().to_string()));
    }
    let path = args
        .ocv_from
        .as_deref()
        .ok_or_else(|| Failure::Usage("expected --ocv or --ocv-from".to_owned()))?;
    let discharge = ocv::read(path, args.positive)?;
    let options = OcvOptions {
        dcir_ohm: args.dcir_ohm,
        ..OcvOptions::default()
    };
    let found =
        extract(&discharge, None, &options).map_err(|error| Failure::Usage(error.to_string()))?;
    Ok((found.curve, discharge.name))
}

/// All that is printed and written.
struct Job<'a> {
    args: &'a JointArgs,
    study: &'a Study,
    pooled: &'a PooledSpectrum,
    curve: &'a OcvCurve,
    ocv_from: &'a str,
    series: &'a str,
    fit: &'a JointOptions,
}

impl Job<'_> {
    fn print(&self) {
        let study = self.study;
        let (sweeps, cells) = study.sweeps_cells;
        let percent = |s: Option<f64>| {
            s.map_or_else(|| "unknown".to_owned(), |s| format!("{:.2} %", 100.0 * s))
        };
        let (within, between) = (
            percent(self.pooled.repeatability),
            percent(study.cell_spread),
        );
        say!(
            "{sweeps} sweeps of {cells} cell(s); scatter within a cell {within}, factor between \
            cells {between}"
        );
        say!("  uncertainty of the mean: {}", study.spectra_basis);
        say!(
            "{}: noise of a sample {:.2} mV, of no mean below {:.3} mV",
            self.series,
            1e3 * study.noise_v.0,
            1e3 * study.noise_v.1
        );
        say!(
            "  RC   DC resistance / mΩ                    after 10 s / mΩ                       \
            χ²/freedom"
        );
        say!(
            "       spectra alone      joint              spectra alone      joint              \
            alone   joint"
        );
        for order in &study.orders {
            let dc = |f: &JointFit| number(f.dc_resistance_ohm, f.sigma.dc_resistance_ohm);
            let step = |f: &JointFit| {
                f.step_resistance
                    .first()
                    .map_or_else(String::new, |s| number(s.1, s.2))
            };
            let (a, b) = (&order.spectra, &order.joint);
            say!(
                "  {:>2}   {:<18} {:<18} {:<18} {:<18} {:>6} {:>7}{}",
                order.rc,
                dc(a),
                dc(b),
                step(a),
                step(b),
                significant(a.reduced_chi2, 3),
                significant(b.reduced_chi2, 3),
                if order.rc == study.rc {
                    "  ← chosen"
                } else {
                    ""
                }
            );
        }
        if let Some(joint) = study.joint() {
            print_model(joint);
        }
        say!(
            "  pulses, mΩ: measured, by {} RC from spectra alone, by the joint model; rms gap over \
            the pulse",
            study.spectra_rc
        );
        study.pulses.iter().for_each(print_pulse);
        for (role, text) in [(Role::Fitted, "fitted"), (Role::HeldOut, "held out")] {
            if let Some((before, after)) = study.rms_v(role) {
                say!(
                    "  rms gap of the pulses {text}: {:.2} mV from spectra alone, {:.2} mV joint",
                    1e3 * before,
                    1e3 * after
                );
            }
        }
        for warning in &study.warnings {
            say!("  note: {warning}");
        }
        if let Some(folder) = &self.args.out {
            say!("written to {}", folder.display());
        }
    }

    fn write(&self, folder: &Path, spectra: &[SourcedSpectrum]) -> Result<(), Failure> {
        let failed = |error: &dyn std::fmt::Display| Failure::Analysis(error.to_string());
        files::make_folder(folder)?;
        let joint = self
            .study
            .joint()
            .ok_or_else(|| Failure::Analysis("no order was fitted".to_owned()))?;
        let pack = PackModel::new(&joint.erm, Pack::THESIS).map_err(|error| failed(&error))?;
        let fit = joint.to_erm_fit(self.pooled, self.fit);
        let names = spectra
            .iter()
            .map(|one| one.spectrum.name.clone())
            .collect();
        let mut model = ModelFile::new("joint", fit, names, Some(pack));
        model.refused = files::refused_points(spectra, self.args.refused_points);
        model.ocv = Some(self.curve.clone());
        let numbers = |role: Role| {
            self.study
                .pulses
                .iter()
                .filter(|p| p.role == role)
                .map(|p| p.joint.pulse)
                .collect()
        };
        model.joint = Some(JointProvenance {
            series: self.series.to_owned(),
            pulses: numbers(Role::Fitted),
            held_out: numbers(Role::HeldOut),
            ocv_from: self.ocv_from.to_owned(),
            gain: joint.gain,
            gain_sigma: joint.gain_sigma,
            held_out_rms_v: self.study.rms_v(Role::HeldOut).map(|r| r.1),
        });
        let text = model.to_json().map_err(|error| failed(&error))?;
        files::write_text(folder, MODEL, &text)?;
        let charts = [
            ("pulses", self.study.pulses_chart(self.series)),
            ("gaps", self.study.gaps_chart(self.series)),
            ("orders", self.study.orders_chart(self.series)),
        ];
        charts
            .iter()
            .try_for_each(|(name, chart)| files::write_chart(folder, name, chart))
    }
}

fn print_model(joint: &JointFit) {
    say!(
        "  joint model, {} RC; {} of {} starts end there",
        joint.erm.branches.len(),
        joint.starts.0,
        joint.starts.1
    );
    say!(
        "        R {} mΩ",
        number(joint.erm.r_ohm, joint.sigma.r_ohm)
    );
    for (branch, sigma) in joint.erm.branches.iter().zip(&joint.sigma.branches) {
        let capacitance = sigma.c_f.map_or_else(
            || significant(branch.c_f, 4),
            |s| format!("{} ± {}", significant(branch.c_f, 4), significant(s, 2)),
        );
        let tau = branch.time_constant_s();
        say!(
            "        {:<16} mΩ ∥ {capacitance:<16} F   τ {} s",
            number(branch.r_ohm, sigma.r_ohm),
            significant(tau, 4)
        );
    }
    let sigma = joint
        .gain_sigma
        .map_or_else(String::new, |s| format!(" ± {s:.4}"));
    say!(
        "        resistance of the pulses over that of the spectra {:.4}{sigma}",
        joint.gain
    );
}

fn print_pulse(pulse: &PulseResult) {
    let role = match pulse.role {
        Role::Fitted => "fitted",
        Role::HeldOut => "held out",
        Role::Outside => "other OCV",
    };
    let at: Vec<String> = pulse
        .joint
        .at
        .iter()
        .zip(&pulse.spectra.at)
        .map(|(j, s)| {
            let sigma = s
                .predicted_sigma_ohm
                .map_or_else(|| "?".to_owned(), |s| format!("{:.2}", 1e3 * s));
            format!(
                "{:>4} s: {:>5.2}±{:.2} {:>5.2}±{sigma} {:>5.2}",
                j.time_s,
                1e3 * j.measured_ohm,
                1e3 * j.measured_sigma_ohm,
                1e3 * s.predicted_ohm,
                1e3 * j.predicted_ohm
            )
        })
        .collect();
    let (before, after) = (1e3 * pulse.spectra.rms_v, 1e3 * pulse.joint.rms_v);
    say!(
        "  {:>2} {:.3} V {role:<9}  {}   {before:.2} → {after:.2} mV",
        pulse.joint.pulse,
        pulse.joint.ocv_v,
        at.join("  ")
    );
}

/// Milliohms with their standard uncertainty.
fn number(ohm: f64, sigma: Option<f64>) -> String {
    sigma.map_or_else(
        || format!("{} ± ?", significant(1e3 * ohm, 4)),
        |s| {
            format!(
                "{} ± {}",
                significant(1e3 * ohm, 4),
                significant(1e3 * s, 2)
            )
        },
    )
}
