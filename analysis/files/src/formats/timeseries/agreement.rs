//! Compares redundant columns: the time with a wall clock, and the charge counted by the cycler with
//! the integral of the current. A ratio of 60, 1000 or 3600 indicates a wrong unit: it determines a
//! unit that is not written, and refuses one that is.

use super::error::SeriesReadError;
use super::raw::{Quantity, Raw};
use std::path::Path;

/// Ratios of units that are commonly confused: ms, min, h, days.
const FACTORS: [f64; 4] = [1.0e3, 60.0, 3600.0, 86_400.0];
/// Tolerance of such a ratio. Clocks with a resolution of one second and sums over coarse rows
/// deviate by less; the nearest other ratios are 100 times as far away.
const NEAR: f64 = 0.03;
/// Minimum span of a wall clock for the comparison, s: the error of a clock with a resolution of
/// one second is then 3 %.
const SHORTEST_S: f64 = 60.0;
/// Minimum number of rows of counted charge for the comparison.
const FEWEST: usize = 10;
/// Maximum relative change of the current between two rows whose charge is compared.
const STEADY: f64 = 0.1;
/// Voltage above which a number without a unit cannot be in volts, V.
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
    /// Whether the file is Maccor's, whose plain times are minutes or seconds depending on a
    /// setting.
    pub(super) maccor: bool,
    /// Whether the unit of a counted charge is written.
    pub(super) capacity: bool,
}

/// Compares the columns, and determines units that are not written.
///
/// # Errors
/// Returns an error if columns contradict each other or a unit cannot be determined.
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
                    "column \"{name}\" has no unit; by the wall clock beside it, it counts \
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
                    "column \"{name}\" has no unit; by the charge beside it, it counts {ratio} s"
                ));
            }
            (None, Some(name)) => {
                raw.scale(Quantity::Current, ratio);
                raw.notes.push(format!(
                    "column \"{name}\" has no unit; by the charge beside it, it counts {ratio} A"
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
                 clock nor counted charge determines which; write the unit into its name, as \"{name} \
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
    let assumed: Vec<String> = plain
        .into_iter()
        .filter_map(|(name, unit)| name.map(|name| format!("\"{name}\" in {unit}")))
        .collect();
    if !assumed.is_empty() {
        let assumed = assumed.join(", ");
        raw.notes.push(format!(
            "columns without a unit are taken as usual: {assumed}"
        ));
    }
    Ok(())
}

/// Returns the factor of units by which the wall clock is faster than the time, and both spans, s;
/// `None` if they cannot be compared.
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
    // A pause of the test affects the total ratio, but only one part.
    let halves = [span(0, last / 2)?, span(last / 2, last)?];
    let alike = |(wall_s, time_s): &(f64, f64)| (wall_s / time_s / factor - 1.0).abs() < 3.0 * NEAR;
    halves
        .iter()
        .all(alike)
        .then_some((factor, [wall_s, time_s]))
}

/// Returns the factor of units by which the counted charge exceeds the integral of the current, and
/// both, Ah.
fn of_charge(raw: &Raw) -> Option<(f64, [f64; 2])> {
    let (time, current) = (raw.get(Quantity::Time), raw.get(Quantity::Current));
    let (mut counted, mut integral, mut rows) = (0.0, 0.0, 0);
    for quantity in COUNTED {
        for (k, pair) in raw.get(quantity).windows(2).enumerate() {
            let grown = pair[1] - pair[0];
            let mean = 0.5 * (current[k].abs() + current[k + 1].abs());
            // Skip rows where it restarts or the current steps.
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
    // Charge has no unit with days.
    (1.0 / 3600.0..=3600.0)
        .contains(&ratio)
        .then_some((ratio, [counted, integral]))
}

/// Returns the factor of units that matches a ratio; `None` for any other ratio.
fn factor(ratio: f64) -> Option<f64> {
    let all = FACTORS.iter().flat_map(|factor| [*factor, 1.0 / factor]);
    let mut known = std::iter::once(1.0).chain(all);
    known.find(|factor| (ratio / factor - 1.0).abs() < NEAR)
}
