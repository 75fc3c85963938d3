//! What was found at an address.

use instruments::{exchange::Identity, transport::Address};
use serde::Serialize;

use bench_core::{
    bench::outputs::OutputReading,
    bench::survey::{InstrumentReport, KnownDialect},
};

/// Instrument found at one address.
#[derive(Debug, Serialize)]
pub(super) struct IdentifiedInstrument {
    /// Its role; for a single address, that of the dialect.
    pub(super) role: Option<&'static str>,
    /// The dialect that was chosen.
    pub(super) model: Option<String>,
    pub(super) address: String,
    #[serde(flatten)]
    pub(super) report: Option<InstrumentReport>,
    /// State of its output, if it can move charge.
    pub(super) output: Option<OutputReading>,
    /// Reason why it did not answer.
    pub(super) failure: Option<String>,
    /// Wall time from connecting to the last answer, s.
    pub(super) took_s: f64,
    /// Lines for the bench file that would force a dialect on an instrument that no dialect knows.
    pub(super) could_be_forced: Vec<String>,
}

impl IdentifiedInstrument {
    pub(super) fn good(&self) -> bool {
        self.report.as_ref().is_some_and(|report| report.recognised)
    }
}

/// Describes the reply of a web server that was found instead of an instrument.
pub(super) fn web(identity: &Identity) -> String {
    format!(
        "expected an instrument, met a web server ({:?}); instruments with a web page speak SCPI on \
         another port, often 5025 or 5555",
        identity.raw
    )
}

/// Returns lines for the bench file that select a known dialect for an unknown model; dialects of
/// the same maker come first.
pub(super) fn forcing(role: Option<&str>, identity: &Identity, address: &Address) -> Vec<String> {
    let maker = identity.maker.to_lowercase();
    let mut known: Vec<KnownDialect> = KnownDialect::all()
        .into_iter()
        .filter(|known| role.is_none_or(|role| role == known.role))
        .collect();
    let akin = |known: &KnownDialect| {
        known
            .key
            .split('-')
            .next()
            .is_some_and(|first| maker.contains(first))
    };
    known.sort_by_key(|known| !akin(known));
    let accept = format!("{},{}", identity.maker, identity.model);
    let accept = if identity.raw.contains(&accept) {
        accept
    } else {
        identity.raw.clone()
    };
    let line = |known: &KnownDialect| {
        let more = if known.role == "logger" {
            ", cell_channel = 101"
        } else {
            ""
        };
        format!(
            "instruments.{} = {{ model = {:?}, address = \"{address}\", accept = {accept:?}{more} \
            }}",
            known.role, known.key
        )
    };
    known.iter().map(line).collect()
}
