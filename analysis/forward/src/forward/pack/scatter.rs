//! A pack of cells that scatter, under a profile, many times over: which cell is worst, and how
//! often the pack leaves its window.
//!
//! Resistances, capacitances and capacities are drawn per cell, the state of charge per group:
//! cells in parallel rest at one voltage, hence at one state of charge. Factors are log-normal, so
//! that none is negative. Equal seeds give equal draws on any number of cores.

mod cells;
mod outcome;
mod setup;

pub use cells::{PlacedCell, drawn_cells};
use cells::{check_packs, draw};
pub use outcome::{Outcome, Percentiles};

use super::network::{Cell, Network, Wiring};
use crate::forward::{Demand, Interpolation, OcvSource, Profile};
use analysis_model::pack::PackError;
use analysis_numeric::Rng;
use rayon::prelude::*;
pub use setup::{Draws, ScatterSetup, Spread};
use setup::{bounds, check};

/// Stretches of the profile of which the bands keep the instants of lowest and highest voltage.
const STRETCHES: usize = 250;

/// An instant of all draws.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BandRow {
    /// Time, s.
    pub time_s: f64,
    /// Demand, W or A.
    pub demand: f64,
    /// Voltage of the cells of the pack of identical cells, V.
    pub identical_v: f64,
    /// Voltage of each draw's lowest cell, V.
    pub lowest_v: Percentiles,
    /// Voltage of each draw's highest cell, V.
    pub highest_v: Percentiles,
}

/// All draws.
#[derive(Debug, Clone, PartialEq)]
pub struct Scatter {
    /// The pack of identical cells.
    pub identical: Outcome,
    /// One per draw.
    pub outcomes: Vec<Outcome>,
    /// Over time.
    pub bands: Vec<BandRow>,
    /// Change of the lowest cell voltage of the identical pack with half the step, V.
    pub step_error_v: f64,
}

impl Scatter {
    /// Returns the fraction of the draws that cannot deliver all the requested power.
    pub fn short_of_power(&self) -> f64 {
        self.outcomes.iter().filter(|o| !o.feasible).count() as f64 / self.outcomes.len() as f64
    }

    /// Returns the share of the draws that leave the window or cannot deliver, and its 95 %
    /// interval (Wilson).
    pub fn leaving(&self) -> (f64, [f64; 2]) {
        let n = self.outcomes.len() as f64;
        let p = self.outcomes.iter().filter(|o| !o.within()).count() as f64 / n;
        let z2 = 1.959_964_f64.powi(2);
        let (centre, half) = (
            p + 0.5 * z2 / n,
            (z2 * (p * (1.0 - p) / n + 0.25 * z2 / (n * n))).sqrt(),
        );
        (
            p,
            [
                if p > 0.0 {
                    (centre - half) / (1.0 + z2 / n)
                } else {
                    0.0
                },
                (centre + half) / (1.0 + z2 / n),
            ],
        )
    }
}

/// Draws packs and runs the profile through each.
///
/// # Errors
/// [`PackError`] for a pack, a cell, a spread or numbers that cannot be.
pub fn scatter(
    setup: &ScatterSetup<'_>,
    spread: &Spread,
    draws: Draws,
) -> Result<Scatter, PackError> {
    check(setup)?;
    spread.check()?;
    bounds(setup, draws.draws)?;
    let mut rng = Rng::new(draws.seed);
    let seeds: Vec<u64> = (0..draws.draws).map(|_| rng.next_u64()).collect();
    Ok(each(setup, seeds.len(), &|k| {
        draw(spread, setup, &mut Rng::new(seeds[k]))
    }))
}

/// Runs the profile through packs of given cells, group by group.
///
/// # Errors
/// [`PackError`] for an invalid pack, cells or numbers.
pub fn scatter_cells(
    setup: &ScatterSetup<'_>,
    packs: &[Vec<PlacedCell>],
) -> Result<Scatter, PackError> {
    check(setup)?;
    bounds(setup, packs.len())?;
    check_packs(setup, packs)?;
    Ok(each(setup, packs.len(), &|k| packs[k].clone()))
}

/// Runs the profile through the drawn packs and through one of identical cells.
fn each(
    setup: &ScatterSetup<'_>,
    packs: usize,
    pack: &(dyn Fn(usize) -> Vec<PlacedCell> + Sync),
) -> Scatter {
    let pieces = pieces(setup.profile, setup.max_step_s);
    let cells = |placed: Vec<PlacedCell>| {
        placed
            .iter()
            .map(|cell| cell.cell(setup.cell))
            .collect::<Vec<Cell>>()
    };
    let alike = cells(draw(&Spread::NONE, setup, &mut Rng::new(0)));
    let (identical, all) = run(setup, &alike, &pieces, &|_| true);
    let kept = telling(&all);
    let line: Vec<Instant> = all
        .into_iter()
        .zip(&kept)
        .filter(|(_, kept)| **kept)
        .map(|(instant, _)| instant)
        .collect();
    let halved = self::pieces(
        setup.profile,
        0.5 * pieces.iter().fold(0.0, |longest, p| p.step_s.max(longest)),
    );
    let (finer, _) = run(setup, &alike, &halved, &|_| false);
    let runs: Vec<(Outcome, Vec<Instant>)> = (0..packs)
        .into_par_iter()
        .map(|k| {
            run(setup, &cells(pack(k)), &pieces, &|k| {
                kept.get(k) == Some(&true)
            })
        })
        .collect();
    let bands = line.iter().enumerate().map(|(k, instant)| {
        // A draw that broke down early has no later instants.
        let all = |which: fn(&Instant) -> f64| {
            Percentiles::of(runs.iter().filter_map(|r| r.1.get(k)).map(which))
        };
        BandRow {
            time_s: instant.time_s,
            demand: instant.demand,
            identical_v: instant.lowest_v,
            lowest_v: all(|i| i.lowest_v),
            highest_v: all(|i| i.highest_v),
        }
    });
    let bands = bands.filter(|row| row.lowest_v.p50.is_finite()).collect();
    let step_error_v = (identical.min_cell_v - finer.min_cell_v).abs();
    Scatter {
        identical,
        bands,
        step_error_v,
        outcomes: runs.into_iter().map(|r| r.0).collect(),
    }
}

/// Part of a profile.
#[derive(Debug, Clone, Copy)]
struct Piece {
    end_s: f64,
    step_s: f64,
    from: f64,
    to: f64,
}

fn pieces(profile: &Profile, max_step_s: f64) -> Vec<Piece> {
    let mut pieces = Vec::new();
    for (times, values) in profile.time_s.windows(2).zip(profile.value.windows(2)) {
        let last = if profile.interpolation == Interpolation::Linear {
            values[1]
        } else {
            values[0]
        };
        let whole = times[1] - times[0];
        let parts = (whole / max_step_s * (1.0 - 1e-9)).ceil().max(1.0);
        let at = |part: f64| values[0] + (last - values[0]) * part / parts;
        for part in 0..parts as usize {
            let part = part as f64;
            let end_s = times[0] + whole * (part + 1.0) / parts;
            pieces.push(Piece {
                end_s,
                step_s: whole / parts,
                from: at(part),
                to: at(part + 1.0),
            });
        }
    }
    pieces
}

/// Extremes over the cells at an instant.
#[derive(Debug, Clone, Copy)]
struct Instant {
    time_s: f64,
    demand: f64,
    lowest_v: f64,
    highest_v: f64,
}

/// Record of the extremes of a run.
struct Watch {
    outcome: Outcome,
    largest_mean_a: f64,
    parallel: usize,
}

impl Watch {
    fn new(parallel: usize) -> Self {
        let (most, least) = (f64::INFINITY, f64::NEG_INFINITY);
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
            hottest_heat_j: 0.0,
            hottest_rise_k: 0.0,
            energy_j: 0.0,
            feasible: true,
        };
        Self {
            outcome,
            largest_mean_a: 0.0,
            parallel,
        }
    }

    fn see(&mut self, time_s: f64, network: &Network<'_>) -> (f64, f64) {
        let now = &network.now;
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
                (lowest, time_s, place / self.parallel + 1);
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
            .max(now.current_a.abs() / self.parallel as f64);
        (lowest, highest)
    }

    fn close(mut self, setup: &ScatterSetup<'_>, heat_j: &[f64], soc: &[f64]) -> Outcome {
        let o = &mut self.outcome;
        (o.margin_low_v, o.margin_high_v) = (
            setup.window.margin_low_v(o.min_cell_v),
            setup.window.margin_high_v(o.max_cell_v),
        );
        if self.largest_mean_a > 0.0 {
            o.largest_share = o.largest_cell_a / self.largest_mean_a;
        }
        o.hottest_heat_j = heat_j.iter().copied().fold(0.0, f64::max);
        o.hottest_rise_k = setup.thermal.rise_k(o.hottest_heat_j);
        if matches!(setup.ocv, OcvSource::Curve(_)) {
            let (low, high) = soc
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| {
                    (l.min(*z), h.max(*z))
                });
            o.soc_spread_end = Some(high - low);
        }
        self.outcome
    }
}

/// Returns the first and the last instant, and of every stretch those of lowest and highest
/// voltage: a peak of one step must not get lost.
fn telling(all: &[Instant]) -> Vec<bool> {
    let mut kept = vec![false; all.len()];
    let stretch = all.len().div_ceil(STRETCHES).max(1);
    for (index, instants) in all.chunks(stretch).enumerate() {
        let by_voltage =
            |a: &(usize, &Instant), b: &(usize, &Instant)| a.1.lowest_v.total_cmp(&b.1.lowest_v);
        let places = || instants.iter().enumerate();
        for (place, _) in places()
            .min_by(by_voltage)
            .into_iter()
            .chain(places().max_by(by_voltage))
        {
            kept[index * stretch + place] = true;
        }
    }
    for end in [0, all.len().saturating_sub(1)] {
        if let Some(end) = kept.get_mut(end) {
            *end = true;
        }
    }
    kept
}

/// Runs one pack through the profile; stores the requested instants, by their number, at the start
/// and after each piece.
fn run(
    setup: &ScatterSetup<'_>,
    cells: &[Cell],
    pieces: &[Piece],
    keep: &dyn Fn(usize) -> bool,
) -> (Outcome, Vec<Instant>) {
    let parallel = setup.pack.parallel as usize;
    let wiring = Wiring {
        parallel,
        tab_ohm: setup.tab_ohm,
        interconnect_ohm: setup.pack.interconnect_ohm,
    };
    let mut network = Network::new(cells, setup.ocv, wiring);
    let mut watch = Watch::new(parallel);
    let mut heat_j = vec![0.0; cells.len()];
    let mut heat_before = heat_j.clone();
    let mut instants = Vec::new();
    let kind: Demand = setup.profile.demand;
    let mut demand = f64::NAN;
    for (index, piece) in pieces.iter().enumerate() {
        if piece.from != demand {
            if !network.look(kind, piece.from) {
                watch.outcome.feasible = false;
                break;
            }
            let (lowest_v, highest_v) = watch.see(piece.end_s - piece.step_s, &network);
            if index == 0 && keep(0) {
                instants.push(Instant {
                    time_s: piece.end_s - piece.step_s,
                    demand: piece.from,
                    lowest_v,
                    highest_v,
                });
            }
        }
        heat_before.copy_from_slice(&network.now.heat_w);
        let power = network.now.current_a * network.now.ccv_v;
        if !network.advance(piece.step_s, kind, piece.to) {
            watch.outcome.feasible = false;
            break;
        }
        demand = piece.to;
        for ((sum, old), new) in heat_j.iter_mut().zip(&heat_before).zip(&network.now.heat_w) {
            *sum += 0.5 * piece.step_s * (old + new);
        }
        watch.outcome.energy_j +=
            0.5 * piece.step_s * (power + network.now.current_a * network.now.ccv_v);
        let (lowest_v, highest_v) = watch.see(piece.end_s, &network);
        if keep(index + 1) {
            instants.push(Instant {
                time_s: piece.end_s,
                demand: piece.to,
                lowest_v,
                highest_v,
            });
        }
    }
    let outcome = watch.close(setup, &heat_j, &network.soc);
    (outcome, instants)
}

#[cfg(test)]
mod tests;
