//! Broker, servers and agents as processes, and requests to them.

use std::{
    ffi::OsStr,
    fs,
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

use serde_json::Value;

use crate::files::{BENCH, Files};
pub(crate) use crate::under_test::{Answer, Ended, Running, ask, listening, poll};

impl Running {
    /// Ends it with SIGKILL.
    pub(crate) fn kill(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

/// Returns the program of the agent.
pub(crate) fn fleet_program() -> PathBuf {
    env!("CARGO_BIN_EXE_eis-fleet").into()
}

/// Returns the program of the server, which another package of the workspace builds.
pub(crate) fn bench_program() -> PathBuf {
    let path = fleet_program().with_file_name("eis-bench");
    assert!(
        path.is_file(),
        "{}: expected eis-bench; `cargo build --workspace --bins` builds it",
        path.display()
    );
    path
}

/// Runs a program to its end.
pub(crate) fn run<S: AsRef<OsStr>>(program: &Path, arguments: &[S]) -> Ended {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null());
    Ended::of(command.output().unwrap())
}

/// A broker, and its address.
pub(crate) struct Broker {
    process: Running,
    folder: PathBuf,
    port: String,
}

impl Broker {
    /// Starts a broker, or returns `None` if the program is not installed.
    pub(crate) fn start(folder: PathBuf) -> Option<Self> {
        let bound = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = bound.local_addr().unwrap().port().to_string();
        drop(bound);
        match Self::spawn(&folder, &port) {
            Ok(child) => Some(Self {
                process: Running(child),
                folder,
                port,
            }),
            Err(error) => {
                eprintln!("skipped: nats-server cannot be started: {error}");
                None
            }
        }
    }

    fn spawn(folder: &Path, port: &str) -> std::io::Result<Child> {
        Command::new("nats-server")
            .args(["-js", "-a", "127.0.0.1", "-p", port, "-sd"])
            .arg(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
    }

    pub(crate) fn kill(&mut self) {
        self.process.kill();
    }

    pub(crate) fn restart(&mut self) {
        self.process = Running(Self::spawn(&self.folder, &self.port).unwrap());
    }

    pub(crate) fn address(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }

    /// Runs a command of `eis-fleet`.
    pub(crate) fn ask(&self, more: &[&str]) -> Ended {
        let address = self.address();
        let head = ["--fleet", "lab", "--server", &address, "--json"];
        run(&fleet_program(), &[&head[..], more].concat())
    }

    /// Runs a command of `eis-fleet` and returns its answer.
    #[track_caller]
    pub(crate) fn fleet(&self, more: &[&str]) -> Value {
        self.ask(more).json()
    }

    /// Returns a job as it is on record.
    pub(crate) fn job(&self, job: &str) -> Value {
        let status = self.fleet(&["status", "--all"]);
        let listed = status["listed"].as_array().unwrap();
        listed.iter().find(|one| one["job"] == job).unwrap().clone()
    }

    /// Waits until a job is in a state, and returns it.
    #[track_caller]
    pub(crate) fn wait_for(&self, job: &str, state: &str) -> Value {
        poll(&format!("{job} {state}"), || {
            let found = self.job(job);
            (found["state"] == state).then_some(found)
        })
    }

    /// Submits the experiment of these files, and returns the first job.
    pub(crate) fn submit(&self, files: &Files, more: &[&str]) -> String {
        let experiment = files.path(crate::files::EXPERIMENT);
        let arguments = ["submit", experiment.to_str().unwrap()];
        let submitted = self.fleet(&[&arguments[..], more].concat());
        submitted["jobs"][0].as_str().unwrap().to_owned()
    }

    /// Returns the bench of a site.
    pub(crate) fn bench(&self, site: &str) -> Option<Value> {
        let status = self.fleet(&["status"]);
        let mut benches = status["benches"].as_array()?.iter();
        benches.find(|one| one["site"] == site).cloned()
    }

    /// Waits until the bench of a site is in a state.
    #[track_caller]
    pub(crate) fn wait_for_bench(&self, site: &str, state: &str) -> Value {
        poll(&format!("a bench of {site} that is {state}"), || {
            self.bench(site).filter(|one| one["state"] == state)
        })
    }
}

/// A program that listens on a port of this machine, and prints its address first.
pub(crate) struct Served {
    pub(crate) process: Running,
    pub(crate) address: String,
}

impl Served {
    fn start(program: &Path, arguments: &[&OsStr]) -> Self {
        let mut command = Command::new(program);
        command.args(arguments);
        let (process, address) = listening(command);
        Self { process, address }
    }

    /// Sends a request with more lines in its head.
    pub(crate) fn ask(&self, request: &str, more: &str, body: &str) -> Answer {
        ask(&self.address, request, more, body)
    }

    #[track_caller]
    pub(crate) fn get(&self, path: &str) -> Value {
        self.ask(&format!("GET /api/v1{path}"), "", "")
            .expect(200)
            .json()
    }

    pub(crate) fn post(&self, path: &str, body: &str) -> Answer {
        self.ask(&format!("POST /api/v1{path}"), "", body)
    }
}

/// Starts the server of these files; on its old port, if there is one.
pub(crate) fn serve(files: &Files) -> Served {
    serve_with(files, "")
}

/// Starts the server of these files, with more sections in its file.
pub(crate) fn serve_with(files: &Files, more: &str) -> Served {
    let port = fs::read_to_string(files.path("port")).unwrap_or_default();
    let listen = if port.is_empty() {
        "127.0.0.1:0"
    } else {
        &port
    };
    let text = format!(
        "listen = {listen:?}\ndata = \"data\"\nconfigs = \".\"\nbenches = [\"{BENCH}\"]\n\
        [limits]\nrequests_per_s = 1000\nburst = 2000\n{more}"
    );
    files.write("serve.toml", &text);
    let config = files.path("serve.toml");
    let served = Served::start(&bench_program(), &["serve".as_ref(), config.as_os_str()]);
    files.write("port", &served.address);
    served
}

/// Makes a token of the server of these files.
pub(crate) fn token(files: &Files, name: &str, scopes: &str) -> String {
    let config = files.path("serve.toml");
    let config = config.to_str().unwrap();
    let made = run(
        &bench_program(),
        &["token", "add", config, name, "--scope", scopes],
    );
    made.expect_code(0).stdout.trim().to_owned()
}

/// Writes the file of an agent beside a server, with more keys.
pub(crate) fn write_agent(files: &Files, broker: &Broker, site: &str, bench_server: &str) {
    let address = broker.address();
    let text = format!(
        "name = \"lab\"\nsite = \"{site}\"\nserver = \"{address}\"\nlease = \"3 s\"\n\
        data = \"agent\"\nlisten = \"127.0.0.1:0\"\nbench_server = \"http://{bench_server}\"\n"
    );
    files.write("fleet.toml", &text);
}

/// Starts the agent of these files.
pub(crate) fn start_agent(files: &Files) -> Served {
    let config = files.path("fleet.toml");
    Served::start(&fleet_program(), &["agent".as_ref(), config.as_os_str()])
}

/// A server with its agent, in a fleet.
pub(crate) struct Site {
    pub(crate) files: Files,
    pub(crate) server: Served,
    pub(crate) agent: Served,
}

impl Site {
    /// Starts both, and waits until the bench may take a job.
    #[track_caller]
    pub(crate) fn start(files: Files, broker: &Broker, site: &str) -> Self {
        let server = serve(&files);
        write_agent(&files, broker, site, &server.address);
        let agent = start_agent(&files);
        broker.wait_for_bench(site, "idle");
        Self {
            files,
            server,
            agent,
        }
    }
}
