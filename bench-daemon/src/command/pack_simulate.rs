//! `eis-bench pack simulate`: a profile through packs of cells that differ.

mod args;
mod cells;
mod picture;

use std::path::{Path, PathBuf};

use analysis::{
    dataset::{self, ColumnSpec},
    formats::read_profile,
    forward::{
        CellWindow, OcvSource,
        pack::{
            Draws, Outcome, Percentiles, PlacedCell, Scatter, ScatterSetup, Spread, scatter,
            scatter_cells,
        },
    },
    given::GivenModel,
    pack::Pack,
};
use serde::Serialize;

use super::profile_args::taken;
pub use args::PackSimulateArgs;
use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use bench_plan::support::terminal::say;
use cells::cell;

/// Report that `--json` prints.
#[derive(Serialize)]
struct PackReport {
    profile: String,
    model: String,
    #[serde(flatten)]
    pack: Pack,
    tab_ohm: f64,
    /// Open-circuit voltage of a cell at the start, V.
    ocv_v: f64,
    soc: Option<f64>,
    window: CellWindow,
    /// Number of packs.
    draws: usize,
    /// Seed of the draws; `None` if the cells were given.
    seed: Option<u64>,
    /// `None` if the cells were given.
    spread: Option<Spread>,
    /// The table that the cells are from.
    cells: Option<PathBuf>,
    /// Population over which the figures are averaged.
    means: cells::Means,
    /// Share of the packs of which a cell leaves the window or that cannot deliver.
    leaving_probability: f64,
    /// Its 95 % interval.
    leaving_interval_95: [f64; 2],
    /// Fraction of the packs that cannot deliver the requested power.
    short_of_power_probability: f64,
    identical: Outcome,
    /// The draw with the lowest cell.
    worst: Option<Outcome>,
    /// Its number, from 1.
    worst_draw: Option<usize>,
    min_cell_v: Percentiles,
    max_cell_v: Percentiles,
    margin_low_v: Percentiles,
    margin_high_v: Percentiles,
    largest_share: Percentiles,
    largest_cell_a: Percentiles,
    soc_spread_end: Option<Percentiles>,
    hottest_rise_k: Percentiles,
    /// Change of the lowest voltage with half the step, V.
    step_error_v: f64,
    /// Warnings of the model's fit.
    model_warnings: Vec<String>,
    /// Limits of the model, and the treatment of its additions.
    notes: Vec<String>,
}

/// Simulates packs and prints how they fared.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn simulate(args: &PackSimulateArgs) -> Result<(), Failure> {
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
    let model = args.model.read(args.ocv.as_deref())?;
    let profile =
        read_profile(&args.profile, &args.read.options()).map_err(|error| usage(&error))?;
    let (ocv, soc) = start(args, &model)?;
    let cell = cell(&model, &ocv)?;
    let setup = ScatterSetup {
        cell: &cell,
        ocv: &ocv,
        pack: args.pack.pack()?,
        tab_ohm: args.tab_ohm,
        soc,
        profile: &profile,
        window: args.window.window(),
        thermal: args.thermal.mass(),
        max_step_s: args
            .max_step_s
            .unwrap_or_else(|| (profile.duration_s() / 2000.0).max(1e-3)),
    };
    let spread = spread(args);
    let draws = Draws {
        draws: args.draws,
        seed: args.seed,
    };
    let packs = cells::packs(args, &setup, &spread, draws)?;
    let met = match &packs {
        Some(packs) if args.cells.is_some() => scatter_cells(&setup, packs),
        _ => scatter(&setup, &spread, draws),
    };
    let met = met.map_err(|error| usage(&error))?;
    let report = report(
        &setup,
        &model,
        args,
        &met,
        cells::Means::new(args, &setup, packs.as_deref()),
    );
    let json = serde_json::to_string_pretty(&report)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    if let Some(out) = &args.out {
        files::make_folder(out)?;
        files::write_text(out, "pack.json", &format!("{json}\n"))?;
        write_draws(out, &met)?;
        picture::write(out, &setup, &met)?;
    }
    if args.json {
        say!("{json}");
        return Ok(());
    }
    print_text(&report, &setup, packs.as_deref());
    if let Some(out) = &args.out {
        say!("written to {}", out.display());
    }
    Ok(())
}

fn spread(args: &PackSimulateArgs) -> Spread {
    Spread {
        r: args.sigma_r,
        rk: args.sigma_rk,
        ck: args.sigma_ck,
        capacity: args.sigma_capacity,
        soc: args.sigma_soc,
    }
}

/// The open-circuit voltage and the state of charge at the start.
fn start(args: &PackSimulateArgs, model: &GivenModel) -> Result<(OcvSource, f64), Failure> {
    match (&model.ocv, args.soc, args.ocv_v) {
        (Some(curve), Some(soc), _) => Ok((OcvSource::Curve(curve.clone()), soc)),
        (Some(curve), None, Some(ocv_v)) => {
            let soc = curve.soc_at(ocv_v).ok_or_else(|| {
                Failure::Usage(format!(
                    "--ocv-v {ocv_v}: the model's OCV curve does not reach it"
                ))
            })?;
            Ok((OcvSource::Curve(curve.clone()), soc))
        }
        (None, None, Some(ocv_v)) if ocv_v.is_finite() && ocv_v > 0.0 => {
            Ok((OcvSource::Constant(ocv_v), 0.5))
        }
        (None, Some(_), _) => Err(Failure::Usage(format!(
            "--soc: {} holds no OCV curve; give --ocv-v, or a curve with --ocv",
            args.model.told()
        ))),
        _ => Err(Failure::Usage(
            "--ocv-v: expected a voltage above 0 V".to_owned(),
        )),
    }
}

fn report(
    setup: &ScatterSetup<'_>,
    model: &GivenModel,
    args: &PackSimulateArgs,
    met: &Scatter,
    means: cells::Means,
) -> PackReport {
    let over = |which: fn(&Outcome) -> f64| Percentiles::of(met.outcomes.iter().map(which));
    let (leaving_probability, leaving_interval_95) = met.leaving();
    let worst = met
        .outcomes
        .iter()
        .enumerate()
        .min_by(|a, b| a.1.min_cell_v.total_cmp(&b.1.min_cell_v));
    let (ocv_v, soc) = match setup.ocv {
        OcvSource::Constant(v) => (*v, None),
        OcvSource::Curve(curve) => (curve.voltage_v(setup.soc), Some(setup.soc)),
    };
    PackReport {
        profile: setup.profile.name.clone(),
        model: model.name.clone(),
        pack: setup.pack,
        tab_ohm: setup.tab_ohm,
        ocv_v,
        soc,
        window: setup.window,
        draws: met.outcomes.len(),
        seed: args.cells.is_none().then_some(args.seed),
        spread: args.cells.is_none().then(|| spread(args)),
        cells: args.cells.clone(),
        means,
        leaving_probability,
        leaving_interval_95,
        short_of_power_probability: met.short_of_power(),
        identical: met.identical.clone(),
        worst: worst.map(|(_, outcome)| outcome.clone()),
        worst_draw: worst.map(|(index, _)| index + 1),
        min_cell_v: over(|o| o.min_cell_v),
        max_cell_v: over(|o| o.max_cell_v),
        margin_low_v: over(|o| o.margin_low_v),
        margin_high_v: over(|o| o.margin_high_v),
        largest_share: over(|o| o.largest_share),
        largest_cell_a: over(|o| o.largest_cell_a),
        soc_spread_end: soc
            .map(|_| Percentiles::of(met.outcomes.iter().filter_map(|o| o.soc_spread_end))),
        hottest_rise_k: over(|o| o.hottest_rise_k),
        step_error_v: met.step_error_v,
        model_warnings: model.warnings.clone(),
        notes: model
            .notes()
            .into_iter()
            .chain(files::addition_notes(model))
            .collect(),
    }
}

fn print_text(r: &PackReport, setup: &ScatterSetup<'_>, packs: Option<&[Vec<PlacedCell>]>) {
    let start = r
        .soc
        .map_or_else(|| "held".to_owned(), |soc| format!("SOC {soc:.3}"));
    say!(
        "{} under {}, {:.2} s, from {:.3} V per cell ({start}); {} {}, {}",
        r.pack.name(),
        r.profile,
        setup.profile.duration_s(),
        r.ocv_v,
        r.draws,
        if r.draws == 1 { "pack" } else { "packs" },
        r.seed.map_or_else(
            || "cells as given".to_owned(),
            |seed| format!("seed {seed}")
        )
    );
    say!("  {}", taken(setup.profile));
    say!(
        "  {:<26}{:>10}{:>10}{:>10}{:>10}",
        "",
        "identical",
        "median",
        "5 %",
        "95 %"
    );
    let row = |name: &str, identical: f64, p: &Percentiles, digits: usize| {
        say!(
            "  {name:<26}{identical:>10.digits$}{:>10.digits$}{:>10.digits$}{:>10.digits$}",
            p.p50,
            p.p5,
            p.p95
        );
    };
    row("lowest cell / V", r.identical.min_cell_v, &r.min_cell_v, 4);
    row(
        "margin to lower limit / V",
        r.identical.margin_low_v,
        &r.margin_low_v,
        4,
    );
    row("highest cell / V", r.identical.max_cell_v, &r.max_cell_v, 4);
    row(
        "margin to upper limit / V",
        r.identical.margin_high_v,
        &r.margin_high_v,
        4,
    );
    row(
        "largest cell current / A",
        r.identical.largest_cell_a,
        &r.largest_cell_a,
        2,
    );
    row(
        "its part of the mean",
        r.identical.largest_share,
        &r.largest_share,
        4,
    );
    if let Some(spread) = &r.soc_spread_end {
        row(
            "SOC apart at the end / %",
            100.0 * r.identical.soc_spread_end.unwrap_or(0.0),
            &percent(spread),
            3,
        );
    }
    row(
        "hottest cell, adiabatic / K",
        r.identical.hottest_rise_k,
        &r.hottest_rise_k,
        3,
    );
    let [low, high] = r.leaving_interval_95;
    say!(
        "  leaving {} to {} V or short of power: {:.1} % of the packs (95 % interval {:.1} to \
        {:.1} %); short of power {:.1} %",
        r.window.low_v,
        r.window.high_v,
        100.0 * r.leaving_probability,
        100.0 * low,
        100.0 * high,
        100.0 * r.short_of_power_probability
    );
    if let Some(worst) = &r.worst {
        say!(
            "  worst draw: {:.4} V in group {} after {:.3} s",
            worst.min_cell_v,
            worst.min_cell_group,
            worst.min_cell_time_s
        );
        if let Some(names) =
            packs.and_then(|packs| cells::lowest(packs, r.worst_draw, worst, setup.pack))
        {
            say!("  its cells: {names}");
        }
    }
    r.means.print();
    if r.soc.is_none() {
        say!(
            "  note: the OCV is held, so that spread of capacity and state of charge has no effect"
        );
    }
    for warning in &r.model_warnings {
        say!("  note: of the model's fit: {warning}");
    }
    for note in &r.notes {
        say!("  note: {note}");
    }
    if r.step_error_v > 1e-3 {
        say!(
            "  note: half the step moves the lowest voltage by {:.1} mV; give a smaller \
            --max-step-s",
            1.0e3 * r.step_error_v
        );
    }
}

fn percent(p: &Percentiles) -> Percentiles {
    Percentiles {
        p1: 100.0 * p.p1,
        p5: 100.0 * p.p5,
        p50: 100.0 * p.p50,
        p95: 100.0 * p.p95,
        p99: 100.0 * p.p99,
    }
}

fn write_draws(out: &Path, met: &Scatter) -> Result<(), Failure> {
    type Column = (ColumnSpec, fn(&Outcome) -> f64);
    let spec = |name, unit, doc| ColumnSpec { name, unit, doc };
    let columns: [Column; 10] = [
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
