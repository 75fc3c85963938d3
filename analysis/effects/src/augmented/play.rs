//! Plays a record: the voltage that base and effects predict for a logged current.

use super::{Added, network};
use crate::contract::{
    Base, Dynamics, Instant, Law, Modulation, Network, Record,
    branch::{self, Branch, Gain, Ramp},
};
use analysis_model::ocv::OcvCurve;
use std::{collections::HashMap, sync::Arc};

/// Interpolation of the current between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Between {
    /// It stays until the next sample.
    Hold,
    /// It goes there along a straight line.
    Linear,
}

/// The steps of a record, computed once for all its simulations.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    between: Between,
    /// For each step its number in `lengths_s`.
    index: Vec<u32>,
    /// Different lengths of steps, s.
    lengths_s: Arc<[f64]>,
}

impl Grid {
    /// Computes the steps between times (s, rising). Lengths within 1 ns count as equal.
    pub fn new(time_s: &[f64], between: Between) -> Self {
        let mut lengths: std::collections::BTreeMap<i64, u32> = std::collections::BTreeMap::new();
        let mut lengths_s = Vec::new();
        let index = time_s
            .windows(2)
            .map(|w| {
                let step_s = w[1] - w[0];
                *lengths
                    .entry((step_s * 1e9).round() as i64)
                    .or_insert_with(|| {
                        lengths_s.push(step_s);
                        lengths_s.len() as u32 - 1
                    })
            })
            .collect();
        Self {
            between,
            index,
            lengths_s: lengths_s.into(),
        }
    }
}

/// Simulates records; keeps its buffers between simulations.
#[derive(Debug, Default)]
pub struct Player {
    current_a: Vec<f64>,
    gains: Vec<Gain>,
    states_v: Vec<f64>,
    /// Sum of the states, V.
    sum_v: f64,
    kept: Kept,
}

/// Gains per ohm of branches that were simulated before. From one simulation of a fit to the next
/// only some time constants change, and the exponentials per step and branch dominate the cost.
#[derive(Debug, Default)]
struct Kept {
    of: HashMap<Key, Arc<[Gain]>>,
    /// Lengths of steps that the keys speak of; kept, so that no other ones get their address.
    lengths_s: HashMap<usize, Arc<[f64]>>,
    gains: usize,
}

/// The dependencies of the gains per ohm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Key {
    lengths_s: usize,
    tau_s: u64,
    clock: u64,
    parts: usize,
    linear: bool,
}

/// Gains that are kept at most; 24 MB.
const MOST_KEPT: usize = 1 << 20;

impl Kept {
    /// Gains of all lengths of steps of a grid for a branch of 1 Ω with this time constant.
    fn gains(&mut self, grid: &Grid, tau_s: f64, parts: usize, clock: f64) -> Arc<[Gain]> {
        let linear = grid.between == Between::Linear;
        let key = Key {
            lengths_s: grid.lengths_s.as_ptr() as usize,
            tau_s: tau_s.to_bits(),
            clock: clock.to_bits(),
            parts,
            linear,
        };
        if let Some(gains) = self.of.get(&key) {
            return Arc::clone(gains);
        }
        if self.gains + grid.lengths_s.len() > MOST_KEPT {
            *self = Self::default();
        }
        let branch = Branch::linear(1.0, tau_s);
        let lengths = grid.lengths_s.iter();
        let gains: Arc<[Gain]> = lengths
            .map(|step_s| Gain::new(&branch, 1.0, step_s * clock / parts as f64, linear))
            .collect();
        self.gains += gains.len();
        self.lengths_s
            .entry(key.lengths_s)
            .or_insert_with(|| Arc::clone(&grid.lengths_s));
        self.of.insert(key, Arc::clone(&gains));
        gains
    }
}

/// The open-circuit voltage near the last question: the interval between two knots and its cubic.
struct Cursor<'a> {
    curve: &'a OcvCurve,
    low: f64,
    high: f64,
    /// Coefficients of powers of (z − low), V.
    c: [f64; 4],
}

impl<'a> Cursor<'a> {
    fn new(curve: &'a OcvCurve) -> Self {
        Self {
            curve,
            low: f64::NAN,
            high: f64::NAN,
            c: [0.0; 4],
        }
    }

    /// OCV and its slope, V.
    fn at(&mut self, soc: f64) -> (f64, f64) {
        if !(self.low <= soc && soc < self.high) {
            let knots = &self.curve.soc;
            let last = knots.len() - 1;
            if !(soc >= knots[0] && soc < knots[last]) {
                return self.curve.at(soc);
            }
            let k = knots.partition_point(|z| *z <= soc).clamp(1, last) - 1;
            let h = knots[k + 1] - knots[k];
            let (m0, m1) = (self.curve.slope_v[k], self.curve.slope_v[k + 1]);
            let secant = (self.curve.ocv_v[k + 1] - self.curve.ocv_v[k]) / h;
            (self.low, self.high) = (knots[k], knots[k + 1]);
            self.c = [
                self.curve.ocv_v[k],
                m0,
                (3.0 * secant - 2.0 * m0 - m1) / h,
                (m0 + m1 - 2.0 * secant) / (h * h),
            ];
        }
        let (x, c) = (soc - self.low, &self.c);
        (
            c[0] + x * (c[1] + x * (c[2] + x * c[3])),
            c[1] + x * (2.0 * c[2] + 3.0 * x * c[3]),
        )
    }
}

impl Player {
    /// Writes the logged voltage (V) that is predicted for every sample of the record into
    /// `voltage_v`.
    ///
    /// Each step is divided into `parts` equal ones (1 for the product, more to measure the error
    /// of integration).
    pub fn play(
        &mut self,
        base: &Base,
        added: &[Added<'_>],
        record: &Record<'_>,
        grid: &Grid,
        parts: usize,
        voltage_v: &mut Vec<f64>,
    ) {
        let mut current_a = std::mem::take(&mut self.current_a);
        current_a.clear();
        current_a.extend_from_slice(record.current_a);
        added
            .iter()
            .for_each(|a| a.effect.current(a.p, record, &mut current_a));
        let network = network(base, added);
        let clock: f64 = added.iter().map(|a| a.effect.clock(a.p)).product();
        let mut dynamics: Vec<Box<dyn Dynamics>> = added
            .iter()
            .filter_map(|a| a.effect.dynamics(a.p, base, record))
            .collect();
        voltage_v.clear();
        let linear = dynamics.is_empty() && network.branches.iter().all(|b| b.law == Law::Linear);
        // A linear network needs no parts: its steps are exact.
        self.load(&network, grid, if linear { 1 } else { parts }, clock);
        let run = Run {
            base,
            network: &network,
            record,
            current_a: &current_a,
            grid,
            parts,
            clock,
            asks_heat: dynamics.iter().any(|d| d.asks_heat()),
        };
        if linear {
            self.linear(&run, voltage_v);
        } else {
            self.general(&run, &mut dynamics, voltage_v);
        }
        added
            .iter()
            .for_each(|a| a.effect.voltage(a.p, record, voltage_v));
        self.current_a = current_a;
    }

    /// Gains of all lengths of steps and branches.
    fn load(&mut self, network: &Network, grid: &Grid, parts: usize, clock: f64) {
        let n = network.branches.len();
        self.sum_v = 0.0;
        self.states_v.clear();
        self.states_v.resize(n, 0.0);
        self.gains.clear();
        self.gains.resize(n * grid.lengths_s.len(), Gain::default());
        for (j, branch) in network.branches.iter().enumerate() {
            let per_ohm = self.kept.gains(grid, branch.tau_s, parts, clock);
            let of_branch = self.gains.iter_mut().skip(j).step_by(n);
            of_branch
                .zip(per_ohm.iter())
                .for_each(|(gain, per_ohm)| *gain = per_ohm.times(branch.r_ohm));
        }
    }

    fn linear(&mut self, run: &Run<'_>, voltage_v: &mut Vec<f64>) {
        let n = run.network.branches.len();
        let capacity_coulomb = 3600.0 * run.base.ocv.capacity_ah;
        let mut ocv = Cursor::new(&run.base.ocv);
        let mut soc = run.record.soc;
        for k in 0..run.current_a.len() {
            voltage_v.push(ocv.at(soc).0 - run.network.r_ohm * run.current_a[k] - self.sum_v);
            let Some(d) = run.grid.index.get(k) else {
                break;
            };
            let (i0, i1) = ends(run.current_a, k, run.grid.between);
            let step_s = run.grid.lengths_s[*d as usize] * run.clock;
            let gains = &self.gains[*d as usize * n..(*d as usize + 1) * n];
            let mut sum_v = 0.0;
            for (v, g) in self.states_v.iter_mut().zip(gains) {
                *v = g.decay * *v + g.start * i0 + g.end * i1;
                sum_v += *v;
            }
            self.sum_v = sum_v;
            soc -= 0.5 * (i0 + i1) * step_s / capacity_coulomb;
        }
    }

    fn general(
        &mut self,
        run: &Run<'_>,
        dynamics: &mut [Box<dyn Dynamics>],
        voltage_v: &mut Vec<f64>,
    ) {
        let capacity_coulomb = 3600.0 * run.base.ocv.capacity_ah;
        let mut ocv = Cursor::new(&run.base.ocv);
        let (mut soc, mut time_s) = (
            run.record.soc,
            run.record.time_s.first().copied().unwrap_or(0.0),
        );
        for k in 0..run.current_a.len() {
            let start = State {
                time_s,
                soc,
                current_a: run.current_a[k],
            };
            let mut at = self.instant(run, dynamics, start, &mut ocv);
            let additions: f64 = dynamics.iter().map(|d| d.voltage_v(&at)).sum();
            voltage_v.push(at.ocv_v - at.overpotential_v + additions);
            let Some(d) = run.grid.index.get(k) else {
                break;
            };
            let (i0, i1) = ends(run.current_a, k, run.grid.between);
            let part_s = run.grid.lengths_s[*d as usize] * run.clock / run.parts as f64;
            for part in 0..run.parts {
                let along = |part: usize| i0 + (i1 - i0) * part as f64 / run.parts as f64;
                let (from, to) = (along(part), along(part + 1));
                if part > 0 {
                    let before = State {
                        time_s,
                        soc,
                        current_a: from,
                    };
                    at = self.instant(run, dynamics, before, &mut ocv);
                }
                // The dynamics see the mean current of each half of the step: one before the
                // branches move, one after.
                at.current_a = 0.75 * from + 0.25 * to;
                let start = modulation(dynamics, &at).branches;
                dynamics
                    .iter_mut()
                    .for_each(|d| d.advance(&at, 0.5 * part_s));
                let mean_a = 0.5 * (from + to);
                let moved = mean_a * part_s / capacity_coulomb;
                let middle = Instant {
                    time_s: time_s + 0.5 * part_s,
                    current_a: mean_a,
                    soc: soc - 0.5 * moved,
                    ..at
                };
                let factor = Change {
                    start,
                    middle: modulation(dynamics, &middle).branches,
                };
                let current_a = Ramp {
                    start: from,
                    end: to,
                };
                self.move_branches(run, factor, current_a, *d as usize, part_s);
                soc -= moved;
                time_s += part_s;
                let end = State {
                    time_s,
                    soc,
                    current_a: to,
                };
                let mut after = self.instant(run, dynamics, end, &mut ocv);
                after.current_a = 0.25 * from + 0.75 * to;
                dynamics
                    .iter_mut()
                    .for_each(|d| d.advance(&after, 0.5 * part_s));
            }
        }
    }

    fn instant(
        &self,
        run: &Run<'_>,
        dynamics: &[Box<dyn Dynamics>],
        state: State,
        ocv: &mut Cursor<'_>,
    ) -> Instant {
        let State {
            time_s,
            soc,
            current_a,
        } = state;
        let (ocv_v, slope_v) = ocv.at(soc);
        let sum = self.sum_v;
        let overpotential_v = run.network.r_ohm * current_a + sum;
        let mut at = Instant {
            time_s,
            current_a,
            soc,
            ocv_v,
            slope_v,
            overpotential_v,
            stored_w: f64::NAN,
        };
        let factor = modulation(dynamics, &at);
        at.overpotential_v = run.network.r_ohm * factor.series * current_a + sum;
        if run.asks_heat {
            at.stored_w = run
                .network
                .stored_w(&self.states_v, current_a, factor.branches);
        }
        at
    }

    fn move_branches(
        &mut self,
        run: &Run<'_>,
        factor: Change,
        current_a: Ramp,
        d: usize,
        part_s: f64,
    ) {
        let (from, to) = (current_a.start, current_a.end);
        let n = run.network.branches.len();
        let mut sum_v = 0.0;
        for (j, (v, branch)) in self
            .states_v
            .iter_mut()
            .zip(&run.network.branches)
            .enumerate()
        {
            if factor.start == 1.0 && factor.middle == 1.0 {
                *v = if branch.law == Law::Linear {
                    let gain = self.gains[d * n + j];
                    gain.decay * *v + gain.start * from + gain.end * to
                } else {
                    branch::ramp(branch, 1.0, *v, current_a, part_s)
                };
                sum_v += *v;
                continue;
            }
            // A fast branch ends with the resistance of the step's end: the product of resistance
            // and current is what changes linearly.
            let gain = Gain::new(branch, factor.middle, part_s, true);
            let (start, end) = (
                gain.start * factor.start / factor.middle,
                gain.end * (2.0 - factor.start / factor.middle),
            );
            *v = match branch.law {
                Law::Linear => gain.decay * *v + start * from + end * to,
                _ => branch::ramp(
                    branch,
                    factor.middle * (start + end) / (gain.start + gain.end),
                    *v,
                    current_a,
                    part_s,
                ),
            };
            sum_v += *v;
        }
        self.sum_v = sum_v;
    }
}

/// State of a cell.
#[derive(Clone, Copy)]
struct State {
    /// Time, s.
    time_s: f64,
    /// State of charge, 0…1.
    soc: f64,
    /// Current, A.
    current_a: f64,
}

/// The factor on the branches' resistances over a step.
#[derive(Clone, Copy)]
struct Change {
    start: f64,
    middle: f64,
}

/// Input of one simulation.
struct Run<'a> {
    base: &'a Base,
    network: &'a Network,
    record: &'a Record<'a>,
    current_a: &'a [f64],
    grid: &'a Grid,
    parts: usize,
    clock: f64,
    asks_heat: bool,
}

/// Currents at start and end of step k.
fn ends(current_a: &[f64], k: usize, between: Between) -> (f64, f64) {
    match between {
        Between::Hold => (current_a[k], current_a[k]),
        Between::Linear => (current_a[k], current_a[k + 1]),
    }
}

fn modulation(dynamics: &[Box<dyn Dynamics>], at: &Instant) -> Modulation {
    dynamics
        .iter()
        .map(|d| d.modulation(at))
        .fold(Modulation::NONE, |all, one| Modulation {
            series: all.series * one.series,
            branches: all.branches * one.branches,
        })
}
