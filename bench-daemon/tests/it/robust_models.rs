//! Unusual loads and records in the commands that use a model: power that is not available, pulses
//! that were not sampled, a slow discharge within a longer record, packs of named cells.

use std::path::Path;

use serde_json::Value;

use crate::support::{program_in, project};

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

/// Returns the thesis' 4-RC model as `model.json` in a separate folder.
fn fitted() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let sweeps = project("fixtures/data/spectra/p45b_thesis.csv");
    let fit = [
        "fit",
        &sweeps,
        "--pool",
        "--rc",
        "4",
        "--objective",
        "sum-abs",
        "--out",
        "p45b",
    ];
    program_in(folder.path(), &fit).ok();
    std::fs::rename(
        folder.path().join("p45b/model_4rc.json"),
        folder.path().join("model.json"),
    )
    .unwrap();
    folder
}

#[test]
fn the_tangent_ends_where_no_voltage_is_left_and_says_when() {
    let folder = fitted();
    // 400 W can be had at once (3.72²/(4·6.43 mΩ) = 538 W), but not for long.
    std::fs::write(folder.path().join("long.txt"), "0 400\n60 400\n").unwrap();
    for more in [vec![], vec!["--method", "thesis"]] {
        let base = [
            "simulate",
            "--model",
            "model.json",
            "--profile",
            "long.txt",
            "--ocv-v",
            "3.72",
            "--beyond",
            "extrapolate",
            "--json",
        ];
        let output = program_in(folder.path(), &[&base[..], &more].concat());
        output.expect_code(0);
        let found = json(&output.stdout);
        let number = |key: &str| {
            found[key]
                .as_f64()
                .unwrap_or_else(|| panic!("{key} in {found}"))
        };
        assert!(
            number("min_ccv_v") >= 0.0 && number("max_ccv_v") < 3.72,
            "{more:?}: {found}"
        );
        assert!(
            number("peak_current_a") < 3.72 / 0.00643,
            "{more:?}: no more than a short circuit: {found}"
        );
        let end = &found["tangent_end"];
        let time_s = end["time_s"]
            .as_f64()
            .unwrap_or_else(|| panic!("{more:?}: {found}"));
        assert!(
            time_s > found["first_infeasible"]["time_s"].as_f64().unwrap() && time_s < 60.0,
            "{found}"
        );
        assert!(
            (number("simulated_s") - time_s).abs() < 0.05,
            "{more:?}: the run ends there: {found}"
        );
        let most_w = end["available_w"].as_f64().unwrap();
        // The tangent at 0.95 P* meets 0 V at (1 + √0.05)² = 1.497 P*.
        assert!(
            (250.0..270.0).contains(&most_w) && end["power_w"] == 400.0,
            "{end}"
        );
        let note = found["notes"]
            .as_array()
            .unwrap()
            .iter()
            .filter_map(Value::as_str)
            .find(|note| note.contains("the tangent"));
        let note = note.unwrap_or_else(|| panic!("{found}"));
        assert!(
            note.contains("400.0 W were asked for") && note.contains("singular as E → 0"),
            "{note}"
        );
    }
    // More than the tangent can answer from the first instant on.
    std::fs::write(folder.path().join("jump.txt"), "0 100\n1 2000\n2 0\n").unwrap();
    let found = json(
        &program_in(
            folder.path(),
            &[
                "simulate",
                "--model",
                "model.json",
                "--profile",
                "jump.txt",
                "--ocv-v",
                "3.72",
                "--beyond",
                "extrapolate",
                "--json",
            ],
        )
        .ok(),
    );
    assert!(
        (found["tangent_end"]["time_s"].as_f64().unwrap() - 1.0).abs() < 1e-6,
        "{found}"
    );
    assert!(
        found["min_ccv_v"].as_f64().unwrap() > 1.5 && found["feasible"] == false,
        "{found}"
    );
}

/// Writes a record of a cell of 10 Ah, OCV 3 V + SOC · 1 V, 10 mΩ and one branch of 5 mΩ and 8 s,
/// at 1 A with 3 A for a time every 4000 s, with the given sampling.
fn pulsed(folder: &Path, name: &str, (sampling_s, length_s): (f64, f64)) -> String {
    let mut text = "Test Time / s,Current / A,Voltage / V\n".to_owned();
    let (mut v, mut drawn, mut noise) = (0.005, 0.0, 0u64);
    let mut due = 0.0;
    for k in 0..144_000u32 {
        let t = 0.2 * f64::from(k);
        let i = if t % 4000.0 >= 4000.0 - 200.0 && t % 4000.0 < 4000.0 - 200.0 + length_s {
            3.0
        } else {
            1.0
        };
        if t >= due - 1e-6 {
            due += sampling_s;
            noise = noise
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let jitter = 1e-4 * ((noise >> 40) as f64 / 16_777_216.0 - 0.5);
            text.push_str(&format!(
                "{t:.1},{},{:.6}\n",
                -i,
                4.0 - drawn / 36_000.0 - i * 0.01 - v + jitter
            ));
        }
        v = 0.005 * i + (v - 0.005 * i) * (-0.2f64 / 8.0).exp();
        drawn += 0.2 * i;
    }
    std::fs::write(folder.join(name), text).unwrap();
    name.to_owned()
}

fn spectra(folder: &Path) -> Vec<String> {
    let one = |repeat: u32| {
        let mut text = "freq_hz,z_re_ohm,z_im_ohm\n".to_owned();
        for k in 0..16 {
            let freq_hz = 0.05 * 2f64.powi(k);
            let wt = std::f64::consts::TAU * freq_hz * 8.0;
            let shift =
                1.0 + 0.001 * f64::from((repeat * 7 + u32::try_from(k).unwrap() * 5) % 11) / 11.0;
            let (re, im) = (
                0.01 + 0.005 / (1.0 + wt * wt),
                -0.005 * wt / (1.0 + wt * wt),
            );
            text.push_str(&format!("{freq_hz},{},{}\n", re * shift, im * shift));
        }
        let name = format!("cell0_{repeat}.csv");
        std::fs::write(folder.join(&name), text).unwrap();
        name
    };
    (0..4).map(one).collect()
}

fn joint(series: &str, rc: &str, spectra: &[String]) -> Vec<String> {
    let base = [
        "joint",
        "--series",
        series,
        "--ocv-from",
        "slow.csv",
        "--rc",
        rc,
        "--at-v",
        "3.5",
        "--within-v",
        "0.45",
        "--spectra",
    ];
    base.into_iter()
        .map(str::to_owned)
        .chain(spectra.iter().cloned())
        .collect()
}

#[test]
fn a_record_that_saw_no_edge_has_no_pulses() {
    let folder = tempfile::tempdir().unwrap();
    pulsed(folder.path(), "slow.csv", (10.0, 0.0));
    let (coarse, fine) = (
        pulsed(folder.path(), "coarse.csv", (10.0, 40.0)),
        pulsed(folder.path(), "fine.csv", (0.2, 40.0)),
    );
    let spectra = spectra(folder.path());
    let arguments = |series: &str, rc: &str| -> Vec<String> { joint(series, rc, &spectra) };
    let run = |arguments: &[String]| {
        program_in(
            folder.path(),
            &arguments.iter().map(String::as_str).collect::<Vec<_>>(),
        )
    };
    let refused = run(&arguments(&coarse, "1"));
    let message = refused.stderr;
    assert_eq!(refused.code, Some(2), "{message}\n{}", refused.stdout);
    let expected = "coarse.csv: expected samples at most 1 s apart around the edges of a pulse, \
    met 10 s at its 7 steps of the current";
    assert!(message.contains(expected), "{message}");
    let taken = run(&arguments(&fine, "1"));
    taken.expect_code(0);
}

#[test]
#[ignore = "drill"]
fn an_order_that_the_data_do_not_bear_is_never_silent() {
    let folder = tempfile::tempdir().unwrap();
    pulsed(folder.path(), "slow.csv", (10.0, 0.0));
    let fine = pulsed(folder.path(), "fine.csv", (0.2, 40.0));
    let mut arguments = joint(&fine, "3", &spectra(folder.path()));
    arguments.push("--json".to_owned());
    let study = json(
        &program_in(
            folder.path(),
            &arguments.iter().map(String::as_str).collect::<Vec<_>>(),
        )
        .ok(),
    );
    // The cell has one branch.
    let joint = &study["orders"][0]["joint"];
    let not_borne: Vec<&str> = joint["not_borne"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(Value::as_str)
        .collect();
    let value = |branch: &Value, key: &str| branch[key].as_f64().unwrap();
    let branches: Vec<(f64, f64)> = joint["erm"]["branches"]
        .as_array()
        .unwrap()
        .iter()
        .map(|b| (value(b, "r_ohm"), value(b, "r_ohm") * value(b, "c_f")))
        .collect();
    let same = branches.windows(2).any(|pair| pair[1].1 < 1.02 * pair[0].1);
    let held = branches
        .iter()
        .any(|(r_ohm, _)| *r_ohm > 0.1 / 1.02 || *r_ohm < 1.02e-6);
    assert!(!(same || held) || !not_borne.is_empty(), "{joint}");
    let warnings = study["warnings"].to_string();
    assert!(
        not_borne.iter().all(|words| warnings.contains(words)),
        "{not_borne:?} {warnings}"
    );
}

#[test]
fn a_slow_discharge_is_chosen_from_a_longer_record() {
    let folder = tempfile::tempdir().unwrap();
    // Two discharges of a cell of 1 Ah, OCV 3 V + SOC · 1 V: 2 h at 0.25 A after 3 h at 0.3 A and a
    // rest.
    let mut text = "Test Time / s,Current / A,Voltage / V\n".to_owned();
    for k in 0..1800u32 {
        let t = 10.0 * f64::from(k);
        let (i, drawn) = match t {
            t if t < 10_000.0 => (0.3, 0.3 * t),
            t if t < 10_800.0 => (0.0, 0.0),
            t => (0.25, 0.25 * (t - 10_800.0)),
        };
        text.push_str(&format!(
            "{t},{},{:.6}\n",
            -i,
            4.0 - drawn / 3600.0 - 0.01 * i
        ));
    }
    std::fs::write(folder.path().join("long.csv"), text).unwrap();
    let base = [
        "ocv",
        "long.csv",
        "--json",
        "--dcir-ohm",
        "0.01",
        "--low-v",
        "2.5",
        "--high-v",
        "4.0",
    ];
    let found = |more: &[&str]| json(&program_in(folder.path(), &[&base[..], more].concat()).ok());
    let number = |value: &Value, key: &str| value[key].as_f64().unwrap();
    // Alone, the one with the most charge is taken.
    assert!((number(&found(&[]), "current_a") - 0.3).abs() < 1e-6);
    let chosen = found(&["--from", "3 h", "--to", "5h"]);
    assert!(
        (number(&chosen, "current_a") - 0.25).abs() < 1e-6
            && (number(&chosen, "capacity_ah") - 0.499).abs() < 2e-3,
        "{chosen}"
    );
    let half = found(&["--from", "3.5 h"]);
    assert!(
        (number(&half, "capacity_ah") - 0.374).abs() < 2e-3,
        "{half}"
    );
    let refused = |more: &[&str]| program_in(folder.path(), &[&base[..], more].concat()).refused();
    let message = refused(&["--from", "6 h"]);
    assert!(
        message.contains(
            "long.csv: expected at least 2 samples from 21600 s on, found 0: its \
    times go from 0 s to 17990 s"
        ),
        "{message}"
    );
    assert!(
        refused(&["--from", "3"])
            .contains("expected a duration with its unit, such as \"30 min\", found \"3\"")
    );
    assert!(
        refused(&["--from", "3 h", "--to", "2 h"])
            .contains("--from, --to: expected a window that ends after it begins")
    );
}

const PACK: [&str; 14] = [
    "pack",
    "simulate",
    "--model",
    "model.json",
    "--profile",
    "pulse.csv",
    "--series",
    "2",
    "--parallel",
    "3",
    "--ocv-v",
    "3.72",
    "--max-step-s",
    "0.05",
];

/// Returns the report without the text on the source of the cells.
fn outcome(text: &str) -> Value {
    let mut report = json(text);
    let fields = report.as_object_mut().unwrap();
    ["seed", "spread", "cells", "means"]
        .iter()
        .for_each(|name| drop(fields.remove(*name)));
    report
}

#[test]
fn drawn_cells_are_exported_and_give_the_same_packs_again() {
    let folder = fitted();
    std::fs::write(folder.path().join("pulse.csv"), "0 300\n2 0\n3 0\n").unwrap();
    let run =
        |more: &[&str]| program_in(folder.path(), &[&PACK[..], &["--json"], more].concat()).ok();
    let drawn = run(&[
        "--draws",
        "7",
        "--seed",
        "3",
        "--sigma-rk",
        "0.02",
        "--export-cells",
        "cells.csv",
    ]);
    let table = std::fs::read_to_string(folder.path().join("cells.csv")).unwrap();
    assert!(
        table.starts_with("draw,group,place,name,r,r1,c1,r2,c2,r3,c3,r4,c4,capacity,soc\n1,1,1,"),
        "{table}"
    );
    assert_eq!(
        table.lines().count(),
        1 + 7 * 6,
        "one row for each cell of each draw"
    );
    let again = run(&["--cells", "cells.csv"]);
    assert_eq!(outcome(&drawn), outcome(&again));
    assert_eq!(json(&again)["cells"], "cells.csv");
    // The table of a table is the table.
    run(&["--cells", "cells.csv", "--export-cells", "again.csv"]);
    assert_eq!(
        table,
        std::fs::read_to_string(folder.path().join("again.csv")).unwrap()
    );
}

#[test]
fn cells_with_names_stand_where_they_are_put_and_the_mean_is_reported() {
    let folder = fitted();
    std::fs::write(folder.path().join("pulse.csv"), "0 300\n2 0\n3 0\n").unwrap();
    let mut rows = "group,place,name,r,capacity\n".to_owned();
    for (k, name) in ["A1", "A2", "A3", "B1", "B2", "weak"].iter().enumerate() {
        let r = if *name == "weak" { "1.3" } else { "" };
        rows += &format!("{},{},{name},{r},\n", k / 3 + 1, k % 3 + 1);
    }
    std::fs::write(folder.path().join("named.csv"), &rows).unwrap();
    let text = program_in(
        folder.path(),
        &[&PACK[..], &["--cells", "named.csv"]].concat(),
    )
    .ok();
    assert!(text.contains("in group 2"), "{text}");
    assert!(
        text.contains("identical: a pack of 6 cells as --model has them"),
        "{text}"
    );
    assert!(
        text.contains(
            "part of the mean: over the current of the pack divided by its 3 cells in parallel"
        ),
        "{text}"
    );
    assert!(
        text.contains("mean over the table's cells: r 1.05000"),
        "{text}"
    );
    assert!(text.contains("its cells: B1, B2, weak"), "{text}");
    // A cell may have a model of its own.
    let models = rows
        .replace("name,r,", "name,model,r,")
        .replace(",weak,1.3,", ",weak,model.json,1.3,")
        .replace("A1,,", "A1,,,");
    let models = models
        .replace("A2,,", "A2,,,")
        .replace("A3,,", "A3,,,")
        .replace("B1,,", "B1,,,")
        .replace("B2,,", "B2,,,");
    std::fs::write(folder.path().join("models.csv"), models).unwrap();
    let run = |table: &str| {
        outcome(
            &program_in(
                folder.path(),
                &[&PACK[..], &["--json", "--cells", table]].concat(),
            )
            .ok(),
        )
    };
    assert_eq!(run("named.csv"), run("models.csv"));
    let refused = |text: &str| {
        std::fs::write(folder.path().join("bad.csv"), text).unwrap();
        program_in(
            folder.path(),
            &[&PACK[..], &["--cells", "bad.csv"]].concat(),
        )
        .refused()
    };
    assert!(
        refused(&rows.replace("2,3,weak", "2,2,weak"))
            .contains("bad.csv, line 7: expected each place once, found group 2, place 2 again")
    );
    assert!(
        refused(&rows.replace("1.3", "-1")).contains(
            "bad.csv, line 7, r: expected a factor above 0, or nothing for 1, found \"-1\""
        )
    );
    assert!(
        refused(&rows.replace("2,3,weak", "3,1,weak"))
            .contains("bad.csv, line 7, group: expected a number from 1 to 2, found \"3\"")
    );
    let short = rows.lines().take(6).collect::<Vec<_>>().join("\n");
    assert!(
        refused(&short)
            .contains("bad.csv: expected 6 cells for 2S3P, found 5: group 2, place 3 is empty")
    );
}
