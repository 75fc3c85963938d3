//! Inner loop: plain arithmetic over lists of W numbers, which the compiler turns into vectors of
//! the machine's length.
//!
//! Products and sums are not fused, so that every machine gets the same bits.

use super::lanes::{LaneGains, Lanes, Now};
use super::law::{CLAMPED, CURRENT, LOAD, LaneDemand, TANGENT, current, less};
use super::ocv_piece::Row;
use super::plan::Plan;
use super::tally::Source;
use crate::forward::law::{Beyond, Demand};
use analysis_effects::contract::Ramp;

/// Runs all steps of a plan.
pub(super) fn run<const W: usize, const N: usize>(
    lanes: &mut Lanes<'_, W, N>,
    plan: &Plan<'_>,
    curved: bool,
) {
    match (plan.demand, plan.beyond) {
        (Demand::Current, _) => by_ocv::<W, N, CURRENT>(lanes, plan, curved),
        (Demand::Resistance, _) => by_ocv::<W, N, LOAD>(lanes, plan, curved),
        (Demand::Power, Beyond::Extrapolate { .. }) => by_ocv::<W, N, TANGENT>(lanes, plan, curved),
        (Demand::Power, _) => by_ocv::<W, N, CLAMPED>(lanes, plan, curved),
    }
}

fn by_ocv<const W: usize, const N: usize, const LAW: u8>(
    lanes: &mut Lanes<'_, W, N>,
    plan: &Plan<'_>,
    curved: bool,
) {
    let arch = pulp::Arch::new();
    if curved {
        arch.dispatch(All::<W, N, LAW, true>(lanes, plan));
    } else {
        arch.dispatch(All::<W, N, LAW, false>(lanes, plan));
    }
}

/// The loop as something to dispatch. A closure would not be inlined into the function that has the
/// machine's vectors.
struct All<'l, 'c, const W: usize, const N: usize, const LAW: u8, const CURVED: bool>(
    &'l mut Lanes<'c, W, N>,
    &'l Plan<'l>,
);

impl<const W: usize, const N: usize, const LAW: u8, const CURVED: bool> pulp::WithSimd
    for All<'_, '_, W, N, LAW, CURVED>
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        all::<W, N, LAW, CURVED>(self.0, self.1);
    }
}

#[inline(always)]
fn all<const W: usize, const N: usize, const LAW: u8, const CURVED: bool>(
    lanes: &mut Lanes<'_, W, N>,
    plan: &Plan<'_>,
) {
    let (fraction, gains) = (
        if let Beyond::Extrapolate { fraction } = plan.beyond {
            fraction
        } else {
            1.0
        },
        std::mem::take(&mut lanes.gains),
    );
    // A local copy, which the compiler can keep in registers.
    let mut now = lanes.now;
    let mut index = 0.0;
    for run in &plan.runs {
        let gain = &gains[run.length];
        // Loops, not closures: see above.
        for row in plan.rows(run) {
            let (from, rise) = plan.row(row, run.share);
            for part in 0..run.parts {
                let demand = Ramp {
                    start: from + rise * part as f64,
                    end: from + rise * (part + 1) as f64,
                };
                let outside = if LAW == CLAMPED {
                    by_one_root::<W, N, CURVED>(lanes, &mut now, gain, demand, index)
                } else {
                    advance::<W, N, LAW, CURVED>(lanes, &mut now, gain, fraction, demand, index)
                };
                if CURVED && outside {
                    lanes.now = now;
                    lanes.find_pieces();
                    now = lanes.now;
                }
                index += 1.0;
            }
        }
    }
    lanes.now = now;
    lanes.gains = gains;
}

/// Makes one step of all lanes under a power, like [`advance`], but without waiting for a second
/// root.
///
/// E changes little over a step: by d, and the square of the root s₀ by x·s₀² with x = (d(2E₀ + d)
/// − Δasked)/s₀². The root at the end is s₀√(1 + x), from the series of it, and 1/s₀² is on its way
/// together with s₀. Beyond [`FAR`] the root is taken.
#[inline(always)]
fn by_one_root<const W: usize, const N: usize, const CURVED: bool>(
    lanes: &Lanes<'_, W, N>,
    now: &mut Now<W, N>,
    g: &LaneGains<W, N>,
    demand: Ramp,
    index: f64,
) -> bool {
    let mut begin = Begin {
        root: [0.0; W],
        current: [0.0; W],
        open: [0.0; W],
        d: [0.0; W],
        rise: [0.0; W],
        back: [0.0; W],
    };
    let mut far = false;
    for l in 0..W {
        // OCV − Σv is carried from step to step: summing the branches anew would make the next root
        // wait for them.
        let e = now.e[l];
        let square = (e * e - lanes.asked[l] * demand.start).max(0.0);
        let (root, inverse) = (square.sqrt(), 1.0 / square);
        let current = (e - root) * lanes.half[l];
        let open = ocv::<W, N, CURVED>(lanes, l, now.soc[l] - g.soc[l] * current);
        // The values that are ready last are added last: the branches, and after them the root.
        let d = ((open - (e + g.held_share[l] * e)) - kept(now, g, l)) + g.held_share[l] * root;
        let change = Change {
            e_v: e,
            d_v: d,
            more_asked_v2: lanes.asked[l] * (demand.end - demand.start),
        };
        let (moved, more_asked) = change.parts(inverse);
        let x = moved - more_asked;
        // x/2 − x²/8 + x³/16; written twice, so that E does not wait for one product more.
        let before_one = moved - (more_asked + 1.0);
        let curve = before_one * before_one + 7.0;
        let part = root * 0.0625;
        let rise = (part * x) * curve;
        let back = ((g.ends_share[l] * part) * x) * curve;
        // In this form the condition also catches NaN.
        let near = x.abs() <= FAR;
        far |= !near;
        (begin.root[l], begin.current[l], begin.open[l]) = (root, current, open);
        (begin.d[l], begin.rise[l], begin.back[l]) = (d, rise, back);
    }
    if far {
        // By value, so that no changing value of a step must be in memory for it.
        let (rise, short) = far_roots(lanes, &{ now.e }, &{ begin }, demand);
        for l in 0..W {
            let Some(rise) = rise[l] else { continue };
            (begin.rise[l], begin.back[l]) = (rise, g.ends_share[l] * rise);
            now.tally.infeasible[l] = less(
                now.tally.infeasible[l],
                if short[l] { index } else { f64::INFINITY },
            );
        }
    }
    finish::<W, N, CURVED>(lanes, now, g, &begin)
}

/// Largest change of the square under the root for which its series is taken. The truncation error
/// is 5/128·x⁴ < 3·10⁻⁹ of the root, far below the error of a step of this size.
const FAR: f64 = 1.0 / 64.0;

/// State of a step before its last current is known.
#[derive(Clone, Copy)]
struct Begin<const W: usize> {
    /// √(E² − 4PR) at the start, V.
    root: Row<W>,
    /// Current at the start, A.
    current: Row<W>,
    /// OCV at the end if this current stayed, V.
    open: Row<W>,
    /// Change of E in that case, V.
    d: Row<W>,
    /// Change of the root, V.
    rise: Row<W>,
    /// Part of that change of E that is taken back at the end, V.
    back: Row<W>,
}

/// Values that change the square under the root over a step.
struct Change {
    /// E at the start, V.
    e_v: f64,
    /// By how much E changes, V.
    d_v: f64,
    /// By how much 4PR changes, V².
    more_asked_v2: f64,
}

/// Returns the change of the root, recomputed in every lane with a large step, and whether the
/// requested power exceeded the available power.
#[cold]
#[inline(never)]
fn far_roots<const W: usize, const N: usize>(
    lanes: &Lanes<'_, W, N>,
    e: &Row<W>,
    begin: &Begin<W>,
    demand: Ramp,
) -> ([Option<f64>; W], [bool; W]) {
    let (mut rise, mut short) = ([None; W], [false; W]);
    for l in 0..W {
        let (e, d, asked) = (e[l], begin.d[l], lanes.asked[l]);
        let inverse = 1.0 / (e * e - asked * demand.start).max(0.0);
        let change = Change {
            e_v: e,
            d_v: d,
            more_asked_v2: asked * (demand.end - demand.start),
        };
        let (moved, more_asked) = change.parts(inverse);
        let near = (moved - more_asked).abs() <= FAR;
        if !near {
            let end = e + d;
            rise[l] = Some((end * end - asked * demand.end).max(0.0).sqrt() - begin.root[l]);
            short[l] = (asked * demand.start > e * e) | (asked * demand.end > end * end);
        }
    }
    (rise, short)
}

impl Change {
    /// Returns the relative change of the square under the root: with E, and less the increase of
    /// the demand. `inverse` is 1 over that square, 1/V².
    #[inline(always)]
    fn parts(&self, inverse: f64) -> (f64, f64) {
        (
            (self.d_v * inverse) * (2.0 * self.e_v + self.d_v),
            self.more_asked_v2 * inverse,
        )
    }
}

/// Moves the branches, E and the tally over a step of [`by_one_root`].
#[inline(always)]
fn finish<const W: usize, const N: usize, const CURVED: bool>(
    lanes: &Lanes<'_, W, N>,
    now: &mut Now<W, N>,
    g: &LaneGains<W, N>,
    begin: &Begin<W>,
) -> bool {
    let mut outside = false;
    for l in 0..W {
        let (e0, i0, d) = (now.e[l], begin.current[l], begin.d[l]);
        let more = d - begin.rise[l];
        let (e1, i1) = (e0 + d, i0 + more * lanes.half[l]);
        for k in 0..N {
            now.v[k][l] =
                (g.decay[k][l] * now.v[k][l] + g.both[k][l] * i0) + g.end_share[k][l] * more;
        }
        now.e[l] = (e1 - g.ends_share[l] * d) + begin.back[l];
        if CURVED {
            now.soc[l] -= 0.5 * g.soc[l] * (i0 + i1);
            outside |= (now.soc[l] < lanes.ocv.from[l]) | (now.soc[l] > lanes.ocv.to[l]);
            now.e[l] += ocv::<W, N, CURVED>(lanes, l, now.soc[l]) - begin.open[l];
        }
        let (start, end) = (source(lanes, l, e0, i0), source(lanes, l, e1, i1));
        now.tally.add(l, g.step_s, start, end);
    }
    outside
}

/// Returns a lane at an instant, from its E, V, and its current, A.
#[inline(always)]
fn source<const W: usize, const N: usize>(
    lanes: &Lanes<'_, W, N>,
    l: usize,
    e_v: f64,
    current_a: f64,
) -> Source {
    Source {
        e_v,
        current_a,
        r_ohm: lanes.r[l],
        interconnect_ohm: lanes.interconnect[l],
    }
}

/// Returns the sum of the branch voltages that remains at the end of the step, V.
#[inline(always)]
fn kept<const W: usize, const N: usize>(now: &Now<W, N>, g: &LaneGains<W, N>, l: usize) -> f64 {
    // Two sums, so that half as many wait for each other.
    let mut kept = [0.0; 2];
    for k in 0..N {
        kept[k % 2] += g.decay[k][l] * now.v[k][l];
    }
    kept[0] + kept[1]
}

/// Makes one step of all lanes; returns true if a lane has left its piece of the OCV curve.
#[inline(always)]
fn advance<const W: usize, const N: usize, const LAW: u8, const CURVED: bool>(
    lanes: &Lanes<'_, W, N>,
    now: &mut Now<W, N>,
    g: &LaneGains<W, N>,
    fraction: f64,
    demand: Ramp,
    index: f64,
) -> bool {
    let mut outside = false;
    for l in 0..W {
        let asked = |e_v: f64, demand: f64| LaneDemand {
            e_v,
            r_ohm: lanes.r[l],
            demand: demand * lanes.scale[l],
            fraction,
            tangent: [lanes.tangent.0, lanes.tangent.1[l]],
        };
        // OCV − Σv is carried from step to step: summing the branches anew would make the next root
        // wait for them.
        let e0 = now.e[l];
        let (i0, short0) = current::<LAW>(asked(e0, demand.start));
        let e1 = ocv::<W, N, CURVED>(lanes, l, now.soc[l] - g.soc[l] * i0)
            - kept(now, g, l)
            - g.held[l] * i0;
        let (i1, short1) = current::<LAW>(asked(e1, demand.end));
        let mut rest = 0.0;
        for k in 0..N {
            let begun = g.decay[k][l] * now.v[k][l] + g.start[k][l] * i0;
            rest += begun;
            now.v[k][l] = begun + g.end[k][l] * i1;
        }
        if CURVED {
            now.soc[l] -= 0.5 * g.soc[l] * (i0 + i1);
            outside |= (now.soc[l] < lanes.ocv.from[l]) | (now.soc[l] > lanes.ocv.to[l]);
        }
        now.e[l] = ocv::<W, N, CURVED>(lanes, l, now.soc[l]) - rest - g.ends[l] * i1;
        let (start, end) = (source(lanes, l, e0, i0), source(lanes, l, e1, i1));
        now.tally.add(l, g.step_s, start, end);
        let t = &mut now.tally;
        t.infeasible[l] = less(
            t.infeasible[l],
            if short0 | short1 {
                index
            } else {
                f64::INFINITY
            },
        );
    }
    outside
}

#[inline(always)]
fn ocv<const W: usize, const N: usize, const CURVED: bool>(
    lanes: &Lanes<'_, W, N>,
    l: usize,
    soc: f64,
) -> f64 {
    let piece = &lanes.ocv;
    if !CURVED {
        return piece.c[0][l];
    }
    let t = (soc - piece.origin[l]) * piece.rate[l];
    piece.c[0][l] + t * (piece.c[1][l] + t * (piece.c[2][l] + t * piece.c[3][l]))
}
