//! A fitted circuit as an extended Randles model: resistances and RC branches that follow its
//! impedance over a band, with a stated error.
//!
//! Blocks of the circuit in series are taken one by one. R, K and p(R,C) are parts of an ERM as
//! they are. Everything else but the blocks below is followed together by a ladder: branches with
//! time constants equally spaced in the logarithm, resistances by least squares of the relative
//! error under the condition that none is negative; then all of them move to the bottom of the same
//! squares. Their density grows until the worst error in the band is below [`TARGET`].
//!
//! * A block that only delays (its reactance is positive over the whole band: an inductance, alone
//!   or beside a resistance) is left out, with its size.
//! * A block that stores charge (C, Wo, H, a pore of ideal capacitance) has no DC resistance. Its
//!   capacitance is the slope of the open-circuit voltage over the charge and is left to the OCV;
//!   the ladder follows the rest of the block, as tanh and coth do without their pole.
//! * A block whose impedance grows without end and stores no charge (W, a CPE) is followed down to
//!   the lower end of the band. 1/(2πf) there is the horizon: whatever lasts longer meets too
//!   little resistance.

mod blocks;
mod polish;
mod rows;
mod solve;

use super::error::{LadderError, REFUSED};
use analysis_model::model::{Circuit, Erm};
use analysis_numeric::significant::format_significant;
use blocks::{Blocking, Blocks};
use num_complex::Complex64;
use serde::{Deserialize, Serialize};
pub use solve::TARGET;
use solve::{Problem, best_ladder};
use std::f64::consts::TAU;
use std::ops::RangeInclusive;

/// Factor by which the band of the ladder reaches beyond that of the data: steps and their first
/// instants lie above it, slow loads below.
const WIDER: f64 = 10.0;
/// A DC resistance of the ladder that differs from the circuit's by less counts as the same.
const SAME_DC: f64 = TARGET;

/// Report on an ERM that follows a circuit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ladder {
    /// The circuit's string.
    pub circuit: String,
    /// Its parameters, in the order of the string and in their units.
    pub values: Vec<f64>,
    /// Band of the data that the circuit was fitted to, Hz; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data_band_hz: Option<(f64, f64)>,
    /// Band in which the ladder follows the circuit, Hz.
    pub band_hz: (f64, f64),
    /// Largest |Z_ladder − Z_circuit|/|Z_circuit| in the band, without the blocks left out. Zero
    /// for a circuit that is an ERM.
    pub worst_relative_error: f64,
    /// Frequency of that error, Hz.
    pub worst_at_hz: f64,
    /// DC resistance of the circuit, without the blocks left out, Ω; `None` if it grows without
    /// limit.
    pub dc_resistance_ohm: Option<f64>,
    /// Time beyond which the ladder lacks resistance, s; none for a circuit with a DC resistance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub horizon_s: Option<f64>,
    /// Capacitance in series that is left to the open-circuit voltage, F.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub storage_f: Option<f64>,
    /// Inductive blocks.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
}

/// A block that the ladder has not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeftOut {
    /// The block as written.
    pub block: String,
    /// Frequency at which it is largest, Hz: the upper end of the data's band.
    pub freq_hz: f64,
    /// Its impedance there, Ω: volts per ampere.
    pub impedance_ohm: f64,
    /// The circuit's whole impedance there, Ω.
    pub of_ohm: f64,
}

/// The ERM that follows a circuit.
#[derive(Debug, Clone, PartialEq)]
pub struct Followed {
    /// Resistance and branches, by rising time constant.
    pub erm: Erm,
    /// Report on its error and on the parts left out.
    pub ladder: Ladder,
    /// Logarithms of the ERM's parameters by logarithms of the circuit's, row by row; none for a
    /// ladder that was fitted.
    pub log_jacobian: Option<Vec<Vec<f64>>>,
}

/// Bands in which the ladder follows a circuit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bands {
    /// Band of the data, Hz, if known.
    pub data_hz: Option<(f64, f64)>,
    /// Requested band, Hz; otherwise that of the data, a decade wider on each side.
    pub asked_hz: Option<(f64, f64)>,
}

impl Bands {
    /// Band to follow, and frequency at which the impedance of the blocks left out is stated.
    fn resolve(self) -> Result<((f64, f64), f64), LadderError> {
        let check =
            |name, (low, high): (f64, f64)| match low > 0.0 && low <= high && high.is_finite() {
                true => Ok((low, high)),
                false => Err(LadderError::Band { name, low, high }),
            };
        let data = self
            .data_hz
            .map(|band| check("band_hz of the circuit", band))
            .transpose()?;
        match (self.asked_hz, data) {
            (Some(asked), _) => check("band of the ladder", asked)
                .map(|band| (band, data.map_or(band.1, |data| data.1))),
            (None, Some((low, high))) => Ok(((low / WIDER, high * WIDER), high)),
            (None, None) => Err(LadderError::NoBand),
        }
    }
}

/// Returns the ERM that follows a circuit with these values.
///
/// # Errors
/// [`LadderError`] for values that are not those of a passive circuit, an invalid band, and a
/// circuit that no RC ladder follows.
pub fn follow(circuit: &Circuit, values: &[f64], bands: Bands) -> Result<Followed, LadderError> {
    let (band_hz, stated_hz) = bands.resolve()?;
    check_values(circuit, values)?;
    let omega = TAU * band_hz.0..=TAU * band_hz.1;
    let blocks = Blocks::of(circuit, values, &omega);
    let total = |freq_hz: f64| circuit.root().impedance(values, TAU * freq_hz);
    let left_out = blocks.inductive.iter().map(|node| LeftOut {
        block: node.to_string(),
        freq_hz: stated_hz,
        impedance_ohm: node.impedance(values, TAU * stated_hz).norm(),
        of_ohm: total(stated_hz).norm(),
    });
    let left_out: Vec<LeftOut> = left_out.collect();
    let blocking = blocks.blocking(values, *omega.start());
    let mut ladder = Ladder {
        circuit: circuit.to_string(),
        values: values.to_vec(),
        data_band_hz: bands.data_hz,
        band_hz,
        worst_relative_error: 0.0,
        worst_at_hz: band_hz.0,
        dc_resistance_ohm: None,
        horizon_s: blocking.grows.then(|| 1.0 / omega.start()),
        storage_f: None,
        left_out,
    };
    let (erm, elastance_per_f, log_jacobian) = if blocks.rest.is_empty() {
        let (erm, jacobian) = blocks.erm(values.len());
        (erm, 0.0, Some(jacobian))
    } else {
        let (erm, elastance) = fitted(&blocks, values, omega, blocking, &mut ladder)?;
        (erm, elastance, None)
    };
    if erm.r_ohm <= 0.0 {
        return Err(LadderError::NoSeriesResistance {
            circuit: circuit.to_string(),
        });
    }
    let elastance_per_f = elastance_per_f + blocks.elastance_per_f;
    ladder.storage_f = (elastance_per_f > 0.0).then(|| 1.0 / elastance_per_f);
    ladder.dc_resistance_ohm = (!blocking.grows).then(|| {
        blocks
            .dc_ohm(values)
            .unwrap_or_else(|| erm.dc_resistance_ohm())
    });
    erm.validate()?;
    Ok(Followed {
        erm,
        ladder,
        log_jacobian,
    })
}

/// Returns the blocks that are parts of an ERM, and a ladder for all others; with the inverse of
/// the capacitance in series.
fn fitted(
    blocks: &Blocks,
    values: &[f64],
    omega: RangeInclusive<f64>,
    blocking: Blocking,
    ladder: &mut Ladder,
) -> Result<(Erm, f64), LadderError> {
    let rest = |omega: f64| {
        blocks
            .rest
            .iter()
            .map(|node| node.impedance(values, omega))
            .sum::<Complex64>()
    };
    let beside = |omega: f64| blocks.exact(omega);
    let dc_ohm = if blocking.stores || blocking.grows {
        None
    } else {
        blocks.rest_dc_ohm(values)
    };
    let problem = Problem {
        rest: &rest,
        beside: &beside,
        omega,
        stores: blocking.stores,
        dc_ohm,
    };
    let names = || {
        blocks
            .rest
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join("-")
    };
    let met = best_ladder(&problem).ok_or_else(|| LadderError::Unsolved { blocks: names() })?;
    (ladder.worst_relative_error, ladder.worst_at_hz) = (met.worst, met.worst_omega / TAU);
    if met.worst > REFUSED {
        return Err(LadderError::NotPassive {
            blocks: names(),
            percent: 100.0 * met.worst,
            freq_hz: ladder.worst_at_hz,
        });
    }
    let branches = blocks
        .branches
        .iter()
        .map(|exact| exact.branch)
        .chain(met.branches)
        .collect();
    Ok((
        Erm {
            r_ohm: blocks.r_ohm + met.r_ohm,
            branches,
        }
        .ordered(),
        met.elastance_per_f,
    ))
}

/// Values that a passive circuit can have: as many as parameters, above zero, exponents up to 1.
fn check_values(circuit: &Circuit, values: &[f64]) -> Result<(), LadderError> {
    let (names, kinds) = (circuit.parameter_names(), circuit.parameter_kinds());
    if names.len() != values.len() {
        return Err(LadderError::Count {
            circuit: circuit.to_string(),
            expected: names.len(),
            met: values.len(),
        });
    }
    for ((name, kind), met) in names.iter().zip(kinds).zip(values) {
        let most = if kind.role == analysis_model::model::Role::Exponent {
            1.0
        } else {
            f64::MAX
        };
        if !(*met > 0.0 && *met <= most) {
            let expected = if most > 1.0 {
                "a finite number above 0"
            } else {
                "an exponent above 0 and up to 1"
            };
            return Err(LadderError::Value {
                name: name.clone(),
                unit: kind.unit,
                expected,
                met: *met,
            });
        }
    }
    Ok(())
}

impl Ladder {
    /// Warnings to the user of the ERM, in sentences.
    pub fn notes(&self, erm: &Erm) -> Vec<String> {
        let mut notes = vec![self.error_note(erm)];
        for l in &self.left_out {
            let (z, of) = (
                format_significant(1e3 * l.impedance_ohm, 3),
                format_significant(1e3 * l.of_ohm, 3),
            );
            let place = format!(
                "at {}, the upper end of the band, where |Z| is {of} mΩ",
                hertz(l.freq_hz)
            );
            notes.push(format!(
                "left out, because a ladder of RC has no inductance: {}, {z} mΩ (as many mV per \
            ampere) {place}",
                l.block
            ));
        }
        if let Some(storage_f) = self.storage_f {
            let v_per_ah = format_significant(3600.0 / storage_f, 3);
            notes.push(format!(
                "the circuit blocks a direct current: its capacitance in series, {} F ({v_per_ah} \
                V per Ah), is charge storage. The slope of an OCV curve represents it; a constant \
                voltage at rest omits it",
                format_significant(storage_f, 4)
            ));
        }
        let ladder_ohm = erm.dc_resistance_ohm();
        match (self.dc_resistance_ohm, self.horizon_s) {
            (None, Some(horizon_s)) => notes.push(format!(
                "the circuit has no DC resistance: it grows as long as a current flows. What flows \
                one way for longer than {} s meets too little; the \
                 ladder's DC resistance, {} mΩ, is its slowest branch's doing, and simple IR with \
                 it compares with nothing",
                format_significant(horizon_s, 3),
                format_significant(1e3 * ladder_ohm, 4)
            )),
            (Some(dc_ohm), _) if (ladder_ohm / dc_ohm - 1.0).abs() > SAME_DC => notes.push(format!(
                "DC resistance of the ladder {} mΩ, of the circuit {} mΩ: the rest lies below the \
                band",
                format_significant(1e3 * ladder_ohm, 4),
                format_significant(1e3 * dc_ohm, 4)
            )),
            _ => {}
        }
        notes.extend(self.slow_note(erm));
        notes
    }

    /// Note on the part of the DC resistance that is slower than the slowest point of the data.
    fn slow_note(&self, erm: &Erm) -> Option<String> {
        let slowest_s = 1.0 / (TAU * self.data_band_hz?.0);
        let slow_ohm: f64 = erm
            .branches
            .iter()
            .filter(|branch| branch.time_constant_s() > slowest_s)
            .map(|branch| branch.r_ohm)
            .sum();
        let dc_ohm = self
            .dc_resistance_ohm
            .filter(|dc_ohm| slow_ohm > SAME_DC * dc_ohm)?;
        Some(format!(
            "of the DC resistance of {} mΩ, {} mΩ lie in time constants beyond {} s, the slowest \
            that the data reach: there the circuit extrapolates",
            format_significant(1e3 * dc_ohm, 4),
            format_significant(1e3 * slow_ohm, 3),
            format_significant(slowest_s, 3)
        ))
    }

    fn error_note(&self, erm: &Erm) -> String {
        if self.worst_relative_error == 0.0 {
            return format!(
                "the circuit {} is an extended Randles model as it is: no ladder was needed",
                self.circuit
            );
        }
        let data = self.data_band_hz.map_or_else(String::new, |(low, high)| {
            format!(" (data {} to {})", hertz(low), hertz(high))
        });
        format!(
            "the circuit {} as a ladder of {} RC: off by at most {} % of |Z| (at {}) from {} to \
            {}{data}",
            self.circuit,
            erm.branches.len(),
            format_significant(100.0 * self.worst_relative_error, 2),
            hertz(self.worst_at_hz),
            hertz(self.band_hz.0),
            hertz(self.band_hz.1)
        )
    }
}

/// Formats a frequency.
fn hertz(freq_hz: f64) -> String {
    match freq_hz {
        f if f < 0.1 => format!("{} mHz", format_significant(1e3 * f, 3)),
        f if f < 1e3 => format!("{} Hz", format_significant(f, 3)),
        f => format!("{} kHz", format_significant(1e-3 * f, 3)),
    }
}

#[cfg(test)]
mod tests;
