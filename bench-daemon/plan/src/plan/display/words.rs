//! Terms that all texts of a plan share.

use instruments::{fixture::Fixture, units::Seconds};

/// Returns the fixture's name in files and configuration.
pub fn fixture_name(fixture: Fixture) -> &'static str {
    match fixture {
        Fixture::Cell => "cell",
        Fixture::Shunt => "shunt",
        Fixture::FakeCell => "fake_cell",
        Fixture::Short => "short",
    }
}

pub(crate) fn minutes(seconds: Seconds) -> String {
    if seconds < Seconds(120.0) {
        format!("{seconds:.0}")
    } else {
        format!("{:.1} min", (seconds / 60.0).0)
    }
}
