//! One pass over the samples: the sums that the normal equations are made of.
//!
//! Phases are factored as exp(jθₙ) = exp(jθ_block) · T_k with a table T of one block, so that the inner loop is a plain dot product, no error builds
//! up along the record, and the sums over the basis functions alone come from six constants of the table.

use num_complex::Complex64;

use super::{Channel, FitOptions, Record, SineError};

/// Samples per block of the table: small enough for the first-level cache, large enough to hide the work per block.
pub(super) const BLOCK: usize = 512;
/// Sums kept side by side: the compiler puts them into vector registers, which the order of a single sum forbids.
pub(super) const LANES: usize = 4;

/// Phase and normalised time of the samples of a record, at one frequency.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    cycles_per_sample: f64,
    /// What rounding took from `cycles_per_sample`.
    cycles_rest: f64,
    centre: f64,
    /// Normalised time per sample: the record spans −1…1.
    pub(super) time_step: f64,
}

impl Grid {
    pub(super) fn new(freq_hz: f64, interval_s: f64, samples: usize) -> Self {
        let cycles_per_sample = freq_hz * interval_s;
        Self {
            cycles_per_sample,
            cycles_rest: freq_hz.mul_add(interval_s, -cycles_per_sample),
            centre: 0.5 * (samples as f64 - 1.0),
            time_step: 2.0 / samples as f64,
        }
    }

    /// exp(jθ) `offset` samples from the middle of the record.
    fn turn(&self, offset: f64) -> Complex64 {
        let cycles = self.cycles_per_sample * offset;
        let rest = self.cycles_per_sample.mul_add(offset, -cycles) + self.cycles_rest * offset;
        Complex64::cis(std::f64::consts::TAU * ((cycles - cycles.round()) + rest))
    }

    /// exp(jθ) at a sample.
    pub(super) fn phase(&self, index: usize) -> Complex64 {
        self.turn(index as f64 - self.centre)
    }

    /// Normalised time of a sample, −1…1.
    pub(super) fn time(&self, index: usize) -> f64 {
        (index as f64 - self.centre) * self.time_step
    }
}

/// The basis within a block, relative to its first sample.
#[derive(Debug)]
pub(super) struct Table {
    pub(super) cos: [f64; BLOCK],
    pub(super) sin: [f64; BLOCK],
    pub(super) time: [f64; BLOCK],
    time_cos: [f64; BLOCK],
    time_sin: [f64; BLOCK],
    relative: Gram,
}

impl Table {
    pub(super) fn new(grid: &Grid) -> Box<Self> {
        let zero = [0.0; BLOCK];
        let mut table = Box::new(Self { cos: zero, sin: zero, time: zero, time_cos: zero, time_sin: zero, relative: Gram::default() });
        for k in 0..BLOCK {
            let turn = grid.turn(k as f64);
            let time = k as f64 * grid.time_step;
            (table.cos[k], table.sin[k], table.time[k]) = (turn.re, turn.im, time);
            (table.time_cos[k], table.time_sin[k]) = (time * turn.re, time * turn.im);
            table.relative.add_sample(turn, time);
        }
        table
    }
}

/// Sums over the basis functions: `u` of tᵐ·exp(jθ), `w` of tᵐ·exp(2jθ), `v` of tᵐ, m = 0…2.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Gram {
    pub(super) u: [Complex64; 3],
    pub(super) w: [Complex64; 3],
    pub(super) v: [f64; 3],
}

impl Gram {
    fn add_sample(&mut self, turn: Complex64, time: f64) {
        let square = turn * turn;
        let mut power = 1.0;
        for m in 0..3 {
            self.u[m] += turn * power;
            self.w[m] += square * power;
            self.v[m] += power;
            power *= time;
        }
    }

    fn add(&mut self, other: &Self) {
        for m in 0..3 {
            self.u[m] += other.u[m];
            self.w[m] += other.w[m];
            self.v[m] += other.v[m];
        }
    }

    /// The same sums with all phases turned and all times moved.
    fn moved(&self, turn: Complex64, time: f64) -> Self {
        let square = turn * turn;
        Self {
            u: binomial(&self.u, time).map(|sum| sum * turn),
            w: binomial(&self.w, time).map(|sum| sum * square),
            v: binomial(&self.v, time),
        }
    }
}

/// Σ (a + κ)ᵐ from Σ κᵐ.
fn binomial<T>(sums: &[T; 3], a: f64) -> [T; 3]
where
    T: Copy + std::ops::Add<Output = T> + std::ops::Mul<f64, Output = T>,
{
    let [s0, s1, s2] = *sums;
    [s0, s0 * a + s1, s0 * (a * a) + s1 * (2.0 * a) + s2]
}

/// All sums of one channel: the basis, and the samples x (less the pivot) on it: `x` of x·tᵐ·exp(jθ), `y` of x·tᵐ, m = 0, 1.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    pub(super) gram: Gram,
    pub(super) x: [Complex64; 2],
    pub(super) y: [f64; 2],
    pub(super) used: usize,
}

/// What the kernels need of a sample.
pub(super) trait Sample: Copy + PartialOrd {
    fn value(self) -> f64;
}

impl Sample for f64 {
    fn value(self) -> f64 {
        self
    }
}

impl Sample for i16 {
    fn value(self) -> f64 {
        f64::from(self)
    }
}

/// Bounds, both exclusive, of the samples that count; `None` counts all (finite) ones.
pub(super) type Bounds<S> = Option<(S, S)>;

/// True for a finite sample within the bounds.
pub(super) fn is_inside<S: Sample>(sample: S, bounds: Bounds<S>) -> bool {
    match bounds {
        Some((low, high)) => sample > low && sample < high,
        None => sample.value().is_finite(),
    }
}

/// True if all samples are finite and within the bounds. Looks at all of them, which vector registers do faster than stopping at the first.
pub(super) fn all_inside<S: Sample>(samples: &[S], bounds: Bounds<S>) -> bool {
    match bounds {
        Some((low, high)) => samples.iter().fold(true, |all, sample| all & (*sample > low) & (*sample < high)),
        None => samples.iter().fold(true, |all, sample| all & sample.value().is_finite()),
    }
}

/// Bounds of the samples to be fitted.
pub(super) fn code_bounds(channel: &Channel<'_>) -> Bounds<i16> {
    match channel {
        Channel::Codes { scale, .. } => Some((scale.code_min, scale.code_max)),
        Channel::Volts { .. } => None,
    }
}

/// Bounds of the samples to be fitted.
pub(super) fn volt_bounds(channel: &Channel<'_>) -> Bounds<f64> {
    match channel {
        Channel::Volts { range_v, .. } => *range_v,
        Channel::Codes { .. } => None,
    }
}

/// Sums of all channels; with `free`, also the sums that a step of the frequency needs.
pub(super) fn accumulate(
    record: &Record<'_>,
    (grid, table): (&Grid, &Table),
    options: &FitOptions,
    free: bool,
) -> Result<Vec<Moments>, SineError> {
    let samples = record.channels.first().map_or(0, Channel::len);
    let mut all = vec![Moments::default(); record.channels.len()];
    let mut start = 0;
    while start < samples {
        let end = (start + BLOCK).min(samples);
        let at = Place { grid, table, start, turn: grid.phase(start), time: grid.time(start) };
        let gram = table.relative.moved(at.turn, at.time);
        for (number, (channel, moments)) in record.channels.iter().zip(&mut all).enumerate() {
            let result = match channel {
                Channel::Volts { samples, .. } => {
                    let bounds = if options.exclude_clipped { volt_bounds(channel) } else { None };
                    let pivot = super::solve::pivot(channel);
                    at.add(moments, &gram, &Part { samples: &samples[start..end], bounds, pivot, free })
                }
                Channel::Codes { codes, .. } => {
                    let bounds = if options.exclude_clipped { code_bounds(channel) } else { None };
                    at.add(moments, &gram, &Part { samples: &codes[start..end], bounds, pivot: 0.0, free })
                }
            };
            result.map_err(|(index, value)| SineError::NotFinite { channel: number + 1, index, value })?;
        }
        start = end;
    }
    Ok(all)
}

/// A block of the record.
struct Place<'a> {
    grid: &'a Grid,
    table: &'a Table,
    start: usize,
    turn: Complex64,
    time: f64,
}

/// One channel's samples of a block.
struct Part<'a, S> {
    samples: &'a [S],
    bounds: Bounds<S>,
    pivot: f64,
    free: bool,
}

impl Place<'_> {
    /// Adds a block; the error is the index and value of a sample that is not finite.
    fn add<S: Sample>(&self, moments: &mut Moments, gram: &Gram, part: &Part<'_, S>) -> Result<(), (usize, f64)> {
        match <&[S; BLOCK]>::try_from(part.samples) {
            Ok(block) if all_inside(block, part.bounds) => {
                self.add_block(moments, block, part);
                moments.gram.add(gram);
                moments.used += BLOCK;
                Ok(())
            }
            _ => self.add_each(moments, part),
        }
    }

    fn add_block<S: Sample>(&self, moments: &mut Moments, block: &[S; BLOCK], part: &Part<'_, S>) {
        let sums = if part.free { dots::<S, true>(self.table, block, part.pivot) } else { dots::<S, false>(self.table, block, part.pivot) };
        let [cos, sin, one, time, time_cos, time_sin] = sums;
        let wave = Complex64::new(cos, sin);
        moments.x[0] += wave * self.turn;
        moments.x[1] += (wave * self.time + Complex64::new(time_cos, time_sin)) * self.turn;
        moments.y[0] += one;
        moments.y[1] += one * self.time + time;
    }

    fn add_each<S: Sample>(&self, moments: &mut Moments, part: &Part<'_, S>) -> Result<(), (usize, f64)> {
        for (k, sample) in part.samples.iter().enumerate() {
            let value = sample.value();
            if !value.is_finite() {
                return Err((self.start + k, value));
            }
            if !is_inside(*sample, part.bounds) {
                continue;
            }
            let (turn, time) = (self.grid.phase(self.start + k), self.grid.time(self.start + k));
            let x = value - part.pivot;
            moments.gram.add_sample(turn, time);
            moments.x[0] += turn * x;
            moments.x[1] += turn * (x * time);
            moments.y[0] += x;
            moments.y[1] += x * time;
            moments.used += 1;
        }
        Ok(())
    }
}

/// Dot products of a whole block with cos, sin, 1, t and, if free, t·cos, t·sin.
fn dots<S: Sample, const FREE: bool>(table: &Table, block: &[S; BLOCK], pivot: f64) -> [f64; 6] {
    let [mut cos, mut sin, mut one, mut time, mut time_cos, mut time_sin] = [[0.0; LANES]; 6];
    for i in (0..BLOCK).step_by(LANES) {
        for lane in 0..LANES {
            let k = i + lane;
            let x = block[k].value() - pivot;
            cos[lane] += x * table.cos[k];
            sin[lane] += x * table.sin[k];
            one[lane] += x;
            time[lane] += x * table.time[k];
            if FREE {
                time_cos[lane] += x * table.time_cos[k];
                time_sin[lane] += x * table.time_sin[k];
            }
        }
    }
    [cos, sin, one, time, time_cos, time_sin].map(|lanes| lanes.iter().sum())
}
