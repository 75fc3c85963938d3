//! Reads from the journal and the manifest when and in which state the cell was measured.

use analysis::run_folder;
use instruments::{clock::TimeMode, fixture::Fixture};

use bench_core::{
    journal::{self, Entry},
    record::Recorder,
    safety::failure::Failure,
};
use bench_plan::config::Experiment;

/// Returns rows of the provenance: the date, the voltages at rest and the temperatures of the cell
/// before its records.
///
/// # Errors
/// Fails if the journal cannot be read.
pub(super) fn rows(
    recorder: &Recorder,
    experiment: &Experiment,
) -> Result<Vec<(String, String)>, Failure> {
    let lines = journal::read(recorder.folder())
        .map_err(|error| Failure::Usage(error.to_string()))?
        .lines;
    let mode = lines.iter().find_map(|line| {
        if let Entry::Started(started) = &line.entry {
            Some(started.time.clone())
        } else {
            None
        }
    });
    let real = mode.as_deref() == Some(TimeMode::Real.to_string().as_str());
    let date = match run_folder::started_unix_s(recorder.folder()).filter(|_| real) {
        Some(unix_s) => format!("{} (UTC)", date(unix_s)),
        None => format!(
            "none: the bench ran in {} time",
            mode.as_deref().unwrap_or("unknown")
        ),
    };
    let idle = |line: &journal::Line| match &line.entry {
        Entry::Point(done) if done.point.fixture == Fixture::Cell => Some(done.idle),
        _ => None,
    };
    let idle: Vec<_> = lines.iter().filter_map(idle).collect();
    let mut rows = vec![("date".to_owned(), date)];
    if let Some(text) = range(
        idle.iter().filter_map(|idle| Some(idle.voltage_v?.value())),
        4,
        "V",
    ) {
        rows.push(("cell at rest before its records".to_owned(), text));
    }
    let held = experiment.temperature.as_ref().map_or_else(
        || "not held".to_owned(),
        |held| format!("held at {} °C", held.setpoint_degc.0),
    );
    let measured = range(
        idle.iter()
            .filter_map(|idle| Some(idle.temperature_degc?.value())),
        2,
        "°C",
    );
    rows.push((
        "temperature of the cell".to_owned(),
        measured.map_or_else(|| held.clone(), |text| format!("{text} ({held})")),
    ));
    Ok(rows)
}

/// Formats the least and the greatest value; returns `None` without values.
fn range(values: impl Iterator<Item = f64>, digits: usize, unit: &str) -> Option<String> {
    let (least, most) = values.fold(
        (f64::INFINITY, f64::NEG_INFINITY),
        |(least, most), value| (least.min(value), most.max(value)),
    );
    let (from, to) = (
        format!("{least:.digits$} {unit}"),
        format!("{most:.digits$} {unit}"),
    );
    (least <= most).then(|| {
        if from == to {
            from
        } else {
            format!("{from} to {to}")
        }
    })
}

/// Returns the date of a time since 1970 in ISO 8601 format.
fn date(unix_s: f64) -> String {
    jiff::Timestamp::from_second(unix_s.floor() as i64).map_or_else(
        |_| "unknown".to_owned(),
        |at| at.to_zoned(jiff::tz::TimeZone::UTC).date().to_string(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_the_calendar() {
        for (unix_s, expected) in [
            (0.0, "1970-01-01"),
            (951_782_400.0, "2000-02-29"),
            (1_735_689_599.0, "2024-12-31"),
            (1_735_689_600.0, "2025-01-01"),
        ] {
            assert_eq!(date(unix_s), expected);
        }
    }

    #[test]
    fn a_range_of_one_value_is_that_value() {
        assert_eq!(
            range([3.8, 3.80001].into_iter(), 4, "V").unwrap(),
            "3.8000 V"
        );
        assert_eq!(
            range([24.9, 25.1].into_iter(), 2, "°C").unwrap(),
            "24.90 °C to 25.10 °C"
        );
        assert_eq!(range([].into_iter(), 2, "°C"), None);
    }
}
