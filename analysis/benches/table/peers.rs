//! Runs `benches/peers/peers.py` and reads its lines.

use std::path::PathBuf;
use std::process::{Command, Stdio};

/// A figure of another program.
#[derive(Debug, Clone)]
pub(crate) struct Peer {
    /// The work, as ours names it.
    pub(crate) work: String,
    /// Which program.
    pub(crate) name: String,
    /// The figure, in the unit of ours.
    pub(crate) value: f64,
}

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../benches/peers")
}

/// Returns the Python to use: from the environment, or the one beside the script.
fn python() -> Option<PathBuf> {
    let named = std::env::var_os("EIS_BENCH_PEERS_PYTHON").map(PathBuf::from);
    let beside = folder().join(".venv/bin/python");
    named.or_else(|| beside.exists().then_some(beside))
}

/// Returns a hint how to install the peers, or `None` if they are installed.
pub(crate) fn hint() -> Option<String> {
    let line = "\nThe peers are not installed. To see them beside us (Python 3.11 and network \
    needed):\n  \
                python3 -m venv benches/peers/.venv && benches/peers/.venv/bin/pip install -r \
                benches/peers/requirements.txt";
    python().is_none().then(|| line.to_owned())
}

/// Returns the peers of one group; empty if they are not installed or fail.
pub(crate) fn run(group: &str) -> Vec<Peer> {
    let Some(python) = python() else {
        return Vec::new();
    };
    let output = Command::new(python)
        .arg(folder().join("peers.py"))
        .arg(group)
        .stderr(Stdio::null())
        .output();
    let Ok(output) = output else {
        return Vec::new();
    };
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    text.lines().filter_map(peer).collect()
}

fn peer(line: &str) -> Option<Peer> {
    let value: serde_json::Value = serde_json::from_str(line).ok()?;
    let figure = ["seconds", "samples_per_cpu_s", "steps_per_cpu_s"]
        .iter()
        .find_map(|key| value[key].as_f64())?;
    Some(Peer {
        work: value["work"].as_str()?.to_owned(),
        name: value["peer"].as_str()?.to_owned(),
        value: figure,
    })
}
