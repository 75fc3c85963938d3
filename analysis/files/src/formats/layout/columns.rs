//! Assigns the columns of a file to quantities.

use crate::formats::error::FormatError;
use crate::formats::sweeps;
use crate::formats::text::{self, Row, Text, shorten};

const PROJECT: [&str; 3] = ["freq_hz", "z_re_ohm", "z_im_ohm"];
const THESIS: [&str; 4] = ["freq", "offset", "resistance", "theta"];
const TIDY: [&str; 7] = [
    "fixture",
    "cell",
    "repeat",
    "bias_a",
    "freq_hz",
    "z_abs_ohm",
    "z_phase_rad",
];
/// Column of the direct current under a sinusoid.
const BIAS: &str = "bias_a";
const OPTIONAL: [&str; 4] = [
    "sigma_re_ohm",
    "sigma_im_ohm",
    "cov_re_im_ohm2",
    "amplitude_a",
];

/// A column: its index and its name.
#[derive(Debug, Clone, Copy)]
pub(super) struct Column {
    pub(super) index: usize,
    pub(super) name: &'static str,
}

/// Notation of an impedance.
#[derive(Debug, Clone, Copy)]
pub(super) enum Impedance {
    Cartesian { re: Column, im: Column },
    Polar { abs: Column, phase: Column },
}

impl Impedance {
    /// Its two columns.
    pub(super) fn columns(self) -> [Column; 2] {
        match self {
            Self::Cartesian { re, im } => [re, im],
            Self::Polar { abs, phase } => [abs, phase],
        }
    }
}

/// The columns of a file.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    pub(super) width: usize,
    pub(super) freq: Column,
    pub(super) impedance: Impedance,
    pub(super) sigma: Option<(Column, Column)>,
    pub(super) cov: Option<Column>,
    pub(super) amplitude: Option<Column>,
    pub(super) bias: Option<Column>,
    /// Fixture, cell, repeat.
    pub(super) labels: Option<[Column; 3]>,
    /// Columns with other names that separate spectra: their kind and index.
    pub(super) sweeps: Vec<(&'static str, usize)>,
}

/// Returns the error for a text whose first line matches no known format.
pub(in super::super) fn unknown(text: &Text<'_>) -> FormatError {
    let first = text.rows.first();
    FormatError::UnknownFormat {
        file: text.file(),
        line: first.map_or(1, |first| first.line),
        met: first.map_or_else(String::new, Row::excerpt),
        nearest: String::new(),
    }
}

impl Layout {
    /// Returns the layout of a file from its first row, and whether that row is a header.
    pub(super) fn of(text: &Text<'_>, first: &Row<'_>) -> Result<(Self, bool), FormatError> {
        let unknown = || unknown(text);
        let column = |index, name| Column { index, name };
        if first
            .fields
            .first()
            .is_some_and(|f| text::number(f, text.separator).is_some())
        {
            if first.fields.len() != 3 {
                return Err(unknown());
            }
            let impedance = Impedance::Cartesian {
                re: column(1, "Re Z"),
                im: column(2, "Im Z"),
            };
            return Ok((Self::plain(3, column(0, "frequency"), impedance), false));
        }
        let header = Header { text, row: first };
        let width = first.fields.len();
        let layout = if let Some([fixture, cell, repeat, bias, freq, abs, phase]) = header.all(TIDY)
        {
            let base = Self::plain(width, freq, Impedance::Polar { abs, phase });
            Self {
                bias: Some(bias),
                labels: Some([fixture, cell, repeat]),
                ..base
            }
        } else if let Some([freq, bias, abs, phase]) = header.all(THESIS) {
            Self {
                bias: Some(bias),
                ..Self::plain(width, freq, Impedance::Polar { abs, phase })
            }
        } else if let Some([freq, re, im]) = header.all(PROJECT) {
            let base = Self::plain(width, freq, Impedance::Cartesian { re, im });
            Self {
                sigma: header.sigma()?,
                cov: header.find(OPTIONAL[2]),
                amplitude: header.find(OPTIONAL[3]),
                bias: header.find(BIAS),
                ..base
            }
        } else {
            return Err(unknown());
        };
        // Only in the project's own files: heads of other programs may contain any text.
        header.refuse_doubles()?;
        let sweeps = first
            .fields
            .iter()
            .enumerate()
            .filter_map(|(place, name)| Some((sweeps::label(name)?, place)))
            .collect();
        Ok((Self { sweeps, ..layout }, true))
    }

    fn plain(width: usize, freq: Column, impedance: Impedance) -> Self {
        Self {
            width,
            freq,
            impedance,
            sigma: None,
            cov: None,
            amplitude: None,
            bias: None,
            labels: None,
            sweeps: Vec::new(),
        }
    }
}

/// The first row as names.
struct Header<'a> {
    text: &'a Text<'a>,
    row: &'a Row<'a>,
}

impl Header<'_> {
    fn find(&self, name: &'static str) -> Option<Column> {
        self.row
            .fields
            .iter()
            .position(|f| f.eq_ignore_ascii_case(name))
            .map(|index| Column { index, name })
    }

    fn all<const N: usize>(&self, names: [&'static str; N]) -> Option<[Column; N]> {
        let found: Vec<Column> = names.iter().filter_map(|n| self.find(n)).collect();
        found.try_into().ok()
    }

    fn sigma(&self) -> Result<Option<(Column, Column)>, FormatError> {
        let [re, im] = [OPTIONAL[0], OPTIONAL[1]];
        match (self.find(re), self.find(im), self.find(OPTIONAL[2])) {
            (Some(a), Some(b), _) => Ok(Some((a, b))),
            (None, None, None) => Ok(None),
            (Some(_), None, _) => {
                Err(self.error(format!("{im} beside {re}"), format!("only {re}")))
            }
            (None, Some(_), _) => {
                Err(self.error(format!("{re} beside {im}"), format!("only {im}")))
            }
            (None, None, Some(c)) => Err(self.error(
                format!("{re} and {im} beside {}", c.name),
                format!("only {}", c.name),
            )),
        }
    }

    fn refuse_doubles(&self) -> Result<(), FormatError> {
        for (i, name) in self
            .row
            .fields
            .iter()
            .enumerate()
            .filter(|(_, n)| !n.is_empty())
        {
            if let Some(first) = self.row.fields[..i]
                .iter()
                .position(|f| f.eq_ignore_ascii_case(name))
            {
                let met = format!("{} in columns {} and {}", shorten(name), first + 1, i + 1);
                return Err(self.error("every column's name once".to_owned(), met));
            }
        }
        Ok(())
    }

    fn error(&self, expected: String, met: String) -> FormatError {
        FormatError::Header {
            file: self.text.file(),
            line: self.row.line,
            expected,
            met,
        }
    }
}
