//! Resolves two smaller sections of a bench file: the quirks of its mocks beside the scenario, and
//! the control of a bath with relays.

use std::collections::BTreeMap;

use instruments::units::{Kelvins, Seconds};

use super::{ConfigError, Instruments, Source, Thermostat, raw_bench};
use crate::mocks::{self, Fault, MakeError, Quirks, Schedule, Value};

pub(super) fn faults(source: &Source, raw: &raw_bench::Faults) -> Result<Schedule, ConfigError> {
    if !(0.0..=1.0).contains(&raw.per_message) {
        let reason = format!("expected a chance from 0 to 1, found {}", raw.per_message);
        return Err(source.complain("simulation.faults.per_message", reason));
    }
    let faults = raw.kinds.clone().unwrap_or_else(|| Fault::ALL.to_vec());
    if let Some(role) = raw.role.as_ref().filter(|role| {
        !mocks::MODELS
            .iter()
            .any(|model| model.role == role.as_str())
    }) {
        return Err(source.complain(
            "simulation.faults.role",
            format!("expected the role of an instrument, found {role:?}"),
        ));
    }
    let from_s = raw.from.map_or(0.0, |from| from.si);
    Ok(Schedule {
        seed: raw.seed,
        per_message: raw.per_message,
        most: raw.most,
        faults,
        role: raw.role.clone(),
        variant: raw.variant,
        from_s,
        ..Schedule::default()
    })
}

/// Quirks of the mocks, by role; each is checked against the quirks of its model.
pub(super) fn quirks(
    source: &Source,
    raw: &BTreeMap<String, BTreeMap<String, Value>>,
    instruments: &Instruments,
) -> Result<BTreeMap<&'static str, Quirks>, ConfigError> {
    let addressed = instruments.addressed();
    let mut by_role = BTreeMap::new();
    for (role, switches) in raw {
        let Some((role, instrument)) = addressed.iter().find(|(known, _)| known == role) else {
            let roles = addressed
                .iter()
                .map(|(role, _)| *role)
                .collect::<Vec<_>>()
                .join(", ");
            return Err(source.complain(
                &format!("simulation.quirks.{role}"),
                format!("expected an instrument of this bench ({roles}), found {role:?}"),
            ));
        };
        let quirks: Quirks = switches.clone().into_iter().collect();
        match mocks::check_quirks(&instrument.model, &quirks) {
            Ok(_) => by_role.insert(*role, quirks),
            Err(MakeError::Quirk(error)) => {
                let reason = format!("{}: {error}", instrument.model);
                return Err(
                    source.complain(&format!("simulation.quirks.{role}.{}", error.name), reason)
                );
            }
            Err(error) => {
                return Err(
                    source.complain(&format!("simulation.quirks.{role}"), error.to_string())
                );
            }
        };
    }
    Ok(by_role)
}

/// Unless they are typed: proportional band, K, integral time, window and age of a reading, s.
const THERMOSTAT: Thermostat = Thermostat {
    band_k: Kelvins(0.5),
    integral_s: Seconds(400.0),
    window_s: Seconds(20.0),
    stale_s: Seconds(60.0),
    sensor_offset_k: Kelvins::ZERO,
};

pub(super) fn thermostat(
    source: &Source,
    raw: &raw_bench::Thermostat,
) -> Result<Thermostat, ConfigError> {
    let within = |field: &str, value: f64, (least, greatest): (f64, f64), unit: &str| {
        let reason =
            || format!("expected {least} {unit} to {greatest} {unit}, found {value} {unit}");
        (least..=greatest)
            .contains(&value)
            .then_some(value)
            .ok_or_else(|| source.complain(&format!("thermostat.{field}"), reason()))
    };
    let usual = THERMOSTAT;
    let window_s = within(
        "window",
        raw.window
            .map_or(usual.window_s.value(), |window| window.si),
        (5.0, 45.0),
        "s",
    )?;
    Ok(Thermostat {
        band_k: Kelvins(within(
            "proportional_band",
            raw.proportional_band
                .map_or(usual.band_k.value(), |band| band.si),
            (0.05, 20.0),
            "K",
        )?),
        integral_s: Seconds(within(
            "integral_time",
            raw.integral_time
                .map_or(usual.integral_s.value(), |time| time.si),
            (10.0, 100_000.0),
            "s",
        )?),
        window_s: Seconds(window_s),
        stale_s: Seconds(within(
            "stale",
            raw.stale.map_or(usual.stale_s.value(), |stale| stale.si),
            (window_s, 600.0),
            "s",
        )?),
        sensor_offset_k: Kelvins(within(
            "sensor_offset",
            raw.sensor_offset.map_or(0.0, |offset| offset.si),
            (-5.0, 5.0),
            "K",
        )?),
    })
}
