//! Residuals, derivatives and fits of a structure to the training runs.

use super::block::{Block, Current, Model, Workspace};
use super::data::Role;
use super::shared::Shared;
use super::structure::{At, Axis, Member, Structure, at_bound};
use super::whitening::{Whitener, dot};
use crate::thresholds::{CONVERGED, CONVERGED_PART, ROUGH_PART};
use analysis_effects::contract::Base;
use analysis_model::model::Erm;
use analysis_numeric::linalg::{cholesky, cholesky_substitute, invert};

/// Steps of a fit at most.
const ITERATIONS: usize = 60;
/// A fit ends when less χ² than this is promised.
const PROMISE: f64 = 2e-3;
/// The same as a part of χ², which is far above its floor while an effect is missing.
const PROMISE_PART: f64 = 1e-6;
/// Part of its promise that a step must keep for less damping, and for the base's derivatives to
/// serve again.
const KEPT_PROMISE: f64 = 0.5;
/// Growth of the damping after a failed step; it doubles with each (Nielsen, IMM-REP-1999-05).
const DAMPING_GROWTH: f64 = 2.0;
/// Part of a step over which its bend is measured.
const BEND_PART: f64 = 0.1;
/// Largest second-order part of a step, relative to the first: 0.75, as its source recommends.
const MOST_ACCELERATION: f64 = 0.75;
/// Information given to a coordinate in any case: a move by 1 changes the prediction by less than
/// 1e-4 standard deviations.
const UNMOVED: f64 = 1e-8;

/// Everything that stays while structures change.
#[derive(Debug, Clone)]
pub(super) struct Problem {
    /// The effects of the judged model, at its values.
    pub(super) given: Structure,
    pub(super) base: Base,
    pub(super) blocks: Vec<Block>,
    /// Of a run's own errors for training runs, of all errors for others.
    pub(super) whiteners: Vec<Whitener>,
    /// Takes what all training runs share out of their whitened rows.
    pub(super) shared: Shared,
    /// Standard deviation of every row of every block.
    pub(super) floors: Vec<Vec<f64>>,
    /// Rows of every block that lie at an edge of the current.
    pub(super) at_edges: Vec<Vec<bool>>,
    /// Whitened errors of every block that its repeats may have too.
    pub(super) repeating: Vec<Vec<f64>>,
}

/// Prediction for the runs of a role.
#[derive(Debug, Clone)]
pub(super) struct Prediction {
    /// Whitened rows of all of them.
    pub(super) white: Vec<f64>,
    /// Rows by block; empty for other blocks.
    rows: Vec<Vec<f64>>,
}

/// Start and end conditions of a fit.
#[derive(Clone, Copy)]
struct Nearby<'a> {
    /// Derivatives by the first coordinates, taken nearby.
    columns: &'a [Vec<f64>],
    /// Whether the fit ends early, possibly on derivatives from a nearby point.
    is_rough: bool,
}

/// A fitted structure.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    pub(super) structure: Structure,
    pub(super) x: Vec<f64>,
    pub(super) axes: Vec<Axis>,
    /// χ² of the training rows.
    pub(super) chi2: f64,
    /// Whitened residuals of the training rows, measured less predicted.
    pub(super) residuals: Vec<f64>,
    /// Derivatives of the whitened prediction, one column per parameter.
    pub(super) columns: Vec<Vec<f64>>,
    /// χ² that a further step is expected to gain; infinite if it was not computed.
    pub(super) promise: f64,
}

impl Problem {
    /// Without any noise yet.
    pub(super) fn unweighed(base: Base, blocks: Vec<Block>) -> Self {
        Self {
            given: Structure::default(),
            base,
            blocks,
            whiteners: Vec::new(),
            shared: Shared::default(),
            floors: Vec::new(),
            at_edges: Vec::new(),
            repeating: Vec::new(),
        }
    }

    pub(super) fn branches(&self) -> usize {
        self.base.erm.branches.len()
    }

    /// Returns the start of a fit without one member: the values of the others.
    pub(super) fn without(&self, fit: &Fit, member: usize) -> (Structure, Vec<f64>, Vec<Axis>) {
        let structure = fit.structure.without(member);
        let axes = structure.axes(&self.base.erm);
        let first = fit.structure.first(member, self.branches());
        let mut x = fit.x.clone();
        x.drain(first..first + fit.structure.members[member].free());
        (structure, x, axes)
    }

    /// Coordinates of the model file's own base.
    pub(super) fn start(&self) -> Vec<f64> {
        Structure::default().encode(&self.base.erm)
    }

    /// Returns the rows of the training runs.
    pub(super) fn training_rows(&self) -> usize {
        self.of_role(Role::Train)
            .map(|k| self.blocks[k].rows())
            .sum()
    }

    /// Penalty for parameters and choices of an effect: k·ln N, and twice the logarithm of the
    /// number of choices.
    pub(super) fn penalty(&self, member: &Member) -> f64 {
        member.free() as f64 * (self.training_rows() as f64).ln()
            + 2.0 * (member.choices() as f64).ln()
    }

    /// Price of the parameters of all effects that a fit has more than its base.
    pub(super) fn spent(&self, base: &Fit, fit: &Fit) -> f64 {
        let members = fit.structure.members.iter();
        let own = members.skip(base.structure.members.len());
        own.map(|m| self.penalty(m)).sum()
    }

    /// Training rows less parameters.
    pub(super) fn degrees_of_freedom(&self, fit: &Fit) -> f64 {
        self.training_rows() as f64 - fit.x.len() as f64
    }

    pub(super) fn of_role(&self, role: Role) -> impl Iterator<Item = usize> {
        self.blocks
            .iter()
            .enumerate()
            .filter(move |(_, b)| b.role == role)
            .map(|(k, _)| k)
    }

    /// Residuals of a fit in each training run, whitened.
    pub(super) fn whitened_residuals<'a>(
        &'a self,
        fit: &'a Fit,
    ) -> impl Iterator<Item = (usize, &'a Block, &'a [f64])> {
        let mut rest = fit.residuals.as_slice();
        self.of_role(Role::Train).map(move |k| {
            let (own, others) = rest.split_at(self.blocks[k].rows());
            rest = others;
            (k, &self.blocks[k], own)
        })
    }

    /// Returns the base with another ERM.
    pub(super) fn base_with(&self, erm: Erm) -> Base {
        Base {
            erm,
            ..self.base.clone()
        }
    }

    /// Predicted rows of one block, every step divided into `parts` times as many as the structure
    /// wants.
    pub(super) fn predict(
        &self,
        at: At<'_>,
        block: usize,
        parts: usize,
        workspace: &mut Workspace,
    ) -> Vec<f64> {
        self.predict_under(at, block, Current::Logged, parts, workspace)
    }

    /// The same under the current as it was logged or driven.
    pub(super) fn predict_under(
        &self,
        at: At<'_>,
        block: usize,
        current: Current,
        parts: usize,
        workspace: &mut Workspace,
    ) -> Vec<f64> {
        let At { structure, x } = at;
        let (erm, values) = structure.decode(x, self.branches());
        let base = self.base_with(erm);
        let added = structure.added(&values);
        let mut rows = Vec::with_capacity(self.blocks[block].rows());
        self.blocks[block].predict_under(
            &Model::new(&base, &added),
            current,
            structure.parts * parts,
            workspace,
            &mut rows,
        );
        rows
    }

    /// Returns the prediction of the training runs.
    pub(super) fn prediction(&self, at: At<'_>, workspace: &mut Workspace) -> Prediction {
        self.prediction_of(Role::Train, at, workspace)
    }

    /// Whitened predictions of the rows of a role.
    pub(super) fn whitened_of(
        &self,
        role: Role,
        at: At<'_>,
        workspace: &mut Workspace,
    ) -> Vec<f64> {
        self.prediction_of(role, at, workspace).white
    }

    fn prediction_of(&self, role: Role, at: At<'_>, workspace: &mut Workspace) -> Prediction {
        let At { structure, x } = at;
        let (erm, values) = structure.decode(x, self.branches());
        let base = self.base_with(erm);
        let added = structure.added(&values);
        let model = Model::new(&base, &added);
        let mut white = Vec::with_capacity(self.training_rows());
        let mut rows: Vec<Vec<f64>> = vec![Vec::new(); self.blocks.len()];
        for k in self.of_role(role) {
            rows[k].reserve(self.blocks[k].rows());
            self.blocks[k].predict(&model, structure.parts, workspace, &mut rows[k]);
            self.whiteners[k].apply(&rows[k], &mut white);
        }
        self.take_shared(role, &mut white);
        Prediction { white, rows }
    }

    fn take_shared(&self, role: Role, rows: &mut [f64]) {
        if role == Role::Train {
            self.shared.apply(rows);
        }
    }

    /// Whitened measured training rows.
    pub(super) fn target(&self) -> Vec<f64> {
        self.target_of(Role::Train)
    }

    /// Whitened measured rows of a role.
    pub(super) fn target_of(&self, role: Role) -> Vec<f64> {
        let mut all = Vec::with_capacity(self.training_rows());
        self.of_role(role)
            .for_each(|k| self.whiteners[k].apply(&self.blocks[k].measured, &mut all));
        self.take_shared(role, &mut all);
        all
    }

    /// Whitened residuals of the held-out rows, and derivatives of their prediction, one column per
    /// coordinate.
    pub(super) fn held_out(
        &self,
        fit: &Fit,
        workspace: &mut Workspace,
    ) -> (Vec<f64>, Vec<Vec<f64>>) {
        let predicted = self.whitened_of(Role::HeldOut, fit.at(), workspace);
        let residual = self
            .target_of(Role::HeldOut)
            .iter()
            .zip(&predicted)
            .map(|(t, p)| t - p)
            .collect();
        let column = |k: usize| {
            let mut x = fit.x.clone();
            let step = fit.axes[k].inwards(x[k]);
            x[k] += step;
            let moved = self.whitened_of(Role::HeldOut, fit.structure.at(&x), workspace);
            moved
                .iter()
                .zip(&predicted)
                .map(|(m, p)| (m - p) / step)
                .collect()
        };
        (residual, (0..fit.x.len()).map(column).collect())
    }

    /// Whitened χ² of one block at a vector.
    pub(super) fn block_chi2(&self, at: At<'_>, block: usize, workspace: &mut Workspace) -> f64 {
        let rows = self.predict(at, block, 1, workspace);
        let difference: Vec<f64> = self.blocks[block]
            .measured
            .iter()
            .zip(&rows)
            .map(|(m, p)| m - p)
            .collect();
        let mut w = Vec::with_capacity(rows.len());
        self.whiteners[block].apply(&difference, &mut w);
        dot(&w, &w)
    }

    /// Returns the change of the whitened prediction when a coordinate changes by a step. A run
    /// that repeats another one changes as that one does, unless an effect distinguishes repeats.
    pub(super) fn change(
        &self,
        at: At<'_>,
        predicted: &Prediction,
        moved: usize,
        step: f64,
        workspace: &mut Workspace,
    ) -> Vec<f64> {
        let each = at.structure.tells_repeats_apart();
        self.changes(at, predicted, moved, step, each, workspace)
    }

    /// Returns the same change for each run separately, or by the run that it repeats.
    fn changes(
        &self,
        at: At<'_>,
        predicted: &Prediction,
        moved: usize,
        step: f64,
        each: bool,
        workspace: &mut Workspace,
    ) -> Vec<f64> {
        let structure = at.structure;
        let mut x = at.x.to_vec();
        x[moved] += step;
        let (erm, values) = structure.decode(&x, self.branches());
        let base = self.base_with(erm);
        let added = structure.added(&values);
        let model = Model::new(&base, &added);
        let mut white = Vec::with_capacity(self.training_rows());
        let mut changes: Vec<Vec<f64>> = vec![Vec::new(); self.blocks.len()];
        for k in self.of_role(Role::Train) {
            let of = self.blocks[k].alike.filter(|_| !each).unwrap_or(k);
            if of == k {
                self.blocks[k].predict(&model, structure.parts, workspace, &mut changes[k]);
                changes[k]
                    .iter_mut()
                    .zip(&predicted.rows[k])
                    .for_each(|(c, p)| *c -= p);
            }
            self.whiteners[k].apply(&changes[of], &mut white);
        }
        self.shared.apply(&mut white);
        white
    }

    /// Returns the tangent space of a fit, each run separately: repeats are not merged.
    pub(super) fn exact_tangent(&self, fit: &Fit, workspace: &mut Workspace) -> Tangent {
        let predicted = self.prediction(fit.at(), workspace);
        let mut tangent = Tangent::default();
        for (k, axis) in fit.axes.iter().enumerate() {
            let step = axis.inwards(fit.x[k]);
            tangent.add(self.changes(fit.at(), &predicted, k, step, true, workspace));
        }
        tangent
    }

    /// Derivatives of the whitened prediction of the training rows.
    pub(super) fn columns(
        &self,
        at: At<'_>,
        axes: &[Axis],
        predicted: &Prediction,
        workspace: &mut Workspace,
    ) -> Vec<Vec<f64>> {
        (0..at.x.len())
            .map(|k| self.column(at, axes, predicted, k, workspace))
            .collect()
    }

    /// Returns the derivative by one coordinate.
    fn column(
        &self,
        at: At<'_>,
        axes: &[Axis],
        predicted: &Prediction,
        k: usize,
        workspace: &mut Workspace,
    ) -> Vec<f64> {
        let step = axes[k].inwards(at.x[k]);
        let mut column = self.change(at, predicted, k, step, workspace);
        column.iter_mut().for_each(|c| *c /= step);
        column
    }

    /// Fits a structure from its members' starts and a base.
    pub(super) fn fit(&self, structure: &Structure, start: &Erm, workspace: &mut Workspace) -> Fit {
        let axes = structure.axes(&self.base.erm);
        let mut x = structure.encode(start);
        put_inside(&mut x, &axes);
        self.fit_from(structure, x, axes, workspace)
    }

    /// Fits a structure with one further effect, starting from a fit without it. A rough fit ends
    /// early and uses the derivatives of a nearby fit.
    pub(super) fn fit_added(
        &self,
        fit: &Fit,
        member: &Member,
        is_rough: bool,
        workspace: &mut Workspace,
    ) -> Fit {
        let structure = fit.structure.with(member.clone());
        let axes = structure.axes(&self.base.erm);
        let mut x = fit.x.clone();
        x.extend(member.encode());
        put_inside(&mut x, &axes);
        let nearby = Nearby {
            columns: &fit.columns,
            is_rough,
        };
        self.fit_by(&structure, x, axes, nearby, workspace)
    }

    /// Returns a structure at a vector, as it is.
    pub(super) fn at(
        &self,
        structure: &Structure,
        x: Vec<f64>,
        axes: Vec<Axis>,
        workspace: &mut Workspace,
    ) -> Fit {
        let predicted = self.prediction(structure.at(&x), workspace);
        let residuals: Vec<f64> = self
            .target()
            .iter()
            .zip(&predicted.white)
            .map(|(t, p)| t - p)
            .collect();
        let columns = self.columns(structure.at(&x), &axes, &predicted, workspace);
        Fit {
            structure: structure.clone(),
            x,
            axes,
            chi2: dot(&residuals, &residuals),
            residuals,
            columns,
            promise: f64::INFINITY,
        }
    }

    /// Fits a structure from a vector.
    pub(super) fn fit_from(
        &self,
        structure: &Structure,
        x: Vec<f64>,
        axes: Vec<Axis>,
        workspace: &mut Workspace,
    ) -> Fit {
        let nothing = Nearby {
            columns: &[],
            is_rough: false,
        };
        self.fit_by(structure, x, axes, nothing, workspace)
    }

    /// Completes a rough fit.
    pub(super) fn polished(&self, fit: Fit, workspace: &mut Workspace) -> Fit {
        if fit.promise < enough(false, fit.chi2) {
            return fit;
        }
        let nearby = Nearby {
            columns: &fit.columns,
            is_rough: false,
        };
        self.fit_by(&fit.structure, fit.x, fit.axes, nearby, workspace)
    }

    /// Returns the second derivative of the whitened prediction along moves, by differences over a
    /// part of them, or `None` if that part does not lie between the bounds.
    fn bend(
        &self,
        at: At<'_>,
        axes: &[Axis],
        moves: &[f64],
        predicted: &Prediction,
        workspace: &mut Workspace,
    ) -> Option<Vec<f64>> {
        let mut along = |part: f64| {
            let x: Vec<f64> = at.x.iter().zip(moves).map(|(x, s)| x + part * s).collect();
            let mut inside = x.iter().zip(axes);
            inside
                .all(|(x, a)| (a.lower..=a.upper).contains(x))
                .then(|| self.prediction(at.structure.at(&x), workspace).white)
        };
        let (there, back) = (along(BEND_PART)?, along(-BEND_PART)?);
        let rows = there.iter().zip(&back).zip(&predicted.white);
        Some(
            rows.map(|((there, back), here)| (there - 2.0 * here + back) / (BEND_PART * BEND_PART))
                .collect(),
        )
    }

    /// A Levenberg–Marquardt fit. In a curved valley the steps follow its bend (geodesic
    /// acceleration, Transtrum and Sethna, arXiv 1201.5885).
    fn fit_by(
        &self,
        structure: &Structure,
        mut x: Vec<f64>,
        axes: Vec<Axis>,
        nearby: Nearby<'_>,
        workspace: &mut Workspace,
    ) -> Fit {
        let target = self.target();
        let difference = |p: &Prediction| {
            target
                .iter()
                .zip(&p.white)
                .map(|(t, p)| t - p)
                .collect::<Vec<f64>>()
        };
        let mut predicted = self.prediction(structure.at(&x), workspace);
        let mut residuals = difference(&predicted);
        let mut chi2 = dot(&residuals, &residuals);
        let mut columns = nearby.columns.to_vec();
        for k in columns.len()..x.len() {
            columns.push(self.column(structure.at(&x), &axes, &predicted, k, workspace));
        }
        // Derivatives by the base's parameters are recomputed only if they have performed badly:
        // they dominate the cost of a fit, and the base moves little.
        let own = 1 + 2 * self.branches();
        let mut are_fresh = nearby.columns.is_empty();
        // Once a step has failed, the way is taken for a curved one.
        let mut is_curved = false;
        let (mut damping, mut growth) = (1e-4, DAMPING_GROWTH);
        for _ in 0..ITERATIONS {
            let Some(normal) = Normal::new(&columns, &residuals, &axes, &x, damping) else {
                break;
            };
            let (mut moves, promise) = normal.step(&columns, &residuals, &axes);
            let enough = enough(nearby.is_rough, chi2);
            let ends = promise < enough;
            if ends && (are_fresh || nearby.is_rough) {
                break;
            }
            let at = structure.at(&x);
            let mut is_straight = true;
            if is_curved && are_fresh && !ends {
                let bend = self.bend(at, &axes, &moves, &predicted, workspace);
                is_straight =
                    bend.is_none_or(|bend| normal.accelerate(&columns, &bend, &mut moves));
            }
            let mut gained = 0.0;
            if !ends && is_straight {
                let trial: Vec<f64> = x
                    .iter()
                    .zip(&moves)
                    .zip(&axes)
                    .map(|((x, s), a)| {
                        let s = s.clamp(-a.longest, a.longest);
                        (x + s).clamp(a.lower, a.upper)
                    })
                    .collect();
                let moved = self.prediction(structure.at(&trial), workspace);
                let residual = difference(&moved);
                let value = dot(&residual, &residual);
                gained = chi2 - value;
                if gained > 0.0 {
                    (x, predicted, residuals, chi2) = (trial, moved, residual, value);
                }
            }
            let at = structure.at(&x);
            let keeps = gained > KEPT_PROMISE * promise;
            if keeps {
                (damping, growth) = (0.1 * damping, DAMPING_GROWTH);
            }
            if keeps && !is_curved {
                let added = columns.iter_mut().enumerate().skip(own);
                added.for_each(|(k, column)| {
                    *column = self.column(at, &axes, &predicted, k, workspace);
                });
                are_fresh = false;
            } else if gained > 0.0 || !are_fresh {
                columns = self.columns(at, &axes, &predicted, workspace);
                if are_fresh && gained < enough {
                    break;
                }
                is_curved |= are_fresh;
                are_fresh = true;
            } else {
                is_curved = true;
                damping = (damping * growth).max(1e-6);
                growth *= 2.0;
                if damping > 1e8 {
                    break;
                }
            }
        }
        if !are_fresh && !nearby.is_rough {
            columns = self.columns(structure.at(&x), &axes, &predicted, workspace);
            are_fresh = true;
        }
        let promise = if are_fresh {
            step(&columns, &residuals, &axes, &x, 0.0).map_or(0.0, |(_, promise)| promise)
        } else {
            f64::INFINITY
        };
        Fit {
            structure: structure.clone(),
            x,
            axes,
            chi2,
            residuals,
            columns,
            promise,
        }
    }
}

/// Moves coordinates beyond their bounds to the bounds.
fn put_inside(x: &mut [f64], axes: &[Axis]) {
    x.iter_mut()
        .zip(axes)
        .for_each(|(x, a)| *x = x.clamp(a.lower, a.upper));
}

/// Returns the predicted χ² gain of a further step below which a fit ends.
fn enough(is_rough: bool, chi2: f64) -> f64 {
    if is_rough {
        CONVERGED.max(ROUGH_PART * chi2)
    } else {
        PROMISE.max(PROMISE_PART * chi2)
    }
}

/// A damped Gauss–Newton step of the coordinates that no bound holds, and the decrease of χ² that
/// it promises.
pub(super) fn step(
    columns: &[Vec<f64>],
    residuals: &[f64],
    axes: &[Axis],
    x: &[f64],
    damping: f64,
) -> Option<(Vec<f64>, f64)> {
    let normal = Normal::new(columns, residuals, axes, x, damping)?;
    Some(normal.step(columns, residuals, axes))
}

/// Damped normal equations of the coordinates that no bound holds.
struct Normal {
    free: Vec<usize>,
    /// Squared sizes of the free columns.
    diagonal: Vec<f64>,
    /// Cholesky factor of the damped matrix.
    factor: Vec<f64>,
}

impl Normal {
    fn new(
        columns: &[Vec<f64>],
        residuals: &[f64],
        axes: &[Axis],
        x: &[f64],
        damping: f64,
    ) -> Option<Self> {
        let held = |k: usize| {
            let gradient = dot(&columns[k], residuals);
            let tiny = 1e-12 * (1.0 + x[k].abs());
            (x[k] <= axes[k].lower + tiny && gradient <= 0.0)
                || (x[k] >= axes[k].upper - tiny && gradient >= 0.0)
        };
        let free: Vec<usize> = (0..x.len()).filter(|k| !held(*k)).collect();
        let m = free.len();
        if m == 0 {
            return None;
        }
        let mut factor = vec![0.0; m * m];
        for (i, k) in free.iter().enumerate() {
            for (j, l) in free.iter().enumerate().take(i + 1) {
                let value = dot(&columns[*k], &columns[*l]);
                factor[i * m + j] = value;
                factor[j * m + i] = value;
            }
        }
        let diagonal: Vec<f64> = (0..m).map(|i| factor[i * m + i]).collect();
        for i in 0..m {
            factor[i * m + i] += damping * diagonal[i] + 1e-9;
        }
        cholesky(&mut factor, m).then_some(Self {
            free,
            diagonal,
            factor,
        })
    }

    /// Returns the free moves whose change of the prediction is nearest to `rows`, damped.
    fn solve(&self, columns: &[Vec<f64>], rows: &[f64]) -> Vec<f64> {
        let mut part: Vec<f64> = self.free.iter().map(|k| dot(&columns[*k], rows)).collect();
        cholesky_substitute(&self.factor, self.free.len(), &mut part);
        part
    }

    fn step(&self, columns: &[Vec<f64>], residuals: &[f64], axes: &[Axis]) -> (Vec<f64>, f64) {
        let part = self.solve(columns, residuals);
        let promise = part
            .iter()
            .zip(&self.free)
            .map(|(s, k)| s * dot(&columns[*k], residuals))
            .sum();
        let mut moves = vec![0.0; columns.len()];
        // Each is tested separately: one that the data hardly determine must not hold the others
        // up.
        self.free
            .iter()
            .zip(&part)
            .for_each(|(k, s)| moves[*k] = s.clamp(-axes[*k].longest, axes[*k].longest));
        (moves, promise)
    }

    /// Adds the curvature correction of the prediction to moves; returns false if the correction is
    /// not small relative to them.
    fn accelerate(&self, columns: &[Vec<f64>], bend: &[f64], moves: &mut [f64]) -> bool {
        let more = self.solve(columns, bend);
        let size = |part: &[f64]| {
            let squares = part.iter().zip(&self.diagonal).map(|(p, d)| p * p * d);
            squares.sum::<f64>().sqrt()
        };
        let first: Vec<f64> = self.free.iter().map(|k| moves[*k]).collect();
        if size(&more) > MOST_ACCELERATION * size(&first) {
            return false;
        }
        self.free
            .iter()
            .zip(&more)
            .for_each(|(k, more)| moves[*k] -= 0.5 * more);
        true
    }
}

impl Fit {
    pub(super) fn at(&self) -> At<'_> {
        self.structure.at(&self.x)
    }

    /// Returns the fitted ERM and the values of the effects.
    pub(super) fn decode(&self, branches: usize) -> (Erm, Vec<Vec<f64>>) {
        self.structure.decode(&self.x, branches)
    }

    /// Returns true if the predicted gain of a further step is negligible against a gain of λ.
    pub(super) fn has_converged(&self, lambda: f64) -> bool {
        self.promise <= CONVERGED.max(CONVERGED_PART * lambda)
    }

    /// Returns the covariance of the coordinates, row-major, or `None` if the data do not determine
    /// them.
    pub(super) fn covariance(&self) -> Option<Vec<f64>> {
        let n = self.x.len();
        let mut information: Vec<f64> = (0..n * n)
            .map(|ij| dot(&self.columns[ij / n], &self.columns[ij % n]))
            .collect();
        // A coordinate that moves nothing must not take the uncertainty of all others away.
        (0..n).for_each(|i| information[i * n + i] += UNMOVED);
        invert(&information, n)
    }

    /// Returns true if a coordinate of a member lies at a bound.
    pub(super) fn member_at_bound(&self, member: usize, branches: usize) -> bool {
        let first = self.structure.first(member, branches);
        (first..first + self.structure.members[member].free())
            .any(|k| at_bound(self.x[k], &self.axes[k]))
    }

    /// Another fit's structure at the coordinates that this one, which has more effects, gives to
    /// it.
    pub(super) fn base_of(&self, other: &Self) -> Self {
        Self {
            x: self.x[..other.x.len()].to_vec(),
            columns: self.columns[..other.x.len()].to_vec(),
            ..other.clone()
        }
    }

    /// Returns an orthonormal basis of the tangent space.
    pub(super) fn tangent(&self) -> Tangent {
        let mut tangent = Tangent::default();
        self.columns.iter().for_each(|c| tangent.add(c.clone()));
        tangent
    }
}

/// An orthonormal basis of the changes that a model can already imitate.
#[derive(Debug, Clone, Default)]
pub(super) struct Tangent {
    pub(super) basis: Vec<Vec<f64>>,
}

impl Tangent {
    /// Takes the part of a vector outside the basis into it, unless nothing is left.
    pub(super) fn add(&mut self, mut column: Vec<f64>) {
        let size = dot(&column, &column).sqrt();
        self.project(&mut column);
        self.project(&mut column);
        let residual = dot(&column, &column).sqrt();
        if residual > 1e-7 * size && residual > 0.0 {
            column.iter_mut().for_each(|c| *c /= residual);
            self.basis.push(column);
        }
    }

    /// Takes the part inside the basis off a vector.
    pub(super) fn project(&self, v: &mut [f64]) {
        for q in &self.basis {
            let along = dot(q, v);
            v.iter_mut().zip(q).for_each(|(v, q)| *v -= along * q);
        }
    }
}
