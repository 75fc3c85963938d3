//! The sweeps of a run at one amplitude, and a comparison of several amplitudes.

use analysis::{
    spectrum::Spectrum,
    validity::{Noise, linearity},
};

use super::super::Measured;

/// Relative difference below which amplitudes count as equal.
const SAME_AMPLITUDE: f64 = 0.1;

/// Returns all sweeps of the cell, in their order.
pub(crate) fn every_sweep(measured: &Measured) -> impl Iterator<Item = &Spectrum> {
    std::iter::once(&measured.spectrum).chain(&measured.repeats)
}

/// Returns the indices of the sweeps of the cell at the amplitude of the first: at another
/// amplitude the cell may behave differently.
pub(super) fn alike(measured: &Measured) -> Vec<usize> {
    let amplitude_a = |spectrum: &Spectrum| {
        spectrum
            .points
            .first()
            .map_or(f64::NAN, |point| point.amplitude_a)
    };
    let first_a = amplitude_a(&measured.spectrum);
    let same = |place: usize, spectrum: &Spectrum| {
        place == 0 || (amplitude_a(spectrum) / first_a - 1.0).abs() < SAME_AMPLITUDE
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

/// Compares sweeps at several amplitudes, as text; returns `None` if there is one amplitude. Each
/// is judged by the noise of its own records.
pub(super) fn linearity_in_words(measured: &Measured) -> Option<(bool, String)> {
    let noises: Vec<Noise> = measured
        .own_noise
        .iter()
        .map(|spectrum| Noise::of(spectrum, &[]))
        .collect::<Result<_, _>>()
        .ok()?;
    let found = linearity(&measured.own_noise, &noises)?;
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
