//! Questions across runs: runs, spectra, fits, diagnoses, cells, and all that is known of one run.

use rusqlite::{Row, ToSql, types::Value};
use serde::Serialize;

pub use crate::question::{Filter, MOST};
use crate::{
    Catalog, CatalogError,
    columns::{DIAGNOSIS_COLUMNS, diagnosis_of, event_of, fit_of, json, run_of, spectrum_of},
    error::sql,
    question::{ALL, Cursor, DIGITS, IS_CODE, KeyKind, Question, RunsQuestion},
    record::{
        CatalogDiagnosis, CatalogEvent, CatalogFit, CatalogParameter, CatalogRun, CatalogSpectrum,
    },
    store::CELL_COLUMNS,
};

/// Runs that an error lists.
const LISTED: usize = 5;
/// Maximum number of runs that counts as few. The rows of this many runs are found and sorted in
/// some milliseconds; above it, at least one row in fifty of 100 000 meets the conditions.
const FEW: usize = 2000;

/// Runs that were found, the latest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RunsFound {
    /// The runs.
    pub runs: Vec<CatalogRun>,
    /// Position of the next part; absent at the end.
    pub after: Option<String>,
}

/// What a person can choose from in a search.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Choices {
    /// Names of all cells.
    pub cells: Vec<String>,
    /// Names of all benches.
    pub benches: Vec<String>,
    /// All tags.
    pub tags: Vec<String>,
}

/// Spectra that were found, the latest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SpectraFound {
    /// The spectra.
    pub spectra: Vec<CatalogSpectrum>,
    /// Position of the next part; absent at the end.
    pub after: Option<String>,
}

/// A cell that runs have measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CellFound {
    /// Its name.
    pub cell: String,
    /// Its serial number, if an experiment states it.
    pub serial: Option<String>,
    /// Number of matching runs with it.
    pub runs: u32,
    /// Start of the first of them, s since 1970.
    pub first_unix_s: f64,
    /// Start of the last of them, s since 1970.
    pub last_unix_s: f64,
    /// Its kind, if it has a name of its own.
    pub model: Option<String>,
    /// Batch that it was made in.
    pub batch: Option<String>,
    /// Barcode on the cell.
    pub barcode: Option<String>,
    /// Maker.
    pub maker: Option<String>,
    /// Chemistry, in words.
    pub chemistry: Option<String>,
    /// Term of a vocabulary, such as BattINFO, for its kind.
    pub term: Option<String>,
}

/// Cells that were found, by name.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CellsFound {
    /// The cells.
    pub cells: Vec<CellFound>,
    /// Position of the next part; absent at the end.
    pub after: Option<String>,
}

/// Everything that is known about a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RunShown {
    /// The run.
    pub run: CatalogRun,
    /// Its instruments, from its manifest.
    pub instruments: serde_json::Value,
    /// Its spectra, in the order of time.
    pub spectra: Vec<CatalogSpectrum>,
    /// Its fits, by file.
    pub fits: Vec<CatalogFit>,
    /// Its events, in the order of time.
    pub events: Vec<CatalogEvent>,
    /// Its diagnoses.
    pub diagnoses: Vec<CatalogDiagnosis>,
}

/// Fits that were found, the latest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct FitsFound {
    /// The fits.
    pub fits: Vec<CatalogFit>,
    /// Position of the next part; absent at the end.
    pub after: Option<String>,
}

/// Diagnoses of runs that were found, those of the latest run first.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct DiagnosesFound {
    /// The diagnoses.
    pub diagnoses: Vec<CatalogDiagnosis>,
    /// Position of the next part; absent at the end.
    pub after: Option<String>,
}

/// A table whose rows belong to a run and a cell.
#[derive(Debug, Clone, Copy)]
struct OfCell {
    table: &'static str,
    /// Its short name.
    of: char,
}

const SPECTRA: OfCell = OfCell {
    table: "spectrum s",
    of: 's',
};
const FITS: OfCell = OfCell {
    table: "fit f",
    of: 'f',
};

/// Fits in the order of time.
const BY_TIME: &str = "ORDER BY f.started_unix_s, f.run, f.file";

/// Diagnoses in the order of their runs and folders.
const BY_FOLDER: &str = "ORDER BY d.run, d.folder";

/// Parameters that a diagnosis of a run names.
pub(crate) struct OfRun {
    pub(crate) run: String,
    pub(crate) parameters: Vec<CatalogParameter>,
}

/// Head of a fit of a single cell.
pub(crate) struct FitHead {
    pub(crate) run: String,
    pub(crate) rc: u32,
    pub(crate) serial: Option<String>,
}

/// The requested cell.
struct Named<'a> {
    /// Its name, if there is one.
    name: Option<String>,
    /// Serial numbers or barcodes that it must have.
    codes: Vec<&'a String>,
}

/// A diagnosis, with the beginning of its run.
struct Diagnosed {
    started_unix_s: f64,
    diagnosis: CatalogDiagnosis,
}

impl Catalog {
    /// Returns the runs that meet every condition, the latest first.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn runs(&self, filter: &Filter) -> Result<RunsFound, CatalogError> {
        let mut asked = RunsQuestion::of(filter);
        asked.question.add_times(asked.of, filter);
        if let Some(after) = &filter.after {
            asked.add_after(Cursor::parse(after)?);
        }
        let RunsQuestion { question, of } = asked;
        let order = format!("ORDER BY {of}.started_unix_s DESC, {of}.run DESC");
        let text = question.text("r.*", &order, filter.most() + 1);
        let mut runs = self.ask(&text, &question.values, run_of)?;
        let after = cut(&mut runs, filter.most(), |run| {
            Cursor::of(run.started_unix_s, &run.run, "")
        });
        Ok(RunsFound { runs, after })
    }

    /// Returns the corrected spectra of cells that meet every condition, the latest first.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn spectra(&self, filter: &Filter) -> Result<SpectraFound, CatalogError> {
        let mut question = self.rows(SPECTRA, filter)?;
        question.add("s.fixture = 'cell' AND s.corrected = 1", &[]);
        let text = latest_first(SPECTRA, &mut question, filter)?;
        let mut spectra = self.ask(&text, &question.values, spectrum_of)?;
        let after = cut(&mut spectra, filter.most(), |one| {
            Cursor::of(one.started_unix_s, &one.run, &one.file)
        });
        Ok(SpectraFound { spectra, after })
    }

    /// Returns the fits that meet every condition, the latest first.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn fits(&self, filter: &Filter) -> Result<FitsFound, CatalogError> {
        let mut question = self.rows(FITS, filter)?;
        let text = latest_first(FITS, &mut question, filter)?;
        let mut fits = self.ask(&text, &question.values, fit_of)?;
        let after = cut(&mut fits, filter.most(), |one| {
            Cursor::of(one.started_unix_s, &one.run, &one.file)
        });
        Ok(FitsFound { fits, after })
    }

    /// Returns every fit that meets the conditions, in the order of time.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn all_fits(&self, filter: &Filter) -> Result<Vec<CatalogFit>, CatalogError> {
        let question = self.rows(FITS, filter)?;
        let text = question.text("f.*", BY_TIME, ALL);
        self.ask(&text, &question.values, fit_of)
    }

    /// Returns the fits of single cells that meet every condition, as far as their choice needs it.
    pub(crate) fn fit_heads(&self, filter: &Filter) -> Result<Vec<FitHead>, CatalogError> {
        let mut question = self.rows(FITS, filter)?;
        question.add("f.cells = 1", &[]);
        let text = question.text("f.run, f.rc, f.serial", "", ALL);
        self.ask(&text, &question.values, |row| {
            Ok(FitHead {
                run: row.get(0)?,
                rc: row.get(1)?,
                serial: row.get(2)?,
            })
        })
    }

    /// Returns the fits of single cells of one number of RC pairs, in the order of time.
    pub(crate) fn single_fits(
        &self,
        filter: &Filter,
        rc: u32,
    ) -> Result<Vec<CatalogFit>, CatalogError> {
        let mut question = self.rows(FITS, filter)?;
        question.add("f.cells = 1 AND f.rc = ?", &[Value::Integer(rc.into())]);
        let text = question.text("f.*", BY_TIME, ALL);
        self.ask(&text, &question.values, fit_of)
    }

    /// Returns the diagnoses of the runs that meet every condition, those of the latest run first.
    /// Diagnoses without an identified run are left out.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn diagnoses(&self, filter: &Filter) -> Result<DiagnosesFound, CatalogError> {
        let mut asked = RunsQuestion::of(filter).into_diagnoses(filter);
        if let Some(after) = &filter.after {
            asked.add_after_file(Cursor::parse(after)?, "d.folder");
        }
        let RunsQuestion { question, of } = asked;
        let order = format!("ORDER BY {of}.started_unix_s DESC, {of}.run DESC, d.folder DESC");
        let select = format!("{DIAGNOSIS_COLUMNS}, {of}.started_unix_s");
        let text = question.text(&select, &order, filter.most() + 1);
        let mut found = self.ask(&text, &question.values, |row| {
            Ok(Diagnosed {
                started_unix_s: row.get("started_unix_s")?,
                diagnosis: diagnosis_of(row)?,
            })
        })?;
        let after = cut(&mut found, filter.most(), |one| {
            let run = one.diagnosis.run.as_deref().unwrap_or_default();
            Cursor::of(one.started_unix_s, run, &one.diagnosis.folder)
        });
        let diagnoses = found.into_iter().map(|one| one.diagnosis).collect();
        Ok(DiagnosesFound { diagnoses, after })
    }

    /// Returns the diagnoses of some runs.
    fn diagnoses_of(&self, runs: &[&str]) -> Result<Vec<CatalogDiagnosis>, CatalogError> {
        let question = of_few("diagnosis d", 'd', Some(runs));
        let text = question.text(DIAGNOSIS_COLUMNS, BY_FOLDER, ALL);
        self.ask(&text, &question.values, diagnosis_of)
    }

    /// Returns the parameters of the effects that diagnoses of some runs name.
    pub(crate) fn parameters_of(&self, runs: &[&str]) -> Result<Vec<OfRun>, CatalogError> {
        let question = of_few("diagnosis d", 'd', Some(runs));
        let text = question.text("d.run, d.parameters", BY_FOLDER, ALL);
        self.ask(&text, &question.values, |row| {
            Ok(OfRun {
                run: row.get("run")?,
                parameters: json(row, "parameters")?,
            })
        })
    }

    /// Returns the cells of the runs that meet every condition, by name and serial number, each
    /// with the number of those runs.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn cells(&self, filter: &Filter) -> Result<CellsFound, CatalogError> {
        // All runs of each cell are counted at the end of a scan.
        let (mut question, columns, group) = match filter.is_empty() {
            true => (Question::of("cell c", &[]), "c.*", ""),
            false => (
                self.cells_of_runs(filter)?,
                CELL_COLUMNS,
                "GROUP BY c.name, c.serial ",
            ),
        };
        if let Some(after) = &filter.after {
            let after = Cursor::parse(after)?;
            let (name, serial) = after.file.split_once('\0').unwrap_or((&after.file, ""));
            let values = [name, serial].map(|text| Value::Text(text.to_owned()));
            question.add("(c.name, c.serial) > (?, ?)", &values);
        }
        let tail = format!("{group}ORDER BY c.name, c.serial");
        let text = question.text(columns, &tail, filter.most() + 1);
        let mut cells = self.ask(&text, &question.values, cell_of)?;
        let after = cut(&mut cells, filter.most(), |cell| {
            let serial = cell.serial.as_deref().unwrap_or_default();
            let place = format!("{}\0{serial}", cell.cell);
            Cursor::of(0.0, &"0".repeat(DIGITS), &place)
        });
        Ok(CellsFound { cells, after })
    }

    /// Returns the cells, benches and tags of all runs, each by name.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn choices(&self) -> Result<Choices, CatalogError> {
        let all = |text| self.ask(text, &[], |row| row.get(0));
        Ok(Choices {
            cells: all("SELECT DISTINCT name FROM cell ORDER BY name")?,
            benches: all("SELECT DISTINCT bench FROM run ORDER BY bench")?,
            tags: all("SELECT DISTINCT t.value FROM run r, json_each(r.tags) t ORDER BY t.value")?,
        })
    }

    /// Creates a query for cells of runs, with every condition but the cursor. If few runs match,
    /// it reads the cells of those runs; otherwise it scans all cells in the order of their names.
    fn cells_of_runs(&self, filter: &Filter) -> Result<Question, CatalogError> {
        let few = match filter.asks_beside_time() {
            true => self.few_runs(filter)?,
            false => None,
        };
        let mut question = of_few("run_cell c", 'c', names(few.as_ref()).as_deref());
        question.add_cell(filter);
        question.add_times('c', filter);
        if few.is_none() {
            question.add_run_of_cell(filter);
        }
        Ok(question)
    }

    /// Returns everything that is known about a run, by its identity, its folder or its name.
    ///
    /// # Errors
    /// [`CatalogError::Run`] for none or several.
    pub fn show(&self, run: &str) -> Result<RunShown, CatalogError> {
        let wanted = std::fs::canonicalize(run).map_or_else(
            |_| run.to_owned(),
            |folder| folder.to_string_lossy().into_owned(),
        );
        let text = format!(
            "SELECT * FROM run WHERE run = ?1 OR folder = ?2 OR name = ?1 \
             ORDER BY started_unix_s DESC, run LIMIT {}",
            LISTED + 1
        );
        let values = [run.to_owned(), wanted].map(Value::Text);
        let mut runs = self.ask(&text, &values, run_of)?;
        if runs.len() != 1 {
            return Err(several(run, &runs));
        }
        let run = runs.remove(0);
        self.shown(run)
    }

    fn shown(&self, run: CatalogRun) -> Result<RunShown, CatalogError> {
        let key = [Value::Text(run.run.clone())];
        let instruments = "SELECT instruments FROM run WHERE run = ?1";
        let instruments = self.ask(instruments, &key, |row| row.get::<_, String>(0))?;
        Ok(RunShown {
            instruments: instruments
                .first()
                .and_then(|text| serde_json::from_str(text).ok())
                .unwrap_or_default(),
            spectra: self.ask(
                "SELECT * FROM spectrum WHERE run = ?1 ORDER BY started_unix_s, file",
                &key,
                spectrum_of,
            )?,
            fits: self.ask(
                "SELECT * FROM fit WHERE run = ?1 ORDER BY file",
                &key,
                fit_of,
            )?,
            events: self.ask(
                "SELECT * FROM event WHERE run = ?1 ORDER BY line",
                &key,
                event_of,
            )?,
            diagnoses: self.diagnoses_of(&[&run.run])?,
            run,
        })
    }

    /// Returns the folders of runs, by their identities, in the same order; `None` for an unknown
    /// run.
    ///
    /// # Errors
    /// [`CatalogError::Sql`].
    pub fn folders(&self, runs: &[&str]) -> Result<Vec<Option<String>>, CatalogError> {
        let text = "SELECT r.folder FROM json_each(?1) w LEFT JOIN run r ON r.run = w.value \
             ORDER BY w.key";
        self.ask(text, &[listed(runs)], |row| row.get(0))
    }

    /// Returns the number of joint fits of several cells whose runs measured the given cell, or
    /// whose cells are of this type.
    ///
    /// # Errors
    /// [`CatalogError::Sql`].
    pub(crate) fn pooled_fits(&self, cell: &str) -> Result<u32, CatalogError> {
        let text = format!(
            "SELECT count(*) FROM fit f INDEXED BY fit_pooled WHERE f.cells > 1 AND (f.cell = ?1 \
             OR f.run IN (SELECT run FROM run_key WHERE kind = {} AND key = ?1))",
            KeyKind::Cell.number()
        );
        let count = self.ask(&text, &[Value::Text(cell.to_owned())], |row| row.get(0))?;
        Ok(count.first().copied().unwrap_or_default())
    }

    /// Creates a query for rows of a run and a cell, with every condition but the cursor. If few
    /// runs meet the run conditions, it reads the rows of these runs. Otherwise it scans rows in
    /// the order of time, many of which then match.
    fn rows(&self, of_cell: OfCell, filter: &Filter) -> Result<Question, CatalogError> {
        let OfCell { table, of } = of_cell;
        let Named { name, codes } = self.named(filter)?;
        let few = match (name.is_none() && !codes.is_empty()) || filter.asks_of_runs() {
            true => self.few_runs(filter)?,
            false => None,
        };
        let mut question = of_few(table, of, names(few.as_ref()).as_deref());
        question.add_text(&format!("{of}.cell = ?"), name.as_ref());
        for code in codes {
            question.add_code(of, code);
        }
        question.add_text(&format!("{of}.batch = ?"), filter.batch.as_ref());
        question.add_text(&format!("{of}.bench = ?"), filter.bench.as_ref());
        question.add_times(of, filter);
        if few.is_none() {
            question.add_run(of, filter);
        }
        Ok(question)
    }

    /// Returns the runs that meet the run conditions, or `None` if they are many. The time is not a
    /// condition here: a spectrum has its own.
    fn few_runs(&self, filter: &Filter) -> Result<Option<Vec<String>>, CatalogError> {
        let RunsQuestion { question, .. } = RunsQuestion::of(filter);
        let text = question.text("r.run", "", FEW + 1);
        let runs = self.ask(&text, &question.values, |row| row.get(0))?;
        Ok(Some(runs).filter(|runs| runs.len() <= FEW))
    }

    /// Resolves the requested cell: the given cell may be a serial number or a barcode.
    fn named<'a>(&self, filter: &'a Filter) -> Result<Named<'a>, CatalogError> {
        let mut codes: Vec<&String> = filter.serial.iter().collect();
        let mut name = None;
        if let Some(cell) = &filter.cell {
            match self.is_code(cell)? {
                true => codes.push(cell),
                false => name = Some(cell.clone()),
            }
        }
        if let (None, Some(code)) = (&name, codes.first()) {
            name = self.name_of(code)?;
        }
        Ok(Named { name, codes })
    }

    /// Returns whether a text that is given as a cell is a serial number or a barcode, and not a
    /// name.
    fn is_code(&self, cell: &str) -> Result<bool, CatalogError> {
        let failed = sql(&self.path, "look for a cell");
        let text = "SELECT NOT EXISTS (SELECT 1 FROM run_cell WHERE name = ?1) \
             AND EXISTS (SELECT 1 FROM run_key WHERE kind = ?2 AND key = ?1)";
        let values = (cell, KeyKind::Cell.number());
        let is_code = self.connection.query_row(text, values, |row| row.get(0));
        is_code.map_err(&failed)
    }

    /// Returns the name of the cells with a serial number or barcode, or `None` if they have
    /// several.
    fn name_of(&self, code: &str) -> Result<Option<String>, CatalogError> {
        let from = "run_key k CROSS JOIN run_cell c ON c.run = k.run";
        let mut question = Question::of(from, &[]);
        let code = Value::Text(code.to_owned());
        let kind = Value::Integer(KeyKind::Cell.number());
        question.add("k.kind = ? AND k.key = ?", &[kind, code.clone()]);
        question.add(IS_CODE, &[code]);
        let text = question.text("DISTINCT c.name", "", 2);
        let mut names = self.ask(&text, &question.values, |row| row.get(0))?;
        Ok(names.pop().filter(|_| names.is_empty()))
    }

    /// Executes a query and reads each row.
    pub(crate) fn ask<T>(
        &self,
        text: &str,
        values: &[Value],
        read: impl Fn(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>, CatalogError> {
        let failed = sql(&self.path, "answer a question");
        let mut asked = self.connection.prepare_cached(text).map_err(&failed)?;
        let values: Vec<&dyn ToSql> = values.iter().map(|value| value as &dyn ToSql).collect();
        let rows = asked.query_map(values.as_slice(), read);
        rows.and_then(Iterator::collect).map_err(&failed)
    }
}

/// Creates a query for the rows of a table, limited to `few` runs if they are given.
fn of_few(table: &str, of: char, few: Option<&[&str]>) -> Question {
    let Some(runs) = few else {
        return Question::of(table, &[]);
    };
    let among = format!("json_each(?) w CROSS JOIN {table} ON {of}.run = w.value");
    Question::of(&among, &[listed(runs)])
}

fn names(runs: Option<&Vec<String>>) -> Option<Vec<&str>> {
    runs.map(|runs| runs.iter().map(String::as_str).collect())
}

/// Runs as one value, which SQLite reads as JSON.
fn listed(runs: &[&str]) -> Value {
    Value::Text(serde_json::json!(runs).to_string())
}

/// Returns the text of a query for rows, the latest first, from its cursor on.
fn latest_first(
    OfCell { of, .. }: OfCell,
    question: &mut Question,
    filter: &Filter,
) -> Result<String, CatalogError> {
    if let Some(after) = &filter.after {
        let condition = format!("({of}.started_unix_s, {of}.run, {of}.file) < (?, ?, ?)");
        question.add(&condition, &Cursor::parse(after)?.values());
    }
    let order = format!("ORDER BY {of}.started_unix_s DESC, {of}.run DESC, {of}.file DESC");
    Ok(question.text(&format!("{of}.*"), &order, filter.most() + 1))
}

/// Truncates a reply to its length. Returns the cursor of its last row if there are more.
fn cut<T>(found: &mut Vec<T>, most: usize, place: impl Fn(&T) -> Cursor) -> Option<String> {
    let more = found.len() > most;
    found.truncate(most);
    found.last().filter(|_| more).map(|last| place(last).text())
}

fn several(wanted: &str, runs: &[CatalogRun]) -> CatalogError {
    let listed = runs.iter().take(LISTED);
    let listed: Vec<String> = listed
        .map(|run| format!("{} ({})", run.run, run.folder))
        .collect();
    CatalogError::Run {
        found: wanted.to_owned(),
        number: runs.len(),
        listed: match listed.as_slice() {
            [] => String::new(),
            listed => format!(": {}", listed.join(", ")),
        },
    }
}

/// Returns a cell of a row of `cell`, or of [`CELL_COLUMNS`].
fn cell_of(row: &Row<'_>) -> rusqlite::Result<CellFound> {
    Ok(CellFound {
        cell: row.get(0)?,
        serial: Some(row.get::<_, String>(1)?).filter(|serial| !serial.is_empty()),
        runs: row.get(2)?,
        first_unix_s: row.get(3)?,
        last_unix_s: row.get(4)?,
        model: row.get(5)?,
        batch: row.get(6)?,
        barcode: row.get(7)?,
        maker: row.get(8)?,
        chemistry: row.get(9)?,
        term: row.get(10)?,
    })
}
