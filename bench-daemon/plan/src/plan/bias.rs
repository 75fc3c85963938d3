//! A direct current under the sinusoids of a sweep, as data: its ramps, and the return of the charge
//! that it moves.

use std::fmt;

use instruments::units::{Amps, Coulombs, Kelvins, Ohms, Seconds, Volts, Watts};

use super::minutes;
use crate::interlock::Limits;

/// Greatest step of a ramp, A.
const RAMP_STEP_A: Amps = Amps(1.0);
/// Time between two steps of a ramp, s.
pub const RAMP_STEP_S: Seconds = Seconds(0.2);
/// Time for the records of the channels at one direct current, s.
const FRAMES_S: Seconds = Seconds(6.0);
/// Heat capacity of a cylindrical cell per capacity, J/K per Ah: 70 g of 0.95 J/(g·K) for 4.5 Ah.
const HEAT_J_PER_K_AH: f64 = 14.8;
/// Time constant with which a cell gives its heat to still air, s.
const COOLING_S: Seconds = Seconds(600.0);

/// A change of the direct current under the sinusoids of a stage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bias {
    /// Direct current before, A, charge positive.
    pub from_a: Amps,
    /// Direct current after, A.
    pub to_a: Amps,
    /// Wait after it, s.
    pub settle_s: Seconds,
    /// Greatest amplitude of a sinusoid of the run, A: it determines the ranges of the scope.
    pub amplitude_a: Amps,
    /// Greatest resistance of the cell, leads included, Ω.
    pub resistance_ohm: Ohms,
    /// Greatest charge that may be away from the cell, or in it, since its start, C.
    pub most_coulomb: Coulombs,
    /// Capacity of the cell, C.
    pub capacity_coulomb: Coulombs,
}

/// Return of the charge that a direct current has moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recharge {
    /// Greatest direct current, A, against that of the sweep.
    pub current_a: Amps,
    /// Expected charge, C, positive.
    pub charge_coulomb: Coulombs,
    /// Greatest charge that may remain, C.
    pub within_coulomb: Coulombs,
    /// Upper bound of the time at the current, s.
    pub max_s: Seconds,
}

impl Bias {
    /// Returns the duration of the ramp, s.
    pub fn ramp_s(&self) -> Seconds {
        ramp_steps(self.from_a, self.to_a) as f64 * RAMP_STEP_S
    }

    /// Returns the expected duration, s.
    pub fn expected_s(&self) -> Seconds {
        let held_s = if self.to_a == Amps::ZERO {
            Seconds::ZERO
        } else {
            self.settle_s + FRAMES_S
        };
        self.ramp_s() + held_s
    }

    /// Returns by how much the direct current and a sinusoid warm the cell at most, K: in still air,
    /// after any time.
    pub fn rise_k(&self) -> Kelvins {
        let most_a = self.from_a.abs().max(self.to_a.abs());
        let squares = most_a.value().powi(2) + 0.5 * self.amplitude_a.value().powi(2);
        let heat_j = Watts(squares * self.resistance_ohm.value()) * COOLING_S;
        Kelvins(heat_j.value() / (HEAT_J_PER_K_AH * self.capacity_coulomb.value() / 3600.0))
    }

    /// Returns the lowest and highest voltage of the cell relative to its rest, V: by its resistance
    /// and by the charge that the direct current may move. A charge moves the voltage at rest by its
    /// share of the capacity, times the cell's voltage window, doubled because the curve is steeper
    /// in places.
    pub fn swing_v(&self, limits: &Limits) -> (Volts, Volts) {
        let window_v = 2.0 * (limits.max_v - limits.min_v);
        let drift_v =
            Volts(window_v.value() * self.most_coulomb.value() / self.capacity_coulomb.value());
        let (least_a, greatest_a) = self.extremes_a();
        let beyond_v = |amps: Amps, charges: bool| {
            let drift_v = if charges { drift_v } else { Volts::ZERO };
            drift_v + self.resistance_ohm * amps.max(Amps::ZERO)
        };
        let charging = self.from_a.max(self.to_a) > Amps::ZERO;
        let discharging = self.from_a.min(self.to_a) < Amps::ZERO;
        (
            -beyond_v(-least_a, discharging),
            beyond_v(greatest_a, charging),
        )
    }

    /// Returns the least and greatest current of the ramp with a sinusoid, A.
    fn extremes_a(&self) -> (Amps, Amps) {
        let (low_a, high_a) = (self.from_a.min(self.to_a), self.from_a.max(self.to_a));
        (
            low_a.min(Amps::ZERO) - self.amplitude_a,
            high_a.max(Amps::ZERO) + self.amplitude_a,
        )
    }

    /// Returns an error if the direct current could exceed the limits of the cell.
    pub(super) fn check(&self, limits: &Limits) -> Result<(), String> {
        check_sine(self.to_a, self.amplitude_a.min(limits.charge_a), limits)?;
        let (down_v, up_v) = self.swing_v(limits);
        let (window_v, swing_v) = (limits.max_v - limits.min_v, up_v - down_v);
        if swing_v > window_v {
            return Err(format!(
                "expected a swing of the cell's voltage of at most {window_v:.3} ({} to {}), \
                found {swing_v:.3} by resistance and charge at worst",
                limits.min_v, limits.max_v
            ));
        }
        Ok(())
    }
}

impl fmt::Display for Bias {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (from_a, to_a) = (self.from_a, self.to_a);
        if to_a == Amps::ZERO {
            return write!(f, "ramp the direct current from {from_a:+} to 0 A");
        }
        write!(
            f,
            "ramp the direct current to {to_a:+}, settle {:.0} s: at most {:.0} C, and {:.1} K of \
            warming",
            self.settle_s.0,
            self.most_coulomb.0,
            self.rise_k().0
        )
    }
}

impl fmt::Display for Recharge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "bring back about {:.0} C with at most {:+} A to within {:.1} C, at most {}",
            self.charge_coulomb.0,
            self.current_a.0,
            self.within_coulomb.0,
            minutes(self.max_s)
        )
    }
}

/// Returns the number of steps of a ramp.
pub fn ramp_steps(from_a: Amps, to_a: Amps) -> usize {
    ((to_a - from_a).abs() / RAMP_STEP_A).ceil().max(1.0) as usize
}

/// Returns an error if a sinusoid about a direct current exceeds the limits of the cell.
pub(super) fn check_sine(bias_a: Amps, amplitude_a: Amps, limits: &Limits) -> Result<(), String> {
    let (least_a, greatest_a) = (bias_a - amplitude_a, bias_a + amplitude_a);
    if -least_a <= limits.discharge_a && greatest_a <= limits.charge_a {
        return Ok(());
    }
    Err(format!(
        "expected currents within -{} A to {} A, the limits of the cell, found {least_a} to \
        {greatest_a}",
        limits.discharge_a.0, limits.charge_a.0
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use instruments::units::Celsius;

    const LIMITS: Limits = Limits {
        min_v: Volts(2.5),
        max_v: Volts(4.2),
        charge_a: Amps(13.5),
        discharge_a: Amps(45.0),
        min_degc: Celsius(0.0),
        max_degc: Celsius(60.0),
    };
    const BIAS: Bias = Bias {
        from_a: Amps(0.0),
        to_a: Amps(5.0),
        settle_s: Seconds(30.0),
        amplitude_a: Amps(1.0),
        resistance_ohm: Ohms(0.03),
        most_coulomb: Coulombs(810.0),
        capacity_coulomb: Coulombs(16_200.0),
    };

    #[test]
    fn a_ramp_has_steps_of_an_ampere_and_its_swing_counts_charge_and_resistance() {
        assert_eq!(
            (
                ramp_steps(Amps(0.0), Amps(5.0)),
                ramp_steps(Amps(-2.5), Amps(0.0)),
                ramp_steps(Amps(0.0), Amps(0.1))
            ),
            (5, 3, 1)
        );
        assert!((BIAS.ramp_s() - Seconds(1.0)).abs() < Seconds(1.0e-12));
        // 5 % of the charge move at most 2 · 1.7 V · 5 %; 6 A and 1 A drop in 30 mΩ.
        let (down_v, up_v) = BIAS.swing_v(&LIMITS);
        assert!(
            (down_v + Volts(0.03)).abs() < Volts(1.0e-9)
                && (up_v - Volts(0.17 + 0.18)).abs() < Volts(1.0e-9),
            "{down_v}, {up_v}"
        );
        let (down_v, up_v) = Bias {
            to_a: Amps(-5.0),
            ..BIAS
        }
        .swing_v(&LIMITS);
        assert!(
            (down_v + Volts(0.35)).abs() < Volts(1.0e-9)
                && (up_v - Volts(0.03)).abs() < Volts(1.0e-9)
        );
        // (25 + 0.5) A² · 30 mΩ · 600 s over 66.6 J/K.
        assert!(
            (BIAS.rise_k() - Kelvins(6.892)).abs() < Kelvins(1.0e-3),
            "{}",
            BIAS.rise_k().0
        );
    }

    #[test]
    fn both_ends_of_a_sinusoid_about_a_direct_current_keep_the_limits() {
        for (bias_a, sound) in [(12.5, true), (12.6, false), (-44.0, true), (-44.1, false)] {
            assert_eq!(
                check_sine(Amps(bias_a), Amps(1.0), &LIMITS).is_ok(),
                sound,
                "{bias_a} A"
            );
        }
        let message = Bias {
            resistance_ohm: Ohms(0.3),
            ..BIAS
        }
        .check(&LIMITS)
        .unwrap_err();
        assert_eq!(
            message,
            "expected a swing of the cell's voltage of at most 1.700 V (2.5 V to 4.2 V), found \
            2.270 V by resistance and charge at worst"
        );
    }
}
