//! Multisine: odd harmonics at once, some left out to show distortion, with phases of a low crest factor; one record per band.

use std::sync::Arc;

use analysis::multisine::{design, odd_grid};
use instruments::{mock::plant::Fixture, supply4q::Holds};

use crate::{
    config::Multisine,
    interlock::Limits,
    plan::{Band, Purpose, Stage, Step},
};

/// The compliance lies above the cell's limit by this much, V, and at least by what the loop takes, Ω.
const COMPLIANCE: (f64, f64) = (0.3, 0.1);
/// The current limit lies above the peak by this factor and this much, A.
const LIMIT: (f64, f64) = (1.1, 0.5);

pub(super) fn stage((multisine, repeat): (&Multisine, usize), limits: &Limits, (held, seed): (Holds, u64)) -> Stage {
    let peak_a = multisine.peak_a;
    let mut steps = vec![Step::Mount(Fixture::Cell)];
    if multisine.rest_s > 0.0 {
        steps.push(Step::Pause { span_s: multisine.rest_s });
    }
    let compliance_v = limits.max_v + (COMPLIANCE.1 * peak_a).max(COMPLIANCE.0);
    steps.push(Step::PowerUp { compliance_v, limit_a: LIMIT.0 * peak_a + LIMIT.1, held });
    for (number, band) in (1..).zip(&multisine.bands) {
        let harmonics = odd_grid(band.base_hz, band.range_hz, band.lines);
        steps.push(Step::Multisine(Arc::new(Band {
            number,
            base_hz: band.base_hz,
            design: design(&harmonics, seed.wrapping_add(number as u64)),
            steps: band.steps,
            peak_a,
            settle_s: band.settle_s,
            span_s: band.span_s,
            memory_points: multisine.memory_points,
            record_points: multisine.record_points,
        })));
    }
    if let Some(quality) = multisine.quality.filter(|quality| quality.again > 0) {
        steps.push(Step::Recheck { max_s: quality.time_s, charge_c: quality.charge_c });
    }
    steps.push(Step::PowerDown);
    Stage { purpose: Purpose::Multisine(repeat), steps }
}
