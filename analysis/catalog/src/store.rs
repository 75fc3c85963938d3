//! Writes the contents of run folders into the tables.

use std::path::Path;

use rusqlite::{Connection, named_params, params};

use crate::{
    question::KeyKind,
    record::{CatalogDiagnosis, CatalogEvent, CatalogFit, CatalogRun, CatalogSpectrum, Folder},
};

/// Columns of a cell of the runs `c` of `run_cell`, in the order of the table of cells.
pub(crate) const CELL_COLUMNS: &str = "c.name, c.serial, count(*), min(c.started_unix_s), \
    max(c.started_unix_s), max(c.model), max(c.batch), max(c.barcode), max(c.maker), \
    max(c.chemistry), max(c.term)";

/// Statements that take a run out of all tables. The first two find their rows by those of the tables that
/// follow: an index by run alone would cost each scan more than it saves.
const OF_RUN: [&str; 7] = [
    "DELETE FROM run_key WHERE run = ?1 AND kind IN (0, 1) \
     AND started_unix_s = (SELECT started_unix_s FROM run WHERE run = ?1) \
     AND key IN (SELECT name FROM run_cell WHERE run = ?1 \
     UNION SELECT serial FROM run_cell WHERE run = ?1 \
     UNION SELECT scanned_serial FROM run_cell WHERE run = ?1 \
     UNION SELECT barcode FROM run_cell WHERE run = ?1 \
     UNION SELECT batch FROM run_cell WHERE run = ?1)",
    "DELETE FROM run_text WHERE run = ?1 \
     AND started_unix_s = (SELECT started_unix_s FROM run WHERE run = ?1)",
    "DELETE FROM run WHERE run = ?1",
    "DELETE FROM run_cell WHERE run = ?1",
    "DELETE FROM spectrum WHERE run = ?1",
    "DELETE FROM fit WHERE run = ?1",
    "DELETE FROM event WHERE run = ?1",
];

/// Takes a run out of all tables.
pub(crate) fn remove(connection: &Connection, run: &str) -> rusqlite::Result<()> {
    for text in OF_RUN {
        connection.prepare_cached(text)?.execute([run])?;
    }
    Ok(())
}

/// Writes a run and replaces its earlier contents.
pub(crate) fn put(connection: &Connection, folder: &Folder, known: bool) -> rusqlite::Result<()> {
    if known {
        remove(connection, &folder.run.run)?;
    }
    put_run(connection, folder)?;
    put_words(connection, &folder.run, &folder.notes)?;
    put_keys(connection, &folder.run)?;
    for spectrum in &folder.spectra {
        put_spectrum(connection, spectrum)?;
    }
    for fit in &folder.fits {
        put_fit(connection, fit)?;
    }
    for event in &folder.events {
        put_event(connection, &folder.run.run, event)?;
    }
    Ok(())
}

fn put_run(connection: &Connection, folder: &Folder) -> rusqlite::Result<()> {
    let Folder {
        run,
        stamp,
        instruments,
        ..
    } = folder;
    let mut into = connection.prepare_cached(
        "INSERT INTO run VALUES (:run, :folder, :name, :stamp, :missing, :version, :experiment, \
         :bench, :operator, :seed, :time, :simulated, :started_unix_s, :time_source, \
         :bench_time_s, :how, :verdict, :trip, :resumed, :spectra, :refused_points, :fits, \
         :config_sha256, :content_sha256, :damage, :cells, :instruments, :tags, :notes, :map)",
    )?;
    into.execute(named_params! {
        ":run": run.run,
        ":folder": run.folder,
        ":name": run.name,
        ":stamp": stamp,
        ":missing": run.missing,
        ":version": run.version,
        ":experiment": run.experiment,
        ":bench": run.bench,
        ":operator": run.operator,
        ":seed": run.seed.to_string(),
        ":time": run.time,
        ":simulated": run.simulated,
        ":started_unix_s": run.started_unix_s,
        ":time_source": run.time_source.label(),
        ":bench_time_s": run.bench_time_s,
        ":how": run.how,
        ":verdict": run.verdict.label(),
        ":trip": run.trip,
        ":resumed": run.resumed,
        ":spectra": run.spectra,
        ":refused_points": run.refused_points,
        ":fits": run.fits,
        ":config_sha256": run.config_sha256,
        ":content_sha256": run.content_sha256,
        ":damage": json(&run.damage),
        ":cells": json(&run.cells),
        ":instruments": instruments.to_string(),
        ":tags": json(&run.tags),
        ":notes": run.notes,
        ":map": json(&run.map),
    })?;
    Ok(())
}

/// Returns the text of a value that always has one.
fn json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

/// Returns the text to search for words beside the name, in lower case: many runs share it.
fn phrase(run: &CatalogRun, notes: &[String]) -> String {
    let own = [&run.bench, &run.experiment].map(String::as_str);
    let more = [&run.operator, &run.how].map(|text| text.as_deref().unwrap_or_default());
    let cells = run.cells.iter().flat_map(|cell| {
        let serials = [&cell.serial, &cell.scanned_serial, &cell.barcode];
        let kind = [&cell.model, &cell.batch, &cell.maker, &cell.chemistry];
        serials
            .into_iter()
            .chain(kind)
            .map(|text| text.as_deref().unwrap_or_default())
            .chain([cell.name.as_str()])
    });
    let people = run.tags.iter().chain(notes).map(String::as_str);
    let all: Vec<&str> = own
        .into_iter()
        .chain(more)
        .chain(cells)
        .chain(people)
        .collect();
    all.join("\n").to_lowercase()
}

/// Inserts the words of a run.
fn put_words(connection: &Connection, run: &CatalogRun, notes: &[String]) -> rusqlite::Result<()> {
    let phrase = phrase(run, notes);
    let mut phrases =
        connection.prepare_cached("INSERT OR IGNORE INTO phrase (text) VALUES (?1)")?;
    phrases.execute([&phrase])?;
    let mut words = connection.prepare_cached(
        "INSERT INTO run_text VALUES (?1, ?2, ?3, ?4, ?5, \
         (SELECT phrase FROM phrase WHERE text = ?6))",
    )?;
    words.execute(params![
        run.started_unix_s,
        run.run,
        run.bench,
        run.verdict.label(),
        run.name.to_lowercase(),
        phrase
    ])?;
    Ok(())
}

fn put_keys(connection: &Connection, run: &CatalogRun) -> rusqlite::Result<()> {
    let verdict = run.verdict.label();
    let mut into = connection.prepare_cached(
        "INSERT OR REPLACE INTO run_cell VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, \
         ?12, ?13, ?14)",
    )?;
    let mut keys = connection
        .prepare_cached("INSERT OR IGNORE INTO run_key VALUES (?1, ?2, ?3, ?4, ?5, ?6)")?;
    for cell in &run.cells {
        into.execute(params![
            cell.name,
            cell.serial.as_deref().unwrap_or_default(),
            run.started_unix_s,
            run.run,
            cell.scanned_serial,
            cell.model,
            cell.batch,
            cell.barcode,
            cell.maker,
            cell.chemistry,
            cell.term,
            run.bench,
            run.experiment,
            verdict
        ])?;
        let codes = [&cell.serial, &cell.scanned_serial, &cell.barcode];
        let of_cell = [&cell.name].into_iter().chain(codes.into_iter().flatten());
        let of_cell = of_cell.map(|key| (KeyKind::Cell, key));
        let of_batch = cell.batch.iter().map(|key| (KeyKind::Batch, key));
        for (kind, key) in of_cell.chain(of_batch) {
            keys.execute(params![
                kind.number(),
                key,
                run.started_unix_s,
                run.run,
                run.bench,
                verdict
            ])?;
        }
    }
    Ok(())
}

fn put_spectrum(connection: &Connection, one: &CatalogSpectrum) -> rusqlite::Result<()> {
    let mut into = connection.prepare_cached(
        "INSERT OR REPLACE INTO spectrum VALUES (:run, :file, :name, :bench, :cell, :serial, :batch, \
         :chemistry, :fixture, \
         :corrected, :repeat, :started_unix_s, :time_source, :amplitude_a, :bias_a, \
         :ocv_v, \
         :temperature_c, :points, :refused_points, :low_hz, :high_hz, :r_high_ohm, \
         :r_high_hz, :r_high_sigma_ohm, :r_low_ohm, :r_low_sigma_ohm)",
    )?;
    into.execute(named_params! {
        ":run": one.run,
        ":file": one.file,
        ":name": one.name,
        ":bench": one.bench,
        ":cell": one.cell,
        ":serial": one.serial,
        ":batch": one.batch,
        ":chemistry": one.chemistry,
        ":fixture": one.fixture,
        ":corrected": one.corrected,
        ":repeat": one.repeat,
        ":started_unix_s": one.started_unix_s,
        ":time_source": one.time_source.label(),
        ":amplitude_a": one.amplitude_a,
        ":bias_a": one.bias_a,
        ":ocv_v": one.ocv_v,
        ":temperature_c": one.temperature_degc,
        ":points": one.points,
        ":refused_points": one.refused_points,
        ":low_hz": one.low_hz,
        ":high_hz": one.high_hz,
        ":r_high_ohm": one.r_high_ohm,
        ":r_high_hz": one.r_high_hz,
        ":r_high_sigma_ohm": one.r_high_sigma_ohm,
        ":r_low_ohm": one.r_low_ohm,
        ":r_low_sigma_ohm": one.r_low_sigma_ohm,
    })?;
    Ok(())
}

fn put_fit(connection: &Connection, fit: &CatalogFit) -> rusqlite::Result<()> {
    let mut into = connection.prepare_cached(
        "INSERT OR REPLACE INTO fit VALUES (:run, :file, :name, :bench, :cell, :serial, :batch, \
         :cells, :rc, \
         :started_unix_s, :time_source, :temperature_c, :ocv_v, :r_ohm, :r_sigma_ohm, \
         :dc_resistance_ohm, :dc_resistance_sigma_ohm, :slow_r_ohm, :slow_r_sigma_ohm, \
         :slow_tau_s, :slow_tau_sigma_s, :time_constants_s, :rms_ohm, :reduced_chi2, :points)",
    )?;
    into.execute(named_params! {
        ":run": fit.run,
        ":file": fit.file,
        ":name": fit.name,
        ":bench": fit.bench,
        ":cell": fit.cell,
        ":serial": fit.serial,
        ":batch": fit.batch,
        ":cells": fit.cells,
        ":rc": fit.rc,
        ":started_unix_s": fit.started_unix_s,
        ":time_source": fit.time_source.label(),
        ":temperature_c": fit.temperature_degc,
        ":ocv_v": fit.ocv_v,
        ":r_ohm": fit.r_ohm,
        ":r_sigma_ohm": fit.r_sigma_ohm,
        ":dc_resistance_ohm": fit.dc_resistance_ohm,
        ":dc_resistance_sigma_ohm": fit.dc_resistance_sigma_ohm,
        ":slow_r_ohm": fit.slow_r_ohm,
        ":slow_r_sigma_ohm": fit.slow_r_sigma_ohm,
        ":slow_tau_s": fit.slow_tau_s,
        ":slow_tau_sigma_s": fit.slow_tau_sigma_s,
        ":time_constants_s": json(&fit.time_constants_s),
        ":rms_ohm": fit.rms_ohm,
        ":reduced_chi2": fit.reduced_chi2,
        ":points": fit.points,
    })?;
    Ok(())
}

fn put_event(connection: &Connection, run: &str, event: &CatalogEvent) -> rusqlite::Result<()> {
    let mut into = connection
        .prepare_cached("INSERT OR REPLACE INTO event VALUES (?1, ?2, ?3, ?4, ?5, ?6)")?;
    let line = i64::try_from(event.line).unwrap_or(i64::MAX);
    into.execute(params![
        run,
        line,
        event.time_s,
        event.kind.label(),
        event.text,
        event.by
    ])?;
    Ok(())
}

/// Counts the runs of each cell anew.
pub(crate) fn count_cells(connection: &Connection) -> rusqlite::Result<()> {
    connection.execute_batch(&format!(
        "BEGIN IMMEDIATE; DELETE FROM cell; INSERT INTO cell SELECT {CELL_COLUMNS} \
         FROM run_cell c GROUP BY c.name, c.serial; COMMIT;"
    ))
}

/// Inserts a diagnosis and replaces the previous one of its folder.
pub(crate) fn put_diagnosis(
    connection: &Connection,
    one: &CatalogDiagnosis,
    stamp: &str,
) -> rusqlite::Result<()> {
    let name = Path::new(&one.folder).file_name().unwrap_or_default();
    let name = name.to_string_lossy();
    let mut into = connection.prepare_cached(
        "INSERT OR REPLACE INTO diagnosis VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)",
    )?;
    into.execute(params![
        one.folder,
        name,
        stamp,
        one.run,
        one.data_set,
        one.model,
        one.verdict,
        one.summary,
        json(&one.parameters),
        one.damage
    ])?;
    Ok(())
}
