//! Simulates a model whose resistances follow state of charge and temperature.
//!
//! All cells are equal, so that one is integrated, at I/P, and the terminals follow: E = S·(U(z, T)
//! − Σv), R = S/P·R₀(z, T) + interconnect. The time constants are fixed, and the voltage that
//! drives a branch, R(z, T)·i, is taken as linear over a step (`analysis_model::map::BranchStep`).
//! The state at the end of a step enters its own resistances and is found by iteration. The cell
//! warms by its own heat, if the map has a heat capacity. The whole run is repeated with halved
//! steps until no row moves by more than the tolerance.

use super::body::Body;
use super::error::ForwardError;
use super::halving::{Apart, FIRST, GROWTH, LONGEST_S, halved};
use super::law::{Beyond, Demand, Drive};
use super::model::{Mapped, SimModel, SimState};
use super::options::{Method, SimOptions, Simulation};
use super::profile::{DemandPoint, Piece, Profile};
use super::trace::{Point, TraceRecorder};
use analysis_model::map::{BranchStep, CellMap, Drive as BranchDrive, Outside};

/// Two runs, one with half the steps of the other, must agree at every row within this, V per cell.
const AGREE_V: f64 = 5e-6;
/// Evaluations of the end of a step at most.
const MOST_LOOKS: usize = 12;

/// As [`super::simulate`], which has checked state and options.
pub(super) fn simulate(
    model: &SimModel,
    mapped: &Mapped,
    state: &SimState,
    profile: &Profile,
    options: &SimOptions,
) -> Result<Simulation, ForwardError> {
    if options.method == Method::Thesis {
        model.linear_only("explicit Euler")?;
    }
    let play = |halvings: u32| Run::play(model, mapped, state, profile, options, 1 << halvings);
    halved(model, options, AGREE_V, play).map_err(|apart| match apart {
        Apart::Failed(error) => error,
        Apart::Unresolved { tolerance_v, met_v } => {
            ForwardError::MapUnresolved { tolerance_v, met_v }
        }
    })
}

/// State of one cell.
#[derive(Debug, Clone)]
struct Cell {
    soc: f64,
    temperature_degc: f64,
    /// Voltages of the branches, V.
    v: Vec<f64>,
}

/// An instant: the terminals, and what drives the cell.
#[derive(Debug, Clone)]
struct Look {
    point: Point,
    /// Current of one cell, A.
    current_a: f64,
    /// What drives each branch of one cell.
    drives: Vec<BranchDrive>,
    /// Heat of one cell, W.
    heat_w: f64,
    /// Distance from the range of the map.
    outside: Outside,
}

struct Run<'a> {
    model: &'a SimModel,
    map: &'a CellMap,
    ambient_degc: f64,
    demand: Demand,
    options: &'a SimOptions,
    cell: Cell,
    recorder: TraceRecorder<'a>,
    outside: Outside,
    /// Equal parts in which each step is made.
    parts: u32,
}

impl<'a> Run<'a> {
    fn play(
        model: &'a SimModel,
        mapped: &'a Mapped,
        state: &SimState,
        profile: &Profile,
        options: &'a SimOptions,
        parts: u32,
    ) -> Result<Simulation, ForwardError> {
        let series = f64::from(model.pack.series);
        let mut run = Self {
            model,
            map: &mapped.map,
            ambient_degc: mapped.ambient_degc,
            demand: profile.demand,
            options,
            cell: Cell {
                soc: state.soc,
                temperature_degc: state.temperature_degc.unwrap_or(mapped.ambient_degc),
                v: state.v_rc_v.iter().map(|v| v / series).collect(),
            },
            recorder: TraceRecorder::new(model, options.window),
            outside: Outside::default(),
            parts,
        };
        run.through(profile)?;
        let end = run.state();
        let start_s = profile.time_s.first().copied().unwrap_or(0.0);
        let (mut summary, trace) = run.recorder.close(&end, start_s);
        summary.outside_map = Some(run.outside);
        Ok(Simulation {
            summary,
            trace,
            end,
        })
    }

    fn through(&mut self, profile: &Profile) -> Result<(), ForwardError> {
        let shortest_s = self.map.branches.first().map_or(LONGEST_S, |b| b.tau_s);
        let first_s = (FIRST * shortest_s).min(LONGEST_S);
        let (mut last, mut step_s) = (None, first_s);
        for piece in profile.pieces(self.options.max_step_s) {
            let Some(start) = self.seen(piece.start())? else {
                return Ok(());
            };
            if last != Some(piece.from) {
                self.recorder.row(&start.point, &self.state());
                step_s = first_s;
            }
            last = Some(piece.to);
            let Some(end) = self.piece(&piece, start, &mut step_s)? else {
                return Ok(());
            };
            self.recorder.row(&end.point, &self.state());
        }
        Ok(())
    }

    /// Runs one piece by steps that grow; returns `None` if the run ends in it.
    fn piece(
        &mut self,
        piece: &Piece,
        start: Look,
        step_s: &mut f64,
    ) -> Result<Option<Look>, ForwardError> {
        let (mut done_s, mut before) = (0.0, start);
        while done_s < piece.step_s {
            let left_s = piece.step_s - done_s;
            let length_s = if left_s < 1.5 * *step_s {
                left_s
            } else {
                *step_s
            };
            let part_s = length_s / f64::from(self.parts);
            for part in 1..=self.parts {
                if self.stops(&before) {
                    return Ok(None);
                }
                let at_s = done_s + part_s * f64::from(part);
                let end = DemandPoint {
                    time_s: piece.from_s + at_s,
                    demand: piece.from + (piece.to - piece.from) * at_s / piece.step_s,
                };
                self.step(&before, part_s, end)?;
                let Some(after) = self.seen(end)? else {
                    return Ok(None);
                };
                self.moved(&before, &after);
                before = after;
            }
            done_s = if length_s < left_s {
                done_s + length_s
            } else {
                piece.step_s
            };
            *step_s = (*step_s * GROWTH).min(LONGEST_S);
        }
        Ok(Some(before).filter(|look| !self.stops(look)))
    }

    fn moved(&mut self, before: &Look, after: &Look) {
        let pack = self.model.pack;
        let cells = f64::from(pack.series) * f64::from(pack.parallel);
        let heat_w = |look: &Look| {
            let current_a = look.point.current_a;
            cells * look.heat_w + current_a * current_a * pack.interconnect_ohm
        };
        let step_s = after.point.time_s - before.point.time_s;
        let heat_j = 0.5 * step_s * (heat_w(before) + heat_w(after));
        self.recorder.moved(&before.point, &after.point, heat_j);
    }

    fn stops(&self, look: &Look) -> bool {
        look.point.past_tangent || (look.point.infeasible && self.options.beyond == Beyond::Stop)
    }

    /// Moves the cell over a step that ends at a time with a demand.
    fn step(&mut self, before: &Look, step_s: f64, end: DemandPoint) -> Result<(), ForwardError> {
        let from = self.cell.clone();
        let capacity_coulomb = self.model.capacity_coulomb() / f64::from(self.model.pack.parallel);
        let mut after = before.clone();
        for _ in 0..MOST_LOOKS {
            let mean_a = 0.5 * (before.current_a + after.current_a);
            self.cell.soc = from.soc - mean_a * step_s / capacity_coulomb;
            self.cell.temperature_degc =
                self.warmed(&from, 0.5 * (before.heat_w + after.heat_w), step_s);
            let drives = before.drives.iter().zip(&after.drives);
            let branches = self.map.branches.iter().zip(&mut self.cell.v).zip(&from.v);
            for (((branch, v), old), (start, end)) in branches.zip(drives) {
                let step = BranchStep::new(step_s, branch.tau_s);
                *v = step.bent_end(*old, *start, *end).v;
            }
            let seen = self.look(end)?;
            let change_a = (seen.current_a - after.current_a).abs();
            let drives = seen.drives.iter().zip(&after.drives);
            let change_v = drives.fold(0.0, |most: f64, (a, b)| {
                most.max((a.driven_v - b.driven_v).abs())
            });
            let change_w = (seen.heat_w - after.heat_w).abs();
            after = seen;
            let current_settled = change_a <= 1e-11 * after.current_a.abs();
            if current_settled && change_v <= 1e-11 && change_w <= 1e-10 {
                break;
            }
        }
        Ok(())
    }

    /// Temperature of a cell after a step with a mean heat, °C.
    fn warmed(&self, from: &Cell, heat_w: f64, step_s: f64) -> f64 {
        let Some(thermal) = self.map.thermal else {
            return self.ambient_degc;
        };
        let body = Body {
            capacity_j_per_k: thermal.capacity_j_per_k,
            path_w_per_k: 1.0 / thermal.resistance_k_per_w,
        };
        let start_k = from.temperature_degc - self.ambient_degc;
        self.ambient_degc + body.end_k(start_k, heat_w, step_s)
    }

    /// Records an instant; returns `None` if no voltage is left behind the series resistance after
    /// power that was not available.
    fn seen(&mut self, at: DemandPoint) -> Result<Option<Look>, ForwardError> {
        match self.look(at) {
            Err(ForwardError::Collapsed { time_s, .. }) if !self.recorder.feasible() => {
                self.recorder.emptied(time_s, self.options.beyond);
                Ok(None)
            }
            Err(error) => Err(error),
            Ok(look) => {
                self.recorder.see(&look.point);
                self.outside = self.outside.farther(look.outside);
                Ok(Some(look))
            }
        }
    }

    /// Answer of the cell to a demand, in its present state.
    fn look(&self, at: DemandPoint) -> Result<Look, ForwardError> {
        let DemandPoint { time_s, demand } = at;
        let (pack, cell) = (&self.model.pack, &self.cell);
        let (series, parallel) = (f64::from(pack.series), f64::from(pack.parallel));
        let mut branch_ohm = vec![0.0; cell.v.len()];
        let values = self
            .map
            .values(cell.soc, cell.temperature_degc, &mut branch_ohm);
        let ocv_v = self.model.curve_v(cell.soc).0 + series * values.correction_v;
        let sum_v: f64 = cell.v.iter().sum();
        let e_v = ocv_v - series * sum_v;
        if !e_v.is_finite() || (self.demand == Demand::Power && e_v <= 0.0) {
            return Err(ForwardError::Collapsed { time_s, e_v });
        }
        let drive = Drive {
            demand: self.demand,
            beyond: self.options.beyond,
            r_ohm: pack.ratio() * values.r_ohm + pack.interconnect_ohm,
        };
        let (reply, past_tangent) = drive.reply_or_most(e_v, demand);
        let ccv_v = e_v - drive.r_ohm * reply.current_a;
        let power = self.demand == Demand::Power;
        let point = Point {
            time_s,
            demand_w: if power {
                demand
            } else {
                ccv_v * reply.current_a
            },
            current_a: reply.current_a,
            ccv_v,
            ocv_v,
            available_w: drive.available_w(e_v),
            infeasible: reply.infeasible,
            past_tangent,
        };
        let current_a = reply.current_a / parallel;
        let mut heat_w = values.r_ohm * current_a * current_a;
        let branches = self.map.branches.iter().zip(&cell.v).zip(&branch_ohm);
        let drives = branches.map(|((branch, v), r_ohm)| {
            let drive = values.drive(branch.tau_s, *r_ohm, current_a);
            heat_w += drive.lost_w(*v, *r_ohm);
            drive
        });
        let drives = drives.collect();
        Ok(Look {
            point,
            current_a,
            drives,
            heat_w,
            outside: values.outside,
        })
    }

    /// Returns the state at the terminals.
    fn state(&self) -> SimState {
        let series = f64::from(self.model.pack.series);
        SimState {
            soc: self.cell.soc,
            v_rc_v: self.cell.v.iter().map(|v| v * series).collect(),
            temperature_degc: Some(self.cell.temperature_degc),
        }
    }
}
