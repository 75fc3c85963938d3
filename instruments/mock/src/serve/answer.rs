//! Treatment of one message: the reply in pieces with pauses, and whether the connection survives
//! it. The same for every transport.

use crate::{Device, Fault, Trouble};

/// A late answer that is still in time, one that is not for most links, and a silence that outlasts
/// every one, s.
const LATE_S: f64 = 1.0;
const TOO_LATE_S: f64 = 4.0;
const STALL_S: f64 = 12.0;
/// Pause between two pieces of an answer, s.
const PIECE_S: f64 = 0.05;

/// Next step of an answer.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Step {
    /// Nothing is sent for this bench time, s.
    Wait(f64),
    /// These bytes are sent; the end of the message accompanies the last ones, if the transport has
    /// one.
    Put { bytes: Vec<u8>, end: bool },
}

/// State of the connection afterwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Then {
    Stay,
    /// The instrument continues to receive and never replies again.
    StopSending,
    HangUp,
}

/// Lets the device handle a message.
pub(super) fn answer(device: &mut dyn Device, now_s: f64, message: &[u8]) -> (Vec<Step>, Then) {
    let trouble = device.trouble(now_s, message);
    let reply = match trouble {
        // The power is back before the next query, and pending queries are discarded.
        Some(Trouble {
            fault: Fault::LoseMessage | Fault::PowerCycle,
            ..
        }) => Vec::new(),
        _ => device.handle(now_s, message),
    };
    let mut steps = Vec::new();
    let late_s = if reply.is_empty() {
        0.0
    } else {
        device.late_s(now_s)
    };
    if late_s > 0.0 {
        steps.push(Step::Wait(late_s));
    }
    let then = match trouble {
        Some(trouble) => put_badly(&mut steps, reply, trouble, message),
        None => {
            put_in_two(&mut steps, reply, device.end_late_s());
            Then::Stay
        }
    };
    (steps, then)
}

fn put(steps: &mut Vec<Step>, bytes: Vec<u8>, end: bool) {
    if !bytes.is_empty() {
        steps.push(Step::Put { bytes, end });
    }
}

/// The last byte may come later than the others.
fn put_in_two(steps: &mut Vec<Step>, mut reply: Vec<u8>, end_late_s: f64) {
    if end_late_s > 0.0 && !reply.is_empty() {
        let end = reply.split_off(reply.len() - 1);
        put(steps, reply, false);
        steps.push(Step::Wait(end_late_s));
        reply = end;
    }
    put(steps, reply, true);
}

fn put_badly(steps: &mut Vec<Step>, mut reply: Vec<u8>, trouble: Trouble, message: &[u8]) -> Then {
    let Trouble { fault, share } = trouble;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "an index"
    )]
    let place = (share * reply.len() as f64) as usize;
    match fault {
        Fault::LoseMessage | Fault::LoseReply => return Then::Stay,
        Fault::PowerCycle | Fault::Reset => return Then::HangUp,
        Fault::Delay => steps.push(Step::Wait(share * LATE_S)),
        Fault::TooLate => steps.push(Step::Wait(TOO_LATE_S)),
        Fault::Stall => steps.push(Step::Wait(STALL_S)),
        Fault::Duplicate => reply.extend_from_within(..),
        Fault::Garble => {
            if let Some(byte) = reply.get_mut(place) {
                *byte ^= message.first().map_or(1, |first| first & 0x1f) | 1;
            }
        }
        // Its end is missing too.
        Fault::Truncate => {
            reply.truncate(place);
            put(steps, reply, false);
            return Then::Stay;
        }
        Fault::Split => {
            let second = reply.split_off(place);
            put(steps, reply, false);
            steps.push(Step::Wait(PIECE_S));
            put(steps, second, true);
            return Then::Stay;
        }
        Fault::HalfClose => {
            put(steps, reply, true);
            return Then::StopSending;
        }
        // Faults of the device itself do not affect the wire.
        _ => {}
    }
    put(steps, reply, true);
    Then::Stay
}
