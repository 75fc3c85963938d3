//! Executes a trace with DC load and DC supply. The load draws negative currents, at constant
//! current or constant power, and the supply charges with positive ones. When no current is to
//! flow, both are off. Their own meters are read just before a step, just after it, and every
//! second between; a row contains the time of its reading.

use analysis_files::dataset::TraceRow;
use instruments::{
    load::{Discharge, Draw},
    supply::Charge,
    units::{Amps, Celsius, Seconds, Volts, Watts},
};

use super::{
    ExecuteError, Executor, POLL_S, Rig,
    dc::{RISE_POLLS, follows},
    require,
    state::Zero,
    trace_rows::Recorded,
    watch::{BELOW_GREATEST_V, LOAD_CURRENT},
};
use bench_plan::{
    interlock::{Drive, Reading},
    plan::{Level, TracePlan},
};

use crate::clock::TypedClock;

/// Distance from its voltage limit within which the supply's current may fall, V.
const NEAR_LIMIT_V: Volts = Volts(0.1);
/// Time before a step at which the last reading is started, s.
const READING_S: Seconds = Seconds(0.15);
/// A row is the mean of one reading.
const ONE: f64 = 1.0;

/// The output that is switched on.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Flowing {
    Nothing,
    /// The load, as it was prepared.
    Load {
        power: bool,
    },
    Supply,
}

/// A trace in progress.
struct Work<'a> {
    trace: &'a TracePlan,
    origin_s: Seconds,
    flowing: Flowing,
    /// How the load was last prepared.
    power: Option<bool>,
    level: Level,
    /// Number of readings since the last step.
    polls: u32,
    recorded: Recorded,
}

impl Rig<'_> {
    /// Programs the limits in advance, so that a step is a single message.
    async fn ready(&mut self, work: &mut Work<'_>) -> Result<(), ExecuteError> {
        if let Some(first) = work
            .trace
            .levels
            .iter()
            .find(|level| level.current_a < Amps::ZERO)
        {
            self.prepare_load(work, first.power_w.is_some()).await?;
        }
        let greatest_a = work.trace.extremes_a().1;
        if greatest_a > Amps::ZERO {
            let voltage = self.setup.limits.max_v - BELOW_GREATEST_V;
            let error = self.bench.error("supply");
            let charge = Charge {
                voltage,
                current: greatest_a,
            };
            require(&mut self.bench.instruments.supply, "supply")?
                .prepare(&charge)
                .await
                .map_err(error)?;
        }
        Ok(())
    }

    async fn prepare_load(&mut self, work: &mut Work<'_>, power: bool) -> Result<(), ExecuteError> {
        let greatest = |of: fn(&Level) -> Option<f64>| {
            work.trace
                .levels
                .iter()
                .filter_map(of)
                .fold(0.0, |most: f64, value| most.max(-value))
        };
        let draw = if power {
            Draw::Power(Watts(greatest(|level| level.power_w.map(Watts::value))))
        } else {
            Draw::Current(Amps(greatest(|level| {
                level.power_w.is_none().then_some(level.current_a.value())
            })))
        };
        let error = self.bench.error("load");
        let stop_below = self.setup.limits.min_v;
        require(&mut self.bench.instruments.load, "load")?
            .prepare(&Discharge { draw, stop_below })
            .await
            .map_err(error)?;
        work.power = Some(power);
        Ok(())
    }

    /// Makes a level flow: first switches off outputs that are on and not needed.
    async fn flow(&mut self, work: &mut Work<'_>, level: Level) -> Result<(), ExecuteError> {
        let power = level.power_w.is_some();
        let wanted = match level.current_a {
            amps if amps < Amps::ZERO => Flowing::Load { power },
            amps if amps > Amps::ZERO => Flowing::Supply,
            _ => Flowing::Nothing,
        };
        if wanted != work.flowing {
            self.end_flow(work).await?;
        }
        match wanted {
            Flowing::Nothing => {}
            Flowing::Load { power } => {
                if work.power != Some(power) {
                    self.prepare_load(work, power).await?;
                }
                let draw = level
                    .power_w
                    .map_or(Draw::Current(-level.current_a), |watts| Draw::Power(-watts));
                let error = self.bench.error("load");
                let load = require(&mut self.bench.instruments.load, "load")?;
                load.level(draw).await.map_err(&error)?;
                if work.flowing != wanted {
                    load.energise().await.map_err(error)?;
                }
            }
            Flowing::Supply => {
                let amps = if power {
                    level.at_a(self.load_volts().await?.0)
                } else {
                    level.current_a
                };
                let error = self.bench.error("supply");
                let supply = require(&mut self.bench.instruments.supply, "supply")?;
                supply.level(amps).await.map_err(&error)?;
                if work.flowing != wanted {
                    supply.energise().await.map_err(error)?;
                }
                work.level = Level {
                    current_a: amps,
                    ..level
                };
            }
        }
        if wanted != Flowing::Supply {
            work.level = level;
        }
        (work.flowing, work.polls) = (wanted, 0);
        Ok(())
    }

    async fn end_flow(&mut self, work: &Work<'_>) -> Result<(), ExecuteError> {
        match work.flowing {
            Flowing::Nothing => Ok(()),
            Flowing::Load { .. } => {
                let error = self.bench.error("load");
                Ok(require(&mut self.bench.instruments.load, "load")?
                    .safe()
                    .await
                    .map_err(error)?)
            }
            Flowing::Supply => {
                let error = self.bench.error("supply");
                Ok(require(&mut self.bench.instruments.supply, "supply")?
                    .safe()
                    .await
                    .map_err(error)?)
            }
        }
    }

    /// Reads every second up to a test time, the last time just before it.
    async fn read_until(&mut self, work: &mut Work<'_>, at_s: Seconds) -> Result<(), ExecuteError> {
        let until_s = work.origin_s + at_s;
        while until_s - self.clock.now() > POLL_S + READING_S {
            self.clock.sleep_for(POLL_S).await;
            self.metered_row(work).await?;
        }
        self.clock
            .sleep_for((until_s - READING_S - self.clock.now()).max(Seconds::ZERO))
            .await;
        // Every step is judged at least once, however short it is.
        work.polls = work.polls.max(RISE_POLLS - 1);
        self.metered_row(work).await?;
        self.clock
            .sleep_for((until_s - self.clock.now()).max(Seconds::ZERO))
            .await;
        Ok(())
    }

    /// Takes one reading, judges it, compares it with the command, and stores it. The supply has
    /// no sense leads; those of the load measure the cell itself.
    async fn metered_row(&mut self, work: &mut Work<'_>) -> Result<(), ExecuteError> {
        let temperature_degc = self.temperature_now_and_then().await?;
        let began_s = self.clock.now();
        let (volts, drawn_a) = self.load_volts().await?;
        let mut terminal_v = None;
        let current_a = match work.flowing {
            // The meters show their zero error.
            Flowing::Nothing => Amps::ZERO,
            Flowing::Load { .. } => -drawn_a,
            Flowing::Supply => {
                let (volts, fed_a) = self.read_drive(Drive::Supply).await?;
                terminal_v = Some(volts);
                fed_a
            }
        };
        let now_s = self.clock.now();
        let shown_a = if work.flowing == Flowing::Nothing {
            -drawn_a
        } else {
            current_a
        };
        self.judge(
            "trace",
            Reading {
                time_s: now_s,
                voltage_v: Some(volts),
                current_a: Some(shown_a),
                temperature_degc,
            },
        )?;
        work.polls += 1;
        // The first reading may still show the state before the step.
        if let Some(terminal_v) = terminal_v.filter(|_| work.polls >= 2) {
            self.cross_check_charger(terminal_v, volts, current_a)?;
        }
        self.nothing_else(work, drawn_a).await?;
        match work.flowing {
            Flowing::Nothing => {}
            Flowing::Load { .. } => {
                let asked_a = work
                    .level
                    .power_w
                    .map_or(-work.level.current_a, |watts| -watts / volts);
                self.explained(follows("load", work.polls, asked_a, drawn_a))
                    .await?;
            }
            Flowing::Supply => {
                if volts < self.setup.limits.max_v - BELOW_GREATEST_V - NEAR_LIMIT_V {
                    self.explained(follows(
                        "supply",
                        work.polls,
                        work.level.current_a,
                        current_a,
                    ))
                    .await?;
                }
            }
        }
        // The voltage drop of the leads is not part of the cell's voltage.
        let voltage_v = volts - current_a * work.trace.lead_ohm;
        let (time_s, temperature_degc) = (
            0.5 * (began_s + now_s) - work.origin_s,
            self.temperatures.last_degc.unwrap_or(Celsius::NAN),
        );
        work.recorded.rows.push(TraceRow {
            time_s: time_s.value(),
            current_a: current_a.value(),
            voltage_v: voltage_v.value(),
            temperature_degc: temperature_degc.value(),
            samples: ONE,
            averaged_s: (time_s.value(), time_s.value()),
        });
        Ok(())
    }

    /// Checks that an output that is off carries no current. Judges from the second reading after
    /// a step on, because the first may still show the state before.
    async fn nothing_else(&mut self, work: &Work<'_>, drawn_a: Amps) -> Result<(), ExecuteError> {
        if work.polls < 2 {
            return Ok(());
        }
        if !matches!(work.flowing, Flowing::Load { .. }) {
            self.no_current(LOAD_CURRENT, drawn_a)?;
        }
        self.others_off(if work.flowing == Flowing::Supply {
            &["load", "supply"]
        } else {
            &["load"]
        })
        .await
    }
}

impl Executor<'_> {
    pub(super) async fn load_and_supply(
        &mut self,
        trace: &TracePlan,
        zero: Zero,
    ) -> Result<(), ExecuteError> {
        let nothing = Level {
            at_s: Seconds::ZERO,
            current_a: Amps::ZERO,
            power_w: None,
        };
        let squares = [zero.scatter.1.powi(2), zero.scatter.0.powi(2)];
        let recorded = Recorded {
            frames: 1,
            squares,
            ..Recorded::default()
        };
        let mut work = Work {
            trace,
            origin_s: Seconds::ZERO,
            flowing: Flowing::Nothing,
            power: None,
            level: nothing,
            polls: 0,
            recorded,
        };
        self.rig.ready(&mut work).await?;
        work.origin_s = self.rig.clock.now();
        self.rig.metered_row(&mut work).await?;
        for level in &trace.levels {
            self.rig.read_until(&mut work, level.at_s).await?;
            work.recorded
                .steps_s
                .push((self.rig.clock.now() - work.origin_s).value());
            self.rig.flow(&mut work, *level).await?;
            self.rig.metered_row(&mut work).await?;
        }
        let end_s = trace
            .end_s
            .max(self.rig.clock.now() - work.origin_s + POLL_S);
        self.rig.read_until(&mut work, end_s).await?;
        self.rig.metered_row(&mut work).await?;
        let Work {
            origin_s, recorded, ..
        } = work;
        self.finish_trace(trace, &zero, origin_s, recorded, None)
    }
}
