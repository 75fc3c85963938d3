//! A cell over its operating range: resistances over state of charge (SOC) and temperature.
//!
//! Each branch keeps one time constant over the whole range; its resistance is a [`Surface`].
//! Between two SOC knots a resistance is linear in SOC. Between two temperature nodes it is the
//! mean of the values that Arrhenius' law gives from either node, weighted by the distance in 1/T:
//! it meets the nodes exactly and stays positive. Beyond the first or last SOC knot a resistance
//! keeps the value of that knot; beyond the nodes of temperature it follows Arrhenius' law. Every
//! query states how far it lies outside ([`Outside`]).
//!
//! The voltage of a branch is continuous when its resistance moves, as that of a capacitor is:
//! τ·dv/dt = R(z, T)·i − v. Where the data show that the resistance falls under current, the fast
//! branches lose their charge by Butler–Volmer's law ([`ChargeTransfer`]): b·sinh(v/b) in the place of v,
//! with the share of each branch in the voltage of charge transfer as b ([`Drive`]).

mod branch_step;
mod charge_transfer;
mod check;
mod constants;
mod error;
mod place;
mod unmeasured;
mod values;

pub use branch_step::{BranchEnd, BranchStep, Drive};
pub use charge_transfer::ChargeTransfer;
pub use check::MapError;
pub use constants::{GAS_J_PER_MOL_K, ZERO_DEGC_K};
pub use error::{BAND_SIGMAS, ErrorSource, RUN_PROBABILITY, VoltageError};
pub use place::{Outside, Place, arrhenius};
pub use unmeasured::{Instant, Unmeasured};
pub use values::MapValues;

use crate::{
    model::{Erm, RcBranch},
    ocv::OcvCurve,
};
use check::{finite, length, positive, rising, zero_or_more};
use place::Nodes;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Temperatures that a map accepts, °C: the range of lithium-ion cells, and a guard against kelvin.
pub const TEMPERATURES_DEGC: RangeInclusive<f64> = -60.0..=120.0;
/// Resistance of a branch that the fit has switched off at a point, Ω, for models that need a
/// positive one.
const LEAST_OHM: f64 = 1e-9;

/// A cell over SOC and temperature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellMap {
    /// SOC knots, rising, 0…1, at least two.
    pub soc: Vec<f64>,
    /// Temperature nodes, °C, rising, at least one.
    pub temperature_degc: Vec<f64>,
    /// Series resistance.
    pub series: Surface,
    /// Branches, by rising time constant.
    pub branches: Vec<MapBranch>,
    /// Correction of the OCV curve at each SOC knot, V.
    pub ocv_offset_v: Vec<f64>,
    /// Change of the OCV with temperature at each SOC knot, V/K, from `ocv_temperature_degc`. It
    /// also holds whatever else moves the voltage at rest between the temperatures of the fit, so
    /// that no reversible heat is computed from it.
    pub ocv_v_per_k: Vec<f64>,
    /// Temperature of the OCV curve, °C.
    pub ocv_temperature_degc: f64,
    /// Fall of the fast branches' resistance under current; without it resistances do not depend on
    /// current.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub charge_transfer: Option<ChargeTransfer>,
    /// Largest current of the logs that the map was fitted to, A; none without logs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub most_current_a: Option<f64>,
    /// Heat capacity and path to the surroundings; without them the cell stays at the temperature
    /// of the surroundings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thermal: Option<Thermal>,
    /// Error of the predicted voltage; without it the map does not state one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voltage_error: Option<VoltageError>,
}

/// A resistance over SOC and temperature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Activation energy of Arrhenius' law between and beyond the nodes, J/mol.
    pub activation_j_per_mol: f64,
    /// Resistance at each node, Ω: a row per temperature, a column per SOC.
    pub r_ohm: Vec<Vec<f64>>,
    /// Standard deviation of `r_ohm`, Ω, in the same order; empty if it is not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sigma_ohm: Vec<Vec<f64>>,
}

/// An RC branch of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapBranch {
    /// Time constant over the whole range, s.
    pub tau_s: f64,
    /// True if the branch is faster than all data, so that its resistance continues the spectra.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub extrapolated: bool,
    /// Its resistance.
    pub resistance: Surface,
}

/// The cell as one body: C·dT/dt = heat − (T − T_surroundings)/R.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Thermal {
    /// Heat capacity, J/K.
    pub capacity_j_per_k: f64,
    /// Thermal resistance to the surroundings, K/W.
    pub resistance_k_per_w: f64,
}

impl Surface {
    /// Returns the resistance between nodes, Ω, from the factors of its energy.
    #[inline]
    fn weighted_ohm(&self, nodes: &Nodes, factors: [f64; 2]) -> f64 {
        let [(low, below), (high, above)] = nodes.soc;
        let mut sum = 0.0;
        for ((j, weight), factor) in nodes.temperature.into_iter().zip(factors) {
            if weight == 0.0 {
                continue;
            }
            let row = &self.r_ohm[j];
            sum += weight * (below * row[low] + above * row[high]) * factor;
        }
        sum
    }
}

impl CellMap {
    /// Checks lengths and values.
    ///
    /// # Errors
    /// [`MapError`] for the first that is wrong.
    pub fn validate(&self) -> Result<(), MapError> {
        rising("soc", &self.soc, 2, 0.0..=1.0, "SOC from 0 to 1 that rise")?;
        let expected = "temperatures from -60 to 120 °C that rise (not kelvin)";
        rising(
            "temperature_degc",
            &self.temperature_degc,
            1,
            TEMPERATURES_DEGC,
            expected,
        )?;
        self.validate_surface("series", &self.series)?;
        let mut least_s = 0.0;
        for (k, branch) in self.branches.iter().enumerate() {
            let field = format!("branches[{k}]");
            if !(branch.tau_s.is_finite() && branch.tau_s > least_s) {
                return Err(MapError::Value {
                    field: format!("{field}.tau_s"),
                    expected: "time constants above 0 s that rise from branch to branch",
                    met: branch.tau_s,
                });
            }
            least_s = branch.tau_s;
            self.validate_surface(&format!("{field}.resistance"), &branch.resistance)?;
        }
        for (field, list) in [
            ("ocv_offset_v", &self.ocv_offset_v),
            ("ocv_v_per_k", &self.ocv_v_per_k),
        ] {
            length(field, self.soc.len(), list.len())?;
            finite(field, list)?;
        }
        finite("ocv_temperature_degc", &[self.ocv_temperature_degc])?;
        if let Some(law) = self.charge_transfer {
            positive("charge_transfer.voltage_v", law.voltage_v)?;
            positive("charge_transfer.slowest_s", law.slowest_s)?;
        }
        if let Some(most_current_a) = self.most_current_a {
            positive("most_current_a", most_current_a)?;
        }
        if let Some(thermal) = self.thermal {
            for (field, met) in [
                ("thermal.capacity_j_per_k", thermal.capacity_j_per_k),
                ("thermal.resistance_k_per_w", thermal.resistance_k_per_w),
            ] {
                positive(field, met)?;
            }
        }
        if let Some(error) = &self.voltage_error {
            let nodes = self.temperature_degc.len();
            length("voltage_error.share", nodes, error.share.len())?;
            zero_or_more("voltage_error.rest_v", &[error.rest_v])?;
            zero_or_more("voltage_error.soc", &[error.soc])?;
            zero_or_more("voltage_error.share", &error.share)?;
            if let Some(factor) = error.whole_runs {
                positive("voltage_error.whole_runs", factor)?;
            }
        }
        Ok(())
    }

    fn validate_surface(&self, name: &str, surface: &Surface) -> Result<(), MapError> {
        finite(
            &format!("{name}.activation_j_per_mol"),
            &[surface.activation_j_per_mol],
        )?;
        let rows = [("r_ohm", &surface.r_ohm), ("sigma_ohm", &surface.sigma_ohm)];
        for (list, rows) in rows {
            if list == "sigma_ohm" && rows.is_empty() {
                continue;
            }
            let field = format!("{name}.{list}");
            length(&field, self.temperature_degc.len(), rows.len())?;
            for (j, row) in rows.iter().enumerate() {
                let field = format!("{field}[{j}]");
                length(&field, self.soc.len(), row.len())?;
                let wrong = row.iter().find(|r| !(r.is_finite() && **r >= 0.0));
                if let Some(met) = wrong {
                    return Err(MapError::Value {
                        field,
                        expected: "ohms, zero or more",
                        met: *met,
                    });
                }
            }
        }
        if let Some(met) = (name == "series")
            .then(|| surface.r_ohm.iter().flatten().find(|r| **r <= 0.0))
            .flatten()
        {
            return Err(MapError::Value {
                field: format!("{name}.r_ohm"),
                expected: "ohms above zero",
                met: *met,
            });
        }
        Ok(())
    }

    /// Number of branches of charge transfer: the first ones.
    pub fn transfer_count(&self) -> usize {
        let slowest_s = self.charge_transfer.map_or(0.0, |law| law.slowest_s);
        self.branches
            .partition_point(|branch| branch.tau_s <= slowest_s)
    }

    /// Returns the whole resistance of charge transfer, Ω, from those of all branches.
    pub fn transfer_ohm(&self, branch_ohm: &[f64]) -> f64 {
        branch_ohm[..self.transfer_count()].iter().sum()
    }

    /// Finds a SOC and a temperature, °C, on the map.
    pub fn place(&self, soc: f64, temperature_degc: f64) -> Place {
        Place::find(&self.soc, &self.temperature_degc, soc, temperature_degc)
    }

    /// Returns the resistance of a surface at a place, Ω.
    pub fn resistance_ohm(&self, surface: &Surface, at: &Place) -> f64 {
        let factors = at.factors(surface.activation_j_per_mol);
        surface.weighted_ohm(&self.nodes(at), factors)
    }

    /// Returns the nodes around a place and their weights.
    fn nodes(&self, at: &Place) -> Nodes {
        Nodes {
            temperature: self.temperature_weights(at),
            soc: self.soc_weights(at),
        }
    }

    /// Returns what is added to the OCV curve at a place and a temperature, V.
    pub fn ocv_correction_v(&self, at: &Place, temperature_degc: f64) -> f64 {
        let warmer_k = temperature_degc - self.ocv_temperature_degc;
        self.soc_weights(at)
            .iter()
            .map(|(k, share)| share * (self.ocv_offset_v[*k] + warmer_k * self.ocv_v_per_k[*k]))
            .sum()
    }

    /// Returns a remark if a cell carries a larger current, A, than the logs that the map was fitted to.
    pub fn current_remark(&self, cell_a: f64) -> Option<String> {
        let most_a = self
            .most_current_a
            .filter(|most_a| cell_a.abs() > *most_a)?;
        Some(format!(
            "a cell carries up to {:.1} A, the logs of the map {most_a:.1} A: the fall of the resistance \
            beyond that is extrapolated",
            cell_a.abs()
        ))
    }

    /// Returns the weights of the temperature nodes at a place.
    pub fn temperature_weights(&self, at: &Place) -> [(usize, f64); 2] {
        at.temperature.pairs(self.temperature_degc.len())
    }

    /// Returns whether a part of the map has an error that its data do not show.
    pub fn has_unmeasured(&self) -> bool {
        self.lasting_errors() > 2
    }

    /// Number of errors of the predicted voltage that last for a run: one at rest, one of the resistances,
    /// that of the voltage of charge transfer, and that of the extrapolated branches.
    pub fn lasting_errors(&self) -> usize {
        let is_extrapolated = self.branches.iter().any(|branch| branch.extrapolated);
        2 + usize::from(self.charge_transfer.is_some()) + usize::from(is_extrapolated)
    }

    /// Returns the standard deviation of the predicted voltage of a cell, V, from the slope dOCV/dSOC,
    /// V, and the overpotential, V, at a place; `None` if the map does not state its error.
    pub fn sigma_v(&self, at: &Place, slope_v: f64, overpotential_v: f64) -> Option<f64> {
        let error = self.voltage_error.as_ref()?;
        Some(error.sigma_v(self.temperature_weights(at), slope_v, overpotential_v))
    }

    /// Returns an OCV curve with the correction at a temperature, °C; `None` if the corrected knots do not
    /// rise.
    pub fn corrected(&self, curve: &OcvCurve, temperature_degc: f64) -> Option<OcvCurve> {
        let knots = curve.soc.iter().zip(&curve.ocv_v).map(|(soc, ocv_v)| {
            let at = self.place(*soc, temperature_degc);
            ocv_v + self.ocv_correction_v(&at, temperature_degc)
        });
        OcvCurve::monotone(curve.capacity_ah, curve.soc.clone(), knots.collect()).ok()
    }

    /// Returns the weights of the nodes at a place in a surface with this activation energy, as
    /// `(temperature, SOC, weight)`: [`Self::resistance_ohm`] is their sum over the resistances.
    pub fn weights(&self, at: &Place, activation_j_per_mol: f64) -> [(usize, usize, f64); 4] {
        let (t, z) = (self.temperature_weights(at), self.soc_weights(at));
        let factor = |side: usize| t[side].1 * (activation_j_per_mol * at.exponents[side]).exp();
        let (cold, warm) = (factor(0), factor(1));
        [
            (t[0].0, z[0].0, cold * z[0].1),
            (t[0].0, z[1].0, cold * z[1].1),
            (t[1].0, z[0].0, warm * z[0].1),
            (t[1].0, z[1].0, warm * z[1].1),
        ]
    }

    /// Returns the weights of the SOC knots at a place.
    pub fn soc_weights(&self, at: &Place) -> [(usize, f64); 2] {
        at.soc.pairs(self.soc.len())
    }

    /// Returns the model at one SOC and temperature, for tasks that know one point only. A branch
    /// without resistance there keeps 1 nΩ.
    pub fn model_at(&self, soc: f64, temperature_degc: f64) -> Erm {
        let at = self.place(soc, temperature_degc);
        let branches = self.branches.iter().map(|branch| {
            let r_ohm = self.resistance_ohm(&branch.resistance, &at).max(LEAST_OHM);
            RcBranch {
                r_ohm,
                c_f: branch.tau_s / r_ohm,
            }
        });
        Erm {
            r_ohm: self.resistance_ohm(&self.series, &at),
            branches: branches.collect(),
        }
    }
}

#[cfg(test)]
mod tests;
