//! Writes bytes to disk so that a crash at any moment leaves either the old file or the new one.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use super::DatasetError;

/// Writes a whole file: into a hidden file beside it, synced, then renamed over it. A reader sees
/// either the old file or the new one.
///
/// # Errors
/// [`DatasetError::Io`]; the hidden file is then removed.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), DatasetError> {
    let temporary = temporary_path(path)?;
    replace(path, &temporary, File::create(&temporary), bytes)
}

/// Does the same with a file that has at most this mode from its creation, independent of the umask
/// of the process: it is never readable or writable for more accounts than the mode allows.
///
/// # Errors
/// As [`write_atomically`].
pub fn write_private(path: &Path, bytes: &[u8], mode: u32) -> Result<(), DatasetError> {
    let temporary = temporary_path(path)?;
    // A file left by a crash would keep its mode.
    let _ = fs::remove_file(&temporary);
    let made = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(mode)
        .open(&temporary);
    replace(path, &temporary, made, bytes)
}

fn replace(
    path: &Path,
    temporary: &Path,
    made: io::Result<File>,
    bytes: &[u8],
) -> Result<(), DatasetError> {
    let written = made.and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()
    });
    let result = match written {
        Ok(()) => fs::rename(temporary, path)
            .map_err(|source| io_error(path, "put the new file in place", source)),
        Err(source) => Err(io_error(temporary, "write the file", source)),
    };
    if result.is_err() {
        // Report the first failure only. Failing to remove the temporary file adds no information.
        let _ = fs::remove_file(temporary);
    }
    result?;
    sync_folder(path)
}

/// Appends lines to a text file that begins with `header`, creates it if needed, and syncs it.
/// Removes bytes after the last line end first.
pub(super) fn append_line(path: &Path, header: &str, line: &str) -> Result<(), DatasetError> {
    let failed = |action| move |source| io_error(path, action, source);
    let mut options = OpenOptions::new();
    let mut file = options
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(path)
        .map_err(failed("open the file"))?;
    let whole = whole_lines_end(&mut file).map_err(failed("read the file"))?;
    let fresh = whole == 0;
    if !fresh {
        check_header(path, &mut file, header)?;
    }
    file.set_len(whole)
        .map_err(failed("take off a torn line"))?;
    file.seek(SeekFrom::Start(whole))
        .map_err(failed("seek the end"))?;
    let text = if fresh {
        format!("{header}\n{line}\n")
    } else {
        format!("{line}\n")
    };
    file.write_all(text.as_bytes())
        .map_err(failed("append to the file"))?;
    file.sync_data().map_err(failed("sync the file"))?;
    if fresh { sync_folder(path) } else { Ok(()) }
}

pub(super) fn io_error(path: &Path, action: &'static str, source: io::Error) -> DatasetError {
    DatasetError::Io {
        path: path.to_path_buf(),
        action,
        source,
    }
}

/// Returns the length of the file up to and including its last line end.
fn whole_lines_end(file: &mut File) -> io::Result<u64> {
    const STEP: u64 = 4096;
    let mut end = file.seek(SeekFrom::End(0))?;
    while end > 0 {
        let start = end.saturating_sub(STEP);
        file.seek(SeekFrom::Start(start))?;
        let mut bytes = Vec::new();
        (&*file).take(end - start).read_to_end(&mut bytes)?;
        if let Some(at) = bytes.iter().rposition(|byte| *byte == b'\n') {
            return Ok(start + at as u64 + 1);
        }
        end = start;
    }
    Ok(0)
}

fn check_header(path: &Path, file: &mut File, header: &str) -> Result<(), DatasetError> {
    let mut bytes = Vec::new();
    let length = header.len() as u64 + 1;
    file.seek(SeekFrom::Start(0))
        .and_then(|_| (&*file).take(length).read_to_end(&mut bytes))
        .map_err(|source| io_error(path, "read the header", source))?;
    let text = String::from_utf8_lossy(&bytes);
    if text.strip_suffix('\n') == Some(header) {
        return Ok(());
    }
    let found = text.lines().next().unwrap_or("").to_owned();
    Err(DatasetError::Header {
        path: path.to_path_buf(),
        expected: header.to_owned(),
        found,
    })
}

fn temporary_path(path: &Path) -> Result<PathBuf, DatasetError> {
    let name = path.file_name().ok_or_else(|| {
        let source = io::Error::new(io::ErrorKind::InvalidInput, "the path ends in no file name");
        io_error(path, "write the file", source)
    })?;
    let mut hidden = std::ffi::OsString::from(".");
    hidden.push(name);
    hidden.push(".partial");
    Ok(path.with_file_name(hidden))
}

/// Syncs the directory, so that the name of a file is as durable as its bytes.
fn sync_folder(path: &Path) -> Result<(), DatasetError> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    File::open(folder)
        .and_then(|file| file.sync_all())
        .map_err(|source| io_error(folder, "sync the folder", source))
}
