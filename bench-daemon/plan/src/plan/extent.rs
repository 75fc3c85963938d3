//! The extremes of a plan, for a comparison with the limits of the cell.

use super::{Flow, Leg, Plan, Step};

/// Extremes that the steps of a plan request. A voltage at which a step ends is included; the
/// voltage of a cell under a current is not known in advance.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Extent {
    /// Greatest current into the cell, A.
    pub charge_a: f64,
    /// Greatest current out of the cell, A.
    pub discharge_a: f64,
    /// Lowest and highest voltage that a step ends at or holds, V; `None` if no step has one.
    pub voltage_v: Option<(f64, f64)>,
    /// Lowest and highest temperature that is held, °C; `None` if none is held.
    pub temperature_degc: Option<(f64, f64)>,
    /// Charge into the cell by direct currents over the expected times, C.
    pub into_coulomb: f64,
    /// Charge out of the cell by direct currents over the expected times, C.
    pub out_coulomb: f64,
}

impl Extent {
    fn current(&mut self, into_a: f64, out_a: f64) {
        self.charge_a = self.charge_a.max(into_a);
        self.discharge_a = self.discharge_a.max(out_a);
    }

    /// Takes a step under a direct current, A.
    fn step(&mut self, step: &Step, bias_a: f64) {
        let span_s = step.expected_s();
        match step {
            Step::Discharge {
                current_a, until_v, ..
            } => {
                self.current(0.0, *current_a);
                widen(&mut self.voltage_v, *until_v);
                self.out_coulomb += current_a * span_s;
            }
            Step::Charge {
                current_a, until_v, ..
            } => {
                self.current(*current_a, 0.0);
                widen(&mut self.voltage_v, *until_v);
                self.into_coulomb += current_a * span_s;
            }
            Step::Leg(leg) => self.leg(leg, span_s),
            Step::Sine { amplitude_a, .. } => {
                self.current(amplitude_a + bias_a, amplitude_a - bias_a);
                self.direct(bias_a, span_s);
            }
            Step::Bias(bias) => {
                self.current(bias.to_a, -bias.to_a);
                self.direct(bias.to_a, span_s);
            }
            Step::Recharge(recharge) => {
                self.current(recharge.current_a, -recharge.current_a);
                let span_s = recharge.charge_coulomb / recharge.current_a.abs();
                self.direct(recharge.current_a, span_s);
            }
            Step::Multisine(band) => {
                self.current(band.peak_a + bias_a, band.peak_a - bias_a);
                self.direct(bias_a, span_s);
            }
            Step::Trace(trace) => {
                let (least_a, greatest_a) = trace.extremes_a();
                self.current(greatest_a, -least_a);
                let (least_coulomb, greatest_coulomb) = trace.swing_coulomb();
                self.out_coulomb -= least_coulomb;
                self.into_coulomb += greatest_coulomb;
            }
            Step::HoldTemperature { setpoint_degc, .. } => {
                widen(&mut self.temperature_degc, *setpoint_degc);
            }
            _ => {}
        }
    }

    /// Adds the charge of a direct current, A.
    fn direct(&mut self, bias_a: f64, span_s: f64) {
        self.into_coulomb += bias_a.max(0.0) * span_s;
        self.out_coulomb += (-bias_a).max(0.0) * span_s;
    }

    fn leg(&mut self, leg: &Leg, span_s: f64) {
        let (into_a, out_a) = leg.most_a();
        self.current(into_a, out_a);
        match leg.flow {
            Flow::Discharge {
                until_v,
                charge_coulomb,
                ..
            } => {
                widen(&mut self.voltage_v, until_v);
                self.out_coulomb += charge_coulomb.unwrap_or(out_a * span_s);
            }
            Flow::DischargeTo {
                until_v,
                expected_coulomb,
                ..
            } => {
                widen(&mut self.voltage_v, until_v);
                self.out_coulomb += expected_coulomb;
            }
            Flow::Charge {
                limit_v,
                charge_coulomb,
                ..
            } => {
                widen(&mut self.voltage_v, limit_v);
                self.into_coulomb += charge_coulomb.unwrap_or(into_a * span_s);
            }
            Flow::Rest => {}
        }
    }
}

fn widen(range: &mut Option<(f64, f64)>, value: f64) {
    let (least, greatest) = range.unwrap_or((value, value));
    *range = Some((least.min(value), greatest.max(value)));
}

impl Plan {
    /// Returns the extremes of the plan.
    pub fn extent(&self) -> Extent {
        let mut extent = Extent::default();
        for stage in &self.stages {
            for (index, step) in stage.steps.iter().enumerate() {
                extent.step(step, stage.bias_at(index));
            }
        }
        extent
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{Purpose, Stage, test_settings};

    #[test]
    fn the_extremes_of_all_steps_count() {
        let steps = vec![
            Step::HoldTemperature {
                setpoint_degc: 25.0,
                within_k: 0.1,
                max_s: 60.0,
            },
            Step::Discharge {
                current_a: 5.0,
                until_v: 3.5,
                max_s: 60.0,
            },
            Step::Charge {
                current_a: 3.0,
                limit_v: 4.2,
                until_v: 3.8,
                max_s: 60.0,
            },
            Step::Sine {
                index: 0,
                freq_hz: 1.0,
                amplitude_a: 4.0,
                wait_s: 1.0,
                settings: test_settings(),
            },
        ];
        let stages = vec![Stage {
            purpose: Purpose::SocReset,
            steps,
        }];
        let extent = Plan { stages }.extent();
        assert_eq!((extent.charge_a, extent.discharge_a), (4.0, 5.0));
        assert_eq!(extent.voltage_v, Some((3.5, 3.8)));
        assert_eq!(extent.temperature_degc, Some((25.0, 25.0)));
        assert!(extent.out_coulomb > 0.0 && extent.into_coulomb > 0.0);
    }
}
