//! Checks units and signs: the size of the measured values against the base model's, by powers of
//! ten.

use super::super::data::{Fixture, Run, RunData, TimeRecord};
use super::{Check, Findings, Inspection, Subject};
use crate::median::median;
use crate::thresholds::{LARGE_STEP_PART, LEAST_LEVEL_V, REVERSED_PART, VISIBLE_STEP_SIGMAS};

pub(super) fn check(at: &Inspection<'_>) -> Findings {
    let mut found = Findings::default();
    for subject in &at.runs {
        let fault = match &subject.run.data {
            RunData::Eis(_) => of_sweep(subject),
            RunData::Time(record) => of_record(at, subject, record),
        };
        if let Some((check, text)) = fault {
            found.add(check, subject.run, text);
        }
    }
    found
}

/// Returns true if the nearest power of ten is a thousand, or a thousandth.
fn is_thousandfold(ratio: f64) -> bool {
    ratio > 0.0 && ratio.log10().round().abs() == 3.0
}

fn of_record(
    at: &Inspection<'_>,
    subject: &Subject<'_>,
    record: &TimeRecord,
) -> Option<(Check, String)> {
    if let Some((_, expected_v)) = subject.record() {
        let ratio = record.series.voltage_v[0] / expected_v[0];
        if expected_v[0].abs() > LEAST_LEVEL_V && is_thousandfold(ratio) {
            let (met, expected) = (record.series.voltage_v[0], expected_v[0]);
            return Some((
                Check::Unit,
                format!(
                    "its voltage is {ratio:.0} times what it must be, {met:.0} against \
                    {expected:.3} V: mV for V?"
                ),
            ));
        }
    }
    let (low_ohm, high_ohm) = resistance(at, subject.run);
    let expected_ohm = (low_ohm * high_ohm).sqrt();
    let steps = Steps::of(record)?;
    if steps.largest_a * steps.ohm.abs().max(low_ohm)
        < VISIBLE_STEP_SIGMAS * at.sample_noise_v(record)
    {
        return None;
    }
    let ratio = steps.ohm / expected_ohm;
    if is_thousandfold(ratio.abs()) {
        let unit = if ratio.abs() < 1.0 {
            "mA for A"
        } else {
            "kA for A, or mV for V"
        };
        let met = 1e3 * steps.ohm.abs();
        return Some((
            Check::Unit,
            format!(
                "steps of its current meet {met:.3e} mΩ where {:.2} mΩ are expected: {unit}?",
                1e3 * expected_ohm
            ),
        ));
    }
    let toward = if matches!(subject.run.fixture, Fixture::Cell(_)) {
        "rises under discharge"
    } else {
        "has the sign of the other direction"
    };
    (steps.ohm < REVERSED_PART * low_ohm && steps.correlation < REVERSED_PART).then(|| {
        (
            Check::Sign,
            format!(
                "its voltage {toward}: steps of current meet {:.2} mΩ; the current's sign is wrong",
                1e3 * steps.ohm
            ),
        )
    })
}

fn resistance(at: &Inspection<'_>, run: &Run) -> (f64, f64) {
    match run.fixture {
        Fixture::Cell(_) => at.expected.resistance_ohm,
        Fixture::Shunt(ohm) | Fixture::FakeCell(ohm) => (ohm, ohm),
    }
}

/// Response to the large steps of a record's current.
struct Steps {
    largest_a: f64,
    /// −Σ ΔV·ΔI/Σ ΔI².
    ohm: f64,
    /// Of −ΔV with ΔI.
    correlation: f64,
}

impl Steps {
    /// None for a current that never changes.
    fn of(record: &TimeRecord) -> Option<Self> {
        let step = |all: &[f64]| all.windows(2).map(|w| w[1] - w[0]).collect::<Vec<f64>>();
        let (di, dv) = (
            step(&record.series.current_a),
            step(&record.series.voltage_v),
        );
        let largest_a = di.iter().fold(0.0f64, |most, i| most.max(i.abs()));
        if largest_a == 0.0 {
            return None;
        }
        let large = di
            .iter()
            .zip(&dv)
            .filter(|(i, _)| i.abs() >= LARGE_STEP_PART * largest_a);
        let (ii, iv, vv) = large.fold((0.0, 0.0, 0.0), |(a, b, c), (i, v)| {
            (a + i * i, b - i * v, c + v * v)
        });
        Some(Self {
            largest_a,
            ohm: iv / ii,
            correlation: if vv > 0.0 { iv / (ii * vv).sqrt() } else { 0.0 },
        })
    }
}

fn of_sweep(subject: &Subject<'_>) -> Option<(Check, String)> {
    let (sweep, expected) = subject.sweep()?;
    let ratio = median(
        sweep
            .points
            .iter()
            .zip(expected)
            .map(|(p, e)| p.z_ohm.norm() / e.norm())
            .collect(),
    );
    if is_thousandfold(ratio) {
        return Some((
            Check::Unit,
            format!("its impedance is {ratio:.1e} times what is expected: mΩ for Ω?"),
        ));
    }
    let sum = |f: &dyn Fn(f64, f64) -> f64| {
        sweep
            .points
            .iter()
            .zip(expected)
            .map(|(p, e)| f(p.z_ohm.im, e.im))
            .sum::<f64>()
    };
    let (both, own) = (sum(&|m, e| m * e), sum(&|_, e| e * e));
    let reversed = |share: f64| share < REVERSED_PART;
    if own > 0.0 && reversed(both / own) && reversed(both / (own * sum(&|m, _| m * m)).sqrt()) {
        return Some((
            Check::Sign,
            "its imaginary part has the sign of an inductance where the arcs \
        are: the sign is wrong"
                .to_owned(),
        ));
    }
    let negative = sweep.points.iter().filter(|p| p.z_ohm.re < 0.0).count();
    (2 * negative > sweep.points.len()).then(|| {
        (
            Check::Sign,
            "its real part is negative: leads reversed?".to_owned(),
        )
    })
}
