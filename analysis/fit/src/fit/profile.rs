//! Profile likelihood: one quantity held, all others fitted again; the interval is where the
//! objective stays near its minimum. Unlike the covariance it need not be symmetric, and it says
//! when a quantity is not bounded at all.
//!
//! The rise of the objective is turned into Δχ² by the noise: χ² itself where every point has a
//! covariance (widened by the reduced χ² above one), the reduced χ² where none is known; for other
//! objectives and for spectra enough to show their own scatter by the ratio of curvature to the
//! stated variance of the parameter (Pace, Salvan and Sartori, 2011), so that near the minimum
//! profile and sigma agree. Limits are squares of Student's t, for the noise is known no better
//! than its degrees of freedom: of few cells, their number less one.

use super::options::{FitError, FitOptions, Objective, check_spectra};
use super::problem::Problem;
use super::result::ErmFit;
use super::search::{log_bounds, polish, sharp};
use super::uncertainty::rounded;
use analysis_numeric::{LocalOptions, Minimum, Smooth, linalg::invert, minimise, stats::t_factor};
use analysis_signal::spectrum::Spectrum;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Maximum number of steps to each side, and the first step as a fraction of a sigma.
const STEPS: usize = 40;
const FIRST_STEP: f64 = 0.4;
/// Pull on the DC resistance: Δχ² of a deviation by a whole step.
const PULL: f64 = 50.0;

/// Quantity that is held fixed.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Held {
    Parameter(usize),
    DcResistance,
}

/// Lower and upper limit; `None` if neither the band nor the bounds set one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Lower limit, in the unit of the quantity.
    pub low: Option<f64>,
    /// Upper limit, in the unit of the quantity.
    pub high: Option<f64>,
}

/// The profile of one quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// R, R1, C1, … as in the thesis, or `DC resistance`.
    pub name: String,
    /// Ω or F.
    pub unit: String,
    /// The fitted value.
    pub value: f64,
    /// 68.27 % interval.
    pub interval_68: Interval,
    /// 95 % interval.
    pub interval_95: Interval,
    /// The curve: value, Δχ².
    pub curve: Vec<(f64, f64)>,
    /// Δχ² at the ends of the two intervals.
    pub limits: (f64, f64),
    /// A deeper minimum that the profile found, as an objective; `None` if the fit was the best.
    pub deeper: Option<f64>,
}

impl Profile {
    /// Returns a warning with the numbers of the interval; `None` if it is bounded on both sides.
    pub fn warning(&self) -> Option<String> {
        let Interval { low, high } = self.interval_95;
        let reach = |index: usize| self.curve.get(index).map_or(self.value, |p| p.0);
        let (least, most) = (reach(0), reach(self.curve.len().saturating_sub(1)));
        let (name, unit) = (&self.name, &self.unit);
        match (low, high) {
            (Some(_), Some(_)) => None,
            (Some(low), None) => Some(format!(
                "{name} is not bounded above by this band: above {low:.4e} {unit}, tried up to \
                {most:.3e} {unit}"
            )),
            (None, Some(high)) => Some(format!(
                "{name} is not bounded below by this band: below {high:.4e} {unit}, tried down to \
                {least:.3e} {unit}"
            )),
            (None, None) => Some(format!(
                "{name} is not bounded by this band at all: tried {least:.3e} to {most:.3e} {unit}"
            )),
        }
    }
}

/// Profiles of all parameters of a fit and of its DC resistance, on all cores.
///
/// # Errors
/// [`FitError`] when the spectra or the options are not those of a fit.
pub fn profiles(spectra: &[Spectrum], fit: &ErmFit) -> Result<Vec<Profile>, FitError> {
    let options = FitOptions {
        rc: fit.erm.branches.len(),
        objective: fit.objective_kind,
        bounds: fit.bounds,
        seed: fit.seed,
    };
    options.check()?;
    check_spectra(spectra)?;
    let problem = sharp(&Problem::new(spectra, fit.objective_kind));
    options.check_size(problem.groups.len())?;
    let walk = Walk::new(&problem, fit, &options);
    let all: Vec<Held> = (0..options.parameter_count())
        .map(Held::Parameter)
        .chain([Held::DcResistance])
        .collect();
    Ok(all
        .into_par_iter()
        .map(|held| walk.profile(held, fit))
        .collect())
}

/// All that the walks along the quantities share.
struct Walk<'a> {
    problem: &'a Problem,
    bounds: Vec<(f64, f64)>,
    best: Minimum,
    /// Half the variance scale without better knowledge: f/freedom.
    noise: f64,
    freedom: f64,
    /// Inverse Hessian at the minimum, and whether the stated covariance sets the scale.
    inverse: Option<Vec<f64>>,
    by_covariance: bool,
}

impl<'a> Walk<'a> {
    fn new(problem: &'a Problem, fit: &ErmFit, options: &FitOptions) -> Self {
        let bounds = log_bounds(options);
        let best = polish(problem, &fit.erm.log_parameters(), &bounds);
        let n = best.x.len();
        let per_point = if problem.kind == Objective::Modulus {
            1
        } else {
            2
        };
        let freedom = (per_point * problem.points).saturating_sub(n) as f64;
        let (mut gradient, mut hessian) = (vec![0.0; n], vec![0.0; n * n]);
        rounded(problem, &best.x, fit.cells.is_some()).expand(&best.x, &mut gradient, &mut hessian);
        let noise = best.value / freedom;
        let noise = if problem.absolute_weights {
            noise.max(1.0)
        } else {
            noise
        };
        let clustered = fit.cells.is_some() || (!problem.absolute_weights && fit.spectra > n);
        let by_covariance = problem.kind == Objective::SumAbs || clustered;
        // Sigmas from the scatter of few cells have only these degrees of freedom.
        let freedom = fit
            .cells
            .map_or(freedom, |cells| (cells as f64 - 1.0).max(1.0));
        Self {
            problem,
            bounds,
            best,
            noise,
            freedom,
            inverse: invert(&hessian, n),
            by_covariance,
        }
    }

    fn profile(&self, held: Held, fit: &ErmFit) -> Profile {
        let (start, relative_sigma) = self.start(held, fit);
        let noise = self.noise_of(held, fit);
        // Stated noise is known; noise read off the residuals is known only so well.
        let freedom = if self.problem.absolute_weights && fit.cells.is_none() {
            1e8
        } else {
            self.freedom
        };
        let limits = [0.682_7, 0.95].map(|level| t_factor(level, freedom).powi(2));
        let step = FIRST_STEP * relative_sigma.filter(|s| *s > 0.0).unwrap_or(0.2).min(1.0);
        let mut points = vec![(start, 0.0)];
        let mut deeper = f64::INFINITY;
        for sign in [-1.0, 1.0] {
            let mut x = self.best.x.clone();
            let (mut at, mut step) = (start, step);
            for _ in 0..STEPS {
                let (reached, minimum) =
                    self.held_at(held, at + sign * step, &x, PULL * noise / (step * step));
                let rise = (minimum.value - self.best.value) / noise;
                if minimum.value < self.best.value * (1.0 - 1e-9) {
                    deeper = deeper.min(minimum.value);
                }
                let ended =
                    sign * (reached - at) < 1e-3 * step || self.leans_on_a_bound(held, &minimum.x);
                (at, x) = (reached, minimum.x);
                if !ended {
                    points.push((reached, rise.max(0.0)));
                }
                if ended || rise > 1.5 * limits[1] {
                    break;
                }
                // Flat stretches are crossed faster: what has not risen after ten sigmas may never
                // rise.
                step = if rise < 0.25 * limits[0] {
                    (step * 1.6).min(0.7)
                } else {
                    step
                };
            }
        }
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points.dedup_by(|a, b| a.0 == b.0);
        let interval = |limit: f64| Interval {
            low: crossing(&points, start, limit, -1.0),
            high: crossing(&points, start, limit, 1.0),
        };
        let (name, unit) = self.name(held, fit);
        Profile {
            name,
            unit: unit.to_owned(),
            value: start.exp(),
            interval_68: interval(limits[0]),
            interval_95: interval(limits[1]),
            curve: points.iter().map(|p| (p.0.exp(), p.1)).collect(),
            limits: (limits[0], limits[1]),
            deeper: deeper.is_finite().then_some(deeper),
        }
    }

    /// Another resistance has come to its upper bound: from here on the bound would make the curve
    /// rise, not the data.
    fn leans_on_a_bound(&self, held: Held, x: &[f64]) -> bool {
        let resistances = (0..x.len()).filter(|i| *i == 0 || i % 2 == 1);
        let at = |x: &[f64], i: usize| x[i] >= self.bounds[i].1 - 1e-9;
        resistances
            .filter(|i| held != Held::Parameter(*i))
            .any(|i| at(x, i) && !at(&self.best.x, i))
    }

    fn name(&self, held: Held, fit: &ErmFit) -> (String, &'static str) {
        match held {
            Held::DcResistance => ("DC resistance".to_owned(), "Ω"),
            Held::Parameter(i) => (
                fit.erm.parameter_names()[i].clone(),
                if i > 0 && i.is_multiple_of(2) {
                    "F"
                } else {
                    "Ω"
                },
            ),
        }
    }

    /// ln of the fitted value and its relative sigma.
    fn start(&self, held: Held, fit: &ErmFit) -> (f64, Option<f64>) {
        match held {
            Held::Parameter(i) => (
                self.best.x[i],
                fit.log_covariance.as_ref().map(|c| c[i][i].max(0.0).sqrt()),
            ),
            Held::DcResistance => {
                let dc = ln_dc(&self.best.x);
                (dc, fit.sigma.dc_resistance_ohm.map(|s| s / dc.exp()))
            }
        }
    }

    /// Divisor that turns the rise of the objective into Δχ².
    fn noise_of(&self, held: Held, fit: &ErmFit) -> f64 {
        let (_, Some(sigma)) = self.start(held, fit) else {
            return self.noise;
        };
        let Some(inverse) = self.inverse.as_ref().filter(|_| self.by_covariance) else {
            return self.noise;
        };
        let n = self.best.x.len();
        let naive = match held {
            Held::Parameter(i) => inverse[i * n + i],
            Held::DcResistance => {
                let w = dc_shares(&self.best.x);
                (0..n * n)
                    .map(|ij| w[ij / n] * inverse[ij] * w[ij % n])
                    .sum()
            }
        };
        // f rises by ½δ²/H⁻¹; Δχ² is to rise by δ²/σ².
        let noise = sigma * sigma / (2.0 * naive);
        if noise.is_finite() && noise > 0.0 {
            noise
        } else {
            self.noise
        }
    }

    /// Returns the least objective with the quantity held (or pulled) at `target`: its actual
    /// value, and the minimum.
    fn held_at(&self, held: Held, target: f64, from: &[f64], weight: f64) -> (f64, Minimum) {
        match held {
            Held::Parameter(i) => {
                let mut bounds = self.bounds.clone();
                let at = target.clamp(bounds[i].0, bounds[i].1);
                bounds[i] = (at, at);
                (at, polish(self.problem, from, &bounds))
            }
            Held::DcResistance => {
                // Any minimum of the sum is the constrained minimum at the resistance that it has:
                // the pull need not be met exactly.
                let pulled = Pulled {
                    problem: self.problem,
                    target,
                    weight,
                };
                let mut minimum = minimise(&pulled, from, &self.bounds, &LocalOptions::default());
                minimum.value = self.problem.value(&minimum.x);
                (ln_dc(&minimum.x), minimum)
            }
        }
    }
}

/// The objective with a spring on ln of the DC resistance.
struct Pulled<'a> {
    problem: &'a Problem,
    target: f64,
    weight: f64,
}

impl Smooth for Pulled<'_> {
    fn value(&self, x: &[f64]) -> f64 {
        self.problem.value(x) + self.weight * (ln_dc(x) - self.target).powi(2)
    }

    fn expand(&self, x: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        let value = self.problem.expand(x, gradient, hessian);
        let (off, shares, n) = (ln_dc(x) - self.target, dc_shares(x), x.len());
        for i in 0..n {
            gradient[i] += 2.0 * self.weight * off * shares[i];
            hessian[i * n + i] += 2.0 * self.weight * off * shares[i];
            for j in 0..n {
                hessian[i * n + j] += 2.0 * self.weight * (1.0 - off) * shares[i] * shares[j];
            }
        }
        value + self.weight * off * off
    }
}

/// ln(R + ΣRₖ).
fn ln_dc(x: &[f64]) -> f64 {
    (x[0].exp() + x[1..].iter().step_by(2).map(|v| v.exp()).sum::<f64>()).ln()
}

/// Returns the slopes of [`ln_dc`]: each resistance's share; zero for capacitances.
fn dc_shares(x: &[f64]) -> Vec<f64> {
    let dc = ln_dc(x).exp();
    (0..x.len())
        .map(|i| {
            if i == 0 || i % 2 == 1 {
                x[i].exp() / dc
            } else {
                0.0
            }
        })
        .collect()
}

/// First crossing of the limit by the curve, away from the start. It is interpolated in the root of
/// Δχ², which is nearly straight.
fn crossing(points: &[(f64, f64)], start: f64, limit: f64, sign: f64) -> Option<f64> {
    let mut side: Vec<(f64, f64)> = points
        .iter()
        .copied()
        .filter(|p| sign * (p.0 - start) >= 0.0)
        .collect();
    side.sort_by(|a, b| (sign * a.0).total_cmp(&(sign * b.0)));
    let pair = side
        .windows(2)
        .find(|w| w[0].1 <= limit && w[1].1 > limit)?;
    let (a, b) = (pair[0].1.sqrt(), pair[1].1.sqrt());
    Some((pair[0].0 + (pair[1].0 - pair[0].0) * (limit.sqrt() - a) / (b - a)).exp())
}
