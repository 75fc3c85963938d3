//! A record from a text: a head of any lines, a row of names, and rows.

use super::super::error::FormatError;
use super::super::text::{self, Row, Text, shorten};
use super::super::{foreign, plain};
use super::agreement::{self, COUNTED, Open};
use super::columns::{self, Columns, Found, Rest, direction_of};
use super::error::SeriesReadError;
use super::head;
use super::moment::Stamp;
use super::near;
use super::raw::{self, QUANTITIES, Quantity, Raw};
use std::path::Path;

/// EC-Lab's number of the mode without current.
const MODE_OF_REST: f64 = 3.0;
/// Quantities whose fields may contain anything: a field that is not a number is unknown.
const BESIDE: [Quantity; 9] = [
    Quantity::Capacity,
    Quantity::Temperature,
    Quantity::ChargeAh,
    Quantity::DischargeAh,
    Quantity::Step,
    Quantity::Soc,
    Quantity::Dod,
    Quantity::Ambient,
    Quantity::NetAh,
];

/// Reads a text.
///
/// # Errors
/// Returns an error for a text without such columns, a field that is not a number, and columns that
/// contradict each other.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Raw, SeriesReadError> {
    let decoded = text::utf_16(bytes);
    if let Some(error) = foreign::binary(path, decoded.as_deref().map_or(bytes, str::as_bytes)) {
        return Err(SeriesReadError::foreign(error));
    }
    let content = plain::text(bytes);
    if let Some(error) = foreign::markup(path, content.as_bytes()) {
        return Err(SeriesReadError::foreign(error));
    }
    let lines: Vec<&str> = content.lines().collect();
    let found = columns::header(&lines).or_else(|| columns::open_circuit(&lines));
    let refused = || {
        let foreign = foreign::text(path, content.as_bytes());
        foreign.map_or_else(|| unknown(path, &lines), SeriesReadError::foreign)
    };
    let (at, columns) = found.ok_or_else(refused)?;
    let start = lines[at].as_ptr() as usize - content.as_ptr() as usize;
    let mut text = Text::new(path, &content.as_bytes()[start..])?;
    text.rows.iter_mut().for_each(|row| row.line += at);
    let names = lines[at].trim();
    let below = lines.get(at + 1).map_or("", |line| line.trim());
    let units = Some(below).filter(|below| !below.contains(|c: char| c.is_ascii_digit()));
    text.rows.retain(|row| {
        let lead = row.fields.iter().take(columns.lead);
        // Names and units repeat if a further table continues the record.
        let again =
            row.raw == names || units.is_some_and(|units| row.line > at + 2 && row.raw == units);
        let title = row.fields.get(1) == Some(&"TABLE");
        row.line > at + 1 && !again && !title && lead.clone().all(|field| field.is_empty())
    });
    text.one_mark()?;
    let table = Table {
        path,
        text: &text,
        columns: &columns,
    };
    let mut raw = table.read()?;
    raw.head = head::read(&lines[..at]);
    Ok(raw)
}

/// Returns the error for a text without a record, with what its most similar line lacks.
fn unknown(path: &Path, lines: &[&str]) -> SeriesReadError {
    let near = near::near_miss(lines);
    let first = || {
        let filled = |line: &str| !line.trim().is_empty() && !text::is_comment(line);
        lines.iter().position(|line| filled(line))
    };
    let (place, met) = match (&near, first()) {
        (Some((at, lacks)), _) => (*at, format!("{}: {lacks}", shorten(lines[*at].trim()))),
        (None, Some(at)) => (at, shorten(lines[at].trim())),
        (None, None) => {
            return SeriesReadError::UnknownFormat {
                file: path.to_owned(),
                place: String::new(),
                met: "no line with data".to_owned(),
            };
        }
    };
    SeriesReadError::UnknownFormat {
        file: path.to_owned(),
        place: format!(", line {}", place + 1),
        met,
    }
}

/// A text whose columns are known.
struct Table<'a> {
    path: &'a Path,
    text: &'a Text<'a>,
    columns: &'a Columns,
}

impl Table<'_> {
    fn read(&self) -> Result<Raw, SeriesReadError> {
        let rows = self.rows();
        let (time, kind) = self.time(rows);
        let state = self.state(rows);
        let mut present = [false; QUANTITIES];
        for quantity in BESIDE.into_iter().chain([Quantity::Wall]) {
            present[quantity as usize] = self.columns.get(quantity).is_some();
        }
        for quantity in [Quantity::Time, Quantity::Voltage, Quantity::Current] {
            present[quantity as usize] = true;
        }
        present[Quantity::State as usize] = state.is_some();
        let mut raw = Raw::with(present);
        let mut first_s = None;
        for row in rows {
            if self.is_empty(row, time) {
                continue;
            }
            self.check_width(row)?;
            let stamp = self.stamp(row, time, kind)?;
            let mut values = [f64::NAN; QUANTITIES];
            let time_s = match stamp {
                Stamp::Number(value) if is_wall(time) => Stamp::Number(value).wall_s(),
                stamp => stamp.seconds(time.unit.unwrap_or(1.0)),
            };
            let from_date = matches!(stamp, Stamp::Date(_)) || is_wall(time);
            let start_s = if from_date {
                *first_s.get_or_insert(time_s)
            } else {
                0.0
            };
            values[Quantity::Time as usize] = time_s - start_s;
            values[Quantity::Voltage as usize] = self.measured(row, Quantity::Voltage)?;
            values[Quantity::Current as usize] = match self.columns.rest {
                Some(Rest::EcLabMode(mode)) => self.rest(row, mode)?,
                Some(Rest::GamryTag) => 0.0,
                None => self.measured(row, Quantity::Current)?,
            };
            for quantity in BESIDE {
                values[quantity as usize] = self.columns.get(quantity).map_or(f64::NAN, |found| {
                    let number = self
                        .number(row, found.index)
                        .filter(|v| text::is_measured(*v));
                    number.map_or(f64::NAN, |value| value * found.unit.unwrap_or(1.0))
                });
            }
            let field = |index: usize| row.fields.get(index).copied().unwrap_or_default();
            let separator = self.text.separator;
            let wall = self.columns.get(Quantity::Wall);
            values[Quantity::Wall as usize] = wall
                .and_then(|found| Stamp::of(field(found.index), separator))
                .map_or(f64::NAN, Stamp::wall_s);
            values[Quantity::State as usize] =
                state.map_or(f64::NAN, |index| direction_of(field(index)));
            raw.push(row.line, values);
        }
        raw.charge_positive = self.columns.charge_positive;
        raw.notes.extend(self.columns.not_the_surest(time));
        if let Some(rest) = self.columns.rest {
            let program = match rest {
                Rest::EcLabMode(_) => "EC-Lab's technique OCV",
                Rest::GamryTag => "Gamry's open-circuit potential (CORPOT)",
            };
            let note = format!("{program} writes no current: it is 0 A at rest");
            raw.notes.push(note);
        }
        let plain = |quantity| {
            let found = self.columns.get(quantity);
            found
                .filter(|found| found.unit.is_none())
                .map(|found| found.title.clone())
        };
        let number = matches!(kind, Some(Stamp::Number(_)) | None) && !is_wall(time);
        let open = Open {
            time: (number && time.unit.is_none()).then(|| time.title.clone()),
            voltage: plain(Quantity::Voltage),
            current: plain(Quantity::Current),
            maccor: self.columns.maccor,
            capacity: COUNTED
                .into_iter()
                .filter_map(|quantity| self.columns.get(quantity))
                .all(|found| found.unit.is_some()),
        };
        agreement::settle(self.path, &mut raw, &open)?;
        Ok(raw)
    }

    /// The rows without a row of units.
    fn rows(&self) -> &[Row<'_>] {
        let all = self.text.rows.as_slice();
        let needed = [Quantity::Voltage, Quantity::Current].map(|q| self.columns.get(q));
        let times = self.columns.times.iter().map(Some);
        let unread = |row: &Row<'_>| {
            let mut found = times.clone().chain(needed).flatten();
            found.all(|found| {
                let field = row.fields.get(found.index).copied().unwrap_or_default();
                Stamp::of(field, self.text.separator).is_none()
            })
        };
        match all.split_first() {
            Some((first, rest)) if unread(first) => rest,
            _ => all,
        }
    }

    /// Returns the first column of a time that never decreases and is not constant, and the kind of
    /// its stamps. A column is skipped if another one changes more than twice as often, because only
    /// the last of several rows at the same time is kept.
    fn time(&self, rows: &[Row<'_>]) -> (&Found, Option<Stamp>) {
        let kind = |found: &Found| {
            rows.iter()
                .find_map(|row| Stamp::of(row.fields.get(found.index)?, self.text.separator))
        };
        let count_moves = |found: &Found| {
            let kind = kind(found)?;
            let (mut last, mut moves) = (f64::NEG_INFINITY, 0);
            for row in rows.iter().filter(|row| !self.is_empty(row, found)) {
                let field = row.fields.get(found.index).copied().unwrap_or_default();
                let stamp = Stamp::of(field, self.text.separator);
                let now = stamp.filter(|stamp| stamp.is_like(kind))?.seconds(1.0);
                if now < last {
                    return None;
                }
                moves += usize::from(now > last);
                last = now;
            }
            (2 * moves > rows.len().min(4)).then_some(moves)
        };
        let times = &self.columns.times;
        let moves: Vec<Option<usize>> = times.iter().map(count_moves).collect();
        let chosen = &times[raw::most_moving(&moves).unwrap_or(0)];
        (chosen, kind(chosen))
    }

    /// Returns the column whose words give the direction.
    fn state(&self, rows: &[Row<'_>]) -> Option<usize> {
        let tells = |index: &usize| {
            let mut words = rows.iter().filter_map(|row| row.fields.get(*index));
            words.any(|word| direction_of(word).abs() == 1.0)
        };
        self.columns.states.iter().copied().find(tells)
    }

    /// Returns whether a row has neither a time nor a voltage nor a current.
    fn is_empty(&self, row: &Row<'_>, time: &Found) -> bool {
        let read = [Quantity::Voltage, Quantity::Current].map(|q| self.columns.get(q));
        read.into_iter().flatten().chain([time]).all(|found| {
            row.fields
                .get(found.index)
                .is_none_or(|field| text::is_missing(field))
        })
    }

    fn stamp(
        &self,
        row: &Row<'_>,
        time: &Found,
        kind: Option<Stamp>,
    ) -> Result<Stamp, SeriesReadError> {
        let field = row.fields.get(time.index).copied();
        let stamp = Stamp::of(field.unwrap_or_default(), self.text.separator);
        let alike = stamp.filter(|stamp| kind.is_none_or(|kind| stamp.is_like(kind)));
        alike.ok_or_else(|| self.wrong(row, time))
    }

    /// Returns a voltage or a current; NaN if it was not measured.
    fn measured(&self, row: &Row<'_>, quantity: Quantity) -> Result<f64, SeriesReadError> {
        let Some(found) = self.columns.get(quantity) else {
            return Ok(f64::NAN);
        };
        let field = row.fields.get(found.index).copied();
        if field.is_some_and(text::is_missing) {
            return Ok(f64::NAN);
        }
        let value = self
            .number(row, found.index)
            .filter(|value| value.is_finite());
        let value = value.ok_or_else(|| self.wrong(row, found))?;
        let scaled = value * found.unit.unwrap_or(1.0);
        Ok(if text::is_measured(value) {
            scaled
        } else {
            f64::NAN
        })
    }

    /// Returns the current of a row in EC-Lab's technique OCV.
    fn rest(&self, row: &Row<'_>, mode: usize) -> Result<f64, SeriesReadError> {
        if self.number(row, mode) == Some(MODE_OF_REST) {
            return Ok(0.0);
        }
        Err(SeriesReadError::UnknownFormat {
            file: self.path.to_owned(),
            place: format!(", line {}", row.line),
            met: "a time and a voltage without a current, and a mode other than 3 (rest); export the \
                  column I/mA"
                .to_owned(),
        })
    }

    fn number(&self, row: &Row<'_>, index: usize) -> Option<f64> {
        text::number(row.fields.get(index)?, self.text.separator)
    }

    /// Refuses a decimal comma between comma separators, which would shift all following fields.
    fn check_width(&self, row: &Row<'_>) -> Result<(), SeriesReadError> {
        let (expected, met) = (self.columns.width, row.fields.len());
        match (expected..met).find(|k| !row.fields[*k].is_empty()) {
            Some(more) if self.text.separator == ',' => Err(FormatError::FieldCount {
                file: self.path.to_owned(),
                line: row.line,
                column: more + 1,
                expected,
                met,
            }
            .into()),
            _ => Ok(()),
        }
    }

    fn wrong(&self, row: &Row<'_>, found: &Found) -> SeriesReadError {
        let field = row.fields.get(found.index);
        SeriesReadError::Field {
            file: self.path.to_owned(),
            line: row.line,
            column: found.index + 1,
            name: found.title.clone(),
            met: field.map_or_else(|| "the end of the line".to_owned(), |field| shorten(field)),
        }
    }
}

/// Returns whether a wall clock is used as the time.
fn is_wall(found: &Found) -> bool {
    columns::is_wall(&found.title)
}
