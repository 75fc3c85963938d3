//! Current at an instant: the algebraic half of the model (thesis equations 4.1–4.6 and
//! section 4.2).
//!
//! Behind the series resistance R lies E = OCV − Σvₖ, which cannot jump. A current i gives CCV = E
//! − R·i. A power P = CCV·i has the root CCV = (E + √(E² − 4PR))/2, real up to P* = E²/4R. Beyond
//! P₀ = f·P* the tangent CCV = V(P₀) + V′(P₀)(P − P₀) continues to any P.
//!
//! *Difference to the thesis:* on the tangent it keeps i = P/CCV, which has a pole where the
//! tangent crosses zero (for f = 0.95 at 1.5·P*) and a negative current after it. Here the current
//! follows Kirchhoff's law, i = (E − CCV)/R. Up to P₀ both agree in value and first derivative;
//! beyond it this one is linear in P, and the delivered power, CCV·i, is at most P*, as in a real
//! cell.

use serde::{Deserialize, Serialize};

/// Quantity that is prescribed over time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Demand {
    /// Power out of the terminals, W, discharge positive.
    Power,
    /// Current out of the terminals, A, discharge positive.
    Current,
    /// Resistance across the terminals, Ω, above zero.
    Resistance,
}

/// Treatment of a power that cannot be delivered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Beyond {
    /// The simulation ends there.
    Stop,
    /// As much as there is, P* = E²/4R, is delivered.
    Clamp,
    /// The voltage follows its tangent at this fraction of P* (thesis 4.2.1).
    Extrapolate {
        /// P₀/P*, above 0 and below 1.
        fraction: f64,
    },
    /// As [`Beyond::Extrapolate`] with two continuous derivatives at P₀, for solvers: the curvature
    /// falls to zero along a straight line between P₀ and P*, and the line behind P* is 1.25 times as
    /// steep as the tangent.
    Bend {
        /// P₀/P*, above 0 and below 1.
        fraction: f64,
    },
}

impl Beyond {
    /// Default point at which the tangent leaves the curve, as a fraction of P*.
    pub const FRACTION: f64 = 0.95;

    /// Returns P₀/P*, where the voltage continues beyond it to any power.
    pub fn fraction(self) -> Option<f64> {
        match self {
            Self::Stop | Self::Clamp => None,
            Self::Extrapolate { fraction } | Self::Bend { fraction } => Some(fraction),
        }
    }

    /// True for a fraction within (0, 1).
    pub fn is_valid(self) -> bool {
        self.fraction()
            .is_none_or(|fraction| fraction > 0.0 && fraction < 1.0)
    }
}

/// Answer to a demand: its kind, the policy and the series resistance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// Kind of the demand.
    pub demand: Demand,
    /// Policy beyond the power that can be had.
    pub beyond: Beyond,
    /// Series resistance R, Ω.
    pub r_ohm: f64,
}

/// The current and its partial derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reply {
    /// Current i, A.
    pub current_a: f64,
    /// ∂i/∂E, A/V.
    pub d_e: f64,
    /// ∂i/∂demand, A per unit of the demand.
    pub d_demand: f64,
    /// ∂i/∂R, A/Ω.
    pub d_r: f64,
    /// True if the demand exceeds P* = E²/4R.
    pub infeasible: bool,
}

impl Drive {
    /// Returns the largest power that can be had, W: P* = E²/4R.
    pub fn available_w(&self, e_v: f64) -> f64 {
        0.25 * e_v * e_v / self.r_ohm
    }

    /// Returns the current at E (V, above zero) under a demand (W, A or Ω).
    ///
    /// With [`Beyond::Stop`] an infeasible demand is answered as with [`Beyond::Clamp`] and marked;
    /// the caller stops.
    pub fn reply(&self, e_v: f64, demand: f64) -> Reply {
        let r = self.r_ohm;
        match self.demand {
            Demand::Current => Reply {
                current_a: demand,
                d_e: 0.0,
                d_demand: 1.0,
                d_r: 0.0,
                infeasible: false,
            },
            Demand::Resistance => {
                let conductance = 1.0 / (r + demand);
                let current_a = e_v * conductance;
                let slope = -current_a * conductance;
                Reply {
                    current_a,
                    d_e: conductance,
                    d_demand: slope,
                    d_r: slope,
                    infeasible: false,
                }
            }
            Demand::Power => match self.beyond {
                Beyond::Extrapolate { fraction } if demand > fraction * self.available_w(e_v) => {
                    self.tangent(e_v, demand, fraction)
                }
                Beyond::Bend { fraction } if demand > fraction * self.available_w(e_v) => {
                    self.bend(e_v, demand, fraction)
                }
                _ => self.root(e_v, demand),
            },
        }
    }

    /// Returns whether the tangent has reached a voltage that no load can hold, zero or less, so
    /// that no solution exists. As E falls the tangent continues to any negative voltage, because
    /// its slope is −R/(cE).
    pub(super) fn is_past_tangent(&self, e_v: f64, reply: &Reply) -> bool {
        self.demand == Demand::Power
            && self.beyond.fraction().is_some()
            && reply.infeasible
            && e_v <= self.r_ohm * reply.current_a
    }

    /// Returns the current at E under a demand, and whether the tangent has no answer to it; then
    /// it is that of the most power there is.
    pub(super) fn reply_or_most(&self, e_v: f64, demand: f64) -> (Reply, bool) {
        let reply = self.reply(e_v, demand);
        if self.is_past_tangent(e_v, &reply) {
            (self.root(e_v, demand), true)
        } else {
            (reply, false)
        }
    }

    /// On the curve, or as much as there is.
    fn root(&self, e: f64, p: f64) -> Reply {
        let r = self.r_ohm;
        let radicand = e * e - 4.0 * p * r;
        if radicand < 0.0 {
            let current_a = 0.5 * e / r;
            return Reply {
                current_a,
                d_e: 0.5 / r,
                d_demand: 0.0,
                d_r: -current_a / r,
                infeasible: true,
            };
        }
        let s = radicand.sqrt();
        let current_a = 2.0 * p / (e + s);
        Reply {
            current_a,
            d_e: -current_a / s,
            d_demand: 1.0 / s,
            d_r: current_a * current_a / s,
            infeasible: false,
        }
    }

    /// On the tangent: with c = √(1 − f), i = (E − L(P))/R = P/(cE) − (1 − c)²·E/(4cR).
    fn tangent(&self, e: f64, p: f64, fraction: f64) -> Reply {
        let r = self.r_ohm;
        let c = (1.0 - fraction).sqrt();
        let w = (1.0 - c) * (1.0 - c) / (4.0 * c * r);
        Reply {
            current_a: p / (c * e) - w * e,
            d_e: -p / (c * e * e) - w,
            d_demand: 1.0 / (c * e),
            d_r: w * e / r,
            infeasible: p > self.available_w(e),
        }
    }

    /// On the bend: with x = P/P*, y = (x − f)/(1 − f) and b = min(y, 1), i = E(1 − s)/2R, where s =
    /// c(1 − y/2 − b²(3 − b)/24 − (y − b)/8) and ds/dx = −(1/2 + b/4 − b²/8)/c.
    fn bend(&self, e: f64, p: f64, fraction: f64) -> Reply {
        let r = self.r_ohm;
        let c = (1.0 - fraction).sqrt();
        let x = p / self.available_w(e);
        let y = (x - fraction) / (1.0 - fraction);
        let b = y.min(1.0);
        let s = c * (1.0 - 0.5 * y - b * b * (3.0 - b) / 24.0 - 0.125 * (y - b));
        let slope = -(0.5 + 0.25 * b - 0.125 * b * b) / c;
        let current_a = 0.5 * e * (1.0 - s) / r;
        Reply {
            current_a,
            d_e: current_a / e + slope * x / r,
            d_demand: -2.0 * slope / e,
            d_r: -current_a / r - 0.5 * e * slope * x / (r * r),
            infeasible: x > 1.0,
        }
    }
}
