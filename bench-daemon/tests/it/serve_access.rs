//! Access to a server: scopes of tokens, and malformed requests.

use std::{
    fs,
    io::{Read, Write},
    sync::Arc,
};

use rustls::pki_types::{CertificateDer, ServerName, pem::PemObject};

use crate::{
    serve_support::{Served, answer, config, data, token},
    support::{Files, program},
};

const SCOPES: [&str; 5] = ["read", "operate", "energise", "clear-trip", "fleet"];

/// Returns every operation of the document: method, path with names filled in, and its scope; an
/// empty scope if any token is sufficient, `None` if no token is required.
fn operations(document: &serde_json::Value) -> Vec<(String, String, Option<String>)> {
    let paths = document["paths"].as_object().unwrap();
    let operations = paths.iter().flat_map(|(path, item)| {
        item.as_object()
            .unwrap()
            .iter()
            .map(move |(method, operation)| (path, method, operation))
    });
    operations
        .map(|(path, method, operation)| {
            let path = path
                .replace("{bench}", "demo")
                .replace("{run}", "none")
                .replace("{id}", "77")
                .replace("{path}", "x")
                .replace("{kind}", "cells")
                .replace("{name}", "none")
                .replace("{cell}", "none")
                .replace("{experiment}", "none");
            (
                method.to_uppercase(),
                path,
                operation["security"].is_array().then(|| {
                    operation["security"][0]["token"][0]
                        .as_str()
                        .unwrap_or_default()
                        .to_owned()
                }),
            )
        })
        .collect()
}

#[test]
fn every_call_wants_its_scope_and_no_other() {
    let files = Files::short(2);
    config(&files, "[limits]\nburst = 2000");
    let served = Served::start(&files);
    let document = served.get("/openapi.json");
    let all = operations(&document);
    assert!(all.len() > 30, "{}", all.len());
    // With the first token the door is shut, without a restart.
    let tokens = SCOPES.map(|scope| token(&files, &format!("{scope}-only"), scope));
    let any: Vec<&str> = all
        .iter()
        .filter(|(.., scope)| scope.as_deref() == Some(""))
        .map(|(_, path, _)| path.as_str())
        .collect();
    assert_eq!(
        any,
        [
            "/api/v1/benches/demo/stop",
            "/api/v1/stop",
            "/api/v1/whoami"
        ]
    );
    for (method, path, scope) in &all {
        // A session has tests of its own.
        if path == "/api/v1/events" || path == "/api/v1/session" {
            continue;
        }
        let ask = |token: &str| {
            served.ask(
                method,
                path,
                (
                    token,
                    if method == "POST" || method == "PUT" {
                        "{}"
                    } else {
                        ""
                    },
                ),
            )
        };
        let none = ask("");
        let Some(scope) = scope else {
            assert_eq!((none.status, path.as_str()), (200, "/api/v1/openapi.json"));
            continue;
        };
        // A person at the machine can stop; a stop that a proxy forwards requires a token.
        if path == "/api/v1/stop" || path == "/api/v1/benches/demo/stop" {
            assert_eq!(none.status, 200, "{method} {path}");
            let passed_on = format!(
                "POST {path} HTTP/1.1\r\nHost: {}\r\nX-Forwarded-For: 192.0.2.7\r\n\
                Connection: close\r\nContent-Length: 0\r\n\r\n",
                served.address
            );
            assert_eq!(served.raw(passed_on.as_bytes()).status, 401, "{path}");
            continue;
        }
        assert_eq!(
            (none.status, &none.json()["code"]),
            (401, &"unauthorised".into()),
            "{method} {path}"
        );
        assert!(
            none.head.contains("www-authenticate: bearer"),
            "{}",
            none.head
        );
        for (holds, token) in SCOPES.iter().zip(&tokens) {
            let answer = ask(token);
            let refused = answer.status == 403;
            assert_eq!(
                refused,
                holds != scope && !scope.is_empty(),
                "{method} {path} with {holds}: {}",
                answer.text()
            );
            assert!(
                answer.status != 401 && answer.status < 500,
                "{method} {path} with {holds}: {}",
                answer.text()
            );
            let documented = &document["paths"][path.replace("demo", "{bench}").as_str()];
            assert!(
                refused
                    || documented.is_null()
                    || !documented[method.to_lowercase()]["responses"][answer.status.to_string()]
                        .is_null()
            );
        }
    }
    let mut wrong = tokens[0].clone();
    wrong.replace_range(10..11, if &wrong[10..11] == "0" { "1" } else { "0" });
    served
        .ask("GET", "/api/v1/benches", (&wrong, ""))
        .expect(401);
    assert_eq!(
        served.ask("GET", "/api/v1/whoami", (&tokens[0], "")).json(),
        serde_json::json!({ "name": "read-only", "scopes": ["read"], "benches": ["demo"] })
    );
    let audit = data(&files, "audit.jsonl");
    assert!(
        audit.contains(
            "\"who\":\"local\",\"from\":\"127.0.0.1\",\
            \"what\":\"POST /api/v1/benches/demo/stop\",\"outcome\":\"200\""
        ),
        "{audit}"
    );
    assert!(
        audit.contains("\"who\":\"operate-only\"")
            && audit.contains("\"what\":\"POST /api/v1/queue\",\"outcome\":\"403 forbidden\"")
    );
    assert!(
        tokens
            .iter()
            .all(|token| !audit.contains(token) && !data(&files, "tokens.json").contains(token))
    );
    // The page itself holds no secret.
    for path in [
        "/",
        "/app.js",
        "/bench.js",
        "/curves.js",
        "/find.js",
        "/forms.js",
        "/analysis.js",
        "/pack.js",
        "/notices.js",
        "/d3.js",
        "/server.js",
        "/style.css",
        "/time.js",
        "/uplot.js",
        "/uplot.css",
    ] {
        let answer = served.ask("GET", path, ("", "")).expect(200);
        assert!(
            answer
                .head
                .contains("content-security-policy: default-src 'none'")
                && answer.head.contains("x-content-type-options: nosniff")
        );
    }
    let config = files.path("serve.toml");
    program(&[
        "token".as_ref(),
        "revoke".as_ref(),
        config.as_os_str(),
        "read-only".as_ref(),
    ])
    .expect_code(0);
    served
        .ask("GET", "/api/v1/benches", (&tokens[0], ""))
        .expect(401);
    let listed = program(&["token".as_ref(), "list".as_ref(), config.as_os_str()]).stdout;
    assert_eq!(listed.lines().count(), SCOPES.len() - 1, "{listed}");
}

#[test]
fn no_file_outside_a_run_is_read() {
    let files = Files::short(2);
    config(&files, "");
    fs::create_dir_all(files.path("data/runs/r/sub")).unwrap();
    fs::write(files.path("data/runs/r/in.txt"), "inside").unwrap();
    fs::write(files.path("secret.txt"), "outside").unwrap();
    std::os::unix::fs::symlink(files.path("secret.txt"), files.path("data/runs/r/link.txt"))
        .unwrap();
    std::os::unix::fs::symlink(files.path("."), files.path("data/runs/up")).unwrap();
    std::os::unix::fs::symlink(files.path("."), files.path("data/runs/r/sub/up")).unwrap();
    let served = Served::start(&files);
    let get = |path: &str| served.ask("GET", &format!("/api/v1/runs/{path}"), ("", ""));
    assert_eq!(get("r/files/in.txt").expect(200).body, b"inside");
    for path in [
        "r/files/link.txt",
        "r/files/sub/up/secret.txt",
        "up/files/secret.txt",
        "r/files/../../../secret.txt",
        "r/files/..%2f..%2f..%2fsecret.txt",
        "r/files/%2e%2e/%2e%2e/%2e%2e/secret.txt",
        "r/files/%2fetc%2fhostname",
        "r/files//etc/hostname",
        "r/files/in.txt%00",
        "..%2fruns%2fr/files/in.txt",
        "../tokens.json",
        ".%2e/files/tokens.json",
        "r/files/sub",
        "r%2fsub/files",
    ] {
        let answer = get(path);
        assert_eq!(answer.status, 404, "{path}: {}", answer.text());
        assert!(!answer.text().contains("outside"), "{path}");
    }
}

#[test]
fn what_is_too_large_too_slow_or_meant_for_somebody_else_is_refused() {
    let files = Files::short(2);
    config(&files, "[limits]\nbody_bytes = 4096\npatience = \"1 s\"");
    let served = Served::start(&files);
    let host = &served.address;
    let head = |more: &str| {
        format!(
            "POST /api/v1/queue HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\n\
            {more}\r\n"
        )
    };
    let code = |request: &[u8]| {
        let answer = served.raw(request);
        (
            answer.status,
            if answer.status == 0 {
                String::new()
            } else {
                answer.json()["code"]
                    .as_str()
                    .unwrap_or_default()
                    .to_owned()
            },
        )
    };
    let refusal = |status: u16, code: &str| (status, code.to_owned());
    // A body with a large declared size, and a large body without a declared size.
    assert_eq!(
        code(head("Connection: close\r\nContent-Length: 5000\r\n").as_bytes()),
        refusal(413, "too_large")
    );
    let chunk = format!(
        "{}1000\r\n{}\r\n1000\r\n{}\r\n0\r\n\r\n",
        head("Connection: close\r\nTransfer-Encoding: chunked\r\n"),
        "x".repeat(4096),
        "x".repeat(4096)
    );
    assert_eq!(code(chunk.as_bytes()), refusal(413, "too_large"));
    // A body that does not come to its end, and a head that does not.
    assert_eq!(
        code(format!("{}{{", head("Connection: close\r\nContent-Length: 100\r\n")).as_bytes()),
        refusal(408, "too_slow")
    );
    let mut slow = served.connect();
    slow.write_all(b"GET /api/v1/benches HTTP/1.1\r\nHost: ")
        .unwrap();
    let mut rest = Vec::new();
    let _ = slow.read_to_end(&mut rest);
    assert_ne!(answer(&rest).status, 200);
    let mut idle = served.connect();
    assert_eq!(
        idle.read(&mut [0; 16]).unwrap_or(0),
        0,
        "a peer that says nothing is let go of"
    );
    let long = format!(
        "GET /{} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n",
        "a".repeat(3000)
    );
    assert_eq!(code(long.as_bytes()), refusal(400, "bad_request"));
    let many = format!(
        "GET / HTTP/1.1\r\nHost: {host}\r\nX: {}\r\n\r\n",
        "a".repeat(40_000)
    );
    // Whether the answer is read before the connection is reset is the system's business.
    let refused = served.raw(many.as_bytes());
    assert!(
        refused.status == 0 || refused.json()["code"] == "head_too_large",
        "{}",
        refused.text()
    );
    let lines = format!(
        "GET / HTTP/1.1\r\nHost: {host}\r\n{}\r\n",
        "X: a\r\n".repeat(200)
    );
    assert_eq!(code(lines.as_bytes()), refusal(431, "head_too_large"));
    assert_eq!(code(b"GET / nonsense\r\n\r\n"), refusal(400, "bad_request"));
    // Another name for this machine, a page of elsewhere, a form of elsewhere.
    let get = |host: &str, more: &str| {
        code(
            format!(
                "GET /api/v1/benches HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n"
            )
            .as_bytes(),
        )
    };
    assert_eq!(get("evil.example", ""), refusal(403, "other_host"));
    assert_eq!(
        get(host, "Origin: http://evil.example\r\n"),
        refusal(403, "other_origin")
    );
    assert_eq!(get(host, &format!("Origin: http://{host}\r\n")).0, 200);
    let form = format!(
        "POST /api/v1/queue HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\
        Content-Type: text/plain\r\nContent-Length: 2\r\n\r\n{{}}"
    );
    assert_eq!(code(form.as_bytes()), refusal(415, "not_json"));
    // A path that does not exist, and one that exists for another method.
    assert_eq!(
        code(
            format!("GET /api/v1/none HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n")
                .as_bytes()
        ),
        refusal(404, "not_found")
    );
    let other = served.ask("PUT", "/api/v1/queue", ("", ""));
    assert!(
        other.status == 405
            && other.head.contains("allow: get,head,post")
            && other.json()["code"] == "method_not_allowed",
        "{}",
        other.head
    );
    for _ in 0..3 {
        assert_eq!(served.raw(b"\x16\x03\x01 nonsense\r\n\r\n").status, 400);
    }
    served.get("/benches");
}

#[test]
fn one_peer_cannot_ask_for_ever_and_a_stop_is_heard_all_the_same() {
    let files = Files::short(2);
    config(&files, "[limits]\nrequests_per_s = 0.1\nburst = 5");
    let served = Served::start(&files);
    let statuses: Vec<u16> = (0..8)
        .map(|_| served.ask("GET", "/api/v1/queue", ("", "")).status)
        .collect();
    assert_eq!(statuses, [200, 200, 200, 200, 200, 429, 429, 429]);
    // If there is nothing to read back, no read-back is reported.
    let report = served.post("/benches/demo/stop", "").expect(200).json();
    assert_eq!(
        (&report["verified"], &report["simulated"]),
        (&false.into(), &true.into()),
        "{report}"
    );
    assert_eq!(
        report["steps"][1],
        "nothing of this bench is outside the run's process, and none runs: no output was read back"
    );
}

#[test]
fn wrong_tokens_are_counted() {
    let files = Files::short(2);
    config(&files, "");
    let good = token(&files, "ann", "read");
    let served = Served::start(&files);
    let guesses: Vec<u16> = (0..25)
        .map(|guess| {
            served
                .ask("GET", "/api/v1/queue", (&format!("eb_{guess}"), ""))
                .status
        })
        .collect();
    assert_eq!(
        guesses.iter().filter(|status| **status == 401).count(),
        20,
        "{guesses:?}"
    );
    assert_eq!(guesses[24], 429);
    // A client with a valid token is not blocked by another client's wrong guesses.
    served.ask("GET", "/api/v1/queue", (&good, "")).expect(200);
    served
        .ask("POST", "/api/v1/benches/demo/stop", (&good, ""))
        .expect(200);
}

#[test]
fn a_server_behind_a_proxy_wants_tokens() {
    let files = Files::short(2);
    let path = config(&files, "[proxy]\nhost = \"bench.lab.example\"");
    let message = program(&["serve".as_ref(), path.as_os_str()]);
    let message = message.expect_code(2).message().to_owned();
    assert!(
        message.contains("expected at least one token to listen beyond this machine")
            && message.contains("bench.lab.example"),
        "{message}"
    );
    let secret = token(&files, "ann", "read");
    let served = Served::start(&files);
    let asked = |host: &str, more: &str| {
        let request = format!(
            "GET /api/v1/whoami HTTP/1.1\r\nHost: {host}\r\nConnection: close{more}\r\n\r\n"
        );
        served.raw(request.as_bytes()).status
    };
    assert_eq!(asked("bench.lab.example", ""), 401);
    let bearer = format!("\r\nAuthorization: Bearer {secret}");
    assert_eq!(asked("bench.lab.example", &bearer), 200);
    assert_eq!(asked("evil.example", &bearer), 403);
}

#[test]
fn a_server_beyond_this_machine_wants_tokens_and_a_certificate() {
    let files = Files::short(2);
    let beyond = |more: &str| {
        let path = config(&files, more);
        files.write(
            "serve.toml",
            &files.text("serve.toml").replace("127.0.0.1:0", "0.0.0.0:0"),
        );
        program(&["serve".as_ref(), path.as_os_str()])
    };
    let message = beyond("").expect_code(2).message().to_owned();
    assert!(
        message.contains("serve.toml:1: listen: expected a section [tls] with certificate and key"),
        "{message}"
    );
    let pem = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/tls");
    let tls = format!(
        "[tls]\ncertificate = {:?}\nkey = {:?}",
        pem.join("certificate.pem"),
        pem.join("key.pem")
    );
    let message = beyond(&tls).expect_code(2).message().to_owned();
    assert!(
        message.contains("expected at least one token to listen beyond this machine")
            && message.contains("eis-bench token add"),
        "{message}"
    );
    let message = beyond(&tls.replace("key.pem", "certificate.pem"))
        .expect_code(2)
        .message()
        .to_owned();
    assert!(message.contains("at least one token"), "{message}");
    let secret = token(&files, "ann", "read");
    let message = beyond(&tls.replace("key.pem", "certificate.pem"))
        .expect_code(2)
        .message()
        .to_owned();
    assert!(
        message.contains("certificate.pem: expected PEM for TLS: "),
        "{message}"
    );
    config(&files, &tls);
    files.write(
        "serve.toml",
        &files.text("serve.toml").replace("127.0.0.1:0", "0.0.0.0:0"),
    );
    let served = Served::start(&files);
    let port = served.address.rsplit_once(':').unwrap().1;
    let mut roots = rustls::RootCertStore::empty();
    roots
        .add(CertificateDer::from_pem_file(pem.join("certificate.pem")).unwrap())
        .unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let client = rustls::ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap();
    let client = Arc::new(client.with_root_certificates(roots).with_no_client_auth());
    let request = format!(
        "GET /api/v1/whoami HTTP/1.1\r\nHost: localhost:{port}\r\nConnection: close\r\n\
        Authorization: Bearer {secret}\r\n\r\n"
    );
    let ask = |request: &str| {
        let mut tls = rustls::ClientConnection::new(
            client.clone(),
            ServerName::try_from("localhost").unwrap(),
        )
        .unwrap();
        let mut socket = std::net::TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
        let mut stream = rustls::Stream::new(&mut tls, &mut socket);
        stream.write_all(request.as_bytes()).unwrap();
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        answer(&bytes)
    };
    assert_eq!(ask(&request).expect(200).json()["name"], "ann");
    // The server does not answer without encryption.
    let mut plain = std::net::TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
    plain.write_all(request.as_bytes()).unwrap();
    let mut bytes = Vec::new();
    let _ = plain.read_to_end(&mut bytes);
    assert!(!String::from_utf8_lossy(&bytes).contains("ann"));
    // Without its last token the server refuses everyone, whether the token was revoked or the
    // file is gone.
    let without = request.replace(&format!("Authorization: Bearer {secret}\r\n"), "");
    let config = files.path("serve.toml");
    let wording = program(&[
        "token".as_ref(),
        "revoke".as_ref(),
        config.as_os_str(),
        "ann".as_ref(),
    ])
    .expect_code(0)
    .stdout
    .clone();
    assert!(
        wording.contains(
            "that was the last token: the server listens beyond this machine (on 0.0.0.0:0) and \
    refuses all requests"
        ),
        "{wording}"
    );
    ask(&request).expect(401);
    ask(&without).expect(401);
    fs::remove_file(files.path("data/tokens.json")).unwrap();
    ask(&request).expect(401);
    ask(&without).expect(401);
}

#[test]
fn a_section_of_a_fleet_is_refused_with_the_way_to_move_it() {
    let files = Files::short(2);
    let path = config(&files, "[fleet]\nname = \"lab\"\nsite = \"north\"");
    let message = program(&["serve".as_ref(), path.as_os_str()]);
    let message = message.expect_code(2).message().to_owned();
    assert!(
        message.contains("serve.toml:") && message.contains("fleet: expected no section [fleet]"),
        "{message}"
    );
    assert!(message.contains("eis-fleet agent fleet.toml"), "{message}");
}
