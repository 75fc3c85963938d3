//! Parts of a plan for the tests of this crate.

use instruments::units::{Amps, Coulombs, Ohms, Seconds, Volts};

use std::sync::Arc;

use bench_plan::plan::{Level, SweepSettings, Through, TracePlan};

/// Returns settings of a sweep for tests.
pub(crate) fn test_settings() -> Arc<SweepSettings> {
    Arc::new(SweepSettings {
        amplitude_a: Amps(1.0),
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
        lead_ohm: Ohms(0.0),
        rest_s: Seconds(0.0),
        levels: vec![
            Level {
                at_s: Seconds(0.5),
                current_a: Amps(-1.0),
                power_w: None,
            },
            Level {
                at_s: Seconds(5.5),
                current_a: Amps(0.0),
                power_w: None,
            },
        ],
        end_s: Seconds(5.5),
        frames: Vec::new(),
        start_v: (Volts(3.6), Volts(3.8)),
        resistance_max_ohm: Ohms(0.03),
        capacity_coulomb: Coulombs(16_200.0),
        thinning: (Seconds(0.002), 0.25, Seconds(10.0)),
    }
}
