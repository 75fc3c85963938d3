//! A record on an even grid of time, divided at its gaps.

use super::record::UsageRecord;

/// Intervals from which on a distance of two rows is a gap.
const GAP: f64 = 4.0;

/// Rows without a gap, on an even grid.
pub(super) struct Piece {
    /// Current into the cells, A.
    pub(super) current_a: Vec<f64>,
    /// Voltage of each cell, V.
    pub(super) voltages_v: Vec<Vec<f64>>,
}

/// Returns the interval, the median of the record's, s, and its pieces, each value interpolated between
/// the two rows around it.
pub(super) fn pieces(record: &UsageRecord) -> (f64, Vec<Piece>) {
    let mut steps: Vec<f64> = record
        .time_s
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .collect();
    steps.sort_by(f64::total_cmp);
    let interval_s = steps[steps.len() / 2];
    let mut pieces = Vec::new();
    let mut from = 0;
    for row in 1..=record.time_s.len() {
        let ends = record
            .time_s
            .get(row)
            .is_none_or(|time_s| time_s - record.time_s[row - 1] > GAP * interval_s);
        if ends {
            pieces.push(piece(record, from, row, interval_s));
            from = row;
        }
    }
    (interval_s, pieces)
}

fn piece(record: &UsageRecord, from: usize, to: usize, interval_s: f64) -> Piece {
    let time_s = &record.time_s[from..to];
    let length_s = time_s[time_s.len() - 1] - time_s[0];
    let count = (length_s / interval_s).floor() as usize + 1;
    // The row before each place of the grid, and how far the place lies behind it.
    let mut row = 0;
    let places: Vec<(usize, f64)> = (0..count)
        .map(|k| {
            let at_s = time_s[0] + k as f64 * interval_s;
            while row + 2 < time_s.len() && time_s[row + 1] <= at_s {
                row += 1;
            }
            let next_s = time_s.get(row + 1).copied().unwrap_or(at_s + interval_s);
            (
                row,
                ((at_s - time_s[row]) / (next_s - time_s[row])).clamp(0.0, 1.0),
            )
        })
        .collect();
    let on_grid = |values: &[f64], factor: f64| -> Vec<f64> {
        let at = |(row, share): &(usize, f64)| {
            let next = values.get(row + 1).copied().unwrap_or(values[*row]);
            factor * (values[*row] + share * (next - values[*row]))
        };
        places.iter().map(at).collect()
    };
    Piece {
        current_a: on_grid(&record.current_a[from..to], -1.0),
        voltages_v: record
            .cells
            .iter()
            .map(|cell| on_grid(&cell.voltage_v[from..to], 1.0))
            .collect(),
    }
}

/// Takes the straight line off that fits the values best.
pub(super) fn without_line(values: &[f64]) -> Vec<f64> {
    let count = values.len() as f64;
    let middle = 0.5 * (count - 1.0);
    let mean = values.iter().sum::<f64>() / count;
    let moment: f64 = values
        .iter()
        .enumerate()
        .map(|(k, v)| (k as f64 - middle) * v)
        .sum();
    let slope = 12.0 * moment / (count * (count * count - 1.0));
    let flat = |(k, v): (usize, &f64)| v - mean - slope * (k as f64 - middle);
    values.iter().enumerate().map(flat).collect()
}
