//! Tracing spans of steps. They do not affect a run.

use std::{fmt::Display, future::Future};

use instruments::{clock::Clock, units::Seconds};
use tracing::{Instrument, Span, field::Empty, info_span};

use bench_plan::plan::Step;

use crate::clock::TypedClock;

/// A span of bench time.
pub struct Timed {
    span: Span,
    clock: Clock,
    began_s: Seconds,
}

impl Timed {
    /// Creates a span that begins now.
    pub fn new(span: Span, clock: &Clock) -> Self {
        let began_s = clock.now();
        span.record("eis_bench.bench_time_s", began_s.value());
        let clock = clock.clone();
        Self {
            span,
            clock,
            began_s,
        }
    }
}

/// Executes work within a span. At its end the span records the duration by the bench's clock, and
/// the error if the work failed.
pub async fn within<T, E: Display>(
    timed: Timed,
    work: impl Future<Output = Result<T, E>>,
) -> Result<T, E> {
    let Timed {
        span,
        clock,
        began_s,
    } = timed;
    let outcome = work.instrument(span.clone()).await;
    span.record(
        "eis_bench.bench_duration_s",
        (clock.now() - began_s).value(),
    );
    if let Err(error) = &outcome {
        span.record("otel.status_code", "ERROR");
        span.record("otel.status_description", error.to_string());
    }
    outcome
}

/// Returns the span of a step; the span of a sine is the point of a sweep.
pub(super) fn step(step: &Step, clock: &Clock) -> Timed {
    let span = info_span!(
        "step",
        otel.name = kind(step),
        otel.status_code = Empty,
        otel.status_description = Empty,
        eis_bench.step = %step,
        eis_bench.freq_hz = Empty,
        eis_bench.bench_time_s = Empty,
        eis_bench.bench_duration_s = Empty,
    );
    if let Step::Sine { freq_hz, .. } = step {
        span.record("eis_bench.freq_hz", freq_hz.value());
    }
    Timed::new(span, clock)
}

/// Returns the name of the span, from a small set, as span names should be.
fn kind(step: &Step) -> &'static str {
    match step {
        Step::Specimen(_) => "insert cell",
        Step::Mount(_) => "mount fixture",
        Step::HoldTemperature { .. } => "hold temperature",
        Step::Discharge { .. } => "discharge",
        Step::Charge { .. } => "charge",
        Step::Rest { .. } => "rest",
        Step::Accept { .. } => "accept",
        Step::Leg(_) => "direct current",
        Step::PowerUp { .. } => "power up",
        Step::Sine { .. } => "point",
        Step::BiasZero(_) => "bias zero",
        Step::Bias(_) => "bias",
        Step::Recharge(_) => "recharge",
        Step::Multisine(_) => "multisine",
        Step::Recheck(_) => "recheck",
        Step::Pause { .. } => "pause",
        Step::Zero(_) => "zero",
        Step::Trace(_) => "trace",
        Step::PowerDown => "power down",
    }
}
