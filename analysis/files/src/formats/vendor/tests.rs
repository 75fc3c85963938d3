//! Files of other programs, and synthetic lists.

use crate::formats::{read_sourced, read_spectra};
use analysis_signal::spectrum::ImpedancePoint;
use num_complex::Complex64;
use std::path::PathBuf;

fn fixture(name: &str) -> PathBuf {
    PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../fixtures/data/spectra/vendors"
    ))
    .join(name)
}

#[test]
fn files_of_others_are_read() {
    // Provenance beside the files; the numbers are the first and the last row of each by rising
    // frequency.
    for (name, points, first, last) in [
        (
            "gamry.DTA",
            8,
            (39_984.37, 2_982.016, -1_407.856),
            (200_015.6, 825.858_4, -1_367.239),
        ),
        (
            "biologic.mpt",
            4,
            (456.314_09, 66.016_418, -1.164_106_8),
            (1_000.320_1, 65.470_886, -0.389_989_79),
        ),
        (
            "zplot.z",
            6,
            (94_868.33, 155.62, -52.177),
            (300_000.0, 147.77, -11.335),
        ),
        (
            "autolab.txt",
            8,
            (1333.5, 0.014_190_365_264_954_8, -0.000_865_948_762_311_971),
            (10_000.0, 0.013_785_863_964_281, 0.007_191_946_305_823),
        ),
    ] {
        let spectra = read_spectra(&fixture(name)).unwrap();
        let [spectrum] = spectra.as_slice() else {
            panic!("{name}: {} spectra", spectra.len())
        };
        let end = |point: &ImpedancePoint| (point.freq_hz, point.z_ohm.re, point.z_ohm.im);
        assert_eq!(
            (
                spectrum.points.len(),
                end(&spectrum.points[0]),
                end(&spectrum.points[points - 1])
            ),
            (points, first, last),
            "{name}"
        );
    }
}

#[test]
fn every_file_beside_them_is_read_and_has_its_row() {
    let rows = std::fs::read_to_string(fixture("README.md")).unwrap();
    for entry in std::fs::read_dir(fixture("")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if name == "README.md" {
            continue;
        }
        assert!(
            rows.contains(&format!("| `{name}` | ")),
            "README.md beside {name}: expected a row with its source and licence"
        );
        assert!(!read_spectra(&path).unwrap().is_empty(), "{name}");
    }
}

#[test]
fn lists_of_modulus_and_phase_are_read_and_cycles_distinguished() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("list.txt");
    std::fs::write(
        &path,
        "Number   Frequency/Hz   Impedance/Ohm   Phase/deg\n1  10  2  -90\n2  1  4  180\n\nend\n",
    )
    .unwrap();
    let points = read_spectra(&path).unwrap().remove(0).points;
    assert!(
        (points[0].z_ohm - Complex64::new(-4.0, 0.0)).norm() < 1e-12
            && (points[1].z_ohm - Complex64::new(0.0, -2.0)).norm() < 1e-12
    );
    std::fs::write(
        &path,
        "freq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\tcycle number\n0\t1\t1\t1\n5\t1\t2\t1\n5\t3\t4\t2\n",
    )
    .unwrap();
    let spectra = read_sourced(&path).unwrap();
    let cycles: Vec<_> = spectra
        .iter()
        .map(|s| (s.spectrum.name.as_str(), s.spectrum.points[0].z_ohm))
        .collect();
    assert_eq!(
        cycles,
        [
            ("list.txt#cycle1", Complex64::new(1.0, -2.0)),
            ("list.txt#cycle2", Complex64::new(3.0, -4.0))
        ]
    );
}

#[test]
fn wrong_numbers_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.z");
    let message = |text: &str| {
        std::fs::write(&path, text).unwrap();
        read_spectra(&path)
            .unwrap_err()
            .to_string()
            .replace(&path.display().to_string(), "x.z")
    };
    assert_eq!(
        message("Freq(Hz)\tZ'(a)\tZ''(b)\n1\t2\tno\n"),
        "x.z, line 2, column 3 (Im Z): expected a finite number in Ω, met \"no\""
    );
    assert_eq!(
        message("Freq(Hz)\tZ'(a)\tZ''(b)\n-1\t2\t3\n"),
        "x.z, line 2, column 1 (frequency): expected a positive finite frequency in Hz, met \"-1\""
    );
    assert_eq!(
        message("Freq(Hz)\tZ'(a)\tZ''(b)\n1\t2\n"),
        "x.z, line 2, column 3: expected 3 fields, met 2"
    );
    let header = "Freq(Hz)\tZ'(a)\tZ''(b)\n";
    for (rows, place) in [
        (
            "Hz\tOhm\tOhm\n1\t2\t3\n1O\t2\t3\n4\t2\t3\n",
            "line 4, column 1 (frequency): expected a positive finite frequency in Hz, met \"1O\"",
        ),
        (
            "1.00,5\t2\t3\n4\t2\t3\n",
            "line 2, column 1 (frequency): expected a positive finite frequency in Hz, \
            met \"1.00,5\"",
        ),
        (
            "1\t2\t3\nnote\n4\t2\t3\n",
            "line 3, column 1 (frequency): expected a frequency in Hz, or no further rows behind \
            the end of the table, met \"note\"",
        ),
    ] {
        assert_eq!(message(&format!("{header}{rows}")), format!("x.z, {place}"));
    }
    for rows in [
        "1\t2\t3\n\n4\t2\t3\nend\n",
        "1\t2\t3\n\t\t\n4\t2\t3\nEXPERIMENTABORTED\tTOGGLE\tT\n7\t2\t3\n",
    ] {
        std::fs::write(&path, format!("{header}{rows}")).unwrap();
        assert_eq!(
            read_spectra(&path).unwrap().remove(0).points.len(),
            2,
            "{rows}"
        );
    }
    let empty = "x.z: expected at least one line with a frequency and an impedance, met the names \
    of columns and no row of numbers";
    assert_eq!(message("Freq(Hz)\tZ'(a)\tZ''(b)\n"), empty);
}

/// An export of Digatron's impedance meter, with the columns that public readers of it use.
const DIGATRON: &str = "\
Measurement ID;3541
Battery Name;cell 7

Time Stamp;Step;Status;Prog Time;Voltage;Current;AhAccu;Temp45;ActFreq;Zreal1;Zimg1;Betrag;Phase
;;;h;V;A;Ah;C;Hz;;;;
01.06.2017 10:00:00;7;EIS;00:00:01.000;3.6635;0.00;-1.45;26.8;0;0;0;0;0
01.06.2017 10:00:02;7;EIS;00:00:02.000;3.6635;0.00;-1.45;26.8;1000;20.9;0.9;20.9;2.4
01.06.2017 10:00:03;7;EIS;00:00:03.000;3.6635;0.00;-1.45;26.8;1000;21.0;1.0;21.0;2.7
01.06.2017 10:00:04;7;EIS;00:00:04.000;3.6635;0.00;-1.45;26.8;100;23.5;-1.5;23.5;-3.6
01.06.2017 10:00:05;7;EIS;00:00:05.000;3.6635;0.00;-1.45;26.8;10;28.0;-3.0;28.2;-6.1
";

#[test]
fn digatrons_spectra_are_in_milliohms_and_count_once_per_frequency() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("3541_EIS00001.csv");
    std::fs::write(&path, DIGATRON).unwrap();
    let read = crate::formats::read_file(&path).unwrap();
    let [spectrum] = read.spectra.as_slice() else {
        panic!("{:?}", read.notes)
    };
    let points = &spectrum.spectrum.points;
    assert_eq!(points.len(), 3);
    let met = points[2].z_ohm;
    assert!((met - Complex64::new(0.021, 0.001)).norm() < 1e-12, "{met}");
    let notes = read.notes.join("; ");
    assert!(
        notes.contains("taken in mΩ") && notes.contains("1 rows are left out"),
        "{notes}"
    );
    assert!(crate::formats::names_a_spectrum(&path));
    std::fs::write(&path, DIGATRON.replace("Hz;;;", "Hz;Ohm;Ohm;")).unwrap();
    let ohms = crate::formats::read_file(&path).unwrap();
    assert_eq!(ohms.spectra[0].spectrum.points[0].z_ohm.re, 28.0);
}
