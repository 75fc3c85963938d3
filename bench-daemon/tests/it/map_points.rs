//! The procedure `map`: its plan, its refusals, the example from the plan to the pulse table, and runs
//! that died on their way to a point.

use std::{fs, path::Path};

use analysis::{
    dataset::{read_spectrum_csv, read_trace_csv},
    run_folder::{MapPoint, read_map_points},
};
use bench_core::executor::charge_of;
use bench_daemon::command::run::run_experiment;

use crate::{
    configuration::configs,
    resume::{die, resume},
    support::{BENCH, CELL, EXPERIMENT, Files, Ports, SCENARIO, json, program, truth},
};

/// Capacity of the cell, C.
const COULOMB: f64 = 16_200.0;

/// The example on the demo's bench.
fn example() -> Files {
    let files = Files::demo();
    let text = |name: &str| fs::read_to_string(configs().join(name)).unwrap();
    let experiment = text("experiments/map.toml").replace("benches/map.toml", "benches/demo.toml");
    files.write(EXPERIMENT, &experiment);
    files.write(SCENARIO, &text("scenarios/map.toml"));
    files
}

fn points(run: &Path) -> Vec<MapPoint> {
    read_map_points(run).unwrap()
}

fn planned(files: &Files) -> String {
    let experiment = files.experiment();
    let planned = program(&["plan".as_ref(), experiment.as_os_str()]);
    planned.expect_code(0);
    planned.stdout.clone() + &planned.stderr
}

#[test]
fn the_plan_has_charge_temperature_margins_and_duration_of_each_point() {
    let text = planned(&example());
    let has = |expected: &str| assert!(text.contains(expected), "{expected}\n{text}");
    // (1 − 0.9), (1 − 0.5) and (1 − 0.2) of 16 200 C.
    for step in [
        "charge at 2.25 A, hold 4.195 V until 0.2 A, at most 300.0 min, into \
         map_charge_1.bdf.csv",
        "discharge at 4.5 A to 1620 C below full or to 2.55 V, at most 19.0 min, into \
         map_discharge_1.bdf.csv",
        "discharge at 4.5 A to 8100 C below full or to 2.55 V, at most 55.0 min, into \
         map_discharge_5.bdf.csv",
        "discharge at 4.5 A to 12960 C below full or to 2.55 V",
        "hold 10 °C, wait until the cell is within 0.2 K",
        // 87 % and 93 % of the OCV curve.
        "accept 4.0432 V to 4.0735 V at rest, else go on and say so",
    ] {
        has(step);
    }
    for (row, moved) in [
        (
            "1, 90 %, 25 °C: sweep of 12 frequencies, pulses of -2.25 A, +2.25 A, -4.5 A; ",
            "; 1",
        ),
        (
            "2, 50 %, 25 °C: sweep of 12 frequencies, pulses of -2.25 A, +2.25 A, -4.5 A, +4.5 A; ",
            "; 6",
        ),
        (
            "4, 90 %, 10 °C: sweep of 12 frequencies, pulses of -2.25 A, +2.25 A, -4.5 A; ",
            "; 1",
        ),
        ("6, 20 %, 10 °C: ", "; 4"),
    ] {
        let line = text.lines().find(|line| line.trim().starts_with(row));
        let line = line.unwrap_or_else(|| panic!("{row}\n{text}"));
        assert!(line.contains(moved) && line.contains(" C out, "), "{line}");
        assert!(line.contains("V at rest; pulses at least "), "{line}");
    }
    has("6 points; 7.");
    // From 4.0735 V: 4.5 A through 30 mΩ are 0.135 V.
    has(
        "point 1: charge pulse of 4.5 A left out: expected a cell voltage within 2.5 V to 4.2 V at worst",
    );
    has("point 4: charge pulse of 4.5 A left out");
    assert!(!text.contains("note: point 2: "), "{text}");
    let experiment = example();
    let ended = program(&[
        "plan".as_ref(),
        experiment.experiment().as_os_str(),
        "--json".as_ref(),
    ]);
    let plan: serde_json::Value = serde_json::from_str(&ended.stdout).unwrap();
    let rows = plan["points"].as_array().unwrap();
    assert_eq!(rows.len(), 6);
    assert_eq!(
        (&rows[4]["soc"], &rows[4]["temperature_c"]),
        (&0.5.into(), &10.0.into())
    );
    // 10 % and 40 % of the capacity; the charge to the first is counted by the rule of all legs.
    let out = |row: usize| rows[row]["charge_c"][1].as_f64().unwrap();
    assert!(
        (out(1) - out(2) - 0.1 * COULOMB).abs() < 1.0,
        "{} {}",
        out(1),
        out(2)
    );
}

/// A cell of the data sheet that allows −20 °C is discharged there and charged at 0 °C or above.
#[test]
fn no_cell_is_charged_below_zero() {
    let files = example();
    let cell = fs::read_to_string(configs().join("cells/p45b.toml")).unwrap();
    files.write(
        CELL,
        &cell.replace("temperature_min = \"0 °C\"", "temperature_min = \"-20 °C\""),
    );
    let experiment = fs::read_to_string(files.experiment()).unwrap();
    let cold = experiment.replace("[\"25 °C\", \"10 °C\"]", "[\"25 °C\", \"-5 °C\"]");
    files.write(EXPERIMENT, &cold);
    let text = planned(&files);
    for way in ["2.25", "4.5"] {
        let left_out = format!(
            "point 5: charge pulse of {way} A left out: a cell is charged at 0 °C or above"
        );
        assert!(text.contains(&left_out), "{text}");
    }
    assert!(
        text.contains("5, 50 %, -5 °C: sweep of 12 frequencies, pulses of -2.25 A, -4.5 A; "),
        "{text}"
    );
    files.write(
        EXPERIMENT,
        &cold.replace("setpoint = \"25 °C\"", "setpoint = \"-5 °C\""),
    );
    let refused = program(&["plan".as_ref(), files.experiment().as_os_str()]);
    refused.expect_code(2);
    assert!(
        refused
            .stderr
            .contains("expected a temperature of at least 0 °C"),
        "{}",
        refused.stderr
    );
}

#[test]
fn a_map_that_cannot_be_is_refused() {
    let pulses = "pulses = { amplitudes = [\"2.25 A\", \"4.5 A\"], duration = \"10 s\", \
                  relaxation = \"40 s\" }";
    for (from, to, expected) in [
        (
            "[fixture_check]",
            "[campaign]\nrepeats = 1\ncells = [{ name = \"A\" }]\n[fixture_check]",
            "map: expected [map] without [campaign]: a map sets the charge itself",
        ),
        (
            "[fixture_check]",
            "[diagnosis]\n[fixture_check]",
            "map: expected [map] without [diagnosis]",
        ),
        (
            "\"90 %\", \"50 %\"",
            "\"50 %\", \"90 %\"",
            "map.soc: expected falling states of charge, because the cell is discharged from point \
             to point, found 90 % after 50 %",
        ),
        (
            "\"90 %\", \"50 %\"",
            "\"99.5 %\", \"50 %\"",
            "map.soc: expected 0.01 (share) to 0.99 (share), found 0.995 (share)",
        ),
        (
            "\"25 °C\", \"10 °C\"]",
            "\"25 °C\", \"25 °C\"]",
            "map.temperatures: expected temperatures that differ, found 25 °C twice",
        ),
        (
            "\"25 °C\", \"10 °C\"]",
            "\"25 °C\", \"-10 °C\"]",
            "map.temperatures: expected 0 °C to 60 °C, found -10 °C",
        ),
        (
            "\"25 °C\", \"10 °C\"]",
            "\"25 °C\"]",
            "map.resistance_max: expected one resistance, or 1, one for each temperature, found 2",
        ),
        (
            "\"90 %\", \"50 %\"",
            "\"98 %\", \"50 %\"",
            "eis.amplitude: expected a cell voltage within 2.5 V to 4.2 V at every point of [map], \
             found 4.058 V to 4.230 V at 98 % and 25 °C",
        ),
        (
            "cut_off = \"0.2 A\"",
            "cut_off = \"2 A\"",
            "map.cut_off: expected 0.02 A to 1.125 A, found 2 A",
        ),
        (
            pulses,
            "pulses = { amplitudes = [], relaxation = \"40 s\" }",
            "map.pulses: expected at least one amplitude, found none",
        ),
        (
            "amplitude = \"1 A\"\n",
            "amplitude = \"1 A\"\nrepeat = 2\n",
            "eis: expected a sweep of the cell with a repeat of 1 beside [map]",
        ),
    ] {
        let ended = example().edit(EXPERIMENT, from, to).run("refused");
        let message = ended.expect_code(2).message();
        assert!(message.contains(expected), "{expected}\n{message}");
    }
    for (file, section, expected) in [
        (
            EXPERIMENT,
            "temperature",
            "map: expected a section [temperature]: the cell is charged at",
        ),
        (
            CELL,
            "ocv",
            "map: expected a section [ocv] in the cell file: the counted charge is",
        ),
        (
            BENCH,
            "instruments.load",
            "instruments.load: expected a section [instruments.load]: ",
        ),
    ] {
        let ended = example().without(file, section).run("refused");
        let message = ended.expect_code(2).message();
        assert!(message.contains(expected), "{expected}\n{message}");
    }
    let nothing = example()
        .edit(EXPERIMENT, pulses, "")
        .without(EXPERIMENT, "eis")
        .without(EXPERIMENT, "fixture_check");
    let ended = nothing.run("refused");
    let message = ended.expect_code(2).message();
    assert!(message.contains("nothing would be measured"), "{message}");
}

#[test]
fn the_example_measures_every_point_at_its_charge_and_temperature() {
    let files = example();
    let run = files.path("run");
    let finished = run_experiment(&files.load(), &run).unwrap();
    let found = points(&run);
    assert_eq!(found.len(), 6);
    let world = finished.simulation.as_ref().unwrap().world();
    for (place, point) in found.iter().enumerate() {
        let soc = [0.9, 0.5, 0.2][place % 3];
        let degc = [25.0, 10.0][place / 3];
        assert!((point.soc - soc).abs() < 1.0e-3, "{point:?}");
        assert!(
            (point.charge_coulomb / COULOMB + 1.0 - point.soc).abs() < 1.0e-5,
            "{point:?}"
        );
        // The cell is full where the current has fallen to 0.2 A, a little below the end of the curve.
        let off = point.soc_by_ocv.unwrap() - point.soc;
        assert!(off.abs() < 0.015, "{point:?}");
        assert!(
            (point.temperature_degc.unwrap() - degc).abs() < 0.3,
            "{point:?}"
        );
        let number = place + 1;
        let name = |path: &Path| path.strip_prefix(&run).unwrap().display().to_string();
        assert_eq!(
            point.spectrum.as_deref().map(name),
            Some(format!("spectra/point_{number}.csv"))
        );
        let series: Vec<String> = point.series.iter().map(|path| name(path)).collect();
        assert_eq!(series, [format!("series_pulses_{number}.bdf.csv")]);
        assert!(run.join(format!("map_discharge_{number}.bdf.csv")).exists());
        assert_eq!(
            read_spectrum_csv(&run.join(format!("spectra/point_{number}.csv")))
                .unwrap()
                .len(),
            12
        );
    }
    // The truth at the end: the counted charge, less the error of full as the curve shows it at 25 °C.
    let traces = json(&run.join("traces.json"));
    let last = &traces["traces"][5];
    let before_coulomb = last["charge_before_c"].as_f64().unwrap();
    assert!((before_coulomb + 0.8 * COULOMB).abs() < 30.0, "{last}");
    let rows = read_trace_csv(&found[5].series[0]).unwrap();
    let counted = 1.0 + (before_coulomb + charge_of(&rows).value()) / COULOMB;
    let full_off = found[0].soc_by_ocv.unwrap() - found[0].soc;
    let truth_soc = world.lock().unwrap().truth_soc();
    assert!(
        (truth_soc - counted - full_off).abs() < 1.5e-3,
        "{truth_soc} {counted} {full_off}"
    );
    // The spectrum of the last point is that of the true cell there.
    let spectrum = read_spectrum_csv(found[5].spectrum.as_ref().unwrap()).unwrap();
    for (point, truth) in spectrum.iter().zip(truth(world, &spectrum)) {
        let off = (point.z_ohm / truth - 1.0).norm();
        assert!(
            off < 0.01,
            "{} Hz: {} instead of {truth}",
            point.freq_hz,
            point.z_ohm
        );
    }
    // The cold charge transfer is more than twice the warm one.
    let arc = |number: usize| {
        let points = read_spectrum_csv(found[number].spectrum.as_ref().unwrap()).unwrap();
        points.first().unwrap().z_ohm.re - points.last().unwrap().z_ohm.re
    };
    assert!(arc(4) > 2.0 * arc(1), "{} {}", arc(4), arc(1));
    let events = fs::read_to_string(run.join("events.csv")).unwrap();
    assert!(
        events.contains("point 2 (50 % and 25 °C): 49.9") || events.contains("50.0"),
        "{events}"
    );
    assert!(events.contains("% by counting, 3.7"), "{events}");
    assert!(
        finished
            .summary
            .contains("map: 6 of 6 points in map_points.csv; counted charge and")
    );
    assert!(
        finished
            .summary
            .contains("note: point 1: charge pulse of 4.5 A left out"),
        "{}",
        finished.summary
    );
    assert!(!run.join("model_1rc.json").exists());
    its_map_is_that_of_the_command(&files, &run, &finished.summary);
    let witness = world.lock().unwrap().witness();
    assert_eq!(witness.abuse, []);
    // All pulses have their resistance, with charge and temperature of their point.
    let made = program(&[
        "hppc".as_ref(),
        run.as_os_str(),
        "--at".as_ref(),
        "1,10".as_ref(),
        "--json".as_ref(),
    ]);
    made.expect_code(0);
    let tables: serde_json::Value = serde_json::from_str(&made.stdout).unwrap();
    let pulses: Vec<usize> = tables
        .as_array()
        .unwrap()
        .iter()
        .map(|table| table["pulses"].as_array().unwrap().len())
        .collect();
    assert_eq!(pulses, [3, 4, 4, 3, 4, 4], "{tables}");
    for (table, point) in tables.as_array().unwrap().iter().zip(&found) {
        let first = &table["pulses"][0];
        let soc = first["state"]["soc"]["value"].as_f64().unwrap();
        assert!((soc - point.soc).abs() < 1.0e-3, "{first}");
        let degc = first["state"]["temperature_c"].as_f64().unwrap();
        assert!(
            (degc - point.temperature_degc.unwrap()).abs() < 0.5,
            "{first}"
        );
    }
}

/// The run has fitted its map as `map` fits it; its files follow from the captures.
fn its_map_is_that_of_the_command(files: &Files, run: &Path, summary: &str) {
    let fitted = |out: &str| {
        let out = files.path(out);
        let words = [
            "map".as_ref(),
            run.as_os_str(),
            "--out".as_ref(),
            out.as_os_str(),
        ];
        let ended = program(&words);
        ended.expect_code(0);
        (ended.stdout, out)
    };
    let (text, out) = fitted("map");
    let headline = text.lines().next().unwrap();
    assert!(
        headline.starts_with("error on pieces of the logs"),
        "{text}"
    );
    assert!(
        summary.contains(&format!("map: {headline}; map.json")),
        "{summary}"
    );
    let report = fs::read_to_string(run.join("report.html")).unwrap();
    let (error, _) = headline.split_once(';').unwrap();
    assert!(
        report.contains(&format!("Map: {error}")) && report.contains("The map: series resistance"),
        "{error}"
    );
    let model = |folder: &Path| {
        let mut model = json(&folder.join("map.json"));
        // The command calls the cell like the folder.
        let name = model["name"].take();
        (name, model)
    };
    assert_eq!(model(run).1, model(&out).1);
    assert_eq!(model(run).0, "Molicel P45B");
    for name in ["map_logs.csv", "map_spectra.csv"] {
        let text = |folder: &Path| fs::read_to_string(folder.join(name)).unwrap();
        assert_eq!(text(run), text(&out), "{name}");
    }
    assert!(run.join("map.svg").is_file() && run.join("map.png").is_file());
    let verified = program(&["verify".as_ref(), run.as_os_str()]);
    verified.expect_code(0);
    let again = files.path("again");
    let words = [
        "replay".as_ref(),
        run.as_os_str(),
        "--out".as_ref(),
        again.as_os_str(),
    ];
    program(&words).expect_code(0);
    assert_eq!(model(run), model(&again));
    assert!(again.join("map_logs.csv").is_file());
}

#[test]
fn a_counted_charge_that_the_curve_denies_is_noted_or_ends_the_run() {
    // A cell with a tenth less charge than its file says.
    let aged = |missed: &str| {
        example()
            .edit(
                SCENARIO,
                "initial_soc = 0.60",
                "initial_soc = 0.60\ncapacity_ah = 4.05",
            )
            .edit(EXPERIMENT, "[\"90 %\", \"50 %\", \"20 %\"]", "[\"40 %\"]")
            .edit(EXPERIMENT, "[\"25 °C\", \"10 °C\"]", "[\"25 °C\"]")
            .edit(EXPERIMENT, "[\"30 mΩ\", \"45 mΩ\"]", "[\"30 mΩ\"]")
            .edit(EXPERIMENT, "points = 12", "points = 2")
            .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"100 Hz\"")
            .edit(
                EXPERIMENT,
                "soc_within = \"3 %\"",
                &format!("soc_within = \"3 %\"\nmissed = \"{missed}\""),
            )
    };
    let files = aged("flag");
    let run = files.path("run");
    let summary = run_experiment(&files.load(), &run).unwrap().summary;
    assert!(
        summary.contains("note: point 1 (40 % and 25 °C): counted charge: expected 3.")
            && summary.contains("pulses left out: expected 3.")
            && summary.contains("from which they could exceed the limits of the cell"),
        "{summary}"
    );
    // A map takes three points of a spectrum.
    assert!(
        summary.contains("note: no map: point_1: expected at least 3 points"),
        "{summary}"
    );
    assert!(!run.join("map.json").exists());
    let found = points(&run);
    // 60 % of 4.5 Ah are two thirds of 4.05 Ah.
    assert!(
        (found[0].soc_by_ocv.unwrap() - 1.0 / 3.0).abs() < 0.015,
        "{found:?}"
    );
    assert!(
        found[0].spectrum.is_some() && found[0].series.is_empty(),
        "{found:?}"
    );
    let refusing = aged("refuse");
    let ended = refusing.run("run");
    assert_ne!(ended.code, Some(0));
    assert!(
        ended
            .message()
            .contains("point 1 (40 % and 25 °C): cell at its counted charge: expected 3."),
        "{}",
        ended.message()
    );
}

/// Two points near full, in scaled time: a few minutes of a bench.
fn near_full() -> Files {
    example()
        .without(EXPERIMENT, "fixture_check")
        .edit(SCENARIO, "initial_soc = 0.60", "initial_soc = 0.975")
        .edit(
            EXPERIMENT,
            "[\"90 %\", \"50 %\", \"20 %\"]",
            "[\"90 %\", \"88 %\"]",
        )
        .edit(EXPERIMENT, "[\"25 °C\", \"10 °C\"]", "[\"22 °C\"]")
        .edit(EXPERIMENT, "setpoint = \"25 °C\"", "setpoint = \"22 °C\"")
        .edit(EXPERIMENT, "within = \"0.2 K\"", "within = \"2 K\"")
        .edit(EXPERIMENT, "[\"30 mΩ\", \"45 mΩ\"]", "[\"30 mΩ\"]")
        .edit(EXPERIMENT, "cut_off = \"0.2 A\"", "cut_off = \"1 A\"")
        .edit(EXPERIMENT, "rest_min = \"10 min\"", "rest_min = \"10 s\"")
        .edit(
            EXPERIMENT,
            "rest_slope = \"0.2 mV/min\"",
            "rest_slope = \"5 mV/min\"",
        )
        // So small that a late step is no current that does not follow its command.
        .edit(EXPERIMENT, "[\"2.25 A\", \"4.5 A\"]", "[\"0.25 A\"]")
        .edit(EXPERIMENT, "points = 12", "points = 2")
        // Slow sinusoids: the simulated law is evaluated many times a period, at many times the pace.
        .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"2 Hz\"")
        .edit(EXPERIMENT, "stop = \"300 Hz\"", "stop = \"5 Hz\"")
}

/// Number of the line of the journal that begins a step, the `number`-th of those with this text.
fn line_of(run: &Path, text: &str, number: usize) -> usize {
    let journal = fs::read_to_string(run.join("journal.jsonl")).unwrap();
    let intents = (1..).zip(journal.lines());
    let mut found = intents.filter(|(_, line)| line.contains(&format!("\"text\":\"{text}")));
    found.nth(number - 1).map(|(line, _)| line).unwrap()
}

#[test]
#[ignore = "drill"]
fn a_map_that_is_killed_goes_on_at_its_point() {
    let files = near_full();
    let ports = Ports::serve(&files, 30.0, 1);
    let whole = files.path("whole");
    files.run("whole").expect_code(0);
    drop(ports);
    // Killed after the intent of each: in a discharge and in pulses the charge is unknown.
    for (text, number, full_charges) in [
        ("discharge at", 2, 2),
        ("rest 10 s", 3, 1),
        ("point  2:", 2, 1),
        ("trace pulses", 1, 2),
    ] {
        let files = near_full();
        let ports = Ports::serve(&files, 30.0, 1);
        let run = files.path("run");
        die(
            &files,
            &run,
            &format!("journal:{}", 2 * line_of(&whole, text, number)),
        );
        crate::guardian::report(&files, "verified");
        resume(&run, &[]).expect_code(0);
        let found = points(&run);
        assert_eq!(found.len(), 2, "{text}: {found:?}");
        for (point, soc) in found.iter().zip([0.9, 0.88]) {
            assert!((point.soc - soc).abs() < 5.0e-3, "{text}: {point:?}");
            assert!(
                point.spectrum.is_some() && point.series.len() == 1,
                "{text}: {point:?}"
            );
        }
        let journal = fs::read_to_string(run.join("journal.jsonl")).unwrap();
        let charges = journal.matches("\"text\":\"charge at").count();
        // On a busy machine a run may go on by itself once more, and charge the cell once more.
        let resumed = journal.matches("\"entry\":{\"resumed\"").count();
        assert!(charges >= full_charges, "{text}: {charges}");
        assert!(
            charges - full_charges < resumed,
            "{text}: {charges}, {resumed}"
        );
        let world = ports.world.lock().unwrap();
        assert_eq!(world.witness().abuse, [], "{text}");
        // Counted charge and true charge differ by that of full, which is the same for both points.
        let off = |point: &MapPoint| point.soc_by_ocv.unwrap() - point.soc;
        let last = &found[1];
        assert!(
            (world.truth_soc() - last.soc - off(last)).abs() < 8.0e-3,
            "{text}: {} {last:?}",
            world.truth_soc()
        );
    }
}
