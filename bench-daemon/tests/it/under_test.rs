//! Programs under test, their files, and requests to them. Test binaries of several crates include
//! this file.

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    time::Duration,
};

use tempfile::TempDir;

/// Files in a temporary folder, to be altered.
pub(crate) struct Files {
    folder: TempDir,
}

impl Files {
    /// Copies files from another folder.
    pub(crate) fn copies(from: &Path, names: &[&str]) -> Self {
        let files = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        for name in names {
            let path = files.path(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::copy(from.join(name), path).unwrap();
        }
        files
    }

    pub(crate) fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    /// Replaces the first occurrence.
    pub(crate) fn edit(self, name: &str, from: &str, to: &str) -> Self {
        let text = self.text(name);
        assert!(text.contains(from), "{name} does not contain {from:?}");
        self.write(name, &text.replacen(from, to, 1));
        self
    }

    pub(crate) fn append(self, name: &str, more: &str) -> Self {
        self.write(name, &format!("{}\n{more}\n", self.text(name)));
        self
    }

    /// Removes a section and its contents.
    pub(crate) fn without(self, name: &str, section: &str) -> Self {
        let mut inside = false;
        let mut kept = String::new();
        let mut found = false;
        for line in self.text(name).lines() {
            if line.starts_with('[') {
                inside =
                    line == format!("[{section}]") || line.starts_with(&format!("[{section}."));
                found |= inside;
            }
            if !inside {
                kept.push_str(line);
                kept.push('\n');
            }
        }
        assert!(found, "{name} has no section [{section}]");
        self.write(name, &kept);
        self
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

/// How a program ended.
#[derive(Debug)]
pub(crate) struct Ended {
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Ended {
    pub(crate) fn of(output: Output) -> Self {
        Self {
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    #[track_caller]
    pub(crate) fn expect_code(&self, code: i32) -> &Self {
        assert_eq!(
            self.code,
            Some(code),
            "standard output:\n{}\nstandard error:\n{}",
            self.stdout,
            self.stderr
        );
        self
    }

    /// Returns what a program that succeeded printed.
    #[track_caller]
    pub(crate) fn ok(self) -> String {
        self.expect_code(0);
        self.stdout
    }

    /// Returns the JSON that a program that succeeded printed.
    #[track_caller]
    pub(crate) fn json(self) -> serde_json::Value {
        let text = self.ok();
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"))
    }

    /// Returns the message of a program that refused its arguments or files.
    #[track_caller]
    pub(crate) fn refused(self) -> String {
        self.expect_code(2);
        self.stderr
    }

    /// Returns the exit code, the output and the message.
    pub(crate) fn parts(self) -> (i32, String, String) {
        (self.code.unwrap(), self.stdout, self.stderr)
    }

    /// Returns the exit code, and the output with the message.
    pub(crate) fn outcome(self) -> (i32, String) {
        (self.code.unwrap(), self.stdout + &self.stderr)
    }

    /// Returns the message after the name of the program.
    pub(crate) fn message(&self) -> &str {
        let named = |line: &&str| line.starts_with("eis-") && line.contains(": ");
        let line = self.stderr.lines().rev().find(named);
        line.and_then(|line| line.split_once(": "))
            .map_or("", |(_, text)| text)
    }
}

/// A process that does not outlive the test.
pub(crate) struct Running(pub(crate) Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Repeats a query until there is an answer, for at most two minutes.
#[track_caller]
pub(crate) fn poll<T>(what: &str, mut question: impl FnMut() -> Option<T>) -> T {
    for _ in 0..6000 {
        if let Some(answer) = question() {
            return answer;
        }
        nap();
    }
    panic!("{what}: not within two minutes");
}

#[expect(
    clippy::disallowed_methods,
    reason = "another process is waited for, which knows no bench time"
)]
fn nap() {
    std::thread::sleep(Duration::from_millis(20));
}

/// Returns every file below a folder, relative to it, sorted.
pub(crate) fn files_below(folder: &Path) -> Vec<PathBuf> {
    fn walk(folder: &Path, root: &Path, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                walk(&path, root, found);
            } else {
                found.push(path.strip_prefix(root).unwrap().to_owned());
            }
        }
    }
    let mut found = Vec::new();
    walk(folder, folder, &mut found);
    found.sort();
    found
}

/// Starts a program that prints the address at which it listens. Returns both.
pub(crate) fn listening(mut command: Command) -> (Running, String) {
    command.stdin(Stdio::null()).stdout(Stdio::piped());
    let mut process = Running(command.spawn().unwrap());
    let mut line = String::new();
    let stdout = process.0.stdout.as_mut().unwrap();
    BufReader::new(stdout).read_line(&mut line).unwrap();
    let address = line.trim().rsplit_once("//");
    let address = address.unwrap_or_else(|| panic!("{command:?} said {line:?}"));
    (process, address.1.to_owned())
}

/// An answer.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }

    pub(crate) fn text(&self) -> String {
        format!("{} {}", self.status, String::from_utf8_lossy(&self.body))
    }

    #[track_caller]
    pub(crate) fn expect(self, status: u16) -> Self {
        assert_eq!(self.status, status, "{}", self.text());
        self
    }
}

/// Sends a request, with more lines in its head, over a separate connection.
pub(crate) fn ask(address: &str, request: &str, more: &str, body: &str) -> Answer {
    let host = match more.contains("Host: ") {
        true => String::new(),
        false => format!("Host: {address}\r\n"),
    };
    let kind = match body {
        "" => "",
        _ => "Content-Type: application/json\r\n",
    };
    let length = body.len();
    let head = format!(
        "{request} HTTP/1.1\r\n{host}Connection: close\r\n{kind}{more}\
        Content-Length: {length}\r\n\r\n"
    );
    send(address, format!("{head}{body}").as_bytes())
}

/// Sends bytes as they are and reads to the end of the connection.
pub(crate) fn send(address: &str, request: &[u8]) -> Answer {
    let mut stream = TcpStream::connect(address).unwrap();
    let patience = Some(Duration::from_secs(150));
    stream.set_read_timeout(patience).unwrap();
    // A server that has had enough answers before it has read everything.
    let _ = stream.write_all(request);
    read(stream)
}

/// Reads to the end of the answer, if its length is given, or of the connection.
fn read(mut stream: TcpStream) -> Answer {
    let (mut bytes, mut part) = (Vec::new(), [0; 16 * 1024]);
    // A reset after the answer is an end too.
    while let Ok(read @ 1..) = stream.read(&mut part) {
        bytes.extend(&part[..read]);
        let known = answer(&bytes);
        let length = known
            .head
            .split_once("content-length:")
            .and_then(|(_, rest)| rest.lines().next()?.trim().parse::<usize>().ok());
        if known.status != 0 && length.is_some_and(|length| known.body.len() >= length) {
            break;
        }
    }
    answer(&bytes)
}

/// Takes an answer apart.
pub(crate) fn answer(bytes: &[u8]) -> Answer {
    let Some(end) = bytes.windows(4).position(|window| window == b"\r\n\r\n") else {
        return Answer {
            status: 0,
            head: String::from_utf8_lossy(bytes).into_owned(),
            body: Vec::new(),
        };
    };
    let head = String::from_utf8_lossy(&bytes[..end]).to_lowercase();
    let status = head
        .split_whitespace()
        .nth(1)
        .and_then(|status| status.parse().ok())
        .unwrap_or(0);
    let mut body = bytes[end + 4..].to_vec();
    if head.contains("transfer-encoding: chunked") {
        body = unchunked(&body);
    }
    Answer { status, head, body }
}

fn unchunked(mut bytes: &[u8]) -> Vec<u8> {
    let mut whole = Vec::new();
    while let Some(end) = bytes.windows(2).position(|window| window == b"\r\n") {
        let length =
            usize::from_str_radix(String::from_utf8_lossy(&bytes[..end]).trim(), 16).unwrap_or(0);
        if length == 0 || bytes.len() < end + 2 + length {
            break;
        }
        whole.extend(&bytes[end + 2..end + 2 + length]);
        bytes = bytes.get(end + 4 + length..).unwrap_or_default();
    }
    whole
}
