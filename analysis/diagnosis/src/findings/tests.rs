use super::{Finding, FindingKind, Inspected};
use crate::gate::tests::sim::{Hidden, campaign, model, points, series};
use crate::{BaseModel, DataSet, Role, RunData};

fn look(set: &DataSet, model: &BaseModel) -> Vec<Finding> {
    Inspected::new(set, model).findings(&[])
}

fn hold_out(set: &mut DataSet, name: &str) {
    let run = set.runs.iter_mut().find(|run| run.name == name).unwrap();
    run.role = Role::HeldOut;
}

fn for_all_records(set: &mut DataSet, mut damage: impl FnMut(&mut crate::TimeRecord)) {
    for run in &mut set.runs {
        if let RunData::Time(record) = &mut run.data {
            damage(record);
        }
    }
}

/// One kind of damage, and the only finding that it must make, with the first run that it names.
type Damage = (&'static str, fn(&mut DataSet), FindingKind, &'static str);

const DAMAGES: &[Damage] = &[
    (
        "a held-out run is a training run",
        |set| {
            let copied = series(set, "profile_0").clone();
            *series(set, "profile_1") = copied;
            hold_out(set, "profile_1");
        },
        FindingKind::Leakage,
        "profile_1",
    ),
    (
        "a third of a held-out run is of a training run",
        |set| {
            let copied = series(set, "pulse_0").clone();
            let own = series(set, "pulse_2");
            let part = own.len() / 3..2 * own.len() / 3;
            own.voltage_v[part.clone()].copy_from_slice(&copied.voltage_v[part.clone()]);
            own.current_a[part.clone()].copy_from_slice(&copied.current_a[part]);
            hold_out(set, "pulse_2");
        },
        FindingKind::Leakage,
        "pulse_2",
    ),
    (
        "a repeat is a copy",
        |set| {
            let copied = series(set, "pulse_0").clone();
            *series(set, "pulse_1") = copied;
        },
        FindingKind::Copy,
        "pulse_1",
    ),
    (
        "a held-out run is a training run that was rounded",
        |set| {
            let mut copied = series(set, "pulse_0").clone();
            for v in &mut copied.voltage_v {
                *v = (*v / 1e-3).round() * 1e-3;
            }
            *series(set, "pulse_1") = copied;
            hold_out(set, "pulse_1");
        },
        FindingKind::Leakage,
        "pulse_1",
    ),
    (
        "a held-out spectrum is one of training",
        |set| {
            let copied = points(set, "eis_0").clone();
            *points(set, "eis_3") = copied;
            hold_out(set, "eis_3");
        },
        FindingKind::Leakage,
        "eis_3",
    ),
    (
        "a rest voltage 250 mV off",
        |set| {
            let own = series(set, "discharge_1");
            own.voltage_v.iter_mut().for_each(|v| *v += 0.25);
        },
        FindingKind::RestVoltage,
        "discharge_1",
    ),
    (
        "forty rows are missing",
        |set| {
            let own = series(set, "discharge_1");
            for column in [&mut own.time_s, &mut own.current_a, &mut own.voltage_v] {
                column.drain(200..240);
            }
        },
        FindingKind::RowsMissing,
        "discharge_1",
    ),
    (
        "a logger that stands still",
        |set| {
            let own = series(set, "profile_1");
            let (i, v) = (own.current_a[60], own.voltage_v[60]);
            own.current_a[60..120].fill(i);
            own.voltage_v[60..120].fill(v);
        },
        FindingKind::RowsRepeated,
        "profile_1",
    ),
    (
        "stamps of whole seconds for samples every 1.3 s",
        |set| {
            let own = series(set, "discharge_1");
            // The rows keep their positions; only their stamps are rounded.
            let mut last_s = f64::NEG_INFINITY;
            let kept: Vec<usize> = (0..own.len())
                .filter(|k| {
                    let late = own.time_s[*k] >= last_s + 1.3;
                    if late {
                        last_s = own.time_s[*k];
                    }
                    late
                })
                .collect();
            own.current_a = kept.iter().map(|k| own.current_a[*k]).collect();
            own.voltage_v = kept.iter().map(|k| own.voltage_v[*k]).collect();
            own.time_s = (0..kept.len()).map(|k| (1.3 * k as f64).round()).collect();
        },
        FindingKind::StampsRounded,
        "discharge_1",
    ),
    (
        "codes of 10 mV",
        |set| {
            for_all_records(set, |record| {
                for v in &mut record.series.voltage_v {
                    *v = (*v / 10e-3).round() * 10e-3;
                }
            });
        },
        FindingKind::Resolution,
        "pulse_0",
    ),
    (
        "records of a cell of another size",
        |set| {
            let model = model();
            for_all_records(set, |record| {
                let series = &mut record.series;
                let (mut soc, mut before_s) = (0.5, 0.0);
                for k in 0..series.len() {
                    if k > 0 {
                        soc -= (series.time_s[k] - before_s) * series.current_a[k - 1] / 16_200.0;
                    }
                    before_s = series.time_s[k];
                    let level_v = model.ocv.voltage_v(soc);
                    series.voltage_v[k] = level_v + 1.5 * (series.voltage_v[k] - level_v);
                }
            });
        },
        FindingKind::Scale,
        "pulse_0",
    ),
];

#[test]
fn clean_data_have_no_findings() {
    let effects = [
        Hidden::default(),
        Hidden {
            heat: true,
            ..Hidden::default()
        },
        Hidden {
            hysteresis_v: 8e-3,
            slow: Some((2e-3, 40.0)),
            ..Hidden::default()
        },
        Hidden {
            beta: 0.05,
            asymmetry: 0.1,
            ageing: 0.01,
            ..Hidden::default()
        },
    ];
    for (k, hidden) in effects.iter().enumerate() {
        for seed in 1..=5 {
            let found = look(&campaign(hidden, seed), &model());
            assert!(found.is_empty(), "effects {k}, seed {seed}: {found:#?}");
        }
    }
}

#[test]
fn each_damage_makes_its_finding_and_no_other() {
    for (name, damage, kind, run) in DAMAGES {
        let mut set = campaign(&Hidden::default(), 1);
        damage(&mut set);
        let found = look(&set, &model());
        let kinds: Vec<FindingKind> = found.iter().map(|finding| finding.kind).collect();
        assert_eq!(kinds, [*kind], "{name}: {found:#?}");
        assert_eq!(found[0].runs[0], *run, "{name}: {found:#?}");
    }
}

#[test]
fn a_model_of_another_cell_is_distinguished_from_records_of_another_cell() {
    let set = campaign(&Hidden::default(), 1);
    let mut other = model();
    other.erm.r_ohm *= 1.6;
    for branch in &mut other.erm.branches {
        branch.r_ohm *= 1.6;
        branch.c_f /= 1.6;
    }
    let found = look(&set, &other);
    assert!(
        found.len() == 1
            && found[0].kind == FindingKind::Scale
            && found[0].text.contains("it is a model of another cell"),
        "{found:#?}"
    );
}

#[test]
fn a_rest_that_is_off_by_little_is_the_physics_to_name() {
    let mut set = campaign(&Hidden::default(), 1);
    let own = series(&mut set, "discharge_1");
    own.voltage_v.iter_mut().for_each(|v| *v += 0.015);
    assert_eq!(look(&set, &model()), []);
}

#[test]
fn a_record_that_ends_a_sample_before_its_end_is_whole() {
    let time_s: Vec<f64> = (0..100).map(f64::from).collect();
    assert_eq!(Finding::ends_early("a", &time_s, 100.5), None);
    let found = Finding::ends_early("a", &time_s, 157.0).unwrap();
    assert_eq!(
        found.text,
        "a ends at 99 s, 58.000 s before its `to_s` of 157 s"
    );
}
