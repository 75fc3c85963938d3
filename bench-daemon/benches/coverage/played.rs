//! Experiments that are run on the simulated bench.

use std::error::Error;
use std::path::{Path, PathBuf};

use analysis::{
    fit::{ErmFit, ModelFile},
    model::Erm,
    spectrum::{ImpedancePoint, Spectrum},
};
use bench_daemon::command::run::run_experiment;
use bench_evaluate::run::Finished;
use bench_plan::config::load_experiment;
use fixtures::Scenario;
use instruments::fixture::Fixture;
use num_complex::Complex64;
use rayon::prelude::*;

use super::{synthetic::Normal, tally::Tally};

/// Number of branches of the simulated cell: other orders have no true values.
const TRUE_RC: usize = 4;

/// Delay of a channel relative to the first, one standard deviation: the prior uncertainty of a
/// correction.
const SKEW_SPREAD_S: f64 = 1e-6;
/// Gains and pick-ups, one standard deviation: below the tolerance of a correction, because the
/// fixture check refuses benches with larger errors.
const GAIN_SPREAD: f64 = 0.002;
const PICKUP_SPREAD_H: f64 = 0.08e-6;
/// Relative difference of the slope of the open-circuit voltage from that of the curve: the
/// uncertainty that a run assumes.
const SLOPE_SPREAD: f64 = 0.03;
const CAPACITY_AH: f64 = 4.5;

/// An experiment to run.
pub(crate) struct Played<'a> {
    /// The folder of the shipped configurations.
    pub(crate) configs: &'a Path,
    /// Name of the experiment in it.
    pub(crate) name: &'a str,
    /// Whether each seed has its own harness (except for `accurate`) and its own slope of the
    /// open-circuit voltage, drawn from the uncertainties that the run assumes.
    pub(crate) drawn: bool,
}

/// Runs an experiment with each of the seeds.
pub(crate) fn play(played: &Played<'_>, seeds: &[u64]) -> Result<Tally, Box<dyn Error>> {
    let scratch = tempfile::tempdir()?;
    let one = |seed: &u64| {
        let mut tally = Tally::default();
        let folder = scratch.path().join(seed.to_string());
        if let Err(error) = with_seed(&mut tally, played, (*seed, &folder)) {
            tally.fail(format!("seed {seed}: {error}"));
        }
        // A remaining scratch folder is harmless.
        let _ = std::fs::remove_dir_all(&folder);
        tally
    };
    Ok(seeds
        .par_iter()
        .map(one)
        .reduce(Tally::default, Tally::join))
}

fn with_seed(
    tally: &mut Tally,
    played: &Played<'_>,
    (seed, folder): (u64, &Path),
) -> Result<(), Box<dyn Error>> {
    let configs = if played.drawn {
        draw(played, seed, folder)?
    } else {
        played.configs.to_owned()
    };
    // The thesis' bench consists of real instruments: its experiment runs on the demo's, which is
    // modelled on it.
    let bench = (played.name == "thesis").then(|| configs.join("benches/demo.toml"));
    let mut experiment = load_experiment(
        &configs.join(format!("experiments/{}.toml", played.name)),
        bench.as_deref(),
    )?;
    if !experiment.fit.rc.is_empty() {
        experiment.fit.rc = vec![TRUE_RC];
    }
    experiment.seed = seed;
    let run = folder.join("run");
    let finished = run_experiment(&experiment, &run)?;
    judge(tally, &finished, &run);
    Ok(())
}

/// Copies the configurations with scenarios whose harness and capacity are drawn.
fn draw(played: &Played<'_>, seed: u64, folder: &Path) -> Result<PathBuf, Box<dyn Error>> {
    let copy = folder.join("configs");
    let mut normal = Normal(seed.wrapping_mul(0x9E6C_63D0_676A_9A99));
    let mut channel = |first: bool, offset_v: f64| {
        let (gain, skew_s) = if first {
            (1.0, 0.0)
        } else {
            (
                1.0 + GAIN_SPREAD * normal.next(),
                SKEW_SPREAD_S * normal.next(),
            )
        };
        format!("{{ gain = {gain}, skew_s = {skew_s:e}, offset_v = {offset_v} }}")
    };
    let channels: Vec<String> = [2.1e-3, -1.3e-3, 3.4e-3, -2.6e-3]
        .into_iter()
        .enumerate()
        .map(|(k, v)| channel(k == 0, v))
        .collect();
    let (jig_h, shunt_h) = (
        PICKUP_SPREAD_H * normal.next(),
        PICKUP_SPREAD_H * normal.next(),
    );
    let capacity_ah = CAPACITY_AH / (1.0 + SLOPE_SPREAD * normal.next());
    for part in ["benches", "cells", "experiments", "scenarios"] {
        std::fs::create_dir_all(copy.join(part))?;
        for entry in std::fs::read_dir(played.configs.join(part))? {
            let from = entry?.path();
            let mut text = std::fs::read_to_string(&from)?;
            if part == "scenarios" {
                text = text.replacen(
                    "[cell]\n",
                    &format!("[cell]\ncapacity_ah = {capacity_ah}\n"),
                    1,
                );
            }
            // The check of `accurate` goes up to 3 kHz and refuses skews of this size; its
            // scenario draws the controls instead.
            if part == "scenarios" && played.name != "accurate" {
                text += &format!(
                    "\n[harness]\njig_pickup_h = {jig_h:e}\nshunt_pickup_h = {shunt_h:e}\n\
                    channels = [{}]\n",
                    channels.join(", ")
                );
            }
            std::fs::write(
                copy.join(part).join(from.file_name().unwrap_or_default()),
                text,
            )?;
        }
    }
    Ok(copy)
}

fn judge(tally: &mut Tally, finished: &Finished, folder: &Path) {
    let measured = &finished.measured;
    let spectra: Vec<&Spectrum> = measured
        .spectra()
        .chain(measured.multisines.iter().map(|run| &run.spectrum))
        .collect();
    let Some(simulation) = &finished.simulation else {
        return tally.fail("no simulated world".to_owned());
    };
    let world = simulation.world();
    let world = world
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    for (number, spectrum) in spectra.iter().enumerate() {
        // Cells of a campaign are measured one after the other, each equally often.
        let cells = world.truth_specimens();
        let cell = if measured.campaign {
            number * cells / spectra.len()
        } else {
            0
        };
        for (index, point) in spectrum.points.iter().enumerate() {
            let truth = if cells > 1 {
                world.truth_impedance_of(cell, point.freq_hz)
            } else {
                world.truth_impedance(Fixture::Cell, point.freq_hz)
            };
            add_point(tally, index, point, truth);
        }
    }
    if measured.spectrum.points.is_empty() {
        return;
    }
    let text = match std::fs::read_to_string(folder.join(format!("model_{TRUE_RC}rc.json"))) {
        Ok(text) => text,
        Err(error) => return tally.fail(format!("model_{TRUE_RC}rc.json: {error}")),
    };
    match ModelFile::from_json(&text) {
        Ok(model) => {
            add_fit(tally, &model.fit, &truth());
            add_chi2(tally, &model.fit);
        }
        Err(error) => tally.fail(error.to_string()),
    }
}

fn add_point(tally: &mut Tally, index: usize, point: &ImpedancePoint, truth: Complex64) {
    let error = point.z_ohm - truth;
    let name = |part: &str| format!("{:.4} Hz, {part}", point.freq_hz);
    tally.add(
        2 * index,
        &name("Re"),
        error.re,
        Some(point.covariance.re_re.sqrt()),
    );
    tally.add(
        2 * index + 1,
        &name("Im"),
        error.im,
        Some(point.covariance.im_im.sqrt()),
    );
}

/// Returns the cell that the scenarios do not change: the mean of the cells if there are several.
fn truth() -> Erm {
    let cell = Scenario::default().cell;
    let branches = cell
        .branches
        .iter()
        .map(|b| analysis::model::RcBranch {
            r_ohm: b.r_ohm,
            c_f: b.c_f,
        })
        .collect();
    Erm {
        r_ohm: cell.r_ohm,
        branches,
    }
    .ordered()
}

/// Rows of the parameters follow those of the frequencies.
const PARAMETERS: usize = 10_000;

/// Adds the parameters of a fit.
pub(crate) fn add_fit(tally: &mut Tally, fit: &ErmFit, truth: &Erm) {
    let mut order = PARAMETERS;
    let mut add = |name: &str, error: f64, sigma: Option<f64>| {
        // A tally counts 1.96 sigmas: for few cells an interval is wider.
        tally.add(
            order,
            name,
            error,
            sigma.map(|sigma| sigma * fit.sigmas_of_95() / 1.96),
        );
        order += 1;
    };
    add("R", fit.erm.r_ohm - truth.r_ohm, fit.sigma.r_ohm);
    for (k, ((found, sigma), truth)) in fit
        .erm
        .branches
        .iter()
        .zip(&fit.sigma.branches)
        .zip(&truth.branches)
        .enumerate()
    {
        add(
            &format!("R{}", k + 1),
            found.r_ohm - truth.r_ohm,
            sigma.r_ohm,
        );
        add(&format!("C{}", k + 1), found.c_f - truth.c_f, sigma.c_f);
        add(
            &format!("τ{}", k + 1),
            found.time_constant_s() - truth.time_constant_s(),
            sigma.time_constant_s,
        );
    }
    add(
        "DC resistance",
        fit.erm.dc_resistance_ohm() - truth.dc_resistance_ohm(),
        fit.sigma.dc_resistance_ohm,
    );
}

/// Adds the distance of a reduced χ² from one in units of √(2/ν). It is not a deviation from a
/// truth, but exceeds two equally rarely.
fn add_chi2(tally: &mut Tally, fit: &ErmFit) {
    if let Some(chi2) = fit.reduced_chi2 {
        let freedom = (2 * fit.points - fit.cells.unwrap_or(1) * fit.erm.parameter_count()) as f64;
        tally.add(
            2 * PARAMETERS,
            "reduced χ² less 1, over √(2/ν)",
            chi2 - 1.0,
            Some((2.0 / freedom).sqrt()),
        );
    }
}
