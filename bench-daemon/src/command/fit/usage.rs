//! `eis-bench fit --usage`: impedance from records of ordinary use, and the weak cell of a string.

use std::path::Path;

use analysis::{
    dataset,
    fit::{Bounds, ErmFit, FitOptions, Objective, fit_erm},
    plot,
    report::{Figure, Level, Report, Table as Shown, Verdict},
    run_folder,
    table::{Hash, Table},
    usage::{CellUsage, CellVoltage, Lag, LagKind, StringCell, Usage, UsageRecord, usage},
};
use serde::Serialize;

use super::input::FitArgs;
use crate::command::{ocv, printed::say_json};
use bench_core::{record::RecordError, safety::failure::Failure};
use bench_evaluate::{files, support::present::significant};
use bench_plan::support::terminal::say;

/// Order of the models if it is not given: a fast and a slow branch.
const RC: usize = 2;
/// Columns of a string: time, current, then voltages.
const TIME: &str = "time_s";
const CURRENT: &str = "current_a";
const VOLTAGE: &str = "_v";

/// The result of one log.
#[derive(Serialize)]
struct Logged {
    log: String,
    length_s: f64,
    interval_s: f64,
    lag: Option<Lag>,
    cells: Vec<Cell>,
    string: Vec<StringCell>,
    #[serde(skip)]
    found: Usage,
}

/// The result of one cell.
#[derive(Serialize)]
struct Cell {
    name: String,
    frequencies: usize,
    refused: usize,
    /// Relative change of |Z| from the first to the second half, and its standard uncertainty.
    change: Option<[f64; 2]>,
    model: Option<ErmFit>,
}

/// Evaluates each log, prints the results, and writes a folder if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a current without power; a folder that cannot be
/// written.
pub(super) fn evaluate(args: &FitArgs) -> Result<(), Failure> {
    let rc = match args.rc.as_str() {
        "auto" => RC,
        text => text
            .parse()
            .ok()
            .filter(|rc| *rc <= analysis::fit::MAX_RC)
            .ok_or_else(|| {
                Failure::Usage(format!(
                    "--rc: expected `auto` or one number beside --usage, found {text:?}"
                ))
            })?,
    };
    let logs = args
        .files
        .iter()
        .map(|file| logged(file, rc, args.seed))
        .collect::<Result<Vec<Logged>, Failure>>()?;
    if let Some(folder) = &args.out {
        for (k, log) in logs.iter().enumerate() {
            if logs[..k].iter().any(|other| other.log == log.log) {
                return Err(Failure::Usage(format!(
                    "--out: expected logs of different names, found two of {:?}: each has a folder of \
                    its name",
                    log.log
                )));
            }
        }
        for log in &logs {
            let folder = if logs.len() == 1 {
                folder.clone()
            } else {
                folder.join(&log.log)
            };
            write(&folder, log)?;
        }
    }
    if args.json {
        return say_json(&logs);
    }
    logs.iter().for_each(print);
    if let Some(folder) = &args.out {
        say!("written to {}", folder.display());
    }
    Ok(())
}

fn logged(file: &Path, rc: usize, seed: u64) -> Result<Logged, Failure> {
    let found = usage(&read(file)?)
        .map_err(|error| Failure::Usage(format!("{}: {error}", file.display())))?;
    let model = |cell: &CellUsage| {
        let spectrum = std::slice::from_ref(&cell.spectrum);
        let options = FitOptions {
            rc,
            objective: Objective::Complex,
            bounds: Bounds::for_spectra(spectrum),
            seed,
        };
        fit_erm(spectrum, &options).ok()
    };
    let cell = |cell: &CellUsage| Cell {
        name: cell.spectrum.name.clone(),
        frequencies: cell.spectrum.points.len(),
        refused: cell.refused.len(),
        change: cell.change,
        model: model(cell),
    };
    Ok(Logged {
        log: file
            .file_stem()
            .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned()),
        length_s: found.length_s,
        interval_s: found.interval_s,
        lag: found.lag,
        cells: found.cells.iter().map(cell).collect(),
        string: found.string.clone(),
        found,
    })
}

/// Reads the table of a string, or the record of one cell in any format of time series.
fn read(file: &Path) -> Result<UsageRecord, Failure> {
    if let Some(record) = string_of(file)? {
        return Ok(record);
    }
    let series = ocv::read(file, None)?;
    Ok(UsageRecord {
        time_s: series.time_s,
        current_a: series.current_a,
        cells: vec![CellVoltage {
            name: series.name,
            voltage_v: series.voltage_v,
        }],
    })
}

/// Reads a table with a column of voltages for each of several cells; `None` for another file.
fn string_of(file: &Path) -> Result<Option<UsageRecord>, Failure> {
    let Ok(table) = Table::read(file, Hash::Comment) else {
        return Ok(None);
    };
    let voltages: Vec<usize> = (0..table.columns.len())
        .filter(|column| table.columns[*column].ends_with(VOLTAGE))
        .collect();
    let (Some(time), Some(current), true) = (
        table.column(TIME),
        table.column(CURRENT),
        voltages.len() > 1,
    ) else {
        return Ok(None);
    };
    let column = |column: usize| -> Result<Vec<f64>, Failure> {
        let number = |row: &analysis::table::Row| {
            row.number(column).ok_or_else(|| {
                Failure::Usage(format!(
                    "{}, line {}, column {}: expected a number, found {:?}",
                    file.display(),
                    row.line,
                    table.columns[column],
                    row.field(column)
                ))
            })
        };
        table.rows.iter().map(number).collect()
    };
    let cells = voltages
        .into_iter()
        .map(|index| {
            Ok(CellVoltage {
                name: table.columns[index].trim_end_matches(VOLTAGE).to_owned(),
                voltage_v: column(index)?,
            })
        })
        .collect::<Result<Vec<CellVoltage>, Failure>>()?;
    let mut record = UsageRecord {
        time_s: column(time)?,
        current_a: column(current)?,
        cells,
    };
    if rises_with_current(&record) {
        record
            .current_a
            .iter_mut()
            .for_each(|current_a| *current_a = -*current_a);
    }
    Ok(Some(record))
}

/// Returns whether the voltages rise with the current from row to row, as with a positive charge.
fn rises_with_current(record: &UsageRecord) -> bool {
    let steps = |values: &[f64]| {
        values
            .windows(2)
            .map(|pair| pair[1] - pair[0])
            .collect::<Vec<_>>()
    };
    let current = steps(&record.current_a);
    let sum = |cell: &CellVoltage| -> f64 {
        steps(&cell.voltage_v)
            .iter()
            .zip(&current)
            .map(|(u, i)| u * i)
            .sum()
    };
    record.cells.iter().map(sum).sum::<f64>() > 0.0
}

/// Returns the lag of the current channel as a sentence.
fn lag_in_words(lag: &Lag) -> String {
    let as_what = match lag.kind {
        LagKind::Delay => "by",
        LagKind::LowPass => "as behind a low-pass of",
    };
    let (late, early) = if lag.lag_s > 0.0 {
        ("current", "voltages")
    } else {
        ("voltages", "current")
    };
    format!(
        "the {late} lags the {early} {as_what} {} ms ± {} ms{}: taken out of the impedances",
        significant(1e3 * lag.lag_s.abs(), 3),
        significant(1e3 * lag.sigma_s, 2),
        match lag.kind {
            LagKind::Delay => "",
            LagKind::LowPass => " (an inductance looks the same)",
        }
    )
}

/// Returns the verdicts on a log in sentences.
fn verdicts(log: &Logged) -> impl Iterator<Item = String> {
    string_in_words(&log.string)
        .into_iter()
        .chain(log.lag.as_ref().map(lag_in_words))
}

/// Returns the verdict on a string in sentences; empty for a single cell.
fn string_in_words(string: &[StringCell]) -> Vec<String> {
    let weak: Vec<String> = string
        .iter()
        .filter(|cell| cell.weak)
        .map(|cell| {
            format!(
                "{} is weak: it answers the current {:.1} % ± {} % more than the mean of the string, {:.1} \
                times the scatter of the other cells (p {})",
                cell.name,
                100.0 * cell.excess,
                significant(100.0 * cell.sigma, 2),
                cell.scatters,
                significant(cell.p, 2)
            )
        })
        .collect();
    if weak.is_empty() && !string.is_empty() {
        return vec![format!("no cell of {} stands out", string.len())];
    }
    weak
}

fn cells_table(log: &Logged) -> Shown {
    let percent = |v: f64| format!("{} %", significant(100.0 * v, 2));
    let row = |cell: &Cell| {
        let excess = log.string.iter().find(|one| one.name == cell.name);
        let [r, dc] = cell
            .model
            .as_ref()
            .map_or(["–".to_owned(), "–".to_owned()], |fit| {
                [fit.erm.r_ohm, fit.erm.dc_resistance_ohm()].map(|ohm| significant(1e3 * ohm, 4))
            });
        vec![
            cell.name.clone(),
            cell.frequencies.to_string(),
            cell.refused.to_string(),
            r,
            dc,
            cell.change.map_or_else(
                || "–".to_owned(),
                |[change, sigma]| format!("{} ± {}", percent(change), percent(sigma)),
            ),
            excess.map_or_else(
                || "–".to_owned(),
                |one| format!("{} ± {}", percent(one.excess), percent(one.sigma)),
            ),
        ]
    };
    let header = [
        "cell",
        "frequencies",
        "refused",
        "R / mΩ",
        "DC resistance / mΩ",
        "change in the log",
        "excess",
    ];
    Shown {
        caption: "Cells: frequencies with and without an impedance, model, change of |Z| from the first to \
                  the second half, response beyond the mean of the string."
            .to_owned(),
        header: header.map(str::to_owned).to_vec(),
        rows: log.cells.iter().map(row).collect(),
    }
}

fn print(log: &Logged) {
    say!(
        "{}: {} s at {} Hz, {} cells",
        log.log,
        significant(log.length_s, 3),
        significant(log.interval_s.recip(), 3),
        log.cells.len()
    );
    let table = cells_table(log);
    for row in std::iter::once(&table.header).chain(&table.rows) {
        let fields = row.iter().map(|field| format!("{field:<18}"));
        say!("  {}", fields.collect::<String>().trim_end());
    }
    verdicts(log).for_each(|text| say!("{text}"));
}

fn write(folder: &Path, log: &Logged) -> Result<(), Failure> {
    files::make_folder(folder)?;
    let failed = |error: String| Failure::Analysis(error);
    for cell in log
        .found
        .cells
        .iter()
        .filter(|cell| !cell.spectrum.points.is_empty())
    {
        let path = folder.join(format!("{}.csv", cell.spectrum.name.replace('/', "_")));
        let flags = vec![String::new(); cell.spectrum.points.len()];
        dataset::write_whole_spectrum_csv(&path, &cell.spectrum, &flags)
            .map_err(RecordError::from)?;
    }
    let json = serde_json::to_string_pretty(log).map_err(|error| failed(error.to_string()))?;
    files::write_text(folder, "usage.json", &json)?;
    let spectra = log.found.cells.iter().enumerate();
    let series = spectra.map(|(k, cell)| cell.spectrum.series(k)).collect();
    let picture = plot::ImpedancePlot::new(&format!("Impedance in {}", log.log), "2σ", series);
    let svg = plot::nyquist_svg(&picture).map_err(|error| failed(error.to_string()))?;
    files::write_picture(folder, "usage", |path| plot::nyquist(&picture, path))?;
    let report = Report {
        title: format!("Impedance from ordinary use: {}", log.log),
        verdicts: verdicts(log)
            .map(|text| Verdict {
                level: Level::Note,
                text,
            })
            .collect(),
        figures: vec![Figure {
            svg,
            caption: "Impedance of each cell where the current has power.".to_owned(),
        }],
        tables: vec![cells_table(log)],
        provenance: vec![(
            "program".to_owned(),
            format!("eis-bench {}", env!("CARGO_PKG_VERSION")),
        )],
        ..Report::default()
    };
    let html = report
        .to_html()
        .map_err(|error| failed(error.to_string()))?;
    files::write_text(folder, run_folder::REPORT, &html)
}
