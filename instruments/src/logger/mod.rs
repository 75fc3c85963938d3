//! The temperature logger: thermocouples on the cell and in the air.

mod keysight_34970a;

use crate::{
    exchange::{Exchange, Identity, forget_errors, play},
    link::{Link, LinkError, LinkProfile},
    units::Celsius,
};

/// One model's language.
pub trait Dialect: Send + Sync {
    /// The name in a bench file.
    fn key(&self) -> &'static str;
    /// Pace and deadlines of its link.
    fn profile(&self) -> LinkProfile;
    /// Whether an identity answer is this dialect's.
    fn recognises(&self, identity: &Identity) -> bool;
    /// Type K thermocouples in °C on these channels, in rising order, scanned together.
    fn configure(&self, channels: &[u16]) -> Vec<Exchange>;
    /// Query for one scan.
    fn scan(&self) -> &'static str;
}

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&keysight_34970a::LOGGER_34970A];

/// Answers of this size mean an open thermocouple or an overload.
const OVERLOAD: f64 = 9.0e37;

/// A logger on its link.
pub struct Logger {
    link: Link,
    dialect: &'static dyn Dialect,
    /// In the order of the caller.
    channels: Vec<u16>,
    /// In the order of the scan.
    scanned: Vec<u16>,
}

impl Logger {
    /// Puts a dialect on a link; `channels` are the slots' channel numbers. Sends nothing.
    pub fn new(link: Link, dialect: &'static dyn Dialect, channels: Vec<u16>) -> Self {
        // These instruments scan in rising order, whatever the order of the list.
        let mut scanned = channels.clone();
        scanned.sort_unstable();
        scanned.dedup();
        Self { link, dialect, channels, scanned }
    }

    /// Asks who it is; changes nothing.
    ///
    /// # Errors
    /// The link's.
    pub async fn identify(&mut self) -> Result<Identity, LinkError> {
        Ok(Identity::parse(&self.link.query("*IDN?").await?))
    }

    /// Sets up the scan.
    ///
    /// # Errors
    /// The first message that was refused.
    pub async fn configure(&mut self) -> Result<(), LinkError> {
        forget_errors(&mut self.link).await?;
        play(&mut self.link, &self.dialect.configure(&self.scanned)).await
    }

    /// One scan, in the order of the channels given to [`Self::new`]; `None` for an open thermocouple.
    ///
    /// # Errors
    /// The link's; an answer with another number of readings than channels.
    pub async fn scan(&mut self) -> Result<Vec<Option<Celsius>>, LinkError> {
        let answer = self.link.query(self.dialect.scan()).await?;
        let readings: Option<Vec<f64>> = answer.split(',').map(|text| text.trim().parse::<f64>().ok()).collect();
        match readings {
            Some(readings) if readings.len() == self.scanned.len() => {
                let reading = |channel: &u16| {
                    let place = self.scanned.binary_search(channel).ok()?;
                    readings.get(place).filter(|reading| reading.abs() < OVERLOAD).copied().map(Celsius)
                };
                Ok(self.channels.iter().map(reading).collect())
            }
            _ => {
                let expected = format!("{} readings", self.scanned.len());
                Err(LinkError::unexpected(self.link.name(), self.dialect.scan(), &answer, &expected))
            }
        }
    }

    /// The link, for reconnecting.
    pub fn link_mut(&mut self) -> &mut Link {
        &mut self.link
    }
}
