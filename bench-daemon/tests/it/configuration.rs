//! Mistakes in configuration files are refused before anything is energised, with file, line, field and what was expected.

use std::path::{Path, PathBuf};

use bench_daemon::{config::load_experiment, procedure};

pub(crate) fn configs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs")
}

/// A copy of the demo's files with one text replaced in one of them.
fn altered(file: &str, from: &str, to: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["benches/demo.toml", "cells/p45b.toml", "experiments/demo.toml", "scenarios/p45b.toml"] {
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
    load_experiment(&folder.path().join("experiments/demo.toml"), None).unwrap_err().to_string()
}

#[test]
fn every_file_in_configs_is_sound() {
    for name in ["demo", "thesis"] {
        let experiment = load_experiment(&configs().join(format!("experiments/{name}.toml")), None).unwrap();
        procedure::plan(&experiment).check(&experiment.cell.limits).unwrap();
    }
}

#[test]
fn mistakes_are_named_with_file_line_and_field() {
    let experiment = "experiments/demo.toml";
    let bench = "benches/demo.toml";
    for (file, from, to, expected) in [
        (experiment, "amplitude =", "amplitdue =", "eis.amplitdue: unknown field `amplitdue`, expected one of `start`"),
        (experiment, "\"1 A\"", "\"1 V\"", "eis.amplitude: expected a current with its unit, such as \"1 A\", found \"1 V\""),
        (experiment, "\"1 A\"", "1.0", "eis.amplitude: invalid type: floating point `1.0`, expected a current with its unit"),
        (experiment, "\"300 Hz\"", "\"300 kHz\"", "eis.stop: expected 0.1 Hz to 10000 Hz, found 300000 Hz"),
        (experiment, "\"1 A\"", "\"50 A\"", "eis.amplitude: expected 0.01 A to 13.5 A, found 50 A"),
        (experiment, "\"3.52 V\"", "\"2.3 V\"", "soc_reset.discharge_until: expected 2.55 V to 4.2 V, found 2.3 V"),
        (experiment, "\"4.2 V\"", "\"4.3 V\"", "soc_reset.charge_voltage: expected 2.5 V to 4.2 V, found 4.3 V"),
        (experiment, "\"25 °C\"", "\"75 °C\"", "temperature.setpoint: expected 0 °C to 60 °C, found 75 °C"),
        (experiment, "rc = [1, 2, 3, 4]", "rc = [0]", "fit.rc: expected orders from 1 to 6, found [0]"),
        (experiment, "\"complex\"", "\"fancy\"", "fit.objective: "),
        (bench, "[instruments.load]", "[instruments.lode]", "instruments.lode: unknown field `lode`, expected one of `supply4q`"),
        (
            bench,
            "\"siglent-sdl1000x\"",
            "\"siglent-sdl9\"",
            "instruments.load.model: expected one of siglent-sdl1000x, found \"siglent-sdl9\"",
        ),
        (bench, "\"memory:scope\"", "\"tcp:/scope\"", "instruments.scope.address: "),
        (bench, "\"9.96 mΩ\"", "\"9.96 mV\"", "wiring.shunt.resistance: expected a resistance with its unit"),
        ("cells/p45b.toml", "\"2.5 V\"", "\"4.5 V\"", "voltage_max: expected more than voltage_min, found 4.2"),
    ] {
        let line = 1 + std::fs::read_to_string(configs().join(file)).unwrap().split(from).next().unwrap().matches('\n').count();
        let message = complaint(file, from, to);
        let field = expected.split(':').next().unwrap();
        assert!(message.contains(expected), "{message}");
        assert!(message.contains(&format!("{file}:")), "{message}");
        // A complaint about another field than the altered one points at that field's own line.
        if !field.ends_with("voltage_max") {
            assert!(message.contains(&format!("{file}:{line}: {field}")), "line {line}: {message}");
        }
    }
}

#[test]
fn a_missing_instrument_is_named_with_the_section_that_needs_it() {
    let bench = std::fs::read_to_string(configs().join("benches/demo.toml")).unwrap();
    let start = bench.find("[instruments.load]").unwrap();
    let end = start + bench[start..].find("\n\n").unwrap();
    let message = complaint("benches/demo.toml", &bench[start..end], "");
    assert!(message.contains("benches/demo.toml:") && message.contains("expected a section [instruments.load]"), "{message}");
    assert!(message.contains("[soc_reset]") && message.contains("experiments/demo.toml"), "{message}");
}

#[test]
fn virtual_time_on_real_ports_is_refused() {
    let folder = altered("benches/demo.toml", "\"memory:scope\"", "\"tcp://127.0.0.1:1\"");
    let bench = folder.path().join("benches/demo.toml");
    let text = std::fs::read_to_string(&bench).unwrap().replace("[simulation]", "[simulation]\ntime = \"virtual\"");
    std::fs::write(&bench, text).unwrap();
    let message = load_experiment(&folder.path().join("experiments/demo.toml"), None).unwrap_err().to_string();
    assert!(message.contains("simulation.time: virtual time jumps ahead of answers on real ports"), "{message}");
}

#[test]
fn scaled_time_on_an_instrument_elsewhere_is_refused() {
    let folder = altered("benches/demo.toml", "\"memory:scope\"", "\"tcp://192.168.1.22:5025\"");
    let bench = folder.path().join("benches/demo.toml");
    let text = std::fs::read_to_string(&bench).unwrap().replace("[simulation]", "[simulation]\ntime = \"scaled:10\"");
    std::fs::write(&bench, text).unwrap();
    let message = load_experiment(&folder.path().join("experiments/demo.toml"), None).unwrap_err().to_string();
    assert!(
        message.contains("simulation.time: scaled time is for mocks on this machine, and scope is at tcp://192.168.1.22:5025"),
        "{message}"
    );
}
