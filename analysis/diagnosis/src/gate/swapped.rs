//! Runs whose content belongs to another one: a current that differs from that of the repeats, a
//! voltage that follows another run's current, a control's spectrum under a cell's name.

use super::super::data::{Fixture, TimeRecord};
use super::current::difference;
use super::{Check, Findings, Inspection, Reason, Subject};
use crate::thresholds::{
    CURRENT_ALIKE, CURRENT_UNLIKE, NO_CURRENT_PART, OTHER_EXPLAINS, OWN_EXPLAINS, SPECTRUM_CLOSER,
    SPECTRUM_FAR,
};
use num_complex::Complex64;

/// Returns a voltage or a spectrum that is another run's.
pub(super) fn by_content(at: &Inspection<'_>) -> Findings {
    let reasons = at
        .runs
        .iter()
        .filter_map(|subject| of_voltage(at, subject).or_else(|| of_spectrum(at, subject)));
    Findings {
        invalid: reasons.collect(),
        notes: Vec::new(),
    }
}

/// Returns a current that is not that of the run's repeats.
pub(super) fn by_current(at: &Inspection<'_>) -> Findings {
    Findings {
        invalid: at
            .runs
            .iter()
            .filter_map(|subject| of_current(at, subject))
            .collect(),
        notes: Vec::new(),
    }
}

fn reason(subject: &Subject<'_>, check: Check, text: String) -> Option<Reason> {
    Some(Reason {
        check,
        runs: vec![subject.run.name.clone()],
        text,
    })
}

/// Records of the group, or of the other groups, but for the run itself.
fn records<'a>(
    at: &'a Inspection<'_>,
    subject: &'a Subject<'_>,
    same_group: bool,
) -> impl Iterator<Item = (&'a str, &'a TimeRecord)> {
    let like = move |other: &&Subject<'_>| {
        (other.run.repeat_group == subject.run.repeat_group) == same_group
            && other.run.name != subject.run.name
    };
    at.runs
        .iter()
        .filter(like)
        .filter_map(|other| Some((other.run.name.as_str(), other.record()?.0)))
}

fn of_current(at: &Inspection<'_>, subject: &Subject<'_>) -> Option<Reason> {
    let (record, _) = subject.record()?;
    let currents = at
        .runs
        .iter()
        .filter_map(|s| s.record())
        .flat_map(|(r, _)| &r.series.current_a);
    let least_a = NO_CURRENT_PART * currents.fold(0.0f64, |most, i| most.max(i.abs()));
    let closest = |same_group: bool| {
        records(at, subject, same_group)
            .filter_map(|(name, other)| Some((name, difference(record, other, least_a)?)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    };
    let (_, own) = closest(true)?;
    if own < CURRENT_UNLIKE {
        return None;
    }
    match closest(false).filter(|(_, other)| *other < CURRENT_ALIKE) {
        Some((name, _)) => reason(
            subject,
            Check::Swapped,
            format!("its current is not that of its repeats but that of {name}: exchanged runs?"),
        ),
        None => {
            let text = format!(
                "its current differs from that of every repeat by {:.0} % or more: not the same \
                experiment",
                100.0 * own
            );
            reason(subject, Check::Repeats, text)
        }
    }
}

/// Returns the share of the voltage's squares about its mean that a + b·expected explains, b above
/// zero.
fn explained(voltage_v: &[f64], expected_v: &[f64]) -> f64 {
    let n = voltage_v.len() as f64;
    let mean = |all: &[f64]| all.iter().sum::<f64>() / n;
    let (mv, me) = (mean(voltage_v), mean(expected_v));
    let pairs = voltage_v
        .iter()
        .zip(expected_v)
        .map(|(v, e)| (v - mv, e - me));
    let (vv, ve, ee) = pairs.fold((0.0, 0.0, 0.0), |(a, b, c), (v, e)| {
        (a + v * v, b + v * e, c + e * e)
    });
    if ve > 0.0 && vv > 0.0 && ee > 0.0 {
        ve * ve / (vv * ee)
    } else {
        0.0
    }
}

fn of_voltage(at: &Inspection<'_>, subject: &Subject<'_>) -> Option<Reason> {
    let (record, expected_v) = subject.record()?;
    let voltage_v = &record.series.voltage_v;
    if explained(voltage_v, expected_v) > OWN_EXPLAINS {
        return None;
    }
    let others = at.runs.iter().filter(|other| {
        other.run.name != subject.run.name && other.run.repeat_group != subject.run.repeat_group
    });
    let right = others.filter_map(|other| {
        let (theirs, predicted_v) = other.record()?;
        let n = predicted_v.len().min(voltage_v.len());
        // Of the time that both last, sample by sample: an exchanged column keeps its order, not
        // its times.
        let by_time: Vec<f64> = record
            .series
            .time_s
            .iter()
            .map_while(|t| interpolated(&theirs.series.time_s, predicted_v, *t))
            .collect();
        let enough = |m: usize| 2 * m > voltage_v.len();
        let share = [(n, predicted_v), (by_time.len(), by_time.as_slice())]
            .into_iter()
            .filter(|(m, _)| enough(*m))
            .map(|(m, all)| explained(&voltage_v[..m], &all[..m]))
            .fold(0.0, f64::max);
        (share > OTHER_EXPLAINS).then_some((other.run.name.as_str(), share))
    });
    let (name, _) = right.max_by(|a, b| a.1.total_cmp(&b.1))?;
    reason(
        subject,
        Check::Swapped,
        format!("its voltage does not follow its own current but that of {name}: exchanged runs?"),
    )
}

/// None beyond the last time.
fn interpolated(time_s: &[f64], values: &[f64], at_s: f64) -> Option<f64> {
    let k = time_s.partition_point(|t| *t <= at_s);
    if k == time_s.len() {
        return (time_s.last() == Some(&at_s)).then(|| values[k - 1]);
    }
    let k = k.max(1);
    let part = ((at_s - time_s[k - 1]) / (time_s[k] - time_s[k - 1])).clamp(0.0, 1.0);
    Some(values[k - 1] + part * (values[k] - values[k - 1]))
}

fn of_spectrum(at: &Inspection<'_>, subject: &Subject<'_>) -> Option<Reason> {
    let (sweep, expected) = subject.sweep()?;
    let measured: Vec<Complex64> = sweep.points.iter().map(|p| p.z_ohm).collect();
    let own = distance(&measured, expected);
    if own < SPECTRUM_FAR {
        return None;
    }
    let freqs =
        |s: &super::super::data::Sweep| s.points.iter().map(|p| p.freq_hz).collect::<Vec<f64>>();
    let others = at
        .runs
        .iter()
        .filter(|other| is_other_kind(&other.run.fixture, &subject.run.fixture));
    let right = others.filter_map(|other| {
        let (theirs, predicted) = other.sweep()?;
        (freqs(theirs) == freqs(sweep))
            .then(|| (other.run.name.as_str(), distance(&measured, predicted)))
    });
    let (name, other) = right.min_by(|a, b| a.1.total_cmp(&b.1))?;
    if other > SPECTRUM_CLOSER * own {
        return None;
    }
    let text = format!(
        "its spectrum is {:.0} % from what its fixture shows and {:.0} % from that of {name}: \
        exchanged runs?",
        100.0 * own,
        100.0 * other
    );
    reason(subject, Check::Swapped, text)
}

/// Returns whether two cells are expected to behave alike.
fn is_other_kind(a: &Fixture, b: &Fixture) -> bool {
    a != b && !matches!((a, b), (Fixture::Cell(_), Fixture::Cell(_)))
}

fn distance(measured: &[Complex64], expected: &[Complex64]) -> f64 {
    let (apart, size) = measured
        .iter()
        .zip(expected)
        .fold((0.0, 0.0), |(a, s), (m, e)| {
            (a + (m - e).norm_sqr(), s + e.norm_sqr())
        });
    (apart / size).sqrt()
}
