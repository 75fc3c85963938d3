//! The bipolar supply's driver: the current and voltage that the cell would have seen, in order.

use instruments::{
    clock::Clock,
    exchange::{Exchange, play},
    instrument::Instrument,
    link::LinkProfile,
    mock::{MockOptions, plant::BipolarState},
    scpi::decode::Terminator,
    supply4q::{self, Limits, Supply4q},
    transcript::Tap,
    transport::MemoryHub,
    units::{Amps, Volts},
};

use crate::{
    device::{Reply, now, open, serve_memory},
    drivers_common::{Rig, dialect, in_virtual_time},
};

const SWITCHING: &str = "kepco-bop-mg";
const LINEAR: &str = "kepco-bop-linear";
const LIMITS: Limits = Limits {
    compliance: Volts(4.3),
    current: Amps(3.0),
};
/// A previous user left a voltage on the output and an analog command.
const UNRULY: [&str; 6] = [
    "CURR 2",
    "VOLT 12",
    "VOLT:LIM 40",
    "CURR:MODE EXT",
    "VOLT:PROT:MODE EXT",
    "OUTP ON",
];

async fn driver(rig: &Rig, model: &str) -> Supply4q {
    let dialect = dialect!(supply4q, model);
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

fn off_active(active: bool) -> MockOptions {
    MockOptions::quirk("off_active", active)
}

/// The output is on only as this bench means it, and when off, open from the first change on.
fn assert_never_dangerous(states: &[BipolarState]) {
    for (index, state) in states.iter().enumerate() {
        let meant = state.current_mode
            && state.analog_input
            && state.off_is_open
            && (state.limit - LIMITS.compliance.value()).abs() < 1e-9;
        assert!(!state.output_on || meant, "step {index}: {state:?}");
        assert!(
            index == 0 || state.output_on || state.off_is_open,
            "step {index} shorts the cell: {state:?}"
        );
    }
}

#[test]
fn the_switching_family_goes_up_and_down_in_the_safe_order_whatever_it_had_stored() {
    for active in [false, true] {
        in_virtual_time(async |clock| {
            let rig = Rig::with(clock, SWITCHING, &off_active(active), &[]);
            let mut supply = driver(&rig, SWITCHING).await;
            assert_eq!(rig.drives()[0].off_is_open, !active);
            supply.prepare(&LIMITS).await.unwrap();
            let prepared = *rig.drives().last().unwrap();
            let expected = BipolarState {
                output_on: false,
                current_mode: true,
                analog_input: false,
                setpoint: 0.0,
                limit: 4.3,
                off_is_open: true,
            };
            assert_eq!(prepared, expected);
            assert!(
                rig.drives()
                    .iter()
                    .all(|state| !state.output_on && !state.analog_input),
                "preparing drives nothing"
            );
            supply.energise().await.unwrap();
            assert_eq!(
                *rig.drives().last().unwrap(),
                BipolarState {
                    output_on: true,
                    analog_input: true,
                    ..expected
                }
            );
            assert_eq!(supply.measure().await.unwrap(), (Volts(3.75), Amps(-2.5)));
            let on = rig.drives().len();
            supply.safe().await.unwrap();
            let down = rig.drives();
            assert_eq!(*down.last().unwrap(), expected);
            // The analog input is released only when the output is off: before, the digital
            // set-point would take over.
            assert!(
                down[on..]
                    .iter()
                    .all(|state| !state.output_on || state.analog_input),
                "{:?}",
                &down[on..]
            );
            assert_never_dangerous(&down);
            supply.safe().await.unwrap();
            assert_never_dangerous(&rig.drives());
        });
    }
}

#[test]
fn the_words_to_the_switching_family_are_those_of_its_manual_in_this_order() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, SWITCHING);
        let mut supply = driver(&rig, SWITCHING).await;
        supply.prepare(&LIMITS).await.unwrap();
        supply.energise().await.unwrap();
        supply.safe().await.unwrap();
        drop(supply);
        let commands: Vec<String> = rig
            .sent()
            .into_iter()
            .filter(|message| !message.contains('?'))
            .collect();
        let off = ["OUTP:MODE BATTERY", "OUTP OFF"];
        let prepare = [
            "FUNC:MODE CURR",
            "CURR:MODE FIX",
            "CURR 0.0000",
            "VOLT 4.3000",
            "VOLT:PROT:MODE FIX",
            "CURR:PROT:MODE FIX",
        ];
        let expected = [
            &off[..],
            &prepare,
            &["CURR:LIM 3.0000", "CURR:MODE EXT", "OUTP ON"],
            &off,
            &["CURR:MODE FIX"],
        ]
        .concat();
        assert_eq!(commands, expected);
        assert_eq!(rig.ask("CURR:LIM?").await, "3.0E0, -3.0E0");
    });
}

/// Prepares a supply that a previous user left on, holding a voltage, with its analog input in
/// command.
async fn after_an_unruly_user(clock: Clock, prepares: bool) -> Rig {
    let rig = Rig::with(clock, SWITCHING, &off_active(true), &[]);
    rig.earlier_user(Terminator::Lf, &UNRULY).await;
    rig.plant.lock().unwrap().actions.clear();
    let mut supply = driver(&rig, SWITCHING).await;
    if prepares {
        supply.prepare(&LIMITS).await.unwrap();
    } else {
        supply.safe().await.unwrap();
    }
    rig
}

#[test]
fn a_supply_that_was_left_on_is_opened_before_anything_else() {
    in_virtual_time(async |clock| {
        for prepares in [true, false] {
            let rig = after_an_unruly_user(clock.clone(), prepares).await;
            let states = rig.drives();
            // First the choice of what off means, then off: neither mode nor set-point change while
            // it is on.
            assert!(
                states[0].output_on
                    && states[0].off_is_open
                    && states[0].analog_input
                    && !states[0].current_mode,
                "{:?}",
                states[0]
            );
            assert!(
                !states[1].output_on && states[1].off_is_open,
                "{:?}",
                states[1]
            );
            assert!(
                states[1..]
                    .iter()
                    .all(|state| !state.output_on && state.off_is_open),
                "{states:?}"
            );
            assert!(!states.last().unwrap().analog_input);
        }
        let rig = after_an_unruly_user(clock, true).await;
        assert_eq!(
            (
                rig.ask("VOLT:PROT:MODE?").await,
                rig.ask("CURR:MODE?").await
            ),
            ("FIXED".to_owned(), "FIX".to_owned())
        );
        assert_eq!(rig.ask("SYST:ERR?").await, "0,\"No error\"");
    });
}

#[test]
fn switching_off_does_not_stop_at_a_supply_that_will_not_choose_its_off_behaviour() {
    in_virtual_time(async |clock| {
        let rig = Rig::with(
            clock,
            SWITCHING,
            &off_active(false),
            &[("OUTP:MODE?", b"ACTIVE\n")],
        );
        rig.earlier_user(Terminator::Lf, &UNRULY).await;
        let mut supply = driver(&rig, SWITCHING).await;
        let expected = "dev: after `OUTP:MODE BATTERY`, `OUTP:MODE?` answered `ACTIVE`: expected \
        one of BATTERY, BATT";
        assert_eq!(supply.safe().await.unwrap_err().to_string(), expected);
        let last = *rig.drives().last().unwrap();
        assert!(!last.output_on && !last.analog_input, "{last:?}");
        // Such a supply is neither prepared nor energised.
        assert_eq!(
            supply.prepare(&LIMITS).await.unwrap_err().to_string(),
            expected
        );
    });
}

#[test]
fn switching_off_goes_on_over_a_new_connection_when_an_answer_stays_away() {
    in_virtual_time(async |clock| {
        let rig = Rig::with(clock, SWITCHING, &off_active(true), &[("OUTP:MODE?", b"")]);
        rig.earlier_user(Terminator::Lf, &UNRULY).await;
        let error = driver(&rig, SWITCHING)
            .await
            .safe()
            .await
            .unwrap_err()
            .to_string();
        assert_eq!(
            error,
            "dev: expected an answer to `OUTP:MODE?` within 2s, found none"
        );
        let last = *rig.drives().last().unwrap();
        assert!(
            !last.output_on && last.off_is_open && !last.analog_input,
            "{last:?}"
        );
        assert_eq!(
            rig.sent()
                .iter()
                .filter(|message| *message == "OUTP OFF")
                .count(),
            1,
            "{:?}",
            rig.sent()
        );
    });
}

/// The question is repeated while an instrument is late, the command never.
#[test]
fn a_read_back_that_is_late_is_believed_and_one_that_never_comes_true_is_not() {
    for (right_from, succeeds) in [(1, true), (4, true), (100, false)] {
        in_virtual_time(async |clock| {
            let hub = MemoryHub::new();
            let mut asked = 0;
            let script = move |message: &str| match message {
                "OUTP?" => {
                    asked += 1;
                    now(if asked >= right_from { "0\n" } else { "1\n" })
                }
                "SYST:ERR?" => now("0,\"No error\"\n"),
                _ => Reply::Silence,
            };
            let heard = serve_memory(&hub, &clock, script);
            let mut link = open(
                "memory:device",
                LinkProfile::scpi(),
                &clock,
                &hub,
                Tap::none(),
            )
            .await
            .unwrap();
            let outcome = play(&mut link, &[], &[Exchange::switch("OUTP", false)]).await;
            let text = "dev: after `OUTP OFF`, `OUTP?` answered `1`: expected 0 or OFF";
            assert_eq!(
                outcome.map_err(|error| error.to_string()),
                if succeeds {
                    Ok(())
                } else {
                    Err(text.to_owned())
                }
            );
            assert_eq!(
                heard
                    .lock()
                    .unwrap()
                    .iter()
                    .filter(|(_, message)| message == "OUTP OFF")
                    .count(),
                1
            );
        });
    }
}

#[test]
fn the_linear_family_never_receives_what_it_does_not_know_and_obeys_its_wiring() {
    for wired in [true, false] {
        in_virtual_time(async |clock| {
            let rig = Rig::with(
                clock,
                LINEAR,
                &MockOptions::quirk("analog_wired", wired),
                &[],
            );
            let mut supply = driver(&rig, LINEAR).await;
            supply.prepare(&LIMITS).await.unwrap();
            assert!(rig.drives().iter().all(|state| !state.output_on));
            supply.energise().await.unwrap();
            let on = *rig.drives().last().unwrap();
            assert!(
                on.output_on
                    && on.current_mode
                    && on.analog_input == wired
                    && on.setpoint == 0.0
                    && on.limit == 4.3,
                "{on:?}"
            );
            supply.safe().await.unwrap();
            let all = rig.drives();
            assert!(
                all.iter()
                    .all(|state| !state.output_on || state.current_mode),
                "{all:?}"
            );
            assert!(!all.last().unwrap().output_on && all.last().unwrap().off_is_open);
            assert_eq!(supply.measure().await.unwrap(), (Volts(3.75), Amps(-2.5)));
            for word in ["CURR:MODE", "VOLT:MODE", "OUTP:MODE", "PROT", "LIM"] {
                assert!(
                    !rig.sent().iter().any(|message| message.contains(word)),
                    "{word} in {:?}",
                    rig.sent()
                );
            }
        });
    }
}

#[test]
fn a_linear_supply_that_was_left_holding_a_voltage_is_in_current_mode_before_it_is_off() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, LINEAR);
        rig.earlier_user(Terminator::Lf, &["VOLT 4", "CURR 1", "OUTP ON"])
            .await;
        driver(&rig, LINEAR).await.safe().await.unwrap();
        assert!(
            rig.drives()
                .iter()
                .skip(4)
                .all(|state| state.output_on || state.current_mode),
            "{:?}",
            rig.drives()
        );
        assert!(!rig.drives().last().unwrap().output_on);
    });
}

#[test]
fn the_wrong_family_is_refused_before_it_is_energised() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, LINEAR);
        let refused = driver(&rig, SWITCHING)
            .await
            .prepare(&LIMITS)
            .await
            .unwrap_err();
        assert_eq!(
            refused.to_string(),
            "dev: `OUTP:MODE BATTERY` was refused: -113, Undefined header"
        );
        assert!(rig.drives().iter().all(|state| !state.output_on));
    });
}

#[test]
fn limits_that_the_instrument_cannot_hold_are_refused_by_name() {
    in_virtual_time(async |clock| {
        for (model, earlier, limits, text) in [
            (
                SWITCHING,
                "*CLS",
                Limits {
                    compliance: Volts(60.0),
                    ..LIMITS
                },
                "dev: `VOLT 60.0000` was refused: -222, Data out of range",
            ),
            (
                SWITCHING,
                "*CLS",
                Limits {
                    current: Amps(25.0),
                    ..LIMITS
                },
                "dev: `CURR:LIM 25.0000` was refused: -222, Data out of range",
            ),
            (
                LINEAR,
                "*CLS",
                Limits {
                    compliance: Volts(24.0),
                    ..LIMITS
                },
                "dev: `VOLT 24.0000` was refused: -222, Data out of range",
            ),
            // A limit that a previous user stored, and a remote pin that holds the output.
            (
                SWITCHING,
                "VOLT:LIM 4",
                LIMITS,
                "dev: `VOLT 4.3000` was refused: -222, Data out of range",
            ),
            (
                SWITCHING,
                "OUTP:CONT HIGH",
                LIMITS,
                "dev: `OUTP OFF` was refused: -221, Settings conflict",
            ),
        ] {
            let rig = Rig::new(clock.clone(), model);
            rig.earlier_user(Terminator::Lf, &[earlier]).await;
            let mut supply = driver(&rig, model).await;
            assert_eq!(supply.prepare(&limits).await.unwrap_err().to_string(), text);
            assert!(rig.drives().iter().all(|state| !state.output_on));
        }
    });
}

#[test]
fn a_limit_that_came_out_on_one_side_only_is_not_believed() {
    in_virtual_time(async |clock| {
        let rig = Rig::lying(clock, SWITCHING, &[("CURR:LIM?", b"3.0E0, -2.0E1\n")]);
        let refused = driver(&rig, SWITCHING)
            .await
            .prepare(&LIMITS)
            .await
            .unwrap_err();
        let text = "dev: after `CURR:LIM 3.0000`, `CURR:LIM?` answered `3.0E0, -2.0E1`: expected \
        two numbers within 5.0e-3 of ±3";
        assert_eq!(refused.to_string(), text);
    });
}

#[test]
fn an_error_of_somebody_else_is_not_taken_for_ours() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, SWITCHING);
        rig.earlier_user(Terminator::Lf, &["NONSENSE", "CURR 99"])
            .await;
        driver(&rig, SWITCHING)
            .await
            .prepare(&LIMITS)
            .await
            .unwrap();
    });
}

#[test]
fn commands_keep_the_distance_that_the_lan_card_needs() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, SWITCHING);
        let mut supply = driver(&rig, SWITCHING).await;
        supply.prepare(&LIMITS).await.unwrap();
        supply.energise().await.unwrap();
        let times: Vec<f64> = rig
            .plant
            .lock()
            .unwrap()
            .actions
            .iter()
            .map(|(t_s, _)| *t_s)
            .collect();
        assert!(
            times.len() > 6
                && times[1..]
                    .windows(2)
                    .all(|pair| pair[1] - pair[0] >= 0.035 - 1e-9),
            "{times:?}"
        );
    });
}

#[test]
fn no_reading_is_an_error_and_not_a_voltage() {
    in_virtual_time(async |clock| {
        for (answer, shown) in [
            (&b"9.91E37\n"[..], "9.91E37"),
            (b"-9.9E37\n", "-9.9E37"),
            (b"OVLD\n", "OVLD"),
        ] {
            let lies: Vec<(&'static str, &'static [u8])> = vec![("MEAS:VOLT?", answer)];
            let rig = Rig::with(clock.clone(), SWITCHING, &MockOptions::default(), &lies);
            let error = driver(&rig, SWITCHING).await.measure().await.unwrap_err();
            assert_eq!(
                error.to_string(),
                format!("dev: `MEAS:VOLT?` answered `{shown}`: expected a number")
            );
        }
    });
}
