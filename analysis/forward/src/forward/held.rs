//! Steps of one length under a held demand, without memory allocation: for controllers and solvers.
//!
//! They are the steps of [`super::step_with_jacobian`] without its derivatives, and of a model with a
//! map those of [`super::simulate_batch`]. The C header and the CasADi module of a model make the same
//! steps, to second order in their length.

use super::batch::mapped::{ABREAST, MapCell, MapLanes, Steps, run};
use super::error::ForwardError;
use super::law::{Demand, Drive};
use super::limits::CellWindow;
use super::model::{SimModel, SimState};
use super::sensitivity::StepOptions;
use super::step::{Coefficients, Integrator};
use analysis_effects::contract::Ramp;
use analysis_model::map::Outside;

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
    /// Distance of the state from the range of the map, of a model with a map.
    pub outside_map: Option<Outside>,
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
    model: &'m SimModel,
    options: StepOptions,
    window: CellWindow,
    method: Method<'m>,
}

#[derive(Debug, Clone)]
enum Method<'m> {
    Point(Point<'m>),
    Map(Box<MapLanes<'m, 1, ABREAST>>),
}

/// A model of one point.
#[derive(Debug, Clone)]
struct Point<'m> {
    integrator: Integrator<'m>,
    coefficients: Coefficients,
    /// The states at both ends of the part that is made.
    from: SimState,
    next: SimState,
}

/// A cell behind its series resistance.
#[derive(Debug, Clone, Copy)]
struct Source {
    e_v: f64,
    r_ohm: f64,
    outside_map: Option<Outside>,
}

impl<'m> HeldStep<'m> {
    /// Prepares steps of a length.
    ///
    /// # Errors
    /// [`ForwardError`] for options that cannot be, and for a model with additions.
    pub fn new(
        model: &'m SimModel,
        options: &StepOptions,
        window: CellWindow,
    ) -> Result<Self, ForwardError> {
        options.check()?;
        let part_s = options.step_s / f64::from(options.parts);
        let rest = model.rest(0.0)?;
        let cell = MapCell::of(model, 1.0);
        let lanes =
            cell.and_then(|cell| MapLanes::new(&[cell], options.demand, options.beyond, &[part_s]));
        let method = if let Some(lanes) = lanes {
            Method::Map(Box::new(lanes))
        } else {
            model.linear_only("steps of one length")?;
            let drive = Drive {
                demand: options.demand,
                beyond: options.beyond,
                r_ohm: model.erm.r_ohm,
            };
            Method::Point(Point {
                integrator: Integrator::new(model, drive),
                coefficients: Coefficients::new(model, part_s),
                from: rest.clone(),
                next: rest,
            })
        };
        Ok(Self {
            model,
            options: *options,
            window,
            method,
        })
    }

    /// Returns what a state shows under a demand, W, A or Ω.
    ///
    /// # Errors
    /// [`ForwardError::Branches`] or [`ForwardError::Value`] for a state of another model,
    /// [`ForwardError::Collapsed`] without a positive voltage behind the series resistance under a
    /// power.
    pub fn look(&self, state: &SimState, demand: f64) -> Result<Instant, ForwardError> {
        self.model.check(state)?;
        self.instant(self.source(state), 0.0, demand)
    }

    /// Moves a state by one step under a demand, W, A or Ω; returns what its start shows. The state
    /// stays if the step fails.
    ///
    /// # Errors
    /// As [`HeldStep::look`], at both ends of the step and between its parts.
    pub fn advance(&mut self, state: &mut SimState, demand: f64) -> Result<Instant, ForwardError> {
        self.model.check(state)?;
        let start = self.load(state);
        let start = self.instant(start, 0.0, demand)?;
        let part_s = self.options.step_s / f64::from(self.options.parts);
        for part in 1..=self.options.parts {
            let end = self.part(demand);
            self.instant(end, f64::from(part) * part_s, demand)?;
        }
        match &self.method {
            Method::Point(point) => copy(&point.from, state),
            Method::Map(lanes) => lanes.store(0, state),
        }
        Ok(start)
    }

    /// Takes a state as the start of a step.
    fn load(&mut self, state: &SimState) -> Source {
        match &mut self.method {
            Method::Point(point) => {
                copy(state, &mut point.from);
                self.source(state)
            }
            Method::Map(lanes) => {
                lanes.load(0, state);
                let (e_v, r_ohm) = lanes.source(0);
                Source {
                    e_v,
                    r_ohm,
                    outside_map: Some(lanes.outside(0)),
                }
            }
        }
    }

    /// Makes one part of a step.
    fn part(&mut self, demand: f64) -> Source {
        let (e_v, r_ohm) = match &mut self.method {
            Method::Point(point) => {
                let held = Ramp {
                    start: demand,
                    end: demand,
                };
                let Point {
                    integrator,
                    coefficients,
                    from,
                    next,
                } = point;
                integrator.step(coefficients, from, next, held);
                std::mem::swap(from, next);
                (integrator.e_v(from), integrator.drive.r_ohm)
            }
            Method::Map(lanes) => {
                run(lanes, Steps::One(demand));
                lanes.source(0)
            }
        };
        Source {
            e_v,
            r_ohm,
            outside_map: None,
        }
    }

    fn source(&self, state: &SimState) -> Source {
        let sum_v: f64 = state.v_rc_v.iter().sum();
        let Some(mapped) = &self.model.mapped else {
            return Source {
                e_v: self.model.ocv_v(state.soc).0 - sum_v,
                r_ohm: self.model.erm.r_ohm,
                outside_map: None,
            };
        };
        let (map, pack) = (&mapped.map, &self.model.pack);
        let degc = map.thermal.and(state.temperature_degc);
        let degc = degc.unwrap_or(mapped.ambient_degc);
        let at = map.place(state.soc, degc);
        let correction_v = f64::from(pack.series) * map.ocv_correction_v(&at, degc);
        let series_ohm = map.resistance_ohm(&map.series, &at);
        Source {
            e_v: self.model.curve_v(state.soc).0 + correction_v - sum_v,
            r_ohm: pack.ratio() * series_ohm + pack.interconnect_ohm,
            outside_map: Some(at.outside),
        }
    }

    fn instant(&self, source: Source, time_s: f64, demand: f64) -> Result<Instant, ForwardError> {
        let Source {
            e_v,
            r_ohm,
            outside_map,
        } = source;
        let is_power = self.options.demand == Demand::Power;
        if !e_v.is_finite() || (e_v <= 0.0 && is_power) {
            return Err(ForwardError::Collapsed { time_s, e_v });
        }
        let drive = Drive {
            demand: self.options.demand,
            beyond: self.options.beyond,
            r_ohm,
        };
        let reply = drive.reply(e_v, demand);
        let ccv_v = e_v - r_ohm * reply.current_a;
        let cell_v = self.model.cell_v(ccv_v, reply.current_a);
        Ok(Instant {
            ccv_v,
            current_a: reply.current_a,
            margin_low_v: self.window.margin_low_v(cell_v),
            margin_high_v: self.window.margin_high_v(cell_v),
            infeasible: reply.infeasible,
            outside_map,
        })
    }
}

/// Copies a state into another one of the same model, without memory allocation.
fn copy(from: &SimState, to: &mut SimState) {
    to.soc = from.soc;
    to.v_rc_v.copy_from_slice(&from.v_rc_v);
}
