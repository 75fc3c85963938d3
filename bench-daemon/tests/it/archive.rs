//! The archive on the command line and in the server: real run folders of the demo, and a folder
//! as the store.

use std::{ffi::OsStr, fs, path::PathBuf};

use analysis::run_folder::{ARCHIVED, CAPTURES};
use serde_json::Value;

use crate::{
    serve_support::{Served, config, submit},
    support::{Ended, Files, files_below, poll, program},
};

pub(crate) const ARCHIVE: &str = "[archive]\nstore = \"store\"\nsite = \"north\"";

/// A run in the data folder of a server with an archive.
struct Archived {
    files: Files,
}

impl Archived {
    fn new() -> Self {
        let files = Files::short(3);
        config(&files, ARCHIVE);
        files.run("data/runs/first").expect_code(0);
        Self { files }
    }

    fn run(&self) -> PathBuf {
        self.files.path("data/runs/first")
    }

    fn ask(&self, words: &[&str]) -> Ended {
        let config = self.files.path("serve.toml");
        let (act, others) = words.split_first().unwrap();
        let words: Vec<&OsStr> = [OsStr::new("archive"), act.as_ref(), config.as_os_str()]
            .into_iter()
            .chain(others.iter().map(|word| OsStr::new(*word)))
            .collect();
        program(&words)
    }

    fn json(&self, words: &[&str]) -> Value {
        let ended = self.ask(&[words, &["--json"]].concat());
        serde_json::from_str(&ended.expect_code(0).stdout).unwrap()
    }

    fn captures(&self) -> usize {
        files_below(&self.run().join(CAPTURES)).len()
    }

    fn on_run(&self, command: &str) -> Ended {
        program(&[command.as_ref(), self.run().as_os_str()])
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
    program(&["verify".as_ref(), again.as_os_str()]).expect_code(0);
}

#[test]
fn captures_that_were_moved_are_told_from_captures_that_are_lost() {
    let at = Archived::new();
    let captures = at.captures();
    assert!(captures > 3);
    at.ask(&["push"]).expect_code(0);
    at.ask(&["thin", "--captures-after", "1 h"]).expect_code(0);
    assert_eq!(at.captures(), captures, "not due");
    let told = at.ask(&["thin", "--captures-after", "0 s", "--dry-run"]);
    assert!(
        told.stdout
            .contains(&format!("{captures} captures of 1 runs would be moved"))
    );
    assert_eq!(at.captures(), captures, "dry");
    at.ask(&["thin", "--captures-after", "0 s"]).expect_code(0);
    assert_eq!(at.captures(), 0);
    let told = at.on_run("verify").expect_code(0).stdout.clone();
    assert!(told.contains("all as they were"), "{told}");
    assert!(told.contains("nothing was recomputed"), "{told}");
    assert!(
        told.contains("`eis-bench archive fetch` brings it back"),
        "{told}"
    );
    let told = at.on_run("replay").expect_code(2).message().to_owned();
    assert!(told.contains("moved to the archive"), "{told}");
    let catalog = at.files.path("runs.sqlite");
    let runs = at.files.path("data/runs");
    let scanned = program(&[
        "catalog".as_ref(),
        "scan".as_ref(),
        catalog.as_os_str(),
        runs.as_os_str(),
    ]);
    let told = &scanned.expect_code(0).stdout;
    assert!(told.contains("1 runs, 1 of them read, 0 damaged"), "{told}");
    assert_eq!(at.json(&["push"])["unchanged"], 1);
    assert!(at.json(&["status"])["moved_bytes"].as_u64() > Some(0));
    // A capture that is missing without having been moved is lost.
    let list = fs::read_to_string(at.run().join(ARCHIVED)).unwrap();
    fs::write(at.run().join(ARCHIVED), list.replace("point01", "paint01")).unwrap();
    let told = at.on_run("verify").expect_code(10).stdout.clone();
    assert!(told.contains(": missing"), "{told}");
    fs::write(at.run().join(ARCHIVED), list).unwrap();
    at.ask(&["fetch", "first"]).expect_code(0);
    assert_eq!(at.captures(), captures);
    let told = at.on_run("verify").expect_code(0).stdout.clone();
    assert!(told.contains("every number as stored"), "{told}");
}

#[test]
fn what_is_wrong_with_an_archive_is_told_with_what_was_expected() {
    let at = Archived::new();
    let message = |words: &[&str], code: i32| at.ask(words).expect_code(code).message().to_owned();
    let told = message(&["push", "second"], 2);
    assert!(told.contains("expected the name of a run of"), "{told}");
    let told = message(&["verify", "first"], 2);
    assert!(
        told.contains("first: expected a run in the archive, found none"),
        "{told}"
    );
    let told = message(&["fetch", "second", "--out", "x"], 2);
    assert!(
        told.contains("expected an archived run or the SHA-256 of one"),
        "{told}"
    );
    let told = message(&["thin"], 2);
    assert!(
        told.contains("archive.thin.captures_after: expected a time"),
        "{told}"
    );
    fs::write(at.run().join("spectrum.csv"), "x").unwrap();
    message(&["push"], 10);
    let status = at.json(&["status"]);
    let why = status["troubles"][0]["why"].as_str().unwrap();
    assert!(why.contains("spectrum.csv: expected the SHA-256"), "{why}");
    for (section, expected) in [
        ("", "expected a section [archive], found none"),
        (
            "[archive]\nstore = \"x\"\nsite = \" \"",
            "archive.site: expected the name of a site",
        ),
        (
            "[archive]\nstore = \"ftp://x\"\nsite = \"n\"",
            "archive.store: expected a folder or s3://BUCKET/PREFIX, found \"ftp://x\"",
        ),
        (
            "[archive]\nstore = \"s3://b\"\nsite = \"n\"\nendpoint = \"http://192.0.2.1:9000\"",
            "archive.endpoint: expected an address https://HOST/PATH, or http:// on this machine",
        ),
        (
            "[archive]\nstore = \"x\"\nsite = \"n\"\nregion = \"r\"",
            "archive.region: expected with a store s3://… only",
        ),
        (
            "[archive]\nstore = \"x\"\nsite = \"n\"\n[archive.thin]\ncaptures_after = \"1 s\"",
            "archive.thin.captures_after: expected 1 h to 36500 d, found 1 s",
        ),
    ] {
        config(&at.files, section);
        let told = message(&["status"], 2);
        assert!(told.contains(expected), "{told}");
    }
    let keys = at.files.path("keys");
    fs::write(&keys, "aws_access_key_id = x\n").unwrap();
    let section = "[archive]\nstore = \"s3://b\"\nsite = \"n\"\ncredentials_file = \"keys\"";
    config(&at.files, section);
    let told = message(&["push"], 2);
    assert!(told.contains("with mode 0600, found 0644"), "{told}");
    fs::set_permissions(&keys, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
    let told = message(&["push"], 2);
    assert!(
        told.contains("archive.credentials_file: expected aws_secret_access_key in"),
        "{told}"
    );
}

#[test]
fn a_server_sends_its_runs_and_tells_what_is_there() {
    let files = Files::short(3);
    config(&files, ARCHIVE);
    files.run("data/runs/before").expect_code(0);
    let served = Served::start(&files);
    let archived = |count: u64| {
        poll("runs in the archive", || {
            let now = served.get("/archive");
            (now["archived"] == count && now["in_work"] == false).then_some(now)
        })
    };
    archived(1);
    let run = submit(&served, r#"{"experiment":"demo"}"#);
    served.ended(&run);
    let now = archived(2);
    assert_eq!(
        (&now["pending"], &now["trouble"]),
        (&0.into(), &Value::Null)
    );
    let answer = served.ask("GET", "/metrics", ("", "")).expect(200).text();
    assert!(
        answer.contains("eis_bench_archive_runs{state=\"archived\"} 2"),
        "{answer}"
    );
    assert!(answer.contains("eis_bench_archive_trouble 0"), "{answer}");
    // Its store becomes unavailable: the server reports this and continues.
    drop(served);
    fs::remove_dir_all(files.path("store")).unwrap();
    fs::write(files.path("store"), "no folder").unwrap();
    files.run("data/runs/later").expect_code(0);
    let served = Served::start(&files);
    let now = poll("the trouble", || {
        let now = served.get("/archive");
        (now["trouble"] != Value::Null).then_some(now)
    });
    assert_eq!((&now["archived"], &now["pending"]), (&2.into(), &1.into()));
    assert!(now["again_unix_s"].as_f64() > Some(0.0));
    fs::remove_file(files.path("store")).unwrap();
    poll("the run in the store that is back", || {
        (served.get("/archive")["archived"] == 3).then_some(())
    });
}

#[test]
fn a_server_without_an_archive_says_so() {
    let files = Files::short(3);
    config(&files, "");
    let served = Served::start(&files);
    let told = served
        .ask("GET", "/api/v1/archive", ("", ""))
        .expect(404)
        .json();
    assert_eq!(told["code"], "no-archive");
    let answer = served.ask("GET", "/metrics", ("", "")).expect(200).text();
    let has = answer
        .lines()
        .any(|line| line.starts_with("eis_bench_archive"));
    assert!(!has, "{answer}");
}
