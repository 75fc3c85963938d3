//! Selection of effects: adds them one by one, each only if all guards accept it, and removes those
//! that later ones make needless.

use super::accept::is_significant;
use super::attempts::{Attempt, is_outside};
use super::guards::outside_lead;
use super::outcome::{Candidate, Evidence};
use super::problem::Fit;
use super::search::Search;
use crate::thresholds::{
    DEEPER_CHI2, FREED_SHAPE_CHI2, MOST_EFFECTS, MOST_REFUSED, MOST_RESTARTS, NAMING_LEAD,
    OUTSIDE_ALONE,
};
use analysis_effects::effects::title;

/// An effect that was taken.
#[derive(Debug, Clone)]
pub(super) struct SelectedEffect {
    pub(super) name: &'static str,
    pub(super) evidence: Evidence,
    pub(super) rivals: Vec<RivalFit>,
    /// Effects that become this one at a limit, and that these data cannot separate from it.
    pub(super) limit_of: Vec<&'static str>,
}

impl SelectedEffect {
    /// Creates an effect whose rivals have not been searched for yet.
    pub(super) fn new(name: &'static str, evidence: Evidence) -> Self {
        Self {
            name,
            evidence,
            rivals: Vec::new(),
            limit_of: Vec::new(),
        }
    }
}

/// Rival: an effect that explains the data as well in place of a selected one.
#[derive(Debug, Clone)]
pub(super) struct RivalFit {
    pub(super) name: &'static str,
    pub(super) score_gap: f64,
    pub(super) discriminability: f64,
    pub(super) fit: Fit,
}

/// A better fit that was refused while a worse one was accepted, and the state of the search at
/// that time.
struct BetterRefused {
    /// Gain of all names together that it takes to go on.
    least: f64,
    fit: Fit,
    selected: Vec<SelectedEffect>,
    refused: (&'static str, f64, String),
}

/// Result of the search.
#[derive(Debug, Clone)]
pub(super) struct Selection {
    /// The base alone, at the deepest minimum that was met.
    pub(super) base: Fit,
    pub(super) fit: Fit,
    pub(super) selected: Vec<SelectedEffect>,
    /// Candidates of the first round.
    pub(super) ranking: Vec<Candidate>,
    /// Their fits, best score first.
    pub(super) first_attempts: Vec<Attempt>,
    /// The best addition that was refused in the last round, with the reason.
    pub(super) refused: Option<(&'static str, f64, String)>,
    /// The best that were refused in the last round.
    pub(super) refused_fits: Vec<Attempt>,
    /// Title of a formula outside the catalogue that explains the data better than every effect of
    /// it; all names are withdrawn then.
    pub(super) outside: Option<&'static str>,
    /// Reason why the names are not certain although none has a rival.
    pub(super) doubt: Option<String>,
}

impl Selection {
    /// Nothing was looked for.
    pub(super) fn nothing(base: &Fit) -> Self {
        Self {
            base: base.clone(),
            fit: base.clone(),
            selected: Vec::new(),
            ranking: Vec::new(),
            first_attempts: Vec::new(),
            refused: None,
            refused_fits: Vec::new(),
            outside: None,
            doubt: None,
        }
    }

    /// Returns the place of a named effect among the members of its fit: those of the base come
    /// first.
    pub(super) fn member(&self, selected: usize) -> usize {
        self.base.structure.members.len() + selected
    }

    /// Takes all names back: something outside the catalogue does better.
    fn withdraw(&mut self, title: &'static str) {
        self.fit = self.base.clone();
        self.selected.clear();
        self.outside = Some(title);
    }
}

impl Search<'_> {
    /// Adds and prunes, from the base's fit.
    pub(super) fn run(&mut self, base: &Fit) -> Selection {
        let mut selection = Selection::nothing(base);
        // The best effect outside the catalogue, on top of the base.
        let mut alone: Option<(&'static str, f64)> = None;
        self.add(&mut selection, &mut alone);
        self.gate_again(&mut selection);
        if self.in_place_of_several(&mut selection) {
            // Further effects may now gain on top of the single one.
            self.add(&mut selection, &mut alone);
            self.gate_again(&mut selection);
        }
        self.find_rivals(&mut selection);
        self.free_shapes(&mut selection);
        self.withdraw_what_predicts_worse(&mut selection);
        self.look_outside(&mut selection, alone);
        selection
    }

    /// Adds effects one by one, as long as one is accepted.
    fn add(&mut self, selection: &mut Selection, alone: &mut Option<(&'static str, f64)>) {
        let mut restarts = 0;
        let mut better: Option<BetterRefused> = None;
        while selection.selected.len() < MOST_EFFECTS {
            let (attempts, mut ranking) = self.attempts(&selection.fit, None);
            let first = selection.selected.is_empty();
            if first {
                *alone = attempts
                    .iter()
                    .find(|a| is_outside(a.name))
                    .map(|a| (a.name, a.score));
                selection.first_attempts.clone_from(&attempts);
            }
            let accepted = self.first_accepted(selection, attempts, &mut ranking);
            if first {
                if let Some((selected, _)) = &accepted {
                    let rest = ranking
                        .iter_mut()
                        .filter(|c| c.name != selected.name && c.refused_because.is_empty());
                    rest.for_each(|c| c.refused_because = "another explains more".to_owned());
                }
                selection.ranking = ranking;
            }
            let Some((attempt, evidence)) = accepted else {
                break;
            };
            if let Some(deeper) = self
                .deeper(&selection.fit, &attempt.fit)
                .filter(|_| restarts < MOST_RESTARTS)
            {
                restarts += 1;
                if first {
                    selection.base = deeper.clone();
                }
                selection.fit = deeper;
                continue;
            }
            // A better fit that may not be named leaves no name with confidence, unless it was
            // refused because this effect was missing.
            let beats = |r: &mut (_, f64, _)| r.1 > attempt.score + NAMING_LEAD;
            if let Some(refused) = selection.refused.take_if(beats) {
                if better.is_some() {
                    selection.refused = Some(refused);
                    break;
                }
                better = Some(BetterRefused {
                    least: self.gained(selection) + refused.1 + NAMING_LEAD,
                    fit: selection.fit.clone(),
                    selected: selection.selected.clone(),
                    refused,
                });
            }
            selection.refused = None;
            selection.fit = attempt.fit;
            let name = attempt.name;
            selection.selected.push(SelectedEffect::new(name, evidence));
        }
        if let Some(better) = better {
            let is_named = selection
                .selected
                .iter()
                .any(|s| s.name == better.refused.0);
            if !is_named || self.gained(selection) < better.least {
                selection.fit = better.fit;
                selection.selected = better.selected;
                selection.refused = Some(better.refused);
            }
        }
    }

    /// Returns the best attempt that passes all checks; better attempts are noted with the reason
    /// for their refusal.
    fn first_accepted(
        &mut self,
        selection: &mut Selection,
        attempts: Vec<Attempt>,
        ranking: &mut [Candidate],
    ) -> Option<(Attempt, Evidence)> {
        selection.refused = None;
        selection.refused_fits.clear();
        for attempt in attempts {
            let attempt = self.integrated(&selection.fit, attempt);
            let last = attempt.fit.structure.members.len() - 1;
            let gained = selection.base.chi2 - selection.fit.chi2;
            let reason = match self.accept(&selection.fit, gained, &attempt, last) {
                Ok(evidence) => return Some((attempt, evidence)),
                Err(reason) => reason,
            };
            let is_significant = is_significant(&attempt, gained);
            if is_significant && selection.refused.is_none() {
                selection.refused = Some((attempt.name, attempt.score, reason.clone()));
            }
            if let Some(c) = ranking.iter_mut().find(|c| c.name == attempt.name) {
                c.refused_because = reason;
            }
            if is_significant && selection.refused_fits.len() < MOST_REFUSED {
                selection.refused_fits.push(attempt);
            }
        }
        None
    }

    /// Repeats the fit from the parameters at which an addition has left them; returns `None` if
    /// that does not reach a deeper minimum. The gain of an addition over a fit in a wrong minimum
    /// is not evidence for the addition.
    fn deeper(&mut self, fit: &Fit, with: &Fit) -> Option<Fit> {
        let again = self.problem.fit_from(
            &fit.structure,
            with.x[..fit.x.len()].to_vec(),
            fit.axes.clone(),
            &mut self.workspace,
        );
        (again.chi2 < fit.chi2 - DEEPER_CHI2).then_some(again)
    }

    /// Takes back effects that later ones have made needless: all that spoke for each must still
    /// do.
    fn gate_again(&mut self, selection: &mut Selection) {
        let mut k = 0;
        while selection.selected.len() > 1 && k < selection.selected.len() {
            let at = selection.member(k);
            let without = self.refit_without(&selection.base, &selection.fit, at);
            let lambda = without.chi2 - selection.fit.chi2;
            let score = lambda - self.problem.penalty(&selection.fit.structure.members[at]);
            let attempt = Attempt {
                name: selection.selected[k].name,
                lambda,
                score,
                distinct: score,
                fit: selection.fit.clone(),
            };
            let gained = selection.base.chi2 - without.chi2;
            if let Ok(evidence) = self.accept(&without, gained, &attempt, at) {
                selection.selected[k].evidence = evidence;
                k += 1;
            } else {
                selection.fit = without;
                selection.selected.remove(k);
                k = 0;
            }
        }
    }

    /// Takes back names, the last first, until no held-out record is predicted worse than by the
    /// base. Each name was judged against the fit before it; together they may still mislead. What is
    /// taken back stays as a lead, with the reason.
    pub(super) fn withdraw_what_predicts_worse(&mut self, selection: &mut Selection) {
        while let Some(last) = selection.selected.last()
            && self.guards.held_out
            && let Err(reason) = self.no_record_worse(&selection.base, &selection.fit)
        {
            let (name, score) = (last.name, last.evidence.score);
            selection.refused = Some((name, score, reason));
            let at = selection.member(selection.selected.len() - 1);
            selection.fit = self.refit_without(&selection.base, &selection.fit, at);
            selection.selected.pop();
        }
    }

    /// Gain of all names together over the base, after the price of their parameters.
    pub(super) fn gained(&self, selection: &Selection) -> f64 {
        selection.base.chi2
            - selection.fit.chi2
            - self.problem.spent(&selection.base, &selection.fit)
    }

    /// Checks whether one effect outside the catalogue does as well as all names together, and
    /// whether a refused effect still leads.
    fn look_outside(&mut self, selection: &mut Selection, alone: Option<(&'static str, f64)>) {
        let gained = self.gained(selection);
        let led = |t: &SelectedEffect| {
            t.rivals
                .iter()
                .find(|r| is_outside(r.name) && r.score_gap >= outside_lead(t.evidence.lambda))
                .map(|r| r.name)
        };
        let beaten = selection.selected.iter().find_map(led);
        let refused = selection
            .refused
            .as_ref()
            .filter(|r| selection.selected.is_empty() && r.1 >= OUTSIDE_ALONE)
            .map(|r| r.0)
            .filter(|name| is_outside(name));
        let stands_alone = alone
            .filter(|a| selection.selected.len() > 1 && a.1 >= gained)
            .map(|a| a.0);
        if let Some(title) = beaten.or(stands_alone).or(refused).and_then(title) {
            selection.withdraw(title);
            return;
        }
        if let Some((name, score, _)) = &selection.refused {
            selection.doubt = Some(format!(
                "{} would gain {score:.0} on top of it but may not be named",
                title(name).unwrap_or(name)
            ));
        } else if let Some(title) = alone
            .filter(|a| selection.selected.len() > 1 && a.1 > gained - NAMING_LEAD)
            .and_then(|a| title(a.0))
        {
            selection.doubt = Some(format!("{title} alone would do as well"));
        }
    }

    /// Returns the fit with one member less, from the better of two starts: its present parameters,
    /// and the base.
    pub(super) fn refit_without(&mut self, base: &Fit, fit: &Fit, member: usize) -> Fit {
        let branches = self.problem.branches();
        let (structure, x, axes) = self.problem.without(fit, member);
        let mut y = base.x[..1 + 2 * branches].to_vec();
        y.extend_from_slice(&x[1 + 2 * branches..]);
        let stay = self
            .problem
            .fit_from(&structure, x, axes.clone(), &mut self.workspace);
        let fresh = self
            .problem
            .fit_from(&structure, y, axes, &mut self.workspace);
        if stay.chi2 <= fresh.chi2 { stay } else { fresh }
    }

    /// Frees the shapes that were held while effects were chosen, so that the intervals contain
    /// their uncertainty. They stay held where freeing drives one to a bound.
    fn free_shapes(&mut self, selection: &mut Selection) {
        let branches = self.problem.branches();
        let first = selection.member(0);
        for k in first..first + selection.selected.len() {
            let (erm, values) = selection.fit.decode(branches);
            let mut structure = selection.fit.structure.clone();
            for (member, value) in structure.members.iter_mut().zip(&values) {
                member.start.clone_from(value);
            }
            let own = structure.members[k].searched(&self.problem.base, &values[k]);
            if structure.members[k].parameters == own {
                continue;
            }
            structure.members[k].parameters = own;
            let free = self.problem.fit(&structure, &erm, &mut self.workspace);
            if !free.member_at_bound(k, branches)
                && free.chi2 <= selection.fit.chi2 + FREED_SHAPE_CHI2
            {
                selection.fit = free;
            }
        }
    }
}
