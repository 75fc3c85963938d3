//! The extremes of a plan, for a comparison with the limits of the cell.

use instruments::units::{Amps, Celsius, Coulombs, Seconds, Unit, Volts};

use super::{Flow, Leg, Plan, Step};

/// Extremes that the steps of a plan request. A voltage at which a step ends is included; the
/// voltage of a cell under a current is not known in advance.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Extent {
    /// Greatest current into the cell, A.
    pub charge_a: Amps,
    /// Greatest current out of the cell, A.
    pub discharge_a: Amps,
    /// Lowest and highest voltage that a step ends at or holds, V; `None` if no step has one.
    pub voltage_v: Option<(Volts, Volts)>,
    /// Lowest and highest temperature that is held, °C; `None` if none is held.
    pub temperature_degc: Option<(Celsius, Celsius)>,
    /// Charge into the cell by direct currents over the expected times, C.
    pub into_coulomb: Coulombs,
    /// Charge out of the cell by direct currents over the expected times, C.
    pub out_coulomb: Coulombs,
}

impl Extent {
    fn current(&mut self, into_a: Amps, out_a: Amps) {
        self.charge_a = self.charge_a.max(into_a);
        self.discharge_a = self.discharge_a.max(out_a);
    }

    /// Takes a step under a direct current, A.
    fn step(&mut self, step: &Step, bias_a: Amps) {
        let span_s = step.expected_s();
        match step {
            Step::Discharge {
                current_a, until_v, ..
            } => {
                self.current(Amps::ZERO, *current_a);
                widen(&mut self.voltage_v, *until_v);
                self.out_coulomb += *current_a * span_s;
            }
            Step::Charge {
                current_a, until_v, ..
            } => {
                self.current(*current_a, Amps::ZERO);
                widen(&mut self.voltage_v, *until_v);
                self.into_coulomb += *current_a * span_s;
            }
            Step::Leg(leg) => self.leg(leg, span_s),
            Step::Sine { amplitude_a, .. } => {
                let amplitude_a = *amplitude_a;
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
    fn direct(&mut self, bias_a: Amps, span_s: Seconds) {
        self.into_coulomb += bias_a.max(Amps::ZERO) * span_s;
        self.out_coulomb += (-bias_a).max(Amps::ZERO) * span_s;
    }

    fn leg(&mut self, leg: &Leg, span_s: Seconds) {
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

fn widen<Q: Unit>(range: &mut Option<(Q, Q)>, value: Q) {
    let (least, greatest) = range.unwrap_or((value, value));
    *range = Some((
        Q::of(least.number().min(value.number())),
        Q::of(greatest.number().max(value.number())),
    ));
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
    use instruments::units::{Hertz, Kelvins};

    #[test]
    fn the_extremes_of_all_steps_count() {
        let steps = vec![
            Step::HoldTemperature {
                setpoint_degc: Celsius(25.0),
                within_k: Kelvins(0.1),
                max_s: Seconds(60.0),
            },
            Step::Discharge {
                current_a: Amps(5.0),
                until_v: Volts(3.5),
                max_s: Seconds(60.0),
            },
            Step::Charge {
                current_a: Amps(3.0),
                limit_v: Volts(4.2),
                until_v: Volts(3.8),
                max_s: Seconds(60.0),
            },
            Step::Sine {
                index: 0,
                freq_hz: Hertz(1.0),
                amplitude_a: Amps(4.0),
                wait_s: Seconds(1.0),
                settings: test_settings(),
            },
        ];
        let stages = vec![Stage {
            purpose: Purpose::SocReset,
            steps,
        }];
        let extent = Plan { stages }.extent();
        assert_eq!(
            (extent.charge_a, extent.discharge_a),
            (Amps(4.0), Amps(5.0))
        );
        assert_eq!(extent.voltage_v, Some((Volts(3.5), Volts(3.8))));
        assert_eq!(
            extent.temperature_degc,
            Some((Celsius(25.0), Celsius(25.0)))
        );
        assert!(extent.out_coulomb > Coulombs(0.0) && extent.into_coulomb > Coulombs(0.0));
    }
}
