//! Map over charge and temperature: at each temperature a full charge, then from point to point by
//! counted charge, a rest, the sweep, the multisine and the pulses. The stages of a point begin with
//! it, as those of a campaign begin with the selection of their cell.

use instruments::{
    fixture::Fixture,
    units::{Amps, Celsius, Coulombs, Seconds, Volts},
};

use super::{power::Power, temperature, trace};
use crate::{
    config::{CHARGE_LEAST_DEGC, Cell, MapProcedure, Segment, Temperature, Trace},
    interlock::Limits,
    plan::{CampaignRun, Flow, Leg, Log, MapPoint, Missed, Purpose, Stage, Step},
};

/// Greatest duration of a leg, as a multiple of the time for its charge, and additional time, s.
const LONGER: (f64, Seconds) = (1.5, Seconds(600.0));
/// Additional time for a constant voltage, s.
const HOLD_S: Seconds = Seconds(7200.0);
/// Digits of a voltage in the plan, 1/V.
const PER_V: f64 = 1.0e4;

/// A map and what its stages need beside it.
pub(super) struct Mapped<'a> {
    pub(super) map: &'a MapProcedure,
    pub(super) cell: &'a Cell,
    /// Where the cell is charged, and how a temperature is held.
    pub(super) temperature: &'a Temperature,
    pub(super) power: Power,
}

impl Mapped<'_> {
    /// Returns the stages that bring the cell to a point: at a new temperature the full charge first.
    pub(super) fn approach(&self, run: &CampaignRun, point: &MapPoint) -> Vec<Stage> {
        let mut stages = Vec::new();
        let before = self.map.place(run.number - 1);
        let first =
            before.is_none_or(|place| Celsius(place.temperature_degc) != point.temperature_degc);
        if first {
            stages.push(temperature::stage(self.temperature));
            stages.push(self.full_charge(run.number));
            stages.push(temperature::stage(&self.at(point)));
        }
        stages.push(self.to_point(run.number, point, first));
        stages
    }

    fn at(&self, point: &MapPoint) -> Temperature {
        Temperature {
            setpoint_degc: point.temperature_degc,
            ..*self.temperature
        }
    }

    fn rest(&self) -> Step {
        let legs = &self.map.legs;
        Step::Rest {
            min_s: legs.rest_s.0,
            max_s: legs.rest_s.1,
            slope_v_per_s: legs.rest_slope_v_per_s,
        }
    }

    fn full_charge(&self, number: usize) -> Stage {
        let legs = &self.map.legs;
        let charge = Leg {
            flow: Flow::Charge {
                current_a: legs.charge_a,
                limit_v: legs.charge_limit_v,
                cut_off_a: legs.cut_off_a,
                charge_coulomb: None,
            },
            max_s: LONGER.0 * self.map.capacity_coulomb / legs.charge_a + HOLD_S,
            log: Log::MapCharge(number),
        };
        let mount = Step::Mount(Fixture::Cell);
        Stage {
            purpose: Purpose::SocReset,
            steps: vec![mount, Step::Leg(charge), self.rest()],
        }
    }

    /// The temperature is held again before the rest, because the discharge has warmed the cell.
    fn to_point(&self, number: usize, point: &MapPoint, first: bool) -> Stage {
        let legs = &self.map.legs;
        let before = self.map.run(number - 1).filter(|_| !first);
        let left = before.and_then(|run| run.point);
        let below_coulomb = point.below_full_coulomb;
        let most_s = below_coulomb / legs.discharge_a;
        let discharge = Leg {
            flow: Flow::DischargeTo {
                current_a: legs.discharge_a,
                until_v: legs.discharge_until_v,
                below_full_coulomb: below_coulomb,
                expected_coulomb: below_coulomb
                    - left.map_or(Coulombs::ZERO, |left| left.below_full_coulomb),
            },
            max_s: LONGER.0 * most_s + LONGER.1,
            log: Log::MapDischarge(number),
        };
        let held = self.at(point);
        let (low_v, high_v) = self.map.band_v(point.soc);
        Stage {
            purpose: Purpose::MapPoint,
            steps: vec![
                Step::Mount(Fixture::Cell),
                Step::Leg(discharge),
                Step::HoldTemperature {
                    setpoint_degc: held.setpoint_degc,
                    within_k: held.within_k,
                    max_s: held.timeout_s,
                },
                self.rest(),
                Step::Accept {
                    band_v: (rounded_v(low_v), rounded_v(high_v)),
                    missed: Some(self.missed()),
                },
            ],
        }
    }

    fn missed(&self) -> Missed {
        self.map.acceptance.1
    }

    /// Returns the stage of the pulses of a point that stay within the voltage limits of the cell, if
    /// any does, and why each other one is left out.
    pub(super) fn pulses(
        &self,
        run: &CampaignRun,
        point: &MapPoint,
        screen_s: &impl Fn(Seconds) -> Seconds,
    ) -> (Option<Stage>, Vec<String>) {
        let measured = self.map.place(run.number).is_some_and(|place| place.pulses);
        let Some(pulses) = self.map.pulses.as_ref().filter(|_| measured) else {
            return (None, Vec::new());
        };
        let (low_v, high_v) = self.map.band_v(point.soc);
        let [rest, pairs @ ..] = pulses.segments.as_slice() else {
            return (None, Vec::new());
        };
        let of = |segments: Vec<Segment>| {
            let trace = Trace {
                start_v: (rounded_v(low_v), rounded_v(high_v)),
                resistance_max_ohm: self.map.resistance_ohm(point.temperature_degc),
                segments,
                // Each is at another charge or temperature.
                repeat_group: format!("{}_{}", pulses.name, run.name()),
                ..pulses.clone()
            };
            trace::stage(&trace, run.number, self.cell, self.power, screen_s)
        };
        let (mut kept, mut left_out) = (vec![*rest], Vec::new());
        for pair in pairs.chunks(2) {
            let with = [&kept[..], pair].concat();
            let charges = pair
                .first()
                .is_some_and(|pulse| pulse.current_a > Amps::ZERO);
            let checked = if charges && point.temperature_degc < CHARGE_LEAST_DEGC {
                Err(format!("a cell is charged at {CHARGE_LEAST_DEGC} or above"))
            } else {
                check_voltage(&of(with.clone()), &self.cell.limits)
            };
            match checked {
                Ok(()) => kept = with,
                Err(reason) => left_out.extend(pair.first().map(|pulse| {
                    let way = if pulse.current_a < Amps::ZERO {
                        "discharge"
                    } else {
                        "charge"
                    };
                    format!(
                        "{way} pulse of {} A left out: {reason}",
                        pulse.current_a.abs().0
                    )
                })),
            }
        }
        let stage = (kept.len() > 1).then(|| of(kept));
        (stage, left_out)
    }
}

/// Returns the pulses of each point that are left out, by the number of the point, and why.
pub(super) fn left_out(
    mapped: &Mapped<'_>,
    screen_s: &impl Fn(Seconds) -> Seconds,
) -> Vec<(usize, String)> {
    let of = |run: CampaignRun| {
        let reasons = run
            .point
            .map_or_else(Vec::new, |point| mapped.pulses(&run, &point, screen_s).1);
        reasons.into_iter().map(move |reason| (run.number, reason))
    };
    mapped.map.runs().flat_map(of).collect()
}

/// Returns why the pulses of a stage could exceed the voltage limits of the cell.
fn check_voltage(stage: &Stage, limits: &Limits) -> Result<(), String> {
    stage.steps.iter().try_for_each(|step| match step {
        Step::Trace(trace) => trace.check_voltage(limits),
        _ => Ok(()),
    })
}

fn rounded_v(volts: Volts) -> Volts {
    Volts((volts * PER_V).0.round() / PER_V)
}
