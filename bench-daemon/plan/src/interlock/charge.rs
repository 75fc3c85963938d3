//! The charge that the present step has moved, together with the steps that it continues.

use super::{
    allowance::Allowance,
    limits::{NET_CHARGE, NO_CURRENT_A, Reading, Trip},
};

/// Charge that is integrated reading by reading.
#[derive(Debug, Default)]
pub(super) struct ChargeCount {
    moved_coulomb: f64,
    /// Charge that the commanded direct current has moved, C.
    planned_coulomb: f64,
    /// Commanded direct current, A.
    steady_a: f64,
    /// Reading of the ammeter while no current flows, A.
    zero_a: f64,
    /// Last current, A, with its bench time, s.
    current: Option<(f64, f64)>,
}

impl ChargeCount {
    /// Returns the charge so far, C, charge positive.
    pub(super) fn moved_coulomb(&self) -> f64 {
        self.moved_coulomb
    }

    /// Sets the reading of the ammeter with the output off, A, which counts as no charge. A
    /// reading beyond a zero error is replaced by 0.
    pub(super) fn zero(&mut self, zero_a: f64) {
        self.zero_a = if zero_a.abs() <= NO_CURRENT_A {
            zero_a
        } else {
            0.0
        };
    }

    /// Sets the direct current that is commanded from now on, A.
    pub(super) fn steady(&mut self, steady_a: f64) {
        self.steady_a = steady_a;
    }

    /// Adds a reading by the trapezoidal rule.
    pub(super) fn count(&mut self, reading: &Reading) {
        let Some(current_a) = reading.current_a else {
            return;
        };
        if let Some((before_s, before_a)) = self.current.replace((reading.time_s, current_a)) {
            self.moved_coulomb +=
                (0.5 * (before_a + current_a) - self.zero_a) * (reading.time_s - before_s);
            self.planned_coulomb += self.steady_a * (reading.time_s - before_s);
        }
    }

    /// Judges the charge so far beside that of the commanded direct current.
    pub(super) fn judge(&self, allowance: &Allowance, time_s: f64) -> Option<Trip> {
        let value = self.moved_coulomb - self.planned_coulomb;
        let (least, greatest) = allowance.charge_coulomb;
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
