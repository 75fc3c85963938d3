//! W cells side by side: everything the inner loop touches, a list of W numbers each.

use super::plan::Plan;
use super::{BatchCell, BatchOutcome};
use crate::forward::law::{Beyond, Demand};
use crate::forward::model::{OcvSource, SimState};
use crate::forward::step::Gain;
use analysis_model::ocv::OcvCurve;

/// One number per cell.
pub(super) type Row<const W: usize> = [f64; W];

/// Action of one step length on each cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneGains<const W: usize, const N: usize> {
    pub(super) decay: [Row<W>; N],
    pub(super) start: [Row<W>; N],
    pub(super) end: [Row<W>; N],
    /// Σ of `start` and `end` over the branches, Ω.
    pub(super) held: Row<W>,
    /// Σ of `end` over the branches, Ω.
    pub(super) ends: Row<W>,
    /// `start` + `end`, Ω.
    pub(super) both: [Row<W>; N],
    /// `end`/2R.
    pub(super) end_share: [Row<W>; N],
    /// `held` and `ends` per 2R: the effect of a volt of the root.
    pub(super) held_share: Row<W>,
    pub(super) ends_share: Row<W>,
    /// SOC per ampere over the step.
    pub(super) soc: Row<W>,
    pub(super) step_s: f64,
}

/// A cubic piece of the OCV at the terminals: c₀ + t(c₁ + t(c₂ + t·c₃)), t = (SOC − origin)·rate.
#[derive(Debug, Clone, Copy)]
pub(super) struct OcvPiece<const W: usize> {
    pub(super) c: [Row<W>; 4],
    pub(super) origin: Row<W>,
    pub(super) rate: Row<W>,
    /// The SOC for which the piece is meant.
    pub(super) from: Row<W>,
    pub(super) to: Row<W>,
}

/// The OCV curve of a lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneCurve<'a> {
    /// Curve of one cell.
    curve: &'a OcvCurve,
    /// Cells in series.
    series: f64,
}

#[derive(Debug, Clone)]
pub(super) struct Lanes<'a, const W: usize, const N: usize> {
    pub(super) r: Row<W>,
    /// 1/2R.
    pub(super) half: Row<W>,
    /// 4R times the scale: the part of a demand under the root.
    pub(super) asked: Row<W>,
    pub(super) interconnect: Row<W>,
    pub(super) scale: Row<W>,
    /// 1/c and (1 − c)²/4cR of the tangent, c = √(1 − P₀/P*).
    pub(super) tangent: (f64, Row<W>),
    pub(super) now: Now<W, N>,
    pub(super) ocv: OcvPiece<W>,
    pub(super) curves: [Option<LaneCurve<'a>>; W],
    pub(super) gains: Vec<LaneGains<W, N>>,
}

/// State that changes with every step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Now<const W: usize, const N: usize> {
    pub(super) v: [Row<W>; N],
    pub(super) soc: Row<W>,
    /// OCV − Σvₖ, V.
    pub(super) e: Row<W>,
    pub(super) tally: Tally<W>,
}

/// Extremes and sums that are kept of the run.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tally<const W: usize> {
    pub(super) min_ccv: Row<W>,
    pub(super) max_ccv: Row<W>,
    /// With the interconnect's share given back.
    pub(super) min_inner: Row<W>,
    pub(super) max_inner: Row<W>,
    pub(super) least_e: Row<W>,
    pub(super) energy: Row<W>,
    pub(super) charge: Row<W>,
    /// First step with too much power, as a number.
    pub(super) infeasible: Row<W>,
}

impl<'a, const W: usize, const N: usize> Lanes<'a, W, N> {
    /// Lanes beyond the last cell repeat it.
    pub(super) fn new(cells: &[BatchCell<'a>], plan: &Plan<'_>) -> Self {
        let cell = |l: usize| cells[l.min(cells.len() - 1)];
        let row =
            |f: &dyn Fn(BatchCell<'a>) -> f64| -> Row<W> { std::array::from_fn(|l| f(cell(l))) };
        let c = if let Beyond::Extrapolate { fraction } = plan.beyond {
            (1.0 - fraction).sqrt()
        } else {
            1.0
        };
        let r = row(&|c| c.model.erm.r_ohm);
        let flat = OcvPiece {
            c: [
                row(&|c| c.model.ocv_v(c.state.soc).0),
                [0.0; W],
                [0.0; W],
                [0.0; W],
            ],
            origin: [0.0; W],
            rate: [1.0; W],
            from: [f64::NEG_INFINITY; W],
            to: [f64::INFINITY; W],
        };
        let curves = std::array::from_fn(|l| match &cell(l).model.ocv {
            OcvSource::Curve(curve) => Some(LaneCurve {
                curve,
                series: f64::from(cell(l).model.pack.series),
            }),
            OcvSource::Constant(_) => None,
        });
        let mut lanes = Self {
            r,
            half: r.map(|r| 0.5 / r),
            asked: row(&|c| 4.0 * c.model.erm.r_ohm * c.scale),
            interconnect: row(&|c| c.model.pack.interconnect_ohm),
            scale: row(&|c| c.scale),
            tangent: (1.0 / c, r.map(|r| (1.0 - c) * (1.0 - c) / (4.0 * c * r))),
            now: Now {
                v: std::array::from_fn(|k| row(&|c| c.state.v_rc_v.get(k).copied().unwrap_or(0.0))),
                soc: row(&|c| c.state.soc),
                e: row(&|c| c.model.ocv_v(c.state.soc).0 - c.state.v_rc_v.iter().sum::<f64>()),
                tally: Tally::new(),
            },
            ocv: flat,
            curves,
            gains: plan.lengths_s.iter().map(|h| gains(&cell, *h)).collect(),
        };
        lanes.find_pieces();
        lanes
    }

    /// Moves every lane to the piece of its curve in which it now is.
    #[cold]
    pub(super) fn find_pieces(&mut self) {
        for l in 0..W {
            if let Some(lane) = self.curves[l] {
                self.ocv.set(l, lane, self.now.soc[l]);
                let branches: f64 = self.now.v.iter().map(|v| v[l]).sum();
                self.now.e[l] = lane.series * lane.curve.voltage_v(self.now.soc[l]) - branches;
            }
        }
    }

    pub(super) fn outcome(&self, l: usize, cell: &BatchCell<'_>, plan: &Plan<'_>) -> BatchOutcome {
        let t = &self.now.tally;
        let first = t.infeasible[l];
        let infeasible_s = first.is_finite().then(|| plan.time_s(first as u64));
        let series = f64::from(cell.model.pack.series);
        let branches = cell.state.v_rc_v.len();
        BatchOutcome {
            min_ccv_v: t.min_ccv[l],
            max_ccv_v: t.max_ccv[l],
            min_cell_v: t.min_inner[l] / series,
            max_cell_v: t.max_inner[l] / series,
            energy_j: t.energy[l],
            charge_coulomb: t.charge[l],
            infeasible_s: infeasible_s.filter(|_| plan.demand == Demand::Power),
            end: SimState {
                soc: self.now.soc[l],
                v_rc_v: self.now.v.iter().take(branches).map(|v| v[l]).collect(),
                temperature_degc: None,
            },
            collapsed: plan.demand == Demand::Power && t.least_e[l] <= 0.0,
        }
    }
}

impl<const W: usize> Tally<W> {
    fn new() -> Self {
        let (most, least) = ([f64::INFINITY; W], [f64::NEG_INFINITY; W]);
        Self {
            min_ccv: most,
            max_ccv: least,
            min_inner: most,
            max_inner: least,
            least_e: most,
            energy: [0.0; W],
            charge: [0.0; W],
            infeasible: most,
        }
    }
}

impl<const W: usize> OcvPiece<W> {
    fn set(&mut self, l: usize, lane: LaneCurve<'_>, soc: f64) {
        let LaneCurve { curve, series } = lane;
        let last = curve.soc.len() - 1;
        let (first_soc, last_soc) = (curve.soc[0], curve.soc[last]);
        if soc <= first_soc || soc >= last_soc {
            let low = soc <= first_soc;
            let (k, from, to) = if low {
                (0, f64::NEG_INFINITY, first_soc)
            } else {
                (last, last_soc, f64::INFINITY)
            };
            self.put(
                l,
                [curve.ocv_v[k] * series, curve.slope_v[k] * series, 0.0, 0.0],
            );
            (self.origin[l], self.rate[l]) = (curve.soc[k], 1.0);
            (self.from[l], self.to[l]) = (from, to);
            return;
        }
        let k = curve.soc.partition_point(|z| *z <= soc).clamp(1, last) - 1;
        let h = curve.soc[k + 1] - curve.soc[k];
        let (m0, m1) = (h * curve.slope_v[k], h * curve.slope_v[k + 1]);
        let rise = curve.ocv_v[k + 1] - curve.ocv_v[k];
        let c = [
            curve.ocv_v[k],
            m0,
            3.0 * rise - 2.0 * m0 - m1,
            m0 + m1 - 2.0 * rise,
        ];
        self.put(l, c.map(|c| c * series));
        (self.origin[l], self.rate[l]) = (curve.soc[k], 1.0 / h);
        (self.from[l], self.to[l]) = (curve.soc[k], curve.soc[k + 1]);
    }

    fn put(&mut self, l: usize, c: [f64; 4]) {
        self.c.iter_mut().zip(c).for_each(|(row, c)| row[l] = c);
    }
}

fn gains<'a, const W: usize, const N: usize>(
    cell: &impl Fn(usize) -> BatchCell<'a>,
    step_s: f64,
) -> LaneGains<W, N> {
    let none = Gain {
        decay: 0.0,
        start: 0.0,
        end: 0.0,
        phi: 0.0,
    };
    let gain = |k: usize, l: usize| {
        cell(l)
            .model
            .erm
            .branches
            .get(k)
            .map_or(none, |b| Gain::new(b.r_ohm, b.c_f, step_s))
    };
    let gain: [[Gain; W]; N] = std::array::from_fn(|k| std::array::from_fn(|l| gain(k, l)));
    let held = std::array::from_fn(|l| gain.iter().map(|row| row[l].start + row[l].end).sum());
    let ends = std::array::from_fn(|l| gain.iter().map(|row| row[l].end).sum());
    let share = |row: &Row<W>| std::array::from_fn(|l| row[l] * 0.5 / cell(l).model.erm.r_ohm);
    LaneGains {
        decay: gain.map(|row| row.map(|g| g.decay)),
        start: gain.map(|row| row.map(|g| g.start)),
        end: gain.map(|row| row.map(|g| g.end)),
        both: gain.map(|row| row.map(|g| g.start + g.end)),
        end_share: gain.map(|row| share(&row.map(|g| g.end))),
        held_share: share(&held),
        ends_share: share(&ends),
        held,
        ends,
        soc: std::array::from_fn(|l| step_s / cell(l).model.capacity_coulomb()),
        step_s,
    }
}
