//! Steps of one length under a held demand, without memory allocation: for controllers and solvers.
//!
//! They are the steps of [`super::step_with_jacobian`] without its derivatives. The C header and
//! the CasADi module of a model make the same steps.

use super::error::ForwardError;
use super::law::Drive;
use super::limits::CellWindow;
use super::model::{SimModel, SimState};
use super::profile::DemandPoint;
use super::sensitivity::{Look, StepOptions};
use super::step::{Coefficients, Integrator};
use analysis_effects::contract::Ramp;

/// Voltages and current of an instant under a demand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instant {
    /// Voltage at the terminals, V.
    pub ccv_v: f64,
    /// Current, A, discharge positive.
    pub current_a: f64,
    /// Voltage of a cell above the lower limit, V; negative below it.
    pub margin_low_v: f64,
    /// Voltage of a cell below the upper limit, V; negative above it.
    pub margin_high_v: f64,
    /// True if the demand exceeds the available power, P* = E²/4R.
    pub infeasible: bool,
}

/// Steps of one length: what depends on the model and the length is computed once.
///
/// ```
/// use analysis_forward::forward::{
///     Beyond, CellWindow, Demand, HeldStep, OcvSource, SimModel, StepOptions,
/// };
/// use analysis_model::model::{Erm, RcBranch};
///
/// let erm = Erm { r_ohm: 0.015, branches: vec![RcBranch { r_ohm: 0.01, c_f: 300.0 }] };
/// let model = SimModel::cell(&erm, OcvSource::Constant(3.7))?;
/// let options = StepOptions {
///     demand: Demand::Power,
///     beyond: Beyond::Extrapolate { fraction: Beyond::FRACTION },
///     step_s: 0.01,
///     parts: 1,
/// };
/// let mut step = HeldStep::new(&model, &options, CellWindow::THESIS)?;
/// let mut state = model.rest(0.5)?;
/// let start = step.advance(&mut state, 20.0)?;
/// let end = step.look(&state, 20.0)?;
/// assert!((start.ccv_v * start.current_a - 20.0).abs() < 1e-9);
/// assert!(end.ccv_v < start.ccv_v && end.margin_low_v > 1.0 && !end.infeasible);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct HeldStep<'m> {
    integrator: Integrator<'m>,
    coefficients: Coefficients,
    window: CellWindow,
    parts: u32,
    /// The states at both ends of the part that is made.
    from: SimState,
    next: SimState,
}

impl<'m> HeldStep<'m> {
    /// Prepares steps of a length.
    ///
    /// # Errors
    /// [`ForwardError`] for options that cannot be, and for a model with a map or additions.
    pub fn new(
        model: &'m SimModel,
        options: &StepOptions,
        window: CellWindow,
    ) -> Result<Self, ForwardError> {
        model.linear_only("steps of one length")?;
        options.check()?;
        let drive = Drive {
            demand: options.demand,
            beyond: options.beyond,
            r_ohm: model.erm.r_ohm,
        };
        Ok(Self {
            integrator: Integrator::new(model, drive),
            coefficients: Coefficients::new(model, options.step_s / f64::from(options.parts)),
            window,
            parts: options.parts,
            from: model.rest(0.0)?,
            next: model.rest(0.0)?,
        })
    }

    /// Returns what a state shows under a demand, W, A or Ω.
    ///
    /// # Errors
    /// [`ForwardError::Branches`] or [`ForwardError::Value`] for a state of another model,
    /// [`ForwardError::Collapsed`] without a positive voltage behind the series resistance under a
    /// power.
    pub fn look(&self, state: &SimState, demand: f64) -> Result<Instant, ForwardError> {
        self.integrator.model.check(state)?;
        self.instant(state, 0.0, demand)
    }

    /// Moves a state by one step under a demand, W, A or Ω; returns what its start shows. The state
    /// stays if the step fails.
    ///
    /// # Errors
    /// As [`HeldStep::look`], at both ends of the step and between its parts.
    pub fn advance(&mut self, state: &mut SimState, demand: f64) -> Result<Instant, ForwardError> {
        let start = self.look(state, demand)?;
        let held = Ramp {
            start: demand,
            end: demand,
        };
        copy(state, &mut self.from);
        for part in 1..=self.parts {
            self.integrator
                .step(&self.coefficients, &self.from, &mut self.next, held);
            std::mem::swap(&mut self.from, &mut self.next);
            let time_s = f64::from(part) * self.coefficients.step_s;
            self.instant(&self.from, time_s, demand)?;
        }
        copy(&self.from, state);
        Ok(start)
    }

    fn instant(&self, state: &SimState, time_s: f64, demand: f64) -> Result<Instant, ForwardError> {
        let asked = DemandPoint { time_s, demand };
        let look = Look::at(&self.integrator, asked, state)?;
        let cell_v = self.integrator.model.cell_v(look.ccv_v, look.current_a);
        Ok(Instant {
            ccv_v: look.ccv_v,
            current_a: look.current_a,
            margin_low_v: self.window.margin_low_v(cell_v),
            margin_high_v: self.window.margin_high_v(cell_v),
            infeasible: look.infeasible,
        })
    }
}

/// Copies a state into another one of the same model, without memory allocation.
fn copy(from: &SimState, to: &mut SimState) {
    to.soc = from.soc;
    to.v_rc_v.copy_from_slice(&from.v_rc_v);
}
