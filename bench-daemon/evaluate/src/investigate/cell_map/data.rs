//! Reads the data of a map from data sets and run folders.

use std::path::{Path, PathBuf};

use analysis::{
    diagnosis::{Fixture, Run, RunData, Start},
    map::{MapData, MapLog, MapPoint, MapSpectrum, soc_of_point},
    ocv::OcvCurve,
    run_folder::{MAP_POINTS, MapPoint as Row, read_map_points},
    series::{Role, TimeSeries},
};
use bench_core::safety::failure::Failure;
use bench_plan::config::{MapPlace, MapProcedure};

use crate::investigate::dataset::Loaded;

/// Adds the runs of a cell in a data set or in a run folder. A run keeps its role unless all are held
/// out. Returns remarks, in sentences.
///
/// # Errors
/// Runs that cannot be read, or that start at a voltage beyond the curve.
pub fn add_folder(
    path: &Path,
    of_all: Role,
    cell: &str,
    loaded: Loaded,
    curve: &OcvCurve,
    data: &mut MapData,
) -> Result<Vec<String>, Failure> {
    let Loaded {
        set,
        problems,
        mut notes,
        ..
    } = loaded;
    if let Some(problem) = problems.first() {
        return Err(Failure::Usage(format!("{}: {problem}", path.display())));
    }
    let points = points(path)?;
    let of_cell = |run: &&Run| matches!(&run.fixture, Fixture::Cell(name) if name == cell);
    for run in set.runs.iter().filter(of_cell) {
        let held_out = of_all == Role::HeldOut || run.is_held_out();
        let role = if held_out { Role::HeldOut } else { Role::Train };
        let soc = match counted(run, &points, curve) {
            Some(soc) => soc,
            None => soc(run, path, curve)?,
        };
        match &run.data {
            RunData::Eis(sweep) if sweep.bias_a != 0.0 => {
                notes.push(format!(
                    "{} is left out: it was measured under {} A, and a map takes spectra at rest",
                    run.name, sweep.bias_a
                ));
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
    Ok(notes)
}

/// The points of a run folder of `[map]`; none for other folders.
fn points(path: &Path) -> Result<Vec<Row>, Failure> {
    if !path.join(MAP_POINTS).exists() {
        return Ok(Vec::new());
    }
    read_map_points(path).map_err(|error| Failure::Usage(error.to_string()))
}

/// The SOC of the point that a run belongs to.
fn counted(run: &Run, points: &[Row], curve: &OcvCurve) -> Option<f64> {
    let is_own = |file: &PathBuf| {
        let name = file.file_name().and_then(|name| name.to_str());
        name.and_then(|name| name.split('.').next()) == Some(run.name.as_str())
    };
    let point = points
        .iter()
        .find(|point| point.spectrum.iter().chain(&point.series).any(is_own))?;
    soc_of_point(point.soc, point.ocv_v, curve)
}

/// Returns the points of a map that a run has measured, with what it has measured at each.
///
/// # Errors
/// A table of points that cannot be read.
pub fn measured_places(folder: &Path, map: &MapProcedure) -> Result<Vec<MapPlace>, Failure> {
    let rows = points(folder)?;
    let place = |row: &Row| {
        let planned = map.place(row.number)?;
        let place = MapPlace {
            spectrum: row.spectrum.is_some(),
            pulses: !row.series.is_empty(),
            ..*planned
        };
        (place.spectrum || place.pulses).then_some(place)
    };
    Ok(rows.iter().filter_map(place).collect())
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

/// Returns the one cell of a folder, or the one that is chosen.
///
/// # Errors
/// Several cells, or none of the chosen name.
pub fn one_cell(path: &Path, runs: &[Run], chosen: Option<&str>) -> Result<String, Failure> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use analysis::run_folder::map_points_csv;
    use bench_plan::config::load_experiment;

    #[test]
    fn a_point_counts_as_measured_by_what_the_run_has_of_it() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/map.toml");
        let map = load_experiment(&file, None).unwrap().map.unwrap();
        let run = tempfile::tempdir().unwrap();
        assert_eq!(measured_places(run.path(), &map).unwrap(), []);
        let row = |number: usize, spectrum: bool, pulses: bool| Row {
            number,
            soc: 0.5,
            soc_by_ocv: None,
            temperature_degc: None,
            ocv_v: 3.7,
            charge_coulomb: -1.0,
            spectrum: spectrum.then(|| run.path().join("spectrum.csv")),
            series: pulses
                .then(|| run.path().join("trace.csv"))
                .into_iter()
                .collect(),
        };
        let rows = [
            row(1, true, false),
            row(2, false, false),
            row(4, true, true),
        ];
        let table = map_points_csv(run.path(), &rows);
        std::fs::write(run.path().join(MAP_POINTS), table).unwrap();
        let found = measured_places(run.path(), &map).unwrap();
        let found: Vec<_> = found
            .iter()
            .map(|place| {
                (
                    place.soc,
                    place.temperature_degc,
                    place.spectrum,
                    place.pulses,
                )
            })
            .collect();
        assert_eq!(found, [(0.9, 25.0, true, false), (0.9, 10.0, true, true)]);
    }
}
