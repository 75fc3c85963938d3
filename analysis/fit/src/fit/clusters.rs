//! Groups of sweeps that scatter together. Sweeps of one cell share its making, its clamping and
//! its state, and are not independent.

use super::cells::CellSweeps;
use analysis_numeric::stats::t_factor;
use analysis_signal::spectrum::Spectrum;

/// Number of cells from which on their scatter is known to a tenth, so that the sigmas need no
/// remark.
const MANY: usize = 50;

/// Clusters of sweeps, for the scatter of the objective's gradient.
#[derive(Debug, Clone)]
pub(super) struct Clusters {
    /// The cluster of each sweep.
    of: Vec<usize>,
    /// Number of clusters.
    pub(super) count: usize,
    /// Number of cells, if they are known.
    cells: Option<usize>,
}

impl Clusters {
    /// Makes every sweep a cluster of its own, for unknown cells.
    pub(super) fn sweeps(count: usize) -> Self {
        Self {
            of: (0..count).collect(),
            count,
            cells: None,
        }
    }

    /// Returns the sweeps ordered by cell, and their clusters: the cells if two or more are known,
    /// otherwise the sweeps.
    pub(super) fn of_cells(cells: &[CellSweeps]) -> (Vec<Spectrum>, Self) {
        let spectra: Vec<Spectrum> = cells.iter().flat_map(|c| c.sweeps.clone()).collect();
        let known = cells.iter().all(|c| c.named) || cells.len() < spectra.len();
        let by_sweep = Self {
            cells: known.then_some(cells.len()),
            ..Self::sweeps(spectra.len())
        };
        if !known || cells.len() < 2 {
            return (spectra, by_sweep);
        }
        let of = cells
            .iter()
            .enumerate()
            .flat_map(|(k, c)| vec![k; c.sweeps.len()])
            .collect();
        (
            spectra,
            Self {
                of,
                count: cells.len(),
                ..by_sweep
            },
        )
    }

    pub(super) fn of(&self, sweep: usize) -> usize {
        self.of.get(sweep).copied().unwrap_or(0)
    }

    /// Two or more known cells.
    pub(super) fn cells(&self) -> Option<usize> {
        self.cells.filter(|cells| *cells > 1)
    }

    /// Returns whether the clusters determine the noise: known cells always do; sweeps do if there
    /// are more of them than parameters.
    pub(super) fn tell_noise(&self, parameters: usize) -> bool {
        self.cells().is_some() || self.count > parameters
    }

    /// Returns a remark on the reliability of the sigmas; `None` if the cells are not known.
    /// `absolute` is true if the sigmas come from stated covariances.
    pub(super) fn remark(&self, absolute: bool) -> Option<String> {
        let cells = self
            .cells
            .filter(|cells| *cells < MANY && self.of.len() > 1)?;
        if cells == 1 {
            return Some(
                "all sweeps are of one cell: the sigmas say how well that cell is known, \
            not how cells differ"
                    .to_owned(),
            );
        }
        if absolute {
            return Some(format!(
                "the sigmas come from the stated covariances, which describe the noise of sweeps \
                and not the differences between the {cells} cells"
            ));
        }
        let freedom = (cells - 1) as f64;
        Some(format!(
            "the sigmas rest on how only {cells} cells scatter: they are themselves known to about \
            {:.0} %, and a 95 % interval takes {:.2} sigma, not 1.96",
            100.0 / (2.0 * freedom).sqrt(),
            t_factor(0.95, freedom)
        ))
    }
}
