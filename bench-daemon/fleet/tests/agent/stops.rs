//! Stops, holds and releases: from elsewhere, without the broker, and without the server.

use crate::{
    files::Files,
    processes::{Broker, Site, poll, serve},
};

#[test]
fn a_bench_is_held_stopped_and_released_from_elsewhere_and_a_latch_is_out_of_reach() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let north = Site::start(Files::slow(), &broker, "north");
    let job = broker.submit(&north.files, &[]);
    broker.wait_for_bench("north", "running");
    let stop = |why: &str| north.agent.post("/fleet/benches/north/demo/stop", why);
    let stopped = stop(r#"{"why": "smoke"}"#).expect(200).json();
    assert_eq!(stopped["outputs_verified"], true, "{stopped}");
    assert_eq!(
        (&stopped["kept"], &stopped["heard"]),
        (&true.into(), &true.into())
    );
    broker.wait_for(&job, "failed");
    let held = north.server.get("/queue")["held"]["demo"].clone();
    assert_eq!(held, "stopped by fleet: local@north");
    let released = broker.fleet(&["release", "north/demo", "--why", "it was steam"]);
    assert_eq!(released[0]["heard"], true, "{released}");
    assert_eq!(released[0]["held"], serde_json::Value::Null, "{released}");
    broker.wait_for_bench("north", "idle");
    // The fleet cannot remove a hold by the bench's own server.
    let hold = r#"{"why": "new probes"}"#;
    north.server.post("/benches/demo/hold", hold).expect(200);
    broker.fleet(&["hold", "north/demo", "--why", "audit"]);
    poll("both holds", || {
        let trail = north.files.text("data/audit.jsonl");
        trail
            .contains("\"what\":\"fleet hold demo: audit\"")
            .then_some(())
    });
    let released = broker.fleet(&["release", "north/demo", "--why", "I want to measure"]);
    let held = released[0]["held"].as_str().unwrap();
    assert!(held.starts_with("new probes (local)"), "{released}");
    north.server.post("/benches/demo/release", "{}").expect(200);
    broker.wait_for_bench("north", "idle");
    // The other way round, a person here revokes what is shown.
    broker.fleet(&["hold", "north/demo", "--why", "audit"]);
    poll("the hold of the fleet", || {
        let held = north.server.get("/queue")["held"]["demo"].clone();
        held.as_str()?.starts_with("audit (fleet: ").then_some(())
    });
    north.server.post("/benches/demo/release", "{}").expect(200);
    assert_eq!(north.server.get("/queue")["held"], serde_json::json!({}));
    let all = north.agent.post("/fleet/stop", r#"{"why": "smoke"}"#);
    let all = all.expect(200).json();
    assert_eq!(all["benches"][0]["bench"], "demo", "{all}");
    assert_eq!(all["benches"][0]["outputs_verified"], true, "{all}");
    assert_eq!(all["unreached"], serde_json::Value::Null, "{all}");
    let none = "/fleet/benches/north/none/hold";
    north.agent.post(none, "{}").expect(404);
    let clear = "/fleet/benches/north/demo/clear";
    north.agent.post(clear, "{}").expect(404);
}

#[test]
fn a_bench_of_this_site_is_stopped_while_the_broker_is_away_and_an_older_release_does_not_free_it()
{
    let folder = tempfile::tempdir().unwrap();
    let Some(mut broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let north = Site::start(Files::slow(), &broker, "north");
    let job = broker.submit(&north.files, &[]);
    broker.wait_for_bench("north", "running");
    broker.kill();
    let one = north.agent.post("/fleet/benches/north/demo/stop", "{}");
    let one = one.expect(200).json();
    assert_eq!(one["outputs_verified"], true, "{one}");
    assert_eq!((&one["kept"], &one["heard"]), (&false.into(), &true.into()));
    let all = north.agent.post("/fleet/stop", "{}").expect(200).json();
    assert_eq!(all["benches"][0]["outputs_verified"], true, "{all}");
    assert!(all["unreached"].is_string(), "{all}");
    broker.restart();
    // Its end is reported once the broker is back.
    broker.wait_for(&job, "failed");
    let released = broker.fleet(&["release", "north/demo", "--why", "go on"]);
    assert_eq!(released[0]["heard"], true, "{released}");
    poll("the release", || {
        let trail = north.files.text("data/audit.jsonl");
        trail.contains("fleet release demo: go on").then_some(())
    });
    // The stop is the server's own now.
    let held = north.server.get("/queue")["held"]["demo"].clone();
    assert_eq!(held, "stopped by fleet: local@north (local)");
}

#[test]
fn a_stop_and_a_hold_that_come_while_the_server_is_away_are_followed_once_it_is_back() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let mut north = Site::start(Files::slow(), &broker, "north");
    let job = broker.submit(&north.files, &[]);
    broker.wait_for_bench("north", "running");
    north.server.process.kill();
    // Never idle, and with the reason.
    let away = broker.wait_for_bench("north", "held");
    let words = away["held"].as_str().unwrap();
    assert!(
        words.starts_with("the server of the bench does not answer"),
        "{away}"
    );
    assert_eq!(away["outputs_verified"], serde_json::Value::Null);
    let stopped = broker.ask(&["stop", "north/demo"]);
    stopped.expect_code(6);
    assert!(
        stopped.stderr.contains("not verified off: north/demo"),
        "{}",
        stopped.stderr
    );
    north.server = serve(&north.files);
    let run = format!("demo-{job}");
    let ended = poll("the end of the run", || {
        let runs = north.server.get("/runs");
        let job = runs
            .as_array()
            .unwrap()
            .iter()
            .find(|one| one["item"]["run"] == *run)?;
        Some(job["ended"].clone()).filter(|ended| !ended.is_null())
    });
    assert_eq!(ended["finished"], false, "{ended}");
    broker.wait_for(&job, "failed");
    let held = north.server.get("/queue")["held"]["demo"].clone();
    assert!(held.as_str().unwrap().contains("stopped by hand"), "{held}");
    let trail = north.files.text("data/audit.jsonl");
    assert!(
        trail.contains("fleet stop demo: stopped by hand"),
        "{trail}"
    );
}
