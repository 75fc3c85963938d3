//! Reads, draws and writes the table of a pack's cells, for `pack simulate`. Also states which
//! cells the figures of a pack are means of.

use std::{collections::BTreeMap, path::Path};

use analysis::{
    dataset,
    forward::{
        OcvSource,
        pack::{Draws, Outcome, PlacedCell, ScatterSetup, Spread, drawn_cells},
    },
    given::GivenModel,
    model::Erm,
    pack::Pack,
    table,
};
use serde::Serialize;

use super::args::PackSimulateArgs;
use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use bench_plan::support::terminal::say;

/// Returns the packs cell by cell, if given or requested; writes the table if requested.
pub(super) fn packs(
    args: &PackSimulateArgs,
    setup: &ScatterSetup<'_>,
    spread: &Spread,
    draws: Draws,
) -> Result<Option<Vec<Vec<PlacedCell>>>, Failure> {
    let packs = match (&args.cells, &args.export_cells) {
        (Some(path), _) => Table::read(path, setup)?.packs()?,
        (None, Some(_)) => {
            drawn_cells(setup, spread, draws).map_err(|error| Failure::Usage(error.to_string()))?
        }
        (None, None) => return Ok(None),
    };
    if let Some(path) = &args.export_cells {
        let text = written(path, &packs, setup)?;
        dataset::write_atomically(path, text.as_bytes())
            .map_err(|error| Failure::Usage(format!("--export-cells: {error}")))?;
    }
    Ok(Some(packs))
}

/// Names of the factors' columns: r, r1, c1, …, capacity.
fn factor_names(branches: usize) -> Vec<String> {
    let of_branches = (1..=branches).flat_map(|k| [format!("r{k}"), format!("c{k}")]);
    std::iter::once("r".to_owned())
        .chain(of_branches)
        .chain(["capacity".to_owned()])
        .collect()
}

fn factors(cell: &PlacedCell) -> impl Iterator<Item = f64> {
    let of_branches = cell.rk.iter().zip(&cell.ck).flat_map(|(r, c)| [*r, *c]);
    std::iter::once(cell.r)
        .chain(of_branches)
        .chain([cell.capacity])
}

/// Formats the table of packs. Numbers are written so that they parse to equal values.
fn written(
    path: &Path,
    packs: &[Vec<PlacedCell>],
    setup: &ScatterSetup<'_>,
) -> Result<String, Failure> {
    if packs.iter().flatten().any(|cell| cell.erm.is_some()) {
        let reason = "expected cells that are factors of --model, found one with a model of its \
        own: keep the table that names it";
        return Err(Failure::Usage(format!(
            "--export-cells {}: {reason}",
            path.display()
        )));
    }
    let mut text = format!(
        "draw,group,place,name,{},soc\n",
        factor_names(setup.cell.branches.len()).join(",")
    );
    let parallel = setup.pack.parallel as usize;
    for (draw, pack) in packs.iter().enumerate() {
        for (k, cell) in pack.iter().enumerate() {
            let numbers: Vec<String> = factors(cell)
                .chain([cell.soc])
                .map(|number| number.to_string())
                .collect();
            text += &format!(
                "{},{},{},{},{}\n",
                draw + 1,
                k / parallel + 1,
                k % parallel + 1,
                cell.name,
                numbers.join(",")
            );
        }
    }
    Ok(text)
}

/// A parsed table of cells: for each draw, group and place, its cell with its line number.
struct Table<'a> {
    path: &'a Path,
    setup: &'a ScatterSetup<'a>,
    columns: Vec<String>,
    cells: BTreeMap<(usize, u32, u32), PlacedCell>,
}

impl<'a> Table<'a> {
    fn read(path: &'a Path, setup: &'a ScatterSetup<'a>) -> Result<Self, Failure> {
        let read = table::Table::read(path, table::Hash::Row)
            .map_err(|error| Failure::Usage(format!("--cells {error}")))?;
        let mut table = Self {
            path,
            setup,
            columns: read.columns,
            cells: BTreeMap::new(),
        };
        table.check_header(read.header_line)?;
        for row in &read.rows {
            table.add(row)?;
        }
        Ok(table)
    }

    fn fail(&self, place: &str, expected: &str, found: &str) -> Failure {
        Failure::Usage(format!(
            "{}{place}: expected {expected}, found {found}",
            self.path.display()
        ))
    }

    fn check_header(&self, line: usize) -> Result<(), Failure> {
        let factors = factor_names(self.setup.cell.branches.len());
        let known = |name: &String| {
            ["draw", "group", "place", "name", "model", "soc"].contains(&name.as_str())
                || factors.contains(name)
        };
        let once = |name: &String| self.columns.iter().filter(|other| *other == name).count() == 1;
        let has = |name: &str| self.columns.iter().any(|column| column == name);
        if has("group") && has("place") && self.columns.iter().all(|name| known(name) && once(name))
        {
            return Ok(());
        }
        let expected = format!(
            "a header with group, place and any of draw, name, model, {}, soc, each once",
            factors.join(", ")
        );
        Err(self.fail(
            &format!(", line {line}"),
            &expected,
            &format!("{:?}", self.columns.join(",")),
        ))
    }

    fn add(&mut self, row: &table::Row) -> Result<(), Failure> {
        let line = row.line;
        if row.width() != self.columns.len() {
            return Err(self.fail(
                &format!(", line {line}"),
                &format!("{} fields", self.columns.len()),
                &row.width().to_string(),
            ));
        }
        let row = Row { table: self, row };
        let pack = self.setup.pack;
        let (draw, group) = (
            row.number("draw", usize::MAX as u64)?.unwrap_or(1),
            row.number("group", pack.series.into())?.unwrap_or(0),
        );
        let place = row.number("place", pack.parallel.into())?.unwrap_or(0);
        let cell = row.cell(format!("g{group}p{place}"))?;
        let key = (draw as usize, group as u32, place as u32);
        if self.cells.insert(key, cell).is_some() {
            let place = if self.columns.iter().any(|column| column == "draw") {
                format!("draw {draw}, ")
            } else {
                String::new()
            };
            return Err(self.fail(
                &format!(", line {line}"),
                "each place once",
                &format!("{place}group {group}, place {} again", key.2),
            ));
        }
        Ok(())
    }

    /// The packs in the order of their numbers.
    fn packs(self) -> Result<Vec<Vec<PlacedCell>>, Failure> {
        let Pack {
            series, parallel, ..
        } = self.setup.pack;
        let draws: std::collections::BTreeSet<usize> = self.cells.keys().map(|key| key.0).collect();
        let first = draws.first().copied().unwrap_or(1);
        for draw in draws
            .iter()
            .copied()
            .chain(draws.is_empty().then_some(first))
        {
            let mut places =
                (1..=series).flat_map(|group| (1..=parallel).map(move |place| (group, place)));
            if let Some((group, place)) =
                places.find(|(group, place)| !self.cells.contains_key(&(draw, *group, *place)))
            {
                let cells = u64::from(series) * u64::from(parallel);
                let found = self.cells.keys().filter(|key| key.0 == draw).count();
                let of = if draws.len() > 1 {
                    format!(" in draw {draw}")
                } else {
                    String::new()
                };
                let expected = format!("{cells} cells for {}{of}", self.setup.pack.name());
                return Err(self.fail(
                    "",
                    &expected,
                    &format!("{found}: group {group}, place {place} is empty"),
                ));
            }
        }
        let mut packs: BTreeMap<usize, Vec<PlacedCell>> = BTreeMap::new();
        for ((draw, group, _), cell) in self.cells {
            let pack = packs.entry(draw).or_default();
            let beside = if pack.len().is_multiple_of(parallel as usize) {
                None
            } else {
                pack.last()
            };
            if let Some(other) = beside.filter(|other| other.soc != cell.soc) {
                let reason = format!(
                    "expected one state of charge for the cells of group {group}, which rest at \
                    one voltage"
                );
                let file = self.path.display();
                return Err(Failure::Usage(format!(
                    "{file}, soc: {reason}, found {} and {}",
                    other.soc, cell.soc
                )));
            }
            pack.push(cell);
        }
        Ok(packs.into_values().collect())
    }
}

/// One line of the table.
struct Row<'t> {
    table: &'t Table<'t>,
    row: &'t table::Row,
}

impl Row<'_> {
    /// Returns the text in a column, or `None` if it is empty or the column does not exist.
    fn text(&self, column: &str) -> Option<&str> {
        let index = self.table.columns.iter().position(|name| name == column)?;
        Some(self.row.field(index)).filter(|text| !text.is_empty())
    }

    fn fail(&self, column: &str, expected: &str) -> Failure {
        self.table.fail(
            &format!(", line {}, {column}", self.row.line),
            expected,
            &format!("{:?}", self.text(column).unwrap_or_default()),
        )
    }

    fn number(&self, column: &str, most: u64) -> Result<Option<u64>, Failure> {
        if !self.table.columns.iter().any(|name| name == column) {
            return Ok(None);
        }
        let found = self
            .text(column)
            .and_then(|text| text.parse().ok())
            .filter(|number| (1..=most).contains(number));
        found
            .map(Some)
            .ok_or_else(|| self.fail(column, &format!("a number from 1 to {most}")))
    }

    fn factor(&self, column: &str) -> Result<Option<f64>, Failure> {
        let Some(text) = self.text(column) else {
            return Ok(None);
        };
        let factor = text
            .parse()
            .ok()
            .filter(|factor: &f64| factor.is_finite() && *factor > 0.0);
        factor
            .map(Some)
            .ok_or_else(|| self.fail(column, "a factor above 0, or nothing for 1"))
    }

    /// The cell, with a name for the case that the line gives none.
    fn cell(&self, usual_name: String) -> Result<PlacedCell, Failure> {
        let setup = self.table.setup;
        let branches = setup.cell.branches.len();
        let name = self.text("name").map_or(usual_name, str::to_owned);
        let mut cell = PlacedCell::plain(name, branches, setup.soc);
        cell.r = self.factor("r")?.unwrap_or(1.0);
        for k in 0..branches {
            cell.rk[k] = self.factor(&format!("r{}", k + 1))?.unwrap_or(cell.r);
            cell.ck[k] = self.factor(&format!("c{}", k + 1))?.unwrap_or(1.0);
        }
        cell.capacity = self.factor("capacity")?.unwrap_or(1.0);
        if let Some(text) = self.text("soc") {
            let soc = text.parse().ok().filter(|soc: &f64| soc.is_finite());
            cell.soc = soc.ok_or_else(|| {
                self.fail("soc", "a state of charge, or nothing for that of the pack")
            })?;
        }
        if let Some(path) = self.text("model") {
            let (erm, capacity) = self.model(path)?;
            (cell.erm, cell.capacity) = (Some(erm), cell.capacity * capacity);
        }
        Ok(cell)
    }

    /// Returns the model of a cell, and the ratio of its capacity to that of the pack's curve.
    fn model(&self, path: &str) -> Result<(Erm, f64), Failure> {
        let folder = self.table.path.parent().unwrap_or_else(|| Path::new(""));
        let file = files::read_model(&folder.join(path), None)
            .map_err(|error| self.fail("model", &format!("a model file ({error})")))?;
        let setup = self.table.setup;
        let expected = match (setup.map, &file.map) {
            (Some(_), _) => {
                Some("no model of a cell of its own: all cells follow the map of --model")
            }
            (None, Some(_)) => Some("a model of one point, as --model is, not a map"),
            (None, None) => None,
        };
        if let Some(expected) = expected {
            return Err(self.fail("model", expected));
        }
        let erm = cell(&file, setup.ocv, setup.thermal.ambient_degc)?;
        let (expected, met) = (setup.cell.branches.len(), erm.branches.len());
        if met != expected {
            return Err(self.fail(
                "model",
                &format!("a model with {expected} RC branches as --model has, not {met}"),
            ));
        }
        let capacity = match (setup.ocv, &file.ocv) {
            (OcvSource::Curve(of_pack), Some(own)) => own.capacity_ah / of_pack.capacity_ah,
            _ => 1.0,
        };
        Ok((erm, capacity))
    }
}

/// Names of the cells in the lowest group of a draw (from 1): in parallel they share the voltage.
pub(super) fn lowest(
    packs: &[Vec<PlacedCell>],
    draw: Option<usize>,
    worst: &Outcome,
    pack: Pack,
) -> Option<String> {
    let cells = packs.get(draw?.checked_sub(1)?)?;
    let group = cells
        .chunks(pack.parallel as usize)
        .nth(worst.min_cell_group.checked_sub(1)?)?;
    Some(
        group
            .iter()
            .map(|cell| cell.name.as_str())
            .collect::<Vec<_>>()
            .join(", "),
    )
}

/// Population over which figures are averaged: cells, or packs.
#[derive(Debug, Serialize)]
pub(super) struct Means {
    identical: String,
    percentiles: String,
    largest_share: String,
    /// Mean over the cells of a table, of each factor.
    cells: Option<Vec<(String, f64)>>,
}

impl Means {
    pub(super) fn new(
        args: &PackSimulateArgs,
        setup: &ScatterSetup<'_>,
        packs: Option<&[Vec<PlacedCell>]>,
    ) -> Self {
        let Pack {
            series, parallel, ..
        } = setup.pack;
        let cells = u64::from(series) * u64::from(parallel);
        let table = packs.filter(|_| args.cells.is_some()).map(|packs| {
            let count = packs.iter().map(Vec::len).sum::<usize>() as f64;
            let mean = |k: usize| {
                packs
                    .iter()
                    .flatten()
                    .filter_map(|cell| factors(cell).nth(k))
                    .sum::<f64>()
                    / count
            };
            factor_names(setup.cell.branches.len())
                .into_iter()
                .enumerate()
                .map(|(k, name)| (name, mean(k)))
                .collect()
        });
        Self {
            identical: format!(
                "a pack of {cells} cells as --model has them; no mean over the cells or packs \
                below it"
            ),
            percentiles: "over the packs, of the figure that each pack has".to_owned(),
            largest_share: format!(
                "over the current of the pack divided by its {parallel} cells in parallel"
            ),
            cells: table,
        }
    }

    pub(super) fn print(&self) {
        say!("  identical: {}", self.identical);
        say!("  median, 5 %, 95 %: {}", self.percentiles);
        say!("  part of the mean: {}", self.largest_share);
        if let Some(cells) = &self.cells {
            let means: Vec<String> = cells
                .iter()
                .map(|(name, mean)| format!("{name} {mean:.5}"))
                .collect();
            say!("  mean over the table's cells: {}", means.join(", "));
        }
    }
}

/// Wiring of a single cell.
pub(super) const SINGLE: Pack = Pack {
    series: 1,
    parallel: 1,
    interconnect_ohm: 0.0,
};

/// The cell as an ERM; that of a map is one point of it. Cells that scatter are linear: what no
/// branch stands for is refused.
pub(super) fn cell(file: &GivenModel, ocv: &OcvSource, ambient_degc: f64) -> Result<Erm, Failure> {
    let model = files::sim_model(file, ocv.clone(), SINGLE, ambient_degc)?;
    match model.laws() {
        None => Ok(model.erm),
        Some(names) => Err(Failure::Usage(format!(
            "--model: expected additions that linear branches stand for, found {names}; `simulate \
            --series --parallel` takes them, with equal cells"
        ))),
    }
}
