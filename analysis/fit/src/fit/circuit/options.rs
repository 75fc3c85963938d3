//! Options of a circuit's fit, and the reasons for a refusal.

use crate::fit::options::{FitError, Objective};
use analysis_model::model::WrittenCircuit;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Most starts a fit may have.
pub const MAX_STARTS: usize = 100_000;

/// Weight of a residual.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weight {
    /// Nothing: every residual counts in Ω.
    Unit,
    /// The measured |Z| at its frequency: every residual counts as a fraction.
    Modulus,
    /// The measured covariance: every residual counts in standard deviations.
    Covariance,
}

impl Weight {
    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unit => "unit",
            Self::Modulus => "modulus",
            Self::Covariance => "covariance",
        }
    }
}

impl fmt::Display for Weight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Weight {
    type Err = CircuitFitError;

    fn from_str(text: &str) -> Result<Self, CircuitFitError> {
        let all = [Self::Unit, Self::Modulus, Self::Covariance];
        all.into_iter()
            .find(|w| w.name() == text)
            .ok_or_else(|| CircuitFitError::UnknownWeight {
                met: text.to_owned(),
            })
    }
}

/// Method of the search for the global optimum.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Search {
    /// Many local fits from starts drawn from ranges that the data give.
    Starts,
    /// Differential evolution over the same ranges, its best basins polished.
    Evolution,
}

impl FromStr for Search {
    type Err = CircuitFitError;

    fn from_str(text: &str) -> Result<Self, CircuitFitError> {
        match text {
            "starts" => Ok(Self::Starts),
            "evolution" => Ok(Self::Evolution),
            _ => Err(CircuitFitError::UnknownSearch {
                met: text.to_owned(),
            }),
        }
    }
}

/// Options of a circuit's fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CircuitOptions {
    /// Objective to minimise.
    pub objective: Objective,
    /// Weight of the residuals. `None`: for `complex` the covariance if every point has one,
    /// otherwise the modulus; for the others unit, so that they are the sums of the ERM's fit.
    pub weight: Option<Weight>,
    /// Start values as (index of the parameter, value); the others are drawn.
    pub guess: Vec<(usize, f64)>,
    /// Parameters that are held, as (index of the parameter, value).
    pub constants: Vec<(usize, f64)>,
    /// Maximum number of starts of [`Search::Starts`]. `None`: 64, or only the guess if it gives
    /// every parameter.
    pub starts: Option<usize>,
    /// Method of the search for the global optimum.
    pub search: Search,
    /// Seed of the starts; equal seeds give equal fits.
    pub seed: u64,
}

impl Default for CircuitOptions {
    /// Complex least squares from starts that the data give.
    fn default() -> Self {
        Self {
            objective: Objective::Complex,
            weight: None,
            guess: Vec::new(),
            constants: Vec::new(),
            starts: None,
            search: Search::Starts,
            seed: 0,
        }
    }
}

impl CircuitOptions {
    /// Adds the values that stand in the circuit's text; those of the options come first.
    #[must_use]
    pub fn with_written(mut self, written: &WrittenCircuit) -> Self {
        let named: Vec<usize> = self
            .guess
            .iter()
            .chain(&self.constants)
            .map(|(index, _)| *index)
            .collect();
        let unnamed = |(index, _): &&(usize, f64)| !named.contains(index);
        self.guess.extend(written.guess.iter().filter(unnamed));
        self.constants
            .extend(written.constants.iter().filter(unnamed));
        self
    }
}

/// Reason why a fit of a circuit was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CircuitFitError {
    /// The data are not valid impedances.
    #[error(transparent)]
    Data(#[from] FitError),
    /// A covariance is requested but absent.
    #[error(
        "weight covariance: expected a covariance at every point, met {known} of {points} points \
        with one; use unit or modulus"
    )]
    UnknownCovariance {
        /// Points with a usable covariance.
        known: usize,
        /// All points.
        points: usize,
    },
    /// More parameters than the data have numbers.
    #[error(
        "fit of {circuit}: expected at least {parameters} numbers for as many free parameters, met \
        {numbers} \
         ({frequencies} distinct frequencies, objective {objective})"
    )]
    TooFewFrequencies {
        /// The circuit.
        circuit: String,
        /// Its free parameters.
        parameters: usize,
        /// Independent numbers in the data.
        numbers: usize,
        /// Distinct frequencies in the data.
        frequencies: usize,
        /// The objective: magnitudes alone give one number per frequency, complex values two.
        objective: Objective,
    },
    /// As many parameters as numbers, and more readings only repeat the same numbers.
    #[error(
        "fit of {circuit}: expected more numbers than {parameters} free parameters, met {points} \
        points that repeat {frequencies} distinct \
         frequencies to the last digit: {numbers} numbers"
    )]
    Repeated {
        /// The circuit.
        circuit: String,
        /// Its free parameters.
        parameters: usize,
        /// Points met.
        points: usize,
        /// Distinct frequencies among them.
        frequencies: usize,
        /// Independent numbers.
        numbers: usize,
    },
    /// A guess or a constant that belongs to no parameter or is out of its range.
    #[error(
        "fit of {circuit}: expected {list} within the physical range of the circuit's parameters, \
        met number {index} with value {value}"
    )]
    BadValue {
        /// The circuit.
        circuit: String,
        /// Guess or constant.
        list: &'static str,
        /// Index of the parameter.
        index: usize,
        /// The value met.
        value: f64,
    },
    /// A number of starts beyond what is sensible.
    #[error("starts: expected 1 to {MAX_STARTS}, met {met}")]
    BadStarts {
        /// The number met.
        met: usize,
    },
    /// No start gave finite numbers.
    #[error(
        "fit of {circuit}: expected impedances that can be squared, met values so large or small \
        that no start gives a finite objective"
    )]
    NoFiniteValue {
        /// The circuit.
        circuit: String,
    },
    /// The name is not a weight.
    #[error("weight: expected unit, modulus or covariance, met \"{met}\"")]
    UnknownWeight {
        /// The name met.
        met: String,
    },
    /// The name is not a search.
    #[error("search: expected starts or evolution, met \"{met}\"")]
    UnknownSearch {
        /// The name met.
        met: String,
    },
}
