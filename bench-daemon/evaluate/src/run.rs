//! A run: from a checked experiment to its folder, from the first message to its models.
//!
//! Once the instruments are known to be the configured ones, the bench is brought into a safe
//! state before this returns. This also holds after a panic and after a stop request.

mod auto_resume;
mod drive;
mod inherited;
mod manifest;
mod map_points;
mod measured;
mod multisine;
mod play;
mod recompute;
pub(crate) mod results;
mod resume_context;
mod run_accumulator;
mod session;
mod slope;
mod stop;
mod sweep_writer;
mod traced;

use std::path::Path;

pub use play::ensure_outputs_off;
pub use recompute::{RecomputedPoint, Recorded, RecordedPoint, on_all_cores};
pub use resume_context::{Accepted, ResumeContext, begun_experiment};
pub use slope::{SlopeAtRest, slope_of_spectrum};
pub use stop::{StopSignals, caught};

use bench_core::{safety::failure::Failure, sim::Simulation};

pub use measured::Measured;
pub use multisine::MultisineRun;
pub use session::Session;

/// A completed run.
pub struct Finished {
    /// Measurements of the run.
    pub measured: Measured,
    /// Summary for the terminal.
    pub summary: String,
    /// The simulated world, if there is one in this process.
    pub simulation: Option<Simulation>,
}

impl Finished {
    /// Returns the summary for the terminal, and the verdict of the quality gate.
    pub fn summary_and_verdict(self) -> (String, Result<(), Failure>) {
        let gated = self.gated();
        (self.summary, gated)
    }

    /// Returns an error if the quality gate has refused points, so that the exit code alone shows
    /// it.
    ///
    /// # Errors
    /// [`Failure::Refused`].
    pub fn gated(&self) -> Result<(), Failure> {
        let count = self.measured.refused();
        if count == 0 {
            Ok(())
        } else {
            Err(Failure::Refused { count })
        }
    }
}

/// How a run ends when nothing remains to be done.
pub(super) const FINISHED: &str = "finished";

fn folder_of(path: &Path) -> String {
    path.parent()
        .and_then(Path::file_name)
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}
