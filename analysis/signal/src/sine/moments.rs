//! One pass over the samples: the sums that make up the normal equations, for all channels, on all
//! cores.
//!
//! The record is cut into chunks of a fixed length, whose sums are added in order: the result does
//! not depend on the number of threads. Whole blocks of samples that all count go through a kernel;
//! the others are added one by one.

use rayon::prelude::*;

use super::basis::{Basis, Doubling, Shift, Square};
use super::block::BLOCK;
use super::kernel::{self, BlockSums, Frame, NARROW_SPAN, Narrow};
use super::sample::{Bounds, Sample, all_inside, code_bounds, code_pivot, is_inside, pivot};
use super::table::Table;
use super::{Channel, Record, SineError};

/// Blocks per chunk.
const CHUNK_BLOCKS: usize = 64;
/// Samples per chunk.
pub(super) const CHUNK: usize = CHUNK_BLOCKS * BLOCK;

/// All sums of one channel, of samples less the pivot.
#[derive(Debug, Clone)]
pub(super) struct Moments {
    /// Σ φφᵀ over the columns.
    pub(super) gram: Square,
    /// Σ φ·x.
    pub(super) right: Vec<f64>,
    /// Σ εφᵀ of the blocks whose sums were computed over rounded columns φ − ε; `None` if there are
    /// no such blocks.
    pub(super) rounding: Option<Square>,
    /// Σ x².
    pub(super) squares: f64,
    /// Σ xₙ·xₙ₊₁; of meaning only if all samples count.
    pub(super) lagged: f64,
    /// Samples that count.
    pub(super) used: usize,
    /// Samples at or beyond the bounds.
    pub(super) clipped: usize,
}

/// The basis with all that was computed once for a frequency.
#[derive(Debug)]
pub(super) struct Stage {
    pub(super) basis: Basis,
    pub(super) table: Table,
    /// From the first sample of a chunk to that of a block in it.
    within: Vec<Shift>,
    gram: Option<Doubling>,
    rounding: Option<Doubling>,
}

impl Stage {
    pub(super) fn new(basis: Basis, record: &Record<'_>, exclude_clipped: bool) -> Self {
        let whole = basis.samples().saturating_sub(1) / BLOCK;
        let table = Table::new(&basis, whole > 0);
        let any_narrow = record
            .channels
            .iter()
            .any(|channel| narrow(channel, exclude_clipped).is_some());
        let doubling = |one: Square| Doubling::new(&basis, BLOCK, one, whole);
        let gram = (whole > 0).then(|| doubling(table.gram()));
        let rounding = (whole > 0 && any_narrow).then(|| doubling(table.rounding()));
        let within = (0..whole.min(CHUNK_BLOCKS))
            .map(|block| basis.shift((block * BLOCK) as f64))
            .collect();
        Self {
            basis,
            table,
            within,
            gram,
            rounding,
        }
    }

    fn frame(&self) -> Frame<'_> {
        let constant = 2 * self.basis.tones();
        Frame {
            table: &self.table,
            time_step: self.basis.time_step,
            constant,
            drift: self.basis.powers() > 1,
        }
    }
}

/// Codes for the integer kernel, if they are.
fn narrow(channel: &Channel<'_>, exclude_clipped: bool) -> Option<Narrow> {
    let scale = channel.scale()?;
    let span = i32::from(scale.code_max) - i32::from(scale.code_min);
    let fits = exclude_clipped && span <= NARROW_SPAN;
    fits.then(|| Narrow {
        pivot: code_pivot(&scale),
        bounds: (scale.code_min, scale.code_max),
    })
}

/// Sums of all channels.
pub(super) fn accumulate(
    record: &Record<'_>,
    stage: &Stage,
    exclude_clipped: bool,
) -> Result<Vec<Moments>, SineError> {
    let mut all = Vec::with_capacity(record.channels.len());
    for (index, channel) in record.channels.iter().enumerate() {
        let chunks = pieces(index + 1, channel, stage, exclude_clipped)?;
        let own = chunks.iter();
        let moments = gather(own, stage, narrow(channel, exclude_clipped).is_some());
        all.push(moments.map_err(|(at, value)| SineError::NotFinite {
            channel: index + 1,
            index: at,
            value,
        })?);
    }
    Ok(all)
}

/// Sums of a channel, which is the `number`th of its record, over its chunks, in order.
fn pieces(
    number: usize,
    channel: &Channel<'_>,
    stage: &Stage,
    exclude_clipped: bool,
) -> Result<Vec<Piece>, SineError> {
    let samples = stage.basis.samples();
    let segment = channel.segment();
    let level = pivot(channel);
    let of_segment = |base: usize| -> Result<Vec<Piece>, SineError> {
        let loaded = channel.load(number, base)?;
        let starts: Vec<usize> = (base..(base + segment).min(samples))
            .step_by(CHUNK)
            .collect();
        let one = |start: &usize| {
            piece(
                &loaded.channel(),
                stage,
                Cut {
                    start: *start,
                    base,
                    level,
                },
                exclude_clipped,
            )
        };
        // A short record is done before the other cores have woken up.
        Ok(if starts.len() > 1 {
            starts.par_iter().map(one).collect()
        } else {
            starts.iter().map(one).collect()
        })
    };
    let mut all = Vec::with_capacity(samples.div_ceil(CHUNK));
    // Segments are read one after the other, which bounds the memory.
    for base in (0..samples).step_by(segment) {
        all.append(&mut of_segment(base)?);
    }
    Ok(all)
}

/// Sums of one channel over one chunk, relative to the middle of the record.
#[derive(Debug)]
struct Piece {
    sums: BlockSums,
    /// Room for the sums of a block on their way to the chunk.
    moved: Vec<f64>,
    /// Whole blocks that went through a kernel.
    kernel_blocks: Vec<bool>,
    /// Σ φφᵀ of the other samples.
    gram: Square,
    used: usize,
    clipped: usize,
    /// First sample that is not finite.
    fault: Option<(usize, f64)>,
}

fn gather<'a>(
    pieces: impl Iterator<Item = &'a Piece>,
    stage: &Stage,
    narrow: bool,
) -> Result<Moments, (usize, f64)> {
    let columns = stage.basis.columns();
    let mut all = Moments {
        gram: Square::zero(columns),
        right: vec![0.0; columns],
        rounding: None,
        squares: 0.0,
        lagged: 0.0,
        used: 0,
        clipped: 0,
    };
    let mut kernel_blocks = Vec::new();
    for piece in pieces {
        if let Some(fault) = piece.fault {
            return Err(fault);
        }
        all.gram.add(&piece.gram);
        all.right
            .iter_mut()
            .zip(&piece.sums.columns)
            .for_each(|(sum, part)| *sum += part);
        all.squares += piece.sums.squares;
        all.lagged += piece.sums.lagged;
        all.used += piece.used;
        all.clipped += piece.clipped;
        kernel_blocks.extend_from_slice(&piece.kernel_blocks);
    }
    let mut rounding = Square::zero(columns);
    let mut first = 0;
    for run in kernel_blocks.chunk_by(|a, b| a == b) {
        if let (Some(true), Some(gram)) = (run.first(), &stage.gram) {
            all.gram.add(&gram.run(&stage.basis, first, run.len()));
            if let (true, Some(doubling)) = (narrow, &stage.rounding) {
                rounding.add(&doubling.run(&stage.basis, first, run.len()));
            }
        }
        first += run.len();
    }
    all.rounding = narrow.then_some(rounding);
    Ok(all)
}

/// Position of a chunk, and the values subtracted from its samples.
#[derive(Clone, Copy)]
struct Cut {
    /// First sample of the chunk, counted in the record.
    start: usize,
    /// The sample of the record that is the first of those read.
    base: usize,
    /// Pivot, in the unit of the samples.
    level: f64,
}

fn piece(channel: &Channel<'_>, stage: &Stage, cut: Cut, exclude_clipped: bool) -> Piece {
    let Cut { start, base, level } = cut;
    match channel {
        // It was read before.
        Channel::Stored(_) => Part::<f64> {
            stage,
            samples: &[],
            start,
            base,
            level,
            bounds: None,
            exclude_clipped,
        }
        .collect(|_| {}),
        Channel::Volts {
            samples, range_v, ..
        } => {
            let part = Part {
                stage,
                samples,
                start,
                base,
                level,
                bounds: *range_v,
                exclude_clipped,
            };
            part.collect(|piece| part.each_floating(|sums| piece.add_block(&part, sums)))
        }
        Channel::Codes { codes, scale } => {
            let part = Part {
                stage,
                samples: codes,
                start,
                base,
                level,
                bounds: code_bounds(scale),
                exclude_clipped,
            };
            match narrow(channel, exclude_clipped) {
                Some(narrow) => part.collect(|piece| {
                    kernel::each_narrow(stage.frame(), narrow, part.chunk(1), |sums| {
                        piece.add_block(&part, sums);
                    });
                }),
                None => {
                    part.collect(|piece| part.each_floating(|sums| piece.add_block(&part, sums)))
                }
            }
        }
    }
}

/// One channel's samples of a chunk.
struct Part<'a, S> {
    stage: &'a Stage,
    samples: &'a [S],
    start: usize,
    /// The sample of the record that is the first of `samples`.
    base: usize,
    level: f64,
    bounds: Bounds<S>,
    exclude_clipped: bool,
}

impl<S: Sample> Part<'_, S> {
    /// Samples of the chunk, and some after it if there are any.
    fn chunk(&self, after: usize) -> &[S] {
        let from = self.start - self.base;
        &self.samples[from..(from + CHUNK + after).min(self.samples.len())]
    }

    fn counts(&self, sample: S) -> bool {
        !self.exclude_clipped || is_inside(sample, self.bounds)
    }

    fn each_floating(&self, mut take: impl FnMut(Option<&BlockSums>)) {
        let frame = self.stage.frame();
        for blocks in kernel::blocks(self.chunk(1)) {
            let clean = all_inside(
                blocks.0,
                if self.exclude_clipped {
                    self.bounds
                } else {
                    None
                },
            );
            let sums = clean.then(|| kernel::floating(&frame, blocks, self.level));
            take(sums.as_ref());
        }
    }

    /// Returns the blocks that a kernel gives, and the rest one by one.
    fn collect(&self, kernels: impl FnOnce(&mut Piece)) -> Piece {
        let columns = self.stage.basis.columns();
        let sums = BlockSums {
            columns: vec![0.0; columns],
            squares: 0.0,
            lagged: 0.0,
        };
        let gram = Square::zero(columns);
        let (moved, kernel_blocks) = (vec![0.0; columns], Vec::with_capacity(CHUNK_BLOCKS));
        let mut piece = Piece {
            sums,
            moved,
            kernel_blocks,
            gram,
            used: 0,
            clipped: 0,
            fault: None,
        };
        kernels(&mut piece);
        self.stage
            .basis
            .place(self.start)
            .apply(&mut piece.sums.columns);
        if !self.exclude_clipped && self.bounds.is_some() {
            piece.clipped = self
                .chunk(0)
                .iter()
                .filter(|sample| !is_inside(**sample, self.bounds))
                .count();
        }
        for (number, block) in self.chunk(0).chunks(BLOCK).enumerate() {
            if !piece.kernel_blocks.get(number).copied().unwrap_or(false) && piece.fault.is_none() {
                self.add_each(&mut piece, number * BLOCK, block.len());
            }
        }
        piece
    }

    /// Adds samples one by one, from an offset in the chunk.
    fn add_each(&self, piece: &mut Piece, offset: usize, count: usize) {
        let first = self.start + offset;
        let place = self.stage.basis.place(first);
        let mut row = vec![0.0; self.stage.basis.columns()];
        for k in 0..count {
            let sample = self.samples[first - self.base + k];
            let value: f64 = sample.into();
            if !value.is_finite() {
                piece.fault = Some((first + k, value));
                return;
            }
            if !self.counts(sample) {
                piece.clipped += 1;
                continue;
            }
            let x = value - self.level;
            self.stage.table.write_row(k, &mut row);
            place.apply(&mut row);
            piece.gram.add_product(&row, &row);
            piece
                .sums
                .columns
                .iter_mut()
                .zip(&row)
                .for_each(|(sum, column)| *sum += column * x);
            piece.sums.squares += x * x;
            if let Some(next) = self.samples.get(first - self.base + k + 1) {
                piece.sums.lagged += x * ((*next).into() - self.level);
            }
            piece.used += 1;
        }
    }
}

impl Piece {
    fn add_block<S: Sample>(&mut self, part: &Part<'_, S>, sums: Option<&BlockSums>) {
        if let (Some(sums), Some(shift)) = (sums, part.stage.within.get(self.kernel_blocks.len())) {
            self.moved.copy_from_slice(&sums.columns);
            shift.apply(&mut self.moved);
            self.sums
                .columns
                .iter_mut()
                .zip(&self.moved)
                .for_each(|(sum, column)| *sum += column);
            self.sums.squares += sums.squares;
            self.sums.lagged += sums.lagged;
            self.used += BLOCK;
        }
        self.kernel_blocks.push(sums.is_some());
    }
}
