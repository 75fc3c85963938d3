//! A folder with files of the simulated bench, and the programs `eis-bench` and `eis-archive`.

use std::{
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use serde_json::Value;

pub(crate) use crate::under_test::Files;
use crate::under_test::{Answer, Ended, Running, ask, listening};

const EXPERIMENT: &str = "experiments/demo.toml";

/// A server.
pub(crate) struct Served {
    _process: Running,
    address: String,
}

impl Files {
    /// Writes the files of the simulated bench, with three points and without the reset of the
    /// charge.
    pub(crate) fn new() -> Self {
        let files = Self::copies(Path::new("."), &[]);
        let folder = files.path("");
        bench(&["config".as_ref(), "new".as_ref(), folder.as_os_str()]).expect_code(0);
        fs::create_dir(files.path("data")).unwrap();
        files
            .without(EXPERIMENT, "soc_reset")
            .edit(EXPERIMENT, "points = 20", "points = 3")
            .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]")
    }

    /// Runs the experiment into a folder.
    pub(crate) fn run(&self, out: &str) {
        let (experiment, out) = (self.path(EXPERIMENT), self.path(out));
        bench(&[
            "run".as_ref(),
            experiment.as_os_str(),
            "--out".as_ref(),
            out.as_os_str(),
        ])
        .expect_code(0);
    }

    /// Writes the file of a server, with more sections behind it.
    pub(crate) fn write_server(&self, more: &str) -> PathBuf {
        self.write(
            "serve.toml",
            &format!(
                "listen = \"127.0.0.1:0\"\ndata = \"data\"\nconfigs = \".\"\n\
                benches = [\"benches/demo.toml\"]\n{more}\n"
            ),
        );
        self.path("serve.toml")
    }
}

impl Served {
    /// Starts a server with the file that [`Files::write_server`] wrote.
    pub(crate) fn start(files: &Files) -> Self {
        let mut command = Command::new(bench_program());
        command.arg("serve").arg(files.path("serve.toml"));
        command.stderr(Stdio::null());
        let (_process, address) = listening(command);
        Self { _process, address }
    }

    /// Sends a request.
    pub(crate) fn ask(&self, method: &str, path: &str, body: &str) -> Answer {
        ask(&self.address, &format!("{method} {path}"), "", body)
    }

    /// State of the archive; `None` before one has written it.
    pub(crate) fn archive(&self) -> Option<Value> {
        let answer = self.ask("GET", "/api/v1/archive", "");
        (answer.status == 200).then(|| answer.json())
    }
}

/// Path of `eis-bench`, which `cargo test --workspace` builds beside `eis-archive`.
fn bench_program() -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_eis-archive")).with_file_name("eis-bench");
    assert!(
        program.is_file(),
        "{}: build it with --workspace",
        program.display()
    );
    program
}

/// Runs `eis-bench`.
pub(crate) fn bench(arguments: &[&OsStr]) -> Ended {
    let mut command = Command::new(bench_program());
    command.args(arguments).stdin(Stdio::null());
    Ended::of(command.output().unwrap())
}
