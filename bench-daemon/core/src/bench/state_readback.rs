//! Reads the state of a bench before any other action: queries outputs and measures currents
//! without changing anything.
//!
//! After a crash, the last settings of the instruments are unknown. A resumed run records what it
//! found before it switches anything off.

use instruments::{
    clock,
    exchange::Answer,
    units::{Amps, Volts},
};
use serde::{Deserialize, Serialize};

use super::outputs::{OutputReading, OutputState};
use crate::bench::{Bench, BenchError};
use bench_plan::interlock::NO_CURRENT_A;

/// State in which one instrument was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InstrumentReadback {
    /// Its role.
    pub role: String,
    /// Whether its output is off, or open so that no current can flow.
    pub off: bool,
    /// Whether it is a generator at its zero command for an analog supply.
    #[serde(default)]
    pub at_zero: bool,
    /// Answers of the instrument.
    pub answers: Vec<Answer>,
    /// Voltage that it measures, V; `None` if it has no voltmeter.
    pub volts: Option<Volts>,
    /// Current that it measures, A.
    pub amps: Option<Amps>,
}

impl InstrumentReadback {
    /// Checks whether the output is off and its meter shows no current.
    pub fn is_quiet(&self) -> bool {
        self.off && self.amps.unwrap_or(Amps::ZERO).abs() <= NO_CURRENT_A
    }

    /// Checks whether the instrument can move charge; a bath cannot.
    pub fn moves_charge(&self) -> bool {
        self.role != "chiller"
    }
}

/// Converts the results of [`look_each`] into readings to be stored, including instruments that
/// did not answer.
pub fn readings(
    bench: &Bench,
    found: &[Result<InstrumentReadback, BenchError>],
    by: &str,
) -> Vec<OutputReading> {
    let unix_s = clock::unix_time_s();
    let one = |found: &Result<InstrumentReadback, BenchError>| {
        let (role, state, meter) = match found {
            Ok(found) => {
                let state = match (found.off, found.is_quiet()) {
                    (true, true) => OutputState::Off,
                    (true, false) => OutputState::Current,
                    (false, _) if found.at_zero => OutputState::Zero,
                    (false, _) => OutputState::On,
                };
                (found.role.as_str(), state, (found.volts, found.amps))
            }
            Err(error) => (error.role()?, OutputState::Unreachable, (None, None)),
        };
        Some(OutputReading {
            role: role.to_owned(),
            model: bench.model(role).to_owned(),
            state,
            volts: meter.0.map(Volts::value),
            amps: meter.1.map(Amps::value),
            unix_s,
            by: by.to_owned(),
        })
    };
    let analog = bench.is_unswitched().then(|| OutputReading {
        role: "supply4q".to_owned(),
        model: bench.model("supply4q").to_owned(),
        state: OutputState::Unswitched,
        volts: None,
        amps: None,
        unix_s,
        by: by.to_owned(),
    });
    analog
        .into_iter()
        .chain(found.iter().filter_map(one))
        .collect()
}

/// Queries everything that can move charge, and the bath.
///
/// # Errors
/// Fails at the first instrument that does not answer.
pub async fn look(bench: &mut Bench) -> Result<Vec<InstrumentReadback>, BenchError> {
    let drives = look_each(bench).await;
    drives.into_iter().chain(look_bath(bench).await).collect()
}

/// Queries whether the bath stands still or its relays are open. Connects to it if necessary.
pub async fn look_bath(bench: &mut Bench) -> Option<Result<InstrumentReadback, BenchError>> {
    let error = bench.error("chiller");
    let bath = bench.instruments.chiller.as_mut()?;
    let answers = async {
        if bath.link_mut().is_dropped() {
            bath.link_mut().reconnect().await?;
        }
        bath.look().await
    };
    let found = answers.await.map(|answers| {
        let off = answers.iter().all(|answer| answer.as_scripted);
        InstrumentReadback {
            role: "chiller".to_owned(),
            off,
            at_zero: false,
            answers,
            volts: None,
            amps: None,
        }
    });
    Some(found.map_err(&error))
}

/// Queries everything that can move charge, each instrument separately: one that does not answer
/// does not prevent the others from being queried. Connects to them if necessary.
pub async fn look_each(bench: &mut Bench) -> Vec<Result<InstrumentReadback, BenchError>> {
    let mut all = Vec::new();
    macro_rules! look {
        ($role:literal, $field:ident, $measure:expr) => {
            let error = bench.error($role);
            if let Some(instrument) = bench.instruments.$field.as_mut() {
                let found = async {
                    if instrument.link_mut().is_dropped() {
                        instrument.link_mut().reconnect().await?;
                    }
                    let answers = instrument.look().await?;
                    let off = answers.iter().all(|answer| answer.as_scripted);
                    #[allow(clippy::redundant_closure_call, reason = "only some roles measure")]
                    let (volts, amps) = $measure(instrument).await?;
                    Ok(InstrumentReadback {
                        role: $role.to_owned(),
                        off,
                        at_zero: false,
                        answers,
                        volts,
                        amps,
                    })
                };
                all.push(found.await.map_err(&error));
            }
        };
    }
    look!(
        "supply4q",
        supply4q,
        async |i: &mut instruments::supply4q::Supply4q| {
            i.measure()
                .await
                .map(|(volts, amps)| (Some(volts), Some(amps)))
        }
    );
    look!(
        "generator",
        generator,
        async |_: &mut instruments::generator::Generator| Ok((None, None))
    );
    if let Some(Ok(found)) = all.last_mut()
        && found.role == "generator"
        && !found.off
    {
        found.at_zero = bench.commands_zero().await;
    }
    look!("load", load, async |i: &mut instruments::load::Load| {
        i.measure()
            .await
            .map(|(volts, amps)| (Some(volts), Some(amps)))
    });
    look!(
        "supply",
        supply,
        async |i: &mut instruments::supply::Supply| {
            i.measure()
                .await
                .map(|(volts, amps)| (Some(volts), Some(amps)))
        }
    );
    all
}

impl std::fmt::Display for InstrumentReadback {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let measured = match (self.volts, self.amps) {
            (Some(volts), Some(amps)) => format!(", {volts:.4}, {amps:.4}"),
            _ => String::new(),
        };
        write!(
            f,
            "found {} {}{measured}",
            self.role,
            match (self.off, self.at_zero) {
                (true, _) => "off",
                (false, true) => "on at its zero command",
                (false, false) => "ON",
            }
        )
    }
}
