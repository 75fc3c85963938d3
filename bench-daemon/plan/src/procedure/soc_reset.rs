//! SOC reset (thesis 3.3.1): discharge below the set-point with the load, charge to it with the
//! supply, stop, let the voltage relax. The relaxed voltage must be steady and within a band, if
//! one is given; a cell that misses it is reset again, up to the allowed number of times.

use instruments::fixture::Fixture;

use crate::{
    config::SocReset,
    plan::{Purpose, Stage, Step},
};

pub(super) fn stage(reset: &SocReset) -> Stage {
    let attempt = [
        Step::Discharge {
            current_a: reset.discharge_a,
            until_v: reset.discharge_until_v,
            max_s: reset.max_s,
        },
        Step::Charge {
            current_a: reset.charge_a,
            limit_v: reset.charge_limit_v,
            until_v: reset.charge_until_v,
            max_s: reset.max_s,
        },
        Step::Rest {
            min_s: reset.rest_min_s,
            max_s: reset.rest_max_s,
            slope_v_per_s: reset.rest_slope_v_per_s,
        },
    ];
    let mut steps = vec![Step::Mount(Fixture::Cell)];
    let Some(acceptance) = reset.acceptance else {
        steps.extend(attempt);
        return Stage {
            purpose: Purpose::SocReset,
            steps,
        };
    };
    for number in 1..=acceptance.attempts {
        steps.extend(attempt.clone());
        let missed = (number == acceptance.attempts).then_some(acceptance.missed);
        steps.push(Step::Accept {
            band_v: acceptance.band_v,
            missed,
        });
    }
    Stage {
        purpose: Purpose::SocReset,
        steps,
    }
}
