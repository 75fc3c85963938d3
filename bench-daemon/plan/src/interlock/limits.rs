//! The limits of one reading, and the trip that ends a run.

use std::ops::RangeInclusive;

use instruments::units::{Amps, Celsius, Seconds, Unit, Volts};

use super::{bath::BathFault, thermometers::ThermometerFault};

/// Limits of a cell.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Limits {
    /// Least voltage, V.
    pub min_v: Volts,
    /// Greatest voltage, V.
    pub max_v: Volts,
    /// Greatest charge current, A.
    pub charge_a: Amps,
    /// Greatest discharge current, A, positive.
    pub discharge_a: Amps,
    /// Least surface temperature, °C.
    #[serde(rename = "min_c")]
    pub min_degc: Celsius,
    /// Greatest surface temperature, °C.
    #[serde(rename = "max_c")]
    pub max_degc: Celsius,
}

impl Limits {
    /// Refuses a current that is not above zero or exceeds its limit.
    pub(crate) fn check_current(amps: Amps, limit: Amps, what: &str) -> Result<(), String> {
        let fits = amps > Amps::ZERO && amps <= limit;
        fits.then_some(())
            .ok_or_else(|| format!("expected a {what} above 0 A, at most {limit}, found {amps}"))
    }

    /// Refuses a voltage outside the limits of the cell.
    pub(crate) fn check_voltage(&self, volts: Volts, what: &str) -> Result<(), String> {
        let (least, greatest) = (self.min_v, self.max_v);
        let fits = (least..=greatest).contains(&volts);
        fits.then_some(())
            .ok_or_else(|| format!("expected {what} within {least} to {greatest}, found {volts}"))
    }

    /// Returns the limits with reduced currents, A: the smaller value of each applies.
    #[must_use]
    pub fn bounded(self, charge_a: Amps, discharge_a: Amps) -> Self {
        Self {
            charge_a: self.charge_a.min(charge_a),
            discharge_a: self.discharge_a.min(discharge_a),
            ..self
        }
    }

    /// Returns the limits for a control in the place of the cell. Copper has no voltage, and a
    /// cell in its place would exceed this limit. The thermocouple stays on the cell, which lies
    /// beside the jig and may have any low temperature.
    #[must_use]
    pub fn of_control(self) -> Self {
        Self {
            min_v: -CONTROL_V,
            max_v: CONTROL_V,
            min_degc: Celsius::NEG_INFINITY,
            ..self
        }
    }
}

/// Readings at one time; a quantity that no instrument measures is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Reading {
    /// Bench time, s.
    pub time_s: Seconds,
    /// Cell voltage, V.
    pub voltage_v: Option<Volts>,
    /// Cell current, A, charge positive.
    pub current_a: Option<Amps>,
    /// Surface temperature of the cell, °C.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<Celsius>,
}

/// Why the interlock ends a run.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Trip {
    /// A quantity that left its limits.
    #[error("{what} {} ({}{}) at {time_s:.1}", left(*value, unit), between(*least, *greatest, unit), set_by(what))]
    Limit {
        /// The quantity.
        what: &'static str,
        /// Value that was read.
        value: f64,
        /// Its unit.
        unit: &'static str,
        /// Lower limit.
        least: f64,
        /// Upper limit.
        greatest: f64,
        /// Bench time, s.
        time_s: Seconds,
    },
    /// The current exceeds what the step requests, with the cause if the instruments report one.
    #[error("{trip}: {cause}")]
    Caused {
        /// Limit that was left.
        trip: Box<Trip>,
        /// The instrument and setting that differ from what this run made.
        cause: String,
    },
    /// The chiller does not do what it was started for.
    #[error("chiller: expected it to run without an alarm, found `{message}` at {time_s:.1}")]
    Chiller {
        /// Its status.
        message: String,
        /// Bench time, s.
        time_s: Seconds,
    },
    /// The own sensor of the bath shows that it is not under control.
    #[error("bath: {fault}, at {time_s:.1}")]
    Bath {
        /// What is wrong.
        fault: BathFault,
        /// Bench time, s.
        time_s: Seconds,
    },
    /// The thermometers contradict each other, the bath or the heat in the cell.
    #[error("thermometer: {fault}, at {time_s:.1}")]
    Thermometer {
        /// What is wrong.
        fault: ThermometerFault,
        /// Bench time, s.
        time_s: Seconds,
    },
}

/// Formats a value that left its limits or that cannot be read.
fn left(value: f64, unit: &str) -> String {
    if value.is_finite() {
        format!("{value:.4} {unit} left its limits")
    } else {
        "cannot be read: its meter gives no number".to_owned()
    }
}

/// Formats limits; an infinite limit is omitted.
fn between(least: f64, greatest: f64, unit: &str) -> String {
    // Print the limit as it was typed, without the rounding error of a sum.
    let [least, greatest] = [least, greatest].map(|limit| {
        if limit.is_finite() {
            (1.0e6 * limit).round() / 1.0e6
        } else {
            limit
        }
    });
    match (least.is_finite(), greatest.is_finite()) {
        (true, true) => format!("{least} {unit} to {greatest} {unit}"),
        (false, _) => format!("at most {greatest} {unit}"),
        (true, false) => format!("at least {least} {unit}"),
    }
}

/// Returns the origin of limits that no file contains as such.
fn set_by(what: &str) -> &'static str {
    match what {
        NET_CHARGE => {
            "; from charge_max and charge_drift_max of the cell file, shares of its capacity"
        }
        _ => "",
    }
}

impl Trip {
    /// Trips if a value is outside a range. NaN is outside every range.
    pub fn outside<Q: Unit>(
        what: &'static str,
        value: Q,
        allowed: &RangeInclusive<Q>,
        time_s: Seconds,
    ) -> Option<Self> {
        (!allowed.contains(&value)).then(|| Self::limit(what, value, allowed, time_s))
    }

    /// Describes a value that left its limits.
    pub fn limit<Q: Unit>(
        what: &'static str,
        value: Q,
        allowed: &RangeInclusive<Q>,
        time_s: Seconds,
    ) -> Self {
        Self::Limit {
            what,
            value: value.number(),
            unit: Q::SYMBOL,
            least: allowed.start().number(),
            greatest: allowed.end().number(),
            time_s,
        }
    }

    /// Trips if a value that cannot be negative exceeds a limit.
    pub fn above<Q: Unit>(
        what: &'static str,
        value: Q,
        greatest: Q,
        time_s: Seconds,
    ) -> Option<Self> {
        (value > greatest).then(|| Self::Limit {
            what,
            value: value.number(),
            unit: Q::SYMBOL,
            least: 0.0,
            greatest: greatest.number(),
            time_s,
        })
    }

    /// Checks whether a temperature, or the device that controls it, is faulty. If so, the bath
    /// must not continue.
    pub fn is_of_temperature(&self) -> bool {
        match self {
            Self::Limit { unit, .. } => matches!(*unit, "°C" | "K/min"),
            Self::Caused { trip, .. } => trip.is_of_temperature(),
            Self::Chiller { .. } | Self::Bath { .. } | Self::Thermometer { .. } => true,
        }
    }

    /// Adds a cause, if one is known.
    #[must_use]
    pub fn because(self, cause: Option<String>) -> Self {
        match cause {
            Some(cause) => Self::Caused {
                trip: Box::new(self),
                cause,
            },
            None => self,
        }
    }

    /// Rewords the trip for a control in the place of the cell.
    #[must_use]
    pub fn of_control(self) -> Self {
        match self {
            Self::Limit {
                what: CELL_VOLTAGE,
                value,
                unit,
                least,
                greatest,
                time_s,
            } => Self::Limit {
                what: "voltage across a control (is the cell in the jig?)",
                value,
                unit,
                least,
                greatest,
                time_s,
            },
            Self::Caused { trip, cause } => trip.of_control().because(Some(cause)),
            other => other,
        }
    }
}

/// Greatest voltage across a control, V, including the voltage drop of the leads if the supply
/// itself is the voltmeter.
const CONTROL_V: Volts = Volts(1.0);
const CELL_VOLTAGE: &str = "cell voltage";
pub(super) const NET_CHARGE: &str = "net charge of the step";
/// Largest reading of an ammeter without a current, A: its zero error.
pub const NO_CURRENT_A: Amps = Amps(0.1);
/// Share of the current limits that a meter's own error may add.
pub const CURRENT_MARGIN: f64 = 1.02;

/// Judges a reading. A reading that is not a number trips, because it carries no information.
pub fn judge(limits: &Limits, reading: &Reading) -> Option<Trip> {
    let time_s = reading.time_s;
    let (discharge_a, charge_a) = (
        limits.discharge_a * CURRENT_MARGIN,
        limits.charge_a * CURRENT_MARGIN,
    );
    let voltage = reading.voltage_v.and_then(|volts| {
        Trip::outside(CELL_VOLTAGE, volts, &(limits.min_v..=limits.max_v), time_s)
    });
    let current = || {
        Trip::outside(
            "cell current",
            reading.current_a?,
            &(-discharge_a..=charge_a),
            time_s,
        )
    };
    let temperature = || {
        let allowed = limits.min_degc..=limits.max_degc;
        Trip::outside(
            "cell temperature",
            reading.temperature_degc?,
            &allowed,
            time_s,
        )
    };
    voltage.or_else(current).or_else(temperature)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        min_v: Volts(2.5),
        max_v: Volts(4.2),
        charge_a: Amps(13.5),
        discharge_a: Amps(45.0),
        min_degc: Celsius(0.0),
        max_degc: Celsius(60.0),
    };

    #[test]
    fn each_limit_trips_by_itself_and_says_which() {
        let inside = Reading {
            time_s: Seconds(1.0),
            voltage_v: Some(Volts(3.7)),
            current_a: Some(Amps(-5.0)),
            temperature_degc: Some(Celsius(25.0)),
        };
        assert_eq!(judge(&LIMITS, &inside), None);
        assert_eq!(judge(&LIMITS, &Reading::default()), None);
        for (reading, text) in [
            (
                Reading {
                    voltage_v: Some(Volts(2.49)),
                    ..inside
                },
                "cell voltage 2.4900 V left its limits (2.5 V to 4.2 V)",
            ),
            (
                Reading {
                    voltage_v: Some(Volts(4.21)),
                    ..inside
                },
                "cell voltage 4.2100 V",
            ),
            (
                Reading {
                    voltage_v: Some(Volts::NAN),
                    ..inside
                },
                "cell voltage cannot be read: its meter gives no number (2.5 V to 4.2 V)",
            ),
            (
                Reading {
                    current_a: Some(Amps(14.0)),
                    ..inside
                },
                "cell current 14.0000 A",
            ),
            (
                Reading {
                    current_a: Some(Amps(-46.0)),
                    ..inside
                },
                "cell current -46.0000 A",
            ),
            (
                Reading {
                    temperature_degc: Some(Celsius(60.5)),
                    ..inside
                },
                "cell temperature 60.5000 °C",
            ),
        ] {
            let trip = judge(&LIMITS, &reading)
                .map(|trip| trip.to_string())
                .unwrap_or_default();
            assert!(trip.starts_with(text), "{trip}");
        }
    }

    #[test]
    fn a_net_charge_names_the_fields_that_bound_it() {
        let trip = Trip::Limit {
            what: NET_CHARGE,
            value: 325.0,
            unit: "C",
            least: -162.0,
            greatest: 324.0,
            time_s: Seconds(12.0),
        };
        let text = "net charge of the step 325.0000 C left its limits (-162 C to 324 C; from \
        charge_max and charge_drift_max of the cell file, \
                    shares of its capacity) at 12.0 s";
        assert_eq!(trip.to_string(), text);
    }

    #[test]
    fn a_control_has_no_voltage_and_a_cell_in_its_place_trips() {
        let control = LIMITS.of_control();
        let across = |volts| {
            judge(
                &control,
                &Reading {
                    voltage_v: Some(volts),
                    ..Reading::default()
                },
            )
        };
        assert_eq!((across(Volts(0.0)), across(Volts(-0.9))), (None, None));
        assert_eq!(
            (control.charge_a, control.discharge_a),
            (Amps(13.5), Amps(45.0))
        );
        // A cell that lies beside the jig may be cold, but not hot.
        let beside = |celsius| {
            judge(
                &control,
                &Reading {
                    temperature_degc: Some(celsius),
                    ..Reading::default()
                },
            )
        };
        assert!(beside(Celsius(-20.0)).is_none() && beside(Celsius(61.0)).is_some());
        for volts in [1.1, 3.72, -3.72, f64::NAN] {
            let trip = across(Volts(volts))
                .map(|trip| trip.of_control().to_string())
                .unwrap_or_default();
            assert!(
                trip.starts_with("voltage across a control (is the cell in the jig?) ")
                    && trip.contains("(-1 V to 1 V)"),
                "{trip}"
            );
        }
    }

    #[test]
    fn a_step_allows_less_than_the_cell_and_never_more() {
        let step = LIMITS.bounded(Amps(2.0), Amps(60.0));
        assert_eq!(
            (step.charge_a, step.discharge_a, step.max_v),
            (Amps(2.0), Amps(45.0), Volts(4.2))
        );
        let reading = Reading {
            current_a: Some(Amps(2.5)),
            ..Reading::default()
        };
        assert!(judge(&LIMITS, &reading).is_none() && judge(&step, &reading).is_some());
    }
}
