//! Checks of a plan before anything is energised. A plan is refused if it could exceed the limits
//! of the cell, drive while the supply is off, change a fixture under power, or wait without end.
//! The checks are pure functions.

use instruments::{
    fixture::Fixture,
    supply4q::Holds,
    units::{Amps, Hertz, Seconds, Volts},
};

use super::{Checked, Plan, PlanError, Purpose, Step, bias::check_sine, bias_course::BiasCourse};
use crate::interlock::Limits;

/// Allowed distance of the bipolar supply's compliance above the cell's greatest voltage, V: large
/// enough that its voltage loop never acts on a sound cell.
const COMPLIANCE_V: (Volts, Volts) = (Volts(0.25), Volts(2.5));

impl Plan {
    /// Refuses a plan that could exceed the limits of the cell, drive while the supply is off,
    /// change a fixture under power, or wait without end.
    ///
    /// # Errors
    /// The first such step.
    pub fn check(self, limits: &Limits) -> Result<Checked, PlanError> {
        for (stage_index, stage) in self.stages.iter().enumerate() {
            let (mut powered, mut course) = (false, BiasCourse::default());
            for (step_index, step) in stage.steps.iter().enumerate() {
                let fail = |reason: String| PlanError {
                    stage: stage_index + 1,
                    step: step_index + 1,
                    what: step.to_string(),
                    reason,
                };
                step.check(limits, powered).map_err(fail)?;
                course.take(step, step.expected_s()).map_err(fail)?;
                let amplitude_a = match step {
                    Step::Sine { amplitude_a, .. } => Some(*amplitude_a),
                    Step::Multisine(band) => Some(band.peak_a),
                    _ => None,
                };
                if let Some(amplitude_a) = amplitude_a {
                    check_sine(course.bias_a, amplitude_a, limits).map_err(fail)?;
                }
                if matches!(stage.purpose, Purpose::Sweep(Fixture::Short, _))
                    && matches!(
                        step,
                        Step::PowerUp {
                            held: Holds::Voltage | Holds::Nothing | Holds::NoLink,
                            ..
                        }
                    )
                {
                    let reason = "expected a bipolar supply with a programmable current limit to \
                    drive a short, found one whose output follows \
                                  the generator up to its rated current: leave \
                                  [fixture_check.short] out";
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
                let reason =
                    "expected the bipolar supply to be taken down before the stage ends".to_owned();
                return Err(PlanError {
                    stage: stage_index + 1,
                    step,
                    what,
                    reason,
                });
            }
        }
        Ok(Checked(self))
    }
}

impl Step {
    fn check(&self, limits: &Limits, powered: bool) -> Result<(), String> {
        let window = |volts: Volts, what: &str| limits.check_voltage(volts, what);
        let needs_off = || {
            if powered {
                Err("expected the bipolar supply to be down".to_owned())
            } else {
                Ok(())
            }
        };
        match *self {
            Self::Specimen(_)
            | Self::Mount(_)
            | Self::HoldTemperature { .. }
            | Self::Pause { .. }
            | Self::BiasZero(_)
            | Self::Zero(_) => needs_off()?,
            Self::Trace(ref trace) => {
                if trace.bipolar() != powered {
                    return Err(format!(
                        "expected the bipolar supply to be {}",
                        if powered { "down" } else { "up" }
                    ));
                }
                trace.check(limits)?;
            }
            Self::Discharge {
                current_a, until_v, ..
            } => {
                needs_off()?;
                Limits::check_current(current_a, limits.discharge_a, "discharge current")?;
                window(until_v, "the end of the discharge")?;
            }
            Self::Charge {
                current_a,
                limit_v,
                until_v,
                ..
            } => {
                needs_off()?;
                Limits::check_current(current_a, limits.charge_a, "charge current")?;
                window(limit_v, "the limit of the supply")?;
                window(until_v, "the end of the charge")?;
            }
            Self::Rest { min_s, max_s, .. } => {
                needs_off()?;
                if min_s > max_s {
                    return Err(format!(
                        "expected a shortest rest of at most {max_s}, found {min_s}"
                    ));
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
            Self::PowerUp {
                compliance_v,
                limit_a,
                ..
            } => {
                needs_off()?;
                let (least, greatest) =
                    (limits.max_v + COMPLIANCE_V.0, limits.max_v + COMPLIANCE_V.1);
                if !(least..=greatest).contains(&compliance_v) {
                    return Err(format!(
                        "expected a compliance within {least:.2} to {greatest:.2}, found \
                        {compliance_v}"
                    ));
                }
                Limits::check_current(
                    limit_a,
                    1.5 * limits.charge_a.min(limits.discharge_a),
                    "current limit",
                )?;
            }
            Self::Sine {
                freq_hz,
                amplitude_a,
                ..
            } => {
                if !powered {
                    return Err("expected the bipolar supply to be up".to_owned());
                }
                Limits::check_current(
                    amplitude_a,
                    limits.charge_a.min(limits.discharge_a),
                    "amplitude",
                )?;
                if !(freq_hz > Hertz::ZERO && freq_hz.is_finite()) {
                    return Err(format!("expected a frequency above 0 Hz, found {freq_hz}"));
                }
            }
            Self::Bias(_) | Self::Recharge(_) if !powered => {
                return Err("expected the bipolar supply to be up".to_owned());
            }
            Self::Bias(ref bias) => bias.check(limits)?,
            Self::Recharge(recharge) => {
                let (limit, what) = if recharge.current_a > Amps::ZERO {
                    (limits.charge_a, "charge current")
                } else {
                    (limits.discharge_a, "discharge current")
                };
                Limits::check_current(recharge.current_a.abs(), limit, what)?;
            }
            Self::Multisine(ref band) => {
                if !powered {
                    return Err("expected the bipolar supply to be up".to_owned());
                }
                band.check(limits)?;
            }
            Self::Recheck(_) => {
                if !powered {
                    return Err("expected the bipolar supply to be up".to_owned());
                }
            }
            Self::PowerDown => {}
        }
        let longest_s = self.longest_s();
        (longest_s.is_finite() && longest_s <= Seconds(7.0 * 86_400.0))
            .then_some(())
            .ok_or_else(|| format!("expected an end within seven days, found {longest_s}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{Stage, test_settings};
    use instruments::units::{Celsius, Coulombs, Ohms};

    const LIMITS: Limits = Limits {
        min_v: Volts(2.5),
        max_v: Volts(4.2),
        charge_a: Amps(13.5),
        discharge_a: Amps(45.0),
        min_degc: Celsius(0.0),
        max_degc: Celsius(60.0),
    };
    const UP: Step = Step::PowerUp {
        compliance_v: Volts(5.0),
        limit_a: Amps(3.0),
        held: Holds::CurrentAndVoltage,
        idle_a: Amps(0.2),
        depth: None,
    };
    fn sine() -> Step {
        Step::Sine {
            index: 0,
            freq_hz: Hertz(1.0),
            amplitude_a: Amps(1.0),
            wait_s: Seconds(12.0),
            settings: test_settings(),
        }
    }

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
            let up = Step::PowerUp {
                compliance_v: Volts(5.0),
                limit_a: Amps(3.0),
                held,
                idle_a: Amps(0.2),
                depth: None,
            };
            let text = up.to_string();
            assert_eq!(
                text.contains("current limit 3 A"),
                held == Holds::CurrentAndVoltage,
                "{up}"
            );
            assert_eq!(
                text.contains("compliance 5 V"),
                held != Holds::Nothing,
                "{up}"
            );
            assert_eq!(
                text.ends_with("no programmable current limit: the output follows the generator"),
                held == Holds::Voltage,
                "{up}"
            );
            assert_eq!(
                text.ends_with("only the daemon's readings and a fuse hold it"),
                held == Holds::Nothing,
                "{up}"
            );
            let stage = Stage {
                purpose: Purpose::Sweep(fixture, 1),
                steps: vec![Step::Mount(fixture), up, sine(), Step::PowerDown],
            };
            assert_eq!(
                Plan {
                    stages: vec![stage]
                }
                .check(&LIMITS)
                .is_ok(),
                sound,
                "{fixture:?}, held: {held:?}"
            );
        }
    }

    fn check(steps: Vec<Step>) -> Result<Checked, PlanError> {
        Plan {
            stages: vec![Stage {
                purpose: Purpose::Sweep(Fixture::Cell, 1),
                steps,
            }],
        }
        .check(&LIMITS)
    }

    #[test]
    fn a_sound_plan_passes() {
        assert!(
            check(vec![
                Step::Mount(Fixture::Cell),
                UP,
                sine(),
                Step::PowerDown
            ])
            .is_ok()
        );
    }

    fn bias(from_a: Amps, to_a: Amps) -> Step {
        Step::Bias(crate::plan::Bias {
            from_a,
            to_a,
            settle_s: Seconds(30.0),
            amplitude_a: Amps(1.0),
            resistance_ohm: Ohms(0.03),
            most_coulomb: Coulombs(810.0),
            capacity_coulomb: Coulombs(16_200.0),
        })
    }

    fn slow(wait_s: Seconds) -> Step {
        Step::Sine {
            index: 0,
            freq_hz: Hertz(0.1),
            amplitude_a: Amps(1.0),
            wait_s,
            settings: test_settings(),
        }
    }

    #[test]
    fn a_direct_current_is_ramped_bounded_and_brought_back() {
        let back = Step::Recharge(crate::plan::Recharge {
            current_a: Amps(-5.0),
            charge_coulomb: Coulombs(500.0),
            within_coulomb: Coulombs(8.0),
            max_s: Seconds(200.0),
        });
        let high = Step::PowerUp {
            compliance_v: Volts(5.0),
            limit_a: Amps(20.0),
            held: Holds::CurrentAndVoltage,
            idle_a: Amps(0.2),
            depth: None,
        };
        let whole = |steps: Vec<Step>| check([vec![high.clone()], steps].concat());
        let sound = vec![
            bias(Amps(0.0), Amps(5.0)),
            slow(Seconds(50.0)),
            bias(Amps(5.0), Amps(0.0)),
            back,
            Step::PowerDown,
        ];
        let plan = whole(sound.clone()).unwrap().plan().clone();
        let extent = plan.extent();
        assert_eq!(
            (extent.charge_a, extent.discharge_a),
            (Amps(6.0), Amps(5.0))
        );
        assert!((extent.into_coulomb - Coulombs(5.0 * (37.0 + 52.0))).abs() < Coulombs(1.0e-9));
        assert_eq!(extent.out_coulomb, Coulombs(500.0));
        // A burst ends the sinusoid only.
        assert_eq!(plan.plays_on_s(Some(1_000_000)), Some(Seconds::INFINITY));
        let stage = &plan.stages[0];
        let met: Vec<f64> = (0..6)
            .map(|step| stage.bias_at(step))
            .map(Amps::value)
            .collect();
        assert_eq!(met, [0.0, 0.0, 5.0, 5.0, 0.0, 0.0]);
        assert_eq!(stage.bias_a(), Amps(5.0));
        let without = |index: usize| {
            let mut steps = sound.clone();
            steps.remove(index);
            steps
        };
        for (steps, reason) in [
            (without(0), "expected a ramp from 0 A, found one from 5 A"),
            (without(2), "expected no direct current, found 5 A"),
            (
                without(3),
                "expected a ramp to 0 A and a recharge before the supply",
            ),
            (
                vec![
                    bias(Amps(0.0), Amps(5.0)),
                    slow(Seconds(50.0)),
                    Step::PowerDown,
                ],
                "expected a ramp to 0 A and a recharge before the supply",
            ),
            (
                vec![bias(Amps(0.0), Amps(5.0)), slow(Seconds(150.0))],
                "at most 810 C before a recharge (bias_charge), found 945 C",
            ),
            (
                vec![bias(Amps(0.0), Amps(13.0))],
                "within -45 A to 13.5 A, the limits of the cell, found 12 A to 14 A",
            ),
            (
                vec![bias(Amps(0.0), Amps(5.0)), Step::Recheck(QUALITY)],
                "expected no direct current, found 5 A",
            ),
        ] {
            let message = whole(steps).map(|_| ()).unwrap_err().to_string();
            assert!(message.contains(reason), "{message}");
        }
        let message = check(vec![bias(Amps(0.0), Amps(5.0))])
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("expected the bipolar supply to be up"),
            "{message}"
        );
    }

    const QUALITY: crate::measure::quality::Quality = crate::measure::quality::Quality {
        noise: 0.01,
        distortion: 0.01,
        drift: 0.01,
        repeatability: 0.01,
        kramers_kronig: 0.01,
        again: 1,
        time_s: Seconds(60.0),
        charge_coulomb: Coulombs(60.0),
    };

    #[test]
    fn each_way_out_of_the_limits_is_refused_with_its_reason() {
        let discharge = |current_a, until_v| Step::Discharge {
            current_a,
            until_v,
            max_s: Seconds(60.0),
        };
        for (steps, reason) in [
            (vec![sine()], "expected the bipolar supply to be up"),
            (
                vec![Step::PowerUp {
                    compliance_v: Volts(4.2),
                    limit_a: Amps(3.0),
                    held: Holds::CurrentAndVoltage,
                    idle_a: Amps(0.2),
                    depth: None,
                }],
                "expected a compliance within 4.45 V to 6.70 V, found 4.2 V",
            ),
            (vec![UP, sine()], "taken down before the stage ends"),
            (
                vec![UP, Step::Mount(Fixture::Shunt), Step::PowerDown],
                "expected the bipolar supply to be down",
            ),
            (
                vec![UP, discharge(Amps(5.0), Volts(3.5)), Step::PowerDown],
                "expected the bipolar supply to be down",
            ),
            (
                vec![discharge(Amps(46.0), Volts(3.5))],
                "at most 45 A, found 46 A",
            ),
            (
                vec![discharge(Amps(5.0), Volts(2.4))],
                "within 2.5 V to 4.2 V, found 2.4 V",
            ),
            (
                vec![Step::Charge {
                    current_a: Amps(3.0),
                    limit_v: Volts(4.3),
                    until_v: Volts(3.8),
                    max_s: Seconds(60.0),
                }],
                "limit of the supply within 2.5 V to 4.2 V",
            ),
            (
                vec![Step::Charge {
                    current_a: Amps(14.0),
                    limit_v: Volts(4.2),
                    until_v: Volts(3.8),
                    max_s: Seconds(60.0),
                }],
                "at most 13.5 A",
            ),
            (
                vec![
                    UP,
                    Step::Sine {
                        index: 0,
                        freq_hz: Hertz(1.0),
                        amplitude_a: Amps(14.0),
                        wait_s: Seconds(1.0),
                        settings: test_settings(),
                    },
                    Step::PowerDown,
                ],
                "amplitude",
            ),
            (
                vec![
                    UP,
                    Step::Sine {
                        index: 0,
                        freq_hz: Hertz(1.0e-9),
                        amplitude_a: Amps(1.0),
                        wait_s: Seconds(1.0e10),
                        settings: test_settings(),
                    },
                    Step::PowerDown,
                ],
                "within seven days",
            ),
            (
                vec![Step::Rest {
                    min_s: Seconds(10.0),
                    max_s: Seconds(5.0),
                    slope_v_per_s: 1e-6,
                }],
                "shortest rest of at most 5 s",
            ),
        ] {
            let message = check(steps).map(|_| ()).unwrap_err().to_string();
            assert!(message.contains(reason), "{message}");
        }
    }
}
