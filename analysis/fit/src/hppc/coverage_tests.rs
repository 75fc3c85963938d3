//! Whether the stated uncertainties cover the truth: random cells, noise and codes, whose resistances
//! follow in closed form.

use analysis_numeric::Rng;
use analysis_signal::series::TimeSeries;

use super::tests::{Cell, Part, log, table_of};
use super::*;

/// Cells of the test.
const CELLS: u64 = 100;
/// Seed of the first cell; the others follow.
const SEED: u64 = 20_261_129;

fn between(rng: &mut Rng, low: f64, high: f64) -> f64 {
    low * (high / low).powf(rng.uniform())
}

fn random_cell(rng: &mut Rng) -> Cell {
    let mut branches = vec![
        (between(rng, 1e-3, 2e-2), between(rng, 0.05, 0.5)),
        (between(rng, 1e-3, 2e-2), between(rng, 2.0, 20.0)),
    ];
    if rng.uniform() < 0.5 {
        branches.push((between(rng, 1e-3, 2e-2), between(rng, 30.0, 300.0)));
    }
    Cell {
        r_ohm: between(rng, 5e-3, 5e-2),
        branches,
        ocv_v: 3.3 + 0.7 * rng.uniform(),
        // 0.2 V to 1 V over 2 Ah to 5 Ah.
        v_per_coulomb: between(rng, 0.2, 1.0) / between(rng, 7200.0, 18_000.0),
    }
}

/// Rows of the simulation for each row of a log whose pulses begin anywhere between two rows.
const FINE: usize = 10;

/// Every tenth row, from a random one on.
fn thinned(series: &mut TimeSeries, from: usize) {
    let thin = |all: &mut Vec<f64>| {
        *all = all.iter().copied().skip(from).step_by(FINE).collect();
    };
    thin(&mut series.time_s);
    thin(&mut series.current_a);
    thin(&mut series.voltage_v);
    series.temperature_degc = None;
}

/// Distances from the truth in stated standard uncertainties, of all times of both pulses of a cell.
fn distances(seed: u64, start_logged: bool) -> Vec<f64> {
    let mut rng = Rng::new(seed);
    let cell = random_cell(&mut rng);
    let current_a = between(&mut rng, 1.0, 10.0);
    let rest_s = between(&mut rng, 40.0, 400.0).round();
    let step_s = if start_logged { 0.1 } else { 0.1 / FINE as f64 };
    let program: [Part; 5] = [
        (120.0, 0.0, step_s),
        (10.1, current_a, step_s),
        (rest_s, 0.0, step_s),
        (10.1, -0.75 * current_a, step_s),
        (60.0, 0.0, step_s),
    ];
    let mut series = log(&cell, &program);
    if !start_logged {
        thinned(&mut series, rng.below(FINE));
    }
    let (noise_v, noise_a) = (
        between(&mut rng, 5e-5, 1e-3),
        current_a * between(&mut rng, 1e-5, 3e-4),
    );
    let code_v = if rng.uniform() < 0.5 {
        between(&mut rng, 5e-5, 6.4e-4)
    } else {
        1e-6
    };
    for v in &mut series.voltage_v {
        *v = ((*v + noise_v * rng.normal()) / code_v).round() * code_v;
    }
    for a in &mut series.current_a {
        *a += noise_a * rng.normal();
    }
    let found = table_of(
        &series,
        &HppcOptions {
            start_logged,
            ..HppcOptions::default()
        },
    )
    .unwrap();
    assert_eq!(found.pulses.len(), 2, "seed {seed}");
    let all = found.pulses.iter().flat_map(|pulse| &pulse.resistances);
    all.map(|one| {
        let met = one.found.unwrap_or_else(|| panic!("seed {seed}: {one:?}"));
        (met.ohm - cell.pulse_ohm(met.row_s)) / met.sigma_ohm.unwrap()
    })
    .collect()
}

/// Parts of the resistances within one and two standard uncertainties.
fn within(start_logged: bool) -> [f64; 2] {
    let all = (SEED..SEED + CELLS).flat_map(|seed| distances(seed, start_logged));
    let all: Vec<f64> = all.collect();
    let part = [1.0, 2.0].map(|sigmas| {
        let count = all
            .iter()
            .filter(|distance| distance.abs() <= sigmas)
            .count();
        count as f64 / all.len() as f64
    });
    println!("{} resistances: {part:?} within 1 and 2 sigma", all.len());
    part
}

/// Three standard deviations of a binomial part. Resistances of one pulse share its trend: the pulses
/// are the independent trials.
fn bound(expected: f64) -> f64 {
    3.0 * (expected * (1.0 - expected) / (2.0 * CELLS as f64)).sqrt()
}

const EXPECTED: [f64; 2] = [0.6827, 0.9545];

#[test]
fn the_truth_lies_within_one_and_two_sigma_as_often_as_it_must() {
    for (met, expected) in within(true).into_iter().zip(EXPECTED) {
        let most = bound(expected);
        assert!(
            (met - expected).abs() <= most,
            "{met} of {expected} ± {most}"
        );
    }
}

#[test]
fn the_truth_is_covered_where_pulses_begin_between_two_rows() {
    // An error that is as likely anywhere in its range is within two standard uncertainties always.
    let [one, two] = within(false);
    let [least_one, least_two] = EXPECTED.map(|expected| expected - bound(expected));
    assert!(one >= least_one && two >= least_two, "{one} {two}");
}
