//! Binary files of potentiostats and spreadsheets: files of other programs, truncated and damaged
//! ones.

use super::{FormatError, names, parse_file};
use crate::formats::{SeriesOptions, read_series};
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;
use proptest::prelude::*;
use std::path::{Path, PathBuf};

fn fixture(name: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/data")).join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(fixture(name)).unwrap()
}

fn numbers(spectrum: &Spectrum) -> Vec<(f64, Complex64)> {
    spectrum
        .points
        .iter()
        .map(|p| (p.freq_hz, p.z_ohm))
        .collect()
}

fn one(name: &str) -> Spectrum {
    let mut read = parse_file(&fixture(name), &bytes(name)).unwrap();
    assert_eq!(read.spectra.len(), 1, "{name}");
    read.spectra.remove(0).spectrum
}

#[test]
fn a_binary_file_of_ec_lab_holds_what_its_text_does() {
    let (binary, text) = (
        one("spectra/vendors/biologic.mpr"),
        one("spectra/vendors/biologic.mpt"),
    );
    assert_eq!(binary.points.len(), text.points.len());
    for (a, b) in binary.points.iter().zip(&text.points) {
        // Single precision in the binary, eight digits in the text.
        assert!((a.freq_hz / b.freq_hz - 1.0).abs() < 1e-7);
        assert!((a.z_ohm - b.z_ohm).norm() < 1e-7 * b.z_ohm.norm());
    }
}

#[test]
fn a_column_of_unknown_width_has_what_the_others_leave() {
    let mut file = bytes("spectra/vendors/biologic.mpr");
    let expected = one("spectra/vendors/biologic.mpr");
    let data = file
        .windows(8)
        .position(|eight| eight == b"VMP data")
        .unwrap();
    // Replace the twelfth column, `Cp/µF` of four bytes, by an unknown one.
    let columns = data + 35 + 16 + 5;
    let place = (columns..columns + 40)
        .step_by(2)
        .find(|at| file[*at..at + 2] == 172_u16.to_le_bytes())
        .unwrap();
    file[place..place + 2].copy_from_slice(&999_u16.to_le_bytes());
    let read = parse_file(Path::new("biologic.mpr"), &file).unwrap();
    assert_eq!(numbers(&read.spectra[0].spectrum), numbers(&expected));
    // The widths of two unknown columns cannot be determined.
    file[columns + 4..columns + 6].copy_from_slice(&998_u16.to_le_bytes());
    let met = parse_file(Path::new("b.mpr"), &file)
        .unwrap_err()
        .to_string();
    assert!(
        met.starts_with("b.mpr: expected an EC-Lab .mpr that can be decoded: records of")
            && met.contains("[998, 999] are not known"),
        "{met}"
    );
}

#[test]
fn a_binary_file_of_zahner_is_the_sweep_from_the_highest_frequency_down() {
    let path = fixture("spectra/vendors/zahner.ism");
    let read = parse_file(&path, &bytes("spectra/vendors/zahner.ism")).unwrap();
    assert_eq!(
        read.notes,
        [
            "zahner.ism: 4 points outside the sweep from the highest to the lowest frequency, which \
             are measured twice, are left out"
        ]
    );
    let points = &read.spectra[0].spectrum.points;
    assert_eq!(points.len(), 13);
    for point in points {
        let omega = std::f64::consts::TAU * point.freq_hz;
        let branch = 0.02 / Complex64::new(1.0, omega * 0.02 * 1.5);
        let expected = 0.012 + branch + Complex64::new(0.0, omega * 2e-8);
        assert!((point.z_ohm - expected).norm() < 1e-12 * expected.norm());
    }
}

#[test]
fn workbooks_of_cyclers_are_read_by_their_sheets() {
    let series = |name: &str| read_series(&fixture(name), &SeriesOptions::default()).unwrap();
    let neware = series("series/neware.xlsx");
    assert_eq!(neware.time_s, [0.5, 10.5, 20.5, 30.5, 40.5]);
    assert_eq!(neware.current_a, [1.5; 5]);
    let arbin = series("series/arbin.xlsx");
    assert_eq!(
        arbin.time_s,
        [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0]
    );
    assert_eq!(arbin.voltage_v[7], 3.67);
    let met = parse_file(Path::new("arbin.xlsx"), &bytes("series/arbin.xlsx"))
        .unwrap_err()
        .to_string();
    assert!(
        met.contains("arbin.xlsx [Channel_1_2], line 1") && met.contains("that of time series"),
        "{met}"
    );
}

#[test]
fn a_workbook_of_spectra_names_its_sheets() {
    let read = parse_file(
        Path::new("a/sheets.xlsx"),
        &bytes("spectra/vendors/sheets.xlsx"),
    )
    .unwrap();
    assert_eq!(
        names(&read.spectra),
        ["sheets.xlsx#10 degC", "sheets.xlsx#25 degC"]
    );
    assert_eq!(
        read.spectra[1].spectrum.points[0].z_ohm,
        Complex64::new(0.02, 0.0)
    );
    assert_eq!(read.notes, ["sheets.xlsx: 2 spectra, separated by sheets"]);
}

#[test]
fn a_file_that_was_cut_off_is_refused_or_less() {
    for name in ["spectra/vendors/biologic.mpr", "spectra/vendors/zahner.ism"] {
        let whole = bytes(name);
        let ended = parse_file(&fixture(name), &whole)
            .unwrap()
            .spectra
            .remove(0);
        for length in 0..whole.len() {
            match parse_file(&fixture(name), &whole[..length]) {
                // Zahner's file contains remarks after its points.
                Ok(read) => {
                    let read = numbers(&read.spectra[0].spectrum);
                    assert_eq!(read, numbers(&ended.spectrum), "{name} {length}");
                }
                Err(error) => assert!(!matches!(error, FormatError::Read { .. })),
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn damaged_files_end_in_an_error_or_in_spectra(
        which in 0_usize..4,
        places in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let name = [
            "spectra/vendors/biologic.mpr",
            "spectra/vendors/zahner.ism",
            "spectra/vendors/sheets.xlsx",
            "series/arbin.xlsx",
        ][which];
        let mut damaged = bytes(name);
        for (place, byte) in places {
            let at = place.index(damaged.len());
            damaged[at] = byte;
        }
        if let Ok(read) = parse_file(&fixture(name), &damaged) {
            prop_assert!(!read.spectra.is_empty());
        }
    }
}

#[test]
fn a_structure_of_matlab_is_a_record() {
    let path = fixture("series/meas.mat");
    let read = read_series(&path, &SeriesOptions::default()).unwrap();
    assert_eq!(read.time_s.len(), 50);
    // Discharge is negative in the file.
    assert_eq!(
        (read.time_s[3], read.current_a[3], read.voltage_v[3]),
        (1.5, 1.5, 3.6985)
    );
    assert_eq!(read.temperature_degc.unwrap()[2], 25.01);
    let whole = bytes("series/meas.mat");
    let folder = tempfile::tempdir().unwrap();
    let cut = folder.path().join("cut.mat");
    for length in (0..whole.len()).step_by(7) {
        std::fs::write(&cut, &whole[..length]).unwrap();
        assert!(
            read_series(&cut, &SeriesOptions::default()).is_err(),
            "{length}"
        );
    }
}

/// A file of EC-Lab before 11.50 with these columns and records.
fn mpr(ids: &[u16], records: &[Vec<u8>]) -> Vec<u8> {
    let mut data = u32::try_from(records.len()).unwrap().to_le_bytes().to_vec();
    data.push(u8::try_from(ids.len()).unwrap());
    data.extend(ids.iter().flat_map(|id| id.to_le_bytes()));
    data.resize(405, 0);
    data.extend(records.concat());
    let mut file = b"BIO-LOGIC MODULAR FILE\x1a".to_vec();
    file.resize(52, 0);
    file.extend(b"MODULE");
    file.extend(format!("{:<10}{:<25}", "VMP data", "VMP data").bytes());
    file.extend(u32::try_from(data.len()).unwrap().to_le_bytes());
    file.extend(2_u32.to_le_bytes());
    file.extend(b"01/01/24");
    file.extend(data);
    file
}

#[test]
fn battery_techniques_of_ec_lab_have_a_current() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mpr");
    // GCPL: 20 rows at rest, then 2 A out; charge since the previous row in mAh, every half second.
    let amps = |k: i32| if k < 20 { 0.0 } else { -2.0 };
    let gcpl = (0..40).map(|k| {
        let dq: f64 = amps(k) * 1e3 * 0.5 / 3600.0;
        let volts: f32 = if k < 20 { 3.7 } else { 3.6 };
        let mut record = vec![1];
        record.extend((0.5 * f64::from(k)).to_le_bytes());
        record.extend(dq.to_le_bytes());
        record.extend(volts.to_le_bytes());
        record
    });
    std::fs::write(&path, mpr(&[1, 4, 23, 6], &gcpl.collect::<Vec<_>>())).unwrap();
    let read = read_series(&path, &SeriesOptions::default()).unwrap();
    assert_eq!(read.len(), 40);
    assert!(
        (read.current_a[10], read.current_a[30]) == (0.0, 2.0),
        "{:?}",
        read.current_a
    );
    // OCV: mode 3, no current.
    let ocv = |mode: u8| {
        let of = |k: i32| {
            let mut record = vec![mode];
            record.extend(f64::from(k).to_le_bytes());
            record.extend(3.7_f32.to_le_bytes());
            record
        };
        mpr(&[1, 4, 6], &(0..20).map(of).collect::<Vec<_>>())
    };
    std::fs::write(&path, ocv(3)).unwrap();
    let read = read_series(&path, &SeriesOptions::default()).unwrap();
    assert!(read.len() == 20 && read.current_a.iter().all(|a| *a == 0.0));
    std::fs::write(&path, ocv(1)).unwrap();
    let refused = read_series(&path, &SeriesOptions::default())
        .unwrap_err()
        .to_string();
    assert!(refused.contains("without a current"), "{refused}");
}

/// A `.zmx` with tables of a modulus in Ω and a phase in rad for each of these impedances.
fn zmx(signals: &[&str], unit: &str) -> String {
    let columns = |one: &str| format!(";{one}").repeat(signals.len());
    let mut table = format!("frequency;time{}\n", columns("|impedance|;phase"));
    table += &format!("Hz;s{}\n", columns(&format!("{unit};rad")));
    let named: String = signals.iter().map(|one| format!(";{one};{one}")).collect();
    table += &format!(";{named}\n");
    for (k, freq) in [100, 300, 1000, 100, 10, 1].iter().enumerate() {
        let values: String = (1..=signals.len())
            .map(|n| format!(";{}.{k};-0.{n}", 10 * n))
            .collect();
        table += &format!("{freq};{k}{values}\n");
    }
    format!(
        "<?xml version=\"1.0\"?>\n<zahner-measurement>\n <csv type=\"wave\"><![CDATA[\nt;x\n]]></csv>\n \
         <csv type=\"data\"><![CDATA[\n{table}]]></csv>\n</zahner-measurement>\n"
    )
}

#[test]
fn a_measurement_of_zahners_im7_is_a_spectrum_for_each_impedance() {
    let parsed = |text: &str| parse_file(Path::new("a.zmx"), text.as_bytes());
    let one = parsed(&zmx(&["voltage/current"], "Ω")).unwrap();
    assert_eq!(names(&one.spectra), ["a"]);
    assert_eq!(
        one.notes,
        [
            "a.zmx: 2 points outside the sweep from the highest to the lowest frequency, which are \
          measured twice, are left out"
        ]
    );
    let points = &one.spectra[0].spectrum.points;
    assert_eq!(points.len(), 4);
    let expected = Complex64::from_polar(10.2, -0.1);
    assert_eq!(points[3].freq_hz, 1000.0);
    assert!(
        (points[3].z_ohm - expected).norm() < 1e-12,
        "{:?}",
        points[3]
    );
    let two = parsed(&zmx(&["7:U~9:A/7:I~9:B", "8:CH4~9:C/7:I~9:B"], "mΩ")).unwrap();
    assert_eq!(
        names(&two.spectra),
        ["a.zmx#7:U per 7:I", "a.zmx#8:CH4 per 7:I"]
    );
    let z = two.spectra[1].spectrum.points[0].z_ohm;
    assert!(
        (z - Complex64::from_polar(0.0205, -0.2)).norm() < 1e-12,
        "{z}"
    );
    for (text, message) in [
        (zmx(&["a/b"], ""), "the impedance a per b has no unit"),
        (
            zmx(&["a/b"], "Ω").replace("10.2", "1O.2"),
            "row 3, field 3: expected a number, met \"1O.2\"",
        ),
        (
            zmx(&["a/b"], "Ω").replace("]]></csv>\n</", "</"),
            "has no end",
        ),
        (
            zmx(&["a/b"], "Ω").replace("|impedance|", "gain"),
            "no table of it holds an impedance",
        ),
        (
            zmx(&["a/b"], "Ω").replace("phase", "drift"),
            "a modulus is not followed by a phase",
        ),
    ] {
        let met = parsed(&text).unwrap_err().to_string();
        assert!(
            met.starts_with("a.zmx: expected a Zahner .zmx") && met.contains(message),
            "{met}"
        );
    }
}

#[test]
fn parquet_whose_pages_are_damaged_is_refused() {
    let mut file = bytes("series/landt.bdf.parquet");
    // Lengths within two pages, at which the decoder panics.
    (file[1731], file[3312]) = (0, 28);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.parquet");
    std::fs::write(&path, file).unwrap();
    let refused = read_series(&path, &SeriesOptions::default()).unwrap_err();
    assert!(
        refused.to_string().contains("its pages are damaged"),
        "{refused}"
    );
}
