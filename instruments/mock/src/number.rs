//! Numbers as the instruments print them.

/// Returns a mantissa of `digits` significant digits and an exponent of at least two, `5.00E-02`:
/// Siglent's oscilloscopes.
pub(super) fn nr3(value: f64, digits: usize) -> String {
    let (mantissa, exponent) = split(value, digits.max(1) - 1);
    format!("{mantissa}E{}{:02}", sign(exponent), exponent.abs())
}

/// Like [`nr3`] with a sign in front and eight decimals, `+2.53740000E+01`: Keysight's scanners.
pub(super) fn signed_nr3(value: f64) -> String {
    let text = nr3(value, 9);
    if text.starts_with('-') {
        text
    } else {
        format!("+{text}")
    }
}

/// At most six significant digits, at least one decimal, bare exponent, `-2.5E0`: Kepco.
pub(super) fn short_nr3(value: f64) -> String {
    let (mantissa, exponent) = split(value, 5);
    format!("{}E{exponent}", trim(&mantissa, 1))
}

/// At most `digits` significant digits without trailing zeros, plain unless the exponent is far
/// out, as C's `%g`: Siglent's generators.
pub(super) fn general(value: f64, digits: usize) -> String {
    let digits = digits.max(1);
    let (mantissa, exponent) = split(value, digits - 1);
    let precision = i32::try_from(digits).unwrap_or(i32::MAX);
    if exponent < -5 || exponent >= precision {
        return format!(
            "{}e{}{:02}",
            trim(&mantissa, 0),
            sign(exponent),
            exponent.abs()
        );
    }
    let decimals = usize::try_from(precision - 1 - exponent).unwrap_or(0);
    trim(&format!("{value:.decimals$}"), 0)
}

/// Mantissa text with `decimals` decimals, and the decimal exponent. Negative zero counts as zero.
fn split(value: f64, decimals: usize) -> (String, i32) {
    let value = if value == 0.0 || !value.is_finite() {
        0.0
    } else {
        value
    };
    let text = format!("{value:.decimals$e}");
    match text.split_once('e') {
        Some((mantissa, exponent)) => (mantissa.to_owned(), exponent.parse().unwrap_or(0)),
        None => (text, 0),
    }
}

fn sign(exponent: i32) -> char {
    if exponent < 0 { '-' } else { '+' }
}

/// Cuts trailing zeros but leaves `keep` decimals.
fn trim(text: &str, keep: usize) -> String {
    let Some((whole, fraction)) = text.split_once('.') else {
        return if keep == 0 {
            text.to_owned()
        } else {
            format!("{text}.{}", "0".repeat(keep))
        };
    };
    let fraction = fraction.trim_end_matches('0');
    if fraction.is_empty() && keep == 0 {
        whole.to_owned()
    } else {
        format!("{whole}.{fraction:0<keep$}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_printed_as_the_instruments_do() {
        for (value, digits, expected) in [
            (0.05, 3, "5.00E-02"),
            (5e9, 3, "5.00E+09"),
            (-3.8, 7, "-3.800000E+00"),
            (0.0, 3, "0.00E+00"),
            (9.999, 3, "1.00E+01"),
        ] {
            assert_eq!(nr3(value, digits), expected);
        }
        for (value, expected) in [
            (25.374, "+2.53740000E+01"),
            (-1.0, "-1.00000000E+00"),
            (9.9e37, "+9.90000000E+37"),
        ] {
            assert_eq!(signed_nr3(value), expected);
        }
        for (value, expected) in [
            (-2.5, "-2.5E0"),
            (20.0, "2.0E1"),
            (0.0, "0.0E0"),
            (-0.0, "0.0E0"),
            (0.012_345_6, "1.23456E-2"),
        ] {
            assert_eq!(short_nr3(value), expected);
        }
        for (value, expected) in [
            (1000.0, "1000"),
            (0.001, "0.001"),
            (0.5, "0.5"),
            (201.234_567, "201.235"),
            (0.0, "0"),
            (-0.28, "-0.28"),
            (1e-7, "1e-07"),
        ] {
            assert_eq!(general(value, 6), expected);
        }
    }
}
