//! Measures for a study of the workflow: the size of the hidden effects, and the performance of an
//! oracle model that knows the truth.
//!
//! Nothing here is used by a diagnosis.

use super::block::{DataSetError, Workspace};
use super::compose::refitted;
use super::data::DataSet;
use super::diagnose::base_fit;
use super::gap::{Fits, gaps};
use super::guards::Guards;
use super::outcome::Gap;
use super::prepare::{BaseModel, prepare};
use super::problem::{Fit, Problem};
use super::propose::propose;
use analysis_effects::effects::find;

/// λ: χ² of noise-free data after the base model is refitted to them, under the noise of the noisy
/// data. It is the χ² that the true structure would remove.
///
/// # Errors
/// [`DataSetError`] for a set that cannot be used.
pub fn removable_chi2(
    noisy: &DataSet,
    clean: &DataSet,
    model: &BaseModel,
) -> Result<f64, DataSetError> {
    removable_beside(noisy, clean, model, &[])
}

/// Returns the same with these effects added and refitted too: the χ² that the effects missing
/// beside them would remove.
///
/// # Errors
/// [`DataSetError`] for a set that cannot be used or a name that is not in the catalogue.
pub fn removable_beside(
    noisy: &DataSet,
    clean: &DataSet,
    model: &BaseModel,
    names: &[&str],
) -> Result<f64, DataSetError> {
    let prepared = prepare(noisy, model, Guards::default())?.with_runs(clean)?;
    let mut workspace = Workspace::default();
    let base = base_fit(&prepared.problem, &model.erm, &mut workspace);
    Ok(with_effects(&prepared.problem, base, names, &mut workspace)?.chi2)
}

/// Returns a fit with these effects added, one after the other.
fn with_effects(
    problem: &Problem,
    mut fit: Fit,
    names: &[&str],
    workspace: &mut Workspace,
) -> Result<Fit, DataSetError> {
    for name in names {
        let effect = find(name).ok_or_else(|| DataSetError::Set {
            name: (*name).to_owned(),
            expected: "effects of the catalogue",
        })?;
        let now = problem.prediction(fit.at(), workspace);
        let proposals = propose(problem, &fit, &now, &fit.tangent(), effect, workspace);
        let mut best: Option<Fit> = None;
        for proposal in proposals.iter().take(4) {
            let found = problem.fit_added(&fit, &proposal.member, false, workspace);
            if best.as_ref().is_none_or(|b| found.chi2 < b.chi2) {
                best = Some(found);
            }
        }
        fit = best.unwrap_or(fit);
    }
    Ok(fit)
}

/// Gaps on the held-out records of the base with the named effects, fitted without any question
/// whether they belong there.
///
/// # Errors
/// [`DataSetError`] for a set that cannot be used or a name that is not in the catalogue.
pub fn oracle(
    set: &DataSet,
    model: &BaseModel,
    names: &[&str],
) -> Result<(f64, Vec<Gap>), DataSetError> {
    let prepared = prepare(set, model, Guards::default())?;
    let problem = &prepared.problem;
    let mut workspace = Workspace::default();
    let base = base_fit(problem, &model.erm, &mut workspace);
    let fit = with_effects(problem, base.clone(), names, &mut workspace)?;
    // As a diagnosis does with its named effects.
    let again = refitted(&prepared, [&base, &fit], Guards::default());
    let (prepared, [base, fit]) = again.unwrap_or((prepared, [base, fit]));
    let fits = Fits {
        base: &base,
        augmented: &fit,
    };
    Ok((fit.chi2, gaps(&prepared, &model.erm, fits, &mut workspace)))
}
