//! Units whose firmware lacks a query or has coarser steps, and settings that a bench file states.

use instruments::{
    chiller::{self, Chiller},
    clock::{Clock, TimeMode},
    generator::{self, Generator, Sine},
    instrument::Instrument,
    link::{Link, LinkError, LinkOptions},
    load::{self, Discharge, Draw, Load},
    mock::{self, MockOptions, plant::Action},
    scope::{self, Intent, Scope},
    supply::{self, Charge, Supply},
    supply4q::{self, Limits, Supply4q},
    transcript::Tap,
    transport::MemoryHub,
    units::{Amps, Celsius, Hertz, Volts},
};

use crate::{
    device::SharedText,
    drivers_common::{Rig, dialect, in_virtual_time},
    mocks_plant::Recorder,
};

fn lacking(text: &str) -> MockOptions {
    MockOptions::quirk("lacks", text)
}

#[test]
fn a_generator_that_does_not_answer_a_burst_is_driven_without_bursts() {
    in_virtual_time(async |clock| {
        let rig = Rig::with(clock, "siglent-sdg1000x", &lacking("BTWV?"), &[]);
        let dialect = dialect!(generator, "siglent-sdg1000x");
        let mut sdg: Generator = Instrument::new(rig.link(dialect.profile()).await, dialect);
        sdg.identify().await.unwrap();
        sdg.output(false).await.unwrap();
        sdg.quiet(Volts(0.0)).await.unwrap();
        let asked = rig.sent().iter().filter(|text| *text == "C1:BTWV?").count();
        assert_eq!(asked, 2, "once more on a new connection, then never again");
        sdg.quiet(Volts(0.0)).await.unwrap();
        let sine = Sine {
            freq: Hertz(1.0),
            amplitude: Volts(0.5),
            offset: Volts(0.0),
        };
        sdg.sine(&sine).await.unwrap();
        let asked_again = rig.sent().iter().filter(|text| *text == "C1:BTWV?").count();
        assert_eq!(asked_again, asked);
        // An end that cannot be read back must not be relied on.
        let refused = sdg.burst(Some(10)).await.unwrap_err();
        assert!(matches!(refused, LinkError::Unexpected { .. }), "{refused}");
        assert!(
            !rig.sent().iter().any(|text| text.contains("STATE,ON")),
            "{:?}",
            rig.sent()
        );
        let notes = sdg.link_mut().notes().join("; ");
        assert!(
            notes.contains("`C1:BTWV?` is not known on this unit: whether a burst"),
            "{notes}"
        );
    });
}

#[test]
fn a_query_that_must_be_answered_still_ends_the_script() {
    in_virtual_time(async |clock| {
        let rig = Rig::with(clock, "siglent-sdg1000x", &lacking("BSWV?"), &[]);
        let dialect = dialect!(generator, "siglent-sdg1000x");
        let mut sdg: Generator = Instrument::new(rig.link(dialect.profile()).await, dialect);
        let error = sdg.direct(Volts(0.1)).await.unwrap_err();
        assert!(matches!(error, LinkError::Timeout { .. }), "{error}");
    });
}

#[test]
fn a_bath_and_a_scope_are_used_without_what_their_firmware_lacks() {
    in_virtual_time(async |clock| {
        let rig = Rig::with(clock.clone(), "julabo", &lacking("IN_MODE_04"), &[]);
        let dialect = dialect!(chiller, "julabo");
        let mut bath: Chiller = Instrument::new(rig.link(dialect.profile()).await, dialect);
        bath.identify().await.unwrap();
        bath.start(Celsius(25.0)).await.unwrap();
        assert!(bath.status().await.unwrap().running);
        let notes = bath.link_mut().notes().join("; ");
        assert!(
            notes.contains("which sensor controls the bath is not known"),
            "{notes}"
        );
        for lacks in [":SYSTem:ERRor?", ":CHAN1:INV?"] {
            let rig = Rig::with(clock.clone(), "rigol-dho800", &lacking(lacks), &[]);
            let dialect = dialect!(scope, "rigol-dho800");
            let mut dho: Scope = Instrument::new(rig.link(dialect.profile()).await, dialect);
            dho.identify().await.unwrap();
            let vertical = scope::Vertical {
                channel: 1,
                per_div: Volts(0.02),
                offset: Volts(0.0),
            };
            dho.set(&Intent::Vertical(vertical)).await.unwrap();
            dho.set(&Intent::Arm).await.unwrap();
            dho.set(&Intent::Arm).await.unwrap();
            let notes = dho.link_mut().notes().join("; ");
            assert!(
                notes.contains(&format!("`{lacks}` is not known on this unit")),
                "{notes}"
            );
        }
    });
}

#[test]
fn an_error_in_the_queue_of_a_scope_is_reported() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, "rigol-dho800");
        rig.earlier_user(instruments::scpi::decode::Terminator::Lf, &[":NONSense 1"])
            .await;
        let dialect = dialect!(scope, "rigol-dho800");
        let mut dho: Scope = Instrument::new(rig.link(dialect.profile()).await, dialect);
        dho.set(&Intent::Arm).await.unwrap();
        let notes = dho.link_mut().notes().join("; ");
        assert!(notes.contains("its error queue held: -113"), "{notes}");
        // A depth that a DHO802 with four channels does not have is not sent.
        let deep = Intent::Session {
            memory_points: 10_000_000,
        };
        let error = dho.set(&deep).await.unwrap_err().to_string();
        assert!(error.contains("expected at most 1000000 points"), "{error}");
    });
}

#[test]
fn a_setting_of_a_scope_that_stands_is_not_sent_again_and_a_change_by_a_hand_is_found_in_turn() {
    in_virtual_time(async |clock| {
        for (model, hand, question) in [
            (
                "siglent-sds800x-hd",
                ":CHANnel1:COUPling AC",
                "`:CHANnel1:COUPling?`",
            ),
            ("rigol-dho800", ":CHAN1:COUP AC", "`:CHAN1:COUP?`"),
        ] {
            let rig = Rig::new(clock.clone(), model);
            let dialect = dialect!(scope, model);
            let mut scope: Scope = Instrument::new(rig.link(dialect.profile()).await, dialect);
            let vertical = Intent::Vertical(scope::Vertical {
                channel: 1,
                per_div: Volts(0.02),
                offset: Volts(0.0),
            });
            let level = |level| {
                Intent::Trigger(scope::Trigger {
                    channel: 2,
                    level: Volts(level),
                })
            };
            scope.set(&vertical).await.unwrap();
            scope.set(&level(0.001)).await.unwrap();
            let before = rig.sent().len();
            scope.set_changes(&level(0.001)).await.unwrap();
            scope.set_changes(&vertical).await.unwrap();
            assert_eq!(rig.sent().len(), before, "{model}: nothing has changed");
            scope.set_changes(&level(0.002)).await.unwrap();
            assert_eq!(rig.sent().len(), before + 1, "{model}: only the level has");
            for _ in 0..12 {
                assert_eq!(scope.check_in_turn().await.unwrap(), None, "{model}");
            }
            rig.earlier_user(instruments::scpi::decode::Terminator::Lf, &[hand])
                .await;
            scope.link_mut().reconnect().await.unwrap();
            let mut found = None;
            for _ in 0..12 {
                found = found.or(scope.check_in_turn().await.unwrap());
            }
            let found = found.unwrap_or_default();
            assert!(found.contains(question), "{model}: {found}");
            // Then everything is sent again.
            let before = rig.sent().len();
            scope.set_changes(&vertical).await.unwrap();
            assert!(rig.sent().len() > before + 10, "{model}");
        }
    });
}

#[test]
fn a_charger_of_coarser_steps_is_set_below_what_was_asked_and_says_so() {
    in_virtual_time(async |clock| {
        let charge = Charge {
            voltage: Volts(4.185),
            current: Amps(1.256),
        };
        for model in ["siglent-spd3303x", "rigol-dp832"] {
            for (step, set, noted) in [(0.001, (4.185, 1.256), false), (0.01, (4.18, 1.25), true)] {
                let options = MockOptions::quirk("step", step);
                let rig = Rig::with(clock.clone(), model, &options, &[]);
                let dialect = dialect!(supply, model);
                let link = rig.link(dialect.profile()).await;
                let mut charger: Supply = Instrument::new(link, dialect);
                charger.prepare(&charge).await.unwrap();
                charger.energise().await.unwrap();
                let Action::Supply(state) = rig.last_action() else {
                    panic!("a supply");
                };
                let near = |one: f64, other: f64| (one - other).abs() < 1.0e-9;
                assert!(
                    near(state.voltage_v, set.0) && near(state.current_a, set.1),
                    "{model}: {state:?}"
                );
                // Nothing above what was asked was ever on.
                assert!(
                    rig.actions().iter().all(|action| !matches!(action,
                        Action::Supply(state) if state.output_on && state.voltage_v > 4.185 + 1e-9)),
                    "{model}"
                );
                let notes = charger.link_mut().notes().join("; ");
                assert_eq!(notes.contains("rounded down"), noted, "{model}: {notes}");
                charger.level(Amps(0.504)).await.unwrap();
                let Action::Supply(state) = rig.last_action() else {
                    panic!("a supply");
                };
                assert!(
                    near(state.current_a, if noted { 0.5 } else { 0.504 }),
                    "{state:?}"
                );
                assert_eq!(charger.differs().await.unwrap(), None, "{model}");
            }
        }
    });
}

#[test]
fn a_load_measures_where_the_bench_file_says_and_without_sense_with_the_drop_of_its_leads() {
    in_virtual_time(async |clock| {
        for (model, question) in [
            ("siglent-sdl1000x", "SYST:SENS?"),
            // This model measures at its sense terminals unless the bench file states otherwise.
            ("rigol-dl3000", ":SOUR:SENS?"),
        ] {
            let usual = model == "rigol-dl3000";
            let options = MockOptions::quirk("lead_ohm", 0.02);
            for remote in [None, Some(true), Some(false)] {
                let expected_v = if remote.unwrap_or(usual) { 3.7 } else { 3.67 };
                let rig = Rig::with(clock.clone(), model, &options, &[]);
                let dialect = dialect!(load, model);
                let link = rig.link(dialect.profile()).await;
                let load: Load = Instrument::new(link, dialect);
                let mut load = load.sensing(remote);
                let discharge = Discharge {
                    draw: Draw::Current(Amps(1.5)),
                    stop_below: Volts(2.75),
                };
                load.prepare(&discharge).await.unwrap();
                load.energise().await.unwrap();
                let (volts, _) = load.measure().await.unwrap();
                assert!(
                    (volts.value() - expected_v).abs() < 1e-4,
                    "{model} {remote:?}: {volts}"
                );
                let asked = rig.sent().iter().any(|text| text == question);
                assert_eq!(asked, remote.is_some() || usual, "{model} {remote:?}");
                // A change at the panel is found while current flows.
                if remote == Some(true) {
                    let header = question.trim_end_matches('?');
                    rig.earlier_user(
                        instruments::scpi::decode::Terminator::Lf,
                        &[&format!("{header} OFF")],
                    )
                    .await;
                    load.link_mut().reconnect().await.unwrap();
                    let differs = load.differs().await.unwrap().unwrap_or_default();
                    assert!(differs.contains("remote sense"), "{model}: {differs}");
                }
            }
        }
    });
}

/// On a serial line a Kepco takes commands of its output in remote mode only.
#[test]
fn a_kepco_on_a_serial_line_is_put_into_remote_mode_first() {
    Clock::runtime(TimeMode::Real).unwrap().block_on(async {
        let clock = Clock::start(TimeMode::Real);
        let plant = std::sync::Arc::new(std::sync::Mutex::new(Recorder::default()));
        let device = mock::make("kepco-bop-mg", plant, &MockOptions::default()).unwrap();
        let (path, _serving) = mock::serve_pty(device, clock.clone()).unwrap();
        let dialect = dialect!(supply4q, "kepco-bop-mg");
        let tape = SharedText::default();
        let options = LinkOptions {
            name: "dev".to_owned(),
            address: format!("serial:{path}?baud=9600").parse().unwrap(),
            profile: dialect.profile(),
            clock: clock.clone(),
            hub: MemoryHub::new(),
            tap: Tap::new(tape.clone()),
        };
        let mut supply: Supply4q = Instrument::new(Link::open(options).await.unwrap(), dialect);
        let limits = Limits {
            compliance: Volts(5.0),
            current: Amps(3.0),
        };
        supply.prepare(&limits).await.unwrap();
        let sent: Vec<String> = tape
            .lines()
            .iter()
            .filter_map(|line| line.strip_prefix("dev > "))
            .filter(|line| *line != "SYST:ERR?")
            .map(str::to_owned)
            .collect();
        assert_eq!(sent[..2], ["SYST:REM ON", "SYST:REM?"], "{sent:?}");
    });
}
