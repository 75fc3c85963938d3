//! A warning to the user of a fit: a code for programs, words for people.

use serde::{Deserialize, Serialize};
use std::{fmt, ops::Deref};

/// Kind of a warning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum WarningCode {
    /// The polish stopped before it converged.
    NotConverged,
    /// Few starts of the search ended at the optimum.
    FewStartsAgree,
    /// A parameter stands at a bound.
    AtBound,
    /// The data do not fix a parameter.
    NotIdentified,
    /// As many parameters as numbers.
    NoFreedom,
    /// A time constant lies outside the band.
    Extrapolated,
    /// Stated uncertainties could not be used.
    CovarianceUnused,
    /// Reduced χ² is high.
    HighChi2,
    /// The slope of the open-circuit voltage contradicts its prior.
    ChargeStorage,
    /// Repeats of cells are unequal or few.
    Repeats,
    /// Signs of the imaginary part look exchanged.
    Sign,
    /// Points that no model of relaxations passes through.
    Outliers,
    /// The spectrum, or an end of it, was not measured on a linear, steady system, or its noise
    /// hides whether it was.
    Validity,
    /// A warning of the fit to spectra and pulses together.
    Joint,
    /// A warning that was read from a file that has no codes.
    #[serde(other)]
    Unknown,
}

impl WarningCode {
    /// Name as JSON and tables have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotConverged => "not_converged",
            Self::FewStartsAgree => "few_starts_agree",
            Self::AtBound => "at_bound",
            Self::NotIdentified => "not_identified",
            Self::NoFreedom => "no_freedom",
            Self::Extrapolated => "extrapolated",
            Self::CovarianceUnused => "covariance_unused",
            Self::HighChi2 => "high_chi2",
            Self::ChargeStorage => "charge_storage",
            Self::Repeats => "repeats",
            Self::Sign => "sign",
            Self::Outliers => "outliers",
            Self::Validity => "validity",
            Self::Joint => "joint",
            Self::Unknown => "unknown",
        }
    }
}

/// Reduced χ² above which the model misses the data or the uncertainty is understated.
pub(super) const HIGH_CHI2: f64 = 2.0;

/// States a relative standard uncertainty in percent, up to where digits say nothing.
pub(super) fn percent(relative: f64) -> String {
    match relative < 10.0 {
        true => format!("{:.0} %", relative * 100.0),
        false => "more than 1000 %".to_owned(),
    }
}

/// A warning to the user of a fit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// Its kind.
    pub code: WarningCode,
    /// The warning in a sentence.
    pub words: String,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.words)
    }
}

impl WarningCode {
    /// A warning of this kind.
    pub fn says(self, words: impl Into<String>) -> Warning {
        Warning {
            code: self,
            words: words.into(),
        }
    }
}

/// Warnings of one fit. In JSON two lists of one length: `warnings` and `warning_codes`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Lists", into = "Lists")]
pub struct Warnings(Vec<Warning>);

impl Warnings {
    /// The sentences.
    pub fn words(&self) -> Vec<String> {
        self.iter().map(|warning| warning.words.clone()).collect()
    }

    /// The kinds, each once, in order.
    pub fn codes(&self) -> Vec<WarningCode> {
        let mut codes: Vec<WarningCode> = self.iter().map(|warning| warning.code).collect();
        codes.sort_unstable();
        codes.dedup();
        codes
    }

    /// Creates the warnings of a fit whose polish has converged or not.
    pub(super) fn of_polish(converged: bool) -> Self {
        let mut found = Self::default();
        if !converged {
            found.push(WarningCode::NotConverged.says(
                "the polish stopped before it converged: the parameters may differ in their \
                last digits",
            ));
        }
        found
    }

    /// Adds that the model misses the data or the stated uncertainty is too small.
    pub(super) fn add_high_chi2(&mut self, reduced_chi2: Option<f64>) {
        if let Some(chi2) = reduced_chi2.filter(|c| *c > HIGH_CHI2) {
            self.push(WarningCode::HighChi2.says(format!(
                "reduced χ² is {chi2:.3}: data and model differ by {:.2} times the stated \
                uncertainty; the sigmas were widened by it",
                chi2.sqrt()
            )));
        }
    }

    /// Adds a warning.
    pub fn push(&mut self, warning: Warning) {
        self.0.push(warning);
    }
}

impl Deref for Warnings {
    type Target = [Warning];

    fn deref(&self) -> &[Warning] {
        &self.0
    }
}

impl Extend<Warning> for Warnings {
    fn extend<T: IntoIterator<Item = Warning>>(&mut self, more: T) {
        self.0.extend(more);
    }
}

impl FromIterator<Warning> for Warnings {
    fn from_iter<T: IntoIterator<Item = Warning>>(all: T) -> Self {
        Self(all.into_iter().collect())
    }
}

#[derive(Serialize, Deserialize)]
struct Lists {
    warnings: Vec<String>,
    #[serde(default)]
    warning_codes: Vec<WarningCode>,
}

impl From<Lists> for Warnings {
    fn from(lists: Lists) -> Self {
        let unknown = std::iter::repeat(WarningCode::Unknown);
        let codes = lists.warning_codes.into_iter().chain(unknown);
        lists
            .warnings
            .into_iter()
            .zip(codes)
            .map(|(words, code)| code.says(words))
            .collect()
    }
}

impl From<Warnings> for Lists {
    fn from(warnings: Warnings) -> Self {
        Self {
            warnings: warnings.words(),
            warning_codes: warnings.iter().map(|warning| warning.code).collect(),
        }
    }
}
