//! The impedance along a charge or discharge: one table over frequency and charge, and a Nyquist plot.

use std::fmt::Write as _;

use analysis::{
    dataset::PointConditions,
    plot::{self, ImpedancePlot},
    report::Figure,
    run_folder::{OPERANDO, OPERANDO_COLUMNS, OPERANDO_FIGURE, PLOTS},
    spectrum::ImpedancePoint,
};

use crate::{
    files,
    run::{Measured, MultisineRun},
};
use bench_core::{record::Recorder, safety::failure::Failure};
use bench_plan::config::Experiment;

/// Most spectra in the plot: more hide each other.
const MOST_DRAWN: usize = 8;

/// Writes the table and the picture; returns the figure of the report, or nothing if no multisine ran
/// under a direct current.
///
/// # Errors
/// Fails if a file cannot be written or the picture cannot be drawn.
pub(super) fn write(
    recorder: &Recorder,
    experiment: &Experiment,
    measured: &Measured,
) -> Result<Option<Figure>, Failure> {
    let is_along = |run: &&MultisineRun| !run.conditions.is_empty();
    let runs: Vec<&MultisineRun> = measured.multisines.iter().filter(is_along).collect();
    if runs.is_empty() {
        return Ok(None);
    }
    let start_soc = start_soc(experiment, runs[0]);
    let capacity_coulomb = experiment.cell.capacity_coulomb.value();
    let soc = |charge_coulomb: f64| start_soc.map(|soc| soc + charge_coulomb / capacity_coulomb);
    recorder.text(OPERANDO, &table(&runs, soc))?;
    let picture = picture(&runs, soc);
    files::write_picture(&recorder.path(PLOTS), OPERANDO_FIGURE, |path| {
        plot::nyquist(&picture, path)
    })?;
    let svg = plot::nyquist_svg(&picture).map_err(|error| Failure::Analysis(error.to_string()))?;
    Ok(Some(Figure {
        svg,
        caption: format!(
            "The impedance along the {}, with 2σ: {} spectra, all of them in {OPERANDO}.",
            if runs[0].conditions[0].bias_a > 0.0 {
                "charge"
            } else {
                "discharge"
            },
            runs.len()
        ),
    }))
}

/// Returns the state of charge before the first multisine, from the voltage at rest and the curve of the
/// cell, or `None` without a curve.
fn start_soc(experiment: &Experiment, first: &MultisineRun) -> Option<f64> {
    experiment.cell.ocv.as_ref()?.soc_at(first.rest_v?)
}

fn table(runs: &[&MultisineRun], soc: impl Fn(f64) -> Option<f64>) -> String {
    let mut text = format!("{OPERANDO_COLUMNS}\n");
    for (number, run) in (1..).zip(runs) {
        for (point, at) in run.spectrum.points.iter().zip(&run.conditions) {
            row(&mut text, number, point, at, soc(at.charge_coulomb));
        }
    }
    text
}

fn row(
    text: &mut String,
    number: usize,
    point: &ImpedancePoint,
    at: &PointConditions,
    soc: Option<f64>,
) {
    let or_nothing = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    let covariance = point.covariance;
    let _ = writeln!(
        text,
        "{number},{},{},{},{},{},{:e},{:e},{:e},{:e},{:e}",
        at.charge_coulomb,
        or_nothing(soc),
        at.bias_measured_a,
        or_nothing(at.temperature_degc),
        point.freq_hz,
        point.z_ohm.re,
        point.z_ohm.im,
        covariance.re_re.sqrt(),
        covariance.im_im.sqrt(),
        covariance.re_im
    );
}

/// Returns evenly spread spectra of the first to the last.
fn picture(runs: &[&MultisineRun], soc: impl Fn(f64) -> Option<f64>) -> ImpedancePlot {
    let drawn = runs.len().min(MOST_DRAWN);
    let place = |k: usize| k * (runs.len() - 1) / (drawn - 1).max(1);
    let series = (0..drawn).map(|k| {
        let run = runs[place(k)];
        let charge_coulomb = run.conditions[0].charge_coulomb;
        let label = soc(charge_coulomb).map_or_else(
            || format!("{charge_coulomb:+.0} C"),
            |soc| format!("SOC {:.1} %", 100.0 * soc),
        );
        run.spectrum.series(k).labelled(Some(&label))
    });
    let bias_a = runs[0].conditions[0].bias_a;
    ImpedancePlot::new(
        &format!("Impedance along a direct current of {bias_a:+} A"),
        "axes equally scaled; 2σ",
        series.collect(),
    )
}
