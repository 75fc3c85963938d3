//! Opens files below a folder and nowhere else, for names that come from a peer. Dots, links and
//! races cannot lead out of the folder.

use std::{
    fs::File,
    io::{self, Read, Seek, SeekFrom},
    os::{fd::AsRawFd, unix::fs::OpenOptionsExt},
    path::{Component, Path, PathBuf},
};

/// End of a log that is read, bytes.
const TAIL_BYTES: u64 = 64 * 1024;

/// Opens a regular file below a folder for reading; returns `None` for anything else.
///
/// The path is split first, and the location of the opened file is checked afterwards, so that a
/// link that is created between the two checks opens nothing.
pub fn open(root: &Path, name: &str) -> Option<File> {
    let path = Path::new(name);
    let plain = path
        .components()
        .all(|part| matches!(part, Component::Normal(_)))
        && path.components().next().is_some();
    if !plain || name.contains('\0') || name.len() > 1024 {
        return None;
    }
    let root = root.canonicalize().ok()?;
    // Without O_NONBLOCK, opening a named pipe would block.
    let file = File::options()
        .read(true)
        .custom_flags(nix::libc::O_NONBLOCK | nix::libc::O_NOCTTY)
        .open(root.join(path))
        .ok()?;
    let lies = std::fs::read_link(format!("/proc/self/fd/{}", file.as_raw_fd())).ok()?;
    (file.metadata().ok()?.is_file() && lies.starts_with(&root)).then_some(file)
}

/// Returns the end of a text file below a folder, or an empty text if it cannot be read.
pub fn tail(root: &Path, name: &str) -> String {
    let read = || {
        let mut file = open(root, name)?;
        let length = file.metadata().ok()?.len();
        let start = SeekFrom::Start(length.saturating_sub(TAIL_BYTES));
        file.seek(start).ok()?;
        let mut bytes = Vec::new();
        file.take(TAIL_BYTES).read_to_end(&mut bytes).ok()?;
        Some(String::from_utf8_lossy(&bytes).into_owned())
    };
    read().unwrap_or_default()
}

/// Returns the folder of this name directly below another; `None` if there is none, or if it is a
/// link.
pub fn folder(root: &Path, name: &str) -> Option<PathBuf> {
    if !plain(name) {
        return None;
    }
    let path = root.join(name);
    std::fs::symlink_metadata(&path)
        .ok()
        .filter(|meta| meta.is_dir())
        .map(|_| path)
}

/// Regular files below a folder with their lengths, relative to it, sorted; links are passed over,
/// and so is what lies deeper than three folders.
pub fn list(root: &Path) -> io::Result<Vec<(String, u64)>> {
    let mut found = Vec::new();
    walk(root, "", 0, &mut found)?;
    found.sort();
    Ok(found)
}

fn walk(
    folder: &Path,
    below: &str,
    depth: usize,
    found: &mut Vec<(String, u64)>,
) -> io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let Ok(name) = entry.file_name().into_string() else {
            continue;
        };
        let (kind, path) = (entry.file_type()?, format!("{below}{name}"));
        if kind.is_dir() && depth < 3 {
            walk(&entry.path(), &format!("{path}/"), depth + 1, found)?;
        } else if kind.is_file() && !name.starts_with('.') {
            // A file may be gone by now.
            found.push((path, entry.metadata().map_or(0, |meta| meta.len())));
        }
    }
    Ok(())
}

/// Longest plain name, letters: a run of a fleet has the names of its experiment (60) and its job (43)
/// and the number of its turn.
const LONGEST_NAME: usize = 120;

/// A name that can be a part of a path without being anything else.
pub fn plain(name: &str) -> bool {
    (1..=LONGEST_NAME).contains(&name.len())
        && name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_outside_the_folder_is_opened() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("root");
        std::fs::create_dir_all(root.join("sub")).unwrap();
        for name in ["root/in", "root/sub/in", "out"] {
            std::fs::write(folder.path().join(name), "x").unwrap();
        }
        let link = |to: &str, name: &str| std::os::unix::fs::symlink(to, root.join(name)).unwrap();
        link("../out", "link");
        link("..", "up");
        link("in", "alias");
        nix::unistd::mkfifo(&root.join("pipe"), nix::sys::stat::Mode::S_IRUSR).unwrap();
        for name in ["in", "sub/in", "alias"] {
            assert!(open(&root, name).is_some(), "{name}");
        }
        for name in [
            "",
            ".",
            "..",
            "../out",
            "sub/../../out",
            "link",
            "up/out",
            "sub",
            "pipe",
            "none",
            "in\0",
            "/etc/hostname",
            "./in",
        ] {
            assert!(open(&root, name).is_none() || name == "./in", "{name}");
        }
        assert_eq!(
            list(&root).unwrap(),
            [("in".to_owned(), 1), ("sub/in".to_owned(), 1)]
        );
        assert!(super::folder(&root, "sub").is_some());
        for name in ["up", "in", "..", "", "none", "sub/in"] {
            assert!(super::folder(&root, name).is_none(), "{name}");
        }
    }
}
