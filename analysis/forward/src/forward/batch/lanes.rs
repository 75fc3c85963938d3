//! W cells side by side: everything the inner loop touches, a list of W numbers each.

use super::cell::{BatchCell, BatchOutcome};
use super::ocv_piece::{LaneCurve, OcvPiece, Row};
use super::plan::Plan;
use super::tally::Tally;
use crate::forward::law::Beyond;
use crate::forward::model::{OcvSource, SimState};
use crate::forward::step::Gain;

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
        let branches = cell.state.v_rc_v.len();
        let end = SimState {
            soc: self.now.soc[l],
            v_rc_v: self.now.v.iter().take(branches).map(|v| v[l]).collect(),
            temperature_degc: None,
        };
        self.now.tally.outcome(l, cell, plan, end, None)
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
