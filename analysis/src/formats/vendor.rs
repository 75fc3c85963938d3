//! Spectra in the text files of potentiostats: a head of any kind, a row that names the columns, and rows of numbers.
//!
//! | program | told by | columns |
//! |---|---|---|
//! | Gamry `.DTA` | `EXPLAIN`, `ZCURVE` | `Freq`, `Zreal`, `Zimag` |
//! | BioLogic EC-Lab `.mpt` | `EC-Lab ASCII FILE` | `freq/Hz`, `Re(Z)/Ohm`, `-Im(Z)/Ohm` |
//! | ZPlot and ZView `.z` | `ZPLOT2 ASCII` | `Freq(Hz)`, `Z'(a)`, `Z''(b)` |
//! | ZView's export of others (Autolab) | `Z60W Data File` | `Freq (Hz)`, `Z'(a)`, `Z''(b)` |
//! | Zahner's and Autolab's lists, any other table | such a row | a frequency, and real and imaginary part or modulus and phase |
//!
//! Where fields are not separated by commas, a comma in a number is a decimal point, and all numbers that are read have the same mark.
//!
//! A minus before the name of the imaginary part is taken for what it says. A row of units under the names is passed over, and so are blank lines; the
//! table ends with a line of text behind which no row follows: one in the midst of the rows is refused. Rows at 0 Hz, by which EC-Lab marks direct
//! current, are left out. What follows a mark of an aborted measurement is not read.

use super::error::FormatError;
use super::text::{self, shorten};
use super::{Origin, SourcedSpectrum};
use crate::spectrum::{Covariance2, ImpedancePoint, Spectrum};
use num_complex::Complex64;
use std::path::Path;

/// Lines between names and numbers, at most.
const UNITS: usize = 3;
/// By which Gamry marks a measurement that was aborted.
const ABORTED: &str = "EXPERIMENTABORTED";

/// How an impedance is written.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Parts {
    /// Columns of real and imaginary part, and the sign of the latter.
    Cartesian(usize, usize, f64),
    /// Columns of modulus and phase, and what makes radians of the latter.
    Polar(usize, usize, f64),
}

/// The columns of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Columns {
    separator: char,
    freq: usize,
    parts: Parts,
    /// Of a spectrum repeated in one file.
    cycle: Option<usize>,
}

impl Columns {
    /// The columns that are read.
    fn read(&self) -> [usize; 3] {
        let (Parts::Cartesian(a, b, _) | Parts::Polar(a, b, _)) = self.parts;
        [self.freq, a, b]
    }
}

/// Reads the spectra of a file; nothing where no row names columns of an impedance.
///
/// # Errors
/// [`FormatError`] for a table without rows, or with numbers that cannot be a measurement.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Option<Result<Vec<SourcedSpectrum>, FormatError>> {
    // Degrees and square centimetres come in any code page; what is read is ASCII.
    let text = String::from_utf8_lossy(bytes);
    let lines: Vec<&str> = text.lines().collect();
    let (at, columns) = lines.iter().enumerate().find_map(|(at, line)| Some((at, columns(line)?)))?;
    Some(read(path, &lines, at, &columns))
}

fn read(path: &Path, lines: &[&str], header: usize, columns: &Columns) -> Result<Vec<SourcedSpectrum>, FormatError> {
    let mut groups: Vec<(Option<String>, Vec<ImpedancePoint>)> = Vec::new();
    let (mut rows, mut mark) = (0, None);
    for (at, line) in lines.iter().enumerate().skip(header + 1) {
        let fields = fields(line, columns.separator);
        let number = |column: usize| fields.get(column).and_then(|field| text::number(field, columns.separator));
        let wrong = |column: usize, name, expected| FormatError::Field {
            file: path.to_owned(),
            line: at + 1,
            column: column + 1,
            name,
            expected,
            met: fields.get(column).map_or_else(|| "the end of the line".to_owned(), |field| shorten(field).trim_matches('"').to_owned()),
        };
        let Some(freq_hz) = number(columns.freq) else {
            let expected = "a frequency in Hz, or no further rows behind the end of the table";
            match told(line, columns) {
                Told::Nothing => continue,
                // A frequency that is none, before numbers.
                Told::Row => return Err(wrong(columns.freq, "frequency", "a positive finite frequency in Hz")),
                Told::Text if rows == 0 && at <= header + UNITS => continue,
                Told::Aborted => break,
                Told::Text if goes_on(&lines[at + 1..], columns) => return Err(wrong(columns.freq, "frequency", expected)),
                Told::Text => break,
            }
        };
        rows += 1;
        if freq_hz == 0.0 {
            continue;
        }
        for column in columns.read() {
            let Some(found) = fields.get(column).and_then(|field| text::mark(field, columns.separator)) else { continue };
            if *mark.get_or_insert(found) != found {
                return Err(wrong(column, "number", "one decimal mark in all numbers, a comma or a point"));
            }
        }
        if !(freq_hz > 0.0 && freq_hz.is_finite()) {
            return Err(wrong(columns.freq, "frequency", "a positive finite frequency in Hz"));
        }
        let finite =
            |column: usize, name, expected| number(column).filter(|value| value.is_finite()).ok_or_else(|| wrong(column, name, expected));
        let z_ohm = match columns.parts {
            Parts::Cartesian(re, im, sign) => {
                Complex64::new(finite(re, "Re Z", "a finite number in Ω")?, sign * finite(im, "Im Z", "a finite number in Ω")?)
            }
            Parts::Polar(modulus, phase, to_rad) => Complex64::from_polar(
                finite(modulus, "|Z|", "a finite magnitude of zero or more in Ω")?.max(0.0),
                to_rad * finite(phase, "phase", "a finite angle")?,
            ),
        };
        let point = ImpedancePoint { freq_hz, z_ohm, covariance: Covariance2::UNKNOWN, amplitude_a: f64::NAN };
        let cycle = columns.cycle.and_then(number).map(|cycle| cycle.to_string());
        match groups.iter_mut().find(|(known, _)| *known == cycle) {
            Some((_, points)) => points.push(point),
            None => groups.push((cycle, vec![point])),
        }
    }
    if groups.is_empty() {
        return Err(FormatError::Empty { file: path.to_owned(), met: "the names of columns and no row of numbers" });
    }
    let stem = path.file_stem().map_or_else(|| "spectrum".to_owned(), |stem| stem.to_string_lossy().into_owned());
    let several = groups.len() > 1;
    let finish = |(cycle, mut points): (Option<String>, Vec<ImpedancePoint>)| {
        points.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
        let name = if several { format!("{stem}_{}", cycle.as_deref().unwrap_or("")) } else { stem.clone() };
        SourcedSpectrum {
            origin: Origin { repeat: cycle.filter(|_| several), ..Origin::default() },
            spectrum: Spectrum { name, points, ..Spectrum::default() },
        }
    };
    Ok(groups.into_iter().map(finish).collect())
}

/// What a line without a frequency is.
enum Told {
    /// A blank one.
    Nothing,
    /// A row but for its frequency.
    Row,
    /// What follows is not to be read.
    Aborted,
    /// Units, or whatever comes behind the table.
    Text,
}

fn told(line: &str, columns: &Columns) -> Told {
    let [_, a, b] = numbers(line, columns);
    if fields(line, columns.separator).iter().all(|field| field.is_empty()) {
        Told::Nothing
    } else if a && b {
        Told::Row
    } else if line.trim_start().starts_with(ABORTED) {
        Told::Aborted
    } else {
        Told::Text
    }
}

/// Whether rows of the table follow, up to a mark of an aborted measurement.
fn goes_on(lines: &[&str], columns: &Columns) -> bool {
    lines.iter().take_while(|line| !line.trim_start().starts_with(ABORTED)).any(|line| numbers(line, columns) == [true; 3])
}

/// Which of the columns that are read hold a number.
fn numbers(line: &str, columns: &Columns) -> [bool; 3] {
    let fields = fields(line, columns.separator);
    columns.read().map(|column| fields.get(column).is_some_and(|field| text::number(field, columns.separator).is_some()))
}

fn fields(line: &str, separator: char) -> Vec<&str> {
    let unquoted = line.trim_end().trim_matches('"');
    if separator == ' ' {
        return unquoted.split_whitespace().collect();
    }
    unquoted.split(separator).map(|field| field.trim().trim_matches('"').trim()).collect()
}

/// The columns that a line names, if it names those of an impedance.
fn columns(line: &str) -> Option<Columns> {
    ['\t', ',', ';', ' '].into_iter().filter(|separator| line.contains(*separator)).find_map(|separator| named(line, separator))
}

fn named(line: &str, separator: char) -> Option<Columns> {
    let mut names: Vec<String> = fields(line, separator).into_iter().map(plain).collect();
    // Z60W writes its names in one field, with blanks between them, and its numbers with commas.
    let separator = if separator == ' ' && line.trim_start().starts_with('"') { ',' } else { separator };
    if separator == ',' && names.len() == 1 {
        names = fields(line, ' ').into_iter().map(plain).collect();
    }
    names.retain(|name| name != "(hz)");
    let find = |wanted: &[&str]| names.iter().position(|name| wanted.contains(&name.as_str()));
    let freq = find(&["freq", "frequency", "freq/hz", "frequency/hz", "freq(hz)", "frequency(hz)", "f/hz", "freq.", "f"])?;
    let re =
        find(&["zreal", "z'", "z'(a)", "re(z)/ohm", "re(z)", "z_re", "zre", "z'(ohm)", "z'/ohm", "zre/ohm", "z'(ω)", "rez", "re", "real"]);
    let plus = find(&[
        "zimag",
        "z''",
        "z''(b)",
        "im(z)/ohm",
        "im(z)",
        "z_im",
        "zim",
        "z''(ohm)",
        "z''/ohm",
        "zim/ohm",
        "z''(ω)",
        "z\"",
        "imz",
        "im",
        "imag",
    ]);
    let minus = find(&["-im(z)/ohm", "-im(z)", "-z''", "-zimag", "-z''(ohm)", "-z''/ohm", "-z''(ω)", "-zim", "-z\"", "-im", "-imag"]);
    let modulus = find(&["|z|/ohm", "|z|", "zmod", "impedance/ohm", "z(ohm)", "|z|(ohm)", "z(ω)", "z/ohm", "impedance"]);
    let degrees = find(&["phase(z)/deg", "phase/deg", "zphz", "-phase(°)", "phase(deg)", "phase(°)", "theta/deg"]);
    let radians = find(&["phase/rad", "phase(rad)", "theta/rad"]);
    let parts = match (re, plus, minus, modulus, degrees, radians) {
        (Some(re), Some(im), ..) => Parts::Cartesian(re, im, 1.0),
        (Some(re), None, Some(im), ..) => Parts::Cartesian(re, im, -1.0),
        (.., Some(modulus), Some(phase), _) => {
            let sign = if names[phase].starts_with('-') { -1.0 } else { 1.0 };
            Parts::Polar(modulus, phase, sign * std::f64::consts::PI / 180.0)
        }
        (.., Some(modulus), None, Some(phase)) => Parts::Polar(modulus, phase, 1.0),
        _ => return None,
    };
    let cycle = find(&["cyclenumber"]);
    Some(Columns { separator, freq, parts, cycle })
}

/// A name without blanks, in lower case.
fn plain(name: &str) -> String {
    name.chars().filter(|c| !c.is_whitespace()).flat_map(char::to_lowercase).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::{read_sourced, read_spectra};
    use std::path::PathBuf;

    fn fixture(name: &str) -> PathBuf {
        PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../fixtures/data/spectra/vendors")).join(name)
    }

    #[test]
    fn files_of_others_are_read() {
        // Provenance beside the files; the numbers are the first and the last row of each by rising frequency.
        for (name, points, first, last) in [
            ("gamry.DTA", 8, (39_984.37, 2_982.016, -1_407.856), (200_015.6, 825.858_4, -1_367.239)),
            ("biologic.mpt", 4, (456.314_09, 66.016_418, -1.164_106_8), (1_000.320_1, 65.470_886, -0.389_989_79)),
            ("zplot.z", 6, (94_868.33, 155.62, -52.177), (300_000.0, 147.77, -11.335)),
            (
                "autolab.txt",
                8,
                (1333.5, 0.014_190_365_264_954_8, -0.000_865_948_762_311_971),
                (10_000.0, 0.013_785_863_964_281, 0.007_191_946_305_823),
            ),
        ] {
            let spectra = read_spectra(&fixture(name)).unwrap();
            let [spectrum] = spectra.as_slice() else { panic!("{name}: {} spectra", spectra.len()) };
            let end = |point: &ImpedancePoint| (point.freq_hz, point.z_ohm.re, point.z_ohm.im);
            assert_eq!(
                (spectrum.points.len(), end(&spectrum.points[0]), end(&spectrum.points[points - 1])),
                (points, first, last),
                "{name}"
            );
        }
    }

    #[test]
    fn lists_of_modulus_and_phase_are_read_and_cycles_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("list.txt");
        std::fs::write(&path, "Number   Frequency/Hz   Impedance/Ohm   Phase/deg\n1  10  2  -90\n2  1  4  180\n\nend\n").unwrap();
        let points = read_spectra(&path).unwrap().remove(0).points;
        assert!(
            (points[0].z_ohm - Complex64::new(-4.0, 0.0)).norm() < 1e-12 && (points[1].z_ohm - Complex64::new(0.0, -2.0)).norm() < 1e-12
        );
        std::fs::write(&path, "freq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\tcycle number\n0\t1\t1\t1\n5\t1\t2\t1\n5\t3\t4\t2\n").unwrap();
        let spectra = read_sourced(&path).unwrap();
        let told: Vec<_> = spectra.iter().map(|s| (s.spectrum.name.as_str(), s.spectrum.points[0].z_ohm)).collect();
        assert_eq!(told, [("list_1", Complex64::new(1.0, -2.0)), ("list_2", Complex64::new(3.0, -4.0))]);
    }

    #[test]
    fn wrong_numbers_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.z");
        let said = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_spectra(&path).unwrap_err().to_string().replace(&path.display().to_string(), "x.z")
        };
        assert_eq!(said("Freq(Hz)\tZ'(a)\tZ''(b)\n1\t2\tno\n"), "x.z, line 2, column 3 (Im Z): expected a finite number in Ω, met \"no\"");
        assert_eq!(
            said("Freq(Hz)\tZ'(a)\tZ''(b)\n-1\t2\t3\n"),
            "x.z, line 2, column 1 (frequency): expected a positive finite frequency in Hz, met \"-1\""
        );
        assert_eq!(
            said("Freq(Hz)\tZ'(a)\tZ''(b)\n1\t2\n"),
            "x.z, line 2, column 3 (Im Z): expected a finite number in Ω, met \"the end of the line\""
        );
        let header = "Freq(Hz)\tZ'(a)\tZ''(b)\n";
        for (rows, place) in [
            (
                "Hz\tOhm\tOhm\n1\t2\t3\n1O\t2\t3\n4\t2\t3\n",
                "line 4, column 1 (frequency): expected a positive finite frequency in Hz, met \"1O\"",
            ),
            ("1.000,5\t2\t3\n4\t2\t3\n", "line 2, column 1 (frequency): expected a positive finite frequency in Hz, met \"1.000,5\""),
            (
                "1\t2\t3\nnote\n4\t2\t3\n",
                "line 3, column 1 (frequency): expected a frequency in Hz, or no further rows behind the end of the table, met \"note\"",
            ),
        ] {
            assert_eq!(said(&format!("{header}{rows}")), format!("x.z, {place}"));
        }
        for rows in ["1\t2\t3\n\n4\t2\t3\nend\n", "1\t2\t3\n\t\t\n4\t2\t3\nEXPERIMENTABORTED\tTOGGLE\tT\n7\t2\t3\n"] {
            std::fs::write(&path, format!("{header}{rows}")).unwrap();
            assert_eq!(read_spectra(&path).unwrap().remove(0).points.len(), 2, "{rows}");
        }
        let empty = "x.z: expected at least one line with a frequency and an impedance, met the names of columns and no row of numbers";
        assert_eq!(said("Freq(Hz)\tZ'(a)\tZ''(b)\n"), empty);
    }
}
