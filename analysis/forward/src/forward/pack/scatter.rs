//! A pack of cells that scatter, under a profile, many times over: which cell is worst, and how
//! often the pack leaves its window.
//!
//! Resistances, capacitances and capacities are drawn per cell, the state of charge per group:
//! cells in parallel rest at one voltage, hence at one state of charge. Factors are log-normal, so
//! that none is negative. Equal seeds give equal draws on any number of cores.

mod cells;
mod outcome;
mod setup;
mod watch;

pub use cells::{PlacedCell, drawn_cells};
use cells::{check_packs, draw};
pub use outcome::{LeftMap, Outcome, Percentiles, Position, SocRange, Temperatures};

use super::mapped::{Common, MapNetwork};
use super::network::{Cell, Network};
use super::wiring::{Cells, Wiring};
use crate::forward::{Demand, Interpolation, OcvSource, Profile};
use analysis_model::pack::PackError;
use analysis_numeric::Rng;
use rayon::prelude::*;
pub use setup::{Draws, ScatterSetup, Spread};
use setup::{bounds, check};
use watch::{Instant, Watch};

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
    /// Temperature of each draw's hottest cell, °C.
    pub hottest_degc: Percentiles,
    /// Temperature of each draw's coldest cell, °C.
    pub coldest_degc: Percentiles,
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
    /// Change of its highest temperature with half the step, K.
    pub step_error_k: f64,
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
    let alike = draw(&Spread::NONE, setup, &mut Rng::new(0));
    let (identical, all) = run(setup, alike.clone(), &pieces, &|_| true);
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
    let (finer, _) = run(setup, alike, &halved, &|_| false);
    let runs: Vec<(Outcome, Vec<Instant>)> = (0..packs)
        .into_par_iter()
        .map(|k| run(setup, pack(k), &pieces, &|k| kept.get(k) == Some(&true)))
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
            hottest_degc: all(|i| i.hottest_degc),
            coldest_degc: all(|i| i.coldest_degc),
        }
    });
    let bands = bands.filter(|row| row.lowest_v.p50.is_finite()).collect();
    let step_error_v = (identical.min_cell_v - finer.min_cell_v).abs();
    let hottest = |outcome: &Outcome| outcome.temperatures.hottest_degc;
    let step_error_k = (hottest(&identical) - hottest(&finer)).abs();
    Scatter {
        identical,
        bands,
        step_error_v,
        step_error_k,
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

/// Returns the cells of a pack in their wiring.
fn wired<'a>(
    setup: &'a ScatterSetup<'a>,
    placed: Vec<PlacedCell>,
    wiring: Wiring<'a>,
) -> Box<dyn Cells + 'a> {
    if let (Some(map), OcvSource::Curve(curve)) = (setup.map, setup.ocv) {
        let common = Common {
            map,
            curve,
            wiring,
            thermal: &setup.thermal,
        };
        let cells = placed.into_iter().map(PlacedCell::mapped).collect();
        return Box::new(MapNetwork::new(cells, common));
    }
    let cells: Vec<Cell> = placed.iter().map(|cell| cell.cell(setup.cell)).collect();
    Box::new(Network::new(&cells, setup.ocv, wiring, &setup.thermal))
}

/// Runs one pack through the profile; stores the requested instants, by their number, at the start
/// and after each piece.
fn run(
    setup: &ScatterSetup<'_>,
    placed: Vec<PlacedCell>,
    pieces: &[Piece],
    keep: &dyn Fn(usize) -> bool,
) -> (Outcome, Vec<Instant>) {
    let wiring = Wiring {
        parallel: setup.pack.parallel as usize,
        links: setup.links,
        tab_ohm: setup.tab_ohm,
        interconnect_ohm: setup.pack.interconnect_ohm,
    };
    let mut cells = wired(setup, placed, wiring);
    let mut watch = Watch::new(setup, wiring, &*cells);
    let mut instants = Vec::new();
    let kind: Demand = setup.profile.demand;
    let mut demand = f64::NAN;
    for (index, piece) in pieces.iter().enumerate() {
        if piece.from != demand {
            if !cells.look(kind, piece.from) {
                watch.break_down();
                break;
            }
            let instant = watch.see(piece.end_s - piece.step_s, piece.from, &*cells);
            if index == 0 && keep(0) {
                instants.push(instant);
            }
        }
        watch.begin(cells.now());
        if !cells.advance(piece.step_s, kind, piece.to) {
            watch.break_down();
            break;
        }
        demand = piece.to;
        watch.passed(piece.step_s, cells.now());
        let instant = watch.see(piece.end_s, piece.to, &*cells);
        if keep(index + 1) {
            instants.push(instant);
        }
    }
    (watch.close(&*cells), instants)
}

#[cfg(test)]
mod tests;
