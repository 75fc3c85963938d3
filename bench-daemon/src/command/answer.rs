//! `eis-bench answer`: shows the question of a run that waits for a person, and answers it.

use std::path::{Path, PathBuf};

use clap::Args;
use instruments::clock::{Clock, TimeMode};

use bench_core::{
    journal::{self, Entry, pending_question},
    operator::question::Answer,
    safety::failure::Failure,
};
use bench_plan::support::{account::who, terminal::say};

/// Number of checks for the entry of an answer, and the interval between two of them, s. Together
/// they last twice as long as a slow bench needs to be read back as off.
const LOOKS: usize = 40;
const LOOK_S: f64 = 0.25;

/// Arguments of `answer`.
#[derive(Debug, Args)]
pub struct AnswerArgs {
    /// The run folder.
    pub folder: PathBuf,
    /// Confirm that the fixture is changed as asked: the run continues, and current may flow.
    #[arg(long, requires = "question")]
    pub done: bool,
    /// Number of the question that is answered; refused if another question is open.
    #[arg(long, value_name = "N", requires = "done")]
    pub question: Option<u64>,
    /// Serial number read from the cell; refused if it is not that of the requested cell.
    #[arg(long, value_name = "TEXT", requires = "done")]
    pub serial: Option<String>,
    /// Who answers [default: the account]
    #[arg(long, value_name = "NAME", requires = "done")]
    pub by: Option<String>,
}

/// Shows the question, or answers it.
///
/// # Errors
/// A folder without an active run; no question; a question or a cell that differs from the
/// requested one.
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
        let folder = args.folder.display();
        say!("every output that the program switches is off; when it is changed as asked:");
        say!("eis-bench answer {folder} --done --question {number}");
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
    if taken(&args.folder, number)? {
        say!("the answer is taken: the run goes on");
    } else {
        say!("the answer is handed over; the run has not taken it yet");
    }
    Ok(())
}

/// Waits until a run has accepted the answer to a question, for [`LOOKS`] checks at most.
fn taken(folder: &Path, number: u64) -> Result<bool, Failure> {
    let is_taken = || {
        let lines = journal::read(folder).map(|read| read.lines);
        lines.is_ok_and(|lines| {
            lines.iter().rev().any(
                |line| matches!(&line.entry, Entry::Answered(answer) if answer.question == number),
            )
        })
    };
    Clock::runtime(TimeMode::Real)?.block_on(async {
        let clock = Clock::start(TimeMode::Real);
        for _ in 0..LOOKS {
            if is_taken() {
                return Ok(true);
            }
            clock.sleep_s(LOOK_S).await;
        }
        Ok(false)
    })
}
