//! Jobs go to benches that fit, and their runs are as any others.

use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::{
    files::{EXPERIMENT, Files},
    processes::{Broker, Site, bench_program, poll, run},
};

fn sha256(text: &str) -> String {
    let digest = Sha256::digest(text.as_bytes());
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn a_job_goes_to_the_bench_that_fits_and_its_run_is_as_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let north = Site::start(Files::tiny(), &broker, "north");
    let south = Site::start(Files::tiny().second(), &broker, "south");
    let needs = ["--site", "south", "--current", "5 A", "--cell", "A7"];
    let job = broker.submit(&north.files, &needs);
    let record = broker.wait_for(&job, "done");
    assert_eq!(record["bench"], "south/second");
    let run = format!("demo-{job}");
    let list = south.files.text(&format!("data/runs/{run}/SHA256SUMS"));
    assert_eq!(record["content_sha256"], sha256(&list), "{record}");
    assert_eq!(
        (&record["run"], &record["cell"]),
        (&run.clone().into(), &"A7".into())
    );
    let trail = south.files.text("data/audit.jsonl");
    let begun = format!("\"what\":\"fleet begin {job} as {run}\",\"outcome\":\"begun\"");
    assert!(
        trail.contains(&begun) && trail.contains("\"who\":\"fleet: "),
        "{trail}"
    );
    // The server itself shows the run as any other.
    let runs = south.server.get("/runs");
    assert_eq!(runs[0]["item"]["run"], run.as_str(), "{runs}");
    let intents = std::fs::read_dir(south.files.path("agent/second/intents")).unwrap();
    assert_eq!(intents.count(), 0, "an intent stays behind");
    the_other_agent_shows_the_same(&broker, &north, &job);
}

fn the_other_agent_shows_the_same(broker: &Broker, north: &Site, job: &str) {
    let agent = &north.agent;
    let odd = agent
        .ask("GET /api/v1/fleet/jobs?state=tpyo", "", "")
        .expect(400);
    let expected = "state: expected one of queued, claimed, started, lost, done, failed, cancelled";
    assert!(odd.text().contains(expected), "{}", odd.text());
    let seen = agent.get("/fleet");
    assert_eq!(seen["jobs"]["done"], 1, "{seen}");
    assert_eq!(
        seen["benches"][1]["capabilities"]["current_a"], 20.0,
        "{seen}"
    );
    let jobs = agent.get("/fleet/jobs?state=done");
    assert_eq!(jobs["jobs"][0]["job"], job);
    let cancel = |job: &str| agent.ask(&format!("DELETE /api/v1/fleet/jobs/{job}"), "", "");
    cancel(job).expect(409);
    let large = r#"{"experiment": "demo", "needs": {"current_a": 500}}"#;
    let large = agent.post("/fleet/jobs", large).expect(201).json();
    let stranded = poll("the reason", || {
        let seen = agent.get("/fleet");
        seen["stranded"][0]["why"].as_str().map(str::to_owned)
    });
    assert!(stranded.contains("expected at least 500 A"), "{stranded}");
    cancel(large["jobs"][0].as_str().unwrap()).expect(204);
    let unknown = agent.post("/fleet/jobs", r#"{"experiment": "../none"}"#);
    unknown.expect(404);
    // Jobs that no bench takes are removed together.
    let spare = ["--site", "west", "--count", "3", "--campaign", "spare"];
    broker.submit(&north.files, &spare);
    let cancelled = broker.fleet(&["cancel", "--campaign", "spare"]);
    assert_eq!(cancelled["what"], "3 jobs of spare", "{cancelled}");
    let more = ["--site", "west", "--count", "2", "--campaign", "more"];
    broker.submit(&north.files, &more);
    let path = "DELETE /api/v1/fleet/jobs?campaign=more";
    let cancelled = agent.ask(path, "", "").expect(200).json();
    assert_eq!(cancelled["cancelled"], 2);
    let odd = broker.ask(&["status", "--state", "tpyo"]);
    odd.expect_code(2);
    assert!(
        odd.stderr.contains("[possible values: queued"),
        "{}",
        odd.stderr
    );
}

#[test]
fn a_bench_whose_check_refuses_a_job_gives_the_line_and_takes_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let north = Site::start(Files::tiny(), &broker, "north");
    let text = north.files.text(EXPERIMENT);
    let beyond = text.replace("amplitude = \"1 A\"", "amplitude = \"900 A\"");
    assert_ne!(beyond, text);
    north.files.write("beyond.toml", &beyond);
    let beyond = north.files.path("beyond.toml");
    let job = broker.fleet(&["submit", beyond.to_str().unwrap()]);
    let job = job["jobs"][0].as_str().unwrap().to_owned();
    let words = poll("the reason", || {
        let words = broker.job(&job)["words"].as_str().unwrap().to_owned();
        words.contains("does not take it").then_some(words)
    });
    assert!(
        words.contains("north/demo") && words.contains("900"),
        "{words}"
    );
    let next = broker.submit(&north.files, &[]);
    broker.wait_for(&next, "done");
    assert_eq!(broker.job(&job)["state"], "queued");
}

#[test]
fn a_campaign_that_was_interrupted_is_submitted_again_and_judged_over_both_benches() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let north = Site::start(Files::measuring(), &broker, "north");
    let south = Site::start(Files::measuring().second(), &broker, "south");
    for bench in ["north/demo", "south/second"] {
        broker.fleet(&["drain", bench, "--why", "to see what is submitted"]);
    }
    let text = format!(
        "name = \"batch\"\nexperiment = \"{EXPERIMENT}\"\ncells = 3\nbenches_per_cell = 2\n\
        references = [\"REF-1\"]\n[[benches]]\nname = \"north/demo\"\n\
        [[benches]]\nname = \"south/second\"\n"
    );
    north.files.write("batch.toml", &text);
    let file = north.files.path("batch.toml");
    let submit = || {
        let submitted = broker.fleet(&["campaign", file.to_str().unwrap()]);
        let jobs = submitted["jobs"].as_array().unwrap().iter();
        jobs.map(|job| job.as_str().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    // Three cells on two benches, and the reference at the beginning and at the end of each.
    let mut jobs = submit();
    assert_eq!(jobs.len(), 10);
    for job in jobs.drain(2..5) {
        broker.fleet(&["cancel", &job]);
    }
    for bench in ["north/demo", "south/second"] {
        broker.fleet(&["release", bench, "--why", "go on"]);
    }
    let again = submit();
    assert_eq!(
        again.len(),
        3,
        "what was cancelled is missing, and nothing else"
    );
    for job in jobs.iter().chain(&again) {
        broker.wait_for(job, "done");
    }
    assert_eq!(submit(), [""; 0]);
    north.files.write(
        "batch.toml",
        &text.replace("cells = 3", "cells = \"three\""),
    );
    let odd = broker.ask(&["campaign", file.to_str().unwrap()]).refused();
    assert!(odd.contains("batch.toml:3"), "{odd}");
    judged_over_both(&north, &south);
}

fn judged_over_both(north: &Site, south: &Site) {
    let path = |site: &Site, name: &str| site.files.path(name).display().to_string();
    let (catalog, out) = (path(north, "db.sqlite"), path(north, "report"));
    let (one, two) = (path(north, "data/runs"), path(south, "data/runs"));
    run(&bench_program(), &["catalog", "scan", &catalog, &one, &two]).expect_code(0);
    let words = [
        "campaign", "report", &catalog, "batch", "--json", "--out", &out,
    ];
    let report: Value = run(&bench_program(), &words).json();
    assert_eq!(report["values"], 10, "{report}");
    let of_r = &report["quantities"][0];
    assert_eq!(of_r["cells"].as_array().unwrap().len(), 4, "{of_r}");
    let benches = of_r["benches"].as_array().unwrap().iter();
    let mut benches: Vec<&str> = benches.map(|one| one["bench"].as_str().unwrap()).collect();
    benches.sort_unstable();
    assert_eq!(benches, ["demo", "second"]);
}
