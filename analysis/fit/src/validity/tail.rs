//! Tail probabilities of sums of squared deviates, of known or estimated variance.

use analysis_numeric::stats::FDistribution;
pub use analysis_numeric::stats::chi2_tail;

/// Probability that a ratio of two mean squares exceeds `x`; 1 without degrees of freedom above.
pub(super) fn f_tail(x: f64, dof: FDistribution) -> f64 {
    if x > 0.0 && dof.above > 0.0 {
        dof.tail(x)
    } else {
        1.0
    }
}

fn dofs(above: f64, below: f64) -> FDistribution {
    FDistribution { above, below }
}

/// Probability that the sum of two squared standard deviates exceeds `d2`; with estimated variance
/// of `dof` degrees of freedom where it is not stated.
pub(super) fn pair_tail(d2: f64, dof: Option<f64>) -> f64 {
    dof.map_or_else(
        || (-0.5 * d2).exp(),
        |dof| (1.0 + d2 / dof).powf(-0.5 * dof),
    )
}

/// Probability of a deviation of at least `t` standard deviations on either side; Student's where
/// the deviation is estimated.
pub fn deviate_tail(t: f64, dof: Option<f64>) -> f64 {
    dof.map_or_else(
        || chi2_tail(t * t, 1.0),
        |dof| f_tail(t * t, dofs(1.0, dof)),
    )
}

/// Probability that a weighted sum of `dof` squared residuals exceeds `x`; with estimated variance
/// where it is not stated.
pub(super) fn sum_tail(x: f64, dof: f64, noise_dof: Option<f64>) -> f64 {
    noise_dof.map_or_else(
        || chi2_tail(x, dof),
        |noise| f_tail(x / dof, dofs(dof, noise)),
    )
}

/// Probabilities of many tests after Holm (1979): each may be compared with the rate that all
/// together are to have.
pub fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
    let mut adjusted = vec![1.0; p.len()];
    let mut least = 0.0_f64;
    for (rank, k) in order.into_iter().enumerate() {
        least = least.max((p.len() - rank) as f64 * p[k]).min(1.0);
        adjusted[k] = least;
    }
    adjusted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_printed_tables() {
        // Abramowitz and Stegun, tables 26.1, 26.8, 26.9, 26.10: 5 % and 1 % points, to the digits
        // printed.
        for (x, dof, p) in [
            (3.84146, 1.0, 0.05),
            (18.3070, 10.0, 0.05),
            (50.8922, 30.0, 0.01),
            (135.807, 100.0, 0.01),
        ] {
            assert!(
                (chi2_tail(x, dof) / p - 1.0).abs() < 1e-4,
                "χ² {x}: {}",
                chi2_tail(x, dof)
            );
        }
        for (x, dof, p) in [
            (3.33, dofs(5.0, 10.0), 0.05),
            (5.64, dofs(5.0, 10.0), 0.01),
            (2.18, dofs(8.0, 40.0), 0.05),
        ] {
            assert!(
                (f_tail(x, dof) / p - 1.0).abs() < 1e-2,
                "F {x}: {}",
                f_tail(x, dof)
            );
        }
        assert!((deviate_tail(2.228_14, Some(10.0)) / 0.05 - 1.0).abs() < 1e-4);
        assert!((deviate_tail(1.959_964, None) / 0.05 - 1.0).abs() < 1e-5);
        assert!((deviate_tail(8.0, None) / 1.244_192e-15 - 1.0).abs() < 1e-5);
    }

    #[test]
    fn holm_steps_down() {
        // Worked by hand: 4·0.005, 3·0.01, then 2·0.03 and 1·0.04 raised to it.
        let met = holm(&[0.01, 0.04, 0.03, 0.005]);
        for (met, expected) in met.iter().zip([0.03, 0.06, 0.06, 0.02]) {
            assert!((met - expected).abs() < 1e-12, "{met} {expected}");
        }
    }

    #[test]
    fn pairs_are_the_special_case_of_two() {
        for d2 in [0.1, 1.0, 9.0, 40.0] {
            assert!((pair_tail(d2, None) / chi2_tail(d2, 2.0) - 1.0).abs() < 1e-9);
            assert!(
                (pair_tail(d2, Some(13.0)) / f_tail(0.5 * d2, dofs(2.0, 13.0)) - 1.0).abs() < 1e-9
            );
        }
        assert_eq!(
            (chi2_tail(-1.0, 3.0), f_tail(0.0, dofs(2.0, 3.0))),
            (1.0, 1.0)
        );
    }
}
