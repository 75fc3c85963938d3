//! Context of a trace as text (W3C Trace Context): from a request to the process of its run.

use opentelemetry::{
    Context,
    propagation::{Extractor, TextMapPropagator},
    trace::{SpanContext, TraceContextExt},
};
use opentelemetry_sdk::propagation::TraceContextPropagator;

use super::CONTEXT_VARIABLE;

/// Header that hands it to a server.
pub const HEADER: &str = "traceparent";

struct Parent<'a>(&'a str);

impl Extractor for Parent<'_> {
    fn get(&self, key: &str) -> Option<&str> {
        (key == HEADER).then_some(self.0)
    }

    fn keys(&self) -> Vec<&str> {
        vec![HEADER]
    }
}

/// Parses the context that a text names, or returns `None` if it is not such a text.
pub fn parent(text: &str) -> Option<Context> {
    let context =
        TraceContextPropagator::new().extract_with_context(&Context::new(), &Parent(text));
    context.span().span_context().is_valid().then_some(context)
}

/// The context that this process was given.
pub fn of_environment() -> Option<Context> {
    parent(&std::env::var(CONTEXT_VARIABLE).ok()?)
}

/// The span of a context as such a text.
pub fn of(context: &Context) -> String {
    text(context.span().span_context())
}

/// A span as such a text.
pub fn text(span: &SpanContext) -> String {
    format!(
        "00-{}-{}-{:02x}",
        span.trace_id(),
        span.span_id(),
        span.trace_flags().to_u8() & 1
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_context_survives_its_text_and_nonsense_is_none() {
        let known = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";
        let context = parent(known).unwrap();
        assert_eq!(of(&context), known);
        for odd in [
            "",
            "00",
            "00-00000000000000000000000000000000-00f067aa0ba902b7-01",
            "ff-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01\r\nx: y",
        ] {
            assert!(parent(odd).is_none(), "{odd}");
        }
    }
}
