//! The messages of a run in progress: its journal and its output, each with the time at which it
//! was seen.

use std::{
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

use instruments::clock::Clock;
use serde_json::Value;

use super::{
    job::{Job, asked_a},
    scene::lock,
};

/// An entry of the journal.
#[derive(Debug, Clone)]
pub(crate) struct Entry {
    /// Bench time at which it was seen, s.
    pub(crate) now_s: f64,
    /// Number of its line.
    pub(crate) number: u64,
    pub(crate) kind: String,
    pub(crate) value: Value,
}

impl Entry {
    /// Returns the text of a step.
    pub(crate) fn text(&self) -> &str {
        self.value["text"].as_str().unwrap_or_default()
    }
}

/// The part of the journal that was read.
pub(crate) struct Journal {
    path: PathBuf,
    offset: u64,
    torn: String,
    pub(crate) entries: Vec<Entry>,
}

impl Journal {
    pub(crate) fn of(run: &Path) -> Self {
        Self {
            path: run.join("journal.jsonl"),
            offset: 0,
            torn: String::new(),
            entries: Vec::new(),
        }
    }

    /// Reads what was written since the last call.
    pub(crate) fn read(&mut self, now_s: f64) {
        let mut text = String::new();
        let read = File::open(&self.path).and_then(|mut file| {
            file.seek(SeekFrom::Start(self.offset))?;
            file.read_to_string(&mut text)
        });
        let Ok(count) = read else { return };
        self.offset += count as u64;
        self.torn.push_str(&text);
        while let Some((line, rest)) = self.torn.split_once('\n') {
            let entry = parse(line, now_s);
            self.torn = rest.to_owned();
            self.entries.extend(entry);
        }
    }

    /// Returns the last entry that is not a remark.
    pub(crate) fn last(&self) -> Option<&Entry> {
        self.entries
            .iter()
            .rev()
            .find(|entry| !matches!(entry.kind.as_str(), "note" | "found"))
    }

    /// Returns when everything was read back as off after the last stage, s.
    pub(crate) fn last_safe_s(&self, stages: usize) -> Option<f64> {
        let mut ended = self.entries.iter().skip_while(|entry| {
            entry.kind != "stage_done" || entry.value["stage"].as_u64() != Some(stages as u64 - 1)
        });
        ended
            .find(|entry| entry.kind == "safe")
            .map(|entry| entry.now_s)
    }

    /// Returns the least and greatest requested current, A, from each time on, s.
    pub(crate) fn envelope(&self, job: Job) -> Vec<(f64, (f64, f64))> {
        let mut envelope = vec![(0.0, (0.0, 0.0))];
        for entry in &self.entries {
            let asked = match entry.kind.as_str() {
                "intent" => asked_a(entry.text(), job),
                "safe" | "stage_done" | "paused" | "asked" | "ended" => Some((0.0, 0.0)),
                _ => None,
            };
            envelope.extend(asked.map(|asked| (entry.now_s, asked)));
        }
        envelope
    }
}

fn parse(line: &str, now_s: f64) -> Option<Entry> {
    let line: Value = serde_json::from_str(line).ok()?;
    let number = line["number"].as_u64().unwrap_or_default();
    let (kind, value) = match &line["entry"] {
        Value::String(kind) => (kind.clone(), Value::Null),
        Value::Object(map) => map
            .iter()
            .next()
            .map(|(kind, value)| (kind.clone(), value.clone()))?,
        _ => return None,
    };
    Some(Entry {
        now_s,
        number,
        kind,
        value,
    })
}

/// Output of a pipe, with the times of its lines, s.
#[derive(Clone, Default)]
pub(crate) struct Said(Arc<Mutex<Vec<(f64, String)>>>);

impl Said {
    /// Collects the output of a pipe.
    pub(crate) fn listen(
        &self,
        mut pipe: impl Read + Send + 'static,
        clock: Clock,
    ) -> std::thread::JoinHandle<()> {
        let kept = self.0.clone();
        std::thread::spawn(move || {
            let (mut bytes, mut torn) = ([0; 4096], String::new());
            while let Ok(count @ 1..) = pipe.read(&mut bytes) {
                torn.push_str(&String::from_utf8_lossy(&bytes[..count]));
                while let Some((line, rest)) = torn.split_once('\n') {
                    lock(&kept).push((clock.now_s(), line.to_owned()));
                    torn = rest.to_owned();
                }
            }
        })
    }

    pub(crate) fn lines(&self) -> Vec<(f64, String)> {
        lock(&self.0).clone()
    }

    pub(crate) fn text(&self) -> String {
        self.lines()
            .iter()
            .map(|(_, line)| format!("{line}\n"))
            .collect()
    }

    /// Returns when a text was first written, s.
    pub(crate) fn at_s(&self, words: &str) -> Option<f64> {
        self.lines()
            .iter()
            .find(|(_, line)| line.contains(words))
            .map(|(now_s, _)| *now_s)
    }
}
