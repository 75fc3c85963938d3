//! Contract between a logger and its dialects.

use crate::{exchange::Exchange, instrument::Model};

/// One model's language.
pub trait Dialect: Model {
    /// Returns whether the channel exists. A model that accepts any number has a card whose slots
    /// are not known here.
    fn has_channel(&self, _channel: u16) -> bool {
        true
    }
    /// Configures type K thermocouples in °C on these channels, scanned together.
    fn configure(&self, channels: &[u16]) -> Vec<Exchange>;
    /// Returns the query for one scan.
    fn scan(&self) -> &'static str;
}
