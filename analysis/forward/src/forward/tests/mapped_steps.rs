//! Steps of a fixed length of models with a map, against the simulation with error control.

use super::mapped::map;
use super::*;
use analysis_model::map::{ChargeTransfer, Thermal};

/// The kinds of a map: linear or bent, at the temperature of the surroundings or with heat.
fn models(pack: Pack) -> Vec<(String, SimModel)> {
    let mut models = Vec::new();
    for (bent, heated) in [(false, false), (true, false), (false, true), (true, true)] {
        let thermal = heated.then_some(Thermal {
            capacity_j_per_k: 60.0,
            resistance_k_per_w: 5.0,
        });
        let mut map = map(
            |z, node| (2.0 - z) * if node == 0 { 2.5 } else { 1.0 },
            thermal,
        );
        map.ocv_offset_v = vec![0.01, -0.004, 0.002];
        map.ocv_v_per_k = vec![2e-4, 0.0, -1e-4];
        map.charge_transfer = bent.then_some(ChargeTransfer {
            voltage_v: 0.06,
            slowest_s: 1.0,
        });
        let name = format!("bent {bent}, heated {heated}");
        models.push((name, SimModel::mapped(map, curve(), pack, 12.0).unwrap()));
    }
    models
}

/// The power of a walking robot.
fn walking() -> Profile {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../fixtures/data/profiles/walking.csv"
    );
    let text = std::fs::read_to_string(path).unwrap();
    let list: Vec<(f64, f64)> = text
        .lines()
        .skip(1)
        .map(|line| {
            let (time_s, power_w) = line.split_once(',').unwrap();
            (time_s.parse().unwrap(), power_w.parse().unwrap())
        })
        .collect();
    rows(Demand::Power, Interpolation::Hold, &list)
}

fn outcome(model: &SimModel, state: &SimState, profile: &Profile, step_s: f64) -> BatchOutcome {
    let cell = BatchCell {
        model,
        state,
        scale: 1.0,
    };
    let options = BatchOptions {
        beyond: Beyond::Clamp,
        max_step_s: step_s,
    };
    simulate_batch(&[cell], profile, &options)
        .unwrap()
        .remove(0)
}

/// Voltage behind the series resistance of two states of a model apart, V per cell.
fn apart_v(model: &SimModel, a: &SimState, b: &SimState) -> f64 {
    let e_v = |state: &SimState| model.ocv_v(state.soc).0 - state.v_rc_v.iter().sum::<f64>();
    (e_v(a) - e_v(b)).abs() / f64::from(model.pack.series)
}

#[test]
fn a_walking_robot_draws_the_voltage_of_the_simulation_from_steps_of_second_order() {
    let pack = Pack::new(16, 3, 0.004).unwrap();
    let profile = walking();
    for (name, model) in models(pack) {
        let start = model.rest(0.6).unwrap();
        let options = SimOptions {
            beyond: Beyond::Clamp,
            ..SimOptions::default()
        };
        let run = simulate(&model, &start, &profile, &options).unwrap();
        let at = |step_s: f64| outcome(&model, &start, &profile, step_s);
        let met = at(1e-3);
        let lowest_v = 2.5 + run.summary.margin_low_v;
        println!(
            "{name}: end {:.3} µV, lowest {:.3} µV from the simulation",
            1e6 * apart_v(&model, &met.end, &run.end),
            1e6 * (met.min_cell_v - lowest_v)
        );
        assert!(apart_v(&model, &met.end, &run.end) < 5e-6, "{name}");
        assert!((met.min_cell_v - lowest_v).abs() < 2e-5, "{name}");
        assert!((met.charge_coulomb / run.summary.charge_coulomb - 1.0).abs() < 1e-5);
        let degc = |state: &SimState| state.temperature_degc.unwrap();
        assert!((degc(&met.end) - degc(&run.end)).abs() < 1e-4, "{name}");
        let exact = at(1.0 / 65_536.0).end;
        let errors = [2e-3, 1e-3, 5e-4].map(|step_s| apart_v(&model, &at(step_s).end, &exact));
        println!("  halved steps: {errors:?} V");
        let by = [errors[0] / errors[1], errors[1] / errors[2]];
        assert!(
            by.iter().all(|by| (2.8..6.0).contains(by)),
            "{name}: {errors:?}"
        );
    }
}

#[test]
fn a_constant_power_empties_the_cell_as_in_the_simulation() {
    let one = Pack::new(1, 1, 0.0).unwrap();
    let profile = Profile::constant(Demand::Power, 25.0, 2000.0).unwrap();
    for (name, model) in models(one) {
        let start = model.rest(0.95).unwrap();
        let options = SimOptions {
            beyond: Beyond::Clamp,
            ..SimOptions::default()
        };
        let run = simulate(&model, &start, &profile, &options).unwrap();
        let met = outcome(&model, &start, &profile, 0.02);
        println!(
            "{name}: end {:.3} µV, SOC {:.4}, {:.2} °C",
            1e6 * apart_v(&model, &met.end, &run.end),
            met.end.soc,
            met.end.temperature_degc.unwrap()
        );
        assert!(met.end.soc < 0.1, "{name}: {met:?}");
        assert!(apart_v(&model, &met.end, &run.end) < 1.5e-5, "{name}");
        let degc = |state: &SimState| state.temperature_degc.unwrap();
        assert!((degc(&met.end) - degc(&run.end)).abs() < 1e-3, "{name}");
        let outside = run.summary.outside_map.unwrap();
        assert!((met.outside_map.unwrap().soc - outside.soc).abs() < 1e-5);
        assert_eq!(met.infeasible_s.is_none(), run.summary.feasible);
    }
}

#[test]
fn leaving_the_range_of_the_map_is_stated() {
    let one = Pack::new(1, 1, 0.0).unwrap();
    let cold = SimModel::mapped(map(|_, _| 1.0, None), curve(), one, -8.0).unwrap();
    let profile = Profile::constant(Demand::Power, 10.0, 1.0).unwrap();
    let met = outcome(&cold, &cold.rest(0.5).unwrap(), &profile, 0.1);
    let outside = met.outside_map.unwrap();
    assert!((outside.temperature_k - 8.0).abs() < 1e-9 && outside.soc == 0.0);
    let options = StepOptions {
        demand: Demand::Power,
        beyond: Beyond::Clamp,
        step_s: 0.1,
        parts: 1,
    };
    let step = HeldStep::new(&cold, &options, CellWindow::THESIS).unwrap();
    let seen = step.look(&cold.rest(0.5).unwrap(), 10.0).unwrap();
    assert_eq!(seen.outside_map, met.outside_map);
}

#[test]
fn cells_side_by_side_are_each_the_cell_alone() {
    let models = models(Pack::new(2, 3, 0.004).unwrap());
    let profile = rows(
        Demand::Power,
        Interpolation::Linear,
        &[(0.0, 100.0), (0.5, 20.0), (0.52, 150.0), (3.0, -60.0)],
    );
    let states: Vec<SimState> = (0..21)
        .map(|k| models[k % 4].1.rest(0.3 + 0.02 * k as f64).unwrap())
        .collect();
    let cells: Vec<BatchCell<'_>> = states
        .iter()
        .enumerate()
        .map(|(k, state)| BatchCell {
            model: &models[k % 4].1,
            state,
            scale: 0.3 + 0.05 * k as f64,
        })
        .collect();
    let extrapolated = Beyond::Extrapolate { fraction: 0.6 };
    for beyond in [Beyond::Clamp, extrapolated] {
        let options = BatchOptions {
            beyond,
            max_step_s: 1e-3,
        };
        let together = simulate_batch(&cells, &profile, &options).unwrap();
        for (cell, met) in cells.iter().zip(&together) {
            let alone = simulate_batch(&[*cell], &profile, &options)
                .unwrap()
                .remove(0);
            assert!(
                apart_v(cell.model, &alone.end, &met.end) < 1e-7,
                "{alone:?} {met:?}"
            );
            assert!((alone.min_ccv_v - met.min_ccv_v).abs() < 1e-6);
            assert!((alone.energy_j - met.energy_j).abs() < 1e-6 * met.energy_j.abs());
        }
    }
    let plain = curved_cell();
    let rest = plain.rest(0.5).unwrap();
    let mixed = BatchCell {
        model: &plain,
        state: &rest,
        scale: 1.0,
    };
    let error = simulate_batch(&[cells[0], mixed], &profile, &BatchOptions::default());
    assert_eq!(
        error.unwrap_err().to_string(),
        "batch, cells with a map: expected all or none, met 1"
    );
}

#[test]
fn a_held_step_is_that_of_the_batch_for_every_kind_of_demand() {
    let one = Pack::new(1, 1, 0.0).unwrap();
    let demands = [
        (Demand::Power, Beyond::Bend { fraction: 0.9 }, 30.0),
        (Demand::Power, Beyond::Extrapolate { fraction: 0.9 }, 30.0),
        (Demand::Power, Beyond::Clamp, 30.0),
        (Demand::Current, Beyond::Clamp, 8.0),
        (Demand::Resistance, Beyond::Clamp, 0.4),
    ];
    for (name, model) in models(one) {
        for (demand, beyond, value) in demands {
            let profile = Profile::constant(demand, value, 2.0).unwrap();
            let start = model.rest(0.55).unwrap();
            let options = StepOptions {
                demand,
                beyond,
                step_s: 0.02,
                parts: 10,
            };
            let mut step = HeldStep::new(&model, &options, CellWindow::THESIS).unwrap();
            let mut state = start.clone();
            for _ in 0..100 {
                let seen = step.look(&state, value).unwrap();
                let made = step.advance(&mut state, value).unwrap();
                assert!(
                    (seen.ccv_v - made.ccv_v).abs() < 1e-6,
                    "{name}: {seen:?} {made:?}"
                );
            }
            // The bend begins above this power, so that it is the same as the clamp.
            let beyond = match beyond {
                Beyond::Bend { .. } => Beyond::Clamp,
                other => other,
            };
            let cell = BatchCell {
                model: &model,
                state: &start,
                scale: 1.0,
            };
            let options = BatchOptions {
                beyond,
                max_step_s: 2e-3,
            };
            let met = simulate_batch(&[cell], &profile, &options)
                .unwrap()
                .remove(0);
            let apart = apart_v(&model, &met.end, &state);
            assert!(apart < 1e-7, "{name}, {demand:?}: {apart:e}");
            assert!((met.end.soc - state.soc).abs() < 1e-10);
        }
    }
}

#[test]
fn the_largest_scale_of_a_map_keeps_the_window_and_a_larger_one_breaks_it() {
    let profile = rows(
        Demand::Power,
        Interpolation::Hold,
        &[(0.0, 10.0), (0.5, 25.0), (0.7, 5.0), (2.0, 5.0)],
    );
    for (name, model) in models(Pack::new(1, 1, 0.0).unwrap()) {
        let start = model.rest(0.5).unwrap();
        let options = ScaleOptions::for_profile(&profile);
        let limit = largest_scale(&model, &start, &profile, &options).unwrap();
        let margin_v = |factor: f64| {
            let run = simulate(
                &model,
                &start,
                &profile.scaled(factor),
                &SimOptions::default(),
            );
            let summary = run.unwrap().summary;
            if summary.feasible {
                summary.margin_low_v
            } else {
                -1.0
            }
        };
        let (inside, beyond) = (margin_v(limit.factor), margin_v(1.0001 * limit.factor));
        println!("{name}: {limit:?}, margin {inside:e} V, {beyond:e} V beyond");
        assert!(inside > -2e-5 && beyond < 0.0, "{name}: {inside} {beyond}");
    }
}
