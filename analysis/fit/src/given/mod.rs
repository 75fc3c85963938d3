//! Reads a cell's model from any source: a model file, a typed model of resistances and
//! capacitances only, or a fitted circuit.
//!
//! All that reads a model reads it here. What the source does not know (uncertainty, provenance,
//! OCV) is absent, and [`GivenModel::notes`] says so.

mod circuit;
mod error;
mod ladder;
mod model;
mod plain;
mod state;

pub use error::{GivenError, LadderError, MOST_BRANCHES, REFUSED};
pub use ladder::{Bands, Followed, Ladder, LeftOut, TARGET, follow};
pub use plain::PlainModel;
pub use state::StateOfRuns;

use crate::fit::{Addition, JsonError, ModelFile, RefusedPoint, augmented};
use analysis_effects::{augmented::Augmented, contract::Facts};
use analysis_model::{
    model::{Erm, ModelError},
    ocv::OcvCurve,
};
pub use model::GivenModel;
use serde_json::Value;

/// Least resistance of a branch at one state of a map, as a part of the whole.
const LEAST_BRANCH: f64 = 1e-4;

impl GivenModel {
    /// Creates a model from its components alone.
    ///
    /// # Errors
    /// [`ModelError`] for components that no cell has.
    pub fn typed(name: &str, erm: Erm) -> Result<Self, ModelError> {
        erm.validate()?;
        Ok(PlainModel::new(name, erm).into())
    }

    /// Reads the text of a model file, a typed model or a fitted circuit. `name` is that of a model
    /// without one; `band_hz` the band that a circuit's ladder is to follow, else that of its data
    /// and a decade more on each side.
    ///
    /// # Errors
    /// [`GivenError`].
    ///
    /// # Examples
    /// ```
    /// use analysis_fit::given::{GivenError, GivenModel};
    ///
    /// let text = r#"{"r_ohm": 0.005, "branches": [{"r_ohm": 0.003, "c_f": 10.0}]}"#;
    /// let model = GivenModel::from_json(text, "cell", None)?;
    /// assert_eq!(model.name, "cell");
    /// assert!((model.erm.dc_resistance_ohm() - 8e-3).abs() < 1e-12);
    /// # Ok::<(), GivenError>(())
    /// ```
    pub fn from_json(
        text: &str,
        name: &str,
        band_hz: Option<(f64, f64)>,
    ) -> Result<Self, GivenError> {
        let value: Value = serde_json::from_str(text)?;
        let has = |field: &str| value.get(field).is_some();
        if has("fits") || has("circuit") {
            return circuit::read(value, band_hz);
        }
        if band_hz.is_some() {
            return Err(GivenError::BandWithoutCircuit);
        }
        if has("schema") {
            return Ok(ModelFile::from_json(text)?.into());
        }
        if has("r_ohm") || has("branches") {
            return plain::read(text, name);
        }
        let fields = value.as_object().map(|fields| {
            fields
                .keys()
                .take(8)
                .cloned()
                .collect::<Vec<_>>()
                .join(", ")
        });
        let met = match fields {
            Some(fields) if fields.is_empty() => "an object without fields".to_owned(),
            Some(fields) => format!("the fields {fields}"),
            None => "no object".to_owned(),
        };
        Err(GivenError::Kind { met })
    }

    /// Returns the model with another OCV curve, if one is given.
    #[must_use]
    pub fn with_ocv(mut self, curve: Option<OcvCurve>) -> Self {
        if let Some(curve) = curve {
            if let Some(file) = &mut self.fitted {
                file.ocv = Some(curve.clone());
            }
            self.ocv = Some(curve);
        }
        self
    }

    /// Base and additions; none for a model without additions.
    ///
    /// # Errors
    /// As [`ModelFile::augmented`].
    pub fn augmented(&self) -> Result<Option<Augmented>, JsonError> {
        augmented(&self.erm, self.ocv.as_ref(), self.facts, &self.additions)
    }

    /// Returns the model with additions to a base that was refitted together with them. The
    /// uncertainty of the first fit, and the report on its ladder, belong to another base and are
    /// dropped.
    #[must_use]
    pub fn with_additions(self, erm: Erm, facts: Facts, additions: Vec<Addition>) -> Self {
        if let Some(file) = self.fitted {
            return file.with_additions(erm, facts, additions).into();
        }
        let warnings = Vec::new();
        Self {
            erm,
            facts: Some(facts),
            additions,
            log_covariance: None,
            ladder: None,
            warnings,
            fitted: None,
            ..self
        }
    }

    /// Adds the points that the gate of the data has refused to those that its first fit refused.
    /// Only a model from a model file has a place for them.
    #[must_use]
    pub fn with_refused(mut self, refused: Vec<RefusedPoint>) -> Self {
        if let Some(file) = &mut self.fitted {
            let fresh: Vec<RefusedPoint> = refused
                .into_iter()
                .filter(|point| !file.refused.contains(point))
                .collect();
            file.refused.extend(fresh);
        }
        self
    }

    /// Returns a model with a map as that of one state of charge and temperature, °C, for small signals.
    /// Branches that the map has switched off there are left out, and the OCV curve has the map's
    /// correction. Also returns remarks that name the state, and what it leaves open; `None` for a model
    /// without a map.
    pub fn at_state(&self, state: &StateOfRuns) -> Option<(Self, Vec<String>)> {
        let map = self.map.as_ref()?;
        let (soc, temperature_degc) = (state.soc, state.temperature_degc);
        let mut erm = map.model_at(soc, temperature_degc);
        let least_ohm = LEAST_BRANCH * erm.dc_resistance_ohm();
        erm.branches.retain(|branch| branch.r_ohm >= least_ohm);
        let curve = self.ocv.as_ref();
        let corrected = curve.and_then(|curve| map.corrected(curve, temperature_degc));
        let mut note = format!(
            "the model is that of the map at {:.1} % of charge and {temperature_degc:.1} °C",
            100.0 * soc
        );
        if corrected.is_none() && curve.is_some() {
            note += "; its OCV curve does not have the map's correction, which would make it fall";
        }
        let outside = map.place(soc, temperature_degc).outside;
        if outside.is_outside() {
            note += &format!("; it {outside}");
        }
        let model = Self {
            erm,
            ocv: corrected.or_else(|| self.ocv.clone()),
            map: None,
            ..self.clone()
        };
        let remark = state.remark();
        Some((model, [note].into_iter().chain(remark).collect()))
    }

    /// Returns a note for tasks that know one point only; `None` for a model without a map.
    pub fn point_note(&self) -> Option<String> {
        self.map.as_ref().map(|_| {
            "the model has a map over state of charge and temperature; this task takes its values \
            at one point, the r_ohm and branches of the file"
                .to_owned()
        })
    }

    /// Returns a note on how far from its data a model of one point is used, at states of charge and
    /// temperatures, °C, as far as they are known; `None` for a model with a map, and for one that is
    /// used where its data lie.
    pub fn away_note(&self, soc: &[f64], degc: &[f64]) -> Option<String> {
        if self.map.is_some() {
            return None;
        }
        let Some(facts) = self.facts else {
            return Some(
                "the model does not state the charge and the temperature at which it was measured: \
                it keeps its resistances at every charge and temperature"
                    .to_owned(),
            );
        };
        let farthest = |list: &[f64], from: f64| {
            let away = list.iter().map(|x| (x - from).abs());
            away.reduce(f64::max)
        };
        let charge = farthest(soc, facts.soc).map(|away| {
            let at = format!("SOC {:.2}", facts.soc);
            (away >= 0.005, at, format!("{away:.2} of charge"))
        });
        let kelvin = farthest(degc, facts.temperature_degc).map(|away| {
            let at = format!("{:.1} °C", facts.temperature_degc);
            (away >= 0.05, at, format!("{away:.1} K"))
        });
        let known: Vec<_> = charge.into_iter().chain(kelvin).collect();
        let (mut places, mut ways) = (Vec::new(), Vec::new());
        for (_, at, away) in &known {
            places.push(at.as_str());
            ways.push(away.as_str());
        }
        known.iter().any(|(is_away, ..)| *is_away).then(|| {
            format!(
                "the data of the model's diagnosis lie at {}; it is used up to {} away, with the \
                resistances found there",
                places.join(" and "),
                ways.join(" and ")
            )
        })
    }

    /// Returns the resistance at zero frequency, Ω; `None` for a circuit whose resistance grows
    /// without limit.
    pub fn dc_resistance_ohm(&self) -> Option<f64> {
        let grows = self
            .ladder
            .as_ref()
            .is_some_and(|ladder| ladder.dc_resistance_ohm.is_none());
        (!grows).then(|| self.erm.dc_resistance_ohm())
    }

    /// Returns notes on data that the source lacks, in sentences; empty for a model file, which has
    /// warnings of its own.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = self
            .ladder
            .as_ref()
            .map_or_else(Vec::new, |ladder| ladder.notes(&self.erm));
        if self.fitted.is_none() && self.log_covariance.is_none() && self.map.is_none() {
            notes.push(match &self.ladder {
                Some(_) => "the ladder has no uncertainty: that of the circuit's fit is not \
                carried over"
                    .to_owned(),
                None => "the model was typed: it has no uncertainty, and the band in which it \
                holds is not known"
                    .to_owned(),
            });
        }
        notes
    }

    /// The text of a file with all of it: a model file as one, everything else as a typed model.
    ///
    /// # Errors
    /// [`JsonError::Syntax`] when a value cannot be written.
    pub fn to_json(&self) -> Result<String, JsonError> {
        match &self.fitted {
            Some(file) => file.to_json(),
            None => Ok(serde_json::to_string_pretty(&PlainModel::from(self.clone()))? + "\n"),
        }
    }
}

impl From<ModelFile> for GivenModel {
    fn from(file: ModelFile) -> Self {
        Self {
            name: file.name.clone(),
            erm: file.fit.erm.clone(),
            ocv: file.ocv.clone(),
            map: None,
            log_covariance: file.fit.log_covariance.clone(),
            warnings: file.fit.warnings.words(),
            additions: file.additions.clone(),
            facts: file.facts,
            ladder: None,
            fitted: Some(Box::new(file)),
        }
    }
}

#[cfg(test)]
mod tests;
