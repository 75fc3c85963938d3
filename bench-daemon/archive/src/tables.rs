//! Rows of a run as Parquet.

use std::collections::BTreeMap;

use analysis_catalog::rows::{RunRows, RunTable};
use analysis_files::batch::{Cells, TableColumn, parquet_bytes};

use crate::{
    ArchiveError,
    layout::{Placed, TABLES_VERSION},
};

/// A table of a run, to be written.
pub(crate) struct TableFile {
    /// Its path in the store.
    pub(crate) path: String,
    /// Its bytes.
    pub(crate) bytes: Vec<u8>,
}

/// Returns the tables of a run in their partitions. A table without rows has no file.
///
/// # Errors
/// The table cannot be created.
pub(crate) fn tables(rows: RunRows, placed: &Placed) -> Result<Vec<TableFile>, ArchiveError> {
    let tables = rows.tables(&placed.run_sha256);
    tables
        .into_iter()
        .map(|table| file(table, placed))
        .collect()
}

fn file(table: RunTable, placed: &Placed) -> Result<TableFile, ArchiveError> {
    let remarks = BTreeMap::from([
        ("eis-bench.table".to_owned(), table.name.to_owned()),
        (
            "eis-bench.schema_version".to_owned(),
            TABLES_VERSION.to_string(),
        ),
    ]);
    let rows = table.rows();
    let head = [
        TableColumn {
            name: "run_sha256",
            cells: Cells::Texts(vec![Some(placed.run_sha256.clone()); rows]),
        },
        TableColumn {
            name: "schema_version",
            cells: Cells::Counts(vec![TABLES_VERSION; rows]),
        },
    ];
    let columns: Vec<TableColumn> = head.into_iter().chain(table.columns).collect();
    Ok(TableFile {
        path: placed.table(table.name),
        bytes: parquet_bytes(&columns, &remarks)?,
    })
}
