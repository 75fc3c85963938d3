//! Plots and the report page of a run.

use analysis::{
    budget::Budget,
    fit::ErmFit,
    plot::{self, ImpedancePlot, PlotError, Series, SeriesStyle},
    report::{Figure, Level, Report, Scripted, Table, Verdict},
    run_folder::{self, MANIFEST, PLOTS, REPORT, SUMS},
    spectrum::{ImpedancePoint, Spectrum},
};
use num_complex::Complex64;

use super::{
    campaign::CampaignResults,
    condition,
    multisine_and_trace::{Shown, draw},
    order::FittedOrders,
    records,
    validity::{self, Judged},
};
use crate::{
    doctor::fixture_check,
    figures::{
        curves::{Curve, ModelOver, Point, scripted},
        impedance::{bode_plot, model_curves},
    },
    files,
    run::{Measured, manifest},
    support::present::{branches_table, fit_warnings, models_table, significant},
};
use bench_core::{journal::ConfigCopy, record::Recorder, safety::failure::Failure};
use bench_plan::{config::Experiment, measure::SweepPoint, support::quoted::quoted};

/// Reduced χ² above which the model is incomplete.
const GOOD_CHI2: f64 = 2.0;

/// Findings from the sweeps of the cell.
pub(super) struct SweepFindings<'a> {
    /// Models of all sweeps together.
    pub(super) fitted: &'a FittedOrders,
    /// The uncertainty of the first sweep.
    pub(super) budget: &'a Budget,
    /// Verdict on each sweep.
    pub(super) judged: &'a [Judged],
    /// Additions of a campaign.
    pub(super) campaign_results: Option<CampaignResults>,
    /// Other measurements.
    pub(super) shown: Shown,
}

/// Writes the page of a run with sweeps of the cell.
pub(super) fn write(
    recorder: &Recorder,
    experiment: &Experiment,
    measured: &Measured,
    found: SweepFindings<'_>,
) -> Result<(), Failure> {
    let SweepFindings {
        fitted,
        budget,
        judged,
        campaign_results,
        shown,
    } = found;
    let fits = &fitted.fits;
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    tables.extend(validity::table(experiment.campaign.as_ref(), judged));
    if let Some(CampaignResults { figure, table, .. }) = campaign_results {
        figures.push(figure);
        tables.push(table);
    }
    figures.extend(models_figures(recorder, experiment, measured, fits)?);
    let first = measured.first_of_several();
    let of = first
        .as_ref()
        .map_or_else(String::new, |name| format!(" of {name}"));
    let titled = first
        .as_ref()
        .map_or_else(String::new, |name| format!(", {name}"));
    let chart = budget.chart(&format!(
        "Uncertainty budget, {}{titled}",
        experiment.cell.name
    ));
    let caption = format!(
        "Where the uncertainty of the corrected spectrum{of} comes from; the parts add up in \
        squares."
    );
    figures.push(draw(recorder, "budget", &chart, caption)?);
    figures.extend(validity::pictures(measured, judged)?);
    figures.extend(shown.figures);
    let mut verdicts = verdicts(recorder, measured);
    verdicts.insert(0, validity::verdict(judged));
    verdicts.extend(described(experiment, measured, fits));
    verdicts.extend(shown.verdicts);
    verdicts.extend(noted(recorder, fits));
    let points = measured.points.first().map_or(&[][..], Vec::as_slice);
    let records = records::table(
        &records::records(points, experiment.bench.wiring.shunt.r_ohm),
        &of,
    );
    let tables = model_tables(experiment, fitted)
        .into_iter()
        .chain(tables)
        .chain([
            spectrum_table(measured, &of),
            harness_table(measured),
            budget_table(budget, &of),
            records,
        ])
        .chain(shown.tables);
    let scripted = Some(looked_into(measured, fitted));
    page(
        recorder,
        experiment,
        Page {
            verdicts,
            scripted,
            figures,
            tables: tables.collect(),
        },
    )
}

/// Returns the corrected spectra with the models that were fitted to all of them, for interactive
/// inspection.
fn looked_into(measured: &Measured, fitted: &FittedOrders) -> Scripted {
    let named = measured
        .names()
        .into_iter()
        .zip(measured.spectra())
        .zip(&measured.points);
    let curve =
        |(index, ((name, spectrum), points)): (usize, ((String, &Spectrum), &Vec<SweepPoint>))| {
            let name = if name.is_empty() {
                "spectrum".to_owned()
            } else {
                name
            };
            let flagged = |point: (&ImpedancePoint, &SweepPoint)| {
                let words: Vec<String> = point.1.failing.iter().map(ToString::to_string).collect();
                Point {
                    verdict: Some(words.join("; ")).filter(|words| !words.is_empty()),
                    ..Point::from(point.0)
                }
            };
            let mut points: Vec<Point> = spectrum.points.iter().zip(points).map(flagged).collect();
            points.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
            Curve {
                id: name.clone(),
                name,
                index,
                corrected: true,
                points,
            }
        };
    let curves: Vec<Curve> = named.enumerate().map(curve).collect();
    let over = |curve: &Curve| {
        let model = |fit: &ErmFit| {
            let order = fit.erm.branches.len();
            let file = run_folder::model(order);
            let recommended = fitted.recommended() == Some(order);
            ModelOver::new(fit, &file, &curve.id, &curve.points).marked(recommended)
        };
        let mut models: Vec<ModelOver> = fitted.fits.iter().map(model).collect();
        models.sort_by_key(ModelOver::place);
        models
    };
    let models: Vec<ModelOver> = curves.iter().flat_map(over).collect();
    scripted(&curves, &models)
}

/// Contents of the page of a run.
struct Page {
    verdicts: Vec<Verdict>,
    scripted: Option<Scripted>,
    figures: Vec<Figure>,
    tables: Vec<Table>,
}

/// Writes the page of a run without sweeps, or with controls only.
pub(super) fn without_sweeps(
    recorder: &Recorder,
    experiment: &Experiment,
    measured: &Measured,
    shown: Shown,
) -> Result<(), Failure> {
    let mut figures = shown.figures;
    let mut tables = shown.tables;
    if !measured.controls.is_empty() {
        figures.push(nyquist(recorder, controls_plot(experiment, measured))?);
        tables.push(harness_table(measured));
    }
    let mut verdicts = verdicts(recorder, measured);
    verdicts.extend(shown.verdicts);
    verdicts.extend(noted(recorder, &[]));
    page(
        recorder,
        experiment,
        Page {
            verdicts,
            scripted: None,
            figures,
            tables,
        },
    )
}

fn page(recorder: &Recorder, experiment: &Experiment, contents: Page) -> Result<(), Failure> {
    let Page {
        verdicts,
        scripted,
        figures,
        tables,
    } = contents;
    let title = format!(
        "{}: {} on bench {}",
        experiment.name, experiment.cell.name, experiment.bench.name
    );
    let copies = manifest::copies(experiment)?;
    let files = copies
        .iter()
        .zip(&experiment.sources)
        .map(|(file, source)| (file.copy.clone(), source.text().to_owned()))
        .collect();
    let report = Report {
        title,
        verdicts,
        scripted,
        figures,
        tables,
        provenance: provenance(recorder, experiment, &copies)?,
        files,
        ..Report::default()
    };
    let html = report
        .to_html()
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    Ok(recorder.text(REPORT, &html)?)
}

/// A Nyquist plot of the report.
struct NyquistPlot {
    /// Name of its files, without the extension.
    name: String,
    caption: String,
    plot: ImpedancePlot,
}

/// Draws a Nyquist plot as files and as a figure.
fn nyquist(recorder: &Recorder, shown: NyquistPlot) -> Result<Figure, Failure> {
    files::write_picture(&recorder.path(PLOTS), &shown.name, |path| {
        plot::nyquist(&shown.plot, path)
    })?;
    Ok(Figure {
        svg: plot::nyquist_svg(&shown.plot).map_err(drawn)?,
        caption: shown.caption,
    })
}

#[expect(clippy::needless_pass_by_value, reason = "what map_err hands over")]
fn drawn(error: PlotError) -> Failure {
    Failure::Analysis(error.to_string())
}

/// Draws the models against all the data that they were fitted to.
fn models_figures(
    recorder: &Recorder,
    experiment: &Experiment,
    measured: &Measured,
    fits: &[ErmFit],
) -> Result<Vec<Figure>, Failure> {
    let pool: Vec<Spectrum> = super::alike_sweeps(measured).into_iter().cloned().collect();
    let mut figures = Vec::new();
    for plot in plots(experiment, measured, &pool, fits) {
        figures.push(nyquist(recorder, plot)?);
    }
    let bode = bode_plot(&format!("Bode plot, {}", whose(experiment)), &pool, fits);
    files::write_picture(&recorder.path(PLOTS), "bode", |path| {
        plot::bode(&bode, path)
    })?;
    let caption = match pool.len() {
        0 | 1 => "Magnitude and phase over frequency: the corrected spectrum with 2σ, and the \
        fitted models."
            .to_owned(),
        count => format!(
            "Magnitude and phase over frequency: {count} corrected spectra, and the \
        models fitted to all of them together."
        ),
    };
    figures.push(Figure {
        svg: plot::bode_svg(&bode).map_err(drawn)?,
        caption,
    });
    Ok(figures)
}

/// Returns the name of the cell, or the number of cells.
fn whose(experiment: &Experiment) -> String {
    let cells = experiment
        .campaign
        .as_ref()
        .map_or(1, |campaign| campaign.cells.len());
    if cells > 1 {
        format!("{}, {cells} cells", experiment.cell.name)
    } else {
        experiment.cell.name.clone()
    }
}

/// Draws Nyquist plots of the cell, its models and the controls.
fn plots(
    experiment: &Experiment,
    measured: &Measured,
    pool: &[Spectrum],
    fits: &[ErmFit],
) -> Vec<NyquistPlot> {
    let subtitle = format!(
        "{} A, corrected by the control impedances",
        amplitude_a(experiment)
    );
    let (data, to): (Vec<Series>, String) = if let [only] = pool {
        (
            vec![only.series(0).labelled(Some("measured, 2σ"))],
            String::new(),
        )
    } else {
        let label = format!("measured, {} spectra", pool.len());
        let light = |(index, spectrum): (usize, &Spectrum)| {
            spectrum
                .series(0)
                .styled(SeriesStyle::Cloud)
                .labelled((index == 0).then_some(label.as_str()))
        };
        (
            pool.iter().enumerate().map(light).collect(),
            format!(", fitted to {} spectra together", pool.len()),
        )
    };
    let title = format!("Nyquist plot, {}", whose(experiment));
    let all = data
        .iter()
        .cloned()
        .chain(model_curves(pool, fits))
        .collect();
    let mut plots = vec![NyquistPlot {
        name: "nyquist".to_owned(),
        caption: format!("The cell and the models{to}; both axes have the same scale."),
        plot: ImpedancePlot::new(&title, &subtitle, all),
    }];
    for (fit, curve) in fits.iter().zip(model_curves(pool, fits)) {
        let rc = fit.erm.branches.len();
        let plot = ImpedancePlot::new(
            &format!("{title}, {rc} RC"),
            &subtitle,
            data.iter().cloned().chain([curve]).collect(),
        );
        plots.push(NyquistPlot {
            name: format!("nyquist_fit_{rc}rc"),
            caption: format!("The model with {rc} RC{to}."),
            plot,
        });
    }
    if !measured.controls.is_empty() {
        plots.push(controls_plot(experiment, measured));
    }
    plots
}

fn controls_plot(experiment: &Experiment, measured: &Measured) -> NyquistPlot {
    let mut series = Vec::new();
    for (index, control) in measured.controls.iter().enumerate() {
        let points = measured
            .sweeps
            .get(control.control)
            .map_or(&[][..], Vec::as_slice);
        let spectrum = |points: Vec<ImpedancePoint>| Spectrum {
            name: control.control.to_owned(),
            points,
            ..Spectrum::default()
        };
        let known = format!(
            "{} as read (known: {} mΩ)",
            control.control,
            significant(1.0e3 * control.known.r_ohm, 4)
        );
        series.push(
            spectrum(fixture_check::raw_points(&experiment.bench, points))
                .series(2 * index)
                .labelled(Some(&known)),
        );
        if control.corrected.is_some() {
            let corrected = points
                .iter()
                .map(|point| measured.correction.apply(&point.phasors))
                .collect();
            let label = format!("{}, corrected", control.control);
            series.push(
                spectrum(corrected)
                    .series(2 * index + 1)
                    .labelled(Some(&label)),
            );
        }
    }
    let caption = "The control impedances: what the bench reads without and with the correction \
    that it computes from them."
        .to_owned();
    let plot = ImpedancePlot::new(
        "Control impedances",
        &format!("{} A", amplitude_a(experiment)),
        series,
    );
    NyquistPlot {
        name: "nyquist_controls".to_owned(),
        caption,
        plot: ImpedancePlot {
            mark_decades: false,
            ..plot
        },
    }
}

fn amplitude_a(experiment: &Experiment) -> f64 {
    experiment.eis.as_ref().map_or(0.0, |eis| eis.amplitude_a.0)
}

/// Returns the verdicts on controls, linearity and multisines.
fn verdicts(recorder: &Recorder, measured: &Measured) -> Vec<Verdict> {
    let level = |passed: bool| if passed { Level::Good } else { Level::Bad };
    let mut verdicts = Vec::new();
    for control in &measured.controls {
        // The reference of the correction need not be correct, only close enough.
        let (raw, what) = match (&control.corrected, control.raw.passed) {
            (Some(_), true) => (Level::Note, "as read, before the correction"),
            (_, passed) => (level(passed), "as read"),
        };
        let name = control.control.replace('_', " ");
        verdicts.push(Verdict {
            level: raw,
            text: format!("{name}, {what}: {}", control.raw.text),
        });
        if let Some(verdict) = &control.corrected {
            verdicts.push(Verdict {
                level: level(verdict.passed),
                text: format!("{name}, corrected: {}", verdict.text),
            });
        }
    }
    verdicts.extend(
        fixture_check::believed_in_words(&measured.controls).map(|text| Verdict {
            level: Level::Note,
            text,
        }),
    );
    let verdict = |(linear, text)| Verdict {
        level: if linear { Level::Good } else { Level::Note },
        text,
    };
    verdicts.extend(super::linearity_in_words(measured).map(verdict));
    verdicts.extend(measured.multisines.iter().map(|run| Verdict {
        level: Level::Note,
        text: crate::run::multisine::in_words(run),
    }));
    verdicts.extend(super::validity::multisine_verdict(measured));
    let through_channels = measured.spectra().next().is_some()
        || !measured.multisines.is_empty()
        || !recorder.index().traces.is_empty();
    if measured.controls.is_empty() && through_channels {
        let text = "No control impedance was measured: everything is as read, and its uncertainty \
            includes what a bench may be off."
            .to_owned();
        verdicts.push(Verdict {
            level: Level::Bad,
            text,
        });
    }
    verdicts
}

/// Returns the warnings of the run and of the fits.
fn noted(recorder: &Recorder, fits: &[ErmFit]) -> Vec<Verdict> {
    let odd = recorder.warnings().into_iter().map(|text| Verdict {
        level: Level::Note,
        text,
    });
    odd.chain(fit_warnings(fits)).collect()
}

/// Returns whether a model describes its data; for several spectra, the remaining residual.
fn described(experiment: &Experiment, measured: &Measured, fits: &[ErmFit]) -> Option<Verdict> {
    let known = fits.iter().filter_map(|fit| Some((fit.reduced_chi2?, fit)));
    let (chi2, fit) = known.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let (rc, pool) = (fit.erm.branches.len(), super::alike_sweeps(measured));
    let (what, its) = match pool.len() {
        0 | 1 => ("the spectrum".to_owned(), "its"),
        count => (format!("the {count} spectra"), "their"),
    };
    if chi2 <= GOOD_CHI2 {
        let text = format!(
            "The model with {rc} RC describes {what} within {its} uncertainty (reduced χ² \
            {chi2:.2})."
        );
        return Some(Verdict {
            level: Level::Good,
            text,
        });
    }
    let mut text = format!(
        "No order describes {what} within {its} uncertainty; the best, {rc} RC, has a reduced χ² \
        of {chi2:.1}."
    );
    if pool.len() > 1 {
        let cells = experiment
            .campaign
            .as_ref()
            .is_some_and(|campaign| campaign.cells.len() > 1);
        text.push_str(&residual_text(
            fit.rms_ohm,
            scatter_ohm(&pool),
            if cells { "cells" } else { "repeats" },
        ));
    }
    Some(Verdict {
        level: Level::Note,
        text,
    })
}

/// Describes the residual of a fit to several spectra: the spread of the spectra around their
/// mean, and the error of the model for the mean; rms, Ω.
fn residual_text(rms_ohm: f64, scatter_ohm: f64, among: &str) -> String {
    let micro = |ohms: f64| significant(1.0e6 * ohms, 3);
    let missed_ohm = (rms_ohm.powi(2) - scatter_ohm.powi(2)).max(0.0).sqrt();
    let (all, scatter, missed) = (micro(rms_ohm), micro(scatter_ohm), micro(missed_ohm));
    if scatter_ohm > missed_ohm {
        format!(
            " What is left, {all} µΩ rms, is the spread between the {among}, {scatter} µΩ; of \
            their mean the model misses {missed} µΩ."
        )
    } else {
        format!(
            " Of what is left, {all} µΩ rms, the spread between the {among} makes {scatter} µΩ; of \
            their mean the model misses {missed} µΩ."
        )
    }
}

/// Returns the distance of spectra from their mean, root mean square over all points, Ω.
fn scatter_ohm(pool: &[&Spectrum]) -> f64 {
    let (mut squares, mut count) = (0.0, 0_u32);
    for point in pool.iter().flat_map(|spectrum| &spectrum.points) {
        let same = |spectrum: &&Spectrum| {
            spectrum
                .points
                .iter()
                .find(|other| other.freq_hz == point.freq_hz)
                .map(|other| other.z_ohm)
        };
        let all: Vec<Complex64> = pool.iter().filter_map(same).collect();
        squares += (point.z_ohm - all.iter().sum::<Complex64>() / all.len() as f64).norm_sqr();
        count += 1;
    }
    (squares / f64::from(count.max(1))).sqrt()
}

fn strings(strings: &[&str]) -> Vec<String> {
    strings.iter().map(|word| (*word).to_owned()).collect()
}

fn model_tables(experiment: &Experiment, fitted: &FittedOrders) -> [Table; 3] {
    let fits = &fitted.fits;
    let (series, parallel) = (experiment.cell.series, experiment.cell.parallel);
    let ratio = f64::from(series) / f64::from(parallel);
    let row = |fit: &ErmFit| {
        let milliohms = |ohms: f64| significant(1.0e3 * ratio * ohms, 5);
        vec![
            fit.erm.branches.len().to_string(),
            milliohms(fit.erm.r_ohm),
            milliohms(fit.erm.dc_resistance_ohm()),
        ]
    };
    let pack = Table {
        caption: format!(
            "The same models for a pack of {series}S{parallel}P identical cells, without \
            interconnect"
        ),
        header: strings(&["RC", "R / mΩ", "DC resistance / mΩ"]),
        rows: fits.iter().map(row).collect(),
    };
    [
        models_table(fits, fitted.recommended()),
        branches_table(fits),
        pack,
    ]
}

/// Returns a table of the spectrum; `of` names it if there are several.
fn spectrum_table(measured: &Measured, of: &str) -> Table {
    let point = |point: &ImpedancePoint| {
        vec![
            significant(point.freq_hz, 6),
            format!(
                "{:.4} ± {:.4}",
                1.0e3 * point.z_ohm.re,
                1.0e3 * point.covariance.re_re.sqrt()
            ),
            format!(
                "{:.4} ± {:.4}",
                1.0e3 * point.z_ohm.im,
                1.0e3 * point.covariance.im_im.sqrt()
            ),
            format!(
                "{:.4} ± {:.4}",
                1.0e3 * point.magnitude_ohm(),
                1.0e3 * point.magnitude_sigma_ohm()
            ),
            format!(
                "{:.3} ± {:.3}",
                point.phase_rad().to_degrees(),
                point.phase_sigma_rad().to_degrees()
            ),
            format!("{:.4}", point.amplitude_a),
        ]
    };
    Table {
        caption: format!("Corrected spectrum{of} (value ± one standard deviation)"),
        header: strings(&[
            "f / Hz",
            "Re Z / mΩ",
            "Im Z / mΩ",
            "|Z| / mΩ",
            "phase / °",
            "current / A",
        ]),
        rows: measured.spectrum.points.iter().map(point).collect(),
    }
}

fn budget_table(budget: &Budget, of: &str) -> Table {
    let table = budget.table();
    Table {
        caption: table.caption.replacen(
            "Uncertainty budget",
            &format!("Uncertainty budget{of}"),
            1,
        ),
        ..table
    }
}

fn harness_table(measured: &Measured) -> Table {
    let parameters = measured.correction.parameters();
    let row = |parameter: &analysis::calibration::HarnessParameter| {
        vec![
            parameter.name.to_owned(),
            significant(parameter.value, 6),
            significant(parameter.sigma, 2),
            parameter.unit.to_owned(),
        ]
    };
    Table {
        caption: "The bench as its controls show it".to_owned(),
        header: strings(&["parameter", "value", "standard deviation", "unit"]),
        rows: parameters.iter().map(row).collect(),
    }
}

fn provenance(
    recorder: &Recorder,
    experiment: &Experiment,
    copies: &[ConfigCopy],
) -> Result<Vec<(String, String)>, Failure> {
    let mut rows = vec![
        (
            "program".to_owned(),
            format!("eis-bench {}", env!("CARGO_PKG_VERSION")),
        ),
        ("seed".to_owned(), experiment.seed.to_string()),
        (
            "objective of the fits".to_owned(),
            experiment.fit.objective.to_string(),
        ),
        (
            "bench".to_owned(),
            if experiment.bench.simulation.is_some() {
                format!("{} (simulated instruments and cell)", experiment.bench.name)
            } else {
                experiment.bench.name.clone()
            },
        ),
    ];
    rows.extend(condition::rows(recorder, experiment)?);
    rows.extend(copies.iter().map(|file| {
        (
            "file".to_owned(),
            format!("{}, SHA-256 {}", file.copy, file.sha256),
        )
    }));
    rows.push((
        "instruments".to_owned(),
        format!("{MANIFEST} beside this page"),
    ));
    rows.push((
        "all files' hashes".to_owned(),
        format!("{SUMS} beside this page; `eis-bench verify` holds the folder against them"),
    ));
    if let [first, bench, ..] = copies {
        let (first, bench) = (quoted(&first.path), quoted(&bench.path));
        let text = format!(
            "eis-bench run {first} --bench {bench} --seed {}",
            experiment.seed
        );
        rows.push(("to repeat it".to_owned(), text));
    }
    rows.push((
        "from the captures".to_owned(),
        "eis-bench replay of the run folder".to_owned(),
    ));
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis::numeric::Covariance2;

    #[test]
    fn the_spread_of_the_pool_is_distinguished_from_what_the_model_misses() {
        let spectrum = |re: f64| Spectrum {
            name: String::new(),
            points: vec![ImpedancePoint {
                freq_hz: 1.0,
                z_ohm: re.into(),
                covariance: Covariance2::UNKNOWN,
                amplitude_a: 1.0,
            }],
            ..Spectrum::default()
        };
        let all = [0.009, 0.011].map(spectrum);
        let scatter = scatter_ohm(&all.iter().collect::<Vec<_>>());
        assert!((scatter - 0.001).abs() < 1.0e-12, "{scatter}");
        let text = " What is left, 1020 µΩ rms, is the spread between the cells, 1000 µΩ; of their \
        mean the model misses 201 µΩ.";
        assert_eq!(residual_text(0.00102, scatter, "cells"), text);
        assert!(residual_text(0.002, scatter, "repeats").starts_with(
            " Of what is left, 2000 µΩ rms, the spread between the repeats makes 1000 µΩ;"
        ));
    }
}
