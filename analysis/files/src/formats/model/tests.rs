//! Compiles the C header, if a compiler is available, and compares it with the project's own
//! simulation.

mod additions;
mod discharge;
mod power;
mod texts;

use std::io::Write as _;
use std::process::{Command, Stdio};

use super::*;
use analysis_forward::forward::{
    Demand, Interpolation, OcvSource, Profile, SimModel, SimOptions, simulate,
};
use analysis_model::{
    map::{CellMap, ChargeTransfer, ErrorSource, MapBranch, Surface, Thermal, VoltageError},
    model::{Erm, RcBranch},
    ocv::OcvCurve,
    pack::Pack,
};

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
        map: None,
        added: None,
        curve: OcvCurve::monotone(4.5, soc, ocv_v).unwrap(),
        window_v: 2.5..=4.2,
        temperature_degc: 25.0,
        notes: vec!["off by */ 1 %".to_owned()],
    }
}

/// A program with the header of a cell.
struct Program {
    folder: tempfile::TempDir,
}

impl Program {
    /// Compiles it; returns `None` without a compiler.
    fn build(cell: &CellModel, flags: &[&str], code: &str) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("model.h"), cell.text(ModelFormat::CHeader).unwrap()).unwrap();
        let code = format!("#include <stdio.h>\n#include \"model.h\"\n{code}");
        std::fs::write(path("main.c"), code).unwrap();
        let compiled = Command::new("cc")
            .current_dir(folder.path())
            .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1"])
            .args(flags)
            .args(["-o", "model", "main.c", "-lm"])
            .output();
        let Ok(compiled) = compiled else {
            eprintln!("no C compiler: the header was not compiled");
            return None;
        };
        let message = String::from_utf8_lossy(&compiled.stderr);
        assert!(compiled.status.success(), "{message}");
        Some(Self { folder })
    }

    /// Runs it on an input.
    fn run(&self, input: Vec<u8>) -> Vec<u8> {
        let mut child = Command::new(self.folder.path().join("model"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stdin = child.stdin.take().unwrap();
        let writer = std::thread::spawn(move || stdin.write_all(&input));
        let output = child.wait_with_output().unwrap();
        writer.join().unwrap().unwrap();
        assert!(output.status.success(), "{:?}", output.status);
        output.stdout
    }
}

/// Runs a program on a text; returns the numbers of each line, or `None` without a compiler.
fn run(cell: &CellModel, flags: &[&str], code: &str, input: &str) -> Option<Vec<Vec<f64>>> {
    let output = Program::build(cell, flags, code)?.run(input.as_bytes().to_vec());
    let text = String::from_utf8(output).unwrap();
    let row = |line: &str| line.split(' ').map(|word| word.parse().unwrap()).collect();
    Some(text.lines().map(row).collect())
}

#[test]
fn a_header_that_is_compiled_gives_what_the_simulation_gives() {
    let cell = cell();
    let steps = [(5.0, 10.0), (-3.0, 60.0), (0.0, 300.0), (20.0, 600.0)];
    let calls: String = steps
        .iter()
        .map(|(a, s)| format!("printf(\"%.17g\\n\", eis_step(&s, {a:?}, {s:?}));\n"))
        .collect();
    let program =
        format!("int main(void) {{ eis_state s; eis_rest(&s, 0.6);\n{calls}return 0; }}\n");
    let Some(met) = run(&cell, &[], &program, "") else {
        return;
    };
    let met: Vec<f64> = met.iter().map(|row| row[0]).collect();

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
                "    0.0069, 0.0069, 0.0017, 0.0017, 0.0032, 0.0032,",
                "\"R0 [Ohm]\": resistance(0),",
                "CAPACITY_AH = 4.5\n",
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
        let text = cell.text(format).unwrap();
        assert!(!mapped().text(format).unwrap().contains('@'));
        wanted
            .iter()
            .for_each(|wanted| assert!(text.contains(wanted), "{wanted}\n{text}"));
        assert!(!text.contains('@'), "{text}");
    }
}

/// A map whose resistances change by a factor of four, with heat and a branch that current bends.
fn mapped() -> CellModel {
    let surface = |r_ohm: f64| Surface {
        activation_j_per_mol: 25e3,
        r_ohm: [2.0, 1.0]
            .map(|cold| [2.0, 1.0, 1.2].map(|z| r_ohm * cold * z).to_vec())
            .to_vec(),
        sigma_ohm: Vec::new(),
    };
    let branch = |r_ohm, tau_s| MapBranch {
        extrapolated: false,
        tau_s,
        resistance: surface(r_ohm),
    };
    CellModel {
        map: Some(CellMap {
            soc: vec![0.1, 0.5, 1.0],
            temperature_degc: vec![0.0, 25.0],
            series: surface(7e-3),
            branches: vec![branch(3e-3, 2.0), branch(6e-3, 60.0)],
            ocv_offset_v: vec![0.002, 0.0, -0.003],
            ocv_v_per_k: vec![1e-4, 0.0, -1e-4],
            ocv_temperature_degc: 25.0,
            most_current_a: None,
            charge_transfer: Some(ChargeTransfer {
                voltage_v: 0.06,
                slowest_s: 5.0,
            }),
            thermal: Some(Thermal {
                capacity_j_per_k: 60.0,
                resistance_k_per_w: 6.0,
            }),
            voltage_error: Some(VoltageError {
                rest_v: 0.008,
                soc: 0.004,
                share: vec![0.1, 0.05],
                from: ErrorSource::LeftOut,
                whole_runs: None,
            }),
        }),
        ..cell()
    }
}

#[test]
fn a_header_of_a_map_gives_what_the_simulation_gives_over_a_whole_discharge() {
    let cell = mapped();
    let program = "int main(void) { eis_state s; eis_rest(&s, 0.98, 2.0);\n\
        for (int k = 0; k < 16000; ++k) { double i = k / 400 % 2 ? 1.0 : 9.0;\n\
        double v = eis_step(&s, i, 2.0, 0.1);\n\
        if (k % 400 == 399) printf(\"%.17g %.17g\\n\", v, s.temperature_degc); }\n\
        double low, high; eis_margins_v(&s, 1.0, &low, &high);\n\
        double i = eis_current_a(&s, 20.0, 0.95);\n\
        printf(\"%.17g %.17g\\n\", low + high, eis_terminal_v(&s, i) * i);\n\
        i = eis_current_a(&s, 2000.0, 0.95); printf(\"%d 0\\n\", i > 0.0);\n\
        return 0; }\n";
    let Some(met) = run(&cell, &["-fsanitize=undefined"], program, "") else {
        return;
    };
    let one = Pack::new(1, 1, 0.0).unwrap();
    let map = cell.map.clone().unwrap();
    let model = SimModel::mapped(map, cell.curve, one, 2.0).unwrap();
    let demand = |k: u32| {
        (
            f64::from(k) * 40.0,
            if k.is_multiple_of(2) { 9.0 } else { 1.0 },
        )
    };
    let rows: Vec<(f64, f64)> = (0..=40).map(demand).collect();
    let profile = Profile::new("steps", Demand::Current, Interpolation::Hold, &rows).unwrap();
    let options = SimOptions::default();
    let run = simulate(&model, &model.rest(0.98).unwrap(), &profile, &options).unwrap();
    let trace = &run.trace;
    for (k, row) in met.iter().take(40).enumerate() {
        let end_s = 40.0 * (k + 1) as f64;
        let place = trace
            .time_s
            .iter()
            .position(|t| (t - end_s).abs() < 1e-9)
            .unwrap();
        let apart_v = (trace.ccv_v[place] - row[0]).abs();
        assert!(
            apart_v < 1e-5,
            "{end_s} s: {row:?}, simulated {}",
            trace.ccv_v[place]
        );
    }
    assert!(
        (run.end.temperature_degc.unwrap() - met[39][1]).abs() < 1e-3,
        "{:?}",
        met[39]
    );
    assert!(met[39][1] > 5.0 && trace.soc.last().unwrap() < &0.55);
    assert!((met[40][0] - 1.7).abs() < 1e-12 && (met[40][1] - 20.0).abs() < 1e-9);
    assert_eq!(met[41][0], 1.0);
}
