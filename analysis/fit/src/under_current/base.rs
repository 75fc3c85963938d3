//! The sweeps at rest: their mean, their noise, their model, and how its resistances act.

use analysis_model::model::{Erm, RcBranch};
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;

use super::{
    options::{UnderCurrentError, UnderCurrentOptions},
    solve::{Data, Solution},
};
use crate::fit::{
    Bounds, CellSweeps, Components, FitOptions, FrequencySpread, Objective, fit_cells,
    frequency_spread, smooth_relative,
};

/// Least and largest number of branches that are tried: a fast and a slow one, which a current changes
/// differently.
const LEAST_RC: usize = 2;
const MOST_RC: usize = 4;
/// An order is large enough if its χ² exceeds the least of all orders by at most this share.
const ENOUGH: f64 = 0.1;

/// The sweeps at rest, and what follows from them.
pub(super) struct Base<'a> {
    pub(super) cells: &'a [CellSweeps],
    pub(super) spread: Vec<FrequencySpread>,
    /// Standard deviation of one sweep of a cell at each frequency, real and imaginary, Ω.
    noise_ohm: Vec<[f64; 2]>,
    pub(super) erm: Erm,
    /// Mean χ² per degree of freedom of the sweeps at rest.
    pub(super) chi2: f64,
}

impl<'a> Base<'a> {
    /// Fits the model to the sweeps at rest.
    pub(super) fn new(
        cells: &'a [CellSweeps],
        options: &UnderCurrentOptions,
    ) -> Result<Self, UnderCurrentError> {
        let spread = frequency_spread(cells);
        if cells.iter().all(|cell| cell.sweeps.len() < 2) {
            return Err(UnderCurrentError::NoRepeats);
        }
        let noise_ohm = noise_ohm(&spread);
        let spectra: Vec<Spectrum> = cells.iter().flat_map(|c| c.sweeps.clone()).collect();
        let bounds = Bounds::for_spectra(&spectra);
        let of = |rc: usize| -> Result<Self, UnderCurrentError> {
            let fit = FitOptions {
                rc,
                objective: Objective::Complex,
                bounds,
                seed: options.seed,
            };
            let mut base = Self {
                cells,
                spread: spread.clone(),
                noise_ohm: noise_ohm.clone(),
                erm: fit_cells(cells, &fit, 0)?.erm,
                chi2: f64::NAN,
            };
            let all: Vec<f64> = cells
                .iter()
                .flat_map(|c| &c.sweeps)
                .map(|s| base.chi2_of(s))
                .collect();
            base.chi2 = all.iter().sum::<f64>() / all.len() as f64;
            Ok(base)
        };
        if let Some(rc) = options.rc {
            return of(rc);
        }
        let most = MOST_RC
            .min(spread.len().saturating_sub(2) / 2)
            .max(LEAST_RC);
        let orders: Vec<Self> = (LEAST_RC..=most).map(of).collect::<Result<_, _>>()?;
        let least = orders
            .iter()
            .map(|base| base.chi2)
            .fold(f64::INFINITY, f64::min);
        let enough = |base: &Self| base.chi2.is_nan() || base.chi2 <= (1.0 + ENOUGH) * least;
        let found = orders.into_iter().find(enough);
        found.ok_or(UnderCurrentError::NoRepeats)
    }

    /// Number of resistances of the model.
    pub(super) fn resistances(&self) -> usize {
        1 + self.erm.branches.len()
    }

    /// Returns the mean impedance at rest, each cell counted once, Ω.
    pub(super) fn mean_ohm(&self, index: usize) -> Complex64 {
        let at = &self.spread[index];
        Complex64::new(at.re_ohm.mean, at.im_ohm.mean)
    }

    /// Returns the differences of a sweep from the mean, at the frequencies that it has; it may lack
    /// some.
    pub(super) fn differences(&self, sweep: &Spectrum) -> Vec<Option<Complex64>> {
        let of = |(index, at): (usize, &FrequencySpread)| {
            let near = |freq_hz: f64| (freq_hz - at.freq_hz).abs() <= 1e-6 * at.freq_hz;
            let point = sweep.points.iter().find(|p| near(p.freq_hz))?;
            Some(point.z_ohm - self.mean_ohm(index))
        };
        self.spread.iter().enumerate().map(of).collect()
    }

    /// Returns one frequency as the solver takes it: the difference, its noise, and the slope over the
    /// logarithm of each resistance; with `drift` also over what a drift of the record leaves in a fit of
    /// a sine, inversely proportional to the frequency, in phase and out of phase.
    pub(super) fn data(&self, index: usize, difference: Complex64, drift: bool) -> Data {
        let freq_hz = self.spread[index].freq_hz;
        let omega = std::f64::consts::TAU * freq_hz;
        let branch = |b: &RcBranch| {
            let shape = Complex64::new(1.0, omega * b.time_constant_s()).inv();
            b.r_ohm * shape * shape
        };
        let series = Complex64::new(self.erm.r_ohm, 0.0);
        let resistances = std::iter::once(series).chain(self.erm.branches.iter().map(branch));
        let lowest = self.mean_ohm(0).norm() * self.spread[0].freq_hz / freq_hz;
        let drifts = [Complex64::new(lowest, 0.0), Complex64::new(0.0, lowest)];
        Data {
            difference,
            noise: self.noise_ohm[index],
            slopes: resistances
                .chain(drifts.into_iter().filter(|_| drift))
                .collect(),
        }
    }

    /// Solves for the changes of a sweep from the frequency with this index on; the drift follows the
    /// resistances.
    pub(super) fn solve(
        &self,
        differences: &[Option<Complex64>],
        first: usize,
        drift: bool,
    ) -> Option<Solution> {
        let points = differences.iter().enumerate().skip(first);
        let data: Vec<Data> = points
            .filter_map(|(index, difference)| Some(self.data(index, (*difference)?, drift)))
            .collect();
        Solution::of(&data, self.resistances() + if drift { 2 } else { 0 })
    }

    fn chi2_of(&self, sweep: &Spectrum) -> f64 {
        self.solve(&self.differences(sweep), 0, false)
            .map_or(f64::NAN, |solution| solution.chi2)
    }

    /// Returns the changes of every sweep at rest by cell, for each resistance, computed as those of a
    /// sweep whose `low` lowest frequencies are left out.
    pub(super) fn at_rest(&self, low: usize) -> Vec<Vec<Vec<f64>>> {
        let of = |cell: &CellSweeps| -> Vec<Vec<f64>> {
            let solved =
                |s: &Spectrum| Some(self.solve(&self.differences(s), low, low > 0)?.shares);
            cell.sweeps.iter().filter_map(solved).collect()
        };
        let cells: Vec<Vec<Vec<f64>>> = self.cells.iter().map(of).collect();
        let of_one = |k: usize| {
            let values = |sweeps: &Vec<Vec<f64>>| sweeps.iter().map(|shares| shares[k]).collect();
            cells.iter().map(values).collect()
        };
        (0..self.resistances()).map(of_one).collect()
    }
}

/// Returns the standard deviation of repeats, averaged over neighbouring frequencies, Ω.
fn noise_ohm(spread: &[FrequencySpread]) -> Vec<[f64; 2]> {
    let part = |part: fn(&FrequencySpread) -> &Components| smooth_relative(spread, part);
    let (re, im) = (part(|f| &f.re_ohm), part(|f| &f.im_ohm));
    let size = |f: &FrequencySpread| f.re_ohm.mean.hypot(f.im_ohm.mean);
    spread
        .iter()
        .zip(re.into_iter().zip(im))
        .map(|(f, (re, im))| [re * size(f), im * size(f)])
        .collect()
}
