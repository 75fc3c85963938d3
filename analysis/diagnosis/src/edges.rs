//! Errors that a logger leaves at an edge of the current, where the current is interpolated between
//! samples: the time of the edge, and the state of the channels at it. Each edge has two errors,
//! each given as the change of a record's rows by one standard deviation.

use super::time_block::{Bin, TimeBlock};
use analysis_effects::contract::Base;

/// 1/√12: standard deviation of a uniform error of one code, and of an edge anywhere between two
/// samples.
pub(super) const UNIFORM: f64 = 0.288_675_134_594_812_9;

/// An error of an edge: the change of the rows by one standard deviation, V.
#[derive(Debug, Clone)]
pub(super) struct EdgeError {
    /// What the branches forget.
    pub(super) passing_v: Vec<f64>,
    /// The same with the charge that an edge at another time has moved.
    pub(super) change_v: Vec<f64>,
}

/// The errors of all edges of a record that starts at a state of charge; its first sample is none.
pub(super) fn of_record(time: &TimeBlock, soc: f64, base: &Base) -> Vec<EdgeError> {
    let edges = time.edges.iter().skip(1);
    edges
        .flat_map(|edge| {
            let passing_v = shift(time, *edge, base);
            let moved = charge(time, *edge, soc, base);
            let change_v = passing_v.iter().zip(moved).map(|(p, m)| p + m).collect();
            let late = lag(time, *edge, base);
            [
                EdgeError {
                    passing_v,
                    change_v,
                },
                EdgeError {
                    passing_v: late.clone(),
                    change_v: late,
                },
            ]
        })
        .collect()
}

/// Change of the later rows' open-circuit voltage for the same edge: the charge that flows in
/// between.
fn charge(time: &TimeBlock, edge: usize, soc: f64, base: &Base) -> Vec<f64> {
    let (step_s, step_a) = (
        time.time_s[edge] - time.time_s[edge - 1],
        time.current_a[edge] - time.current_a[edge - 1],
    );
    let capacity_c = 3600.0 * base.ocv.capacity_ah;
    time.bins
        .iter()
        .map(|b| {
            if b.from < edge {
                return 0.0;
            }
            let slope_v = base.ocv.slope_v(soc - b.charge_c / capacity_c);
            UNIFORM * step_a * step_s / capacity_c * slope_v
        })
        .collect()
}

/// Change of the rows for an edge that lies anywhere between two samples, one standard deviation:
/// the step response's change over that time. The first sample after the edge may be read while the
/// current still changes. Its voltage may then lack any part of the series resistance's drop.
fn shift(time: &TimeBlock, edge: usize, base: &Base) -> Vec<f64> {
    let (step_s, step_a) = (
        time.time_s[edge] - time.time_s[edge - 1],
        time.current_a[edge] - time.current_a[edge - 1],
    );
    let at_s = time.time_s[edge] - 0.5 * step_s;
    time.bins
        .iter()
        .map(|b| {
            let t = b.time_s - at_s;
            if t < 0.0 {
                return 0.0;
            }
            let change = |tau_s: f64| {
                (-(t - 0.5 * step_s).max(0.0) / tau_s).exp() - (-(t + 0.5 * step_s) / tau_s).exp()
            };
            let series_ohm = if b.from <= edge && edge < b.to {
                base.erm.r_ohm / (b.to - b.from) as f64
            } else {
                0.0
            };
            UNIFORM
                * step_a
                * (series_ohm
                    + base
                        .erm
                        .branches
                        .iter()
                        .map(|b| b.r_ohm * change(b.time_constant_s()))
                        .sum::<f64>())
        })
        .collect()
}

/// Change of the later rows for a logger whose voltage channel averages over about a sampling
/// interval, one standard deviation. The drop of the series resistance at the edge comes late and
/// decays by a factor e per interval.
fn lag(time: &TimeBlock, edge: usize, base: &Base) -> Vec<f64> {
    let (step_s, step_a) = (
        time.time_s[edge] - time.time_s[edge - 1],
        time.current_a[edge] - time.current_a[edge - 1],
    );
    let late = |b: &Bin| {
        if b.from <= edge {
            0.0
        } else {
            ((time.time_s[edge] - b.time_s) / step_s).exp()
        }
    };
    time.bins
        .iter()
        .map(|b| UNIFORM * step_a * base.erm.r_ohm * late(b))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TimeRecord;
    use analysis_effects::{augmented::Between, contract::Facts};
    use analysis_model::{
        model::{Erm, RcBranch},
        ocv::OcvCurve,
    };
    use analysis_signal::series::TimeSeries;

    #[test]
    fn the_first_sample_may_lack_the_whole_step_and_the_next_what_comes_late() {
        let time_s: Vec<f64> = (0..40).map(|k| 0.1 * f64::from(k)).collect();
        let current_a: Vec<f64> = (0..40).map(|k| if k < 10 { 0.0 } else { 2.0 }).collect();
        let series = TimeSeries {
            name: "s".to_owned(),
            voltage_v: vec![3.7; 40],
            current_a,
            time_s,
            temperature_c: None,
        };
        let record = TimeRecord {
            series,
            between: Between::Linear,
            compared_from_s: 0.5,
            level_sigma_v: 0.0,
            sigma_v: None,
            averaged_s: None,
        };
        let time = TimeBlock::new(&record, 0.0);
        let facts = Facts {
            lowest_hz: None,
            highest_hz: None,
            longest_s: 4.0,
            shortest_s: 0.1,
            greatest_a: 2.0,
            widest_soc: 0.1,
            soc: 0.5,
            temperature_c: 25.0,
            orders: 0.0,
            span_s: 0.0,
        };
        let erm = Erm {
            r_ohm: 0.02,
            branches: vec![RcBranch {
                r_ohm: 0.01,
                c_f: 1e5,
            }],
        };
        let base = Base {
            erm,
            ocv: OcvCurve::monotone(1.0, vec![0.0, 1.0], vec![3.0, 4.0]).unwrap(),
            facts,
        };
        let errors = of_record(&time, 0.5, &base);
        let (shift, lag) = (&errors[0].passing_v, &errors[1].passing_v);
        let first = time.bins.iter().position(|b| b.from == 10).unwrap();
        // Rows before 0.5 s are not compared, those before the edge know nothing of it.
        assert!(
            time.bins[0].from >= 5
                && shift[..first]
                    .iter()
                    .chain(&lag[..=first])
                    .all(|v| *v == 0.0),
            "{shift:?} {lag:?}"
        );
        let step_v = UNIFORM * 2.0 * 0.02;
        assert!(
            (shift[first] / step_v - 1.0).abs() < 1e-3 && shift[first + 1].abs() < 1e-3 * step_v,
            "{shift:?}"
        );
        assert!(
            (lag[first + 1] / step_v - (-1f64).exp()).abs() < 1e-9 && lag[first + 2] < 0.3 * step_v,
            "{lag:?}"
        );
        // 2 A for 0.1 s of a capacity of 1 Ah, on a slope of 1 V.
        let moved: Vec<f64> = errors[0]
            .change_v
            .iter()
            .zip(shift)
            .map(|(change, passing)| change - passing)
            .collect();
        let moved_v = UNIFORM * 0.2 / 3600.0;
        assert!(
            moved[..first].iter().all(|v| *v == 0.0)
                && moved[first..]
                    .iter()
                    .all(|v| (v / moved_v - 1.0).abs() < 1e-6),
            "{moved:?}"
        );
    }
}
