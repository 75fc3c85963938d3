//! The reset of the state of charge is accepted by slope and band; a reset that misses the band is
//! repeated, then flagged or refused.

use std::fs;

use bench_daemon::command::run::run_experiment;

use crate::support::{EXPERIMENT, Files, SCENARIO, json};

/// Returns files with a reset and two points.
fn files(acceptance: &str) -> Files {
    Files::brief(2).without(EXPERIMENT, "fixture_check").edit(
        EXPERIMENT,
        "max_duration = \"2 h\"",
        &format!("max_duration = \"2 h\"\n{acceptance}"),
    )
}

#[test]
fn a_cell_that_rests_within_the_band_is_accepted_at_once() {
    let files = files("rest_band = [\"3.70 V\", \"3.75 V\"]");
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    let events = fs::read_to_string(files.path("run/events.csv")).unwrap();
    assert_eq!(events.matches("\"discharge at").count(), 1, "{events}");
    assert!(
        !finished.summary.contains("SOC reset"),
        "{}",
        finished.summary
    );
}

#[test]
fn a_cell_that_misses_the_band_is_reset_again_towards_its_middle() {
    // Without correction the cell comes to rest 8 mV above this band.
    let files = files("rest_band = [\"3.705 V\", \"3.711 V\"]");
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    let events = fs::read_to_string(files.path("run/events.csv")).unwrap();
    assert_eq!(events.matches("\"discharge at").count(), 2, "{events}");
    assert!(
        events.contains("SOC reset: expected 3.705 V to 3.711 V at rest, found 3.7")
            && events.contains("moved by -1"),
        "{events}"
    );
    let rested_v = finished
        .simulation
        .as_ref()
        .unwrap()
        .world()
        .lock()
        .unwrap()
        .truth_ocv_v();
    assert!((3.702..3.714).contains(&rested_v), "{rested_v}");
}

#[test]
fn a_band_out_of_reach_is_flagged_or_ends_the_run_as_the_file_says() {
    let out_of_reach = |missed: &str| {
        files(&format!(
            "rest_band = [\"3.54 V\", \"3.55 V\"]\nattempts = 2\nmissed = \"{missed}\""
        ))
    };
    let flagged = out_of_reach("flag");
    let summary = run_experiment(&flagged.load(), &flagged.path("run"))
        .unwrap()
        .summary;
    assert!(
        summary.contains("note: SOC reset: expected 3.54 V to 3.55 V at rest, found 3."),
        "{summary}"
    );
    assert!(
        summary.contains("the state of charge is not the one that was asked for"),
        "{summary}"
    );
    let campaign = "[campaign]\nrepeats = 1\ncells = [{ name = \"A\" }, { name = \"B\" }]";
    let two = out_of_reach("flag")
        .append(EXPERIMENT, campaign)
        .append(SCENARIO, "[specimens]\ncount = 2");
    let summary = run_experiment(&two.load(), &two.path("run"))
        .unwrap()
        .summary;
    assert!(
        summary.contains(
            "note: run 2 (cell B, repeat 1): SOC reset: expected 3.54 V to 3.55 V at rest, found 3."
        ),
        "{summary}"
    );
    let report = json(&two.path("run/campaign.json"));
    for run in report["runs"].as_array().unwrap() {
        assert!(
            run["soc_missed"] == true
                && run["notes"][0]
                    .as_str()
                    .unwrap()
                    .starts_with("SOC reset: expected 3.54 V"),
            "{run}"
        );
    }
    let refused = out_of_reach("refuse");
    let failure = run_experiment(&refused.load(), &refused.path("run"))
        .err()
        .unwrap()
        .to_string();
    assert!(
        failure.starts_with(
            "cell after the SOC reset: expected 3.54 V to 3.55 V at rest, measured 3."
        ),
        "{failure}"
    );
    assert!(!refused.path("run/captures/cell").exists());
}
