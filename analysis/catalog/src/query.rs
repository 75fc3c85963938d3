//! Questions across runs: runs, spectra, cells, and all that is known of one run.

use std::fmt::Write as _;

use rusqlite::{OptionalExtension, Row, ToSql, types::Value};
use serde::Serialize;

use crate::{
    Catalog, CatalogError,
    error::sql,
    record::{
        CatalogDiagnosis, CatalogEvent, CatalogEventKind, CatalogFit, CatalogRun, CatalogSpectrum,
        CatalogVerdict, TimeSource,
    },
};

/// Answers at once where nobody asks for more or fewer.
pub const MOST: usize = 100;
/// Runs that an error lists.
const LISTED: usize = 5;
/// Digits of an identity of a run, and of a time in a cursor.
const DIGITS: usize = 16;

/// Conditions; all of them must hold.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Filter {
    /// Name or serial number of a cell.
    pub cell: Option<String>,
    /// Serial number of a cell, as the experiment tells it or a person read it, or its barcode.
    pub serial: Option<String>,
    /// Batch of a cell.
    pub batch: Option<String>,
    /// Name of a bench.
    pub bench: Option<String>,
    /// Name of an experiment.
    pub experiment: Option<String>,
    /// Begun at this time or later, s since 1970.
    pub from_unix_s: Option<f64>,
    /// Begun before this time, s since 1970.
    pub to_unix_s: Option<f64>,
    /// Verdict of the run.
    pub verdict: Option<CatalogVerdict>,
    /// Words that stand in the name, bench, experiment, operator, end or cells of the run.
    pub text: Option<String>,
    /// Where to go on: `after` of the answer before.
    pub after: Option<String>,
    /// At most so many answers; 0 for [`MOST`].
    pub most: usize,
}

/// Runs that were found, the latest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RunsFound {
    /// The runs.
    pub runs: Vec<CatalogRun>,
    /// Where to go on; none where there are no more.
    pub after: Option<String>,
}

/// Spectra that were found, the latest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SpectraFound {
    /// The spectra.
    pub spectra: Vec<CatalogSpectrum>,
    /// Where to go on; none where there are no more.
    pub after: Option<String>,
}

/// A cell that runs have measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CellFound {
    /// Its name.
    pub cell: String,
    /// Its serial number; none where no experiment tells it.
    pub serial: Option<String>,
    /// Number of runs with it.
    pub runs: u32,
    /// When the first of them began, s since 1970.
    pub first_unix_s: f64,
    /// The same of the last.
    pub last_unix_s: f64,
    /// Its kind, where it has a name of its own.
    pub model: Option<String>,
    /// Batch that it was made in.
    pub batch: Option<String>,
    /// Code that is printed on it.
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
    /// Where to go on; none where there are no more.
    pub after: Option<String>,
}

/// All that is known of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RunShown {
    /// The run.
    pub run: CatalogRun,
    /// Its instruments, as its manifest has them.
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

/// A number of RC pairs, and how many runs have such a fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// Number of RC pairs.
    pub rc: u32,
    /// Number of runs.
    pub runs: u32,
}

/// A place in the order of an answer.
#[derive(Debug, PartialEq)]
pub(crate) struct Cursor {
    started_unix_s: f64,
    run: String,
    file: String,
}

impl Cursor {
    pub(crate) fn of(started_unix_s: f64, run: &str, file: &str) -> Self {
        Self {
            started_unix_s,
            run: run.to_owned(),
            file: file.to_owned(),
        }
    }

    fn text(&self) -> String {
        let file: String = self.file.bytes().fold(String::new(), |mut text, byte| {
            // Writing to a string cannot fail.
            let _ = write!(text, "{byte:02x}");
            text
        });
        format!("{:016x}{}{file}", self.started_unix_s.to_bits(), self.run)
    }

    fn parse(text: &str) -> Result<Self, CatalogError> {
        let found = || CatalogError::Cursor {
            found: text.to_owned(),
        };
        let is_hex = text.bytes().all(|byte| byte.is_ascii_hexdigit());
        if !is_hex || text.len() < 2 * DIGITS || !text.len().is_multiple_of(2) {
            return Err(found());
        }
        let (time, rest) = text.split_at(DIGITS);
        let (run, file) = rest.split_at(DIGITS);
        let bits = u64::from_str_radix(time, 16).map_err(|_| found())?;
        let bytes = (0..file.len())
            .step_by(2)
            .map(|at| u8::from_str_radix(&file[at..at + 2], 16).map_err(|_| found()));
        let bytes: Vec<u8> = bytes.collect::<Result<_, _>>()?;
        Ok(Self {
            started_unix_s: f64::from_bits(bits),
            run: run.to_owned(),
            file: String::from_utf8(bytes).map_err(|_| found())?,
        })
    }
}

/// A question that is being put together.
#[derive(Debug, Default)]
pub(crate) struct Question {
    conditions: Vec<String>,
    values: Vec<Value>,
}

impl Question {
    /// Adds a condition with one `?` for each value.
    pub(crate) fn add(&mut self, condition: &str, values: &[Value]) {
        self.conditions.push(condition.to_owned());
        self.values.extend_from_slice(values);
    }

    fn add_text(&mut self, condition: &str, value: Option<&String>) {
        if let Some(value) = value {
            self.add(condition, &[Value::Text(value.clone())]);
        }
    }

    /// Bounds of the time, which the table of this short name has.
    fn add_times(&mut self, of: char, filter: &Filter) {
        if let Some(from) = filter.from_unix_s {
            self.add(&format!("{of}.started_unix_s >= ?"), &[Value::Real(from)]);
        }
        if let Some(to) = filter.to_unix_s {
            self.add(&format!("{of}.started_unix_s < ?"), &[Value::Real(to)]);
        }
    }

    /// The whole question.
    pub(crate) fn text(&self, select: &str, order: &str, most: usize) -> String {
        let conditions = match self.conditions.as_slice() {
            [] => "1".to_owned(),
            conditions => conditions.join(" AND "),
        };
        format!("SELECT {select} WHERE {conditions} ORDER BY {order} LIMIT {most}")
    }
}

impl Filter {
    fn most(&self) -> usize {
        match self.most {
            0 => MOST,
            most => most,
        }
    }
}

impl Catalog {
    /// The runs that meet every condition, the latest first.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn runs(&self, filter: &Filter) -> Result<RunsFound, CatalogError> {
        let (mut question, mut from) = (Question::default(), "run r".to_owned());
        let mut of = 'r';
        let words = filter.text.as_deref().unwrap_or_default().to_lowercase();
        let words: Vec<&str> = words.split_whitespace().collect();
        if let Some(key) = filter.cell.as_ref().or(filter.serial.as_ref()) {
            (from, of) = (
                "run_key k CROSS JOIN run r ON r.run = k.run".to_owned(),
                'k',
            );
            question.add_text("k.key = ?", Some(key));
        }
        if !words.is_empty() && of == 'r' {
            (from, of) = (
                "run_text t CROSS JOIN run r ON r.run = t.run".to_owned(),
                't',
            );
        } else if !words.is_empty() {
            from.push_str(
                " CROSS JOIN run_text t ON t.started_unix_s = k.started_unix_s AND t.run = k.run",
            );
        }
        for word in words {
            let word = Value::Text(word.to_owned());
            question.add(
                "(instr(t.name, ?) > 0 \
                 OR t.phrase IN (SELECT phrase FROM phrase WHERE instr(text, ?) > 0))",
                &[word.clone(), word],
            );
        }
        if let Some(serial) = &filter.serial {
            let serial = Value::Text(serial.clone());
            question.add(
                "EXISTS (SELECT 1 FROM run_cell c WHERE c.run = r.run \
                 AND ? IN (c.serial, c.scanned_serial, c.barcode))",
                &[serial],
            );
        }
        question.add_text("r.experiment = ?", filter.experiment.as_ref());
        question.add_batch("r", filter.batch.as_ref());
        question.add_text(&format!("{of}.bench = ?"), filter.bench.as_ref());
        if let Some(verdict) = filter.verdict {
            let verdict = Value::Text(verdict.label().to_owned());
            question.add(&format!("{of}.verdict = ?"), &[verdict]);
        }
        question.add_times(of, filter);
        if let Some(after) = &filter.after {
            let Cursor {
                started_unix_s,
                run,
                ..
            } = Cursor::parse(after)?;
            question.add(
                &format!("({of}.started_unix_s, {of}.run) < (?, ?)"),
                &[Value::Real(started_unix_s), Value::Text(run)],
            );
        }
        let order = format!("{of}.started_unix_s DESC, {of}.run DESC");
        let text = question.text(&format!("r.* FROM {from}"), &order, filter.most() + 1);
        let mut runs = self.ask(&text, &question.values, run_of)?;
        let after = cut(&mut runs, filter.most(), |run| {
            Cursor::of(run.started_unix_s, &run.run, "")
        });
        Ok(RunsFound { runs, after })
    }

    /// The corrected spectra of cells that meet every condition, the latest first. Words are not
    /// sought in spectra.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn spectra(&self, filter: &Filter) -> Result<SpectraFound, CatalogError> {
        let mut question = Question::default();
        question.add("s.fixture = 'cell' AND s.corrected = 1", &[]);
        let (cell, serial) = self.cell_and_serial(filter)?;
        question.add_text("s.cell = ?", cell.as_ref());
        question.add_serial("s", serial);
        question.add_text("s.batch = ?", filter.batch.as_ref());
        question.add_experiment("s", filter.experiment.as_ref());
        question.add_text("s.bench = ?", filter.bench.as_ref());
        question.add_times('s', filter);
        if let Some(verdict) = filter.verdict {
            question.add(
                "EXISTS (SELECT 1 FROM run r WHERE r.run = s.run AND r.verdict = ?)",
                &[Value::Text(verdict.label().to_owned())],
            );
        }
        if let Some(after) = &filter.after {
            let after = Cursor::parse(after)?;
            question.add(
                "(s.started_unix_s, s.run, s.file) < (?, ?, ?)",
                &[
                    Value::Real(after.started_unix_s),
                    Value::Text(after.run),
                    Value::Text(after.file),
                ],
            );
        }
        let order = "s.started_unix_s DESC, s.run DESC, s.file DESC";
        let text = question.text("s.* FROM spectrum s", order, filter.most() + 1);
        let mut spectra = self.ask(&text, &question.values, spectrum_of)?;
        let after = cut(&mut spectra, filter.most(), |one| {
            Cursor::of(one.started_unix_s, &one.run, &one.file)
        });
        Ok(SpectraFound { spectra, after })
    }

    /// The cells that runs have measured, by name and serial number. Of the conditions `cell`,
    /// `serial`, `batch`, `after` and `most` count.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn cells(&self, filter: &Filter) -> Result<CellsFound, CatalogError> {
        let mut question = Question::default();
        let (cell, serial) = self.cell_and_serial(filter)?;
        question.add_text("c.name = ?", cell.as_ref());
        question.add_text("c.serial = ?", serial.as_ref());
        question.add_text("c.batch = ?", filter.batch.as_ref());
        if let Some(after) = &filter.after {
            let after = Cursor::parse(after)?;
            let (name, serial) = after.file.split_once('\0').unwrap_or((&after.file, ""));
            let values = [name, serial].map(|text| Value::Text(text.to_owned()));
            question.add("(c.name, c.serial) > (?, ?)", &values);
        }
        let text = question.text("c.* FROM cell c", "c.name, c.serial", filter.most() + 1);
        let mut cells = self.ask(&text, &question.values, |row| {
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
        })?;
        let after = cut(&mut cells, filter.most(), |cell| {
            let serial = cell.serial.as_deref().unwrap_or_default();
            Cursor::of(
                0.0,
                &"0".repeat(DIGITS),
                &format!("{}\0{serial}", cell.cell),
            )
        });
        Ok(CellsFound { cells, after })
    }

    /// All that is known of a run, by its identity, its folder or its name.
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
            diagnoses: self.ask(
                "SELECT * FROM diagnosis WHERE run = ?1 ORDER BY folder",
                &key,
                diagnosis_of,
            )?,
            run,
        })
    }

    /// The fits that meet every condition, in the order of time; of one number of RC pairs where
    /// `rc` says so. Words and places do not count.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn fits(&self, filter: &Filter, rc: Option<u32>) -> Result<Vec<CatalogFit>, CatalogError> {
        let mut question = self.of_fits(filter)?;
        if let Some(rc) = rc {
            question.add("f.rc = ?", &[Value::Integer(rc.into())]);
        }
        let order = "f.started_unix_s, f.run, f.file";
        let text = question.text("f.* FROM fit f", order, filter.most());
        self.ask(&text, &question.values, fit_of)
    }

    /// Numbers of RC pairs of the fits that meet every condition, each with the number of runs that
    /// have such a fit.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn orders(&self, filter: &Filter) -> Result<Vec<Order>, CatalogError> {
        let question = self.of_fits(filter)?;
        let select = "f.rc, count(DISTINCT f.run) FROM fit f";
        let text = question
            .text(select, "f.rc", usize::MAX >> 1)
            .replace(" ORDER BY", " GROUP BY f.rc ORDER BY");
        self.ask(&text, &question.values, |row| {
            Ok(Order {
                rc: row.get(0)?,
                runs: row.get(1)?,
            })
        })
    }

    /// Number of the runs that have a fit that meets every condition.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub(crate) fn runs_with_fits(&self, filter: &Filter) -> Result<u32, CatalogError> {
        let question = self.of_fits(filter)?;
        let text = question.text("count(DISTINCT f.run) FROM fit f", "1", 1);
        let found = self.ask(&text, &question.values, |row| row.get(0))?;
        Ok(found.first().copied().unwrap_or_default())
    }

    fn of_fits(&self, filter: &Filter) -> Result<Question, CatalogError> {
        let mut question = Question::default();
        let (cell, serial) = self.cell_and_serial(filter)?;
        question.add_text("f.cell = ?", cell.as_ref());
        question.add_serial("f", serial);
        question.add_text("f.batch = ?", filter.batch.as_ref());
        question.add_experiment("f", filter.experiment.as_ref());
        question.add_text("f.bench = ?", filter.bench.as_ref());
        question.add_times('f', filter);
        if let Some(verdict) = filter.verdict {
            question.add(
                "EXISTS (SELECT 1 FROM run r WHERE r.run = f.run AND r.verdict = ?)",
                &[Value::Text(verdict.label().to_owned())],
            );
        }
        Ok(question)
    }

    /// The diagnoses that are known to be of a run.
    ///
    /// # Errors
    /// [`CatalogError::Sql`].
    pub(crate) fn diagnoses_of_runs(&self) -> Result<Vec<CatalogDiagnosis>, CatalogError> {
        let text = "SELECT * FROM diagnosis WHERE run IS NOT NULL ORDER BY run, folder";
        self.ask(text, &[], diagnosis_of)
    }

    /// Name and serial number of the cell that is wanted: what is given as a cell may be a serial
    /// number.
    fn cell_and_serial(
        &self,
        filter: &Filter,
    ) -> Result<(Option<String>, Option<String>), CatalogError> {
        let serial = filter.serial.clone();
        let Some(cell) = &filter.cell else {
            return Ok((None, serial));
        };
        let failed = sql(&self.path, "look for a cell");
        let text = "SELECT 1 FROM run_cell WHERE name = ?1 LIMIT 1";
        let named = self.connection.query_row(text, [cell], |_| Ok(()));
        if named.optional().map_err(&failed)?.is_some() {
            return Ok((Some(cell.clone()), serial));
        }
        let text = "SELECT name FROM run_cell WHERE serial = ?1 OR scanned_serial = ?1 \
             OR barcode = ?1 LIMIT 1";
        let name = self.connection.query_row(text, [cell], |row| row.get(0));
        let name: Option<String> = name.optional().map_err(&failed)?;
        Ok(match name {
            Some(name) => (Some(name), serial.or_else(|| Some(cell.clone()))),
            None => (Some(cell.clone()), serial),
        })
    }

    /// Asks, and reads each row.
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

impl Question {
    /// The run of a row is of this experiment.
    fn add_experiment(&mut self, of: &str, experiment: Option<&String>) {
        self.add_text(
            &format!("EXISTS (SELECT 1 FROM run r WHERE r.run = {of}.run AND r.experiment = ?)"),
            experiment,
        );
    }

    /// The run has a cell of this batch.
    fn add_batch(&mut self, of: &str, batch: Option<&String>) {
        self.add_text(
            &format!("EXISTS (SELECT 1 FROM run_cell c WHERE c.run = {of}.run AND c.batch = ?)"),
            batch,
        );
    }

    /// The run of a row has a cell of this serial number.
    fn add_serial(&mut self, of: &str, serial: Option<String>) {
        let Some(serial) = serial.map(Value::Text) else {
            return;
        };
        self.add(
            &format!(
                "EXISTS (SELECT 1 FROM run_cell c WHERE c.run = {of}.run AND c.name = {of}.cell \
                 AND ? IN (c.serial, c.scanned_serial, c.barcode))"
            ),
            &[serial],
        );
    }
}

/// Cuts an answer to its length; the place of its last one, where there are more.
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

/// Value of a column that holds JSON; its default where it is none.
fn json<T: serde::de::DeserializeOwned + Default>(
    row: &Row<'_>,
    column: &str,
) -> rusqlite::Result<T> {
    let text: String = row.get(column)?;
    Ok(serde_json::from_str(&text).unwrap_or_default())
}

fn source(row: &Row<'_>) -> rusqlite::Result<TimeSource> {
    let word: String = row.get("time_source")?;
    Ok(TimeSource::of_word(&word))
}

fn run_of(row: &Row<'_>) -> rusqlite::Result<CatalogRun> {
    let seed: String = row.get("seed")?;
    let verdict: String = row.get("verdict")?;
    Ok(CatalogRun {
        run: row.get("run")?,
        name: row.get("name")?,
        folder: row.get("folder")?,
        missing: row.get("missing")?,
        version: row.get("version")?,
        experiment: row.get("experiment")?,
        bench: row.get("bench")?,
        cells: json(row, "cells")?,
        operator: row.get("operator")?,
        seed: seed.parse().unwrap_or_default(),
        time: row.get("time")?,
        simulated: row.get("simulated")?,
        started_unix_s: row.get("started_unix_s")?,
        time_source: source(row)?,
        bench_time_s: row.get("bench_time_s")?,
        how: row.get("how")?,
        verdict: CatalogVerdict::of_word(&verdict).unwrap_or(CatalogVerdict::Damaged),
        trip: row.get("trip")?,
        resumed: row.get("resumed")?,
        spectra: row.get("spectra")?,
        refused_points: row.get("refused_points")?,
        fits: row.get("fits")?,
        config_sha256: row.get("config_sha256")?,
        content_sha256: row.get("content_sha256")?,
        damage: json(row, "damage")?,
    })
}

fn spectrum_of(row: &Row<'_>) -> rusqlite::Result<CatalogSpectrum> {
    Ok(CatalogSpectrum {
        run: row.get("run")?,
        name: row.get("name")?,
        file: row.get("file")?,
        bench: row.get("bench")?,
        cell: row.get("cell")?,
        serial: row.get("serial")?,
        batch: row.get("batch")?,
        fixture: row.get("fixture")?,
        corrected: row.get("corrected")?,
        repeat: row.get("repeat")?,
        started_unix_s: row.get("started_unix_s")?,
        time_source: source(row)?,
        amplitude_a: row.get("amplitude_a")?,
        ocv_v: row.get("ocv_v")?,
        temperature_c: row.get("temperature_c")?,
        points: row.get("points")?,
        refused_points: row.get("refused_points")?,
        low_hz: row.get("low_hz")?,
        high_hz: row.get("high_hz")?,
        r_high_ohm: row.get("r_high_ohm")?,
        r_high_sigma_ohm: row.get("r_high_sigma_ohm")?,
        r_low_ohm: row.get("r_low_ohm")?,
        r_low_sigma_ohm: row.get("r_low_sigma_ohm")?,
    })
}

fn fit_of(row: &Row<'_>) -> rusqlite::Result<CatalogFit> {
    Ok(CatalogFit {
        run: row.get("run")?,
        name: row.get("name")?,
        file: row.get("file")?,
        bench: row.get("bench")?,
        cell: row.get("cell")?,
        serial: row.get("serial")?,
        batch: row.get("batch")?,
        rc: row.get("rc")?,
        started_unix_s: row.get("started_unix_s")?,
        time_source: source(row)?,
        temperature_c: row.get("temperature_c")?,
        ocv_v: row.get("ocv_v")?,
        r_ohm: row.get("r_ohm")?,
        r_sigma_ohm: row.get("r_sigma_ohm")?,
        dc_resistance_ohm: row.get("dc_resistance_ohm")?,
        dc_resistance_sigma_ohm: row.get("dc_resistance_sigma_ohm")?,
        slow_r_ohm: row.get("slow_r_ohm")?,
        slow_r_sigma_ohm: row.get("slow_r_sigma_ohm")?,
        slow_tau_s: row.get("slow_tau_s")?,
        slow_tau_sigma_s: row.get("slow_tau_sigma_s")?,
        time_constants_s: json(row, "time_constants_s")?,
        rms_ohm: row.get("rms_ohm")?,
        reduced_chi2: row.get("reduced_chi2")?,
        points: row.get("points")?,
    })
}

fn event_of(row: &Row<'_>) -> rusqlite::Result<CatalogEvent> {
    let (line, kind): (i64, String) = (row.get("line")?, row.get("kind")?);
    Ok(CatalogEvent {
        line: u64::try_from(line).unwrap_or_default(),
        time_s: row.get("time_s")?,
        kind: CatalogEventKind::of_word(&kind),
        text: row.get("text")?,
        by: row.get("by")?,
    })
}

fn diagnosis_of(row: &Row<'_>) -> rusqlite::Result<CatalogDiagnosis> {
    Ok(CatalogDiagnosis {
        folder: row.get("folder")?,
        run: row.get("run")?,
        data_set: row.get("data_set")?,
        model: row.get("model")?,
        verdict: row.get("verdict")?,
        summary: row.get("summary")?,
        parameters: json(row, "parameters")?,
        damage: row.get("damage")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_comes_back_and_nothing_else_is_one() {
        let place = Cursor::of(1.5, "00ff00ff00ff00ff", "spectra/ä_1.csv");
        assert_eq!(Cursor::parse(&place.text()).unwrap(), place);
        for text in [
            "",
            "x",
            "0123",
            &"0".repeat(33),
            &format!("{}zz", "0".repeat(32)),
        ] {
            let error = Cursor::parse(text).unwrap_err().to_string();
            assert!(error.starts_with("after: expected the `after`"), "{error}");
        }
    }
}
