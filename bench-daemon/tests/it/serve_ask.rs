//! Questions to the person at the bench, asked and answered over the API: a campaign of two cells
//! that a person clamps, and the notice that the run waits for that person.

use std::ffi::OsStr;

use serde_json::{Value, json};

use crate::{
    serve_support::{Served, config, submit, token},
    support::{BENCH, EXPERIMENT, Files, Ports, SCENARIO, command, poll, program},
};

/// Two cells that a person clamps, a few points each.
pub(crate) fn files() -> Files {
    Files::short(2)
        .without(EXPERIMENT, "fixture_check")
        .append(
            EXPERIMENT,
            "[campaign]\nrepeats = 1\ncells = [{ name = \"A\", serial = \"S-1\" }, { name = \"B\" }]",
        )
        .append(SCENARIO, "[specimens]\ncount = 2")
        .edit(
            BENCH,
            "model = \"mock-jig\"\naddress = \"memory:jig\"",
            "model = \"person\"",
        )
}

/// Returns the state of the bench while it asks a question other than `than`.
fn asked(served: &Served, than: Option<u64>) -> Value {
    poll("a question", || {
        let bench = served.get("/benches/demo");
        let number = bench["question"]["number"].as_u64()?;
        (Some(number) != than && bench["state"] == "asking").then_some(bench)
    })
}

fn answered(served: &Served, run: &str, token: &str, body: &Value) -> (u16, String) {
    let path = format!("/api/v1/runs/{run}/answer");
    let answer = served.ask("POST", &path, (token, &body.to_string()));
    (answer.status, answer.text())
}

#[test]
fn a_person_answers_from_elsewhere_and_the_wrong_cell_is_refused() {
    let files = files();
    let _ports = Ports::serve(&files, 50.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    let run = submit(&served, r#"{"experiment":"demo"}"#);
    let first = asked(&served, None);
    let (number, question) = (
        first["question"]["number"].as_u64().unwrap(),
        &first["question"],
    );
    assert!(
        question["text"]
            .as_str()
            .unwrap()
            .starts_with("Clamp cell A (serial number S-1)"),
        "{question}"
    );
    assert_eq!(
        (&question["serial"], &question["on_terminal"]),
        (&json!("S-1"), &json!(false))
    );
    poll("a notice of the question", || {
        (served.get("/notices")["latest"][0]["about"] == "question").then_some(())
    });
    for (body, words) in [
        (json!({"question": number + 1}), "which waits"),
        (
            json!({"question": number, "serial": "S-2"}),
            "this is another cell",
        ),
    ] {
        let (status, text) = answered(&served, &run, "", &body);
        assert!(status == 409 && text.contains(words), "{text}");
    }
    let (status, text) = answered(
        &served,
        &run,
        "",
        &json!({"question": number, "serial": "S\u{0}1"}),
    );
    assert_eq!(status, 422, "{text}");
    let (status, text) = answered(
        &served,
        &run,
        "",
        &json!({"question": number, "serial": "S-1"}),
    );
    assert_eq!(status, 200, "{text}");

    let second = asked(&served, Some(number));
    assert!(second["question"]["serial"].is_null() && second["question"]["cell"] == "B");
    let folder = files.path("data/runs").join(&run);
    let shown = command(&["answer".as_ref(), folder.as_os_str()])
        .output()
        .unwrap();
    let shown = String::from_utf8(shown.stdout).unwrap();
    assert!(
        shown.contains("Clamp cell B into the jig, no other cell"),
        "{shown}"
    );
    assert!(shown.contains("--done --question "), "{shown}");
    let number = second["question"]["number"].to_string();
    let done = |number: Option<&str>| {
        let mut words: Vec<&OsStr> = vec!["answer".as_ref(), folder.as_os_str()];
        words.extend(["--done", "--by", "Ada"].map(OsStr::new));
        if let Some(number) = number {
            words.extend(["--question", number].map(OsStr::new));
        }
        program(&words)
    };
    done(None).expect_code(2);
    let accepted = done(Some(&number));
    assert!(accepted.stdout.contains("is taken"), "{}", accepted.stdout);
    let ended = poll("the end", || {
        let now = served.get(&format!("/runs/{run}"));
        now["job"]["ended"].is_object().then_some(now)
    });
    assert_eq!(ended["job"]["ended"]["finished"], true, "{ended}");
    let events = files.text(&format!("data/runs/{run}/events.csv"));
    for words in ["answered: local, serial number S-1", "answered: Ada"] {
        assert!(events.contains(words), "{words} in {events}");
    }
    let readings = files.text(&format!("data/runs/{run}/readings.csv"));
    assert!(
        readings.contains(",asking,"),
        "readings were not watched: {readings}"
    );
    let late = answered(&served, &run, "", &json!({"question": 1}));
    let status = late.0;
    assert_eq!(status, 409, "the question is no longer open");
}

#[test]
fn a_question_outlives_the_server_ends_with_a_stop_and_is_nothing_for_who_may_only_look() {
    let files = files();
    let _ports = Ports::serve(&files, 50.0, 1);
    config(&files, "");
    let (all, look) = (
        token(&files, "ada", "read,operate,energise"),
        token(&files, "bob", "read"),
    );
    let served = Served::start(&files);
    let body = r#"{"experiment":"demo"}"#;
    let item = served
        .ask("POST", "/api/v1/queue", (&all, body))
        .expect(201)
        .json();
    let run = item["run"].as_str().unwrap();
    let question = |served: &Served| {
        poll("a question", || {
            let bench = served.ask("GET", "/api/v1/benches/demo", (&all, "")).json();
            bench["question"]["number"].as_u64()
        })
    };
    let number = question(&served);
    let (status, text) = answered(&served, run, &look, &json!({"question": number}));
    assert_eq!(status, 403, "{text}");
    drop(served);
    let served = Served::start(&files);
    assert_eq!(question(&served), number);
    served
        .ask("POST", "/api/v1/benches/demo/stop", (&all, ""))
        .expect(200);
    poll("the end", || {
        let bench = served.ask("GET", "/api/v1/benches/demo", (&all, "")).json();
        (bench["question"].is_null() && bench["state"] == "idle").then_some(())
    });
}
