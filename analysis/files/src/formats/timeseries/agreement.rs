//! Holds columns against each other: the time against a wall clock, and charge that was counted by the
//! cycler against the integral of the current. A ratio of 60, 1000 or 3600 is a wrong unit: it settles
//! a unit that is not written, and refuses one that is.

use super::error::SeriesReadError;
use super::raw::{Quantity, Raw};
use std::path::Path;

/// Ratios of units that are taken for each other: ms, min, h, days.
const FACTORS: [f64; 4] = [1.0e3, 60.0, 3600.0, 86_400.0];
/// Deviation from such a ratio that counts as it. Clocks of a second, and sums over coarse rows, are
/// off by less; the nearest other ratios are 100 times as far away.
const NEAR: f64 = 0.03;
/// Shortest span of a wall clock that is compared, s: clocks of a second are then known to 3 %.
const SHORTEST_S: f64 = 60.0;
/// Fewest rows of counted charge that are compared.
const FEWEST: usize = 10;
/// Part by which the current may change between two rows whose charge is compared.
const STEADY: f64 = 0.1;
/// Voltage beyond which a number without a unit is no voltage of a pack, V.
const GREATEST_V: f64 = 1000.0;

/// Charge that a cycler counts.
pub(super) const COUNTED: [Quantity; 3] = [
    Quantity::ChargeAh,
    Quantity::DischargeAh,
    Quantity::Capacity,
];

/// Names of the columns whose unit is not written.
#[derive(Debug, Default)]
pub(super) struct Open {
    pub(super) time: Option<String>,
    pub(super) voltage: Option<String>,
    pub(super) current: Option<String>,
    /// True for Maccor, whose plain times are minutes or seconds by a setting.
    pub(super) maccor: bool,
    /// True where the unit of a counted charge is written.
    pub(super) capacity: bool,
}

/// Compares the columns, and settles units that are not written.
///
/// # Errors
/// Columns that contradict each other; a unit that nothing tells.
pub(super) fn settle(path: &Path, raw: &mut Raw, open: &Open) -> Result<(), SeriesReadError> {
    let refused = |raw: &Raw, met: String| SeriesReadError::Contradiction {
        file: path.to_owned(),
        line: raw.line(raw.len().saturating_sub(1)),
        met,
    };
    let mut time = open.time.as_deref();
    if let Some((ratio, [clock_s, time_s])) = of_wall(raw) {
        match time.take() {
            Some(name) if ratio != 1.0 => {
                raw.scale(Quantity::Time, ratio);
                raw.notes.push(format!(
                    "column \"{name}\" has no unit; the wall clock beside it tells that it counts \
                     {ratio} s"
                ));
            }
            None if ratio != 1.0 => {
                return Err(refused(
                    raw,
                    format!(
                        "a time that goes on by {time_s} s while the wall clock beside it goes on by \
                         {clock_s} s, a factor of {ratio}: the unit of the time is wrong; correct the \
                         name of its column"
                    ),
                ));
            }
            _ => {}
        }
    }
    let mut current = open.current.as_deref();
    if let Some((ratio, [counted_ah, integral_ah])) = of_charge(raw).filter(|_| open.capacity) {
        match (time.take(), current.take()) {
            _ if ratio == 1.0 => {}
            (Some(name), _) => {
                raw.scale(Quantity::Time, ratio);
                raw.notes.push(format!(
                    "column \"{name}\" has no unit; the charge beside it tells that it counts {ratio} s"
                ));
            }
            (None, Some(name)) => {
                raw.scale(Quantity::Current, ratio);
                raw.notes.push(format!(
                    "column \"{name}\" has no unit; the charge beside it tells that it counts {ratio} A"
                ));
            }
            (None, None) => {
                return Err(refused(
                    raw,
                    format!(
                        "{counted_ah:.4} Ah counted where the current over time is {integral_ah:.4} \
                         Ah, a factor of {ratio}: the unit of the current, the time or the charge is \
                         wrong; correct the name of the column"
                    ),
                ));
            }
        }
    }
    if let Some(name) = time.filter(|_| open.maccor) {
        return Err(refused(
            raw,
            format!(
                "\"{name}\" without a unit, which Maccor writes in minutes or in seconds, and no wall \
                 clock nor counted charge that tells which; write the unit into its name, as \"{name} \
                 (Min)\" or \"{name} (Sec)\""
            ),
        ));
    }
    if let Some(name) = open.voltage.as_deref() {
        let beyond = raw
            .get(Quantity::Voltage)
            .iter()
            .filter(|v| v.abs() > GREATEST_V)
            .count();
        if 2 * beyond > raw.len() {
            let met = format!(
                "\"{name}\" without a unit and beyond {GREATEST_V} V; write the unit into its name, as \
                 \"{name} (mV)\""
            );
            return Err(refused(raw, met));
        }
    }
    let plain = [(time, "s"), (open.voltage.as_deref(), "V"), (current, "A")];
    let told: Vec<String> = plain
        .into_iter()
        .filter_map(|(name, unit)| name.map(|name| format!("\"{name}\" in {unit}")))
        .collect();
    if !told.is_empty() {
        let told = told.join(", ");
        raw.notes
            .push(format!("columns without a unit are taken as usual: {told}"));
    }
    Ok(())
}

/// Factor of units by which the wall clock goes faster than the time, and both spans, s; none where
/// they cannot be compared.
fn of_wall(raw: &Raw) -> Option<(f64, [f64; 2])> {
    let pairs = raw.get(Quantity::Time).iter().zip(raw.get(Quantity::Wall));
    let known: Vec<(f64, f64)> = pairs
        .filter(|(_, wall)| wall.is_finite())
        .map(|(time, wall)| (*time, *wall))
        .collect();
    let span = |from: usize, to: usize| {
        let ((t0, w0), (t1, w1)) = (*known.get(from)?, *known.get(to)?);
        (t1 > t0 && w1 > w0).then_some((w1 - w0, t1 - t0))
    };
    let last = known.len().checked_sub(1)?;
    let (wall_s, time_s) = span(0, last).filter(|(wall_s, _)| *wall_s >= SHORTEST_S)?;
    let factor = factor(wall_s / time_s)?;
    // A pause of the test makes the whole slower, and one part only.
    let halves = [span(0, last / 2)?, span(last / 2, last)?];
    let alike = |(wall_s, time_s): &(f64, f64)| (wall_s / time_s / factor - 1.0).abs() < 3.0 * NEAR;
    halves
        .iter()
        .all(alike)
        .then_some((factor, [wall_s, time_s]))
}

/// Factor of units by which counted charge is larger than that of the current, and both, Ah.
fn of_charge(raw: &Raw) -> Option<(f64, [f64; 2])> {
    let (time, current) = (raw.get(Quantity::Time), raw.get(Quantity::Current));
    let (mut counted, mut integral, mut rows) = (0.0, 0.0, 0);
    for quantity in COUNTED {
        for (k, pair) in raw.get(quantity).windows(2).enumerate() {
            let grown = pair[1] - pair[0];
            let mean = 0.5 * (current[k].abs() + current[k + 1].abs());
            // Where it starts again or the current steps the row tells nothing.
            let steady = (current[k + 1] - current[k]).abs() < STEADY * mean;
            if grown > 0.0 && steady {
                counted += grown;
                integral += mean * (time[k + 1] - time[k]) / 3600.0;
                rows += 1;
            }
        }
    }
    let enough = rows >= FEWEST && integral > 0.0;
    let ratio = enough.then(|| factor(counted / integral)).flatten()?;
    // Days are no unit of it.
    (1.0 / 3600.0..=3600.0)
        .contains(&ratio)
        .then_some((ratio, [counted, integral]))
}

/// The factor of units that a ratio is; none for any other ratio.
fn factor(ratio: f64) -> Option<f64> {
    let all = FACTORS.iter().flat_map(|factor| [*factor, 1.0 / factor]);
    let mut known = std::iter::once(1.0).chain(all);
    known.find(|factor| (ratio / factor - 1.0).abs() < NEAR)
}
