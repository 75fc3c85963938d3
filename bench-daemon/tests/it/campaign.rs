//! Campaigns: several cells, several times, one set of files; and run control requests to a
//! running campaign.

use std::fs;

use analysis::{dataset::RunIndex, ocv::OcvCurve, spectrum::Spectrum};
use bench_daemon::command::run::run_experiment;
use bench_plan::{plan::Purpose, procedure};

use crate::{
    resume::resume,
    support::{
        EXPERIMENT, Files, Ports, Running, SCENARIO, command, files_below, json, poll, program,
    },
};

/// Returns files with two cells, two sweeps each, a few points.
fn files() -> Files {
    Files::short(3)
        .append(
            EXPERIMENT,
            "[campaign]\nrepeats = 2\ncells = [{ name = \"A\", serial = \"S1\" }, \
        { name = \"B\" }]",
        )
        .append(SCENARIO, "[specimens]\ncount = 2")
}

#[test]
fn a_campaign_that_asks_for_it_ends_with_a_diagnosis_of_each_cell() {
    let files = files().append(EXPERIMENT, "[diagnosis]");
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    run_experiment(&files.load(), &files.path("again")).unwrap();
    let run = files.path("run");
    for cell in ["A", "B"] {
        let folder = run.join("diagnosis").join(cell);
        let diagnosis = json(&folder.join("diagnosis.json"));
        assert!(diagnosis["verdict"].is_string(), "{diagnosis}");
        let line = format!(
            "diagnosis:  cell {cell}: {}; ",
            diagnosis["summary"].as_str().unwrap()
        );
        assert!(
            finished.summary.contains(&line),
            "expected {line:?} in {}",
            finished.summary
        );
        let page = fs::read_to_string(folder.join("diagnosis.html")).unwrap();
        assert!(
            page.contains(&format!(
                "eis-bench diagnose . --model model_1rc.json --specimen {cell}"
            )),
            "{cell}"
        );
        let again = files
            .path("again/diagnosis")
            .join(cell)
            .join("diagnosis.html");
        assert!(
            page == fs::read_to_string(again).unwrap(),
            "the page of {cell} differs in another folder"
        );
    }
    // It is a part of the run, and included in its hashes.
    let verified = command(&["verify".as_ref(), run.as_os_str()])
        .output()
        .unwrap();
    assert_eq!(
        verified.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&verified.stderr)
    );
    fs::write(run.join("diagnosis/A/diagnosis.json"), "{}").unwrap();
    assert_ne!(
        command(&["verify".as_ref(), run.as_os_str()])
            .output()
            .unwrap()
            .status
            .code(),
        Some(0)
    );
}

#[test]
fn two_by_two_give_four_spectra_their_spread_and_one_model_and_the_same_files_again() {
    let files = files();
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    run_experiment(&files.load(), &files.path("again")).unwrap();
    let (run, again) = (files.path("run"), files.path("again"));
    assert_eq!(files_below(&run), files_below(&again));
    // The log belongs to the process, not to the run: two runs in one process share it, and the
    // list of hashes contains the hash of the log.
    for name in files_below(&run)
        .into_iter()
        .filter(|name| name.as_os_str() != "log.txt" && name.as_os_str() != "SHA256SUMS")
    {
        assert!(
            fs::read(run.join(&name)).unwrap() == fs::read(again.join(&name)).unwrap(),
            "{} differs",
            name.display()
        );
    }
    let names = |spectrum: &Spectrum| spectrum.name.clone();
    let measured = &finished.measured;
    assert_eq!(names(&measured.spectrum), "A_1");
    assert_eq!(
        measured.repeats.iter().map(names).collect::<Vec<_>>(),
        ["A_2", "B_1", "B_2"]
    );
    let spectra: Vec<_> = files_below(&run.join("spectra"))
        .iter()
        .map(|name| name.display().to_string())
        .collect();
    assert_eq!(spectra, ["A_1.csv", "A_2.csv", "B_1.csv", "B_2.csv"]);
    let campaign = json(&run.join("campaign.json"));
    assert_eq!(campaign["runs"].as_array().unwrap().len(), 4);
    assert_eq!(campaign["cells"][0]["serial"], "S1");
    assert_eq!(campaign["models"].as_array().unwrap().len(), 1);
    // Every spectrum is judged, and each verdict names its spectrum.
    let report = fs::read_to_string(run.join("report.html")).unwrap();
    for text in [
        "drift of 4 spectra: ",
        "Corrected spectrum of A_1 (",
        "Uncertainty budget of A_1: ",
        "Nyquist plot, Molicel P45B, 2 cells",
        "repeat 2",
    ] {
        assert!(report.contains(text), "{text}");
    }
    assert!(
        finished.summary.contains("A_1: |Z| at ")
            && finished.summary.contains("A_1: uncertainty of |Z|"),
        "{}",
        finished.summary
    );
    assert!(
        finished.summary.contains("drift of 4 spectra: "),
        "{}",
        finished.summary
    );
    assert!(
        campaign["runs"]
            .as_array()
            .unwrap()
            .iter()
            .all(|run| run["validity"].is_string() && run["soc_missed"] == false)
    );
    // The true cells differ by at most some per cent, and the repeats of one by noise alone.
    let point = &campaign["spread"][0];
    let number = |field: &str| point[field].as_f64().unwrap();
    assert!(
        (1.0e-4..0.05).contains(&number("cells_magnitude_rel")),
        "{point}"
    );
    assert!(
        number("repeats_re_ohm") < 5.0 * number("stated_re_ohm"),
        "{point}"
    );
    assert!(
        finished
            .summary
            .contains("campaign: 4 spectra of 2 cells; |Z| differs by "),
        "{}",
        finished.summary
    );
    assert!(run.join("plots/campaign.svg").exists() && run.join("plots/campaign.png").exists());
}

#[test]
fn the_spread_between_cells_is_that_of_the_true_cells() {
    let files = files();
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    let mut world = finished.simulation.unwrap().world().lock().unwrap().clone();
    let measured = &finished.measured;
    for (number, spectrum) in [(1, &measured.spectrum), (2, &measured.repeats[2])] {
        use instruments::{fixture::Fixture, mock::plant::Plant};
        assert!(world.insert(1.0e6, number));
        for point in &spectrum.points {
            let true_ohm = world.truth_impedance(Fixture::Cell, point.freq_hz).norm();
            let off = (point.magnitude_ohm() / true_ohm - 1.0).abs();
            assert!(
                off < 0.003,
                "cell {number}, {} Hz: off by {off}",
                point.freq_hz
            );
        }
    }
}

#[test]
#[ignore = "drill"]
fn a_campaign_is_paused_reordered_aborted_and_gone_on_with_from_another_terminal() {
    let files = files().without(EXPERIMENT, "fixture_check");
    let ports = Ports::serve(&files, 10.0, 1);
    let run = files.path("run");
    let experiment = files.experiment();
    let start = |arguments: &[&std::ffi::OsStr]| Running(command(arguments).spawn().unwrap());
    let say = |arguments: &[&str]| {
        let mut all: Vec<&std::ffi::OsStr> = vec![arguments[0].as_ref(), run.as_os_str()];
        all.extend(
            arguments[1..]
                .iter()
                .map(|argument| <str as AsRef<std::ffi::OsStr>>::as_ref(argument)),
        );
        program(&all).expect_code(0);
    };
    let wait_for_journal = |text: &str| {
        poll(text, || {
            fs::read_to_string(run.join("journal.jsonl"))
                .ok()
                .filter(|journal| journal.contains(text))
        })
    };
    let rows = |name: &str| {
        poll(name, || {
            run.join("spectra").join(name).exists().then_some(())
        });
    };

    let mut child = start(&[
        "run".as_ref(),
        experiment.as_os_str(),
        "--out".as_ref(),
        run.as_os_str(),
    ]);
    rows("A_1.csv");
    say(&["pause"]);
    wait_for_journal("\"entry\":\"paused\"");
    assert_eq!(
        ports.world.lock().unwrap().truth_current_a(),
        0.0,
        "paused means no current"
    );
    let kept = fs::read(run.join("journal.jsonl")).unwrap();
    let refused = resume(&run, &[]);
    refused.expect_code(8);
    assert!(
        refused
            .message()
            .contains("expected a bench that is not in use: process "),
        "{}",
        refused.message()
    );
    assert!(
        fs::read(run.join("journal.jsonl")).unwrap() == kept && run.join("wishes.json").exists(),
        "a run that goes on is left alone"
    );
    say(&["reorder", "3"]);
    for (wanted, found) in [
        (&["99"][..], "found 99, of 4 runs"),
        (&["4", "4"], "found 4 twice"),
    ] {
        let arguments = ["reorder".as_ref(), run.as_os_str()]
            .into_iter()
            .chain(wanted.iter().map(|text| text.as_ref()));
        let refused = program(&arguments.collect::<Vec<_>>());
        refused.expect_code(2);
        assert!(refused.message().contains(found), "{}", refused.message());
    }
    let planned_order = program(&[
        "reorder".as_ref(),
        run.as_os_str(),
        "4".as_ref(),
        "2".as_ref(),
    ]);
    planned_order.expect_code(0);
    assert!(
        planned_order.stdout.contains("then: 4, 2, 3"),
        "{}",
        planned_order.stdout
    );
    assert!(
        planned_order
            .stdout
            .contains("the order that was asked for before holds no more: 3"),
        "{}",
        planned_order.stdout
    );
    say(&["go-on"]);
    wait_for_journal("\"entry\":\"gone_on\"");
    rows("B_2.csv");
    say(&["abort"]);
    assert_eq!(child.0.wait().unwrap().code(), Some(130));
    let mut wording = String::new();
    std::io::Read::read_to_string(child.0.stderr.as_mut().unwrap(), &mut wording).unwrap();
    for text in [
        "run 1, cell A: EIS sweep of the cell …",
        "paused on request: every output is off; ",
        "run 4, cell B: EIS sweep of the cell …",
        "ended on request; ",
    ] {
        assert!(wording.contains(text), "{text}: {wording}");
    }
    ports.assert_outputs_off();
    assert!(!run.join("spectra/A_2.csv").exists() && !run.join("spectra/B_1.csv").exists());
    let ended = program(&["pause".as_ref(), run.as_os_str()]);
    ended.expect_code(2);
    assert!(ended.message().contains(
        "expected a run that is going on, found one that has ended: ended early: ended on request"
    ));

    resume(&run, &[]).expect_code(0);
    let index: RunIndex =
        serde_json::from_str(&fs::read_to_string(run.join("traces.json")).unwrap()).unwrap();
    let order: Vec<&str> = index
        .sweeps
        .iter()
        .map(|sweep| sweep.file.as_str())
        .collect();
    assert_eq!(
        order,
        [
            "spectra/A_1.csv",
            "spectra/B_2.csv",
            "spectra/A_2.csv",
            "spectra/B_1.csv"
        ]
    );
    assert_eq!(
        index
            .sweeps
            .iter()
            .map(|sweep| sweep.order)
            .collect::<Vec<_>>(),
        [0, 1, 2, 3]
    );
    ports.assert_outputs_off();
    assert_eq!(ports.world.lock().unwrap().witness().abuse, []);
}

#[test]
fn the_temperature_is_held_before_the_reset_and_after_it() {
    let order = |files: Files| -> Vec<Purpose> {
        let campaign = "[campaign]\nrepeats = 1\ncells = [{ name = \"A\" }]";
        let stages = procedure::plan(&files.append(EXPERIMENT, campaign).load()).stages;
        stages
            .iter()
            .filter(|stage| stage.run() == Some(1))
            .map(|stage| stage.purpose)
            .collect()
    };
    use Purpose::{SocReset, Sweep, Temperature};
    let sweep = Sweep(instruments::fixture::Fixture::Cell, 1);
    assert_eq!(
        order(Files::demo()),
        [Temperature, SocReset, Temperature, sweep]
    );
    assert_eq!(
        order(Files::demo().without(EXPERIMENT, "soc_reset")),
        [Temperature, sweep]
    );
    assert_eq!(order(Files::brief(2)), [SocReset, sweep]);
}

#[test]
fn a_campaign_that_cannot_be_is_refused() {
    let refuse = |files: &Files| files.run("refused").expect_code(2).message().to_owned();
    for (from, to, expected) in [
        (
            "name = \"B\"",
            "name = \"A\"",
            "campaign.cells.2.name: expected names that differ, found \"A\" twice",
        ),
        (
            "name = \"B\"",
            "name = \"a\"",
            "campaign.cells.2.name: expected names that differ in more than capital and small \
            letters, found \"A\" and \"a\"",
        ),
        (
            "name = \"B\"",
            "name = \"B\", serial = \"S1\"",
            "campaign.cells.2.serial: expected serial numbers that differ, found \"S1\" for A and \
            B",
        ),
        (
            "name = \"B\"",
            "name = \"B/\"",
            "campaign.cells.2.name: expected a name of letters, digits and `-`, found \"B/\"",
        ),
        (
            "repeats = 2",
            "repeats = 0",
            "campaign.repeats: expected 1 repeats to 1000 repeats, found 0 repeats",
        ),
        (
            "amplitude = \"1 A\"",
            "amplitude = \"1 A\"\nrepeat = 2",
            "campaign: expected a section [eis] that sweeps the cell with a repeat of 1",
        ),
    ] {
        let message = refuse(&files().edit(EXPERIMENT, from, to));
        assert!(message.contains(expected), "{message}");
    }
    let none = files().edit(SCENARIO, "count = 2", "count = 1").run("one");
    none.expect_code(2);
    let expected = "campaign.cells: expected at most 1 cell, the number of the simulated bench \
    (specimens.count of ";
    assert!(
        none.message().contains(expected)
            && none.message().contains("\"B\" is the first in excess"),
        "{}",
        none.message()
    );
}

#[test]
fn the_index_names_the_cells_and_a_diagnosis_is_one_cells() {
    let files = Files::short(8)
        .append(
            EXPERIMENT,
            "[campaign]\nrepeats = 2\ncells = [{ name = \"A\" }, { name = \"B\" }]",
        )
        .append(SCENARIO, "[specimens]\ncount = 2");
    files.run("run").expect_code(0);
    let run = files.path("run");
    let index: RunIndex =
        serde_json::from_str(&fs::read_to_string(run.join("traces.json")).unwrap()).unwrap();
    let cells: Vec<Option<&str>> = index
        .sweeps
        .iter()
        .map(|sweep| sweep.cell.as_deref())
        .collect();
    assert_eq!(cells, [Some("A"), Some("A"), Some("B"), Some("B")]);
    let model = run.join("model_1rc.json");
    // The model of a campaign is made from several cells, and has no curve of a single one.
    let curve = OcvCurve::monotone(4.5, vec![0.0, 0.5, 1.0], vec![2.8, 3.7, 4.2]).unwrap();
    let ocv = files.path("ocv.json");
    fs::write(&ocv, serde_json::to_string(&curve).unwrap()).unwrap();
    let diagnose = |more: &[&str]| {
        let mut arguments = vec![
            "diagnose".as_ref(),
            run.as_os_str(),
            "--model".as_ref(),
            model.as_os_str(),
            "--ocv".as_ref(),
            ocv.as_os_str(),
        ];
        arguments.extend(
            more.iter()
                .map(|argument| <str as AsRef<std::ffi::OsStr>>::as_ref(argument)),
        );
        program(&arguments)
    };
    let out = files.path("out");
    let both = diagnose(&["--out", out.to_str().unwrap()]);
    let text = &both.expect_code(0).stdout;
    assert!(
        text.contains("cell A:\n") && text.contains("cell B:\n"),
        "{text}"
    );
    assert!(out.join("A/diagnosis.json").exists() && out.join("B/diagnosis.json").exists());
    let one = diagnose(&["--specimen", "B", "--json"]);
    let diagnosis: serde_json::Value = serde_json::from_str(&one.expect_code(0).stdout).unwrap();
    assert!(diagnosis["verdict"].is_string(), "{diagnosis}");
    let list: serde_json::Value =
        serde_json::from_str(&diagnose(&["--json"]).expect_code(0).stdout).unwrap();
    assert_eq!(
        (list[0]["cell"].as_str(), list[1]["cell"].as_str()),
        (Some("A"), Some("B"))
    );
    let none = diagnose(&["--specimen", "C"]);
    assert_eq!(
        none.expect_code(2).message(),
        "--specimen: expected one of A, B, found C"
    );
}

#[test]
#[ignore = "long drill"]
fn a_linear_cell_is_rarely_doubted_for_a_harmonic() {
    let files = Files::demo()
        .without(EXPERIMENT, "temperature")
        .without(EXPERIMENT, "soc_reset")
        .without(EXPERIMENT, "fixture_check")
        .edit(
            EXPERIMENT,
            "amplitude = \"1 A\"",
            "amplitude = \"3 A\"\nrepeat = 12",
        )
        .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]");
    run_experiment(&files.load(), &files.path("run")).unwrap();
    let report = fs::read_to_string(files.path("run/report.html")).unwrap();
    let judged: Vec<&str> = (1..=12)
        .map(|number| {
            report
                .split(&format!(">sweep {number}<"))
                .nth(1)
                .unwrap()
                .split("</tr>")
                .next()
                .unwrap()
        })
        .collect();
    // The stated rate is one false alarm in a hundred sweeps.
    assert!(
        judged
            .iter()
            .filter(|text| text.contains("harmonic 3 of"))
            .count()
            <= 1,
        "{judged:#?}"
    );
}

#[test]
#[ignore = "long drill"]
fn a_reset_leaves_nothing_of_what_traces_have_moved() {
    let trace = "[[traces]]\nname = \"pulse\"\nrest_first = \"2 s\"\n\
    start_voltage = [\"3.6 V\", \"3.85 V\"]\nresistance_max = \"30 mΩ\"\n\
                 pulses = { amplitudes = [\"3 A\"], duration = \"4 s\", relaxation = \"6 s\" }\n\n\
                 [campaign]\nrepeats = 2\ncells = [{ name = \"A\" }]";
    let charges = |files: Files| -> Vec<f64> {
        let files = files
            .without(EXPERIMENT, "fixture_check")
            .append(EXPERIMENT, trace);
        run_experiment(&files.load(), &files.path("run")).unwrap();
        let index: RunIndex =
            serde_json::from_str(&fs::read_to_string(files.path("run/traces.json")).unwrap())
                .unwrap();
        assert!(
            index
                .traces
                .iter()
                .all(|trace| trace.cell.as_deref() == Some("A") && trace.repeat_group == "pulse_A"),
            "{index:?}"
        );
        // The edges are sampled fast: within 20 ms of each step there are rows.
        let rows =
            analysis::dataset::read_trace_csv(&files.path("run").join(&index.traces[0].file))
                .unwrap();
        for step_s in &index.traces[0].steps_s {
            let near = rows
                .iter()
                .filter(|row| (step_s - 0.02..step_s + 0.02).contains(&row.time_s))
                .count();
            assert!(near >= 4, "{near} rows around {step_s} s");
        }
        index
            .traces
            .iter()
            .map(|trace| trace.charge_before_coulomb)
            .collect()
    };
    assert_eq!(charges(Files::brief(2)), [0.0, 0.0]);
    let kept = charges(Files::short(2));
    // The supply's zero error flows throughout.
    assert!(
        kept[0] == 0.0 && kept[1] != 0.0 && kept[1].abs() < 3.0,
        "{kept:?}"
    );
}
