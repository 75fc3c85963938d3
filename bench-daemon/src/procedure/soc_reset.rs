//! SOC reset (thesis 3.3.1): discharge below the set-point with the load, charge to it with the supply, stop, let the voltage relax.

use instruments::mock::plant::Fixture;

use crate::{
    config::SocReset,
    plan::{Purpose, Stage, Step},
};

pub(super) fn stage(reset: &SocReset) -> Stage {
    Stage {
        purpose: Purpose::SocReset,
        steps: vec![
            Step::Mount(Fixture::Cell),
            Step::Discharge { current_a: reset.discharge_a, until_v: reset.discharge_until_v, max_s: reset.max_s },
            Step::Charge { current_a: reset.charge_a, limit_v: reset.charge_limit_v, until_v: reset.charge_until_v, max_s: reset.max_s },
            Step::Rest { min_s: reset.rest_min_s, max_s: reset.rest_max_s, slope_v_per_s: reset.rest_slope_v_per_s },
        ],
    }
}
