use super::{Filter, Form, shared};
use crate::gate::tests::sim::{Hidden, campaign, model, series};
use crate::{DataSet, RunData};

/// Applies a filter to the logged current of a record, in small steps: with `anew` it resets where
/// no current flows. Each row is the mean until the next.
fn filtered(time_s: &[f64], current_a: &[f64], tau_s: f64, anew: bool) -> Vec<f64> {
    let mut state = current_a[0];
    let mut shown = Vec::new();
    for k in 0..time_s.len() {
        let step_s = time_s.get(k + 1).map_or(0.01, |t| t - time_s[k]);
        if anew && current_a[k].abs() < 0.5 {
            state = 0.0;
            shown.push(current_a[k]);
            continue;
        }
        let (mut sum, parts) = (0.0, 200);
        for _ in 0..parts {
            state += (current_a[k] - state) * -(-step_s / f64::from(parts) / tau_s).exp_m1();
            sum += state;
        }
        shown.push(sum / f64::from(parts));
    }
    shown
}

fn damaged(seed: u64, damage: impl Fn(&[f64], &[f64]) -> Vec<f64>) -> DataSet {
    let mut set = campaign(&Hidden::default(), seed);
    for run in &mut set.runs {
        if let RunData::Time(record) = &mut run.data {
            let s = &mut record.series;
            s.current_a = damage(&s.time_s, &s.current_a);
            // As coarse as the channel.
            for i in &mut s.current_a {
                *i = (*i / 0.1).round() * 0.1;
            }
        }
    }
    set
}

fn found(set: &DataSet) -> Filter {
    shared(set, &model()).unwrap()
}

#[test]
fn filters_are_found_with_form_and_time_constant() {
    for tau_s in [0.3, 1.0, 3.0] {
        for (anew, form) in [(false, Form::Plain), (true, Form::Restart)] {
            let met = found(&damaged(1, |t, i| filtered(t, i, tau_s, anew)));
            assert!(
                met.form == form && (met.tau_s / tau_s - 1.0).abs() < 0.05,
                "{form:?} of {tau_s} s: {:?} of {} ± {} s",
                met.form,
                met.tau_s,
                met.sigma_s
            );
        }
    }
}

#[test]
fn the_corrected_current_is_the_one_that_flowed() {
    for anew in [false, true] {
        let clean = campaign(&Hidden::default(), 2);
        let set = damaged(2, |t, i| filtered(t, i, 1.0, anew));
        let filter = found(&set);
        let mut corrected = filter.corrected(&set);
        let mut flowed = clean;
        for name in ["pulse_0", "discharge_1"] {
            let (own, truth) = (
                series(&mut corrected, name).current_a.clone(),
                series(&mut flowed, name).current_a.clone(),
            );
            let mut apart: Vec<f64> = own.iter().zip(&truth).map(|(a, b)| (a - b).abs()).collect();
            apart.sort_unstable_by(f64::total_cmp);
            let most = apart[apart.len() * 99 / 100];
            assert!(most < 0.5, "{name}: {most} A apart");
        }
    }
}

#[test]
fn no_filter_is_found_where_there_is_none() {
    for seed in 1..=6 {
        for hidden in [
            Hidden::default(),
            Hidden {
                slow: Some((3e-3, 1.0)),
                ..Hidden::default()
            },
        ] {
            let met = shared(&campaign(&hidden, seed), &model());
            assert!(met.is_none(), "seed {seed}: {met:?}");
        }
    }
}

#[test]
fn a_source_that_is_slow_is_not_a_slow_logger() {
    let mut set = damaged(1, |t, i| filtered(t, i, 1.0, false));
    for run in &mut set.runs {
        if let RunData::Time(record) = &mut run.data {
            let s = &mut record.series;
            s.voltage_v = filtered(&s.time_s, &s.voltage_v, 1.0, false);
        }
    }
    let met = shared(&set, &model());
    assert!(met.is_none(), "{met:?}");
}

#[test]
fn one_record_alone_has_no_shared_filter() {
    let mut set = campaign(&Hidden::default(), 1);
    let own = series(&mut set, "pulse_1");
    own.current_a = filtered(&own.time_s, &own.current_a, 1.0, false);
    assert!(shared(&set, &model()).is_none());
}

/// Compares the distance from the true current with its stated error: about 1 in the mean square.
#[test]
fn the_errors_of_the_corrected_current_are_what_they_are() {
    let mut flowed = campaign(&Hidden::default(), 3);
    for anew in [false, true] {
        let set = damaged(3, |t, i| filtered(t, i, 1.0, anew));
        let (mut squares, mut levels) = (0.0, 0.0);
        for own in &found(&set).records {
            let truth = &series(&mut flowed, &own.run).current_a;
            let starts = (0..truth.len())
                .filter(|k| *k == 0 || own.current_a[*k] != own.current_a[k - 1])
                .collect::<Vec<_>>();
            for (n, from) in starts.iter().copied().enumerate() {
                let to = starts.get(n + 1).copied().unwrap_or(truth.len());
                let mean_a = truth[from..to].iter().sum::<f64>() / (to - from) as f64;
                let own_a2: f64 = own.errors_a.iter().map(|e| e[from] * e[from]).sum();
                // The truth is logged as well, each row with its noise.
                let log_a2 = 0.042f64.powi(2) / (to - from) as f64;
                squares += (own.current_a[from] - mean_a).powi(2) / (own_a2 + log_a2);
                levels += 1.0;
            }
        }
        let size = squares / levels;
        assert!(
            (0.1..2.0).contains(&size),
            "{anew}: {size} over {levels} levels"
        );
    }
}

/// A step too small to show in the voltage shows in the log, if it lasts.
#[test]
fn a_small_step_is_reported_by_the_log() {
    // Within the rest after a discharge.
    let from_s = |t: &[f64]| 0.8 * t[t.len() - 1];
    let stepped = |t: &[f64], i: &[f64]| -> Vec<f64> {
        let is_long = t[t.len() - 1] > 400.0;
        let more = |(at_s, i): (&f64, &f64)| {
            let is_late = is_long && *at_s > from_s(t);
            if is_late { *i + 0.4 } else { *i }
        };
        t.iter().zip(i).map(more).collect()
    };
    let mut flowed = damaged(2, stepped);
    let set = damaged(2, |t, i| filtered(t, &stepped(t, i), 1.0, false));
    let mut corrected = found(&set).corrected(&set);
    let own = series(&mut corrected, "discharge_1").clone();
    let truth = series(&mut flowed, "discharge_1").current_a.clone();
    let begun_s = from_s(&own.time_s);
    let late: Vec<usize> = (0..truth.len())
        .filter(|k| own.time_s[*k] > begun_s + 1.0)
        .collect();
    let apart_a = late.iter().map(|k| own.current_a[*k] - truth[*k]);
    let off_a = apart_a.sum::<f64>() / late.len() as f64;
    assert!(late.len() > 5 && off_a.abs() < 0.05, "{off_a} A off");
}
