//! `eis-bench hppc`: pulse resistances and power over the state of charge.

mod args;
mod columns;
mod commanded;
mod print;
mod read;

use crate::command::printed::say_json;
use analysis::{batch, hppc, plot};

use bench_core::{operator::progress::Waiting, safety::failure::Failure};
use bench_evaluate::files;
use bench_plan::{config::Cell, support::terminal::say};
use read::{Known, Read};

pub use args::HppcArgs;

/// The table of one file, and where its states come from.
struct Table {
    found: hppc::Hppc,
    states: String,
}

/// Makes the tables of logs, prints them, and writes a table and a picture if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a log without pulses; a file that cannot be written.
pub fn hppc(args: &HppcArgs) -> Result<(), Failure> {
    let cell = args.read_cell()?;
    let curve = args.ocv.as_deref().map(files::read_curve).transpose()?;
    let waiting = Waiting::on(format!("reading {} logs", args.files.len()));
    let logs = read::read_all(args)?;
    if args.plot.is_some() && logs.len() > 1 {
        return Err(Failure::Usage(format!(
            "--plot: expected one log, because a picture has one name; found {}",
            logs.len()
        )));
    }
    let known = Known {
        curve: curve.as_ref(),
        cell: cell.as_ref(),
    };
    waiting.say("evaluating pulses");
    let tables: Vec<Table> = logs
        .iter()
        .map(|log| table(args, log, known))
        .collect::<Result<_, _>>()?;
    waiting.end();
    if let Some(path) = &args.out {
        let all: Vec<&hppc::Hppc> = tables.iter().map(|table| &table.found).collect();
        batch::write_table(path, &columns::columns(&all))
            .map_err(|error| Failure::Usage(error.to_string()))?;
    }
    if let (Some(path), Some(table)) = (&args.plot, tables.first()) {
        plot::chart(&hppc::chart(&table.found), path)
            .map_err(|error| Failure::Usage(format!("--plot: {error}")))?;
    }
    if args.json {
        let all: Vec<&hppc::Hppc> = tables.iter().map(|table| &table.found).collect();
        return say_json(&all);
    }
    for table in &tables {
        print::table(&table.found, &table.states);
    }
    for path in args.out.iter().chain(&args.plot) {
        say!("written: {}", path.display());
    }
    Ok(())
}

fn table(args: &HppcArgs, log: &Read, known: Known<'_>) -> Result<Table, Failure> {
    let charge = read::charge(args, log, known);
    let options = hppc::HppcOptions {
        at_s: args.at.clone(),
        limits: limits_of(args, log, known.cell)?,
        rest_s: args.rest,
        current_gain: args.current_gain,
        start_logged: args.start_logged,
    };
    let source = hppc::Log {
        series: &log.record.series,
        steps: log.record.steps.as_deref(),
        charge: charge.known,
        counter_ah: charge.counter_ah.as_deref(),
    };
    let mut found =
        hppc::hppc(source, &options).map_err(|error| Failure::Usage(error.to_string()))?;
    let head_degc = log
        .record
        .state
        .head
        .temperature_degc
        .map(|fact| fact.value);
    for pulse in &mut found.pulses {
        pulse.state.temperature_degc = pulse.state.temperature_degc.or(head_degc);
    }
    Ok(Table {
        found,
        states: charge.words,
    })
}

/// The voltage limits of a log: the options, else the file of the cell, else the cell of the run.
///
/// # Errors
/// A limit that is not known.
fn limits_of(
    args: &HppcArgs,
    log: &Read,
    cell: Option<&Cell>,
) -> Result<Option<hppc::Limits>, Failure> {
    if args.no_power {
        return Ok(None);
    }
    let cell = cell.or(log.cell.as_ref()).map(|cell| cell.limits);
    let min_v = args.v_min.or(cell.map(|limits| limits.min_v.value()));
    let max_v = args.v_max.or(cell.map(|limits| limits.max_v.value()));
    match (min_v, max_v) {
        (Some(min_v), Some(max_v)) => Ok(Some(hppc::Limits { min_v, max_v })),
        _ => Err(Failure::Usage(format!(
            "{}: expected the voltage limits of the cell for its power, by --v-min and --v-max or by \
             --cell FILE; found {}; --no-power leaves the power out",
            log.name,
            match (min_v, max_v) {
                (Some(_), None) => "no --v-max",
                (None, Some(_)) => "no --v-min",
                _ => "neither",
            }
        ))),
    }
}
