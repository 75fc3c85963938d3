//! The current of a lane under a demand: the inner loop's form of [`crate::forward::Drive::reply`].

use crate::forward::law::{Beyond, Demand, Drive};

/// Kinds of the law, as constants so that each has a separate loop.
pub(super) const CLAMPED: u8 = 0;
pub(super) const TANGENT: u8 = 1;
pub(super) const CURRENT: u8 = 2;
pub(super) const LOAD: u8 = 3;
/// For one lane only: it does not become vectors.
pub(super) const BEND: u8 = 4;

/// A demand on a lane.
#[derive(Clone, Copy)]
pub(super) struct LaneDemand {
    /// E = OCV − Σv, V.
    pub(super) e_v: f64,
    /// Series resistance, Ω.
    pub(super) r_ohm: f64,
    /// Demand, W, A or Ω.
    pub(super) demand: f64,
    /// P₀/P*, where the tangent or the bend begins.
    pub(super) fraction: f64,
    /// 1/c and (1 − c)²/4cR of the tangent, c = √(1 − P₀/P*).
    pub(super) tangent: [f64; 2],
}

/// Returns the current of [`crate::forward::Drive::reply`], and whether the requested power
/// exceeded the available power.
#[inline(always)]
pub(super) fn current<const LAW: u8>(asked: LaneDemand) -> (f64, bool) {
    let LaneDemand {
        e_v: e,
        r_ohm,
        demand,
        fraction,
        tangent,
    } = asked;
    if LAW == CURRENT {
        return (demand, false);
    }
    if LAW == LOAD {
        return (e / (r_ohm + demand), false);
    }
    if LAW == BEND {
        let drive = Drive {
            demand: Demand::Power,
            beyond: Beyond::Bend { fraction },
            r_ohm,
        };
        let reply = drive.reply(e, demand);
        return (reply.current_a, reply.infeasible);
    }
    let (square, asked) = (e * e, 4.0 * r_ohm * demand);
    let short = asked > square;
    // Compared anew below: the root must not wait for the verdict.
    let root = (square - asked).max(0.0).sqrt();
    if LAW == CLAMPED {
        return ((e - root) * (0.5 / r_ohm), short);
    }
    // One division for both, so that nothing branches and all lanes go on together.
    let on_tangent = asked > fraction * square;
    let over = tangent[0] * demand - tangent[1] * square;
    (
        (if on_tangent { over } else { 2.0 * demand }) / (if on_tangent { e } else { e + root }),
        short,
    )
}

/// The smaller one; `f64::min` would also ask for NaN.
#[inline(always)]
pub(super) fn less(a: f64, b: f64) -> f64 {
    if b < a { b } else { a }
}

#[inline(always)]
pub(super) fn more(a: f64, b: f64) -> f64 {
    if b > a { b } else { a }
}
