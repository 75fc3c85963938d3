//! Derivatives of the step and of a whole profile, in forward mode: fit for an optimiser, and for
//! carrying uncertainty from the model to a voltage.
//!
//! They are the exact derivatives of the map that the step is (see `step`), not of the differential
//! equation: an optimiser that uses both sees one consistent function. The tangent beyond P₀ is
//! part of it and joins with continuous derivative.

use super::error::ForwardError;
use super::law::{Beyond, Demand, Drive};
use super::model::{SimModel, SimState};
use super::options::SimOptions;
use super::profile::{DemandPoint, Profile};
use super::step::{Coefficients, Ends, Integrator};
use analysis_effects::contract::Ramp;
use nalgebra::{DMatrix, DVector};

/// Options of a step with derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepOptions {
    /// Kind of the demand, held over the step.
    pub demand: Demand,
    /// Treatment of power that cannot be delivered; [`Beyond::Stop`] here is [`Beyond::Clamp`].
    pub beyond: Beyond,
    /// Length of the step, s.
    pub step_s: f64,
    /// Equal parts in which it is made: short beside the fastest time constant where accuracy
    /// matters.
    pub parts: u32,
}

/// A step and its derivatives. States are (SOC, v₁, v₂, …); parameters are those of the model at
/// the terminals: R, R₁, C₁, R₂, C₂, …, and an offset of the terminals' OCV in V; all in SI units.
#[derive(Debug, Clone, PartialEq)]
pub struct Jacobian {
    /// The state after the step.
    pub next: SimState,
    /// Voltage at the terminals at the start of the step, V.
    pub ccv_v: f64,
    /// Current there, A.
    pub current_a: f64,
    /// True if the demand exceeded the available power anywhere in the step.
    pub infeasible: bool,
    /// A = ∂(next)/∂(state).
    pub a: DMatrix<f64>,
    /// B = ∂(next)/∂(demand).
    pub b: DVector<f64>,
    /// C = ∂(CCV)/∂(state).
    pub c: DVector<f64>,
    /// D = ∂(CCV)/∂(demand).
    pub d: f64,
    /// ∂(next)/∂(parameters).
    pub next_by_parameter: DMatrix<f64>,
    /// ∂(CCV)/∂(parameters).
    pub ccv_by_parameter: DVector<f64>,
}

/// The voltage at an instant of a profile and its derivatives.
#[derive(Debug, Clone, PartialEq)]
pub struct SensitivityRow {
    /// Time, s.
    pub time_s: f64,
    /// Voltage at the terminals, V.
    pub ccv_v: f64,
    /// Derivative with respect to a common factor of all demands, V.
    pub by_scale_v: f64,
    /// Derivatives with respect to R, R₁, C₁, …, OCV offset, as in [`Jacobian`].
    pub by_parameter: Vec<f64>,
    /// Derivatives with respect to the state at the start (SOC, v₁, v₂, …).
    pub by_state: Vec<f64>,
}

/// A profile's voltages with derivatives, at both sides of every jump.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensitivity {
    /// By rising time.
    pub rows: Vec<SensitivityRow>,
    /// Derivatives of the state at the end: rows (SOC, v₁, …), columns (scale, parameters, state at
    /// the start).
    pub end: DMatrix<f64>,
}

/// A direction in which the model is varied, and how the state follows.
#[derive(Debug, Clone)]
struct Direction {
    what: What,
    soc: f64,
    v: Vec<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum What {
    Demand,
    SeriesR,
    BranchR(usize),
    BranchC(usize),
    OcvOffset,
    State(usize),
}

/// One step with A, B, C, D and the derivatives by the parameters.
///
/// # Errors
/// [`ForwardError`] for a state of another model, a step that cannot be, or a model driven beyond
/// its meaning.
pub fn step_with_jacobian(
    model: &SimModel,
    state: &SimState,
    demand: f64,
    options: &StepOptions,
) -> Result<Jacobian, ForwardError> {
    model.check(state)?;
    model.linear_only("derivatives")?;
    options.check()?;
    let integrator = Integrator::new(
        model,
        Drive {
            demand: options.demand,
            beyond: options.beyond,
            r_ohm: model.erm.r_ohm,
        },
    );
    let mut directions = directions(model);
    let at = |time_s: f64| DemandPoint { time_s, demand };
    let output = Look::at(&integrator, at(0.0), state)?;
    let by: Vec<f64> = directions
        .iter()
        .map(|d| output.slope(&integrator, d, 1.0))
        .collect();
    let coefficients = Coefficients::new(model, options.step_s / f64::from(options.parts));
    let (mut now, mut infeasible) = (state.clone(), output.infeasible);
    let held = |value: f64| Ramp {
        start: value,
        end: value,
    };
    for _ in 0..options.parts {
        infeasible |= advance(
            &integrator,
            &coefficients,
            &mut now,
            &mut directions,
            held(demand),
            held(1.0),
        );
    }
    Look::at(&integrator, at(options.step_s), &now)?;
    let (states, parameters) = (1 + now.v_rc_v.len(), 2 + 2 * now.v_rc_v.len());
    let all = matrix(&directions);
    Ok(Jacobian {
        ccv_v: output.ccv_v,
        current_a: output.current_a,
        infeasible,
        a: all.columns(1 + parameters, states).into_owned(),
        b: all.column(0).into_owned(),
        c: DVector::from_column_slice(&by[1 + parameters..]),
        d: by[0],
        next_by_parameter: all.columns(1, parameters).into_owned(),
        ccv_by_parameter: DVector::from_column_slice(&by[1..=parameters]),
        next: now,
    })
}

/// Returns a whole profile with derivatives, in steps of at most `max_step_s` without error
/// control.
///
/// # Errors
/// As [`super::simulate`].
pub fn sensitivity(
    model: &SimModel,
    state: &SimState,
    profile: &Profile,
    beyond: Beyond,
    max_step_s: f64,
) -> Result<Sensitivity, ForwardError> {
    model.check(state)?;
    model.linear_only("derivatives")?;
    SimOptions {
        beyond,
        max_step_s,
        ..SimOptions::default()
    }
    .check(profile)?;
    let integrator = Integrator::new(
        model,
        Drive {
            demand: profile.demand,
            beyond,
            r_ohm: model.erm.r_ohm,
        },
    );
    let (mut now, mut directions, mut rows) = (state.clone(), directions(model), Vec::new());
    let mut coefficients = Coefficients {
        step_s: f64::NAN,
        branches: Vec::new(),
    };
    let mut last_demand = None;
    for piece in profile.pieces(max_step_s) {
        if coefficients.step_s != piece.step_s {
            coefficients = Coefficients::new(model, piece.step_s);
        }
        if last_demand != Some(piece.from) {
            rows.push(row(&integrator, piece.start(), &now, &directions)?);
        }
        last_demand = Some(piece.to);
        // A common factor moves the demand by the demand itself.
        let demand = Ramp {
            start: piece.from,
            end: piece.to,
        };
        advance(
            &integrator,
            &coefficients,
            &mut now,
            &mut directions,
            demand,
            demand,
        );
        let end = DemandPoint {
            time_s: piece.from_s + piece.step_s,
            demand: piece.to,
        };
        rows.push(row(&integrator, end, &now, &directions)?);
    }
    Ok(Sensitivity {
        rows,
        end: matrix(&directions),
    })
}

impl StepOptions {
    pub(super) fn check(&self) -> Result<(), ForwardError> {
        let bad = |what, expected, met| {
            Err(ForwardError::Value {
                what,
                expected,
                met,
            })
        };
        if !(self.step_s.is_finite() && self.step_s > 0.0) {
            return bad("step", "a number of seconds above 0", self.step_s);
        }
        if self.parts == 0 {
            return bad("parts of a step", "at least 1", 0.0);
        }
        match self.beyond.fraction() {
            Some(fraction) if !self.beyond.is_valid() => bad(
                "fraction of the available power",
                "a number above 0 and below 1",
                fraction,
            ),
            _ => Ok(()),
        }
    }
}

/// Demand, parameters, state at the start.
fn directions(model: &SimModel) -> Vec<Direction> {
    let n = model.erm.branches.len();
    let branches = (0..n).flat_map(|k| [What::BranchR(k), What::BranchC(k)]);
    let whats = [What::Demand, What::SeriesR]
        .into_iter()
        .chain(branches)
        .chain([What::OcvOffset])
        .chain((0..=n).map(What::State));
    let unit = |hit: bool| if hit { 1.0 } else { 0.0 };
    whats
        .map(|what| Direction {
            what,
            soc: unit(what == What::State(0)),
            v: (0..n).map(|k| unit(what == What::State(k + 1))).collect(),
        })
        .collect()
}

fn matrix(directions: &[Direction]) -> DMatrix<f64> {
    let height = 1 + directions.first().map_or(0, |d| d.v.len());
    DMatrix::from_fn(height, directions.len(), |i, j| {
        if i == 0 {
            directions[j].soc
        } else {
            directions[j].v[i - 1]
        }
    })
}

fn row(
    integrator: &Integrator<'_>,
    asked: DemandPoint,
    now: &SimState,
    directions: &[Direction],
) -> Result<SensitivityRow, ForwardError> {
    let look = Look::at(integrator, asked, now)?;
    let by: Vec<f64> = directions
        .iter()
        .map(|d| look.slope(integrator, d, asked.demand))
        .collect();
    let parameters = 2 + 2 * now.v_rc_v.len();
    Ok(SensitivityRow {
        time_s: asked.time_s,
        ccv_v: look.ccv_v,
        by_scale_v: by[0],
        by_parameter: by[1..=parameters].to_vec(),
        by_state: by[1 + parameters..].to_vec(),
    })
}

/// Voltage and current of an instant, with their derivatives.
pub(super) struct Look {
    pub(super) ccv_v: f64,
    pub(super) current_a: f64,
    pub(super) infeasible: bool,
    ocv_slope_v: f64,
    reply: super::law::Reply,
}

impl Look {
    pub(super) fn at(
        integrator: &Integrator<'_>,
        asked: DemandPoint,
        state: &SimState,
    ) -> Result<Self, ForwardError> {
        let DemandPoint { time_s, demand } = asked;
        let e_v = integrator.e_v(state);
        if !e_v.is_finite() || (e_v <= 0.0 && integrator.drive.demand == Demand::Power) {
            return Err(ForwardError::Collapsed { time_s, e_v });
        }
        let reply = integrator.drive.reply(e_v, demand);
        let ccv_v = e_v - integrator.drive.r_ohm * reply.current_a;
        let ocv_slope_v = integrator.model.ocv_v(state.soc).1;
        Ok(Self {
            ccv_v,
            current_a: reply.current_a,
            infeasible: reply.infeasible,
            ocv_slope_v,
            reply,
        })
    }

    /// Returns the derivative of the voltage along a direction; `d_demand` is that of the demand
    /// along [`What::Demand`].
    fn slope(&self, integrator: &Integrator<'_>, d: &Direction, d_demand: f64) -> f64 {
        let d_e = self.ocv_slope_v * d.soc - d.v.iter().sum::<f64>() + d.what.ocv();
        let series = if d.what == What::SeriesR {
            self.current_a
        } else {
            0.0
        };
        d_e - integrator.drive.r_ohm * self.reply.along(d.what, d_e, d_demand) - series
    }
}

impl super::law::Reply {
    fn along(&self, what: What, d_e: f64, d_demand: f64) -> f64 {
        let direct = match what {
            What::Demand => self.d_demand * d_demand,
            What::SeriesR => self.d_r,
            _ => 0.0,
        };
        self.d_e * d_e + direct
    }
}

impl What {
    fn ocv(self) -> f64 {
        if self == Self::OcvOffset { 1.0 } else { 0.0 }
    }
}

/// Derivative of one branch's decay and gains (start, end) along a direction.
fn gain_slope(
    integrator: &Integrator<'_>,
    c: &Coefficients,
    k: usize,
    what: What,
) -> (f64, f64, f64) {
    let (g, b) = (&c.branches[k], &integrator.model.erm.branches[k]);
    let x = c.step_s / b.time_constant_s();
    // With respect to ln τ, which R and C change alike.
    let by_tau = (
        g.decay * x,
        b.r_ohm * (g.phi - g.decay - g.decay * x),
        -b.r_ohm * (g.phi - g.decay),
    );
    match what {
        What::BranchR(j) if j == k => (
            by_tau.0 / b.r_ohm,
            (by_tau.1 + g.start) / b.r_ohm,
            (by_tau.2 + g.end) / b.r_ohm,
        ),
        What::BranchC(j) if j == k => (by_tau.0 / b.c_f, by_tau.1 / b.c_f, by_tau.2 / b.c_f),
        _ => (0.0, 0.0, 0.0),
    }
}

/// Makes one step of the state and of all directions; the demand comes with its derivative along
/// [`What::Demand`]. Returns true if the demand is infeasible.
fn advance(
    integrator: &Integrator<'_>,
    c: &Coefficients,
    now: &mut SimState,
    directions: &mut [Direction],
    demand: Ramp,
    d_demand: Ramp,
) -> bool {
    let from = now.clone();
    let ends = integrator.step(c, &from, now, demand);
    for direction in directions {
        follow(integrator, c, &from, &ends, direction, d_demand);
    }
    ends.start.infeasible || ends.end.infeasible
}

fn follow(
    integrator: &Integrator<'_>,
    c: &Coefficients,
    from: &SimState,
    ends: &Ends,
    d: &mut Direction,
    d_demand: Ramp,
) {
    let (h, capacity_coulomb) = (c.step_s, integrator.capacity_coulomb);
    let (i0, i1) = (ends.start.current_a, ends.end.current_a);
    let slope0_v = integrator.model.ocv_v(from.soc).1;
    let slope1_v = integrator
        .model
        .ocv_v(from.soc - h * i0 / capacity_coulomb)
        .1;
    let d_e0 = slope0_v * d.soc - d.v.iter().sum::<f64>() + d.what.ocv();
    let d_i0 = ends.start.along(d.what, d_e0, d_demand.start);
    let slopes: Vec<(f64, f64, f64)> = (0..d.v.len())
        .map(|k| gain_slope(integrator, c, k, d.what))
        .collect();
    let held = |k: usize| {
        let (g, s) = (&c.branches[k], &slopes[k]);
        g.decay * d.v[k] + (g.start + g.end) * d_i0 + s.0 * from.v_rc_v[k] + (s.1 + s.2) * i0
    };
    let d_held: f64 = (0..d.v.len()).map(held).sum();
    let d_e1 = slope1_v * (d.soc - h * d_i0 / capacity_coulomb) - d_held + d.what.ocv();
    let d_i1 = ends.end.along(d.what, d_e1, d_demand.end);
    for (k, v) in d.v.iter_mut().enumerate() {
        let (g, s) = (&c.branches[k], &slopes[k]);
        *v = g.decay * *v
            + g.start * d_i0
            + g.end * d_i1
            + s.0 * from.v_rc_v[k]
            + s.1 * i0
            + s.2 * i1;
    }
    d.soc -= 0.5 * h * (d_i0 + d_i1) / capacity_coulomb;
}
