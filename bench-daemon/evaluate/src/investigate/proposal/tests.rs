//! Proposals from constructed logs, whose pulses are known.

use analysis::{
    diagnosis::Role,
    formats::{CurrentSign, SeriesOptions, bdf_text, read_series},
    ocv::OcvCurve,
    series::TimeSeries,
};

use super::*;

/// A segment of a constructed log.
#[derive(Clone, Copy)]
struct Part {
    lasting_s: f64,
    current_a: f64,
}

const fn part(lasting_s: f64, current_a: f64) -> Part {
    Part {
        lasting_s,
        current_a,
    }
}

const SEARCH: LogSearch = LogSearch {
    rest_s: 10.0,
    slowest_s: 1.0,
};

/// A log of a cell of 20 mΩ at 3.7 V, discharge positive.
fn log(parts: &[Part], step_s: f64) -> TimeSeries {
    let mut current_a = Vec::new();
    for part in parts {
        let rows = (part.lasting_s / step_s).round() as usize;
        current_a.extend(std::iter::repeat_n(part.current_a, rows));
    }
    let time_s = (0..current_a.len()).map(|k| k as f64 * step_s).collect();
    TimeSeries {
        name: "log".to_owned(),
        time_s,
        voltage_v: current_a.iter().map(|a| 3.7 - 0.02 * a).collect(),
        temperature_degc: Some(vec![25.0; current_a.len()]),
        current_a,
    }
}

fn found(series: &TimeSeries) -> Vec<Load> {
    loads(series, None, &SEARCH)
}

fn refusal(load: &Load) -> &str {
    load.refusal.as_deref().unwrap_or("")
}

fn proposed(loads: Vec<Load>) -> Vec<ProposedRun> {
    propose(&[FoundLog {
        file: "log.csv".to_owned(),
        name: "log".to_owned(),
        lasting_s: 0.0,
        temperature: None,
        notes: Vec::new(),
        loads,
    }])
}

/// Pulses of 10 s with a minute of rest around each.
fn pulses(currents_a: &[f64]) -> Vec<Load> {
    let mut parts = vec![part(60.0, 0.0)];
    for current_a in currents_a {
        parts.extend([part(10.0, *current_a), part(60.0, 0.0)]);
    }
    found(&log(&parts, 0.1))
}

#[test]
fn a_pulse_is_found_with_its_rests() {
    let all = pulses(&[2.0]);
    let [pulse] = all.as_slice() else {
        panic!("{all:?}")
    };
    assert_eq!((pulse.kind, refusal(pulse)), (Kind::Pulse, ""));
    let met = [
        pulse.current_a,
        pulse.start_s,
        pulse.duration_s,
        pulse.from_s,
        pulse.to_s,
        pulse.rest_after_s,
    ];
    for (met, expected) in met.iter().zip([2.0, 60.0, 10.0, 0.0, 129.9, 59.9]) {
        assert!((met - expected).abs() < 1e-9, "{met} {expected}");
    }
    let rest = pulse.rest.unwrap();
    assert!((rest.duration_s - 60.0).abs() < 1e-9 && rest.voltage_v == 3.7);
    assert!(rest.slope_v_per_s.abs() < 1e-9 && pulse.temperature_degc == Some(25.0));
}

#[test]
fn the_direction_of_the_file_decides_which_pulse_charges() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.bdf.csv");
    let of_log = log(&[part(60.0, 0.0), part(10.0, 2.0), part(60.0, 0.0)], 1.0);
    // Charge is positive in BDF: the file holds −2 A.
    std::fs::write(&path, bdf_text(&of_log)).unwrap();
    for (sign, current_a, name) in [
        (None, 2.0, "pulse_1_2.00A"),
        (Some(CurrentSign::Charge), 2.0, "pulse_1_2.00A"),
        (Some(CurrentSign::Discharge), -2.0, "pulse_1_2.00A_charge"),
    ] {
        let series = read_series(&path, &SeriesOptions { sign }).unwrap();
        let loads = found(&series);
        assert_eq!(loads[0].current_a, current_a);
        assert_eq!(proposed(loads)[0].name, name);
    }
}

#[test]
fn a_log_of_one_row_a_second_is_taken_and_a_slower_one_is_not() {
    let parts = [part(60.0, 0.0), part(10.0, 2.0), part(60.0, 0.0)];
    let second = found(&log(&parts, 1.0));
    assert_eq!((refusal(&second[0]), second[0].duration_s), ("", 10.0));
    let slow = found(&log(&parts, 2.0));
    let expected = "rows are 2.00 s apart, more than 1.10 s: logged too slowly, or rows lack";
    assert_eq!(refusal(&slow[0]), expected);
}

#[test]
fn a_log_without_rests_gives_no_run() {
    let all = found(&log(
        &[part(30.0, 1.0), part(10.0, 3.0), part(30.0, 1.0)],
        1.0,
    ));
    assert_eq!(all.len(), 1);
    assert_eq!(refusal(&all[0]), "no rest before it");
    assert!(proposed(all).is_empty());
    // A rest that is too short, and a pulse at the end of the log.
    let all = found(&log(
        &[part(6.0, 0.0), part(10.0, 3.0), part(30.0, 0.0)],
        1.0,
    ));
    let expected = "the rest before it is logged for 6.0 s, less than 10.0 s";
    assert_eq!(refusal(&all[0]), expected);
    let all = found(&log(&[part(60.0, 0.0), part(10.0, 3.0)], 1.0));
    assert_eq!(refusal(&all[0]), "no rest after it");
}

#[test]
fn rows_without_a_number_refuse_their_pulse_only() {
    let parts = [
        part(60.0, 0.0),
        part(10.0, 2.0),
        part(60.0, 0.0),
        part(10.0, 3.0),
        part(60.0, 0.0),
    ];
    let mut series = log(&parts, 1.0);
    series.voltage_v[65] = f64::NAN;
    series.current_a[66] = f64::NAN;
    let all = found(&series);
    let expected = "the row at 65.000 s has no current or no voltage";
    assert_eq!((refusal(&all[0]), refusal(&all[1])), (expected, ""));
    // The reader leaves such rows out, so that the log has a gap.
    for column in [
        &mut series.time_s,
        &mut series.voltage_v,
        &mut series.current_a,
    ] {
        column.drain(65..67);
    }
    series.temperature_degc = None;
    let all = found(&series);
    assert!(refusal(&all[0]).starts_with("rows are 3.00 s apart") && all[1].refusal.is_none());
}

#[test]
fn stamps_that_repeat_refuse_their_pulse() {
    let mut series = log(&[part(60.0, 0.0), part(10.0, 2.0), part(60.0, 0.0)], 1.0);
    series.time_s[64] = series.time_s[63];
    let expected = "the stamp 63.000 s repeats or goes back";
    assert_eq!(refusal(&found(&series)[0]), expected);
}

#[test]
fn a_cell_that_still_relaxes_and_a_voltage_limit_are_reported() {
    let mut series = log(&[part(60.0, 0.0), part(10.0, 2.0), part(60.0, 0.0)], 1.0);
    for k in 0..60 {
        series.voltage_v[k] = 3.7 - 1e-4 * k as f64;
    }
    let expected = "the voltage before it still moves by -6.00 mV per minute";
    assert_eq!(refusal(&found(&series)[0]), expected);
    // A charge of constant current, then at 4.2 V.
    let mut series = log(&[part(60.0, 0.0), part(200.0, -2.0), part(60.0, 0.0)], 1.0);
    for k in 160..260 {
        series.current_a[k] = -2.0 * (-0.02 * (k - 160) as f64).exp();
    }
    for k in 60..260 {
        series.voltage_v[k] = (3.8 + 4e-3 * (k - 60) as f64).min(4.2);
    }
    let expected = "a voltage limit was hit: its current falls at one voltage";
    assert_eq!(refusal(&found(&series)[0]), expected);
}

#[test]
fn a_short_load_that_varies_is_not_a_pulse_and_a_long_one_is_a_drive_cycle() {
    let varying = |seconds: usize| {
        let mut parts = vec![part(60.0, 0.0)];
        // With a stop of 20 s in the middle.
        parts.extend((0..seconds).map(|k| part(1.0, 1.0 + (k % 5) as f64)));
        parts.push(part(20.0, 0.0));
        parts.extend((0..seconds).map(|k| part(1.0, -1.0 - (k % 3) as f64)));
        parts.push(part(60.0, 0.0));
        found(&log(&parts, 1.0))
    };
    let short = varying(15);
    assert_eq!(refusal(&short[0]), "its current is not constant");
    let long = varying(50);
    assert_eq!(
        (long.len(), long[0].kind, refusal(&long[0])),
        (1, Kind::DriveCycle, "")
    );
}

#[test]
fn a_rest_is_shared_with_a_pulse_that_is_used_only() {
    let parts = [
        part(60.0, 0.0),
        part(10.0, 2.0),
        part(40.0, 0.0),
        part(10.0, -1.5),
        part(60.0, 0.0),
    ];
    let mut series = log(&parts, 1.0);
    let used = found(&series);
    assert_eq!(
        (refusal(&used[1]), used[0].to_s, used[1].from_s),
        ("", 89.5, 90.0)
    );
    for k in 70..110 {
        series.voltage_v[k] = 3.69 + 2.5e-4 * (k - 70) as f64;
    }
    let left_out = found(&series);
    assert!(refusal(&left_out[1]).contains("still moves"));
    assert_eq!((left_out[0].to_s, left_out[0].rest_after_s), (109.0, 39.0));
}

#[test]
fn equal_pulses_are_one_group_and_have_one_role() {
    let runs = proposed(pulses(&[1.0, 2.0, 4.0, 2.0, 8.0, -2.0]));
    let groups: Vec<&str> = runs.iter().map(|run| run.repeat_group.as_str()).collect();
    let expected = [
        "pulse_1_1.00A",
        "pulse_2_2.00A",
        "pulse_3_4.00A",
        "pulse_2_2.00A",
        "pulse_5_8.00A",
        "pulse_6_2.00A_charge",
    ];
    assert_eq!(groups, expected);
    assert_eq!(runs[1].role, runs[3].role);
    assert!(
        runs.windows(2)
            .all(|pair| pair[0].start_s < pair[1].start_s)
    );
}

#[test]
fn the_largest_and_a_middle_current_are_held_out_where_two_are_left() {
    for (currents_a, held_out) in [
        (&[0.5, 1.0, 2.0, 4.0, 6.0][..], &[2.0, 6.0][..]),
        (&[0.5, 1.0, 2.0, 4.0], &[1.0, 4.0]),
        (&[0.5, 1.0, 2.0], &[2.0]),
        (&[0.5, 1.0], &[]),
        (&[0.5], &[]),
        // Each direction has its own currents.
        (&[-0.75, 1.0, -1.5, 2.0, -3.0], &[-3.0]),
    ] {
        let loads = pulses(currents_a);
        let runs = proposed(loads.clone());
        let met: Vec<f64> = runs
            .iter()
            .filter(|run| run.role == Role::HeldOut)
            .map(|run| loads[run.load].current_a)
            .collect();
        assert_eq!(met, held_out, "{currents_a:?}");
    }
}

#[test]
fn charge_is_counted_from_the_start_or_from_the_rest_voltage() {
    let parts = [
        part(60.0, 0.0),
        part(720.0, 1.0),
        part(300.0, 0.0),
        part(10.0, 2.0),
        part(60.0, 0.0),
    ];
    let series = log(&parts, 1.0);
    let curve = OcvCurve::monotone(2.0, vec![0.0, 1.0], vec![3.2, 4.2]).unwrap();
    for (known, start, from) in [
        (
            ChargeKnown {
                capacity_ah: Some(2.0),
                soc_start: Some(0.9),
                ..ChargeKnown::default()
            },
            0.9,
            SocFrom::Counted,
        ),
        (
            ChargeKnown {
                capacity_ah: Some(2.0),
                curve: Some(&curve),
                ..ChargeKnown::default()
            },
            0.5,
            SocFrom::RestVoltage,
        ),
    ] {
        let mut all = found(&series);
        count_charge(&series, &mut all, known);
        let met = [all[0].soc.unwrap(), all[1].soc.unwrap()];
        assert!((met[0].value - start).abs() < 1e-3 && (met[1].value - start + 0.1).abs() < 1e-3);
        assert_eq!((met[0].from, met[1].from), (from, SocFrom::Counted));
    }
    let mut all = found(&series);
    let wrong = ChargeKnown {
        capacity_ah: Some(0.1),
        soc_start: Some(0.5),
        ..ChargeKnown::default()
    };
    count_charge(&series, &mut all, wrong);
    assert!(refusal(&all[1]).starts_with("the counted state of charge is -1.5"));
    count_charge(&series, &mut found(&series), ChargeKnown::default());
}

#[test]
fn a_spectrum_elsewhere_is_refused_and_one_without_a_state_is_taken_at_the_pulses() {
    let runs = proposed(pulses(&[1.0, 2.0]));
    let spectrum = |place| FoundSpectrum {
        name: "eis".to_owned(),
        file: "eis.csv".to_owned(),
        among: None,
        points: 10,
        from_hz: None,
        to_hz: None,
        inductive: false,
        place,
        assumed: Vec::new(),
        refusal: None,
    };
    let at = |ocv_v, temperature_degc| {
        spectrum(Place {
            soc: None,
            ocv_v,
            temperature_degc,
        })
    };
    let mut all = [
        at(None, None),
        at(Some(3.705), Some(26.0)),
        at(Some(3.9), Some(25.0)),
        at(Some(3.7), Some(10.0)),
    ];
    check_spectra(&mut all, &runs);
    assert_eq!(all[0].assumed, ["temperature_c", "ocv_v"]);
    assert!(all[0].refusal.is_none() && all[1].refusal.is_none());
    for (spectrum, reason) in [
        (&all[2], "it was taken at 3.9000 V and 25.0 °C"),
        (&all[3], "it was taken at 3.7000 V and 10.0 °C"),
    ] {
        assert!(spectrum.refusal.as_deref().unwrap().starts_with(reason));
    }
}

#[test]
fn a_spectrum_beside_several_states_needs_its_own_and_takes_the_one_temperature() {
    let mut loads = pulses(&[1.0, 2.0]);
    for (load, value) in loads.iter_mut().zip([0.9, 0.5]) {
        load.soc = Some(KnownSoc {
            value,
            from: SocFrom::Counted,
        });
    }
    let runs = proposed(loads);
    let spectrum = |soc| FoundSpectrum {
        name: "eis".to_owned(),
        file: "eis.csv".to_owned(),
        among: None,
        points: 10,
        from_hz: None,
        to_hz: None,
        inductive: false,
        place: Place {
            soc,
            ..Place::default()
        },
        assumed: Vec::new(),
        refusal: None,
    };
    let mut all = [spectrum(Some(0.52)), spectrum(None)];
    check_spectra(&mut all, &runs);
    assert_eq!(
        (all[0].refusal.as_deref(), all[0].place.temperature_degc),
        (None, Some(25.0))
    );
    assert_eq!(all[0].assumed, ["temperature_c"]);
    let reason = all[1].refusal.as_deref().unwrap();
    assert!(
        reason.starts_with("its state is not stated") && reason.contains("--at eis:soc="),
        "{reason}"
    );
}

#[test]
fn noise_and_codes_are_estimated_and_nothing_is_stated_of_a_log_without_rests() {
    let mut series = log(&[part(600.0, 0.0), part(100.0, 2.0), part(600.0, 0.0)], 1.0);
    // Uniform noise of 4 codes, by a generator of its own.
    let mut state = 1_u32;
    for v in &mut series.voltage_v {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let uniform = f64::from(state >> 8) / f64::from(1 << 24) - 0.5;
        *v = ((*v + 4e-3 * uniform) / 1e-3).round() * 1e-3;
    }
    let estimated = estimate(&[&series]);
    assert!((estimated.voltage_resolution_v.unwrap() - 1e-3).abs() < 1e-6);
    let noise_v = estimated.voltage_noise_v.unwrap();
    // 4 mV / √12.
    assert!((1.0e-3..1.3e-3).contains(&noise_v), "{noise_v}");
    assert_eq!(
        (estimated.current_noise_a, estimated.current_resolution_a),
        (None, None)
    );
    assert!(!estimated.voltage_noise_hidden);
    assert_eq!(estimate(&[]), Estimate::default());
}
