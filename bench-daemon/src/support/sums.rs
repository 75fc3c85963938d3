//! The hashes of a finished run: `SHA256SUMS`, one line for every other file of the folder, as
//! `sha256sum --check` reads it.
//!
//! They find what was altered by accident, the list itself included; whoever means harm can write
//! another list.

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
};

use analysis::{
    dataset::{self, DatasetError},
    run_folder::SUMS,
};
use rayon::prelude::*;

use crate::support::hash;

/// Hashes that cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum SumsError {
    /// The file system.
    #[error("{path}: cannot be read: {source}", path = path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The list itself.
    #[error(transparent)]
    Write(#[from] DatasetError),
}

/// Something that is not what it was when the run ended.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Altered {
    /// The file, relative to the folder.
    pub file: String,
    /// Difference of the file, in words.
    pub what: String,
}

/// Writes the hashes of all files of a folder.
///
/// # Errors
/// [`SumsError`].
pub fn write(folder: &Path) -> Result<(), SumsError> {
    let names = files(folder)?;
    let lines: Vec<String> = names
        .par_iter()
        .map(|name| Ok(format!("{}  {name}\n", sum(folder, name)?)))
        .collect::<Result<_, SumsError>>()?;
    Ok(dataset::write_atomically(
        &folder.join(SUMS),
        lines.concat().as_bytes(),
    )?)
}

/// Compares all files of a folder with their hashes; also says how many there are.
///
/// # Errors
/// [`SumsError`]; files that are missing are altered ones.
pub fn check(folder: &Path) -> Result<(usize, Vec<Altered>), SumsError> {
    let path = folder.join(SUMS);
    let bytes = fs::read(&path).map_err(|source| SumsError::Read { path, source })?;
    let altered = |file: &str, what: String| Altered {
        file: file.to_owned(),
        what,
    };
    let (mut stored, mut found) = (BTreeMap::new(), Vec::new());
    let text = String::from_utf8_lossy(&bytes);
    for (number, line) in (1..).zip(text.split_inclusive('\n')) {
        match entry(line) {
            Some((sum, name)) if stored.last_key_value().is_none_or(|(last, _)| *last < name) => {
                stored.insert(name, sum);
            }
            _ => found.push(altered(
                SUMS,
                format!(
                    "line {number}: expected 64 digits, two blanks and a \
                name after the last, found {line:?}"
                ),
            )),
        }
    }
    let names = files(folder)?;
    let wrong = |name: &String| -> Result<Option<Altered>, SumsError> {
        let Some(expected) = stored.get(name.as_str()) else {
            return Ok(Some(altered(name, format!("not in {SUMS}"))));
        };
        let met = sum(folder, name)?;
        Ok((met != *expected).then(|| {
            altered(
                name,
                format!("expected the SHA-256 {expected}, found {met}"),
            )
        }))
    };
    let wrong: Vec<Option<Altered>> = names.par_iter().map(wrong).collect::<Result<_, _>>()?;
    found.extend(wrong.into_iter().flatten());
    let there: std::collections::BTreeSet<&str> = names.iter().map(String::as_str).collect();
    found.extend(
        stored
            .keys()
            .filter(|name| !there.contains(**name))
            .map(|name| altered(name, "missing".to_owned())),
    );
    Ok((names.len(), found))
}

fn sum(folder: &Path, name: &str) -> Result<String, SumsError> {
    let path = folder.join(name);
    hash::sha256_of(&path).map_err(|source| SumsError::Read { path, source })
}

/// A whole line of the list, to the letter.
fn entry(line: &str) -> Option<(&str, &str)> {
    let (sum, name) = line.strip_suffix('\n')?.split_once("  ")?;
    let digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    (sum.len() == 64 && sum.bytes().all(digit) && !name.is_empty()).then_some((sum, name))
}

/// All files of a folder but the list, by name.
fn files(folder: &Path) -> Result<Vec<String>, SumsError> {
    let mut names = Vec::new();
    collect(folder, "", &mut names)?;
    names.sort_unstable();
    Ok(names)
}

fn collect(folder: &Path, below: &str, names: &mut Vec<String>) -> Result<(), SumsError> {
    let path = folder.join(below);
    let read = |source| SumsError::Read {
        path: path.clone(),
        source,
    };
    for entry in fs::read_dir(&path).map_err(read)? {
        let entry = entry.map_err(read)?;
        let own = entry.file_name().to_string_lossy().into_owned();
        let name = if below.is_empty() {
            own
        } else {
            format!("{below}/{own}")
        };
        if entry.file_type().map_err(read)?.is_dir() {
            collect(folder, &name, names)?;
        } else if name != SUMS {
            names.push(name);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_altered_is_named() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("b")).unwrap();
        for name in ["a.csv", "b/c", "d"] {
            fs::write(folder.path().join(name), name).unwrap();
        }
        write(folder.path()).unwrap();
        assert_eq!(check(folder.path()).unwrap(), (3, Vec::new()));
        fs::write(folder.path().join("b/c"), "b/d").unwrap();
        fs::rename(folder.path().join("d"), folder.path().join("e")).unwrap();
        let (_, found) = check(folder.path()).unwrap();
        let messages: Vec<String> = found
            .iter()
            .map(|one| format!("{}: {}", one.file, one.what))
            .collect();
        assert!(
            messages[0].starts_with("b/c: expected the SHA-256 ")
                && messages[0].contains(", found "),
            "{messages:?}"
        );
        assert_eq!(messages[1..], ["e: not in SHA256SUMS", "d: missing"]);
    }

    #[test]
    fn no_bit_of_the_list_can_be_flipped() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a", "f"] {
            fs::write(folder.path().join(name), name).unwrap();
        }
        write(folder.path()).unwrap();
        let list = folder.path().join(SUMS);
        let bytes = fs::read(&list).unwrap();
        for bit in 0..8 * bytes.len() {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            fs::write(&list, flipped).unwrap();
            assert!(!check(folder.path()).unwrap().1.is_empty(), "bit {bit}");
        }
    }
}
