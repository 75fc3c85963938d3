//! Reads impedance spectra from text files. The format is recognised by the content, not by the
//! file's name: by the first line that is not a comment.
//!
//! * the project's: a header with `freq_hz,z_re_ohm,z_im_ohm`, perhaps `sigma_re_ohm,sigma_im_ohm`,
//!   `cov_re_im_ohm2`, `amplitude_a`, `flags`, others; one spectrum
//! * impedance.py's: no header, three numbers: f in Hz, Re Z, Im Z in Ω; one spectrum
//! * the thesis': `freq,offset,resistance,theta`: Hz, bias in A, |Z| in Ω, arg Z in rad; one
//!   spectrum per offset
//! * the project's tidy table: `fixture,cell,repeat,bias_a,freq_hz,z_abs_ohm,z_phase_rad`; one
//!   spectrum per fixture, cell, repeat, bias
//!
//! Fields are separated by commas, or by semicolons with decimal commas. With a header, columns may
//! have any order, and columns with other names are skipped. Blank lines, CRLF, a byte order mark,
//! blanks and double quotes around a field, and comments (lines that begin with `#`) are accepted.
//! Points are sorted by frequency. Values that cannot be measurements are refused: the error names
//! file, line, column, the expected value and the value found.
//!
//! A file may hold several sweeps. They are separated by a column that names a cycle, a loop or an
//! id, and where the frequency starts again (`sweeps`); the remarks of [`read_file`] state the
//! criterion.
//!
//! Names: the only spectrum of a file has the file's name without extension. The tidy table's are
//! `cell0_3` (cell 0, repeat 3), `shunt_0`, `fake_cell_0` (fixture, repeat), with the bias at the
//! end where it is not zero: `cell0_0_-2A`, `cell0_0_+5A`. Several sweeps of a file are named by
//! the whole file name and the criterion that separates them: `file.mpt#cycle2`, `file.mpt#loop1`.
//!
//! The module `vendor` reads files of potentiostats' programs (Gamry, BioLogic, ZPlot, Autolab, …),
//! [`scope`] reads records of oscilloscopes, [`read_series`] reads current and voltage over time,
//! and [`spectrum_text`] writes files for other programs.

mod bdf;
mod calendar;
mod error;
mod file_spectra;
mod flags;
mod foreign;
mod ism;
mod layout;
mod mat;
pub mod model;
mod mpr;
mod native;
mod nearest;
mod neware;
mod parquet;
mod plain;
mod profile;
pub mod scope;
pub(crate) mod shared;
mod spreadsheet;
mod sweeps;
pub(crate) mod text;
mod timeseries;
mod vendor;
mod write;
mod zmx;

pub use bdf::{
    BdfMetadata, bdf_metadata_path, bdf_metadata_text, bdf_spectrum_text, bdf_text,
    read_bdf_metadata, write_bdf_parquet, write_bdf_spectrum_parquet,
};
pub use error::{ErrorPlace, FormatError};
pub use profile::{ProfileReadError, ReadOptions, first_bare_row, parse_profile, read_profile};
pub use timeseries::{
    CurrentSign, Fact, Head, LeftOut, ReadSeries, SeriesOptions, SeriesReadError, State,
    read_record, read_series,
};
pub use write::{SpectrumFormat, spectrum_text};

use analysis_signal::spectrum::{SourcedSpectrum, Spectrum};
pub use file_spectra::FileSpectra;
use spreadsheet::Sheet;
use std::path::Path;

/// Reads all spectra of a file, in the order of their first row.
///
/// # Errors
/// [`FormatError`] if the file cannot be read, has no known format, or contains values that cannot
/// be measurements.
pub fn read_spectra(path: &Path) -> Result<Vec<Spectrum>, FormatError> {
    Ok(read_sourced(path)?
        .into_iter()
        .map(|s| s.spectrum)
        .collect())
}

/// Reads the spectra of cells measured without bias: all spectra of a file without columns for
/// fixture and bias, or the matching rows of a table.
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

/// Reads all spectra of a file with their origin as far as the file states it.
///
/// # Errors
/// As [`read_spectra`].
pub fn read_sourced(path: &Path) -> Result<Vec<SourcedSpectrum>, FormatError> {
    Ok(read_file(path)?.spectra)
}

/// Reads all spectra of a file, with remarks on how they were read. For a BDF file, the metadata
/// file beside it is read too.
///
/// # Errors
/// As [`read_spectra`].
pub fn read_file(path: &Path) -> Result<FileSpectra, FormatError> {
    let bytes = std::fs::read(path).map_err(|source| FormatError::Read {
        file: path.to_owned(),
        source,
    })?;
    let mut read = parse_file(path, &bytes)?;
    bdf::attach_metadata(path, &mut read)?;
    Ok(read)
}

/// Like [`read_sourced`], from bytes already read; `path` is used for names and messages only.
///
/// ```
/// use analysis_files::formats::parse;
/// use std::path::Path;
///
/// let text = "freq_hz,z_re_ohm,z_im_ohm\n1000,0.015,0.001\n1,0.02,-0.005\n0.01,0.03,-0.0004\n";
/// let spectra = parse(Path::new("cell.csv"), text.as_bytes())?;
/// let spectrum = &spectra[0].spectrum;
/// assert_eq!(spectrum.name, "cell");
/// // Points are by rising frequency.
/// assert_eq!(spectrum.points[0].freq_hz, 0.01);
/// assert!((spectrum.points[0].magnitude_ohm() - 0.03).abs() < 1e-5);
/// assert!(spectrum.points[1].phase_rad() < 0.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As [`read_spectra`], except for errors of reading.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Vec<SourcedSpectrum>, FormatError> {
    Ok(parse_file(path, bytes)?.spectra)
}

/// Like [`read_file`], from bytes already read; `path` is used for names and messages only.
///
/// # Errors
/// As [`read_spectra`], except for errors of reading.
pub fn parse_file(path: &Path, bytes: &[u8]) -> Result<FileSpectra, FormatError> {
    if let Some(sheets) = spreadsheet::sheets(path, bytes) {
        return of_sheets(path, &sheets?);
    }
    if let Some(text) = mpr::text(path, bytes) {
        return parse_text(path, text?.as_bytes());
    }
    if let Some(decoded) = ism::text(path, bytes).or_else(|| zmx::text(path, bytes)) {
        let ism::Decoded { text, note } = decoded?;
        let mut read = parse_text(path, text.as_bytes())?;
        read.notes.extend(note);
        return Ok(read);
    }
    if let Some(text) = bdf::parquet_text(path, bytes) {
        return parse_text(path, text?.as_bytes());
    }
    parse_text(path, bytes)
}

/// Returns the spectra of all sheets that contain some; if none does, the error of the last sheet.
fn of_sheets(path: &Path, sheets: &[Sheet]) -> Result<FileSpectra, FormatError> {
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    let mut all = FileSpectra::default();
    let mut refused = None;
    let mut holding = Vec::new();
    for sheet in sheets {
        match parse_text(&sheet.path, sheet.text.as_bytes()) {
            Ok(mut read) => {
                holding.push((sheet, read.spectra.len()));
                all.spectra.append(&mut read.spectra);
                all.notes.append(&mut read.notes);
            }
            // A sheet with settings or remarks.
            Err(error @ (FormatError::UnknownFormat { .. } | FormatError::Empty { .. })) => {
                refused = Some(error);
            }
            Err(error) => return Err(error),
        }
    }
    if holding.len() > 1 {
        let of_each = holding
            .iter()
            .flat_map(|(sheet, count)| std::iter::repeat_n((*sheet, *count), *count));
        for (spectrum, (sheet, count)) in all.spectra.iter_mut().zip(of_each) {
            if count == 1 {
                spectrum.spectrum.name = format!("{file}#{}", sheet.name);
            }
        }
        let count = all.spectra.len();
        all.notes
            .push(format!("{file}: {count} spectra, separated by sheets"));
    }
    match refused {
        Some(error) if holding.is_empty() => Err(error),
        None if holding.is_empty() => Err(FormatError::Empty {
            file: path.to_owned(),
            met: "empty sheets",
        }),
        _ => Ok(all),
    }
}

/// Bytes at the start of a file that are searched for names of columns: heads have some dozens of
/// lines.
const HEAD_BYTES: u64 = 1 << 16;

/// Returns whether a text names the columns of an impedance near its start, as does a log with spectra
/// in some of its rows.
pub fn names_a_spectrum(path: &Path) -> bool {
    let mut bytes = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| {
        use std::io::Read as _;
        file.take(HEAD_BYTES).read_to_end(&mut bytes)
    });
    read.is_ok() && vendor::names_a_spectrum(path, &plain::text(&bytes))
}

fn parse_text(path: &Path, bytes: &[u8]) -> Result<FileSpectra, FormatError> {
    // Ivium's files contain binary marks between their lines.
    let decoded = text::utf_16(bytes);
    if let Some(read) = native::parse(path, decoded.as_deref().map_or(bytes, str::as_bytes)) {
        return read;
    }
    if let Some(error) = foreign::binary(path, decoded.as_deref().map_or(bytes, str::as_bytes)) {
        return Err(error);
    }
    let plain = plain::text(bytes);
    let bytes = plain.as_bytes();
    if let Some(error) = foreign::markup(path, bytes) {
        return Err(error);
    }
    if let Some(renamed) = bdf::with_own_names(&plain) {
        // Modulus and phase are compared with the real and imaginary parts.
        vendor::parse(path, bytes).transpose()?;
        return layout::parse(&text::Text::new(path, renamed.as_bytes())?);
    }
    let text = text::Text::new(path, bytes)?;
    // A comment before a list may contain the names of its columns.
    let own = if vendor::names_in_comment(&plain) {
        Err(layout::unknown(&text))
    } else {
        layout::parse(&text)
    };
    match own {
        Err(FormatError::UnknownFormat {
            file, line, met, ..
        }) => {
            let refused = || FormatError::UnknownFormat {
                file,
                line,
                met,
                nearest: nearest::nearest(bytes),
            };
            vendor::parse(path, bytes)
                .unwrap_or_else(|| Err(foreign::text(path, bytes).unwrap_or_else(refused)))
        }
        other => other,
    }
}

#[cfg(test)]
mod tests;
