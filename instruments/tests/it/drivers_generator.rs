//! The generator's driver: the output has the requested volts.

use instruments::{
    generator::{self, Generator, Sine, Wave},
    instrument::Instrument,
    mock::plant::GeneratorState,
    scpi::decode::Terminator,
    transcript::Tap,
    transport::MemoryHub,
    units::{Hertz, Volts},
};

use crate::{
    device::{Reply, now, open, serve_memory},
    drivers_common::{Rig, dialect, in_virtual_time},
};

const MODEL: &str = "siglent-sdg1000x";

async fn driver(rig: &Rig) -> Generator {
    let dialect = dialect!(generator, MODEL);
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

fn sine(freq_hz: f64, amplitude_v: f64, offset_v: f64) -> Sine {
    Sine {
        freq: Hertz(freq_hz),
        amplitude: Volts(amplitude_v),
        offset: Volts(offset_v),
    }
}

fn last(rig: &Rig) -> GeneratorState {
    *rig.waves().last().unwrap()
}

#[test]
fn a_sine_comes_as_asked_and_goes_when_switched_off() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut generator = driver(&rig).await;
        generator.output(false).await.unwrap();
        generator.quiet(Volts(-0.28)).await.unwrap();
        assert!(
            rig.waves()
                .iter()
                .all(|state| *state == GeneratorState::default()),
            "nothing comes before the output is on"
        );
        generator.output(true).await.unwrap();
        // The least sine of the instrument, 2 mV peak to peak.
        assert_eq!(
            (last(&rig).offset_v, last(&rig).amplitude_v),
            (-0.28, 0.001)
        );
        generator.sine(&sine(0.3, 0.5, -0.28)).await.unwrap();
        let state = last(&rig);
        assert_eq!(
            (
                state.freq_hz,
                state.amplitude_v,
                state.offset_v,
                state.phase_rad
            ),
            (0.3, 0.5, -0.28, 0.0)
        );
        generator.quiet(Volts(0.01)).await.unwrap();
        assert_eq!((last(&rig).offset_v, last(&rig).amplitude_v), (0.01, 0.001));
        generator.safe().await.unwrap();
        generator.safe().await.unwrap();
        assert_eq!(last(&rig), GeneratorState::default());
    });
}

#[test]
fn what_an_earlier_user_left_neither_doubles_nor_turns_the_volts() {
    in_virtual_time(async |clock| {
        for earlier in [
            &["C1:OUTP LOAD,50"][..],
            &["C1:OUTP PLRT,INVT"],
            &[
                "C1:OUTP LOAD,75",
                "C1:OUTP PLRT,INVT",
                "C1:OUTP ON",
                "C1:OUTP OFF",
            ],
        ] {
            for quiet_first in [true, false] {
                let rig = Rig::new(clock.clone(), MODEL);
                rig.earlier_user(Terminator::Lf, earlier).await;
                rig.plant.lock().unwrap().actions.clear();
                let mut generator = driver(&rig).await;
                generator.output(false).await.unwrap();
                if quiet_first {
                    generator.quiet(Volts(0.2)).await.unwrap();
                }
                generator.sine(&sine(10.0, 0.5, 0.2)).await.unwrap();
                generator.output(true).await.unwrap();
                let on: Vec<_> = rig
                    .waves()
                    .into_iter()
                    .filter(|state| *state != GeneratorState::default())
                    .collect();
                assert_eq!(on.len(), 1, "{on:?}");
                assert_eq!(
                    (on[0].amplitude_v, on[0].offset_v, on[0].phase_rad),
                    (0.5, 0.2, 0.0),
                    "{earlier:?}"
                );
            }
        }
    });
}

#[test]
fn the_output_is_not_switched_on_with_a_load_that_makes_other_volts() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        rig.earlier_user(Terminator::Lf, &["C1:OUTP LOAD,50"]).await;
        let mut generator = driver(&rig).await;
        generator.sine(&sine(10.0, 0.5, 0.2)).await.unwrap();
        let text = "dev: after `C1:OUTP PLRT,NOR`, `C1:OUTP?` answered `C1:OUTP \
        OFF,LOAD,50,PLRT,NOR`: expected `LOAD,HZ` in the answer";
        assert_eq!(generator.output(true).await.unwrap_err().to_string(), text);
        assert!(
            rig.waves()
                .iter()
                .all(|state| *state == GeneratorState::default())
        );
    });
}

#[test]
fn burst_sweep_and_modulation_are_off_before_the_output_is_on() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        driver(&rig).await.quiet(Volts(0.0)).await.unwrap();
        for command in [
            "C1:OUTP PLRT,NOR",
            "C1:BTWV STATE,OFF",
            "C1:SWWV STATE,OFF",
            "C1:MDWV STATE,OFF",
        ] {
            assert!(
                rig.sent().iter().any(|message| message == command),
                "{command} in {:?}",
                rig.sent()
            );
        }
    });
}

#[test]
fn frequencies_are_exact_to_a_microhertz() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut generator = driver(&rig).await;
        generator.output(true).await.unwrap();
        for freq_hz in [
            1.0e-6,
            0.001,
            0.012_345,
            0.1,
            1.0 / 3.0,
            7.943_282,
            99.999_999,
            1_234.567_891,
            9_999.9,
            100_000.000_001,
            3.0e7,
        ] {
            generator.sine(&sine(freq_hz, 0.1, 0.0)).await.unwrap();
            let met = last(&rig).freq_hz;
            assert!(
                (met - freq_hz).abs() <= 0.51e-6,
                "{freq_hz} Hz came out as {met} Hz"
            );
        }
    });
}

#[test]
fn what_was_clamped_silently_is_said_aloud() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut generator = driver(&rig).await;
        let tail = |text: &str| text.rsplit_once(": ").unwrap().1.to_owned();
        for (asked, expected) in [
            (
                sine(10.0, 12.0, 0.0),
                "expected AMP within 2.4e-2 of 24, found 20V",
            ),
            (
                sine(10.0, 0.0, 0.0),
                "expected AMP within 2.5e-4 of 0, found 0.002V",
            ),
            // The smallest amplitude is 2 mV peak to peak, twice the requested one.
            (
                sine(10.0, 0.5e-3, 0.0),
                "expected AMP within 2.5e-4 of 0.001, found 0.002V",
            ),
            (
                sine(10.0, 4.0, 8.0),
                "expected AMP within 8.3e-3 of 8, found 4V",
            ),
            (
                sine(4.0e7, 0.1, 0.0),
                "expected FRQ within 4.0e1 of 40000000, found 30000000HZ",
            ),
        ] {
            let error = generator.sine(&asked).await.unwrap_err().to_string();
            assert!(
                error.starts_with("dev: after `C1:BSWV WVTP,SINE,FRQ,")
                    && error.contains("`C1:BSWV?` answered `C1:BSWV WVTP,SINE"),
                "{error}"
            );
            assert!(tail(&error) == expected, "{error}: {expected}");
        }
        let error = generator.quiet(Volts(11.0)).await.unwrap_err().to_string();
        assert!(
            error.contains("AMP,0.0020,OFST,11.0000")
                && error.ends_with("expected OFST within 1.0e-3 of 11, found 9.999V"),
            "{error}"
        );
        let sent = rig.sent().len();
        for none in [
            sine(10.0, 0.1, f64::NAN),
            sine(10.0, f64::INFINITY, 0.0),
            sine(f64::NAN, 0.1, 0.0),
        ] {
            let error = generator.sine(&none).await.unwrap_err().to_string();
            assert!(
                error.contains("expected a finite number, found")
                    && error.ends_with("nothing was sent"),
                "{error}"
            );
        }
        assert_eq!(rig.sent().len(), sent);
    });
}

#[test]
fn the_least_amplitude_of_the_capabilities_is_that_of_the_instrument() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut generator = driver(&rig).await;
        generator.output(true).await.unwrap();
        let capabilities = generator.capabilities();
        generator
            .sine(&sine(10.0, capabilities.min_amplitude.value(), 0.0))
            .await
            .unwrap();
        assert_eq!(last(&rig).amplitude_v, 1.0e-3);
        generator
            .sine(&sine(10.0, capabilities.max_peak.value(), 0.0))
            .await
            .unwrap();
        assert_eq!(last(&rig).amplitude_v, 10.0);
    });
}

#[test]
fn any_pair_of_amplitude_and_offset_follows_any_other() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut generator = driver(&rig).await;
        generator.output(true).await.unwrap();
        for (amplitude_v, offset_v) in [(1.0, 8.0), (4.0, 0.0), (1.0, -9.0), (9.0, 1.0), (0.5, 9.5)]
        {
            generator
                .sine(&sine(10.0, amplitude_v, offset_v))
                .await
                .unwrap();
            assert_eq!(
                (last(&rig).amplitude_v, last(&rig).offset_v),
                (amplitude_v, offset_v)
            );
        }
    });
}

/// As a firmware that takes the keys one by one: the old offset clamps the new amplitude, and then
/// is gone.
#[test]
fn an_amplitude_that_the_old_offset_clamped_is_set_once_more_and_no_more() {
    for (clamped_times, succeeds) in [(0, true), (1, true), (2, false)] {
        in_virtual_time(async |clock| {
            let hub = MemoryHub::new();
            let mut settings = 0;
            let script = move |message: &str| match message {
                "C1:BSWV?" => {
                    let amplitude = if settings > clamped_times { "8V" } else { "4V" };
                    now(format!(
                        "C1:BSWV WVTP,SINE,FRQ,10HZ,PERI,0.1S,AMP,{amplitude},OFST,0V,PHSE,0\n"
                    ))
                }
                setting if setting.starts_with("C1:BSWV WVTP") => {
                    settings += 1;
                    Reply::Silence
                }
                "C1:OUTP?" => now("C1:OUTP OFF,LOAD,HZ,PLRT,NOR\n"),
                query if query.ends_with('?') => now("C1:BTWV STATE,OFF\n"),
                _ => Reply::Silence,
            };
            let heard = serve_memory(&hub, &clock, script);
            let dialect = dialect!(generator, MODEL);
            let link = open(
                "memory:device",
                dialect.profile(),
                &clock,
                &hub,
                Tap::none(),
            )
            .await
            .unwrap();
            let outcome = Instrument::new(link, dialect)
                .sine(&sine(10.0, 4.0, 0.0))
                .await;
            assert_eq!(outcome.is_ok(), succeeds, "{outcome:?}");
            let settings = heard
                .lock()
                .unwrap()
                .iter()
                .filter(|(_, message)| message.starts_with("C1:BSWV WVTP"))
                .count();
            assert_eq!(settings, usize::min(clamped_times + 1, 2));
        });
    }
}

#[test]
fn another_wave_or_a_switched_load_is_not_believed() {
    in_virtual_time(async |clock| {
        let square: &[u8] = b"C1:BSWV WVTP,SQUARE,FRQ,10HZ,PERI,0.1S,AMP,1V,OFST,0V,\
            HLEV,0.5V,LLEV,-0.5V,PHSE,0,DUTY,50\n";
        let rig = Rig::lying(clock.clone(), MODEL, &[("C1:BSWV?", square)]);
        let mut generator = driver(&rig).await;
        let error = generator
            .sine(&sine(10.0, 0.5, 0.0))
            .await
            .unwrap_err()
            .to_string();
        assert!(error.ends_with("expected WVTP,SINE"), "{error}");
        let rig = Rig::lying(
            clock,
            MODEL,
            &[("C1:OUTP?", b"C1:OUTP ON,LOAD,50,PLRT,NOR\n")],
        );
        let mut generator = driver(&rig).await;
        let error = generator.output(true).await.unwrap_err().to_string();
        let text = "dev: after `C1:OUTP PLRT,NOR`, `C1:OUTP?` answered `C1:OUTP \
        ON,LOAD,50,PLRT,NOR`: expected `LOAD,HZ` in the answer";
        assert_eq!(error, text);
        let error = generator.safe().await.unwrap_err().to_string();
        assert!(
            error.starts_with("dev: after `C1:OUTP OFF`")
                && error.ends_with("expected `OUTP OFF` in the answer"),
            "{error}"
        );
    });
}

#[test]
fn a_wave_is_loaded_chosen_and_played_and_the_least_sine_ends_it() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut generator = driver(&rig).await;
        generator.output(false).await.unwrap();
        generator.output(true).await.unwrap();
        // Every value of a byte occurs: none of the bytes that end a message may pass.
        let steps: Vec<f64> = (0..4096).map(|k| f64::from(k) / 2048.0 - 1.0).collect();
        let wave = Wave {
            name: "eis1".to_owned(),
            steps: steps.clone(),
            freq: Hertz(0.1),
            amplitude: Volts(0.75),
            offset: Volts(-0.28),
        };
        generator.wave(&wave).await.unwrap();
        let state = last(&rig);
        assert_eq!(
            (
                state.freq_hz,
                state.amplitude_v,
                state.offset_v,
                state.phase_rad
            ),
            (0.1, 0.75, -0.28, 0.0)
        );
        let shape = rig.shape().unwrap();
        assert_eq!(shape.len(), 16_384);
        for (k, value) in shape.iter().enumerate() {
            assert!(
                (value - steps[k / 4]).abs() < 129.0 / 32_767.0,
                "{k}: {value}"
            );
        }
        generator.quiet(Volts(-0.28)).await.unwrap();
        assert!(rig.shape().is_none() && last(&rig).amplitude_v == 0.001);
        let odd = Wave {
            steps: vec![0.0; 1000],
            ..wave
        };
        let refused = generator.wave(&odd).await.unwrap_err().to_string();
        assert!(
            refused.contains("expected a divisor of 16384 as the number of steps, found 1000"),
            "{refused}"
        );
    });
}
