//! Effects that the base has from the start: those of the judged model, and those that a user puts
//! in or leaves out by hand.

use super::block::DataSetError;
use super::gap::rms_mv;
use super::outcome::{ByHandGap, Gap};
use super::problem::Fit;
use super::search::Search;
use super::structure::{Member, Structure};
use analysis_effects::{contract::Base, effects::find};
use analysis_fit::fit::Addition;

/// Effects that a user puts into the base or leaves out of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ByHand {
    /// Names of effects to put in.
    pub add: Vec<&'static str>,
    /// Names of effects to leave out; they are not looked for either.
    pub without: Vec<&'static str>,
}

impl ByHand {
    /// Returns whether nothing was requested.
    pub fn is_empty(&self) -> bool {
        self.add.is_empty() && self.without.is_empty()
    }

    /// Returns the gaps with and without what was requested.
    pub(super) fn gap(&self, fits: [&Fit; 2], gap: Vec<Gap>) -> ByHandGap {
        ByHandGap {
            added: self.add.clone(),
            left_out: self.without.clone(),
            before_chi2: fits[0].chi2,
            after_chi2: fits[1].chi2,
            before_mv: (!gap.is_empty()).then(|| rms_mv(&gap, |g| g.base_mv)),
            after_mv: (!gap.is_empty()).then(|| rms_mv(&gap, |g| g.augmented_mv)),
            gap,
        }
    }
}

/// Returns the structure of a model's additions at their values.
///
/// # Errors
/// An addition that is not in the catalogue, lacks a parameter, or does not apply to the data.
pub(super) fn structure(base: &Base, additions: &[Addition]) -> Result<Structure, DataSetError> {
    let mut whole = Structure::default();
    for addition in additions {
        let fail = |expected| DataSetError::Addition {
            name: addition.name.clone(),
            expected,
        };
        let effect = find(&addition.name).ok_or_else(|| fail("an effect of the catalogue"))?;
        let parameters = effect.parameters(base);
        if parameters.is_empty() {
            return Err(fail("an effect that applies to these runs"));
        }
        let of = |name: &str| addition.parameters.iter().find(|p| p.name == name);
        let values: Option<Vec<f64>> = parameters.iter().map(|p| Some(of(p.name)?.value)).collect();
        let values = values.ok_or_else(|| fail("all parameters that the catalogue has"))?;
        whole = whole.with(Member::given(effect, base, values));
    }
    Ok(whole)
}

impl Structure {
    /// Returns the structure without the members of these names.
    pub(super) fn leaving_out(&self, names: &[&str]) -> Self {
        let mut kept = self.clone();
        kept.members
            .retain(|member| !names.contains(&member.name()));
        kept
    }
}

impl Search<'_> {
    /// Returns a fit with effects put in, whatever they gain.
    ///
    /// # Errors
    /// An effect that does not apply to the data, or that the fit has already.
    pub(super) fn put_in(&mut self, fit: Fit, names: &[&'static str]) -> Result<Fit, DataSetError> {
        let mut fit = fit;
        for name in names {
            let mut found = self.attempts_of(&fit, 1, |other| other == *name);
            let Some(attempt) = found.pop() else {
                return Err(DataSetError::Addition {
                    name: (*name).to_owned(),
                    expected: "an effect that applies to these runs and is not in the model",
                });
            };
            fit = attempt.fit;
        }
        Ok(fit)
    }
}
