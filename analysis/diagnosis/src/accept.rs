//! Conditions that an addition must meet before it is named.

use super::attempts::{Attempt, is_outside};
use super::guards::beyond_formula;
use super::outcome::Evidence;
use super::problem::Fit;
use super::search::{Search, excess_z};
use crate::thresholds::{
    FORMULA_SHARE, GOOD_FIT_Z, INTEGRATION_PART, LEAST_LAMBDA, LEAST_SCORE, MATERIAL_SHARE,
};

/// Returns true if an attempt's gain shows that something is missing beside an effect that has
/// already gained `gained`.
pub(super) fn is_significant(attempt: &Attempt, gained: f64) -> bool {
    let penalty = attempt.lambda - attempt.score;
    beyond_formula(attempt.lambda, gained) - penalty >= LEAST_SCORE
}

impl Search<'_> {
    /// Returns the evidence for one member of an attempt's fit against the fit without it, which
    /// has already gained `gained` over the base. Returns the reason as an error if a check fails.
    pub(super) fn accept(
        &mut self,
        before: &Fit,
        gained: f64,
        attempt: &Attempt,
        member: usize,
    ) -> Result<Evidence, String> {
        let dof = self.problem.degrees_of_freedom(before);
        let (excess, remaining_z) = (
            before.chi2 - dof,
            excess_z(
                attempt.fit.chi2,
                self.problem.degrees_of_freedom(&attempt.fit),
            ),
        );
        let share = if excess > 0.0 {
            (attempt.lambda / excess).min(1.0)
        } else {
            1.0
        };
        if attempt.score < LEAST_SCORE {
            return Err(format!(
                "penalised gain {:.1}: expected at least {LEAST_SCORE}",
                attempt.score
            ));
        }
        if !is_significant(attempt, gained) {
            let percent = 100.0 * FORMULA_SHARE;
            return Err(format!(
                "penalised gain {:.1}, no more than {percent:.0} % of an effect can look like",
                attempt.score
            ));
        }
        if is_outside(attempt.name) {
            return Err("it is not an effect of the catalogue".to_owned());
        }
        let converged = [before, &attempt.fit]
            .iter()
            .all(|fit| fit.has_converged(attempt.lambda));
        if self.guards.convergence && !converged {
            return Err("its fit did not converge".to_owned());
        }
        if self.guards.material_share && share < MATERIAL_SHARE && remaining_z >= GOOD_FIT_Z {
            return Err(format!(
                "removes {:.0} % of the excess: expected at least {:.0} %",
                100.0 * share,
                100.0 * MATERIAL_SHARE
            ));
        }
        if self.guards.bound && attempt.fit.member_at_bound(member, self.problem.branches()) {
            return Err("a parameter lies at its bound".to_owned());
        }
        if attempt.lambda < LEAST_LAMBDA {
            return Err("its interval does not leave zero out".to_owned());
        }
        let held_out_change = self.held_out(before, &attempt.fit)?;
        let integration_error = self.integration_error(&attempt.fit);
        if self.guards.integration && integration_error > INTEGRATION_PART {
            return Err(format!(
                "integration is wrong by {integration_error:.2} of the floor: expected at most \
                {INTEGRATION_PART}"
            ));
        }
        Ok(Evidence {
            lambda: attempt.lambda,
            score: attempt.score,
            share_of_excess: share,
            held_out_change,
            integration_error,
        })
    }

    /// Returns the largest change of any whitened row when all steps are halved: the size of an
    /// integration error relative to noise of variance 1.
    pub(super) fn integration_error(&mut self, fit: &Fit) -> f64 {
        let mut worst: f64 = 0.0;
        for k in 0..self.problem.blocks.len() {
            let once = self.problem.predict(fit.at(), k, 1, &mut self.workspace);
            let halves = self.problem.predict(fit.at(), k, 2, &mut self.workspace);
            let change: Vec<f64> = once.iter().zip(&halves).map(|(a, b)| a - b).collect();
            let mut white = Vec::with_capacity(change.len());
            self.problem.whiteners[k].apply(&change, &mut white);
            worst = white.iter().fold(worst, |w, e| w.max(e.abs()));
        }
        worst
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::Structure;

    /// 3 % of an effect of λ = 10⁴ correspond to 9 of χ²: a second effect that gains 30 beside it
    /// may be no more than that, one that gains 100 is more.
    #[test]
    fn what_differs_from_a_formula_is_not_a_second_effect() {
        let fit = Fit {
            structure: Structure::default(),
            x: vec![],
            axes: vec![],
            chi2: 0.0,
            residuals: vec![],
            columns: vec![],
            promise: 0.0,
        };
        let attempt = |lambda: f64| Attempt {
            name: "rc_slow",
            fit: fit.clone(),
            lambda,
            score: lambda - 14.0,
            distinct: lambda - 14.0,
        };
        assert!(is_significant(&attempt(30.0), 0.0) && is_significant(&attempt(30.0), 100.0));
        assert!(!is_significant(&attempt(30.0), 1e4) && is_significant(&attempt(100.0), 1e4));
        assert!(!is_significant(&attempt(100.0), 1e6) && is_significant(&attempt(2000.0), 1e6));
    }
}
