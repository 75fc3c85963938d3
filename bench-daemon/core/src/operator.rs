//! The person at the bench, who is asked to change the fixture: on the terminal of the run, or
//! through the run folder, with the answer from a command or the page.

pub mod progress;
pub mod question;
pub mod run_control;

use std::{
    io::{BufRead, IsTerminal},
    path::Path,
};

use bench_plan::support::{account::who, terminal::remark};
use question::{Answer, Question};

/// Environment variable; if it is set to [`BY_FOLDER`], questions are answered through the run
/// folder.
pub const OPERATOR_VARIABLE: &str = "EIS_BENCH_OPERATOR";
/// Value of [`OPERATOR_VARIABLE`].
pub const BY_FOLDER: &str = "run-folder";

/// A person could not be asked or did not confirm.
#[derive(Debug, thiserror::Error)]
pub enum OperatorError {
    /// Standard input is not a terminal.
    #[error(
        "a person must change the fixture ([instruments.jig] model = \"person\"), but standard \
        input is not a terminal: run on one, or set {OPERATOR_VARIABLE}={BY_FOLDER} and answer \
        with `eis-bench answer` or on the page"
    )]
    NoTerminal,
    /// The input ended before the change was confirmed.
    #[error("expected `done` after the fixture was changed, found the end of the input")]
    NotConfirmed,
}

/// How the person is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operator {
    /// On the terminal.
    Terminal,
    /// Through the run folder.
    Folder,
    /// No person can be asked.
    Nobody,
}

impl Operator {
    /// Returns the run folder if it is configured, otherwise the terminal, if there is one.
    pub fn detect() -> Self {
        if std::env::var_os(OPERATOR_VARIABLE).is_some_and(|value| value == BY_FOLDER) {
            Self::Folder
        } else if std::io::stdin().is_terminal() {
            Self::Terminal
        } else {
            Self::Nobody
        }
    }

    /// Asks the question with this number, and waits for the confirmation.
    ///
    /// # Errors
    /// Fails if no person can be asked or the change is not confirmed.
    pub async fn ask(
        &self,
        question: &Question,
        number: u64,
        folder: &Path,
    ) -> Result<Answer, OperatorError> {
        match self {
            Self::Nobody => Err(OperatorError::NoTerminal),
            Self::Folder => question::answered(folder, number, question)
                .await
                .ok_or(OperatorError::NotConfirmed),
            Self::Terminal => {
                on_terminal(question).await?;
                Ok(Answer {
                    question: number,
                    by: who(),
                    serial: None,
                })
            }
        }
    }
}

/// Asks on the terminal, and waits for the confirmation there. Every output is off.
///
/// # Errors
/// Fails without a terminal, or if the change is not confirmed.
pub async fn on_terminal(question: &Question) -> Result<(), OperatorError> {
    if !std::io::stdin().is_terminal() {
        return Err(OperatorError::NoTerminal);
    }
    let text = question.text.clone();
    // Waiting for a person blocks a separate thread; the bench is off meanwhile.
    let ask = move || {
        let mut line = String::new();
        remark!(
            "\n{text}\nAll outputs that the program switches are off, but an output that is off is not \
            an open switch: mind the terminals. Type `done` when it is done:"
        );
        // The end of the input also ends the wait: the person has left.
        while std::io::stdin()
            .lock()
            .read_line(&mut line)
            .is_ok_and(|read| read > 0)
        {
            if line.trim() == "done" {
                return Ok(());
            }
            remark!(
                "expected `done`, found {:?}; Ctrl-C stops the run",
                line.trim()
            );
            line.clear();
        }
        Err(OperatorError::NotConfirmed)
    };
    tokio::task::spawn_blocking(ask)
        .await
        .unwrap_or(Err(OperatorError::NotConfirmed))
}
