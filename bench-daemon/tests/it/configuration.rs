//! Mistakes in configuration files are refused before anything is energised, with file, line,
//! field and the expected value.

use std::path::{Path, PathBuf};

use bench_plan::{config::load_experiment, procedure};

pub(crate) fn configs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs")
}

/// The files of the demo and of the accurate bench.
const FILES: [&str; 7] = [
    "benches/demo.toml",
    "benches/accurate.toml",
    "cells/p45b.toml",
    "experiments/demo.toml",
    "experiments/accurate.toml",
    "scenarios/p45b.toml",
    "scenarios/accurate.toml",
];

/// Copies them and replaces one text in one of them.
fn altered(file: &str, from: &str, to: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in FILES {
        let mut text = std::fs::read_to_string(configs().join(name)).unwrap();
        if name == file {
            assert!(text.contains(from), "{name} does not contain {from:?}");
            text = text.replacen(from, to, 1);
        }
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    folder
}

fn complaint(file: &str, from: &str, to: &str) -> String {
    let folder = altered(file, from, to);
    let experiment = if file.ends_with("accurate.toml") {
        "experiments/accurate.toml"
    } else {
        "experiments/demo.toml"
    };
    load_experiment(&folder.path().join(experiment), None)
        .unwrap_err()
        .to_string()
}

#[test]
fn every_file_in_configs_is_sound() {
    for name in ["demo", "thesis", "accurate", "investigate", "campaign"] {
        let experiment =
            load_experiment(&configs().join(format!("experiments/{name}.toml")), None).unwrap();
        procedure::plan(&experiment)
            .check(&experiment.cell.limits)
            .unwrap();
    }
}

#[test]
fn a_campaign_of_more_cells_than_the_simulated_bench_has_is_refused_before_anything_is_done() {
    let cells = "\n[campaign]\nrepeats = 1\n\n[[campaign.cells]]\nname = \"A\"\n\n\
    [[campaign.cells]]\nname = \"B\"\n";
    let folder = altered("experiments/demo.toml", "[fit]", &format!("{cells}\n[fit]"));
    let path = folder.path().join("experiments/demo.toml");
    let message = load_experiment(&path, None).unwrap_err().to_string();
    let limit = "expected at most 1 cell, the number of the simulated bench (specimens.count of ";
    assert!(
        message.contains("campaign.cells: ") && message.contains(limit),
        "{message}"
    );
    assert!(
        message.ends_with("p45b.toml), found 2; \"B\" is the first in excess"),
        "{message}"
    );
    let scenario = folder.path().join("scenarios/p45b.toml");
    let text = std::fs::read_to_string(&scenario).unwrap();
    std::fs::write(&scenario, format!("{text}\n[specimens]\ncount = 2\n")).unwrap();
    assert_eq!(
        load_experiment(&path, None)
            .unwrap()
            .campaign
            .unwrap()
            .cells
            .len(),
        2
    );
}

#[test]
fn two_instruments_cannot_share_a_gpib_adapter() {
    let bench = "benches/demo.toml";
    for (generator, scope) in [("192.0.2.9", "192.0.2.9"), ("localhost", "127.0.0.1")] {
        let folder = altered(
            bench,
            "\"memory:generator\"",
            &format!("\"gpib:tcp:{generator}:1234/8\""),
        );
        let path = folder.path().join(bench);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(
            &path,
            text.replace("\"memory:scope\"", &format!("\"gpib:tcp:{scope}:1234/7\"")),
        )
        .unwrap();
        let message = load_experiment(&folder.path().join("experiments/demo.toml"), None)
            .unwrap_err()
            .to_string();
        assert!(
            message.contains(
                "instruments.scope.address: expected a GPIB adapter of its own, \
        found that of generator"
            ),
            "{message}"
        );
    }
}

#[test]
fn mistakes_are_named_with_file_line_and_field() {
    let experiment = "experiments/demo.toml";
    let bench = "benches/demo.toml";
    for (file, from, to, expected) in [
        (
            experiment,
            "amplitude =",
            "amplitdue =",
            "eis.amplitdue: unknown field `amplitdue`, expected one of `start`",
        ),
        (
            experiment,
            "\"1 A\"",
            "\"1 V\"",
            "eis.amplitude: expected a current with its unit, such as \"1 A\", found \"1 V\"",
        ),
        (
            experiment,
            "\"1 A\"",
            "1.0",
            "eis.amplitude: invalid type: floating point `1.0`, expected a current with its unit",
        ),
        (
            experiment,
            "\"300 Hz\"",
            "\"300 kHz\"",
            "eis.stop: expected 0.1 Hz to 3000 Hz, found 300000 Hz",
        ),
        (
            experiment,
            "\"1 A\"",
            "\"50 A\"",
            "eis.amplitude: expected 0.01 A to 13.5 A, found 50 A",
        ),
        (
            experiment,
            "\"3.52 V\"",
            "\"2.3 V\"",
            "soc_reset.discharge_until: expected 2.55 V to 4.2 V, found 2.3 V",
        ),
        (
            experiment,
            "\"4.2 V\"",
            "\"4.3 V\"",
            "soc_reset.charge_voltage: expected 2.5 V to 4.2 V, found 4.3 V",
        ),
        (
            experiment,
            "\"25 °C\"",
            "\"75 °C\"",
            "temperature.setpoint: expected 0 °C to 60 °C, found 75 °C",
        ),
        (
            experiment,
            "rc = [1, 2, 3, 4]",
            "rc = [0]",
            "fit.rc: expected orders from 1 to 8, found [0]",
        ),
        (experiment, "\"complex\"", "\"fancy\"", "fit.objective: "),
        (
            bench,
            "[instruments.load]",
            "[instruments.lode]",
            "instruments.lode: unknown field `lode`, expected one of `supply4q`",
        ),
        (
            bench,
            "\"siglent-sdl1000x\"",
            "\"siglent-sdl9\"",
            "instruments.load.model: expected one of siglent-sdl1000x, rigol-dl3000, \
            found \"siglent-sdl9\"",
        ),
        (
            bench,
            "\"memory:scope\"",
            "\"tcp:/scope\"",
            "instruments.scope.address: ",
        ),
        (
            bench,
            "\"memory:scope\"",
            "\"vxi11:host:0/inst0\"",
            "instruments.scope.address: port: expected a number from 1 to 65535",
        ),
        (
            bench,
            "\"9.96 mΩ\"",
            "\"9.96 mV\"",
            "wiring.shunt.resistance: expected a resistance with its unit",
        ),
        (
            "experiments/accurate.toml",
            "error = \"2 mΩ\"",
            "error = \"2 %\"",
            "fixture_check.short.error: expected a resistance with its unit",
        ),
        (
            "experiments/accurate.toml",
            "error = \"2 mΩ\"",
            "error = \"2 Ω\"",
            "fixture_check.short.error: expected 0.0000001 Ω to 0.1 Ω, found 2 Ω",
        ),
        (
            "benches/accurate.toml",
            "\"20 µΩ\"",
            "\"0 µΩ\"",
            "controls.short.resistance: expected a resistance above 0 and below 1 Ω, found 0 Ω",
        ),
        (
            "cells/p45b.toml",
            "\"2.5 V\"",
            "\"4.5 V\"",
            "voltage_max: expected more than voltage_min, found 4.2",
        ),
        (
            "cells/p45b.toml",
            "\"5 K/min\"",
            "\"0 K/min\"",
            "interlock.temperature_rate_max: expected 0.1 K/min to 600 K/min, found 0 K/min",
        ),
        (
            "cells/p45b.toml",
            "frozen_charge = \"1 %\"",
            "frozen_charge = \"2 s\"",
            "interlock.frozen_charge: expected a share with its unit",
        ),
        (
            bench,
            "# The bench",
            "guardian = { lease = \"0.1 s\" }\n# The bench",
            "guardian.lease: expected 1 s to 600 s, found 0.1 s",
        ),
    ] {
        let line = 1 + std::fs::read_to_string(configs().join(file))
            .unwrap()
            .split(from)
            .next()
            .unwrap()
            .matches('\n')
            .count();
        let message = complaint(file, from, to);
        let field = expected.split(':').next().unwrap();
        assert!(message.contains(expected), "{message}");
        assert!(message.contains(&format!("{file}:")), "{message}");
        // An error about a field other than the altered one refers to that field's own line.
        if !field.ends_with("voltage_max") {
            assert!(
                message.contains(&format!("{file}:{line}: {field}")),
                "line {line}: {message}"
            );
        }
    }
}

#[test]
fn a_control_needs_its_impedance_and_an_open_jig_its_bounds() {
    let bench = std::fs::read_to_string(configs().join("benches/accurate.toml")).unwrap();
    let start = bench.find("[controls.short]").unwrap();
    let end = start + bench[start..].find("[simulation]").unwrap();
    let message = complaint("benches/accurate.toml", &bench[start..end], "");
    assert!(
        message
            .contains("controls.short: expected its impedance: [fixture_check.short] measures it"),
        "{message}"
    );
    let open = |resistance: &str, capacitance: &str| {
        let text = format!(
            "[controls.open]\nresistance_min = \"{resistance}\"\n\
            capacitance_max = \"{capacitance}\"\n\n[controls.short]"
        );
        complaint("benches/accurate.toml", "[controls.short]", &text)
    };
    let message = open("0 MΩ", "1 nF");
    assert!(
        message
            .contains("controls.open.resistance_min: expected a resistance above 0 Ω, found 0 Ω"),
        "{message}"
    );
    let message = open("1 MΩ", "1 nH");
    assert!(
        message.contains(
            "controls.open.capacitance_max: expected a capacitance with its unit, such as \"1 nF\""
        ),
        "{message}"
    );
    let folder = altered(
        "benches/accurate.toml",
        "[controls.short]",
        "[controls.open]\nresistance_min = \"1 MΩ\"\ncapacitance_max = \"2 nF\"\n\n\
        [controls.short]",
    );
    let open = load_experiment(&folder.path().join("experiments/accurate.toml"), None)
        .unwrap()
        .bench
        .open
        .unwrap();
    assert!(
        (open.g_s - 0.5e-6).abs() < 1e-12 && (open.c_f - 1e-9).abs() < 1e-15,
        "{open:?}"
    );
}

#[test]
fn a_missing_instrument_is_named_with_the_section_that_needs_it() {
    let bench = std::fs::read_to_string(configs().join("benches/demo.toml")).unwrap();
    let start = bench.find("[instruments.load]").unwrap();
    let end = start + bench[start..].find("\n\n").unwrap();
    let message = complaint("benches/demo.toml", &bench[start..end], "");
    assert!(
        message.contains("benches/demo.toml:")
            && message.contains("expected a section [instruments.load]"),
        "{message}"
    );
    assert!(
        message.contains("[soc_reset]") && message.contains("experiments/demo.toml"),
        "{message}"
    );
}

/// Returns the demo with every instrument on a separate port, the scope at another host, and
/// another time.
fn on_ports(scope: &str, time: &str) -> String {
    let folder = altered(
        "benches/demo.toml",
        "[simulation]",
        &format!("[simulation]\ntime = \"{time}\""),
    );
    let bench = folder.path().join("benches/demo.toml");
    let mut text = std::fs::read_to_string(&bench)
        .unwrap()
        .replace("memory:scope", scope);
    for port in 5101.. {
        let Some(start) = text.find("memory:") else {
            break;
        };
        let end = start + text[start..].find('"').unwrap();
        text.replace_range(start..end, &format!("tcp://127.0.0.1:{port}"));
    }
    std::fs::write(&bench, text).unwrap();
    load_experiment(&folder.path().join("experiments/demo.toml"), None)
        .map_or_else(|error| error.to_string(), |_| "accepted".to_owned())
}

#[test]
fn bench_time_fits_the_addresses() {
    let here = "tcp://127.0.0.1:5100";
    assert_eq!(on_ports(here, "scaled:10"), "accepted");
    let message = on_ports(here, "virtual");
    assert!(
        message.contains("simulation.time: virtual time jumps ahead of answers on real ports"),
        "{message}"
    );
    let message = on_ports("tcp://192.0.2.22:5025", "scaled:10");
    assert!(
        message.contains(
            "simulation.time: scaled time is for mocks on this machine, and scope is \
        at tcp://192.0.2.22:5025"
        ),
        "{message}"
    );
}

#[test]
fn what_the_bench_cannot_do_is_refused_before_it_is_begun() {
    let experiment = "experiments/demo.toml";
    let bench = "benches/demo.toml";
    for (file, from, to, expected) in [
        (
            experiment,
            "\"0.1 Hz\"",
            "\"2 mHz\"",
            "eis.start: expected a frame of at most 400 s",
        ),
        (
            experiment,
            "\"0.1 Hz\"",
            "\"299.999999 Hz\"",
            "neighbouring frequencies are the same microhertz",
        ),
        (
            experiment,
            "points = 20",
            "points = 3",
            "fit.rc: expected orders of at most 2 for 3 points, found 3",
        ),
        (
            experiment,
            "[1, 2, 3, 4]",
            "[1, 1]",
            "fit.rc: expected different orders",
        ),
        (
            experiment,
            "[fit]",
            "[diagnosis]\nrc = 5\n[fit]",
            "diagnosis.rc: expected one of the orders of fit.rc, [1, 2, 3, 4], found 5",
        ),
        (
            experiment,
            "charge_until = \"3.80 V\"",
            "charge_until = \"4.2 V\"",
            "soc_reset.charge_until: expected at most 4.180 V",
        ),
        (
            bench,
            "\"memory:scope\"",
            "\"memory:load\"",
            "expected an address of its own, found that of scope",
        ),
        (
            bench,
            "\"memory:scope\"",
            "\"tcp://127.0.0.1:5025\"",
            "expected all instruments in this process",
        ),
        (
            "scenarios/p45b.toml",
            "initial_soc = 0.60",
            "initial_soc = 1.60",
            "cell.initial_soc",
        ),
        (
            "scenarios/p45b.toml",
            "initial_soc",
            "inital_soc",
            "cell.inital_soc: unknown field",
        ),
    ] {
        let message = complaint(file, from, to);
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn quirks_are_checked_against_what_the_model_has_and_a_logger_against_its_inputs() {
    let second = std::fs::read_to_string(configs().join("benches/second.toml")).unwrap();
    for (more, message) in [
        (
            "[simulation.quirks.scope]\npage_byte = 1",
            "rigol-dho800: quirk page_byte: expected one of echo, min_gap, first_answer, late_end, \
            digits, lacks, identity, latency, second_client, page_points, sticky_transfer, \
            stop_delay, busy_opc, unit_after_probe, flash, double_end, block_prefix, unknown, found \
            `page_byte`",
        ),
        (
            "[simulation.quirks.logger]\nunit = \"R\"",
            "siglent-sdm3065x: quirk unit: expected one of C, F, K, found `R`",
        ),
        (
            "[simulation.quirks.load]\nclamps = 1",
            "rigol-dl3000: quirk clamps: expected true or false, found 1",
        ),
        (
            "[simulation.quirks.oven]\necho = true",
            "expected an instrument of this bench (supply4q, generator, scope, load, supply, \
            chiller, logger, jig), found \"oven\"",
        ),
        (
            "[thermostat]\nwindow = \"50 s\"",
            "expected 5 s to 45 s, found 50 s",
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bench.toml");
        std::fs::write(&path, format!("{second}\n{more}\n")).unwrap();
        let met = bench_plan::config::load_bench(&path)
            .unwrap_err()
            .to_string();
        assert!(met.contains(message), "{met}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bench.toml");
    std::fs::write(
        &path,
        second.replace("cell_channel = 1", "cell_channel = 1\nambient_channel = 2"),
    )
    .unwrap();
    let met = bench_plan::config::load_bench(&path)
        .unwrap_err()
        .to_string();
    assert!(
        met.contains("ambient_channel")
            && met.contains(
                "a channel that a siglent-sdm3065x has (one input is channel 1), found 2"
            ),
        "{met}"
    );
}

#[test]
fn limits_beyond_the_cells_own_are_refused_and_useless_ones_are_loudly_said() {
    use crate::support::{CELL, Files, program};
    let plan = |files: &Files| program(&["plan".as_ref(), files.experiment().as_os_str()]);
    let quiet = plan(&Files::short(2));
    quiet.expect_code(0);
    assert_eq!(quiet.stderr, "");
    for (from, to, expected) in [
        (
            "voltage_max = \"4.2 V\"",
            "voltage_max = \"4.3 V\"",
            "voltage_max: expected at most 4.2 V, the cell's absolute limit in [absolute], found \
            4.3 V",
        ),
        (
            "voltage_min = \"2.5 V\"",
            "voltage_min = \"2 V\"",
            "voltage_min: expected at least 2.5 V, the cell's absolute limit in [absolute], found \
            2 V",
        ),
        (
            "charge_current_max = \"13.5 A\"",
            "charge_current_max = \"20 A\"",
            "charge_current_max: expected at most 13.5 A, ",
        ),
        (
            "discharge_current_max = \"45 A\"",
            "discharge_current_max = \"50 A\"",
            "discharge_current_max: expected at most 45 A, ",
        ),
        (
            "temperature_min = \"0 °C\"",
            "temperature_min = \"-10 °C\"",
            "temperature_min: expected at least 0 °C, ",
        ),
        (
            "temperature_max = \"60 °C\"",
            "temperature_max = \"80 °C\"",
            "temperature_max: expected at most 60 °C, ",
        ),
        (
            "capacity = \"4.5 Ah\"",
            "capacity = \"9 Ah\"",
            "capacity: expected at most 4.5 Ah, ",
        ),
    ] {
        let refused = plan(&Files::short(2).edit(CELL, from, to));
        refused.expect_code(2);
        assert!(
            refused.message().contains(expected),
            "{}",
            refused.message()
        );
    }
    let bare = || Files::short(2).without(CELL, "absolute");
    for (from, to, expected) in [
        (
            "voltage_max = \"4.2 V\"",
            "voltage_max = \"4.6 V\"",
            "voltage_max = 4.6 V is above 4.22 V, the greatest voltage of this cell in [ocv]",
        ),
        (
            "voltage_min = \"2.5 V\"",
            "voltage_min = \"1 V\"",
            "voltage_min = 1 V is below 2.48 V, the least voltage of this cell in [ocv]",
        ),
        (
            "charge_current_max = \"13.5 A\"",
            "charge_current_max = \"20 A\"",
            "charge_current_max = 20 A is above 13.725 A, ",
        ),
        (
            "discharge_current_max = \"45 A\"",
            "discharge_current_max = \"90 A\"",
            "discharge_current_max = 90 A is above 67.5 A, ",
        ),
        (
            "temperature_min = \"0 °C\"",
            "temperature_min = \"-40 °C\"",
            "temperature_min = -40 °C is below -20 °C, ",
        ),
        (
            "temperature_max = \"60 °C\"",
            "temperature_max = \"200 °C\"",
            "temperature_max = 200 °C is above 60 °C, ",
        ),
        (
            "\"5 K/min\"",
            "\"600 K/min\"",
            "interlock.temperature_rate_max = 600 K/min is above 20 K/min, ",
        ),
        (
            "charge_max = \"110 %\"",
            "charge_max = \"500 %\"",
            "interlock.charge_max = 500 % is above 125 %, more than any cell holds",
        ),
        (
            "charge_drift_max = \"0.5 %\"",
            "charge_drift_max = \"100 %\"",
            "interlock.charge_drift_max = 100 % is above 10 %, ",
        ),
        (
            "frozen_charge = \"1 %\"",
            "frozen_charge = \"100 %\"",
            "interlock.frozen_charge = 100 % is above 10 %, ",
        ),
        (
            "frozen_time = \"30 s\"",
            "frozen_time = \"3600 s\"",
            "interlock.frozen_time = 3600 s is above 300 s, ",
        ),
        (
            "reading_age_max = \"15 s\"",
            "reading_age_max = \"600 s\"",
            "interlock.reading_age_max = 600 s is above 60 s, ",
        ),
    ] {
        let outcome = plan(&bare().edit(CELL, from, to));
        outcome.expect_code(0);
        let expected = format!("note: A LIMIT OF THE CELL IS TOO WIDE: {expected}");
        assert!(
            outcome.stderr.contains(&expected) && outcome.stderr.lines().count() == 1,
            "{expected}: {}",
            outcome.stderr
        );
    }
    let files = bare().edit(CELL, "\"5 K/min\"", "\"600 K/min\"");
    let ran = files.run("run");
    ran.expect_code(0);
    let outcome = "A LIMIT OF THE CELL IS TOO WIDE: interlock.temperature_rate_max = 600 K/min";
    assert!(
        ran.stderr.contains(outcome) && ran.stdout.contains(outcome),
        "{} {}",
        ran.stderr,
        ran.stdout
    );
    assert!(
        std::fs::read_to_string(files.path("run/report.html"))
            .unwrap()
            .contains(outcome)
    );
}
