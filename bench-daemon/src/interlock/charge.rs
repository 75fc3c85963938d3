//! Charge that the step in work has moved, with those before it that it continues.

use super::{
    allowance::Allowance,
    limits::{NET_CHARGE, NO_CURRENT_A, Reading, Trip},
};

/// Charge that is counted reading by reading.
#[derive(Debug, Default)]
pub(super) struct ChargeCount {
    moved_c: f64,
    /// Reading of the ammeter while no current flows, A.
    zero_a: f64,
    /// Current that was read last, with its bench time, s.
    current: Option<(f64, f64)>,
}

impl ChargeCount {
    /// Charge so far, C, charge positive.
    pub(super) fn moved_c(&self) -> f64 {
        self.moved_c
    }

    /// Sets the reading of the ammeter with the output off, A: that is no charge. A reading beyond
    /// a zero error is taken as 0.
    pub(super) fn zero(&mut self, zero_a: f64) {
        self.zero_a = if zero_a.abs() <= NO_CURRENT_A {
            zero_a
        } else {
            0.0
        };
    }

    /// Counts on by the trapezoidal rule.
    pub(super) fn count(&mut self, reading: &Reading) {
        let Some(current_a) = reading.current_a else {
            return;
        };
        if let Some((before_s, before_a)) = self.current.replace((reading.time_s, current_a)) {
            self.moved_c +=
                (0.5 * (before_a + current_a) - self.zero_a) * (reading.time_s - before_s);
        }
    }

    /// Judges the charge so far.
    pub(super) fn judge(&self, allowance: &Allowance, time_s: f64) -> Option<Trip> {
        let (value, (least, greatest)) = (self.moved_c, allowance.charge_c);
        let outside = allowance.live && !(least..=greatest).contains(&value);
        outside.then_some(Trip::Limit {
            what: NET_CHARGE,
            value,
            unit: "C",
            least,
            greatest,
            time_s,
        })
    }
}
