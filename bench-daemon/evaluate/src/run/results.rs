//! Results of a finished run: fits, model files, plots, the report, and a summary for the terminal.

mod alike;
mod campaign;
mod condition;
mod harmonics;
mod map;
mod multisine_and_trace;
mod ocv;
mod operando;
mod order;
mod ranges;
mod records;
mod report;
mod storage;
mod validity;

use analysis::{
    budget::Budget,
    fit::{Bounds, CellSweeps, FitOptions, ModelFile, PackModel, RefusedPoint, fit_cells},
    pack::Pack,
    run_folder,
    spectrum::Spectrum,
};
use instruments::fixture::Fixture;

use super::Measured;
use crate::doctor::fixture_check;
pub(crate) use alike::every_sweep;
use alike::{alike, alike_sweeps, linearity_in_words};
use bench_core::{record::Recorder, safety::failure::Failure};
use bench_plan::{config::Experiment, measure::SweepPoint};
use order::FittedOrders;

/// Writes everything that follows from the measurement into the run folder; returns the summary.
///
/// # Errors
/// Fails if a fit cannot be computed or a file cannot be written.
pub(super) fn write(
    recorder: &mut Recorder,
    experiment: &Experiment,
    measured: &Measured,
) -> Result<String, Failure> {
    tell_controls(recorder, measured);
    let mut shown = multisine_and_trace::write(recorder, experiment, measured)?;
    harmonics::write(recorder, measured, &mut shown)?;
    let ocv = ocv::write(recorder, experiment, &mut shown)?;
    let map = map::write(recorder, experiment, &mut shown)?;
    ranges::warn(recorder, measured)?;
    let text = evaluate(recorder, experiment, measured, shown)?;
    Ok(text.replacen("\nrun folder:", &format!("{ocv}{map}\nrun folder:"), 1))
}

/// Reports which controls the correction lacks.
fn tell_controls(recorder: &mut Recorder, measured: &Measured) {
    let mut names: Vec<&str> = measured
        .refused_controls
        .iter()
        .map(|(name, _)| *name)
        .collect();
    names.dedup();
    for name in names {
        let of = measured
            .refused_controls
            .iter()
            .filter(|(control, _)| *control == name);
        let points: Vec<String> = of
            .map(|(_, point)| format!("{:.4} Hz ({})", point.freq_hz, point.reasons.join("; ")))
            .collect();
        recorder.warning(&format!(
            "{} points of the {name} that the quality gate refused are left out of the correction: \
            {}",
            points.len(),
            points.join(", ")
        ));
    }
}

/// Evaluates the sweeps of the cell.
fn evaluate(
    recorder: &mut Recorder,
    experiment: &Experiment,
    measured: &Measured,
    shown: multisine_and_trace::Shown,
) -> Result<String, Failure> {
    if measured.spectrum.points.is_empty() {
        report::without_sweeps(recorder, experiment, measured, shown)?;
        let none = FittedOrders::default();
        return Ok(summary(recorder, experiment, measured, &none, None, None));
    }
    // The spectra of a map belong to different states of the cell: no model describes them together.
    let fitted = match experiment.map {
        Some(_) => FittedOrders::default(),
        None => fit_orders(recorder, experiment, measured),
    };
    let fits = &fitted.fits;
    if let Some(selection) = &fitted.selection {
        recorder.json(run_folder::ORDER, selection)?;
    }
    let pack = Pack::new(experiment.cell.series, experiment.cell.parallel, 0.0)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    let named: Vec<RefusedPoint> =
        refused_points(measured, &alike(measured), experiment.fit.refused_points)
            .into_iter()
            .map(|(_, point)| point)
            .collect();
    for fit in fits {
        let mapped =
            PackModel::new(&fit.erm, pack).map_err(|error| Failure::Analysis(error.to_string()))?;
        let mut model = ModelFile::new(
            &experiment.cell.name,
            fit.clone(),
            vec![measured.spectrum.name.clone()],
            Some(mapped),
        );
        model.refused = named.clone();
        model.ocv.clone_from(&experiment.cell.ocv);
        let text = model
            .to_json()
            .map_err(|error| Failure::Analysis(error.to_string()))?;
        recorder.text(&run_folder::model(model.rc), &text)?;
    }
    // Parquet has no columns for a direct current.
    let at_rest = |points: &[SweepPoint]| points.iter().all(|point| point.conditions.is_none());
    for (name, points) in &measured.sweeps {
        if !at_rest(points) {
            continue;
        }
        let raw = fixture_check::raw_points(&experiment.bench, points);
        recorder.flagged_parquet(
            &run_folder::raw_parquet(name),
            &raw,
            &super::sweep_writer::flag_texts(points),
        )?;
    }
    let cell = measured
        .sweeps
        .get(bench_plan::plan::fixture_name(Fixture::Cell))
        .map_or(&[][..], Vec::as_slice);
    let budget = Budget::new(
        &measured.correction,
        cell.iter().map(|point| &point.phasors),
    );
    recorder.text(run_folder::BUDGET, &budget.to_csv())?;
    recorder.json(run_folder::BUDGET_JSON, &budget)?;
    let judged = validity::judge(measured, experiment.bench.wiring.shunt.r_ohm);
    let campaign = experiment.campaign.as_ref();
    let campaign_results = campaign
        .map(|campaign| campaign::write(recorder, experiment, campaign, measured, fits, &judged))
        .transpose()?;
    let mut text = campaign_results.as_ref().map(|one| one.text.clone());
    if judged.len() > 1 {
        let verdict = validity::verdict(&judged).text;
        text = Some(text.map_or_else(|| verdict.clone(), |text| format!("{text}\n{verdict}")));
    }
    report::write(
        recorder,
        experiment,
        measured,
        report::SweepFindings {
            fitted: &fitted,
            budget: &budget,
            judged: &judged,
            campaign_results,
            shown,
        },
    )?;
    Ok(summary(
        recorder,
        experiment,
        measured,
        &fitted,
        Some(&budget),
        text.as_deref(),
    ))
}

/// Fits each model order to all sweeps of the cell together. An order that cannot be fitted is
/// noted and does not affect the others.
fn fit_orders(
    recorder: &mut Recorder,
    experiment: &Experiment,
    measured: &Measured,
) -> FittedOrders {
    let chosen = alike(measured);
    let mut spectra = storage::less_charge_storage(recorder, experiment, alike_sweeps(measured));
    let refused = refused_points(measured, &chosen, experiment.fit.refused_points);
    let left_out = leave_out(chosen.iter().copied().zip(&mut spectra), &refused);
    if left_out > 0 {
        recorder.warning(&format!(
            "{left_out} points that the quality gate refused are left out of the models: [fit] \
            refused_points = true keeps them"
        ));
        let left = spectra
            .iter()
            .map(|spectrum| spectrum.points.len())
            .max()
            .unwrap_or(0);
        spectra.retain(|spectrum| !spectrum.points.is_empty());
        if left == 0 {
            recorder.warning("no model: the quality gate has refused every point");
            return FittedOrders::default();
        }
    }
    let cells = by_cell(experiment, &spectra);
    let mut fits = Vec::new();
    for &rc in &experiment.fit.rc {
        let bounds = Bounds::for_spectra(&spectra);
        match fit_cells(
            &cells,
            &FitOptions {
                rc,
                objective: experiment.fit.objective,
                seed: experiment.seed,
                bounds,
            },
            0,
        ) {
            Ok(fit) if fit.objective.is_finite() => match fit.at_bounds() {
                None => fits.push(fit),
                Some(why) => recorder.warning(&format!("no model with {rc} RC: {why}")),
            },
            Ok(_) => recorder.warning(&format!(
                "no model with {rc} RC: its objective is not finite"
            )),
            Err(error) => recorder.warning(&format!("no model with {rc} RC: {error}")),
        }
    }
    let (fitted, warning) = FittedOrders::choose(fits, &cells, experiment);
    warning.iter().for_each(|text| recorder.warning(text));
    fitted
}

/// Removes points that are not to be fitted from sweeps, which are identified by their index
/// because repeats may have the same name. Returns the number of removed points.
pub(crate) fn leave_out<'a>(
    sweeps: impl Iterator<Item = (usize, &'a mut Spectrum)>,
    refused: &[(usize, RefusedPoint)],
) -> usize {
    let mut count = 0;
    for (place, spectrum) in sweeps {
        let before = spectrum.points.len();
        spectrum.keep(|point| {
            !refused
                .iter()
                .any(|(of, one)| *of == place && !one.fitted && one.freq_hz == point.freq_hz)
        });
        count += before - spectrum.points.len();
    }
    count
}

/// Returns the points that the quality gate refused to the end: the index of the sweep, and
/// whether the point is fitted anyway. Only the selected sweeps are fitted.
pub(crate) fn refused_points(
    measured: &Measured,
    chosen: &[usize],
    wanted: bool,
) -> Vec<(usize, RefusedPoint)> {
    let of = |(place, (spectrum, points)): (usize, (&Spectrum, &Vec<SweepPoint>))| {
        let named = |point: &SweepPoint| RefusedPoint {
            spectrum: spectrum.name.clone(),
            file: measured.files.get(place).cloned().unwrap_or_default(),
            freq_hz: point.phasors.freq_hz,
            reasons: point.failing.iter().map(ToString::to_string).collect(),
            fitted: wanted && chosen.contains(&place),
        };
        let refused = points.iter().filter(|point| !point.failing.is_empty());
        refused
            .map(|point| (place, named(point)))
            .collect::<Vec<_>>()
    };
    every_sweep(measured)
        .zip(&measured.points)
        .enumerate()
        .flat_map(of)
        .collect()
}

/// Groups the sweeps by the cells of a campaign; without a campaign all belong to one cell.
fn by_cell(experiment: &Experiment, spectra: &[Spectrum]) -> Vec<CellSweeps> {
    let mut cells: Vec<CellSweeps> = Vec::new();
    for spectrum in spectra {
        let run = experiment
            .campaign
            .as_ref()
            .and_then(|campaign| campaign.runs().find(|run| run.name() == spectrum.name));
        let name = run.map_or_else(String::new, |run| run.cell.name.clone());
        match cells.iter_mut().find(|cell| cell.cell == name) {
            Some(cell) => cell.sweeps.push(spectrum.clone()),
            None => cells.push(CellSweeps {
                cell: name,
                named: experiment.campaign.is_some(),
                sweeps: vec![spectrum.clone()],
            }),
        }
    }
    cells
}

fn summary(
    recorder: &Recorder,
    experiment: &Experiment,
    measured: &Measured,
    fitted: &FittedOrders,
    budget: Option<&Budget>,
    campaign: Option<&str>,
) -> String {
    let mut lines = vec![
        format!(
            "{} on bench {}: {}",
            experiment.name, experiment.bench.name, experiment.cell.name
        ),
        String::new(),
    ];
    for control in &measured.controls {
        lines.push(format!(
            "control {}, as read: {}",
            control.control, control.raw.text
        ));
        lines.extend(
            control
                .corrected
                .iter()
                .map(|verdict| format!("control {}, corrected: {}", control.control, verdict.text)),
        );
    }
    lines.extend(fixture_check::believed_in_words(&measured.controls));
    lines.push(String::new());
    let first_of = measured
        .first_of_several()
        .map_or_else(String::new, |name| format!("{name}: "));
    if let (Some(first), Some(last)) = (
        measured.spectrum.points.first(),
        measured.spectrum.points.last(),
    ) {
        for point in [first, last] {
            lines.push(format!(
                "{first_of}|Z| at {:>8.3} Hz: {:.4} ± {:.4} mΩ, phase {:+.2} ± {:.2}°",
                point.freq_hz,
                1.0e3 * point.magnitude_ohm(),
                1.0e3 * point.magnitude_sigma_ohm(),
                point.phase_rad().to_degrees(),
                point.phase_sigma_rad().to_degrees()
            ));
        }
    }
    lines.extend(measured.multisines.iter().map(super::multisine::in_words));
    lines.extend(validity::multisine_verdict(measured).map(|verdict| verdict.text));
    lines.extend(linearity_in_words(measured).map(|(_, text)| text));
    lines.extend(
        budget
            .map(Budget::in_words)
            .into_iter()
            .flatten()
            .map(|line| format!("{first_of}{line}")),
    );
    lines.extend(campaign.map(str::to_owned));
    let map = experiment.map.as_ref();
    lines.extend(map.and_then(|map| super::map_points::summary(recorder, map)));
    lines.push(String::new());
    for fit in &fitted.fits {
        let chi2 = fit
            .reduced_chi2
            .map_or_else(String::new, |chi2| format!(", reduced χ² {chi2:.2}"));
        lines.push(format!(
            "{}{} RC: R {:.4} mΩ, DC resistance {:.4} mΩ{}, rms residual {:.2} µΩ{chi2}",
            fitted.mark(fit),
            fit.erm.branches.len(),
            1.0e3 * fit.erm.r_ohm,
            1.0e3 * fit.erm.dc_resistance_ohm(),
            storage::apparent(fit),
            1.0e6 * fit.rms_ohm
        ));
    }
    lines.extend(fitted.in_words());
    for trace in &recorder.index().traces {
        let (file, ocv_v, steps) = (&trace.file, trace.start_ocv_v, trace.steps_s.len());
        lines.push(format!(
            "trace {}, repeat {}: {steps} steps from {ocv_v:.4} V at rest, {file}",
            trace.name, trace.repeat
        ));
    }
    if !recorder.warnings().is_empty() {
        lines.push(String::new());
        lines.extend(
            recorder
                .warnings()
                .iter()
                .map(|warning| format!("note: {warning}")),
        );
    }
    lines.push(String::new());
    lines.push(format!("run folder: {}", recorder.folder().display()));
    if recorder.path(run_folder::REPORT).exists() {
        lines.push(format!(
            "report:     {}",
            recorder.path(run_folder::REPORT).display()
        ));
    }
    // Empty parts leave no gap.
    lines.dedup_by(|line, before| line.is_empty() && before.is_empty());
    lines.join("\n") + "\n"
}
