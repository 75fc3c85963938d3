//! Run control requests: a person can pause, continue or stop a run from another terminal, or
//! change the order of the rest. A request is a small file in the run folder, which the run reads
//! between points.
//!
//! In virtual time no request is read: the run is over in seconds, and a repeated run must give
//! the same result.

use std::path::Path;

use analysis_files::{
    dataset::{self, DatasetError},
    run_folder::RUN_CONTROL,
};
use serde::{Deserialize, Serialize};

/// Whether to continue.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RunAction {
    /// Continue.
    #[default]
    GoOn,
    /// Pause without any current.
    Pause,
    /// Stop in a safe state.
    Abort,
}

/// Run control request.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunControl {
    /// Whether to continue.
    #[serde(rename = "course")]
    pub action: RunAction,
    /// Runs of the campaign, by their numbers from 1, that come first, in this order.
    pub order: Vec<usize>,
}

impl RunControl {
    /// Reads the run control request in a run folder. A file that cannot be read counts as no
    /// request, because it must not stop a run.
    pub fn read(folder: &Path) -> Self {
        Self::read_if_present(folder).unwrap_or_default()
    }

    /// Reads the request; returns `None` if the file does not exist or cannot be read. In that
    /// case a paused run stays paused, because a person may be working at the jig.
    pub fn read_if_present(folder: &Path) -> Option<Self> {
        let text = std::fs::read_to_string(folder.join(RUN_CONTROL)).ok()?;
        serde_json::from_str(&text)
            .inspect_err(|error| tracing::warn!("{RUN_CONTROL}: {error}: ignored"))
            .ok()
    }

    /// Writes the request.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), DatasetError> {
        let text = serde_json::to_string(self).unwrap_or_default();
        dataset::write_atomically(&folder.join(RUN_CONTROL), text.as_bytes())
    }

    /// Removes the request.
    pub fn forget(folder: &Path) {
        let _ = std::fs::remove_file(folder.join(RUN_CONTROL));
    }
}

/// State of a run of a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunStatus {
    /// Nothing of it remains to be done.
    Finished,
    /// It has begun, and ends before any other run begins.
    InWork,
    /// It has not begun.
    NotBegun,
}

/// Returns the numbers of the next runs in their order, with the `wanted` ones first. `runs`
/// contains all runs, by their numbers.
///
/// # Errors
/// Fails if a number does not belong to a run, occurs twice, or belongs to a run that has begun.
pub fn coming(runs: &[(usize, RunStatus)], wanted: &[usize]) -> Result<Vec<usize>, String> {
    let numbers = |status| {
        runs.iter()
            .filter(move |run| run.1 == status)
            .map(|run| run.0)
    };
    let remaining = in_words(numbers(RunStatus::NotBegun));
    for (place, number) in wanted.iter().enumerate() {
        let status = runs.iter().find(|run| run.0 == *number).map(|run| run.1);
        let found = match status {
            None => format!("{number}, of {} runs", runs.len()),
            Some(_) if wanted[..place].contains(number) => format!("{number} twice"),
            Some(RunStatus::Finished) => format!("{number}, which is finished"),
            Some(RunStatus::InWork) => format!("{number}, which is in work"),
            Some(RunStatus::NotBegun) => continue,
        };
        return Err(format!(
            "expected runs that were not begun, each once, of: {remaining}; found {found}"
        ));
    }
    let rest = numbers(RunStatus::NotBegun).filter(|number| !wanted.contains(number));
    Ok(wanted.iter().copied().chain(rest).collect())
}

/// Formats numbers as text.
pub fn in_words(numbers: impl Iterator<Item = usize>) -> String {
    let words: Vec<String> = numbers.map(|number| number.to_string()).collect();
    if words.is_empty() {
        "none".to_owned()
    } else {
        words.join(", ")
    }
}

/// Sorts the remaining items as requested: first the named ones, then the rest in their old order.
/// `number` gives an item's number.
pub fn reorder<T>(remaining: &mut [T], order: &[usize], number: impl Fn(&T) -> Option<usize>) {
    let place = |item: &T| {
        number(item)
            .and_then(|number| order.iter().position(|wanted| *wanted == number))
            .unwrap_or(usize::MAX)
    };
    remaining.sort_by_key(place);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_and_a_broken_file_says_nothing() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(RunControl::read(folder.path()), RunControl::default());
        let request = RunControl {
            action: RunAction::Pause,
            order: vec![3, 1],
        };
        request.write(folder.path()).unwrap();
        assert_eq!(RunControl::read(folder.path()), request);
        std::fs::write(folder.path().join(RUN_CONTROL), "{\"course\":\"dance\"}").unwrap();
        assert_eq!(RunControl::read(folder.path()), RunControl::default());
        RunControl::forget(folder.path());
        assert!(!folder.path().join(RUN_CONTROL).exists());
    }

    #[test]
    fn an_order_is_of_runs_that_were_not_begun_each_once() {
        use RunStatus::{Finished, InWork, NotBegun};
        let runs = [
            (1, Finished),
            (2, InWork),
            (3, NotBegun),
            (4, NotBegun),
            (5, NotBegun),
        ];
        assert_eq!(coming(&runs, &[5, 3]), Ok(vec![5, 3, 4]));
        for (wanted, found) in [
            (&[99][..], "found 99, of 5 runs"),
            (&[0], "found 0, of 5 runs"),
            (&[3, 3], "found 3 twice"),
            (&[4, 1], "found 1, which is finished"),
            (&[2], "found 2, which is in work"),
        ] {
            let refused = coming(&runs, wanted).unwrap_err();
            assert_eq!(
                refused,
                format!("expected runs that were not begun, each once, of: 3, 4, 5; {found}")
            );
        }
        assert!(
            coming(&[(1, Finished)], &[1])
                .unwrap_err()
                .contains("of: none; found 1, which is finished")
        );
    }

    #[test]
    fn the_named_come_first_and_the_rest_stays() {
        let mut remaining = vec![2, 3, 4, 5];
        reorder(&mut remaining, &[5, 9, 3], |item| Some(*item));
        assert_eq!(remaining, [5, 3, 2, 4]);
        reorder(&mut remaining, &[], |item| Some(*item));
        assert_eq!(remaining, [5, 3, 2, 4]);
    }
}
