//! Models as files of other programs.

use std::path::{Path, PathBuf};

use super::place::{free, write_bytes};
use crate::command::units;
use analysis::{
    formats::model::{CellModel, Fmu, ModelFormat},
    given::GivenModel,
    ocv::OcvCurve,
};
use clap::Args;

use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use bench_plan::config::quantity::{Charge, Temperature, Voltage};
use bench_plan::support::terminal::{remark, say};

/// Half the slope of a curve that stands for a constant voltage, V: knots must rise.
const FLAT_V: f64 = 1.0e-9;

/// The note of a model that is written with a constant open-circuit voltage, V.
fn note_constant_ocv(ocv_v: f64) -> String {
    format!(
        "the open-circuit voltage is {ocv_v:.3} V at every state of charge (--ocv-v): the voltage \
        does not fall as the cell empties, and energy and limits hold near this charge only; --ocv \
        takes a curve"
    )
}

/// Numbers of a cell.
#[derive(Debug, Args)]
pub struct CellArgs {
    /// For a model: its open-circuit voltage from `ocv --out` or a cell file.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["ocv_v", "capacity_ah"])]
    pub ocv: Option<PathBuf>,
    /// For a model: a constant open-circuit voltage, V.
    #[arg(long, value_name = "V", requires = "capacity_ah", value_parser = units::of::<Voltage>)]
    pub ocv_v: Option<f64>,
    /// For a model: its capacity, Ah.
    #[arg(long, value_name = "AH", requires = "ocv_v", value_parser = units::of::<Charge>)]
    pub capacity_ah: Option<f64>,
    /// For a model: lowest voltage of the cell, V.
    #[arg(long, value_name = "V", default_value_t = 2.5, value_parser = units::of::<Voltage>)]
    pub low_v: f64,
    /// For a model: highest voltage of the cell, V.
    #[arg(long, value_name = "V", default_value_t = 4.2, value_parser = units::of::<Voltage>)]
    pub high_v: f64,
    /// For a model: temperature at which it was measured, °C.
    #[arg(long = "temperature-c", value_name = "C", default_value_t = 25.0, value_parser = units::of::<Temperature>)]
    pub temperature_degc: f64,
}

/// Kind of file in which a model is written.
#[derive(Clone, Copy)]
pub(super) enum Goal {
    /// The project's JSON.
    Json,
    /// One text.
    Text(ModelFormat),
    /// An FMU.
    Fmu,
}

impl Goal {
    /// Returns the end of the file's name.
    fn ending(self) -> &'static str {
        match self {
            Self::Json => "_model.json",
            Self::Fmu => ".fmu",
            Self::Text(ModelFormat::PyBamm) => "_pybamm.py",
            Self::Text(ModelFormat::CasAdi) => "_casadi.py",
            Self::Text(ModelFormat::Simscape) => "_simscape.m",
            Self::Text(ModelFormat::Modelica) => ".mo",
            Self::Text(_) => ".h",
        }
    }
}

/// A model that was read.
pub(super) struct Given {
    pub(super) model: GivenModel,
    /// Its file or option, for errors.
    pub(super) named: String,
    /// Name of the file that is written, without its end.
    pub(super) stem: String,
}

/// Writes a model.
///
/// # Errors
/// As [`super::convert`].
pub(super) fn write(args: &CellArgs, out: &Path, given: Given, goal: Goal) -> Result<(), Failure> {
    let Given { model, named, stem } = given;
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(format!("{named}: {error}"));
    let curve = match (&args.ocv, args.ocv_v, args.capacity_ah) {
        (Some(path), ..) => Some(files::read_curve(path)?),
        (None, Some(ocv_v), Some(capacity_ah)) => Some(
            OcvCurve::monotone(
                capacity_ah,
                vec![0.0, 1.0],
                vec![ocv_v - FLAT_V, ocv_v + FLAT_V],
            )
            .map_err(|error| usage(&error))?,
        ),
        _ => None,
    };
    let read = model.with_ocv(curve);
    let constant = args.ocv_v.map(note_constant_ocv);
    let bytes = match (goal, &constant) {
        (Goal::Json, None) => read.to_json().map_err(|error| usage(&error))?.into_bytes(),
        (Goal::Json, Some(_)) => {
            let expected = "--ocv-v: expected a curve (--ocv) for --to model, which holds one";
            return Err(Failure::Usage(expected.to_owned()));
        }
        (Goal::Text(_) | Goal::Fmu, _) => {
            let window_v = args.low_v..=args.high_v;
            let cell = CellModel::new(&read, window_v, args.temperature_degc)
                .map_err(|error| usage(&error))?
                .with_notes(constant.clone());
            let written = match goal {
                Goal::Text(format) => cell.text(format).map(String::into_bytes),
                _ => cell
                    .fmu()
                    .and_then(|fmu| fmu.archive(library(&fmu, out).as_deref())),
            };
            written.map_err(|error| usage(&error))?
        }
    };
    let path = free(out, &stem, goal.ending())?;
    write_bytes(&path, &bytes)?;
    say!("{}: {} RC", path.display(), read.erm.branches.len());
    let notes = read.notes().into_iter().chain(constant);
    notes.for_each(|note| say!("  note: {note}"));
    Ok(())
}

/// Compiles the library of an FMU; a remark says why the archive has sources only.
fn library(fmu: &Fmu, out: &Path) -> Option<Vec<u8>> {
    let library = fmu.library(out);
    if let Err(reason) = &library {
        remark!("the FMU holds sources only: {reason}");
    }
    library.ok()
}
