//! Writes spectra as files for other programs.

use std::fmt::Write as _;

use analysis_signal::spectrum::Spectrum;

/// Formats that a spectrum can be written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SpectrumFormat {
    /// impedance.py's: frequency, real and imaginary part, without a header. Known standard
    /// deviations and covariances follow, named in a comment.
    ImpedancePy,
    /// Gamry's `.DTA`.
    Gamry,
    /// BioLogic EC-Lab's `.mpt`.
    BioLogic,
    /// ZPlot's and ZView's `.z`.
    ZView,
}

impl SpectrumFormat {
    /// Returns the extension of its files, with the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::ImpedancePy => ".csv",
            Self::Gamry => ".DTA",
            Self::BioLogic => ".mpt",
            Self::ZView => ".z",
        }
    }
}

/// Returns the text of a file with one spectrum, by falling frequency as those programs expect.
/// Numbers round-trip exactly. Only the format of impedance.py contains uncertainties, because that
/// program reads three columns and skips comments and further columns.
pub fn spectrum_text(spectrum: &Spectrum, format: SpectrumFormat) -> String {
    let mut text = head(spectrum, format);
    let mut points: Vec<_> = spectrum.points.iter().collect();
    points.sort_by(|a, b| b.freq_hz.total_cmp(&a.freq_hz));
    for (number, point) in points.into_iter().enumerate() {
        let (f, re, im) = (point.freq_hz, point.z_ohm.re, point.z_ohm.im);
        let (modulus, degrees) = (point.z_ohm.norm(), point.z_ohm.arg().to_degrees());
        // Writing to a string cannot fail.
        let _ = match format {
            SpectrumFormat::ImpedancePy => {
                let covariance = point.covariance;
                let known = if has_sigma(spectrum) {
                    let (sigma_re, sigma_im) = (covariance.re_re.sqrt(), covariance.im_im.sqrt());
                    format!(",{sigma_re:?},{sigma_im:?},{:?}", covariance.re_im)
                } else {
                    String::new()
                };
                writeln!(text, "{f:?},{re:?},{im:?}{known}")
            }
            SpectrumFormat::Gamry => writeln!(
                text,
                "\t{number}\t{number}\t{f:?}\t{re:?}\t{im:?}\t0\t{modulus:?}\t{degrees:?}\t0\t0\t0"
            ),
            SpectrumFormat::BioLogic => {
                writeln!(
                    text,
                    "{f:?}\t{re:?}\t{:?}\t{modulus:?}\t{degrees:?}\t0",
                    -im
                )
            }
            SpectrumFormat::ZView => writeln!(text, "{f:?}\t0\t0\t0\t{re:?}\t{im:?}\t0\t0\t0"),
        };
    }
    // As written by EC-Lab; galvani requires it.
    if format == SpectrumFormat::BioLogic {
        text = text.replace('\n', "\r\n");
    }
    text
}

/// Names of the columns of a file of impedance.py with uncertainties, after the comment mark.
pub(super) const WITH_SIGMA: &str =
    "freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm,sigma_im_ohm,cov_re_im_ohm2";

impl SpectrumFormat {
    /// Returns whether the format can store the uncertainties of points.
    pub fn keeps_sigma(self) -> bool {
        matches!(self, Self::ImpedancePy)
    }
}

/// Returns whether the uncertainties of all points are known.
fn has_sigma(spectrum: &Spectrum) -> bool {
    spectrum.points.iter().all(|point| {
        let covariance = point.covariance;
        covariance.re_re.is_finite() && covariance.im_im.is_finite() && covariance.re_im.is_finite()
    })
}

fn head(spectrum: &Spectrum, format: SpectrumFormat) -> String {
    let (name, count) = (
        spectrum.name.replace(['\t', '\n', '\r'], " "),
        spectrum.points.len(),
    );
    match format {
        SpectrumFormat::ImpedancePy if has_sigma(spectrum) => format!("# {WITH_SIGMA}\n"),
        SpectrumFormat::ImpedancePy => String::new(),
        SpectrumFormat::Gamry => format!(
            "EXPLAIN\nTAG\tEISPOT\nTITLE\tLABEL\t{name}\tTest &Identifier\nZCURVE\tTABLE\t{count}\n\
             \tPt\tTime\tFreq\tZreal\tZimag\tZsig\tZmod\tZphz\tIdc\tVdc\tIERange\n\
             \t#\ts\tHz\tohm\tohm\tV\tohm\tdeg\tA\tV\t#\n"
        ),
        // The head has only these lines, so that yadg treats the file as one without settings. yadg
        // requires times, which a spectrum does not have. A tab follows the last name, as in EC-Lab's
        // files.
        SpectrumFormat::BioLogic => "EC-Lab ASCII FILE\nNb header lines : 3\n\
            freq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\t|Z|/Ohm\tPhase(Z)/deg\ttime/s\t\n"
            .to_owned(),
        SpectrumFormat::ZView => format!(
            "ZPLOT2 ASCII\n  Title: {name}\n  Data Points:                {count}\n  \
            Freq(Hz)\tAmpl\tBias\tTime(Sec)\tZ'(a)\tZ''(b)\tGD\tErr\tRange\nEnd Comments\n"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::read_spectra;
    use analysis_numeric::Covariance2;
    use analysis_signal::spectrum::ImpedancePoint;
    use num_complex::Complex64;
    use proptest::prelude::*;

    #[test]
    fn uncertainties_come_back_from_a_file_of_impedance_py() {
        let point = |freq_hz: f64| ImpedancePoint {
            freq_hz,
            z_ohm: Complex64::new(0.01 / 3.0, -0.001),
            covariance: Covariance2 {
                re_re: 4.0e-10,
                im_im: 9.0e-10,
                re_im: -1.0e-10,
            },
            amplitude_a: f64::NAN,
        };
        let mut spectrum = Spectrum {
            name: "a cell".to_owned(),
            points: vec![point(0.1), point(100.0)],
            ..Spectrum::default()
        };
        let text = spectrum_text(&spectrum, SpectrumFormat::ImpedancePy);
        assert!(
            text.lines()
                .skip(1)
                .all(|line| line.split(',').count() == 6)
        );
        let back = crate::formats::parse(std::path::Path::new("a.csv"), text.as_bytes()).unwrap();
        for (back, put) in back[0].spectrum.points.iter().zip(&spectrum.points) {
            assert_eq!((back.freq_hz, back.z_ohm), (put.freq_hz, put.z_ohm));
            assert!((back.covariance.re_re / put.covariance.re_re - 1.0).abs() < 1e-15);
            assert!((back.covariance.im_im / put.covariance.im_im - 1.0).abs() < 1e-15);
            assert_eq!(back.covariance.re_im, put.covariance.re_im);
        }
        spectrum.points[1].covariance = Covariance2::UNKNOWN;
        let text = spectrum_text(&spectrum, SpectrumFormat::ImpedancePy);
        assert!(text.lines().all(|line| line.split(',').count() == 3));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn every_format_comes_back_to_the_last_bit(
            rows in prop::collection::vec((1.0e-4..1.0e6_f64, -10.0..10.0_f64, -10.0..10.0_f64), 1..20),
        ) {
            let mut rows = rows;
            rows.sort_by(|a, b| a.0.total_cmp(&b.0));
            rows.dedup_by(|a, b| a.0 == b.0);
            let point = |(freq_hz, re, im): &(f64, f64, f64)| ImpedancePoint {
                freq_hz: *freq_hz,
                z_ohm: Complex64::new(*re, *im),
                covariance: Covariance2::UNKNOWN,
                amplitude_a: f64::NAN,
            };
            let spectrum = Spectrum {
                name: "a cell".to_owned(),
                points: rows.iter().map(point).collect(),
                ..Spectrum::default()
            };
            let folder = tempfile::tempdir().unwrap();
            for format in [
                SpectrumFormat::ImpedancePy,
                SpectrumFormat::Gamry,
                SpectrumFormat::BioLogic,
                SpectrumFormat::ZView,
            ] {
                // The reader uses the content, not the extension.
                let path = folder.path().join("spectrum.dat");
                std::fs::write(&path, spectrum_text(&spectrum, format)).unwrap();
                let back = read_spectra(&path).unwrap().remove(0).points;
                let numbers = |points: &[ImpedancePoint]| {
                    points
                        .iter()
                        .map(|p| (p.freq_hz, p.z_ohm))
                        .collect::<Vec<_>>()
                };
                prop_assert_eq!(numbers(&back), numbers(&spectrum.points), "{:?}", format);
            }
        }
    }
}
