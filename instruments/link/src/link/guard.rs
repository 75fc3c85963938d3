//! Refuses messages before a link sends them, regardless of the caller: malformed messages, queries
//! whose reply would not be read, and commands that must never reach an instrument with a cell in
//! the jig.

use instruments_scpi::{header::Pattern, message::parse_program};

/// The language of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grammar {
    /// SCPI: every message is parsed before it is sent.
    Scpi,
    /// Any other message; only checked for printable characters.
    Plain,
}

/// Commands that no procedure needs and that harm: `*RST` may leave the output of a supply on or
/// shorted, the self-tests of a Kepco drive its output to full scale.
pub const NEVER_SENT: &[&str] = &["*RST", "*TST?", "DIAGnostic:TST?", "DIAGnostic:TST"];

/// Why a message is not sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Refusal {
    /// The message is malformed.
    Malformed(String),
    /// Its header is on the list.
    Forbidden(&'static str),
}

/// Checks a message before it is sent. `answered` states that the caller will wait for a reply.
pub(super) fn judge(
    grammar: Grammar,
    never_sent: &'static [&'static str],
    message: &str,
    answered: bool,
) -> Result<(), Refusal> {
    if grammar == Grammar::Plain {
        return Ok(());
    }
    let units =
        parse_program(message.as_bytes()).map_err(|error| Refusal::Malformed(error.to_string()))?;
    for unit in &units {
        let header = unit.full_header();
        let forbidden = |pattern: &&str| {
            Pattern::parse(pattern).is_ok_and(|pattern| pattern.matches(&header).is_some())
        };
        if let Some(pattern) = never_sent.iter().find(|pattern| forbidden(pattern)) {
            return Err(Refusal::Forbidden(pattern));
        }
    }
    match (units.iter().any(|unit| unit.query), answered) {
        (true, false) => Err(Refusal::Malformed(
            "expected a command, found a question whose answer would not be read".to_owned(),
        )),
        (false, true) => Err(Refusal::Malformed(
            "expected a question, found a command that has no answer".to_owned(),
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmful_commands_are_recognised_in_every_form_and_place() {
        for message in [
            "*RST",
            "*rst",
            "*TST?",
            "DIAG:TST?",
            ":diagnostic:tst?",
            "CURR 0;*RST",
            "OUTP OFF;:DIAG:TST?",
        ] {
            let answered = message.ends_with('?');
            assert!(
                matches!(
                    judge(Grammar::Scpi, NEVER_SENT, message, answered),
                    Err(Refusal::Forbidden(_))
                ),
                "{message}"
            );
        }
        for message in ["*RCL 1", "CURR:PROT 3", "DIAG:TSTX"] {
            assert_eq!(
                judge(Grammar::Scpi, NEVER_SENT, message, false),
                Ok(()),
                "{message}"
            );
        }
    }

    #[test]
    fn a_question_is_asked_and_a_command_is_sent() {
        for (message, answered, expected) in [
            ("CURR?", true, None),
            ("CURR 1", false, None),
            (
                "CURR?",
                false,
                Some("a question whose answer would not be read"),
            ),
            ("CURR 1", true, Some("a command that has no answer")),
            (
                "CURR 1,",
                false,
                Some("expected an argument on both sides of every comma"),
            ),
        ] {
            let reason = match judge(Grammar::Scpi, NEVER_SENT, message, answered) {
                Ok(()) => None,
                Err(Refusal::Malformed(reason)) => Some(reason),
                Err(Refusal::Forbidden(header)) => Some(header.to_owned()),
            };
            match (expected, &reason) {
                (Some(expected), Some(reason)) => assert!(reason.contains(expected), "{reason}"),
                _ => assert_eq!(reason, None, "{message}"),
            }
        }
        assert_eq!(judge(Grammar::Plain, NEVER_SENT, "IN_PV_00", true), Ok(()));
    }
}
