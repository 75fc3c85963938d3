//! Users and tokens: the server decides, and the agent adds nothing of its own.

use serde_json::{Value, json};

use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};

use crate::{
    files::{Files, root},
    processes::{
        Broker, Served, fleet_program, poll, run, serve, serve_with, start_agent, token,
        write_agent,
    },
};

const SCOPES: &str = "read,operate,energise,fleet";

/// A server with tokens and an agent.
struct Guarded {
    files: Files,
    server: Served,
    agent: Served,
}

impl Guarded {
    fn start(broker: &Broker) -> Self {
        let files = Files::tiny();
        let server = serve(&files);
        write_agent(&files, broker, "north", &server.address);
        let secret = token(&files, "agent", SCOPES);
        files.write_private("agent.token", &secret);
        let text = files.text("fleet.toml");
        files.write(
            "fleet.toml",
            &format!("{text}token_file = \"agent.token\"\n"),
        );
        let agent = start_agent(&files);
        broker.wait_for_bench("north", "idle");
        Self {
            files,
            server,
            agent,
        }
    }
}

fn bearer(token: &str) -> String {
    format!("Authorization: Bearer {token}\r\n")
}

#[test]
fn an_agent_with_a_token_that_lacks_a_scope_or_is_unknown_does_not_begin() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let files = Files::tiny();
    let server = serve(&files);
    write_agent(&files, &broker, "north", &server.address);
    let text = files.text("fleet.toml");
    files.write(
        "fleet.toml",
        &format!("{text}token_file = \"agent.token\"\n"),
    );
    let config = files.path("fleet.toml");
    let begin = |secret: &str| {
        files.write_private("agent.token", secret);
        run(&fleet_program(), &["agent", config.to_str().unwrap()]).refused()
    };
    let message = begin(&token(&files, "weak", "read,operate,energise"));
    assert!(
        message.contains("expected a token with the scopes read,operate,energise,fleet"),
        "{message}"
    );
    assert!(
        message.contains("found \"weak\" without fleet"),
        "{message}"
    );
    let message = begin("eb_0");
    assert!(message.contains("refuses the token"), "{message}");
    files.write("agent.token", "eb_0");
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o644);
    std::fs::set_permissions(files.path("agent.token"), mode).unwrap();
    let message = run(&fleet_program(), &["agent", config.to_str().unwrap()]).refused();
    assert!(
        message.contains("expected a file that only its owner may read"),
        "{message}"
    );
}

#[test]
fn only_a_token_with_the_scope_fleet_acts_for_a_person_or_names_a_run() {
    let files = Files::tiny();
    let server = serve(&files);
    let (plain, agent) = (
        token(&files, "ann", "read,operate,energise"),
        token(&files, "agent", SCOPES),
    );
    let person = |token: &str| format!("{}X-Eis-Bench-Person: bob@south\r\n", bearer(token));
    let hold = |head: &str| server.ask("POST /api/v1/benches/demo/hold", head, "{}");
    let refused = hold(&person(&plain)).expect(403);
    assert!(
        refused
            .text()
            .contains("expected a token with the scope `fleet`"),
        "{}",
        refused.text()
    );
    // A stop without a token is a person's at the machine, and never one of the fleet.
    let stop = "POST /api/v1/benches/demo/stop";
    server
        .ask(stop, "X-Eis-Bench-Person: bob@south\r\n", "")
        .expect(401);
    server.ask(stop, "", "").expect(200);
    let release = "POST /api/v1/benches/demo/release";
    server.ask(release, &person(&agent), "{}").expect(200);
    let held = |server: &Served| {
        server
            .ask("GET /api/v1/queue", &bearer(&plain), "")
            .expect(200)
            .json()["held"]
            .clone()
    };
    assert_eq!(held(&server), json!({ "demo": "stopped by local" }));
    server.ask(release, &bearer(&plain), "{}").expect(200);
    hold(&person(&agent)).expect(200);
    assert_eq!(
        held(&server),
        json!({ "demo": "held by hand (fleet: bob@south)" })
    );
    let enter = r#"{"what": "fleet drain demo: x", "outcome": "done"}"#;
    server
        .ask("POST /api/v1/audit", &bearer(&plain), enter)
        .expect(403);
    server
        .ask("POST /api/v1/audit", &person(&agent), enter)
        .expect(204);
    let trail = files.text("data/audit.jsonl");
    let entry = "\"who\":\"fleet: bob@south\",\"from\":\"fleet\",\"what\":\"fleet drain demo: x\"";
    assert!(trail.contains(entry), "{trail}");
    let submit = |head: &str, run: &str| {
        let body = json!({ "experiment": "demo", "run": run }).to_string();
        server.ask("POST /api/v1/queue", head, &body)
    };
    submit(&bearer(&plain), "demo-x").expect(403);
    submit(&person(&agent), "../x").expect(422);
}

#[test]
fn a_run_that_is_named_is_submitted_once_whenever_it_is_submitted_again() {
    let files = Files::tiny();
    let mut server = serve(&files);
    let body = json!({ "experiment": "demo", "run": "demo-x" }).to_string();
    let submit = |server: &Served| server.post("/queue", &body);
    server.post("/benches/demo/hold", "{}").expect(200);
    let first = submit(&server).expect(201).json();
    assert_eq!(submit(&server).expect(200).json(), first);
    server.process.kill();
    server = serve(&files);
    assert_eq!(submit(&server).expect(200).json(), first);
    server.post("/benches/demo/release", "{}").expect(200);
    poll("the end of the run", || {
        let run = server.ask("GET /api/v1/runs/demo-x", "", "");
        let is_over = run.status == 200 && run.json()["job"]["ended"]["finished"] == true;
        is_over.then_some(())
    });
    // Neither an end nor a change of its files makes it new.
    files.write("experiments/demo.toml", "");
    assert_eq!(submit(&server).expect(200).json()["id"], first["id"]);
    assert_eq!(files.runs(), ["demo-x"]);
    let run: Value = server.get("/runs/demo-x");
    assert_eq!(run["content_sha256"].as_str().unwrap().len(), 64);
}

#[test]
fn the_agent_asks_the_server_who_somebody_is_and_hears_its_own_pages_only() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let site = Guarded::start(&broker);
    let (reader, anybody) = (
        token(&site.files, "ann", "read"),
        token(&site.files, "bob", "operate"),
    );
    let agent = &site.agent;
    let fleet = "GET /api/v1/fleet";
    agent.ask(fleet, "", "").expect(401);
    agent.ask(fleet, &bearer("eb_0"), "").expect(401);
    let lacks = agent.ask(fleet, &bearer(&anybody), "").expect(403);
    assert!(
        lacks
            .text()
            .contains("expected a token with the scope `read`"),
        "{}",
        lacks.text()
    );
    agent.ask(fleet, &bearer(&reader), "").expect(200);
    agent.ask("GET /metrics", "", "").expect(401);
    agent.ask("GET /metrics", &bearer(&reader), "").expect(200);
    let job = r#"{"experiment": "demo"}"#;
    agent
        .ask("POST /api/v1/fleet/jobs", &bearer(&reader), job)
        .expect(403);
    // Any token stops.
    let stopped = agent.ask(
        "POST /api/v1/fleet/benches/north/demo/stop",
        &bearer(&anybody),
        "{}",
    );
    assert_eq!(stopped.expect(200).json()["outputs_verified"], true);
    agent.ask("POST /api/v1/fleet/stop", "", "{}").expect(401);
    let held = site
        .server
        .ask("GET /api/v1/queue", &bearer(&reader), "")
        .json();
    assert_eq!(held["held"]["demo"], "stopped by fleet: bob@north");
    // A browser signs in through the agent, and acts with the header of the page only.
    let signed_in = agent
        .post("/session", &json!({ "token": reader }).to_string())
        .expect(200);
    let cookie = signed_in
        .head
        .lines()
        .find_map(|line| line.strip_prefix("set-cookie: "));
    let cookie = cookie.unwrap().split(';').next().unwrap();
    let number = cookie.split_once('=').unwrap().1;
    let cookie = format!("Cookie: eis_bench_session={number}\r\n");
    assert_eq!(
        agent
            .ask("GET /api/v1/whoami", &cookie, "")
            .expect(200)
            .json()["name"],
        "ann"
    );
    let stop = "POST /api/v1/fleet/stop";
    let forged = agent.ask(stop, &cookie, "{}").expect(403);
    assert_eq!(forged.json()["code"], "forged");
    agent
        .ask(stop, &format!("{cookie}X-Eis-Bench: page\r\n"), "{}")
        .expect(200);
    for (head, code) in [
        ("Host: evil.example\r\n".to_owned(), "other_host"),
        ("Origin: http://evil.example\r\n".to_owned(), "other_origin"),
    ] {
        let refused = agent
            .ask(fleet, &format!("{head}{}", bearer(&reader)), "")
            .expect(403);
        assert_eq!(refused.json()["code"], code);
    }
    let page = agent.ask("GET /", "", "").expect(200);
    assert!(page.text().contains("STOP FLEET") && page.head.contains("content-security-policy"));
    for path in [
        "shell.js",
        "fleet.js",
        "bench.js",
        "find.js",
        "server.js",
        "fleet.css",
    ] {
        agent.ask(&format!("GET /{path}"), "", "").expect(200);
    }
    // What the page offers and checks is the server's.
    let experiments = agent
        .ask("GET /api/v1/experiments", &bearer(&reader), "")
        .expect(200);
    assert_eq!(experiments.json()[0]["experiment"], "demo");
    agent.ask("GET /api/v1/experiments", "", "").expect(401);
    let document = agent.get("/openapi.json");
    assert!(
        document["paths"]["/api/v1/fleet/jobs"]["post"].is_object(),
        "{document}"
    );
}

#[test]
fn an_agent_before_a_server_without_tokens_does_not_answer_for_other_machines() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let files = Files::tiny();
    let server = serve(&files);
    write_agent(&files, &broker, "north", &server.address);
    let agent = start_agent(&files);
    agent.get("/whoami");
    let passed_on = "X-Forwarded-For: 192.0.2.7\r\n";
    agent.ask("GET /api/v1/whoami", passed_on, "").expect(401);
    agent
        .ask("POST /api/v1/fleet/stop", passed_on, "{}")
        .expect(401);
}

#[test]
fn server_and_agent_are_reached_over_tls_with_a_certificate_of_ones_own() {
    let folder = tempfile::tempdir().unwrap();
    let Some(broker) = Broker::start(folder.path().join("nats")) else {
        return;
    };
    let files = Files::tiny();
    let pem = root()
        .join("bench-daemon/tests/data/tls")
        .canonicalize()
        .unwrap();
    let (certificate, key) = (pem.join("certificate.pem"), pem.join("key.pem"));
    let tls = format!("[tls]\ncertificate = {certificate:?}\nkey = {key:?}\n");
    let server = serve_with(&files, &tls);
    write_agent(&files, &broker, "north", &server.address);
    let text = files.text("fleet.toml").replace("http://", "https://");
    files.write(
        "fleet.toml",
        &format!("{text}bench_ca = {certificate:?}\n{tls}"),
    );
    let agent = start_agent(&files);
    broker.wait_for_bench("north", "idle");
    let roots = parse_pem(&std::fs::read(&certificate).unwrap())
        .filter_map(|item| match item.unwrap() {
            PemItem::Certificate(certificate) => Some(certificate),
            _ => None,
        })
        .collect::<Vec<_>>();
    let roots = RootCerts::new_with_certs(&roots);
    let config = ureq::Agent::config_builder()
        .tls_config(TlsConfig::builder().root_certs(roots).build())
        .build();
    let client: ureq::Agent = config.into();
    let url = format!("https://{}/api/v1/fleet", agent.address);
    let mut answer = client.get(&url).call().unwrap();
    let fleet: Value = serde_json::from_str(&answer.body_mut().read_to_string().unwrap()).unwrap();
    assert_eq!(fleet["benches"][0]["state"], "idle", "{fleet}");
}
