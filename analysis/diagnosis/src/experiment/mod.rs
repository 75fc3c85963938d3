//! Recommends the next experiment: the planned runs that separate rivals best, and how well they do
//! it (discrimination designs, Hunter and Reiner 1965; Atkinson and Fedorov 1975).
//!
//! Not here: running the experiments. Reading order: `planned`, runs as data; `menu`, the abilities
//! of a bench; `separate`, λ of a pair; `open`, the pairs; here, the choice.

mod menu;
mod open;
pub(super) mod planned;
mod separate;

use crate::thresholds::{
    FEWEST_REPEATS, MOST_TIMES, REFINED_ITEMS, REFIT_STEPS, SECOND_RUNS, WORTH,
};
pub use planned::{BenchLimits, Planned, PlannedRun, Playable};

use super::block::Workspace;
use super::outcome::{NextExperiment, Verdict};
use super::prepare::Prepared;
use super::select::Selection;
use analysis_effects::effects::{self, find};
use menu::{Campaign, MenuItem, menu, sentinel_repeat};
use open::{Open, absences};

/// Recommendation, as text and as runs.
pub(super) type Recommended = (NextExperiment, Vec<PlannedRun>);

/// Advice on the next run, and on pairs that no run of the menu separates.
#[derive(Debug, Default)]
pub(super) struct Advice {
    pub(super) next: Option<Recommended>,
    /// Pairs of an effect and the one that imitates it in every run. The second is empty if a name
    /// would never become certain.
    pub(super) inseparable: Vec<[&'static str; 2]>,
}

impl Advice {
    /// Notes on the pairs that no run separates, and on the experiment outside the menu that would.
    pub(super) fn notes(&self) -> Vec<String> {
        let title = |name: &'static str| effects::title(name).unwrap_or(name);
        let note = |pair: &[&'static str; 2]| {
            let [truth, other] = *pair;
            if other.is_empty() {
                return format!(
                    "{}: its signal is too small for any run of the menu to make it certain",
                    title(truth)
                );
            }
            let would = find(truth).map_or("", |e| e.card().experiment);
            format!(
                "no run of the menu, however often it is repeated, separates {} from {}; required: \
                {would}",
                title(truth),
                title(other)
            )
        };
        self.inseparable.iter().map(note).collect()
    }
}

/// Item with the λ of each pair that it would give.
struct Rated {
    item: MenuItem,
    then: Vec<f64>,
}

/// Criteria by which runs are chosen.
struct Planner<'a> {
    prepared: &'a Prepared,
    open: Open<'a>,
    playable: Option<&'a Playable>,
}

impl Planner<'_> {
    fn allowed(&self, item: &MenuItem) -> bool {
        self.playable
            .is_none_or(|playable| playable(item.name, &item.runs))
    }

    /// Returns the best of some items, and the pairs that no item separates.
    fn choose(
        &mut self,
        items: Vec<MenuItem>,
        others: Vec<MenuItem>,
        workspace: &mut Workspace,
    ) -> Advice {
        let mut all: Vec<Rated> = items
            .into_iter()
            .filter_map(|item| self.rated(item, 1, workspace))
            .collect();
        // Runs that cannot be run here, or no longer, but would separate the pairs.
        let elsewhere: Vec<Rated> = others
            .into_iter()
            .filter_map(|item| self.rated(item, 1, workspace))
            .collect();
        let thens: Vec<&[f64]> = all
            .iter()
            .chain(&elsewhere)
            .map(|r| r.then.as_slice())
            .collect();
        let inseparable = self.open.leave_out(&thens, MOST_TIMES);
        all.sort_by(|a, b| self.order(a, b));
        let mut best: Vec<Rated> = all
            .iter()
            .take(REFINED_ITEMS)
            .filter_map(|first| self.repeated(first, workspace))
            .collect();
        best.sort_by(|a, b| self.order(a, b));
        let Some(mut best) = best.into_iter().next() else {
            return Advice {
                next: None,
                inseparable,
            };
        };
        if self.open.least(&best.then) < 1.0 {
            best = self.joined(&best, &all, workspace).unwrap_or(best);
        }
        let open = &self.open;
        let moved = open.moved(&best.then);
        let least = |lambdas: &[f64]| {
            moved
                .iter()
                .map(|k| lambdas[*k])
                .fold(f64::INFINITY, f64::min)
        };
        let expected = Separation {
            then: least(&best.then),
            now: least(&open.now),
        };
        let next = (!moved.is_empty()).then(|| {
            recommend_item(
                best.item,
                open.names(&moved),
                expected,
                open.all_settled(&best.then),
            )
        });
        Advice { next, inseparable }
    }

    fn rated(&self, item: MenuItem, steps: usize, workspace: &mut Workspace) -> Option<Rated> {
        let planned = self.prepared.planned(&item.runs, workspace).ok()?;
        let then = self.open.lambdas(Some(&planned), steps, workspace);
        Some(Rated { item, then })
    }

    /// Better first: what settles all that can be settled, by the least λ per minute; among what
    /// does not, by how far it does.
    fn order(&self, a: &Rated, b: &Rated) -> std::cmp::Ordering {
        let all = |r: &Rated| self.open.least(&r.then) >= 1.0;
        let worth = |r: &Rated| {
            if all(r) {
                self.open.least(&r.then) / r.item.duration_min()
            } else {
                self.open.settled(&r.then)
            }
        };
        all(b).cmp(&all(a)).then(worth(b).total_cmp(&worth(a)))
    }

    /// The item measured as often as it takes, as long as that brings something.
    fn repeated(&self, first: &Rated, workspace: &mut Workspace) -> Option<Rated> {
        let mut times = self.open.times(&self.open.now, &first.then, MOST_TIMES);
        while times > 1 && !self.allowed(&first.item.times(times)) {
            times /= 2;
        }
        let mut best = self.rated(first.item.times(times), REFIT_STEPS, workspace)?;
        while self.open.least(&best.then) < 1.0 && 2 * times <= MOST_TIMES {
            times *= 2;
            let Some(item) = Some(first.item.times(times)).filter(|item| self.allowed(item)) else {
                break;
            };
            let Some(more) = self.rated(item, REFIT_STEPS, workspace) else {
                break;
            };
            if self.open.settled(&more.then) < WORTH * self.open.settled(&best.then) {
                break;
            }
            best = more;
        }
        Some(best)
    }

    /// Returns the best item with a second one for the pairs that it leaves open, or `None` if that
    /// gains little.
    fn joined(&self, best: &Rated, all: &[Rated], workspace: &mut Workspace) -> Option<Rated> {
        let both = |other: &Rated| {
            let sum: Vec<f64> = best
                .then
                .iter()
                .zip(&other.then)
                .zip(&self.open.now)
                .map(|((a, b), now)| a + b - now)
                .collect();
            self.open.settled(&sum)
        };
        let mut seconds: Vec<&Rated> = all
            .iter()
            .filter(|other| best.item.joins(&other.item))
            .collect();
        seconds.sort_by(|a, b| both(b).total_cmp(&both(a)));
        let mut found: Vec<Rated> = Vec::new();
        for second in seconds.into_iter().take(SECOND_RUNS) {
            let times = self.open.times(&best.then, &second.then, MOST_TIMES);
            let item = best.item.and(&second.item.times(times));
            if self.allowed(&item) {
                found.extend(self.rated(item, REFIT_STEPS, workspace));
            }
        }
        found.sort_by(|a, b| self.order(a, b));
        let enough = WORTH * self.open.settled(&best.then);
        found
            .into_iter()
            .next()
            .filter(|f| self.open.least(&f.then) >= 1.0 || self.open.settled(&f.then) >= enough)
    }
}

/// Returns the runs that separate the open structures. The advice is empty if nothing is open or no
/// available run of the menu would separate them.
pub(super) fn recommend(
    prepared: &Prepared,
    verdict: Verdict,
    selection: &Selection,
    limits: Option<BenchLimits>,
    playable: Option<&Playable>,
) -> Advice {
    if !verdict.is_open() {
        return Advice::default();
    }
    let campaign = Campaign::new(&prepared.problem, limits);
    let mut workspace = Workspace::default();
    let without = absences(&prepared.problem, selection, &mut workspace);
    let open = Open::new(
        prepared.estimate.repeats >= FEWEST_REPEATS,
        verdict,
        &without,
        selection,
        &mut workspace,
    );
    let mut planner = Planner {
        prepared,
        open,
        playable,
    };
    if planner.open.pairs.is_empty() {
        // Without names to separate, a repeat of the first run shows what changed on its own.
        let next = sentinel_repeat(&campaign)
            .filter(|item| planner.allowed(item))
            .map(|item| recommend_item(item, Vec::new(), Separation::default(), false));
        return Advice {
            next,
            inseparable: Vec::new(),
        };
    }
    let (mut items, others): (Vec<MenuItem>, Vec<MenuItem>) = menu(&campaign)
        .into_iter()
        .partition(|item| planner.allowed(item));
    items.dedup_by(|later, first| later.name == first.name);
    planner.choose(items, others, &mut workspace)
}

/// The least λ of the pairs that a run brings forward.
#[derive(Debug, Clone, Copy, Default)]
struct Separation {
    /// With the run measured too.
    then: f64,
    /// In the present data.
    now: f64,
}

fn recommend_item(
    item: MenuItem,
    separates: Vec<&'static str>,
    expected: Separation,
    settles: bool,
) -> Recommended {
    let next = NextExperiment {
        name: item.name,
        duration_min: item.duration_min(),
        charge_ah: item.charge_ah(),
        description: item.description,
        separates,
        separation_sigma: expected.then.sqrt(),
        separation_now_sigma: expected.now.sqrt(),
        settles,
    };
    (next, item.runs)
}

#[cfg(test)]
mod tests;
