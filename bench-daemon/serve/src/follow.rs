//! Follows a growing file: returns the complete lines that were added since the last read.

use std::{
    fs::File,
    io::{self, Read, Seek, SeekFrom},
    os::unix::fs::MetadataExt,
    path::PathBuf,
};

/// Maximum number of bytes in one read.
const AT_ONCE: u64 = 4 * 1024 * 1024;

/// A file and how far it was read.
#[derive(Debug)]
pub struct Follow {
    path: PathBuf,
    inode: u64,
    at: u64,
}

/// Result of one read of a file.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct FileGrowth {
    /// Whole lines that are new.
    pub lines: Vec<String>,
    /// The file was replaced or truncated: earlier content is no longer valid.
    pub anew: bool,
}

impl Follow {
    /// From the beginning of a file that may not be there yet.
    pub fn new(path: PathBuf) -> Self {
        Self {
            path,
            inode: 0,
            at: 0,
        }
    }

    /// Reads the new lines.
    ///
    /// # Errors
    /// The system's. A file that does not exist has no new lines.
    pub fn look(&mut self) -> io::Result<FileGrowth> {
        let mut file = match File::open(&self.path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Ok(FileGrowth::default());
            }
            Err(error) => return Err(error),
        };
        let meta = file.metadata()?;
        let anew = self.inode != 0 && (meta.ino() != self.inode || meta.len() < self.at);
        if anew {
            self.at = 0;
        }
        self.inode = meta.ino();
        if meta.len() == self.at {
            return Ok(FileGrowth {
                anew,
                ..FileGrowth::default()
            });
        }
        file.seek(SeekFrom::Start(self.at))?;
        let mut bytes = Vec::new();
        file.take(AT_ONCE).read_to_end(&mut bytes)?;
        let whole = bytes
            .iter()
            .rposition(|byte| *byte == b'\n')
            .map_or(0, |at| at + 1);
        self.at += whole as u64;
        let lines = String::from_utf8_lossy(&bytes[..whole])
            .lines()
            .map(str::to_owned)
            .collect();
        Ok(FileGrowth { lines, anew })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_whole_lines_count_and_a_file_that_is_another_one_is_read_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f");
        let mut follow = Follow::new(path.clone());
        assert_eq!(follow.look().unwrap(), FileGrowth::default());
        for (text, lines, anew) in [
            ("a\nb", vec!["a"], false),
            ("a\nbc\nd\n", vec!["bc", "d"], false),
            ("a\nbc\nd\n", vec![], false),
            ("x\n", vec!["x"], true),
        ] {
            std::fs::write(&path, text).unwrap();
            let grown = follow.look().unwrap();
            assert_eq!(
                (grown.lines, grown.anew),
                (lines.into_iter().map(str::to_owned).collect(), anew),
                "{text:?}"
            );
        }
        std::fs::write(folder.path().join("g"), "x\ny\n").unwrap();
        std::fs::rename(folder.path().join("g"), &path).unwrap();
        assert_eq!(
            follow.look().unwrap(),
            FileGrowth {
                lines: vec!["x".to_owned(), "y".to_owned()],
                anew: true
            }
        );
    }
}
