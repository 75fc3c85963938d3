//! Standing orders to a bench: hold, drain and stop. The broker stores them, so that a disconnected
//! bench follows them as soon as it is connected again. Nothing here can clear a latch, raise a limit
//! or change a file.

use serde::{Deserialize, Serialize};

/// An order of a person to a bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Said {
    /// Its number.
    pub id: String,
    /// Name of the author.
    pub by: String,
    /// Why.
    pub why: String,
    /// Time by their machine's calendar, s since 1970. For display only, never compared.
    pub unix_s: f64,
}

/// Kind of an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OrderKind {
    /// No run begins; an active run continues.
    Hold,
    /// No further job is taken; jobs of the bench continue.
    Drain,
    /// Ends any active run in safe state, and no run begins afterwards.
    Stop,
    /// Revokes hold, drain and stop of the fleet.
    Release,
}

impl OrderKind {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hold => "hold",
            Self::Drain => "drain",
            Self::Stop => "stop",
            Self::Release => "release",
        }
    }
}

/// Returns the name of a fleet user as the bench's own server records it.
pub fn through_the_fleet(by: &str) -> String {
    format!("fleet: {by}")
}

/// All standing orders of a bench.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Standing {
    /// It is held.
    pub hold: Option<Said>,
    /// It takes no further job.
    pub drain: Option<Said>,
    /// The latest stop that was not revoked.
    pub stop: Option<Said>,
    /// The latest release.
    pub release: Option<Said>,
}

impl Standing {
    /// Returns the standing orders after one more order.
    #[must_use]
    pub fn with(&self, kind: OrderKind, said: Said) -> Self {
        let mut next = self.clone();
        match kind {
            OrderKind::Hold => next.hold = Some(said),
            OrderKind::Drain => next.drain = Some(said),
            OrderKind::Stop => next.stop = Some(said),
            OrderKind::Release => {
                next = Self {
                    release: Some(said),
                    ..Self::default()
                }
            }
        }
        next
    }

    /// Returns whether the bench may take a job.
    pub fn lets_work(&self) -> bool {
        self.hold.is_none() && self.drain.is_none() && self.stop.is_none()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(id: &str) -> Said {
        Said {
            id: id.to_owned(),
            by: "ann".to_owned(),
            why: String::new(),
            unix_s: 0.0,
        }
    }

    #[test]
    fn a_later_order_never_hides_a_stop_and_a_release_takes_all_back() {
        let standing = Standing::default()
            .with(OrderKind::Stop, said("1"))
            .with(OrderKind::Drain, said("2"));
        assert_eq!(standing.stop, Some(said("1")));
        assert!(!standing.lets_work());
        let released = standing.with(OrderKind::Release, said("3"));
        assert!(released.lets_work() && released.stop.is_none());
    }
}
