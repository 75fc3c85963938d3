//! Store of samples, and the part of it that is a channel.

use super::super::CodeScale;

/// Store of samples. Channels count from 0.
pub trait Samples: std::fmt::Debug + Sync {
    /// Returns codes of a channel, `count` of them from `start` on.
    ///
    /// # Errors
    /// The reason why they cannot be read, as text.
    fn codes(&self, channel: usize, start: usize, count: usize) -> Result<Vec<i16>, String>;

    /// Returns volts of a channel, `count` of them from `start` on.
    ///
    /// # Errors
    /// The reason why they cannot be read, as text; also if the samples are codes.
    fn volts(&self, channel: usize, start: usize, count: usize) -> Result<Vec<f64>, String> {
        let _ = (channel, start, count);
        Err("expected volts, found codes".to_owned())
    }
}

/// Samples of one channel that are kept elsewhere, or a part of them.
#[derive(Debug, Clone, Copy)]
pub struct Stored<'a> {
    /// Store of the samples.
    pub samples: &'a dyn Samples,
    /// The channel there, from 0.
    pub channel: usize,
    /// The first sample of the part.
    pub start: usize,
    /// Samples of the part.
    pub count: usize,
    /// Scaling of the codes; `None` for volts.
    pub scale: Option<CodeScale>,
    /// Step of the quantisation of volts, V.
    pub lsb_v: Option<f64>,
    /// A level that is taken from volts before they are summed, V; a sample of them will do.
    pub level_v: f64,
}

impl PartialEq for Stored<'_> {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::addr_eq(self.samples, other.samples)
            && (self.channel, self.start, self.count) == (other.channel, other.start, other.count)
    }
}
