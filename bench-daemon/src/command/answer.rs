//! `eis-bench answer`: shows the question of a run that waits for a person, and answers it.

use std::path::PathBuf;

use clap::Args;

use crate::{
    journal::{self, pending_question},
    operator::question::Answer,
    safety::failure::Failure,
    support::{account::who, terminal::say},
};

/// Arguments of `answer`.
#[derive(Debug, Args)]
pub struct AnswerArgs {
    /// The run folder.
    pub folder: PathBuf,
    /// The fixture is changed as asked: the run may go on, and let current flow.
    #[arg(long)]
    pub done: bool,
    /// Number of the question that is answered: refused where another one waits.
    #[arg(long, value_name = "N", requires = "done")]
    pub question: Option<u64>,
    /// Serial number read from the cell: refused where it is not that of the cell asked for.
    #[arg(long, value_name = "TEXT", requires = "done")]
    pub serial: Option<String>,
    /// Who answers [default: the account]
    #[arg(long, value_name = "NAME", requires = "done")]
    pub by: Option<String>,
}

/// Shows the question, or answers it.
///
/// # Errors
/// A folder in which nothing runs; no question; another question, or another cell, than is asked for.
pub fn answer(args: &AnswerArgs) -> Result<(), Failure> {
    let usage = |text: String| Failure::Usage(format!("{}: {text}", args.folder.display()));
    let lines = journal::read(&args.folder)
        .map_err(|error| Failure::Usage(error.to_string()))?
        .lines;
    let (number, question) = pending_question(&lines)
        .filter(|_| journal::is_written(&args.folder))
        .ok_or_else(|| usage("expected a run that asks a person, found no question".to_owned()))?;
    if question.on_terminal {
        let text = format!("question {number} is asked on the terminal of the run: answer there");
        return Err(usage(text));
    }
    if !args.done {
        say!("question {number}: {}", question.text);
        say!("every output is off; with --done the run goes on");
        return Ok(());
    }
    if let Some(other) = args.question.filter(|other| *other != number) {
        let text = format!("question: expected {number}, which waits, found {other}");
        return Err(usage(text));
    }
    let answer = Answer {
        question: number,
        by: args.by.clone().unwrap_or_else(who),
        serial: args.serial.clone(),
    };
    question.check(&answer).map_err(usage)?;
    answer
        .write(&args.folder)
        .map_err(|error| usage(error.to_string()))?;
    say!("the run goes on");
    Ok(())
}
