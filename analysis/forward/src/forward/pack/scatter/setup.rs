//! Input of the simulation of many packs, and its bounds.

use super::super::links::Links;
use super::super::thermal::PackThermal;
use crate::forward::{CellWindow, OcvSource, Profile};
use analysis_model::{
    map::CellMap,
    model::Erm,
    pack::{Pack, PackError, check_window},
};
use serde::Serialize;

/// Steps of one draw at most.
const MOST_STEPS: f64 = 2e6;

/// Cells of a pack, draws, and cells of all draws at most: beyond it a run fills the memory or
/// never ends.
const MOST_CELLS: f64 = 1e5;
const MOST_DRAWS: f64 = 1e5;
const MOST_DRAWN: f64 = 1e8;

/// Spread of the cells, one standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// All resistances of a cell together, relative.
    pub r: f64,
    /// Each branch resistance separately, in addition, relative.
    pub rk: f64,
    /// Each branch capacitance separately, relative.
    pub ck: f64,
    /// Capacity of a cell, relative; without effect for a constant OCV.
    pub capacity: f64,
    /// State of charge of a group, absolute; without effect for a constant OCV.
    pub soc: f64,
}

impl Spread {
    /// No spread: identical cells.
    pub const NONE: Self = Self {
        r: 0.0,
        rk: 0.0,
        ck: 0.0,
        capacity: 0.0,
        soc: 0.0,
    };

    pub(super) fn check(&self) -> Result<(), PackError> {
        let fields = [
            ("R", self.r),
            ("branch R", self.rk),
            ("branch C", self.ck),
            ("capacity", self.capacity),
            ("SOC", self.soc),
        ];
        match fields
            .into_iter()
            .find(|(_, sigma)| !(0.0..=0.5).contains(sigma))
        {
            Some((_, met)) => Err(PackError::Value {
                what: "spread between cells",
                expected: "a standard deviation from 0 to 0.5",
                met,
            }),
            None => Ok(()),
        }
    }
}

/// Input of the simulation of many packs.
#[derive(Debug, Clone, Copy)]
pub struct ScatterSetup<'a> {
    /// The cell that all others are factors of.
    pub cell: &'a Erm,
    /// Map that the cells follow, if there is one; `cell` is then one point of it.
    pub map: Option<&'a CellMap>,
    /// Open-circuit voltage of a cell.
    pub ocv: &'a OcvSource,
    /// Size and interconnect.
    pub pack: Pack,
    /// Resistances between the cells; without them the cells of a group share their busbars.
    pub links: Option<&'a Links>,
    /// Resistance between each cell and the busbar of its group, or its nodes of the links, Ω.
    pub tab_ohm: f64,
    /// State of charge at the start, at rest; without meaning for a constant OCV.
    pub soc: f64,
    /// Power or current at the pack's terminals, discharge positive.
    pub profile: &'a Profile,
    /// Limits of a cell.
    pub window: CellWindow,
    /// Where the heat of the cells goes.
    pub thermal: PackThermal,
    /// Longest step, s.
    pub max_step_s: f64,
}

/// Number of draws, and their seed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Draws {
    /// Number of packs.
    pub draws: usize,
    /// Seed of all of them.
    pub seed: u64,
}

/// Refuses more packs or cells than fit.
pub(super) fn bounds(setup: &ScatterSetup<'_>, draws: usize) -> Result<(), PackError> {
    let (cells, count) = (setup.pack.cells(), draws as f64);
    let bounds = [
        (
            "cells of the pack, S·P",
            "at most 1e5",
            cells,
            cells <= MOST_CELLS,
        ),
        (
            "number of draws",
            "from 1 to 1e5",
            count,
            (1.0..=MOST_DRAWS).contains(&count),
        ),
        (
            "cells of all draws, S·P times draws",
            "at most 1e8",
            cells * count,
            cells * count <= MOST_DRAWN,
        ),
    ];
    match bounds.into_iter().find(|(.., fits)| !fits) {
        Some((what, expected, met, _)) => Err(PackError::Value {
            what,
            expected,
            met,
        }),
        None => Ok(()),
    }
}

pub(super) fn check(setup: &ScatterSetup<'_>) -> Result<(), PackError> {
    setup.pack.check()?;
    setup.cell.validate()?;
    setup.thermal.check()?;
    check_window(setup.window.low_v..=setup.window.high_v)?;
    let fail = |what, expected, met| {
        Err(PackError::Value {
            what,
            expected,
            met,
        })
    };
    if let Some(map) = setup.map {
        map.validate()?;
        if let OcvSource::Constant(met) = setup.ocv {
            let what = "open-circuit voltage that stays";
            return fail(what, "an OCV curve for a model with a map", *met);
        }
        let branches = setup.cell.branches.len();
        if map.branches.len() != branches {
            let what = "branches of a point of the map";
            return fail(what, "as many as the map has", branches as f64);
        }
    }
    if !(setup.tab_ohm.is_finite() && setup.tab_ohm >= 0.0) {
        return fail(
            "resistance of a cell's tab",
            "zero or more in Ω",
            setup.tab_ohm,
        );
    }
    if !(0.0..=1.0).contains(&setup.soc) {
        return fail("state of charge", "a fraction from 0 to 1", setup.soc);
    }
    let steps = setup.profile.duration_s() / setup.max_step_s;
    if setup.max_step_s.is_nan() || setup.max_step_s <= 0.0 || steps > MOST_STEPS {
        return fail(
            "longest step",
            "seconds above 0 that make fewer than 2e6 steps",
            setup.max_step_s,
        );
    }
    Ok(())
}
