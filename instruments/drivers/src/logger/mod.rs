//! The temperature logger: thermocouples on the cell and in the air.

mod contract;
mod keysight_34970a;
mod siglent_sdm;

use std::sync::PoisonError;

use instruments_domain::units::Celsius;
use instruments_link::link::LinkError;
use instruments_scpi::message::{Field, parse_response};

use crate::{
    exchange::forget_errors,
    instrument::{Instrument, Scan},
};
pub use contract::Dialect;

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&keysight_34970a::LOGGER_34970A, &siglent_sdm::SDM];

/// A logger on its link.
pub type Logger = Instrument<dyn Dialect>;

impl Instrument<dyn Dialect> {
    /// Sets up the scan.
    ///
    /// # Errors
    /// The first message that was refused.
    pub async fn configure(&mut self) -> Result<(), LinkError> {
        forget_errors(&mut self.link).await?;
        let script = self.dialect.configure(&self.ascending());
        self.play(&script).await
    }

    /// Makes one scan, in the order of the channels in use; `None` for an open thermocouple.
    ///
    /// # Errors
    /// The link's; an answer with another number of readings than channels.
    pub async fn scan(&mut self) -> Result<Vec<Option<Celsius>>, LinkError> {
        let answer = self.link.query(self.dialect.scan()).await?;
        let readings: Result<Vec<f64>, _> =
            parse_response(&answer).iter().map(Field::as_f64).collect();
        match readings {
            // An open thermocouple is answered as 9.9E37, which the codec reads as infinite.
            Ok(readings) if readings.len() == self.ascending().len() => {
                // A scan list is answered by rising channel, whatever its order was.
                let order = self.ascending();
                let of = |channel: &u16| {
                    order
                        .iter()
                        .position(|other| other == channel)
                        .and_then(|index| readings.get(index).copied())
                };
                let celsius = |channel| {
                    of(channel)
                        .filter(|reading: &f64| reading.is_finite())
                        .map(Celsius)
                };
                let scanned: Vec<Option<Celsius>> =
                    self.setup.channels.iter().map(celsius).collect();
                *self.scanned.lock().unwrap_or_else(PoisonError::into_inner) = Some(Scan {
                    cell: scanned.first().copied().flatten(),
                    answered_s: self.link.clock().machine_s(),
                });
                Ok(scanned)
            }
            _ => {
                let expected = format!("{} readings", self.ascending().len());
                Err(LinkError::unexpected(
                    self.link.name(),
                    self.dialect.scan(),
                    &answer,
                    &expected,
                ))
            }
        }
    }

    /// Returns the last scan, by any handle.
    pub fn last_scan(&self) -> Option<Scan> {
        *self.scanned.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn ascending(&self) -> Vec<u16> {
        let mut channels = self.setup.channels.clone();
        channels.sort_unstable();
        // A channel that is listed twice is scanned once.
        channels.dedup();
        channels
    }
}
