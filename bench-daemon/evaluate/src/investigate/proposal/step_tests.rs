//! Logs of pulses that are cut by the steps of the cycler, or by the current alone.

use analysis::series::TimeSeries;

use super::*;

/// A step of the cycler's program.
#[derive(Clone, Copy)]
struct Step {
    lasting_s: f64,
    current_a: f64,
    every_s: f64,
}

const fn step(lasting_s: f64, current_a: f64, every_s: f64) -> Step {
    Step {
        lasting_s,
        current_a,
        every_s,
    }
}

const SEARCH: LogSearch = LogSearch {
    rest_s: 10.0,
    slowest_s: 1.0,
};

/// A log of a cell of 4 mΩ at 3.6 V and the numbers of its steps.
fn log(steps: &[Step]) -> (TimeSeries, Vec<f64>) {
    let (mut time_s, mut current_a, mut numbers, mut begun_s) = (vec![], vec![], vec![], 0.0);
    for (number, step) in steps.iter().enumerate() {
        let rows = (step.lasting_s / step.every_s).round() as usize;
        for k in 1..=rows {
            time_s.push(begun_s + k as f64 * step.every_s);
            current_a.push(step.current_a);
            numbers.push((number + 1) as f64);
        }
        begun_s += step.lasting_s;
    }
    let voltage_v = current_a.iter().map(|a| 3.6 - 4e-3 * a).collect();
    let series = TimeSeries {
        name: "log".to_owned(),
        temperature_degc: Some(vec![20.0; time_s.len()]),
        time_s,
        voltage_v,
        current_a,
    };
    (series, numbers)
}

/// Kind, current and duration of each load, and whether it is used.
fn found(series: &TimeSeries, steps: Option<&[f64]>) -> Vec<(Kind, f64, f64, bool)> {
    let all = loads(series, steps, &SEARCH);
    let of = |load: &Load| {
        let used = load.refusal.is_none();
        (load.kind, load.current_a, load.duration_s.round(), used)
    };
    all.iter().map(of).collect()
}

/// An HPPC at two states: a pulse, 40 s of rest, a charge, and at once the slow discharge to the next
/// state, which is logged once a minute.
const HPPC: [Step; 8] = [
    step(60.0, 0.0, 1.0),
    step(12.0, 25.0, 1.0),
    step(40.0, 0.0, 1.0),
    step(12.0, -18.0, 1.0),
    step(360.0, 8.0, 60.0),
    step(120.0, 0.0, 1.0),
    step(12.0, 25.0, 1.0),
    step(40.0, 0.0, 1.0),
];

#[test]
fn each_pulse_of_an_hppc_is_a_load_of_its_own_with_steps_and_without() {
    let (series, steps) = log(&HPPC);
    for steps in [Some(steps.as_slice()), None] {
        let expected = [
            (Kind::Pulse, 25.0, 12.0, true),
            (Kind::Pulse, -18.0, 12.0, true),
            (Kind::Discharge, 8.0, 301.0, false),
            (Kind::Pulse, 25.0, 12.0, true),
        ];
        assert_eq!(found(&series, steps), expected, "{}", steps.is_some());
    }
}

#[test]
fn a_pulse_that_ends_in_another_current_ends_with_its_last_row() {
    let (series, steps) = log(&HPPC);
    let all = loads(&series, Some(&steps), &SEARCH);
    assert_eq!((all[1].start_s, all[1].to_s), (113.0, 124.0));
    assert_eq!(all[1].rest_after_s, 0.0);
    assert_eq!(all[2].refusal.as_deref(), Some("no rest before it"));
}

#[test]
fn steps_separate_currents_and_short_pauses_that_the_current_alone_does_not() {
    // Two currents of 20 s that follow each other, and two pulses with a pause of 4 s.
    let (series, steps) = log(&[
        step(60.0, 0.0, 1.0),
        step(20.0, 2.0, 1.0),
        step(20.0, 4.0, 1.0),
        step(150.0, 0.0, 1.0),
        step(10.0, 3.0, 1.0),
        step(4.0, 0.0, 1.0),
        step(10.0, 3.0, 1.0),
        step(60.0, 0.0, 1.0),
    ]);
    let kinds = |steps: Option<&[f64]>| -> Vec<f64> {
        found(&series, steps).iter().map(|load| load.2).collect()
    };
    assert_eq!(kinds(Some(&steps)), [20.0, 20.0, 10.0, 10.0]);
    assert_eq!(kinds(None), [40.0, 24.0]);
    // A column that counts one step only changes nothing.
    assert_eq!(kinds(Some(&vec![1.0; steps.len()])), [40.0, 24.0]);
}

#[test]
fn a_drive_cycle_that_is_written_in_steps_stays_one() {
    let mut program = vec![step(60.0, 0.0, 1.0)];
    program.extend((0..12).map(|k| step(15.0, 1.0 + f64::from(k % 4), 1.0)));
    program.push(step(60.0, 0.0, 1.0));
    let (series, steps) = log(&program);
    let [(kind, _, lasting_s, used)] = found(&series, Some(&steps))[..] else {
        panic!("{:?}", found(&series, Some(&steps)))
    };
    assert_eq!((kind, lasting_s, used), (Kind::DriveCycle, 180.0, true));
    // So does one whose column counts the rows.
    let rows: Vec<f64> = (0..steps.len()).map(|k| k as f64).collect();
    assert_eq!(found(&series, Some(&rows)).len(), 1);
}

#[test]
fn the_last_current_of_a_step_in_the_first_row_of_the_next_belongs_to_it() {
    let (series, mut steps) = log(&[
        step(60.0, 0.0, 1.0),
        step(10.0, 2.0, 1.0),
        step(60.0, 0.0, 1.0),
    ]);
    steps[69] = 3.0;
    assert_eq!(
        found(&series, Some(&steps)),
        [(Kind::Pulse, 2.0, 10.0, true)]
    );
}

#[test]
fn the_resistance_of_a_pulse_is_that_after_a_second() {
    let (mut series, steps) = log(&[
        step(60.0, 0.0, 1.0),
        step(10.0, 5.0, 1.0),
        step(60.0, 0.0, 1.0),
    ]);
    // It grows by 0.1 mΩ a second.
    for k in 60..70 {
        series.voltage_v[k] = 3.6 - 5.0 * (4e-3 + 1e-4 * (k - 59) as f64);
    }
    let ohm = |series: &TimeSeries| loads(series, Some(&steps), &SEARCH)[0].resistance_1s_ohm;
    assert!((ohm(&series).unwrap() - 4.1e-3).abs() < 1e-9);
    // A log without a row near it has none.
    series.time_s.iter_mut().for_each(|t| *t *= 3.0);
    assert_eq!(ohm(&series), None);
}

#[test]
fn a_column_of_the_state_gives_it_unless_it_is_counted() {
    let (series, steps) = log(&HPPC);
    let column: Vec<f64> = series.time_s.iter().map(|t| 0.8 - 2e-4 * t).collect();
    let mut all = loads(&series, Some(&steps), &SEARCH);
    let known = ChargeKnown {
        column: Some(&column),
        ..ChargeKnown::default()
    };
    count_charge(&series, &mut all, known);
    // The last row of the rest before the first pulse is at 60 s.
    let soc = all[0].soc.unwrap();
    assert!((soc.value - 0.788).abs() < 1e-9 && soc.from == SocFrom::Column);
    let stated = ChargeKnown {
        capacity_ah: Some(30.0),
        soc_start: Some(0.9),
        ..known
    };
    count_charge(&series, &mut all, stated);
    let soc = all[0].soc.unwrap();
    assert!((soc.value - 0.9).abs() < 1e-3 && soc.from == SocFrom::Counted);
}

#[test]
fn what_contradicts_itself_is_named() {
    let (series, steps) = log(&HPPC);
    let all = loads(&series, Some(&steps), &SEARCH);
    let falls: Vec<f64> = series.time_s.iter().map(|t| 0.8 - 3e-4 * t).collect();
    let rises: Vec<f64> = series.time_s.iter().map(|t| 0.2 + 3e-4 * t).collect();
    assert!(fits_current(&series, &falls).is_ok());
    let message = fits_current(&series, &rises).unwrap_err();
    assert!(message.contains("rises by"), "{message}");
    let message = fits_current(&series, &vec![0.0; rises.len()]).unwrap_err();
    assert!(message.contains("stands still"), "{message}");
    let facts = LogFacts {
        capacity_ah: Some(3.0),
        head_capacity_ah: Some(2.5),
        soc_start: Some(0.5),
        temperature_degc: Some(25.0),
        head_temperature_degc: Some(10.0),
        column: Some(&falls),
        curve: None,
    };
    let found = contradictions(&series, &all, &facts);
    let parts = [
        "2.5 Ah",
        "stated temperature 25",
        "head of the file has 10 °C",
        "50.0 % SOC",
        "goes by",
    ];
    assert_eq!(found.len(), parts.len(), "{found:?}");
    for (met, part) in found.iter().zip(parts) {
        assert!(met.contains(part), "{met}");
    }
    assert_eq!(contradictions(&series, &all, &LogFacts::default()), [""; 0]);
}

/// A discharge of 1 A that never rests, with a pulse of 3 A every 1000 s.
fn on_base(count: usize) -> (TimeSeries, Vec<f64>) {
    let mut program = vec![step(1000.0, 1.0, 1.0)];
    for _ in 0..count {
        program.extend([step(10.0, 3.0, 1.0), step(1000.0, 1.0, 1.0)]);
    }
    log(&program)
}

#[test]
fn pulses_on_a_current_that_never_rests_are_runs_where_the_state_is_known() {
    let (series, steps) = on_base(3);
    for steps in [Some(steps.as_slice()), None] {
        let mut all = loads(&series, steps, &SEARCH);
        count_charge(&series, &mut all, ChargeKnown::default());
        assert_eq!(all.len(), 3);
        let reason = all[0].refusal.as_deref().unwrap();
        assert!(
            reason.starts_with("it stands on 1.000 A without a rest"),
            "{reason}"
        );
        let mut all = loads(&series, steps, &SEARCH);
        let known = ChargeKnown {
            capacity_ah: Some(4.0),
            soc_start: Some(1.0),
            ..ChargeKnown::default()
        };
        count_charge(&series, &mut all, known);
        let pulse = &all[1];
        assert_eq!((pulse.refusal.as_deref(), pulse.kind), (None, Kind::Pulse));
        assert_eq!((pulse.start_s, pulse.duration_s), (2011.0, 10.0));
        assert_eq!((pulse.from_s, pulse.to_s), (1411.0, 2141.0));
        let base = pulse.base.unwrap();
        assert_eq!((base.current_a, base.compare_from_s), (1.0, 1981.0));
        assert!((pulse.resistance_1s_ohm.unwrap() - 4e-3).abs() < 1e-9);
        // 1 A for 1410 s, and 2 A more for 10 s of the pulse before.
        let drawn = (1410.0 + 20.0) / 3600.0 / 4.0;
        assert!((pulse.soc.unwrap().value - (1.0 - drawn)).abs() < 2e-4);
    }
}

#[test]
fn of_one_current_at_several_states_every_other_state_is_held_out() {
    let (series, _) = on_base(5);
    let mut all = loads(&series, None, &SEARCH);
    let known = ChargeKnown {
        capacity_ah: Some(2.0),
        soc_start: Some(1.0),
        ..ChargeKnown::default()
    };
    count_charge(&series, &mut all, known);
    let runs = propose(&[found_log(all)]);
    let held_out: Vec<bool> = runs
        .iter()
        .map(|run| run.role == analysis::diagnosis::Role::HeldOut)
        .collect();
    assert_eq!(held_out, [false, true, false, true, false]);
}

#[test]
fn a_model_to_start_from_is_read_off_the_largest_current_that_trains() {
    let (mut series, steps) = log(&[
        step(60.0, 0.0, 1.0),
        step(10.0, 2.0, 1.0),
        step(60.0, 0.0, 1.0),
        step(20.0, 5.0, 0.5),
        step(60.0, 0.0, 1.0),
    ]);
    // 6 mΩ at once, and 3 mΩ with 4 s from the last row at rest on, at 130 s.
    for k in 0..series.len() {
        let since_s = series.time_s[k] - 130.0;
        if series.current_a[k] == 5.0 {
            let ohm = 6e-3 + 3e-3 * (1.0 - (-since_s / 4.0_f64).exp());
            series.voltage_v[k] = 3.6 - 5.0 * ohm;
        }
    }
    let logs = [found_log(loads(&series, Some(&steps), &SEARCH))];
    let runs = propose(&logs);
    let model = start_model(&[&series], &logs, &runs, None).unwrap();
    let branch = model.branch.unwrap();
    assert_eq!(model.run, "pulse_2_5.00A");
    assert!((model.r_ohm / 6e-3 - 1.0).abs() < 0.02, "{model:?}");
    assert!((branch.r_ohm / 3e-3 - 1.0).abs() < 0.05 && (branch.tau_s / 4.0 - 1.0).abs() < 0.1);
    assert!(
        model.json().starts_with("{\"branches\":[{\"c_f\":"),
        "{}",
        model.json()
    );
    assert_eq!(start_model(&[], &[], &[], None), None);
    // The open-circuit voltage falls by 0.4 V over 1 Ah meanwhile: the curve takes it out again.
    let curve = analysis::ocv::OcvCurve::monotone(1.0, vec![0.0, 1.0], vec![3.2, 3.6]).unwrap();
    for k in 0..series.len() {
        if series.current_a[k] == 5.0 {
            series.voltage_v[k] -= 0.4 * 5.0 * (series.time_s[k] - 130.0) / 3600.0;
        }
    }
    let mut logs = logs;
    logs[0].loads[1].soc = Some(KnownSoc {
        value: 0.5,
        from: SocFrom::Counted,
    });
    let with = start_model(&[&series], &logs, &runs, Some(&curve)).unwrap();
    assert!((with.r_ohm / model.r_ohm - 1.0).abs() < 1e-6, "{with:?}");
    assert!((with.branch.unwrap().r_ohm / branch.r_ohm - 1.0).abs() < 1e-6);
    let without = start_model(&[&series], &logs, &runs, None).unwrap();
    assert!(
        without.branch.unwrap().r_ohm > 1.2 * branch.r_ohm,
        "{without:?}"
    );
}

fn found_log(loads: Vec<Load>) -> FoundLog {
    FoundLog {
        file: "log.csv".to_owned(),
        name: "log".to_owned(),
        lasting_s: 0.0,
        temperature: None,
        notes: Vec::new(),
        loads,
    }
}

#[test]
fn a_curve_goes_through_the_rest_voltages_of_known_states() {
    let (mut series, steps) = log(&[
        step(60.0, 0.0, 1.0),
        step(10.0, 2.0, 1.0),
        step(60.0, 0.0, 1.0),
        step(600.0, 3.0, 1.0),
        step(300.0, 0.0, 1.0),
        step(10.0, 2.0, 1.0),
        step(60.0, 0.0, 1.0),
    ]);
    for k in 0..series.len() {
        series.voltage_v[k] -= if series.time_s[k] > 730.0 { 0.2 } else { 0.0 };
    }
    let known = ChargeKnown {
        capacity_ah: Some(2.0),
        soc_start: Some(0.9),
        ..ChargeKnown::default()
    };
    let mut all = loads(&series, Some(&steps), &SEARCH);
    let unknown = [found_log(all.clone())];
    count_charge(&series, &mut all, known);
    let curve = rest_curve(&[found_log(all)], Some(2.0)).unwrap();
    // 3 A for 600 s out of 2 Ah is a quarter.
    assert_eq!(curve.soc.len(), 2);
    assert!(
        (curve.soc[1] - curve.soc[0] - 0.25).abs() < 0.01,
        "{:?}",
        curve.soc
    );
    assert!((curve.ocv_v[0] - 3.4).abs() < 1e-9 && (curve.ocv_v[1] - 3.6).abs() < 1e-9);
    assert_eq!(rest_curve(&unknown, Some(2.0)), None);
}
