//! Safe state: switches off everything that can move charge, in an order that cannot harm the
//! cell, and reads it back. An output that does not go off is brought to zero by the fallback
//! methods that its dialect declares.

use std::{collections::BTreeMap, future::pending, time::Duration};

use instruments::{
    chiller::Chiller,
    clock::Clock,
    exchange::Way,
    generator::Generator,
    instrument::Measured,
    link::LinkError,
    load::Load,
    supply::Supply,
    supply4q::Supply4q,
    units::{Amps, Seconds, Volts},
};

use super::{
    Bench, Command,
    error::{BenchError, wrap},
    output::{LEAST_SINE, Output, SafeReport, UNSWITCHED, Unsafe, ZERO_COMMAND},
    roles::{Instruments, fresh},
};
use bench_plan::interlock::{Drive, NO_CURRENT_A};

use crate::clock::TypedClock;

/// Number of retries of the safe state, and the pause before each, s.
const SAFE_RETRIES: usize = 5;
const SAFE_PAUSE_S: Seconds = Seconds(1.0);
/// How long outputs that do not answer are retried, s: a network outage that ends within this time
/// does not end a run. An output that answers and is not off is faulty, not late.
const OUTAGE_S: Seconds = Seconds(30.0);
/// Pause between two of these attempts.
const OUTAGE_PAUSE: Duration = Duration::from_secs(1);
/// How often relays are opened again if everything else is off.
const BATH_RETRIES: usize = 1;
/// Time after which no current may flow, s. Two successive readings without current, this far
/// apart, count as no current.
const SAFE_SETTLE_S: Seconds = Seconds(0.5);
/// Settling time after a repeated shutdown, s: a meter that shows two values per second shows the
/// new value within it.
const SAFE_SETTLE_AGAIN_S: Seconds = Seconds(1.0);
const SAFE_AGAIN_S: Seconds = Seconds(0.1);
/// Longest wait for the generator's least sine before the supply is switched off. Its first
/// message arrives within this time; a slow generator's read-backs are not waited for.
const QUIET_DEADLINE: Duration = Duration::from_millis(700);

/// An instrument that can move charge and measures its own current.
pub(crate) trait Driven {
    async fn off(&mut self) -> Result<(), LinkError>;
    async fn read(&mut self) -> Result<(Volts, Amps), LinkError>;
    async fn read_current(&mut self) -> Result<Amps, LinkError>;
    fn ways(&self) -> Vec<Way>;
    async fn go_way(&mut self, way: &Way) -> Result<(), LinkError>;
    async fn read_bounds(&mut self) -> Vec<String>;
    fn rating_a(&self) -> Amps;
    async fn renew(&mut self);
    async fn in_step(&mut self) -> Result<(), LinkError>;
    async fn identify_same(&mut self) -> Result<(), LinkError>;
    fn is_dropped(&mut self) -> bool;
    fn answer_time_s(&mut self) -> Seconds;
    fn last_measured(&self) -> Option<Measured>;
}

macro_rules! drives {
    ($($kind:ty, $rating:ident;)+) => { $(
        impl Driven for $kind {
            async fn off(&mut self) -> Result<(), LinkError> {
                self.safe().await
            }

            async fn read(&mut self) -> Result<(Volts, Amps), LinkError> {
                self.measure().await
            }

            async fn read_current(&mut self) -> Result<Amps, LinkError> {
                self.measure_current().await
            }

            fn ways(&self) -> Vec<Way> {
                self.zero()
            }

            async fn go_way(&mut self, way: &Way) -> Result<(), LinkError> {
                self.go(way).await
            }

            async fn read_bounds(&mut self) -> Vec<String> {
                self.bounds().await
            }

            fn rating_a(&self) -> Amps {
                self.capabilities().$rating
            }

            async fn renew(&mut self) {
                fresh(self).await;
            }

            async fn in_step(&mut self) -> Result<(), LinkError> {
                self.reconnect_and_identify().await
            }

            async fn identify_same(&mut self) -> Result<(), LinkError> {
                self.identify_same().await
            }

            fn is_dropped(&mut self) -> bool {
                self.link_mut().is_dropped()
            }

            fn answer_time_s(&mut self) -> Seconds {
                Seconds(self.link_mut().answer_time_s())
            }

            fn last_measured(&self) -> Option<Measured> {
                self.last_measured()
            }
        }
    )+ };
}
drives! {
    Supply4q, full_scale;
    Load, max_current;
    Supply, max_current;
}

/// Result of the shutdown as the instrument reports it, and the fallback method that was used, if
/// any.
type Ended = (Result<(), LinkError>, Option<&'static str>);

impl Bench {
    /// Switches off everything that can move charge, and the relays of a bath without its own
    /// control loop, and verifies it: each output is read back, and no current may flow after 1.5
    /// s.
    ///
    /// First the generator is set to its least sine, which ends the current at once. Its output is
    /// switched off only when the supply's output is known to be off, because without its offset
    /// the supply's zero error would flow; or when the generator does not accept the least sine.
    /// Load and charger are switched off concurrently, so that neither waits for one that does not
    /// answer. An output that does not go off, or still carries a current, is brought to zero by
    /// the fallback methods of its dialect. An instrument that fails is retried for a while on a
    /// new connection, because the shutdown is idempotent. An instrument that once reported a
    /// wrong state is not trusted again.
    pub async fn safe_state(&mut self) -> SafeReport {
        self.safe_state_within(Seconds::ZERO).await
    }

    /// As [`Self::safe_state`], for use during a run: outputs that do not answer are retried for
    /// 30 s, so that a short outage of the network does not raise an alarm.
    pub async fn patient_safe_state(&mut self) -> SafeReport {
        self.safe_state_within(OUTAGE_S).await
    }

    async fn safe_state_within(&mut self, outage_s: Seconds) -> SafeReport {
        let report = self.switch_off(outage_s).await;
        self.last_safe = Some(report.clone());
        report
    }

    async fn switch_off(&mut self, outage_s: Seconds) -> SafeReport {
        let began_s = self.clock.machine();
        let mut report = SafeReport::default();
        for attempt in 0.. {
            let waits = report.is_silent() && self.clock.machine() - began_s < outage_s;
            if attempt > SAFE_RETRIES && !waits {
                break;
            }
            if attempt > SAFE_RETRIES {
                // A real network does not recover faster in scaled time.
                let _ = self.clock.deadline(OUTAGE_PAUSE, pending::<()>()).await;
            } else if attempt > 0 {
                self.clock.sleep_for(SAFE_PAUSE_S).await;
            }
            let mut outputs = self.try_safe().await;
            remember(&mut self.lied, &mut outputs);
            report = SafeReport::of(&self.name, outputs);
            // Everything that moves charge is off: an unreachable bath must not delay this report.
            if report.verified || (report.drives_verified() && attempt >= BATH_RETRIES) {
                return report;
            }
            tracing::info!(
                "switching off, attempt {}: {}; {}",
                attempt + 1,
                report.message,
                report.troubles()
            );
        }
        report
    }

    /// As [`Self::patient_safe_state`], but returns an error if anything could not be verified.
    ///
    /// # Errors
    /// [`Unsafe`].
    pub async fn made_safe(&mut self) -> Result<(), Unsafe> {
        self.patient_safe_state().await.proven().map(|_| ())
    }

    /// Switches every output off again and reads it back, before a relay or a person changes what
    /// is in the jig. An output that another client has switched on since the safe state shows no
    /// current as long as nothing in the jig drives one.
    ///
    /// # Errors
    /// Fails at the first output that could not be read back as off.
    pub async fn off_again(&mut self) -> Result<(), BenchError> {
        let clock = self.clock.clone();
        let driven = off(
            &mut self.instruments.generator,
            &mut self.instruments.supply4q,
            &clock,
            self.command,
        );
        let ((supply4q, generator, _), load, supply) = tokio::join!(
            driven,
            end(&mut self.instruments.load, &clock),
            end(&mut self.instruments.supply, &clock)
        );
        for (role, ended) in [
            ("supply4q", supply4q.0),
            ("generator", generator),
            ("load", load.0),
            ("supply", supply.0),
        ] {
            ended.map_err(|source| wrap(role, self.model(role), source))?;
        }
        Ok(())
    }

    /// Switches off everything that drives the cell through the bipolar supply, once, in the order
    /// of [`Self::safe_state`]. Load and charger stay as they are.
    ///
    /// # Errors
    /// Fails at the first output that could not be read back as off.
    pub async fn drive_off(&mut self) -> Result<(), BenchError> {
        let ((supply4q, _), generator, _) = off(
            &mut self.instruments.generator,
            &mut self.instruments.supply4q,
            &self.clock,
            self.command,
        )
        .await;
        supply4q.map_err(|source| wrap("supply4q", self.model("supply4q"), source))?;
        generator.map_err(|source| wrap("generator", self.model("generator"), source))
    }

    /// Reads voltage, V, and current, A, of each instrument that can move charge. A generator has
    /// no meter.
    pub async fn read_back(&mut self) -> Vec<(&'static str, Result<(Volts, Amps), BenchError>)> {
        let mut found = Vec::new();
        macro_rules! read {
            ($role:literal, $field:ident) => {
                if let Some(instrument) = self.instruments.$field.as_mut() {
                    let read = instrument.read().await;
                    found.push((
                        $role,
                        read.map_err(|source| wrap($role, self.model($role), source)),
                    ));
                }
            };
        }
        read!("supply4q", supply4q);
        read!("load", load);
        read!("supply", supply);
        found
    }

    /// Reads voltage, V, and current, A, by a drive's own meter.
    ///
    /// # Errors
    /// [`BenchError::Missing`] if the bench lacks the drive; otherwise the error of the link.
    pub async fn read(
        &mut self,
        drive: Drive,
    ) -> Result<Result<(Volts, Amps), LinkError>, BenchError> {
        macro_rules! read {
            ($field:ident) => {
                match self.instruments.$field.as_mut() {
                    Some(instrument) => Ok(instrument.read().await),
                    None => Err(BenchError::Missing { role: drive.role() }),
                }
            };
        }
        match drive {
            Drive::Supply4q => read!(supply4q),
            Drive::Load => read!(load),
            Drive::Supply => read!(supply),
        }
    }

    async fn try_safe(&mut self) -> Vec<Output> {
        let (clock, command) = (self.clock.clone(), self.command);
        let Instruments {
            generator,
            supply4q,
            load,
            supply,
            chiller,
            ..
        } = &mut self.instruments;
        // Instruments that move charge do not wait for a bath.
        let driven = async {
            let driven = off(generator, supply4q, &clock, command);
            let ((drive, commands, held), loaded, charged) =
                tokio::join!(driven, end(load, &clock), end(supply, &clock));
            let found = tokio::join!(
                found(supply4q, drive, &clock),
                found(load, loaded, &clock),
                found(supply, charged, &clock)
            );
            (found, commands, held)
        };
        let (((supply4q, load, supply), generator, held), relays) = tokio::join!(
            driven,
            open_relays(chiller.as_mut().filter(|chiller| chiller.is_regulated()))
        );
        let plain = |ended: Result<(), LinkError>| Output {
            off: ended.is_ok(),
            trouble: error_message(ended),
            ..Output::default()
        };
        let commands = |ended| match held {
            true => Output {
                by: Some(
                    if command.unswitched {
                        ZERO_COMMAND
                    } else {
                        LEAST_SINE
                    }
                    .to_owned(),
                ),
                ..Output::default()
            },
            false => plain(ended),
        };
        let unswitched = command.unswitched.then(|| Output {
            by: Some(UNSWITCHED.to_owned()),
            ..Output::default()
        });
        let outputs = [
            ("supply4q", supply4q.or(unswitched)),
            (
                "generator",
                self.instruments
                    .generator
                    .is_some()
                    .then(|| commands(generator)),
            ),
            ("load", load),
            ("supply", supply),
            ("chiller", relays),
        ];
        let named = |(role, output): (&str, Option<Output>)| {
            Some(Output {
                role: role.to_owned(),
                model: self.model(role).to_owned(),
                ..output?
            })
        };
        outputs.into_iter().filter_map(named).collect()
    }
}

/// Records instruments that reported a wrong state, which are not trusted again. `lied` maps roles
/// to the method that brought each to zero.
fn remember(lied: &mut BTreeMap<String, String>, outputs: &mut [Output]) {
    for output in outputs {
        if output.lied {
            lied.insert(output.role.clone(), output.by.clone().unwrap_or_default());
        } else if let Some(by) = lied.get(&output.role) {
            (output.lied, output.by) = (true, Some(by.clone()));
        }
    }
}

fn error_message(ended: Result<(), LinkError>) -> Option<String> {
    ended.err().map(|error| error.to_string())
}

/// Switches an output off. If that fails, tries the fallback methods.
async fn end<D: Driven>(drive: &mut Option<D>, clock: &Clock) -> Ended {
    let Some(drive) = drive.as_mut() else {
        return (Ok(()), None);
    };
    drive.renew().await;
    let off = drive.off().await;
    let by = if off.is_err() {
        zero(drive, clock).await
    } else {
        None
    };
    (off, by)
}

/// Checks whether a reading shows a current.
fn flows(amps: Amps) -> bool {
    amps.abs() > NO_CURRENT_A
}

/// Applies the fallback methods to an output that does not go off, one after the other, until no
/// current flows. Returns the name of the method that succeeded.
async fn zero<D: Driven>(drive: &mut D, clock: &Clock) -> Option<&'static str> {
    /// Time after which a meter shows the new current, s.
    const SHOWN_S: Seconds = Seconds(0.3);
    for way in drive.ways() {
        drive.renew().await;
        if let Err(error) = drive.go_way(&way).await {
            tracing::warn!("{}: {error}", way.name);
        }
        // A silent instrument is not queried further: the next attempt follows soon.
        if drive.is_dropped() {
            return None;
        }
        clock.sleep_for(SHOWN_S).await;
        if drive.read().await.is_ok_and(|(_, amps)| !flows(amps)) {
            return Some(way.name);
        }
    }
    None
}

/// Returns the last reading, as soon as two successive readings show no current, or when the
/// settling time has passed.
async fn at_rest<D: Driven>(
    drive: &mut D,
    clock: &Clock,
    within_s: Seconds,
) -> Result<(Volts, Amps), LinkError> {
    let until_s = clock.now() + within_s;
    let mut quiet = 0;
    loop {
        let read = drive.read().await;
        let Ok((_, amps)) = read else { return read };
        quiet = if flows(amps) { 0 } else { quiet + 1 };
        if quiet >= 2 || clock.now() >= until_s {
            return read;
        }
        clock.sleep_for(SAFE_AGAIN_S).await;
    }
}

/// Reads an instrument after it was switched off. Reports what it measures and, if it is not known
/// to be off, what bounds its current.
async fn found<D: Driven>(
    drive: &mut Option<D>,
    (mut off, mut by): Ended,
    clock: &Clock,
) -> Option<Output> {
    let drive = drive.as_mut()?;
    let mut read = at_rest(drive, clock, SAFE_SETTLE_S).await;
    let (mut lied, mut out_of_step) = (false, false);
    if by.is_none() && off.is_ok() && read.as_ref().is_ok_and(|(_, amps)| flows(*amps)) {
        // Another client may have switched the output on since it was reported as off.
        off = drive.off().await;
        read = at_rest(drive, clock, SAFE_SETTLE_AGAIN_S).await;
    }
    if read.as_ref().is_ok_and(|(_, amps)| flows(*amps)) {
        if by.is_none() {
            // The output is reported as off, but the current contradicts that.
            by = zero(drive, clock).await;
            lied = off.is_ok() && by.is_some();
            read = drive.read().await;
        }
        if read.as_ref().is_ok_and(|(_, amps)| flows(*amps)) {
            // Report a current only if it is the answer to this query.
            let step = drive.in_step().await;
            out_of_step = matches!(step, Err(LinkError::Unexpected { .. }));
            read = match step {
                Ok(()) => drive.read().await,
                Err(error) => Err(error),
            };
        }
    }
    let output = Output {
        off: off.is_ok(),
        lied,
        out_of_step,
        volts: read.as_ref().ok().map(|read| read.0),
        amps: read.as_ref().ok().map(|read| read.1),
        trouble: error_message(off).or_else(|| error_message(read.map(|_| ()))),
        ..Output::default()
    };
    let quiet = output.off && output.amps.is_some_and(|amps| !flows(amps));
    if quiet && by.is_none() {
        return Some(output);
    }
    let mut bounds = if drive.is_dropped() || out_of_step {
        Vec::new()
    } else {
        drive.read_bounds().await
    };
    if bounds.is_empty() {
        bounds.push(format!(
            "nothing but its rating of {} A is known to bound it",
            drive.rating_a().0
        ));
    }
    if drive.ways().is_empty() {
        bounds.push("no other command ends it, because it follows its analog input".to_owned());
    }
    Some(Output {
        by: by.map(str::to_owned),
        bound: Some(bounds.join(", ")),
        ..output
    })
}

/// Opens the relays of a bath without its own control loop. If they are not known to be open,
/// applies the fallback methods of its dialect. A board that refused to open its relays is not
/// trusted when it reports them as open later, but the report mentions it.
async fn open_relays(bath: Option<&mut Chiller>) -> Option<Output> {
    let bath = bath?;
    fresh(bath).await;
    let off = bath.pulse(0.0).await;
    // A silent instrument is not queried further: the next attempt follows soon.
    let silent = bath.link_mut().is_dropped();
    let mut by = None;
    if off.is_err() && !silent {
        for way in bath.zero() {
            fresh(bath).await;
            match bath.go(&way).await {
                Ok(()) => by = by.or_else(|| Some(way.name.to_owned())),
                Err(error) => tracing::warn!("{}: {error}", way.name),
            }
        }
    }
    Some(Output {
        off: off.is_ok(),
        by,
        silent,
        trouble: error_message(off),
        ..Output::default()
    })
}

/// Sets the generator of an analog supply to its zero command and leaves its output as it is:
/// without the offset the zero error of the supply would flow, and nothing may be switched on here.
/// A generator that does not accept the command is switched off, because the zero error is less
/// than an unknown command; the error remains. Returns the result, and whether its output is on.
async fn hold_zero(
    generator: Option<&mut Generator>,
    zero: Volts,
) -> (Result<(), LinkError>, bool) {
    let Some(generator) = generator else {
        return (Ok(()), false);
    };
    fresh(generator).await;
    let outcome = match generator.quiet(zero).await {
        Ok(()) => generator.look().await,
        Err(error) => Err(error),
    };
    match outcome {
        Ok(answers) => (Ok(()), !answers.iter().all(|answer| answer.as_scripted)),
        Err(error) => {
            fresh(generator).await;
            let _ = generator.safe().await;
            (Err(error), false)
        }
    }
}

/// Switches off the bipolar supply and its command in the only safe order: the least sine, the
/// supply with its output open, the generator. Returns the results for supply and generator, and
/// whether the generator was left at its least sine because the supply is not known to be off.
async fn off(
    generator: &mut Option<Generator>,
    supply4q: &mut Option<Supply4q>,
    clock: &Clock,
    command: Command,
) -> (Ended, Result<(), LinkError>, bool) {
    if command.unswitched {
        let (ended, held) = hold_zero(generator.as_mut(), command.zero).await;
        return ((Ok(()), None), ended, held);
    }
    let quiet = match generator.as_mut() {
        // Not worth a long wait, because the supply drives the cell.
        Some(generator) => {
            let quiet = async {
                fresh(generator).await;
                generator.quiet(command.zero).await
            };
            clock
                .deadline(QUIET_DEADLINE, quiet)
                .await
                .is_ok_and(|quiet| quiet.is_ok())
        }
        None => true,
    };
    let supply = end(supply4q, clock).await;
    match generator.as_mut() {
        Some(generator) if supply.0.is_ok() || !quiet => {
            fresh(generator).await;
            let ended = generator.safe().await;
            (supply, ended, false)
        }
        Some(_) => (supply, Ok(()), true),
        None => (supply, Ok(()), false),
    }
}

#[cfg(test)]
mod tests {
    use instruments::clock::TimeMode;

    use super::*;

    /// An output that reports that it is off, but carries a current until its set-point is zero.
    struct Liar {
        amps: Amps,
        in_step: bool,
    }

    impl Driven for Liar {
        async fn off(&mut self) -> Result<(), LinkError> {
            Ok(())
        }

        async fn read(&mut self) -> Result<(Volts, Amps), LinkError> {
            Ok((Volts(3.7), self.amps))
        }

        async fn read_current(&mut self) -> Result<Amps, LinkError> {
            Ok(self.amps)
        }

        fn ways(&self) -> Vec<Way> {
            vec![Way {
                name: "its set-point at 0",
                script: Vec::new(),
            }]
        }

        async fn go_way(&mut self, _: &Way) -> Result<(), LinkError> {
            self.amps = if self.in_step { Amps(0.0) } else { self.amps };
            Ok(())
        }

        async fn read_bounds(&mut self) -> Vec<String> {
            vec!["it is limited to 0 A".to_owned()]
        }

        fn rating_a(&self) -> Amps {
            Amps(30.0)
        }

        async fn renew(&mut self) {}

        async fn in_step(&mut self) -> Result<(), LinkError> {
            if self.in_step {
                Ok(())
            } else {
                Err(LinkError::unexpected(
                    "load",
                    "*IDN?",
                    "3.70",
                    "the identity of a m",
                ))
            }
        }

        async fn identify_same(&mut self) -> Result<(), LinkError> {
            Ok(())
        }

        fn is_dropped(&mut self) -> bool {
            false
        }

        fn answer_time_s(&mut self) -> Seconds {
            Seconds(0.0)
        }

        fn last_measured(&self) -> Option<Measured> {
            None
        }
    }

    fn ended(liar: Liar) -> Output {
        let runtime = Clock::runtime(TimeMode::Virtual).unwrap();
        let output = runtime.block_on(async {
            let clock = Clock::start(TimeMode::Virtual);
            let mut drive = Some(liar);
            let word = end(&mut drive, &clock).await;
            found(&mut drive, word, &clock).await
        });
        Output {
            role: "load".to_owned(),
            model: "m".to_owned(),
            ..output.unwrap()
        }
    }

    #[test]
    fn a_word_that_was_wrong_stays_unbelieved_when_nothing_flows_any_more() {
        let mut lied = BTreeMap::new();
        let mut first = [ended(Liar {
            amps: Amps(3.0),
            in_step: true,
        })];
        assert!(
            first[0].off && first[0].lied && first[0].amps == Some(Amps(0.0)),
            "{first:?}"
        );
        remember(&mut lied, &mut first);
        let mut second = [ended(Liar {
            amps: Amps(0.0),
            in_step: true,
        })];
        assert!(second[0].verified());
        remember(&mut lied, &mut second);
        assert!(
            !second[0].verified() && second[0].by.as_deref() == Some("its set-point at 0"),
            "{second:?}"
        );
    }

    #[test]
    fn an_answer_to_another_question_is_not_a_current() {
        let output = ended(Liar {
            amps: Amps(3.7),
            in_step: false,
        });
        assert!(
            output.out_of_step && output.amps.is_none() && !output.verified(),
            "{output:?}"
        );
        assert_eq!(
            output.bound.as_deref(),
            Some("nothing but its rating of 30 A is known to bound it")
        );
    }
}
