//! Works on many things of one kind, a part at a time, on all cores.

use std::path::Path;

use analysis::batch::{BatchError, Parts, PartsPlan};
use analysis::rows::{ResultColumn, ResultRow};
use rayon::prelude::*;

use bench_core::operator::progress::Share;
use bench_core::safety::failure::Failure;
use bench_plan::support::terminal::{remark, say};

/// Things to be worked on, one after another.
pub trait Items {
    /// A thing.
    type Item: Sync;

    /// Returns a text that is equal for two calls on the same inputs and options.
    ///
    /// # Errors
    /// A file that cannot be inspected.
    fn identity(&self) -> Result<String, Failure>;

    /// Share of everything that is read, 0 to 1.
    fn share(&self) -> f64;

    /// The next; none at the end.
    ///
    /// # Errors
    /// A file that cannot be read.
    fn next(&mut self) -> Result<Option<Self::Item>, Failure>;
}

/// Table to be made.
pub struct Job<'a> {
    /// The table.
    pub table: &'a Path,
    /// Everything beside the things that decides the results, as text.
    pub call: String,
    /// Columns of the table.
    pub columns: Vec<ResultColumn>,
    /// Things of one part: some seconds of work, so that a call that is killed loses no more.
    pub part: usize,
    /// Noun for the items, singular and plural.
    pub noun: [&'static str; 2],
}

/// Counts of a table.
#[derive(Default)]
struct Totals {
    items: usize,
    without_result: usize,
    with_warnings: usize,
}

/// Processes all items and writes the table, with the rows of the items in order. Continues from
/// the parts of a call that was killed. Calls `done` for each part.
///
/// # Errors
/// A file that cannot be read, a table that exists already, a folder that cannot be written. An
/// error of one item is written to its row.
pub fn work<I: Items>(
    job: Job<'_>,
    items: &mut I,
    rows: impl Fn(&I::Item) -> Vec<ResultRow> + Sync,
    mut done: impl FnMut(&[I::Item], &[Vec<ResultRow>]) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let [one, several] = job.noun;
    let parts = Parts::begin(PartsPlan {
        out: job.table.to_path_buf(),
        call: format!("{}\n{}", job.call, items.identity()?),
        columns: job.columns,
    })
    .map_err(|error| refused(&error))?;
    let (mut totals, mut part, mut before) = (Totals::default(), 0, 0);
    let shown = Share::shown();
    loop {
        let taken = take(items, job.part)?;
        if taken.is_empty() {
            break;
        }
        totals.items += taken.len();
        if parts.is_done(part) {
            before += taken.len();
        } else {
            let results: Vec<Vec<ResultRow>> = taken.par_iter().map(&rows).collect();
            totals.count(&results);
            done(&taken, &results)?;
            parts
                .write(part, &results.concat())
                .map_err(|error| refused(&error))?;
        }
        part += 1;
        shown.at(items.share(), &format!("{} {several}", totals.items));
    }
    shown.end();
    if totals.items == 0 {
        let text = format!("expected at least one {one}, found none");
        return Err(Failure::Usage(text));
    }
    parts.finish(part).map_err(|error| refused(&error))?;
    if before > 0 {
        remark!("{before} {several} were worked on by a call before this one");
    }
    let Totals {
        items,
        without_result,
        with_warnings,
    } = totals;
    let scope = if before > 0 { "of the others, " } else { "" };
    say!(
        "{items} {several}; {scope}{without_result} without a result, {with_warnings} with warnings"
    );
    say!("written to {}", job.table.display());
    Ok(())
}

impl Totals {
    fn count(&mut self, results: &[Vec<ResultRow>]) {
        let count = |of: fn(&ResultRow) -> bool| {
            let any = |rows: &&Vec<ResultRow>| rows.iter().any(of);
            results.iter().filter(any).count()
        };
        self.without_result += count(|row| row.error.is_some());
        self.with_warnings += count(|row| row.has_warnings);
    }
}

fn take<I: Items>(items: &mut I, most: usize) -> Result<Vec<I::Item>, Failure> {
    let mut taken = Vec::new();
    while taken.len() < most {
        match items.next()? {
            Some(one) => taken.push(one),
            None => break,
        }
    }
    Ok(taken)
}

fn refused(error: &BatchError) -> Failure {
    Failure::Usage(error.to_string())
}
