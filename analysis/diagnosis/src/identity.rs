//! Identity of branches: identifies the branch that the given model lacks.

use super::problem::Fit;
use super::search::Search;

/// Name of the effect that is one branch more.
const BRANCH: &str = "rc_slow";

impl Search<'_> {
    /// Returns the fit such that its additional branch, if any, is the one that the given model
    /// lacks. The fit of the base may have left the position of one of its branches to the
    /// addition; the choice of the branch that is called the addition changes no prediction.
    pub(super) fn with_identity(&mut self, fit: Fit) -> Fit {
        let (structure, end) = (&fit.structure, 1 + 2 * self.problem.branches());
        let Some(member) = structure.members.iter().position(|m| m.name() == BRANCH) else {
            return fit;
        };
        let at = structure.first(member, self.problem.branches());
        let (strength, free) = (
            structure.members[member].parameters[0].typical,
            structure.members[member].free(),
        );
        if free != 2 || fit.x[at] <= 0.0 {
            return fit;
        }
        let mut branches: Vec<[f64; 2]> = pairs(&fit.x[1..end]);
        branches.push([(fit.x[at] * strength).ln(), fit.x[at + 1]]);
        branches.sort_by(|a, b| a[1].total_cmp(&b[1]));
        let given = pairs(&self.problem.start()[1..]);
        let away = |left_out: usize| -> f64 {
            let others = branches.iter().enumerate().filter(|(k, _)| *k != left_out);
            others
                .zip(&given)
                .map(|((_, b), g)| (b[1] - g[1]).abs())
                .sum()
        };
        let Some(added) = (0..branches.len()).min_by(|a, b| away(*a).total_cmp(&away(*b))) else {
            return fit;
        };
        let [ln_r, ln_tau] = branches.remove(added);
        let mut x = fit.x.clone();
        x[1..end].copy_from_slice(branches.as_flattened());
        (x[at], x[at + 1]) = (ln_r.exp() / strength, ln_tau);
        let inside = x
            .iter()
            .zip(&fit.axes)
            .all(|(x, a)| (a.lower..=a.upper).contains(x));
        if !inside || x == fit.x {
            return fit;
        }
        self.problem
            .fit_from(&fit.structure, x, fit.axes, &mut self.workspace)
    }
}

/// Logarithms of resistance and time constant, branch by branch.
fn pairs(x: &[f64]) -> Vec<[f64; 2]> {
    x.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect()
}
