//! Cells that are not alike, wired to a pack, of a model of one point.
//!
//! Every cell is a source Eₖ = OCV − Σvⱼ behind Rₖ (its series resistance and its tab). Over a step
//! every current is linear; its end enters the branches linearly, so that the end of the step is the
//! same network with other Eₖ and Rₖ: implicit, second order, and no iteration. Temperatures follow
//! from the heat and do not change the resistances.

use super::thermal::{Heat, PackThermal, ThermalNetwork};
use super::wiring::{Cells, Left, Look, Sources, Wiring};
use crate::forward::{Demand, OcvSource};
use analysis_model::{map::BranchStep, model::Erm};

/// One cell in its place.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    pub(super) erm: Erm,
    /// Over that of the OCV curve.
    pub(super) capacity_ratio: f64,
    pub(super) soc: f64,
}

/// Cells, their wiring and their states.
pub(super) struct Network<'a> {
    ocv: &'a OcvSource,
    wiring: Wiring<'a>,
    /// Branches of a cell.
    rc: usize,
    r_ohm: Vec<f64>,
    branches: Vec<(f64, f64)>,
    capacity_coulomb: Vec<f64>,
    /// Steps of the branches of all cells, driven by currents: start and end are in Ω.
    gains: Vec<BranchStep>,
    gains_step_s: f64,
    pub(super) soc: Vec<f64>,
    v_rc: Vec<f64>,
    sources: Sources,
    /// At the start of the last step.
    start: Look,
    pub(super) now: Look,
    thermal: ThermalNetwork,
    /// Mean heat of the cells over a step, W.
    heat_w: Vec<f64>,
    unsettled: u64,
}

impl<'a> Network<'a> {
    /// Cells at rest, group by group.
    pub(super) fn new(
        cells: &[Cell],
        ocv: &'a OcvSource,
        wiring: Wiring<'a>,
        thermal: &PackThermal,
    ) -> Self {
        let n = cells.len();
        let rc = cells.first().map_or(0, |c| c.erm.branches.len());
        let capacity_coulomb = match ocv {
            OcvSource::Constant(_) => f64::INFINITY,
            OcvSource::Curve(curve) => 3600.0 * curve.capacity_ah,
        };
        Self {
            ocv,
            wiring,
            rc,
            r_ohm: cells.iter().map(|c| c.erm.r_ohm).collect(),
            branches: cells
                .iter()
                .flat_map(|c| c.erm.branches.iter().map(|b| (b.r_ohm, b.c_f)))
                .collect(),
            capacity_coulomb: cells
                .iter()
                .map(|c| capacity_coulomb * c.capacity_ratio)
                .collect(),
            gains: Vec::new(),
            gains_step_s: f64::NAN,
            soc: cells.iter().map(|c| c.soc).collect(),
            v_rc: vec![0.0; n * rc],
            sources: Sources::new(n),
            start: Look::new(n, &wiring),
            now: Look::new(n, &wiring),
            thermal: ThermalNetwork::new(thermal, n, wiring.parallel),
            heat_w: vec![0.0; n],
            unsettled: 0,
        }
    }

    fn ocv_at(&self, soc: f64) -> (f64, f64) {
        match self.ocv {
            OcvSource::Constant(v) => (*v, 0.0),
            OcvSource::Curve(curve) => curve.at(soc),
        }
    }

    fn cell_branches(&self, cell: usize) -> std::ops::Range<usize> {
        cell * self.rc..(cell + 1) * self.rc
    }

    /// Returns the energy in the capacitances, J.
    #[cfg(test)]
    pub(super) fn stored_j(&self) -> f64 {
        self.v_rc
            .iter()
            .zip(&self.branches)
            .map(|(v, (_, c))| 0.5 * c * v * v)
            .sum()
    }

    fn set_step(&mut self, step_s: f64) {
        // Steps read from a file differ by rounding in their last digits.
        if (step_s - self.gains_step_s).abs() <= 1e-12 * step_s {
            return;
        }
        self.gains_step_s = step_s;
        self.gains.clear();
        let gain = |&(r, c): &(f64, f64)| BranchStep::new(step_s, r * c).of_current(r);
        self.gains.extend(self.branches.iter().map(gain));
    }

    /// Warms the cells by the heat of the last step.
    fn warm(&mut self, step_s: f64) {
        let ends = [&self.start, &self.now];
        let interconnect_w = self.wiring.mean_heat_w(ends, &mut self.heat_w);
        let heat = Heat {
            cell_w: &self.heat_w,
            interconnect_w,
        };
        self.thermal.begin();
        self.thermal.end(step_s, heat);
        self.unsettled += u64::from(!self.thermal.settled());
    }
}

impl Cells for Network<'_> {
    fn look(&mut self, demand: Demand, value: f64) -> bool {
        for k in 0..self.soc.len() {
            let held: f64 = self.v_rc[self.cell_branches(k)].iter().sum();
            self.sources.e_v[k] = self.ocv_at(self.soc[k]).0 - held;
            self.sources.behind_ohm[k] = self.r_ohm[k] + self.wiring.tab_ohm;
        }
        let sound = self
            .wiring
            .share(&mut self.sources, demand, value, &mut self.now);
        for k in 0..self.soc.len() {
            let i = self.now.cell_a[k];
            self.now.cell_v[k] = self.sources.e_v[k] - self.r_ohm[k] * i;
            let branches = self.v_rc[self.cell_branches(k)]
                .iter()
                .zip(&self.branches[self.cell_branches(k)]);
            self.now.heat_w[k] =
                i * i * self.r_ohm[k] + branches.map(|(v, (r, _))| v * v / r).sum::<f64>();
        }
        sound
    }

    fn advance(&mut self, step_s: f64, demand: Demand, value: f64) -> bool {
        self.set_step(step_s);
        std::mem::swap(&mut self.start, &mut self.now);
        for k in 0..self.soc.len() {
            let (i0, range) = (self.start.cell_a[k], self.cell_branches(k));
            let gains = &self.gains[range.clone()];
            let held: f64 = gains
                .iter()
                .zip(&self.v_rc[range])
                .map(|(g, v)| g.decay * v + g.start * i0)
                .sum();
            let per_ampere = step_s / self.capacity_coulomb[k];
            // The curve is linearised about the point to which the current of the start alone would
            // lead.
            let (ocv, slope) = self.ocv_at(self.soc[k] - per_ampere * i0);
            let bend = 0.5 * slope * per_ampere;
            self.sources.behind_ohm[k] = self.r_ohm[k]
                + self.wiring.tab_ohm
                + bend
                + gains.iter().map(|g| g.end).sum::<f64>();
            self.sources.e_v[k] = ocv + bend * i0 - held;
        }
        let sound = self
            .wiring
            .share(&mut self.sources, demand, value, &mut self.now);
        for k in 0..self.soc.len() {
            let (i0, i1) = (self.start.cell_a[k], self.now.cell_a[k]);
            for j in self.cell_branches(k) {
                self.v_rc[j] = self.gains[j].end_v(self.v_rc[j], i0, i1);
            }
            self.soc[k] -= 0.5 * step_s * (i0 + i1) / self.capacity_coulomb[k];
        }
        let sound = sound && self.look(demand, value);
        self.warm(step_s);
        sound
    }

    fn now(&self) -> &Look {
        &self.now
    }

    fn soc(&self) -> &[f64] {
        &self.soc
    }

    fn thermal(&self) -> &ThermalNetwork {
        &self.thermal
    }

    fn left(&self) -> Option<Left> {
        None
    }

    fn unsettled(&self) -> u64 {
        self.unsettled
    }
}

#[cfg(test)]
mod tests;
