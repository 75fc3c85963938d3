//! Checks that the limits of a cell can protect it. Limits beyond the cell's absolute limits, as
//! far as its file knows them, are refused. Limits beyond the cell's own data or common values
//! cause a warning, because an interlock that never trips does not protect.

use serde::Deserialize;

use super::{
    Cell, ConfigError, Source,
    quantity::{Charge, Current, Quantity, Temperature, Voltage},
};

/// Limits of the maker; a limit or a capacity of the cell file beyond these is refused.
#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Section {
    /// Highest capacity. Left out: not checked.
    capacity: Option<Quantity<Charge>>,
    /// Lowest voltage. Left out: not checked.
    voltage_min: Option<Quantity<Voltage>>,
    /// Highest voltage. Left out: not checked.
    voltage_max: Option<Quantity<Voltage>>,
    /// Highest charging current. Left out: not checked.
    charge_current_max: Option<Quantity<Current>>,
    /// Highest discharging current, positive. Left out: not checked.
    discharge_current_max: Option<Quantity<Current>>,
    /// Lowest temperature of the surface. Left out: not checked.
    temperature_min: Option<Quantity<Temperature>>,
    /// Highest temperature of the surface. Left out: not checked.
    temperature_max: Option<Quantity<Temperature>>,
}

impl Section {
    /// Refuses a cell whose limits or capacity lie beyond these; the capacity sets the limits of
    /// charge.
    ///
    /// # Errors
    /// The first such field.
    pub(super) fn check(&self, source: &Source, cell: &Cell) -> Result<(), ConfigError> {
        let limits = &cell.limits;
        let si = |field: &Option<Quantity<Voltage>>| field.map(|field| field.si);
        let amps = |field: &Option<Quantity<Current>>| field.map(|field| field.si);
        let celsius = |field: &Option<Quantity<Temperature>>| field.map(|field| field.si);
        let capacity = self.capacity.map(|field| field.si / 3600.0);
        for (field, unit, value, (least, greatest)) in [
            (
                "capacity",
                "Ah",
                cell.capacity_coulomb.value() / 3600.0,
                (None, capacity),
            ),
            (
                "voltage_min",
                "V",
                limits.min_v.value(),
                (si(&self.voltage_min), None),
            ),
            (
                "voltage_max",
                "V",
                limits.max_v.value(),
                (None, si(&self.voltage_max)),
            ),
            (
                "charge_current_max",
                "A",
                limits.charge_a.value(),
                (None, amps(&self.charge_current_max)),
            ),
            (
                "discharge_current_max",
                "A",
                limits.discharge_a.value(),
                (None, amps(&self.discharge_current_max)),
            ),
            (
                "temperature_min",
                "°C",
                limits.min_degc.value(),
                (celsius(&self.temperature_min), None),
            ),
            (
                "temperature_max",
                "°C",
                limits.max_degc.value(),
                (None, celsius(&self.temperature_max)),
            ),
        ] {
            let beyond = |word: &str, bound: f64| {
                let reason = format!(
                    "expected at {word} {bound} {unit}, the cell's absolute limit in [absolute], \
                    found {value} {unit}"
                );
                Err(source.complain(field, reason))
            };
            match (least, greatest) {
                (Some(least), _) if value < least => return beyond("least", least),
                (_, Some(greatest)) if value > greatest => return beyond("most", greatest),
                _ => {}
            }
        }
        Ok(())
    }
}

/// A voltage may lie so far beyond the open-circuit voltages of `[ocv]`, V: a table is rounded.
const OCV_MARGIN_V: f64 = 0.02;
/// Least and greatest voltage of the usual lithium cells, V, where the file has no `[ocv]`.
const USUAL_V: (f64, f64) = (2.0, 4.25);
/// Greatest charging and discharging current of the usual power cells, as multiples of the capacity
/// in an hour.
const USUAL_C_RATE: (f64, f64) = (3.05, 15.0);
/// Surface temperatures beyond which a lithium cell ages or plates fast, °C.
const USUAL_C: (f64, f64) = (-20.0, 60.0);

/// Limits of a cell that lie beyond its data or common values, in words.
pub(super) fn wide(cell: &Cell) -> Vec<String> {
    let (limits, settings) = (&cell.limits, &cell.interlock);
    let (ocv, table) = cell
        .ocv
        .as_ref()
        .map_or((USUAL_V, "of the usual lithium cells"), |ocv| {
            let ends = ocv
                .ocv_v
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), v| {
                    (least.min(*v), most.max(*v))
                });
            (
                (ends.0 - OCV_MARGIN_V, ends.1 + OCV_MARGIN_V),
                "of this cell in [ocv]",
            )
        });
    let (ampere_hours, share) = (
        cell.capacity_coulomb.value() / 3600.0,
        100.0 / cell.capacity_coulomb.value(),
    );
    let field =
        |field: &str, (value, unit): (f64, &str), (least, greatest): (f64, f64), why: &str| {
            let (word, bound) = if value < least {
                ("below", least)
            } else {
                ("above", greatest)
            };
            let text = || {
                format!(
                    "{field} = {} {unit} is {word} {} {unit}, {why}",
                    rounded(value),
                    rounded(bound)
                )
            };
            (!(least..=greatest).contains(&value)).then(text)
        };
    let most = |greatest: f64| (f64::NEG_INFINITY, greatest);
    let (never, blind) = (
        "from where it saves no cell",
        "from where nothing is seen for too long",
    );
    [
        field(
            "voltage_min",
            (limits.min_v.value(), "V"),
            (ocv.0, f64::INFINITY),
            &format!("the least voltage {table}"),
        ),
        field(
            "voltage_max",
            (limits.max_v.value(), "V"),
            most(ocv.1),
            &format!("the greatest voltage {table}"),
        ),
        field(
            "charge_current_max",
            (limits.charge_a.value(), "A"),
            most(USUAL_C_RATE.0 * ampere_hours),
            "more than power cells bear for long",
        ),
        field(
            "discharge_current_max",
            (limits.discharge_a.value(), "A"),
            most(USUAL_C_RATE.1 * ampere_hours),
            "more than power cells bear for long",
        ),
        field(
            "temperature_min",
            (limits.min_degc.value(), "°C"),
            (USUAL_C.0, f64::INFINITY),
            "where lithium plates",
        ),
        field(
            "temperature_max",
            (limits.max_degc.value(), "°C"),
            most(USUAL_C.1),
            "where lithium cells age fast",
        ),
        field(
            "interlock.temperature_rate_max",
            (60.0 * settings.rate_k_per_s.value(), "K/min"),
            most(20.0),
            never,
        ),
        field(
            "interlock.temperature_window",
            (settings.window_s.value(), "s"),
            most(180.0),
            blind,
        ),
        field(
            "interlock.charge_max",
            (share * settings.charge_coulomb.value(), "%"),
            most(125.0),
            "more than any cell holds",
        ),
        field(
            "interlock.charge_drift_max",
            (share * settings.drift_coulomb.value(), "%"),
            most(10.0),
            never,
        ),
        field(
            "interlock.frozen_charge",
            (share * settings.frozen_coulomb.value(), "%"),
            most(10.0),
            blind,
        ),
        field(
            "interlock.frozen_time",
            (settings.frozen_s.value(), "s"),
            most(300.0),
            blind,
        ),
        field(
            "interlock.reading_age_max",
            (settings.reading_age_s.value(), "s"),
            most(60.0),
            blind,
        ),
        field(
            "interlock.temperature_age_max",
            (settings.temperature_age_s.value(), "s"),
            most(300.0),
            blind,
        ),
    ]
    .into_iter()
    .flatten()
    .map(|text| format!("A LIMIT OF THE CELL IS TOO WIDE: {text}"))
    .collect()
}

fn rounded(value: f64) -> f64 {
    (1.0e4 * value).round() / 1.0e4
}
