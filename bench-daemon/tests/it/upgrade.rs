//! Run folders and data folders of earlier versions, from `fixtures/data/upgrade`:
//! this version reads, verifies and serves them. With `EIS_BENCH_WRITE_UPGRADE=1` the folder of this
//! version is written, which is done once, at its release.

use std::{
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
};

use serde_json::{Value, json};

use crate::{
    serve_support::{Served, config, submit, token},
    support::{Files, command, files_below, poll, program},
};

const WRITE: &str = "EIS_BENCH_WRITE_UPGRADE";
const THIS: &str = env!("CARGO_PKG_VERSION");
/// Parts of a server's folder that are kept.
const KEPT: [&str; 6] = [
    "serve.toml",
    "experiments",
    "benches",
    "cells",
    "scenarios",
    "data",
];

fn kept() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/data/upgrade")
}

fn copy(from: &Path, to: &Path) {
    for file in files_below(from) {
        let target = to.join(&file);
        fs::create_dir_all(target.parent().unwrap()).unwrap();
        fs::copy(from.join(&file), target).unwrap();
    }
}

fn get(served: &Served, token: &str, path: &str) -> Value {
    served
        .ask("GET", &format!("/api/v1{path}"), (token, ""))
        .expect(200)
        .json()
}

fn send(served: &Served, token: &str, (method, path): (&str, &str), body: &Value) -> Value {
    let answer = served.ask(
        method,
        &format!("/api/v1{path}"),
        (token, &body.to_string()),
    );
    assert!(answer.status < 300, "{path}: {}", answer.text());
    answer.json()
}

/// A server's folder as people leave it: a run that is finished, with notes, tags and a fit; a
/// changed cell; one that died; one that waits behind it; a token.
fn write() {
    let files = Files::short(4);
    config(&files, "");
    let served = Served::start(&files);
    let finished = submit(&served, r#"{"experiment":"demo"}"#);
    assert_eq!(served.ended(&finished)["finished"], true);
    send(
        &served,
        "",
        ("POST", "/runs/demo-1/notes"),
        &json!({"text": "the first"}),
    );
    send(
        &served,
        "",
        ("PUT", "/runs/demo-1/tags"),
        &json!({"tags": ["kept"]}),
    );
    let fit = json!({"kind": "fit", "runs": ["demo-1"], "options": {"rc": "1"}});
    send(&served, "", ("POST", "/analyses"), &fit);
    poll("the fit", || {
        let one = served.get("/analyses/fit-1");
        assert_ne!(one["state"], "failed", "{one}");
        (one["state"] == "done").then_some(())
    });
    let cell = served.get("/files/cells/p45b");
    let change = json!({
        "text": format!("{}\n# changed\n", cell["text"].as_str().unwrap()),
        "why": "to see it kept",
        "was_sha256": cell["sha256"],
    });
    send(&served, "", ("PUT", "/files/cells/p45b"), &change);
    drop(served);
    // The next run dies in its sweep.
    let served = Served::start_with(&files, &[("EIS_BENCH_DRILL", "journal:40")]);
    let died = submit(&served, r#"{"experiment":"demo"}"#);
    assert_eq!(served.ended(&died)["finished"], false);
    submit(&served, r#"{"experiment":"demo"}"#);
    drop(served);
    let secret = token(&files, "ada", "read,operate,energise");
    let to = kept().join(THIS);
    let _ = fs::remove_dir_all(&to);
    for part in KEPT {
        let from = files.path(part);
        if from.is_dir() {
            copy(&from, &to.join(part));
        } else {
            fs::create_dir_all(&to).unwrap();
            fs::copy(from, to.join(part)).unwrap();
        }
    }
    fs::write(to.join("token.txt"), secret).unwrap();
    let _ = fs::remove_file(to.join("data/lock"));
}

/// Copies the folder of a version; returns the copy and its token.
fn unpacked(version: &str) -> (Files, String) {
    let files = Files::demo();
    let from = kept().join(version);
    copy(&from, &files.path("."));
    let tokens = files.path("data/tokens.json");
    let mode = std::os::unix::fs::PermissionsExt::from_mode;
    fs::set_permissions(tokens, mode(0o600)).unwrap();
    let audit = files.path("data/audit.jsonl");
    fs::set_permissions(audit, mode(0o640)).unwrap();
    let secret = fs::read_to_string(from.join("token.txt")).unwrap();
    (files, secret)
}

/// Number of frequencies of its run.
fn frequencies(version: &str) -> usize {
    if version == "0.1.0" { 2 } else { 4 }
}

fn versions() -> Vec<String> {
    let mut all: Vec<String> = fs::read_dir(kept())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    all.sort();
    all
}

#[test]
fn run_folders_of_every_version_are_verified_and_their_results_read() {
    if std::env::var_os(WRITE).is_some() {
        write();
    }
    for version in versions() {
        let (files, _) = unpacked(&version);
        let run = files.path("data/runs/demo-1");
        // Every file is as it was written, and every number comes out again. Reports and pictures are
        // drawn by the program that verifies.
        let text = program(&["verify".as_ref(), run.as_os_str()]).stdout;
        assert!(
            text.contains("against SHA256SUMS: all as they were"),
            "{text}"
        );
        let differ = text.lines().filter(|line| line.starts_with("  "));
        for line in differ {
            let drawn = ["  report.html:", "  plots/", "  recorded by version "];
            let is_new = line.ends_with("the version that wrote the folder did not write it");
            assert!(
                is_new || drawn.iter().any(|name| line.starts_with(name)),
                "{text}"
            );
        }
        let model = run.join("model_1rc.json");
        let stored: Value = serde_json::from_str(&fs::read_to_string(&model).unwrap()).unwrap();
        assert_eq!(stored["program"], format!("eis-bench {version}"));
        let pack = "pack size --series 16 --parallel 3 --ocv-v 3.6 --model";
        let mut words: Vec<&OsStr> = pack.split(' ').map(OsStr::new).collect();
        words.push(model.as_os_str());
        program(&words).expect_code(0);
        // A run whose process died is resumed with the version that began it, and the message
        // names this version.
        let died = files.path("data/runs/demo-2");
        let ended = program(&["resume".as_ref(), died.as_os_str()]);
        if version == THIS {
            ended.expect_code(0);
        } else {
            ended.expect_code(2);
            assert!(ended.message().contains(&version), "{}", ended.message());
        }
    }
}

#[test]
fn the_data_folder_of_every_version_is_served_with_all_that_people_left_in_it() {
    for version in versions() {
        let (files, secret) = unpacked(&version);
        let served = Served::start(&files);
        let get = |path: &str| get(&served, &secret, path);
        let runs = get("/runs");
        let names: Vec<&str> = runs
            .as_array()
            .unwrap()
            .iter()
            .map(|job| job["item"]["run"].as_str().unwrap())
            .collect();
        assert_eq!(names, ["demo-2", "demo-1"], "{version}");
        let run = get("/runs/demo-1");
        assert_eq!(run["card"]["tags"], json!(["kept"]));
        assert_eq!(get("/runs/demo-1/notes")[0]["text"], "the first");
        assert_eq!(
            get("/runs/demo-1/spectra")[0]["points"]
                .as_array()
                .unwrap()
                .len(),
            frequencies(&version)
        );
        assert_eq!(get("/analyses/fit-1")["state"], "done");
        let cell = get("/files/cells/p45b");
        assert_eq!(cell["versions"][1]["why"], "to see it kept");
        assert!(get("/queue")["held"]["demo"].is_string());
        let why = json!({"why": "the next version"});
        send(&served, &secret, ("POST", "/benches/demo/release"), &why);
        let ended = poll("the run that waited", || {
            let runs = get("/runs");
            let ended = &runs.as_array().unwrap().first()?["ended"];
            (runs[0]["item"]["run"] == "demo-3" && ended.is_object()).then(|| ended.clone())
        });
        assert_eq!(ended["finished"], true, "{ended}");
        let trail = files.text("data/audit.jsonl");
        assert!(!trail.contains("is not as it was written"), "{trail}");
    }
    // The program under test has the version that the test assumes.
    let printed = command(&["--version"]).output().unwrap();
    assert_eq!(
        String::from_utf8_lossy(&printed.stdout).trim(),
        format!("eis-bench {THIS}")
    );
}
