//! `eis-bench doctor`: checks a bench before its first use, and after each change of it.
//!
//! Checks without current come first: the machine, the instruments, their limits with every output
//! off. Then a person clamps a control in the place of the cell. Half an ampere verifies drive,
//! meters, probes, limits and safe state. After a failure that makes the next check unsafe,
//! nothing is energised any more. The bench always ends in a safe state.

use ::instruments::units::Volts;

mod examination;
mod findings;
pub mod fixture_check;
mod instruments;
mod lease;
mod live;
mod machine;
mod probes;
mod report;
mod scope;
mod standing;
mod steps;

use ::instruments::{clock::Clock, fixture::Fixture};

pub use findings::{Check, Findings, Texts, Verdict};
pub use instruments::reached;
pub use lease::{hold, lease};
pub use machine::{free, machine};
pub use report::{Instrument, Outcome, Report, write};
pub use standing::{REPORT, standing};

use bench_core::bench::{Bench, BenchError};
use bench_plan::config;
pub use examination::Examination;

/// Checks with current, in this order.
pub const LIVE: [&str; 16] = [
    "fixture.no_cell",
    "zero.current",
    "scope.noise",
    "scope.offset",
    "drive.first",
    "meters.ammeter",
    "probes.current_pair",
    "probes.voltage_pair",
    "probes.swapped",
    "drive.gain",
    "meters.voltmeter",
    "drive.sine",
    "scope.timebase",
    "limit.bipolar",
    "limit.charger",
    "safe.state",
];

/// Voltages that a guardian may find at a jig with copper in it, V.
pub const COPPER_WINDOW_V: (Volts, Volts) = (Volts(-1.0), Volts(1.0));

impl<'a> Examination<'a> {
    /// Begins with an open bench and the findings about the machine.
    pub fn new(config: &'a config::Bench, clock: Clock, bench: Bench, findings: Findings) -> Self {
        let scope = scope::Ranges::new(&config.wiring.scale_per_ampere_v);
        Self {
            config,
            clock,
            bench,
            findings,
            scope,
            zero_v: [0.0; 4],
        }
    }

    /// Checks limits with every output off, then everything that needs a current, if a fixture is
    /// in the jig. Afterwards the state of the outputs is unknown.
    pub async fn examine(&mut self, fixture: Option<Fixture>, why_not: &str) {
        let outcome = self.off().await;
        self.add_failure(outcome);
        let mut why = why_not.to_owned();
        if let Some(fixture) = fixture {
            if self.findings.stopped().is_none() {
                let outcome = self.live(fixture).await;
                self.add_failure(outcome);
            }
            if let Some(stopped) = self.findings.stopped() {
                why = format!("not after {stopped}");
            }
        }
        let done = |id: &str| self.findings.checks.iter().any(|check| check.id == id);
        let left: Vec<&str> = LIVE.into_iter().filter(|id| !done(id)).collect();
        self.findings.skip(&left, &why, "");
    }

    fn add_failure(&mut self, outcome: Result<(), BenchError>) {
        if let Err(error) = outcome {
            let advice = "see that the instrument answers and obeys, then begin again";
            self.findings.add(
                "instrument",
                Texts {
                    expected: "an instrument that answers and obeys",
                    met: error.to_string(),
                },
                Verdict::Fail,
                advice,
            );
            self.findings.stop();
        }
    }
}
