//! A leg as data: a section of direct current through load or supply, or of rest, whose readings
//! are all stored in a file.

use std::{borrow::Cow, fmt};

use analysis_files::run_folder::{OCV_CHARGE, OCV_DISCHARGE, map_charge, map_discharge};

use instruments::units::{Amps, Coulombs, Seconds, Volts};

use super::minutes;
use crate::interlock::Limits;

/// A section of direct current or of rest that is recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leg {
    /// Current or power that flows.
    pub flow: Flow,
    /// Upper bound, s; a rest has this duration.
    pub max_s: Seconds,
    /// The file for its readings.
    pub log: Log,
}

/// Current or power that flows in a leg.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Flow {
    /// Out of the cell, by the load.
    Discharge {
        /// Current, A, positive.
        current_a: Amps,
        /// End, V under load.
        until_v: Volts,
        /// Charge after which it ends earlier, C.
        charge_coulomb: Option<Coulombs>,
    },
    /// Out of the cell, by the load, until its counted charge is at a target.
    DischargeTo {
        /// Current, A, positive.
        current_a: Amps,
        /// Earliest end, V under load.
        until_v: Volts,
        /// Charge below that of the full cell at which it ends, C.
        below_full_coulomb: Coulombs,
        /// The part of it that is expected to be left, C.
        expected_coulomb: Coulombs,
    },
    /// Into the cell, by the supply: constant current, then constant voltage.
    Charge {
        /// Current, A.
        current_a: Amps,
        /// Voltage that the supply holds, V.
        limit_v: Volts,
        /// Current at which it ends, A.
        cut_off_a: Amps,
        /// Charge after which it ends earlier, C.
        charge_coulomb: Option<Coulombs>,
    },
    /// No current.
    Rest,
}

/// The files for the readings of legs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Log {
    /// The discharge direction.
    Discharge,
    /// The charge direction.
    Charge,
    /// The full charge before a point of a map.
    MapCharge(usize),
    /// The discharge to a point of a map.
    MapDischarge(usize),
}

impl Log {
    /// Returns the name of the file in the run folder.
    pub fn file(self) -> Cow<'static, str> {
        match self {
            Self::Discharge => OCV_DISCHARGE.into(),
            Self::Charge => OCV_CHARGE.into(),
            Self::MapCharge(point) => map_charge(point).into(),
            Self::MapDischarge(point) => map_discharge(point).into(),
        }
    }
}

impl Leg {
    /// Returns the greatest requested currents into and out of the cell, A.
    pub fn most_a(&self) -> (Amps, Amps) {
        match self.flow {
            Flow::Discharge { current_a, .. } | Flow::DischargeTo { current_a, .. } => {
                (Amps::ZERO, current_a)
            }
            Flow::Charge { current_a, .. } => (current_a, Amps::ZERO),
            Flow::Rest => (Amps::ZERO, Amps::ZERO),
        }
    }

    /// Returns the expected duration, s: from the charge if one is given.
    pub(super) fn expected_s(&self) -> Seconds {
        match self.flow {
            Flow::Discharge {
                current_a,
                charge_coulomb: Some(charge_coulomb),
                ..
            }
            | Flow::Charge {
                current_a,
                charge_coulomb: Some(charge_coulomb),
                ..
            } => (charge_coulomb / current_a).min(self.max_s),
            Flow::DischargeTo {
                current_a,
                expected_coulomb,
                ..
            } => (expected_coulomb / current_a).min(self.max_s),
            Flow::Discharge { .. } | Flow::Charge { .. } => 0.2 * self.max_s,
            Flow::Rest => self.max_s,
        }
    }

    /// Returns an error if the leg could exceed the limits of the cell.
    pub(super) fn check(&self, limits: &Limits) -> Result<(), String> {
        let window = |volts: Volts, what: &str| limits.check_voltage(volts, what);
        match self.flow {
            Flow::Discharge {
                current_a, until_v, ..
            }
            | Flow::DischargeTo {
                current_a, until_v, ..
            } => {
                Limits::check_current(current_a, limits.discharge_a, "discharge current")?;
                window(until_v, "the end of the discharge")
            }
            Flow::Charge {
                current_a,
                limit_v,
                cut_off_a,
                ..
            } => {
                Limits::check_current(current_a, limits.charge_a, "charge current")?;
                window(limit_v, "the limit of the supply")?;
                let falls = cut_off_a > Amps::ZERO && cut_off_a < current_a;
                falls.then_some(()).ok_or_else(|| {
                    format!(
                        "expected a cut-off current above 0 A, \
                below {current_a}, found {cut_off_a}"
                    )
                })
            }
            Flow::Rest => Ok(()),
        }
    }
}

impl fmt::Display for Leg {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let part = |charge_coulomb: Option<Coulombs>| {
            charge_coulomb.map_or_else(String::new, |charge_coulomb| {
                format!(" or by {charge_coulomb:.0}")
            })
        };
        let (bound, file) = (minutes(self.max_s), self.log.file());
        match self.flow {
            Flow::Discharge {
                current_a,
                until_v,
                charge_coulomb,
            } => {
                write!(
                    f,
                    "discharge at {current_a} to {until_v}{}, at most {bound}, into {file}",
                    part(charge_coulomb)
                )
            }
            Flow::DischargeTo {
                current_a,
                until_v,
                below_full_coulomb,
                ..
            } => {
                write!(
                    f,
                    "discharge at {current_a} to {below_full_coulomb:.0} below full or to \
                    {until_v}, at most {bound}, into {file}"
                )
            }
            Flow::Charge {
                current_a,
                limit_v,
                cut_off_a,
                charge_coulomb,
            } => {
                write!(
                    f,
                    "charge at {current_a}, hold {limit_v} until {cut_off_a}{}, at most \
                    {bound}, into {file}",
                    part(charge_coulomb)
                )
            }
            Flow::Rest => write!(f, "nothing flows for {bound}, into {file}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use instruments::units::Celsius;

    const LIMITS: Limits = Limits {
        min_v: Volts(2.5),
        max_v: Volts(4.2),
        charge_a: Amps(13.5),
        discharge_a: Amps(45.0),
        min_degc: Celsius(0.0),
        max_degc: Celsius(60.0),
    };

    #[test]
    fn a_leg_within_the_limits_passes_and_each_other_is_refused_in_words() {
        let down = |current_a, until_v| Flow::Discharge {
            current_a,
            until_v,
            charge_coulomb: Some(Coulombs(1.0)),
        };
        let up = |current_a, limit_v, cut_off_a| Flow::Charge {
            current_a,
            limit_v,
            cut_off_a,
            charge_coulomb: None,
        };
        let to = |current_a, until_v| Flow::DischargeTo {
            current_a,
            until_v,
            below_full_coulomb: Coulombs(8100.0),
            expected_coulomb: Coulombs(6480.0),
        };
        let cases = [
            (to(Amps(4.5), Volts(2.55)), ""),
            (
                to(Amps(50.0), Volts(2.55)),
                "expected a discharge current above 0 A, at most 45 A, found 50 A",
            ),
            (
                to(Amps(4.5), Volts(2.4)),
                "expected the end of the discharge within 2.5 V to 4.2 V, found 2.4 V",
            ),
            (down(Amps(1.0), Volts(2.505)), ""),
            (up(Amps(1.0), Volts(4.195), Amps(0.1)), ""),
            (Flow::Rest, ""),
            (
                down(Amps(50.0), Volts(2.5)),
                "expected a discharge current above 0 A, at most 45 A, found 50 A",
            ),
            (
                down(Amps(1.0), Volts(2.4)),
                "expected the end of the discharge within 2.5 V to 4.2 V, found 2.4 V",
            ),
            (
                up(Amps(14.0), Volts(4.2), Amps(0.1)),
                "expected a charge current above 0 A, at most 13.5 A, found 14 A",
            ),
            (
                up(Amps(1.0), Volts(4.21), Amps(0.1)),
                "expected the limit of the supply within 2.5 V to 4.2 V, found 4.21 V",
            ),
            (
                up(Amps(1.0), Volts(4.2), Amps(1.0)),
                "expected a cut-off current above 0 A, below 1 A, found 1 A",
            ),
        ];
        for (flow, text) in cases {
            let leg = Leg {
                flow,
                max_s: Seconds(60.0),
                log: Log::Charge,
            };
            assert_eq!(leg.check(&LIMITS).err().unwrap_or_default(), text, "{leg}");
        }
    }
}
