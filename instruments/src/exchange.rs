//! What a dialect hands to its role: a script of messages, each with what must be true after it. The role plays it through the link.
//!
//! A dialect is sync and sends nothing itself, so that the very texts that go to an instrument can be printed, tested and read beforehand.

use crate::{
    link::{Link, LinkError},
    scpi::{
        message::{Command, parse_response},
        number::{parse_bool, parse_quantity},
    },
};

/// One message with its proof.
#[derive(Debug, Clone, PartialEq)]
pub enum Exchange {
    /// Sent; the error queue is asked where the instrument has one.
    Send(String),
    /// Sent, then read back.
    Set {
        /// The command.
        message: String,
        /// The query that shows what the instrument made of it.
        read_back: String,
        /// What the answer must be.
        expect: Expect,
    },
    /// Bytes behind a head, sent as they are; what the instrument made of them shows in what comes after. They must hold no byte that ends a message.
    Data {
        /// The message up to its data.
        head: String,
        /// The data.
        data: Vec<u8>,
    },
    /// A command that the instrument answers by itself, as protocols with a confirmation do.
    Ask {
        /// The command.
        message: String,
        /// What the answer must be.
        expect: Expect,
        /// The query that shows what the instrument made of it, and what its answer must be; none where the confirmation says it all.
        read_back: Option<(String, Expect)>,
    },
    /// Not sent: what was wanted cannot be written as a message, such as a number that is none. Playing it is an error.
    Refuse {
        /// The header of what was wanted.
        message: String,
        /// Why it is not sent.
        reason: String,
    },
}

/// What a read-back must show.
#[derive(Debug, Clone, PartialEq)]
pub enum Expect {
    /// A number, perhaps with a unit behind it, within `tolerance` of `value`.
    Number {
        /// Expected value.
        value: f64,
        /// Greatest allowed difference; covers the rounding of the instrument's display.
        tolerance: f64,
    },
    /// Two numbers of this magnitude: a limit of both signs, answered as `pos, neg`.
    Magnitude {
        /// Expected magnitude.
        value: f64,
        /// Greatest allowed difference.
        tolerance: f64,
    },
    /// A switch in this position, answered as `1`/`0` or `ON`/`OFF`.
    Switch(bool),
    /// One of these words, whatever the case.
    Word(&'static [&'static str]),
    /// One of these words; other answers are told with their meaning where it is known.
    Confirmed {
        /// What is as good as done.
        words: &'static [&'static str],
        /// Refusals and what they mean.
        refusals: &'static [(&'static str, &'static str)],
    },
    /// A field of a Siglent `KEY,value,KEY,value` answer with a number within `tolerance` of `value`.
    Fields(Vec<(&'static str, f64, f64)>),
    /// A field of a Siglent `KEY,value,KEY,value` answer with this word.
    FieldWord(&'static str, &'static str),
    /// All of these.
    All(Vec<Expect>),
    /// The answer contains this text, whatever the case.
    Contains(String),
    /// The low bits of a hexadecimal status word: `word & mask == bits`.
    Bits {
        /// Bits that count.
        mask: u32,
        /// Their expected value.
        bits: u32,
    },
}

impl Exchange {
    /// A command that is sent and trusted to the error queue.
    pub fn send(message: impl Into<String>) -> Self {
        Self::Send(message.into())
    }

    /// A command as it is built, trusted to the error queue.
    pub fn command(header: &str, arguments: impl FnOnce(Command) -> Command) -> Self {
        match arguments(Command::new(header)).build() {
            Ok(message) => Self::Send(message),
            Err(error) => Self::Refuse { message: header.to_owned(), reason: error.to_string() },
        }
    }

    /// `HEADER value` with so many decimals and never an exponent; `HEADER?` must then show the value.
    pub fn fixed(header: &str, value: f64, (decimals, tolerance): (usize, f64)) -> Self {
        match Self::command(header, |command| command.fixed(value, decimals)) {
            Self::Send(message) => Self::number(message, format!("{header}?"), value, tolerance),
            refused => refused,
        }
    }

    /// `HEADER ON` or `HEADER OFF`; `HEADER?` must then show it.
    pub fn switch(header: &str, on: bool) -> Self {
        match Self::command(header, |command| command.on_off(on)) {
            Self::Send(message) => Self::Set { message, read_back: format!("{header}?"), expect: Expect::Switch(on) },
            refused => refused,
        }
    }

    /// A command whose effect is read back as a number.
    pub fn number(message: impl Into<String>, read_back: impl Into<String>, value: f64, tolerance: f64) -> Self {
        Self::Set { message: message.into(), read_back: read_back.into(), expect: Expect::Number { value, tolerance } }
    }

    /// A command whose effect is read back as one of several words.
    pub fn word(message: impl Into<String>, read_back: impl Into<String>, words: &'static [&'static str]) -> Self {
        Self::Set { message: message.into(), read_back: read_back.into(), expect: Expect::Word(words) }
    }
}

impl Expect {
    /// A number that was to be set and is none: no instrument may see it.
    fn not_finite(&self) -> Option<f64> {
        match self {
            Self::Number { value, .. } | Self::Magnitude { value, .. } => Some(*value).filter(|value| !value.is_finite()),
            Self::Fields(fields) => fields.iter().map(|(_, value, _)| *value).find(|value| !value.is_finite()),
            Self::All(all) => all.iter().find_map(Self::not_finite),
            _ => None,
        }
    }

    /// Judges an answer.
    ///
    /// # Errors
    /// What should have been answered, in words that go behind "expected".
    pub fn judge(&self, answer: &str) -> Result<(), String> {
        match self {
            Self::Number { value, tolerance } => judge_number(answer, *value, *tolerance, "a number"),
            Self::Magnitude { value, tolerance } => {
                let fields = parse_response(answer);
                let right = |text: &str| leading_number(text).is_some_and(|number| (number.abs() - value).abs() <= *tolerance);
                (fields.len() == 2 && fields.iter().all(|field| right(&field.text)))
                    .then_some(())
                    .ok_or_else(|| format!("two numbers within {tolerance:.1e} of ±{value}"))
            }
            Self::Switch(on) => match parse_bool(answer) {
                Ok(met) if met == *on => Ok(()),
                _ => Err((if *on { "1 or ON" } else { "0 or OFF" }).to_owned()),
            },
            Self::Word(words) => words
                .iter()
                .any(|word| answer.trim().eq_ignore_ascii_case(word))
                .then_some(())
                .ok_or_else(|| format!("one of {}", words.join(", "))),
            Self::Confirmed { words, refusals } => {
                if words.contains(&answer.trim()) {
                    return Ok(());
                }
                let meaning = refusals.iter().find(|(code, _)| *code == answer.trim());
                Err(format!(
                    "{}{}",
                    words.join(" or "),
                    meaning.map_or_else(String::new, |(code, meaning)| format!(" ({code}: {meaning})"))
                ))
            }
            Self::Fields(fields) => fields.iter().try_for_each(|(key, value, tolerance)| {
                let text = field(answer, key).ok_or_else(|| format!("a field {key}"))?;
                // A long answer is cut where it is shown, perhaps before this field.
                judge_number(text, *value, *tolerance, key).map_err(|expected| format!("{expected}, found {text}"))
            }),
            Self::FieldWord(key, word) => match field(answer, key) {
                Some(met) if met.eq_ignore_ascii_case(word) => Ok(()),
                _ => Err(format!("{key},{word}")),
            },
            Self::All(all) => all.iter().try_for_each(|expect| expect.judge(answer)),
            Self::Contains(text) => answer
                .to_ascii_uppercase()
                .contains(&text.to_ascii_uppercase())
                .then_some(())
                .ok_or_else(|| format!("`{text}` in the answer")),
            Self::Bits { mask, bits } => {
                let word = hex_word(answer).ok_or("a hexadecimal status word")?;
                (word & mask == *bits).then_some(()).ok_or_else(|| format!("status bits {bits:#06x} under mask {mask:#06x}"))
            }
        }
    }
}

/// Plays a script; stops at the first message that is refused or not believed.
///
/// # Errors
/// The link's error for that message.
pub async fn play(link: &mut Link, script: &[Exchange]) -> Result<(), LinkError> {
    for exchange in script {
        match exchange {
            Exchange::Send(message) => link.send(message).await?,
            Exchange::Set { message, read_back, expect } => {
                if let Some(value) = expect.not_finite() {
                    let reason = format!("expected a finite number, found {value}");
                    return Err(LinkError::Malformed { link: link.name().to_owned(), message: message.clone(), reason });
                }
                let outcome = link.set(message, read_back, |answer| expect.judge(answer)).await;
                believe(link, read_back, expect, outcome).await?;
            }
            Exchange::Data { head, data } => link.send_data(head, data).await?,
            Exchange::Ask { message, expect, read_back } => {
                let answer = link.query(message).await?;
                expect.judge(&answer).map_err(|expected| LinkError::unexpected(link.name(), message, &answer, &expected))?;
                if let Some((query, expect)) = read_back {
                    let answer = link.query(query).await?;
                    expect.judge(&answer).map_err(|expected| LinkError::unexpected(link.name(), query, &answer, &expected))?;
                }
            }
            Exchange::Refuse { message, reason } => {
                return Err(LinkError::Malformed { link: link.name().to_owned(), message: message.clone(), reason: reason.clone() });
            }
        }
    }
    Ok(())
}

/// Asks again for a while what was not yet so: some instruments answer before a write has taken effect. A question may be repeated, a command not.
async fn believe(link: &mut Link, read_back: &str, expect: &Expect, outcome: Result<(), LinkError>) -> Result<(), LinkError> {
    const PATIENCE: [f64; 4] = [0.1, 0.2, 0.3, 0.4];
    if !matches!(outcome, Err(LinkError::ReadBack { .. })) {
        return outcome;
    }
    for seconds in PATIENCE {
        link.clock().clone().sleep_s(seconds).await;
        if expect.judge(&link.query(read_back).await?).is_ok() {
            return Ok(());
        }
    }
    outcome
}

/// Plays a whole script whatever happens in between, for switching off: neither a message that is refused nor an answer that stays away must keep the
/// next message from being sent. A link that was dropped is reconnected for it.
///
/// # Errors
/// The link's error for the first message that failed.
pub async fn play_all(link: &mut Link, script: &[Exchange]) -> Result<(), LinkError> {
    let mut outcome = Ok(());
    for exchange in script {
        if link.is_dropped() {
            // When that fails, so will the message, and say why.
            let _ = link.reconnect().await;
        }
        let played = play(link, std::slice::from_ref(exchange)).await;
        outcome = outcome.and(played);
    }
    outcome
}

/// What an instrument says of itself.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Answer {
    /// What was asked.
    pub question: String,
    /// What was answered.
    pub answer: String,
    /// It is what the script would have made it.
    pub as_scripted: bool,
}

/// Asks the questions of a script and sends none of its commands: whether everything already is as the script would make it. Changes nothing.
///
/// # Errors
/// The link's.
pub async fn look(link: &mut Link, script: &[Exchange]) -> Result<Vec<Answer>, LinkError> {
    let mut answers = Vec::new();
    for exchange in script {
        let (Exchange::Set { read_back, expect, .. } | Exchange::Ask { read_back: Some((read_back, expect)), .. }) = exchange else {
            continue;
        };
        let answer = link.query(read_back).await?;
        answers.push(Answer { question: read_back.clone(), as_scripted: expect.judge(&answer).is_ok(), answer });
    }
    Ok(answers)
}

/// Takes out of the error queue what an earlier client or the power-up left there, which would else be taken for an answer to the first message.
///
/// # Errors
/// The link's.
pub async fn forget_errors(link: &mut Link) -> Result<(), LinkError> {
    for entry in link.drain_errors().await? {
        tracing::warn!(link = link.name(), %entry, "an error from before was in the queue");
    }
    Ok(())
}

/// The number at the start of an answer, whatever unit follows it; a header such as `#MRI:` before it is skipped.
pub fn leading_number(answer: &str) -> Option<f64> {
    parse_quantity(after_header(answer)).ok().map(|quantity| quantity.value)
}

/// What follows the `#HEADER:` of protocols that repeat the question in the answer; all of an answer without one.
pub fn after_header(answer: &str) -> &str {
    let named = |header: &str| !header.is_empty() && header.bytes().all(|byte| byte.is_ascii_uppercase());
    let header = answer.trim().strip_prefix('#').and_then(|rest| rest.split_once(':'));
    header.filter(|(header, _)| named(header)).map_or(answer, |(_, value)| value)
}

/// The value behind `key` in a `KEY,value,KEY,value` list; a header such as `C1:BSWV ` before the list is skipped.
pub fn field<'a>(answer: &'a str, key: &str) -> Option<&'a str> {
    let text = answer.trim();
    let list = text.split_once(' ').filter(|(header, _)| header.contains(':')).map_or(text, |(_, list)| list);
    let mut parts = list.split(',');
    while let Some(part) = parts.next() {
        if part.trim().eq_ignore_ascii_case(key) {
            return parts.next().map(str::trim);
        }
    }
    None
}

/// A hexadecimal status word such as `0x0224` or `#MST:08000002`.
pub fn hex_word(answer: &str) -> Option<u32> {
    let text = after_header(answer).trim();
    let digits = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")).unwrap_or(text);
    u32::from_str_radix(digits, 16).ok()
}

/// The last field counts: some answers repeat a keyword before it (`VALue,1.00E+00`).
fn judge_number(answer: &str, value: f64, tolerance: f64, what: &str) -> Result<(), String> {
    match parse_response(answer).last().and_then(|field| leading_number(&field.text)) {
        Some(number) if (number - value).abs() <= tolerance => Ok(()),
        _ => Err(format!("{what} within {tolerance:.1e} of {value}")),
    }
}

/// What an instrument says of itself.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Identity {
    /// The whole answer.
    pub raw: String,
    /// First field: the maker.
    pub maker: String,
    /// Second field: the model.
    pub model: String,
    /// Third field: the serial number; may be empty.
    pub serial: String,
    /// The rest: firmware.
    pub firmware: String,
}

impl Identity {
    /// Splits an `*IDN?` answer at its commas; answers without commas (old Kepco cards, Julabo) give maker and model by their first blank, and
    /// `#VER:model:firmware` is CAENels'.
    pub fn parse(raw: &str) -> Self {
        let raw = raw.trim().to_owned();
        if let Some((model, firmware)) = raw.strip_prefix("#VER:").map(|rest| rest.split_once(':').unwrap_or((rest, ""))) {
            let (model, firmware) = (model.to_owned(), firmware.to_owned());
            return Self { raw, maker: "CAENels".to_owned(), model, serial: String::new(), firmware };
        }
        let fields: Vec<String> = parse_response(&raw).into_iter().map(|field| field.text.trim().to_owned()).collect();
        let (maker, model, serial, firmware) = match fields.as_slice() {
            [maker, model, serial, rest @ ..] => (maker.clone(), model.clone(), serial.clone(), rest.join(",")),
            _ => {
                let (maker, model) = raw.split_once(' ').unwrap_or((raw.as_str(), ""));
                (maker.to_owned(), model.to_owned(), String::new(), String::new())
            }
        };
        Self { raw, maker, model, serial, firmware }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_found_before_their_units() {
        for (answer, number) in [
            ("1000HZ", Some(1000.0)),
            ("-2.5E0", Some(-2.5)),
            ("5.00E-02", Some(0.05)),
            ("+1.000000000000000E+03", Some(1000.0)),
            ("0.5V", Some(0.5)),
            (" 3.25 ", Some(3.25)),
            ("", None),
            ("ON", None),
        ] {
            assert_eq!(leading_number(answer), number, "{answer}");
        }
    }

    #[test]
    fn an_expectation_says_what_it_wanted() {
        let answer = "C1:BSWV WVTP,SINE,FRQ,1000HZ,PERI,0.001S,AMP,1V,OFST,-0.28V,PHSE,0";
        assert_eq!(Expect::Fields(vec![("FRQ", 1000.0, 1e-3), ("OFST", -0.28, 1e-3)]).judge(answer), Ok(()));
        let refused = Expect::Fields(vec![("AMP", 2.0, 0.01)]).judge(answer).unwrap_err();
        assert!(refused.contains("AMP") && refused.contains("of 2"), "{refused}");
        assert_eq!(field("C1:BSWV WVTP, SINE, FRQ, 1000HZ, AMP, 1V", "FRQ"), Some("1000HZ"));
        assert_eq!(Expect::Contains("LOAD,HZ".to_owned()).judge("OUTP OFF,LOAD,50"), Err("`LOAD,HZ` in the answer".to_owned()));
        let both = Expect::Magnitude { value: 3.0, tolerance: 0.01 };
        for (answer, accepted) in
            [("3.0E0, -3.0E0", true), ("3.0E0", false), ("3.0E0, -2.0E1", false), ("2.0E1, -3.0E0", false), ("", false)]
        {
            assert_eq!(both.judge(answer).is_ok(), accepted, "{answer}");
        }
        assert!(Expect::Word(&["FIX", "FIXED"]).judge("fixed").is_ok());
        assert!(Expect::Word(&["FIX", "FIXED"]).judge("EXT").unwrap_err().contains("FIX, FIXED"));
        assert!(Expect::Switch(true).judge("1").is_ok() && Expect::Switch(false).judge("off").is_ok());
        assert_eq!(Expect::Switch(false).judge("ON").unwrap_err(), "0 or OFF");
        assert!(Expect::Bits { mask: 0x10, bits: 0x10 }.judge("0x0224").is_err());
        assert!(Expect::Bits { mask: 0x20, bits: 0x20 }.judge("0x0224").is_ok());
    }

    #[test]
    fn a_number_that_is_none_is_refused_before_it_is_sent() {
        assert_eq!(
            Exchange::fixed("CURR", 1.5, (4, 1e-3)),
            Exchange::Set {
                message: "CURR 1.5000".to_owned(),
                read_back: "CURR?".to_owned(),
                expect: Expect::Number { value: 1.5, tolerance: 1e-3 }
            }
        );
        let refused = Exchange::fixed("CURR", f64::NAN, (4, 1e-3));
        assert!(matches!(&refused, Exchange::Refuse { message, .. } if message == "CURR"), "{refused:?}");
        assert_eq!(Expect::Fields(vec![("FRQ", 1.0, 0.1), ("AMP", f64::INFINITY, 0.1)]).not_finite(), Some(f64::INFINITY));
    }

    #[test]
    fn identities_of_every_shape_are_read() {
        let kepco = Identity::parse("KEPCO,BOP1KW 50-20 ,E156884, 2.01");
        assert_eq!((kepco.maker.as_str(), kepco.model.as_str(), kepco.serial.as_str()), ("KEPCO", "BOP1KW 50-20", "E156884"));
        let card = Identity::parse("KEPCO BOP BIT232 REV. 3.1");
        assert_eq!((card.maker.as_str(), card.model.as_str()), ("KEPCO", "BOP BIT232 REV. 3.1"));
        let spd = Identity::parse("Siglent Technologies,SPD3303X-E,SPD3XIDQ5R5553,1.01.01.02.07R2,V3.0");
        assert_eq!(spd.firmware, "1.01.01.02.07R2,V3.0");
    }
}
