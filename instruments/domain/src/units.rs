//! Newtypes for every quantity that protects a cell or is sent to an instrument, so that volts
//! cannot be compared with amperes or sent where amperes are meant. SI throughout. Only operations
//! that are physically right compile.
//!
//! ```
//! use instruments_domain::units::{Amps, Celsius, Coulombs, Seconds, Volts};
//!
//! let (limit, current) = (Volts(4.2), Amps(1.5));
//! assert_eq!(limit.to_string(), "4.2 V");
//! assert_eq!(current.value(), 1.5);
//! assert!(current * Seconds(10.0) > Coulombs(14.0));
//! assert_eq!((Celsius(25.5) - Celsius(25.0)).to_string(), "0.5 K");
//! ```
//!
//! A charge cannot be compared with a temperature:
//!
//! ```compile_fail,E0308
//! use instruments_domain::units::{Celsius, Coulombs};
//!
//! let trips = Coulombs(1000.0) > Celsius(60.0);
//! ```
//!
//! Two temperatures have no sum, because their zero is arbitrary:
//!
//! ```compile_fail,E0308
//! use instruments_domain::units::Celsius;
//!
//! let sum = Celsius(20.0) + Celsius(25.0);
//! ```

use std::{
    cmp::Ordering,
    fmt,
    iter::Sum,
    ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign},
};

/// A quantity with a unit.
pub trait Unit: Copy + PartialOrd {
    /// Symbol of the unit.
    const SYMBOL: &'static str;

    /// Wraps a bare number in SI.
    fn of(value: f64) -> Self;

    /// Returns the bare number in SI.
    fn number(self) -> f64;
}

/// A number without a unit.
impl Unit for f64 {
    const SYMBOL: &'static str = "";

    fn of(value: f64) -> Self {
        value
    }

    fn number(self) -> f64 {
        self
    }
}

macro_rules! unit {
    ($(#[$doc:meta])* $name:ident, $symbol:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, PartialOrd, Default, serde::Serialize, serde::Deserialize)]
        #[serde(transparent)]
        pub struct $name(pub f64);

        impl $name {
            /// Above every value.
            pub const INFINITY: Self = Self(f64::INFINITY);
            /// Below every value.
            pub const NEG_INFINITY: Self = Self(f64::NEG_INFINITY);
            /// Not a number.
            pub const NAN: Self = Self(f64::NAN);

            /// The bare number in SI.
            pub const fn value(self) -> f64 {
                self.0
            }

            /// Returns the smaller of two values.
            #[must_use]
            pub const fn min(self, other: Self) -> Self {
                Self(self.0.min(other.0))
            }

            /// Returns the greater of two values.
            #[must_use]
            pub const fn max(self, other: Self) -> Self {
                Self(self.0.max(other.0))
            }

            /// Returns the nearest value between two limits.
            #[must_use]
            pub fn clamp(self, least: Self, greatest: Self) -> Self {
                Self(self.0.clamp(least.0, greatest.0))
            }

            /// Checks whether the value is neither infinite nor NaN.
            pub const fn is_finite(self) -> bool {
                self.0.is_finite()
            }

            /// Checks whether the value is not a number.
            pub const fn is_nan(self) -> bool {
                self.0.is_nan()
            }

            /// Compares two values in a total order.
            pub fn total_cmp(&self, other: &Self) -> Ordering {
                self.0.total_cmp(&other.0)
            }
        }

        impl Unit for $name {
            const SYMBOL: &'static str = $symbol;

            fn of(value: f64) -> Self {
                Self(value)
            }

            fn number(self) -> f64 {
                self.0
            }
        }

        /// Shows the bare number, because a run knows the stages of its plan by this text.
        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Debug::fmt(&self.0, f)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(&self.0, f)?;
                f.write_str(concat!(" ", $symbol))
            }
        }
    };
}

/// A quantity with a natural zero: it has sums, multiples and ratios.
macro_rules! linear {
    ($(#[$doc:meta])* $name:ident, $symbol:literal) => {
        unit!($(#[$doc])* $name, $symbol);

        impl $name {
            /// Nothing of it.
            pub const ZERO: Self = Self(0.0);

            /// Returns the value without its sign.
            #[must_use]
            pub const fn abs(self) -> Self {
                Self(self.0.abs())
            }
        }

        impl Add for $name {
            type Output = Self;

            fn add(self, other: Self) -> Self {
                Self(self.0 + other.0)
            }
        }

        impl Sub for $name {
            type Output = Self;

            fn sub(self, other: Self) -> Self {
                Self(self.0 - other.0)
            }
        }

        impl AddAssign for $name {
            fn add_assign(&mut self, other: Self) {
                self.0 += other.0;
            }
        }

        impl SubAssign for $name {
            fn sub_assign(&mut self, other: Self) {
                self.0 -= other.0;
            }
        }

        impl Neg for $name {
            type Output = Self;

            fn neg(self) -> Self {
                Self(-self.0)
            }
        }

        impl Sum for $name {
            fn sum<I: Iterator<Item = Self>>(values: I) -> Self {
                Self(values.map(Self::value).sum())
            }
        }

        impl Mul<f64> for $name {
            type Output = Self;

            fn mul(self, factor: f64) -> Self {
                Self(self.0 * factor)
            }
        }

        impl Mul<$name> for f64 {
            type Output = $name;

            fn mul(self, value: $name) -> $name {
                $name(self * value.0)
            }
        }

        impl Div<f64> for $name {
            type Output = Self;

            fn div(self, divisor: f64) -> Self {
                Self(self.0 / divisor)
            }
        }

        impl Div for $name {
            type Output = f64;

            fn div(self, other: Self) -> f64 {
                self.0 / other.0
            }
        }
    };
}

/// Two quantities whose product is a third.
macro_rules! product {
    ($one:ident * $other:ident = $product:ident) => {
        impl Mul<$other> for $one {
            type Output = $product;

            fn mul(self, other: $other) -> $product {
                $product(self.0 * other.0)
            }
        }

        impl Mul<$one> for $other {
            type Output = $product;

            fn mul(self, one: $one) -> $product {
                $product(self.0 * one.0)
            }
        }

        impl Div<$one> for $product {
            type Output = $other;

            fn div(self, one: $one) -> $other {
                $other(self.0 / one.0)
            }
        }

        impl Div<$other> for $product {
            type Output = $one;

            fn div(self, other: $other) -> $one {
                $one(self.0 / other.0)
            }
        }
    };
}

linear!(
    /// Electric potential, V.
    Volts,
    "V"
);
linear!(
    /// Electric current, A.
    Amps,
    "A"
);
linear!(
    /// Electric charge, C.
    Coulombs,
    "C"
);
linear!(
    /// Frequency, Hz.
    Hertz,
    "Hz"
);
linear!(
    /// Time, s.
    Seconds,
    "s"
);
unit!(
    /// Temperature, °C.
    Celsius,
    "°C"
);
linear!(
    /// Difference of two temperatures, K.
    Kelvins,
    "K"
);
linear!(
    /// Rate of a temperature, K/s.
    KelvinsPerSecond,
    "K/s"
);
linear!(
    /// Resistance, Ω.
    Ohms,
    "Ω"
);
linear!(
    /// Power, W.
    Watts,
    "W"
);
linear!(
    /// Energy, J.
    Joules,
    "J"
);

product!(Amps * Seconds = Coulombs);
product!(Amps * Ohms = Volts);
product!(Volts * Amps = Watts);
product!(Watts * Seconds = Joules);
product!(KelvinsPerSecond * Seconds = Kelvins);

impl Sub for Celsius {
    type Output = Kelvins;

    fn sub(self, other: Self) -> Kelvins {
        Kelvins(self.0 - other.0)
    }
}

impl Add<Kelvins> for Celsius {
    type Output = Self;

    fn add(self, rise: Kelvins) -> Self {
        Self(self.0 + rise.0)
    }
}

impl Sub<Kelvins> for Celsius {
    type Output = Self;

    fn sub(self, fall: Kelvins) -> Self {
        Self(self.0 - fall.0)
    }
}

/// The time of a number of periods.
impl Div<Hertz> for f64 {
    type Output = Seconds;

    fn div(self, frequency: Hertz) -> Seconds {
        Seconds(self / frequency.0)
    }
}

/// The frequency of a number of periods in a time.
impl Div<Seconds> for f64 {
    type Output = Hertz;

    fn div(self, time: Seconds) -> Hertz {
        Hertz(self / time.0)
    }
}

/// A number of periods.
impl Mul<Seconds> for Hertz {
    type Output = f64;

    fn mul(self, time: Seconds) -> f64 {
        self.0 * time.0
    }
}

/// A number of periods.
impl Mul<Hertz> for Seconds {
    type Output = f64;

    fn mul(self, frequency: Hertz) -> f64 {
        self.0 * frequency.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantity_has_sums_multiples_and_ratios() {
        let mut current = Amps(2.0) + Amps(1.0) - Amps(0.5);
        current += Amps(0.5);
        current -= Amps(1.0);
        assert_eq!(current, Amps(2.0));
        assert_eq!(
            (-current, current.abs(), (-current).abs()),
            (Amps(-2.0), current, current)
        );
        assert_eq!(
            (current * 2.0, 3.0 * current, current / 4.0),
            (Amps(4.0), Amps(6.0), Amps(0.5))
        );
        assert_eq!(current / Amps(8.0), 0.25);
        assert_eq!([Amps(1.0), Amps(2.5)].into_iter().sum::<Amps>(), Amps(3.5));
    }

    #[test]
    fn a_quantity_is_ordered_like_its_number() {
        assert_eq!(
            (Volts(1.0).min(Volts(2.0)), Volts(1.0).max(Volts(2.0))),
            (Volts(1.0), Volts(2.0))
        );
        assert_eq!(Volts(5.0).clamp(Volts(2.5), Volts(4.2)), Volts(4.2));
        assert!(!(Volts(2.5)..=Volts(4.2)).contains(&Volts::NAN) && Volts::NAN.is_nan());
        assert!(
            Volts(4.2).is_finite()
                && !Volts::INFINITY.is_finite()
                && Volts::NEG_INFINITY < Volts(0.0)
        );
        assert_eq!(Volts(1.0).total_cmp(&Volts::NAN), Ordering::Less);
        assert_eq!((Volts::SYMBOL, Volts::of(4.2).number()), ("V", 4.2));
    }

    #[test]
    fn a_quantity_is_shown_with_its_unit_and_debugged_as_a_bare_number() {
        assert_eq!(format!("{:+.2}", Amps(1.5)), "+1.50 A");
        assert_eq!(format!("{:?}", Some(Amps(1.0))), "Some(1.0)");
    }

    #[test]
    fn products_have_the_unit_of_physics() {
        assert_eq!(
            (Amps(2.0) * Seconds(3.0), Seconds(3.0) * Amps(2.0)),
            (Coulombs(6.0), Coulombs(6.0))
        );
        assert_eq!(
            (Coulombs(6.0) / Seconds(3.0), Coulombs(6.0) / Amps(2.0)),
            (Amps(2.0), Seconds(3.0))
        );
        assert_eq!(
            (Volts(6.0) / Amps(2.0), Amps(2.0) * Ohms(3.0)),
            (Ohms(3.0), Volts(6.0))
        );
        assert_eq!(
            (Volts(6.0) * Amps(2.0), Watts(12.0) * Seconds(2.0)),
            (Watts(12.0), Joules(24.0))
        );
        assert_eq!(Kelvins(6.0) / Seconds(3.0), KelvinsPerSecond(2.0));
        assert_eq!(
            (1.0 / Hertz(4.0), 1.0 / Seconds(0.25)),
            (Seconds(0.25), Hertz(4.0))
        );
        assert_eq!(
            (Hertz(4.0) * Seconds(2.0), Seconds(2.0) * Hertz(4.0)),
            (8.0, 8.0)
        );
    }

    #[test]
    fn a_temperature_differs_by_kelvins() {
        assert_eq!(Celsius(45.0) - Celsius(25.0), Kelvins(20.0));
        assert_eq!(
            (Celsius(25.0) + Kelvins(1.0), Celsius(25.0) - Kelvins(1.0)),
            (Celsius(26.0), Celsius(24.0))
        );
    }
}
