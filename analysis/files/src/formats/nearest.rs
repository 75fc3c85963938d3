//! Names the reader whose format is most similar to an unreadable text, and what the text lacks for
//! it.

use super::text::{self, shorten};
use super::{timeseries, vendor};

/// Minimum number of fields of a row of numbers.
const ROW: usize = 2;

/// A program by the first words of its files.
struct Program {
    /// Beginning of a line among the first [`HEAD`].
    mark: &'static str,
    reader: &'static str,
    needs: &'static str,
}

/// Number of lines that are searched for the mark of a program.
const HEAD: usize = 20;

const PROGRAMS: [Program; 7] = [
    Program {
        mark: "EXPLAIN",
        reader: "Gamry's .DTA",
        needs: "a table ZCURVE with Freq, Zreal and Zimag",
    },
    Program {
        mark: "EC-Lab ASCII FILE",
        reader: "EC-Lab's .mpt",
        needs: "the columns freq/Hz, Re(Z)/Ohm and -Im(Z)/Ohm",
    },
    Program {
        mark: "BT-Lab ASCII FILE",
        reader: "EC-Lab's .mpt",
        needs: "the columns freq/Hz, Re(Z)/Ohm and -Im(Z)/Ohm",
    },
    Program {
        mark: "ZPLOT",
        reader: "ZPlot's .z",
        needs: "the columns Freq(Hz), Z'(a) and Z''(b)",
    },
    Program {
        mark: "\"Z60W",
        reader: "ZView's Z60W",
        needs: "the columns Freq (Hz), Z'(a) and Z''(b)",
    },
    Program {
        mark: "<Application>",
        reader: "VersaStudio's .par",
        needs: "a list Definition= with Frequency(Hz), Z Real and Z Imag",
    },
    Program {
        mark: "A.C. Impedance",
        reader: "CH Instruments' text",
        needs: "the columns Freq/Hz, Z'/ohm and Z\"/ohm",
    },
];

/// The reader that came nearest and why it does not read the text, as the end of a message; empty
/// if none is similar.
pub(super) fn nearest(bytes: &[u8]) -> String {
    let decoded = String::from_utf8_lossy(bytes);
    let lines: Vec<&str> = decoded.lines().map(str::trim_end).collect();
    let found = of_program(&lines)
        .or_else(|| of_columns(&lines))
        .or_else(|| of_series(&lines))
        .or_else(|| of_list(&lines));
    found.map_or_else(String::new, |reader| {
        format!("; the nearest reader is {reader}")
    })
}

fn of_program(lines: &[&str]) -> Option<String> {
    let marked = |program: &&Program| {
        let mut head = lines.iter().take(HEAD);
        head.any(|line| {
            line.trim_start_matches('\u{feff}')
                .starts_with(program.mark)
        })
    };
    let Program { reader, needs, .. } = PROGRAMS.iter().find(marked)?;
    let tables: Vec<&str> = lines
        .iter()
        .filter_map(|line| line.split_once("\tTABLE"))
        .map(|(name, _)| name)
        .collect();
    let met = match (tables.is_empty(), first_row(lines)) {
        (false, _) => format!("its tables are {}", shorten(&tables.join(", "))),
        (true, Some(row)) if row > 0 => {
            format!("line {row} names {}", shorten(lines[row - 1].trim()))
        }
        (true, Some(_)) => "no line names the columns".to_owned(),
        (true, None) => "it has no row of numbers".to_owned(),
    };
    Some(format!("that of {reader}, which needs {needs}; {met}"))
}

fn of_columns(lines: &[&str]) -> Option<String> {
    let row = first_row(lines)?;
    // A row of units may separate the names from the numbers.
    let (at, named) = (row.saturating_sub(3)..row)
        .rev()
        .find_map(|at| Some((at, vendor::quantities(lines[at])?)))?;
    Some(format!(
        "that of tables with named columns, but line {} names {} alone: it needs the frequency, and \
         the real and the imaginary part or the modulus and the phase of Z",
        at + 1,
        named.join(" and ")
    ))
}

fn of_series(lines: &[&str]) -> Option<String> {
    let at = timeseries::names_a_series(lines)?;
    Some(format!(
        "that of time series, for line {} names a time, a voltage and a current: `ocv`, data sets and \
         `convert --to bdf-csv` take it",
        at + 1
    ))
}

fn of_list(lines: &[&str]) -> Option<String> {
    let row = first_row(lines)?;
    let count = numbers(lines[row])?;
    let line = row + 1;
    (count != 3).then(|| {
        format!(
            "that of impedance.py's list, but line {line} has {count} numbers and not three, and no \
             line names them"
        )
    })
}

/// Returns the first line that contains only numbers.
fn first_row(lines: &[&str]) -> Option<usize> {
    lines
        .iter()
        .position(|line| numbers(line).is_some_and(|count| count >= ROW))
}

/// Returns the number of fields of a line that contains only numbers.
fn numbers(line: &str) -> Option<usize> {
    let separator = match text::separator(line) {
        ',' if !line.contains(',') => ' ',
        other => other,
    };
    let fields: Vec<&str> = if separator == ' ' {
        line.split_whitespace().collect()
    } else {
        text::fields(line, separator).collect()
    };
    let full: Vec<&&str> = fields.iter().filter(|field| !field.is_empty()).collect();
    full.iter()
        .all(|field| text::number(field, separator).is_some())
        .then_some(full.len())
        .filter(|count| *count > 0)
}
