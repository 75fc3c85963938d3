//! Simulates a cell or a pack under a load: voltage, state of charge and heat over time (thesis
//! chapter 4).
//!
//! In reading order: [`SimModel`] is an ERM with its open-circuit voltage, as a cell or as a pack;
//! [`Profile`] is what is asked of it (power, current or a load resistance over time); `law` turns
//! a demand and a state into a current, also beyond the power that can be had (tangent of
//! thesis 4.2.1); `step` moves the state; [`simulate`] runs a profile with error control and
//! delivers a [`Trace`] and a [`Summary`]; [`CellWindow`] judges voltages; [`step_with_jacobian`]
//! and [`sensitivity`] differentiate; [`simulate_batch`] runs many cells in lockstep;
//! [`largest_scale`] asks how much of a profile fits into the window. `additions` is what effects
//! of [`analysis_effects::effects`] do that no linear branch can.
//!
//! Sign: current and power are positive when the cell is discharged. The temperature stays as it
//! was when the model was measured, unless an addition says how the cell warms.

mod additions;
mod batch;
mod error;
mod law;
mod limits;
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

pub use batch::{BatchCell, BatchOptions, BatchOutcome, MAX_BATCH_RC, simulate_batch};
pub use error::ForwardError;
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
