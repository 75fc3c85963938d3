use super::solve::Rows;
use super::tests::{curve, log, of_logs, options};
use super::*;
use analysis_signal::series::Role;
use nalgebra::DMatrix;

/// Steps of 10 s between 1 and 6 A for ten minutes.
fn load(soc: f64, temperature_degc: f64) -> Load {
    let time_s: Vec<f64> = (0..600).map(f64::from).collect();
    let steps = time_s.iter().map(|t| {
        if (t / 10.0).floor() % 2.0 == 0.0 {
            6.0
        } else {
            1.0
        }
    });
    Load {
        name: "load".to_owned(),
        current_a: steps.collect(),
        time_s,
        soc,
        temperature_degc,
    }
}

fn plan(loads: &[Load], choices: &Choices, count: usize) -> NextPlan {
    let mut warm = log("warm", 25.0, 1, Role::Train);
    // The log ends at a SOC of about 0.6.
    for list in [
        &mut warm.series.time_s,
        &mut warm.series.current_a,
        &mut warm.series.voltage_v,
        warm.series.temperature_degc.as_mut().unwrap(),
    ] {
        list.truncate(20_000);
    }
    let data = of_logs([warm]);
    let (ocv, options) = (curve(), options());
    let fit = fit_map(&data, &ocv, &options).unwrap();
    let fitted = Fitted {
        data: &data,
        ocv: &ocv,
        options: &options,
        fit: &fit,
    };
    plan_next(fitted, loads, choices, count).unwrap()
}

#[test]
fn a_load_beyond_the_data_is_measured_where_it_flows() {
    let choices = Choices::new(3.0, &Choices::SOC, &[5.0, 25.0]);
    for (soc, degc) in [(0.3, 25.0), (0.3, 5.0)] {
        let plan = plan(&[load(soc, degc)], &choices, 4);
        let first = plan.next[0];
        assert!((first.soc - soc).abs() < 0.16, "{soc} {degc}: {plan:?}");
        assert_eq!(first.temperature_degc, degc, "{plan:?}");
        let errors: Vec<f64> = plan.next.iter().map(|next| next.error_v).collect();
        assert!(
            errors.windows(2).all(|w| w[1] <= w[0] + 1e-12),
            "{errors:?}"
        );
        assert!(
            errors[3] < 0.5 * plan.error_v,
            "{} {errors:?}",
            plan.error_v
        );
    }
}

#[test]
fn a_load_within_the_data_gains_little() {
    let choices = Choices::new(3.0, &Choices::SOC, &[25.0]);
    let (within, beyond) = (
        plan(&[load(0.8, 27.0)], &choices, 1),
        plan(&[load(0.3, 27.0)], &choices, 1),
    );
    assert!(
        within.error_v < 0.3 * beyond.error_v,
        "{within:?} {beyond:?}"
    );
}

#[test]
fn the_way_and_the_rest_count_once_for_a_place() {
    let choices = Choices::new(3.0, &[0.3], &[25.0]);
    let plan = plan(&[load(0.35, 25.0)], &choices, 5);
    assert_eq!(plan.next.len(), 2, "{plan:?}");
    // From full at C/2: 0.7·120 min; temperature 60 min, rest 30 min; pulses 100 s; a spectrum of 20
    // points from 0.1 to 300 Hz with 14 periods and 3 s each: 7.8 min by hand.
    let way = 84.0 + 60.0 + 30.0;
    let own = |what: Measurement| {
        if what == Measurement::Pulses {
            100.0 / 60.0
        } else {
            7.80
        }
    };
    let [first, second] = plan.next[..] else {
        panic!("{plan:?}")
    };
    assert_ne!(first.what, second.what);
    assert!(
        (first.minutes - way - own(first.what)).abs() < 0.2,
        "{plan:?}"
    );
    assert!((second.minutes - own(second.what)).abs() < 0.2, "{plan:?}");
}

/// The error of a load is the root of the mean of the diagonal of X·Σ·Xᵀ, which the square of few
/// columns gives without the others.
#[test]
fn rows_without_their_empty_columns_give_the_same_error() {
    let rows = DMatrix::from_fn(40, 9, |i, j| {
        let touched = [1, 2, 5, 8].contains(&j);
        let value = ((7 * i + 3 * j) % 11) as f64 - 5.0;
        if touched { value } else { 0.0 }
    });
    let root = DMatrix::from_fn(9, 9, |i, j| ((5 * i + 2 * j) % 7) as f64 - 2.5);
    let covariance = &root * root.transpose();
    let few = Rows::of(&rows);
    assert_eq!(few.columns, [1, 2, 5, 8]);
    let mut square = DMatrix::zeros(9, 9);
    few.add_square_to(&mut square);
    assert!((&square - rows.tr_mul(&rows)).norm() < 1e-9);
    let dense = &rows * &covariance * rows.transpose();
    assert!((covariance.dot(&square) / dense.trace() - 1.0).abs() < 1e-12);
    assert!((few.around(&covariance) - &dense).norm() < 1e-9 * dense.norm());
    let gain = &covariance * rows.transpose();
    assert!((few.after(&covariance) - &gain).norm() < 1e-9 * gain.norm());
}
