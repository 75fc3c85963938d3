//! File of a campaign over benches, checked.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use analysis::table::{Hash, Row, Table};
use serde::Deserialize;

use bench_plan::{
    config::{ConfigError, Source, schema::Kind},
    plan::Specimen,
    support::confined_path::plain,
};

/// Most cells of a campaign.
const MOST_CELLS: usize = 100_000;
/// Most benches of a campaign.
const MOST_BENCHES: usize = 1000;

/// File of a campaign as it is typed.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    /// Name of the campaign and of its experiments: letters, digits, `-` and `_`.
    name: String,
    /// Path of the experiment that each cell undergoes, from the folder of this file. The plan
    /// writes the bench, seed and `[specimen]` into it.
    experiment: String,
    /// Number of cells, 1 to 100 000, without a table of names. Left out: `table` names them.
    cells: Option<usize>,
    /// Path of a table of the cells, from the folder of this file: CSV with the column `name` and
    /// optionally `serial`, `batch` and `barcode`. Left out: `cells` sets the number.
    table: Option<String>,
    /// Prefix of the names of cells without a table.
    #[serde(default = "cell_prefix")]
    prefix: String,
    /// Number of benches on which each cell is measured, 1 to all of them.
    #[serde(default = "one")]
    benches_per_cell: usize,
    /// Names of cells that every bench measures, to separate differences between benches from
    /// differences between cells. They may be cells of the table.
    #[serde(default)]
    references: Vec<String>,
    /// Number of cells after which a bench measures the references again; with 0 it measures them
    /// only at its beginning and end.
    #[serde(default)]
    reference_every: usize,
    /// Seed of the order of the cells, and of the runs.
    #[serde(default)]
    seed: u64,
    /// The benches, one to 1000.
    benches: Vec<RawBench>,
}

/// A bench of a campaign.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBench {
    /// Name of the bench; in a fleet preceded by its site: `SITE/BENCH`. The names must differ in
    /// more than the site.
    name: String,
    /// Path of the bench file, from the folder of this file. Left out: only a fleet knows the
    /// bench, and no experiment is written for it.
    file: Option<String>,
}

fn cell_prefix() -> String {
    "cell".to_owned()
}

fn one() -> usize {
    1
}

/// A cell that is to be measured.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
pub struct CellOfCampaign {
    /// Its name.
    pub name: String,
    /// Its serial number.
    pub serial: Option<String>,
    /// Its batch.
    pub batch: Option<String>,
    /// Code that is printed on it.
    pub barcode: Option<String>,
}

/// A bench of a campaign, resolved.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BenchOfCampaign {
    /// Its name.
    pub name: String,
    /// Its file, if available.
    pub file: Option<PathBuf>,
}

impl BenchOfCampaign {
    /// Its name without the site: what the runs of it know.
    pub fn own_name(&self) -> &str {
        own_name(&self.name)
    }
}

fn own_name(name: &str) -> &str {
    name.rsplit_once('/').map_or(name, |(_, own)| own)
}

/// File of a campaign, checked.
#[derive(Debug)]
pub struct CampaignFile {
    /// Its name.
    pub name: String,
    /// The experiment of each cell, as it was read.
    pub experiment: Source,
    /// The cells that count.
    pub cells: Vec<CellOfCampaign>,
    /// The cells that every bench measures.
    pub references: Vec<CellOfCampaign>,
    /// Number of cells between two turns of the references; 0 for none in between.
    pub reference_every: usize,
    /// Number of benches for each cell.
    pub benches_per_cell: usize,
    /// The benches.
    pub benches: Vec<BenchOfCampaign>,
    /// Seed of the order and of the runs.
    pub seed: u64,
}

impl CampaignFile {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// The first mistake, with file, line and field.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let source = Source::read(path)?;
        let raw: Raw = source.parse_as(Kind::Campaign)?;
        let is_word = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if raw.name.is_empty() || !raw.name.chars().all(is_word) {
            let reason = format!(
                "expected a name of letters, digits, `-` and `_`, found {:?}",
                raw.name
            );
            return Err(source.complain("name", reason));
        }
        let benches = benches(&source, &raw)?;
        if !(1..=benches.len()).contains(&raw.benches_per_cell) {
            let reason = format!(
                "expected 1 to {}, the number of benches, found {}",
                benches.len(),
                raw.benches_per_cell
            );
            return Err(source.complain("benches_per_cell", reason));
        }
        let all = cells(&source, &raw)?;
        let (references, cells) = references(&source, &raw, all)?;
        let experiment = Source::read(&source.relative(&raw.experiment))
            .map_err(|error| source.complain("experiment", error.to_string()))?;
        Ok(Self {
            name: raw.name,
            experiment,
            cells,
            references,
            reference_every: raw.reference_every,
            benches_per_cell: raw.benches_per_cell,
            benches,
            seed: raw.seed,
        })
    }
}

fn benches(source: &Source, raw: &Raw) -> Result<Vec<BenchOfCampaign>, ConfigError> {
    if !(1..=MOST_BENCHES).contains(&raw.benches.len()) {
        let reason = format!(
            "expected 1 to {MOST_BENCHES} benches, found {}",
            raw.benches.len()
        );
        return Err(source.complain("benches", reason));
    }
    let mut known = BTreeSet::new();
    for bench in &raw.benches {
        let name = &bench.name;
        if !(1..=2).contains(&name.split('/').count()) || !name.split('/').all(plain) {
            let reason = format!(
                "expected BENCH or SITE/BENCH, of letters, digits, `-` and `_`, found {name:?}"
            );
            return Err(source.complain("benches.name", reason));
        }
        // A run does not record the site: the report could not distinguish two benches of one
        // name.
        let own = own_name(name);
        if !known.insert(own) {
            let reason =
                format!("expected names that differ, without their sites, found {own:?} twice");
            return Err(source.complain("benches.name", reason));
        }
    }
    Ok(raw
        .benches
        .iter()
        .map(|bench| BenchOfCampaign {
            name: bench.name.clone(),
            file: bench.file.as_ref().map(|file| source.relative(file)),
        })
        .collect())
}

fn cells(source: &Source, raw: &Raw) -> Result<Vec<CellOfCampaign>, ConfigError> {
    let cells = match (raw.cells, &raw.table) {
        (Some(number), None) if number <= MOST_CELLS => (1..=number)
            .map(|at| CellOfCampaign {
                name: format!("{}-{at:04}", raw.prefix),
                ..CellOfCampaign::default()
            })
            .collect(),
        (Some(number), None) => {
            let reason = format!("expected 1 to {MOST_CELLS} cells, found {number}");
            return Err(source.complain("cells", reason));
        }
        (None, Some(path)) => table(source, &source.relative(path))?,
        _ => {
            let reason = "expected either `cells`, their number, or `table`, a file of them";
            return Err(source.complain("cells", reason));
        }
    };
    if !(1..=MOST_CELLS).contains(&cells.len()) {
        let reason = format!("expected 1 to {MOST_CELLS} cells, found {}", cells.len());
        return Err(source.complain("cells", reason));
    }
    let mut known = BTreeSet::new();
    for cell in &cells {
        if !Specimen::is_name(&cell.name) {
            let reason = format!(
                "expected names of letters, digits and `-`, found {:?}",
                cell.name
            );
            return Err(source.complain("cells", reason));
        }
        if !known.insert(cell.name.to_ascii_lowercase()) {
            let reason = format!("expected names that differ, found {:?} twice", cell.name);
            return Err(source.complain("cells", reason));
        }
    }
    Ok(cells)
}

/// Reads a table of cells, whose first line names the columns.
fn table(source: &Source, path: &Path) -> Result<Vec<CellOfCampaign>, ConfigError> {
    let fail = |reason: String| source.complain("table", format!("{}: {reason}", path.display()));
    let table = Table::read(path, Hash::Row)
        .map_err(|error| source.complain("table", error.to_string()))?;
    let known = ["name", "serial", "batch", "barcode"];
    if let Some(other) = table
        .columns
        .iter()
        .find(|column| !known.contains(&column.as_str()))
    {
        return Err(fail(format!(
            "line {}: expected the columns name, serial, batch and barcode, found {other:?}",
            table.header_line
        )));
    }
    let Some(name) = table.column("name") else {
        return Err(fail(format!(
            "line {}: expected a column `name`, found none",
            table.header_line
        )));
    };
    let cell = |row: &Row| {
        if row.width() != table.columns.len() {
            return Err(fail(format!(
                "line {}: expected {} fields, found {}",
                row.line,
                table.columns.len(),
                row.width()
            )));
        }
        let field = |column: &str| {
            let text = table.column(column).map(|at| row.field(at));
            text.filter(|text| !text.is_empty()).map(str::to_owned)
        };
        Ok(CellOfCampaign {
            name: row.field(name).to_owned(),
            serial: field("serial"),
            batch: field("batch"),
            barcode: field("barcode"),
        })
    };
    table.rows.iter().map(cell).collect()
}

/// The references, and the cells without them.
fn references(
    source: &Source,
    raw: &Raw,
    all: Vec<CellOfCampaign>,
) -> Result<(Vec<CellOfCampaign>, Vec<CellOfCampaign>), ConfigError> {
    let mut known = BTreeSet::new();
    if let Some(twice) = raw.references.iter().find(|name| !known.insert(*name)) {
        let reason = format!("expected names that differ, found {twice:?} twice");
        return Err(source.complain("references", reason));
    }
    let (found, cells): (Vec<_>, Vec<_>) =
        all.into_iter().partition(|cell| known.contains(&cell.name));
    let reference = |name: &String| {
        let of_table = found.iter().find(|cell| cell.name == *name).cloned();
        of_table.unwrap_or_else(|| CellOfCampaign {
            name: name.clone(),
            ..CellOfCampaign::default()
        })
    };
    if let Some(bad) = raw.references.iter().find(|name| !Specimen::is_name(name)) {
        let reason = format!("expected names of letters, digits and `-`, found {bad:?}");
        return Err(source.complain("references", reason));
    }
    Ok((raw.references.iter().map(reference).collect(), cells))
}
