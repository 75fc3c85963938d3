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
    /// Nobody has verified that the outputs of a bench are off.
    Unverified,
    /// A person is to change the fixture of a bench, and a run waits for it.
    Question,
    /// A run has ended.
    End,
    /// Somebody tries whether notices arrive.
    Test,
}

impl About {
    /// Whether it is told in quiet hours: a bench that waits with every output off waits until
    /// morning.
    pub fn is_urgent(self) -> bool {
        !matches!(self, Self::End | Self::Question)
    }
}

/// A notice.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub struct Notice {
    /// Its number since the server began.
    pub number: u64,
    /// When, s since 1970.
    pub unix_s: f64,
    /// Subject.
    pub about: About,
    /// The bench; none for a test.
    pub bench: Option<String>,
    /// One line.
    pub title: String,
    /// The rest.
    pub text: String,
    /// Outcome by target.
    pub outcome: BTreeMap<String, String>,
}

/// Notices of a server.
#[derive(Debug)]
pub struct Notices {
    latest: Mutex<VecDeque<Notice>>,
    /// Places for notices that are just being sent.
    pub sending: Semaphore,
    /// A test is under way.
    pub testing: Semaphore,
}

/// Notices that are sent at the same time.
const AT_ONCE: usize = 4;

impl Default for Notices {
    fn default() -> Self {
        Self {
            latest: Mutex::default(),
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

    /// Remembers a notice that is to be sent.
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

    /// Notes the outcome of a notice at a target.
    pub fn outcome(&self, number: u64, target: &'static str, words: String) {
        let mut latest = self.lock();
        if let Some(notice) = latest.iter_mut().find(|notice| notice.number == number) {
            notice.outcome.insert(target.to_owned(), words);
        }
    }
}
