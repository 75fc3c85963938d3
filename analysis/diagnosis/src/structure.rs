//! A model structure: the base's parameters and those of the effects added, as one vector for the
//! search.
//!
//! Order: ln R, ln R₁, ln τ₁, ln R₂, …; then per effect its strength in units of its typical size
//! and its shapes' logarithms. Choices are not in the vector: another choice is another structure.

use crate::thresholds::{AT_BOUND_PART, RESISTANCE_REACH, TIME_REACH};
use analysis_effects::{
    augmented::Added,
    contract::{Base, Effect, Parameter, Range, Scale},
};
use analysis_model::model::{Erm, RcBranch};

/// Longest move of a logarithm in one step of a fit.
const LONGEST_LOG: f64 = 1.0;
/// The same of a strength, as a part of the way between its bounds.
const LONGEST_PART: f64 = 0.25;

/// One effect of a structure.
#[derive(Clone)]
pub(super) struct Member {
    pub(super) effect: &'static dyn Effect,
    pub(super) parameters: Vec<Parameter>,
    /// Values of the choices, by the index of the parameter; other entries are not read.
    pub(super) choice: Vec<f64>,
    /// Values to start from, in physical units.
    pub(super) start: Vec<f64>,
}

impl std::fmt::Debug for Member {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Member")
            .field("effect", &self.effect.card().name)
            .field("start", &self.start)
            .finish_non_exhaustive()
    }
}

impl Member {
    pub(super) fn name(&self) -> &'static str {
        self.effect.card().name
    }

    /// Returns the same with all shapes held at their starts; their grid counts as a choice.
    pub(super) fn frozen(&self) -> Self {
        let mut held = self.clone();
        held.choice = self.start.clone();
        held.parameters
            .iter_mut()
            .skip(1)
            .for_each(|p| p.scale = Scale::Choice);
        held
    }

    /// Returns the same with other starts.
    pub(super) fn from(&self, start: &[f64]) -> Self {
        Self {
            start: start.to_vec(),
            ..self.clone()
        }
    }

    /// Returns an effect at these values. Its bounds reach at least to them.
    pub(super) fn given(effect: &'static dyn Effect, base: &Base, values: Vec<f64>) -> Self {
        let mut parameters = searched(effect, base, &values);
        for (p, value) in parameters.iter_mut().zip(&values) {
            p.range.lower = p.range.lower.min(*value);
            p.range.upper = p.range.upper.max(*value);
        }
        Self {
            effect,
            parameters,
            choice: values.clone(),
            start: values,
        }
    }

    /// Coordinates of its starts.
    pub(super) fn encode(&self) -> Vec<f64> {
        let coordinate = |p: &Parameter, v: f64| match p.scale {
            Scale::Linear => Some(v / p.typical),
            Scale::Log => Some(v.max(1e-300).ln()),
            Scale::Choice => None,
        };
        self.parameters
            .iter()
            .zip(&self.start)
            .filter_map(|(p, v)| coordinate(p, *v))
            .collect()
    }

    /// Returns the number of combinations of its choices.
    pub(super) fn choices(&self) -> usize {
        self.parameters
            .iter()
            .filter(|p| p.scale == Scale::Choice)
            .map(|p| p.starts.len())
            .product()
    }

    /// Returns its parameters with all shapes searched. Bounds that were moved stay there.
    pub(super) fn searched(&self, base: &Base, values: &[f64]) -> Vec<Parameter> {
        let mut own = searched(self.effect, base, values);
        for (p, moved) in own.iter_mut().zip(&self.parameters) {
            p.range.lower = p.range.lower.min(moved.range.lower);
            p.range.upper = p.range.upper.max(moved.range.upper);
            p.usual = p.usual.or(moved.usual);
        }
        own
    }

    /// Parameters that are searched.
    pub(super) fn free(&self) -> usize {
        self.parameters
            .iter()
            .filter(|p| p.scale != Scale::Choice)
            .count()
    }
}

/// The base with effects.
#[derive(Debug, Clone)]
pub(super) struct Structure {
    pub(super) members: Vec<Member>,
    /// Parts that every step of a record is divided into.
    pub(super) parts: usize,
}

impl Default for Structure {
    fn default() -> Self {
        Self {
            members: Vec::new(),
            parts: 1,
        }
    }
}

/// A structure with the values of its vector.
#[derive(Debug, Clone, Copy)]
pub(super) struct At<'a> {
    pub(super) structure: &'a Structure,
    pub(super) x: &'a [f64],
}

/// Axis of the search that a vector entry belongs to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Axis {
    pub(super) lower: f64,
    pub(super) upper: f64,
    /// Step of finite differences.
    pub(super) step: f64,
    /// Longest move in one step of a fit.
    pub(super) longest: f64,
}

impl Axis {
    /// Of a strength between its bounds, in units of its typical size.
    fn strength(lower: f64, upper: f64) -> Self {
        Self {
            lower,
            upper,
            step: 1e-3,
            longest: LONGEST_PART * (upper - lower),
        }
    }

    /// Returns the step of finite differences from a value, on the side with room.
    pub(super) fn inwards(&self, x: f64) -> f64 {
        if x + self.step > self.upper {
            -self.step
        } else {
            self.step
        }
    }
}

impl Structure {
    pub(super) fn at<'a>(&'a self, x: &'a [f64]) -> At<'a> {
        At { structure: self, x }
    }

    pub(super) fn with(&self, member: Member) -> Self {
        let mut members = self.members.clone();
        members.push(member);
        Self {
            members,
            parts: self.parts,
        }
    }

    pub(super) fn without(&self, index: usize) -> Self {
        let mut members = self.members.clone();
        members.remove(index);
        Self {
            members,
            parts: self.parts,
        }
    }

    /// Returns the axes of the vector, the base's first; its bounds lie around `start`.
    pub(super) fn axes(&self, start: &Erm) -> Vec<Axis> {
        let around = |value: f64, reach: f64| Axis {
            lower: value - reach.ln(),
            upper: value + reach.ln(),
            step: 1e-4,
            longest: LONGEST_LOG,
        };
        let whole_ohm = start.dc_resistance_ohm();
        let mut axes: Vec<Axis> = encode_erm(start)
            .iter()
            .enumerate()
            .map(|(k, x)| {
                if k > 0 && k % 2 == 0 {
                    return around(*x, TIME_REACH);
                }
                // A resistance that the spectra have lost may still be all of the cell's.
                let axis = around(*x, RESISTANCE_REACH);
                let upper = axis.upper.max(whole_ohm.ln());
                Axis { upper, ..axis }
            })
            .collect();
        for p in self.members.iter().flat_map(|m| &m.parameters) {
            let Range { lower, upper } = p.range;
            match p.scale {
                Scale::Linear => axes.push(Axis::strength(lower / p.typical, upper / p.typical)),
                Scale::Log => axes.push(Axis {
                    lower: lower.ln(),
                    upper: upper.ln(),
                    step: 1e-3,
                    longest: LONGEST_LOG,
                }),
                Scale::Choice => {}
            }
        }
        axes
    }

    /// The vector of a base and the members' starts.
    pub(super) fn encode(&self, erm: &Erm) -> Vec<f64> {
        let mut x = encode_erm(erm);
        self.members.iter().for_each(|m| x.extend(m.encode()));
        x
    }

    /// Base and effect values of a vector.
    pub(super) fn decode(&self, x: &[f64], branches: usize) -> (Erm, Vec<Vec<f64>>) {
        let erm = decode_erm(&x[..1 + 2 * branches]);
        let mut rest = x[1 + 2 * branches..].iter();
        let values = self
            .members
            .iter()
            .map(|m| {
                m.parameters
                    .iter()
                    .enumerate()
                    .map(|(k, p)| match p.scale {
                        Scale::Linear => rest.next().copied().unwrap_or(0.0) * p.typical,
                        Scale::Log => rest.next().copied().unwrap_or(0.0).exp(),
                        Scale::Choice => m.choice[k],
                    })
                    .collect()
            })
            .collect();
        (erm, values)
    }

    /// Returns the index in the vector of the first parameter of a member.
    pub(super) fn first(&self, member: usize, branches: usize) -> usize {
        1 + 2 * branches
            + self.members[..member]
                .iter()
                .map(Member::free)
                .sum::<usize>()
    }

    /// Returns whether an effect among them distinguishes repeats: the response to all other
    /// parameters then differs in each, too.
    pub(super) fn tells_repeats_apart(&self) -> bool {
        self.members
            .iter()
            .any(|m| m.effect.tells_repeats_apart(&m.choice))
    }

    /// Returns the effects with their values.
    pub(super) fn added<'a>(&'a self, values: &'a [Vec<f64>]) -> Vec<Added<'a>> {
        self.members
            .iter()
            .zip(values)
            .map(|(m, p)| Added {
                effect: m.effect,
                p,
            })
            .collect()
    }
}

/// Returns true if a value of an axis lies at one of its bounds. A strength may be small: near a
/// bound of zero it is judged by its interval instead.
pub(super) fn at_bound(x: f64, axis: &Axis) -> bool {
    let near = AT_BOUND_PART * (axis.upper - axis.lower);
    let absent = axis.lower == 0.0 && x > 0.0;
    (x - axis.lower <= near && !absent) || axis.upper - x <= near
}

fn encode_erm(erm: &Erm) -> Vec<f64> {
    std::iter::once(erm.r_ohm.ln())
        .chain(
            erm.branches
                .iter()
                .flat_map(|b| [b.r_ohm.ln(), b.time_constant_s().ln()]),
        )
        .collect()
}

fn decode_erm(x: &[f64]) -> Erm {
    let branches = x[1..]
        .chunks_exact(2)
        .map(|b| RcBranch {
            r_ohm: b[0].exp(),
            c_f: (b[1] - b[0]).exp(),
        })
        .collect();
    Erm {
        r_ohm: x[0].exp(),
        branches,
    }
}

/// All combinations of starts of the shapes and choices of an effect, the strength left at zero.
pub(super) fn variants(effect: &'static dyn Effect, base: &Base) -> Vec<Member> {
    let parameters = effect.parameters(base);
    // If the data leave a parameter no room (no current flows, the curve is flat), there is nothing
    // to search.
    let room = |p: &Parameter| {
        p.range.lower.is_finite()
            && p.range.upper.is_finite()
            && p.range.upper > p.range.lower
            && p.typical > 0.0
    };
    if parameters.is_empty() || !parameters.iter().all(room) {
        return Vec::new();
    }
    let mut starts: Vec<Vec<f64>> = vec![vec![0.0]];
    for p in &parameters[1..] {
        let of = |s: &Vec<f64>| {
            if meant(p, s) {
                p.starts.clone()
            } else {
                vec![p.starts[0]]
            }
        };
        starts = starts
            .iter()
            .flat_map(|s| {
                of(s)
                    .into_iter()
                    .map(move |v| s.iter().copied().chain([v]).collect())
            })
            .collect();
    }
    let member = |start: Vec<f64>| Member {
        effect,
        parameters: searched(effect, base, &start),
        choice: start.clone(),
        start,
    };
    starts.into_iter().map(member).collect()
}

/// Returns whether a parameter has a meaning beside these values.
fn meant(p: &Parameter, values: &[f64]) -> bool {
    p.only_with
        .is_none_or(|(index, value)| values[index] == value)
}

/// Returns the parameters of an effect with these choices: what has no meaning then is not
/// searched.
fn searched(effect: &'static dyn Effect, base: &Base, values: &[f64]) -> Vec<Parameter> {
    let mut parameters = effect.parameters(base);
    parameters
        .iter_mut()
        .filter(|p| !meant(p, values))
        .for_each(|p| (p.scale, p.starts) = (Scale::Choice, vec![p.starts[0]]));
    parameters
}
