//! A spectrum with its origin.

use serde::{Deserialize, Serialize};

use super::Spectrum;

/// Origin of a spectrum as its file states it, beyond the name; a field is `None` if the file does
/// not contain it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Origin {
    /// Object in the jig: `cell`, `shunt`, `fake_cell`, …
    pub fixture: Option<String>,
    /// Name of the cell or object.
    pub cell: Option<String>,
    /// Name of the repetition.
    pub repeat: Option<String>,
    /// Direct current superposed, A; charging is positive.
    pub bias_a: Option<f64>,
    /// Name of the evaluation, where the file holds several of one measurement; they are no
    /// repeats.
    pub curve: Option<String>,
}

impl Origin {
    /// Nothing says that this is another fixture than a cell, or that a bias flowed.
    pub fn is_unbiased_cell(&self) -> bool {
        self.fixture.as_deref().is_none_or(|f| f == "cell") && self.bias_a.is_none_or(|b| b == 0.0)
    }
}

/// A spectrum and where it comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct SourcedSpectrum {
    /// Origin of the spectrum.
    pub origin: Origin,
    /// The spectrum.
    pub spectrum: Spectrum,
    /// Points of it that the quality gate of the measurement has refused, where the file says so:
    /// they are in the spectrum all the same.
    pub flagged: Vec<FlaggedPoint>,
}

impl SourcedSpectrum {
    /// Takes the points out of the spectrum that a quality gate has refused.
    pub fn leave_out_flagged(&mut self) {
        let flagged: Vec<f64> = self.flagged.iter().map(|point| point.freq_hz).collect();
        self.spectrum
            .keep(|point| !flagged.contains(&point.freq_hz));
    }

    /// Returns the name of the cell from the file's column, or from the name, or `None` if neither
    /// contains it.
    pub fn cell(&self) -> Option<&str> {
        self.origin
            .cell
            .as_deref()
            .or_else(|| cell_in_name(&self.spectrum.name))
    }
}

/// The number of the cell in a name like `cell0_3`, cell and repeat; none of another form, as
/// `cellm2_0`, which was taken under bias.
pub fn cell_in_name(name: &str) -> Option<&str> {
    let number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    let (cell, repeat) = name.strip_prefix("cell")?.split_once('_')?;
    (number(cell) && number(repeat)).then_some(cell)
}

/// A point that is kept under protest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlaggedPoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Reasons: the value expected and the value found.
    pub reasons: Vec<String>,
}
