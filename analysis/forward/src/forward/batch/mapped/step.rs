//! Inner loop: plain arithmetic over lists of numbers, which the compiler turns into vectors of the
//! machine's length.
//!
//! A step predicts charge and temperature from the current at its start, takes the resistances there,
//! moves the branches, and corrects everything by the current at its end: second order in the step.

use super::super::law::{BEND, CLAMPED, CURRENT, LOAD, TANGENT, less, more};
use super::super::ocv_piece::Row;
use super::super::plan::Plan;
use super::super::tally::Source;
use super::bend::Bent;
use super::lanes::{Block, BlockGains, Gains, MapLanes};
use super::tables::Place;
use analysis_effects::contract::Ramp;

/// Steps to be made.
#[derive(Clone, Copy)]
pub(in crate::forward) enum Steps<'p> {
    /// All of a plan.
    All(&'p Plan<'p>),
    /// One of the first length under a held demand.
    One(f64),
}

/// Makes steps.
pub(in crate::forward) fn run<const W: usize, const L: usize>(
    lanes: &mut MapLanes<'_, W, L>,
    steps: Steps<'_>,
) {
    match lanes.fixed.law.kind {
        CURRENT => by_heat::<W, L, CURRENT>(lanes, steps),
        LOAD => by_heat::<W, L, LOAD>(lanes, steps),
        TANGENT => by_heat::<W, L, TANGENT>(lanes, steps),
        BEND => by_heat::<W, L, BEND>(lanes, steps),
        _ => by_heat::<W, L, CLAMPED>(lanes, steps),
    }
}

fn by_heat<const W: usize, const L: usize, const LAW: u8>(
    lanes: &mut MapLanes<'_, W, L>,
    steps: Steps<'_>,
) {
    let arch = pulp::Arch::new();
    if lanes.fixed.heated {
        arch.dispatch(Made::<W, L, LAW, true>(lanes, steps));
    } else {
        arch.dispatch(Made::<W, L, LAW, false>(lanes, steps));
    }
}

/// The loop as something to dispatch. A closure would not be inlined into the function that has the
/// machine's vectors.
struct Made<'l, 'c, 'p, const W: usize, const L: usize, const LAW: u8, const HEATED: bool>(
    &'l mut MapLanes<'c, W, L>,
    Steps<'p>,
);

impl<const W: usize, const L: usize, const LAW: u8, const HEATED: bool> pulp::WithSimd
    for Made<'_, '_, '_, W, L, LAW, HEATED>
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self(lanes, steps) = self;
        let gains = std::mem::take(&mut lanes.gains);
        match steps {
            Steps::One(demand) => {
                let held = Ramp {
                    start: demand,
                    end: demand,
                };
                step::<W, L, LAW, HEATED>(lanes, &gains[0], held, 0.0);
            }
            Steps::All(plan) => all::<W, L, LAW, HEATED>(lanes, plan, &gains),
        }
        lanes.gains = gains;
    }
}

#[inline(always)]
fn all<const W: usize, const L: usize, const LAW: u8, const HEATED: bool>(
    lanes: &mut MapLanes<'_, W, L>,
    plan: &Plan<'_>,
    gains: &[Gains<W, L>],
) {
    let mut index = 0.0;
    for run in &plan.runs {
        let gain = &gains[run.length];
        for row in plan.rows(run) {
            let (from, rise) = plan.row(row, run.share);
            for part in 0..run.parts {
                let demand = Ramp {
                    start: from + rise * part as f64,
                    end: from + rise * (part + 1) as f64,
                };
                step::<W, L, LAW, HEATED>(lanes, gain, demand, index);
                index += 1.0;
            }
        }
    }
}

/// Cells, or branches of cells, in the middle of a step: under the current at its start, where that
/// alone leads.
#[derive(Clone, Copy)]
struct Middle<const L: usize> {
    current: Row<L>,
    /// Place in the piece.
    t: Row<L>,
    u: Row<L>,
    /// Twice the exchange current, at the start and here, A.
    twice: [Row<L>; 2],
    /// Smallest resistance of a branch in its bend and its heat, Ω.
    floor: Row<L>,
}

/// Sums over the branches of a cell, or over some of them.
struct Sums<const L: usize> {
    v: Row<L>,
    push: Row<L>,
    lost: Row<L>,
}

/// Makes one step of all lanes.
#[inline(always)]
fn step<const W: usize, const L: usize, const LAW: u8, const HEATED: bool>(
    lanes: &mut MapLanes<'_, W, L>,
    g: &Gains<W, L>,
    demand: Ramp,
    index: f64,
) {
    let fixed = &lanes.fixed;
    let piece = &lanes.piece;
    let now = &mut lanes.now;
    let [keep, warm] = &g.warmed;
    let mut middle = Middle {
        current: [0.0; W],
        t: [0.0; W],
        u: [0.0; W],
        twice: [now.twice; 2],
        floor: fixed.floor,
    };
    let mut short = [false; W];
    for l in 0..W {
        let asked = demand.start * fixed.scale[l];
        let (i, is_short) = fixed.law.current::<LAW>(now.e[l], now.r[l], asked);
        middle.current[l] = i;
        short[l] = is_short;
        let soc = now.soc[l] - g.soc[l] * i;
        let degc = if HEATED {
            let heat_w = (now.r[l] - fixed.interconnect[l]) * i * i + now.lost[l];
            fixed.ambient[l] + keep[l] * (now.degc[l] - fixed.ambient[l]) + warm[l] * heat_w
        } else {
            now.degc[l]
        };
        let place = piece.place(l, soc, degc);
        (middle.t[l], middle.u[l]) = (place.t, place.u);
    }
    if fixed.bent_blocks > 0 {
        for l in 0..W {
            middle.twice[1][l] = piece.twice_a::<HEATED>(l, middle.place(l));
        }
    }
    let many = middle.beside::<L>();
    let mut sums = Sums {
        v: [0.0; L],
        push: [0.0; L],
        lost: [0.0; L],
    };
    let (bent, straight) = lanes.blocks.split_at_mut(fixed.bent_blocks);
    let (bent_gains, straight_gains) = g.blocks.split_at(fixed.bent_blocks);
    for (block, gain) in bent.iter_mut().zip(bent_gains) {
        bent_step::<L, HEATED>(block, gain, &many, &mut sums);
    }
    for (block, gain) in straight.iter_mut().zip(straight_gains) {
        straight_step::<L, HEATED>(block, gain, &many, &mut sums);
    }
    let (sum_v, push) = (across::<W, L>(sums.v), across::<W, L>(sums.push));
    let lost = if HEATED {
        across::<W, L>(sums.lost)
    } else {
        [0.0; W]
    };
    let mut more_a = [0.0; W];
    let mut left = false;
    for l in 0..W {
        let asked = demand.end * fixed.scale[l];
        let i0 = middle.current[l];
        let place = middle.place(l);
        let r = piece.series_ohm::<HEATED>(l, place) + fixed.interconnect[l];
        let e = piece.ocv_v::<HEATED>(l, place) - sum_v[l];
        let (i1, is_short) = fixed.law.current::<LAW>(e, r, asked);
        more_a[l] = i1 - i0;
        let soc = now.soc[l] - 0.5 * g.soc[l] * (i0 + i1);
        let degc = if HEATED {
            let series_w = (now.r[l] - fixed.interconnect[l]) * i0 * i0
                + (r - fixed.interconnect[l]) * i1 * i1;
            let heat_w = 0.5 * series_w + lost[l];
            fixed.ambient[l] + keep[l] * (now.degc[l] - fixed.ambient[l]) + warm[l] * heat_w
        } else {
            now.degc[l]
        };
        let place = piece.place(l, soc, degc);
        let e1 = piece.ocv_v::<HEATED>(l, place) - (sum_v[l] + push[l] * more_a[l]);
        let r1 = piece.series_ohm::<HEATED>(l, place) + fixed.interconnect[l];
        let source = |e_v: f64, current_a: f64, r_ohm: f64| Source {
            e_v,
            current_a,
            r_ohm,
            interconnect_ohm: fixed.interconnect[l],
        };
        let start = source(now.e[l], i0, now.r[l]);
        lanes.tally.add(l, g.step_s, start, source(e, i1, r));
        let at = if short[l] | is_short {
            index
        } else {
            f64::INFINITY
        };
        lanes.tally.infeasible[l] = less(lanes.tally.infeasible[l], at);
        now.seen_soc[0][l] = less(now.seen_soc[0][l], soc);
        now.seen_soc[1][l] = more(now.seen_soc[1][l], soc);
        if HEATED {
            now.seen_degc[0][l] = less(now.seen_degc[0][l], degc);
            now.seen_degc[1][l] = more(now.seen_degc[1][l], degc);
            now.lost[l] = lost[l];
            now.degc[l] = degc;
        }
        now.twice[l] = middle.twice[1][l];
        (now.soc[l], now.e[l], now.r[l]) = (soc, e1, r1);
        left |= piece.is_left::<HEATED>(l, soc, degc);
    }
    let more_a: Row<L> = std::array::from_fn(|j| more_a[j % W]);
    for block in &mut lanes.blocks {
        let moved = block.v.iter_mut().zip(&block.push).zip(&more_a);
        moved.for_each(|((v, push), more_a)| *v += push * more_a);
    }
    if left {
        lanes.find_pieces();
    }
}

impl<const W: usize> Middle<W> {
    #[inline(always)]
    fn place(&self, l: usize) -> Place {
        Place {
            t: self.t[l],
            u: self.u[l],
        }
    }

    /// Returns the cell of each branch of a block.
    #[inline(always)]
    fn beside<const L: usize>(&self) -> Middle<L> {
        Middle {
            current: std::array::from_fn(|j| self.current[j % W]),
            t: std::array::from_fn(|j| self.t[j % W]),
            u: std::array::from_fn(|j| self.u[j % W]),
            twice: [0, 1].map(|end: usize| std::array::from_fn(|j| self.twice[end][j % W])),
            floor: std::array::from_fn(|j| self.floor[j % W]),
        }
    }
}

/// Moves linear branches under a current that stays.
#[inline(always)]
fn straight_step<const L: usize, const HEATED: bool>(
    block: &mut Block<L>,
    g: &BlockGains<L>,
    middle: &Middle<L>,
    sums: &mut Sums<L>,
) {
    for j in 0..L {
        let (v, r0) = (block.v[j], block.r[j]);
        let r1 = block.table.at::<HEATED>(j, middle.place(j));
        let push = g.end[j] * r1;
        let end = g.decay[j] * v + (g.start[j] * r0 + push) * middle.current[j];
        if HEATED {
            let ohm = (r0 + r1).max(2.0 * middle.floor[j]) as f32;
            sums.lost[j] += f64::from((v * v + end * end) as f32 / ohm);
        }
        sums.v[j] += end;
        sums.push[j] += push;
        block.v[j] = end;
        block.r[j] = r1;
        block.push[j] = push;
    }
}

/// Moves branches of charge transfer under a current that stays.
#[inline(always)]
fn bent_step<const L: usize, const HEATED: bool>(
    block: &mut Block<L>,
    g: &BlockGains<L>,
    middle: &Middle<L>,
    sums: &mut Sums<L>,
) {
    for j in 0..L {
        let (v, r0) = (block.v[j], block.r[j]);
        let r1 = block.table.at::<HEATED>(j, middle.place(j));
        let bend1 = middle.twice[1][j] * r1.max(middle.floor[j]) * block.straight[j];
        let bend = 0.5 * (block.bend[j] + bend1);
        let driven = (r0 + g.end_share[j] * (r1 - r0)) * middle.current[j];
        let inverse = 1.0 / bend as f32;
        let ratio = g.ratio[j] as f32;
        let bent = Bent::new(v as f32 * inverse, driven as f32 * inverse, ratio);
        let end = v + bend * f64::from(bent.change);
        let push = g.end_share[j] * r1 * f64::from(bent.slope);
        if HEATED {
            let mean = 0.5 * (middle.twice[0][j] + middle.twice[1][j]) * block.straight[j];
            let leaks = v * f64::from(bent.leaks[0]) + end * f64::from(bent.leaks[1]);
            sums.lost[j] += 0.5 * mean * leaks;
        }
        sums.v[j] += end;
        sums.push[j] += push;
        block.v[j] = end;
        block.r[j] = r1;
        block.bend[j] = bend1;
        block.push[j] = push;
    }
}

/// Adds the branches of each cell.
#[inline(always)]
fn across<const W: usize, const L: usize>(mut sums: Row<L>) -> Row<W> {
    let mut width = L;
    while width > W {
        width /= 2;
        for j in 0..width {
            sums[j] += sums[j + width];
        }
    }
    std::array::from_fn(|l| sums[l])
}
