//! Direction of the current: all readers use this function to make discharge positive.
//!
//! Order of precedence: the direction that the user states; words and counted charge beside the
//! current (State, Step Type, charge and discharge capacity) and the voltage ([`super::evidence`]),
//! which must agree; and only if these give no direction, the name of a file whose currents have one
//! sign, and the convention of the file's program.

use super::evidence::{self, Load, REST_PART};
use super::parts::CurrentSign;
use super::raw::{Quantity, Raw};

/// Fraction of the weight that may contradict the rest: single rows are noisy, or late by one.
const ODD_PART: f64 = 0.1;
/// Number of loads of which at least one is significant if the currents are more than noise.
const FEWEST_SURE: usize = 5;

/// Information besides the columns.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Known {
    /// The direction that the user states as positive.
    pub(super) stated: Option<CurrentSign>,
    /// The direction of the record from the file's name.
    pub(super) named: Option<CurrentSign>,
}

/// Reason why no direction was found.
#[derive(Debug, PartialEq)]
pub(super) enum Fault {
    /// No evidence; the rows that leave it undetermined, or an empty text.
    Unknown(String),
    /// Contradicting evidence: row from 0, and both statements.
    Contradiction(usize, String),
}

/// Weight of the evidence for each direction that the file may count positive.
#[derive(Debug, Clone, Copy, Default)]
struct Votes {
    charge: f64,
    discharge: f64,
    /// First row with evidence for either.
    rows: [Option<usize>; 2],
}

impl Votes {
    fn add(&mut self, sign: CurrentSign, row: usize, weight: f64) {
        let place = usize::from(sign == CurrentSign::Discharge);
        *(if place == 0 {
            &mut self.charge
        } else {
            &mut self.discharge
        }) += weight;
        self.rows[place].get_or_insert(row);
    }

    /// Returns the direction; an error if both have significant weight.
    fn winner(&self) -> Result<Option<CurrentSign>, [usize; 2]> {
        let all = self.charge + self.discharge;
        if let [Some(charge), Some(discharge)] = self.rows
            && self.charge.min(self.discharge) > ODD_PART * all
        {
            return Err([charge, discharge]);
        }
        Ok(match all {
            0.0 => None,
            _ if self.charge > self.discharge => Some(CurrentSign::Charge),
            _ => Some(CurrentSign::Discharge),
        })
    }

    /// Returns the first row of a direction.
    fn row(&self, sign: CurrentSign) -> usize {
        self.rows[usize::from(sign == CurrentSign::Discharge)].unwrap_or(0)
    }
}

/// Returns the currents of a record, A, discharge positive; adds remarks to the record.
///
/// # Errors
/// [`Fault`]
pub(super) fn discharge_positive(raw: &mut Raw, known: Known) -> Result<Vec<f64>, Fault> {
    let current = raw.get(Quantity::Current);
    let most = current.iter().fold(0.0_f64, |most, a| most.max(a.abs()));
    let beyond = |sign: f64| current.iter().any(|a| sign * a > REST_PART * most);
    let both = beyond(1.0) && beyond(-1.0);
    let turned = |sign| signed(raw, sign);
    if most == 0.0 {
        return Ok(turned(CurrentSign::Charge));
    }
    let words = words(raw);
    let loads = evidence::loads(raw);
    if both {
        let (positive, note) = by_columns(raw, known, &by_words(raw, &words), &by_volts(&loads))?;
        let currents = turned(positive);
        raw.notes.extend(note);
        return Ok(currents);
    }
    let has = |direction: f64| words.contains(&direction);
    if has(1.0) && has(-1.0) {
        return magnitudes_by_words(raw, &words, &loads, known);
    }
    let (voted_words, voted_volts) = (by_words(raw, &words), by_volts(&loads));
    match voted_volts.winner() {
        Err([a, b]) if known.stated.is_none() && voted_words.rows == [None; 2] => {
            magnitudes_by_volts(raw, &loads, [a, b])
        }
        Err(_) if voted_words.rows == [None; 2] => {
            Ok(turned(known.stated.unwrap_or(CurrentSign::Charge)))
        }
        _ => {
            let none = known.stated.is_none()
                && voted_words.rows == [None; 2]
                && voted_volts.rows == [None; 2];
            let (positive, note) = if none {
                by_custom(raw, known, beyond(1.0))?
            } else {
                by_columns(raw, known, &voted_words, &voted_volts)?
            };
            let currents = turned(positive);
            raw.notes.extend(note);
            Ok(currents)
        }
    }
}

/// Returns the currents if the file counts this direction positive.
fn signed(raw: &Raw, positive: CurrentSign) -> Vec<f64> {
    let factor = if positive == CurrentSign::Discharge {
        1.0
    } else {
        -1.0
    };
    raw.get(Quantity::Current)
        .iter()
        .map(|a| factor * a)
        .collect()
}

/// Returns the direction of each row from its word, or from the counted charge that grows: 1 for
/// discharge, −1 for charge.
fn words(raw: &Raw) -> Vec<f64> {
    let state = raw.get(Quantity::State);
    if !state.is_empty() {
        return state.to_vec();
    }
    let (charge, discharge) = (raw.get(Quantity::ChargeAh), raw.get(Quantity::DischargeAh));
    if charge.len() != raw.len() || discharge.len() != raw.len() {
        return vec![f64::NAN; raw.len()];
    }
    let grown = |all: &[f64], k: usize| k > 0 && all[k] > all[k - 1];
    let of = |k: usize| match (grown(charge, k), grown(discharge, k)) {
        (true, false) => -1.0,
        (false, true) => 1.0,
        _ => f64::NAN,
    };
    (0..raw.len()).map(of).collect()
}

/// Returns the evidence of words for the positive direction.
fn by_words(raw: &Raw, words: &[f64]) -> Votes {
    let current = raw.get(Quantity::Current);
    let most = current.iter().fold(0.0_f64, |most, a| most.max(a.abs()));
    let mut votes = Votes::default();
    for (row, (amps, word)) in current.iter().zip(words).enumerate() {
        if amps.abs() > REST_PART * most && word.abs() == 1.0 {
            let discharge = amps * word > 0.0;
            votes.add(
                if discharge {
                    CurrentSign::Discharge
                } else {
                    CurrentSign::Charge
                },
                row,
                1.0,
            );
        }
    }
    votes
}

/// Returns the evidence of the voltage for the positive direction. If few loads are significant and
/// these contradict each other, as with the noise of a rest, there is no evidence.
fn by_volts(loads: &[Load]) -> Votes {
    let votes = volts(loads);
    let sure = loads.iter().filter(|load| load.rise != 0.0).count();
    if votes.winner().is_err() && FEWEST_SURE * sure < loads.len() {
        return Votes::default();
    }
    votes
}

fn volts(loads: &[Load]) -> Votes {
    let mut votes = Votes::default();
    for load in loads.iter().filter(|load| load.rise != 0.0) {
        let charge = (load.rise > 0.0) == load.positive;
        let sign = if charge {
            CurrentSign::Charge
        } else {
            CurrentSign::Discharge
        };
        votes.add(
            sign,
            load.rows.start,
            (load.volts[1] - load.volts[0]).abs().max(f64::MIN_POSITIVE),
        );
    }
    votes
}

/// Returns the positive direction from the columns beside the current, and a remark.
fn by_columns(
    raw: &Raw,
    known: Known,
    words: &Votes,
    volts: &Votes,
) -> Result<(CurrentSign, Option<String>), Fault> {
    let row = |row: usize| described(raw, row);
    let split = |[a, b]: [usize; 2], what: &str| {
        let met = format!(
            "{what} that says charge is positive by {}, and discharge is positive by {}; state which \
             with --positive (Python: sign=, dataset.toml: current_positive)",
            row(a),
            row(b)
        );
        Fault::Contradiction(a.max(b), met)
    };
    if let Some(stated) = known.stated {
        let against = [
            (words, "its words or counted charge"),
            (volts, "its voltage"),
        ]
        .into_iter()
        .find_map(|(votes, what)| {
            let winner = votes.winner().ok()??;
            (winner != stated).then(|| (what, votes.row(winner)))
        });
        let note = against.map(|(what, at)| {
            format!(
                "the direction stated, {} positive, goes against {what} ({}): check it",
                word(stated),
                row(at)
            )
        });
        return Ok((stated, note));
    }
    let by_words = words
        .winner()
        .map_err(|rows| split(rows, "a column (State, Step Type or counted charge)"))?;
    let by_volts = volts.winner().map_err(|rows| split(rows, "a voltage"))?;
    match (by_words, by_volts) {
        (Some(words_say), Some(volts_say)) if words_say != volts_say => {
            let at = words.row(words_say);
            let met = format!(
                "a word or counted charge by which {} is positive ({}), and a voltage by which {} is \
                 ({}); state which with --positive (Python: sign=, dataset.toml: current_positive)",
                word(words_say),
                row(at),
                word(volts_say),
                row(volts.row(volts_say))
            );
            Err(Fault::Contradiction(at, met))
        }
        (Some(positive), _) | (None, Some(positive)) => {
            let odd = positive == CurrentSign::Discharge && raw.charge_positive;
            let at = if by_words.is_some() { words.row(positive) } else { volts.row(positive) };
            let note = odd.then(|| format!("its currents count discharge positive, as {} shows", row(at)));
            Ok((positive, note))
        }
        (None, None) => Ok((
            CurrentSign::Charge,
            Some(
                "its currents are taken charge positive, as cyclers write them: the voltage does not \
                 tell"
                    .to_owned(),
            ),
        )),
    }
}

/// Returns the positive direction of currents of one sign without evidence in other columns.
fn by_custom(
    raw: &Raw,
    known: Known,
    positive: bool,
) -> Result<(CurrentSign, Option<String>), Fault> {
    let note = |what: &str| {
        Some(format!(
            "the direction of its currents is taken from {what}"
        ))
    };
    match known.named {
        // A minus sign shows that the file has a sign convention; use that of cyclers.
        _ if !positive && raw.charge_positive => Ok((CurrentSign::Charge, None)),
        _ if !positive => Ok((CurrentSign::Charge, note("their minus sign: a discharge"))),
        Some(named) => Ok((named, note("the file's name"))),
        None if raw.charge_positive => Ok((CurrentSign::Charge, note("its format: a charge"))),
        None => Err(Fault::Unknown(String::new())),
    }
}

/// Returns signed currents from magnitudes and the word of each row.
fn magnitudes_by_words(
    raw: &mut Raw,
    words: &[f64],
    loads: &[Load],
    known: Known,
) -> Result<Vec<f64>, Fault> {
    for load in loads.iter().filter(|load| load.rise != 0.0 && !load.torn) {
        let of_load = &words[load.rows.clone()];
        let against = of_load
            .iter()
            .filter(|word| **word * load.rise > 0.0)
            .count();
        if 2 * against > of_load.len() {
            let [before, within] = load.volts;
            let at = load.rows.start;
            let met = format!(
                "a word or counted charge that says {} in {} while the voltage goes from {before} V to \
                 {within} V",
                if load.rise > 0.0 {
                    "discharge"
                } else {
                    "charge"
                },
                described(raw, at)
            );
            return Err(Fault::Contradiction(at, met));
        }
    }
    let mut last = 0.0;
    let current = raw
        .get(Quantity::Current)
        .iter()
        .zip(words)
        .map(|(amps, word)| {
            // A row between two steps belongs to the previous one.
            if word.abs() == 1.0 {
                last = *word;
            }
            if last == 0.0 {
                0.0 - amps
            } else {
                last * amps.abs()
            }
        });
    let current = current.collect();
    if known.stated.is_some() {
        let note = "its currents are magnitudes, whose direction a column gives: the direction stated \
                    is not used";
        raw.notes.push(note.to_owned());
    }
    Ok(current)
}

/// Returns signed currents from magnitudes and the voltage of each load.
fn magnitudes_by_volts(raw: &mut Raw, loads: &[Load], rows: [usize; 2]) -> Result<Vec<f64>, Fault> {
    if let Some(open) = loads.iter().find(|load| load.rise == 0.0 || load.torn) {
        let [a, b] = rows.map(|row| described(raw, row));
        return Err(Fault::Unknown(format!(
            ": the voltage falls or rises in {a} and goes the other way in {b}, and is not clear in {}",
            described(raw, open.rows.start)
        )));
    }
    let mut currents: Vec<f64> = raw.get(Quantity::Current).to_vec();
    for load in loads {
        for amps in &mut currents[load.rows.clone()] {
            *amps = if load.rise > 0.0 {
                -amps.abs()
            } else {
                amps.abs()
            };
        }
    }
    raw.notes.push(format!(
        "its currents are magnitudes; the voltage determines the direction of each of {} loads",
        loads.len()
    ));
    Ok(currents)
}

fn word(sign: CurrentSign) -> &'static str {
    match sign {
        CurrentSign::Charge => "charge",
        CurrentSign::Discharge => "discharge",
    }
}

/// Describes a row.
fn described(raw: &Raw, row: usize) -> String {
    let at = |quantity| raw.get(quantity).get(row).copied().unwrap_or(f64::NAN);
    format!(
        "line {} ({} s, {} A, {} V)",
        raw.line(row),
        at(Quantity::Time),
        at(Quantity::Current),
        at(Quantity::Voltage)
    )
}
