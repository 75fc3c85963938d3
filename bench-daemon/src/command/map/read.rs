//! Reads the data of a map: logs, data sets and run folders.

use std::path::Path;

use super::args::MapArgs;
use analysis::{
    diagnosis::{Fixture, Run, RunData, Start},
    formats::{SeriesOptions, read_record},
    map::{MapData, MapLog, MapPoint, MapSpectrum},
    ocv::OcvCurve,
    run_folder::JOURNAL,
    series::{Role, TimeSeries},
};
use bench_core::safety::failure::Failure;
use bench_evaluate::{
    files,
    investigate::dataset::{Loaded, named_files, read_dataset},
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
            folder(path, role(held_out), &named, loaded, curve, &mut data)?;
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

/// Adds the runs of a cell in a data set or in a run folder. A run keeps its role unless all are held
/// out.
fn folder(
    path: &Path,
    of_all: Role,
    cell: &str,
    loaded: Loaded,
    curve: &OcvCurve,
    data: &mut MapData,
) -> Result<(), Failure> {
    let Loaded {
        set,
        problems,
        notes,
        ..
    } = loaded;
    for note in &notes {
        remark!("{}: {note}", path.display());
    }
    if let Some(problem) = problems.first() {
        return Err(Failure::Usage(format!("{}: {problem}", path.display())));
    }
    let of_cell = |run: &&Run| matches!(&run.fixture, Fixture::Cell(name) if name == cell);
    for run in set.runs.iter().filter(of_cell) {
        let role = role(of_all == Role::HeldOut || run.is_held_out());
        let soc = soc(run, path, curve)?;
        match &run.data {
            RunData::Eis(sweep) if sweep.bias_a != 0.0 => {
                remark!(
                    "{}: {} is left out: it was measured under {} A, and a map takes spectra at rest",
                    path.display(),
                    run.name,
                    sweep.bias_a
                );
            }
            RunData::Eis(sweep) => data.spectra.push(MapSpectrum {
                name: run.name.clone(),
                role,
                soc,
                temperature_degc: run.temperature_degc,
                points: sweep
                    .points
                    .iter()
                    .map(|point| MapPoint {
                        freq_hz: point.freq_hz,
                        z_ohm: point.z_ohm,
                        sigma_ohm: point.sigma_ohm.map(|(re, im)| re.max(im)),
                    })
                    .collect(),
            }),
            RunData::Time(record) => data.logs.push(MapLog {
                series: TimeSeries {
                    name: run.name.clone(),
                    ..record.series.clone()
                },
                soc_start: Some(soc),
                net_ah: None,
                temperature_degc: Some(run.temperature_degc),
                role,
            }),
        }
    }
    Ok(())
}

/// The SOC at the start of a run.
fn soc(run: &Run, path: &Path, curve: &OcvCurve) -> Result<f64, Failure> {
    match run.start {
        Start::Soc(soc) => Ok(soc),
        Start::Ocv(met_v) => curve.soc_at(met_v).ok_or_else(|| {
            let (low_v, high_v) = (curve.ocv_v[0], curve.ocv_v[curve.ocv_v.len() - 1]);
            Failure::Usage(format!(
                "{}: {} starts at {met_v:.4} V, expected a voltage of the OCV curve, {low_v:.4} to \
                {high_v:.4} V",
                path.display(),
                run.name
            ))
        }),
    }
}

/// The one cell of a folder, or the one that is chosen.
fn one_cell(path: &Path, runs: &[Run], chosen: Option<&str>) -> Result<String, Failure> {
    let mut cells: Vec<&str> = Vec::new();
    for run in runs {
        if let Fixture::Cell(name) = &run.fixture
            && !cells.contains(&name.as_str())
        {
            cells.push(name);
        }
    }
    let refuse = |expected: String| {
        let found = if cells.is_empty() {
            "none".to_owned()
        } else {
            cells.join(", ")
        };
        Err(Failure::Usage(format!(
            "{}: expected {expected}, found {found}",
            path.display()
        )))
    };
    match (chosen, &cells[..]) {
        (Some(name), _) if cells.contains(&name) => Ok(name.to_owned()),
        (Some(name), _) => refuse(format!("a cell {name}")),
        (None, [cell]) => Ok((*cell).to_owned()),
        (None, _) => refuse("runs of one cell; --specimen chooses one".to_owned()),
    }
}
