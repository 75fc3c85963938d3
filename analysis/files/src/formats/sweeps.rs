//! Groups the rows of a file into spectra.
//!
//! Rows are separated by their table, by the curve if a row holds several, by a column that names a
//! cycle, a loop or an id, and within these by the frequency: if the frequency starts again, a new
//! sweep begins.
//!
//! A run is a sequence of rows whose frequency moves in one direction. A run in the opposite
//! direction of the previous one begins a new sweep if it repeats the sweep: it begins or ends at
//! the first frequency of the sweep and covers at least a quarter of it, or it contains more than
//! half of its frequencies, or all of them. A run that only repeats a few points, fills gaps or
//! measures another part of the band belongs to the same sweep.

mod runs;

use super::FileSpectra;
use super::error::FormatError;
use super::text;
use analysis_signal::spectrum::{ImpedancePoint, Origin, SourcedSpectrum, Spectrum};
use runs::{Cuts, cuts, distinct};
use std::{collections::BTreeMap, path::Path};

/// Maximum number of lines that a remark names.
const SHOWN: usize = 10;

/// A row of a file.
#[derive(Debug, Clone)]
pub(super) struct MeasuredRow {
    /// From 1.
    pub(super) line: usize,
    pub(super) origin: Origin,
    /// Values that identify its spectrum, in the order of [`Rows::keys`].
    pub(super) key: Vec<String>,
    pub(super) point: ImpedancePoint,
}

/// The rows of a file and the keys that separate their spectra.
#[derive(Debug, Default)]
pub(super) struct Rows {
    pub(super) rows: Vec<MeasuredRow>,
    /// Kinds of the keys.
    pub(super) keys: Vec<Key>,
}

/// Kind of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Key {
    /// Table of a file with several.
    Table,
    /// Evaluation of one measurement, if a row holds several.
    Curve,
    /// Column that counts or names spectra.
    Column(&'static str),
}

/// Rows of one spectrum.
struct Part {
    origin: Origin,
    key: Vec<String>,
    rows: Vec<(usize, ImpedancePoint)>,
    /// Number of the loop, if the frequency starts again.
    number: Option<usize>,
}

/// Returns the kind of a column that separates spectra, from its name.
pub(super) fn label(name: &str) -> Option<&'static str> {
    let plain: String = name
        .chars()
        .filter(char::is_ascii_alphanumeric)
        .collect::<String>()
        .to_ascii_lowercase();
    match plain.as_str() {
        "cycle" | "cyclenumber" | "cycleindex" | "cycleno" | "cyclenr" | "cycleid"
        | "cyclecount" | "cyclecount1" => Some("cycle"),
        "loop" | "loopnumber" | "loopindex" | "loopno" => Some("loop"),
        "id" | "testid" | "eistestid" | "spectrumid" | "sweepid" | "scanid" | "measurementid" => {
            Some("id")
        }
        "spectrum" | "spectrumnumber" | "spectrumindex" | "eisindex" | "eisindex1" => {
            Some("spectrum")
        }
        "sweep" | "sweepnumber" | "sweepindex" | "scan" | "scannumber" => Some("sweep"),
        _ => None,
    }
}

/// Returns the value of a label as part of a name: `2` for `2.000E+00`.
pub(super) fn label_value(field: &str) -> String {
    let number = field
        .replace(',', ".")
        .parse::<f64>()
        .ok()
        .filter(|value| value.is_finite());
    number.map_or_else(|| field.to_owned(), |value| value.to_string())
}

/// Sorts rows into spectra; leaves out points that were not measured. `name` is the name of a single
/// spectrum; if it is the file's name without extension, several spectra are named by the whole file
/// name, such as `file.mpt#loop2`.
pub(super) fn sort(
    path: &Path,
    mut all: Rows,
    name: impl Fn(&Origin, bool) -> String,
) -> Result<FileSpectra, FormatError> {
    let unmeasured = all.drop_unmeasured();
    if all.rows.is_empty() {
        return Err(FormatError::Empty {
            file: path.to_owned(),
            met: "no point that was measured: all are overloads, 0 + 0j or empty",
        });
    }
    all.drop_row_numbers();
    let mut parts: Vec<Part> = Vec::new();
    for MeasuredRow {
        line,
        origin,
        key,
        point,
    } in all.rows
    {
        match parts
            .iter_mut()
            .rev()
            .find(|part| part.key == key && part.origin == origin)
        {
            Some(part) => part.rows.push((line, point)),
            None => parts.push(Part {
                origin,
                key,
                rows: vec![(line, point)],
                number: None,
            }),
        }
    }
    let several = parts.iter().any(|part| part.origin != parts[0].origin);
    let mut notes = Vec::new();
    let mut restarts = Vec::new();
    let parts: Vec<Part> = parts
        .into_iter()
        .flat_map(|part| part.split(&mut restarts, &mut notes))
        .collect();
    let file = path.file_name().map_or_else(
        || "spectrum".to_owned(),
        |name| name.to_string_lossy().into_owned(),
    );
    let stem = path.file_stem().map_or_else(
        || "spectrum".to_owned(),
        |stem| stem.to_string_lossy().into_owned(),
    );
    let spectra: Vec<SourcedSpectrum> = parts
        .into_iter()
        .map(|part| {
            let plain = name(&part.origin, several);
            part.finish(&all.keys, plain, &stem, &file)
        })
        .collect();
    for note in &mut notes {
        *note = format!("{file}: {note}");
    }
    if let Some(note) = separation_note(&all.keys, &restarts, &spectra) {
        notes.insert(0, format!("{file}: {note}"));
    }
    notes.extend(unmeasured.map(|note| format!("{file}: {note}")));
    Ok(FileSpectra { spectra, notes })
}

/// Returns a sentence on the values that separated the spectra; `None` if there is only one.
fn separation_note(
    keys: &[Key],
    restarts: &[usize],
    spectra: &[SourcedSpectrum],
) -> Option<String> {
    let mut by: Vec<String> = keys
        .iter()
        .map(|key| match key {
            Key::Table => "by table".to_owned(),
            Key::Curve => {
                "two curves of one measurement, with and without correction of its drift".to_owned()
            }
            Key::Column(kind) => format!("by the column of the {kind}"),
        })
        .collect();
    if let [first, rest @ ..] = restarts {
        let more = if rest.is_empty() {
            String::new()
        } else {
            format!(" and {} more", rest.len())
        };
        by.push(format!(
            "where the frequency starts again (line {first}{more})"
        ));
    }
    let names = spectra
        .iter()
        .map(|s| format!("{} ({} points)", s.spectrum.name, s.spectrum.points.len()))
        .collect::<Vec<_>>()
        .join(", ");
    (!by.is_empty()).then(|| {
        format!(
            "{} spectra, separated {}: {names}",
            spectra.len(),
            by.join(", ")
        )
    })
}

/// Returns whether a point was measured: it is not an overload, has both parts, and is not 0 + 0j.
pub(super) fn is_measured(point: &ImpedancePoint) -> bool {
    let z = point.z_ohm;
    text::is_measured(z.re) && text::is_measured(z.im) && z.norm() > 0.0
}

impl Rows {
    /// Removes points that were not measured: overloads, points without one part, and 0 + 0j, which
    /// programs write for missing values. Returns a remark with their lines.
    fn drop_unmeasured(&mut self) -> Option<String> {
        let good = |row: &MeasuredRow| is_measured(&row.point);
        let lines: Vec<String> = self
            .rows
            .iter()
            .filter(|row| !good(row))
            .map(|row| row.line.to_string())
            .collect();
        self.rows.retain(good);
        let shown = lines
            .iter()
            .take(SHOWN)
            .cloned()
            .collect::<Vec<_>>()
            .join(", ");
        let more = if lines.len() > SHOWN { ", …" } else { "" };
        (!lines.is_empty()).then(|| {
            format!(
                "points without a measurement (an overload, 0 + 0j, or not a number) are left out: \
                 line {shown}{more}"
            )
        })
    }

    /// Removes keys that do not separate spectra: keys with one value, and numbers of rows or
    /// points, whose values have one frequency each.
    fn drop_row_numbers(&mut self) {
        for place in (0..self.keys.len()).rev() {
            let mut groups: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
            for row in &self.rows {
                groups
                    .entry(row.key.get(place).map_or("", String::as_str))
                    .or_default()
                    .push(row.point.freq_hz);
            }
            let all = distinct(
                &self
                    .rows
                    .iter()
                    .map(|row| row.point.freq_hz)
                    .collect::<Vec<_>>(),
            );
            let different: usize = groups.values().map(|freqs| distinct(freqs).len()).sum();
            let numbers = matches!(self.keys[place], Key::Column(_))
                && different < 2 * groups.len()
                && all.len() > 1;
            if groups.len() < 2 || numbers {
                self.keys.remove(place);
                for row in self.rows.iter_mut().filter(|row| place < row.key.len()) {
                    row.key.remove(place);
                }
            }
        }
    }
}

impl Part {
    /// Splits it where the frequency starts again.
    fn split(self, restarts: &mut Vec<usize>, notes: &mut Vec<String>) -> Vec<Self> {
        let freqs: Vec<f64> = self.rows.iter().map(|(_, point)| point.freq_hz).collect();
        let Cuts {
            starts,
            again,
            turns,
            still,
        } = cuts(&freqs);
        let points = |count: usize| match count {
            1 => "a frequency is".to_owned(),
            _ => format!("{count} frequencies are"),
        };
        let line = |row: &usize| self.rows[*row].0;
        if let Some(first) = again.first().map(line) {
            let points = points(again.len());
            notes.push(format!(
                "{points} measured again (from line {first}) within one sweep, which is left whole"
            ));
        }
        if let Some(first) = still.first().map(line) {
            let points = points(still.len());
            notes.push(format!(
                "{points} that of the row before (from line {first})"
            ));
        }
        if let Some(first) = turns.first().map(line) {
            let more = match turns.len() - 1 {
                0 => String::new(),
                more => format!(" and in {more} more"),
            };
            notes.push(format!(
                "the frequency turns in line {first}{more} within one sweep, whose points are sorted by \
                 frequency: if its frequencies and its impedances stand in different orders, the \
                 spectrum is wrong; check it with `kk`"
            ));
        }
        if starts.len() == 1 {
            return vec![self];
        }
        restarts.extend(starts[1..].iter().map(|start| self.rows[*start].0));
        let ends = starts.iter().skip(1).copied().chain([freqs.len()]);
        starts
            .iter()
            .zip(ends)
            .enumerate()
            .map(|(k, (start, end))| Self {
                origin: self.origin.clone(),
                key: self.key.clone(),
                rows: self.rows[*start..end].to_vec(),
                number: Some(k + 1),
            })
            .collect()
    }

    fn finish(self, keys: &[Key], plain: String, stem: &str, file: &str) -> SourcedSpectrum {
        let mut words: Vec<String> = keys
            .iter()
            .zip(&self.key)
            .map(|(key, value)| match key {
                Key::Table | Key::Curve => value.clone(),
                Key::Column(kind) => format!("{kind}{value}"),
            })
            .collect();
        words.extend(self.number.map(|number| format!("loop{number}")));
        let name = match (words.is_empty(), plain == stem) {
            (true, _) => plain,
            (false, true) => format!("{file}#{}", words.join("-")),
            (false, false) => format!("{plain}#{}", words.join("-")),
        };
        let mut points: Vec<ImpedancePoint> =
            self.rows.into_iter().map(|(_, point)| point).collect();
        points.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
        let curve = keys
            .iter()
            .position(|key| *key == Key::Curve)
            .and_then(|place| self.key.get(place).cloned());
        SourcedSpectrum {
            origin: Origin {
                curve,
                ..self.origin
            },
            spectrum: Spectrum {
                name,
                points,
                ..Spectrum::default()
            },
            flagged: Vec::new(),
        }
    }
}
