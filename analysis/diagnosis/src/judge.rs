//! Verdict: the result of a search, and whether the residuals are only noise.

use super::guards::beyond_formula;
use super::inconsistency::Inconsistency;
use super::outcome::{Block, Diagnosis, NamedEffect, Verdict};
use super::select::Selection;
use crate::thresholds::{CERTAIN_LAMBDA, GOOD_FIT_Z, LEAST_BLOCK_P, MOSTLY_LEFT};
use analysis_effects::effects::{self, find};

/// Evidence, beside χ² and blocks, that the residuals are more than noise.
pub(super) struct Doubts {
    /// Reason why the repeats cannot be trusted.
    pub(super) moved: Option<String>,
    /// (χ² − dof)/√(2·dof) of the held-out runs.
    pub(super) held_out_z: f64,
    /// Quantities that may differ between circumstances, most significant first.
    pub(super) differs: Vec<Inconsistency>,
}

/// Verdict, summary and notes.
pub(super) fn judge(d: &mut Diagnosis, selection: &Selection, doubts: Doubts) {
    let Doubts {
        moved,
        held_out_z,
        differs,
    } = doubts;
    let gained = d.quality.base_chi2 - d.quality.augmented_chi2;
    let quiet = d
        .where_after
        .iter()
        .all(|remaining| remaining.p_value > LEAST_BLOCK_P || within_formula(gained, remaining));
    let differs = differs.first().filter(|d| d.p_value <= LEAST_BLOCK_P);
    let fits =
        d.quality.augmented_z < GOOD_FIT_Z && held_out_z < GOOD_FIT_Z && quiet && differs.is_none();
    let names: Vec<&str> = d.effects.iter().map(|e| e.title).collect();
    if !d.noise.from_repeats {
        d.notes.push(
            "fewer than three repeats of any spectrum or any record: the noise is assumed, so that \
            no noise floor can be claimed"
                .to_owned(),
        );
    }
    if held_out_z >= GOOD_FIT_Z {
        d.notes.push(format!(
            "held-out runs are missed by {held_out_z:.1} standard deviations of their χ²"
        ));
    }
    if let Some(differs) = differs {
        let Inconsistency {
            message,
            chi2,
            dof,
            p_value,
            ..
        } = differs;
        d.notes
            .push(format!("{message}: χ² {chi2:.0} of {dof}, p {p_value:.1e}"));
    }
    if let Some(reason) = moved {
        d.verdict = Verdict::Unexplained;
        d.summary = format!(
            "The noise floor itself moved: {reason}. Nothing is named; look for a loose contact or \
            hum."
        );
        return;
    }
    if let Some(title) = selection.outside {
        d.verdict = Verdict::Unexplained;
        d.summary = format!(
            "Something is missing that no effect of the catalogue explains: {title} would explain \
            it better."
        );
        hint(d, selection);
        return;
    }
    for selected in selection.selected.iter().filter(|_| fits) {
        for container in selected.limit_of.iter().filter_map(|name| find(name)) {
            let (title, named) = (container.card().title, title(selected.name));
            d.notes.push(format!(
                "{title} is not excluded: it becomes {named} at a limit of its shape, and these \
                runs cannot separate the two"
            ));
        }
    }
    (d.verdict, d.summary) = match (fits, names.is_empty()) {
        (true, true) if d.noise.from_repeats => (
            Verdict::AtNoiseFloor,
            "Nothing is missing that these repeats could show: the residual is at the noise floor."
                .to_owned(),
        ),
        (true, true) => (
            Verdict::Unexplained,
            "The residual is within the assumed noise; without repeats this is not a finding."
                .to_owned(),
        ),
        (true, false)
            if d.rivals.is_empty()
                && d.effects.iter().any(|e| e.evidence.lambda < CERTAIN_LAMBDA) =>
        {
            let text = "Missing: {} – but the signal is so weak that something outside the \
            catalogue would look the same.";
            (Verdict::Ambiguous, text.replace("{}", &names.join(", ")))
        }
        (true, false) if d.rivals.is_empty() && selection.doubt.is_some() => {
            let doubt = selection.doubt.as_deref().unwrap_or_default();
            (
                Verdict::Ambiguous,
                format!(
                    "Missing: {} – but not for certain: {doubt}.",
                    names.join(", ")
                ),
            )
        }
        (true, false) if d.rivals.is_empty() => (
            Verdict::Explained,
            format!("Missing and now added: {}.", names.join(", ")),
        ),
        (true, false) => {
            let others: Vec<&str> = d.rivals.iter().map(|r| title(r.name)).collect();
            (
                Verdict::Ambiguous,
                format!(
                    "Missing: {} – or {}: these data cannot tell.",
                    names.join(", "),
                    others.join(", ")
                ),
            )
        }
        (false, false) if is_mostly(d) && !differs.is_some_and(|differs| differs.is_contact) => {
            let others: Vec<&str> = d.rivals.iter().map(|r| title(r.name)).collect();
            let or = if others.is_empty() {
                String::new()
            } else {
                format!(" – or {}: these data cannot tell", others.join(", "))
            };
            (
                Verdict::Mostly,
                format!(
                    "Mostly {}{or}. Its form differs from the catalogue's, or something smaller is \
                    missing beside it.",
                    names.join(", ")
                ),
            )
        }
        (false, false) => (
            Verdict::Unexplained,
            format!(
                "A part is explained by {}; the rest has no name in the catalogue.",
                names.join(", ")
            ),
        ),
        (false, true) => (
            Verdict::Unexplained,
            "Something is missing that no effect of the catalogue explains.".to_owned(),
        ),
    };
    hint(d, selection);
    let sentences: Vec<String> = d.effects.iter().flat_map(cautions).collect();
    d.summary.extend(sentences);
}

/// Sentences on the values of a named effect that are unlike sound cells and benches.
fn cautions(effect: &NamedEffect) -> impl Iterator<Item = String> {
    let title = effect.title;
    effect.parameters.iter().filter_map(move |p| {
        let caution = p.caution?;
        Some(format!(
            " Caution, {} of {title} has an unusual value: {caution}.",
            p.name
        ))
    })
}

/// Returns true if the named effects explain nearly all of the base's residual above noise, in the
/// fitted runs and in every held-out one, and only their rivals do as well.
fn is_mostly(d: &Diagnosis) -> bool {
    let (before, after) = (d.quality.base_chi2, d.quality.augmented_chi2);
    // A run in which the base hardly lacks anything may keep as much of its floor.
    let closes = |base: f64, augmented: f64, floor: f64| {
        let beyond = |miss: f64| (miss / floor).powi(2) - 1.0;
        beyond(augmented) <= MOSTLY_LEFT * beyond(base).max(1.0)
    };
    let records = d.gap.iter();
    let mut records = records.map(|g| closes(g.base_mv, g.augmented_mv, g.floor_mv));
    let spectra = d.gap_spectra.iter();
    let mut spectra = spectra.map(|g| closes(g.base_percent, g.augmented_percent, g.floor_percent));
    let held_out = !d.gap.is_empty() && records.all(|met| met) && spectra.all(|met| met);
    let left = after - d.quality.degrees_of_freedom;
    // The cause of the residual is unknown: it could be a deficit of another name.
    let others = d.ranking.iter();
    let mut others = others
        .filter(|c| !d.effects.iter().any(|e| e.name == c.name))
        .filter(|c| !d.rivals.iter().any(|r| r.name == c.name));
    let no_other = others.all(|c| c.lambda.is_none_or(|l| l < before - after - left.max(0.0)));
    let certain = d
        .effects
        .iter()
        .all(|e| e.evidence.lambda >= CERTAIN_LAMBDA);
    certain && no_other && left <= MOSTLY_LEFT * (before - d.quality.degrees_of_freedom) && held_out
}

/// Returns the title of an effect or of a law outside the catalogue.
fn title(name: &'static str) -> &'static str {
    effects::title(name).unwrap_or(name)
}

/// Returns true if the residual of a block is within the error of the formulas of the named
/// effects, which have gained `gained`.
fn within_formula(gained: f64, remaining: &Block) -> bool {
    let excess =
        (remaining.chi2 - remaining.expected_chi2).max(remaining.mean_z * remaining.mean_z);
    beyond_formula(excess, gained) <= 0.0
}

/// Adds a note on the effect that would help but may not be named.
fn hint(d: &mut Diagnosis, selection: &Selection) {
    if let Some((name, score, reason)) = &selection.refused {
        d.notes.push(format!(
            "hint only, not named: {} would gain {score:.0} but {reason}",
            title(name)
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::super::outcome::{Evidence, FittedParameter};
    use super::*;
    use analysis_effects::contract::{Base, Facts};
    use analysis_model::{model::Erm, ocv::OcvCurve};

    #[test]
    fn a_leak_that_no_sound_cell_has_comes_with_a_caution() {
        let leak = find("self_discharge").unwrap();
        let base = Base {
            erm: Erm {
                r_ohm: 6e-3,
                branches: Vec::new(),
            },
            ocv: OcvCurve::monotone(4.5, vec![0.0, 1.0], vec![3.0, 4.0]).unwrap(),
            facts: Facts {
                longest_s: 600.0,
                ..Facts::NONE
            },
        };
        let p = &leak.parameters(&base)[0];
        // 5 % of 4.5 Ah in a day are 9.4 mA.
        let caution_text = |low: f64, high: f64| {
            let effect = NamedEffect {
                name: leak.card().name,
                title: leak.card().title,
                group: leak.card().group,
                parameters: vec![FittedParameter {
                    name: p.name,
                    value: 0.5 * (low + high),
                    sigma: None,
                    interval: (low, high),
                    unit: p.unit,
                    caution: p.unusual(low, high).map(|usual| usual.source),
                }],
                evidence: Evidence {
                    lambda: 500.0,
                    score: 490.0,
                    share_of_excess: 1.0,
                    held_out_change: -10.0,
                    integration_error: 0.0,
                },
                falsified_by: String::new(),
            };
            cautions(&effect).collect::<String>()
        };
        assert_eq!(caution_text(0.005, 0.009), "");
        assert_eq!(caution_text(0.009, 0.02), "");
        let text = caution_text(0.855, 0.863);
        assert!(
            text.starts_with(" Caution, leak_a of self-discharge has an unusual value: a sound")
                && text.contains("BU-802b"),
            "{text}"
        );
    }

    /// 3 % of an effect of λ = 10⁶ are worth 900 of χ², or 30 standard deviations of a mean.
    #[test]
    fn a_block_may_keep_what_a_formula_differs_by() {
        let block = |chi2: f64, mean_z: f64| Block {
            dimension: "sign",
            part: "charge".to_owned(),
            count: 100,
            chi2,
            expected_chi2: 100.0,
            mean_z,
            p_value: 1e-9,
            rms: 1.0,
        };
        assert!(
            within_formula(1e6, &block(800.0, 20.0)) && !within_formula(1e6, &block(1100.0, 20.0))
        );
        assert!(
            !within_formula(1e6, &block(800.0, -35.0)) && !within_formula(1e4, &block(800.0, 1.0))
        );
        assert!(
            !within_formula(0.0, &block(180.0, 1.0)),
            "where nothing was named"
        );
    }
}
