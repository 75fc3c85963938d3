//! The doctor on a simulated bench: each single fault is found under its own name, and a sound
//! bench has none.

use std::{fs, path::Path};

use bench_core::safety::state::{Latched, State};

use crate::support::{BENCH, Ended, Files, Ports, SCENARIO, json, program};

fn doctor(files: &Files, fixture: &str, out: &str) -> Ended {
    let (bench, out) = (files.path(BENCH), files.path(out));
    let words: [&std::ffi::OsStr; 9] = [
        "doctor".as_ref(),
        bench.as_os_str(),
        "--fixture".as_ref(),
        fixture.as_ref(),
        "--yes".as_ref(),
        "--operator".as_ref(),
        "A. Person".as_ref(),
        "--out".as_ref(),
        out.as_os_str(),
    ];
    program(&words)
}

/// Returns the IDs of the checks with this verdict, and the remedies.
fn ended(report: &serde_json::Value, verdict: &str) -> Vec<(String, String)> {
    let text = |value: &serde_json::Value| value.as_str().unwrap().to_owned();
    let checks = report["checks"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|check| check["verdict"] == verdict);
    checks
        .map(|check| {
            (
                text(&check["id"]),
                format!("{} {}", text(&check["met"]), text(&check["advice"])),
            )
        })
        .collect()
}

#[test]
fn a_sound_bench_passes_on_both_controls_and_a_person_has_signed() {
    for fixture in ["shunt", "fake_cell"] {
        let files = Files::demo();
        let passed = doctor(&files, fixture, "report");
        passed.expect_code(0);
        let folder = files.path("report");
        let report = json(&folder.join("doctor.json"));
        assert_eq!(report["outcome"], "passed", "{report:#}");
        assert!(
            report["operator"] == "A. Person"
                && report["fixture"] == fixture
                && report["sha256"].as_str().unwrap().len() == 64
        );
        assert_eq!(report["instruments"].as_array().unwrap().len(), 8);
        for id in [
            "probes.current_pair",
            "probes.voltage_pair",
            "drive.gain",
            "drive.sine",
            "scope.timebase",
            "limit.charger",
            "safe.state",
        ] {
            assert!(
                ended(&report, "ok").iter().any(|(met, _)| met == id),
                "{fixture}: {id}: {report:#}"
            );
        }
        // The mock follows the manual, which guarantees no limit while the analog input commands.
        // A warning about the machine depends on where the test runs, for example on its free disk.
        assert_eq!(
            ended(&report, "warn")
                .into_iter()
                .map(|(id, _)| id)
                .filter(|id| !id.starts_with("machine."))
                .collect::<Vec<_>>(),
            ["limit.bipolar"]
        );
        let markdown = fs::read_to_string(folder.join("doctor.md")).unwrap();
        assert!(
            markdown.contains("Signed off by A. Person on 20")
                && markdown.contains("| drive.gain | ok |"),
            "{markdown}"
        );
        assert!(
            fs::read_to_string(folder.join("doctor.html"))
                .unwrap()
                .contains("probes.voltage_pair")
        );
    }
}

#[test]
fn each_fault_is_named_and_nothing_is_energised_after_it() {
    let harness = |text: &str| ("[harness]\n", text.to_owned());
    let channel = |number: usize, gain: f64| {
        let gains = [1, 2, 3, 4].map(|other| if other == number { gain } else { 1.0 });
        (
            "",
            gains
                .map(|gain| format!("[[harness.channels]]\ngain = {gain:.1}"))
                .join("\n"),
        )
    };
    let faults: [(&str, (&str, String), &str, &str); 11] = [
        (
            "reversed current pair",
            harness("probes = [2, 1, 3, 4]"),
            "probes.current_pair",
            "the pair C1, C2 is reversed",
        ),
        (
            "reversed voltage pair",
            harness("probes = [1, 2, 4, 3]"),
            "probes.voltage_pair",
            "the pair C3, C4 is reversed",
        ),
        (
            "swapped pairs",
            harness("probes = [3, 4, 1, 2]"),
            "probes.swapped",
            "the pairs are swapped",
        ),
        (
            "probe factor",
            channel(3, 0.1),
            "probes.voltage_pair",
            "C3 reads 0.1 of its voltage",
        ),
        (
            "inverted channel",
            channel(4, -1.0),
            "probes.voltage_pair",
            "C4 reads with the wrong sign",
        ),
        (
            "probe factor of the shunt",
            channel(2, 10.0),
            "probes.current_pair",
            "C2 reads 10 of its voltage",
        ),
        (
            "gain factor",
            ("[drives.bipolar]\n", "gain_a_per_v = 1.0".to_owned()),
            "drive.gain",
            "wiring.command_trim = 2.0",
        ),
        (
            "strong drive",
            ("[drives.bipolar]\n", "gain_a_per_v = 40.0".to_owned()),
            "drive.first",
            "far too strong",
        ),
        (
            "reversed drive",
            ("[drives.bipolar]\n", "gain_a_per_v = -2.0".to_owned()),
            "drive.gain",
            "against the command",
        ),
        (
            "dead ammeter",
            ("[faults]\n", "ammeter_freezes_s = 0.0".to_owned()),
            "meters.ammeter",
            "is dead",
        ),
        // It froze while the fake cell was in the jig already: one that shows a cell is refused
        // before.
        (
            "dead voltmeter",
            (
                "",
                "mounted = \"fake_cell\"\n[faults]\nvoltmeter_freezes_s = 0.0".to_owned(),
            ),
            "meters.voltmeter",
            "does not follow",
        ),
    ];
    for (name, (section, text), id, words) in faults {
        let files = Files::demo();
        // A key of its own comes before the tables.
        files.write(
            SCENARIO,
            &if text.starts_with("mounted") {
                text + "\n" + &files.text(SCENARIO)
            } else {
                files.text(SCENARIO) + "\n" + section + &text
            },
        );
        let failed = doctor(&files, "fake_cell", "report");
        failed.expect_code(4);
        let report = json(&files.path("report/doctor.json"));
        let found = ended(&report, "fail");
        assert!(
            found.len() == 1 && found[0].0 == id && found[0].1.contains(words),
            "{name}: {found:?}"
        );
        assert_eq!(
            failed.message(),
            format!("the doctor found what must be mended first: {id}"),
            "{name}"
        );
        if id != "meters.voltmeter" {
            let skipped = ended(&report, "skipped");
            for later in ["limit.charger", "safe.state"] {
                assert!(
                    skipped
                        .iter()
                        .any(|(met, why)| met == later && why.contains("not after ")),
                    "{name}: {skipped:?}"
                );
            }
        }
        assert!(
            ended(&report, "ok")
                .iter()
                .any(|(met, _)| met == "safe.end"),
            "{name}"
        );
    }
}

#[test]
fn a_wrong_value_of_a_control_in_the_bench_file_is_reported_with_what_decides() {
    for (value, other, fixture, id, key, decides) in [
        (
            "3.75 mΩ",
            "6 mΩ",
            "fake_cell",
            "probes.voltage_pair",
            "controls.fake_cell.resistance",
            "`--fixture shunt` decides",
        ),
        (
            "9.96 mΩ",
            "14 mΩ",
            "shunt",
            "probes.current_pair",
            "wiring.shunt.resistance",
            "`--fixture fake_cell` decides",
        ),
    ] {
        let files = Files::demo().edit(BENCH, value, other);
        doctor(&files, fixture, "report").expect_code(4);
        let found = ended(&json(&files.path("report/doctor.json")), "fail");
        assert!(
            found.len() == 1
                && found[0].0 == id
                && found[0].1.contains(key)
                && found[0].1.contains(decides),
            "{found:?}"
        );
    }
}

#[test]
fn a_command_that_goes_to_the_wrong_channel_of_the_generator_is_distinguished_from_a_weak_drive() {
    let files = Files::demo().edit(BENCH, "generator_channel = 1", "generator_channel = 2");
    doctor(&files, "fake_cell", "report").expect_code(4);
    let found = ended(&json(&files.path("report/doctor.json")), "fail");
    assert!(
        found.len() == 1
            && found[0].0 == "drive.gain"
            && found[0].1.contains("wiring.generator_channel"),
        "{found:?}"
    );
}

#[test]
fn without_a_fixture_nothing_is_energised_and_without_a_word_for_it_neither() {
    let files = Files::demo();
    let (bench, out) = (files.path(BENCH), files.path("report"));
    let looked = program(&[
        "doctor".as_ref(),
        bench.as_os_str(),
        "--out".as_ref(),
        out.as_os_str(),
    ]);
    looked.expect_code(0);
    let report = json(&out.join("doctor.json"));
    assert_eq!(report["outcome"], "incomplete");
    assert!(
        ended(&report, "skipped")
            .iter()
            .any(|(id, why)| id == "drive.gain" && why.contains("no fixture in the jig")),
        "{report:#}"
    );
    assert!(
        ended(&report, "ok")
            .iter()
            .any(|(id, _)| id == "limits.supply4q"),
        "{report:#}"
    );
    let files = Files::demo().edit(
        BENCH,
        "model = \"mock-jig\"\naddress = \"memory:jig\"",
        "model = \"person\"",
    );
    let bench = files.path(BENCH);
    let refused = program(&[
        "doctor".as_ref(),
        bench.as_os_str(),
        "--fixture".as_ref(),
        "shunt".as_ref(),
    ]);
    refused.expect_code(2);
    assert!(
        refused
            .message()
            .starts_with("expected a person at a terminal who confirms the fixture, or --yes"),
        "{}",
        refused.message()
    );
}

#[test]
fn a_cell_that_is_still_in_the_jig_is_found_before_anything_goes_on() {
    let files = Files::demo().edit(
        BENCH,
        "model = \"mock-jig\"\naddress = \"memory:jig\"",
        "model = \"person\"",
    );
    doctor(&files, "shunt", "report").expect_code(4);
    let found = ended(&json(&files.path("report/doctor.json")), "fail");
    assert!(
        found.len() == 1
            && found[0].0 == "fixture.no_cell"
            && found[0].1.contains("take the cell out of the jig"),
        "{found:?}"
    );
}

/// On real ports: the guardian exists and intervenes, and a run knows whether the doctor has
/// checked the bench.
#[test]
#[ignore = "long drill"]
fn the_lease_is_proven_on_ports_and_a_run_asks_for_the_report() {
    let files = Files::short(2).append(
        BENCH,
        "[guardian]\nlease = \"1.5 s\"\n[doctor]\nrequired = true",
    );
    let ports = Ports::serve(&files, 4.0, 1);
    let refused = files.run("refused");
    refused.expect_code(2);
    let words = "the bench file requires a report of the doctor: `eis-bench doctor` has never \
    looked at this bench";
    assert!(
        refused.message().starts_with(words),
        "{}",
        refused.message()
    );
    let passed = doctor(&files, "fake_cell", "report");
    passed.expect_code(0);
    let report = json(&files.path("report/doctor.json"));
    for id in [
        "guardian.start",
        "guardian.lease",
        "bench.latch",
        "safe.state",
    ] {
        assert!(
            ended(&report, "ok").iter().any(|(met, _)| met == id),
            "{id}: {report:#}"
        );
    }
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
    files.run("run").expect_code(0);
    let edited = crate::guardian::state(&files, "doctor.json");
    edit(&edited, "A. Person", "Another");
    let refused = files.run("edited");
    refused.expect_code(2);
    assert!(
        refused
            .message()
            .contains("was changed after it was written"),
        "{}",
        refused.message()
    );
    edit(&edited, "Another", "A. Person");
    let files = files.edit(BENCH, "command_trim = 1.0", "command_trim = 1.01");
    assert!(
        files
            .run("changed")
            .expect_code(2)
            .message()
            .contains("the bench file has changed since")
    );
    let files = files.edit(BENCH, "required = true", "required = false");
    let remarked = files.run("remarked");
    assert!(
        remarked
            .expect_code(0)
            .stdout
            .contains("note: the bench file has changed since the doctor's report"),
        "{}",
        remarked.stdout
    );
}

/// Such a check provides no information about the bench: earlier information stays valid.
#[test]
fn a_latched_bench_is_not_connected_to_and_the_report_before_stands() {
    let files = Files::demo();
    let ports = Ports::serve(&files, 4.0, 1);
    let (config, _) = bench_plan::config::load_bench(&files.path(BENCH)).unwrap();
    let state = State::of(&config).unwrap().unwrap();
    let kept = crate::guardian::state(&files, "doctor.json");
    fs::write(&kept, "the report before").unwrap();
    state.latch(&Latched::new("daemon", "a test")).unwrap();
    drop(ports);
    let failed = doctor(&files, "shunt", "report");
    failed.expect_code(4);
    assert_eq!(
        failed.message(),
        "the doctor found what must be mended first: bench.latch"
    );
    let report = json(&files.path("report/doctor.json"));
    let skipped = ended(&report, "skipped");
    for id in [
        "reach.scope",
        "drive.gain",
        "guardian.start",
        "guardian.lease",
    ] {
        assert!(
            skipped
                .iter()
                .any(|(met, why)| met == id && why.starts_with("not after bench.latch")),
            "{id}: {report:#}"
        );
    }
    assert_eq!(report["instruments"], serde_json::json!([]));
    assert_eq!(fs::read_to_string(kept).unwrap(), "the report before");
}

fn edit(path: &Path, from: &str, to: &str) {
    fs::write(path, fs::read_to_string(path).unwrap().replace(from, to)).unwrap();
}

#[test]
fn a_bench_that_another_program_drives_is_left_alone() {
    let files = Files::short(2);
    let ports = Ports::serve(&files, 4.0, 1);
    assert_eq!(ports.ask("load", ":INP ON\n:INP?"), "1");
    let refused = doctor(&files, "fake_cell", "report");
    refused.expect_code(2);
    assert!(
        refused
            .message()
            .starts_with("expected every output off at the beginning, found load ON"),
        "{}",
        refused.message()
    );
    assert!(!files.path("report/doctor.json").exists());
    assert_eq!(ports.ask("load", ":INP?"), "1");
}
