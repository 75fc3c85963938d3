//! Speed of the sinusoid fit: 4 channels of 10⁷ ADC codes.

use std::time::Instant;

use analysis::sine::{
    Channel, CodeScale, FitOptions, Record, fit_free_frequency, fit_known_frequency, relaxations,
};
use rayon::prelude::*;

use crate::{Row, Unit, best_s};

const REPEATS: usize = 7;
const INTERVAL_S: f64 = 1e-6;

/// Samples per second of wall time on a number of threads: the best of some rounds.
fn wall(threads: usize, samples: usize, work: impl Fn() + Sync + Send) -> f64 {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    let once = || {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    pool.install(|| samples as f64 / (0..=REPEATS).map(|_| once()).fold(f64::INFINITY, f64::min))
}

/// Samples per second of processor time on one thread.
fn cpu(samples: usize, work: impl Fn() + Sync + Send) -> f64 {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    pool.install(|| samples as f64 / best_s(REPEATS + 1, &work))
}

/// Returns the sum of all samples, with the widest registers there are.
fn read(codes: &[Vec<i16>]) -> i16 {
    let sum = |part: &[i16]| {
        pulp::Arch::new().dispatch(|| part.iter().fold(0i16, |sum, code| sum.wrapping_add(*code)))
    };
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
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24) * 4.0 - 2.0
    };
    let one = |channel: usize| {
        let value = |n: usize| {
            1500.0
                * (std::f64::consts::TAU * freq_hz * n as f64 * INTERVAL_S + channel as f64).cos()
        };
        (0..count)
            .map(|n| (value(n) + noise()).round() as i16)
            .collect()
    };
    [0, 1, 2, 3].map(one).to_vec()
}

/// Returns the figures.
pub(crate) fn rows() -> Vec<Row> {
    let freq_hz = 1234.5;
    let codes = signal(10_000_000, freq_hz);
    let scale = CodeScale {
        volts_per_code: 1e-3,
        offset_v: 0.0,
        code_min: -2048,
        code_max: 2047,
        code_step: 1,
    };
    let channels: Vec<Channel<'_>> = codes
        .iter()
        .map(|codes| Channel::codes(codes, scale))
        .collect();
    let record = Record {
        channels: &channels,
        interval_s: INTERVAL_S,
    };
    let samples = 4 * codes[0].len();
    let (cores, plain) = (
        std::thread::available_parallelism().map_or(1, usize::from),
        FitOptions::default(),
    );
    let rich = FitOptions {
        harmonics: vec![2, 3],
        ..FitOptions::default()
    }
    .with_mains(50.0, 2);
    let settling = FitOptions {
        decays_s: relaxations(INTERVAL_S * codes[0].len() as f64),
        ..FitOptions::default()
    };
    let known = |options: &FitOptions| {
        std::hint::black_box(fit_known_frequency(&record, freq_hz, options).unwrap());
    };
    let free = || {
        std::hint::black_box(
            fit_free_frequency(&record, Some(freq_hz * (1.0 + 1e-7)), &plain).unwrap(),
        );
    };
    let all = wall(cores, samples, || known(&plain));
    let reading = wall(cores, samples, || {
        std::hint::black_box(read(&codes));
    });
    let unit = Unit::PerSecond("samples");
    vec![
        Row::new(
            "sine-known",
            "sinusoid fit, known frequency, per second of one core",
            cpu(samples, || known(&plain)),
            unit,
        ),
        Row::new(
            "",
            &format!("  the same on {cores} cores, per second"),
            all,
            unit,
        )
        .noted(format!("{:.0} % of the read rate", 100.0 * all / reading)),
        Row::new(
            "",
            &format!("  reading the same samples on {cores} cores, per second"),
            reading,
            unit,
        ),
        Row::new(
            "sine-settling",
            "  with relaxations, per second of one core",
            cpu(samples, || known(&settling)),
            unit,
        )
        .noted(format!("{} time constants", settling.decays_s.len())),
        Row::new(
            "",
            "  with 2 harmonics and mains, per second of one core",
            cpu(samples, || known(&rich)),
            unit,
        ),
        Row::new(
            "",
            "  free frequency, per second of one core",
            cpu(samples, free),
            unit,
        ),
    ]
}
