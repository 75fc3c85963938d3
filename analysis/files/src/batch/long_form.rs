//! Spectra of a table in long form, one after another.

use std::collections::{HashSet, VecDeque};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Origin, SourcedSpectrum, Spectrum};
use num_complex::Complex64;

use super::columns::{NEEDED, Rows, place};
use super::csv::CsvRows;
use super::error::BatchError;
use super::parquet::ParquetRows;

/// First bytes of a Parquet file.
const PARQUET: &[u8] = b"PAR1";

/// Returns whether a file begins like a Parquet file.
pub(super) fn is_parquet(path: &Path) -> bool {
    let mut first = [0; 4];
    File::open(path)
        .and_then(|mut file| file.read_exact(&mut first))
        .is_ok_and(|()| first == PARQUET)
}

/// A spectrum of a table, or the reason why it cannot be used.
#[derive(Debug, Clone, PartialEq)]
pub struct TableSpectrum {
    /// Value of `spectrum_id`, or the name of the file if the table has no such column.
    pub spectrum_id: String,
    /// The spectrum.
    pub spectrum: Result<SourcedSpectrum, String>,
}

#[derive(Debug)]
enum Source {
    Csv(CsvRows),
    Parquet(ParquetRows),
}

impl Source {
    fn next(&mut self) -> Result<Option<Rows>, BatchError> {
        match self {
            Self::Csv(rows) => rows.next(),
            Self::Parquet(rows) => rows.next(),
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Csv(_) => "line",
            Self::Parquet(_) => "row",
        }
    }
}

/// A spectrum whose rows are being read.
#[derive(Debug)]
struct Open {
    spectrum_id: String,
    points: Vec<ImpedancePoint>,
    refused: Option<String>,
}

/// Reads a table in long form: columns `freq_hz`, `z_re_ohm`, `z_im_ohm`; `spectrum_id` where there
/// are several spectra; `sigma_ohm` (of either part) or `sigma_re_ohm`, `sigma_im_ohm` and perhaps
/// `cov_re_im_ohm2`; `amplitude_a`. Other columns are skipped. The rows of a spectrum must be
/// contiguous. The reader holds only one block of rows in memory.
#[derive(Debug)]
pub struct LongForm {
    path: PathBuf,
    source: Source,
    ready: VecDeque<TableSpectrum>,
    open: Option<Open>,
    seen: HashSet<String>,
    ended: bool,
}

impl LongForm {
    /// Returns whether a file is a table in long form: Parquet, or a CSV whose first line names
    /// `spectrum_id` and the columns of an impedance.
    pub fn is_one(path: &Path) -> bool {
        is_parquet(path) || CsvRows::open(path).is_ok_and(|rows| rows.has_ids())
    }

    /// Opens a table.
    ///
    /// # Errors
    /// [`BatchError`] for a file that cannot be read or lacks a column.
    pub fn open(path: &Path) -> Result<Self, BatchError> {
        let source = if is_parquet(path) {
            Source::Parquet(ParquetRows::open(path)?)
        } else {
            Source::Csv(CsvRows::open(path)?)
        };
        Ok(Self {
            path: path.to_path_buf(),
            source,
            ready: VecDeque::new(),
            open: None,
            seen: HashSet::new(),
            ended: false,
        })
    }

    /// Returns the share of the file that has been read, 0 to 1.
    pub fn share(&self) -> f64 {
        match &self.source {
            Source::Csv(rows) => rows.share(),
            Source::Parquet(rows) => rows.share(),
        }
    }

    /// Returns the next spectrum; `None` at the end.
    ///
    /// # Errors
    /// [`BatchError`] if the file cannot be read further or the rows of a spectrum are not
    /// contiguous. An error of a single spectrum is returned in place of that spectrum.
    pub fn next_spectrum(&mut self) -> Result<Option<TableSpectrum>, BatchError> {
        while self.ready.is_empty() && !self.ended {
            match self.source.next()? {
                Some(rows) => self.take(&rows)?,
                None => {
                    self.ended = true;
                    self.close();
                }
            }
        }
        Ok(self.ready.pop_front())
    }

    fn take(&mut self, rows: &Rows) -> Result<(), BatchError> {
        let stem = self.path.file_stem();
        let stem = stem.map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        for row in 0..rows.len() {
            let id = rows.ids.get(row).unwrap_or(&stem);
            if self
                .open
                .as_ref()
                .is_none_or(|open| open.spectrum_id != *id)
            {
                self.close();
                self.begin(id, rows.first + row)?;
            }
            if let Some(open) = &mut self.open {
                match rows.refused.get(&row) {
                    Some(reason) => {
                        let reason = format!("{}, {reason}", self.path.display());
                        open.refused.get_or_insert(reason);
                    }
                    None => open.points.push(point(rows, row)),
                }
            }
        }
        Ok(())
    }

    fn begin(&mut self, id: &str, row: usize) -> Result<(), BatchError> {
        if !self.seen.insert(id.to_owned()) {
            return Err(BatchError::Row {
                path: self.path.clone(),
                place: place(self.source.kind(), row),
                expected: "the rows of each spectrum one after another",
                met: format!("spectrum_id {id:?} again"),
            });
        }
        self.open = Some(Open {
            spectrum_id: id.to_owned(),
            points: Vec::new(),
            refused: None,
        });
        Ok(())
    }

    fn close(&mut self) {
        let Some(open) = self.open.take() else { return };
        let spectrum = match open.refused {
            Some(reason) => Err(reason),
            None => spectrum(&open.spectrum_id, open.points),
        };
        self.ready.push_back(TableSpectrum {
            spectrum_id: open.spectrum_id,
            spectrum,
        });
    }
}

fn spectrum(name: &str, points: Vec<ImpedancePoint>) -> Result<SourcedSpectrum, String> {
    let mut spectrum = Spectrum {
        name: name.to_owned(),
        points,
        ..Spectrum::default()
    };
    spectrum.sort();
    spectrum.validate().map_err(|error| error.to_string())?;
    Ok(SourcedSpectrum {
        origin: Origin::default(),
        spectrum,
        flagged: Vec::new(),
    })
}

fn point(rows: &Rows, row: usize) -> ImpedancePoint {
    let needed = |column| rows.number(column, row).unwrap_or(f64::NAN);
    let known = |column: usize| {
        rows.number(NEEDED.len() + column, row)
            .filter(|value| !value.is_nan())
    };
    let covariance = match (known(0), known(1), known(2)) {
        (_, Some(re), Some(im)) => Covariance2 {
            re_re: re * re,
            im_im: im * im,
            re_im: known(3).unwrap_or(0.0),
        },
        (Some(sigma), _, _) => Covariance2::circular(sigma * sigma),
        _ => Covariance2::UNKNOWN,
    };
    ImpedancePoint {
        freq_hz: needed(0),
        z_ohm: Complex64::new(needed(1), needed(2)),
        covariance,
        amplitude_a: known(4).unwrap_or(f64::NAN),
    }
}
