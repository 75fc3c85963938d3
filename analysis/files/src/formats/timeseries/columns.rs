//! Columns of cyclers' tables by the names that programs write: Arbin, Basytec, BDF, BioLogic (EC-Lab
//! text), Digatron, Gamry, Maccor, Neware, Novonix, PEC, TRI, in English, German, French and Chinese.
//!
//! The row of names may follow a head of other lines. Units are part of the names or in a row under
//! them. The names of one quantity are tried in order; all times are kept, because one of them may
//! restart at each step.

use super::super::text;
use super::names::{
    AMBIENT, CAPACITY, CHARGE, CURRENT, DISCHARGE, DOD, NET, Names, SOC, STATES, STEP, TEMPERATURE,
    TIME, VOLTAGE, WALL,
};
use super::raw::{QUANTITIES, Quantity};

/// Number of lines that are searched for the names of the columns: heads of files have some dozens.
pub(super) const HEAD_LINES: usize = 200;

/// Units that are ambiguous if they are the whole name.
const AMBIGUOUS: [&str; 2] = ["d", "min"];

/// A column.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Found {
    pub(super) index: usize,
    /// Factor that converts a number in it to s, V, A, °C or Ah; `None` if no unit is written.
    pub(super) unit: Option<f64>,
    /// The name in the file.
    pub(super) title: String,
}

/// Columns of a record.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    /// Times, the most reliable first; never empty.
    pub(super) times: Vec<Found>,
    /// The other columns, by [`Quantity`].
    found: [Option<Found>; QUANTITIES],
    /// Columns that may contain the name of the step.
    pub(super) states: Vec<usize>,
    /// Number of names.
    pub(super) width: usize,
    /// Whether the names are those of BDF or of the bench, which count charge positive.
    pub(super) charge_positive: bool,
    /// Whether the file is Maccor's, whose plain times are minutes or seconds depending on a
    /// setting.
    pub(super) maccor: bool,
    /// Number of empty names before the first: a row with a value there belongs to another level.
    pub(super) lead: usize,
    /// Marker of zero current, in a record without a current.
    pub(super) rest: Option<Rest>,
}

/// Marker of zero current.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rest {
    /// The column of EC-Lab's mode.
    EcLabMode(usize),
    /// The tag of Gamry's open-circuit potential.
    GamryTag,
}

impl Columns {
    /// Returns the column of a quantity.
    pub(super) fn get(&self, quantity: Quantity) -> Option<&Found> {
        self.found[quantity as usize].as_ref()
    }

    /// Returns a remark if the time is not from the most reliable column.
    pub(super) fn not_the_surest(&self, time: &Found) -> Option<String> {
        let surest = self.times.first()?;
        (surest.index != time.index).then(|| {
            format!(
                "the time is taken from \"{}\", for \"{}\" starts again, does not change or is not a time",
                time.title, surest.title
            )
        })
    }
}

static READ: [(Quantity, &Names); 12] = [
    (Quantity::Voltage, &VOLTAGE),
    (Quantity::Current, &CURRENT),
    (Quantity::Temperature, &TEMPERATURE),
    (Quantity::ChargeAh, &CHARGE),
    (Quantity::DischargeAh, &DISCHARGE),
    (Quantity::Capacity, &CAPACITY),
    (Quantity::Wall, &WALL),
    (Quantity::Step, &STEP),
    (Quantity::Soc, &SOC),
    (Quantity::Dod, &DOD),
    (Quantity::Ambient, &AMBIENT),
    (Quantity::NetAh, &NET),
];

/// A name in parts.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Parted {
    /// The name in lower case without blanks and punctuation.
    base: String,
    unit: Option<String>,
    title: String,
}

/// Returns the columns of a row of names, optionally with units under them; `None` if time, voltage
/// or current is missing.
pub(super) fn columns(names: &[&str], units: Option<&[&str]>) -> Option<Columns> {
    let columns = any(names, units);
    let whole =
        columns.get(Quantity::Voltage).is_some() && columns.get(Quantity::Current).is_some();
    (whole && !columns.times.is_empty()).then_some(columns)
}

/// Returns the columns that a row names, whether or not they form a record.
pub(super) fn any(names: &[&str], units: Option<&[&str]>) -> Columns {
    let mut all: Vec<Parted> = names.iter().map(|name| parted(name)).collect();
    for (one, unit) in all.iter_mut().zip(units.unwrap_or_default()) {
        one.unit = one
            .unit
            .take()
            .or_else(|| Some(plain_unit(unit)).filter(|unit| !unit.is_empty()));
    }
    let mut found: [Option<Found>; QUANTITIES] = Default::default();
    for (quantity, names) in READ {
        found[quantity as usize] = names.all(&all).into_iter().next();
    }
    // The first of numbered channels, such as Digatron's `Temp45`.
    if found[Quantity::Temperature as usize].is_none() {
        let unnumbered = |one: &Parted| Parted {
            base: one
                .base
                .trim_end_matches(|c: char| c.is_ascii_digit())
                .to_owned(),
            ..one.clone()
        };
        let channels: Vec<Parted> = all.iter().map(unnumbered).collect();
        found[Quantity::Temperature as usize] = TEMPERATURE.all(&channels).into_iter().next();
    }
    let mut times = TIME.all(&all);
    // A wall clock is accepted too, counted from its first row.
    if let Some(wall) = &found[Quantity::Wall as usize] {
        times.push(wall.clone());
    }
    let states = STATES.iter().flat_map(|state| {
        let of = |(_, one): &(usize, &Parted)| one.base == *state;
        all.iter().enumerate().filter(of).map(|(index, _)| index)
    });
    let has = |name: &str| all.iter().any(|one| one.base == name);
    Columns {
        states: states.collect(),
        width: names.len(),
        lead: names
            .iter()
            .take_while(|name| name.trim().is_empty())
            .count(),
        charge_positive: is_bdf(names),
        maccor: (has("md") || has("state")) && (has("rec") || has("steptime") || has("amps")),
        times,
        found,
        rest: None,
    }
}

/// Returns the line and the columns of a record at open circuit, which has no current: EC-Lab's
/// technique OCV, with the mode in a column, and Gamry's `CORPOT`.
pub(super) fn open_circuit(lines: &[&str]) -> Option<(usize, Columns)> {
    let ec_lab = lines.first()?.contains("-Lab ASCII FILE");
    let is_tag = |line: &&&str| line.split_whitespace().eq(["TAG", "CORPOT"]);
    let gamry = lines.first()?.trim() == "EXPLAIN" && lines.iter().take(5).any(|l| is_tag(&l));
    (0..lines.len().min(HEAD_LINES)).find_map(|at| {
        let (names, units) = row(lines, at);
        let columns = any(&names, units.as_deref());
        let place = |wanted: &str| names.iter().position(|name| name.trim() == wanted);
        let rest = if ec_lab {
            Rest::EcLabMode(place("mode")?)
        } else {
            place("Vf").filter(|_| gamry)?;
            Rest::GamryTag
        };
        let lacks_current = columns.get(Quantity::Current).is_none();
        let rests = columns.get(Quantity::Voltage).is_some() && !columns.times.is_empty();
        (rests && lacks_current).then_some((
            at,
            Columns {
                rest: Some(rest),
                ..columns
            },
        ))
    })
}

/// Returns whether rows of numbers follow a line of names, optionally with units between.
pub(super) fn come_before_rows(lines: &[&str], names: usize) -> bool {
    let mut next = (names + 1..lines.len()).take(3);
    next.any(|row| is_numbers(lines, names, row))
}

/// Returns whether a line, split like the line of names, contains numbers in at least half of its
/// fields.
fn is_numbers(lines: &[&str], names: usize, row: usize) -> bool {
    let separator = text::separator(lines[names]);
    let fields = text::fields(lines[row], separator).filter(|field| !field.is_empty());
    let (mut filled, mut numbers) = (0, 0);
    for field in fields {
        filled += 1;
        numbers += usize::from(text::number(field, separator).is_some());
    }
    numbers >= 2 && 2 * numbers >= filled
}

/// Returns the columns of a row whose names are units, such as `Seconds,Volts,Amps` or `s;V;A`, each
/// once. Returns `None` under a row of names, whose units these are.
fn of_units(lines: &[&str], at: usize) -> Option<Columns> {
    let (names, _) = row(lines, at);
    let filled = |fields: &[&str]| fields.iter().filter(|field| !field.is_empty()).count();
    let above = at.checked_sub(1).map_or("", |above| lines[above]);
    let above: Vec<&str> = text::fields(above, text::separator(lines[at])).collect();
    // In prose, `a` is not the unit ampere.
    if filled(&above) >= filled(&names) || !come_before_rows(lines, at) {
        return None;
    }
    let mut columns = any(&names, None);
    let all: Vec<Parted> = names.iter().map(|name| parted(name)).collect();
    let one = |names: &Names| match names.as_units(&all).as_slice() {
        [only] => Some(only.clone()),
        _ => None,
    };
    for (quantity, names) in [(Quantity::Voltage, &VOLTAGE), (Quantity::Current, &CURRENT)] {
        if columns.get(quantity).is_none() {
            columns.found[quantity as usize] = Some(one(names)?);
        }
    }
    if columns.times.is_empty() {
        columns.times.push(one(&TIME)?);
    }
    Some(columns)
}

/// Returns whether a name is that of a wall clock.
pub(super) fn is_wall(name: &str) -> bool {
    WALL.names.contains(&parted(name).base.as_str())
}

/// Returns whether names are those of BDF or of the bench.
fn is_bdf(names: &[&str]) -> bool {
    const KNOWN: [[&str; 2]; 3] = [
        ["Voltage / V", "Current / A"],
        ["voltage_volt", "current_ampere"],
        ["voltage_v", "current_a"],
    ];
    let has = |wanted: &str| {
        names
            .iter()
            .any(|name| name.trim().eq_ignore_ascii_case(wanted))
    };
    KNOWN.iter().any(|known| known.iter().all(|name| has(name)))
}

/// Returns the line of names of a text, from 0, and its separator.
pub(super) fn header(lines: &[&str]) -> Option<(usize, Columns)> {
    let head = 0..lines.len().min(HEAD_LINES);
    let named = |at: usize| {
        let (names, units) = row(lines, at);
        Some((at, columns(&names, units.as_deref())?))
    };
    let by_units = |at: usize| Some((at, of_units(lines, at)?));
    head.clone()
        .find_map(named)
        .or_else(|| head.clone().find_map(by_units))
}

/// Returns the names of a line, and the units under them if the next line has some.
pub(super) fn row<'a>(lines: &[&'a str], at: usize) -> (Vec<&'a str>, Option<Vec<&'a str>>) {
    let separator = text::separator(lines[at]);
    let names: Vec<&str> = text::fields(lines[at], separator).collect();
    let units = lines
        .get(at + 1)
        .map(|line| text::fields(line, separator).collect());
    let units = units.filter(|units: &Vec<&str>| {
        let known = |field: &&&str| {
            let unit = plain_unit(field);
            [&TIME, &VOLTAGE, &CURRENT]
                .iter()
                .any(|names| names.units.iter().any(|(known, _)| *known == unit))
        };
        units.iter().filter(known).count() > 1
    });
    (names, units)
}

impl Names {
    /// Returns the columns of the quantity, the most reliable first.
    fn all(&self, all: &[Parted]) -> Vec<Found> {
        let of = |name: &'static str| {
            let fitting = all
                .iter()
                .enumerate()
                .filter(move |(_, one)| one.base == name);
            fitting.filter_map(move |(index, one)| {
                let unit = match &one.unit {
                    None if self.short.contains(&name) => return None,
                    None => None,
                    // A clock needs no unit.
                    Some(unit) if self.is_clock(unit) => None,
                    Some(unit) => {
                        let known = self.units.iter().find(|(known, _)| known == unit);
                        Some(known?.1)
                    }
                };
                let title = one.title.clone();
                Some(Found { index, unit, title })
            })
        };
        self.names.iter().copied().flat_map(of).collect()
    }

    /// Returns the columns whose whole name is a unit of the quantity.
    pub(super) fn as_units(&self, all: &[Parted]) -> Vec<Found> {
        let of = |(index, one): (usize, &Parted)| {
            let bare = one.unit.is_none() && !AMBIGUOUS.contains(&one.base.as_str());
            let mut units = self.units.iter().filter(|_| bare);
            let (_, factor) = units.find(|(unit, _)| *unit == one.base)?;
            let (unit, title) = (Some(*factor), one.title.clone());
            Some(Found { index, unit, title })
        };
        all.iter().enumerate().filter_map(of).collect()
    }

    fn is_clock(&self, unit: &str) -> bool {
        self.names.contains(&"testtime")
            && unit.starts_with('h')
            && unit.contains('m')
            && unit.contains('s')
    }

    /// Returns a name of the quantity with an unknown unit.
    pub(super) fn unknown_unit(&self, names: &[&str]) -> Option<String> {
        let odd = |one: &Parted| {
            let of_it = self.names.contains(&one.base.as_str());
            let known = |unit: &String| self.units.iter().any(|(known, _)| known == unit);
            of_it
                && one
                    .unit
                    .as_ref()
                    .is_some_and(|unit| !known(unit) && !self.is_clock(unit))
        };
        names
            .iter()
            .map(|name| parted(name))
            .find(odd)
            .map(|one| one.title)
    }
}

/// Returns a text in lower case without blanks and punctuation.
pub(super) fn plain(text: &str) -> String {
    let kept = text
        .chars()
        .filter(|c| !matches!(c, ' ' | '_' | '#' | '.' | ':' | '-' | '<' | '>'));
    kept.flat_map(char::to_lowercase)
        .map(|c| if c == 'μ' { 'µ' } else { c })
        .collect()
}

/// A unit without brackets.
fn plain_unit(text: &str) -> String {
    plain(text.trim().trim_matches(['(', ')', '[', ']', '{', '}']))
}

/// Returns a name in lower case without blanks and punctuation, and its unit, if it has one.
pub(super) fn parted(name: &str) -> Parted {
    let title = name.trim().to_owned();
    let written = title
        .trim_start_matches('%')
        .trim_matches(['~', '<', '>'])
        .replace('（', "(")
        .replace('）', ")");
    let (base, unit) = match written.rsplit_once(['(', '[', '/', '{']) {
        Some((base, unit)) if !base.trim().is_empty() => (base, Some(unit)),
        _ => match written
            .rsplit_once('_')
            .or_else(|| written.rsplit_once(" in "))
        {
            Some((base, unit)) if is_unit(unit) => (base, Some(unit)),
            _ => (written.as_str(), None),
        },
    };
    // Arbin numbers its auxiliary channels after the unit.
    let (unit, number) = match unit.and_then(|unit| unit.split_once([')', ']', '}'])) {
        Some((unit, number)) => (Some(unit), number),
        None => (unit, ""),
    };
    let unit = unit.map(plain_unit);
    Parted {
        base: plain(base) + &plain(number),
        unit: unit.filter(|unit| !unit.is_empty()),
        title,
    }
}

/// Units at the end of machine-readable names.
fn is_unit(text: &str) -> bool {
    let text = text.trim().to_lowercase();
    let known = [&TIME, &VOLTAGE, &CURRENT, &TEMPERATURE, &CHARGE];
    !matches!(text.as_str(), "t" | "d")
        && known
            .iter()
            .any(|names| names.units.iter().any(|(unit, _)| *unit == text))
}

/// Returns the direction of a word: 1 for discharge, −1 for charge, 0 for rest; NaN for any other
/// word.
pub(super) fn direction_of(word: &str) -> f64 {
    let word = word.trim().to_lowercase();
    let has = |parts: &[&str]| parts.iter().any(|part| word.contains(part));
    let rest = [
        "rest", "pause", "pau", "ocv", "idle", "静置", "搁置", "ruhe", "repos", "r", "p", "s",
    ];
    if word.is_empty()
        || word
            .chars()
            .all(|c| c.is_ascii_digit() || matches!(c, '.' | '-'))
    {
        f64::NAN
    } else if word == "d"
        || has(&[
            "disch",
            "dchg",
            "dch",
            "dischrg",
            "entlad",
            "décharge",
            "decharge",
            "放电",
        ])
    {
        1.0
    } else if word == "c" || has(&["charg", "chg", "cha", "laden", "ladung", "充电"]) {
        -1.0
    } else if rest.contains(&word.as_str()) {
        0.0
    } else {
        f64::NAN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_tell_the_direction() {
        for (word, expected) in [
            ("CC_DChg", 1.0),
            ("CC Chg", -1.0),
            ("D", 1.0),
            ("C", -1.0),
            ("Entladen", 1.0),
            ("Laden", -1.0),
            ("恒流放电", 1.0),
            ("恒流恒压充电", -1.0),
            ("Décharge", 1.0),
            ("DCH", 1.0),
            ("CHA", -1.0),
            ("Rest", 0.0),
            ("R", 0.0),
        ] {
            assert_eq!(direction_of(word), expected, "{word}");
        }
        assert!(direction_of("7").is_nan() && direction_of("loop").is_nan());
    }
}
