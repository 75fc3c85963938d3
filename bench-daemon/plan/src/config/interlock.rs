//! The section `[interlock]` of a cell file: interlock limits in addition to the limits of the
//! cell. Every line has a default.

use serde::Deserialize;

use instruments::units::{Coulombs, KelvinsPerSecond, Seconds};

use super::{
    ConfigError, Source,
    quantity::{Duration, Quantity, Share, TemperatureRate},
};
use crate::interlock::Settings;

/// Limits of the interlock in addition to the limits of the cell; shares are of its capacity.
#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Section {
    /// Fastest change of the temperature, 0.1 K/min to 600 K/min. Left out: 5 K/min.
    temperature_rate_max: Option<Quantity<TemperatureRate>>,
    /// Time over which the change is evaluated, 20 s to 600 s. Left out: 60 s.
    temperature_window: Option<Quantity<Duration>>,
    /// Largest charge of one discharge or charge, 1 % to 1000 %. Left out: 110 %.
    charge_max: Option<Quantity<Share>>,
    /// Largest net charge of a sweep, or deviation of a trace from its planned charge, 0.01 % to
    /// 1000 %. Left out: 0.5 %.
    charge_drift_max: Option<Quantity<Share>>,
    /// Charge in one direction under which a voltage or temperature must move, 0.01 % to 1000 %.
    /// Left out: 1 %.
    frozen_charge: Option<Quantity<Share>>,
    /// Time under a slow sinusoid in which voltage and current must move, 10 s to 3600 s. Left out:
    /// 30 s.
    frozen_time: Option<Quantity<Duration>>,
    /// Longest time without a reading while current may flow, 2 s to 600 s. Left out: 15 s.
    reading_age_max: Option<Quantity<Duration>>,
    /// Longest time without a temperature while current may flow, 10 s to 3600 s. Left out: 60 s.
    temperature_age_max: Option<Quantity<Duration>>,
}

/// A field: its name, its typed value, its default, its range, and the unit of the range in
/// messages.
type Field<'a> = (&'a str, Option<f64>, f64, (f64, f64), &'a str);

impl Section {
    /// Checks the section for a cell of `capacity_coulomb`.
    ///
    /// # Errors
    /// The first field outside its range.
    pub(super) fn resolve(
        &self,
        source: &Source,
        capacity_coulomb: Coulombs,
    ) -> Result<Settings, ConfigError> {
        let within = |(field, typed, default, (least, greatest), unit): Field<'_>| {
            let value = typed.unwrap_or(default);
            (least..=greatest)
                .contains(&value)
                .then_some(value)
                .ok_or_else(|| {
                    source.complain(
                        &format!("interlock.{field}"),
                        format!(
                            "expected {least} {unit} to {greatest} {unit}, found {value} {unit}"
                        ),
                    )
                })
        };
        let share = |typed: Option<Quantity<Share>>| typed.map(|share| 100.0 * share.si);
        // The rate of a fault that heats a cell; a discharge at two hours warms a P45B by less than
        // a kelvin a minute.
        let rate = (
            "temperature_rate_max",
            self.temperature_rate_max.map(|rate| 60.0 * rate.si),
            5.0,
            (0.1, 600.0),
            "K/min",
        );
        Ok(Settings {
            rate_k_per_s: KelvinsPerSecond(within(rate)? / 60.0),
            window_s: Seconds(within((
                "temperature_window",
                si(self.temperature_window),
                60.0,
                (20.0, 600.0),
                "s",
            ))?),
            charge_coulomb: 0.01
                * capacity_coulomb
                * within((
                    "charge_max",
                    share(self.charge_max),
                    110.0,
                    (1.0, 1000.0),
                    "%",
                ))?,
            drift_coulomb: 0.01
                * capacity_coulomb
                * within((
                    "charge_drift_max",
                    share(self.charge_drift_max),
                    0.5,
                    (0.01, 1000.0),
                    "%",
                ))?,
            capacity_coulomb,
            frozen_coulomb: 0.01
                * capacity_coulomb
                * within((
                    "frozen_charge",
                    share(self.frozen_charge),
                    1.0,
                    (0.01, 1000.0),
                    "%",
                ))?,
            frozen_s: Seconds(within((
                "frozen_time",
                si(self.frozen_time),
                30.0,
                (10.0, 3600.0),
                "s",
            ))?),
            reading_age_s: Seconds(within((
                "reading_age_max",
                si(self.reading_age_max),
                15.0,
                (2.0, 600.0),
                "s",
            ))?),
            temperature_age_s: Seconds(within((
                "temperature_age_max",
                si(self.temperature_age_max),
                60.0,
                (10.0, 3600.0),
                "s",
            ))?),
        })
    }
}

fn si<D>(typed: Option<Quantity<D>>) -> Option<f64> {
    typed.map(|quantity| quantity.si)
}
