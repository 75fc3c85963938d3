//! Safe state: everything off that can move charge, in the order that cannot harm the cell, read back and proven.

use std::time::Duration;

use instruments::{
    clock::Clock,
    generator::Generator,
    instrument::{Instrument, Model},
    link::LinkError,
    supply4q::Supply4q,
    units::Volts,
};

use super::{Bench, BenchError, wrap};
use crate::interlock::NO_CURRENT_A;

/// How often safe state is tried again, and the pause before each, s.
const SAFE_RETRIES: usize = 5;
const SAFE_PAUSE_S: f64 = 1.0;
/// After this time no current may flow, s.
const SAFE_SETTLE_S: f64 = 0.5;
/// Longest wait for the generator's least sine before the supply is switched off.
const QUIET_DEADLINE: Duration = Duration::from_secs(2);

impl Bench {
    /// Switches everything off that can move charge, and the relays of a bath without a loop of its own, and proves it: each output is read back, and half a second later no current may flow.
    ///
    /// The generator is brought to its least sine first, which ends the current at once; its output goes off only when the supply's is known to be off,
    /// for without its offset the supply's zero error would flow, or when it does not take the least sine. Load and charger are switched off at the same
    /// time, so that none waits for another that does not answer. Who fails is tried again for a while on a fresh connection: switching off is
    /// idempotent.
    ///
    /// # Errors
    /// Every instrument whose safe state could not be verified.
    pub async fn safe_state(&mut self) -> Result<(), Vec<BenchError>> {
        let mut failures = Vec::new();
        for attempt in 0..=SAFE_RETRIES {
            if attempt > 0 {
                self.clock.sleep_s(SAFE_PAUSE_S).await;
            }
            failures = self.try_safe().await;
            if failures.is_empty() {
                self.clock.sleep_s(SAFE_SETTLE_S).await;
                failures = self.still_flowing().await;
            }
            if failures.is_empty() {
                return Ok(());
            }
        }
        Err(failures)
    }

    /// Switches off what drives the cell by the bipolar supply, in the order of [`Self::safe_state`], once. Load and charger stay as they are.
    ///
    /// # Errors
    /// The first that could not be read back as off.
    pub async fn drive_off(&mut self) -> Result<(), BenchError> {
        let offset = Volts(self.command_offset_v);
        let (supply4q, generator) = off(&mut self.generator, &mut self.supply4q, (&self.clock, offset)).await;
        self.failed([("supply4q", supply4q), ("generator", generator)]).into_iter().next().map_or(Ok(()), Err)
    }

    /// Voltage, V, and current, A, that each instrument which can move charge reads now. A generator has no meter.
    pub async fn read_back(&mut self) -> Vec<(&'static str, Result<(f64, f64), BenchError>)> {
        let mut found = Vec::new();
        macro_rules! read {
            ($role:literal, $field:ident) => {
                if let Some(instrument) = self.$field.as_mut() {
                    let read = instrument.measure().await.map(|(volts, amps)| (volts.value(), amps.value()));
                    found.push(($role, read.map_err(|source| wrap($role, self.model($role), source))));
                }
            };
        }
        read!("supply4q", supply4q);
        read!("load", load);
        read!("supply", supply);
        found
    }

    async fn try_safe(&mut self) -> Vec<BenchError> {
        let offset = Volts(self.command_offset_v);
        let driven = off(&mut self.generator, &mut self.supply4q, (&self.clock, offset));
        let (load, supply) = (&mut self.load, &mut self.supply);
        let discharged = async move {
            let Some(load) = load.as_mut() else { return Ok(()) };
            fresh(load).await;
            load.safe().await
        };
        let charged = async move {
            let Some(supply) = supply.as_mut() else { return Ok(()) };
            fresh(supply).await;
            supply.safe().await
        };
        let bath = self.chiller.as_mut().filter(|chiller| chiller.is_regulated());
        let relays = async move {
            let Some(bath) = bath else { return Ok(()) };
            fresh(bath).await;
            bath.pulse(0.0).await
        };
        let ((supply4q, generator), load, supply, chiller) = tokio::join!(driven, discharged, charged, relays);
        self.failed([("supply4q", supply4q), ("generator", generator), ("load", load), ("supply", supply), ("chiller", chiller)])
    }

    fn failed<const ROLES: usize>(&self, outcomes: [(&'static str, Result<(), LinkError>); ROLES]) -> Vec<BenchError> {
        outcomes.into_iter().filter_map(|(role, outcome)| outcome.err().map(|source| wrap(role, self.model(role), source))).collect()
    }

    /// Outputs that say they are off while a current flows.
    async fn still_flowing(&mut self) -> Vec<BenchError> {
        let mut failures = Vec::new();
        macro_rules! measure {
            ($role:literal, $field:ident) => {
                if let Some(instrument) = self.$field.as_mut() {
                    let model = self.models.get($role).map_or("", |instrument| instrument.model.as_str());
                    match instrument.measure().await {
                        Ok((_, amps)) if amps.value().abs() <= NO_CURRENT_A => {}
                        Ok((_, amps)) => failures.push(BenchError::Flowing { role: $role, model: model.to_owned(), amps: amps.value() }),
                        Err(source) => failures.push(wrap($role, model, source)),
                    }
                }
            };
        }
        measure!("supply4q", supply4q);
        measure!("load", load);
        measure!("supply", supply);
        failures
    }
}

/// The one order in which the bipolar supply and its command go off: the least sine, the supply with its output open, the generator. What becomes of supply and
/// generator.
async fn off(
    generator: &mut Option<Generator>,
    supply4q: &mut Option<Supply4q>,
    (clock, offset): (&Clock, Volts),
) -> (Result<(), LinkError>, Result<(), LinkError>) {
    let quiet = match generator.as_mut() {
        // Not worth waiting for long: what drives the cell is the supply.
        Some(generator) => {
            let quiet = async {
                fresh(generator).await;
                generator.quiet(offset).await
            };
            clock.deadline(QUIET_DEADLINE, quiet).await.is_ok_and(|quiet| quiet.is_ok())
        }
        None => true,
    };
    let supply = match supply4q.as_mut() {
        Some(supply) => {
            fresh(supply).await;
            supply.safe().await
        }
        None => Ok(()),
    };
    let generator = match generator.as_mut() {
        Some(generator) if supply.is_ok() || !quiet => {
            fresh(generator).await;
            generator.safe().await
        }
        _ => Ok(()),
    };
    (supply, generator)
}

/// A new connection where the old one was dropped. When that fails, so does what is tried next, and says why.
async fn fresh<D: Model + ?Sized>(instrument: &mut Instrument<D>) {
    if instrument.link_mut().is_dropped() {
        let _ = instrument.link_mut().reconnect().await;
    }
}
