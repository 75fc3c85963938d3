//! Spectra in BDF, there and back.

use std::path::Path;

use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{
    FlaggedPoint, ImpedancePoint, OcvSlope, Origin, SharedError, SourcedSpectrum, Spectrum,
};
use num_complex::Complex64;
use polars::prelude::{DataFrame, NamedFrom, ParquetWriter, Series};

use super::super::{FileSpectra, parse_file, read_file};
use super::{
    bdf_metadata_path, bdf_metadata_text, bdf_spectrum_text, read_bdf_metadata,
    write_bdf_spectrum_parquet,
};

fn point(freq_hz: f64, re: f64, im: f64) -> ImpedancePoint {
    ImpedancePoint {
        freq_hz,
        z_ohm: Complex64::new(re, im),
        covariance: Covariance2::UNKNOWN,
        amplitude_a: f64::NAN,
    }
}

fn plain() -> SourcedSpectrum {
    let points = vec![
        point(0.1, 0.01 / 3.0, -1e-3),
        point(1.0 / 7.0, 0.003, -2e-17),
        point(100.0, 0.002, 1e-4),
    ];
    SourcedSpectrum {
        origin: Origin::default(),
        spectrum: Spectrum::new("a cell, at 10 °C", points),
        flagged: Vec::new(),
    }
}

/// A spectrum with all that the project knows of one.
fn whole() -> SourcedSpectrum {
    let mut one = plain();
    for (k, point) in (1..).zip(&mut one.spectrum.points) {
        let sigma = 1e-5 * f64::from(k);
        point.covariance = Covariance2 {
            re_re: sigma * sigma,
            im_im: 4.0 * sigma * sigma,
            re_im: -sigma * sigma,
        };
    }
    one.spectrum.points[1].amplitude_a = 2.5;
    let at_ohm = [1e-6, 2e-6, -3e-6]
        .map(|re| Complex64::new(re, -re))
        .to_vec();
    one.spectrum.shared = vec![SharedError {
        name: "harness".to_owned(),
        at_ohm,
    }];
    one.spectrum.less = Some(OcvSlope {
        v_per_coulomb: 1e-5,
        sigma_v_per_coulomb: 1e-6,
    });
    one.flagged = vec![FlaggedPoint {
        freq_hz: 100.0,
        reasons: vec!["drift 3 mV".to_owned(), "clipped".to_owned()],
    }];
    one.origin = Origin {
        fixture: Some("cell".to_owned()),
        cell: Some("B12".to_owned()),
        repeat: Some("3".to_owned()),
        bias_a: Some(-0.5),
        curve: None,
    };
    one
}

fn written(folder: &Path, one: &SourcedSpectrum) -> std::path::PathBuf {
    let path = folder.join("x.bdf.csv");
    std::fs::write(&path, bdf_spectrum_text(one)).unwrap();
    std::fs::write(bdf_metadata_path(&path), bdf_metadata_text(one, None)).unwrap();
    path
}

fn only(mut read: FileSpectra) -> SourcedSpectrum {
    assert_eq!(read.spectra.len(), 1, "{:?}", read.notes);
    read.spectra.remove(0)
}

/// Compares all numbers and metadata. The square of a root may differ in its last bit.
fn is_same(back: &SourcedSpectrum, put: &SourcedSpectrum) {
    assert_eq!(back.origin, put.origin);
    assert_eq!(back.flagged, put.flagged);
    let (back, put) = (&back.spectrum, &put.spectrum);
    assert_eq!(
        (&back.name, &back.shared, back.less),
        (&put.name, &put.shared, put.less)
    );
    assert_eq!(back.points.len(), put.points.len());
    for (back, put) in back.points.iter().zip(&put.points) {
        assert_eq!((back.freq_hz, back.z_ohm), (put.freq_hz, put.z_ohm));
        assert_eq!(back.amplitude_a.to_bits(), put.amplitude_a.to_bits());
        let (a, b) = (back.covariance, put.covariance);
        for (a, b) in [(a.re_re, b.re_re), (a.im_im, b.im_im), (a.re_im, b.re_im)] {
            assert!(
                a.is_nan() && b.is_nan() || (a / b - 1.0).abs() < 1e-14,
                "{a} {b}"
            );
        }
    }
}

#[test]
fn a_spectrum_comes_back_from_csv_with_all_that_is_known_of_it() {
    let folder = tempfile::tempdir().unwrap();
    for one in [plain(), whole()] {
        is_same(
            &only(read_file(&written(folder.path(), &one)).unwrap()),
            &one,
        );
    }
    let text = bdf_spectrum_text(&plain());
    let head = "Frequency / Hz,Real Impedance / ohm,Imaginary Impedance / ohm,Absolute Impedance / \
                ohm,Phase / deg\n100.0";
    assert!(
        text.starts_with(&head.replace("\n100.0", "\n0.1,0.0033")),
        "{text}"
    );
}

#[test]
fn metadata_describe_the_columns_that_bdf_has_no_name_for() {
    let read: serde_json::Value = serde_json::from_str(&bdf_metadata_text(&whole(), None)).unwrap();
    let dataset = &read["battinfo_dataset"]["dataset"];
    assert_eq!(dataset["name"], "a cell, at 10 °C");
    let described: Vec<(&str, &str)> = dataset["variable_measured"]
        .as_array()
        .unwrap()
        .iter()
        .map(|one| {
            (
                one["name"].as_str().unwrap(),
                one["unit_text"].as_str().unwrap(),
            )
        })
        .collect();
    let expected = [
        ("sigma_re_ohm", "ohm"),
        ("sigma_im_ohm", "ohm"),
        ("cov_re_im_ohm2", "ohm^2"),
        ("amplitude_a", "A"),
        ("shared_re_ohm[harness]", "ohm"),
        ("shared_im_ohm[harness]", "ohm"),
        ("flags", "1"),
    ];
    assert_eq!(described, expected);
    // Each is a column, and each column that BDF does not name is described.
    let text = bdf_spectrum_text(&whole());
    let header: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    assert_eq!(header[5..], expected.map(|(name, _)| name));
    let plain: serde_json::Value =
        serde_json::from_str(&bdf_metadata_text(&plain(), None)).unwrap();
    assert_eq!(
        plain["battinfo_dataset"]["dataset"]["variable_measured"],
        serde_json::Value::Null
    );
}

#[test]
fn metadata_of_others_are_kept_and_their_column_that_is_not_written_is_not_described() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), &plain());
    let others = r#"{"battinfo_dataset": {"dataset": {"name": "theirs", "license": "CC-BY-4.0",
        "variable_measured": [{"name": "Thickness", "unit_text": "mm"},
        {"name": "Frequency", "unit_text": "Hz"}]}}, "raw": {"lab": 7}, "extras": {"theirs": 1}}"#;
    std::fs::write(bdf_metadata_path(&path), others).unwrap();
    let source = read_bdf_metadata(&path).unwrap().unwrap();
    assert_eq!(source.unread(), ["battinfo_dataset", "extras", "raw"]);
    let one = only(read_file(&path).unwrap());
    // The name of the data set is not the name of the spectrum.
    assert_eq!(one.spectrum.name, "x");
    let merged: serde_json::Value =
        serde_json::from_str(&bdf_metadata_text(&one, Some(&source))).unwrap();
    let dataset = &merged["battinfo_dataset"]["dataset"];
    assert_eq!(
        (&dataset["name"], &dataset["license"]),
        (&"theirs".into(), &"CC-BY-4.0".into())
    );
    assert_eq!(dataset["variable_measured"].as_array().unwrap().len(), 1);
    assert_eq!(merged["raw"]["lab"], 7);
    assert_eq!(merged["extras"]["theirs"], 1);
    assert_eq!(merged["extras"]["eis_bench"]["name"], "x");
}

#[test]
fn metadata_that_are_none_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), &plain());
    for (text, words) in [
        (
            "{",
            "x.bdf.metadata.json: expected metadata of BDF (JSON) that can be decoded: EOF",
        ),
        ("[1]", "expected an object of sections"),
        (r#"{"extras": 3}"#, "expected an object as extras"),
        (
            r#"{"battinfo_dataset": {"dataset": []}}"#,
            "an object as battinfo_dataset.dataset",
        ),
        (
            r#"{"extras": {"eis_bench": {"bias_a": "1 A"}}}"#,
            "extras.eis_bench: invalid type",
        ),
    ] {
        std::fs::write(bdf_metadata_path(&path), text).unwrap();
        let message = read_file(&path).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
    // As batterydf 0.1.0 names them.
    std::fs::remove_file(bdf_metadata_path(&path)).unwrap();
    let older = folder.path().join("x.bdf.csv.metadata.json");
    std::fs::write(&older, r#"{"extras": {"eis_bench": {"name": "B"}}}"#).unwrap();
    assert_eq!(only(read_file(&path).unwrap()).spectrum.name, "B");
}

#[test]
fn a_spectrum_comes_back_from_parquet() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.bdf.parquet");
    let mut one = whole();
    write_bdf_spectrum_parquet(&path, &one.spectrum).unwrap();
    std::fs::write(bdf_metadata_path(&path), bdf_metadata_text(&one, None)).unwrap();
    one.flagged.clear();
    one.spectrum.shared.clear();
    is_same(&only(read_file(&path).unwrap()), &one);
}

#[test]
fn parquet_of_others_with_several_spectra_is_read_under_both_names() {
    let machine = ["frequency_hertz", "absolute_impedance_ohm", "phase_degree"];
    let human = ["Frequency / Hz", "Absolute Impedance / ohm", "Phase / deg"];
    for names in [machine, human] {
        let mut frame = DataFrame::new_infer_height(vec![
            Series::new(
                "Unix Time / s".into(),
                [1.7e9, 1.7e9, 1.8e9, 1.8e9, 1.8e9, 1.8e9],
            )
            .into(),
            Series::new("EIS Index / 1".into(), [1u32, 1, 1, 2, 2, 2]).into(),
            Series::new(names[0].into(), [100.0f32, 10.0, 1.0, 100.0, 10.0, 1.0]).into(),
            Series::new(names[1].into(), [0.5, 1.0, 2.0, 1.5, 2.0, 4.0]).into(),
            Series::new(
                names[2].into(),
                [
                    Some(0.0),
                    Some(-90.0),
                    None,
                    Some(0.0),
                    Some(-90.0),
                    Some(180.0),
                ],
            )
            .into(),
        ])
        .unwrap();
        let mut bytes = Vec::new();
        ParquetWriter::new(&mut bytes).finish(&mut frame).unwrap();
        let within = |most| super::spectrum::parquet_within(Path::new("x"), &bytes, most).unwrap();
        assert!(within(30).is_ok());
        let refused = within(29).unwrap_err().to_string();
        assert!(
            refused.contains("it has 30 fields, and 29 are read"),
            "{refused}"
        );
        let read = parse_file(Path::new("x.bdf.parquet"), &bytes).unwrap();
        let names: Vec<&str> = read
            .spectra
            .iter()
            .map(|one| one.spectrum.name.as_str())
            .collect();
        assert_eq!(
            names,
            ["x.bdf.parquet#spectrum1", "x.bdf.parquet#spectrum2"]
        );
        // A point without a phase is not a point.
        let counts = read.spectra.iter().map(|one| one.spectrum.points.len());
        assert_eq!(counts.collect::<Vec<_>>(), [2, 3]);
        let z = read.spectra[1].spectrum.points[1].z_ohm;
        assert!((z - Complex64::new(0.0, -2.0)).norm() < 1e-12, "{z}");
    }
}

#[test]
fn a_modulus_that_is_not_of_its_parts_is_refused() {
    let text = bdf_spectrum_text(&whole());
    let wrong = text.lines().map(|line| {
        let fields: Vec<&str> = line.split(',').collect();
        let modulus = fields[3]
            .parse::<f64>()
            .map_or_else(|_| fields[3].to_owned(), |z| (1e3 * z).to_string());
        let rest = [&fields[..3], &[modulus.as_str()], &fields[4..]].concat();
        rest.join(",") + "\n"
    });
    let result = parse_file(Path::new("x.bdf.csv"), wrong.collect::<String>().as_bytes());
    let message = result.unwrap_err().to_string();
    assert!(message.contains("x.bdf.csv, line 2"), "{message}");
}
