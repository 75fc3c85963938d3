//! Time series and spectra as BDF (Battery Data Format of the Battery Data Alliance): CSV and Parquet.
//! Currents are positive for charge, as cyclers write them.

mod metadata;
mod spectrum;
#[cfg(test)]
#[path = "bdf/tests.rs"]
mod spectrum_tests;

use std::fmt::Write as _;
use std::path::Path;

use crate::dataset::{self, ColumnSpec, DatasetError};
use analysis_signal::series::TimeSeries;
pub(super) use metadata::attach as attach_metadata;
pub use metadata::{BdfMetadata, bdf_metadata_path, bdf_metadata_text, read_bdf_metadata};
pub use spectrum::{bdf_spectrum_text, write_bdf_spectrum_parquet};
pub(super) use spectrum::{parquet_text, with_own_names};

const COLUMNS: [ColumnSpec; 4] = [
    ColumnSpec {
        name: "Test Time / s",
        unit: "s",
        doc: "time since the start of the test",
    },
    ColumnSpec {
        name: "Voltage / V",
        unit: "V",
        doc: "voltage of the cell",
    },
    ColumnSpec {
        name: "Current / A",
        unit: "A",
        doc: "current into the cell, charge positive",
    },
    ColumnSpec {
        name: "Surface Temperature T1 / degC",
        unit: "°C",
        doc: "temperature of the cell's surface",
    },
];

/// Returns a series as BDF CSV. Numbers round-trip exactly.
pub fn bdf_text(series: &TimeSeries) -> String {
    let columns = columns(series);
    let names: Vec<&str> = columns.iter().map(|(spec, _)| spec.name).collect();
    let mut text = names.join(",") + "\n";
    for row in 0..series.time_s.len() {
        for (place, (_, values)) in columns.iter().enumerate() {
            let comma = if place > 0 { "," } else { "" };
            // Writing to a string cannot fail.
            let _ = write!(
                text,
                "{comma}{:?}",
                values.get(row).copied().unwrap_or(f64::NAN)
            );
        }
        text.push('\n');
    }
    text
}

/// Writes a series as BDF Parquet.
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Parquet`].
pub fn write_bdf_parquet(path: &Path, series: &TimeSeries) -> Result<(), DatasetError> {
    let columns = columns(series);
    let borrowed: Vec<(ColumnSpec, &[f64])> = columns
        .iter()
        .map(|(spec, values)| (*spec, values.as_slice()))
        .collect();
    dataset::write_columns_parquet(path, &borrowed)
}

fn columns(series: &TimeSeries) -> Vec<(ColumnSpec, Vec<f64>)> {
    let current_a = series.current_a.iter().map(|amps| 0.0 - amps).collect();
    let lists = [
        Some(series.time_s.clone()),
        Some(series.voltage_v.clone()),
        Some(current_a),
        series.temperature_degc.clone(),
    ];
    COLUMNS
        .into_iter()
        .zip(lists)
        .filter_map(|(spec, values)| Some((spec, values?)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::{SeriesOptions, read_series};

    #[test]
    fn a_series_comes_back_from_both() {
        let series = TimeSeries {
            name: "x".to_owned(),
            time_s: vec![0.0, 0.1, 1.0 / 3.0],
            current_a: vec![0.0, 1.0 / 7.0, -2.5],
            voltage_v: vec![3.7, 3.65, 3.8],
            temperature_degc: Some(vec![25.0, 25.1, 25.2]),
        };
        let folder = tempfile::tempdir().unwrap();
        let (csv, parquet) = (
            folder.path().join("x.bdf.csv"),
            folder.path().join("x.bdf.parquet"),
        );
        std::fs::write(&csv, bdf_text(&series)).unwrap();
        write_bdf_parquet(&parquet, &series).unwrap();
        assert!(bdf_text(&series).starts_with(
            "Test Time / s,Voltage / V,Current / A,Surface \
        Temperature T1 / degC\n0.0,3.7,0.0,25.0\n"
        ));
        for path in [csv, parquet] {
            let back = read_series(&path, &SeriesOptions::default()).unwrap();
            assert_eq!(back.time_s, series.time_s);
            assert_eq!(
                (back.current_a, back.voltage_v, back.temperature_degc),
                (
                    series.current_a.clone(),
                    series.voltage_v.clone(),
                    series.temperature_degc.clone()
                )
            );
        }
    }
}
