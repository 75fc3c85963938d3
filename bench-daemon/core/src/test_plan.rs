//! Parts of a plan for the tests of this crate.

use std::sync::Arc;

use bench_plan::plan::{Level, SweepSettings, Through, TracePlan};

/// Returns settings of a sweep for tests.
pub(crate) fn test_settings() -> Arc<SweepSettings> {
    Arc::new(SweepSettings {
        amplitude_a: 1.0,
        periods_on_screen: 5.0,
        record_points: 10_000,
        mains_hz: None,
        overlap: None,
        quality: None,
    })
}

/// Returns a trace for tests.
pub(crate) fn test_trace() -> TracePlan {
    TracePlan {
        name: "t".to_owned(),
        repeat: 1,
        role: analysis_signal::series::Role::Train,
        repeat_group: "t".to_owned(),
        through: Through::Bipolar,
        averaged: None,
        lead_ohm: 0.0,
        rest_s: 0.0,
        levels: vec![
            Level {
                at_s: 0.5,
                current_a: -1.0,
                power_w: None,
            },
            Level {
                at_s: 5.5,
                current_a: 0.0,
                power_w: None,
            },
        ],
        end_s: 5.5,
        frames: Vec::new(),
        start_v: (3.6, 3.8),
        resistance_max_ohm: 0.03,
        capacity_coulomb: 16_200.0,
        thinning: (0.002, 0.25, 10.0),
    }
}
