//! What a batch keeps of a run.

use super::cell::{BatchCell, BatchOutcome};
use super::law::{less, more};
use super::ocv_piece::Row;
use super::plan::Plan;
use crate::forward::law::Demand;
use crate::forward::model::SimState;
use analysis_model::map::Outside;

/// A lane at an instant.
#[derive(Debug, Clone, Copy)]
pub(super) struct Source {
    /// E = OCV − Σv, V.
    pub(super) e_v: f64,
    /// Current, A.
    pub(super) current_a: f64,
    /// Series resistance, Ω, and the interconnect's part of it.
    pub(super) r_ohm: f64,
    pub(super) interconnect_ohm: f64,
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

impl<const W: usize> Tally<W> {
    pub(super) fn new() -> Self {
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

    /// Adds a step of one lane from its start and end.
    #[inline(always)]
    pub(super) fn add(&mut self, l: usize, step_s: f64, start: Source, end: Source) {
        let (i0, i1) = (start.current_a, end.current_a);
        let (ccv0, ccv1) = (start.e_v - start.r_ohm * i0, end.e_v - end.r_ohm * i1);
        self.charge[l] += 0.5 * step_s * (i0 + i1);
        self.energy[l] += 0.5 * step_s * (i0 * ccv0 + i1 * ccv1);
        let (inner0, inner1) = (
            ccv0 + start.interconnect_ohm * i0,
            ccv1 + end.interconnect_ohm * i1,
        );
        self.min_ccv[l] = less(self.min_ccv[l], less(ccv0, ccv1));
        self.max_ccv[l] = more(self.max_ccv[l], more(ccv0, ccv1));
        self.min_inner[l] = less(self.min_inner[l], less(inner0, inner1));
        self.max_inner[l] = more(self.max_inner[l], more(inner0, inner1));
        self.least_e[l] = less(self.least_e[l], less(start.e_v, end.e_v));
    }

    /// Returns the result of a lane from its state at the end and, of a map, how far it was outside.
    pub(super) fn outcome(
        &self,
        l: usize,
        cell: &BatchCell<'_>,
        plan: &Plan<'_>,
        end: SimState,
        outside_map: Option<Outside>,
    ) -> BatchOutcome {
        let first = self.infeasible[l];
        let infeasible_s = first.is_finite().then(|| plan.time_s(first as u64));
        let series = f64::from(cell.model.pack.series);
        BatchOutcome {
            min_ccv_v: self.min_ccv[l],
            max_ccv_v: self.max_ccv[l],
            min_cell_v: self.min_inner[l] / series,
            max_cell_v: self.max_inner[l] / series,
            energy_j: self.energy[l],
            charge_coulomb: self.charge[l],
            infeasible_s: infeasible_s.filter(|_| plan.demand == Demand::Power),
            end,
            collapsed: plan.demand == Demand::Power && self.least_e[l] <= 0.0,
            outside_map,
        }
    }
}
