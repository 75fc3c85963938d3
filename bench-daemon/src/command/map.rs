//! `eis-bench map`: resistances over state of charge and temperature, from logs and spectra of a cell.

mod args;
mod next;
mod print;
mod read;

pub use args::MapArgs;

use std::path::Path;

use crate::command::printed::say_json;
use analysis::{
    given::{GivenModel, PlainModel},
    map::{Fitted, LogScore, MapFit, MapOptions, NextPlan, SpectrumScore, fit_map},
    ocv::OcvCurve,
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
};
use bench_core::{operator::progress::Waiting, safety::failure::Failure};
use bench_evaluate::files::{self, AMBIENT_DEGC};
use bench_plan::support::terminal::say;
use serde::Serialize;

/// Result of the command: the fields of the fit, and the proposed measurements.
#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    fit: &'a MapFit,
    #[serde(skip_serializing_if = "Option::is_none")]
    next: Option<NextPlan>,
}

/// Fits the map, prints what it is worth, and writes it into a folder if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn map(args: &MapArgs) -> Result<(), Failure> {
    if let Some(soc) = args.soc_start.filter(|soc| !(0.0..=1.0).contains(soc)) {
        let reason = format!("--soc-start: expected a fraction from 0 to 1, found {soc}");
        return Err(Failure::Usage(reason));
    }
    let curve = read::curve(args)?;
    let waiting = Waiting::on("reading the data".to_owned());
    let data = read::data(args, &curve)?;
    let profiles = next::read(&args.next)?;
    let options = MapOptions {
        time_constants_s: args.time_constants_s.clone(),
        ocv_temperature_degc: args.ocv_temperature_degc,
        ..MapOptions::default()
    };
    waiting.say(format!(
        "fitting a map to {} logs and {} spectra",
        data.logs.len(),
        data.spectra.len()
    ));
    let fit =
        fit_map(&data, &curve, &options).map_err(|error| Failure::Usage(error.to_string()))?;
    waiting.end();
    let stem = args.data[0].file_stem().unwrap_or_default();
    let name = args
        .name
        .clone()
        .unwrap_or_else(|| stem.to_string_lossy().into_owned());
    if let Some(folder) = &args.out {
        write(folder, &name, &curve, &fit)?;
    }
    let fitted = Fitted {
        data: &data,
        ocv: &curve,
        options: &options,
        fit: &fit,
    };
    if !args.json {
        print::print(&fit);
    }
    let next = next::plan(&args.next, &profiles, fitted)?;
    if args.json {
        return say_json(&Printed { fit: &fit, next });
    }
    if let Some(plan) = &next {
        next::print(plan);
    }
    if let Some(folder) = &args.out {
        say!("written to {}", folder.display());
    }
    Ok(())
}

fn write(folder: &Path, name: &str, curve: &OcvCurve, fit: &MapFit) -> Result<(), Failure> {
    files::make_folder(folder)?;
    let model: GivenModel = PlainModel {
        warnings: fit.notes.clone(),
        ..PlainModel::of_map(name, &fit.map, curve, AMBIENT_DEGC)
    }
    .into();
    let json = model.to_json();
    let json = json.map_err(|error| Failure::Analysis(error.to_string()))?;
    files::write_text(folder, "map.json", &json)?;
    if !fit.logs.is_empty() {
        files::write_text(folder, "map_logs.csv", &table_of_logs(&fit.logs))?;
    }
    if !fit.spectra.is_empty() {
        files::write_text(folder, "map_spectra.csv", &table_of_spectra(&fit.spectra))?;
    }
    files::write_chart(folder, "map", &picture(name, fit))
}

/// A number of a table; a log below the states of charge that count has no error.
fn number(value: Option<f64>, factor: f64) -> String {
    let known = value.filter(|value| value.is_finite());
    known.map_or_else(String::new, |value| format!("{:.3}", factor * value))
}

fn table_of_logs(logs: &[LogScore]) -> String {
    let mut table = "log,role,temperature_degc,rms_mv,bias_mv,worst_soc,worst_mv,left_out_rms_mv,in_band_percent\n"
        .to_owned();
    for score in logs {
        let (soc, worst_v) = (score.worst.map(|w| w.0), score.worst.map(|w| w.1));
        table.push_str(&format!(
            "{},{},{:.2},{},{},{},{},{},{}\n",
            score.name.replace(',', ";"),
            print::role(score.role),
            score.temperature_degc,
            number(Some(score.rms_v), 1e3),
            number(Some(score.bias_v), 1e3),
            number(soc, 1.0),
            number(worst_v, 1e3),
            number(score.left_out_rms_v, 1e3),
            number(score.covered, 100.0)
        ));
    }
    table
}

fn table_of_spectra(spectra: &[SpectrumScore]) -> String {
    let mut table =
        "spectrum,role,soc,temperature_degc,error_percent,left_out_percent,expected_percent\n"
            .to_owned();
    for score in spectra {
        table.push_str(&format!(
            "{},{},{:.4},{:.2},{},{},{}\n",
            score.name.replace(',', ";"),
            print::role(score.role),
            score.soc,
            score.temperature_degc,
            number(Some(score.rms_part), 100.0),
            number(score.left_out.map(|left| left.part), 100.0),
            number(score.left_out.map(|left| left.sigma_part), 100.0)
        ));
    }
    table
}

/// The series resistance and the whole resistance over state of charge, a line per temperature.
fn picture(name: &str, fit: &MapFit) -> Chart {
    let map = &fit.map;
    let (mut series, mut whole) = (Vec::new(), Vec::new());
    for (j, degc) in map.temperature_degc.iter().enumerate() {
        let label = format!("{degc:.1} °C");
        let knots = map.soc.iter().enumerate();
        let points = knots.map(|(k, z)| (*z, 1e3 * map.series.r_ohm[j][k]));
        series.push(Trace::new(&label, j, TraceStyle::Line, points.collect()));
        let total = |z: f64| 1e3 * map.model_at(z, *degc).dc_resistance_ohm();
        let points = map.soc.iter().map(|z| (*z, total(*z)));
        whole.push(Trace::new("", j, TraceStyle::Line, points.collect()));
    }
    let soc = || AxisSpec::linear("State of charge").between(0.0, 1.0);
    let panel = |title: &str, traces| Panel::new(soc(), AxisSpec::linear(title), traces);
    Chart::new(
        name,
        "resistance over state of charge and temperature",
        vec![
            panel("series resistance / mΩ", series),
            panel("with all branches / mΩ", whole),
        ],
    )
}
