//! The second dialect of each role, whose manners differ from the first's: channel lists, `ON` and `OFF` as answers, two line ends, hexadecimal
//! registers.

use instruments::{
    chiller,
    generator::{self, Sine},
    instrument::Instrument,
    load::{self, Discharge, Draw, Load},
    mock::{
        MockOptions,
        plant::{Action, ChillerState, GeneratorState, LoadState, SupplyState},
    },
    scope::{self, Intent, Scope, Trigger, Vertical},
    scpi::decode::Terminator,
    supply::{self, Charge, Supply},
    units::{Amps, Celsius, Hertz, Seconds, Volts},
};

use crate::{
    drivers_common::{Rig, dialect, in_virtual_time},
    mocks_plant::{base_v, volts},
};

const CHARGE: Charge = Charge { voltage: Volts(4.2), current: Amps(1.25) };

async fn supply(rig: &Rig, model: &str) -> Supply {
    let dialect = dialect!(supply, model);
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

async fn load(rig: &Rig) -> Load {
    let dialect = dialect!(load, "rigol-dl3000");
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

fn supplies(rig: &Rig) -> Vec<SupplyState> {
    let state = |action| if let Action::Supply(state) = action { state } else { panic!("a supply does not do {action:?}") };
    rig.actions().into_iter().map(state).collect()
}

fn loads(rig: &Rig) -> Vec<LoadState> {
    let state = |action| if let Action::Load(state) = action { state } else { panic!("a load does not do {action:?}") };
    rig.actions().into_iter().map(state).collect()
}

#[test]
fn a_supply_that_was_left_on_is_off_before_it_is_changed_and_charges_with_what_was_asked() {
    for (model, left) in [
        ("keysight-e36312a", &["VOLT 6,(@1)", "CURR 5,(@1)", "VOLT:SENS:SOUR EXT,(@1)", "CURR:PROT:STAT ON,(@1)", "OUTP ON,(@1)"][..]),
        ("rigol-dp832", &[":APPL CH1,30,3", ":OUTP:OVP:VAL CH1,31", ":OUTP:OCP CH1,ON", ":OUTP CH1,ON"]),
    ] {
        in_virtual_time(async |clock| {
            let rig = Rig::new(clock, model);
            rig.earlier_user(Terminator::Lf, &[left, &["NONSENSE"]].concat()).await;
            let start = supplies(&rig).len();
            let mut supply = supply(&rig, model).await;
            supply.prepare(&CHARGE).await.unwrap();
            let states = supplies(&rig)[start..].to_vec();
            assert!(states.iter().all(|state| !state.output_on), "{model}: {states:?}");
            supply.energise().await.unwrap();
            assert_eq!(*supplies(&rig).last().unwrap(), SupplyState { output_on: true, voltage_v: 4.2, current_a: 1.25 }, "{model}");
            // At its current limit, as a charge is: no protection takes that for a fault.
            assert_eq!(supply.measure().await.unwrap(), (Volts(4.0), Amps(1.25)), "{model}");
            assert!(supplies(&rig).last().unwrap().output_on, "{model}");
            supply.safe().await.unwrap();
            supply.safe().await.unwrap();
            assert!(!supplies(&rig).last().unwrap().output_on, "{model}");
        });
    }
}

#[test]
fn the_protection_above_the_charge_is_armed_and_switches_off_by_itself() {
    for (model, armed, lower) in [
        ("keysight-e36312a", ("VOLT:PROT? (@1)", "+4.40000000E+00"), "VOLT:PROT 3.9,(@1)"),
        ("rigol-dp832", (":OUTP:OVP:VAL? CH1", "4.400"), ":OUTP:OVP:VAL CH1,3.9"),
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
            assert!(!supplies(&rig).last().unwrap().output_on, "{model}");
            // And a latched protection is a refusal, not a charge that never comes.
            let mut supply = self::supply(&rig, model).await;
            supply.prepare(&CHARGE).await.unwrap();
            let refused = supply.energise().await.unwrap_err().to_string();
            assert!(refused.contains("expected one of") && refused.contains("ON"), "{model}: {refused}");
        });
    }
}

#[test]
fn what_a_supply_does_not_take_over_is_named() {
    in_virtual_time(async |clock| {
        for (model, charge, text) in [
            ("keysight-e36312a", Charge { voltage: Volts(7.0), ..CHARGE }, "dev: `VOLT 7.000,(@1)` was refused: -222, Data out of range"),
            ("rigol-dp832", Charge { current: Amps(5.0), ..CHARGE }, "dev: `:SOUR1:CURR 5.000` was refused: -222, Data out of range"),
            (
                "rigol-dp832",
                Charge { voltage: Volts(f64::NAN), ..CHARGE },
                "dev: `:SOUR1:VOLT`: `:SOUR1:VOLT`: expected a finite number to send, found NaN",
            ),
        ] {
            let rig = Rig::new(clock.clone(), model);
            let met = supply(&rig, model).await.prepare(&charge).await.unwrap_err().to_string();
            assert!(met.starts_with(text), "{model}: {met}");
        }
        for (model, query, answer, text) in [
            ("keysight-e36312a", "OUTP? (@1)", &b"1\n"[..], "after `OUTP OFF,(@1)`, `OUTP? (@1)` answered `1`: expected one of 0, OFF"),
            ("keysight-e36312a", "VOLT:SENS:SOUR? (@1)", b"EXT\n", "answered `EXT`: expected one of INT, INTernal"),
            ("rigol-dp832", ":OUTP? CH1", b"ON\n", "after `:OUTP CH1,OFF`, `:OUTP? CH1` answered `ON`: expected one of OFF, 0"),
            ("rigol-dp832", ":OUTP:OVP? CH1", b"OFF\n", "after `:OUTP:OVP CH1,ON`, `:OUTP:OVP? CH1` answered `OFF`: expected one of ON, 1"),
        ] {
            let rig = Rig::with(clock.clone(), model, &MockOptions::default(), &[(query, answer)]);
            let met = supply(&rig, model).await.prepare(&CHARGE).await.unwrap_err().to_string();
            assert!(met.contains(text), "{model}: {met}");
        }
    });
}

#[test]
fn a_load_with_two_line_ends_is_read_and_one_left_on_in_another_mode_is_off_before_it_is_changed() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, "rigol-dl3000");
        rig.earlier_user(Terminator::Lf, &[":SOUR:CURR:LEV:IMM 9", ":SOUR:CURR:RANG 4", ":SOUR:FUNC:MODE BATT", ":SOUR:INP:STAT ON"]).await;
        let start = loads(&rig).len();
        let mut load = load(&rig).await;
        load.prepare(&Discharge { draw: Draw::Current(Amps(6.0)), stop_below: Volts(2.75) }).await.unwrap();
        assert!(loads(&rig)[start..].iter().all(|state| !state.input_on), "{:?}", &loads(&rig)[start..]);
        load.energise().await.unwrap();
        assert_eq!(*loads(&rig).last().unwrap(), LoadState { input_on: true, current_a: 6.0, min_voltage_v: 2.75, power_w: None });
        for _ in 0..3 {
            assert_eq!(load.measure().await.unwrap(), (Volts(3.7), Amps(1.5)));
        }
        load.safe().await.unwrap();
        assert!(!loads(&rig).last().unwrap().input_on);
        let refused = load.prepare(&Discharge { draw: Draw::Current(Amps(50.0)), stop_below: Volts(2.75) }).await.unwrap_err().to_string();
        assert_eq!(refused, "dev: `:SOUR:CURR:LEV:IMM 50.0000` was refused: -222, Data out of range");
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
            assert_eq!(rig.last_action(), Action::Chiller(ChillerState { running: true, setpoint_c: celsius }));
        }
        let status = chiller.status().await.unwrap();
        assert!(status.running && status.remote && status.alarm.is_none(), "{status:?}");
        assert_eq!(chiller.temperature().await.unwrap(), Celsius(24.5));
        // Beyond its range it takes the nearest it can, and says so.
        let limited = chiller.start(Celsius(160.0)).await.unwrap_err().to_string();
        assert_eq!(limited, "dev: `{M003E80` answered `{S003A98`: expected `{S003E80` in the answer");
        chiller.stop().await.unwrap();
        assert!(!chiller.status().await.unwrap().running);
        drop(chiller);
        let rig = Rig::with(clock, "huber-pb", &MockOptions::default(), &[("{M01****", b"{S017FFF\r\n")]);
        let mut chiller = Instrument::new(rig.link(dialect.profile()).await, dialect);
        let none = chiller.temperature().await.unwrap_err().to_string();
        assert_eq!(none, "dev: `{M01****` answered `{S017FFF`: expected a temperature");
    });
}

fn waves(rig: &Rig) -> Vec<GeneratorState> {
    let state = |action| if let Action::Generator(state) = action { state } else { panic!("a generator does not do {action:?}") };
    rig.actions().into_iter().map(state).collect()
}

#[test]
fn a_generator_set_for_fifty_ohms_and_inverted_gives_true_volts_and_is_off_before_it_is_changed() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, "keysight-33500b");
        let left = ["OUTP1:LOAD 50", "OUTP1:POL INV", "SOUR1:APPL:SIN 100,2,1", "NONSENSE"];
        rig.earlier_user(Terminator::Lf, &left).await;
        // What was asked for at 50 Ω is twice that at an open input.
        assert!((waves(&rig).last().unwrap().amplitude_v - 2.0).abs() < 1e-9, "{:?}", waves(&rig).last());
        let dialect = dialect!(generator, "keysight-33500b");
        let mut generator = Instrument::new(rig.link(dialect.profile()).await, dialect);
        generator.output(false).await.unwrap();
        let start = waves(&rig).len();
        generator.quiet(Volts(-0.05)).await.unwrap();
        assert!(waves(&rig)[start..].iter().all(|state| *state == GeneratorState::default()));
        generator.output(true).await.unwrap();
        let quiet = *waves(&rig).last().unwrap();
        assert_eq!((quiet.amplitude_v, quiet.offset_v), (1e-3, -0.05));
        generator.sine(&Sine { freq: Hertz(0.1), amplitude: Volts(0.4), offset: Volts(-0.05) }).await.unwrap();
        let driven = *waves(&rig).last().unwrap();
        assert_eq!((driven.freq_hz, driven.amplitude_v, driven.offset_v, driven.phase_rad), (0.1, 0.4, -0.05, 0.0));
        let refused = generator.sine(&Sine { freq: Hertz(0.1), amplitude: Volts(11.0), offset: Volts(0.0) }).await.unwrap_err().to_string();
        assert_eq!(refused, "dev: `SOUR1:VOLT 22.0000` was refused: -221, Settings conflict");
        let none =
            generator.sine(&Sine { freq: Hertz(f64::NAN), amplitude: Volts(1.0), offset: Volts(0.0) }).await.unwrap_err().to_string();
        assert!(none.ends_with("expected a finite number to send, found NaN; nothing was sent"), "{none}");
        generator.safe().await.unwrap();
        generator.safe().await.unwrap();
        assert_eq!(*waves(&rig).last().unwrap(), GeneratorState::default());
    });
}

const PER_DIV_V: f64 = 0.08;
const TIME_PER_DIV_S: f64 = 0.05;

async fn capture(rig: &Rig) -> Scope {
    let dialect = dialect!(scope, "rigol-dho800");
    let mut scope = Instrument::new(rig.link(dialect.profile()).await, dialect);
    scope.set(&Intent::Session { memory_points: 100_000 }).await.unwrap();
    for channel in 1..=4 {
        let vertical = Vertical { channel, per_div: Volts(PER_DIV_V), offset: Volts(-base_v(channel) - 0.012_3) };
        scope.set(&Intent::Vertical(vertical)).await.unwrap();
    }
    let trigger = Intent::Trigger(Trigger { channel: 4, level: Volts(base_v(4)) });
    for intent in [Intent::Timebase(Seconds(TIME_PER_DIV_S)), trigger, Intent::Arm] {
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
            let rig = Rig::with(clock, "rigol-dho800", &MockOptions { page_points, ..MockOptions::default() }, &[]);
            rig.earlier_user(Terminator::Lf, &earlier).await;
            let mut scope = capture(&rig).await;
            for channel in [4, 1, 3, 2] {
                let waveform = scope.download(channel, wanted).await.unwrap();
                assert_eq!(waveform.codes.len() as u64, wanted);
                assert!(waveform.preamble.delay_s.abs() < 1e-9, "the trigger is at the centre: {} s", waveform.preamble.delay_s);
                for (index, &code) in waveform.codes.iter().enumerate() {
                    let met_v = f64::from(code) * waveform.preamble.volts_per_code - waveform.preamble.offset_v;
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
        scope.set(&Intent::Session { memory_points: 1_000 }).await.unwrap();
        scope.set(&Intent::Arm).await.unwrap();
        scope.stop().await.unwrap();
        let none = scope.download(1, 1_000).await.unwrap_err().to_string();
        assert!(
            none.contains("`:WAV:PRE?` answered `1,2,0,1,0,0,0,0,0,32768`: expected scales above zero: no frame was completed"),
            "{none}"
        );
        let vertical = Vertical { channel: 1, per_div: Volts(0.05), offset: Volts(-3.8) };
        let refused = scope.set(&Intent::Vertical(vertical)).await.unwrap_err().to_string();
        assert!(refused.contains("`:CHAN1:OFFS?` answered `-1.0E0`: expected a number within 1.3e-2 of -3.8"), "{refused}");
    });
}
