//! The inner loops: sums of one block of samples over the columns.
//!
//! 12-bit codes are summed in integers, 16 at a time if the processor has AVX2, so the sums are the
//! same on every machine. Wider codes, and volts, are summed as `f64` in a fixed order.

use pulp::{Simd, WithSimd};

use super::block::{BLOCK, products};
use super::table::{Fixed, Table};

/// Greatest distance between the bounds of codes that the integer kernel can take: samples within
/// them differ from the pivot by 2047 at most.
pub(super) const NARROW_SPAN: i32 = 4096;

/// A block of samples and of those one later.
pub(super) type Blocks<'a, S> = (&'a [S; BLOCK], &'a [S; BLOCK]);

/// Sums over one block, of samples less the pivot, relative to the block's first sample.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BlockSums {
    /// Over the columns.
    pub(super) columns: Vec<f64>,
    /// Sum of the squares.
    pub(super) squares: f64,
    /// Sum of the products with the next sample.
    pub(super) lagged: f64,
}

/// The weights of a pass: 1, the samples themselves, the next ones and their number are always
/// there.
type Rows<'a> = [&'a [i16; BLOCK]; 4];

/// Whole-number sums of a pass over a block.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Whole {
    one: i64,
    squares: i64,
    lagged: i64,
    ramp: i64,
    rows: [i64; 4],
    least: i16,
    greatest: i16,
}

const RAMP: [i16; BLOCK] = {
    let mut ramp = [0i16; BLOCK];
    let mut k = 0;
    while k < BLOCK {
        ramp[k] = k as i16;
        k += 1;
    }
    ramp
};

#[cfg(target_arch = "x86_64")]
mod wide {
    //! The same sums with AVX2: products of neighbours are added in pairs, eight lanes of 32 bits.

    use pulp::x86::V3;
    use pulp::{cast, i16x16, i32x8};

    use super::{BLOCK, Blocks, RAMP, Rows, Whole};

    const LANES: usize = 16;

    #[inline(always)]
    fn load(samples: &[i16; BLOCK], at: usize) -> i16x16 {
        // By reference, so that the compiler loads a register and does not copy an array first.
        pulp::bytemuck::cast_ref::<[i16; BLOCK], [i16x16; BLOCK / LANES]>(samples)[at]
    }

    /// Returns the sum of the lanes.
    #[inline(always)]
    fn total(lanes: i32x8) -> i64 {
        let lanes: [i32; 8] = cast(lanes);
        let mut sum = 0;
        for lane in lanes {
            sum += i64::from(lane);
        }
        sum
    }

    #[inline(always)]
    pub(super) fn whole(
        simd: V3,
        (now, next): Blocks<'_, i16>,
        pivot: i16,
        rows: &Rows<'_>,
    ) -> Whole {
        let (offset, one) = (simd.splat_i16x16(pivot), simd.splat_i16x16(1));
        let (mut least, mut greatest) = (simd.splat_i16x16(i16::MAX), simd.splat_i16x16(i16::MIN));
        let mut sums = [simd.splat_i32x8(0); 8];
        for at in 0..BLOCK / LANES {
            let raw = load(now, at);
            let x = simd.wrapping_sub_i16x16(raw, offset);
            let later = simd.wrapping_sub_i16x16(load(next, at), offset);
            least = simd.min_i16x16(least, raw);
            greatest = simd.max_i16x16(greatest, raw);
            let [a, b, c, d] = [
                load(rows[0], at),
                load(rows[1], at),
                load(rows[2], at),
                load(rows[3], at),
            ];
            let weights = [one, x, later, load(&RAMP, at), a, b, c, d];
            for k in 0..8 {
                sums[k] = simd.wrapping_add_i32x8(
                    sums[k],
                    simd.multiply_wrapping_add_adjacent_i16x16(x, weights[k]),
                );
            }
        }
        let (least, greatest): ([i16; LANES], [i16; LANES]) = (cast(least), cast(greatest));
        Whole {
            one: total(sums[0]),
            squares: total(sums[1]),
            lagged: total(sums[2]),
            ramp: total(sums[3]),
            rows: [
                total(sums[4]),
                total(sums[5]),
                total(sums[6]),
                total(sums[7]),
            ],
            least: least.iter().copied().fold(i16::MAX, i16::min),
            greatest: greatest.iter().copied().fold(i16::MIN, i16::max),
        }
    }
}

/// Returns the same sums in plain code.
#[inline(always)]
fn whole(now_next: Blocks<'_, i16>, pivot: i16, rows: &Rows<'_>) -> Whole {
    let (now, next) = now_next;
    let x: [i16; BLOCK] = std::array::from_fn(|k| now[k].wrapping_sub(pivot));
    let later: [i16; BLOCK] = std::array::from_fn(|k| next[k].wrapping_sub(pivot));
    // Sums of 64 products fit 32 bits, as in a lane of the other kernel; with clipped samples they
    // may wrap, and are not used.
    let total = |weights: &[i16; BLOCK]| {
        let part = |(a, b): (&[i16], &[i16])| {
            a.iter().zip(b).fold(0i32, |sum, (a, b)| {
                sum.wrapping_add(i32::from(*a) * i32::from(*b))
            })
        };
        x.chunks_exact(64)
            .zip(weights.chunks_exact(64))
            .map(part)
            .map(i64::from)
            .sum::<i64>()
    };
    Whole {
        one: total(&[1; BLOCK]),
        squares: total(&x),
        lagged: total(&later),
        ramp: total(&RAMP),
        rows: rows.map(total),
        least: now.iter().copied().fold(i16::MAX, i16::min),
        greatest: now.iter().copied().fold(i16::MIN, i16::max),
    }
}

/// Inputs of a kernel besides the samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame<'a> {
    pub(super) table: &'a Table,
    /// Normalised time per sample.
    pub(super) time_step: f64,
    /// Column of the constant; that of the time follows, if there is one.
    pub(super) constant: usize,
    pub(super) drift: bool,
}

/// Codes within bounds that leave the integer kernel room.
#[derive(Debug, Clone, Copy)]
pub(super) struct Narrow {
    /// Code that is subtracted before summing.
    pub(super) pivot: i16,
    /// Samples at or beyond these are clipped.
    pub(super) bounds: (i16, i16),
}

impl Frame<'_> {
    /// Sums of a block; false if a sample is clipped.
    #[inline(always)]
    fn narrow(
        &self,
        narrow: Narrow,
        blocks: Blocks<'_, i16>,
        whole: impl Fn(Blocks<'_, i16>, i16, &Rows<'_>) -> Whole,
        into: &mut BlockSums,
    ) -> bool {
        let mut pairs = self
            .table
            .fixed
            .iter()
            .enumerate()
            .filter_map(|(column, fixed)| Some((column, fixed.as_deref()?)));
        while let Some((first_column, first)) = pairs.next() {
            let second = pairs.next();
            let [c, d] = second.map_or([&RAMP; 2], |(_, fixed)| [&fixed.hi, &fixed.lo]);
            let sums = whole(blocks, narrow.pivot, &[&first.hi, &first.lo, c, d]);
            if sums.least <= narrow.bounds.0 || sums.greatest >= narrow.bounds.1 {
                return false;
            }
            let value = |fixed: &Fixed, hi: i64, lo: i64| {
                hi as f64 * fixed.hi_unit + lo as f64 * fixed.lo_unit
            };
            into.columns[first_column] = value(first, sums.rows[0], sums.rows[1]);
            if let Some((column, fixed)) = second {
                into.columns[column] = value(fixed, sums.rows[2], sums.rows[3]);
            }
            (into.squares, into.lagged) = (sums.squares as f64, sums.lagged as f64);
            into.columns[self.constant] = sums.one as f64;
            if self.drift {
                into.columns[self.constant + 1] = sums.ramp as f64 * self.time_step;
            }
        }
        true
    }
}

/// Runs over blocks of codes one after another.
struct EachNarrow<'a, W, T> {
    frame: Frame<'a>,
    narrow: Narrow,
    codes: &'a [i16],
    whole: W,
    take: T,
}

impl<W: Fn(Blocks<'_, i16>, i16, &Rows<'_>) -> Whole, T: FnMut(Option<&BlockSums>)> WithSimd
    for EachNarrow<'_, W, T>
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _simd: S) {
        let mut sums = BlockSums::zero(self.frame.table.exact.len());
        for blocks in blocks(self.codes) {
            let clean = self
                .frame
                .narrow(self.narrow, blocks, &self.whole, &mut sums);
            (self.take)(clean.then_some(&sums));
        }
    }
}

impl BlockSums {
    fn zero(columns: usize) -> Self {
        Self {
            columns: vec![0.0; columns],
            squares: 0.0,
            lagged: 0.0,
        }
    }
}

/// Returns the whole blocks that have a sample after them, each with the samples one later.
pub(super) fn blocks<S>(samples: &[S]) -> impl Iterator<Item = Blocks<'_, S>> {
    let later = samples.get(1..).unwrap_or(&[]);
    samples
        .as_chunks::<BLOCK>()
        .0
        .iter()
        .zip(later.as_chunks::<BLOCK>().0)
}

/// Calls `take` with the sums of each of the [`blocks`] of codes, in order, or with `None` if a
/// sample is clipped.
pub(super) fn each_narrow(
    frame: Frame<'_>,
    narrow: Narrow,
    codes: &[i16],
    take: impl FnMut(Option<&BlockSums>),
) {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V3::try_new() {
        let wide = |blocks: Blocks<'_, i16>, pivot: i16, rows: &Rows<'_>| {
            wide::whole(simd, blocks, pivot, rows)
        };
        return Simd::vectorize(
            simd,
            EachNarrow {
                frame,
                narrow,
                codes,
                whole: wide,
                take,
            },
        );
    }
    Simd::vectorize(
        pulp::Scalar::new(),
        EachNarrow {
            frame,
            narrow,
            codes,
            whole,
            take,
        },
    );
}

/// Sums of a block of any samples as `f64`, less a pivot.
pub(super) fn floating<S: Copy + Into<f64>>(
    frame: &Frame<'_>,
    (now, next): Blocks<'_, S>,
    pivot: f64,
) -> BlockSums {
    let value = |sample: S| -> f64 { sample.into() - pivot };
    let x: [f64; BLOCK] = std::array::from_fn(|k| value(now[k]));
    let later: [f64; BLOCK] = std::array::from_fn(|k| value(next[k]));
    pulp::Arch::new().dispatch(Floating {
        table: frame.table,
        x: &x,
        later: &later,
    })
}

struct Floating<'a> {
    table: &'a Table,
    x: &'a [f64; BLOCK],
    later: &'a [f64; BLOCK],
}

impl WithSimd for Floating<'_> {
    type Output = BlockSums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> BlockSums {
        BlockSums {
            columns: self
                .table
                .exact
                .iter()
                .map(|column| products(self.x, column))
                .collect(),
            squares: products(self.x, self.x),
            lagged: products(self.x, self.later),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_integer_kernels_give_the_sums_of_wide_integers() {
        let mut state = 7u64;
        let mut next = |span: i64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            i16::try_from(((state >> 33) as i64) % (2 * span + 1) - span).unwrap()
        };
        for (span, pivot) in [(2047, 0i16), (3, 100), (2047, 2048)] {
            let samples: Vec<i16> = (0..=BLOCK).map(|_| next(span) + pivot).collect();
            let rows: Vec<[i16; BLOCK]> = (0..4)
                .map(|_| std::array::from_fn(|_| next(16384)))
                .collect();
            let rows = [&rows[0], &rows[1], &rows[2], &rows[3]];
            let pair: Blocks<'_, i16> = (
                samples.first_chunk().unwrap(),
                samples[1..].first_chunk().unwrap(),
            );
            let x: Vec<i64> = samples
                .iter()
                .map(|v| i64::from(*v) - i64::from(pivot))
                .collect();
            let sum =
                |weight: &dyn Fn(usize) -> i64| (0..BLOCK).map(|k| x[k] * weight(k)).sum::<i64>();
            let expected = Whole {
                one: sum(&|_| 1),
                squares: sum(&|k| x[k]),
                lagged: sum(&|k| x[k + 1]),
                ramp: sum(&|k| k as i64),
                rows: rows.map(|row| sum(&|k| i64::from(row[k]))),
                least: samples[..BLOCK].iter().copied().min().unwrap(),
                greatest: samples[..BLOCK].iter().copied().max().unwrap(),
            };
            assert_eq!(whole(pair, pivot, &rows), expected);
            #[cfg(target_arch = "x86_64")]
            if let Some(simd) = pulp::x86::V3::try_new() {
                assert_eq!(wide::whole(simd, pair, pivot, &rows), expected);
            }
        }
    }

    #[test]
    fn a_lane_holds_the_greatest_sums() {
        // All samples and weights at their limits, of one sign: 64 products of 2047 and 16384 stay
        // below 2³¹.
        let (samples, row) = ([2047i16; BLOCK], [16384i16; BLOCK]);
        let sums = whole((&samples, &samples), 0, &[&row; 4]);
        assert_eq!(sums.rows, [512 * 2047 * 16384; 4]);
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            assert_eq!(wide::whole(simd, (&samples, &samples), 0, &[&row; 4]), sums);
        }
    }
}
