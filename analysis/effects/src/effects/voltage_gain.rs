//! The voltage channel of the records scales all changes of the voltage.

use crate::contract::{Base, Card, Effect, Group, Parameter, Range, Record};

static CARD: Card = Card {
    name: "voltage_gain",
    title: "gain error of the voltage channel",
    group: Group::Bench,
    mechanism: "The voltage channel of the time records reads too little or too much. The level at \
    the start of a record is not evidence: it belongs to the run's offset, which is noise.",
    state_equation: "u_logged = u₀ + (1 + g)·(u − u₀), u₀ at the first sample of the record; g as \
    a fraction",
    impedance: "none: spectra are taken as the reference",
    source: "data sheets of voltmeters: gain error",
    signature: "overpotential and change of the open-circuit voltage of records are off by the \
    same fraction",
    confounders: &["current_gain", "contact_resistance", "ageing", "ocv_slope"],
    contains: &[],
    experiment: "a reference meter beside the channel at two voltages",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct VoltageGain;

impl Effect for VoltageGain {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        // Without spectra it cannot be separated from resistances.
        if base.facts.longest_s <= 0.0 || base.facts.highest_hz.is_none() {
            return Vec::new();
        }
        vec![Parameter::strength(
            "gain",
            "",
            Range {
                lower: -0.3,
                upper: 0.3,
            },
            0.01,
        )]
    }

    fn voltage(&self, p: &[f64], _record: &Record<'_>, voltage_v: &mut [f64]) {
        let level_v = voltage_v.first().copied().unwrap_or(0.0);
        // Written so that a gain of zero changes no bit.
        voltage_v
            .iter_mut()
            .for_each(|v| *v += p[0] * (*v - level_v));
    }
}
