//! `identify` sends only queries; it names an instrument that it does not support, and how to
//! support it.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    process::Child,
    sync::{Arc, Barrier, Mutex},
};

use crate::support::{BENCH, Files, Ports, command, program};

/// The roles of the demo's instruments.
const ROLES: [&str; 8] = [
    "supply4q",
    "generator",
    "scope",
    "load",
    "supply",
    "chiller",
    "logger",
    "jig",
];

/// A proxy between a client and an instrument that records every byte that goes to the
/// instrument.
struct Recorder {
    sent: Arc<Mutex<Vec<u8>>>,
}

impl Recorder {
    fn before(files: &Files, role: &str) -> Self {
        let (instrument, listener) = files.stand_before(role);
        let sent = Arc::new(Mutex::new(Vec::new()));
        let shared = sent.clone();
        std::thread::spawn(move || {
            for mut client in listener.incoming().map_while(Result::ok) {
                let mut far = TcpStream::connect(&instrument).unwrap();
                let (mut back, mut answers) =
                    (client.try_clone().unwrap(), far.try_clone().unwrap());
                std::thread::spawn(move || std::io::copy(&mut answers, &mut back));
                let mut bytes = [0_u8; 4096];
                while let Ok(count @ 1..) = client.read(&mut bytes) {
                    shared.lock().unwrap().extend_from_slice(&bytes[..count]);
                    far.write_all(&bytes[..count]).unwrap();
                }
                let _ = far.shutdown(std::net::Shutdown::Both);
            }
        });
        Self { sent }
    }

    fn messages(&self) -> Vec<String> {
        let text = String::from_utf8(self.sent.lock().unwrap().clone()).unwrap();
        text.split(['\r', '\n'])
            .filter(|line| !line.is_empty())
            .map(str::to_owned)
            .collect()
    }
}

#[test]
fn nothing_but_questions_goes_to_any_instrument() {
    for (from, to) in [
        ("", ""),
        ("siglent-sds800x-hd", "rigol-dho800"),
        ("siglent-sdg1000x", "keysight-33500b"),
        ("siglent-sdl1000x", "rigol-dl3000"),
    ] {
        let files = Files::demo().edit(BENCH, from, to);
        let _ports = Ports::serve(&files, 1.0, 1);
        let roles = [
            "supply4q",
            "generator",
            "scope",
            "load",
            "supply",
            "logger",
            "chiller",
        ];
        let recorders = roles.map(|role| Recorder::before(&files, role));
        let bench = files.path(BENCH);
        program(&["identify".as_ref(), bench.as_os_str()]).expect_code(0);
        for (role, recorder) in roles.iter().zip(recorders) {
            let messages = recorder.messages();
            assert!(!messages.is_empty(), "{role}");
            for message in messages {
                let julabo =
                    message == "VERSION" || message == "STATUS" || message.starts_with("IN_");
                assert!(
                    message.ends_with('?')
                        || message.contains("? ")
                        || (*role == "chiller" && julabo),
                    "{role}: {message:?}"
                );
            }
        }
    }
}

#[test]
#[ignore = "long drill"]
fn an_address_alone_is_enough_and_one_that_is_silent_does_not_hide_the_others() {
    let files = Files::demo();
    let _ports = Ports::serve(&files, 1.0, 1);
    let (bench, _) = bench_plan::config::load_bench(&files.path(BENCH)).unwrap();
    let address = |role: &str| {
        bench
            .instruments
            .addressed()
            .iter()
            .find(|(name, _)| *name == role)
            .unwrap()
            .1
            .address
            .to_string()
    };
    let (scope, chiller) = (address("scope"), address("chiller"));
    let nobody = format!(
        "tcp://{}",
        TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap()
    );
    let asked = program(&["identify", &nobody, &scope, &chiller, "--json"]);
    asked.expect_code(3);
    let found: serde_json::Value = serde_json::from_str(&asked.stdout).unwrap();
    assert!(
        found[0]["failure"].as_str().unwrap().contains("refused"),
        "{found:#}"
    );
    assert!(
        found[1]["model"] == "siglent-sds800x-hd"
            && found[1]["role"] == "scope"
            && found[1]["recognised"] == true,
        "{found:#}"
    );
    assert_eq!(
        found[1]["capabilities"]["half_range_div"]
            .as_f64()
            .map(|div| (10.0 * div).round()),
        Some(43.0)
    );
    assert!(
        found[1]["programmed"].as_array().unwrap().len() > 10
            && found[1]["health"] == serde_json::json!([]),
        "{found:#}"
    );
    assert!(
        found[2]["model"] == "julabo"
            && found[2]["identity"]["raw"]
                .as_str()
                .unwrap()
                .starts_with("JULABO"),
        "{found:#}"
    );
    assert_eq!(
        asked.message(),
        format!(
            "1 of 3 instruments did not answer, or are not the model that was expected: {nobody}"
        )
    );
}

#[test]
fn an_unknown_model_is_refused_with_the_line_that_forces_it() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        for client in listener.incoming().map_while(Result::ok) {
            std::thread::spawn(move || {
                let mut writer = client.try_clone().unwrap();
                for line in BufReader::new(client).lines().map_while(Result::ok) {
                    let answer: &[u8] = if line == "*IDN?" {
                        b"SIGLENT,SDX9000,1,1.0\n"
                    } else {
                        b"0\n"
                    };
                    if writer.write_all(answer).is_err() {
                        break;
                    }
                }
            });
        }
    });
    let asked = program(&["identify", &address]);
    asked.expect_code(3);
    let line = asked
        .stdout
        .lines()
        .find_map(|line| line.split_once("could be tried as  instruments.scope = "))
        .unwrap()
        .1;
    let expected = format!(
        "{{ model = \"siglent-sds800x-hd\", address = \"{address}\", accept = \"SIGLENT,SDX9000\" \
        }}"
    );
    assert_eq!(line, expected, "{}", asked.stdout);
    let files = Files::demo().without(BENCH, "simulation");
    let mut text = String::new();
    for line in files.text(BENCH).lines() {
        text.push_str(line);
        text.push('\n');
    }
    files.write(
        BENCH,
        &format!(
            "name = \"forced\"\n{}",
            &text[text.find("[wiring]").unwrap()..]
        ),
    );
    files.write(
        BENCH,
        &format!("{}\n[instruments]\nscope = {line}\n", files.text(BENCH)),
    );
    let bench = files.path(BENCH);
    let forced = program(&["identify".as_ref(), bench.as_os_str()]);
    forced.expect_code(0);
    assert!(
        forced.stdout.contains("SIGLENT,SDX9000,1,1.0  [ok]"),
        "{}",
        forced.stdout
    );
}

#[test]
fn a_bench_that_runs_is_not_asked() {
    let files = Files::demo();
    let _ports = Ports::serve(&files, 1.0, 1);
    let recorder = Recorder::before(&files, "scope");
    let (config, _) = bench_plan::config::load_bench(&files.path(BENCH)).unwrap();
    let state = bench_core::safety::state::State::of(&config)
        .unwrap()
        .unwrap();
    let run = files.path("run");
    let lock = state.lock(&run).unwrap();
    let (bench, out) = (files.path(BENCH), files.path("report"));
    let words: [&[&std::ffi::OsStr]; 2] = [
        &["identify".as_ref(), bench.as_os_str()],
        &[
            "doctor".as_ref(),
            bench.as_os_str(),
            "--out".as_ref(),
            out.as_os_str(),
        ],
    ];
    for words in words {
        let refused = program(words);
        refused.expect_code(8);
        let expected = format!(
            "expected a bench that is not in use: process {} runs demo for {}",
            std::process::id(),
            run.display()
        );
        assert_eq!(refused.message(), expected);
        assert!(recorder.messages().is_empty() && !out.exists());
    }
    drop(lock);
    program(words[0]).expect_code(0);
    assert!(!recorder.messages().is_empty());
}

/// Passes bytes between a client and an instrument.
fn pass(mut client: TcpStream, instrument: &str) {
    let mut far = TcpStream::connect(instrument).unwrap();
    let (mut back, mut answers) = (client.try_clone().unwrap(), far.try_clone().unwrap());
    std::thread::spawn(move || std::io::copy(&mut answers, &mut back));
    let _ = std::io::copy(&mut client, &mut far);
    let _ = far.shutdown(std::net::Shutdown::Both);
}

#[test]
fn instruments_on_separate_connections_are_asked_in_parallel() {
    let files = Files::demo();
    let _ports = Ports::serve(&files, 1.0, 1);
    // No instrument answers before all of them are asked.
    let all_asked = Arc::new(Barrier::new(ROLES.len()));
    for role in ROLES {
        let (instrument, listener) = files.stand_before(role);
        let all_asked = all_asked.clone();
        std::thread::spawn(move || {
            let (client, _) = listener.accept().unwrap();
            all_asked.wait();
            pass(client, &instrument);
        });
    }
    let bench = files.path(BENCH);
    let asked = program(&["identify".as_ref(), bench.as_os_str(), "--json".as_ref()]);
    let found: serde_json::Value = serde_json::from_str(&asked.expect_code(0).stdout).unwrap();
    let roles: Vec<&str> = (found.as_array().unwrap().iter())
        .map(|one| one["role"].as_str().unwrap())
        .collect();
    assert_eq!(roles, ROLES);
}

#[test]
fn a_silent_instrument_is_named_once_and_the_others_show_identity_and_output() {
    let files = Files::demo();
    let _ports = Ports::serve(&files, 1.0, 1);
    drop(files.stand_before("scope"));
    let bench = files.path(BENCH);
    let asked = program(&["identify".as_ref(), bench.as_os_str()]);
    asked.expect_code(3);
    let lines: Vec<&str> = (asked.stdout.lines())
        .filter(|line| !line.starts_with(' '))
        .collect();
    assert_eq!(lines.len(), ROLES.len(), "{}", asked.stdout);
    for (line, role) in lines.iter().zip(ROLES) {
        assert!(line.starts_with(role), "{line}");
        assert_eq!(line.ends_with("[ok]"), role != "scope", "{line}");
    }
    assert_eq!(
        asked.stdout.matches("refused").count(),
        1,
        "{}",
        asked.stdout
    );
    assert_eq!(
        lines[2].matches("siglent-sds800x-hd").count(),
        1,
        "{}",
        lines[2]
    );
    assert_eq!(
        asked.message(),
        "1 of 8 instruments did not answer, or are not the model that was expected: scope"
    );
    assert!(!asked.stderr.contains("refused"), "{}", asked.stderr);
    assert_eq!(
        asked.stdout.matches("\n    output    off").count(),
        4,
        "{}",
        asked.stdout
    );
    let known = program(&["outputs".as_ref(), bench.as_os_str(), "--known".as_ref()]);
    assert!(
        known.stdout.starts_with("outputs read off at "),
        "{}",
        known.stdout
    );
}

#[test]
fn safe_ends_an_identify_that_hangs() {
    let files = Files::demo();
    let ports = Ports::serve(&files, 1.0, 1);
    let (_, listener) = files.stand_before("scope");
    let bench = files.path(BENCH);
    let mut asked: Child = command(&["identify".as_ref(), bench.as_os_str()])
        .spawn()
        .unwrap();
    // It accepts, and never answers.
    let _client = listener.accept().unwrap();
    let refused = program(&["outputs".as_ref(), bench.as_os_str()]);
    refused.expect_code(8);
    program(&["safe".as_ref(), bench.as_os_str()]).expect_code(0);
    assert_eq!(asked.wait().unwrap().code(), None, "it ended by itself");
    ports.assert_outputs_off();
}
