use super::*;
use proptest::prelude::*;

fn erm(branches: usize, spread: f64) -> Erm {
    let mut cell = thesis_cell();
    cell.branches.truncate(branches);
    while cell.branches.len() < branches {
        cell.branches.push(RcBranch {
            r_ohm: 0.000_3,
            c_f: 50.0 * cell.branches.len() as f64,
        });
    }
    cell.r_ohm *= spread;
    cell.branches.iter_mut().for_each(|b| b.r_ohm *= spread);
    cell
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn every_lane_is_what_the_scalar_simulation_says(
        cells in prop::collection::vec((0..=8usize, 0.8..1.2f64, 0.2..0.9f64, 0.2..1.0f64, any::<bool>()), 1..24),
        values in prop::collection::vec(0.0..150.0f64, 4..20),
        kind in 0..3usize,
        tangent in any::<bool>(),
    ) {
        let demand = [Demand::Power, Demand::Current, Demand::Resistance][kind];
        let offset = if kind == 2 { 0.02 } else { 0.0 };
        let list: Vec<(f64, f64)> = values
            .iter()
            .enumerate()
            .map(|(k, v)| {
                (
                    0.01 * k as f64 + 0.001 * (k % 3) as f64,
                    v * [1.0, 0.3, 0.001][kind] + offset,
                )
            })
            .collect();
        let profile = rows(demand, Interpolation::Linear, &list);
        let beyond = if tangent {
            Beyond::Extrapolate { fraction: 0.6 }
        } else {
            Beyond::Clamp
        };
        let models: Vec<(SimModel, SimState)> = cells
            .iter()
            .map(|(n, spread, soc, _, curved)| {
                let ocv = if *curved {
                    OcvSource::Curve(curve())
                } else {
                    OcvSource::Constant(3.7)
                };
                let model = SimModel::pack(&erm(*n, *spread), ocv, Pack::new(2, 3, 0.004).unwrap())
                    .unwrap();
                let state = model.rest(*soc).unwrap();
                (model, state)
            })
            .collect();
        let lanes: Vec<BatchCell<'_>> = models
            .iter()
            .zip(&cells)
            .map(|((model, state), c)| BatchCell {
                model,
                state,
                scale: 6.0 * c.3,
            })
            .collect();
        let outcomes = simulate_batch(
            &lanes,
            &profile,
            &BatchOptions {
                beyond,
                max_step_s: 2e-5,
            },
        )
        .unwrap();
        for (lane, met) in lanes.iter().zip(&outcomes) {
            let options = SimOptions {
                beyond,
                ..SimOptions::default()
            };
            let run = simulate(
                lane.model,
                lane.state,
                &profile.scaled(lane.scale),
                &options,
            )
            .unwrap();
            let s = &run.summary;
            // Both find extremes only at the ends of their own steps, so a peak in between may
            // differ by the curvature within a step.
            prop_assert!(
                (met.min_ccv_v - s.min_ccv_v).abs() < 3e-5,
                "{} against {}",
                met.min_ccv_v,
                s.min_ccv_v
            );
            prop_assert!(
                (2.5 + s.margin_low_v - met.min_cell_v).abs() < 3e-5
                    && (4.2 - s.margin_high_v - met.max_cell_v).abs() < 3e-5
            );
            prop_assert!(
                (met.charge_coulomb - s.charge_coulomb).abs() < 1e-5 * (1.0 + s.charge_coulomb.abs()),
                "{} against {}",
                met.charge_coulomb,
                s.charge_coulomb
            );
            prop_assert!(
                (met.energy_j - s.energy_j).abs() < 1e-4 * (1.0 + s.energy_j.abs()),
                "{} against {}",
                met.energy_j,
                s.energy_j
            );
            // The scalar's error control allows a microvolt, and hundreds of amperes into some
            // milliohms bring the batch's fixed steps near it.
            let last = met
                .end
                .v_rc_v
                .iter()
                .zip(&run.end.v_rc_v)
                .all(|(a, b)| (a - b).abs() < 5e-6);
            prop_assert!(
                last && (met.end.soc - run.end.soc).abs() < 1e-8,
                "{:?} against {:?}",
                met.end,
                run.end
            );
            prop_assert_eq!(met.infeasible_s.is_none(), s.feasible);
        }
    }
}

#[test]
fn one_lane_or_many_give_the_same_bits_and_order_is_kept() {
    let model = curved_cell();
    let state = model.rest(0.31).unwrap();
    let profile = rows(
        Demand::Power,
        Interpolation::Hold,
        &[(0.0, 40.0), (0.7, 90.0), (1.1, -30.0), (3.0, 0.0)],
    );
    let options = BatchOptions {
        max_step_s: 1e-3,
        ..BatchOptions::default()
    };
    let lanes: Vec<BatchCell<'_>> = (0..37)
        .map(|k| BatchCell {
            model: &model,
            state: &state,
            scale: 0.5 + 0.02 * f64::from(k),
        })
        .collect();
    let together = simulate_batch(&lanes, &profile, &options).unwrap();
    for (lane, met) in lanes.iter().zip(&together) {
        assert_eq!(
            simulate_batch(&[*lane], &profile, &options).unwrap()[0],
            *met
        );
    }
    assert!(together.windows(2).all(|w| w[1].min_ccv_v < w[0].min_ccv_v));
}

#[test]
fn refuses_what_does_not_fit() {
    let model = SimModel::cell(&erm(9, 1.0), OcvSource::Constant(3.7)).unwrap();
    let state = model.rest(0.5).unwrap();
    let profile = Profile::constant(Demand::Power, 10.0, 1.0).unwrap();
    let run = |scale, beyond| {
        simulate_batch(
            &[BatchCell {
                model: &model,
                state: &state,
                scale,
            }],
            &profile,
            &BatchOptions {
                beyond,
                ..BatchOptions::default()
            },
        )
    };
    assert_eq!(
        run(1.0, Beyond::Stop).unwrap_err().to_string(),
        "batch: expected at most 8 RC branches, met 9"
    );
    let bend = Beyond::Bend { fraction: 0.9 };
    assert_eq!(
        run(1.0, bend).unwrap_err().to_string(),
        "batch, power beyond P₀: expected the tangent (Extrapolate), not the bend, met 0.9"
    );
}

#[test]
fn the_largest_scale_of_a_resistance_is_known() {
    // 3.6 V, 10 mΩ: 2.5 V are reached at 110 A and 275 W, 4.2 V at −60 A and −252 W.
    let model = SimModel::cell(
        &Erm {
            r_ohm: 0.01,
            branches: vec![],
        },
        OcvSource::Constant(3.6),
    )
    .unwrap();
    let rest = model.rest(0.5).unwrap();
    let scale = |window: CellWindow, value: f64| {
        let profile = Profile::constant(Demand::Power, value, 1.0).unwrap();
        largest_scale(
            &model,
            &rest,
            &profile,
            &ScaleOptions {
                window,
                ..ScaleOptions::for_profile(&profile)
            },
        )
        .unwrap()
    };
    let met = [
        scale(CellWindow::THESIS, 100.0),
        scale(CellWindow::THESIS, -100.0),
        scale(
            CellWindow {
                low_v: 1.0,
                high_v: 4.2,
            },
            100.0,
        ),
    ];
    for (limit, (factor, bound)) in met.iter().zip([
        (2.75, ScaleBound::LowerVoltage),
        (2.52, ScaleBound::UpperVoltage),
        (3.24, ScaleBound::Power),
    ]) {
        assert!(
            (limit.factor / factor - 1.0).abs() < 1e-5 && limit.bound == bound,
            "{limit:?}, expected {factor} by {bound:?}"
        );
    }
    assert_eq!(scale(CellWindow::THESIS, 0.0).bound, ScaleBound::Nothing);
    assert_eq!(
        scale(
            CellWindow {
                low_v: 3.7,
                high_v: 4.2
            },
            100.0
        )
        .factor,
        0.0
    );
}

#[test]
fn a_step_without_error_control_is_of_second_order() {
    let model = flat_cell();
    let rest = model.rest(0.5).unwrap();
    let profile = rows(
        Demand::Power,
        Interpolation::Linear,
        &[(0.0, 20.0), (0.02, 140.0), (0.04, 60.0)],
    );
    let exact = simulate(
        &model,
        &rest,
        &profile,
        &SimOptions {
            tolerance_v: 1e-12,
            ..SimOptions::default()
        },
    )
    .unwrap()
    .end;
    let error = |max_step_s: f64| {
        let lane = BatchCell {
            model: &model,
            state: &rest,
            scale: 1.0,
        };
        let options = BatchOptions {
            max_step_s,
            ..BatchOptions::default()
        };
        let end = simulate_batch(&[lane], &profile, &options)
            .unwrap()
            .remove(0)
            .end;
        end.v_rc_v
            .iter()
            .zip(&exact.v_rc_v)
            .map(|(a, b)| (a - b).abs())
            .sum::<f64>()
    };
    let errors = [2e-4, 1e-4, 5e-5].map(error);
    assert!(
        errors
            .windows(2)
            .all(|pair| (pair[0] / pair[1] - 4.0).abs() < 0.3),
        "{errors:?}"
    );
}

#[test]
fn one_step_is_exact_for_a_current_along_a_straight_line() {
    let model = flat_cell();
    let rest = model.rest(0.5).unwrap();
    let profile = rows(
        Demand::Current,
        Interpolation::Linear,
        &[(0.0, 0.0), (1.0, 60.0)],
    );
    let lane = BatchCell {
        model: &model,
        state: &rest,
        scale: 1.0,
    };
    let met = simulate_batch(&[lane], &profile, &BatchOptions::default())
        .unwrap()
        .remove(0);
    for (v, b) in met.end.v_rc_v.iter().zip(&thesis_cell().branches) {
        let tau = b.r_ohm * b.c_f;
        let expected = 60.0 * b.r_ohm * (1.0 - tau * (1.0 - (-1.0 / tau).exp()));
        assert!((v - expected).abs() < 1e-12, "{v} V against {expected} V");
    }
}

/// Evaluates two roots in each step, as in the equations, for the thesis' cell at 3.7 V without an
/// OCV curve; returns the branches at the end.
fn by_two_roots(powers: &[f64], step_s: f64) -> Vec<f64> {
    let cell = thesis_cell();
    let current =
        |e: f64, p: f64| (e - (e * e - 4.0 * p * cell.r_ohm).max(0.0).sqrt()) / (2.0 * cell.r_ohm);
    let ocv_v = flat_cell().ocv_v(0.5).0;
    let mut v = vec![0.0; cell.branches.len()];
    for p in powers {
        let i0 = current(ocv_v - v.iter().sum::<f64>(), *p);
        let moved = |i1: f64| -> Vec<f64> {
            let one = |(v, b): (&f64, &RcBranch)| {
                let x = step_s / (b.r_ohm * b.c_f);
                let (a, phi) = ((-x).exp(), -(-x).exp_m1() / x);
                a * v + b.r_ohm * (phi - a) * i0 + b.r_ohm * (1.0 - phi) * i1
            };
            v.iter().zip(&cell.branches).map(one).collect()
        };
        v = moved(current(ocv_v - moved(i0).iter().sum::<f64>(), *p));
    }
    v
}

#[test]
fn one_root_in_a_step_is_as_good_as_two() {
    let model = flat_cell();
    let rest = model.rest(0.5).unwrap();
    // Small steps, where the series replaces the second root, and large ones beyond the available
    // power, where it does not.
    for (step_s, most_w, tolerance_v) in [
        (1e-5, 150.0, 1e-12),
        (1e-3, 150.0, 1e-9),
        (1e-3, 600.0, 1e-8),
        (0.1, 300.0, 1e-8),
    ] {
        let powers: Vec<f64> = (0..400)
            .map(|k| most_w * (f64::from(k) * 0.37).sin() * f64::from(k % 7) / 6.0)
            .collect();
        let list: Vec<(f64, f64)> = (0..=400)
            .map(|k| (step_s * k as f64, powers.get(k).copied().unwrap_or(0.0)))
            .collect();
        let lane = BatchCell {
            model: &model,
            state: &rest,
            scale: 1.0,
        };
        let end = simulate_batch(
            &[lane],
            &rows(Demand::Power, Interpolation::Hold, &list),
            &BatchOptions::default(),
        )
        .unwrap()
        .remove(0)
        .end;
        let worst = end
            .v_rc_v
            .iter()
            .zip(by_two_roots(&powers, step_s))
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(worst < tolerance_v, "{worst} V at steps of {step_s} s");
    }
}
