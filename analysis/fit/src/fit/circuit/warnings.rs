//! Warnings to the user of a fitted circuit, in sentences.

use super::data::Data;
use super::options::Weight;
use super::{CircuitFit, State};
use crate::fit::options::Objective;
use crate::fit::warning::{WarningCode, Warnings, percent};

/// Relative sigma above which a parameter counts as not identified.
const UNIDENTIFIED: f64 = 1.0;

pub(super) fn warnings(fit: &CircuitFit, data: &Data, converged: bool) -> Warnings {
    let mut found = Warnings::of_polish(converged);
    if fit.starts > 1 && fit.starts_at_optimum == 1 {
        found.push(WarningCode::FewStartsAgree.says(format!(
            "only 1 of {} starts ended at this optimum: a better one may have been \
        missed; try more starts",
            fit.starts
        )));
    }
    at_bounds(fit, &mut found);
    not_identified(fit, data, &mut found);
    if fit.objective_kind == Objective::Complex
        && fit.weight != Weight::Covariance
        && data.known > 0
        && data.known < data.points
    {
        found.push(WarningCode::CovarianceUnused.says(format!(
            "only {} of {} points have a usable covariance: it was not used",
            data.known, data.points
        )));
    }
    found.add_high_chi2(fit.reduced_chi2);
    found
}

fn at_bounds(fit: &CircuitFit, found: &mut Warnings) {
    for (i, name) in fit.names.iter().enumerate() {
        let ((lower, upper), unit) = (fit.bounds[i], &fit.units[i]);
        let (side, bound) = match fit.states[i] {
            State::AtLowerBound => ("lower", lower),
            State::AtUpperBound => ("upper", upper),
            State::Free | State::Constant => continue,
        };
        let place = format!("{name} is at its {side} bound of {bound:.3e} {unit}");
        found.push(WarningCode::AtBound.says(format!(
            "{}: it has no sigma, and the others' hold with it there",
            place.trim_end()
        )));
    }
}

fn not_identified(fit: &CircuitFit, data: &Data, found: &mut Warnings) {
    let free: Vec<usize> = (0..fit.names.len())
        .filter(|i| fit.states[*i] == State::Free)
        .collect();
    if !free.is_empty() && fit.degrees_of_freedom == 0 {
        found.push(WarningCode::NoFreedom.says(
            "the fit has as many parameters as numbers: nothing is left to estimate an uncertainty \
        from",
        ));
        return;
    }
    let unfixed: Vec<&str> = free
        .iter()
        .filter(|i| fit.sigmas[**i].is_none())
        .map(|i| fit.names[*i].as_str())
        .collect();
    if !unfixed.is_empty() {
        found.push(WarningCode::NotIdentified.says(format!(
            "the data fix only combinations of {}: these have no sigma; try a simpler circuit",
            unfixed.join(", ")
        )));
    }
    let band = match (data.groups.first(), data.groups.last()) {
        (Some(first), Some(last)) => format!("{:.3e} to {:.3e} Hz", first.freq_hz, last.freq_hz),
        _ => String::new(),
    };
    for i in free {
        if let Some(relative) = fit.sigmas[i]
            .map(|s| s / fit.values[i])
            .filter(|s| *s > UNIDENTIFIED)
        {
            let percent = percent(relative);
            found.push(WarningCode::NotIdentified.says(format!(
                "{} is not identified by this band ({band}): its standard uncertainty is {percent}",
                fit.names[i]
            )));
        }
    }
}
