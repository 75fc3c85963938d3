//! Pictures of the comparison.

use analysis_plot::{
    AxisSpec, Bar, BarChart, BarGroup, BarPanel, BarRow, Chart, Panel, Trace, TraceStyle,
};

use super::{
    result::{CurrentChange, PointChange, UnderCurrent},
    words::{branch_in_words, tau_in_words},
};

/// Draws the difference of every sweep from the mean at rest over the frequency, with the spread of the
/// sweeps at rest.
pub fn change_chart(found: &UnderCurrent) -> Chart {
    Chart::new(
        "Impedance under a direct current, change from the mean at rest",
        &format!(
            "band: 2σ of one sweep of any of {} cells at rest; dashed: points left out for a trend",
            found.cells
        ),
        vec![
            panel(found, "Re, change / % of |Z|", |p| (p.re, p.sigma_re), true),
            panel(
                found,
                "Im, change / % of |Z|",
                |p| (p.im, p.sigma_im),
                false,
            ),
        ],
    )
}

fn panel(
    found: &UnderCurrent,
    name: &str,
    part: fn(&PointChange) -> (f64, f64),
    named: bool,
) -> Panel {
    let label = |text: String| if named { text } else { String::new() };
    let mut traces = Vec::new();
    if let Some(widest) = found
        .changes
        .iter()
        .max_by_key(|change| change.points.len())
    {
        let points = widest.points.iter().map(|p| (p.freq_hz, 0.0)).collect();
        let spread = widest.points.iter().map(|p| 200.0 * part(p).1).collect();
        let band = Trace::new(
            &label("at rest, 2σ".to_owned()),
            7,
            TraceStyle::Band,
            points,
        );
        traces.push(band.with_spread(spread));
    }
    for (colour, change) in found.changes.iter().enumerate() {
        let place = |p: &PointChange| (p.freq_hz, 100.0 * part(p).0);
        let first_kept = change.points.iter().position(|p| p.kept).unwrap_or(0);
        let (left_out, kept) = (&change.points[..=first_kept], &change.points[first_kept..]);
        let places = |points: &[PointChange]| points.iter().map(place).collect::<Vec<_>>();
        traces.push(Trace::new("", colour, TraceStyle::Dashed, places(left_out)));
        traces.push(Trace::new("", colour, TraceStyle::Line, places(kept)));
        let name = label(title(change));
        traces.push(Trace::new(&name, colour, TraceStyle::Points, places(kept)));
    }
    let frequency = AxisSpec::logarithmic("Frequency / Hz");
    Panel::new(frequency, AxisSpec::linear(name), traces)
}

fn title(change: &CurrentChange) -> String {
    format!("{:+} A ({})", change.bias_a, change.name)
}

/// Draws the change of every resistance as bars.
pub fn share_chart(found: &UnderCurrent) -> BarChart {
    let row = |index: usize| {
        let bars = found
            .changes
            .iter()
            .enumerate()
            .filter_map(|(colour, change)| {
                let branch = change.branches.get(index)?;
                Some(Bar {
                    value: if branch.measured {
                        100.0 * branch.share
                    } else {
                        f64::NAN
                    },
                    colour,
                    faint: !branch.is_certain(),
                    text: branch_in_words(branch),
                })
            });
        let name = found
            .changes
            .first()
            .and_then(|c| Some(c.branches.get(index)?.name.clone()));
        BarRow {
            label: format!(
                "{} {}",
                name.unwrap_or_default(),
                tau_in_words(found, index)
            ),
            marked: false,
            bars: bars.collect(),
            note: String::new(),
        }
    };
    let rows = (0..=found.model.branches.len()).map(row).collect();
    BarChart {
        title: "Change of each resistance under a direct current".to_owned(),
        subtitle: "pale: not more than chance; p is adjusted for the number of changes tested"
            .to_owned(),
        legend: found
            .changes
            .iter()
            .enumerate()
            .map(|(k, c)| (title(c), k))
            .collect(),
        panels: vec![BarPanel {
            axis: AxisSpec::linear("Change from rest / %"),
            baseline: 0.0,
            reference: None,
            groups: vec![BarGroup {
                heading: String::new(),
                rows,
            }],
            note_heading: String::new(),
        }],
        width_px: 900,
    }
}
