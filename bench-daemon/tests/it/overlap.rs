//! A sweep whose points overlap: the same impedances, hardly more time than the physical minimum,
//! and a journal that is still ahead of the instruments.

use std::{fs, path::Path};

use bench_daemon::command::run::run_experiment;

use crate::support::{BENCH, EXPERIMENT, Files, sent, truth};

/// Bench time of an entry of the journal, the step it belongs to, and its kind.
#[derive(Debug, Clone, Copy, PartialEq)]
enum What {
    Intent,
    Point,
}

fn journal(run: &Path) -> Vec<(f64, u64, What)> {
    let text = fs::read_to_string(run.join("journal.jsonl")).unwrap();
    let mut found = Vec::new();
    for line in text.lines() {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        let (time_s, entry) = (line["time_s"].as_f64().unwrap(), &line["entry"]);
        if entry["intent"]["text"]
            .as_str()
            .is_some_and(|text| text.starts_with("point"))
        {
            found.push((
                time_s,
                entry["intent"]["step"].as_u64().unwrap(),
                What::Intent,
            ));
        } else if let Some(step) = entry["point"]["step"].as_u64() {
            found.push((time_s, step, What::Point));
        }
    }
    found
}

fn overlapping(points: usize) -> Files {
    Files::demo()
        .without(EXPERIMENT, "temperature")
        .without(EXPERIMENT, "fixture_check")
        .without(EXPERIMENT, "soc_reset")
        .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"10 Hz\"")
        .edit(EXPERIMENT, "points = 20", &format!("points = {points}"))
        .edit(
            EXPERIMENT,
            "extra_wait = \"1 s\"",
            "extra_wait = \"1 s\"\noverlap = true",
        )
        .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]")
}

#[test]
fn a_sweep_takes_little_more_than_its_periods_and_every_step_is_in_the_journal_first() {
    let files = overlapping(20);
    let run = files.path("run");
    let finished = run_experiment(&files.load(), &run).unwrap();
    let points = &finished.measured.spectrum.points;
    let world = finished.simulation.as_ref().unwrap().world();
    for (point, truth) in points.iter().zip(truth(world, points)) {
        // Without controls the gains of the probes are in it.
        assert!(
            (point.z_ohm / truth - 1.0).norm() < 0.1,
            "{:.3} Hz: {} and {truth}",
            point.freq_hz,
            point.z_ohm
        );
    }
    let entries = journal(&run);
    let order: Vec<(u64, What)> = entries
        .iter()
        .map(|(_, step, what)| (*step, *what))
        .collect();
    let first = order[0].0;
    let mut expected = vec![(first, What::Intent)];
    for step in first..first + 20 {
        expected.extend((step + 1 < first + 20).then_some((step + 1, What::Intent)));
        expected.push((step, What::Point));
    }
    assert_eq!(order, expected);
    // In virtual time only waits take time: gaps between messages, and physics. A burst is four
    // messages, 10 ms apart.
    let bursts_s = 0.04 * points.len() as f64;
    // Scales and a record of the zero of the channels come before the first sinusoid.
    let zero_s = 1.5;
    let least_s: f64 = points.iter().map(|point| 11.0 / point.freq_hz + 1.0).sum();
    let took_s = entries.last().unwrap().0 - entries[0].0;
    assert!(
        took_s > least_s && took_s < 1.03 * least_s + bursts_s + zero_s,
        "{took_s} s, at least {least_s} s"
    );
}

/// Messages to an instrument for each point of a sweep, without those before and after it.
fn messages_per_point(role: &str, bench: &str) -> f64 {
    let count = |points: usize| {
        let files = overlapping(points);
        let text = fs::read_to_string(crate::configuration::configs().join(bench)).unwrap();
        files.write(BENCH, &text);
        run_experiment(&files.load(), &files.path("run")).unwrap();
        sent(&files.path("run"), role).len() as f64
    };
    (count(14) - count(6)) / 8.0
}

#[test]
fn settings_that_stand_are_not_sent_again_and_are_read_back_in_turn() {
    for (bench, role, most) in [
        ("benches/demo.toml", "scope", 26.0),
        ("benches/mixed.toml", "scope", 30.0),
    ] {
        let found = messages_per_point(role, bench);
        println!("{bench}: {found} messages to the {role} for each point");
        assert!(
            found <= most,
            "{bench}: {found} messages to the {role} for each point"
        );
    }
    let files = overlapping(14);
    run_experiment(&files.load(), &files.path("run")).unwrap();
    let messages = sent(&files.path("run"), "scope");
    let count = |text: &str| messages.iter().filter(|message| *message == text).count();
    // Sent once for a channel, and read back later.
    assert_eq!(count(":CHANnel3:COUPling DC"), 1);
    assert!(count(":CHANnel3:COUPling?") + count(":CHANnel2:COUPling?") >= 3);
}

#[test]
fn a_record_that_is_taken_again_brings_the_generator_back() {
    let scales = "scale_per_ampere = [\"20 mV\", \"20 mV\", \"40 mV\", \"80 mV\"]";
    let files = overlapping(3).edit(
        BENCH,
        scales,
        "scale_per_ampere = [\"2 mV\", \"20 mV\", \"40 mV\", \"6 mV\"]",
    );
    let run = files.path("run");
    let finished = run_experiment(&files.load(), &run).unwrap();
    assert!(
        finished
            .summary
            .contains("measured again: channel 1 clipped"),
        "{}",
        finished.summary
    );
    let freqs: Vec<String> = sent(&run, "generator")
        .into_iter()
        .filter_map(|message| {
            message
                .split(',')
                .skip_while(|word| *word != "FRQ")
                .nth(1)
                .map(str::to_owned)
        })
        .filter(|freq| {
            freq.parse::<f64>()
                .is_ok_and(|freq_hz| (9.0..301.0).contains(&freq_hz))
        })
        .collect();
    let first_back = freqs.iter().skip(2).position(|freq| *freq == freqs[0]);
    assert!(first_back.is_some(), "{freqs:?}");
    let points = &finished.measured.spectrum.points;
    let world = finished.simulation.as_ref().unwrap().world();
    for (point, truth) in points.iter().zip(truth(world, points)) {
        assert!(
            (point.z_ohm / truth - 1.0).norm() < 0.1,
            "{:.3} Hz: {} and {truth}",
            point.freq_hz,
            point.z_ohm
        );
    }
}
