//! `eis-bench ocv`: the open-circuit voltage of a slow discharge.

use crate::command::printed::say_json;
use crate::command::units;
use bench_core::safety::failure::Failure;
use bench_evaluate::{
    figures::ocv::{picture, write},
    files,
};
use bench_plan::config::quantity::{Resistance, Voltage};
use bench_plan::{
    config::quantity::{Duration, Quantity},
    support::terminal::{remark, say},
};
use std::path::{Path, PathBuf};

use analysis::{
    formats::{CurrentSign, SeriesOptions, read_record},
    ocv::{OcvExtraction, OcvOptions, compensated, extract},
    series::TimeSeries,
};

/// Arguments of `ocv`.
#[derive(Debug, clap::Args)]
pub struct OcvArgs {
    /// A slow discharge: the thesis' cycler CSV, BDF (CSV or Parquet), the bench's own series.
    #[arg(value_name = "FILE")]
    pub discharge: PathBuf,
    /// Start of the discharge in a longer record, by its own time, such as "2 h" or "900 s".
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub from: Option<f64>,
    /// End of the discharge, such as "10 h".
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub to: Option<f64>,
    /// A charge (may be the same file); also prints half the difference of both directions.
    #[arg(long, value_name = "FILE")]
    pub charge: Option<PathBuf>,
    /// Start of the charge in its record.
    #[arg(long, value_name = "TIME", value_parser = duration, requires = "charge")]
    pub charge_from: Option<f64>,
    /// End of the charge.
    #[arg(long, value_name = "TIME", value_parser = duration, requires = "charge")]
    pub charge_to: Option<f64>,
    /// Use the mean of both directions as the curve, for a cell with hysteresis.
    #[arg(long, requires = "charge")]
    pub mean: bool,
    /// Resistance for the compensation of the voltage drop under load, Ω.
    #[arg(long, default_value_t = 0.015, value_name = "OHM", value_parser = units::of::<Resistance>)]
    pub dcir_ohm: f64,
    /// Lower voltage limit of the cell, V.
    #[arg(long, default_value_t = 2.5, value_name = "V", value_parser = units::of::<Voltage>)]
    pub low_v: f64,
    /// Upper voltage limit of the cell, V.
    #[arg(long, default_value_t = 4.2, value_name = "V", value_parser = units::of::<Voltage>)]
    pub high_v: f64,
    /// Also fit a polynomial of this order, with its error and its falling ranges.
    #[arg(long, value_name = "ORDER")]
    pub poly: Option<usize>,
    /// Direction of positive current in the files, `discharge` or `charge` [default: from the
    /// voltage and the file's columns]
    #[arg(long, value_name = "DIRECTION")]
    pub positive: Option<CurrentSign>,
    /// Write `ocv.csv`, `ocv.json` and `ocv.svg`/`.png` into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Computes the curve, prints it, and writes it into a folder if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn ocv(args: &OcvArgs) -> Result<(), Failure> {
    let discharge = within(
        &read(&args.discharge, args.positive)?,
        Window {
            from_s: args.from,
            to_s: args.to,
            names: "--from, --to",
        },
    )?;
    let charge = |path: &Path| {
        let whole = read(path, args.positive)?;
        within(
            &whole,
            Window {
                from_s: args.charge_from,
                to_s: args.charge_to,
                names: "--charge-from, --charge-to",
            },
        )
    };
    let charge = args.charge.as_deref().map(charge).transpose()?;
    let limits_v = (args.low_v, args.high_v);
    let options = OcvOptions {
        dcir_ohm: args.dcir_ohm,
        limits_v,
        polynomial: args.poly,
        mean: args.mean,
        ..OcvOptions::default()
    };
    let found = extract(&discharge, charge.as_ref(), &options)
        .map_err(|error| Failure::Usage(error.to_string()))?;
    if let Some(folder) = &args.out {
        let points =
            compensated(&discharge, &options).map_err(|error| Failure::Usage(error.to_string()))?;
        write(folder, &found)?;
        files::write_chart(folder, "ocv", &picture(&discharge.name, &points, &found))?;
    }
    if args.json {
        return say_json(&found);
    }
    print_text(&discharge.name, &found);
    if let Some(folder) = &args.out {
        say!("written to {}", folder.display());
    }
    Ok(())
}

fn duration(text: &str) -> Result<f64, String> {
    Quantity::<Duration>::parse(text).map(|duration| duration.si)
}

/// A part of a record, in the record's own time.
#[derive(Clone, Copy)]
struct Window {
    from_s: Option<f64>,
    to_s: Option<f64>,
    /// Names of the two options.
    names: &'static str,
}

/// The part of a record that a window chooses.
fn within(series: &TimeSeries, window: Window) -> Result<TimeSeries, Failure> {
    let (from, to, names) = (window.from_s, window.to_s, window.names);
    let (from_s, to_s) = (
        from.unwrap_or(f64::NEG_INFINITY),
        to.unwrap_or(f64::INFINITY),
    );
    if from_s >= to_s {
        return Err(Failure::Usage(format!(
            "{names}: expected a window that ends after it begins, found {from_s} s to {to_s} s"
        )));
    }
    let part = series.between(from_s, to_s);
    if part.len() >= 2 {
        return Ok(part);
    }
    let window = match (from, to) {
        (Some(from_s), Some(to_s)) => format!("from {from_s} s to {to_s} s"),
        (Some(from_s), None) => format!("from {from_s} s on"),
        _ => format!("up to {to_s} s"),
    };
    let (first, last) = (
        series.time_s.first().unwrap_or(&0.0),
        series.time_s.last().unwrap_or(&0.0),
    );
    let (name, found) = (&series.name, part.len());
    Err(Failure::Usage(format!(
        "{name}: expected at least 2 samples {window}, found {found}: its times go from {first} s \
        to {last} s"
    )))
}

/// Reads a time series that an argument names, and reports how it was read.
pub(super) fn read(path: &Path, sign: Option<CurrentSign>) -> Result<TimeSeries, Failure> {
    let read = read_record(path, &SeriesOptions { sign });
    let read = read.map_err(|error| Failure::Usage(error.to_string()))?;
    for note in &read.notes {
        remark!("{note}");
    }
    Ok(read.series)
}

fn print_text(name: &str, found: &OcvExtraction) {
    say!(
        "{name}: {:.4} Ah between {:.3} V and {:.3} V at {:.3} A",
        found.capacity_ah,
        found.span_v.1,
        found.span_v.0,
        found.current_a
    );
    say!(
        "  OCV = V + i·{:.1} mΩ; scatter about the spline {:.2} mV, its own uncertainty {:.2} mV \
        ({:.0} free parameters)",
        1e3 * found.dcir_ohm,
        1e3 * found.noise_v,
        1e3 * found.sigma_v,
        found.effective_parameters
    );
    say!("  {:>5}  {:>7}  {:>9}", "SOC", "OCV / V", "slope / V");
    for k in 0..=10 {
        let soc = 0.1 * f64::from(k);
        let (ocv_v, slope_v) = found.curve.at(soc);
        say!("  {soc:>5.2}  {ocv_v:>7.4}  {slope_v:>9.3}");
    }
    if let Some(p) = &found.polynomial {
        let (rms, max) = (1e3 * p.rms_v, 1e3 * p.max_v);
        say!(
            "  polynomial of order {}: rms error {rms:.2} mV, largest {max:.1} mV at SOC {:.3}",
            p.order,
            p.max_at_soc
        );
        say!("  {}", p.statement());
    }
    if let Some(h) = &found.charge {
        say!(
            "  charge at {:.2} A: half the difference to the discharge is {:.1} mV (median over \
            SOC {:.2}–{:.2}), at most {:.1} mV at SOC {:.2}",
            h.current_a,
            1e3 * h.median_v,
            h.soc.0,
            h.soc.1,
            1e3 * h.max_v,
            h.max_at_soc
        );
    }
    for warning in &found.warnings {
        say!("  note: {warning}");
    }
}
