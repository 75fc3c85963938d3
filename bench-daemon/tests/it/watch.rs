//! The watch beside a procedure, with real processes and sockets: currents that no step reads are
//! detected in every wait, and outages shorter than the retry time of safe state do not end a run.

use std::{
    fs,
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use analysis::dataset::read_spectrum_csv;

use crate::{
    kill::{end, start, wait_for_points},
    support::{BENCH, EXPERIMENT, Files, Ports, poll},
};

/// Bench seconds per second.
const FACTOR: f64 = 10.0;

/// Adds another client that acts once, at the first message after `from`.
fn with_foreign_hand(files: &Files, role: &str, variant: usize, from: &str) {
    let faults = format!(
        "[simulation.faults]\nseed = 1\nper_message = 1.0\nmost = 1\nkinds = [\"second_client\"]\n\
        role = \"{role}\"\nvariant = {variant}\nfrom = \"{from}\""
    );
    files.write(BENCH, &format!("{}\n{faults}\n", files.text(BENCH)));
}

/// Returns files with a temperature step whose target the cell never reaches, and a sweep after it.
fn holding() -> Files {
    Files::demo()
        .without(EXPERIMENT, "soc_reset")
        .without(EXPERIMENT, "fixture_check")
        .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"100 Hz\"")
        .edit(EXPERIMENT, "points = 20", "points = 2")
        .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]")
}

#[test]
fn a_current_is_seen_while_the_procedure_reads_the_thermometer_alone() {
    for (role, variant, what) in [
        ("load", 1, "current of the load"),
        ("supply", 1, "current of the charger"),
    ] {
        let files = holding();
        with_foreign_hand(&files, role, variant, "20 s");
        let ports = Ports::serve(&files, FACTOR, 1);
        let ended = files.run("run");
        ended.expect_code(5);
        assert!(ended.message().contains(what), "{}", ended.message());
        ports.assert_outputs_off();
        let witness = ports.world.lock().unwrap().witness();
        // 2 A for less than the three seconds that the watch may take, and for a machine under load.
        assert!(witness.throughput_coulomb < 20.0, "{role}: {witness:?}");
    }
}

/// A proxy between the program and an instrument; it can cut the wire, and delay answers.
#[derive(Default)]
struct Wire {
    is_cut: AtomicBool,
    late_ms: AtomicU64,
}

impl Wire {
    fn before(files: &Files, role: &str) -> Arc<Self> {
        let (instrument, listener) = files.stand_before(role);
        let wire = Arc::new(Self::default());
        let shared = wire.clone();
        std::thread::spawn(move || accept(&listener, &instrument, &shared));
        wire
    }

    fn set_cut(&self, cut: bool) {
        self.is_cut.store(cut, Ordering::SeqCst);
    }

    fn set_late(&self, late: Duration) {
        let late_ms = u64::try_from(late.as_millis()).unwrap();
        self.late_ms.store(late_ms, Ordering::SeqCst);
    }
}

fn accept(listener: &TcpListener, instrument: &str, wire: &Arc<Wire>) {
    for client in listener.incoming() {
        let (Ok(client), false) = (client, wire.is_cut.load(Ordering::SeqCst)) else {
            continue;
        };
        let Ok(server) = TcpStream::connect(instrument) else {
            continue;
        };
        let (asks, hears) = (client.try_clone().unwrap(), server.try_clone().unwrap());
        let (there, back) = (wire.clone(), wire.clone());
        std::thread::spawn(move || carry(asks, hears, &there, false));
        std::thread::spawn(move || carry(server, client, &back, true));
    }
}

/// Carries bytes until either side closes or the wire is cut.
fn carry(mut from: TcpStream, mut to: TcpStream, wire: &Wire, answers: bool) {
    from.set_read_timeout(Some(Duration::from_millis(20)))
        .unwrap();
    let mut buffer = [0; 65536];
    while !wire.is_cut.load(Ordering::SeqCst) {
        match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => {
                if answers {
                    pause(Duration::from_millis(wire.late_ms.load(Ordering::SeqCst)));
                }
                if to.write_all(&buffer[..count]).is_err() {
                    break;
                }
            }
            Err(error)
                if matches!(
                    error.kind(),
                    std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut
                ) => {}
            Err(_) => break,
        }
    }
    let _ = from.shutdown(std::net::Shutdown::Both);
    let _ = to.shutdown(std::net::Shutdown::Both);
}

#[test]
fn a_drive_that_answers_too_late_ends_the_current_and_the_run_waits_until_it_is_in_time() {
    let files = Files::short(6);
    let ports = Ports::serve(&files, FACTOR, 1);
    let wire = Wire::before(&files, "supply4q");
    let run = files.path("late");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 2));
    wire.set_late(Duration::from_millis(700));
    // In scaled time the wait of five seconds is over after half a second; up to now the answers
    // are late.
    pause(Duration::from_secs(5));
    wire.set_late(Duration::ZERO);
    let (code, text) = end(child);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("expected an answer within 0.45 s"), "{text}");
    assert_eq!(text.matches("going on by itself").count(), 1, "{text}");
    assert_eq!(
        read_spectrum_csv(&run.join("spectrum.csv")).unwrap().len(),
        6
    );
    ports.assert_outputs_off();
}

#[test]
fn an_outage_of_seven_seconds_ends_no_run() {
    for role in ["supply4q", "supply"] {
        let files = Files::short(6);
        let ports = Ports::serve(&files, FACTOR, 1);
        let wire = Wire::before(&files, role);
        let run = files.path("outlived");
        let mut child = start(&files, &run, &[]);
        wait_for_points(&mut child, &run, ("spectrum.csv", 2));
        wire.set_cut(true);
        pause(Duration::from_secs(7));
        wire.set_cut(false);
        let (code, text) = end(child);
        assert_eq!(code, Some(0), "{role}: {text}");
        assert_eq!(
            read_spectrum_csv(&run.join("spectrum.csv")).unwrap().len(),
            6
        );
        ports.assert_outputs_off();
    }
}

#[test]
fn a_run_whose_folder_is_deleted_ends_with_every_output_off() {
    let files = Files::short(12);
    let ports = Ports::serve(&files, FACTOR, 1);
    let run = files.path("deleted");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 1));
    fs::remove_dir_all(&run).unwrap();
    let (code, text) = end(child);
    assert_eq!(code, Some(1), "{text}");
    poll("outputs off", || {
        (ports.world.lock().unwrap().truth_current_a() == 0.0).then_some(())
    });
}

#[expect(
    clippy::disallowed_methods,
    reason = "the wire is cut for seconds of the machine, which no bench time counts"
)]
fn pause(time: Duration) {
    std::thread::sleep(time);
}
