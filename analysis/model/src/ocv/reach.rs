//! A curve carried on to the cell's voltage limits at rest. A measured discharge begins and ends
//! under load, a few millivolts of rest away from the limits; along its end slopes the curve is
//! carried on to them, so that SOC 0 and 1 are states of the cell and not of the load.

use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

use super::OcvCurve;

/// Largest extension of a curve at one end, as a fraction of its capacity. Farther out, its end
/// slope does not predict the curve.
const MOST: f64 = 0.02;

/// Extension of a curve beyond the data, as shares of the capacity that was measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reach {
    /// Below its empty end.
    pub below: f64,
    /// Above its full end.
    pub above: f64,
}

impl Reach {
    /// Returns the state of charge between the limits that a measured one is.
    pub fn soc(&self, measured: f64) -> f64 {
        (measured + self.below) / (1.0 + self.below + self.above)
    }
}

impl OcvCurve {
    /// Returns the same curve between the voltage limits. An end that is too far from its limit, or
    /// beyond it, does not move.
    #[must_use]
    pub fn reaching(&self, limits_v: RangeInclusive<f64>) -> (Self, Reach) {
        let (low_v, high_v) = limits_v.into_inner();
        let (low, high) = (self.at(0.0), self.at(1.0));
        let share = |missing_v: f64, slope_v: f64| {
            Some(missing_v / slope_v)
                .filter(|share| (0.0..=MOST).contains(share))
                .unwrap_or(0.0)
        };
        let reach = Reach {
            below: share(low.0 - low_v, low.1),
            above: share(high_v - high.0, high.1),
        };
        let stretch = 1.0 + reach.below + reach.above;
        let mut curve = Self {
            capacity_ah: self.capacity_ah * stretch,
            soc: self.soc.iter().map(|soc| reach.soc(*soc)).collect(),
            ocv_v: self.ocv_v.clone(),
            slope_v: self.slope_v.iter().map(|slope| slope * stretch).collect(),
        };
        if reach.below > 0.0 {
            curve.soc.insert(0, 0.0);
            curve.ocv_v.insert(0, low_v);
            curve.slope_v.insert(0, low.1 * stretch);
        }
        if reach.above > 0.0 {
            curve.soc.push(1.0);
            curve.ocv_v.push(high_v);
            curve.slope_v.push(high.1 * stretch);
        }
        (curve, reach)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_carried_on_to_near_limits_and_not_to_far_ones() {
        let line = OcvCurve::monotone(4.0, vec![0.0, 0.5, 1.0], vec![3.0, 3.5, 4.0]).unwrap();
        let (whole, reach) = line.reaching(2.99..=4.02);
        assert!(
            (reach.below - 0.01).abs() < 1e-12 && (reach.above - 0.02).abs() < 1e-12,
            "{reach:?}"
        );
        whole.validate().unwrap();
        assert!((whole.capacity_ah - 4.12).abs() < 1e-12);
        for soc in [0.0, 0.3, 0.77, 1.0] {
            assert!(
                (whole.voltage_v(soc) - (2.99 + 1.03 * soc)).abs() < 1e-12
                    && (whole.slope_v(soc) - 1.03).abs() < 1e-12
            );
        }
        let (same, none) = line.reaching(2.5..=3.9);
        assert_eq!(
            (same, none),
            (
                line,
                Reach {
                    below: 0.0,
                    above: 0.0
                }
            )
        );
    }
}
