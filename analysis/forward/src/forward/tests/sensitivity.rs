use super::*;
use proptest::prelude::*;

/// Returns the model with one parameter moved: R, R₁, C₁, …, OCV offset.
fn moved(model: &SimModel, parameter: usize, by: f64) -> SimModel {
    let mut model = model.clone();
    let last = 1 + 2 * model.erm.branches.len();
    match (parameter, &mut model.ocv) {
        (0, _) => model.erm.r_ohm += by,
        (p, OcvSource::Constant(v)) if p == last => *v += by,
        (p, OcvSource::Curve(curve)) if p == last => curve.ocv_v.iter_mut().for_each(|v| *v += by),
        (p, _) if p % 2 == 1 => model.erm.branches[p / 2].r_ohm += by,
        (p, _) => model.erm.branches[p / 2 - 1].c_f += by,
    }
    model
}

fn flat(state: &SimState) -> Vec<f64> {
    std::iter::once(state.soc)
        .chain(state.v_rc_v.iter().copied())
        .collect()
}

fn shifted(state: &SimState, index: usize, by: f64) -> SimState {
    let mut state = state.clone();
    match index {
        0 => state.soc += by,
        k => state.v_rc_v[k - 1] += by,
    }
    state
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_b_c_d_are_difference_quotients_on_both_sides_of_the_joint(
        share in -0.8..2.0f64,
        soc in 0.15..0.9f64,
        v in prop::collection::vec(-0.05..0.1f64, 4),
        step_s in 1e-4..0.1f64,
        parts in 1..4u32,
        kind in 0..3usize,
    ) {
        let model = curved_cell();
        let state = SimState { soc, v_rc_v: v, temperature_degc: None };
        let demand_kind = [Demand::Power, Demand::Current, Demand::Resistance][kind];
        let e = model.ocv_v(soc).0 - state.v_rc_v.iter().sum::<f64>();
        let demand = [
            share * e * e / (4.0 * model.erm.r_ohm),
            60.0 * share,
            share.abs() + 0.02,
        ][kind];
        prop_assume!((share - 0.9).abs() > 0.1);
        let options = StepOptions {
            demand: demand_kind,
            beyond: Beyond::Extrapolate { fraction: 0.9 },
            step_s,
            parts,
        };
        let step = |model: &SimModel, state: &SimState, demand: f64| {
            step_with_jacobian(model, state, demand, &options)
        };
        let Ok(at) = step(&model, &state, demand) else {
            return Ok(());
        };
        // A kink (knot of the curve, joint of the tangent within the step) shows as a difference
        // between the two sides: such cases are skipped.
        let compare = |met: (&[f64], f64),
                       h: f64,
                       moved: &dyn Fn(f64) -> Option<Jacobian>|
         -> Result<(), TestCaseError> {
            let (Some(up), Some(down), Some(half_up), Some(half_down)) =
                (moved(h), moved(-h), moved(0.5 * h), moved(-0.5 * h))
            else {
                return Ok(());
            };
            let outputs =
                |j: &Jacobian| -> Vec<f64> { flat(&j.next).into_iter().chain([j.ccv_v]).collect() };
            let quotient = |a: &Jacobian, b: &Jacobian, h: f64| -> Vec<f64> {
                outputs(a)
                    .iter()
                    .zip(outputs(b))
                    .map(|(a, b)| (a - b) / (2.0 * h))
                    .collect()
            };
            let (coarse, fine) = (
                quotient(&up, &down, h),
                quotient(&half_up, &half_down, 0.5 * h),
            );
            for ((met, coarse), fine) in met.0.iter().chain([&met.1]).zip(coarse).zip(fine) {
                let scale = fine.abs() + 1e-6 / h * 1e-4;
                if (coarse - fine).abs() < 1e-3 * scale {
                    prop_assert!(
                        (met - fine).abs() < 3e-3 * scale,
                        "{} against {}",
                        met,
                        fine
                    );
                }
            }
            Ok(())
        };
        for k in 0..5 {
            let column: Vec<f64> = at.a.column(k).iter().copied().collect();
            compare((&column, at.c[k]), 1e-6, &|h| {
                step(&model, &shifted(&state, k, h), demand).ok()
            })?;
        }
        let column: Vec<f64> = at.b.iter().copied().collect();
        compare((&column, at.d), 1e-5 * demand.abs().max(0.1), &|h| {
            step(&model, &state, demand + h).ok()
        })?;
        let cell = thesis_cell();
        let sizes: Vec<f64> = std::iter::once(cell.r_ohm)
            .chain(cell.branches.iter().flat_map(|b| [b.r_ohm, b.c_f]))
            .chain([3.7])
            .collect();
        for (k, size) in sizes.iter().enumerate() {
            let column: Vec<f64> = at.next_by_parameter.column(k).iter().copied().collect();
            compare((&column, at.ccv_by_parameter[k]), 1e-5 * size, &|h| {
                step(&moved(&model, k, h), &state, demand).ok()
            })?;
        }
    }
}

/// The derivatives of a whole profile against quotients of the error-controlled simulation.
#[test]
fn a_profile_varies_as_its_sensitivities_say() {
    let model = curved_cell();
    let state = model.rest(0.55).unwrap();
    let profile = rows(
        Demand::Power,
        Interpolation::Linear,
        &[(0.0, 20.0), (0.3, 130.0), (0.5, -50.0), (1.0, 60.0)],
    );
    let met = sensitivity(&model, &state, &profile, Beyond::Stop, 1e-4).unwrap();
    let row = met.rows.last().unwrap();
    let last = |model: &SimModel, state: &SimState, profile: &Profile| {
        let options = SimOptions {
            tolerance_v: 1e-11,
            ..SimOptions::default()
        };
        let run = simulate(model, state, profile, &options).unwrap();
        (*run.trace.ccv_v.last().unwrap(), flat(&run.end))
    };
    assert!((row.ccv_v - last(&model, &state, &profile).0).abs() < 1e-7);
    let met_end = &met.end;
    let check =
        |name: &str, met: f64, column: usize, h: f64, run: &dyn Fn(f64) -> (f64, Vec<f64>)| {
            let (up, down) = (run(h), run(-h));
            let quotient = (up.0 - down.0) / (2.0 * h);
            assert!(
                (met - quotient).abs() < 1e-3 * quotient.abs() + 1e-6,
                "{name}: {met} against {quotient}"
            );
            for (k, (a, b)) in up.1.iter().zip(&down.1).enumerate() {
                let (met, quotient) = (met_end[(k, column)], (a - b) / (2.0 * h));
                assert!(
                    (met - quotient).abs() < 2e-3 * quotient.abs() + 1e-5,
                    "{name}, state {k}: {met} against {quotient}"
                );
            }
        };
    let cell = thesis_cell();
    let sizes: Vec<f64> = std::iter::once(cell.r_ohm)
        .chain(cell.branches.iter().flat_map(|b| [b.r_ohm, b.c_f]))
        .chain([1.0])
        .collect();
    check("scale", row.by_scale_v, usize::MAX, 1e-4, &|h| {
        (last(&model, &state, &profile.scaled(1.0 + h)).0, vec![])
    });
    for (k, size) in sizes.iter().enumerate() {
        check(
            &format!("parameter {k}"),
            row.by_parameter[k],
            1 + k,
            1e-4 * size,
            &|h| last(&moved(&model, k, h), &state, &profile),
        );
    }
    for k in 0..5 {
        check(&format!("state {k}"), row.by_state[k], 11 + k, 1e-4, &|h| {
            last(&model, &shifted(&state, k, h), &profile)
        });
    }
}
