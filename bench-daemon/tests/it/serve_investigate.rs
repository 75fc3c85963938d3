//! Investigations over the API on the simulated bench: the rule that ends them, and their state
//! after a person or the death of the server interrupts them.

use serde_json::{Value, json};

use crate::{
    serve_support::{Served, config, data, submit},
    support::{Files, poll},
};

/// Starts a server with a finished run of the demo in virtual time. Its one sweep repeats
/// nothing, so that its diagnosis stays open and recommends to repeat it.
fn with_a_run() -> (Files, Served) {
    let files = Files::demo();
    config(&files, "");
    let served = Served::start(&files);
    assert_eq!(submit(&served, r#"{"experiment":"demo"}"#), "demo-1");
    assert_eq!(served.ended("demo-1")["finished"], true);
    (files, served)
}

fn asked(minutes: f64) -> String {
    json!({ "run": "demo-1", "budget_minutes": minutes, "budget_ah": 5.0 }).to_string()
}

/// Begins an investigation and returns its path.
fn begin(served: &Served, minutes: f64) -> String {
    let one = served
        .post("/investigations", &asked(minutes))
        .expect(201)
        .json();
    assert_eq!(one["state"], "diagnosing", "{one}");
    format!("/investigations/{}", one["id"].as_str().unwrap())
}

/// Waits until the investigation fits and returns it.
fn once(served: &Served, path: &str, what: &str, fits: impl Fn(&Value) -> bool) -> Value {
    poll(what, || Some(served.get(path)).filter(|one| fits(one)))
}

/// Waits until the investigation has this end and returns it.
fn ended(served: &Served, path: &str, end: &str) -> Value {
    let one = once(served, path, "the end of the investigation", |one| {
        one["state"] == "ended"
    });
    assert_eq!(one["ended"]["end"], end, "{one}");
    one
}

fn why(one: &Value) -> &str {
    one["ended"]["why"].as_str().unwrap()
}

#[test]
fn an_investigation_ends_with_its_budget_a_held_bench_or_a_word() {
    let (_files, served) = with_a_run();
    for (body, words) in [
        (
            json!({ "run": "../x", "budget_minutes": 1, "budget_ah": 1 }),
            "run: expected the name of a run",
        ),
        (
            json!({ "run": "demo-1", "budget_minutes": -1, "budget_ah": 1 }),
            "expected a budget of 0 or more",
        ),
        (
            json!({ "run": "demo-1", "bench": "x", "budget_minutes": 1, "budget_ah": 1 }),
            "bench: expected a bench",
        ),
    ] {
        let answer = served
            .post("/investigations", &body.to_string())
            .expect(422);
        assert!(answer.text().contains(words), "{}", answer.text());
    }
    // A budget that does not pay the first experiment.
    let path = begin(&served, 10.0);
    served.post("/investigations", &asked(10.0)).expect(409);
    let one = ended(&served, &path, "budget");
    assert!(
        why(&one).starts_with("the next experiment, sentinel_repeat, takes 9")
            && why(&one).ends_with("left are 10 min and 5.00 Ah"),
        "{one}"
    );
    let step = &one["steps"][0];
    assert_eq!(
        (&step["run"], &step["analysis"], &step["verdict"]),
        (
            &json!("demo-1"),
            &json!("diagnose-1"),
            &json!("unexplained")
        )
    );
    assert_eq!(one["spent"], json!({ "minutes": 0.0, "charge_ah": 0.0 }));
    // Nothing is queued on a held bench, nor after its release.
    let path = begin(&served, 600.0);
    served
        .post("/benches/demo/hold", r#"{"why":"a loose clamp"}"#)
        .expect(200);
    let one = ended(&served, &path, "stopped");
    assert!(
        why(&one).starts_with("the bench demo is held: a loose clamp"),
        "{one}"
    );
    served.post("/investigations", &asked(600.0)).expect(409);
    served
        .post("/benches/demo/release", r#"{"why":"fastened"}"#)
        .expect(200);
    // One request ends it together with its diagnosis.
    let path = begin(&served, 600.0);
    let cancel = format!("{path}/cancel");
    let one = served.post(&cancel, "").expect(200).json();
    assert_eq!(
        (&one["state"], why(&one)),
        (&json!("ended"), "cancelled by local")
    );
    let diagnosis = one["steps"][0]["analysis"].as_str().unwrap();
    let diagnosis = served.get(&format!("/analyses/{diagnosis}"));
    assert_eq!(diagnosis["state"], "cancelled");
    served.post(&cancel, "").expect(409);
    served.post("/investigations/x/cancel", "").expect(404);
    assert_eq!(served.get("/queue")["items"], json!([]));
    assert_eq!(served.get("/runs").as_array().unwrap().len(), 1);
    let all = served.get("/investigations");
    let ids: Vec<&str> = all
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one["id"].as_str().unwrap())
        .collect();
    assert_eq!(
        ids,
        ["investigation-3", "investigation-2", "investigation-1"]
    );
}

#[test]
fn an_investigation_comes_to_its_verdict_over_two_deaths_of_the_server() {
    let (files, mut served) = with_a_run();
    let path = begin(&served, 600.0);
    poll("its diagnosis to begin", || {
        (served.get("/analyses/diagnose-1")["state"] != "waiting").then_some(())
    });
    let again = |served: &mut Served| {
        served.process.0.kill().unwrap();
        served.process.0.wait().unwrap();
        *served = Served::start(&files);
    };
    // Within the first diagnosis, and within the experiment.
    again(&mut served);
    once(&served, &path, "its experiment", |one| {
        one["state"] == "measuring"
    });
    again(&mut served);
    let one = ended(&served, &path, "at_noise_floor");
    let steps = one["steps"].as_array().unwrap();
    assert_eq!(steps.len(), 2, "{one}");
    let run = steps[1]["run"].as_str().unwrap();
    assert_eq!(
        (&steps[1]["experiment"]["name"], &steps[1]["verdict"]),
        (&json!("sentinel_repeat"), &json!("at the noise floor"))
    );
    assert_eq!(served.ended(run)["finished"], true);
    // The diagnosis has seen both runs.
    let analysis = steps[1]["analysis"].as_str().unwrap();
    let analysis = served.get(&format!("/analyses/{analysis}"));
    assert_eq!(analysis["runs"], json!(["demo-1", run]));
    assert_eq!(analysis["stories"][0]["verdict"], "nothing missing");
    let spent = one["spent"]["minutes"].as_f64().unwrap();
    assert!(spent > 30.0 && spent < 600.0, "{one}");
    assert_eq!(served.get("/runs").as_array().unwrap().len(), 2);
    assert!(data(&files, "audit.jsonl").contains(&format!("queued {run} on demo")));
}

#[test]
fn a_stop_ends_an_investigation_and_a_cancelled_one_lets_its_run_go_on() {
    let (_files, served) = with_a_run();
    let measuring = |path: &str| {
        once(&served, path, "its experiment", |one| {
            one["state"] == "measuring"
        })
    };
    let path = begin(&served, 600.0);
    let one = measuring(&path);
    let run = one["steps"][1]["run"].as_str().unwrap().to_owned();
    let one = served.post(&format!("{path}/cancel"), "").expect(200);
    assert!(
        why(&one.json()).ends_with("its experiment is in work and goes on to its end"),
        "{}",
        one.text()
    );
    assert_eq!(served.ended(&run)["finished"], true);
    let path = begin(&served, 600.0);
    measuring(&path);
    served.post("/benches/demo/stop", "").expect(200);
    let one = ended(&served, &path, "stopped");
    served
        .post("/benches/demo/release", r#"{"why":"looked at"}"#)
        .expect(200);
    poll(&format!("an empty queue after {one}"), || {
        (served.get("/queue")["items"] == json!([])).then_some(())
    });
    assert_eq!(served.get("/runs").as_array().unwrap().len(), 3);
}
