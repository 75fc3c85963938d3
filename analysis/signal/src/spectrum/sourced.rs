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
    /// Name of the evaluation, if the file contains several of one measurement; they do not count
    /// as repeats.
    pub curve: Option<String>,
}

impl Origin {
    /// Returns true unless the file states another fixture than a cell, or a bias.
    pub fn is_unbiased_cell(&self) -> bool {
        self.fixture.as_deref().is_none_or(|f| f == "cell") && self.bias_a.is_none_or(|b| b == 0.0)
    }
}

/// A spectrum and its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct SourcedSpectrum {
    /// Origin of the spectrum.
    pub origin: Origin,
    /// The spectrum.
    pub spectrum: Spectrum,
    /// Points that the quality gate of the measurement has refused, if the file states it. The
    /// spectrum still contains them.
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

/// Returns the number of the cell in a name like `cell0_3`, cell and repeat, or `None` for another
/// form, as `cellm2_0`, which was measured under bias.
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
