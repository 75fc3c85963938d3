//! `eis-bench map`, and the commands that take its model.

use std::{fs, path::Path};

use serde_json::Value;

use crate::support::{json, program, project, shared_data};

fn cells(name: &str) -> String {
    project(&format!("fixtures/data/cells/{name}"))
}

/// Runs `map` on the pulses of both temperatures, with more words.
fn map(out: &Path, more: &[&str]) -> (i32, String, String) {
    let (warm, cold, ocv) = (
        cells("panasonic_18650pf_25C/pulses.bdf.csv"),
        cells("panasonic_18650pf_10C/pulses.bdf.csv"),
        cells("panasonic_18650pf_25C/ocv.json"),
    );
    let out = out.to_str().unwrap();
    let words = ["map", &warm, &cold, "--ocv", &ocv, "--out", out];
    program(&[&words[..], more].concat()).parts()
}

#[test]
fn pulses_of_two_temperatures_become_a_model_that_sop_and_simulate_follow() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("map");
    let (code, text, error) = map(&out, &["--name", "NCR18650PF"]);
    assert_eq!(code, 0, "{error}");
    assert!(
        text.starts_with("error on pieces of the logs, each left out of a fit:"),
        "{text}"
    );
    let model = out.join("map.json");
    let written = json(&model);
    assert_eq!(written["name"], "NCR18650PF");
    assert_eq!(
        written["map"]["temperature_degc"].as_array().unwrap().len(),
        2
    );
    let table = fs::read_to_string(out.join("map_logs.csv")).unwrap();
    assert_eq!(table.lines().count(), 3, "{table}");
    assert!(out.join("map.svg").is_file() && out.join("map.png").is_file());
    let sop = |degc: &str| -> f64 {
        let model = model.to_str().unwrap();
        let words = [
            "sop",
            "--model",
            model,
            "--soc",
            "0.5",
            "--duration-s",
            "10",
            "--json",
        ];
        let (code, text, error) =
            program(&[&words[..], &["--ambient-degc", degc]].concat()).parts();
        assert_eq!(code, 0, "{error}");
        let report: Value = serde_json::from_str(&text).unwrap();
        report["map"][0]["discharge_w"].as_f64().unwrap()
    };
    // The resistances of both nodes differ by 1.4 to 1.5.
    let (cold, warm) = (sop("11"), sop("25.9"));
    assert!(warm > 1.3 * cold && warm < 1.7 * cold, "{cold} {warm}");
    let profile = folder.path().join("load.csv");
    fs::write(&profile, "time_s,power_w\n0,20\n30,5\n60,5\n").unwrap();
    let words = ["--soc", "0.5", "--ambient-degc", "-20", "--json", "--out"];
    let simulated = folder.path().join("simulated");
    let call = ["simulate", "--model", model.to_str().unwrap(), "--profile"];
    let end = [profile.to_str().unwrap()];
    let (code, text, error) =
        program(&[&call[..], &end, &words, &[simulated.to_str().unwrap()]].concat()).parts();
    assert_eq!(code, 0, "{error}");
    let report: Value = serde_json::from_str(&text).unwrap();
    let outside = report["outside_map"]["temperature_k"].as_f64().unwrap();
    assert!((outside - 31.0).abs() < 0.5, "{outside}");
    let notes = report["notes"].to_string();
    assert!(
        notes.contains("leaves the range in which the map was measured"),
        "{notes}"
    );
}

#[test]
fn exports_take_a_map_and_a_task_of_one_point_says_so_or_refuses_it() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("map");
    assert_eq!(map(&out, &[]).0, 0);
    let model = out.join("map.json");
    let model = model.to_str().unwrap();
    let to = folder.path().join("export");
    for (format, ending, wanted) in [
        ("pybamm", "map_pybamm.py", "def thevenin("),
        ("modelica", "map.mo", "model Cell "),
        ("fmu", "map.fmu", "modelDescription.xml"),
        ("simscape", "map_simscape.m", "T_vec = "),
    ] {
        let (code, _, error) = program(&[
            "convert",
            model,
            "--to",
            format,
            "--out",
            to.to_str().unwrap(),
        ])
        .parts();
        if format == "simscape" {
            assert_eq!(code, 0, "{error}");
            let mut bent = json(Path::new(model));
            let law = r#"{"voltage_v": 0.05, "slowest_s": 3.0}"#;
            bent["map"]["charge_transfer"] = serde_json::from_str(law).unwrap();
            let path = folder.path().join("map.json");
            fs::write(&path, bent.to_string()).unwrap();
            let words = ["convert", path.to_str().unwrap(), "--to", format, "--out"];
            let words = [&words[..], &[to.to_str().unwrap()]].concat();
            let (code, _, error) = program(&words).parts();
            assert!(
                code == 2 && error.contains("do not depend on the current"),
                "{error}"
            );
        } else {
            assert_eq!(code, 0, "{error}");
        }
        let bytes = fs::read(to.join(ending)).unwrap();
        assert!(String::from_utf8_lossy(&bytes).contains(wanted), "{format}");
    }
    // The library of the FMU is in the archive only.
    assert_eq!(fs::read_dir(&to).unwrap().count(), 4);
    let (code, _, error) =
        program(&["convert", model, "--to", "c", "--out", to.to_str().unwrap()]).parts();
    let header = fs::read_to_string(to.join("map.h")).unwrap();
    assert!(
        code == 0 && header.contains("#define EIS_MAP_DEGC 2"),
        "{error}"
    );
    let set = format!(
        "{}/../configs/datasets/panasonic_50soc",
        env!("CARGO_MANIFEST_DIR")
    );
    // A diagnosis judges the map's model at the mean state of the runs.
    let (code, out, error) = program(&["diagnose", &set, "--model", model]).parts();
    let out = out.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        code == 0 && out.contains("the model is that of the map at 48."),
        "{out} {error}"
    );
    let (code, _, error) = program(&[
        "sop",
        "--model",
        model,
        "--ocv-v",
        "3.7",
        "--duration-s",
        "1",
    ])
    .parts();
    assert!(
        code != 0 && error.contains("state of charge for a model with a map"),
        "{error}"
    );
}

#[test]
fn bad_input_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("map");
    let (code, _, error) = map(&out, &["--soc-start", "1.2"]);
    assert!(
        code != 0 && error.contains("--soc-start: expected a fraction from 0 to 1"),
        "{error}"
    );
    let (code, _, error) = map(&out, &["--time-constants-s", "10,5"]);
    assert!(
        code != 0 && error.contains("seconds above zero that rise"),
        "{error}"
    );
    let log = folder.path().join("log.bdf.csv");
    fs::write(
        &log,
        "Test Time / s,Current / A,Voltage / V\n0,0,3.7\n1,-1,3.6\n2,-1,3.6\n3,0,3.69\n",
    )
    .unwrap();
    let ocv = cells("panasonic_18650pf_25C/ocv.json");
    let (code, _, error) = program(&["map", log.to_str().unwrap(), "--ocv", &ocv]).parts();
    assert!(
        code != 0 && error.contains("log.bdf.csv: expected a column of temperatures"),
        "{error}"
    );
    assert!(!out.exists());
}

/// A data set of one spectrum and two pulses of the Panasonic cell.
fn data_set(folder: &Path, second: &str) -> String {
    let (spectrum, pulses, ocv) = (
        cells("panasonic_18650pf_25C/eis_07.csv"),
        cells("panasonic_18650pf_25C/pulses.bdf.csv"),
        cells("panasonic_18650pf_25C/ocv.json"),
    );
    let text = format!(
        "name = \"set\"\nocv = \"{ocv}\"\n
        [[runs]]\nname = \"z\"\nfile = \"{spectrum}\"\nkind = \"eis\"\nsoc = 0.49\ntemperature_c = 26.8\n\
        from_hz = 0.01\ncell = \"A\"\n
        [[runs]]\nname = \"4C\"\nfile = \"{pulses}\"\nkind = \"time\"\nocv_v = 3.6564\nfrom_s = 49041.8\n\
        to_s = 49171.9\ncell = \"A\"\n
        [[runs]]\nname = \"2C\"\nfile = \"{pulses}\"\nkind = \"time\"\nocv_v = 3.6609\nfrom_s = 47831.7\n\
        to_s = 47961.8\nrole = \"held_out\"\ncell = \"{second}\"\n"
    );
    let set = folder.join(format!("set_{second}"));
    fs::create_dir(&set).unwrap();
    fs::write(set.join("dataset.toml"), text).unwrap();
    set.to_str().unwrap().to_owned()
}

#[test]
fn a_data_set_brings_spectra_pulses_roles_and_its_curve() {
    let folder = tempfile::tempdir().unwrap();
    let set = data_set(folder.path(), "A");
    let out = folder.path().join("map");
    let (code, text, error) = program(&["map", &set, "--out", out.to_str().unwrap()]).parts();
    assert_eq!(code, 0, "{error}");
    assert!(text.contains("error on held-out logs:"), "{text}");
    assert!(
        text.contains("error on fitted spectra (none was held out):"),
        "{text}"
    );
    assert!(
        text.contains("  2C (held out)") && text.contains("  z (fitted)"),
        "{text}"
    );
    let spectra = fs::read_to_string(out.join("map_spectra.csv")).unwrap();
    let row: Vec<&str> = spectra.lines().nth(1).unwrap().split(',').collect();
    assert_eq!(row[..4], ["z", "fitted", "0.4900", "26.80"], "{spectra}");
    // One spectrum and one pulse at one state: the map must describe both to a few percent.
    let percent: f64 = row[4].parse().unwrap();
    assert!(percent > 0.0 && percent < 10.0, "{spectra}");
    let logs = fs::read_to_string(out.join("map_logs.csv")).unwrap();
    let rms_mv: Vec<f64> = logs
        .lines()
        .skip(1)
        .map(|l| l.split(',').nth(3).unwrap().parse().unwrap())
        .collect();
    assert!(
        rms_mv.len() == 2 && rms_mv.iter().all(|mv| *mv < 15.0),
        "{logs}"
    );
    let two = data_set(folder.path(), "B");
    let (code, _, error) = program(&["map", &two]).parts();
    assert!(
        code == 2
            && error.contains("expected runs of one cell; --specimen chooses one, found A, B"),
        "{error}"
    );
    assert_eq!(program(&["map", &two, "--specimen", "A"]).parts().0, 0);
    let pulses = cells("panasonic_18650pf_25C/pulses.bdf.csv");
    let (code, _, error) = program(&["map", &pulses]).parts();
    assert!(
        code == 2 && error.contains("expected an OCV curve of the cell"),
        "{error}"
    );
}

#[test]
fn the_next_measurements_lower_the_predicted_error_of_a_load() {
    let folder = tempfile::tempdir().unwrap();
    let walking = format!(
        "{}/../fixtures/data/profiles/walking.csv",
        env!("CARGO_MANIFEST_DIR")
    );
    let pack = [
        "--under",
        &walking,
        "--series",
        "16",
        "--parallel",
        "3",
        "--json",
    ];
    let out = folder.path().join("map");
    let (code, text, error) = map(&out, &[&["--next", "3"][..], &pack].concat());
    assert_eq!(code, 0, "{error}");
    let report: Value = serde_json::from_str(&text).unwrap();
    let plan = &report["next"];
    let errors: Vec<f64> = [&plan["error_v"]]
        .into_iter()
        .chain(
            plan["next"]
                .as_array()
                .unwrap()
                .iter()
                .map(|next| &next["error_v"]),
        )
        .map(|value| value.as_f64().unwrap())
        .collect();
    assert_eq!(errors.len(), 4, "{text}");
    assert!(errors.windows(2).all(|w| w[1] < w[0]), "{errors:?}");
    // The data are pulses at half charge: the first place lies away from it.
    let soc = plan["next"][0]["soc"].as_f64().unwrap();
    assert!((soc - 0.48).abs() > 0.05, "{plan}");
    let (code, _, error) = map(&out, &["--next", "3"]);
    assert!(code == 2 && error.contains("--under"), "{error}");
}

/// Full drive cycles of a Panasonic 18650PF (Kollmeyer, Mendeley Data 10.17632/wykht8y7tg).
#[test]
fn drive_cycles_at_three_temperatures_predict_another_cycle() {
    let Some(measured) = shared_data("cells") else {
        return;
    };
    let shared = |name: &str| {
        let path = measured.join(format!("panasonic_18650pf_{name}"));
        path.to_str().unwrap().to_owned()
    };
    let folder = tempfile::tempdir().unwrap();
    let text = |path: std::path::PathBuf| path.to_str().unwrap().to_owned();
    let curve = text(folder.path().join("ocv"));
    let slow = shared("25C/c20_ocv.bdf.csv");
    let (code, _, error) = program(&["ocv", &slow, "--dcir-ohm", "0.04", "--out", &curve]).parts();
    assert_eq!(code, 0, "{error}");
    let cycles = ["25C", "10C", "m10C"].map(|t| shared(&format!("{t}/cycle_1.parquet")));
    let held_out = ["25C", "10C"].map(|t| shared(&format!("{t}/us06.parquet")));
    let ocv = format!("{curve}/ocv.json");
    let mut words = vec!["map"];
    words.extend(cycles.iter().map(String::as_str));
    for log in &held_out {
        words.extend(["--held-out", log]);
    }
    words.extend(["--ocv", &ocv, "--soc-start", "1", "--json"]);
    let (code, text, error) = program(&words).parts();
    assert_eq!(code, 0, "{error}");
    let fit: Value = serde_json::from_str(&text).unwrap();
    let rms_mv: Vec<f64> = fit["logs"]
        .as_array()
        .unwrap()
        .iter()
        .map(|log| 1e3 * log["rms_v"].as_f64().unwrap())
        .collect();
    // As measured once: 9.0, 6.2, 14.6; 13.4, 12.7 mV. A model of three branches per temperature
    // without Arrhenius' law has 25 and 23 mV on the last two.
    assert!(rms_mv[..3].iter().all(|rms| *rms < 16.0), "{rms_mv:?}");
    assert!(rms_mv[3..].iter().all(|rms| *rms < 14.5), "{rms_mv:?}");
    let series = &fit["map"]["series"]["r_ohm"];
    let at_half = |node: usize| series[node][7].as_f64().unwrap();
    // As measured once: 46.1, 26.0, 19.9 mΩ.
    assert!(
        at_half(0) > 1.6 * at_half(1) && at_half(1) > 1.2 * at_half(2),
        "{series}"
    );
}

/// The correction of the curve belongs to every voltage at rest: of `sop`, of the simple-IR model,
/// and of a start by voltage.
#[test]
fn the_correction_of_the_curve_is_in_every_voltage_at_rest() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("map");
    assert_eq!(map(&out, &[]).0, 0);
    let path = out.join("map.json");
    let mut model = json(&path);
    let knots = model["map"]["soc"].as_array().unwrap().len();
    model["map"]["ocv_offset_v"] = vec![0.1; knots].into();
    model["map"]["ocv_v_per_k"] = vec![0.0; knots].into();
    let shifted = folder.path().join("shifted.json");
    fs::write(&shifted, model.to_string()).unwrap();
    let ocv_v = |model: &Path| -> f64 {
        let model = model.to_str().unwrap();
        let words = [
            "sop",
            "--model",
            model,
            "--soc",
            "0.45",
            "--duration-s",
            "1",
            "--json",
        ];
        let report: Value = serde_json::from_str(&program(&words).parts().1).unwrap();
        report["map"][0]["ocv_v"].as_f64().unwrap()
    };
    let curve = json(Path::new(&cells("panasonic_18650pf_25C/ocv.json")));
    let near = |k: usize| curve["ocv_v"][k].as_f64().unwrap();
    let ends = (near(0), near(curve["ocv_v"].as_array().unwrap().len() - 1));
    let corrected = ocv_v(&shifted);
    assert!(corrected > ends.0 && corrected < ends.1 + 0.1);
    model["map"]["ocv_offset_v"] = vec![0.0; knots].into();
    fs::write(&path, model.to_string()).unwrap();
    assert!((corrected - ocv_v(&path) - 0.1).abs() < 1e-9);
    let profile = folder.path().join("rest.csv");
    fs::write(&profile, "time_s,power_w\n0,0\n10,0\n").unwrap();
    let simulated = folder.path().join("simulated");
    let words = [
        "simulate",
        "--model",
        shifted.to_str().unwrap(),
        "--profile",
        profile.to_str().unwrap(),
        "--ocv-v",
        "3.75",
        "--json",
        "--out",
        simulated.to_str().unwrap(),
    ];
    let (code, text, error) = program(&words).parts();
    assert_eq!(code, 0, "{error}");
    let report: Value = serde_json::from_str(&text).unwrap();
    assert!(
        (report["max_ccv_v"].as_f64().unwrap() - 3.75).abs() < 1e-6,
        "{text}"
    );
    let curve = cells("panasonic_18650pf_25C/ocv.json");
    let other = [
        "sop",
        "--model",
        shifted.to_str().unwrap(),
        "--ocv",
        &curve,
        "--soc",
        "0.5",
    ];
    let (code, _, error) = program(&other).parts();
    assert!(
        code != 0 && error.contains("--ocv: expected none for a model with a map"),
        "{error}"
    );
}
