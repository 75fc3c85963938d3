//! Times as people write them.

use jiff::{Timestamp, civil::Date, tz::TimeZone};

/// Parses a typed time, s since 1970. A date alone means its beginning in UTC.
///
/// # Errors
/// In words, what was expected.
pub fn unix_s(text: &str) -> Result<f64, String> {
    if let Ok(seconds) = text.parse::<f64>()
        && seconds.is_finite()
    {
        return Ok(seconds);
    }
    let date = || {
        let date: Date = text.parse().ok()?;
        Some(date.to_zoned(TimeZone::UTC).ok()?.timestamp())
    };
    let time = text.parse::<Timestamp>().ok().or_else(date);
    time.map(|time| time.as_millisecond() as f64 / 1.0e3)
        .ok_or_else(|| {
            "expected a time as 2026-11-28, 2026-11-28T12:00:00Z or s since 1970".to_owned()
        })
}

/// Formats the local time of day of a moment, s since 1970, such as `14:32`; with the date if it
/// differs from that of `now_unix_s`.
pub fn local_time(unix_s: f64, now_unix_s: f64) -> String {
    let local = |unix_s: f64| {
        let whole = unix_s.floor() as i64;
        Timestamp::from_second(whole).map(|at| at.to_zoned(TimeZone::system()))
    };
    let (Ok(at), Ok(now)) = (local(unix_s), local(now_unix_s)) else {
        return format!("{unix_s:.0} s after 1970");
    };
    let format = if at.date() == now.date() {
        "%H:%M"
    } else {
        "%Y-%m-%d %H:%M"
    };
    at.strftime(format).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_dates_or_seconds() {
        assert_eq!(unix_s("12.5"), Ok(12.5));
        assert_eq!(unix_s("1970-01-02"), Ok(86_400.0));
        assert_eq!(unix_s("1970-01-01T01:00:00Z"), Ok(3_600.0));
        assert!(unix_s("yesterday").is_err() && unix_s("inf").is_err());
    }

    #[test]
    fn a_time_of_another_day_has_its_date() {
        let today = local_time(1.0e9, 1.0e9 + 1.0);
        assert!(today.len() == 5 && today.ends_with(":46"), "{today}");
        let then = local_time(1.0e9, 1.0e9 + 3.0 * 86_400.0);
        assert!(
            then.starts_with("2001-09-0") && then.ends_with(&today),
            "{then}"
        );
    }
}
