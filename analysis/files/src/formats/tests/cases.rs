//! Small inputs that were read wrongly or refused for a wrong reason, with the correct values. They
//! are in `../shared/data/cases` beside the checkout; without it the tests are skipped.

use crate::formats::{ReadSeries, SeriesOptions, read_file, read_record};
use std::path::{Path, PathBuf};

fn case(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/cases");
    let path = folder.join(name);
    if !path.exists() {
        println!("skipped: {} is not available", path.display());
        return None;
    }
    Some(path)
}

/// The record of the cases: 60 s rest, 2 A discharge at 3.64 V, rest, 1.5 A charge.
fn is_record(name: &str) {
    let Some(path) = case(name) else { return };
    let read = read_record(&path, &SeriesOptions::default());
    let ReadSeries { series, notes, .. } = read.unwrap_or_else(|error| panic!("{name}: {error}"));
    println!("{name}: {} rows; {notes:?}", series.len());
    let at = |t: f64| {
        let row = series.time_s.iter().position(|time| (time - t).abs() < 0.1);
        let row =
            row.unwrap_or_else(|| panic!("{name}: no row at {t} s: {:?}", &series.time_s[..5]));
        (series.current_a[row], series.voltage_v[row])
    };
    assert!(
        (series.time_s[series.len() - 1] - 298.0).abs() < 0.5,
        "{name}"
    );
    assert!(at(10.0).0.abs() < 1e-6, "{name}: {:?}", at(10.0));
    assert!((at(70.0).0 - 2.0).abs() < 1e-3, "{name}: {:?}", at(70.0));
    assert!((at(190.0).0 + 1.5).abs() < 1e-3, "{name}: {:?}", at(190.0));
    assert!(at(70.0).1 < 3.7, "{name}: {:?}", at(70.0));
}

fn is_refused(name: &str, words: &[&str]) {
    let Some(path) = case(name) else { return };
    let series = read_record(&path, &SeriesOptions::default())
        .unwrap_err()
        .to_string();
    println!("{name}: {series}");
    assert!(words.iter().all(|word| series.contains(word)), "{series}");
}

/// The truth of the cases at 100 Hz and at the ends.
fn is_truth(name: &str, points: usize) {
    let Some(path) = case(name) else { return };
    let read = read_file(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
    println!("{name}: {:?}", read.notes);
    let [one] = read.spectra.as_slice() else {
        panic!("{name}: {} spectra", read.spectra.len())
    };
    let all = &one.spectrum.points;
    assert_eq!(all.len(), points, "{name}");
    let near = |f: f64, re: f64, im: f64| {
        all.iter().any(|p| {
            (p.freq_hz / f - 1.0).abs() < 1e-5
                && (p.z_ohm.re / re - 1.0).abs() < 1e-3
                && (p.z_ohm.im / im - 1.0).abs() < 1e-3
        })
    };
    assert!(
        near(1000.0, 0.02104684, -0.0006430064),
        "{name}: {:?}",
        all.last()
    );
    assert!(near(100.0, 0.02409866, -0.003966127), "{name}");
    assert!(near(31.62278, 0.02792068, -0.002955303), "{name}");
}

#[test]
fn series_of_the_cases_are_read_right() {
    for name in [
        "sign_name_hppc_discharge.csv",
        "sign_noname_hppc.csv",
        "sign_steptype.bdf.csv",
        "eclab_cp.mpt",
        "neware_cumulative_time.csv",
        "names_without_units_tri.csv",
        "maccor_minutes.txt",
        "gamry_chrono.DTA",
    ] {
        is_record(name);
    }
    is_refused("time_ms_as_s_unix.bdf.csv", &["wall clock", "0.001"]);
    let Some(path) = case("eclab_ocv.mpt") else {
        return;
    };
    let rest = read_record(&path, &SeriesOptions::default()).unwrap();
    assert!(rest.series.current_a.iter().all(|a| *a == 0.0) && rest.series.len() == 150);
}

#[test]
fn spectra_of_the_cases_are_read_right() {
    for name in [
        "pstrace.csv",
        "v_short_rows.mpt",
        "v_blanks3.txt",
        "v_relax.txt",
        "maccor_eis.041",
        "v_minus.csv",
        "hioki.csv",
        "deutsch.txt",
        "v_percent.txt",
        "v_emptyrows.csv",
        "excel_comma.csv",
        "uniminus.csv",
        "fortran.dat",
    ] {
        is_truth(name, 28);
    }
    is_truth("overload_scpi.csv", 27);
    if let Some(path) = case("v_contra.csv") {
        let refused = read_file(&path).unwrap_err().to_string();
        assert!(refused.contains("of opposite sign"), "{refused}");
    }
    if let Some(path) = case("palmsens_three_channels.pssession") {
        let read = read_file(&path).unwrap();
        let counts: Vec<usize> = read
            .spectra
            .iter()
            .map(|s| s.spectrum.points.len())
            .collect();
        assert_eq!(counts, [5; 12]);
    }
}
