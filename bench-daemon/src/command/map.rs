//! `eis-bench map`: resistances over state of charge and temperature, from logs and spectra of a cell.

mod args;
mod next;
mod print;
mod read;

pub use args::MapArgs;

use crate::command::printed::say_json;
use analysis::map::{Fitted, MapFit, MapOptions, NextPlan, fit_map};
use bench_core::{operator::progress::Waiting, safety::failure::Failure};
use bench_evaluate::investigate::cell_map::files;
use bench_plan::support::terminal::say;
use serde::Serialize;

pub(in crate::command) use print::print as print_fit;

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
    let wanted = next::read(&args.next, &args.data)?;
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
        files::write(folder, &name, &curve, &fit)?;
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
    let plan = |wanted| next::plan(&args.next, wanted, fitted);
    let next = wanted.as_ref().map(plan).transpose()?;
    let chosen = wanted.as_ref().zip(next.as_ref());
    let written = chosen.map(|(wanted, plan)| next::write(&args.next, wanted, plan));
    let written = written.transpose()?.flatten();
    if args.json {
        return say_json(&Printed { fit: &fit, next });
    }
    if let Some(plan) = &next {
        next::print(plan);
    }
    if let Some(written) = written {
        say!("written to {written}");
    }
    if let Some(folder) = &args.out {
        say!("written to {}", folder.display());
    }
    Ok(())
}
