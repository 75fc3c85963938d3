//! Converts one record of a sinusoid to a point of a sweep. The functions are pure: the same
//! samples give the same point, from the scope or later from a run folder.

use analysis_signal::{
    sine::{self, Channel, ChannelFit, Distortion, FitOptions, LeftOut, Note, Record, SineFit},
    spectrum::ChannelPhasors,
};
use instruments::{
    fixture::Fixture,
    scope::Waveform,
    units::{Hertz, Seconds},
};
use num_complex::Complex64;

use super::ExecuteError;
use crate::record::code_scale;
use bench_plan::measure::{
    HARMONICS, HarmonicsAndDrift, SweepPoint,
    channels::{ChannelFault, ControlPotentials, LoopRequest, find_channel_fault},
    harmonics_and_drift::fit_harmonics_and_drift,
    quality::{Failing, measure},
};

/// Least number of periods in a record.
const MIN_RECORD_PERIODS: f64 = 2.0;
/// Distortion above which a point is remarked, as a share.
const MUCH_DISTORTION: f64 = 0.01;
/// Standard deviations above which distortion does not count as noise.
const CERTAIN: f64 = 5.0;
/// Number of mains harmonics that are fitted, including the fundamental.
const MAINS_ORDERS: u32 = 3;
/// Greatest relative difference between the fitted and the set frequency.
const FREQ_TOLERANCE: f64 = 2.0e-3;

/// The point to which a record belongs.
#[derive(Debug, Clone, Copy)]
pub struct PointRequest {
    /// What is in the jig.
    pub fixture: Fixture,
    /// Place in the order of the sweep, from 0.
    pub index: usize,
    /// Commanded frequency, Hz.
    pub freq_hz: f64,
    /// Frequency of the mains, Hz; `None` if its harmonics are not fitted.
    pub mains_hz: Option<f64>,
    /// Commanded amplitude of the current, A.
    pub amplitude_a: f64,
    /// Resistance of the current shunt, Ω.
    pub shunt_ohm: f64,
}

/// A record of the four channels, independent of the storage of its samples.
#[derive(Debug, Clone, Copy)]
pub struct ChannelRecord<'a> {
    /// Samples of C1 to C4.
    pub channels: [Channel<'a>; 4],
    /// Time between two samples, s.
    pub interval_s: f64,
    /// Vertical scales, V per division.
    pub volts_per_div: [f64; 4],
    /// Step of the quantisation, V.
    pub lsb_v: [f64; 4],
}

impl<'a> ChannelRecord<'a> {
    /// Wraps a record that the scope has returned.
    pub fn of(waveforms: &'a [Waveform; 4]) -> Self {
        Self {
            channels: waveforms
                .each_ref()
                .map(|waveform| Channel::codes(&waveform.codes, code_scale(waveform))),
            interval_s: waveforms[0].interval_s,
            volts_per_div: waveforms
                .each_ref()
                .map(|waveform| waveform.preamble.volts_per_div),
            lsb_v: waveforms.each_ref().map(|waveform| {
                f64::from(waveform.preamble.code_step) * waveform.preamble.volts_per_code
            }),
        }
    }
}

/// Computes the point from a record; the caller adds what only the run knows.
pub fn analyse(
    request: &PointRequest,
    channel_record: &ChannelRecord<'_>,
    mut warnings: Vec<String>,
) -> Result<SweepPoint, ExecuteError> {
    let PointRequest {
        fixture,
        index,
        freq_hz,
        mains_hz,
        ..
    } = *request;
    let fail = |reason: String| ExecuteError::Signal {
        freq_hz: Hertz(freq_hz),
        reason,
    };
    let interval_s = channel_record.interval_s;
    let record = Record {
        channels: &channel_record.channels,
        interval_s,
    };
    let periods = interval_s * channel_record.channels[0].len() as f64 * freq_hz;
    // Two clocks differ by parts per million: a screen of two periods may contain one sample less.
    if periods < MIN_RECORD_PERIODS * (1.0 - FREQ_TOLERANCE) {
        let reason = format!(
            "expected a record of at least {MIN_RECORD_PERIODS} periods, found {periods:.2}: does \
            the scope's time run as ours?"
        );
        return Err(fail(reason));
    }
    let mut options = FitOptions {
        harmonics: HARMONICS.to_vec(),
        ..FitOptions::default()
    };
    if fixture == Fixture::Cell {
        // Include the decays after a change of frequency; a control has no memory.
        options.decays_s = sine::relaxations(interval_s * channel_record.channels[0].len() as f64);
    }
    if let Some(mains_hz) = mains_hz {
        options = options.with_mains(mains_hz, MAINS_ORDERS);
    }
    // The impedance of a cell moves with its charge and temperature; a control has none.
    let fit = if fixture == Fixture::Cell {
        sine::fit_with_change(&record, freq_hz, &options)
    } else {
        sine::fit_known_frequency(&record, freq_hz, &options)
    }
    .map_err(|error| fail(error.to_string()))?;
    let free = sine::fit_free_frequency(&record, Some(freq_hz), &options)
        .map_err(|error| fail(error.to_string()))?;
    if (free.freq_hz / freq_hz - 1.0).abs() > FREQ_TOLERANCE {
        // A scope that was not triggered may still hold the frame of an earlier point.
        let reason = format!(
            "a fit with free frequency finds {:.6} Hz in the record: is it an older one?",
            free.freq_hz
        );
        return Err(fail(reason));
    }
    warnings.extend(remarks(&fit));
    let residual_lag1 = fit
        .channels
        .iter()
        .map(|channel| channel.residual_lag1)
        .fold(0.0, f64::max);
    let phasors = ChannelPhasors::from_codes(&fit, channel_record.lsb_v)
        .map_err(|error| fail(error.to_string()))?;
    let harmonics_and_drift = HarmonicsAndDrift {
        relaxed: fit.relaxed,
        ..fit_harmonics_and_drift(&record, freq_hz)
    };
    warnings.extend(unsteady(&fit, &harmonics_and_drift));
    let change = impedance_change(&fit);
    warnings.extend(change.map(change_in_words));
    let clipped = fit
        .channels
        .iter()
        .map(|channel| channel.clipped_samples as f64 / fit.samples as f64)
        .fold(0.0, f64::max);
    let measures = measure(&record, &phasors, &harmonics_and_drift, clipped).less_change(change);
    Ok(SweepPoint {
        fixture,
        index,
        phasors,
        volts_per_div: channel_record.volts_per_div,
        free_freq_hz: Hertz(free.freq_hz),
        residual_lag1,
        harmonics_and_drift,
        warnings,
        time_s: Seconds::ZERO,
        captures: 1,
        rechecked: 0,
        spent: bench_plan::measure::Spent::default(),
        measures,
        failing: Vec::<Failing>::new(),
        conditions: None,
    })
}

/// Returns an error for a point whose channels cannot belong to one loop; the quality gate judges
/// a channel that clips.
///
/// # Errors
/// [`ExecuteError::Channels`], with the channel if one explains the fault.
pub fn check_channels(
    point: &SweepPoint,
    request: &PointRequest,
    controls: &[ControlPotentials],
) -> Result<(), ExecuteError> {
    if point.measures.clipped > 0.0 {
        return Ok(());
    }
    let request = LoopRequest {
        fixture: request.fixture,
        shunt_ohm: request.shunt_ohm,
        amplitude_a: request.amplitude_a,
        controls,
    };
    find_channel_fault(&point.phasors, &request).map_or(Ok(()), |ChannelFault { found, cause }| {
        Err(ExecuteError::Channels {
            freq_hz: Hertz(point.phasors.freq_hz),
            found,
            cause,
        })
    })
}

/// Returns the change of the impedance over the record, relative to it, if the fit contains one.
fn impedance_change(fit: &SineFit) -> Option<Complex64> {
    let [c1, c2, c3, c4] = fit.channels.as_slice() else {
        return None;
    };
    let length_s = fit.interval_s * fit.samples as f64;
    let relative = |high: &ChannelFit, low: &ChannelFit| {
        (high.phasor_slope - low.phasor_slope) / (high.phasor - low.phasor)
    };
    let change = (relative(c4, c3) - relative(c2, c1)) * length_s;
    (fit.varying && change.is_finite()).then_some(change)
}

pub(super) fn change_in_words(change: Complex64) -> String {
    // Round the size to its decade, so that a change of many records is reported once.
    let least = 10.0_f64.powf((100.0 * change.norm()).log10().floor());
    format!(
        "the impedance changes by {least} % to {} % over the record: the point is that of its middle",
        10.0 * least
    )
}

/// Describes a relaxation that the record shows.
fn unsteady(fit: &SineFit, harmonics_and_drift: &HarmonicsAndDrift) -> Option<String> {
    let [_, _, low, high] = fit.channels.as_slice() else {
        return None;
    };
    let bend = harmonics_and_drift.bend.filter(|bend| bend.is_certain())?;
    let microvolts = 1.0e6
        * if fit.relaxed {
            high.relaxation_v - low.relaxation_v
        } else {
            bend.volts
        };
    // Round the size to its decade, so that an effect in many records is reported once.
    let least = 10.0_f64.powf(microvolts.abs().log10().floor());
    let fitted = if fit.relaxed {
        "fitted beside the sinusoid"
    } else {
        "not fitted, because the record is too short: its uncertainty includes the drift"
    };
    Some(format!(
        "the record is not stationary: the cell's voltage bends by {least} µV to {} µV, {fitted}",
        10.0 * least
    ))
}

/// Returns remarks on a fit. Harmonics and mains beyond half the sampling rate are omitted, and so
/// is a mains of less than a period in the record of a fast sinusoid, where it is drift.
fn remarks(fit: &SineFit) -> Vec<String> {
    let known = |note: &&Note| {
        !matches!(
            note,
            Note::LeftOut {
                why: LeftOut::AboveNyquist { .. } | LeftOut::TooSlow { .. },
                ..
            }
        )
    };
    let mut remarks: Vec<String> = fit
        .notes
        .iter()
        .filter(known)
        .map(Note::to_string)
        .collect();
    for channel in 0..fit.channels.len() {
        if let Some(Distortion { thd, sigma }) = fit.distortion(channel)
            && thd > MUCH_DISTORTION.max(CERTAIN * sigma)
        {
            remarks.push(format!(
                "channel {}: {:.1} % of distortion by harmonics {HARMONICS:?}",
                channel + 1,
                100.0 * thd
            ));
        }
    }
    remarks
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns codes of a sinusoid of 40 periods with a second harmonic, rounded, on a range of 12
    /// bits.
    fn codes(amplitude: f64, second: f64, dither: f64) -> Vec<i16> {
        let value = |n: u32| {
            let theta = std::f64::consts::TAU * 0.0101 * f64::from(n);
            // A stride that is not periodic replaces noise.
            amplitude * (theta.cos() + second * (2.0 * theta).cos())
                + dither * ((f64::from(n) * 0.618_034).fract() - 0.5)
        };
        (0..4000).map(|n| value(n).round() as i16).collect()
    }

    #[test]
    fn distortion_and_quantisation_are_remarked_and_a_good_record_is_not() {
        let scale = sine::CodeScale {
            volts_per_code: 1e-3,
            offset_v: 0.0,
            code_min: -2048,
            code_max: 2047,
            code_step: 1,
        };
        let message = |codes: &[i16]| {
            let channels = [Channel::codes(codes, scale)];
            let options = FitOptions {
                harmonics: HARMONICS.to_vec(),
                ..FitOptions::default()
            };
            let fit = sine::fit_known_frequency(
                &Record {
                    channels: &channels,
                    interval_s: 1e-3,
                },
                10.1,
                &options,
            );
            remarks(&fit.unwrap_or_else(|error| panic!("{error}")))
        };
        assert_eq!(message(&codes(1000.0, 0.0, 3.0)), [""; 0]);
        assert_eq!(
            message(&codes(1000.0, 0.03, 3.0)),
            ["channel 1: 3.0 % of distortion by harmonics [2, 3]"]
        );
        let coarse = message(&codes(1.6, 0.0, 0.0));
        assert!(
            coarse[0].starts_with("channel 1: ") && coarse[0].contains("LSB of noise are too few"),
            "{coarse:?}"
        );
    }
}
