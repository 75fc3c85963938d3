use instruments::units::{Amps, Celsius, Coulombs, Seconds, Volts};

use super::*;

/// Conditions at the thermometers as a function of the time, s.
type WorldAt<'w> = &'w dyn Fn(f64) -> World;

/// Capacity of the cell of the demo, C.
const CAPACITY_C: f64 = 4.5 * 3600.0;

/// Conditions on the bench at a time.
struct World {
    cell_degc: f64,
    air_degc: f64,
    bath_degc: Option<f64>,
    amps: f64,
}

impl World {
    fn room() -> Self {
        Self {
            cell_degc: 25.0,
            air_degc: 22.0,
            bath_degc: None,
            amps: 0.0,
        }
    }

    fn bath(bath_degc: f64) -> Self {
        Self {
            bath_degc: Some(bath_degc),
            ..Self::room()
        }
    }
}

/// Returns the noise of a thermometer, K: a separate number for each time and channel.
fn noise(now_s: f64, channel: f64) -> f64 {
    0.02 * (now_s * 12.9898 + channel * 78.233).sin()
}

/// Rounds a reading to steps, K.
fn stepped(celsius: f64, step_k: f64) -> f64 {
    (celsius / step_k).round() * step_k
}

/// Returns the first fault, and its time, of two hours with a reading every ten seconds.
fn first_fault(of: impl Fn(f64) -> World) -> Option<(f64, ThermometerFault)> {
    let mut judge = ThermometerJudge::new(Coulombs(CAPACITY_C));
    (0..7200).find_map(|second| {
        let now_s = f64::from(second);
        let world = of(now_s);
        let volts = 3.7 + 0.016 * world.amps - 1.0e-5 * now_s;
        judge.take_power(Volts(volts), Amps(world.amps), Seconds(now_s));
        if second % 10 != 0 {
            return None;
        }
        let readings = ThermometerReadings {
            cell_degc: Some(Celsius(world.cell_degc)),
            air_degc: Some(Celsius(world.air_degc)),
            bath_degc: world.bath_degc.map(Celsius),
        };
        Some((now_s, judge.judge(readings, true, Seconds(now_s))?))
    })
}

#[test]
fn sound_thermometers_are_left_alone_coarse_and_noiseless_ones_too() {
    let ramp = |now_s: f64| (22.0 + now_s / 100.0).min(45.0);
    let follows = |now_s: f64| (22.0 + (now_s - 120.0).max(0.0) / 100.0).min(44.0);
    let warmed = |now_s: f64| 25.0 + 0.8 * (1.0 - (-now_s / 300.0).exp());
    let cases: [(&str, &dyn Fn(f64) -> World); 9] = [
        ("constant, one decimal", &|_| World::bath(25.0)),
        ("constant, whole degrees", &|now_s| World {
            cell_degc: stepped(25.3 + noise(now_s, 1.0), 1.0),
            air_degc: 22.0 + noise(now_s, 2.0),
            ..World::bath(25.0)
        }),
        ("noise", &|now_s| World {
            cell_degc: 25.0 + noise(now_s, 1.0),
            air_degc: 22.0 + noise(now_s, 2.0),
            ..World::bath(25.0 + noise(now_s, 3.0))
        }),
        ("follows its bath in tenths", &|now_s| World {
            cell_degc: stepped(follows(now_s), 0.1),
            ..World::bath(ramp(now_s))
        }),
        ("warmed by 5 A in tenths", &|now_s| World {
            cell_degc: stepped(warmed(now_s), 0.1),
            amps: if now_s > 60.0 { -5.0 } else { 0.0 },
            ..World::bath(25.0)
        }),
        ("cooled so well that it does not move", &|now_s| World {
            amps: if now_s > 60.0 { -9.0 } else { 0.0 },
            ..World::bath(25.0)
        }),
        ("the sun shines, a door opens", &|now_s| World {
            air_degc: 22.0 + 6.0 * (now_s / 900.0).sin() - 8.0 * (now_s / 3000.0),
            cell_degc: 25.0 + noise(now_s, 1.0),
            ..World::bath(25.0)
        }),
        ("a cold bath in a warm room", &|now_s| World {
            cell_degc: 6.0 + noise(now_s, 1.0),
            air_degc: 25.0 + noise(now_s, 2.0),
            ..World::bath(5.0)
        }),
        ("a hot cell in a bath as warm as the room", &|now_s| World {
            cell_degc: 25.0 + (now_s / 100.0).min(18.0) + noise(now_s, 1.0),
            air_degc: 25.0,
            ..World::bath(25.0)
        }),
    ];
    for (case, of) in cases {
        assert_eq!(first_fault(of), None, "{case}");
    }
}

#[test]
fn thermometers_that_are_frozen_or_swapped_are_named_before_the_cell_is_hot() {
    let runaway = |now_s: f64| 25.0 + (now_s - 600.0).max(0.0) * 0.05;
    let cases: [(&str, WorldAt<'_>, &str, f64); 7] = [
        (
            "still, bath runs away",
            &|now_s| World::bath(runaway(now_s)),
            "it is frozen",
            1100.0,
        ),
        (
            "still, 20 A without a bath",
            &|now_s| World {
                amps: if now_s > 600.0 { -20.0 } else { 0.0 },
                ..World::room()
            },
            "of heat in the cell must have warmed it by",
            700.0,
        ),
        (
            "still, 30 A in a bath",
            &|now_s| World {
                amps: if now_s > 600.0 { -30.0 } else { 0.0 },
                ..World::bath(25.0)
            },
            "of heat in the cell must have warmed it by",
            700.0,
        ),
        (
            "still from the start beside an air with noise",
            &|now_s| World {
                cell_degc: 25.037,
                air_degc: 22.0 + noise(now_s, 2.0),
                ..World::bath(25.0)
            },
            "25.037 °C 21 times in a row",
            310.0,
        ),
        (
            "swapped, the cell heats",
            &|now_s| World {
                cell_degc: 22.0 + noise(now_s, 1.0),
                air_degc: 22.0 + (now_s - 600.0).max(0.0) * 0.02,
                ..World::room()
            },
            "are the two swapped?",
            1020.0,
        ),
        (
            "swapped, a hot bath",
            &|now_s| World {
                cell_degc: 22.0 + noise(now_s, 1.0),
                air_degc: 44.0 + noise(now_s, 2.0),
                ..World::bath(45.0)
            },
            "and the bath 45.0 °C: are the two swapped?",
            310.0,
        ),
        (
            "an air that no room has",
            &|now_s| World {
                air_degc: 74.0 + noise(now_s, 2.0),
                ..World::room()
            },
            "expected -30 °C to 55 °C: is it swapped with that of the cell?",
            0.0,
        ),
    ];
    for (case, of, words, at_most_s) in cases {
        let Some((at_s, fault)) = first_fault(of) else {
            panic!("{case}: no fault")
        };
        assert!(fault.to_string().contains(words), "{case}: {fault}");
        assert!(at_s <= at_most_s, "{case}: {at_s} s");
    }
}

#[test]
fn a_cell_beside_the_jig_is_not_judged_and_the_air_is() {
    let mut judge = ThermometerJudge::new(Coulombs(CAPACITY_C));
    for k in 0..200 {
        let readings = ThermometerReadings {
            cell_degc: Some(Celsius(25.037)),
            air_degc: Some(Celsius(22.0 + noise(f64::from(k), 2.0))),
            bath_degc: Some(Celsius(25.0 + f64::from(k))),
        };
        assert_eq!(
            judge.judge(readings, false, Seconds(10.0 * f64::from(k))),
            None
        );
    }
    let hot = ThermometerReadings {
        air_degc: Some(Celsius(80.0)),
        ..ThermometerReadings::default()
    };
    assert!(judge.judge(hot, false, Seconds(2000.0)).is_some());
}
