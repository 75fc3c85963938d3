//! Transcripts of a run are served again, strictly.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Command, Stdio},
};

use bench_daemon::command::{mock::record, run::run_experiment};
use instruments::{mock::Device, transcript::Transcript};

use crate::{
    configuration::configs,
    support::{BENCH, Files},
};

/// Replays the whole communication of a role against its own record; returns how many messages
/// matched, and their total number.
fn followed(files: &Files, role: &str) -> (usize, usize, Option<String>) {
    let path = files.path(&format!("run/transcripts/{role}.txt"));
    let transcript = Transcript::parse(&std::fs::read_to_string(&path).unwrap()).unwrap();
    let (mut device, outcome) = record::load(&path, None).unwrap();
    let sent =
        transcript
            .records
            .iter()
            .filter_map(|record| match (&record.direction, &record.payload) {
                (
                    instruments::transcript::Direction::Sent,
                    instruments::transcript::Payload::Text(text),
                ) => Some(text.clone()),
                _ => None,
            });
    let messages: Vec<String> = sent.collect();
    for message in &messages {
        device.handle(0.0, message.as_bytes());
    }
    (
        outcome.followed(),
        messages.len(),
        outcome
            .divergence()
            .map(|divergence| divergence.to_string()),
    )
}

#[test]
#[ignore = "drill"]
fn every_conversation_of_a_run_can_be_played_again_with_the_blocks_of_its_captures() {
    for bench in ["benches/demo.toml", "benches/second.toml"] {
        let files = Files::short(2);
        files.write(
            BENCH,
            &std::fs::read_to_string(configs().join(bench)).unwrap(),
        );
        run_experiment(&files.load(), &files.path("run")).unwrap();
        for role in [
            "supply4q",
            "generator",
            "scope",
            "load",
            "supply",
            "logger",
            "jig",
        ] {
            let (met, all, divergence) = followed(&files, role);
            println!("{bench} {role}: {met} of {all}");
            assert_eq!((met, divergence), (all, None), "{bench}: {role}");
        }
    }
}

#[test]
fn the_program_serves_a_record_and_ends_with_the_first_difference() {
    let records =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/data/transcripts");
    for (last, code, expected) in [
        ("MOFF", 0, "13 of 13 messages were as recorded"),
        ("MON", 2, "message 11: expected `MOFF`, met `MON`"),
    ] {
        let record = records.join("caenels-fast-ps.txt");
        let mut child = Command::new(env!("CARGO_BIN_EXE_eis-bench"))
            .args([
                "mock".as_ref(),
                "--replay".as_ref(),
                record.as_os_str(),
                "--json".as_ref(),
            ])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        out.read_line(&mut line).unwrap();
        let stated_errors: serde_json::Value = serde_json::from_str(&line).unwrap();
        let mut stream = TcpStream::connect(
            stated_errors["address"]
                .as_str()
                .unwrap()
                .strip_prefix("tcp://")
                .unwrap(),
        )
        .unwrap();
        let before = [
            "LOOP:?",
            "LOOP:I",
            "UPMODE:?",
            "MON",
            "MON",
            "MWI:0.5",
            "MWI:five",
            "UPMODE:ANALOG",
            "MWI:1",
            "UPMODE:NORMAL",
        ];
        let after: &[&str] = if last == "MOFF" {
            &["MWI:1", "NONSENSE"]
        } else {
            &[]
        };
        for message in before.iter().chain(&[last]).chain(after) {
            stream.write_all(format!("{message}\r").as_bytes()).unwrap();
        }
        let mut rest = String::new();
        out.read_to_string(&mut rest).unwrap();
        let mut error = String::new();
        child
            .stderr
            .take()
            .unwrap()
            .read_to_string(&mut error)
            .unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(code), "{rest}{error}");
        assert!(format!("{rest}{error}").contains(expected), "{rest}{error}");
    }
}
