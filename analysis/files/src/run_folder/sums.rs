//! The lines of [`SUMS`], as `sha256sum --check` reads them, and the files that they cover.

use std::{collections::BTreeMap, fs, io, path::Path};

use super::{ARCHIVED, SUMS};

/// The lines of a list of hashes.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Sums<'a> {
    /// SHA-256 by name of the file.
    pub files: BTreeMap<&'a str, &'a str>,
    /// Descriptions of the lines that are malformed.
    pub wrong: Vec<String>,
}

impl<'a> Sums<'a> {
    /// Reads the lines of a list.
    pub fn of(text: &'a str) -> Self {
        let mut sums = Self::default();
        for (number, line) in (1..).zip(text.split_inclusive('\n')) {
            let last = sums.files.last_key_value().map(|(last, _)| *last);
            match entry(line) {
                Some((sum, name)) if last.is_none_or(|last| last < name) => {
                    sums.files.insert(name, sum);
                }
                _ => sums.wrong.push(format!(
                    "line {number}: expected 64 digits, two blanks and a name after the last, \
                     found {line:?}"
                )),
            }
        }
        sums
    }
}

/// A whole line of the list, to the letter.
fn entry(line: &str) -> Option<(&str, &str)> {
    let (sum, name) = line.strip_suffix('\n')?.split_once("  ")?;
    let digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    (sum.len() == 64 && sum.bytes().all(digit) && !name.is_empty()).then_some((sum, name))
}

/// Returns the sorted names of the files of a run folder, without the list of hashes and the list of
/// files that were moved to an archive.
///
/// # Errors
/// A folder that cannot be read.
pub fn files_of(folder: &Path) -> io::Result<Vec<String>> {
    let mut names = Vec::new();
    collect(folder, "", &mut names)?;
    names.sort_unstable();
    Ok(names)
}

/// The lists, and the temporary file that a process may have left when it died while writing the
/// second one.
fn is_own(name: &str) -> bool {
    let partial = || name.strip_prefix('.')?.strip_suffix(".partial");
    name == SUMS || name == ARCHIVED || partial() == Some(ARCHIVED)
}

fn collect(folder: &Path, below: &str, names: &mut Vec<String>) -> io::Result<()> {
    for entry in fs::read_dir(folder.join(below))? {
        let entry = entry?;
        let own = entry.file_name().to_string_lossy().into_owned();
        let name = match below {
            "" => own,
            below => format!("{below}/{own}"),
        };
        if entry.file_type()?.is_dir() {
            collect(folder, &name, names)?;
        } else if !is_own(&name) {
            names.push(name);
        }
    }
    Ok(())
}
