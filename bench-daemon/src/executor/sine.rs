//! Measures one sinusoid: drives it, waits, captures, and analyses. Where a channel clipped or was
//! too small, it is ranged again.

use instruments::{
    fixture::Fixture,
    generator::Sine,
    scope::{Capabilities, Chosen, Intent, Trigger, Vertical, Waveform},
    units::{Hertz, Seconds, Volts},
};

use super::{
    ExecuteError, Executor, Rig,
    ahead::Tone,
    burst::MOST_LONGER,
    crest::Drawn,
    record::{Asked, Taken, analyse},
    require,
    watch::drawn,
};
use crate::{
    config::Eis,
    measure::SweepPoint,
    plan::{MAX_RANGING, Step, fixture_name},
    record::CaptureFile,
};

/// The trigger watches the high side of the shunt: a large, clean copy of the current.
const TRIGGER_CHANNEL: u8 = 2;
/// A signal that spans less than this share of the ADC's range is ranged again.
const MIN_SPAN: f64 = 0.04;
/// A new range is chosen so that the signal spans this share of it.
const WANTED_SPAN: f64 = 0.5;
/// How far the amplitude of the current may stay behind its command, as a share: at the end of its
/// band a supply loses a seventh.
const CURRENT_TOLERANCE: f64 = 0.2;
/// How far a frame may be from the settings that it was asked with, as a share.
const FRAME_TOLERANCE: f64 = 0.02;

impl Rig<'_> {
    /// Sets the generator so that the supply drives `amplitude_a`, for `wait_s` at least.
    pub(super) async fn drive(&mut self, tone: &Tone) -> Result<(), ExecuteError> {
        let supply = require(&mut self.bench.supply4q, "supply4q")?.capabilities();
        let wiring = &self.experiment.bench.wiring;
        let volts_per_amp = supply.analog_full_scale.value() / supply.full_scale.value();
        let sine = Sine {
            freq: Hertz(tone.freq_hz),
            amplitude: Volts(tone.amplitude_a * volts_per_amp * wiring.command_trim),
            offset: Volts(wiring.command_offset_v),
        };
        let error = self.bench.error("generator");
        require(&mut self.bench.generator, "generator")?
            .sine(&sine)
            .await
            .map_err(error)?;
        self.begin_signal(tone.freq_hz, tone.wait_s).await
    }

    /// The four channels of the stopped frame.
    async fn fetch_frame(
        &mut self,
        (points, chosen): (u64, Option<Chosen>),
        fixture: Fixture,
    ) -> Result<Vec<Waveform>, ExecuteError> {
        let (overlaps, error) = (self.overlaps(), self.bench.error("scope"));
        let mut waveforms: Vec<Waveform> = Vec::with_capacity(4);
        for channel in 1..=4 {
            let scope = require(&mut self.bench.scope, "scope")?;
            let waveform = match (waveforms.last().filter(|_| overlaps), chosen) {
                (Some(before), _) => scope.download_beside(channel, points, before).await,
                (None, Some(chosen)) => scope.download_chosen(chosen, points).await,
                (None, None) => scope.download(channel, points).await,
            };
            waveforms.push(waveform.map_err(&error)?);
            // The current still flows: a download must not stop the watching.
            self.watch_between(fixture).await?;
        }
        Ok(waveforms)
    }

    /// The current must follow the command: a loose lead or a supply in its limits shows here.
    /// Gives its amplitude, A.
    fn check_current(&self, point: &SweepPoint, amplitude_a: f64) -> Result<f64, ExecuteError> {
        let [first, second, _, _] = point.phasors.volts;
        let met_a = (second - first).norm() / self.experiment.bench.wiring.shunt.r_ohm;
        let (least_a, greatest_a) = ((1.0 - CURRENT_TOLERANCE) * amplitude_a, drawn(amplitude_a));
        if (least_a..=greatest_a).contains(&met_a) {
            return Ok(met_a);
        }
        Err(ExecuteError::Disobeyed {
            what: format!("current at {} Hz", point.phasors.freq_hz),
            expected: format!("an amplitude from {least_a:.3} A to {greatest_a:.3} A"),
            met: format!("{met_a:.4} A"),
        })
    }
}

impl Executor<'_> {
    /// Drives, captures and analyses one point; `taken` records of it are there already.
    pub(super) async fn sine(
        &mut self,
        fixture: Fixture,
        step: &Step,
        taken: usize,
    ) -> Result<SweepPoint, ExecuteError> {
        let Step::Sine {
            index,
            freq_hz,
            amplitude_a,
            wait_s,
        } = *step
        else {
            return Err(ExecuteError::Signal {
                freq_hz: 0.0,
                reason: "not a sine step".to_owned(),
            });
        };
        let Some(eis) = &self.rig.experiment.eis else {
            return Err(ExecuteError::Signal {
                freq_hz,
                reason: "no section [eis]".to_owned(),
            });
        };
        let tone = Tone {
            freq_hz,
            amplitude_a,
            wait_s,
        };
        let mut driven_s = match self.sweep.taken_ahead(&tone) {
            Some(since_s) => since_s,
            None => self.driven(fixture, &tone).await?,
        };
        let scope = require(&mut self.rig.bench.scope, "scope")?.capabilities();
        if self.scope.verticals[0].is_none() {
            // Those of the controls, whatever the amplitude: a gain belongs to a range.
            self.first_ranges(fixture, eis.amplitude_a, &scope).await?;
        }
        let mut warnings = Vec::new();
        for attempt in 0..=MAX_RANGING {
            if attempt > 0 {
                // The generator may have gone on already, and the ranges are new in any case.
                self.rig.begin(fixture, step);
                driven_s = match self.sweep.taken_ahead(&tone) {
                    None if self.sweep.next.is_none()
                        && self.rig.driving.burst.ends_s.is_infinite() =>
                    {
                        self.rig.clock.now_s()
                    }
                    _ => self.driven(fixture, &tone).await?,
                };
            }
            let mut longer = 0..MOST_LONGER;
            let (waveforms, effective_a) = loop {
                if let Some(taken) = self.capture(eis, &tone, driven_s, fixture).await? {
                    break taken;
                }
                if longer.next().is_none() {
                    return Err(ExecuteError::Signal {
                        freq_hz,
                        reason: "the generator's burst ends before the record does".to_owned(),
                    });
                }
                tracing::debug!(
                    freq_hz,
                    "a longer burst: the record would have outlasted it"
                );
                driven_s = self.driven(fixture, &tone).await?;
            };
            let length_s = waveforms[0].interval_s * waveforms[0].codes.len() as f64;
            let (attempt_in_all, time_s) = (taken + attempt, self.scope.stopped_s - 0.5 * length_s);
            let file = CaptureFile {
                fixture,
                repeat: self.position.repeat,
                index,
                attempt: attempt_in_all,
                freq_hz,
                amplitude_a,
                start_s: self.rig.clock.now_s(),
            };
            self.rig.recorder.capture(&file, &waveforms)?;
            self.rig
                .crest(
                    fixture,
                    &Drawn {
                        waveforms: &waveforms,
                        freq_hz,
                        amplitude_a,
                    },
                )
                .await?;
            let ranged = self.range_again(&waveforms, &scope);
            let clipped = waveforms
                .iter()
                .any(|waveform| waveform.clipped_share() > 0.0);
            if ranged.is_empty() || (attempt == MAX_RANGING && (!clipped || eis.quality.is_some()))
            {
                warnings.extend(ranged);
                let asked = Asked {
                    fixture,
                    index,
                    freq_hz,
                    mains_hz: eis.mains_hz,
                };
                let point = analyse(&asked, &Taken::of(&waveforms), warnings)?;
                let met_a = self.rig.check_current(&point, amplitude_a)?;
                self.rig.agree_with_supply(effective_a, met_a)?;
                return Ok(SweepPoint {
                    time_s,
                    captures: attempt_in_all + 1,
                    ..point
                });
            }
            tracing::info!(
                "{} point {}: measured again: {}",
                fixture_name(fixture),
                index + 1,
                ranged.join("; ")
            );
            warnings.push(format!("measured again: {}", ranged.join("; ")));
        }
        Err(ExecuteError::Signal {
            freq_hz,
            reason: format!("a channel still clips after {MAX_RANGING} changes of range"),
        })
    }

    /// As [`Self::drive`], where the crests are allowed; gives the instant from which on it
    /// settles, bench s.
    async fn driven(&mut self, fixture: Fixture, tone: &Tone) -> Result<f64, ExecuteError> {
        self.headroom(fixture, tone.freq_hz, tone.amplitude_a)?;
        self.rig.drive(tone).await?;
        Ok(self.rig.clock.now_s())
    }

    /// The configured scales, with the cell's voltage brought to the centre of channel 4.
    pub(super) async fn first_ranges(
        &mut self,
        fixture: Fixture,
        amplitude_a: f64,
        scope: &Capabilities,
    ) -> Result<(), ExecuteError> {
        let cell_v = if fixture == Fixture::Cell {
            self.rig.read_supply4q().await?.voltage_v.unwrap_or(0.0)
        } else {
            0.0
        };
        for (slot, channel) in (1..=4_u8).enumerate() {
            let per_div =
                Volts(self.rig.experiment.bench.wiring.scale_per_ampere_v[slot] * amplitude_a);
            let offset = Volts(if channel == 4 { -cell_v } else { 0.0 });
            self.scope.verticals[slot] = Some(Vertical {
                channel,
                per_div: scope.scale_for_offset(per_div, offset),
                offset,
            });
        }
        Ok(())
    }

    /// Sends the settings of the channels that are to change.
    pub(super) async fn apply_verticals(&mut self) -> Result<(), ExecuteError> {
        let error = self.rig.bench.error("scope");
        for (wanted, applied) in self.scope.verticals.iter().zip(&mut self.scope.applied) {
            if let Some(vertical) = wanted.filter(|_| wanted != applied) {
                require(&mut self.rig.bench.scope, "scope")?
                    .set(&Intent::Vertical(vertical))
                    .await
                    .map_err(&error)?;
                *applied = Some(vertical);
            }
        }
        Ok(())
    }

    /// The four channels of a record, and the effective current by the supply's readings until its
    /// end, A; none where the signal has ended, or would end, before it does.
    async fn capture(
        &mut self,
        eis: &Eis,
        tone: &Tone,
        driven_s: f64,
        fixture: Fixture,
    ) -> Result<Option<([Waveform; 4], Option<f64>)>, ExecuteError> {
        self.apply_verticals().await?;
        let screen_s = self
            .arm_screen(Seconds(eis.periods_on_screen / tone.freq_hz))
            .await?;
        let ripe_s = if self.rig.overlaps() {
            self.rig.ripe_s(tone, driven_s, screen_s)
        } else {
            self.rig.clock.now_s() + tone.wait_s
        };
        if self.rig.falls_short(ripe_s) {
            return Ok(None);
        }
        let chosen = if self.rig.overlaps() {
            self.sweep.announce(self.rig.recorder)?;
            let error = self.rig.bench.error("scope");
            let chosen = require(&mut self.rig.bench.scope, "scope")?
                .choose(1, eis.record_points)
                .await
                .map_err(error)?;
            self.watch_until(ripe_s, fixture).await?;
            chosen
        } else {
            self.rig
                .wait_watching(tone.wait_s, ("sine", fixture))
                .await?;
            None
        };
        let error = self.rig.bench.error("scope");
        require(&mut self.rig.bench.scope, "scope")?
            .stop()
            .await
            .map_err(error)?;
        self.scope.stopped_s = self.rig.clock.now_s();
        if self.rig.falls_short(self.scope.stopped_s) {
            return Ok(None);
        }
        let effective_a = self.rig.interlock.effective_a();
        self.go_ahead(fixture).await?;
        let waveforms = self
            .rig
            .fetch_frame((eis.record_points, chosen), fixture)
            .await?;
        self.check_frame(tone.freq_hz, &waveforms, screen_s)?;
        let four = waveforms.try_into().map_err(|_| ExecuteError::Signal {
            freq_hz: tone.freq_hz,
            reason: "not four channels".to_owned(),
        })?;
        Ok(Some((four, effective_a)))
    }

    /// Arms the scope for a span; gives the length of its screen, s.
    async fn arm_screen(&mut self, span: Seconds) -> Result<f64, ExecuteError> {
        let trigger = Trigger {
            channel: TRIGGER_CHANNEL,
            level: self.scope.trigger_v,
        };
        let overlaps = self.rig.overlaps();
        let error = self.rig.bench.error("scope");
        let scope = require(&mut self.rig.bench.scope, "scope")?;
        let (per_div, scope_divisions) = (
            scope.capabilities().time_per_div(span),
            scope.capabilities().horizontal_div,
        );
        // What nobody has touched since the point before is not sent again where points overlap: it
        // would come out of their settling.
        let same = self
            .scope
            .armed
            .replace((per_div, trigger))
            .filter(|_| overlaps);
        let timebase =
            (same.map(|armed| armed.0) != Some(per_div)).then_some(Intent::Timebase(per_div));
        let trigger =
            (same.map(|armed| armed.1) != Some(trigger)).then_some(Intent::Trigger(trigger));
        for intent in timebase.into_iter().chain(trigger).chain([Intent::Arm]) {
            scope.set(&intent).await.map_err(&error)?;
        }
        Ok(per_div.value() * scope_divisions)
    }

    /// The frame must be of this acquisition: as long as the screen, on the scales that were set,
    /// the same for all channels.
    pub(super) fn check_frame(
        &self,
        freq_hz: f64,
        waveforms: &[Waveform],
        screen_s: f64,
    ) -> Result<(), ExecuteError> {
        let fail = |reason: String| Err(ExecuteError::Signal { freq_hz, reason });
        for (waveform, applied) in waveforms.iter().zip(&self.scope.applied) {
            let preamble = &waveform.preamble;
            let length_s = preamble.interval_s * preamble.points as f64;
            if (length_s / screen_s - 1.0).abs() > FRAME_TOLERANCE {
                return fail(format!(
                    "channel {}: expected a frame of {screen_s} s, found one of {length_s} s",
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

    /// New settings for the channels that clipped or were too small, in words; the trigger level
    /// and the offsets follow the signal.
    pub(super) fn range_again(
        &mut self,
        waveforms: &[Waveform; 4],
        scope: &Capabilities,
    ) -> Vec<String> {
        let mut changes = Vec::new();
        for (slot, waveform) in waveforms.iter().enumerate() {
            let Some(vertical) = self.scope.verticals[slot] else {
                continue;
            };
            let (least_v, greatest_v) = waveform.extremes_v();
            if waveform.channel == TRIGGER_CHANNEL {
                self.scope.trigger_v = Volts(0.5 * (greatest_v + least_v));
            }
            let clipped = waveform.clipped_share() > 0.0;
            let Some(changed) = other_range(&vertical, (least_v, greatest_v), clipped, scope)
            else {
                continue;
            };
            let what = if clipped { "clipped" } else { "small" };
            changes.push(format!(
                "channel {} {what} at {} V/div",
                waveform.channel,
                vertical.per_div.value()
            ));
            self.scope.verticals[slot] = Some(changed);
        }
        changes
    }
}

/// Another range for a signal that clipped or is small in its range; none where the range is right,
/// or the finest there is. A signal that lies wholly outside has no span at all, and yet it is not
/// small.
fn other_range(
    vertical: &Vertical,
    (least_v, greatest_v): (f64, f64),
    clipped: bool,
    scope: &Capabilities,
) -> Option<Vertical> {
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

/// Two significant digits, upwards: scopes take any scale, people prefer round ones.
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
            other_range(&vertical, (rail_v, rail_v), true, &scope).map(|vertical| vertical.per_div);
        assert_eq!(wider, Some(Volts(0.04)));
        let swing = |share: f64| (-share * rail_v, share * rail_v);
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
