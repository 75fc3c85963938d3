//! Propagation of white noise of the logged current.

use super::bench::{BRANCHES, CAPACITY_AH, Chance, HISTORY, Hidden, R0, campaign, model};
use crate::{
    DiagnosisOptions, Verdict,
    block::{Block, Kind},
    current_noise_propagation,
    data::{DataSet, RunData},
    diagnose::diagnose_with,
    guards::Guards,
    prepare::prepare,
    time_block::TimeBlock,
};
use analysis_signal::history::BenchHistory;
use analysis_signal::series::TimeSeries;

/// A long discharge of a campaign.
fn long(set: &DataSet, with: impl FnOnce(&Block, &TimeBlock)) {
    let p = prepare(set, &model(), Guards::default()).unwrap();
    let k = p
        .problem
        .blocks
        .iter()
        .position(|b| b.group == "long")
        .unwrap();
    let Kind::Time(time) = &p.problem.blocks[k].kind else {
        panic!("a record")
    };
    with(&p.problem.blocks[k], time);
}

/// Against 4000 draws of the noise through the branches and the charge, sample by sample.
#[test]
fn what_follows_noise_of_the_current_has_the_covariance_of_many_draws() {
    const DRAWS: usize = 4000;
    let (set, sigma_a) = (campaign(5, &Hidden::default(), &Hidden::default()), 0.3);
    long(&set, |block, time| {
        let mut base = prepare(&set, &model(), Guards::default())
            .unwrap()
            .problem
            .base;
        // Slow enough for many samples within the time constant, fast enough for none.
        base.erm.branches[1].c_f = 40.0 / base.erm.branches[1].r_ohm;
        let taus_s = [BRANCHES[0].1, 40.0];
        let met =
            current_noise_propagation::covariance(time, block.at.soc, &base, sigma_a * sigma_a);
        let n = time.bins.len();
        let per_coulomb: Vec<f64> = time
            .bins
            .iter()
            .map(|b| {
                base.ocv
                    .slope_v(block.at.soc - b.charge_coulomb / (3600.0 * CAPACITY_AH))
                    / (3600.0 * CAPACITY_AH)
            })
            .collect();
        let mut chance = Chance::new(3);
        let mut sums = vec![0.0; n * n];
        for _ in 0..DRAWS {
            let noise: Vec<f64> = time
                .time_s
                .iter()
                .map(|_| sigma_a * chance.normal())
                .collect();
            let (mut v, mut charge_coulomb, mut at) = ([0.0; 2], 0.0, vec![[0.0; 2]; noise.len()]);
            for k in 0..noise.len() {
                if k > 0 {
                    let step_s = time.time_s[k] - time.time_s[k - 1];
                    for (v, (branch, tau_s)) in
                        v.iter_mut().zip(base.erm.branches.iter().zip(taus_s))
                    {
                        let settled_v = branch.r_ohm * noise[k - 1];
                        *v = settled_v + (*v - settled_v) * (-step_s / tau_s).exp();
                    }
                    charge_coulomb += noise[k - 1] * step_s;
                }
                at[k] = [R0 * noise[k] + v[0] + v[1], charge_coulomb];
            }
            let mean = |b: &crate::time_block::Bin, part: usize| {
                at[b.from..b.to].iter().map(|v| v[part]).sum::<f64>() / (b.to - b.from) as f64
            };
            let rows: Vec<f64> = time
                .bins
                .iter()
                .zip(&per_coulomb)
                .map(|(b, u)| mean(b, 0) + u * mean(b, 1))
                .collect();
            (0..n * n).for_each(|ij| sums[ij] += rows[ij / n] * rows[ij % n] / DRAWS as f64);
        }
        // The immediate drop of the samples is in another term.
        (0..n).for_each(|i| {
            sums[i * n + i] -=
                (sigma_a * R0).powi(2) / (time.bins[i].to - time.bins[i].from) as f64;
        });
        let size = |i: usize| {
            (met[i * n + i].max(0.0)
                + (sigma_a * R0).powi(2) / (time.bins[i].to - time.bins[i].from) as f64)
                .sqrt()
        };
        let worst = (0..n * n)
            .map(|ij| (met[ij] - sums[ij]).abs() / (size(ij / n) * size(ij % n)))
            .fold(0.0, f64::max);
        let greatest = (0..n * n)
            .filter(|ij| ij / n != ij % n)
            .map(|ij| met[ij] / (size(ij / n) * size(ij % n)))
            .fold(0.0, f64::max);
        // A correlation from this many draws is known to 1/√4000 = 0.016.
        assert!(worst < 0.09 && greatest > 0.6, "{worst} of {greatest}");
    });
}

/// Noise of the logged current is in the derivative by a resistance and in the residual as well.
/// Without a correction, rests would show a resistance of zero.
#[test]
fn noise_of_the_current_says_nothing_of_a_resistance() {
    let sigma_a = 0.3;
    let mut set = campaign(5, &Hidden::default(), &Hidden::default());
    for seed in 6..14 {
        set.runs.extend(
            campaign(seed, &Hidden::default(), &Hidden::default())
                .runs
                .into_iter()
                .filter(|run| run.repeat_group == "long"),
        );
    }
    let mut chance = Chance::new(9);
    for (order, run) in set.runs.iter_mut().enumerate() {
        run.order = order as u32;
        if let RunData::Time(record) = &mut run.data {
            record
                .series
                .current_a
                .iter_mut()
                .for_each(|i| *i += sigma_a * chance.normal());
        }
    }
    set.history = Some(BenchHistory {
        current_noise_a: sigma_a,
        ..HISTORY
    });
    let d = diagnose_with(
        &set,
        &model(),
        &DiagnosisOptions::default(),
        Guards::default(),
    )
    .unwrap()
    .diagnosis;
    assert_eq!(
        d.verdict,
        Verdict::AtNoiseFloor,
        "{} {:?} {:?} {:?} {:?}",
        d.summary,
        d.notes,
        d.quality,
        d.noise,
        d.where_after.iter().take(5).collect::<Vec<_>>()
    );
}

/// Whether a rest of 100 s and a current after it count as currents that stay.
fn stays(
    logged: impl Fn(usize, &mut Chance) -> f64,
    history: BenchHistory,
    chance: &mut Chance,
) -> bool {
    let mut set = campaign(5, &Hidden::default(), &Hidden::default());
    let RunData::Time(record) = &mut set.runs[1].data else {
        panic!("a record")
    };
    record.series = TimeSeries {
        name: "s".to_owned(),
        time_s: (0..400).map(f64::from).collect(),
        voltage_v: vec![3.7; 400],
        current_a: (0..400).map(|k| logged(k, chance)).collect(),
        temperature_degc: None,
    };
    set.history = Some(history);
    let p = prepare(&set, &model(), Guards::default()).unwrap();
    let block = p
        .problem
        .blocks
        .iter()
        .find(|b| b.name == set.runs[1].name)
        .unwrap();
    let Kind::Time(time) = &block.kind else {
        panic!("a record")
    };
    let under = &time.bins[time.bins.len() - 3..];
    under
        .iter()
        .all(|bin| (bin.current_a - under[0].current_a).abs() < 1e-9)
}

/// A supply that settles by less than the noise within a second has no noise: its current stays as
/// it was logged.
#[test]
fn a_current_that_settles_is_not_noise() {
    let (mut chance, sigma_a) = (Chance::new(4), 0.05);
    let history = BenchHistory {
        current_noise_a: sigma_a,
        ..HISTORY
    };
    let settling = |settling_a: f64| {
        move |k: usize, chance: &mut Chance| {
            let driven_a = if k < 100 {
                0.0
            } else {
                5.0 + settling_a * (-(k as f64 - 100.0) / 60.0).exp()
            };
            driven_a + sigma_a * chance.normal()
        }
    };
    assert!(
        stays(settling(0.0), history, &mut chance) && !stays(settling(0.1), history, &mut chance)
    );
}

/// At the border of two codes a current that stays jumps between them more than codes do on
/// average.
#[test]
fn a_current_between_two_codes_stays() {
    let (mut chance, step_a) = (Chance::new(5), 0.1);
    let history = BenchHistory {
        current_noise_a: 0.01,
        current_resolution_a: step_a,
        ..HISTORY
    };
    let logged = |k: usize, chance: &mut Chance| {
        let flows_a = if k < 100 { 0.0 } else { 50.5 * step_a };
        ((flows_a + 0.01 * chance.normal()) / step_a).round() * step_a
    };
    assert!(stays(logged, history, &mut chance));
}
