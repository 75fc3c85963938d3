//! Profiles from files through every path of a bench: load and supply, the bipolar supply step by
//! step, and a wave in the generator's memory.

use std::fs;

use analysis::{
    dataset::{RunIndex, TraceRow, read_trace_csv},
    formats::{ReadOptions, read_profile},
    forward::{Demand, Interpolation},
};
use bench_daemon::command::run::run_experiment;
use bench_evaluate::run::Finished;
use bench_plan::config::load_experiment;

use instruments::mock::plant::{Action, LoadState, Plant, SupplyState};

use crate::{
    kill::{end, start},
    support::{BENCH, CELL, EXPERIMENT, Files, Ports, SCENARIO, poll, sent},
    traces::answer,
};

const HEAD: &str = r#"
[[traces]]
name = "jump"
rest_first = "20 s"
start_voltage = ["3.77 V", "3.83 V"]
resistance_max = "30 mΩ"
longest_interval = "1 s"
file = "jump.csv"
"#;

/// Returns files with a trace from a file alone.
fn files(more: &str, rows: &str) -> Files {
    let files = Files::short(2)
        .without(EXPERIMENT, "fixture_check")
        .without(EXPERIMENT, "eis")
        .append(EXPERIMENT, &format!("{HEAD}{more}"));
    files.write("experiments/jump.csv", rows);
    files
}

/// Returns the profile after the controls and two points of a sweep: the effect of channels and
/// harness on a voltage is corrected.
fn corrected(more: &str, rows: &str) -> Files {
    let files = Files::short(2).append(EXPERIMENT, &format!("{HEAD}{more}"));
    files.write("experiments/jump.csv", rows);
    files
}

/// Returns the bench with one instrument of each second kind.
fn mixed(files: Files) -> Files {
    let text =
        fs::read_to_string(crate::configuration::configs().join("benches/mixed.toml")).unwrap();
    files.write(BENCH, &text);
    files
}

fn run(files: &Files) -> (Finished, Vec<TraceRow>, RunIndex) {
    let finished = run_experiment(&files.load(), &files.path("run")).unwrap();
    let rows = read_trace_csv(&files.path("run/series_jump_1.bdf.csv")).unwrap();
    let index = serde_json::from_str(&files.text("run/traces.json")).unwrap();
    (finished, rows, index)
}

fn refused(files: &Files) -> String {
    load_experiment(&files.experiment(), None)
        .unwrap_err()
        .to_string()
}

/// Returns the rows within an interval of test time.
fn between(rows: &[TraceRow], from_s: f64, to_s: f64) -> Vec<&TraceRow> {
    rows.iter()
        .filter(|row| (from_s..to_s).contains(&row.time_s))
        .collect()
}

const METERED_WAY: &str = "through = \"load_and_supply\"\nlead_resistance = \"12 mΩ\"";
const METERED: &str = "current_a,duration_s\n-6,10\n0,5\n2,10\n-3,4\n-8,4\n0,10\n";

#[test]
fn load_and_supply_play_what_is_drawn_and_what_is_charged_and_the_bipolar_supply_stays_off() {
    for (name, files) in [
        ("demo", files(METERED_WAY, METERED)),
        ("mixed", mixed(files(METERED_WAY, METERED))),
    ] {
        let (finished, rows, index) = run(&files);
        for (from_s, to_s, amps) in [
            (1.0, 10.0, -6.0),
            (11.0, 15.0, 0.0),
            (16.5, 25.0, 2.0),
            (26.0, 29.0, -3.0),
            (30.0, 33.0, -8.0),
        ] {
            let met = between(&rows, from_s, to_s);
            assert!(
                met.len() >= 3
                    && met
                        .iter()
                        .all(|row| (row.current_a - amps).abs() < 0.02 + 0.01 * f64::abs(amps)),
                "{name}: {met:?}"
            );
        }
        // The meters are as good as they are: a millivolt, and the time of a reading.
        let start_v = index.traces[0].start_ocv_v;
        let steps_s = &index.traces[0].steps_s;
        assert_eq!(steps_s.len(), 6, "{steps_s:?}");
        // The rest at the end belongs to the trace.
        let (last_s, rest) = (rows.last().unwrap().time_s, between(&rows, 34.0, 43.5));
        assert!(
            last_s > 43.2 && rest.len() >= 9 && rest.iter().all(|row| row.current_a == 0.0),
            "{name}: {last_s} s, {rest:?}"
        );
        for (row, answer) in rows.iter().zip(answer(&rows)).filter(|(row, _)| {
            steps_s
                .iter()
                .all(|step_s| !(0.0..0.5).contains(&(row.time_s - step_s)))
        }) {
            // The wire is known to 2 %.
            let tolerance_v = 2.0e-3 + 0.5e-3 * row.current_a.abs();
            assert!(
                (row.voltage_v - start_v - answer).abs() < tolerance_v,
                "{name}: {row:?}, {} V",
                start_v + answer
            );
        }
        for role in ["supply4q", "generator"] {
            let on = sent(&files.path("run"), role)
                .into_iter()
                .find(|message| message.contains("OUTP ON") || message.contains("OUTP1 ON"));
            assert_eq!(on, None, "{name}: {role}");
        }
        let witness = finished
            .simulation
            .as_ref()
            .unwrap()
            .world()
            .lock()
            .unwrap()
            .witness();
        assert!(
            witness.abuse_count == 0 && witness.greatest_discharge_a < 8.2,
            "{name}: {witness:?}"
        );
    }
}

#[test]
fn a_load_that_does_not_follow_is_seen_in_rows_of_a_second() {
    let rows = "current_a,duration_s\n-2,1\n-8,1\n-2,1\n-8,1\n0,5\n";
    let files = files(METERED_WAY, rows).append(SCENARIO, "[drives.load]\ngreatest_a = 3.0");
    let message = run_experiment(&files.load(), &files.path("run"))
        .map(|_| ())
        .unwrap_err()
        .to_string();
    let measured = message
        .split("load: expected 8.000 A, measured ")
        .nth(1)
        .and_then(|rest| rest.split(' ').next()?.parse::<f64>().ok());
    assert!(
        measured.is_some_and(|amps| (amps - 3.0).abs() < 0.01),
        "{message}"
    );
}

#[test]
#[ignore = "drill"]
fn what_is_off_and_carries_a_current_ends_a_trace() {
    let (load, charger) = (
        "interlock: current of the load ",
        "interlock: current of the charger ",
    );
    let draws = Action::Load(LoadState {
        input_on: true,
        current_a: 1.0,
        min_voltage_v: 0.0,
        power_w: None,
    });
    let feeds = Action::Supply(SupplyState {
        output_on: true,
        voltage_v: 4.2,
        current_a: 1.0,
    });
    for (rows, hand, trip) in [
        ("0,600\n-2,1\n", draws, load),
        ("0,600\n-2,1\n", feeds, charger),
        ("-2,600\n", feeds, charger),
    ] {
        let files = files(METERED_WAY, &format!("current_a,duration_s\n{rows}"));
        let ports = Ports::serve(&files, 10.0, 1);
        let run = files.path("run");
        let child = start(&files, &run, &[]);
        let traced = |text: &String| text.matches(",trace,").count() > 4;
        poll("rows of the trace", || {
            fs::read_to_string(run.join("readings.csv"))
                .ok()
                .filter(traced)
        });
        ports.world.lock().unwrap().act(0.0, hand);
        let (code, text) = end(child);
        assert!(code == Some(5) && text.contains(trip), "{rows}: {text}");
        assert_eq!(ports.world.lock().unwrap().truth_current_a(), 0.0, "{rows}");
    }
}

#[test]
fn a_power_is_the_loads_own_constant_power_and_the_energy_is_the_profiles() {
    for (name, files, function) in [
        (
            "demo",
            files(
                "through = \"load_and_supply\"",
                "time_s,power_w\n0,20\n20,45\n40,0\n50,0\n",
            ),
            ":FUNC POWer",
        ),
        (
            "mixed",
            mixed(files(
                "through = \"load_and_supply\"",
                "time_s,power_w\n0,20\n20,45\n40,0\n50,0\n",
            )),
            ":SOUR:FUNC POW",
        ),
    ] {
        let (_, rows, _) = run(&files);
        // In a profile the discharge direction is positive, in a series the charge direction.
        for (from_s, to_s, watts) in [(2.0, 20.0, -20.0), (22.0, 40.0, -45.0)] {
            let met = between(&rows, from_s, to_s);
            let powers: Vec<f64> = met
                .iter()
                .map(|row| row.current_a * row.voltage_v)
                .collect();
            // 16 mΩ of wire lie between the load's terminals and its sense leads.
            assert!(
                powers.len() > 10
                    && powers
                        .iter()
                        .all(|power| (power / watts - 1.0).abs() < 0.02),
                "{name}: {powers:?}"
            );
            assert!(
                met.first().unwrap().current_a > met.last().unwrap().current_a,
                "the current follows the voltage: {name}: {met:?}"
            );
        }
        assert!(
            sent(&files.path("run"), "load").contains(&function.to_owned()),
            "{name}"
        );
    }
}

#[test]
fn what_an_instrument_cannot_is_said_with_the_row_and_what_it_can() {
    for (through, rows, expected) in [
        (
            "load_and_supply",
            "current_a,duration_s\n-5,10\n-31,10\n",
            "traces.jump.file: row 2: expected -30 A to 0 A, which the load siglent-sdl1000x can \
            drive, found -31 A",
        ),
        (
            "load_and_supply",
            "power_w,duration_s\n-60,10\n-220,10\n",
            "traces.jump.file: row 2: expected -30 A to 0 A, which the load siglent-sdl1000x can \
            drive, found -220 W, -88.000 A at 2.5 V",
        ),
        (
            "load_and_supply",
            "current_a,duration_s\n5,10\n",
            "traces.jump.file: row 1: expected 0 A to 3.2 A, which the supply siglent-spd3303x can \
            drive, found 5 A",
        ),
        (
            "load_and_supply",
            "current_a,duration_s\n-5,0.2\n",
            "traces.jump.file: row 1: expected 1 s to 86400 s, which load and supply can play, \
            found 0.2 s; `step` averages rows, \
             `through = \"wave\"` plays them from 1 ms on",
        ),
        (
            "wave",
            "current_a,duration_s\n-5,0.002\n-6,0.003\n",
            "traces.jump.file: row 2: expected a multiple of the shortest row, 0.002 s, found \
            0.003 s; `step` averages",
        ),
        (
            "wave",
            "current_a,duration_s\n-5,0.002\n-6,60\n",
            "traces.jump.file: expected at most 16384 steps, which is what siglent-sdg1000x holds, \
            found 32768 of 2 ms; `step` of 3.9 ms or more averages",
        ),
        (
            "auto",
            "current_a,duration_s\n-35,0.5\n",
            "nothing on the bench can play it; bipolar: row 1: expected -20 A to 20 A",
        ),
        (
            "wave",
            "power_w,duration_s\n-80,0.002\n",
            "row 1: expected -20 A to 20 A, which the bipolar supply kepco-bop-mg can drive, found \
            -80 W, -32.000 A",
        ),
    ] {
        let message = refused(&files(&format!("through = \"{through}\""), rows));
        assert!(message.contains(expected), "{message}");
    }
    let message = refused(&files(
        "step = \"1 s\"",
        "time_s,resistance_ohm\n0,1\n1,1\n",
    ));
    assert!(
        message.contains(
            "nor is it a profile over time: expected powers or currents, found \
    resistances of a load"
        ),
        "{message}"
    );
    // Beyond the cell itself it is the plan that refuses.
    let plan = crate::support::program(&[
        "plan".as_ref(),
        files(
            "through = \"load_and_supply\"",
            "current_a,duration_s\n-29,600\n",
        )
        .experiment()
        .as_os_str(),
    ]);
    assert!(
        plan.message()
            .contains("expected charge within ±2.250 Ah of the start, found -4.833 Ah"),
        "{}",
        plan.stderr
    );
}

#[test]
fn the_first_way_that_can_is_taken() {
    for (rows, words) in [
        ("current_a,duration_s\n-5,2\n0,4\n", " frames, "),
        (
            "current_a,duration_s\n-5,0.01\n3,0.02\n",
            "by a wave of 512 steps of 10 ms in the generator's memory",
        ),
        (
            "current_a,duration_s\n-25,2\n0,4\n",
            "through load and supply",
        ),
    ] {
        let plan = crate::support::program(&[
            "plan".as_ref(),
            files("through = \"auto\"", rows).experiment().as_os_str(),
        ]);
        assert!(
            plan.expect_code(0).stdout.contains(words),
            "{}",
            plan.stdout
        );
    }
}

#[test]
fn a_file_without_a_header_is_not_played_and_a_plan_says_which_way_the_first_step_goes() {
    for (rows, line, found) in [
        ("0,5\n2,-3\n4,0\n", 1, "0,5"),
        ("# a pack's power\n\n0 5\n2 -3\n4 0\n", 3, "0 5"),
        ("\u{feff}-6,10\n0,5\n", 1, "-6,10"),
    ] {
        let message = refused(&files("", rows));
        let expected = format!(
            "jump.csv:{line}: current_a,duration_s: expected a header that says what the columns \
            are and which way it flows: current_a,duration_s or \
             power_w,duration_s with charge positive, time_s,current_a or time_s,power_w with \
             discharge positive, found {found:?}"
        );
        assert!(message.ends_with(&expected), "{message}");
    }
    for (header, words) in [
        ("time_s,current_a", "first 5 A out of the cell, "),
        ("time_s,charge_current_a", "first 5 A into the cell, "),
        ("time_s,power_w", "first 5 W out of the cell, "),
        ("Test Time / s,Current / A", "first 5 A into the cell, "),
        (
            "test_time_second,current_ampere",
            "first 5 A into the cell, ",
        ),
    ] {
        let files = files("", &format!("{header}\n0,0\n2,5\n4,-3\n6,0\n"));
        let plan = crate::support::program(&["plan".as_ref(), files.experiment().as_os_str()]);
        assert!(
            plan.expect_code(0).stdout.contains(words),
            "{header}: {}",
            plan.stdout
        );
    }
}

#[test]
fn rows_that_are_too_fast_are_averaged_and_what_is_lost_is_said_in_plan_and_report() {
    // 40 W for half of every fifth of a second.
    let rows: String = (0..100)
        .map(|k| format!("{},0.1\n", if k % 2 == 0 { -40 } else { 0 }))
        .collect();
    let files = files(
        "through = \"load_and_supply\"\nstep = \"1 s\"",
        &format!("power_w,duration_s\n{rows}"),
    );
    let wording = "100 powers averaged over steps of 1 s: the energy of each step is kept, 20.000 W \
    rms (70.7 % of the rows' rms) and at most 20.000 W are left out";
    let plan = crate::support::program(&["plan".as_ref(), files.experiment().as_os_str()]);
    assert!(
        plan.expect_code(0).stdout.contains(wording),
        "{}",
        plan.stdout
    );
    let (finished, rows, _) = run(&files);
    let energy_j: f64 = rows
        .windows(2)
        .map(|p| {
            0.5 * (p[0].current_a * p[0].voltage_v + p[1].current_a * p[1].voltage_v)
                * (p[1].time_s - p[0].time_s)
        })
        .sum();
    assert!((energy_j / -200.0 - 1.0).abs() < 0.03, "{energy_j} J");
    assert!(
        finished.summary.contains(wording)
            && files
                .text("run/report.html")
                .contains("100 powers averaged over steps of 1 s"),
        "{}",
        finished.summary
    );
}

/// Returns the current of a robot's jump, A, discharge positive: a crouch, the push, the flight,
/// and the energy returned by the landing, every 2 ms.
fn jump_a(time_s: f64) -> f64 {
    let bump = |from_s: f64, length_s: f64, amps: f64| {
        let share = (time_s - from_s) / length_s;
        if (0.0..1.0).contains(&share) {
            amps * (std::f64::consts::PI * share).sin()
        } else {
            0.0
        }
    };
    bump(0.0, 0.4, 4.0) + bump(0.4, 0.25, 16.0) + bump(1.0, 0.15, -7.0)
}

fn jump(column: &str, factor: f64) -> String {
    let rows = (0..=600).map(|k| 0.002 * f64::from(k));
    rows.fold(format!("time_s,{column}\n"), |text, time_s| {
        text + &format!("{time_s:.3},{:.4}\n", factor * jump_a(time_s + 0.001))
    })
}

#[test]
#[ignore = "drill"]
fn a_wave_plays_two_milliseconds_and_the_record_is_the_profile_and_the_truth() {
    for (name, files) in [
        (
            "demo",
            corrected("through = \"wave\"", &jump("current_a", 1.0)),
        ),
        (
            "mixed",
            mixed(corrected("through = \"wave\"", &jump("current_a", 1.0))),
        ),
    ] {
        let (finished, rows, index) = run(&files);
        // The supply's gain is 2 % low, and its zero error flows all the time.
        let steps: Vec<&TraceRow> = between(&rows, 0.5, 1.7);
        assert!(steps.len() > 420, "{name}: {} rows", steps.len());
        let zero_a = rows[0].current_a;
        let worst_a = steps
            .iter()
            .map(|row| (row.current_a - zero_a + 0.98 * jump_a(row.time_s - 0.5)).abs())
            .fold(0.0, f64::max);
        // A step of the SDG may be off by 0.4 % of 16 A, and its edge by a sample.
        assert!(worst_a < 0.2, "{name}: off by {worst_a} A");
        let trace = &index.traces[0];
        // The noise of the record, the noise of the current times the cell's resistance, and 0.1
        // mV for the remaining error of the correction at 16 A; the zero error that flowed before
        // the first row is already in the start.
        let mut squares = 0.0;
        for (row, answer) in rows.iter().zip(answer(&rows)) {
            let noise_v = (trace.sample_sigma_v.powi(2) + (0.01 * trace.sample_sigma_a).powi(2))
                .sqrt()
                / row.samples.sqrt();
            let off_v = row.voltage_v - trace.start_ocv_v - answer;
            assert!(
                off_v.abs() < 5.0 * noise_v + 1.0e-4 + 0.01 * zero_a.abs(),
                "{name}: off by {off_v} V: {row:?}"
            );
            squares += off_v * off_v;
        }
        let rms_v = (squares / rows.len() as f64).sqrt();
        assert!(rms_v < 1.0e-3, "{name}: off by {rms_v} V rms");
        // Every change of the current is a step.
        assert!(trace.steps_s.len() > 390, "{}", trace.steps_s.len());
        let (first_s, last_s) = (trace.steps_s[0], *trace.steps_s.last().unwrap());
        assert!(
            (first_s - 0.5).abs() < 0.005 && (last_s - 1.65).abs() < 0.01,
            "{first_s} s, {last_s} s"
        );
        // It was read all the while, and taken away before it came again.
        let world = finished
            .simulation
            .as_ref()
            .unwrap()
            .world()
            .lock()
            .unwrap()
            .clone();
        let witness = world.witness();
        assert!(
            witness.abuse_count == 0
                && witness.greatest_discharge_a < 16.5
                && world.truth_current_a() == 0.0,
            "{name}: {witness:?}"
        );
        // A simulation can read the profile from it.
        let options = ReadOptions {
            demand: None,
            interpolation: Interpolation::Linear,
            charge_positive: false,
        };
        let profile = read_profile(&files.path("run/series_jump_1.bdf.csv"), &options).unwrap();
        assert!(
            profile.demand == Demand::Current
                && profile.value.iter().copied().fold(0.0, f64::max) > 15.0,
            "discharge positive"
        );
    }
}

#[test]
#[ignore = "drill"]
fn a_wave_of_long_pulses_has_its_charge_every_step_and_the_rest_behind_it() {
    let files = corrected(
        "through = \"wave\"",
        "current_a,duration_s\n-5,0.02\n0,0.98\n-8,4\n0,2\n6,2\n0,3\n",
    );
    let (_, rows, index) = run(&files);
    let trace = &index.traces[0];
    let zero_a = rows[0].current_a;
    let charge_coulomb = |from_s: f64, to_s: f64| -> f64 {
        let pairs = rows
            .windows(2)
            .filter(|pair| (from_s..to_s).contains(&pair[0].time_s));
        pairs
            .map(|p| {
                (0.5 * (p[0].current_a + p[1].current_a) - zero_a) * (p[1].time_s - p[0].time_s)
            })
            .sum()
    };
    // The supply's gain is 2 % low.
    for (from_s, to_s, expected_coulomb) in [(1.0, 6.0, -32.0), (7.0, 10.5, 12.0)] {
        let met_coulomb = charge_coulomb(from_s, to_s);
        assert!(
            (met_coulomb / (0.98 * expected_coulomb) - 1.0).abs() < 5.0e-3,
            "{met_coulomb} C, expected {expected_coulomb} C"
        );
    }
    let expected_s = [0.5, 0.52, 1.5, 5.5, 7.5, 9.5];
    assert_eq!(trace.steps_s.len(), expected_s.len(), "{:?}", trace.steps_s);
    assert!(
        trace
            .steps_s
            .iter()
            .zip(expected_s)
            .all(|(met_s, step_s)| (met_s - step_s).abs() < 0.01),
        "{:?}",
        trace.steps_s
    );
    // Three seconds of rest, and nearly one second of recording.
    assert!(rows.last().unwrap().time_s > 12.5, "{:?}", rows.last());
}

#[test]
fn powers_of_a_wave_take_the_voltage_at_rest_and_the_report_says_what_flowed() {
    let files = files("through = \"wave\"\nscale = 0.5", &jump("power_w", 3.8));
    let (finished, rows, index) = run(&files);
    let ocv_v = index.traces[0].start_ocv_v;
    let zero_a = rows[0].current_a;
    let worst_a = between(&rows, 0.5, 1.7)
        .iter()
        .map(|row| {
            (row.current_a - zero_a + 0.98 * 0.5 * 3.8 / ocv_v * jump_a(row.time_s - 0.5)).abs()
        })
        .fold(0.0, f64::max);
    assert!(worst_a < 0.12, "off by {worst_a} A");
    assert!(
        finished
            .summary
            .contains("powers were converted to currents at the 3.79"),
        "{}",
        finished.summary
    );
}

#[test]
fn the_interlock_ends_a_wave_that_leaves_the_window() {
    // The cell resists more than the file claims, and the push comes again and again: a reading
    // sees it, or the record.
    let rows: String = (0..8).map(|_| "-19,1.0\n-18,0.1\n").collect();
    let files = files(
        "through = \"wave\"",
        &format!("current_a,duration_s\n{rows}"),
    )
    .edit(EXPERIMENT, "\"30 mΩ\"", "\"0.5 mΩ\"")
    .edit(CELL, "voltage_min = \"2.5 V\"", "voltage_min = \"3.70 V\"");
    let failure = run_experiment(&files.load(), &files.path("run"))
        .map(|_| ())
        .unwrap_err();
    let message = failure.to_string();
    assert_eq!(failure.exit_code(), 5, "{message}");
    assert!(
        message.starts_with("interlock: cell voltage 3.")
            && message.contains("left its limits (3.7 V to 4.2 V)"),
        "{message}"
    );
    let events = files.text("run/events.csv");
    let at = |text: &str| {
        events
            .lines()
            .rfind(|line| line.contains(text))
            .and_then(|line| line.split(',').next()?.parse::<f64>().ok())
            .unwrap()
    };
    let readings = files.text("run/readings.csv");
    let last_s: f64 = readings
        .lines()
        .last()
        .and_then(|line| line.split(',').next()?.parse().ok())
        .unwrap();
    // Within the profile, not by its record.
    assert!(last_s - at("trace jump") < 20.0, "{last_s}");
    assert!(!files.path("run/traces.json").exists());
}
