use super::*;
use proptest::prelude::*;

/// Voltages of a power that jumps every millisecond, after 20 of them, against Runge–Kutta in steps
/// of 1 µs.
#[test]
fn within_a_microvolt_of_runge_kutta_at_steps_of_a_millisecond() {
    let power: Vec<f64> = (0..20)
        .map(|k| {
            if k % 3 == 0 {
                150.0
            } else {
                -40.0 + 15.0 * f64::from(k)
            }
        })
        .collect();
    let list: Vec<(f64, f64)> = power
        .iter()
        .copied()
        .chain([0.0])
        .enumerate()
        .map(|(k, p)| (k as f64 * 1e-3, p))
        .collect();
    let reference_curve = curve();
    let soc0 = 0.3;
    let ocv =
        |charge_coulomb: f64| reference_curve.voltage_v(soc0 - charge_coulomb / (4.2 * 3600.0));
    let plain = plain(&ocv);
    let model = curved_cell();
    let run = simulate(
        &model,
        &model.rest(soc0).unwrap(),
        &rows(Demand::Power, Interpolation::Hold, &list),
        &SimOptions::default(),
    )
    .unwrap();
    let mut x = vec![0.0; 5];
    let mut worst: f64 = 0.0;
    for (k, p) in power.iter().enumerate() {
        x = plain.run(x, (&|_| *p, 1e-6, 1000));
        let (ccv, current) = plain.answer(&x, *p);
        let end = k as f64 * 1e-3 + 1e-3;
        let met = run
            .trace
            .time_s
            .iter()
            .position(|t| (t - end).abs() < 1e-9)
            .unwrap();
        worst = worst.max((run.trace.ccv_v[met] - ccv).abs());
        assert!(
            (run.trace.current_a[met] - current).abs() < 1e-3,
            "{} A against {current} A",
            run.trace.current_a[met]
        );
    }
    assert!(worst < 1e-6, "{worst} V");
    assert!(
        (run.summary.charge_coulomb - x[0]).abs() < 1e-7,
        "{} C against {} C",
        run.summary.charge_coulomb,
        x[0]
    );
}

#[test]
fn linear_power_agrees_with_runge_kutta() {
    let profile = rows(
        Demand::Power,
        Interpolation::Linear,
        &[(0.0, 10.0), (0.05, 160.0), (0.08, -60.0), (0.1, 100.0)],
    );
    let p = |t: f64| match t {
        t if t <= 0.05 => 10.0 + 3000.0 * t,
        t if t <= 0.08 => 160.0 - 220.0 / 0.03 * (t - 0.05),
        t => -60.0 + 8000.0 * (t - 0.08),
    };
    let ocv = |_: f64| 3.72;
    let reference = plain(&ocv);
    let x = reference.run(vec![0.0; 5], (&p, 1e-6, 100_000));
    let (ccv, _) = reference.answer(&x, 100.0);
    let model = flat_cell();
    let run = simulate(
        &model,
        &model.rest(0.5).unwrap(),
        &profile,
        &SimOptions::default(),
    )
    .unwrap();
    let met = run.trace.ccv_v.last().unwrap();
    assert!((met - ccv).abs() < 1e-6, "{met} V against {ccv} V");
    assert!(run.trace.soc.iter().all(|z| z.is_nan()));
}

#[test]
fn the_thesis_steps_come_closer_in_first_order() {
    let model = flat_cell();
    let rest = model.rest(0.5).unwrap();
    let error_v = |step_s: f64| {
        let profile = Profile::constant(Demand::Power, 120.0, 0.05).unwrap();
        let last = |method, max_step_s| {
            let options = SimOptions {
                method,
                max_step_s,
                ..SimOptions::default()
            };
            *simulate(&model, &rest, &profile, &options)
                .unwrap()
                .trace
                .ccv_v
                .last()
                .unwrap()
        };
        (last(Method::Thesis, step_s) - last(Method::Exact, f64::INFINITY)).abs()
    };
    let errors = [2e-4, 1e-4, 5e-5].map(error_v);
    assert!(errors[0] > 1e-6, "{errors:?}");
    for pair in errors.windows(2) {
        assert!((pair[0] / pair[1] - 2.0).abs() < 0.1, "{errors:?}");
    }
}

#[test]
fn infeasible_power_is_reported_where_and_how_much() {
    // R alone: E = 3.6 V and 10 mΩ give at most 324 W, at 1.8 V.
    let model = SimModel::cell(
        &Erm {
            r_ohm: 0.01,
            branches: vec![],
        },
        OcvSource::Constant(3.6),
    )
    .unwrap();
    let profile = rows(
        Demand::Power,
        Interpolation::Hold,
        &[(0.0, 100.0), (1.0, 400.0), (2.0, 50.0), (3.0, 0.0)],
    );
    let run = |beyond| {
        simulate(
            &model,
            &model.rest(0.5).unwrap(),
            &profile,
            &SimOptions {
                beyond,
                ..SimOptions::default()
            },
        )
        .unwrap()
    };
    let stopped = run(Beyond::Stop).summary;
    assert!(
        !stopped.feasible && (stopped.simulated_s - 1.0).abs() < 1e-12,
        "{stopped:?}"
    );
    let first = stopped.infeasible[0];
    assert!(
        (first.time_s - 1.0).abs() < 1e-12
            && first.power_w == 400.0
            && (first.available_w - 324.0).abs() < 1e-9,
        "{first:?}"
    );
    let clamped = run(Beyond::Clamp).summary;
    assert!(
        (clamped.energy_j - (100.0 + 324.0 + 50.0)).abs() < 1e-6
            && (clamped.min_ccv_v - 1.8).abs() < 1e-9,
        "{clamped:?}"
    );
    assert!(
        (clamped.infeasible[0].until_s - 2.0).abs() < 1e-9
            && clamped.infeasible.len() == 1
            && (clamped.simulated_s - 3.0).abs() < 1e-12
    );
    // P₀ = 307.8 W; V(P₀) = 1.8·(1 + √0.05) and V′(P₀) = −R/√(E² − 4P₀R).
    let expected = 1.8 * (1.0 + 0.05_f64.sqrt()) - 0.01 / (3.6 * 0.05_f64.sqrt()) * (400.0 - 307.8);
    let tangent = run(Beyond::Extrapolate { fraction: 0.95 }).summary;
    assert!(
        (tangent.min_ccv_v - expected).abs() < 1e-9 && !tangent.feasible,
        "{tangent:?} against {expected}"
    );
}

#[test]
fn power_that_runs_out_within_a_step_stops_there() {
    // Feasible at rest (3.72²/4R = 538 W), not once the branches have charged: DC
    // gives 3.72²/(4·13.8 mΩ) = 251 W.
    let model = flat_cell();
    let profile = Profile::constant(Demand::Power, 350.0, 60.0).unwrap();
    let run = simulate(
        &model,
        &model.rest(0.5).unwrap(),
        &profile,
        &SimOptions::default(),
    )
    .unwrap();
    assert!(!run.summary.feasible);
    let at = run
        .summary
        .infeasible
        .first()
        .map_or(run.summary.simulated_s, |i| i.time_s);
    assert!(at > 0.1 && at < 60.0, "{at}");
}

#[test]
fn a_long_overload_on_the_tangent_ends_the_run_and_a_short_one_does_not() {
    let model = flat_cell();
    let run = |overload_s: f64| {
        let profile = rows(
            Demand::Power,
            Interpolation::Hold,
            &[
                (0.0, 100.0),
                (0.1, 600.0),
                (0.1 + overload_s, 50.0),
                (2.0, 0.0),
            ],
        );
        let options = SimOptions {
            beyond: Beyond::Extrapolate { fraction: 0.95 },
            ..SimOptions::default()
        };
        simulate(&model, &model.rest(0.5).unwrap(), &profile, &options)
            .unwrap()
            .summary
    };
    // After 0.85 ms the tangent has come down to 0 V.
    let (short, long) = (run(0.5e-3), run(1.5));
    assert!(
        !short.feasible && (short.simulated_s - 2.0).abs() < 1e-9,
        "{short:?}"
    );
    assert!(
        !long.feasible && long.simulated_s < 1.6 && long.min_ccv_v >= 0.0,
        "{long:?}"
    );
    assert!(
        short.tangent_end.is_none() && short.min_ccv_v > 0.0 && long.tangent_end.is_some(),
        "{short:?} {long:?}"
    );
}

#[test]
fn margins_leave_the_interconnect_out() {
    let pack = Pack::new(16, 3, 0.03).unwrap();
    let model = SimModel::pack(
        &Erm {
            r_ohm: 0.015,
            branches: vec![],
        },
        OcvSource::Constant(3.6),
        pack,
    )
    .unwrap();
    let profile = Profile::constant(Demand::Current, 90.0, 1.0).unwrap();
    let s = simulate(
        &model,
        &model.rest(0.5).unwrap(),
        &profile,
        &SimOptions::default(),
    )
    .unwrap()
    .summary;
    // 30 A per cell: 3.6 − 0.45 V; the terminals have 16 of them less 90 A · 30 mΩ.
    assert!((s.min_ccv_v - (16.0 * 3.15 - 2.7)).abs() < 1e-9, "{s:?}");
    assert!(
        (s.margin_low_v - 0.65).abs() < 1e-12 && (s.margin_high_v - 1.05).abs() < 1e-12,
        "{s:?}"
    );
}

#[test]
fn refuses_what_cannot_be_simulated() {
    let model = flat_cell();
    let rest = model.rest(0.5).unwrap();
    let profile = Profile::constant(Demand::Power, 10.0, 1.0).unwrap();
    let with = |options| {
        simulate(&model, &rest, &profile, &options)
            .unwrap_err()
            .to_string()
    };
    let default = SimOptions::default();
    assert_eq!(
        with(SimOptions {
            beyond: Beyond::Extrapolate { fraction: 1.0 },
            ..default
        }),
        "fraction of the available power: expected a number above 0 and below 1, met 1"
    );
    assert_eq!(
        with(SimOptions {
            max_step_s: 1e-12,
            ..default
        }),
        "longest step: expected a number of seconds above 0 that makes fewer than 1e8 steps, met \
        0.000000000001"
    );
    assert_eq!(
        with(SimOptions {
            tolerance_v: f64::NAN,
            ..default
        }),
        "tolerance: expected a number of volts above 0, met NaN"
    );
    let short = SimState {
        soc: 0.5,
        v_rc_v: vec![0.0],
        temperature_degc: None,
    };
    let error = simulate(&model, &short, &profile, &default)
        .unwrap_err()
        .to_string();
    assert_eq!(
        error,
        "state: expected 4 branch voltages, as the model has branches, met 1"
    );
    assert_eq!(
        model.rest(1.5).unwrap_err().to_string(),
        "state of charge: expected a fraction from 0 to 1, met 1.5"
    );
    let error = curved_cell().rest_at(5.0).unwrap_err().to_string();
    assert_eq!(
        error,
        "open-circuit voltage: expected one that the model's curve reaches, 2.600 to 4.180 V, met \
        5 V"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_constant_current_has_its_closed_form(
        current in -80.0..80.0f64,
        duration in 1e-3..30.0f64,
    ) {
        let model = flat_cell();
        let profile = Profile::constant(Demand::Current, current, duration).unwrap();
        let options = SimOptions {
            max_step_s: duration / 7.0,
            ..SimOptions::default()
        };
        let run = simulate(&model, &model.rest(0.5).unwrap(), &profile, &options).unwrap();
        let cell = thesis_cell();
        let drop = |t: f64| {
            cell.branches
                .iter()
                .map(|b| current * b.r_ohm * (1.0 - (-t / (b.r_ohm * b.c_f)).exp()))
                .sum::<f64>()
        };
        for (t, ccv) in run.trace.time_s.iter().zip(&run.trace.ccv_v) {
            let expected = 3.72 - current * cell.r_ohm - drop(*t);
            prop_assert!(
                (ccv - expected).abs() < 1e-11,
                "{} against {} at {} s",
                ccv,
                expected,
                t
            );
        }
        // ∫v²/R of one charging branch: i²R·(t − 2τ(1 − e) + τ/2·(1 − e²)).
        let heat: f64 = cell
            .branches
            .iter()
            .map(|b| {
                let tau = b.r_ohm * b.c_f;
                let e = (-duration / tau).exp();
                current
                    * current
                    * b.r_ohm
                    * (duration - 2.0 * tau * (1.0 - e) + 0.5 * tau * (1.0 - e * e))
            })
            .sum::<f64>()
            + current * current * cell.r_ohm * duration;
        prop_assert!(
            (run.summary.heat_j - heat).abs() < 1e-5 * heat.max(1e-9),
            "{} J against {} J",
            run.summary.heat_j,
            heat
        );
    }

    #[test]
    fn no_energy_is_lost(
        values in prop::collection::vec(-100.0..140.0f64, 3..12),
        step in 1e-3..0.3f64,
        linear in any::<bool>(),
        soc in 0.2..0.9f64,
    ) {
        let interpolation = if linear {
            Interpolation::Linear
        } else {
            Interpolation::Hold
        };
        let list: Vec<(f64, f64)> = values
            .iter()
            .enumerate()
            .map(|(k, v)| (k as f64 * step * (1.0 + 0.1 * k as f64), *v))
            .collect();
        let model = curved_cell();
        let options = SimOptions {
            beyond: Beyond::Clamp,
            ..SimOptions::default()
        };
        let s = simulate(
            &model,
            &model.rest(soc).unwrap(),
            &rows(Demand::Power, interpolation, &list),
            &options,
        )
        .unwrap()
        .summary;
        let scale = s.chemical_j.abs() + s.heat_j;
        prop_assert!(
            (s.chemical_j - s.energy_j - s.heat_j - s.stored_j).abs() < 1e-5 * scale,
            "{:?}",
            s
        );
        if s.feasible {
            let asked: f64 = list
                .windows(2)
                .map(|w| {
                    (w[1].0 - w[0].0)
                        * if linear {
                            0.5 * (w[0].1 + w[1].1)
                        } else {
                            w[0].1
                        }
                })
                .sum();
            prop_assert!(
                (s.energy_j - asked).abs() < 1e-5 * scale,
                "{} J against {} J",
                s.energy_j,
                asked
            );
        }
    }

    #[test]
    fn a_pack_does_what_its_cells_do(
        power in -60.0..110.0f64,
        series in 1..40u32,
        parallel in 1..10u32,
    ) {
        let cell = curved_cell();
        let pack = SimModel::pack(
            &thesis_cell(),
            OcvSource::Curve(curve()),
            Pack::new(series, parallel, 0.0).unwrap(),
        )
        .unwrap();
        let run = |model: &SimModel, p: f64| {
            let profile = Profile::constant(Demand::Power, p, 2.0).unwrap();
            simulate(
                model,
                &model.rest(0.6).unwrap(),
                &profile,
                &SimOptions::default(),
            )
            .unwrap()
        };
        let (one, all) = (
            run(&cell, power),
            run(&pack, power * f64::from(series * parallel)),
        );
        prop_assert!(
            (all.summary.min_ccv_v / f64::from(series) - one.summary.min_ccv_v).abs() < 1e-7
        );
        prop_assert!((all.summary.margin_low_v - one.summary.margin_low_v).abs() < 1e-7);
        prop_assert!((all.end.soc - one.end.soc).abs() < 1e-9);
    }
}

#[test]
fn the_thesis_method_takes_steps_that_are_stable_or_says_which_are() {
    // τ₁ of the cell is 1.509 mΩ · 0.5528 F = 0.8342 ms: rows of 2 ms are beyond twice of it.
    let list: Vec<(f64, f64)> = (0..200)
        .map(|k| (0.002 * f64::from(k), if k % 7 < 3 { 120.0 } else { 10.0 }))
        .collect();
    let profile = rows(Demand::Power, Interpolation::Hold, &list);
    let model = flat_cell();
    let rest = model.rest(0.5).unwrap();
    let thesis = SimOptions {
        method: Method::Thesis,
        ..SimOptions::default()
    };
    let run = simulate(&model, &rest, &profile, &thesis).unwrap();
    let exact = simulate(&model, &rest, &profile, &SimOptions::default()).unwrap();
    assert!(
        (run.summary.min_ccv_v - exact.summary.min_ccv_v).abs() < 2e-3,
        "{} {}",
        run.summary.min_ccv_v,
        exact.summary.min_ccv_v
    );
    assert_eq!(run.trace.time_s, exact.trace.time_s);
    let error = simulate(
        &model,
        &rest,
        &profile,
        &SimOptions {
            thesis_step_s: Some(0.002),
            ..thesis
        },
    )
    .unwrap_err();
    assert_eq!(
        error.to_string(),
        "explicit Euler: expected steps below 1.6684 ms, twice the shortest time constant of \
        0.8342 ms, met 2.0000 ms; 0.2085 ms is usable"
    );
    assert!(
        simulate(
            &model,
            &rest,
            &profile,
            &SimOptions {
                thesis_step_s: Some(0.001),
                ..thesis
            }
        )
        .is_ok()
    );
    let error = simulate(
        &model,
        &rest,
        &profile,
        &SimOptions {
            thesis_step_s: Some(0.0),
            ..thesis
        },
    )
    .unwrap_err();
    assert!(
        error
            .to_string()
            .starts_with("step of explicit Euler: expected a number of seconds above 0"),
        "{error}"
    );
}
