//! The lowest points of a sweep, which a drift of the record changes first.

use analysis_signal::spectrum::FlaggedPoint;
use num_complex::Complex64;

use super::base::Base;

/// Prediction error, in standard uncertainties, beyond which a point does not belong to the branches.
const LIMIT: f64 = 4.5;

/// Returns the number of lowest frequencies that the changes at all higher ones do not predict, and the
/// points with their reasons.
pub(super) fn trend(
    base: &Base<'_>,
    differences: &[Option<Complex64>],
) -> (usize, Vec<FlaggedPoint>) {
    let errors = |index: usize| -> Option<[f64; 2]> {
        let difference = differences[index]?;
        let higher = base.solve(differences, index + 1, false)?;
        Some(higher.prediction_error(&base.data(index, difference, false)))
    };
    // Half of the points must remain to predict the others.
    let low = 0..differences.len() / 2;
    let found: Vec<Option<[f64; 2]>> = low.map(errors).collect();
    let beyond = |e: &Option<[f64; 2]>| e.is_some_and(|e| e.iter().any(|v| v.abs() > LIMIT));
    let count = found.iter().rposition(beyond).map_or(0, |last| last + 1);
    let flagged = found.iter().take(count).enumerate();
    let points = flagged.filter_map(|(index, e)| {
        let [re, im] = (*e)?;
        Some(FlaggedPoint {
            freq_hz: base.spread[index].freq_hz,
            reasons: vec![format!(
                "trend: expected the impedance that the higher frequencies predict, found Re {re:+.1} \
                and Im {im:+.1} standard uncertainties from it"
            )],
        })
    });
    (count, points.collect())
}
