//! Prints query results of a catalogue as text.

use analysis::catalog::{
    ageing::Ageing,
    query::{CellFound, RunShown},
    record::{CatalogCell, CatalogMap, CatalogRun, TimeSource},
};

use analysis::run_folder::{MAP, SUMS};
use serde_json::Value;

use bench_evaluate::support::present::{significant, utc};
use bench_plan::support::terminal::say;

/// Digits of a resistance in a table.
const DIGITS: i32 = 4;

/// Formats a time, with a mark if only the file's time stamp is known.
fn time(unix_s: f64, source: TimeSource) -> String {
    let mark = match source {
        TimeSource::Clock => ' ',
        TimeSource::File => '~',
    };
    format!("{mark}{}", utc(unix_s))
}

fn named(cell: &CatalogCell) -> String {
    let serial = cell.serial.as_ref().or(cell.scanned_serial.as_ref());
    match serial {
        Some(serial) => format!("{} ({serial})", cell.name),
        None => cell.name.clone(),
    }
}

fn cells_of(run: &CatalogRun) -> String {
    run.cells.iter().map(named).collect::<Vec<_>>().join(", ")
}

/// A map with its range and its error.
fn map_text(map: &CatalogMap) -> String {
    let error = map.left_out_mv.map_or_else(String::new, |error_mv| {
        format!(", {} mV left out", significant(error_mv, 3))
    });
    format!(
        "map of SOC {:.2} to {:.2}, {:.1} to {:.1} °C{error}",
        map.soc_low, map.soc_high, map.temperature_low_degc, map.temperature_high_degc
    )
}

/// Runs, a line each.
pub(super) fn runs(runs: &[CatalogRun]) {
    for run in runs {
        let map = run.map.as_ref().map(map_text);
        let map = map.map_or_else(String::new, |map| format!(", {map}"));
        let missing = if run.missing { ", missing" } else { "" };
        say!(
            "{}  {}  {:<10} {}  {}  {}  {} spectra{map}{missing}",
            run.run,
            time(run.started_unix_s, run.time_source),
            run.verdict.label(),
            run.bench,
            run.name,
            cells_of(run),
            run.spectra
        );
    }
    if runs.is_empty() {
        say!("no run meets these conditions");
    } else if runs.iter().any(|run| run.time_source == TimeSource::File) {
        say!("~ time of the file: the run was in virtual time");
    }
}

fn batch(cell: &CellFound) -> String {
    let batch = cell.batch.as_ref();
    batch.map_or_else(String::new, |batch| format!("batch {batch}  "))
}

/// Cells, a line each.
pub(super) fn cells(cells: &[CellFound]) {
    for cell in cells {
        let serial = cell.serial.as_deref().unwrap_or("no serial number");
        say!(
            "{}  {serial}  {}{} runs, {} to {}",
            cell.cell,
            batch(cell),
            cell.runs,
            utc(cell.first_unix_s),
            utc(cell.last_unix_s)
        );
    }
    if cells.is_empty() {
        say!("no cell meets these conditions");
    }
}

/// All that is known of a run.
pub(super) fn run(shown: &RunShown) {
    let run = &shown.run;
    let or = |text: &Option<String>| text.clone().unwrap_or_else(|| "-".to_owned());
    let missing = if run.missing { " (missing)" } else { "" };
    say!("run         {}", run.run);
    say!("folder      {}{missing}", run.folder);
    say!("experiment  {}", run.experiment);
    say!(
        "bench       {}{}",
        run.bench,
        if run.simulated { ", simulated" } else { "" }
    );
    run.cells.iter().for_each(cell);
    say!("operator    {}", or(&run.operator));
    say!("began      {}", time(run.started_unix_s, run.time_source));
    say!("ended       {}", or(&run.how));
    say!("verdict     {}", run.verdict.label());
    say!("version     {}", run.version);
    say!("seed        {}", run.seed);
    say!("config      {}", or(&run.config_sha256));
    say!("{SUMS}  {}", or(&run.content_sha256));
    instruments(&shown.instruments);
    for reason in &run.damage {
        say!("damaged     {reason}");
    }
    for one in &shown.spectra {
        say!(
            "spectrum    {}  {}  {} points, {} refused",
            one.file,
            one.cell,
            one.points,
            one.refused_points
        );
    }
    for fit in &shown.fits {
        say!(
            "fit         {}  R {}, DC resistance {}",
            fit.file,
            milliohm(Some(fit.r_ohm), fit.r_sigma_ohm),
            milliohm(Some(fit.dc_resistance_ohm), fit.dc_resistance_sigma_ohm)
        );
    }
    if let Some(map) = &run.map {
        say!("fit         {MAP}  {}", map_text(map));
    }
    for event in &shown.events {
        let by = event
            .by
            .as_ref()
            .map_or_else(String::new, |by| format!(" by {by}"));
        say!(
            "event       {:.3} s  {}{by}  {}",
            event.time_s,
            event.kind.label(),
            event.text
        );
    }
    for one in &shown.diagnoses {
        let cell = one.cell.as_ref();
        let cell = cell.map_or_else(String::new, |cell| format!("{cell}: "));
        let words = one.damage.as_ref().unwrap_or(&one.summary);
        say!("diagnosis   {}  {cell}{words}", one.folder);
    }
}

/// Prints a cell with its known properties.
fn cell(cell: &CatalogCell) {
    let facts = [
        ("serial number read", &cell.scanned_serial),
        ("type", &cell.model),
        ("batch", &cell.batch),
        ("barcode", &cell.barcode),
        ("maker", &cell.maker),
        ("chemistry", &cell.chemistry),
        ("term", &cell.term),
    ];
    let known = facts.iter().filter_map(|(name, fact)| {
        let fact = fact.as_ref()?;
        Some(format!("; {name} {fact}"))
    });
    say!("cell        {}{}", named(cell), known.collect::<String>());
}

/// Prints the instruments of a run: role on the bench, model, and the instrument's
/// identification.
fn instruments(all: &Value) {
    for one in all.as_array().into_iter().flatten() {
        let facts = ["/role", "/model", "/identity/raw"];
        let texts = facts.map(|fact| one.pointer(fact).and_then(Value::as_str).unwrap_or("-"));
        say!("instrument  {}", texts.join("  "));
    }
}

fn milliohm(ohm: Option<f64>, sigma_ohm: Option<f64>) -> String {
    with_sigma(ohm, sigma_ohm, 1.0e3, "mΩ")
}

fn with_sigma(value: Option<f64>, sigma: Option<f64>, factor: f64, unit: &str) -> String {
    let Some(value) = value else {
        return "-".to_owned();
    };
    let sigma = sigma.map_or_else(String::new, |sigma| {
        format!(" ± {}", significant(factor * sigma, 2))
    });
    format!("{}{sigma} {unit}", significant(factor * value, DIGITS))
}

/// A cell over its runs.
pub(super) fn ageing(ageing: &Ageing) {
    let rc = ageing.rc.map_or_else(String::new, |rc| rc.to_string());
    say!(
        "{}: {} models with {rc} RC pairs",
        ageing.cell,
        ageing.points.len()
    );
    for one in &ageing.points {
        let fit = &one.fit;
        say!(
            "{}  {}  R {}  DC {}  slowest pair {}, {}",
            time(fit.started_unix_s, fit.time_source),
            fit.name,
            milliohm(Some(fit.r_ohm), fit.r_sigma_ohm),
            milliohm(Some(fit.dc_resistance_ohm), fit.dc_resistance_sigma_ohm),
            milliohm(fit.slow_r_ohm, fit.slow_r_sigma_ohm),
            with_sigma(fit.slow_tau_s, fit.slow_tau_sigma_s, 1.0, "s")
        );
        for parameter in &one.diffusion {
            say!(
                "    {} {}: {}",
                parameter.effect,
                parameter.name,
                with_sigma(Some(parameter.value), parameter.sigma, 1.0, &parameter.unit)
            );
        }
    }
}
