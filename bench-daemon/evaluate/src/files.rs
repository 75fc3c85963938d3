//! Reads and writes the files of the commands: models in, texts and pictures out.

use std::path::Path;

use analysis::{
    contract::{Facts, Group},
    dataset,
    diagnosis::{Outcome, held_out_error, report::Picture},
    fit::{Addition, MAX_RC, OrderSelection, RefusedPoint},
    formats::read_file,
    forward::{OcvSource, SimModel},
    given::GivenModel,
    ocv::OcvCurve,
    pack::Pack,
    plot::{self, Chart, PlotError},
    run_folder,
    spectrum::{FlaggedPoint, SourcedSpectrum},
};

use crate::support::present::refused_in_words;
use bench_core::safety::failure::Failure;
use bench_plan::{
    config::{Source, resolve_cell},
    support::terminal::remark,
};

/// Returns the order of the recommended model of a folder: the one that was chosen, or that of the
/// only model. `None` if the folder does not state it.
pub fn recommended_order(folder: &Path) -> Option<usize> {
    if let Ok(text) = std::fs::read_to_string(folder.join(run_folder::ORDER)) {
        let selection: OrderSelection = serde_json::from_str(&text).ok()?;
        return Some(selection.recommended);
    }
    let mut orders = (1..=MAX_RC).filter(|rc| folder.join(run_folder::model(*rc)).is_file());
    let first = orders.next()?;
    orders.next().is_none().then_some(first)
}

/// Reads the spectra of a file, and reports how they were separated and what was left out.
pub fn read_spectra(path: &Path) -> Result<Vec<SourcedSpectrum>, Failure> {
    let read = read_file(path).map_err(|error| Failure::Usage(error.to_string()))?;
    for note in &read.notes {
        remark!("{note}");
    }
    Ok(read.spectra)
}

/// Removes points that the quality gate of the measurement has refused, according to the file,
/// unless they are requested, and reports that.
///
/// # Errors
/// [`Failure::Refused`] if nothing is left.
pub fn leave_out_refused(sourced: &mut SourcedSpectrum, wanted: bool) -> Result<(), Failure> {
    let (count, points) = (sourced.flagged.len(), sourced.spectrum.points.len());
    if count == 0 {
        return Ok(());
    }
    let (name, refusals) = (&sourced.spectrum.name, refused_in_words(&sourced.flagged));
    if wanted {
        remark!(
            "{name}: {count} of {points} points are used as requested, although the quality gate \
            refused them: {refusals}"
        );
        return Ok(());
    }
    remark!(
        "{name}: {count} of {points} points are left out: the quality gate refused them: \
        {refusals}; --refused-points uses them"
    );
    sourced.leave_out_flagged();
    if sourced.spectrum.points.is_empty() {
        Err(Failure::Refused { count })
    } else {
        Ok(())
    }
}

/// The points of spectra that a quality gate has refused, as a model file names them.
pub fn refused_points(sweeps: &[SourcedSpectrum], fitted: bool) -> Vec<RefusedPoint> {
    let of = |one: &SourcedSpectrum| -> Vec<RefusedPoint> {
        let named = |point: &FlaggedPoint| RefusedPoint {
            spectrum: one.spectrum.name.clone(),
            file: String::new(),
            freq_hz: point.freq_hz,
            reasons: point.reasons.clone(),
            fitted,
        };
        one.flagged.iter().map(named).collect()
    };
    sweeps.iter().flat_map(of).collect()
}

/// Refuses two evaluations of one measurement in a joint use of spectra, because they are not
/// repeats.
pub fn refuse_curves(spectra: &[SourcedSpectrum]) -> Result<(), Failure> {
    let curves: Vec<&str> = spectra
        .iter()
        .filter(|one| one.origin.curve.is_some())
        .map(|one| one.spectrum.name.as_str())
        .collect();
    if curves.is_empty() {
        return Ok(());
    }
    let met = curves.join(", ");
    Err(Failure::Usage(format!(
        "expected each measurement once, met curves of the same: {met}; take them apart with \
        `convert` and give one"
    )))
}

/// Reads an OCV curve: a file as `ocv --out` writes it, or the `[ocv]` of a cell file (`.toml`).
pub fn read_curve(path: &Path) -> Result<OcvCurve, Failure> {
    let fail = |reason: String| Failure::Usage(format!("{}: {reason}", path.display()));
    if path
        .extension()
        .is_some_and(|extension| extension == "toml")
    {
        return resolve_cell(&Source::read(path)?)?.ocv.ok_or_else(|| {
            fail("expected a section [ocv] in the cell file, found none".to_owned())
        });
    }
    let text = std::fs::read_to_string(path).map_err(|error| fail(error.to_string()))?;
    let curve: OcvCurve = serde_json::from_str(&text).map_err(|error| {
        fail(format!(
            "expected an OCV curve as `ocv --out` writes it, or a cell file (.toml): {error}"
        ))
    })?;
    curve.validate().map_err(|error| fail(error.to_string()))?;
    Ok(curve)
}

/// Temperature of the surroundings of a model with a map, °C, if none is given.
pub const AMBIENT_DEGC: f64 = 25.0;

/// A model as a simulation takes it: with the additions of the cell.
///
/// A model with a map follows state of charge and temperature; its cells start at `ambient_degc`.
/// For a constant OCV, or a model without a map, that temperature means nothing.
pub fn sim_model(
    file: &GivenModel,
    ocv: OcvSource,
    pack: Pack,
    ambient_degc: f64,
) -> Result<SimModel, Failure> {
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
    if let Some(map) = &file.map {
        let OcvSource::Curve(curve) = ocv else {
            return Err(Failure::Usage(
                "expected a state of charge for a model with a map, found an open-circuit voltage \
                that stays"
                    .to_owned(),
            ));
        };
        return SimModel::mapped(map.clone(), curve, pack, ambient_degc)
            .map_err(|error| usage(&error));
    }
    match file.augmented().map_err(|error| usage(&error))? {
        None => SimModel::pack(&file.erm, ocv, pack).map_err(|error| usage(&error)),
        Some(cell) => SimModel::augmented(&cell, ocv, pack).map_err(|error| usage(&error)),
    }
}

/// Treatment of a model's additions, in sentences.
pub fn addition_notes(file: &GivenModel) -> Vec<String> {
    let names = |group: Group| -> Vec<&str> {
        file.additions
            .iter()
            .filter(|a| a.group == group)
            .map(|a| a.title.as_str())
            .collect()
    };
    let (cell, bench) = (names(Group::Cell), names(Group::Bench));
    let mut notes = Vec::new();
    if !cell.is_empty() {
        notes.push(format!(
            "additions to the fitted model: {}",
            cell.join("; ")
        ));
    }
    if !bench.is_empty() {
        notes.push(format!(
            "left out, because the bench did it and not the cell: {}",
            bench.join("; ")
        ));
    }
    notes
}

/// Makes the folder of `--out` if need be.
pub fn make_folder(out: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(out)
        .map_err(|error| Failure::Usage(format!("--out {}: {error}", out.display())))
}

/// Writes a text into a folder.
pub fn write_text(folder: &Path, name: &str, text: &str) -> Result<(), Failure> {
    dataset::write_atomically(&folder.join(name), text.as_bytes())
        .map_err(|error| Failure::Analysis(error.to_string()))
}

/// Draws a picture into a folder, as SVG and as PNG.
pub fn write_picture(
    folder: &Path,
    name: &str,
    draw: impl Fn(&Path) -> Result<(), PlotError>,
) -> Result<(), Failure> {
    // A name may hold dots: the extension is added, not exchanged.
    ["svg", "png"].into_iter().try_for_each(|extension| {
        draw(&folder.join(format!("{name}.{extension}")))
            .map_err(|error| Failure::Analysis(error.to_string()))
    })
}

/// Writes the pictures of a diagnosis into a folder.
pub fn write_pictures(folder: &Path, pictures: &[Picture]) -> Result<(), Failure> {
    pictures.iter().try_for_each(|picture| {
        write_picture(folder, &picture.name, |at| picture.drawing.write(at))
    })
}

/// Returns the additions, those of the diagnosed base with the title and the evidence that they had:
/// the diagnosis has fitted them again and has not judged them.
fn carried(additions: Vec<Addition>, base: &GivenModel) -> Vec<Addition> {
    let of_base = |addition: Addition| {
        let own = base.additions.iter().find(|own| own.name == addition.name);
        match own {
            Some(own) => Addition {
                parameters: addition.parameters,
                ..own.clone()
            },
            None => addition,
        }
    };
    additions.into_iter().map(of_base).collect()
}

/// Writes the diagnosed model with the additions, if any, and the best predicting addition if no
/// effect is certain; `refused` are the points that the gate of the data has refused.
pub fn write_augmented(
    folder: &Path,
    base: &GivenModel,
    outcome: &Outcome,
    refused: &[RefusedPoint],
) -> Result<(), Failure> {
    const BY: &str = concat!("eis-bench ", env!("CARGO_PKG_VERSION"));
    let d = &outcome.diagnosis;
    let predictive = d.predictive.as_ref().map(|predictive| &predictive.model);
    let models = [
        (
            "model_augmented.json",
            d.augmented.as_ref(),
            carried(d.additions(BY), base),
            held_out_error(&d.gap),
        ),
        (
            "model_predictive.json",
            predictive,
            d.predictive_additions(BY),
            d.predictive
                .as_ref()
                .and_then(|predictive| held_out_error(&predictive.gap)),
        ),
    ];
    for (name, erm, additions, held_out) in models {
        let (Some(erm), Some(facts), false) = (erm, outcome.facts, additions.is_empty()) else {
            continue;
        };
        let facts = Facts { held_out, ..facts };
        let text = base
            .clone()
            .with_additions(erm.clone(), facts, additions)
            .with_refused(refused.to_vec())
            .to_json()
            .map_err(|error| Failure::Analysis(error.to_string()))?;
        write_text(folder, name, &text)?;
    }
    Ok(())
}

/// Draws a chart into a folder, as SVG and as PNG.
pub fn write_chart(folder: &Path, name: &str, chart: &Chart) -> Result<(), Failure> {
    write_picture(folder, name, |path| plot::chart(chart, path))
}

/// Reads a model of any kind from a file.
pub fn read_model(path: &Path, band_hz: Option<(f64, f64)>) -> Result<GivenModel, String> {
    let text = std::fs::read_to_string(path).map_err(|error| error.to_string())?;
    let name = path.file_stem().map_or_else(
        || "model".to_owned(),
        |stem| stem.to_string_lossy().into_owned(),
    );
    GivenModel::from_json(&text, &name, band_hz).map_err(|error| error.to_string())
}
