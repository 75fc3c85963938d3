//! Numbers as text: with units, prefixes and only their significant digits.

use crate::outcome::FittedParameter;

/// Units that take a prefix.
const PREFIXED: [&str; 7] = ["Ω", "V", "A", "s", "F", "H", "Hz"];
const PREFIXES: [(f64, &str); 7] = [
    (1e6, "M"),
    (1e3, "k"),
    (1.0, ""),
    (1e-3, "m"),
    (1e-6, "µ"),
    (1e-9, "n"),
    (1e-12, "p"),
];

/// Unit of the numbers of one table row: they are divided by `factor` and shown under `unit`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Unit {
    factor: f64,
    name: String,
    /// Decimals after the division.
    decimals: usize,
    /// As a number times a power of ten.
    exponent: Option<i32>,
}

impl Unit {
    /// Unit for a value that is known to `resolution` (both in `unit`). Two significant digits of
    /// the resolution are shown.
    pub(super) fn of(value: f64, resolution: f64, unit: &str) -> Self {
        let size = value.abs().max(resolution.abs());
        let (factor, prefix) = prefix(size, unit);
        let name = format!("{prefix}{unit}");
        let exponent =
            if factor == 1.0 && prefix.is_empty() && size > 0.0 && !(1e-3..1e5).contains(&size) {
                Some(size.log10().floor() as i32)
            } else {
                None
            };
        let factor = exponent.map_or(factor, |e| 10f64.powi(e));
        let known = resolution.is_finite() && resolution != 0.0;
        let decimals = if known {
            (1.0 - (resolution.abs() / factor).log10().floor()).clamp(0.0, 6.0)
        } else {
            2.0
        };
        Self {
            factor,
            name,
            decimals: decimals as usize,
            exponent,
        }
    }

    /// Returns a number without its unit.
    pub(super) fn number(&self, value: f64) -> String {
        let text = signed(format!("{:.*}", self.decimals, value / self.factor));
        self.exponent
            .map_or_else(|| text.clone(), |e| format!("{text}·10{}", superscript(e)))
    }

    /// Returns a number with its unit.
    pub(super) fn with_unit(&self, value: f64) -> String {
        format!("{} {}", self.number(value), self.name)
            .trim_end()
            .to_owned()
    }
}

/// Returns the value with its unit, to three significant digits.
pub(super) fn quantity(value: f64, unit: &str) -> String {
    Unit::of(value, value.abs() / 10.0, unit).with_unit(value)
}

/// Returns the value to three significant digits, without prefix or power of ten: for mV and %.
pub(super) fn plain(value: f64) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let decimals = if value == 0.0 {
        0.0
    } else {
        (2.0 - value.abs().log10().floor()).clamp(0.0, 3.0)
    };
    signed(format!("{value:.*}", decimals as usize))
}

/// Returns a number of standard deviations, or how many times something is.
pub(super) fn times(value: f64) -> String {
    let decimals = match value.abs() {
        v if v < 2.0 => 2,
        v if v < 100.0 => 1,
        _ => 0,
    };
    if value.is_finite() {
        signed(format!("{value:.decimals$}"))
    } else {
        "–".to_owned()
    }
}

/// Returns a part as a whole number of per cent.
pub(super) fn percent(part: f64) -> String {
    if part.is_finite() {
        signed(format!("{:.0} %", 100.0 * part))
    } else {
        "–".to_owned()
    }
}

/// With a true minus sign.
fn signed(text: String) -> String {
    if text.starts_with('-') {
        text.replacen('-', "−", 1)
    } else {
        text
    }
}

/// Returns a probability.
pub(super) fn probability(p: f64) -> String {
    match p {
        _ if !p.is_finite() => "–".to_owned(),
        _ if p < 1e-15 => "< 10⁻¹⁵".to_owned(),
        _ if p < 1e-3 => format!("10{}", superscript(p.log10().round() as i32)),
        _ if p < 0.1 => format!("{p:.3}"),
        _ => format!("{p:.2}"),
    }
}

fn prefix(size: f64, unit: &str) -> (f64, &'static str) {
    // Seconds are never shown as kiloseconds.
    let none = (1.0, "");
    if !PREFIXED.contains(&unit) || !size.is_finite() || size == 0.0 || (unit == "s" && size >= 1.0)
    {
        return none;
    }
    PREFIXES
        .into_iter()
        .find(|(factor, _)| size >= *factor * (1.0 - 1e-9))
        .unwrap_or((1e-12, "p"))
}

fn superscript(exponent: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let sign = if exponent < 0 { "⁻" } else { "" };
    let digits: String = exponent
        .unsigned_abs()
        .to_string()
        .bytes()
        .filter_map(|b| DIGITS.get(usize::from(b - b'0')))
        .collect();
    format!("{sign}{digits}")
}

/// Returns an effect with its values: "diffusion over a finite length (5.31 ± 0.14 mΩ, 148 ± 11
/// s)".
pub(super) fn with_values(title: &str, parameters: &[FittedParameter]) -> String {
    let values: Vec<String> = parameters
        .iter()
        .filter(|p| !matches!(p.unit, "" | "1"))
        .filter_map(|p| p.sigma.map(|sigma| (p, sigma)))
        .map(|(p, sigma)| {
            let unit = Unit::of(p.value, sigma, p.unit);
            format!("{} ± {}", unit.number(p.value), unit.with_unit(sigma))
        })
        .collect();
    match values.as_slice() {
        [] => title.to_owned(),
        _ => format!("{title} ({})", values.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_digits_of_the_uncertainty_are_shown() {
        let cases = [
            (1.234e-3, 5.6e-5, "Ω", "1.234 mΩ"),
            (-2.7e-6, 1e-7, "s", "−2.70 µs"),
            (612.3, 48.0, "s", "612 s"),
            (4.53e-5, 3e-6, "1/J", "4.53·10⁻⁵ 1/J"),
            (0.42, 0.01, "", "0.420"),
            (0.0, 0.0, "A", "0.00 A"),
            (5e-8, f64::NAN, "H", "50.00 nH"),
        ];
        for (value, sigma, unit, expected) in cases {
            assert_eq!(Unit::of(value, sigma, unit).with_unit(value), expected);
        }
    }

    #[test]
    fn probabilities_and_plain_numbers() {
        let p: Vec<String> = [0.5, 0.049, 3e-7, 1e-40, f64::NAN]
            .into_iter()
            .map(probability)
            .collect();
        assert_eq!(p, ["0.50", "0.049", "10⁻⁷", "< 10⁻¹⁵", "–"]);
        let n: Vec<String> = [27.94, 3.1, 0.0, 1234.5, -0.01, f64::INFINITY]
            .into_iter()
            .map(plain)
            .collect();
        assert_eq!(n, ["27.9", "3.10", "0", "1234", "−0.010", "–"]);
        let z: Vec<String> = [-0.4, 9.55, 323.4, f64::NAN]
            .into_iter()
            .map(times)
            .collect();
        assert_eq!(z, ["−0.40", "9.6", "323", "–"]);
        let parts: Vec<String> = [0.916, -0.53, f64::NAN].into_iter().map(percent).collect();
        assert_eq!(parts, ["92 %", "−53 %", "–"]);
    }
}
