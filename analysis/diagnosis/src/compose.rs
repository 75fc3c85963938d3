//! A model of several formulas that predicts the held-out runs: its test, its shares, and its place
//! in the diagnosis if it names mechanisms.

use super::block::{Kind, Workspace};
use super::data::Role;
use super::gap::{Fits, gaps, rms_mv, sample_floor, samples, spectrum_gaps};
use super::guards::Guards;
use super::localise::localise;
use super::options::DiagnosisOptions;
use super::outcome::{Curves, Diagnosis, Gap, Predictive, Quality, RunCurves, Share};
use super::predictive::described;
use super::prepare::{BaseModel, Prepared};
use super::problem::{Fit, Problem};
use super::search::{Search, excess_z};
use crate::thresholds::FEWEST_REPEATS;
use analysis_model::model::Erm;
use num_complex::Complex64;

/// A base and the same with several formulas, under one noise.
pub(super) struct Composed {
    pub(super) prepared: Prepared,
    base: Fit,
    fit: Fit,
}

impl Composed {
    /// Returns the fits under the noise about the cell with its formulas, as named effects are
    /// fitted, then under the noise that they were found with.
    pub(super) fn under_both_noises(
        prepared: &Prepared,
        base: &Fit,
        fit: Fit,
        guards: Guards,
    ) -> impl Iterator<Item = Self> {
        let again = refitted(prepared, [base, &fit], guards);
        let again = again.map(|(prepared, [base, fit])| Self {
            prepared,
            base,
            fit,
        });
        let found = Self {
            prepared: prepared.clone(),
            base: base.clone(),
            fit,
        };
        again.into_iter().chain(std::iter::once(found))
    }

    fn fits(&self) -> Fits<'_> {
        Fits {
            base: &self.base,
            augmented: &self.fit,
        }
    }

    /// Returns the model with its description, or `None` if it makes a held-out record worse than
    /// the base does, or is no better over all of them than the base and the refit of the diagnosis.
    pub(super) fn tested(
        self,
        model: &BaseModel,
        options: &DiagnosisOptions,
        guards: Guards,
        refit_mv: f64,
    ) -> Option<(Self, Predictive)> {
        let mut search = search(&self.prepared, options, guards);
        search.no_prediction_worse(&self.base, &self.fit).ok()?;
        let mut workspace = Workspace::default();
        let found = described(&self.prepared, &model.erm, self.fits(), &mut workspace)?;
        let [before, after] = [|gap: &Gap| gap.base_mv, |gap: &Gap| gap.augmented_mv]
            .map(|of| rms_mv(&found.gap, of));
        (after < before.min(refit_mv)).then_some((self, found))
    }

    /// Returns the shares of its mechanisms.
    pub(super) fn shares(
        &self,
        model: &BaseModel,
        options: &DiagnosisOptions,
        guards: Guards,
    ) -> Vec<Share> {
        options
            .progress
            .tell("computing the shares of the mechanisms");
        search(&self.prepared, options, guards).shares(&self.prepared, &model.erm, self.fits())
    }

    /// Describes these fits in place of those of the named effects, and returns their curves.
    pub(super) fn describe(&self, d: &mut Diagnosis, model: &BaseModel) -> Vec<RunCurves> {
        let (prepared, fits) = (&self.prepared, self.fits());
        let problem = &prepared.problem;
        let mut workspace = Workspace::default();
        d.blocks = localise(problem, fits.base, true, &mut workspace);
        d.where_after = localise(problem, fits.augmented, true, &mut workspace);
        d.base = Some(fits.base.decode(problem.branches()).0);
        d.gap = gaps(prepared, &model.erm, fits, &mut workspace);
        d.gap_spectra = spectrum_gaps(problem, &model.erm, fits, &mut workspace);
        d.quality = quality(problem, fits.base, fits.augmented);
        d.augmented = Some(fits.augmented.decode(problem.branches()).0);
        curves(prepared, &model.erm, fits, &mut workspace)
    }
}

/// Refits base and named effects under noise computed about the cell with its effects: a scatter of
/// all resistances does not affect a contact, and the effect of a current error on the voltage
/// depends on the missing parts of the base.
pub(super) fn refitted(
    prepared: &Prepared,
    [base, fit]: [&Fit; 2],
    guards: Guards,
) -> Option<(Prepared, [Fit; 2])> {
    let prepared = prepared.clone().again(fit, guards).ok()?;
    let mut workspace = Workspace::default();
    let again = [base, fit].map(|fit| {
        prepared.problem.fit_from(
            &fit.structure,
            fit.x.clone(),
            fit.axes.clone(),
            &mut workspace,
        )
    });
    Some((prepared, again))
}

pub(super) fn search<'a>(
    prepared: &'a Prepared,
    options: &'a DiagnosisOptions,
    guards: Guards,
) -> Search<'a> {
    let (problem, candidates) = (&prepared.problem, &options.candidates);
    Search {
        problem,
        candidates,
        guards,
        measured: measured(prepared),
        progress: &options.progress,
        workspace: Workspace::default(),
    }
}

/// Returns whether repeats have measured the noise.
pub(super) fn measured(prepared: &Prepared) -> bool {
    prepared.estimate.repeats >= FEWEST_REPEATS
}

pub(super) fn quality(problem: &Problem, base: &Fit, after: &Fit) -> Quality {
    let dof = problem.degrees_of_freedom(base);
    Quality {
        base_chi2: base.chi2,
        degrees_of_freedom: dof,
        base_z: excess_z(base.chi2, dof),
        augmented_chi2: after.chi2,
        augmented_z: excess_z(after.chi2, problem.degrees_of_freedom(after)),
    }
}

pub(super) fn curves(
    prepared: &Prepared,
    erm: &Erm,
    fits: Fits<'_>,
    workspace: &mut Workspace,
) -> Vec<RunCurves> {
    let problem = &prepared.problem;
    let given = &problem.given;
    let start = given.encode(erm);
    let all = [given.at(&start), fits.base.at(), fits.augmented.at()];
    let complex = |rows: &[f64]| {
        rows.chunks_exact(2)
            .map(|z| Complex64::new(z[0], z[1]))
            .collect::<Vec<Complex64>>()
    };
    problem
        .blocks
        .iter()
        .enumerate()
        .map(|(k, block)| {
            let curves = match &block.kind {
                Kind::Eis { points, .. } => {
                    let rows = 2 * points.len();
                    let [eis_only_ohm, base_ohm, augmented_ohm] =
                        all.map(|at| complex(&problem.predict(at, k, 1, workspace)[..rows]));
                    Curves::Eis {
                        freq_hz: points.iter().map(|p| p.freq_hz).collect(),
                        measured_ohm: complex(&block.measured[..rows]),
                        eis_only_ohm,
                        base_ohm,
                        augmented_ohm,
                        floor_ohm: problem.floors[k][..rows]
                            .chunks_exact(2)
                            .map(|f| f[0].hypot(f[1]))
                            .collect(),
                    }
                }
                Kind::Time(time) => {
                    let [eis_only_v, base_v, augmented_v] =
                        all.map(|at| samples(problem, at, k, workspace));
                    Curves::Time {
                        time_s: time.time_s[time.compared()].to_vec(),
                        current_a: time.current_a[time.compared()].to_vec(),
                        measured_v: time.voltage_v[time.compared()].to_vec(),
                        eis_only_v,
                        base_v,
                        augmented_v,
                        floor_v: sample_floor(prepared, k, time),
                    }
                }
            };
            RunCurves {
                name: block.name.clone(),
                held_out: block.role == Role::HeldOut,
                curves,
            }
        })
        .collect()
}
