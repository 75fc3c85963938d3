//! The drivers of the load and of the DC supply.

use instruments::{
    instrument::Instrument,
    load::{self, Discharge, Draw, Load},
    mock::{
        MockOptions,
        plant::{LoadState, SupplyState},
    },
    scpi::decode::Terminator,
    supply::{self, Charge, Supply},
    units::{Amps, Volts, Watts},
};

use crate::drivers_common::{Rig, dialect, in_virtual_time};

const LOAD: &str = "siglent-sdl1000x";
const SUPPLY: &str = "siglent-spd3303x";
const DISCHARGE: Discharge = Discharge {
    draw: Draw::Current(Amps(1.5)),
    stop_below: Volts(2.75),
};
const CHARGE: Charge = Charge {
    voltage: Volts(4.2),
    current: Amps(1.25),
};

async fn load(rig: &Rig) -> Load {
    let dialect = dialect!(load, LOAD);
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

async fn supply(rig: &Rig) -> Supply {
    let dialect = dialect!(supply, SUPPLY);
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

#[test]
fn the_load_sinks_what_was_asked_and_stops_by_itself() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, LOAD);
        let mut load = load(&rig).await;
        load.prepare(&DISCHARGE).await.unwrap();
        assert!(rig.loads().iter().all(|state| !state.input_on));
        load.energise().await.unwrap();
        let expected = LoadState {
            input_on: true,
            current_a: 1.5,
            min_voltage_v: 2.75,
            power_w: None,
        };
        assert_eq!(
            rig.loads()
                .into_iter()
                .filter(|state| state.input_on)
                .collect::<Vec<_>>(),
            [expected]
        );
        assert_eq!(load.measure().await.unwrap(), (Volts(3.7), Amps(1.5)));
        load.safe().await.unwrap();
        load.safe().await.unwrap();
        assert!(!rig.loads().last().unwrap().input_on);
    });
}

#[test]
fn a_load_that_was_left_on_latched_in_another_function_and_range_is_off_before_it_is_changed() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, LOAD);
        let messages = [
            ":VOLT:LATC ON",
            ":VOLT:LEV:ON 1",
            ":FUNC POWer",
            ":CURR:LEV:IMM 9",
            ":CURR:IRANG 5",
            ":FUNC CURRent",
            ":INP ON",
        ];
        rig.earlier_user(Terminator::Lf, &messages).await;
        assert!(rig.loads().last().unwrap().input_on);
        let start = rig.loads().len();
        let mut load = load(&rig).await;
        // More than the range in which it was left.
        load.prepare(&Discharge {
            draw: Draw::Current(Amps(6.0)),
            ..DISCHARGE
        })
        .await
        .unwrap();
        assert!(
            rig.loads()[start..].iter().all(|state| !state.input_on),
            "{:?}",
            &rig.loads()[start..]
        );
        load.energise().await.unwrap();
        // Latched, it would go on sinking below the stop voltage: nothing of the latch is left.
        assert_eq!(
            *rig.loads().last().unwrap(),
            LoadState {
                input_on: true,
                current_a: 6.0,
                min_voltage_v: 2.75,
                power_w: None
            }
        );
    });
}

#[test]
fn what_the_load_does_not_take_over_is_named() {
    in_virtual_time(async |clock| {
        let clamped = "dev: after `:CURR:LEV:IMM 35.0000`, `:CURR:LEV:IMM?` answered `30.000000`: \
        expected a number within 2.0e-3 of 35";
        let rig = Rig::new(clock.clone(), LOAD);
        let mut load = load(&rig).await;
        let too_much = Discharge {
            draw: Draw::Current(Amps(35.0)),
            ..DISCHARGE
        };
        assert_eq!(
            load.prepare(&too_much).await.unwrap_err().to_string(),
            clamped
        );
        let reversed = load
            .prepare(&Discharge {
                draw: Draw::Current(Amps(-1.0)),
                ..DISCHARGE
            })
            .await
            .unwrap_err()
            .to_string();
        assert!(
            reversed.ends_with("answered `0.000000`: expected a number within 2.0e-3 of -1"),
            "{reversed}"
        );
        for (query, answer, text) in [
            (
                ":INP?",
                &b"1\n"[..],
                "dev: after `:INP OFF`, `:INP?` answered `1`: expected one of 0, OFF",
            ),
            (
                ":FUNC?",
                b"VOLTAGE\n",
                "dev: after `:FUNC CURRent`, `:FUNC?` answered `VOLTAGE`: expected one of CURRENT",
            ),
            (
                ":CURR:IRANG?",
                b"30\n",
                "dev: after `:CURR:IRANG 5`, `:CURR:IRANG?` answered `30`: expected a number \
                within 1.0e-1 of 5",
            ),
            (
                ":VOLT:LATC?",
                b"1\n",
                "dev: after `:VOLT:LATC OFF`, `:VOLT:LATC?` answered `1`: expected 0 or OFF",
            ),
            (
                ":VOLT:LEV:ON?",
                b"0.000000\n",
                "dev: after `:VOLT:LEV:ON 2.750`, `:VOLT:LEV:ON?` answered `0.000000`: expected a \
                number within 5.0e-3 of 2.75",
            ),
            (
                ":CURR:PROT:LEV?",
                b"30.000000\n",
                "dev: after `:CURR:PROT:LEV 1.7500`, `:CURR:PROT:LEV?` answered `30.000000`: \
                expected a number within 5.0e-3 of 1.75",
            ),
            (
                ":CURR:PROT:STAT?",
                b"0\n",
                "dev: after `:CURR:PROT:STAT ON`, `:CURR:PROT:STAT?` answered `0`: expected 1 or \
                ON",
            ),
        ] {
            let rig = Rig::lying(clock.clone(), LOAD, &[(query, answer)]);
            let mut load = self::load(&rig).await;
            assert_eq!(
                load.prepare(&DISCHARGE).await.unwrap_err().to_string(),
                text
            );
            assert!(rig.loads().iter().all(|state| !state.input_on));
        }
        let rig = Rig::lying(clock, LOAD, &[(":INP?", b"0\n")]);
        let refused = self::load(&rig)
            .await
            .energise()
            .await
            .unwrap_err()
            .to_string();
        assert_eq!(
            refused,
            "dev: after `:INP ON`, `:INP?` answered `0`: expected one of 1, ON"
        );
    });
}

#[test]
fn the_supply_charges_with_what_was_asked() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, SUPPLY);
        rig.earlier_user(
            Terminator::Lf,
            &[
                "OUTP:TRACK 2",
                "CH1:VOLT 30",
                "CH1:CURR 3",
                "OUTP CH1,ON",
                "OUTP CH2,ON",
                "NONSENSE",
            ],
        )
        .await;
        let start = rig.supplies().len();
        let mut supply = supply(&rig).await;
        supply.prepare(&CHARGE).await.unwrap();
        let states = rig.supplies();
        assert_eq!(
            states[start],
            SupplyState {
                output_on: false,
                voltage_v: 30.0,
                current_a: 3.0
            },
            "off comes first"
        );
        assert!(
            states[start..].iter().all(|state| !state.output_on),
            "{states:?}"
        );
        supply.energise().await.unwrap();
        assert_eq!(
            *rig.supplies().last().unwrap(),
            SupplyState {
                output_on: true,
                voltage_v: 4.2,
                current_a: 1.25
            }
        );
        assert_eq!(supply.measure().await.unwrap(), (Volts(4.0), Amps(1.25)));
        supply.safe().await.unwrap();
        supply.safe().await.unwrap();
        assert!(!rig.supplies().last().unwrap().output_on);
        drop(supply);
        // Another channel's business is left alone, and its bit is not taken for ours; the tracking
        // is gone.
        assert_eq!(rig.ask("SYST:STAT?").await, "0x0024");
    });
}

#[test]
fn what_the_supply_does_not_take_over_is_named() {
    in_virtual_time(async |clock| {
        for (charge, text) in [
            (
                Charge {
                    voltage: Volts(36.0),
                    ..CHARGE
                },
                "dev: after `CH1:VOLT 36.000`, `CH1:VOLT?` answered `32.000`: expected a number \
                within 2.0e-3 of 36",
            ),
            (
                Charge {
                    current: Amps(5.0),
                    ..CHARGE
                },
                "dev: after `CH1:CURR 5.000`, `CH1:CURR?` answered `3.200`: expected a number \
                within 2.0e-3 of 5",
            ),
        ] {
            let rig = Rig::new(clock.clone(), SUPPLY);
            assert_eq!(
                supply(&rig)
                    .await
                    .prepare(&charge)
                    .await
                    .unwrap_err()
                    .to_string(),
                text
            );
        }
        // Channel 1 on; channels 1 and 2 in parallel; not a status word.
        for (status, text) in [
            (
                &b"0x0014\n"[..],
                "dev: after `OUTP CH1,OFF`, `SYST:STAT?` answered `its output is on`: expected off",
            ),
            (
                b"0x0028\n",
                "dev: after `OUTP:TRACK 0`, `SYST:STAT?` answered `its coupling is parallel`: \
                expected none",
            ),
            (
                b"OFF\n",
                "dev: after `OUTP CH1,OFF`, `SYST:STAT?` answered `OFF`: expected a hexadecimal \
                status word",
            ),
        ] {
            let lies: Vec<(&'static str, &'static [u8])> = vec![("SYST:STAT?", status)];
            let rig = Rig::with(clock.clone(), SUPPLY, &MockOptions::default(), &lies);
            assert_eq!(
                supply(&rig)
                    .await
                    .prepare(&CHARGE)
                    .await
                    .unwrap_err()
                    .to_string(),
                text
            );
        }
        // Only channel 2 is on.
        let rig = Rig::lying(clock, SUPPLY, &[("SYST:STAT?", b"0x0224\n")]);
        let mut supply = supply(&rig).await;
        supply.safe().await.unwrap();
        let text =
            "dev: after `OUTP CH1,ON`, `SYST:STAT?` answered `its output is off`: expected on";
        assert_eq!(supply.energise().await.unwrap_err().to_string(), text);
    });
}

#[test]
fn levels_change_while_load_and_supply_are_on() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock.clone(), LOAD);
        let mut load = load(&rig).await;
        load.prepare(&Discharge {
            draw: Draw::Power(Watts(60.0)),
            ..DISCHARGE
        })
        .await
        .unwrap();
        load.level(Draw::Power(Watts(20.0))).await.unwrap();
        load.energise().await.unwrap();
        load.level(Draw::Power(Watts(45.5))).await.unwrap();
        assert_eq!(
            *rig.loads().last().unwrap(),
            LoadState {
                input_on: true,
                current_a: 0.0,
                min_voltage_v: 2.75,
                power_w: Some(45.5)
            }
        );
        let too_much = load
            .level(Draw::Power(Watts(260.0)))
            .await
            .unwrap_err()
            .to_string();
        assert!(
            too_much.ends_with("answered `200.000000`: expected a number within 1.0e-2 of 260"),
            "{too_much}"
        );
        let rig = Rig::new(clock, SUPPLY);
        let mut supply = supply(&rig).await;
        supply.prepare(&CHARGE).await.unwrap();
        supply.energise().await.unwrap();
        supply.level(Amps(0.5)).await.unwrap();
        let last = rig.supplies().last().copied().unwrap();
        assert!(
            last.output_on && last.current_a == 0.5 && last.voltage_v == 4.2,
            "{last:?}"
        );
    });
}
