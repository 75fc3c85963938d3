//! Errors that the points of a spectrum have in common, and the contribution of the open-circuit
//! voltage to an impedance.
//!
//! A covariance point by point does not describe how errors at two frequencies correlate. Here each
//! common cause (the error of a correction, the slope of the open-circuit voltage) is a factor: one
//! number of variance 1 that moves all points along a known direction. The covariance of points k
//! and l is then Cₖδₖₗ + Σ dₖdₗᵀ, with d the directions as vectors of real and imaginary part.

mod cause;

use num_complex::Complex64;

use super::{ImpedancePoint, Spectrum};
use analysis_numeric::Covariance2;
pub use cause::{OCV_SLOPE, OcvSlope, SharedError};

impl OcvSlope {
    /// Ratio of the slope to the real part of Z at the lowest frequency if no curve is known, 1/s,
    /// and its standard deviation.
    ///
    /// slope/R = (dU/dSOC)/(R·Q). For lithium-ion cells dU/dSOC is 0.1 V (LFP, plateau) to 1.2 V
    /// (NMC, NCA). R·Q is 23 mΩ·Ah (A123 26650) to 100 mΩ·Ah (Panasonic NCR18650PF), and 63 mΩ·Ah
    /// for the Molicel P45B, by the measurements in `fixtures/data`. The ratio is then 0.0006
    /// to 0.008 1/s.
    const PRIOR_PER_S: f64 = 0.004;

    /// Prior of the slope for a spectrum of which no open-circuit voltage is known: 0.4 % ± 0.4 %
    /// of Re Z at the lowest frequency per second. None without points.
    pub fn prior(spectrum: &Spectrum) -> Option<Self> {
        let lowest = spectrum
            .points
            .iter()
            .min_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz))?;
        let v_per_coulomb = Self::PRIOR_PER_S * lowest.z_ohm.re.abs();
        Some(Self {
            v_per_coulomb,
            sigma_v_per_coulomb: v_per_coulomb,
        })
    }

    /// Checks whether it is a [`Self::prior`] and not a measured slope: its uncertainty equals the
    /// slope itself in every bit. The slope of a flat curve may have a larger uncertainty.
    pub fn is_prior(&self) -> bool {
        self.sigma_v_per_coulomb == self.v_per_coulomb
    }

    /// Returns the share of the slope in an impedance, −j·(dU/dQ)/ω, Ω.
    pub fn impedance(&self, freq_hz: f64) -> Complex64 {
        Complex64::new(0.0, -self.v_per_coulomb / (std::f64::consts::TAU * freq_hz))
    }
}

impl Spectrum {
    /// Creates a spectrum without shared errors.
    pub fn new(name: impl Into<String>, points: Vec<ImpedancePoint>) -> Self {
        Self {
            name: name.into(),
            points,
            ..Self::default()
        }
    }

    /// Leaves out the points that are not wanted, and their part of the shared errors.
    pub fn keep(&mut self, wanted: impl Fn(&ImpedancePoint) -> bool) {
        let kept: Vec<bool> = self.points.iter().map(wanted).collect();
        let is_kept = |k: usize| kept.get(k).copied().unwrap_or(false);
        for error in &mut self.shared {
            error.at_ohm = error
                .at_ohm
                .iter()
                .enumerate()
                .filter(|(k, _)| is_kept(*k))
                .map(|(_, d)| *d)
                .collect();
        }
        self.points = self
            .points
            .iter()
            .enumerate()
            .filter(|(k, _)| is_kept(*k))
            .map(|(_, point)| *point)
            .collect();
    }

    /// Returns the spectrum without the share of the open-circuit voltage. The uncertainty of the
    /// slope becomes a shared error. A spectrum that has lost it already comes back as it is.
    #[must_use]
    pub fn less_charge_storage(&self, slope: OcvSlope) -> Self {
        let mut left = self.clone();
        if self.less.is_some() {
            return left;
        }
        let sigma = OcvSlope {
            v_per_coulomb: slope.sigma_v_per_coulomb,
            ..slope
        };
        let at_ohm: Vec<Complex64> = self
            .points
            .iter()
            .map(|point| sigma.impedance(point.freq_hz))
            .collect();
        for (point, error) in left.points.iter_mut().zip(&at_ohm) {
            point.z_ohm -= slope.impedance(point.freq_hz);
            point.covariance = point.covariance + Covariance2::along(*error);
        }
        if slope.sigma_v_per_coulomb > 0.0 {
            left.shared.push(SharedError {
                name: OCV_SLOPE.to_owned(),
                at_ohm,
            });
        }
        left.less = Some(slope);
        left
    }

    /// Returns the covariance of a point, by its number, without the errors that it shares with
    /// others. NaN if it is unknown.
    pub fn own_covariance(&self, index: usize) -> Covariance2 {
        let total = self
            .points
            .get(index)
            .map_or(Covariance2::UNKNOWN, |point| point.covariance);
        if self.shared.is_empty() || !total.re_re.is_finite() {
            return total;
        }
        let shared = self
            .shared
            .iter()
            .filter_map(|error| error.at_ohm.get(index));
        let left = shared.fold(total, |left, direction| {
            left + Covariance2::along(*direction).times(-1.0)
        });
        // The difference of nearly equal numbers must stay a covariance.
        let least = Covariance2 {
            re_re: LEAST_OWN * total.re_re,
            re_im: 0.0,
            im_im: LEAST_OWN * total.im_im,
        };
        Covariance2 {
            re_re: left.re_re.max(least.re_re),
            re_im: left.re_im,
            im_im: left.im_im.max(least.im_im),
        }
        .tamed()
    }
}

impl Spectrum {
    /// Returns the spectrum with the share of the open-circuit voltage that was taken out of it.
    #[must_use]
    pub fn with_charge_storage(&self) -> Self {
        let mut whole = self.clone();
        let Some(slope) = whole.less.take() else {
            return whole;
        };
        if let Some(at) = whole
            .shared
            .iter()
            .position(|error| error.name == OCV_SLOPE)
        {
            let error = whole.shared.remove(at);
            for (point, direction) in whole.points.iter_mut().zip(&error.at_ohm) {
                point.covariance = point.covariance + Covariance2::along(*direction).times(-1.0);
            }
        }
        whole
            .points
            .iter_mut()
            .for_each(|point| point.z_ohm += slope.impedance(point.freq_hz));
        whole
    }
}

/// Least share of a point's variance that counts as its own: rounding of the difference.
const LEAST_OWN: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;

    fn spectrum() -> Spectrum {
        let point = |freq_hz: f64| ImpedancePoint {
            freq_hz,
            z_ohm: Complex64::new(0.009, -0.001),
            covariance: Covariance2 {
                re_re: 4e-12,
                re_im: 1e-12,
                im_im: 3e-12,
            },
            amplitude_a: 1.0,
        };
        Spectrum::new("s", vec![point(1.0), point(0.1)])
    }

    #[test]
    fn a_prior_is_distinguished_from_a_slope_that_was_given() {
        assert!(OcvSlope::prior(&spectrum()).unwrap().is_prior());
        let given = OcvSlope {
            v_per_coulomb: 5e-5,
            sigma_v_per_coulomb: 2e-6,
        };
        assert!(!given.is_prior());
    }

    #[test]
    fn charge_storage_goes_and_its_uncertainty_is_shared() {
        let slope = OcvSlope {
            v_per_coulomb: 5e-5,
            sigma_v_per_coulomb: 1e-6,
        };
        let left = spectrum().less_charge_storage(slope);
        let omega = std::f64::consts::TAU * 0.1;
        assert!(
            (left.points[1].z_ohm.im - (-0.001 + 5e-5 / omega)).abs() < 1e-15,
            "{}",
            left.points[1].z_ohm
        );
        assert_eq!(left.points[1].z_ohm.re, 0.009);
        assert!((left.points[1].covariance.im_im - (3e-12 + (1e-6 / omega).powi(2))).abs() < 1e-18);
        let own = left.own_covariance(1);
        assert!(
            (own.im_im - 3e-12).abs() < 1e-15
                && (own.re_im - 1e-12).abs() < 1e-15
                && (own.re_re - 4e-12).abs() < 1e-15,
            "{own:?}"
        );
        assert_eq!(
            left.less_charge_storage(slope),
            left,
            "it is taken out once"
        );
    }

    #[test]
    fn sorting_takes_the_shared_errors_along() {
        let mut left = spectrum().less_charge_storage(OcvSlope {
            v_per_coulomb: 5e-5,
            sigma_v_per_coulomb: 1e-6,
        });
        let at_low = left.shared[0].at_ohm[1];
        left.sort();
        assert_eq!(
            (left.points[0].freq_hz, left.shared[0].at_ohm[0]),
            (0.1, at_low)
        );
        assert!(left.validate().is_ok());
        left.shared[0].at_ohm.pop();
        let message = left.validate().unwrap_err().to_string();
        assert_eq!(
            message,
            "spectrum \"s\": expected one value of the shared error \"OCV slope\" per point, 2 in \
            all, met 1"
        );
    }

    #[test]
    fn an_unknown_covariance_stays_unknown() {
        let mut one = spectrum();
        one.points[0].covariance = Covariance2::UNKNOWN;
        assert!(one.own_covariance(0).re_re.is_nan());
    }
}
