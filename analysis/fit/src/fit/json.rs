//! The files a fit leaves: the list of fits as the command line prints it, and one model file per
//! order.

use super::addition::{Addition, augmented};
use super::minima::LocalMinimum;
use super::options::Objective;
use super::result::ErmFit;
use super::schema::{JsonError, MODEL_SCHEMA, MODEL_SCHEMA_VERSION, PROGRAM};
use super::uncertainty::ErmSigma;
use super::warning::Warnings;
use analysis_effects::{augmented::Augmented, contract::Facts};
use analysis_model::{
    model::{Erm, RcBranch},
    ocv::OcvCurve,
    pack::{Pack, PackError},
};
use serde::{Deserialize, Serialize};

/// Version of a file without additions, which older readers accept.
const PLAIN_VERSION: u32 = 1;

/// All fits of one call: `{"fits": [{"rc": …, "objective": …, "r_ohm": …, "branches": […],
/// "dc_resistance_ohm": …, …}]}`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitReport {
    /// One entry per fit.
    pub fits: Vec<FitEntry>,
}

/// One fit of a [`FitReport`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitEntry {
    /// Number of RC branches.
    pub rc: usize,
    /// Value of the objective, in the unit of its kind.
    pub objective: f64,
    /// Series resistance, Ω.
    pub r_ohm: f64,
    /// RC branches by rising time constant.
    pub branches: Vec<RcBranch>,
    /// Resistance at zero frequency, Ω.
    pub dc_resistance_ohm: f64,
    /// Objective that was minimised.
    pub objective_kind: Objective,
    /// Names of the spectra pooled.
    pub spectra: Vec<String>,
    /// Points fitted.
    pub points: usize,
    /// Time constants of the branches, s.
    pub time_constants_s: Vec<f64>,
    /// Standard uncertainty of the parameters.
    pub sigma: ErmSigma,
    /// Root mean square of |Z_model − Z_data|, Ω.
    pub rms_ohm: f64,
    /// χ² per degree of freedom, if the data state their uncertainty.
    pub reduced_chi2: Option<f64>,
    /// Warnings to the user, in sentences.
    #[serde(flatten)]
    pub warnings: Warnings,
    /// Other minima that the search met, deepest first.
    #[serde(default)]
    pub other_minima: Vec<LocalMinimum>,
}

impl FitEntry {
    /// The entry of a fit to the spectra of these names.
    pub fn new(fit: &ErmFit, spectra: Vec<String>) -> Self {
        Self {
            rc: fit.erm.branches.len(),
            objective: fit.objective,
            r_ohm: fit.erm.r_ohm,
            branches: fit.erm.branches.clone(),
            dc_resistance_ohm: fit.erm.dc_resistance_ohm(),
            objective_kind: fit.objective_kind,
            spectra,
            points: fit.points,
            time_constants_s: fit.erm.time_constants_s(),
            sigma: fit.sigma.clone(),
            rms_ohm: fit.rms_ohm,
            reduced_chi2: fit.reduced_chi2,
            warnings: fit.warnings.clone(),
            other_minima: fit.other_minima.clone(),
        }
    }
}

/// A cell's model as a pack sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PackModel {
    /// Size and interconnect.
    #[serde(flatten)]
    pub pack: Pack,
    /// The pack's model.
    pub erm: Erm,
    /// The pack's resistance at zero frequency, Ω.
    pub dc_resistance_ohm: f64,
}

impl PackModel {
    /// Maps a cell's model to a pack.
    ///
    /// # Errors
    /// [`PackError`] for a pack that cannot be or a cell model that is not valid.
    pub fn new(cell: &Erm, pack: Pack) -> Result<Self, PackError> {
        let erm = pack.erm(cell)?;
        Ok(Self {
            pack,
            dc_resistance_ohm: erm.dc_resistance_ohm(),
            erm,
        })
    }
}

/// Contents of a `model.json`: one fitted order with all that is known of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelFile {
    /// [`MODEL_SCHEMA`].
    pub schema: String,
    /// 2 with additions, 1 without.
    pub schema_version: u32,
    /// Program and version that wrote it; empty in files of before.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub program: String,
    /// Name of the cell or model.
    pub name: String,
    /// Number of RC branches.
    pub rc: usize,
    /// The fit of the cell.
    pub fit: ErmFit,
    /// Resistance of the cell at zero frequency, Ω.
    pub dc_resistance_ohm: f64,
    /// Time constants of the branches, s.
    pub time_constants_s: Vec<f64>,
    /// Names of the spectra pooled.
    pub spectra: Vec<String>,
    /// Points that the gate of the measurement has refused.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub refused: Vec<RefusedPoint>,
    /// The cell's model mapped to a pack, if requested.
    pub pack: Option<PackModel>,
    /// Open-circuit voltage over state of charge, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ocv: Option<OcvCurve>,
    /// The pulses that the model was fitted to in addition to the spectra; `None` for spectra
    /// alone. `fit` then holds the joint fit: its objective is χ² of both, its points are
    /// frequencies of the mean spectrum and bins of the pulses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint: Option<JointProvenance>,
    /// Effects that a diagnosis has added; `fit` then holds the base that was refitted together
    /// with them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub additions: Vec<Addition>,
    /// Range of the data that the additions come from; needed with additions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facts: Option<Facts>,
}

/// A point that the gate of the measurement has refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RefusedPoint {
    /// Name of its spectrum.
    pub spectrum: String,
    /// File of that spectrum: repeats may have one name.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub file: String,
    /// Its frequency, Hz.
    pub freq_hz: f64,
    /// Why.
    pub reasons: Vec<String>,
    /// True if the model was nevertheless fitted to it, on request.
    pub fitted: bool,
}

/// Data of a joint fit besides the spectra, and the quality of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointProvenance {
    /// Name of the series with the pulses.
    pub series: String,
    /// Pulses fitted, by their number in the series, from 1.
    pub pulses: Vec<usize>,
    /// Pulses held out.
    pub held_out: Vec<usize>,
    /// Name of what the OCV curve comes from.
    pub ocv_from: String,
    /// Resistance of the pulses' cell and instrument over the spectra's; the model is that of the
    /// spectra's cells.
    pub gain: f64,
    /// Its standard uncertainty.
    pub gain_sigma: Option<f64>,
    /// Root mean square gap on the held-out pulses, V.
    pub held_out_rms_v: Option<f64>,
}

impl ModelFile {
    /// The file of a fit to the spectra of these names.
    pub fn new(name: &str, fit: ErmFit, spectra: Vec<String>, pack: Option<PackModel>) -> Self {
        Self {
            schema: MODEL_SCHEMA.to_owned(),
            program: PROGRAM.to_owned(),
            schema_version: PLAIN_VERSION,
            name: name.to_owned(),
            rc: fit.erm.branches.len(),
            dc_resistance_ohm: fit.erm.dc_resistance_ohm(),
            time_constants_s: fit.erm.time_constants_s(),
            spectra,
            refused: Vec::new(),
            pack,
            fit,
            ocv: None,
            joint: None,
            additions: Vec::new(),
            facts: None,
        }
    }

    /// Checks that the stated order is the model's, and that the covariance has a row and a column
    /// for each of its parameters.
    fn check_size(&self) -> Result<(), JsonError> {
        let (branches, parameters) = (self.fit.erm.branches.len(), self.fit.erm.parameter_count());
        if self.rc != branches {
            return Err(JsonError::Order {
                rc: self.rc,
                branches,
            });
        }
        let Some(rows) = &self.fit.log_covariance else {
            return Ok(());
        };
        match rows
            .iter()
            .map(Vec::len)
            .find(|columns| *columns != parameters)
        {
            None if rows.len() == parameters => Ok(()),
            columns => {
                let (field, columns) = ("fit.log_covariance", columns.unwrap_or(parameters));
                Err(JsonError::Covariance {
                    field,
                    parameters,
                    rows: rows.len(),
                    columns,
                })
            }
        }
    }

    /// The file's text.
    ///
    /// # Errors
    /// [`JsonError::Syntax`] when a value cannot be written; does not happen for a fit made by
    /// [`super::fit_erm`].
    pub fn to_json(&self) -> Result<String, JsonError> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Reads a file's text, written by this version or an older one.
    ///
    /// # Errors
    /// [`JsonError`] for text that is not JSON, another schema, a newer version, a model that is
    /// not valid, or additions that are not known.
    pub fn from_json(text: &str) -> Result<Self, JsonError> {
        #[derive(Deserialize)]
        struct Head {
            schema: String,
            schema_version: u32,
        }
        let head: Head = serde_json::from_str(text)?;
        if head.schema != MODEL_SCHEMA {
            return Err(JsonError::Schema { met: head.schema });
        }
        if head.schema_version == 0 || head.schema_version > MODEL_SCHEMA_VERSION {
            return Err(JsonError::Version {
                met: head.schema_version,
            });
        }
        let file: Self = serde_json::from_str(text)?;
        file.fit.erm.validate()?;
        file.check_size()?;
        if let Some(ocv) = &file.ocv {
            ocv.validate()?;
        }
        file.augmented()?;
        Ok(file)
    }
}

impl ModelFile {
    /// Base and additions; none for a model without additions.
    ///
    /// # Errors
    /// [`JsonError`] for additions that lack an OCV curve or the facts of their data, or that the
    /// catalogue does not know as they are.
    pub fn augmented(&self) -> Result<Option<Augmented>, JsonError> {
        augmented(
            &self.fit.erm,
            self.ocv.as_ref(),
            self.facts,
            &self.additions,
        )
    }

    /// Returns the file with additions to a base that was refitted together with them. The
    /// uncertainty and the pack of the first fit belong to another base and are dropped.
    #[must_use]
    pub fn with_additions(mut self, erm: Erm, facts: Facts, additions: Vec<Addition>) -> Self {
        self.schema_version = MODEL_SCHEMA_VERSION;
        self.program = PROGRAM.to_owned();
        self.rc = erm.branches.len();
        self.dc_resistance_ohm = erm.dc_resistance_ohm();
        self.time_constants_s = erm.time_constants_s();
        self.fit.sigma = super::sigma_of(&erm, &|_, _| None);
        self.fit.log_covariance = None;
        self.fit.other_minima = Vec::new();
        self.fit.erm = erm;
        self.pack = None;
        (self.facts, self.additions) = (Some(facts), additions);
        self
    }
}
