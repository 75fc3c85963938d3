//! A bench whose bipolar supply has no link, as that of the thesis: the generator commands it with a
//! gain of −2 A/V, and scope and voltmeter show what flows.

use std::fs;

use bench_daemon::command::run::run_experiment;
use bench_plan::{
    config::{load_bench, load_experiment},
    procedure,
};

use instruments::units::{Amps, Volts};

use crate::support::{BENCH, EXPERIMENT, Files, SCENARIO, program, sent};

const LINKED: &str = "model = \"kepco-bop-mg\"\naddress = \"memory:supply4q\"";
const ANALOG: &str =
    "model = \"analog\"\ngain = \"-2 A/V\"\nfull_scale = \"20 A\"\nmax_frequency = \"3 kHz\"";
/// The supply of the thesis, whose zero error is cancelled by −0.28 V.
const TRUE_SUPPLY: &str = "[drives.bipolar]\ngain_a_per_v = -2.0\nzero_error_a = -0.56";

fn analog(points: usize, supply: &str) -> Files {
    Files::short(points)
        .edit(BENCH, LINKED, ANALOG)
        .edit(
            BENCH,
            "command_offset = \"0 V\"",
            "command_offset = \"-0.28 V\"",
        )
        .append(SCENARIO, supply)
}

fn failure(files: &Files) -> String {
    let outcome = run_experiment(&files.load(), &files.path("run"));
    outcome.map(|_| ()).unwrap_err().to_string()
}

#[test]
fn a_sweep_on_an_analog_supply_of_negative_gain_measures_the_impedances_of_a_linked_one() {
    let files = analog(3, TRUE_SUPPLY);
    let swept = run_experiment(&files.load(), &files.path("run")).unwrap();
    let other = Files::short(3);
    let linked = run_experiment(&other.load(), &other.path("run")).unwrap();
    let pairs = swept.measured.spectrum.points.iter();
    for (one, other) in pairs.zip(&linked.measured.spectrum.points) {
        assert_eq!(one.freq_hz, other.freq_hz);
        let apart = (one.z_ohm - other.z_ohm).norm() / other.z_ohm.norm();
        assert!(apart < 5.0e-3, "{one:?} {other:?}");
    }
    let events = fs::read_to_string(files.path("run/events.csv")).unwrap();
    assert!(
        events.contains("bipolar supply (analog): +0.250 A commanded, +0.2"),
        "{events}"
    );
    // −0.28 V − A/2: the step of 0.25 A, charge positive, and the amplitude of 1 A.
    let sent = sent(&files.path("run"), "generator");
    assert!(
        sent.iter().any(|text| text.contains("OFST,-0.4050")),
        "{sent:#?}"
    );
    assert!(
        sent.iter()
            .any(|text| text.contains("AMP,1.0000,OFST,-0.2800")),
        "{sent:#?}"
    );
    // Without its offset the zero error of the supply would flow: once on, the output stays on.
    let on = sent.iter().position(|text| text == "C1:OUTP ON").unwrap();
    assert!(
        !sent[on..].iter().any(|text| text == "C1:OUTP OFF"),
        "{sent:#?}"
    );
    let last = sent
        .iter()
        .rfind(|text| text.starts_with("C1:BSWV "))
        .unwrap();
    assert!(last.contains("AMP,0.0020,OFST,-0.2800"), "{last}");
}

#[test]
fn another_sign_or_gain_or_a_supply_that_is_off_is_found_before_anything_is_driven() {
    for (supply, expected) in [
        (
            "[drives.bipolar]\ngain_a_per_v = 2.0\nzero_error_a = 0.56",
            "the sign of instruments.supply4q.gain is wrong",
        ),
        (
            "[drives.bipolar]\ngain_a_per_v = -1.0\nzero_error_a = -0.28",
            "instruments.supply4q.gain would have to be 0.4",
        ),
        (
            "[drives.bipolar]\ngain_a_per_v = -0.02\nzero_error_a = 0.0",
            "is the supply switched on",
        ),
        (
            "[drives.bipolar]\ngain_a_per_v = -2.0\nzero_error_a = 1.0",
            "adjust wiring.command_offset",
        ),
    ] {
        let files = analog(2, supply);
        let failure = failure(&files);
        assert!(failure.contains(expected), "{supply}: {failure}");
        let driven: Vec<String> = sent(&files.path("run"), "generator")
            .into_iter()
            .filter(|text| text.contains("AMP,1.0"))
            .collect();
        assert_eq!(driven, [""; 0], "{supply}: no sinusoid");
    }
}

#[test]
fn a_run_and_its_plan_never_tell_that_an_analog_supply_is_off() {
    let files = analog(2, TRUE_SUPPLY);
    let experiment = files.load();
    let plan = procedure::plan(&experiment)
        .check(&experiment.cell.limits)
        .unwrap();
    let up: Vec<String> = plan
        .plan()
        .stages
        .iter()
        .flat_map(|stage| &stage.steps)
        .map(ToString::to_string)
        .filter(|text| text.contains("the program cannot switch, limit or read it"))
        .collect();
    assert!(up.len() >= 3, "each stage that drives: {up:?}");
    let printed = program(&["plan".as_ref(), files.experiment().as_os_str()]);
    assert!(
        printed.stdout.contains("is not switched by the program"),
        "{}",
        printed.stdout
    );
    let ran = files.run("run");
    assert_eq!(ran.code, Some(0), "{}", ran.stderr);
    let all = format!("{}{}", ran.stdout, ran.stderr);
    assert!(!all.contains("every output is off"), "{all}");
    assert!(
        all.contains("the bipolar supply (analog) is not switched by this program"),
        "{all}"
    );
    let bench = files.path(BENCH);
    let identified = program(&["identify".as_ref(), bench.as_os_str()]);
    assert_eq!(identified.code, Some(0), "{}", identified.stderr);
    assert!(
        identified.stdout.contains("no link: -2 A/V, rated 20 A"),
        "{}",
        identified.stdout
    );
    let doctor = |more: &[&str]| {
        let (out, folder) = ("--out", files.path("doctor"));
        let mut arguments: Vec<&std::ffi::OsStr> = vec!["doctor".as_ref(), bench.as_os_str()];
        arguments.extend([out.as_ref(), folder.as_os_str()]);
        arguments.extend(more.iter().map(std::ffi::OsStr::new));
        program(&arguments)
    };
    let examined = doctor(&[]);
    assert_eq!(
        examined.code,
        Some(0),
        "{}{}",
        examined.stdout,
        examined.stderr
    );
    assert!(
        examined.stdout.contains("each power-up of a run tests it")
            && examined.stdout.contains("is not switched by this program"),
        "{}",
        examined.stdout
    );
    let refused = doctor(&["--fixture", "fake_cell", "--operator", "A", "--yes"]);
    assert_eq!(refused.code, Some(2));
    assert!(
        refused.stderr.contains("expected no --fixture"),
        "{}",
        refused.stderr
    );
}

/// A cell that leaves its voltage limits on an analog supply is seen by the load's voltmeter.
#[test]
fn the_voltmeter_of_the_load_watches_the_cell_on_an_analog_supply() {
    let files = analog(2, TRUE_SUPPLY).edit(
        "cells/p45b.toml",
        "voltage_max = \"4.2 V\"",
        "voltage_max = \"3.6 V\"",
    );
    let failure = failure(&files);
    assert!(failure.contains("cell voltage"), "{failure}");
}

#[test]
fn what_an_analog_supply_lacks_or_what_needs_an_ammeter_is_refused() {
    let refused = |files: Files| {
        load_experiment(&files.experiment(), None)
            .unwrap_err()
            .to_string()
    };
    let bench = |from: &str, to: &str| analog(2, TRUE_SUPPLY).edit(BENCH, from, to);
    for (files, expected) in [
        (
            bench("gain = \"-2 A/V\"\n", ""),
            "instruments.supply4q.gain: expected the gain",
        ),
        (
            bench("\"-2 A/V\"", "\"0 A/V\""),
            "expected 0.01 A/V to 100 A/V of either sign, found 0",
        ),
        (
            bench("\"-2 A/V\"", "\"-2 A\""),
            "expected a current per volt with its unit",
        ),
        (
            bench("full_scale = \"20 A\"\n", ""),
            "instruments.supply4q.full_scale: expected the rated",
        ),
        (
            bench(
                "model = \"analog\"",
                "model = \"analog\"\naddress = \"memory:supply4q\"",
            ),
            "instruments.supply4q.address: expected none: an analog supply has no link",
        ),
        (
            bench("\"-0.28 V\"", "\"0.6 V\""),
            "wiring.command_offset: expected -0.5 V to 0.5 V",
        ),
        (
            bench("\"-2 A/V\"", "\"-5 A/V\""),
            "wiring.command_offset: expected -0.2 V to 0.2 V",
        ),
        (
            analog(2, TRUE_SUPPLY).without(BENCH, "instruments.load"),
            "instruments.load: expected a section [instruments.load]: an analog supply has no meter",
        ),
        (
            analog(2, TRUE_SUPPLY).edit(
                EXPERIMENT,
                "amplitude = \"1 A\"",
                "amplitude = \"1 A\"\nbias = [\"1 A\"]\nresistance_max = \"15 mΩ\"",
            ),
            "eis.bias: expected none: it needs a bipolar supply that measures its current",
        ),
        (
            Files::short(2).edit(BENCH, LINKED, &format!("{LINKED}\ngain = \"2 A/V\"")),
            "instruments.supply4q.gain: expected none: only the model \"analog\" needs it",
        ),
        (
            Files::short(2).edit(BENCH, LINKED, &format!("{LINKED}\nrating = \"20-10M\"")),
            "instruments.supply4q.rating: expected model = \"kepco-bop-linear\" for a BOP 20-10",
        ),
    ] {
        let text = refused(files);
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn the_benches_of_the_thesis_are_as_they_were_built() {
    let configs = crate::configuration::configs();
    let (thesis, _) = load_bench(&configs.join("benches/thesis.toml")).unwrap();
    assert_eq!(thesis.bipolar_model(), Some("analog"));
    // −0.28 V − A/2, the amplitude multiplied by 1.045.
    let offset_v =
        |amps: f64| thesis.wiring.command_offset_v + Volts(amps * thesis.wiring.volts_per_amp);
    assert_eq!(
        [offset_v(0.0), offset_v(1.0), offset_v(-2.0)],
        [-0.28, -0.78, 0.72].map(Volts)
    );
    assert!((thesis.wiring.command_v(Amps(1.0)) + Volts(0.5225)).abs() < Volts(1e-12));
    let addresses: Vec<String> = thesis
        .instruments
        .addressed()
        .iter()
        .map(|(role, instrument)| format!("{role} {}", instrument.address))
        .collect();
    let usb = addresses
        .iter()
        .filter(|text| text.contains("usbtmc:"))
        .count();
    assert_eq!(usb, 3, "{addresses:?}");
    assert!(
        addresses
            .iter()
            .any(|text| text.starts_with("generator vxi11:")),
        "{addresses:?}"
    );
    let (network, _) = load_bench(&configs.join("benches/thesis-network.toml")).unwrap();
    assert_eq!(network.bipolar_model(), Some("kepco-bop-mg"));
    load_experiment(&configs.join("experiments/thesis.toml"), None).unwrap();
    // A rating changes the amperes per volt.
    let files = Files::short(2).edit(
        BENCH,
        "model = \"kepco-bop-mg\"",
        "model = \"kepco-bop-linear\"\nrating = \"36-12M\"",
    );
    let (bench, _) = load_bench(&files.path(BENCH)).unwrap();
    assert!((bench.wiring.volts_per_amp - 10.0 / 12.0).abs() < 1e-12);
}
