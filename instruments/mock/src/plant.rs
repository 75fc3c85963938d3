//! The simulated world, as the mocks see it. All mocks of a bench share one [`Plant`]; what one
//! does to it is visible to the others.
//!
//! This module contains no SCPI and no physics; it is only the interface between the two.
//! `fixtures` implements it.
//!
//! Times are bench seconds ([`instruments_link::clock::Clock::now_s`]); calls come with times that
//! never decrease. Currents into the cell are positive (charge), as the thesis' bench measures them.

use std::sync::{Arc, Mutex};

use instruments_domain::fixture::Fixture;

/// The world shared by the mocks of one bench. Locked only within one command, never across an
/// await.
pub type SharedPlant = Arc<Mutex<dyn Plant>>;

/// How a zero error grows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// Rate, A/s.
    pub a_per_s: f64,
    /// Greatest error, A.
    pub greatest_a: f64,
}

/// One coupled simulated bench.
pub trait Plant: Send {
    /// Sets what an instrument does to the world from `t_s` until the next call. Idempotent: an
    /// action carries the whole state.
    fn act(&mut self, t_s: f64, action: Action);

    /// Sets another shape than a sine for the signal of generator channel 1 from `t_s` on: one
    /// period in equal steps, −1 … 1 of the amplitude, each held until the next. `None` restores
    /// the sine. A world without shapes ignores it.
    fn shape(&mut self, t_s: f64, steps: Option<Arc<[f64]>>) {
        let _ = (t_s, steps);
    }

    /// Returns the reading of the meter at `t_s`, its own error and noise included.
    fn read(&mut self, t_s: f64, meter: Meter) -> f64;

    /// Returns the latest instant in `search.from_s ..= search.to_s` at which the probe of
    /// `search.channel` crosses `search.level_v` in the requested direction, or `None`. `t_s` is
    /// now; `to_s` never lies after it.
    fn find_trigger(&mut self, t_s: f64, search: &TriggerSearch) -> Option<f64>;

    /// Digitises one channel over a span that lies wholly in the past, at most `HISTORY_S` ago. The
    /// same request returns the same codes again.
    fn digitise(&mut self, t_s: f64, request: &DigitiseRequest) -> Vec<i16>;

    /// Clamps another fixture into the jig, as a person would.
    fn mount(&mut self, t_s: f64, fixture: Fixture);

    /// Fixture in the jig.
    fn mounted(&self) -> Fixture;

    /// Selects another of the cells under test, by its number from 1, for `Fixture::Cell`. Returns
    /// whether the cell exists.
    fn insert(&mut self, _t_s: f64, number: usize) -> bool {
        number == 1
    }

    /// Returns the number of the cell under test that `Fixture::Cell` means.
    fn inserted(&self) -> usize {
        1
    }

    /// Returns whether the chiller has lost its flow.
    fn chiller_alarm(&mut self, _t_s: f64) -> bool {
        false
    }

    /// From now on the zero error of the bipolar supply grows. A world without one ignores it.
    fn drift(&mut self, _t_s: f64, _drift: Drift) {}

    /// From now on a chiller that runs brings its bath to this temperature, °C, whatever its
    /// set-point is. A world without a bath ignores it.
    fn bath_runs_away(&mut self, _t_s: f64, _towards_c: f64) {}

    /// How late every answer of every instrument is at `t_s`, s.
    fn late_s(&self, _t_s: f64) -> f64 {
        0.0
    }
}

/// Action of an instrument on the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// The voltage at the output of generator channel 1 into an open circuit.
    Generator(GeneratorState),
    /// The bipolar supply.
    Bipolar(BipolarState),
    /// The DC load.
    Load(LoadState),
    /// Channel 1 of the DC supply.
    Supply(SupplyState),
    /// The chiller.
    Chiller(ChillerState),
    /// Heater and cooler of a bath with an external control loop.
    Bath(BathState),
}

/// A sine plus an offset; all zero when the output is off.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GeneratorState {
    /// Offset, V.
    pub offset_v: f64,
    /// Amplitude (zero to peak), V.
    pub amplitude_v: f64,
    /// Frequency, Hz; zero with zero amplitude.
    pub freq_hz: f64,
    /// Phase at `since_s`, rad.
    pub phase_rad: f64,
    /// Bench time that the phase refers to, s.
    pub since_s: f64,
    /// Whole periods from then on, behind which only the offset stays; none: no end.
    pub periods: Option<u32>,
}

/// State of a bipolar supply.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BipolarState {
    /// The output is on.
    pub output_on: bool,
    /// Controls the current (otherwise the voltage).
    pub current_mode: bool,
    /// The analog input commands the main channel (±10 V is ± full scale).
    pub analog_input: bool,
    /// Digital set-point of the main channel, A or V; not used while `analog_input`.
    pub setpoint: f64,
    /// Limit of the other channel: compliance voltage in current mode, V; current in voltage mode,
    /// A. A magnitude.
    pub limit: f64,
    /// With the output off, the terminals are high-impedance (`BATTERY`, `RESISTIVE`) instead of
    /// held at zero volts (`ACTIVE`, which shorts a cell through the supply).
    pub off_is_open: bool,
}

/// State of a DC load in constant current or in constant power.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LoadState {
    /// The input is on.
    pub input_on: bool,
    /// Current that it draws from the cell, A, positive.
    pub current_a: f64,
    /// In the place of a current, power that it draws at its terminals, W, positive.
    pub power_w: Option<f64>,
    /// It sinks nothing while its terminals are below this, V.
    pub min_voltage_v: f64,
}

/// State of a CC–CV supply channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SupplyState {
    /// The output is on.
    pub output_on: bool,
    /// Voltage limit, V.
    pub voltage_v: f64,
    /// Current limit, A.
    pub current_a: f64,
}

/// State of the chiller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChillerState {
    /// Circulating and controlling.
    pub running: bool,
    /// Set-point, °C.
    pub setpoint_degc: f64,
}

/// Heater and cooler of a bath without a set-point.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BathState {
    /// 1: the heater is on, −1: the cooler, 0: neither.
    pub power: f64,
    /// The relay drops automatically at this bench time, s.
    pub until_s: f64,
}

/// A meter somewhere on the bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Meter {
    /// Voltage at the bipolar supply's terminals, V.
    BipolarVolts,
    /// Current of the bipolar supply, A, charge positive.
    BipolarAmps,
    /// Voltage at the load's sense terminals, V.
    LoadVolts,
    /// Current of the load, A, positive.
    LoadAmps,
    /// Voltage at the supply's terminals, V.
    SupplyVolts,
    /// Current of the supply, A.
    SupplyAmps,
    /// Bath of the chiller, °C.
    BathCelsius,
    /// Surface of the cell, °C (a thermocouple on the logger).
    CellCelsius,
    /// Ambient air, °C (a second thermocouple).
    AmbientCelsius,
}

/// A search for a trigger.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriggerSearch {
    /// Scope channel 1…4.
    pub channel: u8,
    /// Level at the probe tip, V.
    pub level_v: f64,
    /// Rising edge (otherwise falling).
    pub rising: bool,
    /// Earliest instant, s.
    pub from_s: f64,
    /// Latest instant, s.
    pub to_s: f64,
}

/// A span of one channel to be digitised by a linear ADC: code = (V + `offset_v`) ·
/// `codes_per_volt`, rounded, clipped to the code range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DigitiseRequest {
    /// Scope channel 1…4.
    pub channel: u8,
    /// Time of sample 0, bench s.
    pub start_s: f64,
    /// Time between two samples of the ADC, s.
    pub interval_s: f64,
    /// Index of the first sample wanted.
    pub first: u64,
    /// Samples between two wanted ones (1: every one).
    pub stride: u64,
    /// How many samples are wanted.
    pub count: usize,
    /// Vertical scale, V per division: the front end's noise follows it.
    pub volts_per_div: f64,
    /// Offset added before the ADC, V.
    pub offset_v: f64,
    /// ADC codes per volt.
    pub codes_per_volt: f64,
    /// Least code of the ADC.
    pub code_min: i16,
    /// Greatest code of the ADC.
    pub code_max: i16,
    /// Number of the acquisition: the noise of two acquisitions is independent.
    pub acquisition: u64,
}

/// How long a plant must remember waveforms, s: ten divisions of the slowest time base in use (20
/// s/div) and as much again.
pub const HISTORY_S: f64 = 400.0;
