//! Fixture check (thesis 3.3.2): compares the control impedances with their known values, as read
//! and after the correction that follows from them.
//!
//! The functions are pure: they take points and return correction and verdicts.

use std::collections::BTreeMap;

use analysis::{
    calibration::{
        self, CalibrationError, ControlTolerance, ControlVerdict, Controls, Correction,
        KnownImpedance, Priors,
    },
    spectrum::{ChannelPhasors, ImpedancePoint, raw_impedance},
};
use instruments::{fixture::Fixture, units::Hertz};

use crate::support::present::significant;
use bench_plan::{
    config::{Bench, Experiment, Tolerance},
    measure::SweepPoint,
    plan::fixture_name,
};

/// Allowed phase error after the correction, in degrees per unit of its tolerance (1 % of a number
/// is 0.57°).
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
    /// Valid frequency range of the bench as read.
    pub believed_as_read: Option<ValidBand>,
    /// Valid frequency range with the correction.
    pub believed: Option<ValidBand>,
}

/// Frequency up to which a control is correct.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct ValidBand {
    /// Every point up to this frequency is correct, Hz; `None` if the lowest frequency is wrong.
    pub believed_to_hz: Option<f64>,
    /// Frequency of the first wrong point, Hz; `None` if all are correct: then the control was not
    /// measured far enough to find the limit.
    pub wrong_at_hz: Option<f64>,
    /// Greatest error of a correct point, as a share of the known impedance; for a short, of the
    /// current shunt's impedance.
    pub tolerance: f64,
}

/// Returns the control's known impedance.
pub fn known(bench: &Bench, fixture: Fixture) -> KnownImpedance {
    let other = match fixture {
        Fixture::FakeCell => bench.fake_cell,
        Fixture::Short => bench.short,
        Fixture::Shunt | Fixture::Cell => None,
    };
    other.unwrap_or(bench.wiring.shunt)
}

/// Returns impedances as read, without any correction.
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

/// Returns the points of a control within the band of the sweep: only they are judged.
pub fn swept<'p>(experiment: &Experiment, points: &'p [SweepPoint]) -> &'p [SweepPoint] {
    let last_hz = experiment
        .eis
        .as_ref()
        .and_then(|eis| eis.freqs_hz.last().copied())
        .unwrap_or(Hertz::INFINITY);
    &points[..points.partition_point(|point| point.phasors.freq_hz <= last_hz.0)]
}

/// Returns the valid frequency range of the bench as read, from one control: the tolerance is that
/// of the corrected reading.
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

/// Returns the valid frequency range of the bench with the correction, from one control.
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

/// Returns the valid range for points sorted by rising frequency. A point counts as correct while
/// the error of its impedance, magnitude and phase together, is within the share.
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

/// Describes the valid frequency range of the bench, from all controls except the reference of the
/// correction, as a sentence; returns `None` without such a control.
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
        "With its correction the bench is accurate within {percent} % {}; as read, without it, \
        {as_read}.",
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

/// Returns the points that the quality gate has accepted.
pub fn let_through(points: &[SweepPoint]) -> impl Iterator<Item = &SweepPoint> {
    points.iter().filter(|point| point.failing.is_empty())
}

/// Returns the first control of which the quality gate has accepted no point: without it the
/// correction would differ from the requested one.
pub fn refused_whole(sweeps: &BTreeMap<&'static str, Vec<SweepPoint>>) -> Option<&'static str> {
    let controls = [Fixture::Shunt, Fixture::FakeCell, Fixture::Short].map(fixture_name);
    let whole = |name: &&'static str| {
        sweeps
            .get(name)
            .is_some_and(|points| !points.is_empty() && let_through(points).next().is_none())
    };
    controls.into_iter().find(whole)
}

/// Computes the correction from the controls, as far as they were measured: points by the name of
/// the fixture. Points that the quality gate has refused are omitted: a few parameters describe
/// the harness at all frequencies.
///
/// # Errors
/// Fails if the correction cannot be computed from the controls.
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

/// Judges a control after the correction, within a share of its impedance. For a short, which has
/// none, it is a share of the current shunt's impedance. The shunt with the probes on it has the
/// same position as the reference of the correction, so only the contents of the jig provide new
/// information.
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
