//! Reads the head of a record, before the names of its columns: the capacity of the cell and the
//! temperature of the test.

use super::columns::plain;
use super::parts::{Fact, Head};

/// Names of the nominal capacity of a cell. Measured capacities have other names.
const CAPACITY: [&str; 7] = [
    "nominalcapacity",
    "ratedcapacity",
    "batterycapacity",
    "cellcapacity",
    "nominalcap",
    "nennkapazität",
    "nennkapazitat",
];
/// Names of a temperature of the whole test.
const TEMPERATURE: [&str; 7] = [
    "temperature",
    "testtemperature",
    "ambienttemperature",
    "chambertemperature",
    "temperatur",
    "prüftemperatur",
    "umgebungstemperatur",
];
/// A capacity without a unit is in Ah below this number; larger ones may be in mAh.
const MOST_AH: f64 = 100.0;
/// Temperatures at which a cell is tested, °C.
const TEMPERATURES_C: std::ops::RangeInclusive<f64> = -60.0..=120.0;

/// Reads the lines before the names of the columns. The first number of each kind is used.
pub(super) fn read(lines: &[&str]) -> Head {
    let mut head = Head::default();
    for (at, line) in lines.iter().enumerate() {
        let Some(entry) = Entry::of(line) else {
            continue;
        };
        let fact = |value| Fact {
            value,
            line: at + 1,
        };
        head.capacity_ah = head.capacity_ah.or_else(|| entry.capacity_ah().map(fact));
        head.temperature_degc = head
            .temperature_degc
            .or_else(|| entry.temperature_degc().map(fact));
    }
    head
}

/// Parses a line of the head: `name: number unit`, `name [unit];number` or `name,number`.
struct Entry {
    name: String,
    number: f64,
    unit: String,
}

impl Entry {
    fn of(line: &str) -> Option<Self> {
        let (name, rest) = line.split_once([':', ';', '\t', '=', ','])?;
        // Further fields may follow a comma or a semicolon.
        let separator = line[name.len()..].chars().next()?;
        let ends = |c: char| c == separator || c == ';' || c == '\t';
        let value = rest.trim_start().trim_matches('"');
        let value = value.split(ends).next()?.trim().trim_matches('"');
        let is_number = |c: char| c.is_ascii_digit() || matches!(c, '.' | ',' | '-' | '+');
        let length = value.find(|c| !is_number(c)).unwrap_or(value.len());
        let (number, unit) = value.split_at(length);
        let (name, in_name) = name
            .trim_end()
            .trim_end_matches([']', ')'])
            .split_once(['[', '('])
            .unwrap_or((name, ""));
        let unit = if unit.trim().is_empty() {
            in_name
        } else {
            unit
        };
        let name = name.trim().trim_start_matches(['~', '#', '%', '"']);
        Some(Self {
            name: plain(name.trim_end_matches('"')),
            number: number.replace(',', ".").parse().ok()?,
            unit: plain(unit.trim().trim_matches(['[', ']', '(', ')', '"'])),
        })
    }

    fn capacity_ah(&self) -> Option<f64> {
        let named = CAPACITY.contains(&self.name.as_str()) && self.number > 0.0;
        let factor = match self.unit.as_str() {
            "ah" => 1.0,
            "mah" => 1.0e-3,
            "" if self.number < MOST_AH => 1.0,
            _ => return None,
        };
        named.then_some(self.number * factor)
    }

    fn temperature_degc(&self) -> Option<f64> {
        let named = TEMPERATURE.contains(&self.name.as_str());
        let celsius = matches!(
            self.unit.as_str(),
            "" | "c" | "°c" | "degc" | "℃" | "celsius"
        );
        let fits = named && celsius && TEMPERATURES_C.contains(&self.number);
        fits.then_some(self.number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capacity_and_temperature_are_found_in_the_heads_of_programs() {
        for (line, capacity_ah, temperature_degc) in [
            ("Nominal Capacity, 3,,,", Some(3.0), None),
            ("Battery capacity : 3,500 A.h", Some(3.5), None),
            ("~Nominal capacity[Ah]: 4.7", Some(4.7), None),
            ("Rated Capacity (mAh);2900", Some(2.9), None),
            ("Nominal Capacity\t2500 mAh", Some(2.5), None),
            ("Ambient Temperature: -10 °C", None, Some(-10.0)),
            ("Temperature;25", None, Some(25.0)),
            // A number that requires a unit, without one; EC-Lab's empty entry; a measured
            // capacity.
            ("Nominal Capacity,3000", None, None),
            ("Battery capacity : 0,000 A.h", None, None),
            ("Discharge Capacity: 2.9 Ah", None, None),
            ("Temperature: 298.15 K", None, None),
            ("a line", None, None),
        ] {
            let head = read(&["Test,1", line]);
            assert_eq!(
                head.capacity_ah.map(|fact| fact.value),
                capacity_ah,
                "{line}"
            );
            assert_eq!(
                head.temperature_degc.map(|fact| fact.value),
                temperature_degc,
                "{line}"
            );
            let lines = [head.capacity_ah, head.temperature_degc];
            assert!(lines.iter().flatten().all(|fact| fact.line == 2));
        }
    }
}
