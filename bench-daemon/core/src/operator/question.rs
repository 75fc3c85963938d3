//! Questions to the person at the bench that are answered through the run folder, by a command or
//! by the page: the run writes the question into its journal and waits for a small file.

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use analysis_files::{
    dataset::{self, DatasetError},
    run_folder::ANSWER,
};
use instruments::{
    clock::{Clock, TimeMode},
    fixture::Fixture,
    units::Seconds,
};
use serde::{Deserialize, Serialize};

use bench_plan::plan::Specimen;

use crate::clock::TypedClock;

/// Time between two checks for the answer, s of real time: short enough for a person.
const LOOK_S: Seconds = Seconds(0.5);
/// Longest name or serial number, characters.
const LONGEST_TEXT: usize = 100;

/// A requested change of the fixture. Every output is off.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Question {
    /// In words.
    pub text: String,
    /// Fixture that is to be in the jig.
    pub fixture: Fixture,
    /// Name of the cell, if there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cell: Option<String>,
    /// Its serial number, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Code that is printed on it, if known; an answer may contain it instead of the serial
    /// number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub barcode: Option<String>,
    /// Whether it is asked on the terminal of the run, and can be answered only there.
    pub on_terminal: bool,
}

impl Question {
    /// Asks for a fixture: a certain cell if the experiment names its cells, otherwise one of the
    /// kind `cell`. A control begins with the removal of the cell: a bar or a copper dummy clamped
    /// across a cell is a dead short.
    pub fn new(fixture: Fixture, specimen: Option<&Specimen>, cell: &str) -> Self {
        let specimen = specimen.filter(|_| fixture == Fixture::Cell);
        Self {
            text: text(fixture, specimen, cell),
            fixture,
            cell: specimen.map(|specimen| specimen.name.clone()),
            serial: specimen.and_then(|specimen| specimen.serial.clone()),
            barcode: specimen.and_then(|specimen| specimen.barcode.clone()),
            on_terminal: false,
        }
    }

    /// Rejects an answer with another serial number than that of the cell, or with a text that
    /// contains a line break. An answer without a serial number is accepted: not every cell has a
    /// readable number.
    ///
    /// # Errors
    /// A text with the two numbers, or the invalid text.
    pub fn check(&self, answer: &Answer) -> Result<(), String> {
        let texts = [("by", Some(&answer.by)), ("serial", answer.serial.as_ref())];
        for (field, text) in texts {
            let is_plain = |text: &&String| {
                let count = text.trim().chars().count();
                (1..=LONGEST_TEXT).contains(&count) && !text.contains(char::is_control)
            };
            if let Some(text) = text.filter(|text| !is_plain(text)) {
                return Err(format!(
                    "{field}: expected 1 to {LONGEST_TEXT} characters in one line, found {text:?}"
                ));
            }
        }
        let Some(found) = &answer.serial else {
            return Ok(());
        };
        let known: Vec<&String> = [&self.serial, &self.barcode]
            .into_iter()
            .flatten()
            .collect();
        if known.iter().any(|asked| asked.trim() == found.trim()) {
            return Ok(());
        }
        let known: Vec<String> = known.iter().map(|asked| format!("{asked:?}")).collect();
        Err(match known.join(" or ") {
            asked if asked.is_empty() => format!(
                "serial: expected none, because no cell with a serial number is requested, found \
                {found:?}"
            ),
            asked => format!("this is another cell: serial: expected {asked}, found {found:?}"),
        })
    }
}

fn text(fixture: Fixture, specimen: Option<&Specimen>, cell: &str) -> String {
    let text = match (fixture, specimen) {
        (Fixture::Cell, None) => {
            return format!(
                "Clamp the cell under test ({cell}) into the jig, nothing else beside it, voltage \
                probes C3 (−) and C4 (+) on its Kelvin contacts."
            );
        }
        (Fixture::Cell, Some(specimen)) => {
            return format!(
                "Clamp {specimen} into the jig, no other cell and nothing else beside it, voltage \
                probes C3 (−) and C4 (+) on its Kelvin contacts."
            );
        }
        (Fixture::Shunt, _) => {
            "Take the cell out of the jig. Close the current path there with copper (the fake \
            cell, or a short bar) and put the voltage probes \
             C3 and C4 on the shunt, beside C1 and C2."
        }
        (Fixture::FakeCell, _) => {
            "Take the cell out of the jig. Clamp the fake cell in its place, voltage probes C3 (−) \
            and C4 (+) on its Kelvin contacts."
        }
        (Fixture::Short, _) => {
            "Take the cell out of the jig. Clamp the short bar in its place, voltage probes C3 (−) \
            and C4 (+) on its Kelvin contacts."
        }
    };
    text.to_owned()
}

/// Confirmation that the fixture was changed as asked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answer {
    /// Number of the question: that of its line in the journal.
    pub question: u64,
    /// The person who answers.
    pub by: String,
    /// Serial number that was read from the cell, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
}

impl Answer {
    /// Writes the answer into a run folder.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), DatasetError> {
        let text = serde_json::to_string(self).unwrap_or_default();
        dataset::write_atomically(&folder.join(ANSWER), text.as_bytes())
    }

    /// Takes the answer to a question out of a run folder. Ignores an answer to another question
    /// or for another cell.
    fn take(folder: &Path, number: u64, question: &Question) -> Option<Self> {
        let path = folder.join(ANSWER);
        let text = std::fs::read_to_string(&path).ok()?;
        let _ = std::fs::remove_file(&path);
        let answer: Self = serde_json::from_str(&text)
            .inspect_err(|error| tracing::warn!("{ANSWER}: {error}: ignored"))
            .ok()?;
        if answer.question != number {
            tracing::warn!("{ANSWER}: to question {}, ignored", answer.question);
            return None;
        }
        question
            .check(&answer)
            .inspect_err(|error| tracing::warn!("{ANSWER}: {error}: ignored"))
            .ok()?;
        Some(answer)
    }
}

/// A wait that ends when its waiter is dropped.
struct Waits(Arc<AtomicBool>);

impl Drop for Waits {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Waits for the answer in a run folder, in real time regardless of bench time. Returns `None` if
/// the system cannot start a thread.
pub(super) async fn answered(folder: &Path, number: u64, question: &Question) -> Option<Answer> {
    let ended = Waits(Arc::default());
    let (over, question, folder): (_, _, PathBuf) =
        (ended.0.clone(), question.clone(), folder.to_owned());
    // A separate thread, because the clock of a run in virtual time stands still while the run
    // works.
    let look = move || {
        let runtime = Clock::runtime(TimeMode::Real).ok()?;
        runtime.block_on(async {
            let clock = Clock::start(TimeMode::Real);
            while !over.load(Ordering::Relaxed) {
                if let Some(answer) = Answer::take(&folder, number, &question) {
                    return Some(answer);
                }
                if !folder.is_dir() {
                    tracing::error!("{}: expected the run folder, found none", folder.display());
                    return None;
                }
                clock.sleep_for(LOOK_S).await;
            }
            None
        })
    };
    tokio::task::spawn_blocking(look).await.ok().flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn second() -> Specimen {
        Specimen {
            number: 2,
            name: "B".to_owned(),
            serial: Some("P45B-17".to_owned()),
            batch: None,
            barcode: Some("0417 8821".to_owned()),
        }
    }

    fn answer(question: u64, serial: Option<&str>) -> Answer {
        Answer {
            question,
            by: "Ada".to_owned(),
            serial: serial.map(str::to_owned),
        }
    }

    #[test]
    fn a_control_is_asked_for_without_the_cell_and_the_shunt_without_a_fake_cell_that_may_not_exist()
     {
        let request = |fixture, specimen| Question::new(fixture, specimen, "P45B").text;
        let second = second();
        for control in [Fixture::Shunt, Fixture::FakeCell, Fixture::Short] {
            let text = request(control, Some(&second));
            assert!(text.starts_with("Take the cell out of the jig. "), "{text}");
        }
        assert!(request(Fixture::Cell, None).starts_with("Clamp the cell under test (P45B) into"));
        assert!(request(Fixture::Shunt, None).contains("or a short bar"));
        assert!(
            request(Fixture::Cell, Some(&second))
                .starts_with("Clamp cell B (serial number P45B-17) into the jig, no other cell")
        );
    }

    #[test]
    fn only_the_answer_to_this_question_with_this_cell_counts() {
        let folder = tempfile::tempdir().unwrap();
        let question = Question::new(Fixture::Cell, Some(&second()), "P45B");
        let taken = |answer: &Answer| {
            answer.write(folder.path()).unwrap();
            Answer::take(folder.path(), 7, &question)
        };
        assert_eq!(taken(&answer(6, None)), None);
        for serial in ["P45B-71", "P45B-17\n", " ", &"7".repeat(101)] {
            assert_eq!(taken(&answer(7, Some(serial))), None, "{serial:?}");
        }
        let right = answer(7, Some(" P45B-17 "));
        assert_eq!(taken(&right), Some(right));
        assert_eq!(
            Answer::take(folder.path(), 7, &question),
            None,
            "taken once"
        );
        let scanned = answer(7, Some("0417 8821"));
        assert_eq!(taken(&scanned), Some(scanned));
        let short = Question::new(Fixture::Short, Some(&second()), "P45B");
        assert!(short.check(&answer(7, Some("P45B-17"))).is_err());
    }
}
