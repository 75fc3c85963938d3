//! The schema of a model file, and why a text is none.

/// Program and version that write a file; every file with a schema names them.
pub const PROGRAM: &str = concat!("eis-bench ", env!("CARGO_PKG_VERSION"));
/// Name of the model file's schema.
pub const MODEL_SCHEMA: &str = "eis-bench/model";
/// Version of the model file's schema; readers refuse a newer one. Version 2 has additions, which a
/// reader of version 1 would ignore.
pub const MODEL_SCHEMA_VERSION: u32 = 2;

/// Reason why a model file could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JsonError {
    /// Not JSON, or not of this shape.
    #[error("model file: {0}")]
    Syntax(#[from] serde_json::Error),
    /// Another schema.
    #[error("model file: expected schema \"{MODEL_SCHEMA}\", met \"{met}\"")]
    Schema {
        /// The schema met.
        met: String,
    },
    /// A version this program does not know.
    #[error("model file: expected schema version 1 to {MODEL_SCHEMA_VERSION}, met {met}")]
    Version {
        /// The version met.
        met: u32,
    },
    /// An order that is not the model's.
    #[error("model file: expected rc to be the number of fit.erm.branches, {branches}, met {rc}")]
    Order {
        /// The order said.
        rc: usize,
        /// Branches of the model.
        branches: usize,
    },
    /// A covariance of other parameters.
    #[error(
        "model file: {field}: expected {parameters} rows and columns for as many parameters, met \
        {rows} rows, one of {columns} columns"
    )]
    Covariance {
        /// Name of the field.
        field: &'static str,
        /// Parameters of the model.
        parameters: usize,
        /// Rows met.
        rows: usize,
        /// Columns of the first wrong row.
        columns: usize,
    },
    /// A model that cannot be a cell's.
    #[error("model file: {0}")]
    Model(#[from] analysis_model::model::ModelError),
    /// An OCV curve that cannot be.
    #[error("model file: {0}")]
    Ocv(#[from] analysis_model::ocv::OcvError),
    /// Additions without what they refer to.
    #[error("model file: additions: expected beside them {what}, met none")]
    AdditionsLack {
        /// The field that is missing.
        what: &'static str,
    },
    /// An error of held-out runs that cannot be.
    #[error(
        "model file: additions: expected facts.held_out with 1 run or more and a share of 0 or more, met {runs} \
        and {share}"
    )]
    HeldOut {
        /// Number of runs met.
        runs: usize,
        /// Share met.
        share: f64,
    },
    /// An addition that this program does not know.
    #[error(
        "model file: additions: expected the name of an effect of the catalogue (`eis-bench \
        effects` lists it), met \"{met}\""
    )]
    UnknownEffect {
        /// The name met.
        met: String,
    },
    /// An addition with other parameters than its effect has.
    #[error("model file: additions: {effect}: expected the parameters {expected}, met {met}")]
    EffectParameters {
        /// Name of the effect.
        effect: String,
        /// Parameters of the effect.
        expected: String,
        /// Parameters of the file.
        met: String,
    },
    /// A value that a parameter cannot have.
    #[error("model file: additions: {effect}: {parameter}: expected {expected}, met {met}")]
    EffectValue {
        /// Name of the effect.
        effect: String,
        /// Name of the parameter.
        parameter: &'static str,
        /// Requirement on the value.
        expected: &'static str,
        /// Value met.
        met: f64,
    },
}
