//! Assigns the columns of a file to quantities, and turns rows into spectra.

use super::{
    FileSpectra,
    error::FormatError,
    sweeps::{self, Key, MeasuredRow, Rows, label_value},
    text::{self, Row, Text, shorten},
};
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Origin, SourcedSpectrum};
use num_complex::Complex64;

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
const OPTIONAL: [&str; 4] = [
    "sigma_re_ohm",
    "sigma_im_ohm",
    "cov_re_im_ohm2",
    "amplitude_a",
];

/// A column: where it stands and what it is called.
#[derive(Debug, Clone, Copy)]
struct Column {
    index: usize,
    name: &'static str,
}

/// Notation of an impedance.
#[derive(Debug, Clone, Copy)]
enum Impedance {
    Cartesian { re: Column, im: Column },
    Polar { abs: Column, phase: Column },
}

/// The columns of a file.
#[derive(Debug, Clone)]
struct Layout {
    width: usize,
    freq: Column,
    impedance: Impedance,
    sigma: Option<(Column, Column)>,
    cov: Option<Column>,
    amplitude: Option<Column>,
    bias: Option<Column>,
    /// Fixture, cell, repeat.
    labels: Option<[Column; 3]>,
    /// Columns of other names that tell spectra apart: their kind and place.
    sweeps: Vec<(&'static str, usize)>,
}

pub(super) fn parse(text: &Text<'_>) -> Result<FileSpectra, FormatError> {
    let empty = |met| {
        Err(FormatError::Empty {
            file: text.file(),
            met,
        })
    };
    let Some((first, rest)) = text.rows.split_first() else {
        return empty(if text.has_content {
            "only comments"
        } else {
            "an empty file"
        });
    };
    let (layout, named) = Layout::of(text, first)?;
    let rows = if named { rest } else { text.rows.as_slice() };
    if rows.is_empty() {
        return empty("only a header");
    }
    text.one_mark()?;
    let mut all = Rows {
        rows: Vec::new(),
        keys: layout
            .sweeps
            .iter()
            .map(|(kind, _)| Key::Column(kind))
            .collect(),
    };
    for row in rows {
        let cells = Cells {
            text,
            row,
            layout: &layout,
        };
        let (origin, point) = cells.read()?;
        let value = |(_, place): &(&str, usize)| {
            label_value(row.fields.get(*place).copied().unwrap_or_default())
        };
        all.rows.push(MeasuredRow {
            line: row.line,
            origin,
            key: layout.sweeps.iter().map(value).collect(),
            point,
        });
    }
    let stem = text.path.file_stem().map_or_else(
        || "spectrum".to_owned(),
        |s| s.to_string_lossy().into_owned(),
    );
    let mut read = sweeps::sort(text.path, all, |origin, several| {
        name(origin, &stem, several)
    })?;
    if !named {
        read.notes.extend(inductive(text, &read.spectra));
    }
    super::shared::attach(text, &mut read.spectra)?;
    super::flags::attach(text, &mut read.spectra);
    Ok(read)
}

/// A remark on a list without names whose points are inductive, which may be −Im Z.
fn inductive(text: &Text<'_>, spectra: &[SourcedSpectrum]) -> Option<String> {
    let points = || spectra.iter().flat_map(|one| &one.spectrum.points);
    let (all, above) = (
        points().count(),
        points().filter(|p| p.z_ohm.im > 0.0).count(),
    );
    let file = text.path.file_name().unwrap_or_default().to_string_lossy();
    (all > 2 && 10 * above > 9 * all).then(|| {
        format!(
            "{file}: its list has no names and is taken as f, Re Z, Im Z; Im Z is above 0 at {above} of \
             {all} points: if the file holds −Im Z, put the line \"f,re,-im\" before the numbers"
        )
    })
}

/// The refusal of a text whose first line is of no known format.
pub(super) fn unknown(text: &Text<'_>) -> FormatError {
    let first = text.rows.first();
    FormatError::UnknownFormat {
        file: text.file(),
        line: first.map_or(1, |first| first.line),
        met: first.map_or_else(String::new, Row::excerpt),
        nearest: String::new(),
    }
}

fn name(origin: &Origin, stem: &str, several: bool) -> String {
    let text = |o: &Option<String>| o.clone().unwrap_or_default();
    let bias = match origin.bias_a {
        Some(bias) if bias != 0.0 => format!("_{bias:+}A"),
        _ => String::new(),
    };
    match &origin.fixture {
        Some(fixture) => {
            // A control is alone of its kind: its number says nothing.
            let number = Some(text(&origin.cell))
                .filter(|c| fixture == "cell" || c != "0")
                .unwrap_or_default();
            format!("{fixture}{number}_{}{bias}", text(&origin.repeat))
        }
        None if several => format!("{stem}{bias}"),
        None => stem.to_owned(),
    }
}

impl Layout {
    /// The layout that a file's first row announces, and whether that row is a header.
    fn of(text: &Text<'_>, first: &Row<'_>) -> Result<(Self, bool), FormatError> {
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
                ..base
            }
        } else {
            return Err(unknown());
        };
        // Only of its own: the head of another program may say what it likes.
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

/// The first row read as names.
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

/// One row read by a layout.
struct Cells<'a> {
    text: &'a Text<'a>,
    row: &'a Row<'a>,
    layout: &'a Layout,
}

impl Cells<'_> {
    fn read(&self) -> Result<(Origin, ImpedancePoint), FormatError> {
        self.check_width()?;
        let l = self.layout;
        let freq_hz = self.number(l.freq, "a positive finite frequency in Hz", |f| f > 0.0)?;
        let z_ohm = match l.impedance {
            Impedance::Cartesian { re, im } => {
                let part = |c| self.number(c, "a finite number in Ω", |_| true);
                Complex64::new(part(re)?, part(im)?)
            }
            Impedance::Polar { abs, phase } => Complex64::from_polar(
                self.number(abs, "a finite magnitude of zero or more in Ω", |m| {
                    m >= 0.0
                })?,
                self.number(phase, "a finite angle in rad", |_| true)?,
            ),
        };
        let amplitude_a = self
            .optional(l.amplitude, "a positive amplitude in A, or nothing", |a| {
                a > 0.0
            })?
            .unwrap_or(f64::NAN);
        let point = ImpedancePoint {
            freq_hz,
            z_ohm,
            covariance: self.covariance()?,
            amplitude_a,
        };
        Ok((self.origin()?, point))
    }

    fn check_width(&self) -> Result<(), FormatError> {
        let (expected, met) = (self.layout.width, self.row.fields.len());
        let only_blanks_more =
            met > expected && self.row.fields[expected..].iter().all(|f| f.is_empty());
        if met == expected || only_blanks_more {
            return Ok(());
        }
        Err(FormatError::FieldCount {
            file: self.text.file(),
            line: self.row.line,
            column: met.min(expected) + 1,
            expected,
            met,
        })
    }

    fn origin(&self) -> Result<Origin, FormatError> {
        let bias_a = match self.layout.bias {
            // −0 and 0 are one bias.
            Some(column) => Some(self.number(column, "a finite current in A", |_| true)? + 0.0),
            None => None,
        };
        let Some([fixture, cell, repeat]) = self.layout.labels else {
            return Ok(Origin {
                bias_a,
                ..Origin::default()
            });
        };
        if self.field(fixture).is_empty() {
            return Err(self.error(fixture, "the name of what was clamped in"));
        }
        let filled = |c| Some(self.field(c).to_owned()).filter(|t| !t.is_empty());
        Ok(Origin {
            fixture: filled(fixture),
            cell: filled(cell),
            repeat: filled(repeat),
            bias_a,
            curve: None,
        })
    }

    fn covariance(&self) -> Result<Covariance2, FormatError> {
        let Some((re, im)) = self.layout.sigma else {
            return Ok(Covariance2::UNKNOWN);
        };
        let sigma = |c| {
            self.optional(
                Some(c),
                "a standard uncertainty of zero or more in Ω, or nothing",
                |s| s >= 0.0,
            )
        };
        let (Some(sigma_re), Some(sigma_im)) = (sigma(re)?, sigma(im)?) else {
            return Ok(Covariance2::UNKNOWN);
        };
        // Rounding in the file may take the correlation a hair beyond one.
        let most = sigma_re * sigma_im * (1.0 + 1e-9);
        let expected = "a covariance in Ω² no larger than the product of the sigmas, or nothing";
        let re_im = self
            .optional(self.layout.cov, expected, |c| c.abs() <= most)?
            .unwrap_or(0.0);
        Ok(Covariance2 {
            re_re: sigma_re * sigma_re,
            re_im,
            im_im: sigma_im * sigma_im,
        })
    }

    fn number(
        &self,
        column: Column,
        expected: &'static str,
        good: impl Fn(f64) -> bool,
    ) -> Result<f64, FormatError> {
        match text::number(self.field(column), self.text.separator) {
            Some(v) if v.is_finite() && good(v) => Ok(v),
            _ => Err(self.error(column, expected)),
        }
    }

    /// None for a column the file lacks, an empty field, or NaN, which is how an unknown number is
    /// written.
    fn optional(
        &self,
        column: Option<Column>,
        expected: &'static str,
        good: impl Fn(f64) -> bool,
    ) -> Result<Option<f64>, FormatError> {
        match column {
            Some(c) if !self.field(c).is_empty() && !self.field(c).eq_ignore_ascii_case("nan") => {
                self.number(c, expected, good).map(Some)
            }
            _ => Ok(None),
        }
    }

    fn field(&self, column: Column) -> &str {
        self.row
            .fields
            .get(column.index)
            .copied()
            .unwrap_or_default()
    }

    fn error(&self, column: Column, expected: &'static str) -> FormatError {
        let quoted = shorten(self.field(column));
        let met = quoted.trim_matches('"').to_owned();
        FormatError::Field {
            file: self.text.file(),
            line: self.row.line,
            column: column.index + 1,
            name: column.name,
            expected,
            met,
        }
    }
}
