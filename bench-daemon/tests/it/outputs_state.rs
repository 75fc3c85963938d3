//! What API, page, command line, `safe` and notices report about the outputs of a bench in one
//! situation after the other, compared with the actual state: real processes, simulated
//! instruments on real ports. The texts follow from what was read back, and all places agree.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    net::TcpStream,
    path::PathBuf,
};

use nix::sys::signal::Signal;
use serde_json::Value;

use crate::{
    guardian::{on_bench, pid, report, signal, state},
    kill::{start, wait_for_points},
    serve_page::{Browser, DESKTOP},
    serve_support::{Served, config, submit},
    support::{BENCH, EXPERIMENT, Ended, Files, Ports, Running, command, poll, program},
};

const DEMO: &str = r#"{"experiment":"demo"}"#;

/// A bench under a server, with a browser if there is one.
struct Scene {
    files: Files,
    served: Served,
    browser: Option<Browser>,
    rows: Vec<[String; 6]>,
}

/// Returns a text without the time of a reading, so that a table stays comparable: `14:32` becomes
/// `T`.
fn timeless(words: &str) -> String {
    let is_time = |word: &str| {
        let word = word.trim_matches(|c: char| "(),;.".contains(c));
        word.len() == 5
            && word.as_bytes()[2] == b':'
            && word.starts_with(|c: char| c.is_ascii_digit())
    };
    let each = words.split(' ').map(|word| {
        if is_time(word) {
            word.replace(|c: char| c.is_ascii_digit() || c == ':', "")
                .replacen("", "T", 1)
        } else {
            word.to_owned()
        }
    });
    each.collect::<Vec<_>>().join(" ")
}

impl Scene {
    fn live(&self) -> Value {
        self.served.get("/benches/demo")
    }

    /// Waits until the API reports this state of the outputs, and the command line the same.
    #[track_caller]
    fn wait_words(&self, beginning: &str) -> Value {
        let mut last = (Value::Null, String::new());
        for _ in 0..100 {
            last = (self.live(), self.known());
            let words = last.0["outputs"]["words"].as_str().unwrap();
            if words.starts_with(beginning) && words == last.1 {
                return last.0;
            }
        }
        panic!(
            "expected {beginning:?}, the API says {}, the command line {:?}",
            last.0["outputs"], last.1
        );
    }

    /// Returns the report of the command line without a query.
    fn known(&self) -> String {
        let known = on_bench(&self.files, &["outputs", "--known"]);
        known.expect_code(0);
        known.stdout.lines().next().unwrap().to_owned()
    }

    /// Returns the title of the latest notice of outputs.
    fn notice(&self) -> Option<String> {
        let notices = self.served.get("/notices");
        let all = notices["latest"]
            .as_array()
            .or_else(|| notices.as_array())
            .unwrap()
            .clone();
        let one = all.iter().find(|one| one["about"] == "unverified")?;
        Some(one["title"].as_str().unwrap().to_owned())
    }

    /// Adds a row: all places must agree, with a text that begins with these words.
    #[track_caller]
    fn row(&mut self, situation: &str, so: &str, words: &str) {
        let live = self.wait_words(words);
        let said = live["outputs"]["words"].as_str().unwrap().to_owned();
        let in_run = live["outputs"]["state"] == "in_run";
        let page = match &self.browser {
            Some(browser) if in_run => {
                browser.wait("#state", "Running");
                browser.text("#state")
            }
            Some(browser) => {
                browser.wait("#state", &said);
                browser.wait("#overview", &said);
                browser.wait("#outputssaid", &said);
                said.clone()
            }
            None => "(no browser)".to_owned(),
        };
        let is_alarming = live["state"] == "unknown"
            || live["outputs"]["state"] == "on"
            || live["outputs"]["state"] == "unreachable";
        assert_eq!(
            live["verified"],
            live["outputs"]["state"] == "off" && live["state"] != "unknown"
        );
        let notice = if is_alarming {
            let wanted = format!("demo: {said}");
            poll("the notice", || {
                self.notice().filter(|title| *title == wanted)
            })
        } else {
            "–".to_owned()
        };
        self.rows.push(
            [
                situation,
                so,
                live["state"].as_str().unwrap(),
                &timeless(&said),
                &timeless(&page),
                &timeless(&notice),
            ]
            .map(str::to_owned),
        );
    }

    #[track_caller]
    fn read(&self, code: u16) -> Value {
        self.served
            .post("/benches/demo/outputs/read", "")
            .expect(code)
            .json()
    }

    /// Switches off; afterwards all places must show its final message.
    #[track_caller]
    fn safe(&mut self, situation: &str, code: i32, words: &str) -> Ended {
        let safe = on_bench(&self.files, &["safe"]);
        safe.expect_code(code);
        let said = safe
            .stdout
            .lines()
            .rev()
            .find_map(|line| line.strip_prefix("demo: "))
            .unwrap()
            .to_owned();
        assert!(said.starts_with(words), "{said}");
        let live = self.wait_words(words);
        assert_eq!(live["outputs"]["words"], said.as_str(), "safe");
        self.row(situation, "off", words);
        safe
    }

    /// Returns the files with the readings of each output.
    fn kept(&self) -> Vec<PathBuf> {
        let instruments = state(&self.files, "instruments");
        let all = fs::read_dir(instruments)
            .unwrap()
            .map(|entry| entry.unwrap().path().join("output.json"));
        all.filter(|path| path.exists()).collect()
    }

    /// Changes the times of the readings.
    fn change_times(&self, calendar_s: f64, uptime_s: f64) {
        for path in self.kept() {
            let mut kept = crate::support::json(&path);
            let add = |value: &mut Value, by: f64| *value = (value.as_f64().unwrap() + by).into();
            add(&mut kept["unix_s"], calendar_s);
            add(&mut kept["at"]["unix_s"], calendar_s);
            add(&mut kept["at"]["uptime_s"], uptime_s);
            fs::write(&path, kept.to_string()).unwrap();
        }
    }

    fn print(&self) {
        println!("| situation | what is so | state | API, command line | page | notice |");
        println!("|---|---|---|---|---|---|");
        for row in &self.rows {
            println!("| {} |", row.join(" | "));
        }
    }
}

/// Switches the load on, as a person at its panel or another program would.
fn load_on(ports: &Ports) {
    let mut stream = TcpStream::connect(ports.address("load")).unwrap();
    stream.write_all(b":CURR 2\n:INP ON\n:INP?\n").unwrap();
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line).unwrap();
    assert_eq!(line.trim(), "1");
}

/// Kills a run together with its guardian.
fn kill_both(files: &Files, run: i32) {
    let guardian = i32::try_from(report(files, "watching")["pid"].as_i64().unwrap()).unwrap();
    signal(guardian, Signal::SIGSTOP);
    signal(run, Signal::SIGKILL);
    signal(guardian, Signal::SIGKILL);
}

fn run_pid(files: &Files) -> i32 {
    poll("the run's process", || {
        let report = report(files, "watching");
        i32::try_from(report["daemon"].as_i64()?).ok()
    })
}

#[test]
fn every_place_says_of_the_outputs_what_was_read_back_and_when() {
    let files = Files::short(6).without(EXPERIMENT, "fixture_check");
    let ports = Ports::serve(&files, 10.0, 1);
    config(&files, "");
    let served = Served::start(&files);
    let browser = Browser::start(false);
    if let Some(browser) = &browser {
        browser.go(&served.url(), DESKTOP);
        browser.wait("#link", "connected");
    }
    let mut scene = Scene {
        files,
        served,
        browser,
        rows: Vec::new(),
    };
    scene.row("never asked", "off", "outputs not read");
    assert_eq!(scene.read(200)["state"], "off");
    scene.row("read while idle", "off", "outputs read off at ");
    load_on(&ports);
    scene.row(
        "a foreign hand has switched the load on, not read since",
        "load on",
        "outputs read off at ",
    );
    assert_eq!(scene.read(200)["state"], "on");
    scene.row("the same, read", "load on", "load on, 2.00 A (read ");
    if let Some(browser) = &scene.browser {
        browser.picture("outputs-load-on", DESKTOP);
    }
    scene.safe("after `safe`", 0, "outputs read off at ");
    ports.assert_outputs_off();
    scene.change_times(-3.0 * 3600.0, -3.0 * 3600.0);
    scene.row("3 h later", "off", "outputs read off at ");
    assert!(
        scene.known().ends_with(", 3 h ago: no longer current"),
        "{}",
        scene.known()
    );
    scene.change_times(-3600.0, 0.0);
    scene.row("the machine's clock was set", "off", "outputs read off at ");
    assert!(
        scene
            .known()
            .ends_with("clock was set since: no longer current"),
        "{}",
        scene.known()
    );
    scene.runs_and_kills(&ports);
    scene.restarts_and_losses(ports);
    scene.print();
}

impl Scene {
    /// Begins a run and waits until a current flows.
    fn begin(&self) -> String {
        let run = submit(&self.served, DEMO);
        poll("its first point", || {
            let live = self.live();
            let is_ours = live["run"]["run"] == run.as_str() && live["run"]["going"] == true;
            (is_ours && live["run"]["points_done"].as_u64()? >= 1).then_some(())
        });
        run
    }

    fn runs_and_kills(&mut self, ports: &Ports) {
        let run = self.begin();
        self.row("a run is in work", "current flows", "a run is in work");
        let refused = self.read(409);
        assert!(
            refused["message"]
                .as_str()
                .unwrap()
                .contains("its own readings"),
            "{refused}"
        );
        self.served.ended(&run);
        self.row("the run has ended", "off", "outputs read off at ");
        ports.assert_outputs_off();

        self.begin();
        signal(run_pid(&self.files), Signal::SIGKILL);
        report(&self.files, "verified");
        self.row(
            "run killed, guardian verified",
            "off",
            "outputs read off at ",
        );
        let guardian = report(&self.files, "verified");
        assert_eq!(guardian["read"], self.live()["outputs"]["words"]);
        ports.assert_outputs_off();

        self.served.post("/benches/demo/release", "").expect(200);
        self.begin();
        kill_both(&self.files, run_pid(&self.files));
        self.row(
            "run killed with its guardian",
            "bipolar supply on",
            "outputs not read since a run began at ",
        );
        self.read(200);
        self.row("the same, read", "bipolar supply on", "bipolar supply on");
        assert_eq!(ports.ask("supply4q", "OUTP?"), "1");
        self.safe("after `safe`: latched", 0, "outputs read off at ");
        ports.assert_outputs_off();
        assert_eq!(self.live()["state"], "latched");
        let settled = crate::support::json(&state(&self.files, "settled.json"));
        assert_eq!(settled["read"], self.live()["outputs"]["words"]);
    }

    fn restarts_and_losses(&mut self, ports: Ports) {
        let text = self.files.text("serve.toml");
        self.files
            .write("second.toml", &text.replace("\"data\"", "\"data2\""));
        let mut second = command(&["serve".as_ref(), self.files.path("second.toml").as_os_str()]);
        let mut second = Running(second.spawn().unwrap());
        let mut line = String::new();
        BufReader::new(second.0.stdout.as_mut().unwrap())
            .read_line(&mut line)
            .unwrap();
        let address = line.trim().rsplit_once("//").unwrap().1.to_owned();
        let other = poll("the second server", || {
            let live =
                crate::serve_support::exchange(&address, "GET", "/api/v1/benches/demo", "").json();
            (live["state"] != "unknown").then_some(live)
        });
        assert_eq!(other["outputs"]["words"], self.live()["outputs"]["words"]);
        self.row("two servers", "off", "outputs read off at ");
        drop(second);
        self.served.process.0.kill().unwrap();
        self.served.process.0.wait().unwrap();
        self.served = Served::start(&self.files);
        if let Some(browser) = &self.browser {
            browser.go(&self.served.url(), DESKTOP);
        }
        self.row(
            "server killed and started again",
            "off",
            "outputs read off at ",
        );
        drop(ports);
        self.row(
            "connection lost since the reading",
            "not known",
            "outputs read off at ",
        );
        assert_eq!(self.read(200)["state"], "unreachable");
        self.row(
            "instruments not reached",
            "not known",
            "outputs not reached at ",
        );
        let safe = on_bench(&self.files, &["safe"]);
        safe.expect_code(6);
        let last = safe.stdout.lines().rfind(|line| line.starts_with("demo: "));
        assert!(last.unwrap().starts_with("demo: outputs not reached at "));
    }
}

/// Returns the bench of `files` as real hardware: nothing indicates that its instruments are
/// mocks.
fn metal(name: &str) -> (Files, Ports) {
    let files = Files::short(2).without(EXPERIMENT, "fixture_check");
    let files = files.edit(BENCH, "name = \"demo\"", &format!("name = \"{name}\""));
    let ports = Ports::serve(&files, 1.0, 1);
    let files = files.without(BENCH, "simulation");
    (files, ports)
}

/// A bench on which a run has begun and was killed together with its guardian.
fn killed(files: &Files, common: &str) {
    let mut command = command(&[
        "run".as_ref(),
        files.experiment().as_os_str(),
        "--out".as_ref(),
        files.path("run").as_os_str(),
    ]);
    let mut child = Running(command.env("EIS_BENCH_STATE", common).spawn().unwrap());
    let open = files
        .path("benches/.eis-bench")
        .join(bench_name(files))
        .join("open.json");
    poll("an open run", || open.exists().then_some(()));
    let guardian = open.with_file_name("guardian.json");
    let guardian = crate::support::json(&guardian)["pid"].as_i64().unwrap();
    let guardian = i32::try_from(guardian).unwrap();
    signal(guardian, Signal::SIGSTOP);
    signal(pid(&child), Signal::SIGKILL);
    child.0.wait().unwrap();
    signal(guardian, Signal::SIGKILL);
}

fn bench_name(files: &Files) -> String {
    let text = files.text(BENCH);
    let (_, rest) = text.split_once("name = \"").unwrap();
    rest.split_once('"').unwrap().0.to_owned()
}

#[test]
fn safe_without_a_bench_switches_off_every_bench_that_runs_or_ran_here() {
    let common = tempfile::tempdir().unwrap();
    let common = common.path().to_str().unwrap().to_owned();
    let safe = |arguments: &[&str]| {
        let arguments: Vec<&std::ffi::OsStr> = arguments.iter().map(AsRef::as_ref).collect();
        Ended::of(
            command(&arguments)
                .env("EIS_BENCH_STATE", &common)
                .output()
                .unwrap(),
        )
    };
    let none = safe(&["safe"]);
    none.expect_code(6);
    assert!(
        none.stderr.contains("eis-bench safe BENCH.toml"),
        "{}",
        none.stderr
    );
    let (one, other) = (metal("one"), metal("other"));
    killed(&one.0, &common);
    killed(&other.0, &common);
    load_on(&one.1);
    load_on(&other.1);
    let every = safe(&["safe"]);
    every.expect_code(0);
    for (files, ports) in [&one, &other] {
        let path = fs::canonicalize(files.path(BENCH)).unwrap();
        let head = format!("{} ({})", bench_name(files), path.display());
        let words = format!("  {}: outputs read off at ", bench_name(files));
        assert!(
            every.stdout.contains(&head) && every.stdout.contains(&words),
            "{}",
            every.stdout
        );
        ports.assert_outputs_off();
    }
    // A missing bench file is named, and the others are still switched off.
    load_on(&one.1);
    let gone = fs::canonicalize(other.0.path(BENCH)).unwrap();
    fs::remove_file(&gone).unwrap();
    let missing = safe(&["safe"]);
    missing.expect_code(6);
    assert!(
        missing.message().contains(gone.to_str().unwrap())
            && missing
                .message()
                .contains("its file does not exist any more"),
        "{}",
        missing.stderr
    );
    one.1.assert_outputs_off();
}

#[test]
fn a_run_without_descriptors_that_has_switched_off_is_not_called_dead() {
    let files = Files::short(6).without(EXPERIMENT, "fixture_check");
    let ports = Ports::serve(&files, 10.0, 1);
    let run = files.path("run");
    let mut child = start(&files, &run, &[]);
    wait_for_points(&mut child, &run, ("spectrum.csv", 1));
    program(&["pause".as_ref(), run.as_os_str()]).expect_code(0);
    poll("the pause", || {
        let journal = fs::read_to_string(run.join("journal.jsonl")).unwrap();
        journal.contains("\"entry\":\"paused\"").then_some(())
    });
    // From here on the run cannot open any file.
    let limited = std::process::Command::new("prlimit")
        .args(["--pid", &pid(&child).to_string(), "--nofile=3:3"])
        .status();
    assert!(limited.unwrap().success());
    signal(pid(&child), Signal::SIGTERM);
    child.0.wait().unwrap();
    ports.assert_outputs_off();
    let safe = program(&["safe".as_ref(), files.path(BENCH).as_os_str()]);
    safe.expect_code(0);
    assert!(!safe.stderr.contains("died"), "{}", safe.stderr);
    assert!(!state(&files, "trip.json").exists(), "{}", safe.stderr);
}
