//! `eis-bench sop`: the most power that can be held, over duration and state of charge.

use crate::command::units;
use bench_plan::config::quantity::{Current, Temperature, Voltage};
use std::path::{Path, PathBuf};

use analysis::{
    forward::{CellWindow, OcvSource},
    given::GivenModel,
    map::Outside,
    pack::Pack,
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
    sop::{CurrentLimits, LimitedBy, SopEntry, SopGrid, SopOptions, sop_map},
};
use clap::Args;
use serde::Serialize;

use super::model_args::{self, ModelArgs, PackArgs, WindowArgs};
use bench_core::safety::failure::Failure;
use bench_evaluate::files::{self, AMBIENT_DEGC};
use bench_plan::support::terminal::say;

const HELP: &str = "\
State of power: the most constant power that the pack bears for a time, from rest, such that every \
cell stays between --v-min and --v-max from
the first instant to the last and all of the power is available. Positive is discharge. Each value \
is the root of a simulation with the transient
model, to 1e-7 of itself; `IR` beside it is the simple-IR model's, which has the full DC \
resistance from the first instant. The limits hold at
the cells' terminals; `pack size` has them at the pack's, behind the interconnect.

With --ocv-v the voltage at rest stays as it is, which flatters long durations. What a model does \
not know beyond the band of its spectra (for
0.1 Hz, beyond some 2 s) the map does not know either.

Example:
  eis-bench sop --model p45b/model_4rc.json --series 16 --parallel 3 --interconnect-ohm 0.03 \
--ocv-v 3.72 --duration-s 0.1,1,2,10";

/// Curves of a plot at most.
const MOST_CURVES: usize = 5;

/// Arguments of `sop`.
#[derive(Debug, Args)]
#[command(after_help = HELP)]
pub struct SopArgs {
    /// Which model.
    #[command(flatten)]
    pub model: ModelArgs,
    /// The cell's OCV curve from `ocv --out` or a cell file, if the model has none or to replace it.
    #[arg(long, value_name = "JSON")]
    pub ocv: Option<PathBuf>,
    /// The pack.
    #[command(flatten)]
    pub pack: PackArgs,
    /// Durations, s, separated by commas.
    #[arg(long, value_name = "LIST", default_value = "0.1,1,2,10")]
    pub duration_s: String,
    /// States of charge, for a model with an OCV curve or with --ocv: a list with commas, or a
    /// range 0.1..0.9 in steps of 0.1, or 0.1..0.9:0.05.
    #[arg(
        long,
        value_name = "LIST",
        conflicts_with = "ocv_v",
        required_unless_present = "ocv_v"
    )]
    pub soc: Option<String>,
    /// Constant open-circuit voltage of a cell, V, between --v-min and --v-max.
    #[arg(long, value_name = "V", allow_hyphen_values = true, value_parser = units::of::<Voltage>)]
    pub ocv_v: Option<f64>,
    /// Temperature of the surroundings, and of the cells at the start, °C, for a model with a map
    /// [default: 25]
    #[arg(
        long,
        value_name = "DEGC",
        allow_hyphen_values = true,
        value_parser = units::of::<Temperature>
    )]
    pub ambient_degc: Option<f64>,
    /// Limits of a cell.
    #[command(flatten)]
    pub window: WindowArgs,
    /// Largest discharge current of a cell, A [default: no limit]
    #[arg(long, value_name = "A", allow_hyphen_values = true, value_parser = units::of::<Current>)]
    pub max_discharge_a: Option<f64>,
    /// Largest charge current of a cell, A [default: no limit]
    #[arg(long, value_name = "A", allow_hyphen_values = true, value_parser = units::of::<Current>)]
    pub max_charge_a: Option<f64>,
    /// Write sop.json, sop.csv and plots into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Report that `--json` prints.
#[derive(Serialize)]
struct SopReport {
    model: String,
    #[serde(flatten)]
    pack: Pack,
    window: CellWindow,
    max_discharge_a: Option<f64>,
    max_charge_a: Option<f64>,
    map: Vec<SopEntry>,
    /// Notes on how to read the numbers.
    notes: Vec<String>,
}

/// Maps the state of power and prints it.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn sop(args: &SopArgs) -> Result<(), Failure> {
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
    let file = args.model.read(args.ocv.as_deref())?;
    let duration_s = numbers(&args.duration_s)
        .map_err(|error| Failure::Usage(format!("--duration-s: {error}")))?;
    let (ocv, soc) = match (args.ocv_v, &args.soc, &file.ocv) {
        (Some(ocv_v), ..) => (OcvSource::Constant(ocv_v), vec![0.5]),
        (None, Some(text), Some(curve)) => (
            OcvSource::Curve(curve.clone()),
            numbers(text).map_err(|error| Failure::Usage(format!("--soc: {error}")))?,
        ),
        _ => {
            return Err(Failure::Usage(format!(
                "--soc: {} holds no OCV curve; give --ocv-v, or a curve with --ocv",
                args.model.display_name()
            )));
        }
    };
    let pack = args.pack.pack()?;
    let ambient_degc = args.ambient_degc.unwrap_or(AMBIENT_DEGC);
    let model = files::sim_model(&file, ocv, pack, ambient_degc)?;
    let window = args.window.window();
    analysis::pack::check_window(window.low_v..=window.high_v).map_err(|error| usage(&error))?;
    args.ocv_v
        .map_or(Ok(()), |ocv_v| check_ocv(ocv_v, &window, &file))?;
    let currents = CurrentLimits {
        discharge_a: args.max_discharge_a.unwrap_or(f64::INFINITY),
        charge_a: args.max_charge_a.unwrap_or(f64::INFINITY),
    };
    let options = SopOptions {
        window,
        currents,
        ..SopOptions::default()
    };
    let map =
        sop_map(&model, &SopGrid { soc, duration_s }, &options).map_err(|error| usage(&error))?;
    let notes = notes(args, &file, &map);
    let report = SopReport {
        model: file.name,
        pack,
        window,
        max_discharge_a: args.max_discharge_a,
        max_charge_a: args.max_charge_a,
        map,
        notes,
    };
    let json = serde_json::to_string_pretty(&report)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    if let Some(out) = &args.out {
        files::make_folder(out)?;
        files::write_text(out, "sop.json", &format!("{json}\n"))?;
        files::write_text(out, "sop.csv", &csv(&report.map))?;
        draw(out, &report)?;
    }
    if args.json {
        say!("{json}");
        return Ok(());
    }
    print_text(&report);
    if let Some(out) = &args.out {
        say!("written to {}", out.display());
    }
    Ok(())
}

/// Checks that a cell at rest is within its allowed voltages, and on the model's curve, if there
/// is one.
fn check_ocv(ocv_v: f64, window: &CellWindow, file: &GivenModel) -> Result<(), Failure> {
    let within = |(low_v, high_v): (f64, f64), what: &str| {
        let text = || {
            format!(
                "--ocv-v: expected the voltage of a cell at rest, {low_v} to {high_v} V by {what}, \
                found {ocv_v} V"
            )
        };
        if (low_v..=high_v).contains(&ocv_v) {
            Ok(())
        } else {
            Err(Failure::Usage(text()))
        }
    };
    within((window.low_v, window.high_v), "--v-min and --v-max")?;
    let ends = file
        .ocv
        .as_ref()
        .and_then(|curve| Some((*curve.ocv_v.first()?, *curve.ocv_v.last()?)));
    ends.map_or(Ok(()), |ends| within(ends, "the model's OCV curve"))
}

/// Notes without which the result would mislead.
fn notes(args: &SopArgs, file: &GivenModel, map: &[SopEntry]) -> Vec<String> {
    let mut notes = model_args::notes(file);
    let most = |of: fn(&SopEntry) -> f64| map.iter().map(of).fold(0.0, f64::max);
    if let Some(cell) = &file.map {
        let places = map.iter().filter_map(|entry| entry.soc);
        let ambient_degc = args.ambient_degc.unwrap_or(AMBIENT_DEGC);
        let outside = places
            .map(|soc| cell.place(soc, ambient_degc).outside)
            .fold(Outside::default(), Outside::farther);
        if outside.is_outside() {
            notes.push(format!("{outside}; there the resistances are extrapolated"));
        }
        notes.extend(cell.current_remark(most(|e| e.discharge_cell_a.max(e.charge_cell_a))));
    }
    let places: Vec<f64> = map.iter().filter_map(|entry| entry.soc).collect();
    notes.extend(file.away_note(&places, args.ambient_degc.as_slice()));
    if args.max_discharge_a.is_none() || args.max_charge_a.is_none() {
        notes.push(format!(
            "only voltages limit where no current was given: up to {:.0} A out of and {:.0} A into \
            a cell; see its data sheet",
            most(|e| e.discharge_cell_a),
            most(|e| e.charge_cell_a)
        ));
    }
    notes
}

/// Numbers with commas, or a range `from..to`, also with a step behind a colon.
fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let number = |text: &str| {
        text.trim()
            .parse::<f64>()
            .ok()
            .filter(|v| v.is_finite())
            .ok_or_else(|| format!("expected a number, found {text:?}"))
    };
    let Some((from, rest)) = text.split_once("..") else {
        return text.split(',').map(number).collect();
    };
    let (to, step) = rest.split_once(':').unwrap_or((rest, "0.1"));
    let (from, to, step) = (number(from)?, number(to)?, number(step)?);
    let count = (to - from) / step;
    if !(step > 0.0 && (0.0..1000.0).contains(&count)) {
        return Err(format!(
            "expected a rising range of at most 1000 values, found {text:?}"
        ));
    }
    // Rounded, for 0.1 + 2·0.1 is not 0.3.
    Ok((0..=(count + 1e-9) as u32)
        .map(|k| ((from + step * f64::from(k)) * 1e9).round() / 1e9)
        .collect())
}

fn print_text(r: &SopReport) {
    say!(
        "{}, {} to {} V per cell; most power that can be held, W (IR: simple-IR model)",
        r.pack.name(),
        r.window.low_v,
        r.window.high_v
    );
    let header = ["discharge", "IR", "A/cell", "charge", "IR", "A/cell"]
        .map(|name| format!(" {name:>10}"))
        .concat();
    say!(
        "  {:>5}{:>9} {:>8}{header}  limited by",
        "SOC",
        "OCV / V",
        "for / s"
    );
    for e in &r.map {
        let soc = e
            .soc
            .map_or_else(|| "–".to_owned(), |soc| format!("{soc:.2}"));
        let discharge = [e.discharge_w, e.simple_ir_discharge_w, e.discharge_cell_a];
        let numbers =
            discharge
                .into_iter()
                .chain([e.charge_w, e.simple_ir_charge_w, e.charge_cell_a]);
        let numbers: String = numbers.map(tenths).collect();
        let limits = (label(e.limited_by.discharge), label(e.limited_by.charge));
        say!(
            "  {soc:>5}{:>9.3} {:>8}{numbers}  {}, {}",
            e.ocv_v,
            e.duration_s,
            limits.0,
            limits.1
        );
    }
    for note in &r.notes {
        say!("  note: {note}");
    }
}

/// A column, apart from the one before however large the number; zero has no sign.
fn tenths(number: f64) -> String {
    let rounded = if number.abs() < 0.05 { 0.0 } else { number };
    format!(" {rounded:>10.1}")
}

fn label(by: LimitedBy) -> &'static str {
    match by {
        LimitedBy::LowerVoltage => "lower voltage",
        LimitedBy::UpperVoltage => "upper voltage",
        LimitedBy::TheoreticalMaximum => "theoretical maximum",
        LimitedBy::Current => "current",
        LimitedBy::OutsideWindow => "outside the window",
    }
}

fn csv(map: &[SopEntry]) -> String {
    let columns = "soc,ocv_v,duration_s,discharge_w,charge_w,discharge_cell_a,charge_cell_a,\
                   simple_ir_discharge_w,simple_ir_charge_w";
    let mut text = format!("{columns},discharge_limited_by,charge_limited_by\n");
    for e in map {
        let soc = e.soc.map_or_else(String::new, |soc| soc.to_string());
        let powers = [
            e.ocv_v,
            e.duration_s,
            e.discharge_w,
            e.charge_w,
            e.discharge_cell_a,
            e.charge_cell_a,
        ];
        let numbers = powers
            .into_iter()
            .chain([e.simple_ir_discharge_w, e.simple_ir_charge_w]);
        let numbers: Vec<String> = numbers.map(|number| number.to_string()).collect();
        let limits = (label(e.limited_by.discharge), label(e.limited_by.charge));
        text += &format!("{soc},{},{},{}\n", numbers.join(","), limits.0, limits.1);
    }
    text
}

fn draw(out: &Path, r: &SopReport) -> Result<(), Failure> {
    let mut places: Vec<(Option<f64>, f64)> = Vec::new();
    for e in &r.map {
        if places.last() != Some(&(e.soc, e.ocv_v)) {
            places.push((e.soc, e.ocv_v));
        }
    }
    let shown = places.len().min(MOST_CURVES);
    let chosen: Vec<(Option<f64>, f64)> = (0..shown)
        .filter_map(|k| {
            places
                .get(if shown > 1 {
                    k * (places.len() - 1) / (shown - 1)
                } else {
                    0
                })
                .copied()
        })
        .collect();
    let panel = |name: &str, labelled: bool, of: fn(&SopEntry) -> (f64, f64)| {
        let mut traces = Vec::new();
        for (colour, place) in chosen.iter().enumerate() {
            let entries: Vec<&SopEntry> = r
                .map
                .iter()
                .filter(|e| (e.soc, e.ocv_v) == *place)
                .collect();
            let label = place
                .0
                .map_or_else(|| format!("OCV {} V", place.1), |soc| format!("SOC {soc}"));
            let line = |ir: bool| {
                entries
                    .iter()
                    .map(|e| (e.duration_s, 1e-3 * if ir { of(e).1 } else { of(e).0 }))
                    .collect::<Vec<_>>()
            };
            traces.push(Trace::new(
                if labelled { &label } else { "" },
                colour,
                TraceStyle::Line,
                line(false),
            ));
            traces.push(Trace::new("", colour, TraceStyle::Points, line(false)));
            let label = if labelled && colour + 1 == chosen.len() {
                "simple-IR model"
            } else {
                ""
            };
            traces.push(Trace::new(label, colour, TraceStyle::Dashed, line(true)));
        }
        Panel {
            aspect: 0.36,
            ..Panel::new(
                AxisSpec::logarithmic("Held for / s"),
                AxisSpec::linear(name),
                traces,
            )
        }
    };
    let panels = vec![
        panel("Discharge / kW", true, |e| {
            (e.discharge_w, e.simple_ir_discharge_w)
        }),
        panel("Charge / kW", false, |e| (e.charge_w, e.simple_ir_charge_w)),
    ];
    let subtitle = format!(
        "{} to {} V per cell, from rest; broken lines: simple-IR model",
        r.window.low_v, r.window.high_v
    );
    let picture = Chart::new(
        &format!("{}: state of power", r.pack.name()),
        &subtitle,
        panels,
    );
    files::write_chart(out, "sop", &picture)
}

#[cfg(test)]
mod tests {
    use super::{numbers, tenths};

    #[test]
    fn columns_stay_apart_and_zero_has_no_sign() {
        assert_eq!(tenths(-0.0), "        0.0");
        assert_eq!(tenths(-0.04).trim(), "0.0");
        assert_eq!(tenths(-123_456_789_012.34), " -123456789012.3");
    }

    #[test]
    fn lists_and_ranges() {
        assert_eq!(numbers("0.1, 1,10").unwrap(), [0.1, 1.0, 10.0]);
        assert_eq!(numbers("0.1..0.5").unwrap(), [0.1, 0.2, 0.3, 0.4, 0.5]);
        assert_eq!(numbers("0.1..0.2:0.05").unwrap(), [0.1, 0.15, 0.2]);
        for (text, error) in [
            ("a", "expected a number, found \"a\""),
            (
                "0.9..0.1",
                "expected a rising range of at most 1000 values, found \"0.9..0.1\"",
            ),
            (
                "0..1:0",
                "expected a rising range of at most 1000 values, found \"0..1:0\"",
            ),
        ] {
            assert_eq!(numbers(text).unwrap_err(), error);
        }
    }
}
