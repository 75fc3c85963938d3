//! Data set of a diagnosis: runs with their circumstances, and the errors of the bench known from
//! its history.

use analysis_effects::{augmented::Between, contract::CommonModeImpedance};
use analysis_fit::given::StateOfRuns;
use analysis_model::ocv::OcvCurve;
use analysis_signal::{calibration::CommonError, history::BenchHistory, series::TimeSeries};
use num_complex::Complex64;

use crate::median::median;
use crate::thresholds::{
    ASSUMED_CURRENT_NOISE_PART, ASSUMED_DRIFT_S, ASSUMED_DRIFT_V, ASSUMED_EIS_NOISE_PART,
    ASSUMED_GAIN_PART, ASSUMED_LEVEL_V, ASSUMED_NOISE_V, ASSUMED_RESISTANCE_PART,
    ASSUMED_ZERO_PART,
};

/// Runs that belong together.
#[derive(Debug, Clone, PartialEq)]
pub struct DataSet {
    /// Name for reports.
    pub name: String,
    /// The runs, in any order.
    pub runs: Vec<Run>,
    /// Errors of the bench known from its past; `None` if nothing is known.
    pub history: Option<BenchHistory>,
    /// Common error of the correction by control impedances in all spectra; the points' own σ do
    /// not contain it then.
    pub calibration: Option<CommonError>,
}

impl DataSet {
    /// Returns the state at which the runs of cells start, those without a state on the curve left out;
    /// `None` without runs.
    pub fn mean_state(&self, ocv: &OcvCurve) -> Option<StateOfRuns> {
        let of_run = |run: &Run| Some((run.start.soc(ocv)?, run.temperature_degc));
        let cells = self.runs.iter();
        let cells = cells.filter(|run| matches!(run.fixture, Fixture::Cell(_)));
        let states: Vec<(f64, f64)> = cells.filter_map(of_run).collect();
        if states.is_empty() {
            return None;
        }
        let mean_and_spread = |of: fn(&(f64, f64)) -> f64| {
            let low = states.iter().map(of).fold(f64::INFINITY, f64::min);
            let high = states.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
            let sum: f64 = states.iter().map(of).sum();
            (sum / states.len() as f64, high - low)
        };
        let (soc, spread_soc) = mean_and_spread(|state| state.0);
        let (temperature_degc, spread_k) = mean_and_spread(|state| state.1);
        Some(StateOfRuns {
            soc,
            temperature_degc,
            spread_soc,
            spread_k,
        })
    }
}

/// One run.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Name, unique within the data set.
    pub name: String,
    /// Object in the jig.
    pub fixture: Fixture,
    /// Purpose of the run.
    pub role: Role,
    /// Runs of one group repeat each other.
    pub repeat_group: String,
    /// Place in the order of time, 0 for the first.
    pub order: u32,
    /// Start since the start of the first run, s.
    pub start_s: f64,
    /// Temperature of the cell at the start, °C.
    pub temperature_degc: f64,
    /// State of charge at the start.
    pub start: Start,
    /// Measured data.
    pub data: RunData,
}

impl Run {
    /// Returns true if no fit uses it.
    pub fn is_held_out(&self) -> bool {
        self.role == Role::HeldOut
    }
}

/// Object in the jig.
#[derive(Debug, Clone, PartialEq)]
pub enum Fixture {
    /// A cell of this name.
    Cell(String),
    /// A shunt of this resistance, Ω.
    Shunt(f64),
    /// A fake cell of this resistance, Ω.
    FakeCell(f64),
}

pub use analysis_signal::series::Role;

/// Start of a run, at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Start {
    /// At a state of charge, 0…1.
    Soc(f64),
    /// At an open-circuit voltage, V.
    Ocv(f64),
}

impl Start {
    /// Returns the state of charge; `None` for a voltage that the curve does not reach.
    pub(super) fn soc(self, ocv: &OcvCurve) -> Option<f64> {
        match self {
            Self::Soc(soc) => Some(soc),
            Self::Ocv(ocv_v) => ocv.soc_at(ocv_v),
        }
    }
}

/// Measured data of a run.
#[derive(Debug, Clone, PartialEq)]
pub enum RunData {
    /// A spectrum.
    Eis(Sweep),
    /// A record in time.
    Time(TimeRecord),
}

/// A spectrum.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    /// Direct current under the sweep, A, discharge positive.
    pub bias_a: f64,
    /// Impedance between the lower tap of the swept object and the ground of the channels; zero if
    /// it is not stated.
    pub common_mode: CommonModeImpedance,
    /// Time of each point since the start of the run, s; empty if it is not recorded.
    pub elapsed_s: Vec<f64>,
    /// Charge put into the cell from the start of the run to each point, C; empty if it is not
    /// recorded.
    pub charge_coulomb: Vec<f64>,
    /// Its points, by rising frequency.
    pub points: Vec<SweepPoint>,
    /// Second and third harmonics of the voltage; empty if none were measured.
    pub harmonics: Vec<Harmonic>,
}

impl Sweep {
    /// Keeps the frequencies, Hz, that a rule keeps.
    pub fn retain(&mut self, keeps: impl Fn(f64) -> bool) {
        let kept: Vec<bool> = self.points.iter().map(|p| keeps(p.freq_hz)).collect();
        let of_points = |all: &mut Vec<f64>| {
            let mut kept = kept.iter();
            all.retain(|_| kept.next().copied().unwrap_or(true));
        };
        of_points(&mut self.elapsed_s);
        of_points(&mut self.charge_coulomb);
        self.points.retain(|p| keeps(p.freq_hz));
        self.harmonics.retain(|h| keeps(h.freq_hz));
    }
}

/// One harmonic of the voltage of a cell under a sine, beyond what a linear cell makes of the
/// harmonics of the current.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Harmonic {
    /// Frequency of the fundamental, Hz.
    pub freq_hz: f64,
    /// 2 or 3.
    pub order: u32,
    /// Z_k·Aᵏ⁻¹, Ω: its voltage over the amplitude A of the current, charging positive, phase from
    /// the peak of the current.
    pub z_ohm: Complex64,
    /// Standard uncertainty of real and imaginary part, Ω.
    pub sigma_ohm: (f64, f64),
    /// Amplitude of the current, A.
    pub amplitude_a: f64,
}

/// One point of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepPoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Impedance, Ω.
    pub z_ohm: Complex64,
    /// Standard uncertainty of real and imaginary part, Ω, where stated.
    pub sigma_ohm: Option<(f64, f64)>,
    /// Amplitude of the current, A, where stated.
    pub amplitude_a: Option<f64>,
}

/// A record in time.
#[derive(Debug, Clone, PartialEq)]
pub struct TimeRecord {
    /// Current (discharge positive) and voltage. Times start at 0, when the cell is at rest.
    pub series: TimeSeries,
    /// Interpolation of the current between two samples.
    pub between: Between,
    /// Samples before this time are simulated but not compared, s: a record that begins under
    /// current has to settle first.
    pub compared_from_s: f64,
    /// Standard deviation of the level beyond the bench's, V, if the open-circuit voltage at the
    /// start is not known. Above zero, gaps are computed about their mean.
    pub level_sigma_v: f64,
    /// Standard deviation of each voltage's own noise, V, if it is stated: rows that are means of
    /// more or fewer samples.
    pub sigma_v: Option<Vec<f64>>,
    /// Start and end of the window that each sample averages, s, if it is recorded. The mean of a
    /// decay is not its value in the middle.
    pub averaged_s: Option<Vec<(f64, f64)>>,
    /// Independent errors of a reconstructed current, one standard deviation of each: A at every
    /// sample. Empty for a logged current, whose errors are the bench's.
    pub current_errors_a: Vec<Vec<f64>>,
}

impl TimeRecord {
    /// Returns the distance of two rows in the middle, s.
    pub(crate) fn interval_s(&self) -> f64 {
        let steps = self.series.time_s.windows(2).map(|w| w[1] - w[0]);
        median(steps.collect())
    }
}

/// Errors of a bench of which nothing is known, for a greatest current in A.
pub fn assumed_history(greatest_a: f64) -> BenchHistory {
    BenchHistory {
        voltage_noise_v: ASSUMED_NOISE_V,
        voltage_resolution_v: 0.0,
        voltage_offset_v: ASSUMED_LEVEL_V,
        voltage_drift_v: ASSUMED_DRIFT_V,
        voltage_drift_s: ASSUMED_DRIFT_S,
        resistance_rel: ASSUMED_RESISTANCE_PART,
        current_gain_rel: ASSUMED_GAIN_PART,
        current_offset_a: ASSUMED_ZERO_PART * greatest_a,
        current_noise_a: ASSUMED_CURRENT_NOISE_PART * greatest_a,
        current_resolution_a: 0.0,
        eis_noise_rel: ASSUMED_EIS_NOISE_PART,
        start_voltage_v: 0.0,
        calibration_rel: 0.0,
        channel_gain_rel: 0.0,
    }
}
