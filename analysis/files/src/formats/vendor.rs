//! Reads spectra from the text files of potentiostats: any head, a row that names the columns, and
//! rows of numbers. For each program, the list gives its mark and its columns:
//!
//! * Gamry `.DTA`, recognised by `EXPLAIN`, `ZCURVE`: `Freq`, `Zreal`, `Zimag`; `ZrealDrCor`,
//!   `ZimagDrCor`
//! * BioLogic EC-Lab `.mpt`, recognised by `EC-Lab ASCII FILE`: `freq/Hz`, `Re(Z)/Ohm`,
//!   `-Im(Z)/Ohm`
//! * ZPlot and ZView `.z`, recognised by `ZPLOT2 ASCII`: `Freq(Hz)`, `Z'(a)`, `Z''(b)`
//! * ZView's export of other files (Autolab), recognised by `Z60W Data File`: `Freq (Hz)`, `Z'(a)`,
//!   `Z''(b)`
//! * VersaStudio `.par`, recognised by `Definition=`: `Frequency(Hz)`, `Z Real`, `Z Imag`
//! * Arbin, CH Instruments, Parstat, PowerSuite, Zahner's and Autolab's lists, any other table,
//!   recognised by its row of names: a frequency, and real and imaginary part or modulus and phase
//!
//! The row of names determines the separator: a tab, else a semicolon, else a comma, else blanks.
//! Rows must have the same separator and the same number of fields. Units are part of the names or
//! in a row under them; unknown units and impedances per area are refused. A frequency and an
//! impedance without unit are in Hz and Ω; a phase without unit is in degrees if it exceeds a turn
//! in rad, else it is refused.
//!
//! If fields are not separated by commas, a comma in a number is a decimal point, and all numbers
//! must have the same mark.
//!
//! A minus before a name inverts the sign. Real and imaginary part are preferred to modulus and
//! phase, which have fewer digits. Blank lines are skipped. A line of text ends the table if no row
//! follows it; between rows it is refused. Rows at 0 Hz, which EC-Lab writes for direct current,
//! are left out. Rows after a mark of an aborted measurement are not read. Every further table of
//! impedances is a separate spectrum.

mod line;
mod names;
mod polar;
mod rows;
mod table;

use super::FileSpectra;
use super::error::FormatError;
use super::sweeps;
use rows::Reader;
use std::path::Path;

/// Reads the spectra of a file; returns `None` if no row names columns of an impedance.
///
/// # Errors
/// [`FormatError`] for a table without rows, or with numbers that cannot be measurements.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Option<Result<FileSpectra, FormatError>> {
    let text = String::from_utf8_lossy(bytes);
    let lines: Vec<&str> = text
        .lines()
        .map(|line| line.trim_end_matches('\r'))
        .collect();
    let mut reader = Reader::new(path, &lines);
    let mut at = 0;
    while let Some(header) =
        (at..lines.len()).find(|at| may_be_names(lines[*at]) && reader.takes(*at))
    {
        match reader.read_table(header) {
            Ok(end) => at = end.max(header + 1),
            Err(error) => return Some(Err(error)),
        }
    }
    if !reader.met_table {
        return lines
            .iter()
            .enumerate()
            .filter(|(_, line)| may_be_names(line))
            .find_map(|(at, _)| table::near_miss(path, &lines, at))
            .map(Err);
    }
    if reader.rows.rows.is_empty() {
        return Some(Err(FormatError::Empty {
            file: path.to_owned(),
            met: "the names of columns and no row of numbers",
        }));
    }
    let stem = path.file_stem().map_or_else(
        || "spectrum".to_owned(),
        |stem| stem.to_string_lossy().into_owned(),
    );
    let Reader {
        rows, mut notes, ..
    } = reader;
    let mut read = match sweeps::sort(path, rows, |_, _| stem.clone()) {
        Ok(read) => read,
        Err(error) => return Some(Err(error)),
    };
    read.notes.append(&mut notes);
    Some(Ok(read))
}

/// Describes the quantities of a spectrum that a line names; returns `None` if it names none.
pub(super) fn quantities(line: &str) -> Option<Vec<&'static str>> {
    may_be_names(line).then(|| table::quantities(line))?
}

/// Returns whether a line of a text names all columns of an impedance.
pub(super) fn names_a_spectrum(path: &Path, text: &str) -> bool {
    let lines: Vec<&str> = text.lines().collect();
    let names = |at: usize| {
        may_be_names(lines[at]) && table::table(path, &lines, at).is_some_and(|table| table.is_ok())
    };
    (0..lines.len()).any(names)
}

/// Skips rows of numbers; their only letters are those of exponents, `e` or `D`.
fn may_be_names(line: &str) -> bool {
    line.len() > 2
        && line
            .chars()
            .any(|c| c.is_alphabetic() && !matches!(c, 'e' | 'E' | 'd' | 'D'))
}

/// Returns whether the last comment before a list of numbers contains names of an impedance, as
/// `numpy.savetxt` writes them.
pub(super) fn names_in_comment(text: &str) -> bool {
    let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    let mut named = false;
    let first = lines.find(|line| {
        let comment = line.starts_with(['#', '%']);
        if comment && crate::formats::text::announced(line).is_none() {
            named |= table::table(Path::new(""), &[*line], 0).is_some();
        }
        !comment
    });
    named && first.is_some_and(|first| !may_be_names(first))
}

#[cfg(test)]
mod tests;
