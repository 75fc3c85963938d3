//! Steps with direct current or none: temperature, discharge, charge, rest.

use std::{collections::VecDeque, ops::RangeInclusive};

use instruments::{
    fixture::Fixture,
    load::{Discharge, Draw},
    supply::Charge,
    units::{Amps, Celsius, Seconds, Volts},
};

use super::{
    ExecuteError, Executor, POLL_S, Rig, require,
    watch::{CHARGER_CURRENT, LOAD_CURRENT},
};
use crate::{
    clock::TypedClock,
    executor::thermostat::Thermostat,
    journal::{Note, NoteKind},
    record::Event,
};
use bench_plan::{
    config::LOAD_CUT_OFF_V,
    interlock::{Drive, Reading},
    plan::{CampaignRun, Missed, Stage, Step},
};

/// Seconds between two readings while nothing flows.
const REST_POLL_S: Seconds = Seconds(10.0);
/// Time span from which the slope of a resting cell is determined, s.
const SLOPE_SPAN_S: Seconds = Seconds(120.0);
/// The cell must stay within its band for this long, s.
const STEADY_S: Seconds = Seconds(60.0);
/// Number of readings after which a current must have risen.
pub(super) const RISE_POLLS: u32 = 3;

/// Greatest shift of the end of a charge, V.
const GREATEST_SHIFT_V: Volts = Volts(0.1);
/// Least distance of the end of a charge below the limit of the supply, V: near that limit the
/// current falls to zero.
const BELOW_LIMIT_V: Volts = Volts(0.02);

impl Rig<'_> {
    pub(super) async fn discharge(&mut self, step: &Step) -> Result<(), ExecuteError> {
        let Step::Discharge {
            current_a,
            until_v,
            max_s,
        } = *step
        else {
            return Ok(());
        };
        let idle_v = self.idle_volts("discharge").await?;
        if idle_v <= until_v {
            tracing::info!("already at {idle_v:.3}: nothing to discharge");
            return Ok(());
        }
        // Below the end, so that the daemon ends the discharge, and above the cell's limit, so
        // that the load ends it if the daemon does not.
        let stop_below = (until_v - LOAD_CUT_OFF_V).max(self.setup.limits.min_v);
        let error = self.bench.error("load");
        let load = require(&mut self.bench.instruments.load, "load")?;
        load.prepare(&Discharge {
            draw: Draw::Current(current_a),
            stop_below,
        })
        .await
        .map_err(&error)?;
        require(&mut self.bench.instruments.load, "load")?
            .energise()
            .await
            .map_err(&error)?;
        let start_s = self.clock.now();
        for poll in 1.. {
            self.clock.sleep_for(POLL_S).await;
            let (volts, amps) = self.load_volts().await?;
            let temperature_degc = self.temperature_now_and_then().await?;
            let now_s = self.clock.now();
            self.judge(
                "discharge",
                Reading {
                    time_s: now_s,
                    voltage_v: Some(volts),
                    current_a: Some(-amps),
                    temperature_degc,
                },
            )?;
            self.look_back().await?;
            self.others_off(&["load"]).await?;
            if volts <= until_v {
                break;
            }
            self.explained(follows("load", poll, current_a, amps))
                .await?;
            bound(step, now_s - start_s, max_s, || {
                format!("the cell is at {volts:.3}")
            })?;
        }
        require(&mut self.bench.instruments.load, "load")?
            .safe()
            .await
            .map_err(error)?;
        Ok(())
    }

    /// Reads and judges the cell's voltage before anything is switched on: a cell that is missing,
    /// reversed, damaged or too hot must not be driven.
    pub(super) async fn idle_volts(&mut self, phase: &str) -> Result<Volts, ExecuteError> {
        let (volts, drawn_a) = self.load_volts().await?;
        self.no_current(LOAD_CURRENT, drawn_a)?;
        let temperature_degc = self.cell_temperature().await?;
        let reading = Reading {
            time_s: self.clock.now(),
            voltage_v: Some(volts),
            temperature_degc,
            ..Reading::default()
        };
        self.judge(phase, reading)?;
        Ok(volts)
    }

    /// Checks each meter separately while nothing flows, because two currents that cancel are two
    /// faults.
    pub(super) async fn idle_meters(
        &mut self,
        drawn_a: Amps,
        fed_a: Amps,
    ) -> Result<(), ExecuteError> {
        self.no_current(LOAD_CURRENT, drawn_a)?;
        self.no_current(CHARGER_CURRENT, fed_a)?;
        self.others_off(&["load", "supply"]).await
    }

    pub(super) async fn load_volts(&mut self) -> Result<(Volts, Amps), ExecuteError> {
        self.read_drive(Drive::Load).await
    }
}

impl Executor<'_> {
    /// Adds the present run of a campaign to a text.
    pub(super) fn of_run(&self, text: &str) -> String {
        let prefix = self.position.run.as_ref().map(CampaignRun::prefix);
        format!("{}{text}", prefix.unwrap_or_default())
    }

    /// Accepts a voltage by its band and by its slope: a cell that only passes through the band is
    /// not at rest.
    pub(super) fn accept(
        &mut self,
        band_v: RangeInclusive<Volts>,
        missed: Option<Missed>,
    ) -> Result<(), ExecuteError> {
        let (volts, steady) = self.direct.reset.rested.unwrap_or((Volts::NAN, false));
        if steady && band_v.contains(&volts) {
            self.direct.reset.accepted = true;
            return Ok(());
        }
        let met = format!(
            "{volts:.4}, {}",
            if steady { "steady" } else { "still moving" }
        );
        let (low_v, high_v) = band_v.into_inner();
        let expected = format!("{low_v} to {high_v} at rest");
        let (what, cell) = match self.point() {
            Some(_) => ("counted charge", "cell at its counted charge"),
            None => ("SOC reset", "cell after the SOC reset"),
        };
        match missed {
            None => {
                let shift_v = self.direct.reset.shift_v + 0.5 * (low_v + high_v) - volts;
                self.direct.reset.shift_v = if shift_v.is_nan() {
                    Volts::ZERO
                } else {
                    shift_v.clamp(-GREATEST_SHIFT_V, GREATEST_SHIFT_V)
                };
                let shift_mv = 1.0e3 * self.direct.reset.shift_v.value();
                let text = format!(
                    "SOC reset: expected {expected}, found {met}; again, the end of the charge \
                    moved by {shift_mv:+.1} mV"
                );
                Ok(self.rig.recorder.event(Event::Again, &self.of_run(&text))?)
            }
            Some(Missed::Flag) => {
                let text = format!(
                    "{what}: expected {expected}, found {met}: the state of charge is not \
                    the one that was asked for"
                );
                self.rig.recorder.note(Note {
                    text: self.of_run(&text),
                    kind: Some(NoteKind::SocMissed),
                });
                Ok(())
            }
            Some(Missed::Refuse) => Err(ExecuteError::Disobeyed {
                what: self.of_run(cell),
                expected,
                met,
            }),
        }
    }

    /// Brings the bath of a resumed run back to the temperature of a finished stage, and watches
    /// it from here on, because the process that started it is gone and the bath may have been
    /// stopped. With `waits` it also waits for the cell. This moves no charge, so the journal does
    /// not contain it.
    pub async fn hold_again(&mut self, stage: &Stage, waits: bool) -> Result<(), ExecuteError> {
        for step in &stage.steps {
            let Step::HoldTemperature { setpoint_degc, .. } = *step else {
                continue;
            };
            self.person.progress.begin(&stage.title(), step);
            self.rig.recorder.event(Event::Step, &step.to_string())?;
            self.rig.begin(Fixture::Cell, step);
            if waits {
                self.hold_temperature(step).await?;
            } else {
                self.start_bath(setpoint_degc).await?;
            }
            self.person.progress.end(step);
        }
        Ok(())
    }

    /// Starts the bath at a set-point, and watches it from here on.
    async fn start_bath(&mut self, setpoint_degc: Celsius) -> Result<(), ExecuteError> {
        let error = self.rig.bench.error("chiller");
        let chiller = require(&mut self.rig.bench.instruments.chiller, "chiller")?;
        match self.rig.temperatures.thermostat.as_mut() {
            Some(thermostat) => thermostat.set(setpoint_degc),
            None => {
                chiller.start(setpoint_degc).await.map_err(error)?;
                let settings = self.rig.setup.thermostat;
                self.rig.temperatures.thermostat = chiller
                    .is_regulated()
                    .then(|| Thermostat::new(settings, setpoint_degc, self.rig.clock.now()));
            }
        }
        self.rig.temperatures.chiller_runs = true;
        self.rig.temperatures.setpoint_degc = Some(setpoint_degc);
        self.rig.recorder.bath(None, Some(setpoint_degc));
        if self.rig.temperatures.thermostat.is_none() {
            self.person.progress.bath(setpoint_degc.value());
        }
        Ok(())
    }

    pub(super) async fn hold_temperature(&mut self, step: &Step) -> Result<(), ExecuteError> {
        let Step::HoldTemperature {
            setpoint_degc,
            within_k,
            max_s,
        } = *step
        else {
            return Ok(());
        };
        self.start_bath(setpoint_degc).await?;
        let start_s = self.rig.clock.now();
        let mut steady_since_s = None;
        loop {
            let now_s = self.rig.clock.now();
            let temperature_degc = self.rig.cell_temperature().await?;
            self.rig.judge(
                "temperature",
                Reading {
                    time_s: now_s,
                    temperature_degc,
                    ..Reading::default()
                },
            )?;
            if temperature_degc.is_some_and(|met_degc| (met_degc - setpoint_degc).abs() <= within_k)
            {
                if now_s - *steady_since_s.get_or_insert(now_s) >= STEADY_S {
                    return Ok(());
                }
            } else {
                steady_since_s = None;
            }
            bound(step, now_s - start_s, max_s, || {
                at_in_words(temperature_degc)
            })?;
            self.rig.clock.sleep_for(REST_POLL_S).await;
        }
    }

    pub(super) async fn charge(&mut self, step: &Step) -> Result<(), ExecuteError> {
        let Step::Charge {
            current_a,
            limit_v,
            until_v,
            max_s,
        } = *step
        else {
            return Ok(());
        };
        let until_v = (until_v + self.direct.reset.shift_v).min(limit_v - BELOW_LIMIT_V);
        let idle_v = self.rig.idle_volts("charge").await?;
        if idle_v >= until_v {
            tracing::info!("already at {idle_v:.3}: nothing to charge");
            return Ok(());
        }
        let error = self.rig.bench.error("supply");
        let charge = Charge {
            voltage: limit_v,
            current: current_a,
        };
        require(&mut self.rig.bench.instruments.supply, "supply")?
            .prepare(&charge)
            .await
            .map_err(&error)?;
        require(&mut self.rig.bench.instruments.supply, "supply")?
            .energise()
            .await
            .map_err(&error)?;
        let start_s = self.rig.clock.now();
        for poll in 1.. {
            self.rig.clock.sleep_for(POLL_S).await;
            // The supply has no sense leads. Those of the load, with its input off, measure the
            // cell itself.
            let (volts, drawn_a) = self.rig.load_volts().await?;
            let (terminal_v, amps) = self.rig.read_drive(Drive::Supply).await?;
            let temperature_degc = self.rig.temperature_now_and_then().await?;
            let now_s = self.rig.clock.now();
            let reading = Reading {
                time_s: now_s,
                voltage_v: Some(volts),
                current_a: Some(amps),
                temperature_degc,
            };
            self.rig.judge("charge", reading)?;
            self.rig.no_current(LOAD_CURRENT, drawn_a)?;
            self.rig.look_back().await?;
            self.rig.others_off(&["load", "supply"]).await?;
            self.rig.cross_check_charger(terminal_v, volts, amps)?;
            if volts >= until_v {
                break;
            }
            // Near the limit of the supply its current falls, as expected.
            if volts < limit_v - Volts(0.1) {
                self.rig
                    .explained(follows("supply", poll, current_a, amps))
                    .await?;
            }
            bound(step, now_s - start_s, max_s, || {
                format!("the cell is at {volts:.3}")
            })?;
        }
        require(&mut self.rig.bench.instruments.supply, "supply")?
            .safe()
            .await
            .map_err(error)?;
        Ok(())
    }

    pub(super) async fn rest(&mut self, step: &Step) -> Result<(), ExecuteError> {
        let Step::Rest {
            min_s,
            max_s,
            slope_v_per_s,
        } = *step
        else {
            return Ok(());
        };
        let start_s = self.rig.clock.now();
        let mut window: VecDeque<(Seconds, Volts)> = VecDeque::new();
        loop {
            self.rig.clock.sleep_for(REST_POLL_S).await;
            let (volts, drawn_a) = self.rig.load_volts().await?;
            let (_, fed_a) = self.rig.read_drive(Drive::Supply).await?;
            let current_a = Some(fed_a - drawn_a);
            let temperature_degc = self.rig.temperature_now_and_then().await?;
            let now_s = self.rig.clock.now();
            self.rig.judge(
                "rest",
                Reading {
                    time_s: now_s,
                    voltage_v: Some(volts),
                    current_a,
                    temperature_degc,
                },
            )?;
            self.rig.idle_meters(drawn_a, fed_a).await?;
            window.push_back((now_s, volts));
            while window
                .front()
                .is_some_and(|(time_s, _)| now_s - *time_s > SLOPE_SPAN_S)
            {
                window.pop_front();
            }
            let rested_s = now_s - start_s;
            let slope = slope(&window);
            if rested_s >= min_s.max(SLOPE_SPAN_S) && slope.abs() < slope_v_per_s {
                tracing::info!("rested to {volts:.4} in {rested_s:.0}");
                self.direct.reset.rested = Some((volts, true));
                return Ok(());
            }
            if rested_s > max_s {
                // The thesis waits for a consistent voltage. A cell that still changes does not
                // justify the loss of a night, but it must be reported.
                let text = if slope.is_nan() {
                    format!(
                        "{max_s:.0} of rest are too short to decide whether the voltage is \
                        steady"
                    )
                } else {
                    format!(
                        "after {max_s:.0} of rest the voltage still moves by {:.3} mV/min",
                        slope * 6.0e4
                    )
                };
                let text = self.of_run(&text);
                tracing::warn!("{text}");
                self.rig.recorder.warning(&text);
                self.direct.reset.rested = Some((volts, false));
                return Ok(());
            }
        }
    }
}

pub(super) fn bound(
    step: &impl std::fmt::Display,
    passed_s: Seconds,
    max_s: Seconds,
    state: impl Fn() -> String,
) -> Result<(), ExecuteError> {
    if passed_s <= max_s {
        Ok(())
    } else {
        Err(ExecuteError::Bound {
            step: step.to_string(),
            max_s,
            state: state(),
        })
    }
}

/// Formats the temperature of the cell by its thermometer.
fn at_in_words(temperature_degc: Option<Celsius>) -> String {
    temperature_degc.map_or_else(
        || "no temperature was read".to_owned(),
        |met_degc| format!("the cell is at {met_degc:.2}"),
    )
}

/// Checks whether a current follows its command. A current that does not rise indicates a
/// disconnected lead, a fuse or a wrong cell: waiting would not help.
pub(super) fn follows(
    what: &str,
    poll: u32,
    commanded_a: Amps,
    met_a: Amps,
) -> Result<(), ExecuteError> {
    if poll < RISE_POLLS || (met_a - commanded_a).abs() <= 0.1 * commanded_a + Amps(0.05) {
        return Ok(());
    }
    Err(ExecuteError::Disobeyed {
        what: what.to_owned(),
        expected: format!("{commanded_a:.3}"),
        met: format!("{met_a:.3}"),
    })
}

/// Returns the least-squares slope of (s, V), V/s; not a number for fewer than three points.
fn slope(points: &VecDeque<(Seconds, Volts)>) -> f64 {
    if points.len() < 3 {
        return f64::NAN;
    }
    let count = points.len() as f64;
    let numbers = || points.iter().map(|(t, v)| (t.value(), v.value()));
    let mean_t = numbers().map(|(t, _)| t).sum::<f64>() / count;
    let mean_v = numbers().map(|(_, v)| v).sum::<f64>() / count;
    let (covariance, variance) = numbers().fold((0.0, 0.0), |(covariance, variance), (t, v)| {
        (
            covariance + (t - mean_t) * (v - mean_v),
            variance + (t - mean_t).powi(2),
        )
    });
    covariance / variance
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_is_the_lines() {
        let line: VecDeque<(Seconds, Volts)> = (0..12)
            .map(|k| {
                (
                    Seconds(100.0 + 10.0 * f64::from(k)),
                    Volts(3.7 - 2.0e-6 * 10.0 * f64::from(k)),
                )
            })
            .collect();
        assert!((slope(&line) + 2.0e-6).abs() < 1.0e-12);
        assert!(slope(&VecDeque::new()).is_nan());
    }

    #[test]
    fn a_current_that_does_not_come_is_named() {
        assert!(follows("load", 1, Amps(5.0), Amps(0.0)).is_ok());
        let message = follows("load", 3, Amps(5.0), Amps(0.0))
            .unwrap_err()
            .to_string();
        assert_eq!(message, "load: expected 5.000 A, measured 0.000 A");
    }
}
