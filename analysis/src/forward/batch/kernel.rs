//! The inner loop: plain arithmetic over lists of W numbers, which the compiler turns into vectors of whatever length the machine has.
//!
//! Products and sums are not fused, so that every machine gets the same bits.

use super::lanes::{LaneGains, Lanes, Now};
use super::plan::Plan;
use crate::forward::law::{Beyond, Demand};

/// Kinds of the law, as constants so that each has a loop of its own.
const CLAMPED: u8 = 0;
const TANGENT: u8 = 1;
const CURRENT: u8 = 2;
const LOAD: u8 = 3;

/// Runs all steps of a plan.
pub(super) fn run<const W: usize, const N: usize>(lanes: &mut Lanes<'_, W, N>, plan: &Plan, curved: bool) {
    match (plan.demand, plan.beyond) {
        (Demand::Current, _) => by_ocv::<W, N, CURRENT>(lanes, plan, curved),
        (Demand::Resistance, _) => by_ocv::<W, N, LOAD>(lanes, plan, curved),
        (Demand::Power, Beyond::Extrapolate { .. }) => by_ocv::<W, N, TANGENT>(lanes, plan, curved),
        (Demand::Power, _) => by_ocv::<W, N, CLAMPED>(lanes, plan, curved),
    }
}

fn by_ocv<const W: usize, const N: usize, const LAW: u8>(lanes: &mut Lanes<'_, W, N>, plan: &Plan, curved: bool) {
    let arch = pulp::Arch::new();
    if curved { arch.dispatch(All::<W, N, LAW, true>(lanes, plan)) } else { arch.dispatch(All::<W, N, LAW, false>(lanes, plan)) }
}

/// The loop as something to dispatch. A closure would not be inlined into the function that has the machine's vectors.
struct All<'l, 'c, const W: usize, const N: usize, const LAW: u8, const CURVED: bool>(&'l mut Lanes<'c, W, N>, &'l Plan);

impl<const W: usize, const N: usize, const LAW: u8, const CURVED: bool> pulp::WithSimd for All<'_, '_, W, N, LAW, CURVED> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        all::<W, N, LAW, CURVED>(self.0, self.1);
    }
}

#[inline(always)]
fn all<const W: usize, const N: usize, const LAW: u8, const CURVED: bool>(lanes: &mut Lanes<'_, W, N>, plan: &Plan) {
    let (fraction, gains) =
        (if let Beyond::Extrapolate { fraction } = plan.beyond { fraction } else { 1.0 }, std::mem::take(&mut lanes.gains));
    // A copy of its own, which the compiler can keep in registers.
    let mut now = lanes.now;
    for (index, step) in plan.steps.iter().enumerate() {
        let gain = &gains[step.length as usize];
        let left = advance::<W, N, LAW, CURVED>((lanes, &mut now), gain, (step.demand, index as f64, fraction));
        if CURVED && left {
            lanes.now = now;
            lanes.find_pieces();
            now = lanes.now;
        }
    }
    lanes.now = now;
    lanes.gains = gains;
}

/// One step of all lanes; true when one has left its piece of the OCV curve.
#[inline(always)]
fn advance<const W: usize, const N: usize, const LAW: u8, const CURVED: bool>(
    (lanes, now): (&Lanes<'_, W, N>, &mut Now<W, N>),
    g: &LaneGains<W, N>,
    ((from, to), index, fraction): ((f64, f64), f64, f64),
) -> bool {
    let mut left = false;
    for l in 0..W {
        // OCV − Σv is carried from step to step: summing the branches anew would make the next root wait for them.
        let e0 = now.e[l];
        let (i0, short0) = current::<W, N, LAW>(lanes, l, (e0, from * lanes.scale[l], fraction));
        let mut kept = 0.0;
        for k in 0..N {
            kept += g.decay[k][l] * now.v[k][l];
        }
        let e1 = ocv::<W, N, CURVED>(lanes, l, now.soc[l] - g.soc[l] * i0) - kept - g.held[l] * i0;
        let (i1, short1) = current::<W, N, LAW>(lanes, l, (e1, to * lanes.scale[l], fraction));
        let mut rest = 0.0;
        for k in 0..N {
            let begun = g.decay[k][l] * now.v[k][l] + g.start[k][l] * i0;
            rest += begun;
            now.v[k][l] = begun + g.end[k][l] * i1;
        }
        if CURVED {
            now.soc[l] -= 0.5 * g.soc[l] * (i0 + i1);
            left |= (now.soc[l] < lanes.ocv.from[l]) | (now.soc[l] > lanes.ocv.to[l]);
        }
        now.e[l] = ocv::<W, N, CURVED>(lanes, l, now.soc[l]) - rest - g.ends[l] * i1;
        let (ccv0, ccv1) = (e0 - lanes.r[l] * i0, e1 - lanes.r[l] * i1);
        let t = &mut now.tally;
        t.charge[l] += 0.5 * g.step_s * (i0 + i1);
        t.energy[l] += 0.5 * g.step_s * (i0 * ccv0 + i1 * ccv1);
        let (inner0, inner1) = (ccv0 + lanes.interconnect[l] * i0, ccv1 + lanes.interconnect[l] * i1);
        t.min_ccv[l] = less(t.min_ccv[l], less(ccv0, ccv1));
        t.max_ccv[l] = more(t.max_ccv[l], more(ccv0, ccv1));
        t.min_inner[l] = less(t.min_inner[l], less(inner0, inner1));
        t.max_inner[l] = more(t.max_inner[l], more(inner0, inner1));
        t.least_e[l] = less(t.least_e[l], less(e0, e1));
        t.infeasible[l] = less(t.infeasible[l], if short0 | short1 { index } else { f64::INFINITY });
    }
    left
}

#[inline(always)]
fn ocv<const W: usize, const N: usize, const CURVED: bool>(lanes: &Lanes<'_, W, N>, l: usize, soc: f64) -> f64 {
    let piece = &lanes.ocv;
    if !CURVED {
        return piece.c[0][l];
    }
    let t = (soc - piece.origin[l]) * piece.rate[l];
    piece.c[0][l] + t * (piece.c[1][l] + t * (piece.c[2][l] + t * piece.c[3][l]))
}

/// The current of [`crate::forward::Drive::reply`], and whether more was asked for than there is.
#[inline(always)]
fn current<const W: usize, const N: usize, const LAW: u8>(
    lanes: &Lanes<'_, W, N>,
    l: usize,
    (e, demand, fraction): (f64, f64, f64),
) -> (f64, bool) {
    if LAW == CURRENT {
        return (demand, false);
    }
    if LAW == LOAD {
        return (e / (lanes.r[l] + demand), false);
    }
    let (square, asked) = (e * e, 4.0 * lanes.r[l] * demand);
    let short = asked > square;
    // Compared anew below: the root must not wait for the verdict.
    let root = (square - asked).max(0.0).sqrt();
    if LAW != TANGENT {
        return ((e - root) * lanes.half[l], short);
    }
    // One division for both, so that nothing branches and all lanes go on together.
    let on_tangent = asked > fraction * square;
    let over = lanes.tangent.0 * demand - lanes.tangent.1[l] * square;
    ((if on_tangent { over } else { 2.0 * demand }) / (if on_tangent { e } else { e + root }), short)
}

/// The smaller one; `f64::min` would also ask for NaN.
#[inline(always)]
fn less(a: f64, b: f64) -> f64 {
    if b < a { b } else { a }
}

#[inline(always)]
fn more(a: f64, b: f64) -> f64 {
    if b > a { b } else { a }
}
