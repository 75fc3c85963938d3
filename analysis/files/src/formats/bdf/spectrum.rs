//! Impedance in BDF: the columns that the standard has for spectra, as text and as Parquet.
//!
//! BDF defines frequency, real and imaginary part, modulus and phase. It has no columns for
//! uncertainties, the amplitude of the current and the remarks of a quality gate. These are written
//! to further columns under the project's own names, which the metadata beside the file describe.

use std::fmt::Write as _;
use std::path::Path;

use polars::prelude::{Column, DataFrame, DataType, ParquetReader, PolarsError, SerReader};

use super::super::error::FormatError;
use super::super::parquet;
use super::super::text;
use crate::dataset::{self, ColumnSpec, DatasetError, shared};
use analysis_signal::spectrum::{FlaggedPoint, ImpedancePoint, SourcedSpectrum, Spectrum};

/// Maximum number of fields of a Parquet file of spectra.
const MOST_FIELDS: usize = 50_000_000;
/// First bytes of Parquet.
const PARQUET: &[u8] = b"PAR1";

/// Names of a column of impedance: the preferred label, and the name for machines.
type Names = [&'static str; 2];
const FREQUENCY: Names = ["Frequency / Hz", "frequency_hertz"];
const REAL: Names = ["Real Impedance / ohm", "real_impedance_ohm"];
const IMAGINARY: Names = ["Imaginary Impedance / ohm", "imaginary_impedance_ohm"];
const MODULUS: Names = ["Absolute Impedance / ohm", "absolute_impedance_ohm"];
const PHASE: Names = ["Phase / deg", "phase_degree"];
/// The project's names for the first three.
const OWN: [(Names, &str); 3] = [
    (FREQUENCY, "freq_hz"),
    (REAL, "z_re_ohm"),
    (IMAGINARY, "z_im_ohm"),
];

/// Number of the columns that BDF has.
const STANDARD: usize = 5;
/// Columns of a spectrum: those of BDF, and further ones if a point has a value for them.
pub(super) const COLUMNS: [ColumnSpec; 9] = [
    ColumnSpec {
        name: FREQUENCY[0],
        unit: "Hz",
        doc: "frequency",
    },
    ColumnSpec {
        name: REAL[0],
        unit: "ohm",
        doc: "real part of the impedance",
    },
    ColumnSpec {
        name: IMAGINARY[0],
        unit: "ohm",
        doc: "imaginary part of the impedance, below zero for a capacitor",
    },
    ColumnSpec {
        name: MODULUS[0],
        unit: "ohm",
        doc: "modulus of the impedance",
    },
    ColumnSpec {
        name: PHASE[0],
        unit: "deg",
        doc: "phase of the impedance",
    },
    ColumnSpec {
        name: "sigma_re_ohm",
        unit: "ohm",
        doc: "standard deviation of the real part",
    },
    ColumnSpec {
        name: "sigma_im_ohm",
        unit: "ohm",
        doc: "standard deviation of the imaginary part",
    },
    ColumnSpec {
        name: "cov_re_im_ohm2",
        unit: "ohm^2",
        doc: "covariance of real and imaginary part",
    },
    ColumnSpec {
        name: "amplitude_a",
        unit: "A",
        doc: "amplitude of the current, zero to peak",
    },
];

/// A column that BDF does not define.
pub(super) struct Further {
    pub(super) name: String,
    pub(super) unit: &'static str,
    pub(super) doc: &'static str,
}

fn values(point: &ImpedancePoint) -> [f64; COLUMNS.len()] {
    let covariance = point.covariance;
    [
        point.freq_hz,
        point.z_ohm.re,
        point.z_ohm.im,
        point.z_ohm.norm(),
        point.z_ohm.arg().to_degrees(),
        covariance.re_re.sqrt(),
        covariance.im_im.sqrt(),
        covariance.re_im,
        point.amplitude_a,
    ]
}

/// Returns the columns of a spectrum that contain a value; those of BDF always.
fn filled(spectrum: &Spectrum) -> Vec<usize> {
    let holds = |column: &usize| {
        let known = |point| values(point)[*column].is_finite();
        *column < STANDARD || spectrum.points.iter().any(known)
    };
    (0..COLUMNS.len()).filter(holds).collect()
}

/// Returns the columns of a spectrum that BDF does not define, in CSV.
pub(super) fn further(sourced: &SourcedSpectrum) -> Vec<Further> {
    let spectrum = &sourced.spectrum;
    let own = filled(spectrum).into_iter().skip(STANDARD).map(|column| {
        let ColumnSpec { name, unit, doc } = COLUMNS[column];
        let name = name.to_owned();
        Further { name, unit, doc }
    });
    let (header, _) = shared::columns(spectrum);
    let of_shared = header.split(',').filter(|name| !name.is_empty());
    let of_shared = of_shared.map(|name| Further {
        name: name.to_owned(),
        unit: "ohm",
        doc: "deviation of the point by one standard deviation of an error that the points share",
    });
    let flags = (!sourced.flagged.is_empty()).then(|| Further {
        name: dataset::FLAGS.trim_start_matches(',').to_owned(),
        unit: "1",
        doc: "reasons for which a quality gate refused the point, as text",
    });
    own.chain(of_shared).chain(flags).collect()
}

/// Returns whether a description belongs to a column that BDF defines for spectra: by its label, or
/// the part of the label before the unit.
pub(super) fn is_standard(name: &str) -> bool {
    let of = |spec: &ColumnSpec| {
        let quantity = spec.name.split(" / ").next();
        spec.name == name || quantity == Some(name)
    };
    COLUMNS.iter().take(STANDARD).any(of)
}

/// Returns a spectrum as BDF CSV. Numbers round-trip exactly; unknown values are empty fields.
pub fn bdf_spectrum_text(sourced: &SourcedSpectrum) -> String {
    let spectrum = &sourced.spectrum;
    let columns = filled(spectrum);
    let (header, shared) = shared::columns(spectrum);
    let names: Vec<&str> = columns.iter().map(|k| COLUMNS[*k].name).collect();
    let is_flagged = !sourced.flagged.is_empty();
    let mut text = names.join(",") + &header;
    text.push_str(if is_flagged { dataset::FLAGS } else { "" });
    text.push('\n');
    for (point, shared) in spectrum.points.iter().zip(&shared) {
        let all = values(point);
        let fields: Vec<String> = columns.iter().map(|k| field(all[*k])).collect();
        text.push_str(&fields.join(","));
        text.push_str(shared);
        if is_flagged {
            text.push_str(&dataset::flag_field(&reasons(point, &sourced.flagged)));
        }
        text.push('\n');
    }
    text
}

fn field(value: f64) -> String {
    if value.is_nan() {
        String::new()
    } else {
        format!("{value:?}")
    }
}

fn reasons(point: &ImpedancePoint, flagged: &[FlaggedPoint]) -> String {
    let of_point = flagged.iter().filter(|one| one.freq_hz == point.freq_hz);
    let reasons: Vec<String> = of_point.flat_map(|one| one.reasons.clone()).collect();
    reasons.join("; ")
}

/// Writes a spectrum as BDF Parquet, without the errors that the points share and the remarks of a
/// quality gate.
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Parquet`].
pub fn write_bdf_spectrum_parquet(path: &Path, spectrum: &Spectrum) -> Result<(), DatasetError> {
    let of = |column: usize| -> Vec<f64> {
        let points = spectrum.points.iter();
        points.map(|point| values(point)[column]).collect()
    };
    let columns: Vec<(ColumnSpec, Vec<f64>)> = filled(spectrum)
        .into_iter()
        .map(|column| (COLUMNS[column], of(column)))
        .collect();
    let borrowed: Vec<(ColumnSpec, &[f64])> = columns
        .iter()
        .map(|(spec, values)| (*spec, values.as_slice()))
        .collect();
    dataset::write_columns_parquet(path, &borrowed)
}

fn find(fields: &[&str], names: Names) -> Option<usize> {
    let is = |field: &&str| names.iter().any(|name| name.eq_ignore_ascii_case(field));
    fields.iter().position(is)
}

/// Renames the columns of a BDF text to the project's names, if it has columns that only the
/// project defines.
pub(in crate::formats) fn with_own_names(text: &str) -> Option<String> {
    let (at, header) = text::lines(text).find(|(_, line)| !text::is_comment(line))?;
    let separator = text::separator(header);
    let mut fields: Vec<&str> = text::fields(header, separator).collect();
    let own = |field: &&str| {
        let further = COLUMNS.iter().skip(STANDARD).map(|spec| spec.name);
        let flags = dataset::FLAGS.trim_start_matches(',');
        field.starts_with(shared::RE) || further.chain([flags]).any(|name| name == *field)
    };
    if !fields.iter().any(own) {
        return None;
    }
    for (names, own) in OWN {
        let place = find(&fields, names)?;
        fields[place] = own;
    }
    let header = fields.join(&separator.to_string());
    let lines = (1..).zip(text.lines());
    let renamed = lines.map(|(number, line)| if number == at { header.as_str() } else { line });
    Some(renamed.collect::<Vec<_>>().join("\n"))
}

/// Returns the text of a Parquet file with the columns that BDF defines for spectra; `None` for any
/// other file.
///
/// # Errors
/// [`FormatError::Decode`] for a column that is neither numbers nor text.
pub(in crate::formats) fn parquet_text(
    path: &Path,
    bytes: &[u8],
) -> Option<Result<String, FormatError>> {
    parquet_within(path, bytes, MOST_FIELDS)
}

/// Like [`parquet_text`], with the maximum number of fields of the file.
pub(super) fn parquet_within(
    path: &Path,
    bytes: &[u8],
    most: usize,
) -> Option<Result<String, FormatError>> {
    if !bytes.starts_with(PARQUET) {
        return None;
    }
    let failed = |reason: String| FormatError::Decode {
        file: path.to_owned(),
        kind: "Parquet with columns of BDF",
        reason,
    };
    // A file that cannot be decoded is refused by its format.
    let mut reader = ParquetReader::new(std::io::Cursor::new(bytes));
    let schema = reader.schema().ok()?;
    let names: Vec<&str> = schema.iter_names().map(|name| name.as_str()).collect();
    let has = |pair: [Names; 2]| pair.iter().all(|one| find(&names, *one).is_some());
    let frequency = find(&names, FREQUENCY)?;
    if !has([REAL, IMAGINARY]) && !has([MODULUS, PHASE]) {
        return None;
    }
    // A file of some kilobytes can repeat a row arbitrarily often.
    let fields = reader.num_rows().ok()?.saturating_mul(names.len());
    if fields > most {
        return Some(Err(failed(format!(
            "it has {fields} fields, and {most} are read; write the rows of the spectrum alone"
        ))));
    }
    let read = parquet::decode(|| frame_text(&reader.finish()?, frequency));
    Some(read.map_err(failed))
}

/// Cells of a column.
enum Cells {
    Numbers(Vec<f64>),
    Words(Vec<String>),
}

/// Returns the text of the rows with a frequency.
fn frame_text(frame: &DataFrame, frequency: usize) -> Result<String, PolarsError> {
    let columns: Vec<Cells> = frame
        .columns()
        .iter()
        .map(cells)
        .collect::<Result<_, _>>()?;
    let names: Vec<&str> = frame
        .get_column_names()
        .iter()
        .map(|name| name.as_str())
        .collect();
    let mut text = names.join("\t") + "\n";
    for row in 0..frame.height() {
        let is_there = match columns.get(frequency) {
            Some(Cells::Numbers(numbers)) => !numbers[row].is_nan(),
            _ => true,
        };
        for (place, cells) in columns.iter().enumerate().filter(|_| is_there) {
            let tab = if place > 0 { "\t" } else { "" };
            // Writing to a string cannot fail.
            let _ = match cells {
                Cells::Numbers(numbers) => write!(text, "{tab}{}", field(numbers[row])),
                Cells::Words(words) => write!(text, "{tab}{}", words[row]),
            };
        }
        text.push('\n');
    }
    Ok(text)
}

fn cells(column: &Column) -> Result<Cells, PolarsError> {
    if column.dtype().is_primitive_numeric() {
        let floats = column.cast(&DataType::Float64)?;
        let floats = floats.f64()?.iter();
        return Ok(Cells::Numbers(
            floats.map(|value| value.unwrap_or(f64::NAN)).collect(),
        ));
    }
    let words = column.cast(&DataType::String)?;
    let plain = |word: Option<&str>| word.unwrap_or_default().replace(['\t', '\n', '\r'], " ");
    Ok(Cells::Words(words.str()?.iter().map(plain).collect()))
}
