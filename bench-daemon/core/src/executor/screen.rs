//! The scope's settings: the wanted ones, the last ones sent, and those that a record requires.

use std::ops::RangeInclusive;

use instruments::{
    scope::{Capabilities, Intent, Trigger, Vertical, Waveform},
    units::{Hertz, Seconds, Volts},
};

use super::{ExecuteError, require};
use crate::bench::Bench;

/// The trigger uses the high side of the shunt: a large, clean copy of the current.
const TRIGGER_CHANNEL: u8 = 2;
/// Share of the ADC's range below which the range of a signal is changed.
const MIN_SPAN: f64 = 0.04;
/// Share of a new range that the signal is to span.
const WANTED_SPAN: f64 = 0.5;
/// Greatest relative deviation of a frame from the requested settings.
const FRAME_TOLERANCE: f64 = 0.02;
/// Height of the trigger level above the centre, in divisions, at which no signal reaches it: the
/// scope is to roll.
const OUT_OF_REACH_DIV: f64 = 4.0;

/// The scope's settings: the wanted ones and the last ones sent.
pub(super) struct Screen {
    /// Wanted vertical settings of the channels.
    pub(super) verticals: [Option<Vertical>; 4],
    /// Vertical settings that were last applied.
    pub(super) applied: [Option<Vertical>; 4],
    /// Level of the trigger; follows the signal.
    pub(super) trigger_v: Volts,
    /// Memory depth that was last set.
    pub(super) memory_points: Option<u64>,
    /// Time at which the scope was last stopped, s.
    pub(super) stopped_s: Seconds,
    /// Time per division and trigger with which the scope was last armed.
    pub(super) armed: Option<(Seconds, Trigger)>,
}

impl Default for Screen {
    fn default() -> Self {
        Self {
            verticals: [None; 4],
            applied: [None; 4],
            trigger_v: Volts::ZERO,
            memory_points: None,
            stopped_s: Seconds::ZERO,
            armed: None,
        }
    }
}

impl Screen {
    /// Discards the ranges after a change of the object in the jig.
    pub(super) fn forget(&mut self) {
        self.verticals = [None; 4];
        self.trigger_v = Volts::ZERO;
    }

    /// Sets the wanted scales, V per division, with the cell's voltage in the centre of channel 4.
    pub(super) fn centre(&mut self, per_div_v: [Volts; 4], cell_v: Volts, scope: &Capabilities) {
        // The offset is the negative: the messages of earlier versions have a zero without a sign
        // for the channels of the shunt.
        self.centre_on(
            per_div_v,
            [Volts(-0.0), Volts(-0.0), Volts(-0.0), cell_v],
            scope,
        );
    }

    /// Sets the wanted scales, V per division, with these voltages in the centres of the channels.
    pub(super) fn centre_on(
        &mut self,
        per_div_v: [Volts; 4],
        middle_v: [Volts; 4],
        scope: &Capabilities,
    ) {
        for (index, channel) in (1..=4_u8).enumerate() {
            let offset = -middle_v[index];
            self.verticals[index] = Some(Vertical {
                channel,
                per_div: scope.scale_for_offset(per_div_v[index], offset),
                offset,
            });
        }
    }

    /// Sets the trigger to the mean of its channel.
    pub(super) fn trigger_at(&mut self, means_v: [Volts; 4]) {
        self.trigger_v = means_v[usize::from(TRIGGER_CHANNEL) - 1];
    }

    /// Brings the mean of a channel's record into the centre of the channel on the same scale: under
    /// a direct current the voltage of the cell moves from record to record.
    pub(super) fn follow(&mut self, waveform: &Waveform) {
        let (least_v, greatest_v) = waveform.extremes_v();
        let slot = usize::from(waveform.channel).saturating_sub(1);
        if let Some(vertical) = self.verticals.get_mut(slot).and_then(Option::as_mut) {
            vertical.offset = Volts(-0.5 * (greatest_v + least_v));
        }
    }

    /// Sends the settings of all channels again before the next record.
    pub(super) fn forget_verticals(&mut self) {
        self.applied = [None; 4];
    }

    /// Sends the settings of the channels that must change.
    pub(super) async fn apply(&mut self, bench: &mut Bench) -> Result<(), ExecuteError> {
        let error = bench.error("scope");
        for (wanted, applied) in self.verticals.iter().zip(&mut self.applied) {
            if let Some(vertical) = wanted.filter(|_| wanted != applied) {
                require(&mut bench.instruments.scope, "scope")?
                    .set(&Intent::Vertical(vertical))
                    .await
                    .map_err(&error)?;
                *applied = Some(vertical);
            }
        }
        Ok(())
    }

    /// Arms the scope for a span; returns the length of its screen, s.
    pub(super) async fn arm(
        &mut self,
        bench: &mut Bench,
        span: Seconds,
        overlaps: bool,
    ) -> Result<Seconds, ExecuteError> {
        let trigger = Trigger {
            channel: TRIGGER_CHANNEL,
            level: self.trigger_v,
        };
        let error = bench.error("scope");
        let scope = require(&mut bench.instruments.scope, "scope")?;
        let (per_div, scope_divisions) = (
            scope.capabilities().time_per_div(span),
            scope.capabilities().horizontal_div,
        );
        let same = self.armed.replace((per_div, trigger)).filter(|_| overlaps);
        let timebase =
            (same.map(|armed| armed.0) != Some(per_div)).then_some(Intent::Timebase(per_div));
        if let Some(timebase) = timebase {
            scope.set(&timebase).await.map_err(&error)?;
        }
        let trigger = Intent::Trigger(trigger);
        if overlaps {
            // Settings that are unchanged since the previous point are not sent again, because that
            // would reduce the time for settling. One of them is read back instead, in turn.
            scope.set_changes(&trigger).await.map_err(&error)?;
        } else {
            scope.set(&trigger).await.map_err(&error)?;
        }
        scope.set(&Intent::Arm).await.map_err(&error)?;
        if overlaps && let Some(met) = scope.check_in_turn().await.map_err(&error)? {
            let role = "scope";
            return Err(ExecuteError::Meddled { role, met });
        }
        Ok(per_div * scope_divisions)
    }

    /// Returns a trigger level that no signal reaches, V: the scope is to roll.
    pub(super) fn out_of_reach(&self) -> Volts {
        Volts(OUT_OF_REACH_DIV * self.verticals[1].map_or(0.0, |vertical| vertical.per_div.value()))
    }

    /// Checks that the frame belongs to this acquisition: as long as the screen, on the scales
    /// that were set, equal for all channels.
    pub(super) fn check_frame(
        &self,
        freq_hz: Hertz,
        waveforms: &[Waveform],
        screen_s: Seconds,
    ) -> Result<(), ExecuteError> {
        let fail = |reason: String| Err(ExecuteError::Signal { freq_hz, reason });
        for (waveform, applied) in waveforms.iter().zip(&self.applied) {
            let preamble = &waveform.preamble;
            let length_s = preamble.interval_s * preamble.points as f64;
            if (length_s / screen_s.value() - 1.0).abs() > FRAME_TOLERANCE {
                return fail(format!(
                    "channel {}: expected a frame of {screen_s}, found one of {length_s} s",
                    waveform.channel
                ));
            }
            let per_div_v = applied.map_or(f64::NAN, |vertical| vertical.per_div.value());
            if (preamble.volts_per_div / per_div_v - 1.0).abs() > FRAME_TOLERANCE {
                let found = preamble.volts_per_div;
                return fail(format!(
                    "channel {}: expected a frame at {per_div_v} V/div, found one at {found} V/div",
                    waveform.channel
                ));
            }
            if waveform.interval_s != waveforms[0].interval_s
                || waveform.codes.len() != waveforms[0].codes.len()
            {
                return fail(format!(
                    "channel {}: expected the samples of channel 1, found another number or \
                    interval",
                    waveform.channel
                ));
            }
        }
        Ok(())
    }

    /// Sets new ranges for the channels that clipped or were too small and describes them; the
    /// trigger level and the offsets follow the signal.
    pub(super) fn range_again(
        &mut self,
        waveforms: &[Waveform; 4],
        scope: &Capabilities,
    ) -> Vec<String> {
        let mut changes = Vec::new();
        for (slot, waveform) in waveforms.iter().enumerate() {
            let Some(vertical) = self.verticals[slot] else {
                continue;
            };
            let (least_v, greatest_v) = waveform.extremes_v();
            if waveform.channel == TRIGGER_CHANNEL {
                self.trigger_v = Volts(0.5 * (greatest_v + least_v));
            }
            let clipped = waveform.clipped_share() > 0.0;
            let Some(changed) = other_range(&vertical, least_v..=greatest_v, clipped, scope) else {
                continue;
            };
            let what = if clipped { "clipped" } else { "small" };
            changes.push(format!(
                "channel {} {what} at {} V/div",
                waveform.channel,
                vertical.per_div.value()
            ));
            self.verticals[slot] = Some(changed);
        }
        changes
    }
}

/// Returns another range for a signal that clipped or is small in its range, or `None` if the
/// range is right or the finest available. A signal that lies completely outside has no span, but
/// it is not small.
fn other_range(
    vertical: &Vertical,
    extremes_v: RangeInclusive<f64>,
    clipped: bool,
    scope: &Capabilities,
) -> Option<Vertical> {
    let (least_v, greatest_v) = extremes_v.into_inner();
    let (span_v, per_div_v) = (greatest_v - least_v, vertical.per_div.value());
    let small = !clipped
        && span_v < MIN_SPAN * 2.0 * scope.half_range_div * per_div_v
        && per_div_v > scope.per_div.0.value() * 1.001;
    if !(clipped || small) {
        return None;
    }
    let wanted_v = if clipped {
        2.0 * per_div_v
    } else {
        (span_v / (2.0 * scope.half_range_div * WANTED_SPAN)).max(scope.per_div.0.value())
    };
    let offset = Volts(-0.5 * (greatest_v + least_v));
    let per_div = scope.scale_for_offset(Volts(round_scale(wanted_v)), offset);
    (clipped || per_div.value() < per_div_v).then_some(Vertical {
        channel: vertical.channel,
        per_div,
        offset,
    })
}

/// Rounds up to two significant digits: scopes accept any scale, and people prefer round ones.
fn round_scale(scale: f64) -> f64 {
    let decade = 10.0_f64.powf(scale.log10().floor() - 1.0);
    (scale / decade).ceil() * decade
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_wholly_outside_its_range_is_given_a_wider_one() {
        let dialect =
            instruments::instrument::by_key(instruments::scope::DIALECTS, "siglent-sds800x-hd");
        let scope = dialect.map(|dialect| dialect.capabilities()).unwrap();
        let vertical = Vertical {
            channel: 1,
            per_div: Volts(0.02),
            offset: Volts(0.0),
        };
        let rail_v = 0.02 * scope.half_range_div;
        // Every sample is the same: the greatest code.
        let wider =
            other_range(&vertical, rail_v..=rail_v, true, &scope).map(|vertical| vertical.per_div);
        assert_eq!(wider, Some(Volts(0.04)));
        let swing = |share: f64| -share * rail_v..=share * rail_v;
        assert_eq!(other_range(&vertical, swing(0.5), false, &scope), None);
        let finer = other_range(&vertical, swing(0.03), false, &scope)
            .map_or(f64::NAN, |vertical| vertical.per_div.value());
        assert!(finer < 0.02, "{finer}");
    }

    #[test]
    fn scales_are_rounded_up_to_two_digits() {
        for (scale, rounded) in [
            (0.0173, 0.018),
            (0.02, 0.02),
            (1.01, 1.1),
            (0.000_5, 0.000_5),
        ] {
            assert!(
                (round_scale(scale) - rounded).abs() < 1.0e-9,
                "{scale}: {}",
                round_scale(scale)
            );
        }
    }
}
