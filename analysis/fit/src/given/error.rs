//! Reasons why a source is not a valid model of a cell.

/// Relative error above which a ladder is refused: the thesis' cells differ by 0.9 %, and a larger
/// error describes another cell.
pub const REFUSED: f64 = 1e-2;
/// Most branches of a ladder.
pub const MOST_BRANCHES: usize = 32;

/// Reason why a circuit has no ladder.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LadderError {
    /// Values of another circuit.
    #[error("circuit {circuit}: expected {expected} values, one for each parameter, met {met}")]
    Count {
        /// The circuit.
        circuit: String,
        /// Parameters of the circuit.
        expected: usize,
        /// Values met.
        met: usize,
    },
    /// A value that no passive element has.
    #[error(
        "{name} of the circuit: expected {expected}, met {met} {unit}: no ladder of resistances \
        and capacitances represents it"
    )]
    Value {
        /// Name of the parameter.
        name: String,
        /// Its unit.
        unit: &'static str,
        /// Allowed values, in words.
        expected: &'static str,
        /// The value met.
        met: f64,
    },
    /// An invalid band.
    #[error("{name}: expected a lower and a higher frequency above 0 Hz, met {low} and {high}")]
    Band {
        /// Name of the parameter.
        name: &'static str,
        /// Lower end met, Hz.
        low: f64,
        /// Upper end met, Hz.
        high: f64,
    },
    /// A circuit whose data have an unknown band.
    #[error(
        "circuit: expected the field band_hz, the lowest and the highest frequency of the data, \
        met none (an older program wrote the file): fit again, \
         or give the band for the ladder"
    )]
    NoBand,
    /// Nothing that acts at once.
    #[error(
        "circuit {circuit}: expected a resistance in series, met none: a model that is simulated \
        needs one above 0 Ω"
    )]
    NoSeriesResistance {
        /// The circuit.
        circuit: String,
    },
    /// A system without a solution.
    #[error(
        "{blocks}: expected impedances that a ladder can be fitted to, met some too large or too \
        unequal"
    )]
    Unsolved {
        /// The blocks.
        blocks: String,
    },
    /// No passive ladder follows it.
    #[error(
        "{blocks}: expected what resistances and capacitances above zero follow within {} %, met \
        {percent:.1} % of |Z| at {freq_hz:.4} Hz with up to \
         {MOST_BRANCHES} branches: is there an inductive loop",
        100.0 * REFUSED
    )]
    NotPassive {
        /// The blocks.
        blocks: String,
        /// Worst error, %.
        percent: f64,
        /// Frequency of the largest error, Hz.
        freq_hz: f64,
    },
    /// Components that cannot be.
    #[error(transparent)]
    Model(#[from] analysis_model::model::ModelError),
}

/// Reason why a text is not a valid model of a cell.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GivenError {
    /// Not JSON, or not of this shape.
    #[error("expected a model as JSON: {0}")]
    Syntax(#[from] serde_json::Error),
    /// JSON of something else.
    #[error(
        "expected a model file (schema, …), a typed model {{\"r_ohm\": …, \"branches\": \
        [{{\"r_ohm\": …, \"c_f\": …}}]}} or a fitted circuit (circuit.json: \
         fits, …), met {met}"
    )]
    Kind {
        /// The fields met.
        met: String,
    },
    /// A model file that is not as it must be.
    #[error(transparent)]
    File(#[from] crate::fit::JsonError),
    /// A typed model that is not as it must be.
    #[error("typed model: {0}")]
    Plain(serde_json::Error),
    /// Components that cannot be.
    #[error("typed model: {0}")]
    Model(#[from] analysis_model::model::ModelError),
    /// An OCV curve that cannot be.
    #[error("typed model: {0}")]
    Ocv(#[from] analysis_model::ocv::OcvError),
    /// A map that cannot be.
    #[error("typed model: {0}")]
    Map(#[from] analysis_model::map::MapError),
    /// A map without an OCV curve.
    #[error("typed model: expected the field ocv beside map, met none: a map needs its OCV curve")]
    MapWithoutOcv,
    /// A map with additions of a diagnosis.
    #[error(
        "typed model: expected a map without additions, met both: an addition belongs to a model \
        of one point"
    )]
    MapWithAdditions,
    /// The number of fits is not one.
    #[error(
        "fits: expected one fitted circuit, met {met}: take one cell's circuit.json, or fit them \
        together with --pool"
    )]
    Fits {
        /// Number of fits.
        met: usize,
    },
    /// Fits of the extended Randles model.
    #[error(
        "fits: expected a fitted circuit, met a list of extended Randles models: take the \
        model_Nrc.json that `fit --out` writes"
    )]
    RandlesFits,
    /// A circuit that is not as it must be.
    #[error("fitted circuit: {0}")]
    CircuitFile(serde_json::Error),
    /// The text is not a circuit.
    #[error("fitted circuit: {0}")]
    Circuit(#[from] analysis_model::model::ParseError),
    /// A circuit that has no ladder.
    #[error("fitted circuit: {0}")]
    Ladder(#[from] LadderError),
    /// A band for a ladder, but the model is not a circuit.
    #[error(
        "band of the ladder: expected a fitted circuit to follow, met a model that is not a \
        circuit"
    )]
    BandWithoutCircuit,
}
