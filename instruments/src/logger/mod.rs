//! The temperature logger: thermocouples on the cell and in the air.

mod keysight_34970a;

use crate::{
    exchange::{Exchange, Identity, play},
    link::{Link, LinkError, LinkProfile},
    scpi::message::{Field, parse_response},
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
    /// Type K thermocouples in °C on these channels, scanned together.
    fn configure(&self, channels: &[u16]) -> Vec<Exchange>;
    /// Query for one scan.
    fn scan(&self) -> &'static str;
}

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&keysight_34970a::LOGGER_34970A];

/// A logger on its link.
pub struct Logger {
    link: Link,
    dialect: &'static dyn Dialect,
    channels: Vec<u16>,
}

impl Logger {
    /// Puts a dialect on a link; `channels` are the slots' channel numbers. Sends nothing.
    pub fn new(link: Link, dialect: &'static dyn Dialect, channels: Vec<u16>) -> Self {
        Self { link, dialect, channels }
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
        play(&mut self.link, &self.dialect.configure(&self.channels)).await
    }

    /// One scan; `None` for an open thermocouple.
    ///
    /// # Errors
    /// The link's; an answer with another number of readings than channels.
    pub async fn scan(&mut self) -> Result<Vec<Option<Celsius>>, LinkError> {
        let answer = self.link.query(self.dialect.scan()).await?;
        let readings: Result<Vec<f64>, _> = parse_response(&answer).iter().map(Field::as_f64).collect();
        match readings {
            // An open thermocouple is answered as 9.9E37, which the codec reads as infinite.
            Ok(readings) if readings.len() == self.channels.len() => {
                Ok(readings.into_iter().map(|reading| reading.is_finite().then_some(Celsius(reading))).collect())
            }
            _ => {
                let expected = format!("{} readings", self.channels.len());
                Err(LinkError::unexpected(self.link.name(), self.dialect.scan(), &answer, &expected))
            }
        }
    }

    /// The link, for reconnecting.
    pub fn link_mut(&mut self) -> &mut Link {
        &mut self.link
    }
}
