//! A bath with a heater and a cooler on relays, whose loop the daemon closes: the bath holds the
//! temperature during the run, and a bath that cannot hold it ends the run.

use bench_daemon::command::run::run_experiment;

use crate::{
    configuration::configs,
    support::{BENCH, EXPERIMENT, Files, SCENARIO},
};

/// Returns the demo on the bath, with sensors that agree: the cell at 25 °C within a tenth of a
/// kelvin, then a reset and a short sweep.
fn files() -> Files {
    let files = Files::demo()
        .edit(EXPERIMENT, "within = \"0.2 K\"", "within = \"0.1 K\"")
        .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"10 Hz\"")
        .edit(EXPERIMENT, "points = 20", "points = 4")
        .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]")
        .append(SCENARIO, "[meters]\noffset_k = 0.0");
    files.write(
        BENCH,
        &std::fs::read_to_string(configs().join("benches/bath.toml")).unwrap(),
    );
    files
}

/// Returns times, s, and the readings of the sensor, °C.
fn shown(files: &Files) -> Vec<(f64, f64)> {
    let transcript = files.text("run/transcripts/chiller.txt");
    let lines = transcript.lines().filter_map(|line| {
        let (time, reading) = (line.split(' ').next()?, line.split_once(" t=")?.1);
        Some((time.parse().ok()?, reading.parse::<f64>().ok()? / 1000.0))
    });
    lines.collect()
}

#[test]
fn the_daemon_holds_a_plain_bath_within_a_tenth_of_a_kelvin_through_the_run() {
    let files = files();
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    assert_eq!(finished.measured.spectrum.points.len(), 4);
    let shown = shown(&files);
    let (first_s, first_degc) = shown[0];
    let (last_s, _) = shown[shown.len() - 1];
    assert!(
        (first_degc - 22.0).abs() < 0.1,
        "it begins at the room's temperature: {first_degc}"
    );
    let held: Vec<&(f64, f64)> = shown
        .iter()
        .skip_while(|(_, celsius)| *celsius < 24.9)
        .collect();
    let worst_k = held
        .iter()
        .map(|(_, celsius)| (celsius - 25.0).abs())
        .fold(0.0, f64::max);
    println!(
        "reached after {:.0} s, held for {:.0} s, at most {worst_k:.4} K off",
        held[0].0 - first_s,
        last_s - held[0].0
    );
    assert!(last_s - held[0].0 > 1500.0, "nearly half an hour: {last_s}");
    assert!(worst_k <= 0.1, "{worst_k}");
    // The relays are off at the end, and this was read back.
    let transcript = files.text("run/transcripts/chiller.txt");
    let end: Vec<&str> = transcript
        .lines()
        .rev()
        .filter(|line| line.contains(" < "))
        .take(2)
        .collect();
    assert!(
        end[0].ends_with("< OFF") && end[1].ends_with("< OK OFF"),
        "{end:?}"
    );
}

#[test]
fn a_sensor_or_a_relay_that_fails_ends_the_run_with_its_cause_and_the_relays_off() {
    for (quirk, cause) in [
        ("sensor = \"crc\"", "no plausible bath temperature for "),
        (
            "sensor = \"power_on\"",
            "no plausible bath temperature for ",
        ),
        ("sensor = \"absent\"", "no plausible bath temperature for "),
        ("sensor = \"stuck\"", "°C all the while, after "),
        (
            "relay = \"refused\"",
            "LOOK AT THE BENCH: the relays of the bath (relay-thermostat) are not known to be open",
        ),
    ] {
        let files = files().append(BENCH, &format!("[simulation.quirks.chiller]\n{quirk}"));
        let ended = run_experiment(&files.load(), &files.path("run"))
            .err()
            .map(|error| error.to_string())
            .unwrap_or_default();
        assert!(ended.contains(cause), "{quirk}: {ended}");
    }
}
