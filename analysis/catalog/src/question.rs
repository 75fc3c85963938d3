//! A query across runs: its conditions, its construction, and its cursor.

use std::fmt::Write as _;

use rusqlite::types::Value;

use crate::{CatalogError, record::CatalogVerdict};

/// Default maximum number of rows in a reply.
pub const MOST: usize = 100;
/// Length of an answer without a bound, as SQLite takes it.
pub(crate) const ALL: usize = usize::MAX >> 1;
/// Digits of an identity of a run, and of a time in a cursor.
pub(crate) const DIGITS: usize = 16;

/// Conditions; all of them must hold.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Filter {
    /// Name or serial number of a cell, or its barcode.
    pub cell: Option<String>,
    /// Serial number of a cell, from the experiment or read by a person, or its barcode.
    pub serial: Option<String>,
    /// Batch of a cell.
    pub batch: Option<String>,
    /// Name of a bench.
    pub bench: Option<String>,
    /// Name of an experiment.
    pub experiment: Option<String>,
    /// Started at this time or later, s since 1970.
    pub from_unix_s: Option<f64>,
    /// Started before this time, s since 1970.
    pub to_unix_s: Option<f64>,
    /// Verdict of the run.
    pub verdict: Option<CatalogVerdict>,
    /// The interlock has ended the run, even if it continued afterwards.
    pub trip: bool,
    /// The run has fitted a map.
    pub map: bool,
    /// A tag of the run.
    pub tag: Option<String>,
    /// Words that occur in the name, bench, experiment, operator, end, cells, tags or notes of the
    /// run.
    pub text: Option<String>,
    /// Position of the next part: `after` of the previous answer.
    pub after: Option<String>,
    /// Maximum number of rows in the reply; 0 for [`MOST`].
    pub most: usize,
}

impl Filter {
    /// Returns the length of an answer.
    pub(crate) fn most(&self) -> usize {
        match self.most {
            0 => MOST,
            most => most,
        }
    }

    /// Returns whether the question has no condition except a cursor and a length.
    pub(crate) fn is_empty(&self) -> bool {
        let all = Self {
            after: self.after.clone(),
            most: self.most,
            ..Self::default()
        };
        *self == all
    }

    /// Returns whether a condition applies to runs rather than to what is measured in them.
    pub(crate) fn asks_of_runs(&self) -> bool {
        let texts = [&self.batch, &self.experiment, &self.tag, &self.text];
        self.trip || self.map || self.verdict.is_some() || texts.into_iter().any(Option::is_some)
    }

    /// Returns whether the question has a condition beside the time.
    pub(crate) fn asks_beside_time(&self) -> bool {
        let texts = [&self.cell, &self.serial, &self.bench];
        self.asks_of_runs() || texts.into_iter().any(Option::is_some)
    }

    fn words(&self) -> Vec<String> {
        let text = self.text.as_deref().unwrap_or_default().to_lowercase();
        text.split_whitespace().map(str::to_owned).collect()
    }
}

/// A text is a serial number or the barcode of a row `c` of `run_cell`.
pub(crate) const IS_CODE: &str = "? IN (c.serial, c.scanned_serial, c.barcode)";
/// A text is a tag of a run `r`.
const HAS_TAG: &str = "? IN (SELECT value FROM json_each(r.tags))";
/// Join with the words of a run `r`.
const WORDS: &str = "run_text t ON t.started_unix_s = r.started_unix_s AND t.run = r.run";

/// Kind of a key that finds runs.
#[derive(Debug, Clone, Copy)]
pub(crate) enum KeyKind {
    /// Name, serial number or barcode of a cell.
    Cell,
    /// Batch of a cell.
    Batch,
}

impl KeyKind {
    /// Its number in the table.
    pub(crate) fn number(self) -> i64 {
        match self {
            Self::Cell => 0,
            Self::Batch => 1,
        }
    }
}

/// A question that is being put together.
#[derive(Debug, Default)]
pub(crate) struct Question {
    from: String,
    conditions: Vec<String>,
    /// Values of its `?`, in their order.
    pub(crate) values: Vec<Value>,
}

impl Question {
    /// Creates a question to these tables, which have one `?` for each value.
    pub(crate) fn of(from: &str, values: &[Value]) -> Self {
        Self {
            from: from.to_owned(),
            conditions: Vec::new(),
            values: values.to_vec(),
        }
    }

    /// Adds a condition with one `?` for each value.
    pub(crate) fn add(&mut self, condition: &str, values: &[Value]) {
        self.conditions.push(condition.to_owned());
        self.values.extend_from_slice(values);
    }

    /// Adds a condition with one `?`, if there is a text for it.
    pub(crate) fn add_text(&mut self, condition: &str, value: Option<&String>) {
        if let Some(value) = value {
            self.add(condition, &[Value::Text(value.clone())]);
        }
    }

    /// Adds bounds of the time, which the table of this short name has.
    pub(crate) fn add_times(&mut self, of: char, filter: &Filter) {
        if let Some(from) = filter.from_unix_s {
            self.add(&format!("{of}.started_unix_s >= ?"), &[Value::Real(from)]);
        }
        if let Some(to) = filter.to_unix_s {
            self.add(&format!("{of}.started_unix_s < ?"), &[Value::Real(to)]);
        }
    }

    /// Adds the conditions on the run of a row `c` of `run_cell`, beside the cell and the time.
    pub(crate) fn add_run_of_cell(&mut self, filter: &Filter) {
        self.add_text("c.bench = ?", filter.bench.as_ref());
        self.add_text("c.experiment = ?", filter.experiment.as_ref());
        self.add_facts('c', filter);
        if let Some(tag) = &filter.tag {
            let condition = format!("c.run IN (SELECT r.run FROM run r WHERE {HAS_TAG})");
            self.add(&condition, &[Value::Text(tag.clone())]);
        }
        let words = filter.words();
        if !words.is_empty() {
            let mut runs = Self::of("run_text t", &[]);
            runs.add_words(&words);
            let found = runs.text("t.run", "", ALL);
            self.add(&format!("c.run IN ({found})"), &runs.values);
        }
    }

    /// Adds conditions on a row `c` of `run_cell`.
    pub(crate) fn add_cell(&mut self, filter: &Filter) {
        let any = "? IN (c.name, c.serial, c.scanned_serial, c.barcode)";
        self.add_text(any, filter.cell.as_ref());
        self.add_text(IS_CODE, filter.serial.as_ref());
        self.add_text("c.batch = ?", filter.batch.as_ref());
    }

    /// Creates the conditions on a row `c` of `run_cell` alone.
    fn of_cell(filter: &Filter) -> Self {
        let mut cell = Self::default();
        cell.add_cell(filter);
        cell
    }

    /// Adds that a row is of a cell with this serial number or barcode.
    pub(crate) fn add_code(&mut self, of: char, code: &str) {
        let condition = format!(
            "EXISTS (SELECT 1 FROM run_cell c WHERE c.run = {of}.run AND c.name = {of}.cell \
             AND {IS_CODE})"
        );
        self.add(&condition, &[Value::Text(code.to_owned())]);
    }

    /// Adds the conditions on the run of a row, beside its cells, bench and time.
    pub(crate) fn add_run(&mut self, of: char, filter: &Filter) {
        let words = filter.words();
        let from = match words.as_slice() {
            [] => "run r".to_owned(),
            _ => format!("run r CROSS JOIN {WORDS}"),
        };
        let mut run = Self::of(&from, &[]);
        run.add_text("r.experiment = ?", filter.experiment.as_ref());
        run.add_text(HAS_TAG, filter.tag.as_ref());
        run.add_facts('r', filter);
        run.add_words(&words);
        if !run.conditions.is_empty() {
            run.add(&format!("r.run = {of}.run"), &[]);
            let condition = format!("EXISTS ({})", run.text("1", "", 1));
            self.add(&condition, &run.values);
        }
    }

    /// Adds conditions on the runs of a table of this short name, which repeats their verdict.
    fn add_facts(&mut self, of: char, filter: &Filter) {
        if let Some(verdict) = filter.verdict {
            let verdict = Value::Text(verdict.label().to_owned());
            self.add(&format!("{of}.verdict = ?"), &[verdict]);
        }
        if filter.trip {
            let tripped = "run IN (SELECT run FROM event WHERE kind = 'trip')";
            self.add(&format!("{of}.{tripped}"), &[]);
        }
        if filter.map {
            let mapped = "run IN (SELECT run FROM run WHERE map <> 'null')";
            self.add(&format!("{of}.{mapped}"), &[]);
        }
    }

    fn add_words(&mut self, words: &[String]) {
        for word in words {
            let word = Value::Text(word.clone());
            self.add(
                "(instr(t.name, ?) > 0 \
                 OR t.phrase IN (SELECT phrase FROM phrase WHERE instr(text, ?) > 0))",
                &[word.clone(), word],
            );
        }
    }

    /// Adds that among some rows, a table with what chooses them, one meets every condition of
    /// another question.
    fn add_exists(&mut self, rows: &str, other: &Self) {
        let condition = format!(
            "EXISTS (SELECT 1 FROM {rows} AND {})",
            other.conditions.join(" AND ")
        );
        self.add(&condition, &other.values);
    }

    /// Returns the whole question.
    pub(crate) fn text(&self, select: &str, tail: &str, most: usize) -> String {
        let conditions = match self.conditions.as_slice() {
            [] => "1".to_owned(),
            conditions => conditions.join(" AND "),
        };
        let from = &self.from;
        format!("SELECT {select} FROM {from} WHERE {conditions} {tail} LIMIT {most}")
    }
}

/// A question for runs `r`, which may go on to what belongs to them.
#[derive(Debug)]
pub(crate) struct RunsQuestion {
    /// The question.
    pub(crate) question: Question,
    /// Short name of the table that finds the runs, in the order of time.
    pub(crate) of: char,
}

impl RunsQuestion {
    /// All conditions of a filter but the time and the place to go on at.
    pub(crate) fn of(filter: &Filter) -> Self {
        let words = filter.words();
        let mut asked = Self::found_by(filter, !words.is_empty());
        let Self { question, of } = &mut asked;
        question.add_words(&words);
        // A name alone or a batch alone is covered by the table that finds the runs.
        if filter.serial.is_some() || (filter.cell.is_some() && filter.batch.is_some()) {
            let cell = Question::of_cell(filter);
            question.add_exists("run_cell c WHERE c.run = r.run", &cell);
        }
        question.add_text(&format!("{of}.bench = ?"), filter.bench.as_ref());
        question.add_text("r.experiment = ?", filter.experiment.as_ref());
        question.add_text(HAS_TAG, filter.tag.as_ref());
        question.add_facts(*of, filter);
        asked
    }

    /// Chooses the table that finds the runs: by a cell or batch, by words, otherwise the runs
    /// themselves.
    fn found_by(filter: &Filter, has_words: bool) -> Self {
        let of_cell = filter.cell.as_ref().or(filter.serial.as_ref());
        let of_cell = of_cell.map(|key| (KeyKind::Cell, key));
        let key = of_cell.or(filter.batch.as_ref().map(|key| (KeyKind::Batch, key)));
        let (from, of) = match (key, has_words) {
            (Some(_), _) => ("run_key k CROSS JOIN run r ON r.run = k.run", 'k'),
            (None, true) => ("run_text t CROSS JOIN run r ON r.run = t.run", 't'),
            (None, false) => ("run r", 'r'),
        };
        let mut question = Question::of(from, &[]);
        if let Some((kind, key)) = key {
            let values = [Value::Integer(kind.number()), Value::Text(key.clone())];
            question.add("k.kind = ? AND k.key = ?", &values);
        }
        let mut found = Self { question, of };
        if of == 'k' && has_words {
            found.join(WORDS);
        }
        found
    }

    /// Joins another table.
    fn join(&mut self, table: &str) {
        let from = &mut self.question.from;
        // Writing to a string cannot fail.
        let _ = write!(from, " CROSS JOIN {table}");
    }

    /// Joins the diagnoses `d` of the runs. A diagnosis that names another cell of its run than the
    /// requested one is left out.
    pub(crate) fn into_diagnoses(mut self, filter: &Filter) -> Self {
        self.join("diagnosis d ON d.run = r.run");
        self.question.add_times(self.of, filter);
        let cell = Question::of_cell(filter);
        if !cell.conditions.is_empty() {
            let of_other = format!(
                "NOT EXISTS (SELECT 1 FROM run_cell c WHERE c.run = d.run AND c.name = d.name \
                 AND NOT coalesce({}, 0))",
                cell.conditions.join(" AND ")
            );
            self.question.add(&of_other, &cell.values);
        }
        self
    }

    /// Adds the condition that a reply continues after a run.
    pub(crate) fn add_after(&mut self, place: Cursor) {
        let of = self.of;
        let values = [Value::Real(place.started_unix_s), Value::Text(place.run)];
        let condition = format!("({of}.started_unix_s, {of}.run) < (?, ?)");
        self.question.add(&condition, &values);
    }

    /// Adds the condition that a reply continues after a file of a run, in a column.
    pub(crate) fn add_after_file(&mut self, place: Cursor, column: &str) {
        let of = self.of;
        let condition = format!("({of}.started_unix_s, {of}.run, {column}) < (?, ?, ?)");
        self.question.add(&condition, &place.values());
    }
}

/// A place in the order of an answer.
#[derive(Debug, PartialEq)]
pub(crate) struct Cursor {
    started_unix_s: f64,
    run: String,
    /// File in the run, or its substitute.
    pub(crate) file: String,
}

impl Cursor {
    pub(crate) fn of(started_unix_s: f64, run: &str, file: &str) -> Self {
        Self {
            started_unix_s,
            run: run.to_owned(),
            file: file.to_owned(),
        }
    }

    /// Returns the time, run and file.
    pub(crate) fn values(self) -> [Value; 3] {
        let Self {
            started_unix_s,
            run,
            file,
        } = self;
        [
            Value::Real(started_unix_s),
            Value::Text(run),
            Value::Text(file),
        ]
    }

    /// Returns the cursor in the form that a reply contains.
    pub(crate) fn text(&self) -> String {
        let file: String = self.file.bytes().fold(String::new(), |mut text, byte| {
            // Writing to a string cannot fail.
            let _ = write!(text, "{byte:02x}");
            text
        });
        format!("{:016x}{}{file}", self.started_unix_s.to_bits(), self.run)
    }

    /// Parses the cursor from a reply.
    pub(crate) fn parse(text: &str) -> Result<Self, CatalogError> {
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
