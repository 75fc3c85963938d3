//! Terms that all texts of a plan share.

use instruments::fixture::Fixture;

/// Returns the fixture's name in files and configuration.
pub fn fixture_name(fixture: Fixture) -> &'static str {
    match fixture {
        Fixture::Cell => "cell",
        Fixture::Shunt => "shunt",
        Fixture::FakeCell => "fake_cell",
        Fixture::Short => "short",
    }
}

pub(crate) fn minutes(seconds: f64) -> String {
    if seconds < 120.0 {
        format!("{seconds:.0} s")
    } else {
        format!("{:.1} min", seconds / 60.0)
    }
}
