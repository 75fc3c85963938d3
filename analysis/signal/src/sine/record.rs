//! Samples that a fit reads, and how few are too few.

use super::{code_scale::CodeScale, stored::Stored};

/// Minimum number of periods in a record that a fit accepts: below it, sine, offset and drift
/// cannot be separated reliably.
pub const MIN_PERIODS: f64 = 1.4;

/// Fewest usable samples of a channel that a fit accepts.
pub const MIN_SAMPLES: usize = 10;

/// Samples of one or more channels taken at the same instants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record<'a> {
    /// The channels, all of one length.
    pub channels: &'a [Channel<'a>],
    /// Time between two samples, s.
    pub interval_s: f64,
}

/// Samples of one channel, borrowed, or read from where they are stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Channel<'a> {
    /// Volts.
    Volts {
        /// The samples, V.
        samples: &'a [f64],
        /// Step of the quantisation, V; `None` if it is negligible.
        lsb_v: Option<f64>,
        /// Samples at or beyond these bounds are clipped; V.
        range_v: Option<(f64, f64)>,
    },
    /// ADC codes with their scaling.
    Codes {
        /// The samples, codes.
        codes: &'a [i16],
        /// Conversion of the codes to volts.
        scale: CodeScale,
    },
    /// Samples that are kept elsewhere: read by pieces, whenever they are summed over, so that a
    /// record may be larger than the memory.
    Stored(Stored<'a>),
}

impl<'a> Channel<'a> {
    /// Volts without quantisation and without bounds.
    pub const fn volts(samples: &'a [f64]) -> Self {
        Self::Volts {
            samples,
            lsb_v: None,
            range_v: None,
        }
    }

    /// ADC codes.
    pub const fn codes(codes: &'a [i16], scale: CodeScale) -> Self {
        Self::Codes { codes, scale }
    }

    /// Returns the number of samples.
    pub const fn len(&self) -> usize {
        match self {
            Self::Volts { samples, .. } => samples.len(),
            Self::Codes { codes, .. } => codes.len(),
            Self::Stored(stored) => stored.count,
        }
    }

    /// Returns whether the record has no samples.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
