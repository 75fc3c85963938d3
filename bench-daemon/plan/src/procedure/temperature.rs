//! A temperature that is held until the cell has it.

use instruments::fixture::Fixture;

use crate::{
    config::Temperature,
    plan::{Purpose, Stage, Step},
};

pub(super) fn stage(temperature: &Temperature) -> Stage {
    let (setpoint_degc, within_k, max_s) = (
        temperature.setpoint_degc,
        temperature.within_k,
        temperature.timeout_s,
    );
    Stage {
        purpose: Purpose::Temperature,
        steps: vec![
            Step::Mount(Fixture::Cell),
            Step::HoldTemperature {
                setpoint_degc,
                within_k,
                max_s,
            },
        ],
    }
}
