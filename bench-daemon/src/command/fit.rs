//! `eis-bench fit`: the extended Randles model for spectra from anywhere.

pub mod circuit;
mod group;
mod input;
mod many;
pub mod more;
mod table;
mod under_current;
mod usage;

use self::{
    group::Group,
    more::{More, other_minima_note, print_selection},
};
use crate::command::batch::Plots;
use bench_core::safety::failure::Failure;
use bench_evaluate::{
    figures::impedance::bode_plot,
    files,
    support::present::{self, branches_table, fit_warnings, models_table},
};
use bench_plan::support::terminal::{remark, say};
use std::path::Path;

use analysis::{
    fit::{
        ErmFit, ErmRequest, FitEntry, FitReport, MAX_RC, ModelFile, Objective, PackModel, Prepared,
        Slope,
    },
    pack::Pack,
    plot::{self, FigureInput},
    report::{Figure, Report},
    run_folder,
    spectrum::{SourcedSpectrum, Spectrum},
};
pub use input::FitArgs;
pub(super) use input::read;

/// Most groups of spectra whose models are printed in full; of more, a table is printed.
const MOST_IN_FULL: usize = 3;

/// Fits models to spectra, prints them, and writes them into a folder if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a fit that fails; a folder that cannot be
/// written.
pub fn fit(args: &FitArgs) -> Result<(), Failure> {
    if args.usage {
        return usage::evaluate(args);
    }
    if args.under_current {
        under_current::refuse_others(args)?;
        return under_current::compare(args);
    }
    if let Some(circuit) = &args.circuit.circuit {
        return crate::command::fit::circuit::fit_circuit(args, circuit);
    }
    let orders = orders(&args.rc)?;
    let objective: Objective = args
        .objective
        .parse()
        .map_err(|error| Failure::Usage(format!("--{error}")))?;
    let slope = super::ocv_slope::asked(&args.slope, objective)?;
    if let Some(path) = &args.many.table {
        return table::erm(args, path, orders.as_deref(), objective, slope);
    }
    let (cells, others) = read(args)?;
    let groups: Vec<(String, Vec<SourcedSpectrum>)> = if args.pool {
        vec![("pooled".to_owned(), cells)]
    } else {
        cells
            .into_iter()
            .map(|cell| (cell.spectrum.name.clone(), vec![cell]))
            .collect()
    };
    let fitted = groups
        .into_iter()
        .map(|(name, sweeps)| {
            fit_group(
                name,
                &sweeps,
                &Wanted {
                    orders: orders.as_deref(),
                    objective,
                    slope,
                    args,
                },
            )
        })
        .collect::<Result<Vec<_>, _>>()?;
    if let Some(folder) = &args.out {
        let plots = Plots::chosen(args.many.plots, fitted.len());
        for group in &fitted {
            let folder = if fitted.len() == 1 {
                folder.clone()
            } else {
                folder.join(&group.name)
            };
            write(&folder, group, &others, args, plots)?;
        }
    }
    if args.json {
        print_json(&fitted)
    } else if fitted.len() > MOST_IN_FULL {
        many::print(&fitted, args);
        Ok(())
    } else {
        print_text(&fitted, args)
    }
}

/// Request for the fit of each group.
struct Wanted<'a> {
    orders: Option<&'a [usize]>,
    objective: Objective,
    slope: Slope,
    args: &'a FitArgs,
}

/// All that is wanted of the sweeps of one group; without orders the data choose one.
fn fit_group(
    name: String,
    sweeps: &[SourcedSpectrum],
    wanted: &Wanted<'_>,
) -> Result<Group, Failure> {
    let Wanted {
        orders,
        objective,
        slope,
        args,
    } = *wanted;
    let refused = files::refused_points(sweeps, args.refused_points);
    let measured: Vec<Spectrum> = sweeps.iter().map(|s| s.spectrum.clone()).collect();
    let prepared = Prepared::of(sweeps, slope);
    let request = ErmRequest {
        rc: None,
        objective,
        slope,
        seed: args.seed,
        starts: args.more.starts.unwrap_or(0),
    };
    let mut more = More::choose(&name, &prepared, orders.is_none(), args.seed)?;
    let chosen: Vec<usize> = more.order_selection.iter().map(|s| s.recommended).collect();
    let fit = |rc: &usize| {
        prepared
            .fit(*rc, &request)
            .map_err(|error| Failure::Usage(format!("{name}, {rc} RC: {error}")))
    };
    let fits: Vec<ErmFit> = orders
        .unwrap_or(&chosen)
        .iter()
        .map(fit)
        .collect::<Result<_, _>>()?;
    let fits = offered(&name, fits)?;
    more.add(&prepared, &fits, &args.more)?;
    Ok(Group {
        name,
        spectra: measured,
        fits,
        more,
        refused,
    })
}

/// Returns the fits whose parameters are measured. A fit with a parameter at a bound is reported,
/// and is not a result.
fn offered(name: &str, fits: Vec<ErmFit>) -> Result<Vec<ErmFit>, Failure> {
    let mut refused = Vec::new();
    let mut offered = Vec::new();
    for fit in fits {
        match fit.at_bounds() {
            None => offered.push(fit),
            Some(why) => refused.push(format!(
                "{name}: no model with {} RC: {why}",
                fit.erm.branches.len()
            )),
        }
    }
    if offered.is_empty() {
        return Err(Failure::Usage(refused.join("; ")));
    }
    for text in refused {
        remark!("eis-bench: {text}");
    }
    Ok(offered)
}

/// Returns the requested orders, or `None` for `auto`.
fn orders(text: &str) -> Result<Option<Vec<usize>>, Failure> {
    match text {
        "all" => return Ok(Some(vec![1, 2, 3, 4])),
        "auto" => return Ok(None),
        _ => {}
    }
    let fail = || {
        Failure::Usage(format!(
            "--rc: expected `all` or different numbers from 1 to {MAX_RC} separated by commas, \
            found {text:?}"
        ))
    };
    let orders: Vec<usize> = text
        .split(',')
        .map(|order| order.trim().parse().map_err(|_| fail()))
        .collect::<Result<_, _>>()?;
    let distinct: std::collections::BTreeSet<usize> = orders.iter().copied().collect();
    let sound =
        distinct.len() == orders.len() && distinct.iter().all(|order| (1..=MAX_RC).contains(order));
    if sound { Ok(Some(orders)) } else { Err(fail()) }
}

fn report_of(fitted: &[Group]) -> FitReport {
    let entry = |group: &Group, fit: &ErmFit| {
        FitEntry::new(
            fit,
            group
                .spectra
                .iter()
                .map(|spectrum| spectrum.name.clone())
                .collect(),
        )
    };
    FitReport {
        fits: fitted
            .iter()
            .flat_map(|group| group.fits.iter().map(|fit| entry(group, fit)))
            .collect(),
    }
}

/// The fits, and additional results under `groups`, if there are any.
#[derive(serde::Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    report: FitReport,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    groups: Vec<&'a More>,
}

fn print_json(fitted: &[Group]) -> Result<(), Failure> {
    let groups = fitted
        .iter()
        .map(|group| &group.more)
        .filter(|more| !more.is_empty())
        .collect();
    let text = serde_json::to_string_pretty(&Printed {
        report: report_of(fitted),
        groups,
    })
    .map_err(|error| Failure::Analysis(error.to_string()))?;
    say!("{text}");
    Ok(())
}

fn print_text(fitted: &[Group], args: &FitArgs) -> Result<(), Failure> {
    for group in fitted {
        let points: usize = group
            .spectra
            .iter()
            .map(|spectrum| spectrum.points.len())
            .sum();
        let plural = if group.spectra.len() == 1 {
            "spectrum"
        } else {
            "spectra"
        };
        say!(
            "{}: {} {plural}, {points} points, objective {}",
            group.name,
            group.spectra.len(),
            args.objective
        );
        if let Some(selection) = &group.more.order_selection {
            print_selection(selection);
        }
        for fit in &group.fits {
            say!(
                "  {} RC: objective {}, R {} mΩ, DC resistance {} mΩ",
                fit.erm.branches.len(),
                present::objective(fit),
                present::r_mohm(fit),
                present::dc_resistance_mohm(fit)
            );
            if let Some(storage) = &fit.charge_storage {
                say!("        {}", super::ocv_slope::in_words(storage));
            }
            for branch in &fit.erm.branches {
                let tau = present::significant(branch.r_ohm * branch.c_f, 4);
                let (r, c) = (
                    present::significant(1.0e3 * branch.r_ohm, 5),
                    present::significant(branch.c_f, 5),
                );
                say!("        {r:>8} mΩ ∥ {c:>8} F   τ {tau} s");
            }
            for warning in fit
                .warnings
                .words()
                .into_iter()
                .chain(other_minima_note(fit))
            {
                say!("        note: {warning}");
            }
        }
        group.more.print(&group.fits);
    }
    if let Some(folder) = &args.out {
        say!("written to {}", folder.display());
    }
    Ok(())
}

fn write(
    folder: &Path,
    group: &Group,
    controls: &[Spectrum],
    args: &FitArgs,
    plots: Plots,
) -> Result<(), Failure> {
    files::make_folder(folder)?;
    let names: Vec<String> = group
        .spectra
        .iter()
        .map(|spectrum| spectrum.name.clone())
        .collect();
    let text = |name: &str, text: &str| files::write_text(folder, name, text);
    for fit in &group.fits {
        let pack = PackModel::new(&fit.erm, Pack::THESIS)
            .map_err(|error| Failure::Analysis(error.to_string()))?;
        let mut model = ModelFile::new(&group.name, fit.clone(), names.clone(), Some(pack));
        model.refused.clone_from(&group.refused);
        let json = model
            .to_json()
            .map_err(|error| Failure::Analysis(error.to_string()))?;
        text(&run_folder::model(model.rc), &json)?;
    }
    if let Some(selection) = &group.more.order_selection {
        let json = serde_json::to_string_pretty(selection)
            .map_err(|error| Failure::Analysis(error.to_string()))?;
        text(run_folder::ORDER, &json)?;
    }
    let has_warnings = group.fits.iter().any(|fit| !fit.warnings.is_empty());
    let figures = if plots.draws(has_warnings) {
        draw(folder, group, controls)?
    } else {
        Vec::new()
    };
    let report = Report {
        title: present::titled("Extended Randles model", &group.name),
        verdicts: fit_warnings(&group.fits),
        figures,
        tables: vec![models_table(&group.fits, None), branches_table(&group.fits)],
        provenance: vec![
            (
                "program".to_owned(),
                format!("eis-bench {}", env!("CARGO_PKG_VERSION")),
            ),
            ("objective".to_owned(), args.objective.clone()),
            ("seed".to_owned(), args.seed.to_string()),
            ("spectra".to_owned(), names.join(", ")),
        ],
        ..Report::default()
    };
    text(
        run_folder::REPORT,
        &report
            .to_html()
            .map_err(|error| Failure::Analysis(error.to_string()))?,
    )
}

/// Draws the pictures of a group into its folder; returns those of its report.
fn draw(folder: &Path, group: &Group, controls: &[Spectrum]) -> Result<Vec<Figure>, Failure> {
    let input = FigureInput {
        sweeps: &group.spectra,
        controls,
        fits: &group.fits,
    };
    let drawn = |error: plot::PlotError| Failure::Analysis(error.to_string());
    plot::write_thesis_figures(&input, folder).map_err(drawn)?;
    group.more.draw(folder)?;
    let bode = bode_plot(&group.name, &group.spectra, &group.fits);
    files::write_picture(folder, "bode", |path| plot::bode(&bode, path))?;
    let mut figures = vec![Figure {
        svg: plot::nyquist_svg(&plot::sweeps_figure(&group.spectra)).map_err(drawn)?,
        caption: "Nyquist plot of the spectra; both axes have the same scale.".to_owned(),
    }];
    for fit in &group.fits {
        let svg = plot::nyquist_svg(&plot::fit_figure(&group.spectra, fit)).map_err(drawn)?;
        figures.push(Figure {
            svg,
            caption: format!(
                "The model with {} RC over the spectra.",
                fit.erm.branches.len()
            ),
        });
    }
    figures.push(Figure {
        svg: plot::bode_svg(&bode).map_err(drawn)?,
        caption: "Magnitude and phase over frequency.".to_owned(),
    });
    Ok(figures)
}
