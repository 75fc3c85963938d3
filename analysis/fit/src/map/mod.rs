//! Fits a [`CellMap`]: resistances over state of charge and temperature, from logs of a cycler or
//! of the bench, and from spectra.
//!
//! With time constants that are fixed over the range, the voltage is linear in all resistances and
//! in the correction of the OCV, so that without charge transfer one bounded least-squares problem has one
//! optimum and no start: V = U(z) + δ(z) + (T − T_U)·s(z) − R·i − Σ vₖ. The branches' voltages vₖ are sums of the
//! current filtered through the surfaces' weights ([`CellMap::weights`]). The impedance is linear in
//! the same resistances: Z = R + Σ Rₖ/(1 + jωτₖ) + jωL + U′/(jωQ). Resistances are zero or
//! more. Two priors hold what the data do not determine: a surface bends little over SOC, and
//! between two temperatures it follows Arrhenius' law. The activation energies, one of the series
//! resistance and one of the branches, and the voltage of charge transfer are found by their effect on the
//! same cost. Where branches bend, the equations are those around a map, and are solved until that is
//! their own solution.

mod charge;
mod choices;
mod conflict;
mod design;
mod error;
mod kinetics;
mod lag;
mod left_out;
mod log;
mod next;
mod nodes;
mod notes;
mod options;
mod prior;
mod rows;
mod score;
mod solution;
mod solve;
mod sweep;
mod thermal;
mod train;

pub use charge::soc_of_point;
pub use choices::{Choices, Measurement, Offer, PulsePart, Signal};
pub use next::{Fitted, Load, Next, NextPlan, plan_next};
pub use options::{MapFitError, MapLog, MapOptions, MapPoint, MapSpectrum};
pub use score::{LeftOutScore, LogScore, SpectrumScore};

use analysis_model::{
    map::{CellMap, ErrorSource},
    ocv::OcvCurve,
};
use analysis_signal::series::Role;
use conflict::Conflict;
use log::Log;
use score::LogErrors;
use serde::Serialize;
use solution::Solution;
use sweep::Sweep;
pub use train::Scales;
use train::Train;

/// Data of one cell.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MapData {
    /// Logs of current, voltage and temperature.
    pub logs: Vec<MapLog>,
    /// Spectra without a direct current.
    pub spectra: Vec<MapSpectrum>,
}

/// A fitted map and what it is worth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapFit {
    /// The map.
    pub map: CellMap,
    /// Error on each log, in the order of the logs.
    pub logs: Vec<LogScore>,
    /// Error on each spectrum, in the order of the spectra.
    pub spectra: Vec<SpectrumScore>,
    /// Time over which the residuals of the fitted logs are correlated, s: the standard deviations
    /// of the map count one sample per such time. Zero without logs.
    pub correlation_s: f64,
    /// Time by which the voltage of the logs lags their current, s: a property of the recorder, which
    /// the errors of all logs take into account and the map does not contain.
    pub lag_s: f64,
    /// Factors on the errors that the weights of a first fit assume; the standard deviations of the
    /// map follow from them.
    pub scales: Scales,
    /// Frequency from which on spectra are fitted, Hz; below it they contradict the logs. Zero if all of
    /// their points are fitted.
    pub spectra_from_hz: f64,
    /// Remarks, in sentences.
    pub notes: Vec<String>,
}

/// Fits a map to the data with [`Role::Train`], and predicts all of them.
///
/// # Errors
/// [`MapFitError`] for data, a curve or options that cannot be used.
pub fn fit_map(
    data: &MapData,
    ocv: &OcvCurve,
    options: &MapOptions,
) -> Result<MapFit, MapFitError> {
    options.check(ocv)?;
    let logs = data
        .logs
        .iter()
        .map(|log| Log::new(log, ocv))
        .collect::<Result<Vec<_>, _>>()?;
    let sweeps = data
        .spectra
        .iter()
        .map(|spectrum| Sweep::new(spectrum, ocv));
    let sweeps = sweeps.collect::<Result<Vec<_>, _>>()?;
    let mut train = Train::new(&logs, &sweeps, ocv);
    let mut solution = Solution::search(&mut train, options)?;
    let conflict = Conflict::find(&solution, &train, &sweeps, options)?;
    let from_hz = conflict.map_or(0.0, |conflict| conflict.from_hz);
    let sweeps: Vec<Sweep> = sweeps.iter().map(|s| s.clone().fit_from(from_hz)).collect();
    train.sweeps = sweeps.iter().filter(|sweep| sweep.is_fitted()).collect();
    if conflict.is_some() {
        train = Train::new(&logs, &sweeps, ocv);
        solution = Solution::search(&mut train, options)?;
    }
    let mut map = solution.map();
    map.thermal = thermal::fit(&train.logs);
    map.most_current_a = train.most_current_a();
    solution.design.write_sigma(&mut map, &solution.solved);
    map.validate()
        .map_err(|error| MapFitError::Series(error.to_string()))?;
    let of_logs = logs
        .iter()
        .map(|log| LogErrors::new(score::predict(&map, log, train.lag_s)));
    let mut errors: Vec<LogErrors> = of_logs.collect();
    let from = error::source(&logs);
    if from == ErrorSource::LeftOut {
        let pieces = error::predict_left_out(&solution, &train);
        let fitted = logs.iter().zip(&mut errors);
        let fitted = fitted.filter(|(log, _)| log.role == Role::Train);
        for ((_, errors), piece) in fitted.zip(pieces) {
            errors.left_out = Some(piece);
        }
    }
    error::write(&mut map, ocv, from, &logs, &mut errors);
    let left_out = left_out::LeftOut::new(&solution, &train);
    let inductance_h = solution.inductance_h();
    let spectra = score::spectra(&map, &sweeps, inductance_h, |sweep| left_out.score(sweep));
    let conflict = conflict.map(|conflict| conflict.note());
    let both = || logs.iter().zip(&errors);
    let fitted = both().filter(|(log, _)| log.role == Role::Train);
    let fitted: Vec<&Vec<f64>> = fitted.map(|(_, errors)| &errors.of_map).collect();
    Ok(MapFit {
        logs: both()
            .map(|(log, errors)| LogScore::new(&map, log, errors))
            .collect(),
        notes: [
            solution.design.notes(&map, &train),
            conflict.into_iter().collect(),
            left_out.notes(),
        ]
        .concat(),
        correlation_s: score::correlation_s(&train.logs, &fitted),
        spectra,
        map,
        lag_s: train.lag_s,
        scales: train.scales,
        spectra_from_hz: from_hz,
    })
}

#[cfg(test)]
mod error_tests;
#[cfg(test)]
mod next_tests;
#[cfg(test)]
mod tests;
