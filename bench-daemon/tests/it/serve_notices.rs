//! Notices by webhook and e-mail, to receivers of this test on this machine.

use std::{
    io::{BufRead, BufReader, Write},
    net::TcpListener,
    sync::mpsc,
};

use serde_json::Value;

use crate::{
    serve_support::{Served, config, submit},
    support::{CELL, Files, Ports, poll},
};

/// Starts a receiver of webhooks that answers with this status; returns its address and the
/// received messages.
fn hook(status: &'static str) -> (String, mpsc::Receiver<Value>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/hook/secret", listener.local_addr().unwrap());
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = BufReader::new(stream.unwrap());
            let (mut line, mut length) = (String::new(), 0);
            while stream.read_line(&mut line).unwrap() > 2 {
                let value = line.to_lowercase();
                if let Some(found) = value.strip_prefix("content-length:") {
                    length = found.trim().parse().unwrap();
                }
                line.clear();
            }
            let mut body = vec![0; length];
            std::io::Read::read_exact(&mut stream, &mut body).unwrap();
            let answer =
                format!("HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
            stream.get_mut().write_all(answer.as_bytes()).unwrap();
            if sender.send(serde_json::from_slice(&body).unwrap()).is_err() {
                return;
            }
        }
    });
    (address, receiver)
}

/// Starts a mail server that accepts every message (RFC 5321); returns its address and the
/// messages.
fn mail() -> (String, mpsc::Receiver<String>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = BufReader::new(stream.unwrap());
            stream.get_mut().write_all(b"220 test\r\n").unwrap();
            let (mut message, mut in_data) = (String::new(), false);
            let mut line = String::new();
            while stream.read_line(&mut line).unwrap_or(0) > 0 {
                let answer = match (line.trim_end(), in_data) {
                    (".", true) => {
                        in_data = false;
                        sender.send(std::mem::take(&mut message)).unwrap();
                        "250 taken\r\n"
                    }
                    (_, true) => {
                        message.push_str(&line);
                        ""
                    }
                    ("DATA", false) => {
                        in_data = true;
                        "354 go on\r\n"
                    }
                    ("QUIT", false) => "221 bye\r\n",
                    _ => "250 fine\r\n",
                };
                stream.get_mut().write_all(answer.as_bytes()).unwrap();
                line.clear();
            }
        }
    });
    (address, receiver)
}

#[test]
fn ends_and_trips_are_reported_by_webhook_and_by_mail() {
    let files = Files::short(4).edit(
        CELL,
        "temperature_max = \"60 °C\"",
        "temperature_max = \"20 °C\"",
    );
    let _ports = Ports::serve(&files, 50.0, 1);
    let (address, hooks) = hook("204 No Content");
    let (server, mails) = mail();
    let section = format!(
        "[notify]\nwebhook = {address:?}\n[notify.email]\nserver = {server:?}\nencryption = \"none\"\n\
        from = \"Bench <bench@lab.example>\"\nto = [\"ann@lab.example\"]\n"
    );
    config(&files, &section);
    let served = Served::start(&files);
    let now = served.get("/notices");
    let host = address.split('/').nth(2).unwrap();
    assert_eq!(
        now["webhook"], host,
        "the rest of the address may be a secret"
    );
    submit(&served, r#"{"experiment":"demo"}"#);
    let notices: Vec<Value> = (0..2).map(|_| hooks.recv().unwrap()).collect();
    let about = |word: &str| {
        notices
            .iter()
            .find(|one| one["about"] == word)
            .unwrap_or_else(|| panic!("{notices:?}"))
    };
    assert_eq!(
        (&about("trip")["bench"], &about("trip")["title"]),
        (&"demo".into(), &"demo is latched".into())
    );
    assert!(
        about("trip")["text"]
            .as_str()
            .unwrap()
            .contains("temperature")
    );
    assert!(
        about("end")["title"]
            .as_str()
            .unwrap()
            .starts_with("demo-1 on demo: ")
    );
    let messages = [mails.recv().unwrap(), mails.recv().unwrap()];
    let trip = messages
        .iter()
        .find(|message| message.contains("demo is latched"))
        .unwrap();
    assert!(
        trip.contains("To: ann@lab.example")
            && trip.contains("Subject: eis-bench: demo is latched")
    );
    let sent = poll("what came of it", || {
        let latest = served.get("/notices")["latest"].clone();
        let sent =
            |one: &Value| one["outcome"]["webhook"] == "sent" && one["outcome"]["e-mail"] == "sent";
        latest
            .as_array()
            .unwrap()
            .iter()
            .all(sent)
            .then_some(latest)
    });
    assert_eq!(sent.as_array().unwrap().len(), 2);
}

#[test]
fn a_test_says_what_came_of_it_and_quiet_hours_keep_what_can_wait() {
    let files = Files::demo();
    let (address, hooks) = hook("500 Internal Server Error");
    // Quiet but for the minute before midnight, in which this waits.
    config(
        &files,
        &format!("[notify]\nwebhook = {address:?}\nquiet = \"00:00-23:59\"\n"),
    );
    let served = Served::start(&files);
    let tried = served.post("/notices/test", "").expect(200).json();
    assert_eq!(hooks.recv().unwrap()["about"], "test");
    assert_eq!(
        tried["outcome"]["webhook"],
        "not sent, try 1: http status: 500"
    );
    served.ended(&submit(&served, r#"{"experiment":"demo"}"#));
    let kept = poll("the notice of the end", || {
        let latest = served.get("/notices")["latest"].clone();
        latest
            .as_array()
            .unwrap()
            .iter()
            .find(|one| one["about"] == "end")
            .cloned()
    });
    let outcome = poll("what came of it", || {
        let latest = served.get("/notices")["latest"].clone();
        let same = latest
            .as_array()
            .unwrap()
            .iter()
            .find(|one| one["number"] == kept["number"])
            .cloned();
        same.map(|one| one["outcome"].clone())
            .filter(|outcome| *outcome != serde_json::json!({}))
    });
    assert_eq!(outcome["quiet hours"], "kept until their end");
    assert!(hooks.try_recv().is_err());
}

#[test]
fn a_wrong_receiver_is_reported_by_its_field() {
    let files = Files::demo();
    for (section, words) in [
        (
            "webhook = \"http://lab.example/x\"",
            "notify.webhook: expected an address https://HOST/PATH",
        ),
        ("quiet = \"22-6\"", "notify.quiet: expected two local times"),
        (
            "[notify.email]\nserver = \"smtp.lab.example:25\"\nencryption = \"none\"\nfrom = \"a@b.example\"\nto = []",
            "notify.email.encryption: expected `tls` or `starttls`",
        ),
        (
            "[notify.email]\nserver = \"smtp.lab.example:465\"\nfrom = \"a@b.example\"\nto = []",
            "notify.email.to: expected at least one address",
        ),
        (
            "[notify.email]\nserver = \"smtp.lab.example:465\"\nfrom = \"nobody\"\nto = [\"a@b.example\"]",
            "notify.email.from: expected an address",
        ),
    ] {
        let path = config(&files, &format!("[notify]\n{section}\n"));
        let arguments = ["config".as_ref(), "check".as_ref(), path.as_os_str()];
        let ended = crate::support::program(&arguments);
        assert!(ended.stdout.contains(words), "{}", ended.stdout);
    }
}
