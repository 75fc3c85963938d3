//! Second dialect of each role, with conventions that differ from the first: channel lists, `ON`
//! and `OFF` as replies, two line ends, hexadecimal registers.

use instruments::{
    chiller,
    generator::{self, Sine, Wave},
    instrument::Instrument,
    load::{self, Discharge, Draw, Load},
    mock::{
        MockOptions,
        plant::{Action, ChillerState, GeneratorState, LoadState, SupplyState},
    },
    scope::{self, Intent, Scope, Trigger, Vertical},
    scpi::decode::Terminator,
    supply::{self, Charge, Supply},
    units::{Amps, Celsius, Hertz, Seconds, Volts, Watts},
};

use crate::{
    drivers_common::{Rig, dialect, in_virtual_time},
    mocks_plant::{base_v, volts},
};

const CHARGE: Charge = Charge {
    voltage: Volts(4.2),
    current: Amps(1.25),
};

async fn supply(rig: &Rig, model: &str) -> Supply {
    let dialect = dialect!(supply, model);
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

async fn load(rig: &Rig) -> Load {
    let dialect = dialect!(load, "rigol-dl3000");
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

#[test]
fn a_supply_that_was_left_on_is_off_before_it_is_changed_and_charges_with_what_was_asked() {
    for (model, left) in [
        (
            "keysight-e36312a",
            &[
                "VOLT 6,(@1)",
                "CURR 5,(@1)",
                "VOLT:SENS:SOUR EXT,(@1)",
                "CURR:PROT:STAT ON,(@1)",
                "OUTP ON,(@1)",
            ][..],
        ),
        (
            "rigol-dp832",
            &[
                ":APPL CH1,30,3",
                ":OUTP:OVP:VAL CH1,31",
                ":OUTP:OCP CH1,ON",
                ":OUTP CH1,ON",
            ],
        ),
    ] {
        in_virtual_time(async |clock| {
            let rig = Rig::new(clock, model);
            rig.earlier_user(Terminator::Lf, &[left, &["NONSENSE"]].concat())
                .await;
            let start = rig.supplies().len();
            let mut supply = supply(&rig, model).await;
            supply.prepare(&CHARGE).await.unwrap();
            let states = rig.supplies()[start..].to_vec();
            assert!(
                states.iter().all(|state| !state.output_on),
                "{model}: {states:?}"
            );
            supply.energise().await.unwrap();
            assert_eq!(
                *rig.supplies().last().unwrap(),
                SupplyState {
                    output_on: true,
                    voltage_v: 4.2,
                    current_a: 1.25
                },
                "{model}"
            );
            // At its current limit, as a charge is: no protection takes that for a fault.
            assert_eq!(
                supply.measure().await.unwrap(),
                (Volts(4.0), Amps(1.25)),
                "{model}"
            );
            assert!(rig.supplies().last().unwrap().output_on, "{model}");
            supply.safe().await.unwrap();
            supply.safe().await.unwrap();
            assert!(!rig.supplies().last().unwrap().output_on, "{model}");
        });
    }
}

#[test]
fn the_protection_above_the_charge_is_armed_and_switches_off_by_itself() {
    for (model, armed, lower) in [
        (
            "keysight-e36312a",
            ("VOLT:PROT? (@1)", "+4.40000000E+00"),
            "VOLT:PROT 3.9,(@1)",
        ),
        (
            "rigol-dp832",
            (":OUTP:OVP:VAL? CH1", "4.400"),
            ":OUTP:OVP:VAL CH1,3.9",
        ),
    ] {
        in_virtual_time(async |clock| {
            let rig = Rig::new(clock, model);
            let mut supply = supply(&rig, model).await;
            supply.prepare(&CHARGE).await.unwrap();
            supply.energise().await.unwrap();
            drop(supply);
            assert_eq!(rig.ask(armed.0).await, armed.1, "{model}");
            // The terminals show 4.0 V.
            rig.earlier_user(Terminator::Lf, &[lower]).await;
            rig.ask("*IDN?").await;
            assert!(!rig.supplies().last().unwrap().output_on, "{model}");
            // And a latched protection is a refusal, not a charge that never comes.
            let mut supply = self::supply(&rig, model).await;
            supply.prepare(&CHARGE).await.unwrap();
            let refused = supply.energise().await.unwrap_err().to_string();
            assert!(
                refused.contains("expected ") && refused.contains("ON"),
                "{model}: {refused}"
            );
        });
    }
}

#[test]
fn what_a_supply_does_not_take_over_is_named() {
    in_virtual_time(async |clock| {
        for (model, charge, text) in [
            (
                "keysight-e36312a",
                Charge {
                    voltage: Volts(7.0),
                    ..CHARGE
                },
                "dev: `VOLT 7.000,(@1)` was refused: -222, Data out of range",
            ),
            (
                "rigol-dp832",
                Charge {
                    current: Amps(5.0),
                    ..CHARGE
                },
                "dev: `:SOUR1:CURR 5.000` was refused: -222, Data out of range",
            ),
            (
                "rigol-dp832",
                Charge {
                    voltage: Volts(f64::NAN),
                    ..CHARGE
                },
                "dev: `:SOUR1:VOLT`: `:SOUR1:VOLT`: expected a finite number to send, found NaN",
            ),
        ] {
            let rig = Rig::new(clock.clone(), model);
            let met = supply(&rig, model)
                .await
                .prepare(&charge)
                .await
                .unwrap_err()
                .to_string();
            assert!(met.starts_with(text), "{model}: {met}");
        }
        for (model, query, answer, text) in [
            (
                "keysight-e36312a",
                "OUTP? (@1)",
                &b"1\n"[..],
                "after `OUTP OFF,(@1)`, `OUTP? (@1)` answered `1`: expected one of 0, OFF",
            ),
            (
                "keysight-e36312a",
                "VOLT:SENS:SOUR? (@1)",
                b"EXT\n",
                "answered `EXT`: expected one of INT, INTernal",
            ),
            (
                "rigol-dp832",
                ":OUTP? CH1",
                b"ON\n",
                "after `:OUTP CH1,OFF`, `:OUTP? CH1` answered `ON`: expected one of OFF, 0",
            ),
            (
                "rigol-dp832",
                ":OUTP:OVP? CH1",
                b"OFF\n",
                "after `:OUTP:OVP CH1,ON`, `:OUTP:OVP? CH1` answered `OFF`: expected one of ON, 1",
            ),
        ] {
            let rig = Rig::lying(clock.clone(), model, &[(query, answer)]);
            let met = supply(&rig, model)
                .await
                .prepare(&CHARGE)
                .await
                .unwrap_err()
                .to_string();
            assert!(met.contains(text), "{model}: {met}");
        }
    });
}

#[test]
fn a_load_with_two_line_ends_is_read_and_one_left_on_in_another_mode_is_off_before_it_is_changed() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, "rigol-dl3000");
        rig.earlier_user(
            Terminator::Lf,
            &[
                ":SOUR:CURR:LEV:IMM 9",
                ":SOUR:CURR:RANG 4",
                ":SOUR:FUNC:MODE BATT",
                ":SOUR:INP:STAT ON",
            ],
        )
        .await;
        let start = rig.loads().len();
        let mut load = load(&rig).await;
        load.prepare(&Discharge {
            draw: Draw::Current(Amps(6.0)),
            stop_below: Volts(2.75),
        })
        .await
        .unwrap();
        assert!(
            rig.loads()[start..].iter().all(|state| !state.input_on),
            "{:?}",
            &rig.loads()[start..]
        );
        load.energise().await.unwrap();
        assert_eq!(
            *rig.loads().last().unwrap(),
            LoadState {
                input_on: true,
                current_a: 6.0,
                min_voltage_v: 2.75,
                power_w: None
            }
        );
        for _ in 0..3 {
            assert_eq!(load.measure().await.unwrap(), (Volts(3.7), Amps(1.5)));
        }
        load.safe().await.unwrap();
        assert!(!rig.loads().last().unwrap().input_on);
        let refused = load
            .prepare(&Discharge {
                draw: Draw::Current(Amps(50.0)),
                stop_below: Volts(2.75),
            })
            .await
            .unwrap_err()
            .to_string();
        assert_eq!(
            refused,
            "dev: `:SOUR:CURR:LEV:IMM 50.0000` was refused: -222, Data out of range"
        );
    });
}

#[test]
fn a_circulator_that_confirms_every_write_is_believed_only_by_its_confirmation() {
    in_virtual_time(async |clock| {
        let dialect = dialect!(chiller, "huber-pb");
        let rig = Rig::new(clock.clone(), "huber-pb");
        let mut chiller = Instrument::new(rig.link(dialect.profile()).await, dialect);
        for celsius in [25.0, -19.99, 40.0] {
            chiller.start(Celsius(celsius)).await.unwrap();
            assert_eq!(
                rig.last_action(),
                Action::Chiller(ChillerState {
                    running: true,
                    setpoint_degc: celsius
                })
            );
        }
        let status = chiller.status().await.unwrap();
        assert!(
            status.running && status.remote && status.alarm.is_none(),
            "{status:?}"
        );
        assert_eq!(chiller.temperature().await.unwrap(), Celsius(24.5));
        // Beyond its range it uses the nearest possible value, and reports this.
        let limited = chiller.start(Celsius(160.0)).await.unwrap_err().to_string();
        assert_eq!(
            limited,
            "dev: `{M003E80` answered `{S003A98`: expected `{S003E80` in the answer"
        );
        chiller.stop().await.unwrap();
        assert!(!chiller.status().await.unwrap().running);
        drop(chiller);
        let rig = Rig::lying(clock, "huber-pb", &[("{M01****", b"{S017FFF\r\n")]);
        let mut chiller = Instrument::new(rig.link(dialect.profile()).await, dialect);
        let none = chiller.temperature().await.unwrap_err().to_string();
        assert_eq!(
            none,
            "dev: `{M01****` answered `{S017FFF`: expected a temperature"
        );
    });
}

#[test]
fn a_generator_set_for_fifty_ohms_and_inverted_gives_true_volts_and_is_off_before_it_is_changed() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, "keysight-33500b");
        let left = [
            "OUTP1:LOAD 50",
            "OUTP1:POL INV",
            "SOUR1:APPL:SIN 100,2,1",
            "NONSENSE",
        ];
        rig.earlier_user(Terminator::Lf, &left).await;
        // A voltage set at 50 Ω doubles at an open input.
        assert!(
            (rig.waves().last().unwrap().amplitude_v - 2.0).abs() < 1e-9,
            "{:?}",
            rig.waves().last()
        );
        let dialect = dialect!(generator, "keysight-33500b");
        let mut generator = Instrument::new(rig.link(dialect.profile()).await, dialect);
        generator.output(false).await.unwrap();
        let start = rig.waves().len();
        generator.quiet(Volts(-0.05)).await.unwrap();
        assert!(
            rig.waves()[start..]
                .iter()
                .all(|state| *state == GeneratorState::default())
        );
        generator.output(true).await.unwrap();
        let quiet = *rig.waves().last().unwrap();
        assert_eq!((quiet.amplitude_v, quiet.offset_v), (1e-3, -0.05));
        generator
            .sine(&Sine {
                freq: Hertz(0.1),
                amplitude: Volts(0.4),
                offset: Volts(-0.05),
            })
            .await
            .unwrap();
        let driven = *rig.waves().last().unwrap();
        assert_eq!(
            (
                driven.freq_hz,
                driven.amplitude_v,
                driven.offset_v,
                driven.phase_rad
            ),
            (0.1, 0.4, -0.05, 0.0)
        );
        let refused = generator
            .sine(&Sine {
                freq: Hertz(0.1),
                amplitude: Volts(11.0),
                offset: Volts(0.0),
            })
            .await
            .unwrap_err()
            .to_string();
        assert_eq!(
            refused,
            "dev: `SOUR1:VOLT 22.0000` was refused: -221, Settings conflict"
        );
        let none = generator
            .sine(&Sine {
                freq: Hertz(f64::NAN),
                amplitude: Volts(1.0),
                offset: Volts(0.0),
            })
            .await
            .unwrap_err()
            .to_string();
        assert!(
            none.ends_with("expected a finite number to send, found NaN; nothing was sent"),
            "{none}"
        );
        generator.safe().await.unwrap();
        generator.safe().await.unwrap();
        assert_eq!(*rig.waves().last().unwrap(), GeneratorState::default());
    });
}

const PER_DIV_V: f64 = 0.08;
const TIME_PER_DIV_S: f64 = 0.05;

async fn capture(rig: &Rig) -> Scope {
    let dialect = dialect!(scope, "rigol-dho800");
    let mut scope = Instrument::new(rig.link(dialect.profile()).await, dialect);
    scope
        .set(&Intent::Session {
            memory_points: 100_000,
        })
        .await
        .unwrap();
    for channel in 1..=4 {
        let vertical = Vertical {
            channel,
            per_div: Volts(PER_DIV_V),
            offset: Volts(-base_v(channel) - 0.012_3),
        };
        scope.set(&Intent::Vertical(vertical)).await.unwrap();
    }
    let trigger = Intent::Trigger(Trigger {
        channel: 4,
        level: Volts(base_v(4)),
    });
    for intent in [
        Intent::Timebase(Seconds(TIME_PER_DIV_S)),
        trigger,
        Intent::Arm,
    ] {
        scope.set(&intent).await.unwrap();
    }
    rig.clock.sleep_s(2.03).await;
    scope.stop().await.unwrap();
    scope
}

#[test]
fn the_volts_come_back_from_codes_that_are_not_left_justified_at_any_page_size() {
    let earlier = [
        ":CHAN1:PROB 10",
        ":CHAN2:INV ON",
        ":CHAN3:COUP AC",
        ":TRIG:EDGE:SLOP NEG",
        ":TRIG:SWE SING",
        ":TIM:MAIN:OFFS 0.3",
        ":WAV:STAR 500",
        ":WAV:STOP 600",
    ];
    for (page_points, wanted) in [(1_000_000, 100_000), (1_000_000, 2_000), (777, 1_000)] {
        in_virtual_time(async |clock| {
            let rig = Rig::with(
                clock,
                "rigol-dho800",
                &MockOptions::quirk("page_points", page_points as f64),
                &[],
            );
            rig.earlier_user(Terminator::Lf, &earlier).await;
            let mut scope = capture(&rig).await;
            for channel in [4, 1, 3, 2] {
                let waveform = scope.download(channel, wanted).await.unwrap();
                assert_eq!(waveform.codes.len() as u64, wanted);
                assert!(
                    waveform.preamble.delay_s.abs() < 1e-9,
                    "the trigger is at the centre: {} s",
                    waveform.preamble.delay_s
                );
                for (index, &code) in waveform.codes.iter().enumerate() {
                    let met_v = f64::from(code) * waveform.preamble.volts_per_code
                        - waveform.preamble.offset_v;
                    let at_s = index as f64 * waveform.interval_s - 5.0 * TIME_PER_DIV_S;
                    let off_v = (met_v - volts(channel, at_s)).abs();
                    // Half a step of the converter and half a code.
                    assert!(
                        off_v < PER_DIV_V * (0.52 / 433.0 + 0.5 / 7500.0),
                        "channel {channel}, sample {index}: {met_v} V, off by {off_v}"
                    );
                }
            }
        });
    }
}

#[test]
fn a_scope_without_a_frame_says_so_and_an_offset_that_its_scale_does_not_allow_is_named() {
    in_virtual_time(async |clock| {
        let dialect = dialect!(scope, "rigol-dho800");
        let rig = Rig::new(clock, "rigol-dho800");
        let mut scope = Instrument::new(rig.link(dialect.profile()).await, dialect);
        scope
            .set(&Intent::Session {
                memory_points: 1_000,
            })
            .await
            .unwrap();
        scope.set(&Intent::Arm).await.unwrap();
        scope.stop().await.unwrap();
        let none = scope.download(1, 1_000).await.unwrap_err().to_string();
        assert!(
            none.contains(
                "`:WAV:PRE?` answered `1,2,0,1,0,0,0,0,0,32768`: expected scales above \
            zero: no frame was completed"
            ),
            "{none}"
        );
        let vertical = Vertical {
            channel: 1,
            per_div: Volts(0.05),
            offset: Volts(-3.8),
        };
        let refused = scope
            .set(&Intent::Vertical(vertical))
            .await
            .unwrap_err()
            .to_string();
        assert!(
            refused.contains(
                "`:CHAN1:OFFS?` answered `-1.0E0`: expected a number within 1.3e-2 of -3.8"
            ),
            "{refused}"
        );
    });
}

#[test]
fn the_larger_load_answers_its_own_ranges_and_a_limit_left_low_is_lifted() {
    in_virtual_time(async |clock| {
        for (current, answer, taken) in [
            (6.0, &b"60\n"[..], true),
            (6.0, b"40\n", true),
            (6.0, b"6\n", false),
            (3.0, b"6\n", true),
            (3.0, b"4.0000\n", true),
            (3.0, b"60\n", false),
        ] {
            let rig = Rig::lying(
                clock.clone(),
                "rigol-dl3000",
                &[(":SOUR:CURR:RANG?", answer)],
            );
            rig.earlier_user(Terminator::Lf, &[":SOUR:CURR:ILIM 0.5"])
                .await;
            let mut load = load(&rig).await;
            let prepared = load
                .prepare(&Discharge {
                    draw: Draw::Current(Amps(current)),
                    stop_below: Volts(2.75),
                })
                .await;
            assert_eq!(
                prepared.is_ok(),
                taken,
                "{current} A, {}: {prepared:?}",
                String::from_utf8_lossy(answer)
            );
            if taken {
                load.energise().await.unwrap();
                assert_eq!(
                    rig.loads().last().unwrap().current_a,
                    current,
                    "its own limit does not hold it back"
                );
            }
        }
    });
}

#[test]
fn a_wave_is_sent_as_text_played_at_its_rate_and_never_with_a_sines_amplitude() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, "keysight-33500b");
        let dialect = dialect!(generator, "keysight-33500b");
        let mut generator = Instrument::new(rig.link(dialect.profile()).await, dialect);
        generator.output(false).await.unwrap();
        generator.quiet(Volts(-0.28)).await.unwrap();
        generator.output(true).await.unwrap();
        let steps: Vec<f64> = (0..1024).map(|k| f64::from(k) / 512.0 - 1.0).collect();
        let wave = Wave {
            name: "eis1".to_owned(),
            steps: steps.clone(),
            freq: Hertz(0.5),
            amplitude: Volts(0.75),
            offset: Volts(-0.28),
        };
        let before = rig.actions().len();
        // Twice: a name that is there already must not be in the way.
        for _ in 0..2 {
            generator.wave(&wave).await.unwrap();
        }
        let shape = rig.shape().unwrap();
        assert_eq!(shape.len(), 1024);
        assert!(
            shape
                .iter()
                .zip(&steps)
                .all(|(met, step)| (met - step).abs() < 1.0 / 32_767.0)
        );
        let state = |action: &Action| {
            if let Action::Generator(state) = action {
                *state
            } else {
                panic!("{action:?}")
            }
        };
        let states: Vec<GeneratorState> = rig.actions()[before..].iter().map(state).collect();
        let last = states.last().unwrap();
        assert!(
            (last.freq_hz - 0.5).abs() < 1.0e-9
                && (last.amplitude_v - 0.75).abs() < 1.0e-9
                && (last.offset_v + 0.28).abs() < 1.0e-9,
            "{last:?}"
        );
        assert!(
            states
                .iter()
                .all(|state| state.freq_hz < 1.0 || state.amplitude_v < 0.0011),
            "a sine with the wave's amplitude: {states:?}"
        );
        let before = rig.actions().len();
        generator.quiet(Volts(-0.28)).await.unwrap();
        assert!(rig.shape().is_none());
        let states: Vec<GeneratorState> = rig.actions()[before..].iter().map(state).collect();
        // Still the wave, or the least sine: nothing in between.
        assert!(
            states
                .iter()
                .all(|state| state.freq_hz < 1.0 || state.amplitude_v < 0.0011),
            "a sine with the wave's amplitude: {states:?}"
        );
        let sent = rig.sent();
        let at = |text: &str| sent.iter().rposition(|message| message == text).unwrap();
        let first = sent
            .iter()
            .enumerate()
            .skip(at("SOUR1:FUNC ARB"))
            .find(|(_, message)| *message == "SOUR1:VOLT 0.0020")
            .unwrap();
        assert!(first.0 < at("SOUR1:FUNC SIN"), "{sent:?}");
        let short = Wave {
            steps: vec![0.0; 4],
            ..wave
        };
        let refused = generator.wave(&short).await.unwrap_err().to_string();
        assert!(
            refused.contains("expected 8 to 65536 finite steps, found 4"),
            "{refused}"
        );
    });
}

#[test]
fn a_load_draws_a_power_and_changes_its_level_while_it_draws() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, "rigol-dl3000");
        let mut load = load(&rig).await;
        load.prepare(&Discharge {
            draw: Draw::Power(Watts(40.0)),
            stop_below: Volts(2.75),
        })
        .await
        .unwrap();
        load.energise().await.unwrap();
        load.level(Draw::Power(Watts(25.0))).await.unwrap();
        assert_eq!(
            *rig.loads().last().unwrap(),
            LoadState {
                input_on: true,
                current_a: 0.0,
                min_voltage_v: 2.75,
                power_w: Some(25.0)
            }
        );
        let refused = load
            .level(Draw::Power(Watts(250.0)))
            .await
            .unwrap_err()
            .to_string();
        assert_eq!(
            refused,
            "dev: `:SOUR:POW:LEV:IMM 250.000` was refused: -222, Data out of range"
        );
        load.prepare(&Discharge {
            draw: Draw::Current(Amps(6.0)),
            stop_below: Volts(2.75),
        })
        .await
        .unwrap();
        load.level(Draw::Current(Amps(2.0))).await.unwrap();
        assert_eq!(
            *rig.loads().last().unwrap(),
            LoadState {
                input_on: false,
                current_a: 2.0,
                min_voltage_v: 2.75,
                power_w: None
            }
        );
    });
}
