//! The models of many groups of spectra as one table, with a recommendation for all.

use std::collections::BTreeMap;

use analysis::fit::ErmFit;

use super::{group::Group, input::FitArgs};
use bench_evaluate::support::present::{dc_resistance_mohm, r_mohm, significant};
use bench_plan::support::terminal::say;

const HEADER: [&str; 6] = [
    "spectrum",
    "RC",
    "R / mΩ",
    "DC resistance / mΩ",
    "longest τ / s",
    "reduced χ²",
];

/// Prints one line for each model, the notes with the spectra that have them, and the order that
/// suits most spectra.
pub(super) fn print(fitted: &[Group], args: &FitArgs) {
    say!(
        "{} groups of spectra, objective {}; one line for each model:",
        fitted.len(),
        args.objective
    );
    let header = HEADER.map(str::to_owned).to_vec();
    let models = fitted
        .iter()
        .flat_map(|group| group.fits.iter().map(|fit| row(group, fit)));
    let rows: Vec<Vec<String>> = std::iter::once(header).chain(models).collect();
    for row in &rows {
        say!("{}", line(row, &rows));
    }
    for (note, names) in notes(fitted) {
        say!("note: {note}: {}", names.join(", "));
    }
    if let Some(text) = recommendation(fitted) {
        say!("{text}");
    }
    match &args.out {
        Some(folder) => say!("written to {}", folder.display()),
        None => say!("`--json` prints every parameter, `--out DIR` writes the models and a report"),
    }
}

fn row(group: &Group, fit: &ErmFit) -> Vec<String> {
    let branches = fit.erm.branches.iter();
    let tau_s = branches
        .map(|branch| branch.r_ohm * branch.c_f)
        .fold(f64::NAN, f64::max);
    let chi2 = fit
        .reduced_chi2
        .map_or_else(|| "–".to_owned(), |chi2| format!("{chi2:.2}"));
    vec![
        group.name.clone(),
        fit.erm.branches.len().to_string(),
        r_mohm(fit),
        dc_resistance_mohm(fit),
        significant(tau_s, 3),
        chi2,
    ]
}

/// Returns a row with the first column at the left and the others at the right.
fn line(row: &[String], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let cell = |(column, cell): (usize, &String)| match column {
        0 => format!("{cell:<width$}", width = width(column)),
        _ => format!("{cell:>width$}", width = width(column)),
    };
    let cells: Vec<String> = row.iter().enumerate().map(cell).collect();
    cells.join("  ")
}

/// Returns every note with the names of its spectra.
fn notes(fitted: &[Group]) -> BTreeMap<String, Vec<&str>> {
    let mut notes: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for group in fitted {
        for text in group.fits.iter().flat_map(|fit| fit.warnings.words()) {
            let names = notes.entry(text).or_default();
            if names.last() != Some(&group.name.as_str()) {
                names.push(&group.name);
            }
        }
    }
    notes
}

/// Returns the order that the data of most spectra support, and how to use it for all. `None` if
/// the order was given.
fn recommendation(fitted: &[Group]) -> Option<String> {
    let chosen = fitted
        .iter()
        .filter_map(|group| group.more.order_selection.as_ref());
    let mut votes: BTreeMap<usize, usize> = BTreeMap::new();
    for selection in chosen {
        *votes.entry(selection.recommended).or_default() += 1;
    }
    // Of equal numbers the smaller order.
    let (rc, count) = votes.into_iter().rev().max_by_key(|(_, count)| *count)?;
    Some(format!(
        "recommended for all: {rc} RC, the choice for {count} of {} spectra; `--rc {rc} --pool` fits one \
        model to all of one cell",
        fitted.len()
    ))
}
