//! The latest notices, and what came of each.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Mutex, MutexGuard, PoisonError},
};

use instruments::clock;
use serde::{Deserialize, Serialize};
use tokio::sync::Semaphore;
use utoipa::ToSchema;

/// Notices that are remembered.
const REMEMBERED: usize = 100;

/// Subject of a notice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum About {
    /// A bench has tripped and is latched.
    Trip,
    /// The outputs of a bench were not read back as off.
    Unverified,
    /// A person must change the fixture of a bench; a run waits for it.
    Question,
    /// A run has ended.
    End,
    /// A person tests whether notices arrive.
    Test,
}

impl About {
    /// Returns whether it is sent in quiet hours. A bench that waits with all outputs off can
    /// wait until morning.
    pub fn is_urgent(self) -> bool {
        !matches!(self, Self::End | Self::Question)
    }
}

/// A notice.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub struct Notice {
    /// Its number since the start of the server.
    pub number: u64,
    /// Time, s since 1970.
    pub unix_s: f64,
    /// Subject.
    pub about: About,
    /// The bench; null for a test.
    pub bench: Option<String>,
    /// Title, one line.
    pub title: String,
    /// Text.
    pub text: String,
    /// Outcome by target.
    pub outcome: BTreeMap<String, String>,
}

/// Names of the targets.
pub const WEBHOOK: &str = "webhook";
/// See [`WEBHOOK`].
pub const EMAIL: &str = "e-mail";

/// Notices of a server.
#[derive(Debug)]
pub struct Notices {
    latest: Mutex<VecDeque<Notice>>,
    /// Attempts to send, by target: failed ones, and successful ones.
    tries: Mutex<BTreeMap<&'static str, [u64; 2]>>,
    /// Places for notices that are just being sent.
    pub sending: Semaphore,
    /// A test is under way.
    pub testing: Semaphore,
}

/// Maximum number of notices that are sent at the same time.
const AT_ONCE: usize = 4;

impl Default for Notices {
    fn default() -> Self {
        Self {
            latest: Mutex::default(),
            tries: Mutex::new([(WEBHOOK, [0; 2]), (EMAIL, [0; 2])].into()),
            sending: Semaphore::new(AT_ONCE),
            testing: Semaphore::new(1),
        }
    }
}

impl Notices {
    fn lock(&self) -> MutexGuard<'_, VecDeque<Notice>> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The latest first.
    pub fn list(&self) -> Vec<Notice> {
        self.lock().iter().rev().cloned().collect()
    }

    /// Stores a notice that is due to be sent.
    pub fn add(&self, about: About, bench: Option<&str>, title: String, text: String) -> Notice {
        let mut latest = self.lock();
        let notice = Notice {
            number: latest.back().map_or(1, |notice| notice.number + 1),
            unix_s: clock::unix_time_s(),
            about,
            bench: bench.map(str::to_owned),
            title,
            text,
            outcome: BTreeMap::new(),
        };
        latest.push_back(notice.clone());
        if latest.len() > REMEMBERED {
            latest.pop_front();
        }
        notice
    }

    /// Counts a try.
    pub fn tried(&self, target: &'static str, succeeded: bool) {
        let mut tries = self.tries.lock().unwrap_or_else(PoisonError::into_inner);
        tries.entry(target).or_default()[usize::from(succeeded)] += 1;
    }

    /// Returns the attempts by target: failed ones, and successful ones.
    pub fn tries(&self) -> BTreeMap<&'static str, [u64; 2]> {
        self.tries
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Notes the outcome of a notice at a target.
    pub fn outcome(&self, number: u64, target: &'static str, words: String) {
        let mut latest = self.lock();
        if let Some(notice) = latest.iter_mut().find(|notice| notice.number == number) {
            notice.outcome.insert(target.to_owned(), words);
        }
    }
}
