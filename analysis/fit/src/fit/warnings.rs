//! Warnings to the user of a fitted model, in sentences.

use super::options::Objective;
use super::problem::Problem;
use super::result::ErmFit;
use super::warning::{Warning, WarningCode, Warnings, percent};
use super::zero::{NEAR_BOUND, is_r_zero};
use analysis_signal::spectrum::Spectrum;
use std::f64::consts::TAU;

/// Relative sigma above which a parameter counts as not identified.
const UNIDENTIFIED: f64 = 0.5;

pub(crate) fn warnings(
    fit: &ErmFit,
    problem: &Problem,
    spectra: &[Spectrum],
    converged: bool,
) -> Warnings {
    let mut found = Warnings::of_polish(converged);
    at_bounds(fit, problem, &mut found);
    not_identified(fit, &mut found);
    outside_the_band(fit, problem, &mut found);
    if fit.objective_kind == Objective::Complex && !problem.absolute_weights {
        found.extend(no_weights(spectra));
    }
    found.add_high_chi2(fit.reduced_chi2);
    found
}

/// Returns why stated uncertainties were not used; `None` if none are stated.
fn no_weights(spectra: &[Spectrum]) -> Option<Warning> {
    const INSTEAD: &str = "all residuals were weighted relative to |Z| instead";
    let covariances = || {
        spectra
            .iter()
            .flat_map(|s| &s.points)
            .map(|p| &p.covariance)
    };
    let points = covariances().count();
    let zero = covariances()
        .filter(|c| c.re_re == 0.0 || c.im_im == 0.0)
        .count();
    let usable = covariances()
        .filter(|c| c.re_re > 0.0 && c.im_im > 0.0)
        .count();
    let place = if zero == points {
        format!("all {points}")
    } else {
        format!("{zero} of {points}")
    };
    let words = match (zero, usable) {
        (0, 0) => return None,
        (0, _) => format!("only {usable} of {points} points have a usable covariance: {INSTEAD}"),
        _ => format!(
            "σ is zero at {place} points: expected a positive σ, or nothing where it is not known; \
            {INSTEAD}"
        ),
    };
    Some(WarningCode::CovarianceUnused.says(words))
}

/// One parameter by its name in the thesis.
struct Parameter {
    name: String,
    value: f64,
    sigma: Option<f64>,
    bounds: (f64, f64),
    unit: &'static str,
}

fn parameters(fit: &ErmFit) -> Vec<Parameter> {
    let resistance = |name: String, value, sigma| Parameter {
        name,
        value,
        sigma,
        bounds: fit.bounds.r_ohm,
        unit: "Ω",
    };
    let mut all = vec![resistance("R".to_owned(), fit.erm.r_ohm, fit.sigma.r_ohm)];
    for (k, (b, s)) in fit.erm.branches.iter().zip(&fit.sigma.branches).enumerate() {
        all.push(resistance(format!("R{}", k + 1), b.r_ohm, s.r_ohm));
        all.push(Parameter {
            name: format!("C{}", k + 1),
            value: b.c_f,
            sigma: s.c_f,
            bounds: fit.bounds.c_f,
            unit: "F",
        });
    }
    all
}

/// Names of the parameters that stand at a bound; a series resistance of zero does not count.
pub(super) fn held_by_bounds(fit: &ErmFit, problem: &Problem) -> Vec<String> {
    let held =
        |p: &Parameter| p.value <= p.bounds.0 * NEAR_BOUND || p.value >= p.bounds.1 / NEAR_BOUND;
    let zero = usize::from(is_r_zero(&fit.erm, &fit.bounds, problem));
    parameters(fit)
        .into_iter()
        .skip(zero)
        .filter(held)
        .map(|p| p.name)
        .collect()
}

fn at_bounds(fit: &ErmFit, problem: &Problem, found: &mut Warnings) {
    let zero = is_r_zero(&fit.erm, &fit.bounds, problem);
    if zero {
        found.push(WarningCode::NotIdentified.says(format!(
            "R is zero within these data: less than {:.1e} Ω, with every branch within the band",
            fit.erm.r_ohm
        )));
    }
    for Parameter {
        name,
        value,
        bounds: (lo, hi),
        unit,
        ..
    } in parameters(fit).into_iter().skip(usize::from(zero))
    {
        if value <= lo * NEAR_BOUND {
            found.push(
                WarningCode::AtBound.says(format!("{name} is at its lower bound of {lo} {unit}")),
            );
        } else if value >= hi / NEAR_BOUND {
            found.push(
                WarningCode::AtBound.says(format!("{name} is at its upper bound of {hi} {unit}")),
            );
        }
    }
}

fn not_identified(fit: &ErmFit, found: &mut Warnings) {
    if fit.sigma.r_ohm.is_none()
        && fit
            .sigma
            .branches
            .iter()
            .all(|b| b.r_ohm.is_none() && b.c_f.is_none())
    {
        let parameters = fit.erm.parameter_count();
        found.push(WarningCode::NotIdentified.says(format!(
            "the data do not fix all {parameters} parameters: no uncertainty can be \
        given; try fewer RC branches"
        )));
        return;
    }
    for Parameter {
        name, value, sigma, ..
    } in parameters(fit)
    {
        if let Some(relative) = sigma.map(|s| s / value).filter(|s| *s > UNIDENTIFIED) {
            let percent = percent(relative);
            found.push(WarningCode::NotIdentified.says(format!(
                "{name} is not identified by the data: its standard uncertainty is {percent}"
            )));
        }
    }
}

fn outside_the_band(fit: &ErmFit, problem: &Problem, found: &mut Warnings) {
    let (Some(first), Some(last)) = (problem.groups.first(), problem.groups.last()) else {
        return;
    };
    let (slow_s, fast_s) = (1.0 / (TAU * first.freq_hz), 1.0 / (TAU * last.freq_hz));
    for (k, tau) in fit.erm.time_constants_s().into_iter().enumerate() {
        let k = k + 1;
        if tau > slow_s {
            found.push(WarningCode::Extrapolated.says(format!(
                "branch {k}: its time constant of {tau:.3} s is beyond the {slow_s:.3} s of the \
                lowest frequency ({} Hz): R{k} and C{k} are extrapolated",
                short(first.freq_hz)
            )));
        } else if tau < fast_s {
            found.push(WarningCode::Extrapolated.says(format!(
                "branch {k}: its time constant of {:.3} ms is below the {:.3} ms of the highest \
                frequency ({} Hz): R{k} and C{k} are extrapolated",
                tau * 1e3,
                fast_s * 1e3,
                short(last.freq_hz)
            )));
        }
    }
}

/// Frequency to five significant digits, enough for a sentence.
fn short(freq_hz: f64) -> f64 {
    format!("{freq_hz:.4e}").parse().unwrap_or(freq_hz)
}
