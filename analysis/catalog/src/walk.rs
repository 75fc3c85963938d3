//! Finds run folders and diagnoses below a folder.

use std::{
    fs,
    path::{Path, PathBuf},
};

use analysis_files::run_folder::DIAGNOSIS;

use crate::folder::is_run;

/// Folder of a diagnosis in a run folder, as its user may choose to name it.
const DIAGNOSIS_FOLDER: &str = "diagnosis";

/// A place that a scan reads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Place {
    /// The folder of a run.
    Run(PathBuf),
    /// The folder of a diagnosis.
    Diagnosis(PathBuf),
    /// A folder that cannot be looked into, with the reason.
    Unreadable(String),
}

/// Returns the folders of the diagnoses in a run folder, in order: its own, and those of its cells
/// if it has several.
pub fn diagnoses_within(run: &Path) -> Vec<PathBuf> {
    let own = run.join(DIAGNOSIS_FOLDER);
    let entries = fs::read_dir(&own).into_iter().flatten().flatten();
    let mut of_cells: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    of_cells.sort();
    let all = [own].into_iter().chain(of_cells);
    all.filter(|folder| is_diagnosed(folder)).collect()
}

fn is_diagnosed(folder: &Path) -> bool {
    folder.join(DIAGNOSIS).is_file()
}

/// All places below folders, one after another. Links are not followed, and a run folder is not
/// looked into beyond its own diagnoses.
#[derive(Debug)]
pub(crate) struct Walk {
    open: Vec<PathBuf>,
    ready: Vec<Place>,
}

impl Walk {
    /// Begins at folders.
    pub(crate) fn of(roots: &[PathBuf]) -> Self {
        Self {
            open: roots.to_vec(),
            ready: Vec::new(),
        }
    }

    fn look(&mut self, folder: PathBuf) {
        if is_diagnosed(&folder) {
            self.ready.push(Place::Diagnosis(folder.clone()));
        }
        if !is_run(&folder) {
            self.enter(&folder);
            return;
        }
        let own = diagnoses_within(&folder).into_iter();
        self.ready.extend(own.map(Place::Diagnosis));
        self.ready.push(Place::Run(folder));
    }

    fn enter(&mut self, folder: &Path) {
        let entries = match fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(error) => {
                let reason = format!("{}: {error}", folder.display());
                self.ready.push(Place::Unreadable(reason));
                return;
            }
        };
        let inner = entries.flatten().filter(|entry| {
            let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
            !hidden && entry.file_type().is_ok_and(|kind| kind.is_dir())
        });
        self.open.extend(inner.map(|entry| entry.path()));
    }
}

impl Iterator for Walk {
    type Item = Place;

    fn next(&mut self) -> Option<Place> {
        loop {
            if let Some(place) = self.ready.pop() {
                return Some(place);
            }
            let folder = self.open.pop()?;
            self.look(folder);
        }
    }
}
