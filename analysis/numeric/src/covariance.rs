//! Covariance of a complex number.

use num_complex::Complex64;

/// Covariance of a complex number's real and imaginary part, in its unit squared. Not a number
/// where unknown.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Covariance2 {
    /// Variance of the real part.
    pub re_re: f64,
    /// Covariance of the real and the imaginary part.
    pub re_im: f64,
    /// Variance of the imaginary part.
    pub im_im: f64,
}

impl Covariance2 {
    /// Nothing is known of the uncertainty.
    pub const UNKNOWN: Self = Self {
        re_re: f64::NAN,
        re_im: f64::NAN,
        im_im: f64::NAN,
    };
}

impl Covariance2 {
    /// No uncertainty.
    pub const ZERO: Self = Self {
        re_re: 0.0,
        re_im: 0.0,
        im_im: 0.0,
    };

    /// Equal and independent parts, each of the given variance.
    pub const fn circular(variance: f64) -> Self {
        Self {
            re_re: variance,
            re_im: 0.0,
            im_im: variance,
        }
    }

    /// Covariance of `direction` times a real number of variance 1.
    pub fn along(direction: Complex64) -> Self {
        Self {
            re_re: direction.re * direction.re,
            re_im: direction.re * direction.im,
            im_im: direction.im * direction.im,
        }
    }

    /// Covariance of `factor` times the number: the parts are turned and stretched.
    pub fn scaled(self, factor: Complex64) -> Self {
        let Complex64 { re: a, im: b } = factor;
        let Self {
            re_re,
            re_im,
            im_im,
        } = self;
        Self {
            re_re: a * a * re_re - 2.0 * a * b * re_im + b * b * im_im,
            re_im: a * b * (re_re - im_im) + (a * a - b * b) * re_im,
            im_im: b * b * re_re + 2.0 * a * b * re_im + a * a * im_im,
        }
    }

    /// Covariance of the number times the root of `factor`.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        Self {
            re_re: factor * self.re_re,
            re_im: factor * self.re_im,
            im_im: factor * self.im_im,
        }
    }

    /// Returns the variance of the part along the direction of angle `angle_rad`.
    pub fn variance_along(&self, angle_rad: f64) -> f64 {
        let (sin, cos) = angle_rad.sin_cos();
        // Rounding must not turn a vanishing variance negative; not-a-number passes.
        let variance =
            cos * cos * self.re_re + 2.0 * sin * cos * self.re_im + sin * sin * self.im_im;
        if variance < 0.0 { 0.0 } else { variance }
    }

    /// True for a covariance: finite, no negative variance, correlation within −1…1 but for
    /// rounding.
    pub fn is_valid(&self) -> bool {
        let product = self.re_re * self.im_im;
        let finite = self.re_re.is_finite() && self.re_im.is_finite() && self.im_im.is_finite();
        finite
            && self.re_re >= 0.0
            && self.im_im >= 0.0
            && self.re_im * self.re_im <= product * (1.0 + 1e-9) + f64::MIN_POSITIVE
    }

    /// Returns the same covariance with a correlation within ±1.
    #[must_use]
    pub fn tamed(self) -> Self {
        let most = (self.re_re * self.im_im).sqrt() * (1.0 - 1e-9);
        Self {
            re_im: self.re_im.clamp(-most.max(0.0), most.max(0.0)),
            ..self
        }
    }
}

impl std::ops::Add for Covariance2 {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            re_re: self.re_re + other.re_re,
            re_im: self.re_im + other.re_im,
            im_im: self.im_im + other.im_im,
        }
    }
}

impl std::iter::Sum for Covariance2 {
    fn sum<I: Iterator<Item = Self>>(parts: I) -> Self {
        parts.fold(Self::ZERO, |sum, part| sum + part)
    }
}
