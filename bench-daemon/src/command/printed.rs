//! Results as JSON on standard output.

use serde::Serialize;

use bench_core::safety::failure::Failure;
use bench_plan::support::terminal::say;

/// Prints a value as JSON, for `--json`.
///
/// # Errors
/// A value that JSON cannot represent: a map whose keys are not strings.
pub fn say_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    say!("{text}");
    Ok(())
}
