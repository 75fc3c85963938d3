//! Prepares the problem from a data set and a model: facts, blocks, noise.

use super::block::{Block, DataSetError, Kind, Model, Workspace};
use super::data::{DataSet, Fixture, Role, Run, RunData};
use super::estimate::{Estimate, estimate};
use super::experiment::planned::PlannedRun;
use super::guards::Guards;
use super::noise::{Prior, Shape, Term, current_jitter_a};
use super::problem::{Fit, Problem};
use super::shared::{Errors, Shared};
use super::whitening::Whitener;
use analysis_effects::{
    augmented::Between,
    contract::{Base, Facts},
};
use analysis_model::{model::Erm, ocv::OcvCurve};

/// The model that is judged.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseModel {
    /// Name for reports.
    pub name: String,
    /// Fitted to spectra.
    pub erm: Erm,
    /// Open-circuit voltage over SOC, with the capacity.
    pub ocv: OcvCurve,
}

/// A problem with the noise it was made with.
#[derive(Debug, Clone)]
pub(super) struct Prepared {
    pub(super) problem: Problem,
    pub(super) estimate: Estimate,
    pub(super) prior: Prior,
    /// White noise of one voltage sample, V.
    pub(super) sample_noise_v: f64,
}

/// Makes a data set ready.
///
/// # Errors
/// [`DataSetError`] for a run that cannot be used or a set without training runs.
pub(super) fn prepare(
    set: &DataSet,
    model: &BaseModel,
    guards: Guards,
) -> Result<Prepared, DataSetError> {
    if !set.runs.iter().any(|r| r.role == Role::Train) {
        return Err(DataSetError::Set {
            name: set.name.clone(),
            expected: "at least one training run",
        });
    }
    let base = Base {
        erm: model.erm.clone(),
        ocv: model.ocv.clone(),
        facts: facts(set, &model.ocv),
    };
    let blocks = blocks(set, &base)?;
    let prior = Prior::new(set.history, set.calibration, &base);
    let mut workspace = Workspace::default();
    let alone = Model::new(&base, &[]);
    let shapes = guarded_shapes(&blocks, &alone, &prior, guards, &mut workspace);
    let residuals: Vec<Vec<f64>> = blocks
        .iter()
        .map(|b| {
            let mut rows = Vec::new();
            b.predict(&alone, 1, &mut workspace, &mut rows);
            b.measured.iter().zip(rows).map(|(m, p)| m - p).collect()
        })
        .collect();
    let estimate = estimate(&blocks, &shapes, &residuals, &prior);
    let sample_noise_v = (estimate.variance(Term::White) + prior.sample_variance(&base)).sqrt();
    let mut problem = Problem::unweighed(base, blocks);
    weigh(&mut problem, &shapes, &estimate)?;
    Ok(Prepared {
        problem,
        estimate,
        prior,
        sample_noise_v,
    })
}

/// Returns the blocks in the order of time, counted from the first: the first number of a campaign
/// has no meaning for the cell.
fn blocks(set: &DataSet, base: &Base) -> Result<Vec<Block>, DataSetError> {
    let first = set.runs.iter().map(|r| r.order).min().unwrap_or(0);
    let jitter_a = set.history.as_ref().map_or(0.0, current_jitter_a);
    let first_s = set
        .runs
        .iter()
        .map(|r| r.start_s)
        .fold(f64::INFINITY, f64::min);
    let counted = |r: &Run| {
        Block::new(
            &Run {
                order: r.order - first,
                start_s: r.start_s - first_s,
                ..r.clone()
            },
            base,
            jitter_a,
        )
    };
    let mut blocks = set
        .runs
        .iter()
        .map(counted)
        .collect::<Result<Vec<Block>, DataSetError>>()?;
    blocks.sort_by(|a, b| a.at.order.total_cmp(&b.at.order));
    Block::tell_charge(&mut blocks, base.ocv.capacity_ah);
    Block::find_alike(&mut blocks);
    Ok(blocks)
}

/// Returns the shape of every block's noise about a model.
fn shapes(
    blocks: &[Block],
    model: &Model<'_>,
    prior: &Prior,
    workspace: &mut Workspace,
) -> Vec<Shape> {
    let repeats = |b: &Block| {
        blocks
            .iter()
            .filter(|o| o.group == b.group && o.role == b.role)
            .count()
    };
    let shape = |b: &Block| {
        let mut shape = Shape::new(b, model, prior, workspace);
        shape.share_codes(repeats(b));
        shape
    };
    blocks.iter().map(shape).collect()
}

/// Returns the same shapes, without the errors of the current channel if they must not count.
fn guarded_shapes(
    blocks: &[Block],
    model: &Model<'_>,
    prior: &Prior,
    guards: Guards,
    workspace: &mut Workspace,
) -> Vec<Shape> {
    let mut shapes = shapes(blocks, model, prior, workspace);
    if !guards.current_channel_noise {
        shapes.iter_mut().for_each(Shape::forget_current_channel);
    }
    shapes
}

/// Whiteners, standard deviations and shared errors of a problem.
fn weigh(problem: &mut Problem, shapes: &[Shape], estimate: &Estimate) -> Result<(), DataSetError> {
    (problem.whiteners, problem.repeating) = (Vec::new(), Vec::new());
    (problem.floors, problem.at_edges) = (Vec::new(), Vec::new());
    let mut errors = Errors::default();
    for (block, shape) in problem.blocks.iter().zip(shapes) {
        let n = block.rows();
        let whole = shape.whole_covariance(&estimate.log_sigmas, 1);
        let variances: Vec<f64> = (0..n).map(|i| whole[i * n + i]).collect();
        problem.at_edges.push(shape.at_edges(&variances));
        problem
            .floors
            .push(variances.iter().map(|v| v.sqrt()).collect());
        let met = || DataSetError::Run {
            run: block.name.clone(),
            expected: "noise that is not zero",
            met: "a singular covariance".to_owned(),
        };
        let covariance = if block.role == Role::Train {
            shape.covariance(&estimate.log_sigmas)
        } else {
            whole
        };
        let whitener = Whitener::new(covariance, n).ok_or_else(met)?;
        if block.role == Role::Train {
            errors
                .iter_mut()
                .zip(shape.shared())
                .for_each(|(all, v)| whitener.apply(v, all));
        }
        problem.repeating.push(whitener.whitened(shape.known()));
        problem.whiteners.push(whitener);
    }
    problem.shared = Shared::new(errors);
    Ok(())
}

impl Prepared {
    /// Determines the noise again about a fit and from its residuals: an effect that the base lacks
    /// makes repeats with slightly different currents differ, and the errors of the bench act on
    /// the real cell with its effects.
    pub(super) fn again(mut self, fit: &Fit, guards: Guards) -> Result<Self, DataSetError> {
        let mut workspace = Workspace::default();
        let problem = &self.problem;
        let (erm, values) = fit.decode(problem.branches());
        let (base, added) = (problem.base_with(erm), fit.structure.added(&values));
        let model = Model::new(&base, &added);
        let shapes = guarded_shapes(&problem.blocks, &model, &self.prior, guards, &mut workspace);
        let residuals: Vec<Vec<f64>> = (0..problem.blocks.len())
            .map(|k| {
                let rows = problem.predict(fit.at(), k, 1, &mut workspace);
                problem.blocks[k]
                    .measured
                    .iter()
                    .zip(rows)
                    .map(|(m, p)| m - p)
                    .collect()
            })
            .collect();
        self.estimate = estimate(&problem.blocks, &shapes, &residuals, &self.prior);
        self.weighed(&shapes)
    }

    /// Noise of the bench's history, without regard to the repeats.
    pub(super) fn of_history(mut self, guards: Guards) -> Result<Self, DataSetError> {
        let problem = &self.problem;
        let shapes = guarded_shapes(
            &problem.blocks,
            &Model::new(&problem.base, &[]),
            &self.prior,
            guards,
            &mut Workspace::default(),
        );
        self.estimate.log_sigmas = self.prior.log_sigmas;
        self.weighed(&shapes)
    }

    /// Weighed by its estimate of the noise.
    fn weighed(mut self, shapes: &[Shape]) -> Result<Self, DataSetError> {
        weigh(&mut self.problem, shapes, &self.estimate)?;
        self.sample_noise_v = (self.estimate.variance(Term::White)
            + self.prior.sample_variance(&self.problem.base))
        .sqrt();
        Ok(self)
    }

    /// Returns the same problem with other measurements of the same campaign, under the determined
    /// noise.
    pub(super) fn with_runs(mut self, set: &DataSet) -> Result<Self, DataSetError> {
        let problem = &mut self.problem;
        problem.blocks = blocks(set, &problem.base)?;
        let mut workspace = Workspace::default();
        let shapes = shapes(
            &problem.blocks,
            &Model::new(&problem.base, &[]),
            &self.prior,
            &mut workspace,
        );
        weigh(problem, &shapes, &self.estimate)?;
        Ok(self)
    }

    /// Returns the problem of runs that are yet to be measured, under the noise found. Repeats make
    /// a run's own noise that much smaller, not what all runs share.
    pub(super) fn planned(
        &self,
        runs: &[PlannedRun],
        workspace: &mut Workspace,
    ) -> Result<Problem, DataSetError> {
        let base = &self.problem.base;
        let linear = self
            .problem
            .blocks
            .iter()
            .any(|b| matches!(&b.kind, Kind::Time(t) if t.linear));
        let between = if linear {
            Between::Linear
        } else {
            Between::Hold
        };
        let stated_v = stated_noise_v(&self.problem.blocks);
        let mut planned = Problem::unweighed(base.clone(), Vec::new());
        for run in runs {
            let mut block = Block::new(
                &run.unmeasured(between, stated_v),
                base,
                self.prior.jitter_a(),
            )?;
            // The campaign moved its charge first. Then the cell is taken to the planned state of
            // charge.
            let last = self.problem.blocks.iter().rev().find(|b| b.at.is_cell);
            block.before = last.map_or_else(Vec::new, |last| {
                last.charge_until(run.soc, base.ocv.capacity_ah)
            });
            block.lies_as(&self.problem.blocks);
            let mut shape = Shape::new(&block, &Model::new(base, &[]), &self.prior, workspace);
            shape.share_codes(run.repeat);
            let covariance = shape.whole_covariance(&self.estimate.log_sigmas, run.repeat);
            let singular = DataSetError::Run {
                run: run.name.clone(),
                expected: "noise that is not zero",
                met: "a singular covariance".to_owned(),
            };
            planned
                .whiteners
                .push(Whitener::new(covariance, block.rows()).ok_or(singular)?);
            planned.blocks.push(block);
        }
        Ok(planned)
    }
}

/// Returns the root mean square of the stated noise of the records' rows, V, or `None` if no noise
/// is stated.
fn stated_noise_v(blocks: &[Block]) -> Option<f64> {
    let times = blocks.iter().filter_map(|b| {
        if let Kind::Time(t) = &b.kind {
            Some(t)
        } else {
            None
        }
    });
    let all: Vec<f64> = times
        .flat_map(|t| &t.bins)
        .map(|b| b.stated_v2 * (b.to - b.from) as f64)
        .filter(|v| *v > 0.0)
        .collect();
    (!all.is_empty()).then(|| (all.iter().sum::<f64>() / all.len() as f64).sqrt())
}

fn facts(set: &DataSet, ocv: &OcvCurve) -> Facts {
    let mut f = Facts::NONE;
    let (mut socs, mut temperatures) = ((Vec::new(), Vec::new()), (Vec::new(), Vec::new()));
    let (mut orders, mut starts) = (
        (f64::INFINITY, f64::NEG_INFINITY),
        (f64::INFINITY, f64::NEG_INFINITY),
    );
    let widen = |span: &mut (f64, f64), v: f64| *span = (span.0.min(v), span.1.max(v));
    for run in &set.runs {
        widen(&mut orders, f64::from(run.order));
        widen(&mut starts, run.start_s);
        let soc = run.start.soc(ocv);
        let is_cell = matches!(run.fixture, Fixture::Cell(_));
        let (by_kind, warm) = match &run.data {
            RunData::Eis(sweep) => {
                for p in &sweep.points {
                    f.lowest_hz = Some(f.lowest_hz.map_or(p.freq_hz, |l: f64| l.min(p.freq_hz)));
                    f.highest_hz = Some(f.highest_hz.map_or(p.freq_hz, |h: f64| h.max(p.freq_hz)));
                }
                (&mut socs.0, &mut temperatures.0)
            }
            RunData::Time(record) => {
                let s = &record.series;
                f.longest_s = f
                    .longest_s
                    .max(s.time_s.last().unwrap_or(&0.0) - s.time_s.first().unwrap_or(&0.0));
                f.shortest_s = s
                    .time_s
                    .windows(2)
                    .fold(f.shortest_s, |m, w| m.min(w[1] - w[0]));
                f.greatest_a = s.current_a.iter().fold(f.greatest_a, |m, i| m.max(i.abs()));
                let (low, high) = s
                    .charge_coulomb()
                    .iter()
                    .fold((0.0f64, 0.0f64), |(a, b), q| (a.min(*q), b.max(*q)));
                f.widest_soc = f.widest_soc.max((high - low) / (3600.0 * ocv.capacity_ah));
                (&mut socs.1, &mut temperatures.1)
            }
        };
        if is_cell {
            by_kind.extend(soc);
            warm.push(run.temperature_degc);
        }
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let choose = |(spectra, records): &(Vec<f64>, Vec<f64>), otherwise: f64| match (
        spectra.is_empty(),
        records.is_empty(),
    ) {
        (false, _) => mean(spectra),
        (true, false) => mean(records),
        (true, true) => otherwise,
    };
    (f.soc, f.temperature_degc) = (choose(&socs, 0.5), choose(&temperatures, 25.0));
    (f.orders, f.span_s) = (orders.1 - orders.0, starts.1 - starts.0);
    f
}
