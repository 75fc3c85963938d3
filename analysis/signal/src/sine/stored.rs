//! Samples that are stored elsewhere and read in pieces. The sums are the same as for samples in
//! memory.

mod store;

use super::moments::CHUNK;
use super::{Channel, CodeScale, SineError};
pub use store::{Samples, Stored};

/// Samples that are read at once: eight chunks, which is a row group as Parquet writes them.
const SEGMENT: usize = 8 * CHUNK;

/// A piece of a channel, from sample `base` of it on.
pub(super) enum Piece<'a> {
    /// The samples in place.
    Whole(Channel<'a>),
    /// As it was read.
    Codes(Vec<i16>, CodeScale),
    /// As it was read.
    Volts(Vec<f64>, Option<f64>),
}

impl Piece<'_> {
    /// Returns the piece as a separate channel.
    pub(super) fn channel(&self) -> Channel<'_> {
        match self {
            Self::Whole(channel) => *channel,
            Self::Codes(codes, scale) => Channel::codes(codes, *scale),
            Self::Volts(samples, lsb_v) => Channel::Volts {
                samples,
                lsb_v: *lsb_v,
                range_v: None,
            },
        }
    }
}

impl<'a> Channel<'a> {
    /// Returns the number of samples that are read at once; all of them if they are in memory.
    pub(super) fn segment(&self) -> usize {
        if let Self::Stored(_) = self {
            SEGMENT
        } else {
            self.len().max(1)
        }
    }

    /// The samples from `start` on, a segment of them and one more for what neighbours have to do
    /// with each other.
    pub(super) fn load(&self, number: usize, start: usize) -> Result<Piece<'a>, SineError> {
        let Self::Stored(stored) = self else {
            return Ok(Piece::Whole(*self));
        };
        let count = (SEGMENT + 1).min(stored.count.saturating_sub(start));
        stored.read(number, start, count)
    }

    /// One code of a channel of codes.
    pub(super) fn code(&self, number: usize, index: usize) -> Result<Option<i16>, SineError> {
        match self {
            Self::Codes { codes, .. } => Ok(codes.get(index).copied()),
            Self::Stored(stored) if stored.scale.is_some() => {
                match stored.read(number, index, 1)? {
                    Piece::Codes(codes, _) => Ok(codes.first().copied()),
                    _ => Ok(None),
                }
            }
            Self::Volts { .. } | Self::Stored(_) => Ok(None),
        }
    }

    /// Returns the conversion of codes to volts, if the samples are codes.
    pub(super) fn scale(&self) -> Option<CodeScale> {
        match self {
            Self::Codes { scale, .. } => Some(*scale),
            Self::Stored(stored) => stored.scale,
            Self::Volts { .. } => None,
        }
    }
}

impl Stored<'_> {
    fn read<'b>(&self, number: usize, start: usize, count: usize) -> Result<Piece<'b>, SineError> {
        let failed = |reason| SineError::Unreadable {
            channel: number,
            reason,
        };
        let short = |found: usize| {
            failed(format!(
                "expected {count} samples from sample {} on, found {found}",
                self.start + start
            ))
        };
        let from = self.start + start;
        let piece = match self.scale {
            Some(scale) => Piece::Codes(
                self.samples
                    .codes(self.channel, from, count)
                    .map_err(failed)?,
                scale,
            ),
            None => Piece::Volts(
                self.samples
                    .volts(self.channel, from, count)
                    .map_err(failed)?,
                self.lsb_v,
            ),
        };
        let found = piece.channel().len();
        if found == count {
            Ok(piece)
        } else {
            Err(short(found))
        }
    }
}
