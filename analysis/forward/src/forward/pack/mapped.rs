//! Cells that are not alike, wired to a pack, whose resistances follow a map.
//!
//! Each cell has its own state of charge, branches and temperature. A step obeys the equations of
//! `forward::mapped`: what drives a branch, R(z, T)·g(i), is linear over the step, charge follows the
//! mean current and temperature the mean heat. The currents at its end enter the state there. They
//! are found by iteration: with resistances held and g replaced by its tangent, the end of the step
//! is a network of sources as for a model of one point, which gives better currents. Cells in
//! parallel need this, because they exchange current through resistances as small as their own.

use super::thermal::{Heat, PackThermal, ThermalNetwork};
use super::wiring::{Cells, Left, Look, Sources, Wiring};
use crate::forward::Demand;
use analysis_model::{
    map::{BranchStep, CellMap, Drive, MapValues},
    ocv::OcvCurve,
};

/// Iterations of a step at most.
const MOST_LOOKS: usize = 12;
/// Change of the currents, over the largest, and of the driving voltages, V, below which the tangent
/// of g is as good as g: its error is the square of the change.
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
    /// Factor of each branch resistance. That of a branch of charge transfer divides its exchange
    /// current, because their product follows from the temperature alone.
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
    pub(super) wiring: Wiring,
    pub(super) thermal: &'a PackThermal,
}

/// States of all cells, besides their temperatures.
#[derive(Debug, Clone)]
struct State {
    soc: Vec<f64>,
    /// Voltages of the branches, V, cell by cell.
    v: Vec<f64>,
    /// R·g(i) of the branches, V.
    driven_v: Vec<f64>,
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
    /// What drives the branches, g(i), A.
    driven_a: Vec<f64>,
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
            driven_v: vec![0.0; n * rc],
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
            before: Look::new(n),
            now: Look::new(n),
            guess_a: vec![0.0; n],
            driven_a: vec![0.0; n * rc],
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

    /// Sources of all cells at the end of a step, linear in the currents there.
    fn linearise(&mut self, step_s: f64) {
        for k in 0..self.cells.len() {
            let (values, slope_v) = (&self.found.values[k], self.found.ocv_v[k].1);
            let open_v = self.found.open_v(k, self.end.soc[k]);
            let current_a = self.now.cell_a[k];
            let bend_ohm = 0.5 * slope_v * step_s / self.capacity_coulomb[k];
            let mut e_v = open_v + bend_ohm * current_a;
            let mut behind_ohm = values.r_ohm + self.common.wiring.tab_ohm + bend_ohm;
            for (j, law) in self
                .branches(k)
                .zip(laws(self.common.map, &self.cells[k], values))
            {
                let step = self.steps[j];
                let end_ohm = step.end * self.found.branch_ohm[j];
                let (driven_a, slope) = (self.driven_a[j], law.slope(current_a));
                e_v -= step.decay * self.start.v[j]
                    + step.start * self.start.driven_v[j]
                    + end_ohm * (driven_a - slope * current_a);
                behind_ohm += end_ohm * slope;
            }
            self.sources.e_v[k] = e_v;
            self.sources.behind_ohm[k] = behind_ohm;
        }
    }

    /// Computes what the currents drive; returns the largest change of a driving voltage, V.
    fn drive(&mut self) -> f64 {
        let mut change_v = 0.0_f64;
        for k in 0..self.cells.len() {
            let current_a = self.now.cell_a[k];
            let laws = laws(self.common.map, &self.cells[k], &self.found.values[k]);
            for (j, law) in self.branches(k).zip(laws) {
                let driven_a = law.driven_a(current_a);
                self.driven_a[j] = driven_a;
                let driven_v = self.found.branch_ohm[j] * driven_a;
                change_v = change_v.max((driven_v - self.end.driven_v[j]).abs());
                self.end.driven_v[j] = driven_v;
            }
        }
        change_v
    }

    /// Computes the heat of the cells from their currents and the voltages of their branches.
    fn heat(&mut self) {
        for k in 0..self.cells.len() {
            let (values, current_a) = (&self.found.values[k], self.now.cell_a[k]);
            let mut heat_w = values.r_ohm * current_a * current_a;
            for (j, law) in self
                .branches(k)
                .zip(laws(self.common.map, &self.cells[k], values))
            {
                heat_w += law.lost_w(self.end.v[j], self.found.branch_ohm[j]);
            }
            self.now.heat_w[k] = heat_w;
        }
    }

    /// Computes the voltages of the branches at the end of the step.
    fn charge(&mut self) {
        for (j, v) in self.end.v.iter_mut().enumerate() {
            let start = &self.start;
            *v = self.steps[j].end_v(start.v[j], start.driven_v[j], self.end.driven_v[j]);
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
        let sound = wiring.share(&self.sources, demand, value, &mut self.now);
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
        self.end.driven_v.copy_from_slice(&self.start.driven_v);
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
            if !wiring.share(&self.sources, demand, value, &mut self.now) {
                return false;
            }
            change = self
                .drive()
                .max(largest_change(&self.guess_a, &self.now.cell_a));
            self.charge();
            if !self.thermal.held() {
                self.heat();
            }
        }
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

/// Returns how a current drives each branch of a cell.
fn laws<'n>(
    map: &'n CellMap,
    cell: &'n MappedCell,
    values: &'n MapValues,
) -> impl Iterator<Item = Drive> + 'n {
    let branches = map.branches.iter().zip(&cell.rk);
    branches.map(|(branch, factor)| {
        let law = values.drive(branch.tau_s);
        Drive {
            exchange_a: law.exchange_a.map(|exchange_a| exchange_a / factor),
        }
    })
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
