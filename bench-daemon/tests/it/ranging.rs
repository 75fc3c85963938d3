//! A channel that clips or wastes its range is ranged again and the point measured again; the
//! offset limits of the scope are respected.

use std::fs;

use bench_daemon::command::run::run_experiment;

use crate::support::{BENCH, Files, sent, truth};

const SCALES: &str = "scale_per_ampere = [\"20 mV\", \"20 mV\", \"40 mV\", \"80 mV\"]";

/// Runs with other first scales; checks the impedance, and returns the notes and the names of the
/// cell's captures.
fn run_with(scales: &str) -> (String, Vec<String>, Files) {
    let files = Files::short(2).edit(BENCH, SCALES, scales);
    let run = files.path("run");
    let finished = run_experiment(&files.load(), &run).unwrap();
    let points = &finished.measured.spectrum.points;
    let world = finished.simulation.as_ref().unwrap().world();
    for (point, truth) in points.iter().zip(truth(world, points)) {
        let off = (point.z_ohm / truth - 1.0).norm();
        assert!(off < 0.01, "{scales}: {:.3} Hz off by {off}", point.freq_hz);
    }
    let mut captures: Vec<String> = fs::read_dir(run.join("captures/cell"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    captures.sort();
    (finished.summary, captures, files)
}

#[test]
fn well_chosen_scales_are_kept() {
    let (summary, captures, _) = run_with(SCALES);
    assert!(!summary.contains("measured again"), "{summary}");
    assert_eq!(captures.len(), 2, "{captures:?}");
}

#[test]
fn clipping_is_ranged_away_and_every_attempt_is_kept() {
    let (summary, captures, _) =
        run_with("scale_per_ampere = [\"2 mV\", \"20 mV\", \"40 mV\", \"6 mV\"]");
    assert!(
        summary.contains(
            "measured again: channel 1 clipped at 0.002 V/div; channel 4 clipped at 0.006 V/div"
        ),
        "{summary}"
    );
    assert!(
        captures
            .iter()
            .any(|name| name.ends_with("_again1.parquet")),
        "{captures:?}"
    );
    assert!(
        captures
            .iter()
            .filter(|name| !name.contains("again"))
            .count()
            == 2,
        "{captures:?}"
    );
}

#[test]
fn a_signal_that_is_small_in_its_range_is_ranged_up() {
    let (summary, captures, _) =
        run_with("scale_per_ampere = [\"20 mV\", \"500 mV\", \"40 mV\", \"2 V\"]");
    assert!(
        summary.contains("channel 2 small at 0.5 V/div; channel 4 small at 2 V/div"),
        "{summary}"
    );
    assert!(
        captures
            .iter()
            .any(|name| name.ends_with("_again1.parquet")),
        "{captures:?}"
    );
}

#[test]
fn no_offset_is_asked_for_that_the_scale_does_not_allow() {
    // At 1 mV/div the scope offsets 1.6 V at most; the cell sits at 3.7 V.
    let (_, _, files) = run_with("scale_per_ampere = [\"20 mV\", \"20 mV\", \"40 mV\", \"1 mV\"]");
    let mut scale_v = 0.0;
    for message in sent(&files.path("run"), "scope") {
        if let Some(scale) = message.strip_prefix(":CHANnel4:SCALe ") {
            scale_v = scale.parse::<f64>().unwrap();
        }
        if let Some(offset) = message.strip_prefix(":CHANnel4:OFFSet ") {
            let limit_v = if scale_v <= 0.005 { 1.6 } else { 4.0 };
            assert!(
                offset.parse::<f64>().unwrap().abs() <= limit_v,
                "{offset} at {scale_v} V/div"
            );
        }
    }
    assert!(scale_v > 0.005, "{scale_v}");
}
