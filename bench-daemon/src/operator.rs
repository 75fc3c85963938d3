//! The person at the bench, asked on the terminal to change the fixture.

use std::io::{BufRead, IsTerminal, Write};

use instruments::mock::plant::Fixture;

/// A person who could not be asked, or did not confirm.
#[derive(Debug, thiserror::Error)]
pub enum OperatorError {
    /// No terminal.
    #[error("a person must change the fixture ([instruments.jig] model = \"person\"), but standard input is no terminal: run on one")]
    NoTerminal,
    /// Something else than `done` was typed.
    #[error("expected `done` after the fixture was changed, found {0:?}")]
    NotConfirmed(String),
}

/// How the person is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operator {
    /// On the terminal.
    Terminal,
    /// There is nobody.
    Nobody,
}

impl Operator {
    /// The terminal, where there is one.
    pub fn detect() -> Self {
        if std::io::stdin().is_terminal() { Self::Terminal } else { Self::Nobody }
    }

    /// Asks for a fixture and waits until it is confirmed. Every output is off.
    ///
    /// # Errors
    /// Nobody there; not confirmed.
    pub async fn mount(&self, fixture: Fixture) -> Result<(), OperatorError> {
        if *self == Self::Nobody {
            return Err(OperatorError::NoTerminal);
        }
        let text = match fixture {
            Fixture::Cell => "Clamp the cell into the jig, voltage probes C3 (−) and C4 (+) on its Kelvin contacts.",
            Fixture::Shunt => "Clamp the fake cell into the jig and put the voltage probes C3 and C4 on the shunt, beside C1 and C2.",
            Fixture::FakeCell => "Clamp the fake cell into the jig, voltage probes C3 (−) and C4 (+) on its Kelvin contacts.",
        };
        // Waiting for a person blocks a thread of its own; the bench is off meanwhile.
        let answer = tokio::task::spawn_blocking(move || {
            eprint!("\n{text}\nAll outputs are off. Type `done` when it is so: ");
            let _ = std::io::stderr().flush();
            let mut line = String::new();
            let _ = std::io::stdin().lock().read_line(&mut line);
            line.trim().to_owned()
        })
        .await
        .unwrap_or_default();
        if answer == "done" { Ok(()) } else { Err(OperatorError::NotConfirmed(answer)) }
    }
}
