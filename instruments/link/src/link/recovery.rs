//! Resynchronises a link with its instrument if the transport can do more than drop the connection:
//! a device clear, then a query whose reply cannot be mistaken for another.
//!
//! A device clear leaves settings alone (IEEE 488.2, clause 5.8). An instrument that ignores it, or
//! a transport that has none, still replies in order: everything that arrives before the reply to
//! the latest query belongs to earlier queries and is discarded.

use instruments_scpi::{excerpt, status, text_of};

use super::{connection::Connection, conversation::Conversation, error::LinkError};
use crate::{
    clock::Clock,
    link::Grammar,
    transcript::{Direction, Payload},
};

/// Answers to earlier questions that are thrown away before the instrument is given up.
const MOST_STALE: usize = 4;
/// Bit of the status byte: an answer is waiting (IEEE 488.2, clause 11.2.1.2).
const MESSAGE_AVAILABLE: u8 = 0x10;
const IDENTITY: &str = "*IDN?";
/// Completion query, for instruments whose identity query was not answered and that have no error
/// queue. Its reply is `1`.
const COMPLETION: &str = "*OPC?";

impl Conversation {
    /// Puts a connection on which an exchange failed, or one in its place, back into use.
    pub(super) async fn recover(&mut self, mut connection: Connection) -> Result<(), LinkError> {
        self.clear(&mut connection).await?;
        if self.options.profile.grammar == Grammar::Scpi {
            self.ask_something_else(&mut connection).await?;
        }
        if self.has_answer_waiting(&mut connection).await? {
            return Err(self.not_cleared("no answer waiting", "an unexpected one".to_owned()));
        }
        self.connection = Some(connection);
        self.remark("in step again after a device clear");
        for entry in self.drain_errors().await? {
            self.remark(&format!("left in the error queue: {entry}"));
        }
        Ok(())
    }

    /// Discards an answer that an earlier client left unread, so that it is not taken for the
    /// answer to the first question. Touches the instrument only if there is something.
    pub(super) async fn leave_nothing_behind(
        &self,
        connection: &mut Connection,
    ) -> Result<(), LinkError> {
        match connection.can_be_cleared() && self.has_answer_waiting(connection).await? {
            true => self.clear(connection).await,
            false => Ok(()),
        }
    }

    async fn clear(&self, connection: &mut Connection) -> Result<(), LinkError> {
        let deadline = self.options.profile.first_timeout;
        let cleared = self.clock().deadline(deadline, connection.clear()).await;
        let late = |_| self.not_cleared("an acknowledgement", format!("none within {deadline:?}"));
        cleared
            .map_err(late)?
            .map_err(|broken| self.error(broken, "device clear"))
    }

    async fn has_answer_waiting(&self, connection: &mut Connection) -> Result<bool, LinkError> {
        let deadline = self.options.profile.first_timeout;
        let polled = self
            .clock()
            .deadline(deadline, connection.status_byte())
            .await;
        let late = |_| self.not_cleared("a status byte", format!("none within {deadline:?}"));
        let byte = polled
            .map_err(late)?
            .map_err(|broken| self.error(broken, "status byte"))?;
        Ok(byte.is_some_and(|byte| byte & MESSAGE_AVAILABLE != 0))
    }

    /// Sends a query whose reply cannot be mistaken for the reply to the failed query, and waits
    /// until it arrives.
    async fn ask_something_else(&mut self, connection: &mut Connection) -> Result<(), LinkError> {
        let profile = self.options.profile;
        let in_vain = self.asked.to_ascii_uppercase().contains(IDENTITY);
        let question = if in_vain {
            profile.error_query.unwrap_or(COMPLETION)
        } else {
            IDENTITY
        };
        self.hand_over(connection, question).await?;
        let clock: Clock = self.clock().clone();
        let mut found = String::new();
        for _ in 0..=MOST_STALE {
            let timed_out = |_| LinkError::Timeout {
                link: self.link(),
                message: question.to_owned(),
                deadline: profile.first_timeout,
            };
            let read = clock
                .deadline(
                    profile.first_timeout,
                    connection.read_whole(profile.first_timeout),
                )
                .await
                .map_err(timed_out)?;
            let message = read.map_err(|broken| self.error(broken, question))?;
            let text = text_of(&message).trim().to_owned();
            let fits = match question {
                IDENTITY => self.is_identity(&text),
                COMPLETION => text == "1",
                _ => status::parse_error(&text).is_ok(),
            };
            let direction = if fits {
                Direction::Received
            } else {
                Direction::Unsolicited
            };
            self.record(direction, Payload::Text(excerpt(&message)));
            if fits {
                return Ok(());
            }
            found = excerpt(&message);
        }
        Err(self.not_cleared(&format!("an answer to `{question}`"), format!("`{found}`")))
    }

    fn is_identity(&self, text: &str) -> bool {
        match &self.identity {
            Some(known) => known.trim() == text,
            None => looks_like_identity(text, &self.asked),
        }
    }

    fn not_cleared(&self, expected: &str, found: String) -> LinkError {
        LinkError::NotCleared {
            link: self.link(),
            expected: expected.to_owned(),
            found,
        }
    }
}

/// Returns whether a text may be an identity (IEEE 488.2, clause 10.14: fields separated by commas,
/// the maker first), and not a late list that answers `asked`. A maker's name may contain a blank;
/// the header of a reply contains colons, or is that of the query.
fn looks_like_identity(text: &str, asked: &str) -> bool {
    let maker = text.split(',').next().unwrap_or_default();
    let word = maker.split_whitespace().next().unwrap_or_default();
    let header = asked
        .split_whitespace()
        .next()
        .unwrap_or_default()
        .trim_end_matches('?');
    text.matches(',').count() >= 2
        && text.starts_with(|first: char| first.is_ascii_alphabetic())
        && !maker.contains([':', '?'])
        && !word.eq_ignore_ascii_case(header)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_list_is_not_an_identity() {
        for (text, asked, fits) in [
            (
                "Siglent Technologies,SDG1032X,SDG1XCAQ1R0001,1.01.01.33R1B6",
                "C1:BSWV?",
                true,
            ),
            ("HEWLETT-PACKARD,34970A,0,13-2-2", "ROUT:SCAN?", true),
            ("C1:BSWV WVTP,SINE,FRQ,1000HZ,AMP,4V", "C1:BSWV?", false),
            // Late by more than one question.
            ("C1:BSWV WVTP,SINE,FRQ,1000HZ,AMP,4V", "C2:OUTP?", false),
            ("TRSE EDGE,SR,C1,HT,OFF", "TRSE?", false),
            ("1.0,2.0,3.0", "MEAS?", false),
            ("ON,LOAD", "OUTP?", false),
        ] {
            assert_eq!(looks_like_identity(text, asked), fits, "{text}");
        }
    }
}
