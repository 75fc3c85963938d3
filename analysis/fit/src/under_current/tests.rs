//! Comparisons of simulated sweeps whose change is known.

use analysis_model::model::{Erm, RcBranch};
use analysis_numeric::{Covariance2, Rng};
use analysis_signal::spectrum::{ImpedancePoint, Origin, SourcedSpectrum, Spectrum};
use num_complex::Complex64;

use super::*;

const CELLS: usize = 6;
const REPEATS: usize = 4;
const NOISE: f64 = 0.002;

fn cell(rng: &mut Rng) -> Erm {
    let mut about = |value: f64| value * (1.0 + 0.01 * rng.normal());
    let mut branch = |r_ohm: f64, c_f: f64| RcBranch {
        r_ohm: about(r_ohm),
        c_f,
    };
    let branches = vec![branch(2e-3, 1.0), branch(3e-3, 500.0)];
    Erm {
        r_ohm: about(7e-3),
        branches,
    }
}

/// A sweep from 0.1 Hz to 300 Hz. Each impedance passes through `change`.
fn sweep(
    rng: &mut Rng,
    erm: &Erm,
    origin: Origin,
    change: impl Fn(f64, Complex64) -> Complex64,
) -> SourcedSpectrum {
    let mut point = |k: i32| {
        let freq_hz = 0.1 * 3000_f64.powf(f64::from(k) / 19.0);
        let z = change(freq_hz, erm.impedance(freq_hz));
        let noise = Complex64::new(rng.normal(), rng.normal()) * NOISE * z.norm();
        ImpedancePoint {
            freq_hz,
            z_ohm: z + noise,
            covariance: Covariance2::UNKNOWN,
            amplitude_a: 1.0,
        }
    };
    SourcedSpectrum {
        spectrum: Spectrum::new("sweep".to_owned(), (0..20).map(&mut point).collect()),
        origin,
        flagged: Vec::new(),
    }
}

fn of_cell(cell: usize) -> Origin {
    Origin {
        cell: Some(cell.to_string()),
        ..Origin::default()
    }
}

fn under(bias_a: f64, cell: Option<usize>) -> Origin {
    Origin {
        bias_a: Some(bias_a),
        cell: cell.map(|cell| cell.to_string()),
        ..Origin::default()
    }
}

/// Cells at rest, and their sweeps.
fn at_rest(rng: &mut Rng) -> (Vec<Erm>, Vec<SourcedSpectrum>) {
    let cells: Vec<Erm> = (0..CELLS).map(|_| cell(rng)).collect();
    let mut sweeps = Vec::new();
    for (index, erm) in cells.iter().enumerate() {
        sweeps.extend((0..REPEATS).map(|_| sweep(rng, erm, of_cell(index), |_, z| z)));
    }
    (cells, sweeps)
}

fn two() -> UnderCurrentOptions {
    UnderCurrentOptions {
        rc: Some(2),
        ..UnderCurrentOptions::default()
    }
}

/// The same cell with another resistance of its first branch; its capacitance stays.
fn changed(erm: &Erm, factor: f64) -> Erm {
    let mut erm = erm.clone();
    erm.branches[0].r_ohm *= factor;
    erm
}

#[test]
fn one_branch_that_falls_is_named_and_the_others_are_not() {
    let (mut named, mut others, mut within, mut flagged) = (0, 0, 0, 0);
    for seed in 0..100 {
        let mut rng = Rng::new(seed);
        let (cells, rest) = at_rest(&mut rng);
        let biased = sweep(
            &mut rng,
            &changed(&cells[3], 0.9),
            under(2.0, None),
            |_, z| z,
        );
        let found = under_current(&rest, &[biased], &two()).unwrap();
        let change = &found.changes[0];
        assert_eq!(change.compared, Compared::AllCells { cells: CELLS });
        let [series, arc, slow] = change.branches.as_slice() else {
            panic!("{:?}", change.branches)
        };
        named += usize::from(arc.is_certain());
        others += usize::from(series.is_certain() || slow.is_certain());
        within += usize::from((arc.share - 0.9_f64.ln()).abs() < 2.6 * arc.sigma);
        flagged += usize::from(!change.flagged.is_empty());
    }
    assert!(named >= 90, "the branch was named in {named} of 100");
    assert!(others <= 5, "another branch was named in {others} of 100");
    assert!(
        within >= 93,
        "the change lies within its 95 % interval in {within} of 100"
    );
    assert!(
        flagged <= 2,
        "points were called a trend in {flagged} of 100"
    );
}

#[test]
fn a_sweep_of_a_cell_that_was_measured_at_rest_is_compared_with_that_cell() {
    let mut rng = Rng::new(1);
    let (cells, rest) = at_rest(&mut rng);
    let small = sweep(
        &mut rng,
        &changed(&cells[2], 0.98),
        under(2.0, Some(2)),
        |_, z| z,
    );
    let found = under_current(&rest, &[small], &two()).unwrap();
    let change = &found.changes[0];
    assert_eq!(
        change.compared,
        Compared::OwnCell {
            cell: "cell 2".to_owned()
        }
    );
    let arc = &change.branches[1];
    assert!(
        arc.is_certain() && (arc.share + 0.02).abs() < 3.0 * arc.sigma,
        "{arc:?}"
    );
    assert_eq!(arc.freedom, CELLS * (REPEATS - 1));
}

#[test]
fn a_drift_of_the_record_is_a_trend_and_no_branch() {
    let (mut trends, mut named) = (0, 0);
    for seed in 0..40 {
        let mut rng = Rng::new(seed);
        let (cells, rest) = at_rest(&mut rng);
        // What a linear drift leaves in a fit without one: inversely proportional to the frequency.
        let drift = |f: f64, z: Complex64| z + Complex64::from_polar(1.2e-4 / f, 0.7);
        let biased = sweep(&mut rng, &cells[0], under(5.0, None), drift);
        let found = under_current(&rest, &[biased], &two()).unwrap();
        let change = &found.changes[0];
        let lowest = change
            .flagged
            .first()
            .map_or(f64::NAN, |point| point.freq_hz);
        trends += usize::from((lowest - 0.1).abs() < 1e-9);
        named += usize::from(change.branches.iter().any(BranchChange::is_certain));
        assert!(
            change.flagged.iter().all(|p| p.freq_hz < 3.0),
            "{:?}",
            change.flagged
        );
    }
    assert!(trends >= 38, "the trend was found in {trends} of 40");
    assert!(named <= 2, "a branch was named in {named} of 40");
}

#[test]
fn sweeps_of_one_cell_are_compared_with_each_other_on_request() {
    let mut rng = Rng::new(5);
    let (cells, rest) = at_rest(&mut rng);
    let minus = sweep(&mut rng, &cells[4], under(-2.0, None), |_, z| z);
    let plus = sweep(
        &mut rng,
        &changed(&cells[4], 0.96),
        under(2.0, None),
        |_, z| z,
    );
    let biased = [plus, minus];
    let apart = under_current(&rest, &biased, &two()).unwrap();
    assert!(apart.pairs.is_empty());
    let currents: Vec<f64> = apart.changes.iter().map(|change| change.bias_a).collect();
    assert_eq!(currents, [-2.0, 2.0]);
    let options = UnderCurrentOptions {
        same_cell: true,
        ..two()
    };
    let found = under_current(&rest, &biased, &options).unwrap();
    let arc = &found.pairs[0].branches[1];
    assert!(
        arc.is_certain() && (arc.share + 0.04).abs() < 3.0 * arc.sigma,
        "{arc:?}"
    );
    assert!(
        in_words(&found)
            .iter()
            .any(|text| text.contains("taken as one cell: R1 −"))
    );
}

#[test]
fn the_smallest_order_that_suits_the_sweeps_at_rest_is_chosen() {
    let mut rng = Rng::new(9);
    let (cells, rest) = at_rest(&mut rng);
    let biased = sweep(&mut rng, &cells[0], under(1.0, None), |_, z| z);
    let found = under_current(&rest, &[biased], &UnderCurrentOptions::default()).unwrap();
    assert_eq!(found.model.branches.len(), 2);
    assert!(
        (0.8..1.3).contains(&found.chi2_at_rest),
        "{}",
        found.chi2_at_rest
    );
}

#[test]
fn too_little_to_compare_is_refused_with_what_is_missing() {
    let mut rng = Rng::new(2);
    let (cells, rest) = at_rest(&mut rng);
    let biased = sweep(&mut rng, &cells[0], under(1.0, None), |_, z| z);
    let words = |rest: &[SourcedSpectrum], biased: &[SourcedSpectrum]| {
        under_current(rest, biased, &two()).unwrap_err().to_string()
    };
    let none = words(&rest, &rest);
    assert_eq!(
        none,
        "expected at least one spectrum with a direct current, found none"
    );
    let one_cell = words(&rest[..REPEATS], std::slice::from_ref(&biased));
    assert!(
        one_cell.contains("repeats of two or more cells without direct current, found 1"),
        "{one_cell}"
    );
    let once: Vec<SourcedSpectrum> = rest.iter().step_by(REPEATS).cloned().collect();
    let no_repeats = words(&once, std::slice::from_ref(&biased));
    assert!(
        no_repeats.contains("repeats state the noise of a sweep"),
        "{no_repeats}"
    );
    let mut elsewhere = biased;
    elsewhere
        .spectrum
        .points
        .iter_mut()
        .for_each(|point| point.freq_hz *= 1.01);
    let frequencies = words(&rest, &[elsewhere]);
    assert!(
        frequencies.contains("at least 6 frequencies"),
        "{frequencies}"
    );
    assert!(frequencies.ends_with("found 0"), "{frequencies}");
}
