//! A model that was typed, a file of nothing but resistances and capacitances, and a fitted
//! circuit, through every command that takes a model.

use std::{fs, path::Path};

use serde_json::Value;

use crate::support::{json, program_in};

const ERM: &str = "6.43 mΩ; 1.51 mOhm, 0.553 F; 0.66 mΩ, 4.6 ms; 4.77 mohm, 1.084 kF";
const PLAIN: &str = r#"{"r_ohm": 0.00643, "branches": [{"r_ohm": 0.00151, "c_f": 0.553},
    {"r_ohm": 0.00066, "c_f": 6.96969696969697}, {"r_ohm": 0.00477, "c_f": 1084.0}]}"#;

#[track_caller]
fn done(folder: &Path, arguments: &[&str]) -> String {
    let (code, message) = program_in(folder, arguments).outcome();
    assert_eq!(code, 0, "{arguments:?}: {message}");
    message
}

#[track_caller]
fn refused(folder: &Path, arguments: &[&str]) -> String {
    let (code, message) = program_in(folder, arguments).outcome();
    assert_eq!(code, 2, "{arguments:?}: {message}");
    message
}

#[track_caller]
fn answer(folder: &Path, arguments: &[&str]) -> Value {
    serde_json::from_str(&done(folder, &[arguments, &["--json"]].concat())).unwrap()
}

/// 10 mΩ + (5 mΩ ∥ CPE of 3 Ω⁻¹s^0.8), by real arithmetic.
fn arc(freq_hz: f64) -> (f64, f64) {
    let admittance = 3.0 * (std::f64::consts::TAU * freq_hz).powf(0.8);
    let (g, b) = (
        200.0 + admittance * (0.4 * std::f64::consts::PI).cos(),
        admittance * (0.4 * std::f64::consts::PI).sin(),
    );
    (0.010 + g / (g * g + b * b), -b / (g * g + b * b))
}

/// Returns a folder with `plain.json`, `circuit.json` of the arc from 10 mHz to 10 kHz as `fit
/// --circuit` writes it, an OCV curve and a pulse.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("plain.json", PLAIN);
    write("pulse.csv", "time_s,current_a\n0,10\n100,0\n101,0\n");
    write(
        "ocv.json",
        r#"{"capacity_ah": 4.5, "soc": [0, 1], "ocv_v": [3.0, 4.2], "slope_v": [1.2, 1.2]}"#,
    );
    let row = |k: i32| {
        let freq_hz = 0.01 * 1.0e6_f64.powf(f64::from(k) / 29.0);
        let (re, im) = arc(freq_hz);
        format!("{freq_hz},{re},{im}\n")
    };
    write("cell.csv", &(0..30).map(row).collect::<String>());
    done(
        folder.path(),
        &[
            "fit",
            "cell.csv",
            "--circuit",
            "R0-p(R1,CPE1)",
            "--out",
            "fit",
        ],
    );
    fs::copy(
        folder.path().join("fit/circuit.json"),
        folder.path().join("circuit.json"),
    )
    .unwrap();
    folder
}

/// Arguments that name the model in the three ways.
const WAYS: [[&str; 2]; 3] = [
    ["--erm", ERM],
    ["--model", "plain.json"],
    ["--model", "circuit.json"],
];

/// DC resistance in each of the three ways, Ω.
const DC_OHM: [f64; 3] = [0.01337, 0.01337, 0.015];

fn near(value: &Value, expected: f64, tolerance: f64) {
    let met = value.as_f64().unwrap_or_else(|| panic!("{value}"));
    assert!(
        (met - expected).abs() <= tolerance,
        "{met}, expected {expected}"
    );
}

#[test]
fn simulate_takes_a_model_in_each_way_and_invents_no_uncertainty() {
    let folder = folder();
    let mut answers = Vec::new();
    for (way, dc_ohm) in WAYS.iter().zip(DC_OHM) {
        let found = answer(
            folder.path(),
            &[&[
                "simulate",
                way[0],
                way[1],
                "--profile",
                "pulse.csv",
                "--ocv-v",
                "3.72",
            ][..]]
            .concat(),
        );
        // 100 s are 19 of the longest time constant of the typed model; the arc's tail is still 0.3
        // % away.
        near(&found["min_ccv_v"], 3.72 - 10.0 * dc_ohm, 5e-4);
        near(&found["simple_ir"]["dcir_ohm"], dc_ohm, 1e-5);
        assert!(
            found["min_ccv_sigma_v"].is_null() && found["band"].is_null(),
            "{found}"
        );
        answers.push(found);
    }
    let notes = |k: usize| answers[k]["notes"].to_string();
    assert!(
        notes(0).contains("it has no uncertainty") && notes(1).contains("it has no uncertainty"),
        "{}",
        notes(0)
    );
    assert!(
        notes(2).contains("off by at most")
            && notes(2).contains("from 1 mHz to 100 kHz (data 10 mHz to 10 kHz)"),
        "{}",
        notes(2)
    );
    assert!(
        notes(2).contains("the ladder has no uncertainty"),
        "{}",
        notes(2)
    );
    near(
        &answers[1]["min_ccv_v"],
        answers[0]["min_ccv_v"].as_f64().unwrap(),
        1e-9,
    );
    let text = done(
        folder.path(),
        &[
            "simulate",
            "--model",
            "circuit.json",
            "--profile",
            "pulse.csv",
            "--ocv-v",
            "3.72",
        ],
    );
    assert!(
        text.contains("note: the circuit R0-p(R1,CPE1) as a ladder of") && !text.contains("±"),
        "{text}"
    );
}

#[test]
fn a_typed_model_gets_its_voltage_from_a_curve_or_says_that_it_lacks_one() {
    let folder = folder();
    let base = ["--erm", ERM, "--profile", "pulse.csv"];
    let found = answer(
        folder.path(),
        &[
            &["simulate"],
            &base[..],
            &["--soc", "0.5", "--ocv", "ocv.json"],
        ]
        .concat(),
    );
    // 1000 As of 4.5 Ah move 1.2 V per unit of charge by 74 mV.
    near(
        &found["min_ccv_v"],
        3.6 - 0.1337 - 1.2 * 1000.0 / 16_200.0,
        5e-4,
    );
    let text = refused(
        folder.path(),
        &[&["simulate"], &base[..], &["--soc", "0.5"]].concat(),
    );
    assert!(
        text.contains(
            "--soc: expected a model with an OCV curve, --erm has none; give --ocv-v \
        instead, or a curve with --ocv"
        ),
        "{text}"
    );
    let text = refused(
        folder.path(),
        &["sop", "--model", "plain.json", "--soc", "0.5"],
    );
    assert!(
        text.contains("--soc: plain.json holds no OCV curve; give --ocv-v, or a curve with --ocv"),
        "{text}"
    );
    let pack = ["pack", "simulate", "--series", "2", "--parallel", "2"];
    let text = refused(
        folder.path(),
        &[&pack[..], &base[..], &["--soc", "0.5"]].concat(),
    );
    assert!(
        text.contains("--soc: --erm holds no OCV curve; give --ocv-v, or a curve with --ocv"),
        "{text}"
    );
    let data = folder.path().join("data");
    fs::create_dir(&data).unwrap();
    let text = refused(folder.path(), &["diagnose", "data", "--erm", ERM]);
    assert!(
        text.contains("--erm: expected an OCV curve in it, found none; give one with --ocv"),
        "{text}"
    );
}

#[test]
fn sop_and_both_pack_commands_take_a_model_in_each_way() {
    let folder = folder();
    for (way, dc_ohm) in WAYS.iter().zip(DC_OHM) {
        let sop = answer(
            folder.path(),
            &[
                "sop",
                way[0],
                way[1],
                "--ocv-v",
                "3.6",
                "--duration-s",
                "0.1,1000",
            ],
        );
        // Down to 2.5 V at the full DC resistance: 2.5·(3.6 − 2.5)/R.
        near(&sop["map"][1]["discharge_w"], 2.5 * 1.1 / dc_ohm, 0.5);
        assert!(sop["notes"].to_string().contains("no uncertainty"), "{sop}");
        let curve = answer(
            folder.path(),
            &[
                "sop",
                way[0],
                way[1],
                "--soc",
                "0.5",
                "--ocv",
                "ocv.json",
                "--duration-s",
                "1",
            ],
        );
        near(&curve["map"][0]["ocv_v"], 3.6, 1e-9);

        let size = [
            "pack",
            "size",
            "--series",
            "16",
            "--parallel",
            "3",
            "--ocv-v",
            "3.6",
        ];
        let sized = answer(folder.path(), &[&size[..], way].concat());
        let by_hand = answer(
            folder.path(),
            &[&size[..], &["--dcir-ohm", &sized["dcir_ohm"].to_string()]].concat(),
        );
        near(&sized["dcir_ohm"], dc_ohm, 1e-5);
        assert_eq!(sized["peak_power_w"], by_hand["peak_power_w"]);

        let pack = [
            "pack",
            "simulate",
            "--profile",
            "pulse.csv",
            "--series",
            "2",
            "--parallel",
            "2",
            "--ocv-v",
            "3.6",
            "--draws",
            "5",
        ];
        let packed = answer(folder.path(), &[&pack[..], way].concat());
        near(&packed["identical"]["min_cell_v"], 3.6 - 5.0 * dc_ohm, 1e-3);
        assert!(
            packed["notes"].to_string().contains("no uncertainty"),
            "{packed}"
        );
    }
}

#[test]
fn convert_writes_a_model_in_each_way_with_the_error_of_a_ladder() {
    let folder = folder();
    for (k, way) in [["--erm", ERM], ["plain.json", ""], ["circuit.json", ""]]
        .into_iter()
        .enumerate()
    {
        let model: Vec<&str> = way.into_iter().filter(|word| !word.is_empty()).collect();
        let stem = ["typed", "plain", "circuit"][k];
        for (to, ending, number) in [
            ("c", ".h", "16200"),
            ("pybamm", "_pybamm.py", "4.5"),
            ("casadi", "_casadi.py", "16200"),
        ] {
            let out = format!("{to}{k}");
            let given = ["--to", to, "--out", &out, "--ocv", "ocv.json"];
            let message = done(
                folder.path(),
                &[&["convert"], &model[..], &given[..]].concat(),
            );
            let text = fs::read_to_string(folder.path().join(&out).join(format!("{stem}{ending}")))
                .unwrap();
            assert!(text.contains(number), "{text}");
            assert_eq!(
                text.contains("off by at most") && message.contains("off by at most"),
                k == 2,
                "{message} {text}"
            );
            assert!(text.contains("no uncertainty"), "{text}");
        }
        // A model file of it, which is accepted wherever a model is.
        let out = format!("model{k}");
        done(
            folder.path(),
            &[&["convert"], &model[..], &["--to", "model", "--out", &out]].concat(),
        );
        let file = format!("{out}/{stem}_model.json");
        let written = json(&folder.path().join(&file));
        assert!(
            written["r_ohm"].is_number()
                && written.get("fit").is_none()
                && written.get("sigma").is_none(),
            "{written}"
        );
        assert_eq!(
            written["ladder"]["worst_relative_error"]
                .as_f64()
                .is_some_and(|error| error < 1e-3),
            k == 2,
            "{written}"
        );
        let direct = if k == 0 {
            ["--erm", ERM]
        } else {
            ["--model", model[0]]
        };
        let profile = ["--profile", "pulse.csv", "--ocv-v", "3.7"];
        let found = [direct, ["--model", &file]].map(|way| {
            answer(
                folder.path(),
                &[&["simulate"], &way[..], &profile[..]].concat(),
            )
        });
        assert_eq!(found[0]["min_ccv_v"], found[1]["min_ccv_v"]);
        assert_eq!(found[0]["notes"], found[1]["notes"]);
    }
    let text = refused(
        folder.path(),
        &["convert", "--erm", ERM, "--to", "gamry", "--out", "x"],
    );
    assert!(
        text.contains(
            "--erm: expected with --to c, pybamm, casadi, simscape, fmu, modelica or model"
        ),
        "{text}"
    );
    let text = refused(
        folder.path(),
        &["convert", "--erm", ERM, "--to", "c", "--out", "x"],
    );
    assert!(
        text.contains("expected an open-circuit voltage over the state of charge, met none"),
        "{text}"
    );
}

#[test]
fn a_resistance_alone_is_a_model_that_a_compiler_takes() {
    let folder = folder();
    let given = [
        "--to",
        "c",
        "--out",
        "bare",
        "--ocv-v",
        "3.7",
        "--capacity-ah",
        "4.5",
    ];
    done(
        folder.path(),
        &[&["convert", "--erm", "10 mΩ"], &given[..]].concat(),
    );
    fs::write(
        folder.path().join("bare/main.c"),
        "#include <stdio.h>\n#include \"typed.h\"\n\
        int main(void) { eis_state s; eis_rest(&s, 0.5); printf(\"%.6f\", eis_step(&s, 10.0, \
        1.0)); return 0; }\n",
    )
    .unwrap();
    let arguments = [
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-pedantic",
        "-Werror",
        "-o",
        "main",
        "main.c",
        "-lm",
    ];
    let Ok(compiled) = std::process::Command::new("cc")
        .current_dir(folder.path().join("bare"))
        .args(arguments)
        .output()
    else {
        eprintln!("skipped: no C compiler");
        return;
    };
    assert!(
        compiled.status.success(),
        "{}",
        String::from_utf8_lossy(&compiled.stderr)
    );
    let output = std::process::Command::new(folder.path().join("bare/main"))
        .output()
        .unwrap();
    assert_eq!(String::from_utf8(output.stdout).unwrap(), "3.600000");
}

#[test]
fn a_circuit_without_dc_resistance_says_so_everywhere() {
    let folder = folder();
    let warburg = r#"{"fits": [{
        "circuit": "L0-R0-p(R1-W1,CPE1)",
        "values": [2e-8, 0.006, 0.002, 0.0005, 2.0, 0.85],
        "band_hz": [0.01, 10000.0]
    }]}"#;
    fs::write(folder.path().join("warburg.json"), warburg).unwrap();
    let text = done(
        folder.path(),
        &[
            "simulate",
            "--model",
            "warburg.json",
            "--profile",
            "pulse.csv",
            "--ocv-v",
            "3.72",
        ],
    );
    assert!(
        text.contains("the circuit has no DC resistance") && text.contains("longer than 159 s"),
        "{text}"
    );
    assert!(
        text.contains("left out, because a ladder of RC has no inductance: L0, 1.26 mΩ"),
        "{text}"
    );
    let size = [
        "pack",
        "size",
        "--series",
        "16",
        "--parallel",
        "3",
        "--ocv-v",
        "3.6",
        "--model",
        "warburg.json",
    ];
    let text = refused(folder.path(), &size);
    assert!(
        text.contains(
            "warburg.json: expected a model with a DC resistance, met a circuit \
    without one; give --dcir-ohm"
        ),
        "{text}"
    );
    // Another band moves the horizon.
    let slow = [
        "simulate",
        "--model",
        "warburg.json",
        "--ladder-band-hz",
        "1e-5,1e4",
        "--profile",
        "pulse.csv",
        "--ocv-v",
        "3.72",
    ];
    assert!(done(folder.path(), &slow).contains("longer than 15915 s"));
    let euler = [
        "simulate",
        "--model",
        "warburg.json",
        "--profile",
        "hour.csv",
        "--ocv-v",
        "3.72",
        "--method",
        "thesis",
    ];
    fs::write(folder.path().join("hour.csv"), "0,1\n3600,0\n").unwrap();
    assert!(refused(folder.path(), &euler).contains("--method thesis: expected at most 1e8 steps"));
    let text = refused(
        folder.path(),
        &[
            "simulate",
            "--erm",
            ERM,
            "--ladder-band-hz",
            "1,2",
            "--profile",
            "pulse.csv",
            "--ocv-v",
            "3.72",
        ],
    );
    assert!(
        text.contains("--ladder-band-hz: expected a fitted circuit to follow, met --erm"),
        "{text}"
    );
}

#[test]
fn what_is_not_a_model_is_refused_with_the_place() {
    let folder = folder();
    let run = |model: [&str; 2]| {
        refused(
            folder.path(),
            &[
                "simulate",
                model[0],
                model[1],
                "--profile",
                "pulse.csv",
                "--ocv-v",
                "3.72",
            ],
        )
    };
    let text = run(["--erm", "6.43 mΩ; 1.51 mΩ, 0.553"]);
    let expected = "--erm: element 2, \"1.51 mΩ, 0.553\": expected a capacitance or a time \
    constant with its unit, such as \"0.553 F\" or \"0.8 ms\", found \"0.553\"";
    assert!(text.contains(expected), "{text}");
    assert!(
        run(["--model", "ocv.json"])
            .contains("--model ocv.json: expected a model file (schema, …), a typed model")
    );
    let text = refused(
        folder.path(),
        &["simulate", "--profile", "pulse.csv", "--ocv-v", "3.72"],
    );
    let expected = "expected --model or --erm, found neither";
    assert!(text.contains(expected), "{text}");
    let text = refused(
        folder.path(),
        &[
            "sop",
            "--model",
            "plain.json",
            "--erm",
            ERM,
            "--ocv-v",
            "3.6",
        ],
    );
    assert!(text.contains("cannot be used with"), "{text}");
}

#[test]
#[ignore = "long drill"]
fn diagnose_takes_a_model_in_each_way_and_repeats_it() {
    let folder = tempfile::tempdir().unwrap();
    let spec = study::hidden::Spec::null(3);
    crate::diagnose::campaign(folder.path(), &spec);
    let model = json(&folder.path().join("model.json"));
    let erm = &model["fit"]["erm"];
    fs::write(folder.path().join("ocv.json"), model["ocv"].to_string()).unwrap();
    fs::write(folder.path().join("plain.json"), erm.to_string()).unwrap();
    let branches = erm["branches"].as_array().unwrap();
    let typed = branches
        .iter()
        .fold(format!("{} Ω", erm["r_ohm"]), |text, b| {
            format!("{text}; {} Ω, {} F", b["r_ohm"], b["c_f"])
        });
    let values: Vec<f64> = std::iter::once(&erm["r_ohm"])
        .chain(branches.iter().flat_map(|b| [&b["r_ohm"], &b["c_f"]]))
        .map(|v| v.as_f64().unwrap())
        .collect();
    // A Zarc whose exponent is 1 is the third branch, found by the ladder.
    let mut values = values;
    let last = values.len() - 2;
    values[last + 1] *= values[last];
    values.push(1.0);
    let circuit = serde_json::json!({"fits": [{
        "circuit": "R0-p(R1,C1)-p(R2,C2)-Zarc3", "values": values, "band_hz": [0.1, 300.0]
    }]});
    fs::write(folder.path().join("circuit.json"), circuit.to_string()).unwrap();
    let base = answer(
        folder.path(),
        &["diagnose", "data", "--model", "model.json"],
    );
    for (way, out) in [
        (["--erm", &typed], "out1"),
        (["--model", "plain.json"], "out2"),
        (["--model", "circuit.json"], "out3"),
    ] {
        let given = [
            "diagnose", "data", way[0], way[1], "--ocv", "ocv.json", "--out", out,
        ];
        let found = answer(folder.path(), &given);
        assert_eq!(found["verdict"], base["verdict"], "{out}");
        assert!(
            found["notes"].to_string().contains("no uncertainty"),
            "{}",
            found["notes"]
        );
        let page = fs::read_to_string(folder.path().join(out).join("diagnosis.html")).unwrap();
        assert!(
            page.contains(&format!("eis-bench diagnose data {} ", way[0])),
            "{out}"
        );
    }
}
