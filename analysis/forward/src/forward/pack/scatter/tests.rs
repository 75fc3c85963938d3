use super::super::thermal::PackThermal;
use super::*;
use crate::forward::CellWindow;
use analysis_model::{
    map::{CellMap, MapBranch, Surface},
    model::{Erm, RcBranch},
    ocv::OcvCurve,
    pack::Pack,
};

fn erm() -> Erm {
    Erm {
        r_ohm: 0.007,
        branches: vec![
            RcBranch {
                r_ohm: 0.0015,
                c_f: 10.0,
            },
            RcBranch {
                r_ohm: 0.003,
                c_f: 2000.0,
            },
        ],
    }
}

fn ocv() -> OcvSource {
    OcvSource::Curve(
        OcvCurve::monotone(4.2, vec![0.0, 0.2, 0.5, 1.0], vec![2.5, 3.4, 3.7, 4.2]).unwrap(),
    )
}

fn setup<'a>(cell: &'a Erm, ocv: &'a OcvSource, profile: &'a Profile) -> ScatterSetup<'a> {
    ScatterSetup {
        cell,
        map: None,
        ocv,
        pack: Pack::new(4, 3, 0.01).unwrap(),
        links: None,
        tab_ohm: 0.0,
        soc: 0.5,
        profile,
        window: CellWindow::THESIS,
        thermal: PackThermal::adiabatic(25.0, 66.5),
        max_step_s: 0.01,
    }
}

fn pulse(power_w: f64) -> Profile {
    Profile::new(
        "pulse",
        Demand::Power,
        Interpolation::Hold,
        &[(0.0, power_w), (2.0, 0.0), (3.0, 0.0)],
    )
    .unwrap()
}

#[test]
fn without_spread_every_draw_is_the_identical_pack() {
    let (cell, ocv, profile) = (erm(), ocv(), pulse(800.0));
    let met = scatter(
        &setup(&cell, &ocv, &profile),
        &Spread::NONE,
        Draws { draws: 5, seed: 1 },
    )
    .unwrap();
    assert!(met.outcomes.iter().all(|o| *o == met.identical));
    assert!(
        (met.identical.largest_share - 1.0).abs() < 1e-12
            && met.identical.soc_spread_end.unwrap() < 1e-15
    );
    assert!(met.step_error_v < 1e-5, "{}", met.step_error_v);
    assert!(met.step_error_k < 1e-4, "{}", met.step_error_k);
    // At t = 0 the branches are empty: V = (E + √(E² − 4PR))/2 of 14.8 V behind 7 mΩ·4/3 + 10 mΩ;
    // the end of the pulse is lower.
    let r = 0.007 * 4.0 / 3.0 + 0.01;
    let first = 0.5 * (14.8 + (14.8f64.powi(2) - 4.0 * 800.0 * r).sqrt());
    let current = (14.8 - first) / r;
    assert!((met.bands[0].identical_v - (3.7 - 0.007 * current / 3.0)).abs() < 1e-12);
    assert!(
        met.identical.min_cell_v < met.bands[0].identical_v
            && (met.identical.min_cell_time_s - 2.0).abs() < 1e-9
    );
    assert!((met.identical.energy_j - 1600.0).abs() < 1e-6);
    assert_eq!(met.leaving().0, 0.0);
}

#[test]
fn a_peak_of_one_step_is_in_the_bands() {
    let rows: Vec<(f64, f64)> = (0..5000)
        .map(|k| (0.002 * f64::from(k), if k == 2345 { 900.0 } else { 50.0 }))
        .collect();
    let profile = Profile::new("peak", Demand::Power, Interpolation::Hold, &rows).unwrap();
    let (cell, ocv) = (erm(), ocv());
    let met = scatter(
        &setup(&cell, &ocv, &profile),
        &Spread::NONE,
        Draws { draws: 2, seed: 1 },
    )
    .unwrap();
    let lowest = met
        .bands
        .iter()
        .map(|r| r.lowest_v.p50)
        .fold(f64::INFINITY, f64::min);
    assert_eq!(lowest, met.identical.min_cell_v);
    assert!(met.bands.len() <= 502 && met.bands.iter().any(|r| r.demand == 900.0));
}

#[test]
fn shares_at_the_first_instant_follow_the_spread_of_resistance() {
    // Of three cells with conductances 1 ± σ each takes its part of the mean: the standard
    // deviation of a share is σ·√(2/3), the largest of twelve such is above 1. Only R scatters; a
    // current step, one step long.
    let (cell, ocv) = (
        Erm {
            r_ohm: 0.01,
            branches: Vec::new(),
        },
        OcvSource::Constant(3.7),
    );
    let profile = Profile::new(
        "step",
        Demand::Current,
        Interpolation::Hold,
        &[(0.0, 30.0), (0.001, 30.0)],
    )
    .unwrap();
    let one_group = ScatterSetup {
        pack: Pack::new(1, 3, 0.0).unwrap(),
        ..setup(&cell, &ocv, &profile)
    };
    let spread = Spread {
        r: 0.01,
        ..Spread::NONE
    };
    let met = scatter(
        &one_group,
        &spread,
        Draws {
            draws: 4000,
            seed: 3,
        },
    )
    .unwrap();
    let mean = met
        .outcomes
        .iter()
        .map(|o| o.largest_share - 1.0)
        .sum::<f64>()
        / 4000.0;
    // Mean of the largest of three normals is 0.8463 σ; subtracting the mean of the three does not
    // change it.
    assert!((mean - 0.008_463).abs() < 3.0e-4, "{mean}");
}

#[test]
fn weaker_cells_leave_the_window_first_and_a_seed_is_a_result() {
    let (cell, ocv, profile) = (erm(), ocv(), pulse(1000.0));
    let base = setup(&cell, &ocv, &profile);
    let spread = Spread {
        r: 0.05,
        rk: 0.02,
        ck: 0.02,
        capacity: 0.01,
        soc: 0.01,
    };
    let first = scatter(
        &base,
        &spread,
        Draws {
            draws: 200,
            seed: 9,
        },
    )
    .unwrap();
    let again = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let again = again.install(|| {
        scatter(
            &base,
            &spread,
            Draws {
                draws: 200,
                seed: 9,
            },
        )
        .unwrap()
    });
    assert_eq!(first, again);
    assert_ne!(
        first.outcomes,
        scatter(
            &base,
            &spread,
            Draws {
                draws: 200,
                seed: 10
            }
        )
        .unwrap()
        .outcomes
    );
    let lowest = Percentiles::of(first.outcomes.iter().map(|o| o.min_cell_v));
    assert!(
        lowest.p50 < first.identical.min_cell_v,
        "the worst of twelve is below the mean"
    );
    // A limit at the median of the lowest voltages is broken by half of the draws.
    let tight = ScatterSetup {
        window: CellWindow {
            low_v: lowest.p50,
            high_v: 4.2,
        },
        ..base
    };
    let (share, [low, high]) = scatter(
        &tight,
        &spread,
        Draws {
            draws: 200,
            seed: 9,
        },
    )
    .unwrap()
    .leaving();
    assert!(
        (share - 0.5).abs() < 0.006 && low < 0.44 && high > 0.56,
        "{share} {low} {high}"
    );
    assert!(
        first
            .outcomes
            .iter()
            .all(|o| o.largest_share > 1.0 && o.soc_spread_end.unwrap() > 0.0)
    );
}

#[test]
fn too_much_power_is_a_result_and_nonsense_an_error() {
    let (cell, ocv, profile) = (erm(), ocv(), pulse(1e5));
    let met = scatter(
        &setup(&cell, &ocv, &profile),
        &Spread::NONE,
        Draws { draws: 2, seed: 0 },
    )
    .unwrap();
    assert!(!met.identical.feasible && met.leaving().0 == 1.0 && met.short_of_power() == 1.0);
    let bad = Spread {
        r: -0.1,
        ..Spread::NONE
    };
    let text = scatter(
        &setup(&cell, &ocv, &profile),
        &bad,
        Draws { draws: 2, seed: 0 },
    )
    .unwrap_err()
    .to_string();
    assert_eq!(
        text,
        "spread between cells: expected a standard deviation from 0 to 0.5, met -0.1"
    );
    let nothing = scatter(
        &setup(&cell, &ocv, &profile),
        &Spread::NONE,
        Draws { draws: 0, seed: 0 },
    )
    .unwrap_err()
    .to_string();
    assert_eq!(nothing, "number of draws: expected from 1 to 1e5, met 0");
}

#[test]
fn more_cells_than_fit_are_refused() {
    let (cell, ocv, profile) = (erm(), ocv(), pulse(800.0));
    let met = |series, parallel, draws| {
        let setup = ScatterSetup {
            pack: Pack::new(series, parallel, 0.0).unwrap(),
            ..setup(&cell, &ocv, &profile)
        };
        scatter(&setup, &Spread::NONE, Draws { draws, seed: 1 })
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        met(100_000, 100_000, 1),
        "cells of the pack, S·P: expected at most 1e5, met 10000000000"
    );
    assert_eq!(
        met(1, 1, 1_000_000),
        "number of draws: expected from 1 to 1e5, met 1000000"
    );
    assert_eq!(
        met(100, 100, 20_000),
        "cells of all draws, S·P times draws: expected at most 1e8, met 200000000"
    );
}

/// The cell of these tests as a map that doubles its resistances at low charge and in the cold.
fn map() -> CellMap {
    let surface = |r_ohm: f64| Surface {
        activation_j_per_mol: 30e3,
        r_ohm: vec![vec![4.0 * r_ohm, 2.0 * r_ohm], vec![2.0 * r_ohm, r_ohm]],
        sigma_ohm: Vec::new(),
    };
    let branches = erm().branches.into_iter().map(|branch| MapBranch {
        extrapolated: false,
        tau_s: branch.time_constant_s(),
        resistance: surface(branch.r_ohm),
    });
    CellMap {
        soc: vec![0.2, 0.6],
        temperature_degc: vec![0.0, 25.0],
        series: surface(0.007),
        branches: branches.collect(),
        ocv_offset_v: vec![0.0; 2],
        ocv_v_per_k: vec![0.0; 2],
        ocv_temperature_degc: 25.0,
        most_current_a: None,
        charge_transfer: None,
        thermal: None,
        voltage_error: None,
    }
}

#[test]
fn cells_that_leave_the_map_and_cells_of_their_own_are_named() {
    let (cell, ocv, map) = (erm(), ocv(), map());
    let profile = Profile::constant(Demand::Current, 25.2, 600.0).unwrap();
    let setup = ScatterSetup {
        map: Some(&map),
        soc: 0.35,
        max_step_s: 2.0,
        ..setup(&cell, &ocv, &profile)
    };
    // 2C for ten minutes; the small cell is in group 2.
    let mut pack = draw(&Spread::NONE, &setup, &mut Rng::new(0));
    pack[4].capacity = 0.8;
    let met = scatter_cells(&setup, std::slice::from_ref(&pack)).unwrap();
    let left = met.outcomes[0].outside_map.unwrap();
    assert_eq!(left.soc_cell, Position { group: 2, place: 2 });
    // Equal cells go from 0.35 down by 1/3.
    let equal = met.identical.outside_map.unwrap().outside;
    assert!(
        (equal.soc - (0.2 - (0.35 - 1.0 / 3.0))).abs() < 1e-9,
        "{equal:?}"
    );
    assert!(left.outside.soc > equal.soc + 0.01);
    // 66.5 J/K without a path: some kelvin above 25 °C.
    let rise_k = met.identical.temperatures.hottest_degc - 25.0;
    assert!(
        (equal.temperature_k - rise_k).abs() < 1e-7 && rise_k > 3.0,
        "{rise_k}"
    );
    assert!((met.identical.hottest_rise_k - rise_k).abs() < 1e-9);
    let soc = met.identical.soc_range.unwrap();
    assert!((soc.lowest - (0.35 - 1.0 / 3.0)).abs() < 1e-9 && soc.highest == 0.35);
    assert_eq!(met.outcomes[0].unsettled_steps, 0);
    pack[1].erm = Some(erm());
    let error = scatter_cells(&setup, &[pack]).unwrap_err().to_string();
    let text =
        "cells with a model of their own in a pack whose cells follow a map: expected none, met 1";
    assert_eq!(error, text);
    let constant = OcvSource::Constant(3.7);
    let held = ScatterSetup {
        ocv: &constant,
        ..setup
    };
    let draws = Draws { draws: 1, seed: 1 };
    let error = scatter(&held, &Spread::NONE, draws).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("an OCV curve for a model with a map")
    );
    let cold = ScatterSetup {
        thermal: PackThermal {
            neighbour_w_per_k: -1.0,
            ..setup.thermal
        },
        ..setup
    };
    let error = scatter(&cold, &Spread::NONE, draws).unwrap_err();
    assert!(error.to_string().contains("conductance between neighbours"));
}

#[test]
#[allow(
    clippy::disallowed_methods,
    reason = "the time is printed and not judged"
)]
fn large_packs_with_a_map_run_in_a_printed_time() {
    let (cell, ocv, map) = (erm(), ocv(), map());
    let rows: Vec<(f64, f64)> = (0..=500)
        .map(|k| {
            (
                0.02 * f64::from(k),
                1500.0 + 1000.0 * (0.3 * f64::from(k)).sin(),
            )
        })
        .collect();
    let profile = Profile::new("load", Demand::Power, Interpolation::Hold, &rows).unwrap();
    let plain = ScatterSetup {
        pack: Pack::new(16, 3, 0.03).unwrap(),
        ..setup(&cell, &ocv, &profile)
    };
    let mapped = ScatterSetup {
        map: Some(&map),
        ..plain
    };
    let spread = Spread {
        r: 0.01,
        capacity: 0.005,
        soc: 0.005,
        ..Spread::NONE
    };
    let draws = Draws { draws: 2, seed: 2 };
    for (name, setup) in [("one point", &plain), ("a map", &mapped)] {
        let start = std::time::Instant::now();
        let met = scatter(setup, &spread, draws).unwrap();
        eprintln!(
            "16S3P, {} draws, {name}: {:?}",
            draws.draws,
            start.elapsed()
        );
        let sound = |outcome: &Outcome| outcome.feasible && outcome.unsettled_steps == 0;
        assert!(met.outcomes.iter().all(sound));
    }
}
