//! A folder with files of the simulated bench, and the programs `eis-bench` and `eis-archive`.

use std::{
    ffi::OsStr,
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
};

use instruments_link::clock::{Clock, TimeMode};
use serde_json::Value;
use tempfile::TempDir;

/// Longest time that a test waits for something, s.
const PATIENCE_S: f64 = 120.0;

/// Runs of the demo with few points, in a temporary folder.
pub(crate) struct Files {
    folder: TempDir,
}

/// Result of a program.
pub(crate) struct Ended {
    code: Option<i32>,
    pub(crate) stdout: String,
    stderr: String,
}

/// A process that ends with the test.
pub(crate) struct Running(Child);

/// A server.
pub(crate) struct Served {
    _process: Running,
    address: String,
}

impl Files {
    /// Writes the files of the simulated bench, with three points and without the reset of the
    /// charge.
    pub(crate) fn new() -> Self {
        let files = Self {
            folder: TempDir::new().unwrap(),
        };
        let folder = files.path("");
        bench(&["config".as_ref(), "new".as_ref(), folder.as_os_str()]).expect_code(0);
        let experiment = files.path("experiments/demo.toml");
        let text = fs::read_to_string(&experiment).unwrap();
        let mut kept = Vec::new();
        let mut is_reset = false;
        for line in text.lines() {
            if line.starts_with('[') {
                is_reset = line.starts_with("[soc_reset");
            }
            match is_reset {
                true => {}
                false if line.starts_with("points = ") => kept.push("points = 3"),
                false if line.starts_with("rc = ") => kept.push("rc = [1]"),
                false => kept.push(line),
            }
        }
        assert!(
            kept.contains(&"points = 3") && kept.len() < text.lines().count(),
            "{text}"
        );
        fs::write(experiment, kept.join("\n")).unwrap();
        fs::create_dir(files.path("data")).unwrap();
        files
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    /// Runs the experiment into a folder.
    pub(crate) fn run(&self, out: &str) {
        let (experiment, out) = (self.path("experiments/demo.toml"), self.path(out));
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

impl Ended {
    pub(crate) fn of(command: &mut Command) -> Self {
        let output = command.stdin(Stdio::null()).output().unwrap();
        Self {
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    #[track_caller]
    pub(crate) fn expect_code(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{}{}", self.stdout, self.stderr);
        self
    }

    /// Last line of the standard error.
    pub(crate) fn message(&self) -> &str {
        self.stderr.lines().last().unwrap_or_default()
    }
}

impl Running {
    pub(crate) fn start(command: &mut Command) -> Self {
        Self(command.stdin(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Served {
    /// Starts a server with the file that [`Files::write_server`] wrote.
    pub(crate) fn start(files: &Files) -> Self {
        let mut command = Command::new(bench_program());
        command.arg("serve").arg(files.path("serve.toml"));
        let mut process = Running::start(command.stdout(Stdio::piped()).stderr(Stdio::null()));
        let mut lines = BufReader::new(process.0.stdout.take().unwrap()).lines();
        let address = lines.find_map(|line| {
            let line = line.unwrap();
            let url = line.strip_prefix("listening on http://")?;
            Some(url.split('/').next().unwrap().to_owned())
        });
        // The server must always find a reader.
        thread::spawn(move || lines.for_each(drop));
        Self {
            _process: process,
            address: address.unwrap(),
        }
    }

    /// Sends a request; returns status and body.
    pub(crate) fn ask(&self, method: &str, path: &str, body: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        let length = body.len();
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\
            Content-Type: application/json\r\nContent-Length: {length}\r\n\r\n{body}",
            self.address
        );
        stream.write_all(head.as_bytes()).unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, body.to_owned())
    }

    /// State of the archive; `None` before one has written it.
    pub(crate) fn archive(&self) -> Option<Value> {
        match self.ask("GET", "/api/v1/archive", "") {
            (200, body) => Some(serde_json::from_str(&body).unwrap()),
            _ => None,
        }
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
    Ended::of(Command::new(bench_program()).args(arguments))
}

/// Repeats a query until there is an answer.
#[track_caller]
pub(crate) fn poll<T>(what: &str, mut query: impl FnMut() -> Option<T>) -> T {
    let runtime = Clock::runtime(TimeMode::Real).unwrap();
    let clock = Clock::start(TimeMode::Real);
    while clock.now_s() < PATIENCE_S {
        if let Some(answer) = query() {
            return answer;
        }
        runtime.block_on(clock.sleep_s(0.05));
    }
    panic!("{what}: not within {PATIENCE_S} s");
}

/// Paths of all files below a folder, relative to it.
pub(crate) fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).into_iter().flatten() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false => found.push(path.strip_prefix(folder).unwrap().to_owned()),
            }
        }
    }
    found
}
