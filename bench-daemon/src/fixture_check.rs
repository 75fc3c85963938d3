//! The fixture check (thesis 3.3.2): are the control impedances what they are known to be, as read and after the correction that they give?
//!
//! Pure: points in, correction and verdicts out.

use analysis::{
    calibration::{self, CalibrationError, ControlTolerance, ControlVerdict, Controls, Correction, KnownImpedance, Priors},
    spectrum::{ChannelPhasors, ImpedancePoint, raw_impedance},
};
use instruments::mock::plant::Fixture;

use crate::{config::Bench, executor::SweepPoint, plan::fixture_name};

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
    match (fixture, bench.fake_cell) {
        (Fixture::FakeCell, Some(fake_cell)) => fake_cell,
        _ => bench.wiring.shunt,
    }
}

/// Impedances as read, without any correction.
pub fn raw_points(bench: &Bench, points: &[SweepPoint]) -> Vec<ImpedancePoint> {
    points.iter().map(|point| raw_impedance(&point.phasors, bench.wiring.shunt.r_ohm)).collect()
}

/// Judges a control as read.
pub fn judge_raw(bench: &Bench, fixture: Fixture, tolerance: &ControlTolerance, points: &[SweepPoint]) -> ControlResult {
    let known = known(bench, fixture);
    let raw = calibration::check_control(&raw_points(bench, points), &known, tolerance);
    ControlResult { control: fixture_name(fixture), known, raw, corrected: None }
}

/// The correction that the controls give.
///
/// # Errors
/// Controls from which it cannot be computed.
pub fn correction(bench: &Bench, shunt: &[SweepPoint], fake_cell: &[SweepPoint]) -> Result<Correction, CalibrationError> {
    let shunt = phasors(shunt);
    let fake = phasors(fake_cell);
    let fake_cell = bench.fake_cell.filter(|_| !fake.is_empty()).map(|known| (known, fake.as_slice()));
    Correction::fit(&Controls { current_shunt: bench.wiring.shunt, shunt: &shunt, fake_cell, priors: Priors::default() })
}

/// Judges a control after the correction. The shunt with the probes on it shares its place with the correction's own reference, so that only the
/// fake cell tells something new.
pub fn judge_corrected(correction: &Correction, known: &KnownImpedance, tolerance: f64, points: &[SweepPoint]) -> ControlVerdict {
    let corrected: Vec<ImpedancePoint> = points.iter().map(|point| correction.apply(&point.phasors)).collect();
    let tolerance = ControlTolerance { magnitude_rel: tolerance, phase_deg: tolerance * DEGREES_PER_SHARE };
    calibration::check_control(&corrected, known, &tolerance)
}

fn phasors(points: &[SweepPoint]) -> Vec<ChannelPhasors> {
    points.iter().map(|point| point.phasors).collect()
}
