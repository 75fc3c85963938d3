//! Checks the effect of a fast current on the cell between two readings. Meters average over the
//! crests, so the crests are checked before the signal starts and in its record.

use instruments::{
    fixture::Fixture,
    scope::Waveform,
    units::{Amps, Hertz, Ohms, Volts},
};

use super::{ExecuteError, Executor, Rig, rig::FirstMean, watch::drawn};
use bench_plan::{
    interlock::{NO_CURRENT_A, Trip},
    measure::zero::{SINCE_ZERO, allowed_since_zero_a},
};

use crate::clock::TypedClock;

/// Greatest impedance of a cell for which this bench is made, at any frequency of a sweep, Ω. The
/// record shows the actual value a moment later.
const MOST_OHM: Ohms = Ohms(0.025);
/// Margin of a crest for noise and gain errors of the channels, V.
const MARGIN_V: Volts = Volts(0.02);
/// Least correlation of neighbouring samples of a signal.
const SMOOTH: f64 = 0.5;
/// Offset error of a channel, as a share of its range, and V (data sheets of 12-bit scopes: 0.5 %
/// to 1 %, and 1 mV).
const OFFSET_SHARE: f64 = 0.01;
const OFFSET_V: Volts = Volts(1.0e-3);
/// Gain error of a scope's offset, by which the cell's voltage is brought to the centre (data
/// sheets of 12-bit scopes: 1 % to 1.5 %).
pub(super) const OFFSET_GAIN: f64 = 0.015;

/// Share of the samples that noise may move beyond a crest: 0.1 % of normal noise lies beyond 3.3
/// standard deviations, and a current that flows for a shorter time is a spike.
const BEYOND: f64 = 1.0e-3;

/// Share of a period by which a record may be shorter than a whole period and still count as
/// whole: two clocks differ by parts per million.
const PERIOD_SLACK: f64 = 2.0e-3;

/// A record, and the current that was commanded while it was taken.
pub(super) struct Drawn<'w> {
    pub(super) waveforms: &'w [Waveform; 4],
    /// Lowest frequency in it, Hz.
    pub(super) freq_hz: Hertz,
    /// Peak of the current, A.
    pub(super) amplitude_a: Amps,
}

impl Rig<'_> {
    /// Trips if a record shows more current than the step requests, or the cell beyond its limits,
    /// whatever the meters have averaged. Records that cannot show a current, or cannot come from
    /// this cell, are rejected before any conclusion is drawn from them.
    pub(super) async fn crest(
        &mut self,
        fixture: Fixture,
        asked: &Drawn<'_>,
    ) -> Result<(), ExecuteError> {
        self.refuse_old_record(fixture, asked)?;
        let Drawn {
            waveforms,
            freq_hz,
            amplitude_a,
        } = *asked;
        let [below, above, low, high] = waveforms;
        let current = difference(above, below);
        let mean_v = mean(whole_periods(&current, below.interval_s * freq_hz.value()));
        let r_ohm = Ohms(self.setup.wiring.shunt.r_ohm);
        let mean_a = Volts(mean_v) / r_ohm;
        let mut unsure_v: Volts = [below, above]
            .iter()
            .map(|waveform| self.offset_error_v(waveform))
            .sum();
        let biased = self.driving.bias.is_on();
        if biased {
            let offset_v = |waveform: &Waveform| waveform.preamble.offset_v.abs();
            unsure_v += Volts(OFFSET_GAIN * (offset_v(below) + offset_v(above)));
        }
        let greatest = 0.1 * amplitude_a + NO_CURRENT_A + unsure_v / r_ohm;
        let time_s = self.clock.now();
        let volts_per_div = [below, above].map(|waveform| waveform.preamble.volts_per_div);
        // On new scales the zeros of the channels differ: carry over the change of the mean up to
        // now.
        let first = match self.driving.first_mean {
            Some(first) if first.volts_per_div == volts_per_div => first,
            _ => self.first_mean(fixture, asked, mean_a),
        };
        self.driving.first_mean = Some(first);
        if fixture != Fixture::Cell {
            self.keep_zero(asked);
        }
        // A channel that clips shows what both channels have in common, and is measured again.
        // Noise is not a current: the quality gate judges it.
        let clips = [below, above]
            .into_iter()
            .any(|waveform| waveform.clipped_share() > 0.0);
        let crest_a = if clips || !smooth(&current) {
            Amps::ZERO
        } else {
            Volts(within(&current, (mean_a * r_ohm).value())) / r_ohm
        };
        let crest = (crest_a > drawn(amplitude_a) + unsure_v / r_ohm).then_some((
            "crest of the cell current in a record",
            crest_a,
            drawn(amplitude_a),
        ));
        let balance = Balance {
            mean_a,
            expected_a: self.driving.bias.met.base_a,
            greatest_a: greatest,
            first,
            amplitude_a,
        };
        if let Some((what, value, greatest)) = balance.direct().or(crest) {
            if !smooth(&current) {
                return Err(self.no_record("of the current"));
            }
            let trip = Trip::limit(what, value, &(-greatest..=greatest), time_s);
            return Err(trip.because(self.cause().await).into());
        }
        self.driving.mean_change_a = mean_a - first.zero_a;
        if biased {
            // The offsets of the channels are the same in the record before the first sinusoid.
            let base_a = self.driving.bias.met.base_a;
            let met_a = first
                .channels_a
                .map_or(base_a, |channels_a| base_a + mean_a - channels_a);
            self.driving.bias.meet(time_s, met_a);
        }
        if fixture != Fixture::Cell {
            return Ok(());
        }
        let cell = difference(high, low);
        // The scope may be wrong: the voltmeter shows the voltage of the cell between the crests.
        let most_a = amplitude_a + self.driving.bias.commanded_a.abs();
        let agreed = self.cross_check_scope(waveforms, most_a * MOST_OHM);
        let (least_v, greatest_v) = cell.iter().map(|v| Volts(*v)).fold(
            (Volts::INFINITY, Volts::NEG_INFINITY),
            |(least, most), v| (least.min(v), most.max(v)),
        );
        let limits = &self.setup.limits;
        let (least, greatest) = (limits.min_v, limits.max_v);
        let beyond = [
            (least_v, least_v < least - MARGIN_V),
            (greatest_v, greatest_v > greatest + MARGIN_V),
        ];
        let beyond = beyond.into_iter().find(|(_, beyond)| *beyond);
        if (agreed.is_err() || beyond.is_some()) && !smooth(&cell) {
            return Err(self.no_record("of a cell"));
        }
        agreed?;
        let Some((value, _)) = beyond else {
            return Ok(());
        };
        let what = "cell voltage at the crest of a record";
        Err(Trip::limit(what, value, &(least..=greatest), time_s).into())
    }

    fn no_record(&self, of: &str) -> ExecuteError {
        let allowed = format!("{SMOOTH} from one sample to the next");
        let one =
            format!("a record {of} from the scope whose samples are not related to each other");
        ExecuteError::Disagree {
            what: "record",
            one,
            other: "a sampled signal is smooth".to_owned(),
            allowed,
        }
    }

    /// Returns the possible offset error of a channel, V: one per cent of its range, and a
    /// millivolt.
    pub(super) fn offset_error_v(&self, waveform: &Waveform) -> Volts {
        let half_range_div = self
            .bench
            .instruments
            .scope
            .as_ref()
            .map_or(4.0, |scope| scope.capabilities().half_range_div);
        Volts(OFFSET_SHARE * 2.0 * half_range_div * waveform.preamble.volts_per_div) + OFFSET_V
    }
}

impl Executor<'_> {
    /// Refuses a current whose crests could exceed the voltage limits of the cell, from its
    /// voltage at rest.
    pub(super) fn headroom(
        &self,
        fixture: Fixture,
        freq_hz: Hertz,
        peak_a: Amps,
    ) -> Result<(), ExecuteError> {
        if self.rig.driving.bias.is_on() {
            // The ramp was refused unless every crest about the direct current is allowed.
            return Ok(());
        }
        let Some(rest_v) = self
            .known
            .idle
            .voltage_v
            .filter(|_| fixture == Fixture::Cell)
        else {
            return Ok(());
        };
        let limits = &self.rig.setup.limits;
        let (least_v, greatest_v) = (rest_v - peak_a * MOST_OHM, rest_v + peak_a * MOST_OHM);
        if least_v >= limits.min_v && greatest_v <= limits.max_v {
            return Ok(());
        }
        let reason = format!(
            "expected crests within {} V to {} V, found up to {least_v:.3} to {greatest_v:.3} \
            for {peak_a} at a cell of {rest_v:.3}",
            limits.min_v.0, limits.max_v.0
        );
        Err(ExecuteError::Signal { freq_hz, reason })
    }
}

/// The mean of the current in a record, and its limits.
struct Balance {
    mean_a: Amps,
    /// Direct current under the sinusoid, A.
    expected_a: Amps,
    /// Greatest allowed distance of the mean from it, A.
    greatest_a: Amps,
    /// The mean of the first record on the same scales.
    first: FirstMean,
    /// Requested amplitude, A.
    amplitude_a: Amps,
}

impl Balance {
    /// Returns the fault of the mean of a record, its value and its limit, A. Checks the mean, its
    /// change since the first record on the same scales and its distance from the zero of the
    /// channels. The zeros of the channels do not change from record to record, and the supply has
    /// shown that nothing flowed before the first: a change may be as large as one of the two
    /// allowances for the mean, not as their sum. Records are some seconds apart, and a drift
    /// continues between them.
    fn direct(&self) -> Option<(&'static str, Amps, Amps)> {
        let change = (
            "change of the mean of the cell current from record to record",
            self.mean_a - self.first.zero_a,
            (0.1 * self.amplitude_a).max(NO_CURRENT_A),
        );
        let since_zero = self.first.channels_a.map(|zero_a| {
            let allowed_a = allowed_since_zero_a(self.amplitude_a);
            (SINCE_ZERO, self.mean_a - zero_a, allowed_a)
        });
        let whole = (
            "mean of the cell current in a record",
            self.mean_a - self.expected_a,
            self.greatest_a,
        );
        [whole, change]
            .into_iter()
            .chain(since_zero)
            .find(|(_, value, greatest)| value.abs() > *greatest)
    }
}

/// Returns the distance from `middle` within which all but [`BEYOND`] of the samples lie.
fn within(samples: &[f64], middle: f64) -> f64 {
    let mut distances: Vec<f64> = samples.iter().map(|v| (v - middle).abs()).collect();
    let count = ((1.0 - BEYOND) * distances.len() as f64) as usize;
    if count >= distances.len() {
        return 0.0;
    }
    *distances.select_nth_unstable_by(count, f64::total_cmp).1
}

/// Returns the samples of whole periods; `periods_per_sample` is the number of periods per sample.
pub(super) fn whole_periods(samples: &[f64], periods_per_sample: f64) -> &[f64] {
    let periods = (samples.len() as f64 * periods_per_sample + PERIOD_SLACK).floor();
    let count = (periods / periods_per_sample).round() as usize;
    samples
        .get(..count)
        .filter(|whole| !whole.is_empty())
        .unwrap_or(samples)
}

/// Returns the difference of two channels, V.
pub(super) fn difference(high: &Waveform, low: &Waveform) -> Vec<f64> {
    let volts = |waveform: &Waveform, code: i16| {
        f64::from(code) * waveform.preamble.volts_per_code - waveform.preamble.offset_v
    };
    high.codes
        .iter()
        .zip(&low.codes)
        .map(|(high_code, low_code)| volts(high, *high_code) - volts(low, *low_code))
        .collect()
}

/// Returns the samples of a channel, V.
pub(super) fn channel_volts(waveform: &Waveform) -> Vec<f64> {
    let preamble = &waveform.preamble;
    let volts = |code: &i16| f64::from(*code) * preamble.volts_per_code - preamble.offset_v;
    waveform.codes.iter().map(volts).collect()
}

pub(super) fn mean(samples: &[f64]) -> f64 {
    samples.iter().sum::<f64>() / samples.len().max(1) as f64
}

/// Checks whether neighbouring samples are correlated: those of a signal are, random bytes are
/// not. A constant record is smooth.
fn smooth(samples: &[f64]) -> bool {
    let middle = mean(samples);
    let square: f64 = samples.iter().map(|v| (v - middle).powi(2)).sum();
    let pairs: f64 = samples
        .windows(2)
        .map(|pair| (pair[0] - middle) * (pair[1] - middle))
        .sum();
    square <= 0.0 || pairs / square >= SMOOTH
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_whole_periods_does_not_see_the_rest_of_the_record() {
        let sine: Vec<f64> = (0..1000)
            .map(|k| 0.3 + (std::f64::consts::TAU * 0.00267 * f64::from(k)).sin())
            .collect();
        assert!((mean(&sine) - 0.3).abs() > 0.05);
        assert!((mean(whole_periods(&sine, 0.00267)) - 0.3).abs() < 2.0e-3);
        // Less than a period stays unchanged, and a record that ends a sample early counts as
        // whole.
        assert_eq!(
            (
                whole_periods(&sine, 1.0e-4).len(),
                whole_periods(&sine, 1.9999e-3).len()
            ),
            (1000, 1000)
        );
    }

    #[test]
    fn a_direct_current_shows_in_the_mean_and_earlier_in_its_change() {
        let under = |expected_a, mean_a, zero_a| {
            Balance {
                mean_a,
                expected_a,
                greatest_a: Amps(0.7),
                first: FirstMean {
                    volts_per_div: [0.02; 2],
                    zero_a,
                    channels_a: None,
                },
                amplitude_a: Amps(1.0),
            }
            .direct()
            .map(|(what, ..)| what.split(' ').next().unwrap_or_default())
        };
        let what = |mean_a, zero_a| under(Amps(0.0), mean_a, zero_a);
        // A direct current that is commanded is expected; beside it the same limits hold.
        assert_eq!(
            [
                under(Amps(5.0), Amps(5.5), Amps(5.5)),
                under(Amps(5.0), Amps(5.71), Amps(5.71)),
                under(Amps(5.0), Amps(0.0), Amps(0.0))
            ],
            [None, Some("mean"), Some("mean")]
        );
        // The zeros of the channels may correspond to half an ampere.
        assert_eq!(
            [
                what(Amps(0.5), Amps(0.5)),
                what(Amps(0.5), Amps(0.45)),
                what(Amps(-0.5), Amps(-0.41))
            ],
            [None, None, None]
        );
        assert_eq!(
            [what(Amps(0.71), Amps(0.71)), what(Amps(-0.71), Amps(-0.7))],
            [Some("mean"), Some("mean")]
        );
        assert_eq!(
            [what(Amps(0.5), Amps(0.39)), what(Amps(-0.1), Amps(0.01))],
            [Some("change"), Some("change")]
        );
    }

    #[test]
    fn an_oscillation_beside_the_sine_shows_in_its_crest_and_a_spike_does_not() {
        let with = |amplitude: f64| -> Vec<f64> {
            let beside = |k: f64| amplitude * (std::f64::consts::TAU * 0.21 * k).sin();
            (0..10_000)
                .map(f64::from)
                .map(|k| 0.3 + (std::f64::consts::TAU * 0.001 * k).sin() + beside(k))
                .collect()
        };
        let mut spiked = with(0.0);
        spiked[17] = 9.0;
        assert!(
            (within(&spiked, 0.3) - 1.0).abs() < 1.0e-3,
            "{}",
            within(&spiked, 0.3)
        );
        assert!(within(&with(2.0), 0.3) > 2.9);
        assert_eq!(within(&[], 0.0), 0.0);
    }

    #[test]
    fn a_signal_is_smooth_and_random_bytes_are_not() {
        let sine: Vec<f64> = (0..1000)
            .map(|k| 3.7 + 0.02 * (0.06 * f64::from(k)).sin())
            .collect();
        let noise: Vec<f64> = (0..1000_u32)
            .map(|k| f64::from(k.wrapping_mul(2_654_435_761) >> 16) / 65_536.0)
            .collect();
        assert!(smooth(&sine) && !smooth(&noise) && smooth(&[3.7; 10]));
    }
}
