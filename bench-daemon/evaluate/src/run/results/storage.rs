//! Removes the charge storage of the cell before models are fitted: the slope of its open-circuit
//! voltage at the voltage at rest before each sweep.

use analysis::{fit::ErmFit, spectrum::Spectrum};

use crate::run::slope::{rest_voltages, slope_before};
use bench_core::record::Recorder;
use bench_plan::config::Experiment;

/// Returns the spectra without the share of the open-circuit voltage. If it is unknown, returns
/// them unchanged with a note.
pub(super) fn less_charge_storage(
    recorder: &mut Recorder,
    experiment: &Experiment,
    spectra: Vec<&Spectrum>,
) -> Vec<Spectrum> {
    let Some(curve) = &experiment.cell.ocv else {
        recorder.warning(
            "the cell's file has no [ocv]: charge storage is left in the impedance, \
        and the DC resistance is an apparent one",
        );
        return spectra.into_iter().cloned().collect();
    };
    // The spectra are those at the direct current of the first sweep.
    let index = recorder.index();
    let first = index.sweeps.iter().find(|sweep| sweep.fixture == "cell");
    let rests_v = rest_voltages(index, first.map_or(0.0, |sweep| sweep.bias_a));
    let mut outside = 0;
    let mut one =
        |(number, spectrum): (usize, &Spectrum)| match slope_before(curve, &rests_v, number) {
            Some(at) => spectrum.less_charge_storage(at.slope),
            None => {
                outside += 1;
                spectrum.clone()
            }
        };
    let left: Vec<Spectrum> = spectra.into_iter().enumerate().map(&mut one).collect();
    if outside > 0 {
        recorder.warning(&format!(
            "{outside} sweeps began at a voltage outside the curve of [ocv], or at an unknown one: \
            charge storage is left in all impedances, and the DC resistance \
             is an apparent one"
        ));
        return left.iter().map(Spectrum::with_charge_storage).collect();
    }
    left
}

/// Describes the apparent DC resistance; empty if charge storage was not removed.
pub(super) fn apparent(fit: &ErmFit) -> String {
    fit.charge_storage.map_or_else(String::new, |storage| {
        format!(
            " (apparent, with the slope of the open-circuit voltage left in: {:.4} mΩ)",
            1.0e3 * storage.apparent_dc_resistance_ohm
        )
    })
}
