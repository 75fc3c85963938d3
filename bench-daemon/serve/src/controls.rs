//! Compares the controls of an ended run with their known values, to detect a drift of the bench.

use std::path::Path;

use analysis::{
    calibration::KnownImpedance,
    dataset::read_spectrum_csv,
    run_folder::{self, CONTROLS},
    spectrum::ImpedancePoint,
};
use serde::Deserialize;

/// A control as a run has measured it.
#[derive(Debug, Clone, PartialEq)]
pub struct ControlNow {
    /// Its name.
    pub control: String,
    /// Its resistance as it is certified, Ω.
    pub certified_ohm: f64,
    /// Its resistance as read, Ω: the middle of all points, each divided by what it should be.
    pub as_read_ohm: f64,
    /// Deviation as read.
    pub as_read: Deviation,
    /// The largest deviation after the correction, where the correction was judged by it.
    pub corrected: Option<Deviation>,
}

/// A deviation from the certified value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// Relative, with sign.
    pub ratio: f64,
    /// The same in standard deviations: of the certificate and of the measurement's noise. Gains of
    /// the scope are not in it.
    pub sigmas: f64,
}

#[derive(Deserialize)]
struct Recorded {
    control: String,
    known: KnownImpedance,
    corrected: Option<Worst>,
}

#[derive(Deserialize)]
struct Worst {
    worst_magnitude_rel: Option<f64>,
    worst_magnitude_freq_hz: Option<f64>,
}

/// Reads the controls of a run folder; returns an empty list if it has none.
pub fn read(run: &Path) -> Vec<ControlNow> {
    let recorded: Vec<Recorded> = std::fs::read_to_string(run.join(CONTROLS))
        .ok()
        .and_then(|text| serde_json::from_str(&text).ok())
        .unwrap_or_default();
    recorded
        .iter()
        .filter_map(|recorded| {
            let table = run.join(run_folder::raw(&recorded.control));
            judged(recorded, &read_spectrum_csv(&table).ok()?)
        })
        .collect()
}

fn judged(recorded: &Recorded, points: &[ImpedancePoint]) -> Option<ControlNow> {
    let known = &recorded.known;
    let mut ratios: Vec<f64> = points
        .iter()
        .map(|point| point.z_ohm.norm() / known.at(point.freq_hz).norm())
        .filter(|ratio| ratio.is_finite())
        .collect();
    ratios.sort_by(f64::total_cmp);
    let middle = *ratios.get(ratios.len() / 2)?;
    let noise = points.iter().map(|point| noise_of(point, known));
    let noise = noise.sum::<f64>() / points.len() as f64;
    Some(ControlNow {
        control: recorded.control.clone(),
        certified_ohm: known.r_ohm,
        as_read_ohm: middle * known.r_ohm,
        as_read: deviation(middle - 1.0, noise / (points.len() as f64).sqrt(), known),
        corrected: recorded
            .corrected
            .as_ref()
            .and_then(|worst| worst_of(worst, points, known)),
    })
}

fn worst_of(worst: &Worst, points: &[ImpedancePoint], known: &KnownImpedance) -> Option<Deviation> {
    let freq_hz = worst.worst_magnitude_freq_hz?;
    let distance = |point: &ImpedancePoint| (point.freq_hz - freq_hz).abs();
    let at = points
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    Some(deviation(
        worst.worst_magnitude_rel?,
        noise_of(at, known),
        known,
    ))
}

/// Standard deviation of a point's magnitude by its own noise, relative.
fn noise_of(point: &ImpedancePoint, known: &KnownImpedance) -> f64 {
    point.covariance.re_re.max(0.0).sqrt() / known.r_ohm
}

fn deviation(ratio: f64, noise: f64, known: &KnownImpedance) -> Deviation {
    let sigma = noise.hypot(known.r_sigma_ohm / known.r_ohm);
    Deviation {
        ratio,
        sigmas: ratio / sigma,
    }
}
