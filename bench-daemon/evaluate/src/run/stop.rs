//! Ends of a run that must lead to a safe state although they come from outside or from a bug:
//! signals and panics.

use std::{panic::AssertUnwindSafe, task::Poll};

use tokio::signal::unix::{Signal, SignalKind, signal};

use bench_core::safety::failure::Failure;

/// Number of the signal that Ctrl-Z sends, on Linux.
const SIGTSTP: i32 = 20;

/// Ctrl-C, a termination signal, or the end of the terminal: each brings the bench into a safe
/// state.
pub struct StopSignals([Signal; 5]);

impl StopSignals {
    /// Installs handlers, so that these signals no longer end the process directly.
    ///
    /// # Errors
    /// Fails if the system refuses: a run that cannot be stopped must not begin.
    pub fn install() -> std::io::Result<Self> {
        // Ctrl-Z would stop the watching while the current flows: it ends the run like Ctrl-C.
        let suspend = SignalKind::from_raw(SIGTSTP);
        let [interrupt, terminate, hangup, quit, suspend] = [
            SignalKind::interrupt(),
            SignalKind::terminate(),
            SignalKind::hangup(),
            SignalKind::quit(),
            suspend,
        ]
        .map(signal);
        Ok(Self([interrupt?, terminate?, hangup?, quit?, suspend?]))
    }

    /// Checks whether a signal has arrived since the installation or since the last check.
    pub(crate) async fn came(&mut self) -> bool {
        tokio::select! {
            biased;
            () = self.requested() => true,
            () = std::future::ready(()) => false,
        }
    }

    /// Waits for the first of them.
    pub async fn requested(&mut self) {
        let [interrupt, terminate, hangup, quit, suspend] = &mut self.0;
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hangup.recv() => {}
            _ = quit.recv() => {}
            _ = suspend.recv() => {}
        }
    }
}

/// Converts a panic to a failure, so that the outputs are switched off as after any other failure.
pub async fn caught<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let mut work = Box::pin(work);
    std::future::poll_fn(move |context| {
        std::panic::catch_unwind(AssertUnwindSafe(|| work.as_mut().poll(context))).unwrap_or_else(
            |panic| {
                let text = panic
                    .downcast_ref::<String>()
                    .cloned()
                    .or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
                Poll::Ready(Err(Failure::Panic(text.unwrap_or_default())))
            },
        )
    })
    .await
}

#[cfg(test)]
mod tests {
    use instruments::clock::{Clock, TimeMode};

    use super::*;

    #[test]
    fn a_panic_becomes_a_failure() {
        let runtime = Clock::runtime(TimeMode::Real).unwrap();
        let outcome: Result<(), Failure> =
            runtime.block_on(caught(async { panic!("out of range") }));
        assert!(
            matches!(&outcome, Err(Failure::Panic(text)) if text == "out of range"),
            "{outcome:?}"
        );
    }
}
