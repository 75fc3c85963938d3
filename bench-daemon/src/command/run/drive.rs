//! A plan played stage by stage: controls are judged and the correction is made from them, sweeps and traces go into the index.

use std::collections::BTreeMap;

use analysis::{
    calibration::Correction,
    dataset::{self, Role, SweepEntry},
    spectrum::Spectrum,
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
    plan::{Checked, Purpose, Stage, fixture_name},
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
    };
    recorder.about(&experiment.cell.name, experiment.cell.capacity_c);
    let mut executor = Executor::new((bench, recorder), experiment, clock.clone(), (operator, progress));
    if let Some(correction) = inherited {
        executor.recorder.json("correction.json", &correction)?;
        executor.correction = correction;
    }
    for stage in &plan.plan().stages {
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
            let point = correction.apply(&point.phasors);
            recorder.spectrum_point(&file, &point)?;
            spectrum.points.push(point);
        }
        for warning in &point.warnings {
            recorder.point_warning(&name, point.phasors.freq_hz, warning);
        }
        Ok(())
    };
    let points = executor.stage(stage, &mut on_point).await?;
    if repeat > 0 {
        let file = if corrected { file } else { format!("raw_{name}.csv") };
        let entry = entry(executor, (fixture, repeat), (file, start_time_s), measured);
        executor.recorder.sweep(entry)?;
    }
    match (cell, repeat) {
        (true, 1) => measured.spectrum = spectrum,
        (true, _) => measured.repeats.push(spectrum),
        (false, _) => {}
    }
    Ok(points)
}

/// A sweep in words of the index.
fn entry(
    executor: &Executor<'_>,
    (fixture, repeat): (Fixture, usize),
    (file, start_time_s): (String, f64),
    measured: &Measured,
) -> SweepEntry {
    let (experiment, cell) = (executor.experiment, fixture == Fixture::Cell);
    SweepEntry {
        file,
        fixture: fixture_name(fixture).to_owned(),
        fixture_ohm: (!cell).then_some(fixture_check::known(&experiment.bench, fixture).r_ohm),
        corrected: measured.correction.reduced_chi2.is_some(),
        amplitude_a: experiment.eis.as_ref().map_or(f64::NAN, |eis| eis.amplitude_a),
        repeat,
        order: executor.recorder.measured(),
        start_time_s,
        start_ocv_v: executor.idle.voltage_v.filter(|_| cell),
        temperature_c: executor.idle.temperature_c.filter(|_| cell),
        role: Role::Train,
        repeat_group: if cell { "eis".to_owned() } else { "eis_shunt".to_owned() },
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
    let result = fixture_check::judge_raw(&experiment.bench, fixture, tolerance, points);
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
        let verdict = fixture_check::judge_corrected(&experiment.bench, fixture, correction, points);
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
