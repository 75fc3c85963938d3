//! Tail probabilities of the normal, χ², F and t distributions, by the series and continued
//! fractions of the incomplete gamma and beta functions (Abramowitz and
//! Stegun 6.5.29, 6.5.31, 26.5.8). About ten digits; tails below 1e-300 are zero.

use analysis_numeric::stats::FDistribution;

const EPSILON: f64 = 1e-15;
const TINY: f64 = 1e-300;
const STEPS: u32 = 500;

/// Returns the probability that χ² of `dof` degrees of freedom exceeds `x`; 1 without degrees of
/// freedom.
pub fn chi2_tail(x: f64, dof: f64) -> f64 {
    if x > 0.0 && dof > 0.0 {
        gamma_tail(0.5 * dof, 0.5 * x)
    } else {
        1.0
    }
}

/// Probability that a ratio of two mean squares exceeds `x`.
pub(super) fn f_tail(x: f64, dof: FDistribution) -> f64 {
    let FDistribution { above, below } = dof;
    if x > 0.0 && above > 0.0 {
        beta_lower(0.5 * below, 0.5 * above, below / (below + above * x))
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

/// ln Γ(x) for x > 0: Stirling's series after a shift beyond 10.
fn ln_gamma(x: f64) -> f64 {
    let mut shift = 0.0;
    let mut y = x;
    while y < 10.0 {
        shift += y.ln();
        y += 1.0;
    }
    let z = 1.0 / (y * y);
    let series = (1.0 / 12.0 - z * (1.0 / 360.0 - z * (1.0 / 1260.0 - z / 1680.0))) / y;
    (y - 0.5) * y.ln() - y + 0.5 * std::f64::consts::TAU.ln() + series - shift
}

/// Γ(a, x)/Γ(a).
fn gamma_tail(a: f64, x: f64) -> f64 {
    let scale = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let mut term = 1.0 / a;
        let mut sum = term;
        for k in 1..STEPS {
            term *= x / (a + f64::from(k));
            sum += term;
            if term < sum * EPSILON {
                break;
            }
        }
        return 1.0 - sum * scale;
    }
    let fraction = |k: f64| {
        (
            if k == 0.0 { 1.0 } else { -k * (k - a) },
            x + 1.0 - a + 2.0 * k,
        )
    };
    scale * continued(fraction)
}

/// I_x(a, b).
fn beta_lower(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return if x > 0.0 { 1.0 } else { 0.0 };
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - beta_lower(b, a, 1.0 - x);
    }
    let scale =
        (a * x.ln() + b * (-x).ln_1p() + ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b)).exp() / a;
    let fraction = |k: f64| {
        let m = (0.5 * k).floor();
        let numerator = if k == 0.0 {
            1.0
        } else if k % 2.0 == 0.0 {
            m * (b - m) * x / ((a + k - 1.0) * (a + k))
        } else {
            -(a + m) * (a + b + m) * x / ((a + k - 1.0) * (a + k))
        };
        (numerator, 1.0)
    };
    scale * continued(fraction)
}

/// a₀/(b₀ + a₁/(b₁ + …)) by Lentz's method; the function gives (aₖ, bₖ).
fn continued(term: impl Fn(f64) -> (f64, f64)) -> f64 {
    let guard = |v: f64| if v.abs() < TINY { TINY } else { v };
    let (first, b0) = term(0.0);
    // The denominator b₀ + a₁/(b₁ + …) is what converges.
    let (mut c, mut d) = (guard(b0), 0.0);
    let mut value = c;
    for k in 1..STEPS {
        let (a, b) = term(f64::from(k));
        d = 1.0 / guard(b + a * d);
        c = guard(b + a / c);
        value *= c * d;
        if (c * d - 1.0).abs() < EPSILON {
            break;
        }
    }
    first / value
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
