//! Determines, before any fit, which effects a data set can separate.
//!
//! r[A, B] is the part of A's signal outside the base's tangent space that B cannot imitate: 1 −
//! cos² of the angle between their directions, the least over the starts of B's shapes, to first
//! order and around the base. It does not depend on the strength of A; √(λ·r) is the separation in
//! standard deviations.

use super::block::{DataSetError, Workspace};
use super::data::DataSet;
use super::diagnose::base_fit;
use super::guards::Guards;
use super::prepare::{BaseModel, prepare};
use super::propose::direction;
use super::report::Distinguishability;
use super::structure::variants;
use super::whitening::dot;
use analysis_effects::contract::Effect;

/// One effect's directions, one per variant, outside the tangent space.
struct Directions {
    name: &'static str,
    /// Whitened change per typical strength.
    all: Vec<Vec<f64>>,
    /// The strength cannot be negative.
    one_sided: bool,
}

/// Returns the matrix of a data set for those effects that apply to it; rows are the true effects
/// at their typical strength.
///
/// # Errors
/// [`DataSetError`] for a set that cannot be used.
pub fn distinguish(
    set: &DataSet,
    model: &BaseModel,
    effects: &[&'static dyn Effect],
) -> Result<Distinguishability, DataSetError> {
    let prepared = prepare(set, model, Guards::default())?;
    let problem = &prepared.problem;
    let mut workspace = Workspace::default();
    let fit = base_fit(problem, &model.erm, &mut workspace);
    let tangent = fit.tangent();
    let predicted = problem.prediction(fit.at(), &mut workspace);
    let mut found: Vec<Directions> = Vec::new();
    for effect in effects {
        let members = variants(*effect, &problem.base);
        let one_sided = members
            .first()
            .is_some_and(|m| m.parameters[0].range.lower >= 0.0);
        let mut all = Vec::new();
        for member in members {
            let Some(mut d) = direction(
                problem,
                &fit,
                &predicted,
                &fit.structure.with(member),
                1.0,
                &mut workspace,
            ) else {
                continue;
            };
            let whole = dot(&d, &d);
            tangent.project(&mut d);
            // A change that the base imitates to the last digit has no direction.
            if dot(&d, &d) > 1e-12 * whole {
                all.push(d);
            }
        }
        if !all.is_empty() {
            found.push(Directions {
                name: effect.card().name,
                all,
                one_sided,
            });
        }
    }
    let mut r = Vec::new();
    let mut separation_sigma = Vec::new();
    for a in &found {
        let signal = &a.all[a.all.len() / 2];
        let size = dot(signal, signal);
        let row: Vec<f64> = found
            .iter()
            .map(|b| {
                if a.name == b.name {
                    0.0
                } else {
                    apart(signal, b)
                }
            })
            .collect();
        separation_sigma.push(row.iter().map(|r| (size * r).sqrt()).collect());
        r.push(row);
    }
    Ok(Distinguishability {
        labels: found.iter().map(|d| d.name.to_owned()).collect(),
        r,
        separation_sigma,
    })
}

fn apart(signal: &[f64], other: &Directions) -> f64 {
    let size = dot(signal, signal);
    let of = |d: &Vec<f64>| {
        let along = dot(signal, d);
        if other.one_sided && along < 0.0 {
            1.0
        } else {
            1.0 - along * along / (size * dot(d, d))
        }
    };
    other.all.iter().map(of).fold(1.0, f64::min).max(0.0)
}
