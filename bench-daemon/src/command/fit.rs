//! `eis-bench fit`: the extended Randles model for spectra from anywhere.

pub mod circuit;
pub mod more;

use self::more::{More, other_minima_note, print_selection};
use crate::{
    command,
    figures::impedance::bode_plot,
    files,
    safety::failure::Failure,
    support::present::{self, branches_table, fit_warnings, models_table},
    support::terminal::{remark, say},
};
use std::path::{Path, PathBuf};

use analysis::{
    fit::{
        Bounds, CellSweeps, ErmFit, FitEntry, FitOptions, FitReport, MAX_RC, ModelFile, Objective,
        PackModel, RefusedPoint, fit_cells,
    },
    pack::Pack,
    plot::{self, FigureInput},
    report::{Figure, Report},
    run_folder,
    spectrum::{SourcedSpectrum, Spectrum},
};

/// Arguments of `fit`.
#[derive(Debug, clap::Args)]
pub struct FitArgs {
    /// Spectra: the project's CSV, impedance.py's plain `f,re,im`, the thesis'
    /// `freq,offset,resistance,theta`, files of Gamry, EC-Lab, ZPlot, Autolab.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Leave out what is below this frequency, Hz.
    #[arg(long, default_value_t = 0.0, value_name = "HZ")]
    pub from_hz: f64,
    /// Leave out what is above this frequency, Hz.
    #[arg(long, default_value_t = f64::INFINITY, value_name = "HZ", hide_default_value = true)]
    pub to_hz: f64,
    /// Fit points that the quality gate of their measurement refused, too: those of the column
    /// `flags`.
    #[arg(long)]
    pub refused_points: bool,
    /// One fit over all spectra instead of one for each.
    #[arg(long)]
    pub pool: bool,
    /// Orders: a number of RC pairs, several with commas, `all` for 1 to 4, or `auto` for the one
    /// that the data bear.
    #[arg(long, default_value = "all", value_name = "N|all|auto")]
    pub rc: String,
    /// Objective to minimise: `sum-abs` (Σ|Z_model − Z_data|, as the thesis), `modulus` (|Z| only)
    /// or `complex` (least squares).
    #[arg(long, default_value = "complex")]
    pub objective: String,
    /// Charge storage of the cell.
    #[command(flatten)]
    pub slope: command::ocv_slope::SlopeArgs,
    /// A circuit instead of the extended Randles model, and how to fit it.
    #[command(flatten)]
    pub circuit: circuit::CircuitArgs,
    /// Seed of the global search.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Write models, plots and a report into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Order, uncertainty and search in depth.
    #[command(flatten)]
    pub more: more::MoreArgs,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// The spectra that one set of models belongs to.
struct Group {
    name: String,
    spectra: Vec<Spectrum>,
    fits: Vec<ErmFit>,
    more: More,
    refused: Vec<RefusedPoint>,
}

/// Fits models to spectra, prints them, and writes them into a folder if asked to.
///
/// # Errors
/// A file or an argument that is not as expected; a fit that cannot be made; a folder that cannot
/// be written.
pub fn fit(args: &FitArgs) -> Result<(), Failure> {
    if let Some(circuit) = &args.circuit.circuit {
        return crate::command::fit::circuit::fit_circuit(args, circuit);
    }
    let orders = orders(&args.rc)?;
    let objective: Objective = args
        .objective
        .parse()
        .map_err(|error| Failure::Usage(format!("--{error}")))?;
    let (cells, others) = read(args)?;
    let slope = super::ocv_slope::Slope::asked(&args.slope, objective)?;
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
        for group in &fitted {
            let folder = if fitted.len() == 1 {
                folder.clone()
            } else {
                folder.join(&group.name)
            };
            write(&folder, group, &others, args)?;
        }
    }
    if args.json {
        print_json(&fitted)
    } else {
        print_text(&fitted, args)
    }
}

/// Request for the fit of each group.
struct Wanted<'a> {
    orders: Option<&'a [usize]>,
    objective: Objective,
    slope: super::ocv_slope::Slope,
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
    let sweeps: Vec<SourcedSpectrum> = sweeps
        .iter()
        .map(|s| SourcedSpectrum {
            spectrum: slope.less(&s.spectrum),
            ..s.clone()
        })
        .collect();
    let cells = CellSweeps::sort(&sweeps);
    let mut more = More::choose(&name, &cells, orders.is_none(), args.seed)?;
    let chosen: Vec<usize> = more.order_selection.iter().map(|s| s.recommended).collect();
    let spectra: Vec<Spectrum> = sweeps.iter().map(|s| s.spectrum.clone()).collect();
    let mut fits = Vec::new();
    for &rc in orders.unwrap_or(&chosen) {
        let options = FitOptions {
            rc,
            objective,
            seed: args.seed,
            bounds: Bounds::for_spectra(&spectra),
        };
        let fit = fit_cells(&cells, &options, args.more.starts.unwrap_or(0))
            .map_err(|error| Failure::Usage(format!("{name}, {rc} RC: {error}")))?;
        if !fit.objective.is_finite() {
            return Err(Failure::Usage(format!(
                "{name}, {rc} RC: expected impedances that can be squared, found too large ones"
            )));
        }
        fits.push(fit);
    }
    more.add(&cells, &spectra, &fits, &args.more)?;
    Ok(Group {
        name,
        spectra: measured,
        fits,
        more,
        refused,
    })
}

/// The orders asked for; none for `auto`.
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

/// The spectra to be fitted, and the control impedances that came with them. Sweeps with a bias
/// belong to neither.
pub(super) fn read(args: &FitArgs) -> Result<(Vec<SourcedSpectrum>, Vec<Spectrum>), Failure> {
    let mut cells = Vec::new();
    let mut others = Vec::new();
    let mut passed_over = Vec::new();
    for file in &args.files {
        for mut sourced in files::read_spectra(file)? {
            sourced
                .spectrum
                .keep(|p| (args.from_hz..=args.to_hz).contains(&p.freq_hz));
            sourced
                .flagged
                .retain(|p| (args.from_hz..=args.to_hz).contains(&p.freq_hz));
            if sourced.spectrum.points.is_empty() {
                let met = format!("none from {} Hz to {} Hz", args.from_hz, args.to_hz);
                return Err(Failure::Usage(format!(
                    "{}: expected frequencies to be fitted, found {met}",
                    file.display()
                )));
            }
            if sourced.origin.is_unbiased_cell() {
                files::leave_out_refused(&mut sourced, args.refused_points)?;
                cells.push(sourced);
            } else {
                let SourcedSpectrum {
                    origin, spectrum, ..
                } = sourced;
                passed_over.push(spectrum.name.clone());
                if origin.fixture.as_deref() != Some("cell")
                    && origin.bias_a.is_none_or(|bias| bias == 0.0)
                {
                    others.push(spectrum);
                }
            }
        }
    }
    if !passed_over.is_empty() {
        remark!(
            "not fitted, for they are controls or carry a direct current: {}",
            passed_over.join(", ")
        );
    }
    if args.pool {
        files::refuse_curves(&cells)?;
    }
    if cells.is_empty() {
        return Err(Failure::Usage(
            "expected at least one spectrum of a cell without direct current, found none"
                .to_owned(),
        ));
    }
    Ok((cells, others))
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

/// The fits, and under `groups` what goes beyond them, where there is any of it.
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
            let (rc, dc) = (fit.erm.branches.len(), 1.0e3 * fit.erm.dc_resistance_ohm());
            say!(
                "  {rc} RC: objective {}, R {} mΩ, DC resistance {} mΩ",
                present::objective(fit),
                present::significant(1.0e3 * fit.erm.r_ohm, 5),
                present::significant(dc, 5)
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
            for warning in fit.warnings.iter().cloned().chain(other_minima_note(fit)) {
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
    let report = Report {
        title: present::titled("Extended Randles model", &group.name),
        verdicts: fit_warnings(&group.fits),
        figures,
        tables: vec![models_table(&group.fits), branches_table(&group.fits)],
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
