//! Queries that some firmware does not know. Who an instrument is and what it can are separate
//! questions: a missing answer to the second does not hide the first.

use instruments_link::link::{Grammar, Link, LinkError};

/// The answer of a unit that does not know a query.
pub const NOT_KNOWN: &str = "not known on this unit";
/// Numbers of the errors of a command that an instrument does not know.
const UNKNOWN_COMMAND: std::ops::RangeInclusive<i32> = -119..=-100;

/// Checks whether an error may mean that the instrument does not know a query.
pub(super) fn may_be_missing(error: &LinkError, question: &str) -> bool {
    match error {
        LinkError::Timeout { message, .. } => message == question,
        LinkError::Refused { code, .. } => UNKNOWN_COMMAND.contains(code),
        _ => false,
    }
}

/// Sends a query again on a new connection, because the first one may have been lost. Returns `None`
/// if the instrument answers everything but this query, and remembers it.
pub(super) async fn ask_again(
    link: &mut Link,
    question: &str,
    without: &str,
) -> Result<Option<String>, LinkError> {
    prove_alive(link).await?;
    match link.query(question).await {
        Ok(answer) => return Ok(Some(answer)),
        Err(LinkError::Timeout { .. }) => {}
        Err(error) => return Err(error),
    }
    prove_alive(link).await?;
    link.note_lacking(question, &format!("{NOT_KNOWN}: {without} is not known"));
    Ok(None)
}

/// Reconnects, if necessary, and shows that the instrument answers; the error that an unknown query
/// has left in its queue is removed.
pub(super) async fn prove_alive(link: &mut Link) -> Result<(), LinkError> {
    if link.is_dropped() {
        link.reconnect().await?;
    }
    if link.profile().grammar == Grammar::Scpi {
        link.query("*IDN?").await?;
        link.drain_errors().await?;
    }
    Ok(())
}

/// Sends the command of a setting that cannot be read back. A unit that does not know the command
/// either is left as it is.
pub(super) async fn send_unread(link: &mut Link, message: &str) -> Result<(), LinkError> {
    match link.send(message).await {
        Err(LinkError::Refused { code, .. }) if UNKNOWN_COMMAND.contains(&code) => Ok(()),
        outcome => outcome,
    }
}
