//! Finds who has verified that the outputs of a bench are off, once the process of its last run is
//! gone. The run itself says so in its journal. For a run that died the guardian says it, the stop,
//! or a later run that settled it.

use std::{os::unix::fs::MetadataExt, path::Path};

use analysis::run_folder::JOURNAL;

use super::live::StopReport;
use crate::{
    bench::SafeReport,
    safety::guardian::{DRIVES, Report, Status},
    safety::state::State,
};

/// Somebody has read the outputs back as off.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Proof {
    /// Who; none where the run did it itself.
    pub by: Option<&'static str>,
    /// The instruments that were read back; none where nothing of the bench is left outside a
    /// process that has ended.
    roles: Option<Vec<String>>,
}

impl Proof {
    /// Of a bench that was simulated in a process that has ended: it has no outputs any more.
    pub fn nothing_left() -> Self {
        Self {
            by: None,
            roles: None,
        }
    }

    /// Of a stop.
    pub fn of_stop(stop: &StopReport) -> Option<Self> {
        let roles = stop
            .outputs
            .iter()
            .map(|output| output.output.role.clone())
            .collect();
        let proof = Self {
            by: Some("stop"),
            roles: Some(roles),
        };
        stop.proven().then_some(if stop.simulated {
            Self::nothing_left()
        } else {
            proof
        })
    }

    /// Of a run whose process is gone, from what its guardian and others have written down.
    pub fn after(state: &State, run: &Path) -> Option<Self> {
        let drives = || Some(DRIVES.map(str::to_owned).to_vec());
        let guardian = Report::read(state);
        if let Some(report) = guardian
            .as_ref()
            .filter(|report| same(Path::new(&report.run), run))
        {
            match report.status {
                // An older guardian does not say what it has read back: everything that it guards.
                // A bath that it did not reach is not among it.
                Status::Verified | Status::BathNotReached => {
                    let verified = |safe: &SafeReport| {
                        safe.outputs
                            .iter()
                            .filter(|output| output.verified())
                            .map(|output| output.role.clone())
                            .collect()
                    };
                    let read = report.safe.as_ref().map(verified);
                    return Some(Self {
                        by: Some("guardian"),
                        roles: read.or_else(drives),
                    });
                }
                // By the run itself, whose transcripts tell what each instrument said.
                Status::Dismissed => {
                    return Some(Self {
                        by: None,
                        roles: Some(Vec::new()),
                    });
                }
                Status::Watching | Status::SwitchingOff => {}
            }
        }
        // No run begins, and no guardian with it, before what the one before has left is settled.
        let written_s = std::fs::metadata(run.join(JOURNAL))
            .map_or(f64::INFINITY, |meta| meta.mtime() as f64 + 1.0);
        let later = guardian
            .is_some_and(|report| !same(Path::new(&report.run), run) && report.unix_s > written_s);
        let settled = state
            .last_settled()
            .is_some_and(|settled| same(&settled.run, run));
        (later || settled).then(|| Self {
            by: Some("safe"),
            roles: drives(),
        })
    }

    /// Whether an instrument is among those that were read back.
    pub fn covers(&self, role: &str) -> bool {
        self.roles
            .as_ref()
            .is_none_or(|roles| roles.iter().any(|one| one == role))
    }
}

/// However a folder is reached, it is one.
fn same(one: &Path, other: &Path) -> bool {
    let whole = |path: &Path| {
        std::fs::canonicalize(path)
            .or_else(|_| std::path::absolute(path))
            .ok()
    };
    whole(one).is_some_and(|one| Some(one) == whole(other))
}
