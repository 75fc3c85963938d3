//! The state of power over state of charge and duration.

use super::search::{Limit, LimitedBy, SopOptions, most_power};
use crate::forward::{ForwardError, OcvSource, SimModel};
use rayon::prelude::*;
use serde::Serialize;

/// Grid of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct SopGrid {
    /// States of charge, 0…1; one of any value for a constant OCV.
    pub soc: Vec<f64>,
    /// Durations, s, above zero.
    pub duration_s: Vec<f64>,
}

/// One place of the map, from rest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SopEntry {
    /// State of charge; none for a constant OCV.
    pub soc: Option<f64>,
    /// Open-circuit voltage of a cell, V.
    pub ocv_v: f64,
    /// Time that the power is held, s.
    pub duration_s: f64,
    /// Most power out of the terminals, W, zero or more.
    pub discharge_w: f64,
    /// Most power into the terminals, W, zero or less.
    pub charge_w: f64,
    /// Largest current of a cell under that discharge, A.
    pub discharge_cell_a: f64,
    /// Largest current of a cell under that charge, A, without sign.
    pub charge_cell_a: f64,
    /// Limits that end the discharge and the charge.
    pub limited_by: Limits,
    /// The same by the simple-IR model (DC resistance from the first instant, SOC at rest), W.
    pub simple_ir_discharge_w: f64,
    /// The same for charging, W.
    pub simple_ir_charge_w: f64,
}

/// Limit that ends the power, per direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Limits {
    /// Limit of the discharge.
    pub discharge: LimitedBy,
    /// Limit of the charge.
    pub charge: LimitedBy,
}

/// Returns the map, by state of charge and then by duration, from rest.
///
/// # Errors
/// As [`most_power`], and for an invalid state of charge.
pub fn sop_map(
    model: &SimModel,
    grid: &SopGrid,
    options: &SopOptions,
) -> Result<Vec<SopEntry>, ForwardError> {
    let places: Vec<(f64, f64)> = grid
        .soc
        .iter()
        .flat_map(|&soc| grid.duration_s.iter().map(move |&t| (soc, t)))
        .collect();
    places
        .par_iter()
        .map(|&(soc, duration_s)| entry(model, soc, duration_s, options))
        .collect()
}

fn entry(
    model: &SimModel,
    soc: f64,
    duration_s: f64,
    options: &SopOptions,
) -> Result<SopEntry, ForwardError> {
    let (discharge, charge) = most_power(model, &model.rest(soc)?, duration_s, options)?;
    let (ir_discharge, ir_charge) = simple_ir(model, soc, duration_s, options)?;
    let series = f64::from(model.pack.series);
    Ok(SopEntry {
        soc: matches!(model.ocv, OcvSource::Curve(_)).then_some(soc),
        ocv_v: model.ocv_v(soc).0 / series,
        duration_s,
        discharge_w: discharge.power_w,
        charge_w: charge.power_w,
        discharge_cell_a: discharge.cell_a,
        charge_cell_a: charge.cell_a,
        limited_by: Limits {
            discharge: discharge.limited_by,
            charge: charge.limited_by,
        },
        simple_ir_discharge_w: ir_discharge.power_w,
        simple_ir_charge_w: ir_charge.power_w,
    })
}

/// Returns the same limits of the DC resistance alone, at the OCV of the start.
fn simple_ir(
    model: &SimModel,
    soc: f64,
    duration_s: f64,
    options: &SopOptions,
) -> Result<(Limit, Limit), ForwardError> {
    let cell_v = model.ocv_v(soc).0 / f64::from(model.pack.series);
    let ir = SimModel {
        ocv: OcvSource::Constant(cell_v),
        ..model.simple_ir(soc)
    };
    most_power(&ir, &ir.rest(soc)?, duration_s, options)
}
