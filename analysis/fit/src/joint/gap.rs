//! Gap between a model and a pulse.

use super::apparent::apparent;
use super::fit::JointFit;
use super::noise::NoiseModel;
use super::response::add_step;
use super::window::PulseWindow;
use analysis_model::ocv::OcvCurve;
use analysis_signal::series::TimeSeries;
use serde::{Deserialize, Serialize};

/// The measured pulses and what they are held against.
#[derive(Debug, Clone, Copy)]
pub struct Source<'a> {
    /// The series of the pulses.
    pub series: &'a TimeSeries,
    /// Its noise.
    pub noise: &'a NoiseModel,
    /// The OCV curve.
    pub curve: &'a OcvCurve,
}

/// Measured and predicted resistance a time after the edge.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GapAt {
    /// Time after the edge, s.
    pub time_s: f64,
    /// Measured apparent resistance, Ω.
    pub measured_ohm: f64,
    /// Its standard uncertainty, Ω.
    pub measured_sigma_ohm: f64,
    /// Predicted, Ω: the model's answer and the fall of the OCV.
    pub predicted_ohm: f64,
    /// Its standard uncertainty, Ω: parameters, gain between the instruments and cells, place of
    /// the edge; `None` if a parameter is not determined.
    pub predicted_sigma_ohm: Option<f64>,
    /// Part of the predicted resistance that is the fall of the OCV, Ω.
    pub ocv_ohm: f64,
    /// Predicted less measured voltage, V.
    pub gap_v: f64,
}

impl GapAt {
    /// Predicted less measured, Ω.
    pub fn gap_ohm(&self) -> f64 {
        self.predicted_ohm - self.measured_ohm
    }
}

/// Gap between a model and one pulse.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gap {
    /// Number of the pulse in its series, from 1.
    pub pulse: usize,
    /// OCV at its edge, V.
    pub ocv_v: f64,
    /// SOC at its edge.
    pub soc: f64,
    /// Step of the current, A.
    pub step_a: f64,
    /// At the requested times that have samples.
    pub at: Vec<GapAt>,
    /// Root mean square of predicted less measured voltage over the pulse, V.
    pub rms_v: f64,
    /// The same over the relaxation after it, V.
    pub relaxation_rms_v: f64,
}

/// Holds a model against pulses.
pub fn gaps(
    source: &Source<'_>,
    windows: &[PulseWindow],
    fit: &JointFit,
    times_s: &[f64],
) -> Vec<Gap> {
    windows
        .iter()
        .map(|w| gap(source, w, fit, times_s))
        .collect()
}

/// Time since the edge, s, measured and predicted voltage less that before the edge, V, of each bin
/// of a pulse.
pub fn overlay(window: &PulseWindow, fit: &JointFit) -> Vec<(f64, f64, f64)> {
    let model = window.model(&fit.erm, fit.gain, fit.edge);
    let time =
        |times: &[f64]| times.iter().sum::<f64>() / times.len() as f64 - window.pulse.start_s();
    let before: Vec<usize> = (0..window.bins.len())
        .filter(|k| time(&window.bins[*k].times_s) <= 0.0)
        .collect();
    let mean = |f: &dyn Fn(usize) -> f64| {
        before.iter().map(|k| f(*k)).sum::<f64>() / before.len().max(1) as f64
    };
    // The measured voltage before the edge drifts with the OCV: what is common to both is taken
    // off, so that both begin at zero.
    let offset = mean(&|k| window.bins[k].voltage_v - model[k].0);
    let level = mean(&|k| window.bins[k].voltage_v - window.bins[k].ocv_v);
    window
        .bins
        .iter()
        .zip(&model)
        .map(|(b, m)| (time(&b.times_s), b.voltage_v - level, m.0 + offset - level))
        .collect()
}

fn gap(source: &Source<'_>, window: &PulseWindow, fit: &JointFit, times_s: &[f64]) -> Gap {
    let end = window.pulse.edges_s[1].0 - window.pulse.start_s();
    let points = overlay(window, fit);
    let rms = |keep: &dyn Fn(f64) -> bool| {
        let squares: Vec<f64> = points
            .iter()
            .filter(|p| keep(p.0))
            .map(|p| (p.2 - p.1).powi(2))
            .collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    };
    Gap {
        pulse: window.number,
        ocv_v: window.ocv_v,
        soc: window.soc,
        step_a: window.pulse.step_a(),
        at: times_s
            .iter()
            .filter_map(|t| gap_at(source, window, fit, *t))
            .collect(),
        rms_v: rms(&|t| t > 0.0 && t <= end),
        relaxation_rms_v: rms(&|t| t > end),
    }
}

fn gap_at(source: &Source<'_>, window: &PulseWindow, fit: &JointFit, time_s: f64) -> Option<GapAt> {
    let pulse = &window.pulse;
    let measured = apparent(source.series, pulse, time_s, source.noise)?;
    let width = pulse.edges_s[0].1 - pulse.edges_s[0].0;
    let parameters = fit.erm.parameter_count();
    let mut slopes = vec![0.0; parameters + 2];
    let (value, rate) = add_step(
        &fit.erm,
        (time_s - fit.edge * width).max(0.0),
        fit.gain,
        &mut slopes,
    );
    slopes[parameters] = value;
    slopes[parameters + 1] = -rate * width;
    let drawn = pulse.current_a[1] * time_s / (3600.0 * source.curve.capacity_ah);
    let ocv_ohm = (source.curve.voltage_v(window.soc) - source.curve.voltage_v(window.soc - drawn))
        / pulse.step_a();
    let variance = fit.covariance.as_ref().map(|c| {
        let row = |(i, a): (usize, &f64)| {
            slopes
                .iter()
                .zip(&c[i])
                .map(|(b, c)| a * b * c)
                .sum::<f64>()
        };
        slopes.iter().enumerate().map(row).sum::<f64>()
    });
    let predicted_ohm = value + ocv_ohm;
    Some(GapAt {
        time_s,
        measured_ohm: measured.resistance_ohm,
        measured_sigma_ohm: measured.sigma_ohm,
        predicted_ohm,
        predicted_sigma_ohm: variance.map(|v| v.max(0.0).sqrt()),
        ocv_ohm,
        gap_v: (measured.resistance_ohm - predicted_ohm) * pulse.step_a(),
    })
}
