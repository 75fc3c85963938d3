//! Pairs of structures that the data do not settle, and the λ that a further run must add to settle
//! each.

use super::separate::{View, separation_chi2};
use crate::thresholds::{
    CERTAIN_LAMBDA, LEAST_GROWTH, LINEAR_FACTOR, MOST_RIVALS, ONE_IN_TWENTY, WEAKEST_PART,
};
use crate::{
    block::Workspace,
    guards::naming_lead,
    outcome::Verdict,
    problem::{Fit, Problem},
    select::{RivalFit, Selection},
};
use analysis_effects::effects::find;

/// Structures that the data leave open, and which of them must be separated.
pub(super) struct Open<'a> {
    fits: Vec<(&'static str, &'a Fit)>,
    pub(super) pairs: Vec<Pair>,
    /// λ of each pair in the present data.
    pub(super) now: Vec<f64>,
    /// Pairs that some run can settle; all where none can.
    within_reach: Vec<usize>,
}

/// Pair of structures: one that is assumed to be true, one that is refitted to its prediction, and
/// the λ that a run must add to settle the pair.
pub(super) struct Pair {
    truth: usize,
    other: usize,
    enough: f64,
}

impl<'a> Open<'a> {
    /// Collects each named effect against its closest rivals, and against its absence (`without`,
    /// in the order of the names) if it is too weak to be certain; without any of these the last
    /// refused effect.
    pub(super) fn new(
        measured: bool,
        verdict: Verdict,
        without: &'a [Option<Fit>],
        selection: &'a Selection,
        workspace: &mut Workspace,
    ) -> Self {
        let mut open = Self {
            fits: Vec::new(),
            pairs: Vec::new(),
            now: Vec::new(),
            within_reach: Vec::new(),
        };
        for (selected, without) in selection.selected.iter().zip(without) {
            let found = selected.evidence.lambda;
            let lead = naming_lead(measured, found);
            let named = open.add(selected.name, &selection.fit);
            let mut rivals: Vec<&RivalFit> = selected.rivals.iter().collect();
            rivals.sort_by(|a, b| b.score_gap.total_cmp(&a.score_gap));
            for rival in rivals.into_iter().take(MOST_RIVALS) {
                let other = open.add(rival.name, &rival.fit);
                // An effect that contains the named effect as a limit imitates it in any
                // measurement. It must show that it is more.
                if !find(rival.name).is_some_and(|e| e.card().contains.contains(&selected.name)) {
                    open.pairs.push(Pair {
                        truth: named,
                        other,
                        enough: enough(lead + rival.score_gap, found),
                    });
                }
                open.pairs.push(Pair {
                    truth: other,
                    other: named,
                    enough: enough(lead - rival.score_gap, found),
                });
            }
            if let (Verdict::Ambiguous, true, Some(fit)) =
                (verdict, found < CERTAIN_LAMBDA, without)
            {
                let other = open.add("", fit);
                open.pairs.push(Pair {
                    truth: named,
                    other,
                    enough: enough(CERTAIN_LAMBDA - found, found),
                });
            }
        }
        if open.pairs.is_empty() {
            open.refused(selection, measured);
        }
        open.now = open.lambdas(None, 1, workspace);
        open.within_reach = (0..open.pairs.len()).collect();
        open
    }

    /// Opens the pairs among the fits that were refused last. A single refused fit is paired with
    /// the selection before it.
    fn refused(&mut self, selection: &'a Selection, measured: bool) {
        self.fits = selection
            .refused_fits
            .iter()
            .map(|a| (a.name, &a.fit))
            .collect();
        let needed: Vec<f64> = selection
            .refused_fits
            .iter()
            .map(|a| enough(naming_lead(measured, a.lambda), a.lambda))
            .collect();
        let n = self.fits.len();
        if n == 1 {
            let other = self.add("", &selection.fit);
            self.pairs.push(Pair {
                truth: 0,
                other,
                enough: needed[0],
            });
            return;
        }
        let all = (0..n * n)
            .map(|ij| (ij / n, ij % n))
            .filter(|(i, j)| i != j);
        self.pairs = all
            .map(|(truth, other)| Pair {
                truth,
                other,
                enough: needed[truth],
            })
            .collect();
    }

    fn add(&mut self, name: &'static str, fit: &'a Fit) -> usize {
        self.fits.push((name, fit));
        self.fits.len() - 1
    }

    /// Returns λ of every pair if planned runs are measured too, after a number of steps of the
    /// refits.
    pub(super) fn lambdas(
        &self,
        planned: Option<&Problem>,
        steps: usize,
        workspace: &mut Workspace,
    ) -> Vec<f64> {
        let views: Vec<View<'_>> = self
            .fits
            .iter()
            .map(|(_, fit)| View::new(fit, planned, workspace))
            .collect();
        let lambda = |p: &Pair, workspace: &mut Workspace| {
            separation_chi2(&views[p.truth], &views[p.other], planned, steps, workspace)
        };
        self.pairs.iter().map(|p| lambda(p, workspace)).collect()
    }

    /// Growth of a pair's λ by planned runs, as a part of the growth that settles it.
    fn growth(&self, pair: usize, then: &[f64]) -> f64 {
        ((then[pair] - self.now[pair]) / self.pairs[pair].enough).max(0.0)
    }

    /// Degree to which the pairs within reach are settled together, 0…1.
    pub(super) fn settled(&self, then: &[f64]) -> f64 {
        self.within_reach
            .iter()
            .map(|k| self.growth(*k, then).min(1.0))
            .sum::<f64>()
            / self.within_reach.len().max(1) as f64
    }

    /// Growth of the pair within reach that is least settled.
    pub(super) fn least(&self, then: &[f64]) -> f64 {
        self.within_reach
            .iter()
            .map(|k| self.growth(*k, then))
            .fold(f64::INFINITY, f64::min)
    }

    /// Returns whether all pairs are settled, those out of reach too.
    pub(super) fn all_settled(&self, then: &[f64]) -> bool {
        (0..self.pairs.len()).all(|k| self.growth(k, then) >= 1.0)
    }

    /// Pairs that a run brings forward.
    pub(super) fn moved(&self, then: &[f64]) -> Vec<usize> {
        (0..self.pairs.len())
            .filter(|k| self.growth(*k, then) >= LEAST_GROWTH)
            .collect()
    }

    /// Returns the number of repeats of a run that gives `then` on top of `before`, as a power of
    /// two up to `most`. Pairs that it cannot settle in this way do not count.
    pub(super) fn times(&self, before: &[f64], then: &[f64], most: usize) -> usize {
        let missing = |k: usize| (1.0 - self.growth(k, before)) / self.growth(k, then);
        let needed = self
            .within_reach
            .iter()
            .map(|k| missing(*k))
            .filter(|n| *n <= LINEAR_FACTOR * most as f64);
        let needed = needed.fold(f64::NEG_INFINITY, f64::max);
        if needed.is_finite() {
            (needed.max(1.0).ceil() as usize)
                .next_power_of_two()
                .min(most)
        } else {
            most
        }
    }

    /// Removes pairs that no run separates regardless of the number of repeats, and returns their
    /// names. λ grows no faster than the number of repeats: the refit minimises a sum that is
    /// linear in it.
    pub(super) fn leave_out(&mut self, thens: &[&[f64]], most: usize) -> Vec<[&'static str; 2]> {
        let hopeless = |k: &usize| {
            thens
                .iter()
                .all(|then| LINEAR_FACTOR * most as f64 * self.growth(*k, then) < 1.0)
        };
        let (out, within): (Vec<usize>, Vec<usize>) = (0..self.pairs.len()).partition(hopeless);
        if !within.is_empty() {
            self.within_reach = within;
        }
        let mut named: Vec<[&'static str; 2]> = Vec::new();
        for k in out {
            let pair = [
                self.fits[self.pairs[k].truth].0,
                self.fits[self.pairs[k].other].0,
            ];
            if !named.iter().any(|n| *n == pair || *n == [pair[1], pair[0]]) {
                named.push(pair);
            }
        }
        named
    }

    /// Effects of some pairs.
    pub(super) fn names(&self, pairs: &[usize]) -> Vec<&'static str> {
        let mut names: Vec<&'static str> = Vec::new();
        for k in pairs
            .iter()
            .flat_map(|k| [self.pairs[*k].truth, self.pairs[*k].other])
        {
            let name = self.fits[k].0;
            if !name.is_empty() && !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }
}

/// Returns the λ that a run must be expected to add for χ² to differ by `need` more in all but one
/// of twenty cases: λ scatters by 2√λ, and the effect may be weaker than the `found` λ suggests,
/// whose root scatters by one.
fn enough(need: f64, found: f64) -> f64 {
    let root = ONE_IN_TWENTY + (ONE_IN_TWENTY * ONE_IN_TWENTY + need.max(0.0)).sqrt();
    (root / (1.0 - ONE_IN_TWENTY / found.max(1.0).sqrt()).max(WEAKEST_PART)).powi(2)
}

/// Returns each named effect's fit without it, if the name is too weak to be certain; in the order
/// of the names.
pub(super) fn absences(
    problem: &Problem,
    selection: &Selection,
    workspace: &mut Workspace,
) -> Vec<Option<Fit>> {
    let alone = selection.selected.len() == 1;
    let without = |(k, selected): (usize, &crate::select::SelectedEffect)| {
        if selected.evidence.lambda >= CERTAIN_LAMBDA {
            return None;
        }
        if alone {
            return Some(selection.base.clone());
        }
        let (structure, x, axes) = problem.without(&selection.fit, k);
        Some(problem.fit_from(&structure, x, axes, workspace))
    };
    selection.selected.iter().enumerate().map(without).collect()
}
