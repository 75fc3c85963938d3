//! Tail probabilities and quantiles of the normal, χ², F and t distributions, by the series and
//! continued fractions of the incomplete gamma and beta functions (Abramowitz and Stegun 6.5.29,
//! 6.5.31, 26.5.8). About ten digits; tails below 1e-300 are zero.

const EPSILON: f64 = 1e-15;
const TINY: f64 = 1e-300;
const STEPS: u32 = 5000;

/// Returns the probability that χ² of `dof` degrees of freedom exceeds `x`; 1 without degrees of
/// freedom.
pub fn chi2_tail(x: f64, dof: f64) -> f64 {
    if x > 0.0 && dof > 0.0 {
        gamma_tail(0.5 * dof, 0.5 * x)
    } else {
        1.0
    }
}

/// An F distribution: of the ratio of two mean squares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FDistribution {
    /// Degrees of freedom of the mean square above the line.
    pub above: f64,
    /// Degrees of freedom of the mean square below the line.
    pub below: f64,
}

impl FDistribution {
    /// P(F ≥ f); not a number when either degree of freedom is not above zero.
    pub fn tail(self, f: f64) -> f64 {
        let (a, b) = (self.above, self.below);
        if !(a > 0.0 && b > 0.0) {
            return f64::NAN;
        }
        if f <= 0.0 {
            return 1.0;
        }
        beta_lower(0.5 * b, 0.5 * a, b / (b + a * f))
    }
}

/// P(F ≥ f) for a square of one degree of freedom, with the standard deviation known to `freedom`.
fn square_tail(f: f64, freedom: f64) -> f64 {
    FDistribution {
        above: 1.0,
        below: freedom,
    }
    .tail(f)
}

/// P(X ≥ z) for a standard normal X.
pub fn normal_tail(z: f64) -> f64 {
    let t = chi2_tail(z * z, 1.0) / 2.0;
    if z >= 0.0 { t } else { 1.0 - t }
}

/// Returns the factor t with P(|T| ≤ t) = `level` for Student's distribution, by bisection;
/// infinite for no degrees of freedom.
pub fn t_factor(level: f64, freedom: f64) -> f64 {
    if freedom.is_nan() || freedom <= 0.0 {
        return f64::INFINITY;
    }
    factor(level, |square| square_tail(square, freedom))
}

/// Returns the factor x with P(χ² ≤ x²) = `level` for χ² of `freedom` degrees of freedom, by bisection.
pub fn chi_factor(level: f64, freedom: f64) -> f64 {
    factor(level, |square| chi2_tail(square, freedom))
}

/// Returns x where the tail beyond x² is 1 − `level`.
fn factor(level: f64, tail: impl Fn(f64) -> f64) -> f64 {
    let (mut lo, mut hi) = (0.0f64, 1e6f64);
    for _ in 0..200 {
        let mid = if hi > 2.0 * lo.max(1e-3) {
            (lo.max(1e-3) * hi).sqrt()
        } else {
            0.5 * (lo + hi)
        };
        if 1.0 - tail(mid * mid) < level {
            lo = mid;
        } else {
            hi = mid;
        }
    }
    0.5 * (lo + hi)
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
        // Upper 5 % and 1 % points of F, two-sided factors of t, tails of the normal distribution,
        // as tables print them.
        for (a, b, f, p) in [
            (2.0, 30.0, 3.316, 0.05),
            (2.0, 30.0, 5.390, 0.01),
            (10.0, 150.0, 1.894, 0.05),
            (1.0, 1.0, 161.45, 0.05),
        ] {
            let met = FDistribution { above: a, below: b }.tail(f);
            assert!((met / p - 1.0).abs() < 2e-3, "F({a}, {b}) > {f}: {met}");
        }
        for (level, freedom, t) in [
            (0.95, 4.0, 2.7764),
            (0.95, 20.0, 2.0860),
            (0.95, 1e7, 1.9600),
            (0.6827, 1e7, 1.0000),
            (0.99, 1.0, 63.657),
        ] {
            assert!(
                (t_factor(level, freedom) / t - 1.0).abs() < 1e-4,
                "t {level} {freedom}: {}",
                t_factor(level, freedom)
            );
        }
        for (z, p) in [
            (0.0, 0.5),
            (1.644_854, 0.05),
            (3.090_232, 0.001),
            (-1.644_854, 0.95),
            (6.0, 9.8659e-10),
        ] {
            assert!(
                (normal_tail(z) / p - 1.0).abs() < 1e-4,
                "{z}: {}",
                normal_tail(z)
            );
        }
        assert!(
            FDistribution {
                above: 0.0,
                below: 3.0
            }
            .tail(1.0)
            .is_nan()
                && t_factor(0.95, 0.0).is_infinite()
        );
    }
}
