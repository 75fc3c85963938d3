//! Shares of mechanisms in what the refitted base lacks.
//!
//! The additions of a fit are grouped by mechanism. Every set of groups is fitted again with all
//! else, so that the question of each group is: what comes back when it is switched off? The share
//! of a group is the mean of what it removes over all orders in which the groups can be added
//! (Shapley 1953), in the mean square of the gap on held-out runs and in the χ² of fitted runs.

use super::attempts::is_outside;
use super::block::Workspace;
use super::gap::{Fits, gaps, spectrum_gaps};
use super::outcome::Share;
use super::prepare::Prepared;
use super::problem::Fit;
use super::search::Search;
use crate::thresholds::{NAMED_SHARE, PARTNER_SHARE, PREDICTIVE_TRIED};
use analysis_effects::effects::{Mechanism, title};
use analysis_model::model::Erm;
use rayon::prelude::*;

/// A mechanism and its members in a fit, by their places.
struct Part {
    mechanism: Mechanism,
    members: Vec<usize>,
}

/// What a set of mechanisms leaves.
#[derive(Debug, Clone, Copy)]
struct Left {
    /// χ² of the fitted runs.
    chi2: f64,
    /// Mean square of the gaps on held-out runs beyond their floors: mV², or parts of |Z|² where
    /// only spectra are held out.
    missed: f64,
    /// Root mean square over the held-out records, mV.
    missed_mv: f64,
}

impl Search<'_> {
    /// Returns the shares of the mechanisms that a fit has more than its base, the largest first;
    /// empty if it has none, or no run is held out.
    pub(super) fn shares(&mut self, prepared: &Prepared, erm: &Erm, fits: Fits<'_>) -> Vec<Share> {
        let (base, fit) = (fits.base, fits.augmented);
        let parts = parts(base, fit);
        let sets: Vec<usize> = (0..1 << parts.len()).collect();
        let mut found: Vec<(Fit, Left)> = sets
            .into_par_iter()
            .map(|set| {
                let own = self.aside().fit_of(&parts, set, fits);
                let left = left(prepared, erm, base, &own);
                (own, left)
            })
            .collect();
        keep_deepest(&mut found);
        self.progress.tell("asking what else would do as well");
        let all: Vec<Left> = found.iter().map(|(_, left)| *left).collect();
        let none = all[0];
        let last = all.len() - 1;
        let dof = self.problem.degrees_of_freedom(base);
        let of_gap = |v: f64| v / none.missed.max(f64::MIN_POSITIVE);
        let mut shares = Vec::new();
        for (k, part) in parts.iter().enumerate() {
            let held_out = removed(&all, k, |l| l.missed);
            let fitted = removed(&all, k, |l| l.chi2);
            let others = &found[last & !(1 << k)];
            let share = of_gap(mean(&held_out));
            let does_as_well = |other: &Fit| {
                let left = left(prepared, erm, base, other);
                let brings_back = |of: fn(&Left) -> f64| {
                    let removed = of(&others.1) - of(&all[last]);
                    removed > 0.0 && of(&others.1) - of(&left) >= PARTNER_SHARE * removed
                };
                brings_back(|l| l.chi2) && brings_back(|l| l.missed)
            };
            let partners = if share >= NAMED_SHARE {
                self.partners(part, &others.0, does_as_well)
            } else {
                Vec::new()
            };
            shares.push(Share {
                mechanism: part.mechanism,
                title: part.mechanism.title(),
                effects: part.names(fit),
                held_out: share,
                held_out_range: (of_gap(least(&held_out)), of_gap(greatest(&held_out))),
                fitted: mean(&fitted) / (none.chi2 - dof).max(1.0),
                without_mv: others.1.missed_mv,
                with_mv: all[last].missed_mv,
                partners,
            });
        }
        shares.sort_by(|a, b| b.held_out.total_cmp(&a.held_out));
        shares
    }

    /// Returns the fit with the mechanisms of a set alone, from the better of two starts: the
    /// parameters beside all of them, and the base's.
    fn fit_of(&mut self, parts: &[Part], set: usize, fits: Fits<'_>) -> Fit {
        if set == 0 {
            return fits.base.clone();
        }
        let mut fit = fits.augmented.clone();
        let mut off: Vec<usize> = parts
            .iter()
            .enumerate()
            .filter(|(k, _)| set & (1 << k) == 0)
            .flat_map(|(_, part)| part.members.iter().copied())
            .collect();
        off.sort_unstable();
        let Some((first, others)) = off.split_first() else {
            return fit;
        };
        for member in others.iter().rev() {
            let (structure, x, axes) = self.problem.without(&fit, *member);
            fit = Fit {
                structure,
                x,
                axes,
                ..fit
            };
        }
        self.refit_without(fits.base, &fit, *first)
    }

    /// Returns the other mechanisms, or laws outside the catalogue, one effect of which does as well
    /// as a mechanism: it brings back nearly all of what that removes.
    fn partners(
        &mut self,
        part: &Part,
        without: &Fit,
        does_as_well: impl Fn(&Fit) -> bool,
    ) -> Vec<&'static str> {
        let others = self.attempts_of(without, PREDICTIVE_TRIED, |name| {
            is_outside(name) || Mechanism::of(name) != part.mechanism
        });
        let mut partners = Vec::new();
        for other in others {
            let title = if is_outside(other.name) {
                title(other.name).unwrap_or(other.name)
            } else {
                Mechanism::of(other.name).title()
            };
            if !partners.contains(&title) && does_as_well(&other.fit) {
                partners.push(title);
            }
        }
        partners
    }
}

impl Part {
    fn names(&self, fit: &Fit) -> Vec<&'static str> {
        let members = self.members.iter();
        members.map(|m| fit.structure.members[*m].name()).collect()
    }
}

/// Groups the members that a fit has more than its base, in the order of their first member.
fn parts(base: &Fit, fit: &Fit) -> Vec<Part> {
    let mut parts: Vec<Part> = Vec::new();
    let members = fit.structure.members.iter().enumerate();
    for (k, member) in members.skip(base.structure.members.len()) {
        let mechanism = Mechanism::of(member.name());
        match parts.iter_mut().find(|p| p.mechanism == mechanism) {
            Some(part) => part.members.push(k),
            None => parts.push(Part {
                mechanism,
                members: vec![k],
            }),
        }
    }
    parts
}

fn left(prepared: &Prepared, erm: &Erm, base: &Fit, fit: &Fit) -> Left {
    let mut workspace = Workspace::default();
    let fits = Fits {
        base,
        augmented: fit,
    };
    let mean = |squares: &[f64]| squares.iter().sum::<f64>() / squares.len().max(1) as f64;
    let beyond = |miss: f64, floor: f64| (miss * miss - floor * floor).max(0.0);
    let records = gaps(prepared, erm, fits, &mut workspace);
    let all_mv2: Vec<f64> = records.iter().map(|g| g.augmented_mv.powi(2)).collect();
    let missed: Vec<f64> = if records.is_empty() {
        spectrum_gaps(&prepared.problem, erm, fits, &mut workspace)
            .iter()
            .map(|g| beyond(g.augmented_percent, g.floor_percent))
            .collect()
    } else {
        records
            .iter()
            .map(|g| beyond(g.augmented_mv, g.floor_mv))
            .collect()
    };
    Left {
        chi2: fit.chi2,
        missed: mean(&missed),
        missed_mv: mean(&all_mv2).sqrt(),
    }
}

/// Replaces the fit of a set by that of a smaller one if the smaller one is deeper: the larger one
/// has stopped in a wrong minimum.
fn keep_deepest(found: &mut [(Fit, Left)]) {
    for set in 0..found.len() {
        for k in 0..found.len().trailing_zeros() {
            let smaller = set & !(1 << k);
            if found[smaller].1.chi2 < found[set].1.chi2 {
                found[set] = found[smaller].clone();
            }
        }
    }
}

/// Returns what a mechanism removes beside each set of the others, with the weight of the set.
fn removed(left: &[Left], k: usize, of: impl Fn(&Left) -> f64) -> Vec<(f64, f64)> {
    let own = 1 << k;
    let count = left.len().trailing_zeros() as usize;
    let without = (0..left.len()).filter(|set| set & own == 0);
    without
        .map(|set| {
            let size = set.count_ones() as usize;
            let weight = 1.0 / (count as f64 * choose(count - 1, size));
            (of(&left[set]) - of(&left[set | own]), weight)
        })
        .collect()
}

/// Binomial coefficient.
fn choose(n: usize, k: usize) -> f64 {
    (0..k).map(|i| (n - i) as f64 / (i + 1) as f64).product()
}

fn mean(removed: &[(f64, f64)]) -> f64 {
    removed.iter().map(|(value, weight)| value * weight).sum()
}

fn least(removed: &[(f64, f64)]) -> f64 {
    removed
        .iter()
        .fold(f64::INFINITY, |least, r| least.min(r.0))
}

fn greatest(removed: &[(f64, f64)]) -> f64 {
    removed
        .iter()
        .fold(f64::NEG_INFINITY, |most, r| most.max(r.0))
}

#[cfg(test)]
mod tests {
    use super::{Left, mean, removed};

    /// Two mechanisms that are worth 1 and 2 alone and 6 together.
    fn together() -> Vec<Left> {
        [10.0, 9.0, 8.0, 4.0]
            .map(|chi2| Left {
                chi2,
                missed: 2.0 * chi2,
                missed_mv: 0.0,
            })
            .to_vec()
    }

    #[test]
    fn shares_of_two_mechanisms_add_up_and_split_what_only_both_do() {
        let left = together();
        let [first, second] = [0, 1].map(|k| mean(&removed(&left, k, |l| l.chi2)));
        assert!((first - 2.5).abs() < 1e-12 && (second - 3.5).abs() < 1e-12);
        let missed = mean(&removed(&left, 0, |l| l.missed));
        assert!((missed - 5.0).abs() < 1e-12);
    }

    #[test]
    fn weights_of_all_sets_add_up_to_one() {
        for count in 1..5 {
            let left = vec![together()[0]; 1 << count];
            for k in 0..count {
                let sum: f64 = removed(&left, k, |l| l.chi2).iter().map(|r| r.1).sum();
                assert!((sum - 1.0).abs() < 1e-12, "{count} {k}");
            }
        }
    }
}
