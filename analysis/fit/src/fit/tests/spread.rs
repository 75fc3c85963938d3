//! Cells that differ by known amounts, swept several times.

use super::noisy;
use crate::fit::{CellSweeps, FitOptions, Objective, cell_spread};
use analysis_numeric::{Covariance2, Rng};

/// Cells whose R differs by `between` (relative), whose second resistance does not; sweeps repeat
/// within 0.2 %.
fn cells(count: usize, between: f64, rng: &mut Rng) -> Vec<CellSweeps> {
    let one = |k: usize, rng: &mut Rng| {
        let r = 0.007 * (1.0 + between * rng.normal());
        let mut sweeps: Vec<_> = (0..3 + k % 3)
            .map(|_| noisy((r, &[(0.0017, 1.2), (0.0026, 200.0)]), 20, 0.002, rng))
            .collect();
        sweeps
            .iter_mut()
            .flat_map(|s| &mut s.points)
            .for_each(|p| p.covariance = Covariance2::UNKNOWN);
        CellSweeps {
            cell: format!("cell {k}"),
            named: true,
            sweeps,
        }
    };
    (0..count).map(|k| one(k, rng)).collect()
}

#[test]
fn what_differs_between_cells_is_distinguished_from_what_does_not_repeat() {
    let mut rng = Rng::new(21);
    let options = FitOptions {
        rc: 2,
        objective: Objective::Complex,
        ..FitOptions::default()
    };
    let met = cell_spread(&cells(24, 0.01, &mut rng), &[2, 4], &options).unwrap();
    assert_eq!((met.cells, met.sweeps, met.frequencies.len()), (24, 96, 20));
    let two = &met.parameters[0];
    let relative = |name: &str| {
        let q = two.quantities.iter().find(|q| q.name == name).unwrap();
        (
            q.spread.between.unwrap() / q.spread.mean,
            q.spread.within.unwrap() / q.spread.mean,
            q.fitted_relative_sigma.unwrap(),
        )
    };
    // 24 cells know a standard deviation within 15 %: three of these are allowed.
    let (between, within, stated) = relative("R");
    assert!((between / 0.01 - 1.0).abs() < 0.45, "{between}");
    assert!(
        (within / stated - 1.0).abs() < 0.3,
        "repeats scatter by {within}, single fits state {stated}"
    );
    let (between, within, _) = relative("R2");
    assert!(between < 0.5 * within, "{between} {within}");
    assert!(two.warning.is_none(), "{:?}", two.warning);
    let four = met.parameters[1].warning.as_ref().unwrap();
    assert!(
        four.starts_with("single sweeps do not fix ")
            && four.contains("of 4 RC: their spread is of the fit"),
        "{four}"
    );
    let (low, fast) = (&met.frequencies[0], &met.frequencies[19]);
    // At 300 Hz Re Z is R and a tenth of R1; 1 % of 7 mΩ is 70 µΩ at every frequency, and nothing
    // in the imaginary part.
    for f in [low, fast] {
        assert!(
            (f.re_ohm.between.unwrap() / 70e-6 - 1.0).abs() < 0.45,
            "{f:?}"
        );
        assert!(f.im_ohm.between.unwrap() < 12e-6, "{f:?}");
        assert!(
            (f.re_ohm.within.unwrap() / (0.002 * f.re_ohm.mean.hypot(f.im_ohm.mean)) - 1.0).abs()
                < 0.35,
            "{f:?}"
        );
    }
    assert_eq!(
        met.measured
            .iter()
            .map(|q| q.name.as_str())
            .collect::<Vec<_>>()
            .first(),
        Some(&"|Z| at 0.100 Hz")
    );
}
