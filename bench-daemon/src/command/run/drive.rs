//! A plan played stage by stage: controls are judged and the correction is made from them, sweeps and traces go into the index.

use std::collections::BTreeMap;

use analysis::{
    calibration::Correction,
    dataset::{self, FlaggedPoint, Role, SweepEntry},
    spectrum::{ImpedancePoint, Spectrum, at_one_time},
};
use instruments::{clock::Clock, mock::plant::Fixture};

use super::{Measured, safe};
use crate::{
    bench::Bench,
    command::Failure,
    config::Experiment,
    executor::{ExecuteError, Executor, SweepPoint},
    fixture_check,
    operator::Operator,
    plan::{Checked, Purpose, Stage, Step, fixture_name},
    progress::Progress,
    record::{Recorder, sweep_name},
};

/// Executes the plan, stage by stage, and judges the controls as soon as they are measured.
pub(super) async fn drive(
    (bench, recorder): (&mut Bench, &mut Recorder),
    experiment: &Experiment,
    plan: &Checked,
    (clock, operator, progress): (&Clock, &Operator, &Progress),
    inherited: Option<Correction>,
) -> Result<Measured, Failure> {
    safe(bench.safe_state().await, Ok(()))?;
    let mut measured = Measured {
        controls: Vec::new(),
        sweeps: BTreeMap::new(),
        correction: inherited.clone().unwrap_or_else(|| Correction::none(experiment.bench.wiring.shunt)),
        spectrum: Spectrum { name: experiment.name.clone(), points: Vec::new() },
        repeats: Vec::new(),
        own_noise: Vec::new(),
        multisines: Vec::new(),
    };
    recorder.about(&experiment.cell.name, experiment.cell.capacity_c);
    let mut executor = Executor::new((bench, recorder), experiment, clock.clone(), (operator, progress));
    if let Some(correction) = inherited {
        executor.recorder.json("correction.json", &correction)?;
        executor.correction = correction;
    }
    for stage in &plan.plan().stages {
        if let Purpose::Multisine(repeat) = stage.purpose {
            super::multisine::measure(&mut executor, (stage, repeat), &mut measured).await?;
            continue;
        }
        let Purpose::Sweep(fixture, repeat) = stage.purpose else {
            executor.stage(stage, &mut |_, _| Ok(())).await?;
            continue;
        };
        let points = sweep(&mut executor, stage, (fixture, repeat), &mut measured).await?;
        if repeat == 0 {
            judge(executor.recorder, experiment, (fixture, &points), &mut measured)?;
        }
        measured.sweeps.entry(fixture_name(fixture)).or_insert(points);
        // Before anything is done with the cell, its state of charge included.
        let controls = experiment.fixture_check.as_ref().map_or(0, |check| check.controls.len());
        if repeat == 0 && measured.controls.len() == controls {
            correct(executor.recorder, experiment, &mut measured)?;
            executor.correction = measured.correction.clone();
        }
    }
    if !measured.spectrum.points.is_empty() {
        dataset::write_spectrum_parquet(&executor.recorder.path("spectrum.parquet"), &measured.spectrum.points)
            .map_err(crate::record::RecordError::from)?;
    }
    Ok(measured)
}

/// One sweep: every point is in the files as soon as it is measured, and the whole sweep in the index.
async fn sweep(
    executor: &mut Executor<'_>,
    stage: &Stage,
    (fixture, repeat): (Fixture, usize),
    measured: &mut Measured,
) -> Result<Vec<SweepPoint>, Failure> {
    let (name, experiment, correction) = (sweep_name(fixture, repeat), executor.experiment, measured.correction.clone());
    let cell = fixture == Fixture::Cell;
    let corrected = cell || (repeat > 0 && correction.reduced_chi2.is_some());
    let file = match (cell, repeat) {
        (true, 0 | 1) => "spectrum.csv".to_owned(),
        (true, _) => format!("spectrum_{repeat}.csv"),
        (false, _) => format!("spectrum_{name}.csv"),
    };
    let mut spectrum = Spectrum { name: experiment.name.clone(), points: Vec::new() };
    let start_time_s = executor.clock.now_s();
    let mut on_point = |recorder: &mut Recorder, point: &SweepPoint| -> Result<(), ExecuteError> {
        let raw = fixture_check::raw_points(&experiment.bench, std::slice::from_ref(point));
        for point in &raw {
            recorder.spectrum_point(&format!("raw_{name}.csv"), point)?;
        }
        if corrected {
            recorder.spectrum_point(&file, &correction.apply(&point.phasors))?;
        }
        for warning in &point.warnings {
            recorder.point_warning(&name, point.phasors.freq_hz, warning);
        }
        Ok(())
    };
    let mut points = executor.stage(stage, &mut on_point).await?;
    // Records that were taken again, and any order: the files hold what counts, by rising frequency.
    points.sort_by(|a, b| a.phasors.freq_hz.total_cmp(&b.phasors.freq_hz));
    let read = fixture_check::raw_points(&experiment.bench, &points);
    let visits: Vec<(f64, ImpedancePoint)> = points.iter().zip(read).map(|(point, read)| (point.time_s, read)).collect();
    executor.recorder.spectrum(&format!("raw_{name}.csv"), &at_one_time(&visits))?;
    if corrected {
        spectrum.points = frozen(&points, &correction);
        executor.recorder.spectrum(&file, &spectrum.points)?;
    }
    let flagged = flags(executor.recorder, &name, &points);
    if repeat > 0 {
        let file = if corrected { file } else { format!("raw_{name}.csv") };
        let entry = SweepEntry { flagged, ..entry(executor, (stage, fixture, repeat), (file, start_time_s), measured) };
        executor.recorder.sweep(entry)?;
    }
    if cell {
        let own = |point: &SweepPoint| correction.measured_parts(&point.phasors).into_iter().sum();
        let visits: Vec<(f64, ImpedancePoint)> = points
            .iter()
            .map(|point| (point.time_s, ImpedancePoint { covariance: own(point), ..correction.apply(&point.phasors) }))
            .collect();
        measured.own_noise.push(Spectrum { name: spectrum.name.clone(), points: at_one_time(&visits) });
    }
    match (cell, repeat) {
        (true, 1) => measured.spectrum = spectrum,
        (true, _) => measured.repeats.push(spectrum),
        (false, _) => {}
    }
    points.dedup_by(|a, b| a.phasors.freq_hz == b.phasors.freq_hz);
    Ok(points)
}

/// Corrected points, each frequency once: where it was visited twice, at the time in the middle of the sweep.
fn frozen(points: &[SweepPoint], correction: &Correction) -> Vec<ImpedancePoint> {
    let visits: Vec<(f64, ImpedancePoint)> = points.iter().map(|point| (point.time_s, correction.apply(&point.phasors))).collect();
    at_one_time(&visits)
}

/// What the quality gate refused to the end, said and in words of the index.
fn flags(recorder: &mut Recorder, name: &str, points: &[SweepPoint]) -> Vec<FlaggedPoint> {
    let mut flagged = Vec::new();
    for point in points.iter().filter(|point| !point.failing.is_empty()) {
        let freq_hz = point.phasors.freq_hz;
        let reasons: Vec<String> = point.failing.iter().map(ToString::to_string).collect();
        for failing in &point.failing {
            recorder.point_warning(
                name,
                freq_hz,
                &format!("flagged by the quality gate after {} records: {}", point.captures, failing.criterion),
            );
        }
        flagged.push(FlaggedPoint { freq_hz, reasons });
    }
    flagged
}

/// A sweep in words of the index.
fn entry(
    executor: &Executor<'_>,
    (stage, fixture, repeat): (&Stage, Fixture, usize),
    (file, start_time_s): (String, f64),
    measured: &Measured,
) -> SweepEntry {
    let (experiment, cell) = (executor.experiment, fixture == Fixture::Cell);
    let driven = stage.steps.iter().find_map(|step| if let Step::Sine { amplitude_a, .. } = step { Some(*amplitude_a) } else { None });
    let amplitude_a = driven.unwrap_or(f64::NAN);
    let several = experiment.eis.as_ref().is_some_and(|eis| eis.steps_a.len() > 1);
    let group = if cell { "eis" } else { "eis_shunt" };
    SweepEntry {
        file,
        fixture: fixture_name(fixture).to_owned(),
        fixture_ohm: (!cell).then_some(fixture_check::known(&experiment.bench, fixture).r_ohm),
        corrected: measured.correction.reduced_chi2.is_some(),
        amplitude_a,
        repeat,
        order: executor.recorder.measured(),
        start_time_s,
        start_ocv_v: executor.idle.voltage_v.filter(|_| cell),
        temperature_c: executor.idle.temperature_c.filter(|_| cell),
        role: Role::Train,
        repeat_group: if several { format!("{group}_{amplitude_a}A") } else { group.to_owned() },
        flagged: Vec::new(),
    }
}

/// Stops the run when a control that was just measured is off as read.
fn judge(
    recorder: &mut Recorder,
    experiment: &Experiment,
    (fixture, points): (Fixture, &[SweepPoint]),
    measured: &mut Measured,
) -> Result<(), Failure> {
    let tolerance = experiment.fixture_check.iter().flat_map(|check| &check.controls).find(|(control, _)| *control == fixture);
    let Some((_, tolerance)) = tolerance else { return Ok(()) };
    let swept = fixture_check::swept(experiment, points);
    let mut result = fixture_check::judge_raw(&experiment.bench, fixture, tolerance, swept);
    result.believed_as_read = Some(fixture_check::believed_as_read(experiment, fixture, points));
    let text = format!("{} as read: {}", result.control, result.raw.text);
    recorder.event(&text).map_err(Failure::from)?;
    let passed = result.raw.passed;
    measured.controls.push(result);
    recorder.json("controls.json", &measured.controls)?;
    if passed { Ok(()) } else { Err(Failure::FixtureCheck(text)) }
}

/// Computes the correction from the controls and stops the run when it does not make them right.
fn correct(recorder: &mut Recorder, experiment: &Experiment, measured: &mut Measured) -> Result<(), Failure> {
    let Some(check) = &experiment.fixture_check else { return Ok(()) };
    let correction = fixture_check::correction(&experiment.bench, &measured.sweeps)
        .map_err(|error| Failure::FixtureCheck(format!("no correction can be computed: {error}")))?;
    recorder.json("correction.json", &correction)?;
    measured.correction = correction;
    let mut wrong = None;
    for fixture in [Fixture::FakeCell, Fixture::Short] {
        let name = fixture_name(fixture);
        let Some(control) = measured.controls.iter_mut().find(|control| control.control == name) else { continue };
        let points = measured.sweeps.get(name).map_or(&[][..], Vec::as_slice);
        let correction = (&measured.correction, check.corrected_tolerance);
        let verdict = fixture_check::judge_corrected(&experiment.bench, fixture, correction, fixture_check::swept(experiment, points));
        control.believed = Some(fixture_check::believed(experiment, fixture, correction, points));
        let text = format!("{name} after the correction: {}", verdict.text);
        recorder.event(&text)?;
        if !verdict.passed && wrong.is_none() {
            wrong = Some(text);
        }
        control.corrected = Some(verdict);
    }
    recorder.json("controls.json", &measured.controls)?;
    wrong.map_or(Ok(()), |text| Err(Failure::FixtureCheck(text)))
}
