//! Who did what, and when: one line of JSON each, appended and synced before the answer goes out. Each line carries a checksum over itself and the line
//! before, so that a line that was taken out or altered shows.

use std::{
    fs::{File, OpenOptions},
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use instruments::clock;
use serde::{Deserialize, Serialize};

use crate::journal::checksum;

const FILE: &str = "audit.jsonl";

/// One deed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Deed {
    /// When, s since 1970.
    pub unix_s: f64,
    /// Name of the token; `local` where none is asked for, `-` where none was shown.
    pub who: String,
    /// Address of the peer.
    pub from: String,
    /// What was asked for: method and path.
    pub what: String,
    /// How it was answered: the status, and for a refusal its code.
    pub outcome: String,
    /// Checksum over the line before and this one.
    #[serde(default)]
    pub chain: String,
}

/// The audit trail of a data folder.
#[derive(Debug)]
pub struct Audit {
    path: PathBuf,
    open: Mutex<(File, String)>,
}

impl Audit {
    /// Goes on with the trail of a data folder.
    ///
    /// # Errors
    /// The system's; a trail that was altered is told and gone on with.
    pub fn open(data: &Path) -> std::io::Result<Self> {
        let path = data.join(FILE);
        let file = OpenOptions::new().create(true).append(true).open(&path)?;
        let last = match check(&path)? {
            Ok(last) => last,
            Err((line, last)) => {
                tracing::warn!("{}:{line}: this line of the audit trail is not as it was written", path.display());
                last
            }
        };
        Ok(Self { path, open: Mutex::new((file, last)) })
    }

    /// Writes a deed down; it is on disk when this returns.
    ///
    /// # Errors
    /// The system's.
    pub fn write(&self, (who, from): (&str, &str), what: &str, outcome: &str) -> std::io::Result<()> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let text = |text: &str| text.chars().take(300).collect::<String>();
        let unix_s = (clock::unix_time_s() * 1.0e3).round() / 1.0e3;
        let mut deed = Deed { unix_s, who: text(who), from: text(from), what: text(what), outcome: text(outcome), chain: String::new() };
        deed.chain = chain(&open.1, &deed);
        let line = serde_json::to_string(&deed)?;
        writeln!(open.0, "{line}")?;
        open.0.sync_data()?;
        open.1 = deed.chain;
        Ok(())
    }

    /// The latest deeds, the latest last.
    ///
    /// # Errors
    /// The system's.
    pub fn latest(&self, most: usize) -> std::io::Result<Vec<Deed>> {
        let mut found = std::collections::VecDeque::new();
        for line in BufReader::new(File::open(&self.path)?).lines() {
            if let Ok(deed) = serde_json::from_str::<Deed>(&line?) {
                found.push_back(deed);
                if found.len() > most {
                    found.pop_front();
                }
            }
        }
        Ok(found.into())
    }
}

fn chain(before: &str, deed: &Deed) -> String {
    checksum(&format!("{before} {} {} {} {} {}", deed.unix_s, deed.who, deed.from, deed.what, deed.outcome))
}

/// The last checksum; with it the first line that is not as it was written.
fn check(path: &Path) -> std::io::Result<Result<String, (usize, String)>> {
    let (mut before, mut wrong) = (String::new(), None);
    for (number, line) in (1..).zip(BufReader::new(File::open(path)?).lines()) {
        match serde_json::from_str::<Deed>(&line?) {
            Ok(deed) => {
                if chain(&before, &deed) != deed.chain {
                    wrong.get_or_insert(number);
                }
                before = deed.chain;
            }
            Err(_) => drop(wrong.get_or_insert(number)),
        }
    }
    Ok(wrong.map_or_else(|| Ok(before.clone()), |line| Err((line, before.clone()))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_trail_goes_on_after_a_restart_and_a_line_that_was_altered_shows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        for what in ["first", "second"] {
            let audit = Audit::open(folder.path()).unwrap();
            audit.write(("ann", "127.0.0.1"), what, "200").unwrap();
            audit.write(("ann", "127.0.0.1"), &format!("{what} again"), "200").unwrap();
        }
        assert!(check(&path).unwrap().is_ok());
        let latest = Audit::open(folder.path()).unwrap().latest(3).unwrap();
        assert_eq!(latest.iter().map(|deed| deed.what.as_str()).collect::<Vec<_>>(), ["first again", "second", "second again"]);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replacen("ann", "bob", 1)).unwrap();
        assert_eq!(check(&path).unwrap().unwrap_err().0, 1);
        let taken_out: Vec<&str> = text.lines().enumerate().filter(|(index, _)| *index != 1).map(|(_, line)| line).collect();
        std::fs::write(&path, taken_out.join("\n")).unwrap();
        assert_eq!(check(&path).unwrap().unwrap_err().0, 2);
    }
}
