//! A cell's model for other programs: a C header, a PyBaMM parameter file, a CasADi function.
//!
//! All contain the same: a series resistance, RC branches, and the open-circuit voltage over the
//! state of charge as knots of a cubic Hermite curve, as evaluated by [`OcvCurve::at`]. Currents
//! are positive for discharge. The C header and the CasADi module also take a power, with the
//! tangent beyond P₀, and a map over state of charge and temperature. These formats cannot represent
//! effects that a diagnosis has added to a model; such models are refused.

mod map;
mod text;

use std::fmt::Write as _;
use std::ops::RangeInclusive;

use text::{harmless, rows};

use analysis_fit::given::GivenModel;
use analysis_model::{
    map::CellMap,
    model::{Erm, RcBranch},
    ocv::OcvCurve,
};

/// Points of the curve for a program that interpolates linearly.
const DENSE: u32 = 400;
/// Voltage below which the law of power takes a higher one, as a share of the greatest open-circuit
/// voltage.
const FLOOR_SHARE: f64 = 0.125;
/// The same at least, V.
const LEAST_FLOOR_V: f64 = 0.1;
/// Kelvin at 0 °C.
const KELVIN: f64 = 273.15;

/// Formats that a model can be written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ModelFormat {
    /// C99, without memory management.
    CHeader,
    /// A Python module whose `get_parameter_values` PyBaMM's `equivalent_circuit.Thevenin` takes.
    PyBamm,
    /// A Python module that builds CasADi functions of one step.
    CasAdi,
}

/// A cell with all inputs of a simulation.
#[derive(Debug, Clone, PartialEq)]
pub struct CellModel {
    name: String,
    erm: Erm,
    /// Resistances over state of charge and temperature, of which `erm` is one point.
    map: Option<CellMap>,
    curve: OcvCurve,
    /// Least and greatest voltage, V.
    window_v: RangeInclusive<f64>,
    temperature_degc: f64,
    /// Limits of the model that the file states, in sentences.
    notes: Vec<String>,
}

/// Reason why a model cannot be written for another program.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelExportError {
    /// Additions.
    #[error(
        "model {name}: expected one without additions, met {additions}: these formats hold \
        resistances, capacitances and an open-circuit voltage only"
    )]
    Additions {
        /// The model.
        name: String,
        /// Their titles.
        additions: String,
    },
    /// A map.
    #[error(
        "model {name}: expected a model of one point for this format, met a map over the state of \
        charge and the temperature; C and CasADi take it"
    )]
    Map {
        /// The model.
        name: String,
    },
    /// No open-circuit voltage.
    #[error(
        "model {name}: expected an open-circuit voltage over the state of charge, met none: give a \
        curve, or a voltage and a capacity"
    )]
    NoOcv {
        /// The model.
        name: String,
    },
}

impl CellModel {
    /// A model with its open-circuit voltage. `window_v`: the cell's limits; `temperature_degc`: where
    /// it was measured.
    ///
    /// # Errors
    /// [`ModelExportError`].
    pub fn new(
        file: &GivenModel,
        window_v: RangeInclusive<f64>,
        temperature_degc: f64,
    ) -> Result<Self, ModelExportError> {
        let name = file.name.clone();
        if !file.additions.is_empty() {
            let additions = file
                .additions
                .iter()
                .map(|addition| addition.title.as_str())
                .collect::<Vec<_>>()
                .join("; ");
            return Err(ModelExportError::Additions { name, additions });
        }
        // Beyond its nodes a map is extrapolated, and the header does not say so at run time.
        let warnings = file.map.iter().flat_map(|map| {
            let (soc, degc) = (&map.soc, &map.temperature_degc);
            let range = format!(
                "measured from {:.2} to {:.2} of charge and {:.1} to {:.1} degrees Celsius",
                soc[0],
                soc[soc.len() - 1],
                degc[0],
                degc[degc.len() - 1]
            );
            std::iter::once(range).chain(file.warnings.iter().cloned())
        });
        let curve = file
            .ocv
            .clone()
            .ok_or(ModelExportError::NoOcv { name: name.clone() })?;
        Ok(Self {
            name,
            erm: file.erm.clone(),
            map: file.map.clone(),
            curve,
            window_v,
            temperature_degc,
            notes: file.notes().into_iter().chain(warnings).collect(),
        })
    }

    /// Adds sentences to the notes at the head of the file.
    #[must_use]
    pub fn with_notes(mut self, notes: impl IntoIterator<Item = String>) -> Self {
        self.notes.extend(notes);
        self
    }

    /// Returns the text of the file.
    ///
    /// # Errors
    /// [`ModelExportError::Map`] for a map for PyBaMM.
    pub fn text(&self, format: ModelFormat) -> Result<String, ModelExportError> {
        let template = self.template(format)?;
        let comment = match format {
            ModelFormat::CHeader => " *",
            ModelFormat::PyBamm | ModelFormat::CasAdi => "#",
        };
        let list = |values: &mut dyn Iterator<Item = f64>| {
            rows(
                values,
                if format == ModelFormat::PyBamm {
                    "        "
                } else {
                    "    "
                },
            )
        };
        let erm = &self.erm;
        // Without branches, the array of the C header still has one element, which no loop reads;
        // Python's list is empty.
        let none = if format == ModelFormat::CHeader {
            "    0.0"
        } else {
            ""
        };
        let branches = |of: &dyn Fn(&RcBranch) -> f64| match erm.branches.is_empty() {
            true => none.to_owned(),
            false => {
                list(&mut erm.branches.iter().map(of))
                    + if format == ModelFormat::CHeader {
                        ""
                    } else {
                        ","
                    }
            }
        };
        let mut dense = (0..=DENSE).map(|k| f64::from(k) / f64::from(DENSE));
        let pairs = [
            ("@NAME@", harmless(&self.name)),
            (
                "@NOTES@",
                self.notes
                    .iter()
                    .map(|note| format!("{comment} note: {}\n", harmless(note)))
                    .collect(),
            ),
            ("@RC@", erm.branches.len().to_string()),
            ("@R_OHM@", format!("{:?}", erm.r_ohm)),
            ("@BRANCH_R_OHM@", branches(&|branch| branch.r_ohm)),
            ("@BRANCH_C_F@", branches(&|branch| branch.c_f)),
            (
                "@CAPACITY_C@",
                format!("{:?}", 3600.0 * self.curve.capacity_ah),
            ),
            ("@CAPACITY_AH@", format!("{:?}", self.curve.capacity_ah)),
            ("@KNOTS@", self.curve.soc.len().to_string()),
            ("@SOC@", list(&mut self.curve.soc.iter().copied())),
            ("@OCV_V@", list(&mut self.curve.ocv_v.iter().copied())),
            ("@SLOPE_V@", list(&mut self.curve.slope_v.iter().copied())),
            (
                "@DENSE_OCV_V@",
                list(&mut dense.by_ref().map(|soc| self.curve.voltage_v(soc))),
            ),
            ("@DENSE@", DENSE.to_string()),
            ("@LOW_V@", format!("{:?}", self.window_v.start())),
            ("@HIGH_V@", format!("{:?}", self.window_v.end())),
            ("@FLOOR_V@", format!("{:?}", self.floor_v())),
            ("@AMBIENT_DEGC@", format!("{:?}", self.temperature_degc)),
            (
                "@TEMPERATURE_K@",
                format!("{:?}", self.temperature_degc + KELVIN),
            ),
            ("@ELEMENTS@", self.pybamm_elements()),
        ];
        let text = pairs
            .iter()
            .fold(template, |text, (mark, value)| text.replace(mark, value));
        Ok(text)
    }

    /// Returns the text with marks, those of the parts of the file and of the map filled.
    fn template(&self, format: ModelFormat) -> Result<String, ModelExportError> {
        let parts = match (format, &self.map) {
            (ModelFormat::PyBamm, None) => return Ok(PYBAMM.to_owned()),
            (ModelFormat::PyBamm, Some(_)) => {
                let name = self.name.clone();
                return Err(ModelExportError::Map { name });
            }
            (ModelFormat::CHeader, map) => c_parts(map.as_ref()),
            (ModelFormat::CasAdi, map) => casadi_parts(map.as_ref()),
        };
        let fill = |text: String, (mark, value): &(&str, String)| text.replace(mark, value);
        Ok(parts.iter().fold("@WHOLE@".to_owned(), fill))
    }

    /// Returns the voltage below which the law of power takes a higher one, V: far below those of
    /// the cell.
    fn floor_v(&self) -> f64 {
        let greatest_v = self.curve.ocv_v.last().copied().unwrap_or_default();
        (greatest_v * FLOOR_SHARE).max(LEAST_FLOOR_V)
    }

    fn pybamm_elements(&self) -> String {
        let mut text = String::new();
        for (number, branch) in (1..).zip(&self.erm.branches) {
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "        \"R{number} [Ohm]\": {:?},\n        \"C{number} [F]\": {:?},",
                branch.r_ohm, branch.c_f
            );
            let _ = writeln!(
                text,
                "        \"Element-{number} initial overpotential [V]\": 0.0,"
            );
        }
        text
    }
}

/// Parts of a C header and their marks, in the order in which they are filled.
fn c_parts(map: Option<&CellMap>) -> Vec<(&'static str, String)> {
    let (whole, ambient, given_ambient) = match map {
        None => (C_CELL.to_owned(), "", ""),
        Some(map) => {
            let whole = map::fill(map::HEADER, map, "    0.0");
            (whole, "double ambient_degc, ", "ambient_degc, ")
        }
    };
    vec![
        ("@WHOLE@", whole),
        ("@OCV@", C_OCV.to_owned()),
        ("@LAW@", C_LAW.to_owned()),
        ("@STEP@", C_STEP.to_owned()),
        ("@AMBIENT@", ambient.to_owned()),
        ("@GIVEN_AMBIENT@", given_ambient.to_owned()),
    ]
}

/// Parts of a CasADi module and their marks, in the order in which they are filled.
fn casadi_parts(map: Option<&CellMap>) -> Vec<(&'static str, String)> {
    let (cell, state, input, accuracy) = match map {
        None => (
            CASADI_CELL.to_owned(),
            "The state is (state of charge, voltages over the RC branches).",
            "",
            "exact",
        ),
        Some(map) => (
            map::fill(map::CASADI, map, ""),
            "The state is (state of charge, temperature in degrees Celsius, voltages over the RC \
                branches).",
            ", ambient_degc",
            "of second order in the step",
        ),
    };
    vec![
        ("@WHOLE@", CASADI.to_owned()),
        ("@CELL@", cell),
        ("@STATE@", state.to_owned()),
        ("@INPUT@", input.to_owned()),
        ("@ACCURACY@", accuracy.to_owned()),
    ]
}

const C_CELL: &str = include_str!("model/cell.h.in");
/// The open-circuit voltage of both C headers.
const C_OCV: &str = include_str!("model/ocv.h.in");
/// The law of power of both.
const C_LAW: &str = include_str!("model/law.h.in");
/// The steps of both.
const C_STEP: &str = include_str!("model/step.h.in");
/// What the CasADi modules of a point and of a map share.
const CASADI: &str = include_str!("model/casadi.py.in");
const CASADI_CELL: &str = include_str!("model/casadi_cell.py.in");

const PYBAMM: &str = r#"# Parameters of a lithium-ion cell for PyBaMM: @NAME@
#
#   model = pybamm.equivalent_circuit.Thevenin(options={"number of rc elements": @RC@})
#   values = pybamm.ParameterValues(get_parameter_values())
#
# Isothermal: the thermal parameters keep the cell where it is.
@NOTES@import pybamm

SOC = [k / @DENSE@ for k in range(@DENSE@ + 1)]
OCV_V = [
@DENSE_OCV_V@,
]


def open_circuit_voltage(soc):
    import numpy

    return pybamm.Interpolant(numpy.array(SOC), numpy.array(OCV_V), soc, "open-circuit voltage", interpolator="linear")


def get_parameter_values():
    return {
        "chemistry": "ecm",
        "Initial SoC": 0.5,
        "Initial temperature [K]": @TEMPERATURE_K@,
        "Cell capacity [A.h]": @CAPACITY_AH@,
        "Nominal cell capacity [A.h]": @CAPACITY_AH@,
        "Ambient temperature [K]": @TEMPERATURE_K@,
        "Current function [A]": @CAPACITY_AH@,
        "Upper voltage cut-off [V]": @HIGH_V@,
        "Lower voltage cut-off [V]": @LOW_V@,
        "Cell thermal mass [J/K]": 1.0e9,
        "Cell-jig heat transfer coefficient [W/K]": 10.0,
        "Jig thermal mass [J/K]": 1.0e9,
        "Jig-air heat transfer coefficient [W/K]": 10.0,
        "Open-circuit voltage [V]": open_circuit_voltage,
        "R0 [Ohm]": @R_OHM@,
@ELEMENTS@        "Entropic change [V/K]": 0.0,
        "RCR lookup limit [A]": 340,
    }
"#;

#[cfg(test)]
mod tests;
