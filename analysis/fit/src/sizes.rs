//! Sizes of the impedances of a spectrum that one wrong row does not decide: an overload or a slip
//! of the decimal point must set neither the weights nor the bounds of a fit.

use analysis_signal::spectrum::ImpedancePoint;

/// Factor by which |Z| may differ from the median of the points about it. Between neighbours |Z| of
/// resistances, capacitances and inductances changes no faster than the frequency, so that even one
/// point per decade stays below it.
const FAR: f64 = 20.0;
/// Points on either side that make the median.
const ABOUT: usize = 2;

/// |Z| of each point, Ω; of a point that is far from those about it, their median.
pub(crate) fn sizes_ohm(points: &[ImpedancePoint]) -> Vec<f64> {
    let own: Vec<f64> = points.iter().map(|p| p.z_ohm.norm()).collect();
    let size = |k: usize| {
        let mut about = own[k.saturating_sub(ABOUT)..(k + ABOUT + 1).min(own.len())].to_vec();
        about.sort_by(f64::total_cmp);
        let median = about[about.len() / 2];
        if (median / FAR..=median * FAR).contains(&own[k]) {
            own[k]
        } else {
            median
        }
    };
    (0..own.len()).map(size).collect()
}

/// The same, but a point that is larger than those about it keeps its size: by its own size its
/// residual weighs no more than those of the others together.
pub(crate) fn weight_sizes_ohm(points: &[ImpedancePoint]) -> Vec<f64> {
    let of = |(p, size): (&ImpedancePoint, f64)| p.z_ohm.norm().max(size);
    points.iter().zip(sizes_ohm(points)).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_numeric::Covariance2;

    fn points(sizes: &[f64]) -> Vec<ImpedancePoint> {
        let point = |(k, size): (usize, &f64)| ImpedancePoint {
            freq_hz: 10f64.powi(k as i32),
            z_ohm: (*size).into(),
            covariance: Covariance2::UNKNOWN,
            amplitude_a: f64::NAN,
        };
        sizes.iter().enumerate().map(point).collect()
    }

    #[test]
    fn a_far_point_takes_the_median_about_it_and_a_steep_band_stays() {
        let steep = [1e3, 1e2, 1e1, 1.0, 1.0];
        assert_eq!(sizes_ohm(&points(&steep)), steep);
        let spoilt = [2.0, 3.0, 9.9e37, 4.0, 1e-6, 6.0];
        assert_eq!(sizes_ohm(&points(&spoilt)), [2.0, 3.0, 3.0, 4.0, 6.0, 6.0]);
        assert_eq!(
            weight_sizes_ohm(&points(&spoilt)),
            [2.0, 3.0, 9.9e37, 4.0, 6.0, 6.0]
        );
    }
}
