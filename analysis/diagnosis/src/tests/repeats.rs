//! Errors that repeated runs share, and errors that they do not share.

use super::bench::{Hidden, campaign, model};
use crate::{
    block::{Block, Kind, Workspace},
    data::{DataSet, Fixture, Role, Run, RunData, Start, Sweep, SweepPoint, TimeRecord},
    diagnose::base_fit,
    guards::Guards,
    prepare::{Prepared, prepare},
    problem::Problem,
    propose::direction,
    structure::variants,
    whitening::dot,
};
use analysis_effects::{
    augmented::Between,
    contract::{CommonModeImpedance, Moved},
    effects::find,
};
use analysis_signal::history::BenchHistory;
use analysis_signal::series::TimeSeries;
use num_complex::Complex64;

fn prepared(set: &DataSet) -> Prepared {
    prepare(set, &model(), Guards::default()).unwrap()
}

/// Returns the same without anything shared.
fn each_by_itself(problem: &Problem) -> Problem {
    let mut each = problem.clone();
    each.blocks.iter_mut().for_each(|b| b.alike = None);
    each
}

/// Part of a vector that another one differs by.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    let difference: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    (dot(&difference, &difference) / dot(b, b)).sqrt()
}

#[test]
fn repeats_share_derivatives_and_what_tells_them_apart_does_not() {
    let p = prepared(&campaign(5, &Hidden::default(), &Hidden::default()));
    let (problem, each) = (&p.problem, each_by_itself(&p.problem));
    let shared = problem
        .of_role(Role::Train)
        .filter(|k| problem.blocks[*k].alike.is_some())
        .count();
    assert_eq!(
        shared, 4,
        "two of three pulses and two of three long discharges"
    );
    let mut workspace = Workspace::default();
    let fit = base_fit(problem, &model().erm, &mut workspace);
    let predicted = problem.prediction(fit.at(), &mut workspace);
    let mut columns =
        |problem: &Problem| problem.columns(fit.at(), &fit.axes, &predicted, &mut workspace);
    let (near, exact) = (columns(problem), columns(&each));
    // Repeats are driven by currents that differ by a part in a thousand.
    assert!(
        near.iter()
            .zip(&exact)
            .all(|(n, e)| apart(n, e) < 5e-3 && n != e)
    );
    for (name, same) in [("ageing", true), ("rc_slow", false)] {
        let member = variants(find(name).unwrap(), &problem.base).remove(0);
        let structure = fit.structure.with(member);
        let mut of = |problem: &Problem| {
            direction(problem, &fit, &predicted, &structure, 0.3, &mut workspace).unwrap()
        };
        assert_eq!(of(problem) == of(&each), same, "{name}");
    }
}

#[test]
fn a_repeat_from_elsewhere_has_derivatives_of_its_own() {
    let mut set = campaign(5, &Hidden::default(), &Hidden::default());
    let second = set
        .runs
        .iter_mut()
        .filter(|run| run.repeat_group == "long")
        .nth(1)
        .unwrap();
    second.start = Start::Soc(0.503);
    let p = prepared(&set);
    let alike: Vec<bool> = p
        .problem
        .blocks
        .iter()
        .filter(|b| b.group == "long")
        .map(|b| b.alike.is_some())
        .collect();
    assert_eq!(alike, [false, false, true]);
}

/// Returns a record of a current (A, discharge positive) sampled each second.
fn run(current_a: Vec<f64>, order: u32, soc: f64) -> Run {
    let time_s: Vec<f64> = (0..current_a.len()).map(|k| k as f64).collect();
    let series = TimeSeries {
        name: "s".to_owned(),
        voltage_v: vec![3.7; time_s.len()],
        time_s,
        current_a,
        temperature_degc: None,
    };
    let (between, compared_from_s, level_sigma_v) = (Between::Hold, 0.0, 0.0);
    Run {
        name: format!("s_{order}"),
        fixture: Fixture::Cell("a".to_owned()),
        role: Role::Train,
        repeat_group: "s".to_owned(),
        order,
        start_s: 1e4 * f64::from(order),
        temperature_degc: 25.0,
        start: Start::Soc(soc),
        data: RunData::Time(TimeRecord {
            series,
            between,
            compared_from_s,
            level_sigma_v,
            sigma_v: None,
            averaged_s: None,
            current_errors_a: Vec::new(),
        }),
    }
}

/// ±0.1 A on top, as codes that toggle.
fn toggling(amps: f64, count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |k| amps + if k % 7 == 3 { 0.1 } else { 0.0 })
}

#[test]
fn charge_is_reported_in_stretches_without_a_reversal() {
    let swing = |out: usize, back: usize| {
        toggling(5.0, out)
            .chain(toggling(0.0, 50))
            .chain(toggling(-5.0, back))
            .chain([0.0])
            .collect::<Vec<f64>>()
    };
    // 100 C out and 60 C in; then the cell was charged by a tenth of its 16200 C; then the same
    // once more.
    let down = 0.5 - 40.0 / 16_200.0;
    let set = DataSet {
        name: "t".to_owned(),
        runs: vec![
            run(swing(20, 12), 0, 0.5),
            run(swing(20, 12), 1, down + 0.1),
            run(swing(20, 12), 2, down + 0.1),
        ],
        history: None,
        calibration: None,
    };
    let p = prepared(&set);
    let of = |k: usize| p.problem.blocks[k].before.clone();
    let near = |met: &[Moved], expected: &[f64]| {
        met.len() == expected.len()
            && met.iter().zip(expected).all(|(m, e)| {
                (m.charge_coulomb - e).abs() < 3.0 && m.through_coulomb == m.charge_coulomb.abs()
            })
    };
    assert!(near(&of(0), &[0.0]), "{:?}", of(0));
    assert!(near(&of(1), &[-100.0, 60.0 + 1620.0]), "{:?}", of(1));
    // A difference of the start's state of charge below a hundredth is not charge: the state was
    // read from a voltage.
    assert!(near(&of(2), &[-100.0, 1680.0, -100.0, 60.0]), "{:?}", of(2));
}

/// Returns the charge moved by a sweep of 2 A, from frequencies with the times of their points,
/// after a rest without records.
fn swung(visited: &[(f64, f64)]) -> Vec<Moved> {
    let point = |freq_hz: f64| SweepPoint {
        freq_hz,
        z_ohm: Complex64::new(0.01, 0.0),
        sigma_ohm: None,
        amplitude_a: Some(2.0),
    };
    let sweep = Sweep {
        bias_a: 0.0,
        common_mode: CommonModeImpedance::default(),
        elapsed_s: visited.iter().map(|v| 1000.0 + v.1).collect(),
        charge_coulomb: Vec::new(),
        harmonics: Vec::new(),
        points: visited.iter().map(|v| point(v.0)).collect(),
    };
    let swept = Run {
        data: RunData::Eis(sweep),
        ..run(vec![0.0, 0.0], 1, 0.5)
    };
    let out: Vec<f64> = toggling(5.0, 20).chain(toggling(0.0, 5)).collect();
    let runs = vec![
        run(out, 0, 0.5),
        swept,
        run(vec![5.0; 20], 2, 0.5),
        run(vec![0.0, 0.0], 3, 0.5),
    ];
    prepared(&DataSet {
        name: "t".to_owned(),
        runs,
        history: None,
        calibration: None,
    })
    .problem
    .blocks[3]
        .before
        .clone()
}

#[test]
fn a_sweep_moves_charge_to_and_fro() {
    let met = swung(&[(0.1, 3840.0), (1.0, 160.0), (10.0, 80.0), (100.0, 0.0)]);
    // 80 s from point to point and as long for the first; an interval that is an hour longer, and
    // its half after the last point, count as no more than that.
    let through_coulomb = 2.0 * std::f64::consts::FRAC_2_PI * (80.0 + 80.0 + 80.0 + 80.0 + 40.0);
    let expected = [
        Moved::one_way(-100.0),
        Moved {
            charge_coulomb: 0.0,
            through_coulomb,
        },
        Moved::one_way(-95.0),
    ];
    assert_eq!(met.len(), 3, "{met:?}");
    for (met, expected) in met.iter().zip(expected) {
        assert!(
            (met.charge_coulomb - expected.charge_coulomb).abs() < 3.0
                && (met.through_coulomb - expected.through_coulomb).abs() < 3.0,
            "{met:?} {expected:?}"
        );
    }
}

/// A point of 11 periods takes minutes at 0.1 Hz and a second at 300 Hz: all of it flowed.
#[test]
fn slow_points_of_a_sweep_are_no_break() {
    let lasts_s = |freq_hz: f64| 3.0 + 11.0 / freq_hz;
    let (mut visited, mut at_s) = (Vec::new(), 0.0);
    for k in 0..20 {
        let freq_hz = 300.0 * (1.0f64 / 3000.0).powf(f64::from(k) / 19.0);
        visited.push((freq_hz, at_s + 0.5 * lasts_s(freq_hz)));
        at_s += lasts_s(freq_hz);
    }
    let met = swung(&visited)[1].through_coulomb / (2.0 * std::f64::consts::FRAC_2_PI);
    // How long the slowest one lasted after its middle is taken from the point before it.
    assert!((met / at_s - 1.0).abs() < 0.05, "{met} s of {at_s} s");
}

#[test]
fn noise_of_a_small_current_is_not_an_edge() {
    let current_a: Vec<f64> = toggling(0.0, 20)
        .chain(toggling(3.0, 100))
        .chain(toggling(0.0, 40))
        .collect();
    let edges = |jitter_a: f64| {
        let base = prepared(&campaign(5, &Hidden::default(), &Hidden::default()))
            .problem
            .base;
        let block = Block::new(&run(current_a.clone(), 0, 0.5), &base, jitter_a).unwrap();
        let Kind::Time(time) = block.kind else {
            panic!("a record")
        };
        time.edges
    };
    let history = BenchHistory {
        current_noise_a: 0.03,
        current_resolution_a: 0.1,
        ..super::bench::HISTORY
    };
    assert_eq!(
        edges(crate::noise::current_jitter_a(&history)),
        [0, 20, 120]
    );
    assert!(edges(0.0).len() > 20);
}
