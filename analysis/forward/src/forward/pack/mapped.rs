//! Cells that are not alike, wired to a pack, whose resistances follow a map.
//!
//! Each cell has its own state of charge, branches and temperature. A step obeys the equations of
//! `forward::mapped`: what drives a branch, R(z, T)·i, is linear over the step, charge follows the
//! mean current and temperature the mean heat. The currents at its end enter the state there. They
//! are found by iteration: with resistances held and the ends of the branches replaced by their
//! tangents, the end of the step is a network of sources as for a model of one point, which gives
//! better currents. Cells in parallel need this, because they exchange current through resistances as
//! small as their own.

use super::thermal::{Heat, PackThermal, ThermalNetwork};
use super::wiring::{Cells, Left, Look, Sources, Wiring};
use crate::forward::Demand;
use analysis_model::{
    map::{BranchStep, CellMap, Drive, MapValues},
    ocv::OcvCurve,
};

/// Iterations of a step at most.
const MOST_LOOKS: usize = 12;
/// Change of the currents, over the largest, and of the voltages of branches, V, below which a tangent is
/// as good as the law: its error is the square of the change.
const SETTLED: f64 = 3e-6;
/// Changes are compared with this current if all are smaller: cells at rest exchange less.
const LEAST_A: f64 = 1e-3;
/// Distances in state of charge and temperature, K, over which the values of the map stay. Resistances
/// change by less than 1e-9 of themselves.
const NEAR_SOC: f64 = 1e-10;
const NEAR_K: f64 = 1e-8;

/// One cell in its place, as factors of the map.
#[derive(Debug, Clone)]
pub(super) struct MappedCell {
    /// Factor of the series resistance.
    pub(super) r: f64,
    /// Factor of each branch resistance. Those of the branches of charge transfer divide the
    /// exchange current of the cell.
    pub(super) rk: Vec<f64>,
    /// Factor of each time constant.
    pub(super) tau: Vec<f64>,
    /// Capacity over that of the OCV curve.
    pub(super) capacity_ratio: f64,
    pub(super) soc: f64,
}

/// What all cells of a pack have in common.
#[derive(Debug, Clone, Copy)]
pub(super) struct Common<'a> {
    pub(super) map: &'a CellMap,
    pub(super) curve: &'a OcvCurve,
    pub(super) wiring: Wiring<'a>,
    pub(super) thermal: &'a PackThermal,
}

/// States of all cells, besides their temperatures.
#[derive(Debug, Clone)]
struct State {
    soc: Vec<f64>,
    /// Voltages of the branches, V, cell by cell.
    v: Vec<f64>,
    drives: Vec<Drive>,
}

/// What the map states about all cells in their states.
#[derive(Debug, Clone)]
struct Found {
    values: Vec<MapValues>,
    /// Resistances of the branches, Ω, cell by cell.
    branch_ohm: Vec<f64>,
    /// Voltage of the curve, V, and its slope with SOC, V.
    ocv_v: Vec<(f64, f64)>,
    /// Where they were read: SOC and temperature, °C.
    at: Vec<(f64, f64)>,
}

impl Found {
    /// Returns the open-circuit voltage of a cell at a SOC beside the place of reading, V.
    fn open_v(&self, cell: usize, soc: f64) -> f64 {
        let (ocv_v, slope_v) = self.ocv_v[cell];
        ocv_v + self.values[cell].correction_v + slope_v * (soc - self.at[cell].0)
    }
}

/// Cells, their wiring and their states.
pub(super) struct MapNetwork<'a> {
    common: Common<'a>,
    cells: Vec<MappedCell>,
    capacity_coulomb: Vec<f64>,
    /// Of the branches of all cells, for `step_s`.
    steps: Vec<BranchStep>,
    step_s: f64,
    start: State,
    end: State,
    found: Found,
    sources: Sources,
    /// At the start of the last step.
    before: Look,
    now: Look,
    /// Currents of the cells before the last iteration, A.
    guess_a: Vec<f64>,
    /// Changes of the branches' voltages at the end of the step with the currents there, Ω.
    slope_ohm: Vec<f64>,
    thermal: ThermalNetwork,
    /// Mean heat of the cells over a step, W.
    heat_w: Vec<f64>,
    left: Left,
    unsettled: u64,
}

impl<'a> MapNetwork<'a> {
    /// Cells at rest and at the temperature of the surroundings, group by group.
    pub(super) fn new(cells: Vec<MappedCell>, common: Common<'a>) -> Self {
        let (n, rc) = (cells.len(), common.map.branches.len());
        let coulomb = |cell: &MappedCell| 3600.0 * common.curve.capacity_ah * cell.capacity_ratio;
        let state = State {
            soc: cells.iter().map(|cell| cell.soc).collect(),
            v: vec![0.0; n * rc],
            drives: vec![Drive::new(None, 0.0, 0.0); n * rc],
        };
        Self {
            capacity_coulomb: cells.iter().map(coulomb).collect(),
            steps: Vec::new(),
            step_s: f64::NAN,
            start: state.clone(),
            end: state,
            found: Found {
                values: vec![MapValues::default(); n],
                branch_ohm: vec![0.0; n * rc],
                ocv_v: vec![(0.0, 0.0); n],
                at: vec![(f64::NAN, f64::NAN); n],
            },
            sources: Sources::new(n),
            before: Look::new(n, &common.wiring),
            now: Look::new(n, &common.wiring),
            guess_a: vec![0.0; n],
            slope_ohm: vec![0.0; n * rc],
            thermal: ThermalNetwork::new(common.thermal, n, common.wiring.parallel),
            heat_w: vec![0.0; n],
            left: Left::default(),
            unsettled: 0,
            common,
            cells,
        }
    }

    fn branches(&self, cell: usize) -> std::ops::Range<usize> {
        let rc = self.common.map.branches.len();
        cell * rc..(cell + 1) * rc
    }

    fn set_step(&mut self, step_s: f64) {
        // Steps read from a file differ by rounding in their last digits.
        if (step_s - self.step_s).abs() <= 1e-12 * step_s {
            return;
        }
        self.step_s = step_s;
        self.steps.clear();
        for cell in &self.cells {
            let branches = self.common.map.branches.iter().zip(&cell.tau);
            let steps = branches.map(|(branch, tau)| BranchStep::new(step_s, branch.tau_s * tau));
            self.steps.extend(steps);
        }
    }

    /// Reads the map at the states of all cells that have moved; returns whether one has.
    fn find(&mut self) -> bool {
        let mut moved = false;
        for (k, cell) in self.cells.iter().enumerate() {
            let (soc, degc) = (self.end.soc[k], self.thermal.degc(k));
            let (found_soc, found_degc) = self.found.at[k];
            if (soc - found_soc).abs() <= NEAR_SOC && (degc - found_degc).abs() <= NEAR_K {
                continue;
            }
            let range = self.branches(k);
            let branch_ohm = &mut self.found.branch_ohm[range];
            let mut values = self.common.map.values(soc, degc, branch_ohm);
            values.r_ohm *= cell.r;
            branch_ohm
                .iter_mut()
                .zip(&cell.rk)
                .for_each(|(r_ohm, factor)| *r_ohm *= factor);
            let whole_ohm = self.common.map.transfer_ohm(branch_ohm);
            let law = self.common.map.charge_transfer;
            values.exchange_a = law.map(|law| law.exchange_a(whole_ohm, degc));
            self.found.values[k] = values;
            self.found.ocv_v[k] = self.common.curve.at(soc);
            self.found.at[k] = (soc, degc);
            moved = true;
        }
        moved
    }

    /// Moves charge and temperature to the end of the step with the currents and the heat that are
    /// known of it.
    fn arrive(&mut self, step_s: f64) {
        if !self.thermal.held() {
            let ends = [&self.before, &self.now];
            let interconnect_w = self.common.wiring.mean_heat_w(ends, &mut self.heat_w);
            let heat = Heat {
                cell_w: &self.heat_w,
                interconnect_w,
            };
            self.thermal.end(step_s, heat);
        }
        for (k, soc) in self.end.soc.iter_mut().enumerate() {
            let mean_a = 0.5 * (self.before.cell_a[k] + self.now.cell_a[k]);
            *soc = self.start.soc[k] - mean_a * step_s / self.capacity_coulomb[k];
        }
    }

    /// Moves the branches to the end of the step with the currents that are known of it, and writes the
    /// sources of all cells there, linear in the currents.
    fn linearise(&mut self, step_s: f64) {
        self.drive();
        for k in 0..self.cells.len() {
            let (values, slope_v) = (&self.found.values[k], self.found.ocv_v[k].1);
            let open_v = self.found.open_v(k, self.end.soc[k]);
            let current_a = self.now.cell_a[k];
            let bend_ohm = 0.5 * slope_v * step_s / self.capacity_coulomb[k];
            let mut e_v = open_v + bend_ohm * current_a;
            let mut behind_ohm = values.r_ohm + self.common.wiring.tab_ohm + bend_ohm;
            for j in self.branches(k) {
                let drives = [self.start.drives[j], self.end.drives[j]];
                let end = self.steps[j].bent_end(self.start.v[j], drives[0], drives[1]);
                let slope_ohm = end.slope * self.found.branch_ohm[j];
                self.end.v[j] = end.v;
                self.slope_ohm[j] = slope_ohm;
                e_v -= end.v - slope_ohm * current_a;
                behind_ohm += slope_ohm;
            }
            self.sources.e_v[k] = e_v;
            self.sources.behind_ohm[k] = behind_ohm;
        }
    }

    /// Moves the ends of the branches along their tangents to the present currents; returns the largest
    /// change of a voltage, V.
    fn follow(&mut self) -> f64 {
        let mut most_v = 0.0_f64;
        for k in 0..self.cells.len() {
            let change_a = self.now.cell_a[k] - self.guess_a[k];
            for j in self.branches(k) {
                let change_v = self.slope_ohm[j] * change_a;
                self.end.v[j] += change_v;
                most_v = most_v.max(change_v.abs());
            }
        }
        most_v
    }

    /// Computes what drives the branches under the present currents.
    fn drive(&mut self) {
        for k in 0..self.cells.len() {
            let (values, current_a) = (&self.found.values[k], self.now.cell_a[k]);
            for (j, branch) in self.branches(k).zip(&self.common.map.branches) {
                let r_ohm = self.found.branch_ohm[j];
                self.end.drives[j] = values.drive(branch.tau_s, r_ohm, current_a);
            }
        }
    }

    /// Computes the heat of the cells from their currents and the voltages of their branches.
    fn heat(&mut self) {
        for k in 0..self.cells.len() {
            let (values, current_a) = (&self.found.values[k], self.now.cell_a[k]);
            let lost_w = |j: usize| {
                let drive = &self.end.drives[j];
                drive.lost_w(self.end.v[j], self.found.branch_ohm[j])
            };
            let branches_w: f64 = self.branches(k).map(lost_w).sum();
            self.now.heat_w[k] = values.r_ohm * current_a * current_a + branches_w;
        }
    }

    /// Computes all currents and voltages under a demand in the present state.
    fn answer(&mut self, demand: Demand, value: f64) -> bool {
        self.note_places();
        for k in 0..self.cells.len() {
            let held_v: f64 = self.end.v[self.branches(k)].iter().sum();
            self.sources.e_v[k] = self.found.open_v(k, self.end.soc[k]) - held_v;
            self.sources.behind_ohm[k] = self.found.values[k].r_ohm + self.common.wiring.tab_ohm;
        }
        let wiring = self.common.wiring;
        let sound = wiring.share(&mut self.sources, demand, value, &mut self.now);
        for (k, values) in self.found.values.iter().enumerate() {
            self.now.cell_v[k] = self.sources.e_v[k] - values.r_ohm * self.now.cell_a[k];
        }
        sound
    }

    fn note_places(&mut self) {
        let left = &mut self.left;
        for (k, values) in self.found.values.iter().enumerate() {
            let outside = values.outside;
            if outside.soc > left.soc {
                (left.soc, left.soc_cell) = (outside.soc, k);
            }
            if outside.temperature_k > left.temperature_k {
                (left.temperature_k, left.temperature_cell) = (outside.temperature_k, k);
            }
        }
    }
}

impl Cells for MapNetwork<'_> {
    fn look(&mut self, demand: Demand, value: f64) -> bool {
        self.find();
        let sound = self.answer(demand, value);
        self.drive();
        self.heat();
        sound
    }

    fn advance(&mut self, step_s: f64, demand: Demand, value: f64) -> bool {
        self.set_step(step_s);
        self.thermal.begin();
        std::mem::swap(&mut self.start, &mut self.end);
        std::mem::swap(&mut self.before, &mut self.now);
        self.now.cell_a.copy_from_slice(&self.before.cell_a);
        self.now.heat_w.copy_from_slice(&self.before.heat_w);
        self.now.current_a = self.before.current_a;
        let (mut change, mut settled) = (f64::INFINITY, false);
        for iteration in 0..MOST_LOOKS {
            self.arrive(step_s);
            // The values of the start give the first currents.
            let moved = iteration == 0 || self.find();
            if !moved && change <= SETTLED {
                settled = true;
                break;
            }
            self.linearise(step_s);
            self.guess_a.copy_from_slice(&self.now.cell_a);
            let wiring = self.common.wiring;
            if !wiring.share(&mut self.sources, demand, value, &mut self.now) {
                return false;
            }
            change = self
                .follow()
                .max(largest_change(&self.guess_a, &self.now.cell_a));
            if !self.thermal.held() {
                self.heat();
            }
        }
        self.drive();
        if self.thermal.held() {
            self.heat();
        }
        self.unsettled += u64::from(!(settled && self.thermal.settled()));
        if self.now.infeasible {
            // The most power there is belongs to the state and not to the tangent.
            return self.look(demand, value);
        }
        self.find();
        self.answer(demand, value)
    }

    fn now(&self) -> &Look {
        &self.now
    }

    fn soc(&self) -> &[f64] {
        &self.end.soc
    }

    fn thermal(&self) -> &ThermalNetwork {
        &self.thermal
    }

    fn left(&self) -> Option<Left> {
        Some(self.left)
    }

    fn unsettled(&self) -> u64 {
        self.unsettled
    }
}

/// Largest change of a current over the largest current.
fn largest_change(before_a: &[f64], after_a: &[f64]) -> f64 {
    let most_a = after_a.iter().fold(0.0_f64, |most, i| most.max(i.abs()));
    let pairs = before_a.iter().zip(after_a);
    let change_a = pairs.fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
    change_a / most_a.max(LEAST_A)
}

#[cfg(test)]
mod tests;
