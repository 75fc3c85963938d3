//! Notes and tags that users attach to runs and cells. They lie beside the run folders, whose
//! files never change. Each run or cell has one file, to which entries are appended line by line.

use std::{
    collections::BTreeSet,
    fs::OpenOptions,
    io::Write,
    os::unix::fs::{FileExt, OpenOptionsExt},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

use instruments::clock;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use bench_plan::support::hash;

/// Longest note, characters.
pub const LONGEST_NOTE: usize = 4000;
/// Longest tag, characters.
pub const LONGEST_TAG: usize = 40;
/// Most tags of a run.
pub const MOST_TAGS: usize = 20;

/// Subject of a note.
#[derive(Debug, Clone, Copy)]
pub enum About<'a> {
    /// A run.
    Run(&'a str),
    /// A cell.
    Cell(&'a str),
    /// A bench.
    Bench(&'a str),
}

/// A note.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Note {
    /// Time, s since 1970.
    pub unix_s: f64,
    /// Name of the token; `local` if none is required.
    pub by: String,
    /// The text.
    pub text: String,
}

/// A line of a file: a note, or all tags from then on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Line {
    unix_s: f64,
    by: String,
    /// Name of the run or cell, for readers of the file.
    about: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    text: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tags: Option<Vec<String>>,
}

/// Notes and tags of one subject.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Entries {
    /// Notes, the latest last.
    pub notes: Vec<Note>,
    /// Tags.
    pub tags: Vec<String>,
}

/// The notes and tags of a server.
#[derive(Debug)]
pub struct Notebook {
    folder: PathBuf,
    /// Runs that something was written about. One entry is written at a time.
    runs: Mutex<BTreeSet<String>>,
}

impl Notebook {
    /// Opens the notebook of a data folder.
    pub fn of(data: &Path) -> Self {
        let folder = data.join("notes");
        let files = std::fs::read_dir(folder.join("runs"));
        let names = files.into_iter().flatten().flatten().filter_map(|file| {
            let name = file.file_name().into_string().ok()?;
            Some(name.strip_suffix(".jsonl")?.to_owned())
        });
        Self {
            runs: Mutex::new(names.collect()),
            folder,
        }
    }

    /// A cell name may contain any character; a file name may not.
    fn path(&self, about: About<'_>) -> PathBuf {
        match about {
            About::Run(run) => self.folder.join("runs").join(format!("{run}.jsonl")),
            About::Bench(bench) => self.folder.join("benches").join(format!("{bench}.jsonl")),
            About::Cell(cell) => {
                let name = &hash::sha256(cell)[..24];
                self.folder.join("cells").join(format!("{name}.jsonl"))
            }
        }
    }

    /// All that was written about a run or a cell.
    pub fn read(&self, about: About<'_>) -> Entries {
        if matches!(about, About::Run(run) if !self.runs().contains(run)) {
            return Entries::default();
        }
        let bytes = std::fs::read(self.path(about)).unwrap_or_default();
        let text = String::from_utf8_lossy(&bytes);
        let mut entries = Entries::default();
        let lines = text
            .lines()
            .filter_map(|line| serde_json::from_str(line).ok());
        for Line {
            unix_s,
            by,
            text,
            tags,
            ..
        } in lines
        {
            if let Some(text) = text {
                entries.notes.push(Note { unix_s, by, text });
            }
            if let Some(tags) = tags {
                entries.tags = tags;
            }
        }
        entries
    }

    /// Adds a note.
    ///
    /// # Errors
    /// The system's.
    pub fn note(&self, about: About<'_>, by: &str, text: &str) -> std::io::Result<Note> {
        let note = Note {
            unix_s: clock::unix_time_s(),
            by: by.to_owned(),
            text: text.to_owned(),
        };
        self.append(about, &note, Some(text.to_owned()), None)?;
        Ok(note)
    }

    /// Replaces all tags with these.
    ///
    /// # Errors
    /// The system's.
    pub fn tag(&self, about: About<'_>, by: &str, tags: &[String]) -> std::io::Result<()> {
        let note = Note {
            unix_s: clock::unix_time_s(),
            by: by.to_owned(),
            text: String::new(),
        };
        self.append(about, &note, None, Some(tags.to_vec()))
    }

    fn runs(&self) -> MutexGuard<'_, BTreeSet<String>> {
        self.runs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn append(
        &self,
        about: About<'_>,
        note: &Note,
        text: Option<String>,
        tags: Option<Vec<String>>,
    ) -> std::io::Result<()> {
        let (About::Run(name) | About::Cell(name) | About::Bench(name)) = about;
        let line = Line {
            unix_s: note.unix_s,
            by: note.by.clone(),
            about: name.to_owned(),
            text,
            tags,
        };
        let path = self.path(about);
        let mut runs = self.runs();
        if let About::Run(run) = about {
            runs.insert(run.to_owned());
        }
        std::fs::create_dir_all(path.parent().unwrap_or(&self.folder))?;
        let mut file = OpenOptions::new()
            .create(true)
            .read(true)
            .append(true)
            .mode(0o640)
            .open(&path)?;
        let before = file.metadata()?.len();
        let mut text = format!("{}\n", serde_json::to_string(&line)?);
        // A line that a full disk has torn does not take the next one with it.
        if before > 0 {
            let mut last = [0];
            file.read_exact_at(&mut last, before - 1)?;
            if last != *b"\n" {
                text.insert(0, '\n');
            }
        }
        if let Err(error) = file.write_all(text.as_bytes()) {
            file.set_len(before)?;
            return Err(error);
        }
        file.sync_data()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_are_kept_in_order_and_the_last_tags_hold() {
        let folder = tempfile::tempdir().unwrap();
        let book = Notebook::of(folder.path());
        let cell = About::Cell("Zelle Ä/1 ../x");
        assert_eq!(book.read(cell), Entries::default());
        book.note(cell, "ann", "swollen").unwrap();
        book.note(cell, "ben", "line 1\nline 2").unwrap();
        book.tag(cell, "ann", &["a".to_owned(), "b".to_owned()])
            .unwrap();
        book.tag(cell, "ann", &["b".to_owned()]).unwrap();
        let entries = Notebook::of(folder.path()).read(cell);
        let texts: Vec<&str> = entries
            .notes
            .iter()
            .map(|note| note.text.as_str())
            .collect();
        assert_eq!(texts, ["swollen", "line 1\nline 2"]);
        assert_eq!(entries.notes[1].by, "ben");
        assert_eq!(entries.tags, ["b"]);
        // Only the torn line is lost.
        let path = book.path(cell);
        let torn = [
            std::fs::read(&path).unwrap(),
            b"{\"unix_s\": 1, \xff".to_vec(),
        ]
        .concat();
        std::fs::write(&path, torn).unwrap();
        book.note(cell, "ann", "after it").unwrap();
        assert_eq!(book.read(cell).notes.len(), 3);
        // Nothing was written outside the folder of the notes.
        let names = |path: &Path| std::fs::read_dir(path).unwrap().count();
        assert_eq!(
            (names(folder.path()), names(&folder.path().join("notes"))),
            (1, 1)
        );
    }
}
