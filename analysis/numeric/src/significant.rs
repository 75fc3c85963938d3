//! Numbers as short text, with as many significant digits as a reader needs. Not for files, which
//! keep every digit.

/// Returns the number with at most `digits` significant digits, without trailing zeros and without
/// an exponent.
pub fn format_significant(value: f64, digits: i32) -> String {
    let decimals = if value == 0.0 || !value.is_finite() {
        0
    } else {
        (digits - 1 - value.abs().log10().floor() as i32).clamp(0, 12)
    };
    let text = format!("{value:.*}", decimals as usize);
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::format_significant;

    #[test]
    fn digits_are_those_that_tell_and_zeros_at_the_end_do_not() {
        for (value, digits, text) in [
            (0.0, 3, "0"),
            (0.100_000_001_490_116_12, 4, "0.1"),
            (-0.28, 3, "-0.28"),
            (123_456.0, 3, "123456"),
            (1.2345e-6, 3, "0.00000123"),
            (9.9996, 4, "10"),
            (f64::NAN, 4, "NaN"),
        ] {
            assert_eq!(format_significant(value, digits), text);
        }
    }
}
