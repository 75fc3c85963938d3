//! Start values and limits of a circuit's parameters, from the data alone.
//!
//! Every element gets a frequency within the band and an impedance within the range of |Z|, and its
//! parameters follow: C = 1/(ωr), τ = 1/ω, the A of a Warburg element = r√ω. Then each block in
//! series at the top of the circuit is scaled, for which least squares within bounds has a closed
//! form, so that chance has to find only time constants, exponents and the shares within a block.

use super::data::Data;
use crate::fit::pooled::{apply, quadratic};
use analysis_model::model::{Circuit, ElementKind, Node, ParameterKind, Role};
use analysis_numeric::{
    Rng,
    linalg::{BoxQuadratic, MAX_UNKNOWNS},
};
use num_complex::Complex64;
use std::f64::consts::TAU;

/// The exponents of starts are drawn from here to 1.
const LOWEST_EXPONENT: f64 = 0.5;
/// The shares within a block differ by up to this many decades up and down.
const SPREAD_DECADES: f64 = 1.0;

/// Ranges that the data show before any fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ranges {
    /// Angular frequencies of the band, rad/s.
    omega: (f64, f64),
    /// Least and greatest |Z|, Ω.
    z_ohm: (f64, f64),
}

impl Ranges {
    pub(super) fn of(data: &Data) -> Self {
        let span = |(lo, hi): (f64, f64), v: f64| (lo.min(v), hi.max(v));
        let none = (f64::INFINITY, 0.0);
        Self {
            omega: data.groups.iter().map(|g| TAU * g.freq_hz).fold(none, span),
            z_ohm: data
                .groups
                .iter()
                .flat_map(|g| &g.points)
                .map(|p| p.z.norm())
                .fold(none, span),
        }
    }

    /// Returns the bounds of one parameter: the range that this band could detect, several decades
    /// beyond it, within the physical range. `order` is the power of the frequency with which the
    /// impedance of the element falls.
    fn bounds(&self, kind: &ParameterKind, element: ElementKind) -> (f64, f64) {
        let (physical, omega) = (kind.bounds, (1e-3 * self.omega.0, 1e3 * self.omega.1));
        let level = (1e-6 * self.z_ohm.0, 1e4 * self.z_ohm.1);
        let orders: &[f64] = match element {
            ElementKind::C | ElementKind::H => &[1.0],
            ElementKind::L => &[-1.0],
            ElementKind::W => &[0.5],
            ElementKind::Cpe => &[LOWEST_EXPONENT, 1.0],
            // The storage of a pore; its resistances are levels whatever the frequency.
            _ if kind.role == Role::InverseLevel => &[LOWEST_EXPONENT, 1.0],
            ElementKind::La => &[-LOWEST_EXPONENT, -1.0],
            _ => &[0.0],
        };
        let corners = orders.iter().flat_map(|order| {
            [omega.0, omega.1]
                .into_iter()
                .flat_map(move |omega| [level.0, level.1].map(|level| level * omega.powf(*order)))
        });
        let span = |(lo, hi): (f64, f64), v: f64| (lo.min(v), hi.max(v));
        let (lo, hi) = match kind.role {
            Role::Level => corners.fold((f64::INFINITY, 0.0), span),
            Role::InverseLevel => corners.map(f64::recip).fold((f64::INFINITY, 0.0), span),
            Role::Time => (1e-4 / self.omega.1, 1e4 / self.omega.0),
            Role::Exponent | Role::Length => physical,
        };
        (
            lo.clamp(physical.0, physical.1),
            hi.clamp(physical.0, physical.1),
        )
    }

    /// Returns the bounds of all parameters, widened to contain given start values.
    pub(super) fn all_bounds(&self, circuit: &Circuit, guess: &[(usize, f64)]) -> Vec<(f64, f64)> {
        let mut bounds = Vec::with_capacity(circuit.parameter_names().len());
        circuit.root().visit(&mut |element| {
            bounds.extend(
                element
                    .kind
                    .parameters()
                    .iter()
                    .map(|kind| self.bounds(kind, element.kind)),
            );
        });
        for (i, value) in guess {
            let (kind, (lo, hi)) = (&circuit.parameter_kinds()[*i], bounds[*i]);
            if kind.role != Role::Exponent {
                bounds[*i] = (
                    lo.min(1e-3 * value).max(kind.bounds.0),
                    hi.max(1e3 * value).min(kind.bounds.1),
                );
            }
        }
        bounds
    }

    /// Returns the number of coordinates in 0…1 that [`Ranges::place`] needs.
    pub(super) fn dimensions(circuit: &Circuit) -> usize {
        circuit.parameter_names().len() + elements(circuit)
    }

    /// All parameters for coordinates in 0…1: per element one for its frequency, one for its level,
    /// others for exponents and lengths.
    pub(super) fn place(&self, circuit: &Circuit, unit: &[f64]) -> Vec<f64> {
        let mut parameters = Vec::with_capacity(circuit.parameter_names().len());
        let mut next = unit.iter().copied();
        // Half a decade beyond the band: there a time constant still shows.
        let (lo, hi) = (self.omega.0 / 3.0, 3.0 * self.omega.1);
        let middle = (self.z_ohm.0 * self.z_ohm.1).sqrt();
        circuit.root().visit(&mut |element| {
            let mut draw = || next.next().unwrap_or(0.5);
            // Of a diffusion, the knee may lie far below the band and still bend what is in it.
            let lo = if matches!(element.kind, ElementKind::Wo | ElementKind::Ws) {
                0.1 * lo
            } else {
                lo
            };
            let omega = lo * (hi / lo).powf(draw());
            let r = middle * 10f64.powf(SPREAD_DECADES * (2.0 * draw() - 1.0));
            let exponent = |u: f64| LOWEST_EXPONENT + (1.0 - LOWEST_EXPONENT) * u;
            match element.kind {
                ElementKind::R => parameters.push(r),
                ElementKind::C => parameters.push(1.0 / (omega * r)),
                ElementKind::L => parameters.push(r / omega),
                ElementKind::W => parameters.push(r * omega.sqrt()),
                ElementKind::Cpe | ElementKind::La => {
                    let alpha = exponent(draw());
                    let level = if element.kind == ElementKind::La {
                        r / omega.powf(alpha)
                    } else {
                        1.0 / (r * omega.powf(alpha))
                    };
                    parameters.extend([level, alpha]);
                }
                ElementKind::Wo | ElementKind::Ws | ElementKind::G | ElementKind::K => {
                    parameters.extend([r, 1.0 / omega]);
                }
                ElementKind::Zarc | ElementKind::Ga => {
                    parameters.extend([r, 1.0 / omega, exponent(draw())]);
                }
                ElementKind::Ha => {
                    let exponents = [exponent(draw()), exponent(draw())];
                    parameters.extend([r, 1.0 / omega]);
                    parameters.extend(exponents);
                }
                ElementKind::H => {
                    let exponents = [exponent(draw()), exponent(draw())];
                    parameters.extend([1.0 / (omega * r), 1.0 / omega]);
                    parameters.extend(exponents);
                }
                ElementKind::T => parameters.extend([r, r * draw(), draw(), 1.0 / omega]),
                ElementKind::Tlmq
                | ElementKind::Tlmbs
                | ElementKind::Tlmbq
                | ElementKind::Ls
                | ElementKind::Tlmns
                | ElementKind::Tlmnq => {
                    let gamma = exponent(draw());
                    // A storage with a resistance's share of the drawn one at the drawn frequency.
                    let storage = |share: f64, exponent: f64| {
                        1.0 / (r * 10f64.powf(2.0 * share - 1.0) * omega.powf(exponent))
                    };
                    parameters.push(r);
                    if matches!(
                        element.kind,
                        ElementKind::Ls | ElementKind::Tlmns | ElementKind::Tlmnq
                    ) {
                        parameters.push(r * 10f64.powf(2.0 * draw() - 1.0));
                    }
                    parameters.extend([storage(0.5, gamma), gamma]);
                    if element.kind == ElementKind::Tlmnq {
                        parameters.push(r * 10f64.powf(2.0 * draw() - 1.0));
                    }
                    if matches!(element.kind, ElementKind::Tlmbq | ElementKind::Tlmnq) {
                        let delta = exponent(draw());
                        parameters.extend([storage(draw(), delta), delta]);
                    }
                }
                ElementKind::Gs => {
                    let phi = 10f64.powf(2.0 * draw() - 1.0);
                    parameters.extend([r * phi.tanh(), 1.0 / omega, phi]);
                }
            }
        });
        parameters
    }
}

fn elements(circuit: &Circuit) -> usize {
    let mut count = 0;
    circuit.root().visit(&mut |_| count += 1);
    count
}

/// Makes starts of one circuit for one set of data.
pub(super) struct Starter<'a> {
    pub(super) circuit: &'a Circuit,
    pub(super) data: &'a Data,
    pub(super) ranges: Ranges,
    /// Values that every start keeps, constants and guesses.
    pub(super) given: Vec<(usize, f64)>,
    pub(super) bounds: &'a [(f64, f64)],
}

impl Starter<'_> {
    /// Returns the best of this number of random starts: parameters and weighted sum of squares.
    pub(super) fn draw(&self, rng: &mut Rng, candidates: usize) -> (Vec<f64>, f64) {
        let dimensions = Ranges::dimensions(self.circuit);
        let mut best = (Vec::new(), f64::INFINITY);
        for _ in 0..candidates.max(1) {
            let unit: Vec<f64> = (0..dimensions).map(|_| rng.uniform()).collect();
            let start = self.at(&unit);
            if start.1 < best.1 || best.0.is_empty() {
                best = start;
            }
        }
        best
    }

    /// The start of coordinates in 0…1, its blocks scaled to the data, and its weighted sum of
    /// squares.
    pub(super) fn at(&self, unit: &[f64]) -> (Vec<f64>, f64) {
        let mut parameters = self.ranges.place(self.circuit, unit);
        for (i, value) in &self.given {
            parameters[*i] = *value;
        }
        let value = self.scale(&mut parameters);
        for (p, (lo, hi)) in parameters.iter_mut().zip(self.bounds) {
            *p = p.max(*lo).min(*hi);
        }
        for (i, value) in &self.given {
            parameters[*i] = *value;
        }
        (parameters, value)
    }

    /// Scales the top-level blocks without given levels so that the weighted squares are minimal;
    /// returns them.
    fn scale(&self, parameters: &mut [f64]) -> f64 {
        let single = std::slice::from_ref(self.circuit.root());
        let blocks: &[Node] = if let Node::Series(blocks) = self.circuit.root() {
            blocks
        } else {
            single
        };
        let (free, given): (Vec<&Node>, Vec<&Node>) =
            blocks.iter().partition(|block| self.can_be_scaled(block));
        let scaled = &free[..free.len().min(MAX_UNKNOWNS)];
        // Each block with its greatest impedance at one, so that all factors are Ω of the same
        // size.
        let mut shapes: Vec<Vec<Complex64>> = scaled
            .iter()
            .map(|block| self.response(block, parameters))
            .collect();
        let mut factors: Vec<f64> = Vec::with_capacity(scaled.len());
        for shape in &mut shapes {
            let size = shape
                .iter()
                .map(|z| z.norm())
                .fold(f64::MIN_POSITIVE, f64::max);
            shape.iter_mut().for_each(|z| *z /= size);
            factors.push(1.0 / size);
        }
        let mut missing: Vec<Complex64> = self.data.groups.iter().map(|g| g.mean).collect();
        for block in given.iter().chain(&free[scaled.len()..]) {
            missing
                .iter_mut()
                .zip(self.response(block, parameters))
                .for_each(|(rest, z)| *rest -= z);
        }
        let levels = self.best_levels(&shapes, &missing);
        for ((block, factor), level) in scaled.iter().zip(factors).zip(levels) {
            for i in block.range() {
                match self.circuit.parameter_kinds()[i].role {
                    Role::Level => parameters[i] *= factor * level,
                    Role::InverseLevel => parameters[i] /= factor * level,
                    Role::Time | Role::Exponent | Role::Length => {}
                }
            }
        }
        let model = |k: usize| {
            shapes
                .iter()
                .zip(levels)
                .map(|(shape, level)| shape[k] * level)
                .sum::<Complex64>()
        };
        self.data
            .groups
            .iter()
            .enumerate()
            .map(|(k, g)| quadratic(&g.weight, model(k) - missing[k]))
            .sum()
    }

    fn can_be_scaled(&self, block: &Node) -> bool {
        let level = |i: usize| {
            matches!(
                self.circuit.parameter_kinds()[i].role,
                Role::Level | Role::InverseLevel
            )
        };
        !self
            .given
            .iter()
            .any(|(i, _)| block.range().contains(i) && level(*i))
    }

    /// The factors of the shapes that leave the least weighted squares.
    fn best_levels(&self, shapes: &[Vec<Complex64>], missing: &[Complex64]) -> [f64; MAX_UNKNOWNS] {
        let n = shapes.len();
        let mut problem = BoxQuadratic::new(n);
        for (k, group) in self.data.groups.iter().enumerate() {
            for (i, shape) in shapes.iter().enumerate() {
                let [x, y] = apply(&group.weight, shape[k]);
                problem.c[i] += x * missing[k].re + y * missing[k].im;
                for (q, other) in problem.q[i].iter_mut().zip(shapes) {
                    *q += x * other[k].re + y * other[k].im;
                }
            }
        }
        problem.lo[..n].fill(1e-3 * self.ranges.z_ohm.0);
        problem.hi[..n].fill(10.0 * self.ranges.z_ohm.1);
        problem.solve()
    }

    fn response(&self, block: &Node, parameters: &[f64]) -> Vec<Complex64> {
        self.data
            .groups
            .iter()
            .map(|g| block.impedance(parameters, TAU * g.freq_hz))
            .collect()
    }
}
