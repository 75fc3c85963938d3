//! A server as a process, and a client that sends HTTP byte by byte, so that it can also send
//! invalid requests.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    net::TcpStream,
    path::PathBuf,
    process::{Command, Stdio},
    time::Duration,
};

use crate::{
    support::{Files, Running, command, poll, program},
    under_test::{ask, listening, send},
};

pub(crate) use crate::under_test::{Answer, answer};

/// A server on a port of this machine.
pub(crate) struct Served {
    pub(crate) process: Running,
    pub(crate) address: String,
}

/// Writes a server's file beside altered copies of the demo's, with more sections behind it.
pub(crate) fn config(files: &Files, more: &str) -> PathBuf {
    let text = format!(
        "listen = \"127.0.0.1:0\"\ndata = \"data\"\nconfigs = \".\"\n\
        benches = [\"benches/demo.toml\"]\n{more}\n"
    );
    files.write("serve.toml", &text);
    files.path("serve.toml")
}

/// Makes a token.
pub(crate) fn token(files: &Files, name: &str, scope: &str) -> String {
    let config = files.path("serve.toml");
    let arguments = [
        "token".as_ref(),
        "add".as_ref(),
        config.as_os_str(),
        name.as_ref(),
        "--scope".as_ref(),
        scope.as_ref(),
    ];
    program(&arguments).expect_code(0).stdout.trim().to_owned()
}

impl Served {
    /// Starts a server with the file that [`config`] wrote.
    pub(crate) fn start(files: &Files) -> Self {
        Self::start_with(files, &[])
    }

    pub(crate) fn start_with(files: &Files, environment: &[(&str, &str)]) -> Self {
        let config = files.path("serve.toml");
        let mut command = command(&["serve".as_ref(), config.as_os_str()]);
        command.envs(environment.iter().copied());
        Self::start_by(command)
    }

    /// Starts it in a shell after these commands, such as `umask 0`.
    pub(crate) fn start_after(files: &Files, words: &str) -> Self {
        let mut command = Command::new("sh");
        command
            .args([
                "-c",
                &format!("{words}; exec \"$@\""),
                "sh",
                env!("CARGO_BIN_EXE_eis-bench"),
                "serve",
            ])
            .arg(files.path("serve.toml"));
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        Self::start_by(command)
    }

    fn start_by(mut command: Command) -> Self {
        command.stderr(Stdio::inherit());
        let (process, address) = listening(command);
        Self { process, address }
    }

    pub(crate) fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    pub(crate) fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(120)))
            .unwrap();
        stream
    }

    /// Sends bytes as they are and reads to the end of the connection.
    pub(crate) fn raw(&self, request: &[u8]) -> Answer {
        send(&self.address, request)
    }

    pub(crate) fn ask(&self, method: &str, path: &str, (token, body): (&str, &str)) -> Answer {
        let token = match token {
            "" => String::new(),
            token => format!("Authorization: Bearer {token}\r\n"),
        };
        ask(&self.address, &format!("{method} {path}"), &token, body)
    }

    pub(crate) fn get(&self, path: &str) -> serde_json::Value {
        self.ask("GET", &format!("/api/v1{path}"), ("", ""))
            .expect(200)
            .json()
    }

    pub(crate) fn post(&self, path: &str, body: &str) -> Answer {
        self.ask("POST", &format!("/api/v1{path}"), ("", body))
    }

    /// Waits for the end of a run and returns it.
    pub(crate) fn ended(&self, run: &str) -> serde_json::Value {
        poll(&format!("the end of {run}"), || {
            let jobs = self.get("/runs");
            let job = jobs
                .as_array()
                .unwrap()
                .iter()
                .find(|job| job["item"]["run"] == run)?;
            Some(job["ended"].clone()).filter(|ended| !ended.is_null())
        })
    }

    /// Waits until a run has this number of points.
    pub(crate) fn points(&self, count: u64) -> serde_json::Value {
        poll(&format!("{count} points"), || {
            let live = self.get("/benches/demo");
            (live["run"]["points_done"].as_u64()? >= count).then_some(live)
        })
    }

    /// Connects a listener to the events.
    pub(crate) fn listen(&self, more: &str) -> Events {
        let mut stream = self.connect();
        write!(
            stream,
            "GET /api/v1/events HTTP/1.1\r\nHost: {}\r\n{more}\r\n",
            self.address
        )
        .unwrap();
        let mut reader = BufReader::new(stream);
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            assert!(reader.read_line(&mut head).unwrap() > 0, "{head}");
        }
        assert!(head.starts_with("HTTP/1.1 200"), "{head}");
        Events(reader)
    }
}

/// Events as they come.
pub(crate) struct Events(BufReader<TcpStream>);

impl Iterator for Events {
    /// Name, kind and data.
    type Item = (String, String, serde_json::Value);

    fn next(&mut self) -> Option<Self::Item> {
        let (mut id, mut kind) = (String::new(), String::new());
        loop {
            let mut line = String::new();
            // Lengths of chunks and blank lines between them are passed over.
            if self.0.read_line(&mut line).ok()? == 0 {
                return None;
            }
            let line = line.trim_end();
            if let Some(text) = line.strip_prefix("id: ") {
                id = text.to_owned();
            } else if let Some(text) = line.strip_prefix("event: ") {
                kind = text.to_owned();
            } else if let Some(text) = line.strip_prefix("data: ") {
                return Some((id, kind, serde_json::from_str(text).unwrap()));
            }
        }
    }
}

/// Sends one request over a separate connection and returns the answer.
pub(crate) fn exchange(address: &str, method: &str, path: &str, body: &str) -> Answer {
    ask(address, &format!("{method} {path}"), "", body)
}

/// Submits a run to this server and returns its name.
pub(crate) fn submit(served: &Served, body: &str) -> String {
    served.post("/queue", body).expect(201).json()["run"]
        .as_str()
        .unwrap()
        .to_owned()
}

/// Returns the text of a file in the server's data folder.
pub(crate) fn data(files: &Files, name: &str) -> String {
    fs::read_to_string(files.path("data").join(name))
        .unwrap_or_else(|error| panic!("{name}: {error}"))
}
