//! `eis-bench fit --circuit`: any equivalent circuit, written as impedance.py's users know it.

mod args;

use crate::command::{
    batch::Plots,
    fit::{FitArgs, read, table},
    ocv_slope,
};
use bench_core::safety::failure::Failure;
use bench_evaluate::{files, support::present};
use bench_plan::support::terminal::say;
use std::path::Path;

use analysis::{
    fit::{
        CellSweeps, CircuitFit, CircuitOptions, Objective, Search, Slope, State, WarningCode,
        Weight, fit_circuit_cells,
    },
    model::{Circuit, WrittenCircuit},
    plot::{self, ImpedancePlot, Series, SeriesStyle},
    report::{Figure, Level, Report, Table, Verdict},
    run_folder::REPORT,
    spectrum::{SourcedSpectrum, Spectrum},
};
pub use args::CircuitArgs;

/// The spectra fitted together, and the fit.
struct Group {
    name: String,
    spectra: Vec<Spectrum>,
    fit: CircuitFit,
}

/// Report that `--json` prints and `circuit.json` holds.
#[derive(serde::Serialize)]
struct CircuitReport<'a> {
    fits: Vec<&'a CircuitFit>,
}

/// Fits a circuit to spectra, prints it, and writes it into a folder if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a fit that fails; a folder that cannot be
/// written.
pub fn fit_circuit(args: &FitArgs, text: &str) -> Result<(), Failure> {
    let written = WrittenCircuit::read(text)
        .map_err(|error| Failure::Usage(format!("--circuit: {error}")))?;
    let options = options(args, &written.circuit)?.with_written(&written);
    let circuit = written.circuit;
    let slope = ocv_slope::for_circuit(&args.slope, options.objective)?;
    if let Some(path) = &args.many.table {
        return table::circuit(args, path, circuit, options, slope);
    }
    let (mut cells, _) = read(args)?;
    cells
        .iter_mut()
        .for_each(|sourced| sourced.spectrum = slope.less(&sourced.spectrum));
    let groups: Vec<(String, Vec<SourcedSpectrum>)> = if args.pool {
        vec![("pooled".to_owned(), cells)]
    } else {
        cells
            .into_iter()
            .map(|sourced| (sourced.spectrum.name.clone(), vec![sourced]))
            .collect()
    };
    let mut fitted = Vec::new();
    for (name, sweeps) in groups {
        let mut fit = fit_circuit_cells(&CellSweeps::sort(&sweeps), &circuit, &options)
            .map_err(|error| Failure::Usage(format!("{name}: {error}")))?;
        if let Slope::Known(slope) = &slope {
            let micro = |v: f64| present::significant(1.0e6 * v, 3);
            fit.warnings.push(WarningCode::ChargeStorage.says(format!(
                "without charge storage: −j·(dU/dQ)/ω was taken out of the spectra, dU/dQ {} ± {} \
                µV/C",
                micro(slope.v_per_coulomb),
                micro(slope.sigma_v_per_coulomb)
            )));
        }
        let spectra = sweeps.into_iter().map(|sourced| sourced.spectrum).collect();
        fitted.push(Group { name, spectra, fit });
    }
    if let Some(folder) = &args.out {
        let plots = Plots::chosen(args.many.plots, fitted.len());
        for group in &fitted {
            let folder = if fitted.len() == 1 {
                folder.clone()
            } else {
                folder.join(&group.name)
            };
            write(&folder, group, &circuit, plots)?;
        }
    }
    if args.json {
        say!("{}", json(fitted.iter().map(|group| &group.fit).collect())?);
    } else {
        fitted.iter().for_each(print);
        if let Some(folder) = &args.out {
            say!("written to {}", folder.display());
        }
    }
    Ok(())
}

fn options(args: &FitArgs, circuit: &Circuit) -> Result<CircuitOptions, Failure> {
    // The messages begin with the argument's name.
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(format!("--{error}"));
    let values = |name: &'static str, text: &Option<String>| match text {
        Some(text) => circuit
            .assignments(name, text)
            .map_err(|error| Failure::Usage(error.to_string())),
        None => Ok(Vec::new()),
    };
    let objective: Objective = args.objective.parse().map_err(|error| usage(&error))?;
    let weight: Option<Weight> = args
        .circuit
        .weight
        .as_deref()
        .map(str::parse)
        .transpose()
        .map_err(|error| usage(&error))?;
    let search: Search = args.circuit.search.parse().map_err(|error| usage(&error))?;
    let guess = values("--guess", &args.circuit.guess)?;
    let constants = values("--constants", &args.circuit.constants)?;
    if let Some((index, _)) = guess
        .iter()
        .find(|(i, _)| constants.iter().any(|(c, _)| c == i))
    {
        let name = &circuit.parameter_names()[*index];
        return Err(Failure::Usage(format!(
            "--guess, --constants: expected a parameter in one of them, met {name} in both"
        )));
    }
    Ok(CircuitOptions {
        objective,
        weight,
        guess,
        constants,
        starts: args.more.starts,
        search,
        seed: args.seed,
    })
}

fn json(fits: Vec<&CircuitFit>) -> Result<String, Failure> {
    serde_json::to_string_pretty(&CircuitReport { fits })
        .map_err(|error| Failure::Analysis(error.to_string()))
}

fn print(group: &Group) {
    let fit = &group.fit;
    let plural = if group.spectra.len() == 1 {
        "spectrum"
    } else {
        "spectra"
    };
    say!(
        "{}: {} {plural}, {} points, {}",
        group.name,
        group.spectra.len(),
        fit.points,
        fit.circuit
    );
    let chi2 = fit
        .reduced_chi2
        .map_or_else(String::new, |chi2| format!(", reduced χ² {chi2:.2}"));
    let rms = present::significant(1.0e6 * fit.rms_ohm, 4);
    say!(
        "  objective {} = {}, weight {}{chi2}, rms {rms} µΩ",
        fit.objective_kind,
        objective(fit),
        fit.weight
    );
    let rows: Vec<[String; 5]> = (0..fit.names.len()).map(|index| row(fit, index)).collect();
    let width = |column: usize| {
        rows.iter()
            .map(|row| row[column].chars().count())
            .max()
            .unwrap_or(0)
    };
    let (name, value, sigma, unit) = (width(0), width(1), width(2), width(3));
    for row in &rows {
        let line = format!(
            "  {:<name$}  {:>value$} {:<sigma$} {:<unit$}  {}",
            row[0], row[1], row[2], row[3], row[4]
        );
        say!("{}", line.trim_end());
    }
    for warning in fit.warnings.iter() {
        say!("  note: {warning}");
    }
}

/// The objective's value with its unit, which depends on the weight too.
fn objective(fit: &CircuitFit) -> String {
    let unit = match (fit.weight, fit.objective_kind) {
        (Weight::Unit, Objective::SumAbs) => " Ω",
        (Weight::Unit, Objective::Modulus | Objective::Complex) => " Ω²",
        _ => "",
    };
    format!("{}{unit}", present::significant(fit.objective, 5))
}

/// Returns name, value, sigma, unit and a remark of one parameter; value and sigma have equal
/// numbers of decimals.
fn row(fit: &CircuitFit, index: usize) -> [String; 5] {
    let (value, sigma) = (fit.values[index], fit.sigmas[index]);
    let (factor, prefix) = prefix(value, &fit.units[index]);
    let (value, scaled) = (factor * value, sigma.map(|sigma| factor * sigma));
    let remark = match (fit.states[index], sigma) {
        (State::Constant, _) => "held".to_owned(),
        (State::AtLowerBound, _) => "at its lower bound".to_owned(),
        (State::AtUpperBound, _) => "at its upper bound".to_owned(),
        (State::Free, None) => "not fixed by the data".to_owned(),
        (State::Free, Some(sigma)) => format!(
            "{} %",
            present::significant(100.0 * factor * sigma / value, 2)
        ),
    };
    let plus_minus = scaled.map_or_else(String::new, |sigma| {
        format!("± {}", present::significant(sigma, 2))
    });
    [
        fit.names[index].clone(),
        present::significant(value, 5),
        plus_minus,
        format!("{prefix}{}", fit.units[index]),
        remark,
    ]
}

/// The power of a thousand that makes a value of a plain unit readable.
fn prefix(value: f64, unit: &str) -> (f64, &'static str) {
    let table = [
        (1.0e9, "n", 1.0e-6),
        (1.0e6, "µ", 1.0e-3),
        (1.0e3, "m", 1.0),
        (1.0, "", 1.0e4),
        (1.0e-3, "k", 1.0e7),
        (1.0e-6, "M", f64::INFINITY),
    ];
    let plain = ["Ω", "F", "H", "s"].contains(&unit);
    let fitting = table
        .into_iter()
        .find(|(_, _, below)| value < *below)
        .filter(|_| plain);
    fitting.map_or((1.0, ""), |(factor, prefix, _)| (factor, prefix))
}

fn write(folder: &Path, group: &Group, circuit: &Circuit, plots: Plots) -> Result<(), Failure> {
    files::make_folder(folder)?;
    let text = |name: &str, text: &str| files::write_text(folder, name, text);
    let drawn = |error: plot::PlotError| Failure::Analysis(error.to_string());
    text("circuit.json", &json(vec![&group.fit])?)?;
    let mut figures = Vec::new();
    if plots.draws(!group.fit.warnings.is_empty()) {
        let picture = picture(group, circuit);
        files::write_picture(folder, "nyquist", |path| plot::nyquist(&picture, path))?;
        files::write_picture(folder, "bode", |path| plot::bode(&picture, path))?;
        figures = vec![
            Figure {
                svg: plot::nyquist_svg(&picture).map_err(drawn)?,
                caption: "The circuit over the spectra; both axes have the same scale.".to_owned(),
            },
            Figure {
                svg: plot::bode_svg(&picture).map_err(drawn)?,
                caption: "Magnitude and phase over frequency.".to_owned(),
            },
        ];
    }
    let report = Report {
        title: present::titled(&group.fit.circuit.to_string(), &group.name),
        verdicts: group
            .fit
            .warnings
            .iter()
            .map(|warning| Verdict {
                level: Level::Note,
                text: warning.words.clone(),
            })
            .collect(),
        figures,
        tables: vec![table(&group.fit)],
        provenance: vec![
            (
                "program".to_owned(),
                format!("eis-bench {}", env!("CARGO_PKG_VERSION")),
            ),
            ("circuit".to_owned(), group.fit.circuit.clone()),
            (
                "objective".to_owned(),
                format!(
                    "{} = {}, weight {}",
                    group.fit.objective_kind,
                    objective(&group.fit),
                    group.fit.weight
                ),
            ),
            ("seed".to_owned(), group.fit.seed.to_string()),
            ("spectra".to_owned(), group.fit.spectra.join(", ")),
        ],
        ..Report::default()
    };
    text(
        REPORT,
        &report
            .to_html()
            .map_err(|error| Failure::Analysis(error.to_string()))?,
    )
}

fn table(fit: &CircuitFit) -> Table {
    let row = |index: usize| {
        let [name, value, sigma, unit, remark] = row(fit, index);
        vec![
            name,
            format!("{value} {sigma}").trim_end().to_owned(),
            unit,
            remark,
        ]
    };
    Table {
        caption: "Parameters (value ± one standard deviation)".to_owned(),
        header: ["parameter", "value", "unit", ""]
            .map(str::to_owned)
            .to_vec(),
        rows: (0..fit.names.len()).map(row).collect(),
    }
}

/// Spectra as points, the circuit as a curve over their band.
fn picture(group: &Group, circuit: &Circuit) -> ImpedancePlot {
    let many = group.spectra.len() > 1;
    let label = if many {
        format!("measured, {} spectra", group.spectra.len())
    } else {
        "measured".to_owned()
    };
    let data = |(index, spectrum): (usize, &Spectrum)| {
        let series = spectrum
            .series(0)
            .labelled((index == 0).then_some(label.as_str()));
        if many {
            series.styled(SeriesStyle::Cloud)
        } else {
            series
        }
    };
    let mut series: Vec<Series> = group.spectra.iter().enumerate().map(data).collect();
    let freqs = group
        .spectra
        .iter()
        .flat_map(|spectrum| &spectrum.points)
        .map(|point| point.freq_hz);
    let (low, high) = freqs.fold((f64::INFINITY, 0.0_f64), |(low, high), freq| {
        (low.min(freq), high.max(freq))
    });
    if low < high {
        series.push(Series::curve(
            &group.fit.circuit,
            low..=high,
            1,
            |freq_hz| circuit.impedance(&group.fit.values, freq_hz),
        ));
    }
    ImpedancePlot::new(&group.name, "", series)
}
