//! The next experiment: which planned run tells rivals apart, and how well (discrimination designs, Hunter and Reiner 1965; Atkinson and Fedorov 1975).
//!
//! Not here: playing the run. Reading order: `planned`, runs as data; `menu`, what a bench can do; `separate`, λ of a pair; here, the choice.

mod menu;
mod planned;
mod separate;

pub use planned::{CurrentLimits, Planned, PlannedRun};

use super::block::Desk;
use super::outcome::{NextExperiment, Verdict};
use super::prepare::Prepared;
use super::problem::{Fit, Problem};
use super::select::Selection;
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

/// Structures that the data leave open, and which of them are to be told apart: (truth, what is refitted to it).
struct Open<'a> {
    fits: Vec<(&'static str, &'a Fit)>,
    pairs: Vec<(usize, usize)>,
}

impl<'a> Open<'a> {
    /// Each named effect against its closest rivals, else what was refused last among itself.
    fn new(selection: &'a Selection) -> Self {
        let mut open = Self { fits: Vec::new(), pairs: Vec::new() };
        for taken in &selection.taken {
            let mut rivals: Vec<_> = taken.rivals.iter().collect();
            rivals.sort_by(|a, b| b.score_gap.total_cmp(&a.score_gap));
            if rivals.is_empty() {
                continue;
            }
            let first = open.fits.len();
            open.fits.push((taken.name, &selection.fit));
            for rival in rivals.into_iter().take(MOST_RIVALS) {
                open.both_ways(first, (rival.name, &rival.fit));
            }
        }
        if open.fits.is_empty() {
            for attempt in &selection.refused_fits {
                open.fits.push((attempt.name, &attempt.fit));
            }
            let n = open.fits.len();
            open.pairs = (0..n * n).map(|ij| (ij / n, ij % n)).filter(|(i, j)| i != j).collect();
        }
        open
    }

    /// Either may be the truth.
    fn both_ways(&mut self, first: usize, rival: (&'static str, &'a Fit)) {
        let other = self.fits.len();
        self.fits.push(rival);
        self.pairs.extend([(first, other), (other, first)]);
    }

    fn names(&self) -> Vec<&'static str> {
        let mut names: Vec<&'static str> = Vec::new();
        for (name, _) in &self.fits {
            if !names.contains(name) {
                names.push(name);
            }
        }
        names
    }

    /// λ of the closest pair when `problem` is measured too, by so many steps of the refit.
    fn closest_chi2(&self, problem: Option<&Problem>, steps: usize, desk: &mut Desk) -> f64 {
        let views: Vec<View> = self.fits.iter().map(|(_, fit)| View::new(fit, problem, desk)).collect();
        self.pairs
            .iter()
            .map(|(truth, other)| {
                separation_chi2((self.fits[*truth].1, &views[*truth]), (self.fits[*other].1, &views[*other], problem), steps, desk)
            })
            .fold(f64::INFINITY, f64::min)
    }
}

/// An item with what it would tell.
struct Rated {
    item: MenuItem,
    problem: Problem,
    lambda: f64,
}

impl Rated {
    /// Better first: what tells the pair apart, by λ per minute; among what does not, by λ.
    fn order(&self, other: &Self) -> std::cmp::Ordering {
        let (here, there) = (self.lambda >= ENOUGH, other.lambda >= ENOUGH);
        let per_minute = |r: &Self| r.lambda / r.item.duration_min();
        there.cmp(&here).then(if here && there {
            per_minute(other).total_cmp(&per_minute(self))
        } else {
            other.lambda.total_cmp(&self.lambda)
        })
    }
}

/// The run that tells what is open apart; none where nothing is open or no run of the menu would.
pub(super) fn recommend(
    prepared: &Prepared,
    verdict: Verdict,
    selection: &Selection,
    limits: Option<CurrentLimits>,
) -> Option<Recommended> {
    if !matches!(verdict, Verdict::Ambiguous | Verdict::Unexplained) {
        return None;
    }
    let campaign = Campaign::new(&prepared.problem, limits);
    let open = Open::new(selection);
    if open.pairs.is_empty() {
        // No names to tell apart: what changed by itself shows when the first run is repeated.
        return (verdict == Verdict::Unexplained).then(|| sentinel_repeat(&campaign)).flatten().map(|item| told(item, &open, (0.0, 0.0)));
    }
    let mut desk = Desk::default();
    let now = open.closest_chi2(None, STEPS, &mut desk);
    let mut rated: Vec<Rated> = menu(&campaign)
        .into_iter()
        .filter_map(|item| {
            let problem = prepared.planned(&item.runs, &mut desk).ok()?;
            let lambda = open.closest_chi2(Some(&problem), 1, &mut desk);
            Some(Rated { item, problem, lambda })
        })
        .collect();
    rated.sort_by(Rated::order);
    rated.truncate(REFINED);
    rated.iter_mut().for_each(|r| r.lambda = open.closest_chi2(Some(&r.problem), STEPS, &mut desk));
    rated.sort_by(Rated::order);
    let best = rated.into_iter().next().filter(|r| r.lambda >= now + LEAST_GROWTH)?;
    Some(told(best.item, &open, (best.lambda, now)))
}

fn told(item: MenuItem, open: &Open<'_>, (lambda, now): (f64, f64)) -> Recommended {
    let next = NextExperiment {
        name: item.name,
        duration_min: item.duration_min(),
        charge_ah: item.charge_ah(),
        description: item.description,
        separates: open.names(),
        separation_sigma: lambda.sqrt(),
        separation_now_sigma: now.sqrt(),
    };
    (next, item.runs)
}

#[cfg(test)]
mod tests;
