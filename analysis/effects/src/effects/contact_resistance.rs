//! The fixtures of spectra and records hold the cell by different contacts.

use crate::contract::{Base, Card, Effect, Group, Parameter, Point, Range};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "contact_resistance",
    title: "contact resistance in the spectra's fixture",
    group: Group::Bench,
    mechanism: "Between the sense points of the sweeps lies more of clamp, tab or weld than \
    between those of the time records.",
    state_equation: "none in records, which are the reference; R_c in Ω, negative where the \
    records' fixture has the larger contact",
    impedance: "Z → Z + R_c of the cell; not of controls, which have contacts of their own",
    source: "two-wire against four-wire connection",
    signature: "spectra are shifted along the real axis by the same amount at every frequency",
    confounders: &["current_gain", "ageing"],
    contains: &[],
    experiment: "seat the cell again with Kelvin clamps and sweep; a shunt in both fixtures",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct ContactResistance;

impl Effect for ContactResistance {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        // Without records it is the series resistance.
        if base.facts.longest_s <= 0.0 || base.facts.highest_hz.is_none() {
            return Vec::new();
        }
        let most = 0.5 * base.erm.dc_resistance_ohm();
        vec![Parameter::strength(
            "r_ohm",
            "Ω",
            Range {
                lower: -most,
                upper: most,
            },
            0.01 * most,
        )
        .usually(
            Range {
                lower: -base.erm.r_ohm.min(most),
                upper: most,
            },
            "with more than the series resistance taken off, a passive cell would have a negative \
            one: look for another cell, temperature or scale in the spectra",
        )]
    }

    fn impedance(&self, p: &[f64], _base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if at.is_cell { z_ohm + p[0] } else { z_ohm }
    }
}
