//! The procedures of the thesis, each a pure function from parameters to stages of a plan.

mod biased;
mod campaign;
mod eis_sweep;
mod map;
mod multisine;
mod ocv_soc;
mod power;
mod soc_reset;
mod temperature;
mod trace;

use std::sync::Arc;

use instruments::{
    fixture::Fixture,
    instrument::by_key,
    scope,
    units::{Amps, Seconds},
};

use crate::{
    config::{Eis, Experiment, Instrument},
    plan::{Plan, SweepSettings},
};

use power::Power;

/// Returns the whole experiment as a plan: fixture check, temperature, OCV over SOC, SOC reset,
/// then rounds of one sweep and each trace, as often as each is to be repeated. In a campaign
/// every run has temperature, SOC reset, temperature again, sweep and traces; in a map every point
/// has its charge, its temperature, sweep, multisine and pulses. The controls come first, so that the
/// cell is put into the jig once, after the last of them, and no fixture must be clamped in the place
/// of the cell afterwards.
pub fn plan(experiment: &Experiment) -> Plan {
    let mut stages = Vec::new();
    let power = Power::of(experiment);
    let settings = experiment.eis.as_ref().map(|eis| Arc::new(settings(eis)));
    let limits = &experiment.cell.limits;
    let beyond_hz = experiment
        .fixture_check
        .as_ref()
        .map_or(&[][..], |check| &check.beyond_hz);
    let sweep = |fixture, repeat, [bias_a, amplitude_a]: [Amps; 2]| {
        let (eis, settings) = experiment.eis.as_ref().zip(settings.as_ref())?;
        let sweep = eis_sweep::Sweep {
            fixture,
            repeat,
            amplitude_a,
            bias_a,
            power,
            beyond_hz,
            seed: experiment.seed,
            settings,
        };
        Some(eis_sweep::stage(&sweep, eis, limits, time_base(experiment)))
    };
    let amplitude_a = experiment
        .eis
        .as_ref()
        .map_or(Amps::ZERO, |eis| eis.amplitude_a);
    for (control, _) in experiment
        .fixture_check
        .iter()
        .flat_map(|check| &check.controls)
    {
        stages.extend(sweep(*control, 0, [Amps::ZERO, amplitude_a]));
    }
    let temperature = experiment.temperature.as_ref().map(temperature::stage);
    if let Some(campaign) = &experiment.campaign {
        let reset = experiment.soc_reset.as_ref().map(soc_reset::stage);
        for run in campaign.runs() {
            let traces = experiment.traces.iter().map(|trace| {
                trace::stage(
                    trace,
                    run.number,
                    &experiment.cell,
                    power,
                    time_base(experiment),
                )
            });
            // A reset at another temperature ends at another charge, and its currents warm the
            // cell: the temperature is held before and after it.
            let reset = temperature
                .clone()
                .filter(|_| reset.is_some())
                .into_iter()
                .chain(reset.clone());
            let parts = reset
                .chain(temperature.clone())
                .chain(sweep(Fixture::Cell, run.number, [Amps::ZERO, amplitude_a]))
                .chain(traces);
            stages.extend(parts.map(|stage| campaign::of_run(stage, &run)));
        }
        return Plan { stages };
    }
    if let Some(mapped) = mapped(experiment, power) {
        for (run, place) in mapped.map.runs().zip(&mapped.map.places) {
            let Some(point) = run.point else { continue };
            let swept = experiment.eis.as_ref();
            let swept = swept.filter(|eis| eis.repeat > 0 && place.spectrum);
            let multisine = experiment.multisine.as_ref().filter(|_| place.spectrum);
            let multisine = multisine.map(|multisine| {
                let asked = multisine::Asked {
                    multisine,
                    repeat: run.number,
                    bias_a: Amps::ZERO,
                    seed: experiment.seed,
                };
                multisine::stage(&asked, limits, power)
            });
            let parts = mapped
                .approach(&run, &point)
                .into_iter()
                .chain(
                    swept.and_then(|_| sweep(Fixture::Cell, run.number, [Amps::ZERO, amplitude_a])),
                )
                .chain(multisine)
                .chain(mapped.pulses(&run, &point, &time_base(experiment)).0);
            stages.extend(parts.map(|stage| campaign::of_run(stage, &run)));
        }
        return Plan { stages };
    }
    stages.extend(temperature);
    if let Some(ocv) = &experiment.ocv_soc {
        stages.push(ocv_soc::stage(ocv, &experiment.cell));
    }
    if let Some(reset) = &experiment.soc_reset {
        stages.push(soc_reset::stage(reset));
    }
    let sweeps = experiment.eis.as_ref().map_or(0, |eis| eis.repeat);
    let sweeps = experiment
        .multisine
        .as_ref()
        .map_or(sweeps, |multisine| sweeps.max(multisine.repeat));
    let rounds = experiment
        .traces
        .iter()
        .map(|trace| trace.repeat)
        .fold(sweeps, usize::max);
    for round in 1..=rounds {
        for eis in experiment.eis.iter().filter(|eis| round <= eis.repeat) {
            let sweeps = eis.sweeps_of(round);
            let before = (round - 1) * sweeps.len();
            stages.extend(
                sweeps
                    .into_iter()
                    .enumerate()
                    .filter_map(|(k, currents_a)| sweep(eis.fixture, before + k + 1, currents_a)),
            );
        }
        let due = experiment
            .multisine
            .iter()
            .filter(|multisine| round <= multisine.repeat);
        for multisine in due {
            let levels_a = multisine.levels_of(round);
            let before = (round - 1) * levels_a.len();
            stages.extend(levels_a.into_iter().enumerate().map(|(k, bias_a)| {
                let asked = multisine::Asked {
                    multisine,
                    repeat: before + k + 1,
                    bias_a,
                    seed: experiment.seed,
                };
                multisine::stage(&asked, limits, power)
            }));
        }
        let due = experiment
            .traces
            .iter()
            .filter(|trace| round <= trace.repeat);
        stages.extend(due.map(|trace| {
            trace::stage(trace, round, &experiment.cell, power, time_base(experiment))
        }));
    }
    Plan { stages }
}

fn mapped(experiment: &Experiment, power: Power) -> Option<map::Mapped<'_>> {
    Some(map::Mapped {
        map: experiment.map.as_ref()?,
        cell: &experiment.cell,
        temperature: experiment.temperature.as_ref()?,
        power,
    })
}

/// Returns the pulses of a map that could exceed the limits of the cell and are left out: the number
/// of the point, and why.
pub fn left_out_pulses(experiment: &Experiment) -> Vec<(usize, String)> {
    mapped(experiment, Power::of(experiment)).map_or_else(Vec::new, |mapped| {
        map::left_out(&mapped, &time_base(experiment))
    })
}

/// Returns the settings that all points of the sweeps share.
fn settings(eis: &Eis) -> SweepSettings {
    SweepSettings {
        amplitude_a: eis.amplitude_a,
        periods_on_screen: eis.periods_on_screen,
        record_points: eis.record_points,
        mains_hz: eis.mains_hz,
        overlap: eis.overlap,
        quality: eis.quality,
    }
}

/// Returns a function from a least span to the time that the scope's screen spans.
fn time_base(experiment: &Experiment) -> impl Fn(Seconds) -> Seconds {
    let scope =
        experiment
            .bench
            .instruments
            .scope
            .as_ref()
            .and_then(|Instrument { model, .. }| {
                by_key(scope::DIALECTS, model).map(|dialect| dialect.capabilities())
            });
    move |span_s| {
        scope.map_or(span_s, |capabilities| {
            capabilities.time_per_div(span_s) * capabilities.horizontal_div
        })
    }
}
