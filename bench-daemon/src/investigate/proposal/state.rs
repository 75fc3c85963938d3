//! State of charge at the start of every load, by counting charge.

use analysis::{ocv::OcvCurve, series::TimeSeries};

use super::{
    load::Load,
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
/// It is counted from the start of the log if the initial state is known. Otherwise, the first
/// usable rest of each part of the log determines it by the curve, and it is counted from there
/// for later loads.
pub fn count_charge(series: &TimeSeries, loads: &mut [Load], known: ChargeKnown<'_>) {
    let Some(capacity_ah) = known
        .capacity_ah
        .or(known.curve.map(|curve| curve.capacity_ah))
    else {
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
                && counted.connects(anchor.sample, load.first)
        });
        let at_rest = |curve: &OcvCurve| {
            let rest_v = load.rest_v().filter(|_| load.refusal.is_none())?;
            let end = f64::from(u8::from(rest_v > curve.voltage_v(0.5)));
            Some(curve.soc_at(rest_v).unwrap_or(end))
        };
        if let Some(anchor) = from {
            let soc = anchor.soc
                - (counted.charge_ah[load.first] - counted.charge_ah[anchor.sample]) / capacity_ah;
            load.soc = Some(soc.clamp(0.0, 1.0));
            load.counted = true;
            if !(-SOC_BEYOND..=1.0 + SOC_BEYOND).contains(&soc) && load.refusal.is_none() {
                load.refusal = Some(format!(
                    "the counted state of charge is {soc:.3}: capacity or start are wrong"
                ));
            }
        } else if let Some(soc) = known.curve.and_then(at_rest) {
            load.soc = Some(soc);
            anchor = Some(Anchor {
                sample: load.first,
                soc,
                part: Some(load.part),
            });
        }
    }
}

/// Charge drawn since the start of a log.
struct Counted {
    charge_ah: Vec<f64>,
    /// Number of cuts with unknown current before each sample.
    cuts: Vec<usize>,
}

impl Counted {
    fn of(series: &TimeSeries) -> Self {
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
