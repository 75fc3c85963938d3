//! Pictures and tables of measurements other than sweeps: multisines and traces.

use analysis::{
    dataset::{self, TraceEntry, TraceRow},
    multisine::Line,
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle, chart_svg},
    report::{Figure, Table, Verdict},
    run_folder,
    spectrum::ImpedancePoint,
};

use super::operando;
use crate::{
    files,
    run::{Measured, MultisineRun},
    support::present::significant,
};
use bench_core::{
    record::{RecordError, Recorder},
    safety::failure::Failure,
};
use bench_plan::config::Experiment;

/// Pictures, tables and verdicts of a report.
#[derive(Default)]
pub(super) struct Shown {
    pub(super) figures: Vec<Figure>,
    pub(super) tables: Vec<Table>,
    pub(super) verdicts: Vec<Verdict>,
}

/// Draws every multisine and every trace into `plots`.
///
/// # Errors
/// Fails if a trace cannot be read or a picture cannot be drawn.
pub(super) fn write(
    recorder: &Recorder,
    experiment: &Experiment,
    measured: &Measured,
) -> Result<Shown, Failure> {
    let mut shown = Shown::default();
    let along = experiment
        .multisine
        .as_ref()
        .is_some_and(|multisine| multisine.operando);
    if along {
        shown
            .figures
            .extend(operando::write(recorder, experiment, measured)?);
    }
    for (number, run) in (1..)
        .zip(&measured.multisines)
        .filter(|(_, run)| !along && !run.spectrum.points.is_empty())
    {
        let title = if number == 1 {
            "Multisine".to_owned()
        } else {
            format!("Multisine {number}")
        };
        let caption = format!(
            "{title}: magnitude and phase with 2σ, and what each line shows of noise and of \
            nonlinear distortion."
        );
        shown.figures.push(draw(
            recorder,
            &run_folder::multisine_figure(number),
            &multisine_chart(&title, run),
            caption,
        )?);
        shown.tables.push(lines_table(&title, run));
    }
    for trace in &recorder.index().traces {
        let rows =
            dataset::read_trace_csv(&recorder.path(&trace.file)).map_err(RecordError::from)?;
        if rows.is_empty() {
            continue;
        }
        let caption = format!(
            "Trace {}, repeat {}: current (charge positive) and voltage of the cell over time.",
            trace.name, trace.repeat
        );
        shown.figures.push(draw(
            recorder,
            &run_folder::trace_name(&trace.name, trace.repeat),
            &trace_chart(trace, &rows),
            caption,
        )?);
    }
    shown.tables.extend(traces_table(&recorder.index().traces));
    Ok(shown)
}

/// Draws a chart as a file of `plots` and as a figure of the report.
///
/// # Errors
/// Fails if a chart cannot be drawn or a file cannot be written.
pub(super) fn draw(
    recorder: &Recorder,
    file: &str,
    chart: &Chart,
    caption: String,
) -> Result<Figure, Failure> {
    files::write_chart(&recorder.path(run_folder::PLOTS), file, chart)?;
    Ok(Figure {
        svg: chart_svg(chart).map_err(|error| Failure::Analysis(error.to_string()))?,
        caption,
    })
}

fn multisine_chart(title: &str, run: &MultisineRun) -> Chart {
    let freq = || AxisSpec::logarithmic("Frequency / Hz");
    let of = |value: fn(&ImpedancePoint) -> f64| {
        run.spectrum
            .points
            .iter()
            .map(|point| (point.freq_hz, value(point)))
            .collect::<Vec<_>>()
    };
    let spread = |sigma: fn(&ImpedancePoint) -> f64| {
        run.spectrum
            .points
            .iter()
            .map(|point| 2.0 * sigma(point))
            .collect::<Vec<_>>()
    };
    let magnitude = Trace::new(
        "|Z|, 2σ",
        0,
        TraceStyle::Points,
        of(|point| 1.0e3 * point.magnitude_ohm()),
    )
    .with_spread(spread(|point| 1.0e3 * point.magnitude_sigma_ohm()));
    let phase = Trace::new(
        "phase, 2σ",
        1,
        TraceStyle::Points,
        of(|point| point.phase_rad().to_degrees()),
    )
    .with_spread(spread(|point| point.phase_sigma_rad().to_degrees()));
    let share = |label: &str, colour, value: fn(&Line) -> f64| {
        // Zero cannot be shown on a logarithmic axis.
        let points = run
            .lines
            .iter()
            .map(|line| (line.freq_hz, 100.0 * value(line)))
            .filter(|(_, percent)| *percent > 0.0);
        Trace::new(label, colour, TraceStyle::Points, points.collect())
    };
    let shares = vec![
        share("noise", 6, |line| line.noise),
        share("even distortion", 2, |line| line.even),
        share("odd distortion", 3, |line| line.odd),
    ];
    let mut panels = vec![
        Panel::new(freq(), AxisSpec::linear("|Z| / mΩ"), vec![magnitude]),
        Panel {
            aspect: 0.3,
            ..Panel::new(freq(), AxisSpec::linear("Phase / °"), vec![phase])
        },
    ];
    if shares.iter().any(|trace| !trace.points.is_empty()) {
        panels.push(Panel {
            aspect: 0.3,
            ..Panel::new(
                freq(),
                AxisSpec::logarithmic("% of the line's voltage"),
                shares,
            )
        });
    }
    let distorted = run.lines.iter().filter(|line| line.is_distorted()).count();
    let subtitle = format!(
        "{} lines; distortion beyond the noise at {distorted} of them",
        run.lines.len()
    );
    Chart::new(title, &subtitle, panels)
}

fn lines_table(title: &str, run: &MultisineRun) -> Table {
    let percent = |share: f64| significant(100.0 * share, 3);
    let row = |(point, line): (&ImpedancePoint, &Line)| {
        vec![
            significant(point.freq_hz, 6),
            format!(
                "{:.4} ± {:.4}",
                1.0e3 * point.magnitude_ohm(),
                1.0e3 * point.magnitude_sigma_ohm()
            ),
            format!(
                "{:.3} ± {:.3}",
                point.phase_rad().to_degrees(),
                point.phase_sigma_rad().to_degrees()
            ),
            percent(line.noise),
            percent(line.even),
            percent(line.odd),
            if line.is_distorted() {
                "yes"
            } else {
                "none seen"
            }
            .to_owned(),
        ]
    };
    let header = [
        "f / Hz",
        "|Z| / mΩ",
        "phase / °",
        "noise / %",
        "even / %",
        "odd / %",
        "distorted",
    ];
    Table {
        caption: format!(
            "{title}: lines (value ± one standard deviation; noise and distortion of the line's \
            voltage)"
        ),
        header: header.map(str::to_owned).to_vec(),
        rows: run
            .spectrum
            .points
            .iter()
            .zip(&run.lines)
            .map(row)
            .collect(),
    }
}

fn trace_chart(trace: &TraceEntry, rows: &[TraceRow]) -> Chart {
    let time = || AxisSpec::linear("Time / s");
    let over = |value: fn(&TraceRow) -> f64| {
        rows.iter()
            .map(|row| (row.time_s, value(row)))
            .collect::<Vec<_>>()
    };
    let panel = |name: &str, colour, points| {
        Panel::new(
            time(),
            AxisSpec::linear(name),
            vec![Trace::new("", colour, TraceStyle::Line, points)],
        )
    };
    let panels = vec![
        Panel {
            aspect: 0.28,
            ..panel("Current / A", 0, over(|row| row.current_a))
        },
        panel("Voltage / V", 1, over(|row| row.voltage_v)),
    ];
    let subtitle = format!(
        "from {:.4} V at rest, {} steps of the current, {} rows",
        trace.start_ocv_v,
        trace.steps_s.len(),
        rows.len()
    );
    Chart::new(
        &format!("Trace {}, repeat {}", trace.name, trace.repeat),
        &subtitle,
        panels,
    )
}

fn traces_table(traces: &[TraceEntry]) -> Option<Table> {
    let header = [
        "trace",
        "repeat",
        "at rest / V",
        "temperature / °C",
        "steps",
        "noise / mA",
        "noise / mV",
        "file",
    ];
    let row = |trace: &TraceEntry| {
        vec![
            trace.name.clone(),
            trace.repeat.to_string(),
            format!("{:.4}", trace.start_ocv_v),
            trace
                .temperature_degc
                .map_or_else(|| "–".to_owned(), |celsius| format!("{celsius:.2}")),
            trace.steps_s.len().to_string(),
            significant(1.0e3 * trace.sample_sigma_a, 3),
            significant(1.0e3 * trace.sample_sigma_v, 3),
            trace.file.clone(),
        ]
    };
    (!traces.is_empty()).then(|| Table {
        caption: "Traces (noise of one sample, rms)".to_owned(),
        header: header.map(str::to_owned).to_vec(),
        rows: traces.iter().map(row).collect(),
    })
}
