//! The chiller that holds the cell's water blocks at a temperature.

mod contract;
mod huber;
mod julabo;
mod relay_board;

use instruments_domain::units::Celsius;
use instruments_link::link::LinkError;

use crate::{
    exchange::{Answer, ExpectedAnswers, Way, look},
    instrument::Instrument,
};
use contract::HARMLESS_C;
pub use contract::{Dialect, Status};

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&julabo::JULABO, &huber::HUBER, &relay_board::RELAY_BOARD];

/// A chiller on its link.
pub type Chiller = Instrument<dyn Dialect>;

impl Instrument<dyn Dialect> {
    /// Returns the range of set-points.
    pub fn range(&self) -> (Celsius, Celsius) {
        self.dialect.range()
    }

    /// Queries state and alarms.
    ///
    /// # Errors
    /// The link's.
    pub async fn status(&mut self) -> Result<Status, LinkError> {
        let answer = self.link.query(self.dialect.queries()[1]).await?;
        let status = self.dialect.status(&answer);
        match self
            .dialect
            .asks_whether_it_runs(&answer)
            .filter(|_| status.alarm.is_none())
        {
            Some((query, yes)) => {
                let running = yes.judge(&self.link.query(query).await?).is_ok();
                // In remote mode the bath does what it was commanded.
                Ok(Status {
                    running,
                    remote: true,
                    ..status
                })
            }
            None => Ok(status),
        }
    }

    /// Sets the temperature, if it has a set-point, and starts. Both are read back, because some
    /// baths ignore commands silently in manual mode.
    ///
    /// # Errors
    /// The link's errors; manual mode; an alarm.
    pub async fn start(&mut self, setpoint: Celsius) -> Result<(), LinkError> {
        let status = self.status().await?;
        self.require_remote(&status)?;
        if let Some(alarm) = &status.alarm {
            return Err(LinkError::unexpected(
                self.link.name(),
                self.dialect.queries()[1],
                alarm,
                "no alarm",
            ));
        }
        let script = self.dialect.run(Some(setpoint));
        // If the daemon closes the loop, it changes the relay commands continuously.
        if self.is_regulated() {
            self.play(&script).await
        } else {
            self.tell(&script).await
        }
    }

    /// Returns whether the daemon must close the loop, by [`Self::pulse`].
    pub fn is_regulated(&self) -> bool {
        self.dialect.pulse(0.0).is_some()
    }

    /// Heats or cools for the given time; read back.
    ///
    /// # Errors
    /// The link's; a relay that does not do it; nothing is sent to a chiller that closes its loop
    /// itself.
    pub async fn pulse(&mut self, seconds: f64) -> Result<(), LinkError> {
        match self.dialect.pulse(seconds) {
            Some(script) => self.play(&script).await,
            None => Ok(()),
        }
    }

    /// Ways to harm nothing while it does not stop.
    pub fn zero(&self) -> Vec<Way> {
        self.dialect.zero()
    }

    /// Stops the chiller.
    ///
    /// # Errors
    /// The link's errors; a read-back that differs; manual mode, unless it is already stopped.
    pub async fn stop(&mut self) -> Result<(), LinkError> {
        self.expect_nothing().await;
        let stopped = self.play(&self.dialect.run(None)).await;
        if let Err(LinkError::ReadBack { .. }) = &stopped {
            let status = self.status().await?;
            self.require_remote(&status)?;
        }
        stopped
    }

    fn require_remote(&self, status: &Status) -> Result<(), LinkError> {
        if status.remote {
            return Ok(());
        }
        let expected = "remote mode (set it on the panel: in manual mode commands are ignored)";
        Err(LinkError::unexpected(
            self.link.name(),
            self.dialect.queries()[1],
            &status.raw,
            expected,
        ))
    }

    /// Queries whether it is stopped, or its relays are open, and changes nothing.
    ///
    /// # Errors
    /// The link's errors.
    pub async fn look(&mut self) -> Result<Vec<Answer>, LinkError> {
        look(
            &mut self.link,
            self.dialect.settings(),
            &self.dialect.run(None),
        )
        .await
    }

    /// Registers that another process started it at this set-point, which must still apply. Sends
    /// nothing.
    pub async fn was_left_at(&self, setpoint: Celsius) {
        *self.expected.lock().await = if self.is_regulated() {
            ExpectedAnswers::default()
        } else {
            ExpectedAnswers::of(&self.dialect.run(Some(setpoint)))
        };
    }

    /// Returns the set-point, or `None` for a bath whose loop is closed elsewhere.
    ///
    /// # Errors
    /// The link's errors, including a reply that is not a number.
    pub async fn setpoint(&mut self) -> Result<Option<Celsius>, LinkError> {
        match self.dialect.setpoint() {
            Some(query) => self.celsius(query).await.map(Some),
            None => Ok(None),
        }
    }

    /// Returns the temperature of the bath.
    ///
    /// # Errors
    /// The link's errors, including a reply that is not a number.
    pub async fn temperature(&mut self) -> Result<Celsius, LinkError> {
        self.celsius(self.dialect.queries()[0]).await
    }

    async fn celsius(&mut self, query: &str) -> Result<Celsius, LinkError> {
        let answer = self.link.query(query).await?;
        let celsius = self
            .dialect
            .celsius(&answer)
            .filter(|celsius| celsius.is_finite());
        celsius
            .map(Celsius)
            .ok_or_else(|| LinkError::unexpected(self.link.name(), query, &answer, "a temperature"))
    }
}
