//! The trace of a simulation as Parquet.

use std::path::Path;

use crate::dataset::{self, ColumnSpec, DatasetError};
use analysis_forward::forward::{CellWindow, TRACE_BRANCHES, Trace};

/// Names of the branches' columns.
const BRANCHES: [&str; TRACE_BRANCHES] = [
    "v1_v", "v2_v", "v3_v", "v4_v", "v5_v", "v6_v", "v7_v", "v8_v", "v9_v", "v10_v", "v11_v",
    "v12_v", "v13_v", "v14_v", "v15_v", "v16_v",
];

/// Writes a trace as Parquet: columns as in [`Trace`], the signed margins of a cell to a window,
/// and the branches as `v1_v`, `v2_v`, … (at most [`TRACE_BRANCHES`]).
///
/// # Errors
/// [`DatasetError`] if the file cannot be written.
pub fn write_trace_parquet(
    path: &Path,
    trace: &Trace,
    window: CellWindow,
) -> Result<(), DatasetError> {
    let low: Vec<f64> = trace
        .cell_v
        .iter()
        .map(|v| window.margin_low_v(*v))
        .collect();
    let high: Vec<f64> = trace
        .cell_v
        .iter()
        .map(|v| window.margin_high_v(*v))
        .collect();
    let spec = |name, unit, doc| ColumnSpec { name, unit, doc };
    let mut columns = vec![
        (
            spec("time_s", "s", "time; stands twice where the demand jumps"),
            trace.time_s.as_slice(),
        ),
        (
            spec("demand_w", "W", "power asked for, discharge positive"),
            &trace.demand_w,
        ),
        (
            spec(
                "power_w",
                "W",
                "power delivered at the terminals, discharge positive",
            ),
            &trace.power_w,
        ),
        (
            spec("current_a", "A", "current, discharge positive"),
            &trace.current_a,
        ),
        (spec("ccv_v", "V", "voltage at the terminals"), &trace.ccv_v),
        (
            spec(
                "cell_v",
                "V",
                "mean voltage of a cell, without the interconnect",
            ),
            &trace.cell_v,
        ),
        (
            spec(
                "margin_low_v",
                "V",
                "voltage of a cell above its lower limit, negative below it",
            ),
            &low,
        ),
        (
            spec(
                "margin_high_v",
                "V",
                "voltage of a cell below its upper limit, negative above it",
            ),
            &high,
        ),
        (
            spec("ocv_v", "V", "open-circuit voltage at the terminals"),
            &trace.ocv_v,
        ),
        (
            spec(
                "soc",
                "1",
                "state of charge; NaN for a constant open-circuit voltage",
            ),
            &trace.soc,
        ),
    ];
    let of_map = [
        (
            spec("temperature_degc", "°C", "temperature of the cells"),
            trace.temperature_degc.as_slice(),
        ),
        (
            spec(
                "cell_sigma_v",
                "V",
                "standard deviation of cell_v by the error of the map; 1.96 times holds 95 %",
            ),
            &trace.cell_sigma_v,
        ),
    ];
    columns.extend(of_map.into_iter().filter(|(_, values)| !values.is_empty()));
    let branches = trace.v_rc_v.iter().zip(BRANCHES);
    columns.extend(branches.map(|(v, name)| {
        (
            spec(
                name,
                "V",
                "voltage over an RC branch, positive after a discharge",
            ),
            v.as_slice(),
        )
    }));
    dataset::write_columns_parquet(path, &columns)
}
