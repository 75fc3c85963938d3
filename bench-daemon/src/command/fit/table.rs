//! `eis-bench fit --table`: one row for each spectrum.

use std::path::Path;

use analysis::{
    fit::{CircuitOptions, ErmRequest, Objective, Slope},
    model::Circuit,
    rows::{CircuitRows, ErmRows, ResultRows},
};

use super::FitArgs;
use crate::command::batch::{Batch, Choice, work_on_spectra};
use bench_core::safety::failure::Failure;

/// Fits the extended Randles model to each spectrum.
pub(super) fn erm(
    args: &FitArgs,
    table: &Path,
    orders: Option<&[usize]>,
    objective: Objective,
    slope: Slope,
) -> Result<(), Failure> {
    let rc = match orders {
        None => None,
        Some([rc]) => Some(*rc),
        Some(_) => {
            return Err(Failure::Usage(format!(
                "--rc: expected one number or `auto` with --table, found {:?}",
                args.rc
            )));
        }
    };
    let request = ErmRequest {
        rc,
        objective,
        slope,
        seed: args.seed,
        starts: args.more.starts.unwrap_or(0),
    };
    let call = format!("fit {request:?}");
    rows(args, table, &call, &ErmRows { request })
}

/// Fits a circuit to each spectrum.
pub(super) fn circuit(
    args: &FitArgs,
    table: &Path,
    circuit: Circuit,
    options: CircuitOptions,
    slope: Slope,
) -> Result<(), Failure> {
    let call = format!("fit {circuit} {options:?} {slope:?}");
    let kind = CircuitRows {
        circuit,
        options,
        slope,
    };
    rows(args, table, &call, &kind)
}

fn rows(args: &FitArgs, table: &Path, call: &str, kind: &impl ResultRows) -> Result<(), Failure> {
    let refused = [
        ("--pool", args.pool),
        ("--json", args.json),
        ("--profile", args.more.profile),
        ("--seeds", args.more.seeds.is_some()),
    ];
    if let Some((name, _)) = refused.iter().find(|(_, given)| *given) {
        return Err(Failure::Usage(format!(
            "{name}: expected no --table beside it: a table has one row for each spectrum"
        )));
    }
    let choice = Choice {
        from_hz: args.from_hz,
        to_hz: args.to_hz,
        refused_points: args.refused_points,
        cells_only: true,
        run_slopes: args.circuit.circuit.is_none()
            && args.slope.ocv.is_none()
            && args.slope.ocv_slope.is_none(),
    };
    let batch = Batch {
        files: &args.files,
        choice,
        table,
        call: format!("{call} {choice:?}"),
        pictures: args.many.pictures(args.out.as_deref())?,
    };
    work_on_spectra(batch, kind)
}
