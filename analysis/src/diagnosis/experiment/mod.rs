//! The next experiment: which planned run tells rivals apart, and how well (discrimination designs, Hunter and Reiner 1965; Atkinson and Fedorov 1975).
//!
//! Not here: playing the run. Reading order: `planned`, runs as data; `menu`, what a bench can do; `separate`, λ of a pair; here, the choice.

mod menu;
mod planned;
mod separate;

pub use planned::{CurrentLimits, Planned, PlannedRun};

use super::block::Desk;
use super::guards::CERTAIN_LAMBDA;
use super::outcome::{NextExperiment, Verdict};
use super::prepare::Prepared;
use super::problem::{Fit, Problem};
use super::select::{RivalFit, Selection};
use menu::{Campaign, MenuItem, menu, sentinel_repeat};
use separate::{View, separation_chi2};

/// λ at which a pair is told apart without doubt.
const ENOUGH: f64 = 40.0;
/// Growth of the closest pair's λ below which a run is not worth its time.
const LEAST_GROWTH: f64 = 4.0;
/// Rivals of one effect that are looked at, the closest ones.
const MOST_RIVALS: usize = 3;
/// Items whose λ is found by more than one step.
const REFINED: usize = 3;
/// Steps of a refined refit.
const STEPS: usize = 3;

/// What was recommended, as words and as runs.
pub(super) type Recommended = (NextExperiment, Vec<PlannedRun>);

/// Structures that the data leave open, and which of them are to be told apart.
struct Open<'a> {
    fits: Vec<(&'static str, &'a Fit)>,
    pairs: Vec<Pair>,
}

/// A structure taken for the truth, one that is refitted to what it predicts, and the λ that settles it.
struct Pair {
    truth: usize,
    other: usize,
    enough: f64,
}

/// The pair that is farthest from being settled: its λ, and that as a part of what settles it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tightest {
    lambda: f64,
    part: f64,
}

impl<'a> Open<'a> {
    /// Each named effect against its closest rivals, and against nothing where it is too weak to be certain; without names what was refused last.
    fn new(verdict: Verdict, base: &'a Fit, selection: &'a Selection) -> Self {
        let mut open = Self { fits: Vec::new(), pairs: Vec::new() };
        for taken in &selection.taken {
            let named = open.add(taken.name, &selection.fit);
            let mut rivals: Vec<&RivalFit> = taken.rivals.iter().collect();
            rivals.sort_by(|a, b| b.score_gap.total_cmp(&a.score_gap));
            for rival in rivals.into_iter().take(MOST_RIVALS) {
                let other = open.add(rival.name, &rival.fit);
                open.pairs.extend([(named, other), (other, named)].map(|(truth, other)| Pair { truth, other, enough: ENOUGH }));
            }
            let weak = selection.taken.len() == 1 && taken.evidence.lambda < CERTAIN_LAMBDA;
            if verdict == Verdict::Ambiguous && weak {
                let other = open.add("", base);
                open.pairs.push(Pair { truth: named, other, enough: CERTAIN_LAMBDA });
            }
        }
        if open.pairs.is_empty() && verdict == Verdict::Unexplained {
            open.refused(selection);
        }
        open
    }

    /// What was refused last, among itself; a single one against what was taken before it.
    fn refused(&mut self, selection: &'a Selection) {
        self.fits = selection.refused_fits.iter().map(|a| (a.name, &a.fit)).collect();
        let n = self.fits.len();
        if n == 1 {
            let other = self.add("", &selection.fit);
            self.pairs.push(Pair { truth: 0, other, enough: ENOUGH });
            return;
        }
        let all = (0..n * n).map(|ij| (ij / n, ij % n)).filter(|(i, j)| i != j);
        self.pairs = all.map(|(truth, other)| Pair { truth, other, enough: ENOUGH }).collect();
    }

    fn add(&mut self, name: &'static str, fit: &'a Fit) -> usize {
        self.fits.push((name, fit));
        self.fits.len() - 1
    }

    /// Effects of the pairs.
    fn names(&self) -> Vec<&'static str> {
        let mut names: Vec<&'static str> = Vec::new();
        let paired = |k: usize| self.pairs.iter().any(|p| p.truth == k || p.other == k);
        for (_, (name, _)) in self.fits.iter().enumerate().filter(|(k, (name, _))| !name.is_empty() && paired(*k)) {
            if !names.contains(name) {
                names.push(name);
            }
        }
        names
    }

    /// The tightest pair when planned runs are measured too, by so many steps of the refits.
    fn tightest(&self, planned: Option<&Problem>, steps: usize, desk: &mut Desk) -> Tightest {
        let views: Vec<View> = self.fits.iter().map(|(_, fit)| View::new(fit, planned, desk)).collect();
        let mut tightest = Tightest { lambda: f64::INFINITY, part: f64::INFINITY };
        for Pair { truth, other, enough } in &self.pairs {
            let other = (self.fits[*other].1, &views[*other], planned);
            let lambda = separation_chi2((self.fits[*truth].1, &views[*truth]), other, steps, desk);
            if lambda / enough < tightest.part {
                tightest = Tightest { lambda, part: lambda / enough };
            }
        }
        tightest
    }
}

/// An item with what it would tell.
struct Rated {
    item: MenuItem,
    planned: Problem,
    then: Tightest,
}

impl Rated {
    /// Better first: what settles all pairs, by λ per minute; among what does not, by λ.
    fn order(&self, other: &Self) -> std::cmp::Ordering {
        let settles = |r: &Self| r.then.part >= 1.0;
        let worth = |r: &Self| if settles(r) { r.then.part / r.item.duration_min() } else { r.then.part };
        settles(other).cmp(&settles(self)).then(worth(other).total_cmp(&worth(self)))
    }
}

/// The run that tells what is open apart; none where nothing is open or no run of the menu would.
pub(super) fn recommend(
    prepared: &Prepared,
    verdict: Verdict,
    (base, selection): (&Fit, &Selection),
    limits: Option<CurrentLimits>,
) -> Option<Recommended> {
    if !matches!(verdict, Verdict::Ambiguous | Verdict::Unexplained) {
        return None;
    }
    let campaign = Campaign::new(&prepared.problem, limits);
    let open = Open::new(verdict, base, selection);
    if open.pairs.is_empty() {
        // No names to tell apart: what changed by itself shows when the first run is repeated.
        let nothing = Tightest { lambda: 0.0, part: 0.0 };
        return sentinel_repeat(&campaign).map(|item| told(item, &open, (nothing, nothing)));
    }
    let mut desk = Desk::default();
    let now = open.tightest(None, 1, &mut desk);
    let mut rated: Vec<Rated> = menu(&campaign)
        .into_iter()
        .filter_map(|item| {
            let planned = prepared.planned(&item.runs, &mut desk).ok()?;
            let then = open.tightest(Some(&planned), 1, &mut desk);
            Some(Rated { item, planned, then })
        })
        .collect();
    rated.sort_by(Rated::order);
    rated.truncate(REFINED);
    rated.iter_mut().for_each(|r| r.then = open.tightest(Some(&r.planned), STEPS, &mut desk));
    rated.sort_by(Rated::order);
    let best = rated.into_iter().next().filter(|r| r.then.lambda >= now.lambda + LEAST_GROWTH)?;
    Some(told(best.item, &open, (best.then, now)))
}

fn told(item: MenuItem, open: &Open<'_>, (then, now): (Tightest, Tightest)) -> Recommended {
    let next = NextExperiment {
        name: item.name,
        duration_min: item.duration_min(),
        charge_ah: item.charge_ah(),
        description: item.description,
        separates: open.names(),
        separation_sigma: then.lambda.sqrt(),
        separation_now_sigma: now.lambda.sqrt(),
    };
    (next, item.runs)
}

#[cfg(test)]
mod tests;
