//! Rows averaged over equal steps: the energy of a power and the charge of a current stay what they
//! are in every step. Pure.

use instruments::units::Seconds;

use super::Row;
use crate::plan::Averaged;

/// Times that differ by less than this share are one.
const ROUNDING: f64 = 1.0e-9;
/// Times of rows are differences of rounded ones: a nanosecond is none, s.
pub(super) const ROUNDING_S: Seconds = Seconds(1.0e-9);

/// Returns the mean of the rows over each step, and the resulting loss. If every row consists of
/// whole steps, returns the rows unchanged and `None`. The last step is padded with zero current.
///
/// # Errors
/// Rows of current and power together, and rows without a duration, in words.
pub(super) fn averaged(
    rows: &[Row],
    step_s: Seconds,
) -> Result<(Vec<Row>, Option<Averaged>), String> {
    let power = rows.first().is_some_and(|row| row.power);
    if let Some(index) = rows.iter().position(|row| row.power != power) {
        return Err(format!(
            "expected rows of current or of power, found both (row {}): only one of them has a \
            mean",
            index + 1
        ));
    }
    if let Some(reason) = Row::first_wrong(rows) {
        return Err(reason);
    }
    let rounding_s = |span_s: Seconds| ROUNDING_S.max(ROUNDING * span_s);
    let whole = |row: &Row| {
        let steps = (row.duration_s / step_s).round().max(1.0);
        (steps * step_s - row.duration_s).abs() <= rounding_s(row.duration_s)
    };
    if rows.iter().all(whole) {
        return Ok((rows.to_vec(), None));
    }
    let total_s: Seconds = rows.iter().map(|row| row.duration_s).sum();
    let count = ((total_s - rounding_s(total_s)) / step_s).ceil().max(1.0) as usize;
    let (step, total) = (step_s.value(), total_s.value());
    let mut sums = vec![(0.0_f64, 0.0_f64); count];
    let mut pieces: Vec<(usize, f64, f64)> = Vec::new();
    let mut at_s = 0.0;
    for row in rows {
        let end_s = at_s + row.duration_s.value();
        while end_s - at_s > ROUNDING * step {
            let index = (((at_s / step) + ROUNDING).floor() as usize).min(count - 1);
            let part_s = end_s.min((index + 1) as f64 * step) - at_s;
            if part_s <= 0.0 {
                break;
            }
            sums[index].0 += row.value * part_s;
            sums[index].1 += row.value * row.value * part_s;
            pieces.push((index, row.value, part_s));
            at_s += part_s;
        }
        at_s = end_s;
    }
    let means: Vec<f64> = sums.iter().map(|(sum, _)| sum / step).collect();
    let (square, left) =
        pieces
            .iter()
            .fold((0.0, 0.0), |(square, left), (index, value, part_s)| {
                (
                    square + value * value * part_s,
                    left + (value - means[*index]).powi(2) * part_s,
                )
            });
    let greatest = pieces
        .iter()
        .map(|(index, value, _)| (value - means[*index]).abs())
        .fold(0.0, f64::max);
    let (rms, whole_rms) = ((left / total).sqrt(), (square / total).sqrt());
    let share = if whole_rms > 0.0 {
        rms / whole_rms
    } else {
        0.0
    };
    let averaged = Averaged {
        step_s,
        rows: rows.len(),
        power,
        rms,
        share,
        greatest,
    };
    Ok((
        means
            .into_iter()
            .map(|value| Row {
                value,
                power,
                duration_s: step_s,
            })
            .collect(),
        Some(averaged),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_numeric::Rng;

    fn rows(list: &[(f64, f64)]) -> Vec<Row> {
        list.iter()
            .map(|&(value, duration_s)| Row {
                value,
                power: true,
                duration_s: Seconds(duration_s),
            })
            .collect()
    }

    #[test]
    fn what_is_whole_steps_stays_as_it_is_and_what_is_not_is_averaged_with_its_loss() {
        let whole = rows(&[(1.0, 2.0), (3.0, 1.0)]);
        assert_eq!(averaged(&whole, Seconds(1.0)).unwrap(), (whole, None));
        let (means, lost) =
            averaged(&rows(&[(4.0, 0.5), (0.0, 0.5), (2.0, 0.5)]), Seconds(1.0)).unwrap();
        assert_eq!(
            means.iter().map(|row| row.value).collect::<Vec<_>>(),
            [2.0, 1.0]
        );
        let lost = lost.unwrap();
        // 2² for a second and 1² for half a one, in one and a half.
        assert!(
            (lost.rms - (4.5_f64 / 1.5).sqrt()).abs() < 1.0e-12 && lost.greatest == 2.0,
            "{lost:?}"
        );
        assert!(
            (lost.share - (4.5_f64 / 10.0).sqrt()).abs() < 1.0e-12,
            "{lost:?}"
        );
        let text = "3 powers averaged over steps of 1 s: the energy of each step is kept, 1.732 W \
        rms (67.1 % of the rows' rms) and at most 2.000 W are \
                    left out";
        assert_eq!(lost.to_string(), text);
    }

    #[test]
    fn rounded_times_make_no_further_step() {
        // Late in a long file a row is a rounding off its 2 ms, and the sum of many rows is.
        let late = rows(&[(1.0, 100_000.002 - 100_000.0)]);
        assert_eq!(averaged(&late, Seconds(2.0e-3)).unwrap(), (late, None));
        let many = rows(&[(1.0, 1.0e-3 + 3.0e-13); 20_001]);
        assert_eq!(
            averaged(&many[..20_000], Seconds(2.0e-3)).unwrap().0.len(),
            10_000
        );
        assert_eq!(averaged(&many, Seconds(2.0e-3)).unwrap().0.len(), 10_001);
    }

    #[test]
    fn rows_that_have_no_mean_are_refused() {
        let mut mixed = rows(&[(1.0, 0.3), (2.0, 0.3)]);
        mixed[1].power = false;
        assert!(
            averaged(&mixed, Seconds(1.0))
                .unwrap_err()
                .contains("found both (row 2)")
        );
        assert_eq!(
            averaged(&rows(&[(1.0, 0.3), (2.0, 0.0)]), Seconds(1.0)).unwrap_err(),
            "row 2: expected a duration above 0 s, found 0 s"
        );
    }

    #[test]
    fn the_sum_over_time_is_kept_whatever_the_rows_and_the_step() {
        let mut rng = Rng::new(3);
        for _ in 0..200 {
            let count = 1 + (40.0 * rng.uniform()) as usize;
            let list: Vec<(f64, f64)> = (0..count)
                .map(|_| (100.0 * (rng.uniform() - 0.5), 1.0e-3 + 0.7 * rng.uniform()))
                .collect();
            let (rows, step_s) = (rows(&list), 0.05 + rng.uniform());
            let (means, _) = averaged(&rows, Seconds(step_s)).unwrap();
            let sum = |rows: &[Row]| {
                rows.iter()
                    .map(|row| row.value * row.duration_s.value())
                    .sum::<f64>()
            };
            assert!(
                (sum(&rows) - sum(&means)).abs() < 1.0e-6,
                "{} {}, {step_s} s",
                sum(&rows),
                sum(&means)
            );
        }
    }
}
