//! The workflow from a data set to a verdict.

use super::block::{DataSetError, Workspace};
use super::compose::{Composed, curves, measured, quality, refitted, search};
use super::consistency::inconsistencies;
use super::data::{DataSet, Role};
use super::experiment::{Advice, PlannedRun, recommend};
use super::gap::{Fits, gaps, rms_mv, spectrum_gaps};
use super::given;
use super::guards::Guards;
use super::intervals::named;
use super::judge::{Doubts, judge};
use super::localise::localise;
use super::mechanisms::judge_mechanisms;
use super::noise::TERMS;
use super::options::DiagnosisOptions;
use super::outcome::{
    ByHandGap, DIAGNOSIS_SCHEMA, DIAGNOSIS_SCHEMA_VERSION, Diagnosis, NoiseReport, NoiseTerm,
    Rival, RunCurves, Verdict,
};
use super::predictive::terms;
use super::prepare::{BaseModel, Prepared, prepare};
use super::problem::{Fit, Problem};
use super::search::excess_z;
use super::select::Selection;
use super::structure::Structure;
use super::whitening::dot;
use crate::thresholds::{LEAST_BLOCK_P, MISFIT_Z, OTHER_STARTS, SENTINEL_Z};
use analysis_effects::contract::Facts;
use analysis_fit::fit::PROGRAM;
use analysis_model::model::Erm;
use analysis_numeric::linalg::{cholesky, cholesky_substitute};

/// A diagnosis and the curves behind its pictures.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Diagnosis as it is written to a file.
    pub diagnosis: Diagnosis,
    /// One entry per run.
    pub curves: Vec<RunCurves>,
    /// Range of the data, which an augmented model file keeps; none for data that cannot be used.
    pub facts: Option<Facts>,
    /// The runs of [`Diagnosis::next_experiment`].
    pub next_runs: Vec<PlannedRun>,
}

/// Diagnoses a data set that passed the gate against a model, with these guards on.
///
/// # Errors
/// [`DataSetError`] for a set or run that cannot be used at all.
pub(crate) fn diagnose_with(
    set: &DataSet,
    model: &BaseModel,
    options: &DiagnosisOptions,
    guards: Guards,
) -> Result<Outcome, DataSetError> {
    options.progress.tell("fitting the model again");
    let mut prepared = prepare(set, model, guards)?;
    prepared.problem.given = given::structure(&prepared.problem.base, &options.given)?;
    let options = &options.without_left_out();
    let mut workspace = Workspace::default();
    let mut base = ground(&prepared, model, options, guards)?;
    if prepared.problem.degrees_of_freedom(&base) < 1.0 {
        return Err(DataSetError::Set {
            name: set.name.clone(),
            expected: "more training rows than the model has parameters",
        });
    }
    let mut selection = search(&prepared, options, guards).run(&base);
    let mut moved = if guards.sentinel {
        moved_floor(&prepared)
    } else {
        None
    };
    if moved.is_some() {
        // A missing effect can look like noise that changed. The repeats are judged again by their
        // residuals.
        prepared = prepared.again(&selection.fit, guards)?;
        moved = moved_floor(&prepared);
        if moved.is_some() && prepared.prior.known {
            // The missing effect may have been counted as noise from the start. It is therefore
            // searched under the noise that the bench had before.
            prepared = prepared.of_history(guards)?;
            let base = ground(&prepared, model, options, guards)?;
            let fit = search(&prepared, options, guards).run(&base).fit;
            prepared = prepared.again(&fit, guards)?;
            moved = moved_floor(&prepared);
        }
        if moved.is_some() && measured(&prepared) {
            let other = restated(&prepared, &selection.fit, guards)?;
            if moved_floor(&other).is_none() {
                (prepared, moved) = (other, None);
            }
        }
        base = ground(&prepared, model, options, guards)?;
        let mut search = search(&prepared, options, guards);
        selection = if moved.is_some() {
            // No effect is named, but held-out records may still show which addition predicts them.
            Selection {
                first_attempts: search.attempts(&base, None).0,
                ..Selection::nothing(&base)
            }
        } else {
            search.run(&base)
        };
    }
    let again = if selection.selected.is_empty() {
        None
    } else {
        refitted(&prepared, [&selection.base, &selection.fit], guards)
    };
    let again = again.map(|(prepared, [base, fit])| {
        (
            prepared,
            Selection {
                base,
                fit,
                ..selection.clone()
            },
        )
    });
    let (judged, last) = again
        .as_ref()
        .map_or((&prepared, &selection), |(prepared, selection)| {
            (prepared, selection)
        });
    // The search may have met a deeper minimum of the base.
    let (problem, base, fit) = (&judged.problem, &last.base, &last.fit);
    let fits = Fits {
        base,
        augmented: fit,
    };
    let mut d = Diagnosis {
        schema: DIAGNOSIS_SCHEMA,
        schema_version: DIAGNOSIS_SCHEMA_VERSION,
        program: PROGRAM,
        data_set: set.name.clone(),
        model: model.name.clone(),
        verdict: Verdict::Unexplained,
        summary: String::new(),
        effects: named(problem, last, &mut workspace),
        rivals: rivals(&selection),
        blocks: localise(problem, base, guards.tangent_projection, &mut workspace),
        where_after: localise(problem, fit, guards.tangent_projection, &mut workspace),
        gap: gaps(judged, &model.erm, fits, &mut workspace),
        gap_spectra: spectrum_gaps(problem, &model.erm, fits, &mut workspace),
        next_experiment: None,
        inseparable: Vec::new(),
        findings: Vec::new(),
        accepted: Vec::new(),
        notes: Vec::new(),
        quality: quality(problem, base, fit),
        noise: noise_report(judged),
        ranking: selection.ranking.clone(),
        base: Some(base.decode(problem.branches()).0),
        augmented: Some(fit.decode(problem.branches()).0),
        predictive: None,
        shares: Vec::new(),
        given: terms(problem, base),
        by_hand: by_hand(judged, base, model, options),
    };
    d.notes.extend(overruled(judged));
    if !options.given.is_empty() {
        d.notes
            .push("findings on the data compare with the model without its additions".to_owned());
    }
    let held_out_z = held_out_z(problem, fit, &mut workspace);
    let asked = guards.consistency && measured(judged);
    let differs = if asked {
        inconsistencies(problem, fit, base.chi2 - fit.chi2, &mut workspace)
    } else {
        Vec::new()
    };
    let has_moved = moved.is_some();
    let has_contact = differs
        .first()
        .is_some_and(|one| one.is_contact && one.p_value <= LEAST_BLOCK_P);
    judge(
        &mut d,
        &selection,
        Doubts {
            moved,
            held_out_z,
            differs,
        },
    );
    let mut composed_curves = None;
    options.progress.tell("planning the next run");
    let advice = recommend(
        &prepared,
        d.verdict,
        &selection,
        options.limits,
        options.playable.as_ref(),
    );
    d.notes.extend(advice.notes());
    let Advice { next, inseparable } = advice;
    d.inseparable = inseparable;
    if d.verdict.is_open() && (next.is_none() || !options.next_run_first) {
        options.progress.tell("choosing terms that predict");
        let refit_mv = rms_mv(&d.gap, |gap| gap.base_mv);
        let fit = predictive(&prepared, &selection, options, guards);
        let composed = fit.and_then(|fit| {
            let mut tries = Composed::under_both_noises(&prepared, &selection.base, fit, guards);
            tries.find_map(|composed| composed.tested(model, options, guards, refit_mv))
        });
        if let Some((composed, found)) = composed {
            // A law outside the catalogue that leads may be any mechanism.
            if selection.outside.is_none() {
                d.shares = composed.shares(model, options, guards);
            }
            // Noise that seemed to have moved may have been the missing mechanisms.
            let is_steady = !has_moved || moved_floor(&composed.prepared).is_none();
            if is_steady && !has_contact && judge_mechanisms(&mut d) {
                composed_curves = Some(composed.describe(&mut d, model));
                d.noise = noise_report(&composed.prepared);
            }
            d.predictive = Some(found);
        }
    }
    if next.is_none() && d.verdict.is_open() {
        d.notes
            .push("no run of the menu can separate the remaining candidates".to_owned());
    }
    let (next_experiment, next_runs) = next.unzip();
    d.next_experiment = next_experiment;
    Ok(Outcome {
        diagnosis: d,
        curves: composed_curves.unwrap_or_else(|| curves(judged, &model.erm, fits, &mut workspace)),
        facts: Some(prepared.problem.base.facts),
        next_runs: next_runs.unwrap_or_default(),
    })
}

/// Returns the terms that predict best beside the names, or `None` if nothing helps, or if no
/// held-out record can test it.
fn predictive(
    prepared: &Prepared,
    selection: &Selection,
    options: &DiagnosisOptions,
    guards: Guards,
) -> Option<Fit> {
    prepared.problem.of_role(Role::HeldOut).next()?;
    search(prepared, options, guards).predictive(selection)
}

/// Returns the base that the search starts from: the model's, less what is left out by hand, with
/// what is put in.
fn ground(
    prepared: &Prepared,
    model: &BaseModel,
    options: &DiagnosisOptions,
    guards: Guards,
) -> Result<Fit, DataSetError> {
    let problem = &prepared.problem;
    let kept = problem.given.leaving_out(&options.by_hand.without);
    let fit = base_fit_of(problem, &kept, &model.erm, &mut Workspace::default());
    search(prepared, options, guards).put_in(fit, &options.by_hand.add)
}

/// Returns the change that the request by hand makes to the held-out records.
fn by_hand(
    judged: &Prepared,
    base: &Fit,
    model: &BaseModel,
    options: &DiagnosisOptions,
) -> Option<ByHandGap> {
    if options.by_hand.is_empty() {
        return None;
    }
    let mut workspace = Workspace::default();
    let before = base_fit(&judged.problem, &model.erm, &mut workspace);
    let fits = Fits {
        base: &before,
        augmented: base,
    };
    let gap = gaps(judged, &model.erm, fits, &mut workspace);
    Some(options.by_hand.gap([&before, base], gap))
}

/// Refits the base to spectra and training records: from the model, and from other time constants
/// if that does not reach the floor.
pub(super) fn base_fit(problem: &Problem, erm: &Erm, workspace: &mut Workspace) -> Fit {
    base_fit_of(problem, &problem.given, erm, workspace)
}

fn base_fit_of(
    problem: &Problem,
    structure: &Structure,
    erm: &Erm,
    workspace: &mut Workspace,
) -> Fit {
    let mut best = problem.fit(structure, erm, workspace);
    let dof = problem.training_rows() as f64 - best.x.len() as f64;
    if excess_z(best.chi2, dof) > MISFIT_Z {
        for factor in OTHER_STARTS {
            let mut start = erm.clone();
            start.branches.iter_mut().for_each(|b| b.c_f *= factor);
            let other = problem.fit(structure, &start, workspace);
            if other.chi2 < best.chi2 {
                best = other;
            }
        }
    }
    best
}

/// Returns the reason why the repeats cannot be trusted, or `None` if they can.
fn moved_floor(prepared: &Prepared) -> Option<String> {
    let e = &prepared.estimate;
    if let Some(z) = e.repeat_z.filter(|z| *z > SENTINEL_Z) {
        return Some(format!(
            "repeats differ from each other by more than any noise that the bench has: {z:.1} \
            standard deviations"
        ));
    }
    if !prepared.prior.known {
        return None;
    }
    let (k, z) =
        e.z.iter()
            .enumerate()
            .filter_map(|(k, z)| z.map(|z| (k, z)))
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
    // Quieter repeats than usual are chance or luck.
    (z > SENTINEL_Z).then(|| {
        format!(
            "{} has left the bench's history by {z:.1} standard deviations",
            TERMS[k].1
        )
    })
}

/// Returns the noise measured by repeats if the stated noise of the bench is wrong by one common
/// factor: a loose contact or hum moves some terms and leaves others.
fn restated(prepared: &Prepared, fit: &Fit, guards: Guards) -> Result<Prepared, DataSetError> {
    let stated = prepared.prior;
    let of_repeats = Prepared {
        prior: stated.ignorant(),
        ..prepared.clone()
    }
    .again(fit, guards)?;
    let mut moved: Vec<f64> = (0..TERMS.len())
        .filter(|k| prepared.estimate.z[*k].is_some())
        .map(|k| of_repeats.estimate.log_sigmas[k] - stated.log_sigmas[k])
        .collect();
    moved.sort_by(f64::total_cmp);
    let middle = moved.get(moved.len() / 2).copied().unwrap_or(0.0);
    Prepared {
        prior: stated.times(middle.exp()),
        ..prepared.clone()
    }
    .again(fit, guards)
}

/// Returns a note on a stated noise that repeats contradict, or `None` if they do not.
fn overruled(prepared: &Prepared) -> Option<String> {
    let factor = prepared.prior.factor;
    (factor != 1.0).then(|| {
        format!(
            "repeats measure {factor:.2} times the noise that was stated of the bench; what they \
            measure counts"
        )
    })
}

fn rivals(selection: &Selection) -> Vec<Rival> {
    let taken = selection
        .selected
        .iter()
        .flat_map(|t| t.rivals.iter().map(|r| (t.name, r)));
    taken
        .map(|(instead_of, r)| Rival {
            name: r.name,
            instead_of,
            score_gap: r.score_gap,
            discriminability: r.discriminability,
        })
        .collect()
}

/// (χ² − dof)/√(2·dof) of the held-out runs, in which nothing was fitted, under noise and the
/// uncertainty of the parameters: rᵀ(I + JΣJᵀ)⁻¹r = rᵀr − (Jᵀr)ᵀ(Σ⁻¹ + JᵀJ)⁻¹(Jᵀr).
fn held_out_z(problem: &Problem, fit: &Fit, workspace: &mut Workspace) -> f64 {
    let (residual, columns) = problem.held_out(fit, workspace);
    if residual.is_empty() {
        return 0.0;
    }
    let n = columns.len();
    let mut information: Vec<f64> = (0..n * n)
        .map(|ij| {
            dot(&columns[ij / n], &columns[ij % n])
                + dot(&fit.columns[ij / n], &fit.columns[ij % n])
        })
        .collect();
    (0..n).for_each(|i| information[i * n + i] += 1e-8);
    let along: Vec<f64> = columns.iter().map(|c| dot(c, &residual)).collect();
    let mut solved = along.clone();
    let taken = if cholesky(&mut information, n) {
        cholesky_substitute(&information, n, &mut solved);
        dot(&along, &solved)
    } else {
        0.0
    };
    excess_z(dot(&residual, &residual) - taken, residual.len() as f64)
}

fn noise_report(prepared: &Prepared) -> NoiseReport {
    let e = &prepared.estimate;
    let terms = TERMS
        .iter()
        .enumerate()
        .map(|(k, (_, name))| NoiseTerm {
            name,
            sigma: e.log_sigmas[k].exp(),
            history: prepared
                .prior
                .known
                .then(|| prepared.prior.log_sigmas[k].exp() / prepared.prior.factor),
            z: if prepared.prior.known { e.z[k] } else { None },
        })
        .collect();
    NoiseReport {
        from_repeats: measured(prepared),
        terms,
    }
}
