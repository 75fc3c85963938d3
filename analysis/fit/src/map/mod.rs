//! Fits a [`CellMap`]: resistances over state of charge and temperature, from logs of a cycler or
//! of the bench.
//!
//! With time constants that are fixed over the range, the voltage is linear in all resistances and
//! in the correction of the OCV, so that one bounded least-squares problem has one optimum and no
//! start: V = U(z) + δ(z) + (T − T_U)·s(z) − R·i − Σ vₖ. The branches' voltages vₖ are sums of the
//! current filtered through the surfaces' weights ([`CellMap::weights`]). Resistances are zero or
//! more. Two priors hold what the data do not determine: a surface bends little over SOC, and
//! between two temperatures it follows Arrhenius' law. The activation energies, one of the series
//! resistance and one of the branches, are found by their effect on the same cost.

mod design;
mod options;
mod score;
mod solve;
mod thermal;

pub use options::{MapFitError, MapLog, MapOptions};
pub use score::LogScore;

use analysis_model::{map::CellMap, ocv::OcvCurve};
use analysis_signal::series::Role;
use design::{Design, Log};
use serde::Serialize;
use solve::{Energies, Solved};

/// Start and prior of the activation energies, J/mol: ionic conduction, and charge transfer with
/// diffusion (Arrhenius slopes of lithium-ion cells; Waldmann et al., J. Power Sources 262 (2014)
/// 129, and the sources there).
const ENERGIES: Energies = Energies {
    series: 15e3,
    branches: 35e3,
};
/// Standard deviation of both about their prior, J/mol.
const ENERGY_SIGMA: f64 = 12e3;
/// Step of the search of the energies, J/mol; one move is at most twice as long.
const ENERGY_STEP: f64 = 5e3;
/// Rounds of the search over both energies.
const ENERGY_ROUNDS: usize = 2;

/// A fitted map and what it is worth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapFit {
    /// The map.
    pub map: CellMap,
    /// Error on each log, in the order of the logs.
    pub logs: Vec<LogScore>,
    /// Time over which the residuals of the fitted logs are correlated, s: the standard deviations
    /// of the map count one sample per such time.
    pub correlation_s: f64,
    /// Remarks, in sentences.
    pub notes: Vec<String>,
}

/// Fits a map to the logs with [`Role::Train`], and predicts all of them.
///
/// # Errors
/// [`MapFitError`] for logs, a curve or options that cannot be used.
pub fn fit_map(
    logs: &[MapLog],
    ocv: &OcvCurve,
    options: &MapOptions,
) -> Result<MapFit, MapFitError> {
    options.check(ocv)?;
    let logs = logs
        .iter()
        .map(|log| Log::new(log, ocv))
        .collect::<Result<Vec<_>, _>>()?;
    let train: Vec<&Log> = logs.iter().filter(|log| log.role == Role::Train).collect();
    let design = Design::new(&train, options)?;
    let (energies, solved) = search_energies(&design, &train, ocv)?;
    let mut map = design.map(energies, &solved);
    map.thermal = thermal::fit(&train);
    let residuals: Vec<Vec<f64>> = logs.iter().map(|log| score::residuals(&map, log)).collect();
    let fitted: Vec<_> = logs
        .iter()
        .zip(&residuals)
        .filter(|(log, _)| log.role == Role::Train)
        .collect();
    let correlation_s = score::correlation_s(&fitted);
    let scale = score::sigma_scale(&fitted, correlation_s);
    design.write_sigma(&mut map, &solved, scale);
    let scores = logs
        .iter()
        .zip(&residuals)
        .map(|(log, r)| LogScore::new(&map, log, r));
    Ok(MapFit {
        logs: scores.collect(),
        notes: design.notes(&map, &train, ocv.capacity_ah),
        map,
        correlation_s,
    })
}

/// Finds both activation energies by parabolas through the cost, one after the other.
fn search_energies(
    design: &Design,
    train: &[&Log],
    ocv: &OcvCurve,
) -> Result<(Energies, Solved), MapFitError> {
    let cost = |energies: Energies| -> Result<(f64, Solved), MapFitError> {
        let solved = design.solve(train, ocv, energies)?;
        let prior = |energy: f64, expected: f64| ((energy - expected) / ENERGY_SIGMA).powi(2);
        let beside =
            prior(energies.series, ENERGIES.series) + prior(energies.branches, ENERGIES.branches);
        Ok((solved.cost + beside, solved))
    };
    let mut best = ENERGIES;
    let (mut least, mut solved) = cost(best)?;
    for _ in 0..ENERGY_ROUNDS {
        for of_series in [true, false] {
            let moved = |by: f64| {
                let mut energies = best;
                let energy = if of_series {
                    &mut energies.series
                } else {
                    &mut energies.branches
                };
                *energy = (*energy + by).max(0.0);
                energies
            };
            let (below, _) = cost(moved(-ENERGY_STEP))?;
            let (above, _) = cost(moved(ENERGY_STEP))?;
            let bend = below + above - 2.0 * least;
            let by = if bend > 0.0 {
                (0.5 * ENERGY_STEP * (below - above) / bend)
                    .clamp(-2.0 * ENERGY_STEP, 2.0 * ENERGY_STEP)
            } else if below < above {
                -ENERGY_STEP
            } else {
                ENERGY_STEP
            };
            let tried = moved(by);
            let (met, there) = cost(tried)?;
            if met < least {
                (best, least, solved) = (tried, met, there);
            }
        }
    }
    Ok((best, solved))
}

#[cfg(test)]
mod tests;
