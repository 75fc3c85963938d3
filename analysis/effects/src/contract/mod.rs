//! Contract between the catalogue of effects and the code that simulates or fits them: the
//! properties of an effect, and the model that it acts upon.

pub(crate) mod branch;
mod equation;
mod network;
pub(crate) mod quantity;
mod situation;

use num_complex::Complex64;

pub use branch::{Branch, Law, Ramp};
pub use equation::{Equation, Relaxation};
pub use network::Network;
pub use quantity::{Parameter, Range, Scale, Usual};
pub use situation::{
    Base, CommonModeImpedance, Facts, HeldOutError, Instant, Modulation, Moved, Point, Record,
};

/// Place of an effect: in the cell or in the bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// Physics of the cell: belongs into a model that predicts.
    Cell,
    /// An artefact of the bench: explains a measurement, never a prediction.
    Bench,
}

/// Properties of an effect that hold without any data.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Card {
    /// Name in files and on the command line: `rc_slow`.
    pub name: &'static str,
    /// Name as text: "additional relaxation".
    pub title: &'static str,
    /// Cell or bench.
    pub group: Group,
    /// Physical mechanism, one or two sentences.
    pub mechanism: &'static str,
    /// State equation with units.
    pub state_equation: &'static str,
    /// Impedance with units, or what becomes of one.
    pub impedance: &'static str,
    /// Equation, clause or paper.
    pub source: &'static str,
    /// Signature in the data.
    pub signature: &'static str,
    /// Names of effects that look alike.
    pub confounders: &'static [&'static str],
    /// Names of effects that it becomes at a limit of its shape, and then fits as well as they do.
    pub contains: &'static [&'static str],
    /// The experiment that separates it from them.
    pub experiment: &'static str,
}

/// One effect. All hooks default to "nothing happens". `p` are the values of
/// [`Effect::parameters`], in their units and order.
pub trait Effect: Sync {
    /// Properties of the effect.
    fn card(&self) -> &'static Card;

    /// Returns its parameters with bounds derived from the base fit, the strength first; empty if
    /// it does not apply to this base or data.
    fn parameters(&self, base: &Base) -> Vec<Parameter>;

    /// Returns whether it differs between runs that repeat each other: it depends on their order,
    /// their start or the charge before them.
    fn tells_repeats_apart(&self, _p: &[f64]) -> bool {
        false
    }

    /// Returns the values for predictions, in which time since the campaign and charge before it
    /// are not known: by default unchanged.
    fn predicting(&self, p: Vec<f64>) -> Vec<f64> {
        p
    }

    /// Changes the linear network: acts on impedance and on time alike.
    fn network(&self, _p: &[f64], _base: &Base, _network: &mut Network) {}

    /// Returns the impedance that a point of a spectrum shows instead of `z_ohm`, Ω.
    fn impedance(&self, _p: &[f64], _base: &Base, _at: &Point, z_ohm: Complex64) -> Complex64 {
        z_ohm
    }

    /// Turns the logged current (A, discharge positive) of a record into the one that flowed.
    fn current(&self, _p: &[f64], _record: &Record<'_>, _current_a: &mut [f64]) {}

    /// Returns the state of the effect over time, or `None` if it has no state.
    fn dynamics(
        &self,
        _p: &[f64],
        _base: &Base,
        _record: &Record<'_>,
    ) -> Option<Box<dyn Dynamics>> {
        None
    }

    /// Returns the law of [`Effect::dynamics`] as numbers, for a record that starts at rest after
    /// the campaign; `None` for an effect without dynamics, or with one that has no such form.
    fn equation(&self, _p: &[f64], _base: &Base) -> Option<Equation> {
        None
    }

    /// True seconds per second of the logger's clock.
    fn clock(&self, _p: &[f64]) -> f64 {
        1.0
    }

    /// Turns the voltage (V) at the terminals into the logged one.
    fn voltage(&self, _p: &[f64], _record: &Record<'_>, _voltage_v: &mut [f64]) {}
}

/// An effect with a state of its own.
pub trait Dynamics {
    /// Factors on resistances at this instant.
    fn modulation(&self, _at: &Instant) -> Modulation {
        Modulation::NONE
    }

    /// Returns the voltage added to the terminal voltage at this instant, V.
    fn voltage_v(&self, _at: &Instant) -> f64 {
        0.0
    }

    /// Returns whether the effect needs [`Instant::heat_w`] of an instant. If no effect needs it,
    /// it is NaN in the simulation of a record.
    fn asks_heat(&self) -> bool {
        false
    }

    /// Moves the state over `step_s` seconds in which the current of `at` flows; `at` is the
    /// instant at the start.
    fn advance(&mut self, _at: &Instant, _step_s: f64) {}
}

/// Returns the impedance of the charge that the sinusoid moves along the OCV curve, Ω:
/// (dU/dz)/(jω·Q). A record shows it as its slope over charge.
pub fn storage_ohm(base: &Base, at: &Point) -> Complex64 {
    let per_coulomb = base.ocv.slope_v(at.soc) / (3600.0 * base.ocv.capacity_ah);
    Complex64::new(0.0, -per_coulomb / (std::f64::consts::TAU * at.freq_hz))
}
