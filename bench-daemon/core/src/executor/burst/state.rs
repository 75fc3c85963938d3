//! How long the generator's signal continues on its own.

use instruments::units::{Amps, Seconds};

use super::super::ExecuteError;
use bench_plan::{
    interlock::{NO_CURRENT_A, Reading},
    plan::{IDLE_CURRENT_A, LEEWAY_S},
};

/// How long the generator's signal continues on its own.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Burst {
    /// Earliest end of the signal, bench s.
    pub ends_s: Seconds,
    /// Latest end of the signal, bench s.
    pub(super) ended_s: Seconds,
    pub(super) leeway_s: Seconds,
    /// Whether the generator is in burst mode.
    pub(super) on: bool,
    /// Whether the generator did not execute the burst command.
    pub refused: bool,
}

impl Default for Burst {
    fn default() -> Self {
        Self {
            ends_s: Seconds::INFINITY,
            ended_s: Seconds::INFINITY,
            leeway_s: LEEWAY_S,
            on: false,
            refused: false,
        }
    }
}

impl Burst {
    /// Checks that nothing but the direct current is read after the signal must have ended.
    ///
    /// # Errors
    /// [`ExecuteError::Disobeyed`].
    pub(crate) fn over(&self, reading: &Reading, steady_a: Amps) -> Result<(), ExecuteError> {
        let nothing_a = IDLE_CURRENT_A + NO_CURRENT_A;
        let Some(amps) = reading
            .current_a
            .filter(|amps| reading.time_s > self.ended_s && (*amps - steady_a).abs() > nothing_a)
        else {
            return Ok(());
        };
        let expected = format!(
            "its burst to have ended {:.1} s ago",
            (reading.time_s - self.ended_s).0
        );
        Err(ExecuteError::Disobeyed {
            what: "generator".to_owned(),
            expected,
            met: format!("{amps:.3}"),
        })
    }
}
