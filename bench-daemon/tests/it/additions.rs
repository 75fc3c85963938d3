//! Commands on a model with additions: which ones take effect, which ones are omitted with a
//! message, and which ones are refused.

use serde_json::{Value, json};

use crate::support::{json as read_json, program_in, project};

/// Returns the thesis' 1-RC model with an OCV curve, once unchanged and once with a warming cell
/// and a current channel that reads too little.
fn models() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let sweeps = project("fixtures/data/spectra/p45b_thesis.csv");
    let fit = [
        "fit",
        &sweeps,
        "--pool",
        "--rc",
        "1",
        "--objective",
        "sum-abs",
        "--out",
        ".",
    ];
    program_in(folder.path(), &fit).ok();
    let mut model: Value = serde_json::from_str(
        &std::fs::read_to_string(folder.path().join("model_1rc.json")).unwrap(),
    )
    .unwrap();
    model["ocv"] = json!({ "capacity_ah": 4.5, "soc": [0.0, 1.0], "ocv_v": [3.0, 4.2], "slope_v": [1.2, 1.2] });
    std::fs::write(folder.path().join("plain.json"), model.to_string()).unwrap();
    let addition = |name: &str, title: &str, group: &str, parameters: Value| {
        let evidence = json!({
            "text": "a test", "lambda": 100.0, "score": 90.0,
            "held_out_gap_before_v": null, "held_out_gap_after_v": null
        });
        json!({
            "name": name, "title": title, "group": group, "parameters": parameters,
            "evidence": evidence, "data_set": "d", "added_by": "a"
        })
    };
    let parameter = |name: &str, value: f64, unit: &str| -> Value {
        json!({ "name": name, "value": value, "sigma": null, "unit": unit })
    };
    model["schema_version"] = 2.into();
    model["facts"] = json!({
        "lowest_hz": 0.1, "highest_hz": 300.0, "longest_s": 60.0, "shortest_s": 0.1,
        "greatest_a": 40.0, "widest_soc": 0.1, "soc": 0.5,
        "temperature_c": 25.0, "orders": 0.0, "span_s": 0.0
    });
    let heat = json!([
        parameter("g_per_j", 2e-4, "1/J"),
        parameter("tau_s", 600.0, "s")
    ]);
    model["additions"] = json!([
        addition("self_heating", "Joule self-heating", "cell", heat),
        addition(
            "current_gain",
            "gain error",
            "bench",
            json!([parameter("gain", 0.02, "")])
        ),
    ]);
    std::fs::write(folder.path().join("warm.json"), model.to_string()).unwrap();
    std::fs::write(
        folder.path().join("pulse.csv"),
        "time_s,current_a\n0,30\n60,0\n61,0\n",
    )
    .unwrap();
    folder
}

/// Simulates the pulse from 60 % of charge by a model of the folder.
fn simulated(folder: &std::path::Path, model: &str) -> Value {
    let words = ["simulate", "--model", model, "--profile", "pulse.csv"];
    let state = ["--soc", "0.6", "--json"];
    program_in(folder, &[&words[..], &state[..]].concat()).json()
}

#[test]
fn a_diagnosed_model_has_the_band_of_its_held_out_runs() {
    let folder = models();
    let band = |model: &str| {
        let found = simulated(folder.path(), model);
        (found["band"].clone(), found["notes"].to_string())
    };
    assert_eq!(band("warm.json").0, Value::Null, "no runs were held out");
    let mut model = read_json(&folder.path().join("warm.json"));
    model["facts"]["held_out"] = json!({ "runs": 9, "share": 0.03 });
    std::fs::write(folder.path().join("known.json"), model.to_string()).unwrap();
    let (found, notes) = band("known.json");
    assert_eq!(found["probability"], 0.9);
    // 3 % of some 0.4 V under 30 A, and of 20 mV.
    let most_v = found["most_half_v"].as_f64().unwrap();
    assert!((0.005..0.02).contains(&most_v), "{most_v}");
    assert!(notes.contains("with a probability of 90 % "), "{notes}");
    assert!(
        notes.contains("as the 9 held-out runs of the diagnosis do"),
        "{notes}"
    );
    model["facts"]["held_out"]["share"] = json!(0.06);
    std::fs::write(folder.path().join("known.json"), model.to_string()).unwrap();
    let twice_v = band("known.json").0["most_half_v"].as_f64().unwrap();
    assert!((twice_v / most_v - 2.0).abs() < 1e-9);
}

#[test]
fn commands_honour_additions_or_say_that_they_do_not() {
    let folder = models();
    let run = |arguments: &[&str]| {
        let ended = program_in(folder.path(), arguments);
        match ended.code {
            Some(0) => (true, ended.stdout),
            _ => (false, ended.stderr),
        }
    };
    let lowest_v = |model: &str| {
        let found = simulated(folder.path(), model);
        (
            found["min_ccv_v"].as_f64().unwrap(),
            found["notes"].to_string(),
        )
    };
    let ((plain_v, _), (warm_v, notes)) = (lowest_v("plain.json"), lowest_v("warm.json"));
    assert!(warm_v > plain_v + 1e-3, "{warm_v} V against {plain_v} V");
    assert!(
        notes.contains("additions to the fitted model: Joule self-heating"),
        "{notes}"
    );
    assert!(
        notes.contains("left out, because the bench did it and not the cell: gain error"),
        "{notes}"
    );
    let (done, text) = run(&[
        "sop",
        "--model",
        "warm.json",
        "--soc",
        "0.5",
        "--duration-s",
        "5",
    ]);
    assert!(
        done && text.contains("additions to the fitted model"),
        "{text}"
    );
    let refused: [(&[&str], &str); 2] = [
        (
            &["sop", "--model", "warm.json", "--ocv-v", "3.6"],
            "expected a state of charge on the model's OCV curve, met a model with self_heating",
        ),
        (
            &[
                "pack",
                "simulate",
                "--model",
                "warm.json",
                "--profile",
                "pulse.csv",
                "--series",
                "2",
                "--parallel",
                "2",
                "--soc",
                "0.6",
            ],
            "--model: expected additions that linear branches stand for, found self_heating",
        ),
    ];
    for (arguments, expected) in refused {
        let (done, text) = run(arguments);
        assert!(!done && text.contains(expected), "{text}");
    }
}

#[test]
fn a_typed_model_holds_additions_as_a_model_file_does() {
    let folder = models();
    let model = crate::support::json(&folder.path().join("warm.json"));
    let erm = &model["fit"]["erm"];
    let (additions, facts, ocv) = (&model["additions"], &model["facts"], &model["ocv"]);
    let typed = json!({
        "r_ohm": erm["r_ohm"], "branches": erm["branches"], "ocv": ocv, "additions": additions,
        "facts": facts
    });
    std::fs::write(folder.path().join("typed.json"), typed.to_string()).unwrap();
    let lowest_v = |model: &str| {
        simulated(folder.path(), model)["min_ccv_v"]
            .as_f64()
            .unwrap()
    };
    assert_eq!(lowest_v("typed.json"), lowest_v("warm.json"));
    let lacking = json!({ "r_ohm": erm["r_ohm"], "branches": erm["branches"], "additions": additions, "facts": facts });
    std::fs::write(folder.path().join("lacking.json"), lacking.to_string()).unwrap();
    let words = [
        "simulate",
        "--model",
        "lacking.json",
        "--profile",
        "pulse.csv",
        "--ocv-v",
        "3.7",
    ];
    let text = program_in(folder.path(), &words).refused();
    let expected = "additions: expected beside them ocv, the OCV curve of the model, met none";
    assert!(text.contains(expected), "{text}");
}
