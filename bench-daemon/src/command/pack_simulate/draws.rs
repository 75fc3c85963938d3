//! The draws of `pack simulate` as a table.

use std::path::Path;

use analysis::{
    dataset::{self, ColumnSpec},
    forward::pack::{Outcome, Scatter},
};
use bench_core::safety::failure::Failure;

/// Writes `draws.parquet`, a row for each draw.
pub(super) fn write(out: &Path, met: &Scatter) -> Result<(), Failure> {
    type Column = (ColumnSpec, fn(&Outcome) -> f64);
    let spec = |name, unit, doc| ColumnSpec { name, unit, doc };
    let columns: [Column; 19] = [
        (spec("min_cell_v", "V", "lowest voltage of any cell"), |o| {
            o.min_cell_v
        }),
        (spec("min_cell_time_s", "s", "when"), |o| o.min_cell_time_s),
        (spec("min_cell_group", "1", "its group, from 1"), |o| {
            o.min_cell_group as f64
        }),
        (
            spec("max_cell_v", "V", "highest voltage of any cell"),
            |o| o.max_cell_v,
        ),
        (spec("min_ccv_v", "V", "lowest voltage of the pack"), |o| {
            o.min_ccv_v
        }),
        (
            spec(
                "largest_cell_a",
                "A",
                "largest current of any cell, without sign",
            ),
            |o| o.largest_cell_a,
        ),
        (
            spec(
                "largest_share",
                "1",
                "largest current of any cell over the largest mean",
            ),
            |o| o.largest_share,
        ),
        (
            spec(
                "soc_spread_end",
                "1",
                "highest less lowest SOC at the end; NaN for a held OCV",
            ),
            |o| o.soc_spread_end.unwrap_or(f64::NAN),
        ),
        (
            spec(
                "hottest_rise_k",
                "K",
                "adiabatic temperature rise of the hottest cell",
            ),
            |o| o.hottest_rise_k,
        ),
        (
            spec("hottest_degc", "degC", "highest temperature of any cell"),
            |o| o.temperatures.hottest_degc,
        ),
        (spec("hottest_time_s", "s", "when"), |o| {
            o.temperatures.hottest_time_s
        }),
        (spec("hottest_group", "1", "its group, from 1"), |o| {
            o.temperatures.hottest.group as f64
        }),
        (
            spec("hottest_place", "1", "its place in the group, from 1"),
            |o| o.temperatures.hottest.place as f64,
        ),
        (
            spec(
                "lowest_peak_degc",
                "degC",
                "highest temperature of the cell that stays coldest",
            ),
            |o| o.temperatures.lowest_peak_degc,
        ),
        (
            spec("coldest_group", "1", "the group of that cell, from 1"),
            |o| o.temperatures.coldest.group as f64,
        ),
        (
            spec("coldest_place", "1", "its place in the group, from 1"),
            |o| o.temperatures.coldest.place as f64,
        ),
        (
            spec(
                "temperature_spread_k",
                "K",
                "largest difference between two cells at one instant",
            ),
            |o| o.temperatures.spread_k,
        ),
        (
            spec(
                "interconnect_heat_j",
                "J",
                "heat of the interconnect and of the tabs",
            ),
            |o| o.interconnect_heat_j,
        ),
        (spec("feasible", "1", "1 if all power was available"), |o| {
            f64::from(u8::from(o.feasible))
        }),
    ];
    let values: Vec<(ColumnSpec, Vec<f64>)> = columns
        .into_iter()
        .map(|(s, of)| (s, met.outcomes.iter().map(of).collect()))
        .collect();
    let columns: Vec<(ColumnSpec, &[f64])> =
        values.iter().map(|(s, v)| (*s, v.as_slice())).collect();
    dataset::write_columns_parquet(&out.join("draws.parquet"), &columns)
        .map_err(|error| Failure::Analysis(error.to_string()))
}
