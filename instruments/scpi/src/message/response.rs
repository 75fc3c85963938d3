//! Response messages, as the controller reads them: units joined by `;`, fields joined by `,`, both
//! outside quotes only (IEEE 488.2 clause 8).

use crate::number::{self, NumberError};

/// One field of an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Field {
    /// The text with blanks around it trimmed and its quotes taken off.
    pub text: String,
    /// It stood in quotes.
    pub quoted: bool,
}

impl Field {
    /// Returns the field as a number; see [`number::parse_f64`].
    ///
    /// # Errors
    /// [`NumberError::NotANumber`] if it is not a number.
    pub fn as_f64(&self) -> Result<f64, NumberError> {
        number::parse_f64(&self.text)
    }

    /// Returns the field as a Boolean; see [`number::parse_bool`].
    ///
    /// # Errors
    /// [`NumberError::NotABoolean`] if it is not a Boolean.
    pub fn as_bool(&self) -> Result<bool, NumberError> {
        number::parse_bool(&self.text)
    }
}

/// Returns the fields of one reply, in their order. `;` separates units and ends a field too; an
/// empty reply has no field.
///
/// ```
/// use instruments_scpi::message::parse_response;
/// # fn main() -> Result<(), instruments_scpi::number::NumberError> {
/// let fields = parse_response("\"A,B\",3.700E+00;ON");
/// assert_eq!(fields.len(), 3);
/// assert_eq!(fields[0].text, "A,B");
/// assert_eq!(fields[1].as_f64()?, 3.7);
/// assert!(fields[2].as_bool()?);
/// # Ok(())
/// # }
/// ```
pub fn parse_response(text: &str) -> Vec<Field> {
    if text.trim().is_empty() {
        return Vec::new();
    }
    split_outside_quotes(text, &[',', ';'])
        .into_iter()
        .map(field)
        .collect()
}

/// Returns the units of one reply, as several queries in one message return them.
pub fn response_units(text: &str) -> Vec<&str> {
    split_outside_quotes(text, &[';'])
        .into_iter()
        .map(str::trim)
        .filter(|unit| !unit.is_empty())
        .collect()
}

fn split_outside_quotes<'a>(text: &'a str, separators: &[char]) -> Vec<&'a str> {
    let mut quote = None;
    text.split(|c: char| {
        match quote {
            Some(open) if c == open => quote = None,
            None if c == '"' => quote = Some(c),
            _ => {}
        }
        quote.is_none() && separators.contains(&c)
    })
    .collect()
}

fn field(text: &str) -> Field {
    let trimmed = text.trim();
    match trimmed
        .strip_prefix('"')
        .and_then(|inner| inner.strip_suffix('"'))
    {
        Some(inner) => Field {
            text: inner.replace("\"\"", "\""),
            quoted: true,
        },
        None => Field {
            text: trimmed.to_owned(),
            quoted: false,
        },
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn texts(answer: &str) -> Vec<String> {
        parse_response(answer)
            .into_iter()
            .map(|field| field.text)
            .collect()
    }

    #[test]
    fn fields_are_split_outside_quotes() {
        let table: [(&str, &[&str]); 8] = [
            (
                "KEPCO,BOP1KW 50-20 ,E156884, 2.01",
                &["KEPCO", "BOP1KW 50-20", "E156884", "2.01"],
            ),
            (
                "-113,\"Undefined header;a,b\"",
                &["-113", "Undefined header;a,b"],
            ),
            ("\"say \"\"no\"\"\",1", &["say \"no\"", "1"]),
            ("1;2", &["1", "2"]),
            ("", &[]),
            ("a,", &["a", ""]),
            ("Trig'd,1", &["Trig'd", "1"]),
            ("\"\"", &[""]),
        ];
        for (answer, expected) in table {
            assert_eq!(texts(answer), expected, "{answer}");
        }
        assert!(parse_response("\"1\"")[0].quoted);
        assert_eq!(parse_response(" 9.9E37 ,ON")[0].as_f64(), Ok(f64::INFINITY));
        assert_eq!(parse_response(" 9.9E37 ,ON")[1].as_bool(), Ok(true));
    }

    #[test]
    fn units_are_split_outside_quotes() {
        assert_eq!(response_units("1.5;\"a;b\" ; 2"), ["1.5", "\"a;b\"", "2"]);
    }

    proptest! {
        #[test]
        fn quoted_fields_survive(fields in prop::collection::vec("[ -~]{0,12}", 1..6)) {
            let answer: Vec<String> = fields
                .iter()
                .map(|field| format!("\"{}\"", field.replace('"', "\"\"")))
                .collect();
            prop_assert_eq!(texts(&answer.join(",")), fields);
        }
    }
}
