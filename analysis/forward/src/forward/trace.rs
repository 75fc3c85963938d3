//! Results of a simulation: its trace over time and the figures of the whole run.

use super::law::Beyond;
use super::limits::CellWindow;
use super::model::{OcvSource, SimModel, SimState};
use analysis_model::{map::Outside, model::RcBranch};
use serde::Serialize;

/// A run over time, one entry of each list per row. Where the demand jumps, a time occurs twice:
/// before and after the jump.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trace {
    /// Time, s.
    pub time_s: Vec<f64>,
    /// Requested power, W.
    pub demand_w: Vec<f64>,
    /// Power delivered at the terminals, W, discharge positive.
    pub power_w: Vec<f64>,
    /// Current, A, discharge positive.
    pub current_a: Vec<f64>,
    /// Voltage at the terminals, V.
    pub ccv_v: Vec<f64>,
    /// Mean voltage of a cell, V, without the interconnect.
    pub cell_v: Vec<f64>,
    /// Open-circuit voltage at the terminals, V.
    pub ocv_v: Vec<f64>,
    /// State of charge, 0…1; not a number for a constant OCV.
    pub soc: Vec<f64>,
    /// Voltages over the RC branches, V: one list per branch.
    pub v_rc_v: Vec<Vec<f64>>,
    /// Temperature of the cells, °C; empty for a model that knows none.
    pub temperature_degc: Vec<f64>,
    /// Standard deviation of the mean voltage of a cell at the current of the row, V; empty for a model
    /// that does not state its error. All cells of a pack share it.
    pub cell_sigma_v: Vec<f64>,
}

/// A stretch of time in which the requested power exceeded the available power.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Infeasible {
    /// Start of the stretch, s.
    pub time_s: f64,
    /// End time, s; equal to the start if the simulation stopped.
    pub until_s: f64,
    /// Requested power at its start, W.
    pub power_w: f64,
    /// Power that could be had there, W: E²/4R.
    pub available_w: f64,
}

/// End of the tangent of [`super::Beyond::Extrapolate`], or of the line of [`super::Beyond::Bend`],
/// where its voltage reached zero. The run ended there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TangentEnd {
    /// When, s.
    pub time_s: f64,
    /// Requested power, W.
    pub power_w: f64,
    /// The most that could be had, W: E²/4R.
    pub available_w: f64,
}

/// Figures of a whole run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Lowest voltage at the terminals, V.
    pub min_ccv_v: f64,
    /// When, s.
    pub min_ccv_time_s: f64,
    /// Highest voltage at the terminals, V.
    pub max_ccv_v: f64,
    /// When, s.
    pub max_ccv_time_s: f64,
    /// Lowest voltage of a cell above the lower limit, V; negative when below it. The
    /// interconnect's share is not the cell's.
    pub margin_low_v: f64,
    /// Highest voltage of a cell below the upper limit, V; negative when above it.
    pub margin_high_v: f64,
    /// Energy delivered at the terminals, J.
    pub energy_j: f64,
    /// Charge taken, C.
    #[serde(rename = "charge_c")]
    pub charge_coulomb: f64,
    /// Heat in the resistances, J: ∫i²R + Σ∫vₖ²/Rₖ, interconnect included; with additions also
    /// their voltage drop times the current.
    pub heat_j: f64,
    /// Work of the open-circuit voltage, J: ∫OCV·i.
    pub chemical_j: f64,
    /// More in the capacitances at the end than at the start, J.
    pub stored_j: f64,
    /// Highest power delivered, W; negative or zero for a run that only charges.
    pub peak_power_w: f64,
    /// Lowest power delivered, W: negative when the cell is charged.
    pub lowest_power_w: f64,
    /// Highest discharge current, A.
    pub peak_current_a: f64,
    /// Lowest current, A: negative when the cell is charged.
    pub lowest_current_a: f64,
    /// Lowest state of charge of the trace, below 0 where more was taken than there is; none for a
    /// constant OCV.
    pub soc_min: Option<f64>,
    /// Highest state of charge of the trace, above 1 where more was put in than there is room; none
    /// for a constant OCV.
    pub soc_max: Option<f64>,
    /// True if all requested power was available. The margins judge the window.
    pub feasible: bool,
    /// Stretches in which it could not.
    pub infeasible: Vec<Infeasible>,
    /// End of the tangent, and of the run with it.
    pub tangent_end: Option<TangentEnd>,
    /// Time of the last row of the trace less that of the first row of the profile, s.
    pub simulated_s: f64,
    /// Sub-steps made.
    pub steps: u64,
    /// Farthest distance of state of charge and temperature from the range in which a map was
    /// measured; none for a model without a map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outside_map: Option<Outside>,
}

impl Summary {
    /// Returns the largest current in either direction, A.
    pub fn most_current_a(&self) -> f64 {
        self.peak_current_a.abs().max(self.lowest_current_a.abs())
    }
}

/// An instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    pub(super) time_s: f64,
    pub(super) demand_w: f64,
    pub(super) current_a: f64,
    pub(super) ccv_v: f64,
    pub(super) ocv_v: f64,
    pub(super) available_w: f64,
    pub(super) infeasible: bool,
    /// The tangent has no voltage for the demand: the maximum power replaces it, and the run ends.
    pub(super) past_tangent: bool,
}

/// Keeps the books of a run.
pub(super) struct TraceRecorder<'m> {
    model: &'m SimModel,
    window: CellWindow,
    trace: Trace,
    summary: Summary,
    cell_v: (f64, f64),
    first: Option<SimState>,
    within: bool,
}

impl<'m> TraceRecorder<'m> {
    pub(super) fn new(model: &'m SimModel, window: CellWindow) -> Self {
        let (inf, none) = (f64::INFINITY, f64::NEG_INFINITY);
        let summary = Summary {
            min_ccv_v: inf,
            min_ccv_time_s: 0.0,
            max_ccv_v: none,
            max_ccv_time_s: 0.0,
            margin_low_v: 0.0,
            margin_high_v: 0.0,
            energy_j: 0.0,
            charge_coulomb: 0.0,
            heat_j: 0.0,
            chemical_j: 0.0,
            stored_j: 0.0,
            peak_power_w: none,
            lowest_power_w: inf,
            peak_current_a: none,
            lowest_current_a: inf,
            soc_min: None,
            soc_max: None,
            feasible: true,
            infeasible: Vec::new(),
            tangent_end: None,
            simulated_s: 0.0,
            steps: 0,
            outside_map: None,
        };
        let trace = Trace {
            v_rc_v: vec![Vec::new(); model.erm.branches.len()],
            ..Trace::default()
        };
        Self {
            model,
            window,
            trace,
            summary,
            cell_v: (inf, none),
            first: None,
            within: false,
        }
    }

    /// Takes an instant into the extremes.
    pub(super) fn see(&mut self, p: &Point) {
        let s = &mut self.summary;
        if p.ccv_v < s.min_ccv_v {
            (s.min_ccv_v, s.min_ccv_time_s) = (p.ccv_v, p.time_s);
        }
        if p.ccv_v > s.max_ccv_v {
            (s.max_ccv_v, s.max_ccv_time_s) = (p.ccv_v, p.time_s);
        }
        s.peak_power_w = s.peak_power_w.max(p.ccv_v * p.current_a);
        s.lowest_power_w = s.lowest_power_w.min(p.ccv_v * p.current_a);
        s.peak_current_a = s.peak_current_a.max(p.current_a);
        s.lowest_current_a = s.lowest_current_a.min(p.current_a);
        let cell_v = self.model.cell_v(p.ccv_v, p.current_a);
        self.cell_v = (self.cell_v.0.min(cell_v), self.cell_v.1.max(cell_v));
        match (p.infeasible, self.within, s.infeasible.last_mut()) {
            (true, true, Some(open)) => open.until_s = p.time_s,
            (true, ..) => {
                let (time_s, power_w, available_w) = (p.time_s, p.demand_w, p.available_w);
                s.infeasible.push(Infeasible {
                    time_s,
                    until_s: time_s,
                    power_w,
                    available_w,
                });
            }
            (false, true, Some(open)) => open.until_s = p.time_s,
            _ => {}
        }
        if p.past_tangent && s.tangent_end.is_none() {
            s.tangent_end = Some(TangentEnd {
                time_s: p.time_s,
                power_w: p.demand_w,
                available_w: p.available_w,
            });
        }
        self.within = p.infeasible;
        s.feasible &= !p.infeasible;
    }

    /// Returns true while all requested power was available.
    pub(super) fn feasible(&self) -> bool {
        self.summary.feasible
    }

    /// Nothing was left behind the series resistance at a time, under a power: the tangent ended
    /// with it.
    pub(super) fn emptied(&mut self, time_s: f64, beyond: Beyond) {
        let open = self
            .summary
            .infeasible
            .last()
            .map(|last| last.power_w)
            .filter(|_| beyond.fraction().is_some());
        if let (Some(power_w), None) = (open, self.summary.tangent_end) {
            self.summary.tangent_end = Some(TangentEnd {
                time_s,
                power_w,
                available_w: 0.0,
            });
        }
    }

    /// Adds a row to the trace.
    pub(super) fn row(&mut self, p: &Point, state: &SimState) {
        if self.first.is_none() {
            self.first = Some(state.clone());
        }
        let soc = if matches!(self.model.ocv, OcvSource::Constant(_)) {
            f64::NAN
        } else {
            state.soc
        };
        let t = &mut self.trace;
        let cell_v = self.model.cell_v(p.ccv_v, p.current_a);
        let row = [
            p.time_s,
            p.demand_w,
            p.ccv_v * p.current_a,
            p.current_a,
            p.ccv_v,
            cell_v,
            p.ocv_v,
            soc,
        ];
        let columns = [
            &mut t.time_s,
            &mut t.demand_w,
            &mut t.power_w,
            &mut t.current_a,
            &mut t.ccv_v,
            &mut t.cell_v,
            &mut t.ocv_v,
            &mut t.soc,
        ];
        columns
            .into_iter()
            .zip(row)
            .for_each(|(column, value)| column.push(value));
        t.v_rc_v
            .iter_mut()
            .zip(&state.v_rc_v)
            .for_each(|(column, value)| column.push(*value));
        t.temperature_degc.extend(state.temperature_degc);
        t.cell_sigma_v
            .extend(self.model.cell_sigma_v(state, cell_v, p.ocv_v, p.current_a));
    }

    /// Integrates over a sub-step from its start, middle and end (Simpson).
    pub(super) fn passed(&mut self, points: [&Point; 3], states: [&SimState; 3]) {
        let h = points[2].time_s - points[0].time_s;
        let simpson = |f: &dyn Fn(&Point) -> f64| {
            h / 6.0 * (f(points[0]) + 4.0 * f(points[1]) + f(points[2]))
        };
        let s = &mut self.summary;
        s.energy_j += simpson(&|p| p.ccv_v * p.current_a);
        s.charge_coulomb += simpson(&|p| p.current_a);
        s.chemical_j += simpson(&|p| p.ocv_v * p.current_a);
        s.heat_j += simpson(&|p| p.current_a * p.current_a) * self.model.erm.r_ohm;
        for (k, branch) in self.model.erm.branches.iter().enumerate() {
            let v = states.map(|state| state.v_rc_v[k]);
            let square_v2s = if h < 0.2 * branch.time_constant_s() {
                h / 6.0 * (v[0] * v[0] + 4.0 * v[1] * v[1] + v[2] * v[2])
            } else {
                squared_v2s(branch, v[0], points[0], points[2])
            };
            s.heat_j += square_v2s / branch.r_ohm;
        }
        s.steps += 1;
    }

    /// Integrates over a step by trapezoids, with the heat (J) from the caller.
    pub(super) fn moved(&mut self, from: &Point, to: &Point, heat_j: f64) {
        let h = 0.5 * (to.time_s - from.time_s);
        let s = &mut self.summary;
        s.energy_j += h * (from.ccv_v * from.current_a + to.ccv_v * to.current_a);
        s.charge_coulomb += h * (from.current_a + to.current_a);
        s.chemical_j += h * (from.ocv_v * from.current_a + to.ocv_v * to.current_a);
        s.heat_j += heat_j;
        s.steps += 1;
    }

    /// Integrates over a step of explicit Euler, which holds the values at its start.
    pub(super) fn held(&mut self, p: &Point, h: f64, from: &SimState) {
        let s = &mut self.summary;
        s.energy_j += h * p.ccv_v * p.current_a;
        s.charge_coulomb += h * p.current_a;
        s.chemical_j += h * p.ocv_v * p.current_a;
        let branches = self.model.erm.branches.iter().zip(&from.v_rc_v);
        s.heat_j += h
            * (p.current_a * p.current_a * self.model.erm.r_ohm
                + branches.map(|(b, v)| v * v / b.r_ohm).sum::<f64>());
        s.steps += 1;
    }

    /// Returns the results, with the state at the end and the time at the start.
    pub(super) fn close(mut self, end: &SimState, start_s: f64) -> (Summary, Trace) {
        let stored = |state: &SimState| -> f64 {
            self.model
                .erm
                .branches
                .iter()
                .zip(&state.v_rc_v)
                .map(|(b, v)| 0.5 * b.c_f * v * v)
                .sum()
        };
        self.summary.stored_j = stored(end) - self.first.as_ref().map_or(0.0, stored);
        self.summary.margin_low_v = self.window.margin_low_v(self.cell_v.0);
        self.summary.margin_high_v = self.window.margin_high_v(self.cell_v.1);
        let soc = |better: fn(f64, f64) -> f64| {
            self.trace
                .soc
                .iter()
                .copied()
                .filter(|z| z.is_finite())
                .reduce(better)
        };
        (self.summary.soc_min, self.summary.soc_max) = (soc(f64::min), soc(f64::max));
        self.summary.simulated_s = self.trace.time_s.last().map_or(0.0, |t| t - start_s);
        (self.summary, self.trace)
    }
}

/// Returns ∫v² over a step in which the current is linear from i₀ to i₁, V²s: v = α·exp(−t/τ) + β +
/// γt.
fn squared_v2s(branch: &RcBranch, start_v: f64, start: &Point, end: &Point) -> f64 {
    let (r, tau) = (branch.r_ohm, branch.time_constant_s());
    let (i0, i1) = (start.current_a, end.current_a);
    let h = end.time_s - start.time_s;
    let gamma = r * (i1 - i0) / h;
    let beta = r * i0 - gamma * tau;
    let alpha = start_v - beta;
    let a = (-h / tau).exp();
    let fast = 0.5 * alpha * alpha * tau * (1.0 - a * a)
        + 2.0 * alpha * tau * (beta * (1.0 - a) + gamma * (tau - a * (tau + h)));
    fast + h * (beta * beta + beta * gamma * h + gamma * gamma * h * h / 3.0)
}

/// Maximum number of branches whose voltages a trace's file contains.
pub const TRACE_BRANCHES: usize = 16;
