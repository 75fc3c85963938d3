//! Sends the newest frame: descriptor and samples, a page at a time.

use super::{
    COUNTS_PER_DIV, Channel, Scope,
    acquisition::Frame,
    descriptor::{Descriptor, LENGTH},
};
use crate::plant::DigitiseRequest;
use crate::tree::{Answer, Fallible, fail};
use scpi::error::ErrorCode;

/// Sample words are ADC counts shifted left by this many bits.
const JUSTIFY: u32 = 4;
const CODE_MIN: i16 = -2048;
const CODE_MAX: i16 = 2047;
/// Behind the payload of a block; the end of the message adds a second one.
const TAIL: u8 = b'\n';

impl Scope {
    /// Returns the frame of the chosen channel, when both exist.
    fn source_frame(&self) -> Option<(Frame, Channel)> {
        let frame = self.acquisition.remembered(self.world.now_s)?;
        let channel = *frame.panel.channels.get(self.transfer.source)?;
        channel.on.then_some((frame, channel))
    }

    /// Returns the points of a page as announced.
    pub(super) fn announced_points(&self) -> usize {
        match self.quirks.count("announced_points") {
            0 => self.page_points,
            announced => announced,
        }
    }

    /// All zeros until there is something to describe, or no answer at all.
    pub(super) fn preamble(&self) -> Fallible<Answer> {
        let descriptor = match self.source_frame() {
            Some((frame, channel)) => Descriptor {
                frame: &frame,
                channel: &channel,
                transfer: &self.transfer,
            }
            .bytes(),
            None if self.quirks.is("zeroed_descriptor") => vec![0; LENGTH],
            None => return fail(ErrorCode::DataCorruptOrStale),
        };
        Ok(block(&descriptor))
    }

    /// One page from the start point on.
    pub(super) fn data(&self) -> Answer {
        let Some((frame, channel)) = self.source_frame() else {
            return block(&[]);
        };
        let codes = self.digitise(&frame, &channel);
        let mut payload = Vec::with_capacity(codes.len() * if self.transfer.words { 2 } else { 1 });
        for code in codes {
            let word = code << JUSTIFY;
            match (self.transfer.words, self.transfer.big_endian) {
                (true, true) => payload.extend(word.to_be_bytes()),
                (true, false) => payload.extend(word.to_le_bytes()),
                // Only the high byte: eight of the twelve bits.
                (false, _) => payload.push(word.to_be_bytes()[0]),
            }
        }
        block(&payload)
    }

    fn digitise(&self, frame: &Frame, channel: &Channel) -> Vec<i16> {
        let (points, interval_s) = frame.panel.sampling();
        let transfer = &self.transfer;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at least 1 and at most 10^7"
        )]
        let left = (points as u64)
            .saturating_sub(transfer.start)
            .div_ceil(transfer.interval);
        let wanted = if transfer.points == 0 {
            left
        } else {
            left.min(transfer.points)
        };
        let count = usize::try_from(wanted)
            .unwrap_or(usize::MAX)
            .min(self.page_points);
        let counts_per_volt = COUNTS_PER_DIV / channel.input_scale();
        if channel.coupling == "GND" {
            return vec![grounded(channel.input_offset() * counts_per_volt); count];
        }
        let request = DigitiseRequest {
            channel: u8::try_from(transfer.source + 1).unwrap_or(u8::MAX),
            start_s: frame.start_s,
            interval_s,
            first: transfer.start,
            stride: transfer.interval,
            count,
            volts_per_div: channel.input_scale(),
            offset_v: channel.input_offset(),
            codes_per_volt: counts_per_volt,
            code_min: CODE_MIN,
            code_max: CODE_MAX,
            acquisition: frame.number,
        };
        if count == 0 {
            return Vec::new();
        }
        self.world.plant().digitise(self.world.now_s, &request)
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "clamped to the range of the codes"
)]
fn grounded(counts: f64) -> i16 {
    counts
        .round()
        .clamp(f64::from(CODE_MIN), f64::from(CODE_MAX)) as i16
}

/// Returns a definite block with nine digits and its first line feed.
fn block(payload: &[u8]) -> Answer {
    let mut bytes = format!("#9{:09}", payload.len()).into_bytes();
    bytes.extend_from_slice(payload);
    bytes.push(TAIL);
    bytes
}
