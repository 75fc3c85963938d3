//! What is to be done, as data: stages of steps, each with an upper bound in time, checked before anything is energised.

mod crash;
mod leg;
mod multisine;
mod specimen;
mod trace;

use std::{fmt, sync::Arc};

use instruments::{mock::plant::Fixture, supply4q::Holds};

use crate::interlock::Limits;
pub use crash::AfterCrash;
pub use leg::{Flow, Leg, Log};
pub use multisine::Band;
pub use specimen::Specimen;
#[cfg(test)]
pub(crate) use trace::test_trace;
pub use trace::{Frame, LONGEST_FRAME_S, Level, TracePlan};

/// A plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Its stages, in order.
    pub stages: Vec<Stage>,
}

/// Steps that belong together; the outputs are off before and after.
#[derive(Debug, Clone, PartialEq)]
pub struct Stage {
    /// What it is for.
    pub purpose: Purpose,
    /// Its steps, in order.
    pub steps: Vec<Step>,
}

/// What a stage is for: decides what is done with its records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Bringing the cell to its temperature.
    Temperature,
    /// Bringing the cell to its state of charge.
    SocReset,
    /// Finding the open-circuit voltage over the state of charge.
    OcvSoc,
    /// A sweep over what is in the jig: 0 as a control, else the number of the repeat.
    Sweep(Fixture, usize),
    /// Many frequencies at once, with the number of the repeat.
    Multisine(usize),
    /// A current that steps through the cell.
    Trace,
}

/// One step.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// One of the cells of a campaign is taken into use, for the run with this number; every output is off.
    Specimen(Arc<Specimen>, usize),
    /// Something else is clamped into the jig; every output is off.
    Mount(Fixture),
    /// The chiller holds a temperature, and the cell is waited for.
    HoldTemperature {
        /// Set-point, °C.
        setpoint_c: f64,
        /// Accepted deviation, K.
        within_k: f64,
        /// Upper bound, s.
        max_s: f64,
    },
    /// Discharge at constant current down to a voltage.
    Discharge {
        /// Current, A, positive.
        current_a: f64,
        /// End, V under load.
        until_v: f64,
        /// Upper bound, s.
        max_s: f64,
    },
    /// Charge at constant current up to a voltage.
    Charge {
        /// Current, A.
        current_a: f64,
        /// Limit of the supply, V.
        limit_v: f64,
        /// End, V under load.
        until_v: f64,
        /// Upper bound, s.
        max_s: f64,
    },
    /// Nothing flows until the voltage is steady.
    Rest {
        /// Lower bound, s.
        min_s: f64,
        /// Upper bound, s.
        max_s: f64,
        /// Steady means slower than this, V/s.
        slope_v_per_s: f64,
    },
    /// The voltage at rest is held against a band; where it fits, what is left of the stage is left out.
    Accept {
        /// The band, V.
        band_v: (f64, f64),
        /// What becomes of a cell that misses it; none where the charge is tried again.
        missed: Option<Missed>,
    },
    /// Direct current through load or supply, or rest, every reading of which is kept.
    Leg(Leg),
    /// The bipolar supply is brought up with the generator at zero.
    PowerUp {
        /// Compliance voltage, V.
        compliance_v: f64,
        /// Current limit, A: the daemon judges its readings by it, and the supply holds it where it can.
        limit_a: f64,
        /// What of it the supply holds by itself while the generator commands the current.
        held: Holds,
    },
    /// One sinusoid is driven and captured.
    Sine {
        /// Its number in the sweep, from 0.
        index: usize,
        /// Frequency, Hz.
        freq_hz: f64,
        /// Amplitude of the current, A.
        amplitude_a: f64,
        /// Shortest wait for the record, s.
        wait_s: f64,
    },
    /// Many sinusoids are driven at once and captured.
    Multisine(Arc<Band>),
    /// The finished sweep is held against itself; what does not fit is measured again.
    Recheck {
        /// Time for that, s.
        max_s: f64,
        /// Charge that may be moved to and fro for that, C.
        charge_c: f64,
    },
    /// Nothing flows for a while.
    Pause {
        /// How long, s.
        span_s: f64,
    },
    /// Rest, then what scope and voltmeter show of the cell while nothing flows.
    Zero(Arc<TracePlan>),
    /// Steps of direct current are driven and recorded.
    Trace(Arc<TracePlan>),
    /// The bipolar supply is taken down.
    PowerDown,
}

/// What becomes of a run whose cell misses the band of its state of charge to the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Missed {
    /// It goes on, and says so.
    Flag,
    /// It ends.
    Refuse,
}

/// A plan that would leave the limits.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("stage {stage}, step {step} ({what}): {reason}")]
pub struct PlanError {
    /// Number of the stage, from 1.
    pub stage: usize,
    /// Number of the step in it, from 1.
    pub step: usize,
    /// The step in words.
    pub what: String,
    /// Why not.
    pub reason: String,
}

/// A plan that was checked; only such a plan can be executed.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked(Plan);

impl Checked {
    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.0
    }
}

impl Plan {
    /// Refuses a plan that could leave the limits of the cell, drive without a supply that is up, change a fixture under power, or wait without end.
    ///
    /// # Errors
    /// The first such step.
    pub fn check(self, limits: &Limits) -> Result<Checked, PlanError> {
        for (stage_index, stage) in self.stages.iter().enumerate() {
            let mut powered = false;
            for (step_index, step) in stage.steps.iter().enumerate() {
                let fail = |reason: String| PlanError { stage: stage_index + 1, step: step_index + 1, what: step.to_string(), reason };
                step.check(limits, powered).map_err(fail)?;
                if matches!(stage.purpose, Purpose::Sweep(Fixture::Short, _))
                    && matches!(step, Step::PowerUp { held: Holds::Voltage | Holds::Nothing, .. })
                {
                    let reason = "expected a bipolar supply with a programmable current limit to drive a short, found one whose output follows \
                                  the generator up to its rated current: leave [fixture_check.short] out";
                    return Err(fail(reason.to_owned()));
                }
                match step {
                    Step::PowerUp { .. } => powered = true,
                    Step::PowerDown => powered = false,
                    _ => {}
                }
            }
            if powered {
                let (step, what) = (stage.steps.len(), "end of the stage".to_owned());
                let reason = "expected the bipolar supply to be taken down before the stage ends".to_owned();
                return Err(PlanError { stage: stage_index + 1, step, what, reason });
            }
        }
        Ok(Checked(self))
    }

    /// Expected duration, bench s: the fixed waits whole, the others by a rule of thumb.
    pub fn expected_s(&self) -> f64 {
        self.stages.iter().flat_map(|stage| &stage.steps).map(Step::expected_s).sum()
    }

    /// Longest possible duration, bench s.
    pub fn longest_s(&self) -> f64 {
        self.stages.iter().flat_map(|stage| &stage.steps).map(Step::longest_s).sum()
    }
}

/// How often a point is measured again because a channel clipped or was too small.
pub const MAX_RANGING: usize = 4;
/// The compliance of the bipolar supply lies so far above the cell's greatest voltage, V: enough that its voltage loop never acts on a sound cell.
const COMPLIANCE_V: (f64, f64) = (0.25, 2.5);
/// Seconds that setting up and downloading one point takes, as a rule of thumb.
const OVERHEAD_S: f64 = 2.0;

impl Step {
    fn check(&self, limits: &Limits, powered: bool) -> Result<(), String> {
        let current = |amps: f64, limit: f64, what: &str| {
            (amps > 0.0 && amps <= limit)
                .then_some(())
                .ok_or_else(|| format!("expected a {what} above 0 A, at most {limit} A, found {amps} A"))
        };
        let window = |volts: f64, what: &str| {
            (limits.min_v..=limits.max_v)
                .contains(&volts)
                .then_some(())
                .ok_or_else(|| format!("expected {what} within {} V to {} V, found {volts} V", limits.min_v, limits.max_v))
        };
        let needs_off = || if powered { Err("expected the bipolar supply to be down".to_owned()) } else { Ok(()) };
        match *self {
            Self::Specimen(..) | Self::Mount(_) | Self::HoldTemperature { .. } | Self::Pause { .. } | Self::Zero(_) => needs_off()?,
            Self::Trace(ref trace) => {
                if !powered {
                    return Err("expected the bipolar supply to be up".to_owned());
                }
                trace.check(limits)?;
            }
            Self::Discharge { current_a, until_v, .. } => {
                needs_off()?;
                current(current_a, limits.discharge_a, "discharge current")?;
                window(until_v, "the end of the discharge")?;
            }
            Self::Charge { current_a, limit_v, until_v, .. } => {
                needs_off()?;
                current(current_a, limits.charge_a, "charge current")?;
                window(limit_v, "the limit of the supply")?;
                window(until_v, "the end of the charge")?;
            }
            Self::Rest { min_s, max_s, .. } => {
                needs_off()?;
                if min_s > max_s {
                    return Err(format!("expected a shortest rest of at most {max_s} s, found {min_s} s"));
                }
            }
            Self::Accept { band_v, .. } => {
                needs_off()?;
                window(band_v.0, "the band of the voltage at rest")?;
                window(band_v.1, "the band of the voltage at rest")?;
            }
            Self::Leg(ref leg) => {
                needs_off()?;
                leg.check(limits)?;
            }
            Self::PowerUp { compliance_v, limit_a, .. } => {
                needs_off()?;
                let (least, greatest) = (limits.max_v + COMPLIANCE_V.0, limits.max_v + COMPLIANCE_V.1);
                if !(least..=greatest).contains(&compliance_v) {
                    return Err(format!("expected a compliance within {least:.2} V to {greatest:.2} V, found {compliance_v} V"));
                }
                current(limit_a, 1.5 * limits.charge_a.min(limits.discharge_a), "current limit")?;
            }
            Self::Sine { freq_hz, amplitude_a, .. } => {
                if !powered {
                    return Err("expected the bipolar supply to be up".to_owned());
                }
                current(amplitude_a, limits.charge_a.min(limits.discharge_a), "amplitude")?;
                if !(freq_hz > 0.0 && freq_hz.is_finite()) {
                    return Err(format!("expected a frequency above 0 Hz, found {freq_hz} Hz"));
                }
            }
            Self::Multisine(ref band) => {
                if !powered {
                    return Err("expected the bipolar supply to be up".to_owned());
                }
                band.check(limits)?;
            }
            Self::Recheck { .. } => {
                if !powered {
                    return Err("expected the bipolar supply to be up".to_owned());
                }
            }
            Self::PowerDown => {}
        }
        let longest_s = self.longest_s();
        (longest_s.is_finite() && longest_s <= 7.0 * 86_400.0)
            .then_some(())
            .ok_or_else(|| format!("expected an end within seven days, found {longest_s} s"))
    }

    /// Expected duration, bench s.
    pub fn expected_s(&self) -> f64 {
        match *self {
            Self::Specimen(..) | Self::Mount(_) | Self::PowerUp { .. } | Self::PowerDown => OVERHEAD_S,
            Self::HoldTemperature { max_s, .. } => 0.2 * max_s,
            Self::Discharge { max_s, .. } | Self::Charge { max_s, .. } => 0.2 * max_s,
            Self::Rest { min_s, max_s, .. } => 0.5 * (min_s + max_s),
            Self::Accept { .. } => 0.0,
            Self::Leg(ref leg) => leg.expected_s(),
            Self::Sine { wait_s, .. } => wait_s + OVERHEAD_S,
            Self::Multisine(ref band) => band.expected_s() + 2.0 * OVERHEAD_S,
            Self::Recheck { .. } => OVERHEAD_S,
            Self::Pause { span_s } => span_s,
            Self::Zero(ref trace) => trace.rest_s + 2.0 * OVERHEAD_S,
            Self::Trace(ref trace) => trace.length_s() + OVERHEAD_S,
        }
    }

    /// Longest possible duration, bench s.
    pub fn longest_s(&self) -> f64 {
        match *self {
            Self::Specimen(..) | Self::Mount(_) | Self::PowerUp { .. } | Self::PowerDown => 60.0,
            Self::HoldTemperature { max_s, .. } | Self::Discharge { max_s, .. } | Self::Charge { max_s, .. } | Self::Rest { max_s, .. } => {
                max_s
            }
            Self::Accept { .. } => 0.0,
            Self::Leg(Leg { max_s, .. }) | Self::Recheck { max_s, .. } => max_s,
            Self::Multisine(ref band) => (band.expected_s() + 60.0) * (MAX_RANGING + 1) as f64,
            Self::Sine { wait_s, .. } => (wait_s + 60.0) * (MAX_RANGING + 1) as f64,
            Self::Pause { span_s } => span_s + 60.0,
            Self::Zero(ref trace) => trace.rest_s + 60.0,
            Self::Trace(ref trace) => trace.length_s() + 60.0,
        }
    }
}

impl fmt::Display for Purpose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Temperature => "temperature",
            Self::SocReset => "SOC reset",
            Self::OcvSoc => "OCV over SOC",
            Self::Sweep(Fixture::Cell, _) => "EIS sweep of the cell",
            Self::Sweep(Fixture::Shunt, 0) => "fixture check: shunt",
            Self::Sweep(Fixture::Shunt, _) => "EIS sweep of the shunt",
            Self::Sweep(Fixture::FakeCell, _) => "fixture check: fake cell",
            Self::Sweep(Fixture::Short, _) => "fixture check: short",
            Self::Multisine(_) => "multisine of the cell",
            Self::Trace => "current trace",
        })
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Specimen(ref specimen, run) => write!(f, "run {run}: take {specimen}"),
            Self::Mount(fixture) => write!(f, "mount {}", fixture_name(fixture)),
            Self::HoldTemperature { setpoint_c, within_k, max_s } => {
                write!(f, "hold {setpoint_c} °C, wait until the cell is within {within_k} K, at most {}", minutes(max_s))
            }
            Self::Discharge { current_a, until_v, max_s } => {
                write!(f, "discharge at {current_a} A to {until_v} V, at most {}", minutes(max_s))
            }
            Self::Charge { current_a, limit_v, until_v, max_s } => {
                write!(f, "charge at {current_a} A (limit {limit_v} V) to {until_v} V, at most {}", minutes(max_s))
            }
            Self::Rest { min_s, max_s, slope_v_per_s } => {
                write!(f, "rest {} to {}, until slower than {:.3} mV/min", minutes(min_s), minutes(max_s), slope_v_per_s * 6.0e4)
            }
            Self::Accept { band_v: (low, high), missed } => {
                let otherwise = match missed {
                    None => "else again, the end of the charge moved by what is missing",
                    Some(Missed::Flag) => "else go on and say so",
                    Some(Missed::Refuse) => "else end the run",
                };
                write!(f, "accept {low} V to {high} V at rest, {otherwise}")
            }
            Self::Leg(ref leg) => leg.fmt(f),
            Self::PowerUp { compliance_v, limit_a, held: Holds::CurrentAndVoltage } => {
                write!(f, "bipolar supply up: compliance {compliance_v} V, current limit {limit_a} A")
            }
            Self::PowerUp { held: Holds::Nothing, .. } => f.write_str(
                "bipolar supply up: no programmable limit of current or voltage: the output follows the generator up to its ratings, and only the \
                 daemon's readings and a fuse hold it",
            ),
            Self::PowerUp { compliance_v, .. } => {
                write!(f, "bipolar supply up: compliance {compliance_v} V, no programmable current limit: the output follows the generator")
            }
            Self::Sine { index, freq_hz, amplitude_a, wait_s } => {
                write!(f, "point {:>2}: {freq_hz:>10.4} Hz, {amplitude_a} A, wait {wait_s:.1} s", index + 1)
            }
            Self::Multisine(ref band) => band.fmt(f),
            Self::Recheck { max_s, charge_c } => {
                write!(f, "measure again what the quality gate refuses: at most {} and {charge_c:.0} C in all", minutes(max_s))
            }
            Self::Pause { span_s } => write!(f, "rest {}", minutes(span_s)),
            Self::Zero(ref trace) => write!(f, "rest {}, then the zeros of the channels and the voltage at rest", minutes(trace.rest_s)),
            Self::Trace(ref trace) => {
                let (least_a, greatest_a) = trace.extremes_a();
                let (name, repeat, steps, frames) = (&trace.name, trace.repeat, trace.levels.len(), trace.frames.len());
                let length = minutes(trace.length_s());
                let worst = if trace.levels.iter().any(|level| level.power_w.is_some()) { " at worst, by power" } else { "" };
                write!(
                    f,
                    "trace {name}, repeat {repeat}: {steps} steps from {least_a} A to {greatest_a} A{worst}, {frames} frames, {length}"
                )
            }
            Self::PowerDown => write!(f, "bipolar supply down"),
        }
    }
}

/// The fixture's name in files and configuration.
pub fn fixture_name(fixture: Fixture) -> &'static str {
    match fixture {
        Fixture::Cell => "cell",
        Fixture::Shunt => "shunt",
        Fixture::FakeCell => "fake_cell",
        Fixture::Short => "short",
    }
}

fn minutes(seconds: f64) -> String {
    if seconds < 120.0 { format!("{seconds:.0} s") } else { format!("{:.1} min", seconds / 60.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { min_v: 2.5, max_v: 4.2, charge_a: 13.5, discharge_a: 45.0, min_c: 0.0, max_c: 60.0 };
    const UP: Step = Step::PowerUp { compliance_v: 5.0, limit_a: 3.0, held: Holds::CurrentAndVoltage };
    const SINE: Step = Step::Sine { index: 0, freq_hz: 1.0, amplitude_a: 1.0, wait_s: 12.0 };

    #[test]
    fn a_short_is_driven_only_by_a_supply_that_limits_its_current() {
        for (fixture, held, sound) in [
            (Fixture::Short, Holds::CurrentAndVoltage, true),
            (Fixture::Short, Holds::Voltage, false),
            (Fixture::Short, Holds::Nothing, false),
            (Fixture::FakeCell, Holds::Voltage, true),
            (Fixture::Cell, Holds::Voltage, true),
            (Fixture::Cell, Holds::Nothing, true),
        ] {
            let up = Step::PowerUp { compliance_v: 5.0, limit_a: 3.0, held };
            let text = up.to_string();
            assert_eq!(text.contains("current limit 3 A"), held == Holds::CurrentAndVoltage, "{up}");
            assert_eq!(text.contains("compliance 5 V"), held != Holds::Nothing, "{up}");
            assert_eq!(text.ends_with("no programmable current limit: the output follows the generator"), held == Holds::Voltage, "{up}");
            assert_eq!(text.ends_with("only the daemon's readings and a fuse hold it"), held == Holds::Nothing, "{up}");
            let stage = Stage { purpose: Purpose::Sweep(fixture, 1), steps: vec![Step::Mount(fixture), up, SINE, Step::PowerDown] };
            assert_eq!(Plan { stages: vec![stage] }.check(&LIMITS).is_ok(), sound, "{fixture:?}, held: {held:?}");
        }
    }

    fn check(steps: Vec<Step>) -> Result<Checked, PlanError> {
        Plan { stages: vec![Stage { purpose: Purpose::Sweep(Fixture::Cell, 1), steps }] }.check(&LIMITS)
    }

    #[test]
    fn a_sound_plan_passes() {
        assert!(check(vec![Step::Mount(Fixture::Cell), UP, SINE, Step::PowerDown]).is_ok());
    }

    #[test]
    fn each_way_out_of_the_limits_is_refused_with_its_reason() {
        let discharge = |current_a, until_v| Step::Discharge { current_a, until_v, max_s: 60.0 };
        for (steps, reason) in [
            (vec![SINE], "expected the bipolar supply to be up"),
            (
                vec![Step::PowerUp { compliance_v: 4.2, limit_a: 3.0, held: Holds::CurrentAndVoltage }],
                "expected a compliance within 4.45 V to 6.70 V, found 4.2 V",
            ),
            (vec![UP, SINE], "taken down before the stage ends"),
            (vec![UP, Step::Mount(Fixture::Shunt), Step::PowerDown], "expected the bipolar supply to be down"),
            (vec![UP, discharge(5.0, 3.5), Step::PowerDown], "expected the bipolar supply to be down"),
            (vec![discharge(46.0, 3.5)], "at most 45 A, found 46 A"),
            (vec![discharge(5.0, 2.4)], "within 2.5 V to 4.2 V, found 2.4 V"),
            (vec![Step::Charge { current_a: 3.0, limit_v: 4.3, until_v: 3.8, max_s: 60.0 }], "limit of the supply within 2.5 V to 4.2 V"),
            (vec![Step::Charge { current_a: 14.0, limit_v: 4.2, until_v: 3.8, max_s: 60.0 }], "at most 13.5 A"),
            (vec![UP, Step::Sine { index: 0, freq_hz: 1.0, amplitude_a: 14.0, wait_s: 1.0 }, Step::PowerDown], "amplitude"),
            (vec![UP, Step::Sine { index: 0, freq_hz: 1.0e-9, amplitude_a: 1.0, wait_s: 1.0e10 }, Step::PowerDown], "within seven days"),
            (vec![Step::Rest { min_s: 10.0, max_s: 5.0, slope_v_per_s: 1e-6 }], "shortest rest of at most 5 s"),
        ] {
            let message = check(steps).map(|_| ()).unwrap_err().to_string();
            assert!(message.contains(reason), "{message}");
        }
    }
}
