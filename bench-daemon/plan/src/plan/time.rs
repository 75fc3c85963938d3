//! Duration of a plan: the expected one, and the longest.

use instruments::units::{Hertz, Seconds};

use super::{Leg, Plan, Stage, Step, Through};

/// How often a point is measured again because a channel clipped or its signal was too small.
pub const MAX_RANGING: usize = 4;
/// Additional duration of a generator's burst beyond the need of its step, s: the usual time for
/// arming, reading and fetching.
pub const LEEWAY_S: Seconds = Seconds(5.0);
/// Approximate time for setting up and downloading one point, s.
const OVERHEAD_S: Seconds = Seconds(2.0);
/// Duration of a wait for a temperature, s: the first of a run takes ten minutes, each later one
/// the minute in which the cell must stay within its band.
const TEMPER_S: Seconds = Seconds(180.0);
/// Share of its upper bound that a discharge or charge of a reset takes: the bound is sufficient
/// for more than a whole cell, and a reset moves about a tenth of a cell in each direction.
const RESET_SHARE: f64 = 0.055;

impl Stage {
    /// Returns the expected duration of all its steps, bench s.
    pub fn expected_s(&self) -> Seconds {
        self.steps.iter().map(Step::expected_s).sum()
    }
}

impl Plan {
    /// Returns the expected duration, bench s: fixed waits in full, others by a rule of thumb. The
    /// first attempt of a reset is assumed to succeed.
    pub fn expected_s(&self) -> Seconds {
        let played = |stage: &Stage| {
            let last = stage
                .steps
                .iter()
                .position(|step| matches!(step, Step::Accept { .. }));
            stage
                .steps
                .iter()
                .take(last.unwrap_or(stage.steps.len()))
                .map(Step::expected_s)
                .sum::<Seconds>()
        };
        self.stages.iter().map(played).sum()
    }

    /// Returns the step that a pause request, and the one that a stop request, may have to wait
    /// for longest, with its expected and its longest duration, bench s.
    pub fn waits(&self) -> [Option<(&Step, Seconds, Seconds)>; 2] {
        let longest = |of: fn(&&Step) -> bool| {
            let steps = self.stages.iter().flat_map(|stage| &stage.steps).filter(of);
            steps
                .map(|step| (step, step.expected_s(), step.longest_s()))
                .max_by(|one, other| one.2.total_cmp(&other.2))
        };
        // Repeated points can be ended one by one.
        [
            longest(|_| true),
            longest(|step| !step.ends_early() && !matches!(step, Step::Recheck(_))),
        ]
    }

    /// Returns how long generator and bipolar supply at most continue to drive if no message
    /// reaches them any more, for a model with at most this number of periods in a burst, bench s:
    /// infinite without bursts; `None` if they drive nothing.
    pub fn plays_on_s(&self, most_periods: Option<u32>) -> Option<Seconds> {
        let steps = self.stages.iter().flat_map(|stage| &stage.steps);
        if steps.clone().any(|step| matches!(step, Step::Bias(_))) {
            // After a burst the generator stays at its offset, which is the direct current.
            return Some(Seconds::INFINITY);
        }
        let whole_s = |freq_hz: Hertz, needed_s: Seconds| {
            let periods = ((needed_s + LEEWAY_S) * freq_hz).ceil();
            if most_periods.is_some_and(|most| periods <= f64::from(most)) {
                periods / freq_hz
            } else {
                Seconds::INFINITY
            }
        };
        let ends_s = steps.filter_map(|step| match step {
            Step::Sine {
                freq_hz, wait_s, ..
            } => Some(whole_s(*freq_hz, *wait_s)),
            Step::Multisine(band) => Some(whole_s(band.base_hz, band.settle_s + band.span_s)),
            Step::Trace(trace) => match trace.through {
                Through::Wave { step_s, steps } => Some(if most_periods.is_some() {
                    step_s * steps as f64
                } else {
                    Seconds::INFINITY
                }),
                // A level holds until the next message.
                Through::Bipolar => Some(Seconds::INFINITY),
                Through::LoadAndSupply => None,
            },
            _ => None,
        });
        ends_s.reduce(Seconds::max)
    }

    /// Returns the longest possible duration, bench s.
    pub fn longest_s(&self) -> Seconds {
        self.stages
            .iter()
            .flat_map(|stage| &stage.steps)
            .map(Step::longest_s)
            .sum()
    }
}

impl Step {
    /// Checks whether the step may be ended early: only its end or its readings are kept.
    pub fn ends_early(&self) -> bool {
        matches!(
            self,
            Self::HoldTemperature { .. }
                | Self::Discharge { .. }
                | Self::Charge { .. }
                | Self::Rest { .. }
                | Self::Leg(_)
                | Self::Pause { .. }
                | Self::Zero(_)
        )
    }

    /// Returns the expected duration, bench s.
    pub fn expected_s(&self) -> Seconds {
        match *self {
            Self::Specimen(_) | Self::Mount(_) | Self::PowerUp { .. } | Self::PowerDown => {
                OVERHEAD_S
            }
            Self::HoldTemperature { max_s, .. } => TEMPER_S.min(max_s),
            Self::Discharge { max_s, .. } | Self::Charge { max_s, .. } => RESET_SHARE * max_s,
            Self::Rest { min_s, .. } => min_s,
            Self::Accept { .. } => Seconds::ZERO,
            Self::Leg(ref leg) => leg.expected_s(),
            Self::Sine { wait_s, .. } => wait_s + OVERHEAD_S,
            Self::BiasZero(_) => 2.0 * OVERHEAD_S,
            Self::Bias(ref bias) => bias.expected_s(),
            Self::Recharge(ref recharge) => {
                recharge.charge_coulomb / recharge.current_a.abs() + 2.0 * OVERHEAD_S
            }
            Self::Multisine(ref band) => band.expected_s() + 2.0 * OVERHEAD_S,
            Self::Recheck(_) => OVERHEAD_S,
            Self::Pause { span_s } => span_s,
            Self::Zero(ref trace) => trace.rest_s + 2.0 * OVERHEAD_S,
            Self::Trace(ref trace) => trace.length_s() + OVERHEAD_S,
        }
    }

    /// Returns the longest possible duration, bench s.
    pub fn longest_s(&self) -> Seconds {
        match *self {
            Self::Specimen(_) | Self::Mount(_) | Self::PowerUp { .. } | Self::PowerDown => {
                Seconds(60.0)
            }
            Self::HoldTemperature { max_s, .. }
            | Self::Discharge { max_s, .. }
            | Self::Charge { max_s, .. }
            | Self::Rest { max_s, .. } => max_s,
            Self::Accept { .. } => Seconds::ZERO,
            Self::Leg(Leg { max_s, .. }) => max_s,
            Self::Recheck(quality) => quality.time_s,
            Self::Multisine(ref band) => {
                (band.expected_s() + Seconds(60.0)) * (MAX_RANGING + 1) as f64
            }
            Self::Sine { wait_s, .. } => (wait_s + Seconds(60.0)) * (MAX_RANGING + 1) as f64,
            Self::BiasZero(_) => Seconds(60.0),
            Self::Bias(ref bias) => bias.expected_s() + Seconds(60.0),
            Self::Recharge(ref recharge) => recharge.max_s + Seconds(60.0),
            Self::Pause { span_s } => span_s + Seconds(60.0),
            Self::Zero(ref trace) => trace.rest_s + Seconds(60.0),
            Self::Trace(ref trace) => trace.length_s() + Seconds(60.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{Missed, Purpose};
    use instruments::units::{Amps, Celsius, Kelvins, Volts};

    #[test]
    fn a_reset_is_expected_to_succeed_at_once_and_bounded_by_all_its_attempts() {
        let attempt = |missed| {
            [
                Step::Discharge {
                    current_a: Amps(5.0),
                    until_v: Volts(3.52),
                    max_s: Seconds(7200.0),
                },
                Step::Charge {
                    current_a: Amps(3.0),
                    limit_v: Volts(4.2),
                    until_v: Volts(3.8),
                    max_s: Seconds(7200.0),
                },
                Step::Rest {
                    min_s: Seconds(300.0),
                    max_s: Seconds(3600.0),
                    slope_v_per_s: 3.0e-6,
                },
                Step::Accept {
                    band_v: (Volts(3.7), Volts(3.74)),
                    missed,
                },
            ]
        };
        let steps: Vec<Step> = [None, Some(Missed::Flag)]
            .into_iter()
            .flat_map(attempt)
            .collect();
        let plan = Plan {
            stages: vec![Stage {
                purpose: Purpose::SocReset,
                steps,
            }],
        };
        // On the simulated bench a later reset takes 278 s, 456 s and 301 s.
        assert!(
            (Seconds(1000.0)..Seconds(1200.0)).contains(&plan.expected_s()),
            "{} s",
            plan.expected_s().0
        );
        assert_eq!(plan.longest_s(), Seconds(2.0 * (7200.0 + 7200.0 + 3600.0)));
        let hold = Step::HoldTemperature {
            setpoint_degc: Celsius(25.0),
            within_k: Kelvins(0.2),
            max_s: Seconds(60.0),
        };
        assert_eq!(hold.expected_s(), Seconds(60.0));
    }
}
