//! The fixture check (thesis 3.3.2): are the control impedances what they are known to be, as read and after the correction that they give?
//!
//! Pure: points in, correction and verdicts out.

use std::collections::BTreeMap;

use analysis::{
    calibration::{self, CalibrationError, ControlTolerance, ControlVerdict, Controls, Correction, KnownImpedance, Priors},
    spectrum::{ChannelPhasors, ImpedancePoint, raw_impedance},
};
use instruments::mock::plant::Fixture;

use crate::{
    config::{Bench, Tolerance},
    executor::SweepPoint,
    plan::fixture_name,
};

/// After the correction a control must be right in phase too: this many degrees for each per cent of its tolerance (1 % of a number is 0.57°).
const DEGREES_PER_SHARE: f64 = 180.0 / std::f64::consts::PI;

/// One control's result.
#[derive(Debug, Clone, serde::Serialize)]
pub struct ControlResult {
    /// Its name.
    pub control: &'static str,
    /// What it is known to be.
    pub known: KnownImpedance,
    /// As read.
    pub raw: ControlVerdict,
    /// After the correction; `None` until every control was measured.
    pub corrected: Option<ControlVerdict>,
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
    points.iter().map(|point| raw_impedance(&point.phasors, bench.wiring.shunt.r_ohm)).collect()
}

/// Judges a control as read.
pub fn judge_raw(bench: &Bench, fixture: Fixture, tolerance: &Tolerance, points: &[SweepPoint]) -> ControlResult {
    let known = known(bench, fixture);
    let raw = judge(&raw_points(bench, points), &known, tolerance);
    ControlResult { control: fixture_name(fixture), known, raw, corrected: None }
}

fn judge(points: &[ImpedancePoint], known: &KnownImpedance, tolerance: &Tolerance) -> ControlVerdict {
    match tolerance {
        Tolerance::Relative(tolerance) => calibration::check_control(points, known, tolerance),
        Tolerance::Absolute(error_ohm) => calibration::check_short(points, known, *error_ohm),
    }
}

/// The correction that the controls give, as far as they were measured: points by the name of the fixture.
///
/// # Errors
/// Controls from which it cannot be computed.
pub fn correction(bench: &Bench, sweeps: &BTreeMap<&'static str, Vec<SweepPoint>>) -> Result<Correction, CalibrationError> {
    let of = |fixture: Fixture| sweeps.get(fixture_name(fixture)).map_or_else(Vec::new, |points| phasors(points));
    let (shunt, fake, short) = (of(Fixture::Shunt), of(Fixture::FakeCell), of(Fixture::Short));
    Correction::fit(&Controls {
        current_shunt: bench.wiring.shunt,
        shunt: &shunt,
        fake_cell: bench.fake_cell.filter(|_| !fake.is_empty()).map(|known| (known, fake.as_slice())),
        short: bench.short.filter(|_| !short.is_empty()).map(|known| (known, short.as_slice())),
        open: bench.open,
        priors: Priors::default(),
    })
}

/// Judges a control after the correction, within a share of its impedance; a short, within that share of the current shunt's, for it has none. The shunt
/// with the probes on it shares its place with the correction's own reference, so that only what was in the jig tells something new.
pub fn judge_corrected(bench: &Bench, fixture: Fixture, (correction, share): (&Correction, f64), points: &[SweepPoint]) -> ControlVerdict {
    let corrected: Vec<ImpedancePoint> = points.iter().map(|point| correction.apply(&point.phasors)).collect();
    let tolerance = match fixture {
        Fixture::Short => Tolerance::Absolute(share * bench.wiring.shunt.r_ohm),
        _ => Tolerance::Relative(ControlTolerance { magnitude_rel: share, phase_deg: share * DEGREES_PER_SHARE }),
    };
    judge(&corrected, &known(bench, fixture), &tolerance)
}

fn phasors(points: &[SweepPoint]) -> Vec<ChannelPhasors> {
    points.iter().map(|point| point.phasors).collect()
}
