use super::*;

fn in_virtual_time<T>(work: impl FnOnce(Clock) -> T) -> T {
    let runtime = Clock::runtime(TimeMode::Virtual).unwrap();
    runtime.block_on(async { work(Clock::start(TimeMode::Virtual)) })
}

fn entries() -> Vec<Entry> {
    vec![
        Entry::Stage { stage: 0 },
        Entry::Intent {
            stage: 0,
            step: 0,
            text: "mount \"cell\"".to_owned(),
            live: false,
        },
        Entry::Done { stage: 0, step: 0 },
        Entry::Note(Note::of("odd, \"sha256\":\" in it")),
        Entry::Ended {
            how: "finished".to_owned(),
        },
    ]
}

/// Returns a folder with a journal of these entries.
fn written() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    in_virtual_time(|clock| {
        let mut journal = Journal::create(folder.path(), &clock).unwrap();
        entries().into_iter().for_each(|entry| {
            journal.write(entry).unwrap();
        });
    });
    folder
}

#[test]
fn a_missed_state_of_charge_is_reported_by_its_kind_or_in_older_journals_by_its_words() {
    let words =
        "run 1 (cell A, repeat 1): SOC reset: expected 3.7 V to 3.74 V at rest, found 3.6 V";
    let missed = |text: &str| Note {
        text: text.to_owned(),
        kind: Some(NoteKind::SocMissed),
    };
    for (note, json, is_missed) in [
        (Note::of("odd"), r#"{"note":{"text":"odd"}}"#, false),
        (
            Note::of(words),
            &format!(r#"{{"note":{{"text":"{words}"}}}}"#),
            true,
        ),
        (
            missed("low"),
            r#"{"note":{"text":"low","kind":"soc_missed"}}"#,
            true,
        ),
    ] {
        let entry = Entry::Note(note.clone());
        assert_eq!(serde_json::to_string(&entry).unwrap(), json);
        assert_eq!(serde_json::from_str::<Entry>(json).unwrap(), entry);
        assert_eq!(note.is_soc_missed(), is_missed, "{json}");
    }
}

#[test]
fn what_is_written_is_read() {
    let folder = written();
    let found = read(folder.path()).unwrap();
    assert_eq!(
        found
            .lines
            .iter()
            .map(|line| line.entry.clone())
            .collect::<Vec<_>>(),
        entries()
    );
    assert_eq!(
        found
            .lines
            .iter()
            .map(|line| line.number)
            .collect::<Vec<_>>(),
        [1, 2, 3, 4, 5]
    );
    assert!(found.torn.is_empty());
}

#[test]
fn a_journal_torn_at_any_byte_keeps_its_whole_lines_and_goes_on() {
    let whole = std::fs::read(written().path().join(JOURNAL)).unwrap();
    let ends: Vec<usize> = whole
        .iter()
        .enumerate()
        .filter(|(_, byte)| **byte == b'\n')
        .map(|(at, _)| at + 1)
        .collect();
    for length in 0..=whole.len() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(JOURNAL), &whole[..length]).unwrap();
        let found = read(folder.path()).unwrap();
        let kept = ends.iter().filter(|end| **end <= length).count();
        assert_eq!(found.lines.len(), kept, "{length} bytes");
        in_virtual_time(|clock| {
            Journal::reopen(folder.path(), &clock, &found)
                .unwrap()
                .write(Entry::Safe)
                .unwrap();
        });
        let again = read(folder.path()).unwrap();
        assert_eq!(
            (again.lines.len(), again.torn.len()),
            (kept + 1, 0),
            "{length} bytes"
        );
        assert_eq!(
            again.lines.last().map(|line| &line.entry),
            Some(&Entry::Safe)
        );
        let aside = std::fs::read(folder.path().join(TORN_JOURNAL)).unwrap_or_default();
        assert_eq!(
            aside,
            whole[found.whole_bytes as usize..length],
            "{length} bytes"
        );
    }
}

#[test]
fn a_line_that_was_altered_lost_or_doubled_is_named() {
    let text = std::fs::read_to_string(written().path().join(JOURNAL)).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let joined = |lines: &[&str]| {
        lines
            .iter()
            .map(|line| format!("{line}\n"))
            .collect::<String>()
    };
    let altered = text.replacen("\"step\":0,\"text\"", "\"step\":1,\"text\"", 1);
    for (text, expected) in [
        (
            altered,
            "journal.jsonl:2: expected a line with the checksum ",
        ),
        (
            joined(&[lines[0], lines[2]]),
            "journal.jsonl:2: expected line number 2, found 3: lines are missing or doubled",
        ),
        (
            joined(&[lines[0], lines[0]]),
            "journal.jsonl:2: expected line number 2, found 1: lines are missing or doubled",
        ),
        (
            joined(&[lines[0], "", lines[1]]),
            "journal.jsonl:2: expected a line that ends in its checksum, found \"\"",
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(JOURNAL), text).unwrap();
        let message = read(folder.path()).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    // The checksum is valid, but the entry must be valid, too.
    let strange = r#"{"number":1,"time_s":0.0,"entry":"danced""#;
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join(JOURNAL),
        format!("{strange}{CHECKSUM}{}\"}}\n", checksum(strange)),
    )
    .unwrap();
    let message = read(folder.path()).unwrap_err().to_string();
    assert!(
        message.contains("journal.jsonl:1: expected an entry that version ")
            && message.contains("danced"),
        "{message}"
    );
}

/// A disk that accepts this number of lines and then fails, in writing or in syncing.
struct Failing {
    writes: usize,
    syncs: usize,
}

impl Write for Failing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writes = self
            .writes
            .checked_sub(1)
            .ok_or(io::ErrorKind::StorageFull)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Durable for Failing {
    fn sync(&mut self) -> io::Result<()> {
        self.syncs = self.syncs.checked_sub(1).ok_or(io::ErrorKind::Other)?;
        Ok(())
    }
}

#[test]
fn a_full_disk_is_an_error_before_anything_is_begun() {
    in_virtual_time(|clock| {
        for (writes, syncs, what) in [(1, 9, "cannot be written"), (9, 1, "cannot be synced")] {
            let mut journal = Journal::on(
                JOURNAL.into(),
                Box::new(Failing { writes, syncs }),
                &clock,
                1,
            );
            assert!(journal.write(Entry::Safe).is_ok());
            let message = journal.write(Entry::Safe).unwrap_err().to_string();
            assert!(
                message.starts_with(&format!("{JOURNAL}: {what}: "))
                    && message.contains("nothing may be begun"),
                "{message}"
            );
            // A failed write may have left a part of a line: nothing may be written after it, even
            // when there is room again.
            let message = journal.write(Entry::Safe).unwrap_err().to_string();
            assert!(
                message.contains("a write before this one has failed"),
                "{message}"
            );
        }
        let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
        let mut journal = Journal::on("/dev/full".into(), Box::new(full), &clock, 1);
        let message = journal.write(Entry::Safe).unwrap_err().to_string();
        assert!(
            message.starts_with("/dev/full: cannot be written: No space left on device"),
            "{message}"
        );
    });
}

#[test]
fn of_two_that_go_on_with_one_run_the_second_is_refused() {
    let folder = written();
    let read = read(folder.path()).unwrap();
    in_virtual_time(|clock| {
        let first = Journal::reopen(folder.path(), &clock, &read).unwrap();
        let refused = Journal::reopen(folder.path(), &clock, &read)
            .err()
            .unwrap()
            .to_string();
        assert!(
            refused.contains("is in use by another process"),
            "{refused}"
        );
        drop(first);
        assert!(Journal::reopen(folder.path(), &clock, &read).is_ok());
    });
}

#[test]
fn a_journal_whose_folder_was_deleted_is_an_error_at_the_next_entry() {
    let runtime = Clock::runtime(TimeMode::Real).unwrap();
    let clock = runtime.block_on(async { Clock::start(TimeMode::Real) });
    let folder = tempfile::tempdir().unwrap();
    let mut journal = Journal::create(folder.path(), &clock).unwrap();
    journal.write(Entry::Safe).unwrap();
    std::fs::remove_dir_all(folder.path()).unwrap();
    let error = journal.write(Entry::Safe).unwrap_err();
    let text = crate::record::with_causes(&error);
    assert!(
        text.ends_with("the run folder was deleted while the run was going on"),
        "{text}"
    );
}
