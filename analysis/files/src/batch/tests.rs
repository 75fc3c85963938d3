//! Tables in long form as Parquet, and damaged ones.

use super::{BatchError, LongForm, TableSpectrum, write_long_form};
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use num_complex::Complex64;
use polars::prelude::{Column, DataFrame, ParquetWriter};
use std::fs::File;
use std::path::{Path, PathBuf};

fn write(path: &Path, columns: Vec<Column>) {
    let height = columns[0].len();
    let mut frame = DataFrame::new(height, columns).unwrap();
    ParquetWriter::new(File::create(path).unwrap())
        .with_row_group_size(Some(4))
        .finish(&mut frame)
        .unwrap();
}

fn numbers(name: &str, values: &[f64]) -> Column {
    Column::new(name.into(), values)
}

fn all(path: &Path) -> Result<Vec<TableSpectrum>, BatchError> {
    let mut table = LongForm::open(path)?;
    std::iter::from_fn(|| table.next_spectrum().transpose()).collect()
}

fn at(name: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    (folder, path)
}

#[test]
fn spectra_are_whole_across_row_groups_and_ids_may_be_numbers() {
    let (_kept, path) = at("t.parquet");
    write(
        &path,
        vec![
            Column::new("spectrum_id".into(), [7_i64, 7, 7, 9, 9, 9]),
            numbers("freq_hz", &[1.0, 10.0, 100.0, 100.0, 10.0, 1.0]),
            Column::new("z_re_ohm".into(), [3_i32, 2, 1, 1, 2, 3]),
            numbers("z_im_ohm", &[-0.1; 6]),
            numbers("sigma_re_ohm", &[0.1, 0.1, 0.1, f64::NAN, 0.1, 0.1]),
            numbers("sigma_im_ohm", &[0.2; 6]),
        ],
    );
    let met = all(&path).unwrap();
    let ids: Vec<&str> = met.iter().map(|one| one.spectrum_id.as_str()).collect();
    assert_eq!(ids, ["7", "9"]);
    let second = &met[1].spectrum.as_ref().unwrap().spectrum;
    let freqs: Vec<f64> = second.points.iter().map(|p| p.freq_hz).collect();
    assert_eq!(freqs, [1.0, 10.0, 100.0]);
    assert_eq!(second.points[0].z_ohm.re, 3.0);
    assert_eq!(second.points[0].covariance.re_re, 0.1_f64 * 0.1);
    assert_eq!(second.points[0].covariance.im_im, 0.2_f64 * 0.2);
    assert!(second.points[2].covariance.re_re.is_nan());
}

#[test]
fn a_missing_value_costs_its_spectrum_alone() {
    let (_kept, path) = at("t.parquet");
    write(
        &path,
        vec![
            Column::new("spectrum_id".into(), ["a", "a", "b", "b"]),
            numbers("freq_hz", &[1.0, 10.0, 1.0, 10.0]),
            Column::new("z_re_ohm".into(), [Some(1.0), None, Some(1.0), Some(2.0)]),
            numbers("z_im_ohm", &[0.0; 4]),
        ],
    );
    let met = all(&path).unwrap();
    let reason = met[0].spectrum.as_ref().unwrap_err();
    assert!(
        reason.ends_with("row 2: column z_re_ohm: expected a number, met none"),
        "{reason}"
    );
    assert!(met[1].spectrum.is_ok());
}

#[test]
fn columns_that_are_missing_or_texts_are_named() {
    let (_kept, path) = at("t.parquet");
    write(
        &path,
        vec![numbers("freq_hz", &[1.0]), numbers("z_re_ohm", &[1.0])],
    );
    let message = all(&path).unwrap_err().to_string();
    assert!(
        message.ends_with("expected a column z_im_ohm, met freq_hz, z_re_ohm"),
        "{message}"
    );
    write(
        &path,
        vec![
            numbers("freq_hz", &[1.0]),
            numbers("z_re_ohm", &[1.0]),
            Column::new("z_im_ohm".into(), ["-1"]),
        ],
    );
    let message = all(&path).unwrap_err().to_string();
    assert!(
        message.ends_with("expected a column z_im_ohm of numbers, met String"),
        "{message}"
    );
}

#[test]
fn damaged_bytes_are_refused_and_never_panic() {
    let (_kept, path) = at("t.parquet");
    let values: Vec<f64> = (1..200).map(f64::from).collect();
    write(
        &path,
        vec![
            numbers("freq_hz", &values),
            numbers("z_re_ohm", &values),
            numbers("z_im_ohm", &values),
        ],
    );
    let whole = std::fs::read(&path).unwrap();
    let mut refused = 0;
    for cut in (5..whole.len()).step_by(97) {
        std::fs::write(&path, &whole[..cut]).unwrap();
        refused += usize::from(all(&path).is_err());
    }
    assert_eq!(refused, (5..whole.len()).step_by(97).count());
}

#[test]
fn spectra_that_were_written_come_back_with_their_uncertainties() {
    let point = |freq_hz: f64, covariance| ImpedancePoint {
        freq_hz,
        z_ohm: Complex64::new(0.01 / 3.0, -0.1 / freq_hz),
        covariance,
        amplitude_a: 0.5,
    };
    let known = Covariance2 {
        re_re: 0.25,
        im_im: 4.0,
        re_im: -0.125,
    };
    let spectrum = |name: &str, covariance| Spectrum {
        name: name.to_owned(),
        points: vec![point(0.1, covariance), point(30.0, covariance)],
        ..Spectrum::default()
    };
    let put = [spectrum("a", known), spectrum("b#2", Covariance2::UNKNOWN)];
    for name in ["t.parquet", "t.csv"] {
        let (_kept, path) = at(name);
        write_long_form(&path, &put).unwrap();
        let back: Vec<Spectrum> = all(&path)
            .unwrap()
            .into_iter()
            .map(|one| one.spectrum.unwrap().spectrum)
            .collect();
        assert_eq!(back[0], put[0], "{name}");
        assert_eq!(back[1].name, "b#2");
        assert!(back[1].points[0].covariance.re_re.is_nan());
        assert_eq!(back[1].points[1].z_ohm, put[1].points[1].z_ohm);
    }
    let (_kept, path) = at("t.csv");
    let twice = [put[0].clone(), put[0].clone()];
    let met = write_long_form(&path, &twice).unwrap_err().to_string();
    assert!(
        met.contains("spectrum 2: expected another name for each spectrum"),
        "{met}"
    );
    let comma = [spectrum("a,b", known)];
    let met = write_long_form(&path, &comma).unwrap_err().to_string();
    assert!(met.contains("a name without separators"), "{met}");
    assert!(!path.exists());
}
