//! The thresholds of the workflow: each number that decides something, with its unit and source.
//!
//! Each value exists once. The macro makes of an entry the constant that the code uses and a row
//! of the table that `eis-bench effects --thresholds` prints.

use std::fmt;

use serde::Serialize;

/// A number that decides something.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Threshold {
    /// Name of the constant.
    pub name: &'static str,
    /// Its value.
    pub value: Value,
    /// Unit; "1" for a ratio or a χ².
    pub unit: &'static str,
    /// The decision in one sentence.
    pub meaning: &'static str,
    /// Where the value comes from.
    pub source: Source,
}

/// A value of a threshold.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Value {
    /// One number.
    Real(f64),
    /// A number of things.
    Count(usize),
    /// Several numbers: ends of a range, or steps.
    List(&'static [f64]),
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Real(value) => write!(f, "{value}"),
            Self::Count(count) => write!(f, "{count}"),
            Self::List(values) => {
                let all: Vec<String> = values.iter().map(f64::to_string).collect();
                f.write_str(&all.join(", "))
            }
        }
    }
}

/// Where a value comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(tag = "kind", content = "text", rename_all = "snake_case")]
pub enum Source {
    /// A quantile: of which distribution, at which probability.
    Quantile(&'static str),
    /// A derivation: the equation.
    Derivation(&'static str),
    /// A study: which one, with its seed.
    Study(&'static str),
    /// A measurement, a paper or a standard.
    Citation(&'static str),
    /// A convention, with what supports the choice.
    Convention(&'static str),
}

impl Source {
    /// The kind in a word.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Quantile(_) => "quantile",
            Self::Derivation(_) => "derivation",
            Self::Study(_) => "study",
            Self::Citation(_) => "citation",
            Self::Convention(_) => "convention",
        }
    }

    /// The source itself.
    pub fn text(&self) -> &'static str {
        match self {
            Self::Quantile(text)
            | Self::Derivation(text)
            | Self::Study(text)
            | Self::Citation(text)
            | Self::Convention(text) => text,
        }
    }
}

/// The registry as a table in Markdown, as it stands in `docs/thresholds.md`.
pub fn thresholds_markdown() -> String {
    let head = "| name | value | unit | meaning | source |\n|---|---|---|---|---|\n";
    let row = |t: &Threshold| {
        let (kind, text) = (t.source.kind(), t.source.text());
        let Threshold {
            name,
            value,
            unit,
            meaning,
            ..
        } = t;
        format!("| `{name}` | {value} | {unit} | {meaning} | *{kind}*: {text} |\n")
    };
    THRESHOLDS
        .iter()
        .map(row)
        .fold(head.to_owned(), |table, row| table + &row)
}

/// A value as its type tells it.
macro_rules! value {
    (f64, $name:ident) => {
        Value::Real($name)
    };
    (usize, $name:ident) => {
        Value::Count($name)
    };
    (u32, $name:ident) => {
        Value::Count($name as usize)
    };
    ((f64, f64), $name:ident) => {
        Value::List(&[$name.0, $name.1])
    };
    ([f64; $count:literal], $name:ident) => {
        Value::List(&$name)
    };
}

/// Constants and their table.
macro_rules! thresholds {
    ($(
        $name:ident: $type:tt = $value:expr, $unit:literal,
        $meaning:literal,
        $kind:ident $source:literal;
    )*) => {
        $(
            #[doc = $meaning]
            pub(crate) const $name: $type = $value;
        )*

        /// All thresholds, in the order of the workflow.
        pub const THRESHOLDS: &[Threshold] = &[$(
            Threshold {
                name: stringify!($name),
                value: value!($type, $name),
                unit: $unit,
                meaning: $meaning,
                source: Source::$kind($source),
            },
        )*];
    };
}

thresholds! {
    // Gate.
    CLIP_FEWEST: usize = 4, "samples",
        "Fewest samples in a row at the extreme voltage that may be clipped.",
        Convention "Noise and codes repeat a value too; that the voltage must move decides, not \
        this number. `gate/tests` finds each damage and passes strong effects.";
    CLIP_MOVES_SIGMAS: f64 = 10.0, "σ or codes",
        "Least move of the expected voltage during a flat top, and its least distance beyond the \
        top, for a clipped voltage.",
        Convention "Twice the 5 σ of other checks, for an alarm ends the diagnosis. `gate/tests` \
        finds each damage and passes strong effects.";
    CLIP_MOVES_PART: f64 = 0.03, "1",
        "Least value of the same move as a part of the voltage's expected range in the record.",
        Convention "Below it an effect may have held the voltage; it equals the 3 % of \
        `FORMULA_SHARE`. No study of the value is on record.";
    LAG_TRIED_S: (f64, f64) = (1e-3, 10.0), "s",
        "Shortest and longest lag of the current that is tried.",
        Convention "From a sample of a fast logger to the slowest smoothing of a cycler. No study \
        of the range is on record.";
    LAG_TRIES: usize = 41, "1",
        "Number of lags that are tried, equally spaced in their logarithm.",
        Convention "Ten per decade, 26 % from one to the next. Finer steps change the fit of a lag \
        by little.";
    LAG_LEAST_MISSED: f64 = 4.0, "1",
        "Least squares that the prediction misses, as a multiple of the noise's, before a lag is \
        looked for.",
        Convention "A misfit of twice the noise in root mean square; below, a lag cannot be told \
        from noise.";
    LAG_LEFT_PART: f64 = 0.3, "1",
        "Part of the missed squares that the best lag may leave to be believed.",
        Convention "Most of the misfit must go with the lag. `gate/tests` finds each damage and \
        passes strong effects.";
    LAG_UNEXPLAINED_PART: f64 = 0.1, "1",
        "Part of the delayed voltage's squares that may stay unexplained where a lag is believed.",
        Convention "A larger rest says that something else is wrong. `gate/tests` finds each \
        damage and passes strong effects.";
    LAG_TIMES_OTHERS: f64 = 3.0, "1",
        "Multiple of the median lag of the other records from which on a record lags alone.",
        Convention "A lag that all records share is an effect of the catalogue. `gate/tests` finds \
        each damage and passes strong effects.";
    CURRENT_UNLIKE: f64 = 0.5, "1",
        "Difference of two currents, as a part of the larger one's root mean square, from which on \
        repeats are not the same experiment.",
        Convention "Repeats of one experiment differ by noise and timing only, far below it. No \
        study of the value is on record.";
    CURRENT_ALIKE: f64 = 0.25, "1",
        "Difference of two currents, in the same measure, below which they are one experiment: the \
        run was exchanged.",
        Convention "Half of `CURRENT_UNLIKE`, so that no current is both. No study of the value is \
        on record.";
    NO_CURRENT_PART: f64 = 0.01, "1",
        "Part of the data set's greatest current below which a record counts as one without \
        current.",
        Convention "What a channel shows without current is noise; a log at zero current was once \
        called an exchanged run, see `gate/tests`.";
    OWN_EXPLAINS: f64 = 0.5, "1",
        "Part of a voltage's squares that its own current explains at least where the run is not \
        exchanged.",
        Convention "Missing effects leave the shape of the voltage, so that a true current \
        explains most. `gate/tests` passes strong effects.";
    OTHER_EXPLAINS: f64 = 0.9, "1",
        "Part of a voltage's squares that another run's current must explain for the run to be \
        called exchanged.",
        Convention "Stricter than `OWN_EXPLAINS`, for a name of the right run is given. No study \
        of the value is on record.";
    SPECTRUM_FAR: f64 = 0.15, "1",
        "Relative distance of a spectrum from its own fixture's prediction from which on it may be \
        another fixture's.",
        Convention "Effects of the catalogue move a spectrum by less than a change of fixture \
        does. `gate/tests` passes strong effects.";
    SPECTRUM_CLOSER: f64 = 0.3, "1",
        "Part of that distance within which the other fixture's prediction must lie.",
        Convention "The right fixture must be closer by a factor of three. No study of the value \
        is on record.";
    WHOLE_RUN_PART: f64 = 0.9, "1",
        "Part of a repeat's length, or number of points, below which a run is cut off.",
        Convention "A stop that comes late or early by some samples is no damage. No study of the \
        value is on record.";
    REPEAT_FLOWS_PART: f64 = 0.05, "1",
        "Part of the repeat's largest current that must flow in the missing time of a run that is \
        cut off.",
        Convention "A shorter rest at the end is no damage. No study of the value is on record.";
    REPEAT_FAR_OFF_Z: f64 = 20.0, "σ",
        "Distance of a run from its repeats, in standard deviations of the bench's history, from \
        which on it is damaged.",
        Convention "Noise does not reach it. It is four times `SENTINEL_Z`, so that a floor that \
        moved reaches the diagnosis.";
    FEWEST_TO_DRIFT: usize = 3, "runs",
        "Fewest repeats that show a drift.",
        Derivation "Two runs always lie on opposite sides of their mean; a third tells a \
        direction.";
    DRIFT_CORRELATION: f64 = -0.7, "1",
        "Correlation of the first and the last repeat about the middle below which the group \
        drifts and is not damaged.",
        Convention "A cell that changes moves both ends in opposite ways, a damaged run does not. \
        No study of the value is on record.";
    DRIFT_MOST_Z: f64 = 400.0, "σ",
        "Distance between repeats beyond which a drift that is not steady in time counts as \
        damage.",
        Convention "Twenty times `REPEAT_FAR_OFF_Z`, set by judgement. Faster ageing passes as a \
        steady drift.";
    STEADY_PART: f64 = 0.15, "1",
        "Difference between a run's part of the way and its part of the time within which a drift \
        is steady.",
        Convention "Ageing in proportion to time fits within it; the same change in one step does \
        not (`gate/tests`).";
    ASIDE_PART: f64 = 0.3, "1",
        "Part of the way that a run of a steady drift may lie aside of it.",
        Convention "Ageing at any rate passes; the same change in one step does not \
        (`gate/tests`).";
    WITH_CELL_TIMES: f64 = 5.0, "1",
        "Multiple of a steady group's rate of change up to which two repeats of the cell change \
        with it.",
        Convention "Another current or state of charge may show the same ageing stronger. \
        `gate/tests` holds a case that passes.";
    CELL_CHANGE_Z: f64 = 5.0, "σ",
        "Least distance between repeats of a steady group for it to show that the cell changes.",
        Quantile "Normal distribution, one-sided probability 3·10⁻⁷.";
    ODD_STEP_PART: f64 = 0.1, "1",
        "Relative difference of a time step from its repeat's from which on it is odd.",
        Convention "Set by judgement. No study of the value is on record.";
    ODD_STEP_S: f64 = 5e-3, "s",
        "Difference of a time step from its repeat's that is allowed in addition.",
        Convention "Set by judgement, some milliseconds of a logger's clock. No study of the value \
        is on record.";
    MOST_ODD_STEPS: usize = 3, "1",
        "Most odd steps of a record for them to be a jump of its clock.",
        Convention "More of them say that the record is sampled in another way. No study of the \
        value is on record.";
    AT_EDGES_PART: f64 = 0.05, "1",
        "Part of the samples, the farthest ones, that is left out where repeats are compared.",
        Convention "Edges of the current need not fall on the same instant. No study of the value \
        is on record.";
    SAME_TIME_S: f64 = 1e-3, "s",
        "Difference of two instants below which two samples of repeats have the same time.",
        Convention "The planned runs of the menu are sampled in whole milliseconds.";
    LARGE_STEP_PART: f64 = 0.2, "1",
        "Part of the largest step of current from which on a step tells the resistance.",
        Convention "Smaller steps add more noise than knowledge. No study of the value is on \
        record.";
    VISIBLE_STEP_SIGMAS: f64 = 10.0, "σ",
        "Least move of the voltage at the largest step, in standard deviations of a sample, to \
        judge sign and unit.",
        Convention "The resistance of one step is then known to 15 %, as √2/10. Sign and powers of \
        ten need less.";
    LEAST_LEVEL_V: f64 = 0.1, "V",
        "Expected voltage below which its unit is not judged.",
        Convention "A control rests at zero, where a ratio of levels says nothing; a cell lies far \
        above.";
    REVERSED_PART: f64 = -0.5, "1",
        "Part of the expected response, and correlation with it, below which a sign is wrong.",
        Convention "Half the response in the wrong direction; a right sign gives plus one. \
        `gate/tests` finds each damage.";
    KK_LEAST_PERCENT: f64 = 1.0, "% of magnitude of Z",
        "Residual of the Kramers–Kronig test from which on a spectrum may be refused.",
        Convention "Below, the ladder of the test itself and the imperfect causality of a skew are \
        met.";
    KK_LEAST_SIGMAS: f64 = 5.0, "σ",
        "The same in standard deviations of the spectrum's noise.",
        Quantile "Normal distribution, two-sided probability 6·10⁻⁷.";
    KK_END_PART: f64 = 0.3, "1",
        "Part of the points at one end of the band that may disagree with Kramers–Kronig.",
        Convention "A cell that had not come to rest spoils the lowest frequencies only. No study \
        of the value is on record.";
    MEDIAN_STEP_SIGMAS: f64 = 0.954, "σ",
        "Median of the magnitude of the difference of two samples of white noise, in standard \
        deviations of a sample.",
        Quantile "Half-normal distribution of scale √2, probability 0.5: 0.6745·√2 = 0.9539.";
}
