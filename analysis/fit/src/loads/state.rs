//! State of charge at the start of every load: by counting charge, by a column of the log, or by the
//! voltage of a rest.

use analysis_model::ocv::OcvCurve;
use analysis_signal::series::TimeSeries;

use super::{
    load::{KnownSoc, Load, SocFrom},
    segment::rest_current_a,
    thresholds::{CUT_S, SOC_BEYOND},
};

/// Knowledge of a cell's charge.
#[derive(Debug, Clone, Copy, Default)]
pub struct ChargeKnown<'a> {
    /// Capacity, Ah.
    pub capacity_ah: Option<f64>,
    /// State of charge at the first sample of the log.
    pub soc_start: Option<f64>,
    /// OCV curve.
    pub curve: Option<&'a OcvCurve>,
    /// State of charge in each row of the log, NaN where the row has none.
    pub column: Option<&'a [f64]>,
}

/// A state of charge at a sample, from which charge is counted.
#[derive(Debug, Clone, Copy)]
struct Anchor {
    sample: usize,
    soc: f64,
    /// Part of the log that it serves; `None` for all parts.
    part: Option<usize>,
}

/// Sets the state of charge at the start of each load.
///
/// It is counted from the start of the log if the initial state and the capacity are known. Otherwise
/// a column of the log determines it. Otherwise, the first usable rest of each part of the log
/// determines it by the curve, and it is counted from there for later loads. A pulse on a base current
/// is refused without it.
pub fn count_charge(series: &TimeSeries, loads: &mut [Load], known: ChargeKnown<'_>) {
    set_states(series, loads, known);
    for load in loads {
        if let (Some(base), None, None) = (load.base, load.soc, &load.refusal) {
            load.refusal = Some(format!(
                "it stands on {:.3} A without a rest, and its state of charge is not known: --soc-start \
                 with --capacity-ah states it",
                base.current_a
            ));
        }
    }
}

fn set_states(series: &TimeSeries, loads: &mut [Load], known: ChargeKnown<'_>) {
    let counts = known.soc_start.is_some() && known.capacity_ah.is_some();
    if let Some(column) = known.column.filter(|_| !counts) {
        loads.iter_mut().for_each(|load| {
            // The last row of the rest, if the load has one.
            let rows = load.begin.saturating_sub(1)..=load.begin;
            let soc = column
                .get(rows)
                .and_then(|rows| rows.iter().find(|soc| soc.is_finite()));
            load.soc = soc.map(|soc| KnownSoc {
                value: soc.clamp(0.0, 1.0),
                from: SocFrom::Column,
            });
        });
        return;
    }
    let Some(capacity_ah) = known.capacity_ah else {
        return;
    };
    let counted = Counted::of(series);
    let mut anchor = known.soc_start.map(|soc| Anchor {
        sample: 0,
        soc,
        part: None,
    });
    for load in loads {
        let from = anchor.filter(|anchor| {
            anchor.part.is_none_or(|part| part == load.part)
                && counted.connects(anchor.sample, load.begin)
        });
        let at_rest = |curve: &OcvCurve| {
            let rest_v = load.rest_v().filter(|_| load.refusal.is_none())?;
            Some(at_voltage(curve, rest_v))
        };
        if let Some(anchor) = from {
            let soc = anchor.soc
                - (counted.charge_ah[load.begin] - counted.charge_ah[anchor.sample]) / capacity_ah;
            load.soc = Some(KnownSoc {
                value: soc.clamp(0.0, 1.0),
                from: SocFrom::Counted,
            });
            if !(-SOC_BEYOND..=1.0 + SOC_BEYOND).contains(&soc) && load.refusal.is_none() {
                load.refusal = Some(format!(
                    "the counted state of charge is {soc:.3}: capacity or start are wrong"
                ));
            }
        } else if let Some(soc) = known.curve.and_then(at_rest) {
            load.soc = Some(KnownSoc {
                value: soc,
                from: SocFrom::RestVoltage,
            });
            anchor = Some(Anchor {
                sample: load.samples.start,
                soc,
                part: Some(load.part),
            });
        }
    }
}

/// The state of charge at which a curve has a voltage; its end for a voltage beyond it.
pub fn at_voltage(curve: &OcvCurve, rest_v: f64) -> f64 {
    let end = f64::from(u8::from(rest_v > curve.voltage_v(0.5)));
    curve.soc_at(rest_v).unwrap_or(end)
}

/// Charge drawn since the start of a log.
pub struct Counted {
    /// Charge in each row, Ah.
    pub charge_ah: Vec<f64>,
    /// Number of cuts with unknown current before each sample.
    cuts: Vec<usize>,
}

impl Counted {
    /// Counts the current by trapezia; a row without a current has that of the row before it.
    pub fn of(series: &TimeSeries) -> Self {
        let below_a = rest_current_a(series);
        let (mut charge, mut cuts) = (0.0, 0);
        let mut counted = Self {
            charge_ah: vec![0.0; series.len()],
            cuts: vec![0; series.len()],
        };
        let mut before_a = 0.0;
        for k in 0..series.len() {
            let now_a = Some(series.current_a[k])
                .filter(|a| a.is_finite())
                .unwrap_or(before_a);
            if k > 0 {
                let step_s = series.time_s[k] - series.time_s[k - 1];
                if step_s > CUT_S && before_a.abs().max(now_a.abs()) > below_a {
                    cuts += 1;
                }
                charge += 0.5 * (before_a + now_a) * step_s.max(0.0) / 3600.0;
            }
            counted.charge_ah[k] = charge;
            counted.cuts[k] = cuts;
            before_a = now_a;
        }
        counted
    }

    fn connects(&self, from: usize, to: usize) -> bool {
        self.cuts.get(from) == self.cuts.get(to)
    }
}

/// Part by which a counter of charge may differ from the integral of the current.
const SAME_COUNT_PART: f64 = 0.1;

/// Charge drawn since the first row by a counter of the cycler, Ah, from the charge that went in less
/// that which came out. It goes on where the log has a cut.
///
/// # Errors
/// The reason why it is not used: a row without a count, or a count that does not follow the current.
pub fn drawn_by_counter(series: &TimeSeries, net_ah: &[f64]) -> Result<Vec<f64>, String> {
    let refuse = |why: String| Err(format!("the counter of the charge is not used: {why}"));
    if net_ah.len() != series.len() || net_ah.iter().any(|ah| !ah.is_finite()) {
        return refuse("it has no count in some rows".to_owned());
    }
    let counted = Counted::of(series).charge_ah;
    let (mut both, mut own) = (0.0, 0.0);
    for k in 1..series.len() {
        if series.time_s[k] - series.time_s[k - 1] <= CUT_S {
            let moved_ah = counted[k] - counted[k - 1];
            both += moved_ah * (net_ah[k - 1] - net_ah[k]);
            own += moved_ah * moved_ah;
        }
    }
    let part = both / own;
    if own > 0.0 && (part - 1.0).abs() > SAME_COUNT_PART {
        return refuse(format!(
            "it moves by {part:.3} of the charge that the current moves"
        ));
    }
    Ok(net_ah.iter().map(|ah| net_ah[0] - ah).collect())
}
