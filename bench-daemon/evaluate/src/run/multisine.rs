//! Writes a measured multisine: its spectrum like that of a sweep, and the noise and distortion of
//! each line.

mod result;

use std::{fmt::Write as _, path::Path};

use analysis::{
    dataset::SweepEntry,
    multisine::Line,
    run_folder::{LINE_COLUMNS, Multisine},
    series::Role,
    spectrum::{ChannelPhasors, FlaggedPoint, ImpedancePoint, Spectrum, raw_impedance},
};
use instruments::fixture::Fixture;

use super::{Measured, sweep_writer};
use bench_core::{
    executor::{Executor, ResumePoint},
    record::Recorder,
    safety::failure::Failure,
};
use bench_plan::{
    config::Experiment,
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
}

/// Measures a multisine and writes its files: `multisine.csv`, `raw_multisine.csv`,
/// `multisine_lines.csv`, and a description in `multisine.json`; `shared/multisine.csv` contains
/// the errors that its points share.
pub(super) async fn measure(
    executor: &mut Executor<'_>,
    experiment: &Experiment,
    number: usize,
    stage: &Stage,
    repeat: usize,
    measured: &Measured,
) -> Result<MultisineRun, Failure> {
    let start_s = executor.rig.clock.now_s();
    executor
        .rig
        .recorder
        .forget_sweep(&Multisine::Spectrum.file(repeat));
    // An interrupted multisine is repeated completely: it moves no net charge.
    let points = executor
        .stage(number, stage, &ResumePoint::default(), &mut |_, _| Ok(()))
        .await?;
    let took_s = executor.rig.clock.now_s() - start_s;
    for point in &points {
        for warning in &point.warnings {
            executor
                .rig
                .recorder
                .point_warning("multisine", point.phasors.freq_hz, warning);
        }
    }
    let recorder = &mut *executor.rig.recorder;
    let flagged = sweep_writer::flags(&points, &mut |freq_hz, text| {
        recorder.point_warning("multisine", freq_hz, text);
    });
    let lines = std::mem::take(&mut executor.known.lines);
    let found: Vec<MeasuredLine> = points
        .iter()
        .zip(lines)
        .map(|(point, line)| (point.phasors, point.volts_per_div, line))
        .collect();
    let run = write(
        executor.rig.recorder,
        experiment,
        stage,
        repeat,
        &found,
        measured,
        MultisineFigures { flagged, took_s },
    )?;
    let corrected = measured.correction.reduced_chi2.is_some();
    let phasors: Vec<ChannelPhasors> = found.iter().map(|(phasors, ..)| *phasors).collect();
    let common_mode = sweep_writer::common_mode(&phasors, experiment.bench.wiring.shunt.r_ohm);
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
        ..entry(executor, stage, repeat, start_s, measured)
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
    let MultisineFigures { flagged, took_s } = figures;
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
    recorder.flagged_spectrum(&Multisine::Raw.file(repeat), &raw, &flags)?;
    recorder.flagged_spectrum(&Multisine::Spectrum.file(repeat), &corrected, &flags)?;
    recorder.text(&Multisine::Lines.file(repeat), &table(&lines))?;
    recorder.flagged_parquet(&Multisine::SpectrumParquet.file(repeat), &corrected, &flags)?;
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
    sweep_writer::write_shared(
        recorder,
        &Multisine::Spectrum.file(repeat),
        &spectrum,
        &flags,
    )?;
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
fn entry(
    executor: &Executor<'_>,
    stage: &Stage,
    repeat: usize,
    start_time_s: f64,
    measured: &Measured,
) -> SweepEntry {
    let driven = |step: &Step| {
        if let Step::Multisine(band) = step {
            Some(band.design.amplitude * band.peak_a)
        } else {
            None
        }
    };
    SweepEntry {
        file: Multisine::Spectrum.file(repeat),
        fixture: fixture_name(Fixture::Cell).to_owned(),
        cell: None,
        fixture_ohm: None,
        corrected: measured.correction.reduced_chi2.is_some(),
        amplitude_a: stage.steps.iter().find_map(driven).unwrap_or(f64::NAN),
        bias_a: 0.0,
        conditions: Vec::new(),
        repeat,
        order: executor.rig.recorder.measured(),
        start_time_s,
        start_ocv_v: executor.known.idle.voltage_v,
        temperature_degc: executor.known.idle.temperature_degc,
        role: Role::Train,
        repeat_group: "multisine".to_owned(),
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
        "multisine: {} lines from {:.4} Hz to {:.4} Hz in {:.0} s; noise at most {:.3} %; \
        {distortion}",
        run.lines.len(),
        first.freq_hz,
        last.freq_hz,
        run.took_s,
        100.0 * noise
    )
}
