//! Rounded time stamps, and samples too far apart for the model or for the current.

use std::ops::Range;

use super::finding::{Finding, FindingKind, names};
use super::scene::{Played, Scene};
use crate::data::Run;
use crate::median::median;
use crate::thresholds::{
    GAP_CHANGES_PART, LARGE_STEP_PART, ROUNDED_FEWEST, ROUNDED_MOST_QUANTA, ROUNDED_PART,
    SLOW_BRANCH_PART, SLOW_SHARE, UNSEEN_PART,
};
use analysis_effects::augmented::Between;

pub(super) fn rounded(scene: &Scene<'_>) -> Vec<Finding> {
    let all: Vec<(Played<'_>, f64, f64)> = scene
        .records()
        .filter_map(|played| {
            let (quantum_s, part) = rounding(&played)?;
            Some((played, quantum_s, part))
        })
        .collect();
    let Some((_, quantum_s, part)) = all.iter().max_by(|a, b| a.1.total_cmp(&b.1)) else {
        return Vec::new();
    };
    let runs: Vec<String> = all.iter().map(|(p, ..)| p.run.name.clone()).collect();
    vec![Finding {
        kind: FindingKind::StampsRounded,
        text: format!(
            "{}: time stamps are rounded to {quantum_s} s, more than the distance of the samples \
            scatters by",
            names(&runs)
        ),
        how_sure: format!(
            "{:.0} % of the steps differ from the one before by exactly {quantum_s} s",
            100.0 * part
        ),
        effect: format!(
            "An edge of the current is wrong by up to {} s. A fast branch, a skew of the channels \
            and a lag of the current show it.",
            0.5 * quantum_s
        ),
        runs,
        correctable: false,
    }]
}

/// Returns the quantum of stamps, s, and the fraction of steps that it makes uneven, or `None` if
/// the sampling is as even as the stamps.
fn rounding(played: &Played<'_>) -> Option<(f64, f64)> {
    const QUANTA_S: [f64; 10] = [10.0, 5.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.001];
    let series = &played.record.series;
    let steps: Vec<f64> = series.time_s.windows(2).map(|w| w[1] - w[0]).collect();
    let is_multiple = |h: &f64, q: f64| {
        let n = h / q;
        n > 0.5 && (n - n.round()).abs() < 1e-4
    };
    let quantum_s = QUANTA_S
        .into_iter()
        .find(|q| steps.iter().all(|h| is_multiple(h, *q)))?;
    // A step that is one quantum longer or shorter than the one before, there and back.
    let quanta: Vec<i64> = steps
        .iter()
        .map(|h| (h / quantum_s).round() as i64)
        .collect();
    // A logger that samples at edges too is not uneven by rounding.
    let largest_a = played.largest_a();
    let (low_v, high_v) = series
        .voltage_v
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
            (l.min(*v), h.max(*v))
        });
    let still = |rows: &[f64], size: f64| {
        rows.windows(2)
            .all(|w| (w[1] - w[0]).abs() < GAP_CHANGES_PART * size)
    };
    // The voltage sees an edge that the log has smoothed.
    let is_quiet = |rows: Range<usize>| {
        still(&series.current_a[rows.clone()], largest_a)
            && still(&series.voltage_v[rows], high_v - low_v)
    };
    let uneven = quanta
        .windows(3)
        .enumerate()
        .filter(|(first, w)| {
            let around = first.saturating_sub(1)..(first + 5).min(series.len());
            let most = w.iter().max().copied().unwrap_or(0);
            (w[1] - w[0]).abs() == 1
                && (w[2] - w[1]) * (w[1] - w[0]) <= 0
                && most <= ROUNDED_MOST_QUANTA as i64
                && is_quiet(around)
        })
        .count();
    let part = uneven as f64 / quanta.len().max(1) as f64;
    (uneven >= ROUNDED_FEWEST && part >= ROUNDED_PART).then_some((quantum_s, part))
}

pub(super) fn slow(scene: &Scene<'_>) -> Vec<Finding> {
    let erm = &scene.model.erm;
    let all: Vec<(String, f64)> = scene
        .of_cells()
        .filter(|played| played.record.between == Between::Linear)
        .filter_map(|played| Some((played.run.name.clone(), at_edges_s(&played)?)))
        .collect();
    let share_of = |interval_s: f64| {
        erm.branches
            .iter()
            .filter(|b| b.time_constant_s() < SLOW_BRANCH_PART * interval_s)
            .map(|b| b.r_ohm)
            .sum::<f64>()
            / erm.dc_resistance_ohm()
    };
    let slow: Vec<&(String, f64)> = all
        .iter()
        .filter(|(_, interval_s)| share_of(*interval_s) > SLOW_SHARE)
        .collect();
    if slow.is_empty() {
        return Vec::new();
    }
    let runs: Vec<String> = slow.iter().map(|(name, _)| name.clone()).collect();
    let typical_s = median(slow.iter().map(|(_, s)| *s).collect());
    vec![Finding {
        kind: FindingKind::SamplingSlow,
        text: format!(
            "{}: samples at edges of the current are {typical_s:.3} s apart in the middle; \
            branches faster than {:.3} s hold {:.0} % of the model's resistance",
            names(&runs),
            SLOW_BRANCH_PART * typical_s,
            100.0 * share_of(typical_s)
        ),
        how_sure: "certain: stamps against the model's time constants".to_owned(),
        effect: "These records cannot separate such a branch from the series resistance, nor a \
            fast effect from an edge between two samples."
            .to_owned(),
        runs,
        correctable: false,
    }]
}

/// Returns the records whose current is unrelated from one sample to the next. Repeats of such a
/// record are excluded with it.
pub(super) fn unseen(scene: &Scene<'_>) -> Vec<Finding> {
    let cells: Vec<(&Run, Option<f64>)> = scene
        .of_cells()
        .filter(|played| played.record.between == Between::Linear)
        .map(|played| (played.run, unresolved(&played)))
        .collect();
    let is_unseen = |part: &Option<f64>| part.is_some_and(|part| part > UNSEEN_PART);
    let repeats = |a: &Run, b: &Run| a.repeat_group == b.repeat_group && a.role == b.role;
    let runs: Vec<String> = cells
        .iter()
        .map(|(run, _)| *run)
        .filter(|run| {
            let mut others = cells.iter();
            others.any(|(other, part)| is_unseen(part) && repeats(run, other))
        })
        .map(|run| run.name.clone())
        .collect();
    if runs.is_empty() {
        return Vec::new();
    }
    let parts = cells.iter().filter_map(|(_, part)| *part);
    let most = parts.fold(0.0, f64::max);
    vec![Finding {
        kind: FindingKind::CurrentUnseen,
        text: format!(
            "{}: the current changes faster than it is logged; what it was between two samples is \
            not known",
            names(&runs)
        ),
        how_sure: format!(
            "certain: up to {:.0} % of the large steps of the current are followed by another one \
            there or back at the next sample, and that by a third",
            100.0 * most
        ),
        effect: "These records are left out: they are neither fitted nor compared. A faster log \
            would make them useful. So would `current_between_samples = \"hold\"`, where the \
            samples stand at the steps of the current."
            .to_owned(),
        runs,
        correctable: false,
    }]
}

/// Returns the fraction of the large steps of the current that stand in a row of three or more
/// between successive samples, no two of them on one slope. Returns `None` for means over windows,
/// whose edges are known, and for a current without large steps.
fn unresolved(played: &Played<'_>) -> Option<f64> {
    if played.record.averaged_s.is_some() {
        return None;
    }
    let current_a = &played.record.series.current_a[played.first_compared()..];
    let steps: Vec<f64> = current_a.windows(2).map(|w| w[1] - w[0]).collect();
    let largest_a = played.largest_a();
    let is_large = |step: f64| step.abs() > LARGE_STEP_PART * largest_a;
    // Twice as large as the one before, or half, or back: no slope.
    let is_turn =
        |a: f64, b: f64| a * b < 0.0 || a.abs() > 2.0 * b.abs() || b.abs() > 2.0 * a.abs();
    let (mut all, mut in_rows, mut row) = (0, 0, 0);
    for (k, step) in steps.iter().enumerate() {
        if !is_large(*step) {
            row = 0;
            continue;
        }
        all += 1;
        let goes_on = row > 0 && is_turn(steps[k - 1], *step);
        row = if goes_on { row + 1 } else { 1 };
        in_rows += match row {
            1 | 2 => 0,
            3 => 3,
            _ => 1,
        };
    }
    (all > 0).then(|| f64::from(in_rows) / f64::from(all))
}

/// Typical distance of the two samples around a large step of the current, s.
fn at_edges_s(played: &Played<'_>) -> Option<f64> {
    let series = &played.record.series;
    let largest_a = series
        .current_a
        .windows(2)
        .fold(0.0f64, |most, w| most.max((w[1] - w[0]).abs()));
    let edges: Vec<f64> = (played.first_compared().max(1)..series.len())
        .filter(|k| {
            (series.current_a[*k] - series.current_a[k - 1]).abs() > LARGE_STEP_PART * largest_a
        })
        .map(|k| series.time_s[k] - series.time_s[k - 1])
        .collect();
    (!edges.is_empty()).then(|| median(edges))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{Fixture, Role, RunData, Start, TimeRecord};
    use analysis_signal::series::TimeSeries;

    fn part(current_a: &[f64]) -> Option<f64> {
        let series = TimeSeries {
            name: "log".to_owned(),
            time_s: (0..current_a.len()).map(|k| k as f64).collect(),
            current_a: current_a.to_vec(),
            voltage_v: vec![3.7; current_a.len()],
            temperature_degc: None,
        };
        let record = TimeRecord {
            series,
            between: Between::Linear,
            compared_from_s: 0.0,
            level_sigma_v: 0.0,
            sigma_v: None,
            averaged_s: None,
            current_errors_a: Vec::new(),
        };
        let run = Run {
            name: "log".to_owned(),
            fixture: Fixture::Cell("cell".to_owned()),
            role: Role::Train,
            repeat_group: "log".to_owned(),
            order: 0,
            start_s: 0.0,
            temperature_degc: 25.0,
            start: Start::Soc(0.5),
            data: RunData::Time(record.clone()),
        };
        unresolved(&Played {
            run: &run,
            record: &record,
            expected_v: &record.series.voltage_v,
        })
    }

    fn repeated(levels: &[f64], rows: usize) -> Vec<f64> {
        levels.iter().flat_map(|i| vec![*i; rows]).collect()
    }

    /// Levels that a linear congruence draws, A.
    fn drawn(count: u64) -> Vec<f64> {
        let draw = |k: u64| ((k * 7919 + 13) % 101) as f64;
        (0..count).map(draw).collect()
    }

    #[test]
    fn a_current_that_jumps_from_row_to_row_is_not_known_between_them() {
        let jumps = drawn(60);
        assert!(part(&jumps).unwrap() > 0.6, "{:?}", part(&jumps));
        // Hours of rest beside the jumps do not change the result.
        let with_rest = [vec![0.0; 5000], jumps].concat();
        assert!(part(&with_rest).unwrap() > 0.6, "{:?}", part(&with_rest));
    }

    #[test]
    fn steps_with_rows_on_either_side_are_known() {
        assert_eq!(part(&repeated(&drawn(30), 2)), Some(0.0));
        assert_eq!(part(&repeated(&[0.0, 5.0, -5.0, 0.0, 5.0], 3)), Some(0.0));
        // Pulses of one row: how long they were is an error of two edges.
        let pulses = [vec![0.0; 5], vec![9.0]].concat().repeat(6);
        assert_eq!(part(&pulses), Some(0.0));
    }

    #[test]
    fn a_wave_that_is_sampled_often_enough_is_known() {
        let wave = |rows_per_period: f64| {
            let at = |k: u32| 10.0 * (std::f64::consts::TAU * f64::from(k) / rows_per_period).sin();
            part(&(0..80).map(at).collect::<Vec<f64>>()).unwrap_or(0.0)
        };
        assert!(wave(12.0) < UNSEEN_PART, "{}", wave(12.0));
        assert!(wave(2.3) > UNSEEN_PART, "{}", wave(2.3));
        assert_eq!(part(&[4.0; 50]), None, "a constant current");
    }
}
