//! Quirks that need no knowledge of the model: changes of messages and answers on the wire, and the
//! form of blocks and numbers.

use instruments_scpi::decode::Terminator;

use super::{Device, Trouble, latency::Latency, plant::SharedPlant, quirks::Quirks};

/// A text such as some send before a block.
const PREFIX: &[u8] = b"C1:WF ALL,";

/// Device with the protocol quirks that it was given.
pub(super) struct QuirkyDevice {
    device: Box<dyn Device>,
    plant: SharedPlant,
    quirks: Quirks,
    /// When the last message came, s.
    last_message_s: f64,
    /// Nothing was answered on this connection yet.
    fresh: bool,
    /// Additional time of the first answer, s; 0 for the others.
    first_s: f64,
    latency: Option<&'static Latency>,
    /// Time that the answer to the last message takes, s.
    answer_s: f64,
}

impl QuirkyDevice {
    pub(super) fn new(device: Box<dyn Device>, plant: SharedPlant, quirks: Quirks) -> Self {
        Self {
            device,
            plant,
            quirks,
            last_message_s: f64::NEG_INFINITY,
            fresh: true,
            first_s: 0.0,
            latency: None,
            answer_s: 0.0,
        }
    }

    /// Sets the times that it takes to answer.
    pub(super) fn with_latency(self, latency: Option<&'static Latency>) -> Self {
        Self { latency, ..self }
    }

    /// Returns the form of a block, or the digits of numbers.
    fn dressed(&self, mut reply: Vec<u8>) -> Vec<u8> {
        if reply.first() == Some(&b'#') && reply.get(1).is_some_and(u8::is_ascii_digit) {
            while reply.last() == Some(&b'\n') && ends_behind_block(&reply) {
                reply.pop();
            }
            reply.extend_from_slice(if self.quirks.is("double_end") {
                b"\n\n"
            } else {
                b"\n"
            });
            return if self.quirks.is("block_prefix") {
                [PREFIX, &reply].concat()
            } else {
                reply
            };
        }
        match self.quirks.count("digits") {
            0 => reply,
            digits => rounded(&reply, digits),
        }
    }
}

/// Returns whether a message holds a text, in any case.
fn contains(message: &[u8], text: &[u8]) -> bool {
    message
        .windows(text.len())
        .any(|part| part.eq_ignore_ascii_case(text))
}

/// Returns whether there is a byte behind the payload of the block.
fn ends_behind_block(reply: &[u8]) -> bool {
    let digits = reply
        .get(1)
        .map_or(0, |digit| usize::from(digit.saturating_sub(b'0')));
    let length = reply
        .get(2..2 + digits)
        .and_then(|length| std::str::from_utf8(length).ok()?.parse::<usize>().ok());
    length.is_some_and(|length| reply.len() > 2 + digits + length)
}

/// Rounds a reply that is one number to `digits` significant digits. Lists, such as the scaling of
/// a waveform, are not read-backs and stay exact.
fn rounded(reply: &[u8], digits: usize) -> Vec<u8> {
    let Ok(text) = std::str::from_utf8(reply) else {
        return reply.to_vec();
    };
    let body = text.trim_end();
    [
        round(body, digits).as_bytes(),
        &text.as_bytes()[body.len()..],
    ]
    .concat()
}

/// Rounds a number in its own format; returns any other field unchanged.
fn round(field: &str, digits: usize) -> String {
    let number = field
        .parse::<f64>()
        .ok()
        .filter(|number| number.is_finite() && field.contains(['.', 'E', 'e']));
    let Some(number) = number else {
        return field.to_owned();
    };
    let short: f64 = format!("{number:.*e}", digits.max(1) - 1)
        .parse()
        .unwrap_or(number);
    if field.contains(['E', 'e']) {
        format!("{short:E}")
    } else {
        short.to_string()
    }
}

impl Device for QuirkyDevice {
    fn terminator(&self) -> Terminator {
        self.device.terminator()
    }

    fn connected(&mut self, now_s: f64) {
        self.fresh = true;
        self.device.connected(now_s);
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        let gap_s = now_s - std::mem::replace(&mut self.last_message_s, now_s);
        if gap_s < self.quirks.number("min_gap") {
            return Vec::new();
        }
        self.answer_s = self
            .latency
            .map_or(0.0, |latency| latency.of_message(message));
        let lacks = self.quirks.word("lacks");
        if !lacks.is_empty() && contains(message, lacks.as_bytes()) {
            return Vec::new();
        }
        let identity = self.quirks.word("identity");
        let reply = if !identity.is_empty() && message.trim_ascii().eq_ignore_ascii_case(b"*IDN?") {
            format!("{identity}\n").into_bytes()
        } else {
            self.device.handle(now_s, message)
        };
        let reply = self.dressed(reply);
        let first = !reply.is_empty() && std::mem::take(&mut self.fresh);
        self.first_s = if first {
            self.quirks.number("first_answer")
        } else {
            0.0
        };
        if self.quirks.is("echo") {
            [message, b"\r\n", &reply].concat()
        } else {
            reply
        }
    }

    fn trouble(&mut self, now_s: f64, message: &[u8]) -> Option<Trouble> {
        self.device.trouble(now_s, message)
    }

    fn late_s(&self, now_s: f64) -> f64 {
        self.plant
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
            .late_s(now_s)
            + self.first_s
            + self.answer_s
    }

    fn end_late_s(&self) -> f64 {
        self.quirks.number("late_end")
    }

    fn refuses_second(&self) -> bool {
        self.quirks.word("second_client") == "refuse"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_answers_of_one_number_are_rounded() {
        for (answer, three) in [
            ("+1.23456789E+00\n", "1.23E0\n"),
            ("4.2345\n", "4.23\n"),
            ("4.200,1.2345\n", "4.200,1.2345\n"),
            (
                "Siglent Technologies,SPD3303X,SIM,1.01.01.02.07R2,V3.0\n",
                "Siglent Technologies,SPD3303X,SIM,1.01.01.02.07R2,V3.0\n",
            ),
            ("1\n", "1\n"),
            ("\r\n", "\r\n"),
        ] {
            assert_eq!(
                String::from_utf8(rounded(answer.as_bytes(), 3)).unwrap(),
                three
            );
        }
    }

    #[test]
    fn a_line_end_in_a_payload_belongs_to_it() {
        assert!(!ends_behind_block(b"#12a\n"));
        assert!(ends_behind_block(b"#12a\n\n"));
    }
}
