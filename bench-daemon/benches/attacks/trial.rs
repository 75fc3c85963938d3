//! Runs one attack, from its files to its row of results. The mocks are served by a thread of this
//! process, so that the strain of the cell is known. The program under attack knows only addresses.

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex, PoisonError, mpsc},
    time::{Duration, Instant},
};

use analysis::dataset::read_spectrum_csv;
use bench_daemon::{config::load_bench, sim::Simulation};
use fixtures::SimulatedBench;
use instruments::{
    clock::{Clock, TimeMode},
    fixture::Fixture,
    mock::{
        FaultSwitch, Schedule,
        plant::{Meter, Plant},
    },
};
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use num_complex::Complex64;

use crate::list::{Attack, Deed, Job, RECHARGE_S};

/// Bench time runs so many times as fast: deadlines of links are of the wall, so that a discharge,
/// which nobody can wait for, loses ten times as long by them.
fn factor(job: Job) -> f64 {
    if job == Job::Reset { 10.0 } else { 1.0 }
}

/// Between two looks at the true current, bench s.
const SAMPLE_S: f64 = 0.05;
/// Before the charge of a reset is surely under way the discharge may still be, s.
const GOES_OVER_S: f64 = 200.0;
/// Nothing flows, A.
const NOTHING_A: f64 = 0.1;
/// Longest wait for a process, of the wall.
const PATIENCE: Duration = Duration::from_secs(300);
/// Time after the end of a process within which its last output arrives, wall clock.
const LINGER: Duration = Duration::from_secs(2);
/// Share by which a number may be off without being wrong.
const OFF: f64 = 0.01;

/// Result of one attack.
pub(crate) struct Row {
    name: String,
    job: Job,
    /// Charge beyond the envelope of the step and 10 %, A·s.
    beyond_as: f64,
    /// From the first to the last instant beyond it, s.
    beyond_s: f64,
    /// The greatest and least voltage, V, and the greatest temperature, °C, of the cell.
    worst: (f64, f64, f64),
    abuse: usize,
    /// From the attack to the last current, s; none where some still flowed at the end.
    zero_s: Option<f64>,
    still: bool,
    happened: bool,
    code: Option<i32>,
    message: String,
    /// Points that are wrong and have no flag.
    wrong: usize,
    resumed: String,
}

impl Row {
    pub(crate) const HEAD: &'static str = "| attack | beyond the step, A·s (s) | worst V, °C | to \
    zero, s | code | message | resumed |\n|---|---|---|---|---|---|---|\n";

    pub(crate) fn line(&self) -> String {
        let Self {
            name,
            beyond_as,
            beyond_s,
            worst: (least_v, most_v, most_c),
            zero_s,
            code,
            message,
            resumed,
            ..
        } = self;
        let zero = match (self.still, zero_s) {
            (true, _) => "STILL FLOWS".to_owned(),
            (false, Some(zero_s)) if self.code != Some(0) => format!("{zero_s:.1}"),
            _ => "–".to_owned(),
        };
        let code = code.map_or("none".to_owned(), |code| code.to_string());
        let message: String = message.replace('|', "/").chars().take(220).collect();
        let happened = if self.happened {
            ""
        } else {
            " (did not happen)"
        };
        format!(
            "| {name}{happened} | {beyond_as:.2} ({beyond_s:.1}) | {least_v:.3}…{most_v:.3}, \
            {most_c:.1} | {zero} | {code} | {message} | {resumed} |"
        )
    }

    /// Violations of the safety rules, in words; empty where there are none.
    pub(crate) fn wrong(&self) -> Vec<String> {
        let period_s: f64 = if self.job == Job::Slow { 5.0 } else { 0.1 };
        let mut wrong = Vec::new();
        if self.beyond_s > period_s.max(2.0) + 1.0 {
            wrong.push(format!(
                "{}: {:.1} s beyond the envelope of the step",
                self.name, self.beyond_s
            ));
        }
        if self.wrong > 0 && self.code == Some(0) {
            wrong.push(format!(
                "{}: {} points are wrong, without a flag and with exit code 0",
                self.name, self.wrong
            ));
        }
        if self.still {
            wrong.push(format!("{}: a current still flows at the end", self.name));
        }
        if self.abuse > 0 {
            wrong.push(format!(
                "{}: the cell was harmed {} times",
                self.name, self.abuse
            ));
        }
        wrong
    }
}

/// The least and the greatest current that the step in work asks for at a bench time, A.
fn asked_a(job: Job, time_s: f64) -> (f64, f64) {
    match job {
        Job::Slow | Job::Fast => (-1.0, 1.0),
        // A discharge, then a charge: when the one has gone over into the other differs from run to
        // run by some seconds.
        Job::Reset if time_s < RECHARGE_S - GOES_OVER_S => (-5.0, 0.0),
        // And a sweep behind it.
        Job::Reset if time_s > RECHARGE_S => (-1.0, 3.0),
        Job::Reset => (-5.0, 3.0),
    }
}

/// Samples of bench time, s, and true current, A.
type Samples = Arc<Mutex<Vec<(f64, f64)>>>;

struct Served {
    world: Arc<Mutex<SimulatedBench>>,
    simulation: Simulation,
    samples: Samples,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Drop for Served {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn lock<T>(shared: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Serves the mocks with their schedule and writes their addresses into the bench file.
fn serve(folder: &Path, schedule: Option<Schedule>, factor: f64) -> Served {
    let path = folder.join("benches/demo.toml");
    let (bench, _) = load_bench(&path).expect("the bench of the demo");
    let simulation = Simulation::new(&folder.join("scenarios/p45b.toml"), 1)
        .expect("its scenario")
        .with_faults(schedule);
    let (world, samples) = (simulation.world().clone(), Samples::default());
    let (stop, mut stopped) = tokio::sync::oneshot::channel();
    let (tell, told) = mpsc::channel();
    let (served, seen, kept) = (simulation.clone(), world.clone(), samples.clone());
    let mode = TimeMode::Scaled(factor);
    let thread = std::thread::spawn(move || {
        let runtime = Clock::runtime(mode).expect("a runtime");
        runtime.block_on(async {
            let clock = Clock::start(mode);
            let addresses = served
                .serve_on_ports(&bench, &[], &clock)
                .await
                .expect("free ports");
            tell.send(addresses).expect("a listener");
            while stopped.try_recv().is_err() {
                clock.sleep_s(SAMPLE_S).await;
                let mut world = lock(&seen);
                let now_s = clock.now_s();
                world.read(now_s, Meter::BipolarAmps);
                let amps = world.truth_current_a();
                lock(&kept).push((now_s, amps));
            }
        });
    });
    let mut text = fs::read_to_string(&path)
        .expect("the bench file")
        .replace("[simulation]", &format!("[simulation]\ntime = \"{mode}\""));
    for served in told.recv().expect("addresses") {
        text = text.replace(
            &format!("\"memory:{}\"", served.role),
            &format!("{:?}", served.address),
        );
    }
    fs::write(&path, text).expect("a bench file");
    Served {
        world,
        simulation,
        samples,
        stop: Some(stop),
        thread: Some(thread),
    }
}

/// The demo's files, changed for the job.
fn files(job: Job) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
    for name in [
        "experiments/demo.toml",
        "benches/demo.toml",
        "cells/p45b.toml",
        "scenarios/p45b.toml",
    ] {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::copy(configs.join(name), path).expect("a copy");
    }
    let experiment = folder.path().join("experiments/demo.toml");
    let mut text = without(
        &fs::read_to_string(&experiment).expect("the experiment"),
        &["temperature", "fixture_check"],
    );
    let (start, stop, points) = match job {
        Job::Slow => ("0.2 Hz", "2 Hz", 3),
        Job::Fast => ("100 Hz", "300 Hz", 8),
        Job::Reset => ("100 Hz", "300 Hz", 2),
    };
    if job != Job::Reset {
        text = without(&text, &["soc_reset"]);
    }
    for (from, to) in [
        ("start = \"0.1 Hz\"", format!("start = \"{start}\"")),
        ("stop = \"300 Hz\"", format!("stop = \"{stop}\"")),
        ("points = 20", format!("points = {points}")),
        ("rc = [1, 2, 3, 4]", "rc = [1]".to_owned()),
    ] {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, &to, 1);
    }
    fs::write(experiment, text).expect("the experiment");
    folder
}

fn without(text: &str, sections: &[&str]) -> String {
    let mut inside = false;
    let mut kept = String::new();
    for line in text.lines() {
        if let Some(name) = line.strip_prefix('[') {
            inside = sections.iter().any(|section| {
                name.starts_with(&format!("{section}]")) || name.starts_with(&format!("{section}."))
            });
        }
        if !inside {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    kept
}

/// Plays one attack.
pub(crate) fn stand(program: &str, attack: &Attack, usual: &Usual) -> Row {
    let folder = files(attack.job);
    let repaired = FaultSwitch::default();
    let schedule = match attack.deed {
        Deed::Fault(role, fault, variant) => Some(Schedule {
            seed: 1,
            per_message: 1.0,
            most: 1,
            faults: vec![fault],
            role: Some(role.to_owned()),
            from_s: attack.from_s,
            variant: Some(variant),
            repaired: repaired.clone(),
        }),
        Deed::Signal(..) | Deed::Nothing => None,
    };
    let served = serve(folder.path(), schedule, factor(attack.job));
    let run = folder.path().join("run");
    let mut child = start(
        program,
        &[
            "run".as_ref(),
            folder.path().join("experiments/demo.toml").as_os_str(),
            "--out".as_ref(),
            run.as_os_str(),
        ],
    );
    let mut deed_s = None;
    if let Deed::Signal(whom, signal) = attack.deed {
        wait(|| {
            lock(&served.samples)
                .last()
                .is_some_and(|(now_s, _)| *now_s > attack.from_s)
        });
        deed_s = lock(&served.samples).last().map(|(now_s, _)| *now_s);
        signal_to(&child, (whom, signal), folder.path());
    }
    let (code, text) = ended(&mut child);
    if matches!(attack.deed, Deed::Signal(..)) || code == Some(6) {
        // The guardian is still at it.
        wait(|| {
            status(folder.path())
                .is_some_and(|status| status != "watching" && status != "switching off")
                || quiet_for(&served, 60.0)
        });
    }
    let happened = served.simulation.happened();
    deed_s = deed_s.or_else(|| happened.first().map(|happened| happened.time_s));
    let samples = lock(&served.samples).clone();
    let (beyond_as, beyond_s) = beyond(attack.job, &samples);
    let witness = lock(&served.world).witness();
    let still = samples
        .last()
        .is_some_and(|(_, amps)| amps.abs() > NOTHING_A);
    let last_s = samples
        .iter()
        .rev()
        .find(|(_, amps)| amps.abs() > NOTHING_A)
        .map_or(0.0, |(now_s, _)| *now_s);
    let shares = shares(&run, &served);
    if attack.deed == Deed::Nothing {
        lock(usual).insert(attack.job, shares.iter().map(|(_, share)| *share).collect());
    }
    // Not held while others want it.
    let usual = lock(usual).get(&attack.job).cloned();
    let wrong = wrong_points(&shares, usual.as_ref(), &text);
    repaired.mend();
    let resumed = if code == Some(0) {
        "–".to_owned()
    } else {
        resume(program, (folder.path(), &served), usual.as_ref())
    };
    Row {
        name: attack.name(),
        job: attack.job,
        beyond_as,
        beyond_s,
        worst: (witness.least_v, witness.greatest_v, witness.greatest_c),
        abuse: witness.abuse.len(),
        zero_s: deed_s
            .filter(|_| !still)
            .map(|deed_s| (last_s - deed_s).max(0.0)),
        still,
        happened: !happened.is_empty() || matches!(attack.deed, Deed::Signal(..) | Deed::Nothing),
        code,
        message: text
            .lines()
            .rev()
            .find_map(|line| line.strip_prefix("eis-bench: "))
            .unwrap_or_default()
            .to_owned(),
        wrong,
        resumed,
    }
}

fn start(program: &str, words: &[&std::ffi::OsStr]) -> Child {
    Command::new(program)
        .args(words)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program")
}

#[expect(
    clippy::disallowed_methods,
    reason = "other processes are waited for, which know no bench time"
)]
fn wait_at_most(most: Duration, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while start.elapsed() < most && !done() {
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn wait(done: impl FnMut() -> bool) {
    wait_at_most(PATIENCE, done);
}

/// How a process ends, killed when it does not within the patience, and what it has said.
fn ended(child: &mut Child) -> (Option<i32>, String) {
    let messages = [
        child.stdout.take().map(listen),
        child.stderr.take().map(listen),
    ];
    let mut status = None;
    wait(|| {
        status = child.try_wait().ok().flatten();
        status.is_some()
    });
    if status.is_none() {
        let _ = child.kill();
        let _ = child.wait();
    }
    // A guardian that goes on may hold the pipes: what was said until now is enough.
    wait_at_most(LINGER, || {
        messages
            .iter()
            .flatten()
            .all(|(reader, _)| reader.is_finished())
    });
    let text = messages
        .iter()
        .flatten()
        .map(|(_, text)| lock(text).clone())
        .collect::<String>();
    (status.and_then(|status| status.code()), text)
}

/// Collects what comes out of a pipe.
fn listen(
    mut pipe: impl std::io::Read + Send + 'static,
) -> (std::thread::JoinHandle<()>, Arc<Mutex<String>>) {
    let text = Arc::new(Mutex::new(String::new()));
    let kept = text.clone();
    let reader = std::thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(count @ 1..) = pipe.read(&mut bytes) {
            lock(&kept).push_str(&String::from_utf8_lossy(&bytes[..count]));
        }
    });
    (reader, text)
}

fn status(folder: &Path) -> Option<String> {
    let text = fs::read_to_string(folder.join("benches/.eis-bench/demo/guardian.json")).ok()?;
    Some(
        serde_json::from_str::<serde_json::Value>(&text).ok()?["status"]
            .as_str()?
            .to_owned(),
    )
}

fn signal_to(child: &Child, (whom, signal): (u8, Signal), folder: &Path) {
    let guardian = || {
        let text = fs::read_to_string(folder.join("benches/.eis-bench/demo/guardian.json")).ok()?;
        i32::try_from(serde_json::from_str::<serde_json::Value>(&text).ok()?["pid"].as_i64()?).ok()
    };
    if whom >= 1
        && let Some(pid) = guardian()
    {
        let _ = kill(Pid::from_raw(pid), signal);
    }
    if whom != 1 {
        let _ = kill(
            Pid::from_raw(i32::try_from(child.id()).unwrap_or(i32::MAX)),
            signal,
        );
    }
}

/// Nothing has flowed for so long, bench s.
fn quiet_for(served: &Served, span_s: f64) -> bool {
    let samples = lock(&served.samples);
    let Some((now_s, _)) = samples.last() else {
        return false;
    };
    samples
        .iter()
        .rev()
        .take_while(|(at_s, _)| now_s - at_s < span_s)
        .all(|(_, amps)| amps.abs() <= NOTHING_A)
}

/// Charge beyond the envelope of the step, A·s, and the time from its first to its last instant, s.
fn beyond(job: Job, samples: &[(f64, f64)]) -> (f64, f64) {
    let excess = |(time_s, amps): (f64, f64)| {
        let (least, most) = asked_a(job, time_s);
        (1.1f64.mul_add(least, -NOTHING_A) - amps)
            .max(amps - 1.1f64.mul_add(most, NOTHING_A))
            .max(0.0)
    };
    let (mut charge, mut first, mut last) = (0.0, None, 0.0);
    for pair in samples.windows(2) {
        let over = excess(pair[1]);
        if over > 0.0 {
            charge += over * (pair[1].0 - pair[0].0);
            first.get_or_insert(pair[1].0);
            last = pair[1].0;
        }
    }
    (charge, first.map_or(0.0, |first| last - first))
}

/// Ratio of measured to true impedance at each point of an undisturbed run, by job. The bench has
/// no fixture check.
pub(crate) type Usual = Mutex<BTreeMap<Job, Vec<Complex64>>>;

/// The points of the cell's spectrum, each over the truth, with their frequencies, Hz.
fn shares(run: &Path, served: &Served) -> Vec<(f64, Complex64)> {
    let Ok(points) = read_spectrum_csv(&run.join("spectrum.csv")) else {
        return Vec::new();
    };
    let world = lock(&served.world);
    points
        .iter()
        .map(|point| {
            (
                point.freq_hz,
                point.z_ohm / world.truth_impedance(Fixture::Cell, point.freq_hz),
            )
        })
        .collect()
}

/// How many points are off by more than a hundredth without a word in what the program has said.
fn wrong_points(
    shares: &[(f64, Complex64)],
    usual: Option<&Vec<Complex64>>,
    messages: &str,
) -> usize {
    let Some(usual) = usual else { return 0 };
    let off = |((freq_hz, share), usual): &(&(f64, Complex64), &Complex64)| {
        (*share / *usual - 1.0).norm() > OFF && !messages.contains(&format!("{freq_hz:.4} Hz"))
    };
    shares.iter().zip(usual).filter(off).count()
}

/// Clears the latch, with every instrument sound again, and goes on with the run.
fn resume(
    program: &str,
    (folder, served): (&Path, &Served),
    usual: Option<&Vec<Complex64>>,
) -> String {
    let bench = folder.join("benches/demo.toml");
    let _ = ended(&mut start(
        program,
        &["safe".as_ref(), bench.as_os_str(), "--kill".as_ref()],
    ));
    let _ = ended(&mut start(
        program,
        &["clear".as_ref(), bench.as_os_str(), "--yes".as_ref()],
    ));
    let run = folder.join("run");
    let (code, text) = ended(&mut start(program, &["resume".as_ref(), run.as_os_str()]));
    let shares = shares(&run, served);
    let (points, wrong) = (shares.len(), wrong_points(&shares, usual, &text));
    match code {
        Some(0) if wrong == 0 => format!("finished, {points} points right"),
        Some(0) => format!("finished, {wrong} of {points} points wrong"),
        code => {
            let message = text
                .lines()
                .rev()
                .find_map(|line| line.strip_prefix("eis-bench: "))
                .unwrap_or_default();
            format!(
                "code {code:?}: {}",
                message.chars().take(80).collect::<String>()
            )
        }
    }
}
