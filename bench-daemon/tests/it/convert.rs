//! Import and export of files of other programs, and captures that a scope has exported.

use std::{fmt::Write as _, fs, path::PathBuf};

use analysis::{dataset, formats::read_spectra};
use num_complex::Complex64;

use crate::support::{program, project};

fn fixture(name: &str) -> String {
    project(&format!("fixtures/data/{name}"))
}

#[test]
fn a_real_file_of_another_program_goes_through_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name).display().to_string();
    let source = fixture("spectra/vendors/gamry.DTA");
    let numbers = |path: &str| {
        read_spectra(&PathBuf::from(path))
            .unwrap()
            .remove(0)
            .points
            .iter()
            .map(|p| (p.freq_hz, p.z_ohm))
            .collect::<Vec<_>>()
    };
    let expected = numbers(&source);
    for (to, file) in [
        ("csv", "gamry.csv"),
        ("impedance-py", "gamry.csv"),
        ("gamry", "gamry.DTA"),
        ("biologic", "gamry.mpt"),
        ("zview", "gamry.z"),
    ] {
        let (code, message) =
            program(&["convert", &source, "--to", to, "--out", &out(to)]).outcome();
        assert_eq!(code, 0, "{message}");
        assert_eq!(numbers(&format!("{}/{file}", out(to))), expected, "{to}");
        let (code, message) =
            program(&["convert", &source, "--to", to, "--out", &out(to)]).outcome();
        assert!(
            code == 2 && message.contains("expected no such file, found one"),
            "{message}"
        );
    }
    // Any command that reads a spectrum accepts them.
    let (code, message) = program(&["fit", &source, "--rc", "1", "--json"]).outcome();
    assert!(
        code == 0 && message.contains("\"rc\": 1"),
        "{code} {message}"
    );
    // No relaxation fits an inductive one.
    let inductive = fixture("spectra/vendors/autolab.txt");
    let (code, message) = program(&["fit", &inductive, "--rc", "1", "--json"]).outcome();
    let refused = "autolab: no model with 1 RC: R1 is at its lower bound of 0.000001 Ω";
    assert!(code == 2 && message.contains(refused), "{code} {message}");
}

#[test]
fn spectra_become_bdf_with_their_metadata_and_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name).display().to_string();
    let source = fixture("spectra/vendors/biologic.mpt");
    let points = |path: &str| {
        let read = read_spectra(&PathBuf::from(path)).unwrap().remove(0);
        let numbers = read.points.iter().map(|p| (p.freq_hz, p.z_ohm));
        (read.name, numbers.collect::<Vec<_>>())
    };
    let expected = points(&source);
    for (to, file) in [
        ("bdf-csv", "biologic.bdf.csv"),
        ("bdf-parquet", "biologic.bdf.parquet"),
    ] {
        let (code, message) =
            program(&["convert", &source, "--to", to, "--out", &out(to)]).outcome();
        assert_eq!(code, 0, "{message}");
        let written = format!("{}/{file}", out(to));
        assert_eq!(points(&written), expected, "{to}");
        let beside = format!("{}/biologic.bdf.metadata.json", out(to));
        assert!(
            fs::read_to_string(beside)
                .unwrap()
                .contains("\"name\": \"biologic\"")
        );
        // Once more, from BDF.
        let again = out(&format!("{to}-again"));
        let (code, message) =
            program(&["convert", &written, "--to", to, "--out", &again]).outcome();
        assert_eq!(code, 0, "{message}");
        assert_eq!(points(&format!("{again}/{file}")), expected, "{to}");
    }
    // A log of a cycler with a spectrum in some of its rows becomes both.
    let log = folder.path().join("log.csv");
    let mut text = "Test Time / s,Voltage / V,Current / A,Frequency / Hz,Real Impedance / \
                    ohm,Imaginary Impedance / ohm\n"
        .to_owned();
    for k in 0..20 {
        writeln!(text, "{k},{},-1,,,", 3.7 - 0.01 * f64::from(k)).unwrap();
    }
    for k in 0..5 {
        writeln!(
            text,
            "{},3.6,0,{},0.01,-0.001",
            20 + k,
            100.0 / f64::from(k + 1)
        )
        .unwrap();
    }
    fs::write(&log, text).unwrap();
    let both = out("both");
    let (code, message) = program(&[
        "convert",
        &log.display().to_string(),
        "--to",
        "bdf-csv",
        "--out",
        &both,
    ])
    .outcome();
    assert_eq!(code, 0, "{message}");
    assert_eq!(
        points(&format!("{both}/log.bdf.csv")).1.len(),
        5,
        "{message}"
    );
    let series = fs::read_to_string(format!("{both}/log.series.bdf.csv")).unwrap();
    assert_eq!(series.lines().count(), 26, "{message}");
    // A spectrum that is damaged is refused as one.
    fs::write(&log, "freq_hz,z_re_ohm,z_im_ohm\n1,x,0\n").unwrap();
    let (code, message) = program(&[
        "convert",
        &log.display().to_string(),
        "--to",
        "bdf-csv",
        "--out",
        &both,
    ])
    .outcome();
    assert!(
        code == 2 && message.contains("log.csv, line 2, column 2 (z_re_ohm)"),
        "{message}"
    );
}

#[test]
fn a_model_is_written_for_others_only_with_its_voltage() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name).display().to_string();
    let (code, message) = program(&[
        "fit",
        &fixture("spectra/vendors/impedance_py.csv"),
        "--rc",
        "1",
        "--out",
        &out("fit"),
    ])
    .outcome();
    assert_eq!(code, 0, "{message}");
    let model = fs::read_dir(out("fit"))
        .unwrap()
        .flatten()
        .map(|e| e.path())
        .find(|p| p.to_string_lossy().ends_with("model_1rc.json"))
        .unwrap();
    let model = model.display().to_string();
    let (code, message) = program(&["convert", &model, "--to", "c", "--out", &out("c")]).outcome();
    assert!(
        code == 2
            && message
                .contains("expected an open-circuit voltage over the state of charge, met none"),
        "{message}"
    );
    for (to, ending) in [
        ("c", "model_1rc.h"),
        ("pybamm", "model_1rc_pybamm.py"),
        ("casadi", "model_1rc_casadi.py"),
    ] {
        let (code, message) = program(&[
            "convert",
            &model,
            "--to",
            to,
            "--out",
            &out(to),
            "--ocv-v",
            "3.7",
            "--capacity-ah",
            "4.5",
        ])
        .outcome();
        let text = fs::read_to_string(format!("{}/{ending}", out(to))).unwrap();
        assert!(
            code == 0 && text.contains("16200") | (to == "pybamm"),
            "{message}"
        );
        // Both the file and the terminal say that the voltage is constant.
        let note = "note: the open-circuit voltage is 3.700 V at every state of charge (--ocv-v)";
        assert!(
            text.contains(note) && message.contains(note),
            "{to}: {message}"
        );
    }
    let flat = [
        "--to",
        "model",
        "--out",
        &out("flat"),
        "--ocv-v",
        "3.7",
        "--capacity-ah",
        "4.5",
    ];
    let (code, message) = program(&[&["convert", &model], &flat[..]].concat()).outcome();
    assert!(
        code == 2 && message.contains("--ocv-v: expected a curve (--ocv) for --to model"),
        "{message}"
    );
}

#[test]
fn exported_captures_give_the_impedance_that_is_in_them() {
    let folder = tempfile::tempdir().unwrap();
    let (interval_s, r_ohm) = (1.0e-4, 0.01);
    // 15 mΩ − j5 mΩ through a shunt of 10 mΩ at 2 A, an offset on each channel, one file per
    // frequency.
    let z = Complex64::new(0.015, -0.005);
    let mut description = "name = \"a cell\"\n[current]\nplus = 2\nminus = 1\nshunt = \"10 mΩ\"\n\
    [voltage]\nplus = 3\n"
        .to_owned();
    for freq_hz in [10.0, 100.0] {
        let mut text =
            "Record Length,Analog:4000\nSample Interval,Analog:1.0E-04\nSource,CH1,CH2,CH3\n\
            Second,Value,Value,Value\n"
                .to_owned();
        for k in 0..4000 {
            let t = interval_s * f64::from(k);
            let wave = |p: Complex64| (p * Complex64::cis(std::f64::consts::TAU * freq_hz * t)).re;
            let noise = 1.0e-6 * ((f64::from(k) * 0.618_034).fract() - 0.5);
            let current = Complex64::from(2.0);
            writeln!(
                text,
                "{t:e},{:e},{:e},{:e}",
                0.1 + noise,
                0.1 + wave(current * r_ohm) - noise,
                3.7 + wave(current * z) + noise
            )
            .unwrap();
        }
        fs::write(folder.path().join(format!("{freq_hz}.csv")), text).unwrap();
        write!(
            description,
            "[[capture]]\nfrequency = \"{freq_hz} Hz\"\nfiles = [\"{freq_hz}.csv\"]\n"
        )
        .unwrap();
    }
    let toml = folder.path().join("capture.toml");
    fs::write(&toml, &description).unwrap();
    let out = folder.path().join("out").display().to_string();
    let (code, message) =
        program(&["replay", &toml.display().to_string(), "--out", &out]).outcome();
    assert!(
        code == 0 && message.contains("2 captures of a cell"),
        "{code} {message}"
    );
    let points = dataset::read_spectrum_csv(&PathBuf::from(out).join("spectrum.csv")).unwrap();
    for (point, freq_hz) in points.iter().zip([10.0, 100.0]) {
        assert!(
            (point.z_ohm - z).norm() < 2.0e-7 && (point.freq_hz / freq_hz - 1.0).abs() < 1.0e-6,
            "{point:?}"
        );
        assert!(
            (point.amplitude_a - 2.0).abs() < 1.0e-4 && point.magnitude_sigma_ohm() < 1.0e-6,
            "{point:?}"
        );
    }
    for (from, to, expected) in [
        (
            "shunt = \"10 mΩ\"",
            "",
            "current: expected either `shunt` or `amps_per_volt`, and no `gain`",
        ),
        (
            "plus = 3",
            "plus = 4",
            "capture.1: expected a channel 4, found 3 in the files",
        ),
        (
            "files = [\"10.csv\"]",
            "files = [\"none.csv\"]",
            "capture.1: ",
        ),
        (
            "plus = 3",
            "plus = 0",
            "voltage: expected two channels that differ, counted from 1",
        ),
    ] {
        fs::write(&toml, description.replacen(from, to, 1)).unwrap();
        let (code, message) = program(&["replay", &toml.display().to_string()]).outcome();
        assert!(code == 2 && message.contains(expected), "{code} {message}");
    }
}

#[test]
fn several_sweeps_of_a_file_are_reported_and_never_made_one() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("three.mpt");
    let mut text =
        "EC-Lab ASCII FILE\nNb header lines : 3\nfreq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\tcycle number\n"
            .to_owned();
    for sweep in 0..3 {
        for k in 0..29 {
            let freq_hz = 1.0e4 * 10f64.powf(-f64::from(k) / 7.0);
            let z = Complex64::new(0.02, 0.0)
                + Complex64::new(0.01, 0.0)
                    / Complex64::new(1.0, freq_hz / (50.0 + f64::from(sweep)));
            writeln!(text, "{freq_hz}\t{}\t{}\t0", z.re, -z.im).unwrap();
        }
    }
    fs::write(&file, text).unwrap();
    let file = file.display().to_string();
    let notice = "three.mpt: 3 spectra, separated where the frequency starts again (line 33 and 1 \
    more): \
                three.mpt#loop1 (29 points), three.mpt#loop2 (29 points), three.mpt#loop3 (29 \
                points)";
    let (code, message) = program(&["fit", &file, "--rc", "1"]).outcome();
    assert!(
        code == 0
            && message.contains(notice)
            && message.contains("three.mpt#loop3: 1 spectrum, 29 points"),
        "{code} {message}"
    );
    let (code, message) = program(&["kk", &file]).outcome();
    assert!(code == 0 && message.contains(notice), "{code} {message}");
    let out = folder.path().join("out");
    let (code, message) = program(&[
        "convert",
        &file,
        "--to",
        "csv",
        "--out",
        &out.display().to_string(),
    ])
    .outcome();
    assert!(
        code == 0 && message.contains(notice) && out.join("three.mpt#loop2.csv").exists(),
        "{code} {message}"
    );
}

#[test]
fn two_curves_of_one_measurement_are_reported_and_not_pooled() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("drift.dta");
    let mut text = "EXPLAIN\n\
    ZCURVE\tTABLE\n\tPt\tFreq\tZreal\tZimag\tZrealDrCor\tZimagDrCor\n\t#\tHz\tohm\tohm\tohm\tohm\n"
        .to_owned();
    for k in 0..20 {
        let freq_hz = 1.0e4 * 10f64.powf(-f64::from(k) / 5.0);
        let z = Complex64::new(0.02, 0.0)
            + Complex64::new(0.01, 0.0) / Complex64::new(1.0, freq_hz / 50.0);
        writeln!(
            text,
            "\t{k}\t{freq_hz}\t{}\t{}\t{}\t{}",
            z.re,
            z.im,
            1.01 * z.re,
            1.01 * z.im
        )
        .unwrap();
    }
    fs::write(&file, text).unwrap();
    let file = file.display().to_string();
    let (code, message) = program(&["fit", &file, "--rc", "1"]).outcome();
    let notice = "two curves of one measurement, with and without correction of its drift";
    assert!(
        code == 0
            && message.contains(notice)
            && message.contains("drift.dta#uncorrected: 1 spectrum, 20 points"),
        "{code} {message}"
    );
    let (code, message) = program(&["fit", &file, "--rc", "1", "--pool"]).outcome();
    assert!(
        code == 2
            && message.contains(
                "expected each measurement once, met curves of the same: drift.dta#drift-corrected"
            ),
        "{code} {message}"
    );
}

#[test]
fn uncertainties_are_kept_where_the_target_has_a_place() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name).display().to_string();
    let source = out("cell.csv");
    fs::write(
        &source,
        "freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm,sigma_im_ohm,cov_re_im_ohm2,shared_re_ohm[gain],\
         shared_im_ohm[gain]\n1,0.02,-0.005,1e-5,2e-5,1e-11,3e-6,1e-6\n\
         1000,0.015,0.001,1e-5,2e-5,0,2e-6,1e-6\n",
    )
    .unwrap();
    let points = |path: &str| {
        let read = read_spectra(&PathBuf::from(path)).unwrap().remove(0);
        read.points
            .iter()
            .map(|p| p.covariance.re_im)
            .collect::<Vec<f64>>()
    };
    for (to, written) in [
        ("csv", "cell.csv"),
        ("impedance-py", "cell.csv"),
        ("table-csv", "spectra.csv"),
    ] {
        let (code, message) =
            program(&["convert", &source, "--to", to, "--out", &out(to)]).outcome();
        assert_eq!(code, 0, "{message}");
        let path = format!("{}/{written}", out(to));
        assert_eq!(points(&path), [1e-11, 0.0], "{to}");
        let says = message.contains("no place to say which errors the points share: gain");
        assert_eq!(says, to != "csv", "{message}");
    }
    let back = read_spectra(&PathBuf::from(out("csv") + "/cell.csv")).unwrap();
    assert_eq!(back[0].shared[0].name, "gain");
    assert_eq!(back[0].shared[0].at_ohm[1].re, 2e-6);
    let (code, message) =
        program(&["convert", &source, "--to", "gamry", "--out", &out("g")]).outcome();
    assert!(
        code == 0 && message.contains("no place for the uncertainties"),
        "{message}"
    );
    let table = out("fits.csv");
    let other = fixture("spectra/vendors/autolab.txt");
    let (code, message) = program(&[
        "convert",
        &source,
        &other,
        "--to",
        "table-parquet",
        "--out",
        &out("t"),
    ])
    .outcome();
    assert!(code == 0 && message.contains("2 spectra"), "{message}");
    let long = out("t") + "/spectra.parquet";
    let (code, message) = program(&["fit", &long, "--rc", "1", "--table", &table]).outcome();
    assert_eq!(code, 0, "{message}");
    assert_eq!(fs::read_to_string(&table).unwrap().lines().count(), 3);
    let twice = [
        "convert",
        &source,
        &source,
        "--to",
        "table-csv",
        "--out",
        &out("u"),
    ];
    let (code, message) = program(&twice).outcome();
    assert!(
        code == 2 && message.contains("another name for each spectrum"),
        "{message}"
    );
}

#[test]
fn harmonics_of_a_run_become_the_columns_of_nleis() {
    let folder = tempfile::tempdir().unwrap();
    let (table, out) = (
        folder.path().join("harmonics.csv"),
        folder.path().join("out"),
    );
    let head = analysis::run_folder::HARMONIC_COLUMNS;
    let rows = "1,0,1,0.5,1,9e-3,-1e-3,1e-6,2e-6,0,V/A\n1,0,1,0.5,2,4e-6,-1e-6,3e-7,3e-7,0,V/A2\n\
        1,0,1,0.5,3,1e-6,0,1e-7,1e-7,0,V/A3\n1,0,1,200,1,7e-3,0,1e-6,1e-6,0,V/A\n";
    let convert = |text: &str| {
        fs::write(&table, text).unwrap();
        let (table, out) = (table.to_str().unwrap(), out.to_str().unwrap());
        program(&["convert", table, "--to", "nleis", "--out", out])
            .outcome()
            .1
    };
    let written = convert(&format!("{head}\n{rows}"));
    assert!(written.contains("1 frequencies"), "{written}");
    let text = fs::read_to_string(out.join("nleis_1.csv")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(
        lines.len(),
        2,
        "only the frequency with both orders: {text}"
    );
    assert_eq!(lines[1], "0.5,9e-3,-1e-3,4e-6,-1e-6,1e-6,2e-6,3e-7,3e-7");
    let wrong = convert(&format!("{head}\n{}", rows.replacen("9e-3", "x", 1)));
    assert!(
        wrong.contains("line 2, column z_re: expected a number, found \"x\""),
        "{wrong}"
    );
    let other = convert("f,re,im\n1,2,3\n");
    assert!(
        other.contains("expected the file harmonics.csv of a run folder"),
        "{other}"
    );
}
