//! Settings that stand: they were sent and read back, and need not be sent again. Each is read back
//! in turn instead, so that a change by a hand at the panel is found. How a record is sent is not
//! read back in turn, because the descriptor of each record shows it.

use super::Expect;

/// The last settings of an instrument, and the last commands without a read-back.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Standing {
    answers: Vec<Answered>,
    commands: Vec<String>,
    /// Number of the next setting to be read back.
    turn: usize,
    /// Points of the memory of which a record was sent last, every point.
    pub(crate) sent_points: Option<u64>,
}

/// A query with the answer that it must give.
#[derive(Debug, Clone, PartialEq)]
struct Answered {
    question: String,
    expect: Expect,
    /// Whether it is read back in turn.
    in_turn: bool,
}

impl Standing {
    /// Checks whether a query still has to give this answer.
    pub(super) fn has(&self, question: &str, expect: &Expect) -> bool {
        self.answers
            .iter()
            .any(|known| known.question == question && known.expect == *expect)
    }

    /// Checks whether a command was the last one with its header.
    pub(super) fn said(&self, command: &str) -> bool {
        self.commands.iter().any(|known| known == command)
    }

    /// Remembers what a query has to answer from now on.
    pub(super) fn set(&mut self, question: &str, expect: &Expect, in_turn: bool) {
        self.answers.retain(|known| known.question != question);
        self.answers.push(Answered {
            question: question.to_owned(),
            expect: expect.clone(),
            in_turn,
        });
    }

    /// Remembers a command, which replaces the one with its header.
    pub(super) fn say(&mut self, command: &str) {
        let header = |text: &str| text.split(' ').next().map(str::to_owned);
        let own = header(command);
        self.commands.retain(|known| header(known) != own);
        self.commands.push(command.to_owned());
    }

    /// Forgets everything, so that all of it is sent again.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Returns the next setting to be read back, counted round.
    pub(super) fn next(&mut self) -> Option<(String, Expect)> {
        let in_turn = || self.answers.iter().filter(|known| known.in_turn);
        let Answered {
            question, expect, ..
        } = in_turn().nth(self.turn % in_turn().count().max(1))?;
        self.turn = self.turn.wrapping_add(1);
        Some((question.clone(), expect.clone()))
    }
}
