//! `eis-archive` on run folders that `eis-bench` wrote, with a folder as the store, and beside a
//! server.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may end a test"
)]

mod support;
#[allow(dead_code, reason = "other test binaries use the rest")]
#[path = "../../../tests/it/under_test.rs"]
mod under_test;

use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::PathBuf,
    process::{Command, Stdio},
};

use analysis_files::run_folder::{ARCHIVED, CAPTURES};
use serde_json::Value;

use support::{Files, Served, bench};
use under_test::{Ended, Running, files_below, poll};

/// File of the archive; the store is a folder beside the data folder.
const ARCHIVE: &str = "data = \"data\"\nstore = \"store\"\nsite = \"north\"\n";

fn archive() -> Command {
    Command::new(env!("CARGO_BIN_EXE_eis-archive"))
}

fn write_config(files: &Files, text: &str) {
    files.write("archive.toml", text);
}

/// Starts `eis-archive follow`.
fn follow(files: &Files) -> Running {
    let mut command = archive();
    command.arg("follow").arg(files.path("archive.toml"));
    command.args(["--every", "1 s"]).stdin(Stdio::null());
    Running(command.stderr(Stdio::null()).spawn().unwrap())
}

/// A run in the data folder of a server with an archive.
struct Archived {
    files: Files,
}

impl Archived {
    fn new() -> Self {
        let files = Files::new();
        write_config(&files, ARCHIVE);
        files.run("data/runs/first");
        Self { files }
    }

    fn run(&self) -> PathBuf {
        self.files.path("data/runs/first")
    }

    fn ask(&self, words: &[&str]) -> Ended {
        let (action, others) = words.split_first().unwrap();
        let mut command = archive();
        command.arg(action).arg(self.files.path("archive.toml"));
        Ended::of(command.args(others).stdin(Stdio::null()).output().unwrap())
    }

    fn json(&self, words: &[&str]) -> Value {
        self.ask(&[words, &["--json"]].concat()).json()
    }

    fn captures(&self) -> usize {
        files_below(&self.run().join(CAPTURES)).len()
    }

    fn on_run(&self, command: &str) -> Ended {
        bench(&[command.as_ref(), self.run().as_os_str()])
    }
}

#[test]
fn a_run_goes_into_the_archive_once_and_comes_back_as_it_was() {
    let at = Archived::new();
    let pushed = at.json(&["push"]);
    assert_eq!(
        (&pushed["archived"], &pushed["refused"]),
        (&1.into(), &0.into())
    );
    assert_eq!(at.json(&["push"])["unchanged"], 1);
    let status = at.json(&["status"]);
    assert_eq!(
        (&status["archived"], &status["site"]),
        (&1.into(), &"north".into())
    );
    let verified = at.json(&["verify"]);
    assert_eq!(verified["runs"], 1);
    let count = files_below(&at.run()).len();
    assert_eq!(verified["files"], count);
    assert_eq!(at.json(&["verify", "--all"])["files"], count);
    let again = at.files.path("again");
    at.ask(&["fetch", "first", "--out", again.to_str().unwrap()])
        .expect_code(0);
    for file in files_below(&at.run()) {
        let (own, copy) = (at.run().join(&file), again.join(&file));
        assert!(
            fs::read(&own).unwrap() == fs::read(&copy).unwrap(),
            "{copy:?}"
        );
    }
    bench(&["verify".as_ref(), again.as_os_str()]).expect_code(0);
}

#[test]
fn captures_that_were_moved_are_distinguished_from_captures_that_are_lost() {
    let at = Archived::new();
    let captures = at.captures();
    assert!(captures > 3);
    at.ask(&["push"]).expect_code(0);
    at.ask(&["thin", "--captures-after", "1 h"]).expect_code(0);
    assert_eq!(at.captures(), captures, "not due");
    let dry_run = at.ask(&["thin", "--captures-after", "0 s", "--dry-run"]);
    assert!(
        dry_run
            .stdout
            .contains(&format!("{captures} captures of 1 runs would be moved"))
    );
    assert_eq!(at.captures(), captures, "dry");
    at.ask(&["thin", "--captures-after", "0 s"]).expect_code(0);
    assert_eq!(at.captures(), 0);
    let text = at.on_run("verify").ok();
    assert!(text.contains("all as they were"), "{text}");
    assert!(text.contains("nothing was recomputed"), "{text}");
    assert!(
        text.contains("`eis-archive fetch` brings it back"),
        "{text}"
    );
    let text = at.on_run("replay").expect_code(2).message().to_owned();
    assert!(text.contains("moved to the archive"), "{text}");
    let catalog = at.files.path("runs.sqlite");
    let runs = at.files.path("data/runs");
    let scanned = bench(&[
        "catalog".as_ref(),
        "scan".as_ref(),
        catalog.as_os_str(),
        runs.as_os_str(),
    ]);
    let text = &scanned.ok();
    assert!(text.contains("1 runs, 1 of them read, 0 damaged"), "{text}");
    assert_eq!(at.json(&["push"])["unchanged"], 1);
    assert!(at.json(&["status"])["moved_bytes"].as_u64() > Some(0));
    // A capture that is missing without having been moved is lost.
    let list = fs::read_to_string(at.run().join(ARCHIVED)).unwrap();
    fs::write(at.run().join(ARCHIVED), list.replace("point01", "paint01")).unwrap();
    let text = at.on_run("verify").expect_code(10).stdout.clone();
    assert!(text.contains(": missing"), "{text}");
    fs::write(at.run().join(ARCHIVED), list).unwrap();
    at.ask(&["fetch", "first"]).expect_code(0);
    assert_eq!(at.captures(), captures);
    let text = at.on_run("verify").ok();
    assert!(text.contains("every number as stored"), "{text}");
}

#[test]
fn what_is_wrong_with_an_archive_is_reported_with_what_was_expected() {
    let at = Archived::new();
    let message = |words: &[&str], code: i32| at.ask(words).expect_code(code).message().to_owned();
    let error = message(&["push", "second"], 2);
    assert!(error.contains("expected the name of a run of"), "{error}");
    let error = message(&["verify", "first"], 2);
    assert!(
        error.contains("first: expected a run in the archive, found none"),
        "{error}"
    );
    let error = message(&["fetch", "second", "--out", "x"], 2);
    assert!(
        error.contains("expected an archived run or the SHA-256 of one"),
        "{error}"
    );
    let error = message(&["thin"], 2);
    assert!(
        error.contains("thin.captures_after: expected a time"),
        "{error}"
    );
    fs::write(at.run().join("spectrum.csv"), "x").unwrap();
    message(&["push"], 10);
    let status = at.json(&["status"]);
    let why = status["troubles"][0]["why"].as_str().unwrap();
    assert!(why.contains("spectrum.csv: expected the SHA-256"), "{why}");
    let own = "data = \"data\"\n";
    for (text, expected) in [
        ("", "missing field `data`"),
        (
            "data = \"nowhere\"\nstore = \"x\"\nsite = \"n\"",
            "data: expected the data folder of a server",
        ),
        (
            "store = \"x\"\nsite = \" \"",
            "site: expected the name of a site",
        ),
        (
            "store = \"ftp://x\"\nsite = \"n\"",
            "store: expected a folder or s3://BUCKET/PREFIX, found \"ftp://x\"",
        ),
        (
            "store = \"s3://b\"\nsite = \"n\"\nendpoint = \"http://192.0.2.1:9000\"",
            "endpoint: expected an address https://HOST/PATH, or http:// on this machine",
        ),
        (
            "store = \"x\"\nsite = \"n\"\nregion = \"r\"",
            "region: expected with a store s3://… only",
        ),
        (
            "store = \"x\"\nsite = \"n\"\n[thin]\ncaptures_after = \"1 s\"",
            "thin.captures_after: expected 1 h to 36500 d, found \"1 s\"",
        ),
    ] {
        let begin = if text.starts_with("store") { own } else { "" };
        write_config(&at.files, &format!("{begin}{text}"));
        let error = message(&["status"], 2);
        assert!(error.contains(expected), "{error}");
    }
    let keys = at.files.path("keys");
    fs::write(&keys, "aws_access_key_id = x\n").unwrap();
    let text = "data = \"data\"\nstore = \"s3://b\"\nsite = \"n\"\ncredentials_file = \"keys\"";
    write_config(&at.files, text);
    let error = message(&["push"], 2);
    assert!(error.contains("with mode 0600, found 0644"), "{error}");
    fs::set_permissions(&keys, PermissionsExt::from_mode(0o600)).unwrap();
    let error = message(&["push"], 2);
    assert!(
        error.contains("credentials_file: expected aws_secret_access_key in"),
        "{error}"
    );
}

#[test]
fn a_follower_sends_runs_as_they_end_and_the_server_shows_its_state() {
    let files = Files::new();
    files.write_server("");
    write_config(&files, ARCHIVE);
    files.run("data/runs/before");
    let served = Served::start(&files);
    let following = follow(&files);
    let archived = |count: u64| {
        poll("runs in the archive", || {
            let now = served.archive()?;
            (now["archived"] == count && now["in_work"] == false).then_some(now)
        })
    };
    archived(1);
    let queued = served.ask("POST", "/api/v1/queue", r#"{"experiment":"demo"}"#);
    queued.expect(201);
    let now = archived(2);
    assert_eq!(
        (&now["pending"], &now["trouble"]),
        (&0.into(), &Value::Null)
    );
    poll("the archive in the metrics", || {
        let text = served.ask("GET", "/metrics", "").text();
        let has = |row: &str| text.lines().any(|line| line == row);
        let is_up_to_date = has("eis_bench_archive_runs{state=\"archived\"} 2");
        (is_up_to_date && has("eis_bench_archive_trouble 0")).then_some(())
    });
    // A store that fails is retried, and the server shows why.
    drop(following);
    fs::remove_dir_all(files.path("store")).unwrap();
    files.write("store", "no folder");
    files.run("data/runs/later");
    let _following = follow(&files);
    let now = poll("the trouble", || {
        let now = served.archive()?;
        (now["trouble"] != Value::Null).then_some(now)
    });
    assert_eq!((&now["archived"], &now["pending"]), (&2.into(), &1.into()));
    assert!(now["again_unix_s"].as_f64() > Some(0.0));
    fs::remove_file(files.path("store")).unwrap();
    archived(3);
}

#[test]
fn a_server_refuses_the_section_of_the_archive_and_shows_none() {
    let files = Files::new();
    let path = files.write_server("[archive]\nstore = \"store\"\nsite = \"north\"");
    let ended = bench(&["serve".as_ref(), path.as_os_str()]);
    ended.expect_code(2);
    let message = ended.message();
    assert!(
        message.contains("archive: the archive has a file of its own"),
        "{message}"
    );
    files.write_server("");
    let served = Served::start(&files);
    let refused = served.ask("GET", "/api/v1/archive", "").expect(404);
    assert_eq!(refused.json()["code"], "no-archive");
    let text = served.ask("GET", "/metrics", "").text();
    let has_value = text
        .lines()
        .any(|line| line.starts_with("eis_bench_archive"));
    assert!(!has_value, "{text}");
}
