//! Runs that must not continue: each ends with its exit code and a message that names the finding,
//! with the outputs off and the cell unharmed.

use std::{fs, path::Path};

use bench_daemon::command::run::run_experiment;
use instruments::{fixture::Fixture, mock::plant::Plant as _};

use crate::support::{
    BENCH, CELL, EXPERIMENT, Files, Ports, SCENARIO, files_below, json, program, sent, truth,
};

const FACTOR: f64 = 20.0;
/// Messages that switch something on that can move charge.
const ON: [(&str, &str); 4] = [
    ("supply4q", "OUTP ON"),
    ("generator", "C1:OUTP ON"),
    ("load", ":INP ON"),
    ("supply", "OUTP CH1,ON"),
];

/// A channel whose gain is 6 % off: the voltage pair is on 27 mΩ of wires, so that 10 mΩ reads a
/// sixth too much.
const BAD_GAIN: &str = "
[harness]
channels = [
    { gain = 1.004, skew_s = 40e-9, offset_v = 2.1e-3 },
    { gain = 1.001, skew_s = -90e-9, offset_v = -1.3e-3 },
    { gain = 0.999, skew_s = 150e-9, offset_v = 3.4e-3 },
    { gain = 1.065, skew_s = 60e-9, offset_v = -2.6e-3 },
]
";

fn manifest_status(run: &Path) -> String {
    json(&run.join("manifest.json"))["status"]
        .as_str()
        .unwrap()
        .to_owned()
}

#[test]
#[ignore = "drill"]
fn a_bench_that_measures_its_controls_wrong_never_touches_the_cell() {
    let brief = || Files::brief(2);
    // The fault, the control, the exceeded tolerance, and the greatest and least error of the
    // magnitude, %.
    let cases = [
        (
            brief().edit(EXPERIMENT, "\"3 %\"", "\"1 %\""),
            "shunt as read: control of 9.960 mΩ",
            "1 %",
            1.5..2.5,
        ),
        (
            brief().append(SCENARIO, BAD_GAIN),
            "shunt as read: control of 9.960 mΩ",
            "3 %",
            15.0..22.0,
        ),
        (
            brief().edit(EXPERIMENT, "\"3 °\"", "\"0.5 °\""),
            "shunt as read: control of 9.960 mΩ",
            "0.5°",
            1.5..2.5,
        ),
        (
            brief().edit(BENCH, "\"3.75 mΩ\"", "\"4.85 mΩ\""),
            "fake_cell as read: control of 4.850 mΩ",
            "15 %",
            -20.0..-15.0,
        ),
        (
            brief().edit(
                EXPERIMENT,
                "corrected_tolerance = \"1 %\"",
                "corrected_tolerance = \"0.01 %\"",
            ),
            "fake_cell after the correction: control of 3.750 mΩ",
            "0.01 %",
            -1.0..1.0,
        ),
    ];
    for (files, control, tolerance, percent) in cases {
        let ports = Ports::serve(&files, FACTOR, 1);
        let ended = files.run("run");
        ended.expect_code(4);
        let message = ended.message();
        let rest = message.strip_prefix(&format!(
            "fixture check failed: {control} FAILS: magnitude off by "
        ));
        let (found, rest) = rest
            .and_then(|rest| rest.split_once(" % at "))
            .unwrap_or_else(|| panic!("{message}"));
        assert!(
            percent.contains(&found.parse::<f64>().unwrap()),
            "{percent:?}: {message}"
        );
        assert!(
            rest.contains(&format!("OUTSIDE the tolerance of {tolerance}")),
            "{message}"
        );
        let run = files.path("run");
        assert_eq!(manifest_status(&run), format!("ended early: {message}"));
        let controls = json(&run.join("controls.json"));
        assert!(
            controls.to_string().contains("\"passed\":false"),
            "{controls}"
        );
        assert_cell_left_alone(&run, &ports);
        ports.assert_outputs_off();
    }
}

#[test]
fn a_short_that_reads_too_much_ends_the_run() {
    let known = "[controls.short]\nresistance = \"20 µΩ\"\nresistance_sigma = \"0.2 µΩ\"\n\
    inductance = \"6 nH\"\ninductance_sigma = \"0.3 nH\"";
    let files = Files::brief(2)
        .append(BENCH, known)
        .append(EXPERIMENT, "[fixture_check.short]\nerror = \"0.1 mΩ\"");
    let ports = Ports::serve(&files, FACTOR, 1);
    let ended = files.run("run");
    ended.expect_code(4);
    // 0.57 % between the gains of C3 and C4 on 39 mΩ of common potential.
    let message = ended.message();
    let rest =
        message.strip_prefix("fixture check failed: short as read: short of 20 µΩ FAILS: off by ");
    let (found, rest) = rest
        .and_then(|rest| rest.split_once(" µΩ at "))
        .unwrap_or_else(|| panic!("{message}"));
    assert!(
        (120.0..400.0).contains(&found.parse::<f64>().unwrap())
            && rest.contains("OUTSIDE the tolerance of 100 µΩ"),
        "{message}"
    );
    assert_cell_left_alone(&files.path("run"), &ports);
    ports.assert_outputs_off();
}

/// No step with the cell was begun, nothing was switched on but the pair that drives the controls,
/// and the cell felt nothing.
fn assert_cell_left_alone(run: &Path, ports: &Ports) {
    let events = fs::read_to_string(run.join("events.csv")).unwrap();
    for stage in ["SOC reset", "EIS sweep of the cell", "mount cell"] {
        assert!(!events.contains(stage), "{events}");
    }
    assert!(
        !run.join("raw_cell.csv").exists()
            && !run.join("spectrum.csv").exists()
            && !run.join("captures/cell").exists()
    );
    for (role, on) in &ON[2..] {
        assert!(
            !sent(run, role).iter().any(|message| message == on),
            "{role}"
        );
    }
    let world = ports.world.lock().unwrap();
    let witness = world.witness();
    assert_eq!(
        (
            witness.throughput_coulomb,
            witness.greatest_charge_a,
            witness.greatest_discharge_a
        ),
        (0.0, 0.0, 0.0)
    );
    assert_eq!(witness.abuse, []);
    assert_eq!(world.truth_soc(), 0.6);
}

/// Returns a cell whose open-circuit voltage ranges from one value to another.
fn cell_of(least_v: f64, greatest_v: f64) -> String {
    format!(
        "initial_soc = 0.60\nocv = [{{ soc = 0.0, ocv_v = {least_v:.1} }}, {{ soc = 1.0, ocv_v = \
        {greatest_v:.1} }}]"
    )
}

#[test]
#[ignore = "drill"]
fn a_cell_that_is_out_of_its_limits_is_not_driven() {
    let bare = || Files::short(2).without(EXPERIMENT, "fixture_check");
    let reset = || Files::brief(2).without(EXPERIMENT, "fixture_check");
    let soc = "initial_soc = 0.60";
    let cases = [
        (
            bare().edit(SCENARIO, soc, &cell_of(1.0, 2.0)),
            "cell voltage 1.",
            "V left its limits (2.5 V to 4.2 V)",
        ),
        (
            reset().edit(SCENARIO, soc, &cell_of(1.0, 2.0)),
            "cell voltage 1.",
            "V left its limits (2.5 V to 4.2 V)",
        ),
        (
            bare().edit(SCENARIO, soc, &cell_of(4.2, 4.4)),
            "cell voltage 4.3",
            "V left its limits (2.5 V to 4.2 V)",
        ),
        (
            reset().edit(SCENARIO, soc, &cell_of(4.2, 4.4)),
            "cell voltage 4.3",
            "V left its limits (2.5 V to 4.2 V)",
        ),
        // The jig holds a piece of copper instead of a cell, and no person can change it.
        (
            bare()
                .append(SCENARIO, "")
                .edit(SCENARIO, "[cell]", "mounted = \"fake_cell\"\n[cell]")
                .without(BENCH, "instruments.jig"),
            "cell voltage",
            "V left its limits (2.5 V to 4.2 V)",
        ),
        (
            bare().edit(CELL, "\"60 °C\"", "\"20 °C\""),
            "cell temperature 2",
            "°C left its limits (0 °C to 20 °C)",
        ),
        (
            reset().edit(CELL, "\"60 °C\"", "\"20 °C\""),
            "cell temperature 2",
            "°C left its limits (0 °C to 20 °C)",
        ),
        (
            bare().edit(CELL, "\"0 °C\"", "\"30 °C\""),
            "cell temperature 2",
            "°C left its limits (30 °C to 60 °C)",
        ),
    ];
    for (files, what, limits) in cases {
        let ports = Ports::serve(&files, FACTOR, 1);
        let ended = files.run("run");
        ended.expect_code(5);
        let message = ended.message();
        assert!(
            message.starts_with(&format!("interlock: {what}")) && message.contains(limits),
            "{message}"
        );
        let run = files.path("run");
        assert_eq!(manifest_status(&run), format!("ended early: {message}"));
        for (role, on) in ON {
            assert!(
                !sent(&run, role).iter().any(|message| message == on),
                "{role} was switched on: {message}"
            );
        }
        ports.assert_outputs_off();
        let witness = ports.world.lock().unwrap().witness();
        assert_eq!(
            (
                witness.throughput_coulomb,
                witness.greatest_charge_a,
                witness.greatest_discharge_a
            ),
            (0.0, 0.0, 0.0),
            "{message}"
        );
    }
}

#[test]
fn a_limit_passed_in_mid_run_trips_and_switches_off() {
    // 10 A heat the cell by a kelvin within a minute.
    let files = Files::brief(2)
        .without(EXPERIMENT, "fixture_check")
        .edit(CELL, "\"60 °C\"", "\"22.5 °C\"")
        .edit(
            EXPERIMENT,
            "discharge_current = \"5 A\"",
            "discharge_current = \"10 A\"",
        );
    let ports = Ports::serve(&files, 50.0, 1);
    let ended = files.run("run");
    ended.expect_code(5);
    assert!(
        ended
            .message()
            .starts_with("interlock: cell temperature 22."),
        "{}",
        ended.message()
    );
    assert!(
        ended
            .message()
            .contains("left its limits (0 °C to 22.5 °C)"),
        "{}",
        ended.message()
    );
    let run = files.path("run");
    assert_eq!(
        manifest_status(&run),
        format!("ended early: {}", ended.message())
    );
    assert!(
        sent(&run, "load").contains(&":INP ON".to_owned()),
        "the discharge had begun"
    );
    assert!(
        !fs::read_to_string(run.join("events.csv"))
            .unwrap()
            .contains("charge at 3 A")
    );
    ports.assert_outputs_off();
    let witness = ports.world.lock().unwrap().witness();
    assert!(
        (witness.greatest_discharge_a - 10.0).abs() < 0.1 && witness.greatest_charge_a == 0.0,
        "{witness:?}"
    );
    assert_eq!(witness.abuse, []);
}

#[test]
fn a_temperature_out_of_the_limits_trips_while_it_is_waited_for() {
    let files =
        Files::demo()
            .without(EXPERIMENT, "fixture_check")
            .edit(CELL, "\"0 °C\"", "\"24 °C\"");
    let ended = files.run("run");
    ended.expect_code(5);
    let message = ended.message();
    // The simulated air and the cell are at 22 °C, the thermometer within 0.1 K of it.
    assert!(
        message.starts_with("interlock: cell temperature 2")
            && message.contains("(24 °C to 60 °C)"),
        "{message}"
    );
    assert_eq!(
        manifest_status(&files.path("run")),
        format!("ended early: {message}")
    );
    for (role, on) in ON {
        assert!(
            !sent(&files.path("run"), role)
                .iter()
                .any(|message| message == on),
            "{role}"
        );
    }
}

#[test]
fn a_folder_in_use_is_refused_and_left_as_it_is() {
    let files = Files::short(2);
    let out = files.path("run");
    fs::create_dir(&out).unwrap();
    fs::write(out.join("thesis.csv"), "precious").unwrap();
    let ended = files.run("run");
    ended.expect_code(2);
    let message = ended.message();
    assert!(
        message.contains("expected a new or empty folder, found files in it")
            && message.contains("--out"),
        "{message}"
    );
    assert!(message.contains(&out.display().to_string()), "{message}");
    assert_eq!(files_below(&out), [Path::new("thesis.csv")]);
    assert_eq!(
        fs::read_to_string(out.join("thesis.csv")).unwrap(),
        "precious"
    );
}

#[test]
fn a_mistake_in_a_file_ends_before_anything_is_made() {
    let files = Files::short(2).edit(EXPERIMENT, "\"1 A\"", "\"50 A\"");
    let ended = files.run("run");
    ended.expect_code(2);
    assert!(
        ended
            .message()
            .contains("eis.amplitude: expected 0.01 A to 13.5 A, found 50 A"),
        "{}",
        ended.message()
    );
    assert!(!files.path("run").exists());
}

#[test]
fn plan_prints_every_stage_and_touches_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let configs = crate::configuration::configs().canonicalize().unwrap();
    // No instrument answers at the addresses of the thesis' bench, and none is queried.
    for name in ["demo", "thesis"] {
        let experiment = configs.join(format!("experiments/{name}.toml"));
        let output = crate::support::command(&["plan".as_ref(), experiment.as_os_str()])
            .current_dir(&folder)
            .output()
            .unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        assert_eq!(
            output.status.code(),
            Some(0),
            "{name}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        let stages = [
            "\nfixture check: shunt\n",
            "\ntemperature\n",
            "\nSOC reset\n",
            "\nEIS sweep of the cell\n",
        ];
        let found: Vec<Option<usize>> = stages.iter().map(|stage| text.find(stage)).collect();
        assert!(
            found.iter().all(Option::is_some) && found.is_sorted(),
            "{name}: {found:?} in\n{text}"
        );
        for step in [
            "mount shunt",
            "bipolar supply up: compliance",
            "discharge at 5 A to 3.52 V",
            "rest 5.0 min",
            "bipolar supply down",
        ] {
            assert!(name != "demo" || text.contains(step), "{step:?} in\n{text}");
        }
        assert!(
            text.contains("point 20:")
                && text.contains(" at most ")
                && text.contains("of bench time"),
            "{text}"
        );
    }
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
}

#[test]
fn identify_prints_all_eight_instruments() {
    let bench = crate::configuration::configs().join(BENCH);
    let ended = program(&["identify".as_ref(), bench.as_os_str()]);
    ended.expect_code(0);
    let lines: Vec<&str> = ended
        .stdout
        .lines()
        .filter(|line| !line.starts_with(' '))
        .collect();
    let expected = [
        ("supply4q", "kepco-bop-mg", "KEPCO"),
        ("generator", "siglent-sdg1000x", "SDG1032X"),
        ("scope", "siglent-sds800x-hd", "SDS824X HD"),
        ("load", "siglent-sdl1000x", "SDL1020X-E"),
        ("supply", "siglent-spd3303x", "SPD3303X"),
        ("chiller", "julabo", "JULABO"),
        ("logger", "keysight-34970a", "34970A"),
        ("jig", "mock-jig", "mock-jig"),
    ];
    assert_eq!(lines.len(), expected.len(), "{}", ended.stdout);
    for (line, (role, model, identity)) in lines.iter().zip(expected) {
        assert!(
            line.starts_with(role)
                && line.contains(model)
                && line.contains(identity)
                && line.ends_with("[ok]"),
            "{line}"
        );
    }
    let ended = program(&["identify".as_ref(), bench.as_os_str(), "--json".as_ref()]);
    let found: serde_json::Value = serde_json::from_str(&ended.expect_code(0).stdout).unwrap();
    assert_eq!(found.as_array().unwrap().len(), expected.len());
}

#[test]
#[ignore = "drill"]
fn the_linear_bipolar_supply_measures_the_same_cell() {
    let files = || Files::short(6).edit(EXPERIMENT, "\"100 Hz\"", "\"1 Hz\"");
    let switching = files();
    let linear = files().edit(BENCH, "kepco-bop-mg", "kepco-bop-linear");
    let [switching, linear] = [switching, linear].map(|files| {
        let run = files.path("run");
        (run_experiment(&files.load(), &run).unwrap(), files)
    });
    let messages = sent(&linear.1.path("run"), "supply4q");
    assert!(
        !messages
            .iter()
            .any(|message| message.starts_with("CURR:MODE") || message.starts_with("OUTP:MODE")),
        "{messages:?}"
    );
    assert!(messages.contains(&"FUNC:MODE CURR".to_owned()));
    let world = linear.0.simulation.as_ref().unwrap().world();
    let (found, expected) = (
        &linear.0.measured.spectrum.points,
        &switching.0.measured.spectrum.points,
    );
    assert_eq!(found.len(), 6);
    for ((found, expected), true_ohm) in found.iter().zip(expected).zip(truth(world, found)) {
        for (error, variance) in [
            (
                found.z_ohm.re - expected.z_ohm.re,
                found.covariance.re_re + expected.covariance.re_re,
            ),
            (
                found.z_ohm.im - expected.z_ohm.im,
                found.covariance.im_im + expected.covariance.im_im,
            ),
            (found.z_ohm.re - true_ohm.re, found.covariance.re_re),
            (found.z_ohm.im - true_ohm.im, found.covariance.im_im),
        ] {
            assert!(
                error.abs() < 4.0 * variance.sqrt(),
                "{} Hz: {found:?}, {expected:?}, {true_ohm}",
                found.freq_hz
            );
        }
        assert!(
            ((found.z_ohm / true_ohm).norm() - 1.0).abs() < 3.0e-3,
            "{} Hz: {found:?}",
            found.freq_hz
        );
    }
    let world = world.lock().unwrap();
    assert_eq!(world.witness().abuse, []);
    assert_eq!(world.truth_current_a(), 0.0);
    assert!(world.truth_impedance(Fixture::Cell, 1.0).re > 0.0);
}

#[test]
fn more_current_than_the_step_asked_for_trips_at_once() {
    // Eight times the command, far below what the cell could tolerate.
    let files = Files::short(2).edit(BENCH, "command_trim = 1.0", "command_trim = 8.0");
    let ports = Ports::serve(&files, FACTOR, 1);
    let ended = files.run("run");
    ended.expect_code(5);
    let message = ended.message();
    assert!(
        message.contains("interlock: cell current") && message.contains("left its limits (-1.22"),
        "{message}"
    );
    ports.assert_outputs_off();
}

/// The operator answers `done` without removing the cell: the jig still contains the cell.
#[test]
fn a_cell_left_in_the_jig_is_not_driven_as_a_control() {
    for (control, what) in [
        (Fixture::Shunt, "driving the shunt"),
        (Fixture::Short, "before mounting the short"),
    ] {
        let files = Files::short(2);
        let mut experiment = files.load();
        experiment.bench.instruments.jig = None;
        for (fixture, _) in experiment
            .fixture_check
            .as_mut()
            .unwrap()
            .controls
            .iter_mut()
            .take(1)
        {
            *fixture = control;
        }
        let run = files.path("run");
        let message = run_experiment(&experiment, &run)
            .err()
            .map(|failure| failure.to_string())
            .unwrap_or_default();
        let rest = message.strip_prefix(what).and_then(|rest| {
            rest.strip_prefix(": expected nothing with a voltage in the jig, found 3.")
        });
        assert!(
            rest.is_some_and(|rest| rest.ends_with(" V: is the cell still in?")),
            "{message}"
        );
        for (role, on) in ON {
            assert!(
                !sent(&run, role).iter().any(|message| message == on),
                "{role}"
            );
        }
        let readings = fs::read_to_string(run.join("readings.csv")).unwrap();
        let last: Vec<&str> = readings.lines().last().unwrap().split(',').collect();
        assert!(
            last[1] == "idle" && last[2].starts_with("3."),
            "the voltage is on record: {readings}"
        );
    }
}

#[test]
fn a_cell_that_comes_into_the_jig_while_a_control_is_driven_trips() {
    let files = Files::short(20);
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("run");
    let ended = std::thread::scope(|scope| {
        let running = scope.spawn(|| files.run("run"));
        crate::support::poll("the first point of the shunt", || {
            run.join("raw_shunt.csv").exists().then_some(())
        });
        ports.world.lock().unwrap().mount(0.0, Fixture::Cell);
        running.join().unwrap()
    });
    ended.expect_code(5);
    let message = ended.message();
    assert!(
        message.starts_with("interlock: voltage across a control (is the cell in the jig?) 3."),
        "{message}"
    );
    assert!(
        message.contains("left its limits (-1 V to 1 V)"),
        "{message}"
    );
    ports.assert_outputs_off();
}

#[test]
fn the_voltage_across_a_control_is_recorded() {
    let files = Files::short(2);
    let run = files.path("run");
    run_experiment(&files.load(), &run).unwrap();
    let readings = fs::read_to_string(run.join("readings.csv")).unwrap();
    let driven: Vec<Vec<&str>> = readings
        .lines()
        .map(|line| line.split(',').collect())
        .filter(|row: &Vec<&str>| row[1] == "sine")
        .collect();
    assert!(!driven.is_empty());
    for row in driven {
        assert!(row[2].parse::<f64>().is_ok(), "{row:?}");
    }
}

#[test]
fn the_linear_bipolar_supply_says_that_it_has_no_current_limit_and_drives_no_short() {
    let files = Files::short(2).edit(BENCH, "kepco-bop-mg", "kepco-bop-linear");
    let experiment = files.experiment();
    let text = &program(&["plan".as_ref(), experiment.as_os_str()]).stdout;
    assert!(
        text.contains("no programmable current limit: the output follows the generator"),
        "{text}"
    );
    assert!(!text.contains(", current limit"), "{text}");
    let known = "[controls.short]\nresistance = \"20 µΩ\"\nresistance_sigma = \"0.2 µΩ\"\n\
    inductance = \"6 nH\"\ninductance_sigma = \"0.3 nH\"";
    let files = files
        .append(BENCH, known)
        .append(EXPERIMENT, "[fixture_check.short]\nerror = \"0.1 mΩ\"");
    let ended = files.run("run");
    ended.expect_code(2);
    let message = ended.message();
    assert!(
        message.contains(
            "expected a bipolar supply with a programmable current limit to drive a short"
        ),
        "{message}"
    );
    assert!(!files.path("run").exists());
}

#[test]
fn a_point_too_fast_for_the_mains_is_not_news_and_one_note_is_said_once() {
    let files = Files::short(4).edit(
        EXPERIMENT,
        "periods = 11",
        "periods = 11\nmains = \"50 Hz\"",
    );
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    let notes: Vec<&str> = finished
        .summary
        .lines()
        .filter(|line| line.starts_with("note: "))
        .collect();
    assert!(
        !notes
            .iter()
            .any(|note| note.contains("takes longer than the record")),
        "{notes:#?}"
    );
}

#[test]
fn a_measurement_goes_on_without_a_reader() {
    let files = Files::short(2);
    let experiment = files.experiment();
    let run = files.path("run");
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_eis-bench"))
        .args([
            "run".as_ref(),
            experiment.as_os_str(),
            "--out".as_ref(),
            run.as_os_str(),
        ])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop((child.stdout.take(), child.stderr.take()));
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert_eq!(manifest_status(&run), "finished");
}

#[test]
fn a_sine_whose_crests_would_leave_the_limits_of_the_cell_is_not_driven() {
    let files = Files::short(2)
        .edit(SCENARIO, "initial_soc = 0.60", "initial_soc = 0.95")
        .edit(EXPERIMENT, "amplitude = \"1 A\"", "amplitude = \"8 A\"")
        .without(EXPERIMENT, "fixture_check");
    let failure = run_experiment(&files.load(), &files.path("run"))
        .err()
        .unwrap()
        .to_string();
    assert!(
        failure.contains("expected crests within 2.5 V to 4.2 V, found up to "),
        "{failure}"
    );
    let expected =
        "eis.start: expected half a period to move at most 324 C (2 % of the capacity), found ";
    let slow = Files::short(2)
        .edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"0.001 Hz\"")
        .edit(EXPERIMENT, "\"1 A\"", "\"2 A\"");
    let refused = slow.run("slow");
    refused.expect_code(2);
    assert!(
        refused.message().contains(expected),
        "{}",
        refused.message()
    );
}
