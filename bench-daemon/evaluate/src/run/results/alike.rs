//! The sweeps of a run at one amplitude and one direct current, and a comparison of several
//! amplitudes.

use super::super::Measured;
use analysis::{
    spectrum::Spectrum,
    validity::{Noise, linearity},
};

/// Relative difference below which amplitudes count as equal.
const SAME_AMPLITUDE: f64 = 0.1;

/// Returns all sweeps of the cell, in their order.
pub(crate) fn every_sweep(measured: &Measured) -> impl Iterator<Item = &Spectrum> {
    std::iter::once(&measured.spectrum).chain(&measured.repeats)
}

/// Returns the indices of the sweeps of the cell at the amplitude and the direct current of the
/// first: at others the cell may behave differently. The first sweep is at rest if any is.
pub(super) fn alike(measured: &Measured) -> Vec<usize> {
    let amplitude_a = |spectrum: &Spectrum| {
        spectrum
            .points
            .first()
            .map_or(f64::NAN, |point| point.amplitude_a)
    };
    let first_a = amplitude_a(&measured.spectrum);
    let same = |place: usize, spectrum: &Spectrum| {
        let amplitude = (amplitude_a(spectrum) / first_a - 1.0).abs() < SAME_AMPLITUDE;
        place == 0 || (amplitude && measured.bias_a(place) == measured.bias_a(0))
    };
    every_sweep(measured)
        .enumerate()
        .filter(|(place, spectrum)| same(*place, spectrum))
        .map(|(place, _)| place)
        .collect()
}

/// Returns the sweeps at these indices.
pub(super) fn alike_sweeps(measured: &Measured) -> Vec<&Spectrum> {
    let chosen = alike(measured);
    every_sweep(measured)
        .enumerate()
        .filter(|(place, _)| chosen.contains(place))
        .map(|(_, spectrum)| spectrum)
        .collect()
}

/// Compares sweeps at several amplitudes and the direct current of the first, as text; returns
/// `None` if there is one amplitude. Each is judged by the noise of its own records.
pub(super) fn linearity_in_words(measured: &Measured) -> Option<(bool, String)> {
    let same = |(place, _): &(usize, &Spectrum)| measured.bias_a(*place) == measured.bias_a(0);
    let own_noise: Vec<Spectrum> = measured
        .own_noise
        .iter()
        .enumerate()
        .filter(same)
        .map(|(_, spectrum)| spectrum.clone())
        .collect();
    let noises: Vec<Noise> = own_noise
        .iter()
        .map(|spectrum| Noise::of(spectrum, &[]))
        .collect::<Result<_, _>>()
        .ok()?;
    let found = linearity(&own_noise, &noises)?;
    let (least_a, greatest_a) = found.amplitudes_a;
    let worst = found
        .points
        .iter()
        .filter(|point| point.nonlinear)
        .max_by(|a, b| a.change_percent.total_cmp(&b.change_percent));
    let text = match worst {
        None => format!(
            "The impedance is the same at {least_a:.3} A and {greatest_a:.3} A within its \
            uncertainty: the cell answers in proportion."
        ),
        Some(worst) => format!(
            "The impedance changes from {least_a:.3} A to {greatest_a:.3} A beyond its \
            uncertainty, by {:.2} % at {:.4} Hz at most: the cell does not \
             answer in proportion.",
            worst.change_percent, worst.freq_hz
        ),
    };
    Some((worst.is_none(), text))
}

#[cfg(test)]
mod tests {
    use instruments::units::{Hertz, Seconds};
    use std::path::Path;

    use analysis::{
        dataset::PointConditions,
        spectrum::{ChannelPhasors, ImpedancePoint, PhasorVariance},
    };
    use instruments::fixture::Fixture;
    use num_complex::Complex64;

    use super::*;
    use crate::run::run_accumulator::RunAccumulator;
    use bench_plan::{
        config::load_experiment,
        measure::{HarmonicsAndDrift, Spent, SweepPoint, quality::Measures},
    };

    fn point(bias_a: f64) -> SweepPoint {
        let conditions = PointConditions {
            bias_a,
            bias_measured_a: bias_a,
            sigma_bias_a: 0.01,
            charge_coulomb: 1.0,
            temperature_degc: None,
        };
        SweepPoint {
            fixture: Fixture::Cell,
            index: 0,
            phasors: ChannelPhasors {
                freq_hz: 1.0,
                volts: [Complex64::ONE; 4],
                variance: [PhasorVariance::circular(1.0e-12); 4],
            },
            volts_per_div: [1.0; 4],
            free_freq_hz: Hertz(1.0),
            residual_lag1: 0.0,
            harmonics_and_drift: HarmonicsAndDrift::default(),
            warnings: Vec::new(),
            time_s: Seconds(0.0),
            captures: 1,
            rechecked: 0,
            spent: Spent::default(),
            measures: Measures::default(),
            failing: Vec::new(),
            conditions: (bias_a != 0.0).then_some(conditions),
        }
    }

    #[test]
    fn sweeps_under_another_direct_current_are_not_alike_and_are_named() {
        let file =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/demo.toml");
        let experiment = load_experiment(&file, None).unwrap();
        let of = |biases_a: &[f64]| {
            let mut measured = RunAccumulator::new(&experiment, None).measured;
            let impedance = ImpedancePoint {
                freq_hz: 1.0,
                z_ohm: Complex64::ONE,
                covariance: analysis::numeric::Covariance2::UNKNOWN,
                amplitude_a: 1.0,
            };
            let spectrum = || Spectrum::new("s".to_owned(), vec![impedance]);
            measured.spectrum = spectrum();
            measured.repeats = biases_a.iter().skip(1).map(|_| spectrum()).collect();
            measured.points = biases_a.iter().map(|bias_a| vec![point(*bias_a)]).collect();
            (alike(&measured), measured.names())
        };
        let (chosen, names) = of(&[0.0, 2.0, -2.0, -2.0, 2.0, 0.0]);
        assert_eq!(chosen, [0, 5]);
        assert_eq!(
            names,
            [
                "sweep 1",
                "sweep 2, +2 A",
                "sweep 3, -2 A",
                "sweep 4, -2 A",
                "sweep 5, +2 A",
                "sweep 6"
            ]
        );
        let (chosen, names) = of(&[2.0]);
        assert_eq!((chosen, names), (vec![0], vec!["sweep 1, +2 A".to_owned()]));
    }
}
