//! A diagnosis' effects as additions to a model file, each with its evidence.

use super::outcome::{Diagnosis, Gap, NamedEffect, Verdict};
use analysis_fit::fit::{Addition, AdditionEvidence, AdditionParameter};

impl Diagnosis {
    /// The named effects as additions to the model that was refitted together with them
    /// ([`Diagnosis::augmented`]); empty where none was named.
    pub fn additions(&self, added_by: &str) -> Vec<Addition> {
        self.effects
            .iter()
            .map(|e| self.addition(e, added_by))
            .collect()
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

    fn addition(&self, effect: &NamedEffect, added_by: &str) -> Addition {
        let rms_v = |pick: fn(&Gap) -> f64| {
            let sum: f64 = self.gap.iter().map(|g| pick(g).powi(2)).sum();
            (!self.gap.is_empty()).then(|| 1e-3 * (sum / self.gap.len() as f64).sqrt())
        };
        let sure = match self.verdict {
            Verdict::Explained if self.gap.is_empty() => {
                "explained on training runs; no held-out record has seen it"
            }
            Verdict::Explained => "explained: nothing else is missing that the data could show",
            Verdict::Ambiguous => "ambiguous: other effects would do as well",
            _ => "explains a part: something else is missing",
        };
        let e = &effect.evidence;
        Addition {
            name: effect.name.to_owned(),
            title: effect.title.to_owned(),
            group: effect.group,
            parameters: effect
                .parameters
                .iter()
                .map(|p| AdditionParameter {
                    name: p.name.to_owned(),
                    value: p.value,
                    sigma: p.sigma,
                    unit: p.unit.to_owned(),
                })
                .collect(),
            evidence: AdditionEvidence {
                text: format!("{sure}{}", self.of_corrected()),
                lambda: e.lambda,
                score: e.score,
                held_out_gap_before_v: rms_v(|g| g.base_mv),
                held_out_gap_after_v: rms_v(|g| g.augmented_mv),
            },
            data_set: self.data_set.clone(),
            added_by: added_by.to_owned(),
        }
    }
}
