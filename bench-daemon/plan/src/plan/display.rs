//! Formats a plan as text, for `eis-bench plan` and the journal.

mod words;

use std::fmt;

use instruments::{fixture::Fixture, supply4q::Holds};

use super::{Missed, Purpose, Step, Through};
use crate::measure::quality::Quality;
pub use words::fixture_name;
pub(super) use words::minutes;

impl fmt::Display for Purpose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Temperature => "temperature",
            Self::SocReset => "SOC reset",
            Self::MapPoint => "state of charge of the point",
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
            Self::Specimen(ref run) => match run.point {
                Some(point) => write!(f, "point {}: {point}", run.number),
                None => write!(f, "run {}: take {}", run.number, run.cell),
            },
            Self::Mount(fixture) => write!(f, "mount {}", fixture_name(fixture)),
            Self::HoldTemperature {
                setpoint_degc,
                within_k,
                max_s,
            } => {
                write!(
                    f,
                    "hold {setpoint_degc}, wait until the cell is within {within_k}, at \
                most {}",
                    minutes(max_s)
                )
            }
            Self::Discharge {
                current_a,
                until_v,
                max_s,
            } => {
                write!(
                    f,
                    "discharge at {current_a} to {until_v}, at most {}",
                    minutes(max_s)
                )
            }
            Self::Charge {
                current_a,
                limit_v,
                until_v,
                max_s,
            } => {
                write!(
                    f,
                    "charge at {current_a} (limit {limit_v}) to {until_v}, at most \
                {}",
                    minutes(max_s)
                )
            }
            Self::Rest {
                min_s,
                max_s,
                slope_v_per_s,
            } => {
                write!(
                    f,
                    "rest {} to {}, until slower than {:.3} mV/min",
                    minutes(min_s),
                    minutes(max_s),
                    slope_v_per_s * 6.0e4
                )
            }
            Self::Accept {
                band_v: (low, high),
                missed,
            } => {
                let otherwise = match missed {
                    None => "else again, the end of the charge moved by what is missing",
                    Some(Missed::Flag) => "else go on and say so",
                    Some(Missed::Refuse) => "else end the run",
                };
                write!(f, "accept {low} to {high} at rest, {otherwise}")
            }
            Self::Leg(ref leg) => leg.fmt(f),
            Self::PowerUp {
                compliance_v,
                limit_a,
                held: Holds::CurrentAndVoltage,
                ..
            } => {
                write!(
                    f,
                    "bipolar supply up: compliance {compliance_v}, current limit {limit_a}"
                )
            }
            Self::PowerUp {
                held: Holds::Nothing,
                ..
            } => f.write_str(
                "bipolar supply up: no programmable limit of current or voltage: the output \
                follows the generator up to its ratings, and only the \
                 daemon's readings and a fuse hold it",
            ),
            Self::PowerUp {
                held: Holds::NoLink,
                ..
            } => f.write_str(
                "bipolar supply commanded: the program cannot switch, limit or read it; the \
                generator commands zero, the scope and the load's voltmeter show what flows, and \
                a step of the command tests gain and sign",
            ),
            Self::PowerUp { compliance_v, .. } => {
                write!(
                    f,
                    "bipolar supply up: compliance {compliance_v}, no programmable current \
                limit: the output follows the generator"
                )
            }
            Self::Sine {
                index,
                freq_hz,
                amplitude_a,
                wait_s,
                ..
            } => {
                write!(
                    f,
                    "point {:>2}: {freq_hz:>10.4}, {amplitude_a}, wait {wait_s:.1}",
                    index + 1
                )
            }
            Self::BiasZero(_) => f.write_str("record the zeros of the channels, every output off"),
            Self::Bias(ref bias) => bias.fmt(f),
            Self::Recharge(ref recharge) => recharge.fmt(f),
            Self::Multisine(ref band) => band.fmt(f),
            Self::Recheck(Quality {
                time_s,
                charge_coulomb,
                ..
            }) => {
                write!(
                    f,
                    "measure again what the quality gate refuses: at most {} and \
                {charge_coulomb:.0} in all",
                    minutes(time_s)
                )
            }
            Self::Pause { span_s } => write!(f, "rest {}", minutes(span_s)),
            Self::Zero(ref trace) => write!(
                f,
                "rest {}, then the zeros of the channels and the \
            voltage at rest",
                minutes(trace.rest_s)
            ),
            Self::Trace(ref trace) => {
                let (least_a, greatest_a) = trace.extremes_a();
                let (name, repeat, steps, frames) = (
                    &trace.name,
                    trace.repeat,
                    trace.levels.len(),
                    trace.frames.len(),
                );
                let length = minutes(trace.length_s());
                let through = match trace.through {
                    Through::Bipolar => format!("{frames} frames"),
                    Through::Wave { step_s, steps } => {
                        format!(
                            "by a wave of {steps} steps of {} ms in the generator's memory",
                            (1.0e6 * step_s).0.round() / 1.0e3
                        )
                    }
                    Through::LoadAndSupply => "through load and supply".to_owned(),
                };
                let averaged = trace
                    .averaged
                    .map_or_else(String::new, |averaged| format!("; {averaged}"));
                let first = trace
                    .first_step()
                    .map_or_else(String::new, |first| format!(", first {first}"));
                let worst = if trace.levels.iter().any(|level| level.power_w.is_some()) {
                    " at worst, by power"
                } else {
                    ""
                };
                let steps = format!("{steps} steps from {least_a} to {greatest_a}{worst}{first}");
                write!(
                    f,
                    "trace {name}, repeat {repeat}: {steps}, {through}, {length}{averaged}"
                )
            }
            Self::PowerDown => write!(f, "bipolar supply down"),
        }
    }
}
