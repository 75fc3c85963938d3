//! The solution of a fit with its weights.

use super::design::Design;
use super::kinetics;
use super::options::{MapFitError, MapOptions};
use super::score;
use super::solve::{Kinetics, Normal, Solved};
use super::train::Train;
use analysis_model::map::CellMap;

/// Solutions of a bent map before the last one: the weights or the data have changed.
const SOLUTIONS_BEFORE: usize = 2;

/// The unknowns, their equations and the minimiser.
pub(super) struct Solution {
    pub(super) design: Design,
    pub(super) kinetics: Kinetics,
    pub(super) equations: Normal,
    pub(super) solved: Solved,
}

impl Solution {
    /// Fits the data twice: the second time by the errors that the first one leaves, which are written
    /// into the data with the lag of the logs.
    pub(super) fn search(train: &mut Train, options: &MapOptions) -> Result<Self, MapFitError> {
        let design = Design::new(train, &[], options)?;
        let (kinetics, first) = kinetics::search(&design, train)?;
        let map = design.map(&kinetics, &first);
        let of_train = train.logs.iter();
        let residuals: Vec<Vec<f64>> = of_train
            .map(|log| score::residuals(&map, log, train.lag_s))
            .collect();
        let residuals: Vec<&Vec<f64>> = residuals.iter().collect();
        train.scales = score::scales(&map, train, &residuals, design.inductance_h(&first));
        Self::new(design, train, kinetics)
    }

    /// Fits the data with given kinetics, around the map of its own solution if that is bent.
    pub(super) fn new(
        design: Design,
        train: &Train,
        mut kinetics: Kinetics,
    ) -> Result<Self, MapFitError> {
        if kinetics.around.is_some() {
            for _ in 0..SOLUTIONS_BEFORE {
                let solved = design.solve(train, &kinetics)?;
                kinetics = kinetics::kinetics_at_solution(&design, &kinetics, &solved);
            }
        }
        let equations = design.equations(train, &kinetics);
        let solved = equations.solve(design.resistances(), None)?;
        Ok(Self {
            design,
            kinetics,
            equations,
            solved,
        })
    }

    /// Returns the map, without standard deviations.
    pub(super) fn map(&self) -> CellMap {
        self.design.map(&self.kinetics, &self.solved)
    }

    /// Inductance of the wiring in the spectra, H.
    pub(super) fn inductance_h(&self) -> f64 {
        self.design.inductance_h(&self.solved)
    }
}
