//! The files of a run: written data are read back, and crashes leave the finished parts.

use std::fs;
use std::path::Path;

use analysis::{
    dataset::{
        CAPTURE_COLUMNS, CONDITION_COLUMNS, Capture, CaptureMeta, ChannelMeta, PointConditions,
        SERIES_COLUMNS, SPECTRUM_COLUMNS, SeriesRow, append_spectrum_csv, open_capture,
        read_capture, read_series_parquet, read_spectrum_csv, read_spectrum_parquet,
        write_atomically, write_biased_spectrum_csv, write_capture, write_series_parquet,
        write_spectrum_csv, write_spectrum_parquet,
    },
    numeric::Covariance2,
    sine::{CodeScale, FitOptions, Record, fit_free_frequency, fit_known_frequency},
    spectrum::{ImpedancePoint, Spectrum},
};
use num_complex::Complex64;

use crate::noise::Noise;

const HEADER: &str =
    "freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm,sigma_im_ohm,cov_re_im_ohm2,amplitude_a";

/// Awkward numbers: no short decimal, tiny, huge.
fn awkward(noise: &mut Noise) -> f64 {
    noise.gauss() * 10f64.powf(40.0 * noise.uniform() - 30.0)
}

fn points(seed: u64, count: usize) -> Vec<ImpedancePoint> {
    let mut noise = Noise::new(seed);
    let point = |index: usize| {
        // Squares of numbers, as a file that holds standard deviations gives them back.
        let [re, im] = [awkward(&mut noise), awkward(&mut noise)].map(|sigma| sigma * sigma);
        let covariance = Covariance2 {
            re_re: re,
            re_im: awkward(&mut noise),
            im_im: im,
        };
        let z_ohm = Complex64::new(awkward(&mut noise), awkward(&mut noise));
        ImpedancePoint {
            freq_hz: 0.1 * 1.5f64.powi(index as i32),
            z_ohm,
            covariance,
            amplitude_a: noise.uniform(),
        }
    };
    (0..count).map(point).collect()
}

fn bits(points: &[ImpedancePoint]) -> Vec<[u64; 7]> {
    let of = |p: &ImpedancePoint| {
        let c = p.covariance;
        [
            p.freq_hz,
            p.z_ohm.re,
            p.z_ohm.im,
            c.re_re,
            c.re_im,
            c.im_im,
            p.amplitude_a,
        ]
        .map(f64::to_bits)
    };
    points.iter().map(of).collect()
}

fn capture(count: usize) -> Capture {
    let mut noise = Noise::new(9);
    let scale = |k: f64| CodeScale {
        volts_per_code: 0.1 / 3.0 * k,
        offset_v: -3.7 / 7.0 * k,
        code_min: -2048,
        code_max: 2047,
        code_step: 1,
    };
    let channels = [1.0, 2.0, 3.0, 4.0].map(|k| ChannelMeta {
        scale: scale(k),
        volts_per_div: 0.02 * k,
    });
    let meta = CaptureMeta {
        label: "cell, \"point\" 3\n5 °C".into(),
        freq_hz: 0.1 + 0.2,
        interval_s: 1.0 / 3.0,
        start_s: 1e9 / 7.0,
        channels,
    };
    let mut codes: [Vec<i16>; 4] = std::array::from_fn(|_| {
        (0..count)
            .map(|n| (1500.0 * (1e-3 * n as f64).sin() + 3.0 * noise.gauss()) as i16)
            .collect()
    });
    (codes[0][0], codes[1][1]) = (i16::MIN, i16::MAX);
    Capture { meta, codes }
}

#[test]
fn a_capture_comes_back_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let (path, again) = (
        folder.path().join("a.parquet"),
        folder.path().join("b.parquet"),
    );
    // More than one row group.
    let written = capture(300_001);
    write_capture(&path, &written).unwrap();
    let read = read_capture(&path).unwrap();
    assert_eq!(read, written);
    assert_eq!(read.meta.start_s.to_bits(), written.meta.start_s.to_bits());
    write_capture(&again, &written).unwrap();
    assert!(
        fs::read(&path).unwrap() == fs::read(&again).unwrap(),
        "equal captures, equal bytes"
    );
    assert!(
        fs::metadata(&path).unwrap().len() < 4 * 2 * 300_001 + 20_000,
        "{} bytes: no more than two a code",
        fs::metadata(&path).unwrap().len()
    );
    let names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    assert_eq!(names.len(), 2, "nothing is left beside: {names:?}");
}

#[test]
fn a_capture_can_be_fitted_as_it_is() {
    let mut capture = capture(1000);
    for (k, codes) in capture.codes.iter_mut().enumerate() {
        *codes = (0..1000)
            .map(|n| (1000.0 * (0.1 * f64::from(n)).cos()).round() as i16 + k as i16)
            .collect();
    }
    capture.meta.interval_s = 1e-3;
    let channels = capture.channels();
    let freq_hz = 100.0 / std::f64::consts::TAU;
    let fit = fit_known_frequency(
        &Record {
            channels: &channels,
            interval_s: 1e-3,
        },
        freq_hz,
        &FitOptions::default(),
    )
    .unwrap();
    for (k, channel) in fit.channels.iter().enumerate() {
        let scale = capture.meta.channels[k].scale;
        assert!(
            (channel.phasor.re / (1000.0 * scale.volts_per_code) - 1.0).abs() < 1e-3,
            "{channel:?}"
        );
        let offset_v = k as f64 * scale.volts_per_code - scale.offset_v;
        assert!(
            (channel.offset_v - offset_v).abs() < 0.1 * scale.volts_per_code,
            "{channel:?}"
        );
    }
}

#[test]
fn channels_of_unlike_length_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.parquet");
    let mut capture = capture(100);
    capture.codes[2].pop();
    let text = write_capture(&path, &capture).unwrap_err().to_string();
    assert_eq!(
        text,
        format!(
            "{}, column code_c3: expected 100 samples as in code_c1, met 99",
            path.display()
        )
    );
    assert!(!path.exists());
}

#[test]
fn a_spectrum_comes_back_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let mut written = points(1, 40);
    written[3].covariance = Covariance2::UNKNOWN;
    written[4].amplitude_a = f64::NAN;
    write_spectrum_csv(&file("a.csv"), &written).unwrap();
    write_spectrum_parquet(&file("a.parquet"), &written).unwrap();
    let (csv, parquet) = (
        read_spectrum_csv(&file("a.csv")).unwrap(),
        read_spectrum_parquet(&file("a.parquet")).unwrap(),
    );
    assert_eq!(bits(&csv), bits(&written));
    assert_eq!(bits(&parquet), bits(&written));
    write_spectrum_csv(&file("b.csv"), &csv).unwrap();
    write_spectrum_parquet(&file("b.parquet"), &csv).unwrap();
    for kind in ["csv", "parquet"] {
        let [a, b] = ["a", "b"].map(|name| fs::read(file(&format!("{name}.{kind}"))).unwrap());
        assert!(a == b, "{kind} differs");
    }
    assert!(
        fs::read_to_string(file("a.csv"))
            .unwrap()
            .starts_with(&format!("{HEADER}\n0.1,"))
    );
}

#[test]
fn a_spectrum_under_a_direct_current_states_it_at_each_point_and_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("biased.csv");
    let point = |freq_hz: f64| ImpedancePoint {
        freq_hz,
        z_ohm: Complex64::new(0.02, -0.003),
        covariance: Covariance2 {
            re_re: 1.0e-5 * 1.0e-5,
            re_im: 0.0,
            im_im: 1.0e-5 * 1.0e-5,
        },
        amplitude_a: 1.0,
    };
    let spectrum = Spectrum::new("s".to_owned(), vec![point(1.0), point(2.0)]);
    let conditions = PointConditions {
        bias_a: -2.0,
        bias_measured_a: -1.97,
        sigma_bias_a: 0.02,
        charge_coulomb: -100.5,
        temperature_degc: None,
    };
    let flags = ["".to_owned(), "noise".to_owned()];
    write_biased_spectrum_csv(&path, &spectrum, &[conditions; 2], &flags).unwrap();
    let text = fs::read_to_string(&path).unwrap();
    assert_eq!(
        text.lines().next().unwrap(),
        format!("{HEADER},bias_a,bias_measured_a,sigma_bias_a,charge_c,temperature_c,flags")
    );
    assert!(
        text.lines()
            .nth(2)
            .unwrap()
            .ends_with(",1.0,-2.0,-1.97,0.02,-100.5,NaN,noise"),
        "{text}"
    );
    assert_eq!(
        bits(&read_spectrum_csv(&path).unwrap()),
        bits(&spectrum.points)
    );
    let read = analysis::formats::read_sourced(&path).unwrap();
    assert_eq!((read.len(), read[0].origin.bias_a), (1, Some(-2.0)));
    assert!(!read[0].origin.is_unbiased_cell());
    // A point whose conditions are missing is never read as one at rest.
    write_biased_spectrum_csv(&path, &spectrum, &[conditions], &flags).unwrap();
    let error = analysis::formats::read_sourced(&path)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("bias_a") && error.contains("line 3"),
        "{error}"
    );
}

#[test]
fn any_variance_comes_back_within_rounding() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("v.csv");
    let mut noise = Noise::new(4);
    let mut written = points(2, 20);
    for point in &mut written {
        point.covariance = Covariance2 {
            re_re: noise.uniform() * 1e-9,
            re_im: 0.0,
            im_im: noise.uniform(),
        };
    }
    write_spectrum_csv(&path, &written).unwrap();
    for (a, b) in written.iter().zip(read_spectrum_csv(&path).unwrap()) {
        assert!((a.covariance.re_re / b.covariance.re_re - 1.0).abs() < 4.0 * f64::EPSILON);
        assert!((a.covariance.im_im / b.covariance.im_im - 1.0).abs() < 4.0 * f64::EPSILON);
    }
}

#[test]
fn appended_points_make_the_file_that_is_written_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let (grown, whole) = (
        folder.path().join("grown.csv"),
        folder.path().join("whole.csv"),
    );
    // Long enough that the search for the last line end takes more than one step.
    let all = points(3, 45);
    for point in &all {
        append_spectrum_csv(&grown, point).unwrap();
    }
    write_spectrum_csv(&whole, &all).unwrap();
    assert!(fs::metadata(&whole).unwrap().len() > 4096);
    assert_eq!(
        fs::read_to_string(&grown).unwrap(),
        fs::read_to_string(&whole).unwrap()
    );
}

#[test]
fn a_crash_at_any_byte_costs_no_finished_point() {
    let folder = tempfile::tempdir().unwrap();
    let (path, whole) = (folder.path().join("s.csv"), folder.path().join("whole.csv"));
    let all = points(5, 3);
    write_spectrum_csv(&whole, &all).unwrap();
    let bytes = fs::read(&whole).unwrap();
    // Around every line end, and some in between: every append waits for the disk.
    let near_end =
        |cut: usize| bytes[cut.saturating_sub(2)..(cut + 2).min(bytes.len())].contains(&b'\n');
    for cut in (0..=bytes.len()).filter(|cut| cut % 29 == 0 || near_end(*cut)) {
        fs::write(&path, &bytes[..cut]).unwrap();
        let finished = bytes[..cut].iter().filter(|byte| **byte == b'\n').count();
        if finished > 0 {
            assert_eq!(
                bits(&read_spectrum_csv(&path).unwrap()),
                bits(&all[..finished - 1]),
                "cut at {cut}"
            );
        } else {
            assert!(
                read_spectrum_csv(&path)
                    .unwrap_err()
                    .to_string()
                    .contains("line 1: expected the header"),
                "cut at {cut}"
            );
        }
        for point in &all[finished.saturating_sub(1)..] {
            append_spectrum_csv(&path, point).unwrap();
        }
        assert!(
            fs::read(&path).unwrap() == bytes,
            "resumed after a cut at {cut}"
        );
    }
}

#[test]
fn a_torn_line_longer_than_the_next_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.csv");
    let point = points(5, 1)[0];
    fs::write(&path, format!("{HEADER}\n{}", "1.0,".repeat(2000))).unwrap();
    append_spectrum_csv(&path, &point).unwrap();
    assert_eq!(bits(&read_spectrum_csv(&path).unwrap()), bits(&[point]));
    assert!(fs::read_to_string(&path).unwrap().lines().count() == 2);
}

fn text_of(path: &Path, content: &str) -> String {
    fs::write(path, content).unwrap();
    read_spectrum_csv(path).unwrap_err().to_string()
}

#[test]
fn what_is_wrong_in_a_csv_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.csv");
    let shown = path.display();
    assert_eq!(
        text_of(&path, &format!("{HEADER}\n1,2,3,4,5,6,7\n1,2,x,4,5,6,7\n")),
        format!("{shown}, line 3, column z_im_ohm: expected a number, met \"x\"")
    );
    assert_eq!(
        text_of(&path, &format!("{HEADER}\n1,2,3,4,5,6\n")),
        format!("{shown}, line 2, column amplitude_a: expected a number, met \"end of line\"")
    );
    assert_eq!(
        text_of(&path, &format!("{HEADER}\n1,2,3,4,5,6,7,8\n")),
        format!(
            "{shown}, line 2, column amplitude_a: expected the end of the line after it, met \"8\""
        )
    );
    assert_eq!(
        text_of(&path, "f,re,im\n1,2,3\n"),
        format!("{shown}, line 1: expected the header {HEADER:?}, met \"f,re,im\"")
    );
    let text = append_spectrum_csv(&path, &points(1, 1)[0])
        .unwrap_err()
        .to_string();
    assert_eq!(
        text,
        format!("{shown}, line 1: expected the header {HEADER:?}, met \"f,re,im\"")
    );
    assert_eq!(
        fs::read_to_string(&path).unwrap(),
        "f,re,im\n1,2,3\n",
        "a foreign file is left as it is"
    );
    fs::write(&path, format!("{HEADER}\r\n1,2,3,,,,\r\n")).unwrap();
    let read = read_spectrum_csv(&path).unwrap();
    assert!(read.len() == 1 && read[0].covariance.re_re.is_nan() && read[0].amplitude_a.is_nan());
    let missing = folder.path().join("none.csv");
    assert_eq!(
        read_spectrum_csv(&missing).unwrap_err().to_string(),
        format!("{}: could not read the file", missing.display())
    );
}

#[test]
fn what_is_wrong_in_a_parquet_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.parquet");
    let shown = path.display();
    write_spectrum_parquet(&path, &points(1, 3)).unwrap();
    assert_eq!(
        read_capture(&path).unwrap_err().to_string(),
        format!("{shown}, metadata label: expected a text, met no such entry")
    );
    write_capture(&path, &capture(10)).unwrap();
    let text = read_spectrum_parquet(&path).unwrap_err().to_string();
    assert_eq!(
        text,
        format!("{shown}, column freq_hz: expected a column of 64-bit floats, met no such column")
    );
}

#[test]
fn a_damaged_capture_is_refused_whatever_the_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.parquet");
    write_capture(&path, &capture(200)).unwrap();
    let good = fs::read(&path).unwrap();
    let refused = |bytes: &[u8]| {
        // A new file each time: some file systems wait for the disk when an old one is overwritten.
        fs::remove_file(&path).unwrap();
        fs::write(&path, bytes).unwrap();
        read_capture(&path).unwrap_err().to_string()
    };
    for at in 0..good.len() {
        let mut bad = good.clone();
        bad[at] ^= 1 << (at % 8);
        let text = refused(&bad);
        assert!(
            text.starts_with(&format!(
                "{}: expected a file of this program with the checksum ",
                path.display()
            )),
            "byte {at}: {text}"
        );
    }
    for length in [0, 4, good.len() / 2, good.len() - 1] {
        assert!(
            refused(&good[..length]).ends_with("it is damaged or comes from elsewhere"),
            "cut at {length}"
        );
    }
    let text = refused(b"PAR1, or so it says");
    let expected = "expected a file of this program with the checksum in its metadata, met none; \
    it is damaged or comes from elsewhere";
    assert_eq!(text, format!("{}: {expected}", path.display()));
}

#[test]
fn a_series_comes_back_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let mut noise = Noise::new(8);
    let mut row = |n: u32| SeriesRow {
        time_s: 0.1 * f64::from(n),
        voltage_v: awkward(&mut noise),
        current_a: noise.gauss(),
        temperature_degc: 25.1,
    };
    let mut series: Vec<_> = (0..50).map(&mut row).collect();
    series[7].temperature_degc = f64::NAN;
    let bits = |rows: &[SeriesRow]| -> Vec<[u64; 4]> {
        rows.iter()
            .map(|r| [r.time_s, r.voltage_v, r.current_a, r.temperature_degc].map(f64::to_bits))
            .collect()
    };
    write_series_parquet(&file("a.parquet"), &series).unwrap();
    assert_eq!(
        bits(&read_series_parquet(&file("a.parquet")).unwrap()),
        bits(&series)
    );
    write_series_parquet(&file("empty.parquet"), &[]).unwrap();
    assert!(
        read_series_parquet(&file("empty.parquet"))
            .unwrap()
            .is_empty()
    );
}

#[test]
fn writing_whole_files_replaces_or_leaves() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.json");
    write_atomically(&path, b"one").unwrap();
    write_atomically(&path, b"two").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"two");
    let nowhere = folder.path().join("no/such/folder.json");
    let text = write_atomically(&nowhere, b"x").unwrap_err().to_string();
    assert!(
        text.ends_with("no/such/.folder.json.partial: could not write the file"),
        "{text}"
    );
    let text = write_atomically(Path::new("/"), b"x")
        .unwrap_err()
        .to_string();
    assert_eq!(text, "/: could not write the file");
}

#[test]
fn every_column_says_its_unit() {
    for spec in CAPTURE_COLUMNS
        .iter()
        .chain(SPECTRUM_COLUMNS)
        .chain(CONDITION_COLUMNS)
        .chain(SERIES_COLUMNS)
    {
        let suffix = match spec.unit {
            "Hz" => "_hz",
            "Ω" => "_ohm",
            "Ω²" => "_ohm2",
            "A" => "_a",
            "V" => "_v",
            "s" => "_s",
            "°C" | "C" => "_c",
            "1" => "",
            other => panic!("unit {other} of {} is new here", spec.name),
        };
        assert!(
            spec.name.ends_with(suffix) && !spec.doc.is_empty(),
            "{spec:?}"
        );
    }
    let names: Vec<_> = SPECTRUM_COLUMNS.iter().map(|spec| spec.name).collect();
    assert_eq!(names.join(","), HEADER);
}

#[test]
fn a_capture_that_stays_on_disk_gives_the_same_fit() {
    // Two row groups and a part of a third, a few samples of which clip.
    let count = 2 * 262_144 + 10_001;
    let codes = [0.0_f64, 1.1, 0.4, 2.0].map(|phase| {
        let sample = |k: u32| {
            let value = 1800.0 * (1.0e-3 * f64::from(k) + phase).cos()
                + 7.0 * (f64::from(k) * 0.618_034).fract();
            if k % 100_003 == 7 {
                2047
            } else {
                value.round() as i16
            }
        };
        (0..count).map(sample).collect::<Vec<i16>>()
    });
    let scale = CodeScale {
        volts_per_code: 1.0e-4,
        offset_v: 0.2,
        code_min: -2048,
        code_max: 2047,
        code_step: 1,
    };
    let channels = [ChannelMeta {
        scale,
        volts_per_div: 0.1,
    }; 4];
    let meta = CaptureMeta {
        label: "large".to_owned(),
        freq_hz: 159.155,
        interval_s: 1.0e-6,
        start_s: 0.0,
        channels,
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.parquet");
    write_capture(&path, &Capture { meta, codes }).unwrap();
    let (whole, stored) = (read_capture(&path).unwrap(), open_capture(&path).unwrap());
    assert_eq!(
        (stored.meta(), stored.samples()),
        (&whole.meta, count as usize)
    );
    let options = FitOptions {
        harmonics: vec![2, 3],
        ..FitOptions::default()
    };
    let fits = [whole.channels(), stored.channels()].map(|channels| {
        let record = Record {
            channels: &channels,
            interval_s: 1.0e-6,
        };
        let known = fit_known_frequency(&record, 159.155, &options).unwrap();
        (
            known,
            fit_free_frequency(&record, Some(159.155), &options).unwrap(),
        )
    });
    assert_eq!(fits[0], fits[1]);
    // A flipped bit is found without loading the file.
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[1000] ^= 4;
    std::fs::write(&path, bytes).unwrap();
    let message = open_capture(&path).unwrap_err().to_string();
    assert!(message.contains("with the checksum"), "{message}");
}
