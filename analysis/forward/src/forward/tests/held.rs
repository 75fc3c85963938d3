//! Steps of one length against those with derivatives, and against the simulation.

use super::*;
use proptest::prelude::*;

fn options(fraction: f64, step_s: f64, parts: u32) -> StepOptions {
    StepOptions {
        demand: Demand::Power,
        beyond: Beyond::Extrapolate { fraction },
        step_s,
        parts,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_step_is_the_one_with_derivatives(
        share in -0.8..1.3f64,
        soc in 0.15..0.9f64,
        fraction in 0.5..0.99f64,
        parts in 1..5u32,
    ) {
        let model = curved_cell();
        let mut state = model.rest(soc).unwrap();
        state.v_rc_v = vec![0.01, -0.02, 0.0, 0.05];
        let e_v = model.ocv_v(soc).0 - 0.04;
        let power_w = share * e_v * e_v / (4.0 * model.erm.r_ohm);
        let options = options(fraction, 2e-3, parts);
        let mut step = HeldStep::new(&model, &options, CellWindow::THESIS).unwrap();
        let jacobian = match step_with_jacobian(&model, &state, power_w, &options) {
            Ok(jacobian) => jacobian,
            // Far beyond the available power the voltage may collapse within the step.
            Err(error) => {
                let found = step.advance(&mut state, power_w).unwrap_err();
                prop_assert!(share > 1.0, "{}", error);
                prop_assert_eq!(found.to_string(), error.to_string());
                return Ok(());
            }
        };
        let seen = step.look(&state, power_w).unwrap();
        let start = step.advance(&mut state, power_w).unwrap();
        prop_assert_eq!(&state, &jacobian.next);
        prop_assert_eq!(start, seen);
        prop_assert_eq!((start.ccv_v, start.current_a), (jacobian.ccv_v, jacobian.current_a));
        prop_assert!((start.margin_low_v - (start.ccv_v - 2.5)).abs() < 1e-12);
        prop_assert!((start.margin_high_v - (4.2 - start.ccv_v)).abs() < 1e-12);
        prop_assert_eq!(start.infeasible, share > 1.0);
    }
}

#[test]
fn a_profile_of_steps_is_that_of_the_simulation() {
    let model = curved_cell();
    let powers_w = [60.0, 20.0, -30.0, 150.0, 0.0];
    let mut demand: Vec<(f64, f64)> = (0..).map(|k| 0.02 * f64::from(k)).zip(powers_w).collect();
    demand.push((0.1, 0.0));
    let profile = rows(Demand::Power, Interpolation::Hold, &demand);
    let mut state = model.rest(0.6).unwrap();
    let run = simulate(&model, &state, &profile, &SimOptions::default()).unwrap();
    let mut step = HeldStep::new(&model, &options(0.95, 0.02, 200), CellWindow::THESIS).unwrap();
    for (power_w, end_s) in powers_w.into_iter().zip([0.02, 0.04, 0.06, 0.08, 0.1]) {
        step.advance(&mut state, power_w).unwrap();
        let near = |time_s: &f64| (time_s - end_s).abs() < 1e-9;
        let row = run.trace.time_s.iter().position(near).unwrap();
        let apart_v = step.look(&state, power_w).unwrap().ccv_v - run.trace.ccv_v[row];
        assert!(apart_v.abs() < 1e-5, "{end_s} s: {apart_v} V");
    }
    assert!((state.soc - run.end.soc).abs() < 1e-9);
}

#[test]
fn a_pack_has_the_margins_of_its_cells() {
    let pack = Pack::new(16, 3, 0.01).unwrap();
    let model = SimModel::pack(&thesis_cell(), OcvSource::Constant(3.7), pack).unwrap();
    let step = HeldStep::new(&model, &options(0.95, 0.01, 1), CellWindow::THESIS).unwrap();
    let seen = step.look(&model.rest(0.5).unwrap(), 5000.0).unwrap();
    let cell_v = (seen.ccv_v + 0.01 * seen.current_a) / 16.0;
    assert!((seen.margin_low_v - (cell_v - 2.5)).abs() < 1e-12);
}

#[test]
fn a_state_without_voltage_and_one_of_another_model_are_errors_and_nothing_moves() {
    let model = curved_cell();
    let mut step = HeldStep::new(&model, &options(0.95, 0.01, 4), CellWindow::THESIS).unwrap();
    // The first branch loses its voltage within the step; then none is left behind the series
    // resistance.
    let mut state = model.rest(0.5).unwrap();
    state.v_rc_v = vec![-0.5, 0.0, 0.0, model.ocv_v(0.5).0 + 0.2];
    let before = state.clone();
    assert!(step.look(&state, 0.0).unwrap().ccv_v > 0.29);
    let error = step.advance(&mut state, 0.0).unwrap_err();
    assert!(matches!(error, ForwardError::Collapsed { .. }), "{error}");
    assert_eq!(state, before);
    state.v_rc_v.pop();
    let error = step.advance(&mut state, 5.0).unwrap_err();
    assert_eq!(
        error,
        ForwardError::Branches {
            expected: 4,
            met: 3
        }
    );
    let wrong = HeldStep::new(&model, &options(1.0, 0.01, 1), CellWindow::THESIS).unwrap_err();
    assert!(
        wrong.to_string().contains("above 0 and below 1, met 1"),
        "{wrong}"
    );
}
