//! Quantities as people type them: a number with its unit, so that volts cannot be given where
//! amperes are wanted.

use std::{fmt, marker::PhantomData};

use serde::de::{self, Deserialize, Deserializer, Visitor};

/// Physical dimension of a field.
pub trait Dimension {
    /// "a current".
    const NAME: &'static str;
    /// An example with its unit.
    const EXAMPLE: &'static str;
    /// Accepted units and their factor to SI (percent to a share, ampere-hours to coulombs). Flags of
    /// the command line are named after the first.
    const UNITS: &'static [(&'static str, f64)];
}

/// A quantity in SI.
pub struct Quantity<D> {
    /// The value in SI.
    pub si: f64,
    dimension: PhantomData<D>,
}

impl<D> Clone for Quantity<D> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<D> Copy for Quantity<D> {}
impl<D> fmt::Debug for Quantity<D> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.si)
    }
}

impl<D: Dimension> Quantity<D> {
    /// A value in SI.
    pub(super) fn of(si: f64) -> Self {
        Self {
            si,
            dimension: PhantomData,
        }
    }

    /// Reads `"500 mA"`.
    ///
    /// # Errors
    /// Expected and found text.
    pub fn parse(text: &str) -> Result<Self, String> {
        let fail = || {
            format!(
                "expected {} with its unit, such as {:?}, found {text:?}",
                D::NAME,
                D::EXAMPLE
            )
        };
        let trimmed = text.trim();
        let split = trimmed
            .char_indices()
            .find(|(at, c)| {
                let exponent = matches!(c, 'e' | 'E')
                    && trimmed[at + 1..].starts_with(|next: char| {
                        next.is_ascii_digit() || next == '-' || next == '+'
                    });
                !(c.is_ascii_digit() || matches!(c, '.' | '+' | '-') || exponent)
            })
            .map_or(trimmed.len(), |(at, _)| at);
        let (number, unit) = trimmed.split_at(split);
        let number: f64 = number.parse().map_err(|_| fail())?;
        let unit = unit.trim();
        let factor = D::UNITS
            .iter()
            .find(|(name, _)| *name == unit)
            .map(|(_, factor)| *factor)
            .ok_or_else(fail)?;
        let si = number * factor;
        si.is_finite()
            .then_some(Self {
                si,
                dimension: PhantomData,
            })
            .ok_or_else(fail)
    }
}

impl<'de, D: Dimension> Deserialize<'de> for Quantity<D> {
    fn deserialize<De: Deserializer<'de>>(deserializer: De) -> Result<Self, De::Error> {
        struct Text<D>(PhantomData<D>);
        impl<D: Dimension> Visitor<'_> for Text<D> {
            type Value = Quantity<D>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{} with its unit, such as {:?}", D::NAME, D::EXAMPLE)
            }
            fn visit_str<E: de::Error>(self, text: &str) -> Result<Self::Value, E> {
                Quantity::parse(text).map_err(E::custom)
            }
        }
        deserializer.deserialize_str(Text(PhantomData))
    }
}

macro_rules! dimension {
    ($(#[$doc:meta])* $name:ident, $what:literal, $example:literal, [$(($unit:literal, $factor:expr)),* $(,)?]) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy)]
        pub struct $name;
        impl Dimension for $name {
            const NAME: &'static str = $what;
            const EXAMPLE: &'static str = $example;
            const UNITS: &'static [(&'static str, f64)] = &[$(($unit, $factor)),*];
        }
    };
}

dimension!(
    /// Electric potential.
    Voltage, "a voltage", "3.80 V", [("V", 1.0), ("mV", 1.0e-3), ("µV", 1.0e-6), ("uV", 1.0e-6)]);
dimension!(
    /// Electric current.
    Current, "a current", "1 A", [("A", 1.0), ("mA", 1.0e-3)]);
dimension!(
    /// Power.
    Power, "a power", "-40 W", [("W", 1.0), ("kW", 1.0e3)]);
dimension!(
    /// Current per voltage.
    Transconductance, "a current per volt", "-2 A/V", [("A/V", 1.0), ("mA/V", 1.0e-3)]);
dimension!(
    /// Frequency.
    Frequency, "a frequency", "0.1 Hz", [("Hz", 1.0), ("mHz", 1.0e-3), ("kHz", 1.0e3)]);
dimension!(
    /// Time.
    Duration, "a duration", "30 min",
    [("s", 1.0), ("ms", 1.0e-3), ("µs", 1.0e-6), ("us", 1.0e-6), ("min", 60.0), ("h", 3600.0),
     ("d", 86_400.0)]);
dimension!(
    /// Temperature.
    Temperature, "a temperature", "25 °C", [("°C", 1.0), ("degC", 1.0), ("C", 1.0)]);
dimension!(
    /// Difference of temperatures.
    TemperatureDifference, "a temperature difference", "0.1 K", [("K", 1.0)]);
dimension!(
    /// Rate of a temperature.
    TemperatureRate, "a rate of a temperature", "5 K/min", [("K/min", 1.0 / 60.0), ("K/s", 1.0)]);
dimension!(
    /// Resistance.
    Resistance, "a resistance", "9.96 mΩ",
    [("Ω", 1.0), ("ohm", 1.0), ("mΩ", 1.0e-3), ("mohm", 1.0e-3), ("µΩ", 1.0e-6), ("uΩ", 1.0e-6),
     ("uohm", 1.0e-6), ("MΩ", 1.0e6), ("kΩ", 1.0e3), ("Ohm", 1.0), ("mOhm", 1.0e-3),
     ("uOhm", 1.0e-6), ("\u{2126}", 1.0), ("m\u{2126}", 1.0e-3), ("\u{3bc}Ω", 1.0e-6),
     ("µ\u{2126}", 1.0e-6)]);
dimension!(
    /// Inductance.
    Inductance, "an inductance", "20 nH", [("H", 1.0), ("µH", 1.0e-6), ("uH", 1.0e-6), ("nH", 1.0e-9)]);
dimension!(
    /// Capacitance.
    Capacitance, "a capacitance", "1 nF",
    [("F", 1.0), ("kF", 1.0e3), ("mF", 1.0e-3), ("µF", 1.0e-6), ("uF", 1.0e-6), ("nF", 1.0e-9),
     ("pF", 1.0e-12)]);
dimension!(
    /// Charge.
    Charge, "a charge", "4.5 Ah", [("Ah", 3600.0), ("mAh", 3.6), ("C", 1.0)]);
dimension!(
    /// A share.
    Share, "a share", "3 %", [("%", 1.0e-2)]);
dimension!(
    /// An angle.
    Angle, "an angle", "2 °", [("°", 1.0), ("deg", 1.0)]);
dimension!(
    /// Slope of a voltage.
    VoltageSlope, "a slope of a voltage", "0.2 mV/min",
    [("V/s", 1.0), ("mV/s", 1.0e-3), ("mV/min", 1.0e-3 / 60.0), ("mV/h", 1.0e-3 / 3600.0)]);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_are_read_in_their_units() {
        assert_eq!(Quantity::<Current>::parse("500 mA").unwrap().si, 0.5);
        assert_eq!(Quantity::<Voltage>::parse("-0.28V").unwrap().si, -0.28);
        assert_eq!(Quantity::<Charge>::parse("4.5 Ah").unwrap().si, 16_200.0);
        assert_eq!(Quantity::<Frequency>::parse("1e-1 Hz").unwrap().si, 0.1);
        assert_eq!(Quantity::<Duration>::parse("2 min").unwrap().si, 120.0);
        assert_eq!(Quantity::<Duration>::parse("250 µs").unwrap().si, 250.0e-6);
    }

    #[test]
    fn a_wrong_or_missing_unit_is_refused_in_words() {
        for text in ["1 V", "1", "A", "one A", "1 a", "", "1e999 A", "1 eA"] {
            let message = Quantity::<Current>::parse(text).unwrap_err();
            assert!(
                message.contains("expected a current with its unit, such as \"1 A\"")
                    && message.contains(text),
                "{message}"
            );
        }
    }
}
