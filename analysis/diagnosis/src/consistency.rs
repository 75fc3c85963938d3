//! Tests whether a named effect has the same value in all measurements.
//!
//! A true structure needs one value of each of its quantities; what imitates another one would need
//! one value for small currents and another for large ones, or in one kind of run and in the next.
//! The quantities asked are all resistances together and every parameter of the named effects. With
//! a derivative of the whitened rows by a quantity taken in one class of circumstances only,
//! outside the model's tangent space, and q₁ … qₘ an orthonormal basis of what all classes of one
//! kind make of it,
//!
//! ```text
//! Q = Σ (qₖᵀ·r)²
//! ```
//!
//! is the χ² that would go if the quantity had a value per class, about Cochran's Q (Biometrics
//! 10, 1954): χ² of m degrees of freedom where one value does. The sum of all squares knows nothing
//! of directions and needs far more. Probabilities are corrected after Holm over all quantities and
//! kinds of classes.

use super::block::{Current, Kind, Workspace};
use super::data::Role;
use super::guards::beyond_formula;
use super::inconsistency::Inconsistency;
use super::intermittent::intermittent_contact;
use super::localise::{Ranges, places};
use super::periodic::{Wave, wave};
use super::problem::{Fit, Problem, Tangent};
use super::repeat_mean::repeat_mean_residual;
use super::structure::Structure;
use super::whitening::dot;
use crate::thresholds::{DIRECTION_LEFT_PART, MOST_TURNS, PULSE_FLOWS_PART};
use analysis_fit::validity::tail::{chi2_tail, holm};
use std::collections::BTreeMap;

/// Step of the logarithm of all resistances.
const STEP: f64 = 1e-3;

/// A quantity: its name and how the coordinates move with it.
struct Quantity {
    name: String,
    moves: Vec<(usize, f64)>,
}

/// Rows of each class of one kind of circumstances: per training block the class of every row.
type Classes = Vec<Vec<Option<u32>>>;

/// All quantities over all kinds of circumstances, most significant first. `gained` is the χ² that
/// the named effects have removed.
pub(super) fn inconsistencies(
    problem: &Problem,
    fit: &Fit,
    gained: f64,
    workspace: &mut Workspace,
) -> Vec<Inconsistency> {
    let train: Vec<usize> = problem.of_role(Role::Train).collect();
    let kinds = kinds(problem, &train);
    // The tangent must contain exactly what one value for all runs makes.
    let tangent = problem.exact_tangent(fit, workspace);
    let mut found: Vec<Inconsistency> = Vec::new();
    let predict = |x: &[f64], workspace: &mut Workspace| -> Vec<Vec<f64>> {
        train
            .iter()
            .map(|k| problem.predict(fit.structure.at(x), *k, 1, workspace))
            .collect()
    };
    let plain = predict(&fit.x, workspace);
    let residual = free_of_current_noise(problem, &train, fit, workspace);
    for (n, quantity) in quantities(problem, fit).into_iter().enumerate() {
        let mut x = fit.x.clone();
        quantity.moves.iter().for_each(|(k, step)| x[*k] += step);
        let moved = predict(&x, workspace);
        let change: Vec<Vec<f64>> = moved
            .iter()
            .zip(&plain)
            .map(|(m, p)| m.iter().zip(p).map(|(m, p)| m - p).collect())
            .collect();
        for (over, classes) in &kinds {
            // Each single pulse is tested for its resistance only.
            if *over == PULSES && n > 0 {
                continue;
            }
            let (q, dof) = between(problem, &train, &change, classes, &tangent, &residual);
            let beyond = beyond_formula(q, gained);
            if dof > 0 {
                let p_value = chi2_tail(beyond, dof as f64);
                found.push(Inconsistency {
                    message: format!("{} is not the same over {over}", quantity.name),
                    chi2: q,
                    dof,
                    p_value,
                    is_contact: false,
                });
            }
        }
    }
    if let Some(Wave {
        period_s,
        chi2,
        dof,
        p_value,
    }) = wave(problem, fit, |chi2| beyond_formula(chi2, gained))
    {
        let message =
            format!("what is left is not the same over the phase of a wave of {period_s:.3} s");
        found.push(Inconsistency {
            message,
            chi2,
            dof,
            p_value,
            is_contact: false,
        });
    }
    let corrected = holm(&found.iter().map(|f| f.p_value).collect::<Vec<f64>>());
    found
        .iter_mut()
        .zip(corrected)
        .for_each(|(f, p)| f.p_value = p);
    // These are separate families: their findings do not belong to circumstances.
    found.extend(intermittent_contact(problem, fit, gained));
    found.extend(repeat_mean_residual(problem, fit, gained));
    found.sort_by(|a, b| {
        a.p_value
            .total_cmp(&b.p_value)
            .then((b.chi2 / b.dof as f64).total_cmp(&(a.chi2 / a.dof as f64)))
    });
    found
}

/// Removes the noise of the logged current in the prediction from the residuals. The derivatives
/// contain that noise as well: if little else flows, a resistance estimated from the logged current
/// would always be zero. The noise is propagated through the base alone. For an effect that depends
/// on the sign of the current, a rest with noise differs from a rest without.
fn free_of_current_noise(
    problem: &Problem,
    train: &[usize],
    fit: &Fit,
    workspace: &mut Workspace,
) -> Vec<f64> {
    let (structure, base) = (Structure::default(), &fit.x[..=2 * problem.branches()]);
    let mut noise = Vec::with_capacity(fit.residuals.len());
    for k in train {
        let mut predict =
            |current| problem.predict_under(structure.at(base), *k, current, 1, workspace);
        let (logged, driven) = (predict(Current::Logged), predict(Current::Driven));
        let rows: Vec<f64> = logged.iter().zip(driven).map(|(l, d)| l - d).collect();
        problem.whiteners[*k].apply(&rows, &mut noise);
    }
    problem.shared.apply(&mut noise);
    fit.residuals
        .iter()
        .zip(noise)
        .map(|(r, n)| r + n)
        .collect()
}

/// All resistances, and every parameter of the effects.
fn quantities(problem: &Problem, fit: &Fit) -> Vec<Quantity> {
    let branches = problem.branches();
    // The times of the branches go with their resistances, for capacitances stay.
    let mut all = vec![Quantity {
        name: "the resistance".to_owned(),
        moves: (0..=2 * branches).map(|k| (k, STEP)).collect(),
    }];
    for (m, member) in fit.structure.members.iter().enumerate() {
        let first = fit.structure.first(m, branches);
        for k in first..first + member.free() {
            let step = fit.axes[k].inwards(fit.x[k]);
            let of = if k == first { "size" } else { "shape" };
            all.push(Quantity {
                name: format!("the {of} of {}", member.effect.card().title),
                moves: vec![(k, step)],
            });
        }
    }
    all
}

/// Every stretch of constant current separately.
const PULSES: &str = "single pulses";

/// Counter of the current's changes of direction.
#[derive(Default)]
struct Turns {
    last_a: f64,
    count: u32,
}

impl Turns {
    fn after(&mut self, current_a: f64) -> u32 {
        if self.last_a * current_a < 0.0 {
            self.count = (self.count + 1).min(MOST_TURNS);
        }
        if current_a != 0.0 {
            self.last_a = current_a;
        }
        self.count
    }
}

/// Kinds of circumstances with their classes.
fn kinds(problem: &Problem, train: &[usize]) -> BTreeMap<&'static str, Classes> {
    let ranges = Ranges::new(problem);
    let mut kinds: BTreeMap<&'static str, Classes> = BTreeMap::new();
    let empty: Classes = train
        .iter()
        .map(|k| vec![None; problem.blocks[*k].rows()])
        .collect();
    let mut groups: Vec<&str> = Vec::new();
    let mut pulses = 0;
    for (b, k) in train.iter().enumerate() {
        let block = &problem.blocks[*k];
        let group = groups
            .iter()
            .position(|g| *g == block.group)
            .unwrap_or_else(|| {
                groups.push(&block.group);
                groups.len() - 1
            });
        let mut put = |over, row: usize, class: u32| {
            kinds.entry(over).or_insert_with(|| empty.clone())[b][row] = Some(class);
        };
        let mut turns = Turns::default();
        for row in 0..block.rows() {
            put("kinds of run", row, group as u32);
            for (over, class, _) in places(block, row, &ranges) {
                put(over, row, class);
            }
            let Kind::Time(time) = &block.kind else {
                continue;
            };
            put(
                "number of reversals",
                row,
                turns.after(time.bins[row].last_current_a),
            );
            if time.bins[row].current_a.abs() > PULSE_FLOWS_PART * problem.base.facts.greatest_a {
                put(
                    PULSES,
                    row,
                    pulses + time.edges.partition_point(|e| *e <= time.bins[row].from) as u32,
                );
            }
        }
        if let Kind::Time(time) = &block.kind {
            pulses += 1 + time.edges.len() as u32;
        }
    }
    kinds
}

/// Q of a quantity with a value per class, and its degrees of freedom.
fn between(
    problem: &Problem,
    train: &[usize],
    change: &[Vec<f64>],
    classes: &Classes,
    tangent: &Tangent,
    residuals: &[f64],
) -> (f64, usize) {
    let mut names: Vec<u32> = classes.iter().flatten().flatten().copied().collect();
    names.sort_unstable();
    names.dedup();
    let mut basis = tangent.clone();
    let own = basis.basis.len();
    for class in names {
        let mut column = Vec::with_capacity(residuals.len());
        for (b, k) in train.iter().enumerate() {
            if classes[b].contains(&Some(class)) {
                let rows: Vec<f64> = change[b]
                    .iter()
                    .zip(&classes[b])
                    .map(|(c, of)| if *of == Some(class) { *c } else { 0.0 })
                    .collect();
                problem.whiteners[*k].apply(&rows, &mut column);
            } else {
                column.resize(column.len() + classes[b].len(), 0.0);
            }
        }
        problem.shared.apply(&mut column);
        let size = dot(&column, &column);
        let mut residual = column;
        basis.project(&mut residual);
        if dot(&residual, &residual) > DIRECTION_LEFT_PART * DIRECTION_LEFT_PART * size {
            basis.add(residual);
        }
    }
    let along = basis.basis[own..]
        .iter()
        .map(|q| dot(q, residuals).powi(2))
        .sum();
    (along, basis.basis.len() - own)
}
