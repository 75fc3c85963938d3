//! A bench under examination.

use ::instruments::clock::Clock;

use super::{findings::Findings, scope};
use bench_core::bench::Bench;
use bench_plan::config;

/// A bench under examination.
pub struct Examination<'a> {
    /// The bench file.
    pub config: &'a config::Bench,
    /// Bench time.
    pub clock: Clock,
    /// The instruments.
    pub bench: Bench,
    /// Findings so far.
    pub findings: Findings,
    pub(super) scope: scope::Ranges,
    /// Voltages of channels 1 to 4 without current, V.
    pub(super) zero_v: [f64; 4],
}
