//! Measures one band of a multisine: the generator receives the wave, the scope rolls over whole
//! periods of it, and the record is converted to one point per line.

use analysis_files::run_folder;
use analysis_signal::{
    multisine::{
        Change, Excited, Line, MultisineFit, analyse, analyse_changing, analyse_played,
        clock_offset, nonlinear, with_distortion,
    },
    spectrum::{ChannelPhasors, ImpedancePoint, PhasorVariance, raw_impedance},
};
use instruments::{
    fixture::Fixture,
    generator::{Sine, Wave},
    scope::{Intent, Trigger, Waveform},
    units::{Amps, Hertz, Ohms, Seconds, Volts},
};

use super::{
    ExecuteError, Executor, Rig, burst::MOST_LONGER, crest::Drawn, record::change_in_words, require,
};
use num_complex::Complex64;

use crate::{
    clock::TypedClock,
    record::{capture_of, code_scale},
};
use bench_plan::{
    measure::{
        HarmonicsAndDrift, SweepPoint,
        channels::{ChannelFault, LoopRequest, find_channel_fault},
        quality::Measures,
    },
    plan::{Band, MAX_RANGING},
};

/// Time for the scope to fill its screen, s.
const FILL_S: Seconds = Seconds(0.05);
/// Standard deviations above which clocks count as different.
const CERTAIN: f64 = 5.0;
/// Phase turn of the fastest line over the record above which it is reported, and above which it
/// is rejected, rad: with 0.3 rad, about two per mille of a line leak into the next but one.
const NOTED_TURN_RAD: f64 = 0.02;
const GREATEST_TURN_RAD: f64 = 0.3;
/// Greatest deviation of a line's current from its command, as a share.
const CURRENT_TOLERANCE: f64 = 0.2;

/// Result of the record of one band.
pub struct BandFit {
    /// One point per line, with the possible effect of distortion in its variance.
    pub phasors: Vec<ChannelPhasors>,
    /// Noise and distortion of each line.
    pub lines: Vec<Line>,
}

impl BandFit {
    fn of(fit: &MultisineFit) -> Self {
        Self {
            phasors: with_distortion(fit),
            lines: nonlinear(fit),
        }
    }
}

/// Converts a record of one band, in volts, to its lines; `changing` under a direct current, where the
/// cell may change over the record. The function is pure: an old record gives the same lines.
///
/// # Errors
/// Fails if the record cannot be analysed.
pub fn fit_band(
    band: &Band,
    channels: [&[f64]; 4],
    interval_s: Seconds,
    changing: bool,
) -> Result<BandFit, ExecuteError> {
    fit_of(band, channels, interval_s, changing).map(|(fit, _)| BandFit::of(&fit))
}

fn fit_of(
    band: &Band,
    channels: [&[f64]; 4],
    interval_s: Seconds,
    changing: bool,
) -> Result<(MultisineFit, Option<Change>), ExecuteError> {
    let fit = if changing {
        analyse_changing(
            channels,
            interval_s.value(),
            excited(band),
            Some(band.steps),
        )
    } else {
        analyse_played(channels, interval_s.value(), excited(band), band.steps)
            .map(|fit| (fit, None))
    };
    fit.map_err(|error| failed(band, error))
}

/// One screen of whole periods.
struct Rolled {
    waveforms: [Waveform; 4],
    /// Bench time of its middle, s.
    middle_s: Seconds,
}

/// Returns the lines of a band.
fn excited(band: &Band) -> Excited<'_> {
    Excited {
        base_hz: band.base_hz.value(),
        harmonics: &band.design.harmonics,
    }
}

impl Rig<'_> {
    async fn play_wave(&mut self, band: &Band) -> Result<(), ExecuteError> {
        let offset_v = self.offset_v(self.driving.bias.commanded_a);
        let wiring = &self.setup.wiring;
        let sine = Sine {
            freq: band.base_hz,
            amplitude: wiring.command_v(band.peak_a).abs(),
            offset: offset_v,
        };
        let wave = Wave::named("eis", band.design.samples(band.steps), sine);
        let error = self.bench.error("generator");
        let generator = require(&mut self.bench.instruments.generator, "generator")?;
        // A wave is loaded while the least sine is active: at most the direct current flows.
        generator.quiet(wave.offset).await.map_err(&error)?;
        generator.wave(&wave).await.map_err(error)?;
        self.no_burst();
        Ok(())
    }

    fn lines(
        &mut self,
        band: &Band,
        rolled: &Rolled,
        first: usize,
        captures: usize,
        mut warnings: Vec<String>,
    ) -> Result<Vec<(SweepPoint, Line)>, ExecuteError> {
        let waveforms = &rolled.waveforms;
        let volts = waveforms.each_ref().map(|waveform| {
            let scale = code_scale(waveform);
            waveform
                .codes
                .iter()
                .map(|code| scale.volts(*code))
                .collect::<Vec<f64>>()
        });
        let excited = excited(band);
        let (channels, interval_s) = (volts.each_ref().map(Vec::as_slice), waveforms[0].interval_s);
        warnings.extend(self.judge_clocks(band, clock_offset(channels, interval_s, excited))?);
        let (fit, change) = fit_of(
            band,
            channels,
            Seconds(interval_s),
            self.driving.bias.is_on(),
        )?;
        warnings.extend(judge_images(&fit));
        warnings.extend(greatest(change.as_ref()).map(change_in_words));
        let commanded_a = band.design.amplitude * band.peak_a;
        for phasors in &fit.excited {
            self.check_loop(phasors, commanded_a)?;
            self.check_line(phasors, commanded_a)?;
        }
        let BandFit {
            phasors,
            lines: found,
        } = BandFit::of(&fit);
        let clipped = waveforms
            .iter()
            .map(Waveform::clipped_share)
            .fold(0.0, f64::max);
        let halves = halves(channels, interval_s, excited);
        let measures = |k: usize| {
            let (noise, line) = (noise_share(&fit.excited[k]), &found[k]);
            let repeatability = halves.as_ref().map(|halves| halves[k]);
            Measures {
                clipped,
                noise,
                distortion: (line.even.max(line.odd), line.sigma),
                drift: drift_share(&fit.excited[k]),
                repeatability,
            }
            .less_change(
                change
                    .as_ref()
                    .and_then(|change| change.relative.get(k).copied()),
            )
        };
        let last_degc = self.temperatures.last_degc;
        let conditions = self.driving.bias.conditions(rolled.middle_s, last_degc);
        let (time_s, volts_per_div) = (
            self.clock.now(),
            waveforms
                .each_ref()
                .map(|waveform| waveform.preamble.volts_per_div),
        );
        let point = |(k, phasors): (usize, &ChannelPhasors)| SweepPoint {
            fixture: Fixture::Cell,
            index: first + k,
            phasors: *phasors,
            volts_per_div,
            free_freq_hz: Hertz(phasors.freq_hz),
            residual_lag1: 0.0,
            harmonics_and_drift: HarmonicsAndDrift::default(),
            warnings: if k == 0 { warnings.clone() } else { Vec::new() },
            time_s,
            captures,
            rechecked: 0,
            spent: bench_plan::measure::Spent::default(),
            measures: measures(k),
            failing: Vec::new(),
            conditions,
        };
        Ok(phasors
            .iter()
            .enumerate()
            .map(point)
            .zip(found.iter().copied())
            .collect())
    }

    /// Checks that generator and scope run on one clock, as a multisine requires. A difference of
    /// their clocks turns the fastest line over the record, so that lines leak into each other: a
    /// small turn is reported, a large one is rejected.
    fn judge_clocks(
        &self,
        band: &Band,
        found: Option<(f64, f64)>,
    ) -> Result<Option<String>, ExecuteError> {
        let Some((offset, sigma)) = found.filter(|(offset, sigma)| offset.abs() > CERTAIN * sigma)
        else {
            return Ok(None);
        };
        let fastest_hz = band
            .design
            .harmonics
            .last()
            .map_or(Hertz::ZERO, |harmonic| *harmonic as f64 * band.base_hz);
        let turn_rad = std::f64::consts::TAU * fastest_hz * band.span_s * offset.abs();
        let message = format!(
            "the generator's clock runs {:+.1} ± {:.1} ppm against the scope's: the fastest line \
            turns by {turn_rad:.3} rad over the record",
            1.0e6 * offset,
            1.0e6 * sigma
        );
        if turn_rad > GREATEST_TURN_RAD {
            return Err(failed(
                band,
                format!(
                    "{message}, expected at most {GREATEST_TURN_RAD} rad: connect their 10 MHz \
                    references, or shorten the record"
                ),
            ));
        }
        Ok((turn_rad > NOTED_TURN_RAD).then_some(message))
    }

    /// Checks that the channels at a line can belong to one loop.
    fn check_loop(&self, phasors: &ChannelPhasors, amplitude_a: Amps) -> Result<(), ExecuteError> {
        let request = LoopRequest {
            fixture: Fixture::Cell,
            shunt_ohm: self.setup.wiring.shunt.r_ohm,
            amplitude_a: amplitude_a.value(),
            controls: &[],
        };
        find_channel_fault(phasors, &request).map_or(Ok(()), |ChannelFault { found, cause }| {
            Err(ExecuteError::Channels {
                freq_hz: Hertz(phasors.freq_hz),
                found,
                cause,
            })
        })
    }

    fn check_line(&self, phasors: &ChannelPhasors, amplitude_a: Amps) -> Result<(), ExecuteError> {
        let met_v = Volts((phasors.volts[1] - phasors.volts[0]).norm());
        let met_a = met_v / Ohms(self.setup.wiring.shunt.r_ohm);
        if (met_a / amplitude_a - 1.0).abs() <= CURRENT_TOLERANCE {
            return Ok(());
        }
        Err(ExecuteError::Disobeyed {
            what: format!("current of the line at {} Hz", phasors.freq_hz),
            expected: format!(
                "an amplitude of {amplitude_a:.4} within {:.0} %",
                100.0 * CURRENT_TOLERANCE
            ),
            met: format!("{met_a:.4}"),
        })
    }
}

impl Executor<'_> {
    /// Drives and records one band; `first` lines of other bands precede it and `taken` records of
    /// it exist already. Returns a point per line, and noise and distortion of each line.
    pub(super) async fn multisine(
        &mut self,
        band: &Band,
        first: usize,
        taken: usize,
    ) -> Result<Vec<(SweepPoint, Line)>, ExecuteError> {
        self.headroom(Fixture::Cell, band.base_hz, band.peak_a)?;
        self.rig.play_wave(band).await?;
        let scope = require(&mut self.rig.bench.instruments.scope, "scope")?.capabilities();
        if self.scope.verticals[0].is_none() {
            self.first_ranges(Fixture::Cell, band.peak_a, &scope)
                .await?;
        }
        let mut warnings = Vec::new();
        for attempt in 0..=MAX_RANGING {
            let rolled = self.settled_roll(band, attempt, taken).await?;
            let waveforms = &rolled.waveforms;
            let drawn = Drawn {
                waveforms,
                freq_hz: band.base_hz,
                amplitude_a: band.peak_a,
            };
            self.rig.crest(Fixture::Cell, &drawn).await?;
            let ranged = self.scope.range_again(waveforms, &scope);
            let clipped = waveforms
                .iter()
                .any(|waveform| waveform.clipped_share() > 0.0);
            if ranged.is_empty() || (attempt == MAX_RANGING && !clipped) {
                warnings.extend(ranged);
                if self.rig.driving.bias.is_on() {
                    self.scope.follow(&waveforms[3]);
                }
                return self
                    .rig
                    .lines(band, &rolled, first, taken + attempt + 1, warnings);
            }
            warnings.push(format!("measured again: {}", ranged.join("; ")));
        }
        Err(failed(
            band,
            format!("a channel still clips after {MAX_RANGING} changes of range"),
        ))
    }

    /// Takes one record of the settled wave. Restarts the wave if it would have ended in the
    /// meantime.
    async fn settled_roll(
        &mut self,
        band: &Band,
        attempt: usize,
        taken: usize,
    ) -> Result<Rolled, ExecuteError> {
        let needed_s = band.settle_s + band.span_s + FILL_S;
        for longer in 0..=MOST_LONGER {
            // A signal without an end continues, and has settled.
            if attempt + longer == 0 || self.rig.driving.burst.ends_s.is_finite() {
                self.rig.begin_signal(band.base_hz, needed_s).await?;
                self.rig
                    .wait_watching(band.settle_s, "sine", Fixture::Cell)
                    .await?;
            }
            if let Some(rolled) = self.roll(band, taken + attempt).await? {
                return Ok(rolled);
            }
        }
        Err(failed(
            band,
            "the generator's burst ends before the record does",
        ))
    }

    /// Records one screen of whole periods, which is on disk when this returns. Returns nothing if
    /// the signal has ended, or would end, before the record does.
    async fn roll(&mut self, band: &Band, attempt: usize) -> Result<Option<Rolled>, ExecuteError> {
        self.scope.apply(self.rig.bench).await?;
        let error = self.rig.bench.error("scope");
        let level = self.scope.out_of_reach();
        let scope = require(&mut self.rig.bench.instruments.scope, "scope")?;
        let per_div = scope.capabilities().time_per_div(band.span_s);
        let memory_points = band.memory_points;
        let intents = [
            Intent::Session { memory_points },
            Intent::Timebase(per_div),
            Intent::Trigger(Trigger { channel: 2, level }),
            Intent::Roll,
        ];
        for intent in intents {
            scope.set(&intent).await.map_err(&error)?;
        }
        self.scope.memory_points = Some(memory_points);
        if self
            .rig
            .falls_short(self.rig.clock.now() + band.span_s + FILL_S)
        {
            return Ok(None);
        }
        self.rig
            .wait_watching(band.span_s + FILL_S, "sine", Fixture::Cell)
            .await?;
        let end_s = self.rig.clock.now();
        require(&mut self.rig.bench.instruments.scope, "scope")?
            .stop()
            .await
            .map_err(&error)?;
        if self.rig.falls_short(self.rig.clock.now()) {
            return Ok(None);
        }
        let mut waveforms = Vec::with_capacity(4);
        for channel in 1..=4 {
            waveforms.push(
                require(&mut self.rig.bench.instruments.scope, "scope")?
                    .download(channel, band.record_points)
                    .await
                    .map_err(&error)?,
            );
            self.rig.watch("multisine", Fixture::Cell).await?;
        }
        self.scope
            .check_frame(band.base_hz, &waveforms, band.span_s)?;
        let waveforms: [Waveform; 4] = waveforms
            .try_into()
            .map_err(|_| failed(band, "not four channels"))?;
        let label = format!(
            "multisine {} repeat {} attempt {}",
            band.number,
            self.position.repeat,
            attempt + 1
        );
        let capture = capture_of(
            label,
            band.base_hz.value(),
            (end_s - band.span_s).value(),
            &waveforms,
        );
        self.rig.recorder.write_capture(
            &run_folder::multisine_captures(self.position.repeat),
            &run_folder::band_capture(band.number, attempt),
            &capture,
        )?;
        Ok(Some(Rolled {
            waveforms,
            middle_s: end_s - 0.5 * band.span_s,
        }))
    }
}

/// Returns a message if the record does not contain the images of the generator's steps at the
/// frequencies that follow from the rates.
fn judge_images(fit: &MultisineFit) -> Option<String> {
    let proof = fit
        .proof
        .filter(analysis_signal::multisine::Proof::contradicts)?;
    let missing = format!(
        "{} of {} images of the generator's steps are not where the rates put them",
        proof.missing, proof.predicted
    );
    let strange = format!(
        "{} lines are not images, the strongest at {:.3} Hz with {:.0} standard deviations of the \
        noise",
        proof.strange, proof.strange_hz, proof.strange_sigmas
    );
    Some(format!(
        "{missing}; {strange}: the images on the measured lines are not known"
    ))
}

/// Returns the change of the line that changes most, relative to its impedance.
fn greatest(change: Option<&Change>) -> Option<Complex64> {
    let all = change?.relative.iter().copied();
    all.max_by(|a, b| a.norm().total_cmp(&b.norm()))
}

/// Returns the possible error of Z due to a change that is not straight, relative to |Z|.
fn drift_share(phasors: &ChannelPhasors) -> f64 {
    let only = phasors.variance.map(|all| PhasorVariance {
        noise: all.drift,
        ..PhasorVariance::circular(0.0)
    });
    let drift = ChannelPhasors {
        variance: only,
        ..*phasors
    };
    noise_share(&drift)
}

/// Returns the standard deviation of Z due to noise, relative to |Z|.
fn noise_share(phasors: &ChannelPhasors) -> f64 {
    let point = raw_impedance(phasors, 1.0);
    (0.5 * (point.covariance.re_re + point.covariance.im_im)).sqrt() / point.magnitude_ohm()
}

/// Returns for each line the difference of Z between the first and the second half of the record,
/// relative to |Z|, and the part of it that noise explains. Returns nothing if a half has too few
/// periods.
fn halves(channels: [&[f64]; 4], interval_s: f64, excited: Excited<'_>) -> Option<Vec<(f64, f64)>> {
    let count = channels[0].len();
    let periods = (count as f64 * interval_s * excited.base_hz).round();
    let length = ((0.5 * periods).floor() / (excited.base_hz * interval_s)).round() as usize;
    let part = |from: usize| {
        let fit = analyse(
            channels.map(|samples| &samples[from..from + length]),
            interval_s,
            excited,
        )
        .ok()?;
        Some(
            fit.excited
                .iter()
                .map(|phasors| raw_impedance(phasors, 1.0))
                .collect::<Vec<_>>(),
        )
    };
    let (first, second) = (part(0)?, part(count.checked_sub(length)?)?);
    let of = |(a, b): (&ImpedancePoint, &ImpedancePoint)| {
        let (scale, both) = (
            0.5 * (a.z_ohm.norm() + b.z_ohm.norm()),
            a.covariance + b.covariance,
        );
        (
            (a.z_ohm - b.z_ohm).norm() / scale,
            (both.re_re + both.im_im).sqrt() / scale,
        )
    };
    Some(first.iter().zip(&second).map(of).collect())
}

fn failed(band: &Band, reason: impl std::fmt::Display) -> ExecuteError {
    ExecuteError::Signal {
        freq_hz: band.base_hz,
        reason: format!("multisine {}: {reason}", band.number),
    }
}
