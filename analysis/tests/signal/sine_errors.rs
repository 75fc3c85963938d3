//! Refusals of the sinusoid fit, and their messages.

use analysis::sine::{
    Channel, CodeScale, FitOptions, Record, fit_free_frequency, fit_known_frequency,
};

const SCALE: CodeScale = CodeScale {
    volts_per_code: 1e-3,
    offset_v: 0.0,
    code_min: -2048,
    code_max: 2047,
    code_step: 1,
};

fn refusal(channels: &[Channel<'_>], interval_s: f64, freq_hz: f64) -> String {
    fit_known_frequency(
        &Record {
            channels,
            interval_s,
        },
        freq_hz,
        &FitOptions::default(),
    )
    .unwrap_err()
    .to_string()
}

fn sine(count: usize) -> Vec<f64> {
    (0..count).map(|n| (0.1 * n as f64).sin()).collect()
}

#[test]
fn the_record_and_the_frequency_are_checked() {
    let wave = sine(1000);
    let good = [Channel::volts(&wave)];
    let cases: [(&[Channel<'_>], f64, f64, &str); 9] = [
        (&[], 1e-3, 10.0, "expected at least one channel, met none"),
        (
            &good,
            0.0,
            10.0,
            "expected a sampling interval above 0 s, met 0 s",
        ),
        (
            &good,
            f64::NAN,
            10.0,
            "expected a sampling interval above 0 s, met NaN s",
        ),
        (
            &good,
            1e-3,
            -1.0,
            "expected a frequency above 0 Hz, met -1 Hz",
        ),
        (
            &good,
            1e-3,
            f64::NAN,
            "expected a frequency above 0 Hz, met NaN Hz",
        ),
        (
            &good,
            1e-3,
            500.0,
            "expected a frequency below half the sampling rate (500 Hz), met 500 Hz",
        ),
        (
            &good,
            1e-3,
            1.25,
            "expected at least 1.4 periods of 1.25 Hz in the record, met 1.250",
        ),
        (
            &[Channel::volts(&wave[..9])],
            1e-3,
            300.0,
            "channel 1: expected at least 10 usable samples, met 9 (0 more are clipped)",
        ),
        (
            &[Channel::volts(&wave), Channel::volts(&wave[1..])],
            1e-3,
            10.0,
            "channel 2: expected 1000 samples as in channel 1, met 999",
        ),
    ];
    for (channels, interval_s, freq_hz, text) in cases {
        assert_eq!(refusal(channels, interval_s, freq_hz), text);
    }
}

#[test]
fn samples_that_are_no_numbers_are_named() {
    for (index, value, text) in [
        (
            0,
            f64::NAN,
            "channel 2: expected finite samples, met NaN at sample 0",
        ),
        (
            700,
            f64::INFINITY,
            "channel 2: expected finite samples, met inf at sample 700",
        ),
        (
            999,
            f64::NEG_INFINITY,
            "channel 2: expected finite samples, met -inf at sample 999",
        ),
    ] {
        let (good, mut bad) = (sine(1000), sine(1000));
        bad[index] = value;
        let ranged = Channel::Volts {
            samples: &bad,
            lsb_v: None,
            range_v: Some((-10.0, 10.0)),
        };
        assert_eq!(
            refusal(&[Channel::volts(&good), Channel::volts(&bad)], 1e-3, 15.9),
            text
        );
        assert_eq!(
            refusal(&[Channel::volts(&good), ranged], 1e-3, 15.9),
            text,
            "bounds do not hide it"
        );
        let channels = [Channel::volts(&good), Channel::volts(&bad)];
        let free = fit_free_frequency(
            &Record {
                channels: &channels,
                interval_s: 1e-3,
            },
            None,
            &FitOptions::default(),
        );
        assert_eq!(free.unwrap_err().to_string(), text);
    }
}

#[test]
fn clipping_that_leaves_nothing_is_said() {
    let all = vec![2047i16; 1000];
    assert_eq!(
        refusal(&[Channel::codes(&all, SCALE)], 1e-3, 15.9),
        "channel 1: expected samples within the range of the ADC, met 1000 samples that are all \
        clipped"
    );
    let mut most = all.clone();
    most[10..15].copy_from_slice(&[1, 2, 3, 4, 5]);
    assert_eq!(
        refusal(&[Channel::codes(&most, SCALE)], 1e-3, 15.9),
        "channel 1: expected at least 10 usable samples, met 5 (995 more are clipped)"
    );
    let mut together = all;
    for (k, code) in together[100..112].iter_mut().enumerate() {
        *code = k as i16;
    }
    assert_eq!(
        refusal(&[Channel::codes(&together, SCALE)], 1e-3, 1.5),
        "channel 1: the 12 usable samples do not determine a sinusoid of 1.5 Hz besides offset and \
        drift"
    );
}

#[test]
fn an_unusable_scale_is_refused() {
    let codes = vec![1i16; 1000];
    for (volts_per_code, offset_v, met) in [
        (0.0, 0.0, "0 V and 0 V"),
        (f64::NAN, 0.0, "NaN V and 0 V"),
        (1.0, f64::NAN, "1 V and NaN V"),
    ] {
        let text = refusal(
            &[Channel::codes(
                &codes,
                CodeScale {
                    volts_per_code,
                    offset_v,
                    ..SCALE
                },
            )],
            1e-3,
            15.9,
        );
        assert!(
            text.starts_with("channel 1: expected a positive, finite volts-per-code")
                && text.ends_with(met),
            "{text}"
        );
    }
}

#[test]
fn a_frequency_is_not_found_where_nothing_oscillates() {
    let flat = vec![1.5; 1000];
    let channels = [Channel::volts(&flat)];
    let record = Record {
        channels: &channels,
        interval_s: 1e-3,
    };
    let text = "expected a sinusoid to find the frequency of, met channels without one";
    assert_eq!(
        fit_free_frequency(&record, None, &FitOptions::default())
            .unwrap_err()
            .to_string(),
        text
    );
    assert_eq!(
        fit_free_frequency(&record, Some(20.0), &FitOptions::default())
            .unwrap_err()
            .to_string(),
        text
    );
    let known = fit_known_frequency(&record, 20.0, &FitOptions::default()).unwrap();
    assert!(
        known.channels[0].phasor.norm() < 1e-12 && (known.channels[0].offset_v - 1.5).abs() < 1e-12,
        "a flat line is a fine answer"
    );
}
