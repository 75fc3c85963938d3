//! `diagnose` and `effects` as a user calls them.

use std::path::Path;

use analysis::{
    fit::{Bounds, FitOptions, ModelFile, Objective, fit_erm},
    formats::read_spectra,
    ocv::OcvCurve,
};
use bench_evaluate::investigate::dataset::read_dataset;
use study::hidden::{Case, Corruption, Spec};

use crate::support::{Ended, program};

/// A campaign in `data`, a model of its first sweep beside it.
pub(crate) fn campaign(folder: &Path, spec: &Spec) {
    let case = Case::new(spec);
    case.write(&folder.join("data")).unwrap();
    let set = read_dataset(&folder.join("data")).unwrap().set;
    let sweep = set
        .runs
        .iter()
        .find(|run| run.repeat_group == "eis")
        .unwrap();
    let file = std::fs::read_dir(folder.join("data"))
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let file = file
        .filter(|path| path.to_string_lossy().contains(&sweep.name))
        .min()
        .unwrap();
    let spectra = read_spectra(&file).unwrap();
    let options = FitOptions {
        rc: 3,
        objective: Objective::Complex,
        bounds: Bounds::for_spectra(&spectra),
        seed: 1,
    };
    let (soc, ocv_v) = case.base.ocv.iter().copied().unzip();
    let mut model = ModelFile::new(
        "cell",
        fit_erm(&spectra, &options).unwrap(),
        Vec::new(),
        None,
    );
    std::fs::write(folder.join("bare.json"), model.to_json().unwrap()).unwrap();
    model.ocv = Some(OcvCurve::monotone(case.base.capacity_ah, soc, ocv_v).unwrap());
    std::fs::write(folder.join("model.json"), model.to_json().unwrap()).unwrap();
}

fn diagnose(folder: &Path, model: &str) -> Ended {
    let [data, model, out] = ["data", model, "out"].map(|name| folder.join(name));
    program(&[
        Path::new("diagnose"),
        &data,
        Path::new("--model"),
        &model,
        Path::new("--out"),
        &out,
        Path::new("--json"),
    ])
}

#[test]
fn damaged_data_are_a_verdict_with_an_exit_code_of_its_own() {
    for (kind, text) in [
        (Corruption::VoltageMillivolts, "mV for V?"),
        (Corruption::TimeBackwards, "its times go back"),
        (Corruption::Truncated, ""),
    ] {
        let folder = tempfile::tempdir().unwrap();
        campaign(
            folder.path(),
            &Spec {
                corruption: Some(kind),
                ..Spec::null(1)
            },
        );
        let output = diagnose(folder.path(), "model.json");
        output.expect_code(12);
        let printed: serde_json::Value = serde_json::from_str(&output.stdout).unwrap();
        let summary = printed["summary"].as_str().unwrap();
        assert!(
            printed["verdict"] == "invalid" && summary.contains(text),
            "{summary}"
        );
        assert_eq!(
            crate::support::json(&folder.path().join("out/diagnosis.json")),
            printed
        );
    }
}

#[test]
fn what_is_missing_is_reported_and_ends_with_2() {
    let folder = tempfile::tempdir().unwrap();
    campaign(folder.path(), &Spec::null(3));
    let refused = |model: &str, text: &str| {
        let error = diagnose(folder.path(), model).refused();
        assert!(error.contains(text), "{error}");
    };
    refused(
        "bare.json",
        "expected an OCV curve in it, found none; give one with --ocv",
    );
    refused("none.json", "--model ");
    std::fs::write(
        folder.path().join("data/dataset.toml"),
        "name = \"d\"\nruns = []\n",
    )
    .unwrap();
    refused(
        "model.json",
        "dataset.toml:2: runs: expected at least one [[runs]], found none",
    );
}

/// Puts keys before everything else of `data/dataset.toml`.
fn name_in_data_set(folder: &Path, keys: &str) {
    let path = folder.join("data/dataset.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let runs = text.trim_start_matches(|c| c != '\n');
    let name = text.strip_suffix(runs).unwrap();
    assert!(name.starts_with("name = "), "{name}");
    std::fs::write(&path, format!("{name}\n{keys}{runs}")).unwrap();
}

#[test]
fn a_data_set_may_name_its_model_and_its_curve() {
    let folder = tempfile::tempdir().unwrap();
    let spec = Spec {
        // A verdict that takes no fit.
        corruption: Some(Corruption::VoltageMillivolts),
        ..Spec::null(1)
    };
    campaign(folder.path(), &spec);
    let data = folder.path().join("data");
    let plain = || program(&[Path::new("diagnose"), &data]);
    let refused = |text: &str| {
        let error = plain().refused();
        assert!(error.contains(text), "{error}");
    };
    refused("data: expected --model, --erm, or `model` in its dataset.toml, found none");

    let toml = std::fs::read_to_string(data.join("dataset.toml")).unwrap();
    name_in_data_set(folder.path(), "model = \"../none.json\"\n");
    refused("dataset.toml:2: model: expected a model of `fit`, `joint` or a run; ");
    std::fs::write(data.join("dataset.toml"), &toml).unwrap();
    name_in_data_set(folder.path(), "model = \"../bare.json\"\n");
    refused("dataset.toml:2: model: expected an OCV curve in it, found none");
    std::fs::write(data.join("dataset.toml"), &toml).unwrap();
    let keys = "model = \"../bare.json\"\nocv = \"../bare.json\"\n";
    name_in_data_set(folder.path(), keys);
    refused("dataset.toml:3: ocv: expected an OCV curve; ");

    // The curve of the arguments takes the place of the data set's.
    let model = folder.path().join("model.json");
    let whole: serde_json::Value = crate::support::json(&model);
    let curve = folder.path().join("ocv.json");
    std::fs::write(&curve, whole["ocv"].to_string()).unwrap();
    let words = [Path::new("diagnose"), &data, Path::new("--ocv"), &curve];
    assert_eq!(program(&words).code, Some(12));
    let words = [Path::new("diagnose"), &data, Path::new("--model"), &model];
    assert_eq!(program(&words).code, Some(12));

    std::fs::write(data.join("dataset.toml"), &toml).unwrap();
    let keys = "model = \"../bare.json\"\nocv = \"../ocv.json\"\n";
    name_in_data_set(folder.path(), keys);
    let out = folder.path().join("out");
    let words = [Path::new("diagnose"), &data, Path::new("--out"), &out];
    assert_eq!(program(&words).code, Some(12));
    let page = std::fs::read_to_string(out.join("diagnosis.html")).unwrap();
    for text in ["bare.json, SHA-256 ", "ocv.json, SHA-256 "] {
        assert!(page.contains(text), "{text}");
    }
}

#[test]
fn the_catalogue_is_printed() {
    let text = program(&[Path::new("effects")]).stdout;
    assert!(
        analysis::effects::catalogue()
            .iter()
            .all(|e| text.contains(e.card().name)),
        "{text}"
    );
    assert!(
        text.contains("additional relaxation") && text.contains("dv/dt = (R·i − v)/τ"),
        "{text}"
    );
    let cards = program(&["effects", "--json"]).json();
    assert_eq!(
        cards["effects"].as_array().unwrap().len(),
        analysis::effects::catalogue().len()
    );
}

#[test]
fn the_thresholds_are_printed() {
    let text = program(&["effects", "--thresholds"]).ok();
    assert_eq!(text, analysis::diagnosis::thresholds::markdown());
    let all = program(&["effects", "--thresholds", "--json"]).json();
    let of = |name: &str| {
        all.as_array()
            .unwrap()
            .iter()
            .find(|t| t["name"] == name)
            .unwrap()
    };
    assert_eq!(of("LEAST_SCORE")["value"], 8.0);
    assert_eq!(of("LEAST_LAMBDA")["source"]["kind"], "quantile");
}

#[test]
fn the_curve_of_a_run_folder_is_that_of_its_cell() {
    let files = crate::support::Files::short(5);
    files.run("run").expect_code(0);
    let (run, out) = (files.path("run"), files.path("out"));
    let model = run.join("model_1rc.json");
    let output = program(&[
        Path::new("diagnose"),
        &run,
        Path::new("--model"),
        &model,
        Path::new("--out"),
        &out,
    ]);
    output.expect_code(0);
    assert!(
        files
            .text("out/diagnosis.html")
            .contains("eis-bench diagnose ")
    );
    let page = files.text("run/report.html");
    for text in [
        "none: the bench ran in virtual time",
        "cell at rest before its records",
        " --seed 1",
        "config/experiments_demo.toml, SHA-256 ",
    ] {
        assert!(page.contains(text), "{text}");
    }
}

#[test]
fn what_is_asked_by_hand_must_fit_the_model() {
    let folder = tempfile::tempdir().unwrap();
    campaign(folder.path(), &Spec::null(5));
    let [data, model] = ["data", "model.json"].map(|name| folder.path().join(name));
    for (word, name, text) in [
        (
            "--without",
            "diffusion",
            "expected one of the model's additions: none",
        ),
        (
            "--add",
            "nonsense",
            "expected the name of an effect of the catalogue",
        ),
    ] {
        let output = program(&[
            Path::new("diagnose"),
            &data,
            Path::new("--model"),
            &model,
            Path::new(word),
            Path::new(name),
        ]);
        let error = output.stderr;
        assert!(output.code != Some(0) && error.contains(text), "{error}");
    }
}
