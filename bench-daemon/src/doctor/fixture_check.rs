//! Fixture check (thesis 3.3.2): compares the control impedances with their known values, as read
//! and after the correction that they give.
//!
//! Pure: points in, correction and verdicts out.

use std::collections::BTreeMap;

use analysis::{
    calibration::{
        self, CalibrationError, ControlTolerance, ControlVerdict, Controls, Correction,
        KnownImpedance, Priors,
    },
    spectrum::{ChannelPhasors, ImpedancePoint, raw_impedance},
};
use instruments::fixture::Fixture;

use crate::{
    config::{Bench, Experiment, Tolerance},
    measure::SweepPoint,
    plan::fixture_name,
    support::present::significant,
};

/// After the correction a control must be right in phase too: this many degrees for each per cent
/// of its tolerance (1 % of a number is 0.57°).
const DEGREES_PER_SHARE: f64 = 180.0 / std::f64::consts::PI;

/// One control's result.
#[derive(Debug, Clone, serde::Serialize)]
pub struct ControlResult {
    /// Its name.
    pub control: &'static str,
    /// Known impedance.
    pub known: KnownImpedance,
    /// As read.
    pub raw: ControlVerdict,
    /// After the correction; `None` until every control was measured.
    pub corrected: Option<ControlVerdict>,
    /// How far the bench goes as read.
    pub believed_as_read: Option<ValidBand>,
    /// How far it goes with the correction.
    pub believed: Option<ValidBand>,
}

/// Up to which frequency a control is right.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct ValidBand {
    /// Up to here every point is right, Hz; none where the slowest is wrong.
    pub believed_to_hz: Option<f64>,
    /// Here is the first that is wrong, Hz; none where all are right: then the control was not
    /// measured far enough to find the end.
    pub wrong_at_hz: Option<f64>,
    /// Right means within this share of the known impedance, of a short within this share of the
    /// current shunt's.
    pub tolerance: f64,
}

/// The control's known impedance.
pub fn known(bench: &Bench, fixture: Fixture) -> KnownImpedance {
    let other = match fixture {
        Fixture::FakeCell => bench.fake_cell,
        Fixture::Short => bench.short,
        Fixture::Shunt | Fixture::Cell => None,
    };
    other.unwrap_or(bench.wiring.shunt)
}

/// Impedances as read, without any correction.
pub fn raw_points(bench: &Bench, points: &[SweepPoint]) -> Vec<ImpedancePoint> {
    points
        .iter()
        .map(|point| raw_impedance(&point.phasors, bench.wiring.shunt.r_ohm))
        .collect()
}

/// Judges a control as read.
pub fn judge_raw(
    bench: &Bench,
    fixture: Fixture,
    tolerance: &Tolerance,
    points: &[SweepPoint],
) -> ControlResult {
    let known = known(bench, fixture);
    let raw = judge(&raw_points(bench, points), &known, tolerance);
    ControlResult {
        control: fixture_name(fixture),
        known,
        raw,
        corrected: None,
        believed_as_read: None,
        believed: None,
    }
}

/// The points of a control within the band of the sweep: only they are judged.
pub fn swept<'p>(experiment: &Experiment, points: &'p [SweepPoint]) -> &'p [SweepPoint] {
    let last_hz = experiment
        .eis
        .as_ref()
        .and_then(|eis| eis.freqs_hz.last().copied())
        .unwrap_or(f64::INFINITY);
    &points[..points.partition_point(|point| point.phasors.freq_hz <= last_hz)]
}

/// How far the bench goes as read, by one control: the tolerance is that of the corrected reading.
pub fn believed_as_read(
    experiment: &Experiment,
    fixture: Fixture,
    points: &[SweepPoint],
) -> ValidBand {
    let share = experiment
        .fixture_check
        .as_ref()
        .map_or(0.0, |check| check.corrected_tolerance);
    reach(
        &raw_points(&experiment.bench, points),
        experiment,
        fixture,
        share,
    )
}

/// How far the bench goes with the correction, by one control.
pub fn believed(
    experiment: &Experiment,
    fixture: Fixture,
    correction: &Correction,
    share: f64,
    points: &[SweepPoint],
) -> ValidBand {
    let corrected: Vec<ImpedancePoint> = points
        .iter()
        .map(|point| correction.apply(&point.phasors))
        .collect();
    reach(&corrected, experiment, fixture, share)
}

/// Points by rising frequency. A point counts as right while the error of its impedance, magnitude
/// and phase together, is within the share.
fn reach(
    points: &[ImpedancePoint],
    experiment: &Experiment,
    fixture: Fixture,
    share: f64,
) -> ValidBand {
    let known = known(&experiment.bench, fixture);
    let scale = |freq_hz: f64| {
        if fixture == Fixture::Short {
            experiment.bench.wiring.shunt.r_ohm
        } else {
            known.at(freq_hz).norm()
        }
    };
    let right = |point: &&ImpedancePoint| {
        (point.z_ohm - known.at(point.freq_hz)).norm() <= share * scale(point.freq_hz)
    };
    let good = points.iter().take_while(right).count();
    ValidBand {
        believed_to_hz: good.checked_sub(1).map(|last| points[last].freq_hz),
        wrong_at_hz: points.get(good).map(|point| point.freq_hz),
        tolerance: share,
    }
}

/// How far the bench is to be believed, by all controls that were not the correction's own
/// reference: a sentence; none without such a control.
pub fn believed_in_words(controls: &[ControlResult]) -> Option<String> {
    let limit = |of: fn(&ControlResult) -> Option<ValidBand>| {
        let to_hz = |believed: &ValidBand| believed.believed_to_hz.unwrap_or(0.0);
        controls
            .iter()
            .filter_map(of)
            .min_by(|a, b| to_hz(a).total_cmp(&to_hz(b)))
    };
    let words = |believed: ValidBand| match (believed.believed_to_hz, believed.wrong_at_hz) {
        (Some(to_hz), Some(at_hz)) => format!(
            "up to {} Hz (wrong at {} Hz)",
            significant(to_hz, 4),
            significant(at_hz, 4)
        ),
        (Some(to_hz), None) => format!("up to {} Hz at least", significant(to_hz, 4)),
        (None, _) => "at no frequency".to_owned(),
    };
    let corrected = limit(|control| control.believed)?;
    let as_read = limit(|control| {
        control
            .believed_as_read
            .filter(|_| control.believed.is_some())
    })
    .map(words)
    .unwrap_or_default();
    let percent = significant(100.0 * corrected.tolerance, 2);
    Some(format!(
        "With its correction the bench is to be believed within {percent} % {}; as read, without \
        it, {as_read}.",
        words(corrected)
    ))
}

fn judge(
    points: &[ImpedancePoint],
    known: &KnownImpedance,
    tolerance: &Tolerance,
) -> ControlVerdict {
    match tolerance {
        Tolerance::Relative(tolerance) => calibration::check_control(points, known, tolerance),
        Tolerance::Absolute(error_ohm) => calibration::check_short(points, known, *error_ohm),
    }
}

/// The points that the quality gate has let through.
pub fn let_through(points: &[SweepPoint]) -> impl Iterator<Item = &SweepPoint> {
    points.iter().filter(|point| point.failing.is_empty())
}

/// The first control of which the quality gate has left nothing: without it the correction would be
/// another one than was asked for.
pub fn refused_whole(sweeps: &BTreeMap<&'static str, Vec<SweepPoint>>) -> Option<&'static str> {
    let controls = [Fixture::Shunt, Fixture::FakeCell, Fixture::Short].map(fixture_name);
    let whole = |name: &&'static str| {
        sweeps
            .get(name)
            .is_some_and(|points| !points.is_empty() && let_through(points).next().is_none())
    };
    controls.into_iter().find(whole)
}

/// The correction that the controls give, as far as they were measured: points by the name of the
/// fixture. What the quality gate has refused is left out: a few parameters describe the harness at
/// all frequencies.
///
/// # Errors
/// Controls from which it cannot be computed.
pub fn correction(
    bench: &Bench,
    sweeps: &BTreeMap<&'static str, Vec<SweepPoint>>,
) -> Result<Correction, CalibrationError> {
    let of = |fixture: Fixture| {
        sweeps
            .get(fixture_name(fixture))
            .map_or_else(Vec::new, |points| phasors(points))
    };
    let (shunt, fake, short) = (
        of(Fixture::Shunt),
        of(Fixture::FakeCell),
        of(Fixture::Short),
    );
    Correction::fit(&Controls {
        current_shunt: bench.wiring.shunt,
        shunt: &shunt,
        fake_cell: bench
            .fake_cell
            .filter(|_| !fake.is_empty())
            .map(|known| (known, fake.as_slice())),
        short: bench
            .short
            .filter(|_| !short.is_empty())
            .map(|known| (known, short.as_slice())),
        open: bench.open,
        priors: Priors::default(),
    })
}

/// Judges a control after the correction, within a share of its impedance; a short, within that
/// share of the current shunt's, for it has none. The shunt with the probes on it shares its place
/// with the correction's own reference, so that only what was in the jig tells something new.
pub fn judge_corrected(
    bench: &Bench,
    fixture: Fixture,
    correction: &Correction,
    share: f64,
    points: &[SweepPoint],
) -> ControlVerdict {
    let corrected: Vec<ImpedancePoint> = points
        .iter()
        .map(|point| correction.apply(&point.phasors))
        .collect();
    let tolerance = match fixture {
        Fixture::Short => Tolerance::Absolute(share * bench.wiring.shunt.r_ohm),
        _ => Tolerance::Relative(ControlTolerance {
            magnitude_rel: share,
            phase_deg: share * DEGREES_PER_SHARE,
        }),
    };
    judge(&corrected, &known(bench, fixture), &tolerance)
}

fn phasors(points: &[SweepPoint]) -> Vec<ChannelPhasors> {
    let_through(points).map(|point| point.phasors).collect()
}
