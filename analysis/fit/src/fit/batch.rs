//! The projection of [`super::projection`] for many members of a population at once: eight members
//! side by side, so that the compiler turns each arithmetic operation into vector instructions
//! (AVX2 where the machine has it, chosen at run time). Every member's arithmetic is the same in
//! every lane and on every machine: no fused operations, no sums across lanes.

// Index loops over triangles of small matrices say what the formulas say.
#![allow(clippy::needless_range_loop)]

use super::options::{Bounds, Objective};
use super::problem::Problem;
use super::projection::REWEIGHTS;
use analysis_numeric::{
    Columns,
    linalg::{BoxQuadratic, MAX_UNKNOWNS},
};
use std::f64::consts::TAU;

const LANES: usize = 8;
type Lane = [f64; LANES];

/// A lane by its number.
#[inline(always)]
fn lane(f: impl Fn(usize) -> f64) -> Lane {
    std::array::from_fn(f)
}

/// Values members of a population; holds the working memory between calls.
pub(crate) struct Batch<'a> {
    problem: &'a Problem,
    bounds: &'a Bounds,
    arch: pulp::Arch,
    work: Work,
}

struct Work {
    /// Number of unknown resistances.
    n: usize,
    /// Re and Im of 1/(1 + jωτₖ) per frequency and branch, frequency by frequency.
    basis: Vec<[Lane; 2]>,
    /// Terms of the quadratic that touches the objective at the model, per frequency: xx, xy, yy,
    /// bx, by.
    touching: Vec<[Lane; 5]>,
    q: [[Lane; MAX_UNKNOWNS]; MAX_UNKNOWNS],
    c: [Lane; MAX_UNKNOWNS],
    lo: [Lane; MAX_UNKNOWNS],
    hi: [Lane; MAX_UNKNOWNS],
    r: [Lane; MAX_UNKNOWNS],
    /// 1 for an unknown that no bound holds, otherwise 0; and the bound that holds it.
    free: [Lane; MAX_UNKNOWNS],
    at: [Lane; MAX_UNKNOWNS],
}

impl<'a> Batch<'a> {
    pub(crate) fn new(problem: &'a Problem, bounds: &'a Bounds, rc: usize) -> Self {
        let (groups, zero) = (problem.groups.len(), [0.0; LANES]);
        let work = Work {
            n: (rc + 1).min(MAX_UNKNOWNS),
            basis: vec![[zero; 2]; groups * rc],
            touching: vec![[zero; 5]; groups],
            q: [[zero; MAX_UNKNOWNS]; MAX_UNKNOWNS],
            c: [zero; MAX_UNKNOWNS],
            lo: [zero; MAX_UNKNOWNS],
            hi: [zero; MAX_UNKNOWNS],
            r: [zero; MAX_UNKNOWNS],
            free: [zero; MAX_UNKNOWNS],
            at: [zero; MAX_UNKNOWNS],
        };
        Self {
            problem,
            bounds,
            arch: pulp::Arch::new(),
            work,
        }
    }

    /// Objective of every member with the best resistances found for its time constants (natural
    /// logarithms, s).
    pub(crate) fn values(&mut self, log_tau: &Columns, values: &mut [f64]) {
        let (problem, bounds, work) = (self.problem, self.bounds, &mut self.work);
        for (chunk, values) in values.chunks_mut(LANES).enumerate() {
            // Lanes beyond the last member repeat it.
            let last = log_tau.members() - 1;
            for k in 1..work.n {
                let column = log_tau.coordinate(k - 1);
                work.r[k] = lane(|l| column[(chunk * LANES + l).min(last)].exp());
            }
            let met = self.arch.dispatch(|| work.value(problem, bounds));
            values.copy_from_slice(&met[..values.len()]);
        }
    }
}

impl Work {
    /// Time constants are handed over in `r`.
    #[inline(always)]
    fn value(&mut self, problem: &Problem, bounds: &Bounds) -> Lane {
        self.prepare(problem, bounds);
        let rounds = if problem.kind == Objective::Complex {
            1
        } else {
            REWEIGHTS
        };
        let mut best = [f64::INFINITY; LANES];
        for round in 0..rounds {
            self.assemble();
            self.solve();
            let value = self.evaluate(problem, round + 1 < rounds);
            best = lane(|l| {
                if value[l] < best[l] {
                    value[l]
                } else {
                    best[l]
                }
            });
        }
        best
    }

    #[inline(always)]
    fn prepare(&mut self, problem: &Problem, bounds: &Bounds) {
        (self.lo[0], self.hi[0]) = ([bounds.r_ohm.0; LANES], [bounds.r_ohm.1; LANES]);
        self.free = [[1.0; LANES]; MAX_UNKNOWNS];
        let tau = self.r;
        for k in 1..self.n {
            self.lo[k] = lane(|l| bounds.r_ohm.0.max(tau[k][l] / bounds.c_f.1));
            self.hi[k] = lane(|l| bounds.r_ohm.1.min(tau[k][l] / bounds.c_f.0));
        }
        let rc = self.n - 1;
        for (index, g) in problem.groups.iter().enumerate() {
            let w = TAU * g.freq_hz;
            for k in 0..rc {
                let x = lane(|l| w * tau[k + 1][l]);
                let d = lane(|l| 1.0 / (1.0 + x[l] * x[l]));
                self.basis[index * rc + k] = [d, lane(|l| -x[l] * d[l])];
            }
            let m = g.mean;
            let [xx, xy, yy, bx, by] = if problem.kind == Objective::Modulus {
                let (n, u) = (g.points.len() as f64, m / m.norm().max(f64::MIN_POSITIVE));
                let b = n * g.mean_abs * u;
                [
                    n * u.re * u.re,
                    n * u.re * u.im,
                    n * u.im * u.im,
                    b.re,
                    b.im,
                ]
            } else {
                let [xx, xy, yy] = g.weight;
                [xx, xy, yy, xx * m.re + xy * m.im, xy * m.re + yy * m.im]
            };
            self.touching[index] = [xx, xy, yy, bx, by].map(|v| [v; LANES]);
        }
    }

    /// Normal equations of the quadratic that touches the objective.
    #[inline(always)]
    fn assemble(&mut self) {
        let (n, rc, zero) = (self.n, self.n - 1, [0.0; LANES]);
        self.c[..n].fill(zero);
        self.q[..n].iter_mut().for_each(|row| row[..n].fill(zero));
        for (index, [xx, xy, yy, bx, by]) in self.touching.iter().enumerate() {
            add(&mut self.c[0], bx);
            add(&mut self.q[0][0], xx);
            let basis = &self.basis[index * rc..(index + 1) * rc];
            for (i, [re, im]) in basis.iter().enumerate() {
                let hx = lane(|l| xx[l] * re[l] + xy[l] * im[l]);
                let hy = lane(|l| xy[l] * re[l] + yy[l] * im[l]);
                add(&mut self.c[i + 1], &lane(|l| re[l] * bx[l] + im[l] * by[l]));
                let row = &mut self.q[i + 1];
                add(&mut row[0], &hx);
                for (q, [re, im]) in row[1..].iter_mut().zip(&basis[..=i]) {
                    add(q, &lane(|l| hx[l] * re[l] + hy[l] * im[l]));
                }
            }
        }
    }

    /// Best resistances within bounds by block principal pivoting (Portugal, Júdice and
    /// Vicente, 1994): all lanes exchange free and held unknowns together until none is wrong, from
    /// where the last round ended; lanes that do not settle are solved one by one.
    #[inline(always)]
    fn solve(&mut self) {
        const EXCHANGES: usize = 6;
        let mut settled = [0.0; LANES];
        for _ in 0..EXCHANGES {
            let sound = self.solve_free();
            let right = self.exchange();
            settled = lane(|l| sound[l] * right[l]);
            if settled == [1.0; LANES] {
                return;
            }
        }
        for l in (0..LANES).filter(|l| settled[*l] != 1.0) {
            self.solve_one(l);
        }
    }

    fn solve_one(&mut self, l: usize) {
        let n = self.n;
        let mut one = BoxQuadratic::new(n);
        for i in 0..n {
            (one.c[i], one.lo[i], one.hi[i]) = (self.c[i][l], self.lo[i][l], self.hi[i][l]);
            for j in 0..=i {
                one.q[i][j] = self.q[i][j][l];
                one.q[j][i] = self.q[i][j][l];
            }
        }
        let r = one.solve();
        for i in 0..n {
            self.r[i][l] = r[i];
        }
    }

    /// Holds unknowns that violate a bound and frees those that pull off one; 1 if nothing changed.
    #[inline(always)]
    fn exchange(&mut self) -> Lane {
        let n = self.n;
        let mut right = [1.0; LANES];
        for i in 0..n {
            let mut gradient = lane(|l| -self.c[i][l]);
            for j in 0..n {
                let (q, x) = (&self.q[i.max(j)][i.min(j)], &self.r[j]);
                gradient = lane(|l| gradient[l] + q[l] * x[l]);
            }
            let (q, c, x, lo, hi) = (&self.q[i][i], &self.c[i], self.r[i], self.lo[i], self.hi[i]);
            let (free, at) = (self.free[i], self.at[i]);
            let noise = lane(|l| 1e-9 * (c[l].abs() + q[l] * x[l].abs()));
            let below = lane(|l| if x[l] < lo[l] { free[l] } else { 0.0 });
            let above = lane(|l| if x[l] > hi[l] { free[l] } else { 0.0 });
            let inward = lane(|l| {
                if at[l] > lo[l] {
                    gradient[l]
                } else {
                    -gradient[l]
                }
            });
            let off = lane(|l| {
                if inward[l] > noise[l] {
                    1.0 - free[l]
                } else {
                    0.0
                }
            });
            self.free[i] = lane(|l| free[l] - below[l] - above[l] + off[l]);
            self.at[i] = lane(|l| {
                if above[l] > 0.0 {
                    hi[l]
                } else if below[l] > 0.0 {
                    lo[l]
                } else {
                    at[l]
                }
            });
            right = lane(|l| right[l] * (1.0 - below[l]) * (1.0 - above[l]) * (1.0 - off[l]));
        }
        right
    }

    /// Cholesky of all lanes over the free unknowns, with the held ones at their bounds and the
    /// ridge of [`BoxQuadratic`]; 1 if it succeeded.
    #[inline(always)]
    fn solve_free(&mut self) -> Lane {
        let n = self.n;
        let mut f = self.q;
        let mut sound = [1.0; LANES];
        for i in 0..n {
            let mine = self.free[i];
            let mut x = self.c[i];
            for j in 0..n {
                let (q, free, at) = (&self.q[i.max(j)][i.min(j)], &self.free[j], &self.at[j]);
                x = lane(|l| x[l] - (1.0 - free[l]) * q[l] * at[l]);
            }
            let at = &self.at[i];
            x = lane(|l| mine[l] * x[l] + (1.0 - mine[l]) * at[l]);
            for j in 0..i {
                let other = &self.free[j];
                let mut s = lane(|l| f[i][j][l] * mine[l] * other[l]);
                for k in 0..j {
                    let (a, b) = (f[i][k], f[j][k]);
                    s = lane(|l| s[l] - a[l] * b[l]);
                }
                let d = f[j][j];
                f[i][j] = lane(|l| s[l] * d[l]);
            }
            let mut s = lane(|l| f[i][i][l] * (1.0 + 1e-11) * mine[l] + (1.0 - mine[l]));
            let floor = lane(|l| 1e-14 * s[l]);
            for k in 0..i {
                let (a, b) = (f[i][k], self.r[k]);
                s = lane(|l| s[l] - a[l] * a[l]);
                x = lane(|l| x[l] - a[l] * b[l]);
            }
            sound = lane(|l| if s[l] > floor[l] { sound[l] } else { 0.0 });
            let d = lane(|l| 1.0 / s[l].max(f64::MIN_POSITIVE).sqrt());
            f[i][i] = d;
            self.r[i] = lane(|l| x[l] * d[l]);
        }
        for i in (0..n).rev() {
            let mut x = self.r[i];
            for k in i + 1..n {
                let (a, b) = (f[k][i], self.r[k]);
                x = lane(|l| x[l] - a[l] * b[l]);
            }
            let d = f[i][i];
            self.r[i] = lane(|l| x[l] * d[l]);
        }
        sound
    }

    /// Computes the objective at the resistances; sets the next touching quadratic if requested.
    #[inline(always)]
    fn evaluate(&mut self, problem: &Problem, more: bool) -> Lane {
        let rc = self.n - 1;
        let mut value = [0.0; LANES];
        let floor = 1e-8 * problem.scale_ohm * problem.scale_ohm;
        for (index, g) in problem.groups.iter().enumerate() {
            let (mut x, mut y) = (self.r[0], [0.0; LANES]);
            for (k, [re, im]) in self.basis[index * rc..(index + 1) * rc].iter().enumerate() {
                let r = self.r[k + 1];
                x = lane(|l| x[l] + r[l] * re[l]);
                y = lane(|l| y[l] + r[l] * im[l]);
            }
            match problem.kind {
                Objective::Complex => {
                    let [xx, xy, yy] = g.weight;
                    let (u, v) = (lane(|l| x[l] - g.mean.re), lane(|l| y[l] - g.mean.im));
                    add(
                        &mut value,
                        &lane(|l| {
                            xx * u[l] * u[l] + 2.0 * xy * u[l] * v[l] + yy * v[l] * v[l] + g.scatter
                        }),
                    );
                }
                Objective::Modulus => {
                    let n = g.points.len() as f64;
                    let m = lane(|l| (x[l] * x[l] + y[l] * y[l]).sqrt());
                    let excess = lane(|l| m[l] - g.mean_abs);
                    add(
                        &mut value,
                        &lane(|l| n * excess[l] * excess[l] + g.scatter_abs),
                    );
                    let inverse = lane(|l| 1.0 / m[l].max(f64::MIN_POSITIVE));
                    let (u, v) = (lane(|l| x[l] * inverse[l]), lane(|l| y[l] * inverse[l]));
                    let pull = n * g.mean_abs;
                    self.touching[index] = [
                        lane(|l| n * u[l] * u[l]),
                        lane(|l| n * u[l] * v[l]),
                        lane(|l| n * v[l] * v[l]),
                        lane(|l| pull * u[l]),
                        lane(|l| pull * v[l]),
                    ];
                }
                Objective::SumAbs => {
                    let (mut weight, mut bx, mut by) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
                    for p in &g.points {
                        let s = lane(|l| {
                            ((x[l] - p.z.re) * (x[l] - p.z.re)
                                + (y[l] - p.z.im) * (y[l] - p.z.im)
                                + floor)
                                .sqrt()
                        });
                        add(&mut value, &s);
                        if more {
                            let w = lane(|l| 1.0 / s[l]);
                            add(&mut weight, &w);
                            bx = lane(|l| bx[l] + w[l] * p.z.re);
                            by = lane(|l| by[l] + w[l] * p.z.im);
                        }
                    }
                    self.touching[index] = [weight, [0.0; LANES], weight, bx, by];
                }
            }
        }
        value
    }
}

#[inline(always)]
fn add(to: &mut Lane, what: &Lane) {
    for l in 0..LANES {
        to[l] += what[l];
    }
}
