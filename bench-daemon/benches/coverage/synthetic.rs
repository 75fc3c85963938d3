//! Synthetic pulses with spectra, for the joint fit.

use crate::tally::Tally;

pub(crate) fn play(_seeds: &[u64]) -> Tally {
    Tally::default()
}
