//! The picture of one or several profiles: power, voltage with the window, and state of charge if
//! known.

use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use std::path::Path;

use analysis::{
    forward::{CellWindow, OcvSource, SimModel, Trace as Run},
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
};

use super::case::Case;

/// One picture per profile, and for several one over all.
pub(super) fn write(
    folder: &Path,
    cases: &[Case],
    model: &SimModel,
    window: CellWindow,
) -> Result<(), Failure> {
    for case in cases {
        let name = if cases.len() == 1 {
            "simulation".to_owned()
        } else {
            case.profile.name.clone()
        };
        files::write_chart(folder, &name, &one(case, model, window))?;
    }
    if cases.len() > 1 {
        files::write_chart(folder, "profiles", &all(cases, model, window))
    } else {
        Ok(())
    }
}

fn points(run: &Run, y: impl Fn(usize) -> f64) -> Vec<(f64, f64)> {
    run.time_s
        .iter()
        .enumerate()
        .map(|(k, t)| (*t, y(k)))
        .filter(|(_, y)| y.is_finite())
        .collect()
}

fn time_axis() -> AxisSpec {
    AxisSpec::linear("Time / s")
}

fn subtitle(model: &SimModel) -> String {
    let curve = if let OcvSource::Curve(curve) = &model.ocv {
        Some(curve)
    } else {
        None
    };
    let (n, r, dc) = (
        model.erm.branches.len(),
        1e3 * model.erm.r_ohm,
        1e3 * model.erm.dc_resistance_ohm(),
    );
    format!(
        "{}, {n} RC, R {r:.1} mΩ, DC resistance {dc:.1} mΩ, {}",
        model.pack.name(),
        super::case::state_words(curve)
    )
}

fn one(case: &Case, model: &SimModel, window: CellWindow) -> Chart {
    let (full, simple) = (&case.full.trace, &case.simple.trace);
    let line = |label: &str, colour, points| Trace::new(label, colour, TraceStyle::Line, points);
    let power = vec![line("power", 2, points(full, |k| 1e-3 * full.power_w[k]))];
    let mut volts = vec![
        line(
            "simple IR (DC resistance)",
            1,
            points(simple, |k| simple.cell_v[k]),
        ),
        line("transient model", 0, points(full, |k| full.cell_v[k])),
    ];
    if let Some(run) = &case.uncertainty.band {
        let band = Trace::new(
            "95 % of whole runs",
            0,
            TraceStyle::Band,
            points(full, |k| full.cell_v[k]),
        );
        volts.insert(0, band.with_spread(run.half_v.clone()));
    }
    volts.extend(limits(case, window));
    let mut panels = vec![
        Panel::new(time_axis(), AxisSpec::linear("Power / kW"), power),
        Panel::new(time_axis(), AxisSpec::linear("Cell voltage / V"), volts),
    ];
    let soc = points(full, |k| 100.0 * full.soc[k]);
    if !soc.is_empty() {
        panels.push(Panel {
            aspect: 0.2,
            ..Panel::new(
                time_axis(),
                AxisSpec::linear("SOC / %"),
                vec![line("", 3, soc)],
            )
        });
    }
    panels[0].aspect = 0.25;
    Chart::new(
        &format!("{} on {}", case.profile.name, model.pack.name()),
        &subtitle(model),
        panels,
    )
}

fn limits(case: &Case, window: CellWindow) -> Vec<Trace> {
    let times = &case.profile.time_s;
    let (Some(first), Some(last)) = (times.first(), times.last()) else {
        return Vec::new();
    };
    let dashed = |label: &str, v: f64| {
        Trace::new(label, 6, TraceStyle::Dashed, vec![(*first, v), (*last, v)])
    };
    vec![
        dashed("limits of a cell", window.low_v),
        dashed("", window.high_v),
    ]
}

/// A panel of voltages per profile, each over its own time.
fn all(cases: &[Case], model: &SimModel, window: CellWindow) -> Chart {
    // One range for all: the panels share the lowest one's ticks.
    let ends = cases
        .iter()
        .flat_map(|case| [case.profile.time_s.first(), case.profile.time_s.last()])
        .flatten();
    let (first, last) = ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| {
        (a.min(*t), b.max(*t))
    });
    let mut panels = Vec::new();
    for (index, case) in cases.iter().enumerate() {
        let (full, simple) = (&case.full.trace, &case.simple.trace);
        let label = |text: &'static str| if index == 0 { text } else { "" };
        let mut volts = vec![
            Trace::new(
                label("simple IR (DC resistance)"),
                1,
                TraceStyle::Line,
                points(simple, |k| simple.cell_v[k]),
            ),
            Trace::new(
                label("transient model"),
                0,
                TraceStyle::Line,
                points(full, |k| full.cell_v[k]),
            ),
        ];
        volts.extend(limits(case, window).into_iter().map(|t| {
            if index == 0 {
                t
            } else {
                Trace { label: None, ..t }
            }
        }));
        let name = AxisSpec::linear(&format!("{}, V per cell", case.profile.name));
        panels.push(Panel {
            aspect: 0.22,
            ..Panel::new(time_axis().between(first, last), name, volts)
        });
    }
    Chart::new(
        &format!(
            "Cell voltage under {} profiles on {}",
            cases.len(),
            model.pack.name()
        ),
        &subtitle(model),
        panels,
    )
}
