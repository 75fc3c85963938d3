//! The cells of a pack one by one, as factors of the model's: drawn from a spread, or given.

use super::super::mapped::MappedCell;
use super::super::network::Cell;
use super::{Draws, ScatterSetup, Spread, bounds, check};
use analysis_model::{model::Erm, pack::PackError};
use analysis_numeric::Rng;

/// Cells of all packs that may be listed, at most: a table of a few hundred megabytes.
const MOST_LISTED: f64 = 1e6;

/// One cell at its position: its parameters relative to the model's, as factors.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedCell {
    /// Its name.
    pub name: String,
    /// A cell's own model in place of that of the pack; as many branches.
    pub erm: Option<Erm>,
    /// Factor of the series resistance.
    pub r: f64,
    /// Factor of each branch resistance.
    pub rk: Vec<f64>,
    /// Factor of each branch capacitance.
    pub ck: Vec<f64>,
    /// Factor of the capacity of the OCV curve; without effect for a constant OCV.
    pub capacity: f64,
    /// State of charge at the start, at rest; without effect for a constant OCV.
    pub soc: f64,
}

impl PlacedCell {
    /// A cell as the model has it.
    pub fn plain(name: String, branches: usize, soc: f64) -> Self {
        Self {
            name,
            erm: None,
            r: 1.0,
            rk: vec![1.0; branches],
            ck: vec![1.0; branches],
            capacity: 1.0,
            soc,
        }
    }

    pub(super) fn cell(&self, model: &Erm) -> Cell {
        let mut erm = self.erm.as_ref().unwrap_or(model).clone();
        erm.r_ohm *= self.r;
        for ((branch, r), c) in erm.branches.iter_mut().zip(&self.rk).zip(&self.ck) {
            branch.r_ohm *= r;
            branch.c_f *= c;
        }
        Cell {
            erm,
            capacity_ratio: self.capacity,
            soc: self.soc,
        }
    }

    /// Returns the cell as factors of a map.
    pub(super) fn mapped(self) -> MappedCell {
        let factors = self.rk.iter().zip(&self.ck);
        MappedCell {
            r: self.r,
            tau: factors.map(|(r, c)| r * c).collect(),
            rk: self.rk,
            capacity_ratio: self.capacity,
            soc: self.soc,
        }
    }

    fn check(&self, model: &Erm) -> Result<(), PackError> {
        let fail = |what, expected, met| {
            Err(PackError::Value {
                what,
                expected,
                met,
            })
        };
        let (own, branches) = (
            self.erm
                .as_ref()
                .map_or(model.branches.len(), |erm| erm.branches.len()),
            model.branches.len(),
        );
        if [own, self.rk.len(), self.ck.len()]
            .iter()
            .any(|met| *met != branches)
        {
            return fail(
                "branches of a cell",
                "as many as the model has, with a factor each",
                own as f64,
            );
        }
        let factors = [self.r, self.capacity]
            .into_iter()
            .chain(self.rk.iter().copied())
            .chain(self.ck.iter().copied());
        if let Some(met) = factors
            .into_iter()
            .find(|factor| !(factor.is_finite() && *factor > 0.0))
        {
            return fail("factor of a cell", "a number above 0", met);
        }
        self.erm.as_ref().map_or(Ok(()), Erm::validate)?;
        Ok(())
    }
}

/// Draws one pack, group by group.
pub(super) fn draw(spread: &Spread, setup: &ScatterSetup<'_>, rng: &mut Rng) -> Vec<PlacedCell> {
    let mut cells = Vec::new();
    for group in 1..=setup.pack.series {
        let soc = setup.soc + spread.soc * rng.normal();
        for place in 1..=setup.pack.parallel {
            let mut factor = |sigma: f64| (sigma * rng.normal()).exp();
            let (all, capacity) = (factor(spread.r), factor(spread.capacity));
            let branches = setup
                .cell
                .branches
                .iter()
                .map(|_| (all * factor(spread.rk), factor(spread.ck)));
            let (rk, ck) = branches.unzip();
            cells.push(PlacedCell {
                name: format!("g{group}p{place}"),
                erm: None,
                r: all,
                rk,
                ck,
                capacity,
                soc,
            });
        }
    }
    cells
}

/// Returns the packs that [`super::scatter`] would draw, cell by cell.
///
/// # Errors
/// [`PackError`] as there, and for more cells than a table can hold.
pub fn drawn_cells(
    setup: &ScatterSetup<'_>,
    spread: &Spread,
    draws: Draws,
) -> Result<Vec<Vec<PlacedCell>>, PackError> {
    check(setup)?;
    spread.check()?;
    bounds(setup, draws.draws)?;
    let met = setup.pack.cells() * draws.draws as f64;
    if met > MOST_LISTED {
        return Err(PackError::Value {
            what: "cells of all draws in a table",
            expected: "at most 1e6",
            met,
        });
    }
    let mut rng = Rng::new(draws.seed);
    Ok((0..draws.draws)
        .map(|_| draw(spread, setup, &mut Rng::new(rng.next_u64())))
        .collect())
}

/// Checks that packs are those of the setup.
pub(super) fn check_packs(
    setup: &ScatterSetup<'_>,
    packs: &[Vec<PlacedCell>],
) -> Result<(), PackError> {
    for pack in packs {
        if pack.len() as f64 != setup.pack.cells() {
            return Err(PackError::Value {
                what: "cells of a pack",
                expected: "as many as S·P",
                met: pack.len() as f64,
            });
        }
        pack.iter().try_for_each(|cell| cell.check(setup.cell))?;
        let own = pack.iter().filter(|cell| cell.erm.is_some()).count();
        if setup.map.is_some() && own > 0 {
            return Err(PackError::Value {
                what: "cells with a model of their own in a pack whose cells follow a map",
                expected: "none",
                met: own as f64,
            });
        }
    }
    Ok(())
}
