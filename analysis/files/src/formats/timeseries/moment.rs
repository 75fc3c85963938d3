//! Times of rows: numbers, clocks (`h:mm:ss`) and dates.

use super::super::calendar::days_since_1970;
use super::super::text;

/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// A time in a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stamp {
    /// A number, in the unit of its column.
    Number(f64),
    /// `h:mm:ss`, s.
    Clock(f64),
    /// A date with a time of day, s since 1970.
    Date(f64),
}

impl Stamp {
    /// Parses a field; returns `None` if it is not a time.
    pub(super) fn of(field: &str, separator: char) -> Option<Self> {
        let number = text::number(field, separator).filter(|value| value.is_finite());
        number
            .map(Self::Number)
            .or_else(|| clock_s(field).map(Self::Clock))
            .or_else(|| date_s(field, false).map(Self::Date))
    }

    /// Returns whether two time stamps are of the same kind.
    pub(super) fn is_like(self, other: Self) -> bool {
        std::mem::discriminant(&self) == std::mem::discriminant(&other)
    }

    /// Returns seconds; numbers use the factor of the column's unit.
    pub(super) fn seconds(self, factor: f64) -> f64 {
        match self {
            Self::Number(value) => value * factor,
            Self::Clock(seconds) | Self::Date(seconds) => seconds,
        }
    }

    /// Returns the seconds of a wall clock. The magnitude of a number determines its unit: seconds
    /// or milliseconds since 1970, days since 1900 (Excel) or since the year 0 (MATLAB).
    pub(super) fn wall_s(self) -> f64 {
        match self {
            Self::Number(days) if (2.0e4..1.0e5).contains(&days) => days * DAY_S,
            Self::Number(days) if (7.0e5..8.0e5).contains(&days) => days * DAY_S,
            Self::Number(seconds) if (5.0e8..5.0e9).contains(&seconds) => seconds,
            Self::Number(millis) if (5.0e11..5.0e12).contains(&millis) => 1.0e-3 * millis,
            Self::Number(micros) if (5.0e14..5.0e15).contains(&micros) => 1.0e-6 * micros,
            Self::Number(_) | Self::Clock(_) => f64::NAN,
            Self::Date(seconds) => seconds,
        }
    }
}

/// Parses a clock to seconds: `h:mm:ss`, optionally with fractions and with days before a blank or
/// `d`.
fn clock_s(field: &str) -> Option<f64> {
    let (days, rest) = field
        .split_once(['d', ' '])
        .map_or(("0", field), |(days, rest)| (days, rest));
    let mut parts = rest
        .trim()
        .split(':')
        .map(|part| part.trim().replace(',', ".").parse::<f64>());
    let (hours, minutes, seconds) = (
        parts.next()?.ok()?,
        parts.next()?.ok()?,
        parts.next()?.ok()?,
    );
    let within = (0.0..60.0).contains(&minutes) && (0.0..60.0).contains(&seconds);
    let whole = within && hours >= 0.0 && parts.next().is_none();
    let days: f64 = days.trim().parse().ok()?;
    whole.then_some(((days * 24.0 + hours) * 60.0 + minutes) * 60.0 + seconds)
}

/// Parses a date with a time of day to seconds since 1970. In `a/b/year` the month is first, as in
/// the US, unless `day_first` is set or it exceeds 12; with points or dashes the day is first.
fn date_s(field: &str, day_first: bool) -> Option<f64> {
    let (date, time) = field.trim().split_once(['T', ' '])?;
    let mark = date.chars().find(|c| matches!(c, '-' | '/' | '.'))?;
    let mut parts = date.split(mark).map(|part| part.parse::<i64>().ok());
    let (a, b, c) = (parts.next()??, parts.next()??, parts.next()??);
    if parts.next().is_some() {
        return None;
    }
    let (year, month, day) = match (a > 31, mark) {
        (true, _) => (a, b, c),
        (false, '/') if a <= 12 && !day_first => (c, a, b),
        (false, _) => (c, b, a),
    };
    let year = if year < 100 { 2000 + year } else { year };
    if !(1..=12).contains(&month) || !(1..=31).contains(&day) {
        return None;
    }
    let days = days_since_1970(year, month, day);
    #[expect(clippy::cast_precision_loss, reason = "days of some thousand years")]
    Some(days as f64 * DAY_S + time_of_day_s(time.trim())?)
}

fn time_of_day_s(time: &str) -> Option<f64> {
    let lower = time.to_lowercase();
    let (clock, half) = match lower.split_once(['a', 'p']) {
        Some((clock, rest)) if rest.starts_with('m') => (clock.trim(), lower.contains("pm")),
        _ => (lower.as_str(), false),
    };
    let is_12 = clock.len() < lower.len();
    // The time zone is the same in all rows.
    let end = clock.find(['z', '+', '-']).unwrap_or(clock.len());
    let mut parts = clock[..end].trim().split(':');
    let mut next = || parts.next()?.trim().replace(',', ".").parse::<f64>().ok();
    let (hours, minutes) = (next()?, next()?);
    let seconds = next().unwrap_or(0.0);
    let hours = if is_12 { hours % 12.0 } else { hours } + if half { 12.0 } else { 0.0 };
    Some((hours * 60.0 + minutes) * 60.0 + seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_and_clocks_become_seconds() {
        for (field, expected) in [
            ("1970-01-02 00:00:01", Stamp::Date(86_401.0)),
            ("2021-05-11T15:40:00.5Z", Stamp::Date(1_620_747_600.5)),
            ("5/11/2021 3:40:00 PM", Stamp::Date(1_620_747_600.0)),
            ("11.05.2021 15:40", Stamp::Date(1_620_747_600.0)),
            ("5/11/2021 12:00:00 AM", Stamp::Date(1_620_691_200.0)),
            ("25/12/2021 00:00:00", Stamp::Date(1_640_390_400.0)),
            ("0:01:02.5", Stamp::Clock(62.5)),
            ("1d 00:00:01", Stamp::Clock(86_401.0)),
            ("1.5", Stamp::Number(1.5)),
        ] {
            assert_eq!(Stamp::of(field, '\t'), Some(expected), "{field}");
        }
        for field in ["", "a", "2021-13-01 0:00:00", "today", "0:61:00"] {
            assert_eq!(Stamp::of(field, '\t'), None, "{field}");
        }
        assert_eq!(Stamp::Number(1.5e12).wall_s(), 1.5e9);
        assert!(Stamp::Number(7.0).wall_s().is_nan());
    }
}
