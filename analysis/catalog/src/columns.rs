//! Contents of the rows of the tables.

use rusqlite::Row;

use crate::record::{
    CatalogDiagnosis, CatalogEvent, CatalogEventKind, CatalogFit, CatalogRun, CatalogSpectrum,
    CatalogVerdict, TimeSource,
};

/// Columns of a diagnosis `d`, with the cell of its run that it is of: the one that its folder is
/// called after, or the only one.
pub(crate) const DIAGNOSIS_COLUMNS: &str = "d.*, (SELECT c.name FROM run_cell c \
    WHERE c.run = d.run AND (c.name = d.name \
    OR (SELECT count(*) FROM run_cell o WHERE o.run = d.run) = 1)) AS cell";

/// Returns the value of a column that holds JSON, or its default if it is not valid JSON.
pub(crate) fn json<T: serde::de::DeserializeOwned + Default>(
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

/// Returns a run of a row of `run`.
pub(crate) fn run_of(row: &Row<'_>) -> rusqlite::Result<CatalogRun> {
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
        tags: json(row, "tags")?,
        notes: row.get("notes")?,
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
        map: json(row, "map")?,
        config_sha256: row.get("config_sha256")?,
        content_sha256: row.get("content_sha256")?,
        damage: json(row, "damage")?,
    })
}

/// Returns a spectrum of a row of `spectrum`.
pub(crate) fn spectrum_of(row: &Row<'_>) -> rusqlite::Result<CatalogSpectrum> {
    Ok(CatalogSpectrum {
        run: row.get("run")?,
        name: row.get("name")?,
        file: row.get("file")?,
        bench: row.get("bench")?,
        cell: row.get("cell")?,
        serial: row.get("serial")?,
        batch: row.get("batch")?,
        chemistry: row.get("chemistry")?,
        fixture: row.get("fixture")?,
        corrected: row.get("corrected")?,
        repeat: row.get("repeat")?,
        started_unix_s: row.get("started_unix_s")?,
        time_source: source(row)?,
        amplitude_a: row.get("amplitude_a")?,
        bias_a: row.get("bias_a")?,
        ocv_v: row.get("ocv_v")?,
        temperature_degc: row.get("temperature_c")?,
        points: row.get("points")?,
        refused_points: row.get("refused_points")?,
        low_hz: row.get("low_hz")?,
        high_hz: row.get("high_hz")?,
        r_high_ohm: row.get("r_high_ohm")?,
        r_high_hz: row.get("r_high_hz")?,
        r_high_sigma_ohm: row.get("r_high_sigma_ohm")?,
        r_low_ohm: row.get("r_low_ohm")?,
        r_low_sigma_ohm: row.get("r_low_sigma_ohm")?,
    })
}

/// Returns a fit of a row of `fit`.
pub(crate) fn fit_of(row: &Row<'_>) -> rusqlite::Result<CatalogFit> {
    Ok(CatalogFit {
        run: row.get("run")?,
        name: row.get("name")?,
        file: row.get("file")?,
        bench: row.get("bench")?,
        cell: row.get("cell")?,
        serial: row.get("serial")?,
        batch: row.get("batch")?,
        cells: row.get("cells")?,
        rc: row.get("rc")?,
        started_unix_s: row.get("started_unix_s")?,
        time_source: source(row)?,
        temperature_degc: row.get("temperature_c")?,
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

/// Returns an event of a row of `event`.
pub(crate) fn event_of(row: &Row<'_>) -> rusqlite::Result<CatalogEvent> {
    let (line, kind): (i64, String) = (row.get("line")?, row.get("kind")?);
    Ok(CatalogEvent {
        line: u64::try_from(line).unwrap_or_default(),
        time_s: row.get("time_s")?,
        kind: CatalogEventKind::of_word(&kind),
        text: row.get("text")?,
        by: row.get("by")?,
    })
}

/// Returns a diagnosis of a row of `diagnosis`, with `cell`, the cell of its run that it is of.
pub(crate) fn diagnosis_of(row: &Row<'_>) -> rusqlite::Result<CatalogDiagnosis> {
    Ok(CatalogDiagnosis {
        folder: row.get("folder")?,
        run: row.get("run")?,
        cell: row.get("cell")?,
        data_set: row.get("data_set")?,
        model: row.get("model")?,
        verdict: row.get("verdict")?,
        summary: row.get("summary")?,
        parameters: json(row, "parameters")?,
        damage: row.get("damage")?,
    })
}
