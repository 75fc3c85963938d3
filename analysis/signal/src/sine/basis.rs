//! The columns of the model, and how their sums move along the record.
//!
//! Columns in order: cos θ and −sin θ of each tone, the fundamental first; 1, t, t² as far as drift
//! is fitted; exp(−t/τ) of each relaxation; then t·cos θ and −t·sin θ, for a sinusoid that changes of
//! the fundamental, and for a free frequency of the tones that move with it. t runs from −1 to 1 over
//! the record.
//!
//! Seen from another sample, all columns are a small linear map of themselves ([`Shift`]). Sums
//! over a block relative to its first sample are therefore worth as much as sums relative to the
//! middle of the record, phases never build up errors, and the normal matrix of a long run comes
//! from that of one block by doubling.

use num_complex::Complex64;

/// One frequency of the model.
#[derive(Debug, Clone, Copy)]
struct Tone {
    cycles_per_sample: f64,
    /// Rounding error of `cycles_per_sample`, cycles.
    cycles_rest: f64,
}

impl Tone {
    fn new(freq_hz: f64, interval_s: f64) -> Self {
        let cycles_per_sample = freq_hz * interval_s;
        Self {
            cycles_per_sample,
            cycles_rest: freq_hz.mul_add(interval_s, -cycles_per_sample),
        }
    }

    /// exp(jθ) for a number of samples.
    fn turn(&self, offset: f64) -> Complex64 {
        let cycles = self.cycles_per_sample * offset;
        let rest = self.cycles_per_sample.mul_add(offset, -cycles) + self.cycles_rest * offset;
        Complex64::cis(std::f64::consts::TAU * ((cycles - cycles.round()) + rest))
    }
}

/// The columns at one frequency.
#[derive(Debug, Clone)]
pub(super) struct Basis {
    tones: Vec<Tone>,
    powers: usize,
    /// Relaxation rates, 1 per sample.
    rates: Vec<f64>,
    timed: usize,
    /// True if the columns of the first tone that are multiplied by time are fitted.
    varying: bool,
    samples: usize,
    centre: f64,
    /// Normalised time per sample: the record spans −1…1.
    pub(super) time_step: f64,
}

/// Description of the columns of a basis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Make<'a> {
    /// Frequencies, Hz, the fundamental first.
    pub(super) freqs_hz: &'a [f64],
    /// Degree of the drift, 0…2.
    pub(super) degree: usize,
    /// Time constants of relaxations, s.
    pub(super) decays_s: &'a [f64],
    /// Number of first tones that also get columns multiplied by time.
    pub(super) timed: usize,
    /// True if those of the first tone are fitted.
    pub(super) varying: bool,
}

impl Basis {
    pub(super) fn new(make: &Make<'_>, interval_s: f64, samples: usize) -> Self {
        Self {
            tones: make
                .freqs_hz
                .iter()
                .map(|freq_hz| Tone::new(*freq_hz, interval_s))
                .collect(),
            powers: make.degree + 1,
            rates: make
                .decays_s
                .iter()
                .map(|tau_s| interval_s / tau_s)
                .collect(),
            timed: make.timed.max(usize::from(make.varying)),
            varying: make.varying,
            samples,
            centre: 0.5 * (samples as f64 - 1.0),
            time_step: 2.0 / samples as f64,
        }
    }

    /// Returns the number of tones.
    pub(super) fn tones(&self) -> usize {
        self.tones.len()
    }

    /// Returns the number of columns of the drift: its degree and one.
    pub(super) fn powers(&self) -> usize {
        self.powers
    }

    /// Column of the first relaxation.
    pub(super) fn first_decay(&self) -> usize {
        2 * self.tones.len() + self.powers
    }

    /// First column that is multiplied by time.
    pub(super) fn first_timed(&self) -> usize {
        self.first_decay() + self.rates.len()
    }

    /// Returns the number of columns that are fitted: the first ones.
    pub(super) fn fitted(&self) -> usize {
        self.first_timed() + 2 * usize::from(self.varying)
    }

    /// Returns the number of columns.
    pub(super) fn columns(&self) -> usize {
        self.first_timed() + 2 * self.timed
    }

    /// Returns the number of samples of the record.
    pub(super) fn samples(&self) -> usize {
        self.samples
    }

    /// Returns the map of the columns by a number of samples.
    pub(super) fn shift(&self, offset: f64) -> Shift {
        let turns = self.tones.iter().map(|tone| tone.turn(offset)).collect();
        let fades = self
            .rates
            .iter()
            .map(|rate| (-rate * offset).exp())
            .collect();
        Shift {
            turns,
            time: offset * self.time_step,
            powers: self.powers,
            fades,
            timed: self.timed,
            varying: self.varying,
        }
    }

    /// Returns the map from columns relative to a sample to those of the record.
    pub(super) fn place(&self, index: usize) -> Shift {
        self.shift(index as f64 - self.centre)
    }

    /// Writes the columns at an offset in samples from their origin.
    pub(super) fn write_row(&self, offset: f64, row: &mut [f64]) {
        let (time, first_power) = (offset * self.time_step, 2 * self.tones.len());
        for (j, tone) in self.tones.iter().enumerate() {
            let turn = tone.turn(offset);
            (row[2 * j], row[2 * j + 1]) = (turn.re, -turn.im);
            if j < self.timed {
                let at = self.first_timed() + 2 * j;
                (row[at], row[at + 1]) = (time * turn.re, -time * turn.im);
            }
        }
        for power in 0..self.powers {
            row[first_power + power] = time.powi(power as i32);
        }
        let first_decay = self.first_decay();
        for (cell, rate) in row[first_decay..].iter_mut().zip(&self.rates) {
            *cell = (-rate * offset).exp();
        }
    }

    /// Returns the columns at a sample of the record; the index may lie outside.
    pub(super) fn row_at(&self, index: f64) -> Vec<f64> {
        let mut row = vec![0.0; self.columns()];
        self.write_row(index - self.centre, &mut row);
        row
    }
}

/// Conversion of columns counted from one sample to columns counted from another.
#[derive(Debug, Clone)]
pub(super) struct Shift {
    turns: Vec<Complex64>,
    time: f64,
    powers: usize,
    /// Factor that remains of each relaxation.
    fades: Vec<f64>,
    timed: usize,
    varying: bool,
}

impl Shift {
    /// exp(jθ) of a tone.
    pub(super) fn turn(&self, tone: usize) -> Complex64 {
        self.turns[tone]
    }

    /// Maps the columns, or sums of samples over them.
    pub(super) fn apply(&self, v: &mut [f64]) {
        let first_power = 2 * self.turns.len();
        let first_decay = first_power + self.powers;
        let first_timed = first_decay + self.fades.len();
        for (j, turn) in self.turns.iter().enumerate() {
            rotate(v, 2 * j, *turn);
        }
        if self.powers > 2 {
            v[first_power + 2] +=
                self.time * (2.0 * v[first_power + 1] + self.time * v[first_power]);
        }
        if self.powers > 1 {
            v[first_power + 1] += self.time * v[first_power];
        }
        v[first_decay..]
            .iter_mut()
            .zip(&self.fades)
            .for_each(|(cell, fade)| *cell *= fade);
        for (j, turn) in self.turns.iter().enumerate().take(self.timed) {
            let at = first_timed + 2 * j;
            rotate(v, at, *turn);
            v[at] += self.time * v[2 * j];
            v[at + 1] += self.time * v[2 * j + 1];
        }
    }

    /// Maps coefficients of the fitted columns back: the model does not change if it is counted
    /// from another sample.
    pub(super) fn pull_back(&self, beta: &mut [f64]) {
        if self.varying {
            let first_timed = 2 * self.turns.len() + self.powers + self.fades.len();
            beta[0] += self.time * beta[first_timed];
            beta[1] += self.time * beta[first_timed + 1];
            rotate(beta, first_timed, self.turns[0].conj());
        }
        for (j, turn) in self.turns.iter().enumerate() {
            rotate(beta, 2 * j, turn.conj());
        }
        let at = 2 * self.turns.len();
        let quadratic = if self.powers > 2 { beta[at + 2] } else { 0.0 };
        if self.powers > 1 {
            beta[at] += self.time * (beta[at + 1] + self.time * quadratic);
            beta[at + 1] += 2.0 * self.time * quadratic;
        }
        beta[at + self.powers..]
            .iter_mut()
            .zip(&self.fades)
            .for_each(|(cell, fade)| *cell *= fade);
    }

    /// Maps a matrix of sums of products of columns.
    fn apply_both(&self, matrix: &Square) -> Square {
        let mut mapped = matrix.clone();
        for _ in 0..2 {
            mapped.rows_mut().for_each(|row| self.apply(row));
            mapped.transpose();
        }
        mapped
    }
}

/// (cos, −sin) turned by an angle.
fn rotate(v: &mut [f64], at: usize, turn: Complex64) {
    let (cos, sin) = (v[at], v[at + 1]);
    v[at] = turn.re * cos + turn.im * sin;
    v[at + 1] = turn.re * sin - turn.im * cos;
}

/// A small square matrix, row by row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Square {
    pub(super) size: usize,
    cells: Vec<f64>,
}

impl Square {
    pub(super) fn zero(size: usize) -> Self {
        Self {
            size,
            cells: vec![0.0; size * size],
        }
    }

    pub(super) fn at(&self, row: usize, column: usize) -> f64 {
        self.cells[row * self.size + column]
    }

    pub(super) fn set(&mut self, row: usize, column: usize, value: f64) {
        self.cells[row * self.size + column] = value;
    }

    fn row(&self, row: usize) -> &[f64] {
        &self.cells[row * self.size..(row + 1) * self.size]
    }

    fn rows_mut(&mut self) -> impl Iterator<Item = &mut [f64]> {
        self.cells.chunks_exact_mut(self.size)
    }

    fn transpose(&mut self) {
        for row in 0..self.size {
            for column in 0..row {
                self.cells
                    .swap(row * self.size + column, column * self.size + row);
            }
        }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.cells
            .iter_mut()
            .zip(&other.cells)
            .for_each(|(a, b)| *a += b);
    }

    /// Adds the product of a column and a row.
    pub(super) fn add_product(&mut self, left: &[f64], right: &[f64]) {
        for (row, a) in self.rows_mut().zip(left) {
            row.iter_mut()
                .zip(right)
                .for_each(|(cell, b)| *cell += a * b);
        }
    }

    /// Product with a vector of the first columns.
    pub(super) fn times(&self, vector: &[f64]) -> Vec<f64> {
        (0..self.size)
            .map(|row| dot(self.row(row), vector))
            .collect()
    }
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Sums of products over runs of whole blocks, by doubling.
#[derive(Debug)]
pub(super) struct Doubling {
    block: usize,
    /// Sums over 1, 2, 4, … blocks, relative to the first sample.
    powers: Vec<Square>,
}

impl Doubling {
    /// From the sums of one block, for runs of up to `most` blocks.
    pub(super) fn new(basis: &Basis, block: usize, one: Square, most: usize) -> Self {
        let mut powers = vec![one];
        while powers.len() < most.max(1).ilog2() as usize + 1 {
            let last = &powers[powers.len() - 1];
            let mut twice = basis
                .shift((block << (powers.len() - 1)) as f64)
                .apply_both(last);
            twice.add(last);
            powers.push(twice);
        }
        Self { block, powers }
    }

    /// Sums over `count` blocks from block `first`, relative to the middle of the record.
    pub(super) fn run(&self, basis: &Basis, first: usize, count: usize) -> Square {
        let mut sum = Square::zero(basis.columns());
        let mut at = first;
        for (bit, matrix) in self.powers.iter().enumerate() {
            if count >> bit & 1 == 1 {
                sum.add(&basis.place(at * self.block).apply_both(matrix));
                at += 1 << bit;
            }
        }
        sum
    }
}
