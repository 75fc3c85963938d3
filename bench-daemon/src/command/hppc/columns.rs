//! Pulse resistances as the columns of a table.

use analysis::{
    batch::{Cells, TableColumn},
    hppc::{Hppc, Pulse, Resistance},
};

/// A resistance, its pulse and its log.
struct Row<'a> {
    table: &'a Hppc,
    pulse: &'a Pulse,
    one: &'a Resistance,
}

/// One row for each pulse and time.
pub(super) fn columns(tables: &[&Hppc]) -> Vec<TableColumn> {
    let mut rows: Vec<Row<'_>> = Vec::new();
    for table in tables {
        for pulse in &table.pulses {
            rows.extend(
                pulse
                    .resistances
                    .iter()
                    .map(|one| Row { table, pulse, one }),
            );
        }
    }
    let texts = |name, of: &dyn Fn(&Row<'_>) -> Option<String>| TableColumn {
        name,
        cells: Cells::Texts(rows.iter().map(of).collect()),
    };
    let numbers = |name, of: &dyn Fn(&Row<'_>) -> Option<f64>| TableColumn {
        name,
        cells: Cells::Numbers(rows.iter().map(of).collect()),
    };
    let notes = |pulse: &Pulse| Some(pulse.notes.join("; ")).filter(|notes| !notes.is_empty());
    vec![
        texts("file", &|row| Some(row.table.name.clone())),
        numbers("start_s", &|row| Some(row.pulse.start_s)),
        texts("direction", &|row| {
            Some(row.pulse.direction.word().to_owned())
        }),
        numbers("current_a", &|row| Some(row.pulse.current_a)),
        numbers("base_a", &|row| {
            Some(row.pulse.state.base.map_or(0.0, |base| base.current_a))
        }),
        numbers("duration_s", &|row| Some(row.pulse.duration_s)),
        numbers("soc", &|row| row.pulse.state.soc.map(|soc| soc.value)),
        numbers("drawn_ah", &|row| row.pulse.state.drawn_ah),
        numbers("temperature_c", &|row| row.pulse.state.temperature_degc),
        numbers("ocv_v", &|row| {
            row.pulse.state.open_circuit.map(|ocv| ocv.v)
        }),
        numbers("sigma_ocv_v", &|row| {
            row.pulse.state.open_circuit.and_then(|ocv| ocv.sigma_v)
        }),
        numbers("at_s", &|row| Some(row.one.at_s)),
        numbers("row_s", &|row| row.one.found.map(|found| found.row_s)),
        numbers("r_ohm", &|row| row.one.found.map(|found| found.ohm)),
        numbers("sigma_ohm", &|row| {
            row.one.found.and_then(|found| found.sigma_ohm)
        }),
        numbers("start_ohm", &|row| {
            row.one.found.and_then(|found| found.start_ohm)
        }),
        numbers("power_w", &|row| {
            row.one.found.and_then(|found| found.power_w)
        }),
        numbers("sigma_power_w", &|row| {
            row.one.found.and_then(|found| found.power_sigma_w)
        }),
        texts("reason", &|row| row.one.reason.clone()),
        texts("notes", &|row| notes(row.pulse)),
    ]
}
