//! The drivers of the chiller and of the temperature logger.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use instruments::{
    chiller::{self, Chiller},
    clock::TimeMode,
    instrument::Instrument,
    link::LinkProfile,
    logger::{self, Logger},
    mock::{
        self, MockOptions,
        plant::{Action, ChillerState},
    },
    scpi::decode::Terminator,
    transcript::Tap,
    transport::MemoryHub,
    units::Celsius,
};

use crate::{
    device::open,
    drivers_common::{Rig, dialect, in_time, in_virtual_time},
    mocks_plant::Recorder,
};

const CHILLER: &str = "julabo";
const LOGGER: &str = "keysight-34970a";

async fn chiller(rig: &Rig) -> Chiller {
    let dialect = dialect!(chiller, CHILLER);
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

async fn logger(rig: &Rig, channels: &[u16]) -> Logger {
    let dialect = dialect!(logger, LOGGER);
    Instrument::new(rig.link(dialect.profile()).await, dialect).on_channels(channels.to_vec())
}

fn bath(rig: &Rig) -> ChillerState {
    match rig.last_action() {
        Action::Chiller(state) => state,
        other => panic!("a chiller does not do {other:?}"),
    }
}

#[test]
fn the_chiller_starts_and_stops_at_the_pace_it_needs() {
    for strict_pacing in [true, false] {
        in_virtual_time(async |clock| {
            let rig = Rig::with(
                clock,
                CHILLER,
                &MockOptions::quirk("strict_pacing", strict_pacing),
                &[],
            );
            let mut chiller = chiller(&rig).await;
            assert_eq!(chiller.status().await.unwrap().raw, "02 REMOTE STOP");
            for celsius in [12.5, -19.99, 40.0] {
                chiller.start(Celsius(celsius)).await.unwrap();
                assert_eq!(
                    bath(&rig),
                    ChillerState {
                        running: true,
                        setpoint_degc: celsius
                    }
                );
            }
            let status = chiller.status().await.unwrap();
            assert!(
                status.running && status.remote && status.alarm.is_none(),
                "{status:?}"
            );
            assert_eq!(chiller.temperature().await.unwrap(), Celsius(24.5));
            chiller.stop().await.unwrap();
            chiller.stop().await.unwrap();
            assert!(!bath(&rig).running);
        });
    }
}

#[test]
fn the_mock_does_lose_what_comes_too_soon() {
    // Else the test above would not show that the profile keeps the pace.
    in_virtual_time(async |clock| {
        let rig = Rig::with(
            clock,
            CHILLER,
            &MockOptions::quirk("strict_pacing", true),
            &[],
        );
        let dialect = dialect!(chiller, CHILLER);
        let hasty = LinkProfile {
            write_gap: Duration::ZERO,
            timeout: Duration::from_millis(500),
            ..dialect.profile()
        };
        let mut chiller = Instrument::new(rig.link(hasty).await, dialect);
        let lost = chiller.start(Celsius(12.5)).await.unwrap_err().to_string();
        assert_eq!(
            lost,
            "dev: expected an answer to `IN_SP_00` within 500ms, found none"
        );
    });
}

#[test]
fn the_sensor_and_the_set_point_of_somebody_else_are_put_back() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, CHILLER);
        rig.earlier_user(
            Terminator::Cr,
            &["OUT_MODE_04 1", "OUT_SP_00 70", "OUT_MODE_05 1"],
        )
        .await;
        let before = rig.actions().len();
        let mut chiller = chiller(&rig).await;
        chiller.start(Celsius(20.0)).await.unwrap();
        assert!(rig.actions().len() > before);
        assert_eq!(
            bath(&rig),
            ChillerState {
                running: true,
                setpoint_degc: 20.0
            }
        );
        let sent = rig.sent();
        let at = |message: &str| {
            sent.iter()
                .position(|other| other == message)
                .unwrap_or_else(|| panic!("no {message} in {sent:?}"))
        };
        assert!(
            at("OUT_MODE_04 0") < at("OUT_SP_00 20.00")
                && at("OUT_MODE_01 0") < at("OUT_MODE_05 1"),
            "{sent:?}"
        );
        assert!(
            at("OUT_SP_00 20.00") < at("OUT_MODE_05 1"),
            "the set-point comes before the start"
        );
    });
}

#[test]
fn in_manual_mode_nothing_is_ignored_silently() {
    in_virtual_time(async |clock| {
        let rig = Rig::with(clock, CHILLER, &MockOptions::quirk("local", true), &[]);
        let mut chiller = chiller(&rig).await;
        let text = "dev: `STATUS` answered `00 MANUAL STOP`: expected remote mode (set it on the \
        panel: in manual mode commands are ignored)";
        assert_eq!(
            chiller.start(Celsius(20.0)).await.unwrap_err().to_string(),
            text
        );
        assert!(
            !rig.sent().iter().any(|message| message.starts_with("OUT_")),
            "nothing is commanded"
        );
        // It is already stopped, which is the aim of the command.
        chiller.stop().await.unwrap();
        assert_eq!(
            bath(&rig),
            ChillerState {
                running: false,
                setpoint_degc: 25.0
            }
        );
    });
    in_virtual_time(async |clock| {
        let manual: &[(&str, &[u8])] =
            &[("IN_MODE_05", b"1\r\n"), ("STATUS", b"01 MANUAL START\r\n")];
        let rig = Rig::with(clock, CHILLER, &MockOptions::quirk("local", true), manual);
        let text = "dev: `STATUS` answered `01 MANUAL START`: expected remote mode (set it on the \
        panel: in manual mode commands are ignored)";
        assert_eq!(
            chiller(&rig).await.stop().await.unwrap_err().to_string(),
            text
        );
    });
    // Manual mode that hides behind a message shows in the read-back.
    in_virtual_time(async |clock| {
        let hidden: &[(&str, &[u8])] = &[(
            "STATUS",
            b"-09 COMMAND NOT ALLOWED IN CURRENT OPERATING MODE\r\n",
        )];
        let rig = Rig::with(clock, CHILLER, &MockOptions::quirk("local", true), hidden);
        let error = chiller(&rig)
            .await
            .start(Celsius(20.0))
            .await
            .unwrap_err()
            .to_string();
        assert_eq!(
            error,
            "dev: after `OUT_SP_00 20.00`, `IN_SP_00` answered `25.00`: expected a number within \
            6.0e-3 of 20"
        );
    });
}

#[test]
fn a_set_point_beyond_the_range_is_an_error() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, CHILLER);
        let error = chiller(&rig)
            .await
            .start(Celsius(-40.0))
            .await
            .unwrap_err()
            .to_string();
        assert_eq!(
            error,
            "dev: after `OUT_SP_00 -40.00`, `IN_SP_00` answered `25.00`: expected a number within \
            6.0e-3 of -40"
        );
        assert!(!bath(&rig).running);
    });
}

#[test]
fn an_alarm_keeps_the_chiller_from_starting_and_a_warning_does_not() {
    in_virtual_time(async |clock| {
        for (status, alarm) in [
            (&b"-01 LOW LEVEL ALARM\r\n"[..], true),
            (b"-14 EXCESS TEMPERATURE PROTECTOR ALARM\r\n", true),
            (b"PUMP?\r\n", true),
            (b"-20 WARNING: CLEAN CONDENSOR\r\n", false),
            (b"-10 VALUE TOO SMALL\r\n", false),
        ] {
            let lies: Vec<(&'static str, &'static [u8])> = vec![("STATUS", status)];
            let rig = Rig::with(clock.clone(), CHILLER, &MockOptions::default(), &lies);
            let started = chiller(&rig).await.start(Celsius(20.0)).await;
            let raw = String::from_utf8_lossy(status).trim().to_owned();
            let expected =
                alarm.then(|| format!("dev: `STATUS` answered `{raw}`: expected no alarm"));
            assert_eq!(started.err().map(|error| error.to_string()), expected);
            assert_eq!(bath(&rig).running, !alarm);
        }
        let rig = Rig::lying(clock, CHILLER, &[("IN_PV_00", b"---.--\r\n")]);
        let error = chiller(&rig)
            .await
            .temperature()
            .await
            .unwrap_err()
            .to_string();
        assert_eq!(
            error,
            "dev: `IN_PV_00` answered `---.--`: expected a temperature"
        );
    });
}

#[test]
fn the_chiller_is_driven_over_a_pseudo_terminal() {
    in_time(TimeMode::Real, async |clock| {
        let plant = Arc::new(Mutex::new(Recorder::default()));
        let options = MockOptions::quirk("strict_pacing", true);
        let (path, _task) = mock::serve_pty(
            mock::make(CHILLER, plant.clone(), &options).unwrap(),
            clock.clone(),
        )
        .unwrap();
        let dialect = dialect!(chiller, CHILLER);
        // On a busy machine an answer may take its time.
        let profile = LinkProfile {
            timeout: Duration::from_secs(20),
            ..dialect.profile()
        };
        let address = format!("serial:{path}?baud=4800&parity=even&data=7&flow=rtscts");
        let link = open(&address, profile, &clock, &MemoryHub::new(), Tap::none())
            .await
            .unwrap();
        let mut chiller = Instrument::new(link, dialect);
        assert!(dialect.recognises(&chiller.identify().await.unwrap()));
        chiller.start(Celsius(15.25)).await.unwrap();
        assert_eq!(chiller.temperature().await.unwrap(), Celsius(24.5));
        let (_, last) = *plant.lock().unwrap().actions.last().unwrap();
        assert_eq!(
            last,
            Action::Chiller(ChillerState {
                running: true,
                setpoint_degc: 15.25
            })
        );
        chiller.stop().await.unwrap();
    });
}

#[test]
fn the_logger_gives_each_channel_its_own_temperature() {
    // 101 is the cell, 102 the air, 103 the bath, 104 is open.
    let of = |channel: u16| {
        [
            Some(Celsius(25.374)),
            Some(Celsius(22.0)),
            Some(Celsius(24.5)),
            None,
        ][usize::from(channel - 101)]
    };
    in_virtual_time(async |clock| {
        for channels in [
            &[101, 102][..],
            &[102, 101],
            &[104, 101, 103],
            &[104],
            &[103, 101, 103],
        ] {
            let rig = Rig::new(clock.clone(), LOGGER);
            rig.earlier_user(
                Terminator::Lf,
                &[
                    "UNIT:TEMP F",
                    "FORM:READ:CHAN ON",
                    "FORM:READ:UNIT ON",
                    "TRIG:COUN 3",
                    "NONSENSE",
                ],
            )
            .await;
            let mut logger = logger(&rig, channels).await;
            logger.configure().await.unwrap();
            for _ in 0..2 {
                assert_eq!(
                    logger.scan().await.unwrap(),
                    channels
                        .iter()
                        .map(|channel| of(*channel))
                        .collect::<Vec<_>>()
                );
            }
            let scan = rig
                .sent()
                .into_iter()
                .find(|message| message.starts_with("ROUT:SCAN"))
                .unwrap();
            let list: Vec<u16> = scan[12..scan.len() - 1]
                .split(',')
                .map(|channel| channel.parse().unwrap())
                .collect();
            assert!(
                list.is_sorted_by(|a, b| a < b),
                "{scan}: the instrument scans in rising order, each channel once"
            );
        }
    });
}

#[test]
fn a_scan_that_is_none_is_an_error() {
    in_virtual_time(async |clock| {
        for (answer, shown) in [
            (&b"+2.53740000E+01\n"[..], "+2.53740000E+01"),
            (
                b"+2.5E+01,+2.2E+01,+2.4E+01\n",
                "+2.5E+01,+2.2E+01,+2.4E+01",
            ),
            (b"+2.5E+01 C,+2.2E+01 C\n", "+2.5E+01 C,+2.2E+01 C"),
        ] {
            let lies: Vec<(&'static str, &'static [u8])> = vec![("READ?", answer)];
            let rig = Rig::with(clock.clone(), LOGGER, &MockOptions::default(), &lies);
            let mut logger = logger(&rig, &[101, 102]).await;
            logger.configure().await.unwrap();
            assert_eq!(
                logger.scan().await.unwrap_err().to_string(),
                format!("dev: `READ?` answered `{shown}`: expected 2 readings")
            );
        }
        let rig = Rig::new(clock, LOGGER);
        let error = logger(&rig, &[101, 999])
            .await
            .configure()
            .await
            .unwrap_err()
            .to_string();
        assert_eq!(
            error,
            "dev: `CONF:TEMP TC,K,(@101,999)` was refused: -222, Data out of range"
        );
    });
}
