//! Quality gate: compares the quality of one point of a sweep with limits, and describes the
//! excesses. The functions are pure.
//!
//! A value fails only if noise does not explain it, so that a strict limit on a noisy bench
//! reports the noise and nothing else.

use analysis_fit::validity::{Drift, DriftShape};
use analysis_signal::{
    sine::{self, Channel, FitOptions, Record, SineFit, Stored, Tone, ToneKind},
    spectrum::{ChannelPhasors, ImpedancePoint, PhasorVariance, raw_impedance},
};
use num_complex::Complex64;

use instruments::units::{Coulombs, Seconds};

use crate::measure::HarmonicsAndDrift;

/// Standard deviations above which a value does not count as noise.
const CERTAIN: f64 = 5.0;

/// Harmonics that are evaluated: with fewer, a clipped crest would count as noise.
const ORDERS: std::ops::RangeInclusive<u32> = 2..=7;

/// Limits of the gate, as shares of |Z| or of the amplitude.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Quality {
    /// Standard deviation of Z due to noise and rounding.
    pub noise: f64,
    /// Harmonics of current and voltage relative to their fundamentals.
    pub distortion: f64,
    /// Greatest share of the voltage's drift in Z.
    pub drift: f64,
    /// Difference of Z between the two halves of the record.
    pub repeatability: f64,
    /// Residual of the Kramers–Kronig test.
    pub kramers_kronig: f64,
    /// Greatest number of repetitions of a point.
    pub again: usize,
    /// Time for repetitions in one sweep, s.
    pub time_s: Seconds,
    /// Charge for repetitions in one sweep, C, moved back and forth.
    #[serde(rename = "charge_c")]
    pub charge_coulomb: Coulombs,
}

/// Quality of a record.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Measures {
    /// Greatest share of clipped samples of a channel.
    pub clipped: f64,
    /// Standard deviation of Z due to noise and rounding, relative to |Z|.
    pub noise: f64,
    /// The larger of the distortions of current and voltage, and the part that noise explains.
    pub distortion: (f64, f64),
    /// Possible error of Z due to the drift of the voltage, relative to |Z|.
    pub drift: f64,
    /// Difference of Z between the halves of the record, relative to |Z|, and the part that noise
    /// explains; `None` if a half is too short.
    pub repeatability: Option<(f64, f64)>,
}

/// Quantity that is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Criterion {
    /// Clipped samples.
    Clipped,
    /// Noise and rounding.
    Noise,
    /// Harmonics.
    Distortion,
    /// Drift of the voltage.
    Drift,
    /// The halves of the record.
    Repeatability,
    /// The point in its sweep.
    KramersKronig,
    /// The sign of the real part.
    Passivity,
    /// Neighbouring points that the sweep rejects.
    Neighbours,
}

impl std::fmt::Display for Criterion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Clipped => "clipped samples",
            Self::Noise => "noise",
            Self::Distortion => "distortion",
            Self::Drift => "drift",
            Self::Repeatability => "difference of the halves",
            Self::KramersKronig => "Kramers–Kronig residual",
            Self::Passivity => "negative real part of Z",
            Self::Neighbours => "refused neighbours",
        })
    }
}

/// A value that exceeds its limit.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Failing {
    /// Quantity that fails.
    pub criterion: Criterion,
    /// The value, as a share.
    pub value: f64,
    /// Its limit.
    pub limit: f64,
}

impl std::fmt::Display for Failing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Two significant digits for any magnitude.
        let percent = |share: f64| {
            let value = 100.0 * share;
            if !value.is_finite() {
                return "no number".to_owned();
            }
            let digits = if value > 0.0 {
                (1.0 - value.log10().floor()).clamp(0.0, 6.0) as usize
            } else {
                0
            };
            format!("{value:.digits$} %")
        };
        if self.criterion == Criterion::Neighbours {
            return write!(
                f,
                "{}: expected more points in a row than the {} refused beside them, found {}",
                self.criterion, self.limit, self.value
            );
        }
        write!(
            f,
            "{}: expected at most {}, found {}",
            self.criterion,
            percent(self.limit),
            percent(self.value)
        )
    }
}

/// Greatest change of the impedance over a record that the fit may explain. A larger one remains a
/// difference of the halves: it need not be a straight line.
const MOST_CHANGE: f64 = 0.05;

impl Measures {
    /// Returns the same without the difference of the halves that a fitted change of the impedance over
    /// the record, relative to it, explains: half of it, because the middles of the halves lie half a
    /// record apart.
    #[must_use]
    pub fn less_change(self, change: Option<Complex64>) -> Self {
        let explained = change.map_or(0.0, Complex64::norm);
        if explained > MOST_CHANGE {
            return self;
        }
        let less = |(value, sigma): (f64, f64)| ((value - 0.5 * explained).abs(), sigma);
        Self {
            repeatability: self.repeatability.map(less),
            ..self
        }
    }
}

impl Quality {
    /// Returns the limits that a record exceeds.
    pub fn judge(&self, measures: &Measures) -> Vec<Failing> {
        let beyond = |(value, sigma): (f64, f64), limit: f64| value > limit.max(CERTAIN * sigma);
        let mut failing = Vec::new();
        let mut check = |criterion, value: (f64, f64), limit| {
            // A value that is not a number is not known to be good.
            if beyond(value, limit) || value.0.is_nan() {
                failing.push(Failing {
                    criterion,
                    value: value.0,
                    limit,
                });
            }
        };
        check(Criterion::Clipped, (measures.clipped, 0.0), 0.0);
        check(Criterion::Noise, (measures.noise, 0.0), self.noise);
        check(Criterion::Distortion, measures.distortion, self.distortion);
        check(Criterion::Drift, (measures.drift, 0.0), self.drift);
        if let Some(halves) = measures.repeatability {
            check(Criterion::Repeatability, halves, self.repeatability);
        }
        failing
    }

    /// Returns the residual of a point in the finished sweep if it is too large.
    pub fn judge_residual(&self, share: f64) -> Option<Failing> {
        (share > self.kramers_kronig).then_some(Failing {
            criterion: Criterion::KramersKronig,
            value: share,
            limit: self.kramers_kronig,
        })
    }
}

impl Failing {
    /// Checks whether the criterion belongs to the finished sweep instead of the record.
    pub fn is_of_sweep(&self) -> bool {
        matches!(
            self.criterion,
            Criterion::KramersKronig | Criterion::Passivity | Criterion::Neighbours
        )
    }
}

/// Returns how far the worst value exceeds its limit; 0 for a good point.
pub fn severity(failing: &[Failing]) -> f64 {
    let of = |one: &Failing| match (one.value, one.limit) {
        (value, _) if value.is_nan() => f64::INFINITY,
        (value, limit) if limit > 0.0 => value / limit,
        // Any clipped sample is worse than any value that is only too large.
        (value, _) => 1.0e3 * (1.0 + value),
    };
    failing.iter().map(of).fold(0.0, f64::max)
}

/// Computes the quality of a record of four channels from its fits. `clipped` is the greatest
/// share of clipped samples.
pub fn measure(
    record: &Record<'_>,
    phasors: &ChannelPhasors,
    harmonics_and_drift: &HarmonicsAndDrift,
    clipped: f64,
) -> Measures {
    let magnitude = |variance: fn(&PhasorVariance) -> analysis_numeric::Covariance2| {
        let only = phasors.variance.map(|all| PhasorVariance {
            noise: variance(&all),
            ..PhasorVariance::circular(0.0)
        });
        let point = raw_impedance(
            &ChannelPhasors {
                variance: only,
                ..*phasors
            },
            1.0,
        );
        point.magnitude_sigma_ohm().max(across(&point)) / point.magnitude_ohm()
    };
    let amplitude_v = (phasors.volts[3] - phasors.volts[2]).norm();
    let bend = harmonics_and_drift
        .bend
        .filter(|bend| bend.is_certain() && !harmonics_and_drift.relaxed)
        .map_or(0.0, |bend| {
            let drift = Drift {
                over_amplitude: bend.volts / amplitude_v,
                periods: bend.periods,
                shape: DriftShape::Bend,
            };
            0.01 * drift.error_percent()
        });
    Measures {
        clipped,
        noise: magnitude(|variance| variance.noise + variance.quantisation),
        distortion: distortion(record, phasors.freq_hz),
        drift: magnitude(|variance| variance.drift).max(bend),
        repeatability: halves(record, phasors.freq_hz),
    }
}

/// Returns the standard deviation perpendicular to the impedance, Ω: an error of the phase counts
/// as much as one of the magnitude.
fn across(point: &ImpedancePoint) -> f64 {
    point.phase_sigma_rad() * point.magnitude_ohm()
}

/// Returns the root of the summed squares of the harmonics relative to the fundamental: for the
/// current, and for the part of the voltage that the current's harmonics do not explain (with the
/// impedance of the fundamental, because a single record shows no other). Returns the larger of
/// the two, with the part that noise explains.
fn distortion(record: &Record<'_>, freq_hz: f64) -> (f64, f64) {
    let options = FitOptions {
        harmonics: ORDERS.collect(),
        ..FitOptions::default()
    };
    let Ok(fit) = sine::fit_known_frequency(record, freq_hz, &options) else {
        return (f64::NAN, 0.0);
    };
    let Ok(phasors) = ChannelPhasors::from_fit(&fit) else {
        return (f64::NAN, 0.0);
    };
    let pairs = |of: &ChannelPhasors| (of.volts[1] - of.volts[0], of.volts[3] - of.volts[2]);
    let (current, voltage) = pairs(&phasors);
    let ratio = voltage / current;
    let mut sums = [(0.0, 0.0); 2];
    for harmonic in harmonics(&fit) {
        let (i, v) = pairs(&harmonic);
        let noise = harmonic.totals().map(|total| total.re_re + total.im_im);
        let add = |sum: &mut (f64, f64), value: Complex64, variance: f64| {
            *sum = (sum.0 + value.norm_sqr(), sum.1 + variance);
        };
        add(
            &mut sums[0],
            i / current.norm(),
            (noise[0] + noise[1]) / current.norm_sqr(),
        );
        add(
            &mut sums[1],
            (v - ratio * i) / voltage.norm(),
            (noise[2] + noise[3]) / voltage.norm_sqr() + (noise[0] + noise[1]) / current.norm_sqr(),
        );
    }
    let [current, voltage] = sums.map(|(square, variance)| (square.sqrt(), variance.sqrt()));
    if voltage.0 > current.0 {
        voltage
    } else {
        current
    }
}

fn harmonics(fit: &SineFit) -> Vec<ChannelPhasors> {
    let of = |tone: &Tone| {
        let channels = <&[sine::Phasor; 4]>::try_from(tone.channels.as_slice()).ok()?;
        let variance = channels.each_ref().map(|p| PhasorVariance {
            noise: p.variance,
            ..PhasorVariance::circular(0.0)
        });
        Some(ChannelPhasors {
            freq_hz: tone.freq_hz,
            volts: channels.map(|p| p.phasor),
            variance,
        })
    };
    fit.tones
        .iter()
        .filter(|tone| matches!(tone.kind, ToneKind::Harmonic(_)))
        .filter_map(of)
        .collect()
}

fn halves(record: &Record<'_>, freq_hz: f64) -> Option<(f64, f64)> {
    let count = record.channels.first()?.len();
    let half = |first: bool| {
        let channels: Vec<Channel<'_>> = record
            .channels
            .iter()
            .map(|channel| {
                part(
                    channel,
                    if first {
                        0..count / 2
                    } else {
                        count - count / 2..count
                    },
                )
            })
            .collect();
        let fit = sine::fit_known_frequency(
            &Record {
                channels: &channels,
                interval_s: record.interval_s,
            },
            freq_hz,
            &FitOptions::default(),
        )
        .ok()?;
        Some(raw_impedance(&ChannelPhasors::from_fit(&fit).ok()?, 1.0))
    };
    let (first, second) = (half(true)?, half(false)?);
    let scale = 0.5 * (first.z_ohm.norm() + second.z_ohm.norm());
    let both = first.covariance + second.covariance;
    Some((
        (first.z_ohm - second.z_ohm).norm() / scale,
        (both.re_re + both.im_im).sqrt() / scale,
    ))
}

fn part<'a>(channel: &Channel<'a>, range: std::ops::Range<usize>) -> Channel<'a> {
    match *channel {
        Channel::Volts {
            samples,
            lsb_v,
            range_v,
        } => Channel::Volts {
            samples: &samples[range],
            lsb_v,
            range_v,
        },
        Channel::Codes { codes, scale } => Channel::Codes {
            codes: &codes[range],
            scale,
        },
        Channel::Stored(stored) => Channel::Stored(Stored {
            start: stored.start + range.start,
            count: range.len(),
            ..stored
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Quality = Quality {
        noise: 0.005,
        distortion: 0.01,
        drift: 0.005,
        repeatability: 0.01,
        kramers_kronig: 0.01,
        again: 2,
        time_s: Seconds(600.0),
        charge_coulomb: Coulombs(600.0),
    };

    #[test]
    fn each_number_fires_by_itself_and_noise_excuses_what_it_explains() {
        let good = Measures {
            clipped: 0.0,
            noise: 0.001,
            distortion: (0.002, 0.0001),
            drift: 0.001,
            repeatability: Some((0.001, 0.0005)),
        };
        assert_eq!(LIMITS.judge(&good), []);
        assert_eq!(
            LIMITS.judge(&Measures {
                distortion: (0.02, 0.005),
                repeatability: Some((0.02, 0.01)),
                ..good
            }),
            []
        );
        for (measures, text) in [
            (
                Measures {
                    clipped: 0.01,
                    ..good
                },
                "clipped samples: expected at most 0 %, found 1.0 %",
            ),
            (
                Measures {
                    noise: 0.02,
                    ..good
                },
                "noise: expected at most 0.50 %, found 2.0 %",
            ),
            (
                Measures {
                    distortion: (0.034, 0.001),
                    ..good
                },
                "distortion: expected at most 1.0 %, found 3.4 %",
            ),
            (
                Measures {
                    drift: 0.0061,
                    ..good
                },
                "drift: expected at most 0.50 %, found 0.61 %",
            ),
            (
                Measures {
                    drift: f64::NAN,
                    ..good
                },
                "drift: expected at most 0.50 %, found no number",
            ),
            (
                Measures {
                    repeatability: Some((0.3, 0.01)),
                    ..good
                },
                "difference of the halves: expected at most 1.0 %, found 30 %",
            ),
        ] {
            let failing = LIMITS.judge(&measures);
            assert_eq!(
                failing.iter().map(ToString::to_string).collect::<Vec<_>>(),
                [text]
            );
            assert!(severity(&failing) > 1.0, "{failing:?}");
        }
        let residual = LIMITS.judge_residual(0.02).unwrap();
        assert!(residual.is_of_sweep() && LIMITS.judge_residual(0.01).is_none());
        assert_eq!(
            residual.to_string(),
            "Kramers–Kronig residual: expected at most 1.0 %, found 2.0 %"
        );
    }

    #[test]
    fn a_small_change_that_the_fit_contains_is_not_a_difference_of_the_halves() {
        let measures = Measures {
            repeatability: Some((0.02, 0.001)),
            ..Measures::default()
        };
        let left = |change: f64| {
            let less = measures.less_change(Some(Complex64::new(0.0, change)));
            less.repeatability.unwrap()
        };
        assert!((left(0.04).0).abs() < 1e-12 && (left(0.04).1 - 0.001).abs() < 1e-12);
        assert!((left(0.01).0 - 0.015).abs() < 1e-12);
        assert_eq!(left(0.3), (0.02, 0.001));
        assert_eq!(measures.less_change(None), measures);
    }

    #[test]
    fn a_record_whose_impedance_changes_shows_it_in_its_halves() {
        let (n, interval_s, freq_hz) = (4000_u32, 1.0e-3, 1.25);
        let samples = |amplitude_v: f64, change: f64| -> Vec<f64> {
            let at = |k: u32| {
                let t = interval_s * f64::from(k);
                // A stride that is not periodic replaces noise.
                let noise = 1.0e-5 * ((f64::from(k) * 0.618_034).fract() - 0.5);
                amplitude_v
                    * (1.0 + change * f64::from(k) / f64::from(n))
                    * (std::f64::consts::TAU * freq_hz * t).cos()
                    + noise
            };
            (0..n).map(at).collect()
        };
        for (change, expected) in [(0.0, 0.0), (0.1, 0.05)] {
            let volts = [
                samples(0.0, 0.0),
                samples(0.01, 0.0),
                samples(0.0, 0.0),
                samples(0.02, change),
            ];
            let channels = volts.each_ref().map(|v| Channel::volts(v));
            let (difference, sigma) = halves(
                &Record {
                    channels: &channels,
                    interval_s,
                },
                freq_hz,
            )
            .unwrap();
            assert!(
                (difference - expected).abs() < 0.003,
                "{difference}, expected {expected}"
            );
            // The residual of a changing amplitude is not noise, but counts as such.
            assert!(sigma < 0.01, "{sigma}");
        }
    }
}
