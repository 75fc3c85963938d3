//! The next experiment: which planned run tells rivals apart, and how well (discrimination designs, Hunter and Reiner 1965; Atkinson and Fedorov 1975).
//!
//! Not here: playing the run. Reading order: `planned`, runs as data; `menu`, what a bench can do; `separate`, λ of a pair; here, the choice.

mod menu;
mod planned;
mod separate;

pub use planned::{BenchLimits, Planned, PlannedRun, Playable};

use super::block::Desk;
use super::guards::{CERTAIN_LAMBDA, naming_lead};
use super::outcome::{NextExperiment, Verdict};
use super::prepare::Prepared;
use super::problem::{Fit, Problem};
use super::select::{RivalFit, Selection};
use crate::effects::find;
use menu::{Campaign, MenuItem, menu, sentinel_repeat};
use separate::{View, separation_chi2};

/// Quantile of the normal distribution that a plan allows for: what is expected to settle fails in one of twenty.
const ONE_IN_TWENTY: f64 = 1.645;
/// An effect is taken for no weaker than this part of the strength that was found.
const WEAKEST: f64 = 0.4;
/// How many times as often as the menu says a run may be measured, where less does not settle what is open.
const REPEATS: [usize; 4] = [1, 2, 4, 8];
/// What a run must add to a pair's λ, as a part of what settles it, to be worth its time.
const LEAST_GROWTH: f64 = 0.1;
/// Rivals of one effect that are looked at, the closest ones.
const MOST_RIVALS: usize = 6;
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

impl<'a> Open<'a> {
    /// Each named effect against its closest rivals, and against nothing where it is too weak to be certain; without any of these what was refused last.
    fn new((problem, measured): (&Problem, bool), verdict: Verdict, base: &'a Fit, selection: &'a Selection) -> Self {
        let mut open = Self { fits: Vec::new(), pairs: Vec::new() };
        let cost = |fit: &Fit| fit.structure.members.iter().map(|m| problem.penalty(m)).sum::<f64>();
        for taken in &selection.taken {
            let found = taken.evidence.lambda;
            let lead = naming_lead(measured, found);
            let named = open.add(taken.name, &selection.fit);
            let mut rivals: Vec<&RivalFit> = taken.rivals.iter().collect();
            rivals.sort_by(|a, b| b.score_gap.total_cmp(&a.score_gap));
            for rival in rivals.into_iter().take(MOST_RIVALS) {
                let other = open.add(rival.name, &rival.fit);
                let dearer = cost(&rival.fit) - cost(&selection.fit);
                // What contains the named effect as a limit imitates it whatever is measured: it has to show that it is more.
                if !find(rival.name).is_some_and(|e| e.card().contains.contains(&taken.name)) {
                    open.pairs.push(Pair { truth: named, other, enough: enough(lead - dearer, found) });
                }
                open.pairs.push(Pair { truth: other, other: named, enough: enough(lead + dearer, found) });
            }
            let weak = selection.taken.len() == 1 && found < CERTAIN_LAMBDA;
            if verdict == Verdict::Ambiguous && weak {
                let other = open.add("", base);
                open.pairs.push(Pair { truth: named, other, enough: enough(CERTAIN_LAMBDA, found) });
            }
        }
        if open.pairs.is_empty() {
            open.refused(selection, measured);
        }
        open
    }

    /// What was refused last, among itself; a single one against what was taken before it.
    fn refused(&mut self, selection: &'a Selection, measured: bool) {
        self.fits = selection.refused_fits.iter().map(|a| (a.name, &a.fit)).collect();
        let needed: Vec<f64> = selection.refused_fits.iter().map(|a| enough(naming_lead(measured, a.lambda), a.lambda)).collect();
        let n = self.fits.len();
        if n == 1 {
            let other = self.add("", &selection.fit);
            self.pairs.push(Pair { truth: 0, other, enough: needed[0] });
            return;
        }
        let all = (0..n * n).map(|ij| (ij / n, ij % n)).filter(|(i, j)| i != j);
        self.pairs = all.map(|(truth, other)| Pair { truth, other, enough: needed[truth] }).collect();
    }

    fn add(&mut self, name: &'static str, fit: &'a Fit) -> usize {
        self.fits.push((name, fit));
        self.fits.len() - 1
    }

    /// λ of every pair when planned runs are measured too, by so many steps of the refits.
    fn lambdas(&self, planned: Option<&Problem>, steps: usize, desk: &mut Desk) -> Vec<f64> {
        let views: Vec<View> = self.fits.iter().map(|(_, fit)| View::new(fit, planned, desk)).collect();
        let lambda = |p: &Pair, desk: &mut Desk| {
            let other = (self.fits[p.other].1, &views[p.other], planned);
            separation_chi2((self.fits[p.truth].1, &views[p.truth]), other, steps, desk)
        };
        self.pairs.iter().map(|p| lambda(p, desk)).collect()
    }

    /// How far a pair is settled, 0…1.
    fn part(&self, pair: usize, lambdas: &[f64]) -> f64 {
        (lambdas[pair] / self.pairs[pair].enough).min(1.0)
    }

    /// The same of all pairs together.
    fn settled(&self, lambdas: &[f64]) -> f64 {
        (0..self.pairs.len()).map(|k| self.part(k, lambdas)).sum::<f64>() / self.pairs.len() as f64
    }

    /// Pairs that a run brings forward.
    fn moved(&self, now: &[f64], then: &[f64]) -> Vec<usize> {
        (0..self.pairs.len()).filter(|k| self.part(*k, then) >= self.part(*k, now) + LEAST_GROWTH).collect()
    }

    /// Effects of some pairs.
    fn names(&self, pairs: &[usize]) -> Vec<&'static str> {
        let mut names: Vec<&'static str> = Vec::new();
        for k in pairs.iter().flat_map(|k| [self.pairs[*k].truth, self.pairs[*k].other]) {
            let name = self.fits[k].0;
            if !name.is_empty() && !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }
}

/// λ that a pair must be expected to have for χ² to differ by `need` in all but one of twenty cases: λ scatters by 2√λ, and the effect may be weaker than
/// the `found` λ says, whose root scatters by one.
fn enough(need: f64, found: f64) -> f64 {
    let root = ONE_IN_TWENTY + (ONE_IN_TWENTY * ONE_IN_TWENTY + need.max(0.0)).sqrt();
    (root / (1.0 - ONE_IN_TWENTY / found.max(1.0).sqrt()).max(WEAKEST)).powi(2)
}

/// An item with what it would tell: λ of each pair.
struct Rated {
    item: MenuItem,
    then: Vec<f64>,
    /// How far it settles the pairs, 0…1.
    settled: f64,
    /// Least λ of any pair, as a part of what settles it.
    least: f64,
}

impl Rated {
    fn new((item, planned): (MenuItem, Problem), open: &Open<'_>, steps: usize, desk: &mut Desk) -> Self {
        let then = open.lambdas(Some(&planned), steps, desk);
        let settled = open.settled(&then);
        let least = then.iter().zip(&open.pairs).map(|(l, p)| l / p.enough).fold(f64::INFINITY, f64::min);
        Self { item, then, settled, least }
    }

    /// Better first: what settles all pairs, by the least λ per minute; among what does not, by how far it does.
    fn order(&self, other: &Self) -> std::cmp::Ordering {
        let all = |r: &Self| r.least >= 1.0;
        let worth = |r: &Self| if all(r) { r.least / r.item.duration_min() } else { r.settled };
        all(other).cmp(&all(self)).then(worth(other).total_cmp(&worth(self)))
    }
}

/// The run that tells what is open apart; none where nothing is open or no run of the menu that can be played would.
pub(super) fn recommend(
    prepared: &Prepared,
    verdict: Verdict,
    (base, selection): (&Fit, &Selection),
    (limits, playable): (Option<BenchLimits>, Option<&Playable>),
) -> Option<Recommended> {
    if !matches!(verdict, Verdict::Ambiguous | Verdict::Unexplained) {
        return None;
    }
    let campaign = Campaign::new(&prepared.problem, limits);
    let open = Open::new((&prepared.problem, prepared.estimate.repeats >= 3), verdict, base, selection);
    let allowed = |item: &MenuItem| playable.is_none_or(|playable| playable(item.name, &item.runs));
    if open.pairs.is_empty() {
        // No names to tell apart: what changed by itself shows when the first run is repeated.
        return sentinel_repeat(&campaign).filter(allowed).map(|item| told(item, Vec::new(), (0.0, 0.0), false));
    }
    let mut desk = Desk::default();
    let now = open.lambdas(None, 1, &mut desk);
    let rated = |item: MenuItem, steps: usize, desk: &mut Desk| {
        let planned = prepared.planned(&item.runs, desk).ok()?;
        Some(Rated::new((item, planned), &open, steps, desk))
    };
    let mut items: Vec<MenuItem> = menu(&campaign).into_iter().filter(allowed).collect();
    items.dedup_by(|later, first| later.name == first.name);
    let mut all: Vec<Rated> = items.into_iter().filter_map(|item| rated(item, 1, &mut desk)).collect();
    all.sort_by(Rated::order);
    let mut best: Vec<Rated> = Vec::new();
    for first in all.into_iter().take(REFINED) {
        let mut settled = f64::NEG_INFINITY;
        for item in REPEATS.map(|times| first.item.times(times)).into_iter().filter(allowed) {
            let Some(more) = rated(item, STEPS, &mut desk).filter(|r| r.least >= 1.0 || r.settled >= settled + LEAST_GROWTH) else { break };
            settled = more.settled;
            let enough = more.least >= 1.0;
            best.push(more);
            if enough {
                break;
            }
        }
    }
    best.sort_by(Rated::order);
    let best = best.into_iter().next()?;
    let moved = open.moved(&now, &best.then);
    let least = |lambdas: &[f64]| moved.iter().map(|k| lambdas[*k]).fold(f64::INFINITY, f64::min);
    (!moved.is_empty()).then(|| told(best.item, open.names(&moved), (least(&best.then), least(&now)), best.least >= 1.0))
}

fn told(item: MenuItem, separates: Vec<&'static str>, (then, now): (f64, f64), settles: bool) -> Recommended {
    let next = NextExperiment {
        name: item.name,
        duration_min: item.duration_min(),
        charge_ah: item.charge_ah(),
        description: item.description,
        separates,
        separation_sigma: then.sqrt(),
        separation_now_sigma: now.sqrt(),
        settles,
    };
    (next, item.runs)
}

#[cfg(test)]
mod tests;
