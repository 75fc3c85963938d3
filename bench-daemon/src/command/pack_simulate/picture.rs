//! Plots of packs with different cells: bands over time, and the distribution of the worst cells.

use bench_core::safety::failure::Failure;
use bench_evaluate::{files, support::present::titled};
use std::path::Path;

use analysis::{
    forward::{
        Demand,
        pack::{BandRow, Outcome, Percentiles, Scatter, ScatterSetup},
    },
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
};

/// Writes `bands` and `distribution` as SVG and PNG.
pub(super) fn write(out: &Path, setup: &ScatterSetup<'_>, met: &Scatter) -> Result<(), Failure> {
    for (name, picture) in [
        ("bands", bands(setup, met)),
        ("distribution", distribution(setup, met)),
    ] {
        files::write_chart(out, name, &picture)?;
    }
    Ok(())
}

fn bands(setup: &ScatterSetup<'_>, met: &Scatter) -> Chart {
    let (factor, name) = match setup.profile.demand {
        Demand::Power => (1e-3, "Power / kW"),
        Demand::Current => (1.0, "Current / A"),
        Demand::Resistance => (1.0, "Load / Ω"),
    };
    let demand = met
        .bands
        .iter()
        .map(|r| (r.time_s, factor * r.demand))
        .collect();
    let line = |of: fn(&BandRow) -> f64| -> Vec<(f64, f64)> {
        met.bands.iter().map(|r| (r.time_s, of(r))).collect()
    };
    let band = |label: &str, colour, of: fn(&BandRow) -> &Percentiles| {
        let points = met
            .bands
            .iter()
            .map(|r| (r.time_s, 0.5 * (of(r).p5 + of(r).p95)))
            .collect();
        let spread = met
            .bands
            .iter()
            .map(|r| 0.5 * (of(r).p95 - of(r).p5))
            .collect();
        Trace::new(label, colour, TraceStyle::Band, points).with_spread(spread)
    };
    let mut voltages = vec![
        band("highest cell, 5 to 95 % of the packs", 2, |r| &r.highest_v),
        band("lowest cell, 5 to 95 % of the packs", 1, |r| &r.lowest_v),
        Trace::new(
            "identical cells",
            0,
            TraceStyle::Line,
            line(|r| r.identical_v),
        ),
    ];
    let (low, high) = (setup.window.low_v, setup.window.high_v);
    let ends = (
        met.bands.first().map_or(0.0, |r| r.time_s),
        met.bands.last().map_or(0.0, |r| r.time_s),
    );
    // A limit far away would squeeze the curves.
    for (limit, margin) in [
        (low, met.identical.margin_low_v),
        (high, met.identical.margin_high_v),
    ] {
        if margin < 0.3 {
            voltages.push(Trace::new(
                "limit of a cell",
                5,
                TraceStyle::Dashed,
                vec![(ends.0, limit), (ends.1, limit)],
            ));
        }
    }
    let time = || AxisSpec::linear("Time / s");
    let mut panels = vec![
        Panel {
            aspect: 0.22,
            ..Panel::new(
                time(),
                AxisSpec::linear(name),
                vec![Trace::new("", 0, TraceStyle::Line, demand)],
            )
        },
        Panel::new(time(), AxisSpec::linear("Cell voltage / V"), voltages),
    ];
    if !setup.thermal.held {
        // Bands may be too thin to see.
        let median =
            |colour, of: fn(&BandRow) -> f64| Trace::new("", colour, TraceStyle::Line, line(of));
        let temperatures = vec![
            band("hottest cell, 5 to 95 % of the packs", 3, |r| {
                &r.hottest_degc
            }),
            band("coldest cell, 5 to 95 % of the packs", 4, |r| {
                &r.coldest_degc
            }),
            median(3, |r| r.hottest_degc.p50),
            median(4, |r| r.coldest_degc.p50),
        ];
        panels.push(Panel {
            aspect: 0.3,
            ..Panel::new(time(), AxisSpec::linear("Temperature / °C"), temperatures)
        });
    }
    Chart::new(
        &titled(
            &format!("{} of cells that differ", setup.pack.name()),
            &setup.profile.name,
        ),
        &subtitle(met),
        panels,
    )
}

fn distribution(setup: &ScatterSetup<'_>, met: &Scatter) -> Chart {
    let panel = |name: &str, colour: usize, of: fn(&Outcome) -> f64| {
        let mut sorted: Vec<f64> = met.outcomes.iter().map(of).collect();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len() as f64;
        let points = sorted
            .iter()
            .enumerate()
            .map(|(k, v)| (*v, (k as f64 + 0.5) / n))
            .collect();
        let identical = of(&met.identical);
        let traces = vec![
            Trace::new("packs drawn", colour, TraceStyle::Line, points),
            Trace::new(
                "identical cells",
                5,
                TraceStyle::Dashed,
                vec![(identical, 0.0), (identical, 1.0)],
            ),
        ];
        Panel {
            aspect: 0.3,
            ..Panel::new(
                AxisSpec::linear(name),
                AxisSpec::linear("Share below").between(0.0, 1.0),
                traces,
            )
        }
    };
    let mut panels = vec![
        panel("Lowest voltage of any cell / V", 1, |o| o.min_cell_v),
        panel("Largest current of any cell / mean current", 1, |o| {
            o.largest_share
        }),
        panel("Adiabatic rise of the hottest cell / K", 1, |o| {
            o.hottest_rise_k
        }),
    ];
    if !setup.thermal.held {
        panels.push(panel("Highest temperature of any cell / °C", 1, |o| {
            o.temperatures.hottest_degc
        }));
    }
    // One entry in the legend is enough for all panels.
    panels
        .iter_mut()
        .skip(1)
        .flat_map(|p| &mut p.traces)
        .for_each(|t| t.label = None);
    Chart::new(
        &titled(
            &format!("Worst cells of {} packs", setup.pack.name()),
            &setup.profile.name,
        ),
        &subtitle(met),
        panels,
    )
}

fn subtitle(met: &Scatter) -> String {
    format!(
        "{} packs drawn; {:.1} % leave the window or lack power",
        met.outcomes.len(),
        100.0 * met.leaving().0
    )
}
