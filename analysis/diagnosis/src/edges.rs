//! Errors that a logger leaves at an edge of the current, where the current is interpolated between
//! samples: the time of the edge, and the state of the channels at it. Each error is given as
//! changes of a record's rows by one standard deviation.
//!
//! An edge may lie anywhere between two samples. A branch's voltage is not a linear function of
//! that position: five positions (Gauss–Lobatto), each with its weight, reproduce its second
//! moments over all positions. Both ends are among them, because a logger that starts its rows at
//! steps has its edges there, and branches far faster than the rows then show. A record with a row
//! a second and a step of 100 A differs from a straight line by five times its noise.
//!
//! A logger that starts with a step of the current has all edges at the same position; one whose
//! rows run free has all edges of a record in common; another one has no edges in common. The data
//! do not identify the type of logger. So each edge, each record and all runs together have half of
//! the variance: any two of them make it whole.

use super::time_block::{Bin, TimeBlock};
use analysis_effects::contract::Base;

/// 1/√12: standard deviation of a uniform error of one code, and of an edge anywhere between two
/// samples.
pub(super) const UNIFORM: f64 = 0.288_675_134_594_812_9;

/// A place between two samples.
#[derive(Clone, Copy)]
struct Place {
    /// Part of the way.
    part: f64,
    /// Root of its weight.
    weight: f64,
}

const PLACES: [Place; 5] = [
    Place {
        part: 0.0,
        weight: 0.223_606_797_749_979,
    },
    Place {
        part: 0.172_673_164_646_011,
        weight: 0.521_749_194_749_951,
    },
    Place {
        part: 0.5,
        weight: 0.596_284_793_999_944,
    },
    Place {
        part: 0.827_326_835_353_989,
        weight: 0.521_749_194_749_951,
    },
    Place {
        part: 1.0,
        weight: 0.223_606_797_749_979,
    },
];

/// Errors that all edges may have in common: of each place, and of a channel that averages.
pub(super) const COMMON: usize = PLACES.len() + 1;

/// The errors of an edge: changes of the rows, V.
#[derive(Debug, Clone)]
pub(super) struct EdgeErrors {
    /// Errors that all edges may have in common, in the order of [`COMMON`]: the half that this
    /// edge has alone, and an equal part that it shares with the record and with all records.
    pub(super) common_v: [Vec<f64>; COMMON],
    /// The first sample.
    pub(super) first_v: Vec<f64>,
    /// Variance from the decaying parts of the branches, of the three halves together, V².
    pub(super) passing_v2: Vec<f64>,
}

/// Returns the errors of all edges of a record that starts at a state of charge; its first sample
/// does not count as an edge.
pub(super) fn of_record(time: &TimeBlock, soc: f64, base: &Base) -> Vec<EdgeErrors> {
    let edges = time.edges.iter().skip(1);
    edges
        .map(|edge| {
            let passing = PLACES.map(|place| shift(time, *edge, place, base));
            let (first_v, late) = (first(time, *edge, base), lag(time, *edge, base));
            let all = passing.iter().chain([&first_v, &late]);
            let mut passing_v2 = vec![0.0; first_v.len()];
            all.for_each(|error| {
                passing_v2
                    .iter_mut()
                    .zip(error)
                    .for_each(|(v2, e)| *v2 += e * e);
            });
            let moved = charge(time, *edge, soc, base);
            let mut common_v = std::array::from_fn(|k| match PLACES.get(k) {
                Some(place) => moved
                    .iter()
                    .zip(&passing[k])
                    .map(|(m, p)| p + place.weight * (0.5 - place.part) * m)
                    .collect(),
                None => Vec::new(),
            });
            common_v[PLACES.len()] = late;
            let all = common_v.iter_mut().flatten();
            all.for_each(|v| *v *= std::f64::consts::FRAC_1_SQRT_2);
            passing_v2.iter_mut().for_each(|v2| *v2 *= 1.5);
            EdgeErrors {
                common_v,
                first_v,
                passing_v2,
            }
        })
        .collect()
}

/// The samples of a row from one on.
struct Later {
    /// Part of the row's samples.
    part: f64,
    /// Their mean time, s; that of the first edge if there are none.
    time_s: f64,
}

fn later(time: &TimeBlock, row: &Bin, first: usize) -> Later {
    let from = row.from.max(first);
    let count = row.to.saturating_sub(from);
    if count == 0 {
        let first = first.min(time.time_s.len() - 1);
        return Later {
            part: 0.0,
            time_s: time.time_s[first],
        };
    }
    Later {
        part: count as f64 / (row.to - row.from) as f64,
        time_s: time.time_s[from..row.to].iter().sum::<f64>() / count as f64,
    }
}

/// Returns the change of the later rows' open-circuit voltage for an edge that comes earlier by the
/// distance of the samples about it: the charge that flows in between.
fn charge(time: &TimeBlock, edge: usize, soc: f64, base: &Base) -> Vec<f64> {
    let (step_s, step_a) = (
        time.time_s[edge] - time.time_s[edge - 1],
        time.current_a[edge] - time.current_a[edge - 1],
    );
    let capacity_coulomb = 3600.0 * base.ocv.capacity_ah;
    time.bins
        .iter()
        .map(|b| {
            let slope_v = base.ocv.slope_v(soc - b.charge_coulomb / capacity_coulomb);
            later(time, b, edge).part * step_a * step_s / capacity_coulomb * slope_v
        })
        .collect()
}

/// Returns the change of the branch voltages in the later rows for an edge at a position, relative
/// to the mean over all positions, times the root of the position's weight.
fn shift(time: &TimeBlock, edge: usize, place: Place, base: &Base) -> Vec<f64> {
    let (step_s, step_a) = (
        time.time_s[edge] - time.time_s[edge - 1],
        time.current_a[edge] - time.current_a[edge - 1],
    );
    time.bins
        .iter()
        .map(|b| {
            let later = later(time, b, edge);
            let t = later.time_s - time.time_s[edge];
            let change = |tau_s: f64| {
                let mean = tau_s / step_s * -(-step_s / tau_s).exp_m1();
                (-t / tau_s).exp() * (mean - (-(1.0 - place.part) * step_s / tau_s).exp())
            };
            let branches = base.erm.branches.iter();
            let branches = branches.map(|b| b.r_ohm * change(b.time_constant_s()));
            later.part * place.weight * step_a * branches.sum::<f64>()
        })
        .collect()
}

/// Returns the change of the first sample after an edge, one standard deviation: it may be read
/// while the current still changes. Its voltage may then lack any part of the drop of the series
/// resistance and of the branches that are faster than the samples.
fn first(time: &TimeBlock, edge: usize, base: &Base) -> Vec<f64> {
    let (step_s, step_a) = (
        time.time_s[edge] - time.time_s[edge - 1],
        time.current_a[edge] - time.current_a[edge - 1],
    );
    let branches = base.erm.branches.iter();
    let fast_ohm = branches.map(|b| b.r_ohm * -(-step_s / b.time_constant_s()).exp_m1());
    let drop_v = step_a * (base.erm.r_ohm + fast_ohm.sum::<f64>());
    time.bins
        .iter()
        .map(|b| {
            if b.from <= edge && edge < b.to {
                UNIFORM * drop_v / (b.to - b.from) as f64
            } else {
                0.0
            }
        })
        .collect()
}

/// Returns the change of the later rows for a logger whose voltage channel averages over about a
/// sampling interval, one standard deviation. The drop of the series resistance at the edge comes
/// late and decays by a factor e per interval.
fn lag(time: &TimeBlock, edge: usize, base: &Base) -> Vec<f64> {
    let (step_s, step_a) = (
        time.time_s[edge] - time.time_s[edge - 1],
        time.current_a[edge] - time.current_a[edge - 1],
    );
    let late = |b: &Bin| {
        let later = later(time, b, edge + 1);
        later.part * ((time.time_s[edge] - later.time_s) / step_s).exp()
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

    const FACTS: Facts = Facts {
        lowest_hz: None,
        highest_hz: None,
        longest_s: 4.0,
        shortest_s: 0.1,
        greatest_a: 2.0,
        widest_soc: 0.1,
        soc: 0.5,
        temperature_degc: 25.0,
        orders: 0.0,
        span_s: 0.0,
        held_out: None,
    };

    #[test]
    fn the_first_sample_may_lack_the_whole_step_and_the_next_what_comes_late() {
        let time_s: Vec<f64> = (0..40).map(|k| 0.1 * f64::from(k)).collect();
        let current_a: Vec<f64> = (0..40).map(|k| if k < 10 { 0.0 } else { 2.0 }).collect();
        let series = TimeSeries {
            name: "s".to_owned(),
            voltage_v: vec![3.7; 40],
            current_a,
            time_s,
            temperature_degc: None,
        };
        let record = TimeRecord {
            series,
            between: Between::Linear,
            compared_from_s: 0.5,
            level_sigma_v: 0.0,
            sigma_v: None,
            averaged_s: None,
            current_errors_a: Vec::new(),
        };
        let time = TimeBlock::new(&record, 0.0);
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
            facts: FACTS,
        };
        let errors = &of_record(&time, 0.5, &base)[0];
        let (first_v, lag) = (&errors.first_v, &errors.common_v[PLACES.len()]);
        let first = time.bins.iter().position(|b| b.from == 10).unwrap();
        // Rows before 0.5 s are not compared, and those before the edge do not depend on it.
        assert!(
            time.bins[0].from >= 5
                && errors.passing_v2[..first].iter().all(|v2| *v2 == 0.0)
                && lag[..=first].iter().all(|v| *v == 0.0),
            "{errors:?}"
        );
        let (step_v, part) = (UNIFORM * 2.0 * 0.02, std::f64::consts::FRAC_1_SQRT_2);
        assert!(
            (first_v[first] / step_v - 1.0).abs() < 1e-3 && first_v[first + 1] == 0.0,
            "{first_v:?}"
        );
        assert!(
            (lag[first + 1] / step_v - part * (-1f64).exp()).abs() < 1e-9
                && lag[first + 2] < 0.3 * step_v,
            "{lag:?}"
        );
        // 2 A for 0.1 s of a capacity of 1 Ah, on a slope of 1 V, and in the branch of 100 kF: 1/√12
        // of it over all places, half of its variance.
        let moved_v2 = |row: usize| -> f64 {
            let places = errors.common_v[..PLACES.len()].iter();
            places.map(|v| v[row].powi(2)).sum()
        };
        let moved_v = part * UNIFORM * 0.2 * (1.0 / 3600.0 + 1e-5);
        assert!((0..first).all(|row| moved_v2(row) == 0.0));
        let last = time.bins.len() - 1;
        assert!(
            (moved_v2(last).sqrt() / moved_v - 1.0).abs() < 1e-3,
            "{}",
            moved_v2(last).sqrt()
        );
    }

    #[test]
    fn a_step_anywhere_between_two_rows_lies_in_the_span_of_its_places() {
        let time_s: Vec<f64> = (0..30).map(f64::from).collect();
        let current_a = time_s.iter().map(|t| if *t < 5.0 { 0.0 } else { 100.0 });
        let series = TimeSeries {
            name: "s".to_owned(),
            voltage_v: vec![3.7; 30],
            current_a: current_a.collect(),
            time_s,
            temperature_degc: None,
        };
        let record = TimeRecord {
            series,
            between: Between::Linear,
            compared_from_s: 0.0,
            level_sigma_v: 0.0,
            sigma_v: None,
            averaged_s: None,
            current_errors_a: Vec::new(),
        };
        let time = TimeBlock::new(&record, 0.0);
        let branch = |r_ohm: f64, tau_s: f64| RcBranch {
            r_ohm,
            c_f: tau_s / r_ohm,
        };
        let (fast, slow) = (branch(0.003, 1.5), branch(0.004, 20.0));
        let base = Base {
            erm: Erm {
                r_ohm: 0.01,
                branches: vec![fast, slow],
            },
            ocv: OcvCurve::monotone(4.5, vec![0.0, 1.0], vec![3.0, 4.0]).unwrap(),
            facts: FACTS,
        };
        let errors = &of_record(&time, 0.5, &base)[0];
        for place in [0.0, 0.2, 0.5, 0.8, 1.0] {
            // Voltage of the cell beyond the prediction for a ramp of the current from 4 to 5 s.
            let drop = |b: &RcBranch, t: f64| {
                let tau_s = b.time_constant_s();
                let ramp = tau_s * -(-1.0 / tau_s).exp_m1() * (-(t - 5.0) / tau_s).exp();
                100.0 * b.r_ohm * (ramp - (-(t - 4.0 - place) / tau_s).exp())
            };
            let charge_v = 100.0 * (0.5 - place) / (3600.0 * 4.5);
            let wanted: Vec<f64> = time
                .bins
                .iter()
                .map(|b| {
                    let is_after = f64::from(b.from >= 5);
                    is_after * (drop(&fast, b.time_s) + drop(&slow, b.time_s) + charge_v)
                })
                .collect();
            let most = |v: &[f64]| v.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let left = rest_beside(&wanted, &errors.common_v[..PLACES.len()]);
            let line = rest_beside(&wanted, &errors.common_v[..1]);
            assert!(
                most(&left) < 0.1e-3 && (place == 0.0 || most(&line) > 10.0 * most(&left)),
                "{place}: of {} V {} V are left, {} V beside a line",
                most(&wanted),
                most(&left),
                most(&line)
            );
        }
    }

    /// Rest of values beside a span (Gram–Schmidt).
    fn rest_beside(values: &[f64], span: &[Vec<f64>]) -> Vec<f64> {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut axes: Vec<Vec<f64>> = Vec::new();
        let less = |v: &[f64], axes: &[Vec<f64>]| {
            let mut v = v.to_vec();
            for axis in axes {
                let part = dot(axis, &v);
                v.iter_mut().zip(axis).for_each(|(v, a)| *v -= part * a);
            }
            v
        };
        for v in span {
            let v = less(v, &axes);
            let size = dot(&v, &v).sqrt();
            if size > 1e-9 {
                axes.push(v.iter().map(|v| v / size).collect());
            }
        }
        less(values, &axes)
    }
}
