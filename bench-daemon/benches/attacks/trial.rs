//! Executes one attack, from its files to its row of results.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use instruments::mock::{
    Armed, Fault, Schedule,
    plant::{Drift, Plant},
};
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};

use super::{
    deed::{Attack, BIPOLAR_FIXED, Deed, Hand},
    job::{self, Job},
    judge::{
        NOTHING_A, Usual, beyond, deadline_s, false_words, printed_bound_s, shares, wrong_points,
    },
    scene::{Scene, Switches, lock},
    table::Row,
    timeline::{Journal, Said},
    window::{Cue, Window},
};

/// Interval between two checks of a run.
const LOOK: Duration = Duration::from_millis(20);
/// Time after which a run that was asked to end is killed, s.
const ENDING_S: f64 = 30.0;
/// Time from the attack until a run is asked to end, s: if it would not end soon on its own, if it
/// would, and if it must continue after an outage.
const OBSERVED_S: (f64, f64, f64) = (25.0, 150.0, 280.0);
/// Time after which a window counts as not reached, s.
const REACHED_S: f64 = 200.0;
/// Time from the attack to the end of a pause or prompt, s.
const WAITED_S: f64 = 12.0;
/// Time from the delay of answers to the second client, s.
const SLOW_FIRST_S: f64 = 3.0;
/// Delay of the scope's blocks in the window of their download, s.
const BLOCK_S: f64 = 3.0;
/// Longest wait for a guardian, s, and for a command.
const GUARDIAN_S: f64 = 60.0;
const COMMAND: Duration = Duration::from_secs(300);
/// Time after the end of a process within which its last output arrives.
const LINGER: Duration = Duration::from_secs(2);
/// Roles of the instruments on ports.
const ROLES: [&str; 7] = [
    "supply4q",
    "generator",
    "scope",
    "load",
    "supply",
    "chiller",
    "logger",
];

/// Usual answer time in the bench file for an instrument that answers at once, s.
const USUAL_ANSWER_S: f64 = 0.1;

/// Settings for the execution of attacks.
pub(crate) struct Play<'a> {
    pub(crate) program: &'a str,
    pub(crate) usual: &'a Usual,
    /// Whether a run that did not end with 0 is resumed on repaired instruments.
    pub(crate) resumes: bool,
    /// Whether the bench file states the delay of answers.
    pub(crate) stated: bool,
}

/// One attack in progress.
struct Trial<'a> {
    play: &'a Play<'a>,
    attack: Attack,
    folder: &'a Path,
    run: PathBuf,
    scene: &'a Scene,
    switches: Switches,
    child: Child,
    journal: Journal,
    said: Said,
    /// Messages of the program and of its guardian, with their times, s.
    reports: Vec<(f64, String)>,
    deed_s: Option<f64>,
    /// Pending actions: bench time, s, and messages of the other client.
    later: Vec<(f64, Hand)>,
    /// The number of the last answered question, and whether the pause was requested.
    answered: u64,
    paused: bool,
    prelude: bool,
    asked_to_end_s: Option<f64>,
    helpers: Vec<Child>,
    hung: bool,
}

impl Play<'_> {
    /// Executes one attack.
    pub(crate) fn stand(&self, attack: &Attack) -> Row {
        let job = attack.window.job();
        let folder = job.files();
        if self.stated && attack.deed.late_s() > 0.0 {
            job::state_answers(folder.path(), attack.deed.late_s() + USUAL_ANSWER_S);
        }
        let switches = Switches::default();
        let schedule = match attack.deed {
            Deed::Fault(role, fault) => Some(Schedule {
                seed: 1,
                per_message: 1.0,
                most: 1,
                faults: vec![fault],
                role: Some(role.to_owned()),
                awaits: Some(switches.begun.clone()),
                repaired: switches.repaired.clone(),
                ..Schedule::default()
            }),
            _ => None,
        };
        let scene = Scene::serve(folder.path(), schedule, job.has_person());
        if attack.window == Window::Download
            && let Some(scope) = scene.remote("scope")
        {
            scope.delay_blocks(BLOCK_S);
        }
        let run = folder.path().join("run");
        let experiment = folder.path().join("experiments/attack.toml");
        let mut child = self.start(&[
            "run".as_ref(),
            experiment.as_os_str(),
            "--out".as_ref(),
            run.as_os_str(),
        ]);
        let said = Said::default();
        let pipes = [
            child
                .stdout
                .take()
                .map(|pipe| said.listen(pipe, scene.clock.clone())),
            child
                .stderr
                .take()
                .map(|pipe| said.listen(pipe, scene.clock.clone())),
        ];
        let mut trial = Trial {
            play: self,
            attack: *attack,
            folder: folder.path(),
            journal: Journal::of(&run),
            run,
            scene: &scene,
            switches,
            child,
            said,
            reports: Vec::new(),
            deed_s: None,
            later: Vec::new(),
            answered: 0,
            paused: false,
            prelude: false,
            asked_to_end_s: None,
            helpers: Vec::new(),
            hung: false,
        };
        let code = trial.until_end();
        // A guardian that continues may hold the pipes: the messages up to now are enough.
        wait_at_most(LINGER, || {
            pipes.iter().flatten().all(|pipe| pipe.is_finished())
        });
        let ended_s = scene.now_s();
        trial.until_guardian_rests(code);
        trial.judge(code, ended_s)
    }

    fn start(&self, words: &[&std::ffi::OsStr]) -> Child {
        Command::new(self.program)
            .args(words)
            .env("EIS_BENCH_OPERATOR", "run-folder")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program")
    }

    /// Runs a command to its end; returns its exit code and its output.
    fn command(&self, words: &[&std::ffi::OsStr]) -> (Option<i32>, String) {
        let mut child = self.start(words);
        let pipes = (child.stdout.take(), child.stderr.take());
        let reader = std::thread::spawn(move || {
            let mut text = String::new();
            let (out, err) = pipes;
            if let Some(mut out) = out {
                let _ = std::io::Read::read_to_string(&mut out, &mut text);
            }
            if let Some(mut err) = err {
                let _ = std::io::Read::read_to_string(&mut err, &mut text);
            }
            text
        });
        let mut status = None;
        wait_at_most(COMMAND, || {
            status = child.try_wait().ok().flatten();
            status.is_some()
        });
        if status.is_none() {
            let _ = child.kill();
            let _ = child.wait();
        }
        wait_at_most(LINGER, || reader.is_finished());
        let text = if reader.is_finished() {
            reader.join().unwrap_or_default()
        } else {
            String::new()
        };
        (status.and_then(|status| status.code()), text)
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "other processes are waited for, which know no bench time"
)]
fn wait_at_most(most: Duration, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while start.elapsed() < most && !done() {
        std::thread::sleep(LOOK);
    }
}

impl Trial<'_> {
    /// Follows the run to its end; returns its exit code.
    fn until_end(&mut self) -> Option<i32> {
        let mut status = None;
        wait_at_most(Duration::MAX, || {
            status = self.child.try_wait().ok().flatten();
            status.is_some() || self.look()
        });
        self.journal.read(self.scene.now_s());
        if status.is_none() {
            self.hung = true;
            let _ = self.child.kill();
            status = self.child.wait().ok();
        }
        for mut helper in self.helpers.drain(..) {
            let _ = helper.kill();
            let _ = helper.wait();
        }
        status.and_then(|status| status.code())
    }

    /// Checks the run once; returns whether its time is over.
    fn look(&mut self) -> bool {
        let now_s = self.scene.now_s();
        self.journal.read(now_s);
        self.note_guardian(now_s);
        self.serve_person(now_s);
        self.prepare(now_s);
        if self.deed_s.is_none() && self.attack.deed != Deed::Nothing && self.is_in_window(now_s) {
            self.deed_s = Some(now_s);
            self.act(now_s);
        }
        self.act_later(now_s);
        self.end_in_time(now_s)
    }

    /// Asks the run to end if it has taken too long; returns whether it must be killed.
    fn end_in_time(&mut self, now_s: f64) -> bool {
        let (long_s, soon_s, outage_s) = OBSERVED_S;
        let soon = self.attack.window.ends_soon();
        let most_s = match (self.attack.deed.is_transient(), soon) {
            (true, _) if self.attack.window != Window::Leg => outage_s,
            (true, _) => 2.0 * long_s,
            (false, true) => soon_s,
            (false, false) => long_s,
        };
        let late = match self.deed_s {
            Some(deed_s) => now_s - deed_s > most_s,
            None if self.attack.deed == Deed::Nothing && self.attack.window == Window::Leg => {
                now_s > long_s
            }
            None if self.attack.deed == Deed::Nothing => now_s > outage_s,
            None => now_s > REACHED_S,
        };
        if late && self.asked_to_end_s.is_none() {
            self.hung = soon;
            self.asked_to_end_s = Some(now_s);
            self.signal((0, Signal::SIGINT));
        }
        self.asked_to_end_s
            .is_some_and(|asked_s| now_s - asked_s > ENDING_S)
    }

    /// Checks whether the window is reached.
    fn is_in_window(&self, now_s: f64) -> bool {
        let since = |entry_s: f64, delay_s: f64| now_s - entry_s >= delay_s;
        match self.attack.window.cue() {
            Cue::Step(words, delay_s) => self.journal.last().is_some_and(|entry| {
                entry.kind == "intent"
                    && entry.text().contains(words)
                    && since(entry.now_s, delay_s)
            }),
            Cue::Entry(kind, delay_s) => self
                .journal
                .entries
                .iter()
                .find(|entry| entry.kind == kind)
                .is_some_and(|entry| since(entry.now_s, delay_s)),
            Cue::LastSafe => self
                .journal
                .last_safe_s(self.attack.window.job().stages())
                .is_some(),
            Cue::Said(words, delay_s) => self
                .said
                .at_s(words)
                .is_some_and(|said_s| since(said_s, delay_s)),
            Cue::Heard(role, words) => self
                .scene
                .remote(role)
                .and_then(|remote| remote.heard())
                .is_some_and(|(heard_s, message)| {
                    message.contains(words) && now_s - heard_s < BLOCK_S
                }),
        }
    }

    /// Brings the run into windows that it does not reach on its own.
    fn prepare(&mut self, now_s: f64) {
        if self.attack.window == Window::Pause {
            self.pause(now_s);
        }
        let in_sine = self.journal.last().is_some_and(|entry| {
            entry.kind == "intent" && entry.text().starts_with("point") && now_s - entry.now_s > 0.5
        });
        if self.attack.window.is_after_fault() && !self.prelude && in_sine {
            self.prelude = true;
            self.arm("scope", Fault::Reset, "?");
        }
    }

    /// Requests a pause, and its end.
    fn pause(&mut self, now_s: f64) {
        let wish = |course: &str| {
            let text = format!("{{\"course\":\"{course}\",\"order\":[]}}");
            let path = self.run.join("wishes.tmp");
            let _ = fs::write(&path, text)
                .and_then(|()| fs::rename(&path, self.run.join("wishes.json")));
        };
        let is_paused = self
            .journal
            .last()
            .is_some_and(|entry| entry.kind == "paused");
        if !self.paused && !self.journal.entries.is_empty() {
            self.paused = true;
            wish("pause");
        }
        let over = match self.deed_s {
            Some(deed_s) => now_s - deed_s > WAITED_S,
            None => self.attack.deed == Deed::Nothing,
        };
        if is_paused && over {
            wish("go_on");
        }
    }

    /// Answers a question as a person who changes the fixture does.
    fn serve_person(&mut self, now_s: f64) {
        let Some(entry) = self.journal.last().filter(|entry| entry.kind == "asked") else {
            return;
        };
        let over = match self.deed_s {
            Some(deed_s) => now_s - deed_s > WAITED_S,
            None => self.attack.deed == Deed::Nothing || now_s - entry.now_s > WAITED_S,
        };
        if !over || entry.number == self.answered {
            return;
        }
        self.answered = entry.number;
        let fixture = serde_json::from_value(entry.value["fixture"].clone());
        if let Ok(fixture) = fixture {
            lock(&self.scene.world).mount(now_s, fixture);
        }
        let number = self.answered.to_string();
        self.helpers.push(self.play.start(&[
            "answer".as_ref(),
            self.run.as_os_str(),
            "--done".as_ref(),
            "--question".as_ref(),
            number.as_ref(),
        ]));
    }

    /// Executes the attack.
    fn act(&mut self, now_s: f64) {
        match self.attack.deed {
            Deed::Nothing => {}
            Deed::Hand(hand) => self.meddle(hand),
            Deed::Hang(role, fault, within) => self.arm(role, fault, within),
            Deed::Fault(..) => self.switches.begun.throw(),
            Deed::Slow(late_s, hand) => {
                for remote in ROLES.iter().filter_map(|role| self.scene.remote(role)) {
                    remote.delay(late_s);
                }
                self.later.push((now_s + SLOW_FIRST_S, hand));
            }
            Deed::Gone(role, span_s, closed) => {
                let gone = ROLES
                    .iter()
                    .filter(|known| role.is_none_or(|role| role == **known));
                for remote in gone.filter_map(|role| self.scene.remote(role)) {
                    remote.leave(now_s + span_s, closed);
                }
            }
            Deed::Signal(whom, signal) => self.signal((whom, signal)),
            Deed::FolderGone => {
                let _ = fs::remove_dir_all(&self.run);
            }
            Deed::Offset(greatest_a) => lock(&self.scene.world).drift(
                now_s,
                Drift {
                    a_per_s: greatest_a,
                    greatest_a,
                },
            ),
        }
    }

    fn act_later(&mut self, now_s: f64) {
        let due: Vec<Hand> = self
            .later
            .iter()
            .filter(|(at_s, _)| *at_s <= now_s)
            .map(|(_, hand)| *hand)
            .collect();
        self.later.retain(|(at_s, _)| *at_s > now_s);
        for hand in due {
            // The time to zero counts from the action of the other client.
            self.deed_s = Some(now_s);
            self.meddle(hand);
        }
        if let Deed::Hang(role, ..) = self.attack.deed
            && let Some(befell_s) = self.scene.remote(role).and_then(|remote| remote.befell_s())
            && !self.prelude
        {
            self.prelude = true;
            self.deed_s = Some(befell_s);
            self.meddle(BIPOLAR_FIXED);
        }
    }

    fn meddle(&self, hand: Hand) {
        let now_s = self.scene.now_s();
        if let Some(remote) = self.scene.remote(hand.role) {
            for message in hand.messages {
                remote.send(now_s, message);
            }
        }
    }

    fn arm(&self, role: &str, fault: Fault, within: &str) {
        if let Some(remote) = self.scene.remote(role) {
            remote.arm(Armed {
                fault,
                within: within.to_owned(),
            });
        }
    }

    /// Returns the report of the guardian.
    fn guardian(&self) -> Option<serde_json::Value> {
        let path = self.folder.join("benches/.eis-bench/demo/guardian.json");
        serde_json::from_str(&fs::read_to_string(path).ok()?).ok()
    }

    /// Records the report of the guardian if it is new.
    fn note_guardian(&mut self, now_s: f64) {
        let Some(status) = self
            .guardian()
            .and_then(|report| Some(report["status"].as_str()?.to_owned()))
        else {
            return;
        };
        let text = match status.as_str() {
            "verified" | "verified, bath not reached" => {
                format!("guardian.json: {status}: every output is off")
            }
            other => format!("guardian.json: {other}"),
        };
        if self.reports.last().is_none_or(|(_, last)| *last != text) {
            self.reports.push((now_s, text));
        }
    }

    fn signal(&self, (whom, signal): (u8, Signal)) {
        if whom >= 1
            && let Some(pid) = self.guardian().and_then(|report| report["pid"].as_i64())
            && let Ok(pid) = i32::try_from(pid)
        {
            let _ = kill(Pid::from_raw(pid), signal);
        }
        if whom != 1
            && let Ok(pid) = i32::try_from(self.child.id())
        {
            let _ = kill(Pid::from_raw(pid), signal);
        }
    }

    /// Waits for a guardian that is still working.
    fn until_guardian_rests(&mut self, code: Option<i32>) {
        if !matches!(self.attack.deed, Deed::Signal(..)) && code.is_some_and(|code| code != 6) {
            return;
        }
        wait_at_most(Duration::from_secs_f64(GUARDIAN_S), || {
            self.note_guardian(self.scene.now_s());
            self.reports.last().is_some_and(|(_, text)| {
                !text.ends_with("watching") && !text.ends_with("switching off")
            }) || self.scene.is_quiet_for(20.0)
        });
    }

    fn happened(&self) -> bool {
        match self.attack.deed {
            Deed::Nothing => true,
            Deed::Fault(..) => !self.scene.simulation.happened().is_empty(),
            Deed::Hang(role, ..) => self
                .scene
                .remote(role)
                .is_some_and(|remote| remote.befell_s().is_some()),
            Deed::Slow(..) => self.deed_s.is_some() && self.later.is_empty(),
            _ => self.deed_s.is_some(),
        }
    }

    /// Returns the allowed currents at each time. If the journal was deleted, every current that
    /// the job ever requests is allowed.
    fn envelope(&self, ended_s: f64) -> Vec<(f64, (f64, f64))> {
        let job = self.attack.window.job();
        let mut envelope = match self.attack.deed {
            Deed::FolderGone => vec![(0.0, job.extremes_a())],
            _ => self.journal.envelope(job),
        };
        // A killed process leaves the currents of its step on until its guardian has acted.
        if !self.attack.deed.takes_lease() {
            envelope.push((ended_s, (0.0, 0.0)));
        }
        envelope
    }

    /// Returns the bound that the program prints, s.
    fn bound_s(&self) -> Option<f64> {
        if self.attack.deed.late_s() == 0.0 {
            return None;
        }
        printed_bound_s(&self.said.text()).or_else(|| {
            let experiment = self.folder.join("experiments/attack.toml");
            let (_, text) = self
                .play
                .command(&["plan".as_ref(), experiment.as_os_str()]);
            printed_bound_s(&text)
        })
    }

    fn judge(&mut self, code: Option<i32>, ended_s: f64) -> Row {
        let attack = self.attack;
        let job = attack.window.job();
        let samples = self.scene.samples();
        let gap_s = attack.window.period_s().max(2.0);
        let (beyond_as, beyond_s) = beyond(&samples, &self.envelope(ended_s), gap_s);
        let still = samples
            .last()
            .is_some_and(|sample| sample.amps.abs() > NOTHING_A);
        let last_s = samples
            .iter()
            .rev()
            .find(|sample| sample.amps.abs() > NOTHING_A)
            .map(|sample| sample.now_s);
        let zero_s = self
            .deed_s
            .zip(last_s)
            .filter(|_| !still && code != Some(0))
            .map(|(deed_s, last_s)| (last_s - deed_s).max(0.0));
        let shares = shares(&self.run, self.scene);
        if attack.deed == Deed::Nothing {
            lock(self.play.usual).insert(job, shares.iter().map(|(_, share)| *share).collect());
        }
        // Do not hold the lock while other threads need it.
        let usual = lock(self.play.usual).get(&job).cloned();
        let text = self.said.text();
        let mut said = self.said.lines();
        said.extend(self.reports.iter().cloned());
        let witness = lock(&self.scene.world).witness();
        let bound_s = self.bound_s();
        let mut row = Row {
            attack,
            beyond_as,
            beyond_s,
            bound_s,
            deadline_s: deadline_s(&attack, bound_s),
            worst: (witness.least_v, witness.greatest_v, witness.greatest_degc),
            zero_s,
            still,
            happened: self.happened(),
            began: self
                .journal
                .entries
                .iter()
                .any(|entry| entry.kind == "safe"),
            hung: self.hung,
            code,
            message: last_message(&text),
            wrong_points: wrong_points(&shares, usual.as_ref(), &text),
            points: shares.len(),
            usual: usual.as_ref().map_or(0, Vec::len),
            false_words: false_words(&said, &samples),
            went_on_s: self.deed_s.map_or(0.0, |deed_s| ended_s - deed_s),
            took_s: ended_s,
            lag_s: self.scene.lag_s(),
            resumed: "–".to_owned(),
        };
        self.clean_up(code, &mut row);
        row
    }

    /// Ends the rest of the run on repaired instruments, and resumes it if requested.
    fn clean_up(&self, code: Option<i32>, row: &mut Row) {
        self.switches.repaired.throw();
        for remote in ROLES.iter().filter_map(|role| self.scene.remote(role)) {
            remote.delay(0.0);
        }
        if code == Some(0) {
            return;
        }
        // A guardian that was stopped, or still retries, would access the instruments of later
        // trials.
        self.end_guardian();
        let bench = self.folder.join("benches/demo.toml");
        self.play
            .command(&["safe".as_ref(), bench.as_os_str(), "--kill".as_ref()]);
        if self.play.resumes {
            row.resumed = self.resume(row.attack.window.job());
        }
    }

    /// Kills the guardian of this trial if it still runs.
    fn end_guardian(&self) {
        let Some(pid) = self.guardian().and_then(|report| report["pid"].as_i64()) else {
            return;
        };
        let words = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        let is_its = String::from_utf8_lossy(&words).contains(&*self.folder.to_string_lossy());
        if is_its && let Ok(pid) = i32::try_from(pid) {
            let _ = kill(Pid::from_raw(pid), Signal::SIGKILL);
        }
    }

    /// Clears the latch and resumes the run.
    fn resume(&self, job: Job) -> String {
        let bench = self.folder.join("benches/demo.toml");
        self.play
            .command(&["clear".as_ref(), bench.as_os_str(), "--yes".as_ref()]);
        let (code, text) = self
            .play
            .command(&["resume".as_ref(), self.run.as_os_str()]);
        let shares = shares(&self.run, self.scene);
        let usual = lock(self.play.usual).get(&job).cloned();
        let (points, wrong) = (shares.len(), wrong_points(&shares, usual.as_ref(), &text));
        match code {
            Some(0) if wrong == 0 => format!("finished, {points} points right"),
            Some(0) => format!("finished, {wrong} of {points} points wrong"),
            code => format!("code {code:?}: {}", last_message(&text)),
        }
    }
}

/// Returns the last message of the program.
fn last_message(text: &str) -> String {
    text.lines()
        .rev()
        .find_map(|line| line.strip_prefix("eis-bench: "))
        .unwrap_or_default()
        .to_owned()
}
