//! Columns of cyclers' tables by the names that programs write: Arbin, Basytec, BDF, BioLogic (EC-Lab
//! text), Digatron, Gamry, Maccor, Neware, Novonix, PEC, TRI, in English, German, French and Chinese.
//!
//! The row of names may stand behind a head of other lines. Units stand in the names or in a row under
//! them. The names of one quantity are tried in their order; of times all are kept, for one of them may
//! start again at each step.

use super::super::text;
use super::names::{
    CAPACITY, CHARGE, CURRENT, DISCHARGE, Names, STATES, STEP, TEMPERATURE, TIME, VOLTAGE, WALL,
};
use super::raw::{QUANTITIES, Quantity};

/// Lines in which the names of the columns are sought: heads of files have some dozens.
const HEAD_LINES: usize = 200;

/// A column.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Found {
    pub(super) index: usize,
    /// Factor that converts a number in it to s, V, A, °C or Ah; none where no unit is written.
    pub(super) unit: Option<f64>,
    /// The name as it stands in the file.
    pub(super) title: String,
}

/// Columns of a record.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    /// Times, the surest first; never empty.
    pub(super) times: Vec<Found>,
    /// The others by [`Quantity`].
    found: [Option<Found>; QUANTITIES],
    /// Columns that may hold the word of the step.
    pub(super) states: Vec<usize>,
    /// Number of names.
    pub(super) width: usize,
    /// True under the names of BDF or of the bench, which count charge positive.
    pub(super) charge_positive: bool,
    /// True for Maccor, whose plain times are minutes or seconds by a setting.
    pub(super) maccor: bool,
    /// Names without a text before the first: a row with something there is of another level.
    pub(super) lead: usize,
    /// Column of EC-Lab's mode in a record of its technique OCV, which writes no current.
    pub(super) rest_mode: Option<usize>,
}

impl Columns {
    /// The column of a quantity.
    pub(super) fn get(&self, quantity: Quantity) -> Option<&Found> {
        self.found[quantity as usize].as_ref()
    }
}

static READ: [(Quantity, &Names); 8] = [
    (Quantity::Voltage, &VOLTAGE),
    (Quantity::Current, &CURRENT),
    (Quantity::Temperature, &TEMPERATURE),
    (Quantity::ChargeAh, &CHARGE),
    (Quantity::DischargeAh, &DISCHARGE),
    (Quantity::Capacity, &CAPACITY),
    (Quantity::Wall, &WALL),
    (Quantity::Step, &STEP),
];

/// A name in parts.
#[derive(Debug, Clone, PartialEq)]
struct Parted {
    /// Without blanks and marks, in small letters.
    base: String,
    unit: Option<String>,
    title: String,
}

/// Columns of a row of names, perhaps with units under them; none where time, voltage or current is
/// not there.
pub(super) fn columns(names: &[&str], units: Option<&[&str]>) -> Option<Columns> {
    let columns = any(names, units);
    let whole =
        columns.get(Quantity::Voltage).is_some() && columns.get(Quantity::Current).is_some();
    (whole && !columns.times.is_empty()).then_some(columns)
}

/// The columns that a row names, whether or not they are a record.
fn any(names: &[&str], units: Option<&[&str]>) -> Columns {
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
    let mut times = TIME.all(&all);
    // A wall clock counts too, from its first row on.
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
        rest_mode: None,
    }
}

/// The line and the columns of EC-Lab's technique OCV: a time, a voltage and the mode, and no current.
pub(super) fn open_circuit(lines: &[&str]) -> Option<(usize, Columns)> {
    lines
        .first()
        .filter(|line| line.contains("-Lab ASCII FILE"))?;
    (0..lines.len().min(HEAD_LINES)).find_map(|at| {
        let (names, units) = row(lines, at);
        let columns = any(&names, units.as_deref());
        let mode = names.iter().position(|name| name.trim() == "mode")?;
        let lacks_current = columns.get(Quantity::Current).is_none();
        let rest = columns.get(Quantity::Voltage).is_some() && !columns.times.is_empty();
        (rest && lacks_current).then_some((
            at,
            Columns {
                rest_mode: Some(mode),
                ..columns
            },
        ))
    })
}

/// Whether a name is that of a wall clock.
pub(super) fn is_wall(name: &str) -> bool {
    WALL.names.contains(&parted(name).base.as_str())
}

/// Whether names are those of BDF or of the bench.
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

/// The line of names of a text, from 0, and its separator.
pub(super) fn header(lines: &[&str]) -> Option<(usize, Columns)> {
    (0..lines.len().min(HEAD_LINES)).find_map(|at| {
        let (names, units) = row(lines, at);
        Some((at, columns(&names, units.as_deref())?))
    })
}

/// The names of a line, and the units under them where the next line holds some.
fn row<'a>(lines: &[&'a str], at: usize) -> (Vec<&'a str>, Option<Vec<&'a str>>) {
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

/// The line that names most of a record and what it lacks, as line from 0 and in words; none where no
/// line names two quantities of one.
pub(super) fn near_miss(lines: &[&str]) -> Option<(usize, String)> {
    let of = |at: usize| {
        let (names, units) = row(lines, at);
        let columns = any(&names, units.as_deref());
        let has = [
            ("a time", !columns.times.is_empty()),
            ("a voltage", columns.get(Quantity::Voltage).is_some()),
            ("a current", columns.get(Quantity::Current).is_some()),
        ];
        let count = has.iter().filter(|(_, there)| *there).count();
        let unknown = [&TIME, &VOLTAGE, &CURRENT]
            .iter()
            .find_map(|names_of| names_of.unknown_unit(&names));
        ((1..3).contains(&count) && (count == 2 || unknown.is_some()))
            .then(|| (count, at, words(&has, unknown)))
    };
    let all = (0..lines.len().min(HEAD_LINES)).filter_map(of);
    let (_, at, words) = all.max_by_key(|(count, at, _)| (*count, std::cmp::Reverse(*at)))?;
    Some((at, words))
}

fn words(has: &[(&str, bool)], unknown: Option<String>) -> String {
    let list = |there: bool| {
        let names = has.iter().filter(|(_, met)| *met == there);
        names
            .map(|(name, _)| *name)
            .collect::<Vec<_>>()
            .join(" and ")
    };
    let unit = unknown.map_or_else(String::new, |name| {
        format!(
            "; the unit in {} is not known (s, min, h; V, mV; A, mA)",
            text::shorten(&name)
        )
    });
    format!("it names {}, and not {}{unit}", list(true), list(false))
}

impl Names {
    /// The columns of the quantity, the surest first.
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
                    // A clock says what it is.
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

    fn is_clock(&self, unit: &str) -> bool {
        self.names.contains(&"testtime")
            && unit.starts_with('h')
            && unit.contains('m')
            && unit.contains('s')
    }

    /// A name of the quantity with a unit that is not known.
    fn unknown_unit(&self, names: &[&str]) -> Option<String> {
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

/// A text in small letters without blanks and marks.
fn plain(text: &str) -> String {
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

/// A name without blanks and marks, in small letters, and its unit where it has one.
fn parted(name: &str) -> Parted {
    let title = name.trim().to_owned();
    let written = title
        .trim_matches(['~', '<', '>', '%'])
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
    let unit = unit.map(plain_unit);
    Parted {
        base: plain(base),
        unit: unit.filter(|unit| !unit.is_empty()),
        title,
    }
}

/// Units that names for machines end with.
fn is_unit(text: &str) -> bool {
    let text = text.trim().to_lowercase();
    let known = [&TIME, &VOLTAGE, &CURRENT, &TEMPERATURE, &CHARGE];
    !matches!(text.as_str(), "t" | "d")
        && known
            .iter()
            .any(|names| names.units.iter().any(|(unit, _)| *unit == text))
}

/// Direction that a word says: 1 for discharge, −1 for charge, 0 for rest; NaN for any other word.
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
