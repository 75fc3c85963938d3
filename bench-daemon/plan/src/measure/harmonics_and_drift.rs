//! Content of a record beside its sinusoid: harmonics, and a nonlinear drift. It is a separate
//! fit, so that the phasors of the sinusoid do not change.

use analysis_numeric::Covariance2;
use analysis_signal::{
    sine::{self, Drift, FitOptions, Record, SineFit, ToneKind},
    spectrum::{ChannelPhasors, PhasorVariance},
};

/// Harmonics that are fitted: the first ones of an asymmetric and of a symmetric nonlinearity.
const ORDERS: [u32; 2] = [2, 3];

/// Content of a record beside its sinusoid.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct HarmonicsAndDrift {
    /// Orders and phasors of the harmonics that the record can resolve.
    pub harmonics: Vec<(u32, ChannelPhasors)>,
    /// The nonlinear part of the drift; `None` if the record is too short for it.
    pub bend: Option<Bend>,
    /// Whether the fit of the sinusoid included relaxations, which remove such a drift.
    #[serde(default)]
    pub relaxed: bool,
}

/// Curvature of the offset of the voltage across the jig.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Bend {
    /// Change from the middle of the record to its ends, V.
    pub volts: f64,
    /// Its standard deviation, V.
    pub sigma_v: f64,
    /// Periods in the record.
    pub periods: f64,
}

/// Standard deviations above which a bend does not count as noise.
const CERTAIN: f64 = 5.0;

impl Bend {
    /// Returns true if the bend is not noise.
    pub fn is_certain(&self) -> bool {
        self.volts.abs() > CERTAIN * self.sigma_v
    }
}

/// Fits harmonics and a parabola beside the sinusoid; returns nothing if the record is not
/// sufficient.
pub fn fit_harmonics_and_drift(record: &Record<'_>, freq_hz: f64) -> HarmonicsAndDrift {
    let options = FitOptions {
        drift: Drift::Quadratic,
        harmonics: ORDERS.to_vec(),
        ..FitOptions::default()
    };
    // Another fit determines whether the sinusoid itself can be fitted.
    sine::fit_known_frequency(record, freq_hz, &options).map_or_else(
        |_| HarmonicsAndDrift::default(),
        |fit| HarmonicsAndDrift {
            harmonics: harmonics(&fit),
            bend: bend(&fit),
            relaxed: false,
        },
    )
}

fn harmonics(fit: &SineFit) -> Vec<(u32, ChannelPhasors)> {
    let of = |tone: &sine::Tone| {
        let ToneKind::Harmonic(order) = tone.kind else {
            return None;
        };
        let channels = <&[sine::Phasor; 4]>::try_from(tone.channels.as_slice()).ok()?;
        let noise = |p: &sine::Phasor| PhasorVariance {
            noise: p.variance,
            quantisation: Covariance2::ZERO,
            drift: Covariance2::ZERO,
        };
        let variance = channels.each_ref().map(noise);
        Some((
            order,
            ChannelPhasors {
                freq_hz: tone.freq_hz,
                volts: channels.map(|p| p.phasor),
                variance,
            },
        ))
    };
    fit.tones.iter().filter_map(of).collect()
}

/// Returns the bend of the offset. Over u = −1…1, the part of u² that is neither offset nor
/// straight line has a mean square of 4/45.
fn bend(fit: &SineFit) -> Option<Bend> {
    let [_, _, low, high] = fit.channels.as_slice() else {
        return None;
    };
    let half_s = 0.5 * fit.interval_s * fit.samples as f64;
    let curvature = high.curvature_v_per_s2 - low.curvature_v_per_s2;
    let variance = |c: &sine::ChannelFit| {
        c.colour_factor * c.residual_rms_v.powi(2) * 45.0 / (4.0 * c.samples_used as f64)
    };
    // A fit without a parabola returns zero.
    (curvature != 0.0).then(|| Bend {
        volts: curvature * half_s * half_s,
        sigma_v: (variance(low) + variance(high)).sqrt(),
        periods: fit.periods(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_signal::sine::Channel;
    use std::f64::consts::TAU;

    #[test]
    fn harmonics_and_a_bend_are_what_was_put_in() {
        let (n, interval_s, freq_hz) = (2000, 2.0e-3, 1.25);
        // Five periods; the voltage has 3 % of third harmonic, and its offset rises by 20 mV and
        // back to the ends of the record.
        let samples = |amplitude_v: f64, third: f64, bend_v: f64| -> Vec<f64> {
            let at = |k: i32| {
                let (turn, u) = (
                    TAU * freq_hz * interval_s * f64::from(k),
                    (f64::from(k) - 999.5) / 1000.0,
                );
                amplitude_v * (turn.cos() + third * (3.0 * turn).sin()) + bend_v * u * u + 0.01 * u
            };
            (0..n).map(at).collect()
        };
        let volts = [
            samples(0.1, 0.0, 0.0),
            samples(0.2, 0.0, 0.0),
            samples(0.3, 0.0, 0.005),
            samples(0.5, 0.03, -0.015),
        ];
        let channels = volts.each_ref().map(|v| Channel::volts(v));
        let found = fit_harmonics_and_drift(
            &Record {
                channels: &channels,
                interval_s,
            },
            freq_hz,
        );
        assert_eq!(
            found.harmonics.iter().map(|h| h.0).collect::<Vec<_>>(),
            [2, 3]
        );
        for ((_, phasors), expected) in found.harmonics.iter().zip([0.0, 0.015]) {
            assert!(
                (phasors.volts[3].norm() - expected).abs() < 1.0e-6,
                "{}",
                phasors.volts[3]
            );
            assert!(phasors.volts[..3].iter().all(|v| v.norm() < 1.0e-6));
        }
        let bend = found.bend.unwrap();
        assert!(
            (bend.volts + 0.020).abs() < 1.0e-6 && (bend.periods - 5.0).abs() < 1.0e-9,
            "{bend:?}"
        );
    }
}
