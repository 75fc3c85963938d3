//! Open-circuit voltage (OCV) over state of charge (SOC): the curve that every other part reads.
//!
//! SOC is a fraction, 0 at the lower and 1 at the upper voltage limit; the capacity between them
//! converts it to charge. Between the knots the curve is the cubic Hermite polynomial of the knots'
//! values and slopes; beyond the first and the last knot it continues as a straight line, so that a
//! simulation that leaves the table is not held at its end. [`extract`] finds the curve of a slow
//! discharge.

mod extract;
mod interrupted;
mod polynomial;
mod reach;
mod spline;

pub use extract::{ExtractError, Hysteresis, OcvExtraction, OcvOptions, compensated, extract};
pub use interrupted::{Interrupted, Interruption, interrupted};
pub use polynomial::{MAX_ORDER, OcvPolynomial};
pub use reach::Reach;

use analysis_signal::spectrum::OcvSlope;
use serde::{Deserialize, Serialize};

/// Standard deviation of the voltage at rest of a measured cell, V, if nothing else is known: the
/// voltmeters of the known supplies are specified to a few millivolts, and at the end of a rest a
/// few millivolts of relaxation remain.
pub const REST_SIGMA_V: f64 = 5.0e-3;

/// Standard deviation of the slope of a curve, as a share, by convention: cells of one make differ
/// by 1 to 2 % in capacity, and a curve is drawn through knots.
pub const SLOPE_SHARE: f64 = 0.03;

/// Open-circuit voltage over state of charge.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OcvCurve {
    /// Charge between SOC 0 and 1, Ah, above zero.
    pub capacity_ah: f64,
    /// State of charge at the knots, rising, 0…1.
    pub soc: Vec<f64>,
    /// OCV at the knots, V, rising.
    pub ocv_v: Vec<f64>,
    /// dOCV/dSOC at the knots, V, zero or more.
    pub slope_v: Vec<f64>,
}

/// Reason why knots are not a valid OCV curve.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OcvError {
    /// Lists that do not belong together.
    #[error(
        "OCV curve: expected at least 2 knots and as many voltages and slopes, met {soc}, {ocv} \
        and {slope}"
    )]
    Lengths {
        /// Number of states of charge.
        soc: usize,
        /// Number of voltages.
        ocv: usize,
        /// Number of slopes.
        slope: usize,
    },
    /// A value that cannot be.
    #[error("OCV curve, knot {knot} (counted from 1): expected {expected}, met {met}")]
    Knot {
        /// Number of the knot, from 1.
        knot: usize,
        /// Allowed values, as text.
        expected: &'static str,
        /// Value found.
        met: f64,
    },
    /// The capacity is invalid.
    #[error("OCV curve: expected a capacity above 0 Ah, met {met}")]
    Capacity {
        /// The value met, Ah.
        met: f64,
    },
}

impl OcvCurve {
    /// Returns the monotone curve through knots (SOC, V): slopes by Fritsch and Carlson (1980), so
    /// that it never overshoots between them.
    ///
    /// ```
    /// use analysis_model::ocv::OcvCurve;
    ///
    /// let soc = vec![0.0, 0.1, 0.5, 0.9, 1.0];
    /// let curve = OcvCurve::monotone(4.5, soc, vec![2.7, 3.3, 3.7, 4.0, 4.2])?;
    /// let half_v = curve.voltage_v(0.5);
    /// assert!((half_v - 3.7).abs() < 1e-12);
    /// assert!(curve.slope_v(0.05) > curve.slope_v(0.5));
    /// assert!(curve.soc_at(half_v).is_some_and(|soc| (soc - 0.5).abs() < 1e-6));
    /// assert!(curve.soc_at(4.3).is_none());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`OcvError`] unless capacity, SOC and voltages are as the fields want them.
    pub fn monotone(capacity_ah: f64, soc: Vec<f64>, ocv_v: Vec<f64>) -> Result<Self, OcvError> {
        let slope_v = if soc.len() == ocv_v.len() {
            monotone_slopes(&soc, &ocv_v)
        } else {
            Vec::new()
        };
        let curve = Self {
            capacity_ah,
            soc,
            ocv_v,
            slope_v,
        };
        curve.validate()?;
        Ok(curve)
    }

    /// Checks lengths, order and signs.
    ///
    /// # Errors
    /// [`OcvError`] for the first thing that is wrong.
    pub fn validate(&self) -> Result<(), OcvError> {
        let (soc, ocv, slope) = (self.soc.len(), self.ocv_v.len(), self.slope_v.len());
        if soc < 2 || ocv != soc || slope != soc {
            return Err(OcvError::Lengths { soc, ocv, slope });
        }
        if !(self.capacity_ah > 0.0 && self.capacity_ah.is_finite()) {
            return Err(OcvError::Capacity {
                met: self.capacity_ah,
            });
        }
        let fail = |k: usize, expected, met| {
            Err(OcvError::Knot {
                knot: k + 1,
                expected,
                met,
            })
        };
        let fall = |values: &[f64], k: usize, strictly: bool| {
            k > 0 && (values[k] < values[k - 1] || (strictly && values[k] == values[k - 1]))
        };
        if let Some(k) =
            (0..soc).find(|&k| !(0.0..=1.0).contains(&self.soc[k]) || fall(&self.soc, k, true))
        {
            return fail(k, "rising SOC within 0 to 1", self.soc[k]);
        }
        if let Some(k) =
            (0..soc).find(|&k| !self.ocv_v[k].is_finite() || fall(&self.ocv_v, k, false))
        {
            return fail(k, "voltages that do not fall, in V", self.ocv_v[k]);
        }
        if let Some(k) =
            (0..soc).find(|&k| !(self.slope_v[k].is_finite() && self.slope_v[k] >= 0.0))
        {
            return fail(k, "a slope of 0 V or more", self.slope_v[k]);
        }
        Ok(())
    }

    /// Returns the slope over charge at a voltage at rest, with its standard deviation: the curve
    /// is good to `share` of its slope (it is often another cell's), and the voltage to `sigma_v`.
    /// None outside the curve.
    pub fn charge_slope(&self, rest_v: f64, sigma_v: f64, share: f64) -> Option<OcvSlope> {
        let soc = self.soc_at(rest_v)?;
        let capacity_coulomb = 3600.0 * self.capacity_ah;
        let slope_v = self.slope_v(soc);
        let beside = |v: f64| {
            self.soc_at(v)
                .map_or(0.0, |soc| (self.slope_v(soc) - slope_v).abs())
        };
        let by_place = 0.5 * (beside(rest_v - sigma_v) + beside(rest_v + sigma_v));
        Some(OcvSlope {
            v_per_coulomb: slope_v / capacity_coulomb,
            sigma_v_per_coulomb: by_place.hypot(share * slope_v) / capacity_coulomb,
        })
    }

    /// OCV at a state of charge, V.
    pub fn voltage_v(&self, soc: f64) -> f64 {
        self.at(soc).0
    }

    /// dOCV/dSOC at a state of charge, V.
    pub fn slope_v(&self, soc: f64) -> f64 {
        self.at(soc).1
    }

    /// OCV, V, and its slope dOCV/dSOC, V, at a state of charge.
    pub fn at(&self, soc: f64) -> (f64, f64) {
        let last = self.soc.len() - 1;
        if soc <= self.soc[0] || soc >= self.soc[last] {
            let end = if soc <= self.soc[0] { 0 } else { last };
            return (
                self.ocv_v[end] + self.slope_v[end] * (soc - self.soc[end]),
                self.slope_v[end],
            );
        }
        let k = self.soc.partition_point(|z| *z <= soc).clamp(1, last) - 1;
        let h = self.soc[k + 1] - self.soc[k];
        let t = (soc - self.soc[k]) / h;
        let (y0, y1, m0, m1) = (
            self.ocv_v[k],
            self.ocv_v[k + 1],
            h * self.slope_v[k],
            h * self.slope_v[k + 1],
        );
        let rise = y1 - y0;
        let value = y0 + t * (m0 + t * (3.0 * rise - 2.0 * m0 - m1 + t * (m0 + m1 - 2.0 * rise)));
        let slope =
            m0 + t * (2.0 * (3.0 * rise - 2.0 * m0 - m1) + 3.0 * t * (m0 + m1 - 2.0 * rise));
        (value, slope / h)
    }

    /// Returns the state of charge of an OCV within the curve's range; none outside it.
    pub fn soc_at(&self, ocv_v: f64) -> Option<f64> {
        let (mut lo, mut hi) = (*self.soc.first()?, *self.soc.last()?);
        if !(self.voltage_v(lo) <= ocv_v && ocv_v <= self.voltage_v(hi)) {
            return None;
        }
        while hi - lo > 1e-14 {
            let middle = 0.5 * (lo + hi);
            if middle <= lo || middle >= hi {
                break;
            }
            if self.voltage_v(middle) < ocv_v {
                lo = middle;
            } else {
                hi = middle;
            }
        }
        Some(0.5 * (lo + hi))
    }
}

/// Slopes that make the cubic Hermite interpolant of rising data rise everywhere.
fn monotone_slopes(x: &[f64], y: &[f64]) -> Vec<f64> {
    let n = x.len();
    if n < 2 {
        return vec![0.0; n];
    }
    let secant: Vec<f64> = (0..n - 1)
        .map(|k| (y[k + 1] - y[k]) / (x[k + 1] - x[k]))
        .collect();
    let mut slope = vec![secant[0]; n];
    slope[n - 1] = secant[n - 2];
    for k in 1..n - 1 {
        let (before, after) = (secant[k - 1], secant[k]);
        let (h0, h1) = (x[k] - x[k - 1], x[k + 1] - x[k]);
        // The weighted harmonic mean of Fritsch and Butland keeps within the bound 3·min(secants)
        // for any spacing.
        let (w0, w1) = (h0 + 2.0 * h1, 2.0 * h0 + h1);
        slope[k] = if before > 0.0 && after > 0.0 {
            (w0 + w1) / (w0 / before + w1 / after)
        } else {
            0.0
        };
    }
    slope
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn curve() -> OcvCurve {
        OcvCurve::monotone(
            4.2,
            vec![0.0, 0.1, 0.5, 0.9, 1.0],
            vec![2.5, 3.3, 3.7, 4.05, 4.2],
        )
        .unwrap()
    }

    #[test]
    fn goes_through_its_knots_and_straight_beyond_them() {
        let c = curve();
        for (z, u) in c.soc.iter().zip(&c.ocv_v) {
            assert!((c.voltage_v(*z) - u).abs() < 1e-12);
        }
        assert!((c.voltage_v(1.05) - (4.2 + 0.05 * c.slope_v(1.0))).abs() < 1e-12);
        assert!((c.voltage_v(-0.05) - (2.5 - 0.05 * c.slope_v(0.0))).abs() < 1e-12);
        assert_eq!(c.soc_at(4.3), None);
        assert_eq!(c.soc_at(2.4), None);
    }

    #[test]
    fn refuses_what_is_not_a_curve() {
        let cases = [
            (
                OcvCurve::monotone(0.0, vec![0.0, 1.0], vec![2.5, 4.2]),
                "OCV curve: expected a capacity above 0 Ah, met 0",
            ),
            (
                OcvCurve::monotone(4.2, vec![0.0], vec![2.5]),
                "OCV curve: expected at least 2 knots and as many voltages and slopes, met 1, 1 \
                and 1",
            ),
            (
                OcvCurve::monotone(4.2, vec![0.0, 0.0], vec![2.5, 4.2]),
                "OCV curve, knot 2 (counted from 1): expected rising SOC within 0 to 1, met 0",
            ),
            (
                OcvCurve::monotone(4.2, vec![0.0, 1.0], vec![4.2, 2.5]),
                "OCV curve, knot 2 (counted from 1): expected voltages that do not fall, in V, met \
                2.5",
            ),
        ];
        for (result, message) in cases {
            assert_eq!(result.unwrap_err().to_string(), message);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn rises_everywhere_and_its_slope_is_its_derivative(
            steps in prop::collection::vec((0.01..1.0f64, 0.0..1.0f64), 2..12),
            place in 0.001..0.999f64,
        ) {
            let total: f64 = steps.iter().map(|s| s.0).sum();
            let mut at = (0.0, 2.5);
            let mut knots = vec![at];
            for (dx, dy) in &steps {
                at = ((at.0 + dx / total).min(1.0), at.1 + dy);
                knots.push(at);
            }
            let (soc, ocv) = knots.into_iter().unzip();
            let c = OcvCurve::monotone(4.2, soc, ocv).unwrap();
            let h = 1e-6;
            let quotient = (c.voltage_v(place + h) - c.voltage_v(place - h)) / (2.0 * h);
            prop_assert!(
                quotient >= -1e-6
                    && (quotient - c.slope_v(place)).abs() < 1e-3 * (1.0 + quotient.abs()),
                "{} against {}",
                quotient,
                c.slope_v(place)
            );
            let u = c.voltage_v(place);
            let back = c.soc_at(u).unwrap();
            prop_assert!((c.voltage_v(back) - u).abs() < 1e-9);
        }
    }
}
