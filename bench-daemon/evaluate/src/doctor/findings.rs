//! Findings of the doctor: a list of checks, each with the expected value, the observed value, and
//! a remedy.

use serde::{Deserialize, Serialize};

/// How a check ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// As expected.
    Ok,
    /// Worth knowing; the bench may be used.
    Warn,
    /// Wrong.
    Fail,
    /// Not done.
    Skipped,
}

impl Verdict {
    /// Returns the label for people.
    pub fn label(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warn => "warn",
            Self::Fail => "FAIL",
            Self::Skipped => "skipped",
        }
    }
}

/// One check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Check {
    /// Its name, equal in every report.
    pub id: String,
    /// Expected value or state, as text.
    pub expected: String,
    /// Observed value or state, as text.
    pub met: String,
    /// How it ended.
    pub verdict: Verdict,
    /// Remedy, as text; empty if nothing is to be done.
    pub advice: String,
}

/// The texts of a check.
pub struct Texts<E, M> {
    /// Expected value or state.
    pub expected: E,
    /// Value or state that was found.
    pub met: M,
}

/// The checks so far, and whether the next one would be unsafe.
#[derive(Debug, Default)]
pub struct Findings {
    /// The checks in the order in which they were made.
    pub checks: Vec<Check>,
    stopped: Option<String>,
}

impl Findings {
    /// Adds a check that is judged by one condition.
    pub fn judge(
        &mut self,
        id: &str,
        texts: Texts<impl Into<String>, impl Into<String>>,
        good: bool,
        advice: &str,
    ) -> bool {
        let verdict = if good { Verdict::Ok } else { Verdict::Fail };
        self.add(id, texts, verdict, if good { "" } else { advice });
        good
    }

    /// Adds a check.
    pub fn add(
        &mut self,
        id: &str,
        texts: Texts<impl Into<String>, impl Into<String>>,
        verdict: Verdict,
        advice: &str,
    ) {
        let check = Check {
            id: id.to_owned(),
            expected: texts.expected.into(),
            met: texts.met.into(),
            verdict,
            advice: advice.to_owned(),
        };
        tracing::info!(
            "{}: {}: expected {}, met {}",
            check.id,
            verdict.label(),
            check.expected,
            check.met
        );
        self.checks.push(check);
    }

    /// Adds checks that are skipped, and the reason.
    pub fn skip(&mut self, ids: &[&str], why: &str, advice: &str) {
        for id in ids {
            self.add(
                id,
                Texts {
                    expected: "",
                    met: why,
                },
                Verdict::Skipped,
                advice,
            );
        }
    }

    /// Forbids energising anything from here on.
    pub fn stop(&mut self) {
        if self.stopped.is_none() {
            self.stopped = self.checks.last().map(|check| check.id.clone());
        }
    }

    /// Returns the check after which nothing may be energised.
    pub fn stopped(&self) -> Option<&str> {
        self.stopped.as_deref()
    }

    /// Returns the number of checks with this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.checks
            .iter()
            .filter(|check| check.verdict == verdict)
            .count()
    }
}
