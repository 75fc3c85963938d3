//! The cells of a string against their mean.

use analysis_numeric::stats::FDistribution;

use super::{
    grid::{Piece, without_line},
    result::StringCell,
};

/// Fewest cells of a string whose scatter says anything.
const FEWEST_CELLS: usize = 4;
/// Length of a block, s: the open-circuit voltages of the cells differ by a straight line within it.
const BLOCK_S: f64 = 5.0;
/// Fewest blocks.
const FEWEST_BLOCKS: usize = 6;
/// Probability below which a cell is weak.
const CERTAIN: f64 = 0.01;
/// Standard uncertainties of the record that the excess must exceed as well.
const BEYOND_NOISE: f64 = 4.0;

/// Compares every cell with the mean of the others: in each block the cell's difference from it follows
/// its response to the current, as far as the cell's impedance is larger. The scatter of the blocks is the
/// uncertainty. Empty for few cells or a short record.
pub(super) fn string(names: &[&str], pieces: &[Piece], interval_s: f64) -> Vec<StringCell> {
    let block = ((BLOCK_S / interval_s).round() as usize).max(16);
    let cells = names.len();
    let mut products = vec![Vec::new(); cells];
    let mut squares = vec![Vec::new(); cells];
    for piece in pieces {
        for from in (0..(piece.current_a.len() + 1).saturating_sub(block)).step_by(block) {
            let own: Vec<Vec<f64>> = piece
                .voltages_v
                .iter()
                .map(|voltage_v| without_line(&voltage_v[from..from + block]))
                .collect();
            let mean: Vec<f64> = (0..block)
                .map(|k| own.iter().map(|cell| cell[k]).sum::<f64>() / cells as f64)
                .collect();
            // The mean of the others: a cell's own noise would correlate with itself.
            let count = cells as f64;
            for ((cell, products), squares) in own.iter().zip(&mut products).zip(&mut squares) {
                let others = || {
                    let each = cell.iter().zip(&mean);
                    each.map(|(u, m)| (u, (count * m - u) / (count - 1.0)))
                };
                products.push(others().map(|(u, m)| (u - m) * m).sum::<f64>());
                squares.push(others().map(|(_, m)| m * m).sum::<f64>());
            }
        }
    }
    let blocks = squares.first().map_or(0, Vec::len);
    if cells < FEWEST_CELLS || blocks < FEWEST_BLOCKS {
        return Vec::new();
    }
    let each = products.iter().zip(&squares);
    let found: Vec<[f64; 2]> = each.map(|(own, squares)| excess(own, squares)).collect();
    names
        .iter()
        .enumerate()
        .map(|(k, name)| judged(name, k, &found))
        .collect()
}

/// Returns the excess of a cell over all blocks, and its standard uncertainty by leaving out one after
/// the other.
fn excess(products: &[f64], squares: &[f64]) -> [f64; 2] {
    let (product, square): (f64, f64) = (products.iter().sum(), squares.iter().sum());
    let whole = product / square;
    let count = squares.len() as f64;
    let left_out = products
        .iter()
        .zip(squares)
        .map(|(p, s)| (product - p) / (square - s) - whole);
    let variance = (count - 1.0) / count * left_out.map(|off| off * off).sum::<f64>();
    [whole, variance.sqrt()]
}

/// Judges a cell by the scatter of all others.
fn judged(name: &str, index: usize, found: &[[f64; 2]]) -> StringCell {
    let [excess, sigma] = found[index];
    let others: Vec<f64> = found
        .iter()
        .enumerate()
        .filter(|(k, _)| *k != index)
        .map(|(_, [excess, _])| *excess)
        .collect();
    let count = others.len() as f64;
    let mean = others.iter().sum::<f64>() / count;
    let variance = others.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let scatters = (excess - mean) / (variance * (1.0 + 1.0 / count)).sqrt();
    let student = FDistribution {
        above: 1.0,
        below: count - 1.0,
    };
    // One side, for the greatest of all cells.
    let p = if scatters > 0.0 {
        (0.5 * student.tail(scatters * scatters) * found.len() as f64).min(1.0)
    } else {
        1.0
    };
    StringCell {
        name: name.to_owned(),
        excess,
        sigma,
        scatters,
        p,
        weak: p < CERTAIN && excess > BEYOND_NOISE * sigma,
    }
}
