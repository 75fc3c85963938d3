use instruments::units::{Amps, Celsius, Coulombs, KelvinsPerSecond, Seconds, Volts};

use super::*;

const LIMITS: Limits = Limits {
    min_v: Volts(2.5),
    max_v: Volts(4.2),
    charge_a: Amps(13.5),
    discharge_a: Amps(45.0),
    min_degc: Celsius(0.0),
    max_degc: Celsius(60.0),
};
const SETTINGS: Settings = Settings {
    rate_k_per_s: KelvinsPerSecond(5.0 / 60.0),
    window_s: Seconds(60.0),
    charge_coulomb: Coulombs(1000.0),
    drift_coulomb: Coulombs(100.0),
    reading_age_s: Seconds(15.0),
    temperature_age_s: Seconds(60.0),
    frozen_coulomb: Coulombs(50.0),
    frozen_s: Seconds(30.0),
    capacity_coulomb: Coulombs(5000.0),
};

fn live(charge_coulomb: (Coulombs, Coulombs)) -> Interlock {
    let mut interlock = Interlock::new(SETTINGS, LIMITS, true);
    interlock.begin(
        Allowance {
            live: true,
            charge_coulomb,
            ..Allowance::idle(LIMITS)
        },
        Seconds(0.0),
    );
    interlock
}

/// Feeds readings until one trips; returns the trip and its bench time.
fn play(
    interlock: &mut Interlock,
    readings: impl Iterator<Item = Reading>,
) -> Option<(String, f64)> {
    readings.into_iter().find_map(|reading| {
        let trip = interlock.judge(&reading, reading.time_s)?;
        Some((trip.to_string(), reading.time_s.value()))
    })
}

/// Returns one reading per second: volts, amperes and degrees over time, s.
fn course(
    seconds: u32,
    of: impl Fn(f64) -> (f64, f64, Option<f64>),
) -> impl Iterator<Item = Reading> {
    (1..=seconds).map(f64::from).map(move |time_s| {
        let (volts, amps, temperature_degc) = of(time_s);
        Reading {
            time_s: Seconds(time_s),
            voltage_v: Some(Volts(volts)),
            current_a: Some(Amps(amps)),
            temperature_degc: temperature_degc.map(Celsius),
        }
    })
}

const FREE: (Coulombs, Coulombs) = (Coulombs::NEG_INFINITY, Coulombs::INFINITY);

/// Voltage, current and temperature over time.
type Course = Box<dyn Fn(f64) -> (f64, f64, Option<f64>)>;

#[test]
fn a_sound_discharge_trips_nothing_and_each_fault_trips_its_own() {
    let sound = |t: f64| (4.0 - 1.0e-4 * t, -5.0, Some(25.0 + 0.02 * t));
    assert_eq!(
        play(
            &mut live((Coulombs(-1000.0), Coulombs(10.0))),
            course(180, sound)
        ),
        None
    );
    let cases: [(&str, Course, f64); 7] = [
        (
            "net charge of the step -1002",
            Box::new(|t| (4.0 - 1.0e-4 * t, -6.0, Some(25.0 + 0.01 * t))),
            168.0,
        ),
        (
            "net charge of the step 1",
            Box::new(|t| (4.0 + 1.0e-4 * t, 1.0, Some(25.0 + 0.01 * t))),
            12.0,
        ),
        (
            "charge while the cell voltage stood still 55",
            Box::new(|t| (4.0, -5.0, Some(25.0 + 0.01 * t))),
            12.0,
        ),
        (
            "charge while the cell temperature stood still 55",
            Box::new(|t| (4.0 - 1.0e-4 * t, -5.0, Some(25.0))),
            12.0,
        ),
        (
            "rate of the cell temperature 6.0000 K/min",
            Box::new(|t| (4.0 - 1.0e-4 * t, -5.0, Some(25.0 + 0.1 * t))),
            31.0,
        ),
        (
            "rate of the cell temperature -6.0000 K/min",
            Box::new(|t| (4.0 - 1.0e-4 * t, -5.0, Some(25.0 - 0.1 * t))),
            31.0,
        ),
        (
            "time without a cell temperature 61.0000 s",
            Box::new(|t| (4.0 - 1.0e-4 * t, -5.0, None)),
            61.0,
        ),
    ];
    for (text, of, at_s) in cases {
        let tripped = play(
            &mut live((Coulombs(-1000.0), Coulombs(10.0))),
            course(300, of),
        );
        assert!(
            tripped
                .as_ref()
                .is_some_and(|(found, time_s)| found.starts_with(text) && *time_s == at_s),
            "{text}: {tripped:?}"
        );
    }
}

#[test]
fn a_reading_that_comes_late_trips_only_while_current_may_flow() {
    let reading = |time_s| Reading {
        time_s,
        voltage_v: Some(Volts(3.7)),
        temperature_degc: Some(Celsius(25.0)),
        ..Reading::default()
    };
    let mut interlock = live(FREE);
    assert_eq!(interlock.judge(&reading(Seconds(1.0)), Seconds(1.0)), None);
    let trip = interlock
        .judge(&reading(Seconds(20.0)), Seconds(20.0))
        .map(|trip| trip.to_string())
        .unwrap_or_default();
    assert!(
        trip.starts_with("time without a reading 19.0000 s left its limits (0 s to 15 s)"),
        "{trip}"
    );
    let mut resting = Interlock::new(SETTINGS, LIMITS, true);
    resting.begin(Allowance::idle(LIMITS), Seconds(0.0));
    assert_eq!(
        (
            resting.judge(&reading(Seconds(1.0)), Seconds(1.0)),
            resting.judge(&reading(Seconds(500.0)), Seconds(500.0))
        ),
        (None, None)
    );
    // A quantity that was not read at rest is not late when the step begins, but is late if it is
    // still not read.
    resting.begin(
        Allowance {
            live: true,
            ..Allowance::idle(LIMITS)
        },
        Seconds(900.0),
    );
    assert_eq!(
        resting.judge(&reading(Seconds(901.0)), Seconds(901.0)),
        None
    );
    assert!(
        resting
            .judge(&reading(Seconds(950.0)), Seconds(950.0))
            .is_some()
    );
}

#[test]
fn a_bench_without_a_logger_is_not_asked_for_a_temperature() {
    let mut interlock = Interlock::new(SETTINGS, LIMITS, false);
    interlock.begin(
        Allowance {
            live: true,
            charge_coulomb: FREE,
            ..Allowance::idle(LIMITS)
        },
        Seconds(0.0),
    );
    assert_eq!(
        play(
            &mut interlock,
            course(200, |t| (4.0 - 1.0e-4 * t, 0.0, None))
        ),
        None
    );
}

#[test]
fn a_supply_that_holds_the_voltage_may_hold_it_and_a_step_that_goes_on_counts_on() {
    let mut interlock = Interlock::new(SETTINGS, LIMITS, false);
    let holding = Allowance {
        live: true,
        held_v: Volts(4.1),
        ..Allowance::idle(LIMITS)
    };
    interlock.begin(holding, Seconds(0.0));
    assert_eq!(
        play(&mut interlock, course(200, |_| (4.15, 3.0, None))),
        None
    );
    interlock.begin(
        Allowance {
            continues: true,
            charge_coulomb: (Coulombs(-10.0), Coulombs(590.0)),
            held_v: Volts(0.0),
            ..holding
        },
        Seconds(200.0),
    );
    let reading = Reading {
        time_s: Seconds(201.0),
        voltage_v: Some(Volts(4.15)),
        current_a: Some(Amps(3.0)),
        ..Reading::default()
    };
    assert!(
        interlock
            .judge(&reading, Seconds(201.0))
            .is_some_and(|trip| trip.to_string().starts_with("net charge of the step 600"))
    );
}

#[test]
fn a_meter_that_stands_still_under_a_slow_sinusoid_trips_and_a_coarse_one_at_rest_does_not() {
    let swinging = |period_s: Option<f64>| {
        let mut interlock = Interlock::new(SETTINGS, LIMITS, false);
        interlock.begin(
            Allowance {
                live: true,
                charge_coulomb: FREE,
                swing_s: period_s.map(Seconds),
                ..Allowance::idle(LIMITS)
            },
            Seconds(0.0),
        );
        interlock
    };
    let phase = |t: f64| (std::f64::consts::TAU * t / 10.0).sin();
    // Whole millivolts and tenths of an ampere.
    let volts = move |t: f64| (1000.0 * (3.8 + 0.009 * phase(t))).round() / 1000.0;
    let amps = move |t: f64| (10.0 * phase(t)).round() / 10.0;
    type Case = (Option<f64>, Course, Option<(&'static str, f64)>);
    let cases: [Case; 6] = [
        (
            Some(10.0),
            Box::new(move |t| (volts(t), amps(t), None)),
            None,
        ),
        (
            Some(10.0),
            Box::new(move |t| (3.8, amps(t), None)),
            Some((
                "time in which the cell voltage stood still under a sinusoid 31",
                32.0,
            )),
        ),
        (
            Some(10.0),
            Box::new(move |t| (volts(t), 0.3, None)),
            Some((
                "time in which the cell current stood still under a sinusoid 31",
                32.0,
            )),
        ),
        // At least two periods.
        (
            Some(20.0),
            Box::new(move |t| (3.8, amps(t), None)),
            Some((
                "time in which the cell voltage stood still under a sinusoid 41",
                42.0,
            )),
        ),
        // A fast sinusoid is averaged out, and at rest nothing changes.
        (None, Box::new(|_| (3.8, 0.0, None)), None),
        (None, Box::new(|_| (3.8, 0.1, None)), None),
    ];
    for (period_s, of, expected) in cases {
        let tripped = play(&mut swinging(period_s), course(300, of));
        let right = match (&tripped, expected) {
            (Some((found, time_s)), Some((text, at_s))) => {
                found.starts_with(text) && *time_s == at_s
            }
            (found, expected) => found.is_none() && expected.is_none(),
        };
        assert!(right, "{expected:?}: {tripped:?}");
    }
    // A value that did not change under the previous fast sinusoid does not count against the slow
    // one.
    let mut interlock = swinging(None);
    assert_eq!(
        play(&mut interlock, course(100, |_| (3.8, 0.0, None))),
        None
    );
    interlock.begin(
        Allowance {
            continues: true,
            ..Allowance {
                live: true,
                swing_s: Some(Seconds(10.0)),
                ..Allowance::idle(LIMITS)
            }
        },
        Seconds(100.0),
    );
    let later = (101..=300).map(f64::from).map(|t| Reading {
        time_s: Seconds(t),
        voltage_v: Some(Volts(volts(t))),
        current_a: Some(Amps(amps(t))),
        ..Reading::default()
    });
    assert_eq!(play(&mut interlock, later), None);
    // The voltage of copper is negligible: only its current is judged.
    let mut copper = swinging(None);
    copper.begin(
        Allowance {
            live: true,
            swing_s: Some(Seconds(10.0)),
            cell: false,
            ..Allowance::idle(LIMITS.of_control())
        },
        Seconds(0.0),
    );
    assert_eq!(
        play(&mut copper, course(100, move |t| (0.0, amps(t), None))),
        None
    );
}

#[test]
fn a_gap_in_the_temperatures_trips_even_when_it_ends() {
    let mut interlock = live(FREE);
    let reading = |time_s: f64, temperature_degc| Reading {
        time_s: Seconds(time_s),
        voltage_v: Some(Volts(3.8 - 1.0e-4 * time_s)),
        temperature_degc,
        ..Reading::default()
    };
    for time_s in 1..=6 {
        assert_eq!(
            interlock.judge(
                &reading(10.0 * f64::from(time_s), None),
                Seconds(10.0 * f64::from(time_s))
            ),
            None
        );
    }
    let trip = interlock
        .judge(&reading(61.0, Some(Celsius(25.0))), Seconds(61.0))
        .map(|trip| trip.to_string())
        .unwrap_or_default();
    assert!(
        trip.starts_with("time without a cell temperature 61.0000 s left its limits (0 s to 60 s)"),
        "{trip}"
    );
}

#[test]
fn a_temperature_that_is_meant_to_change_may_change() {
    let mut interlock = Interlock::new(SETTINGS, LIMITS, true);
    interlock.begin(
        Allowance {
            tempering: true,
            ..Allowance::idle(LIMITS)
        },
        Seconds(0.0),
    );
    assert_eq!(
        play(
            &mut interlock,
            course(120, |t| (3.7, 0.0, Some(20.0 + 0.2 * t)))
        ),
        None
    );
}

#[test]
fn a_chiller_that_stopped_or_has_an_alarm_trips() {
    let interlock = live(FREE);
    let status = |running, alarm: bool| chiller::Status {
        running,
        remote: true,
        alarm: alarm.then(|| "-01 LOW LEVEL ALARM".to_owned()),
        raw: "02 REMOTE STOP".to_owned(),
    };
    assert_eq!(interlock.chiller(&status(true, false), Seconds(7.0)), None);
    for status in [status(false, false), status(true, true)] {
        let trip = interlock
            .chiller(&status, Seconds(7.0))
            .map(|trip| trip.to_string());
        assert_eq!(
            trip.as_deref(),
            Some("chiller: expected it to run without an alarm, found `02 REMOTE STOP` at 7.0 s")
        );
    }
}

/// A sine of 1 A and 10 s that restarts after 7 s: its mean over the last ten seconds is not the
/// mean of a period until a complete one was read.
#[test]
fn a_signal_that_begins_anew_has_no_mean_of_what_was_before_and_one_with_an_offset_still_trips() {
    let mean = Some(Mean {
        period_s: Seconds(10.0),
        around_a: Amps(0.0),
        greatest_a: Amps(0.2),
        amplitude_a: Some(Amps(1.0)),
    });
    let sine = |since_s: f64, offset_a: f64| {
        move |t: f64| {
            (
                3.8 + 1.0e-3 * t.sin(),
                offset_a + (std::f64::consts::TAU * 0.1 * (t - since_s)).sin(),
                Some(25.0 + 0.01 * t),
            )
        }
    };
    let begun = || {
        let mut interlock = live(FREE);
        interlock.begin(
            Allowance {
                live: true,
                mean,
                ..Allowance::idle(LIMITS)
            },
            Seconds(0.0),
        );
        interlock
    };
    let both = |interlock: &mut Interlock, lost: bool| {
        assert_eq!(play(interlock, course(7, sine(0.0, 0.0))), None);
        if lost {
            interlock.lose_period();
        }
        play(interlock, course(57, sine(7.0, 0.0)).skip(7))
    };
    assert!(
        both(&mut begun(), false)
            .is_some_and(|(text, _)| text.starts_with("mean of the cell current"))
    );
    assert_eq!(both(&mut begun(), true), None);
    let tripped = play(&mut begun(), course(60, sine(0.0, 0.3)));
    assert!(tripped.is_some_and(
        |(text, time_s)| text.starts_with("mean of the cell current 0.3") && time_s <= 12.0
    ));
}

/// A sine of 1 A and 10 s about 5 A.
#[test]
fn a_sine_about_a_direct_current_has_its_mean_and_its_charge_there() {
    let mean = Some(Mean {
        period_s: Seconds(10.0),
        around_a: Amps(5.0),
        greatest_a: Amps(0.2),
        amplitude_a: Some(Amps(1.0)),
    });
    let about = |direct_a: f64| {
        move |t: f64| {
            (
                3.8 + 1.0e-3 * t.sin() + 1.0e-4 * t,
                direct_a + (std::f64::consts::TAU * 0.1 * t).sin(),
                Some(25.0 + 0.01 * t),
            )
        }
    };
    let begun = |steady_a: f64, mean: Option<Mean>| {
        let most_coulomb = if mean.is_some() { 1.0e4 } else { 20.0 };
        let mut interlock = live(FREE);
        interlock.begin(
            Allowance {
                live: true,
                charge_coulomb: (Coulombs(-most_coulomb), Coulombs(most_coulomb)),
                mean,
                ..Allowance::idle(LIMITS)
            },
            Seconds(0.0),
        );
        interlock.steady(Amps(steady_a));
        interlock
    };
    let mut sound = begun(5.0, mean);
    assert_eq!(play(&mut sound, course(100, about(5.0))), None);
    // Only the alternating part counts.
    let effective_a = sound.effective_a().unwrap_or(Amps::NAN);
    assert!(
        (effective_a - Amps(0.5_f64.sqrt())).abs() < Amps(0.02),
        "{effective_a}"
    );
    // A current that is missing or too large is found within a period.
    for direct_a in [0.0, 4.7, 5.3] {
        let tripped = play(&mut begun(5.0, mean), course(60, about(direct_a)));
        assert!(
            tripped.is_some_and(
                |(text, time_s)| text.starts_with("mean of the cell current ")
                    && text.contains("4.8")
                    && time_s <= 12.0
            ),
            "{direct_a} A"
        );
    }
    assert_eq!(play(&mut begun(5.0, None), course(100, about(5.0))), None);
    // A charge that was not commanded counts against the limits of a sinusoid.
    let tripped = play(&mut begun(4.5, None), course(100, about(5.0)));
    let (text, _) = tripped.unwrap_or_default();
    assert!(text.starts_with("net charge of the step 2"), "{text}");
}

#[test]
fn a_pair_of_readings_at_unsure_times_is_judged_by_what_the_times_may_do() {
    let mean = Mean {
        period_s: Seconds(0.4),
        around_a: Amps(0.0),
        greatest_a: Amps(0.2),
        amplitude_a: Some(Amps(1.0)),
    };
    assert_eq!(mean.pair_s(), Some(Seconds(0.2)));
    assert!(
        mean.judge_pair(Amps(0.25), Seconds(0.0), Seconds(1.0))
            .is_some()
            && mean
                .judge_pair(Amps(0.25), Seconds(0.02), Seconds(1.0))
                .is_none()
    );
    // 20 ms are a twentieth of the period: the limit is 0.2 A and 1 A · sin(π/20).
    assert!(
        mean.judge_pair(Amps(0.35), Seconds(0.02), Seconds(1.0))
            .is_none()
            && mean
                .judge_pair(Amps(-0.37), Seconds(0.02), Seconds(1.0))
                .is_some()
    );
    assert_eq!(
        Mean {
            amplitude_a: None,
            ..mean
        }
        .pair_s(),
        None
    );
    // A period of 5 s is read often enough for its mean even if a reading takes half a second.
    assert!(
        Mean {
            period_s: Seconds(5.0),
            ..mean
        }
        .poll_s()
            + Seconds(0.5)
            < Seconds(5.0 / 4.0)
    );
}

#[test]
fn the_zero_of_an_ammeter_is_not_a_charge_and_more_than_a_zero_is() {
    let net = |zero_a: f64| {
        let mut interlock = live((Coulombs(-100.0), Coulombs(100.0)));
        interlock.zero(Amps(zero_a));
        let moving = |t: f64| {
            (
                3.7 + 1.0e-5 * t,
                0.04 + 0.001 * (t % 2.0),
                Some(25.0 + 0.001 * (t % 3.0)),
            )
        };
        play(&mut interlock, course(4000, moving)).map(|(text, _)| text)
    };
    assert_eq!(net(0.0405), None);
    // The first zero is not known; the second is implausible.
    for zero_a in [0.0, 0.5] {
        assert!(
            net(zero_a).is_some_and(|text| text.starts_with("net charge of the step 100.")),
            "{zero_a}"
        );
    }
}
