//! A second pass: what the fit leaves. The sum of squares is formed from the differences themselves, for taking it from the sums of the first pass
//! would lose all digits where the offset or the signal is large against the noise.

use num_complex::Complex64;

use super::moments::{BLOCK, Bounds, Grid, LANES, Sample, Table, all_inside, code_bounds, is_inside, volt_bounds};
use super::{Channel, FitOptions};

/// Sums over the residuals of one channel, in the unit of its samples.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Residual {
    pub(super) sum_squares: f64,
    /// Σ rₙ·rₙ₊₁ over neighbours that both count.
    sum_lagged: f64,
    pairs: usize,
    pub(super) clipped: usize,
}

impl Residual {
    /// Correlation of neighbouring residuals, −1…1; 0 if nothing is left.
    pub(super) fn lag1(&self) -> f64 {
        if self.sum_squares > 0.0 { (self.sum_lagged / self.sum_squares).clamp(-1.0, 1.0) } else { 0.0 }
    }

    /// Density at a frequency (rad per sample) over the mean density, of a first-order autoregression with this correlation; 1 where the
    /// correlation is not significant or the density lower.
    pub(super) fn colour_factor(&self, rad_per_sample: f64) -> f64 {
        let rho = self.lag1();
        if rho * (self.pairs as f64).sqrt() < SIGNIFICANT {
            return 1.0;
        }
        // Kept off 1, where the density at zero frequency would be infinite.
        let rho = rho.min(1.0 - 1.0 / (self.pairs as f64 + 1.0));
        let density = (1.0 - rho * rho) / (1.0 - 2.0 * rho * rad_per_sample.cos() + rho * rho);
        density.max(1.0)
    }
}

/// Standard deviations at which a correlation counts as one.
const SIGNIFICANT: f64 = 4.0;

/// The fitted model of one channel, in the unit of its samples, less the pivot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wave {
    pub(super) phasor: Complex64,
    pub(super) offset: f64,
    pub(super) drift: f64,
    pub(super) pivot: f64,
}

/// Residuals of a channel.
pub(super) fn residual(channel: &Channel<'_>, wave: &Wave, frame: (&Grid, &Table), options: &FitOptions) -> Residual {
    match channel {
        Channel::Volts { samples, .. } => of_samples(samples, volt_bounds(channel), wave, frame, options),
        Channel::Codes { codes, .. } => of_samples(codes, code_bounds(channel), wave, frame, options),
    }
}

fn of_samples<S: Sample>(samples: &[S], bounds: Bounds<S>, wave: &Wave, (grid, table): (&Grid, &Table), options: &FitOptions) -> Residual {
    let mut sums = Residual::default();
    let mut last = None;
    let mut differences = [0.0; BLOCK];
    for (number, block) in samples.chunks(BLOCK).enumerate() {
        let start = number * BLOCK;
        let level = wave.pivot + wave.offset + wave.drift * grid.time(start);
        subtract(&mut differences, block, table, &Wave { phasor: wave.phasor * grid.phase(start), offset: level, ..*wave });
        let inside = all_inside(block, bounds);
        if !inside {
            sums.clipped += block.iter().filter(|sample| !is_inside(**sample, bounds)).count();
        }
        match <&[f64; BLOCK]>::try_from(&differences[..block.len()]) {
            Ok(differences) if inside => add_whole(&mut sums, differences, &mut last),
            _ => {
                let counts = |sample: &S| !options.exclude_clipped || is_inside(*sample, bounds);
                add_some(&mut sums, differences.iter().zip(block).map(|(r, sample)| counts(sample).then_some(*r)), &mut last);
            }
        }
    }
    sums
}

/// Samples less the wave, whose phasor and offset are those at the start of the block.
fn subtract<S: Sample>(differences: &mut [f64; BLOCK], block: &[S], table: &Table, wave: &Wave) {
    let basis = table.cos.iter().zip(&table.sin).zip(&table.time);
    for ((difference, sample), ((cos, sin), time)) in differences.iter_mut().zip(block).zip(basis) {
        *difference = sample.value() - (wave.phasor.re * cos - wave.phasor.im * sin + wave.offset + wave.drift * time);
    }
}

fn add_whole(sums: &mut Residual, differences: &[f64; BLOCK], last: &mut Option<f64>) {
    if let Some(before) = *last {
        sums.sum_lagged += before * differences[0];
        sums.pairs += 1;
    }
    let (mut squares, mut lagged) = ([0.0; LANES], [0.0; LANES]);
    for i in (0..BLOCK - LANES).step_by(LANES) {
        for lane in 0..LANES {
            let r = differences[i + lane];
            squares[lane] += r * r;
            lagged[lane] += r * differences[i + lane + 1];
        }
    }
    let end = &differences[BLOCK - LANES..];
    sums.sum_squares += squares.iter().sum::<f64>() + end.iter().map(|r| r * r).sum::<f64>();
    sums.sum_lagged += lagged.iter().sum::<f64>() + end.iter().zip(&end[1..]).map(|(a, b)| a * b).sum::<f64>();
    sums.pairs += BLOCK - 1;
    *last = differences.last().copied();
}

fn add_some(sums: &mut Residual, differences: impl Iterator<Item = Option<f64>>, last: &mut Option<f64>) {
    for difference in differences {
        if let Some(r) = difference {
            sums.sum_squares += r * r;
            if let Some(before) = *last {
                sums.sum_lagged += before * r;
                sums.pairs += 1;
            }
        }
        *last = difference;
    }
}
