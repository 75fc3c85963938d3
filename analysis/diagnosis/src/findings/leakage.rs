//! Runs that contain the same rows: a held-out run that is a copy of a training run, or a part of
//! it, tests nothing; a repeat that is a copy carries no information about the noise.

use std::collections::HashMap;

use super::finding::{Finding, FindingKind};
use super::scene::{Played, Scene};
use crate::data::{Role, RunData, Sweep};
use crate::median::median;
use crate::thresholds::{
    COPY_CHANGES, COPY_DISTINCT, COPY_EQUAL_PART, COPY_LEAST_ROWS, COPY_LEAST_V, COPY_NOISE_PART,
    COPY_OF_RUN, COPY_WINDOW, SAME_TIME_S, WHITE_SCATTER_SIGMAS,
};

pub(super) fn find(scene: &Scene<'_>) -> Vec<Finding> {
    let records: Vec<Played<'_>> = scene.records().collect();
    let mut found = Vec::new();
    for (k, later) in records.iter().enumerate() {
        for earlier in &records[..k] {
            if let Some((text, how_sure)) =
                same_rows(later, earlier).or_else(|| near(scene, later, earlier))
            {
                let held_out = [later.is_held_out(), earlier.is_held_out()];
                found.push(finding(
                    &[&later.run.name, &earlier.run.name],
                    held_out,
                    &text,
                    how_sure,
                ));
            }
        }
    }
    let sweeps: Vec<(&str, bool, &Sweep)> = scene
        .at
        .runs
        .iter()
        .filter_map(|subject| match &subject.run.data {
            RunData::Eis(sweep) => Some((
                subject.run.name.as_str(),
                subject.run.role == Role::HeldOut,
                sweep,
            )),
            RunData::Time(_) => None,
        })
        .collect();
    for (k, (later, is_held_out, sweep)) in sweeps.iter().enumerate() {
        for (earlier, was_held_out, other) in &sweeps[..k] {
            if let Some((text, how_sure)) = same_points(sweep, other) {
                let held_out = [*is_held_out, *was_held_out];
                found.push(finding(&[later, earlier], held_out, &text, how_sure));
            }
        }
    }
    found
}

fn finding(runs: &[&str; 2], held_out: [bool; 2], text: &str, how_sure: String) -> Finding {
    // The held-out run is named first.
    let [a, b] = match held_out {
        [false, true] => [runs[1], runs[0]],
        _ => *runs,
    };
    let leaks = held_out[0] != held_out[1];
    let (kind, effect) = if leaks {
        (
            FindingKind::Leakage,
            format!(
                "{a} was fitted as {b}: its gap does not test a prediction. Hold out another run."
            ),
        )
    } else {
        (
            FindingKind::Copy,
            "Two copies are taken for two measurements: the noise between repeats comes out too \
            small, and the information of the run counts twice."
                .to_owned(),
        )
    };
    let role = if leaks { "held-out " } else { "" };
    let other = if leaks { "the training run " } else { "" };
    Finding {
        kind,
        runs: vec![a.to_owned(), b.to_owned()],
        text: format!("{role}{a} and {other}{b}: {text}"),
        how_sure,
        effect,
        correctable: false,
    }
}

/// Current and voltage of a compared row, to the last digit.
type Row = (u64, u64);

fn rows(played: &Played<'_>) -> Vec<Row> {
    let series = &played.record.series;
    (played.first_compared()..series.len())
        .map(|k| (series.current_a[k].to_bits(), series.voltage_v[k].to_bits()))
        .collect()
}

/// Returns whether a stretch of rows can be distinguished from another one that looks alike.
fn is_distinct(window: &[Row]) -> bool {
    let mut voltages: Vec<u64> = window.iter().map(|row| row.1).collect();
    voltages.sort_unstable();
    voltages.dedup();
    voltages.len() >= COPY_DISTINCT
}

/// Returns a stretch of rows that is in both to the last digit.
fn same_rows(own: &Played<'_>, theirs: &Played<'_>) -> Option<(String, String)> {
    let (a, b) = (rows(own), rows(theirs));
    let mut known: HashMap<&[Row], usize> = HashMap::new();
    for (start, window) in b.windows(COPY_WINDOW).enumerate() {
        if is_distinct(window) {
            known.entry(window).or_insert(start);
        }
    }
    // Start in one less start in the other, with the first and the last row that it explains.
    let mut shifts: HashMap<isize, (usize, usize)> = HashMap::new();
    for (start, window) in a.windows(COPY_WINDOW).enumerate() {
        if let Some(at) = known.get(window) {
            let shift = start as isize - *at as isize;
            let end = start + COPY_WINDOW;
            shifts
                .entry(shift)
                .and_modify(|(_, last)| *last = end)
                .or_insert((start, end));
        }
    }
    let (shift, (first, last)) = shifts
        .into_iter()
        .max_by_key(|(shift, (first, last))| (last - first, std::cmp::Reverse(*shift)))?;
    // A window identifies a copy; as long as the rows are equal, they belong to it.
    let is_equal = |k: usize| {
        let theirs = k.checked_add_signed(-shift).and_then(|j| b.get(j));
        a.get(k).is_some_and(|own| theirs == Some(own))
    };
    let first = (0..first)
        .rev()
        .take_while(|k| is_equal(*k))
        .last()
        .unwrap_or(first);
    let last = last + (last..).take_while(|k| is_equal(*k)).count();
    let of = last - first;
    let equal = (first..last).filter(|k| is_equal(*k)).count();
    let changes = a[first..last]
        .windows(2)
        .filter(|w| w[0].1 != w[1].1)
        .count();
    let copied = of >= COPY_LEAST_ROWS
        && changes >= COPY_CHANGES
        && equal as f64 >= COPY_EQUAL_PART * of as f64
        && of as f64 >= COPY_OF_RUN * a.len().min(b.len()) as f64;
    copied.then(|| {
        let series = &own.record.series;
        let from = own.first_compared() + first;
        let text = format!(
            "{equal} rows hold the same current and voltage to the last digit, from {:.3} s to \
            {:.3} s of {}",
            series.time_s[from],
            series.time_s[from + of - 1],
            own.run.name
        );
        (
            text,
            format!("{equal} of {of} rows in a row are equal, among them {changes} changes of the voltage"),
        )
    })
}

/// Returns a run that is another one but for rounding, or some noise upon it.
fn near(scene: &Scene<'_>, own: &Played<'_>, theirs: &Played<'_>) -> Option<(String, String)> {
    let (a, b) = (&own.record.series, &theirs.record.series);
    let from = own.first_compared().max(theirs.first_compared());
    let same_times = a.len() == b.len()
        && a.time_s
            .iter()
            .zip(&b.time_s)
            .all(|(x, y)| (x - y).abs() < SAME_TIME_S);
    if !same_times || a.len() < from + COPY_LEAST_ROWS {
        return None;
    }
    // The expectation of the model is subtracted, so that an edge does not count as scatter.
    let own_v: Vec<f64> = (from..a.len())
        .map(|k| a.voltage_v[k] - own.expected_v[k])
        .collect();
    let their_v: Vec<f64> = (from..b.len())
        .map(|k| b.voltage_v[k] - theirs.expected_v[k])
        .collect();
    let apart_v: Vec<f64> = (from..a.len())
        .map(|k| a.voltage_v[k] - b.voltage_v[k])
        .collect();
    // The model's error scatters too, but equally in both.
    let noise_v = WHITE_SCATTER_SIGMAS * scene.at.sample_noise_v(own.record);
    let single = (scatter(&own_v) * scatter(&their_v)).sqrt().min(noise_v);
    let apart = scatter(&apart_v);
    let part = apart / (2f64.sqrt() * single);
    // Coarse codes make most differences zero, of two measurements too.
    (apart > COPY_LEAST_V && part < COPY_NOISE_PART).then(|| {
        (
            format!(
                "their voltages differ from row to row by {:.0} % of what the noise of two runs \
                makes",
                100.0 * part
            ),
            format!(
                "over {} rows at the same times; two measurements give 100 %",
                apart_v.len()
            ),
        )
    })
}

/// Returns the middle of the second differences, by size: noise, without what moves slowly.
fn scatter(values: &[f64]) -> f64 {
    median(
        values
            .windows(3)
            .map(|w| (w[2] - 2.0 * w[1] + w[0]).abs())
            .collect(),
    )
}

fn same_points(own: &Sweep, theirs: &Sweep) -> Option<(String, String)> {
    let equal = own
        .points
        .iter()
        .filter(|p| {
            theirs
                .points
                .iter()
                .any(|o| o.freq_hz == p.freq_hz && o.z_ohm == p.z_ohm)
        })
        .count();
    let of = own.points.len().min(theirs.points.len());
    // Two points of one spectrum may be equal by chance where its digits are few.
    (equal > 2 && equal as f64 >= COPY_EQUAL_PART * of as f64).then(|| {
        (
            format!("{equal} points hold the same impedance to the last digit"),
            format!("{equal} of {of} points are equal"),
        )
    })
}
