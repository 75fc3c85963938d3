//! A share of the coverage gate (`benches/coverage`): few seeds, which detect errors by a factor,
//! but not by a tenth.

#[path = "../../benches/coverage/played.rs"]
mod played;
#[path = "../../benches/coverage/synthetic.rs"]
mod synthetic;
#[path = "../../benches/coverage/tally.rs"]
mod tally;

use std::path::Path;

#[test]
#[ignore = "long drill"]
fn six_seeds_refute_no_interval_of_the_demo_with_a_harness_of_their_own() {
    let seeds: Vec<u64> = (80_001..80_007).collect();
    let configs = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../configs"));
    let tally = played::play(
        &played::Played {
            configs,
            name: "demo",
            drawn: true,
        },
        &seeds,
    )
    .unwrap();
    assert!(
        tally
            .rows()
            .any(|(name, deviations)| name == "DC resistance" && deviations.len() == seeds.len())
    );
    assert_eq!(tally.refuted(), [""; 0], "{}", tally.table("demo"));
}

#[test]
#[ignore = "long drill"]
fn twenty_seeds_refute_no_interval_of_joint_fits() {
    let seeds: Vec<u64> = (80_001..80_021).collect();
    let tally = synthetic::play(&seeds);
    assert!(
        tally
            .rows()
            .any(|(name, deviations)| name == "DC resistance" && deviations.len() == seeds.len())
    );
    assert_eq!(tally.refuted(), [""; 0], "{}", tally.table("joint"));
}
