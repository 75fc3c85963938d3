//! The OCV curve of a slow discharge (thesis 3.1): OCV = V + i·DCIR with i positive for discharge,
//! over the charge drawn.
//!
//! SOC is 1 at the first sample of the discharge and 0 where it ends or reaches the lower limit;
//! the charge between is the capacity. The compensation is that of the steady state: in the first
//! half minute after the load is switched on the curve is too high by the part that has not relaxed
//! yet. A charge at the same rate gives half the difference of both directions: hysteresis and any
//! polarisation that the DCIR leaves.

use super::polynomial::OcvPolynomial;
use super::spline::{Smoothed, smooth};
use super::{OcvCurve, OcvError};
use analysis_signal::series::{SeriesError, TimeSeries};
use serde::{Deserialize, Serialize};

/// Options of finding a curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OcvOptions {
    /// Resistance that the load's voltage drop is compensated with, Ω; the thesis takes the data
    /// sheet's 15 mΩ.
    pub dcir_ohm: f64,
    /// Lower and upper voltage limit of the cell, V.
    pub limits_v: (f64, f64),
    /// Intervals of the spline over SOC.
    pub intervals: usize,
    /// Order of an additional polynomial, if requested.
    pub polynomial: Option<usize>,
    /// Uses the mean of both directions instead of the discharge, if there is a charge: a curve for
    /// a cell with hysteresis.
    pub mean: bool,
}

impl Default for OcvOptions {
    /// Returns the thesis' 15 mΩ and 2.5–4.2 V.
    fn default() -> Self {
        Self {
            dcir_ohm: 0.015,
            limits_v: (2.5, 4.2),
            intervals: 200,
            polynomial: None,
            mean: false,
        }
    }
}

/// A curve and its properties.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OcvExtraction {
    /// The monotone smoothing spline.
    pub curve: OcvCurve,
    /// Charge between the ends of the discharge, Ah.
    pub capacity_ah: f64,
    /// Mean current of the discharge, weighted by charge, A.
    pub current_a: f64,
    /// Resistance used for the compensation, Ω.
    pub dcir_ohm: f64,
    /// Lowest and highest voltage of the discharge under load, V.
    pub span_v: (f64, f64),
    /// Scatter of the samples about the spline, V (standard deviation).
    pub noise_v: f64,
    /// Standard uncertainty of the spline by that scatter, V; the error of the DCIR times the
    /// current comes on top.
    pub sigma_v: f64,
    /// Free parameters that the smoothing leaves.
    pub effective_parameters: f64,
    /// The polynomial, if requested.
    pub polynomial: Option<OcvPolynomial>,
    /// Result of the charge, if one was given.
    pub charge: Option<Hysteresis>,
    /// Warnings to the user, in sentences.
    pub warnings: Vec<String>,
}

/// Half the difference between both directions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hysteresis {
    /// SOC range in which both are known.
    pub soc: (f64, f64),
    /// Mean magnitude of the charging current, A.
    pub current_a: f64,
    /// Median of (charge − discharge)/2, V.
    pub median_v: f64,
    /// Largest of it, V.
    pub max_v: f64,
    /// SOC of the maximum.
    pub max_at_soc: f64,
}

/// Reason for a missing curve.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ExtractError {
    /// No discharge in the data.
    #[error("{name}: expected a {direction} of at least {expected} samples, met {met}")]
    TooShort {
        /// Name of the series.
        name: String,
        /// `discharge` or `charge`.
        direction: &'static str,
        /// Samples needed.
        expected: usize,
        /// Samples met.
        met: usize,
    },
    /// An option that cannot be.
    #[error("{option}: expected {expected}, met {met}")]
    Option {
        /// Which.
        option: &'static str,
        /// Allowed values, as text.
        expected: String,
        /// Value found.
        met: String,
    },
    /// The series is invalid.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// The curve is invalid.
    #[error(transparent)]
    Curve(#[from] OcvError),
}

/// One direction: SOC and compensated voltage of every sample.
struct Branch {
    points: Vec<(f64, f64)>,
    capacity_ah: f64,
    current_a: f64,
    span_v: (f64, f64),
    spread_a: f64,
}

/// Finds the curve of a discharge, and the additional results of a charge.
///
/// # Errors
/// [`ExtractError`] for invalid options, a series without a discharge, or a charge without
/// charging.
pub fn extract(
    discharge: &TimeSeries,
    charge: Option<&TimeSeries>,
    options: &OcvOptions,
) -> Result<OcvExtraction, ExtractError> {
    check(options)?;
    let down = branch(discharge, 1.0, options)?;
    let short = || ExtractError::TooShort {
        name: discharge.name.clone(),
        direction: "discharge",
        expected: 8,
        met: down.points.len(),
    };
    let spline = smooth(&down.points, options.intervals).ok_or_else(short)?;
    let mut curve = to_curve(&spline, down.capacity_ah)?;
    let mut hysteresis = None;
    if let Some(series) = charge {
        let up = Up::new(series, &curve, options)?;
        hysteresis = Some(up.half_difference(&curve));
        if options.mean {
            curve = up.mean(&curve)?;
        }
    }
    let polynomial = options
        .polynomial
        .and_then(|order| OcvPolynomial::through(&curve, order));
    let mut warnings = warnings(&down, options);
    warnings.extend(
        polynomial
            .iter()
            .filter(|p| !p.falling_soc.is_empty())
            .map(OcvPolynomial::statement),
    );
    if let Some(h) = hysteresis
        .as_ref()
        .filter(|h| h.current_a * 3.0 > curve.capacity_ah)
    {
        warnings.push(format!(
            "the charge ran at {:.1} A: half the difference is mostly polarisation, not hysteresis",
            h.current_a
        ));
    }
    Ok(OcvExtraction {
        capacity_ah: down.capacity_ah,
        current_a: down.current_a,
        dcir_ohm: options.dcir_ohm,
        span_v: down.span_v,
        noise_v: spline.noise,
        sigma_v: spline.sigma,
        effective_parameters: spline.effective_parameters,
        curve,
        polynomial,
        charge: hysteresis,
        warnings,
    })
}

/// SOC, voltage under load and compensated voltage of every sample of the discharge, for pictures.
///
/// # Errors
/// As [`extract`].
pub fn compensated(
    discharge: &TimeSeries,
    options: &OcvOptions,
) -> Result<Vec<(f64, f64)>, ExtractError> {
    check(options)?;
    Ok(branch(discharge, 1.0, options)?.points)
}

fn check(options: &OcvOptions) -> Result<(), ExtractError> {
    let fail = |option, expected: String, met: String| {
        Err(ExtractError::Option {
            option,
            expected,
            met,
        })
    };
    if !(0.0..10.0).contains(&options.dcir_ohm) {
        return fail(
            "DCIR",
            "0 Ω or more, below 10 Ω".to_owned(),
            format!("{} Ω", options.dcir_ohm),
        );
    }
    let (low, high) = options.limits_v;
    if !(low.is_finite() && high.is_finite() && low < high) {
        return fail(
            "voltage limits",
            "the lower below the upper, in V".to_owned(),
            format!("{low} and {high} V"),
        );
    }
    if !(4..=2000).contains(&options.intervals) {
        return fail(
            "intervals of the spline",
            "4 to 2000".to_owned(),
            options.intervals.to_string(),
        );
    }
    match options.polynomial {
        Some(order) if !(1..=super::polynomial::MAX_ORDER).contains(&order) => fail(
            "order of the polynomial",
            format!("1 to {}", super::polynomial::MAX_ORDER),
            order.to_string(),
        ),
        _ => Ok(()),
    }
}

/// Returns the longest stretch in a direction, cut where it leaves the limits.
fn branch(
    series: &TimeSeries,
    direction: f64,
    options: &OcvOptions,
) -> Result<Branch, ExtractError> {
    const LEAST: usize = 100;
    series.validate()?;
    let stretch = series.longest_stretch(direction);
    let (low, _) = options.limits_v;
    let below = |k: &usize| direction > 0.0 && series.voltage_v[*k] < low;
    let end = stretch.clone().find(below).unwrap_or(stretch.end);
    let range = stretch.start..end;
    if range.len() < LEAST {
        let direction = if direction > 0.0 {
            "discharge"
        } else {
            "charge"
        };
        return Err(ExtractError::TooShort {
            name: series.name.clone(),
            direction,
            expected: LEAST,
            met: range.len(),
        });
    }
    let charge = series.charge_coulomb();
    let total = (charge[range.end - 1] - charge[range.start]).abs();
    // Every sample counts by the charge since the one before: a tail of small current has many
    // samples and little charge.
    let moved = |k: usize| (charge[k] - charge[k - 1]).abs() / total;
    let current = || (range.start + 1..range.end).map(|k| (series.current_a[k].abs(), moved(k)));
    let current_a = current().map(|(i, share)| share * i).sum::<f64>();
    let spread_a = current()
        .map(|(i, share)| share * (i - current_a).powi(2))
        .sum::<f64>()
        .sqrt();
    let volts = || range.clone().map(|k| series.voltage_v[k]);
    let soc = |k: usize| {
        if direction > 0.0 {
            1.0 - (charge[k] - charge[range.start]) / total
        } else {
            (charge[range.start] - charge[k]) / total
        }
    };
    Ok(Branch {
        points: range
            .clone()
            .map(|k| {
                (
                    soc(k),
                    series.voltage_v[k] + series.current_a[k] * options.dcir_ohm,
                )
            })
            .collect(),
        capacity_ah: total / 3600.0,
        current_a,
        span_v: (
            volts().fold(f64::INFINITY, f64::min),
            volts().fold(f64::NEG_INFINITY, f64::max),
        ),
        spread_a,
    })
}

fn to_curve(spline: &Smoothed, capacity_ah: f64) -> Result<OcvCurve, OcvError> {
    let curve = OcvCurve {
        capacity_ah,
        soc: spline.x.clone(),
        ocv_v: spline.value.clone(),
        slope_v: spline.slope.clone(),
    };
    curve.validate()?;
    Ok(curve)
}

/// The charge, laid onto the discharge at the full end.
struct Up {
    curve: OcvCurve,
    current_a: f64,
    /// Its charge over that of the discharge.
    share: f64,
}

impl Up {
    fn new(
        series: &TimeSeries,
        down: &OcvCurve,
        options: &OcvOptions,
    ) -> Result<Self, ExtractError> {
        let up = branch(series, -1.0, options)?;
        let short = || ExtractError::TooShort {
            name: series.name.clone(),
            direction: "charge",
            expected: 8,
            met: up.points.len(),
        };
        let curve = to_curve(
            &smooth(&up.points, options.intervals).ok_or_else(short)?,
            up.capacity_ah,
        )?;
        Ok(Self {
            curve,
            current_a: up.current_a,
            share: up.capacity_ah / down.capacity_ah,
        })
    }

    fn half_difference_v(&self, down: &OcvCurve, soc: f64) -> f64 {
        0.5 * (self.curve.voltage_v(1.0 - (1.0 - soc) / self.share) - down.voltage_v(soc))
    }

    fn half_difference(&self, down: &OcvCurve) -> Hysteresis {
        const GRID: u32 = 400;
        let low = (1.0 - self.share).max(0.0);
        let mut halves: Vec<(f64, f64)> = (0..=GRID)
            .map(|k| low + (1.0 - low) * f64::from(k) / f64::from(GRID))
            .map(|z| (self.half_difference_v(down, z), z))
            .collect();
        let max = halves
            .iter()
            .copied()
            .max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
            .unwrap_or((0.0, low));
        halves.sort_by(|a, b| a.0.total_cmp(&b.0));
        let median_v = halves[halves.len() / 2].0;
        Hysteresis {
            soc: (low, 1.0),
            current_a: self.current_a,
            median_v,
            max_v: max.0,
            max_at_soc: max.1,
        }
    }

    fn mean(&self, down: &OcvCurve) -> Result<OcvCurve, OcvError> {
        let mut highest_v = f64::NEG_INFINITY;
        let middle_v = |z: &f64| {
            highest_v = highest_v.max(down.voltage_v(*z) + self.half_difference_v(down, *z));
            highest_v
        };
        let ocv_v = down.soc.iter().map(middle_v).collect();
        OcvCurve::monotone(down.capacity_ah, down.soc.clone(), ocv_v)
    }
}

fn warnings(down: &Branch, options: &OcvOptions) -> Vec<String> {
    let mut found = Vec::new();
    let (low, high) = options.limits_v;
    if down.span_v.0 > low + 0.02 {
        found.push(format!(
            "the discharge ended at {:.3} V and not at the lower limit of {low} V: the capacity is \
            that down to there, and SOC 0 is there",
            down.span_v.0
        ));
    }
    if down.span_v.1 + down.current_a * options.dcir_ohm < high - 0.02 {
        found.push(format!(
            "the discharge began at {:.3} V, below the upper limit of {high} V: SOC 1 is there",
            down.span_v.1
        ));
    }
    if down.spread_a > 0.05 * down.current_a {
        found.push(format!(
            "the current scatters by {:.0} %: the compensation holds for a steady load",
            100.0 * down.spread_a / down.current_a
        ));
    }
    if down.current_a > 0.5 * down.capacity_ah {
        found.push(format!(
            "{:.1} A is {:.2} C: not slow, the curve holds the polarisation of the load",
            down.current_a,
            down.current_a / down.capacity_ah
        ));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_numeric::Rng;

    fn truth(z: f64) -> f64 {
        3.1 + 0.9 * z + 0.15 * z.powi(6) + 0.02 * (12.0 * z).sin() - 0.4 * (-z / 0.04).exp()
    }

    /// Returns a cell of 2 Ah with 20 mΩ and 10 mV of hysteresis to each side, driven at
    /// `current_a` (discharge positive), noise of 0.4 mV.
    fn slow(current_a: f64, seed: u64) -> TimeSeries {
        let mut rng = Rng::new(seed);
        let n = 7200;
        let time_s: Vec<f64> = (0..=n).map(f64::from).collect();
        let soc = |t: &f64| {
            if current_a > 0.0 {
                1.0 - t / 7200.0
            } else {
                t / 7200.0
            }
        };
        let mut noise = || (0..12).map(|_| rng.uniform()).sum::<f64>() - 6.0;
        let voltage_v = time_s
            .iter()
            .map(|t| truth(soc(t)) - 0.02 * current_a - 0.01 * current_a.signum() + 4e-4 * noise())
            .collect();
        TimeSeries {
            name: "slow".to_owned(),
            current_a: vec![current_a; time_s.len()],
            time_s,
            voltage_v,
            temperature_degc: None,
        }
    }

    #[test]
    fn finds_curve_capacity_and_half_difference() {
        let options = OcvOptions {
            dcir_ohm: 0.02,
            polynomial: Some(9),
            ..OcvOptions::default()
        };
        let found = extract(&slow(1.0, 1), Some(&slow(-1.0, 2)), &options).unwrap();
        assert!(
            (found.capacity_ah - 2.0).abs() < 1e-9,
            "{}",
            found.capacity_ah
        );
        assert!(
            (found.noise_v / 4e-4 - 1.0).abs() < 0.05,
            "{}",
            found.noise_v
        );
        for k in 0..=100 {
            let z = f64::from(k) / 100.0;
            let (u, m) = found.curve.at(z);
            // At its ends a spline has points on one side only.
            let allowed = if (3..=97).contains(&k) { 2e-4 } else { 1.5e-3 };
            assert!((u - truth(z) + 0.01).abs() < allowed, "OCV at {z}: {u}");
            let slope = (truth(z + 1e-4) - truth(z - 1e-4)) / 2e-4;
            assert!(
                (m - slope).abs() < 0.05 * slope + 0.02 || !(3..=97).contains(&k),
                "slope at {z}: {m} against {slope}"
            );
        }
        assert!(found.curve.slope_v.iter().all(|m| *m >= 0.0));
        let mean = extract(
            &slow(1.0, 1),
            Some(&slow(-1.0, 2)),
            &OcvOptions {
                mean: true,
                ..options
            },
        )
        .unwrap()
        .curve;
        assert!(
            (5..=95).all(
                |k| (mean.voltage_v(f64::from(k) / 100.0) - truth(f64::from(k) / 100.0)).abs()
                    < 2e-4
            ),
            "{mean:?}"
        );
        let h = found.charge.unwrap();
        assert!(
            (h.median_v - 0.01).abs() < 2e-4 && (h.max_v - 0.01).abs() < 1e-3,
            "{h:?}"
        );
        assert!(found.polynomial.unwrap().rms_v < 0.02);
    }

    #[test]
    fn cuts_at_the_limit_and_says_where_it_did_not_get_there() {
        let series = slow(1.0, 3);
        let limit = OcvOptions {
            dcir_ohm: 0.02,
            limits_v: (3.2, 4.2),
            ..OcvOptions::default()
        };
        let cut = extract(&series, None, &limit).unwrap();
        let crossing = (0..7200)
            .map(|k| f64::from(k) / 7200.0)
            .find(|z| truth(*z) - 0.03 >= 3.2)
            .unwrap();
        assert!(
            (cut.capacity_ah - 2.0 * (1.0 - crossing)).abs() < 0.002,
            "{}",
            cut.capacity_ah
        );
        assert!(
            !cut.warnings.iter().any(|w| w.contains("ended at")),
            "{:?}",
            cut.warnings
        );
        let whole = extract(&series, None, &OcvOptions::default()).unwrap();
        assert!(
            whole
                .warnings
                .iter()
                .any(|w| w.starts_with("the discharge ended at 2.6")
                    && w.contains("lower limit of 2.5 V")),
            "{:?}",
            whole.warnings
        );
    }

    #[test]
    fn refuses_what_gives_no_curve() {
        let bad = |options: OcvOptions, text: &str| {
            assert_eq!(
                extract(&slow(1.0, 1), None, &options)
                    .unwrap_err()
                    .to_string(),
                text
            );
        };
        bad(
            OcvOptions {
                dcir_ohm: -1.0,
                ..OcvOptions::default()
            },
            "DCIR: expected 0 Ω or more, below 10 Ω, met -1 Ω",
        );
        bad(
            OcvOptions {
                polynomial: Some(40),
                ..OcvOptions::default()
            },
            "order of the polynomial: expected 1 to 15, met 40",
        );
        bad(
            OcvOptions {
                limits_v: (4.2, 2.5),
                ..OcvOptions::default()
            },
            "voltage limits: expected the lower below the upper, in V, met 4.2 and 2.5 V",
        );
        let error = extract(&slow(-1.0, 1), None, &OcvOptions::default())
            .unwrap_err()
            .to_string();
        assert_eq!(
            error,
            "slow: expected a discharge of at least 100 samples, met 0"
        );
    }
}
