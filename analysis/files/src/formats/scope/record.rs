//! Record of an oscilloscope.

use analysis_signal::sine::{Channel, Stored};

use super::{error::ScopeError, raw::RawFile};

/// A record of one or more channels, on disk.
#[derive(Debug)]
pub struct ScopeRecord {
    /// Kind of the file.
    pub kind: &'static str,
    /// Time between two samples, s.
    pub interval_s: f64,
    /// Samples of each channel.
    pub samples: usize,
    /// Names of the channels as the file has them.
    pub names: Vec<String>,
    pub(super) raw: RawFile,
}

impl ScopeRecord {
    /// A channel by its number in the file, from 0, ready to be fitted.
    pub fn channel(&self, index: usize) -> Option<Channel<'_>> {
        let layout = self.raw.channels.get(index)?;
        Some(Channel::Stored(Stored {
            samples: &self.raw,
            channel: index,
            start: 0,
            count: self.samples,
            scale: layout.scale,
            lsb_v: layout.lsb_v,
            level_v: layout.level_v,
        }))
    }

    /// Volts of a channel from its number `start` on, at most `count`.
    ///
    /// # Errors
    /// [`ScopeError::Layout`] for a file that cannot be read any more.
    pub fn volts(&self, index: usize, start: usize, count: usize) -> Result<Vec<f64>, ScopeError> {
        self.raw
            .volts_of(index, start, count.min(self.samples.saturating_sub(start)))
    }
}
