//! Speed of the sinusoid fit: 4 channels of 10⁷ ADC codes, known frequency.
//!
//! Prints samples per second of CPU time on one thread, samples per second on all cores, and the rate at which the machine reads the same samples.
//! With `--json` one object per line, for a script that puts other programs beside it. `--samples N` changes the length of a channel.

#![allow(clippy::print_stdout, clippy::disallowed_methods, reason = "a benchmark reads the clock and prints")]
#![allow(clippy::unwrap_used, reason = "a benchmark that fails ends")]

use std::time::Instant;

use analysis::sine::{Channel, CodeScale, FitOptions, Record, fit_free_frequency, fit_known_frequency};
use rayon::prelude::*;

const REPEATS: usize = 7;
const INTERVAL_S: f64 = 1e-6;

/// User and system time of this process, s: fields 14 and 15 of /proc/self/stat count hundredths.
fn cpu_s() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let (_, fields) = stat.rsplit_once(')')?;
    let ticks: Vec<f64> = fields.split_whitespace().skip(11).take(2).filter_map(|field| field.parse().ok()).collect();
    (ticks.len() == 2).then(|| (ticks[0] + ticks[1]) / 100.0)
}

/// One line of the table, in samples per second.
struct Line {
    what: &'static str,
    per_cpu_second: Option<f64>,
    best: f64,
}

/// Runs `work` often enough for the CPU clock to tell, on a number of threads.
fn measure(what: &'static str, threads: usize, samples: usize, work: impl Fn() + Sync + Send) -> Line {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        work();
        let (mut best_s, mut rounds) = (f64::INFINITY, 0);
        let (start, cpu) = (Instant::now(), cpu_s());
        while rounds < REPEATS || start.elapsed().as_secs_f64() < 1.0 {
            let round = Instant::now();
            work();
            best_s = best_s.min(round.elapsed().as_secs_f64());
            rounds += 1;
        }
        let per_cpu_second = cpu.zip(cpu_s()).map(|(before, after)| (samples * rounds) as f64 / (after - before));
        Line { what, per_cpu_second, best: samples as f64 / best_s }
    })
}

/// Sum of all samples, with the widest registers there are.
fn read(codes: &[Vec<i16>]) -> i16 {
    let sum = |part: &[i16]| pulp::Arch::new().dispatch(|| part.iter().fold(0i16, |sum, code| sum.wrapping_add(*code)));
    codes
        .iter()
        .flat_map(|channel| channel.chunks(1 << 16))
        .collect::<Vec<_>>()
        .par_iter()
        .map(|part| sum(part))
        .reduce(|| 0, i16::wrapping_add)
}

fn signal(count: usize, freq_hz: f64) -> Vec<Vec<i16>> {
    let mut state = 1u64;
    let mut noise = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24) * 4.0 - 2.0
    };
    let one = |channel: usize| {
        let value = |n: usize| 1500.0 * (std::f64::consts::TAU * freq_hz * n as f64 * INTERVAL_S + channel as f64).cos();
        (0..count).map(|n| (value(n) + noise()).round() as i16).collect()
    };
    [0, 1, 2, 3].map(one).to_vec()
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let json = args.iter().any(|arg| arg == "--json");
    let after = |name: &str| args.iter().position(|arg| arg == name).and_then(|at| args.get(at + 1));
    let count: usize = after("--samples").and_then(|text| text.parse().ok()).unwrap_or(10_000_000);
    let freq_hz = 1234.5;
    let codes = signal(count, freq_hz);
    let scale = CodeScale { volts_per_code: 1e-3, offset_v: 0.0, code_min: -2048, code_max: 2047 };
    let channels: Vec<Channel<'_>> = codes.iter().map(|codes| Channel::codes(codes, scale)).collect();
    let record = Record { channels: &channels, interval_s: INTERVAL_S };
    let samples = 4 * count;
    let (cores, plain) = (std::thread::available_parallelism().map_or(1, usize::from), FitOptions::default());
    let rich = FitOptions { harmonics: vec![2, 3], ..FitOptions::default() }.with_mains(50.0, 2);
    let known = |options: &FitOptions| {
        std::hint::black_box(fit_known_frequency(&record, freq_hz, options).unwrap());
    };
    let lines = [
        measure("known frequency, one thread", 1, samples, || known(&plain)),
        measure("known frequency, all cores", cores, samples, || known(&plain)),
        measure("read, all cores", cores, samples, || {
            std::hint::black_box(read(&codes));
        }),
        measure("known frequency, 2 harmonics, mains, one thread", 1, samples, || known(&rich)),
        measure("free frequency, one thread", 1, samples, || {
            std::hint::black_box(fit_free_frequency(&record, Some(freq_hz * (1.0 + 1e-7)), &plain).unwrap());
        }),
    ];
    for line in &lines {
        let cpu = line.per_cpu_second.map_or(f64::NAN, |rate| rate / 1e6);
        if json {
            let cpu = if cpu.is_finite() { format!("{cpu:.1}") } else { "null".to_owned() };
            let best = line.best / 1e6;
            println!(
                r#"{{"bench":"sine","what":"{}","samples":{samples},"msamples_per_cpu_s":{cpu},"msamples_per_s":{best:.1}}}"#,
                line.what
            );
        } else {
            println!("{:<50}{cpu:>8.0} Msamples per CPU-second {:>8.0} Msamples/s at best", line.what, line.best / 1e6);
        }
    }
    if !json {
        println!("{:<50}{:>8.0} % of the read rate", "known frequency, all cores", 100.0 * lines[1].best / lines[2].best);
    }
}
