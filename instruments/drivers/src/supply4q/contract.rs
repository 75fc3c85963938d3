//! Contract between a four-quadrant supply and its dialects.

use instruments_domain::units::{Amps, Hertz, Volts};

use crate::{
    exchange::{Bound, Exchange, Way},
    instrument::Model,
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
    /// None, and no message reaches the supply: it is neither switched nor read.
    NoLink,
}

/// Rated voltage and current of a member of a family.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Rating {
    /// Rated voltage of either sign, V.
    pub volts: f64,
    /// Rated current of either sign, A.
    pub amps: f64,
}

impl Rating {
    /// Reads the volts, the amperes and the option in a model's name: `36-12`, `20-50MG`.
    pub fn parse(word: &str) -> Option<Self> {
        let (volts, amps) = word.trim().split_once('-')?;
        let digits = amps
            .find(|c: char| !(c.is_ascii_digit() || c == '.'))
            .unwrap_or(amps.len());
        let (number, option) = amps.split_at(digits);
        let (volts, amps): (f64, f64) = (volts.parse().ok()?, number.parse().ok()?);
        let named = option.chars().all(|c| c.is_ascii_alphanumeric());
        (volts > 0.0 && amps > 0.0 && volts.is_finite() && amps.is_finite() && named)
            .then_some(Self { volts, amps })
    }

    /// Rated power, W.
    pub fn watts(self) -> f64 {
        self.volts * self.amps
    }
}

/// Limits that a model enforces itself, regardless of what is sent to it.
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
    /// Compliance voltage in current mode; sent if [`Capabilities::holds`] lists it.
    pub compliance: Volts,
    /// Greatest current of either sign; sent if [`Capabilities::holds`] lists it.
    pub current: Amps,
}

/// One model's language.
pub trait Dialect: Model {
    /// Capabilities of the model.
    fn capabilities(&self) -> Capabilities;
    /// Switches the output. The first and the last step of a session switch it off. This must leave
    /// the cell unconnected, not shorted by an output that holds zero volts: if the instrument can
    /// do either, the script selects the former first.
    fn output(&self, on: bool) -> Vec<Exchange>;
    /// Takes the control from the panel, on a serial line.
    fn remote(&self) -> Vec<Exchange> {
        Vec::new()
    }
    /// Returns methods to drive no current if the output does not switch off, the gentlest first. A
    /// model with an analog input as its only command has none; the generator's smallest sine
    /// serves instead.
    fn zero(&self) -> Vec<Way>;
    /// Limits of the current within the instrument.
    fn bounds(&self) -> &'static [Bound] {
        &[]
    }
    /// Sets current mode, limits and zero set-point; assumes the output is off.
    fn prepare(&self, limits: &Limits) -> Vec<Exchange>;
    /// Hands the output to the analog input, or takes it back.
    fn analog(&self, on: bool) -> Vec<Exchange>;
    /// Queries for terminal voltage and current.
    fn measure(&self) -> [&'static str; 2];
    /// Returns the member of the family with another rating.
    ///
    /// # Errors
    /// Why the family has no such member.
    fn rated(&self, rating: Rating) -> Result<&'static dyn Dialect, String> {
        let Rating { volts, amps } = rating;
        Err(format!(
            "expected no rating: {} has only one, found {volts}-{amps}",
            self.key()
        ))
    }
    /// Returns the query for its own limits: least and greatest voltage, least and greatest
    /// current, separated by `:`.
    fn own_limits(&self) -> Option<&'static str> {
        None
    }
}
