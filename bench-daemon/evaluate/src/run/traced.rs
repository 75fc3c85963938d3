//! Tracing spans of a run and of its stages. They do not affect a run.

use std::path::Path;

use instruments::clock::Clock;
use tracing::{Span, field::Empty, info_span};

use crate::support::telemetry;
use bench_core::{executor::Timed, safety::failure::Failure};
use bench_plan::{config::Experiment, plan::Stage};

/// Returns the span of a run. It belongs to the trace of the process that started this one, if
/// any.
pub(super) fn run(experiment: &Experiment, folder: &Path, resumed: bool) -> Span {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let span = info_span!(
        "run",
        eis_bench.run = %name,
        eis_bench.experiment = %experiment.name,
        eis_bench.bench = %experiment.bench.name,
        eis_bench.cell = %experiment.cell.name,
        eis_bench.seed = experiment.seed,
        eis_bench.resumed = resumed,
    );
    telemetry::set_parent(&span);
    span
}

/// Records how a run ended.
pub(super) fn ended(span: &Span, failure: Option<&Failure>) {
    if let Some(failure) = failure {
        telemetry::record_failure(span, failure.exit_code(), failure.to_string());
    }
}

/// Returns the span of a stage.
pub(super) fn stage(number: usize, stage: &Stage, clock: &Clock) -> Timed {
    let span = info_span!(
        "stage",
        otel.status_code = Empty,
        otel.status_description = Empty,
        eis_bench.stage = %stage.title(),
        eis_bench.stage_number = number + 1,
        eis_bench.bench_time_s = Empty,
        eis_bench.bench_duration_s = Empty,
    );
    Timed::new(span, clock)
}
