pub(crate) mod sim;

use super::{Check, Expected, GateReport, gate};
use crate::{DataSet, Verdict};
use num_complex::Complex64;
use sim::{Hidden, campaign, exchange, model, points, series};
use std::f64::consts::TAU;

fn look(set: &DataSet) -> GateReport {
    gate(set, &Expected::new(set, &model()))
}

/// Findings of the gate, with the runs.
fn found(set: &DataSet) -> Vec<(Check, String)> {
    look(set)
        .invalid
        .into_iter()
        .map(|reason| (reason.check, reason.runs.join("+")))
        .collect()
}

type Damage = fn(&mut DataSet);

/// Each kind of damage, by the run that has it and the check that must find it.
const DAMAGES: &[(&str, Damage, Check, &str)] = &[
    (
        "no samples",
        |s| {
            *series(s, "pulse_1") = analysis_signal::series::TimeSeries {
                time_s: vec![],
                current_a: vec![],
                voltage_v: vec![],
                ..series(s, "pulse_1").clone()
            }
        },
        Check::Empty,
        "pulse_1",
    ),
    (
        "lists of different lengths",
        |s| {
            series(s, "pulse_1").current_a.pop();
        },
        Check::Empty,
        "pulse_1",
    ),
    (
        "no points",
        |s| points(s, "eis_2").clear(),
        Check::Empty,
        "eis_2",
    ),
    (
        "not a number",
        |s| series(s, "discharge_0").voltage_v[40] = f64::NAN,
        Check::NotFinite,
        "discharge_0",
    ),
    (
        "infinite impedance",
        |s| points(s, "eis_1")[3].z_ohm.im = f64::INFINITY,
        Check::NotFinite,
        "eis_1",
    ),
    (
        "time back",
        |s| {
            series(s, "profile_1")
                .time_s
                .iter_mut()
                .skip(50)
                .for_each(|t| *t -= 2.0);
        },
        Check::TimesGoBack,
        "profile_1",
    ),
    (
        "a clock that jumps between two samples",
        |s| {
            series(s, "discharge_1")
                .time_s
                .iter_mut()
                .skip(200)
                .for_each(|t| *t -= 0.5);
        },
        Check::TimesGoBack,
        "discharge_1",
    ),
    (
        "mA",
        |s| {
            series(s, "pulse_0")
                .current_a
                .iter_mut()
                .for_each(|i| *i *= 1e3);
        },
        Check::Unit,
        "pulse_0",
    ),
    (
        "kA",
        |s| {
            series(s, "discharge_0")
                .current_a
                .iter_mut()
                .for_each(|i| *i /= 1e3);
        },
        Check::Unit,
        "discharge_0",
    ),
    (
        "mV",
        |s| {
            series(s, "profile_2")
                .voltage_v
                .iter_mut()
                .for_each(|v| *v *= 1e3);
        },
        Check::Unit,
        "profile_2",
    ),
    (
        "mΩ",
        |s| points(s, "eis_0").iter_mut().for_each(|p| p.z_ohm *= 1e3),
        Check::Unit,
        "eis_0",
    ),
    (
        "current's sign",
        |s| {
            series(s, "discharge_1")
                .current_a
                .iter_mut()
                .for_each(|i| *i = -*i);
        },
        Check::Sign,
        "discharge_1",
    ),
    (
        "imaginary part's sign",
        |s| {
            points(s, "eis_3")
                .iter_mut()
                .for_each(|p| p.z_ohm.im = -p.z_ohm.im);
        },
        Check::Sign,
        "eis_3",
    ),
    (
        "leads reversed",
        |s| {
            points(s, "eis_3")
                .iter_mut()
                .for_each(|p| p.z_ohm.re = -p.z_ohm.re);
        },
        Check::Sign,
        "eis_3",
    ),
    (
        "clipped below",
        |s| clip(s, "pulse_2", 0.4),
        Check::Clipped,
        "pulse_2",
    ),
    (
        "clipped discharge",
        |s| clip(s, "discharge_2", 0.4),
        Check::Clipped,
        "discharge_2",
    ),
    (
        "clipped profile",
        |s| clip(s, "profile_0", 0.5),
        Check::Clipped,
        "profile_0",
    ),
    (
        "one lags",
        |s| lag(s, "pulse_1", 1.5),
        Check::CurrentLags,
        "pulse_1",
    ),
    (
        "one lags in the long discharge",
        |s| lag(s, "discharge_1", 1.5),
        Check::CurrentLags,
        "discharge_1",
    ),
    (
        "one lags in the profile",
        |s| lag(s, "profile_1", 1.5),
        Check::CurrentLags,
        "profile_1",
    ),
    (
        "drift during the sweep",
        |s| drift(s, "eis_1", 0.15),
        Check::KramersKronig,
        "eis_1",
    ),
    (
        "drift the other way",
        |s| drift(s, "eis_2", -0.15),
        Check::KramersKronig,
        "eis_2",
    ),
    (
        "contents exchanged",
        |s| exchange(s, "pulse_0", "discharge_1"),
        Check::Swapped,
        "pulse_0",
    ),
    (
        "voltage of another run",
        |s| {
            let v = series(s, "profile_0").voltage_v.clone();
            let own = &mut series(s, "pulse_1").voltage_v;
            let n = own.len().min(v.len());
            own[..n].copy_from_slice(&v[..n]);
            own.truncate(n);
            let kept = series(s, "pulse_1");
            kept.time_s.truncate(n);
            kept.current_a.truncate(n);
        },
        Check::Swapped,
        "pulse_1",
    ),
    (
        "shunt's sweep under the cell's name",
        |s| exchange(s, "eis_0", "shunt_0"),
        Check::Swapped,
        "eis_0",
    ),
    (
        "cut off",
        |s| truncate(s, "pulse_2", 0.4),
        Check::Truncated,
        "pulse_2",
    ),
    (
        "discharge cut off",
        |s| truncate(s, "discharge_2", 0.4),
        Check::Truncated,
        "discharge_2",
    ),
    (
        "sweep cut off",
        |s| points(s, "eis_1").truncate(10),
        Check::Truncated,
        "eis_1",
    ),
    (
        "a repeat with other resistances",
        |s| points(s, "eis_1").iter_mut().for_each(|p| p.z_ohm *= 1.15),
        Check::Repeats,
        "eis_1",
    ),
    (
        "a repeat at another level",
        |s| {
            series(s, "pulse_1")
                .voltage_v
                .iter_mut()
                .for_each(|v| *v += 0.05);
        },
        Check::Repeats,
        "pulse_1",
    ),
];

fn clip(set: &mut DataSet, name: &str, share: f64) {
    let v = &mut series(set, name).voltage_v;
    let (low, high) = v
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
            (l.min(*v), h.max(*v))
        });
    v.iter_mut()
        .for_each(|v| *v = v.max(high - share * (high - low)));
}

fn lag(set: &mut DataSet, name: &str, tau_s: f64) {
    let s = series(set, name);
    let mut state = s.current_a[0];
    for k in 0..s.current_a.len() {
        let step_s = s.time_s.get(k + 1).map_or(1.0, |t| t - s.time_s[k]);
        state += (1.0 - (-step_s / tau_s).exp()) * (s.current_a[k] - state);
        s.current_a[k] = state;
    }
}

fn drift(set: &mut DataSet, name: &str, share: f64) {
    let all = points(set, name);
    let last = all.len() as f64 - 1.0;
    all.iter_mut()
        .enumerate()
        .for_each(|(k, p)| p.z_ohm *= 1.0 + share * k as f64 / last);
}

fn truncate(set: &mut DataSet, name: &str, share: f64) {
    let s = series(set, name);
    let kept = (share * s.time_s.len() as f64) as usize;
    [&mut s.time_s, &mut s.current_a, &mut s.voltage_v]
        .into_iter()
        .for_each(|column| column.truncate(kept));
}

#[test]
fn damage_is_found_and_named() {
    let clean = campaign(&Hidden::default(), 1);
    let mut wrong = Vec::new();
    for (what, damage, check, run) in DAMAGES {
        let mut set = clean.clone();
        damage(&mut set);
        let met = found(&set);
        if !met.iter().any(|(c, runs)| c == check && runs == run) {
            wrong.push(format!("{what}: {met:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Without any one of the checks, some damage is not found under its name.
#[test]
fn each_check_is_needed() {
    let clean = campaign(&Hidden::default(), 1);
    let damaged: Vec<_> = DAMAGES
        .iter()
        .map(|(_, damage, check, run)| {
            let mut set = clean.clone();
            damage(&mut set);
            let expected = Expected::new(&set, &model());
            (set, expected, *check, *run)
        })
        .collect();
    for left_out in 0..super::CHECKS.len() {
        let mut checks = super::CHECKS.to_vec();
        checks.remove(left_out);
        let missed = damaged.iter().any(|(set, expected, check, run)| {
            let invalid = super::run(set, expected, &checks).invalid;
            !invalid
                .iter()
                .any(|reason| reason.check == *check && reason.runs == [*run])
        });
        assert!(missed, "check {left_out} finds nothing of its own");
    }
}

#[test]
fn reasons_name_run_and_numbers() {
    let mut set = campaign(&Hidden::default(), 1);
    series(&mut set, "pulse_0")
        .current_a
        .iter_mut()
        .for_each(|i| *i *= 1e3);
    lag(&mut set, "discharge_1", 1.5);
    series(&mut set, "profile_1").time_s[1] = 0.0;
    let texts: Vec<String> = look(&set).invalid.iter().map(ToString::to_string).collect();
    let [back, unit, late] = texts.as_slice() else {
        panic!("{texts:?}")
    };
    assert_eq!(
        back,
        "profile_1: its times go back: after 0 s comes 0 s (sample 2)"
    );
    assert!(
        unit.starts_with("pulse_0: steps of its current meet ")
            && unit.ends_with(" mΩ where 9.19 mΩ are expected: mA for A?"),
        "{unit}"
    );
    assert!(
        late.starts_with("discharge_1: its logged current lags by 1.")
            && late.ends_with(" s behind the voltage, the other records' does not"),
        "{late}"
    );
}

#[test]
fn what_was_let_pass_is_noted() {
    let slow = Hidden {
        lag_s: 1.5,
        ..Hidden::default()
    };
    let notes = look(&campaign(&slow, 1)).notes;
    assert!(
        notes.len() == 1
            && notes[0]
                .starts_with("the logged current of 9 records lags behind the voltage, by 1."),
        "{notes:?}"
    );
}

#[test]
fn without_history_the_rest_still_works() {
    let mut set = campaign(&Hidden::default(), 1);
    set.history = None;
    assert_eq!(look(&set), GateReport::default());
    series(&mut set, "pulse_0")
        .current_a
        .iter_mut()
        .for_each(|i| *i = -*i);
    clip(&mut set, "discharge_1", 0.4);
    drift(&mut set, "eis_1", 0.15);
    let expected = [
        (Check::Sign, "pulse_0"),
        (Check::KramersKronig, "eis_1"),
        (Check::Clipped, "discharge_1"),
    ];
    assert_eq!(
        found(&set),
        expected.map(|(check, run)| (check, run.to_owned()))
    );
}

/// A cell that ages steadily passes at any rate; the same change all at once, before the last
/// repeat, does not.
#[test]
fn steady_ageing_passes_at_any_rate() {
    let mut steady = campaign(
        &Hidden {
            ageing: 0.2,
            ..Hidden::default()
        },
        1,
    );
    if let Some(history) = &mut steady.history {
        // A bench so good that the change is some thousand standard deviations.
        (
            history.resistance_rel,
            history.eis_noise_rel,
            history.current_gain_rel,
        ) = (1e-4, 1e-4, 1e-4);
    }
    let repeats = |set: &DataSet| {
        found(set)
            .into_iter()
            .filter(|(check, _)| *check == Check::Repeats)
            .count()
    };
    assert_eq!(repeats(&steady), 0, "{:?}", found(&steady));
    let mut sudden = steady;
    for nth in 0..2 {
        let z = points(&mut sudden, &format!("eis_{nth}")).clone();
        points(&mut sudden, &format!("eis_{}", 1 - nth)).clone_from(&z);
    }
    assert!(repeats(&sudden) > 0, "the order of time counts");
}

/// Without current a channel shows only noise: repeats of a log at zero current are alike.
#[test]
fn logs_without_current_repeat_each_other() {
    let mut set = campaign(&Hidden::default(), 1);
    for nth in 0..3u32 {
        let mut run = set
            .runs
            .iter()
            .find(|run| run.name == "pulse_0")
            .unwrap()
            .clone();
        (run.name, run.repeat_group, run.order) =
            (format!("zero_{nth}"), "zero".to_owned(), 100 + nth);
        set.runs.push(run);
        let s = series(&mut set, &format!("zero_{nth}"));
        let level_v = s.voltage_v[0];
        for k in 0..s.current_a.len() {
            s.current_a[k] = 0.03 * (f64::from(nth + 1) * 12.9898 * (k as f64 + 1.0)).sin();
            s.voltage_v[k] = level_v;
        }
    }
    let wrong: Vec<_> = found(&set)
        .into_iter()
        .filter(|(check, _)| matches!(check, Check::Repeats | Check::Swapped))
        .collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// A zero error of 2.3 standard deviations is counted as 1 % of the charge within an hour and a
/// half: 21 mV of the open-circuit voltage, in that repeat alone.
#[test]
fn a_zero_error_of_a_long_record_is_not_another_run() {
    let mut set = campaign(&Hidden::default(), 1);
    for (nth, zero_a) in (0..3u32).zip([0.07, -0.01, 0.0]) {
        let mut run = set
            .runs
            .iter()
            .find(|run| run.name == "pulse_0")
            .unwrap()
            .clone();
        (run.name, run.repeat_group, run.order) =
            (format!("rest_{nth}"), "rest".to_owned(), 100 + nth);
        set.runs.push(run);
        let s = series(&mut set, &format!("rest_{nth}"));
        let level_v = s.voltage_v[0];
        for k in 0..s.len() {
            (s.current_a[k], s.voltage_v[k]) = (zero_a, level_v);
        }
        let lasts_s = s.time_s[s.len() - 1];
        s.time_s.iter_mut().for_each(|t| *t *= 5400.0 / lasts_s);
    }
    let wrong: Vec<_> = found(&set)
        .into_iter()
        .filter(|(check, _)| *check == Check::Repeats)
        .collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn refused_data_end_as_invalid() {
    let mut set = campaign(&Hidden::default(), 1);
    let unreadable = vec![super::Reason::unreadable("lost", "no such bytes")];
    let clean = super::diagnose(&set, unreadable, &model(), &Default::default())
        .unwrap()
        .diagnosis;
    assert_eq!(
        (clean.verdict, clean.summary.as_str()),
        (
            Verdict::Invalid,
            "The data cannot be used. lost: no such bytes."
        )
    );
    clip(&mut set, "pulse_2", 0.4);
    let refused = super::diagnose(&set, Vec::new(), &model(), &Default::default())
        .unwrap()
        .diagnosis;
    assert!(
        refused.verdict == Verdict::Invalid
            && refused.summary.contains("pulse_2: its voltage is clipped"),
        "{}",
        refused.summary
    );
    let json = serde_json::to_value(&refused).unwrap();
    assert_eq!(
        (&json["verdict"], &json["quality"]["base_chi2"]),
        (&"invalid".into(), &serde_json::Value::Null)
    );
}

#[test]
fn clean_campaigns_pass() {
    for seed in 0..12 {
        let report = look(&campaign(&Hidden::default(), seed));
        assert_eq!(report, GateReport::default(), "seed {seed}");
    }
}

/// Two repeats do not show which way they go, but the cell does where others of it were measured
/// three times.
#[test]
fn two_repeats_may_go_with_the_cell() {
    let pair = |hidden: &Hidden| {
        let mut set = campaign(hidden, 4);
        set.runs.retain(|run| run.name != "profile_1");
        set
    };
    let refused = |set: &DataSet| {
        look(set)
            .invalid
            .iter()
            .any(|reason| reason.check == Check::Repeats)
    };
    let aged = pair(&Hidden {
        ageing: 1e-1,
        ..Hidden::default()
    });
    assert!(!refused(&aged));
    let mut alone = aged;
    let mut seen = std::collections::BTreeSet::new();
    alone
        .runs
        .retain(|run| run.repeat_group == "profile" || seen.insert(run.repeat_group.clone()));
    assert!(refused(&alone), "nothing else says that the cell changes");
    let mut moved = pair(&Hidden::default());
    series(&mut moved, "profile_2")
        .voltage_v
        .iter_mut()
        .for_each(|v| *v += 0.05);
    assert!(refused(&moved), "the others did not move");
}

/// Everything a cell or a bench may really do, strong.
#[test]
fn hidden_effects_pass() {
    let spectrum = |more: fn(f64, Complex64) -> Complex64| Hidden {
        spectrum: Some(more),
        ..Hidden::default()
    };
    let cases: Vec<(&str, Hidden)> = vec![
        (
            "heat",
            Hidden {
                heat: true,
                ..Hidden::default()
            },
        ),
        (
            "hysteresis",
            Hidden {
                hysteresis_v: 0.02,
                ..Hidden::default()
            },
        ),
        (
            "slow relaxation",
            Hidden {
                slow: Some((8e-3, 30.0)),
                ..Hidden::default()
            },
        ),
        (
            "Butler–Volmer",
            Hidden {
                beta: 2e-3 / (2.0 * 25.69e-3),
                ..Hidden::default()
            },
        ),
        (
            "asymmetry",
            Hidden {
                asymmetry: 0.1,
                ..Hidden::default()
            },
        ),
        (
            "ageing",
            Hidden {
                ageing: 5e-3,
                ..Hidden::default()
            },
        ),
        (
            "a lag of all records",
            Hidden {
                lag_s: 0.05,
                ..Hidden::default()
            },
        ),
        (
            "a long lag of all records",
            Hidden {
                lag_s: 1.5,
                ..Hidden::default()
            },
        ),
        (
            "inductance",
            spectrum(|f, z| z + Complex64::new(0.0, TAU * f * 300e-9)),
        ),
        (
            "a large inductance",
            spectrum(|f, z| z + Complex64::new(0.0, TAU * f * 2e-6)),
        ),
        (
            "lossy inductance",
            spectrum(|f, z| z + 300e-9 * TAU * 300.0 * Complex64::new(0.0, f / 300.0).powf(0.6)),
        ),
        (
            "skew",
            spectrum(|f, z| z * Complex64::new(0.0, TAU * f * 50e-6).exp()),
        ),
        (
            "skew the other way",
            spectrum(|f, z| z * Complex64::new(0.0, -TAU * f * 50e-6).exp()),
        ),
        ("contact", spectrum(|_, z| z + 2e-3)),
        ("gain", spectrum(|_, z| 1.1 * z)),
        (
            "depressed arc",
            spectrum(|f, z| {
                z + 3e-3 / (1.0 + Complex64::new(0.0, TAU * f * 0.06).powf(0.7))
                    - 3e-3 / (1.0 + Complex64::new(0.0, TAU * f * 0.06))
            }),
        ),
        (
            "diffusion",
            spectrum(|f, z| z + 5e-4 / Complex64::new(0.0, TAU * f).sqrt()),
        ),
        (
            "finite diffusion",
            spectrum(|f, z| {
                let x = Complex64::new(0.0, TAU * f * 40.0).sqrt();
                z + 8e-3 * x.tanh() / x
            }),
        ),
    ];
    let mut wrong = Vec::new();
    for (what, hidden) in cases {
        for seed in 0..3 {
            let met = look(&campaign(&hidden, seed)).invalid;
            if !met.is_empty() {
                wrong.push(format!("{what}, seed {seed}: {met:?}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
