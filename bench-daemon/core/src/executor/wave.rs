//! Executes a trace as a single wave in the generator's memory, which the bipolar supply follows.
//! This allows steps of milliseconds, which no message could command. Within the period of the
//! wave no current flows before and after the trace. In the pause after the trace the least sine
//! replaces the wave before it would repeat. Meanwhile the interlock reads as always; the scope's
//! record of every step is judged afterwards.
//!
//! A power is converted to a current by the voltage at rest, because a wave cannot follow the
//! voltage. The file contains the actual power.

use analysis_files::{
    dataset::{Capture, Commanded, TraceRow},
    thinning::Mean,
};
use analysis_signal::staircase::{Around, Stair, Sums, begins, chunks};
use instruments::{
    fixture::Fixture,
    generator::{Sine, Wave},
    units::{Amps, Hertz, Joules, Seconds, Volts},
};

use super::{
    ExecuteError, Executor, POLL_S, Rig, require,
    state::Zero,
    trace::disobeyed,
    trace_rows::{Frames, Recorded, SETTLE_S},
};
use bench_plan::{config::AFTER_WAVE_S, plan::TracePlan};

use crate::clock::TypedClock;

/// Time for the scope to fill its screen, s.
const FILL_S: f64 = 0.05;
/// Greatest time between the last message and the beginning of the wave, s.
const REACH_S: f64 = 0.45;
/// Share of a step that is omitted at its end, because its edges are known only to a sample.
const GUARD: f64 = 0.06;
/// Share of a step that the supply may take to settle.
const SETTLE: f64 = 0.3;
/// Share of the recorded time after the wave from which rows are made.
const TAIL: f64 = 0.8;
/// Least share of the squares of a wave in each half for a comparison of the clocks.
const SHARE: f64 = 0.1;
/// Position of a wave in its record.
struct Place {
    /// Its beginning, s.
    begin_s: f64,
    /// Length of a step by the scope's clock, s.
    step_s: f64,
}

impl Rig<'_> {
    /// Loads and starts the wave; returns the actual duration of a step, s.
    async fn play_trace(
        &mut self,
        currents: &[f64],
        step_s: f64,
        steps: usize,
    ) -> Result<f64, ExecuteError> {
        let wiring = &self.setup.wiring;
        let peak_a = currents
            .iter()
            .fold(f64::MIN_POSITIVE, |peak, amps| peak.max(amps.abs()));
        let offset = wiring.command_offset_v;
        let peak_v = wiring.command_v(Amps(peak_a));
        let (amplitude, polarity) = (peak_v.abs(), peak_v.0.signum());
        let error = self.bench.error("generator");
        let generator = require(&mut self.bench.instruments.generator, "generator")?;
        let grid_hz = generator.capabilities().freq_step.value();
        let freq_hz = (1.0 / (step_s * steps as f64) / grid_hz).round() * grid_hz;
        let mut shape: Vec<f64> = currents
            .iter()
            .map(|amps| polarity * amps / peak_a)
            .collect();
        shape.resize(steps, 0.0);
        generator.quiet(offset).await.map_err(&error)?;
        let sine = Sine {
            freq: Hertz(freq_hz),
            amplitude,
            offset,
        };
        let wave = Wave::named("run", shape, sine);
        generator.wave(&wave).await.map_err(&error)?;
        self.no_burst();
        let refused = self.driving.burst.refused;
        self.begin_periods(Hertz(freq_hz), 1.0).await?;
        if self.driving.burst.refused != refused {
            // The wave has continued in the meantime and is restarted.
            let generator = require(&mut self.bench.instruments.generator, "generator")?;
            generator.quiet(offset).await.map_err(&error)?;
            generator.wave(&wave).await.map_err(&error)?;
        }
        Ok(1.0 / (freq_hz * steps as f64))
    }

    /// Compares the current that flowed with the current that was requested.
    fn tell_energy(
        &mut self,
        trace: &TracePlan,
        zero: &Zero,
        rows: &[TraceRow],
    ) -> Result<(), ExecuteError> {
        let asked_j: Joules = trace
            .levels
            .windows(2)
            .filter_map(|pair| Some(pair[0].power_w? * (pair[1].at_s - pair[0].at_s)))
            .sum();
        if trace.levels.iter().all(|level| level.power_w.is_none()) {
            return Ok(());
        }
        let power_w = |row: &TraceRow| row.current_a * row.voltage_v;
        let flowed_j: f64 = rows
            .windows(2)
            .map(|pair| {
                0.5 * (power_w(&pair[0]) + power_w(&pair[1])) * (pair[1].time_s - pair[0].time_s)
            })
            .sum();
        self.recorder.warning(&format!(
            "trace {}: powers were converted to currents at the {:.4} V at rest, because a wave \
            cannot follow the voltage: {flowed_j:.2} J flowed, {asked_j:.2} were requested",
            trace.name, zero.ocv_v.0
        ));
        Ok(())
    }
}

impl Executor<'_> {
    pub(super) async fn wave_trace(
        &mut self,
        trace: &TracePlan,
        zero: Zero,
        planned_s: f64,
        steps: usize,
    ) -> Result<(), ExecuteError> {
        let Some(frame) = trace.frames.first().copied() else {
            return Err(disobeyed(&trace.name, "a frame", "none"));
        };
        let over_s = trace.end_s + AFTER_WAVE_S;
        let currents = currents(trace, planned_s, zero.ocv_v.0);
        self.arm(&frame).await?;
        // The screen is longer than the wave; the excess passes before the wave.
        self.rig
            .wait_watching(
                (frame.span_s - over_s).max(Seconds::ZERO) + Seconds(FILL_S),
                "trace",
                Fixture::Cell,
            )
            .await?;
        let step_s = self.rig.play_trace(&currents, planned_s, steps).await?;
        let began_s = self.rig.clock.now();
        // No reading in the last second: nothing may delay the end of the wave.
        self.rig
            .wait_watching((over_s - POLL_S).max(Seconds::ZERO), "trace", Fixture::Cell)
            .await?;
        self.rig
            .clock
            .sleep_for((began_s + over_s - self.rig.clock.now()).max(Seconds::ZERO))
            .await;
        let frozen_s = self.rig.freeze().await?;
        let offset = self.rig.setup.wiring.command_offset_v;
        let error = self.rig.bench.error("generator");
        require(&mut self.rig.bench.instruments.generator, "generator")?
            .quiet(offset)
            .await
            .map_err(error)?;
        self.rig.no_burst();
        once(
            &trace.name,
            (self.rig.clock.now() - began_s).0,
            step_s * steps as f64,
        )?;
        let capture = self.download(&frame, frozen_s, trace, "wave").await?;
        let (origin_s, found) = self
            .frames(trace, &zero)
            .of_wave(&capture, began_s.0, step_s, planned_s);
        let recorded = self.rig.judged(trace, found)?;
        self.rig.tell_energy(trace, &zero, &recorded.rows)?;
        self.finish_trace(
            trace,
            &zero,
            Seconds(origin_s),
            recorded,
            Some(Commanded::Wave {
                sent_s: began_s.0,
                step_s,
            }),
        )
    }
}

impl Frames<'_> {
    /// Returns the bench time of test time 0, and a row per step, of a wave whose last message was
    /// sent at `sent_s`, bench s. Its steps last `step_s` by the generator's clock, s, and were
    /// planned as `planned_s`.
    pub fn of_wave(
        &self,
        capture: &Capture,
        sent_s: f64,
        step_s: f64,
        planned_s: f64,
    ) -> (f64, Recorded) {
        let (start_s, currents) = (
            capture.meta.start_s,
            currents(self.trace, planned_s, self.ocv_v),
        );
        let place = place(
            &self.shunt_current(capture),
            &Stair {
                values: &currents,
                step_s,
            },
            sent_s - start_s,
        );
        (
            start_s + place.begin_s,
            self.rows_of_wave(capture, &currents, &place),
        )
    }

    /// Returns the record's current from the shunt alone, A.
    fn shunt_current(&self, capture: &Capture) -> Sums {
        let [low, high] = [0, 1].map(|channel: usize| capture.meta.channels[channel].scale);
        let off_v = self.zero_v[1] - self.zero_v[0];
        let samples = capture.codes[0].iter().zip(&capture.codes[1]);
        Sums::of(
            samples.map(|(a, b)| (high.volts(*b) - low.volts(*a) - off_v) / self.shunt_ohm),
            capture.meta.interval_s,
        )
    }

    fn rows_of_wave(&self, capture: &Capture, currents: &[f64], place: &Place) -> Recorded {
        let interval_s = capture.meta.interval_s;
        let sums: Vec<Sums> = (0..4)
            .map(|channel| {
                let scale = capture.meta.channels[channel].scale;
                Sums::of(
                    capture.codes[channel]
                        .iter()
                        .map(|code| scale.volts(*code) - self.zero_v[channel]),
                    interval_s,
                )
            })
            .collect();
        let mut values = currents.to_vec();
        // The rest after the last step belongs to the trace itself.
        let own = values
            .len()
            .max(((self.trace.end_s.value() / place.step_s).round()) as usize);
        values.resize(
            own + (TAIL * AFTER_WAVE_S.value() / place.step_s) as usize,
            0.0,
        );
        let still = values.iter().take_while(|amps| **amps == 0.0).count();
        let (_, growth, longest_s) = self.trace.thinning;
        let settle_s = SETTLE_S.min(SETTLE * place.step_s);
        let mut recorded = Recorded {
            frames: 1,
            squares: self.scatter_before(capture, place, currents),
            ..Recorded::default()
        };
        for chunk in chunks(&values, growth, (longest_s.value() / place.step_s) as usize) {
            let from_s = place.begin_s + chunk.from as f64 * place.step_s + settle_s;
            let to_s = place.begin_s + chunk.to as f64 * place.step_s - GUARD * place.step_s;
            let means: Vec<(f64, usize)> = sums
                .iter()
                .filter_map(|sums| sums.mean(from_s, to_s))
                .collect();
            let [first, second, third, fourth] = means.as_slice() else {
                if (still..own).contains(&chunk.from) {
                    let expected = format!("a record from {from_s:.3} s to {to_s:.3} s");
                    recorded
                        .missing
                        .get_or_insert((expected, "one that does not hold it".to_owned()));
                }
                continue;
            };
            let averaged_s = (from_s - place.begin_s, to_s - place.begin_s);
            recorded.rows.push(self.row(&Mean {
                time_s: 0.5 * (averaged_s.0 + averaged_s.1),
                volts: [first.0, second.0, third.0, fourth.0],
                samples: first.1,
                averaged_s,
            }));
            recorded.levels_a.push(values[chunk.from]);
        }
        let changes = values
            .windows(2)
            .enumerate()
            .filter(|(_, pair)| pair[0] != pair[1]);
        recorded.steps_s = changes
            .map(|(index, _)| (index + 1) as f64 * place.step_s)
            .collect();
        recorded
    }

    /// Returns the squares of the scatters of one sample of current and voltage before anything
    /// flows, A² and V².
    fn scatter_before(&self, capture: &Capture, place: &Place, currents: &[f64]) -> [f64; 2] {
        let still = currents.iter().take_while(|amps| **amps == 0.0).count() as f64 * place.step_s;
        let index = |time_s: f64| {
            ((time_s / capture.meta.interval_s).max(0.0) as usize).min(capture.codes[0].len())
        };
        let range = index(place.begin_s)..index(place.begin_s + (1.0 - GUARD) * still);
        let square = |low: usize, high: usize| {
            let volts = |channel: usize, k: usize| {
                capture.meta.channels[channel]
                    .scale
                    .volts(capture.codes[channel][k])
            };
            let (mut sum, mut squares) = (0.0, 0.0);
            let first = range
                .clone()
                .next()
                .map_or(0.0, |k| volts(high, k) - volts(low, k));
            for k in range.clone() {
                let change = volts(high, k) - volts(low, k) - first;
                (sum, squares) = (sum + change, squares + change * change);
            }
            let count = range.len() as f64;
            (squares - sum * sum / count) / (count - 1.0)
        };
        [square(0, 1) / self.shunt_ohm.powi(2), square(2, 3)]
    }
}

/// Checks that a wave that was replaced this long after its last message cannot have repeated.
fn once(trace: &str, passed_s: f64, period_s: f64) -> Result<(), ExecuteError> {
    if passed_s <= period_s - REACH_S {
        return Ok(());
    }
    Err(disobeyed(
        trace,
        &format!("the wave taken away within {:.3} s", period_s - REACH_S),
        &format!("{passed_s:.3} s: it began again"),
    ))
}

/// Returns the current of each step up to the last change, A, of a power at a voltage.
fn currents(trace: &TracePlan, step_s: f64, volts: f64) -> Vec<f64> {
    let place = |at_s: f64| (at_s / step_s).round() as usize;
    let mut currents = vec![0.0; trace.levels.first().map_or(0, |level| place(level.at_s.0))];
    for pair in trace.levels.windows(2) {
        currents.resize(place((pair[1].at_s).0), pair[0].at_a(Volts(volts)).value());
    }
    currents
}

/// Greatest plausible difference of two clocks, as a share.
const CLOCKS_APART: f64 = 1.0e-3;

/// Locates the wave in the record, near the time of its last message, s. If both halves can be
/// located, the scope's clock is used.
fn place(record: &Sums, stair: &Stair<'_>, near_s: f64) -> Place {
    let whole = Place {
        begin_s: begins(
            record,
            stair,
            Around {
                near_s,
                reach_s: REACH_S,
            },
        ),
        step_s: stair.step_s,
    };
    let middle = stair.values.len() / 2;
    let square = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    let (first, second) = stair.values.split_at(middle);
    if square(first).min(square(second)) < SHARE * square(stair.values) {
        return whole;
    }
    let near = Around {
        near_s: whole.begin_s,
        reach_s: 2.0 * stair.step_s,
    };
    let first_s = begins(
        record,
        &Stair {
            values: first,
            ..*stair
        },
        near,
    );
    let second_s = begins(
        record,
        &Stair {
            values: second,
            ..*stair
        },
        Around {
            near_s: near.near_s + middle as f64 * stair.step_s,
            ..near
        },
    );
    let apart_s = second_s - first_s;
    // A difference below one sample is not a difference of clocks.
    if (apart_s - middle as f64 * stair.step_s).abs() <= 1.01 * record.interval_s() {
        return whole;
    }
    let step_s = apart_s / middle as f64;
    // Quartz clocks do not differ by this much: the halves were not located.
    if (step_s / stair.step_s - 1.0).abs() > CLOCKS_APART {
        return whole;
    }
    Place {
        begin_s: first_s,
        step_s,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wave_that_began_again_is_an_error() {
        assert!(once("t", 7.5, 8.0).is_ok());
        let message = once("t", 7.6, 8.0).unwrap_err().to_string();
        assert_eq!(
            message,
            "trace t: expected the wave taken away within 7.550 s, measured 7.600 s: it began again"
        );
    }
}
