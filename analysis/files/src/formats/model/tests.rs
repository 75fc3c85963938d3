//! Compiles the C header, if a compiler is available, and compares it with the project's own
//! simulation.

use std::process::Command;

use super::*;
use analysis_forward::forward::{
    Demand, Interpolation, OcvSource, Profile, SimModel, SimOptions, simulate,
};
use analysis_model::model::RcBranch;

fn cell() -> CellModel {
    let branches = [(1.7e-3, 1.2), (3.2e-3, 760.0), (2.0e-3, 20_000.0)]
        .map(|(r_ohm, c_f)| RcBranch { r_ohm, c_f });
    let soc: Vec<f64> = (0..=10).map(|k| 0.1 * f64::from(k)).collect();
    let ocv_v: Vec<f64> = soc
        .iter()
        .map(|z| 3.0 + 1.1 * z + 0.1 * (6.0 * z).tanh())
        .collect();
    CellModel {
        name: "a \"cell\" */".to_owned(),
        erm: Erm {
            r_ohm: 6.9e-3,
            branches: branches.to_vec(),
        },
        curve: OcvCurve::monotone(4.5, soc, ocv_v).unwrap(),
        window_v: 2.5..=4.2,
        temperature_c: 25.0,
        notes: vec!["off by */ 1 %".to_owned()],
    }
}

#[test]
fn a_header_that_is_compiled_gives_what_the_simulation_gives() {
    let cell = cell();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("model.h"), cell.text(ModelFormat::CHeader)).unwrap();
    let steps = [(5.0, 10.0), (-3.0, 60.0), (0.0, 300.0), (20.0, 600.0)];
    let calls: String = steps
        .iter()
        .map(|(a, s)| format!("printf(\"%.17g\\n\", eis_step(&s, {a:?}, {s:?}));\n"))
        .collect();
    let program = format!(
        "#include <stdio.h>\n#include \"model.h\"\n\
        int main(void) {{ eis_state s; eis_rest(&s, 0.6);\n{calls}return 0; }}\n"
    );
    std::fs::write(path("main.c"), program).unwrap();
    let compiled = Command::new("cc")
        .current_dir(folder.path())
        .args([
            "-std=c99", "-Wall", "-Wextra", "-Werror", "-o", "model", "main.c", "-lm",
        ])
        .output();
    let Ok(compiled) = compiled else {
        eprintln!("no C compiler: the header was not compiled");
        return;
    };
    assert!(
        compiled.status.success(),
        "{}",
        String::from_utf8_lossy(&compiled.stderr)
    );
    let output = Command::new(path("model")).output().unwrap();
    let met: Vec<f64> = String::from_utf8_lossy(&output.stdout)
        .lines()
        .map(|line| line.parse().unwrap())
        .collect();

    let model = SimModel::cell(&cell.erm, OcvSource::Curve(cell.curve.clone())).unwrap();
    let mut rows = vec![(0.0, steps[0].0)];
    let mut at = 0.0;
    for (k, (_, s)) in steps.iter().enumerate() {
        at += s;
        rows.push((at, steps.get(k + 1).map_or(0.0, |next| next.0)));
    }
    let profile = Profile::new("steps", Demand::Current, Interpolation::Hold, &rows).unwrap();
    let trace = simulate(
        &model,
        &model.rest(0.6).unwrap(),
        &profile,
        &SimOptions {
            max_step_s: f64::INFINITY,
            ..SimOptions::default()
        },
    )
    .unwrap()
    .trace;
    let mut end_s = 0.0;
    for ((_, s), met) in steps.iter().zip(&met) {
        end_s += s;
        // A jump of the current has two rows at the same time: the first is before the jump.
        let row = trace
            .time_s
            .iter()
            .position(|time_s| (time_s - end_s).abs() < 1e-9)
            .unwrap();
        assert!(
            (trace.ccv_v[row] - met).abs() < 1e-9,
            "{end_s} s: {met}, simulated {}",
            trace.ccv_v[row]
        );
    }
    assert_eq!(met.len(), steps.len());
}

#[test]
fn the_python_modules_hold_every_number() {
    let cell = cell();
    for (format, wanted) in [
        (
            ModelFormat::PyBamm,
            [
                "\"R0 [Ohm]\": 0.0069,",
                "\"C2 [F]\": 760.0,",
                "\"Element-3 initial overpotential [V]\": 0.0,",
            ],
        ),
        (
            ModelFormat::CasAdi,
            [
                "R_OHM = 0.0069",
                "CAPACITY_C = 16200.0",
                "0.0017, 0.0032, 0.002",
            ],
        ),
    ] {
        let text = cell.text(format);
        wanted
            .iter()
            .for_each(|wanted| assert!(text.contains(wanted), "{wanted}\n{text}"));
        assert!(!text.contains('@'), "{text}");
    }
}
