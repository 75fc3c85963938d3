//! The columns within one block, relative to its first sample: exactly, and in fixed point for the
//! integer kernel.
//!
//! In fixed point a column is hi·2⁻¹⁴ + lo·2⁻²⁹ with two 16-bit numbers, so that its products with
//! 12-bit samples are summed without any rounding. The effect of the rounding of the column itself
//! (about 10⁻⁹) on the sums follows from the fitted model and the sums [`Table::rounding`];
//! [`super::solve`] removes it.

use super::basis::{Basis, Square};
use super::block::{self, BLOCK};

/// A column in fixed point.
#[derive(Debug)]
pub(super) struct Fixed {
    pub(super) hi: [i16; BLOCK],
    pub(super) lo: [i16; BLOCK],
    /// Value of a unit of `hi`.
    pub(super) hi_unit: f64,
    /// Value of a unit of `lo`.
    pub(super) lo_unit: f64,
}

impl Fixed {
    /// Whole numbers of `lo_unit`, cut into a high part of multiples of 2^`bits` and a low part.
    fn new(value: impl Fn(usize) -> i32, bits: u32, lo_unit: f64) -> Self {
        let half = 1i32 << (bits - 1);
        let hi = |k: usize| (value(k) + half) >> bits;
        let narrow = |number: i32| i16::try_from(number).unwrap_or(0);
        Self {
            hi: std::array::from_fn(|k| narrow(hi(k))),
            lo: std::array::from_fn(|k| narrow(value(k) - (hi(k) << bits))),
            hi_unit: lo_unit * f64::from(1i32 << bits),
            lo_unit,
        }
    }

    fn value(&self, k: usize) -> f64 {
        f64::from(self.hi[k]) * self.hi_unit + f64::from(self.lo[k]) * self.lo_unit
    }
}

/// 2²⁹: cos = 1 is then 2¹⁴ in the high part.
const ONE: f64 = 536_870_912.0;

/// All columns of a basis over one block.
#[derive(Debug)]
pub(super) struct Table {
    /// Columns, exact.
    pub(super) exact: Vec<Box<[f64; BLOCK]>>,
    /// Columns in fixed point; none for 1 and t, which the kernel has itself, and none at all if
    /// the record has no whole block.
    pub(super) fixed: Vec<Option<Box<Fixed>>>,
}

impl Table {
    /// Creates the table of a record; `whole` if it has whole blocks.
    pub(super) fn new(basis: &Basis, whole: bool) -> Self {
        let count = if whole {
            BLOCK
        } else {
            basis.samples().min(BLOCK)
        };
        let mut exact = vec![Box::new([0.0; BLOCK]); basis.columns()];
        let mut row = vec![0.0; basis.columns()];
        for k in 0..count {
            basis.write_row(k as f64, &mut row);
            for (column, value) in exact.iter_mut().zip(&row) {
                column[k] = *value;
            }
        }
        let fixed = if whole {
            (0..exact.len())
                .map(|column| fixed(basis, column, &exact[column]))
                .collect()
        } else {
            Vec::new()
        };
        Self { exact, fixed }
    }

    /// Writes the columns at one sample.
    pub(super) fn write_row(&self, k: usize, row: &mut [f64]) {
        row.iter_mut()
            .zip(&self.exact)
            .for_each(|(cell, column)| *cell = column[k]);
    }

    /// Σ ψψᵀ over a block.
    pub(super) fn gram(&self) -> Square {
        products(self.exact.len(), |row, column| {
            block::products(&self.exact[row], &self.exact[column])
        })
    }

    /// Σ εψᵀ over a block, with the rounding ε = ψ − ψ_fixed of the fixed-point columns.
    pub(super) fn rounding(&self) -> Square {
        let rounded = |column: usize| -> Option<[f64; BLOCK]> {
            let fixed = self.fixed.get(column)?.as_ref()?;
            Some(std::array::from_fn(|k| {
                self.exact[column][k] - fixed.value(k)
            }))
        };
        let rounded: Vec<_> = (0..self.exact.len()).map(rounded).collect();
        products(self.exact.len(), |row, column| {
            rounded[row]
                .as_ref()
                .map_or(0.0, |rounded| block::products(rounded, &self.exact[column]))
        })
    }
}

fn products(size: usize, cell: impl Fn(usize, usize) -> f64) -> Square {
    let mut all = Square::zero(size);
    for row in 0..size {
        for column in 0..size {
            all.set(row, column, cell(row, column));
        }
    }
    all
}

fn fixed(basis: &Basis, column: usize, exact: &[f64; BLOCK]) -> Option<Box<Fixed>> {
    let power = column
        .checked_sub(2 * basis.tones())
        .filter(|power| *power < basis.powers());
    let scaled = |unit: f64| Fixed::new(|k| (exact[k] / unit * ONE).round() as i32, 15, unit / ONE);
    match power {
        Some(0 | 1) => None,
        // Squares of whole numbers need no rounding.
        Some(_) => Some(Box::new(Fixed::new(
            |k| (k * k) as i32,
            9,
            basis.time_step * basis.time_step,
        ))),
        None if column < basis.first_timed() => Some(Box::new(scaled(1.0))),
        None => Some(Box::new(scaled(BLOCK as f64 * basis.time_step))),
    }
}
