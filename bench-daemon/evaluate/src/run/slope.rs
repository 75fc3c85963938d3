//! Slope of the open-circuit voltage of a run's cell at the voltage at rest before each sweep: by
//! it, the share of the open-circuit voltage is subtracted from an impedance before a fit.

use std::path::{Path, PathBuf};

use analysis::{
    dataset::{RunIndex, SweepEntry},
    ocv::{OcvCurve, REST_SIGMA_V, SLOPE_SHARE},
    run_folder::{self, INDEX, JOURNAL},
    spectrum::OcvSlope,
};

use super::recompute::Recorded;

/// Deepest folder of a spectrum in a run folder.
const DEPTH: usize = 2;

/// Slope at a voltage at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlopeAtRest {
    /// The voltage, V.
    pub rest_v: f64,
    /// The slope.
    pub slope: OcvSlope,
}

/// Slope of a spectrum in a run folder.
#[derive(Debug, Clone, PartialEq)]
pub struct RunSlope {
    /// The run folder.
    pub run: PathBuf,
    /// The slope before the sweep.
    pub at: SlopeAtRest,
}

/// Returns the voltages at rest before the sweeps of the cell under a direct current, V, in the
/// order of the index.
pub(crate) fn rest_voltages(index: &RunIndex, bias_a: f64) -> Vec<Option<f64>> {
    let of_cell = sweeps_of_cell(index, bias_a);
    of_cell.map(|sweep| sweep.start_ocv_v).collect()
}

fn sweeps_of_cell(index: &RunIndex, bias_a: f64) -> impl Iterator<Item = &SweepEntry> {
    let sweeps = index.sweeps.iter();
    sweeps.filter(move |sweep| sweep.fixture == "cell" && sweep.bias_a == bias_a)
}

/// Returns the slope before a sweep of the cell, by its place in `rests_v`. A sweep without a
/// voltage has the first one that is known.
pub(crate) fn slope_before(
    curve: &OcvCurve,
    rests_v: &[Option<f64>],
    place: usize,
) -> Option<SlopeAtRest> {
    let own_v = rests_v.get(place).copied().flatten();
    let rest_v = own_v.or_else(|| rests_v.iter().flatten().next().copied())?;
    let slope = curve.charge_slope(rest_v, REST_SIGMA_V, SLOPE_SHARE)?;
    Some(SlopeAtRest { rest_v, slope })
}

/// Returns the slope of a spectrum of a cell that lies in a run folder. `None` if it does not, or
/// if the cell of the run has no open-circuit voltage at the voltage before the sweep.
pub fn slope_of_spectrum(path: &Path) -> Option<RunSlope> {
    let path = std::path::absolute(path).ok()?;
    let is_run = |folder: &&Path| folder.join(JOURNAL).is_file() && folder.join(INDEX).is_file();
    let run = path.ancestors().skip(1).take(DEPTH).find(is_run)?;
    let file = path.strip_prefix(run).ok()?.with_extension("csv");
    let file = file.to_str()?;
    let index: RunIndex =
        serde_json::from_str(&std::fs::read_to_string(run.join(INDEX)).ok()?).ok()?;
    let is_it = |sweep: &&SweepEntry| {
        sweep.file == file || run_folder::shared_spectrum(&sweep.file) == file
    };
    let bias_a = index.sweeps.iter().find(is_it)?.bias_a;
    let place = sweeps_of_cell(&index, bias_a).position(|sweep| is_it(&sweep))?;
    let recorded = Recorded::read(run).ok()?;
    let at = slope_before(recorded.ocv()?, &rest_voltages(&index, bias_a), place)?;
    let run = run.to_owned();
    Some(RunSlope { run, at })
}
