//! Collects the results of the finished stages of a run: sweeps, the controls' verdicts, the
//! correction. It uses no instrument: a resumed run and one that is recomputed from its captures
//! collect in the same manner.

use std::collections::{
    BTreeMap,
    btree_map::Entry::{Occupied, Vacant},
};

use analysis::{
    calibration::Correction,
    run_folder::{CONTROLS, CORRECTION, SPECTRUM_PARQUET},
    spectrum::Spectrum,
};
use instruments::fixture::Fixture;

use super::{
    Measured,
    sweep_writer::{self, Settled, SweepWriter},
};
use crate::doctor::fixture_check;
use bench_core::{
    record::{Event, RecordError, Recorder},
    safety::failure::Failure,
};
use bench_plan::{
    config::Experiment,
    measure::SweepPoint,
    plan::{Stage, fixture_name},
};

/// Results of the finished stages so far.
pub(super) struct RunAccumulator<'a> {
    experiment: &'a Experiment,
    pub(super) measured: Measured,
    /// Sweeps of the cell, by their numbers.
    settled: BTreeMap<usize, Settled>,
}

impl<'a> RunAccumulator<'a> {
    /// Creates an accumulator without measurements; its correction is that of an earlier run, if
    /// any.
    pub(super) fn new(experiment: &'a Experiment, inherited: Option<Correction>) -> Self {
        let measured = Measured {
            controls: Vec::new(),
            sweeps: BTreeMap::new(),
            correction: inherited
                .unwrap_or_else(|| Correction::none(experiment.bench.wiring.shunt)),
            spectrum: Spectrum {
                name: experiment.name.clone(),
                points: Vec::new(),
                ..Spectrum::default()
            },
            repeats: Vec::new(),
            own_noise: Vec::new(),
            points: Vec::new(),
            files: Vec::new(),
            refused_controls: Vec::new(),
            campaign: experiment.campaign.is_some() || experiment.map.is_some(),
            multisines: Vec::new(),
        };
        Self {
            experiment,
            measured,
            settled: BTreeMap::new(),
        }
    }

    /// Returns the writer of the sweep of a stage.
    pub(super) fn sweep_writer(
        &self,
        stage: &Stage,
        fixture: Fixture,
        repeat: usize,
    ) -> SweepWriter<'a> {
        let writer = SweepWriter::new(self.experiment, fixture, repeat, &self.measured);
        writer.under(stage.bias_a().0)
    }

    /// Evaluates a complete sweep. `restored` means that its results were already reported.
    pub(super) fn finish(
        &mut self,
        recorder: &mut Recorder,
        fixture: Fixture,
        repeat: usize,
        settled: Settled,
        restored: bool,
    ) -> Result<(), Failure> {
        let points = settled.points.clone();
        if fixture == Fixture::Cell {
            self.settled.insert(repeat, settled);
        } else {
            let refused = sweep_writer::flags(&points, &mut |_, _| ())
                .into_iter()
                .map(|point| (fixture_name(fixture), point));
            self.measured.refused_controls.extend(refused);
        }
        let tell = |recorder: &mut Recorder, text: &str| {
            if restored {
                Ok(())
            } else {
                recorder.event(Event::Check, text)
            }
        };
        if repeat == 0 {
            judge(
                recorder,
                self.experiment,
                fixture,
                &points,
                &mut self.measured,
                &tell,
            )?;
        }
        let first = repeat <= 1;
        match self.measured.sweeps.entry(fixture_name(fixture)) {
            Occupied(mut known) if first => drop(known.insert(points)),
            Occupied(_) => {}
            Vacant(place) => drop(place.insert(points)),
        }
        // This comes before any other use of the cell, including its state of charge.
        let controls = self
            .experiment
            .fixture_check
            .as_ref()
            .map_or(0, |check| check.controls.len());
        if repeat == 0 && self.measured.controls.len() == controls {
            correct(recorder, self.experiment, &mut self.measured, &tell)?;
        }
        Ok(())
    }

    /// Returns all results, once nothing remains to be done.
    pub(super) fn whole(self, recorder: &Recorder) -> Result<Measured, Failure> {
        let Self {
            mut measured,
            settled,
            ..
        } = self;
        for (
            place,
            Settled {
                points,
                spectrum,
                own_noise,
                file,
            },
        ) in settled.into_values().enumerate()
        {
            if place == 0 {
                measured.spectrum = spectrum;
            } else {
                measured.repeats.push(spectrum);
            }
            measured.points.push(points);
            measured.files.push(file);
            measured.own_noise.push(own_noise);
        }
        // Parquet has no columns for a direct current.
        if !measured.spectrum.points.is_empty() && measured.bias_a(0) == 0.0 {
            let flags = measured
                .points
                .first()
                .map_or_else(Vec::new, |points| sweep_writer::flag_texts(points));
            recorder.flagged_parquet(SPECTRUM_PARQUET, &measured.spectrum.points, &flags)?;
        }
        Ok(measured)
    }
}

/// Reports a result unless it was already reported.
type Tell<'a> = &'a dyn Fn(&mut Recorder, &str) -> Result<(), RecordError>;

/// Stops the run if a control that was just measured is wrong as read.
fn judge(
    recorder: &mut Recorder,
    experiment: &Experiment,
    fixture: Fixture,
    points: &[SweepPoint],
    measured: &mut Measured,
    tell: Tell<'_>,
) -> Result<(), Failure> {
    let tolerance = experiment
        .fixture_check
        .iter()
        .flat_map(|check| &check.controls)
        .find(|(control, _)| *control == fixture);
    let Some((_, tolerance)) = tolerance else {
        return Ok(());
    };
    let swept = fixture_check::swept(experiment, points);
    let mut result = fixture_check::judge_raw(&experiment.bench, fixture, tolerance, swept);
    result.believed_as_read = Some(fixture_check::believed_as_read(experiment, fixture, points));
    let text = format!("{} as read: {}", result.control, result.raw.text);
    tell(recorder, &text)?;
    let passed = result.raw.passed;
    measured.controls.push(result);
    recorder.json(CONTROLS, &measured.controls)?;
    if passed {
        Ok(())
    } else {
        Err(Failure::FixtureCheck(text))
    }
}

/// Computes the correction from the controls and stops the run if it does not make them right.
fn correct(
    recorder: &mut Recorder,
    experiment: &Experiment,
    measured: &mut Measured,
    tell: Tell<'_>,
) -> Result<(), Failure> {
    let Some(check) = &experiment.fixture_check else {
        return Ok(());
    };
    if let Some(name) = fixture_check::refused_whole(&measured.sweeps) {
        let text = format!(
            "{name}: expected points for the correction, the quality gate has refused every one of \
            them"
        );
        return Err(Failure::FixtureCheck(text));
    }
    let correction =
        fixture_check::correction(&experiment.bench, &measured.sweeps).map_err(|error| {
            Failure::FixtureCheck(format!("no correction can be computed: {error}"))
        })?;
    recorder.json(CORRECTION, &correction)?;
    measured.correction = correction;
    let mut wrong = None;
    for fixture in [Fixture::FakeCell, Fixture::Short] {
        let name = fixture_name(fixture);
        let Some(control) = measured
            .controls
            .iter_mut()
            .find(|control| control.control == name)
        else {
            continue;
        };
        // Refused points carry no information about the correction.
        let points: Vec<SweepPoint> = measured.sweeps.get(name).map_or_else(Vec::new, |points| {
            fixture_check::let_through(points).cloned().collect()
        });
        let verdict = fixture_check::judge_corrected(
            &experiment.bench,
            fixture,
            &measured.correction,
            check.corrected_tolerance,
            fixture_check::swept(experiment, &points),
        );
        control.believed = Some(fixture_check::believed(
            experiment,
            fixture,
            &measured.correction,
            check.corrected_tolerance,
            &points,
        ));
        let text = format!("{name} after the correction: {}", verdict.text);
        tell(recorder, &text)?;
        if !verdict.passed && wrong.is_none() {
            wrong = Some(text);
        }
        control.corrected = Some(verdict);
    }
    recorder.json(CONTROLS, &measured.controls)?;
    wrong.map_or(Ok(()), |text| Err(Failure::FixtureCheck(text)))
}
