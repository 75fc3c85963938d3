use super::design::Design;
use super::error::*;
use super::log::Log;
use super::score::{predict, residuals};
use super::solution::Solution;
use super::solve::START;
use super::tests::{curve, log, of_logs, options};
use super::train::Train;
use super::{MapFit, MapLog, fit_map};
use analysis_model::map::{ErrorSource, VoltageError};
use analysis_signal::series::Role;
use nalgebra::{DMatrix, DVector};

/// A voltage that misses the law of the map by 8 % of the overpotential, over and over in 90 s.
fn bent(name: &str, degc: f64, seed: u64, role: Role) -> MapLog {
    let mut log = log(name, degc, seed, role);
    let (mut soc, mut last_s) = (1.0, 0.0);
    for k in 0..log.series.len() {
        let series = &mut log.series;
        let (t, i) = (series.time_s[k], series.current_a[k]);
        soc -= (t - last_s) * i / (3600.0 * 3.0);
        last_s = t;
        let overpotential_v = 3.0 + soc + 0.1 * soc * soc - series.voltage_v[k];
        let phase = std::f64::consts::TAU * t / 90.0;
        series.voltage_v[k] -= 0.08 * std::f64::consts::SQRT_2 * phase.sin() * overpotential_v;
    }
    log
}

/// A map of two such logs, and its error on two others.
fn fit_with_held_out_logs() -> MapFit {
    let logs = [
        bent("warm", 25.0, 1, Role::Train),
        bent("cold", 0.0, 2, Role::Train),
        bent("warm too", 25.0, 3, Role::HeldOut),
        bent("cold too", 0.0, 4, Role::HeldOut),
    ];
    fit_map(&of_logs(logs), &curve(), &options()).unwrap()
}

#[test]
fn the_error_of_one_held_out_log_covers_another() {
    let fit = fit_with_held_out_logs();
    let error = fit.map.voltage_error.clone().unwrap();
    assert_eq!(error.from, ErrorSource::HeldOut);
    for share in &error.share {
        assert!((0.07..0.09).contains(share), "{error:?}");
    }
    assert!(error.rest_v < 4e-3, "{error:?}");
    for score in &fit.logs[2..] {
        // By the error that the other held-out log shows.
        assert!(score.covered.unwrap() > 0.9, "{score:?}");
    }
    assert_eq!(fit.logs[0].covered, None);
    let other = Log::new(&bent("other", 12.0, 5, Role::HeldOut), &curve()).unwrap();
    let errors_v = residuals(&fit.map, &other, fit.lag_s);
    let inside = covered(&fit.map, &curve(), &other, &errors_v).unwrap();
    assert!((0.9..=1.0).contains(&inside), "{inside}");
    // Half the error covers less: the band is not wide by its floor.
    let mut narrow = fit.map;
    narrow.voltage_error = Some(VoltageError {
        share: error.share.iter().map(|share| 0.5 * share).collect(),
        ..error
    });
    let inside = covered(&narrow, &curve(), &other, &errors_v).unwrap();
    assert!(inside < 0.85, "{inside}");
}

/// Predicted voltages in the last piece of a log: without that piece, and with it.
fn last_piece(log: &MapLog) -> [Vec<f64>; 2] {
    let (log, ocv) = (Log::new(log, &curve()).unwrap(), curve());
    let logs = [log];
    let (log, train) = (&logs[0], Train::new(&logs, &[], &ocv));
    let design = Design::new(&train, &[], &options()).unwrap();
    let all = Solution::new(design, &train, START).unwrap();
    let without = predict_left_out(&all, &train).remove(0);
    let with = residuals(&all.map(), log, 0.0);
    let voltage_v = &log.samples.voltage_v;
    [without, with].map(|errors_v| {
        let all = voltage_v.iter().zip(&errors_v).map(|(v, e)| v - e);
        all.skip(last_piece_begins(log)).collect()
    })
}

fn last_piece_begins(log: &Log) -> usize {
    let samples = log.rows().div_ceil(PIECES) * log.every();
    (log.len() - 1) / samples * samples
}

#[test]
fn a_piece_is_predicted_without_its_own_samples() {
    let good = log("log", 25.0, 1, Role::Train);
    let mut wrong = good.clone();
    let from = last_piece_begins(&Log::new(&good, &curve()).unwrap());
    for v in &mut wrong.series.voltage_v[from..] {
        *v -= 0.03;
    }
    let apart = |[a, b]: [&Vec<f64>; 2]| {
        let both = a.iter().zip(b);
        both.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
    };
    let ([a, of_all_a], [b, of_all_b]) = (last_piece(&good), last_piece(&wrong));
    assert!(
        apart([&of_all_a, &of_all_b]) > 0.01,
        "the fit to all follows"
    );
    assert!(apart([&a, &b]) < 0.001, "{}", apart([&a, &b]));
    let fit = fit_map(&of_logs([wrong]), &curve(), &options()).unwrap();
    assert_eq!(fit.map.voltage_error.unwrap().from, ErrorSource::LeftOut);
}

#[test]
fn a_temperature_without_samples_has_the_share_of_its_neighbour() {
    // Node 1 has samples, node 2 some by a small weight with other errors, nodes 3 and 4 have none.
    let rows = DMatrix::from_fn(400, 5, |i, j| match (j, i) {
        (0, _) => 1e-4,
        (1, _) => 1e-2 * (1 + i % 7) as f64,
        (2, 0..20) => 1e-3,
        _ => 0.0,
    });
    let mut squares = &rows * DVector::from_vec(vec![0.25, 0.04, 0.0, 0.0, 0.0]);
    for square in squares.iter_mut().take(20) {
        *square *= 1.5;
    }
    let found = variances(&rows, &squares, &DVector::from_element(400, 1.0)).unwrap();
    for met in found.iter().skip(1) {
        assert!((met / 0.04 - 1.0).abs() < 0.15, "{found}");
    }
}

#[test]
fn held_out_logs_that_say_too_little_leave_the_error_to_pieces() {
    let mut short = log("short", 25.0, 3, Role::HeldOut);
    for column in [
        &mut short.series.time_s,
        &mut short.series.current_a,
        &mut short.series.voltage_v,
    ] {
        column.truncate(300);
    }
    short
        .series
        .temperature_degc
        .as_mut()
        .unwrap()
        .truncate(300);
    let logs = [log("long", 25.0, 1, Role::Train), short];
    let fit = fit_map(&of_logs(logs), &curve(), &options()).unwrap();
    assert_eq!(
        fit.map.voltage_error.unwrap().from,
        ErrorSource::LeftOut,
        "30 s are three correlation times"
    );
    assert!(fit.logs[0].left_out_rms_v.is_some() && fit.logs[1].left_out_rms_v.is_none());
    // No other log shows a band for the only one with pieces.
    assert_eq!(fit.logs[0].covered, None);
}

#[test]
fn the_factor_for_whole_runs_has_the_rank_of_95_percent_of_the_pieces() {
    let pieces = |count: u32| (1..=count).map(f64::from).collect();
    // 0.95 of 40 is 38.
    assert_eq!(whole_runs(pieces(39)), Some(38.0));
    // The rank is beyond the pieces: the largest.
    assert_eq!(whole_runs(pieces(10)), Some(10.0));
    assert_eq!(whole_runs(Vec::new()), None);
    assert_eq!(whole_runs(vec![0.2, 0.4]), Some(1.0));
}

#[test]
fn the_band_for_whole_runs_holds_the_pieces_of_the_logs_that_show_it() {
    let fit = fit_with_held_out_logs();
    let factor = fit.map.voltage_error.as_ref().unwrap().whole_runs.unwrap();
    let other = Log::new(&bent("other", 12.0, 5, Role::HeldOut), &curve()).unwrap();
    let of_other = predict(&fit.map, &other, fit.lag_s);
    let errors_v = &of_other.residual_v;
    let farthest = farthest(&fit.map, &curve(), &other, &of_other.lasting_v, errors_v);
    assert_eq!(farthest.len(), PIECES);
    let inside = farthest.iter().filter(|far| **far <= factor).count();
    assert!(inside >= PIECES - 1, "{farthest:?} {factor}");
    // It is no wider than the pieces need.
    assert!(
        farthest.iter().any(|far| *far > 0.5 * factor),
        "{farthest:?} {factor}"
    );
}
