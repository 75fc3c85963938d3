//! Hyperbolic functions of a complex number with real part of zero or more, as diffusion elements
//! need them: exact near zero, no overflow far out.
//!
//! With t = tanh x and S = 1/cosh² x the quotients stay finite for every x: tanh(x + jy) = (t +
//! j·S·sin y·cos y)/(t² + S·cos² y), coth(x + jy) = (t − j·S·sin y·cos y)/(t² + S·sin² y).

use num_complex::Complex64;

/// Real part beyond which 1/cosh² and 1/sinh² are below 1e-260 and count as zero.
const FAR: f64 = 300.0;
/// |q²| below which the power series of tanh(q)/q is used.
const NEAR: f64 = 0.02;
/// Coefficients of tanh(q)/q in powers of q².
const TANH_SERIES: [f64; 8] = [
    1.0,
    -1.0 / 3.0,
    2.0 / 15.0,
    -17.0 / 315.0,
    62.0 / 2835.0,
    -1382.0 / 155_925.0,
    21_844.0 / 6_081_075.0,
    -929_569.0 / 638_512_875.0,
];

/// tanh q.
pub(super) fn tanh(q: Complex64) -> Complex64 {
    let (t, s) = real_parts(q.re);
    let (sin, cos) = q.im.sin_cos();
    Complex64::new(t, s * sin * cos) / (t * t + s * cos * cos)
}

/// coth q.
pub(super) fn coth(q: Complex64) -> Complex64 {
    let (t, s) = real_parts(q.re);
    let (sin, cos) = q.im.sin_cos();
    Complex64::new(t, -s * sin * cos) / (t * t + s * sin * sin)
}

/// 1/sinh² q.
pub(super) fn csch_squared(q: Complex64) -> Complex64 {
    if q.re > FAR {
        return Complex64::ZERO;
    }
    let sinh = q.sinh();
    (sinh * sinh).inv()
}

/// 1/sinh q.
pub(super) fn csch(q: Complex64) -> Complex64 {
    if q.re > FAR {
        return Complex64::ZERO;
    }
    q.sinh().inv()
}

/// tanh(q)/q and q·d/dq of it, sech² q − tanh(q)/q; the difference would lose its digits near zero.
pub(super) fn tanh_over(q: Complex64) -> (Complex64, Complex64) {
    let square = q * q;
    if square.norm() < NEAR {
        let (mut value, mut slope) = (Complex64::ZERO, Complex64::ZERO);
        for (k, coefficient) in TANH_SERIES.iter().enumerate().rev() {
            value = value * square + coefficient;
            slope = slope * square + 2.0 * k as f64 * coefficient;
        }
        return (value, slope);
    }
    let value = tanh(q) / q;
    let cosh = q.cosh();
    let sech_squared = if q.re > FAR {
        Complex64::ZERO
    } else {
        (cosh * cosh).inv()
    };
    (value, sech_squared - value)
}

/// tanh x and 1/cosh² x of a real number.
fn real_parts(x: f64) -> (f64, f64) {
    let e = (-2.0 * x.abs()).exp();
    (x.tanh(), 4.0 * e / ((1.0 + e) * (1.0 + e)))
}
