//! The zero of the scope's channels: their means without a current through a cell. The functions
//! are pure.

use instruments::units::{Amps, Volts};

use crate::interlock::NO_CURRENT_A;

/// Name of the quantity that trips.
pub const SINCE_ZERO: &str = "mean of the cell current since the zero of the channels";
/// Direct current that may accompany a sinusoid, as a share of its amplitude: generators are
/// specified to 0.25 % to 0.5 % (33500B, SDG1000X).
const OFFSET_SHARE: f64 = 0.01;

/// Returns the greatest mean of a record relative to the zero of the channels, A: the supply has
/// shown less than this before the first sinusoid.
pub fn allowed_since_zero_a(amplitude_a: Amps) -> Amps {
    NO_CURRENT_A + OFFSET_SHARE * amplitude_a
}

/// Means of C1 to C3 in one record, V, with their scales.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChannelMeans {
    /// Vertical scales, V per division.
    pub volts_per_div: [f64; 3],
    /// Means, V.
    pub volts: [Volts; 3],
}

/// Means of the channels without a current through a cell, one for each set of scales.
#[derive(Debug, Default)]
pub struct Zeros {
    means: Vec<ChannelMeans>,
    by_controls: bool,
}

impl Zeros {
    /// Stores the means of a record; the latest on a set of scales is used.
    pub fn keep(&mut self, means: ChannelMeans) {
        self.means
            .retain(|known| known.volts_per_div != means.volts_per_div);
        self.means.push(means);
    }

    /// Stores the means of a record of a control.
    pub fn keep_of_control(&mut self, means: ChannelMeans) {
        self.by_controls = true;
        self.keep(means);
    }

    /// Checks whether no control has shown the zero.
    pub fn lacks_controls(&self) -> bool {
        !self.by_controls
    }

    /// Returns the zero on these scales of the shunt's channels, if possible with the same scale
    /// of C3.
    pub fn on(&self, means: &ChannelMeans) -> Option<&ChannelMeans> {
        let same = |known: &&ChannelMeans| known.volts_per_div[..2] == means.volts_per_div[..2];
        let whole = |known: &&ChannelMeans| known.volts_per_div == means.volts_per_div;
        self.means
            .iter()
            .find(whole)
            .or_else(|| self.means.iter().rfind(same))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_zero_belongs_to_its_scales_and_the_latest_counts() {
        let means = |scales: [f64; 3], zero_v: Volts| ChannelMeans {
            volts_per_div: scales,
            volts: [zero_v; 3],
        };
        let mut zeros = Zeros::default();
        zeros.keep(means([0.02, 0.02, 0.04], Volts(1.0)));
        zeros.keep(means([0.02, 0.02, 0.08], Volts(2.0)));
        zeros.keep(means([0.02, 0.02, 0.04], Volts(3.0)));
        let on = |scales| {
            zeros
                .on(&means(scales, Volts(0.0)))
                .map(|zero| zero.volts[0])
        };
        assert_eq!(on([0.02, 0.02, 0.08]), Some(Volts(2.0)));
        assert_eq!(on([0.02, 0.02, 0.16]), Some(Volts(3.0)));
        assert_eq!(on([0.02, 0.04, 0.04]), None);
        assert_eq!(allowed_since_zero_a(Amps(3.0)), Amps(0.13));
        assert!(zeros.lacks_controls());
        zeros.keep_of_control(means([0.04, 0.04, 0.04], Volts(4.0)));
        assert!(!zeros.lacks_controls());
    }
}
