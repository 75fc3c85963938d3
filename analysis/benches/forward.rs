//! How many steps per second the forward simulation makes: 4 RC, a power profile at 10 kHz over 60 s, as `docs` of the peers' figures have it.
//!
//! `cargo bench -p analysis --bench forward [-- --json]`. Best of several runs, so that a busy machine disturbs least; per core where it says so.
#![allow(clippy::disallowed_methods, reason = "a benchmark measures the machine's time")]
#![allow(clippy::unwrap_used, missing_docs, reason = "a benchmark may end with its reason")]

use analysis::forward::{
    BatchCell, BatchOptions, Beyond, Demand, Interpolation, OcvSource, Profile, SimModel, SimOptions, SimState, simulate, simulate_batch,
};
use analysis::model::{Erm, RcBranch};
use analysis::ocv::OcvCurve;
use std::time::Instant;

const STEPS: usize = 600_000;
const CELLS: usize = 64;
const RUNS: usize = 7;

fn main() {
    let json = std::env::args().any(|a| a == "--json");
    let (flat, curved) = (cell(OcvSource::Constant(3.72)), cell(OcvSource::Curve(curve())));
    let state = flat.rest(0.5).unwrap();
    let (held, linear) = (profile(Interpolation::Hold), profile(Interpolation::Linear));
    let stop = BatchOptions::default();
    let tangent = BatchOptions { beyond: Beyond::Extrapolate { fraction: Beyond::FRACTION }, ..stop };
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let many =
        |model: &SimModel, profile: &Profile, options: &BatchOptions| one_core.install(|| batch((model, &state, CELLS), profile, options));
    let one = |model: &SimModel, profile: &Profile| one_core.install(|| batch((model, &state, 1), profile, &stop));
    let controlled = || {
        let start = Instant::now();
        let run = simulate(&flat, &state, &linear, &SimOptions::default()).unwrap();
        assert!(run.summary.feasible);
        STEPS as f64 / start.elapsed().as_secs_f64()
    };
    let cases: [(&str, &dyn Fn() -> f64); 7] = [
        ("forward_one_cell_held_power", &|| one(&flat, &held)),
        ("forward_one_cell_linear_power", &|| one(&flat, &linear)),
        ("forward_one_cell_error_controlled_with_trace", &controlled),
        ("forward_batch_per_core_held_power", &|| many(&flat, &held, &stop)),
        ("forward_batch_per_core_tangent", &|| many(&flat, &held, &tangent)),
        ("forward_batch_per_core_ocv_curve", &|| many(&curved, &held, &stop)),
        ("forward_batch_all_cores", &|| batch((&flat, &state, CELLS), &held, &stop)),
    ];
    let only = std::env::args().skip(1).find(|a| !a.starts_with('-'));
    for (name, case) in cases.into_iter().filter(|(name, _)| only.as_ref().is_none_or(|o| name.contains(o.as_str()))) {
        let best = (0..RUNS).map(|_| case()).fold(0.0, f64::max);
        if json {
            println!("{{\"name\":\"{name}\",\"steps_per_s\":{best:.4e}}}");
        } else {
            println!("{name:<48} {:>8.1} Msteps/s", best * 1e-6);
        }
    }
}

/// Cell-steps per second of a batch of equal cells at different scales.
fn batch((model, state, cells): (&SimModel, &SimState, usize), profile: &Profile, options: &BatchOptions) -> f64 {
    let cells: Vec<BatchCell<'_>> = (0..cells).map(|k| BatchCell { model, state, scale: 1.0 - 0.001 * k as f64 }).collect();
    let start = Instant::now();
    let outcomes = simulate_batch(&cells, profile, options).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    assert!(outcomes.iter().all(|o| o.infeasible_s.is_none() && o.min_ccv_v > 2.0));
    (STEPS * cells.len()) as f64 / seconds
}

fn profile(interpolation: Interpolation) -> Profile {
    let power = |t: f64| 60.0 + 40.0 * (7.0 * t).sin() + if (t * 3.0).fract() < 0.2 { 60.0 } else { 0.0 };
    let rows: Vec<(f64, f64)> = (0..=STEPS).map(|k| k as f64 * 1e-4).map(|t| (t, power(t))).collect();
    Profile::new("bench", (Demand::Power, interpolation), &rows).unwrap()
}

/// Appendix A of the thesis, 4 RC.
fn cell(ocv: OcvSource) -> SimModel {
    let rc = |r_ohm, c_f| RcBranch { r_ohm, c_f };
    let branches = vec![rc(0.001_509, 0.552_8), rc(0.000_662_8, 6.979_8), rc(0.000_404_1, 663.8), rc(0.004_774, 1_084.2)];
    SimModel::cell(&Erm { r_ohm: 0.006_428_6, branches }, ocv).unwrap()
}

fn curve() -> OcvCurve {
    let knots: Vec<f64> = (0..=100).map(|k| f64::from(k) / 100.0).collect();
    let volts = knots.iter().map(|z| 3.3 + 0.8 * z + 0.1 * (z - 0.5).powi(3)).collect();
    OcvCurve::monotone(4.2, knots, volts).unwrap()
}
