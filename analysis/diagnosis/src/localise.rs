//! Localisation of the misfit: whitened residuals outside the model's tangent space, by blocks.
//!
//! r⊥ = (I − QQᵀ)r with Q an orthonormal basis of the derivatives: no wrong parameter can cause
//! this residual. Each block of r⊥ is tested for its χ² (against the trace of I − QQᵀ over the
//! block) and for its mean. The smaller of both probabilities, doubled, is corrected after Holm
//! over all blocks.

use super::block::{Block as Run, Kind, Workspace};
use super::data::Role;
use super::outcome::Block;
use super::problem::{Fit, Problem, Tangent};
use crate::thresholds::{AFTER_EDGE_S, BLOCK_FEWEST_ROWS, REST_PART};
use analysis_fit::validity::tail::{chi2_tail, deviate_tail, holm};
use std::collections::BTreeMap;

/// One row's place: dimension, sorting key and part.
pub(super) type Place = (&'static str, u32, String);

/// Blocks of the training residuals of a fit, most significant first; `project` false leaves the
/// tangent space in.
pub(super) fn localise(
    problem: &Problem,
    fit: &Fit,
    project: bool,
    workspace: &mut Workspace,
) -> Vec<Block> {
    let tangent = if project {
        fit.tangent()
    } else {
        Tangent::default()
    };
    let mut residuals = fit.residuals.clone();
    tangent.project(&mut residuals);
    let mut cells: BTreeMap<Place, Sums> = BTreeMap::new();
    let mut row = 0;
    let ranges = Ranges::new(problem);
    for k in problem.of_role(Role::Train) {
        let run = &problem.blocks[k];
        let raw = raw(run, &problem.predict(fit.at(), k, 1, workspace));
        let at_edges = &problem.at_edges[k];
        for (n, raw) in raw.iter().enumerate() {
            let basis: Vec<f64> = tangent.basis.iter().map(|q| q[row]).collect();
            for place in places(run, n, &ranges) {
                cells.entry(place).or_default().add(
                    residuals[row],
                    &basis,
                    Raw {
                        residual: *raw,
                        at_edge: at_edges[n],
                    },
                );
            }
            row += 1;
        }
    }
    let mut blocks: Vec<Block> = cells
        .into_iter()
        .filter(|(_, s)| s.count >= BLOCK_FEWEST_ROWS)
        .map(|((dimension, _, part), s)| s.block(dimension, part))
        .collect();
    let corrected = holm(&blocks.iter().map(|b| b.p_value).collect::<Vec<f64>>());
    blocks
        .iter_mut()
        .zip(corrected)
        .for_each(|(b, p)| b.p_value = p);
    blocks.sort_by(|a, b| {
        a.p_value
            .total_cmp(&b.p_value)
            .then((b.chi2 / b.expected_chi2).total_cmp(&(a.chi2 / a.expected_chi2)))
    });
    blocks
}

/// Residuals before whitening: V for a record, part of |Z| for a spectrum.
fn raw(run: &Run, predicted: &[f64]) -> Vec<f64> {
    let scale = |n: usize| match &run.kind {
        Kind::Eis { .. } => run.impedance_ohm(n).recip(),
        Kind::Time(_) => 1.0,
    };
    run.measured
        .iter()
        .zip(predicted)
        .enumerate()
        .map(|(n, (m, p))| (m - p) * scale(n))
        .collect()
}

/// Residual before whitening.
#[derive(Clone, Copy)]
struct Raw {
    residual: f64,
    at_edge: bool,
}

#[derive(Default)]
struct Sums {
    count: usize,
    chi2: f64,
    expected: f64,
    sum: f64,
    /// Sum of the squares of all rows.
    square: f64,
    /// Number and sum of the squares of the rows beside edges.
    beside_edges: (usize, f64),
    /// Sum of each vector of the tangent space's basis over the block.
    along: Vec<f64>,
}

impl Sums {
    fn add(&mut self, r: f64, basis: &[f64], raw: Raw) {
        self.count += 1;
        self.chi2 += r * r;
        self.expected += 1.0 - basis.iter().map(|q| q * q).sum::<f64>();
        self.along.resize(basis.len(), 0.0);
        self.along.iter_mut().zip(basis).for_each(|(a, q)| *a += q);
        self.sum += r;
        let square = raw.residual * raw.residual;
        self.square += square;
        if !raw.at_edge {
            self.beside_edges.0 += 1;
            self.beside_edges.1 += square;
        }
    }

    fn block(&self, dimension: &'static str, part: String) -> Block {
        let expected = self.expected.max(1e-9);
        // Variance of the sum: 1ᵀ(I − QQᵀ)1 over the block; it is zero if the model can move all of
        // it together.
        let variance = self.count as f64 - self.along.iter().map(|a| a * a).sum::<f64>();
        let mean_z = if variance > 1e-6 * self.count as f64 {
            self.sum / variance.sqrt()
        } else {
            0.0
        };
        let p =
            (2.0 * chi2_tail(self.chi2, expected).min(deviate_tail(mean_z.abs(), None))).min(1.0);
        // At an edge the residual shows when the current changed.
        let (count, square) = match self.beside_edges {
            (0, _) => (self.count, self.square),
            beside => beside,
        };
        let rms = 1e3 * (square / count as f64).sqrt();
        Block {
            dimension,
            part,
            count: self.count,
            chi2: self.chi2,
            expected_chi2: self.expected,
            mean_z,
            p_value: p,
            rms,
        }
    }
}

/// Ranges that the limits of the blocks are taken from.
pub(super) struct Ranges {
    lowest_hz: f64,
    highest_hz: f64,
    greatest_a: f64,
    socs: (f64, f64),
    temperatures_degc: (f64, f64),
    orders: (f64, f64),
    greatest_coulomb: f64,
}

impl Ranges {
    pub(super) fn new(problem: &Problem) -> Self {
        let span = |pick: &dyn Fn(&Run) -> f64| {
            problem
                .of_role(Role::Train)
                .map(|k| pick(&problem.blocks[k]))
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
                    (a.min(v), b.max(v))
                })
        };
        let f = &problem.base.facts;
        Self {
            lowest_hz: f.lowest_hz.unwrap_or(1.0),
            highest_hz: f.highest_hz.unwrap_or(1.0),
            greatest_a: f.greatest_a,
            socs: span(&|b| b.at.soc),
            temperatures_degc: span(&|b| b.at.temperature_degc),
            orders: span(&|b| b.at.order),
            greatest_coulomb: 3600.0 * problem.base.ocv.capacity_ah * f.widest_soc,
        }
    }
}

/// Places of the rows of a run, in every dimension that separates runs or rows.
pub(super) fn places(run: &Run, n: usize, ranges: &Ranges) -> Vec<Place> {
    let mut places = Vec::with_capacity(8);
    let third = |x: f64, (low, high): (f64, f64)| (((x - low) / (high - low) * 3.0) as u32).min(2);
    let mut thirds = |dimension: &'static str, x: f64, span: (f64, f64), unit: &str| {
        // If all values are alike, there is nothing to separate.
        if span.1 - span.0 > 1e-6 * span.1.abs().max(1e-9) {
            let t = third(x, span);
            let edge = |k: u32| span.0 + (span.1 - span.0) * f64::from(k) / 3.0;
            places.push((
                dimension,
                t,
                format!("{:.3} to {:.3}{unit}", edge(t), edge(t + 1)),
            ));
        }
    };
    thirds("state of charge at the start", run.at.soc, ranges.socs, "");
    thirds(
        "temperature",
        run.at.temperature_degc,
        ranges.temperatures_degc,
        " °C",
    );
    thirds("run order", run.at.order, ranges.orders, "");
    match &run.kind {
        Kind::Eis {
            points,
            harmonics,
            control_ohm,
            ..
        } => {
            let harmonic = (n / 2).checked_sub(points.len()).map(|h| harmonics[h]);
            let freq_hz = harmonic.map_or_else(|| points[n / 2].freq_hz, |h| h.at.freq_hz);
            let at = (freq_hz / ranges.lowest_hz).ln()
                / (ranges.highest_hz / ranges.lowest_hz).ln().max(1e-9);
            let band = ((at * 3.0) as u32).min(2);
            let part = if n.is_multiple_of(2) {
                "real"
            } else {
                "imaginary"
            };
            let edge = |k: u32| {
                ranges.lowest_hz * (ranges.highest_hz / ranges.lowest_hz).powf(f64::from(k) / 3.0)
            };
            if let Some(h) = harmonic {
                let name = if h.order == 2 { "second" } else { "third" };
                places.push((
                    "harmonic",
                    3 * (h.order - 2) + band,
                    format!("{name}, {:.3} to {:.3} Hz", edge(band), edge(band + 1)),
                ));
                return places;
            }
            let of = if control_ohm.is_some() {
                "control, "
            } else {
                ""
            };
            let order = 4 * band + u32::from(n % 2 == 1) * 2 + u32::from(control_ohm.is_some());
            places.push((
                "frequency",
                order,
                format!(
                    "{of}{:.3} to {:.3} Hz, {part} part",
                    edge(band),
                    edge(band + 1)
                ),
            ));
        }
        Kind::Time(time) => {
            let b = &time.bins[n];
            let resting = b.current_a.abs() < REST_PART * ranges.greatest_a;
            let (order, part) = match b.since_edge_s {
                t if t < AFTER_EDGE_S[0] => (0, "below 10 ms"),
                t if t < AFTER_EDGE_S[1] => (1, "10 to 100 ms"),
                t if t < AFTER_EDGE_S[2] => (2, "0.1 to 1 s"),
                t if t < AFTER_EDGE_S[3] => (3, "1 to 5 s"),
                t if t < AFTER_EDGE_S[4] => (4, "5 to 60 s"),
                _ => (5, "beyond 60 s"),
            };
            let phase = if resting { "rest" } else { "under current" };
            places.push((
                "time since edge",
                2 * order + u32::from(resting),
                format!("{part}, {phase}"),
            ));
            if !resting {
                let t = third(b.current_a.abs(), (0.0, ranges.greatest_a));
                let edge = |k: u32| ranges.greatest_a * f64::from(k) / 3.0;
                places.push((
                    "current",
                    t,
                    format!("{:.1} to {:.1} A", edge(t), edge(t + 1)),
                ));
            }
            if b.last_current_a != 0.0 {
                let (order, sign) = if b.last_current_a > 0.0 {
                    (0, "discharge")
                } else {
                    (1, "charge")
                };
                places.push(("sign", order, format!("{sign} or the rest after it")));
            }
            let t = third(
                b.charge_coulomb.abs(),
                (0.0, ranges.greatest_coulomb.max(1e-9)),
            );
            let edge = |k: u32| ranges.greatest_coulomb * f64::from(k) / 3.0;
            places.push((
                "charge passed",
                t,
                format!("{:.0} to {:.0} C", edge(t), edge(t + 1)),
            ));
        }
    }
    places
}
