//! What a person wants of a run that is going on, said from another terminal: to pause, to go on, to end, to do what is left in another order. A small file
//! in the run folder, looked at between points.
//!
//! In virtual time nobody is asked: the run is over in seconds, and played again it must be the same.

use std::path::Path;

use analysis::dataset::{self, DatasetError};
use serde::{Deserialize, Serialize};

/// Its name in the run folder.
const FILE: &str = "wishes.json";

/// To go on or not.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Course {
    /// To go on.
    #[default]
    GoOn,
    /// To wait without any current.
    Pause,
    /// To end in safe state.
    Abort,
}

/// What is wanted.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Wishes {
    /// To go on or not.
    pub course: Course,
    /// Runs of the campaign, by their numbers from 1, that come first, in this order.
    pub order: Vec<usize>,
}

impl Wishes {
    /// What is wanted of the run in a folder. A file that cannot be read says nothing: it must not stop a run.
    pub fn read(folder: &Path) -> Self {
        Self::said(folder).unwrap_or_default()
    }

    /// What is said; nothing where no file is there or none that can be read. Who waits on request goes on waiting then: somebody may be at the jig.
    pub fn said(folder: &Path) -> Option<Self> {
        let text = std::fs::read_to_string(folder.join(FILE)).ok()?;
        serde_json::from_str(&text).inspect_err(|error| tracing::warn!("{FILE}: {error}: not heeded")).ok()
    }

    /// Says what is wanted.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), DatasetError> {
        let text = serde_json::to_string(self).unwrap_or_default();
        dataset::write_atomically(&folder.join(FILE), text.as_bytes())
    }

    /// Nothing is wanted any more.
    pub fn forget(folder: &Path) {
        let _ = std::fs::remove_file(folder.join(FILE));
    }
}

/// What is left, in the order that is wanted: first what is named, then the rest as it was. `number` tells an item's number.
pub fn reorder<T>(left: &mut [T], order: &[usize], number: impl Fn(&T) -> Option<usize>) {
    let place = |item: &T| number(item).and_then(|number| order.iter().position(|wanted| *wanted == number)).unwrap_or(usize::MAX);
    left.sort_by_key(place);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_is_heard_and_a_broken_file_says_nothing() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Wishes::read(folder.path()), Wishes::default());
        let wishes = Wishes { course: Course::Pause, order: vec![3, 1] };
        wishes.write(folder.path()).unwrap();
        assert_eq!(Wishes::read(folder.path()), wishes);
        std::fs::write(folder.path().join(FILE), "{\"course\":\"dance\"}").unwrap();
        assert_eq!(Wishes::read(folder.path()), Wishes::default());
        Wishes::forget(folder.path());
        assert!(!folder.path().join(FILE).exists());
    }

    #[test]
    fn the_named_come_first_and_the_rest_stays() {
        let mut left = vec![2, 3, 4, 5];
        reorder(&mut left, &[5, 9, 3], |item| Some(*item));
        assert_eq!(left, [5, 3, 2, 4]);
        reorder(&mut left, &[], |item| Some(*item));
        assert_eq!(left, [5, 3, 2, 4]);
    }
}
