//! Spectra as a table in long form.

use std::collections::HashMap;
use std::path::Path;

use polars::prelude::{Column, CsvWriter, DataFrame, ParquetWriter, SerWriter};

use analysis_signal::spectrum::{ImpedancePoint, Spectrum};

use super::columns::{ID, NEEDED, OPTIONAL};
use super::error::BatchError;
use crate::dataset::write_atomically;

/// Writes spectra as a table in long form, one row for each point, with the known uncertainties:
/// Parquet for a file named `.parquet`, else CSV. All numbers except the standard deviations, which
/// are roots of variances, round-trip exactly. The table cannot hold errors that points share or
/// the flags of a quality gate.
///
/// # Errors
/// [`BatchError`]: two spectra of one name, a name that CSV cannot hold, a file that cannot be
/// written.
pub fn write_long_form(path: &Path, spectra: &[Spectrum]) -> Result<(), BatchError> {
    let is_parquet = path.extension().is_some_and(|end| end == "parquet");
    check_names(path, spectra, is_parquet)?;
    let points = || spectra.iter().flat_map(|one: &Spectrum| &one.points);
    let known = |value: f64| Some(value).filter(|value| !value.is_nan());
    let optional = |name: &str, value: &dyn Fn(&ImpedancePoint) -> f64| {
        let values: Vec<Option<f64>> = points().map(|point| known(value(point))).collect();
        Column::new(name.into(), values)
    };
    let needed = |name: &str, value: &dyn Fn(&ImpedancePoint) -> f64| {
        Column::new(name.into(), points().map(value).collect::<Vec<f64>>())
    };
    let ids = spectra
        .iter()
        .flat_map(|one| std::iter::repeat_n(one.name.as_str(), one.points.len()));
    let [freq, re, im] = NEEDED;
    let [_, sigma_re, sigma_im, cov, amplitude] = OPTIONAL;
    let columns = vec![
        Column::new(ID.into(), ids.collect::<Vec<&str>>()),
        needed(freq, &|point| point.freq_hz),
        needed(re, &|point| point.z_ohm.re),
        needed(im, &|point| point.z_ohm.im),
        optional(sigma_re, &|point| point.covariance.re_re.sqrt()),
        optional(sigma_im, &|point| point.covariance.im_im.sqrt()),
        optional(cov, &|point| point.covariance.re_im),
        optional(amplitude, &|point| point.amplitude_a),
    ];
    let failed = |source| BatchError::Parquet {
        path: path.to_path_buf(),
        action: "write the table",
        source,
    };
    let mut frame = DataFrame::new(points().count(), columns).map_err(failed)?;
    let mut bytes = Vec::new();
    if is_parquet {
        let writer = ParquetWriter::new(&mut bytes);
        writer.finish(&mut frame).map_err(failed)?;
    } else {
        CsvWriter::new(&mut bytes)
            .finish(&mut frame)
            .map_err(failed)?;
    }
    Ok(write_atomically(path, &bytes)?)
}

fn check_names(path: &Path, spectra: &[Spectrum], is_parquet: bool) -> Result<(), BatchError> {
    let mut seen = HashMap::new();
    for (number, spectrum) in spectra.iter().enumerate() {
        let refused = |expected, met| BatchError::Row {
            path: path.to_path_buf(),
            place: format!("spectrum {}", number + 1),
            expected,
            met,
        };
        let name = &spectrum.name;
        if let Some(before) = seen.insert(name, number + 1) {
            let met = format!("{name:?}, which spectrum {before} is called, too");
            return Err(refused("another name for each spectrum", met));
        }
        if !is_parquet && name.contains([',', ';', '\t', '"', '\n', '\r']) {
            let expected = "a name without separators and quotes, or a table in Parquet";
            return Err(refused(expected, format!("{name:?}")));
        }
    }
    Ok(())
}
