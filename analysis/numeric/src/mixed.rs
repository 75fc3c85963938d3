//! Components of variance by restricted maximum likelihood (REML; Patterson and Thompson, 1971).
//!
//! y = X·b + Σ Z·u + e, with one u for each level of each factor, u ~ N(0, s²) of its factor, and
//! e ~ N(0, s² + v) with a known variance v of each value. Factors may be nested or crossed, and
//! unbalanced. The greatest factor is eliminated level by level, so that the work grows with the
//! rows and with the square of the other levels, not with the cube of all of them.
//!
//! Intervals are those of the profile of the likelihood: all standard deviations at which the best
//! of the rest is less than 3.84 worse (χ² with one degree of freedom, 95 %). A factor of five
//! levels is covered in 94.1 % by that, in the limit of exact values.

use crate::{
    LocalOptions, Smooth,
    linalg::{cholesky, cholesky_substitute, invert},
    minimise,
};

/// 95 % point of χ² with one degree of freedom.
const CHI2_95: f64 = 3.841_458_820_694_124;
/// Step of the numerical derivatives, of standard deviations in units of the scatter of the values.
const STEP: f64 = 1e-4;
/// Least variance of a row in those units: below it a fit is exact and has no likelihood.
const LEAST_VARIANCE: f64 = 1e-14;
/// Largest standard deviation that is looked at, in units of the scatter of the values.
const LARGEST: f64 = 1e3;

/// A factor: what values of one level share.
#[derive(Debug, Clone, Copy)]
pub struct Factor<'a> {
    /// Its name.
    pub name: &'a str,
    /// Level of each row, from 0.
    pub levels: &'a [usize],
}

/// Values with their possible dependencies.
#[derive(Debug, Clone, Copy)]
pub struct Grouped<'a> {
    /// The values.
    pub values: &'a [f64],
    /// Known variance of each value; empty where none is known.
    pub variances: &'a [f64],
    /// Columns of the fixed part beside the constant, each with a number for each row.
    pub covariates: &'a [&'a [f64]],
    /// The factors.
    pub factors: &'a [Factor<'a>],
}

/// Reason for a missing result.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MixedError {
    /// Columns of another length than the values; the name of the column.
    Length(String),
    /// A value is not a number, or a variance is negative; the row, from 0.
    Value(usize),
    /// Too few rows for the fixed part and one component; how many are needed.
    Few(usize),
    /// The covariates depend on each other.
    Dependent,
    /// The values do not differ, or the fit is exact: nothing varies.
    Exact,
}

impl std::fmt::Display for MixedError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Length(name) => write!(f, "expected a value of {name} for each row"),
            Self::Value(row) => write!(
                f,
                "row {}: expected a finite value and a variance of 0 or more",
                row + 1
            ),
            Self::Few(needed) => write!(f, "expected at least {needed} rows"),
            Self::Dependent => write!(f, "expected covariates that do not depend on each other"),
            Self::Exact => write!(f, "expected values that scatter"),
        }
    }
}

impl std::error::Error for MixedError {}

/// A value with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Standard deviation of the common part of a factor's levels.
#[derive(Debug, Clone, PartialEq)]
pub struct Component {
    /// Name of the factor; `residual` for what no factor explains.
    pub name: String,
    /// The standard deviation.
    pub sd: f64,
    /// Lower end of its interval of 95 %.
    pub low: f64,
    /// Upper end; infinite if the values exclude no number.
    pub high: f64,
    /// Number of levels; of rows for the residual.
    pub levels: usize,
}

/// Prediction for one level of a factor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// The excess of its values over the fixed part, shrunk towards zero by the available
    /// information.
    pub value: f64,
    /// Standard deviation of the error of that.
    pub sigma: f64,
    /// The value in standard deviations of such predictions; 0 if the factor has no variance.
    pub z: f64,
}

/// Result of a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Mixed {
    /// The constant, and the coefficient of each covariate.
    pub fixed: Vec<Estimate>,
    /// The factors in their order, and at last the residual.
    pub components: Vec<Component>,
    /// Predictions for the levels of each factor.
    pub levels: Vec<Vec<Level>>,
    /// Residual of each row, in its standard deviations.
    pub residuals: Vec<f64>,
    /// −2 log of the restricted likelihood, but for a constant.
    pub deviance: f64,
}

/// Fits fixed part and components of variance.
///
/// # Errors
/// [`MixedError`].
pub fn fit_mixed(grouped: &Grouped<'_>) -> Result<Mixed, MixedError> {
    fit(grouped, |model, at, best| model.interval(at, best))
}

/// Computes the same estimate without intervals, whose ends are NaN: they take most of the time.
///
/// # Errors
/// [`MixedError`].
pub fn estimate_mixed(grouped: &Grouped<'_>) -> Result<Mixed, MixedError> {
    fit(grouped, |_, _, _| [f64::NAN; 2])
}

fn fit(
    grouped: &Grouped<'_>,
    interval: impl Fn(&Model<'_>, usize, &Best) -> [f64; 2],
) -> Result<Mixed, MixedError> {
    let model = Model::new(grouped)?;
    let best = model.best(&vec![None; model.unknowns()]);
    if !best.value.is_finite() {
        return Err(MixedError::Exact);
    }
    let components = (0..model.unknowns())
        .map(|at| model.component(at, &best, interval(&model, at, &best)))
        .collect();
    model.result(&best, components).ok_or(MixedError::Dependent)
}

/// The rows in units of their scatter, and the factors with the greatest one apart.
struct Model<'a> {
    grouped: Grouped<'a>,
    scale: f64,
    centre: f64,
    values: Vec<f64>,
    variances: Vec<f64>,
    means: Vec<f64>,
    greatest: Option<usize>,
    /// First column of each factor among the dense ones; not used for the greatest.
    first: Vec<usize>,
    counts: Vec<usize>,
    dense: usize,
}

/// A minimum of the deviance.
#[derive(Clone)]
struct Best {
    sds: Vec<f64>,
    value: f64,
}

/// Sums of a set of standard deviations.
struct Sums {
    log: f64,
    matrix: Vec<f64>,
    right: Vec<f64>,
    square: f64,
    groups: Vec<Group>,
}

/// Sums over the rows of one level of the greatest factor.
#[derive(Clone, Default)]
struct Group {
    weight: f64,
    value: f64,
    columns: Vec<(usize, f64)>,
}

impl Group {
    fn add(&mut self, column: usize, weighted: f64) {
        match self.columns.iter_mut().find(|(known, _)| *known == column) {
            Some((_, sum)) => *sum += weighted,
            None => self.columns.push((column, weighted)),
        }
    }
}

impl<'a> Model<'a> {
    fn new(grouped: &Grouped<'a>) -> Result<Self, MixedError> {
        let rows = grouped.values.len();
        check(grouped, rows)?;
        let fixed = 1 + grouped.covariates.len();
        if rows < fixed + 2 {
            return Err(MixedError::Few(fixed + 2));
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / rows as f64;
        let centre = mean(grouped.values);
        let square = grouped.values.iter().map(|y| (y - centre).powi(2));
        let scale = (square.sum::<f64>() / (rows - 1) as f64).sqrt();
        if !(scale.is_finite() && scale > 0.0) {
            return Err(MixedError::Exact);
        }
        let levels = |factor: &Factor<'_>| 1 + factor.levels.iter().max().copied().unwrap_or(0);
        let counts: Vec<usize> = grouped.factors.iter().map(levels).collect();
        let greatest = (0..counts.len()).max_by_key(|at| counts[*at]);
        let mut dense = fixed;
        let first = (0..counts.len()).map(|at| {
            let first = dense;
            dense += if Some(at) == greatest { 0 } else { counts[at] };
            first
        });
        let first = first.collect();
        Ok(Self {
            grouped: *grouped,
            scale,
            centre,
            values: grouped
                .values
                .iter()
                .map(|y| (y - centre) / scale)
                .collect(),
            variances: match grouped.variances {
                [] => vec![0.0; rows],
                known => known.iter().map(|v| v / (scale * scale)).collect(),
            },
            means: grouped.covariates.iter().map(|x| mean(x)).collect(),
            greatest,
            first,
            counts,
            dense,
        })
    }

    /// Returns the standard deviations: one for each factor, and the residual.
    fn unknowns(&self) -> usize {
        self.counts.len() + 1
    }

    fn residual_at(&self) -> usize {
        self.counts.len()
    }

    fn fixed(&self) -> usize {
        1 + self.grouped.covariates.len()
    }

    /// Entries of a row in the dense columns, in the scale of the standard deviations.
    fn row(&self, row: usize, sds: &[f64], entries: &mut Vec<(usize, f64)>) {
        entries.clear();
        entries.push((0, 1.0));
        let covariates = self.grouped.covariates.iter().zip(&self.means);
        entries.extend(
            covariates
                .enumerate()
                .map(|(at, (column, mean))| (1 + at, column[row] - mean)),
        );
        for (at, factor) in self.grouped.factors.iter().enumerate() {
            if Some(at) != self.greatest {
                entries.push((self.first[at] + factor.levels[row], sds[at]));
            }
        }
    }

    fn group_of(&self, row: usize) -> Option<usize> {
        self.greatest.map(|at| self.grouped.factors[at].levels[row])
    }

    /// Returns sums over all rows, or `None` if a row has no variance.
    fn sums(&self, sds: &[f64]) -> Option<Sums> {
        let n = self.dense;
        let own = sds[self.residual_at()].powi(2);
        let mut sums = Sums {
            log: 0.0,
            matrix: vec![0.0; n * n],
            right: vec![0.0; n],
            square: 0.0,
            groups: vec![Group::default(); self.greatest.map_or(0, |at| self.counts[at])],
        };
        for at in self.fixed()..n {
            sums.matrix[at * n + at] = 1.0;
        }
        let mut entries = Vec::new();
        for (row, y) in self.values.iter().enumerate() {
            let variance = own + self.variances[row];
            if variance < LEAST_VARIANCE {
                return None;
            }
            let weight = 1.0 / variance;
            sums.log += variance.ln();
            sums.square += weight * y * y;
            self.row(row, sds, &mut entries);
            for (i, x) in &entries {
                sums.right[*i] += weight * x * y;
                for (j, other) in &entries {
                    sums.matrix[i * n + j] += weight * x * other;
                }
            }
            if let Some(group) = self.group_of(row) {
                let group = &mut sums.groups[group];
                group.weight += weight;
                group.value += weight * y;
                entries.iter().for_each(|(i, x)| group.add(*i, weight * x));
            }
        }
        self.eliminate(&mut sums, sds);
        Some(sums)
    }

    /// Takes the greatest factor out of the sums, level by level.
    fn eliminate(&self, sums: &mut Sums, sds: &[f64]) {
        let Some(variance) = self.greatest.map(|at| sds[at].powi(2)) else {
            return;
        };
        let n = self.dense;
        for group in &sums.groups {
            let bound = 1.0 + variance * group.weight;
            let share = variance / bound;
            sums.log += bound.ln();
            sums.square -= share * group.value * group.value;
            for (i, x) in &group.columns {
                sums.right[*i] -= share * x * group.value;
                for (j, other) in &group.columns {
                    sums.matrix[i * n + j] -= share * x * other;
                }
            }
        }
    }

    /// Returns −2 log of the restricted likelihood, except for a constant; infinite if there is
    /// none.
    fn deviance(&self, sds: &[f64]) -> f64 {
        let Some(mut sums) = self.sums(sds) else {
            return f64::INFINITY;
        };
        let n = self.dense;
        if !cholesky(&mut sums.matrix, n) {
            return f64::INFINITY;
        }
        let log: f64 = (0..n).map(|i| sums.matrix[i * n + i].ln()).sum();
        let mut solved = sums.right.clone();
        cholesky_substitute(&sums.matrix, n, &mut solved);
        let explained: f64 = sums.right.iter().zip(&solved).map(|(t, b)| t * b).sum();
        sums.log + 2.0 * log + sums.square - explained
    }

    /// Returns the best standard deviations, some of them held; sought from several starts, for the
    /// likelihood of small tables can have two tops.
    fn best(&self, held: &[Option<f64>]) -> Best {
        let starts = [0.5, 0.1, 0.9];
        let found = starts.iter().map(|start| self.from(*start, held));
        found
            .min_by(|a, b| a.value.total_cmp(&b.value))
            .unwrap_or(Best {
                sds: Vec::new(),
                value: f64::INFINITY,
            })
    }

    fn from(&self, start: f64, held: &[Option<f64>]) -> Best {
        self.near(&vec![start; held.len()], held)
    }

    fn near(&self, start: &[f64], held: &[Option<f64>]) -> Best {
        let bounds: Vec<(f64, f64)> = held
            .iter()
            .map(|held| held.map_or((0.0, LARGEST), |sd| (sd, sd)))
            .collect();
        let options = LocalOptions {
            iterations: 100,
            tolerance: 1e-11,
            longest_step: 0.3,
        };
        let found = minimise(&Deviance { model: self }, start, &bounds, &options);
        Best {
            sds: found.x,
            value: found.value,
        }
    }

    /// Both ends of the interval of one component.
    fn interval(&self, at: usize, best: &Best) -> [f64; 2] {
        [0.0, LARGEST].map(|bound| self.end(at, best, bound) * self.scale)
    }

    /// One component with its interval.
    fn component(&self, at: usize, best: &Best, [low, high]: [f64; 2]) -> Component {
        let factor = self.grouped.factors.get(at);
        let levels = self.counts.get(at).copied();
        Component {
            name: factor.map_or("residual", |factor| factor.name).to_owned(),
            sd: best.sds[at] * self.scale,
            low,
            high,
            levels: levels.unwrap_or(self.values.len()),
        }
    }

    /// Finds where the profile of one standard deviation crosses the limit, in the direction of
    /// `bound`.
    fn end(&self, at: usize, best: &Best, bound: f64) -> f64 {
        let mut near = best.sds.clone();
        let mut is_inside = |sd: f64| {
            let mut held = vec![None; self.unknowns()];
            held[at] = Some(sd);
            let found = self.near(&near, &held);
            if found.value.is_finite() {
                near.clone_from(&found.sds);
                // A start at zero would stay there: the deviance is even in each of them.
                near.iter_mut().for_each(|sd| *sd = sd.max(0.02));
            }
            found.value - best.value <= CHI2_95
        };
        let (mut inside, mut outside) = (best.sds[at], bound);
        if bound > inside {
            let mut reach = (2.0 * inside).max(0.1);
            while reach < bound && is_inside(reach) {
                inside = reach;
                reach *= 2.0;
            }
            if reach >= bound {
                return f64::INFINITY;
            }
            outside = reach;
        } else if is_inside(bound) {
            return bound;
        }
        while (outside - inside).abs() > 1e-4 * outside.max(inside) {
            let middle = 0.5 * (inside + outside);
            if is_inside(middle) {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        inside
    }

    /// Fixed part, predictions and residuals at the best standard deviations.
    fn result(&self, best: &Best, components: Vec<Component>) -> Option<Mixed> {
        let sums = self.sums(&best.sds)?;
        let n = self.dense;
        let inverse = invert(&sums.matrix, n)?;
        let solved: Vec<f64> = inverse
            .chunks_exact(n)
            .map(|row| row.iter().zip(&sums.right).map(|(i, t)| i * t).sum())
            .collect();
        let levels = (0..self.counts.len())
            .map(|at| match Some(at) == self.greatest {
                true => self.greatest_levels(at, best, &sums, &solved, &inverse),
                false => self.dense_levels(at, best, &solved, &inverse),
            })
            .collect::<Vec<Vec<Level>>>();
        Some(Mixed {
            fixed: self.fixed_part(&solved, &inverse),
            residuals: self.residuals(best, &solved, &levels),
            components,
            levels,
            deviance: best.value,
        })
    }

    /// Returns the constant at covariates of zero, and the coefficients.
    fn fixed_part(&self, solved: &[f64], inverse: &[f64]) -> Vec<Estimate> {
        let (n, fixed) = (self.dense, self.fixed());
        // The covariates were taken relative to their means.
        let away: Vec<f64> = std::iter::once(1.0)
            .chain(self.means.iter().map(|mean| -mean))
            .collect();
        let value: f64 = away.iter().zip(solved).map(|(a, b)| a * b).sum();
        let variance: f64 = (0..fixed)
            .flat_map(|i| (0..fixed).map(move |j| (i, j)))
            .map(|(i, j)| away[i] * away[j] * inverse[i * n + j])
            .sum();
        let constant = Estimate {
            value: self.centre + self.scale * value,
            sigma: self.scale * variance.max(0.0).sqrt(),
        };
        let rest = (1..fixed).map(|at| Estimate {
            value: self.scale * solved[at],
            sigma: self.scale * inverse[at * n + at].sqrt(),
        });
        std::iter::once(constant).chain(rest).collect()
    }

    /// Returns a prediction from its value and the variance of its error, in units of the scatter.
    fn level(&self, value: f64, error: f64, sd: f64) -> Level {
        let of_prediction = (sd * sd - error).max(0.0).sqrt();
        let known = of_prediction > 1e-6 * sd && sd > 0.0;
        Level {
            value: self.scale * value,
            sigma: self.scale * error.max(0.0).sqrt(),
            z: if known { value / of_prediction } else { 0.0 },
        }
    }

    fn dense_levels(&self, at: usize, best: &Best, solved: &[f64], inverse: &[f64]) -> Vec<Level> {
        let sd = best.sds[at];
        let columns = self.first[at]..self.first[at] + self.counts[at];
        columns
            .map(|j| {
                let error = sd * sd * inverse[j * self.dense + j];
                self.level(sd * solved[j], error, sd)
            })
            .collect()
    }

    fn greatest_levels(
        &self,
        at: usize,
        best: &Best,
        sums: &Sums,
        solved: &[f64],
        inverse: &[f64],
    ) -> Vec<Level> {
        let sd = best.sds[at];
        let variance = sd * sd;
        let of = |group: &Group| {
            let bound = 1.0 + variance * group.weight;
            let fitted: f64 = group.columns.iter().map(|(i, x)| x * solved[*i]).sum();
            let shared: f64 = group
                .columns
                .iter()
                .flat_map(|(i, x)| {
                    let row = &inverse[i * self.dense..];
                    group.columns.iter().map(move |(j, y)| x * y * row[*j])
                })
                .sum();
            let error = variance / bound + (variance / bound).powi(2) * shared;
            self.level(variance * (group.value - fitted) / bound, error, sd)
        };
        sums.groups.iter().map(of).collect()
    }

    fn residuals(&self, best: &Best, solved: &[f64], levels: &[Vec<Level>]) -> Vec<f64> {
        let own = best.sds[self.residual_at()].powi(2);
        let mut entries = Vec::new();
        let mut residuals = Vec::with_capacity(self.values.len());
        for (row, y) in self.values.iter().enumerate() {
            self.row(row, &best.sds, &mut entries);
            let fitted: f64 = entries.iter().map(|(i, x)| x * solved[*i]).sum();
            let shared = self.greatest.map_or(0.0, |at| {
                levels[at][self.grouped.factors[at].levels[row]].value / self.scale
            });
            residuals.push((y - fitted - shared) / (own + self.variances[row]).sqrt());
        }
        residuals
    }
}

fn check(grouped: &Grouped<'_>, rows: usize) -> Result<(), MixedError> {
    let variances = grouped.variances;
    let mut columns = vec![("variances", variances.len(), !variances.is_empty())];
    columns.extend(
        grouped
            .covariates
            .iter()
            .map(|x| ("a covariate", x.len(), true)),
    );
    columns.extend(
        grouped
            .factors
            .iter()
            .map(|of| (of.name, of.levels.len(), true)),
    );
    if let Some((name, _, _)) = columns
        .iter()
        .find(|(_, len, there)| *there && *len != rows)
    {
        return Err(MixedError::Length((*name).to_owned()));
    }
    let is_bad = |row: &usize| {
        let variance = variances.get(*row).copied().unwrap_or(0.0);
        let covariates = grouped.covariates.iter().all(|x| x[*row].is_finite());
        !(grouped.values[*row].is_finite() && variance.is_finite() && variance >= 0.0 && covariates)
    };
    match (0..rows).find(is_bad) {
        Some(row) => Err(MixedError::Value(row)),
        None => Ok(()),
    }
}

/// The deviance with numerical derivatives.
struct Deviance<'a> {
    model: &'a Model<'a>,
}

impl Deviance<'_> {
    /// The deviance is even in each standard deviation: it takes equal values below and above zero.
    fn at(&self, x: &[f64]) -> f64 {
        let sds: Vec<f64> = x.iter().map(|sd| sd.abs()).collect();
        self.model.deviance(&sds)
    }

    fn moved(&self, x: &[f64], moves: &[(usize, f64)]) -> f64 {
        let mut x = x.to_vec();
        moves.iter().for_each(|(at, by)| x[*at] += by);
        self.at(&x)
    }
}

impl Smooth for Deviance<'_> {
    fn value(&self, x: &[f64]) -> f64 {
        self.at(x)
    }

    fn expand(&self, x: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        let n = x.len();
        let here = self.at(x);
        for i in 0..n {
            let (above, below) = (self.moved(x, &[(i, STEP)]), self.moved(x, &[(i, -STEP)]));
            gradient[i] = (above - below) / (2.0 * STEP);
            hessian[i * n + i] = (above - 2.0 * here + below) / (STEP * STEP);
            for j in 0..i {
                let at = |a: f64, b: f64| self.moved(x, &[(i, a * STEP), (j, b * STEP)]);
                let mixed = at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0);
                hessian[i * n + j] = mixed / (4.0 * STEP * STEP);
                hessian[j * n + i] = hessian[i * n + j];
            }
        }
        here
    }
}

#[cfg(test)]
mod tests;
