//! Recomputes multisines and traces from their captures, into the folder with all other results.
//!
//! The run supplies what no capture contains: which line the gate refused, how long a multisine
//! took, when each level was commanded, the voltmeter's voltage at rest, and the temperatures
//! beside a trace. A trace through load and supply has no capture: its rows are the readings of
//! their meters. A trace through the bipolar supply may come from a version that did not record
//! its commands. It has captures, but the positions of its steps in them are unknown.

use std::fs;

use analysis::{
    calibration::Correction,
    dataset::{self, Capture, Commanded, TraceEntry, TraceRow},
    run_folder::{self, Multisine},
    spectrum::raw_impedance,
};

use instruments::units::{Amps, Seconds};

use super::{Recorded, figures};
use crate::run::multisine::{self, MeasuredLine, MultisineRun};
use bench_core::{
    executor::{BandFit, Frames, RecordedTrace, fit_band, zeros},
    record::{RecordError, Recorder},
    safety::failure::Failure,
};
use bench_plan::plan::{Band, Stage, Step, Through, TracePlan};

/// Results that were recomputed beside the points of sweeps.
#[derive(Debug, Default)]
pub struct OtherResults {
    /// Lines of multisines.
    pub lines: usize,
    /// Rows of traces.
    pub rows: usize,
    /// Number of points that the quality gate has refused.
    pub refused: usize,
    /// Files of traces without a capture.
    pub as_read: Vec<String>,
    /// Files of traces with captures, from a version that did not record the commands.
    pub uncommanded: Vec<String>,
}

impl Recorded {
    /// Recomputes the multisine with this number of a stage from its captures. Uses the record of every
    /// line that the run kept, or the latest if none matches. Also returns the run's own result.
    pub(super) fn multisine(
        &self,
        stage: &Stage,
        repeat: usize,
        number: usize,
    ) -> Result<(Vec<MeasuredLine>, MultisineRun), Failure> {
        let kept = multisine::restore(&self.folder, number)?;
        let raw = dataset::read_spectrum_csv(&self.folder.join(Multisine::Raw.file(number)))
            .map_err(RecordError::from)?;
        let shunt_ohm = self.experiment.bench.wiring.shunt.r_ohm;
        let mut found: Vec<MeasuredLine> = Vec::new();
        let bands: Vec<&Band> = stage
            .steps
            .iter()
            .filter_map(|step| match step {
                Step::Multisine(band) => Some(band.as_ref()),
                _ => None,
            })
            .collect();
        let numbers = multisine::numbers(&self.experiment, stage, repeat);
        let of_one = bands.len() / numbers.len();
        let own = bands.chunks(of_one.max(1)).nth(number - numbers.start);
        for band in own.unwrap_or_default() {
            let attempts = self.attempts(band, repeat, stage.bias_a() != Amps(0.0))?;
            for line in 0..band.design.harmonics.len() {
                let stored = raw.get(found.len()).map(|point| point.z_ohm);
                let same = |attempt: &&Vec<MeasuredLine>| {
                    attempt
                        .get(line)
                        .map(|own| raw_impedance(&own.0, shunt_ohm).z_ohm)
                        == stored
                };
                let attempt = attempts.iter().find(same).or_else(|| attempts.first());
                let missing = || {
                    self.failed(&format!(
                        "multisine {number}, band {}: expected line {}, found none",
                        band.number,
                        line + 1
                    ))
                };
                found.push(
                    *attempt
                        .and_then(|attempt| attempt.get(line))
                        .ok_or_else(missing)?,
                );
            }
        }
        Ok((found, kept))
    }

    /// Returns the lines of all records of a band, the latest first. A record that cannot be
    /// analysed was not kept, unless it is the only one.
    fn attempts(
        &self,
        band: &Band,
        repeat: usize,
        changing: bool,
    ) -> Result<Vec<Vec<MeasuredLine>>, Failure> {
        let (mut attempts, mut wrong) = (Vec::new(), None);
        for attempt in 0_usize.. {
            let path = self.folder.join(run_folder::capture(
                &run_folder::multisine_captures(repeat),
                &run_folder::band_capture(band.number, attempt),
            ));
            if attempt > 0 && !path.exists() {
                break;
            }
            let capture =
                dataset::read_capture(&path).map_err(|error| Failure::Usage(figures(&error)))?;
            let scale = |slot: usize| capture.meta.channels[slot].scale;
            let volts = [0, 1, 2, 3].map(|slot| {
                capture.codes[slot]
                    .iter()
                    .map(|code| scale(slot).volts(*code))
                    .collect::<Vec<f64>>()
            });
            match fit_band(
                band,
                volts.each_ref().map(Vec::as_slice),
                Seconds(capture.meta.interval_s),
                changing,
            ) {
                Ok(BandFit { phasors, lines }) => {
                    let volts_per_div = capture.meta.channels.map(|channel| channel.volts_per_div);
                    attempts.insert(
                        0,
                        phasors
                            .into_iter()
                            .zip(lines)
                            .map(|(own, line)| (own, volts_per_div, line))
                            .collect(),
                    );
                }
                Err(error) => wrong = Some(self.failed(&format!("{}: {error}", path.display()))),
            }
        }
        wrong
            .filter(|_| attempts.is_empty())
            .map_or(Ok(attempts), Err)
    }

    /// Recomputes a trace from its frames into the new folder: its rows, and its entry in the
    /// index.
    pub(super) fn trace(
        &self,
        recorder: &mut Recorder,
        correction: &Correction,
        trace: &TracePlan,
        others: &mut OtherResults,
    ) -> Result<(), Failure> {
        let known = recorder
            .index()
            .traces
            .iter()
            .find(|known| known.name == trace.name && known.repeat == trace.repeat)
            .cloned();
        let Some(entry) = known else { return Ok(()) };
        let Some(commanded) = entry.commanded.clone() else {
            let held = if trace.through == Through::LoadAndSupply {
                &mut others.as_read
            } else {
                &mut others.uncommanded
            };
            held.push(entry.file);
            return Ok(());
        };
        let empty = || {
            self.failed(&format!(
                "trace {}: expected a frame of the zeros, found an empty one",
                trace.name
            ))
        };
        let zero_v = zeros(&self.frame(trace, run_folder::ZERO_FRAME)?).ok_or_else(empty)?;
        let shunt_ohm = self.experiment.bench.wiring.shunt.r_ohm;
        let frames = Frames {
            trace,
            correction,
            shunt_ohm,
            zero_v,
            ocv_v: entry.start_ocv_v,
        };
        let (start_time_s, mut found) = self.frames(&frames, &commanded)?;
        let path = self.folder.join(&entry.file);
        let was: Vec<TraceRow> = dataset::read_trace_csv(&path).map_err(RecordError::from)?;
        for (row, was) in found.rows.iter_mut().zip(&was) {
            row.temperature_degc = was.temperature_degc;
        }
        others.rows += found.rows.len();
        let [sample_sigma_a, sample_sigma_v] = found.scatter();
        let entry = TraceEntry {
            start_time_s,
            sample_sigma_a,
            sample_sigma_v,
            steps_s: found.steps_s,
            ..entry
        };
        // Do not write through a link to the file of the run.
        let _ = fs::remove_file(recorder.path(&entry.file));
        Ok(recorder.trace_again(entry, &found.rows)?)
    }

    /// Returns all frames of a trace, and the bench time of test time 0, s.
    fn frames(
        &self,
        frames: &Frames<'_>,
        commanded: &Commanded,
    ) -> Result<(f64, RecordedTrace), Failure> {
        match (commanded, frames.trace.through) {
            (
                Commanded::Wave { sent_s, step_s },
                Through::Wave {
                    step_s: planned_s, ..
                },
            ) => {
                let capture = self.frame(frames.trace, "wave")?;
                let found = frames.of_wave(&capture, *sent_s, *step_s, planned_s.0);
                match &found.1.missing {
                    Some((expected, measured)) => Err(self.failed(&format!(
                        "{}: expected {expected}, found {measured}",
                        frames.trace.name
                    ))),
                    None => Ok(found),
                }
            }
            (Commanded::Steps(steps), Through::Bipolar) => {
                let mut all = RecordedTrace::default();
                for number in 1..=frames.trace.frames.len() {
                    all.append(frames.of_frame(
                        &self.frame(frames.trace, &format!("frame{number:03}"))?,
                        steps,
                    ));
                }
                Ok((steps.first().map_or(f64::NAN, |(at_s, _)| *at_s), all))
            }
            _ => Err(self.failed(&format!(
                "trace {}: expected to be driven as its plan says, found another way",
                frames.trace.name
            ))),
        }
    }

    fn frame(&self, trace: &TracePlan, name: &str) -> Result<Capture, Failure> {
        let path = self.folder.join(run_folder::capture(
            &run_folder::trace_name(&trace.name, trace.repeat),
            name,
        ));
        dataset::read_capture(&path).map_err(|error| Failure::Usage(figures(&error)))
    }

    pub(super) fn failed(&self, what: &str) -> Failure {
        Failure::Usage(format!("{}: {what}", self.folder.display()))
    }
}
