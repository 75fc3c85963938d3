//! Common parts of the SCPI mocks: handlers, arguments, the error queue and the common commands, on
//! the device side of the `scpi` crate.
//!
//! The crate tokenises a message, walks the tree and hands over the parameters. Its rough edges are
//! dealt with here: a leading blank is cut off, a reply that an error left half written is dropped,
//! `*OPC` sets its event bit without an entry in the error queue, `*CLS` empties that queue.
//! Numbers are formatted by the instruments themselves ([`super::number`]), for the crate prints
//! the shortest form.

mod argument;

use std::{collections::VecDeque, ops::RangeInclusive};

use scpi::{
    Context, Device as ScpiDevice,
    error::{Error, ErrorCode},
    parser::{
        parameters::Parameters,
        response::{Formatter, ResponseData, ResponseUnit},
    },
    tree::{Node, command::Command},
};

pub(super) use argument::{Argument, Arguments, Span, to_number};

use super::quirks::Quirks;

pub(super) type Fallible<T = ()> = Result<T, Error>;

/// Bytes of one response unit, without the terminator.
pub(super) type Answer = Vec<u8>;

/// Runs one message on a device. An error anywhere in the message silences the whole reply.
pub(super) fn exchange<D: ScpiDevice>(
    tree: &Node<'_, D>,
    device: &mut D,
    message: &[u8],
) -> Vec<u8> {
    let message = message.trim_ascii();
    let mut reply = Vec::new();
    match tree.run(message, device, &mut Context::new(), &mut reply) {
        Ok(()) => reply,
        Err(_) => Vec::new(),
    }
}

/// Action and answer of a header.
pub(super) struct Verb<D> {
    set: Option<fn(&mut D, &mut Arguments) -> Fallible>,
    get: Option<fn(&mut D, &mut Arguments) -> Fallible<Answer>>,
}

/// Returns a header that is only a command.
pub(super) const fn set<D>(set: fn(&mut D, &mut Arguments) -> Fallible) -> Verb<D> {
    Verb {
        set: Some(set),
        get: None,
    }
}

/// Returns a header that is only a query.
pub(super) const fn get<D>(get: fn(&mut D, &mut Arguments) -> Fallible<Answer>) -> Verb<D> {
    Verb {
        set: None,
        get: Some(get),
    }
}

/// Returns a header that is both.
pub(super) const fn both<D>(
    set: fn(&mut D, &mut Arguments) -> Fallible,
    get: fn(&mut D, &mut Arguments) -> Fallible<Answer>,
) -> Verb<D> {
    Verb {
        set: Some(set),
        get: Some(get),
    }
}

/// A text answer.
#[expect(
    clippy::unnecessary_wraps,
    reason = "the last expression of a query handler"
)]
pub(super) fn text(answer: impl Into<String>) -> Fallible<Answer> {
    Ok(answer.into().into_bytes())
}

/// Returns a switch, answered as `1` or `0`.
pub(super) fn bit(on: bool) -> Fallible<Answer> {
    text(if on { "1" } else { "0" })
}

/// Returns the error number as an error.
pub(super) fn fail<T>(code: ErrorCode) -> Fallible<T> {
    Err(Error::new(code))
}

/// Marks a known header in a form that it does not have. Some firmware distinguishes this from an
/// unknown header.
pub(super) const WRONG_FORM: &[u8] = b"wrong form";

impl<D: ScpiDevice> Command<D> for Verb<D> {
    fn event(&self, device: &mut D, _context: &mut Context, params: Parameters) -> Fallible {
        let Some(set) = self.set else {
            return Err(Error::new(ErrorCode::UndefinedHeader).extended(WRONG_FORM));
        };
        let mut arguments = Arguments::read(params)?;
        set(device, &mut arguments)?;
        arguments.end()
    }

    fn query(
        &self,
        device: &mut D,
        _context: &mut Context,
        params: Parameters,
        mut response: ResponseUnit,
    ) -> Fallible {
        let Some(get) = self.get else {
            return Err(Error::new(ErrorCode::UndefinedHeader).extended(WRONG_FORM));
        };
        let mut arguments = Arguments::read(params)?;
        let answer = get(device, &mut arguments)?;
        arguments.end()?;
        response.data(Raw(&answer)).finish()
    }
}

/// Bytes that go out as they are.
struct Raw<'a>(&'a [u8]);

impl ResponseData for Raw<'_> {
    fn format_response_data(&self, formatter: &mut dyn Formatter) -> Fallible {
        formatter.push_str(self.0)
    }
}

/// The status byte's sources: the error queue and the standard event register.
#[derive(Debug)]
pub(super) struct Status {
    depth: usize,
    errors: VecDeque<Error>,
    esr: u8,
    ese: u8,
    sre: u8,
    /// Values out of range are limited instead of refused.
    clamps: bool,
    /// Unknown headers leave no entry.
    silent: bool,
}

/// A device with a [`Status`].
pub(super) trait HasStatus: ScpiDevice {
    fn status(&mut self) -> &mut Status;
}

impl Status {
    /// Creates an empty queue for `depth` errors, as after power-on.
    pub(super) fn new(depth: usize) -> Self {
        Self {
            depth,
            errors: VecDeque::new(),
            esr: 0x80,
            ese: 0,
            sre: 0,
            clamps: false,
            silent: false,
        }
    }

    /// Applies the error settings of its quirks.
    pub(super) fn quirky(self, quirks: &Quirks) -> Self {
        Self {
            clamps: quirks.is("clamps"),
            silent: quirks.word("unknown") == "silence",
            ..self
        }
    }

    /// Values out of range are limited without an error.
    pub(super) fn clamps(&self) -> bool {
        self.clamps
    }

    /// Checks a value against its range. A value beyond the range is refused or clamped; a value
    /// that is not a number is refused.
    pub(super) fn bounded(&self, value: f64, range: RangeInclusive<f64>) -> Fallible<f64> {
        match value {
            value if range.contains(&value) => Ok(value),
            value if self.clamps && !value.is_nan() => {
                Ok(value.clamp(*range.start(), *range.end()))
            }
            _ => fail(ErrorCode::DataOutOfRange),
        }
    }

    /// Queues an error; a full queue turns its newest entry into −350.
    pub(super) fn push(&mut self, error: Error) {
        let class = error.get_code();
        if self.silent && matches!(class, -113 | -101) {
            return;
        }
        self.esr |= match class {
            -199..=-100 => 0x20,
            -299..=-200 => 0x10,
            -499..=-400 => 0x04,
            _ => 0x08,
        };
        if self.errors.len() < self.depth {
            self.errors.push_back(error);
        } else if let Some(newest) = self.errors.back_mut() {
            *newest = Error::new(ErrorCode::QueueOverflow);
        }
    }

    /// Takes the oldest error.
    pub(super) fn pop(&mut self) -> Option<Error> {
        self.errors.pop_front()
    }
}

/// The commands of IEEE 488.2 that hang on [`Status`].
pub(super) mod common {
    use super::{Answer, Arguments, ErrorCode, Fallible, HasStatus, fail, text};

    pub(crate) fn cls<D: HasStatus>(device: &mut D, _: &mut Arguments) -> Fallible {
        let status = device.status();
        status.errors.clear();
        status.esr = 0;
        Ok(())
    }

    pub(crate) fn opc<D: HasStatus>(device: &mut D, _: &mut Arguments) -> Fallible {
        device.status().esr |= 0x01;
        Ok(())
    }

    pub(crate) fn opc_query<D>(_: &mut D, _: &mut Arguments) -> Fallible<Answer> {
        text("1")
    }

    #[expect(clippy::unnecessary_wraps, reason = "a command handler")]
    pub(crate) fn ignore<D>(_: &mut D, arguments: &mut Arguments) -> Fallible {
        while arguments.next().is_some() {}
        Ok(())
    }

    pub(crate) fn esr_query<D: HasStatus>(device: &mut D, _: &mut Arguments) -> Fallible<Answer> {
        text(std::mem::take(&mut device.status().esr).to_string())
    }

    pub(crate) fn ese<D: HasStatus>(device: &mut D, arguments: &mut Arguments) -> Fallible {
        device.status().ese = byte(arguments)?;
        Ok(())
    }

    pub(crate) fn ese_query<D: HasStatus>(device: &mut D, _: &mut Arguments) -> Fallible<Answer> {
        text(device.status().ese.to_string())
    }

    pub(crate) fn sre<D: HasStatus>(device: &mut D, arguments: &mut Arguments) -> Fallible {
        device.status().sre = byte(arguments)? & !0x40;
        Ok(())
    }

    pub(crate) fn sre_query<D: HasStatus>(device: &mut D, _: &mut Arguments) -> Fallible<Answer> {
        text(device.status().sre.to_string())
    }

    pub(crate) fn stb_query<D: HasStatus>(device: &mut D, _: &mut Arguments) -> Fallible<Answer> {
        let status = device.status();
        let queue = if status.errors.is_empty() { 0 } else { 0x04 };
        let events = if status.esr & status.ese == 0 {
            0
        } else {
            0x20
        };
        let summary = if (queue | events) & status.sre == 0 {
            0
        } else {
            0x40
        };
        text((queue | events | summary).to_string())
    }

    /// `SYSTem:ERRor[:NEXT]?` in the standard form.
    pub(crate) fn error_query<D: HasStatus>(device: &mut D, _: &mut Arguments) -> Fallible<Answer> {
        text(
            device
                .status()
                .pop()
                .map_or_else(|| "0,\"No error\"".to_owned(), |error| error.to_string()),
        )
    }

    /// The same as Keysight writes an empty queue.
    pub(crate) fn signed_error_query<D: HasStatus>(
        device: &mut D,
        _: &mut Arguments,
    ) -> Fallible<Answer> {
        text(
            device
                .status()
                .pop()
                .map_or_else(|| "+0,\"No error\"".to_owned(), |error| error.to_string()),
        )
    }

    fn byte(arguments: &mut Arguments) -> Fallible<u8> {
        let value = arguments.number("")?.round();
        if !(0.0..=255.0).contains(&value) {
            return fail(ErrorCode::DataOutOfRange);
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "checked above"
        )]
        Ok(value as u8)
    }
}
