//! The columns of a record as read from the file.

use super::parts::{Head, LeftOut};

/// Quantity of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    /// Time since the start, s.
    Time,
    /// Voltage, V.
    Voltage,
    /// Current with the sign of the file, A.
    Current,
    /// Temperature, °C.
    Temperature,
    /// Direction from a word: 1 for discharge, −1 for charge, 0 for rest.
    State,
    /// Charge into the cell, Ah.
    ChargeAh,
    /// Charge out of the cell, Ah.
    DischargeAh,
    /// Counted charge without direction, Ah.
    Capacity,
    /// Time of a wall clock, s.
    Wall,
    /// Number of the step of the program.
    Step,
    /// State of charge, 0 to 1.
    Soc,
    /// Depth of discharge, 0 to 1.
    Dod,
    /// Temperature of the chamber, °C.
    Ambient,
    /// Charge that went in less charge that came out, Ah.
    NetAh,
}

/// Number of quantities.
pub(super) const QUANTITIES: usize = 14;

/// A value of each quantity; NaN if missing.
pub(super) type Values = [f64; QUANTITIES];

/// Returns the first column of times that changes at least half as often as the one that changes
/// most, given how often each changes; `None` if all decrease somewhere.
pub(super) fn most_moving(moves: &[Option<usize>]) -> Option<usize> {
    let most = moves.iter().flatten().max()?;
    moves
        .iter()
        .position(|moves| moves.is_some_and(|moves| 2 * moves >= *most))
}

/// Columns of a record, of equal length; missing columns are empty.
#[derive(Debug, Default)]
pub(super) struct Raw {
    columns: [Vec<f64>; QUANTITIES],
    present: [bool; QUANTITIES],
    /// Lines of the rows.
    lines: Vec<usize>,
    /// Rows without a voltage or a current, and rows that another one replaced.
    pub(super) left_out: Vec<LeftOut>,
    /// Remarks on how it was read.
    pub(super) notes: Vec<String>,
    /// Whether the file's program counts charge positive by convention.
    pub(super) charge_positive: bool,
    /// Contents of the lines before the names of the columns.
    pub(super) head: Head,
}

impl Raw {
    /// Creates an empty record with these columns.
    pub(super) fn with(present: [bool; QUANTITIES]) -> Self {
        Self {
            present,
            ..Self::default()
        }
    }

    /// Adds a row from this line.
    pub(super) fn push(&mut self, line: usize, values: Values) {
        let time_s = values[Quantity::Time as usize];
        let lacks = values[Quantity::Voltage as usize].is_nan()
            || values[Quantity::Current as usize].is_nan();
        if lacks {
            self.left_out.push(LeftOut {
                line,
                time_s,
                replaced: false,
            });
            return;
        }
        // Cyclers write the same time twice at the end of a step.
        let again = self.get(Quantity::Time).last() == Some(&time_s);
        if again {
            self.left_out.push(LeftOut {
                line: self.lines.pop().unwrap_or(line),
                time_s,
                replaced: true,
            });
            for column in &mut self.columns {
                column.pop();
            }
        }
        self.lines.push(line);
        let all = self.columns.iter_mut().zip(values).zip(self.present);
        for ((column, value), _) in all.filter(|(_, present)| *present) {
            column.push(value);
        }
    }

    /// Appends the rows of another sheet.
    pub(super) fn append(&mut self, mut other: Self) {
        if self.lines.is_empty() {
            self.present = other.present;
            self.charge_positive = other.charge_positive;
            self.head = other.head;
        }
        for (column, more) in self.columns.iter_mut().zip(&mut other.columns) {
            column.append(more);
        }
        self.lines.append(&mut other.lines);
        self.left_out.append(&mut other.left_out);
        for note in other.notes {
            if !self.notes.contains(&note) {
                self.notes.push(note);
            }
        }
    }

    /// Returns a column; empty if the file lacks it.
    pub(super) fn get(&self, quantity: Quantity) -> &[f64] {
        &self.columns[quantity as usize]
    }

    /// Removes and returns a column; `None` if the file lacks it.
    pub(super) fn take(&mut self, quantity: Quantity) -> Option<Vec<f64>> {
        self.present[quantity as usize]
            .then(|| std::mem::take(&mut self.columns[quantity as usize]))
    }

    /// Multiplies a column.
    pub(super) fn scale(&mut self, quantity: Quantity, factor: f64) {
        for value in &mut self.columns[quantity as usize] {
            *value *= factor;
        }
    }

    /// The line of a row.
    pub(super) fn line(&self, row: usize) -> usize {
        self.lines.get(row).copied().unwrap_or(0)
    }

    /// Number of rows.
    pub(super) fn len(&self) -> usize {
        self.lines.len()
    }
}
