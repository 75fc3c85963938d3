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
    /// Names of the channels in the file.
    pub names: Vec<String>,
    pub(super) raw: RawFile,
}

impl ScopeRecord {
    /// Returns a channel by its number in the file, from 0, ready to be fitted.
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

    /// Returns at most `count` samples of a channel in volts, from sample `start` on.
    ///
    /// # Errors
    /// [`ScopeError::Layout`] if the file cannot be read any more.
    pub fn volts(&self, index: usize, start: usize, count: usize) -> Result<Vec<f64>, ScopeError> {
        self.raw
            .volts_of(index, start, count.min(self.samples.saturating_sub(start)))
    }
}
