//! Arguments on the heat of a pack, and what follows from them and from the model.

use analysis::{
    forward::pack::PackThermal,
    map::{CellMap, TEMPERATURES_DEGC},
    pack::ThermalMass,
};
use clap::Args;

use super::super::pack_size::ThermalArgs;
use crate::command::units;
use bench_core::safety::failure::Failure;
use bench_evaluate::files::AMBIENT_DEGC;
use bench_plan::config::quantity::Temperature;

/// Where the heat of the cells goes.
#[derive(Debug, Clone, Copy, Args)]
pub struct HeatArgs {
    /// Mass and specific heat of a cell; for a map with a heat capacity, which they replace, both or
    /// neither.
    #[command(flatten)]
    pub mass: ThermalArgs,
    /// Temperature of the surroundings, and of the cells at the start, °C.
    #[arg(
        long,
        default_value_t = AMBIENT_DEGC,
        value_name = "DEGC",
        allow_hyphen_values = true,
        value_parser = units::of::<Temperature>
    )]
    pub ambient_degc: f64,
    /// Thermal resistance from a cell to the surroundings, K/W [default: that of the map; without one
    /// no heat leaves a cell]
    #[arg(long, value_name = "K/W", allow_negative_numbers = true)]
    pub path_k_per_w: Option<f64>,
    /// Share of that path that goes through the four sides of a cell, 0 to 1: a side that faces a
    /// neighbour is lost for it.
    #[arg(
        long,
        value_name = "X",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub side_share: f64,
    /// Conductance between two cells side by side, in a group or in groups that follow each other,
    /// W/K.
    #[arg(
        long,
        value_name = "W/K",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub neighbour_w_per_k: f64,
    /// Conductance between a cell and each busbar that touches it, W/K. With it the heat of the
    /// interconnect flows into the groups that it joins; without it the heat is lost.
    #[arg(
        long,
        value_name = "W/K",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub busbar_w_per_k: f64,
}

impl HeatArgs {
    /// Returns where the heat of the cells of a model goes. What the arguments give comes first, then
    /// the map.
    ///
    /// # Errors
    /// A value that cannot be.
    pub(super) fn thermal(&self, map: Option<&CellMap>) -> Result<PackThermal, Failure> {
        self.check()?;
        let mass = self.mass.mass();
        mass.check()
            .map_err(|error| Failure::Usage(error.to_string()))?;
        let of_map = map.and_then(|map| map.thermal);
        if let (Some(of_map), Some(missing)) = (of_map, self.mass.missing()) {
            return Err(Failure::Usage(format!(
                "{missing}: expected both --cell-mass-kg and --specific-heat, or neither: together \
                they replace the {:.1} J/K of the map",
                of_map.capacity_j_per_k
            )));
        }
        let given = self.mass.is_given()
            || self.path_k_per_w.is_some()
            || self.neighbour_w_per_k > 0.0
            || self.busbar_w_per_k > 0.0;
        let own_j_per_k = of_map.filter(|_| !self.mass.is_given());
        let path_k_per_w = self
            .path_k_per_w
            .or(of_map.map(|of_map| of_map.resistance_k_per_w));
        if self.side_share > 0.0 && path_k_per_w.is_none() {
            return Err(Failure::Usage(
                "--side-share: expected a path to the surroundings by --path-k-per-w or of a map, \
                found none"
                    .to_owned(),
            ));
        }
        Ok(PackThermal {
            ambient_degc: self.ambient_degc,
            capacity_j_per_k: own_j_per_k.map_or_else(
                || mass.mass_kg * mass.specific_heat_j_per_kg_k,
                |own| own.capacity_j_per_k,
            ),
            held: map.is_some() && of_map.is_none() && !given,
            path_w_per_k: path_k_per_w.map_or(0.0, f64::recip),
            side_share: self.side_share,
            neighbour_w_per_k: self.neighbour_w_per_k,
            busbar_w_per_k: self.busbar_w_per_k,
        })
    }

    fn check(&self) -> Result<(), Failure> {
        let fail = |name: &str, expected: &str, found: f64| {
            let text = format!("--{name}: expected {expected}, found {found}");
            Err(Failure::Usage(text))
        };
        if !TEMPERATURES_DEGC.contains(&self.ambient_degc) {
            return fail("ambient-degc", "-60 to 120 °C", self.ambient_degc);
        }
        if let Some(met) = self
            .path_k_per_w
            .filter(|met| !(met.is_normal() && *met > 0.0))
        {
            return fail("path-k-per-w", "a number above 0 in K/W", met);
        }
        if !(0.0..=1.0).contains(&self.side_share) {
            return fail("side-share", "a number from 0 to 1", self.side_share);
        }
        for (name, met) in [
            ("neighbour-w-per-k", self.neighbour_w_per_k),
            ("busbar-w-per-k", self.busbar_w_per_k),
        ] {
            if !(met.is_finite() && met >= 0.0) {
                return fail(name, "zero or more in W/K", met);
            }
        }
        Ok(())
    }
}

/// Returns notes on temperatures that a model lacks.
pub(super) fn notes(args: &HeatArgs, thermal: &PackThermal, map: Option<&CellMap>) -> Vec<String> {
    let mut notes = Vec::new();
    match map {
        Some(_) if thermal.held => notes.push(
            "the map has no heat capacity: the cells keep the temperature of their surroundings; \
            --cell-mass-kg, --specific-heat and --path-k-per-w let them warm"
                .to_owned(),
        ),
        Some(map) if map.thermal.is_none() => notes.extend(default_note(args.mass)),
        Some(_) => (),
        None => notes.push(
            "a model of one point has one resistance at every temperature: heat does \
            not change it"
                .to_owned(),
        ),
    }
    if !thermal.held && thermal.path_w_per_k == 0.0 {
        notes.push(
            "no heat leaves the cells: give a path to the surroundings with --path-k-per-w"
                .to_owned(),
        );
    }
    notes
}

/// Returns a note on the mass and the specific heat that are not given; `None` if both are.
fn default_note(given: ThermalArgs) -> Option<String> {
    let (mass, usual) = (given.mass(), ThermalMass::P45B);
    let missing = match (given.cell_mass_kg, given.specific_heat) {
        (Some(_), Some(_)) => return None,
        (None, None) => "--cell-mass-kg and --specific-heat",
        (Some(_), None) => "--specific-heat",
        (None, Some(_)) => "--cell-mass-kg",
    };
    let (capacity, origin) = (
        mass.mass_kg * mass.specific_heat_j_per_kg_k,
        if given.is_given() { "contain" } else { "are" },
    );
    Some(format!(
        "the map has no heat capacity: {capacity:.1} J/K {origin} the default of a P45B ({:.0} g, {} \
        J/(kg·K)); give {missing}",
        1e3 * usual.mass_kg,
        usual.specific_heat_j_per_kg_k
    ))
}
