//! Several sweeps in one file.

use super::{names, parse, parse_file};
use analysis_signal::spectrum::SourcedSpectrum;
use std::{fmt::Write as _, path::Path};

const DOWN: [f64; 9] = [1.0e4, 3.0e3, 1.0e3, 3.0e2, 1.0e2, 30.0, 10.0, 3.0, 1.0];

fn table(freqs: &[f64]) -> Vec<SourcedSpectrum> {
    let mut text = "freq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\n".to_owned();
    for (k, f) in freqs.iter().enumerate() {
        writeln!(text, "{f}\t{}\t0.5", k + 1).unwrap();
    }
    parse(Path::new("dir/x.mpt"), text.as_bytes()).unwrap()
}

fn counts(spectra: &[SourcedSpectrum]) -> Vec<usize> {
    spectra.iter().map(|s| s.spectrum.points.len()).collect()
}

#[test]
fn a_sweep_that_starts_again_is_a_spectrum_of_its_own() {
    let up: Vec<f64> = DOWN.iter().rev().copied().collect();
    let loops = table(&[DOWN, DOWN, DOWN].concat());
    assert_eq!(
        (names(&loops), counts(&loops)),
        (
            vec!["x.mpt#loop1", "x.mpt#loop2", "x.mpt#loop3"],
            vec![9, 9, 9]
        )
    );
    assert_eq!(loops[1].spectrum.points[8].z_ohm.re, 10.0);
    assert_eq!(counts(&table(&[up.clone(), up.clone()].concat())), [9, 9]);
    // Up and down; the point of reversal is measured once or twice.
    assert_eq!(
        counts(&table(&[DOWN.to_vec(), up.clone()].concat())),
        [9, 9]
    );
    assert_eq!(
        counts(&table(&[DOWN.to_vec(), up[1..].to_vec()].concat())),
        [9, 8]
    );
    // The first sweep was aborted.
    assert_eq!(counts(&table(&[&DOWN[..4], &DOWN].concat())), [4, 9]);
    // On another grid.
    let other: Vec<f64> = (0..12)
        .map(|k| 1.0e4 * 10f64.powf(-f64::from(k) / 2.75))
        .collect();
    assert_eq!(counts(&table(&[DOWN.to_vec(), other].concat())), [9, 12]);
    // It starts at the second frequency.
    assert_eq!(counts(&table(&[&DOWN, &DOWN[1..]].concat())), [9, 8]);
    assert_eq!(counts(&table(&[5.0, 1.0, 5.0, 1.0])), [2, 2]);
}

#[test]
fn a_sweep_that_repeats_a_few_points_stays_whole() {
    let reversed: Vec<f64> = DOWN.iter().rev().copied().collect();
    for freqs in [
        DOWN.to_vec(),
        reversed,
        // Points in the middle are repeated.
        [&DOWN[..5], &DOWN[3..]].concat(),
        [&DOWN[..6], &DOWN[3..]].concat(),
        // Each point is measured twice.
        DOWN.iter().flat_map(|f| [*f, *f]).collect(),
        // The first points are repeated at the end, to detect drift.
        [&DOWN[..], &DOWN[..2]].concat(),
        // One frequency between all others.
        DOWN.iter().flat_map(|f| [*f, 1.0e3]).collect(),
        // The lower half before the upper one; every second frequency first.
        [&DOWN[4..], &DOWN[..4]].concat(),
        DOWN.iter()
            .step_by(2)
            .chain(DOWN.iter().skip(1).step_by(2))
            .copied()
            .collect(),
        // Random order.
        vec![30.0, 1.0e4, 1.0, 1.0e3, 3.0, 1.0e2, 3.0e3, 10.0, 3.0e2],
        // One frequency, repeated.
        vec![1.0e3; 20],
        // A grid finer than a percent.
        (0..400).map(|k| 1.0e3 * 0.995f64.powi(k)).collect(),
    ] {
        let spectra = table(&freqs);
        assert_eq!(
            (names(&spectra), counts(&spectra)),
            (vec!["x"], vec![freqs.len()]),
            "{freqs:?}"
        );
    }
}

#[test]
fn a_column_tells_the_sweeps() {
    let rows = |label: fn(usize, usize) -> String| {
        let mut text = String::new();
        for sweep in 0..3 {
            for (k, f) in DOWN.iter().enumerate() {
                writeln!(text, "{}\t{f}\t{}\t-0.5", label(sweep, k), sweep + 1).unwrap();
            }
        }
        text
    };
    for (column, expected) in [
        ("cycle number", "cycle"),
        ("Loop", "loop"),
        ("id", "id"),
        ("spectrum", "spectrum"),
        ("EIS_Test_ID", "id"),
    ] {
        let text = format!(
            "{column}\tFrequency\tZreal\tZimg\n{}",
            rows(|sweep, _| (sweep + 4).to_string())
        );
        let spectra = parse(Path::new("x.csv"), text.as_bytes()).unwrap();
        let expected: Vec<String> = (4..7).map(|k| format!("x.csv#{expected}{k}")).collect();
        assert_eq!(
            (names(&spectra), counts(&spectra)),
            (expected.iter().map(String::as_str).collect(), vec![9; 3]),
            "{column}"
        );
    }
    // A number of the row or of the point does not identify a spectrum: the restart of the
    // frequency does.
    for label in [
        |sweep: usize, k: usize| (9 * sweep + k).to_string(),
        |_: usize, k: usize| k.to_string(),
        |_, _| "7".to_owned(),
    ] {
        let spectra = parse(
            Path::new("x.csv"),
            format!("id\tFrequency\tZreal\tZimg\n{}", rows(label)).as_bytes(),
        )
        .unwrap();
        assert_eq!(
            (names(&spectra), counts(&spectra)),
            (
                vec!["x.csv#loop1", "x.csv#loop2", "x.csv#loop3"],
                vec![9; 3]
            )
        );
    }
    // Rows with the same label need not be contiguous.
    let mut text = "f,re,im,cycle\n".to_owned();
    for f in DOWN {
        writeln!(text, "{f},1,2,1\n{f},3,4,2").unwrap();
    }
    let spectra = parse(Path::new("x.csv"), text.as_bytes()).unwrap();
    assert_eq!(
        (names(&spectra), counts(&spectra)),
        (vec!["x.csv#cycle1", "x.csv#cycle2"], vec![9; 2])
    );
}

#[test]
fn sweeps_of_an_arbin_table_are_distinguished() {
    let mut text = "Channel_ID,EIS_Test_ID,EIS_Data_Point,Test_Time,Frequency,Zmod,Zphz,Zreal,\
                    Zimg,OCV,AC_Amp_RMS\n"
        .to_owned();
    for sweep in 0..27 {
        for k in 0..40 {
            let f = 1.0e4 * 10f64.powf(-f64::from(k) / 7.0);
            writeln!(
                text,
                "1,12,{},{},{f},0.0204,-11.3,{},-0.004,3.7,0.1",
                40 * sweep + k + 1,
                40 * sweep + k,
                0.02 + 1e-4 * f64::from(sweep)
            )
            .unwrap();
        }
    }
    let spectra = parse(Path::new("arbin.csv"), text.as_bytes()).unwrap();
    assert_eq!(counts(&spectra), [40; 27]);
    assert_eq!(
        (
            spectra[26].spectrum.name.as_str(),
            spectra[26].spectrum.points[3].z_ohm.re
        ),
        ("arbin.csv#loop27", 0.02 + 1e-4 * 26.0)
    );
}

#[test]
fn every_layout_is_split() {
    let twice = |row: &dyn Fn(f64) -> String| {
        [DOWN, DOWN]
            .concat()
            .into_iter()
            .map(row)
            .collect::<String>()
    };
    let spectra = |text: String| {
        let read = parse(Path::new("x.csv"), text.as_bytes()).unwrap();
        (
            read.iter()
                .map(|s| s.spectrum.name.clone())
                .collect::<Vec<_>>()
                .join(" "),
            counts(&read),
        )
    };
    let expected = |names: &str| (names.to_owned(), vec![9, 9]);
    assert_eq!(
        spectra(twice(&|f| format!("{f},1,-2\n"))),
        expected("x.csv#loop1 x.csv#loop2")
    );
    assert_eq!(
        spectra(format!(
            "freq_hz,z_re_ohm,z_im_ohm\n{}",
            twice(&|f| format!("{f},1,-2\n"))
        )),
        expected("x.csv#loop1 x.csv#loop2")
    );
    assert_eq!(
        spectra(format!(
            "freq,offset,resistance,theta\n{}",
            twice(&|f| format!("{f},0,1,-0.2\n"))
        )),
        expected("x.csv#loop1 x.csv#loop2")
    );
    let tidy = "fixture,cell,repeat,bias_a,freq_hz,z_abs_ohm,z_phase_rad\n";
    assert_eq!(
        spectra(format!(
            "{tidy}{}",
            twice(&|f| format!("cell,0,3,0,{f},1,0\n"))
        )),
        expected("cell0_3#loop1 cell0_3#loop2")
    );
    let mut labelled = "freq_hz,z_re_ohm,z_im_ohm,cycle\n".to_owned();
    for (k, f) in [DOWN, DOWN].concat().into_iter().enumerate() {
        writeln!(labelled, "{f},1,-2,{}", k / 9 + 1).unwrap();
    }
    assert_eq!(spectra(labelled), expected("x.csv#cycle1 x.csv#cycle2"));
}

/// The remarks on a table of these frequencies, the first in line 2.
fn notes(freqs: &[f64]) -> Vec<String> {
    let mut text = "freq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\n".to_owned();
    for (k, f) in freqs.iter().enumerate() {
        writeln!(text, "{f}\t{}\t0.5", k + 1).unwrap();
    }
    parse_file(Path::new("x.mpt"), text.as_bytes())
        .unwrap()
        .notes
}

#[test]
fn an_order_of_frequencies_that_is_none_is_reported_by_its_line() {
    let up: Vec<f64> = DOWN.iter().rev().copied().collect();
    for quiet in [DOWN.to_vec(), up] {
        assert!(notes(&quiet).is_empty(), "{:?}", notes(&quiet));
    }
    let mut turned = DOWN.to_vec();
    turned.swap(3, 4);
    let remarks = |freqs: &[f64]| notes(freqs).join("; ");
    assert!(
        remarks(&turned).contains("the frequency turns in line 6 within one sweep"),
        "{}",
        remarks(&turned)
    );
    assert!(remarks(&turned).contains("sorted by frequency") && remarks(&turned).contains("`kk`"));
    turned.swap(6, 7);
    assert!(
        remarks(&turned).contains("turns in line 6 and in 1 more within"),
        "{}",
        remarks(&turned)
    );
    let halves = [&DOWN[4..], &DOWN[..4]].concat();
    assert!(
        remarks(&halves).contains("turns in line 7 within"),
        "{}",
        remarks(&halves)
    );
    let twice = [&DOWN[..5], &DOWN[4..]].concat();
    assert!(
        remarks(&twice).contains("a frequency is that of the row before (from line 7)"),
        "{}",
        remarks(&twice)
    );
    // Frequencies that are repeated after others get a separate remark.
    let again = [&DOWN[..5], &DOWN[3..]].concat();
    assert!(remarks(&again).contains("2 frequencies are measured again (from line 7)"));
    assert!(!remarks(&again).contains("turns"), "{}", remarks(&again));
    // Up and down are two sweeps.
    let back: Vec<f64> = DOWN.iter().chain(DOWN.iter().rev()).copied().collect();
    assert!(
        !remarks(&back).contains("turns") && !remarks(&back).contains("row before"),
        "{}",
        remarks(&back)
    );
}
