//! Result of a campaign over benches: components of variance of the fitted resistances, the offset
//! of each bench, and each cell corrected for them.
//!
//! The logarithm of a value is the mean + batch + cell + bench + rest; each term except the mean
//! has its own variance (`analysis::mixed`). The stated uncertainty of a fit is not used, because a
//! misfit of the model and an error of the controls are equal in all values and do not scatter. The
//! rest is the difference between repeats.

use std::collections::{BTreeMap, BTreeSet};

use analysis::{
    catalog::{
        Catalog, CatalogError,
        query::Filter,
        record::{CatalogFit, CatalogRun, CatalogVerdict},
    },
    mixed::{Component, Factor, Grouped, Level, Mixed, MixedError, fit_mixed},
    numeric::stats::normal_tail,
    validity::tail::holm,
};
use serde::Serialize;

/// Chance that any cell or bench of a campaign without outliers is named as one.
const FALSE_ALARM: f64 = 0.01;

/// Reason why a report cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The catalogue.
    #[error(transparent)]
    Catalog(#[from] CatalogError),
    /// No fit of the campaign.
    #[error(
        "expected finished runs of the experiment {campaign:?} with fitted models of {rc} RC pairs in \
        the catalogues, found none; orders that are there: {orders}{left_out}"
    )]
    None {
        /// The campaign.
        campaign: String,
        /// Requested order.
        rc: String,
        /// Orders that are there.
        orders: String,
        /// Runs that were left out, as text.
        left_out: String,
    },
    /// One quantity.
    #[error("{quantity}: {source}")]
    Mixed {
        /// Its name.
        quantity: &'static str,
        /// Reason.
        source: MixedError,
    },
}

/// A component of variance, as a share of the value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Spread {
    /// `cell`, `batch`, `bench`, or `residual` for what repeats of one cell on one bench differ by.
    pub name: String,
    /// Number of its levels.
    pub levels: usize,
    /// Standard deviation, as a share.
    pub sd: f64,
    /// Ends of its 95 % interval; the upper one is `None` if it is unbounded.
    pub low: f64,
    /// Upper end.
    pub high: Option<f64>,
}

/// Offset of a bench.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchOffset {
    /// The bench.
    pub bench: String,
    /// Number of values from it.
    pub values: usize,
    /// By how much it reads too high, as a share.
    pub offset: f64,
    /// Standard deviation of that.
    pub sigma: f64,
    /// It does not belong to the others.
    pub is_outlier: bool,
}

/// A cell, corrected for its benches.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CorrectedCell {
    /// The cell.
    pub cell: String,
    /// Its batch, if known.
    pub batch: Option<String>,
    /// Number of its values.
    pub values: usize,
    /// Mean of its values as measured.
    pub measured: f64,
    /// Mean of its values, each divided by the offset of its bench.
    pub corrected: f64,
    /// Standard deviation of that.
    pub sigma: f64,
    /// Deviation of the cell in standard deviations of such deviations.
    pub z: f64,
    /// It does not belong to the others.
    pub is_outlier: bool,
}

/// One quantity over the campaign.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quantity {
    /// Its name.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Geometric mean over the cells.
    pub mean: f64,
    /// Its standard deviation.
    pub mean_sigma: f64,
    /// Components of variance.
    pub spread: Vec<Spread>,
    /// The benches.
    pub benches: Vec<BenchOffset>,
    /// The cells.
    pub cells: Vec<CorrectedCell>,
}

/// Runs of a campaign that were left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Why.
    pub why: &'static str,
    /// Number of them.
    pub runs: usize,
}

/// Result of a campaign.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CampaignReport {
    /// Its name.
    pub campaign: String,
    /// Number of RC pairs of its models.
    pub rc: u32,
    /// Number of values.
    pub values: usize,
    /// Runs that were left out, by reason.
    pub left_out: Vec<LeftOut>,
    /// The quantities.
    pub quantities: Vec<Quantity>,
}

/// Runs that are used, with their models, and runs that are not.
#[derive(Debug, Default)]
struct Chosen {
    fits: Vec<CatalogFit>,
    left_out: BTreeMap<&'static str, usize>,
    /// Contents of the runs that count.
    contents: BTreeSet<String>,
}

const DAMAGED: &str = "damaged";
const FAILED: &str = "failed";
const UNFINISHED: &str = "unfinished";
const MISSING: &str = "their folders are missing";
const TWICE: &str = "the same as another one, by their hashes";
const SEVERAL: &str = "their models are of several cells together";
const WITHOUT: &str = "without a fitted model";

impl Chosen {
    /// Takes the runs of a campaign from a catalogue.
    fn take(&mut self, catalog: &Catalog, campaign: &str) -> Result<(), CatalogError> {
        let filter = Filter {
            experiment: Some(campaign.to_owned()),
            ..Filter::default()
        };
        let mut of_run: BTreeMap<String, Vec<CatalogFit>> = BTreeMap::new();
        for fit in catalog.all_fits(&filter)? {
            of_run.entry(fit.run.clone()).or_default().push(fit);
        }
        for run in catalog.all_runs(&filter)? {
            let fits = of_run.remove(&run.run).unwrap_or_default();
            match self.why_not(&run, &fits) {
                Some(why) => *self.left_out.entry(why).or_default() += 1,
                None => {
                    self.contents.extend(run.content_sha256);
                    self.fits.extend(fits);
                }
            }
        }
        Ok(())
    }

    /// Returns why a run is not used, or `None` if it is.
    fn why_not(&self, run: &CatalogRun, fits: &[CatalogFit]) -> Option<&'static str> {
        let is_known = |content: &String| self.contents.contains(content);
        match run.verdict {
            CatalogVerdict::Damaged => Some(DAMAGED),
            CatalogVerdict::Stopped | CatalogVerdict::Failed => Some(FAILED),
            CatalogVerdict::Unfinished => Some(UNFINISHED),
            _ if run.missing => Some(MISSING),
            _ if run.content_sha256.as_ref().is_some_and(is_known) => Some(TWICE),
            _ if fits.is_empty() => Some(WITHOUT),
            _ if fits.iter().any(|fit| fit.cells != 1) => Some(SEVERAL),
            CatalogVerdict::Good | CatalogVerdict::Doubtful => None,
        }
    }

    fn left_out(&self) -> Vec<LeftOut> {
        let all = self.left_out.iter();
        all.map(|(why, runs)| LeftOut { why, runs: *runs })
            .collect()
    }

    fn none(&self, campaign: &str, rc: Option<u32>) -> ReportError {
        let orders: BTreeSet<u32> = self.fits.iter().map(|fit| fit.rc).collect();
        let listed: Vec<String> = orders.iter().map(u32::to_string).collect();
        let left_out = self.left_out.iter();
        ReportError::None {
            campaign: campaign.to_owned(),
            rc: rc.map_or("any number of".to_owned(), |rc| rc.to_string()),
            orders: match listed.as_slice() {
                [] => "none".to_owned(),
                listed => listed.join(", "),
            },
            left_out: left_out
                .map(|(why, runs)| format!("; {runs} runs left out: {why}"))
                .collect(),
        }
    }
}

/// Evaluates the runs of a campaign in catalogues, by models of one order: the greatest
/// available, unless one is chosen. A run is used if it is finished and its folder exists, and
/// only once if several folders have equal content.
///
/// # Errors
/// [`ReportError`].
pub fn report(
    catalogs: &[Catalog],
    campaign: &str,
    rc: Option<u32>,
) -> Result<CampaignReport, ReportError> {
    let mut chosen = Chosen::default();
    for catalog in catalogs {
        chosen.take(catalog, campaign)?;
    }
    let greatest = chosen.fits.iter().map(|fit| fit.rc).max();
    let wanted = rc.or(greatest).unwrap_or_default();
    let of_order = chosen.fits.iter().filter(|fit| fit.rc == wanted);
    let fits: Vec<CatalogFit> = of_order.cloned().collect();
    if fits.is_empty() {
        return Err(chosen.none(campaign, rc));
    }
    let quantities = QUANTITIES
        .iter()
        .map(|kind| kind.over(&fits))
        .collect::<Result<Vec<Option<Quantity>>, ReportError>>()?;
    Ok(CampaignReport {
        campaign: campaign.to_owned(),
        rc: wanted,
        values: fits.len(),
        left_out: chosen.left_out(),
        quantities: quantities.into_iter().flatten().collect(),
    })
}

/// A quantity of a fit.
struct Kind {
    name: &'static str,
    unit: &'static str,
    of: fn(&CatalogFit) -> Option<f64>,
}

const QUANTITIES: [Kind; 4] = [
    Kind {
        name: "R",
        unit: "Ω",
        of: |fit| Some(fit.r_ohm),
    },
    Kind {
        name: "DC resistance",
        unit: "Ω",
        of: |fit| Some(fit.dc_resistance_ohm),
    },
    Kind {
        name: "R of the slowest pair",
        unit: "Ω",
        of: |fit| fit.slow_r_ohm,
    },
    Kind {
        name: "time constant of the slowest pair",
        unit: "s",
        of: |fit| fit.slow_tau_s,
    },
];

/// A value of a cell on a bench.
struct Row {
    log: f64,
    cell: usize,
    bench: usize,
    batch: usize,
}

/// Names of the groups of the rows, in order.
#[derive(Default)]
struct Names {
    known: BTreeMap<String, usize>,
}

impl Names {
    fn number(&mut self, name: &str) -> usize {
        let next = self.known.len();
        *self.known.entry(name.to_owned()).or_insert(next)
    }

    fn listed(&self) -> Vec<String> {
        let mut all: Vec<(&String, &usize)> = self.known.iter().collect();
        all.sort_by_key(|(_, number)| **number);
        all.into_iter().map(|(name, _)| name.clone()).collect()
    }
}

/// The rows of a quantity, and the names of their cells, benches and batches.
#[derive(Default)]
struct Rows {
    rows: Vec<Row>,
    cells: Names,
    benches: Names,
    batches: Names,
    batch_of: BTreeMap<usize, String>,
}

impl Rows {
    fn of(fits: &[CatalogFit], kind: &Kind) -> Self {
        let mut made = Self::default();
        for fit in fits {
            let Some(value) = (kind.of)(fit).filter(|value| value.is_finite() && *value > 0.0)
            else {
                continue;
            };
            let cell = made.cells.number(&fit.cell);
            if let Some(batch) = &fit.batch {
                made.batch_of.insert(cell, batch.clone());
            }
            let row = Row {
                log: value.ln(),
                cell,
                bench: made.benches.number(&fit.bench),
                batch: made
                    .batches
                    .number(fit.batch.as_deref().unwrap_or_default()),
            };
            made.rows.push(row);
        }
        made
    }

    fn column<T>(&self, of: impl Fn(&Row) -> T) -> Vec<T> {
        self.rows.iter().map(of).collect()
    }

    fn fit(&self) -> Result<Mixed, MixedError> {
        let cells = self.column(|row| row.cell);
        let benches = self.column(|row| row.bench);
        let batches = self.column(|row| row.batch);
        let several = |names: &Names| names.known.len() > 1;
        let mut factors = Vec::new();
        // With one measurement per cell, differences between cells cannot be separated from the
        // scatter of repeats.
        if several(&self.cells) && self.cells.known.len() < self.rows.len() {
            factors.push(Factor {
                name: CELL,
                levels: &cells,
            });
        }
        if several(&self.benches) {
            factors.push(Factor {
                name: BENCH,
                levels: &benches,
            });
        }
        // An unknown batch does not count as a batch of its own.
        if self
            .batches
            .known
            .keys()
            .filter(|name| !name.is_empty())
            .count()
            > 1
        {
            factors.push(Factor {
                name: "batch",
                levels: &batches,
            });
        }
        fit_mixed(&Grouped {
            values: &self.column(|row| row.log),
            variances: &[],
            covariates: &[],
            factors: &factors,
        })
    }
}

const CELL: &str = "cell";
const BENCH: &str = "bench";

impl Kind {
    /// Returns the quantity over all fits that have it, or `None` if fewer than three have it.
    fn over(&self, fits: &[CatalogFit]) -> Result<Option<Quantity>, ReportError> {
        let rows = Rows::of(fits, self);
        if rows.rows.len() < 3 {
            return Ok(None);
        }
        let fit = rows.fit().map_err(|source| ReportError::Mixed {
            quantity: self.name,
            source,
        })?;
        let at = |name: &str| fit.components.iter().position(|one| one.name == name);
        let levels = |name: &str, count: usize| match at(name) {
            Some(at) => fit.levels[at].clone(),
            None => vec![NOTHING; count],
        };
        let benches = levels(BENCH, rows.benches.known.len());
        let cells = levels(CELL, rows.cells.known.len());
        let mean = fit.fixed[0].value.exp();
        Ok(Some(Quantity {
            name: self.name,
            unit: self.unit,
            mean,
            mean_sigma: mean * fit.fixed[0].sigma,
            spread: fit.components.iter().map(spread).collect(),
            benches: rows.offsets(&benches),
            cells: rows.corrected(&cells, &benches, residual(&fit)),
        }))
    }
}

/// A level of a factor that is not in the model.
const NOTHING: Level = Level {
    value: 0.0,
    sigma: 0.0,
    z: 0.0,
};

fn residual(fit: &Mixed) -> f64 {
    fit.components.last().map_or(0.0, |one| one.sd)
}

fn spread(component: &Component) -> Spread {
    Spread {
        name: component.name.clone(),
        levels: component.levels,
        sd: component.sd,
        low: component.low,
        high: Some(component.high).filter(|high| high.is_finite()),
    }
}

impl Rows {
    fn offsets(&self, levels: &[Level]) -> Vec<BenchOffset> {
        let outliers = outliers(levels);
        let names = self.benches.listed();
        let all = names.into_iter().zip(levels).zip(outliers);
        all.enumerate()
            .map(|(at, ((bench, level), is_outlier))| BenchOffset {
                bench,
                values: self.rows.iter().filter(|row| row.bench == at).count(),
                offset: level.value.exp_m1(),
                sigma: level.sigma,
                is_outlier,
            })
            .collect()
    }

    fn corrected(&self, levels: &[Level], benches: &[Level], rest: f64) -> Vec<CorrectedCell> {
        let outliers = outliers(levels);
        let mut of_cell: Vec<Vec<&Row>> = vec![Vec::new(); levels.len()];
        self.rows.iter().for_each(|row| of_cell[row.cell].push(row));
        let names = self.cells.listed().into_iter().zip(of_cell);
        let all = names.zip(levels).zip(outliers);
        all.enumerate()
            .map(|(at, (((cell, rows), level), is_outlier))| {
                let count = rows.len() as f64;
                let mean =
                    |of: &dyn Fn(&Row) -> f64| rows.iter().map(|row| of(row)).sum::<f64>() / count;
                let corrected = mean(&|row| row.log - benches[row.bench].value).exp();
                let variance = mean(&|row| rest * rest + benches[row.bench].sigma.powi(2));
                CorrectedCell {
                    cell,
                    batch: self.batch_of.get(&at).cloned(),
                    values: rows.len(),
                    measured: mean(&|row| row.log).exp(),
                    corrected,
                    sigma: corrected * (variance / count).sqrt(),
                    z: level.z,
                    is_outlier,
                }
            })
            .collect()
    }
}

/// Which levels do not belong to the others (Holm, 1979): the chance that any is named where none
/// differs is [`FALSE_ALARM`].
fn outliers(levels: &[Level]) -> Vec<bool> {
    let chance = |level: &Level| 2.0 * normal_tail(level.z.abs());
    let chances: Vec<f64> = levels.iter().map(chance).collect();
    holm(&chances).iter().map(|p| *p <= FALSE_ALARM).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chance_of_a_false_alarm_is_shared_by_all_levels() {
        let level = |z| Level { z, ..NOTHING };
        let mut levels: Vec<Level> = (0..99).map(|at| level(f64::from(at) / 50.0)).collect();
        // 2·P(Z > 3.7) is 2.2e-4, more than 0.01/100; 2·P(Z > 4.1) is 4.1e-5.
        levels.push(level(-3.7));
        assert!(outliers(&levels).iter().all(|named| !named));
        levels[99] = level(-4.1);
        assert_eq!(outliers(&levels).iter().filter(|named| **named).count(), 1);
    }
}
