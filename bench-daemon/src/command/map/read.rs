//! Reads the data of a map: logs, data sets and run folders.

use std::path::Path;

use super::args::MapArgs;
use analysis::{
    formats::{SeriesOptions, read_record},
    map::{MapData, MapLog},
    ocv::OcvCurve,
    run_folder::JOURNAL,
    series::Role,
};
use bench_core::safety::failure::Failure;
use bench_evaluate::{
    files,
    investigate::{
        cell_map::data::{add_folder, one_cell},
        dataset::{named_files, read_dataset},
    },
    run::Recorded,
};
use bench_plan::support::terminal::remark;

/// Reads the OCV curve: `--ocv`, else that of the first folder that has one.
///
/// # Errors
/// A file that cannot be read, or no curve.
pub(super) fn curve(args: &MapArgs) -> Result<OcvCurve, Failure> {
    if let Some(path) = &args.ocv {
        return files::read_curve(path);
    }
    for folder in args.data.iter().filter(|path| path.is_dir()) {
        if let Some(file) = named_files(folder)?.ocv {
            return files::read_curve(&file.path);
        }
        if folder.join(JOURNAL).is_file()
            && let Some(curve) = Recorded::read(folder)?.ocv()
        {
            return Ok(curve.clone());
        }
    }
    Err(Failure::Usage(
        "expected an OCV curve of the cell, found none in the data; give one with --ocv".to_owned(),
    ))
}

/// Reads all logs and folders.
///
/// # Errors
/// A file that is not as expected; folders of several cells.
pub(super) fn data(args: &MapArgs, curve: &OcvCurve) -> Result<MapData, Failure> {
    let mut data = MapData::default();
    let mut cell: Option<String> = None;
    let held_out = args.held_out.iter().map(|path| (path, true));
    for (path, held_out) in args.data.iter().map(|path| (path, false)).chain(held_out) {
        if path.is_dir() {
            let loaded = read_dataset(path)?;
            let named = one_cell(path, &loaded.set.runs, args.specimen.as_deref())?;
            if let Some(other) = cell.as_ref().filter(|other| **other != named) {
                return Err(Failure::Usage(format!(
                    "{}: expected runs of the cell {other} as in the folder before it, found {named}",
                    path.display()
                )));
            }
            let notes = add_folder(path, role(held_out), &named, loaded, curve, &mut data)?;
            for note in notes {
                remark!("{}: {note}", path.display());
            }
            cell = Some(named);
        } else {
            data.logs.push(log(path, role(held_out), args)?);
        }
    }
    Ok(data)
}

fn role(held_out: bool) -> Role {
    if held_out { Role::HeldOut } else { Role::Train }
}

fn log(path: &Path, role: Role, args: &MapArgs) -> Result<MapLog, Failure> {
    let options = SeriesOptions {
        sign: args.positive,
    };
    let read = read_record(path, &options).map_err(|error| Failure::Usage(error.to_string()))?;
    for note in &read.notes {
        remark!("{note}");
    }
    let mut series = read.series;
    series.name = path.display().to_string();
    Ok(MapLog {
        series,
        soc_start: args.soc_start,
        net_ah: read.state.net_ah,
        temperature_degc: args.temperature_degc,
        role,
    })
}
