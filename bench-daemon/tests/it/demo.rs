//! The demo: its folder is complete, its numbers agree with the simulated truth within their
//! stated uncertainties, and the same seed gives the same bytes.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use analysis::{
    calibration::Correction,
    dataset::{read_capture, read_spectrum_csv, read_spectrum_parquet},
    fit::ModelFile,
    spectrum::ImpedancePoint,
};
use bench_daemon::command::run::run_experiment;
use bench_evaluate::run::Finished;
use bench_plan::config::load_experiment;
use fixtures::SimulatedBench;
use instruments::transcript::Direction;

use crate::support::{Ended, demo, files_below, json, program, sent, transcript, truth};

const ROLES: [&str; 8] = [
    "supply4q",
    "generator",
    "scope",
    "load",
    "supply",
    "chiller",
    "logger",
    "jig",
];
const FIXTURES: [&str; 3] = ["shunt", "fake_cell", "cell"];
const POINTS: usize = 20;
const RECORD_POINTS: usize = 10_000;
const SHUNT_OHM: f64 = 9.96e-3;

/// Runs the demo as another process.
fn run_program(out: &Path, more: &[&str]) -> Ended {
    let experiment = demo();
    let mut arguments = vec![
        "run".as_ref(),
        experiment.as_os_str(),
        "--out".as_ref(),
        out.as_os_str(),
    ];
    arguments.extend(more.iter().map(std::ffi::OsStr::new));
    let ended = program(&arguments);
    ended.expect_code(0);
    ended
}

/// Runs the demo in this process, where its truth is accessible; with one fit, because the fits
/// are not tested here.
fn run_here(seed: u64) -> (Finished, tempfile::TempDir) {
    let mut experiment = load_experiment(&demo(), None).unwrap();
    experiment.seed = seed;
    experiment.fit.rc = vec![1];
    let folder = tempfile::tempdir().unwrap();
    let finished = run_experiment(&experiment, &folder.path().join("run")).unwrap();
    (finished, folder)
}

#[test]
fn the_run_folder_is_complete_and_everything_in_it_is_readable() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let ended = run_program(&run, &[]);
    assert_recommended(&run, &ended.stdout);
    assert_spectra(&run);
    assert_captures(&run);
    assert_models(&run);
    assert_budget(&run);
    assert_controls(&run);
    assert_manifest(&run);
    assert_tables(&run);
    assert_report(&run);
    for role in ROLES {
        let found = transcript(&run, role);
        assert!(found.torn.is_none(), "{role}");
        let count = |direction: Direction| {
            found
                .records
                .iter()
                .filter(|record| record.direction == direction)
                .count()
        };
        assert!(
            count(Direction::Sent) > 0 && count(Direction::Received) > 0,
            "{role}"
        );
        assert_eq!(count(Direction::Unsolicited), 0, "{role}");
        assert!(
            found.records.is_sorted_by(|a, b| a.time_s <= b.time_s),
            "{role}"
        );
    }
    // Configured values are kept as they were typed.
    for (kept, typed) in [
        ("experiments_demo", "experiments/demo"),
        ("benches_demo", "benches/demo"),
        ("cells_p45b", "cells/p45b"),
        ("scenarios_p45b", "scenarios/p45b"),
    ] {
        let typed = crate::configuration::configs().join(format!("{typed}.toml"));
        let kept = run.join("config").join(format!("{kept}.toml"));
        assert_eq!(
            fs::read(&kept).unwrap(),
            fs::read(typed).unwrap(),
            "{}",
            kept.display()
        );
    }
}

fn assert_spectra(run: &Path) {
    for name in ["raw_shunt", "raw_fake_cell", "raw_cell", "spectrum"] {
        let table = read_spectrum_csv(&run.join(format!("{name}.csv"))).unwrap();
        assert_eq!(table.len(), POINTS, "{name}");
        assert!(table.is_sorted_by(|a, b| a.freq_hz < b.freq_hz), "{name}");
        assert!(
            (table[0].freq_hz, table[POINTS - 1].freq_hz) == (0.1, 300.0),
            "{name}"
        );
        assert!(
            table
                .iter()
                .all(|point| point.covariance.is_valid() && point.covariance.re_re > 0.0),
            "{name}"
        );
        assert!(
            table
                .iter()
                .all(|point| (point.amplitude_a - 1.0).abs() < 0.05),
            "{name}: about 1 A was asked for"
        );
        let columns = read_spectrum_parquet(&run.join(format!("{name}.parquet"))).unwrap();
        assert_eq!(columns.len(), table.len(), "{name}");
        for (row, column) in table.iter().zip(&columns) {
            assert_eq!(
                (row.freq_hz, row.z_ohm, row.amplitude_a),
                (column.freq_hz, column.z_ohm, column.amplitude_a),
                "{name}"
            );
            assert!(
                (row.covariance.re_re / column.covariance.re_re - 1.0).abs() < 1.0e-12,
                "{name}"
            );
            assert_eq!(row.covariance.re_im, column.covariance.re_im, "{name}");
        }
    }
}

fn assert_captures(run: &Path) {
    let spectrum = read_spectrum_csv(&run.join("spectrum.csv")).unwrap();
    for fixture in FIXTURES {
        let folder = run.join("captures").join(fixture);
        // A point whose range was changed has more than one capture; its name shows it.
        let files: Vec<PathBuf> = files_below(&folder)
            .into_iter()
            .filter(|name| !name.to_string_lossy().contains("_again"))
            .collect();
        assert_eq!(files.len(), POINTS, "{fixture}");
        for (file, point) in files.iter().zip(&spectrum) {
            let capture = read_capture(&folder.join(file)).unwrap();
            assert!(
                capture.meta.label.starts_with(&format!("{fixture} point ")),
                "{}",
                capture.meta.label
            );
            assert_eq!(
                capture.meta.freq_hz,
                point.freq_hz,
                "{fixture} {}",
                file.display()
            );
            assert_eq!(
                capture.codes.each_ref().map(Vec::len),
                [RECORD_POINTS; 4],
                "{fixture} {}",
                file.display()
            );
            let periods = capture.meta.interval_s * RECORD_POINTS as f64 * point.freq_hz;
            // The scope reports its sample interval in single precision.
            assert!(
                periods >= 4.999,
                "{fixture} {}: {periods} periods",
                file.display()
            );
            for codes in &capture.codes {
                assert!(
                    codes.iter().min() < codes.iter().max(),
                    "{fixture} {}: a channel saw nothing",
                    file.display()
                );
            }
        }
    }
}

fn assert_models(run: &Path) {
    for rc in 1..=4 {
        let text = fs::read_to_string(run.join(format!("model_{rc}rc.json"))).unwrap();
        let model = ModelFile::from_json(&text).unwrap();
        assert_eq!((model.rc, model.fit.erm.branches.len()), (rc, rc));
        let pack = model.pack.unwrap();
        // 16 cells in series, 3 in parallel, and all cells equal.
        let ratio = pack.dc_resistance_ohm / model.dc_resistance_ohm;
        assert!((ratio - 16.0 / 3.0).abs() < 1.0e-9, "{rc} RC: {ratio}");
        // The curve of the cell file goes with the model into every later command.
        let ocv = model.ocv.unwrap();
        assert!(ocv.capacity_ah == 4.5 && ocv.ocv_v.len() > 2, "{ocv:?}");
    }
}

/// Asserts that the model of the simulated cell is recommended, in the run and in a later fit of
/// its spectrum, which uses the slope of the open-circuit voltage as the run does.
fn assert_recommended(run: &Path, text: &str) {
    let order = json(&run.join("order.json"));
    assert_eq!(order["recommended"], 4);
    for part in ["\n→ 4 RC: R 6.4", "\n  3 RC: R ", "\nrecommended: 4 RC: "] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let report = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(report.contains("4 (recommended)"));
    let spectrum = run.join("spectrum.csv");
    let fitted = program(&["fit".as_ref(), spectrum.as_os_str(), "--json".as_ref()]);
    let found: serde_json::Value = serde_json::from_str(&fitted.expect_code(0).stdout).unwrap();
    let said = &fitted.stderr;
    for part in [
        "slope of the open-circuit voltage ",
        "from [ocv] of its cell at 3.",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let fits = found["fits"].as_array().unwrap();
    assert_eq!((fits.len(), &fits[0]["rc"]), (1, &4.into()));
    let ended = json(&run.join("model_4rc.json"));
    let of = |value: &serde_json::Value| value["dc_resistance_ohm"].as_f64().unwrap();
    assert!((of(&fits[0]) - of(&ended)).abs() < 1.0e-5, "{found:#}");
    // A copy has the slope that is stated for it, or none.
    let copy = run.with_file_name("copy.csv");
    fs::copy(&spectrum, &copy).unwrap();
    let given = &ended["fit"]["charge_storage"]["given"];
    let [slope, sigma] = ["v_per_c", "sigma_v_per_c"].map(|key| given[key].as_f64().unwrap());
    let stated = format!("--slope-of={}={slope},{sigma}", copy.display());
    let fitted = program(&["fit", "--json", &stated, copy.to_str().unwrap()]);
    let copied: serde_json::Value = serde_json::from_str(&fitted.expect_code(0).stdout).unwrap();
    assert!(
        (of(&copied["fits"][0]) - of(&ended)).abs() < 1.0e-5,
        "{copied:#}"
    );
    assert_eq!(fitted.stderr, "");
    // An argument comes first.
    let other = program(&[
        "fit".as_ref(),
        spectrum.as_os_str(),
        "--ocv-slope".as_ref(),
        "fit".as_ref(),
    ]);
    assert!(
        other.stdout.contains("no slope was given: prior "),
        "{}",
        other.stdout
    );
}

/// Asserts that the budget belongs to the spectrum: its totals are the spectrum's standard
/// deviations, and its parts add up to them in squares.
fn assert_budget(run: &Path) {
    let spectrum = read_spectrum_csv(&run.join("spectrum.csv")).unwrap();
    let text = fs::read_to_string(run.join("budget.csv")).unwrap();
    let (header, rows) = text.split_once('\n').unwrap();
    let names: Vec<&str> = header.split(',').collect();
    for name in [
        "noise",
        "quantisation",
        "drift",
        "shunt",
        "gain",
        "skew",
        "mutual_inductance",
        "fake_cell",
        "control_noise",
    ] {
        assert!(
            names.contains(&format!("{name}_pct").as_str())
                && names.contains(&format!("{name}_deg").as_str()),
            "{name}: {header}"
        );
    }
    for (row, point) in rows.lines().zip(&spectrum) {
        let cells: Vec<f64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
        let column = |name: &str| cells[names.iter().position(|met| *met == name).unwrap()];
        assert_eq!(column("freq_hz"), point.freq_hz);
        for (unit, stated) in [
            (
                "_pct",
                100.0 * point.magnitude_sigma_ohm() / point.magnitude_ohm(),
            ),
            ("_deg", point.phase_sigma_rad().to_degrees()),
        ] {
            assert!(
                (column(&format!("total{unit}")) / stated - 1.0).abs() < 1.0e-3,
                "{row}"
            );
            let parts = names.iter().filter(|name| {
                name.ends_with(unit)
                    && !["correction", "total", "phase"]
                        .iter()
                        .any(|sum| name.starts_with(sum))
            });
            let squares: f64 = parts.map(|name| column(name).powi(2)).sum();
            assert!((squares.sqrt() / stated - 1.0).abs() < 1.0e-3, "{row}");
        }
    }
    assert_eq!(rows.lines().count(), POINTS);
    assert_eq!(
        json(&run.join("budget.json"))["points"]
            .as_array()
            .unwrap()
            .len(),
        POINTS
    );
}

fn assert_controls(run: &Path) {
    let correction: Correction =
        serde_json::from_value(json(&run.join("correction.json"))).unwrap();
    assert!(
        correction
            .parameters()
            .iter()
            .all(|parameter| parameter.value.is_finite() && parameter.sigma > 0.0)
    );
    let controls = json(&run.join("controls.json"));
    let names: Vec<&str> = controls
        .as_array()
        .unwrap()
        .iter()
        .map(|control| control["control"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["shunt", "fake_cell"]);
    assert!(
        controls[0]["raw"]["passed"].as_bool().unwrap()
            && controls[1]["corrected"]["passed"].as_bool().unwrap()
    );
}

fn assert_manifest(run: &Path) {
    let manifest = json(&run.join("manifest.json"));
    assert_eq!(manifest["program"], "eis-bench");
    assert_eq!(manifest["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(
        (&manifest["seed"], &manifest["time"]),
        (&1.into(), &"virtual".into())
    );
    assert_eq!(manifest["status"], "finished");
    assert!(
        manifest["bench_time_s"].as_f64().unwrap() > 3000.0,
        "about an hour of bench time: {}",
        manifest["bench_time_s"]
    );
    let hash = manifest["config_sha256"].as_str().unwrap();
    assert!(
        hash.len() == 64 && hash.bytes().all(|byte| byte.is_ascii_hexdigit()),
        "{hash}"
    );
    assert_eq!(
        manifest["files"].as_object().unwrap().len(),
        4,
        "experiment, bench, cell, scenario"
    );
    let instruments = manifest["instruments"].as_array().unwrap();
    let roles: Vec<&str> = instruments
        .iter()
        .map(|instrument| instrument["role"].as_str().unwrap())
        .collect();
    assert_eq!(roles, ROLES);
    for instrument in instruments {
        assert_eq!(instrument["recognised"], true);
        assert!(!instrument["identity"]["raw"].as_str().unwrap().is_empty());
    }
}

fn assert_tables(run: &Path) {
    let times = |name: &str, header: &str| -> Vec<f64> {
        let text = fs::read_to_string(run.join(name)).unwrap();
        let (first, rows) = text.split_once('\n').unwrap();
        assert_eq!(first, header);
        rows.lines()
            .map(|row| row.split(',').next().unwrap().parse().unwrap())
            .collect()
    };
    let events = times("events.csv", "time_s,kind,event");
    let readings = times(
        "readings.csv",
        "time_s,phase,voltage_v,current_a,temperature_c",
    );
    assert!(events.is_sorted() && readings.is_sorted());
    assert!(
        events.len() > 3 * POINTS && readings.len() > 1000,
        "{} events, {} readings",
        events.len(),
        readings.len()
    );
    let text = fs::read_to_string(run.join("events.csv")).unwrap();
    let stages = [
        "\"fixture check: shunt\"",
        "\"fixture check: fake cell\"",
        "\"temperature\"",
        "\"SOC reset\"",
        "\"EIS sweep of the cell\"",
    ];
    let found: Vec<Option<usize>> = stages.iter().map(|stage| text.find(stage)).collect();
    assert!(
        found.iter().all(Option::is_some) && found.is_sorted(),
        "the controls before the cell, then as in the thesis: {found:?}"
    );
    let log = fs::read_to_string(run.join("log.txt")).unwrap();
    assert!(log.contains("INFO stage: EIS sweep of the cell"), "{log}");
}

/// Asserts that the report needs no other file, and that each plot exists for the screen and for
/// print.
fn assert_report(run: &Path) {
    let report = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(report.starts_with("<!DOCTYPE html>") && report.trim_end().ends_with("</html>"));
    for reference in ["src=\"http", "href=\"http", "<script src", "@import"] {
        assert!(
            !report.contains(reference),
            "the report needs something else: {reference}"
        );
    }
    assert!(report.matches("<svg").count() >= 3 && report.contains("Molicel P45B"));
    let orders = (1..=4).map(|rc| format!("nyquist_fit_{rc}rc"));
    for name in ["nyquist", "bode", "budget", "nyquist_controls"]
        .map(str::to_owned)
        .into_iter()
        .chain(orders)
    {
        let svg = fs::read_to_string(run.join(format!("plots/{name}.svg"))).unwrap();
        assert!(
            svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"),
            "{name}"
        );
        let png = fs::read(run.join(format!("plots/{name}.png"))).unwrap();
        assert!(
            png.starts_with(b"\x89PNG\r\n") && png.ends_with(b"IEND\xaeB`\x82"),
            "{name}"
        );
    }
}

#[test]
fn one_seed_gives_the_same_bytes_and_another_seed_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let runs = ["first", "second", "other"].map(|name| folder.path().join(name));
    std::thread::scope(|scope| {
        for (run, seed) in runs.iter().zip(["1", "1", "2"]) {
            scope.spawn(move || run_program(run, &["--seed", seed]));
        }
    });
    let [first, second, other] = runs.map(|run| {
        let files = files_below(&run);
        files
            .into_iter()
            .map(|name| (name.clone(), fs::read(run.join(name)).unwrap()))
            .collect::<BTreeMap<_, _>>()
    });
    assert!(first.len() > 60 + ROLES.len(), "{:?}", first.keys());
    assert_eq!(
        first.keys().collect::<Vec<_>>(),
        second.keys().collect::<Vec<_>>()
    );
    let differing: Vec<&PathBuf> = first
        .iter()
        .filter(|(name, bytes)| second[*name] != **bytes)
        .map(|(name, _)| name)
        .collect();
    assert!(
        differing.is_empty(),
        "one seed, two contents: {differing:?}"
    );
    for name in [
        "spectrum.csv",
        "raw_shunt.csv",
        "captures/cell/point01_0.100000Hz.parquet",
        "readings.csv",
        "model_4rc.json",
    ] {
        assert_ne!(first[Path::new(name)], other[Path::new(name)], "{name}");
    }
}

/// Comparison of one seed's spectrum with the truth.
#[derive(Debug)]
struct Accuracy {
    /// Largest errors.
    magnitude_rel: f64,
    phase_deg: f64,
    /// Parts of the impedance (Re and Im of each point) within two standard deviations of the
    /// truth.
    covered: usize,
}

fn accuracy(finished: &Finished) -> Accuracy {
    let points = &finished.measured.spectrum.points;
    assert_eq!(points.len(), POINTS);
    let truth = truth(finished.simulation.as_ref().unwrap().world(), points);
    let mut accuracy = Accuracy {
        magnitude_rel: 0.0,
        phase_deg: 0.0,
        covered: 0,
    };
    for (point, true_ohm) in points.iter().zip(truth) {
        let ratio = point.z_ohm / true_ohm;
        accuracy.magnitude_rel = accuracy.magnitude_rel.max((ratio.norm() - 1.0).abs());
        accuracy.phase_deg = accuracy.phase_deg.max(ratio.arg().to_degrees().abs());
        let error = point.z_ohm - true_ohm;
        for (error, variance) in [
            (error.re, point.covariance.re_re),
            (error.im, point.covariance.im_im),
        ] {
            accuracy.covered += usize::from(error.abs() <= 2.0 * variance.sqrt());
        }
    }
    accuracy
}

/// One run for all checks, because it takes a second.
#[test]
fn a_run_agrees_with_the_truth_its_shunt_reads_too_much_and_its_cell_was_treated_well() {
    let (finished, folder) = run_here(1);
    let run = folder.path().join("run");
    let found = accuracy(&finished);
    assert!(
        found.magnitude_rel <= 3.0e-3 && found.phase_deg <= 0.3,
        "{found:?}"
    );
    let world = finished.simulation.unwrap().world().lock().unwrap().clone();
    assert_shunt_reads_too_much(&run, world.truth_harness().shunt_pickup_h);
    assert_treated_well(&run, &world);
    assert_last_word_off(&run);
}

#[test]
#[ignore = "long drill"]
fn the_spectra_of_ten_seeds_agree_with_the_truth_and_their_uncertainty_is_honest() {
    let found: Vec<Accuracy> = std::thread::scope(|scope| {
        let halves = [1..=5_u64, 6..=10].map(|seeds| {
            scope.spawn(|| {
                seeds
                    .map(|seed| accuracy(&run_here(seed).0))
                    .collect::<Vec<_>>()
            })
        });
        halves
            .into_iter()
            .flat_map(|half| half.join().unwrap())
            .collect()
    });
    for seed in &found {
        assert!(
            seed.magnitude_rel <= 3.0e-3 && seed.phase_deg <= 0.3,
            "the seeds from 1 on: {found:#?}"
        );
    }
    let parts = found.len() * POINTS * 2;
    let covered = found.iter().map(|seed| seed.covered).sum::<usize>() as f64 / parts as f64;
    eprintln!(
        "parts of the impedance within two standard deviations: {covered}; by seed: {found:.3?}"
    );
    // Two standard deviations cover 95 %. The errors of one seed's correction are common to its
    // points, so ten seeds scatter around that.
    assert!((0.90..=0.99).contains(&covered), "{covered}: {found:#?}");
}

/// Asserts that its phase rises as the pick-up explains: the moved probes add ωM to R.
fn assert_shunt_reads_too_much(run: &Path, pickup_h: f64) {
    let points = read_spectrum_csv(&run.join("raw_shunt.csv")).unwrap();
    for point in &points {
        let milliohm = 1.0e3 * point.magnitude_ohm();
        assert!(
            (milliohm - 10.15).abs() <= 0.05,
            "{milliohm} mΩ at {} Hz",
            point.freq_hz
        );
    }
    let phase_deg = |freq_hz: f64| {
        let near = |a: &&ImpedancePoint, b: &&ImpedancePoint| {
            (a.freq_hz / freq_hz)
                .ln()
                .abs()
                .total_cmp(&(b.freq_hz / freq_hz).ln().abs())
        };
        points.iter().min_by(near).unwrap().phase_rad().to_degrees()
    };
    let pickup_deg = (std::f64::consts::TAU * 300.0 * pickup_h / SHUNT_OHM)
        .atan()
        .to_degrees();
    let excess_deg = phase_deg(300.0) - phase_deg(1.0);
    assert!(
        (excess_deg - pickup_deg).abs() < 0.2,
        "{excess_deg}°, of which the pick-up explains {pickup_deg}°"
    );
    assert!(excess_deg > 0.5, "{excess_deg}°");
}

fn assert_treated_well(run: &Path, world: &SimulatedBench) {
    let witness = world.witness();
    assert_eq!(
        (witness.abuse_count, witness.abuse.as_slice()),
        (0, &[][..])
    );
    assert!(
        witness.least_v > 3.4 && witness.greatest_v < 3.95,
        "{witness:?}"
    );
    // 5 A down, 3 A up, 1 A of sinusoid; meters and gains are off by a few parts in a thousand.
    assert!(
        (witness.greatest_discharge_a - 5.0).abs() < 0.05
            && (witness.greatest_charge_a - 3.0).abs() < 0.05,
        "{witness:?}"
    );
    assert!(
        witness.greatest_degc > 22.0 && witness.greatest_degc < 27.0,
        "{witness:?}"
    );
    // The run has recorded what the cell experienced: one reading a second while charge flows.
    let readings = fs::read_to_string(run.join("readings.csv")).unwrap();
    let direct_coulomb: f64 = readings
        .lines()
        .filter_map(|line| line.split(',').collect::<Vec<_>>().try_into().ok())
        .filter(|[_, phase, ..]: &[&str; 5]| ["discharge", "charge"].contains(phase))
        .map(|[_, _, _, amps, _]| amps.parse::<f64>().unwrap_or(0.0).abs())
        .sum();
    let sine_coulomb = witness.throughput_coulomb - direct_coulomb;
    assert!(
        direct_coulomb > 1000.0,
        "a reset moves charge: {direct_coulomb} C"
    );
    assert!(
        (100.0..1000.0).contains(&sine_coulomb),
        "{direct_coulomb} C while resetting, {sine_coulomb} C in the sweep of the cell"
    );
    let gained_coulomb = (world.truth_soc() - 0.6) * 4.5 * 3600.0;
    assert!(
        (witness.net_charge_coulomb - gained_coulomb).abs() < 1.0,
        "{} C, {gained_coulomb} C",
        witness.net_charge_coulomb
    );
    // Thesis 3.3.1: about 3.72 V.
    assert!(
        (world.truth_cell_v() - 3.72).abs() < 0.02,
        "{} V",
        world.truth_cell_v()
    );
    assert_eq!(world.truth_current_a(), 0.0);
}

/// Asserts that each instrument last reported its output as off, and that nothing was sent
/// afterwards that could change that.
fn assert_last_word_off(run: &Path) {
    for (role, question, off, on) in [
        ("supply4q", "OUTP?", "0", "OUTP ON"),
        ("generator", "C1:OUTP?", "C1:OUTP OFF", "C1:OUTP ON"),
        ("load", ":INP?", "0", ":INP ON"),
    ] {
        let records = transcript(run, role).records;
        let text = |index: usize| match &records[index].payload {
            instruments::transcript::Payload::Text(text) => text.clone(),
            instruments::transcript::Payload::Block(block) => block.prefix.clone(),
        };
        let asked = (0..records.len())
            .rev()
            .find(|&index| text(index) == question)
            .unwrap();
        assert!(
            text(asked + 1).starts_with(off),
            "{role}: {}",
            text(asked + 1)
        );
        let last_on = (0..records.len()).rev().find(|&index| text(index) == on);
        assert!(
            last_on.is_some_and(|index| index < asked),
            "{role} was on once and was asked after that"
        );
    }
    assert!(
        sent(run, "supply")
            .iter()
            .rev()
            .any(|message| message == "OUTP CH1,OFF")
    );
}
