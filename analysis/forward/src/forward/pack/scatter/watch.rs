//! Records the extremes of a run of a pack.

use super::super::links::LinkWatch;
use super::super::wiring::{Cells, Look, Wiring};
use super::outcome::{LeftMap, Outcome, Position, SocRange, Temperatures};
use super::setup::ScatterSetup;
use crate::forward::OcvSource;
use analysis_model::map::Outside;

/// Extremes over the cells at an instant.
#[derive(Debug, Clone, Copy)]
pub(super) struct Instant {
    pub(super) time_s: f64,
    pub(super) demand: f64,
    pub(super) lowest_v: f64,
    pub(super) highest_v: f64,
    pub(super) hottest_degc: f64,
    pub(super) coldest_degc: f64,
}

/// Temperatures of a run.
struct Heat {
    /// Joule heat of each cell, J.
    joule_j: Vec<f64>,
    /// Heat of each cell at the start of the step, W.
    before_w: Vec<f64>,
    /// Highest temperature of each cell over the surroundings, K.
    peak_k: Vec<f64>,
    /// Highest of all of them, K, and when, s.
    hottest_k: f64,
    hottest_s: f64,
    spread_k: f64,
    wires_j: f64,
    wires_before_w: f64,
}

/// Record of the extremes of a run.
pub(super) struct Watch<'a> {
    setup: &'a ScatterSetup<'a>,
    wiring: Wiring<'a>,
    links: Option<LinkWatch<'a>>,
    outcome: Outcome,
    largest_mean_a: f64,
    /// Lowest and highest state of charge at the start.
    start_soc: (f64, f64),
    heat: Heat,
    power_before_w: f64,
}

impl<'a> Watch<'a> {
    pub(super) fn new(setup: &'a ScatterSetup<'a>, wiring: Wiring<'a>, start: &dyn Cells) -> Self {
        let (most, least) = (f64::INFINITY, f64::NEG_INFINITY);
        let first = Position::of(0, wiring.parallel);
        let outcome = Outcome {
            min_cell_v: most,
            min_cell_time_s: 0.0,
            min_cell_group: 0,
            max_cell_v: least,
            min_ccv_v: most,
            margin_low_v: 0.0,
            margin_high_v: 0.0,
            largest_cell_a: 0.0,
            largest_share: 1.0,
            soc_spread_end: None,
            soc_range: None,
            hottest_heat_j: 0.0,
            hottest_rise_k: 0.0,
            temperatures: Temperatures {
                hottest_degc: setup.thermal.ambient_degc,
                hottest_time_s: 0.0,
                hottest: first,
                lowest_peak_degc: setup.thermal.ambient_degc,
                coldest: first,
                spread_k: 0.0,
            },
            interconnect_heat_j: 0.0,
            outside_map: None,
            links: None,
            energy_j: 0.0,
            unsettled_steps: 0,
            feasible: true,
        };
        let cells = setup.pack.cells() as usize;
        let heat = Heat {
            joule_j: vec![0.0; cells],
            before_w: vec![0.0; cells],
            peak_k: vec![least; cells],
            hottest_k: least,
            hottest_s: 0.0,
            spread_k: 0.0,
            wires_j: 0.0,
            wires_before_w: 0.0,
        };
        Self {
            setup,
            wiring,
            links: wiring.links.map(LinkWatch::new),
            outcome,
            largest_mean_a: 0.0,
            start_soc: ends(start.soc()),
            heat,
            power_before_w: 0.0,
        }
    }

    /// Notes that the pack has no voltage left.
    pub(super) fn break_down(&mut self) {
        self.outcome.feasible = false;
    }

    /// Begins a step.
    pub(super) fn begin(&mut self, now: &Look) {
        self.heat.before_w.copy_from_slice(&now.heat_w);
        self.heat.wires_before_w = self.wiring.wires_w(now);
        self.power_before_w = now.current_a * now.ccv_v;
        if let Some(links) = &mut self.links {
            links.begin(&now.link_a);
        }
    }

    /// Adds up heat and energy of the step that ends.
    pub(super) fn passed(&mut self, step_s: f64, now: &Look) {
        if let Some(links) = &mut self.links {
            links.passed(step_s, &now.link_a);
        }
        let heat = &mut self.heat;
        let cells = heat.joule_j.iter_mut().zip(&heat.before_w);
        for ((sum, old), new) in cells.zip(&now.heat_w) {
            *sum += 0.5 * step_s * (old + new);
        }
        heat.wires_j += 0.5 * step_s * (heat.wires_before_w + self.wiring.wires_w(now));
        self.outcome.energy_j += 0.5 * step_s * (self.power_before_w + now.current_a * now.ccv_v);
    }

    /// Takes an instant into the extremes.
    pub(super) fn see(&mut self, time_s: f64, demand: f64, cells: &dyn Cells) -> Instant {
        let now = cells.now();
        if let Some(links) = &mut self.links {
            links.see(now.current_a, &now.cell_a, &now.link_a);
        }
        let o = &mut self.outcome;
        let (mut lowest, mut highest, mut place) = (f64::INFINITY, f64::NEG_INFINITY, 0);
        for (k, &v) in now.cell_v.iter().enumerate() {
            if v < lowest {
                (lowest, place) = (v, k);
            }
            highest = highest.max(v);
        }
        if lowest < o.min_cell_v {
            (o.min_cell_v, o.min_cell_time_s, o.min_cell_group) =
                (lowest, time_s, place / self.wiring.parallel + 1);
        }
        o.max_cell_v = o.max_cell_v.max(highest);
        o.min_ccv_v = o.min_ccv_v.min(now.ccv_v);
        o.feasible &= !now.infeasible;
        o.largest_cell_a = now
            .cell_a
            .iter()
            .fold(o.largest_cell_a, |most, i| most.max(i.abs()));
        self.largest_mean_a = self
            .largest_mean_a
            .max(now.current_a.abs() / self.wiring.parallel as f64);
        let ambient_degc = self.setup.thermal.ambient_degc;
        let (cold_k, hot_k) = self.heat.see(time_s, cells.thermal().over_k());
        Instant {
            time_s,
            demand,
            lowest_v: lowest,
            highest_v: highest,
            hottest_degc: ambient_degc + hot_k,
            coldest_degc: ambient_degc + cold_k,
        }
    }

    /// Returns the results of the run.
    pub(super) fn close(mut self, cells: &dyn Cells) -> Outcome {
        let (setup, parallel) = (self.setup, self.wiring.parallel);
        self.outcome.links = self.links.map(LinkWatch::close);
        let o = &mut self.outcome;
        (o.margin_low_v, o.margin_high_v) = (
            setup.window.margin_low_v(o.min_cell_v),
            setup.window.margin_high_v(o.max_cell_v),
        );
        if self.largest_mean_a > 0.0 {
            o.largest_share = o.largest_cell_a / self.largest_mean_a;
        }
        o.hottest_heat_j = self.heat.joule_j.iter().copied().fold(0.0, f64::max);
        o.hottest_rise_k = o.hottest_heat_j / setup.thermal.capacity_j_per_k;
        o.temperatures = self.heat.temperatures(setup, parallel);
        o.interconnect_heat_j = self.heat.wires_j;
        if matches!(setup.ocv, OcvSource::Curve(_)) {
            let (low, high) = ends(cells.soc());
            o.soc_spread_end = Some(high - low);
            o.soc_range = Some(SocRange {
                lowest: low.min(self.start_soc.0),
                highest: high.max(self.start_soc.1),
            });
        }
        o.unsettled_steps = cells.unsettled();
        o.outside_map = cells.left().map(|left| LeftMap {
            outside: Outside {
                soc: left.soc,
                temperature_k: left.temperature_k,
            },
            soc_cell: Position::of(left.soc_cell, parallel),
            temperature_cell: Position::of(left.temperature_cell, parallel),
        });
        self.outcome
    }
}

impl Heat {
    /// Takes temperatures over the surroundings into the extremes; returns the lowest and the
    /// highest, K.
    fn see(&mut self, time_s: f64, over_k: &[f64]) -> (f64, f64) {
        let (cold_k, hot_k) = ends(over_k);
        for (peak, over) in self.peak_k.iter_mut().zip(over_k) {
            *peak = peak.max(*over);
        }
        if hot_k > self.hottest_k {
            (self.hottest_k, self.hottest_s) = (hot_k, time_s);
        }
        self.spread_k = self.spread_k.max(hot_k - cold_k);
        (cold_k, hot_k)
    }

    fn temperatures(&self, setup: &ScatterSetup<'_>, parallel: usize) -> Temperatures {
        let (cold_k, hot_k) = ends(&self.peak_k);
        let place = |wanted: f64| self.peak_k.iter().position(|peak| *peak == wanted);
        let position = |wanted: f64| Position::of(place(wanted).unwrap_or(0), parallel);
        // A pack that breaks down at once is never seen.
        let seen = |over_k: f64| if over_k.is_finite() { over_k } else { 0.0 };
        let degc = |over_k: f64| setup.thermal.ambient_degc + seen(over_k);
        Temperatures {
            hottest_degc: degc(hot_k),
            hottest_time_s: self.hottest_s,
            hottest: position(hot_k),
            lowest_peak_degc: degc(cold_k),
            coldest: position(cold_k),
            spread_k: self.spread_k,
        }
    }
}

/// Returns the lowest and the highest value.
fn ends(values: &[f64]) -> (f64, f64) {
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    let values = values.iter();
    values.fold(none, |(low, high), v| (low.min(*v), high.max(*v)))
}
