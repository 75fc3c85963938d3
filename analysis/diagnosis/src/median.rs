//! Median of values.

/// Returns the middle one, or the mean of both; zero of none.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values.as_slice() {
        [] => 0.0,
        all if all.len() % 2 == 1 => all[all.len() / 2],
        all => 0.5 * (all[all.len() / 2 - 1] + all[all.len() / 2]),
    }
}
