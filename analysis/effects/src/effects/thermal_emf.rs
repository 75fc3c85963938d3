//! A thermal voltage that grows while a record runs.

use crate::contract::{Base, Card, Effect, Group, Parameter, Range, Record};

/// Largest drift over the longest record, V: ten times what 250 K between copper and constantan
/// make, so that a worse contact shows as such.
const MOST_V: f64 = 0.1;
/// Voltage of copper against Kovar, 75 µV/K, over 20 K.
const COPPER_KOVAR_V: f64 = 1.5e-3;

static CARD: Card = Card {
    name: "thermal_emf",
    title: "drifting thermal voltage",
    group: Group::Bench,
    mechanism: "Junctions of different metals in the voltage leads warm up while the bench is \
    under load and add a voltage to the cell's.",
    state_equation: "u_logged = u + a·t, t since the start of the record; a in V/s. A drift over \
    the campaign has the same slope within a record, and its \
                     level in each run belongs to the run's offset, which is noise",
    impedance: "none: a sweep does not see direct voltage",
    source: "Seebeck effect; about 40 µV/K for copper against constantan",
    signature: "a ramp of the voltage with time whatever current flows, the same at any state of \
    charge",
    confounders: &["current_offset", "self_discharge", "insufficient_rest"],
    contains: &[],
    experiment: "a record with the voltage leads shorted; swap the leads",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct ThermalEmf;

impl Effect for ThermalEmf {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.longest_s <= 0.0 {
            return Vec::new();
        }
        let most = MOST_V / base.facts.longest_s;
        vec![Parameter::strength(
            "drift_v_per_s",
            "V/s",
            Range {
                lower: -most,
                upper: most,
            },
            1e-3 * most,
        )
        .usually(
            Range {
                lower: -COPPER_KOVAR_V / base.facts.longest_s,
                upper: COPPER_KOVAR_V / base.facts.longest_s,
            },
            "copper and Kovar give 75 µV/K (Keithley, Low Level Measurements Handbook, table of \
            thermoelectric coefficients), 1.5 mV in a record in which a contact warms by 20 K",
        )]
    }

    fn voltage(&self, p: &[f64], record: &Record<'_>, voltage_v: &mut [f64]) {
        let start_s = record.time_s.first().copied().unwrap_or(0.0);
        voltage_v
            .iter_mut()
            .zip(record.time_s)
            .for_each(|(v, t)| *v += p[0] * (t - start_s));
    }
}
