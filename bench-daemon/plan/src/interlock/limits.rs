//! The limits of one reading, and the trip that ends a run.

use super::{bath::BathFault, thermometers::ThermometerFault};

/// Limits of a cell.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Limits {
    /// Least voltage, V.
    pub min_v: f64,
    /// Greatest voltage, V.
    pub max_v: f64,
    /// Greatest charge current, A.
    pub charge_a: f64,
    /// Greatest discharge current, A, positive.
    pub discharge_a: f64,
    /// Least surface temperature, °C.
    #[serde(rename = "min_c")]
    pub min_degc: f64,
    /// Greatest surface temperature, °C.
    #[serde(rename = "max_c")]
    pub max_degc: f64,
}

impl Limits {
    /// Returns the limits with reduced currents, A: the smaller value of each applies.
    #[must_use]
    pub fn bounded(self, charge_a: f64, discharge_a: f64) -> Self {
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
            min_degc: f64::NEG_INFINITY,
            ..self
        }
    }
}

/// Readings at one time; a quantity that no instrument measures is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Reading {
    /// Bench time, s.
    pub time_s: f64,
    /// Cell voltage, V.
    pub voltage_v: Option<f64>,
    /// Cell current, A, charge positive.
    pub current_a: Option<f64>,
    /// Surface temperature of the cell, °C.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
}

/// Why the interlock ends a run.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Trip {
    /// A quantity that left its limits.
    #[error("{what} {} ({}{}) at {time_s:.1} s", left(*value, unit), between(*least, *greatest, unit), set_by(what))]
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
        time_s: f64,
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
    #[error("chiller: expected it to run without an alarm, found `{message}` at {time_s:.1} s")]
    Chiller {
        /// Its status.
        message: String,
        /// Bench time, s.
        time_s: f64,
    },
    /// The own sensor of the bath shows that it is not under control.
    #[error("bath: {fault}, at {time_s:.1} s")]
    Bath {
        /// What is wrong.
        fault: BathFault,
        /// Bench time, s.
        time_s: f64,
    },
    /// The thermometers contradict each other, the bath or the heat in the cell.
    #[error("thermometer: {fault}, at {time_s:.1} s")]
    Thermometer {
        /// What is wrong.
        fault: ThermometerFault,
        /// Bench time, s.
        time_s: f64,
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
const CONTROL_V: f64 = 1.0;
const CELL_VOLTAGE: &str = "cell voltage";
pub(super) const NET_CHARGE: &str = "net charge of the step";
/// Largest reading of an ammeter without a current, A: its zero error.
pub const NO_CURRENT_A: f64 = 0.1;
/// Share of the current limits that a meter's own error may add.
pub const CURRENT_MARGIN: f64 = 1.02;

/// Judges a reading. A reading that is not a number trips, because it carries no information.
pub fn judge(limits: &Limits, reading: &Reading) -> Option<Trip> {
    let checks = [
        (
            CELL_VOLTAGE,
            reading.voltage_v,
            "V",
            limits.min_v,
            limits.max_v,
        ),
        (
            "cell current",
            reading.current_a,
            "A",
            -limits.discharge_a * CURRENT_MARGIN,
            limits.charge_a * CURRENT_MARGIN,
        ),
        (
            "cell temperature",
            reading.temperature_degc,
            "°C",
            limits.min_degc,
            limits.max_degc,
        ),
    ];
    checks
        .into_iter()
        .find_map(|(what, value, unit, least, greatest)| {
            let value = value?;
            (!(least..=greatest).contains(&value)).then_some(Trip::Limit {
                what,
                value,
                unit,
                least,
                greatest,
                time_s: reading.time_s,
            })
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        min_v: 2.5,
        max_v: 4.2,
        charge_a: 13.5,
        discharge_a: 45.0,
        min_degc: 0.0,
        max_degc: 60.0,
    };

    #[test]
    fn each_limit_trips_by_itself_and_says_which() {
        let inside = Reading {
            time_s: 1.0,
            voltage_v: Some(3.7),
            current_a: Some(-5.0),
            temperature_degc: Some(25.0),
        };
        assert_eq!(judge(&LIMITS, &inside), None);
        assert_eq!(judge(&LIMITS, &Reading::default()), None);
        for (reading, text) in [
            (
                Reading {
                    voltage_v: Some(2.49),
                    ..inside
                },
                "cell voltage 2.4900 V left its limits (2.5 V to 4.2 V)",
            ),
            (
                Reading {
                    voltage_v: Some(4.21),
                    ..inside
                },
                "cell voltage 4.2100 V",
            ),
            (
                Reading {
                    voltage_v: Some(f64::NAN),
                    ..inside
                },
                "cell voltage cannot be read: its meter gives no number (2.5 V to 4.2 V)",
            ),
            (
                Reading {
                    current_a: Some(14.0),
                    ..inside
                },
                "cell current 14.0000 A",
            ),
            (
                Reading {
                    current_a: Some(-46.0),
                    ..inside
                },
                "cell current -46.0000 A",
            ),
            (
                Reading {
                    temperature_degc: Some(60.5),
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
            time_s: 12.0,
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
        assert_eq!((across(0.0), across(-0.9)), (None, None));
        assert_eq!((control.charge_a, control.discharge_a), (13.5, 45.0));
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
        assert!(beside(-20.0).is_none() && beside(61.0).is_some());
        for volts in [1.1, 3.72, -3.72, f64::NAN] {
            let trip = across(volts)
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
        let step = LIMITS.bounded(2.0, 60.0);
        assert_eq!(
            (step.charge_a, step.discharge_a, step.max_v),
            (2.0, 45.0, 4.2)
        );
        let reading = Reading {
            current_a: Some(2.5),
            ..Reading::default()
        };
        assert!(judge(&LIMITS, &reading).is_none() && judge(&step, &reading).is_some());
    }
}
