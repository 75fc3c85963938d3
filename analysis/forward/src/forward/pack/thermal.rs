//! Temperatures of the cells of a pack, which conduct to each other and to their busbars.
//!
//! The cells of a group stand in a row, and the groups form the rows of a grid. With u = T − T_s over
//! the surroundings, cell k follows
//!
//! C·duₖ/dt = Pₖ − Gₖ·uₖ + g·Σₙ(uₙ − uₖ) + Σ_b(P_b/N_b + g_b·(ū_b − uₖ))
//!
//! n are its neighbours in the grid (two to four), b the busbars that touch it: one between each two
//! groups, with the N_b cells of both. A busbar stores no heat, so that its heat P_b flows into its
//! cells, and g_b evens them out. Gₖ = G·(1 − s·nₖ/4): the share s of a cell's path to the
//! surroundings goes through its four sides, and a side that faces a neighbour is lost for it.
//!
//! A step is that of [`Body`] for all cells together: flows follow ũ = u₀ + θ·(u₁ − u₀), a linear
//! system with a symmetric matrix, solved by conjugate gradients. Heat is kept to rounding however
//! exactly it is solved, because u₁ follows from the flows.

use crate::forward::body::{Body, theta};
use analysis_model::{map::TEMPERATURES_DEGC, pack::PackError};
use serde::Serialize;

/// Residual of the linear system over its right side.
const RESIDUAL: f64 = 1e-13;

/// Heat of the cells of a pack, and where it goes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PackThermal {
    /// Temperature of the surroundings, and of the cells at the start, °C.
    pub ambient_degc: f64,
    /// Heat capacity of a cell, J/K.
    pub capacity_j_per_k: f64,
    /// The cells keep the temperature of the surroundings.
    pub held: bool,
    /// Conductance from a cell to the surroundings, W/K; 0 if no heat leaves it.
    pub path_w_per_k: f64,
    /// Share of that conductance that goes through the four sides of a cell, 0 to 1.
    pub side_share: f64,
    /// Conductance between two neighbours, W/K.
    pub neighbour_w_per_k: f64,
    /// Conductance between a cell and a busbar, W/K; 0 if the heat of the interconnect does not reach
    /// the cells.
    pub busbar_w_per_k: f64,
}

impl PackThermal {
    /// Heat that stays in its cell.
    pub fn adiabatic(ambient_degc: f64, capacity_j_per_k: f64) -> Self {
        Self {
            ambient_degc,
            capacity_j_per_k,
            held: false,
            path_w_per_k: 0.0,
            side_share: 0.0,
            neighbour_w_per_k: 0.0,
            busbar_w_per_k: 0.0,
        }
    }

    /// Checks the values.
    ///
    /// # Errors
    /// [`PackError::Value`] for the first that cannot be.
    pub fn check(&self) -> Result<(), PackError> {
        let fail = |what, expected, met| {
            Err(PackError::Value {
                what,
                expected,
                met,
            })
        };
        let (capacity, ambient) = (self.capacity_j_per_k, self.ambient_degc);
        if !TEMPERATURES_DEGC.contains(&ambient) {
            let what = "temperature of the surroundings";
            return fail(what, "-60 to 120 °C", ambient);
        }
        if !(capacity.is_finite() && capacity > 0.0) {
            let what = "heat capacity of a cell";
            return fail(what, "a number above 0 in J/K", capacity);
        }
        if !(0.0..=1.0).contains(&self.side_share) {
            let what = "share of the sides in the path of a cell to the surroundings";
            return fail(what, "a number from 0 to 1", self.side_share);
        }
        let conductances = [
            (
                "conductance of a cell to the surroundings",
                self.path_w_per_k,
            ),
            ("conductance between neighbours", self.neighbour_w_per_k),
            ("conductance to a busbar", self.busbar_w_per_k),
        ];
        match conductances
            .into_iter()
            .find(|(_, met)| !(met.is_finite() && *met >= 0.0))
        {
            Some((what, met)) => fail(what, "zero or more in W/K", met),
            None => Ok(()),
        }
    }

    /// Returns whether cells exchange heat.
    fn couples(&self) -> bool {
        self.neighbour_w_per_k > 0.0 || self.busbar_w_per_k > 0.0
    }
}

/// The grid of the cells and what conducts in it.
#[derive(Debug, Clone)]
struct Grid {
    thermal: PackThermal,
    parallel: usize,
    /// Conductance of each cell to the surroundings, W/K.
    path_w_per_k: Vec<f64>,
    /// Bound on what the conductances take out of the cells per kelvin, in any pattern of
    /// temperatures, W/K.
    most_w_per_k: f64,
}

impl Grid {
    fn new(thermal: PackThermal, cells: usize, parallel: usize) -> Self {
        let neighbours = |k: usize| {
            let place = k % parallel;
            [
                place > 0,
                place + 1 < parallel,
                k >= parallel,
                k + parallel < cells,
            ]
            .into_iter()
            .map(f64::from)
            .sum::<f64>()
        };
        let path = |k: usize| {
            let lost = 0.25 * thermal.side_share * neighbours(k);
            thermal.path_w_per_k * (1.0 - lost)
        };
        let path_w_per_k: Vec<f64> = (0..cells).map(path).collect();
        // The step must damp the fastest pattern without a change of its sign: hot and cold cells in
        // turn, in which a difference to a neighbour is twice a temperature. A busbar conducts to the
        // mean of its cells, which is 0 in such a pattern: it counts once for each cell that it
        // touches.
        let busbars = if parallel == cells { 1.0 } else { 2.0 };
        let most = (0..cells).map(|k| {
            path_w_per_k[k]
                + 2.0 * neighbours(k) * thermal.neighbour_w_per_k
                + busbars * thermal.busbar_w_per_k
        });
        Self {
            most_w_per_k: most.fold(0.0, f64::max),
            thermal,
            parallel,
            path_w_per_k,
        }
    }

    /// Cells of each busbar. A pack of one group has one.
    fn busbars(&self) -> impl Iterator<Item = std::ops::Range<usize>> {
        let (cells, parallel) = (self.path_w_per_k.len(), self.parallel);
        let width = (2 * parallel).min(cells);
        (0..=cells - width)
            .step_by(parallel)
            .map(move |first| first..first + width)
    }

    /// Heat that flows out of each cell at temperatures over the surroundings, W.
    fn flows(&self, over_k: &[f64], out_w: &mut [f64]) {
        for ((out, path), over) in out_w.iter_mut().zip(&self.path_w_per_k).zip(over_k) {
            *out = path * over;
        }
        let (cells, parallel) = (over_k.len(), self.parallel);
        let neighbour = self.thermal.neighbour_w_per_k;
        let mut exchange = |a: usize, b: usize| {
            let flow_w = neighbour * (over_k[a] - over_k[b]);
            out_w[a] += flow_w;
            out_w[b] -= flow_w;
        };
        if neighbour > 0.0 {
            for k in 0..cells {
                if (k + 1) % parallel != 0 {
                    exchange(k, k + 1);
                }
                if k + parallel < cells {
                    exchange(k, k + parallel);
                }
            }
        }
        let busbar = self.thermal.busbar_w_per_k;
        if busbar > 0.0 {
            for range in self.busbars() {
                let joined = &over_k[range.clone()];
                let mean = joined.iter().sum::<f64>() / joined.len() as f64;
                for (out, over) in out_w[range].iter_mut().zip(joined) {
                    *out += busbar * (over - mean);
                }
            }
        }
    }
}

/// Heat that arises over a step, mean of its ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Heat<'h> {
    /// In each cell, W.
    pub(super) cell_w: &'h [f64],
    /// In the interconnect, W.
    pub(super) interconnect_w: f64,
}

/// Temperatures of all cells.
#[derive(Debug, Clone)]
pub(super) struct ThermalNetwork {
    grid: Grid,
    /// Over the surroundings, at the start of the step, K.
    start_k: Vec<f64>,
    /// At its end.
    end_k: Vec<f64>,
    /// In between, as the flows follow it.
    mean_k: Vec<f64>,
    /// Heat that flows into each cell from itself and its busbars, W.
    source_w: Vec<f64>,
    /// Whether the linear system of the last step is solved.
    settled: bool,
    gradient: Gradient,
}

impl ThermalNetwork {
    /// Cells at the temperature of the surroundings, group by group.
    pub(super) fn new(thermal: &PackThermal, cells: usize, parallel: usize) -> Self {
        Self {
            grid: Grid::new(*thermal, cells, parallel),
            start_k: vec![0.0; cells],
            end_k: vec![0.0; cells],
            mean_k: vec![0.0; cells],
            source_w: vec![0.0; cells],
            settled: true,
            gradient: Gradient::new(cells),
        }
    }

    /// Returns the temperature of a cell, °C.
    pub(super) fn degc(&self, cell: usize) -> f64 {
        self.grid.thermal.ambient_degc + self.end_k[cell]
    }

    /// Returns the temperatures over the surroundings, K.
    pub(super) fn over_k(&self) -> &[f64] {
        &self.end_k
    }

    /// Returns the heat that has left to the surroundings in the last step, W.
    #[cfg(test)]
    pub(super) fn lost_w(&self) -> f64 {
        let paths = self.grid.path_w_per_k.iter().zip(&self.mean_k);
        paths.map(|(path, over)| path * over).sum()
    }

    /// Returns whether the cells keep the temperature of the surroundings.
    pub(super) fn held(&self) -> bool {
        self.grid.thermal.held
    }

    /// Returns whether the temperatures of the last step solve their equations to rounding.
    pub(super) fn settled(&self) -> bool {
        self.settled
    }

    /// Begins a step at the present temperatures.
    pub(super) fn begin(&mut self) {
        self.start_k.copy_from_slice(&self.end_k);
    }

    /// Computes the temperatures at the end of the step. May be repeated with other heat.
    pub(super) fn end(&mut self, step_s: f64, heat: Heat<'_>) {
        let thermal = self.grid.thermal;
        if thermal.held {
            return;
        }
        if !thermal.couples() {
            for (k, end_k) in self.end_k.iter_mut().enumerate() {
                let body = Body {
                    capacity_j_per_k: thermal.capacity_j_per_k,
                    path_w_per_k: self.grid.path_w_per_k[k],
                };
                let (start_k, heat_w) = (self.start_k[k], heat.cell_w[k]);
                self.mean_k[k] = body.mean_k(start_k, heat_w, step_s);
                *end_k = body.end_k(start_k, heat_w, step_s);
            }
            return;
        }
        self.source_w.copy_from_slice(heat.cell_w);
        if thermal.busbar_w_per_k > 0.0 {
            let count = self.grid.busbars().count() as f64;
            for range in self.grid.busbars() {
                let each_w = heat.interconnect_w / count / range.len() as f64;
                self.source_w[range].iter_mut().for_each(|w| *w += each_w);
            }
        }
        let per_watt = step_s / thermal.capacity_j_per_k;
        let inert = 1.0 / (per_watt * theta(per_watt * self.grid.most_w_per_k));
        let right = &mut self.end_k;
        for ((right, start), source) in right.iter_mut().zip(&self.start_k).zip(&self.source_w) {
            *right = inert * start + source;
        }
        self.settled = self
            .gradient
            .solve(&self.grid, inert, right, &mut self.mean_k);
        self.grid.flows(&self.mean_k, &mut self.gradient.product);
        for (k, end_k) in self.end_k.iter_mut().enumerate() {
            *end_k = self.start_k[k] + per_watt * (self.source_w[k] - self.gradient.product[k]);
        }
    }
}

/// Work space of conjugate gradients.
#[derive(Debug, Clone)]
struct Gradient {
    residual: Vec<f64>,
    direction: Vec<f64>,
    product: Vec<f64>,
}

impl Gradient {
    fn new(cells: usize) -> Self {
        Self {
            residual: vec![0.0; cells],
            direction: vec![0.0; cells],
            product: vec![0.0; cells],
        }
    }

    /// Solves (inert + flows)·x = right from an approximate x. Returns whether it has succeeded.
    fn solve(&mut self, grid: &Grid, inert: f64, right: &[f64], x: &mut [f64]) -> bool {
        grid.flows(x, &mut self.product);
        for (k, residual) in self.residual.iter_mut().enumerate() {
            *residual = right[k] - inert * x[k] - self.product[k];
        }
        self.direction.copy_from_slice(&self.residual);
        let enough = RESIDUAL * RESIDUAL * dot(right, right);
        let mut square = dot(&self.residual, &self.residual);
        for _ in 0..4 * x.len() + 20 {
            if square <= enough {
                return true;
            }
            grid.flows(&self.direction, &mut self.product);
            for (product, direction) in self.product.iter_mut().zip(&self.direction) {
                *product += inert * direction;
            }
            let length = square / dot(&self.direction, &self.product);
            for (k, x) in x.iter_mut().enumerate() {
                *x += length * self.direction[k];
                self.residual[k] -= length * self.product[k];
            }
            let next = dot(&self.residual, &self.residual);
            for (direction, residual) in self.direction.iter_mut().zip(&self.residual) {
                *direction = residual + next / square * *direction;
            }
            square = next;
        }
        square <= enough
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests;
