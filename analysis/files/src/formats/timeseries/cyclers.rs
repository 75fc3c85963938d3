//! Columns of cyclers' tables by the field's usual names: Arbin, Basytec, BioLogic (EC-Lab text),
//! Digatron, Maccor, Neware, Novonix, PEC, and names of BDF with other units.
//!
//! The row of names may stand behind a head of other lines. Units stand in the names. A time without
//! unit is a clock (`h:mm:ss`). Maccor's currents have no sign: its column `State` or `MD` tells the
//! direction.

use super::super::text;

/// Lines in which the names of the columns are sought: heads of files have some dozens.
const HEAD_LINES: usize = 200;

/// A column, and the factor that converts a number in it to s, V, A or °C.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Found {
    pub(super) index: usize,
    pub(super) factor: f64,
    /// The time is `h:mm:ss`.
    pub(super) clock: bool,
}

/// Columns of a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Columns {
    pub(super) time: Found,
    pub(super) voltage: Found,
    pub(super) current: Found,
    pub(super) temperature: Option<Found>,
    /// Column that tells the direction of currents without sign.
    pub(super) state: Option<usize>,
}

/// Names of a quantity without blanks and marks, the surest first, and its units.
struct Quantity {
    names: &'static [&'static str],
    units: &'static [(&'static str, f64)],
    /// Names that say the unit by themselves.
    plain: &'static [&'static str],
}

const TIME: Quantity = Quantity {
    names: &[
        "testtime",
        "totaltime",
        "runtime",
        "progtime",
        "programtime",
        "elapsedtime",
        "test",
        "prüfzeit",
        "programmdauer",
        "time",
        "zeit",
    ],
    units: &[
        ("s", 1.0),
        ("sec", 1.0),
        ("second", 1.0),
        ("seconds", 1.0),
        ("ms", 1.0e-3),
        ("millisecond", 1.0e-3),
        ("milliseconds", 1.0e-3),
        ("min", 60.0),
        ("minutes", 60.0),
        ("h", 3600.0),
        ("hr", 3600.0),
        ("hours", 3600.0),
    ],
    plain: &[],
};

const VOLTAGE: Quantity = Quantity {
    names: &[
        "voltage",
        "ewe",
        "ecell",
        "volts",
        "potential",
        "spannung",
        "cellvoltage",
        "ucell",
        "u",
    ],
    units: &[("v", 1.0), ("volt", 1.0), ("mv", 1.0e-3)],
    plain: &["volts"],
};

const CURRENT: Quantity = Quantity {
    names: &["current", "<i>", "i", "amps", "strom"],
    units: &[("a", 1.0), ("ampere", 1.0), ("ma", 1.0e-3)],
    plain: &["amps"],
};

const TEMPERATURE: Quantity = Quantity {
    names: &[
        "surfacetemperaturet1",
        "temperaturet1",
        "auxtemperature1",
        "celltemperature",
        "temperature",
        "temperatur",
        "temp",
        "t1",
    ],
    units: &[("c", 1.0), ("°c", 1.0), ("degc", 1.0), ("celsius", 1.0)],
    plain: &[],
};

/// Columns of a row of names; none where time, voltage or current is not there.
pub(super) fn columns(names: &[&str]) -> Option<Columns> {
    let parted: Vec<(String, Option<String>)> = names.iter().map(|name| parted(name)).collect();
    let current = CURRENT.find(&parted)?;
    let maccor = parted
        .get(current.index)
        .is_some_and(|(name, _)| name == "amps");
    let is_state = |(name, _): &(String, Option<String>)| name == "state" || name == "md";
    Some(Columns {
        time: TIME.find(&parted)?,
        voltage: VOLTAGE.find(&parted)?,
        current,
        temperature: TEMPERATURE.find(&parted).filter(|found| !found.clock),
        state: parted.iter().position(is_state).filter(|_| maccor),
    })
}

/// The line of names of a text, from 0, and its separator.
pub(super) fn header(lines: &[&str]) -> Option<(usize, Columns)> {
    lines
        .iter()
        .take(HEAD_LINES)
        .enumerate()
        .find_map(|(at, line)| {
            let separator = text::separator(line);
            let fields: Vec<&str> = text::fields(line, separator).collect();
            Some((at, columns(&fields)?))
        })
}

/// Seconds of a clock: `h:mm:ss`, with fractions, days before a blank or `d` allowed.
pub(super) fn clock_s(field: &str) -> Option<f64> {
    let (days, rest) = field
        .split_once(['d', ' '])
        .map_or(("0", field), |(days, rest)| (days, rest));
    let mut parts = rest
        .trim()
        .split(':')
        .map(|part| part.trim().parse::<f64>());
    let (hours, minutes, seconds) = (
        parts.next()?.ok()?,
        parts.next()?.ok()?,
        parts.next()?.ok()?,
    );
    let within = (0.0..60.0).contains(&minutes) && (0.0..60.0).contains(&seconds);
    let whole = within && hours >= 0.0 && parts.next().is_none();
    let days: f64 = days.trim().parse().ok()?;
    whole.then_some(((days * 24.0 + hours) * 60.0 + minutes) * 60.0 + seconds)
}

impl Quantity {
    fn find(&self, parted: &[(String, Option<String>)]) -> Option<Found> {
        self.names.iter().find_map(|name| {
            let fitting = parted
                .iter()
                .enumerate()
                .filter(|(_, (met, _))| met == name);
            fitting.into_iter().find_map(|(index, (met, unit))| {
                let found = |factor, clock| Found {
                    index,
                    factor,
                    clock,
                };
                match unit {
                    None if self.plain.contains(&met.as_str()) => Some(found(1.0, false)),
                    // A time without unit.
                    None => self.plain.is_empty().then(|| found(1.0, true)),
                    Some(unit) => {
                        let known = self.units.iter().find(|(known, _)| known == unit);
                        known.map(|(_, factor)| found(*factor, false))
                    }
                }
            })
        })
    }
}

/// A name without blanks and marks, in small letters, and its unit where it has one.
fn parted(name: &str) -> (String, Option<String>) {
    let name = name.trim().trim_start_matches('~');
    let (base, unit) = match name.rsplit_once(['(', '[', '/']) {
        Some((base, unit)) if !base.trim().is_empty() => (base, Some(unit)),
        _ => match name.rsplit_once('_') {
            Some((base, unit)) if is_unit(unit) => (base, Some(unit)),
            _ => (name, None),
        },
    };
    let plain = |text: &str| -> String {
        let kept = text
            .chars()
            .filter(|c| !matches!(c, ' ' | '_' | '#' | '.' | ':'));
        kept.flat_map(char::to_lowercase).collect()
    };
    let unit = unit.map(|unit| plain(unit.trim_end_matches([')', ']', ' '])));
    (plain(base), unit.filter(|unit| !unit.is_empty()))
}

/// Units that names for machines end with.
fn is_unit(text: &str) -> bool {
    let text = text.to_lowercase();
    text.len() > 1
        && [&TIME, &VOLTAGE, &CURRENT, &TEMPERATURE]
            .iter()
            .any(|quantity| quantity.units.iter().any(|(unit, _)| *unit == text))
}
