//! Files made by the layouts of each version, which `fastnda` 1.3.1 reads with the same numbers, and
//! such files damaged.

use super::super::{ReadSeries, SeriesOptions, read_record};
use super::record::{amperes_per_count, date_s};
use super::text;
use std::path::{Path, PathBuf};

const FILES: [&str; 11] = [
    "neware_8.nda",
    "neware_22.nda",
    "neware_29.nda",
    "neware_130_2.nda",
    "neware_130_19.nda",
    "neware_2.ndax",
    "neware_5.ndax",
    "neware_11.ndax",
    "neware_14.ndax",
    "neware_16.ndax",
    "neware_17.ndax",
];

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/data/series/neware")
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(folder().join(name)).unwrap()
}

/// Time, voltage, current (discharge positive) and number of the step: at 10 s a rest, 1.5 A out, a
/// rest, 0.5 A in. Of the two rows at the end of a step, which have the same time, the later one.
fn rows() -> Vec<[f64; 4]> {
    let steps = [
        (3, 4.0, 0.0, 0.0),
        (6, 3.85, -0.0123, 1.5),
        (5, 3.9, 0.0021, 0.0),
        (6, 3.95, 0.0056, -0.5),
    ];
    let (mut rows, mut begun_s) = (Vec::new(), 0.0);
    for (number, (count, volts, slope, amperes)) in (1..).zip(steps) {
        for k in (0..count).map(f64::from) {
            let time_s = begun_s + 10.0 * k;
            if rows.last().is_some_and(|last: &[f64; 4]| last[0] == time_s) {
                rows.pop();
            }
            rows.push([time_s, volts + slope * k, amperes, f64::from(number)]);
        }
        begun_s += 10.0 * f64::from(count - 1);
    }
    rows
}

fn read(name: &str) -> ReadSeries {
    read_record(&folder().join(name), &SeriesOptions::default()).unwrap()
}

#[test]
fn each_version_gives_the_rows_that_stand_in_it() {
    let expected = rows();
    assert_eq!(expected.len(), 17);
    for name in FILES {
        let read = read(name);
        let series = &read.series;
        assert_eq!(series.time_s.len(), expected.len(), "{name}");
        // BTS 9 writes a fraction of a second.
        let begun_s = if name == "neware_130_19.nda" {
            0.25
        } else {
            0.0
        };
        for (k, [time_s, volts, amperes, step]) in expected.iter().enumerate() {
            let met = (series.time_s[k], series.voltage_v[k], series.current_a[k]);
            let near = (met.0 - time_s - begun_s).abs() < 1e-9
                && (met.1 - volts).abs() < 3e-7
                && (met.2 - amperes).abs() < 1e-9;
            assert!(near, "{name}, row {k}: {met:?}");
            assert_eq!(read.steps.as_ref().unwrap()[k], *step, "{name}, row {k}");
        }
        assert_eq!(read.left_out.len(), 3, "{name}");
    }
}

#[test]
fn the_first_auxiliary_channel_is_the_temperature_and_the_others_are_reported() {
    let of = |name: &str| read(name).series.temperature_degc.unwrap();
    for name in ["neware_22.nda", "neware_29.nda"] {
        // The third row, 25.2 °C, is at the time of the fourth.
        let met = of(name);
        assert!(
            (met[0] - 25.0).abs() < 1e-9 && (met[2] - 25.3).abs() < 1e-9,
            "{name}: {met:?}"
        );
    }
    assert_eq!(of("neware_130_19.nda")[2], 25.375);
    assert!(of("neware_8.nda").iter().all(|degrees| degrees.is_nan()));
    let expected = "neware_29.nda: of 2 auxiliary channels the temperature of channel 1 is read";
    assert!(read("neware_29.nda").notes.contains(&expected.to_owned()));
    assert!(
        read("neware_22.nda")
            .notes
            .iter()
            .all(|note| !note.contains("auxiliary"))
    );
}

#[test]
fn a_version_that_is_not_known_is_refused_by_its_number() {
    let refused = |name: &str, bytes: &[u8], words: &str| {
        let message = text(Path::new(name), bytes)
            .unwrap()
            .unwrap_err()
            .to_string();
        assert!(message.contains(words), "{message}");
    };
    let mut nda = bytes("neware_8.nda");
    nda[14] = 11;
    refused(
        "x.nda",
        &nda,
        "x.nda: expected a Neware .nda that can be decoded: version 11 of .nda is not known; export",
    );
    let mut bts9 = bytes("neware_130_2.nda");
    bts9[16] = 42;
    refused("x.nda", &bts9, "version 42 of BTS 9's records is not known");
    // A record of another length.
    let mut other = bytes("neware_130_19.nda");
    let at = other.len() - 5 - 56;
    other.remove(at);
    refused(
        "x.nda",
        &other,
        "whose length is none of [52, 56, 60] bytes",
    );
    // Both programs read the range 6000 mA in 0.1 mA; they differ beyond 200 A.
    let mut range = bytes("neware_22.nda");
    range[1024 + 78..1024 + 82].copy_from_slice(&(-100_000_000_i32).to_le_bytes());
    refused(
        "x.nda",
        &range,
        "a current range of -100000000 mA, whose unit is not known",
    );
    refused(
        "x.nda",
        &bytes("neware_22.nda")[..2000],
        "announces 1720 bytes from byte 2744 on, and it has 2000",
    );
    refused("x.nda", b"NEWARE", "version 0 of .nda");
}

#[test]
fn units_of_a_current_and_moments_are_those_that_are_published() {
    for (range, unit) in [
        (1, 1e-7),
        (50, 1e-6),
        (500, 1e-5),
        (6000, 1e-4),
        (200_000, 1e-4),
        (-5, 1e-8),
        (-100, 1e-6),
        (-6000, 1e-5),
    ] {
        assert_eq!(amperes_per_count(range).unwrap(), unit, "{range}");
    }
    assert!(amperes_per_count(0).is_err());
    // 2024-02-29 12:34:56, and the first day of 1970.
    assert_eq!(date_s(&[0xE8, 7, 2, 29, 12, 34, 56], 0), 1_709_210_096.0);
    assert_eq!(date_s(&[0xB2, 7, 1, 1, 0, 0, 0], 0), 0.0);
}

#[test]
fn cut_and_flipped_files_never_panic() {
    for name in FILES {
        let whole = bytes(name);
        for k in 0..200 {
            let at = whole.len() * k / 200;
            let _ = text(Path::new(name), &whole[..at]);
            let mut flipped = whole.clone();
            flipped[at] ^= 0xFF;
            let _ = text(Path::new(name), &flipped);
        }
    }
}
