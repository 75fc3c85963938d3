//! The matrix of `benches/attacks`: what it plays and how it judges. The trials themselves take
//! minutes and are a command of their own.
#![allow(
    dead_code,
    reason = "the matrix is played by the benchmark; its parts are tested here"
)]

#[path = "../../benches/attacks/deed.rs"]
mod deed;
#[path = "../../benches/attacks/job.rs"]
mod job;
#[path = "../../benches/attacks/judge.rs"]
mod judge;
#[path = "../../benches/attacks/scene.rs"]
mod scene;
#[path = "../../benches/attacks/table.rs"]
mod table;
#[path = "../../benches/attacks/timeline.rs"]
mod timeline;
#[path = "../../benches/attacks/window.rs"]
mod window;

use std::collections::BTreeSet;

use deed::{Deed, product};
use window::Window;

#[test]
fn the_product_has_four_hundred_attacks_and_a_foreign_hand_and_an_outage_in_every_window() {
    let (attacks, skipped) = product();
    let names: BTreeSet<String> = attacks.iter().map(|attack| attack.name()).collect();
    assert_eq!(names.len(), attacks.len(), "each combination once");
    let quiet = attacks
        .iter()
        .filter(|attack| attack.deed == Deed::Nothing)
        .count();
    assert!(attacks.len() - quiet >= 400, "{}", attacks.len() - quiet);
    assert!(
        skipped
            .iter()
            .all(|(why, count)| !why.is_empty() && *count > 0)
    );
    for window in Window::ALL {
        let has = |fits: fn(&Deed) -> bool| {
            attacks
                .iter()
                .any(|attack| attack.window == window && fits(&attack.deed))
        };
        assert!(has(|deed| matches!(deed, Deed::Hand(_))), "{window:?}");
        let outage = has(|deed| matches!(deed, Deed::Gone(..)));
        assert_eq!(outage, window.is_watched(), "{window:?}");
    }
}

#[test]
fn the_experiments_of_the_matrix_are_plans() {
    for window in Window::ALL {
        let folder = window.job().files();
        let path = folder.path().join("experiments/attack.toml");
        let experiment = bench_daemon::config::load_experiment(&path, None).unwrap();
        let plan = bench_daemon::procedure::plan(&experiment);
        assert_eq!(plan.stages.len(), window.job().stages(), "{window:?}");
        plan.check(&experiment.cell.limits).unwrap();
    }
}
