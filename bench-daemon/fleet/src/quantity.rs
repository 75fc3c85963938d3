//! Quantities from user input: a number with its unit, with the same units as in the files of
//! `eis-bench`.

/// A physical dimension with its units.
struct Dimension {
    /// "a current".
    name: &'static str,
    example: &'static str,
    /// Units with their factors to the first one.
    units: &'static [(&'static str, f64)],
}

const DURATION: Dimension = Dimension {
    name: "a duration",
    example: "30 min",
    units: &[
        ("s", 1.0),
        ("ms", 1.0e-3),
        ("min", 60.0),
        ("h", 3600.0),
        ("d", 86_400.0),
    ],
};
const CURRENT: Dimension = Dimension {
    name: "a current",
    example: "1 A",
    units: &[("A", 1.0), ("mA", 1.0e-3)],
};
const TEMPERATURE: Dimension = Dimension {
    name: "a temperature",
    example: "25 °C",
    units: &[("°C", 1.0), ("degC", 1.0), ("C", 1.0)],
};

impl Dimension {
    fn with_unit(&self, text: &str) -> Option<f64> {
        let text = text.trim();
        let (unit, factor) = self
            .units
            .iter()
            .filter(|(unit, _)| text.ends_with(unit))
            .max_by_key(|(unit, _)| unit.len())?;
        let number: f64 = text.strip_suffix(unit)?.trim_end().parse().ok()?;
        Some(number * factor).filter(|value| value.is_finite())
    }

    /// Parses a number in the first unit, or with any unit.
    fn of_flag(&self, text: &str) -> Result<f64, String> {
        let plain = text.trim().parse::<f64>().ok();
        let plain = plain.filter(|value| value.is_finite());
        plain.or_else(|| self.with_unit(text)).ok_or_else(|| {
            let (name, unit, example) = (self.name, self.units[0].0, self.example);
            format!("expected {name} in {unit}, or with its unit, such as {example:?}")
        })
    }
}

/// Parses a duration of the command line; returns seconds.
///
/// # Errors
/// Describes the accepted texts.
pub fn duration_s(text: &str) -> Result<f64, String> {
    DURATION.of_flag(text)
}

/// Parses a current of the command line; returns amperes.
///
/// # Errors
/// Describes the accepted texts.
pub fn current_a(text: &str) -> Result<f64, String> {
    CURRENT.of_flag(text)
}

/// Parses a temperature of the command line; returns degrees Celsius.
///
/// # Errors
/// Describes the accepted texts.
pub fn temperature_degc(text: &str) -> Result<f64, String> {
    TEMPERATURE.of_flag(text)
}

/// Parses a duration of a file, where a number needs its unit; returns seconds.
///
/// # Errors
/// Expected and found text.
pub fn typed_duration_s(text: &str) -> Result<f64, String> {
    DURATION.with_unit(text).ok_or_else(|| {
        let (name, example) = (DURATION.name, DURATION.example);
        format!("expected {name} with its unit, such as {example:?}, found {text:?}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_in_the_unit_of_its_flag_and_a_unit_is_heard() {
        assert_eq!(duration_s("90 d"), Ok(7_776_000.0));
        assert_eq!(duration_s("5min"), Ok(300.0));
        assert_eq!(duration_s("500 ms"), Ok(0.5));
        assert_eq!(duration_s("30"), Ok(30.0));
        assert_eq!(current_a("500 mA"), Ok(0.5));
        assert_eq!(current_a("5"), Ok(5.0));
        assert_eq!(temperature_degc("-10 °C"), Ok(-10.0));
        for wrong in ["3 V", "inf", "A", "1 A A"] {
            assert_eq!(
                current_a(wrong).unwrap_err(),
                "expected a current in A, or with its unit, such as \"1 A\"",
                "{wrong}"
            );
        }
        assert_eq!(
            typed_duration_s("30").unwrap_err(),
            "expected a duration with its unit, such as \"30 min\", found \"30\""
        );
    }
}
