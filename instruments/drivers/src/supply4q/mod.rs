//! The bipolar (four-quadrant) supply that drives current through the cell, commanded by an analog
//! input.
//!
//! Bring-up order (and the reverse when switching off): output off, mode, limits, zero, analog
//! select, output on. The generator must be at zero whenever the output is switched on; the caller
//! must ensure this, because this module controls one instrument only.

mod caenels;
mod contract;
mod kepco;

use instruments_domain::units::{Amps, Volts};
use instruments_link::{link::LinkError, transport::Address};

use crate::{
    exchange::{Exchange, ExpectedAnswers, after_header, forget_errors},
    instrument::{Instrument, by_key},
    power::moves_current,
};
pub use contract::{AnalogSelect, Capabilities, Dialect, Holds, Limits, OwnLimits, Rating};

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&kepco::BOP_MG, &kepco::BOP_LINEAR, &caenels::FAST_PS];

/// Finds the model of this name, or the member of its family with a rating.
///
/// # Errors
/// An unknown name; a rating that the family does not have.
pub fn dialect(key: &str, rating: Option<Rating>) -> Result<&'static dyn Dialect, String> {
    let model = by_key(DIALECTS, key).ok_or_else(|| {
        let keys: Vec<&str> = DIALECTS.iter().map(|dialect| dialect.key()).collect();
        format!("expected one of {}, found {key:?}", keys.join(", "))
    })?;
    rating.map_or(Ok(model), |rating| model.rated(rating))
}

/// A bipolar supply on its link.
pub type Supply4q = Instrument<dyn Dialect>;

moves_current!(output);

impl Instrument<dyn Dialect> {
    /// Switches the output off, then sets current mode with zero current and reads the limits back.
    /// At this point nothing drives the cell.
    ///
    /// # Errors
    /// The error of the first message that was refused or whose read-back was wrong.
    pub async fn prepare(&mut self, limits: &Limits) -> Result<(), LinkError> {
        let mut expected = self.expected.clone().lock_owned().await;
        *expected = ExpectedAnswers::default();
        forget_errors(&mut self.link).await?;
        self.play(&self.remote()).await?;
        self.play(&self.dialect.output(false)).await?;
        let script = self.dialect.prepare(limits);
        self.play(&script).await?;
        expected.add_bounds(&script, self.dialect.bounds());
        Ok(())
    }

    /// Hands the output to the analog input and switches it on. The caller holds the generator at
    /// zero volts.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn energise(&mut self) -> Result<(), LinkError> {
        self.tell(&self.dialect.analog(true)).await?;
        self.tell(&self.dialect.output(true)).await
    }

    /// Switches the output off, read back; then returns to the digital set-point. Safe at any time,
    /// also twice.
    ///
    /// # Errors
    /// As [`Self::prepare`]; everything is sent whatever fails in between.
    pub async fn safe(&mut self) -> Result<(), LinkError> {
        self.expect_nothing().await;
        let remote = self.play_all(&self.remote()).await;
        let off = self.play_all(&self.dialect.output(false)).await;
        let digital = self.play_all(&self.dialect.analog(false)).await;
        off.and(digital).and(remote)
    }

    /// Returns the messages that take the control from the panel; on a network there is none.
    fn remote(&self) -> Vec<Exchange> {
        match self.link.address() {
            Address::Serial(_) => self.dialect.remote(),
            _ => Vec::new(),
        }
    }

    /// Queries the limits that the supply enforces itself, if it can report them; changes nothing.
    ///
    /// # Errors
    /// The link's errors, including a reply that is not four numbers around zero.
    pub async fn own_limits(&mut self) -> Result<Option<OwnLimits>, LinkError> {
        let Some(query) = self.dialect.own_limits() else {
            return Ok(None);
        };
        let answer = self.link.query(query).await?;
        let numbers: Vec<f64> = after_header(&answer)
            .split(':')
            .filter_map(|number| number.trim().parse().ok())
            .collect();
        match numbers.as_slice() {
            [v0, v1, a0, a1]
                if *v0 <= 0.0
                    && *v1 >= 0.0
                    && *a0 <= 0.0
                    && *a1 >= 0.0
                    && numbers.iter().all(|number| number.is_finite()) =>
            {
                Ok(Some(OwnLimits {
                    volts: (*v0, *v1),
                    amps: (*a0, *a1),
                }))
            }
            _ => Err(LinkError::unexpected(
                self.link.name(),
                query,
                &answer,
                "least and greatest voltage and current, around zero",
            )),
        }
    }
}
