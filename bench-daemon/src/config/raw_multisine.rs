//! The section `[multisine]` as it is typed.

use serde::Deserialize;

use super::quantity::{Current, Duration, Frequency, Quantity};

/// The section.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Raw {
    pub(super) peak: Quantity<Current>,
    #[serde(default = "one")]
    pub(super) repeat: usize,
    pub(super) rest_first: Option<Quantity<Duration>>,
    pub(super) bands: Vec<RawBand>,
    #[serde(default = "million")]
    pub(super) memory_points: u64,
    #[serde(default = "hundred_thousand")]
    pub(super) record_points: u64,
    pub(super) quality: Option<super::raw_quality::Raw>,
}

/// A band.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawBand {
    pub(super) base: Quantity<Frequency>,
    pub(super) start: Option<Quantity<Frequency>>,
    pub(super) stop: Quantity<Frequency>,
    pub(super) lines: usize,
    pub(super) periods: u32,
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
