//! Holds what is known of a log against each other: the options of the user, the columns and the head of
//! the file, and what the current and the voltage show.

use analysis::{
    loads::{Counted, Load, SocFrom, at_voltage},
    ocv::OcvCurve,
    series::TimeSeries,
};

use super::thresholds::{SAME_CAPACITY_PART, STATE_SOC, STATE_TEMPERATURE_C};

/// What the user states of a log, and what the log holds.
#[derive(Debug, Clone, Copy, Default)]
pub struct LogFacts<'a> {
    /// Capacity that is used, Ah.
    pub capacity_ah: Option<f64>,
    /// Capacity in the head of the file, Ah.
    pub head_capacity_ah: Option<f64>,
    /// State of charge at the first row as stated by the user.
    pub soc_start: Option<f64>,
    /// Temperature as stated by the user, °C.
    pub temperature_degc: Option<f64>,
    /// Temperature in the head of the file, °C.
    pub head_temperature_degc: Option<f64>,
    /// State of charge in each row by a column.
    pub column: Option<&'a [f64]>,
    /// OCV curve.
    pub curve: Option<&'a OcvCurve>,
}

/// Why a column of the state of charge cannot be one: it must fall while charge is drawn.
///
/// # Errors
/// The reason, for a remark.
pub fn fits_current(series: &TimeSeries, column: &[f64]) -> Result<(), String> {
    let Some(Drawn { ah, soc }) = drawn(series, column) else {
        return Ok(());
    };
    if soc < 0.0 {
        return Ok(());
    }
    Err(format!(
        "the column of the state of charge is not used: it {} while {ah:.3} Ah are drawn",
        if soc == 0.0 {
            "stands still".to_owned()
        } else {
            format!("rises by {:.1} %", 100.0 * soc)
        }
    ))
}

/// Charge that is drawn from one row to another, and the change of a column between them.
struct Drawn {
    ah: f64,
    soc: f64,
}

/// The largest discharge or charge within the log; none if no charge flows or the column lacks a value.
fn drawn(series: &TimeSeries, column: &[f64]) -> Option<Drawn> {
    let charge_ah = Counted::of(series).charge_ah;
    let known = (0..charge_ah.len()).filter(|k| column.get(*k).is_some_and(|v| v.is_finite()));
    let by_charge = |a: &usize, b: &usize| charge_ah[*a].total_cmp(&charge_ah[*b]);
    let (least, most) = (known.clone().min_by(by_charge)?, known.max_by(by_charge)?);
    let ah = charge_ah[most] - charge_ah[least];
    (ah > 0.0).then(|| Drawn {
        ah,
        soc: column[most] - column[least],
    })
}

/// What contradicts each other in a log, each as a sentence that says which one is used.
pub fn contradictions(series: &TimeSeries, loads: &[Load], facts: &LogFacts<'_>) -> Vec<String> {
    let both = |a: Option<f64>, b: Option<f64>| a.zip(b);
    let mut found = Vec::new();
    let unlike = |(a, b): &(f64, f64)| (a / b - 1.0).abs() > SAME_CAPACITY_PART;
    if let Some((used, head)) = both(facts.capacity_ah, facts.head_capacity_ah).filter(unlike) {
        found.push(format!(
            "the capacity {used} Ah is used, and the head of the file has {head} Ah"
        ));
    }
    let away = |(a, b): &(f64, f64)| (a - b).abs() > STATE_TEMPERATURE_C;
    let logged = loads.iter().find_map(|load| load.temperature_degc);
    if let Some((stated, met)) = both(facts.temperature_degc, logged).filter(away) {
        found.push(format!(
            "the stated temperature {stated} °C is used, and the log has {met:.1} °C at its first load"
        ));
    }
    let used = facts.temperature_degc.or(logged);
    if let Some((used, head)) = both(used, facts.head_temperature_degc).filter(away) {
        found.push(format!(
            "the temperature {used:.1} °C is used, and the head of the file has {head} °C"
        ));
    }
    if let Some(column) = facts.column {
        let first = column.iter().copied().find(|soc| soc.is_finite());
        let apart = |(a, b): &(f64, f64)| (a - b).abs() > STATE_SOC;
        if let Some((stated, met)) = both(facts.soc_start, first).filter(apart) {
            found.push(format!(
                "the log is stated to begin at {:.1} % SOC, which is used, and its column begins at \
                 {:.1} %",
                100.0 * stated,
                100.0 * met
            ));
        }
        let by_column = drawn(series, column)
            .filter(|drawn| -drawn.soc > STATE_SOC)
            .map(|drawn| -drawn.ah / drawn.soc);
        if let Some((used, met)) = both(facts.capacity_ah, by_column).filter(unlike) {
            found.push(format!(
                "the capacity is {used} Ah, and the column of the state of charge goes by {met:.2} Ah"
            ));
        }
    }
    found.extend(facts.curve.and_then(|curve| against_curve(loads, curve)));
    found
}

/// The load whose state of charge is furthest from that of its rest voltage.
fn against_curve(loads: &[Load], curve: &OcvCurve) -> Option<String> {
    let away = |load: &Load| {
        let soc = load.soc.filter(|soc| soc.from != SocFrom::RestVoltage)?;
        let rest_v = load.rest_v().filter(|_| load.refusal.is_none())?;
        Some((soc.value - at_voltage(curve, rest_v)).abs())
    };
    let worst = loads
        .iter()
        .filter_map(|load| Some((load, away(load)?)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|(_, away)| *away > STATE_SOC);
    worst.map(|(load, _)| {
        let rest_v = load.rest_v().unwrap_or(f64::NAN);
        format!(
            "the load at {:.1} s is taken at {:.1} % SOC, and the curve has its rest voltage {rest_v:.4} V \
             at {:.1} %",
            load.start_s,
            100.0 * load.soc.map_or(f64::NAN, |soc| soc.value),
            100.0 * at_voltage(curve, rest_v)
        )
    })
}
