//! 200 listeners and 50 requests per second while a sweep runs in real time: the cost to the sweep,
//! and when the listeners hear of it. `EIS_BENCH_LOAD_S=120 cargo test -p bench-daemon --test it --
//! --ignored --nocapture serve_load` measures it for two minutes.

use std::{
    sync::{
        Mutex,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use bench_core::journal::{Entry, read};
use instruments::clock::unix_time_s;

use crate::{
    serve_support::{Served, config, submit},
    support::{EXPERIMENT, Files, Ports, json},
};

const LISTENERS: usize = 200;
const REQUESTS_PER_S: usize = 50;
/// Seconds of load unless `EIS_BENCH_LOAD_S` sets another number.
const LOAD_S: f64 = 20.0;
/// Time that the plan allows a point beyond its wait (`Step::longest_s`), s.
const TOLERANCE_S: f64 = 60.0;
/// Longest time that the interlock allows between two readings, s.
const READING_AGE_S: f64 = 15.0;

#[expect(clippy::disallowed_methods, reason = "the load comes in its own time")]
fn sleep(seconds: f64) {
    std::thread::sleep(Duration::from_secs_f64(seconds.max(0.0)));
}

/// Returns a quantile of sorted numbers.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

/// Returns each point's planned and actual wait, and the longest time between two readings, s.
fn lateness(files: &Files, run: &str) -> (Vec<f64>, f64) {
    let folder = files.path("data/runs").join(run);
    let lines = read(&folder).unwrap().lines;
    let (mut begun, mut late) = (0.0, Vec::new());
    for line in &lines {
        match &line.entry {
            Entry::Intent { text, .. } => {
                let wait = text
                    .split_once("wait ")
                    .and_then(|(_, wait)| wait.trim_end_matches(" s").parse::<f64>().ok());
                begun = line.time_s.value() + wait.unwrap_or(0.0);
            }
            Entry::Point(_) => late.push(line.time_s.value() - begun),
            _ => {}
        }
    }
    let text = std::fs::read_to_string(folder.join("readings.csv")).unwrap();
    let sines: Vec<f64> = text
        .lines()
        .filter(|line| line.contains(",sine,"))
        .map(|line| line.split(',').next().unwrap().parse().unwrap())
        .collect();
    // Between two sweeps nothing is read as a sine.
    let gap = sines
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .filter(|gap| *gap < READING_AGE_S)
        .fold(0.0, f64::max);
    (late, gap)
}

fn files() -> Files {
    Files::short(14).edit(EXPERIMENT, "start = \"100 Hz\"", "start = \"2 Hz\"")
}

#[test]
#[ignore = "long drill"]
fn two_hundred_listeners_and_fifty_requests_per_second_cost_a_sweep_nothing() {
    let load_s = std::env::var("EIS_BENCH_LOAD_S").map_or(LOAD_S, |text| text.parse().unwrap());
    for loaded in [false, true] {
        let files = files();
        let _ports = Ports::serve(&files, 1.0, 1);
        config(&files, "");
        let served = Served::start(&files);
        let run = submit(&served, r#"{"experiment":"demo"}"#);
        served.points(1);
        let began_s = unix_time_s();
        let over = AtomicBool::new(!loaded);
        let (asked, failed) = (AtomicU64::new(0), AtomicU64::new(0));
        let (answers, heard) = (Mutex::new(Vec::new()), Mutex::new(Vec::new()));
        std::thread::scope(|scope| {
            for _ in 0..if loaded { LISTENERS } else { 0 } {
                scope.spawn(|| {
                    let mut mine = Vec::new();
                    for (_, kind, data) in served.listen("") {
                        if kind == "spectrum" {
                            let name = data["spectrum"]["name"]
                                .as_str()
                                .unwrap_or_default()
                                .to_owned();
                            mine.push((
                                name,
                                data["spectrum"]["points"].as_array().map_or(0, Vec::len),
                                unix_time_s(),
                            ));
                        }
                        if kind == "lost" || (kind == "run" && !data["ended"].is_null()) {
                            break;
                        }
                    }
                    heard.lock().unwrap().push(mine);
                });
            }
            for number in 0..if loaded { 10 } else { 0 } {
                let (served, over, run) = (&served, &over, &run);
                let (asked, failed, answers) = (&asked, &failed, &answers);
                scope.spawn(move || {
                    let paths = [
                        "/benches",
                        "/queue",
                        "/runs",
                        &format!("/runs/{run}"),
                        &format!("/runs/{run}/spectra"),
                    ]
                    .map(|path| format!("/api/v1{path}"));
                    let every_s = 10.0 / REQUESTS_PER_S as f64;
                    for turn in 0.. {
                        let due_s = began_s + every_s * (f64::from(turn) + 0.1 * f64::from(number));
                        if over.load(Ordering::Relaxed) || due_s > began_s + load_s {
                            return;
                        }
                        sleep(due_s - unix_time_s());
                        let sent_s = unix_time_s();
                        let answer =
                            served.ask("GET", &paths[turn as usize % paths.len()], ("", ""));
                        answers.lock().unwrap().push(unix_time_s() - sent_s);
                        asked.fetch_add(1, Ordering::Relaxed);
                        failed.fetch_add(u64::from(answer.status != 200), Ordering::Relaxed);
                    }
                });
            }
            // Longer than anything else waits here.
            while served.get("/benches/demo")["run"]["going"] == true {
                sleep(1.0);
            }
            let ended = served.ended(&run);
            over.store(true, Ordering::Relaxed);
            assert_eq!(ended["finished"], true, "{ended}");
        });
        let took_s = unix_time_s() - began_s;
        let (mut late, gap_s) = lateness(&files, &run);
        late.sort_by(f64::total_cmp);
        println!(
            "load {loaded}: {} points in {took_s:.1} s; beyond the planned wait a point took {:.2} \
            s in the middle, {:.2} s at most (tolerance {TOLERANCE_S} s); \
             longest time between two readings while current flowed {gap_s:.2} s",
            late.len(),
            quantile(&late, 0.5),
            quantile(&late, 1.0)
        );
        assert_eq!(late.len(), 42);
        assert!(quantile(&late, 1.0) < TOLERANCE_S, "{late:?}");
        if loaded {
            report(
                (asked.into_inner(), failed.into_inner()),
                &mut answers.into_inner().unwrap(),
                &heard.into_inner().unwrap(),
                (&files, &run),
            );
            let metrics = served.ask("GET", "/metrics", ("", "")).text();
            println!(
                "{}",
                metrics
                    .lines()
                    .filter(|line| line.contains("lagged_total") && !line.starts_with('#'))
                    .collect::<String>()
            );
        }
    }
}

type Heard = Vec<(String, usize, f64)>;

fn report(
    (asked, failed): (u64, u64),
    answers: &mut [f64],
    heard: &[Heard],
    (files, run): (&Files, &str),
) {
    answers.sort_by(f64::total_cmp);
    println!(
        "{asked} requests, {failed} failed; answered within {:.1} ms in the middle, {:.1} ms at 99 \
        %, {:.1} ms at most",
        1e3 * quantile(answers, 0.5),
        1e3 * quantile(answers, 0.99),
        1e3 * quantile(answers, 1.0)
    );
    let folder = files.path("data/runs").join(run);
    let start_s = json(&folder.join("manifest.json"))["started_unix_s"]
        .as_f64()
        .unwrap();
    let mut done: Vec<f64> = Vec::new();
    let mut cell = 0;
    for line in read(&folder).unwrap().lines {
        if let Entry::Point(point) = &line.entry
            && point.point.fixture == instruments::fixture::Fixture::Cell
        {
            cell += 1;
            done.push(start_s + line.time_s.value());
        }
    }
    // When each listener had each point of the cell's sweep.
    let mut delays: Vec<f64> = heard
        .iter()
        .flat_map(|mine| {
            done.iter().enumerate().map(move |(index, done_s)| {
                let first = mine
                    .iter()
                    .find(|(name, points, _)| name == "raw_cell" && *points > index);
                first.map_or(f64::INFINITY, |(_, _, heard_s)| heard_s - done_s)
            })
        })
        .collect();
    delays.sort_by(f64::total_cmp);
    println!(
        "{} listeners heard {cell} points of the cell's sweep each; after {:.2} s in the middle, \
        {:.2} s at 99 %, {:.2} s at most",
        heard.len(),
        quantile(&delays, 0.5),
        quantile(&delays, 0.99),
        quantile(&delays, 1.0)
    );
    assert!(
        failed == 0 && heard.len() == LISTENERS && delays.iter().all(|delay| delay.is_finite())
    );
}
