//! Each driver against each quirk of its mock: it works, or stops with a named cause, and never
//! takes a wrong number for a right one.

use instruments::{
    chiller,
    fixture::Fixture,
    generator,
    instrument::Instrument,
    jig::Jig,
    link::LinkError,
    load, logger,
    mock::{
        self, MODELS, MockOptions,
        plant::{Action, BathState},
        quirks::{Kind, Quirks, Value},
    },
    scope::{self, Intent, Trigger, Vertical},
    supply, supply4q,
    units::{Amps, Celsius, Hertz, Seconds, Volts},
};

use crate::{
    drivers_common::{Rig, dialect, in_virtual_time},
    mocks_plant::{base_v, volts},
};

/// Tolerance between the settings of the world and the readings of the driver, as a share. A quirk
/// that rounds answers gets its rounding in addition.
struct Judge {
    share: f64,
}

impl Judge {
    fn reads(&self, what: &str, met: f64, truth: f64) {
        assert!(
            (met - truth).abs() <= self.share * truth.abs() + 1e-9,
            "{what}: {met} instead of {truth}"
        );
    }
}

async fn exercise(rig: &Rig, model: &str, role: &str, judge: &Judge) -> Result<(), LinkError> {
    macro_rules! driver {
        ($role:ident) => {{
            let dialect = dialect!($role, model);
            Instrument::new(rig.link(dialect.profile()).await, dialect)
        }};
    }
    match role {
        "supply4q" => {
            let mut supply = driver!(supply4q);
            supply
                .prepare(&supply4q::Limits {
                    compliance: Volts(4.3),
                    current: Amps(3.0),
                })
                .await?;
            if let Some(own) = supply.own_limits().await? {
                assert!(own.volts.1 <= 20.0 && own.amps.1 <= 20.0, "{own:?}");
            }
            supply.energise().await?;
            let Action::Bipolar(state) = rig.last_action() else {
                panic!("{:?}", rig.last_action())
            };
            // The wiring of a linear unit cannot be queried: an unwired unit drives nothing.
            let commanded =
                state.analog_input || (model == "kepco-bop-linear" && state.setpoint == 0.0);
            assert!(
                state.output_on && commanded && state.current_mode && state.off_is_open,
                "{state:?}"
            );
            if supply.capabilities().holds != supply4q::Holds::Nothing {
                judge.reads("compliance", state.limit, 4.3);
            }
            let (met_v, met_a) = supply.measure().await?;
            judge.reads("voltage", met_v.value(), 3.75);
            judge.reads("current", met_a.value(), -2.5);
            supply.safe().await?;
            assert!(
                matches!(rig.last_action(), Action::Bipolar(state) if !state.output_on),
                "{:?}",
                rig.last_action()
            );
        }
        "generator" => {
            let mut generator = driver!(generator).on_channels(vec![1]);
            generator.output(false).await?;
            generator.quiet(Volts(-0.05)).await?;
            generator.output(true).await?;
            generator
                .sine(&generator::Sine {
                    freq: Hertz(1.25),
                    amplitude: Volts(0.4),
                    offset: Volts(-0.05),
                })
                .await?;
            let Action::Generator(state) = rig.last_action() else {
                panic!("{:?}", rig.last_action())
            };
            judge.reads("frequency", state.freq_hz, 1.25);
            judge.reads("amplitude", state.amplitude_v, 0.4);
            judge.reads("offset", state.offset_v, -0.05);
            generator.safe().await?;
        }
        "scope" => {
            let mut scope = driver!(scope);
            scope
                .set(&Intent::Session {
                    memory_points: 10_000,
                })
                .await?;
            for channel in 1..=4 {
                let offset = Volts(-base_v(channel) - 0.012_3);
                scope
                    .set(&Intent::Vertical(Vertical {
                        channel,
                        per_div: Volts(0.08),
                        offset,
                    }))
                    .await?;
            }
            for intent in [
                Intent::Timebase(Seconds(0.05)),
                Intent::Trigger(Trigger {
                    channel: 4,
                    level: Volts(base_v(4)),
                }),
                Intent::Arm,
            ] {
                scope.set(&intent).await?;
            }
            rig.clock.sleep_s(2.03).await;
            scope.stop().await?;
            for channel in [1, 4] {
                let waveform = scope.download(channel, 2_000).await?;
                assert_eq!(waveform.codes.len(), 2_000);
                for (index, &code) in waveform.codes.iter().enumerate() {
                    let met_v = f64::from(code) * waveform.preamble.volts_per_code
                        - waveform.preamble.offset_v;
                    let truth_v = volts(channel, index as f64 * waveform.interval_s - 0.25);
                    assert!(
                        (met_v - truth_v).abs() < 0.08 / 200.0,
                        "channel {channel}, sample {index}: {met_v} V instead of {truth_v} V"
                    );
                }
            }
        }
        "load" => {
            let mut load = driver!(load).sensing(Some(true));
            load.prepare(&load::Discharge {
                draw: load::Draw::Current(Amps(3.5)),
                stop_below: Volts(2.75),
            })
            .await?;
            load.energise().await?;
            let Action::Load(state) = rig.last_action() else {
                panic!("{:?}", rig.last_action())
            };
            assert!(state.input_on);
            judge.reads("level", state.current_a, 3.5);
            let (met_v, met_a) = load.measure().await?;
            judge.reads("voltage", met_v.value(), 3.7);
            judge.reads("current", met_a.value(), 1.5);
            load.safe().await?;
        }
        "supply" => {
            let mut supply = driver!(supply);
            supply
                .prepare(&supply::Charge {
                    voltage: Volts(4.2),
                    current: Amps(1.25),
                })
                .await?;
            supply.energise().await?;
            let Action::Supply(state) = rig.last_action() else {
                panic!("{:?}", rig.last_action())
            };
            assert!(state.output_on);
            judge.reads("limit", state.voltage_v, 4.2);
            judge.reads("level", state.current_a, 1.25);
            let (met_v, met_a) = supply.measure().await?;
            judge.reads("voltage", met_v.value(), 4.0);
            judge.reads("current", met_a.value(), 1.25);
            supply.safe().await?;
        }
        "chiller" => {
            let mut chiller = driver!(chiller);
            chiller.start(Celsius(25.0)).await?;
            if chiller.is_regulated() {
                chiller.pulse(5.0).await?;
                assert!(
                    matches!(
                        rig.last_action(),
                        Action::Bath(BathState { power: 1.0, .. })
                    ),
                    "{:?}",
                    rig.last_action()
                );
            } else {
                let Action::Chiller(state) = rig.last_action() else {
                    panic!("{:?}", rig.last_action())
                };
                assert!(state.running && state.setpoint_degc == 25.0, "{state:?}");
                let status = chiller.status().await?;
                assert!(status.running && status.alarm.is_none(), "{status:?}");
            }
            judge.reads("bath", chiller.temperature().await?.value(), 24.5);
            chiller.stop().await?;
        }
        "logger" => {
            let channels = if dialect!(logger, model).has_channel(101) {
                vec![101, 102]
            } else {
                vec![1]
            };
            let mut logger = driver!(logger).on_channels(channels);
            logger.configure().await?;
            // An open thermocouple is reported as `None`.
            if let Some(cell) = logger.scan().await?.first().copied().flatten() {
                judge.reads("cell", cell.value(), 25.374);
            }
        }
        _ => {
            Jig::new(rig.link(Jig::profile()).await)
                .mount(Fixture::Shunt)
                .await?;
        }
    }
    Ok(())
}

/// Settings of a switch to be tried.
fn tried(name: &str, kind: Kind) -> Vec<Value> {
    let mut values = kind.others();
    match name {
        "digits" => values = vec![3.0.into(), 5.0.into()],
        // A memory of ten million pages of one point is downloaded for too long.
        "page_points" => values = vec![777.0.into(), 2_000.0.into()],
        "announced_points" => values = vec![500.0.into(), 5_000.0.into()],
        _ => {}
    }
    values
}

#[test]
fn every_driver_works_with_every_quirk_or_says_what_is_wrong() {
    for model in MODELS {
        let usual = std::iter::once(None);
        let changes = model.quirks().flat_map(|quirk| {
            tried(quirk.name, quirk.kind)
                .into_iter()
                .map(move |value| Some((quirk.name, value)))
        });
        for change in usual.chain(changes) {
            in_virtual_time(async |clock| {
                let quirks = change
                    .iter()
                    .fold(Quirks::default(), |quirks, (name, value)| {
                        quirks.with(name, value.clone())
                    });
                let rig = Rig::with(
                    clock,
                    model.key,
                    &MockOptions {
                        quirks,
                        ..MockOptions::default()
                    },
                    &[],
                );
                let share = if matches!(change, Some(("digits", _))) {
                    6.0e-3
                } else {
                    1.5e-3
                };
                let outcome = exercise(&rig, model.key, model.role, &Judge { share }).await;
                match (&change, outcome) {
                    (_, Ok(())) => println!("{} {change:?}: works", model.key),
                    (None, Err(error)) => panic!("{}: {error}", model.key),
                    (Some(_), Err(error)) => {
                        println!("{} {change:?}: {error}", model.key);
                        assert!(
                            error.to_string().starts_with("dev: "),
                            "{}: {change:?}: {error}",
                            model.key
                        );
                    }
                }
            });
        }
    }
}

#[test]
fn a_switch_that_a_model_does_not_have_is_refused_with_those_that_it_has() {
    for (key, quirks, message) in [
        (
            "siglent-sdm3065x",
            Quirks::default().with("page_points", 1.0),
            "quirk page_points: expected one of echo, min_gap, first_answer, late_end, digits, \
            lacks, identity, latency, second_client, unit, open_thermocouple, unknown, \
             found `page_points`",
        ),
        (
            "julabo",
            Quirks::default().with("local", 1.0),
            "quirk local: expected true or false, found 1",
        ),
        (
            "julabo",
            Quirks::default().with("min_gap", -1.0),
            "quirk min_gap: expected a number from 0 to 10, found -1",
        ),
        (
            "siglent-sdm3065x",
            Quirks::default().with("unit", "R"),
            "quirk unit: expected one of C, F, K, found `R`",
        ),
    ] {
        assert_eq!(
            mock::check_quirks(key, &quirks).unwrap_err().to_string(),
            message
        );
    }
}
