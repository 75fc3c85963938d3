//! A run that was not measured yet, as data.

use crate::data::{Fixture, Role, Run, RunData, Start, Sweep, SweepPoint, TimeRecord};
use crate::thresholds::{
    BETWEEN_REPEATS_S, POINT_S, SAMPLING_PART, SAMPLING_S, SLOW_HZ, SLOW_SWEEP_PERIODS,
    SWEEP_PERIODS,
};
use analysis_effects::{augmented::Between, contract::CommonModeImpedance};
use analysis_signal::series::TimeSeries;
use num_complex::Complex64;

/// Limits of a planned run on bench and cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BenchLimits {
    /// Largest current discharging, A.
    pub discharge_a: f64,
    /// Largest charging current, A, positive; 0 if the cell must not be charged.
    pub charge_a: f64,
    /// Highest frequency of a sweep, Hz.
    pub highest_hz: f64,
    /// The one shunt that can replace the cell, Ω; `None` if any can.
    pub shunt_ohm: Option<f64>,
}

/// Decides, by the name of its item, whether bench, cell and budget allow a planned run and whether
/// it is worthwhile.
pub type Playable = std::sync::Arc<dyn Fn(&str, &[PlannedRun]) -> bool + Send + Sync>;

/// A run that is to be measured.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedRun {
    /// Name of letters, digits and `_`.
    pub name: String,
    /// Object in the jig.
    pub fixture: Fixture,
    /// State of charge at the start, 0…1.
    pub soc: f64,
    /// Temperature of the cell, °C.
    pub temperature_degc: f64,
    /// Number of times that it is measured.
    pub repeat: usize,
    /// Runs of one group repeat each other.
    pub repeat_group: String,
    /// Place of the first repeat in the order of time; the others follow.
    pub order: u32,
    /// Time before it in which cell and bench settle, s.
    pub settle_s: f64,
    /// Start of the first repeat since the start of the campaign's first run, s.
    pub start_s: f64,
    /// Action of the run.
    pub what: Planned,
}

/// Action of a planned run.
#[derive(Debug, Clone, PartialEq)]
pub enum Planned {
    /// Currents one after the other: how long (s) and how much (A, discharge positive).
    Trace(Vec<(f64, f64)>),
    /// A sweep.
    Eis {
        /// Frequencies, Hz, rising.
        freq_hz: Vec<f64>,
        /// Amplitude of the current, A.
        amplitude_a: f64,
        /// Direct current under the sine, A, discharge positive; its charge is brought back.
        bias_a: f64,
    },
}

/// Returns the time of a point of a sweep, s.
pub(super) fn point_s(freq_hz: f64) -> f64 {
    let periods = if freq_hz < SLOW_HZ {
        SLOW_SWEEP_PERIODS
    } else {
        SWEEP_PERIODS
    };
    periods / freq_hz + POINT_S
}

impl Planned {
    /// Returns the duration of one run, s.
    pub fn span_s(&self) -> f64 {
        match self {
            Self::Trace(segments) => segments.iter().map(|(span_s, _)| span_s).sum(),
            Self::Eis {
                freq_hz, bias_a, ..
            } => {
                let sweep_s: f64 = freq_hz.iter().map(|f| point_s(*f)).sum();
                // The way back takes as long.
                if *bias_a == 0.0 {
                    sweep_s
                } else {
                    2.0 * sweep_s
                }
            }
        }
    }

    /// Returns the charge moved once, in either direction together, C.
    pub fn charge_coulomb(&self) -> f64 {
        match self {
            Self::Trace(segments) => segments
                .iter()
                .map(|(span_s, amps)| span_s * amps.abs())
                .sum(),
            // The mean of |sin| is 2/π, and less than the direct current if that is larger.
            Self::Eis {
                amplitude_a,
                bias_a,
                ..
            } => bias_a.abs().max(std::f64::consts::FRAC_2_PI * amplitude_a) * self.span_s(),
        }
    }
}

impl PlannedRun {
    /// Returns the duration with all repeats and all settling, s.
    pub fn duration_s(&self) -> f64 {
        let more = self.repeat.saturating_sub(1) as f64;
        self.settle_s
            + self.what.span_s()
            + more * (self.settle_s.min(BETWEEN_REPEATS_S) + self.what.span_s())
    }

    /// Returns the charge moved with its repeats, in both directions together, Ah; zero if a
    /// control is in the jig.
    pub fn charge_ah(&self) -> f64 {
        let cell = matches!(self.fixture, Fixture::Cell(_));
        if cell {
            self.repeat as f64 * self.what.charge_coulomb() / 3600.0
        } else {
            0.0
        }
    }

    /// Returns the start of a repeat, counted from 0, s.
    pub fn repeat_start_s(&self, nth: usize) -> f64 {
        self.start_s + nth as f64 * (self.settle_s.min(BETWEEN_REPEATS_S) + self.what.span_s())
    }

    /// Returns the first repeat with zeros for what will be measured, sampled as a campaign's runs
    /// are: dense after an edge.
    pub(crate) fn unmeasured(&self, between: Between, sigma_v: Option<f64>) -> Run {
        let data = match &self.what {
            Planned::Trace(segments) => {
                let (time_s, current_a) = samples(segments);
                let voltage_v = vec![0.0; time_s.len()];
                let series = TimeSeries {
                    name: self.name.clone(),
                    time_s,
                    current_a,
                    voltage_v,
                    temperature_degc: None,
                };
                let sigma_v = sigma_v.map(|sigma_v| vec![sigma_v; series.len()]);
                RunData::Time(TimeRecord {
                    series,
                    between,
                    compared_from_s: 0.0,
                    level_sigma_v: 0.0,
                    sigma_v,
                    averaged_s: None,
                    current_errors_a: Vec::new(),
                })
            }
            Planned::Eis {
                freq_hz,
                amplitude_a,
                bias_a,
            } => {
                let point = |f: &f64| SweepPoint {
                    freq_hz: *f,
                    z_ohm: Complex64::ZERO,
                    sigma_ohm: None,
                    amplitude_a: Some(*amplitude_a),
                };
                RunData::Eis(Sweep {
                    bias_a: *bias_a,
                    common_mode: CommonModeImpedance::default(),
                    elapsed_s: Vec::new(),
                    charge_coulomb: Vec::new(),
                    harmonics: Vec::new(),
                    points: freq_hz.iter().map(point).collect(),
                })
            }
        };
        Run {
            name: self.name.clone(),
            fixture: self.fixture.clone(),
            role: Role::Train,
            repeat_group: self.repeat_group.clone(),
            order: self.order,
            start_s: self.start_s,
            temperature_degc: self.temperature_degc,
            start: Start::Soc(self.soc),
            data,
        }
    }
}

/// Instants in whole milliseconds and the currents from each on.
fn samples(segments: &[(f64, f64)]) -> (Vec<f64>, Vec<f64>) {
    let whole = |t: f64| (t * 1e3).round() / 1e3;
    let (mut time_s, mut current_a, mut start_s) = (Vec::new(), Vec::new(), 0.0);
    for (span_s, amps) in segments {
        let mut since_s = 0.0;
        while since_s < span_s - 0.5 * SAMPLING_S.0 {
            time_s.push(whole(start_s + since_s));
            current_a.push(*amps);
            since_s += whole((SAMPLING_PART * since_s).clamp(SAMPLING_S.0, SAMPLING_S.1));
        }
        start_s = whole(start_s + span_s);
    }
    time_s.push(start_s);
    current_a.push(segments.last().map_or(0.0, |(_, amps)| *amps));
    (time_s, current_a)
}
