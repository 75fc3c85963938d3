//! Duration of a real-time sweep, compared with the physical minimum: 20 points from 10 Hz to 300
//! Hz over sockets. Each point needs 11 periods and a second of settling. A pyvisa script does the
//! same with the same simulated instruments, if Python has pyvisa and numpy (`benches/peers`).
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    missing_docs,
    reason = "a benchmark may end, and prints"
)]

use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

use serde_json::Value;

const PROGRAM: &str = env!("CARGO_BIN_EXE_eis-bench");
const POINTS: usize = 20;
const BAND_HZ: (f64, f64) = (10.0, 300.0);
const PERIODS: f64 = 11.0;
const WAIT_S: f64 = 1.0;
const RUNS: usize = 3;

struct Mocks(Child);

impl Drop for Mocks {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Start and end of a sweep, s of its own clock.
#[derive(Debug, Clone, Copy)]
struct Took {
    /// From the first command of the generator to the last record held.
    measured_s: f64,
    /// To the last point analysed and written.
    recorded_s: f64,
}

fn main() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .to_owned();
    let freqs_hz: Vec<f64> = (0..POINTS)
        .map(|k| BAND_HZ.0 * (BAND_HZ.1 / BAND_HZ.0).powf(k as f64 / (POINTS - 1) as f64))
        .collect();
    let least_s: f64 = freqs_hz.iter().map(|hz| PERIODS / hz + WAIT_S).sum();
    println!(
        "physical minimum, {POINTS} points from {} Hz to {} Hz: {least_s:.3} s",
        BAND_HZ.0, BAND_HZ.1
    );
    for _ in 0..RUNS {
        tell("eis-bench, points overlapping", ours(&root, true), least_s);
    }
    tell(
        "eis-bench, one point after the other",
        ours(&root, false),
        least_s,
    );
    let named = std::env::var_os("EIS_BENCH_PEERS_PYTHON").map(PathBuf::from);
    let python: Vec<PathBuf> = named
        .into_iter()
        .chain([root.join("benches/peers/.venv/bin/python")])
        .collect();
    let able = |python: &&PathBuf| {
        let tried = Command::new(python)
            .args(["-c", "import pyvisa, pyvisa_py, numpy"])
            .stderr(Stdio::null())
            .status();
        tried.is_ok_and(|status| status.success())
    };
    match python.iter().find(able) {
        Some(python) => tell("pyvisa script", peer(&root, python, &freqs_hz), least_s),
        None => println!(
            "pyvisa script: no Python with pyvisa, pyvisa-py and numpy: see \
            benches/peers/requirements.txt"
        ),
    }
}

fn tell(who: &str, took: Took, least_s: f64) {
    let more = |seconds: f64| 100.0 * (seconds / least_s - 1.0);
    let Took {
        measured_s,
        recorded_s,
    } = took;
    println!(
        "{who:<40} {measured_s:7.3} s ({:+.2} %) to the last record, {recorded_s:7.3} s ({:+.2} %) \
        to the last point on disk",
        more(measured_s),
        more(recorded_s)
    );
}

fn mocks(root: &Path, folder: &Path) -> (Mocks, Value) {
    let mut mocks = Mocks(
        Command::new(PROGRAM)
            .arg("mock")
            .arg(root.join("configs/benches/demo.toml"))
            .args(["--time", "real", "--json", "--seed", "1", "--write-bench"])
            .arg(folder.join("bench.toml"))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut line = String::new();
    BufReader::new(mocks.0.stdout.as_mut().unwrap())
        .read_line(&mut line)
        .unwrap();
    (mocks, serde_json::from_str(&line).unwrap())
}

/// Runs the sweep with the daemon and takes the times from its journal.
fn ours(root: &Path, overlap: bool) -> Took {
    let folder = tempfile::tempdir().unwrap();
    let (_mocks, _) = mocks(root, folder.path());
    let experiment = folder.path().join("sweep.toml");
    let cell = root.join("configs/cells/p45b.toml");
    let text = format!(
        "name = \"sweep\"\nbench = \"bench.toml\"\ncell = {cell:?}\nseed = 1\n[eis]\n\
        start = \"{} Hz\"\nstop = \"{} Hz\"\npoints = {POINTS}\n\
         amplitude = \"1 A\"\nperiods = {PERIODS:.0}\nextra_wait = \"{WAIT_S} s\"\n\
         overlap = {overlap}\n[fit]\nrc = [1]\n",
        BAND_HZ.0, BAND_HZ.1
    );
    fs::write(&experiment, text).unwrap();
    let run = folder.path().join("run");
    let output = Command::new(PROGRAM)
        .arg("run")
        .arg(&experiment)
        .arg("--out")
        .arg(&run)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    took(&run)
}

fn took(run: &Path) -> Took {
    let journal = fs::read_to_string(run.join("journal.jsonl")).unwrap();
    let lines: Vec<Value> = journal
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let time_s = |line: &Value| line["time_s"].as_f64().unwrap();
    let first = lines
        .iter()
        .find(|line| {
            line["entry"]["intent"]["text"]
                .as_str()
                .is_some_and(|text| text.starts_with("point"))
        })
        .unwrap();
    let last = lines
        .iter()
        .rfind(|line| line.to_string().contains("\"phasors\""))
        .unwrap();
    let stopped_s = stopped_s(run).unwrap_or_else(|| time_s(last));
    Took {
        measured_s: stopped_s - time_s(first),
        recorded_s: time_s(last) - time_s(first),
    }
}

/// Returns when the scope was last stopped, from its transcript.
fn stopped_s(run: &Path) -> Option<f64> {
    let text = fs::read_to_string(run.join("transcripts/scope.txt")).ok()?;
    let line = text.lines().rfind(|line| line.contains(":TRIGger:STOP"))?;
    line.split_whitespace().find_map(|word| word.parse().ok())
}

/// Runs the sweep with a script of a few dozen lines.
fn peer(root: &Path, python: &Path, freqs_hz: &[f64]) -> Took {
    let folder = tempfile::tempdir().unwrap();
    let (_mocks, line) = mocks(root, folder.path());
    let addresses = serde_json::to_string(&line["addresses"]).unwrap();
    let freqs = serde_json::to_string(freqs_hz).unwrap();
    let script = root.join("benches/peers/sweep.py");
    let output = Command::new(python)
        .arg(script)
        .args([addresses, freqs])
        .stderr(Stdio::inherit())
        .output()
        .unwrap();
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    Took {
        measured_s: found["measured_s"].as_f64().unwrap(),
        recorded_s: found["recorded_s"].as_f64().unwrap(),
    }
}
