//! Numbers, Booleans and quantities as instruments write and read them: NR1 to NR3 (IEEE 488.2
//! clause 8.7), non-decimal numbers (7.7.4), suffixes (7.7.3) and SCPI's stand-ins for infinity and
//! not-a-number (SCPI-1999 volume 1, 7.2.1.4 and 7.2.1.5).

use super::excerpt;

/// Answer of SCPI instruments for positive infinity (an overload, an open thermocouple).
pub const SCPI_INFINITY: f64 = 9.9e37;
/// Reply of SCPI instruments in place of a number that is not available.
pub const SCPI_NAN: f64 = 9.91e37;

/// A number that could not be read or written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NumberError {
    /// The text is not a number.
    #[error("expected a number such as 42, 4.2 or 4.2E+0, found `{0}`")]
    NotANumber(String),
    /// The text is not a Boolean.
    #[error("expected 1, 0, ON or OFF, found `{0}`")]
    NotABoolean(String),
    /// The text is not a `#H`, `#Q` or `#B` number of at most 64 bits.
    #[error("expected digits after #H, #Q or #B, at most 64 bits, found `{0}`")]
    NotNonDecimal(String),
    /// The suffix belongs to another unit, or to none.
    #[error("expected a number in {expected}, found the suffix `{found}`")]
    Suffix {
        /// The requested unit, as SCPI writes it.
        expected: String,
        /// The suffix that was met, in capitals.
        found: String,
    },
    /// Infinity and not-a-number are never sent.
    #[error("expected a finite number to send, found {0}")]
    NotFinite(f64),
    /// Too large to be written with all digits.
    #[error(
        "expected a magnitude below 1e15 with at most 12 decimals to send, found {value} with \
        {decimals} decimals"
    )]
    TooLarge {
        /// The number to be sent.
        value: f64,
        /// The requested number of decimals.
        decimals: usize,
    },
}

/// Parses a number in any of the forms NR1, NR2 and NR3, with optional blanks around it; 9.9E37 is
/// infinity, 9.91E37 is not-a-number, and so are the keywords `INF`, `NINF` and `NAN`.
///
/// ```
/// use instruments_scpi::number::parse_f64;
/// # fn main() -> Result<(), instruments_scpi::number::NumberError> {
/// assert_eq!(parse_f64(" +4.2E+0")?, 4.2);
/// assert_eq!(parse_f64("9.9E37")?, f64::INFINITY);
/// assert!(parse_f64("4.2 V").is_err());
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// [`NumberError::NotANumber`] for any other text, including a unit after the number (see
/// [`parse_quantity`]).
pub fn parse_f64(text: &str) -> Result<f64, NumberError> {
    let quantity = parse_quantity(text)?;
    if quantity.suffix.is_empty() {
        Ok(quantity.value)
    } else {
        Err(NumberError::NotANumber(excerpt(text.as_bytes())))
    }
}

/// Parses a whole number; `1.0` and `1E0` count as whole, because instruments write register
/// contents in this form.
///
/// # Errors
/// [`NumberError::NotANumber`] if it is not a number, is not whole or lies beyond ±2⁵³.
pub fn parse_i64(text: &str) -> Result<i64, NumberError> {
    let value = parse_f64(text)?;
    let whole = value.is_finite() && value.fract() == 0.0 && value.abs() <= 9_007_199_254_740_992.0;
    if whole {
        Ok(value as i64)
    } else {
        Err(NumberError::NotANumber(excerpt(text.as_bytes())))
    }
}

/// Parses `1`, `0`, `ON` or `OFF` in any case.
///
/// # Errors
/// [`NumberError::NotABoolean`] for any other text.
pub fn parse_bool(text: &str) -> Result<bool, NumberError> {
    let word = text.trim();
    match word {
        "1" | "+1" => Ok(true),
        "0" | "+0" => Ok(false),
        _ if word.eq_ignore_ascii_case("on") => Ok(true),
        _ if word.eq_ignore_ascii_case("off") => Ok(false),
        _ => Err(NumberError::NotABoolean(excerpt(text.as_bytes()))),
    }
}

/// Parses a non-decimal number: `#H1F`, `#Q17` or `#B101`, in any case.
///
/// # Errors
/// [`NumberError::NotNonDecimal`] for any other text.
pub fn parse_non_decimal(text: &str) -> Result<u64, NumberError> {
    let fail = || NumberError::NotNonDecimal(excerpt(text.as_bytes()));
    let mut chars = text.chars();
    let radix = match (
        chars.next(),
        chars.next().map(|letter| letter.to_ascii_uppercase()),
    ) {
        (Some('#'), Some('H')) => 16,
        (Some('#'), Some('Q')) => 8,
        (Some('#'), Some('B')) => 2,
        _ => return Err(fail()),
    };
    let digits = chars.as_str();
    if !digits.starts_with(|first: char| first.is_digit(radix)) {
        return Err(fail());
    }
    u64::from_str_radix(digits, radix).map_err(|_| fail())
}

/// A number with the suffix after it. The meaning of the suffix depends on the expected unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantity {
    /// The number as written, not yet multiplied.
    pub value: f64,
    /// The suffix in capitals, empty if there was none.
    pub suffix: String,
}

impl Quantity {
    /// Returns the number in `unit` without multiplier (`V`, `A`, `HZ`, `OHM`, `S`, …): `1500 mA`
    /// is 1.5 in `A`. No suffix means `unit` itself. `M` is milli except before `HZ` and `OHM`,
    /// where it is mega.
    ///
    /// # Errors
    /// [`NumberError::Suffix`] if the suffix is not a multiplier followed by `unit`.
    pub fn si(&self, unit: &str) -> Result<f64, NumberError> {
        if self.suffix.is_empty() {
            return Ok(self.value);
        }
        let unit = unit.to_ascii_uppercase();
        let multiplier = self
            .suffix
            .strip_suffix(unit.as_str())
            .and_then(|prefix| multiplier(prefix, &unit));
        multiplier
            .map(|factor| self.value * factor)
            .ok_or_else(|| NumberError::Suffix {
                expected: unit,
                found: self.suffix.clone(),
            })
    }
}

/// Parses a number and the suffix after it, if any: `1500 mA`, `2MHZ`, `-3.0E-1 V`, `0.707Vrms`.
///
/// ```
/// use instruments_scpi::number::parse_quantity;
/// # fn main() -> Result<(), instruments_scpi::number::NumberError> {
/// let quantity = parse_quantity("1500 mA")?;
/// assert!((quantity.si("A")? - 1.5).abs() < 1.0e-12);
/// assert!(quantity.si("V").is_err());
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// [`NumberError::NotANumber`] if the text does not start with a number, or if anything other than
/// one suffix follows.
pub fn parse_quantity(text: &str) -> Result<Quantity, NumberError> {
    let fail = || NumberError::NotANumber(excerpt(text.as_bytes()));
    let trimmed = text.trim();
    if let Some(value) = special_word(trimmed) {
        return Ok(Quantity {
            value,
            suffix: String::new(),
        });
    }
    let (digits, rest) = trimmed
        .split_at_checked(decimal_length(trimmed.as_bytes()))
        .ok_or_else(fail)?;
    let value: f64 = digits.parse().map_err(|_| fail())?;
    let suffix = rest.trim_start().to_uppercase();
    let plausible = suffix.chars().all(|c| {
        c.is_alphabetic() || matches!(c, '/' | '.' | '%' | '°' | '-') || c.is_ascii_digit()
    });
    let starts_well =
        suffix.starts_with(|c: char| c.is_alphabetic() || matches!(c, '/' | '%' | '°'));
    if suffix.is_empty() || (plausible && starts_well) {
        Ok(Quantity {
            value: without_stand_ins(value),
            suffix,
        })
    } else {
        Err(fail())
    }
}

/// Writes a number with exactly `decimals` digits after the point and never with an exponent: some
/// instruments read no exponents, others keep only the first digits of a long mantissa. Minus zero
/// is written as zero.
///
/// # Errors
/// [`NumberError::NotFinite`] for infinity and not-a-number, [`NumberError::TooLarge`] from 1e15
/// and beyond 12 decimals.
pub fn format_fixed(value: f64, decimals: usize) -> Result<String, NumberError> {
    if !value.is_finite() {
        return Err(NumberError::NotFinite(value));
    }
    if value.abs() >= 1.0e15 || decimals > 12 {
        return Err(NumberError::TooLarge { value, decimals });
    }
    let text = format!("{value:.decimals$}");
    let is_zero = text.bytes().all(|byte| matches!(byte, b'-' | b'0' | b'.'));
    Ok(if is_zero {
        text.trim_start_matches('-').to_owned()
    } else {
        text
    })
}

/// Returns the length of the number at the start of `text`: sign, digits with at most one point,
/// and an exponent if digits follow it. Zero if there is none.
pub(crate) fn decimal_length(text: &[u8]) -> usize {
    let at = |index: usize| text.get(index).copied().unwrap_or(0);
    let digits_from = |start: usize| {
        text.iter()
            .skip(start)
            .take_while(|byte| byte.is_ascii_digit())
            .count()
    };
    let sign = usize::from(matches!(at(0), b'+' | b'-'));
    let whole = digits_from(sign);
    let point = usize::from(at(sign + whole) == b'.');
    let fraction = if point == 1 {
        digits_from(sign + whole + 1)
    } else {
        0
    };
    if whole + fraction == 0 {
        return 0;
    }
    let mantissa = sign + whole + point + fraction;
    if !matches!(at(mantissa), b'e' | b'E') {
        return mantissa;
    }
    let exponent_sign = usize::from(matches!(at(mantissa + 1), b'+' | b'-'));
    let exponent = digits_from(mantissa + 1 + exponent_sign);
    if exponent == 0 {
        mantissa
    } else {
        mantissa + 1 + exponent_sign + exponent
    }
}

fn special_word(text: &str) -> Option<f64> {
    let (sign, word) = match text.strip_prefix('-') {
        Some(rest) => (-1.0, rest),
        None => (1.0, text.strip_prefix('+').unwrap_or(text)),
    };
    match word.to_ascii_uppercase().as_str() {
        "INF" | "INFINITY" => Some(sign * f64::INFINITY),
        "NINF" => Some(f64::NEG_INFINITY),
        "NAN" => Some(f64::NAN),
        _ => None,
    }
}

/// The tolerance covers instruments that print the stand-ins in single precision.
fn without_stand_ins(value: f64) -> f64 {
    const TOLERANCE: f64 = 1.0e-6;
    if (value / SCPI_NAN - 1.0).abs() < TOLERANCE {
        f64::NAN
    } else if value.abs() > SCPI_INFINITY * (1.0 - TOLERANCE) {
        f64::INFINITY.copysign(value)
    } else {
        value
    }
}

/// Returns the multiplier of IEEE 488.2 table 7-2, with the exception of its note for `MHZ` and
/// `MOHM`.
fn multiplier(prefix: &str, unit: &str) -> Option<f64> {
    Some(match prefix {
        "" => 1.0,
        "EX" => 1.0e18,
        "PE" => 1.0e15,
        "T" => 1.0e12,
        "G" => 1.0e9,
        "MA" => 1.0e6,
        "M" if matches!(unit, "HZ" | "OHM") => 1.0e6,
        "K" => 1.0e3,
        "M" => 1.0e-3,
        "U" => 1.0e-6,
        "N" => 1.0e-9,
        "P" => 1.0e-12,
        "F" => 1.0e-15,
        "A" => 1.0e-18,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn every_form_of_a_number_is_read() {
        let table = [
            ("42", 42.0),
            ("-0", 0.0),
            (" +4.2\t", 4.2),
            (".5", 0.5),
            ("5.", 5.0),
            ("4.2E+0", 4.2),
            ("-2.5e0", -2.5),
            ("+2.53740000E+01", 25.374),
            ("1.000000000000000E+03", 1000.0),
            ("9.9E37", f64::INFINITY),
            ("+9.90000000E+37", f64::INFINITY),
            ("-9.9E+37", f64::NEG_INFINITY),
            ("INF", f64::INFINITY),
            ("-inf", f64::NEG_INFINITY),
            ("9.8E37", 9.8e37),
        ];
        for (text, value) in table {
            assert_eq!(parse_f64(text), Ok(value), "{text}");
        }
        for text in ["9.91E37", "+9.91000000E+37", "nan"] {
            assert!(parse_f64(text).unwrap().is_nan(), "{text}");
        }
    }

    #[test]
    fn what_is_not_a_number_is_named() {
        for text in [
            "", " ", ".", "-", "+-1", "1,5", "1.2.3", "0x10", "1e", "infinite", "---.--", "1 V",
            "--1", "1\n2",
        ] {
            let message = parse_f64(text).unwrap_err().to_string();
            assert!(
                message.starts_with("expected a number such as 42, 4.2 or 4.2E+0, found `"),
                "{text}: {message}"
            );
        }
        assert_eq!(
            parse_f64("---.--").unwrap_err().to_string(),
            "expected a number such as 42, 4.2 or 4.2E+0, found `---.--`"
        );
    }

    #[test]
    fn a_suffix_is_read_in_the_unit_that_is_asked_for() {
        let table = [
            ("1500 mA", "A", 1.5),
            ("2 MHZ", "HZ", 2.0e6),
            ("2mhz", "HZ", 2.0e6),
            ("3 MOHM", "OHM", 3.0e6),
            ("3 MV", "V", 3.0e-3),
            ("3 MAV", "V", 3.0e6),
            ("10 KOHM", "OHM", 1.0e4),
            ("7 US", "S", 7.0e-6),
            ("1 MA", "A", 1.0e-3),
            ("1 MAA", "A", 1.0e6),
            ("1 EXHZ", "HZ", 1.0e18),
            ("2.5", "V", 2.5),
            ("1000HZ", "HZ", 1000.0),
            ("0.707Vrms", "VRMS", 0.707),
            ("1E3V", "V", 1000.0),
        ];
        for (text, unit, value) in table {
            let read = parse_quantity(text).unwrap().si(unit).unwrap();
            assert!((read / value - 1.0).abs() < 1e-12, "{text}: {read}");
        }
        let error = parse_quantity("5 mV").unwrap().si("A").unwrap_err();
        assert_eq!(
            error.to_string(),
            "expected a number in A, found the suffix `MV`"
        );
        assert!(parse_quantity("5 XV").unwrap().si("V").is_err());
        assert!(parse_quantity("5 V 6").is_err());
    }

    #[test]
    fn booleans_and_non_decimal_numbers() {
        for (text, value) in [
            ("1", true),
            ("0", false),
            ("ON", true),
            (" off ", false),
            ("+1", true),
        ] {
            assert_eq!(parse_bool(text), Ok(value), "{text}");
        }
        assert_eq!(
            parse_bool("2").unwrap_err().to_string(),
            "expected 1, 0, ON or OFF, found `2`"
        );
        for (text, value) in [
            ("#H1F", 31),
            ("#hff", 255),
            ("#Q17", 15),
            ("#B101", 5),
            ("#HFFFFFFFFFFFFFFFF", u64::MAX),
        ] {
            assert_eq!(parse_non_decimal(text), Ok(value), "{text}");
        }
        for text in [
            "#H",
            "#HG",
            "#Q8",
            "#B2",
            "#X1",
            "1F",
            "#H+1",
            "#H1FFFFFFFFFFFFFFFF",
        ] {
            assert!(parse_non_decimal(text).is_err(), "{text}");
        }
        assert_eq!(parse_i64("+1.0E1"), Ok(10));
        assert!(parse_i64("1.5").is_err());
        assert!(parse_i64("9.9E37").is_err());
    }

    #[test]
    fn numbers_are_written_plainly_or_not_at_all() {
        let table = [
            (-0.000_01, 4, "0.0000"),
            (1.0e-9, 4, "0.0000"),
            (1.0e6, 4, "1000000.0000"),
            (-2.5, 1, "-2.5"),
            (300.0, 0, "300"),
        ];
        for (value, decimals, text) in table {
            assert_eq!(format_fixed(value, decimals).unwrap(), text);
        }
        assert_eq!(
            format_fixed(f64::NAN, 4).unwrap_err().to_string(),
            "expected a finite number to send, found NaN"
        );
        assert!(
            format_fixed(1.0e15, 4)
                .unwrap_err()
                .to_string()
                .starts_with("expected a magnitude below 1e15")
        );
    }

    proptest! {
        #[test]
        fn a_written_number_is_read_back_to_its_last_digit(value in -1.0e9_f64..1.0e9, decimals in 0_usize..=9) {
            let text = format_fixed(value, decimals).unwrap();
            prop_assert!(!text.contains(['e', 'E']));
            let half_digit = 0.5 * 10.0_f64.powi(-(decimals as i32));
            prop_assert!((parse_f64(&text).unwrap() - value).abs() <= half_digit + 2.0 * f64::EPSILON * value.abs());
        }

        #[test]
        fn the_machines_own_notation_is_read_exactly(value in prop::num::f64::NORMAL) {
            prop_assume!(value.abs() < 9.8e37);
            prop_assert_eq!(parse_f64(&format!("{value:e}")).unwrap(), value);
        }
    }
}
