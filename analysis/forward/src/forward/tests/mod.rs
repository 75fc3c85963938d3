//! The simulation against an independent integrator, closed forms, difference quotients and
//! conservation of energy.

mod additions;
mod batch;
mod exactness;
mod held;
mod law;
mod mapped;
mod mapped_steps;
mod profile;
mod sensitivity;

use super::*;
use analysis_model::{
    model::{Erm, RcBranch},
    ocv::OcvCurve,
    pack::Pack,
};

/// Appendix A of the thesis, 4 RC, rounded.
fn thesis_cell() -> Erm {
    let rc = |r_ohm, c_f| RcBranch { r_ohm, c_f };
    let branches = vec![
        rc(0.001_509, 0.552_8),
        rc(0.000_662_8, 6.979_8),
        rc(0.000_404_1, 663.8),
        rc(0.004_774, 1_084.2),
    ];
    Erm {
        r_ohm: 0.006_428_6,
        branches,
    }
}

fn curve() -> OcvCurve {
    OcvCurve::monotone(
        4.2,
        vec![0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0],
        vec![2.6, 3.3, 3.55, 3.7, 3.85, 4.05, 4.18],
    )
    .unwrap()
}

fn flat_cell() -> SimModel {
    SimModel::cell(&thesis_cell(), OcvSource::Constant(3.72)).unwrap()
}

fn curved_cell() -> SimModel {
    SimModel::cell(&thesis_cell(), OcvSource::Curve(curve())).unwrap()
}

fn rows(demand: Demand, interpolation: Interpolation, rows: &[(f64, f64)]) -> Profile {
    Profile::new("test", demand, interpolation, rows).unwrap()
}

/// The cell as a system of differential equations, written down anew: R, (Rₖ, Cₖ), OCV of the
/// charge taken.
struct Plain<'a> {
    r: f64,
    branches: Vec<(f64, f64)>,
    ocv: &'a dyn Fn(f64) -> f64,
}

impl Plain<'_> {
    /// (CCV, i) at charge taken and branch voltages under a power.
    fn answer(&self, x: &[f64], p: f64) -> (f64, f64) {
        let e = (self.ocv)(x[0]) - x[1..].iter().sum::<f64>();
        // Newton on P = CCV·(E − CCV)/R from the open-circuit side; no square root.
        let mut ccv = e;
        for _ in 0..60 {
            ccv -= (ccv * (e - ccv) - p * self.r) / (e - 2.0 * ccv);
        }
        (ccv, (e - ccv) / self.r)
    }

    fn rate(&self, x: &[f64], p: f64) -> Vec<f64> {
        let (_, i) = self.answer(x, p);
        std::iter::once(i)
            .chain(
                self.branches
                    .iter()
                    .zip(&x[1..])
                    .map(|((r, c), v)| (i - v / r) / c),
            )
            .collect()
    }

    /// Classical Runge–Kutta of fourth order.
    fn run(&self, mut x: Vec<f64>, (p, h, steps): (&dyn Fn(f64) -> f64, f64, usize)) -> Vec<f64> {
        let add = |x: &[f64], k: &[f64], f: f64| -> Vec<f64> {
            x.iter().zip(k).map(|(a, b)| a + f * b).collect()
        };
        for n in 0..steps {
            let t = n as f64 * h;
            let k1 = self.rate(&x, p(t));
            let k2 = self.rate(&add(&x, &k1, 0.5 * h), p(t + 0.5 * h));
            let k3 = self.rate(&add(&x, &k2, 0.5 * h), p(t + 0.5 * h));
            let k4 = self.rate(&add(&x, &k3, h), p(t + h));
            for (j, v) in x.iter_mut().enumerate() {
                *v += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j]);
            }
        }
        x
    }
}

fn plain(ocv: &dyn Fn(f64) -> f64) -> Plain<'_> {
    let cell = thesis_cell();
    Plain {
        r: cell.r_ohm,
        branches: cell.branches.iter().map(|b| (b.r_ohm, b.c_f)).collect(),
        ocv,
    }
}
