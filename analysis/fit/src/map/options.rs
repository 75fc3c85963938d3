//! Input of a fit of a map, and what can be wrong with it.

use analysis_model::ocv::OcvCurve;
use analysis_signal::series::{Role, TimeSeries};
use num_complex::Complex64;

/// A log, and its circumstances.
#[derive(Debug, Clone, PartialEq)]
pub struct MapLog {
    /// Current, voltage and temperature over time.
    pub series: TimeSeries,
    /// SOC at the first sample; `None` if the log begins at rest, so that the OCV gives it.
    pub soc_start: Option<f64>,
    /// Charge that went into the cell less charge that came out at each sample, Ah, by a counter of
    /// the recorder. It serves across gaps of the log.
    pub net_ah: Option<Vec<f64>>,
    /// Temperature of a log without a column for it, °C.
    pub temperature_degc: Option<f64>,
    /// Whether the log is fitted or predicted only.
    pub role: Role,
}

/// A spectrum at one state of the cell, without a direct current.
#[derive(Debug, Clone, PartialEq)]
pub struct MapSpectrum {
    /// Name for reports.
    pub name: String,
    /// Whether it is fitted or predicted only.
    pub role: Role,
    /// State of charge, 0…1.
    pub soc: f64,
    /// Temperature of the cell, °C.
    pub temperature_degc: f64,
    /// Its points, in any order.
    pub points: Vec<MapPoint>,
}

/// A point of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapPoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Impedance, Ω.
    pub z_ohm: Complex64,
    /// Standard uncertainty of its real and imaginary part, Ω, if it is stated.
    pub sigma_ohm: Option<f64>,
}

/// Form of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct MapOptions {
    /// SOC knots, rising, 0…1.
    pub soc: Vec<f64>,
    /// Time constants of the branches, s, rising. One that no log and no spectrum shows is left out.
    pub time_constants_s: Vec<f64>,
    /// Logs whose mean temperatures differ by less than this share a node, K.
    pub node_distance_k: f64,
    /// Temperature of the OCV curve, °C.
    pub ocv_temperature_degc: f64,
}

impl Default for MapOptions {
    fn default() -> Self {
        Self {
            soc: vec![
                0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0,
            ],
            time_constants_s: vec![
                0.0002, 0.0005, 0.002, 0.006, 0.02, 0.06, 0.3, 2.0, 10.0, 50.0, 300.0, 1500.0,
                6000.0,
            ],
            node_distance_k: 6.0,
            ocv_temperature_degc: 25.0,
        }
    }
}

impl MapOptions {
    /// Checks the options and the curve.
    pub(super) fn check(&self, ocv: &OcvCurve) -> Result<(), MapFitError> {
        ocv.validate()
            .map_err(|error| MapFitError::Curve(error.to_string()))?;
        let rises = |list: &[f64]| list.windows(2).all(|w| w[0] < w[1]);
        let within = self.soc.iter().all(|z| (0.0..=1.0).contains(z));
        if self.soc.len() < 2 || !rises(&self.soc) || !within {
            return Err(MapFitError::Option {
                what: "SOC knots",
                expected: "at least two from 0 to 1 that rise",
                met: format!("{:?}", self.soc),
            });
        }
        for (what, met, fits) in [
            (
                "distance of two nodes, K",
                self.node_distance_k,
                self.node_distance_k > 0.0,
            ),
            (
                "temperature of the OCV curve, °C",
                self.ocv_temperature_degc,
                true,
            ),
        ] {
            if !(fits && met.is_finite()) {
                let met = met.to_string();
                return Err(MapFitError::Option {
                    what,
                    expected: "a finite number, a distance above zero",
                    met,
                });
            }
        }
        let taus = &self.time_constants_s;
        if taus.iter().any(|tau| !(tau.is_finite() && *tau > 0.0)) || !rises(taus) {
            return Err(MapFitError::Option {
                what: "time constants",
                expected: "seconds above zero that rise",
                met: format!("{taus:?}"),
            });
        }
        Ok(())
    }
}

/// Reason why a map cannot be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MapFitError {
    /// The OCV curve.
    #[error("{0}")]
    Curve(String),
    /// An option.
    #[error("{what}: expected {expected}, met {met}")]
    Option {
        /// Which option.
        what: &'static str,
        /// Allowed values.
        expected: &'static str,
        /// Value found.
        met: String,
    },
    /// No log to fit.
    #[error("expected at least one log or spectrum to fit, found none")]
    NoLogs,
    /// A spectrum at a state of charge that no cell has.
    #[error("{name}: expected a state of charge from 0 to 1, met {met}")]
    Soc {
        /// Name of the spectrum.
        name: String,
        /// Value found.
        met: f64,
    },
    /// An impedance or an uncertainty that is not a number above zero.
    #[error("{name}: expected a finite impedance and uncertainty at {freq_hz} Hz, met another")]
    Impedance {
        /// Name of the spectrum.
        name: String,
        /// Frequency of the point, Hz.
        freq_hz: f64,
    },
    /// A series that is not one.
    #[error("{0}")]
    Series(String),
    /// A spectrum with too few points.
    #[error("{name}: expected at least {expected} points without an inductive part, met {met}")]
    FewPoints {
        /// Name of the spectrum.
        name: String,
        /// Points at least.
        expected: usize,
        /// Points found.
        met: usize,
    },
    /// A log without temperatures.
    #[error(
        "{log}: expected a column of temperatures, or one temperature for the log, found neither"
    )]
    Temperature {
        /// Name of the log.
        log: String,
    },
    /// A temperature that no cell has.
    #[error("{log}: expected temperatures of a cell from -60 to 120 °C, met {met} °C{hint}")]
    NoCell {
        /// Name of the log.
        log: String,
        /// Value found, °C.
        met: f64,
        /// The likely unit.
        hint: &'static str,
    },
    /// A log whose state at the start is not known.
    #[error(
        "{log}: its first sample carries {current_a:.3} A, so that the OCV curve does not give the \
        state of charge at its start; give that"
    )]
    Start {
        /// Name of the log.
        log: String,
        /// Current of the first sample, A.
        current_a: f64,
    },
    /// A rest voltage that the curve does not have.
    #[error(
        "{log}: rests at {time_s:.0} s at {met_v:.4} V, expected a voltage of the OCV curve, \
        {low_v:.4} to {high_v:.4} V; give the state of charge at its start"
    )]
    RestVoltage {
        /// Name of the log.
        log: String,
        /// Time of the rest, s.
        time_s: f64,
        /// Voltage there, V.
        met_v: f64,
        /// Lowest voltage of the curve, V.
        low_v: f64,
        /// Highest voltage of the curve, V.
        high_v: f64,
    },
    /// A gap after which the charge is not known.
    #[error(
        "{log}: has a gap before {time_s:.0} s, and a current flows after it, so that its charge is \
        not known; expected a rest after the gap, or a counter of the charge (a column of the net \
        capacity)"
    )]
    Gap {
        /// Name of the log.
        log: String,
        /// Time of the first sample after the gap, s.
        time_s: f64,
    },
    /// Charge that does not fit into the cell.
    #[error(
        "{log}: its charge does not close: SOC reaches {met:.3}, expected -0.1 to 1.1 with \
        {capacity_ah} Ah from SOC {start:.3}; check the capacity, the start and the gaps of the log"
    )]
    Charge {
        /// Name of the log.
        log: String,
        /// SOC found.
        met: f64,
        /// Capacity of the curve, Ah.
        capacity_ah: f64,
        /// SOC at the start.
        start: f64,
    },
    /// No current to learn from.
    #[error("{log}: expected a current, found none above 1 mA")]
    NoCurrent {
        /// Name of the log.
        log: String,
    },
    /// A voltage that does not fall under a discharge.
    #[error(
        "{log}: expected a voltage below the OCV curve under discharge and above it under charge, \
        found the opposite on average; check the state of charge at its start, the curve and the \
        direction of the current"
    )]
    NoLoss {
        /// Name of the first log of its temperature.
        log: String,
    },
    /// The equations have no unique solution.
    #[error("the logs do not determine the map: {0}")]
    Singular(&'static str),
}
