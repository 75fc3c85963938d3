//! The oscilloscope's driver: the volts of the world come out, or a clear error, never other volts.

use std::f64::consts::TAU;

use instruments::{
    clock::{Clock, TimeMode},
    instrument::Instrument,
    mock::{self, MockOptions},
    scope::{self, Intent, Scope, Trigger, Vertical, Waveform},
    scpi::decode::Terminator,
    transcript::Tap,
    transport::MemoryHub,
    units::{Seconds, Volts},
};

use crate::{
    device::open,
    drivers_common::{Rig, dialect, in_time, in_virtual_time},
    mocks_plant::{AMPLITUDE_V, FREQ_HZ, Recorder, base_v},
};

const MODEL: &str = "siglent-sds800x-hd";
const MEMORY_POINTS: u64 = 100_000;
const TIME_PER_DIV_S: f64 = 0.05;
const PER_DIV_V: f64 = 0.04;
/// ADC counts per division.
const COUNTS_PER_DIV: f64 = 480.0;

async fn driver(rig: &Rig) -> Scope {
    let dialect = dialect!(scope, MODEL);
    Instrument::new(rig.link(dialect.profile()).await, dialect)
}

fn pages_of(page_points: usize) -> MockOptions {
    MockOptions::quirk("page_points", page_points as f64)
}

/// The channel's constant part at the centre of the screen, a little off so that all digits of the
/// offset matter.
fn vertical(channel: u8) -> Vertical {
    Vertical {
        channel,
        per_div: Volts(PER_DIV_V),
        offset: Volts(-base_v(channel) - 0.012_3),
    }
}

fn level() -> Intent {
    Intent::Trigger(Trigger {
        channel: 4,
        level: Volts(base_v(4)),
    })
}

async fn arm(scope: &mut Scope) {
    scope
        .set(&Intent::Session {
            memory_points: MEMORY_POINTS,
        })
        .await
        .unwrap();
    for channel in 1..=4 {
        scope
            .set(&Intent::Vertical(vertical(channel)))
            .await
            .unwrap();
    }
    for intent in [
        Intent::Timebase(Seconds(TIME_PER_DIV_S)),
        level(),
        Intent::Arm,
    ] {
        scope.set(&intent).await.unwrap();
    }
}

/// Sets everything, waits for a trigger, stops.
async fn capture(rig: &Rig) -> Scope {
    let mut scope = driver(rig).await;
    arm(&mut scope).await;
    rig.clock.sleep_s(2.03).await;
    scope.stop().await.unwrap();
    scope
}

/// Checks the signal of the world: the trigger, a rising crossing of the middle, is at the centre
/// of the screen.
fn assert_true(waveform: &Waveform, channel: u8, points: usize) {
    assert_eq!((waveform.channel, waveform.codes.len()), (channel, points));
    let span_s = 10.0 * TIME_PER_DIV_S;
    assert!(
        (waveform.interval_s * points as f64 / span_s - 1.0).abs() < 1e-3,
        "{} s apart",
        waveform.interval_s
    );
    for (index, &code) in waveform.codes.iter().enumerate() {
        let met_v = f64::from(code) * waveform.preamble.volts_per_code - waveform.preamble.offset_v;
        let at_s = index as f64 * waveform.interval_s - span_s / 2.0;
        let true_v = base_v(channel) + AMPLITUDE_V * (TAU * FREQ_HZ * at_s).sin();
        assert!(
            (met_v - true_v).abs() < 0.52 * PER_DIV_V / COUNTS_PER_DIV,
            "channel {channel}, sample {index}: {met_v} V, truly {true_v} V"
        );
    }
}

#[test]
fn the_volts_of_every_channel_come_back_at_any_stride_and_page_size() {
    // The last pages hold fewer points than the thinned-out record, so that the driver fetches all
    // and thins out itself.
    for (page_points, wanted, points) in [
        (10_000_000, 100_000, 100_000),
        (10_000_000, 2_000, 2_000),
        (2_000, 2_000, 2_000),
        (1_999, 2_000, 2_000),
        (30_000, 100_000, 100_000),
        (700, 900, 901),
    ] {
        in_virtual_time(async |clock| {
            let rig = Rig::with(clock, MODEL, &pages_of(page_points), &[]);
            let mut scope = capture(&rig).await;
            for channel in [4, 1, 3, 2] {
                assert_true(
                    &scope.download(channel, wanted).await.unwrap(),
                    channel,
                    points,
                );
            }
            let requests = &rig.plant.lock().unwrap().requests;
            let pages_together = requests
                .iter()
                .all(|request| request.stride == 1 || request.first == 0);
            assert!(pages_together, "no second page of a thinned-out record");
        });
    }
}

/// Settings of the transfer that are sent while the scope acquires are not sent again; a frame of
/// another length than was thought is fetched from the beginning.
#[test]
fn what_was_chosen_before_the_stop_is_fetched_with_two_questions() {
    for (page_points, wanted, from_the_beginning) in [
        (10_000_000, 2_000, false),
        (10_000_000, 100_000, false),
        (700, 2_000, true),
    ] {
        in_virtual_time(async |clock| {
            let rig = Rig::with(clock, MODEL, &pages_of(page_points), &[]);
            let mut scope = driver(&rig).await;
            arm(&mut scope).await;
            let chosen = scope.choose(4, wanted).await.unwrap().unwrap();
            rig.clock.sleep_s(2.03).await;
            scope.stop().await.unwrap();
            let before = rig.sent().len();
            let waveform = scope.download_chosen(chosen, wanted).await.unwrap();
            assert_true(&waveform, 4, usize::try_from(wanted).unwrap());
            let sent = rig.sent();
            let again = sent[before..]
                .iter()
                .any(|message| message.starts_with(":WAVeform:SOURce "));
            assert_eq!(again, from_the_beginning, "{:?}", &sent[before..]);
            if !again {
                assert_eq!(sent[before..], [":WAVeform:PREamble?", ":WAVeform:DATA?"]);
            }
            assert_true(
                &scope.download_beside(1, wanted, &waveform).await.unwrap(),
                1,
                usize::try_from(wanted).unwrap(),
            );
        });
    }
}

#[test]
fn a_scope_that_takes_transfer_settings_only_when_stopped_receives_nothing_before() {
    in_virtual_time(async |clock| {
        // It does not show that it has taken the stride.
        let rig = Rig::lying(clock, MODEL, &[(":WAVeform:INTerval?", b"1\n")]);
        let mut scope = driver(&rig).await;
        arm(&mut scope).await;
        assert_eq!(scope.choose(4, 2_000).await.unwrap(), None);
        let dialect = dialect!(scope, "rigol-dho800");
        let rig = Rig::new(rig.clock.clone(), "rigol-dho800");
        let mut scope = Instrument::new(rig.link(dialect.profile()).await, dialect);
        assert_eq!(scope.choose(4, 2_000).await.unwrap(), None);
        assert_eq!(rig.sent(), [""; 0]);
    });
}

#[test]
fn the_length_of_a_page_is_what_comes() {
    for wanted in [1_000, 100_000] {
        in_virtual_time(async |clock| {
            let rig = Rig::with(clock, MODEL, &pages_of(777), &[]);
            let waveform = capture(&rig).await.download(2, wanted).await.unwrap();
            assert_true(&waveform, 2, usize::try_from(wanted).unwrap());
        });
    }
}

#[test]
fn the_transfer_and_the_screen_of_an_earlier_client_are_overridden() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let messages = [
            ":WAVeform:SOURce C3",
            ":WAVeform:STARt 50000",
            ":WAVeform:POINt 17",
            ":WAVeform:INTerval 9",
            ":WAVeform:WIDTh BYTE",
            ":WAVeform:BYTeorder MSB",
            ":FORMat:DATA CUSTom,2",
            ":TIMebase:REFerence POSition",
            ":TIMebase:REFerence:POSition 20",
            ":TIMebase:DELay 0.3",
            ":CHANnel1:PROBe VALue,10",
            ":CHANnel1:COUPling AC",
            ":CHANnel2:PROBe VALue,100",
            ":TRIGger:EDGE:SLOPe FALLing",
            ":TRIGger:MODE SINGle",
        ];
        rig.earlier_user(Terminator::Lf, &messages).await;
        let mut scope = capture(&rig).await;
        for channel in 1..=4 {
            let waveform = scope.download(channel, MEMORY_POINTS).await.unwrap();
            assert_true(&waveform, channel, 100_000);
            assert!(
                waveform.preamble.delay_s.abs() < 1e-9,
                "the trigger is at the centre, not {} s from it",
                waveform.preamble.delay_s
            );
        }
    });
}

#[test]
fn a_transfer_that_somebody_else_changed_in_between_is_set_again() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        drop(capture(&rig).await);
        rig.earlier_user(
            Terminator::Lf,
            &[":WAVeform:STARt 3;INTerval 7;POINt 2;WIDTh BYTE"],
        )
        .await;
        let waveform = driver(&rig).await.download(4, MEMORY_POINTS).await.unwrap();
        assert_true(&waveform, 4, 100_000);
    });
}

#[test]
fn settings_are_believed_before_the_number_format_is_set() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut scope = driver(&rig).await;
        // Without a session: the read-back of a fresh instrument has three digits.
        let odd = Vertical {
            channel: 4,
            per_div: Volts(0.012_345),
            offset: Volts(-3.812_34),
        };
        scope.set(&Intent::Vertical(odd)).await.unwrap();
        scope.set(&Intent::Timebase(Seconds(0.002))).await.unwrap();
        drop(scope);
        assert_eq!(rig.ask(":CHANnel4:OFFSet?").await, "-3.8123400000000E+00");
    });
}

#[test]
fn an_offset_that_was_clamped_is_an_error_that_says_so() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut scope = driver(&rig).await;
        let fine = Vertical {
            channel: 4,
            per_div: Volts(0.004),
            offset: Volts(-3.8),
        };
        let text = "dev: after `:CHANnel4:OFFSet -3.80000E0`, `:CHANnel4:OFFSet?` answered \
        `-1.6000000000000E+00`: expected a number within 1.0e-3 of -3.8";
        assert_eq!(
            scope
                .set(&Intent::Vertical(fine))
                .await
                .unwrap_err()
                .to_string(),
            text
        );
        let per_div = scope
            .capabilities()
            .scale_for_offset(fine.per_div, fine.offset);
        scope
            .set(&Intent::Vertical(Vertical { per_div, ..fine }))
            .await
            .unwrap();
        let coarse = Vertical {
            channel: 4,
            per_div: Volts(20.0),
            offset: Volts(0.0),
        };
        let text = "dev: after `:CHANnel4:SCALe 2.00000E1`, `:CHANnel4:SCALe?` answered \
        `1.0000000000000E+01`: expected a number within 4.0e-1 of 20";
        assert_eq!(
            scope
                .set(&Intent::Vertical(coarse))
                .await
                .unwrap_err()
                .to_string(),
            text
        );
    });
}

#[test]
fn a_rolling_scope_keeps_what_lies_before_the_stop() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut scope = driver(&rig).await;
        arm(&mut scope).await;
        let beyond = Intent::Trigger(Trigger {
            channel: 4,
            level: Volts(3.85),
        });
        for intent in [beyond, Intent::Roll] {
            scope.set(&intent).await.unwrap();
        }
        rig.clock.sleep_s(2.013).await;
        let stopped_s = rig.clock.now_s();
        scope.stop().await.unwrap();
        let waveform = scope.download(4, MEMORY_POINTS).await.unwrap();
        let start_s = stopped_s - 10.0 * TIME_PER_DIV_S;
        for (index, &code) in waveform.codes.iter().enumerate() {
            let met_v =
                f64::from(code) * waveform.preamble.volts_per_code - waveform.preamble.offset_v;
            let at_s = start_s + index as f64 * waveform.interval_s;
            let true_v = base_v(4) + AMPLITUDE_V * (TAU * FREQ_HZ * at_s).sin();
            // The clock of virtual time has steps of a millisecond.
            assert!(
                (met_v - true_v).abs() < 1.0e-3 * TAU * FREQ_HZ * AMPLITUDE_V + 0.1 * PER_DIV_V,
                "{at_s} s: {met_v} V, {true_v} V"
            );
        }
    });
}

#[test]
fn without_a_frame_there_are_no_volts_but_a_reason() {
    const TEXT: &str = "dev: `:WAVeform:PREamble?` answered `346 bytes`: expected a descriptor \
    that starts with WAVEDESC: no frame was completed since the scope was armed";
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut scope = driver(&rig).await;
        arm(&mut scope).await;
        // Stopped before the screen is full.
        rig.clock.sleep_s(0.1).await;
        scope.stop().await.unwrap();
        assert_eq!(scope.download(4, 1000).await.unwrap_err().to_string(), TEXT);
        // A level that is never crossed.
        scope
            .set(&Intent::Trigger(Trigger {
                channel: 4,
                level: Volts(3.85),
            }))
            .await
            .unwrap();
        scope.set(&Intent::Arm).await.unwrap();
        rig.clock.sleep_s(5.0).await;
        scope.stop().await.unwrap();
        assert_eq!(scope.download(4, 1000).await.unwrap_err().to_string(), TEXT);
        // The next frame is as good as ever: an old one does not linger, and the link lives.
        scope.set(&level()).await.unwrap();
        scope.set(&Intent::Arm).await.unwrap();
        rig.clock.sleep_s(2.0).await;
        scope.stop().await.unwrap();
        assert_true(&scope.download(4, MEMORY_POINTS).await.unwrap(), 4, 100_000);
    });
}

#[test]
fn clipping_shows_in_its_share_and_extremes() {
    in_virtual_time(async |clock| {
        let rig = Rig::new(clock, MODEL);
        let mut scope = driver(&rig).await;
        arm(&mut scope).await;
        let clipping = Vertical {
            channel: 4,
            per_div: Volts(0.02),
            offset: Volts(-base_v(4)),
        };
        scope.set(&Intent::Vertical(clipping)).await.unwrap();
        rig.clock.sleep_s(2.0).await;
        scope.stop().await.unwrap();
        let clipped = scope.download(4, MEMORY_POINTS).await.unwrap();
        // The converter ends 2048 counts below and 2047 above the centre; the sine is beyond for
        // this part of its period.
        let ends_v = [2048.0, 2047.0].map(|counts| counts * 0.02 / COUNTS_PER_DIV);
        let beyond = ends_v
            .map(|end_v| (end_v / AMPLITUDE_V).acos() / std::f64::consts::PI)
            .iter()
            .sum::<f64>();
        assert!(
            (clipped.clipped_share() - beyond).abs() < 2e-3,
            "{} of the samples, truly {beyond}",
            clipped.clipped_share()
        );
        let (least_v, greatest_v) = clipped.extremes_v();
        assert!(
            (least_v - (base_v(4) - ends_v[0])).abs() < 1e-6
                && (greatest_v - (base_v(4) + ends_v[1])).abs() < 1e-6,
            "{least_v} {greatest_v}"
        );
        let whole = scope.download(1, MEMORY_POINTS).await.unwrap();
        assert_eq!(whole.clipped_share(), 0.0);
        let (least_v, greatest_v) = whole.extremes_v();
        let count_v = PER_DIV_V / COUNTS_PER_DIV;
        assert!(
            (least_v + AMPLITUDE_V).abs() < count_v && (greatest_v - AMPLITUDE_V).abs() < count_v,
            "{least_v} {greatest_v}"
        );
    });
}

#[test]
fn the_samples_of_another_channel_are_never_taken() {
    in_virtual_time(async |clock| {
        let rig = Rig::lying(clock.clone(), MODEL, &[(":WAVeform:SOURce C4", b"")]);
        let mut scope = capture(&rig).await;
        let text = "dev: after `:WAVeform:SOURce C4`, `:WAVeform:SOURce?` answered `C1`: expected \
        `C4` in the answer";
        assert_eq!(scope.download(4, 100).await.unwrap_err().to_string(), text);
        let rig = Rig::new(clock, MODEL);
        let mut scope = driver(&rig).await;
        let error = scope
            .set(&Intent::Trigger(Trigger {
                channel: 5,
                level: Volts(0.0),
            }))
            .await
            .unwrap_err()
            .to_string();
        assert_eq!(
            error,
            "dev: after `:TRIGger:EDGE:SOURce C5`, `:TRIGger:EDGE:SOURce?` answered `C1`: expected \
            `C5` in the answer"
        );
    });
}

#[test]
fn pages_that_do_not_fit_are_named() {
    let data = "dev: `:WAVeform:DATA?` answered";
    for (query, answer, text) in [
        (
            ":WAVeform:DATA?",
            &b"#9000000000\n\n"[..],
            format!(
                "{data} `a page of 0 bytes after 0 of \
        100000 points`: expected samples"
            ),
        ),
        (
            ":WAVeform:DATA?",
            b"#9000000003abc\n\n",
            format!(
                "{data} `a page of 3 bytes after 0 of 100000 points`: expected two bytes a \
            sample"
            ),
        ),
        (
            ":WAVeform:PREamble?",
            b"#9000000008WAVEDESC\n\n",
            "expected a descriptor of at least 346 \
        bytes"
                .to_owned(),
        ),
        (
            ":WAVeform:STARt?",
            b"12\n",
            "dev: after `:WAVeform:STARt 0`, `:WAVeform:STARt?` answered `12`: expected a number \
            within 5.0e-1 of 0"
                .to_owned(),
        ),
        (
            ":WAVeform:INTerval?",
            b"2\n",
            "expected a number within 5.0e-1 of 1".to_owned(),
        ),
        (
            ":WAVeform:WIDTh?",
            b"BYTE\n",
            "expected one of WORD".to_owned(),
        ),
        (
            ":ACQuire:POINts?",
            b"0.00E+00\n",
            "dev: `:ACQuire:POINts?` answered `0.00E+00`: expected \
        a number of points"
                .to_owned(),
        ),
    ] {
        in_virtual_time(async |clock| {
            let rig = Rig::lying(clock, MODEL, &[(query, answer)]);
            let error = capture(&rig)
                .await
                .download(4, MEMORY_POINTS)
                .await
                .unwrap_err()
                .to_string();
            assert!(error.ends_with(&text), "{error}: expected {text}");
        });
    }
}

#[test]
fn a_scope_that_does_not_stop_is_polled_gently_and_given_up() {
    in_virtual_time(async |clock| {
        let rig = Rig::lying(clock, MODEL, &[(":TRIGger:STATus?", b"Auto\n")]);
        let mut scope = driver(&rig).await;
        let start_s = rig.clock.now_s();
        let error = scope.stop().await.unwrap_err().to_string();
        assert_eq!(
            error,
            "dev: `:TRIGger:STATus?` answered `Auto`: expected the stopped state within 5 s"
        );
        let polls = rig
            .sent()
            .iter()
            .filter(|message| message.ends_with("STATus?"))
            .count() as f64;
        assert!(
            polls >= 10.0 && (rig.clock.now_s() - start_s) / polls >= 0.1,
            "{polls} polls"
        );
    });
}

#[test]
fn over_a_socket_the_volts_are_the_same() {
    in_time(TimeMode::Real, async |clock: Clock| {
        let plant = std::sync::Arc::new(std::sync::Mutex::new(Recorder::default()));
        let device = mock::make(MODEL, plant, &pages_of(30_000)).unwrap();
        let (address, _task) = mock::serve_tcp(device, "127.0.0.1:0", clock.clone())
            .await
            .unwrap();
        let dialect = dialect!(scope, MODEL);
        let link = open(
            &format!("tcp://{address}"),
            dialect.profile(),
            &clock,
            &MemoryHub::new(),
            Tap::none(),
        )
        .await
        .unwrap();
        let mut scope = Instrument::new(link, dialect);
        arm(&mut scope).await;
        clock.sleep_s(0.7).await;
        scope.stop().await.unwrap();
        for channel in [1, 4] {
            assert_true(
                &scope.download(channel, MEMORY_POINTS).await.unwrap(),
                channel,
                100_000,
            );
        }
    });
}
