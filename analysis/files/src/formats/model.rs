//! A cell's model for other programs: a C header, a PyBaMM parameter file, a CasADi function.
//!
//! All contain the same: a series resistance, RC branches, and the open-circuit voltage over the
//! state of charge as knots of a cubic Hermite curve, as evaluated by [`OcvCurve::at`]. Currents
//! are positive for discharge. The C header also takes a map over state of charge and temperature.
//! These formats cannot represent effects that a diagnosis has added to a model; such models are
//! refused.

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
    /// A Python module that builds a CasADi function of one step.
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
        charge and the temperature; the C header takes it"
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
    /// [`ModelExportError::Map`] for a map in a format other than C.
    pub fn text(&self, format: ModelFormat) -> Result<String, ModelExportError> {
        let (template, comment) = match (format, &self.map) {
            (ModelFormat::CHeader, None) => (C_HEADER.replace("@OCV@", C_OCV), " *"),
            (ModelFormat::CHeader, Some(map)) => (map::template(map, C_OCV), " *"),
            (_, Some(_)) => {
                let name = self.name.clone();
                return Err(ModelExportError::Map { name });
            }
            (ModelFormat::PyBamm, None) => (PYBAMM.to_owned(), "#"),
            (ModelFormat::CasAdi, None) => (CASADI.to_owned(), "#"),
        };
        let list = |values: &mut dyn Iterator<Item = f64>| {
            rows(
                values,
                if format == ModelFormat::CHeader {
                    "    "
                } else {
                    "        "
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

/// The open-circuit voltage of both C headers.
const C_OCV: &str = r"/* Knots of a cubic Hermite curve: state of charge, voltage, slope over the state of charge. */
static const double eis_knot_soc[EIS_KNOTS] = {
@SOC@
};
static const double eis_knot_ocv_v[EIS_KNOTS] = {
@OCV_V@
};
static const double eis_knot_slope_v[EIS_KNOTS] = {
@SLOPE_V@
};

/* Open-circuit voltage, V. */
static inline double eis_ocv_v(double soc)
{
    const int last = EIS_KNOTS - 1;
    if (soc <= eis_knot_soc[0])
        return eis_knot_ocv_v[0] + eis_knot_slope_v[0] * (soc - eis_knot_soc[0]);
    if (soc >= eis_knot_soc[last])
        return eis_knot_ocv_v[last] + eis_knot_slope_v[last] * (soc - eis_knot_soc[last]);
    int low = 0, high = last;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (eis_knot_soc[middle] <= soc)
            low = middle;
        else
            high = middle;
    }
    const double width = eis_knot_soc[high] - eis_knot_soc[low];
    const double t = (soc - eis_knot_soc[low]) / width;
    const double m0 = width * eis_knot_slope_v[low], m1 = width * eis_knot_slope_v[high];
    const double rise = eis_knot_ocv_v[high] - eis_knot_ocv_v[low];
    return eis_knot_ocv_v[low] + t * (m0 + t * (3.0 * rise - 2.0 * m0 - m1 + t * (m0 + m1 - 2.0 * rise)));
}
";

const C_HEADER: &str = concat!(
    "/* Model of a lithium-ion cell: @NAME@\n",
    " *\n",
    " * A series resistance, RC branches, and the open-circuit voltage over the state of charge. ",
    "Currents in A are positive for discharge, times in s,\n",
    " * voltages in V. eis_step() is exact for a current that is constant over the step. ",
    "No memory is allocated and no state is kept here. C99; link with -lm.\n",
    r#"@NOTES@ */
#ifndef EIS_BENCH_MODEL_H
#define EIS_BENCH_MODEL_H

#include <math.h>

#define EIS_RC @RC@
/* An array in C has at least one element. */
#define EIS_RC_SIZE (EIS_RC > 0 ? EIS_RC : 1)
#define EIS_KNOTS @KNOTS@

static const double eis_r_ohm = @R_OHM@;
static const double eis_branch_r_ohm[EIS_RC_SIZE] = {
@BRANCH_R_OHM@
};
static const double eis_branch_c_f[EIS_RC_SIZE] = {
@BRANCH_C_F@
};
static const double eis_capacity_c = @CAPACITY_C@;
static const double eis_least_v = @LOW_V@;
static const double eis_greatest_v = @HIGH_V@;
@OCV@
typedef struct {
    double soc;
    double branch_v[EIS_RC_SIZE];
} eis_state;

/* A cell at rest. */
static inline void eis_rest(eis_state *state, double soc)
{
    state->soc = soc;
    for (int k = 0; k < EIS_RC; ++k)
        state->branch_v[k] = 0.0;
}

/* Voltage at the terminals under a current, V. */
static inline double eis_terminal_v(const eis_state *state, double current_a)
{
    double v = eis_ocv_v(state->soc) - eis_r_ohm * current_a;
    for (int k = 0; k < EIS_RC; ++k)
        v -= state->branch_v[k];
    return v;
}

/* Moves the state by dt_s under a constant current; returns the voltage at the terminals at the end of the step, V. */
static inline double eis_step(eis_state *state, double current_a, double dt_s)
{
    for (int k = 0; k < EIS_RC; ++k) {
        const double decay = exp(-dt_s / (eis_branch_r_ohm[k] * eis_branch_c_f[k]));
        state->branch_v[k] = decay * state->branch_v[k] + (1.0 - decay) * eis_branch_r_ohm[k] * current_a;
    }
    state->soc -= current_a * dt_s / eis_capacity_c;
    return eis_terminal_v(state, current_a);
}

#endif
"#
);

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

const CASADI: &str = concat!(
    "# Model of a lithium-ion cell for trajectory optimisation with CasADi: @NAME@\n",
    "#\n",
    "# Currents in A are positive for discharge, times in s, voltages in V. ",
    "The state is (state of charge, voltages over the RC branches).\n",
    r#"@NOTES@import casadi

R_OHM = @R_OHM@
BRANCH_R_OHM = [
@BRANCH_R_OHM@
]
BRANCH_C_F = [
@BRANCH_C_F@
]
CAPACITY_C = @CAPACITY_C@
LEAST_V, GREATEST_V = @LOW_V@, @HIGH_V@
# Knots of a cubic Hermite curve: state of charge, voltage, slope over the state of charge.
KNOT_SOC = [
@SOC@,
]
KNOT_OCV_V = [
@OCV_V@,
]
KNOT_SLOPE_V = [
@SLOPE_V@,
]


def ocv_v(soc):
    """Open-circuit voltage, as an expression with two continuous derivatives but at the knots."""
    last = len(KNOT_SOC) - 1
    value = KNOT_OCV_V[0] + KNOT_SLOPE_V[0] * (soc - KNOT_SOC[0])
    for k in range(last):
        width = KNOT_SOC[k + 1] - KNOT_SOC[k]
        t = (soc - KNOT_SOC[k]) / width
        m0, m1 = width * KNOT_SLOPE_V[k], width * KNOT_SLOPE_V[k + 1]
        rise = KNOT_OCV_V[k + 1] - KNOT_OCV_V[k]
        piece = KNOT_OCV_V[k] + t * (m0 + t * (3 * rise - 2 * m0 - m1 + t * (m0 + m1 - 2 * rise)))
        value = casadi.if_else(soc > KNOT_SOC[k], piece, value)
    beyond = KNOT_OCV_V[last] + KNOT_SLOPE_V[last] * (soc - KNOT_SOC[last])
    return casadi.if_else(soc >= KNOT_SOC[last], beyond, value)


def rest(soc):
    """The state of a cell at rest."""
    return casadi.DM([soc] + [0.0] * len(BRANCH_R_OHM))


def step():
    """Function (state, current_a, dt_s) -> (next state, voltage at the terminals at the end): "#,
    r#"exact for a constant current over the step."""
    state = casadi.SX.sym("state", 1 + len(BRANCH_R_OHM))
    current_a, dt_s = casadi.SX.sym("current_a"), casadi.SX.sym("dt_s")
    following = [state[0] - current_a * dt_s / CAPACITY_C]
    for k, (r_ohm, c_f) in enumerate(zip(BRANCH_R_OHM, BRANCH_C_F)):
        decay = casadi.exp(-dt_s / (r_ohm * c_f))
        following.append(decay * state[1 + k] + (1 - decay) * r_ohm * current_a)
    following = casadi.vertcat(*following)
    terminal_v = ocv_v(following[0]) - R_OHM * current_a - casadi.sum1(following[1:])
    return casadi.Function("step", [state, current_a, dt_s], [following, terminal_v], "#,
    r#"["state", "current_a", "dt_s"], ["next", "terminal_v"])
"#
);

#[cfg(test)]
mod tests;
