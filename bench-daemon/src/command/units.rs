//! Quantities on the command line: a number in the unit that the flag names, or a number with its
//! unit, as in files.

use crate::config::quantity::{
    Charge, Current, Dimension, Duration, Frequency, Power, Quantity, Resistance, Temperature,
    Voltage,
};

/// Coulombs of an ampere-hour.
const AMPERE_HOUR_C: f64 = 3600.0;

fn read<D: Dimension>(text: &str, unit: &str, unit_si: f64) -> Result<f64, String> {
    let plain = text.trim().parse::<f64>().ok();
    plain
        .or_else(|| Quantity::<D>::parse(text).ok().map(|met| met.si / unit_si))
        .ok_or_else(|| {
            let (name, example) = (D::NAME, D::EXAMPLE);
            format!("expected {name} in {unit}, or with its unit, such as {example:?}")
        })
}

/// Reads volts.
///
/// # Errors
/// What was expected, in words; as of all functions here.
pub fn volts(text: &str) -> Result<f64, String> {
    read::<Voltage>(text, "V", 1.0)
}

/// Reads amperes.
///
/// # Errors
/// As [`volts`].
pub fn amperes(text: &str) -> Result<f64, String> {
    read::<Current>(text, "A", 1.0)
}

/// Reads ohms.
///
/// # Errors
/// As [`volts`].
pub fn ohms(text: &str) -> Result<f64, String> {
    read::<Resistance>(text, "Ω", 1.0)
}

/// Reads watts.
///
/// # Errors
/// As [`volts`].
pub fn watts(text: &str) -> Result<f64, String> {
    read::<Power>(text, "W", 1.0)
}

/// Reads seconds.
///
/// # Errors
/// As [`volts`].
pub fn seconds(text: &str) -> Result<f64, String> {
    read::<Duration>(text, "s", 1.0)
}

/// Reads hertz.
///
/// # Errors
/// As [`volts`].
pub fn hertz(text: &str) -> Result<f64, String> {
    read::<Frequency>(text, "Hz", 1.0)
}

/// Reads degrees Celsius.
///
/// # Errors
/// As [`volts`].
pub fn celsius(text: &str) -> Result<f64, String> {
    read::<Temperature>(text, "°C", 1.0)
}

/// Reads ampere-hours.
///
/// # Errors
/// As [`volts`].
pub fn ampere_hours(text: &str) -> Result<f64, String> {
    read::<Charge>(text, "Ah", AMPERE_HOUR_C)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_in_the_unit_of_its_flag_and_a_unit_is_heard() {
        assert_eq!(volts("3.6"), Ok(3.6));
        assert_eq!(volts("3.6 V"), Ok(3.6));
        assert_eq!(volts("3600mV"), Ok(3.6));
        assert_eq!(ohms("15 mΩ"), Ok(0.015));
        assert_eq!(watts("-4 kW"), Ok(-4000.0));
        assert_eq!(seconds("2 min"), Ok(120.0));
        assert_eq!(ampere_hours("4500 mAh"), Ok(4.5));
        assert_eq!(celsius("25 °C"), Ok(25.0));
        assert_eq!(
            amperes("3 V").unwrap_err(),
            "expected a current in A, or with its unit, such as \"1 A\""
        );
    }
}
