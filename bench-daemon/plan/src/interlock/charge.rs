//! The charge that the present step has moved, together with the steps that it continues.

use instruments::units::{Amps, Coulombs, Seconds};

use super::{
    allowance::Allowance,
    limits::{NET_CHARGE, NO_CURRENT_A, Reading, Trip},
};

/// Charge that is integrated reading by reading.
#[derive(Debug, Default)]
pub(super) struct ChargeCount {
    moved_coulomb: Coulombs,
    /// Charge that the commanded direct current has moved, C.
    planned_coulomb: Coulombs,
    /// Commanded direct current, A.
    steady_a: Amps,
    /// Reading of the ammeter while no current flows, A.
    zero_a: Amps,
    /// Last current, A, with its bench time, s.
    current: Option<(Amps, Seconds)>,
}

impl ChargeCount {
    /// Returns the charge so far, C, charge positive.
    pub(super) fn moved_coulomb(&self) -> Coulombs {
        self.moved_coulomb
    }

    /// Sets the reading of the ammeter with the output off, A, which counts as no charge. A
    /// reading beyond a zero error is replaced by 0.
    pub(super) fn zero(&mut self, zero_a: Amps) {
        self.zero_a = if zero_a.abs() <= NO_CURRENT_A {
            zero_a
        } else {
            Amps::ZERO
        };
    }

    /// Sets the direct current that is commanded from now on, A.
    pub(super) fn steady(&mut self, steady_a: Amps) {
        self.steady_a = steady_a;
    }

    /// Adds a reading by the trapezoidal rule.
    pub(super) fn count(&mut self, reading: &Reading) {
        let Some(current_a) = reading.current_a else {
            return;
        };
        if let Some((before_a, before_s)) = self.current.replace((current_a, reading.time_s)) {
            self.moved_coulomb +=
                (0.5 * (before_a + current_a) - self.zero_a) * (reading.time_s - before_s);
            self.planned_coulomb += self.steady_a * (reading.time_s - before_s);
        }
    }

    /// Judges the charge so far beside that of the commanded direct current.
    pub(super) fn judge(&self, allowance: &Allowance, time_s: Seconds) -> Option<Trip> {
        let net = self.moved_coulomb - self.planned_coulomb;
        let (least, greatest) = allowance.charge_coulomb;
        let trip = || Trip::outside(NET_CHARGE, net, &(least..=greatest), time_s);
        allowance.live.then(trip).flatten()
    }
}
