//! Finds the pulses of a log and makes their table.

use std::collections::BTreeMap;

use analysis_signal::series::TimeSeries;

use super::options::{HppcError, HppcOptions};
use super::pulse;
use super::result::{Hppc, LeftOutLoad, Pulse, StateAxis};
use crate::loads::{
    CUT_S, ChargeKnown, Counted, Course, KnownSoc, LONGEST_PULSE_S, Load, LogSearch, SOC_BEYOND,
    SocFrom, count_charge, estimate, loads,
};

/// A log, and what is known of the charge of its cell.
#[derive(Debug, Clone, Copy)]
pub struct Log<'a> {
    /// Current, positive for discharge, and voltage.
    pub series: &'a TimeSeries,
    /// Number of the cycler's step in each row, if the log has it.
    pub steps: Option<&'a [f64]>,
    /// Capacity, state of charge at the first row, columns and curve.
    pub charge: ChargeKnown<'a>,
    /// Charge drawn since the first row by a counter of the cycler, Ah, as
    /// [`drawn_by_counter`](crate::loads::drawn_by_counter) gives it. It takes the place of the integral
    /// of the current.
    pub counter_ah: Option<&'a [f64]>,
}

/// Makes the table of the pulses of a log.
///
/// # Errors
/// [`HppcError`]: options that cannot be, numbers that are no log, a log without pulses.
pub fn hppc(log: Log<'_>, options: &HppcOptions) -> Result<Hppc, HppcError> {
    options.check()?;
    log.series.validate()?;
    let loads = with_states(log, options);
    let drawn = Counted::of(log.series);
    let noise = estimate(&[log.series]);
    let (mut pulses, mut left_out): (Vec<Pulse>, Vec<LeftOutLoad>) = (Vec::new(), Vec::new());
    for Placed { load, note } in loads {
        match reason_against(&load, options) {
            None => {
                let last_row = load.samples.start.saturating_sub(1);
                let mut found = pulse::pulse(log.series, &load, &noise, options);
                found.state.drawn_ah = match log.counter_ah {
                    Some(counter) => counter.get(last_row).copied(),
                    None => (load.part == 0).then(|| drawn.charge_ah[last_row]),
                };
                found.notes.extend(note);
                pulses.push(found);
            }
            Some(reason) => left_out.push(LeftOutLoad {
                start_s: load.start_s,
                current_a: load.current_a,
                reason,
            }),
        }
    }
    if pulses.is_empty() {
        return Err(HppcError::NoPulses {
            name: log.series.name.clone(),
            longest_s: LONGEST_PULSE_S,
            rest_s: options.rest_s,
            found: in_words(&left_out),
        });
    }
    let axis = if pulses.iter().all(|pulse| pulse.state.soc.is_some()) {
        StateAxis::Soc
    } else if pulses.iter().all(|pulse| pulse.state.drawn_ah.is_some()) {
        StateAxis::ChargeDrawn
    } else {
        StateAxis::RestVoltage
    };
    Ok(Hppc {
        name: log.series.name.clone(),
        axis,
        at_s: options.at_s.clone(),
        limits: options.limits,
        noise,
        pulses,
        left_out,
    })
}

/// A load with its state, and the reason why that is not known.
struct Placed {
    load: Load,
    note: Option<String>,
}

/// The loads of a log with their states of charge.
fn with_states(log: Log<'_>, options: &HppcOptions) -> Vec<Placed> {
    let search = LogSearch {
        rest_s: options.rest_s,
        slowest_s: f64::INFINITY,
    };
    let mut all = loads(log.series, log.steps, &search);
    // Behind a cut charge is not counted from the first row, but from the curve.
    let mut by_curve = all.clone();
    let unstated = ChargeKnown {
        soc_start: None,
        ..log.charge
    };
    count_charge(log.series, &mut by_curve, unstated);
    let counts = log.charge.soc_start.is_some() && log.charge.capacity_ah.is_some();
    if counts {
        // A load that is refused as a run of a data set still has a state.
        all.iter_mut().for_each(|load| load.refusal = None);
    }
    let before: Vec<Option<String>> = all.iter().map(|load| load.refusal.clone()).collect();
    count_charge(log.series, &mut all, log.charge);
    let each = all.into_iter().zip(before).zip(by_curve);
    each.map(|((mut load, before), by_curve)| {
        // A pulse on a current that has no state keeps its place by the charge.
        let met = load.refusal.clone().filter(|_| load.refusal != before);
        let mut note = met.filter(|_| load.soc.is_some());
        if note.is_some() {
            load.soc = None;
        }
        if let Some(soc) = by_counter(log, &load) {
            let fits = (-SOC_BEYOND..=1.0 + SOC_BEYOND).contains(&soc);
            load.soc = fits.then_some(KnownSoc {
                value: soc.clamp(0.0, 1.0),
                from: SocFrom::Counted,
            });
            let note = (!fits).then(|| {
                format!("the counted state of charge is {soc:.3}: capacity or start are wrong")
            });
            return Placed { load, note };
        }
        if load.part > 0 && counts {
            load.soc = by_curve.soc;
            note = None;
        }
        if load.part > 0 && load.soc.is_none() {
            note = Some(format!(
                "no state of charge: a row before it is more than {CUT_S} s after the last one, and \
                 charge may have moved in between; --ocv gives the state by its rest"
            ));
        }
        Placed { load, note }
    })
    .collect()
}

/// The state of charge at the last row before a load by the counter of the cycler.
fn by_counter(log: Log<'_>, load: &Load) -> Option<f64> {
    let drawn_ah = log.counter_ah?.get(load.samples.start.saturating_sub(1))?;
    Some(log.charge.soc_start? - drawn_ah / log.charge.capacity_ah?)
}

/// Returns the reason why a load is not a pulse of the table.
fn reason_against(load: &Load, options: &HppcOptions) -> Option<String> {
    if load.course == Course::Varying {
        return Some("its current varies".to_owned());
    }
    if load.duration_s > LONGEST_PULSE_S {
        return Some(match load.course {
            Course::AtLimit => "a voltage limit holds it for longer than a pulse".to_owned(),
            _ => format!("its constant current lasts longer than {LONGEST_PULSE_S} s"),
        });
    }
    match load.rest {
        Some(rest) if rest.duration_s < options.rest_s => Some(format!(
            "the rest before it is logged for less than {} s",
            options.rest_s
        )),
        None if load.base.is_none() => Some("no rest before it".to_owned()),
        _ => None,
    }
}

/// Counts of loads by their reasons, in words.
pub(super) fn in_words(left_out: &[LeftOutLoad]) -> String {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for load in left_out {
        *counts.entry(&load.reason).or_default() += 1;
    }
    let words = counts.into_iter().map(|(reason, count)| match count {
        1 => format!("1 load ({reason})"),
        _ => format!("{count} loads ({reason})"),
    });
    let words = words.collect::<Vec<_>>().join(", ");
    if words.is_empty() {
        "no current above the rest".to_owned()
    } else {
        words
    }
}

impl Hppc {
    /// Loads that are left out, counted by their reasons, in words; `None` if there are none.
    pub fn left_out_in_words(&self) -> Option<String> {
        (!self.left_out.is_empty()).then(|| in_words(&self.left_out))
    }
}
