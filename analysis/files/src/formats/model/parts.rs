//! The templates of each language: the file, the parts that kinds of models share, and the law.

use super::error::ModelFormat;
use super::text::{Mark, Style, number};
use analysis_model::map::CellMap;

// C: a file and a law for each kind of model, the rest for all.
const C_POINT: &str = include_str!("cell.h.in");
const C_MAP: &str = include_str!("map.h.in");
const C_POINT_LAW: &str = include_str!("point.h.in");
const C_ADDED_LAW: &str = include_str!("added.h.in");
const C_OCV: &str = include_str!("ocv.h.in");
const C_SOURCE: &str = include_str!("source.h.in");
const C_POWER_LAW: &str = include_str!("law.h.in");
const C_STEP: &str = include_str!("step.h.in");
// Python: a file for each program, the law of power and of a map for both.
const CASADI: &str = include_str!("casadi.py.in");
const CASADI_POINT: &str = include_str!("casadi_cell.py.in");
const CASADI_ADDED: &str = include_str!("casadi_added.py.in");
const CASADI_MAP: &str = include_str!("casadi_map.py.in");
const PYBAMM: &str = include_str!("pybamm.py.in");
const PYTHON_MAP_LAW: &str = include_str!("map_law.py.in");
const PYTHON_POWER_LAW: &str = include_str!("power_law.py.in");
const SIMSCAPE: &str = include_str!("simscape.m.in");
const MODELICA: &str = include_str!("modelica.mo.in");

/// Returns how a format writes lists and comments.
pub(super) fn style(format: ModelFormat) -> Style {
    let (comment, going_on, none) = match format {
        // Without branches, the array of the C header still has one element, which no loop reads.
        ModelFormat::CHeader => (" *", ",\n", "    0.0"),
        ModelFormat::PyBamm | ModelFormat::CasAdi => ("#", ",\n", ""),
        ModelFormat::Simscape => ("%", ", ...\n", ""),
        ModelFormat::Modelica => ("  //", ",\n", ""),
    };
    Style {
        comment,
        going_on,
        none,
    }
}

/// Returns the parts of a file and their marks, in the order in which they are filled.
pub(super) fn of(format: ModelFormat, map: bool, added: bool) -> Vec<Mark> {
    let text = |part: &str| part.trim_end().to_owned();
    match format {
        ModelFormat::CHeader => c(map, added),
        ModelFormat::CasAdi => casadi(map, added),
        ModelFormat::PyBamm => vec![
            ("@WHOLE@", PYBAMM.to_owned()),
            ("@MAP_LAW@", text(PYTHON_MAP_LAW)),
            ("@POWER_LAW@", text(PYTHON_POWER_LAW)),
        ],
        ModelFormat::Simscape => vec![("@WHOLE@", SIMSCAPE.to_owned())],
        ModelFormat::Modelica => vec![("@WHOLE@", MODELICA.to_owned())],
    }
}

fn c(map: bool, added: bool) -> Vec<Mark> {
    let (whole, law, accuracy) = match (map, added) {
        (true, _) => (C_MAP, "", ""),
        (false, true) => (
            C_POINT,
            C_ADDED_LAW,
            "eis_step() and\n * eis_power_step() are of second order in the step.",
        ),
        (false, false) => (
            C_POINT,
            C_POINT_LAW,
            "eis_step() is exact for a current that is constant\n * over the step, \
            eis_power_step() is of second order.",
        ),
    };
    let (ambient, given) = match map {
        true => ("double ambient_degc, ", "ambient_degc, "),
        false => ("", ""),
    };
    vec![
        ("@WHOLE@", whole.to_owned()),
        ("@CELL@", law.to_owned()),
        ("@ACCURACY@", accuracy.to_owned()),
        ("@OCV@", C_OCV.to_owned()),
        ("@SOURCE@", C_SOURCE.trim_end().to_owned()),
        ("@LAW@", C_POWER_LAW.to_owned()),
        ("@STEP@", C_STEP.to_owned()),
        ("@AMBIENT@", ambient.to_owned()),
        ("@GIVEN_AMBIENT@", given.to_owned()),
    ]
}

fn casadi(map: bool, added: bool) -> Vec<Mark> {
    let second = "of second order in the step";
    let (cell, state, input, accuracy) = match (map, added) {
        (true, _) => (
            CASADI_MAP,
            "The state is (state of charge, temperature in degrees Celsius, voltages over the RC \
                branches).",
            ", ambient_degc",
            second,
        ),
        (false, true) => (
            CASADI_ADDED,
            "The state is (state of charge, voltages over the RC branches, additions).",
            "",
            second,
        ),
        (false, false) => (
            CASADI_POINT,
            "The state is (state of charge, voltages over the RC branches).",
            "",
            "exact",
        ),
    };
    vec![
        ("@WHOLE@", CASADI.to_owned()),
        ("@CELL@", cell.to_owned()),
        ("@MAP_LAW@", PYTHON_MAP_LAW.trim_end().to_owned()),
        ("@POWER_LAW@", PYTHON_POWER_LAW.trim_end().to_owned()),
        ("@STATE@", state.to_owned()),
        ("@INPUT@", input.to_owned()),
        ("@ACCURACY@", accuracy.to_owned()),
    ]
}

/// Returns the parts that repeat for each branch.
pub(super) fn branches(format: ModelFormat, map: &CellMap) -> Vec<Mark> {
    let branches = &map.branches;
    let each = |text: &dyn Fn(usize, f64) -> String| -> String {
        let numbered = (1..).zip(branches);
        numbered.map(|(k, branch)| text(k, branch.tau_s)).collect()
    };
    match format {
        ModelFormat::Simscape => {
            let tables = each(&|k, tau_s| {
                let (surface, tau_s) = (k + 1, number(tau_s));
                format!(
                    "R{k}_mat = R_mat(:, :, {surface});\ntau{k}_mat = {tau_s} * \
                    ones(size(R0_mat));\n"
                )
            });
            vec![("@SIMSCAPE_BRANCHES@", tables)]
        }
        ModelFormat::Modelica => {
            let heat = each(&|k, _| {
                format!("\n      + lost_w(twice_a, {k}, branch_v[{k}], branch_ohm[{k}])")
            });
            let sum = each(&|k, _| format!(" + branch_v[{k}]"));
            let whole: Vec<String> = (1..=map.transfer_count())
                .map(|k| format!("branch_ohm[{k}]"))
                .collect();
            let whole = match whole.is_empty() {
                true => "0.0".to_owned(),
                false => whole.join(" + "),
            };
            let taus = style(format).list(branches.iter().map(|branch| branch.tau_s));
            let (sum, taus) = match branches.is_empty() {
                true => ("0.0".to_owned(), "fill(0.0, 0)".to_owned()),
                false => (format!("({})", &sum[3..]), format!("{{{taus}}}")),
            };
            vec![
                ("@MODELICA_HEAT@", heat),
                ("@MODELICA_SUM_V@", sum),
                ("@MODELICA_WHOLE_OHM@", whole),
                ("@MODELICA_TAU@", taus),
            ]
        }
        _ => Vec::new(),
    }
}
