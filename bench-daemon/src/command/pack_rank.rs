//! `eis-bench pack rank`: which cell, and how many in series and parallel.

use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

use analysis::{
    pack::{CellKind, PowerLimit, RankedPack, Requirements, rank_packs},
    table::{Hash, Table},
};
use bench_core::safety::failure::Failure;
use bench_plan::{
    config::quantity::{Power, Resistance, Voltage},
    support::terminal::say,
};
use clap::Args;

use super::{printed::say_json, units};

const HELP: &str = "\
CELLS is a table of comma-separated values with a header. Columns:
  cell             name
  capacity_ah      capacity, Ah
  ocv_v            open-circuit voltage at which packs are compared, V
  dcir_ohm         DC resistance, Ω
  mass_kg          mass, kg
  v_min, v_max     lowest and highest voltage, V
  discharge_max_a  largest discharge current, A; an empty field or no such column: no limit

Every cell is taken in every size, as an ideal source behind its DC resistance (see `pack size`).
Packs that meet all requirements come first: with --power-w the lightest first, otherwise the \
strongest.

Example:
  eis-bench pack rank CELLS.csv --series 14..18 --parallel 2..4 --power-w 5000 --bus-v 40,68";

/// Arguments of `pack rank`.
#[derive(Debug, Args)]
#[command(after_help = HELP)]
pub struct RankArgs {
    /// The table of cells.
    #[arg(value_name = "CELLS")]
    pub cells: PathBuf,
    /// Cells in series: a number, or the first and the last one, such as 14..18.
    #[arg(long, value_name = "FROM..TO", value_parser = counts)]
    pub series: RangeInclusive<u32>,
    /// Cells in parallel, in the same form.
    #[arg(long, value_name = "FROM..TO", value_parser = counts)]
    pub parallel: RangeInclusive<u32>,
    /// Resistance of busbars, wires and connectors over the whole pack, Ω.
    #[arg(long, value_name = "OHM", default_value_t = 0.0, value_parser = units::of::<Resistance>)]
    pub interconnect_ohm: f64,
    /// Power that the pack must deliver, W.
    #[arg(long, value_name = "W", value_parser = units::of::<Power>)]
    pub power_w: Option<f64>,
    /// Largest mass of all cells, kg.
    #[arg(long, value_name = "KG")]
    pub cells_kg: Option<f64>,
    /// Lowest and highest voltage of the bus, V: the load works within them.
    #[arg(
        long,
        value_name = "LOW,HIGH",
        value_delimiter = ',',
        value_parser = units::of::<Voltage>
    )]
    pub bus_v: Option<Vec<f64>>,
    /// Number of packs that are printed.
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub rows: usize,
    /// Print all packs as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Reads a number, or the first and the last one.
fn counts(text: &str) -> Result<RangeInclusive<u32>, String> {
    let (from, to) = text.split_once("..").unwrap_or((text, text));
    match (from.trim().parse(), to.trim().parse()) {
        (Ok(from), Ok(to)) if 1 <= from && from <= to => Ok(from..=to),
        _ => Err("expected a number from 1, or a range such as 14..18".to_owned()),
    }
}

/// Ranks packs and prints them.
///
/// # Errors
/// A table or an argument that is not as expected.
pub fn rank(args: &RankArgs) -> Result<(), Failure> {
    let cells = read(&args.cells)?;
    let bus_v = match args.bus_v.as_deref() {
        Some([low, high]) if 0.0 <= *low && low < high => Some((*low, *high)),
        Some(_) => {
            let expected = "--bus-v: expected two voltages, the lower one first";
            return Err(Failure::Usage(expected.to_owned()));
        }
        None => None,
    };
    let needs = Requirements {
        interconnect_ohm: args.interconnect_ohm,
        power_w: args.power_w,
        cells_kg: args.cells_kg,
        bus_v,
    };
    let ranked = rank_packs(&cells, args.series.clone(), args.parallel.clone(), &needs)
        .map_err(|error| Failure::Usage(error.to_string()))?;
    if args.json {
        return say_json(&ranked);
    }
    print_text(&ranked, args.rows);
    Ok(())
}

/// Reads the table of cells.
fn read(path: &Path) -> Result<Vec<CellKind>, Failure> {
    let fail = |reason: String| Failure::Usage(format!("{}: {reason}", path.display()));
    let table = Table::read(path, Hash::Comment).map_err(|e| Failure::Usage(e.to_string()))?;
    let column = |name: &str| {
        table.column(name).ok_or_else(|| {
            let found = table.columns.join(", ");
            fail(format!("expected a column {name}, found {found}"))
        })
    };
    let name = column("cell")?;
    let numbers = [
        "capacity_ah",
        "ocv_v",
        "dcir_ohm",
        "mass_kg",
        "v_min",
        "v_max",
    ];
    let columns = numbers.map(|name| column(name).map(|at| (name, at)));
    let columns = columns.into_iter().collect::<Result<Vec<_>, _>>()?;
    let current = table.column("discharge_max_a");
    let mut cells = Vec::with_capacity(table.rows.len());
    for row in &table.rows {
        let number = |(name, at): (&str, usize)| {
            row.number(at).ok_or_else(|| {
                let (line, found) = (row.line, row.field(at));
                fail(format!(
                    "line {line}, column {name}: expected a number, found {found:?}"
                ))
            })
        };
        let found = columns
            .iter()
            .map(|column| number(*column))
            .collect::<Result<Vec<_>, _>>()?;
        let &[capacity_ah, ocv_v, dcir_ohm, mass_kg, low_v, high_v] = found.as_slice() else {
            continue;
        };
        let discharge_max_a = match current.filter(|at| !row.field(*at).is_empty()) {
            Some(at) => number(("discharge_max_a", at))?,
            None => f64::INFINITY,
        };
        cells.push(CellKind {
            name: row.field(name).to_owned(),
            capacity_ah,
            ocv_v,
            dcir_ohm,
            mass_kg,
            window_v: (low_v, high_v),
            discharge_max_a,
        });
    }
    if cells.is_empty() {
        return Err(fail(
            "expected at least one cell, found a header only".to_owned(),
        ));
    }
    Ok(cells)
}

fn print_text(ranked: &[RankedPack], rows: usize) {
    let width = ranked.iter().map(|one| one.cell.chars().count()).max();
    let width = width.unwrap_or(0).max("cell".len());
    say!(
        "{:width$}  {:>8}  {:>6}  {:>6}  {:>6}  {:>6}  {:>7}  {:>9}  {:>9}  limit, unmet",
        "cell",
        "pack",
        "kW",
        "Wh",
        "kg",
        "kW/kg",
        "Wh/kg",
        "margin/V",
        "margin/A"
    );
    let margin = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:+.3}"));
    for one in ranked.iter().take(rows) {
        let limit = match one.limited_by {
            PowerLimit::LowerVoltage => "voltage",
            PowerLimit::TheoreticalMaximum => "half the OCV",
            PowerLimit::Current => "current",
        };
        let words: Vec<&str> = std::iter::once(limit)
            .chain(one.unmet.iter().map(String::as_str))
            .collect();
        say!(
            "{:width$}  {:>8}  {:>6.2}  {:>6.0}  {:>6.2}  {:>6.2}  {:>7.0}  {:>9}  {:>9}  {}",
            one.cell,
            one.pack.name(),
            1.0e-3 * one.peak_power_w,
            one.energy_wh,
            one.cells_kg,
            1.0e-3 * one.power_per_mass(),
            one.energy_wh / one.cells_kg,
            margin(one.margin_v),
            margin(one.margin_a),
            words.join("; ")
        );
    }
    if ranked.len() > rows {
        say!(
            "{} of {} packs; --rows N prints more, --json all",
            rows,
            ranked.len()
        );
    }
}
