use super::*;
use num_complex::Complex64;
use proptest::prelude::*;

mod binary;
mod cases;
mod corpus;
mod kinds;
mod mat;
mod mutations;
mod native;
mod seen;
mod sweeps;

fn read(text: &str) -> Result<Vec<SourcedSpectrum>, FormatError> {
    parse(Path::new("dir/sweep.csv"), text.as_bytes())
}

fn names(spectra: &[SourcedSpectrum]) -> Vec<&str> {
    spectra.iter().map(|s| s.spectrum.name.as_str()).collect()
}

#[test]
fn the_projects_own_with_everything() {
    let text = "\u{feff}# bench 3\r\n\
    z_im_ohm,freq_hz,z_re_ohm,sigma_re_ohm,sigma_im_ohm,cov_re_im_ohm2,amplitude_a,note\r\n\r\n\
                -1e-3, 10 ,0.007,1e-5,2e-5,-1e-10,1.05,x\r\n\"-2e-3\",1,0.008,,nan,,,\r\n# end\r\n";
    let spectra = read(text).unwrap();
    assert_eq!(names(&spectra), ["sweep"]);
    assert!(spectra[0].origin.is_unbiased_cell());
    let [slow, fast] = spectra[0].spectrum.points.as_slice() else {
        panic!("two points")
    };
    assert_eq!(
        (slow.freq_hz, slow.z_ohm),
        (1.0, Complex64::new(0.008, -0.002))
    );
    assert!(slow.covariance.re_re.is_nan() && slow.amplitude_a.is_nan());
    assert_eq!(
        (fast.freq_hz, fast.z_ohm, fast.amplitude_a),
        (10.0, Complex64::new(0.007, -0.001), 1.05)
    );
    let c = fast.covariance;
    assert!(
        (c.re_re - 1e-10).abs() < 1e-24 && (c.im_im - 4e-10).abs() < 1e-24 && c.re_im == -1e-10
    );
}

#[test]
fn three_numbers_without_header() {
    let spectra = read("3.1e-03,4.9e-02,-2.0e-02\n3.9e-03,4.7e-02,-1.8e-02\n").unwrap();
    assert_eq!(spectra[0].spectrum.points.len(), 2);
    assert_eq!(
        spectra[0].spectrum.points[0].z_ohm,
        Complex64::new(0.049, -0.02)
    );
}

#[test]
fn a_file_of_impedance_py_is_read() {
    // Provenance beside the file; the numbers are its first and its last row.
    let path = Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../fixtures/data/spectra/vendors/impedance_py.csv"
    ));
    let points = read_spectra(path).unwrap().remove(0).points;
    let end = |point: &analysis_signal::spectrum::ImpedancePoint| (point.freq_hz, point.z_ohm);
    assert_eq!(
        (points.len(), end(&points[0])),
        (
            12,
            (
                0.0031623,
                Complex64::new(0.0494998977640506, -0.020438698544418925)
            )
        )
    );
    assert_eq!(points[11].freq_hz, 0.039811);
}

#[test]
fn columns_may_be_named_and_between_semicolons_a_comma_is_a_decimal_point() {
    let expected = vec![
        (1.0, Complex64::new(0.008, -0.002)),
        (10.0, Complex64::new(0.007, -0.001)),
    ];
    for text in [
        "f,re,im\n10,0.007,-1e-3\n1,0.008,-2e-3\n",
        "Frequency (Hz);Z' (Ohm);-Z'' (Ohm)\n10,0;0,007;1e-3\n1,0;0,008;2E-3\n",
        "freq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\n1,0000E+01\t7,0E-03\t1,0E-03\n1,0\t8,0E-03\t2,0E-03\n",
        "freq_hz;z_re_ohm;z_im_ohm\n10;0,007;-0,001\n1;0,008;-0,002\n",
        "10;0,007;-0,001\n1;0,008;-0,002\n",
        "10;0.007;-0.001\n1;0.008;-0.002\n",
    ] {
        let points = read(text)
            .unwrap_or_else(|error| panic!("{text}: {error}"))
            .remove(0)
            .spectrum
            .points;
        assert_eq!(
            points
                .iter()
                .map(|point| (point.freq_hz, point.z_ohm))
                .collect::<Vec<_>>(),
            expected,
            "{text}"
        );
    }
    let sigmas =
        read("freq_hz;z_re_ohm;z_im_ohm;sigma_re_ohm;sigma_im_ohm\n10;0,007;-0,001;1,5e-5;2e-5\n")
            .unwrap()
            .remove(0);
    assert!((sigmas.spectrum.points[0].covariance.re_re.sqrt() - 1.5e-5).abs() < 1.0e-18);
    let mark = "expected one decimal mark in all numbers, a comma or a point, met";
    for (text, message) in [
        (
            "freq_hz;z_re_ohm;z_im_ohm\n1,000;0.5;0\n",
            format!(", line 2: {mark} both in \"1,000;0.5;0\""),
        ),
        (
            "freq/Hz\tRe(Z)/Ohm\tIm(Z)/Ohm\n1,000\t0.5\t0\n",
            format!(", line 2, column 2 (number): {mark} \"0.5\""),
        ),
        (
            "1.00,5;2;3\n",
            ", line 1: expected three numbers".to_owned(),
        ),
        (
            "1;2;1.00,5\n",
            ", line 1, column 3 (Im Z): expected a finite number in Ω, met \"1.00,5\"".to_owned(),
        ),
    ] {
        let error = read(text).unwrap_err().to_string();
        assert!(
            error.starts_with(&format!("dir/sweep.csv{message}")),
            "{error}"
        );
    }
}

#[test]
fn the_first_line_of_another_program_may_say_one_thing_twice() {
    let spectra = read("Program,a,a\nf/Hz,Re(Z)/Ohm,Im(Z)/Ohm\n10,0.007,-1e-3\n").unwrap();
    assert_eq!(
        spectra[0].spectrum.points[0].z_ohm,
        Complex64::new(0.007, -1e-3)
    );
}

#[test]
fn the_thesis_writes_magnitude_and_phase() {
    let spectra =
        read("freq,offset,resistance,theta\n0.2,-2,0.01,0\n0.1,-2,0.02,-1.5707963267948966\n")
            .unwrap();
    assert_eq!(names(&spectra), ["sweep"]);
    assert_eq!(spectra[0].origin.bias_a, Some(-2.0));
    assert!(!spectra[0].origin.is_unbiased_cell());
    let points = &spectra[0].spectrum.points;
    assert!(
        (points[0].z_ohm - Complex64::new(0.0, -0.02)).norm() < 1e-17
            && points[1].z_ohm == Complex64::new(0.01, 0.0)
    );
    let two = read("freq,offset,resistance,theta\n0.1,0,0.01,0\n0.1,5,0.01,0\n").unwrap();
    assert_eq!(names(&two), ["sweep", "sweep_+5A"]);
}

#[test]
fn the_tidy_table_is_one_spectrum_per_key() {
    let text = "fixture,cell,repeat,bias_a,freq_hz,z_abs_ohm,z_phase_rad\n\
                cell,0,0,0,0.1,0.009,-0.1\ncell,0,1,-0,0.1,0.0091,-0.1\n\
                cell,1,0,0,0.1,0.0092,-0.1\ncell,0,0,0,0.2,0.0089,-0.1\n\
                cell,0,0,-2,0.1,0.0094,-0.1\ncell,,0,5,0.1,0.0094,-0.1\nshunt,0,0,0,0.1,0.01,0\n\
                fake_cell,,0,0,0.1,0.0037,0\n";
    let spectra = read(text).unwrap();
    assert_eq!(
        names(&spectra),
        [
            "cell0_0",
            "cell0_1",
            "cell1_0",
            "cell0_0_-2A",
            "cell_0_+5A",
            "shunt_0",
            "fake_cell_0"
        ]
    );
    assert_eq!(
        spectra[0].spectrum.points.len(),
        2,
        "rows of one key need not stand together"
    );
    let unbiased: Vec<bool> = spectra
        .iter()
        .map(|s| s.origin.is_unbiased_cell())
        .collect();
    assert_eq!(unbiased, [true, true, true, false, false, false, false]);
}

#[test]
fn errors_name_the_place_and_what_was_expected() {
    let known = "three numbers (frequency, Re, Im) or one of the \
    headers \"freq_hz,z_re_ohm,z_im_ohm[,…]\", \
                 \"freq,offset,resistance,theta\", \
                 \"fixture,cell,repeat,bias_a,freq_hz,z_abs_ohm,z_phase_rad\", \
                 a file of a potentiostat's program that docs/formats.md lists, \
                 or a table that names its columns (`f,re,im`, `Frequency/Hz`, `Zreal`, `|Z|/Ohm`, \
                 `Phase/deg`, …)";
    let header = "freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm,sigma_im_ohm,cov_re_im_ohm2\n";
    let cases: [(String, String); 16] = [
        (String::new(), ": expected at least one line with a frequency and an impedance, met an \
        empty file".into()),
        ("# nothing\n".into(), ": expected at least one line with a frequency and an impedance, \
        met only comments".into()),
        (header.into(), ": expected at least one line with a frequency and an impedance, met only \
        a header".into()),
        ("\n1 2\n".into(), format!(", line 2: expected {known}, met \"1 2\"; the nearest \
        reader is that of impedance.py's list, but line 2 has 2 numbers and not three, and no line \
        names them")),
        ("1,2\n".into(), format!(", line 1: expected {known}, met \"1,2\"; the nearest reader \
        is that of impedance.py's list, but line 1 has 2 numbers and not three, and no line names \
        them")),
        ("f,q,y\n".into(), format!(", line 1: expected {known}, met \"f,q,y\"")),
        ("1,2,3\n1,x,3\n".into(), ", line 2, column 2 (Re Z): expected a finite number in Ω, \
        met \"x\"".into()),
        ("1,2,3\n\nNaN,2,3\n".into(), ", line 3, column 1 (frequency): expected a positive finite \
        frequency in Hz, met \"NaN\"".into()),
        ("1,2,3\n\n2,inf,3\n".into(), ", line 3, column 2 (Re Z): expected a finite number in Ω, \
        met \"inf\"".into()),
        ("-1,2,3\n".into(), ", line 1, column 1 (frequency): expected a positive finite frequency \
        in Hz, met \"-1\"".into()),
        ("1,2,3\n1,2\n".into(), ", line 2, column 3: expected 3 fields, met 2".into()),
        ("1,2,3\n1,2,3,4\n".into(), ", line 2, column 4: expected 3 fields, met 4".into()),
        (
            format!("{header}1,2,3,-1,1,0\n"),
            ", line 2, column 4 (sigma_re_ohm): expected a standard uncertainty of zero or more in \
            Ω, or nothing, met \"-1\"".into(),
        ),
        (
            format!("{header}1,2,3,1,1,1.1\n"),
            ", line 2, column 6 (cov_re_im_ohm2): expected a covariance in Ω² no larger than the \
            product of the sigmas, or nothing, met \"1.1\""
                .into(),
        ),
        (
            "freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm\n1,2,3,4\n".into(),
            ", line 1: expected sigma_im_ohm beside sigma_re_ohm, met only sigma_re_ohm".into(),
        ),
        (
            "freq_hz,z_re_ohm,z_im_ohm,Freq_Hz\n1,2,3,4\n".into(),
            ", line 1: expected every column's name once, met \"Freq_Hz\" in columns 1 and 4".into(),
        ),
    ];
    for (text, message) in cases {
        assert_eq!(
            read(&text).unwrap_err().to_string(),
            format!("dir/sweep.csv{message}"),
            "{text:?}"
        );
    }
    // A text must not be refused because of its code page.
    let odd = parse(Path::new("a.csv"), b"a\n\xff\xfe").unwrap_err();
    assert!(
        odd.to_string()
            .starts_with("a.csv, line 1: expected three numbers"),
        "{odd}"
    );
    let missing = read_spectra(Path::new("no/such.csv")).unwrap_err();
    assert!(
        missing
            .to_string()
            .starts_with("no/such.csv: expected a readable file of impedance spectra: "),
        "{missing}"
    );
}

#[test]
fn files_are_read_by_path() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bench7.csv");
    std::fs::write(
        &path,
        "fixture,cell,repeat,bias_a,freq_hz,z_abs_ohm,z_phase_rad\n\
    cell,2,4,0,0.1,0.009,0\nshunt,0,0,0,0.1,0.01,0\n",
    )
    .unwrap();
    assert_eq!(read_spectra(&path).unwrap().len(), 2);
    let cells = read_unbiased_cells(&path).unwrap();
    assert_eq!(
        cells.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(),
        ["cell2_4"]
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn what_is_written_is_read_back(
        points in prop::collection::vec((1e-6..1e7f64, -10.0..10.0f64, -10.0..10.0f64), 1..30),
    ) {
        let text: String = points
            .iter()
            .map(|(f, re, im)| format!("{f},{re},{im}\n"))
            .collect();
        let spectra = read(&text).unwrap();
        let mut sorted = points;
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Random frequencies may look like those of two sweeps.
        let mut met: Vec<_> = spectra
            .iter()
            .flat_map(|s| &s.spectrum.points)
            .map(|p| (p.freq_hz, p.z_ohm.re, p.z_ohm.im))
            .collect();
        met.sort_by(|a, b| a.0.total_cmp(&b.0));
        prop_assert_eq!(met, sorted);
    }

    #[test]
    fn no_bytes_make_it_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..200),
        soup in "(freq_hz|z_re_ohm|z_im_ohm|sigma_re_ohm|freq|offset|resistance|theta|fixture|cell\
                 |,|\"|\n|#|1e3|-|nan|inf|é){0,40}",
    ) {
        let _ = parse(Path::new("x"), &bytes);
        let _ = parse(Path::new("x"), soup.as_bytes());
    }
}
