use super::menu::{Campaign, menu};
use super::open::Open;
use super::separate::{View, separation_chi2};
use super::{Advice, BenchLimits, Planned, PlannedRun, Playable, recommend};
use crate::{
    block::Workspace,
    data::{DataSet, Fixture, RunData},
    gate::tests::sim::{Hidden, campaign, model},
    guards::Guards,
    outcome::{Evidence, Verdict},
    prepare::{Prepared, prepare},
    problem::Fit,
    propose::propose,
    select::{RivalFit, SelectedEffect, Selection},
    structure::Structure,
};
use analysis_effects::effects::find;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Returns the charge that a sinusoid moves along the curve of the simulated cell, Ω.
fn storage(freq_hz: f64, z_ohm: Complex64) -> Complex64 {
    z_ohm + Complex64::new(0.0, -0.9 / (16_200.0 * TAU * freq_hz))
}

/// Returns the same with 100 nH more.
fn inductive(freq_hz: f64, z_ohm: Complex64) -> Complex64 {
    storage(freq_hz, z_ohm) + Complex64::new(0.0, TAU * freq_hz * 1e-7)
}

/// Returns the same with 10 nH more.
fn weakly_inductive(freq_hz: f64, z_ohm: Complex64) -> Complex64 {
    storage(freq_hz, z_ohm) + Complex64::new(0.0, TAU * freq_hz * 1e-8)
}

/// Runs of the cell alone.
fn cell_runs(spectrum: fn(f64, Complex64) -> Complex64) -> DataSet {
    let mut set = campaign(
        &Hidden {
            spectrum: Some(spectrum),
            ..Hidden::default()
        },
        3,
    );
    set.runs
        .retain(|run| matches!(run.fixture, Fixture::Cell(_)));
    set
}

fn prepared(set: &DataSet) -> Prepared {
    prepare(set, &model(), Guards::default()).unwrap()
}

/// Returns the base with one effect, fitted.
fn fitted(p: &Prepared, name: &str, workspace: &mut Workspace) -> Fit {
    let base = p
        .problem
        .fit(&Structure::default(), &model().erm, workspace);
    let predicted = p.problem.prediction(base.at(), workspace);
    let proposal = propose(
        &p.problem,
        &base,
        &predicted,
        &base.tangent(),
        find(name).unwrap(),
        workspace,
    )
    .remove(0);
    p.problem.fit(
        &base.structure.with(proposal.member),
        &model().erm,
        workspace,
    )
}

/// Returns the first effect named at this λ, the others as its rivals.
fn selected(p: &Prepared, lambda: f64, names: &[&'static str]) -> Selection {
    let mut workspace = Workspace::default();
    let base = p
        .problem
        .fit(&Structure::default(), &model().erm, &mut workspace);
    let rival = |name: &&'static str| RivalFit {
        name,
        score_gap: 0.0,
        discriminability: 0.0,
        fit: fitted(p, name, &mut Workspace::default()),
    };
    let evidence = Evidence {
        lambda,
        score: lambda,
        share_of_excess: 1.0,
        held_out_change: 0.0,
        integration_error: 0.0,
    };
    let selected = SelectedEffect {
        name: names[0],
        evidence,
        rivals: names[1..].iter().map(rival).collect(),
        limit_of: Vec::new(),
    };
    Selection {
        fit: fitted(p, names[0], &mut workspace),
        selected: vec![selected],
        ..Selection::nothing(&base)
    }
}

#[test]
fn an_inductance_is_distinguished_from_a_skew_by_a_shunt() {
    let p = prepared(&cell_runs(inductive));
    let selection = selected(&p, 1e3, &["inductance", "time_skew"]);
    let (next, runs) = recommend(&p, Verdict::Ambiguous, &selection, None, None)
        .next
        .unwrap();
    assert!(next.name.starts_with("shunt_sweep"), "{next:?}");
    let mut apart = next.separates.clone();
    apart.sort_unstable();
    assert_eq!(apart, ["inductance", "time_skew"]);
    assert!(
        next.separation_sigma > 40f64.sqrt()
            && next.separation_now_sigma < 0.5 * next.separation_sigma,
        "{next:?}"
    );
    assert!(next.charge_ah == 0.0 && next.duration_min > 2.0, "{next:?}");
    let after = cell_runs(storage)
        .runs
        .iter()
        .map(|run| run.order)
        .max()
        .unwrap()
        + 1;
    assert!(
        runs.iter()
            .all(|run| matches!(run.fixture, Fixture::Shunt(_)) && run.order == after),
        "{runs:?}"
    );
}

#[test]
fn what_cannot_be_played_is_not_recommended() {
    let p = prepared(&cell_runs(inductive));
    let selection = selected(&p, 1e3, &["inductance", "time_skew"]);
    let asked = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
    let seen = asked.clone();
    let playable: Playable = std::sync::Arc::new(move |name: &str, runs: &[PlannedRun]| {
        seen.lock().unwrap().push((name.to_owned(), runs.len()));
        !name.starts_with("shunt")
    });
    let next = recommend(&p, Verdict::Ambiguous, &selection, None, Some(&playable)).next;
    assert!(next.is_none_or(|(next, _)| !next.name.starts_with("shunt")));
    assert!(
        asked
            .lock()
            .unwrap()
            .contains(&("shunt_sweep".to_owned(), 1))
    );
    // Of one shunt only that one can be swept.
    let limits = BenchLimits {
        discharge_a: 18.0,
        charge_a: 12.0,
        highest_hz: 1000.0,
        shunt_ohm: Some(9.96e-3),
    };
    let items = menu(&Campaign::new(&p.problem, Some(limits)));
    let shunts: Vec<&Fixture> = items
        .iter()
        .flat_map(|i| &i.runs)
        .map(|r| &r.fixture)
        .filter(|f| matches!(f, Fixture::Shunt(_)))
        .collect();
    assert_eq!(shunts, [&Fixture::Shunt(9.96e-3)]);
}

#[test]
fn what_is_too_weak_to_be_certain_is_to_be_seen_better() {
    let p = prepared(&cell_runs(weakly_inductive));
    let selection = selected(&p, 60.0, &["inductance"]);
    let (next, _) = recommend(&p, Verdict::Ambiguous, &selection, None, None)
        .next
        .unwrap();
    assert_eq!(next.separates, ["inductance"]);
    assert!(
        next.separation_sigma > next.separation_now_sigma,
        "{next:?}"
    );
}

#[test]
fn what_is_settled_needs_no_experiment() {
    let p = prepared(&cell_runs(storage));
    let base = p.problem.fit(
        &Structure::default(),
        &model().erm,
        &mut Workspace::default(),
    );
    let nothing = Selection::nothing(&base);
    for verdict in [Verdict::AtNoiseFloor, Verdict::Explained, Verdict::Invalid] {
        assert!(
            recommend(&p, verdict, &nothing, None, None).next.is_none(),
            "{verdict:?}"
        );
    }
    let (next, runs) = recommend(&p, Verdict::Unexplained, &nothing, None, None)
        .next
        .unwrap();
    assert_eq!(
        (next.name, runs[0].repeat_group.as_str(), runs.len()),
        ("sentinel_repeat", "eis", 1)
    );
    assert!(
        next.description.contains("run eis_0 once more"),
        "{}",
        next.description
    );
}

#[test]
fn a_structure_does_not_differ_from_itself_and_more_data_never_bring_it_nearer() {
    let p = prepared(&cell_runs(inductive));
    let mut workspace = Workspace::default();
    let (skew, slow) = (
        fitted(&p, "time_skew", &mut workspace),
        fitted(&p, "rc_slow", &mut workspace),
    );
    let items = menu(&Campaign::new(&p.problem, None));
    let zero = items.iter().find(|i| i.name == "shunt_sweep").unwrap();
    let planned = p.planned(&zero.runs, &mut workspace).unwrap();
    let mut between = |a: &Fit, b: &Fit, with: bool, steps: usize| {
        let planned = with.then_some(&planned);
        let (shown, view) = (
            View::new(a, planned, &mut workspace),
            View::new(b, planned, &mut workspace),
        );
        separation_chi2(&shown, &view, planned, steps, &mut workspace)
    };
    assert!(between(&skew, &skew, true, 3) < 1e-6);
    let (now, then) = (
        between(&skew, &slow, false, 3),
        between(&skew, &slow, true, 3),
    );
    assert!(now > 0.0 && then >= 0.999 * now, "{now} {then}");
    let linear = between(&skew, &slow, true, 1);
    assert!((linear / then).ln().abs() < 0.5, "{linear} {then}");
}

/// A refit to noise-free data of the truth, planned runs among them, agrees with the linear one.
#[test]
fn the_expected_separation_is_what_a_full_refit_leaves() {
    let p = prepared(&cell_runs(inductive));
    let mut workspace = Workspace::default();
    let (truth, other) = (
        fitted(&p, "inductance", &mut workspace),
        fitted(&p, "time_skew", &mut workspace),
    );
    let items = menu(&Campaign::new(&p.problem, None));
    let planned = p
        .planned(
            &items.iter().find(|i| i.name == "shunt_sweep").unwrap().runs,
            &mut workspace,
        )
        .unwrap();
    let (shown, view) = (
        View::new(&truth, Some(&planned), &mut workspace),
        View::new(&other, Some(&planned), &mut workspace),
    );
    let expected = separation_chi2(&shown, &view, Some(&planned), 3, &mut workspace);
    let mut whole = prepared(&cell_runs(inductive)).problem;
    whole.blocks.extend(planned.blocks);
    whole.whiteners.extend(planned.whiteners);
    for k in 0..whole.blocks.len() {
        whole.blocks[k].measured = whole.predict(truth.at(), k, 1, &mut workspace);
    }
    let full = whole
        .fit_from(
            &other.structure,
            other.x.clone(),
            other.axes.clone(),
            &mut workspace,
        )
        .chi2;
    assert!(
        (expected / full).ln().abs() < 0.25 && full > 40.0,
        "{expected} {full}"
    );
}

#[test]
fn the_menu_keeps_to_limits_and_range() {
    let p = prepared(&cell_runs(storage));
    let own = Campaign::new(&p.problem, None);
    let names: Vec<&str> = menu(&own).iter().map(|item| item.name).collect();
    assert_eq!(
        names,
        [
            "shunt_sweep",
            "shunt_sweep_small",
            "eis_lower_soc",
            "eis_higher_soc",
            "eis_other_temperature",
            "eis_larger_amplitude",
            "eis_under_discharge",
            "eis_under_charge",
            "eis_low_frequency",
            "eis_low_frequency",
            "eis_low_frequency",
            "zero_current_log",
            "mirrored_charge",
            "mirrored_charge",
            "mirrored_charge",
            "zero_net_charge_bursts",
            "long_pulse",
            "slow_pulse",
            "square_waves",
            "minor_loops",
            "equal_charge_pulses",
            "range_walk",
            "range_walk",
            "range_walk",
            "sentinel_repeat",
        ]
    );
    let further = Campaign::new(
        &p.problem,
        Some(BenchLimits {
            discharge_a: 100.0,
            charge_a: 40.0,
            highest_hz: 3000.0,
            shunt_ohm: None,
        }),
    );
    assert_eq!(menu(&further)[0].name, "eis_high_frequency");
    for (discharge_a, charge_a) in [
        (100.0, 40.0),
        (18.0, 13.0),
        (5.0, 20.0),
        (10.0, 0.0),
        (0.0, 0.0),
    ] {
        let campaign = Campaign::new(
            &p.problem,
            Some(BenchLimits {
                discharge_a,
                charge_a,
                highest_hz: 3000.0,
                shunt_ohm: None,
            }),
        );
        for item in menu(&campaign) {
            assert!(
                item.duration_min().is_finite() && item.duration_min() > 2.0,
                "{item:?}"
            );
            for run in &item.runs {
                if let Planned::Eis {
                    freq_hz,
                    amplitude_a,
                    bias_a,
                } = &run.what
                    && *bias_a != 0.0
                {
                    assert!(
                        amplitude_a + bias_a <= discharge_a && amplitude_a - bias_a <= charge_a,
                        "{} within {discharge_a} A and {charge_a} A",
                        item.name
                    );
                    // The charge is moved twice: under the sweep, and back.
                    let sweep_s = 0.5 * run.what.span_s();
                    let moved = run.what.charge_coulomb() - 2.0 * bias_a.abs() * sweep_s;
                    assert!(
                        moved.abs() < 1e-6 && sweep_s > 4.0 / freq_hz[0],
                        "{moved} C"
                    );
                }
                let Planned::Trace(segments) = &run.what else {
                    continue;
                };
                let (low, high) = segments
                    .iter()
                    .fold((0.0f64, 0.0f64), |(l, h), s| (l.min(s.1), h.max(s.1)));
                assert!(
                    high <= discharge_a + 1e-9 && -low <= charge_a + 1e-9,
                    "{} within {discharge_a} A and {charge_a} A",
                    item.name
                );
                assert!(segments.iter().all(|s| s.0 > 0.0));
                let moved: f64 = segments.iter().map(|s| s.0 * s.1).sum();
                assert!(
                    item.name != "zero_net_charge_bursts" || moved.abs() < 1e-6,
                    "{moved} C"
                );
            }
        }
    }
}

#[test]
fn a_planned_run_counts_its_repeats_and_samples_densely_after_edges() {
    let run = PlannedRun {
        name: "r".to_owned(),
        fixture: Fixture::Cell("cell".to_owned()),
        soc: 0.5,
        temperature_degc: 25.0,
        repeat: 3,
        repeat_group: "r".to_owned(),
        order: 7,
        settle_s: 900.0,
        start_s: 1000.0,
        what: Planned::Trace(vec![(2.0, 0.0), (60.0, 5.0), (30.0, -10.0)]),
    };
    // 900 + 92 and twice 600 + 92.
    assert!(
        (run.duration_s() - 2376.0).abs() < 1e-9 && (run.repeat_start_s(2) - 2384.0).abs() < 1e-9
    );
    assert!((run.what.charge_coulomb() - 600.0).abs() < 1e-9);
    let RunData::Time(record) = run
        .unmeasured(analysis_effects::augmented::Between::Hold, None)
        .data
    else {
        panic!("a record")
    };
    let s = record.series;
    assert!(s.validate().is_ok() && s.time_s[s.len() - 1] == 92.0);
    let from = s.time_s.partition_point(|t| *t < 2.0);
    assert!(
        s.current_a[from] == 5.0
            && s.current_a[from - 1] == 0.0
            && (s.time_s[from + 1] - 2.01).abs() < 1e-9
    );
    let widest = s.time_s.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
    assert!(widest > 1.0 && widest <= 5.0, "{widest}");
}

#[test]
fn nothing_refused_and_nothing_named_leaves_nothing_open() {
    let p = prepared(&cell_runs(storage));
    let base = p.problem.fit(
        &Structure::default(),
        &model().erm,
        &mut Workspace::default(),
    );
    for verdict in [Verdict::Ambiguous, Verdict::Unexplained] {
        assert!(
            Open::new(
                true,
                verdict,
                &[],
                &Selection::nothing(&base),
                &mut Workspace::default()
            )
            .pairs
            .is_empty()
        );
    }
}

#[test]
fn a_second_run_comes_after_all_repeats_of_the_first_and_only_one_is_a_sweep() {
    let p = prepared(&cell_runs(storage));
    let items = menu(&Campaign::new(&p.problem, None));
    let item = |name: &str| items.iter().find(|i| i.name == name).unwrap();
    let (loops, log, shunt) = (
        item("minor_loops"),
        item("zero_current_log"),
        item("shunt_sweep"),
    );
    let both = loops.times(2).and(log);
    let [first, second] = both.runs.as_slice() else {
        panic!("two runs")
    };
    assert_eq!((first.repeat, second.order), (6, first.order + 6));
    assert!((second.start_s - first.start_s - first.duration_s()).abs() < 1e-6);
    assert!(
        (both.duration_min() - loops.times(2).duration_min() - log.duration_min()).abs() < 1e-9
    );
    assert!(loops.joins(log) && loops.joins(shunt));
    for (one, other) in [
        (shunt, item("eis_larger_amplitude")),
        (loops, loops),
        (loops, item("eis_lower_soc")),
    ] {
        assert!(!one.joins(other), "{} and {}", one.name, other.name);
    }
}

#[test]
fn what_no_run_brings_forward_is_named_and_does_not_count() {
    let p = prepared(&cell_runs(inductive));
    let selection = selected(&p, 1e3, &["inductance", "time_skew", "rc_slow"]);
    let mut open = Open::new(
        true,
        Verdict::Ambiguous,
        &[None],
        &selection,
        &mut Workspace::default(),
    );
    let more = |by: f64| open.now.iter().map(|l| l + by).collect::<Vec<f64>>();
    // A lead of 14 in all but one of twenty cases, of an effect that may be weaker, needs 36.5:
    // eight times five.
    let (now, some, mut then) = (open.now.clone(), more(5.0), more(1e4));
    assert_eq!(
        (open.times(&now, &some, 16), open.times(&now, &then, 16)),
        (8, 1)
    );
    (then[0], then[1]) = (now[0], now[1]);
    assert_eq!(open.least(&then), 0.0);
    assert_eq!(
        open.leave_out(&[then.as_slice()], 16),
        [["inductance", "time_skew"]]
    );
    assert!(open.least(&then) >= 1.0 && !open.all_settled(&then));
}

#[test]
fn what_no_run_tells_is_said_with_what_would() {
    let inseparable = vec![["current_gain", "voltage_gain"], ["inductance", ""]];
    let notes = Advice {
        next: None,
        inseparable,
    }
    .notes();
    assert_eq!(
        notes,
        [
            "no run of the menu, however often it is repeated, separates gain error of the current \
            channel from gain error of the voltage channel; required: the same shunt through both \
            instruments",
            "series inductance: its signal is too small for any run of the menu to make it certain",
        ]
    );
}
