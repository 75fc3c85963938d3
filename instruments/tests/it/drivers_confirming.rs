//! Drivers of instruments that themselves confirm or refuse every write: the FAST-PS and the
//! thermostat board; and of the multimeter with one input.

use instruments::{
    chiller,
    instrument::Instrument,
    logger,
    mock::{
        MockOptions,
        plant::{Action, BathState},
        quirks::Quirks,
    },
    scpi::decode::Terminator,
    supply4q::{self, Holds, Limits, OwnLimits, Supply4q},
    units::{Amps, Celsius, Volts},
};

use crate::drivers_common::{Rig, dialect, in_virtual_time};

const FAST_PS: &str = "caenels-fast-ps";
const LIMITS: Limits = Limits {
    compliance: Volts(4.3),
    current: Amps(3.0),
};

async fn supply(rig: &Rig) -> Supply4q {
    let dialect = dialect!(supply4q, FAST_PS);
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

#[test]
fn a_supply_left_on_in_the_other_loop_is_off_before_it_is_changed_and_obeys_the_analog_input_alone()
{
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, FAST_PS);
        rig.earlier_user(Terminator::Cr, &["LOOP:V", "MON", "MWV:12"])
            .await;
        assert!(matches!(
            rig.drives().last(),
            Some(state) if state.output_on && !state.current_mode && state.setpoint == 12.0
        ));
        let start = rig.drives().len();
        let mut supply = supply(&rig).await;
        supply.prepare(&LIMITS).await.unwrap();
        assert!(
            rig.drives()[start..]
                .iter()
                .all(|state| !state.output_on && !state.analog_input),
            "{:?}",
            &rig.drives()[start..]
        );
        supply.energise().await.unwrap();
        let on = *rig.drives().last().unwrap();
        assert!(on.output_on && on.current_mode && on.analog_input, "{on:?}");
        assert_eq!(supply.measure().await.unwrap(), (Volts(3.75), Amps(-2.5)));
        let up = rig.drives().len();
        supply.safe().await.unwrap();
        supply.safe().await.unwrap();
        let down = rig.drives();
        assert!(!down.last().unwrap().output_on && !down.last().unwrap().analog_input);
        // The analog input is released only when the output is off: before, the digital set-point
        // would take over.
        assert!(
            down[up..]
                .iter()
                .all(|state| !state.output_on || state.analog_input),
            "{:?}",
            &down[up..]
        );
        drop(supply);
        let off = ["MOFF", "MST"];
        let prepare = ["LOOP:I", "LOOP:?", "UPMODE:NORMAL", "UPMODE:?"];
        let energise = ["UPMODE:ANALOG", "UPMODE:?", "MON", "MST", "MRV", "MRI"];
        let safe = [&off[..], &["UPMODE:NORMAL", "UPMODE:?"]].concat();
        assert_eq!(
            rig.sent(),
            [&off[..], &prepare, &energise, &safe, &safe].concat()
        );
    });
}

#[test]
fn what_it_holds_by_itself_is_asked_for_and_nothing_is_claimed() {
    in_virtual_time(async |clock| {
        let options = MockOptions {
            quirks: Quirks::default()
                .with("own_volts", 5.0)
                .with("own_amps", 3.5),
            ..MockOptions::default()
        };
        let rig = Rig::with(clock.clone(), FAST_PS, &options, &[]);
        let mut supply = self::supply(&rig).await;
        assert_eq!(supply.capabilities().holds, Holds::Nothing);
        assert_eq!(
            supply.own_limits().await.unwrap(),
            Some(OwnLimits {
                volts: (-5.0, 5.0),
                amps: (-3.5, 3.5)
            })
        );
        let looked = supply.look().await.unwrap();
        assert_eq!(looked.len(), 1, "{looked:?}");
        assert!(looked[0].as_scripted && looked[0].question == "MST");
        assert_eq!(rig.sent(), ["MLIMITS:?", "MST"], "looking changes nothing");
        for answer in [
            &b"#MLIMITS:-5.0:5.0:-3.5\r\n"[..],
            b"#MLIMITS:5.0:20.0:-3.5:3.5\r\n",
            b"#NAK:01\r\n",
        ] {
            let rig = Rig::lying(clock.clone(), FAST_PS, &[("MLIMITS:?", answer)]);
            let refused = self::supply(&rig)
                .await
                .own_limits()
                .await
                .unwrap_err()
                .to_string();
            assert!(
                refused.ends_with("expected least and greatest voltage and current, around zero"),
                "{refused}"
            );
        }
    });
}

#[test]
fn a_confirmation_that_the_state_belies_is_not_believed() {
    in_virtual_time(async |clock| {
        for (query, answer, message) in [
            (
                "MST",
                &b"#MST:08000001\r\n"[..],
                "`MST` answered `its output is on`: expected off",
            ),
            (
                "LOOP:?",
                b"#LOOP:V\r\n",
                "`LOOP:?` answered `#LOOP:V`: expected one of #LOOP:I",
            ),
            (
                "UPMODE:NORMAL",
                b"#NAK:02\r\n",
                "`UPMODE:NORMAL` answered `#NAK:02`: expected #AK (#NAK:02: unknown parameter)",
            ),
            (
                "MOFF",
                b"#NAK:77\r\n",
                "`MOFF` answered `#NAK:77`: expected #AK or #NAK:13",
            ),
        ] {
            let rig = Rig::lying(clock.clone(), FAST_PS, &[(query, answer)]);
            let met = supply(&rig)
                .await
                .prepare(&LIMITS)
                .await
                .unwrap_err()
                .to_string();
            assert!(met.ends_with(message), "{met}");
        }
    });
}

#[test]
fn the_thermostat_board_pulses_one_relay_and_a_pulse_that_is_too_long_is_not_sent() {
    in_virtual_time(async |clock| {
        let dialect = dialect!(chiller, "relay-thermostat");
        let rig = Rig::new(clock.clone(), "relay-thermostat");
        let mut board = Instrument::new(rig.link(dialect.profile()).await, dialect);
        assert!(board.is_regulated());
        board.start(Celsius(25.0)).await.unwrap();
        assert_eq!(board.temperature().await.unwrap(), Celsius(24.5));
        for (seconds, power) in [(8.5, 1.0), (-3.25, -1.0), (0.0, 0.0)] {
            board.pulse(seconds).await.unwrap();
            let Action::Bath(BathState {
                power: met,
                until_s,
            }) = rig.last_action()
            else {
                panic!("{:?}", rig.last_action())
            };
            assert_eq!(met, power);
            assert!(
                (until_s - clock.now_s() - f64::abs(seconds)).abs() < 0.1,
                "{until_s}"
            );
        }
        let refused = board.pulse(61.0).await.unwrap_err().to_string();
        assert_eq!(
            refused,
            "dev: `HEAT`: expected a pulse of at most 60 s, found 61 s; nothing was sent"
        );
        let none = board.pulse(f64::NAN).await.unwrap_err().to_string();
        assert!(none.ends_with("nothing was sent"), "{none}");
        drop(board);
        let rig = Rig::lying(clock, "relay-thermostat", &[("STATE", b"OFF\n")]);
        let mut board = Instrument::new(rig.link(dialect.profile()).await, dialect);
        let belied = board.pulse(5.0).await.unwrap_err().to_string();
        assert_eq!(
            belied,
            "dev: `STATE` answered `OFF`: expected `HEAT` in the answer"
        );
    });
}

#[test]
fn a_multimeter_that_was_left_in_fahrenheit_shows_celsius_and_an_open_thermocouple_is_none() {
    in_virtual_time(async |clock| {
        let dialect = dialect!(logger, "siglent-sdm3065x");
        assert!(dialect.has_channel(1) && !dialect.has_channel(2));
        for (quirks, cell) in [
            (Quirks::default().with("unit", "F"), Some(Celsius(25.374))),
            (Quirks::default().with("open_thermocouple", true), None),
        ] {
            let rig = Rig::with(
                clock.clone(),
                "siglent-sdm3065x",
                &MockOptions {
                    quirks,
                    ..MockOptions::default()
                },
                &[],
            );
            rig.earlier_user(Terminator::Lf, &["SAMP:COUN 7", "NONSENSE"])
                .await;
            let mut logger =
                Instrument::new(rig.link(dialect.profile()).await, dialect).on_channels(vec![1]);
            logger.configure().await.unwrap();
            assert_eq!(logger.scan().await.unwrap(), [cell]);
        }
    });
}
