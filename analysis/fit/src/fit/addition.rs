//! The additions of a model file: effects of the catalogue that a diagnosis has found missing, each
//! with its provenance.

use super::schema::JsonError;
use analysis_effects::{
    augmented::{Augmented, Kept},
    contract::{Base, Facts, Group, HeldOutError, Scale},
    effects::find,
};
use analysis_model::{model::Erm, ocv::OcvCurve};
use serde::{Deserialize, Serialize};

/// An effect that was added to the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Addition {
    /// Name in the catalogue.
    pub name: String,
    /// Name in words.
    pub title: String,
    /// Cell or bench: an effect of the bench explains the data and is left out of predictions.
    pub group: Group,
    /// Its parameters, the strength first.
    pub parameters: Vec<AdditionParameter>,
    /// Evidence for it.
    pub evidence: AdditionEvidence,
    /// Name of the data set that showed it.
    pub data_set: String,
    /// Program and version that added it.
    pub added_by: String,
}

/// A parameter of an addition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdditionParameter {
    /// Name with unit, as the catalogue has it.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard uncertainty; none where the data do not fix it.
    pub sigma: Option<f64>,
    /// Unit.
    pub unit: String,
}

/// Evidence for an added effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdditionEvidence {
    /// In words.
    pub text: String,
    /// λ: χ² that it removes from the training runs.
    pub lambda: f64,
    /// λ less k·ln N.
    pub score: f64,
    /// Root mean square gap over the held-out records before it was added, V; none without such
    /// records.
    pub held_out_gap_before_v: Option<f64>,
    /// The same after it was added, V.
    pub held_out_gap_after_v: Option<f64>,
}

/// Base and additions; none without additions.
///
/// # Errors
/// As [`super::ModelFile::augmented`].
pub(crate) fn augmented(
    erm: &Erm,
    ocv: Option<&OcvCurve>,
    facts: Option<Facts>,
    additions: &[Addition],
) -> Result<Option<Augmented>, JsonError> {
    if additions.is_empty() {
        return Ok(None);
    }
    let lacks = |what| JsonError::AdditionsLack { what };
    let ocv = ocv
        .cloned()
        .ok_or(lacks("ocv, the OCV curve of the model"))?;
    let facts = facts.ok_or(lacks("facts, what the data of the additions reach"))?;
    if let Some(HeldOutError { runs, share }) = facts.held_out
        && (runs == 0 || share.is_nan() || share < 0.0)
    {
        return Err(JsonError::HeldOut { runs, share });
    }
    let base = Base {
        erm: erm.clone(),
        ocv,
        facts,
    };
    let kept = additions
        .iter()
        .map(|a| a.kept(&base))
        .collect::<Result<_, _>>()?;
    Ok(Some(Augmented { base, kept }))
}

impl Addition {
    /// The effect with its values, checked against the catalogue.
    fn kept(&self, base: &Base) -> Result<Kept, JsonError> {
        let name = || self.name.clone();
        let effect = find(&self.name).ok_or_else(|| JsonError::UnknownEffect { met: name() })?;
        let parameters = effect.parameters(base);
        let list = |names: Vec<&str>| {
            if names.is_empty() {
                "none".to_owned()
            } else {
                names.join(", ")
            }
        };
        let (expected, met): (Vec<&str>, Vec<&str>) = (
            parameters.iter().map(|p| p.name).collect(),
            self.parameters.iter().map(|p| p.name.as_str()).collect(),
        );
        if expected != met {
            return Err(JsonError::EffectParameters {
                effect: name(),
                expected: list(expected),
                met: list(met),
            });
        }
        for (known, given) in parameters.iter().zip(&self.parameters) {
            let (value, positive) = (given.value, known.scale == Scale::Log);
            if !value.is_finite() || (positive && value <= 0.0) {
                let expected = if positive {
                    "a finite number above 0"
                } else {
                    "a finite number"
                };
                return Err(JsonError::EffectValue {
                    effect: name(),
                    parameter: known.name,
                    expected,
                    met: value,
                });
            }
        }
        Ok(Kept {
            effect,
            p: effect.predicting(self.parameters.iter().map(|p| p.value).collect()),
        })
    }
}
