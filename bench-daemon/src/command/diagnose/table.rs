//! `eis-bench diagnose --table`: one row for each held-out run of many data sets.

use std::fs;
use std::path::{Path, PathBuf};

use analysis::{
    diagnosis::{Diagnosis, Verdict},
    rows::{Cell, ResultColumn, ResultRow},
    run_folder::JOURNAL,
};
use serde::Serialize;

use super::args::DiagnoseArgs;
use super::judged::{Judged, accept};
use crate::command::batch::{Items, Job, paths, work};
use bench_core::safety::failure::Failure;
use bench_evaluate::investigate::dataset::DATASET_FILE;

/// Data sets of one part: a diagnosis takes seconds to minutes, and one that is done is kept.
const PART: usize = 1;
/// Name of a gap for which no effect was searched.
const GAP: &str = "gap";

/// Data sets, one after another.
struct DataSets {
    folders: Vec<PathBuf>,
    next: usize,
}

impl DataSets {
    /// The folders that were named, or the data sets and runs in them.
    fn new(named: &[PathBuf]) -> Result<Self, Failure> {
        let mut folders = Vec::new();
        for folder in named {
            if is_data_set(folder) {
                folders.push(folder.clone());
                continue;
            }
            let failed = |error| Failure::Usage(format!("{}: {error}", folder.display()));
            let mut inside = Vec::new();
            for entry in fs::read_dir(folder).map_err(failed)? {
                inside.push(entry.map_err(failed)?.path());
            }
            inside.retain(|path| is_data_set(path));
            if inside.is_empty() {
                return Err(Failure::Usage(format!(
                    "{}: expected {DATASET_FILE}, a run, or folders of them, found none",
                    folder.display()
                )));
            }
            inside.sort();
            folders.extend(inside);
        }
        Ok(Self { folders, next: 0 })
    }
}

fn is_data_set(folder: &Path) -> bool {
    [DATASET_FILE, JOURNAL]
        .iter()
        .any(|name| folder.join(name).is_file())
}

impl Items for DataSets {
    type Item = PathBuf;

    /// The files of each folder; files elsewhere that a data set names are not looked at.
    fn identity(&self) -> Result<String, Failure> {
        let mut text = String::new();
        for folder in &self.folders {
            let files = paths::files_of(std::slice::from_ref(folder), "a data set")?;
            for file in files {
                text += &paths::identity(&file)?;
            }
        }
        Ok(text)
    }

    fn share(&self) -> f64 {
        self.next as f64 / self.folders.len().max(1) as f64
    }

    fn next(&mut self) -> Result<Option<PathBuf>, Failure> {
        let folder = self.folders.get(self.next).cloned();
        self.next += 1;
        Ok(folder)
    }
}

/// Diagnoses each data set.
pub(super) fn table(args: &DiagnoseArgs, table: &Path) -> Result<(), Failure> {
    for (name, given) in [
        ("--json", args.json),
        ("--out", args.out.is_some()),
        ("--findings", args.findings),
    ] {
        if given {
            return Err(Failure::Usage(format!(
                "{name}: expected no --table beside it: a table has one row for each held-out run"
            )));
        }
    }
    let mut sets = DataSets::new(&args.data)?;
    let job = Job {
        table,
        call: format!("diagnose {args:?}"),
        columns: columns(),
        part: PART,
        noun: ["data set", "data sets"],
    };
    work(job, &mut sets, |folder| rows(args, folder), |_, _| Ok(()))
}

/// Numbers of one held-out run: mV of a record, % of a spectrum.
const GAPS: [&str; 8] = [
    "eis_only_mv",
    "base_mv",
    "augmented_mv",
    "floor_mv",
    "eis_only_percent",
    "base_percent",
    "augmented_percent",
    "floor_percent",
];

/// Numbers of a data set.
const QUALITY: [&str; 5] = [
    "base_chi2",
    "degrees_of_freedom",
    "base_z",
    "augmented_chi2",
    "augmented_z",
];

fn columns() -> Vec<ResultColumn> {
    let mut columns: Vec<ResultColumn> = ["data_set", "cell", "run", "verdict", "effects"]
        .map(ResultColumn::text)
        .into();
    columns.extend(
        GAPS.iter()
            .chain(&QUALITY)
            .map(|name| ResultColumn::number(*name)),
    );
    columns.extend(["summary", "warning_codes", "warnings", "error"].map(ResultColumn::text));
    columns
}

/// Returns the rows of a data set: one for each held-out run of each cell, or one without a run
/// if there is none.
fn rows(args: &DiagnoseArgs, folder: &Path) -> Vec<ResultRow> {
    let name = folder.file_name().unwrap_or(folder.as_os_str());
    let name = name.to_string_lossy();
    match diagnoses(args, folder) {
        Err(failure) => vec![refused(&name, &failure.to_string())],
        Ok(cells) => {
            let rows = cells.iter().flat_map(|(cell, diagnosis)| match diagnosis {
                Ok(diagnosis) => of_cell(args, &name, cell, diagnosis),
                Err(failure) => vec![refused(&name, &format!("cell {cell}: {failure}"))],
            });
            rows.collect()
        }
    }
}

/// A cell with its diagnosis.
type OfCell = (String, Result<Diagnosis, Failure>);

fn diagnoses(args: &DiagnoseArgs, folder: &Path) -> Result<Vec<OfCell>, Failure> {
    let mut judged = Judged::read(
        folder,
        &args.model,
        args.ocv.as_deref(),
        args.refused_points,
    )?;
    judged.base_only = args.base_only;
    judged.quiet = true;
    accept(&mut judged.loaded, &args.accept);
    let cells = judged.cells(args.specimen.as_deref())?;
    let each = judged.each(&cells, args.specimen.as_deref());
    Ok(each
        .map(|(cell, one)| {
            let diagnosis = one.diagnose().map(|outcome| outcome.diagnosis);
            (cell.to_owned(), diagnosis)
        })
        .collect())
}

fn of_cell(args: &DiagnoseArgs, name: &str, cell: &str, d: &Diagnosis) -> Vec<ResultRow> {
    let records = d.gap.iter().map(|gap| {
        let mv = [gap.eis_only_mv, gap.base_mv, gap.augmented_mv, gap.floor_mv];
        (Some(&gap.run), [mv, [f64::NAN; 4]].concat())
    });
    let spectra = d.gap_spectra.iter().map(|gap| {
        let percent = [
            gap.eis_only_percent,
            gap.base_percent,
            gap.augmented_percent,
            gap.floor_percent,
        ];
        (Some(&gap.run), [[f64::NAN; 4], percent].concat())
    });
    let mut runs: Vec<(Option<&String>, Vec<f64>)> = records.chain(spectra).collect();
    if runs.is_empty() {
        runs.push((None, vec![f64::NAN; GAPS.len()]));
    }
    let verdict = match d.verdict {
        Verdict::AtNoiseFloor | Verdict::Invalid => code(&d.verdict),
        _ if args.base_only => GAP.to_owned(),
        other => code(&other),
    };
    let effects: Vec<&str> = d.effects.iter().map(|effect| effect.name).collect();
    let q = &d.quality;
    let quality = [
        q.base_chi2,
        q.degrees_of_freedom,
        q.base_z,
        q.augmented_chi2,
        q.augmented_z,
    ];
    let mut kinds: Vec<String> = d
        .findings
        .iter()
        .map(|finding| code(&finding.kind))
        .collect();
    kinds.dedup();
    let words: Vec<&str> = d
        .findings
        .iter()
        .map(|finding| finding.text.as_str())
        .collect();
    let invalid = (d.verdict == Verdict::Invalid).then(|| d.summary.clone());
    // Without a search the sentence about effects would mislead.
    let summary = if args.base_only {
        Cell::Text(None)
    } else {
        Cell::text(&d.summary)
    };
    let row = |(run, gaps): (Option<&String>, Vec<f64>)| {
        let mut cells = vec![
            Cell::text(name),
            Cell::text(cell),
            Cell::Text(run.cloned()),
            Cell::text(&verdict),
            Cell::text(effects.join(";")),
        ];
        cells.extend(gaps.into_iter().chain(quality).map(Cell::finite));
        cells.push(summary.clone());
        cells.push(Cell::text(kinds.join(";")));
        cells.push(Cell::text(words.join("; ")));
        cells.push(Cell::Text(invalid.clone()));
        ResultRow {
            cells,
            error: invalid.clone(),
            has_warnings: !kinds.is_empty(),
            fitted: None,
        }
    };
    runs.into_iter().map(row).collect()
}

fn refused(name: &str, reason: &str) -> ResultRow {
    let mut cells: Vec<Cell> = columns().iter().map(ResultColumn::missing).collect();
    cells[0] = Cell::text(name);
    if let Some(last) = cells.last_mut() {
        *last = Cell::text(reason);
    }
    ResultRow {
        cells,
        error: Some(reason.to_owned()),
        has_warnings: false,
        fitted: None,
    }
}

/// The name that a value has in the files of a diagnosis.
fn code(value: &impl Serialize) -> String {
    let value = serde_json::to_value(value).unwrap_or_default();
    value.as_str().unwrap_or_default().to_owned()
}
