//! Many runs: measures the speed and memory of scans and queries.
//!
//! `cargo test --workspace --test catalog -- --ignored --nocapture`. `EIS_BENCH_CATALOG_RUNS` is
//! their number, and `EIS_BENCH_CATALOG_FOLDER` a folder in which they are kept for the next time.

use std::{
    env, fs,
    path::{Path, PathBuf},
    time::Instant,
};

use analysis_catalog::{Catalog, query::Filter, record::CatalogVerdict, scan::ScanOptions};

use sha2::{Digest, Sha256};

use crate::made::{Made, filter};

/// Default number of runs.
const RUNS: usize = 100_000;
/// Run folders in one folder.
const TOGETHER: usize = 1000;
/// One run in this many has a diagnosis.
const DIAGNOSED: usize = 10;
/// Batch and experiment that few runs have.
const RARE: &str = "rare";
/// One run in this many has them, among the first `RARE_UNTIL` runs.
const RARELY: usize = 100;
const RARE_UNTIL: usize = 10_000;
/// Questions of each kind.
const QUESTIONS: usize = 200;

#[expect(
    clippy::disallowed_methods,
    reason = "a drill measures the time on the wall"
)]
fn now() -> Instant {
    Instant::now()
}

/// Memory of this process now and at most, MB.
fn memory_mb() -> [f64; 2] {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    ["VmRSS:", "VmHWM:"].map(|key| {
        let line = status.lines().find(|line| line.starts_with(key)).unwrap();
        let kb: f64 = line.split_whitespace().nth(1).unwrap().parse().unwrap();
        kb / 1024.0
    })
}

/// Returns the time that all threads of this process have computed, s.
fn computed_s() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap();
    let (_, rest) = stat.rsplit_once(") ").unwrap();
    let ticks = rest.split_whitespace().skip(11).take(2);
    // Linux reports it in hundredths of a second.
    ticks.map(|text| text.parse::<f64>().unwrap() / 100.0).sum()
}

fn folder() -> (PathBuf, Option<tempfile::TempDir>) {
    match env::var("EIS_BENCH_CATALOG_FOLDER") {
        Ok(folder) => (folder.into(), None),
        Err(_) => {
            let folder = tempfile::tempdir().unwrap();
            (folder.path().to_path_buf(), Some(folder))
        }
    }
}

fn is_rare(run: usize) -> bool {
    run % RARELY == 3 && run < RARE_UNTIL
}

fn make(root: &Path, number: usize) {
    for run in 0..number {
        let within = root.join(format!("{:03}", run / TOGETHER));
        let made = Made {
            refused: usize::from(run % 50 == 7),
            batch: if is_rare(run) { RARE } else { "2026-03" }.to_owned(),
            experiment: if is_rare(run) { RARE } else { "ageing" }.to_owned(),
            ..Made::of(run)
        };
        if within.join(made.name()).is_dir() {
            continue;
        }
        let folder = made.write(&within);
        // Of each cell, which comes back after 100 runs.
        if (run + run / 100) % DIAGNOSED == 0 {
            made.diagnose(&folder.join("diagnosis"));
        }
    }
}

fn scan(path: &Path, root: &Path) -> usize {
    let computed = computed_s();
    let (catalog, began) = (Catalog::make(path).unwrap(), now());
    let roots = [root.to_path_buf()];
    let scanned = catalog.scan(&roots, &ScanOptions::plain()).unwrap();
    let took_s = began.elapsed().as_secs_f64();
    eprintln!(
        "scan: {} runs, {} read, {took_s:.1} s, {:.0} runs/s, {:.1} s of processors; memory {:.0?} MB",
        scanned.runs,
        scanned.read,
        scanned.runs as f64 / took_s,
        computed_s() - computed,
        memory_mb()
    );
    scanned.read
}

/// Executes one kind of query many times and prints the median and the slowest of a hundred.
fn ask(path: &Path, kind: &str, question: impl Fn(&Catalog, usize)) {
    let computed = computed_s();
    let mut times: Vec<f64> = (0..QUESTIONS)
        .map(|number| {
            let began = now();
            let catalog = Catalog::open(path).unwrap();
            question(&catalog, number);
            1.0e3 * began.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times[(share * (times.len() - 1) as f64).round() as usize];
    let mean_ms = 1.0e3 * (computed_s() - computed) / QUESTIONS as f64;
    eprintln!(
        "{kind}: median {:.1} ms, p99 {:.1} ms, {mean_ms:.1} ms of a processor",
        at(0.5),
        at(0.99)
    );
}

fn questions(path: &Path, number: usize) {
    let runs = |filter: Filter| move |catalog: &Catalog| drop(catalog.runs(&filter).unwrap());
    let text = |text: String| Some(text);
    let cell = |k: usize| format!("C{:02}", k % 100);
    ask(path, "latest runs", |catalog, _| {
        runs(Filter::default())(catalog);
    });
    ask(path, "runs of a cell", |catalog, k| {
        runs(filter(&[("cell", &cell(k))]))(catalog);
    });
    ask(path, "doubtful runs of a bench", |catalog, k| {
        let bench = text(format!("bench{}", k % 5));
        let verdict = Some(CatalogVerdict::Doubtful);
        runs(Filter {
            bench,
            verdict,
            ..Filter::default()
        })(catalog);
    });
    ask(path, "runs of a day", |catalog, k| {
        let from = Made::of(k * number / QUESTIONS).started_unix_s();
        let (from_unix_s, to_unix_s) = (Some(from), Some(from + 86_400.0));
        runs(Filter {
            from_unix_s,
            to_unix_s,
            ..Filter::default()
        })(catalog);
    });
    ask(path, "a common word", |catalog, _| {
        runs(filter(&[("text", "ageing")]))(catalog);
    });
    ask(path, "a rare word", |catalog, k| {
        let name = Made::of(k * number / QUESTIONS).name();
        runs(filter(&[("text", &name)]))(catalog);
    });
    ask(path, "a word that is nowhere", |catalog, _| {
        runs(filter(&[("text", "swollen")]))(catalog);
    });
    ask(path, "spectra of a cell", |catalog, k| {
        let filter = filter(&[("cell", &cell(k))]);
        drop(catalog.spectra(&filter).unwrap());
    });
    ask(path, "cells", |catalog, _| {
        drop(catalog.cells(&Filter::default()).unwrap());
    });
    ask(path, "a run", |catalog, k| {
        let name = Made::of(k * number / QUESTIONS).name();
        assert_eq!(catalog.show(&name).unwrap().spectra.len(), 1);
    });
    ask(path, "ageing of a cell", |catalog, k| {
        let filter = filter(&[("cell", &cell(k))]);
        assert!(!catalog.ageing(&filter, None).unwrap().points.is_empty());
    });
}

/// Questions for conditions that few runs meet, many, or none, and that no table is in the order of.
fn questions_of_conditions(path: &Path) {
    let conditions = [
        ("a rare batch", filter(&[("batch", RARE)])),
        ("a common batch", filter(&[("batch", "2026-03")])),
        ("a serial number", filter(&[("serial", "P45B-0042")])),
        ("a rare experiment", filter(&[("experiment", RARE)])),
        ("a common experiment", filter(&[("experiment", "ageing")])),
        ("a verdict", filter(&[("verdict", "doubtful")])),
        ("a verdict that none has", filter(&[("verdict", "failed")])),
        ("a bench", filter(&[("bench", "bench2")])),
        ("trips, none", filter(&[("trip", "")])),
        ("a common word", filter(&[("text", "ageing")])),
        ("a rare word", filter(&[("text", "run042")])),
    ];
    for (name, filter) in &conditions {
        ask(path, &format!("runs, {name}"), |catalog, _| {
            drop(catalog.runs(filter).unwrap());
        });
        ask(path, &format!("spectra, {name}"), |catalog, _| {
            drop(catalog.spectra(filter).unwrap());
        });
        ask(path, &format!("fits, {name}"), |catalog, _| {
            drop(catalog.fits(filter).unwrap());
        });
        ask(path, &format!("diagnoses, {name}"), |catalog, _| {
            drop(catalog.diagnoses(filter).unwrap());
        });
        ask(path, &format!("cells, {name}"), |catalog, _| {
            drop(catalog.cells(filter).unwrap());
        });
    }
}

/// Hash of everything that is known of each run, with its spectra, fits, events and diagnoses, and of
/// the cells.
fn hash_of_all(path: &Path) -> Vec<u8> {
    let catalog = Catalog::open(path).unwrap();
    let mut hash = Sha256::new();
    for run in catalog.all_runs(&Filter::default()).unwrap() {
        let shown = catalog.show(&run.run).unwrap();
        hash.update(serde_json::to_vec(&shown).unwrap());
    }
    let cells = Filter {
        most: RUNS,
        ..Filter::default()
    };
    hash.update(serde_json::to_vec(&catalog.cells(&cells).unwrap()).unwrap());
    hash.finalize().to_vec()
}

#[test]
#[ignore = "long drill"]
fn many_runs_are_scanned_and_asked() {
    let number = env::var("EIS_BENCH_CATALOG_RUNS").map_or(RUNS, |number| number.parse().unwrap());
    let (root, _kept) = folder();
    let runs = root.join("runs");
    let began = now();
    make(&runs, number);
    eprintln!("made in {:.0} s", began.elapsed().as_secs_f64());
    let path = root.join("catalog.sqlite");
    let _ = fs::remove_file(&path);
    assert_eq!(scan(&path, &runs), number);
    assert_eq!(scan(&path, &runs), 0);
    eprintln!("file: {} MB", fs::metadata(&path).unwrap().len() >> 20);
    questions(&path, number);
    questions_of_conditions(&path);
    let again = root.join("again.sqlite");
    let _ = fs::remove_file(&again);
    scan(&again, &runs);
    assert_eq!(hash_of_all(&path), hash_of_all(&again));
}
