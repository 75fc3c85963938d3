//! Rule by which an investigation continues or ends, and its budget. The command and the server
//! use one rule.

use analysis::diagnosis::Verdict;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of runs that a diagnosis may request.
pub const MOST_RUNS: usize = 6;
/// Maximum number of requests for one run.
pub const MOST_AGAIN: usize = 2;

/// Every verdict, to be found by its name in a file.
const VERDICTS: [Verdict; 6] = [
    Verdict::AtNoiseFloor,
    Verdict::Explained,
    Verdict::Mostly,
    Verdict::Ambiguous,
    Verdict::Unexplained,
    Verdict::Invalid,
];

/// How an investigation ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = InvestigationEnd)]
pub enum End {
    /// The missing effect has a name.
    Explained,
    /// Nothing is missing.
    AtNoiseFloor,
    /// The data cannot be used.
    Invalid,
    /// The predicted error of the loads of a map is small enough.
    ErrorReached,
    /// The next measurement of a map takes less off the error of the loads than its time is worth.
    GainBelowCost,
    /// No remaining run of the menu that this bench can execute adds information.
    NoExperiment,
    /// The rest of the budget does not pay for a run that may add information.
    Budget,
    /// A requested run ended early, or its bench was stopped, held or latched.
    Stopped,
    /// A person cancelled it.
    Cancelled,
    /// A diagnosis failed, or an experiment could not be submitted.
    Failed,
}

/// Time and charge of experiments after the first campaign.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = InvestigationBudget)]
pub struct Budget {
    /// Time on the bench, min.
    pub minutes: f64,
    /// Charge moved in either direction, Ah.
    pub charge_ah: f64,
}

impl Budget {
    /// Returns the budget if it is valid.
    ///
    /// # Errors
    /// In words: a number below 0, or not a number.
    pub fn checked(self) -> Result<Self, String> {
        if self.minutes >= 0.0 && self.charge_ah >= 0.0 {
            return Ok(self);
        }
        Err(format!(
            "expected a budget of 0 or more, found {} min and {} Ah",
            self.minutes, self.charge_ah
        ))
    }

    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        Self {
            minutes: self.minutes + other.minutes,
            charge_ah: self.charge_ah + other.charge_ah,
        }
    }

    /// The rest of it.
    pub fn less(self, spent: Self) -> Self {
        Self {
            minutes: self.minutes - spent.minutes,
            charge_ah: self.charge_ah - spent.charge_ah,
        }
    }

    /// Describes why this remaining budget does not cover a price, or returns `None` if it does.
    pub fn shortfall(self, price: Self) -> Option<String> {
        let pays = price.minutes <= self.minutes && price.charge_ah <= self.charge_ah;
        (!pays).then(|| {
            format!(
                "takes {:.0} min and {:.2} Ah; left are {:.0} min and {:.2} Ah",
                price.minutes, price.charge_ah, self.minutes, self.charge_ah
            )
        })
    }
}

/// Returns the end that a verdict implies, with its sentence, or `None` while a question is open.
pub fn settled(verdict: Verdict) -> Option<(End, &'static str)> {
    match verdict {
        Verdict::Explained => Some((End::Explained, "what was missing has a name")),
        Verdict::AtNoiseFloor => Some((
            End::AtNoiseFloor,
            "nothing is missing that these repeats could show",
        )),
        Verdict::Invalid => Some((End::Invalid, "the data cannot be used")),
        Verdict::Mostly | Verdict::Ambiguous | Verdict::Unexplained => None,
    }
}

/// Returns the sentence of an investigation that has executed the maximum number of runs.
pub fn most_played() -> String {
    format!("{MOST_RUNS} runs were played, which is the most")
}

/// Verdict of this name, as files of a diagnosis have it.
pub fn verdict_named(name: &str) -> Option<Verdict> {
    let is_named = |verdict: &Verdict| {
        serde_json::to_value(verdict).is_ok_and(|value| value.as_str() == Some(name))
    };
    VERDICTS.into_iter().find(is_named)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_verdict_is_found_by_its_name_and_ends_or_goes_on() {
        let found = VERDICTS.map(|verdict| {
            let name = serde_json::to_value(verdict).unwrap();
            assert_eq!(verdict_named(name.as_str().unwrap()), Some(verdict));
            settled(verdict).is_none() == verdict.is_open()
        });
        assert_eq!(found, [true; 6]);
        assert_eq!(verdict_named("fine"), None);
    }

    #[test]
    fn a_rest_pays_what_it_covers_in_both_and_says_what_it_lacks() {
        let of = |minutes, charge_ah| Budget { minutes, charge_ah };
        let rest = of(60.0, 2.0).less(of(10.0, 0.5)).plus(of(0.0, 0.5));
        assert_eq!(rest, of(50.0, 2.0));
        assert_eq!(rest.shortfall(of(50.0, 2.0)), None);
        assert_eq!(
            rest.shortfall(of(50.0, 2.1)).as_deref(),
            Some("takes 50 min and 2.10 Ah; left are 50 min and 2.00 Ah")
        );
        assert!(of(f64::NAN, 1.0).checked().is_err() && of(0.0, 0.0).checked().is_ok());
    }
}
