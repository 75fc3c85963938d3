//! Records begin before the cell has come to rest.

use crate::contract::{Base, Card, Effect, Group, Parameter, Range, Record, quantity::log_grid};

/// Largest part of the voltage that may still be missing at the start, V.
const MOST_V: f64 = 0.05;

static CARD: Card = Card {
    name: "insufficient_rest",
    title: "insufficient rest before a record",
    group: Group::Bench,
    mechanism: "What went before a record has not relaxed yet when it starts; the voltage goes on \
    moving whatever the record does.",
    state_equation: "u = u_at_rest + A·exp(−t/τ), t since the start of the record; A in V, the \
    same for all records of a cell; τ in s",
    impedance: "left out: drift under a sweep spoils its lowest frequencies, which the \
    Kramers–Kronig test finds",
    source: "superposition of relaxations in a linear network",
    signature: "the voltage creeps at the start of every record, most in the first rest, and then \
    settles",
    confounders: &["thermal_emf", "current_offset", "self_discharge", "rc_slow"],
    contains: &[],
    experiment: "rest for hours, then the same record again",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct InsufficientRest;

impl Effect for InsufficientRest {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let longest_s = base.facts.longest_s;
        if longest_s <= 0.0 {
            return Vec::new();
        }
        vec![
            Parameter::strength(
                "start_v",
                "V",
                Range {
                    lower: -MOST_V,
                    upper: MOST_V,
                },
                0.01 * MOST_V,
            ),
            Parameter::shape(
                "tau_s",
                "s",
                Range {
                    lower: 0.003 * longest_s,
                    upper: 3.0 * longest_s,
                },
                log_grid(0.03 * longest_s, longest_s, 3),
            ),
        ]
    }

    fn voltage(&self, p: &[f64], record: &Record<'_>, voltage_v: &mut [f64]) {
        if !record.is_cell {
            return;
        }
        let start_s = record.time_s.first().copied().unwrap_or(0.0);
        voltage_v
            .iter_mut()
            .zip(record.time_s)
            .for_each(|(v, t)| *v += p[0] * (-(t - start_s) / p[1]).exp());
    }
}
