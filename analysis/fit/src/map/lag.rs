//! The time by which the voltage of the logs lags their current.
//!
//! A recorder that reads the voltage before the current shows each step of the current up to one of
//! its own steps before that of the voltage. Without the lag, the rows after each step of the current
//! would bend the fast branches.

use super::design::Design;
use super::options::MapFitError;
use super::score::residuals;
use super::solve::{Kinetics, Solved};
use super::train::Train;

/// Lags that are tried, as shares of the shortest step of the logs.
const TRIED: [f64; 9] = [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0];
/// Fits, each with the lag that suits the map before it.
const ROUNDS: usize = 2;

/// Finds the lag, s; `None` if the logs show none.
pub(super) fn find(
    design: &Design,
    train: &Train,
    kinetics: &Kinetics,
    without: &Solved,
) -> Result<Option<f64>, MapFitError> {
    let step_s = train.shortest_step_s();
    if !step_s.is_finite() {
        return Ok(None);
    }
    let mut best = (0.0, without.clone());
    for _ in 0..ROUNDS {
        let map = design.map(kinetics, &best.1);
        let square = |lag_s: f64| -> f64 {
            let of_logs = train.logs.iter().map(|log| residuals(&map, log, lag_s));
            of_logs.map(|r| r.iter().map(|v| v * v).sum::<f64>()).sum()
        };
        let lag_s = step_s * lowest(&TRIED.map(|share| (share, square(share * step_s))));
        if lag_s == best.0 {
            break;
        }
        let solved = design.solve(
            &Train {
                lag_s,
                ..train.clone()
            },
            kinetics,
        )?;
        if solved.cost >= best.1.cost {
            break;
        }
        best = (lag_s, solved);
    }
    Ok(train
        .shows_more(best.1.cost, without.cost)
        .then_some(best.0))
}

/// Returns the lowest point of the parabola through the lowest of the points and its neighbours.
fn lowest(points: &[(f64, f64)]) -> f64 {
    let middle = (1..points.len() - 1).min_by(|a, b| points[*a].1.total_cmp(&points[*b].1));
    let Some(k) = middle else { return 0.0 };
    let (before, at, after) = (points[k - 1], points[k], points[k + 1]);
    let bend = before.1 + after.1 - 2.0 * at.1;
    if bend <= 0.0 {
        return at.0;
    }
    at.0 + 0.5 * (at.0 - before.0) * ((before.1 - after.1) / bend).clamp(-1.0, 1.0)
}
