//! Steps per second of the forward simulation: 4 RC, a power profile at 10 kHz over 60 s. The best
//! of several runs counts, so that a busy machine disturbs least.

use analysis::forward::{
    BatchCell, BatchOptions, Beyond, Demand, Interpolation, OcvSource, Profile, SimModel,
    SimOptions, SimState, simulate, simulate_batch,
};
use analysis::model::{Erm, RcBranch};
use analysis::ocv::OcvCurve;
use std::time::Instant;

use crate::{Row, Unit};

const STEPS: usize = 600_000;
const CELLS: usize = 64;
const RUNS: usize = 7;

/// Returns the figures.
pub(crate) fn rows() -> Vec<Row> {
    let (flat, curved) = (
        cell(OcvSource::Constant(3.72)),
        cell(OcvSource::Curve(curve())),
    );
    let state = flat.rest(0.5).unwrap();
    let (held, linear) = (profile(Interpolation::Hold), profile(Interpolation::Linear));
    let stop = BatchOptions::default();
    let tangent = BatchOptions {
        beyond: Beyond::Extrapolate {
            fraction: Beyond::FRACTION,
        },
        ..stop
    };
    let one_core = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let many = |model: &SimModel, profile: &Profile, options: &BatchOptions| {
        one_core.install(|| batch(model, &state, CELLS, profile, options))
    };
    let one = |model: &SimModel, profile: &Profile| {
        one_core.install(|| batch(model, &state, 1, profile, &stop))
    };
    let controlled = || {
        let start = Instant::now();
        let run = simulate(&flat, &state, &linear, &SimOptions::default()).unwrap();
        assert!(run.summary.feasible);
        STEPS as f64 / start.elapsed().as_secs_f64()
    };
    let cases: [(&str, &str, &dyn Fn() -> f64); 7] = [
        ("forward-4rc", "forward, one cell, held power", &|| {
            one(&flat, &held)
        }),
        ("", "forward, one cell, linear power", &|| {
            one(&flat, &linear)
        }),
        (
            "",
            "forward, one cell, error control and trace",
            &controlled,
        ),
        (
            "forward-4rc",
            "forward, 64 cells in lockstep, per core",
            &|| many(&flat, &held, &stop),
        ),
        ("", "  the same with the tangent beyond P₀", &|| {
            many(&flat, &held, &tangent)
        }),
        ("", "  the same with an OCV curve", &|| {
            many(&curved, &held, &stop)
        }),
        ("", "  the same on all cores", &|| {
            batch(&flat, &state, CELLS, &held, &stop)
        }),
    ];
    let best = |case: &dyn Fn() -> f64| (0..RUNS).map(|_| case()).fold(0.0, f64::max);
    cases
        .into_iter()
        .map(|(work, what, case)| Row::new(work, what, best(case), Unit::PerSecond("steps")))
        .chain(crate::forward_map::rows(&held))
        .collect()
}

/// Cell-steps per second of a batch of equal cells at different scales.
fn batch(
    model: &SimModel,
    state: &SimState,
    cells: usize,
    profile: &Profile,
    options: &BatchOptions,
) -> f64 {
    let cells: Vec<BatchCell<'_>> = (0..cells)
        .map(|k| BatchCell {
            model,
            state,
            scale: 1.0 - 0.001 * k as f64,
        })
        .collect();
    let start = Instant::now();
    let outcomes = simulate_batch(&cells, profile, options).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    assert!(
        outcomes
            .iter()
            .all(|o| o.infeasible_s.is_none() && o.min_ccv_v > 2.0)
    );
    (STEPS * cells.len()) as f64 / seconds
}

fn profile(interpolation: Interpolation) -> Profile {
    let power =
        |t: f64| 60.0 + 40.0 * (7.0 * t).sin() + if (t * 3.0).fract() < 0.2 { 60.0 } else { 0.0 };
    let rows: Vec<(f64, f64)> = (0..=STEPS)
        .map(|k| k as f64 * 1e-4)
        .map(|t| (t, power(t)))
        .collect();
    Profile::new("bench", Demand::Power, interpolation, &rows).unwrap()
}

/// Appendix A of the thesis, 4 RC.
fn cell(ocv: OcvSource) -> SimModel {
    let rc = |r_ohm, c_f| RcBranch { r_ohm, c_f };
    let branches = vec![
        rc(0.001_509, 0.552_8),
        rc(0.000_662_8, 6.979_8),
        rc(0.000_404_1, 663.8),
        rc(0.004_774, 1_084.2),
    ];
    SimModel::cell(
        &Erm {
            r_ohm: 0.006_428_6,
            branches,
        },
        ocv,
    )
    .unwrap()
}

fn curve() -> OcvCurve {
    let knots: Vec<f64> = (0..=100).map(|k| f64::from(k) / 100.0).collect();
    let volts = knots
        .iter()
        .map(|z| 3.3 + 0.8 * z + 0.1 * (z - 0.5).powi(3))
        .collect();
    OcvCurve::monotone(4.2, knots, volts).unwrap()
}
