//! Signals under a direct current: their groups, the ramps around them, and the return of the charge.

use instruments::units::{Amps, Coulombs, Seconds};

use crate::plan::{Bias, Recharge, Step};

/// Share of the capacity within which a recharge brings the charge back.
const BACK_WITHIN: f64 = 5.0e-4;
/// Time beyond the expected one that a recharge may take, as a share and in s.
const RECHARGE_MORE: (f64, Seconds) = (0.5, Seconds(60.0));

/// Puts points under a direct current, in groups that move no more charge than allowed. After each
/// group the charge is brought back.
pub(super) fn in_groups(points: Vec<Step>, bias: &Bias) -> Vec<Step> {
    let coulomb = |step: &Step| bias.to_a.abs() * step.expected_s();
    let first_coulomb = coulomb(&Step::Bias(*bias));
    let mut groups: Vec<(Coulombs, Vec<Step>)> = Vec::new();
    for point in points {
        let more_coulomb = coulomb(&point);
        match groups.last_mut() {
            Some((moved, group)) if *moved + more_coulomb <= bias.most_coulomb => {
                *moved += more_coulomb;
                group.push(point);
            }
            _ => groups.push((first_coulomb + more_coulomb, vec![point])),
        }
    }
    let around = |(moved_coulomb, group): (Coulombs, Vec<Step>)| {
        let down = Bias {
            from_a: bias.to_a,
            to_a: Amps::ZERO,
            ..*bias
        };
        let (share, more_s) = RECHARGE_MORE;
        let recharge = Recharge {
            current_a: -bias.to_a,
            charge_coulomb: moved_coulomb,
            within_coulomb: BACK_WITHIN * bias.capacity_coulomb,
            max_s: (1.0 + share) * moved_coulomb / bias.to_a.abs() + more_s,
        };
        let mut steps = vec![Step::Bias(*bias)];
        steps.extend(group);
        steps.extend([Step::Bias(down), Step::Recharge(recharge)]);
        steps
    };
    groups.into_iter().flat_map(around).collect()
}

/// Repeats rounds of steps under a direct current as often as it may move their charge, at least once, as
/// one group.
pub(super) fn along(round: impl Fn(usize) -> Vec<Step>, bias: &Bias) -> Vec<Step> {
    let coulomb = |step: &Step| bias.to_a.abs() * step.expected_s();
    let first_coulomb = coulomb(&Step::Bias(*bias));
    let round_coulomb: Coulombs = round(0).iter().map(coulomb).sum();
    let rounds = ((bias.most_coulomb - first_coulomb) / round_coulomb)
        .floor()
        .max(1.0) as usize;
    in_groups((0..rounds).flat_map(round).collect(), bias)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::test_settings;
    use instruments::units::{Hertz, Ohms};

    #[test]
    fn points_under_a_direct_current_come_in_groups_that_move_no_more_charge_than_allowed() {
        let bias = Bias {
            from_a: Amps(0.0),
            to_a: Amps(-2.0),
            settle_s: Seconds(30.0),
            amplitude_a: Amps(1.0),
            resistance_ohm: Ohms(0.03),
            most_coulomb: Coulombs(200.0),
            capacity_coulomb: Coulombs(16_200.0),
        };
        let point = |index| Step::Sine {
            index,
            freq_hz: Hertz(1.0),
            amplitude_a: Amps(1.0),
            wait_s: Seconds(18.0),
            settings: test_settings(),
        };
        // The ramp and its records take 36.4 s, a point 20 s: three points move 192.8 C.
        let steps = in_groups((0..5).map(point).collect(), &bias);
        let kinds: String = steps
            .iter()
            .map(|step| match step {
                Step::Bias(bias) if bias.to_a == Amps(-2.0) => 'd',
                Step::Bias(_) => 'u',
                Step::Sine { .. } => 's',
                Step::Recharge(_) => 'r',
                _ => '?',
            })
            .collect();
        assert_eq!(kinds, "dsssurdssur");
        let Step::Recharge(recharge) = steps[5] else {
            panic!("{:?}", steps[5]);
        };
        assert!(
            (recharge.charge_coulomb - Coulombs(192.8)).abs() < Coulombs(1.0e-9)
                && recharge.current_a == Amps(2.0)
        );
        assert!((recharge.within_coulomb - Coulombs(8.1)).abs() < Coulombs(1.0e-9));
        assert!((recharge.max_s - Seconds(1.5 * 96.4 + 60.0)).abs() < Seconds(1.0e-9));
    }

    #[test]
    fn rounds_along_a_discharge_are_one_group() {
        let bias = Bias {
            from_a: Amps(0.0),
            to_a: Amps(-1.0),
            settle_s: Seconds(30.0),
            amplitude_a: Amps(1.0),
            resistance_ohm: Ohms(0.03),
            most_coulomb: Coulombs(200.0),
            capacity_coulomb: Coulombs(16_200.0),
        };
        let round = |number| {
            let pause = Step::Pause {
                span_s: Seconds(25.0),
            };
            vec![
                Step::Pause {
                    span_s: Seconds(20.0 + number as f64 * 0.0),
                },
                pause,
            ]
        };
        // The ramp takes 36.2 s, a round 45 s: three rounds move 171.2 C of 200 C.
        let steps = along(round, &bias);
        let pauses = steps
            .iter()
            .filter(|step| matches!(step, Step::Pause { .. }))
            .count();
        let ramps = steps
            .iter()
            .filter(|step| matches!(step, Step::Bias(_)))
            .count();
        assert_eq!((pauses, ramps), (6, 2), "{steps:?}");
    }
}
