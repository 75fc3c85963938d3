//! Script that a dialect returns to its role: messages, each with a condition that must hold after
//! it. The role runs it on the link.
//!
//! A dialect is synchronous and sends nothing, so that the exact texts for an instrument can be
//! printed, tested and read beforehand.

mod expect;
mod identity;
mod optional;
mod setting_text;
mod standing;

pub use expect::{Expect, after_header, field, hex_word, leading_number, plain};
pub use identity::{Identity, fold};
pub use optional::NOT_KNOWN;
pub use setting_text::{CHOSEN, ON_OFF, Says, Setting, Shows};
pub use standing::Standing;

use instruments_link::link::{Link, LinkError};
use instruments_scpi::message::Command;

use setting_text::Differs;

/// One message with the check of its effect.
///
/// ```
/// use instruments_drivers::exchange::Exchange;
///
/// let exchange = Exchange::fixed("CURR", 1.5, 3, 1.0e-3);
/// let Exchange::Set { message, read_back, expect } = exchange else {
///     panic!("a finite number can be sent");
/// };
/// assert_eq!((message.as_str(), read_back.as_str()), ("CURR 1.500", "CURR?"));
/// assert!(expect.judge("1.5004E+00").is_ok());
/// assert!(expect.judge("1.6").is_err());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum Exchange {
    /// A message without a read-back. The error queue is queried if the instrument has one.
    Send(String),
    /// Sent, then read back.
    Set {
        /// The command.
        message: String,
        /// The query that reads the effect back.
        read_back: String,
        /// Condition that the answer must meet.
        expect: Expect,
    },
    /// Bytes after a header, sent unchanged; their effect shows in later read-backs. They must
    /// contain no byte that ends a message.
    Data {
        /// The message up to its data.
        head: String,
        /// The data.
        data: Vec<u8>,
    },
    /// A command that the instrument itself answers, as in protocols with a confirmation.
    Ask {
        /// The command.
        message: String,
        /// Condition that the answer must meet.
        expect: Expect,
        /// The query that reads the effect back, and its expected reply; `None` if the confirmation
        /// is sufficient.
        read_back: Option<(String, Expect)>,
    },
    /// Not sent: the requested setting cannot be written as a message, such as a value that is not
    /// a number. Running it is an error.
    Refuse {
        /// The header of the requested setting.
        message: String,
        /// Why it is not sent.
        reason: String,
    },
}

/// A method to stop the current through an instrument whose output does not switch off.
#[derive(Debug, Clone, PartialEq)]
pub struct Way {
    /// Effect of the way, as the end of a sentence that begins with "by".
    pub name: &'static str,
    /// How.
    pub script: Vec<Exchange>,
}

/// A limit within the instrument that bounds its current, and how to query it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bound {
    /// The question; its answer is a number.
    pub query: &'static str,
    /// The text before the number.
    pub words: &'static str,
    /// Its unit.
    pub unit: &'static str,
}

impl Exchange {
    /// Returns a command whose only check is the error queue.
    pub fn send(message: impl Into<String>) -> Self {
        Self::Send(message.into())
    }

    /// Returns a built command whose only check is the error queue.
    pub fn command(header: &str, arguments: impl FnOnce(Command) -> Command) -> Self {
        match arguments(Command::new(header)).build() {
            Ok(message) => Self::Send(message),
            Err(error) => Self::Refuse {
                message: header.to_owned(),
                reason: error.to_string(),
            },
        }
    }

    /// Returns the command `HEADER value` with `decimals` decimals and never an exponent; `HEADER?`
    /// must then return the value.
    pub fn fixed(header: &str, value: f64, decimals: usize, tolerance: f64) -> Self {
        match Self::command(header, |command| command.fixed(value, decimals)) {
            Self::Send(message) => Self::number(message, format!("{header}?"), value, tolerance),
            refused => refused,
        }
    }

    /// Returns the command `HEADER ON` or `HEADER OFF`; `HEADER?` must then return the state.
    pub fn switch(header: &str, on: bool) -> Self {
        match Self::command(header, |command| command.on_off(on)) {
            Self::Send(message) => Self::Set {
                message,
                read_back: format!("{header}?"),
                expect: Expect::Switch(on),
            },
            refused => refused,
        }
    }

    /// Returns a command whose effect is read back as a number.
    pub fn number(
        message: impl Into<String>,
        read_back: impl Into<String>,
        value: f64,
        tolerance: f64,
    ) -> Self {
        Self::Set {
            message: message.into(),
            read_back: read_back.into(),
            expect: Expect::Number { value, tolerance },
        }
    }

    /// Returns a command whose effect is read back as one of several keywords.
    pub fn word(
        message: impl Into<String>,
        read_back: impl Into<String>,
        words: &'static [&'static str],
    ) -> Self {
        Self::Set {
            message: message.into(),
            read_back: read_back.into(),
            expect: Expect::Word(words),
        }
    }
}

/// Runs a script. Stops at the first message that the instrument refuses or whose read-back does
/// not match. Errors describe these settings in words.
///
/// # Errors
/// The link's error for that message.
pub async fn play(
    link: &mut Link,
    settings: &[Setting],
    script: &[Exchange],
) -> Result<(), LinkError> {
    for exchange in script {
        match exchange {
            Exchange::Send(message) => link.send(message).await?,
            Exchange::Set {
                message,
                read_back,
                expect,
            } => {
                if let Some(value) = expect.not_finite() {
                    let reason = format!("expected a finite number, found {value}");
                    return Err(LinkError::Malformed {
                        link: link.name().to_owned(),
                        message: message.clone(),
                        reason,
                    });
                }
                let question = Question {
                    text: read_back,
                    expect,
                    settings,
                };
                let without = Setting::missing(settings, read_back);
                if without.is_some() && link.lacks(read_back) {
                    optional::send_unread(link, message).await?;
                    continue;
                }
                let mut outcome = link
                    .set(message, read_back, |answer| expect.judge(answer))
                    .await;
                if let (Err(error), Some(without)) = (&outcome, without)
                    && optional::may_be_missing(error, read_back)
                {
                    match optional::ask_again(link, read_back, without).await? {
                        None => continue,
                        Some(answer) => {
                            outcome =
                                expect
                                    .judge(&answer)
                                    .map_err(|expected| LinkError::ReadBack {
                                        link: link.name().to_owned(),
                                        sent: message.clone(),
                                        asked: read_back.clone(),
                                        answered: answer,
                                        expected,
                                    });
                        }
                    }
                }
                question.believe(link, outcome).await?;
            }
            Exchange::Data { head, data } => link.send_data(head, data).await?,
            Exchange::Ask {
                message,
                expect,
                read_back,
            } => {
                let answer = link.query(message).await?;
                expect.judge(&answer).map_err(|expected| {
                    LinkError::unexpected(link.name(), message, &answer, &expected)
                })?;
                if let Some((query, expect)) = read_back {
                    let answer = link.query(query).await?;
                    expect.judge(&answer).map_err(|expected| {
                        let question = Question {
                            text: query,
                            expect,
                            settings,
                        };
                        let (answer, expected) = question.readable(link, &answer, expected);
                        LinkError::unexpected(link.name(), query, &answer, &expected)
                    })?;
                }
            }
            Exchange::Refuse { message, reason } => {
                return Err(LinkError::Malformed {
                    link: link.name().to_owned(),
                    message: message.clone(),
                    reason: reason.clone(),
                });
            }
        }
    }
    Ok(())
}

/// Question that shows what became of a message.
struct Question<'a> {
    text: &'a str,
    /// Condition that the answer must meet.
    expect: &'a Expect,
    /// Settings of the instrument, as text.
    settings: &'a [Setting],
}

impl Question<'_> {
    /// Repeats a query for a while if the reply does not match yet: some instruments reply before a
    /// write has taken effect. A query may be repeated, a command must not.
    async fn believe(
        &self,
        link: &mut Link,
        outcome: Result<(), LinkError>,
    ) -> Result<(), LinkError> {
        const PATIENCE: [f64; 4] = [0.1, 0.2, 0.3, 0.4];
        if !matches!(outcome, Err(LinkError::ReadBack { .. })) {
            return outcome;
        }
        for seconds in PATIENCE {
            link.clock().clone().sleep_s(seconds).await;
            if self.expect.judge(&link.query(self.text).await?).is_ok() {
                return Ok(());
            }
        }
        outcome.map_err(|error| match error {
            LinkError::ReadBack {
                link: name,
                sent,
                asked,
                answered,
                expected,
            } => {
                let (answered, expected) = self.readable(link, &answered, expected);
                LinkError::ReadBack {
                    link: name,
                    sent,
                    asked,
                    answered,
                    expected,
                }
            }
            other => other,
        })
    }

    /// Returns reply and expectation for an error message. Those of a status word are described in
    /// text, because a mask of bits is hard to read. The raw reply is in the log.
    fn readable(&self, link: &Link, answer: &str, expected: String) -> (String, String) {
        let Self {
            text,
            expect,
            settings,
        } = self;
        let masked = matches!(expect, Expect::Bits { .. }) && hex_word(answer).is_some();
        match Differs::of(settings, text, expect, answer).filter(|_| masked) {
            Some(words) => {
                tracing::info!(
                    link = link.name(),
                    "`{text}` is answered by `{answer}`: expected {expected}"
                );
                (words.found, words.wanted)
            }
            None => (answer.to_owned(), expected),
        }
    }
}

/// Runs a whole script regardless of errors, for switching off: neither a refused message nor a
/// missing reply must keep the next message from being sent. A dropped link is reconnected for it.
///
/// # Errors
/// The link's error for the first message that failed.
pub async fn play_all(
    link: &mut Link,
    settings: &[Setting],
    script: &[Exchange],
) -> Result<(), LinkError> {
    let mut outcome = Ok(());
    for exchange in script {
        if link.is_dropped() {
            // If this fails, the message fails too, with the reason.
            let _ = link.reconnect().await;
        }
        let played = play(link, settings, std::slice::from_ref(exchange)).await;
        outcome = outcome.and(played);
    }
    outcome
}

/// Answer of an instrument about itself.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Answer {
    /// The query that was sent.
    pub question: String,
    /// Answer that was given.
    pub answer: String,
    /// Whether the state matches the script.
    pub as_scripted: bool,
}

/// Sends the queries of a script and none of its commands: checks whether everything is already as
/// the script would set it. Changes nothing.
///
/// # Errors
/// The link's errors.
pub async fn look(
    link: &mut Link,
    settings: &[Setting],
    script: &[Exchange],
) -> Result<Vec<Answer>, LinkError> {
    let mut answers = Vec::new();
    for (read_back, expect) in read_backs(script) {
        let without = Setting::missing(settings, read_back);
        let answer = if without.is_some() && link.lacks(read_back) {
            None
        } else {
            match (link.query(read_back).await, without) {
                (Err(error), Some(without)) if optional::may_be_missing(&error, read_back) => {
                    optional::ask_again(link, read_back, without).await?
                }
                (answer, _) => Some(answer?),
            }
        };
        answers.push(Answer {
            question: read_back.to_owned(),
            as_scripted: answer
                .as_ref()
                .is_none_or(|answer| expect.judge(answer).is_ok()),
            answer: answer.unwrap_or_else(|| NOT_KNOWN.to_owned()),
        });
    }
    Ok(answers)
}

/// Number of queries without an answer after which [`survey`] sends no further one: each takes a
/// timeout.
const MOST_UNKNOWN: usize = 4;

/// As [`look`], for an instrument of which only the identity is known: a query without an
/// answer is answered by [`NOT_KNOWN`]. After some of them the rest is not asked.
///
/// # Errors
/// The link's errors, except a timeout of a query while the instrument answers otherwise.
pub async fn survey(link: &mut Link, script: &[Exchange]) -> Result<Vec<Answer>, LinkError> {
    let (mut answers, mut unknown): (Vec<Answer>, usize) = (Vec::new(), 0);
    for (question, expect) in read_backs(script) {
        if answers.iter().any(|known| known.question == question) {
            continue;
        }
        let answer = if unknown >= MOST_UNKNOWN {
            "not asked".to_owned()
        } else {
            match link.query(question).await {
                Err(LinkError::Timeout { .. }) => {
                    unknown += 1;
                    optional::prove_alive(link).await?;
                    NOT_KNOWN.to_owned()
                }
                answer => answer?,
            }
        };
        answers.push(Answer {
            question: question.to_owned(),
            as_scripted: expect.judge(&answer).is_ok(),
            answer,
        });
    }
    Ok(answers)
}

/// Returns the queries of a script, each with the condition that its answer must meet.
fn read_backs(script: &[Exchange]) -> impl Iterator<Item = (&str, &Expect)> {
    script.iter().filter_map(|exchange| match exchange {
        Exchange::Set {
            read_back, expect, ..
        }
        | Exchange::Ask {
            read_back: Some((read_back, expect)),
            ..
        } => Some((read_back.as_str(), expect)),
        _ => None,
    })
}

/// Returns the part of a script that does not stand yet. Commands without arguments act, and are
/// always sent.
pub fn changes(standing: &Standing, script: &[Exchange]) -> Vec<Exchange> {
    let is_new = |exchange: &&Exchange| match exchange {
        Exchange::Set {
            read_back, expect, ..
        } => !standing.has(read_back, expect),
        Exchange::Send(command) => !(command.contains(' ') && standing.said(command)),
        _ => true,
    };
    script.iter().filter(is_new).cloned().collect()
}

/// Remembers the settings of a script that was played, to be read back in turn or not.
pub fn keep(standing: &mut Standing, script: &[Exchange], in_turn: bool) {
    for exchange in script {
        match exchange {
            Exchange::Set {
                read_back, expect, ..
            } => standing.set(read_back, expect, in_turn),
            Exchange::Send(command) if command.contains(' ') => standing.say(command),
            _ => {}
        }
    }
}

/// Reads one of the settings that stand, in turn. Returns a description of a difference.
///
/// # Errors
/// The link's errors.
pub async fn check_in_turn(
    link: &mut Link,
    settings: &[Setting],
    standing: &mut Standing,
) -> Result<Option<String>, LinkError> {
    let Some((question, expect)) = standing.next() else {
        return Ok(None);
    };
    let one = ExpectedAnswers(vec![(question, expect)]);
    let differs = one.differs(link, settings).await?;
    if differs.is_some() {
        standing.clear();
    }
    Ok(differs)
}

/// The questions of scripts, each with the last thing that it must show.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ExpectedAnswers(Vec<(String, Expect)>);

impl ExpectedAnswers {
    /// Creates the list of the settings made by this script alone.
    pub fn of(script: &[Exchange]) -> Self {
        let mut answers = Self::default();
        answers.add(script);
        answers
    }

    /// Adds the settings of a later script, which replace those of an earlier one.
    pub fn add(&mut self, script: &[Exchange]) {
        for (read_back, expect) in read_backs(script) {
            self.0.retain(|(question, _)| question != read_back);
            self.0.push((read_back.to_owned(), expect.clone()));
        }
    }

    /// Adds the part of a script that bounds the current, and must stay so too.
    pub fn add_bounds(&mut self, script: &[Exchange], bounds: &[Bound]) {
        let bounding = |exchange: &&Exchange| {
            matches!(
                exchange,
                Exchange::Set { read_back, .. }
                    if bounds.iter().any(|bound| bound.query == read_back)
            )
        };
        script
            .iter()
            .filter(bounding)
            .for_each(|exchange| self.add(std::slice::from_ref(exchange)));
    }

    /// Returns whether no setting is known.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Forgets all known settings except those of this script.
    pub fn keep(&mut self, script: &[Exchange]) {
        let kept = Self::of(script);
        self.0
            .retain(|(question, _)| kept.0.iter().any(|(other, _)| other == question));
    }

    /// Checks that all settings are unchanged, and changes nothing. Returns the differences, in the
    /// words of `settings`.
    ///
    /// # Errors
    /// The link's errors.
    pub async fn differs(
        &self,
        link: &mut Link,
        settings: &[Setting],
    ) -> Result<Option<String>, LinkError> {
        self.differs_in(0..self.0.len(), link, settings).await
    }

    /// As [`Self::differs`], for one setting: number `turn`, counted round.
    ///
    /// # Errors
    /// The link's.
    pub async fn differs_one(
        &self,
        turn: usize,
        link: &mut Link,
        settings: &[Setting],
    ) -> Result<Option<String>, LinkError> {
        match self.0.len() {
            0 => Ok(None),
            count => {
                let one = turn % count;
                self.differs_in(one..one + 1, link, settings).await
            }
        }
    }

    async fn differs_in(
        &self,
        range: std::ops::Range<usize>,
        link: &mut Link,
        settings: &[Setting],
    ) -> Result<Option<String>, LinkError> {
        for (question, expect) in self.0.get(range).unwrap_or_default() {
            if link.lacks(question) {
                continue;
            }
            let first = link.query(question).await?;
            if expect.judge(&first).is_ok() {
                continue;
            }
            // One answer may be garbled on its way: only two make a difference.
            let answer = link.query(question).await?;
            if let Err(expected) = expect.judge(&answer) {
                tracing::info!(
                    link = link.name(),
                    "`{question}` is answered by `{answer}`: expected {expected}"
                );
                let words = Differs::of(settings, question, expect, &answer);
                let unnamed =
                    || format!("the value of `{question}` differs from what this run left");
                return Ok(Some(words.map_or_else(unnamed, |words| words.to_string())));
            }
        }
        Ok(None)
    }
}

/// Empties the error queue of entries from an earlier client or the power-up, which would otherwise
/// be mistaken for the result of the first message.
///
/// # Errors
/// The link's errors.
pub async fn forget_errors(link: &mut Link) -> Result<(), LinkError> {
    for entry in link.drain_errors().await? {
        tracing::warn!(link = link.name(), %entry, "an error from before was in the queue");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_that_is_none_is_refused_before_it_is_sent() {
        assert_eq!(
            Exchange::fixed("CURR", 1.5, 4, 1e-3),
            Exchange::Set {
                message: "CURR 1.5000".to_owned(),
                read_back: "CURR?".to_owned(),
                expect: Expect::Number {
                    value: 1.5,
                    tolerance: 1e-3
                }
            }
        );
        let refused = Exchange::fixed("CURR", f64::NAN, 4, 1e-3);
        assert!(
            matches!(&refused, Exchange::Refuse { message, .. } if message == "CURR"),
            "{refused:?}"
        );
        assert_eq!(
            Expect::Fields(vec![("FRQ", 1.0, 0.1), ("AMP", f64::INFINITY, 0.1)]).not_finite(),
            Some(f64::INFINITY)
        );
    }
}
