//! Residuals of the fit: their sum of squares and the correlation of neighbours.
//!
//! Of whole codes, all of which count, both follow from the sums of the first pass, which are exact
//! but for the fitted part. Otherwise, and where so little is left of the signal that the
//! difference of the sums would be rounding, a second pass forms the residuals themselves.

use rayon::prelude::*;

use super::basis::dot;
use super::block::BLOCK;
use super::moments::{CHUNK, Moments, Stage};
use super::sample::{Bounds, Sample, code_bounds, is_inside, pivot};
use super::{Channel, SineError};

/// Fraction of the sum of squares that must remain for the sums of the first pass to determine it:
/// they are accurate to about 10⁻¹⁵ of it.
const LEFT_BY_SUMS: f64 = 1e-9;

/// Sums over the residuals of one channel, in the unit of its samples.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Residual {
    pub(super) sum_squares: f64,
    /// Σ rₙ·rₙ₊₁ over neighbours that both count.
    sum_lagged: f64,
    pairs: usize,
}

impl Residual {
    /// Correlation of neighbouring residuals, −1…1; 0 if nothing is left.
    pub(super) fn lag1(&self) -> f64 {
        if self.sum_squares > 0.0 {
            (self.sum_lagged / self.sum_squares).clamp(-1.0, 1.0)
        } else {
            0.0
        }
    }

    /// Returns the density at a frequency (rad per sample) over the mean density, of a first-order
    /// autoregression with this correlation; 1 if the correlation is not significant or the density
    /// is lower.
    pub(super) fn colour_factor(&self, rad_per_sample: f64) -> f64 {
        let rho = self.lag1();
        if rho * (self.pairs as f64).sqrt() < SIGNIFICANT {
            return 1.0;
        }
        // Kept below 1, where the density at zero frequency would be infinite.
        let rho = rho.min(1.0 - 1.0 / (self.pairs as f64 + 1.0));
        let density = (1.0 - rho * rho) / (1.0 - 2.0 * rho * rad_per_sample.cos() + rho * rho);
        density.max(1.0)
    }
}

/// Standard deviations at which a correlation counts as one.
const SIGNIFICANT: f64 = 4.0;

/// Residuals of a channel, which is the `number`th of its record.
///
/// # Errors
/// Samples that cannot be read.
pub(super) fn residual(
    number: usize,
    channel: &Channel<'_>,
    stage: &Stage,
    moments: &Moments,
    beta: &[f64],
    exclude_clipped: bool,
) -> Result<Residual, SineError> {
    if channel.scale().is_some()
        && let Some(known) = by_sums(number, channel, stage, moments, beta)?
    {
        return Ok(known);
    }
    let (level, segment) = (pivot(channel), channel.segment());
    let mut pieces: Vec<Piece> = Vec::new();
    for base in (0..channel.len()).step_by(segment) {
        let loaded = channel.load(number, base)?;
        match loaded.channel() {
            Channel::Volts {
                samples, range_v, ..
            } => {
                let bounds = if exclude_clipped { range_v } else { None };
                let samples = &samples[..samples.len().min(segment)];
                pieces.append(&mut of_samples(
                    stage,
                    beta,
                    &Source {
                        samples,
                        base,
                        level,
                        bounds,
                    },
                ));
            }
            Channel::Codes { codes, scale } => {
                let bounds = if exclude_clipped {
                    code_bounds(&scale)
                } else {
                    None
                };
                let samples = &codes[..codes.len().min(segment)];
                pieces.append(&mut of_samples(
                    stage,
                    beta,
                    &Source {
                        samples,
                        base,
                        level,
                        bounds,
                    },
                ));
            }
            Channel::Stored(_) => {}
        }
    }
    Ok(joined(&pieces))
}

/// Computes the residuals from the sums, if these are accurate enough.
fn by_sums(
    number: usize,
    channel: &Channel<'_>,
    stage: &Stage,
    moments: &Moments,
    beta: &[f64],
) -> Result<Option<Residual>, SineError> {
    let count = channel.len();
    let sum_squares = moments.squares - dot(beta, &moments.right);
    if moments.used < count || sum_squares <= LEFT_BY_SUMS * moments.squares {
        return Ok(None);
    }
    let level = pivot(channel);
    let x = |index: usize| {
        channel
            .code(number, index)
            .map(|code| code.map(|code| f64::from(code) - level))
    };
    let (Some(first), Some(last)) = (x(0)?, x(count.saturating_sub(1))?) else {
        return Ok(None);
    };
    let model = |index: f64| dot(beta, &stage.basis.row_at(index));
    // The model one sample later is the model on shifted columns; the ends, which have one
    // neighbour only, are set right.
    let shifted = |samples: f64, sums: &[f64]| {
        let mut sums = sums.to_vec();
        stage.basis.shift(samples).apply(&mut sums);
        dot(beta, &sums)
    };
    let end = count as f64;
    let samples_model = shifted(1.0, &moments.right) - last * model(end)
        + shifted(-1.0, &moments.right)
        - first * model(-1.0);
    let model_model = shifted(1.0, &moments.gram.times(beta)) - model(end - 1.0) * model(end);
    Ok(Some(Residual {
        sum_squares,
        sum_lagged: moments.lagged - samples_model + model_model,
        pairs: count - 1,
    }))
}

/// Samples with the values subtracted from them and the bounds of those that count.
struct Source<'a, S> {
    samples: &'a [S],
    /// The sample of the record that is the first of them.
    base: usize,
    level: f64,
    bounds: Bounds<S>,
}

/// Residuals of a chunk, with the first and the last if they count.
#[derive(Debug, Clone, Copy, Default)]
struct Piece {
    sums: Residual,
    first: Option<f64>,
    last: Option<f64>,
}

fn of_samples<S: Sample>(stage: &Stage, beta: &[f64], source: &Source<'_, S>) -> Vec<Piece> {
    let chunks: Vec<&[S]> = source.samples.chunks(CHUNK).collect();
    let one = |(number, chunk): (usize, &&[S])| {
        of_chunk(stage, beta, source, source.base + number * CHUNK, chunk)
    };
    if chunks.len() > 1 {
        chunks.par_iter().enumerate().map(one).collect()
    } else {
        chunks.iter().enumerate().map(one).collect()
    }
}

fn joined(pieces: &[Piece]) -> Residual {
    let (mut sums, mut before) = (Residual::default(), None);
    for piece in pieces {
        sums.sum_squares += piece.sums.sum_squares;
        sums.sum_lagged += piece.sums.sum_lagged;
        sums.pairs += piece.sums.pairs;
        if let (Some(a), Some(b)) = (before, piece.first) {
            sums.sum_lagged += a * b;
            sums.pairs += 1;
        }
        before = piece.last;
    }
    sums
}

fn of_chunk<S: Sample>(
    stage: &Stage,
    beta: &[f64],
    source: &Source<'_, S>,
    start: usize,
    chunk: &[S],
) -> Piece {
    let mut piece = Piece::default();
    let mut remainder = [0.0; BLOCK];
    let mut last = None;
    for (number, block) in chunk.chunks(BLOCK).enumerate() {
        let at = number * BLOCK;
        for (cell, sample) in remainder.iter_mut().zip(block) {
            *cell = (*sample).into() - source.level;
        }
        subtract(&mut remainder[..block.len()], stage, beta, start + at);
        for (k, sample) in block.iter().enumerate() {
            let counted = is_inside(*sample, source.bounds).then_some(remainder[k]);
            if let Some(r) = counted {
                piece.sums.sum_squares += r * r;
                if let Some(before) = last {
                    piece.sums.sum_lagged += before * r;
                    piece.sums.pairs += 1;
                }
            }
            if at + k == 0 {
                piece.first = counted;
            }
            last = counted;
        }
    }
    piece.last = last;
    piece
}

/// Takes the model off the samples of a block.
fn subtract(remainder: &mut [f64], stage: &Stage, beta: &[f64], start: usize) {
    let mut beta = beta.to_vec();
    stage.basis.place(start).pull_back(&mut beta);
    for (coefficient, column) in beta.iter().zip(&stage.table.exact) {
        remainder
            .iter_mut()
            .zip(column.iter())
            .for_each(|(r, value)| *r -= coefficient * value);
    }
}
