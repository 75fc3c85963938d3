//! Axes: ranges, ticks at round numbers, and their labels.

/// One axis of a frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Axis {
    /// Lower end; the decimal logarithm on a logarithmic axis.
    pub(super) lo: f64,
    /// Upper end, above the lower.
    pub(super) hi: f64,
    /// Places of the labelled ticks, with their labels.
    pub(super) ticks: Vec<(f64, String)>,
    /// Places of grid lines without label.
    pub(super) minor: Vec<f64>,
}

impl Axis {
    /// Returns a linear axis with about `count` ticks.
    pub(super) fn linear(lo: f64, hi: f64, count: f64) -> Self {
        Self::stepped(lo, hi, round_step((hi - lo) / count))
    }

    /// Returns a linear axis with a tick at every multiple of `step`.
    pub(super) fn stepped(lo: f64, hi: f64, step: f64) -> Self {
        let first = (lo / step).ceil() as i64;
        let last = (hi / step).floor() as i64;
        let decimals = (-step.log10().floor()).clamp(0.0, 12.0) as usize;
        let ticks = (first..=last.min(first + 200))
            .map(|k| k as f64 * step)
            .map(|v| (v, number(v, decimals)))
            .collect();
        Self {
            lo,
            hi,
            ticks,
            minor: Vec::new(),
        }
    }

    /// Returns a logarithmic axis over the whole decades that hold the frequencies lo…hi.
    pub(super) fn decades(lo: f64, hi: f64) -> Self {
        // A hair of tolerance: 0.1 must not open the decade below for its rounding.
        let first = (lo.log10() + 1e-9).floor() as i32;
        let last = ((hi.log10() - 1e-9).ceil() as i32).max(first + 1);
        let ticks = (first..=last)
            .map(|d| (f64::from(d), power_of_ten(d)))
            .collect();
        let minor = (first..last)
            .flat_map(|d| (2..10).map(move |m| f64::from(d) + f64::from(m).log10()))
            .collect();
        Self {
            lo: f64::from(first),
            hi: f64::from(last),
            ticks,
            minor,
        }
    }

    /// Returns a logarithmic axis from lo to hi as they are, both above zero: labels at 1, 2 and 5
    /// of each decade, or at the decades where these are many.
    pub(super) fn tight_decades(lo: f64, hi: f64) -> Self {
        let (lo, hi) = (lo.log10(), hi.log10().max(lo.log10() + 1e-6));
        let steps: &[f64] = if hi - lo < 2.2 {
            &[1.0, 2.0, 5.0]
        } else {
            &[1.0]
        };
        let decades = || lo.floor() as i32..=hi.ceil() as i32;
        let within = |v: &f64| (lo - 1e-9..=hi + 1e-9).contains(v);
        let label = |d: i32, m: f64| match d {
            _ if m == 1.0 => power_of_ten(d),
            -12..=-1 => number(m * 10f64.powi(d), d.unsigned_abs() as usize),
            _ => number(m * 10f64.powi(d), 0),
        };
        let all = decades().flat_map(|d| steps.iter().map(move |m| (d, *m)));
        let ticks = all
            .map(|(d, m)| (f64::from(d) + m.log10(), label(d, m)))
            .filter(|(v, _)| within(v))
            .collect();
        let minor = decades()
            .flat_map(|d| (2..10).map(move |m| f64::from(d) + f64::from(m).log10()))
            .filter(within)
            .collect();
        Self {
            lo,
            hi,
            ticks,
            minor,
        }
    }

    /// Fraction of the way from the lower to the upper end.
    pub(super) fn fraction(&self, value: f64) -> f64 {
        (value - self.lo) / (self.hi - self.lo)
    }
}

/// Returns the smallest of 1, 2, 2.5, 5 times a power of ten that is not less than `raw`.
pub(super) fn round_step(raw: f64) -> f64 {
    let raw = if raw.is_finite() && raw > 0.0 {
        raw
    } else {
        1.0
    };
    let decade = 10f64.powf(raw.log10().floor());
    let candidates = [1.0, 2.0, 5.0, 10.0];
    candidates
        .into_iter()
        .map(|c| c * decade)
        .find(|s| *s >= raw * (1.0 - 1e-9))
        .unwrap_or(10.0 * decade)
}

/// Returns a number with a true minus sign, and no minus before zero.
pub(super) fn number(value: f64, decimals: usize) -> String {
    let text = format!("{:.decimals$}", value.abs());
    let is_zero = text.bytes().all(|b| matches!(b, b'0' | b'.'));
    if value < 0.0 && !is_zero {
        format!("−{text}")
    } else {
        text
    }
}

/// Formats 0.01 … 10000 written out, otherwise as a power of ten.
pub(super) fn power_of_ten(exponent: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    match exponent {
        0..=4 => format!("{}", 10i64.pow(exponent.unsigned_abs())),
        -3..=-1 => format!(
            "{:.*}",
            exponent.unsigned_abs() as usize,
            10f64.powi(exponent)
        ),
        _ => {
            let sign = if exponent < 0 { "⁻" } else { "" };
            let digits: String = exponent
                .unsigned_abs()
                .to_string()
                .bytes()
                .filter_map(|b| DIGITS.get(usize::from(b - b'0')))
                .collect();
            format!("10{sign}{digits}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_stand_at_round_numbers() {
        let labels = |a: Axis| a.ticks.into_iter().map(|(_, l)| l).collect::<Vec<_>>();
        assert_eq!(
            labels(Axis::linear(6.3, 9.9, 8.0)),
            ["6.5", "7.0", "7.5", "8.0", "8.5", "9.0", "9.5"]
        );
        assert_eq!(
            labels(Axis::linear(-0.13, 0.12, 5.0)),
            ["−0.10", "−0.05", "0.00", "0.05", "0.10"]
        );
        assert_eq!(
            labels(Axis::linear(0.0, 4000.0, 4.0)),
            ["0", "1000", "2000", "3000", "4000"]
        );
    }

    #[test]
    fn decades_are_whole_and_tight() {
        let cases = [
            ((0.1, 201.0), (-1.0, 3.0)),
            ((0.099_999_999_999, 100.0), (-1.0, 2.0)),
            ((1.0, 1.0), (0.0, 1.0)),
            ((3.0, 5.0), (0.0, 1.0)),
        ];
        for ((lo, hi), expected) in cases {
            let axis = Axis::decades(lo, hi);
            assert_eq!((axis.lo, axis.hi), expected, "{lo}…{hi} Hz");
        }
        let words: Vec<String> = [-12, -3, -1, 0, 3, 4, 5, 10]
            .into_iter()
            .map(power_of_ten)
            .collect();
        assert_eq!(
            words,
            ["10⁻¹²", "0.001", "0.1", "1", "1000", "10000", "10⁵", "10¹⁰"]
        );
    }

    #[test]
    fn tight_decades_keep_their_ends() {
        let axis = Axis::tight_decades(0.7, 12.0);
        assert_eq!(
            (10f64.powf(axis.lo), axis.hi),
            (10f64.powf(0.7f64.log10()), 12f64.log10())
        );
        let labels = |a: Axis| a.ticks.into_iter().map(|(_, l)| l).collect::<Vec<_>>();
        assert_eq!(labels(axis), ["1", "2", "5", "10"]);
        assert_eq!(labels(Axis::tight_decades(0.2, 1.0)), ["0.2", "0.5", "1"]);
        assert_eq!(
            labels(Axis::tight_decades(1.0, 3000.0)),
            ["1", "10", "100", "1000"]
        );
    }

    #[test]
    fn steps_of_nothing_do_not_stall() {
        assert!(round_step(0.0) > 0.0 && round_step(f64::NAN) > 0.0);
        assert!(Axis::stepped(0.0, 1.0, 1e-9).ticks.len() <= 201);
    }
}
