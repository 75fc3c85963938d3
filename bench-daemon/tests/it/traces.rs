//! Currents that step: planned, checked, driven, recorded, and entered into the index of the run
//! folder.

use std::fs;

use analysis::{
    dataset::{RunIndex, TraceRow, read_spectrum_csv, read_trace_csv},
    formats::{SeriesOptions, read_series},
    series::Role,
};
use bench_core::safety::failure::Failure;
use bench_daemon::command::run::run_experiment;
use bench_plan::{config::load_experiment, procedure};

use crate::support::{BENCH, CELL, EXPERIMENT, Files, SCENARIO, sent};

const TRACE: &str = r#"
[[traces]]
name = "pulses"
role = "held_out"
repeat = 2
rest_first = "20 s"
start_voltage = ["3.77 V", "3.83 V"]
resistance_max = "30 mΩ"
segments = [
    { current = "-5 A", duration = "3 s" },
    { current = "0 A", duration = "12 s" },
    { current = "3 A", duration = "3 s" },
    { current = "0 A", duration = "6 s" },
]
"#;

/// Returns the demo's files with a brief check of the bench, two short sweeps and the trace.
fn files() -> Files {
    Files::short(2)
        .edit(
            EXPERIMENT,
            "amplitude = \"1 A\"",
            "amplitude = \"1 A\"\nrepeat = 2\nrest_first = \"30 s\"",
        )
        .append(EXPERIMENT, TRACE)
}

/// Without a sweep of any kind.
fn trace_only() -> Files {
    Files::short(2)
        .without(EXPERIMENT, "fixture_check")
        .without(EXPERIMENT, "eis")
        .append(EXPERIMENT, TRACE)
}

fn index(files: &Files) -> RunIndex {
    serde_json::from_str(&fs::read_to_string(files.path("run/traces.json")).unwrap()).unwrap()
}

/// Appendix A of the thesis, and the slope of the open-circuit voltage at the charge of the test,
/// V/C.
const SERIES_OHM: f64 = 0.006428631596419841;
const BRANCHES: [(f64, f64); 4] = [
    (0.0015092416058207665, 0.5528122375316784),
    (0.0004040655126863733, 663.8165189932115),
    (0.004774060802661011, 1084.2430675670112),
    (0.0006627965074183888, 6.9798491396501285),
];
const SLOPE_V_PER_C: f64 = 0.85 / 16_200.0;

/// Response of the true cell to a current that runs straight between rows, V, less its voltage at
/// rest.
pub(crate) fn answer(rows: &[TraceRow]) -> Vec<f64> {
    let (mut branches_v, mut moved_coulomb) = ([0.0; 4], 0.0);
    let mut answers = vec![SERIES_OHM * rows[0].current_a];
    for pair in rows.windows(2) {
        let (span_s, from_a) = (pair[1].time_s - pair[0].time_s, pair[0].current_a);
        let slope = (pair[1].current_a - from_a) / span_s;
        for (volts, (r, c)) in branches_v.iter_mut().zip(BRANCHES) {
            let left = (-span_s / (r * c)).exp();
            *volts = *volts * left
                + r * (from_a * (1.0 - left) + slope * (span_s - r * c * (1.0 - left)));
        }
        moved_coulomb += 0.5 * (pair[0].current_a + pair[1].current_a) * span_s;
        answers.push(
            SERIES_OHM * pair[1].current_a
                + branches_v.iter().sum::<f64>()
                + SLOPE_V_PER_C * moved_coulomb,
        );
    }
    answers
}

#[test]
#[ignore = "drill"]
fn a_trace_is_the_truth_within_its_noise_and_the_index_tells_what_is_what() {
    let files = files();
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    let index = index(&files);
    let sweeps: Vec<(&str, usize, bool)> = index
        .sweeps
        .iter()
        .map(|sweep| (sweep.file.as_str(), sweep.order, sweep.corrected))
        .collect();
    assert_eq!(
        sweeps,
        [("spectrum.csv", 0, true), ("spectrum_2.csv", 2, true)]
    );
    for sweep in &index.sweeps {
        assert_eq!(
            read_spectrum_csv(&files.path("run").join(&sweep.file))
                .unwrap()
                .len(),
            2
        );
    }
    let traces: Vec<(&str, usize, Role)> = index
        .traces
        .iter()
        .map(|trace| (trace.file.as_str(), trace.order, trace.role))
        .collect();
    assert_eq!(
        traces,
        [
            ("series_pulses_1.bdf.csv", 1, Role::HeldOut),
            ("series_pulses_2.bdf.csv", 3, Role::HeldOut)
        ]
    );
    // The second sweep begins half a minute after the first trace has ended, at least.
    let events = fs::read_to_string(files.path("run/events.csv")).unwrap();
    assert_eq!(events.matches(",\"rest 30 s\"").count(), 2, "{events}");
    let world = finished
        .simulation
        .as_ref()
        .unwrap()
        .world()
        .lock()
        .unwrap()
        .clone();
    for trace in &index.traces {
        let rows = read_trace_csv(&files.path("run").join(&trace.file)).unwrap();
        let steps_s = [0.5, 3.5, 15.5, 18.5];
        assert!(
            trace.steps_s.len() == 4
                && trace
                    .steps_s
                    .iter()
                    .zip(steps_s)
                    .all(|(met, step)| (met - step).abs() < 0.05),
            "{trace:?}"
        );
        assert!(
            rows.iter().any(|row| (row.current_a + 4.9).abs() < 0.1)
                && rows.iter().any(|row| (row.current_a - 2.97).abs() < 0.1)
        );
        for (row, answer) in rows.iter().zip(answer(&rows)) {
            let noise_v = trace.sample_sigma_v * (1.0 / row.samples + 0.01).sqrt();
            // The position of a step between two samples is uncertain by the sampling interval.
            let jitter_v = if trace
                .steps_s
                .iter()
                .any(|step_s| (0.0..2.0e-3).contains(&(row.time_s - step_s)))
            {
                1.0e-3
            } else {
                1.0e-4
            };
            let off_v = row.voltage_v - trace.start_ocv_v - answer;
            assert!(
                off_v.abs() < 5.0 * noise_v + jitter_v,
                "{} off by {off_v} V: {row:?}",
                trace.file
            );
        }
        assert!(rows.last().unwrap().time_s > 23.0 && rows[0].temperature_degc > 20.0);
        // Any reader of BDF can read it, with discharge positive.
        let series = read_series(
            &files.path("run").join(&trace.file),
            &SeriesOptions::default(),
        )
        .unwrap();
        assert!(
            series.current_a.iter().any(|amps| (amps - 4.9).abs() < 0.1),
            "{series:?}"
        );
    }
    assert!((index.traces[1].start_ocv_v - world.truth_ocv_v()).abs() < 3.0e-3);
    // 5 A for 3 s out, 3 A for 3 s in, and the zero error of the supply.
    assert!(
        (index.traces[1].charge_before_coulomb + 6.0).abs() < 1.5,
        "{}",
        index.traces[1].charge_before_coulomb
    );
    let witness = world.witness();
    assert!(
        witness.abuse_count == 0 && witness.greatest_discharge_a < 5.2,
        "{witness:?}"
    );
    assert_eq!(world.truth_current_a(), 0.0);
    assert!(
        files
            .path("run/captures/trace_pulses_2/frame001.parquet")
            .exists()
    );
    assert!(
        finished
            .summary
            .contains("trace pulses, repeat 2: 4 steps from 3.79"),
        "{}",
        finished.summary
    );
}

#[test]
#[ignore = "drill"]
fn a_trace_needs_no_sweep_and_a_hidden_effect_shows_in_it() {
    let end_v = |files: Files| {
        let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
        assert!(
            !files.path("run/spectrum.csv").exists()
                && finished.measured.spectrum.points.is_empty()
        );
        let rows = read_trace_csv(&files.path("run").join(&index(&files).traces[0].file)).unwrap();
        let before = rows.partition_point(|row| row.time_s < 3.45) - 1;
        rows[before].voltage_v - rows[0].voltage_v
    };
    let hidden = "[effects.slow_rc]\nr_ohm = 2e-3\ntau_s = 3.0\n";
    let (plain_v, hidden_v) = (
        end_v(trace_only()),
        end_v(trace_only().append(SCENARIO, hidden)),
    );
    // 2 mΩ · 4.9 A · (1 − 1/e).
    assert!(
        (hidden_v - plain_v + 6.2e-3).abs() < 3.0e-4,
        "{plain_v} V, {hidden_v} V"
    );
}

#[test]
fn a_generator_whose_least_sine_is_greater_than_its_manual_says_commands_direct_currents() {
    let files = trace_only()
        .edit(
            EXPERIMENT,
            "role = \"held_out\"",
            "role = \"held_out\"\nthrough = \"bipolar\"",
        )
        .append(
            BENCH,
            "[simulation.quirks.generator]\nleast_amplitude = 4e-3",
        );
    run_experiment(&files.load(), &files.path("run")).unwrap();
    let rows = read_trace_csv(&files.path("run").join(&index(&files).traces[0].file)).unwrap();
    assert!(
        rows.iter().any(|row| (row.current_a + 4.9).abs() < 0.1)
            && rows.iter().any(|row| (row.current_a - 2.97).abs() < 0.1)
    );
    let sent = sent(&files.path("run"), "generator");
    assert!(
        sent.iter()
            .any(|message| message.starts_with("C1:BSWV WVTP,SINE")
                && message.contains("AMP,0.0020")),
        "{sent:?}"
    );
}

#[test]
fn the_controls_can_be_measured_for_a_trace_alone() {
    let files = Files::short(2)
        .edit(
            EXPERIMENT,
            "amplitude = \"1 A\"",
            "amplitude = \"1 A\"\nrepeat = 0",
        )
        .append(EXPERIMENT, TRACE);
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    assert_eq!(finished.measured.controls.len(), 2);
    assert!(files.path("run/correction.json").exists() && !files.path("run/spectrum.csv").exists());
    assert_eq!(
        (index(&files).sweeps.len(), index(&files).traces.len()),
        (0, 2)
    );
    // The controls saw 1 A, the traces 5 A.
    let wording = "note: trace pulses, repeat 1; trace pulses, repeat 2 measured on channel ";
    assert_eq!(
        finished.summary.matches(wording).count(),
        1,
        "{}",
        finished.summary
    );
    let report = fs::read_to_string(files.path("run/report.html")).unwrap();
    assert!(
        report.contains("Traces (noise of one sample")
            && report.contains("The bench as its controls show it")
    );
    assert!(files.path("run/plots/trace_pulses_2.png").exists());
}

#[test]
fn the_interlock_ends_a_trace_that_leaves_the_window() {
    // The cell resists more than the file claims, so that the plan is not refused.
    let files = trace_only().edit(EXPERIMENT, "\"30 mΩ\"", "\"1 mΩ\"").edit(
        CELL,
        "voltage_min = \"2.5 V\"",
        "voltage_min = \"3.74 V\"",
    );
    let failure = run_experiment(&files.load(), &files.path("run"))
        .map(|_| ())
        .unwrap_err();
    let message = failure.to_string();
    assert_eq!(failure.exit_code(), 5, "{message}");
    assert!(
        message.starts_with("interlock: cell voltage 3.")
            && message.contains("left its limits (3.74 V to 4.2 V)"),
        "{message}"
    );
    let last = sent(&files.path("run"), "supply4q")
        .into_iter()
        .rev()
        .find(|message| message.starts_with("OUTP O"));
    assert_eq!(last.as_deref(), Some("OUTP OFF"));
    assert!(!files.path("run/traces.json").exists());
}

#[test]
fn a_trace_does_not_begin_at_another_voltage_than_it_was_checked_for() {
    let files = trace_only().edit(
        EXPERIMENT,
        "[\"3.77 V\", \"3.83 V\"]",
        "[\"3.6 V\", \"3.7 V\"]",
    );
    let message = run_experiment(&files.load(), &files.path("run"))
        .map(|_| ())
        .unwrap_err()
        .to_string();
    assert!(
        message.starts_with(
            "cell before trace pulses: expected 3.6 V to 3.7 V at rest, measured 3.79"
        ),
        "{message}"
    );
    assert!(!sent(&files.path("run"), "supply4q").contains(&"OUTP ON".to_owned()));
}

#[test]
fn a_plan_that_could_leave_the_limits_is_refused() {
    for (from, to, reason) in [
        (
            "\"3 A\", duration",
            "\"14 A\", duration",
            "expected charge currents of at most 13.5 A, found 14 A",
        ),
        (
            "\"-5 A\", duration = \"3 s\"",
            "\"-15 A\", duration = \"30 min\"",
            "expected charge within ±2.250 Ah of the start, found -7.500 Ah",
        ),
        (
            "\"30 mΩ\"",
            "\"150 mΩ\"",
            "expected a cell voltage within 2.5 V to 4.2 V at worst, found 3.0",
        ),
        (
            "\"-5 A\", duration = \"3 s\"",
            "\"-5 A\", duration = \"20 min\"",
            "expected a cell voltage within 2.5 V to 4.2 V at worst, found 2.3",
        ),
    ] {
        let experiment = trace_only().edit(EXPERIMENT, from, to).load();
        let refused = procedure::plan(&experiment)
            .check(&experiment.cell.limits)
            .map(|_| ())
            .unwrap_err();
        assert!(refused.to_string().contains(reason), "{refused}");
        assert_eq!(Failure::from(refused).exit_code(), 2);
    }
}

#[test]
fn the_shunt_is_swept_alone_at_given_frequencies() {
    let sweep = "amplitude = \"1 A\"\nfixture = \"shunt\"\n\
    frequencies = [\"300 Hz\", \"100 Hz\", \"1 kHz\"]";
    let files = Files::short(2).without(EXPERIMENT, "fixture_check").edit(
        EXPERIMENT,
        "start = \"100 Hz\"\nstop = \"300 Hz\"\npoints = 2\namplitude = \"1 A\"",
        sweep,
    );
    run_experiment(&files.load(), &files.path("run")).unwrap();
    let index = index(&files);
    let [sweep] = index.sweeps.as_slice() else {
        panic!("{index:?}")
    };
    assert_eq!(
        (sweep.file.as_str(), sweep.fixture.as_str()),
        ("raw_shunt_sweep_1.csv", "shunt")
    );
    assert!(
        sweep
            .fixture_ohm
            .is_some_and(|ohm| (ohm - 9.96e-3).abs() < 1.0e-9),
        "{index:?}"
    );
    assert!(
        !sweep.corrected && sweep.start_ocv_v.is_none() && index.traces.is_empty(),
        "{index:?}"
    );
    let points = read_spectrum_csv(&files.path("run").join(&sweep.file)).unwrap();
    assert_eq!(
        points.iter().map(|point| point.freq_hz).collect::<Vec<_>>(),
        [100.0, 300.0, 1000.0]
    );
    assert!(
        points
            .iter()
            .all(|point| (point.z_ohm.re / 9.96e-3 - 1.0).abs() < 0.05),
        "{points:?}"
    );
}

#[test]
fn mistakes_in_traces_are_named() {
    let complaint = |files: Files| {
        load_experiment(&files.experiment(), None)
            .unwrap_err()
            .to_string()
    };
    for (from, to, expected) in [
        (
            "name = \"pulses\"",
            "name = \"a pulse\"",
            "traces.name: expected a name of letters, digits, `-` and `_`, found \"a pulse\"",
        ),
        (
            "\"-5 A\"",
            "\"-25 A\"",
            "traces.pulses.segments: row 1: expected -20 A to 20 A, which the bipolar supply \
            kepco-bop-mg can drive, found -25 A",
        ),
        (
            "\"12 s\"",
            "\"100 ms\"",
            "traces.pulses.segments: row 2: expected 0.5 s to 86400 s, which the bipolar supply \
            step by step can play, found 0.1 s",
        ),
        (
            "\"12 s\"",
            "\"0 s\"",
            "traces.pulses.segments: row 2: expected a duration above 0 s, found 0 s",
        ),
        (
            "segments = [",
            "scale = 0.0\nsegments = [",
            "traces.pulses.scale: expected a factor other than 0, with which nothing would flow",
        ),
        (
            "segments = [",
            "step = \"25 s\"\nsegments = [",
            "traces.pulses.step: expected at most the 24 s that the trace lasts, found 25 s",
        ),
        (
            "\"held_out\"",
            "\"test\"",
            "traces.1.role: unknown variant `test`, expected `train` or `held_out`",
        ),
        (
            "\"3.77 V\", \"3.83 V\"",
            "\"3.83 V\", \"3.77 V\"",
            "traces.pulses.start_voltage: expected two rising voltages within 2.5 V to 4.2 V",
        ),
        (
            "segments = [",
            "file = \"a.csv\"\nsegments = [",
            "traces.pulses.segments: expected segments or a file of them, and not both",
        ),
    ] {
        let message = complaint(trace_only().edit(EXPERIMENT, from, to));
        assert!(message.contains(expected), "{message}");
    }
    let message = complaint(
        Files::short(2)
            .without(EXPERIMENT, "eis")
            .append(EXPERIMENT, TRACE),
    );
    assert!(
        message.contains(
            "fixture_check: expected a section [eis], whose frequencies the \
    controls are measured at"
        ),
        "{message}"
    );
    let (head, _) = TRACE.split_once("segments").unwrap();
    for (text, expected) in [
        (
            "amps,seconds\n1,2\n",
            "steps.csv:1: current_a,duration_s: expected the header current_a,duration_s or \
            power_w,duration_s, found \"amps,seconds\"",
        ),
        (
            "current_a,duration_s\n-1,2\n3;4\n",
            "steps.csv:3: current_a,duration_s: expected two numbers, found \"3;4\"",
        ),
        (
            "current_a,duration_s\n",
            "traces.pulses.file: expected at least one segment, found none",
        ),
        (
            "current_a,duration_s\n1,2\nnan,2\n",
            "steps.csv:3: current_a,duration_s: expected a finite current, found NaN",
        ),
        (
            "power_w,duration_s\n-inf,2\n",
            "steps.csv:2: current_a,duration_s: expected a finite power, found -inf",
        ),
        (
            "current_a,duration_s\n1,nan\n",
            "steps.csv:2: current_a,duration_s: expected a duration above 0 s, found NaN s",
        ),
        (
            "current_a,duration_s\n1,-2\n",
            "steps.csv:2: current_a,duration_s: expected a duration above 0 s, found -2 s",
        ),
    ] {
        let files = Files::short(2)
            .without(EXPERIMENT, "fixture_check")
            .without(EXPERIMENT, "eis")
            .append(EXPERIMENT, &format!("{head}file = \"steps.csv\""));
        files.write("experiments/steps.csv", text);
        let message = complaint(files);
        assert!(message.contains(expected), "{message}");
    }
    let message = complaint(trace_only().append(EXPERIMENT, TRACE));
    assert!(
        message.contains("traces: expected names that differ, found \"pulses\" twice"),
        "{message}"
    );
}

#[test]
fn a_power_becomes_a_current_by_the_voltage_of_the_moment_and_is_planned_at_worst() {
    let files = trace_only().edit(
        EXPERIMENT,
        "{ current = \"-5 A\", duration = \"3 s\" }",
        "{ power = \"-15 W\", duration = \"3 s\" }",
    );
    let text = crate::support::program(&["plan".as_ref(), files.experiment().as_os_str()]).stdout;
    // 15 W at the 2.5 V that the cell never falls below.
    assert!(
        text.contains(
            "trace pulses, repeat 1: 4 steps from -6 A to 3 A at worst, by power, \
    first 15 W out of the cell, "
        ),
        "{text}"
    );
    run_experiment(&files.load(), &files.path("run")).unwrap();
    let rows = read_trace_csv(&files.path("run/series_pulses_1.bdf.csv")).unwrap();
    let powers: Vec<f64> = rows
        .iter()
        .filter(|row| row.current_a < -2.0)
        .map(|row| row.current_a * row.voltage_v)
        .collect();
    // The voltage falls by 2 % under it, the supply's gain is 2 % low.
    assert!(
        !powers.is_empty() && powers.iter().all(|watts| (-15.3..-14.0).contains(watts)),
        "{powers:?}"
    );
    let both = trace_only().edit(
        EXPERIMENT,
        "{ current = \"-5 A\",",
        "{ current = \"-5 A\", power = \"-15 W\",",
    );
    let refused = load_experiment(&both.experiment(), None)
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("traces.pulses.segments: expected a current or a power, and not both"),
        "{refused}"
    );
}

#[test]
#[ignore = "drill"]
fn steps_that_follow_each_other_fast_do_not_keep_the_cell_from_being_watched() {
    let segments: String = (0..20)
        .map(|k| {
            format!(
                "    {{ current = \"{} A\", duration = \"1 s\" }},\n",
                if k % 2 == 0 { -5 } else { -4 }
            )
        })
        .collect();
    let i = TRACE.find("segments").unwrap();
    let trace = format!(
        "{}segments = [\n{segments}    {{ current = \"0 A\", duration = \"3 s\" }},\n]\n",
        &TRACE[..i]
    );
    let files = Files::short(2)
        .without(EXPERIMENT, "fixture_check")
        .without(EXPERIMENT, "eis")
        .append(EXPERIMENT, &trace);
    run_experiment(&files.load(), &files.path("run")).unwrap();
    let readings = fs::read_to_string(files.path("run/readings.csv")).unwrap();
    let flowing: Vec<f64> = readings
        .lines()
        .filter(|line| {
            line.split(',')
                .nth(3)
                .and_then(|amps| amps.parse().ok())
                .is_some_and(|amps: f64| amps < -3.0)
        })
        .map(|line| line.split(',').next().unwrap().parse().unwrap())
        .collect();
    // Two repeats of 20 s.
    assert!(flowing.len() >= 16, "{flowing:?}");
    let longest_s = flowing
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .filter(|gap_s| *gap_s < 10.0)
        .fold(0.0, f64::max);
    assert!(
        longest_s < 3.0,
        "{longest_s} s without a reading: {flowing:?}"
    );
}

#[test]
fn a_direct_current_is_added_to_every_row_of_currents_and_not_to_powers() {
    let currents = |files: &Files| -> Vec<f64> {
        let experiment = files.load();
        let segments = experiment.traces[0].segments.iter();
        segments.map(|segment| segment.current_a.value()).collect()
    };
    let key =
        |bias: &str| trace_only().edit(EXPERIMENT, "segments = [", &format!("{bias}segments = ["));
    assert_eq!(currents(&key("")), [-5.0, 0.0, 3.0, 0.0]);
    assert_eq!(
        currents(&key("bias = \"-1.5 A\"\n")),
        [-6.5, -1.5, 1.5, -1.5]
    );
    let powers = key("bias = \"1 A\"\n").edit(EXPERIMENT, "current = \"3 A\"", "power = \"3 W\"");
    let message = load_experiment(&powers.experiment(), None)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains(
            "traces.pulses.bias: expected rows of currents beside it, found a power in row 3"
        ),
        "{message}"
    );
}
