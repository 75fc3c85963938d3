//! Effects that are not in the catalogue and are never named. They represent effects that the
//! catalogue lacks. If one of them beats a name, the name is withdrawn.
//!
//! Each is a simple law of a kind that the catalogue lacks: a resistance with a memory of the
//! current's size, friction of the stored charge in one element or in many, a resistance that
//! changes once between two runs, and gain errors as in the catalogue but for nonlinear channels: a
//! voltage channel whose gain grows with the level, a current channel with another gain for large
//! currents.

use crate::contract::{
    Base, Card, Dynamics, Effect, Group, Instant, Modulation, Parameter, Point, Range, Record,
    Scale, quantity::log_grid,
};
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// Places in the order of runs that a single change is looked for at.
const PLACES: usize = 7;
/// Elements that friction of many elements is made of.
const ELEMENTS: usize = 8;
/// Exponents by which the half widths of elements grow; 0 is one element. A small signal sees the
/// mean of 1/w', which is then 1.0, 2.7, 5.4 and 12.2 of 1/w.
const POWERS: [f64; 4] = [0.0, 1.0, 1.5, 2.0];
/// Parts of the largest current from which on a current channel's gain may be another.
const FROM: [f64; 4] = [0.1, 0.2, 0.4, 0.7];
/// Half width of the transition from one gain to the other, as a fraction of the limit. With an
/// abrupt transition, a current that stays at the limit would be split into samples whose noise is
/// above and below it, and the gain would fit the noise of each.
const WITHIN: f64 = 0.1;

/// All of them.
pub fn outside() -> &'static [&'static dyn Effect] {
    &[&Memory, &Friction, &Change, &Bent, &Ranged]
}

const fn card(
    name: &'static str,
    title: &'static str,
    state_equation: &'static str,
    impedance: &'static str,
) -> Card {
    Card {
        name,
        title,
        // Never read, because the effect is not part of any model.
        group: Group::Cell,
        mechanism: "Stands for causes that the catalogue does not have.",
        state_equation,
        impedance,
        source: "a law of its kind with the fewest parameters",
        signature: "not looked for by name",
        confounders: &[],
        contains: &[],
        experiment: "none: it is never named",
    }
}

static MEMORY: Card = card(
    "outside_memory",
    "something like a resistance that remembers the size of the current",
    "R → R·(1 + m·x), τ·dx/dt = |i| − x; m in 1/A, τ in s",
    "the mean of |i| is 2/π of the amplitude",
);
static FRICTION: Card = card(
    "outside_friction",
    "something like friction of the stored charge",
    "V += M·mean((z − p)/w'), each p is dragged along where |z − p| exceeds its half width w': one \
    of w, or eight up to w that grow evenly, with the power 3/2 or with the square; M in V",
    "Z += M·mean(1/w') over the capacity, from rest",
);
static CHANGE: Card = card(
    "outside_change",
    "something like a change of the resistances between two runs",
    "all resistances × (1 + d) from some run on",
    "as its resistances",
);

static BENT: Card = card(
    "outside_bent",
    "something like a voltage channel whose gain depends on the level",
    "u_logged = u + k·(u − u₀)², u₀ at the first sample of the record; k in 1/V",
    "none: the amplitude is too small",
);
static RANGED: Card = card(
    "outside_ranged",
    "something like a current channel with another gain for large currents",
    "i = i_logged·(1 + g) where |i_logged| exceeds a limit by a tenth, i_logged a tenth below it, \
    in proportion between",
    "none: the current of a sweep is too small",
);

#[derive(Debug)]
struct Memory;

impl Effect for Memory {
    fn card(&self) -> &'static Card {
        &MEMORY
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.longest_s <= 0.0 || base.facts.greatest_a <= 0.0 {
            return Vec::new();
        }
        let most = 0.5 / base.facts.greatest_a;
        let range = Range {
            lower: 1.0,
            upper: 600.0,
        };
        vec![
            Parameter::strength(
                "per_a",
                "1/A",
                Range {
                    lower: -most,
                    upper: most,
                },
                0.01 * most,
            ),
            Parameter::shape("tau_s", "s", range, log_grid(4.0, 60.0, 2)),
        ]
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        z_ohm + base.erm.r_ohm * p[0] * at.amplitude_a.unwrap_or(0.0) * 2.0 / PI
    }

    fn dynamics(&self, p: &[f64], _base: &Base, _record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Remembered {
            per_a: p[0],
            tau_s: p[1],
            x_a: 0.0,
        }))
    }
}

struct Remembered {
    per_a: f64,
    tau_s: f64,
    x_a: f64,
}

impl Dynamics for Remembered {
    fn modulation(&self, _at: &Instant) -> Modulation {
        Modulation {
            series: 1.0 + self.per_a * self.x_a,
            branches: 1.0,
        }
    }

    fn advance(&mut self, at: &Instant, step_s: f64) {
        let settled = at.current_a.abs();
        self.x_a = settled + (self.x_a - settled) * (-step_s / self.tau_s).exp();
    }
}

#[derive(Debug)]
struct Friction;

impl Effect for Friction {
    fn card(&self) -> &'static Card {
        &FRICTION
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let widest = base.facts.widest_soc;
        if widest <= 0.0 {
            return Vec::new();
        }
        let range = Range {
            lower: 0.02 * widest,
            upper: 2.0 * widest,
        };
        vec![
            Parameter::strength(
                "m_v",
                "V",
                Range {
                    lower: 0.0,
                    upper: 0.2,
                },
                2e-3,
            ),
            Parameter::shape(
                "half_width",
                "",
                range,
                log_grid(0.1 * widest, 0.6 * widest, 2),
            ),
            Parameter::choice("many", POWERS.len()),
        ]
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        let halves = halves_coulomb(p, base);
        let per_coulomb = p[0]
            * halves
                .iter()
                .map(|half_coulomb| 1.0 / half_coulomb)
                .sum::<f64>()
            / halves.len() as f64;
        z_ohm - Complex64::new(0.0, per_coulomb / (TAU * at.freq_hz))
    }

    fn dynamics(&self, p: &[f64], base: &Base, _record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        let elements = halves_coulomb(p, base)
            .into_iter()
            .map(|half_coulomb| (half_coulomb, 0.0))
            .collect();
        Some(Box::new(Dragged {
            m_v: p[0],
            elements,
        }))
    }
}

/// Half widths of the elements, C.
fn halves_coulomb(p: &[f64], base: &Base) -> Vec<f64> {
    let widest_coulomb = p[1] * 3600.0 * base.ocv.capacity_ah;
    let power = POWERS[(p[2].round() as usize).min(POWERS.len() - 1)];
    let count = if power > 0.0 { ELEMENTS } else { 1 };
    (1..=count)
        .map(|k| widest_coulomb * (k as f64 / count as f64).powf(power))
        .collect()
}

struct Dragged {
    m_v: f64,
    /// Of each element the half width and the charge put in since its drag began, within the half
    /// width, C.
    elements: Vec<(f64, f64)>,
}

impl Dynamics for Dragged {
    fn voltage_v(&self, _at: &Instant) -> f64 {
        self.m_v
            * self
                .elements
                .iter()
                .map(|(half_coulomb, stretched_coulomb)| stretched_coulomb / half_coulomb)
                .sum::<f64>()
            / self.elements.len() as f64
    }

    fn advance(&mut self, at: &Instant, step_s: f64) {
        for (half_coulomb, stretched_coulomb) in &mut self.elements {
            *stretched_coulomb =
                (*stretched_coulomb - at.current_a * step_s).clamp(-*half_coulomb, *half_coulomb);
        }
    }
}

#[derive(Debug)]
struct Change;

impl Effect for Change {
    fn card(&self) -> &'static Card {
        &CHANGE
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.orders <= 0.0 {
            return Vec::new();
        }
        vec![
            Parameter::strength(
                "d",
                "",
                Range {
                    lower: -0.3,
                    upper: 1.0,
                },
                0.01,
            ),
            Parameter::choice("place", PLACES),
        ]
    }

    fn tells_repeats_apart(&self, _p: &[f64]) -> bool {
        true
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        z_ohm + changed(p, base, at.order).change_ohm(&base.erm, at.freq_hz)
    }

    fn dynamics(&self, p: &[f64], base: &Base, record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Changed {
            modulation: changed(p, base, record.order),
        }))
    }
}

fn changed(p: &[f64], base: &Base, order: f64) -> Modulation {
    let from = (p[1] + 1.0) / (PLACES as f64 + 1.0) * base.facts.orders;
    Modulation::all(1.0 + if order > from { p[0] } else { 0.0 })
}

struct Changed {
    modulation: Modulation,
}

impl Dynamics for Changed {
    fn modulation(&self, _at: &Instant) -> Modulation {
        self.modulation
    }
}

#[derive(Debug)]
struct Bent;

impl Effect for Bent {
    fn card(&self) -> &'static Card {
        &BENT
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.longest_s <= 0.0 || base.facts.greatest_a <= 0.0 {
            return Vec::new();
        }
        vec![Parameter::strength(
            "per_v",
            "1/V",
            Range {
                lower: -0.3,
                upper: 0.3,
            },
            0.01,
        )]
    }

    fn voltage(&self, p: &[f64], _record: &Record<'_>, voltage_v: &mut [f64]) {
        let level_v = voltage_v.first().copied().unwrap_or(0.0);
        voltage_v
            .iter_mut()
            .for_each(|v| *v += p[0] * (*v - level_v) * (*v - level_v));
    }
}

#[derive(Debug)]
struct Ranged;

impl Effect for Ranged {
    fn card(&self) -> &'static Card {
        &RANGED
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let greatest_a = base.facts.greatest_a;
        if base.facts.longest_s <= 0.0 || greatest_a <= 0.0 {
            return Vec::new();
        }
        let range = Range {
            lower: 0.01 * greatest_a,
            upper: greatest_a,
        };
        let from_a = Parameter {
            scale: Scale::Choice,
            ..Parameter::shape(
                "from_a",
                "A",
                range,
                FROM.map(|part| part * greatest_a).to_vec(),
            )
        };
        vec![
            Parameter::strength(
                "gain",
                "",
                Range {
                    lower: -0.2,
                    upper: 0.2,
                },
                0.01,
            ),
            from_a,
        ]
    }

    fn current(&self, p: &[f64], _record: &Record<'_>, current_a: &mut [f64]) {
        let above = |i: f64| (0.5 * (1.0 + (i.abs() / p[1] - 1.0) / WITHIN)).clamp(0.0, 1.0);
        current_a
            .iter_mut()
            .for_each(|i| *i *= 1.0 + p[0] * above(*i));
    }
}
