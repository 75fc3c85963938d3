//! The section `[multisine]` as it is typed.

use serde::Deserialize;

use super::quantity::{Current, Duration, Frequency, Quantity, Resistance, Share};

/// Records of many frequencies at once; the bench needs a generator that plays waves.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Raw {
    /// Peak of the current, from 0.01 A to the smallest limit of supply and cell.
    pub(super) peak: Quantity<Current>,
    /// Number of times that all bands are measured, 1 to 1000.
    #[serde(default = "one")]
    pub(super) repeat: usize,
    /// Rest of the cell before each, 0 s to 86 400 s. Left out: no rest.
    pub(super) rest_first: Option<Quantity<Duration>>,
    /// Bands, at least one; they rise and do not overlap.
    pub(super) bands: Vec<RawBand>,
    /// Points in the memory of the scope per channel, 1000 to 10 000 000.
    #[serde(default = "million")]
    pub(super) memory_points: u64,
    /// Points of a record downloaded per channel, 1000 to `memory_points`. The fastest line needs 8
    /// samples a period.
    #[serde(default = "hundred_thousand")]
    pub(super) record_points: u64,
    /// Quality gate that every line must pass. Left out: no line is judged.
    pub(super) quality: Option<super::raw_quality::Raw>,
    /// Direct currents under the multisine, all different, positive for a charge, as `bias` of `[eis]`.
    /// Left out: no direct current.
    pub(super) bias: Option<Vec<Quantity<Current>>>,
    /// Largest charge that a direct current may move, as a share of the capacity, 0.1 % to 20 %, with
    /// `operando` to 40 %; then it is brought back. Left out: 5 %.
    pub(super) bias_charge: Option<Quantity<Share>>,
    /// Highest resistance of the cell, leads to the voltmeter included, 0.1 mΩ to 1 Ω. It bounds
    /// voltage and heat under a direct current. Left out: `bias` may only be 0 A.
    pub(super) resistance_max: Option<Quantity<Resistance>>,
    /// Wait at a direct current before the first band, 5 s to 3600 s. Left out: 30 s.
    pub(super) bias_settle: Option<Quantity<Duration>>,
    /// Whether all bands are repeated under one direct current until it has moved `bias_charge`: the
    /// impedance along a charge or discharge.
    #[serde(default)]
    pub(super) operando: bool,
}

/// Band of frequencies, recorded at once.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawBand {
    /// Base frequency, 1 mHz to 1000 Hz; the lines are odd multiples of it.
    pub(super) base: Quantity<Frequency>,
    /// Lowest frequency of a line, `base` or more. Left out: `base`.
    pub(super) start: Option<Quantity<Frequency>>,
    /// Highest frequency of a line, up to the limits of generator and supply.
    pub(super) stop: Quantity<Frequency>,
    /// Number of lines, 2 to 200.
    pub(super) lines: usize,
    /// Number of periods of `base` in the record, 3 to 1000. They must fill a screen of the scope.
    pub(super) periods: u32,
    /// Wait before the record, 0 s to 3600 s.
    pub(super) settle: Quantity<Duration>,
}

fn one() -> usize {
    1
}
fn million() -> u64 {
    1_000_000
}
fn hundred_thousand() -> u64 {
    100_000
}
