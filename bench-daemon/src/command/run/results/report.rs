//! Plots and the page of a run.

use analysis::{
    budget::Budget,
    fit::ErmFit,
    plot::{self, ImpedancePlot, PlotError, Series},
    report::{Figure, Level, Report, Table, Verdict},
    spectrum::{ImpedancePoint, Spectrum},
};

use instruments::mock::plant::Fixture;

use super::{campaign::Told, records};
use crate::{
    command::{
        Failure,
        fit::{bode_plot, model_curves},
        kk,
        run::Measured,
    },
    config::Experiment,
    fixture_check,
    plan::fixture_name,
    present::{branches_table, fit_warnings, models_table, significant},
    record::Recorder,
};

/// A reduced χ² above this says that the model leaves something out.
const GOOD_CHI2: f64 = 2.0;

pub(super) fn write(
    recorder: &Recorder,
    experiment: &Experiment,
    measured: &Measured,
    (fits, budget, campaign): (&[ErmFit], &Budget, Option<Told>),
) -> Result<(), Failure> {
    let drawn = |error: PlotError| Failure::Analysis(error.to_string());
    let spectra = std::slice::from_ref(&measured.spectrum);
    let mut figures = Vec::new();
    let mut spread = None;
    if let Some(Told { figure, table, .. }) = campaign {
        figures.push(figure);
        spread = Some(table);
    }
    for (name, caption, plot) in plots(experiment, measured, fits) {
        for extension in ["svg", "png"] {
            plot::nyquist(&plot, &recorder.path(&format!("plots/{name}.{extension}"))).map_err(drawn)?;
        }
        figures.push(Figure { svg: plot::nyquist_svg(&plot).map_err(drawn)?, caption });
    }
    let bode = bode_plot(&format!("Bode plot, {}", experiment.cell.name), spectra, fits);
    for extension in ["svg", "png"] {
        plot::bode(&bode, &recorder.path(&format!("plots/bode.{extension}"))).map_err(drawn)?;
    }
    let caption = "Magnitude and phase over frequency: the corrected spectrum with 2σ, and the fitted models.".to_owned();
    figures.push(Figure { svg: plot::bode_svg(&bode).map_err(drawn)?, caption });
    let chart = budget.chart(&format!("Uncertainty budget, {}", experiment.cell.name));
    for extension in ["svg", "png"] {
        plot::chart(&chart, &recorder.path(&format!("plots/budget.{extension}"))).map_err(drawn)?;
    }
    let caption = "Where the uncertainty of the corrected spectrum comes from; the parts add up in squares.".to_owned();
    figures.push(Figure { svg: plot::chart_svg(&chart).map_err(drawn)?, caption });
    let cell = measured.sweeps.get(fixture_name(Fixture::Cell)).map_or(&[][..], Vec::as_slice);
    let records = records::records(cell, experiment.bench.wiring.shunt.r_ohm);
    let tested = records::with_own_noise(&measured.spectrum, budget);
    let (validity, pictures) = kk::in_report(&measured.spectrum, &tested, &records)?;
    figures.extend(pictures);
    let mut verdicts = verdicts(recorder, measured, fits);
    verdicts.insert(0, validity);
    let report = Report {
        title: format!("{}: {} on bench {}", experiment.name, experiment.cell.name, experiment.bench.name),
        verdicts,
        figures,
        tables: tables(experiment, measured, (fits, budget)).into_iter().chain([records::table(&records)]).chain(spread).collect(),
        provenance: provenance(experiment),
    };
    let html = report.to_html().map_err(|error| Failure::Analysis(error.to_string()))?;
    Ok(recorder.text("report.html", &html)?)
}

/// Nyquist plots: name, caption, plot.
fn plots(experiment: &Experiment, measured: &Measured, fits: &[ErmFit]) -> Vec<(String, String, ImpedancePlot)> {
    let spectra = std::slice::from_ref(&measured.spectrum);
    let subtitle = format!("{} A, corrected by the control impedances", amplitude_a(experiment));
    let data = Series::data(&measured.spectrum, 0).labelled(Some("measured, 2σ"));
    let title = format!("Nyquist plot, {}", experiment.cell.name);
    let all = std::iter::once(data.clone()).chain(model_curves(spectra, fits)).collect();
    let mut plots = vec![(
        "nyquist".to_owned(),
        "The cell and the fitted models; both axes have the same scale.".to_owned(),
        ImpedancePlot::new(&title, &subtitle, all),
    )];
    for (fit, curve) in fits.iter().zip(model_curves(spectra, fits)) {
        let rc = fit.erm.branches.len();
        let plot = ImpedancePlot::new(&format!("{title}, {rc} RC"), &subtitle, vec![data.clone(), curve]);
        plots.push((format!("nyquist_fit_{rc}rc"), format!("The model with {rc} RC."), plot));
    }
    if !measured.controls.is_empty() {
        plots.push(controls_plot(experiment, measured));
    }
    plots
}

fn controls_plot(experiment: &Experiment, measured: &Measured) -> (String, String, ImpedancePlot) {
    let mut series = Vec::new();
    for (index, control) in measured.controls.iter().enumerate() {
        let points = measured.sweeps.get(control.control).map_or(&[][..], Vec::as_slice);
        let spectrum = |points: Vec<ImpedancePoint>| Spectrum { name: control.control.to_owned(), points };
        let known = format!("{} as read (known: {} mΩ)", control.control, significant(1.0e3 * control.known.r_ohm, 4));
        series.push(Series::data(&spectrum(fixture_check::raw_points(&experiment.bench, points)), 2 * index).labelled(Some(&known)));
        if control.corrected.is_some() {
            let corrected = points.iter().map(|point| measured.correction.apply(&point.phasors)).collect();
            let label = format!("{}, corrected", control.control);
            series.push(Series::data(&spectrum(corrected), 2 * index + 1).labelled(Some(&label)));
        }
    }
    let caption = "The control impedances: what the bench reads without and with the correction that it computes from them.".to_owned();
    let plot = ImpedancePlot::new("Control impedances", &format!("{} A", amplitude_a(experiment)), series);
    ("nyquist_controls".to_owned(), caption, ImpedancePlot { mark_decades: false, ..plot })
}

fn amplitude_a(experiment: &Experiment) -> f64 {
    experiment.eis.as_ref().map_or(0.0, |eis| eis.amplitude_a)
}

fn verdicts(recorder: &Recorder, measured: &Measured, fits: &[ErmFit]) -> Vec<Verdict> {
    let level = |passed: bool| if passed { Level::Good } else { Level::Bad };
    let mut verdicts = Vec::new();
    for control in &measured.controls {
        verdicts.push(Verdict { level: level(control.raw.passed), text: format!("{}, as read: {}", control.control, control.raw.text) });
        verdicts.extend(
            control
                .corrected
                .iter()
                .map(|verdict| Verdict { level: level(verdict.passed), text: format!("{}, corrected: {}", control.control, verdict.text) }),
        );
    }
    verdicts.extend(fixture_check::believed_in_words(&measured.controls).map(|text| Verdict { level: Level::Note, text }));
    let verdict = |(linear, text)| Verdict { level: if linear { Level::Good } else { Level::Note }, text };
    verdicts.extend(super::linearity_in_words(measured).map(verdict));
    verdicts
        .extend(measured.multisines.iter().map(|run| Verdict { level: Level::Note, text: crate::command::run::multisine::in_words(run) }));
    if measured.controls.is_empty() {
        let text =
            "No control impedance was measured: the spectrum is as read, its uncertainty includes what a bench may be off.".to_owned();
        verdicts.push(Verdict { level: Level::Bad, text });
    }
    if let Some((chi2, fit)) = fits.iter().filter_map(|fit| Some((fit.reduced_chi2?, fit))).min_by(|a, b| a.0.total_cmp(&b.0)) {
        let rc = fit.erm.branches.len();
        let text = if chi2 <= GOOD_CHI2 {
            format!("The model with {rc} RC describes the spectrum within its uncertainty (reduced χ² {chi2:.2}).")
        } else {
            format!("No order describes the spectrum within its uncertainty; the best, {rc} RC, has a reduced χ² of {chi2:.1}.")
        };
        verdicts.push(Verdict { level: if chi2 <= GOOD_CHI2 { Level::Good } else { Level::Note }, text });
    }
    verdicts.extend(recorder.warnings().iter().map(|warning| Verdict { level: Level::Note, text: warning.clone() }));
    verdicts.extend(fit_warnings(fits));
    verdicts
}

fn tables(experiment: &Experiment, measured: &Measured, (fits, budget): (&[ErmFit], &Budget)) -> Vec<Table> {
    let words = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
    let point = |point: &ImpedancePoint| {
        vec![
            significant(point.freq_hz, 6),
            format!("{:.4} ± {:.4}", 1.0e3 * point.z_ohm.re, 1.0e3 * point.covariance.re_re.sqrt()),
            format!("{:.4} ± {:.4}", 1.0e3 * point.z_ohm.im, 1.0e3 * point.covariance.im_im.sqrt()),
            format!("{:.4} ± {:.4}", 1.0e3 * point.magnitude_ohm(), 1.0e3 * point.magnitude_sigma_ohm()),
            format!("{:.3} ± {:.3}", point.phase_rad().to_degrees(), point.phase_sigma_rad().to_degrees()),
            format!("{:.4}", point.amplitude_a),
        ]
    };
    let spectrum = Table {
        caption: "Corrected spectrum (value ± one standard deviation)".to_owned(),
        header: words(&["f / Hz", "Re Z / mΩ", "Im Z / mΩ", "|Z| / mΩ", "phase / °", "current / A"]),
        rows: measured.spectrum.points.iter().map(point).collect(),
    };
    let harness = Table {
        caption: "The bench as its controls show it".to_owned(),
        header: words(&["parameter", "value", "standard deviation", "unit"]),
        rows: measured
            .correction
            .parameters()
            .iter()
            .map(|parameter| {
                vec![parameter.name.to_owned(), significant(parameter.value, 6), significant(parameter.sigma, 2), parameter.unit.to_owned()]
            })
            .collect(),
    };
    let (series, parallel) = (experiment.cell.series, experiment.cell.parallel);
    let ratio = f64::from(series) / f64::from(parallel);
    let pack = Table {
        caption: format!("The same models for a pack of {series}S{parallel}P identical cells, without interconnect"),
        header: words(&["RC", "R / mΩ", "DC resistance / mΩ"]),
        rows: fits
            .iter()
            .map(|fit| {
                let milliohms = |ohms: f64| significant(1.0e3 * ratio * ohms, 5);
                vec![fit.erm.branches.len().to_string(), milliohms(fit.erm.r_ohm), milliohms(fit.erm.dc_resistance_ohm())]
            })
            .collect(),
    };
    vec![models_table(fits), branches_table(fits), pack, spectrum, harness, budget.table()]
}

fn provenance(experiment: &Experiment) -> Vec<(String, String)> {
    let mut rows = vec![
        ("program".to_owned(), format!("eis-bench {}", env!("CARGO_PKG_VERSION"))),
        ("seed".to_owned(), experiment.seed.to_string()),
        ("objective of the fits".to_owned(), experiment.fit.objective.to_string()),
        (
            "bench".to_owned(),
            if experiment.bench.simulation.is_some() {
                format!("{} (simulated instruments and cell)", experiment.bench.name)
            } else {
                experiment.bench.name.clone()
            },
        ),
    ];
    rows.extend(experiment.sources.iter().map(|source| ("file".to_owned(), source.path().display().to_string())));
    rows.push(("instruments, files' hashes".to_owned(), "manifest.json beside this page".to_owned()));
    rows
}
