//! Checks whether a control impedance measures as it is known.

use super::KnownImpedance;
use crate::spectrum::ImpedancePoint;
use analysis_numeric::significant::format_significant;

/// Largest allowed error of a control.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ControlTolerance {
    /// Largest error of the magnitude, relative to the magnitude known.
    pub magnitude_rel: f64,
    /// Largest error of the phase, degrees.
    pub phase_deg: f64,
}

/// Error of a control. The values are NaN if nothing could be compared.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct ControlVerdict {
    /// Largest error of the magnitude, relative, with sign.
    pub worst_magnitude_rel: f64,
    /// Frequency there, Hz.
    pub worst_magnitude_freq_hz: f64,
    /// Largest error of the phase, degrees, with sign.
    pub worst_phase_deg: f64,
    /// Frequency there, Hz.
    pub worst_phase_freq_hz: f64,
    /// Both within the tolerance at every point.
    pub passed: bool,
    /// The verdict as text.
    pub text: String,
}

/// Compares a measured control with its known impedance. A control that has no point, or a point
/// that is not finite, does not pass.
///
/// A correction that was fitted to the same points proves little by passing; use points that were
/// not in the fit, or check before correcting.
pub fn check_control(
    points: &[ImpedancePoint],
    known: &KnownImpedance,
    tolerance: &ControlTolerance,
) -> ControlVerdict {
    if points.is_empty() {
        return failed(
            "the control was not measured: expected at least one point, met none".to_owned(),
            f64::NAN,
        );
    }
    if let Some(point) = points
        .iter()
        .find(|point| !(point.z_ohm.re.is_finite() && point.z_ohm.im.is_finite()))
    {
        return failed(
            format!(
                "the control has no finite impedance at {} Hz: met {} Ω",
                short(point.freq_hz),
                point.z_ohm
            ),
            point.freq_hz,
        );
    }
    let errors = points.iter().map(|point| {
        let ratio = point.z_ohm / known.at(point.freq_hz);
        (point, ratio.norm() - 1.0, ratio.arg().to_degrees())
    });
    let errors: Vec<_> = errors.collect();
    let largest = |of: fn(&(&ImpedancePoint, f64, f64)) -> f64| {
        let worst = errors
            .iter()
            .max_by(|a, b| of(a).abs().total_cmp(&of(b).abs()));
        worst.map_or((f64::NAN, f64::NAN), |error| (of(error), error.0.freq_hz))
    };
    let (magnitude, phase) = (largest(|error| error.1), largest(|error| error.2));
    let good = [
        magnitude.0.abs() <= tolerance.magnitude_rel,
        phase.0.abs() <= tolerance.phase_deg,
    ];
    ControlVerdict {
        worst_magnitude_rel: magnitude.0,
        worst_magnitude_freq_hz: magnitude.1,
        worst_phase_deg: phase.0,
        worst_phase_freq_hz: phase.1,
        passed: good[0] && good[1],
        text: in_words(known, tolerance, [magnitude, phase], good),
    }
}

/// Compares a measured short with its known impedance. Its impedance is nearly zero, so the error
/// counts in ohms, `tolerance_ohm`; the verdict's magnitude is that error over the short's own
/// resistance, and the phase is not checked.
pub fn check_short(
    points: &[ImpedancePoint],
    known: &KnownImpedance,
    tolerance_ohm: f64,
) -> ControlVerdict {
    let errors = points.iter().map(|point| {
        (
            (point.z_ohm - known.at(point.freq_hz)).norm(),
            point.freq_hz,
        )
    });
    // A point that is NaN counts as the worst.
    let worst = errors.max_by(|a, b| a.0.is_nan().cmp(&b.0.is_nan()).then(a.0.total_cmp(&b.0)));
    let Some((error_ohm, freq_hz)) = worst else {
        return failed(
            "the control was not measured: expected at least one point, met none".to_owned(),
            f64::NAN,
        );
    };
    let passed = error_ohm <= tolerance_ohm;
    let (verdict, word) = if passed {
        ("", "within")
    } else {
        (" FAILS", "OUTSIDE")
    };
    let text = format!(
        "short of {} µΩ{verdict}: off by {} µΩ at {} Hz, {word} the tolerance of {} µΩ",
        short(known.r_ohm * 1e6),
        short(error_ohm * 1e6),
        short(freq_hz),
        short(tolerance_ohm * 1e6)
    );
    let worst_magnitude_rel = error_ohm / known.r_ohm;
    ControlVerdict {
        worst_magnitude_rel,
        worst_magnitude_freq_hz: freq_hz,
        passed,
        text,
        ..failed(String::new(), freq_hz)
    }
}

fn failed(text: String, freq_hz: f64) -> ControlVerdict {
    ControlVerdict {
        worst_magnitude_rel: f64::NAN,
        worst_magnitude_freq_hz: freq_hz,
        worst_phase_deg: f64::NAN,
        worst_phase_freq_hz: freq_hz,
        passed: false,
        text,
    }
}

fn in_words(
    known: &KnownImpedance,
    tolerance: &ControlTolerance,
    [magnitude, phase]: [(f64, f64); 2],
    good: [bool; 2],
) -> String {
    let word = |good: bool| if good { "within" } else { "OUTSIDE" };
    let verdict = if good[0] && good[1] { "" } else { " FAILS" };
    format!(
        "control of {:.3} mΩ{verdict}: magnitude off by {:+.2} % at {} Hz, {} the tolerance of {} \
        %; phase off by {:+.2}° at {} Hz, {} the \
         tolerance of {}°",
        known.r_ohm * 1e3,
        magnitude.0 * 100.0,
        short(magnitude.1),
        word(good[0]),
        short(tolerance.magnitude_rel * 100.0),
        phase.0,
        short(phase.1),
        word(good[1]),
        short(tolerance.phase_deg),
    )
}

/// Formats a number for a verdict.
fn short(value: f64) -> String {
    format_significant(value, 4)
}
