//! Kinds of spectra that were read wrongly or refused for a wrong reason, reduced and with synthetic
//! numbers.

use crate::formats::{FileSpectra, parse_file};
use num_complex::Complex64;
use std::path::Path;

/// 14 mΩ, 6 mΩ with 4 ms, 9 mΩ with 0.5 s, from 2 kHz down to 20 mHz.
fn truth() -> Vec<(f64, Complex64)> {
    let of = |k: i32| {
        let f = 2000.0 * 10.0_f64.powf(-f64::from(k) / 4.0);
        let rc = |r: f64, tau: f64| r / Complex64::new(1.0, std::f64::consts::TAU * f * tau);
        (f, 0.014 + rc(0.006, 0.004) + rc(0.009, 0.5))
    };
    (0..21).map(of).collect()
}

fn text(head: &str, row: impl Fn(usize, f64, Complex64) -> String) -> String {
    let rows = truth()
        .into_iter()
        .enumerate()
        .map(|(k, (f, z))| row(k, f, z));
    head.to_owned() + &rows.collect::<Vec<_>>().join("\n") + "\n"
}

fn read(name: &str, text: &str) -> Result<FileSpectra, String> {
    parse_file(Path::new(name), text.as_bytes()).map_err(|error| error.to_string())
}

fn is_truth(name: &str, text: &str) -> FileSpectra {
    let read = read(name, text).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let [one] = read.spectra.as_slice() else {
        panic!("{} spectra\n{text}", read.spectra.len())
    };
    assert_eq!(one.spectrum.points.len(), 21, "{text}");
    for (point, (f, z)) in one.spectrum.points.iter().rev().zip(truth()) {
        let near =
            (point.freq_hz / f - 1.0).abs() < 1e-6 && (point.z_ohm - z).norm() < 1e-6 * z.norm();
        assert!(near, "{point:?}, not {f} Hz {z}\n{text}");
    }
    read
}

fn refused(text: &str, words: &[&str]) {
    let message = read("x.csv", text).expect_err(text);
    assert!(words.iter().all(|word| message.contains(word)), "{message}");
}

/// A number with a decimal comma.
fn comma(value: f64) -> String {
    format!("{value:.9}").replace('.', ",")
}

#[test]
fn names_that_programs_write_are_known() {
    let csv = |_: usize, f: f64, z: Complex64| format!("{f},{},{}", z.re, z.im);
    let minus = |_: usize, f: f64, z: Complex64| format!("{f},{},{}", z.re, -z.im);
    let milli = |_: usize, f: f64, z: Complex64| format!("{f},{},{}", 1e3 * z.re, 1e3 * z.im);
    for head in [
        "freq in Hz,Re(Z) in Ohm,Im(Z) in Ohm\n",
        "Frequenz,Realteil,Imaginaerteil\n",
        "fréquence (Hz),partie réelle (Ohm),partie imaginaire (Ohm)\n",
        "频率(Hz),阻抗实部(Ohm),阻抗虚部(Ohm)\n",
        "Data: Frequency,Data: Z',Data: Z''\n",
        "frequency_hertz,real_impedance_ohm,imaginary_impedance_ohm\n",
        "Frequency / Hz,Real Impedance / ohm,Imaginary Impedance / ohm\n",
        "f,r,x\n",
    ] {
        is_truth("x.csv", &text(head, csv));
    }
    for head in [
        "Freq/Hz,Re(Z)/Ohm,Minus Im(Z)/Ohm\n",
        "f,Re(Z),neg. Im(Z)\n",
    ] {
        is_truth("x.csv", &text(head, minus));
    }
    is_truth("x.csv", &text("Frequency[Hz],R[mOhm],X[mOhm]\n", milli));
    let maccor = "MACCOR\n\nFreq(Hz)\tZ'(a)\tZ''(b)\tVMag\tIMag\n\n";
    is_truth(
        "x.041",
        &text(maccor, |_, f, z| {
            format!("{f}\t{}\t{}\t0.01\t0.5", z.re, z.im)
        }),
    );
    let relax =
        "RelaxIS 3.0\nData: Frequency\tData: Z'\tData: Z''\nDC=0.1, TM=25\tModel: none\tcell\n";
    is_truth(
        "x.txt",
        &text(relax, |_, f, z| format!("{f}\t{}\t{}", z.re, z.im)),
    );
    let short = "EC-Lab ASCII FILE\nNb header lines : 3\nfreq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\tRwe/Ohm\tRce/Ohm\t\n";
    is_truth(
        "x.mpt",
        &text(short, |_, f, z| format!("{f}\t{}\t{}\t1.0", z.re, -z.im)),
    );
}

#[test]
fn lists_are_read_with_blanks_and_with_the_names_in_a_comment() {
    let blanks = |_: usize, f: f64, z: Complex64| format!("{f:.9e}   {:.9e} {:.9e}", z.re, z.im);
    is_truth("x.txt", &text("", blanks));
    is_truth("x.txt", &text("# made by a program\n", blanks));
    is_truth(
        "x.txt",
        &text("", |_, f, z| {
            format!("{} {} {}", comma(f), comma(z.re), comma(z.im))
        }),
    );
    // The comment names the columns.
    let turned = |_: usize, f: f64, z: Complex64| format!("{f:.9e} {:.9e} {:.9e}", -z.im, z.re);
    for head in [
        "# f(Hz) -ImZ(Ohm) ReZ(Ohm)\n",
        "# f, -ImZ, ReZ\n",
        "%f(Hz)  -ImZ(Ohm)  ReZ(Ohm)\n",
    ] {
        is_truth("x.txt", &text(head, turned));
    }
    let semicolons = |_: usize, f: f64, z: Complex64| {
        format!("{f:.9e};{:.9e};{:.9e}", z.norm(), z.arg().to_degrees())
    };
    is_truth(
        "x.txt",
        &text("%Frequency(Hz)    Modulus(Ohm)    Phase(deg)\n", semicolons),
    );
    let fortran = |_: usize, f: f64, z: Complex64| blanks(0, f, z).replace('e', "D");
    is_truth("x.dat", &text("", fortran));
}

#[test]
fn numbers_are_read_as_tables_write_them() {
    let head = "\"Frequency (Hz)\",\"Z' (Ohm)\",\"-Z'' (Ohm)\"\n";
    is_truth(
        "x.csv",
        &text(head, |_, f, z| {
            format!("\"{}\",\"{}\",\"{}\"", comma(f), comma(z.re), comma(-z.im))
        }),
    );
    // Thousands grouped by commas, by apostrophes, by points.
    let grouped = |f: f64, mark: char, point: char| {
        let text = format!("{f:.9}");
        let (whole, rest) = text.split_once('.').unwrap();
        let whole = if whole.len() > 3 {
            format!("{}{mark}{}", &whole[..1], &whole[1..])
        } else {
            whole.to_owned()
        };
        format!("{whole}{point}{rest}")
    };
    is_truth(
        "x.csv",
        &text(head, |_, f, z| {
            format!("\"{}\",{:.9},{:.9}", grouped(f, ',', '.'), z.re, -z.im)
        }),
    );
    let tabs = "f/Hz\tZ'/Ohm\tZ''/Ohm\n";
    is_truth(
        "x.txt",
        &text(tabs, |_, f, z| {
            format!("{}\t{}\t{}", grouped(f, '\'', '.'), z.re, z.im)
        }),
    );
    is_truth(
        "x.txt",
        &text(tabs, |_, f, z| {
            format!("{}\t{}\t{}", grouped(f, '.', ','), comma(z.re), comma(z.im))
        }),
    );
    is_truth(
        "x.txt",
        &text(tabs, |_, f, z| {
            format!(
                "{}\t{}\t{}",
                grouped(f, '\u{202f}', ','),
                comma(z.re),
                comma(z.im)
            )
        }),
    );
    is_truth(
        "x.txt",
        &text(tabs, |_, f, z| {
            format!("{f}\t{}\t{}", z.re, z.im).replace('-', "\u{2212}")
        }),
    );
}

#[test]
fn points_that_are_no_measurement_are_left_out_by_their_line() {
    let odd = |what: &'static str, head: &'static str| {
        text(head, move |k, f, z| match k {
            4 => format!("{f},{what},{what}"),
            _ => format!("{f},{},{}", z.re, z.im),
        })
    };
    for (what, head) in [
        ("9.9E37", "freq_hz,z_re_ohm,z_im_ohm\n"),
        ("9.91E+37", "f/Hz,Z'/Ohm,Z''/Ohm\n"),
        ("-9.9E37", ""),
        ("0", "f/Hz,Z'/Ohm,Z''/Ohm\n"),
        ("OVERLOAD", "f/Hz,Z'/Ohm,Z''/Ohm\n"),
        ("nan", "f/Hz,Z'/Ohm,Z''/Ohm\n"),
        ("", "f/Hz,Z'/Ohm,Z''/Ohm\n"),
    ] {
        let met = read("x.csv", &odd(what, head)).unwrap_or_else(|error| panic!("{what}: {error}"));
        assert_eq!(met.spectra[0].spectrum.points.len(), 20, "{what}");
        let line = 5 + usize::from(!head.is_empty());
        let is_noted = met
            .notes
            .iter()
            .any(|note| note.contains(&format!("line {line}")));
        assert!(is_noted, "{what}: {:?}", met.notes);
    }
    refused(
        "f,re,im\n10,0,0\n1,9.9E37,9.9E37\n",
        &["no point that was measured"],
    );
    // A log with impedances in some rows.
    let log =
        |k: usize, f: f64, z: Complex64| format!("{k},3.7,{f},{},{}\n{k}.5,3.7,,,", z.re, z.im);
    is_truth(
        "x.csv",
        &text(
            "time_s,voltage_v,Frequency_Hz,Z_Real_Ohm,Z_Imag_Ohm\n0,3.7,,,\n",
            log,
        ),
    );
}

#[test]
fn parts_are_held_against_modulus_and_phase() {
    let row = |im: f64, phase: f64, factor: f64| {
        move |_: usize, f: f64, z: Complex64| {
            format!(
                "{f},{},{},{},{}",
                z.re,
                im * z.im,
                factor * z.norm(),
                phase * z.arg().to_degrees()
            )
        }
    };
    let plain = "f/Hz,Z'/Ohm,Z''/Ohm,|Z|/Ohm,Phase/deg\n";
    is_truth("x.csv", &text(plain, row(1.0, 1.0, 1.0)));
    refused(
        &text(plain, row(-1.0, 1.0, 1.0)),
        &["\"Z''/Ohm\" and \"Phase/deg\" of opposite sign", "-Z''"],
    );
    refused(
        &text(plain, row(1.0, 1.0, 1e3)),
        &["\"|Z|/Ohm\" 1000 times"],
    );
    // The name that states a sign takes precedence.
    let signed = "freq / Hz,Z' / Ohm,Z'' / Ohm,Z / Ohm,neg. Phase / °\n";
    let met = is_truth("x.csv", &text(signed, row(-1.0, -1.0, 1.0)));
    assert!(
        met.notes.iter().any(|note| note.contains("taken as −Im Z")),
        "{:?}",
        met.notes
    );
    let minus = "f/Hz,Z'/Ohm,-Z''/Ohm,|Z|/Ohm,Phase/deg\n";
    is_truth("x.csv", &text(minus, row(-1.0, -1.0, 1.0)));
    is_truth("x.csv", &text(minus, row(-1.0, 1.0, 1.0)));
}

#[test]
fn every_channel_of_a_palmsens_session_is_read_whatever_the_case_of_its_keys() {
    let set = |ohm: f64| {
        let arrays = [
            ("Frequency", [100.0, 1.0]),
            ("ZRe", [ohm, ohm + 1.0]),
            ("ZIm", [0.1, 0.2]),
        ]
        .map(|(name, [a, b])| {
            format!(
                "{{\"Description\": \"{name}\", \"DataValues\": [{{\"V\": {a}}}, {{\"V\": {b}}}]}}"
            )
        });
        format!("{{\"Values\": [{}]}}", arrays.join(", "))
    };
    let channel = |n: f64| {
        let scan = |ohm: f64| format!("{{\"Title\": \"E={ohm} V\", \"DataSet\": {}}}", set(ohm));
        format!(
            "{{\"Title\": \"CH {n}: scan\", \"SubScans\": [{}, {}]}}",
            scan(n),
            scan(n + 10.0)
        )
    };
    let session = format!(
        "{{\"Type\": \"PalmSens.DataFiles.SessionFile\", \"Measurements\": [{{\"DataSet\": {}, \
         \"EISDataList\": [{}, {}, {}]}}]}}",
        set(3.0),
        channel(1.0),
        channel(2.0),
        channel(3.0)
    );
    for text in [session.clone(), session.to_lowercase()] {
        let read = read("x.pssession", &text).unwrap();
        let ohms: Vec<f64> = read
            .spectra
            .iter()
            .map(|one| one.spectrum.points[1].z_ohm.re)
            .collect();
        assert_eq!(ohms, [1.0, 11.0, 2.0, 12.0, 3.0, 13.0]);
    }
}

#[test]
fn points_that_are_no_measurement_are_left_out_of_the_projects_own_tables_too() {
    let odd = |k: usize, f: f64, z: Complex64| {
        let (re, im) = match k {
            3 => ("NaN".to_owned(), z.im.to_string()),
            5 => (z.re.to_string(), "OVERLOAD".to_owned()),
            8 => ("9.9E37".to_owned(), z.im.to_string()),
            11 => (z.re.to_string(), String::new()),
            13 => ("0".to_owned(), "0".to_owned()),
            _ => (z.re.to_string(), z.im.to_string()),
        };
        if k == 15 {
            ",,".to_owned()
        } else {
            format!("{f},{re},{im}")
        }
    };
    for (head, first) in [
        ("freq_hz,z_re_ohm,z_im_ohm\n", 5),
        ("", 4),
        ("f,re,im\n", 5),
    ] {
        let read = read("x.csv", &text(head, odd)).unwrap();
        let points = &read.spectra[0].spectrum.points;
        assert_eq!(points.len(), 15, "{head}");
        let right = points.iter().all(|point| {
            let mut all = truth().into_iter();
            all.any(|(f, z)| point.freq_hz == f && (point.z_ohm - z).norm() < 1e-15)
        });
        assert!(right, "{points:?}");
        let lines = [0, 2, 5, 8, 10].map(|k| (first + k).to_string()).join(", ");
        assert_eq!(
            read.notes,
            [format!(
                "x.csv: points without a measurement (an overload, 0 + 0j, or not a number) are left \
                 out: line {lines}"
            )]
        );
    }
    // Errors that points share remain assigned to their points.
    let shared = "freq_hz,z_re_ohm,z_im_ohm,shared_re_ohm[a],shared_im_ohm[a]\n\
        100,0.02,-0.001,1e-5,4e-5\n10,NaN,-0.002,2e-5,5e-5\n1,0.03,-0.003,3e-5,6e-5\n";
    let spectrum = &read("x.csv", shared).unwrap().spectra[0].spectrum;
    assert_eq!(spectrum.points.len(), 2);
    assert_eq!(
        spectrum.shared[0].at_ohm,
        [Complex64::new(3e-5, 6e-5), Complex64::new(1e-5, 4e-5)]
    );
    let thesis =
        "freq,offset,resistance,theta\n10,0,0.02,-0.1\n1,0,overload,-0.2\n0.1,0,0.03,nan\n";
    assert_eq!(
        read("x.csv", thesis).unwrap().spectra[0]
            .spectrum
            .points
            .len(),
        1
    );
    for (row, word) in [
        ("1,inf,0", "\"inf\""),
        ("NaN,0.02,0", "\"NaN\""),
        ("1,a,0", "\"a\""),
    ] {
        refused(
            &format!("freq_hz,z_re_ohm,z_im_ohm\n10,0.02,0\n{row}\n"),
            &["line 3", word],
        );
    }
}
