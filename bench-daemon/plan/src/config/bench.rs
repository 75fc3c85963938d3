//! A bench as its file describes it, complete and checked.

use std::{collections::BTreeMap, path::PathBuf};

use analysis_signal::calibration::{KnownImpedance, StrayAdmittance};
use analysis_signal::history::BenchHistory;
use instruments::{
    clock::TimeMode,
    loopback::names_loopback,
    supply4q::{self, AnalogSelect, Capabilities, Holds, Rating},
    transport::Address,
    units::{Amps, Hertz, Kelvins, Seconds, Volts},
};

use crate::mocks::{Quirks, Schedule};

/// A bench.
#[derive(Debug, Clone)]
pub struct Bench {
    /// Its name.
    pub name: String,
    /// Its instruments; an absent one is `None`.
    pub instruments: Instruments,
    /// How it is wired.
    pub wiring: Wiring,
    /// The copper fake cell, where its impedance is known.
    pub fake_cell: Option<KnownImpedance>,
    /// The short bar, where its impedance is known.
    pub short: Option<KnownImpedance>,
    /// The stray admittance of the open jig, if it was measured.
    pub open: Option<StrayAdmittance>,
    /// The simulation behind the addresses, if there is one.
    pub simulation: Option<Simulation>,
    /// Known errors of the bench from its past, where any are known.
    pub history: Option<BenchHistory>,
    /// The file that this was read from.
    pub path: PathBuf,
    /// SHA-256 of its text.
    pub sha256: String,
    /// Folder of its state: which process runs it, and why it must not be run.
    pub state_folder: PathBuf,
    /// The process that watches over it.
    pub guardian: Guardian,
    /// Control of a bath whose loop the daemon closes.
    pub thermostat: Thermostat,
    /// Requirement of a run on the last report of `eis-bench doctor`.
    pub doctor: Doctor,
}

impl Bench {
    /// Whether it is simulated in this process: then nothing of it is left when the process has
    /// ended.
    pub fn in_process(&self) -> bool {
        self.instruments
            .addressed()
            .iter()
            .all(|(_, instrument)| matches!(instrument.address, Address::Memory { .. }))
    }

    /// Whether mocks on this machine stand for its instruments: nothing at these addresses outlives
    /// the process that serves them.
    pub fn is_mocked(&self) -> bool {
        self.simulation.is_some()
            && self
                .instruments
                .addressed()
                .iter()
                .all(|(_, instrument)| is_local(&instrument.address))
    }

    /// Whether every instrument is simulated: in this process, or by mocks on this machine.
    pub fn is_simulated(&self) -> bool {
        self.in_process() || self.is_mocked()
    }

    /// How bench time runs.
    pub fn time(&self) -> TimeMode {
        self.simulation
            .as_ref()
            .map_or(TimeMode::Real, |simulation| simulation.time)
    }
}

/// Time limits of the guardian, in wall time.
#[derive(Debug, Clone, Copy)]
pub struct Guardian {
    /// Silence of the daemon, s, after which the guardian ends it and switches off.
    pub lease_s: Seconds,
    /// Longest computation of the daemon between two waits, s: after it the daemon counts as hung,
    /// and the lease is not renewed.
    pub stall_s: Seconds,
}

/// Control of a bath with relays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thermostat {
    /// Distance from the set-point at which a relay is always on, K.
    pub band_k: Kelvins,
    /// Time in which a standing error doubles its effect, s.
    pub integral_s: Seconds,
    /// Interval in which a relay is switched on once, s.
    pub window_s: Seconds,
    /// Longest time without a reading before the run is stopped, s.
    pub stale_s: Seconds,
    /// Offset of the sensor: reading minus true temperature, K.
    pub sensor_offset_k: Kelvins,
}

/// Requirement of a run on the last report of `eis-bench doctor`.
#[derive(Debug, Clone, Copy)]
pub struct Doctor {
    /// Whether a missing valid report prevents energising; otherwise it is only reported.
    pub required: bool,
    /// Validity of a report, s.
    pub valid_for_s: Seconds,
}

/// The instruments by role.
#[derive(Debug, Clone, Default)]
pub struct Instruments {
    /// Bipolar supply with a link; [`Wiring::analog`] is one without.
    pub supply4q: Option<Instrument>,
    /// Signal generator.
    pub generator: Option<Instrument>,
    /// Oscilloscope.
    pub scope: Option<Instrument>,
    /// DC load.
    pub load: Option<Instrument>,
    /// DC supply.
    pub supply: Option<Instrument>,
    /// Chiller.
    pub chiller: Option<Instrument>,
    /// Temperature logger, with the channels of cell and air.
    pub logger: Option<(Instrument, u16, Option<u16>)>,
    /// Changes the fixture: a device, or a person.
    pub jig: Option<Jig>,
}

impl Instruments {
    /// The same with one role only.
    #[must_use]
    pub fn only(&self, role: &str) -> Self {
        let keep = |name: &str, instrument: &Option<Instrument>| {
            instrument.clone().filter(|_| name == role)
        };
        Self {
            supply4q: keep("supply4q", &self.supply4q),
            generator: keep("generator", &self.generator),
            scope: keep("scope", &self.scope),
            load: keep("load", &self.load),
            supply: keep("supply", &self.supply),
            chiller: keep("chiller", &self.chiller),
            logger: self.logger.clone().filter(|_| role == "logger"),
            jig: self.jig.clone().filter(|_| role == "jig"),
        }
    }

    /// Every instrument with an address, in a fixed order.
    pub fn addressed(&self) -> Vec<(&'static str, &Instrument)> {
        let jig = match &self.jig {
            Some(Jig::Device(instrument)) => Some(instrument),
            Some(Jig::Person) | None => None,
        };
        [
            ("supply4q", self.supply4q.as_ref()),
            ("generator", self.generator.as_ref()),
            ("scope", self.scope.as_ref()),
            ("load", self.load.as_ref()),
            ("supply", self.supply.as_ref()),
            ("chiller", self.chiller.as_ref()),
            (
                "logger",
                self.logger.as_ref().map(|(instrument, _, _)| instrument),
            ),
            ("jig", jig),
        ]
        .into_iter()
        .filter_map(|(role, instrument)| instrument.map(|instrument| (role, instrument)))
        .collect()
    }
}

/// Default of the longest usual time until an instrument replies to a query, s. Makers' figures
/// and owners' measurements are below it (`docs/safety.md`).
pub const ANSWER_S: Seconds = Seconds(0.3);

/// A model at an address.
#[derive(Debug, Clone)]
pub struct Instrument {
    /// Key of the dialect.
    pub model: String,
    /// Its address.
    pub address: Address,
    /// Text in the identity of another model that is accepted as this one.
    pub accept: Option<String>,
    /// Longest usual time until it answers a question, s.
    pub answer_s: Seconds,
    /// Rating of a bipolar supply, if the bench file states it.
    pub rating: Option<Rating>,
    /// Whether a load measures at its sense terminals; `None` to leave it as it is.
    pub remote_sense: Option<bool>,
}

/// How the fixture is changed.
#[derive(Debug, Clone)]
pub enum Jig {
    /// A person, prompted on the terminal.
    Person,
    /// A device.
    Device(Instrument),
}

/// How the bench is wired.
#[derive(Debug, Clone)]
pub struct Wiring {
    /// Output of the generator in use.
    pub generator_channel: u8,
    /// A bipolar supply without a link, if the bench has one.
    pub analog: Option<Analog>,
    /// Voltage at the input of the bipolar supply for one ampere of charge, V, without trim;
    /// negative if a positive voltage discharges.
    pub volts_per_amp: f64,
    /// Factor on the generator's amplitude that makes the current right.
    pub command_trim: f64,
    /// Offset of the generator that brings the mean current to zero, V.
    pub command_offset_v: Volts,
    /// The number of periods is set on the generator, if it supports bursts.
    pub bursts: bool,
    /// The current shunt.
    pub shunt: KnownImpedance,
    /// Vertical scale of channels 1…4 for one ampere of amplitude, V per division.
    pub scale_per_ampere_v: [f64; 4],
}

impl Wiring {
    /// Voltage of the generator that changes the current by `amps`, A, charge positive: the command
    /// without the offset that cancels the zero error of the supply.
    pub fn command_v(&self, amps: Amps) -> Volts {
        Volts(amps.value() * self.volts_per_amp * self.command_trim)
    }
}

/// Name of the model of a supply without a link.
pub const ANALOG: &str = "analog";

/// A bipolar supply without a link: the generator commands it, and no message switches or reads it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Analog {
    /// Current per volt at its input, A/V, charge positive: negative if a positive voltage
    /// discharges.
    pub amps_per_volt: f64,
    /// Rated current of either sign, A.
    pub rated_a: Amps,
    /// Greatest frequency that it follows within a few per cent, Hz.
    pub follows_hz: Hertz,
}

impl Analog {
    /// Properties for a plan.
    pub fn capabilities(&self) -> Capabilities {
        Capabilities {
            analog_select: AnalogSelect::Wiring,
            holds: Holds::NoLink,
            full_scale: self.rated_a,
            max_freq: self.follows_hz,
            analog_full_scale: Volts(self.rated_a.value() / self.amps_per_volt.abs()),
        }
    }
}

impl Bench {
    /// Model of its bipolar supply, with a link or without.
    pub fn bipolar_model(&self) -> Option<&str> {
        match &self.instruments.supply4q {
            Some(supply) => Some(&supply.model),
            None => self.wiring.analog.map(|_| ANALOG),
        }
    }

    /// Capabilities of its bipolar supply, with a link or without.
    pub fn bipolar(&self) -> Option<Capabilities> {
        match &self.instruments.supply4q {
            Some(supply) => supply4q::dialect(&supply.model, supply.rating)
                .ok()
                .map(|dialect| dialect.capabilities()),
            None => self.wiring.analog.map(|analog| analog.capabilities()),
        }
    }
}

/// A simulation behind the addresses.
#[derive(Debug, Clone)]
pub struct Simulation {
    /// The scenario file.
    pub scenario: PathBuf,
    /// How bench time runs.
    pub time: TimeMode,
    /// Faults between the simulated instruments and their client.
    pub faults: Option<Schedule>,
    /// Quirks of the mocks, by role.
    pub quirks: BTreeMap<&'static str, Quirks>,
}

/// Returns whether an address is in this process, on the loopback interface, on a
/// pseudo-terminal, or a socket instead of a device file.
pub(super) fn is_local(address: &Address) -> bool {
    match (address, address.host(), address.path()) {
        (_, Some(host), _) => names_loopback(host),
        (Address::UsbTmc { .. }, _, Some(path)) => !path.starts_with("/dev/"),
        (_, _, Some(path)) => path.starts_with("/dev/pts/"),
        (_, None, None) => true,
    }
}
