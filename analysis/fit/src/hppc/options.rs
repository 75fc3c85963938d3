//! Options of the table, and why there is none.

use serde::Serialize;

use analysis_signal::series::SeriesError;

/// Voltage limits of the cell.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limits {
    /// Lowest voltage, V.
    pub min_v: f64,
    /// Highest voltage, V.
    pub max_v: f64,
}

/// Options of [`hppc`](super::hppc).
#[derive(Debug, Clone, PartialEq)]
pub struct HppcOptions {
    /// Times after the start of a pulse, s.
    pub at_s: Vec<f64>,
    /// Limits for the power; without them no power is computed.
    pub limits: Option<Limits>,
    /// Shortest rest before a pulse, s.
    pub rest_s: f64,
    /// Relative standard uncertainty of the current's gain. A log does not show it.
    pub current_gain: f64,
    /// Whether the log has a row where the current begins. Otherwise the current may begin up to the
    /// first row of the pulse, and that is part of the uncertainty.
    pub start_logged: bool,
}

impl Default for HppcOptions {
    fn default() -> Self {
        Self {
            at_s: vec![0.1, 1.0, 2.0, 5.0, 10.0],
            limits: None,
            rest_s: 10.0,
            current_gain: 0.0,
            start_logged: false,
        }
    }
}

impl HppcOptions {
    pub(super) fn check(&self) -> Result<(), HppcError> {
        let times = !self.at_s.is_empty()
            && self.at_s.iter().all(|t| t.is_finite() && *t > 0.0)
            && self.at_s.windows(2).all(|pair| pair[0] < pair[1]);
        if !times {
            return Err(HppcError::Times {
                met: self.at_s.clone(),
            });
        }
        if let Some(Limits { min_v, max_v }) = self.limits
            && !(min_v > 0.0 && min_v < max_v && max_v.is_finite())
        {
            return Err(HppcError::Limits { min_v, max_v });
        }
        if !(0.0..1.0).contains(&self.current_gain) {
            return Err(HppcError::Gain {
                met: self.current_gain,
            });
        }
        if !(self.rest_s >= 0.0 && self.rest_s.is_finite()) {
            return Err(HppcError::Rest { met: self.rest_s });
        }
        Ok(())
    }
}

/// Reason why a table cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum HppcError {
    /// Times that are no list of times.
    #[error("times of the table: expected rising times above 0 s, found {met:?}")]
    Times {
        /// The times.
        met: Vec<f64>,
    },
    /// Voltage limits that cannot be.
    #[error(
        "voltage limits: expected a lowest voltage above 0 V and a highest above it, found {min_v} V \
         and {max_v} V"
    )]
    Limits {
        /// Lowest voltage, V.
        min_v: f64,
        /// Highest voltage, V.
        max_v: f64,
    },
    /// An uncertainty that cannot be.
    #[error(
        "uncertainty of the current's gain: expected a part from 0 to less than 1, found {met}"
    )]
    Gain {
        /// The value.
        met: f64,
    },
    /// A rest that cannot be.
    #[error("shortest rest: expected a time of 0 s or more, found {met} s")]
    Rest {
        /// The value, s.
        met: f64,
    },
    /// Numbers that are no log.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// A log without pulses.
    #[error(
        "{name}: expected at least one pulse: a constant current of up to {longest_s} s after a rest of \
         at least {rest_s} s, or on a steady current; found {found}"
    )]
    NoPulses {
        /// Name of the log.
        name: String,
        /// Longest pulse, s.
        longest_s: f64,
        /// Shortest rest, s.
        rest_s: f64,
        /// What the log holds, in words.
        found: String,
    },
}
