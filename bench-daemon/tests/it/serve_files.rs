//! A bench that is edited over the API: a saved change is a proposal, a person at the machine puts
//! it in force, and a running server begins no run on a bench whose file it does not know.

use std::{
    fs,
    os::unix::fs::{MetadataExt, PermissionsExt},
    path::Path,
};

use bench_core::safety::state::{Latched, State};
use bench_plan::config::load_bench;
use serde_json::{Value, json};

use crate::{
    serve_support::{Answer, Served, config, submit},
    support::{BENCH, Ended, Files, poll, program},
};

const FILE: &str = "/files/benches/demo";

fn propose(served: &Served, text: &str, was: &Value) -> Answer {
    let body = json!({ "text": text, "why": "measured anew", "was_sha256": was }).to_string();
    served.ask("PUT", &format!("/api/v1{FILE}"), ("", &body))
}

/// Proposes another trim of the command.
fn propose_trim(served: &Served, trim: &str) -> Value {
    let file = served.get(FILE);
    let text = file["text"]
        .as_str()
        .unwrap()
        .replace("command_trim = 1.0", &format!("command_trim = {trim}"));
    propose(served, &text, &file["sha256"]).expect(200).json()
}

fn take(files: &Files, more: &[&str]) -> Ended {
    let server = files.path("serve.toml");
    let mut arguments = vec!["config".as_ref(), "take".as_ref(), server.as_os_str()];
    arguments.push("demo".as_ref());
    arguments.extend(more.iter().map(|one| std::ffi::OsStr::new(*one)));
    program(&arguments)
}

#[test]
fn a_bench_is_proposed_over_the_api_and_put_in_force_at_the_machine() {
    let files = Files::short(3);
    config(&files, "");
    fs::set_permissions(files.path(BENCH), fs::Permissions::from_mode(0o640)).unwrap();
    let before = files.text(BENCH);
    let served = Served::start(&files);
    let first = served.get(FILE);
    assert_eq!(
        (&first["proposed"], &first["restart"], &first["changes"]),
        (&Value::Null, &Value::Null, &json!([]))
    );
    for (from, to, expected) in [
        ("name = \"demo\"", "name = \"other\"", "name: expected"),
        (
            "trim = 1.0",
            "trim = 100.0",
            "wiring.command_trim: expected",
        ),
        (
            "../scenarios/p45b",
            "../../../../etc/passwd",
            "simulation.scenario: ",
        ),
        ("[wiring]", "[wirin]", "wirin"),
    ] {
        assert!(before.contains(from), "{from}");
        let answer = propose(&served, &before.replace(from, to), &first["sha256"]).expect(422);
        let message = answer.json()["message"].as_str().unwrap().to_owned();
        assert!(
            message.starts_with("text: line ") && message.contains(expected),
            "{message}"
        );
    }
    let wrong = before.replace("trim = 1.0", "trim = 100.0");
    let draft = json!({ "text": wrong, "kind": "benches", "name": "demo" }).to_string();
    let draft = served.post("/drafts", &draft).expect(200).json();
    assert_eq!(draft["mistakes"][0]["field"], "wiring.command_trim");

    let proposed = propose_trim(&served, "1.25");
    let change = json!([{ "key": "wiring.command_trim", "was": "1.0", "now": "1.25" }]);
    assert_eq!(
        (&proposed["proposed"], &proposed["changes"]),
        (&json!(1), &change)
    );
    assert_eq!(served.get("/files/benches")[0]["proposed"], 1);
    assert_eq!(files.text(BENCH), before, "the server writes no bench file");
    propose(&served, &before, &first["sha256"]).expect(409);
    assert_eq!(served.get(&format!("{FILE}?version=0"))["text"], before);
    submit(&served, r#"{"experiment":"demo"}"#);
    served.ended("demo-1");

    let asked = take(&files, &[]);
    asked.expect_code(2);
    assert!(asked.stdout.contains("  wiring.command_trim: 1.0 -> 1.25"));
    assert!(asked.message().contains("expected --yes"));
    take(&files, &["--version", "7", "--yes"]).expect_code(2);
    assert_eq!(files.text(BENCH), before);
    take(&files, &["--yes"]).expect_code(0);
    assert!(files.text(BENCH).contains("command_trim = 1.25"));
    let mode = fs::metadata(files.path(BENCH)).unwrap().mode() & 0o7777;
    assert_eq!(mode, 0o640);
    assert!(fs::read_dir(files.path("benches")).unwrap().count() == 1);

    let taken = served.get(FILE);
    let kinds: Vec<&Value> = taken["versions"]
        .as_array()
        .unwrap()
        .iter()
        .map(|one| &one["kind"])
        .collect();
    assert_eq!(kinds, ["written", "written", "before", "taken"]);
    assert_eq!(taken["proposed"], Value::Null);
    let restart = taken["restart"].as_str().unwrap();
    assert!(restart.contains("restart the server"), "{restart}");
    let refused = served
        .post("/queue", r#"{"experiment":"demo"}"#)
        .expect(422);
    assert!(
        refused.text().contains("restart the server"),
        "{}",
        refused.text()
    );

    drop(served);
    let served = Served::start(&files);
    assert_eq!(served.get(FILE)["restart"], Value::Null);
    served.get("/experiments/demo/plan");
    // The file of before is put in force as any other version.
    take(&files, &["--version", "2", "--yes"]).expect_code(0);
    assert_eq!(files.text(BENCH), before);
    let again = take(&files, &["--version", "2", "--yes"]);
    assert!(again.stdout.contains("is in force already"));
}

#[test]
fn a_proposal_is_withdrawn_by_the_text_in_force() {
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    let before = files.text(BENCH);
    let proposed = propose_trim(&served, "1.25");
    let withdrawn = propose(&served, &before, &proposed["sha256"])
        .expect(200)
        .json();
    assert_eq!(withdrawn["proposed"], Value::Null);
    assert_eq!(withdrawn["versions"][2]["kind"], "withdrawn");
    let none = take(&files, &["--yes"]);
    none.expect_code(2);
    assert!(
        none.message()
            .contains("proposed and not in force, found none")
    );
}

#[test]
fn a_run_that_was_planned_with_another_bench_file_is_not_begun() {
    let files = Files::short(3);
    config(&files, "");
    let served = Served::start(&files);
    served.post("/benches/demo/hold", "{}").expect(200);
    submit(&served, r#"{"experiment":"demo"}"#);
    propose_trim(&served, "1.25");
    take(&files, &["--yes"]).expect_code(0);
    let held = |served: &Served, words: &str| {
        served.post("/benches/demo/release", "{}").expect(200);
        poll(words, || {
            let held = served.get("/queue")["held"]["demo"].clone();
            held.as_str()
                .filter(|held| held.contains(words))
                .map(str::to_owned)
        });
    };
    held(&served, "restart the server");
    drop(served);
    let served = Served::start(&files);
    held(&served, "submit it again");
    assert!(!files.path("data/runs/demo-1").exists());
    let id = served.get("/queue")["items"][0]["id"].to_string();
    let path = format!("/api/v1/queue/{id}");
    served.ask("DELETE", &path, ("", "")).expect(200);
    served.post("/benches/demo/release", "{}").expect(200);
    assert_eq!(submit(&served, r#"{"experiment":"demo"}"#), "demo-2");
    served.ended("demo-2");
}

/// Returns the demo's bench with addresses on this machine where no instrument listens: it has a
/// state.
fn outside_the_process() -> Files {
    let files = Files::demo();
    let text = files.text(BENCH);
    let roles = text.matches("\"memory:").count();
    let text = (0..roles).fold(text, |text, place| {
        let (before, rest) = text.split_once("\"memory:").unwrap();
        let (_, after) = rest.split_once('"').unwrap();
        format!("{before}\"tcp://127.0.0.1:{}\"{after}", 50_000 + place)
    });
    files.write(BENCH, &text);
    files
}

#[test]
fn the_file_of_a_bench_that_is_in_use_or_latched_is_not_changed() {
    let files = outside_the_process();
    config(&files, "");
    let served = Served::start(&files);
    propose_trim(&served, "1.25");
    drop(served);
    let before = files.text(BENCH);
    let (bench, _) = load_bench(&files.path(BENCH)).unwrap();
    let state = State::of(&bench).unwrap().unwrap();
    let run = Path::new("/run");

    let lock = state.lock(run).unwrap();
    take(&files, &["--yes"]).expect_code(8);
    drop(lock);
    let guardian = state.lock_guardian().unwrap().unwrap();
    take(&files, &["--yes"]).expect_code(8);
    drop(guardian);
    state.begin(run).unwrap();
    let open = take(&files, &["--yes"]);
    open.expect_code(2);
    assert!(
        open.message().contains("verified off"),
        "{}",
        open.message()
    );
    state.settled().unwrap();
    let trip = Latched::new("daemon", "too hot");
    state.latch(&trip).unwrap();
    take(&files, &["--yes"]).expect_code(7);
    state.clear(&trip, None, None).unwrap();
    assert_eq!(files.text(BENCH), before);
    take(&files, &["--yes"]).expect_code(0);
    assert!(files.text(BENCH).contains("command_trim = 1.25"));
}
