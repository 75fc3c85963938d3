//! Helpers of several tests: altered copies of the demo's files, the program as a process, and
//! simulated instruments on real ports whose world the test can inspect.

use std::{
    ffi::OsStr,
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{Arc, Mutex, mpsc},
    thread::JoinHandle,
    time::Duration,
};

use analysis::spectrum::ImpedancePoint;
use bench_core::sim::Simulation;
use bench_plan::config::{Experiment, load_bench, load_experiment};
use fixtures::SimulatedBench;
use instruments::{
    clock::{Clock, TimeMode},
    fixture::Fixture,
    transcript::{Direction, Payload, Transcript},
};

pub(crate) use crate::under_test::{Ended, Files, Running, files_below, poll};

pub(crate) const EXPERIMENT: &str = "experiments/demo.toml";
pub(crate) const BENCH: &str = "benches/demo.toml";
pub(crate) const CELL: &str = "cells/p45b.toml";
pub(crate) const SCENARIO: &str = "scenarios/p45b.toml";

/// Returns the demo's files as they are in the tree.
pub(crate) fn demo() -> PathBuf {
    crate::configuration::configs().join(EXPERIMENT)
}

impl Files {
    pub(crate) fn demo() -> Self {
        let configs = crate::configuration::configs();
        Self::copies(&configs, &[EXPERIMENT, BENCH, CELL, SCENARIO])
    }

    /// Fixture check, SOC reset and sweep with a few points from 100 Hz to 300 Hz, one fit.
    pub(crate) fn brief(points: usize) -> Self {
        Self::demo()
            .without(EXPERIMENT, "temperature")
            .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"100 Hz\"")
            .edit(EXPERIMENT, "points = 20", &format!("points = {points}"))
            .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]")
    }

    /// Returns the demo without the reset: the cell keeps its charge.
    pub(crate) fn short(points: usize) -> Self {
        Self::brief(points).without(EXPERIMENT, "soc_reset")
    }

    /// Puts a listener in front of an instrument on a TCP port; returns the instrument's original
    /// address and the listener.
    pub(crate) fn stand_before(&self, role: &str) -> (String, TcpListener) {
        let (bench, _) = load_bench(&self.path(BENCH)).unwrap();
        let addressed = bench.instruments.addressed();
        let address = addressed
            .iter()
            .find(|(name, _)| *name == role)
            .unwrap()
            .1
            .address
            .to_string();
        let instrument = address.strip_prefix("tcp://").unwrap().to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        self.write(
            BENCH,
            &self
                .text(BENCH)
                .replace(&instrument, &listener.local_addr().unwrap().to_string()),
        );
        (instrument, listener)
    }

    pub(crate) fn experiment(&self) -> PathBuf {
        self.path(EXPERIMENT)
    }

    /// Runs the experiment as another process into a folder beside the files.
    pub(crate) fn run(&self, out: &str) -> Ended {
        program(&[
            "run".as_ref(),
            self.experiment().as_os_str(),
            "--out".as_ref(),
            self.path(out).as_os_str(),
        ])
    }

    pub(crate) fn load(&self) -> Experiment {
        load_experiment(&self.experiment(), None).unwrap()
    }
}

/// Returns a command of the program, without a person at the terminal.
pub(crate) fn command<A: AsRef<OsStr>>(arguments: &[A]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_eis-bench"));
    command
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// Runs the program to its end.
pub(crate) fn program<A: AsRef<OsStr>>(arguments: &[A]) -> Ended {
    Ended::of(command(arguments).output().unwrap())
}

/// Runs the program to its end in a folder.
pub(crate) fn program_in<A: AsRef<OsStr>>(folder: &Path, arguments: &[A]) -> Ended {
    Ended::of(command(arguments).current_dir(folder).output().unwrap())
}

/// Returns the path of a file of the project.
pub(crate) fn project(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path);
    path.to_str().unwrap().to_owned()
}

/// Returns a file or folder of measured data, which stand in a folder `shared` beside the project,
/// or `None` with a message if it is not there.
pub(crate) fn shared_data(name: &str) -> Option<PathBuf> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let path = data.join(name);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: no measured data in {}", path.display());
    None
}

/// The simulated instruments of a bench in another process.
pub(crate) struct MockProcess {
    _process: Running,
    /// Its line of JSON.
    pub(crate) line: serde_json::Value,
}

impl MockProcess {
    /// Starts `eis-bench mock`, which writes a bench file with its addresses to `written`.
    pub(crate) fn start(bench: &Path, written: &Path, timing: (&str, u64)) -> Self {
        Self::start_over(bench, written, timing, &[])
    }

    /// Starts them with instruments behind other transports than their addresses name.
    pub(crate) fn start_over(
        bench: &Path,
        written: &Path,
        (time, seed): (&str, u64),
        over: &[&str],
    ) -> Self {
        let (bench, written, seed) = (bench.as_os_str(), written.as_os_str(), seed.to_string());
        let mut command = command(&[
            "mock".as_ref(),
            bench,
            "--time".as_ref(),
            time.as_ref(),
            "--json".as_ref(),
            "--write-bench".as_ref(),
            written,
            "--seed".as_ref(),
            seed.as_ref(),
        ]);
        for over in over {
            command.args(["--over", over]);
        }
        let mut process = Running(command.stderr(Stdio::inherit()).spawn().unwrap());
        let mut text = String::new();
        BufReader::new(process.0.stdout.as_mut().unwrap())
            .read_line(&mut text)
            .unwrap();
        Self {
            _process: process,
            line: serde_json::from_str(&text).unwrap(),
        }
    }

    pub(crate) fn address(&self, role: &str) -> String {
        self.line["addresses"][role].as_str().unwrap().to_owned()
    }
}

/// The simulated instruments of a bench on real ports, served by a thread of this process, so that
/// a test can inspect the true state of the cell while the program under test knows only
/// addresses.
pub(crate) struct Ports {
    pub(crate) world: Arc<Mutex<SimulatedBench>>,
    addresses: Vec<(&'static str, String)>,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Ports {
    /// Serves the bench of `files` at a multiple of real time and writes the addresses into the
    /// bench file.
    pub(crate) fn serve(files: &Files, factor: f64, seed: u64) -> Self {
        let (bench, _) = load_bench(&files.path(BENCH)).unwrap();
        let mode = TimeMode::Scaled(factor);
        let quirks = bench
            .simulation
            .as_ref()
            .map(|simulation| simulation.quirks.clone())
            .unwrap_or_default();
        let faults = bench
            .simulation
            .as_ref()
            .and_then(|simulation| simulation.faults.clone());
        let simulation = Simulation::new(&files.path(SCENARIO), seed)
            .unwrap()
            .with_quirks(quirks)
            .with_faults(faults);
        let world = simulation.world().clone();
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let (tell, receiver) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            Clock::runtime(mode).unwrap().block_on(async {
                let clock = Clock::start(mode);
                let served = simulation
                    .serve_on_ports(&bench, &[], &clock)
                    .await
                    .unwrap();
                tell.send(
                    served
                        .into_iter()
                        .map(|mock| (mock.role, mock.address))
                        .collect(),
                )
                .unwrap();
                let _ = stopped.await;
            });
        });
        let addresses: Vec<(&'static str, String)> = receiver.recv().unwrap();
        let mut text = files
            .text(BENCH)
            .replace("[simulation]", &format!("[simulation]\ntime = \"{mode}\""));
        for (role, address) in &addresses {
            text = text.replace(&format!("\"memory:{role}\""), &format!("{address:?}"));
        }
        files.write(BENCH, &text);
        Self {
            world,
            addresses,
            stop: Some(stop),
            thread: Some(thread),
        }
    }

    /// Sends one query to an instrument over a separate connection. Instruments accept one client
    /// at a time, so no other client may be connected.
    pub(crate) fn ask(&self, role: &str, question: &str) -> String {
        ask(self.address(role), question)
    }

    /// Returns the host and port of an instrument.
    pub(crate) fn address(&self, role: &str) -> &str {
        self.addresses
            .iter()
            .find(|(name, _)| *name == role)
            .unwrap()
            .1
            .strip_prefix("tcp://")
            .unwrap()
    }

    /// Asserts that every output that can move charge is reported as off.
    #[track_caller]
    pub(crate) fn assert_outputs_off(&self) {
        assert_eq!(self.ask("supply4q", "OUTP?"), "0");
        assert!(
            self.ask("generator", "C1:OUTP?")
                .starts_with("C1:OUTP OFF,")
        );
        assert_eq!(self.ask("load", ":INP?"), "0");
        let status = self.ask("supply", "SYST:STAT?");
        let bits = u32::from_str_radix(status.trim_start_matches("0x"), 16).unwrap();
        assert_eq!(bits & 0x10, 0, "channel 1 of the supply is on: {status}");
        assert_eq!(self.world.lock().unwrap().truth_current_a(), 0.0);
    }
}

impl Drop for Ports {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Sends one query over a new connection and returns the answer.
pub(crate) fn ask(address: &str, question: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    stream
        .write_all(format!("{question}\n").as_bytes())
        .unwrap();
    let mut answer = Vec::new();
    let mut byte = [0_u8];
    while byte[0] != b'\n' {
        assert_eq!(
            stream.read(&mut byte).unwrap(),
            1,
            "{address} closed the connection instead of answering {question}"
        );
        answer.push(byte[0]);
    }
    String::from_utf8(answer).unwrap().trim().to_owned()
}

/// Returns the impedance of the true cell at the present moment.
pub(crate) fn truth(
    world: &Mutex<SimulatedBench>,
    points: &[ImpedancePoint],
) -> Vec<num_complex::Complex64> {
    let world = world.lock().unwrap();
    points
        .iter()
        .map(|point| world.truth_impedance(Fixture::Cell, point.freq_hz))
        .collect()
}

/// Returns the transcript of one instrument of a run.
pub(crate) fn transcript(run: &Path, role: &str) -> Transcript {
    let path = run.join("transcripts").join(format!("{role}.txt"));
    let text =
        fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    Transcript::parse(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns the messages that were sent to one instrument of a run.
pub(crate) fn sent(run: &Path, role: &str) -> Vec<String> {
    transcript(run, role)
        .records
        .into_iter()
        .filter(|record| record.direction == Direction::Sent)
        .map(|record| match record.payload {
            Payload::Text(text) => text,
            Payload::Block(block) => block.prefix,
        })
        .collect()
}

/// Returns the JSON of a run's file.
pub(crate) fn json(path: &Path) -> serde_json::Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap())
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
