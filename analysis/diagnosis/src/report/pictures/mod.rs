//! The pictures of a diagnosis. None is made that would be empty.
//!
//! Colours mean the same in all: orange before, blue with the named effects, dark grey the model
//! file alone, green the noise.

mod bars;
mod residuals;

use super::{is_significant, misfit};
use crate::outcome::{Curves, Diagnosis, RunCurves, Verdict};
use analysis_plot::Drawing;

/// Most held-out runs of a kind that get a picture of their own.
const MOST_RUNS: usize = 6;
/// Indices of colours.
const AFTER: usize = 0;
const BEFORE: usize = 1;
const NOISE: usize = 2;
const ALONE: usize = 6;

/// Kind of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Blocks of residuals and their misfit.
    Map,
    /// Residuals of a record over time.
    Time,
    /// Residuals of a spectrum over frequency.
    Spectrum,
    /// Scores of the candidates.
    Ranking,
    /// Gaps of the held-out runs.
    Gap,
    /// Matrix of effects that can be separated.
    Matrix,
}

/// A picture with its words.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// File name without extension.
    pub name: String,
    /// Kind of the picture.
    pub kind: Kind,
    /// A sentence to stand below it.
    pub caption: String,
    /// The picture.
    pub drawing: Drawing,
}

/// The pictures of a diagnosis: the map, the residuals of held-out runs and of the worst training
/// run of each kind, the ranking, the gaps. None for data that cannot be used.
pub fn pictures(d: &Diagnosis, runs: &[RunCurves]) -> Vec<Picture> {
    if d.verdict == Verdict::Invalid {
        return Vec::new();
    }
    let of_kind = |time: bool| {
        runs.iter()
            .filter(move |r| matches!(r.curves, Curves::Time { .. }) == time)
    };
    let shown = chosen(of_kind(true))
        .into_iter()
        .chain(chosen(of_kind(false)));
    let residuals = shown
        .filter_map(|run| residuals::picture(d, run))
        .enumerate();
    let numbered = residuals.map(|(k, p)| Picture {
        name: format!("residual-{}-{}", k + 1, p.name),
        ..p
    });
    bars::map(d)
        .into_iter()
        .chain(numbered)
        .chain(bars::ranking(d))
        .chain(bars::gap(d))
        .collect()
}

/// The held-out runs with the largest misses, in their order, and the worst training run.
fn chosen<'a>(runs: impl Iterator<Item = &'a RunCurves>) -> Vec<&'a RunCurves> {
    let (mut held_out, training): (Vec<&RunCurves>, Vec<&RunCurves>) =
        runs.partition(|r| r.held_out);
    let size = |r: &&RunCurves| residuals::miss(&r.curves);
    let mut sizes: Vec<f64> = held_out.iter().map(size).collect();
    sizes.sort_by(|a, b| b.total_cmp(a));
    if let Some(least) = sizes.get(MOST_RUNS - 1) {
        held_out.retain(|r| size(r) >= *least);
        held_out.truncate(MOST_RUNS);
    }
    held_out.extend(
        training
            .into_iter()
            .max_by(|a, b| size(a).total_cmp(&size(b))),
    );
    held_out
}

/// True where there is more to show than the base model.
fn has_after(d: &Diagnosis) -> bool {
    !d.effects.is_empty()
}

/// The named effects, short enough for a legend.
fn effect_names(d: &Diagnosis) -> String {
    d.effects
        .iter()
        .map(|e| e.name)
        .collect::<Vec<_>>()
        .join(" + ")
}
