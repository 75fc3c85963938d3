//! A block of samples.

/// Samples per block: a lane of the integer kernel holds 64 products of 12 and 15 bits.
pub(super) const BLOCK: usize = 512;

/// Sums kept side by side: the compiler puts them into vector registers, which the order of a
/// single sum forbids.
pub(super) const LANES: usize = 16;

/// Returns the sum of the products of two blocks.
#[inline(always)]
pub(super) fn products(a: &[f64; BLOCK], b: &[f64; BLOCK]) -> f64 {
    let mut sums = [0.0; LANES];
    for (a, b) in a
        .as_chunks::<LANES>()
        .0
        .iter()
        .zip(b.as_chunks::<LANES>().0)
    {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sums.iter().sum()
}
