//! A diagnosis' effects as additions to a model file, each with its evidence.

use super::gap::rms_mv;
use super::outcome::{
    Diagnosis, FittedParameter, Gap, NamedEffect, PREDICTION_ONLY, PredictiveTerm, Verdict,
};
use analysis_fit::fit::{Addition, AdditionEvidence, AdditionParameter};

impl Diagnosis {
    /// Returns the named effects as additions to the model that was refitted together with them
    /// ([`Diagnosis::augmented`]), those of the base first; empty without any.
    pub fn additions(&self, added_by: &str) -> Vec<Addition> {
        let given = self.given.iter().map(|term| self.given(term, added_by));
        let named = self.effects.iter().map(|e| self.addition(e, added_by));
        given.chain(named).collect()
    }

    /// Which corrected data the evidence hangs on.
    fn of_corrected(&self) -> String {
        let titles: Vec<&str> = self.accepted.iter().map(|kind| kind.title()).collect();
        if titles.is_empty() {
            String::new()
        } else {
            format!("; on data corrected for: {}", titles.join(", "))
        }
    }

    /// Returns the terms of the augmentation for predictions as additions to the model that was
    /// refitted together with them; empty without terms.
    pub fn predictive_additions(&self, added_by: &str) -> Vec<Addition> {
        let Some(predictive) = &self.predictive else {
            return Vec::new();
        };
        let over = |of: fn(&Gap) -> f64| rms_v(&predictive.gap, of);
        let range = predictive.range;
        let text = format!(
            "{PREDICTION_ONLY}: stands for \"{{form}}\", claims no cause; holds up to {} A, for {} \
            s, about a state of charge of {:.2}, at {} °C",
            range.greatest_a, range.longest_s, range.soc, range.temperature_degc
        );
        let addition = |term: &PredictiveTerm| Addition {
            name: term.name.to_owned(),
            title: format!("predictive term of the form of {}", term.title),
            group: term.group,
            parameters: parameters(&term.parameters),
            evidence: AdditionEvidence {
                text: text.replace("{form}", term.stands_for) + &self.of_corrected(),
                lambda: predictive.lambda,
                score: predictive.score,
                held_out_gap_before_v: over(|g| g.base_mv),
                held_out_gap_after_v: over(|g| g.augmented_mv),
            },
            data_set: self.data_set.clone(),
            added_by: added_by.to_owned(),
        };
        predictive.terms.iter().map(addition).collect()
    }

    fn given(&self, term: &PredictiveTerm, added_by: &str) -> Addition {
        Addition {
            name: term.name.to_owned(),
            title: term.title.to_owned(),
            group: term.group,
            parameters: parameters(&term.parameters),
            evidence: AdditionEvidence {
                text: format!("put into the base by hand{}", self.of_corrected()),
                lambda: 0.0,
                score: 0.0,
                held_out_gap_before_v: rms_v(&self.gap, |g| g.eis_only_mv),
                held_out_gap_after_v: rms_v(&self.gap, |g| g.base_mv),
            },
            data_set: self.data_set.clone(),
            added_by: added_by.to_owned(),
        }
    }

    fn addition(&self, effect: &NamedEffect, added_by: &str) -> Addition {
        let sure = match self.verdict {
            Verdict::Explained if self.gap.is_empty() => {
                "explained on training runs; no held-out record has seen it"
            }
            Verdict::Explained => "explained: nothing else is missing that the data could show",
            Verdict::Mostly => {
                "mostly: its form differs from the data, or something smaller is missing beside it"
            }
            Verdict::Ambiguous => "ambiguous: other effects would do as well",
            _ => "explains a part: something else is missing",
        };
        let e = &effect.evidence;
        Addition {
            name: effect.name.to_owned(),
            title: effect.title.to_owned(),
            group: effect.group,
            parameters: parameters(&effect.parameters),
            evidence: AdditionEvidence {
                text: format!("{sure}{}", self.of_corrected()),
                lambda: e.lambda,
                score: e.score,
                held_out_gap_before_v: rms_v(&self.gap, |g| g.base_mv),
                held_out_gap_after_v: rms_v(&self.gap, |g| g.augmented_mv),
            },
            data_set: self.data_set.clone(),
            added_by: added_by.to_owned(),
        }
    }
}

fn parameters(fitted: &[FittedParameter]) -> Vec<AdditionParameter> {
    let parameter = |p: &FittedParameter| AdditionParameter {
        name: p.name.to_owned(),
        value: p.value,
        sigma: p.sigma,
        unit: p.unit.to_owned(),
    };
    fitted.iter().map(parameter).collect()
}

/// Returns the root mean square over records, V; none without any.
fn rms_v(gaps: &[Gap], of: fn(&Gap) -> f64) -> Option<f64> {
    (!gaps.is_empty()).then(|| 1e-3 * rms_mv(gaps, of))
}
