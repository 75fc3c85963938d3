//! Temperatures of a map.

use super::log::Log;
use super::options::MapFitError;
use super::solve::START;
use super::sweep::Sweep;
use super::train::Train;
use analysis_model::map::arrhenius;

/// A place that is to be measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wanted {
    pub(super) soc: f64,
    pub(super) temperature_degc: f64,
}

/// A log, a spectrum, or a place that is to be measured.
#[derive(Clone, Copy)]
enum Datum<'a> {
    Log(&'a Log),
    Sweep(&'a Sweep),
    Wanted(Wanted),
}

impl Datum<'_> {
    fn degc(&self) -> f64 {
        match self {
            Self::Log(log) => log.mean_degc(),
            Self::Sweep(sweep) => sweep.temperature_degc,
            Self::Wanted(place) => place.temperature_degc,
        }
    }
}

/// Finds the temperature nodes, °C, and a third of the DC resistance at each, Ω.
///
/// Data whose temperatures differ by less than `distance_k` from the coldest of a group share a node.
/// The resistance of a node without data is that of the nearest one with data, by Arrhenius' law.
///
/// # Errors
/// [`MapFitError::NoLoss`] if the logs of a node gain power.
pub(super) fn nodes(
    train: &Train,
    places: &[Wanted],
    distance_k: f64,
) -> Result<(Vec<f64>, Vec<f64>), MapFitError> {
    let logs = train.logs.iter().map(|log| Datum::Log(log));
    let sweeps = train.sweeps.iter().map(|sweep| Datum::Sweep(sweep));
    let places = places.iter().map(|place| Datum::Wanted(*place));
    let mut data: Vec<Datum> = logs.chain(sweeps).chain(places).collect();
    data.sort_by(|a, b| a.degc().total_cmp(&b.degc()));
    let (mut means, mut known) = (Vec::new(), Vec::new());
    let mut rest = &data[..];
    while let Some(first) = rest.first() {
        let near = |datum: &&Datum| datum.degc() - first.degc() < distance_k;
        let (group, after) = rest.split_at(rest.iter().take_while(near).count());
        means.push(group.iter().map(Datum::degc).sum::<f64>() / group.len() as f64);
        known.push(resistance_ohm(group)?);
        rest = after;
    }
    let units = means.iter().zip(&known).map(|(degc, r_ohm)| {
        let others = means
            .iter()
            .zip(&known)
            .filter_map(|(other, r_ohm)| Some((*other, (*r_ohm)?)));
        let far =
            |a: &(f64, f64), b: &(f64, f64)| (a.0 - degc).abs().total_cmp(&(b.0 - degc).abs());
        let from = |(other, r_ohm)| r_ohm * arrhenius(START.branches, *degc, other);
        r_ohm
            .or_else(|| others.min_by(far).map(from))
            .unwrap_or(1.0)
            / 3.0
    });
    let units = units.collect();
    Ok((means, units))
}

/// The DC resistance that logs lose their power in; without logs, that of the spectra; without data,
/// none.
fn resistance_ohm(group: &[Datum]) -> Result<Option<f64>, MapFitError> {
    let logs = || {
        group.iter().filter_map(|datum| match datum {
            Datum::Log(log) => Some(*log),
            Datum::Sweep(_) | Datum::Wanted(_) => None,
        })
    };
    let samples = logs().flat_map(|log| (0..log.len()).map(move |k| (log, k)));
    let (lost, square) = samples.fold((0.0, 0.0), |(lost, square), (log, k)| {
        (
            lost + log.heat_w(k),
            square + log.samples.current_a[k].powi(2),
        )
    });
    match logs().next() {
        Some(log) if lost <= 0.0 => Err(MapFitError::NoLoss {
            log: log.name.clone(),
        }),
        Some(_) => Ok(Some(lost / square)),
        None => {
            let sweeps = group.iter().filter_map(|datum| match datum {
                Datum::Sweep(sweep) => Some(sweep.lowest_ohm()),
                Datum::Log(_) | Datum::Wanted(_) => None,
            });
            let ohm: Vec<f64> = sweeps.collect();
            Ok((!ohm.is_empty()).then(|| ohm.iter().sum::<f64>() / ohm.len() as f64))
        }
    }
}
