//! Instruments that are exchanged, or that spell their identity differently, between two parts of
//! a run.

use std::{
    fs,
    io::{Read, Write},
    net::{Shutdown, TcpStream},
    sync::{Arc, Mutex},
};

use crate::{
    kill::{end, start, wait_for_points},
    resume::resume,
    support::{EXPERIMENT, Files, Ports},
};

/// Changes that a proxy makes to the answers of an instrument.
#[derive(Default)]
struct Answers {
    /// Text that replaces another one.
    replaced: Option<(String, String)>,
    /// Connections at present.
    open: Vec<TcpStream>,
}

/// A proxy between the programs and an instrument.
#[derive(Clone, Default)]
struct Proxy(Arc<Mutex<Answers>>);

impl Proxy {
    fn before(files: &Files, role: &str) -> Self {
        let (instrument, listener) = files.stand_before(role);
        let proxy = Self::default();
        let shared = proxy.clone();
        std::thread::spawn(move || {
            for client in listener.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(&instrument) else {
                    return;
                };
                let ends = [&client, &far].map(|end| end.try_clone().unwrap());
                shared.0.lock().unwrap().open.extend(ends);
                let (to, from) = (far.try_clone().unwrap(), client.try_clone().unwrap());
                std::thread::spawn(move || pass(from, to, None));
                let shared = shared.clone();
                std::thread::spawn(move || pass(far, client, Some(&shared)));
            }
        });
        proxy
    }

    /// Plugs in another instrument: every connection breaks.
    fn exchange(&self, from: &str, to: &str) {
        let mut answers = self.0.lock().unwrap();
        answers.replaced = Some((from.to_owned(), to.to_owned()));
        for stream in answers.open.drain(..) {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

/// Forwards bytes, and alters them if they are answers.
fn pass(mut from: TcpStream, mut to: TcpStream, answers: Option<&Proxy>) {
    let mut bytes = [0_u8; 65536];
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        let altered = answers
            .and_then(|proxy| proxy.0.lock().unwrap().replaced.clone())
            .and_then(|(old, new)| {
                let text = std::str::from_utf8(&bytes[..count]).ok()?;
                text.contains(&old).then(|| text.replace(&old, &new))
            });
        let sent = match &altered {
            Some(text) => to.write_all(text.as_bytes()),
            None => to.write_all(&bytes[..count]),
        };
        if sent.is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
    let _ = from.shutdown(Shutdown::Both);
}

fn short() -> Files {
    Files::short(6).without(EXPERIMENT, "fixture_check")
}

#[test]
fn another_charger_between_a_kill_and_resume_is_a_question_and_another_spelling_is_none() {
    for (role, from, to, another) in [
        ("supply", "SIM00001", "SIM00002", true),
        (
            "supply4q",
            "KEPCO,BOP1KW 50-20",
            "kepco , Bop1kw  50-20 ",
            false,
        ),
        (
            "load",
            "Siglent Technologies",
            "SIGLENT  TECHNOLOGIES",
            false,
        ),
    ] {
        let files = short();
        let ports = Ports::serve(&files, 10.0, 1);
        let proxy = Proxy::before(&files, role);
        let run = files.path("run");
        let mut child = start(&files, &run, &[]);
        wait_for_points(&mut child, &run, ("raw_cell.csv", 2));
        child.0.kill().unwrap();
        child.0.wait().unwrap();
        crate::guardian::report(&files, "verified");
        let journal = fs::read_to_string(run.join("journal.jsonl")).unwrap();
        for known in [
            "supply4q",
            "generator",
            "scope",
            "load",
            "supply",
            "chiller",
            "logger",
        ] {
            assert!(journal.contains(&format!("{{\"role\":\"{known}\",\"identity\":\"")));
        }
        assert!(journal.contains("\"serial\":\"SIM00001\""), "{journal}");
        proxy.exchange(from, to);
        let mut resumed = resume(&run, &[]);
        if another {
            resumed.expect_code(2);
            let text = resumed.message();
            for words in [
                "supply was `Siglent Technologies,SPD3303X,SIM00001,",
                "and is `Siglent Technologies,SPD3303X,SIM00002,",
                "--accept-instruments",
            ] {
                assert!(text.contains(words), "{words}: {text}");
            }
            ports.assert_outputs_off();
            resumed = resume(&run, &["--accept-instruments"]);
        }
        resumed.expect_code(0);
        let events = fs::read_to_string(run.join("events.csv")).unwrap();
        assert_eq!(
            events.contains("accepted by a person: expected the instruments"),
            another,
            "{role}: {events}"
        );
        ports.assert_outputs_off();
    }
}

#[test]
fn a_run_does_not_go_on_by_itself_with_another_bipolar_supply() {
    let files = short();
    let ports = Ports::serve(&files, 10.0, 1);
    let proxy = Proxy::before(&files, "supply4q");
    let run = files.path("run");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("raw_cell.csv", 2));
    let serial = |text: &str| {
        let (_, rest) = text.split_once("KEPCO,BOP1KW 50-20 ,").unwrap();
        rest.split(',').next().unwrap().to_owned()
    };
    let before = serial(&fs::read_to_string(run.join("journal.jsonl")).unwrap());
    proxy.exchange(&before, "E999999");
    let (code, words) = end(child);
    assert_eq!(code, Some(2), "{words}");
    for text in [
        "supply4q was `KEPCO,BOP1KW 50-20 ,",
        ",E999999,",
        "--accept-instruments",
    ] {
        assert!(words.contains(text), "{text}: {words}");
    }
    ports.assert_outputs_off();
}
