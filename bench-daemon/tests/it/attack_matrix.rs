//! The matrix of `benches/attacks`: its combinations and its verdicts. The trials themselves take
//! minutes and have their own command.
#![allow(
    dead_code,
    reason = "the benchmark executes the matrix; its parts are tested here"
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
use judge::{beyond, false_words, printed_bound_s};
use scene::Sample;
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
        let experiment = bench_plan::config::load_experiment(&path, None).unwrap();
        let plan = bench_plan::procedure::plan(&experiment);
        assert_eq!(plan.stages.len(), window.job().stages(), "{window:?}");
        plan.check(&experiment.cell.limits).unwrap();
    }
}

fn samples(amps: impl Fn(f64) -> f64) -> Vec<Sample> {
    (0..200)
        .map(|k| {
            let now_s = 0.05 * f64::from(k);
            let amps = amps(now_s);
            Sample {
                now_s,
                amps,
                live: amps != 0.0,
            }
        })
        .collect()
}

#[test]
fn what_flows_beyond_the_step_counts_from_its_first_to_its_last_instant() {
    let envelope = [(0.0, (0.0, 0.0)), (2.0, (-5.0, 0.0)), (4.0, (0.0, 0.0))];
    let sound = samples(|now_s| {
        if (2.0..4.0).contains(&now_s) {
            -5.4
        } else {
            0.15
        }
    });
    assert_eq!(beyond(&sound, &envelope, 2.0), (0.0, 0.0));
    let hand = samples(|now_s| {
        if (5.0..7.0).contains(&now_s) {
            -20.2
        } else {
            0.0
        }
    });
    let (charge, longest) = beyond(&hand, &envelope, 2.0);
    assert!((charge - 40.0).abs() < 1.1, "{charge}");
    assert!((longest - 2.0).abs() < 0.11, "{longest}");
}

#[test]
fn words_are_false_where_an_output_was_on_for_the_second_before() {
    let on = samples(|now_s| if now_s > 3.0 { 1.0 } else { 0.0 });
    let said = |now_s: f64| vec![(now_s, "x; every output is off: y".to_owned())];
    assert!(false_words(&said(3.5), &on).is_empty());
    assert_eq!(false_words(&said(4.5), &on).len(), 1);
}

#[test]
fn the_bound_is_the_number_behind_within_on_the_line_of_the_watch() {
    let text = "plan\nwatch: from a cause to zero within 3.5 s (meters)\n";
    assert_eq!(printed_bound_s(text), Some(3.5));
    assert_eq!(printed_bound_s("within 3 s"), None);
}
