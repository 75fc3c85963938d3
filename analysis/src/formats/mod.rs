//! Impedance spectra from text files, the format told by the content and not by the file's name.
//!
//! | format | first line that is not a comment | spectra |
//! |---|---|---|
//! | the project's | a header with `freq_hz,z_re_ohm,z_im_ohm`, perhaps `sigma_re_ohm,sigma_im_ohm`, `cov_re_im_ohm2`, `amplitude_a`, `flags`, others | one |
//! | impedance.py's | no header, three numbers: f in Hz, Re Z, Im Z in Ω | one |
//! | the thesis' | `freq,offset,resistance,theta`: Hz, bias in A, \|Z\| in Ω, arg Z in rad | one per offset |
//! | the project's tidy table | `fixture,cell,repeat,bias_a,freq_hz,z_abs_ohm,z_phase_rad` | one per fixture, cell, repeat, bias |
//!
//! Fields are separated by commas, or by semicolons, between which a comma is a decimal point;
//! columns may stand in any order where there is a header, columns of other names are passed over.
//! Blank lines, CRLF, a byte order mark, blanks and double quotes around a field, and comments (`#`
//! first in a line) are tolerated. Points are sorted by frequency. What cannot be a measurement is
//! refused: the error names file, line, column, what was expected and what was met.
//!
//! A file may hold several sweeps. They are told apart by a column that names a cycle, a loop or an
//! id, and by a frequency that starts again (`sweeps`); [`read_file`] says by what.
//!
//! Names: a file that holds one spectrum gives it the file's name without extension. The tidy
//! table's are `cell0_3` (cell 0, repeat 3), `shunt_0`, `fake_cell_0` (fixture, repeat), with the
//! bias at the end where it is not zero: `cell0_0_-2A`, `cell0_0_+5A`. Sweeps of one file are
//! called after the whole file name and what tells them apart: `file.mpt#cycle2`, `file.mpt#loop1`.
//!
//! Files of potentiostats' programs (Gamry, BioLogic, ZPlot, Autolab, …): the module `vendor`.
//! Records of oscilloscopes: [`scope`]. Current and voltage over time: [`read_series`]. What is
//! written for others: [`spectrum_text`].

mod bdf;
mod error;
mod flags;
mod foreign;
mod layout;
pub mod model;
pub mod scope;
pub(crate) mod shared;
mod sweeps;
mod text;
mod timeseries;
mod vendor;
mod write;

pub use bdf::{bdf_text, write_bdf_parquet};
pub use error::FormatError;
pub use timeseries::{CurrentSign, SeriesOptions, SeriesReadError, read_series};
pub use write::{SpectrumFormat, spectrum_text};

use crate::{dataset::FlaggedPoint, spectrum::Spectrum};
use std::path::Path;

/// What a file tells of where a spectrum comes from, beyond its name; none where it does not tell.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Origin {
    /// What was clamped in: `cell`, `shunt`, `fake_cell`, …
    pub fixture: Option<String>,
    /// Which of them.
    pub cell: Option<String>,
    /// Which repetition.
    pub repeat: Option<String>,
    /// Direct current superposed, A; charging is positive.
    pub bias_a: Option<f64>,
    /// Which evaluation of one measurement it is, where the file holds several: they are no
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
    /// Where it comes from.
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

    /// Which cell it is of: as the file's column tells, else as the name does; none where neither
    /// tells.
    pub fn cell(&self) -> Option<&str> {
        self.origin
            .cell
            .as_deref()
            .or_else(|| cell_in_name(&self.spectrum.name))
    }
}

/// The number of the cell in a name like `cell0_3`, cell and repeat; none of another form, as
/// `cellm2_0`, which was taken under bias.
pub(crate) fn cell_in_name(name: &str) -> Option<&str> {
    let number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    let (cell, repeat) = name.strip_prefix("cell")?.split_once('_')?;
    (number(cell) && number(repeat)).then_some(cell)
}

/// Reads all spectra of a file, in the order of their first row.
///
/// # Errors
/// [`FormatError`] when the file cannot be read, is of no known format, or holds what cannot be a
/// measurement.
pub fn read_spectra(path: &Path) -> Result<Vec<Spectrum>, FormatError> {
    Ok(read_sourced(path)?
        .into_iter()
        .map(|s| s.spectrum)
        .collect())
}

/// Reads the spectra of cells measured without bias: all of a file that names no fixture and no
/// bias, and of a table those rows.
///
/// # Errors
/// As [`read_spectra`]. A file without any such spectrum gives an empty list.
pub fn read_unbiased_cells(path: &Path) -> Result<Vec<Spectrum>, FormatError> {
    Ok(read_sourced(path)?
        .into_iter()
        .filter(|s| s.origin.is_unbiased_cell())
        .map(|s| s.spectrum)
        .collect())
}

/// Reads all spectra of a file with what it tells of their origin.
///
/// # Errors
/// As [`read_spectra`].
pub fn read_sourced(path: &Path) -> Result<Vec<SourcedSpectrum>, FormatError> {
    Ok(read_file(path)?.spectra)
}

/// The spectra of a file, and remarks on how they were read, which whoever asked for them ought to
/// see.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FileSpectra {
    /// The spectra, in the order of their first row.
    pub spectra: Vec<SourcedSpectrum>,
    /// Sentences that begin with the file's name: by what spectra were told apart, what was left
    /// out or taken for granted.
    pub notes: Vec<String>,
}

/// Reads all spectra of a file, with remarks on how.
///
/// # Errors
/// As [`read_spectra`].
pub fn read_file(path: &Path) -> Result<FileSpectra, FormatError> {
    let bytes = std::fs::read(path).map_err(|source| FormatError::Read {
        file: path.to_owned(),
        source,
    })?;
    parse_file(path, &bytes)
}

/// As [`read_sourced`], from bytes already read; `path` serves names and messages only.
///
/// # Errors
/// As [`read_spectra`], but for reading.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Vec<SourcedSpectrum>, FormatError> {
    Ok(parse_file(path, bytes)?.spectra)
}

/// As [`read_file`], from bytes already read; `path` serves names and messages only.
///
/// # Errors
/// As [`read_spectra`], but for reading.
pub fn parse_file(path: &Path, bytes: &[u8]) -> Result<FileSpectra, FormatError> {
    if let Some(error) = foreign::binary(path, bytes) {
        return Err(error);
    }
    let own = text::Text::new(path, bytes).and_then(|text| layout::parse(&text));
    match own {
        Err(error @ (FormatError::UnknownFormat { .. } | FormatError::NotText { .. })) => {
            vendor::parse(path, bytes)
                .unwrap_or_else(|| Err(foreign::text(path, bytes).unwrap_or(error)))
        }
        other => other,
    }
}

#[cfg(test)]
mod tests;
