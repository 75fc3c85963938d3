//! Profile of a model's protocol (terminators, gaps, deadlines), and the options of a link.

use std::time::Duration;

use instruments_scpi::decode::{DecoderOptions, Terminator};

use super::guard::{Grammar, NEVER_SENT};
use crate::{
    clock::Clock,
    transcript::Tap,
    transport::{Address, MemoryHub},
};

/// Protocol conventions of one dialect. Gaps count bench time, deadlines count time on the wire
/// ([`Clock::deadline`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkProfile {
    /// The language: what every message must be before it is sent.
    pub grammar: Grammar,
    /// Commands that are refused, in manual notation.
    pub never_sent: &'static [&'static str],
    /// Written behind every message. Answers end with NL, or with CR too where this is
    /// [`Terminator::Cr`].
    pub terminator: Terminator,
    /// Least time between the end of one exchange and the next message.
    pub min_gap: Duration,
    /// Least time after a message that has no answer, if longer than `min_gap`.
    pub write_gap: Duration,
    /// Deadline for connecting and for the first answer on a connection.
    pub first_timeout: Duration,
    /// Deadline for every later line, and for handing a message over.
    pub timeout: Duration,
    /// Deadline for a whole block.
    pub block_timeout: Duration,
    /// How long a serial line must be silent after it was opened, since a serial port cannot
    /// recognise a reply to a query from an earlier connection.
    pub quiet: Duration,
    /// Sent after every write; `None` if the instrument has no error queue.
    pub error_query: Option<&'static str>,
    /// The error query is sent when it is asked for, not after every write, and some firmware does
    /// not know it.
    pub errors_on_demand: bool,
    /// XON and XOFF are taken out of the answers.
    pub strip_flow_bytes: bool,
    /// Longest line, bytes.
    pub max_line: usize,
    /// Longest block, bytes.
    pub max_block: usize,
}

impl LinkProfile {
    /// Returns the profile of an instrument with a SCPI error queue on a raw socket: NL, no gaps,
    /// 10 s for the first reply, 2 s for later ones, 30 s for a block.
    pub const fn scpi() -> Self {
        Self {
            grammar: Grammar::Scpi,
            never_sent: NEVER_SENT,
            terminator: Terminator::Lf,
            min_gap: Duration::ZERO,
            write_gap: Duration::ZERO,
            first_timeout: Duration::from_secs(10),
            timeout: Duration::from_secs(2),
            block_timeout: Duration::from_secs(30),
            quiet: Duration::from_millis(100),
            error_query: Some("SYST:ERR?"),
            errors_on_demand: false,
            strip_flow_bytes: false,
            max_line: 64 << 10,
            max_block: 64 << 20,
        }
    }

    pub(super) fn decoder_options(&self) -> DecoderOptions {
        DecoderOptions {
            terminator: self.terminator,
            max_line: self.max_line,
            max_block: self.max_block,
            strip_flow_bytes: self.strip_flow_bytes,
            has_end_flag: false,
        }
    }
}

impl Default for LinkProfile {
    fn default() -> Self {
        Self::scpi()
    }
}

/// Options with which a link is opened.
#[derive(Debug, Clone)]
pub struct LinkOptions {
    /// The instrument's name on this bench, for messages and transcripts.
    pub name: String,
    /// Address of the instrument.
    pub address: Address,
    /// How it wants to be talked to.
    pub profile: LinkProfile,
    /// Bench time.
    pub clock: Clock,
    /// Where memory addresses are looked up.
    pub hub: MemoryHub,
    /// Destination of the transcript.
    pub tap: Tap,
}
