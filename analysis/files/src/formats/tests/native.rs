//! Vendor formats that are not tables with named columns, with synthetic files; `corpus` has the
//! real ones.

use super::{parse, parse_file};
use std::path::Path;

fn error_message(name: &str, bytes: &[u8]) -> String {
    parse(Path::new(name), bytes).unwrap_err().to_string()
}

/// Frequencies and impedances of the spectra of a file.
fn points(name: &str, bytes: &[u8]) -> Vec<Vec<[f64; 3]>> {
    let read = parse_file(Path::new(name), bytes).unwrap_or_else(|error| panic!("{error}"));
    let of = |spectrum: &analysis_signal::spectrum::Spectrum| {
        let points = spectrum.points.iter();
        points
            .map(|p| [p.freq_hz, p.z_ohm.re, p.z_ohm.im])
            .collect()
    };
    read.spectra.iter().map(|s| of(&s.spectrum)).collect()
}

const TWO: [[f64; 3]; 2] = [[1.0, 0.03, -0.01], [10.0, 0.02, -0.005]];

fn autolab() -> String {
    let mut text = "VERSION8.0\n 2\n 1\n".to_owned();
    for [freq, re, im] in TWO {
        text += &format!(" {freq}\n {re}\n {}\n", -im);
        text += &" 0.0\n".repeat(6);
    }
    text
}

fn elchemea() -> String {
    let [a, b] = TWO.map(|[f, re, im]| format!("{f} {re} {im}\n"));
    format!("made of 1 2 3\n\n2\n{b}{a}")
}

fn ivium() -> Vec<u8> {
    let mut bytes = [[0_u8; 16].as_slice(), b"\x48\0\0\0\r\n"].concat();
    for method in ["CyclicVoltammetry", "Impedance"] {
        bytes.extend(format!("Method={method}\r\nprimary_data  \r\n3 \r\n2 \r\n").bytes());
        for [freq, re, im] in TWO {
            bytes.extend(format!("{re} {im}\t{freq}\r\n").bytes());
        }
        bytes.extend(b"\0\0\xff\r\n");
    }
    bytes
}

fn palmsens() -> Vec<u8> {
    let array = |name: &str, values: [f64; 2]| {
        let [a, b] = values;
        format!(r#"{{"Description":"{name}","DataValues":[{{"V":{a}}},{{"V":{b}}}]}}"#)
    };
    let [f, re, im] = [0, 1, 2].map(|k| TWO.map(|point| point[k]));
    let values = [
        array("Frequency", f),
        array("ZRe", re),
        array("ZIm", im.map(|v| -v)),
    ];
    let text = format!(
        r#"{{"Type":"PalmSens.DataFiles.SessionFile","Measurements":[{{"DataSet":{{"Values":[{}]}}}}]}}"#,
        values.join(",")
    );
    utf_16(&text, u16::to_le_bytes)
}

fn utf_16(text: &str, bytes: fn(u16) -> [u8; 2]) -> Vec<u8> {
    let units = std::iter::once(0xFEFF).chain(text.encode_utf16());
    units.flat_map(bytes).collect()
}

#[test]
fn each_maker_gives_the_same_points_whatever_the_file_is_called() {
    for bytes in [
        autolab().into_bytes(),
        elchemea().into_bytes(),
        ivium(),
        palmsens(),
    ] {
        for name in ["cell.dat", "cell"] {
            assert_eq!(points(name, &bytes), [TWO.to_vec()]);
        }
    }
}

#[test]
fn text_of_two_bytes_is_read_as_any_other() {
    let text = "freq_hz,z_re_ohm,z_im_ohm\n1,0.03,-0.01\n10,0.02,-0.005\n";
    for bytes in [u16::to_le_bytes, u16::to_be_bytes] {
        assert_eq!(points("cell.csv", &utf_16(text, bytes)), [TWO.to_vec()]);
    }
    let comma = "Frequency (Hz);Z' (Ω);-Z'' (Ω)\n1,0;0,03;0,01\n10,0;0,02;0,005\n";
    assert_eq!(
        points("cell.csv", &utf_16(comma, u16::to_le_bytes)),
        [TWO.to_vec()]
    );
}

#[test]
fn what_is_wrong_is_reported_with_its_line() {
    let cut = autolab().replacen(" 0.02\n", "", 1);
    assert!(error_message("a.dfr", cut.as_bytes()).contains("the end of the file"));
    let wrong = autolab().replacen("0.02", "x", 1);
    let met = error_message("a.dfr", wrong.as_bytes());
    assert!(
        met.contains("line 14") && met.contains("expected Re Z in Ω"),
        "{met}"
    );
    let negative = autolab().replacen(" 10\n", " -10\n", 1);
    let met = error_message("a.dfr", negative.as_bytes());
    assert!(met.contains("a frequency above 0 Hz"), "{met}");
    let many = autolab().replacen(" 2\n", " 99999999999\n", 1);
    assert!(error_message("a.dfr", many.as_bytes()).contains("the end of the file"));
    let json = utf_16(
        "{\"Type\":\"PalmSens.DataFiles.SessionFile\",",
        u16::to_le_bytes,
    );
    assert!(error_message("a.pssession", &json).contains("expected JSON"));
    let three = String::from_utf8_lossy(&ivium()).replace("3 \r\n2", "4 \r\n2");
    assert!(error_message("a.idf", three.as_bytes()).contains("4 columns"));
}

#[test]
fn cut_and_flipped_files_never_panic() {
    let mut state = 88_172_645_463_325_252_u64;
    let mut draw = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below as u64) as usize
    };
    for whole in [
        autolab().into_bytes(),
        elchemea().into_bytes(),
        ivium(),
        palmsens(),
    ] {
        for cut in 0..whole.len() {
            let _ = parse(Path::new("a"), &whole[..cut]);
        }
        for _ in 0..2000 {
            let mut bytes = whole.clone();
            for _ in 0..=draw(3) {
                let at = draw(bytes.len());
                bytes[at] = draw(256) as u8;
            }
            let _ = parse(Path::new("a"), &bytes);
        }
    }
}
