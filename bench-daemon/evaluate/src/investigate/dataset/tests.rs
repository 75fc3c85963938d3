use std::path::Path;

use analysis::{
    augmented::Between,
    calibration::CommonError,
    contract::CommonModeImpedance,
    diagnosis::{
        BenchHistory, DataSet, FindingKind, Fixture, Harmonic, Role, Run, RunData, Start, Sweep,
        SweepPoint, TimeRecord,
    },
    series::TimeSeries,
};
use num_complex::Complex64;

use super::*;

const SERIES: &str =
    "Test Time / s,Current / A,Voltage / V\n10,0,3.7\n11,-2,3.6\n12,-2,3.59\n13,0,3.69\n";
const SPECTRUM: &str = "freq_hz,z_re_ohm,z_im_ohm\n1,0.01,-0.002\n2,0.009,-0.001\n";
const THESIS: &str =
    "freq,offset,resistance,theta\n1,0,0.01,0\n2,0,0.01,0\n1,-2,0.02,0\n2,-2,0.02,0\n";

fn folder(toml: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("p.bdf.csv", SERIES),
        ("s.csv", SPECTRUM),
        ("thesis.csv", THESIS),
        (DATASET_FILE, toml),
    ] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    folder
}

fn read(toml: &str) -> Result<Loaded, String> {
    let folder = folder(toml);
    let prefix = format!("{}/", folder.path().display());
    read_dataset(folder.path()).map_err(|error| error.to_string().replace(&prefix, ""))
}

fn series(run: &Run) -> &TimeRecord {
    let RunData::Time(record) = &run.data else {
        panic!("{run:?}")
    };
    record
}

fn points(run: &Run) -> &Sweep {
    let RunData::Eis(sweep) = &run.data else {
        panic!("{run:?}")
    };
    sweep
}

#[test]
fn a_short_file_is_completed_by_defaults() {
    let toml = "name = \"d\"\n[[runs]]\nfile = \"s.csv\"\nkind = \"eis\"\nsoc = 0.5\n\
    temperature_c = 25\n\
                [[runs]]\nfile = \"p.bdf.csv\"\nkind = \"time\"\nocv_v = 3.7\n\
                temperature_c = 24.5\nrole = \"held_out\"\n\
                current_between_samples = \"hold\"\n[[runs]]\nname = \"n\"\nfile = \"p.bdf.csv\"\n\
                kind = \"time\"\nfixture = \"shunt\"\n\
                fixture_ohm = 0.01\ntemperature_c = 25\ncurrent_positive = \"discharge\"\n\
                from_s = 11\nto_s = 12.5\nstart_s = 100\n";
    let set = read(toml).unwrap().set;
    let [s, p, n] = set.runs.as_slice() else {
        panic!("{set:?}")
    };
    assert_eq!(
        (s.name.as_str(), s.repeat_group.as_str(), s.order, s.start_s),
        ("s", "s", 0, 0.0)
    );
    assert_eq!(
        (&s.fixture, s.start, s.role),
        (
            &Fixture::Cell("cell".to_owned()),
            Start::Soc(0.5),
            Role::Train
        )
    );
    assert_eq!(
        (
            points(s).bias_a,
            points(s).points[0].sigma_ohm,
            points(s).points[0].amplitude_a
        ),
        (0.0, None, None)
    );
    // The sweep before it takes a period of 1 Hz and one of 2 Hz at least.
    assert_eq!(
        (p.name.as_str(), p.order, p.start_s, p.role),
        ("p", 1, 1.5, Role::HeldOut)
    );
    assert_eq!(
        (series(p).between, &series(p).series.time_s),
        (Between::Hold, &vec![0.0, 1.0, 2.0, 3.0])
    );
    assert_eq!(series(p).series.current_a, [0.0, 2.0, 2.0, 0.0]);
    assert_eq!(
        (&n.fixture, n.start_s, series(n).between),
        (&Fixture::Shunt(0.01), 100.0, Between::Linear)
    );
    assert_eq!(
        (&series(n).series.time_s, &series(n).series.current_a),
        (&vec![0.0, 1.0], &vec![-2.0, -2.0])
    );
}

#[test]
fn what_is_odd_in_a_file_is_reported_and_corrections_are_asked_for() {
    let toml = "name = \"d\"\naccept = [\"current_filter\"]\n[[runs]]\nfile = \"p.bdf.csv\"\n\
                kind = \"time\"\nocv_v = 3.7\ntemperature_c = 25\nto_s = 71\n";
    let folder = folder(toml);
    let file = folder.path().join("p.bdf.csv");
    std::fs::write(file, SERIES.replace("12,-2,3.59", "12,-2,nan")).unwrap();
    let loaded = read_dataset(folder.path()).unwrap();
    assert_eq!(loaded.accept, [FindingKind::CurrentFilter]);
    let texts: Vec<&str> = loaded.findings.iter().map(|f| f.text.as_str()).collect();
    assert_eq!(
        texts,
        [
            "p ends at 13 s, 58.000 s before its `to_s` of 71 s",
            "p: 1 row of its part of the file without a voltage or a current (line 4)",
        ]
    );
    let whole = read(
        &toml
            .replace("to_s = 71\n", "")
            .replace("current_filter", "none"),
    );
    assert!(whole.unwrap_err().contains("current_filter"));
}

#[test]
fn one_spectrum_of_several_is_chosen_by_bias_or_name() {
    let run = |more: &str| {
        format!(
            "name = \"d\"\n[[runs]]\nfile = \"thesis.csv\"\nkind = \"eis\"\nsoc = 0.5\n\
            temperature_c = 25\n{more}\n"
        )
    };
    for (more, bias_a) in [
        ("bias_a = -2", 2.0),
        ("bias_a = 0", 0.0),
        ("bias_a = 2\ncurrent_positive = \"discharge\"", 2.0),
        ("spectrum = \"thesis_-2A\"", 2.0),
    ] {
        let set = read(&run(more)).unwrap().set;
        let sweep = points(&set.runs[0]);
        let expected = if bias_a == 0.0 { 0.01 } else { 0.02 };
        assert_eq!(
            (sweep.bias_a, sweep.points[0].z_ohm.norm()),
            (bias_a, expected),
            "{more}"
        );
    }
    let names = "expected the name of one of the file's spectra: thesis, thesis_-2A";
    assert_eq!(
        read(&run("")).unwrap_err(),
        format!("dataset.toml:2: runs.1.spectrum: {names}")
    );
    assert_eq!(
        read(&run("bias_a = 3")).unwrap_err(),
        format!("dataset.toml:7: runs.1.bias_a: {names}")
    );
}

#[test]
fn parts_of_records_and_sweeps_are_taken() {
    let run = |file: &str, more: &str| {
        format!("name = \"d\"\n[[runs]]\nfile = {file}\nsoc = 0.5\ntemperature_c = 25\n{more}\n")
    };
    let set = read(&run(
        "\"p.bdf.csv\"\nkind = \"time\"",
        "from_s = 10.5\ncompare_from_s = 12\nlevel_sigma_v = 0.02",
    ))
    .unwrap()
    .set;
    let record = series(&set.runs[0]);
    assert_eq!(
        (
            record.compared_from_s,
            record.level_sigma_v,
            record.series.time_s[0]
        ),
        (1.0, 0.02, 0.0)
    );
    let whole = read(&run("\"s.csv\"\nkind = \"eis\"", "")).unwrap().set;
    let all = points(&whole.runs[0]).points.clone();
    let part = read(&run(
        "\"s.csv\"\nkind = \"eis\"",
        &format!("to_hz = {}", all[0].freq_hz),
    ))
    .unwrap()
    .set;
    assert_eq!(points(&part.runs[0]).points, all[..1]);
    let none = read(&run("\"s.csv\"\nkind = \"eis\"", "from_hz = 1e9")).unwrap_err();
    assert_eq!(
        none,
        "dataset.toml:7: runs.1.from_hz: expected frequencies of the sweep from `from_hz` to \
        `to_hz`, found none"
    );
}

#[test]
fn mistakes_name_file_line_and_field() {
    let good = "name = \"d\"\n[[runs]]\nfile = \"p.bdf.csv\"\nkind = \"time\"\nsoc = 0.5\n\
    temperature_c = 25\n";
    for (from, to, expected) in [
        (
            "soc = 0.5",
            "sock = 0.5",
            "dataset.toml:5: runs.1.sock: unknown field `sock`",
        ),
        (
            "soc = 0.5",
            "soc = 50",
            "dataset.toml:5: runs.1.soc: expected a state of charge from 0 to 1, found 50",
        ),
        (
            "soc = 0.5",
            "",
            "dataset.toml:2: runs.1.soc: expected `soc` or `ocv_v`, found neither",
        ),
        (
            "soc = 0.5",
            "soc = 0.5\nocv_v = 3.7",
            "dataset.toml:6: runs.1.ocv_v: expected either `soc` or `ocv_v`, found both",
        ),
        (
            "temperature_c = 25",
            "",
            "dataset.toml:2: runs.1.temperature_c: expected the temperature at the start in °C: \
            the file holds none",
        ),
        (
            "temperature_c = 25",
            "temperature_c = 298",
            "dataset.toml:6: runs.1.temperature_c: expected -60 °C to 120 °C, found 298",
        ),
        (
            "temperature_c = 25",
            "temperature_c = 25\nfixture = \"shunt\"",
            "dataset.toml:2: runs.1.fixture_ohm: expected the resistance of the shunt in Ω, found \
            none",
        ),
        (
            "temperature_c = 25",
            "temperature_c = 25\nfixture_ohm = 1",
            "dataset.toml:7: runs.1.fixture_ohm: expected none beside a cell: only shunt and \
            fake_cell have a known resistance",
        ),
        (
            "temperature_c = 25",
            "temperature_c = 25\nfrom_s = 12.5",
            "dataset.toml:7: runs.1.from_s: expected two samples or more from `from_s` to `to_s`; \
            the file holds 10 s to 13 s",
        ),
        (
            "temperature_c = 25",
            "temperature_c = 25\ncompare_from_s = 14",
            "dataset.toml:7: runs.1.compare_from_s: expected samples after it, found none up to 13 \
            s",
        ),
        (
            "temperature_c = 25",
            "temperature_c = 25\nfrom_hz = 1",
            "dataset.toml:7: runs.1.from_hz: a run of kind `time` has no such field",
        ),
        (
            "temperature_c = 25",
            "temperature_c = 25\nbias_a = 1",
            "dataset.toml:7: runs.1.bias_a: a run of kind `time` has no such field",
        ),
        (
            "p.bdf.csv",
            "q.csv",
            "dataset.toml:3: runs.1.file: q.csv: expected a readable file of current and voltage \
            over time",
        ),
        (
            "p.bdf.csv",
            "s.csv",
            "dataset.toml:3: runs.1.file: s.csv, line 1: expected columns",
        ),
        (
            "[[runs]]",
            "[bench]\nvoltage_noise_v = -1\n[[runs]]",
            "dataset.toml:3: bench.voltage_noise_v: expected a number of zero or more, found -1",
        ),
    ] {
        let message = read(&good.replace(from, to)).unwrap_err();
        assert!(message.starts_with(expected), "{message}\n{expected}");
    }
    let twice = format!(
        "{good}[[runs]]\nfile = \"p.bdf.csv\"\nkind = \"time\"\nsoc = 0.5\ntemperature_c = 25\n"
    );
    assert_eq!(
        read(&twice).unwrap_err(),
        "dataset.toml:7: runs.2.name: expected a name of its own for every run, found \"p\""
    );
}

#[test]
fn errors_of_a_bench_that_are_not_stated_are_assumed_and_reported() {
    let loaded = read(
        "name = \"d\"\n[bench]\nvoltage_noise_v = 1e-4\n[[runs]]\nfile = \"p.bdf.csv\"\n\
        kind = \"time\"\nsoc = 0.5\ntemperature_c = 25\n",
    )
    .unwrap();
    // The greatest current is 2 A.
    let expected = BenchHistory {
        voltage_noise_v: 1e-4,
        ..analysis::diagnosis::assumed_history(2.0)
    };
    assert_eq!(loaded.set.history, Some(expected));
    let [note] = loaded.notes.as_slice() else {
        panic!("{:?}", loaded.notes)
    };
    assert!(note.starts_with("[bench] does not state voltage_resolution_v, voltage_offset_v"));
}

#[test]
fn a_damaged_file_is_a_problem_and_not_an_error() {
    let toml = "name = \"d\"\n[[runs]]\nname = \"bad\"\nfile = \"bad.csv\"\nkind = \"KIND\"\n\
    soc = 0.5\ntemperature_c = 25\n\
                [[runs]]\nfile = \"s.csv\"\nkind = \"eis\"\nsoc = 0.5\ntemperature_c = 25\n";
    let back = SERIES.replace("13,", "11.5,");
    for (kind, text, expected) in [
        ("time", "", "expected columns"),
        ("time", back.as_str(), "its times go back: "),
        (
            "time",
            &SERIES[..SERIES.len() - 6],
            "line 5, column 3 (Voltage / V): expected a finite number, met the end of the line",
        ),
        (
            "time",
            "Test Time / s,Current / A,Voltage / V\n",
            "expected at least 2 samples",
        ),
        (
            "time",
            &SERIES.replace("3.59", "inf"),
            "expected a finite number, met \"inf\"",
        ),
        ("eis", "", "met an empty file"),
        (
            "eis",
            "freq_hz,z_re_ohm,z_im_ohm\n1,0.01,nan\n",
            "met no point that was measured",
        ),
        (
            "eis",
            "freq_hz,z_re_ohm,z_im_ohm\n1,0.01,0\n1,0.01,0\n",
            "expected rising frequencies",
        ),
    ] {
        let folder = folder(&toml.replace("KIND", kind));
        std::fs::write(folder.path().join("bad.csv"), text).unwrap();
        let loaded = read_dataset(folder.path()).unwrap();
        assert_eq!(loaded.set.runs.len(), 1);
        let [problem] = loaded.problems.as_slice() else {
            panic!("{:?}", loaded.problems)
        };
        assert!(
            problem.run == "bad" && problem.text.contains(expected),
            "{problem}\n{expected}"
        );
    }
}

#[test]
fn a_data_set_comes_back_from_its_folder_bit_for_bit() {
    let series = TimeSeries {
        name: "03_a_pulse__20_A.bdf.csv".to_owned(),
        time_s: vec![0.0, 0.1, 1.0 / 3.0],
        current_a: vec![0.0, 20.0, -1.0 / 3.0],
        voltage_v: vec![3.7, 3.5, 3.600_000_1],
        temperature_degc: Some(vec![25.0, 25.1, 25.2]),
    };
    let point = |freq_hz: f64, sigma_ohm, amplitude_a| SweepPoint {
        freq_hz,
        z_ohm: Complex64::new(0.01, -0.1 / 3.0),
        sigma_ohm,
        amplitude_a,
    };
    let run = |name: &str, fixture, data| Run {
        name: name.to_owned(),
        fixture,
        role: Role::HeldOut,
        repeat_group: "g".to_owned(),
        order: 7,
        start_s: 12.5,
        temperature_degc: 24.9,
        start: Start::Ocv(3.7),
        data,
    };
    let sweep = Sweep {
        bias_a: 2.0,
        common_mode: CommonModeImpedance {
            r_ohm: 0.04,
            l_h: 7e-7,
        },
        elapsed_s: vec![30.0, 12.5],
        charge_coulomb: vec![-4.0, 8.0 / 3.0],
        harmonics: Vec::new(),
        points: vec![point(0.1, None, None), point(0.2, None, Some(1.0))],
    };
    let harmonic = |order: u32| Harmonic {
        freq_hz: 0.2,
        order,
        z_ohm: Complex64::new(1e-5, -2e-5),
        sigma_ohm: (1e-6, 2e-6),
        amplitude_a: 2.0,
    };
    let with_harmonics = Sweep {
        harmonics: vec![harmonic(2), harmonic(3)],
        ..sweep.clone()
    };
    let history = BenchHistory {
        voltage_noise_v: 5e-4,
        voltage_resolution_v: 1.22e-3,
        voltage_offset_v: 5e-4,
        voltage_drift_v: 1.5e-4,
        voltage_drift_s: 2.0,
        resistance_rel: 4e-3,
        current_gain_rel: 1e-3,
        current_offset_a: 0.03,
        current_noise_a: 0.03,
        current_resolution_a: 0.1,
        eis_noise_rel: 1e-3,
        start_voltage_v: 0.0,
        calibration_rel: 0.0,
        channel_gain_rel: 0.0,
    };
    let set = DataSet {
        name: "whole".to_owned(),
        runs: vec![
            run("sweep", Fixture::FakeCell(0.00375), RunData::Eis(sweep)),
            Run {
                repeat_group: "swept".to_owned(),
                ..run(
                    "sweep of the cell",
                    Fixture::Cell("P45B 3".to_owned()),
                    RunData::Eis(with_harmonics),
                )
            },
            run(
                "a pulse, 20 A",
                Fixture::Cell("P45B 3".to_owned()),
                RunData::Time(TimeRecord {
                    series,
                    between: Between::Hold,
                    compared_from_s: 0.0,
                    level_sigma_v: 0.0,
                    sigma_v: Some(vec![1e-6, 2e-6, 1e-3 / 3.0]),
                    averaged_s: Some(vec![(0.0, 0.0), (0.05, 0.1 + 1e-3 / 3.0), (0.25, 0.4)]),
                    current_errors_a: Vec::new(),
                }),
            ),
        ],
        history: Some(history),
        calibration: Some(CommonError {
            skew_s: [5e-7, 0.0, 0.0, 0.0, 0.0],
            inductance_h: [-1e-9 / 3.0, 2e-10, 0.0, 0.0, 0.0],
            square_ohm_s2: [0.0, 1e-13, 2e-13 / 3.0, 0.0, 0.0],
            at_shunt_h: [1e-10, 0.0, 3e-11, 1e-10, 0.0],
            at_shunt_ohm_s2: [0.0, 0.0, 1e-14, 0.0, 1e-13],
        }),
    };
    let folder = tempfile::tempdir().unwrap();
    write_dataset(folder.path(), &set).unwrap();
    let loaded = read_dataset(folder.path()).unwrap();
    assert_eq!((loaded.set, loaded.problems), (set, Vec::new()));
}

fn run_folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let manifest =
        "{\"experiment\": \"demo\", \"cell\": {\"name\": \"P45B\", \"capacity_c\": 16200.0}}";
    for (name, text) in [("manifest.json", manifest), ("spectrum.csv", SPECTRUM)]
        .iter()
        .chain(files)
    {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    folder
}

#[test]
fn a_run_folder_without_an_index_is_its_sweep() {
    let readings = "time_s,phase,voltage_v,current_a,temperature_c\n1,rest,3.71,0,24.0\n\
    2,rest,3.72,0,\n3,sine,3.8,1,\n4,sine,3.6,-1,\n";
    let folder = run_folder(&[("readings.csv", readings)]);
    let loaded = read_dataset(folder.path()).unwrap();
    let [run] = loaded.set.runs.as_slice() else {
        panic!("{loaded:?}")
    };
    assert_eq!(
        (loaded.set.name.as_str(), &run.fixture),
        ("demo", &Fixture::Cell("P45B".to_owned()))
    );
    assert_eq!(
        (run.start, run.temperature_degc, points(run).points.len()),
        (Start::Ocv(3.72), 24.0, 2)
    );
    let folder = run_folder(&[(
        "readings.csv",
        &readings.replace("rest", "idle").replace("24.0", ""),
    )]);
    let loaded = read_dataset(folder.path()).unwrap();
    assert!(
        matches!(loaded.set.runs[0].start, Start::Ocv(v) if (v - 3.7).abs() < 1e-12),
        "{:?}",
        loaded.set.runs[0].start
    );
    assert_eq!(
        loaded.notes,
        ["spectrum: its temperature was not measured, 25 °C is taken"]
    );
}

#[test]
fn a_run_folder_with_an_index_gives_its_sweeps_and_traces() {
    let index = r#"{"cell": "P45B", "capacity_c": 16200.0,
        "sweeps": [{"file": "spectrum.csv", "fixture": "cell", "fixture_ohm": null, "corrected": true,
                    "amplitude_a": 1.0, "repeat": 1, "order": 0,
                    "start_time_s": 100.0, "start_ocv_v": 3.72, "temperature_c": 25.0, "role": "train",
                    "repeat_group": "eis", "own_sigma_ohm": [[1e-6, 2e-6], [3e-6, 4e-6]], "below_ohm": 0.035,
                    "below_h": 8e-7, "elapsed_s": [60.0, 20.0], "common_error":
                    {"skew_s": [5e-7, 0, 0, 0, 0], "inductance_h": [1e-9, 2e-9, 0, 0, 0],
                     "square_ohm_s2": [0, 0, 0, 0, 0],
                     "at_shunt_h": [0, 0, 0, 0, 0], "at_shunt_ohm_s2": [0, 0, 0, 0, 0]}}],
        "traces": [{"file": "series_pulse_1.bdf.csv", "name": "pulse", "repeat": 1, "order": 1,
                    "start_time_s": 160.0, "start_ocv_v": 3.7,
                    "charge_before_c": 0.0, "temperature_c": 25.5, "role": "held_out",
                    "repeat_group": "pulse", "current_positive": "charge",
                    "current_between_samples": "hold", "steps_s": [1.0], "sample_sigma_a": 0.01,
                    "sample_sigma_v": 0.0005}]}"#;
    let rows = |(k, line): (usize, &str)| {
        line.to_owned()
            + if k == 0 {
                ",Surface Temperature T1 / degC,Averaged Samples / 1\n"
            } else {
                ",25.5,4\n"
            }
    };
    let series_csv: String = SERIES.lines().enumerate().map(rows).collect();
    let folder = run_folder(&[
        ("traces.json", index),
        ("series_pulse_1.bdf.csv", &series_csv),
        ("events.csv", "time_s,event\n"),
    ]);
    std::fs::create_dir(folder.path().join("config")).unwrap();
    std::fs::copy(
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../configs")
            .join("benches/investigate.toml"),
        folder.path().join("config/benches_b.toml"),
    )
    .unwrap();
    std::fs::copy(
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../configs")
            .join("cells/p45b.toml"),
        folder.path().join("config/a_cell.toml"),
    )
    .unwrap();
    let loaded = read_dataset(folder.path()).unwrap();
    let [sweep, pulse] = loaded.set.runs.as_slice() else {
        panic!("{loaded:?}")
    };
    assert_eq!(
        (sweep.name.as_str(), sweep.start, sweep.start_s),
        ("spectrum", Start::Ocv(3.72), 0.0)
    );
    assert_eq!(
        points(sweep).points[1].sigma_ohm,
        Some((3e-6, 4e-6)),
        "of its own records"
    );
    assert_eq!(
        (points(sweep).common_mode, &points(sweep).elapsed_s),
        (
            CommonModeImpedance {
                r_ohm: 0.035,
                l_h: 8e-7
            },
            &vec![60.0, 20.0]
        )
    );
    assert_eq!(
        loaded
            .set
            .calibration
            .map(|left| (left.skew_s[0], left.inductance_h[1])),
        Some((5e-7, 2e-9))
    );
    assert_eq!(
        loaded.set.history.map(|history| history.eis_noise_rel),
        Some(7e-5),
        "of the bench's file"
    );
    assert_eq!(
        series(pulse).averaged_s,
        None,
        "an older run does not state windows"
    );
    assert_eq!(
        (pulse.name.as_str(), pulse.role, pulse.start_s),
        ("series_pulse_1", Role::HeldOut, 60.0)
    );
    assert_eq!(
        (series(pulse).between, &series(pulse).series.current_a),
        (Between::Hold, &vec![0.0, 2.0, 2.0, 0.0])
    );
    // Windows of half a second before and after each row, and a supply that was up 13 s before the
    // first.
    let rows = |(_, line): (usize, &str)| match line
        .split(',')
        .next()
        .and_then(|time_s| time_s.parse::<f64>().ok())
    {
        Some(time_s) => format!("{line},25.5,4,{},{}\n", time_s - 0.5, time_s + 0.5),
        None => format!(
            "{line},Surface Temperature T1 / degC,Averaged Samples / 1,Averaged From / s,Averaged \
            To / s\n"
        ),
    };
    let series_csv: String = SERIES.lines().enumerate().map(rows).collect();
    let events = format!("time_s,event\n157.0,{}\n", analysis::run_folder::OUTPUT_ON);
    let folder = run_folder(&[
        ("traces.json", index),
        ("series_pulse_1.bdf.csv", &series_csv),
        ("events.csv", &events),
    ]);
    let loaded = read_dataset(folder.path()).unwrap();
    let means = series(&loaded.set.runs[1]);
    let about = |k: usize| (means.series.time_s[k] - 0.5, means.series.time_s[k] + 0.5);
    let windows = means.averaged_s.as_ref().unwrap();
    assert_eq!(
        (windows.len(), means.series.time_s[..2].to_vec(), windows[0]),
        (5, vec![0.0, 13.0], (0.0, 0.0))
    );
    assert!(
        (1..5).all(|k| windows[k] == about(k)),
        "{windows:?} about {:?}",
        means.series.time_s
    );
}

#[test]
fn what_is_not_a_data_set_is_reported_as_such() {
    let folder = tempfile::tempdir().unwrap();
    let message = read_dataset(folder.path()).unwrap_err().to_string();
    assert!(
        message.contains("expected dataset.toml or a run folder with manifest.json"),
        "{message}"
    );
    let message = read_dataset(Path::new("no such folder"))
        .unwrap_err()
        .to_string();
    assert!(
        message.starts_with("no such folder/manifest.json: cannot be read"),
        "{message}"
    );
}

/// Harmonics are numbered by the sweeps of the cell; a multisine between them has no number.
#[test]
fn harmonics_of_a_run_belong_to_its_sweeps() {
    let entry = |file: &str, group: &str, bias_a: f64| {
        format!(
            "{{\"file\": {file:?}, \"fixture\": \"cell\", \"fixture_ohm\": null, \"corrected\": true,
            \"amplitude_a\": 1.0, \"bias_a\": {bias_a}, \"repeat\": 1, \"order\": 0, \"start_time_s\": 0.0,
            \"start_ocv_v\": 3.7, \"temperature_c\": 25.0, \"role\": \"train\", \"repeat_group\": {group:?}}}"
        )
    };
    let index = format!(
        "{{\"cell\": \"P45B\", \"capacity_c\": 16200.0, \"sweeps\": [{}, {}, {}], \"traces\": []}}",
        entry("spectrum.csv", "rest", 0.0),
        entry("multi.csv", "multisine", 0.0),
        entry("biased.csv", "biased", -2.0)
    );
    let harmonics = |bias_a: f64| {
        let head = analysis::run_folder::HARMONIC_COLUMNS;
        format!(
            "{head}\n1,0,1,1,2,2e-6,0,1e-7,1e-7,0,V/A2\n2,{bias_a},2,1,2,4e-6,0,1e-7,1e-7,0,V/A2\n\
            2,{bias_a},2,2,3,0,0,0,0,0,V/A3\n"
        )
    };
    let read = |bias_a: f64| {
        let folder = run_folder(&[
            ("multi.csv", SPECTRUM),
            ("biased.csv", SPECTRUM),
            ("traces.json", &index),
            ("harmonics.csv", &harmonics(bias_a)),
        ]);
        read_dataset(folder.path())
    };
    let loaded = read(-2.0).unwrap();
    let found: Vec<Vec<(u32, f64)>> = loaded
        .set
        .runs
        .iter()
        .map(|run| {
            let harmonics = points(run).harmonics.iter();
            harmonics.map(|h| (h.order, h.z_ohm.re)).collect()
        })
        .collect();
    // V/A² times 2 A; what has no uncertainty is left out.
    assert_eq!(found, [vec![(2, 2e-6)], vec![], vec![(2, 8e-6)]]);
    let error = read(5.0).unwrap_err().to_string();
    assert!(
        error.contains("direct current of -2 A, found 5 A"),
        "{error}"
    );
}
