//! The columns of the tables, as the documents list them.

use analysis_catalog::{
    rows::{RunRows, TABLES},
    scan::Beside,
};
use analysis_files::batch::Cells;

use crate::made::{Made, Place, diagnosed};

const BOOK: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/archive.md");

#[test]
fn the_documents_list_every_column_with_its_kind() {
    let place = Place::new();
    let run = diagnosed(&place, &Made::ONE.write(&place), "diagnosis-1");
    let rows = RunRows::read(&run.folder, Beside::default(), &run.diagnoses);
    let text = std::fs::read_to_string(BOOK).unwrap();
    let tables = rows.tables("00");
    assert_eq!(
        tables.iter().map(|table| table.name).collect::<Vec<_>>(),
        TABLES
    );
    for table in tables {
        let head = format!("### `{}`", table.name);
        let (_, section) = text.split_once(&head).unwrap_or_else(|| panic!("{head}"));
        let section = section.split("\n#").next().unwrap();
        let documented: Vec<(&str, &str)> = section.lines().filter_map(row).collect();
        let kind = |cells: &Cells| match cells {
            Cells::Numbers(_) => "number",
            Cells::Counts(_) => "whole number",
            Cells::Texts(_) => "text",
        };
        let columns = table
            .columns
            .iter()
            .map(|column| (column.name, kind(&column.cells)));
        assert_eq!(documented, columns.collect::<Vec<_>>(), "{}", table.name);
    }
}

/// Name and kind in a row such as `| ``r_ohm`` | number | … |`.
fn row(line: &str) -> Option<(&str, &str)> {
    let mut fields = line.strip_prefix("| `")?.split(" | ");
    let name = fields.next()?.strip_suffix('`')?;
    Some((name, fields.next()?))
}
