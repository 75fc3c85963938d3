//! Open-circuit voltage over state of charge (thesis 3.1): charged by constant current and
//! constant voltage, rest, slow discharge, and charge again if requested. Short interruptions show
//! the resistance for the compensation of the load's voltage drop, at the terminals where the
//! voltage is read.

use instruments::{
    fixture::Fixture,
    units::{Amps, Seconds, Volts},
};

use crate::{
    config::{Cell, OcvSoc},
    plan::{Flow, Leg, Log, Purpose, Stage, Step},
};

/// Distance from the cell's limits at which the currents end, V: a meter error of a few millivolts
/// must not cause a trip at the end.
const INSIDE_V: Volts = Volts(0.005);
/// Greatest duration of a leg, as a multiple of the time for the cell's capacity.
const LONGER: f64 = 1.5;
/// Additional time for a constant voltage, s.
const HOLD_S: Seconds = Seconds(7200.0);

pub(super) fn stage(ocv: &OcvSoc, cell: &Cell) -> Stage {
    let until_v = ocv.discharge_until_v.max(cell.limits.min_v + INSIDE_V);
    let limit_v = ocv.charge_limit_v.min(cell.limits.max_v - INSIDE_V);
    let rest = Step::Rest {
        min_s: ocv.rest_s.0,
        max_s: ocv.rest_s.1,
        slope_v_per_s: ocv.rest_slope_v_per_s,
    };
    let parts = ocv.interruptions + 1;
    let part_coulomb = cell.capacity_coulomb / parts as f64;
    let whole_s = |amps: Amps| LONGER * cell.capacity_coulomb / amps;
    let pause = |log| {
        Step::Leg(Leg {
            flow: Flow::Rest,
            max_s: ocv.interruption_s,
            log,
        })
    };
    // The first charge ends where the measured one begins; its readings go into the file of the
    // charge direction, which the measured one restarts.
    let up = |charge_coulomb| {
        let flow = Flow::Charge {
            current_a: ocv.charge_a,
            limit_v,
            cut_off_a: ocv.cut_off_a,
            charge_coulomb,
        };
        Step::Leg(Leg {
            flow,
            max_s: whole_s(ocv.charge_a) + HOLD_S,
            log: Log::Charge,
        })
    };
    let down = |current_a, charge_coulomb| {
        let flow = Flow::Discharge {
            current_a,
            until_v,
            charge_coulomb,
        };
        Step::Leg(Leg {
            flow,
            max_s: whole_s(current_a),
            log: Log::Discharge,
        })
    };
    let mut steps = vec![Step::Mount(Fixture::Cell), up(None), rest.clone()];
    for _ in 1..parts {
        steps.extend([
            down(ocv.discharge_a, Some(part_coulomb)),
            pause(Log::Discharge),
        ]);
    }
    steps.push(down(ocv.discharge_a, None));
    if ocv.tail_a < ocv.discharge_a {
        steps.push(down(ocv.tail_a, None));
    }
    steps.push(pause(Log::Discharge));
    if ocv.both_directions {
        steps.push(rest);
        for _ in 1..parts {
            steps.extend([up(Some(part_coulomb)), pause(Log::Charge)]);
        }
        steps.extend([up(None), pause(Log::Charge)]);
    }
    Stage {
        purpose: Purpose::OcvSoc,
        steps,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interlock::{Limits, Settings};
    use instruments::units::{Celsius, Coulombs, KelvinsPerSecond};

    #[test]
    fn the_ends_lie_inside_the_limits_and_each_direction_has_its_pauses() {
        let limits = Limits {
            min_v: Volts(2.5),
            max_v: Volts(4.2),
            charge_a: Amps(13.5),
            discharge_a: Amps(45.0),
            min_degc: Celsius(0.0),
            max_degc: Celsius(60.0),
        };
        let interlock = Settings {
            rate_k_per_s: KelvinsPerSecond(0.1),
            window_s: Seconds(60.0),
            charge_coulomb: Coulombs(20_000.0),
            drift_coulomb: Coulombs(100.0),
            reading_age_s: Seconds(10.0),
            temperature_age_s: Seconds(60.0),
            frozen_s: Seconds(30.0),
            capacity_coulomb: Coulombs(1.0),
            frozen_coulomb: Coulombs(10.0),
        };
        let cell = Cell {
            name: "c".to_owned(),
            identity: crate::config::Identity::default(),
            capacity_coulomb: Coulombs(16_200.0),
            limits,
            interlock,
            series: 1,
            parallel: 1,
            ocv: None,
            wide: Vec::new(),
        };
        let ocv = OcvSoc {
            charge_a: Amps(1.0),
            charge_limit_v: Volts(4.2),
            cut_off_a: Amps(0.1),
            discharge_a: Amps(1.0),
            discharge_until_v: Volts(2.5),
            tail_a: Amps(0.2),
            interruptions: 3,
            interruption_s: Seconds(60.0),
            rest_s: (Seconds(300.0), Seconds(3600.0)),
            rest_slope_v_per_s: 1.0e-6,
            both_directions: true,
            dcir_ohm: None,
            polynomial: None,
        };
        let words: Vec<String> = stage(&ocv, &cell)
            .steps
            .iter()
            .map(ToString::to_string)
            .collect();
        assert_eq!(
            words[1],
            "charge at 1 A, hold 4.195 V until 0.1 A, at most 525.0 min, into ocv_charge.bdf.csv"
        );
        assert_eq!(
            words[3],
            "discharge at 1 A to 2.505 V or by 4050 C, at most 405.0 min, into \
            ocv_discharge.bdf.csv"
        );
        assert_eq!(
            words
                .iter()
                .filter(|step| step.starts_with("nothing flows for 60 s, into ocv_discharge"))
                .count(),
            4
        );
        assert_eq!(
            words
                .iter()
                .filter(|step| step.starts_with("nothing flows for 60 s, into ocv_charge"))
                .count(),
            4
        );
        assert!(
            words
                .iter()
                .any(|step| step.starts_with("discharge at 0.2 A to 2.505 V, at most")),
            "{words:#?}"
        );
        let one_way = stage(
            &OcvSoc {
                both_directions: false,
                tail_a: Amps(1.0),
                ..ocv
            },
            &cell,
        );
        assert_eq!(one_way.steps.len(), 3 + 2 * 3 + 2);
    }
}
