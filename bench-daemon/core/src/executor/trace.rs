//! Executes a current trace: the generator's offset commands steps of direct current through the
//! bipolar supply, and the scope records frames around them.
//!
//! First the zeros of the channels, read without a current, are subtracted. The correction of the
//! harness then gives current and voltage. The voltmeter at the jig gives the voltage at rest,
//! from which the change of voltage is measured.

use std::ops::RangeInclusive;

use analysis_effects::augmented::Between;
use analysis_files::{
    dataset::{Capture, Commanded, CurrentPositive, TraceEntry, TraceRow},
    run_folder,
};
use instruments::{
    fixture::Fixture,
    scope::{Intent, Trigger, Waveform},
    units::{Amps, Celsius, Coulombs, Hertz, Seconds, Volts},
};

use super::{
    ExecuteError, Executor, POLL_S, Rig, require,
    state::Zero,
    trace_rows::{Frames, Recorded, zeros},
};
use crate::{clock::TypedClock, record::capture_of};
use bench_plan::{
    interlock::{self, Reading},
    plan::{Frame, Level, Through, TracePlan},
};

/// Number of voltmeter readings whose mean is the voltage at rest.
const REST_READINGS: usize = 10;
/// Seconds between two readings of a resting cell.
const REST_POLL_S: Seconds = Seconds(10.0);
/// The frame that shows the zeros.
const ZERO_FRAME: Frame = Frame {
    start_s: Seconds::ZERO,
    span_s: Seconds(1.0),
    memory_points: 10_000,
    record_points: 10_000,
};
/// Time for the scope to fill its screen, s.
const FILL_S: Seconds = Seconds(0.05);
/// Time before an action of the trace in which no reading is started, s: it would delay the
/// action.
const QUIET_S: Seconds = Seconds(0.4);
/// Share of a frame that may clip: the loop's inductance responds to a step with a spike, which no
/// row includes.
const SPIKES: f64 = 1.0e-4;
/// Share of a wave's frame that may clip; a wave has many steps.
const WAVE_SPIKES: f64 = 0.02;
/// Greatest deviation of the current from its command, as a share and in A.
const FOLLOWS: (f64, Amps) = (0.1, Amps(0.3));
/// Least current for which the vertical scales are set, A.
const LEAST_SCALE_A: Amps = Amps(0.5);

/// Action at one time of a trace.
#[derive(Debug, Clone, Copy)]
enum Action {
    Arm(Frame),
    Level(Level),
    Fetch(Frame),
}

impl Rig<'_> {
    /// Watches the cell while nothing flows.
    pub(super) async fn pause(&mut self, span_s: Seconds) -> Result<(), ExecuteError> {
        let end_s = self.clock.now() + span_s;
        while self.clock.now() < end_s {
            self.clock
                .sleep_for(REST_POLL_S.min(end_s - self.clock.now()))
                .await;
            self.handle_request_within_step()?;
            self.glance("rest").await?;
        }
        Ok(())
    }

    /// Takes one reading of the cell, by the bipolar supply if there is one.
    pub(super) async fn glance(&mut self, phase: &str) -> Result<Reading, ExecuteError> {
        if self.bench.instruments.supply4q.is_some() {
            return self.watch(phase, Fixture::Cell).await;
        }
        let (volts, drawn_a) = self.load_volts().await?;
        let temperature_degc = self.temperature_now_and_then().await?;
        let reading = Reading {
            time_s: self.clock.now(),
            voltage_v: Some(volts),
            current_a: Some(-drawn_a),
            temperature_degc,
        };
        self.judge(phase, reading)?;
        Ok(reading)
    }

    /// Waits while reading and judging every second. If steps follow each other so fast that a
    /// reading would delay the next one, every second reading may be postponed, but no more: a
    /// late step is recorded with its actual time, whereas a cell that is not watched may catch
    /// fire.
    async fn wait_until(&mut self, until_s: Seconds) -> Result<(), ExecuteError> {
        loop {
            let (left_s, age_s) = (
                until_s - self.clock.now(),
                self.clock.now() - self.watching.watched_s,
            );
            if left_s <= POLL_S + QUIET_S {
                if age_s >= 2.0 * POLL_S || (age_s >= POLL_S && left_s > QUIET_S) {
                    self.watch("trace", Fixture::Cell).await?;
                }
                self.clock.sleep_for(until_s - self.clock.now()).await;
                return Ok(());
            }
            self.clock.sleep_for(POLL_S).await;
            self.watch("trace", Fixture::Cell).await?;
        }
    }

    /// Returns the present voltage at the jig, V. A value that is not a number is an error,
    /// because no power follows from it.
    async fn jig_volts(&mut self) -> Result<Volts, ExecuteError> {
        Ok(self
            .watch("trace", Fixture::Cell)
            .await?
            .voltage_v
            .unwrap_or(Volts::INFINITY))
    }

    /// Stops the scope; returns when, bench s.
    pub(super) async fn freeze(&mut self) -> Result<Seconds, ExecuteError> {
        let error = self.bench.error("scope");
        let end_s = self.clock.now();
        require(&mut self.bench.instruments.scope, "scope")?
            .stop()
            .await
            .map_err(&error)?;
        Ok(end_s)
    }

    /// Commands a direct current, A, charge positive.
    pub(super) async fn command(&mut self, current_a: Amps) -> Result<(), ExecuteError> {
        let offset = self.offset_v(current_a);
        let error = self.bench.error("generator");
        let generator = require(&mut self.bench.instruments.generator, "generator")?;
        Ok(generator.direct(offset).await.map_err(error)?)
    }

    /// Returns rows of the scope, each judged as any reading and compared with its command.
    pub(super) fn judged(
        &self,
        trace: &TracePlan,
        mut found: Recorded,
    ) -> Result<Recorded, ExecuteError> {
        for (row, level_a) in found.rows.iter_mut().zip(&found.levels_a) {
            let reading = Reading {
                time_s: Seconds(row.time_s),
                voltage_v: Some(Volts(row.voltage_v)),
                current_a: Some(Amps(row.current_a)),
                temperature_degc: None,
            };
            if let Some(trip) = interlock::judge(self.interlock.limits(), &reading) {
                return Err(trip.into());
            }
            obeys(&trace.name, Amps(*level_a), row)?;
            row.temperature_degc = self.temperatures.last_degc.unwrap_or(Celsius::NAN).value();
        }
        // The existing rows were judged first: an exceeded limit outweighs an incomplete record.
        match &found.missing {
            Some((expected, measured)) => Err(disobeyed(&trace.name, expected, measured)),
            None => Ok(found),
        }
    }
}

impl Executor<'_> {
    /// Rests, then measures the cell while nothing flows.
    pub(super) async fn zero(&mut self, trace: &TracePlan) -> Result<(), ExecuteError> {
        self.rig.pause(trace.rest_s).await?;
        let mut resting = Vec::with_capacity(REST_READINGS);
        for _ in 0..REST_READINGS {
            let reading = self.rig.glance("rest").await?;
            resting.push((
                reading.voltage_v.unwrap_or(Volts::NAN),
                reading.current_a.unwrap_or(Amps::NAN),
            ));
        }
        let ocv_v = resting.iter().map(|reading| reading.0).sum::<Volts>() / REST_READINGS as f64;
        let temperature_degc = self.rig.cell_temperature().await?;
        self.rig.judge(
            "rest",
            Reading {
                time_s: self.rig.clock.now(),
                voltage_v: Some(ocv_v),
                temperature_degc,
                ..Reading::default()
            },
        )?;
        let (low, high) = trace.start_v;
        if !(low..=high).contains(&ocv_v) {
            if self.point().is_some() {
                self.leave_out_pulses(ocv_v, low..=high);
                return Ok(());
            }
            return Err(ExecuteError::Disobeyed {
                what: format!("cell before trace {}", trace.name),
                expected: format!("{low} to {high} at rest"),
                met: format!("{ocv_v:.4}"),
            });
        }
        let scatter = (
            scatter(resting.iter().map(|reading| reading.0.value())),
            scatter(resting.iter().map(|reading| reading.1.value())),
        );
        if !trace.bipolar() {
            self.direct.zero = Some(Zero {
                volts: [Volts::ZERO; 4],
                ocv_v,
                scatter,
                temperature_degc,
            });
            return Ok(());
        }
        self.trace_ranges(trace, ocv_v);
        self.arm(&ZERO_FRAME).await?;
        self.rig.clock.sleep_for(ZERO_FRAME.span_s + FILL_S).await;
        let capture = self
            .fetch(&ZERO_FRAME, trace, run_folder::ZERO_FRAME)
            .await?;
        let Some(volts) = zeros(&capture) else {
            return Err(disobeyed(
                &trace.name,
                "a frame of the zeros",
                "an empty one",
            ));
        };
        self.direct.zero = Some(Zero {
            volts: volts.map(Volts),
            ocv_v,
            scatter,
            temperature_degc,
        });
        Ok(())
    }

    /// Leaves out the pulses of a point whose voltage at rest is not the one for which they are known
    /// to stay within the limits of the cell.
    fn leave_out_pulses(&mut self, ocv_v: Volts, band_v: RangeInclusive<Volts>) {
        let (low_v, high_v) = band_v.into_inner();
        let text = format!(
            "pulses left out: expected {low_v} to {high_v} at rest, found {ocv_v:.4}, from \
            which they could exceed the limits of the cell"
        );
        let text = self.of_run(&text);
        self.rig.recorder.warning(&text);
        self.direct.reset.accepted = true;
    }

    /// Drives and records a trace.
    pub(super) async fn trace(&mut self, trace: &TracePlan) -> Result<(), ExecuteError> {
        let Some(zero) = self.direct.zero.take() else {
            return Err(disobeyed(&trace.name, "the zeros of the channels", "none"));
        };
        if let Some(averaged) = trace.averaged {
            self.rig
                .recorder
                .warning(&format!("trace {}: {averaged}", trace.name));
        }
        match trace.through {
            Through::Bipolar => self.step_by_step(trace, zero).await,
            Through::Wave { step_s, steps } => {
                self.wave_trace(trace, zero, step_s.value(), steps).await
            }
            Through::LoadAndSupply => self.load_and_supply(trace, zero).await,
        }
    }

    async fn step_by_step(&mut self, trace: &TracePlan, zero: Zero) -> Result<(), ExecuteError> {
        let mut actions: Vec<(Seconds, Action)> = trace
            .levels
            .iter()
            .map(|level| (level.at_s, Action::Level(*level)))
            .collect();
        for frame in &trace.frames {
            actions.push((frame.start_s, Action::Arm(*frame)));
            actions.push((frame.start_s + frame.span_s, Action::Fetch(*frame)));
        }
        actions.sort_by(|a, b| a.0.total_cmp(&b.0));
        let origin_s = self.rig.clock.now();
        let mut commanded: Vec<(f64, f64)> = vec![(origin_s.value(), 0.0)];
        let mut recorded = Recorded::default();
        let mut filled_s = origin_s;
        for (at_s, action) in actions {
            self.rig.wait_until(origin_s + at_s).await?;
            match action {
                Action::Arm(frame) => {
                    self.arm(&frame).await?;
                    filled_s = self.rig.clock.now() + frame.span_s + FILL_S;
                }
                Action::Level(level) => {
                    let current_a = if level.power_w.is_some() {
                        level.at_a(self.rig.jig_volts().await?)
                    } else {
                        level.current_a
                    };
                    commanded.push((self.rig.clock.now().value(), current_a.value()));
                    self.rig.command(current_a).await?;
                }
                Action::Fetch(frame) => {
                    self.rig.wait_until(filled_s).await?;
                    let name = format!("frame{:03}", recorded.frames + 1);
                    let capture = self.fetch(&frame, trace, &name).await?;
                    let found = self.frames(trace, &zero).of_frame(&capture, &commanded);
                    recorded.append(self.rig.judged(trace, found)?);
                }
            }
        }
        self.finish_trace(
            trace,
            &zero,
            origin_s,
            recorded,
            Some(Commanded::Steps(commanded)),
        )
    }

    /// Sets scales that hold the whole trace, with the cell's voltage at rest in the centre of
    /// channel 4.
    fn trace_ranges(&mut self, trace: &TracePlan, ocv_v: Volts) {
        let Some(scope) = self
            .rig
            .bench
            .instruments
            .scope
            .as_ref()
            .map(|scope| scope.capabilities())
        else {
            return;
        };
        let (least_a, greatest_a) = trace.extremes_a();
        let most_a = greatest_a.max(-least_a).max(LEAST_SCALE_A);
        let (down_v, up_v) = trace.drift_v(&self.rig.setup.limits);
        let scales = self.rig.setup.wiring.scale_per_ampere_v;
        let drift_v = 0.5 * up_v.max(-down_v);
        let mut per_div_v = scales.map(|scale_v| Volts(scale_v * most_a.value()));
        per_div_v[3] += drift_v / scope.half_range_div;
        self.scope.centre(per_div_v, ocv_v, &scope);
    }

    pub(super) async fn arm(&mut self, frame: &Frame) -> Result<(), ExecuteError> {
        self.scope.apply(self.rig.bench).await?;
        let error = self.rig.bench.error("scope");
        let memory_points = frame.memory_points;
        let level = self.scope.out_of_reach();
        let remembered = self.scope.memory_points.replace(memory_points) == Some(memory_points);
        let scope = require(&mut self.rig.bench.instruments.scope, "scope")?;
        if !remembered {
            scope
                .set(&Intent::Session { memory_points })
                .await
                .map_err(&error)?;
        }
        let per_div = scope.capabilities().time_per_div(frame.span_s);
        for intent in [
            Intent::Timebase(per_div),
            Intent::Trigger(Trigger { channel: 2, level }),
            Intent::Roll,
        ] {
            scope.set(&intent).await.map_err(&error)?;
        }
        Ok(())
    }

    /// Stops the scope and downloads its screen. The data are on disk when this returns.
    async fn fetch(
        &mut self,
        frame: &Frame,
        trace: &TracePlan,
        name: &str,
    ) -> Result<Capture, ExecuteError> {
        let end_s = self.rig.freeze().await?;
        self.download(frame, end_s, trace, name).await
    }

    /// Downloads the screen of the scope as it was when stopped, bench s.
    pub(super) async fn download(
        &mut self,
        frame: &Frame,
        end_s: Seconds,
        trace: &TracePlan,
        name: &str,
    ) -> Result<Capture, ExecuteError> {
        let error = self.rig.bench.error("scope");
        let mut waveforms = Vec::with_capacity(4);
        for channel in 1..=4 {
            waveforms.push(
                require(&mut self.rig.bench.instruments.scope, "scope")?
                    .download(channel, frame.record_points)
                    .await
                    .map_err(&error)?,
            );
            if self.rig.clock.now() - self.rig.watching.watched_s >= POLL_S {
                self.rig.watch("trace", Fixture::Cell).await?;
            }
        }
        let fail = |reason: String| ExecuteError::Frame {
            trace: trace.name.clone(),
            frame: name.to_owned(),
            reason,
        };
        let waveforms: [Waveform; 4] = waveforms
            .try_into()
            .map_err(|_| fail("not four channels".to_owned()))?;
        let screen_s = require(&mut self.rig.bench.instruments.scope, "scope")?.capabilities();
        let screen_s = screen_s.time_per_div(frame.span_s) * screen_s.horizontal_div;
        self.scope
            .check_frame(Hertz::ZERO, &waveforms, screen_s)
            .map_err(|refused| fail(refused.to_string()))?;
        let start_s = end_s - screen_s;
        let label = format!("trace {} repeat {} {name}", trace.name, trace.repeat);
        let capture = capture_of(label, 0.0, start_s.value(), &waveforms);
        self.rig.recorder.write_capture(
            &run_folder::trace_name(&trace.name, trace.repeat),
            name,
            &capture,
        )?;
        let spikes = if matches!(trace.through, Through::Wave { .. }) {
            WAVE_SPIKES
        } else {
            SPIKES
        };
        if let Some(waveform) = waveforms
            .iter()
            .find(|waveform| waveform.clipped_share() > spikes)
        {
            let (channel, scale) = (waveform.channel, waveform.preamble.volts_per_div);
            let reason = format!(
                "channel {channel} clips at {scale:.4} V/div: expected a coarser \
                wiring.scale_per_ampere"
            );
            return Err(fail(reason));
        }
        Ok(capture)
    }

    /// Returns the scales by which the frames of a trace are read.
    pub(super) fn frames<'f>(&'f self, trace: &'f TracePlan, zero: &Zero) -> Frames<'f> {
        let shunt_ohm = self.rig.setup.wiring.shunt.r_ohm;
        Frames {
            trace,
            correction: &self.known.correction,
            shunt_ohm,
            zero_v: zero.volts.map(Volts::value),
            ocv_v: zero.ocv_v.value(),
        }
    }

    pub(super) fn finish_trace(
        &mut self,
        trace: &TracePlan,
        zero: &Zero,
        origin_s: Seconds,
        recorded: Recorded,
        commanded: Option<Commanded>,
    ) -> Result<(), ExecuteError> {
        let charge_coulomb = charge_of(&recorded.rows);
        let scatter = recorded.scatter();
        let entry = TraceEntry {
            file: run_folder::series(&trace.name, trace.repeat),
            name: trace.name.clone(),
            cell: self
                .position
                .specimen
                .as_ref()
                .map(|specimen| specimen.name.clone()),
            repeat: trace.repeat,
            order: self.rig.recorder.measured(),
            start_time_s: origin_s.value(),
            start_ocv_v: zero.ocv_v.value(),
            charge_before_coulomb: self.direct.charge_coulomb.value(),
            temperature_degc: zero.temperature_degc.map(Celsius::value),
            role: trace.role,
            repeat_group: self.position.specimen.as_ref().map_or_else(
                || trace.repeat_group.clone(),
                |specimen| format!("{}_{}", trace.repeat_group, specimen.name),
            ),
            current_positive: CurrentPositive::Charge,
            current_between_samples: Between::Linear,
            steps_s: recorded.steps_s,
            sample_sigma_a: scatter[0],
            sample_sigma_v: scatter[1],
            commanded,
        };
        self.direct.charge_coulomb += charge_coulomb;
        self.rig.recorder.trace(entry, &recorded.rows)?;
        Ok(())
    }
}

/// Returns the charge that a trace has moved into the cell, C.
pub fn charge_of(rows: &[TraceRow]) -> Coulombs {
    let moved = rows.windows(2).map(|pair| {
        0.5 * (pair[0].current_a + pair[1].current_a) * (pair[1].time_s - pair[0].time_s)
    });
    Coulombs(moved.sum())
}

/// Returns the standard deviation of readings.
fn scatter(readings: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = readings.clone().count() as f64;
    let mean = readings.clone().sum::<f64>() / count;
    (readings
        .map(|reading| (reading - mean).powi(2))
        .sum::<f64>()
        / (count - 1.0))
        .sqrt()
}

/// Checks that the current follows its command.
fn obeys(trace: &str, level_a: Amps, row: &TraceRow) -> Result<(), ExecuteError> {
    let TraceRow {
        time_s, current_a, ..
    } = *row;
    let (share, amps) = FOLLOWS;
    if (Amps(current_a) - level_a).abs() <= share * level_a.abs() + amps {
        return Ok(());
    }
    Err(disobeyed(
        trace,
        &format!("{level_a}"),
        &format!("{current_a:.4} A at {time_s:.3} s"),
    ))
}

pub(super) fn disobeyed(trace: &str, expected: &str, met: &str) -> ExecuteError {
    ExecuteError::Disobeyed {
        what: format!("trace {trace}"),
        expected: expected.to_owned(),
        met: met.to_owned(),
    }
}
