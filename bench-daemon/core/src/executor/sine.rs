//! Measures one sinusoid: drives it, waits, captures, and analyses. If a channel clipped or its
//! signal was too small, changes its range.

use instruments::{
    fixture::Fixture,
    generator::Sine,
    scope::{Capabilities, Chosen, Waveform},
    units::{Amps, Hertz, Seconds, Volts},
};

use super::{
    ExecuteError, Executor, Rig,
    burst::MOST_LONGER,
    crest::Drawn,
    point_overlap::Tone,
    record::{ChannelRecord, PointRequest, analyse, check_channels},
    require,
    watch::drawn,
};
use crate::{clock::TypedClock, record::CaptureFile};
use bench_plan::{
    measure::SweepPoint,
    plan::{MAX_RANGING, Step, SweepSettings, fixture_name},
};

/// Greatest relative shortfall of the current amplitude against its command: at the end of its
/// band a supply loses a seventh.
const CURRENT_TOLERANCE: f64 = 0.2;

impl Rig<'_> {
    /// Sets the generator so that the supply drives `amplitude_a`, for at least `wait_s`.
    pub(super) async fn drive(&mut self, tone: &Tone) -> Result<(), ExecuteError> {
        // The polarity of a sinusoid is its phase, which starts anywhere.
        let amplitude = self.setup.wiring.command_v(tone.amplitude_a).abs();
        let sine = Sine {
            freq: tone.freq_hz,
            amplitude,
            offset: self.offset_v(self.driving.bias.commanded_a),
        };
        let error = self.bench.error("generator");
        require(&mut self.bench.instruments.generator, "generator")?
            .sine(&sine)
            .await
            .map_err(error)?;
        self.begin_signal(tone.freq_hz, tone.wait_s).await
    }

    /// Downloads the four channels of the stopped frame.
    async fn fetch_frame(
        &mut self,
        settings: &SweepSettings,
        chosen: Option<Chosen>,
        fixture: Fixture,
    ) -> Result<Vec<Waveform>, ExecuteError> {
        let (overlaps, error) = (self.overlaps(settings), self.bench.error("scope"));
        let points = settings.record_points;
        let mut waveforms: Vec<Waveform> = Vec::with_capacity(4);
        for channel in 1..=4 {
            let scope = require(&mut self.bench.instruments.scope, "scope")?;
            let waveform = match (waveforms.last().filter(|_| overlaps), chosen) {
                (Some(before), _) => scope.download_beside(channel, points, before).await,
                (None, Some(chosen)) => scope.download_chosen(chosen, points).await,
                (None, None) if overlaps => scope.download_again(channel, points).await,
                (None, None) => scope.download(channel, points).await,
            };
            waveforms.push(waveform.map_err(&error)?);
            // The current still flows: a download must not interrupt the watching.
            self.watch_between(settings, fixture).await?;
        }
        Ok(waveforms)
    }

    /// Checks that the current follows the command: this detects a loose lead or a supply at its
    /// limits. Returns its amplitude, A.
    fn check_current(&self, point: &SweepPoint, amplitude_a: Amps) -> Result<Amps, ExecuteError> {
        let [first, second, _, _] = point.phasors.volts;
        let met_a = (second - first).norm() / self.setup.wiring.shunt.r_ohm;
        let (least_a, greatest_a) = ((1.0 - CURRENT_TOLERANCE) * amplitude_a, drawn(amplitude_a));
        if (least_a..=greatest_a).contains(&Amps(met_a)) {
            return Ok(Amps(met_a));
        }
        Err(ExecuteError::Disobeyed {
            what: format!("current at {} Hz", point.phasors.freq_hz),
            expected: format!("an amplitude from {least_a:.3} to {greatest_a:.3}"),
            met: format!("{met_a:.4} A"),
        })
    }
}

impl Executor<'_> {
    /// Drives, captures and analyses one point; `taken` records of it exist already.
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
            ref settings,
        } = *step
        else {
            return Err(ExecuteError::Signal {
                freq_hz: Hertz::ZERO,
                reason: "not a sine step".to_owned(),
            });
        };
        let tone = Tone {
            freq_hz,
            amplitude_a,
            wait_s,
        };
        let mut driven_s = match self.sweep.take_started(&tone) {
            Some(since_s) => since_s,
            None => {
                self.measure_zero(fixture, settings).await?;
                self.driven(fixture, &tone).await?
            }
        };
        let scope = require(&mut self.rig.bench.instruments.scope, "scope")?.capabilities();
        if self.scope.verticals[0].is_none() {
            // Use the ranges of the controls for any amplitude: a gain belongs to a range.
            self.first_ranges(fixture, settings.amplitude_a, &scope)
                .await?;
        }
        let mut warnings = Vec::new();
        for attempt in 0..=MAX_RANGING {
            if attempt > 0 {
                // The generator may already drive the next point, and the ranges are new in any
                // case.
                self.rig.begin(fixture, step);
                driven_s = match self.sweep.take_started(&tone) {
                    None if self.sweep.next.is_none()
                        && self.rig.driving.burst.ends_s.value().is_infinite() =>
                    {
                        self.rig.clock.now()
                    }
                    _ => self.driven(fixture, &tone).await?,
                };
            }
            let mut longer = 0..MOST_LONGER;
            let (waveforms, effective_a) = loop {
                if let Some(taken) = self.capture(settings, &tone, driven_s, fixture).await? {
                    break taken;
                }
                if longer.next().is_none() {
                    return Err(ExecuteError::Signal {
                        freq_hz,
                        reason: "the generator's burst ends before the record does".to_owned(),
                    });
                }
                tracing::debug!(
                    freq_hz = freq_hz.value(),
                    "a longer burst: the record would have outlasted it"
                );
                driven_s = self.driven(fixture, &tone).await?;
            };
            let length_s = waveforms[0].interval_s * waveforms[0].codes.len() as f64;
            let (attempt_in_all, time_s) = (
                taken + attempt,
                self.scope.stopped_s - Seconds(0.5 * length_s),
            );
            let file = CaptureFile {
                fixture,
                repeat: self.position.repeat,
                index,
                attempt: attempt_in_all,
                freq_hz: freq_hz.value(),
                amplitude_a: amplitude_a.value(),
                start_s: self.rig.clock.now().value(),
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
            let ranged = self.scope.range_again(&waveforms, &scope);
            let clipped = waveforms
                .iter()
                .any(|waveform| waveform.clipped_share() > 0.0);
            if ranged.is_empty()
                || (attempt == MAX_RANGING && (!clipped || settings.quality.is_some()))
            {
                warnings.extend(ranged);
                let request = PointRequest {
                    fixture,
                    index,
                    freq_hz: freq_hz.value(),
                    mains_hz: settings.mains_hz.map(Hertz::value),
                    amplitude_a: amplitude_a.value(),
                    shunt_ohm: self.rig.setup.wiring.shunt.r_ohm,
                };
                let point = analyse(&request, &ChannelRecord::of(&waveforms), warnings)?;
                check_channels(&point, &request, &self.known.controls)?;
                let met_a = self.rig.check_current(&point, amplitude_a)?;
                self.rig.cross_check_supply(effective_a, met_a)?;
                let last_degc = self.rig.temperatures.last_degc;
                let conditions = self.rig.driving.bias.conditions(time_s, last_degc);
                if conditions.is_some() {
                    self.scope.follow(&waveforms[3]);
                }
                return Ok(SweepPoint {
                    time_s,
                    captures: attempt_in_all + 1,
                    conditions,
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

    /// As [`Rig::drive`], if the crests are allowed; returns the time from which it settles, bench
    /// s.
    async fn driven(&mut self, fixture: Fixture, tone: &Tone) -> Result<Seconds, ExecuteError> {
        self.headroom(fixture, tone.freq_hz, tone.amplitude_a)?;
        self.rig.drive(tone).await?;
        Ok(self.rig.clock.now())
    }

    /// Sets the configured scales, with the cell's voltage in the centre of channel 4.
    pub(super) async fn first_ranges(
        &mut self,
        fixture: Fixture,
        amplitude_a: Amps,
        scope: &Capabilities,
    ) -> Result<(), ExecuteError> {
        let cell_v = if fixture == Fixture::Cell {
            self.rig
                .read_supply4q()
                .await?
                .voltage_v
                .unwrap_or(Volts::ZERO)
        } else {
            Volts::ZERO
        };
        let per_div_v = self
            .rig
            .setup
            .wiring
            .scale_per_ampere_v
            .map(|scale_v| Volts(scale_v * amplitude_a.value()));
        self.scope.centre(per_div_v, cell_v, scope);
        Ok(())
    }

    /// Returns the four channels of a record, and the effective current from the supply's readings
    /// up to its end, A. Returns nothing if the signal has ended, or would end, before the record
    /// does.
    async fn capture(
        &mut self,
        settings: &SweepSettings,
        tone: &Tone,
        driven_s: Seconds,
        fixture: Fixture,
    ) -> Result<Option<([Waveform; 4], Option<Amps>)>, ExecuteError> {
        self.scope.apply(self.rig.bench).await?;
        let span = settings.periods_on_screen / tone.freq_hz;
        let overlaps = self.rig.overlaps(settings);
        let screen_s = self.scope.arm(self.rig.bench, span, overlaps).await?;
        let settled_at_s = if overlaps {
            self.rig.settled_at_s(tone, driven_s, screen_s)
        } else {
            self.rig.clock.now() + tone.wait_s
        };
        if self.rig.falls_short(settled_at_s) {
            return Ok(None);
        }
        let chosen = if overlaps {
            self.sweep.announce(self.rig.recorder)?;
            let error = self.rig.bench.error("scope");
            let chosen = require(&mut self.rig.bench.instruments.scope, "scope")?
                .choose(1, settings.record_points)
                .await
                .map_err(error)?;
            self.watch_until(settled_at_s, fixture).await?;
            chosen
        } else {
            self.rig.wait_watching(tone.wait_s, "sine", fixture).await?;
            None
        };
        let error = self.rig.bench.error("scope");
        require(&mut self.rig.bench.instruments.scope, "scope")?
            .stop()
            .await
            .map_err(error)?;
        self.scope.stopped_s = self.rig.clock.now();
        if self.rig.falls_short(self.scope.stopped_s) {
            return Ok(None);
        }
        let effective_a = self.rig.interlock.effective_a();
        self.start_next_point(fixture).await?;
        let waveforms = self.rig.fetch_frame(settings, chosen, fixture).await?;
        self.scope.check_frame(tone.freq_hz, &waveforms, screen_s)?;
        let four = waveforms.try_into().map_err(|_| ExecuteError::Signal {
            freq_hz: tone.freq_hz,
            reason: "not four channels".to_owned(),
        })?;
        Ok(Some((four, effective_a)))
    }
}
