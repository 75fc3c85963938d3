//! Writes a measured multisine: its spectrum like that of a sweep, and the noise and distortion of
//! each line.

mod result;

use std::{fmt::Write as _, ops::Range, path::Path};

use analysis::{
    dataset::{PointConditions, SweepEntry},
    multisine::Line,
    run_folder::{self, LINE_COLUMNS, Multisine},
    series::Role,
    spectrum::{ChannelPhasors, FlaggedPoint, ImpedancePoint, Spectrum, raw_impedance},
};
use instruments::{
    fixture::Fixture,
    units::{Amps, Celsius, Volts},
};

use super::{Measured, sweep_writer};
use bench_core::{
    executor::{Executor, ResumePoint},
    record::Recorder,
    safety::failure::Failure,
};
use bench_plan::{
    config::Experiment,
    measure::SweepPoint,
    plan::{Stage, Step, fixture_name},
};
pub use result::MultisineRun;

/// A line: its phasors, the scope's V/div, and its noise and distortion.
pub(super) type MeasuredLine = (ChannelPhasors, [f64; 4], Line);

/// Values of a measured multisine beside its lines.
pub(super) struct MultisineFigures {
    /// Points that the quality gate refused to the end.
    pub(super) flagged: Vec<FlaggedPoint>,
    /// Bench time that it took, including everything that belongs to it, s.
    pub(super) took_s: f64,
    /// Direct current, charge and temperature of each line; empty without a direct current.
    pub(super) conditions: Vec<PointConditions>,
    /// Voltage of the cell at rest before the direct current, V.
    pub(super) rest_v: Option<f64>,
}

/// Returns the numbers of the multisines of a stage, after which their files are named: one, or along a
/// charge or discharge one for each time that its bands are repeated.
pub(super) fn numbers(experiment: &Experiment, stage: &Stage, repeat: usize) -> Range<usize> {
    let is_band = |step: &&Step| matches!(step, Step::Multisine(_));
    let bands = stage.steps.iter().filter(is_band).count();
    let once = experiment
        .multisine
        .as_ref()
        .map_or(1, |multisine| multisine.bands.len());
    let screens = (bands / once.max(1)).max(1);
    (repeat - 1) * screens + 1..repeat * screens + 1
}

/// Measures the multisines of a stage and writes the files of each: `multisine.csv`, `raw_multisine.csv`,
/// `multisine_lines.csv`, and a description in `multisine.json`; `shared/multisine.csv` contains
/// the errors that its points share.
pub(super) async fn measure(
    executor: &mut Executor<'_>,
    experiment: &Experiment,
    number: usize,
    stage: &Stage,
    repeat: usize,
    measured: &Measured,
) -> Result<Vec<MultisineRun>, Failure> {
    let start_s = executor.rig.clock.now_s();
    let numbers = numbers(experiment, stage, repeat);
    for number in numbers.clone() {
        executor
            .rig
            .recorder
            .forget_sweep(&Multisine::Spectrum.file(number));
    }
    // An interrupted multisine is repeated completely: it moves no net charge, and one about a direct
    // current begins at a known charge.
    let points = executor
        .stage(number, stage, &ResumePoint::default(), &mut |_, _| Ok(()))
        .await?;
    let took_s = (executor.rig.clock.now_s() - start_s) / numbers.len() as f64;
    for point in &points {
        for warning in &point.warnings {
            executor
                .rig
                .recorder
                .point_warning("multisine", point.phasors.freq_hz, warning);
        }
    }
    let lines = std::mem::take(&mut executor.known.lines);
    let of_one = points.len().div_ceil(numbers.len()).max(1);
    let mut runs = Vec::new();
    for (number, (points, lines)) in numbers.zip(points.chunks(of_one).zip(lines.chunks(of_one))) {
        let first_s = points.first().filter(|_| !runs.is_empty());
        let begun = Begun {
            experiment,
            stage,
            number,
            start_s: first_s.map_or(start_s, |point| point.time_s.0),
        };
        runs.push(finish(executor, &begun, points, lines, measured, took_s)?);
    }
    Ok(runs)
}

/// A multisine whose lines are measured.
struct Begun<'a> {
    experiment: &'a Experiment,
    stage: &'a Stage,
    number: usize,
    start_s: f64,
}

/// Writes the files of one multisine and its entry in the index.
fn finish(
    executor: &mut Executor<'_>,
    begun: &Begun<'_>,
    points: &[SweepPoint],
    lines: &[Line],
    measured: &Measured,
    took_s: f64,
) -> Result<MultisineRun, Failure> {
    let rest_v = executor.known.idle.voltage_v;
    let recorder = &mut *executor.rig.recorder;
    let flagged = sweep_writer::flags(points, &mut |freq_hz, text| {
        recorder.point_warning("multisine", freq_hz, text);
    });
    let found: Vec<MeasuredLine> = points
        .iter()
        .zip(lines)
        .map(|(point, line)| (point.phasors, point.volts_per_div, *line))
        .collect();
    let run = write(
        executor.rig.recorder,
        begun.experiment,
        begun.stage,
        begun.number,
        &found,
        measured,
        MultisineFigures {
            flagged,
            took_s,
            conditions: points.iter().filter_map(|point| point.conditions).collect(),
            rest_v: rest_v.map(Volts::value),
        },
    )?;
    let corrected = measured.correction.reduced_chi2.is_some();
    let phasors: Vec<ChannelPhasors> = found.iter().map(|(phasors, ..)| *phasors).collect();
    let shunt_ohm = begun.experiment.bench.wiring.shunt.r_ohm;
    let common_mode = sweep_writer::common_mode(&phasors, shunt_ohm);
    let entry = SweepEntry {
        flagged: run.flagged.clone(),
        own_sigma_ohm: if corrected {
            sweep_writer::own_sigma_ohm(&run.own_noise)
        } else {
            Vec::new()
        },
        common_error: if corrected {
            measured
                .correction
                .common_error(&phasors, &sweep_writer::shunt_phasors(measured))
        } else {
            None
        },
        below_ohm: common_mode.map(|common_mode| common_mode.r_ohm),
        below_h: common_mode.map(|common_mode| common_mode.l_h),
        conditions: run.conditions.clone(),
        ..entry(executor, begun, measured)
    };
    executor.rig.recorder.sweep(entry)?;
    Ok(run)
}

/// Writes all files of a multisine, from its lines and earlier measurements.
pub(super) fn write(
    recorder: &Recorder,
    experiment: &Experiment,
    stage: &Stage,
    repeat: usize,
    found: &[MeasuredLine],
    measured: &Measured,
    figures: MultisineFigures,
) -> Result<MultisineRun, Failure> {
    let MultisineFigures {
        flagged,
        took_s,
        conditions,
        rest_v,
    } = figures;
    let correction = &measured.correction;
    let corrected: Vec<ImpedancePoint> = found
        .iter()
        .map(|(phasors, ..)| correction.apply(phasors))
        .collect();
    let raw: Vec<ImpedancePoint> = found
        .iter()
        .map(|(phasors, ..)| raw_impedance(phasors, experiment.bench.wiring.shunt.r_ohm))
        .collect();
    let lines: Vec<Line> = found.iter().map(|(.., line)| *line).collect();
    let flags: Vec<String> = found
        .iter()
        .map(|(phasors, ..)| reasons(&flagged, phasors.freq_hz))
        .collect();
    let (raw_file, file) = (
        Multisine::Raw.file(repeat),
        Multisine::Spectrum.file(repeat),
    );
    let name = &experiment.name;
    if conditions.is_empty() {
        recorder.flagged_spectrum(&raw_file, &raw, &flags)?;
        recorder.flagged_spectrum(&file, &corrected, &flags)?;
        recorder.flagged_parquet(&Multisine::SpectrumParquet.file(repeat), &corrected, &flags)?;
    } else {
        // Parquet has no columns for a direct current.
        let table = |file: &str, points: &[ImpedancePoint]| {
            let spectrum = Spectrum::new(name.clone(), points.to_vec());
            recorder.biased_spectrum(file, &spectrum, &conditions, &flags)
        };
        table(&raw_file, &raw)?;
        table(&file, &corrected)?;
    }
    recorder.text(&Multisine::Lines.file(repeat), &table(&lines))?;
    let own = |((phasors, ..), point): (&MeasuredLine, &ImpedancePoint)| {
        let covariance = correction.measured_parts(phasors).into_iter().sum();
        ImpedancePoint {
            covariance,
            ..*point
        }
    };
    let own_noise = Spectrum {
        name: experiment.name.clone(),
        points: found.iter().zip(&corrected).map(own).collect(),
        ..Spectrum::default()
    };
    let phasors: Vec<ChannelPhasors> = found.iter().map(|(phasors, ..)| *phasors).collect();
    let spectrum = Spectrum::new(experiment.name.clone(), corrected);
    let spectrum = sweep_writer::with_shared(
        spectrum,
        &phasors,
        correction,
        &sweep_writer::jig_phasors(measured),
    );
    if conditions.is_empty() {
        sweep_writer::write_shared(recorder, &file, &spectrum, &flags)?;
    } else if !spectrum.shared.is_empty() {
        let shared = run_folder::shared_spectrum(&file);
        recorder.biased_spectrum(&shared, &spectrum, &conditions, &flags)?;
    }
    let volts_per_div = found
        .iter()
        .map(|(_, volts_per_div, _)| *volts_per_div)
        .collect();
    let run = MultisineRun {
        spectrum,
        own_noise,
        noise_dof: noise_dof(stage),
        flagged,
        lines,
        volts_per_div,
        took_s,
        rest_v: rest_v.filter(|_| !conditions.is_empty()),
        conditions,
    };
    recorder.json(&Multisine::Whole.file(repeat), &run)?;
    Ok(run)
}

/// Returns why the quality gate refused the line at a frequency; empty if it was accepted.
fn reasons(flagged: &[FlaggedPoint], freq_hz: f64) -> String {
    flagged
        .iter()
        .filter(|point| point.freq_hz == freq_hz)
        .flat_map(|point| &point.reasons)
        .cloned()
        .collect::<Vec<_>>()
        .join("; ")
}

/// Reads the multisine that an earlier process measured.
pub(super) fn restore(folder: &Path, repeat: usize) -> Result<MultisineRun, Failure> {
    let path = folder.join(Multisine::Whole.file(repeat));
    let text = std::fs::read_to_string(&path)
        .map_err(|error| Failure::Analysis(format!("{}: {error}", path.display())))?;
    serde_json::from_str(&text)
        .map_err(|error| Failure::Analysis(format!("{}: {error}", path.display())))
}

/// Returns the multisine's entry for the index.
fn entry(executor: &Executor<'_>, begun: &Begun<'_>, measured: &Measured) -> SweepEntry {
    let Begun {
        stage,
        number: repeat,
        start_s: start_time_s,
        ..
    } = *begun;
    let driven = |step: &Step| {
        if let Step::Multisine(band) = step {
            Some(band.design.amplitude * band.peak_a)
        } else {
            None
        }
    };
    let bias_a = stage.bias_a();
    let operando = begun
        .experiment
        .multisine
        .as_ref()
        .is_some_and(|m| m.operando);
    let repeat_group = match (bias_a != Amps(0.0), operando) {
        // Each is at another charge or temperature.
        _ if stage.point().is_some() => format!("multisine_point_{repeat}"),
        (false, _) => "multisine".to_owned(),
        (true, false) => format!("multisine_bias{:+}A", bias_a.value()),
        // Each is at another charge.
        (true, true) => format!("operando_{repeat}"),
    };
    SweepEntry {
        file: Multisine::Spectrum.file(repeat),
        fixture: fixture_name(Fixture::Cell).to_owned(),
        cell: None,
        fixture_ohm: None,
        corrected: measured.correction.reduced_chi2.is_some(),
        amplitude_a: stage.steps.iter().find_map(driven).unwrap_or(Amps::NAN).0,
        bias_a: bias_a.0,
        conditions: Vec::new(),
        repeat,
        order: executor.rig.recorder.measured(),
        start_time_s,
        start_ocv_v: executor.known.idle.voltage_v.map(Volts::value),
        temperature_degc: executor.known.idle.temperature_degc.map(Celsius::value),
        role: Role::Train,
        repeat_group,
        flagged: Vec::new(),
        own_sigma_ohm: Vec::new(),
        common_error: None,
        below_ohm: None,
        below_h: None,
        // All its lines are measured at once.
        elapsed_s: Vec::new(),
    }
}

/// Returns the degrees of freedom of the noise. Between a line and its neighbours on either side
/// lie as many bins as there are periods, minus one, of two parts each.
fn noise_dof(stage: &Stage) -> f64 {
    let of = |step: &Step| {
        if let Step::Multisine(band) = step {
            Some(4.0 * (band.periods() - 1.0))
        } else {
            None
        }
    };
    stage
        .steps
        .iter()
        .filter_map(of)
        .fold(f64::INFINITY, f64::min)
}

fn table(lines: &[Line]) -> String {
    let mut text = format!("{LINE_COLUMNS}\n");
    for line in lines {
        let _ = writeln!(
            text,
            "{},{:e},{:e},{:e},{:e},{:e}",
            line.freq_hz, line.noise, line.even, line.odd, line.sigma, line.images
        );
    }
    text
}

/// Returns the direct current and the mean charge of a multisine, as part of a sentence.
fn under(run: &MultisineRun) -> String {
    let Some(first) = run.conditions.first() else {
        return String::new();
    };
    let count = run.conditions.len() as f64;
    let charge = run
        .conditions
        .iter()
        .map(|at| at.charge_coulomb)
        .sum::<f64>()
        / count;
    format!(" under {:+} A at {charge:+.1} C", first.bias_a)
}

/// Returns a sentence for the summary and the report.
pub(super) fn in_words(run: &MultisineRun) -> String {
    let (Some(first), Some(last)) = (run.spectrum.points.first(), run.spectrum.points.last())
    else {
        return "multisine without lines".to_owned();
    };
    let worst = run
        .lines
        .iter()
        .filter(|line| line.is_distorted())
        .max_by(|a, b| a.even.max(a.odd).total_cmp(&b.even.max(b.odd)));
    let distortion = worst.map_or_else(
        || "no nonlinear distortion beyond the noise".to_owned(),
        |line| {
            format!(
                "nonlinear distortion, at most {:.2} % even and {:.2} % odd of the voltage at \
                {:.4} Hz",
                100.0 * line.even,
                100.0 * line.odd,
                line.freq_hz
            )
        },
    );
    let noise = run.lines.iter().map(|line| line.noise).fold(0.0, f64::max);
    format!(
        "multisine{}: {} lines from {:.4} Hz to {:.4} Hz in {:.0} s; noise at most {:.3} %; \
        {distortion}",
        under(run),
        run.lines.len(),
        first.freq_hz,
        last.freq_hz,
        run.took_s,
        100.0 * noise
    )
}
