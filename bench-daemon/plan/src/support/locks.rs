//! Finds the holder of a lock without touching it: an attempt to take it could hinder the run that
//! wants it.

use std::{os::unix::fs::MetadataExt, path::Path};

/// Returns the process that holds an exclusive lock (flock) on a file, from the system's list of
/// locks, or `None` if the file is not locked.
pub fn holder(path: &Path) -> Option<i32> {
    let inode = std::fs::metadata(path).ok()?.ino();
    holder_in(&std::fs::read_to_string("/proc/locks").ok()?, inode)
}

/// Lines are `1: FLOCK ADVISORY WRITE 22707 fe:00:10412823 0 EOF`; a waiting process has `->`
/// after the number.
fn holder_in(locks: &str, inode: u64) -> Option<i32> {
    locks.lines().find_map(|line| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [_, "FLOCK", _, "WRITE", pid, file, ..] = words.as_slice() else {
            return None;
        };
        (file.rsplit(':').next()?.parse() == Ok(inode))
            .then(|| pid.parse().ok())
            .flatten()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_holds_a_lock_is_found_and_who_waits_is_not() {
        let text = "1: POSIX  ADVISORY  WRITE 5 fe:00:7 0 EOF\n\
        2: -> FLOCK  ADVISORY  WRITE 6 fe:00:7 0 EOF\n3: FLOCK  ADVISORY  WRITE 8 fe:00:7 0 EOF\n";
        assert_eq!(
            (holder_in(text, 7), holder_in(text, 9), holder_in("", 7)),
            (Some(8), None, None)
        );
        let file = tempfile::NamedTempFile::new().unwrap();
        assert_eq!(holder(file.path()), None);
        file.as_file().lock().unwrap();
        assert_eq!(holder(file.path()), i32::try_from(std::process::id()).ok());
    }
}
