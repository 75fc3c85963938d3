//! Whether a record shows that its sinusoids change.

use super::SineFit;

/// Probability of a change by chance below which the record shows it. A record that does not change
/// keeps the simpler fit.
const CHANCE: f64 = 1e-6;
/// Least change over the record, as a share of the amplitude. A smaller one moves the phasor of the
/// middle by less than a ten-thousandth.
const LEAST: f64 = 1e-3;

/// Returns true if the fit with a change explains the record better than chance, and the change is not
/// negligible in every channel.
///
/// The likelihood ratio counts the samples of each channel by the colour of what the change leaves.
pub(super) fn is_shown(constant: &SineFit, changing: &SineFit) -> bool {
    let length_s = changing.interval_s * changing.samples as f64;
    let is_large = changing
        .channels
        .iter()
        .any(|channel| channel.phasor_slope.norm() * length_s > LEAST * channel.phasor.norm());
    if !(changing.varying && is_large) {
        return false;
    }
    let gain = |(before, after): (&super::ChannelFit, &super::ChannelFit)| {
        let ratio = before.residual_rms_v / after.residual_rms_v;
        let samples = after.samples_used as f64 / after.colour_factor;
        // A channel without any noise cannot be judged.
        if ratio.is_finite() {
            2.0 * samples * ratio.max(1.0).ln()
        } else {
            0.0
        }
    };
    let gains = constant.channels.iter().zip(&changing.channels).map(gain);
    chi2_tail(gains.sum(), changing.channels.len()) < CHANCE
}

/// P(χ² ≥ x) for twice `pairs` degrees of freedom.
fn chi2_tail(x: f64, pairs: usize) -> f64 {
    let half = 0.5 * x;
    let (mut term, mut sum) = (1.0, 1.0);
    for k in 1..pairs {
        term *= half / k as f64;
        sum += term;
    }
    if half > 700.0 {
        0.0
    } else {
        (-half).exp() * sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tail_is_that_of_the_tables() {
        for (x, pairs, expected) in [(5.991, 1, 0.05), (15.507, 4, 0.05), (26.124, 4, 0.001)] {
            assert!(
                (chi2_tail(x, pairs) / expected - 1.0).abs() < 1e-3,
                "{x} {pairs}"
            );
        }
        assert!(chi2_tail(1e6, 4).abs() < 1e-300);
    }
}
