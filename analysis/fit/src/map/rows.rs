//! Logs and spectra as linear equations of the unknowns.

use super::design::Design;
use super::log::Log;
use super::solve::{INDUCTANCE_H, Kinetics};
use super::sweep::Sweep;
use analysis_model::map::{BranchStep, CellMap, Drive};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

/// Rows that are added at once.
const CHUNK: usize = 512;

impl Design {
    /// Adds the rows of a log: its overpotential is the sum of the unknowns times their columns.
    ///
    /// `weight` is that of a row from the time that it stands for, s, and its SOC.
    pub(super) fn add_log(
        &self,
        log: &Log,
        lag_s: f64,
        kinetics: &Kinetics,
        weight: impl Fn(f64, f64) -> f64,
        add: &mut impl FnMut(&DMatrix<f64>, &DVector<f64>),
    ) {
        let map = self.empty_map(kinetics);
        let (resistances, count) = (self.resistances(), self.count());
        let per_surface = self.nodes() * self.soc.len();
        let fast = self.transfer_count();
        // Voltages of the fast branches per ohm, A, as if their resistances stood still for seconds; and
        // currents of the slow branches by surface node.
        let mut per_ohm_a = vec![0.0; fast];
        let mut filtered = vec![0.0; per_surface * (self.taus_s.len() - fast)];
        let (fast_s, slow_s) = self.taus_s.split_at(fast);
        let every = log.every();
        let samples = &log.samples;
        let current_a = log.lagged_a(lag_s);
        let mut last_s = samples.time_s[0];
        let mut rows = DMatrix::<f64>::zeros(CHUNK, count);
        let mut right = DVector::<f64>::zeros(CHUNK);
        let mut filled = 0;
        let mut before = (Drive::new(None, 1.0, 0.0), [(0, 0, 0.0); 4]);
        let around = kinetics.around.as_deref();
        let mut around = around.map(|map| Around::new(map, fast_s));
        for k in 0..log.len() {
            let (soc, degc, i) = (samples.soc[k], samples.temperature_degc[k], current_a[k]);
            let at = map.place(soc, degc);
            let exchange_a = around
                .as_mut()
                .and_then(|around| around.exchange_a(soc, degc));
            let drive = Drive::new(exchange_a, 1.0, i);
            let weights = map.weights(&at, kinetics.branches);
            let driven = (drive, weights.map(|(node, knot, w)| (node, knot, w * i)));
            if log.begins_at(k) {
                per_ohm_a.fill(0.0);
                filtered.fill(0.0);
            } else {
                let step_s = samples.time_s[k] - samples.time_s[k - 1];
                for (a, tau_s) in per_ohm_a.iter_mut().zip(fast_s) {
                    let step = BranchStep::new(step_s, *tau_s);
                    *a = step.bent_end(*a, before.0, drive).v;
                }
                let parts = filtered.chunks_exact_mut(per_surface);
                for (states, tau_s) in parts.zip(slow_s) {
                    let step = BranchStep::new(step_s, *tau_s);
                    advance(states, self.soc.len(), step, [before.1, driven.1]);
                }
            }
            before = driven;
            if k % every != 0 {
                continue;
            }
            let w = weight(samples.time_s[k] - last_s, soc);
            last_s = samples.time_s[k];
            let mut row = rows.row_mut(filled);
            row.fill(0.0);
            for (node, knot, share) in map.weights(&at, kinetics.series) {
                row[self.index(0, node, knot)] -= w * share * i;
            }
            let (fallen_a, fallen_v) = around.as_ref().map_or((0.0, 0.0), |around| {
                around.exchange_effect(drive, &per_ohm_a)
            });
            for (branch, a) in per_ohm_a.iter().enumerate() {
                for (node, knot, share) in weights {
                    row[self.index(1 + branch, node, knot)] -= w * share * (a - fallen_a);
                }
            }
            let first = (1 + fast) * per_surface;
            for (place, state) in filtered.iter().enumerate() {
                row[first + place] = -w * state;
            }
            for (knot, share) in map.soc_weights(&at) {
                row[resistances + knot] += w * share;
                row[resistances + self.soc.len() + knot] +=
                    w * share * (degc - self.ocv_temperature_degc);
            }
            right[filled] = w * (samples.voltage_v[k] - samples.ocv_v[k] + fallen_v);
            filled += 1;
            if filled == CHUNK {
                add(&rows, &right);
                filled = 0;
            }
        }
        if filled > 0 {
            add(
                &rows.rows(0, filled).into_owned(),
                &right.rows(0, filled).into_owned(),
            );
        }
    }

    /// Adds the rows of the fitted points of a spectrum: its impedance without that of the OCV is the sum
    /// of the unknowns times their columns.
    pub(super) fn add_sweep(
        &self,
        sweep: &Sweep,
        scale: f64,
        kinetics: &Kinetics,
        add: &mut impl FnMut(&DMatrix<f64>, &DVector<f64>),
    ) {
        let map = self.empty_map(kinetics);
        let at = map.place(sweep.soc, sweep.temperature_degc);
        let (series, branch) = (
            map.weights(&at, kinetics.series),
            map.weights(&at, kinetics.branches),
        );
        let points = sweep.fitted();
        let mut rows = DMatrix::<f64>::zeros(2 * points.len(), self.count());
        let mut right = DVector::<f64>::zeros(2 * points.len());
        for (k, point) in points.iter().enumerate() {
            let w = 1.0 / (scale * point.error_ohm);
            let mut put = |column: usize, factor: Complex64| {
                rows[(2 * k, column)] += w * factor.re;
                rows[(2 * k + 1, column)] += w * factor.im;
            };
            for (node, knot, share) in series {
                put(self.index(0, node, knot), share.into());
            }
            for (number, tau_s) in self.taus_s.iter().enumerate() {
                let response = Complex64::new(1.0, point.omega * tau_s).inv();
                for (node, knot, share) in branch {
                    put(self.index(1 + number, node, knot), share * response);
                }
            }
            put(
                self.inductance(),
                Complex64::new(0.0, point.omega * INDUCTANCE_H),
            );
            right[2 * k] = w * point.z_ohm.re;
            right[2 * k + 1] = w * point.z_ohm.im;
        }
        add(&rows, &right);
    }
}

/// The map around which the equations of charge transfer are made, in one state.
struct Around<'a> {
    map: &'a CellMap,
    /// Resistances of its branches, Ω.
    ohm: Vec<f64>,
    /// Places of the fast branches of the equations among its own, if it has them.
    places: Vec<Option<usize>>,
}

impl<'a> Around<'a> {
    fn new(map: &'a CellMap, fast_s: &[f64]) -> Self {
        let place = |tau_s: &f64| map.branches.iter().position(|b| b.tau_s == *tau_s);
        Self {
            map,
            ohm: vec![0.0; map.branches.len()],
            places: fast_s.iter().map(place).collect(),
        }
    }

    /// Moves to a state, and returns its exchange current, A.
    fn exchange_a(&mut self, soc: f64, degc: f64) -> Option<f64> {
        self.map.values(soc, degc, &mut self.ohm).exchange_a
    }

    /// Returns how much less voltage an ohm more of charge transfer adds, A, because it lowers the exchange
    /// current of all branches, and the same for the resistances of the map, V: ∂v/∂ln(i₀) is
    /// v − b·tanh(v/b) of a branch that has settled. `per_ohm_a`: voltages of the branches per ohm, A.
    fn exchange_effect(&self, drive: Drive, per_ohm_a: &[f64]) -> (f64, f64) {
        let branches = self.places.iter().zip(per_ohm_a);
        let fallen_v: f64 = branches
            .filter_map(|(place, a)| Some(self.ohm[(*place)?] * drive.fallen_v(*a)))
            .sum();
        let whole_ohm = self.map.transfer_ohm(&self.ohm);
        let fallen_a = fallen_v / whole_ohm.max(Drive::LEAST_OHM);
        (fallen_a, fallen_a * whole_ohm)
    }
}

/// Moves the filtered columns of one branch over a step.
fn advance(
    states: &mut [f64],
    knots: usize,
    step: BranchStep,
    driven: [[(usize, usize, f64); 4]; 2],
) {
    states.iter_mut().for_each(|state| *state *= step.decay);
    for (list, gain) in driven.into_iter().zip([step.start, step.end]) {
        for (node, knot, value) in list {
            states[node * knots + knot] += gain * value;
        }
    }
}
