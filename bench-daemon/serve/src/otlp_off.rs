//! Stands in for the telemetry of the server in a program that is built without the feature `otlp`.

use super::settings::Settings;
use bench_evaluate::support::telemetry::Telemetry;

/// Starts nothing. The settings refuse an address; the environment is reported.
pub fn start(settings: &Settings) -> Telemetry {
    Telemetry::from_environment(&settings.listen.port().to_string())
}
