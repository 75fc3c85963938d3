//! The server: a queue that survives it, runs that do not notice its end, the stop, and the events.

use std::{os::unix::net::UnixDatagram, time::Duration};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};

use crate::{
    serve_support::{Served, config, data, submit},
    support::{BENCH, EXPERIMENT, Files, Ports, Running, poll, program},
};

const DEMO: &str = r#"{"experiment":"demo"}"#;

fn signal(process: &Running, signal: Signal) {
    kill(
        Pid::from_raw(i32::try_from(process.0.id()).unwrap()),
        signal,
    )
    .unwrap();
}

#[test]
fn an_experiment_is_submitted_runs_by_itself_and_can_be_looked_at() {
    let files = Files::short(3);
    config(&files, "");
    let served = Served::start(&files);
    assert_eq!(
        served.get("/experiments"),
        serde_json::json!([{ "experiment": "demo" }])
    );
    let plan = served.get("/experiments/demo/plan");
    assert!(
        plan["stages"].as_array().unwrap().len() == 3
            && plan["expected_s"].as_f64().unwrap() > 10.0,
        "{plan}"
    );
    let run = submit(&served, r#"{"experiment":"demo","seed":5}"#);
    let ended = served.ended(&run);
    assert_eq!(
        (&ended["code"], &ended["finished"]),
        (&0.into(), &true.into()),
        "{ended}"
    );
    let detail = served.get(&format!("/runs/{run}"));
    assert_eq!(
        (
            &detail["now"]["points_done"],
            &detail["now"]["points"],
            &detail["resumable"]
        ),
        (&9.into(), &9.into(), &false.into()),
        "{detail}"
    );
    let spectra = served.get(&format!("/runs/{run}/spectra"));
    let names: Vec<_> = spectra
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one["name"].as_str().unwrap())
        .collect();
    assert_eq!(
        names,
        ["raw_cell", "raw_fake_cell", "raw_shunt", "spectrum"]
    );
    let point = &spectra[3]["points"][0];
    assert!(
        (point["freq_hz"].as_f64().unwrap() - 100.0).abs() < 1e-6
            && point["re_ohm"].as_f64().unwrap() > 1e-3,
        "{point}"
    );
    let fits = served.get(&format!("/runs/{run}/fits"));
    assert!(fits["model_1rc"].is_object(), "{fits}");
    let readings = served.get(&format!("/runs/{run}/readings?most=8"));
    assert!(
        (2..=8).contains(&readings["time_s"].as_array().unwrap().len()),
        "{readings}"
    );
    let listed = served.get(&format!("/runs/{run}/files"));
    assert!(
        listed
            .as_array()
            .unwrap()
            .iter()
            .any(|file| file["path"] == "captures/cell/point01_100.000000Hz.parquet"),
        "{listed}"
    );
    let report = served
        .ask(
            "GET",
            &format!("/api/v1/runs/{run}/files/report.html"),
            ("", ""),
        )
        .expect(200);
    assert!(
        report.head.contains("content-disposition: attachment")
            && report.head.contains("application/octet-stream"),
        "{}",
        report.head
    );
    assert!(String::from_utf8_lossy(&report.body).contains("</html>"));
    assert_eq!(served.get("/queue")["items"], serde_json::json!([]));
    assert!(
        served.get(&format!("/runs/{run}/log"))["lines"]
            .as_array()
            .unwrap()
            .len()
            > 3
    );
    let idle = poll("an idle bench", || {
        Some(served.get("/benches/demo")).filter(|live| live["state"] == "idle")
    });
    assert_eq!(
        (&idle["run"]["safe"], &idle["reading"]["fresh"]),
        (&true.into(), &false.into()),
        "{idle}"
    );
    let metrics = served.ask("GET", "/metrics", ("", "")).expect(200).text();
    assert!(
        metrics.contains("eis_bench_run_points_done{bench=\"demo\"} 9")
            && metrics.contains("eis_bench_latched{bench=\"demo\"} 0"),
        "{metrics}"
    );
    assert!(
        !metrics.contains("eis_bench_cell_voltage_volts{"),
        "a cell without a run has no reading: {metrics}"
    );
    // The submitted version was executed, regardless of later changes of the file.
    let frozen = data(&files, &format!("submitted/{run}/experiments/demo.toml"));
    assert_eq!(frozen, files.text(EXPERIMENT));
    assert!(data(&files, "audit.jsonl").contains(
        "\"who\":\"local\",\"from\":\"127.0.0.1\",\"what\":\"POST \
            /api/v1/queue\",\"outcome\":\"201\""
    ));
}

#[test]
fn an_experiment_is_checked_before_it_waits_and_names_no_file_outside_the_configuration() {
    let files = Files::short(3);
    config(&files, "");
    let served = Served::start(&files);
    let text = files.text(EXPERIMENT);
    let refused = |text: &str| {
        let body = serde_json::json!({ "text": text }).to_string();
        served.post("/queue", &body).expect(422).json()["message"]
            .as_str()
            .unwrap()
            .to_owned()
    };
    let outside = files.path("..").join("secret.toml");
    for cell in [
        "/etc/hostname",
        "../../secret.toml",
        "../../../../etc/passwd",
        &outside.display().to_string(),
    ] {
        let message = refused(&text.replace("../cells/p45b.toml", cell));
        assert!(
            message.contains("cell: ")
                && message.contains("the file does not exist in the folder of the configuration"),
            "{message}"
        );
    }
    std::os::unix::fs::symlink("/etc/hostname", files.path("cells/link.toml")).unwrap();
    let message = refused(&text.replace("p45b.toml", "link.toml"));
    assert!(message.contains("the file does not exist"), "{message}");
    let message = refused(&text.replace("amplitude = \"1 A\"", "amplitude = \"1 V\""));
    assert!(
        message.contains("eis.amplitude: expected a current"),
        "{message}"
    );
    let message = refused(&text.replace("../benches/demo.toml", "../benches/other.toml"));
    assert!(
        message.contains("names a bench that this server does not have (demo)"),
        "{message}"
    );
    let message = refused(
        "name = \"a/b\"\nbench = \"../benches/demo.toml\"\ncell = \"../cells/p45b.toml\"\n",
    );
    assert!(
        message.contains("expected a name of letters, digits"),
        "{message}"
    );
    for (body, status) in [
        (r#"{"experiment":"none"}"#, 404),
        (r#"{"experiment":"../serve"}"#, 404),
        (r#"{"experiment":"demo","bench":"other"}"#, 422),
        ("{}", 422),
        (r#"{"experiment":"demo","text":"x"}"#, 422),
        (r#"{"experiment":"demo","spoon":1}"#, 422),
        (r#"{"experiment":1}"#, 422),
        ("{", 400),
    ] {
        let answer = served.post("/queue", body);
        assert_eq!(answer.status, status, "{body}: {}", answer.text());
        assert!(
            answer.json()["code"].is_string() && answer.json()["message"].is_string(),
            "{}",
            answer.text()
        );
    }
    assert_eq!(served.get("/queue")["items"], serde_json::json!([]));
    // A text that is sound runs as a file does.
    served
        .post("/benches/demo/hold", r#"{"why":"to look"}"#)
        .expect(200);
    let run = submit(
        &served,
        &serde_json::json!({ "text": text.replace("name = \"demo\"", "name = \"mine\"") })
            .to_string(),
    );
    assert_eq!(run, "mine-1");
    served.post("/benches/demo/release", "").expect(200);
    assert_eq!(served.ended(&run)["finished"], true);
}

#[test]
fn a_queue_survives_a_server_that_is_killed() {
    let files = Files::short(2);
    config(&files, "");
    let mut served = Served::start(&files);
    served
        .post("/benches/demo/hold", r#"{"reason":"x"}"#)
        .expect(422);
    assert_eq!(
        served.post("/benches/demo/hold", "").expect(200).json()["held"]["demo"],
        "held by hand (local)"
    );
    served.post("/benches/demo/release", "").expect(200);
    served
        .post("/benches/demo/hold", r#"{"why":"not yet"}"#)
        .expect(200);
    let runs: Vec<String> = (0..3).map(|_| submit(&served, DEMO)).collect();
    served.post("/queue/order", r#"{"ids":[3]}"#).expect(200);
    served
        .ask("DELETE", "/api/v1/queue/1", ("", ""))
        .expect(200);
    served
        .ask("DELETE", "/api/v1/queue/1", ("", ""))
        .expect(404);
    let before = served.get("/queue");
    served.process.0.kill().unwrap();
    served.process.0.wait().unwrap();
    let served = Served::start(&files);
    let after = served.get("/queue");
    assert_eq!(after, before);
    let names: Vec<_> = after["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|item| item["run"].as_str().unwrap())
        .collect();
    assert_eq!(names, [&runs[2], &runs[1]]);
    assert_eq!(after["held"]["demo"], "not yet (local)");
    served.post("/benches/demo/release", "").expect(200);
    for run in [&runs[2], &runs[1]] {
        assert_eq!(served.ended(run)["finished"], true);
    }
    // A second server on the same data is refused.
    let config = files.path("serve.toml");
    let second = program(&["serve".as_ref(), config.as_os_str()]);
    second.expect_code(2);
    let message = second.message();
    let url = served.url();
    assert!(
        message.contains("expected a data folder of its own, found one that another server uses")
            && message.contains(&format!("(process {} at {url})", served.process.0.id()))
            && message.ends_with("a second server needs another `data` and another `listen`"),
        "{message}"
    );
}

#[test]
#[ignore = "drill"]
fn a_run_outlives_its_server_and_the_next_one_finds_it() {
    let files = Files::short(6);
    let _ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let mut served = Served::start(&files);
    let run = submit(&served, DEMO);
    let next = submit(&served, DEMO);
    served.points(2);
    served.process.0.kill().unwrap();
    served.process.0.wait().unwrap();
    let served = Served::start(&files);
    let live = served.points(3);
    assert_eq!(
        (&live["state"], &live["run"]["run"]),
        (&"running".into(), &run.as_str().into()),
        "{live}"
    );
    // A graceful stop leaves it alone as well.
    signal(&served.process, Signal::SIGTERM);
    let mut served = served;
    assert_eq!(served.process.0.wait().unwrap().code(), Some(0));
    let served = Served::start(&files);
    assert_eq!(served.ended(&run)["finished"], true);
    // The waiting run starts automatically.
    poll("the next run", || {
        (served.get("/benches/demo")["run"]["run"] == next.as_str()).then_some(())
    });
    assert_eq!(
        served.post("/benches/demo/stop", "").expect(200).json()["verified"],
        true
    );
}

#[test]
#[ignore = "drill"]
fn a_stop_ends_the_run_reads_every_output_back_and_holds_the_queue() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    let (run, next) = (submit(&served, DEMO), submit(&served, DEMO));
    let live = served.points(1);
    let supply = live["instruments"]
        .as_array()
        .unwrap()
        .iter()
        .find(|one| one["role"] == "supply4q")
        .unwrap()
        .clone();
    assert_eq!(
        (&supply["output"], &supply["recognised"]),
        (&true.into(), &true.into()),
        "{supply}"
    );
    assert!(
        live["reading"]["fresh"] == true
            && live["reading"]["voltage_v"].is_number()
            && live["limits"][0]["margin"].as_f64().unwrap() > 0.0,
        "{live}"
    );
    // The catalogue has the run while it is in work.
    poll("the unfinished run in the catalogue", || {
        let path = "/api/v1/catalog/runs?verdict=unfinished&bench=demo";
        let answer = served.ask("GET", path, ("", ""));
        let found = (answer.status == 200).then(|| answer.json())?;
        (found["runs"][0]["name"] == run.as_str()).then_some(())
    });
    // The sweep allows far less current than the cell, and the margin is that to its limit.
    let sweep = poll("the limits of a sweep", || {
        let live = served.get("/benches/demo");
        let limit = live["limits"][1].clone();
        let is_met = live["reading"]["phase"] == "sine" && limit["margin"].is_number();
        (is_met && limit["of"] == "step").then_some(limit)
    });
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let greatest_a = number(&sweep["in_force"]["greatest"]);
    assert!((1.0..2.0).contains(&greatest_a), "{sweep}");
    let nearer_a = greatest_a - number(&sweep["value"]).abs();
    assert!((number(&sweep["margin"]) - nearer_a).abs() < 0.1, "{sweep}");
    let report = served.post("/benches/demo/stop", "").expect(200).json();
    assert_eq!(
        (&report["verified"], &report["over"]),
        (&true.into(), &true.into()),
        "{report}"
    );
    let roles: Vec<_> = report["outputs"]
        .as_array()
        .unwrap()
        .iter()
        .map(|output| output["role"].as_str().unwrap())
        .collect();
    assert_eq!(roles, ["supply4q", "generator", "load", "supply"]);
    ports.assert_outputs_off();
    let ended = served.ended(&run);
    assert_eq!(
        (&ended["stopped"], &ended["stopped_by"]),
        (&true.into(), &"local".into())
    );
    assert_eq!(served.get("/benches/demo")["run"]["stopped"], true);
    let card = &served.get(&format!("/runs/{run}"))["card"];
    assert_eq!(card["verdict"], "stopped", "{card}");
    let metrics = crate::observe::metrics(&served);
    for (name, value) in [("stopped", 1), ("failed", 0)] {
        let line = format!("eis_bench_runs_{name}_total{{bench=\"demo\"}} {value}");
        assert!(metrics.contains(&line), "{line}: {metrics}");
    }
    assert!(
        ended["finished"] == false
            && ended["how"]
                .as_str()
                .unwrap()
                .contains("stopped on request"),
        "{ended}"
    );
    let live = poll("an idle bench", || {
        Some(served.get("/benches/demo")).filter(|live| live["state"] == "idle")
    });
    assert!(
        live["held"]
            .as_str()
            .unwrap()
            .starts_with("stopped by local")
            && live["stop"]["verified"] == true,
        "{live}"
    );
    let off = |one: &serde_json::Value| one["output"] != true;
    assert!(
        live["instruments"].as_array().unwrap().iter().all(off),
        "{live}"
    );
    // A waiting run does not begin after a stop, and a bench without a run can also be stopped.
    assert_eq!(served.get("/queue")["items"][0]["run"], next.as_str());
    let idle = served.post("/benches/demo/stop", "").expect(200).json();
    assert!(
        idle["verified"] == true && idle["steps"][0] == "no run was in work",
        "{idle}"
    );
    // The interrupted run continues where it was.
    served
        .ask("DELETE", "/api/v1/queue/2", ("", ""))
        .expect(200);
    assert_eq!(served.get(&format!("/runs/{run}"))["resumable"], true);
    served.post(&format!("/runs/{run}/resume"), "").expect(201);
    served.post(&format!("/runs/{run}/resume"), "").expect(409);
    served.post("/benches/demo/release", "").expect(200);
    poll("the end", || {
        Some(()).filter(|()| served.ended(&run)["finished"] == true)
    });
    assert_eq!(
        served.get(&format!("/runs/{run}/spectra"))[3]["points"]
            .as_array()
            .unwrap()
            .len(),
        6
    );
}

#[test]
fn a_stop_reaches_a_run_that_hangs_and_one_of_another_terminal() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, 10.0, 1);
    config(&files, "[stop]\nwait = \"1 s\"");
    let served = Served::start(&files);
    let folder = files.path("elsewhere");
    let mut run = crate::kill::start(&files, &folder, &[]);
    crate::kill::wait_for_points(&mut run, &folder, ("raw_shunt.csv", 1));
    let live = poll("the other's run", || {
        Some(served.get("/benches/demo"))
            .filter(|live| live["run"]["points_done"].as_u64() > Some(0))
    });
    assert!(
        live["run"]["run"].is_null() && live["state"] == "running",
        "{live}"
    );
    signal(&run, Signal::SIGSTOP);
    let report = served.post("/benches/demo/stop", "").expect(200).json();
    assert_eq!(report["verified"], true, "{report}");
    assert!(
        report["steps"]
            .to_string()
            .contains("has not ended within 1 s"),
        "{report}"
    );
    ports.assert_outputs_off();
    assert_eq!(
        std::os::unix::process::ExitStatusExt::signal(&run.0.wait().unwrap()),
        Some(9)
    );
}

/// Returns the process ID of the present run.
fn in_work(served: &Served) -> i32 {
    poll("a process", || {
        i32::try_from(served.get("/queue")["items"][0]["process"]["pid"].as_i64()?).ok()
    })
}

fn of_role(live: &serde_json::Value, role: &str) -> serde_json::Value {
    live["instruments"]
        .as_array()
        .unwrap()
        .iter()
        .find(|one| one["role"] == role)
        .unwrap()
        .clone()
}

#[test]
#[ignore = "drill"]
fn after_a_killed_run_outputs_are_shown_as_its_guardian_or_somebody_else_has_verified_them() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    submit(&served, DEMO);
    assert_eq!(served.points(1)["verified"], false);
    crate::guardian::signal(in_work(&served), Signal::SIGKILL);
    let live = poll("a verified bench", || {
        let live = served.get("/benches/demo");
        let supply = of_role(&live, "supply4q");
        // Nothing is called idle before it is known to be off.
        assert!(
            live["state"] != "idle" || (live["verified"] == true && supply["output"] == false),
            "{live}"
        );
        (live["verified"] == true).then_some(live)
    });
    for role in ["supply4q", "generator", "load", "supply"] {
        let one = of_role(&live, role);
        assert_eq!(
            (&one["output"], &one["output_by"], &one["trouble"]),
            (&false.into(), &"guardian".into(), &serde_json::Value::Null),
            "{live}"
        );
    }
    ports.assert_outputs_off();
    let report = crate::guardian::report(&files, "verified");
    assert_eq!(
        (
            &report["verified"],
            report["outputs"].as_array().unwrap().len()
        ),
        (&true.into(), 4),
        "{report}"
    );
    // If a run dies together with its guardian, the state is unknown until the bench is switched
    // off.
    served.post("/benches/demo/release", "").expect(200);
    let second = submit(&served, DEMO);
    poll("its first point", || {
        Some(served.points(1)).filter(|live| live["run"]["run"] == second.as_str())
    });
    let guardian = i32::try_from(
        crate::guardian::report(&files, "watching")["pid"]
            .as_i64()
            .unwrap(),
    )
    .unwrap();
    let run = in_work(&served);
    crate::guardian::signal(run, Signal::SIGSTOP);
    crate::guardian::signal(guardian, Signal::SIGKILL);
    crate::guardian::signal(run, Signal::SIGKILL);
    let live = poll("an unknown bench", || {
        Some(served.get("/benches/demo")).filter(|live| live["state"] == "unknown")
    });
    let supply = of_role(&live, "supply4q");
    assert!(
        live["verified"] == false && supply["output"].is_null(),
        "{live}"
    );
    assert_eq!(
        supply["trouble"], "not read since the last run began",
        "{live}"
    );
    crate::guardian::on_bench(&files, &["safe"]).expect_code(0);
    let live = poll("a verified bench", || {
        Some(served.get("/benches/demo")).filter(|live| live["verified"] == true)
    });
    let supply = of_role(&live, "supply4q");
    assert_eq!(
        (&live["state"], &supply["output"], &supply["output_by"]),
        (&"latched".into(), &false.into(), &"safe".into()),
        "{live}"
    );
    ports.assert_outputs_off();
}

#[test]
#[ignore = "drill"]
fn a_run_waits_and_goes_on_as_commanded() {
    let files = Files::short(8);
    let _ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    let run = submit(&served, DEMO);
    served.points(1);
    let reply = served
        .post(&format!("/runs/{run}/pause"), "")
        .expect(200)
        .json();
    assert!(
        reply["said"]
            .as_str()
            .unwrap()
            .starts_with("pauses after the step in work, which takes about "),
        "{reply}"
    );
    let live = poll("a pause", || {
        Some(served.get("/benches/demo")).filter(|live| live["state"] == "paused")
    });
    assert_eq!(live["run"]["going"], true);
    assert_eq!(live["run"]["pausing"], false);
    served.post("/benches/demo/identify", "").expect(409);
    served
        .post(&format!("/runs/{run}/order"), r#"{"runs":[1]}"#)
        .expect(409);
    served.post(&format!("/runs/{run}/go-on"), "").expect(200);
    assert_eq!(served.ended(&run)["finished"], true);
    served.post(&format!("/runs/{run}/pause"), "").expect(409);
    served.post("/runs/none/pause", "").expect(404);
    poll("an idle bench", || {
        Some(()).filter(|()| served.get("/benches/demo")["state"] == "idle")
    });
    let identified = served.post("/benches/demo/identify", "").expect(200).json();
    assert!(
        identified["answers"].as_array().unwrap().len() == 8 && identified["trouble"].is_null(),
        "{identified}"
    );
    assert_eq!(identified["silent"], serde_json::json!([]));
    assert_eq!(identified["answers"][0]["output"]["state"], "off");
}

#[test]
fn the_experiment_of_a_run_that_waits_can_be_read() {
    let files = Files::short(2);
    config(&files, "");
    let served = Served::start(&files);
    served
        .post("/benches/demo/hold", r#"{"why":"later"}"#)
        .expect(200);
    let run = submit(&served, DEMO);
    let of_run = served.get(&format!("/runs/{run}/experiment"));
    assert_eq!(
        (&of_run["name"], &of_run["bench"]),
        (&"demo".into(), &"demo".into())
    );
    assert!(
        of_run["text"].as_str().unwrap().contains("[eis]"),
        "{of_run}"
    );
}

#[test]
fn a_silent_instrument_does_not_hide_the_answers_of_the_others() {
    let files = Files::short(2);
    let _ports = Ports::serve(&files, 10.0, 1);
    drop(files.stand_before("scope"));
    config(&files, "");
    let served = Served::start(&files);
    let identified = served.post("/benches/demo/identify", "").expect(200).json();
    assert_eq!(identified["answers"].as_array().unwrap().len(), 7);
    assert_eq!(identified["trouble"], "no answer: scope");
    let silent = identified["silent"].as_array().unwrap();
    assert_eq!((silent.len(), &silent[0]["role"]), (1, &"scope".into()));
    let of = |role: &str| {
        poll("the answers", || {
            let live = served.get("/benches/demo");
            let all = live["instruments"].as_array().unwrap();
            let one = all.iter().find(|one| one["role"] == role).unwrap().clone();
            (live["outputs"]["state"] == "off" && live["instruments"][0]["identity"].is_string())
                .then_some(one)
        })
    };
    assert!(
        of("load")["identity"]
            .as_str()
            .unwrap()
            .contains("SDL1020X-E")
    );
    let scope = of("scope");
    let trouble = scope["trouble"].as_str().unwrap();
    assert!(
        trouble.starts_with("no answer: ") && scope["identity"].is_null(),
        "{scope}"
    );
    assert!(
        trouble.ends_with(silent[0]["why"].as_str().unwrap()),
        "{trouble}"
    );
}

#[test]
#[ignore = "drill"]
fn a_pause_is_shown_at_once_with_the_time_until_it_and_is_taken_back() {
    let files = Files::short(3).edit(
        crate::support::EXPERIMENT,
        "start = \"100 Hz\"",
        "start = \"0.1 Hz\"",
    );
    let ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    let run = submit(&served, DEMO);
    let live = || served.get("/benches/demo");
    poll("a slow point", || {
        live()["run"]["point"]["freq_hz"]
            .as_f64()
            .filter(|hz| *hz < 1.0)
    });
    served.post(&format!("/runs/{run}/pause"), "").expect(200);
    let pausing = poll("a pause that was asked for", || {
        Some(live()).filter(|live| live["run"]["pausing"] == true)
    });
    assert_eq!(pausing["state"], "running");
    assert!(
        pausing["run"]["step_left_s"].as_f64().unwrap() > 0.0,
        "{pausing}"
    );
    served.post(&format!("/runs/{run}/go-on"), "").expect(200);
    poll("no pause", || {
        (live()["run"]["pausing"] == false).then_some(())
    });
    served.post("/benches/demo/stop", "").expect(200);
    ports.assert_outputs_off();
}

#[test]
fn a_trip_is_shown_with_its_cause_and_cleared_only_after_it_was_seen() {
    let files = Files::short(6).edit(
        crate::support::CELL,
        "temperature_max = \"60 °C\"",
        "temperature_max = \"20 °C\"",
    );
    let _ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    let run = submit(&served, DEMO);
    assert_eq!(served.ended(&run)["code"], 5);
    let live = poll("a latch", || {
        Some(served.get("/benches/demo")).filter(|live| live["state"] == "latched")
    });
    let cause = live["trip"]["cause"].as_str().unwrap().to_owned();
    assert!(
        cause.contains("temperature") && live["trip"]["value"].is_number(),
        "{live}"
    );
    served.post("/benches/demo/release", "").expect(200);
    submit(&served, DEMO);
    served
        .post("/benches/demo/trips/clear", r#"{"cause":"something"}"#)
        .expect(409);
    assert_eq!(
        served.get("/queue")["items"][0]["process"],
        serde_json::Value::Null,
        "nothing is begun on a latched bench"
    );
    served
        .post("/benches/demo/hold", r#"{"why":"x"}"#)
        .expect(200);
    served
        .post(
            "/benches/demo/trips/clear",
            &serde_json::json!({ "cause": cause, "found": "a".repeat(1001) }).to_string(),
        )
        .expect(400);
    served
        .post(
            "/benches/demo/trips/clear",
            &serde_json::json!({ "cause": cause, "found": " Ann: a loose probe " }).to_string(),
        )
        .expect(200);
    served
        .post(
            "/benches/demo/trips/clear",
            &serde_json::json!({ "cause": cause }).to_string(),
        )
        .expect(409);
    let trips = served.get("/benches/demo/trips");
    let what: Vec<_> = trips["history"]
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one["what"].as_str().unwrap())
        .collect();
    assert!(
        trips["latched"].is_null() && what.ends_with(&["latched", "cleared"]),
        "{trips}"
    );
    let last = trips["history"].as_array().unwrap().last().unwrap();
    assert_eq!(last["found"], "Ann: a loose probe");
}

#[test]
#[ignore = "drill"]
fn a_listener_hears_what_changes_goes_on_where_it_was_and_a_slow_one_delays_no_other() {
    let files = Files::short(4);
    let _ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    // Connected, and never read from.
    let slow: Vec<_> = (0..20).map(|_| served.listen("")).collect();
    let mut events = served.listen("");
    assert_eq!(events.next().unwrap().1, "hello");
    let run = submit(&served, DEMO);
    let mut heard: Vec<(String, String, serde_json::Value)> = Vec::new();
    for event in events.by_ref() {
        let end = event.1 == "run" && !event.2["ended"].is_null();
        heard.push(event);
        if end {
            break;
        }
    }
    for kind in ["live", "spectrum", "run", "queue"] {
        assert!(heard.iter().any(|event| event.1 == kind), "{kind}");
    }
    // A sweep grows point by point.
    let points = |event: &&(String, String, serde_json::Value)| {
        event.1 == "spectrum"
            && event.2["spectrum"]["name"] == "spectrum"
            && event.2["run"] == run.as_str()
    };
    let counts: Vec<usize> = heard
        .iter()
        .filter(points)
        .map(|event| event.2["spectrum"]["points"].as_array().unwrap().len())
        .collect();
    assert!(
        counts.is_sorted() && counts.first() < Some(&4) && counts.last() == Some(&4),
        "{counts:?}"
    );
    let middle = heard.len() / 2;
    let again = served.listen(&format!("Last-Event-ID: {}\r\n", heard[middle].0));
    let followed: Vec<String> = again
        .skip(1)
        .take(heard.len() - middle - 1)
        .map(|event| event.0)
        .collect();
    assert_eq!(
        followed,
        heard[middle + 1..]
            .iter()
            .map(|event| event.0.clone())
            .collect::<Vec<_>>()
    );
    assert_eq!(
        served.listen("Last-Event-ID: 1-1\r\n").next().unwrap().1,
        "lost"
    );
    assert_eq!(served.ended(&run)["finished"], true);
    drop(slow);
}

#[test]
fn systemd_hears_that_the_server_is_ready_lives_and_stops() {
    let files = Files::short(2);
    config(&files, "");
    let socket = UnixDatagram::bind(files.path("notify")).unwrap();
    socket
        .set_read_timeout(Some(Duration::from_secs(60)))
        .unwrap();
    let path = files.path("notify");
    let mut served = Served::start_with(
        &files,
        &[
            ("NOTIFY_SOCKET", path.to_str().unwrap()),
            ("WATCHDOG_USEC", "600000"),
        ],
    );
    let word = || {
        let mut bytes = [0; 64];
        let length = socket.recv(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes[..length]).into_owned()
    };
    assert_eq!(
        [word(), word(), word()],
        ["READY=1", "WATCHDOG=1", "WATCHDOG=1"]
    );
    signal(&served.process, Signal::SIGTERM);
    assert_eq!(served.process.0.wait().unwrap().code(), Some(0));
    assert!(
        std::iter::from_fn(|| Some(word()))
            .take(10)
            .any(|word| word == "STOPPING=1")
    );
    assert!(files.path(BENCH).exists());
}
