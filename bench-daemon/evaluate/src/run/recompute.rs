//! Recomputes a recorded run from its captures: the present program analyses every record again.
//! All results are collected and evaluated as in the run itself. This uses no instrument and does
//! not change the run folder.
//!
//! The journal supplies what no capture contains: which record of a point is used, when it was
//! taken, and which readings accompanied it.

mod recorded;
mod records;

use std::{
    fs,
    os::unix::fs::symlink,
    path::Path,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

pub(crate) use records::OtherResults;

use super::{
    FINISHED, inherited::inherited_correction, multisine, results, resume_context,
    run_accumulator::RunAccumulator, sweep_writer,
};
use analysis::{
    dataset::{self, Capture, CaptureFile, CaptureMeta},
    ocv::OcvCurve,
    run_folder::{
        self, CORRECTION, EVENTS, INDEX, JOURNAL, MANIFEST, PLOTS, READINGS, SPECTRA, TRANSCRIPTS,
        moved_captures,
    },
    sine::Channel,
};
use bench_core::{
    executor::{ChannelRecord, PointRequest, analyse, check_channels},
    journal::{self, Entry, Line, replay::JournalReplay},
    record::Recorder,
    safety::failure::Failure,
};
use bench_plan::{
    measure::{
        SweepPoint,
        channels::ControlPotentials,
        repeated::{Digest, SeenRecords, digest_record},
    },
    plan::{Purpose, Step},
    procedure,
};
use instruments::{
    clock::{Clock, TimeMode},
    fixture::Fixture,
    units::{Amps, Hertz},
};
pub use recorded::Recorded;
use recorded::figures;

/// Captures above this size are read in parts, bytes: memory use is this size for each core,
/// decoded.
const LARGE_BYTES: u64 = 1 << 23;

/// A finished point in the journal.
pub struct RecordedPoint {
    /// The number of its stage.
    pub stage: usize,
    /// All captures of the point, relative to the folder.
    pub files: Vec<String>,
    /// Result of the run from the record that is used.
    pub point: SweepPoint,
}

/// The point recomputed from the same capture.
pub struct RecomputedPoint {
    /// The point.
    pub point: SweepPoint,
    /// The capture.
    pub file: String,
    /// Its size on disk.
    pub bytes: u64,
    /// Number of samples of all channels.
    pub samples: u64,
    /// Digest of its codes; `None` if the capture was read in parts.
    digest: Option<Digest>,
}

impl Recorded {
    /// Reads journal and configuration of a run folder.
    ///
    /// # Errors
    /// Fails if files cannot be read or were not written by a run.
    pub fn read(folder: &Path) -> Result<Self, Failure> {
        let usage = |text: String| Failure::Usage(format!("{}: {text}", folder.display()));
        let mut lines = journal::read(folder)
            .map_err(|error| Failure::Usage(error.to_string()))?
            .lines;
        let ended = JournalReplay::of(&lines)
            .map_err(|error| usage(error.to_string()))?
            .ended;
        let stopped = (ended.as_deref() != Some(FINISHED))
            .then(|| ended.unwrap_or_else(|| "its journal has no end".to_owned()));
        // Steps after the measurement are computed again. A safe state also occurs at the
        // beginning, and a run that was stopped may have no other.
        let measures = |line: &Line| {
            matches!(
                line.entry,
                Entry::Stage { .. } | Entry::Intent { .. } | Entry::Point(_)
            )
        };
        let last = lines.iter().rposition(measures).unwrap_or(0);
        let end = lines
            .iter()
            .rposition(|line| line.entry == Entry::Safe)
            .filter(|at| *at > last)
            .map_or(lines.len(), |at| at + 1);
        lines.truncate(end);
        let replay = JournalReplay::of(&lines).map_err(|error| usage(error.to_string()))?;
        let experiment = resume_context::copied_experiment(folder, &replay.started)?;
        let plan = procedure::plan(&experiment);
        Ok(Self {
            folder: folder.to_owned(),
            experiment,
            plan,
            lines,
            replay,
            stopped,
        })
    }

    /// Returns the version of the program that made the run.
    pub fn version(&self) -> &str {
        &self.replay.started.version
    }

    /// Returns how a run ended if it was not completed.
    pub fn stopped(&self) -> Option<&str> {
        self.stopped.as_deref()
    }

    /// The experiment, from the copies of its files.
    pub fn experiment(&self) -> &bench_plan::config::Experiment {
        &self.experiment
    }

    /// Returns the open-circuit voltage of the cell from its file.
    pub fn ocv(&self) -> Option<&OcvCurve> {
        self.experiment.cell.ocv.as_ref()
    }

    /// Returns all finished points in the order of the plan, including those of incomplete sweeps.
    ///
    /// # Errors
    /// Fails if the journal contains a sweep where the plan has none.
    pub fn points(&self) -> Result<Vec<RecordedPoint>, Failure> {
        let mut known = Vec::new();
        for (stage, replay) in &self.replay.stages {
            for (step, done) in &replay.points {
                if self.swept(*stage).is_none() {
                    let text = format!(
                        "{}: expected a sweep as stage {} of the plan: this program plans another \
                        run",
                        self.folder.display(),
                        stage + 1
                    );
                    return Err(Failure::Usage(text));
                }
                known.push(RecordedPoint {
                    stage: *stage,
                    files: self.files(*stage, *step),
                    point: done.point.clone(),
                });
            }
        }
        Ok(known)
    }

    /// Returns the number of points of incomplete sweeps, from which no spectrum is made.
    pub fn unfinished(&self) -> usize {
        self.replay
            .stages
            .values()
            .filter(|replay| !replay.finished)
            .map(|replay| replay.points.len())
            .sum()
    }

    /// Analyses all captures, on all cores.
    ///
    /// # Errors
    /// Fails if a capture cannot be read or analysed, or was moved to an archive.
    pub fn analyse(&self, known: &[RecordedPoint]) -> Result<Vec<RecomputedPoint>, Failure> {
        if let Some(moved) = moved_captures(&self.folder).map_err(Failure::Usage)? {
            return Err(Failure::Usage(moved));
        }
        let points = on_all_cores(known, |known| self.point(known))?;
        let mut seen = SeenRecords::default();
        for point in &points {
            if let Some(earlier) = seen.remember(point.digest, point.file.clone())
                && earlier != point.file
            {
                return Err(self.failed(&format!(
                    "{}: expected a new record from the scope, found that of {earlier} again",
                    point.file
                )));
            }
        }
        Ok(points)
    }

    /// Writes everything that follows from the points, and from the records of multisines and
    /// traces, into a new folder: correction, spectra, series, and with `whole` fits, tables,
    /// pictures and report.
    ///
    /// # Errors
    /// Fails if the folder is in use, if points do not pass as controls any more, or if a result
    /// cannot be computed or written.
    pub fn settle(
        &self,
        points: &[(usize, SweepPoint)],
        out: &Path,
        whole: bool,
    ) -> Result<OtherResults, Failure> {
        let (mut recorder, mut others) = (self.recorder(out)?, OtherResults::default());
        let inherited = inherited_correction(&self.experiment, &self.folder)?;
        if let Some(correction) = &inherited {
            recorder.json(CORRECTION, correction)?;
        }
        let mut accumulator = RunAccumulator::new(&self.experiment, inherited);
        let mut stages: Vec<usize> = self
            .replay
            .stages
            .iter()
            .filter(|(_, replay)| replay.finished)
            .map(|(stage, _)| *stage)
            .collect();
        let began_s = |stage: &usize| {
            self.replay
                .stages
                .get(stage)
                .map_or(0.0, |replay| replay.began_s.value())
        };
        stages.sort_by(|a, b| began_s(a).total_cmp(&began_s(b)).then(a.cmp(b)));
        for number in stages {
            let Some(stage) = self.plan.stages.get(number) else {
                continue;
            };
            if let Purpose::Multisine(repeat) = stage.purpose {
                for number in multisine::numbers(&self.experiment, stage, repeat) {
                    let (found, kept) = self.multisine(stage, repeat, number)?;
                    others.lines += found.len();
                    let figures = multisine::MultisineFigures {
                        flagged: kept.flagged,
                        took_s: kept.took_s,
                        conditions: kept.conditions,
                        rest_v: kept.rest_v,
                    };
                    let run = multisine::write(
                        &recorder,
                        &self.experiment,
                        stage,
                        number,
                        &found,
                        &accumulator.measured,
                        figures,
                    )?;
                    accumulator.measured.multisines.push(run);
                }
            }
            for step in &stage.steps {
                let Step::Trace(trace) = step else { continue };
                self.trace(
                    &mut recorder,
                    &accumulator.measured.correction,
                    trace,
                    &mut others,
                )?;
            }
            let Some((fixture, repeat)) = self.swept(number) else {
                continue;
            };
            let sweep_writer = accumulator.sweep_writer(stage, fixture, repeat);
            let own: Vec<SweepPoint> = points
                .iter()
                .filter(|(stage, _)| *stage == number)
                .map(|(_, point)| point.clone())
                .collect();
            for point in &own {
                point.warnings.iter().for_each(|text| {
                    recorder.known_point_warning(&sweep_writer.name, point.phasors.freq_hz, text);
                });
            }
            let settled = sweep_writer.settle(&recorder, own)?;
            sweep_writer::flags(&settled.points, &mut |freq_hz, text| {
                recorder.known_point_warning(&sweep_writer.name, freq_hz, text);
            });
            accumulator.finish(&mut recorder, fixture, repeat, settled, true)?;
        }
        let measured = accumulator.whole(&recorder)?;
        others.refused = measured.refused();
        if whole {
            results::write(&mut recorder, &self.experiment, &measured)?;
        }
        Ok(others)
    }

    fn swept(&self, stage: usize) -> Option<(Fixture, usize)> {
        match self.plan.stages.get(stage)?.purpose {
            Purpose::Sweep(fixture, repeat) => Some((fixture, repeat)),
            _ => None,
        }
    }

    /// Returns all captures of a step in the journal, the latest first.
    fn files(&self, stage: usize, step: usize) -> Vec<String> {
        let mut files: Vec<String> = Vec::new();
        for line in self.lines.iter().rev() {
            let Entry::Point(done) = &line.entry else {
                continue;
            };
            if (done.stage, done.step) == (stage, step) {
                let fresh = done
                    .files
                    .iter()
                    .rev()
                    .map(|(file, _)| file.clone())
                    .filter(|file| !files.contains(file));
                files.extend(fresh.collect::<Vec<_>>());
            }
        }
        files
    }

    /// Recomputes a point from the capture that was used: the one whose result matches the
    /// journal, or the latest if none does.
    fn point(&self, known: &RecordedPoint) -> Result<RecomputedPoint, Failure> {
        let mut latest = None;
        for file in &known.files {
            let recomputed = self.of_capture(known, file)?;
            if recomputed.point.phasors == known.point.phasors {
                return Ok(recomputed);
            }
            latest = latest.or(Some(recomputed));
        }
        let missing = || {
            Failure::Usage(format!(
                "{}: the journal names no capture of a point",
                self.folder.display()
            ))
        };
        latest.ok_or_else(missing)
    }

    fn of_capture(&self, known: &RecordedPoint, file: &str) -> Result<RecomputedPoint, Failure> {
        let path = self.folder.join(file);
        let failed = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
        let bytes = fs::metadata(&path)
            .map_err(|error| failed(&format!("{}: {error}", path.display())))?
            .len();
        let stored = if bytes > LARGE_BYTES {
            Records::Stored(dataset::open_capture(&path).map_err(|error| failed(&figures(&error)))?)
        } else {
            Records::Whole(dataset::read_capture(&path).map_err(|error| failed(&figures(&error)))?)
        };
        let digest = match &stored {
            Records::Whole(capture) => digest_record(capture.codes.each_ref().map(Vec::as_slice)),
            Records::Stored(_) => None,
        };
        let (meta, channels) = stored.channel_record();
        let channel_record = ChannelRecord {
            channels,
            interval_s: meta.interval_s,
            volts_per_div: meta.channels.map(|channel| channel.volts_per_div),
            lsb_v: meta
                .channels
                .map(|channel| f64::from(channel.scale.code_step) * channel.scale.volts_per_code),
        };
        let eis = self.experiment.eis.as_ref();
        let SweepPoint { fixture, index, .. } = known.point;
        let request = PointRequest {
            fixture,
            index,
            freq_hz: meta.freq_hz,
            mains_hz: eis.and_then(|eis| eis.mains_hz).map(Hertz::value),
            amplitude_a: self.amplitude_a(known),
            shunt_ohm: self.experiment.bench.wiring.shunt.r_ohm,
        };
        let ranging: Vec<String> = known
            .point
            .warnings
            .iter()
            .filter(|text| of_ranging(text))
            .cloned()
            .collect();
        let point = analyse(&request, &channel_record, ranging)
            .map_err(|error| failed(&format!("{}: {error}", path.display())))?;
        check_channels(&point, &request, &self.control_potentials())
            .map_err(|error| failed(&format!("{}: {error}", path.display())))?;
        let mut failing = eis
            .and_then(|eis| eis.quality)
            .map_or_else(Vec::new, |quality| quality.judge(&point.measures));
        failing.extend(
            known
                .point
                .failing
                .iter()
                .filter(|failing| failing.is_of_sweep())
                .cloned(),
        );
        let SweepPoint {
            time_s,
            captures,
            rechecked,
            spent,
            conditions,
            ..
        } = known.point;
        let samples = 4 * channels[0].len() as u64;
        Ok(RecomputedPoint {
            point: SweepPoint {
                time_s,
                captures,
                rechecked,
                spent,
                failing,
                conditions,
                ..point
            },
            file: file.to_owned(),
            bytes,
            samples,
            digest,
        })
    }

    /// Returns the planned current amplitude of a point, A.
    fn amplitude_a(&self, known: &RecordedPoint) -> f64 {
        let steps = self
            .plan
            .stages
            .get(known.stage)
            .map_or(&[][..], |stage| &stage.steps);
        let driven = steps.iter().find_map(|step| match *step {
            Step::Sine {
                index, amplitude_a, ..
            } if index == known.point.index => Some(amplitude_a),
            _ => None,
        });
        driven.unwrap_or(Amps::NAN).0
    }

    /// Returns the potentials of the channels with the run's controls in the jig.
    fn control_potentials(&self) -> Vec<ControlPotentials> {
        let shunt_ohm = self.experiment.bench.wiring.shunt.r_ohm;
        let points = self
            .replay
            .stages
            .values()
            .flat_map(|stage| stage.points.values());
        points
            .filter_map(|done| ControlPotentials::of(&done.point, shunt_ohm))
            .collect()
    }

    /// Creates a folder with the readings and notes of the run, but without derived results.
    fn recorder(&self, out: &Path) -> Result<Recorder, Failure> {
        if fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(bench_core::record::RecordError::NotEmpty {
                path: out.to_owned(),
            }
            .into());
        }
        for part in [PLOTS, SPECTRA, TRANSCRIPTS] {
            fs::create_dir_all(out.join(part))?;
        }
        let own = fs::canonicalize(&self.folder)?;
        for entry in fs::read_dir(&own)? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            // Data that cannot be recomputed but that later evaluations read.
            if run_folder::RECORDED
                .iter()
                .any(|prefix| name.starts_with(prefix))
            {
                symlink(entry.path(), out.join(&name))?;
            }
        }
        for name in [INDEX, READINGS, MANIFEST, EVENTS] {
            if own.join(name).exists() {
                fs::copy(own.join(name), out.join(name))?;
            }
        }
        let text = fs::read_to_string(own.join(JOURNAL))?;
        let begin: String = text.split_inclusive('\n').take(self.lines.len()).collect();
        fs::write(out.join(JOURNAL), begin)?;
        let read = journal::read(out).map_err(|error| Failure::Usage(error.to_string()))?;
        // Time has no meaning here; virtual time avoids disk syncs.
        let clock = Clock::start(TimeMode::Virtual);
        Ok(Recorder::reopen(out, clock, &read, &self.replay)?)
    }
}

/// A capture in memory or on disk.
enum Records {
    Whole(Capture),
    Stored(CaptureFile),
}

impl Records {
    fn channel_record(&self) -> (&CaptureMeta, [Channel<'_>; 4]) {
        match self {
            Self::Whole(capture) => (&capture.meta, capture.channels()),
            Self::Stored(file) => (file.meta(), file.channels()),
        }
    }
}

/// Processes at most as many items at once as there are cores, because each holds a capture.
/// Threads of a pool would start the next item, nested, while they wait for the decoder's pool.
pub fn on_all_cores<T: Sync, R: Send>(
    items: &[T],
    work: impl Fn(&T) -> Result<R, Failure> + Sync,
) -> Result<Vec<R>, Failure> {
    let (next, done) = (
        AtomicUsize::new(0),
        Mutex::new(Vec::with_capacity(items.len())),
    );
    let one_after_the_other = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else { return };
            let result = work(item);
            if result.is_err() {
                // The first failure ends the other threads.
                next.store(items.len(), Ordering::Relaxed);
            }
            done.lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push((index, result));
        }
    };
    let cores = thread::available_parallelism()
        .map_or(1, usize::from)
        .min(items.len());
    thread::scope(|scope| (0..cores).for_each(|_| drop(scope.spawn(one_after_the_other))));
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

/// Checks whether a remark of the run concerns ranges, which no capture shows.
fn of_ranging(text: &str) -> bool {
    text.starts_with("measured again: ")
        || (text.starts_with("channel ") && text.ends_with(" V/div"))
}
