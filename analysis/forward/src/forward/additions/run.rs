//! One run with additions.

use crate::forward::{
    error::ForwardError,
    halving::{FIRST, GROWTH, LONGEST_S},
    law::{Beyond, Demand, Drive},
    model::{SimModel, SimState},
    nonlinear::Laws,
    options::{SimOptions, Simulation},
    profile::{DemandPoint, Piece, Profile},
    trace::{Point, TraceRecorder},
};
use analysis_effects::contract::{Dynamics, Instant, Modulation, Ramp};
use std::ops::Range;

/// Evaluates the law until current and additions agree.
const MOST_LOOKS: usize = 12;

pub(super) struct Run<'a> {
    model: &'a SimModel,
    laws: &'a Laws,
    demand: Demand,
    options: &'a SimOptions,
    dynamics: Vec<Box<dyn Dynamics>>,
    /// One cell.
    soc: f64,
    /// Branches of one cell, V.
    v: Vec<f64>,
    recorder: TraceRecorder<'a>,
    /// First step after a change of the demand, s.
    first_s: f64,
    /// Equal parts that each step is made in.
    parts: u32,
}

/// An instant as the terminals and as a cell see it.
#[derive(Clone, Copy)]
struct Look {
    point: Point,
    demand: f64,
    cell: Instant,
    factor: Modulation,
    /// Voltage that the additions add to the voltage of a cell, V.
    additions_v: f64,
    /// Heat of one cell, W.
    heat_w: f64,
}

impl<'a> Run<'a> {
    /// Plays the profile from a state, with steps halved the given number of times.
    pub(super) fn play(
        model: &'a SimModel,
        laws: &'a Laws,
        state: &SimState,
        profile: &Profile,
        options: &'a SimOptions,
        halvings: u32,
    ) -> Result<Simulation, ForwardError> {
        let shortest_s = laws
            .network
            .branches
            .iter()
            .map(|b| b.tau_s)
            .fold(LONGEST_S, f64::min);
        let series = f64::from(model.pack.series);
        let mut run = Self {
            model,
            laws,
            demand: profile.demand,
            options,
            dynamics: laws.dynamics(state.soc),
            soc: state.soc,
            v: state.v_rc_v.iter().map(|v| v / series).collect(),
            recorder: TraceRecorder::new(model, options.window),
            first_s: FIRST * shortest_s,
            parts: 1 << halvings,
        };
        run.through(profile)?;
        let end = run.state();
        let (summary, trace) = run
            .recorder
            .close(&end, profile.time_s.first().copied().unwrap_or(0.0));
        Ok(Simulation {
            summary,
            trace,
            end,
        })
    }

    fn through(&mut self, profile: &Profile) -> Result<(), ForwardError> {
        let (mut last, mut step_s) = (None, self.first_s);
        for piece in profile.pieces(self.options.max_step_s) {
            let slope = (piece.to - piece.from) / piece.step_s;
            let Some(start) = self.seen(piece.start())? else {
                return Ok(());
            };
            if last.is_none_or(|(to, _)| to != piece.from) {
                self.recorder.row(&start.point, &self.state());
            }
            // Pieces of one row have one slope, up to rounding.
            if last.is_none_or(|(to, before)| {
                to != piece.from || f64::abs(before - slope) > 1e-6 * f64::abs(slope)
            }) {
                step_s = self.first_s;
            }
            last = Some((piece.to, slope));
            let Some(end) = self.piece(&piece, start, &mut step_s)? else {
                return Ok(());
            };
            self.recorder.row(&end.point, &self.state());
        }
        Ok(())
    }

    /// Runs one piece; returns `None` if the run ends in it.
    fn piece(
        &mut self,
        piece: &Piece,
        start: Look,
        step_s: &mut f64,
    ) -> Result<Option<Look>, ForwardError> {
        let (mut done_s, mut before) = (0.0, start);
        while done_s < piece.step_s {
            let left_s = piece.step_s - done_s;
            let next_s = if left_s < 1.5 * *step_s {
                piece.step_s
            } else {
                done_s + *step_s
            };
            let at = |t: f64| DemandPoint {
                time_s: piece.from_s + t,
                demand: piece.from + (piece.to - piece.from) * t / piece.step_s,
            };
            let Some(after) = self.parts(before, done_s..next_s, at)? else {
                return Ok(None);
            };
            (done_s, before) = (next_s, after);
            *step_s = (*step_s * GROWTH).min(LONGEST_S);
        }
        Ok(Some(before).filter(|p| !self.stops(p)))
    }

    /// Runs a step in its parts; returns `None` if the run ends in it.
    fn parts(
        &mut self,
        start: Look,
        span_s: Range<f64>,
        at: impl Fn(f64) -> DemandPoint,
    ) -> Result<Option<Look>, ForwardError> {
        let pack = self.model.pack;
        let cells = f64::from(pack.series) * f64::from(pack.parallel);
        let heat_w = |look: &Look| {
            cells * look.heat_w
                + look.point.current_a * look.point.current_a * pack.interconnect_ohm
        };
        let part_s = (span_s.end - span_s.start) / f64::from(self.parts);
        let mut before = start;
        for part in 1..=self.parts {
            if self.stops(&before) {
                return Ok(None);
            }
            let end = if part == self.parts {
                at(span_s.end)
            } else {
                at(span_s.start + part_s * f64::from(part))
            };
            self.step(&before, part_s, end)?;
            let Some(after) = self.seen(end)? else {
                return Ok(None);
            };
            let heat_j = 0.5 * (heat_w(&before) + heat_w(&after)) * part_s;
            self.recorder.moved(&before.point, &after.point, heat_j);
            before = after;
        }
        Ok(Some(before))
    }

    fn stops(&self, look: &Look) -> bool {
        look.point.past_tangent || (look.point.infeasible && self.options.beyond == Beyond::Stop)
    }

    /// Moves the cell over a step that ends at a time with a demand.
    fn step(&mut self, before: &Look, step_s: f64, end: DemandPoint) -> Result<(), ForwardError> {
        let capacity_coulomb = self.model.capacity_coulomb() / f64::from(self.model.pack.parallel);
        self.dynamics
            .iter_mut()
            .for_each(|d| d.advance(&before.cell, 0.5 * step_s));
        let start = self.look(DemandPoint {
            time_s: before.point.time_s,
            demand: before.demand,
        })?;
        let (soc, v, i0) = (self.soc, self.v.clone(), start.cell.current_a);
        // The second half of the additions changes the results of the first half again.
        let (f0, drift) = (
            before.factor.branches,
            start.factor.branches - before.factor.branches,
        );
        let (mut i1, mut f1) = (i0, f0 + 2.0 * drift);
        let ramp = |start: f64, end: f64| Ramp { start, end };
        // The current at the end and the branches there wait for each other: a step may be long
        // beside the fastest of them.
        for _ in 0..MOST_LOOKS {
            (self.soc, self.v) = (soc - 0.5 * (i0 + i1) * step_s / capacity_coulomb, v.clone());
            self.laws
                .network
                .advance(&mut self.v, ramp(f0, f1), ramp(i0, i1), step_s);
            let seen = self.look(end)?;
            f1 = seen.factor.branches + drift;
            let change_a = (seen.cell.current_a - i1).abs();
            i1 = seen.cell.current_a;
            if change_a <= 1e-12 * i1.abs() {
                break;
            }
        }
        let mut after = self.look(end)?.cell;
        // Without this a heat that depends on itself is of first order.
        after.current_a += start.cell.current_a - before.cell.current_a;
        after.overpotential_v += start.cell.overpotential_v - before.cell.overpotential_v;
        after.stored_w += start.cell.stored_w - before.cell.stored_w;
        self.dynamics
            .iter_mut()
            .for_each(|d| d.advance(&after, 0.5 * step_s));
        Ok(())
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
                Ok(Some(Look {
                    heat_w: self.heat_w(&look),
                    ..look
                }))
            }
        }
    }

    /// Answer of the law at a time under a demand, with the additions as they are. The heat
    /// is left to [`Self::seen`].
    fn look(&self, at: DemandPoint) -> Result<Look, ForwardError> {
        let DemandPoint { time_s, demand } = at;
        let pack = &self.model.pack;
        let (series, parallel) = (f64::from(pack.series), f64::from(pack.parallel));
        let (ocv_v, slope_v) = self.model.ocv_v(self.soc);
        let (sum_v, r_ohm) = (self.v.iter().sum::<f64>(), self.laws.network.r_ohm);
        let (ocv_cell_v, slope_v) = (ocv_v / series, slope_v / series);
        let mut cell = Instant {
            time_s,
            current_a: 0.0,
            soc: self.soc,
            ocv_v: ocv_cell_v,
            slope_v,
            overpotential_v: sum_v,
            stored_w: 0.0,
        };
        let mut factor = Modulation::NONE;
        let mut looks = 0;
        loop {
            cell.overpotential_v = r_ohm * factor.series * cell.current_a + sum_v;
            factor = self.modulation(&cell);
            let additions_v: f64 = self.dynamics.iter().map(|d| d.voltage_v(&cell)).sum();
            let e_v = series * (ocv_cell_v - sum_v + additions_v);
            if !e_v.is_finite() || (self.demand == Demand::Power && e_v <= 0.0) {
                return Err(ForwardError::Collapsed { time_s, e_v });
            }
            let terminals_ohm = pack.ratio() * r_ohm * factor.series + pack.interconnect_ohm;
            let drive = Drive {
                demand: self.demand,
                beyond: self.options.beyond,
                r_ohm: terminals_ohm,
            };
            let (reply, past_tangent) = drive.reply_or_most(e_v, demand);
            let current_a = reply.current_a / parallel;
            let change_a = (current_a - cell.current_a).abs();
            cell.current_a = current_a;
            looks += 1;
            if change_a > 1e-13 * current_a.abs() && looks < MOST_LOOKS {
                continue;
            }
            cell.stored_w = self
                .laws
                .network
                .stored_w(&self.v, current_a, factor.branches);
            let (current_a, ccv_v) = (reply.current_a, e_v - terminals_ohm * reply.current_a);
            let demand_w = if self.demand == Demand::Power {
                demand
            } else {
                ccv_v * current_a
            };
            let (available_w, infeasible) = (drive.available_w(e_v), reply.infeasible);
            let point = Point {
                time_s,
                demand_w,
                current_a,
                ccv_v,
                ocv_v,
                available_w,
                infeasible,
                past_tangent,
            };
            return Ok(Look {
                point,
                demand,
                cell,
                factor,
                additions_v,
                heat_w: 0.0,
            });
        }
    }

    /// Returns the heat of one cell, W: of its resistances and of the voltage drops of the
    /// additions.
    fn heat_w(&self, look: &Look) -> f64 {
        let i = look.cell.current_a;
        let branches = self
            .laws
            .network
            .branches
            .iter()
            .zip(&self.v)
            .map(|(b, v)| v * b.conducted_a(*v, look.factor.branches));
        i * i * self.laws.network.r_ohm * look.factor.series + branches.sum::<f64>()
            - i * look.additions_v
    }

    fn modulation(&self, at: &Instant) -> Modulation {
        self.dynamics
            .iter()
            .map(|d| d.modulation(at))
            .fold(Modulation::NONE, |all, one| Modulation {
                series: all.series * one.series,
                branches: all.branches * one.branches,
            })
    }

    /// Returns the state at the terminals.
    fn state(&self) -> SimState {
        let series = f64::from(self.model.pack.series);
        SimState {
            soc: self.soc,
            v_rc_v: self.v.iter().map(|v| v * series).collect(),
            temperature_degc: None,
        }
    }
}
