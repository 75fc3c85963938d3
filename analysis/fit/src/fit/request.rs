//! A fit of the extended Randles model as a user asks for it: perhaps with the order that the data
//! bear, and with what becomes of the charge storage.

use super::cells::CellSweeps;
use super::erm::fit_cells;
use super::options::{Bounds, FitError, FitOptions, Objective};
use super::order::{MOST_AUTO, OrderOptions, OrderSelection, select_order};
use super::result::ErmFit;
use super::slope::Slope;
use analysis_signal::spectrum::{SourcedSpectrum, Spectrum};

/// Options for the fit of one group of spectra.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErmRequest {
    /// Number of RC branches; `None` for the number that the data support.
    pub rc: Option<usize>,
    /// Objective to minimise.
    pub objective: Objective,
    /// Treatment of the charge storage.
    pub slope: Slope,
    /// Seed of the global search.
    pub seed: u64,
    /// More descents from random time constants.
    pub starts: usize,
}

/// A fit, and the choice of its order, if any.
#[derive(Debug, Clone, PartialEq)]
pub struct ErmAnswer {
    /// The fit.
    pub fit: ErmFit,
    /// Choice of the order.
    pub order: Option<OrderSelection>,
}

/// Spectra prepared for a fit: sorted by cell, without the share of the slope.
#[derive(Debug, Clone)]
pub struct Prepared {
    /// Sweeps by cell.
    pub cells: Vec<CellSweeps>,
    /// The same sweeps in the order in which they were given.
    pub spectra: Vec<Spectrum>,
}

impl Prepared {
    /// Takes the charge storage out and sorts by cell.
    pub fn of(sweeps: &[SourcedSpectrum], slope: Slope) -> Self {
        let sweeps: Vec<SourcedSpectrum> = sweeps
            .iter()
            .map(|sweep| SourcedSpectrum {
                spectrum: slope.less(&sweep.spectrum),
                ..sweep.clone()
            })
            .collect();
        Self {
            cells: CellSweeps::sort(&sweeps),
            spectra: sweeps.into_iter().map(|sweep| sweep.spectrum).collect(),
        }
    }

    /// The order that the data bear.
    ///
    /// # Errors
    /// As [`select_order`].
    pub fn select_order(&self, seed: u64) -> Result<OrderSelection, FitError> {
        let options = OrderOptions {
            most: MOST_AUTO,
            bounds: Bounds::for_spectra(&self.spectra),
            seed,
        };
        select_order(&self.cells, &options)
    }

    /// Fit of one order.
    ///
    /// # Errors
    /// As [`fit_cells`].
    pub fn fit(&self, rc: usize, request: &ErmRequest) -> Result<ErmFit, FitError> {
        let options = FitOptions {
            rc,
            objective: request.objective,
            bounds: Bounds::for_spectra(&self.spectra),
            seed: request.seed,
        };
        fit_cells(&self.cells, &options, request.starts)
    }
}

impl ErmRequest {
    /// Fits one model to spectra together.
    ///
    /// # Errors
    /// [`FitError`].
    pub fn fit(&self, sweeps: &[SourcedSpectrum]) -> Result<ErmAnswer, FitError> {
        let prepared = Prepared::of(sweeps, self.slope);
        let (rc, order) = match self.rc {
            Some(rc) => (rc, None),
            None => {
                let order = prepared.select_order(self.seed)?;
                (order.recommended, Some(order))
            }
        };
        let fit = prepared.fit(rc, self)?;
        Ok(ErmAnswer { fit, order })
    }
}
