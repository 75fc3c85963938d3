//! Additions that no linear branch can represent: branches with a law of their own, and states that
//! move resistances or add voltages.
//!
//! All cells are equal, so that one is integrated, at I/P, and the terminals follow: E = S·(U −
//! Σv + Σadditions), R = S/P·f·R₀ + interconnect, where f is the additions' factor; the current is
//! the root of [`super::law`] with these. A step is Strang's: additions half a step, branches and
//! charge, additions half a step, with currents that see the additions of the middle: second order,
//! and exact for branches under a prescribed current. The steps grow from a part of the shortest
//! time constant after every change of the demand; the whole run is repeated with halved steps
//! until no row moves by more than the tolerance.

mod run;

use super::error::ForwardError;
use super::halving::{Apart, halved};
use super::model::{SimModel, SimState};
use super::nonlinear::Laws;
use super::options::{Method, SimOptions, Simulation};
use super::profile::Profile;
use run::Run;

/// Two runs, one with half the steps of the other, must agree at every row within this, V per cell.
const AGREE_V: f64 = 2e-6;

/// As [`super::simulate`], which has checked state and options.
pub(super) fn simulate(
    model: &SimModel,
    laws: &Laws,
    state: &SimState,
    profile: &Profile,
    options: &SimOptions,
) -> Result<Simulation, ForwardError> {
    if options.method == Method::Thesis {
        model.linear_only("explicit Euler")?;
    }
    let play = |halvings: u32| Run::play(model, laws, state, profile, options, halvings);
    halved(model, options, AGREE_V, play).map_err(|apart| match apart {
        Apart::Failed(error) => error,
        Apart::Unresolved { tolerance_v, met_v } => ForwardError::Unresolved {
            names: laws.names(),
            tolerance_v,
            met_v,
        },
    })
}
