//! Audit trail: who did what, and when. For each request, one line of JSON is appended and synced
//! before the reply is sent. Each line contains a checksum over itself and the previous line,
//! which reveals removed and altered lines. A second file contains the number of lines and the
//! last checksum, which reveals a truncated end.

use std::{
    fs::{File, OpenOptions},
    io::{BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom, Write},
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use analysis::dataset::write_private;
use instruments::clock;
use serde::{Deserialize, Serialize};

use bench_core::journal::checksum;

const FILE: &str = "audit.jsonl";
/// File with the length of the trail at the last write.
const HEAD: &str = "audit.head.json";
/// File mode: readable by the group, inaccessible to all other accounts.
const MODE: u32 = 0o640;
/// Name under which the server itself records that the trail was altered.
const SERVER: &str = "server";
/// Maximum number of altered lines that are listed by line number.
const NUMBERS: usize = 8;

/// Restricts a file to its own account, and to its group for reading if `mode` says so. Refuses a
/// file that is writable by everyone, because its content cannot be trusted.
///
/// # Errors
/// The system's.
pub fn private(path: &Path, mode: u32) -> std::io::Result<()> {
    let found = std::fs::metadata(path)?.permissions().mode();
    if found & 0o002 != 0 {
        let text = format!(
            "{}: expected a file that not everybody may write, found mode {:04o}",
            path.display(),
            found & 0o7777
        );
        return Err(std::io::Error::other(text));
    }
    if found & 0o777 & !mode == 0 {
        Ok(())
    } else {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode & found))
    }
}

/// One request in the audit trail.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Deed {
    /// Time, s since 1970.
    pub unix_s: f64,
    /// Name of the token; `local` if none is required, `-` if none was presented.
    pub who: String,
    /// Address of the peer.
    pub from: String,
    /// Request: method and path.
    pub what: String,
    /// Outcome: the status, and for a refusal its code.
    pub outcome: String,
    /// Checksum over the previous line and this one.
    #[serde(default)]
    pub chain: String,
}

/// The author of a request.
#[derive(Debug, Clone, Copy)]
pub struct By<'a> {
    /// Name; `-` if the author is unknown.
    pub who: &'a str,
    /// Address; `-` for the server itself.
    pub from: &'a str,
}

/// How far a trail goes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Head {
    /// Its lines.
    lines: usize,
    /// The checksum of the last.
    chain: String,
    /// Checksum over the altered lines that the trail has already reported; empty if there are
    /// none. Altered lines stay in the file, and a report at each start would fill the trail.
    #[serde(rename = "told", default, skip_serializing_if = "String::is_empty")]
    reported: String,
}

/// The audit trail of a data folder.
#[derive(Debug)]
pub struct Audit {
    path: PathBuf,
    open: Mutex<(File, Head)>,
}

impl Audit {
    /// Opens the trail of a data folder to append to it.
    ///
    /// # Errors
    /// The system's. A trail that was altered is not an error: the alteration is reported in the
    /// log and in the trail itself, and the trail continues.
    pub fn open(data: &Path) -> std::io::Result<Self> {
        let path = data.join(FILE);
        let mut file = OpenOptions::new()
            .create(true)
            .read(true)
            .append(true)
            .mode(MODE)
            .open(&path)?;
        private(&path, MODE)?;
        let (head, wrong) = check(&path)?;
        end_torn_line(&mut file)?;
        let audit = Self {
            path,
            open: Mutex::new((file, head)),
        };
        for what in wrong {
            tracing::warn!("{}: {what}", audit.path.display());
            audit.write(
                By {
                    who: SERVER,
                    from: "-",
                },
                "look at the audit trail",
                &what,
            )?;
        }
        Ok(audit)
    }

    /// Writes a request to the trail; it is on disk when this returns.
    ///
    /// # Errors
    /// The system's.
    pub fn write(&self, by: By<'_>, what: &str, outcome: &str) -> std::io::Result<()> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let text = |text: &str| text.chars().take(300).collect::<String>();
        let unix_s = (clock::unix_time_s() * 1.0e3).round() / 1.0e3;
        let mut deed = Deed {
            unix_s,
            who: text(by.who),
            from: text(by.from),
            what: text(what),
            outcome: text(outcome),
            chain: String::new(),
        };
        deed.chain = chain(&open.1.chain, &deed);
        let line = serde_json::to_string(&deed)?;
        writeln!(open.0, "{line}")?;
        open.0.sync_data()?;
        (open.1.lines, open.1.chain) = (open.1.lines + 1, deed.chain);
        let head = serde_json::to_string(&open.1)?;
        write_private(&self.path.with_file_name(HEAD), head.as_bytes(), MODE)
            .map_err(std::io::Error::other)
    }

    /// The latest requests, the latest last.
    ///
    /// # Errors
    /// The system's.
    pub fn latest(&self, most: usize) -> std::io::Result<Vec<Deed>> {
        let mut found = std::collections::VecDeque::new();
        for line in BufReader::new(File::open(&self.path)?).split(b'\n') {
            if let Some(deed) = read(&line?) {
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
    checksum(&format!(
        "{before} {} {} {} {} {}",
        deed.unix_s, deed.who, deed.from, deed.what, deed.outcome
    ))
}

/// Parses the request of a line. A server may have crashed inside a multi-byte character, so
/// invalid UTF-8 must not prevent the next start.
fn read(line: &[u8]) -> Option<Deed> {
    serde_json::from_str(&String::from_utf8_lossy(line)).ok()
}

/// Reads the recorded length of the trail from the file beside it, or `None` if that file does
/// not exist. A failure describes what is wrong with the file.
fn named(path: &Path) -> Result<Option<Head>, String> {
    let wrong = |what: &str| {
        format!(
            "{HEAD} beside the audit trail cannot be {what}: whether the end of the trail is there \
            is not known"
        )
    };
    let head = path.with_file_name(HEAD);
    if std::fs::metadata(&head)
        .is_ok_and(|meta| meta.is_file() && meta.permissions().mode() & 0o002 != 0)
    {
        return Err(wrong("trusted (everybody may write it)"));
    }
    match std::fs::read(head) {
        Ok(bytes) => serde_json::from_slice(&bytes)
            .map(Some)
            .map_err(|error| wrong(&format!("understood ({error})"))),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(wrong(&format!("read ({error})"))),
    }
}

/// Returns the length of the trail, and its defects that have not been reported yet.
fn check(path: &Path) -> std::io::Result<(Head, Vec<String>)> {
    let named = named(path);
    let known = named.as_ref().ok().and_then(Option::as_ref);
    let (mut head, mut wrong, mut met) = (Head::default(), Vec::new(), false);
    for line in BufReader::new(File::open(path)?).split(b'\n') {
        let line = line?;
        head.lines += 1;
        let deed = read(&line);
        if deed
            .as_ref()
            .is_none_or(|deed| chain(&head.chain, deed) != deed.chain)
        {
            wrong.push(head.lines);
            head.reported = checksum(&format!(
                "{} {} {}",
                head.reported,
                head.lines,
                String::from_utf8_lossy(&line)
            ));
        }
        head.chain = deed.map_or(head.chain, |deed| deed.chain);
        met |= known.is_some_and(|known| (known.lines, &known.chain) == (head.lines, &head.chain));
    }
    let news = !wrong.is_empty() && known.is_none_or(|known| known.reported != head.reported);
    let mut messages: Vec<String> = news.then(|| altered(&wrong)).into_iter().collect();
    // Of a server that died between the two, the trail is a line longer than the other file says.
    match named {
        Err(what) => messages.push(what),
        Ok(Some(known)) if known.lines > head.lines => {
            messages.push(format!(
                "the audit trail had {} lines, found {}: its end was cut off",
                known.lines, head.lines
            ));
        }
        Ok(Some(known)) if known.lines > 0 && !met && messages.is_empty() => {
            messages.push(format!(
                "line {} of the audit trail is not the one that {HEAD} names",
                known.lines
            ));
        }
        Ok(None) if head.lines > 0 => {
            messages.push(format!(
                "expected {HEAD} beside the audit trail, found none: whether its end \
            is there is not known"
            ));
        }
        Ok(_) => {}
    }
    Ok((head, messages))
}

fn altered(lines: &[usize]) -> String {
    if let [line] = lines {
        return format!("line {line} of the audit trail is not as it was written");
    }
    let numbers: Vec<String> = lines
        .iter()
        .take(NUMBERS)
        .map(ToString::to_string)
        .collect();
    let more = if lines.len() > NUMBERS {
        format!(" and {} more", lines.len() - NUMBERS)
    } else {
        String::new()
    };
    format!(
        "lines {}{more} of the audit trail are not as they were written",
        numbers.join(", ")
    )
}

/// Terminates a line that was cut off by a crash of the server, so that it remains a separate
/// line.
fn end_torn_line(file: &mut File) -> std::io::Result<()> {
    let mut last = [b'\n'];
    if file.seek(SeekFrom::End(-1)).is_ok() {
        file.read_exact(&mut last)?;
    }
    if last == [b'\n'] {
        Ok(())
    } else {
        writeln!(file)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ANN: By<'_> = By {
        who: "ann",
        from: "127.0.0.1",
    };

    #[test]
    fn the_trail_goes_on_after_a_restart_and_what_was_altered_or_cut_off_shows() {
        let folder = tempfile::tempdir().unwrap();
        let (path, head) = (folder.path().join(FILE), folder.path().join(HEAD));
        for what in ["first", "second"] {
            let audit = Audit::open(folder.path()).unwrap();
            audit.write(ANN, what, "200").unwrap();
            audit.write(ANN, &format!("{what} again"), "200").unwrap();
        }
        let wrong = || check(&path).unwrap().1;
        assert_eq!(wrong(), [""; 0]);
        let latest = Audit::open(folder.path()).unwrap().latest(3).unwrap();
        assert_eq!(
            latest
                .iter()
                .map(|deed| deed.what.as_str())
                .collect::<Vec<_>>(),
            ["first again", "second", "second again"]
        );
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replacen("ann", "bob", 1)).unwrap();
        assert_eq!(
            wrong(),
            ["line 1 of the audit trail is not as it was written"]
        );
        let without = |lines: std::ops::Range<usize>| {
            text.lines()
                .enumerate()
                .filter(|(index, _)| !lines.contains(index))
                .fold(String::new(), |all, (_, line)| all + line + "\n")
        };
        std::fs::write(&path, without(1..2)).unwrap();
        let cut = "the audit trail had 4 lines, found 3: its end was cut off";
        assert_eq!(
            wrong(),
            ["line 2 of the audit trail is not as it was written", cut]
        );
        std::fs::write(&path, without(3..4)).unwrap();
        assert_eq!(wrong(), [cut]);
        // It is in the trail itself, once.
        drop(Audit::open(folder.path()).unwrap());
        let deeds = Audit::open(folder.path()).unwrap().latest(9).unwrap();
        assert_eq!(
            (
                deeds.len(),
                deeds[3].who.as_str(),
                deeds[3].outcome.as_str()
            ),
            (4, "server", cut)
        );
        // A server died in the middle of a line, or between the line and the other file.
        std::fs::write(&path, format!("{text}{}", &text[..40])).unwrap();
        std::fs::write(
            &head,
            format!("{{\"lines\":3,\"chain\":\"{}\"}}", latest[1].chain),
        )
        .unwrap();
        assert_eq!(
            wrong(),
            ["line 5 of the audit trail is not as it was written"]
        );
        drop(Audit::open(folder.path()).unwrap());
        assert_eq!(wrong(), [""; 0]);
        std::fs::write(&path, &text).unwrap();
        std::fs::write(
            &head,
            format!("{{\"lines\":3,\"chain\":\"{}\"}}", latest[1].chain),
        )
        .unwrap();
        assert_eq!(wrong(), [""; 0]);
        std::fs::remove_file(&head).unwrap();
        assert_eq!(
            wrong(),
            [
                "expected audit.head.json beside the audit trail, found none: whether its end is \
                there is not known"
            ]
        );
    }

    #[test]
    fn an_altered_line_is_reported_once_and_another_one_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        let audit = Audit::open(folder.path()).unwrap();
        for what in ["first", "second"] {
            audit.write(ANN, what, "200").unwrap();
        }
        drop(audit);
        let server_reports = || -> Vec<String> {
            let deeds = Audit::open(folder.path()).unwrap().latest(99).unwrap();
            deeds
                .into_iter()
                .filter(|deed| deed.who == SERVER)
                .map(|deed| deed.outcome)
                .collect()
        };
        let alter = |from: &str, to: &str| {
            std::fs::write(
                &path,
                std::fs::read_to_string(&path)
                    .unwrap()
                    .replacen(from, to, 1),
            )
            .unwrap();
        };
        alter("first", "other");
        let first = "line 1 of the audit trail is not as it was written";
        assert_eq!(
            (server_reports(), server_reports(), server_reports()),
            (
                vec![first.to_owned()],
                vec![first.to_owned()],
                vec![first.to_owned()]
            )
        );
        alter("second", "another");
        let both = "lines 1, 2 of the audit trail are not as they were written";
        assert_eq!(
            (server_reports(), server_reports()),
            (
                vec![first.to_owned(), both.to_owned()],
                vec![first.to_owned(), both.to_owned()]
            )
        );
    }

    #[test]
    fn a_letter_torn_in_the_middle_does_not_keep_the_server_from_starting() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        Audit::open(folder.path())
            .unwrap()
            .write(ANN, "first", "200")
            .unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.extend(b"{\"who\":\"J\xc3");
        std::fs::write(&path, &bytes).unwrap();
        let deeds = Audit::open(folder.path()).unwrap().latest(9).unwrap();
        let outcomes: Vec<&str> = deeds.iter().map(|deed| deed.outcome.as_str()).collect();
        assert_eq!(
            outcomes,
            ["200", "line 2 of the audit trail is not as it was written"]
        );
        assert_eq!(check(&path).unwrap().1, [""; 0]);
    }

    #[test]
    fn a_head_that_everybody_may_write_is_reported_and_written_anew() {
        let folder = tempfile::tempdir().unwrap();
        let head = folder.path().join(HEAD);
        Audit::open(folder.path())
            .unwrap()
            .write(ANN, "first", "200")
            .unwrap();
        std::fs::set_permissions(&head, std::fs::Permissions::from_mode(0o666)).unwrap();
        let outcome = Audit::open(folder.path())
            .unwrap()
            .latest(1)
            .unwrap()
            .remove(0)
            .outcome;
        assert!(
            outcome.starts_with(
                "audit.head.json beside the audit trail cannot be trusted (everybody may write it)"
            ),
            "{outcome}"
        );
        assert_eq!(
            std::fs::metadata(&head).unwrap().permissions().mode() & 0o777 & !MODE,
            0
        );
        assert_eq!(
            Audit::open(folder.path()).unwrap().latest(9).unwrap().len(),
            2
        );
    }

    #[test]
    fn a_damaged_head_is_reported_like_a_missing_one() {
        let folder = tempfile::tempdir().unwrap();
        let (path, head) = (folder.path().join(FILE), folder.path().join(HEAD));
        Audit::open(folder.path())
            .unwrap()
            .write(ANN, "first", "200")
            .unwrap();
        for damaged in [&b""[..], b"{\"lines\":", b"{}", b"\xff"] {
            std::fs::write(&head, damaged).unwrap();
            let deeds = Audit::open(folder.path()).unwrap().latest(1).unwrap();
            let notice = &deeds[0].outcome;
            assert!(
                notice.starts_with("audit.head.json beside the audit trail cannot be understood ("),
                "{notice}"
            );
            assert!(
                notice.ends_with("): whether the end of the trail is there is not known"),
                "{notice}"
            );
            assert_eq!(check(&path).unwrap().1, [""; 0]);
        }
        // An empty trail with a damaged file beside it is reported, too.
        std::fs::write(&path, "").unwrap();
        std::fs::write(&head, "{").unwrap();
        assert_eq!(check(&path).unwrap().1.len(), 1);
        std::fs::remove_file(&head).unwrap();
        std::fs::create_dir(&head).unwrap();
        let wrong = check(&path).unwrap().1;
        assert!(
            wrong.len() == 1
                && wrong[0].starts_with("audit.head.json beside the audit trail cannot be read ("),
            "{wrong:?}"
        );
    }
}
