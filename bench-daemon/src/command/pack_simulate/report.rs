//! Results of `pack simulate`, as `--json` prints them.

use std::path::PathBuf;

use analysis::{
    forward::{
        CellWindow, OcvSource,
        pack::{
            LeftMap, Outcome, PackThermal, Percentiles, Position, Scatter, ScatterSetup, Spread,
            Temperatures,
        },
    },
    given::GivenModel,
    map::Outside,
    pack::Pack,
};
use serde::Serialize;

use super::args::PackSimulateArgs;
use super::cells::Means;
use super::heat;
use bench_evaluate::files;

/// State at the start.
pub(super) struct Start {
    /// Open-circuit voltage of a cell.
    pub(super) ocv: OcvSource,
    pub(super) soc: f64,
    /// Voltage of a cell there, V.
    pub(super) ocv_v: f64,
}

/// Report that `--json` prints.
#[derive(Serialize)]
pub(super) struct PackReport {
    pub(super) profile: String,
    pub(super) model: String,
    #[serde(flatten)]
    pub(super) pack: Pack,
    pub(super) tab_ohm: f64,
    /// Resistance in series with the pack that equals the links, Ω; `None` without links.
    pub(super) links_ohm: Option<f64>,
    /// Open-circuit voltage of a cell at the start, V.
    pub(super) ocv_v: f64,
    pub(super) soc: Option<f64>,
    pub(super) window: CellWindow,
    /// Number of packs.
    pub(super) draws: usize,
    /// Seed of the draws; `None` if the cells were given.
    pub(super) seed: Option<u64>,
    /// `None` if the cells were given.
    pub(super) spread: Option<Spread>,
    /// The table that the cells are from.
    pub(super) cells: Option<PathBuf>,
    /// Population over which the figures are averaged.
    pub(super) means: Means,
    /// Share of the packs of which a cell leaves the window or that cannot deliver.
    pub(super) leaving_probability: f64,
    /// Its 95 % interval.
    pub(super) leaving_interval_95: [f64; 2],
    /// Fraction of the packs that cannot deliver the requested power.
    pub(super) short_of_power_probability: f64,
    pub(super) identical: Outcome,
    /// The draw with the lowest cell.
    pub(super) worst: Option<Outcome>,
    /// Its number, from 1.
    pub(super) worst_draw: Option<usize>,
    pub(super) min_cell_v: Percentiles,
    pub(super) max_cell_v: Percentiles,
    pub(super) margin_low_v: Percentiles,
    pub(super) margin_high_v: Percentiles,
    pub(super) largest_share: Percentiles,
    pub(super) largest_cell_a: Percentiles,
    pub(super) soc_spread_end: Option<Percentiles>,
    pub(super) hottest_rise_k: Percentiles,
    /// Where the heat goes.
    pub(super) thermal: PackThermal,
    /// Highest temperature of any cell, °C.
    pub(super) hottest_degc: Percentiles,
    /// Highest temperature of the cell that stays coldest, °C.
    pub(super) lowest_peak_degc: Percentiles,
    /// Largest difference between two cells at one instant, K.
    pub(super) temperature_spread_k: Percentiles,
    /// Heat of the interconnect and of the tabs, J.
    pub(super) interconnect_heat_j: Percentiles,
    /// Temperatures of the draw with the hottest cell.
    pub(super) hottest: Option<Temperatures>,
    /// Its number, from 1.
    pub(super) hottest_draw: Option<usize>,
    /// Largest distance of any cell outside the range of the map; `None` without a map.
    pub(super) outside_map: Option<OutsideMap>,
    /// Change of the lowest voltage with half the step, V.
    pub(super) step_error_v: f64,
    /// Change of the highest temperature with half the step, K.
    pub(super) step_error_k: f64,
    /// Steps of all packs whose equations were not solved to their tolerance.
    pub(super) unsettled_steps: u64,
    /// Warnings of the model's fit.
    pub(super) model_warnings: Vec<String>,
    /// Limits of the model, and the treatment of its additions.
    pub(super) notes: Vec<String>,
}

/// Largest distance outside the range of a map over all draws, and the cells that go there.
#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct OutsideMap {
    #[serde(flatten)]
    pub(super) outside: Outside,
    /// Draw that is farthest in state of charge, from 1, and its cell.
    pub(super) soc_draw: usize,
    pub(super) soc_cell: Position,
    /// Draw that is farthest in temperature, from 1, and its cell.
    pub(super) temperature_draw: usize,
    pub(super) temperature_cell: Position,
}

impl OutsideMap {
    fn of(met: &Scatter) -> Option<Self> {
        let farthest = |of: fn(&LeftMap) -> f64| {
            let left = met.outcomes.iter().enumerate();
            left.filter_map(|(draw, outcome)| Some((draw + 1, outcome.outside_map?)))
                .reduce(|most, next| {
                    if of(&next.1) > of(&most.1) {
                        next
                    } else {
                        most
                    }
                })
        };
        let (soc_draw, soc) = farthest(|left| left.outside.soc)?;
        let (temperature_draw, temperature) = farthest(|left| left.outside.temperature_k)?;
        Some(Self {
            outside: Outside {
                soc: soc.outside.soc,
                temperature_k: temperature.outside.temperature_k,
            },
            soc_draw,
            soc_cell: soc.soc_cell,
            temperature_draw,
            temperature_cell: temperature.temperature_cell,
        })
    }

    /// Returns a note; `None` if no cell leaves the range.
    fn note(&self) -> Option<String> {
        let mut cells = Vec::new();
        if self.outside.soc > 0.0 {
            let (draw, cell) = (self.soc_draw, self.soc_cell);
            cells.push(format!("in charge draw {draw}, {cell}"));
        }
        if self.outside.temperature_k > 0.0 {
            let (draw, cell) = (self.temperature_draw, self.temperature_cell);
            cells.push(format!("in temperature draw {draw}, {cell}"));
        }
        let outside = self.outside;
        (!cells.is_empty()).then(|| {
            let cells = cells.join("; ");
            format!("a cell {outside} ({cells}); there the resistances are extrapolated")
        })
    }
}

/// Spread of the cells by the arguments.
pub(super) fn spread(args: &PackSimulateArgs) -> Spread {
    Spread {
        r: args.sigma_r,
        rk: args.sigma_rk,
        ck: args.sigma_ck,
        capacity: args.sigma_capacity,
        soc: args.sigma_soc,
    }
}

/// Collects the results.
pub(super) fn report(
    setup: &ScatterSetup<'_>,
    model: &GivenModel,
    args: &PackSimulateArgs,
    met: &Scatter,
    means: Means,
    ocv_v: f64,
) -> PackReport {
    let over = |which: fn(&Outcome) -> f64| Percentiles::of(met.outcomes.iter().map(which));
    let (leaving_probability, leaving_interval_95) = met.leaving();
    let worst = met
        .outcomes
        .iter()
        .enumerate()
        .min_by(|a, b| a.1.min_cell_v.total_cmp(&b.1.min_cell_v));
    let soc = match setup.ocv {
        OcvSource::Constant(_) => None,
        OcvSource::Curve(_) => Some(setup.soc),
    };
    let hottest = met.outcomes.iter().enumerate().max_by(|a, b| {
        let degc = |outcome: &Outcome| outcome.temperatures.hottest_degc;
        degc(a.1).total_cmp(&degc(b.1))
    });
    let outside_map = OutsideMap::of(met);
    PackReport {
        profile: setup.profile.name.clone(),
        model: model.name.clone(),
        pack: setup.pack,
        tab_ohm: setup.tab_ohm,
        links_ohm: setup
            .links
            .map(|links| links.equivalent_ohm(setup.cell.r_ohm + setup.tab_ohm)),
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
        thermal: setup.thermal,
        hottest_degc: over(|o| o.temperatures.hottest_degc),
        lowest_peak_degc: over(|o| o.temperatures.lowest_peak_degc),
        temperature_spread_k: over(|o| o.temperatures.spread_k),
        interconnect_heat_j: over(|o| o.interconnect_heat_j),
        hottest: hottest.map(|(_, outcome)| outcome.temperatures),
        hottest_draw: hottest.map(|(index, _)| index + 1),
        step_error_v: met.step_error_v,
        step_error_k: met.step_error_k,
        unsettled_steps: unsettled(met),
        model_warnings: model.warnings.clone(),
        notes: notes(setup, model, args, outside_map.as_ref(), met),
        outside_map,
    }
}

/// Returns notes without which the results would mislead.
fn notes(
    setup: &ScatterSetup<'_>,
    model: &GivenModel,
    args: &PackSimulateArgs,
    outside_map: Option<&OutsideMap>,
    met: &Scatter,
) -> Vec<String> {
    let mut notes = model.notes();
    notes.extend(files::addition_notes(model));
    notes.extend(outside_map.and_then(OutsideMap::note));
    let cells_a = met.outcomes.iter().map(|outcome| outcome.largest_cell_a);
    let cell_a = cells_a.fold(0.0, f64::max);
    notes.extend(setup.map.and_then(|map| map.current_remark(cell_a)));
    let ranges = met.outcomes.iter().filter_map(|outcome| outcome.soc_range);
    let soc: Vec<f64> = ranges
        .flat_map(|range| [range.lowest, range.highest])
        .collect();
    let hottest = met.outcomes.iter().map(|o| o.temperatures.hottest_degc);
    let degc: Vec<f64> = hottest.chain([setup.thermal.ambient_degc]).collect();
    notes.extend(model.away_note(&soc, &degc));
    notes.extend(heat::notes(&args.heat, &setup.thermal, setup.map));
    let unsettled = unsettled(met);
    if unsettled > 0 {
        notes.push(format!(
            "{unsettled} steps of all packs ended before their currents and temperatures settled; \
            give a smaller --max-step-s"
        ));
    }
    notes
}

/// Counts the steps of all packs whose equations were not solved to their tolerance.
fn unsettled(met: &Scatter) -> u64 {
    let packs = met.outcomes.iter().chain([&met.identical]);
    packs.map(|outcome| outcome.unsettled_steps).sum()
}
