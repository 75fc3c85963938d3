//! A typed model: resistances and capacitances, and optional further data.

use super::GivenModel;
use super::error::GivenError;
use super::ladder::Ladder;
use crate::fit::{Addition, JsonError};
use analysis_effects::contract::Facts;
use analysis_model::{
    map::CellMap,
    model::{Erm, RcBranch},
    ocv::OcvCurve,
};
use serde::{Deserialize, Serialize};

/// Contents of a file of a typed model. Only `r_ohm` and `branches` are needed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlainModel {
    /// Name of the cell or model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Series resistance, Ω, above zero.
    pub r_ohm: f64,
    /// RC branches.
    pub branches: Vec<RcBranch>,
    /// Open-circuit voltage over state of charge.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ocv: Option<OcvCurve>,
    /// Resistances over state of charge and temperature; `r_ohm` and `branches` are one point of
    /// them, for tasks that know one point only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<CellMap>,
    /// Covariance of ln R, ln R1, ln C1, …, row by row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_covariance: Option<Vec<Vec<f64>>>,
    /// Warnings to the user of the model, in sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// The circuit that the model follows, and the quality of the ladder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ladder: Option<Ladder>,
    /// Effects that a diagnosis has added.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub additions: Vec<Addition>,
    /// Range of the data that the additions come from; needed with additions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facts: Option<Facts>,
}

impl PlainModel {
    /// Components with a name.
    pub fn new(name: &str, erm: Erm) -> Self {
        Self {
            name: Some(name.to_owned()),
            r_ohm: erm.r_ohm,
            branches: erm.branches,
            ocv: None,
            map: None,
            log_covariance: None,
            warnings: Vec::new(),
            ladder: None,
            additions: Vec::new(),
            facts: None,
        }
    }

    /// A map with its OCV curve. Tasks that know one point only get its model at half charge and the
    /// temperature node nearest to `ambient_degc`.
    pub fn of_map(name: &str, map: &CellMap, ocv: &OcvCurve, ambient_degc: f64) -> Self {
        let distance_k = |degc: &&f64| (**degc - ambient_degc).abs();
        let nodes = map.temperature_degc.iter();
        let nearest = nodes.min_by(|a, b| distance_k(a).total_cmp(&distance_k(b)));
        let degc = nearest.copied().unwrap_or(ambient_degc);
        Self {
            ocv: Some(ocv.clone()),
            map: Some(map.clone()),
            ..Self::new(name, map.model_at(0.5, degc))
        }
    }
}

/// Reads a typed model; `name` is that of a file without one.
pub(super) fn read(text: &str, name: &str) -> Result<GivenModel, GivenError> {
    let plain: PlainModel = serde_json::from_str(text).map_err(GivenError::Plain)?;
    let plain = PlainModel {
        name: plain.name.or_else(|| Some(name.to_owned())),
        ..plain
    };
    let model = GivenModel::from(plain);
    model.erm.validate()?;
    if let Some(ocv) = &model.ocv {
        ocv.validate()?;
    }
    if let Some(map) = &model.map {
        map.validate()?;
        if model.ocv.is_none() {
            return Err(GivenError::MapWithoutOcv);
        }
        if !model.additions.is_empty() {
            return Err(GivenError::MapWithAdditions);
        }
    }
    if let Some(rows) = &model.log_covariance {
        let parameters = model.erm.parameter_count();
        let wrong = rows
            .iter()
            .map(Vec::len)
            .find(|columns| *columns != parameters);
        if rows.len() != parameters || wrong.is_some() {
            let columns = wrong.unwrap_or(parameters);
            return Err(JsonError::Covariance {
                field: "log_covariance",
                parameters,
                rows: rows.len(),
                columns,
            }
            .into());
        }
    }
    model.augmented()?;
    Ok(model)
}

impl From<PlainModel> for GivenModel {
    fn from(plain: PlainModel) -> Self {
        Self {
            name: plain.name.unwrap_or_default(),
            erm: Erm {
                r_ohm: plain.r_ohm,
                branches: plain.branches,
            },
            ocv: plain.ocv,
            map: plain.map,
            log_covariance: plain.log_covariance,
            warnings: plain.warnings,
            additions: plain.additions,
            facts: plain.facts,
            ladder: plain.ladder,
            fitted: None,
        }
    }
}

impl From<GivenModel> for PlainModel {
    fn from(model: GivenModel) -> Self {
        let GivenModel {
            name,
            erm,
            ocv,
            map,
            log_covariance,
            warnings,
            additions,
            facts,
            ladder,
            fitted: _,
        } = model;
        Self {
            name: Some(name),
            r_ohm: erm.r_ohm,
            branches: erm.branches,
            ocv,
            map,
            log_covariance,
            warnings,
            ladder,
            additions,
            facts,
        }
    }
}
