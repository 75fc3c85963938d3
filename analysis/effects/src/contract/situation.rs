//! Model, data and moment that an effect is given.

use analysis_model::{
    model::{Erm, RcBranch},
    ocv::OcvCurve,
};
use num_complex::Complex64;

/// The base model and what bounds are derived from.
#[derive(Debug, Clone, PartialEq)]
pub struct Base {
    /// The fitted extended Randles model of one cell.
    pub erm: Erm,
    /// Open-circuit voltage over SOC, with the capacity.
    pub ocv: OcvCurve,
    /// Range of the data.
    pub facts: Facts,
}

/// Range of the data: the limits within which an effect was identified.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Facts {
    /// Lowest frequency of a spectrum, Hz; none without spectra.
    pub lowest_hz: Option<f64>,
    /// Highest frequency of a spectrum, Hz; none without spectra.
    pub highest_hz: Option<f64>,
    /// Longest record in time, s; zero without any.
    pub longest_s: f64,
    /// Shortest distance of two samples, s; infinite without records, null in files.
    #[serde(deserialize_with = "null_is_infinite")]
    pub shortest_s: f64,
    /// Largest current of a record, A.
    pub greatest_a: f64,
    /// Most charge moved within one record, as a part of the capacity.
    pub widest_soc: f64,
    /// SOC to which resistances refer: the spectra's mean, otherwise the records'.
    pub soc: f64,
    /// Temperature that resistances refer to, °C.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: f64,
    /// Span of run orders; zero where all are equal.
    pub orders: f64,
    /// Span of the runs' start times, s.
    pub span_s: f64,
    /// Error of the predictions of held-out runs; none without such runs, and in older files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out: Option<HeldOutError>,
}

/// Error of the predictions of runs in which nothing was fitted.
///
/// A run of another sample of the same kind is inside the band of all n runs with a probability of n/(n + 1),
/// because its own share is as likely as any other to be the largest (split conformal prediction, Vovk 2005).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldOutError {
    /// Number of runs.
    pub runs: usize,
    /// Half width of the band that holds all of them, over [`HeldOutError::moved_v`].
    pub share: f64,
}

impl HeldOutError {
    /// Movement of a voltage that has not moved, V: so much of the error is there at rest.
    const STILL_V: f64 = 0.02;

    /// Returns how far the voltages of a run have moved at each row: the largest distance from the first so
    /// far, V, and 20 mV.
    pub fn moved_v(voltage_v: &[f64]) -> Vec<f64> {
        let mut most_v = 0.0_f64;
        let moved = |v: &f64| {
            most_v = most_v.max((v - voltage_v[0]).abs());
            most_v + Self::STILL_V
        };
        voltage_v.iter().map(moved).collect()
    }

    /// Returns the probability with which the band holds a whole run.
    pub fn probability(&self) -> f64 {
        let runs = self.runs as f64;
        runs / (runs + 1.0)
    }
}

impl Facts {
    /// Facts of no data at all.
    pub const NONE: Self = Self {
        lowest_hz: None,
        highest_hz: None,
        longest_s: 0.0,
        shortest_s: f64::INFINITY,
        greatest_a: 0.0,
        widest_soc: 0.0,
        soc: 0.5,
        temperature_degc: 25.0,
        orders: 0.0,
        span_s: 0.0,
        held_out: None,
    };

    /// Longest time that anything in the data lasts, s: a record or a period.
    pub(crate) fn slowest_s(&self) -> f64 {
        self.longest_s.max(self.lowest_hz.map_or(0.0, |f| 1.0 / f))
    }

    /// Shortest time that the data resolve, s: a sample or a tenth of a period, about 1/ω.
    pub(crate) fn fastest_s(&self) -> f64 {
        self.shortest_s
            .min(self.highest_hz.map_or(f64::INFINITY, |f| 0.1 / f))
    }
}

/// JSON has no infinity and writes null.
fn null_is_infinite<'de, D: serde::Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(<Option<f64> as serde::Deserialize>::deserialize(from)?.unwrap_or(f64::INFINITY))
}

/// One point of a spectrum and the circumstances of its run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Amplitude of the current, A; `None` if it is not stated.
    pub amplitude_a: Option<f64>,
    /// Direct current under the sweep, A, discharge positive.
    pub bias_a: f64,
    /// Time for which the direct current has flowed, s; [`Point::HELD_S`] where it is not known.
    pub held_s: f64,
    /// SOC of the run.
    pub soc: f64,
    /// Temperature of the run, °C.
    pub temperature_degc: f64,
    /// Order of the run in time, 0 for the first.
    pub order: f64,
    /// Start of the run since the start of the campaign, s. For a point whose time within the sweep
    /// is recorded, that time.
    pub start_s: f64,
    /// False for a control impedance in the jig: only the bench acts then.
    pub is_cell: bool,
    /// Impedance below the swept object.
    pub common_mode: CommonModeImpedance,
}

/// Impedance between the lower tap of the swept object and the ground of the channels; zero if a
/// channel measures the difference of both taps.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CommonModeImpedance {
    /// Resistance, Ω.
    pub r_ohm: f64,
    /// Inductance, H.
    pub l_h: f64,
}

impl Point {
    /// Time for which a direct current has flowed where it is not known, s.
    pub const HELD_S: f64 = 60.0;
}

impl CommonModeImpedance {
    /// Its impedance, Ω.
    pub fn impedance(&self, freq_hz: f64) -> Complex64 {
        Complex64::new(self.r_ohm, std::f64::consts::TAU * freq_hz * self.l_h)
    }
}

/// One record in time and the circumstances of its run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record<'a> {
    /// Time since the start of the record, s.
    pub time_s: &'a [f64],
    /// Logged current, A, discharge positive.
    pub current_a: &'a [f64],
    /// SOC at the start.
    pub soc: f64,
    /// Temperature of the run, °C.
    pub temperature_degc: f64,
    /// Order of the run in time, 0 for the first.
    pub order: f64,
    /// Start of the run since the start of the campaign, s.
    pub start_s: f64,
    /// False for a control impedance in the jig.
    pub is_cell: bool,
    /// Charge that the runs before it and what went on between them moved through the cell, in the
    /// order of time.
    pub before: &'a [Moved],
}

/// Charge that went through a cell.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moved {
    /// Net charge put into the cell, C.
    pub charge_coulomb: f64,
    /// Total charge moved in both directions, C. It is the size of the net charge if there was no
    /// reversal, and more for the swings of a sweep.
    pub through_coulomb: f64,
}

impl Moved {
    /// Returns a charge without a reversal, C.
    pub fn one_way(charge_coulomb: f64) -> Self {
        Self {
            charge_coulomb,
            through_coulomb: charge_coulomb.abs(),
        }
    }
}

/// One moment within a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instant {
    /// Time since the start of the record, s.
    pub time_s: f64,
    /// Current through the cell, A, discharge positive.
    pub current_a: f64,
    /// SOC.
    pub soc: f64,
    /// OCV at this SOC, V.
    pub ocv_v: f64,
    /// dOCV/dSOC at this SOC, V.
    pub slope_v: f64,
    /// Overpotential: the drop of current and branches from the OCV, V, positive under discharge.
    pub overpotential_v: f64,
    /// Power into the capacitances of the branches, W; negative if they return it to their
    /// resistances.
    pub stored_w: f64,
}

impl Instant {
    /// Returns the power that the resistances turn into heat, W.
    pub fn heat_w(&self) -> f64 {
        self.current_a * self.overpotential_v - self.stored_w
    }
}

/// Factors on resistances. Capacitances stay, so that a branch's time constant follows its
/// resistance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Modulation {
    /// On the series resistance.
    pub series: f64,
    /// On the resistances of all branches.
    pub branches: f64,
}

impl Modulation {
    /// No change.
    pub const NONE: Self = Self {
        series: 1.0,
        branches: 1.0,
    };

    /// Returns the same factor on everything.
    pub fn all(factor: f64) -> Self {
        Self {
            series: factor,
            branches: factor,
        }
    }

    /// Returns the change of the impedance of a base, Ω.
    pub(crate) fn change_ohm(self, erm: &Erm, freq_hz: f64) -> Complex64 {
        let series = Complex64::from((self.series - 1.0) * erm.r_ohm);
        erm.branches.iter().fold(series, |sum, b| {
            let scaled = RcBranch {
                r_ohm: b.r_ohm * self.branches,
                c_f: b.c_f,
            };
            sum + scaled.impedance(freq_hz) - b.impedance(freq_hz)
        })
    }
}
