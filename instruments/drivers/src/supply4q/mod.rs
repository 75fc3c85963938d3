//! The bipolar (four-quadrant) supply that drives current through the cell, commanded by an analog
//! input.
//!
//! Bring-up order (and the reverse on the way down): output off, mode, limits, zero, analog select,
//! output on. The generator must be at zero whenever the output is switched on; that is the
//! caller's business, for this module knows one instrument only.

mod caenels;
mod kepco;

use instruments_domain::units::{Amps, Hertz, Volts};
use instruments_link::link::LinkError;

use crate::{
    exchange::{Answer, Bound, Exchange, ExpectedAnswers, Way, after_header, forget_errors, look},
    instrument::{Instrument, Model},
};

/// How the analog input is made to command the output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AnalogSelect {
    /// A command selects it, and another takes it back.
    Command,
    /// Switches and the rear connector select it: it drives the output whenever the output is on,
    /// whatever is sent.
    Wiring,
}

/// Which limits can be sent that hold while the analog input commands the output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Holds {
    /// Of the current and of the voltage.
    CurrentAndVoltage,
    /// Of the voltage only: the output follows the generator up to its rated current.
    Voltage,
    /// None: the output follows the generator up to its rated current, at any voltage up to its
    /// rating.
    Nothing,
}

/// Limits that a model holds by itself, whatever is sent to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OwnLimits {
    /// Least and greatest voltage, V.
    pub volts: (f64, f64),
    /// Least and greatest current, A.
    pub amps: (f64, f64),
}

/// Capabilities of a model.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Capabilities {
    /// How the analog input is selected.
    pub analog_select: AnalogSelect,
    /// The limits that it takes over.
    pub holds: Holds,
    /// Rated current; ± this is full scale of the analog input.
    pub full_scale: Amps,
    /// Up to here the output follows the analog input within a few per cent.
    pub max_freq: Hertz,
    /// Analog input for full scale.
    pub analog_full_scale: Volts,
}

/// Limits programmed into the instrument before it is energised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Compliance voltage in current mode; sent where [`Capabilities::holds`] says so.
    pub compliance: Volts,
    /// Greatest current of either sign; sent where [`Capabilities::holds`] says so.
    pub current: Amps,
}

/// One model's language.
pub trait Dialect: Model {
    /// Capabilities of the model.
    fn capabilities(&self) -> Capabilities;
    /// Switches the output. Off is the first and the last thing, and must leave the cell
    /// unconnected, not shorted by an output that holds zero volts: where the instrument can do
    /// either, the script chooses first.
    fn output(&self, on: bool) -> Vec<Exchange>;
    /// Ways to drive nothing while the output does not go off, the gentlest first. One that only
    /// its analog input commands has none of its own: the generator's least sine is it.
    fn zero(&self) -> Vec<Way>;
    /// Limits of the current within the instrument.
    fn bounds(&self) -> &'static [Bound] {
        &[]
    }
    /// Current mode, limits, zero set-point; assumes the output is off.
    fn prepare(&self, limits: &Limits) -> Vec<Exchange>;
    /// Hands the output to the analog input, or takes it back.
    fn analog(&self, on: bool) -> Vec<Exchange>;
    /// Queries for terminal voltage and current.
    fn measure(&self) -> [&'static str; 2];
    /// Query for the limits of its own: least and greatest voltage, least and greatest current,
    /// separated by `:`.
    fn own_limits(&self) -> Option<&'static str> {
        None
    }
}

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&kepco::BOP_MG, &kepco::BOP_LINEAR, &caenels::FAST_PS];

/// A bipolar supply on its link.
pub type Supply4q = Instrument<dyn Dialect>;

impl Instrument<dyn Dialect> {
    /// Capabilities of the model.
    pub fn capabilities(&self) -> Capabilities {
        self.dialect.capabilities()
    }

    /// Output off, then current mode with zero current and the limits read back. The cell is not
    /// yet connected to anything that drives it.
    ///
    /// # Errors
    /// The first message that was refused or whose read-back was wrong.
    pub async fn prepare(&mut self, limits: &Limits) -> Result<(), LinkError> {
        forget_errors(&mut self.link).await?;
        self.play(&self.dialect.output(false)).await?;
        let script = self.dialect.prepare(limits);
        self.play(&script).await?;
        self.expected = ExpectedAnswers::default();
        self.expected.add_bounds(&script, self.dialect.bounds());
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

    /// Output off, read back; then back to the digital set-point. Safe at any time, also twice.
    ///
    /// # Errors
    /// As [`Self::prepare`]; everything is sent whatever fails in between.
    pub async fn safe(&mut self) -> Result<(), LinkError> {
        self.expected = ExpectedAnswers::default();
        let off = self.play_all(&self.dialect.output(false)).await;
        let digital = self.play_all(&self.dialect.analog(false)).await;
        off.and(digital)
    }

    /// Ways to drive nothing while the output does not go off, the gentlest first.
    pub fn zero(&self) -> Vec<Way> {
        self.dialect.zero()
    }

    /// Limits of the current within the instrument, by its own answers.
    pub async fn bounds(&mut self) -> Vec<String> {
        self.bounded_by(self.dialect.bounds()).await
    }

    /// Asks whether the output is off, and changes nothing.
    ///
    /// # Errors
    /// The link's.
    pub async fn look(&mut self) -> Result<Vec<Answer>, LinkError> {
        look(&mut self.link, &self.dialect.output(false)).await
    }

    /// The limits that it holds by itself, where it can be asked for them; changes nothing.
    ///
    /// # Errors
    /// The link's; an answer that is not four numbers around zero.
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

    /// Terminal voltage and current (charge positive).
    ///
    /// # Errors
    /// The link's, or [`LinkError`] for an answer that is no number.
    pub async fn measure(&mut self) -> Result<(Volts, Amps), LinkError> {
        let queries = self.dialect.measure();
        self.volts_and_amps(queries).await
    }
}
