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
    /// Origin of the value.
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

/// Origin of a value.
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
    /// Returns the kind as a keyword.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Quantile(_) => "quantile",
            Self::Derivation(_) => "derivation",
            Self::Study(_) => "study",
            Self::Citation(_) => "citation",
            Self::Convention(_) => "convention",
        }
    }

    /// Returns the source itself.
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

/// Returns the registry as a table in Markdown, as in `docs/reference-thresholds.md`.
pub fn markdown() -> String {
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

/// Converts a value according to its type.
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
    ([(f64, f64); 3], $name:ident) => {
        Value::List(&[
            $name[0].0, $name[0].1, $name[1].0, $name[1].1, $name[2].0, $name[2].1,
        ])
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
        Convention "A misfit of twice the noise in root mean square; below, a lag cannot be \
        separated from noise.";
    LAG_LEFT_PART: f64 = 0.3, "1",
        "Part of the missed squares that the best lag may leave to be accepted.",
        Convention "Most of the misfit must go with the lag. `gate/tests` finds each damage and \
        passes strong effects.";
    LAG_UNEXPLAINED_PART: f64 = 0.1, "1",
        "Part of the delayed voltage's squares that may stay unexplained if a lag is accepted.",
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
        Convention "A stop that comes late or early by some samples is not damage. No study of the \
        value is on record.";
    REPEAT_FLOWS_PART: f64 = 0.05, "1",
        "Part of the repeat's largest current that must flow in the missing time of a run that is \
        cut off.",
        Convention "A shorter rest at the end is not damage. No study of the value is on record.";
    REPEAT_FAR_OFF_Z: f64 = 20.0, "σ",
        "Distance of a run from its repeats, in standard deviations of the bench's history, from \
        which on it is damaged.",
        Convention "Noise does not reach it. It is four times `SENTINEL_Z`, so that a floor that \
        moved reaches the diagnosis.";
    FEWEST_TO_DRIFT: usize = 3, "runs",
        "Fewest repeats that show a drift.",
        Derivation "Two runs always lie on opposite sides of their mean; a third shows a \
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
        Convention "The 5 σ of other checks. By noise alone the differences have a root mean \
        square of about one.";
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
        "Part of the largest step of current from which on a step determines the resistance.",
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
    // Findings on the data.
    COPY_WINDOW: usize = 12, "rows",
        "Rows in a row that must be equal in two runs for the place of a copy to be looked for.",
        Convention "Where a third of the rows of two repeats are equal by their codes, twelve in a \
        row are by chance once in 500 000.";
    COPY_DISTINCT: usize = 6, "1",
        "Fewest voltages that differ among these rows.",
        Convention "Half of the rows must carry information: a rest repeats few codes in every \
            run.";
    COPY_LEAST_ROWS: usize = 24, "rows",
        "Fewest rows that two runs share in a copy.",
        Convention "Two windows of `COPY_WINDOW`.";
    COPY_CHANGES: usize = 12, "1",
        "Fewest changes of the voltage among the shared rows.",
        Convention "Each change is a coincidence of its own. No study of the value is on record.";
    COPY_EQUAL_PART: f64 = 0.98, "1",
        "Part of the shared rows, or points of a spectrum, that must be equal to the last digit.",
        Convention "Repeats of a bench with coarse codes have many equal rows, but not all.";
    COPY_OF_RUN: f64 = 0.05, "1",
        "Least part of the shorter run that the shared rows are.",
        Convention "Less of a run hardly moves a gap. No study of the value is on record.";
    COPY_NOISE_PART: f64 = 0.4, "1",
        "Scatter of the difference of two runs, as a part of what two measurements make, below \
        which one is made of the other.",
        Convention "Two measurements give one within some per cent, a copy that was rounded much \
        less. Where the model misses, they give less than one.";
    WHITE_SCATTER_SIGMAS: f64 = 1.652, "σ",
        "Median of the magnitude of the second difference of white noise, in standard deviations of \
        a sample.",
        Quantile "Half-normal distribution of scale √6, probability 0.5: 0.6745·√6 = 1.652.";
    COPY_LEAST_V: f64 = 1e-8, "V",
        "Scatter of that difference below which coarse codes have made the two runs equal.",
        Convention "Far below any code; zero but for the digits of a float.";
    REST_CURRENT_PART: f64 = 0.02, "1",
        "Part of the record's largest current up to which it rests.",
        Convention "Zero and noise of a channel lie within it. No study of the value is on record.";
    REST_SIGMAS: f64 = 5.0, "σ",
        "Distance of the rest voltage from its expectation, in standard deviations of noise, level \
        and start voltage, that is reported.",
        Quantile "Normal distribution, two-sided probability 6·10⁻⁷.";
    REST_LEAST_V: f64 = 0.03, "V",
        "Least distance of the rest voltage that is reported.",
        Convention "Hysteresis of LFP is 17 mV and a rest of minutes lacks some millivolts: both \
        are the physics' to name.";
    REST_SOC: f64 = 0.02, "1",
        "Error of a stated state of charge that is allowed in addition, by the curve's slope.",
        Convention "As for counted states in `dataset init`: further than 2 % off is refused there.";
    GAP_TIMES_EVEN: f64 = 3.0, "1",
        "Multiple of the steps around from which on rows are missing in an evenly sampled record.",
        Convention "Three rows or more are lost; one late row is not a gap.";
    GAP_TIMES: f64 = 12.0, "1",
        "The same in a record whose spacing changes.",
        Convention "Loggers that slow down by decades make steps of ten times the one before.";
    GAP_AROUND: usize = 3, "1",
        "Steps before and after a gap that it is compared with.",
        Convention "A logger that slows down has longer steps behind it.";
    GAP_CHANGES_PART: f64 = 0.05, "1",
        "Part of the largest current by which it must differ across a gap for an edge to be lost.",
        Convention "As `REPEAT_FLOWS_PART`.";
    EVEN_PART: f64 = 0.9, "1",
        "Part of the steps that must be alike for a record to be sampled evenly.",
        Convention "Gaps, edges and the odd late row are the rest.";
    EVEN_STEP_PART: f64 = 0.25, "1",
        "Relative distance from the middle step within which steps are alike.",
        Convention "Timers of cyclers scatter by a part of a step. No study of the value is on \
        record.";
    FROZEN_LEAST_ROWS: usize = 8, "rows",
        "Fewest equal rows in a row that may be a logger that stood still.",
        Convention "Codes repeat a value too; chance and motion decide, not this number.";
    FROZEN_BY_CHANCE: f64 = 1e-9, "1",
        "Expected number of such stretches in a record by chance, below which they are reported.",
        Convention "Rows are not independent: a drift of the noise holds a code longer.";
    FROZEN_CODES: f64 = 3.0, "codes",
        "Least expected motion of the voltage during equal rows that shows a standstill.",
        Convention "One code is rounding; three are beyond it and the noise of one code.";
    FROZEN_SIGMAS: f64 = 10.0, "σ",
        "The same in standard deviations of a sample.",
        Convention "As `CLIP_MOVES_SIGMAS`.";
    ROUNDED_FEWEST: usize = 8, "1",
        "Fewest uneven steps that show rounded stamps.",
        Convention "An edge makes one or two. No study of the value is on record.";
    ROUNDED_PART: f64 = 0.05, "1",
        "Least part of the steps that are uneven by exactly one quantum.",
        Convention "Fewer say that the record was made of pieces. No study of the value is on \
        record.";
    ROUNDED_MOST_QUANTA: usize = 10, "1",
        "Most quanta in a step for their rounding to matter.",
        Convention "An edge is then known to a tenth of a sample or better.";
    SLOW_BRANCH_PART: f64 = 0.5, "1",
        "Time constant of a branch, as a part of the distance of samples at edges, below which a \
        record does not see it.",
        Derivation "exp(−2) = 14 % of it is left at the next sample.";
    SLOW_SHARE: f64 = 0.25, "1",
        "Part of the model's resistance in such branches from which on it is reported.",
        Convention "Less goes with the series resistance unseen. No study of the value is on \
        record.";
    UNSEEN_PART: f64 = 0.3, "1",
        "Part of the large steps of a current that stand in a row of three or more from which on \
        the current between the samples is not known.",
        Convention "A third: a step that comes back within a sample shows as such a row or not at \
        all. No study of the value is on record.";
    CODES_FEWEST: usize = 6, "1",
        "Fewest different values that codes are looked for in.",
        Convention "A current of a few set points lies on any grid.";
    CODES_FIT_PART: f64 = 0.1, "1",
        "Distance of a step from a multiple of the code that still fits, per code.",
        Convention "Digits of a file round codes: 0.64325 mV is written as 0.64 or 0.65 mV.";
    CODES_ON_GRID: f64 = 0.95, "1",
        "Part of the steps between values that must fit.",
        Convention "Of values on no grid a third fits by chance.";
    CODES_TIMES_STATED: f64 = 2.5, "1",
        "Multiple of the stated step, or of the stated noise where that is more, from which on \
        codes are coarse.",
        Convention "The clean sets lie at 1; rounding of 2.5 times the noise is most of a floor.";
    SCALE_WINDOW_S: f64 = 5.0, "s",
        "Time after an edge over which model and record are compared for a factor.",
        Convention "Diffusion and charge are small within it, most branches are not.";
    SCALE_FEWEST: usize = 3, "1",
        "Fewest edges that determine a factor with its scatter.",
        Derivation "Two have one degree of freedom, of which a scatter is known to 70 %.";
    SCALE_LEAST: f64 = 1.25, "1",
        "Factor, or its inverse, from which on it is reported.",
        Convention "Temperature, ageing and missing effects make less on the real data sets.";
    SCALE_SIGMAS: f64 = 5.0, "σ",
        "Distance of the factor from one in standard deviations.",
        Quantile "Normal distribution, two-sided probability 6·10⁻⁷.";
    SCALE_SAME_CURRENT: f64 = 1.1, "1",
        "Ratio of two neighbouring currents below which their edges give one factor.",
        Convention "Programmed currents of one step agree far better; steps differ by more.";
    SCALE_VARIES: f64 = 1.1, "1",
        "Ratio of the factors at the smallest and the largest current, or its inverse, from which on \
        the factor depends on the current.",
        Convention "A gain is one number; temperature and charge between steps make some per cent.";
    SCALE_SPECTRUM_NEAR: f64 = 0.1, "1",
        "Logarithm of the factor of spectra to the model below which they belong together.",
        Convention "Repeats of spectra agree to some per cent. No study of the value is on record.";
    FILTER_TRIED_S: (f64, f64) = (0.02, 10.0), "s",
        "Shortest and longest filter of the current that is tried.",
        Convention "From twice the fastest logger of the study to the slowest smoothing of a \
        cycler.";
    FILTER_TRIES: usize = 32, "1",
        "Number of time constants that are tried first, equally spaced in their logarithm.",
        Convention "22 % from one to the next; the best is then sharpened.";
    FILTER_FEWEST_EDGES: usize = 4, "1",
        "Fewest steps of the current that determine a filter.",
        Convention "A pulse has two; one record of one pulse is too little to speak of all.";
    FILTER_EDGE_SIGMAS: f64 = 6.0, "σ",
        "Least jump of the current that the voltage needs, in standard deviations of such jumps.",
        Quantile "Normal distribution, two-sided probability 2·10⁻⁹.";
    FILTER_EDGE_PART: f64 = 0.01, "1",
        "The same as a part of the record's largest current.",
        Convention "Smaller steps are left in the log as they are.";
    FILTER_SEGMENT_S: f64 = 2.0, "s",
        "Typical time that a record's current is constant for the record to have a say about form \
        and time constant.",
        Convention "Most of a filter of 1 s is then seen. Where no records are so, all have a say.";
    FILTER_MERGE_SIGMAS: f64 = 4.0, "σ",
        "Difference of two levels of the current below which there was no step between them.",
        Quantile "Normal distribution, two-sided probability 6·10⁻⁵.";
    FILTER_SPLIT_SIGMAS: f64 = 6.0, "σ",
        "Difference of two levels from which on the log shows a step that the voltage does not.",
        Quantile "Normal distribution, two-sided probability 2·10⁻⁹: one is looked for at each of \
        10⁴ rows and more.";
    FILTER_SHORT_PART: f64 = 0.1, "1",
        "Part of the time constant below which a level is so short that it may be no level.",
        Convention "A tenth of a step shows in the log then: its level is known ten times worse.";
    FILTER_LEFT_PART: f64 = 0.3, "1",
        "Part of the squares without a filter that the best one may leave.",
        Convention "As `LAG_LEFT_PART`.";
    FILTER_RECORDS_PART: f64 = 0.6, "1",
        "Part of the records with steps in which the filter must show.",
        Convention "What a minority has is damage of single records, which the gate refuses.";
    FILTER_REST_PART: f64 = 0.02, "1",
        "Part of the record's largest current below which none flows.",
        Convention "As `REST_CURRENT_PART`.";
    FILTER_OFF_PART: f64 = 0.3, "1",
        "Part of the current before it, by the voltage, below which the current was switched off.",
        Convention "What a model misses of a voltage after a load is less.";
    FILTER_SWING_PART: f64 = 0.05, "1",
        "Change of the current by the voltage, as a part of the largest, that is followed at once.",
        Convention "Smaller ones are followed slowly, so that a misfit does not swing.";
    FILTER_AT_ONCE: f64 = 0.6, "1",
        "Part of a large step that the voltage must show in its first sample.",
        Convention "Where the source is slow, the voltage shows as little of it as the log.";
    FILTER_SLOWER: f64 = 1.0, "1",
        "Least time constant as a multiple of the distance of the first two samples after a step.",
        Convention "A faster one shows in one sample, which the time of the edge explains as well.";
    // Rows of a run.
    MOST_BINS: usize = 140, "rows",
        "Most rows of a record; more are merged.",
        Convention "A compromise: whitening a run costs the cube of its rows. No study of the \
        value is on record.";
    BIN_WIDTH_PART: f64 = 0.3, "1",
        "Width of a row as a part of the time since the last edge, before rows are merged.",
        Convention "Some nine rows per decade, as 1/log₁₀(1.3). No study of the value is on \
        record.";
    BIN_GROWTH: f64 = 1.5, "1",
        "Factor by which that width grows until the rows are few enough.",
        Convention "Seven such factors lead beyond `BIN_WIDEST_PART`. The value decides how \
        closely `MOST_BINS` is met.";
    BIN_WIDEST_PART: f64 = 4.0, "1",
        "Width, as a part of the time since the last edge, from which on neighbours are merged \
        instead.",
        Convention "Set by judgement. No study of the value is on record.";
    EDGE_STEP_PART: f64 = 0.03, "1",
        "Part of the largest current that a change must have to be an edge, and that a row must \
        have to be no rest.",
        Convention "Smaller changes are ripple of a current that stays. No study of the value is \
        on record.";
    EDGE_SIGMAS: f64 = 5.0, "σ",
        "The same change in standard deviations of what noise and codes make of a current that \
        stays.",
        Quantile "Normal distribution, two-sided probability 6·10⁻⁷: fewer than one false edge in \
        a million samples.";
    STEADY_CURRENT_SIGMAS: f64 = 3.0, "σ",
        "Standard deviations by which the variance of a current that stays may exceed that of \
        noise.",
        Quantile "Normal distribution, one-sided probability 1.3·10⁻³.";
    CODE_BORDER_FACTOR: f64 = 3.0, "1",
        "Multiple of the codes' mean variance that a current at the border of two codes may have.",
        Derivation "Half of the samples on either code give q²/4, the mean over all places gives \
        q²/12: (q²/4)/(q²/12) = 3.";
    EDGE_ROW_PART: f64 = 0.5, "1",
        "Part of a row's variance that errors at edges of the current must make for it to be left \
        out of gaps and floors in millivolts.",
        Derivation "More than half: the row then depends more on the edge's time than on all else \
        together.";
    EDGE_SAMPLES: usize = 2, "samples",
        "Samples after an edge that stay as they were logged, because a smoothed channel shows \
        there.",
        Convention "One sample may be read during the edge, and one shows the smoothing. No study \
        of the value is on record.";
    ALIKE_SOC: f64 = 5e-4, "1",
        "Difference in state of charge within which repeats share their derivatives.",
        Convention "It saves time only: a diagnosis takes 0.7 of its time (commit 1e11da2). \
        Residuals are each run's own.";
    ALIKE_K: f64 = 0.05, "K",
        "Difference in temperature within which repeats share their derivatives.",
        Convention "As for `ALIKE_SOC`.";
    ALIKE_PART: f64 = 0.01, "1",
        "Difference in current and in time since an edge, as a part, within which repeats share \
        their derivatives.",
        Convention "As for `ALIKE_SOC`.";
    ALIKE_S: f64 = 0.01, "s",
        "Time that is added to the time since an edge before that part is taken.",
        Convention "As for `ALIKE_SOC`.";
    LEAST_CHARGE_BETWEEN: f64 = 0.01, "1",
        "Part of the capacity by which two states of charge must differ for charge to have flowed \
        between two runs.",
        Convention "Voltages at rest lie higher or lower after a charge or a discharge. No study \
        of the value is on record.";
    LEAST_REVERSAL: f64 = 1e-4, "1",
        "Part of the capacity that must flow back to be a reversal.",
        Convention "Set by judgement, far above noise that is counted as charge and far below a \
        pulse. No study is on record.";
    SWEEP_INTERRUPTED: f64 = 3.0, "1",
        "Multiple of the time that waits and periods explain, beyond which a sweep was \
        interrupted.",
        Convention "Set by judgement. `tests/repeats` holds slow points that are not a break.";
    // Noise.
    HISTORY_SPREAD: f64 = 0.15, "1",
        "Standard deviation of the logarithm of a σ that the bench's history states.",
        Convention "95 % of such a σ lie within a factor of 1.34 of the history. No study of the \
        value is on record.";
    IGNORANCE_SPREAD: f64 = 1.5, "1",
        "Standard deviation of the logarithm of a σ without history.",
        Convention "95 % of such a σ lie within a factor of 19 of the assumption, so that repeats \
        decide.";
    ASSUMED_NOISE_V: f64 = 5e-4, "V",
        "White noise of a voltage sample that is assumed without history.",
        Convention "A cycler of middling quality. A diagnosis without repeats says that its noise \
        is assumed.";
    ASSUMED_LEVEL_V: f64 = 1e-3, "V",
        "Scatter of the level from run to run that is assumed without history.",
        Convention "As for `ASSUMED_NOISE_V`.";
    ASSUMED_DRIFT_V: f64 = 2e-4, "V",
        "Slow drift within a run that is assumed without history.",
        Convention "As for `ASSUMED_NOISE_V`.";
    ASSUMED_DRIFT_S: f64 = 2.0, "s",
        "Correlation time of that drift.",
        Convention "As for `ASSUMED_NOISE_V`.";
    ASSUMED_RESISTANCE_PART: f64 = 0.01, "1",
        "Relative scatter of all resistances from run to run that is assumed without history.",
        Convention "As for `ASSUMED_NOISE_V`.";
    ASSUMED_GAIN_PART: f64 = 2e-3, "1",
        "Relative scatter of the current's gain from run to run that is assumed without history.",
        Convention "As for `ASSUMED_NOISE_V`.";
    ASSUMED_ZERO_PART: f64 = 1e-3, "1",
        "Zero error of the current that is assumed without history, as a part of the greatest \
        current.",
        Convention "As for `ASSUMED_NOISE_V`.";
    ASSUMED_CURRENT_NOISE_PART: f64 = 2e-4, "1",
        "Noise of a current sample that is assumed without history, as a part of the greatest \
        current.",
        Convention "As for `ASSUMED_NOISE_V`.";
    ASSUMED_EIS_NOISE_PART: f64 = 3e-3, "1",
        "Relative noise of a point of a spectrum that is assumed without history.",
        Convention "As for `ASSUMED_NOISE_V`.";
    ASSUMED_DISTORTION_PART: f64 = 1e-3, "1",
        "Harmonic of the voltage channel that is assumed, as a part of the fundamental.",
        Convention "60 dB, a usual distortion of an oscilloscope's channel.";
    MOST_STRETCHES: usize = 40, "1",
        "Most stretches of constant current that have an error of their own; more are merged.",
        Convention "A compromise with the time of a diagnosis. No study of the value is on record.";
    DITHERED_PART: f64 = 0.02, "1",
        "Part of q²/12 that samples of one voltage may share where the noise dithers the codes.",
        Convention "K(0) of `codes` falls to that part at a noise of 0.294 of a code, as \
        √(ln(6/(0.02·π²)))/(2π). Such codes count as dithered.";
    LEAST_INFORMATION: f64 = 1e-3, "1",
        "Information of the repeats on ln σ from which on a σ is compared with the bench's \
        history.",
        Convention "Below it, repeats know ln σ to 32 at best, as 1/√0.001: nothing.";
    FEWEST_REPEATS: usize = 3, "runs",
        "Fewest repeats that measure the noise, so that a noise floor may be claimed.",
        Convention "Two repeats give one difference and no sign of which one is off. No study of \
        the value is on record.";
    SENTINEL_Z: f64 = 5.0, "σ",
        "Distance of repeats from each other, or of a σ from the history, from which on the noise \
        floor has moved.",
        Quantile "Normal distribution, one-sided probability 3·10⁻⁷. The χ² of repeats has a \
        heavier tail: 1.4·10⁻⁵ at 100 degrees of freedom.";
    // Where, and the same everywhere.
    BLOCK_FEWEST_ROWS: usize = 4, "rows",
        "Fewest residuals that make a block.",
        Convention "Fewer say little and add a question to Holm's correction. No study of the \
        value is on record.";
    REST_PART: f64 = 0.03, "1",
        "Part of the greatest current of the data below which a row counts as rest in a block.",
        Convention "The value of `EDGE_STEP_PART`, taken of all runs. No study of the value is on \
        record.";
    AFTER_EDGE_S: [f64; 5] = [0.01, 0.1, 1.0, 5.0, 60.0], "s",
        "Times since the last edge that divide the blocks.",
        Convention "One block per decade, with a further limit at 5 s between branches and \
        diffusion. No study is on record.";
    SIGNIFICANT_P: f64 = 0.05, "1",
        "Corrected probability below which the report says that a block lies outside the noise; no \
        verdict depends on it.",
        Convention "The usual 5 % of one family of questions, corrected after Holm (Scandinavian \
        Journal of Statistics 6, 1979).";
    LEAST_BLOCK_P: f64 = 1e-4, "1",
        "Corrected probability below which a block, or a difference between circumstances, says \
        that something is missing.",
        Convention "One false alarm in 10⁴ diagnoses per family of questions. Of 600 nulls (study, \
        seed 20261127), 599 ended at the floor.";
    DIRECTION_LEFT_PART: f64 = 0.02, "1",
        "Part of a direction that must lie outside all others to count as a degree of freedom of \
        its own.",
        Convention "What is left is smaller than the 3 % of `FORMULA_SHARE`. No study of the value \
        is on record.";
    PULSE_FLOWS_PART: f64 = 0.2, "1",
        "Part of the largest current from which on a stretch of current counts as a pulse.",
        Convention "Smaller ones determine a resistance poorly. No study of the value is on \
            record.";
    MOST_TURNS: u32 = 2, "1",
        "Reversals of the current that are counted; further ones are one class.",
        Convention "None, one and more separate a memory from none. No study of the value is on \
        record.";
    WAVE_PERIODS_S: (f64, f64) = (2.0, 60.0), "s",
        "Periods of a wave that are looked for.",
        Convention "A row averages shorter ones out, and a branch of the model can be a longer \
        one.";
    WAVE_PER_PEAK: f64 = 1.5, "1",
        "Frequencies that are asked per width of a peak, which is one over the longest record.",
        Convention "A wave in the middle between two of them keeps sin(π/3)/(π/3) = 0.83 of its \
        amplitude.";
    WAVE_MOST_FREQUENCIES: f64 = 1500.0, "1",
        "Most frequencies that are asked.",
        Convention "The question must not cost minutes. No study of the value is on record.";
    WAVE_LEAST_PERIODS: f64 = 1.5, "periods",
        "Periods that a record must hold to be asked for a wave.",
        Convention "Fewer are the record's level and slope. No study of the value is on record.";
    WAVE_LONGEST_PERIODS: f64 = 2.0, "periods",
        "Periods of the slowest wave that the longest record must hold.",
        Convention "Above `WAVE_LEAST_PERIODS`, so that one record at least is asked. No study of \
        the value is on record.";
    CONTACT_TAUS_S: [f64; 3] = [1.0, 5.0, 25.0], "s",
        "Times within which a contact that comes and goes is asked for.",
        Convention "Factors of five, which the exponential of the kernel bridges. No study of the \
        values is on record.";
    CONTACT_RECORDS_Z: f64 = 2.5, "σ",
        "Standard deviations that the records must show by themselves for spectra to have a say on \
        such a contact.",
        Quantile "Normal distribution, one-sided probability 0.6 %; the tail of the score, a χ², \
        is heavier. The verdict asks `LEAST_BLOCK_P` of both together.";
    CONTACT_FLOWS_PART: f64 = 0.05, "1",
        "Part of a record's largest current below which a row says nothing of a resistance.",
        Convention "The kernel goes with the square of the current: such a row has at most 0.25 % \
        of the weight.";
    // Fit of the base.
    RESISTANCE_REACH: f64 = 300.0, "1",
        "Factor by which a resistance of the base may leave its start.",
        Convention "Wide enough that the data bound it, not the search. No study of the value is \
        on record.";
    TIME_REACH: f64 = 30.0, "1",
        "Factor by which a time constant of the base may leave its start.",
        Convention "A branch stays within three decades about its start. No study of the value is \
        on record.";
    AT_BOUND_PART: f64 = 1e-3, "1",
        "Distance to a bound, as a part of the width or of the value, within which a parameter is \
        at the bound.",
        Convention "Set by judgement. No study of the value is on record.";
    MISFIT_Z: f64 = 3.0, "σ",
        "Distance of χ² from its expectation from which on fits are tried from other starts too.",
        Quantile "Normal distribution, one-sided probability 1.3·10⁻³ (χ² of 1300 degrees of \
        freedom: 1.8·10⁻³). It costs time only.";
    OTHER_STARTS: [f64; 2] = [0.6, 1.7], "1",
        "Factors on all time constants of the model where the base is fitted from other starts.",
        Convention "A factor of 1.7 to either side, set by judgement. No study of the values is on \
        record.";
    // Search.
    PROPOSAL_STEPS: [f64; 2] = [0.3, 8.0], "typical size",
        "Steps of a strength at which the direction of an effect is taken.",
        Convention "A small one for what is linear, a large one for what shows in second order \
        only.";
    LEAST_LAGRANGE: f64 = 5.0, "1",
        "Lagrange score above which a candidate is fitted.",
        Convention "Noise gives as much in 2.5 % of directions (χ² of one degree of freedom). It \
        costs time only.";
    ALWAYS_FITTED: usize = 3, "effects",
        "Candidates that are fitted even below that score.",
        Convention "A compromise with the time of a diagnosis. No study of the value is on record.";
    MOST_FITTED: usize = 8, "effects",
        "Most candidates that are fitted, but for those near the best.",
        Convention "A compromise with the time of a diagnosis. No study of the value is on record.";
    NEAR_BEST: f64 = 0.3, "1",
        "Part of the best Lagrange score that keeps a candidate beyond `MOST_FITTED`.",
        Convention "A linear test may rank strong effects wrongly. No study of the value is on \
        record.";
    HELD_STARTS: usize = 2, "1",
        "Starts of an effect with held shapes at the fit itself.",
        Convention "A compromise with the time of a diagnosis. No study of the value is on record.";
    STRONG_LAGRANGE: f64 = 300.0, "1",
        "Lagrange score from which on every start of an effect is tried.",
        Convention "The linear test does not know the shape of so strong an effect. Commit 593c605 \
        names the diffusion that one start had missed.";
    KEPT_PART: f64 = 0.5, "1",
        "Part of its Lagrange score that a strong effect's fit must keep; else weaker starts are \
        tried.",
        Convention "Set by judgement. Commit 2496db6 names the depletions that one start had \
        missed.";
    WEAKER_STARTS: [f64; 3] = [0.6, 0.36, 0.2], "1",
        "Weaker starts, as parts of the strength that the linear test wants.",
        Convention "About powers of 0.6. Commit 2496db6 names the depletions that one start had \
        missed.";
    SHAPE_DRIFT: f64 = 12.0, "1",
        "χ² that a shape at its bound must gain over a held one to be accepted.",
        Convention "Noise gains as much in 5·10⁻⁴ of cases (χ² of one degree of freedom), or \
        2.5·10⁻³ (two).";
    WIDENED_SHARE: f64 = 0.9, "1",
        "Part of the excess of χ² that an effect must remove for its bound to move.",
        Convention "As much as `MOSTLY_LEFT` leaves: almost everything is explained, so that the \
        bound is wrong and not the effect.";
    WIDENED_BY: f64 = 3.0, "1",
        "Factor by which a bound moves in one step.",
        Convention "Half a decade. No study of the value is on record.";
    MOST_WIDENED: usize = 3, "1",
        "Most steps by which a bound moves.",
        Convention "Together a factor of 27; beyond it the name would not fit the cell.";
    LEFT_OF_BRANCH: f64 = 0.1, "1",
        "Part of its resistance that a branch keeps where an effect starts in its place.",
        Convention "Small enough to leave the place, large enough for its derivative to lead \
        back.";
    DEEPER_CHI2: f64 = 1.0, "1",
        "χ² by which another minimum of a fit must be deeper to be taken for it.",
        Convention "One standard deviation of one parameter. No study of the value is on record.";
    FREED_SHAPE_CHI2: f64 = 1.0, "1",
        "χ² by which a fit with freed shapes may be worse than the one with held shapes and still \
        replace it.",
        Convention "One standard deviation of one parameter; more means another minimum. No study \
        of the value is on record.";
    MOST_RESTARTS: usize = 2, "1",
        "Times that a search begins again from a deeper minimum.",
        Convention "A bound on the time of a diagnosis. No study of the value is on record.";
    MOST_REFUSED: usize = 3, "effects",
        "Refused effects that are kept to plan the next experiment.",
        Convention "A bound on the time of a plan. No study of the value is on record.";
    MOST_EFFECTS: usize = 3, "effects",
        "Most effects that are added.",
        Convention "The study hides up to three. No study of more is on record.";
    PREDICTIVE_TERMS: usize = 4, "effects",
        "Most effects of an augmentation for predictions.",
        Convention "One more than `MOST_EFFECTS`, for a form may need two of them. No study of \
        more is on record.";
    PREDICTIVE_TRIED: usize = 3, "effects",
        "Candidates of the best Lagrange scores that are fitted for each of them.",
        Convention "A compromise with the time of a diagnosis. No study of the value is on record.";
    MOST_PARTS: usize = 8, "1",
        "Most parts that a step of a record is divided into to integrate well enough.",
        Convention "Three halvings; what is still too coarse is refused. No study of the value is \
        on record.";
    // Accept.
    LEAST_SCORE: f64 = 8.0, "1",
        "Score λ − k·ln N that an effect must have.",
        Convention "A BIC difference of 6 to 10 is strong evidence (Kass and Raftery, JASA 90, \
        1995). At N = 1300 noise gives it in 10⁻⁴ of directions.";
    CONVERGED: f64 = 0.1, "1",
        "χ² that a further step of a fit may still promise where the fit counts as converged.",
        Convention "An eightieth of `LEAST_SCORE`: too little to decide anything.";
    CONVERGED_PART: f64 = 0.01, "1",
        "The same as a part of the λ that the fit is evidence for.",
        Convention "A hundredth of the evidence decides nothing.";
    ROUGH_PART: f64 = 1e-4, "1",
        "Part of χ² that a further step may still promise where a fit only compares starts; \
        `CONVERGED` at least.",
        Convention "A ninth of 0.03² of `FORMULA_SHARE`, the part of λ by which names must lead. \
        The best start is then fitted to the end.";
    MATERIAL_SHARE: f64 = 0.3, "1",
        "Part of the excess of χ² that an effect must remove, unless what is left is noise.",
        Convention "What removes less is a part of something else. No study of the value is on \
        record.";
    LEAST_LAMBDA: f64 = 3.84, "1",
        "χ² that leaving an effect out must cost.",
        Quantile "χ² of one degree of freedom, probability 0.95: 3.841. The 95 % interval by the \
        likelihood leaves zero out.";
    HELD_OUT_PART: f64 = 0.1, "1",
        "Part by which the χ² of a held-out run may grow, beside `HELD_OUT_SUM`.",
        Convention "Set by judgement in commit c420b1d and not changed since. No study of the \
        value is on record.";
    HELD_OUT_SUM: f64 = 20.0, "1",
        "χ² by which a held-out run may grow, beside `HELD_OUT_PART`.",
        Convention "Set by judgement in commit c420b1d and not changed since. No study of the \
        value is on record.";
    HELD_OUT_Z: f64 = 4.0, "σ",
        "Standard deviations by which held-out runs may contradict the size of what an effect \
        predicts for them.",
        Quantile "Normal distribution, two-sided probability 6·10⁻⁵.";
    HELD_OUT_RMS_Z: f64 = 3.0, "σ",
        "Standard deviations of its noise beyond which a held-out record may not be missed by more \
        millivolts than before.",
        Quantile "Normal distribution, one-sided probability 1.3·10⁻³ per run.";
    FORMULA_SHARE: f64 = 0.03, "1",
        "Part of an effect's size by which nature may differ from the catalogue's formula.",
        Derivation "What the formula for diffusion through a layer leaves of diffusion into spheres \
        (Crank, The Mathematics of Diffusion, 6.3), at its best strength and time constant: 2.3 % \
        of its root mean square over three decades of time, 3.5 % over four, as the test \
        `a_layer_leaves_three_percent_of_spheres` measures it. Beside an effect of λ a gain of \
        0.03²·λ = 0.0009·λ is nothing.";
    INTEGRATION_PART: f64 = 0.1, "σ",
        "Largest error of integration of a row, in standard deviations of its noise.",
        Convention "In one row it adds 0.1² = 0.01 to χ², a hundredth of the row's expectation.";
    // Tell apart.
    NAMING_LEAD: f64 = 14.0, "1",
        "Score by which a name must lead every rival.",
        Convention "Above a BIC difference of 10, which is very strong evidence (Kass and Raftery, \
        JASA 90, 1995). By the bound of `OUTSIDE_LEAD` chance gives it in Φ(−√14) = 9.1·10⁻⁵ of \
        cases.";
    ASSUMED_LEAD: f64 = 0.05, "1",
        "Part of the λ of a name by which it must lead too where the noise is assumed.",
        Convention "Such a χ² is worth no more than the assumption. It was set on the Panasonic \
        pulses (commit fe5bd06).";
    SUFFICES: f64 = 6.63, "1",
        "χ² below which the freer of two forms gains nothing over the one that it contains.",
        Quantile "χ² of one degree of freedom, probability 0.99: 6.635. The interval of the \
        further shape holds the limit.";
    CERTAIN_LAMBDA: f64 = 150.0, "1",
        "λ below which a name is never certain.",
        Convention "A law outside the catalogue that shares five sixths of λ leaves 150/6 = 25, \
        five standard deviations, to notice.";
    MOSTLY_LEFT: f64 = 0.1, "1",
        "Part of what the base leaves of χ² over noise that may be left where a verdict is mostly.",
        Convention "Three times `FORMULA_SHARE`: a third of the residual in millivolts.";
    NAMED_SHARE: f64 = 0.15, "1",
        "Share of the gap, and of the excess of χ² in the fitted runs, from which on a mechanism is \
        named.",
        Convention "As `SHARE_ERROR`: a smaller share is not distinguished from none.";
    MOSTLY_SHARE: f64 = 0.7, "1",
        "Share of the gap that the named mechanisms must remove together for a verdict of mostly.",
        Convention "Two thirds of the mean square and a little more: what stays is less than half \
        of the residual in millivolts plus its floor.";
    SHARE_ERROR: f64 = 0.15, "1",
        "Least half of the width of the interval of a share.",
        Study "`eis-study --porous 10 --shares --seed 20261129`: four of four named shares whose truth \
        is known lie within it.";
    PARTNER_SHARE: f64 = 0.9, "1",
        "Part of what a mechanism removes that another one must bring back to do as well.",
        Convention "As much as `MOSTLY_LEFT` leaves.";
    OUTSIDE_LEAD: f64 = 6.0, "1",
        "Score by which a law outside the catalogue must lead a name to withdraw it.",
        Quantile "Normal distribution, one-sided probability 0.7 % of w above √6. With one \
        strength each, the lead over a true name is at most w².";
    OUTSIDE_ALONE: f64 = 30.0, "1",
        "Score from which on a law outside the catalogue says by itself that something is missing.",
        Convention "Twice the 15 that one gained on a simulated bench with nothing hidden, by \
        small systematic errors that repeats do not show.";
    // Verdict and report.
    GOOD_FIT_Z: f64 = 5.0, "σ",
        "Distance of χ² from its expectation below which nothing is missing.",
        Quantile "Normal distribution, one-sided probability 3·10⁻⁷ (χ² of 1300 degrees of \
        freedom: 1.2·10⁻⁶).";
    TWO_SIDED_95: f64 = 1.959_964, "σ",
        "Root of the χ² at the ends of a stated interval.",
        Quantile "Normal distribution, probability 0.975.";
    HARD_TO_TELL_R: f64 = 0.9, "1",
        "Distinguishability r below which the catalogue lists a pair as hard to separate; no \
        verdict depends on it.",
        Convention "A tenth of λ is shared. No study of the value is on record.";
    APART_SIGMA: f64 = 6.32, "σ",
        "Separation from which on the catalogue counts a pair as separated; no verdict depends on \
        it.",
        Convention "√40. At λ of 40 or more the study finds the truth, alone or among twins, in \
        971 of 973 trials (seed 20261128).";
    // Next experiment: what is worth its time.
    ONE_IN_TWENTY: f64 = 1.645, "σ",
        "Standard deviations of λ and of the strength that a plan allows for.",
        Quantile "Normal distribution, probability 0.95: 1.645. What is expected to settle fails \
        in one of twenty cases.";
    WEAKEST_PART: f64 = 0.4, "1",
        "Part of the strength that was found below which a plan takes an effect for no weaker.",
        Convention "Else a plan for a barely seen effect would never be enough. No study of the \
        value is on record.";
    LEAST_GROWTH: f64 = 0.1, "1",
        "Part of what settles a pair that a run must add to its λ to count as separating it.",
        Convention "Less is not worth the time of a run. No study of the value is on record.";
    MOST_RIVALS: usize = 6, "effects",
        "Most rivals of one effect that a plan looks at.",
        Convention "A bound on the time of a plan. No study of the value is on record.";
    LINEAR_FACTOR: f64 = 2.0, "1",
        "Factor by which a linear refit may misjudge λ before a pair is given up.",
        Convention "Set by judgement. Of the plans that expected to settle, 61 of 68 did (study, \
        seed 1729).";
    MOST_TIMES: usize = 8, "1",
        "Most times as often as the menu says that a run may be measured.",
        Convention "Three doublings of the menu's number. No study of the value is on record.";
    WORTH: f64 = 1.1, "1",
        "Factor by which more repeats, or a second run, must bring everything forward to be worth \
        their time.",
        Convention "The counterpart of `LEAST_GROWTH`. No study of the value is on record.";
    REFINED_ITEMS: usize = 3, "runs",
        "Best runs of the menu whose λ is found by more than one step.",
        Convention "A bound on the time of a plan. No study of the value is on record.";
    SECOND_RUNS: usize = 2, "runs",
        "Second runs that are tried beside the best one.",
        Convention "A bound on the time of a plan. No study of the value is on record.";
    REFIT_STEPS: usize = 3, "steps",
        "Gauss–Newton steps of a refined λ.",
        Convention "A bound on the time of a plan. No study of the value is on record.";
    // Next experiment: how a run is planned.
    SWEEP_PERIODS: f64 = 4.0, "periods",
        "Periods of a point of a planned sweep.",
        Convention "An estimate of the bench's own sweeps, for the time of a plan only.";
    SLOW_SWEEP_PERIODS: f64 = 8.0, "periods",
        "Periods of a slow point, after which the cell has to forget the one before.",
        Convention "Twice `SWEEP_PERIODS`, for the time of a plan only.";
    SLOW_HZ: f64 = 0.05, "Hz",
        "Frequency below which a point is slow.",
        Convention "Its period of 20 s is `POINT_S`. It is for the time of a plan only.";
    POINT_S: f64 = 20.0, "s",
        "Time of a point beside its periods, in which the step of frequency dies away.",
        Convention "An estimate of the bench's own sweeps, for the time of a plan only.";
    BIAS_PART: f64 = 0.5, "1",
        "Part of the limit beside the amplitude that a planned direct current uses.",
        Convention "Far from the limits, so that a drift of the cell ends no sweep.";
    BIAS_CHARGE: f64 = 0.03, "1",
        "Part of the capacity that the slowest point under a planned direct current moves at most.",
        Convention "Below the 5 % that an experiment allows a group of points by default.";
    BIAS_RAMP_S: f64 = 40.0, "s",
        "Time of ramp, settling and first records under a planned direct current.",
        Convention "The 30 s that an experiment settles by default, and the ramp.";
    BETWEEN_REPEATS_S: f64 = 600.0, "s",
        "Longest rest between repeats of a planned run.",
        Convention "The value of `SETTLE_S`. No study of the value is on record.";
    SAMPLING_S: (f64, f64) = (0.01, 5.0), "s",
        "Shortest and longest distance of samples of a planned record.",
        Convention "As a campaign's records are logged: dense after an edge. No study of the \
        values is on record.";
    SAMPLING_PART: f64 = 0.1, "1",
        "Distance of samples as a part of the time since the last edge.",
        Convention "As a campaign's records are logged: some 24 samples per decade, as \
        1/log₁₀(1.1).";
    MENU_REPEATS: usize = 3, "runs",
        "Repeats of each planned run.",
        Convention "The value of `FEWEST_REPEATS`: one could be an accident, and three measure the \
        noise.";
    SETTLE_S: f64 = 600.0, "s",
        "Rest of the cell before a run at the campaign's state of charge.",
        Convention "Set by judgement. No study of the value is on record.";
    SETTLE_ELSEWHERE_S: f64 = 3600.0, "s",
        "Time to bring the cell to another state of charge or temperature.",
        Convention "Set by judgement: an hour of charge and heat. No study of the value is on \
        record.";
    SETTLE_JIG_S: f64 = 120.0, "s",
        "Time to change what is in the jig.",
        Convention "Set by judgement: two minutes of a person's work.";
    SOC_WITHIN: (f64, f64) = (0.05, 0.95), "1",
        "States of charge that a planned run stays within.",
        Convention "Outside, curves are steep and limits of voltage near. No study of the values \
        is on record.";
    SWEEP_BAND_HZ: (f64, f64) = (0.1, 300.0), "Hz",
        "Band of a planned sweep where the campaign has none.",
        Convention "The band of the project's examples, as in `docs/diagnosis.md`. No study of the \
        values is on record.";
    SWEEP_POINTS: usize = 25, "points",
        "Points of such a sweep.",
        Convention "Seven per decade, as 24/log₁₀(3000). No study of the value is on record.";
    TOP_POINTS: usize = 40, "points",
        "Points of a planned sweep of the upper band.",
        Convention "Set by judgement. No study of the value is on record.";
    SLOWEST_HZ: [f64; 3] = [2e-3, 1e-2, 1.6e-2], "Hz",
        "Lowest frequencies of a planned slow sweep, each where the bench cannot do the one \
        before.",
        Convention "Periods of 500, 100 and 63 s. No study of the values is on record.";
    SLOW_POINTS: usize = 6, "points",
        "Points of a planned slow sweep.",
        Convention "Each takes minutes. No study of the value is on record.";
    SLOW_REPEATS: usize = 2, "runs",
        "Repeats of a planned slow sweep.",
        Convention "Each takes minutes per point. No study of the value is on record.";
    MIRRORED_PARTS: [f64; 3] = [1.0, 0.5, 0.25], "1",
        "Parts of a record's current with which it is mirrored, each where the one before leaves \
        the cell's limits.",
        Convention "Halvings. No study of the values is on record.";
    HALVES_S: [f64; 5] = [2.0, 5.0, 10.0, 20.0, 40.0], "s",
        "Quarter periods of the planned square waves.",
        Convention "Steps of about two. No study of the values is on record.";
    WALK_SOC: [(f64, f64); 3] = [(0.3, 0.9), (0.35, 0.8), (0.4, 0.7)], "1",
        "States of charge between which the cell is walked, the widest walk first.",
        Convention "Below and above, curves are steep and seldom well known. No study of the \
        values is on record.";
    WALK_REST_S: f64 = 600.0, "s",
        "Rest at each end of the walk.",
        Convention "The value of `SETTLE_S`. No study of the value is on record.";
    BURST_S: f64 = 0.5, "s",
        "Half of a planned burst.",
        Convention "The shortest current that a bench times well, by judgement.";
}
