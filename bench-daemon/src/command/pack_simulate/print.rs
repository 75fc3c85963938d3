//! Results of `pack simulate` as text.

use analysis::forward::pack::{Percentiles, PlacedCell, ScatterSetup};

use super::super::profile_args::taken;
use super::cells::lowest;
use super::links;
use super::report::PackReport;
use bench_plan::support::terminal::say;

/// Prints the report as text.
pub(super) fn print(r: &PackReport, setup: &ScatterSetup<'_>, packs: Option<&[Vec<PlacedCell>]>) {
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
    print_temperatures(r);
    if let (Some(loads), Some(ohm)) = (&r.identical.links, r.links_ohm) {
        links::print_loads(loads, ohm);
    }
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
        if let Some(names) = packs.and_then(|packs| lowest(packs, r.worst_draw, worst, setup.pack))
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
    if r.step_error_k > 0.1 {
        say!(
            "  note: half the step moves the highest temperature by {:.2} K; give a smaller \
            --max-step-s",
            r.step_error_k
        );
    }
    if r.step_error_v > 1e-3 {
        say!(
            "  note: half the step moves the lowest voltage by {:.1} mV; give a smaller \
            --max-step-s",
            1.0e3 * r.step_error_v
        );
    }
}

fn row(name: &str, identical: f64, p: &Percentiles, digits: usize) {
    say!(
        "  {name:<26}{identical:>10.digits$}{:>10.digits$}{:>10.digits$}{:>10.digits$}",
        p.p50,
        p.p5,
        p.p95
    );
}

fn print_temperatures(r: &PackReport) {
    let identical = &r.identical.temperatures;
    if !r.thermal.held {
        row(
            "hottest cell / °C",
            identical.hottest_degc,
            &r.hottest_degc,
            2,
        );
        row(
            "coldest cell / °C",
            identical.lowest_peak_degc,
            &r.lowest_peak_degc,
            2,
        );
        let spread = &r.temperature_spread_k;
        row("cells apart / K", identical.spread_k, spread, 3);
    }
    let joule = r.identical.interconnect_heat_j;
    row("interconnect heat / J", joule, &r.interconnect_heat_j, 1);
    if let (Some(hottest), Some(draw), false) = (&r.hottest, r.hottest_draw, r.thermal.held) {
        say!(
            "  hottest draw {draw}: {:.2} °C in {} after {:.3} s; its coldest cell, {}, reaches \
            {:.2} °C",
            hottest.hottest_degc,
            hottest.hottest,
            hottest.hottest_time_s,
            hottest.coldest,
            hottest.lowest_peak_degc
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
