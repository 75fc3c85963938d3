//! Exchange of roles: a branch of the base that stands where a mode of an effect belongs.
//!
//! A base without the effect bends its slowest branch onto the effect's first mode. Fitted on top
//! of that base, the effect only fills what is left, and no small step leads out of this minimum.
//! So the effect is also fitted from the branch's place, with the branch elsewhere.

use super::attempts::Attempt;
use super::search::Search;
use super::structure::Member;
use crate::thresholds::{DEEPER_CHI2, LEFT_OF_BRANCH, MOST_RESTARTS, STRONG_LAGRANGE};
use analysis_effects::contract::{Base, Network, Scale};

/// Resistance and time constant of a mode.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Mode {
    r_ohm: f64,
    tau_s: f64,
}

impl Mode {
    /// Returns the slowest of several modes of a member whose strength is their resistance and whose
    /// only shape is their time; `None` for all others: one mode is a branch itself.
    fn of(member: &Member, values: &[f64], base: &Base) -> Option<Self> {
        let [strength, shape] = member.parameters.as_slice() else {
            return None;
        };
        if strength.unit != "Ω" || shape.unit != "s" || shape.scale != Scale::Log {
            return None;
        }
        let mut network = Network {
            r_ohm: 0.0,
            branches: Vec::new(),
        };
        member.effect.network(values, base, &mut network);
        let slowest = network
            .branches
            .iter()
            .max_by(|a, b| a.tau_s.total_cmp(&b.tau_s))?;
        (network.branches.len() > 1 && slowest.r_ohm > 0.0).then_some(Self {
            r_ohm: slowest.r_ohm,
            tau_s: slowest.tau_s,
        })
    }
}

impl Search<'_> {
    /// Returns the fit of an addition, or a deeper one in which its first mode and a branch of the
    /// base have exchanged their roles.
    pub(super) fn exchanged(&mut self, before_chi2: f64, attempt: Attempt) -> Attempt {
        let mut best = attempt;
        if best.lambda < STRONG_LAGRANGE {
            return best;
        }
        for _ in 0..MOST_RESTARTS {
            let Some(deeper) = self
                .exchanges(&best)
                .into_iter()
                .map(|start| self.restarted(before_chi2, &best, start))
                .filter(|other| other.lambda > best.lambda + DEEPER_CHI2)
                .max_by(|a, b| a.lambda.total_cmp(&b.lambda))
            else {
                break;
            };
            best = deeper;
        }
        best
    }

    /// Returns the starts after each exchange, the slowest branch first: the branch takes the place
    /// of the mode, or stays with a small part of its resistance.
    fn exchanges(&self, attempt: &Attempt) -> Vec<Vec<f64>> {
        let (fit, branches) = (&attempt.fit, self.problem.branches());
        let last = fit.structure.members.len() - 1;
        let member = &fit.structure.members[last];
        let (_, values) = fit.decode(branches);
        let (values, at) = (&values[last], fit.structure.first(last, branches));
        let Some(mode) = Mode::of(member, values, &self.problem.base) else {
            return Vec::new();
        };
        let mut slowest_first: Vec<usize> = (0..branches).collect();
        slowest_first.sort_by(|a, b| fit.x[2 + 2 * b].total_cmp(&fit.x[2 + 2 * a]));
        let mut starts = Vec::new();
        for k in slowest_first {
            let (ln_r, ln_tau) = (fit.x[1 + 2 * k], fit.x[2 + 2 * k]);
            let mut x = fit.x.clone();
            x[at] *= ln_r.exp() / mode.r_ohm;
            x[at + 1] += ln_tau - mode.tau_s.ln();
            let mut small = x.clone();
            small[1 + 2 * k] += LEFT_OF_BRANCH.ln();
            (x[1 + 2 * k], x[2 + 2 * k]) = (mode.r_ohm.ln(), mode.tau_s.ln());
            starts.extend([x, small]);
        }
        starts
    }

    /// Returns the attempt fitted from another start.
    fn restarted(&mut self, before_chi2: f64, attempt: &Attempt, mut x: Vec<f64>) -> Attempt {
        let axes = attempt.fit.axes.clone();
        x.iter_mut()
            .zip(&axes)
            .for_each(|(x, axis)| *x = x.clamp(axis.lower, axis.upper));
        let structure = &attempt.fit.structure;
        let fit = self
            .problem
            .fit_from(structure, x, axes, &mut self.workspace);
        let lambda = before_chi2 - fit.chi2;
        Attempt {
            score: attempt.score + lambda - attempt.lambda,
            lambda,
            fit,
            ..attempt.clone()
        }
    }
}
