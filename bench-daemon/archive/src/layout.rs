//! Layout of a store, and contents of its lists.
//!
//! ```text
//! store.json                                    format and version
//! objects/sha256/ab/<64 digits>                 bytes of a file, by its hash
//! runs/<run_sha256>.json                        the files of a run; written last
//! tables/TABLE/site=S/bench=B/date=D/<run_sha256>.parquet
//! ```

use analysis_catalog::record::CatalogRun;
use jiff::{Timestamp, tz::TimeZone};
use serde::{Deserialize, Serialize};

use crate::hash::Hashed;

/// Name of the format of a store.
pub const STORE_FORMAT: &str = "eis-bench store";
/// Version of that format.
pub const STORE_VERSION: u32 = 1;
/// Version of the columns of the tables.
pub const TABLES_VERSION: u32 = 1;
/// The file that states format and version.
pub(crate) const STORE_FILE: &str = "store.json";
/// Folder of the lists of files.
pub(crate) const RUNS: &str = "runs";
/// Name that Hive gives to the partition of an unknown value.
const UNKNOWN: &str = "__HIVE_DEFAULT_PARTITION__";

/// Head of a store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct StoreHead {
    pub(crate) format: String,
    pub(crate) version: u32,
}

impl StoreHead {
    /// Returns the format and version of this program.
    pub(crate) fn own() -> Self {
        Self {
            format: STORE_FORMAT.to_owned(),
            version: STORE_VERSION,
        }
    }
}

/// A file of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileEntry {
    /// Its path in the run folder; `analyses/…` for a diagnosis beside the folder.
    pub path: String,
    /// SHA-256 of its bytes.
    pub sha256: String,
    /// Its size.
    pub bytes: u64,
}

impl FileEntry {
    pub(crate) fn hashed(&self) -> Hashed {
        Hashed {
            sha256: self.sha256.clone(),
            bytes: self.bytes,
        }
    }
}

/// Partition of the rows of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Partition {
    /// The site.
    pub site: String,
    /// The bench.
    pub bench: String,
    /// UTC date of the start of the run.
    pub date: String,
}

impl Partition {
    /// Returns the partition of a run.
    pub(crate) fn of(site: &str, run: &CatalogRun) -> Self {
        let began = Timestamp::from_millisecond((run.started_unix_s * 1.0e3) as i64);
        let date = began
            .unwrap_or(Timestamp::UNIX_EPOCH)
            .to_zoned(TimeZone::UTC)
            .date();
        Self {
            site: site.to_owned(),
            bench: run.bench.clone(),
            date: date.to_string(),
        }
    }
}

/// Rows of a run in a partition.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Placed {
    /// The run.
    pub run_sha256: String,
    /// Location of its rows.
    #[serde(flatten)]
    pub partition: Partition,
}

impl Placed {
    /// Returns the path of its rows in a table.
    pub(crate) fn table(&self, name: &str) -> String {
        let Partition { site, bench, date } = &self.partition;
        let [site, bench] = [site, bench].map(|value| encoded(value));
        let run = &self.run_sha256;
        format!("tables/{name}/site={site}/bench={bench}/date={date}/{run}.parquet")
    }
}

/// Files of a run in a store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunList {
    /// [`STORE_FORMAT`].
    pub format: String,
    /// [`STORE_VERSION`].
    pub version: u32,
    /// The run, and the location of its rows.
    #[serde(flatten)]
    pub placed: Placed,
    /// Name of its folder.
    pub name: String,
    /// Previous identity of the run, if it has changed.
    pub supersedes: Option<String>,
    /// Its files, by path.
    pub files: Vec<FileEntry>,
}

impl RunList {
    /// Returns the path of the list of a run.
    pub(crate) fn path(run_sha256: &str) -> String {
        format!("{RUNS}/{run_sha256}.json")
    }

    /// Returns the size of all files.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.bytes).sum()
    }
}

/// Returns the path of the bytes of a file.
pub(crate) fn object(sha256: &str) -> String {
    let first = sha256.get(..2).unwrap_or_default();
    format!("objects/sha256/{first}/{sha256}")
}

/// Returns the SHA-256 of a run: that of the sorted lines of its files, each of hash, two blanks
/// and path.
pub fn run_sha256(files: &[FileEntry]) -> String {
    let line = |file: &FileEntry| format!("{}  {}\n", file.sha256, file.path);
    let mut lines: Vec<String> = files.iter().map(line).collect();
    lines.sort_unstable();
    Hashed::of(lines.concat().as_bytes()).sha256
}

/// Returns whether a text is a SHA-256 in the form that this program writes.
pub fn is_sha256(text: &str) -> bool {
    text.len() == 64
        && text
            .bytes()
            .all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
}

/// Encodes a value as Hive does in the name of a folder.
fn encoded(value: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    let one = |byte: u8| match plain(byte) {
        true => char::from(byte).to_string(),
        false => format!("%{byte:02X}"),
    };
    match value {
        "" => UNKNOWN.to_owned(),
        value => value.bytes().map(one).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_partitions_are_written_as_hive_writes_them() {
        assert_eq!(
            ["north", "hall 3/b", "Süd", ""].map(encoded),
            ["north", "hall%203%2Fb", "S%C3%BCd", UNKNOWN]
        );
    }

    #[test]
    fn the_hash_of_a_run_is_that_of_its_sorted_lines() {
        let file = |path: &str, sha256: &str| FileEntry {
            path: path.to_owned(),
            sha256: sha256.to_owned(),
            bytes: 1,
        };
        let (one, other) = (file("a", "22"), file("b", "11"));
        let lines = Hashed::of(b"11  b\n22  a\n").sha256;
        assert_eq!(run_sha256(&[one.clone(), other.clone()]), lines);
        assert_eq!(run_sha256(&[other, one]), lines);
    }
}
