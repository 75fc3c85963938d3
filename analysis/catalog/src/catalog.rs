//! The file of a catalogue: opened for questions, or to be written.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use rusqlite::{Connection, OpenFlags};

use crate::{
    error::{CatalogError, sql},
    schema::{APPLICATION, TABLES, VERSION},
};

/// How long a question waits for a scan that writes.
const PATIENCE: Duration = Duration::from_secs(5);
/// Settings of a connection: a bounded cache of 8 MB, and sorting in files beyond it.
const SETTINGS: &str = "PRAGMA cache_size = -8000; PRAGMA temp_store = FILE;";
/// Settings of a writing connection: queries continue beside it, and a crash loses at most the last
/// batch, which the next scan reads again.
const WRITING: &str = "PRAGMA journal_mode = WAL; PRAGMA synchronous = NORMAL; \
    PRAGMA wal_autocheckpoint = 8000;";

/// A catalogue.
#[derive(Debug)]
pub struct Catalog {
    pub(crate) path: PathBuf,
    pub(crate) connection: Connection,
}

/// Owner of a file, read from its header.
struct Head {
    application: i32,
    version: i32,
    /// It has a table.
    used: bool,
}

impl Catalog {
    /// Opens a catalogue for questions; it cannot be written through it.
    ///
    /// # Errors
    /// [`CatalogError`]: no file, one of another program, one of a newer or older version.
    pub fn open(path: &Path) -> Result<Self, CatalogError> {
        if !path.is_file() {
            return Err(CatalogError::Absent { path: path.into() });
        }
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let catalog = Self::connect(path, flags)?;
        let Head {
            application,
            version,
            ..
        } = catalog.head()?;
        catalog.check(application)?;
        catalog.check_newer(version)?;
        if version < VERSION {
            return Err(CatalogError::Older {
                path: path.into(),
                expected: VERSION,
                found: version,
            });
        }
        Ok(catalog)
    }

    /// Opens a catalogue to scan into it, and creates it if it does not exist. A catalogue of an
    /// older version is emptied except for its roots.
    ///
    /// # Errors
    /// [`CatalogError`]: a file of another program or of a newer version.
    pub fn make(path: &Path) -> Result<Self, CatalogError> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE
            | OpenFlags::SQLITE_OPEN_CREATE
            | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let catalog = Self::connect(path, flags)?;
        let head = catalog.head()?;
        if head.used {
            catalog.check(head.application)?;
            catalog.check_newer(head.version)?;
        }
        if head.used && head.version == VERSION {
            catalog.run(WRITING, "prepare it for writing")?;
            return Ok(catalog);
        }
        let roots = if head.used {
            catalog.roots()?
        } else {
            Vec::new()
        };
        drop(catalog);
        Self::remove(path)?;
        let catalog = Self::connect(path, flags)?;
        catalog.run(WRITING, "prepare it for writing")?;
        let marks = format!(
            "BEGIN; PRAGMA application_id = {APPLICATION}; PRAGMA user_version = {VERSION}; \
             {TABLES} COMMIT;"
        );
        catalog.run(&marks, "make its tables")?;
        catalog.remember(&roots)?;
        Ok(catalog)
    }

    /// Returns the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Folders that were scanned into it.
    ///
    /// # Errors
    /// [`CatalogError::Sql`].
    pub fn roots(&self) -> Result<Vec<PathBuf>, CatalogError> {
        let failed = sql(&self.path, "read its roots");
        let mut asked = self
            .connection
            .prepare("SELECT folder FROM root ORDER BY folder")
            .map_err(&failed)?;
        let rows = asked.query_map([], |row| row.get::<_, String>(0));
        let rows = rows.map_err(&failed)?;
        rows.map(|row| row.map(PathBuf::from).map_err(&failed))
            .collect()
    }

    /// Remembers folders that are scanned.
    pub(crate) fn remember(&self, roots: &[PathBuf]) -> Result<(), CatalogError> {
        for root in roots {
            self.connection
                .execute(
                    "INSERT OR IGNORE INTO root VALUES (?1)",
                    [root.to_string_lossy()],
                )
                .map_err(sql(&self.path, "remember its roots"))?;
        }
        Ok(())
    }

    /// Executes statements without an answer.
    pub(crate) fn run(&self, text: &str, action: &'static str) -> Result<(), CatalogError> {
        let done = self.connection.execute_batch(text);
        done.map_err(sql(&self.path, action))
    }

    fn connect(path: &Path, flags: OpenFlags) -> Result<Self, CatalogError> {
        let failed = sql(path, "open it");
        let connection = Connection::open_with_flags(path, flags).map_err(&failed)?;
        connection.busy_timeout(PATIENCE).map_err(&failed)?;
        let catalog = Self {
            path: path.to_path_buf(),
            connection,
        };
        catalog.run(SETTINGS, "open it")?;
        Ok(catalog)
    }

    fn head(&self) -> Result<Head, CatalogError> {
        let number = |text: &str| -> Result<i32, CatalogError> {
            let value = self.connection.query_row(text, [], |row| row.get(0));
            value.map_err(sql(&self.path, "read its head"))
        };
        Ok(Head {
            application: number("PRAGMA application_id")?,
            version: number("PRAGMA user_version")?,
            used: number("SELECT count(*) FROM sqlite_schema")? > 0,
        })
    }

    fn check(&self, application: i32) -> Result<(), CatalogError> {
        if application == APPLICATION {
            return Ok(());
        }
        Err(CatalogError::Foreign {
            path: self.path.clone(),
            expected: APPLICATION,
            found: application,
        })
    }

    fn check_newer(&self, version: i32) -> Result<(), CatalogError> {
        if version <= VERSION {
            return Ok(());
        }
        Err(CatalogError::Newer {
            path: self.path.clone(),
            expected: VERSION,
            found: version,
        })
    }

    /// Removes a catalogue with its journal: it is never the only copy.
    fn remove(path: &Path) -> Result<(), CatalogError> {
        for end in ["", "-wal", "-shm"] {
            let mut file = path.as_os_str().to_owned();
            file.push(end);
            let file = PathBuf::from(file);
            if file.exists() {
                fs::remove_file(&file).map_err(|source| CatalogError::Root {
                    path: file.clone(),
                    source,
                })?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn marked(path: &Path, application: i32, version: i32) {
        let connection = Connection::open(path).unwrap();
        let text = format!(
            "PRAGMA application_id = {application}; PRAGMA user_version = {version}; \
             CREATE TABLE IF NOT EXISTS other (x);"
        );
        connection.execute_batch(&text).unwrap();
    }

    #[test]
    fn a_file_of_another_program_or_version_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.sqlite");
        let open = || Catalog::open(&path).unwrap_err().to_string();
        assert!(open().contains("found no file"));
        marked(&path, 7, 0);
        assert!(
            open().contains("application_id: expected 0x45495343 of a catalogue, found 0x00000007")
        );
        let make = || Catalog::make(&path).unwrap_err().to_string();
        assert!(make().contains("nothing is written into it"));
        marked(&path, APPLICATION, VERSION + 1);
        let newer = format!(
            "user_version: expected at most {VERSION}, found {}",
            VERSION + 1
        );
        assert!(open().contains(&newer) && make().contains(&newer));
        marked(&path, APPLICATION, 0);
        let older = format!("user_version: expected {VERSION}, found 0");
        assert!(open().contains(&older));
    }

    #[test]
    fn an_older_catalogue_is_built_again_and_keeps_its_roots() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.sqlite");
        let made = Catalog::make(&path).unwrap();
        made.remember(&["/a".into()]).unwrap();
        made.run("PRAGMA user_version = 0", "make it older")
            .unwrap();
        drop(made);
        let again = Catalog::make(&path).unwrap();
        assert_eq!(again.roots().unwrap(), [PathBuf::from("/a")]);
        assert_eq!(
            Catalog::open(&path).unwrap().head().unwrap().version,
            VERSION
        );
    }
}
