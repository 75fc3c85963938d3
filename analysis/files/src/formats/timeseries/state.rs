//! State and temperature of the cell, from the columns and the head of a record.

use super::parts::Head;
use super::raw::{Quantity, Raw};

/// Above this number a state of charge is in percent.
const MOST: f64 = 1.5;
/// Allowed states of charge in a column: cyclers count slightly beyond empty and full.
const STATES: std::ops::RangeInclusive<f64> = -0.1..=1.1;

/// State of the cell from a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct State {
    /// State of charge in each row, 0 to 1, from its column or from the depth of discharge; NaN if
    /// the row has none.
    pub soc: Option<Vec<f64>>,
    /// Charge that went into the cell less charge that came out in each row, Ah, by a counter of the
    /// cycler; NaN where the row has none.
    pub net_ah: Option<Vec<f64>>,
    /// Numbers before the names of the columns.
    pub head: Head,
}

/// Extracts the state and the temperatures of the cell, °C; adds remarks to the record.
pub(super) fn take(raw: &mut Raw) -> (State, Option<Vec<f64>>) {
    let charged = fraction(raw, Quantity::Soc, "state of charge");
    let soc = charged.or_else(|| {
        let discharged = fraction(raw, Quantity::Dod, "depth of discharge")?;
        Some(discharged.into_iter().map(|depth| 1.0 - depth).collect())
    });
    let state = State {
        soc,
        net_ah: raw.take(Quantity::NetAh),
        head: raw.head,
    };
    let measured = |all: &Vec<f64>| all.iter().any(|celsius| celsius.is_finite());
    let of_cell = raw.take(Quantity::Temperature);
    if of_cell.as_ref().is_some_and(measured) {
        return (state, of_cell);
    }
    let chamber = raw.take(Quantity::Ambient).filter(measured);
    if chamber.is_some() {
        let note = "it holds no temperature of the cell: that of the chamber is taken";
        raw.notes.push(note.to_owned());
    }
    (state, chamber.or(of_cell))
}

/// Converts a column of fractions or percent to fractions; returns `None` if the file has none or
/// its values are out of range.
fn fraction(raw: &mut Raw, quantity: Quantity, name: &str) -> Option<Vec<f64>> {
    let mut all = raw.take(quantity)?;
    let finite = || all.iter().copied().filter(|value| value.is_finite());
    let most = finite().fold(f64::NEG_INFINITY, f64::max);
    let factor = if most > MOST { 0.01 } else { 1.0 };
    let odd = finite().find(|value| !STATES.contains(&(factor * value)));
    if most == f64::NEG_INFINITY {
        return None;
    }
    if let Some(odd) = odd {
        raw.notes.push(format!(
            "its column of the {name} is not used: it holds {odd}, which is none"
        ));
        return None;
    }
    all.iter_mut().for_each(|value| *value *= factor);
    Some(all)
}
