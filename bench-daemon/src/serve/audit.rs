//! Who did what, and when: one line of JSON each, appended and synced before the answer goes out. Each line carries a checksum over itself and the line
//! before, so that a line that was taken out or altered shows; how many there are and the last checksum stand in a file beside it, so that an end that was
//! cut off shows too.

use std::{
    fs::{File, OpenOptions},
    io::{BufRead, BufReader, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use analysis::dataset::write_atomically;
use instruments::clock;
use serde::{Deserialize, Serialize};

use crate::journal::checksum;

const FILE: &str = "audit.jsonl";
/// How far the trail went when it was written last.
const HEAD: &str = "audit.head.json";
/// Who writes down that the trail was altered.
const SERVER: &str = "server";

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

/// How far a trail goes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Head {
    /// Its lines.
    lines: usize,
    /// The checksum of the last.
    chain: String,
}

/// The audit trail of a data folder.
#[derive(Debug)]
pub struct Audit {
    path: PathBuf,
    open: Mutex<(File, Head)>,
}

impl Audit {
    /// Goes on with the trail of a data folder.
    ///
    /// # Errors
    /// The system's; a trail that was altered is told, in the log and in the trail itself, and gone on with.
    pub fn open(data: &Path) -> std::io::Result<Self> {
        let path = data.join(FILE);
        let mut file = OpenOptions::new().create(true).read(true).append(true).open(&path)?;
        let (head, wrong) = check(&path)?;
        end_torn_line(&mut file)?;
        let audit = Self { path, open: Mutex::new((file, head)) };
        for what in wrong {
            tracing::warn!("{}: {what}", audit.path.display());
            audit.write((SERVER, "-"), "look at the audit trail", &what)?;
        }
        Ok(audit)
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
        deed.chain = chain(&open.1.chain, &deed);
        let line = serde_json::to_string(&deed)?;
        writeln!(open.0, "{line}")?;
        open.0.sync_data()?;
        open.1 = Head { lines: open.1.lines + 1, chain: deed.chain };
        let head = serde_json::to_string(&open.1)?;
        write_atomically(&self.path.with_file_name(HEAD), head.as_bytes()).map_err(std::io::Error::other)
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

/// How far the trail goes, and what is wrong with it.
fn check(path: &Path) -> std::io::Result<(Head, Vec<String>)> {
    let known: Option<Head> = match std::fs::read(path.with_file_name(HEAD)) {
        Ok(bytes) => Some(serde_json::from_slice(&bytes).unwrap_or_default()),
        Err(_) => None,
    };
    let (mut head, mut wrong, mut met) = (Head::default(), None, false);
    for line in BufReader::new(File::open(path)?).lines() {
        head.lines += 1;
        match serde_json::from_str::<Deed>(&line?) {
            Ok(deed) => {
                if chain(&head.chain, &deed) != deed.chain {
                    wrong.get_or_insert(head.lines);
                }
                head.chain = deed.chain;
            }
            Err(_) => drop(wrong.get_or_insert(head.lines)),
        }
        met |= known.as_ref() == Some(&head);
    }
    let mut told: Vec<String> = wrong.map(|line| format!("line {line} of the audit trail is not as it was written")).into_iter().collect();
    // Of a server that died between the two, the trail is a line longer than the other file says.
    match known {
        Some(known) if known.lines > head.lines => {
            told.push(format!("the audit trail had {} lines, found {}: its end was cut off", known.lines, head.lines));
        }
        Some(known) if known.lines > 0 && !met && told.is_empty() => {
            told.push(format!("line {} of the audit trail is not the one that {HEAD} names", known.lines));
        }
        None if head.lines > 0 => {
            told.push(format!("expected {HEAD} beside the audit trail, found none: whether its end is there is not known"));
        }
        _ => {}
    }
    Ok((head, told))
}

/// What is left of a line that was being written when a server died stays a line of its own.
fn end_torn_line(file: &mut File) -> std::io::Result<()> {
    let mut last = [b'\n'];
    if file.seek(SeekFrom::End(-1)).is_ok() {
        file.read_exact(&mut last)?;
    }
    if last == [b'\n'] { Ok(()) } else { writeln!(file) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_trail_goes_on_after_a_restart_and_what_was_altered_or_cut_off_shows() {
        let folder = tempfile::tempdir().unwrap();
        let (path, head) = (folder.path().join(FILE), folder.path().join(HEAD));
        for what in ["first", "second"] {
            let audit = Audit::open(folder.path()).unwrap();
            audit.write(("ann", "127.0.0.1"), what, "200").unwrap();
            audit.write(("ann", "127.0.0.1"), &format!("{what} again"), "200").unwrap();
        }
        let wrong = || check(&path).unwrap().1;
        assert_eq!(wrong(), [""; 0]);
        let latest = Audit::open(folder.path()).unwrap().latest(3).unwrap();
        assert_eq!(latest.iter().map(|deed| deed.what.as_str()).collect::<Vec<_>>(), ["first again", "second", "second again"]);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replacen("ann", "bob", 1)).unwrap();
        assert_eq!(wrong(), ["line 1 of the audit trail is not as it was written"]);
        let without = |lines: std::ops::Range<usize>| {
            text.lines().enumerate().filter(|(index, _)| !lines.contains(index)).fold(String::new(), |all, (_, line)| all + line + "\n")
        };
        std::fs::write(&path, without(1..2)).unwrap();
        let cut = "the audit trail had 4 lines, found 3: its end was cut off";
        assert_eq!(wrong(), ["line 2 of the audit trail is not as it was written", cut]);
        std::fs::write(&path, without(3..4)).unwrap();
        assert_eq!(wrong(), [cut]);
        // It is in the trail itself, once.
        drop(Audit::open(folder.path()).unwrap());
        let told = Audit::open(folder.path()).unwrap().latest(9).unwrap();
        assert_eq!((told.len(), told[3].who.as_str(), told[3].outcome.as_str()), (4, "server", cut));
        // A server died in the middle of a line, or between the line and the other file.
        std::fs::write(&path, format!("{text}{}", &text[..40])).unwrap();
        std::fs::write(&head, format!("{{\"lines\":3,\"chain\":\"{}\"}}", latest[1].chain)).unwrap();
        drop(Audit::open(folder.path()).unwrap());
        assert_eq!(wrong(), ["line 5 of the audit trail is not as it was written"]);
        std::fs::write(&path, &text).unwrap();
        std::fs::write(&head, format!("{{\"lines\":3,\"chain\":\"{}\"}}", latest[1].chain)).unwrap();
        assert_eq!(wrong(), [""; 0]);
        std::fs::remove_file(&head).unwrap();
        assert_eq!(wrong(), ["expected audit.head.json beside the audit trail, found none: whether its end is there is not known"]);
    }
}
