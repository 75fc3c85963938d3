//! The tasks of the watch: one loop for each meter, one for settings, one for ages. The first
//! alarm ends all of them.

use std::{
    cell::{Cell, RefCell},
    future::pending,
    sync::{Arc, atomic::Ordering},
};

use instruments::{
    clock::{Clock, TimeMode},
    instrument::Measured,
    link::LinkError,
    logger::Logger,
    units::Seconds,
};
use tokio::sync::watch;

use super::{
    alarm::Alarm,
    envelope::Envelope,
    judge::{Judge, Judgement},
    pace::Pace,
    shared::{Shared, locked},
};
use crate::{
    bench::{Bench, Driven, Instruments, SafeReport},
    clock::TypedClock,
};
use bench_plan::interlock::{Drive, Trip};

/// Number of ticks in a period: the time resolution with which readings of the procedure are
/// detected.
const TICKS: f64 = 5.0;
/// Least period on the machine's clock, s: scaled time must not flood the ports.
const LEAST_PERIOD_S: Seconds = Seconds(0.05);
/// Time between two scans of the thermometers, s.
const TEMPERATURE_S: Seconds = Seconds(5.0);
/// Time after which a drive that no step uses and that is not read is remarked, s.
const UNREAD_S: Seconds = Seconds(5.0);
/// Pause before an unreachable instrument is tried again, s.
const REACH_AGAIN_S: Seconds = Seconds(0.5);
/// Longest search for the setting that explains a trip, s.
const CAUSE: std::time::Duration = std::time::Duration::from_millis(300);
/// The instruments whose settings are compared, in turn. The generator has no meter and is queried
/// twice as often as any other.
const TURNS: [&str; 8] = [
    "generator",
    "supply4q",
    "generator",
    "load",
    "generator",
    "supply",
    "generator",
    "chiller",
];

/// State that the loops of one watch share.
pub(super) struct Rounds {
    pub(super) bench: Bench,
    pub(super) shared: Arc<Shared>,
    pub(super) clock: Clock,
    pub(super) pace: Pace,
}

impl Rounds {
    /// Watches until an alarm or until it is stopped. After an alarm everything is switched off
    /// before this returns.
    pub(super) async fn keep(
        mut self,
        found: watch::Sender<Option<Alarm>>,
        mut stopped: watch::Receiver<bool>,
    ) -> (Bench, Option<SafeReport>) {
        let alarm = tokio::select! {
            alarm = self.alarm() => alarm,
            _ = stopped.wait_for(|stopped| *stopped) => return (self.bench, None),
        };
        tracing::warn!("the watch: {alarm}");
        self.bench.take_over();
        found.send_replace(Some(alarm));
        let report = self.bench.patient_safe_state().await;
        (self.bench, Some(report))
    }

    async fn alarm(&mut self) -> Alarm {
        let (mut settings, mut causes) =
            (self.bench.share(&self.clock), self.bench.share(&self.clock));
        let Instruments {
            supply4q,
            load,
            supply,
            logger,
            ..
        } = &mut self.bench.instruments;
        let watched = Watched::new(
            &self.shared,
            &self.clock,
            self.pace,
            [supply4q.is_some(), load.is_some(), supply.is_some()],
        );
        let alarm = tokio::select! {
            alarm = watched.follow(Drive::Supply4q, supply4q.as_mut()) => alarm,
            alarm = watched.follow(Drive::Load, load.as_mut()) => alarm,
            alarm = watched.follow(Drive::Supply, supply.as_mut()) => alarm,
            alarm = watched.follow_temperature(logger.as_mut()) => alarm,
            alarm = watched.compare_settings(&mut settings) => alarm,
            alarm = watched.judge_ages() => alarm,
        };
        match alarm {
            Alarm::Trip(trip) => Alarm::Trip(trip.because(watched.find_cause(&mut causes).await)),
            other => other,
        }
    }
}

/// The next reading of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Next {
    /// Whatever the procedure has read, or a query of the drive when it is due.
    Usual,
    /// Voltage and current, immediately.
    Volts,
    /// The current, immediately.
    Amps,
}

/// State of the reading of one drive.
#[derive(Debug, Default)]
struct DriveState {
    /// Whether the bench has the drive.
    present: bool,
    /// Time since its last reading, s; time in which the watch could not run does not count.
    age_s: Cell<Seconds>,
    /// Whether the drive was read, and its answers are not later than the bound of the watch
    /// allows.
    in_time: Cell<bool>,
    /// The last error of its link.
    trouble: RefCell<String>,
}

/// State of the loops; they run on one thread.
struct Watched<'a> {
    shared: &'a Shared,
    clock: &'a Clock,
    pace: Pace,
    /// Machine seconds per bench second.
    machine_per_bench: f64,
    drives: [DriveState; 3],
    /// Age of the cell's temperature, s; `None` without a logger.
    temperature_age_s: Cell<Option<Seconds>>,
}

impl<'a> Watched<'a> {
    fn new(shared: &'a Shared, clock: &'a Clock, pace: Pace, present: [bool; 3]) -> Self {
        let drives = present.map(|present| DriveState {
            present,
            ..DriveState::default()
        });
        let machine_per_bench = match clock.mode() {
            TimeMode::Scaled(factor) => 1.0 / factor,
            TimeMode::Real | TimeMode::Virtual => 1.0,
        };
        Self {
            shared,
            clock,
            pace,
            machine_per_bench,
            drives,
            temperature_age_s: Cell::new(None),
        }
    }

    /// Returns the period of the readings on the machine's clock, s.
    fn period_s(&self) -> Seconds {
        (self.pace.period_s() * self.machine_per_bench).max(LEAST_PERIOD_S)
    }

    /// Sleeps for a time in machine seconds.
    async fn sleep_s(&self, machine_s: Seconds) {
        self.clock
            .sleep_for(machine_s / self.machine_per_bench)
            .await;
    }

    async fn tick(&self) {
        self.sleep_s(self.period_s() / TICKS).await;
    }

    fn envelope(&self, asked_s: Seconds) -> Envelope {
        locked(&self.shared.force).at(asked_s).allowed
    }

    fn reads_cell(&self, drive: Drive) -> bool {
        drive.reads_cell(self.drives[Drive::Load as usize].present)
    }

    /// Judges each reading of a drive, whether the procedure or the watch requested it. Queries
    /// the drive when the procedure does not.
    async fn follow<D: Driven>(&self, drive: Drive, meter: Option<&mut D>) -> Alarm {
        let Some(meter) = meter else {
            return pending().await;
        };
        let mut judge = Judge::new(drive, self.reads_cell(drive));
        let first = if self.shared.waits {
            Next::Amps
        } else {
            Next::Volts
        };
        let (mut judged_s, mut next) = (None, first);
        loop {
            let (answer_s, late_s) = (meter.answer_time_s(), self.pace.late_s(drive));
            let envelope = self.envelope(self.clock.machine());
            if answer_s > late_s && self.is_needed(drive, &envelope) {
                return Alarm::Slow {
                    role: drive.role(),
                    answer_s,
                    limit_s: late_s,
                };
            }
            let theirs = meter.last_measured().filter(|reading| {
                judged_s.is_none_or(|judged_s| Seconds(reading.answered_s) > judged_s)
            });
            let age_s = judged_s.map_or(Seconds::INFINITY, |judged_s| {
                self.clock.machine() - judged_s
            });
            let (reading, own) = match (theirs, next) {
                (Some(reading), Next::Usual) => (reading, false),
                (None, Next::Usual) if age_s < self.period_s() => {
                    self.tick().await;
                    continue;
                }
                _ => match self.read(drive, meter, next).await {
                    Some(reading) => (reading, true),
                    None => continue,
                },
            };
            self.count(drive, &reading, judged_s, own);
            let state = &self.drives[drive as usize];
            state.in_time.set(meter.answer_time_s() <= late_s);
            judged_s = Some(Seconds(reading.answered_s));
            let envelopes = locked(&self.shared.force).at(Seconds(reading.asked_s));
            match judge.judge(&reading, &envelopes, self.clock.now()) {
                Judgement::Within => next = Next::Usual,
                // A repeated reading would come too late, and no current should flow.
                Judgement::AskAgain { trip, .. }
                    if !self.shared.waits
                        && meter.answer_time_s() > late_s
                        && !envelopes.allowed.uses(drive) =>
                {
                    return Alarm::Trip(trip);
                }
                Judgement::AskAgain { volts, .. } => {
                    next = if volts { Next::Volts } else { Next::Amps };
                    if self.shared.waits {
                        self.end_stray_current(drive, meter, &reading).await;
                    }
                }
                Judgement::Beyond(trip) => return Alarm::Trip(trip),
            }
        }
    }

    /// Switches off a drive that shows a current while nothing may flow, and remarks it.
    async fn end_stray_current<D: Driven>(&self, drive: Drive, meter: &mut D, reading: &Measured) {
        let off = match meter.off().await {
            Ok(()) => "it was switched off".to_owned(),
            Err(error) => format!("switching it off failed: {error}"),
        };
        let remark = format!(
            "while the run waited, the {} was {:.2} A at {:.0} s, where nothing may flow; {off}",
            drive.current(),
            reading.amps.value(),
            self.clock.now().0
        );
        tracing::warn!("the watch: {remark}");
        locked(&self.shared.log).remarks.push(remark);
    }

    /// Reads a drive. If the link fails, reconnects and identifies the instrument.
    async fn read<D: Driven>(&self, drive: Drive, meter: &mut D, next: Next) -> Option<Measured> {
        // The voltage of the cell is queried with every second reading.
        let volts = match next {
            Next::Usual => {
                self.reads_cell(drive)
                    && meter
                        .last_measured()
                        .is_none_or(|last| last.volts.is_none())
            }
            Next::Volts => true,
            Next::Amps => false,
        };
        let read = if volts {
            meter.read().await.map(|_| ())
        } else {
            meter.read_current().await.map(|_| ())
        };
        match read {
            Ok(()) => meter.last_measured(),
            Err(error) => {
                self.drives[drive as usize]
                    .trouble
                    .replace(error.to_string());
                if meter.is_dropped()
                    && let Err(error) = self.reconnect(meter).await
                {
                    self.drives[drive as usize]
                        .trouble
                        .replace(error.to_string());
                    self.sleep_s(REACH_AGAIN_S).await;
                }
                None
            }
        }
    }

    /// Reconnects and identifies the instrument. During a wait the instrument is switched off
    /// first: with late answers, reading its identity and its current takes seconds.
    async fn reconnect<D: Driven>(&self, meter: &mut D) -> Result<(), LinkError> {
        meter.renew().await;
        if self.shared.waits {
            meter.off().await?;
        }
        meter.identify_same().await
    }

    fn count(&self, drive: Drive, reading: &Measured, judged_s: Option<Seconds>, own: bool) {
        self.drives[drive as usize].age_s.set(Seconds::ZERO);
        locked(&self.shared.log).count(
            drive,
            judged_s.map(|judged_s| Seconds(reading.answered_s) - judged_s),
            Seconds(reading.answered_s - reading.asked_s),
            own,
        );
    }

    /// Judges the cell's temperature, whether the procedure or the watch requested it.
    async fn follow_temperature(&self, logger: Option<&mut Logger>) -> Alarm {
        let Some(logger) = logger else {
            return pending().await;
        };
        self.temperature_age_s.set(Some(Seconds::ZERO));
        let (mut judged_s, mut beyond, mut ready) = (f64::NEG_INFINITY, false, false);
        loop {
            self.tick().await;
            let due = self.clock.machine() - Seconds(judged_s) > TEMPERATURE_S;
            if logger
                .last_scan()
                .is_none_or(|scan| scan.answered_s <= judged_s)
            {
                if !due && !beyond {
                    continue;
                }
                if !ready {
                    ready = logger.configure().await.is_ok();
                }
                if logger.scan().await.is_err() {
                    // The procedure's next reading, or the age of the temperature, ends the run.
                    self.sleep_s(TEMPERATURE_S).await;
                    continue;
                }
            }
            let Some(scan) = logger.last_scan() else {
                continue;
            };
            judged_s = scan.answered_s;
            self.temperature_age_s.set(Some(Seconds::ZERO));
            let Some(degc) = scan.cell else {
                continue;
            };
            let (least, greatest) = self.envelope(Seconds(judged_s)).degc();
            if (least..=greatest).contains(&degc) {
                beyond = false;
            } else if std::mem::replace(&mut beyond, true) {
                let (allowed, now_s) = (least..=greatest, self.clock.now());
                return Alarm::Trip(Trip::limit("cell temperature", degc, &allowed, now_s));
            }
        }
    }

    /// Queries the instruments in turn whether a setting is still as this run made it.
    async fn compare_settings(&self, bench: &mut Bench) -> Alarm {
        for turn in 0_usize.. {
            self.sleep_s(self.period_s() / 2.0).await;
            let role = TURNS[turn % TURNS.len()];
            if let Ok(Some(met)) = bench.differs_one(role, turn / TURNS.len()).await {
                return Alarm::Meddled { role, met };
            }
        }
        pending().await
    }

    /// Returns the setting that explains a trip, if the instruments answer immediately.
    async fn find_cause(&self, bench: &mut Bench) -> Option<String> {
        let asked = async {
            for role in ["generator", "supply4q", "load", "supply", "chiller"] {
                if let Ok(Some(met)) = bench.differs(role).await {
                    return Some(Alarm::Meddled { role, met }.to_string());
                }
            }
            None
        };
        self.clock.deadline(CAUSE, asked).await.ok().flatten()
    }

    /// Judges the time without a reading. Time in which the machine did not run the watch does not
    /// count: the guardian's lease bounds it.
    async fn judge_ages(&self) -> Alarm {
        let mut last_s = self.clock.machine();
        let mut remarked = [false; 3];
        loop {
            self.tick().await;
            let now_s = self.clock.machine();
            let passed_s = (now_s - last_s).min(2.0 * self.period_s() / TICKS);
            last_s = now_s;
            let envelope = self.envelope(now_s);
            let sees = self.sees_every_drive();
            self.shared.sees_every_drive.store(sees, Ordering::Relaxed);
            for drive in Drive::ALL {
                let at = drive as usize;
                let state = &self.drives[at];
                if !state.present {
                    continue;
                }
                let age_s = state.age_s.get() + passed_s;
                state.age_s.set(age_s);
                let limit_s = self.pace.blind_s(drive);
                if self.is_needed(drive, &envelope) && age_s > limit_s {
                    return Alarm::Blind {
                        role: drive.role(),
                        age_s,
                        limit_s,
                        why: state.trouble.borrow().clone(),
                    };
                }
                self.remark(drive, age_s, &mut remarked[at]);
            }
            if let Some(trip) = self.judge_temperature_age(passed_s, &envelope) {
                return Alarm::Trip(trip);
            }
        }
    }

    /// Checks whether a current may flow that nothing but this meter watches. For an analog supply
    /// that is the voltmeter of the load.
    fn is_needed(&self, drive: Drive, envelope: &Envelope) -> bool {
        let is_analog = !self.drives[Drive::Supply4q as usize].present;
        envelope.uses(drive)
            || (drive == Drive::Load && is_analog && envelope.uses(Drive::Supply4q))
    }

    fn sees_every_drive(&self) -> bool {
        Drive::ALL
            .into_iter()
            .filter(|drive| self.drives[*drive as usize].present)
            .all(|drive| {
                let state = &self.drives[drive as usize];
                state.in_time.get() && state.age_s.get() <= self.pace.blind_s(drive)
            })
    }

    /// Returns a trip if the temperature of the cell is too old while a current may flow.
    fn judge_temperature_age(&self, passed_s: Seconds, envelope: &Envelope) -> Option<Trip> {
        let age_s = self.temperature_age_s.get()? + passed_s;
        self.temperature_age_s.set(Some(age_s));
        let greatest = self.pace.temperature_age_s;
        let what = "time without a cell temperature";
        envelope
            .is_live()
            .then(|| Trip::above(what, age_s, greatest, self.clock.now()))
            .flatten()
    }

    /// Remarks a drive that no step uses and that does not answer.
    fn remark(&self, drive: Drive, age_s: Seconds, remarked: &mut bool) {
        if age_s < UNREAD_S {
            *remarked = false;
        } else if !std::mem::replace(remarked, true) {
            let text = format!(
                "the {} was not read for more than {UNREAD_S} from {:.0} s on: {}",
                drive.current(),
                (self.clock.now() - age_s / self.machine_per_bench).0,
                self.drives[drive as usize].trouble.borrow()
            );
            tracing::warn!("the watch: {text}");
            locked(&self.shared.log).remarks.push(text);
        }
    }
}
