//! Simulates a cell or a pack under a load: voltage, state of charge and heat over time (thesis
//! chapter 4).
//!
//! In reading order: [`SimModel`] is an ERM with its open-circuit voltage, as a cell or as a pack;
//! [`Profile`] is the demand (power, current or a load resistance over time); `law` converts a
//! demand and a state to a current, also beyond the available power (tangent of thesis 4.2.1);
//! `step` advances the state; [`simulate`] runs a profile with error control and returns a
//! [`Trace`] and a [`Summary`]; [`CellWindow`] judges voltages; [`step_with_jacobian`] and
//! [`sensitivity`] differentiate; [`HeldStep`] steps without memory allocation; [`simulate_batch`]
//! runs many cells in lockstep; [`largest_scale`] determines how much of a profile fits into the
//! window. `additions` contains the parts of [`analysis_effects::effects`] that no linear branch can
//! represent.
//!
//! `mapped` simulates a model whose resistances follow state of charge and temperature.
//!
//! Sign: current and power are positive when the cell is discharged. The temperature stays as it
//! was when the model was measured, unless a map or an addition models the heating of the cell.

mod additions;
mod band;
mod batch;
mod body;
mod error;
mod halving;
mod held;
mod law;
mod limits;
mod mapped;
mod model;
mod nonlinear;
mod options;
pub mod pack;
mod profile;
mod scale;
mod sensitivity;
mod simulate;
mod step;
mod trace;

pub use band::{RunBand, RunError};
pub use batch::{BatchCell, BatchOptions, BatchOutcome, MAX_BATCH_RC, simulate_batch};
pub use error::ForwardError;
pub use held::{HeldStep, Instant};
pub use law::{Beyond, Demand, Drive, Reply};
pub use limits::CellWindow;
pub use model::{OcvSource, SimModel, SimState};
pub use options::{Method, SimOptions, Simulation};
pub use profile::{Interpolation, Profile, ProfileError};
pub use scale::{ScaleBound, ScaleLimit, ScaleOptions, largest_scale};
pub use sensitivity::{
    Jacobian, Sensitivity, SensitivityRow, StepOptions, sensitivity, step_with_jacobian,
};
pub use simulate::simulate;
pub use trace::{Infeasible, Summary, TRACE_BRANCHES, TangentEnd, Trace};

#[cfg(test)]
mod tests;
