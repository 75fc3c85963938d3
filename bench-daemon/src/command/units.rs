//! Quantities on the command line: a number in the unit that the flag names, or a number with its
//! unit, as in files.

use bench_plan::config::quantity::{Dimension, Quantity};

/// Parses a number in the first unit of its dimension, or with any of its units. Returns it in
/// that first unit, after which flags are named.
///
/// # Errors
/// The values that are accepted, in words.
pub fn of<D: Dimension>(text: &str) -> Result<f64, String> {
    let (unit, unit_si) = D::UNITS[0];
    let plain = text.trim().parse::<f64>().ok();
    plain
        .or_else(|| Quantity::<D>::parse(text).ok().map(|met| met.si / unit_si))
        .ok_or_else(|| {
            let (name, example) = (D::NAME, D::EXAMPLE);
            format!("expected {name} in {unit}, or with its unit, such as {example:?}")
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::config::quantity::{
        Charge, Current, Duration, Power, Resistance, Temperature, Voltage,
    };

    #[test]
    fn a_number_is_in_the_unit_of_its_flag_and_a_unit_is_heard() {
        assert_eq!(of::<Voltage>("3.6"), Ok(3.6));
        assert_eq!(of::<Voltage>("3.6 V"), Ok(3.6));
        assert_eq!(of::<Voltage>("3600mV"), Ok(3.6));
        assert_eq!(of::<Resistance>("15 mΩ"), Ok(0.015));
        assert_eq!(of::<Power>("-4 kW"), Ok(-4000.0));
        assert_eq!(of::<Duration>("2 min"), Ok(120.0));
        assert_eq!(of::<Charge>("4500 mAh"), Ok(4.5));
        assert_eq!(of::<Temperature>("25 °C"), Ok(25.0));
        assert_eq!(
            of::<Current>("3 V").unwrap_err(),
            "expected a current in A, or with its unit, such as \"1 A\""
        );
    }
}
