//! One chart of the gap per held-out run: the rows beside edges and all rows, each with the noise
//! over the same rows.

use super::super::first_page::{AS_GIVEN, REFITTED, Row, titles};
use super::super::numbers::plain;
use super::{AFTER, ALONE, BEFORE, Kind, NOISE, Picture, file_name, has_after};
use crate::outcome::Diagnosis;
use analysis_plot::{AxisSpec, Bar, BarChart, BarGroup, BarPanel, BarRow, Drawing};

const WIDTH_PX: u32 = 900;
/// Most runs that get a chart; the table names all.
const MOST_CHARTS: usize = 4;

/// Returns the charts of the runs that the model as given misses most, in the order of the runs.
pub(super) fn held_out(d: &Diagnosis) -> Vec<Picture> {
    let records = d.gap.iter().map(|gap| {
        let beside = Row::beside_edges(gap);
        let with = Row::with_edges(gap);
        std::iter::once(beside).chain(with).collect::<Vec<Row>>()
    });
    let spectra = d.gap_spectra.iter().map(|gap| vec![Row::of_spectrum(gap)]);
    let records = most(records.collect(), MOST_CHARTS);
    let spectra = most(
        spectra.collect(),
        MOST_CHARTS - records.len().min(MOST_CHARTS - 1),
    );
    records
        .iter()
        .chain(&spectra)
        .enumerate()
        .map(|(k, rows)| picture(d, k + 1, rows))
        .collect()
}

/// Returns the runs with the largest misfit, in their order.
fn most(mut runs: Vec<Vec<Row>>, count: usize) -> Vec<Vec<Row>> {
    let mut sizes: Vec<f64> = runs.iter().map(|rows| rows[0].alone).collect();
    sizes.sort_by(|a, b| b.total_cmp(a));
    if let Some(least) = sizes.get(count - 1) {
        runs.retain(|rows| rows[0].alone >= *least);
        runs.truncate(count);
    }
    runs
}

fn picture(d: &Diagnosis, number: usize, rows: &[Row]) -> Picture {
    let run = rows[0].run.clone();
    let mut legend = vec![(AS_GIVEN.to_owned(), ALONE), (REFITTED.to_owned(), BEFORE)];
    if has_after(d) {
        legend.push((format!("with {}", titles(d)), AFTER));
    }
    let noise = if d.noise.from_repeats {
        "noise"
    } else {
        "noise as assumed"
    };
    legend.push((noise.to_owned(), NOISE));
    let axis = match rows[0].unit {
        "mV" => "Voltage, rms / mV",
        _ => "Impedance, rms of |ΔZ| / % of |Z|",
    };
    // One axis for each choice of rows: the noise at edges can be many times all else.
    let panel = |row: &Row| BarPanel {
        axis: AxisSpec::linear(axis),
        baseline: 0.0,
        reference: None,
        groups: vec![BarGroup {
            heading: String::new(),
            rows: vec![bars(d, row)],
        }],
        note_heading: String::new(),
    };
    let chart = BarChart {
        title: format!("{run}: prediction less measurement"),
        subtitle: "A run that no fit has seen".to_owned(),
        legend,
        panels: rows.iter().map(panel).collect(),
        width_px: WIDTH_PX,
    };
    Picture {
        name: format!("gap-{number}-{}", file_name(&run)),
        kind: Kind::HeldOut,
        caption: format!("Gap of {run}. Each bar and the noise below it are over the same rows."),
        drawing: Drawing::Bars(chart),
    }
}

fn bars(d: &Diagnosis, row: &Row) -> BarRow {
    let bar = |value: f64, colour| Bar {
        value,
        colour,
        faint: false,
        text: format!("{} {}", plain(value), row.unit),
    };
    let mut bars = vec![bar(row.alone, ALONE), bar(row.base, BEFORE)];
    if has_after(d) {
        bars.push(bar(row.augmented, AFTER));
    }
    bars.push(bar(row.floor, NOISE));
    let label = if row.rows.is_empty() {
        "all rows"
    } else {
        row.rows
    };
    BarRow {
        label: label.to_owned(),
        marked: false,
        bars,
        note: String::new(),
    }
}
