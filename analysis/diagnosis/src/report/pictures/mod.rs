//! The pictures of a diagnosis. None is made that would be empty.
//!
//! Colours have the same meaning in all: orange before, blue with the named effects, dark grey the
//! model file alone, green the noise.

mod bars;
mod held_out;
mod picture;
mod residuals;

use super::{is_significant, misfit};
use crate::outcome::{Curves, Diagnosis, RunCurves, Verdict};
use picture::{AFTER, ALONE, BEFORE, NOISE, effect_names, file_name, has_after};
pub use picture::{Kind, Picture};

/// Most held-out runs of a kind that get a picture of their own.
const MOST_RUNS: usize = 6;

/// Returns the pictures of a diagnosis: the gap of each held-out run, the map, the residuals of
/// held-out runs and of the worst training run of each kind, the ranking, the gaps. None for data
/// that cannot be used.
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
    held_out::held_out(d)
        .into_iter()
        .chain(bars::map(d))
        .chain(numbered)
        .chain(bars::ranking(d))
        .chain(bars::gap(d))
        .collect()
}

/// Returns the held-out runs with the largest misses, in their order, and the worst training run.
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
