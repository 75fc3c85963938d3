//! The extended Randles model's answer to steps of current, in closed form, with its derivatives.
//!
//! A step of 1 A at time zero costs S(t) = R + Σₖ Rₖ(1 − exp(−t/τₖ)), τₖ = RₖCₖ; a current made of
//! steps costs the sum.

use analysis_model::model::Erm;

/// Voltage lost t seconds after a step of 1 A, V/A: R + Σ Rₖ(1 − exp(−t/τₖ)); 0 before the step.
pub fn step_resistance_ohm(erm: &Erm, time_s: f64) -> f64 {
    if time_s < 0.0 {
        return 0.0;
    }
    erm.branches.iter().fold(erm.r_ohm, |s, b| {
        s - b.r_ohm * (-time_s / b.time_constant_s()).exp_m1()
    })
}

/// Its standard uncertainty, Ω, by the covariance of the logarithmic parameters; none where an
/// entry is unknown.
pub fn step_resistance_sigma_ohm(
    erm: &Erm,
    log_covariance: &[Vec<f64>],
    time_s: f64,
) -> Option<f64> {
    let mut slopes = vec![0.0; erm.parameter_count()];
    add_step(erm, time_s, 1.0, &mut slopes);
    let mut variance = 0.0;
    for (i, a) in slopes.iter().enumerate() {
        for (j, b) in slopes.iter().enumerate() {
            variance += a * b * log_covariance.get(i)?.get(j)?;
        }
    }
    Some(variance.max(0.0).sqrt())
}

/// Adds weight·S(t) to a sum's derivatives with respect to ln R, ln R₁, ln C₁, …; returns
/// weight·S(t) and weight·dS/dt.
pub(super) fn add_step(erm: &Erm, time_s: f64, weight: f64, slopes: &mut [f64]) -> (f64, f64) {
    if time_s < 0.0 {
        return (0.0, 0.0);
    }
    let mut value = erm.r_ohm;
    let mut rate = 0.0;
    slopes[0] += weight * erm.r_ohm;
    for (k, b) in erm.branches.iter().enumerate() {
        let ratio = time_s / b.time_constant_s();
        let decay = (-ratio).exp();
        let risen = -b.r_ohm * (-ratio).exp_m1();
        let moved = b.r_ohm * ratio * decay;
        value += risen;
        rate += b.r_ohm / b.time_constant_s() * decay;
        slopes[2 * k + 1] += weight * (risen - moved);
        slopes[2 * k + 2] -= weight * moved;
    }
    (weight * value, weight * rate)
}
