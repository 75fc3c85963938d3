//! Fits the map of a finished run of `[map]`, as `eis-bench map` fits it to the run folder.

use analysis::{
    map::{MapData, MapFit, MapOptions, fit_map},
    ocv::OcvCurve,
    plot::chart_svg,
    report::{Figure, Level, Verdict},
    run_folder::MAP,
    series::Role,
};

use super::multisine_and_trace::Shown;
use crate::investigate::{
    cell_map::{
        data::{add_folder, one_cell},
        files::{picture, write as write_files},
        headline::headline,
    },
    dataset::{Reading, read_as},
};
use bench_core::{record::Recorder, safety::failure::Failure};
use bench_plan::config::Experiment;

/// Writes the files of the map; returns text for the summary, and adds to the report. A map that cannot
/// be fitted is noted.
pub(super) fn write(
    recorder: &mut Recorder,
    experiment: &Experiment,
    shown: &mut Shown,
) -> Result<String, Failure> {
    let Some(map) = &experiment.map else {
        return Ok(String::new());
    };
    let fit = match fitted(recorder, experiment, &map.ocv) {
        Ok(fit) => fit,
        Err(failure) => {
            let folder = format!("{}: ", recorder.folder().display());
            let why = failure.to_string().replace(&folder, "");
            recorder.warning(&format!("no map: {why}"));
            return Ok(String::new());
        }
    };
    let cell = &experiment.cell.name;
    write_files(recorder.folder(), cell, &map.ocv, &fit)?;
    let svg = chart_svg(&picture(cell, &fit));
    shown.figures.push(Figure {
        svg: svg.map_err(|error| Failure::Analysis(error.to_string()))?,
        caption: "The map: series resistance, and with all branches, over state of charge and temperature."
            .to_owned(),
    });
    let headline = headline(&fit);
    let texts = std::iter::once(&headline).chain(&fit.notes);
    shown.verdicts.extend(texts.map(|text| Verdict {
        level: Level::Note,
        text: format!("Map: {text}."),
    }));
    Ok(format!("map: {headline}; {MAP}\n"))
}

/// Fits the map. What the remarks on the data say, missing controls and refused points, the report states
/// itself.
fn fitted(
    recorder: &Recorder,
    experiment: &Experiment,
    curve: &OcvCurve,
) -> Result<MapFit, Failure> {
    let folder = recorder.folder();
    let how = Reading {
        known: None,
        refused_points: experiment.fit.refused_points,
    };
    let loaded = read_as(folder, how)?;
    let cell = one_cell(folder, &loaded.set.runs, None)?;
    let mut data = MapData::default();
    add_folder(folder, Role::Train, &cell, loaded, curve, &mut data)?;
    fit_map(&data, curve, &MapOptions::default())
        .map_err(|error| Failure::Analysis(error.to_string()))
}
