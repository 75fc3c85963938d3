//! Writes a map: the model, the tables of its errors, and its picture.

use std::path::Path;

use analysis::{
    given::{GivenModel, PlainModel},
    map::{LogScore, MapFit, SpectrumScore},
    ocv::OcvCurve,
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
    run_folder::{MAP, MAP_LOG_COLUMNS, MAP_LOGS, MAP_SPECTRA, MAP_SPECTRUM_COLUMNS},
    series::Role,
};
use bench_core::safety::failure::Failure;

use crate::files::{self, AMBIENT_DEGC};

/// Returns the role of data in words.
pub fn role(role: Role) -> &'static str {
    match role {
        Role::Train => "fitted",
        Role::HeldOut => "held out",
    }
}

/// Writes `map.json`, `map_logs.csv`, `map_spectra.csv` and `map.svg`/`.png` into a folder.
///
/// # Errors
/// A folder that cannot be written.
pub fn write(folder: &Path, name: &str, curve: &OcvCurve, fit: &MapFit) -> Result<(), Failure> {
    files::make_folder(folder)?;
    let model: GivenModel = PlainModel {
        warnings: fit.notes.clone(),
        ..PlainModel::of_map(name, &fit.map, curve, AMBIENT_DEGC)
    }
    .into();
    let json = model.to_json();
    let json = json.map_err(|error| Failure::Analysis(error.to_string()))?;
    files::write_text(folder, MAP, &json)?;
    if !fit.logs.is_empty() {
        files::write_text(folder, MAP_LOGS, &table_of_logs(&fit.logs))?;
    }
    if !fit.spectra.is_empty() {
        files::write_text(folder, MAP_SPECTRA, &table_of_spectra(&fit.spectra))?;
    }
    files::write_chart(folder, "map", &picture(name, fit))
}

/// A number of a table; a log below the states of charge that count has no error.
fn number(value: Option<f64>, factor: f64) -> String {
    let known = value.filter(|value| value.is_finite());
    known.map_or_else(String::new, |value| format!("{:.3}", factor * value))
}

fn table_of_logs(logs: &[LogScore]) -> String {
    let mut table = format!("{MAP_LOG_COLUMNS}\n");
    for score in logs {
        let (soc, worst_v) = (score.worst.map(|w| w.0), score.worst.map(|w| w.1));
        table.push_str(&format!(
            "{},{},{:.2},{},{},{},{},{},{}\n",
            score.name.replace(',', ";"),
            role(score.role),
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
    let mut table = format!("{MAP_SPECTRUM_COLUMNS}\n");
    for score in spectra {
        table.push_str(&format!(
            "{},{},{:.4},{:.2},{},{},{}\n",
            score.name.replace(',', ";"),
            role(score.role),
            score.soc,
            score.temperature_degc,
            number(Some(score.rms_part), 100.0),
            number(score.left_out.map(|left| left.part), 100.0),
            number(score.left_out.map(|left| left.sigma_part), 100.0)
        ));
    }
    table
}

/// The series resistance with its band and the whole resistance over state of charge, a line per
/// temperature; below them the error on each spectrum that a fit without it leaves.
pub(crate) fn picture(name: &str, fit: &MapFit) -> Chart {
    let map = &fit.map;
    let (mut series, mut whole) = (Vec::new(), Vec::new());
    for (j, degc) in map.temperature_degc.iter().enumerate() {
        let label = format!("{degc:.1} °C");
        let knots = map.soc.iter().enumerate();
        let points: Vec<(f64, f64)> = knots
            .map(|(k, z)| (*z, 1e3 * map.series.r_ohm[j][k]))
            .collect();
        if let Some(sigma_ohm) = map.series.sigma_ohm.get(j) {
            let half = sigma_ohm.iter().map(|sigma| 2e3 * sigma).collect();
            let band = Trace::new("", j, TraceStyle::Band, points.clone()).with_spread(half);
            series.push(band);
        }
        series.push(Trace::new(&label, j, TraceStyle::Line, points));
        let total = |z: f64| 1e3 * map.model_at(z, *degc).dc_resistance_ohm();
        let points = map.soc.iter().map(|z| (*z, total(*z)));
        whole.push(Trace::new("", j, TraceStyle::Line, points.collect()));
    }
    let soc = || AxisSpec::linear("State of charge").between(0.0, 1.0);
    let panel = |title: &str, traces| Panel::new(soc(), AxisSpec::linear(title), traces);
    let mut panels = vec![
        panel("series resistance, ±2σ / mΩ", series),
        panel("with all branches / mΩ", whole),
    ];
    let errors = errors_left_out(fit);
    if !errors.is_empty() {
        panels.push(panel("spectra, left out of the fit: error / %", errors));
    }
    Chart::new(
        name,
        "resistance over state of charge and temperature",
        panels,
    )
}

/// Errors on spectra that are left out of a fit, in the colour of the nearest temperature of the map.
fn errors_left_out(fit: &MapFit) -> Vec<Trace> {
    let nodes_degc = &fit.map.temperature_degc;
    let nearest = |degc: f64| {
        let nodes = 0..nodes_degc.len();
        let distance = |k: &usize| (nodes_degc[*k] - degc).abs();
        nodes.min_by(|a, b| distance(a).total_cmp(&distance(b)))
    };
    let at_node = |node: usize| {
        let here = fit.spectra.iter();
        let here = here.filter(|score| nearest(score.temperature_degc) == Some(node));
        let points = here.filter_map(|score| Some((score.soc, 100.0 * score.left_out?.part)));
        Trace::new("", node, TraceStyle::Points, points.collect())
    };
    let traces = (0..nodes_degc.len()).map(at_node);
    traces.filter(|trace| !trace.points.is_empty()).collect()
}
