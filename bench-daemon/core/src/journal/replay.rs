//! Journal replay: determines from a journal how far a run came, and where it may continue. The
//! functions are pure: they take lines and return a decision.
//!
//! A stage whose end was recorded is never executed again, and neither is a finished point. What
//! else is executed again depends on the effect of a crash in a step ([`Step::after_crash`]): a
//! step that moved an unknown charge is never simply repeated.

use std::collections::{BTreeMap, BTreeSet};

use instruments::units::Seconds;

use crate::journal::{Entry, InstrumentIdentity, Line, Note, PointDone, Started};
use bench_plan::plan::{AfterCrash, Plan, Purpose, Stage, Step};

/// Journal replay of a stage: how far it came.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StageReplay {
    /// Bench time of its first start, s.
    pub began_s: Seconds,
    /// Its finished points, by their step.
    pub points: BTreeMap<usize, PointDone>,
    /// Steps that have begun since the stage last began.
    begun: BTreeSet<usize>,
    /// Steps of these that are done.
    done: BTreeSet<usize>,
    /// Whether nothing of it remains to be done.
    pub finished: bool,
}

/// Journal replay of a run: how far it came.
#[derive(Debug, Clone, PartialEq)]
pub struct JournalReplay {
    /// First entry of the run.
    pub started: Started,
    /// Bench time of the last entry, s.
    pub last_s: Seconds,
    /// The instruments that it began with, or those that were last accepted.
    pub instruments: Vec<InstrumentIdentity>,
    /// Its stages that have begun.
    pub stages: BTreeMap<usize, StageReplay>,
    /// Warnings of the run.
    pub notes: Vec<Note>,
    /// What is known of the charge of the cell.
    pub charge: ChargeReplay,
    /// The stage that began last.
    pub latest: Option<usize>,
    /// How the process recorded its end, if it did.
    pub ended: Option<String>,
}

/// What a journal knows of the charge of the cell.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ChargeReplay {
    /// The last charge that a map has counted, C, and its bench time, s.
    pub counted: Option<(f64, f64)>,
    /// What is still to be executed because a crash has left the charge unknown.
    pub repeats: Option<Repeats>,
}

/// Stages to execute again, because a crash has left the charge of the cell unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Repeats {
    /// The SOC reset.
    pub reset: usize,
    /// The stage that was interrupted.
    pub open: usize,
}

/// Resume point of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ResumeDecision {
    /// A SOC reset that is repeated first, because the charge of the cell is no longer known.
    pub repeated_reset: Option<usize>,
    /// The stage that was interrupted, and the step from which it is executed; steps that clamp
    /// something are executed in any case.
    pub open: Option<(usize, usize)>,
}

/// Reason why a run cannot be resumed without a person.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ResumeError {
    /// The first entry is missing.
    #[error("expected a journal that begins with what runs, found {0}")]
    NotStarted(String),
    /// A step moved an unknown charge.
    #[error(
        "stage {stage}, step {step} ({what}) was started but its end is not known: the charge that \
        it moved is unknown, and no SOC reset precedes it that could be repeated; check the cell, \
        bring it to the required state by hand, and continue with --accept-charge, which repeats \
        the step from its beginning"
    )]
    UnknownCharge {
        /// Number of the stage, from 1.
        stage: usize,
        /// Number of the step in it, from 1.
        step: usize,
        /// The step, as text.
        what: String,
    },
}

impl JournalReplay {
    /// Replays the lines of a journal.
    ///
    /// # Errors
    /// [`ResumeError::NotStarted`].
    pub fn of(lines: &[Line]) -> Result<Self, ResumeError> {
        let found = lines
            .first()
            .map_or_else(|| "nothing".to_owned(), |line| format!("{:?}", line.entry));
        let Some(Line {
            entry: Entry::Started(started),
            time_s,
            ..
        }) = lines.first()
        else {
            return Err(ResumeError::NotStarted(found));
        };
        let started = (**started).clone();
        let mut replay = Self {
            started,
            last_s: *time_s,
            instruments: Vec::new(),
            stages: BTreeMap::new(),
            notes: Vec::new(),
            charge: ChargeReplay::default(),
            latest: None,
            ended: None,
        };
        lines.iter().for_each(|line| replay.add(line));
        Ok(replay)
    }

    fn add(&mut self, line: &Line) {
        self.last_s = self.last_s.max(line.time_s);
        self.ended = None;
        match &line.entry {
            Entry::Stage { stage } => {
                let known = self.stages.entry(*stage).or_insert_with(|| StageReplay {
                    began_s: line.time_s,
                    ..StageReplay::default()
                });
                (known.begun, known.done, known.finished) =
                    (BTreeSet::new(), BTreeSet::new(), false);
                self.latest = Some(*stage);
            }
            Entry::Intent { stage, step, .. } => {
                self.stages.entry(*stage).or_default().begun.insert(*step);
            }
            Entry::Done { stage, step } => {
                self.stages.entry(*stage).or_default().done.insert(*step);
            }
            Entry::Point(point) => {
                let stage = self.stages.entry(point.stage).or_default();
                stage.done.insert(point.step);
                stage.points.insert(point.step, (**point).clone());
            }
            Entry::StageDone { stage } => {
                self.stages.entry(*stage).or_default().finished = true;
                self.charge.repeats = self
                    .charge
                    .repeats
                    .filter(|repeats| repeats.reset != *stage);
            }
            Entry::ChargeUnknown { reset, open } => {
                self.charge.repeats = Some(Repeats {
                    reset: *reset,
                    open: *open,
                });
            }
            Entry::Instruments(found) => self.instruments.clone_from(found),
            Entry::Note(note) => self.notes.push(note.clone()),
            Entry::Charge { charge_coulomb } => {
                self.charge.counted = Some((charge_coulomb.0, line.time_s.0));
            }
            Entry::Ended { how } => self.ended = Some(how.clone()),
            Entry::Started(_)
            | Entry::Found(_)
            | Entry::Resumed { .. }
            | Entry::Safe
            | Entry::Paused
            | Entry::Asked(_)
            | Entry::Answered(_)
            | Entry::GoneOn => {}
        }
    }

    /// Checks whether nothing of a stage remains to be done.
    pub fn finished(&self, stage: usize) -> bool {
        self.stages
            .get(&stage)
            .is_some_and(|replay| replay.finished)
    }

    /// Returns the resume point of the run. `recorded` returns whether the result of a step is in
    /// the run folder, regardless of the journal. With `accept_charge` a step that moved an
    /// unknown charge is executed again.
    ///
    /// # Errors
    /// [`ResumeError::UnknownCharge`].
    pub fn next(
        &self,
        plan: &Plan,
        recorded: impl Fn(&Step) -> bool,
        accept_charge: bool,
    ) -> Result<ResumeDecision, ResumeError> {
        // A second crash, before the reset was done, has not made the charge known.
        if let Some(Repeats { reset, open }) = self.charge.repeats.filter(|_| !accept_charge) {
            return Ok(ResumeDecision {
                repeated_reset: Some(reset),
                open: Some((open, 0)),
            });
        }
        let open = self.latest.filter(|stage| !self.finished(*stage));
        let Some((number, stage, replay)) = open
            .and_then(|number| Some((number, plan.stages.get(number)?, self.stages.get(&number)?)))
        else {
            return Ok(ResumeDecision::default());
        };
        let done = |index: usize, step: &Step| replay.done.contains(&index) || recorded(step);
        let moves: Vec<(usize, &Step)> = stage
            .steps
            .iter()
            .enumerate()
            .filter(|(_, step)| step.after_crash() != AfterCrash::Repeat)
            .collect();
        let crashed = moves
            .iter()
            .find(|(index, step)| replay.begun.contains(index) && !done(*index, step));
        let left = moves.iter().any(|(index, step)| !done(*index, step));
        let unknown = moves.iter().any(|(index, step)| {
            let spent = done(*index, step) && left;
            let here = crashed.is_some_and(|(at, _)| at == index);
            match step.after_crash() {
                AfterCrash::Unknown => spent || here,
                AfterCrash::Counted => here,
                AfterCrash::Repeat | AfterCrash::Absolute => false,
            }
        });
        if unknown && !accept_charge {
            let repeated_reset = last_reset(plan, number, stage);
            let moved = || {
                moves.iter().rfind(|(index, step)| {
                    done(*index, step) && step.after_crash() == AfterCrash::Unknown
                })
            };
            let blamed = crashed.or_else(moved);
            let (step, what) = blamed.map_or((0, String::new()), |(index, step)| {
                (index + 1, step.to_string())
            });
            return match repeated_reset {
                Some(repeated_reset) => Ok(ResumeDecision {
                    repeated_reset: Some(repeated_reset),
                    open: Some((number, 0)),
                }),
                None => Err(ResumeError::UnknownCharge {
                    stage: number + 1,
                    step,
                    what,
                }),
            };
        }
        let from = match stage.purpose {
            _ if left => 0,
            // A point is not reached before the rest after its discharge is recorded.
            Purpose::MapPoint => {
                let discharge = stage
                    .steps
                    .iter()
                    .position(|step| matches!(step, Step::Leg(_)));
                discharge.map_or(0, |index| index + 1)
            }
            _ => moves.last().map_or(0, |(index, _)| index + 1),
        };
        Ok(ResumeDecision {
            repeated_reset: None,
            open: Some((number, from)),
        })
    }
}

/// Returns the last SOC reset of the same cell before a stage.
fn last_reset(plan: &Plan, before: usize, stage: &Stage) -> Option<usize> {
    let same = |candidate: &Stage| {
        candidate.purpose == Purpose::SocReset && candidate.specimen() == stage.specimen()
    };
    (0..before)
        .rev()
        .find(|index| plan.stages.get(*index).is_some_and(same))
}

/// Returns a first entry, for tests.
#[cfg(test)]
pub fn test_started() -> Entry {
    Entry::Started(Box::new(Started {
        version: "0".to_owned(),
        experiment: "x".to_owned(),
        seed: 1,
        time: "real".to_owned(),
        inherited: false,
        files: Vec::new(),
        plan: Vec::new(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_plan::{test_settings, test_trace};
    use bench_plan::plan::{Flow, Leg, Log};
    use instruments::units::{Amps, Coulombs, Hertz, Ohms, Volts};
    use instruments::{fixture::Fixture, supply4q::Holds};

    const DISCHARGE: Step = Step::Discharge {
        current_a: Amps(5.0),
        until_v: Volts(3.5),
        max_s: Seconds(60.0),
    };
    const CHARGE: Step = Step::Charge {
        current_a: Amps(3.0),
        limit_v: Volts(4.2),
        until_v: Volts(3.8),
        max_s: Seconds(60.0),
    };
    const REST: Step = Step::Rest {
        min_s: Seconds(1.0),
        max_s: Seconds(2.0),
        slope_v_per_s: 1.0e-6,
    };
    const UP: Step = Step::PowerUp {
        compliance_v: Volts(4.5),
        limit_a: Amps(2.0),
        held: Holds::CurrentAndVoltage,
        idle_a: Amps(0.2),
        depth: None,
    };

    fn sine(index: usize) -> Step {
        Step::Sine {
            index,
            freq_hz: Hertz(1.0),
            amplitude_a: Amps(1.0),
            wait_s: Seconds(12.0),
            settings: test_settings(),
        }
    }

    fn stage(purpose: Purpose, steps: Vec<Step>) -> Stage {
        Stage {
            purpose,
            steps: [vec![Step::Mount(Fixture::Cell)], steps].concat(),
        }
    }

    /// Stage 0 resets, 1 sweeps, 2 is a trace; with `reset` false the first is a wait.
    fn plan(reset: bool) -> Plan {
        let first = if reset {
            stage(Purpose::SocReset, vec![DISCHARGE, CHARGE, REST])
        } else {
            stage(Purpose::Temperature, vec![REST])
        };
        let trace = std::sync::Arc::new(test_trace());
        let steps = vec![
            Step::Zero(trace.clone()),
            UP,
            Step::Trace(trace),
            Step::PowerDown,
        ];
        Plan {
            stages: vec![
                first,
                stage(
                    Purpose::Sweep(Fixture::Cell, 1),
                    vec![UP, sine(0), sine(1), Step::PowerDown],
                ),
                stage(Purpose::Trace, steps),
            ],
        }
    }

    /// Replays a journal in short form: `S1` a stage, `i2` a step begun, `d2` done, `F` the stage
    /// is finished.
    fn replay(text: &str) -> JournalReplay {
        let (mut stage, mut lines) = (0, vec![test_started()]);
        for word in text.split_whitespace() {
            let number = word[1..].parse().unwrap_or(0);
            lines.push(match &word[..1] {
                "S" => {
                    stage = number;
                    Entry::Stage { stage }
                }
                "i" => Entry::Intent {
                    stage,
                    step: number,
                    text: String::new(),
                    live: true,
                },
                "d" => Entry::Done {
                    stage,
                    step: number,
                },
                // The reset is stage 0 in all plans here.
                "u" => Entry::ChargeUnknown {
                    reset: 0,
                    open: number,
                },
                _ => Entry::StageDone { stage },
            });
        }
        let line = |(index, entry): (usize, Entry)| Line {
            number: index as u64 + 1,
            time_s: Seconds(index as f64),
            entry,
        };
        JournalReplay::of(&lines.into_iter().enumerate().map(line).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn every_crash_has_its_place_to_go_on() {
        let go = |repeated_reset, open| {
            Ok(ResumeDecision {
                repeated_reset,
                open,
            })
        };
        for (text, expected) in [
            ("", go(None, None)),
            ("S0 i0", go(None, Some((0, 0)))),
            // A reset is absolute: it is executed from its beginning, unless only the rest
            // remains.
            ("S0 i0 d0 i1", go(None, Some((0, 0)))),
            ("S0 i0 d0 i1 d1 i2", go(None, Some((0, 0)))),
            ("S0 i0 d0 i1 d1 i2 d2", go(None, Some((0, 3)))),
            ("S0 i0 d0 i1 d1 i2 d2 i3", go(None, Some((0, 3)))),
            ("S0 i0 d0 F", go(None, None)),
            ("S0 F S1 i0 d0 i1 d1 i2", go(None, Some((1, 0)))),
            // A trace that has not begun is executed; one that was interrupted moved an unknown
            // charge; one that is done stays done.
            ("S0 F S1 F S2 i0 d0 i1 d1 i2", go(None, Some((2, 0)))),
            (
                "S0 F S1 F S2 i0 d0 i1 d1 i2 d2 i3",
                go(Some(0), Some((2, 0))),
            ),
            (
                "S0 F S1 F S2 i0 d0 i1 d1 i2 d2 i3 d3 i4",
                go(None, Some((2, 4))),
            ),
            // The reset was being repeated when the next crash happened: the trace still waits.
            ("S0 F S1 F S2 i3 S0 i0 d0 i1", go(None, Some((0, 0)))),
            ("S0 F S1 F S2 F", go(None, None)),
        ] {
            assert_eq!(
                replay(text).next(&plan(true), |_| false, false),
                expected,
                "{text}"
            );
        }
    }

    #[test]
    fn without_a_reset_an_unknown_charge_stops_the_run_and_says_what_to_do() {
        let crashed = replay("S0 F S1 F S2 i0 d0 i1 d1 i2 d2 i3");
        let message = crashed
            .next(&plan(false), |_| false, false)
            .unwrap_err()
            .to_string();
        assert!(
            message.starts_with("stage 3, step 4 (trace t, repeat 1: ")
                && message.contains("--accept-charge"),
            "{message}"
        );
        assert_eq!(
            crashed.next(&plan(false), |_| false, true),
            Ok(ResumeDecision {
                repeated_reset: None,
                open: Some((2, 0))
            })
        );
        // Its file is in the index: only the end was not recorded.
        let recorded = |step: &Step| matches!(step, Step::Trace(_));
        assert_eq!(
            crashed.next(&plan(false), recorded, false),
            Ok(ResumeDecision {
                repeated_reset: None,
                open: Some((2, 4))
            })
        );
    }

    #[test]
    fn a_crash_under_a_direct_current_repeats_the_sweep_after_a_reset_or_stops() {
        let bias = |from_a, to_a| {
            Step::Bias(bench_plan::plan::Bias {
                from_a,
                to_a,
                settle_s: Seconds(30.0),
                amplitude_a: Amps(1.0),
                resistance_ohm: Ohms(0.03),
                most_coulomb: Coulombs(810.0),
                capacity_coulomb: Coulombs(16_200.0),
            })
        };
        let back = Step::Recharge(bench_plan::plan::Recharge {
            current_a: Amps(-2.0),
            charge_coulomb: Coulombs(100.0),
            within_coulomb: Coulombs(8.0),
            max_s: Seconds(200.0),
        });
        // 1 power up, 2 ramp up, 3 and 4 points, 5 ramp down, 6 recharge, 7 power down.
        let sweep = vec![
            UP,
            bias(Amps(0.0), Amps(2.0)),
            sine(0),
            sine(1),
            bias(Amps(2.0), Amps(0.0)),
            back,
            Step::PowerDown,
        ];
        let stages = |reset: bool| Plan {
            stages: vec![
                plan(reset).stages[0].clone(),
                stage(Purpose::Sweep(Fixture::Cell, 1), sweep.clone()),
            ],
        };
        let begun = "S0 F S1 i0 d0 i1 d1";
        for (text, reset, from) in [
            ("", false, 0),
            (" i2", true, 0),
            (" i2 d2", true, 0),
            (" i2 d2 i3 d3 i4", true, 0),
            (" i2 d2 i3 d3 i4 d4 i5 d5", true, 0),
            (" i2 d2 i3 d3 i4 d4 i5 d5 i6", true, 0),
            // The charge is back.
            (" i2 d2 i3 d3 i4 d4 i5 d5 i6 d6 i7", false, 7),
        ] {
            let replay = replay(&format!("{begun}{text}"));
            assert_eq!(
                replay.next(&stages(true), |_| false, false),
                Ok(ResumeDecision {
                    repeated_reset: reset.then_some(0),
                    open: Some((1, from)),
                }),
                "{text}"
            );
            let without = replay.next(&stages(false), |_| false, false);
            assert_eq!(without.is_err(), reset, "{text}");
        }
        let message = replay(&format!("{begun} i2 d2 i3"))
            .next(&stages(false), |_| false, false)
            .unwrap_err()
            .to_string();
        assert!(
            message.starts_with("stage 2, step 3 (ramp the direct current to +2 A"),
            "{message}"
        );
    }

    #[test]
    fn a_crash_in_a_counted_discharge_repeats_the_full_charge_and_one_after_it_does_not() {
        let leg = Step::Leg(Leg {
            flow: Flow::DischargeTo {
                current_a: Amps(4.5),
                until_v: Volts(2.55),
                below_full_coulomb: Coulombs(4860.0),
                expected_coulomb: Coulombs(3240.0),
            },
            max_s: Seconds(2220.0),
            log: Log::MapDischarge(2),
        });
        let accept = Step::Accept {
            band_v: (Volts(3.8), Volts(3.9)),
            missed: Some(bench_plan::plan::Missed::Flag),
        };
        let mut plan = plan(true);
        plan.stages[1] = stage(Purpose::MapPoint, vec![leg, REST, accept]);
        for (text, repeated_reset) in [
            ("S0 F S1 i0 d0 i1", Some(0)),
            ("S0 F S1 i0 d0 i1 d1 i2", None),
            ("S0 F S1 i0 d0 i1 d1 i2 d2 i3", None),
        ] {
            assert_eq!(
                replay(text).next(&plan, |_| false, false),
                Ok(ResumeDecision {
                    repeated_reset,
                    open: Some((1, 0))
                }),
                "{text}"
            );
        }
    }

    #[test]
    fn the_charge_stays_unknown_until_the_reset_is_done() {
        let plan = plan(true);
        let crashed = "S0 i0 d0 F S1 i0 d0 i1";
        for (text, repeated_reset) in [
            // Killed before the reset began, in another stage that was played first, and in it.
            (" u1", Some(0)),
            (" u1 S2 i0", Some(0)),
            (" u1 S2 i0 d0 F S0 i0 d0 i1", Some(0)),
            // The reset is done; the interrupted stage begins again.
            (" u1 S2 i0 d0 F S0 i0 d0 i1 d1 F S1 i0", None),
        ] {
            let replay = replay(&format!("{crashed}{text}"));
            let next = replay.next(&plan, |_| false, false).unwrap();
            assert_eq!(next.repeated_reset, repeated_reset, "{text}");
            assert_eq!(next.open.map(|open| open.0), Some(1), "{text}");
        }
    }

    #[test]
    fn a_journal_without_a_beginning_is_none() {
        let message = JournalReplay::of(&[]).unwrap_err().to_string();
        assert_eq!(
            message,
            "expected a journal that begins with what runs, found nothing"
        );
    }
}
