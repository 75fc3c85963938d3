//! The procedures of the thesis, each a pure function from parameters to stages of a plan.

mod eis_sweep;
mod soc_reset;

use instruments::{instrument::by_key, mock::plant::Fixture, scope, supply4q, units::Seconds};

use crate::{
    config::{Experiment, Instrument},
    plan::{Plan, Purpose, Stage, Step},
};

/// The whole experiment as a plan: fixture check, temperature, SOC reset, sweep of the cell. The controls come first, so that the cell is put into
/// the jig once, after the last of them, and nothing has to be clamped where it sits.
pub fn plan(experiment: &Experiment) -> Plan {
    let mut stages = Vec::new();
    let supply = experiment.bench.instruments.supply4q.as_ref().and_then(|supply| by_key(supply4q::DIALECTS, &supply.model));
    let held = supply.is_some_and(|dialect| dialect.capabilities().current_limit);
    let limits = &experiment.cell.limits;
    for (control, _) in experiment.fixture_check.iter().flat_map(|check| &check.controls) {
        stages.push(eis_sweep::stage((*control, held), &experiment.eis, limits, time_base(experiment)));
    }
    if let Some(temperature) = &experiment.temperature {
        let (setpoint_c, within_k, max_s) = (temperature.setpoint_c, temperature.within_k, temperature.timeout_s);
        stages.push(Stage {
            purpose: Purpose::Temperature,
            steps: vec![Step::Mount(Fixture::Cell), Step::HoldTemperature { setpoint_c, within_k, max_s }],
        });
    }
    if let Some(reset) = &experiment.soc_reset {
        stages.push(soc_reset::stage(reset));
    }
    stages.push(eis_sweep::stage((Fixture::Cell, held), &experiment.eis, limits, time_base(experiment)));
    Plan { stages }
}

/// The time that the scope's screen spans when it is to hold at least a given span.
fn time_base(experiment: &Experiment) -> impl Fn(f64) -> f64 {
    let scope = experiment
        .bench
        .instruments
        .scope
        .as_ref()
        .and_then(|Instrument { model, .. }| by_key(scope::DIALECTS, model).map(|dialect| dialect.capabilities()));
    move |span_s| scope.map_or(span_s, |capabilities| capabilities.time_per_div(Seconds(span_s)).value() * capabilities.horizontal_div)
}
