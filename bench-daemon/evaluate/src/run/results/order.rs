//! Choice among the orders that a run has fitted.

use analysis::fit::{Bounds, CellSweeps, ErmFit, OrderOptions, OrderSelection, select_order};

use bench_plan::config::Experiment;

/// The fitted models, and the choice of the order among several.
#[derive(Debug, Default)]
pub(super) struct FittedOrders {
    /// The models, one for each order.
    pub(super) fits: Vec<ErmFit>,
    /// The choice, if there are several models and one could be chosen.
    pub(super) selection: Option<OrderSelection>,
}

impl FittedOrders {
    /// Chooses one of several models by the sweeps that they were fitted to. Returns a warning if
    /// none could be chosen.
    pub(super) fn choose(
        fits: Vec<ErmFit>,
        cells: &[CellSweeps],
        experiment: &Experiment,
    ) -> (Self, Option<String>) {
        let alone = |fits| Self {
            fits,
            selection: None,
        };
        if fits.len() < 2 {
            return (alone(fits), None);
        }
        let sweeps: Vec<_> = cells.iter().flat_map(|cell| cell.sweeps.clone()).collect();
        let options = OrderOptions {
            most: experiment.fit.rc.iter().copied().max().unwrap_or(1),
            bounds: Bounds::for_spectra(&sweeps),
            seed: experiment.seed,
        };
        match select_order(cells, &options) {
            Ok(selection) => {
                let selection = Some(among(&fits, selection));
                (Self { fits, selection }, None)
            }
            Err(error) => (
                alone(fits),
                Some(format!("no model is recommended: {error}")),
            ),
        }
    }

    /// Returns the order of the recommended model.
    pub(super) fn recommended(&self) -> Option<usize> {
        match (&self.selection, self.fits.as_slice()) {
            (Some(selection), _) => Some(selection.recommended),
            (None, [only]) => Some(only.erm.branches.len()),
            _ => None,
        }
    }

    /// Returns the mark of a model in the summary: an arrow at the recommended one of several.
    pub(super) fn mark(&self, fit: &ErmFit) -> &'static str {
        match &self.selection {
            Some(selection) if selection.recommended == fit.erm.branches.len() => "→ ",
            Some(_) => "  ",
            None => "",
        }
    }

    /// Returns the recommendation with its first reason.
    pub(super) fn in_words(&self) -> Option<String> {
        let selection = self.selection.as_ref()?;
        let why = selection.reasons.first().map_or("", String::as_str);
        Some(format!("recommended: {} RC: {why}", selection.recommended))
    }
}

/// Replaces a recommended order that has no model by the fitted one with the least AICc.
fn among(fits: &[ErmFit], mut selection: OrderSelection) -> OrderSelection {
    let is_fitted = |rc: usize| fits.iter().any(|fit| fit.erm.branches.len() == rc);
    let wanted = selection.recommended;
    if is_fitted(wanted) {
        return selection;
    }
    let fitted = selection.rows.iter().filter(|row| is_fitted(row.rc));
    let best = fitted.min_by(|a, b| a.aicc.total_cmp(&b.aicc));
    if let Some(rc) = best.map(|row| row.rc) {
        let why = format!("{wanted} RC has no model, and {rc} RC has the least AICc of the others");
        selection.recommended = rc;
        selection.reasons.insert(0, why);
    }
    selection
}
