//! Tables that were read wrongly, reduced.

use super::{Complex64, names, parse};
use analysis_signal::spectrum::SourcedSpectrum;
use std::path::Path;

fn read(name: &str, text: &str) -> Result<Vec<SourcedSpectrum>, String> {
    parse(Path::new(name), text.as_bytes()).map_err(|error| error.to_string())
}

fn points(name: &str, text: &str) -> Vec<(f64, Complex64)> {
    let spectra = read(name, text).unwrap_or_else(|error| panic!("{text}: {error}"));
    let [one] = spectra.as_slice() else {
        panic!("{text}: {:?}", names(&spectra))
    };
    one.spectrum
        .points
        .iter()
        .map(|p| (p.freq_hz, p.z_ohm))
        .collect()
}

fn near(met: &[(f64, Complex64)], expected: &[(f64, f64, f64)]) -> bool {
    let close = |(a, b): (&(f64, Complex64), &(f64, f64, f64))| {
        (a.0 / b.0 - 1.0).abs() < 1.0e-12
            && (a.1 - Complex64::new(b.1, b.2)).norm() <= 1.0e-12 * a.1.norm()
    };
    met.len() == expected.len() && met.iter().zip(expected).all(close)
}

#[test]
fn the_separator_never_changes_between_header_and_data() {
    let parstat = "Potential (V)\tElapsed Time (s)\tFrequency (Hz)\tZre (ohms)\tZim (ohms)\t|Vac| \
    (V)\t\n\
                   3.5\t10\t0\t0\t0\t0\t\n3.5\t20\t100\t0.030\t-0.004\t0.0049\t\n\
                   3.5\t30\t10\t0.031\t-0.006\t0.0048\t\n";
    assert!(near(
        &points("parstat.txt", parstat),
        &[(10.0, 0.031, -0.006), (100.0, 0.030, -0.004)]
    ));
    let spaced = "Frequency / Hz\tRe(Z) / mOhm\t-Im(Z) / mOhm\n100\t30\t4\n10\t31\t6\n";
    assert!(near(
        &points("spaced.txt", spaced),
        &[(10.0, 0.031, -0.006), (100.0, 0.030, -0.004)]
    ));
    let blanks = "Freq (Hz) Zre (mOhm) -Zim (mOhm)\n100 30 4\n10 31 6\n";
    assert!(near(
        &points("blanks.txt", blanks),
        &[(10.0, 0.031, -0.006), (100.0, 0.030, -0.004)]
    ));
    let unknown = read(
        "x.txt",
        "Frequency (Hz)\tZre (quatloos)\tZim (quatloos)\n100\t30\t4\n",
    )
    .unwrap_err();
    assert!(
        unknown.contains("line 1, column 2 (Zre (quatloos))")
            && unknown.contains("met \"quatloos\""),
        "{unknown}"
    );
    // Names separated by blanks, numbers by another separator: the columns cannot be assigned.
    for text in [
        "f re im\n1,2,3\n",
        "f,re,im\n1;2;3\n",
        "f\tre\tim\n1 2 3\n",
        "f;re;im\n1\t2\t3\n",
        "f re im\n1, 2, 3\n",
    ] {
        let refused = read("x.txt", text);
        assert!(refused.is_err(), "{text}: {refused:?}");
    }
}

#[test]
fn units_are_read() {
    let expected = [(1.0e3, 0.030, -0.004), (1.0e5, 0.029, -0.001)];
    for text in [
        "Frequency/kHz\tZ'/mΩ\tZ''/mΩ\n1\t30\t-4\n100\t29\t-1\n",
        "Frequency (MHz);Zre [kOhm];-Zim [kOhm]\n1e-3;30e-6;4e-6\n0.1;29e-6;1e-6\n",
        "f (mHz),Z' (µΩ),Z\" (µΩ)\n1e6,30000,-4000\n1e8,29000,-1000\n",
        "freq_khz,z_re_mohm,z_im_mohm\n1,30,-4\n100,29,-1\n",
        "f/Hz\tRe(Z)\t−Z″\n\tmOhm\tmOhm\n1000\t30\t4\n100000\t29\t1\n",
        "Freq\tZreal\tZimag\nkHz\tmohm\tmohm\n1\t30\t-4\n100\t29\t-1\n",
    ] {
        let met = points("x.txt", text);
        assert!(near(&met, &expected), "{text}: {met:?}");
    }
    let quarter = [(1.0, 0.0, -2.0), (10.0, 4.0, 0.0)];
    for text in [
        "f/Hz,|Z|/Ohm,Phase/deg\n1,2,-90\n10,4,0\n",
        "f/Hz,|Z|/mOhm,Phase (rad)\n1,2000,-1.5707963267948966\n10,4000,0\n",
        "f/Hz,|Z|/Ohm,-Phase [°]\n1,2,90\n10,4,0\n",
        "frequency,|Z|,-phase\n1,2,90\n10,4,0\n",
        "f/Hz,|Z|,theta\nHz,Ohm,mrad\n1,2,-1570.7963267948966\n10,4,0\n",
    ] {
        let met = points("x.txt", text);
        assert!(
            met.iter()
                .zip(&quarter)
                .all(|(m, q)| (m.1 - Complex64::new(q.1, q.2)).norm() < 1e-12),
            "{text}: {met:?}"
        );
    }
    // Code pages of one byte: degrees, ohms of others' programs.
    let latin = [
        b"f (Hz)\t|Z| (Ohm)\tPhase (".as_slice(),
        &[0xB0],
        b")\n1\t2\t-90\n",
    ]
    .concat();
    let z = parse(Path::new("x.txt"), &latin).unwrap()[0]
        .spectrum
        .points[0]
        .z_ohm;
    assert!((z - Complex64::new(0.0, -2.0)).norm() < 1e-12);
}

#[test]
fn units_that_cannot_be_are_refused_with_their_column() {
    for (text, message) in [
        (
            "f/Hz,Z'/Ohm·cm²,Z''/Ohm·cm²\n1,2,3\n",
            "column 2 (Z'/Ohm·cm²): expected an impedance in Ω, met \"Ohm.cm2\": it is normalised \
            to an area",
        ),
        (
            "f/Hz,Re(Z) (Ohm cm2),Im(Z) (Ohm cm2)\n1,2,3\n",
            "normalised to an area",
        ),
        (
            "Freq,Zreal,Zimag\nHz,ohm.cm^2,ohm.cm^2\n1,2,3\n",
            "line 2, column 2 (Zreal)",
        ),
        ("f (mhz),Z',Z''\n1,2,3\n", "milli or mega"),
        (
            "f/Hz,|Z|/Ohm,Phase\n1,2,-1.5\n2,2,-1\n",
            "column 3 (Phase): expected an angle in deg or rad, met no unit",
        ),
        (
            "f/Hz,Z'/Ohm,Zre/Ohm,Z''/Ohm\n1,2,3,4\n",
            "expected one column",
        ),
    ] {
        let refused = read("x.txt", text).unwrap_err();
        assert!(refused.contains(message), "{text}: {refused}");
    }
}

#[test]
fn ragged_rows_are_refused_with_their_line() {
    let gamry = "EXPLAIN\nTAG\tEISPOT\n\
    ZCURVE\tTABLE\n\tPt\tTime\tFreq\tZreal\tZimag\tZsig\n\t#\ts\tHz\tohm\tohm\tV\n\
                 \t0\t1\t100\t30\t-4\t1\n\t1\t2\t10\t31\t-5\t1\n";
    assert_eq!(points("x.DTA", gamry).len(), 2);
    for (row, line, met) in [
        ("\t2\t3\t1\t32\t-6", 8, 6),
        ("\t2\t3\t1", 8, 4),
        ("\t2", 8, 2),
        ("\t2\t3\t4\t1\t32\t-6\t1", 8, 8),
    ] {
        let refused = read("x.DTA", &format!("{gamry}{row}\n")).unwrap_err();
        assert!(
            refused.contains(&format!("line {line}, column"))
                && refused.contains(&format!("expected 7 fields, met {met}")),
            "{refused}"
        );
    }
    // A row with empty fields is not ragged.
    let trailing = "f\tre\tim\tnote\t\n1\t2\t3\t\t\n4\t5\t6\t\n";
    assert_eq!(points("x.txt", trailing).len(), 2);
}

#[test]
fn real_and_imaginary_part_are_taken_before_a_phase_of_few_digits() {
    let text = "A.C. Impedance\nInstrument Model:  CHI660E\n\n\
    Freq/Hz, Z'/ohm, Z\"/ohm, Z/ohm, Phase/deg\n\n\
                9.961e+4, 9.891e+1, -2.748e+0, 9.894e+1, -1.6\n\
                8.252e+4, 9.912e+1, 1.603e+0, 9.913e+1, 0.9\n";
    assert!(near(
        &points("chi.txt", text),
        &[(8.252e4, 99.12, 1.603), (9.961e4, 98.91, -2.748)]
    ));
}

#[test]
fn both_curves_of_a_drift_corrected_file_are_read() {
    let text = "EXPLAIN\nDRIFTCOR\tTOGGLE\tT\n\
    ZCURVE\tTABLE\n\tPt\tFreq\tZreal\tZimag\tZrealDrCor\tZimagDrCor\n\t#\tHz\tohm\tohm\tohm\tohm\n\
                \t0\t100\t30\t-4\t29\t-3\n\t1\t10\t31\t-5\t28\t-2\n";
    let spectra = read("dir/x.dta", text).unwrap();
    assert_eq!(
        names(&spectra),
        ["x.dta#drift-corrected", "x.dta#uncorrected"]
    );
    let first = |k: usize| spectra[k].spectrum.points[0].z_ohm;
    assert_eq!(
        (first(0), first(1)),
        (Complex64::new(28.0, -2.0), Complex64::new(31.0, -5.0))
    );
}

#[test]
fn a_corrected_curve_in_other_words_is_read_beside_the_other() {
    for [re, im] in [
        ["Z' (drift corrected)/Ohm", "Z'' (drift corrected)/Ohm"],
        ["Z' corrected/Ohm", "Z'' corrected/Ohm"],
        ["Zre_corr (Ohm)", "Zim_corr (Ohm)"],
    ] {
        let text = format!("Freq/Hz,Z'/Ohm,Z''/Ohm,{re},{im}\n100,30,-4,29,-3\n10,31,-5,28,-2\n");
        let spectra = read("x.csv", &text).unwrap();
        assert_eq!(
            names(&spectra),
            ["x.csv#drift-corrected", "x.csv#uncorrected"],
            "{re}"
        );
        assert_eq!(
            spectra[0].spectrum.points[0].z_ohm,
            Complex64::new(28.0, -2.0),
            "{re}"
        );
    }
}

#[test]
fn tables_in_one_file_are_spectra_of_their_own() {
    let table = |name: &str, z: f64| {
        format!(
            "{name}\tTABLE\t2\n\tPt\tFreq\tZreal\tZimag\n\t#\tHz\tohm\tohm\n\t0\t100\t{z}\t-4\n\t1\t10\t31\t-5\n"
        )
    };
    let text = format!(
        "EXPLAIN\nTAG\tEISPOT\n\
        {}{}OCVCURVE\tTABLE\t1\n\tPt\tT\tVf\tVm\n\t#\ts\tV\tV\n\t0\t1\t2\t3\n",
        table("ZCURVE", 30.0),
        table("ZCURVE.1", 40.0)
    );
    let spectra = read("x.dta", &text).unwrap();
    assert_eq!(names(&spectra), ["x.dta#ZCURVE", "x.dta#ZCURVE.1"]);
    assert_eq!(
        spectra[1].spectrum.points[1].z_ohm,
        Complex64::new(40.0, -4.0)
    );
}

#[test]
fn files_of_other_kinds_are_recognised_by_their_kind() {
    for (name, bytes, message) in [
        (
            "a.mpr",
            b"BIO-LOGIC MODULAR FILE\x1a    \x00\xff".as_slice(),
            "an EC-Lab .mpr",
        ),
        (
            "renamed.csv",
            b"BIO-LOGIC MODULAR FILE\x1a    \x00\xff",
            "an EC-Lab .mpr",
        ),
        ("a.ism", b"\x00\x01\x02\xff", "a Zahner .ism"),
        (
            "a.xlsx",
            b"PK\x03\x04\x14\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\x0f\0\0\0xl/workbook.xml\xff",
            "an Excel workbook",
        ),
        // Packed bytes may hold anything.
        (
            "a.zip",
            b"PK\x03\x04\x14\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\x05\0\0\0a.csv \xff xl/ .ndc",
            "a ZIP archive; unpack it",
        ),
        ("a.tdms", b"TDSm\x0e\0\0\0", "LabVIEW's TDMS; export its channels as CSV"),
        ("a.npy", b"\x93NUMPY\x01\0", "numpy.savetxt"),
        (
            "a.ods",
            b"PK\x03\x04\x14\x00\x00\x00mimetypeapplication/vnd.oasis.opendocument.spreadsheet\xff",
            "an OpenDocument spreadsheet",
        ),
        ("a.zip", b"PK\x03\x04\x14\x00\xff", "a ZIP archive"),
        (
            "a.xls",
            b"\xD0\xCF\x11\xE0\xA1\xB1\x1A\xE1\x00",
            "an old Excel workbook",
        ),
        ("a.dta", b"EXPLAIN\x00\x01\x02\xff\xfe", "a binary file"),
        ("a.parquet", b"PAR1\n\xff\xfe", "Parquet"),
        (
            "a.mat",
            b"MATLAB 5.0 MAT-file, Platform: GLNXA64\x00\xff",
            "a MATLAB .mat",
        ),
        ("a.h5", b"\x89HDF\r\n\x1a\n\x00", "HDF5; export its table as CSV or Parquet"),
        ("a.pdf", b"%PDF-1.7\n\xff", "a PDF"),
        ("a.png", b"\x89PNG\r\n\x1a\n\x00", "a picture"),
        ("a.jpg", b"\xFF\xD8\xFF\xE0\x00", "a picture"),
        ("a.csv.gz", b"\x1f\x8b\x08\x00", "gzip"),
        (
            "a.res",
            b"\x00\x01\x00\x00Standard Jet DB\x00",
            "an Arbin .res",
        ),
        ("a.json", b"{\n \"f (Hz)\": {\"0\": 1}}\n", "JSON"),
        // Its texts may name columns.
        (
            "b.json",
            b"{\"rows\": [\"freq/Hz\", \"Re(Z)\", \"-Im(Z)\", \"Re(Z)\"]}\n",
            "JSON",
        ),
        ("a.isfx", b"<?xml version=\"1.0\"?>\n<f,re,im>\n", "XML"),
        (
            "a.mps",
            b"BT-LAB SETTING FILE\r\n\r\nlim1_type  Time  Ecell  I\r\n",
            "settings of EC-Lab (.mps), which hold no data; take the .mpr or .mpt",
        ),
        (
            "a.fods",
            b"<?xml version=\"1.0\"?>\n<office:document>\n",
            "an OpenDocument spreadsheet",
        ),
    ] {
        let refused = parse(Path::new(name), bytes).unwrap_err().to_string();
        assert!(
            refused.starts_with(name) && refused.contains(message),
            "{name}: {refused}"
        );
        assert!(
            !refused.contains('\n') && refused.len() < 260,
            "{name}: {refused}"
        );
    }
}

#[test]
fn a_table_without_a_frequency_or_a_part_is_reported_as_such() {
    for (text, message) in [
        (
            "EC-Lab ASCII FILE\nNb header lines : 3\nRe(Z)/Ohm\t-Im(Z)/Ohm\n1\t2\n",
            "line 3: expected a column of the frequency",
        ),
        (
            "Freq (Hz)\tZreal (Ohm)\n1\t2\n",
            "line 1: expected a column of the imaginary part",
        ),
        (
            "Freq (Hz)\t|Z| (Ohm)\n1\t2\n",
            "line 1: expected a column of the phase",
        ),
    ] {
        let refused = read("x.mpt", text).unwrap_err();
        assert!(refused.contains(message), "{text}: {refused}");
    }
}

#[test]
fn a_refused_text_names_the_reader_that_came_nearest() {
    let refusal = |text: &str| {
        parse(Path::new("x.txt"), text.as_bytes())
            .unwrap_err()
            .to_string()
    };
    let cases = [
        (
            "EXPLAIN\nTAG\tCV\nCURVE1\tTABLE\t2\n\tPt\tT\tVf\tIm\n\t#\ts\tV\tA\n\t0\t0.1\t3.7\t0.1\n",
            "nearest reader is that of Gamry's .DTA, which needs a table ZCURVE with Freq, Zreal and \
             Zimag; its tables are \"CURVE1\"",
        ),
        (
            "EC-Lab ASCII FILE\nNb header lines : 3\ntime/s\tEwe/V\tcontrol/V\n0\t3.7\t1\n",
            "that of EC-Lab's .mpt, which needs the columns freq/Hz, Re(Z)/Ohm and -Im(Z)/Ohm; line 3 \
             names \"time/s\tEwe/V\tcontrol/V\"",
        ),
        (
            "f/Hz,admittance/S,note\n1000,0.01,7\n",
            "that of tables with named columns, but line 1 names the frequency alone",
        ),
        (
            "Test Time / s,Voltage / V,Current / A\n0,3.7,1.0\n1,3.6,1.0\n",
            "that of time series, for line 1 names a time, a voltage and a current",
        ),
        (
            "1000,0.01,-0.001,0.01\n100,0.02,-0.002,0.02\n",
            "that of impedance.py's list, but line 1 has 4 numbers and not three",
        ),
    ];
    for (text, expected) in cases {
        let met = refusal(text);
        assert!(met.contains(expected), "{met}");
    }
    assert!(!refusal("a letter\nof some lines\n").contains("nearest"));
}
