//! Tables of constructed cells, whose resistances follow in closed form.

use analysis_signal::series::TimeSeries;

use super::*;
use crate::loads::{ChargeKnown, Counted, drawn_by_counter};

/// A resistance, pairs of resistance and time constant, and an open-circuit voltage with a slope.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    pub(super) r_ohm: f64,
    pub(super) branches: Vec<(f64, f64)>,
    pub(super) ocv_v: f64,
    pub(super) v_per_coulomb: f64,
}

impl Cell {
    /// The resistance of a pulse after a time.
    pub(super) fn pulse_ohm(&self, at_s: f64) -> f64 {
        let branch = |(ohm, tau_s): &(f64, f64)| ohm * (1.0 - (-at_s / tau_s).exp());
        self.r_ohm + self.branches.iter().map(branch).sum::<f64>() + self.v_per_coulomb * at_s
    }
}

/// A part of a program: duration, s, current, A, and step of the log, s.
pub(super) type Part = (f64, f64, f64);

/// The log of a cell under a program. A row stands at the end of each step of the log.
pub(super) fn log(cell: &Cell, program: &[Part]) -> TimeSeries {
    let mut held_v = vec![0.0; cell.branches.len()];
    let (mut begun_s, mut drawn_coulomb) = (0.0, 0.0);
    let (mut time_s, mut current_a, mut voltage_v) = (vec![0.0], vec![0.0], vec![cell.ocv_v]);
    for (lasting_s, amperes, every_s) in program {
        let rows = (lasting_s / every_s).round() as usize;
        for k in 1..=rows {
            drawn_coulomb += amperes * every_s;
            for (v, (ohm, tau_s)) in held_v.iter_mut().zip(&cell.branches) {
                let kept = (-every_s / tau_s).exp();
                *v = *v * kept + ohm * amperes * (1.0 - kept);
            }
            time_s.push(begun_s + k as f64 * every_s);
            current_a.push(*amperes);
            let lost_v = cell.r_ohm * amperes + held_v.iter().sum::<f64>();
            voltage_v.push(cell.ocv_v - cell.v_per_coulomb * drawn_coulomb - lost_v);
        }
        begun_s += lasting_s;
    }
    TimeSeries {
        name: "log.csv".to_owned(),
        temperature_degc: Some(vec![25.0; time_s.len()]),
        time_s,
        current_a,
        voltage_v,
    }
}

pub(super) fn table_of(series: &TimeSeries, options: &HppcOptions) -> Result<Hppc, HppcError> {
    hppc(
        Log {
            series,
            steps: None,
            charge: ChargeKnown::default(),
            counter_ah: None,
        },
        options,
    )
}

fn cell() -> Cell {
    Cell {
        r_ohm: 0.01,
        branches: vec![(0.005, 0.5), (0.01, 20.0)],
        ocv_v: 3.7,
        v_per_coulomb: 4e-5,
    }
}

const LIMITS: HppcOptions = HppcOptions {
    at_s: Vec::new(),
    limits: Some(Limits {
        min_v: 2.5,
        max_v: 4.2,
    }),
    rest_s: 10.0,
    current_gain: 0.0,
    start_logged: false,
};

fn with_limits() -> HppcOptions {
    HppcOptions {
        at_s: HppcOptions::default().at_s,
        ..LIMITS
    }
}

/// A discharge, 40 s of rest and a charge, as the manual has it.
const MANUAL: [Part; 5] = [
    (600.0, 0.0, 1.0),
    (10.0, 4.0, 0.1),
    (40.0, 0.0, 0.1),
    (10.0, -3.0, 0.1),
    (60.0, 0.0, 1.0),
];

fn reasons(pulse: &Pulse) -> Vec<&str> {
    let each = pulse.resistances.iter();
    each.map(|one| one.reason.as_deref().unwrap_or(""))
        .collect()
}

#[test]
fn resistances_and_power_are_those_of_the_cell_in_both_directions() {
    let found = table_of(&log(&cell(), &MANUAL), &with_limits()).unwrap();
    let [discharge, charge] = found.pulses.as_slice() else {
        panic!("{found:#?}")
    };
    assert_eq!(
        (discharge.direction, charge.direction),
        (Direction::Discharge, Direction::Charge)
    );
    assert_eq!((discharge.current_a, charge.current_a), (4.0, -3.0));
    assert!((charge.state.drawn_ah.unwrap() - 40.0 / 3600.0).abs() < 1e-9);
    assert_eq!(found.axis, StateAxis::ChargeDrawn);
    for pulse in [discharge, charge] {
        for one in &pulse.resistances {
            let (met, truth) = (one.found.unwrap().ohm, cell().pulse_ohm(one.at_s));
            // The rest before the charge still relaxes: its trend is not exact.
            let part = if pulse.direction == Direction::Charge {
                0.01
            } else {
                1e-9
            };
            assert!(
                (met / truth - 1.0).abs() < part,
                "{} s: {met} {truth}",
                one.at_s
            );
        }
    }
    // V_min (OCV − V_min) / R at 10 s, the least of all times.
    let least = discharge.least_power.unwrap();
    let power_w = 2.5 * (3.7 - 2.5) / cell().pulse_ohm(10.0);
    assert!(
        least.at_s == 10.0 && (least.w - power_w).abs() < 1e-6,
        "{least:?}"
    );
    let charge_ocv_v = charge.state.open_circuit.unwrap().v;
    let power_w = 4.2 * (4.2 - charge_ocv_v) / charge.resistances[4].found.unwrap().ohm;
    assert!((charge.least_power.unwrap().w - power_w).abs() < 1e-9);
}

#[test]
fn the_trend_of_a_rest_that_relaxes_is_continued_into_the_pulse() {
    let series = log(&cell(), &MANUAL);
    let found = table_of(&series, &HppcOptions::default()).unwrap();
    let met = found.pulses[1].resistances[4].found.unwrap();
    // One sample of the rest instead of its trend is wrong by more than a percent.
    let rows = |at_s: f64| {
        series
            .time_s
            .iter()
            .position(|t| (t - at_s).abs() < 1e-6)
            .unwrap()
    };
    let sample = (series.voltage_v[rows(650.0)] - series.voltage_v[rows(660.0)]) / -3.0;
    let truth = cell().pulse_ohm(10.0);
    assert!((sample / truth - 1.0).abs() > 0.01, "{sample} {truth}");
    assert!((met.ohm / truth - 1.0).abs() < 0.002, "{} {truth}", met.ohm);
}

#[test]
fn what_the_rows_do_not_show_is_empty_with_its_reason() {
    let program = [(60.0, 0.0, 1.0), (7.0, 4.0, 1.0), (60.0, 0.0, 1.0)];
    let found = table_of(&log(&cell(), &program), &HppcOptions::default()).unwrap();
    assert_eq!(
        reasons(&found.pulses[0]),
        [
            "first row of the pulse at 1.00 s",
            "",
            "",
            "",
            "the pulse lasts 8.0 s"
        ]
    );
    // Rows each 3 s: none is near 2 s or 5 s, and none is made up.
    let program = [(60.0, 0.0, 1.0), (15.0, 4.0, 3.0), (60.0, 0.0, 1.0)];
    let found = table_of(&log(&cell(), &program), &HppcOptions::default()).unwrap();
    assert_eq!(
        reasons(&found.pulses[0])[1..],
        [
            "first row of the pulse at 3.00 s",
            "first row of the pulse at 3.00 s",
            "no row near it, only at 3.00 s and 6.00 s",
            "no row near it, only at 9.00 s and 12.00 s"
        ]
    );
}

#[test]
fn a_current_that_is_not_constant_is_named_with_its_time() {
    let mut series = log(&cell(), &MANUAL);
    let row = |series: &TimeSeries, at_s: f64| {
        let mut times = series.time_s.iter();
        times.position(|t| (t - at_s).abs() < 1e-6).unwrap()
    };
    // The first row of the discharge is on the way to its current.
    let first = row(&series, 600.1);
    series.current_a[first] = 3.6;
    let found = table_of(&series, &HppcOptions::default()).unwrap();
    let pulse = &found.pulses[0];
    assert_eq!(
        reasons(pulse),
        [
            "its current is not constant: 3.600 A at 0.10 s, not 4.000 A",
            "",
            "",
            "",
            ""
        ]
    );
    assert_eq!(
        pulse.notes,
        ["its current is within 2 % of 4.000 A from 0.20 s on"]
    );
    // A slower one settles too late for the resistance at 1 s.
    for k in 1..8 {
        series.current_a[first + k] = 3.6;
    }
    let found = table_of(&series, &HppcOptions::default()).unwrap();
    // It then varies for longer than a ramp, and is not a constant current.
    assert_eq!(found.pulses.len(), 1);
    assert_eq!(found.left_out[0].reason, "its current varies");
}

#[test]
fn a_pulse_that_a_voltage_limit_holds_has_resistances_until_then() {
    let mut series = log(&cell(), &MANUAL);
    let from = series
        .time_s
        .iter()
        .position(|t| (t - 606.05).abs() < 0.06)
        .unwrap();
    let held_v = series.voltage_v[from];
    for k in from..from + 40 {
        series.voltage_v[k] = held_v;
        series.current_a[k] = 4.0 * (1.0 - 0.005 * (k + 1 - from) as f64);
    }
    let found = table_of(&series, &HppcOptions::default()).unwrap();
    let pulse = &found.pulses[0];
    assert_eq!(pulse.current_a, 4.0);
    assert_eq!(pulse.notes[0], "a voltage limit reduces its current");
    assert!(pulse.resistances[3].found.is_some());
    let reason = pulse.resistances[4].reason.as_deref().unwrap();
    assert!(
        reason.starts_with("its current is not constant: 3.9"),
        "{reason}"
    );
}

#[test]
fn currents_at_one_state_are_rows_of_their_own_and_pulses_on_a_current_have_no_power() {
    let program = [
        (300.0, 1.0, 1.0),
        (10.0, 3.0, 0.1),
        (300.0, 1.0, 1.0),
        (10.0, 5.0, 0.1),
        (300.0, 1.0, 1.0),
    ];
    let found = table_of(&log(&cell(), &program), &with_limits()).unwrap();
    let currents: Vec<f64> = found.pulses.iter().map(|pulse| pulse.current_a).collect();
    assert_eq!(currents, [3.0, 5.0]);
    let one = &found.pulses[0];
    let met = one.resistances[4].found.unwrap();
    // Of the change from 1 A to 3 A.
    assert!(
        (met.ohm / cell().pulse_ohm(10.0) - 1.0).abs() < 0.01,
        "{}",
        met.ohm
    );
    assert!(met.power_w.is_none() && one.least_power.is_none());
    assert_eq!(
        one.notes,
        ["no power: it stands on a current, so that no rest has the OCV"]
    );
}

#[test]
fn states_are_counted_where_capacity_and_start_are_known() {
    let series = log(&cell(), &MANUAL);
    let at = |soc_start: f64| {
        let charge = ChargeKnown {
            capacity_ah: Some(0.1),
            soc_start: Some(soc_start),
            ..ChargeKnown::default()
        };
        let log = Log {
            series: &series,
            steps: None,
            charge,
            counter_ah: None,
        };
        hppc(log, &HppcOptions::default()).unwrap()
    };
    let found = at(0.5);
    assert_eq!(found.axis, StateAxis::Soc);
    let soc = found.pulses[1].state.soc.unwrap().value;
    // 4 A for 10 s of 0.1 Ah.
    assert!((soc - (0.5 - 40.0 / 360.0)).abs() < 1e-3, "{soc}");
    // A count that leaves 0 to 1 is named and not used.
    let found = at(0.05);
    assert_eq!(found.axis, StateAxis::ChargeDrawn);
    let note = &found.pulses[1].notes[0];
    assert!(note.contains("capacity or start are wrong"), "{note}");
}

#[test]
fn a_limit_that_the_rest_is_beyond_gives_no_power() {
    let mut options = with_limits();
    options.limits = Some(Limits {
        min_v: 3.8,
        max_v: 4.2,
    });
    let found = table_of(&log(&cell(), &MANUAL), &options).unwrap();
    assert_eq!(
        found.pulses[0].notes,
        ["no power: its rest at 3.7000 V is beyond the limit of 3.8 V"]
    );
    assert!(found.pulses[1].least_power.is_some());
}

#[test]
fn a_log_without_pulses_says_what_it_holds() {
    let message = |program: &[Part]| {
        let error = table_of(&log(&cell(), program), &HppcOptions::default());
        error.unwrap_err().to_string()
    };
    let looked = "log.csv: expected at least one pulse: a constant current of up to 300 s after a \
                  rest of at least 10 s, or on a steady current; found ";
    assert_eq!(
        message(&[(60.0, 0.0, 1.0), (900.0, 1.0, 1.0), (60.0, 0.0, 1.0)]),
        format!("{looked}1 load (its constant current lasts longer than 300 s)")
    );
    assert_eq!(
        message(&[(6.0, 0.0, 1.0), (10.0, 1.0, 1.0), (60.0, 0.0, 1.0)]),
        format!("{looked}1 load (the rest before it is logged for less than 10 s)")
    );
    assert_eq!(
        message(&[(60.0, 0.0, 1.0)]),
        format!("{looked}no current above the rest")
    );
}

#[test]
fn options_that_cannot_be_are_refused() {
    let series = log(&cell(), &MANUAL);
    let refused = |change: &dyn Fn(&mut HppcOptions)| {
        let mut options = with_limits();
        change(&mut options);
        table_of(&series, &options).unwrap_err().to_string()
    };
    let message = refused(&|options| options.at_s = vec![1.0, 0.1]);
    assert!(
        message.contains("rising times above 0 s, found [1.0, 0.1]"),
        "{message}"
    );
    let message = refused(&|options| {
        options.limits = Some(Limits {
            min_v: 4.2,
            max_v: 2.5,
        });
    });
    assert!(message.contains("found 4.2 V and 2.5 V"), "{message}");
    let message = refused(&|options| options.current_gain = f64::NAN);
    assert!(message.contains("found NaN"), "{message}");
    let message = refused(&|options| options.rest_s = -1.0);
    assert!(message.contains("found -1 s"), "{message}");
}

#[test]
fn a_start_that_the_log_does_not_show_is_part_of_the_uncertainty() {
    let program = [(60.0, 0.0, 1.0), (10.0, 4.0, 1.0), (60.0, 0.0, 1.0)];
    let mut series = log(&cell(), &program);
    series
        .voltage_v
        .iter_mut()
        .for_each(|v| *v = (*v / 1e-5).round() * 1e-5);
    let at = |start_logged: bool| {
        let options = HppcOptions {
            start_logged,
            ..HppcOptions::default()
        };
        table_of(&series, &options).unwrap().pulses[0].resistances[2]
            .found
            .unwrap()
    };
    let (logged, open) = (at(true), at(false));
    assert_eq!(logged.ohm, open.ohm);
    // The current may begin a second later: the slope from 1 s to 2 s.
    let moved = cell().pulse_ohm(2.0) - cell().pulse_ohm(1.0);
    assert!((open.start_ohm.unwrap() - moved).abs() < 1e-5);
    let sigma = |found: Found| found.sigma_ohm.unwrap();
    let expected = sigma(logged).hypot(open.start_ohm.unwrap() / 3.0_f64.sqrt());
    assert!((sigma(open) / expected - 1.0).abs() < 1e-9 && sigma(logged) < 1e-5);
}

#[test]
fn charge_is_not_counted_over_a_cut_of_the_log() {
    let mut series = log(&cell(), &MANUAL);
    // The rest before the charge goes on after 2000 s without a row.
    let rest = series.time_s.iter().position(|t| *t > 620.05).unwrap();
    series.time_s[rest..].iter_mut().for_each(|t| *t += 2000.0);
    let charge = ChargeKnown {
        capacity_ah: Some(2.0),
        soc_start: Some(0.5),
        ..ChargeKnown::default()
    };
    let log = Log {
        series: &series,
        steps: None,
        charge,
        counter_ah: None,
    };
    let found = hppc(log, &HppcOptions::default()).unwrap();
    assert_eq!(found.axis, StateAxis::RestVoltage);
    let [before, behind] = [0, 1].map(|k| &found.pulses[k].state);
    assert!(before.soc.is_some() && before.drawn_ah.is_some());
    assert!(behind.soc.is_none() && behind.drawn_ah.is_none());
    let note = &found.pulses[1].notes[0];
    assert!(
        note.contains("more than 900 s after the last one"),
        "{note}"
    );
}

#[test]
fn a_counter_of_the_cycler_goes_on_over_a_cut() {
    let mut series = log(&cell(), &MANUAL);
    let rest = series.time_s.iter().position(|t| *t > 620.05).unwrap();
    series.time_s[rest..].iter_mut().for_each(|t| *t += 2000.0);
    // 0.5 Ah are drawn in the cut.
    let mut net_ah: Vec<f64> = Counted::of(&series)
        .charge_ah
        .iter()
        .map(|ah| 0.1 - ah)
        .collect();
    net_ah[rest..].iter_mut().for_each(|ah| *ah -= 0.5);
    let counter = drawn_by_counter(&series, &net_ah).unwrap();
    let charge = ChargeKnown {
        capacity_ah: Some(2.0),
        soc_start: Some(0.9),
        ..ChargeKnown::default()
    };
    let log = Log {
        series: &series,
        steps: None,
        charge,
        counter_ah: Some(&counter),
    };
    let found = hppc(log, &HppcOptions::default()).unwrap();
    assert_eq!(found.axis, StateAxis::Soc);
    let soc = found.pulses[1].state.soc.unwrap().value;
    let drawn_ah = 0.5 + 40.0 / 3600.0;
    assert!((soc - (0.9 - drawn_ah / 2.0)).abs() < 1e-3, "{soc}");
    assert!((found.pulses[1].state.drawn_ah.unwrap() - drawn_ah).abs() < 1e-3);
    // One that counts the other way round, or lacks a row, is named.
    let turned: Vec<f64> = net_ah.iter().map(|ah| -ah).collect();
    let message = drawn_by_counter(&series, &turned).unwrap_err();
    assert!(
        message.contains("it moves by -1.000 of the charge"),
        "{message}"
    );
    net_ah[5] = f64::NAN;
    let message = drawn_by_counter(&series, &net_ah).unwrap_err();
    assert!(message.contains("no count in some rows"), "{message}");
}
