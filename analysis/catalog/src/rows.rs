//! Rows of one run folder for the tables of an archive, without a catalogue.

use std::{
    collections::BTreeMap,
    ffi::OsStr,
    path::{Path, PathBuf},
};

use analysis_files::{
    batch::{Cells, TableColumn},
    dataset::read_spectrum_csv,
};

use crate::{
    export::{Points, diagnosis_columns, fit_columns, point_columns, run_columns},
    folder::{self, Beside, CELL},
    record::{CatalogCell, CatalogDiagnosis, CatalogRun, CatalogVerdict, Folder},
    scan::read_diagnosis,
    walk::{Place, Walk},
};

pub use crate::walk::diagnoses_within;

/// Columns that describe a machine or are part of a partition's path.
const LEFT_OUT: [&str; 3] = ["bench", "folder", "missing"];

/// Rows of a run folder.
#[derive(Debug)]
pub struct RunRows {
    folder: Folder,
    points: Vec<Points>,
    diagnoses: Vec<CatalogDiagnosis>,
}

/// A table of the rows of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunTable {
    /// Its name.
    pub name: &'static str,
    /// Its columns.
    pub columns: Vec<TableColumn>,
}

/// A folder of a diagnosis beside the run that it is of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DiagnosisFolder {
    /// Its path relative to the searched folder.
    pub name: String,
    /// The folder.
    pub folder: PathBuf,
}

/// Names of the tables of a run.
pub const TABLES: [&str; 4] = ["runs", "spectra", "fits", "diagnoses"];

impl RunRows {
    /// Reads a run folder with the diagnoses in it, and folders of diagnoses beside it. Read errors
    /// are reported in the row of the run.
    pub fn read(folder: &Path, beside: Beside, diagnoses: &[DiagnosisFolder]) -> Self {
        let read = folder::read(folder, String::new(), beside);
        let of_cell = read
            .spectra
            .iter()
            .filter(|one| one.fixture == CELL && one.corrected);
        let points = of_cell.filter_map(|spectrum| {
            let points = read_spectrum_csv(&folder.join(&spectrum.file)).ok()?;
            Some(Points {
                spectrum: spectrum.clone(),
                points,
            })
        });
        let own = diagnoses_within(folder).into_iter().map(|own| {
            let name = own.strip_prefix(folder).unwrap_or(&own);
            DiagnosisFolder {
                name: name.to_string_lossy().into_owned(),
                folder: own,
            }
        });
        let all = own.chain(diagnoses.iter().cloned());
        let diagnoses = all.map(|one| CatalogDiagnosis {
            cell: cell_of(&one.folder, &read.run),
            ..read_diagnosis(&one.folder, &one.name)
        });
        Self {
            points: points.collect(),
            diagnoses: diagnoses.collect(),
            folder: read,
        }
    }

    /// Returns the run.
    pub fn run(&self) -> &CatalogRun {
        &self.folder.run
    }

    /// Returns whether the run has ended without further work.
    pub fn is_finished(&self) -> bool {
        use CatalogVerdict::{Damaged, Doubtful, Failed, Good, Stopped, Unfinished};
        match self.folder.run.verdict {
            Good | Doubtful => true,
            Damaged => self.folder.run.how.as_deref() == Some(crate::journal::FINISHED),
            Stopped | Failed | Unfinished => false,
        }
    }

    /// Returns the tables that have rows, with an identity of the run that is the same on every
    /// machine.
    pub fn tables(mut self, identity: &str) -> Vec<RunTable> {
        identity.clone_into(&mut self.folder.run.run);
        for fit in &mut self.folder.fits {
            identity.clone_into(&mut fit.run);
        }
        for one in &mut self.points {
            identity.clone_into(&mut one.spectrum.run);
        }
        for one in &mut self.diagnoses {
            one.run = Some(identity.to_owned());
        }
        let columns = [
            run_columns(std::slice::from_ref(&self.folder.run)),
            point_columns(&self.points),
            fit_columns(&self.folder.fits),
            diagnosis_columns(&self.diagnoses),
        ];
        let tables = TABLES.into_iter().zip(columns);
        tables
            .map(|(name, columns)| RunTable {
                name,
                columns: portable(columns),
            })
            .filter(|table| table.rows() > 0)
            .collect()
    }
}

/// Returns the cell of a run that a diagnosis is of: the one that its folder is called after, or
/// the only one.
fn cell_of(diagnosis: &Path, run: &CatalogRun) -> Option<String> {
    let called = |cell: &&CatalogCell| diagnosis.file_name() == Some(OsStr::new(&cell.name));
    let only = match run.cells.as_slice() {
        [one] => Some(one),
        _ => None,
    };
    let cell = run.cells.iter().find(called).or(only);
    cell.map(|cell| cell.name.clone())
}

impl RunTable {
    /// Returns the number of its rows.
    pub fn rows(&self) -> usize {
        self.columns
            .first()
            .map_or(0, |column| match &column.cells {
                Cells::Numbers(cells) => cells.len(),
                Cells::Counts(cells) => cells.len(),
                Cells::Texts(cells) => cells.len(),
            })
    }
}

fn portable(mut columns: Vec<TableColumn>) -> Vec<TableColumn> {
    columns.retain(|column| !LEFT_OUT.contains(&column.name));
    columns
}

/// Returns the folders of diagnoses below a folder, by the folder of the run that each belongs to.
/// Diagnoses without an identified run are left out.
pub fn diagnoses_below(root: &Path) -> BTreeMap<PathBuf, Vec<DiagnosisFolder>> {
    let mut found: BTreeMap<PathBuf, Vec<DiagnosisFolder>> = BTreeMap::new();
    for place in Walk::of(&[root.to_path_buf()]) {
        let Place::Diagnosis(folder) = place else {
            continue;
        };
        if let Some(run) = crate::scan::run_folder_of_diagnosis(&folder) {
            let name = folder.strip_prefix(root).unwrap_or(&folder);
            let name = name.to_string_lossy().into_owned();
            let of_run = found.entry(run).or_default();
            of_run.push(DiagnosisFolder { name, folder });
        }
    }
    let sort = |all: &mut Vec<DiagnosisFolder>| all.sort_by(|a, b| a.name.cmp(&b.name));
    found.values_mut().for_each(sort);
    found
}
