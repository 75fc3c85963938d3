//! Configuration: files as typed (`raw`), read with line numbers (`source`) and units (`quantity`), checked once (`resolve`, `check`). What comes out
//! of here is complete and within the limits of cell and instruments; nothing is energised before that.

mod campaign;
mod check;
mod interlock;
mod limits;
mod multisine;
mod ocv_soc;
mod quality;
pub mod quantity;
mod raw;
mod resolve;
mod simulation;
mod source;
mod trace;

use std::{collections::BTreeMap, path::PathBuf};

use crate::{plan::Missed, quality::Quality};
use analysis::{
    calibration::{ControlTolerance, KnownImpedance, StrayAdmittance},
    diagnosis::BenchHistory,
    fit::Objective,
    ocv::OcvCurve,
};
use instruments::{
    clock::TimeMode,
    mock::{Schedule, plant::Fixture, quirks::Quirks},
    transport::Address,
};

pub use campaign::{Campaign, CampaignRun};
pub(crate) use check::{LOAD_CUT_OFF_V, check_frames};
pub use multisine::{Band, Multisine};
pub use ocv_soc::OcvSoc;
pub use resolve::{load_any_bench, load_bench, load_experiment, resolve_experiment};
pub use source::{ConfigError, Copies, Fence, Source};
pub(crate) use trace::{AFTER_WAVE_S, BEFORE_S};
pub use trace::{Segment, Trace};

/// A complete experiment.
#[derive(Debug, Clone)]
pub struct Experiment {
    /// Its name: run folders are called after it.
    pub name: String,
    /// Seed of the simulation and of the searches of the fits.
    pub seed: u64,
    /// The bench.
    pub bench: Bench,
    /// The cell.
    pub cell: Cell,
    /// Holding a temperature first, if asked for.
    pub temperature: Option<Temperature>,
    /// Checking the bench with control impedances first, if asked for.
    pub fixture_check: Option<FixtureCheck>,
    /// Bringing the cell to a known state of charge first, if asked for.
    pub soc_reset: Option<SocReset>,
    /// Finding the open-circuit voltage over the state of charge, if asked for.
    pub ocv_soc: Option<OcvSoc>,
    /// The sweeps, if there are any.
    pub eis: Option<Eis>,
    /// Many frequencies at once, if asked for.
    pub multisine: Option<Multisine>,
    /// Several cells, each measured several times, if there are any.
    pub campaign: Option<Campaign>,
    /// Currents that step, in the order in which each round plays them.
    pub traces: Vec<Trace>,
    /// The fits.
    pub fit: Fit,
    /// The order of the fitted model that is diagnosed with the run's own data at its end, where that is asked for.
    pub diagnosed_rc: Option<usize>,
    /// The files that this was read from.
    pub sources: Vec<Source>,
}

/// A bench.
#[derive(Debug, Clone)]
pub struct Bench {
    /// Its name.
    pub name: String,
    /// Its instruments; what is absent is `None`.
    pub instruments: Instruments,
    /// How it is wired.
    pub wiring: Wiring,
    /// The copper fake cell, where its impedance is known.
    pub fake_cell: Option<KnownImpedance>,
    /// The short bar, where its impedance is known.
    pub short: Option<KnownImpedance>,
    /// The stray admittance of the open jig, where it was measured.
    pub open: Option<StrayAdmittance>,
    /// The simulation behind the addresses, if there is one.
    pub simulation: Option<Simulation>,
    /// What its past says of its errors, where anything is known.
    pub history: Option<BenchHistory>,
    /// The file that this was read from.
    pub path: PathBuf,
    /// Where its state is kept: who runs it, and why it must not be run.
    pub state_folder: PathBuf,
    /// The process that watches over it.
    pub guardian: Guardian,
    /// How a bath is held whose loop the daemon closes.
    pub thermostat: Thermostat,
    /// What a run asks of the last look of the doctor.
    pub doctor: Doctor,
}

impl Bench {
    /// Whether it is simulated in this process: then nothing of it is left when the process has ended.
    pub fn in_process(&self) -> bool {
        self.instruments.addressed().iter().all(|(_, instrument)| matches!(instrument.address, Address::Memory { .. }))
    }

    /// Whether mocks on this machine stand for its instruments: nothing at these addresses outlives the process that serves them.
    pub fn is_mocked(&self) -> bool {
        self.simulation.is_some() && self.instruments.addressed().iter().all(|(_, instrument)| resolve::is_local(&instrument.address))
    }

    /// How bench time runs.
    pub fn time(&self) -> TimeMode {
        self.simulation.as_ref().map_or(TimeMode::Real, |simulation| simulation.time)
    }
}

/// When the guardian steps in. Both are seconds on the wall.
#[derive(Debug, Clone, Copy)]
pub struct Guardian {
    /// Without a word from the daemon for so long, s, the guardian ends it and switches off.
    pub lease_s: f64,
    /// The daemon may compute for so long between two waits, s: after that it counts as hung, and the lease is not renewed.
    pub stall_s: f64,
}

/// How the daemon holds a bath with relays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thermostat {
    /// So far from the set-point a relay is on all the time, K.
    pub band_k: f64,
    /// Time in which a standing error doubles its effect, s.
    pub integral_s: f64,
    /// A relay is switched on once in it, s.
    pub window_s: f64,
    /// Without a reading for longer the run is stopped, s.
    pub stale_s: f64,
    /// What the sensor shows too much, K.
    pub sensor_offset_k: f64,
}

/// What a run asks of the last report of `eis-bench doctor`.
#[derive(Debug, Clone, Copy)]
pub struct Doctor {
    /// Without a valid report nothing is energised; else its want is remarked.
    pub required: bool,
    /// A report is valid for so long, s.
    pub valid_for_s: f64,
}

/// The instruments by role.
#[derive(Debug, Clone, Default)]
pub struct Instruments {
    /// Bipolar supply.
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
    /// What changes the fixture: a device, or a person.
    pub jig: Option<Jig>,
}

impl Instruments {
    /// The same with one role only.
    #[must_use]
    pub fn only(&self, role: &str) -> Self {
        let keep = |name: &str, instrument: &Option<Instrument>| instrument.clone().filter(|_| name == role);
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
            ("logger", self.logger.as_ref().map(|(instrument, _, _)| instrument)),
            ("jig", jig),
        ]
        .into_iter()
        .filter_map(|(role, instrument)| instrument.map(|instrument| (role, instrument)))
        .collect()
    }
}

/// A model at an address.
#[derive(Debug, Clone)]
pub struct Instrument {
    /// Key of the dialect.
    pub model: String,
    /// Where it is reached.
    pub address: Address,
    /// What the identity of another model contains that is to be spoken to as this one all the same.
    pub accept: Option<String>,
}

impl Instrument {
    /// Whether it is to be spoken to as this model although it answers as another one.
    pub fn accepts(&self, identity: &str) -> bool {
        self.accept.as_deref().is_some_and(|text| !text.is_empty() && identity.contains(text))
    }
}

/// Who changes the fixture.
#[derive(Debug, Clone)]
pub enum Jig {
    /// A person, asked on the terminal.
    Person,
    /// A device.
    Device(Instrument),
}

/// How the bench is wired.
#[derive(Debug, Clone)]
pub struct Wiring {
    /// Output of the generator in use.
    pub generator_channel: u8,
    /// Factor on the generator's amplitude that makes the current right.
    pub command_trim: f64,
    /// Offset of the generator that brings the mean current to zero, V.
    pub command_offset_v: f64,
    /// The current shunt.
    pub shunt: KnownImpedance,
    /// Vertical scale of channels 1…4 for one ampere of amplitude, V per division.
    pub scale_per_ampere_v: [f64; 4],
}

/// A simulation behind the addresses.
#[derive(Debug, Clone)]
pub struct Simulation {
    /// The scenario file.
    pub scenario: PathBuf,
    /// How bench time runs.
    pub time: TimeMode,
    /// What goes wrong between the simulated instruments and their client.
    pub faults: Option<Schedule>,
    /// What a mock is told to do differently, by role.
    pub quirks: BTreeMap<&'static str, Quirks>,
}

/// A cell and what may be done to it.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Cell {
    /// Its name.
    pub name: String,
    /// Capacity, C.
    pub capacity_c: f64,
    /// What may be done to it.
    pub limits: crate::interlock::Limits,
    /// What the interlock allows beside them.
    pub interlock: crate::interlock::Settings,
    /// Cells in series in the pack that the model is mapped to.
    pub series: u32,
    /// Cells in parallel.
    pub parallel: u32,
    /// Open-circuit voltage as the data sheet or an earlier cell shows it.
    #[serde(skip)]
    pub ocv: Option<OcvCurve>,
    /// What of its limits is beyond its data or common sense, in words.
    #[serde(skip)]
    pub wide: Vec<String>,
}

/// A temperature to hold.
#[derive(Debug, Clone, Copy)]
pub struct Temperature {
    /// Set-point, °C.
    pub setpoint_c: f64,
    /// Accepted deviation of the cell, K.
    pub within_k: f64,
    /// Longest wait, s.
    pub timeout_s: f64,
}

/// The check of the bench.
#[derive(Debug, Clone)]
pub struct FixtureCheck {
    /// The controls to measure and how far their raw reading may be off.
    pub controls: Vec<(Fixture, Tolerance)>,
    /// How far a control may be off after the correction, as a share.
    pub corrected_tolerance: f64,
    /// Frequencies beyond those of the sweep at which the controls are looked at, Hz: they are judged by nothing, and tell how far the bench goes.
    pub beyond_hz: Vec<f64>,
}

/// How far a control may be off as read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Tolerance {
    /// Of an impedance: by magnitude and phase.
    Relative(ControlTolerance),
    /// Of a short: by this much in any direction, Ω.
    Absolute(f64),
}

/// The reset of the state of charge (thesis 3.3.1).
#[derive(Debug, Clone, Copy)]
pub struct SocReset {
    /// Discharge current, A, positive.
    pub discharge_a: f64,
    /// End of the discharge, V under load.
    pub discharge_until_v: f64,
    /// Charge current, A.
    pub charge_a: f64,
    /// Voltage limit of the supply, V.
    pub charge_limit_v: f64,
    /// End of the charge, V under load.
    pub charge_until_v: f64,
    /// Shortest rest, s.
    pub rest_min_s: f64,
    /// Longest rest, s.
    pub rest_max_s: f64,
    /// The rest ends when the voltage changes more slowly, V/s.
    pub rest_slope_v_per_s: f64,
    /// Longest discharge and longest charge, s.
    pub max_s: f64,
    /// Where the voltage must come to rest, where that is asked for.
    pub acceptance: Option<Acceptance>,
}

/// When a reset of the state of charge has succeeded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Acceptance {
    /// The band of the voltage at rest, V.
    pub band_v: (f64, f64),
    /// Resets at most.
    pub attempts: usize,
    /// What becomes of a cell that misses it to the end.
    pub missed: Missed,
}

/// The sweeps.
#[derive(Debug, Clone)]
pub struct Eis {
    /// What is swept, beside the controls.
    pub fixture: Fixture,
    /// How often; 0 where only the controls are.
    pub repeat: usize,
    /// Rest of the cell before each, s.
    pub rest_s: f64,
    /// Frequencies, rising, Hz.
    pub freqs_hz: Vec<f64>,
    /// Amplitude of the current, A.
    pub amplitude_a: f64,
    /// Periods waited at least.
    pub periods: f64,
    /// Waited on top, s.
    pub extra_wait_s: f64,
    /// Periods on the screen at least.
    pub periods_on_screen: f64,
    /// Points downloaded per channel.
    pub record_points: u64,
    /// Points in the scope's memory per channel.
    pub memory_points: u64,
    /// Frequency of the mains whose pick-up is fitted besides the sinusoid, Hz; `None` if there is none to expect.
    pub mains_hz: Option<f64>,
    /// In which order the frequencies come.
    pub order: Order,
    /// Amplitudes of the sweeps of a round, A; the largest is `amplitude_a`.
    pub steps_a: Vec<f64>,
    /// Each sweep goes there and back, and every point counts at the time in between.
    pub compensate_drift: bool,
    /// The next point settles while the record of this one is fetched and analysed; where it is not said, in real time only.
    pub overlap: Option<bool>,
    /// What a point must be to be kept without a flag, where it is asked for.
    pub quality: Option<Quality>,
}

/// In which order the frequencies of a sweep come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// The slowest first.
    #[default]
    Ascending,
    /// The fastest first.
    Descending,
    /// Drawn from the seed, anew for each sweep: a drift of the cell becomes noise.
    Random,
    /// The slowest, the fastest, the second slowest …
    Alternating,
}

/// The fits.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Orders.
    pub rc: Vec<usize>,
    /// What is minimised.
    pub objective: Objective,
}
