//! Reads the logs of `hppc`, and what is known of the charge of their cells.

use std::path::{Path, PathBuf};

use analysis::{
    dataset::RunIndex,
    formats::{ReadSeries, SeriesOptions, read_record},
    loads::{ChargeKnown, drawn_by_counter},
    ocv::OcvCurve,
    run_folder::{self, MapPoint},
};

use super::{args::HppcArgs, commanded::subtract_residual};
use bench_core::safety::failure::Failure;
use bench_evaluate::investigate::proposal::fits_current;
use bench_plan::{
    config::{Cell, Source, resolve_cell},
    support::terminal::remark,
};

/// A log that was read.
pub(super) struct Read {
    pub(super) name: String,
    pub(super) record: ReadSeries,
    /// The cell of its run folder.
    pub(super) cell: Option<Cell>,
    /// The point of the map of its run folder.
    pub(super) point: Option<MapPoint>,
}

/// What is known of the cells of all logs.
#[derive(Clone, Copy)]
pub(super) struct Known<'a> {
    pub(super) curve: Option<&'a OcvCurve>,
    pub(super) cell: Option<&'a Cell>,
}

/// Reads all files, and the logs in run folders.
pub(super) fn read_all(args: &HppcArgs) -> Result<Vec<Read>, Failure> {
    let mut all = Vec::new();
    for path in &args.files {
        if path.is_dir() {
            let cell = cell_of_run(path);
            let points = points_of_run(path)?;
            let index = index_of_run(path);
            let place = |file: &PathBuf| points.iter().position(|one| one.series.contains(file));
            let mut files = logs_of_run(path)?;
            files.sort_by_key(|file| place(file).unwrap_or(points.len()));
            for file in files {
                let point = place(&file).and_then(|place| points.get(place)).cloned();
                let mut log = one(args, &file, cell.clone())?;
                let trace = index
                    .traces
                    .iter()
                    .find(|trace| path.join(&trace.file) == file);
                let series = &mut log.record.series;
                if let Some(left_a) = trace.and_then(|trace| subtract_residual(series, trace)) {
                    remark!(
                        "{}: {:+.1} mA at a command of zero count as a rest and are subtracted",
                        log.name,
                        1.0e3 * left_a
                    );
                }
                all.push(Read { point, ..log });
            }
        } else {
            all.push(one(args, path, None)?);
        }
    }
    Ok(all)
}

fn one(args: &HppcArgs, path: &Path, cell: Option<Cell>) -> Result<Read, Failure> {
    let options = SeriesOptions {
        sign: args.positive,
    };
    let record = read_record(path, &options).map_err(|error| Failure::Usage(error.to_string()))?;
    for note in &record.notes {
        remark!("{note}");
    }
    Ok(Read {
        name: record.series.name.clone(),
        record,
        cell,
        point: None,
    })
}

/// The logs of a run folder, by name.
fn logs_of_run(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let fail = |reason: String| Failure::Usage(format!("{}: {reason}", folder.display()));
    let mut found: Vec<PathBuf> = names(folder).map_err(|error| fail(error.to_string()))?;
    found.retain(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        run_folder::is_series(&name)
    });
    if found.is_empty() {
        return Err(fail(
            "expected a run folder with the log of a current and voltage over time, found none; a sweep \
             has no pulses"
                .to_owned(),
        ));
    }
    Ok(found)
}

/// The index of a run folder; an empty one if it cannot be read.
fn index_of_run(folder: &Path) -> RunIndex {
    let text = std::fs::read_to_string(folder.join(run_folder::INDEX)).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_default()
}

/// The points of the map of a run folder; none without a map.
fn points_of_run(folder: &Path) -> Result<Vec<MapPoint>, Failure> {
    if !folder.join(run_folder::MAP_POINTS).exists() {
        return Ok(Vec::new());
    }
    run_folder::read_map_points(folder).map_err(|error| Failure::Usage(error.to_string()))
}

fn names(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        found.push(entry?.path());
    }
    found.sort();
    Ok(found)
}

/// The cell of a run, from the copies of its configuration.
fn cell_of_run(folder: &Path) -> Option<Cell> {
    let copies = names(&folder.join(run_folder::CONFIG)).ok()?;
    copies
        .iter()
        .find_map(|path| resolve_cell(&Source::read(path).ok()?).ok())
}

/// The charge of a log's cell, and where it comes from.
pub(super) struct Charge<'a> {
    pub(super) known: ChargeKnown<'a>,
    /// Charge drawn by the counter of the cycler, Ah.
    pub(super) counter_ah: Option<Vec<f64>>,
    pub(super) words: String,
}

/// What is known of the charge of a log's cell, the options first.
pub(super) fn charge<'a>(args: &HppcArgs, log: &'a Read, known: Known<'a>) -> Charge<'a> {
    let of_cell = known.cell.or(log.cell.as_ref());
    let head = log.record.state.head.capacity_ah.map(|fact| fact.value);
    let sources = [
        (args.capacity_ah, "--capacity-ah"),
        (known.curve.map(|curve| curve.capacity_ah), "the OCV curve"),
        (
            of_cell.map(|cell| cell.capacity_coulomb.value() / 3600.0),
            "the file of the cell",
        ),
        (head, "the head of the log"),
    ];
    let capacity = sources
        .into_iter()
        .find_map(|(ah, source)| Some((ah?, source)));
    let column = log.record.state.soc.as_deref();
    let series = &log.record.series;
    let fits = column.map(|column| fits_current(series, column));
    if let Some(Err(reason)) = &fits {
        remark!("{}: {reason}", log.name);
    }
    let column = column.filter(|_| matches!(fits, Some(Ok(()))));
    let net_ah = log.record.state.net_ah.as_deref();
    let counter_ah = match net_ah.map(|net_ah| drawn_by_counter(series, net_ah)) {
        Some(Ok(counter_ah)) => Some(counter_ah),
        Some(Err(reason)) => {
            remark!("{}: {reason}", log.name);
            None
        }
        None => None,
    };
    let by = match counter_ah {
        Some(_) => " by the net capacity of the log",
        None => "",
    };
    let of_map = log.point.as_ref().map(|point| point.soc);
    let by_map = of_map.filter(|_| args.soc_start.is_none() && capacity.is_some());
    let words = match (args.soc_start.or(by_map), capacity, column, known.curve) {
        (Some(soc), Some((ah, source)), ..) if by_map.is_some() => format!(
            "state of charge: counted{by} from {:.1} % of point {}, as {} says, {ah} Ah as {source} says",
            100.0 * soc,
            log.point.as_ref().map_or(0, |point| point.number),
            run_folder::MAP_POINTS
        ),
        (Some(soc), Some((ah, source)), ..) => format!(
            "state of charge: counted{by} from {:.1} % at the first row, {ah} Ah as {source} says",
            100.0 * soc
        ),
        (Some(_), None, ..) => {
            "no state of charge: --soc-start needs a capacity, which --capacity-ah \
                                states; the charge drawn since the first row instead"
                .to_owned()
        }
        (None, _, Some(_), _) => "state of charge: from the column of the log".to_owned(),
        (None, _, None, Some(_)) => {
            "state of charge: by the OCV curve at the first rest of each stretch, counted from there".to_owned()
        }
        _ => {
            let counter = if by.is_empty() { " by the current" } else { by };
            format!(
                "no state of charge: the charge drawn since the first row, counted{counter}; \
                 --soc-start with --capacity-ah states it"
            )
        }
    };
    Charge {
        known: ChargeKnown {
            capacity_ah: capacity.map(|(ah, _)| ah),
            soc_start: args.soc_start.or(by_map),
            curve: known.curve,
            column,
        },
        counter_ah,
        words,
    }
}
