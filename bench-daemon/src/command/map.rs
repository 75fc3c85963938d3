//! `eis-bench map`: resistances over state of charge and temperature, from logs of a cell.

use std::path::{Path, PathBuf};

use crate::command::{printed::say_json, units};
use analysis::{
    formats::{CurrentSign, SeriesOptions, read_record},
    given::{GivenModel, PlainModel},
    map::{LogScore, MapFit, MapLog, MapOptions, fit_map},
    ocv::OcvCurve,
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
    series::Role,
};
use bench_core::{operator::progress::Waiting, safety::failure::Failure};
use bench_evaluate::files::{self, AMBIENT_DEGC};
use bench_plan::{
    config::quantity::Temperature,
    support::terminal::{remark, say},
};

const HELP: &str = "\
Fits V = U(z) + correction − R(z, T)·i − Σ vₖ with branches of fixed time constants whose \
resistances follow state of charge and temperature: for given activation energies one bounded \
least-squares problem without starting values. Between and beyond temperatures, resistances follow \
Arrhenius' law. Fit logs that cover the range of charge, at two or more temperatures; hold one out \
to see the error on data that the fit has not seen. The error of a log is stated above a state of \
charge of 0.1.

Example:
  eis-bench map drive_25C.parquet drive_10C.parquet --held-out us06_25C.parquet --ocv curve.json \
--soc-start 1 --out map";

/// States of charge whose resistances are printed, if the map has them as knots.
const SHOWN_SOC: [f64; 5] = [0.1, 0.2, 0.5, 0.8, 1.0];

/// Arguments of `map`.
#[derive(Debug, clap::Args)]
#[command(after_help = HELP)]
pub struct MapArgs {
    /// Logs to fit: time, current, voltage and temperature, of a cycler or of the bench.
    #[arg(value_name = "LOG", required = true)]
    pub logs: Vec<PathBuf>,
    /// Logs to predict only; may be given several times.
    #[arg(long, value_name = "LOG")]
    pub held_out: Vec<PathBuf>,
    /// The cell's OCV curve from `ocv --out` or a cell file.
    #[arg(long, value_name = "JSON")]
    pub ocv: PathBuf,
    /// Temperature at which the OCV curve was measured, °C.
    #[arg(
        long,
        default_value_t = AMBIENT_DEGC,
        value_name = "DEGC",
        allow_hyphen_values = true,
        value_parser = units::of::<Temperature>
    )]
    pub ocv_temperature_degc: f64,
    /// State of charge at the first sample of every log, 0 to 1 [default: from the OCV curve; the
    /// log must then begin at rest]
    #[arg(long, value_name = "X")]
    pub soc_start: Option<f64>,
    /// Temperature of the cell in logs that have no column for it, °C.
    #[arg(
        long,
        value_name = "DEGC",
        allow_hyphen_values = true,
        value_parser = units::of::<Temperature>
    )]
    pub temperature_degc: Option<f64>,
    /// Time constants of the branches, s, rising, separated by commas.
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = MapOptions::default().time_constants_s)]
    pub time_constants_s: Vec<f64>,
    /// Direction of positive current in the files, `discharge` or `charge` [default: from the
    /// voltage and the file's columns]
    #[arg(long, value_name = "DIRECTION")]
    pub positive: Option<CurrentSign>,
    /// Name of the cell [default: that of the first log's file]
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Write `map.json` (a model for `simulate` and `sop`), `map_logs.csv` and `map.svg`/`.png` into
    /// this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Fits the map, prints what it is worth, and writes it into a folder if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn map(args: &MapArgs) -> Result<(), Failure> {
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
    let curve = files::read_curve(&args.ocv)?;
    if let Some(soc) = args.soc_start.filter(|soc| !(0.0..=1.0).contains(soc)) {
        let reason = format!("--soc-start: expected a fraction from 0 to 1, found {soc}");
        return Err(Failure::Usage(reason));
    }
    let fitted = args.logs.iter().map(|path| (path, Role::Train));
    let predicted = args.held_out.iter().map(|path| (path, Role::HeldOut));
    let count = args.logs.len() + args.held_out.len();
    let waiting = Waiting::on(format!("reading {count} logs"));
    let logs = fitted
        .chain(predicted)
        .map(|(path, role)| read(path, role, args))
        .collect::<Result<Vec<_>, _>>()?;
    let options = MapOptions {
        time_constants_s: args.time_constants_s.clone(),
        ocv_temperature_degc: args.ocv_temperature_degc,
        ..MapOptions::default()
    };
    waiting.say(format!("fitting a map to {count} logs"));
    let fit = fit_map(&logs, &curve, &options).map_err(|error| usage(&error))?;
    waiting.end();
    let stem = args.logs[0].file_stem().unwrap_or_default();
    let name = args
        .name
        .clone()
        .unwrap_or_else(|| stem.to_string_lossy().into_owned());
    if let Some(folder) = &args.out {
        write(folder, &name, &curve, &fit)?;
    }
    if args.json {
        return say_json(&fit);
    }
    print_text(&fit);
    if let Some(folder) = &args.out {
        say!("written to {}", folder.display());
    }
    Ok(())
}

fn read(path: &Path, role: Role, args: &MapArgs) -> Result<MapLog, Failure> {
    let options = SeriesOptions {
        sign: args.positive,
    };
    let read = read_record(path, &options).map_err(|error| Failure::Usage(error.to_string()))?;
    for note in &read.notes {
        remark!("{note}");
    }
    let mut series = read.series;
    series.name = path.display().to_string();
    Ok(MapLog {
        series,
        soc_start: args.soc_start,
        temperature_degc: args.temperature_degc,
        role,
    })
}

/// The map as a model file: the map itself, and its model at half charge for tasks that know one
/// point only.
fn model(name: &str, curve: &OcvCurve, fit: &MapFit) -> GivenModel {
    let map = &fit.map;
    let nearest =
        |a: &&f64, b: &&f64| f64::abs(**a - AMBIENT_DEGC).total_cmp(&f64::abs(**b - AMBIENT_DEGC));
    let degc = map
        .temperature_degc
        .iter()
        .min_by(nearest)
        .copied()
        .unwrap_or(AMBIENT_DEGC);
    PlainModel {
        ocv: Some(curve.clone()),
        map: Some(map.clone()),
        warnings: fit.notes.clone(),
        ..PlainModel::new(name, map.model_at(0.5, degc))
    }
    .into()
}

fn write(folder: &Path, name: &str, curve: &OcvCurve, fit: &MapFit) -> Result<(), Failure> {
    files::make_folder(folder)?;
    let json = model(name, curve, fit).to_json();
    let json = json.map_err(|error| Failure::Analysis(error.to_string()))?;
    files::write_text(folder, "map.json", &json)?;
    let mut table = "log,role,temperature_degc,rms_mv,bias_mv,worst_soc,worst_mv\n".to_owned();
    for score in &fit.logs {
        // A log below the states of charge that count has no error.
        let number = |value: Option<f64>, factor: f64| {
            let known = value.filter(|value| value.is_finite());
            known.map_or_else(String::new, |value| format!("{:.3}", factor * value))
        };
        let (soc, worst_v) = (score.worst.map(|w| w.0), score.worst.map(|w| w.1));
        table.push_str(&format!(
            "{},{},{:.2},{},{},{},{}\n",
            score.name.replace(',', ";"),
            role(score),
            score.temperature_degc,
            number(Some(score.rms_v), 1e3),
            number(Some(score.bias_v), 1e3),
            number(soc, 1.0),
            number(worst_v, 1e3)
        ));
    }
    files::write_text(folder, "map_logs.csv", &table)?;
    files::write_chart(folder, "map", &picture(name, fit))
}

fn role(score: &LogScore) -> &'static str {
    match score.role {
        Role::Train => "fitted",
        Role::HeldOut => "held out",
    }
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

fn print_text(fit: &MapFit) {
    let map = &fit.map;
    say!("{}", headline(&fit.logs));
    say!("");
    say!(
        "  {:>7}  {:>7}  {:>8}  {:>22}  log",
        "rms/mV",
        "bias/mV",
        "T/°C",
        "worst band"
    );
    for score in &fit.logs {
        let worst = score.worst.map_or_else(String::new, |(low, v)| {
            format!("SOC {low:.1}–{:.1}: {:.1} mV", low + 0.1, 1e3 * v)
        });
        say!(
            "  {:>7.1}  {:>7.1}  {:>8.1}  {worst:>22}  {} ({})",
            1e3 * score.rms_v,
            1e3 * score.bias_v,
            score.temperature_degc,
            score.name,
            role(score)
        );
        let outside = score.outside;
        if outside.soc > 0.02 || outside.temperature_k > 2.0 {
            say!(
                "           leaves the measured range by up to {:.2} of charge and {:.1} K",
                outside.soc,
                outside.temperature_k
            );
        }
    }
    say!("");
    say!("  series resistance / mΩ (± standard deviation), and with all branches");
    let shown = |soc: f64| SHOWN_SOC.iter().any(|z| (z - soc).abs() < 1e-9);
    let all = !map.soc.iter().any(|soc| shown(*soc));
    for (j, degc) in map.temperature_degc.iter().enumerate() {
        for (k, soc) in map.soc.iter().enumerate() {
            if !all && !shown(*soc) {
                continue;
            }
            let sigma = map.series.sigma_ohm.get(j).map_or(f64::NAN, |row| row[k]);
            say!(
                "  {degc:>6.1} °C  SOC {soc:.2}  {:>7.2} ± {:.2}  {:>7.2}",
                1e3 * map.series.r_ohm[j][k],
                1e3 * sigma,
                1e3 * map.model_at(*soc, *degc).dc_resistance_ohm()
            );
        }
    }
    let of_branches = map.branches.first().map_or_else(String::new, |branch| {
        let energy = 1e-3 * branch.resistance.activation_j_per_mol;
        format!(", {energy:.1} of the branches")
    });
    say!(
        "  activation energy: {:.1} kJ/mol of the series resistance{of_branches}",
        1e-3 * map.series.activation_j_per_mol
    );
    if let Some(thermal) = map.thermal {
        say!(
            "  heat capacity {:.1} J/K, {:.2} K/W to the surroundings",
            thermal.capacity_j_per_k,
            thermal.resistance_k_per_w
        );
    }
    say!("  residuals are correlated over {:.0} s", fit.correlation_s);
    for note in &fit.notes {
        say!("note: {note}");
    }
}

/// What the map is worth, and where it is weakest.
fn headline(logs: &[LogScore]) -> String {
    let held_out: Vec<&LogScore> = logs.iter().filter(|l| l.role == Role::HeldOut).collect();
    let (chosen, what) = if held_out.is_empty() {
        (logs.iter().collect(), "fitted logs (none was held out)")
    } else {
        (held_out, "held-out logs")
    };
    let rms_v = || {
        chosen
            .iter()
            .map(|l| l.rms_v)
            .filter(|rms_v| rms_v.is_finite())
    };
    let Some(most) = rms_v().max_by(f64::total_cmp) else {
        return format!("error on {what}: none reaches a state of charge above 0.1");
    };
    let least = rms_v().fold(most, f64::min);
    let worst = chosen
        .iter()
        .filter_map(|l| l.worst.map(|(soc, v)| (soc, v, l.temperature_degc)))
        .max_by(|a, b| a.1.total_cmp(&b.1));
    let weakest = worst.map_or_else(String::new, |(soc, v, degc)| {
        format!(
            "; weakest at SOC {soc:.1}–{:.1} and {degc:.0} °C: {:.1} mV",
            soc + 0.1,
            1e3 * v
        )
    });
    format!(
        "error on {what}: {:.1} to {:.1} mV rms{weakest}",
        1e3 * least,
        1e3 * most
    )
}
