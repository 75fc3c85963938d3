//! Real servers in a fleet: a job goes to a suitable bench, is visible and can be stopped from
//! another server, and a server that was killed continues its job. Needs `nats-server` in the
//! PATH, and prints a message if it is missing.

use std::{
    ffi::OsStr,
    fs,
    net::TcpListener,
    path::Path,
    process::{Command, Stdio},
};

use bench_daemon::support::hash;
use serde_json::Value;

use crate::{
    serve_support::{Served, data},
    support::{BENCH, EXPERIMENT, Files, Running, SCENARIO, poll, program},
};

/// A broker, and its address.
pub(crate) struct Broker {
    _process: Running,
    pub(crate) address: String,
}

impl Broker {
    pub(crate) fn start(folder: &Path) -> Option<Self> {
        let bound = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = bound.local_addr().unwrap().port().to_string();
        drop(bound);
        let child = Command::new("nats-server")
            .args(["-js", "-a", "127.0.0.1", "-p", &port, "-sd"])
            .arg(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        match child {
            Ok(child) => Some(Self {
                _process: Running(child),
                address: format!("nats://127.0.0.1:{port}"),
            }),
            Err(error) => {
                eprintln!("skipped: nats-server cannot be started: {error}");
                None
            }
        }
    }

    /// Writes the file of a server with one bench in this fleet.
    fn config(&self, files: &Files, site: &str) {
        let text = format!(
            "listen = \"127.0.0.1:0\"\ndata = \"data\"\nconfigs = \".\"\n\
            benches = [\"{BENCH}\"]\n[fleet]\nname = \"lab\"\nsite = \"{site}\"\n\
            server = \"{}\"\nlease = \"3 s\"\n",
            self.address
        );
        files.write("serve.toml", &text);
    }

    /// Returns the arguments of `fleet`.
    fn asked<'a>(&'a self, more: &[&'a str]) -> Vec<&'a OsStr> {
        let asked = [
            "fleet",
            "--fleet",
            "lab",
            "--server",
            &self.address,
            "--json",
        ];
        let asked = asked.into_iter().chain(more.iter().copied());
        asked.map(OsStr::new).collect()
    }

    /// Runs `fleet` on the command line and returns its answer.
    fn fleet(&self, more: &[&str]) -> Value {
        let ended = program(&self.asked(more));
        ended.expect_code(0);
        serde_json::from_str(&ended.stdout).unwrap()
    }

    fn job(&self, job: &str) -> Value {
        let status = self.fleet(&["status", "--all"]);
        let listed = status["listed"].as_array().unwrap();
        let found = listed.iter().find(|one| one["job"] == job);
        found.unwrap().clone()
    }

    fn submit(&self, files: &Files, more: &[&str]) -> String {
        let experiment = files.experiment();
        let arguments = ["submit", experiment.to_str().unwrap()];
        let submitted = self.fleet(&[&arguments[..], more].concat());
        submitted["jobs"][0].as_str().unwrap().to_owned()
    }

    /// Waits until a bench may take a job.
    fn knows(&self, site: &str) {
        poll("a bench that is idle", || {
            let status = self.fleet(&["status"]);
            let benches = status["benches"].as_array()?.iter();
            let mut idle = benches.filter(|one| one["site"] == site && one["state"] == "idle");
            idle.next().map(drop)
        });
    }
}

/// Returns files with the cell alone and two points: a run of less than a second.
fn tiny() -> Files {
    Files::short(2).without(EXPERIMENT, "fixture_check")
}

/// Returns files with controls and a sweep to which a model with two pairs is fitted.
fn measuring() -> Files {
    Files::short(8)
        .edit(EXPERIMENT, "rc = [1]", "rc = [2]")
        .edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"0.5 Hz\"")
        .append(SCENARIO, "[specimens]\nstore = 5\n")
}

#[test]
fn a_job_goes_to_the_bench_that_fits_and_its_run_is_as_any_other() {
    let north = tiny();
    let Some(broker) = Broker::start(&north.path("nats")) else {
        return;
    };
    let south = tiny().edit(BENCH, "name = \"demo\"", "name = \"second\"");
    broker.config(&north, "north");
    broker.config(&south, "south");
    let (one, two) = (Served::start(&north), Served::start(&south));
    broker.knows("north");
    broker.knows("south");
    let job = broker.submit(
        &north,
        &["--site", "south", "--current", "5 A", "--cell", "A7"],
    );
    let run = format!("demo-{job}");
    let ended = two.ended(&run);
    assert_eq!(ended["finished"], true, "{ended}");
    let told = poll("the end of the job", || {
        let told = broker.job(&job);
        (told["state"] == "done").then_some(told)
    });
    assert_eq!(told["bench"], "south/second");
    let list = data(&south, &format!("runs/{run}/SHA256SUMS"));
    assert_eq!(told["content_sha256"], hash::sha256(list), "{told}");
    assert_eq!((&told["run"], &told["cell"]), (&run.into(), &"A7".into()));
    assert!(data(&south, "audit.jsonl").contains(&format!("fleet begin {job}")));
    let odd = one
        .ask("GET", "/api/v1/fleet/jobs?state=tpyo", ("", ""))
        .expect(400);
    let told = "state: expected one of queued, claimed, started, lost, done, failed, cancelled";
    assert!(odd.text().contains(told), "{}", odd.text());
    // The other server shows the same state, and refuses what it should.
    let seen = one.get("/fleet");
    assert_eq!(seen["jobs"]["done"], 1, "{seen}");
    assert_eq!(
        seen["benches"][1]["capabilities"]["current_a"], 20.0,
        "{seen}"
    );
    let jobs = one.get("/fleet/jobs?state=done");
    assert_eq!(jobs["jobs"][0]["job"], job);
    let path = format!("/api/v1/fleet/jobs/{job}");
    one.ask("DELETE", &path, ("", "")).expect(409);
    let large = r#"{"experiment": "demo", "needs": {"current_a": 500}}"#;
    let large = one.post("/fleet/jobs", large).expect(201).json();
    let stranded = poll("the reason", || {
        let seen = one.get("/fleet");
        seen["stranded"][0]["why"].as_str().map(str::to_owned)
    });
    assert!(stranded.contains("expected at least 500 A"), "{stranded}");
    let path = format!("/api/v1/fleet/jobs/{}", large["jobs"][0].as_str().unwrap());
    one.ask("DELETE", &path, ("", "")).expect(204);
    // Jobs that no bench takes are removed together, and a bench that is gone is removed from the
    // fleet.
    broker.submit(
        &north,
        &["--site", "west", "--count", "3", "--campaign", "spare"],
    );
    let cancelled = broker.fleet(&["cancel", "--campaign", "spare"]);
    assert_eq!(cancelled["what"], "3 jobs of spare", "{cancelled}");
    broker.submit(
        &north,
        &["--site", "west", "--count", "2", "--campaign", "more"],
    );
    let path = "/api/v1/fleet/jobs?campaign=more";
    let cancelled = one.ask("DELETE", path, ("", "")).expect(200).json();
    assert_eq!(cancelled["cancelled"], 2);
    drop(two);
    poll("a bench that is forgotten", || {
        let ended = program(&broker.asked(&["forget", "south/second"]));
        ended.stdout.contains("forgotten").then_some(())
    });
    let stopped = broker.fleet(&["stop", "--all"]);
    assert_eq!(stopped.as_array().unwrap().len(), 1, "{stopped}");
    let odd = program(&broker.asked(&["status", "--state", "tpyo"]));
    assert!(
        odd.expect_code(2)
            .stderr
            .contains("[possible values: queued"),
        "{}",
        odd.stderr
    );
}

#[test]
fn a_campaign_that_was_interrupted_is_submitted_again_and_judged_over_both_benches() {
    let north = measuring();
    let Some(broker) = Broker::start(&north.path("nats")) else {
        return;
    };
    let south = measuring().edit(BENCH, "name = \"demo\"", "name = \"second\"");
    broker.config(&north, "north");
    broker.config(&south, "south");
    let _servers = (Served::start(&north), Served::start(&south));
    broker.knows("north");
    broker.knows("south");
    for bench in ["north/demo", "south/second"] {
        broker.fleet(&["drain", bench, "--why", "to see what is submitted"]);
    }
    let text = format!(
        "name = \"batch\"\nexperiment = \"{EXPERIMENT}\"\ncells = 3\nbenches_per_cell = 2\n\
        references = [\"REF-1\"]\n[[benches]]\nname = \"north/demo\"\n\
        [[benches]]\nname = \"south/second\"\n"
    );
    north.write("batch.toml", &text);
    let file = north.path("batch.toml");
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
        poll("the end of a job", || {
            (broker.job(job)["state"] == "done").then_some(())
        });
    }
    assert_eq!(submit(), [""; 0]);
    let path = |files: &Files, name: &str| files.path(name).into_os_string();
    let (catalog, out) = (path(&north, "db.sqlite"), path(&north, "report"));
    let (one, two) = (path(&north, "data/runs"), path(&south, "data/runs"));
    program(&["catalog".as_ref(), "scan".as_ref(), &catalog, &one, &two]).expect_code(0);
    let report = program(&[
        "campaign".as_ref(),
        "report".as_ref(),
        &catalog,
        "batch".as_ref(),
        "--json".as_ref(),
        "--out".as_ref(),
        &out,
    ]);
    let report: Value = serde_json::from_str(&report.expect_code(0).stdout).unwrap();
    assert_eq!(report["values"], 10, "{report}");
    let of_r = &report["quantities"][0];
    assert_eq!(of_r["cells"].as_array().unwrap().len(), 4, "{of_r}");
    let benches = of_r["benches"].as_array().unwrap().iter();
    let mut benches: Vec<&str> = benches.map(|one| one["bench"].as_str().unwrap()).collect();
    benches.sort_unstable();
    assert_eq!(benches, ["demo", "second"]);
}

#[test]
fn a_bench_is_held_stopped_and_released_from_elsewhere_and_a_latch_is_out_of_reach() {
    // In scaled time, so that there is a run to be stopped.
    let files = tiny().edit(BENCH, "[simulation]", "[simulation]\ntime = \"scaled:1\"");
    let Some(broker) = Broker::start(&files.path("nats")) else {
        return;
    };
    broker.config(&files, "north");
    let served = Served::start(&files);
    broker.knows("north");
    let job = broker.submit(&files, &[]);
    poll("a run", || {
        (served.get("/benches/demo")["state"] == "running").then_some(())
    });
    let stopped = served
        .post("/fleet/benches/north/demo/stop", r#"{"why": "smoke"}"#)
        .expect(200)
        .json();
    assert_eq!(stopped["outputs_verified"], true, "{stopped}");
    poll("the end of the job", || {
        (broker.job(&job)["state"] == "failed").then_some(())
    });
    let released = broker.fleet(&["release", "north/demo", "--why", "it was steam"]);
    assert_eq!(released[0]["heard"], true, "{released}");
    // The fleet cannot remove a hold by the bench's own server.
    served
        .post("/benches/demo/hold", r#"{"why": "new probes"}"#)
        .expect(200);
    let released = broker.fleet(&["release", "north/demo", "--why", "I want to measure"]);
    assert!(
        released[0]["held"]
            .as_str()
            .unwrap()
            .starts_with("new probes"),
        "{released}"
    );
    let all = served.post("/fleet/stop", r#"{"why": "smoke"}"#);
    let all = all.expect(200).json();
    assert_eq!(all["benches"][0]["bench"], "demo", "{all}");
    assert_eq!(all["benches"][0]["outputs_verified"], true, "{all}");
    assert_eq!(all["unreached"], serde_json::Value::Null, "{all}");
    served
        .post("/fleet/benches/north/none/hold", "{}")
        .expect(404);
    served
        .post("/fleet/benches/north/demo/clear", "{}")
        .expect(404);
}

#[test]
fn a_server_that_is_killed_goes_on_with_its_job_and_a_server_without_a_fleet_has_none() {
    let files = tiny();
    let Some(broker) = Broker::start(&files.path("nats")) else {
        return;
    };
    broker.config(&files, "north");
    let mut served = Served::start(&files);
    broker.knows("north");
    let jobs: Vec<String> = (0..5).map(|_| broker.submit(&files, &[])).collect();
    for _ in 0..3 {
        poll("a job that is started", || {
            let status = broker.fleet(&["status"]);
            let counts = &status["jobs"];
            (counts["started"] != 0 || counts["done"] == 5).then_some(())
        });
        served.process.0.kill().unwrap();
        served.process.0.wait().unwrap();
        served = Served::start(&files);
    }
    poll("the end of all jobs", || {
        (broker.fleet(&["status"])["jobs"]["done"] == 5).then_some(())
    });
    let runs = fs::read_dir(files.path("data/runs")).unwrap();
    let mut runs: Vec<String> = runs
        .map(|run| run.unwrap().file_name().into_string().unwrap())
        .collect();
    runs.sort();
    let expected = jobs.iter().map(|job| format!("demo-{job}"));
    let mut expected: Vec<String> = expected.collect();
    expected.sort();
    assert_eq!(runs, expected);
    let alone = tiny();
    crate::serve_support::config(&alone, "");
    let alone = Served::start(&alone);
    let none = alone.ask("GET", "/api/v1/fleet", ("", "")).expect(404);
    assert_eq!(none.json()["code"], "no-fleet");
}
