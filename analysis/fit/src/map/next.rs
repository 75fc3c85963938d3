//! What to measure next: the spectra and pulses that take most off the predicted error of a load, per
//! minute of bench time.
//!
//! Rows and priors of the fit give the covariance Σ of its unknowns. Under a load profile the voltage
//! is X·x, so that its variance is the mean of the diagonal of X·Σ·Xᵀ. A measurement at a place adds
//! rows that are known before it is made, and with them a smaller Σ. Places are chosen one after the
//! other, each with the largest fall of the error per minute.

use super::choices::{Choices, Measurement, Offer, PulsePart, Signal};
use super::design::Design;
use super::log::Log;
use super::nodes::Wanted;
use super::options::{MapFitError, MapLog, MapOptions, MapPoint, MapSpectrum};
use super::solve::{Kinetics, Rows};
use super::sweep::Sweep;
use super::train::Train;
use super::{MapData, MapFit};
use analysis_model::ocv::OcvCurve;
use analysis_signal::series::{Role, TimeSeries};
use nalgebra::DMatrix;
use serde::Serialize;
use std::sync::Arc;

/// Shortest time between two rows of a pulse, s.
const PULSE_STEP_S: f64 = 0.1;
/// Time without current before the first pulse, s.
const BEFORE_S: f64 = 1.0;

/// A measurement that is proposed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Next {
    /// State of charge, 0…1.
    pub soc: f64,
    /// Temperature, °C.
    pub temperature_degc: f64,
    /// What is measured.
    pub what: Measurement,
    /// Bench time with the way to the place and the rest, min.
    pub minutes: f64,
    /// Predicted error of the voltage under the loads after it, one standard deviation, V.
    pub error_v: f64,
}

/// Proposed measurements, in the order of their choice.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextPlan {
    /// Predicted error of the voltage under the loads before the first of them, V.
    pub error_v: f64,
    /// The measurements.
    pub next: Vec<Next>,
}

/// A load whose voltage shall be predicted.
#[derive(Debug, Clone, PartialEq)]
pub struct Load {
    /// Name for errors.
    pub name: String,
    /// Times, s, rising.
    pub time_s: Vec<f64>,
    /// Current of the cell, A, discharge positive.
    pub current_a: Vec<f64>,
    /// State of charge at the start.
    pub soc: f64,
    /// Temperature of the cell, °C.
    pub temperature_degc: f64,
}

/// A fitted map with all that it was made of.
#[derive(Debug, Clone, Copy)]
pub struct Fitted<'a> {
    /// Data of the fit.
    pub data: &'a MapData,
    /// OCV curve of the fit.
    pub ocv: &'a OcvCurve,
    /// Form of the map.
    pub options: &'a MapOptions,
    /// The map.
    pub fit: &'a MapFit,
}

/// Chooses up to `count` measurements that make the map predict the loads better.
///
/// # Errors
/// [`MapFitError`] for loads or data that cannot be used.
pub fn plan_next(
    fitted: Fitted,
    loads: &[Load],
    choices: &Choices,
    count: usize,
) -> Result<NextPlan, MapFitError> {
    let mut planner = Planner::new(fitted, loads, choices)?;
    let error_v = planner.error_v();
    let mut next = Vec::new();
    while next.len() < count
        && let Some(best) = planner.best()
    {
        next.push(planner.take(&best));
    }
    Ok(NextPlan { error_v, next })
}

/// State of the choice.
struct Planner<'a> {
    fitted: Fitted<'a>,
    choices: &'a Choices,
    design: Design,
    kinetics: Kinetics,
    /// Mean of Xᵀ·X under the loads.
    goal: DMatrix<f64>,
    /// Covariance of the unknowns.
    covariance: DMatrix<f64>,
    /// Measurements that may be chosen.
    open: Vec<Candidate<'a>>,
    /// Places of those that were chosen.
    taken: Vec<Wanted>,
}

/// A measurement that may be chosen, with its weighted rows.
struct Candidate<'a> {
    offer: &'a Offer,
    rows: Rows,
}

/// The best of the measurements that may be chosen: its place among them, and its bench time, min.
struct Best {
    open: usize,
    minutes: f64,
    per_minute_v: f64,
}

impl<'a> Planner<'a> {
    fn new(fitted: Fitted<'a>, loads: &[Load], choices: &'a Choices) -> Result<Self, MapFitError> {
        let Fitted {
            data,
            ocv,
            options,
            fit,
        } = fitted;
        let logs = data.logs.iter().filter(|log| log.role == Role::Train);
        let logs = logs
            .map(|log| Log::new(log, ocv))
            .collect::<Result<Vec<_>, _>>()?;
        let sweeps = data
            .spectra
            .iter()
            .filter(|spectrum| spectrum.role == Role::Train);
        let sweeps = sweeps
            .map(|s| Ok(Sweep::new(s, ocv)?.fit_from(fit.spectra_from_hz)))
            .collect::<Result<Vec<_>, MapFitError>>()?;
        let train = Train {
            lag_s: fit.lag_s,
            scales: fit.scales,
            ..Train::new(&logs, &sweeps, ocv)
        };
        let measured = choices.offers.iter().map(place_of);
        let of_loads = loads.iter().map(|load| Wanted {
            soc: load.soc,
            temperature_degc: load.temperature_degc,
        });
        let wanted: Vec<Wanted> = measured.chain(of_loads).collect();
        let design = Design::new(&train, &wanted, options)?;
        let kinetics = Kinetics {
            series: fit.map.series.activation_j_per_mol,
            branches: fit
                .map
                .branches
                .first()
                .map_or(0.0, |b| b.resistance.activation_j_per_mol),
            around: fit.map.charge_transfer.map(|_| Arc::new(fit.map.clone())),
        };
        let covariance = design.equations(&train, &kinetics).covariance();
        let covariance = covariance.ok_or(MapFitError::Singular("no place is determined"))?;
        let mut goal = DMatrix::zeros(design.count(), design.count());
        for load in loads {
            let log = Log::new(&log_of(load), ocv)?;
            let duration_s = log.longest_s() * loads.len() as f64;
            design.add_log(
                &log,
                0.0,
                &kinetics,
                |stands_s, _| (stands_s / duration_s).sqrt(),
                &mut |rows, _| Rows::of(rows).add_square_to(&mut goal),
            );
        }
        let mut planner = Self {
            fitted,
            choices,
            design,
            kinetics,
            goal,
            covariance,
            open: Vec::new(),
            taken: Vec::new(),
        };
        for offer in &choices.offers {
            let rows = planner.rows(offer)?;
            planner.open.push(Candidate { offer, rows });
        }
        Ok(planner)
    }

    /// Predicted error of the voltage under the loads, V.
    fn error_v(&self) -> f64 {
        self.covariance.dot(&self.goal).max(0.0).sqrt()
    }

    /// Finds the measurement with the largest fall of the error per minute.
    fn best(&self) -> Option<Best> {
        let variance = self.covariance.dot(&self.goal);
        let seen = &self.covariance * &self.goal * &self.covariance;
        let mut best: Option<Best> = None;
        for (open, candidate) in self.open.iter().enumerate() {
            let Some(inverse) = self.innovation(&candidate.rows) else {
                continue;
            };
            let removed = candidate.rows.around(&seen).dot(&inverse);
            let left = (variance - removed).max(0.0);
            let minutes = self.minutes(candidate.offer);
            let per_minute_v = (variance.sqrt() - left.sqrt()) / minutes;
            if best.as_ref().is_none_or(|b| per_minute_v > b.per_minute_v) {
                best = Some(Best {
                    open,
                    minutes,
                    per_minute_v,
                });
            }
        }
        best.filter(|best| best.per_minute_v > 0.0)
    }

    /// Returns (1 + X·Σ·Xᵀ)⁻¹ of the rows of a measurement.
    fn innovation(&self, rows: &Rows) -> Option<DMatrix<f64>> {
        let mut matrix = rows.around(&self.covariance);
        (0..matrix.nrows()).for_each(|k| matrix[(k, k)] += 1.0);
        matrix.cholesky().map(|factor| factor.inverse())
    }

    /// Takes a measurement as made.
    fn take(&mut self, best: &Best) -> Next {
        let Candidate { offer, rows } = self.open.remove(best.open);
        if let Some(inverse) = self.innovation(&rows) {
            let gain = rows.after(&self.covariance);
            self.covariance -= &gain * inverse * gain.transpose();
        }
        self.taken.push(place_of(offer));
        Next {
            soc: offer.soc,
            temperature_degc: offer.temperature_degc,
            what: offer.measurement(),
            minutes: best.minutes,
            error_v: self.error_v(),
        }
    }

    /// Weighted rows of a measurement that is not yet made.
    fn rows(&self, offer: &Offer) -> Result<Rows, MapFitError> {
        let (design, ocv) = (&self.design, self.fitted.ocv);
        let mut kept = Vec::new();
        let mut keep = |rows: &DMatrix<f64>, _: &_| kept.push(rows.clone());
        match &offer.signal {
            Signal::Spectrum { freqs_hz } => {
                let sweep = Sweep::new(&self.spectrum(offer, freqs_hz), ocv)?;
                let sweep = sweep.fit_from(self.fitted.fit.spectra_from_hz);
                let scale = self.fitted.fit.scales.spectra;
                design.add_sweep(&sweep, scale, &self.kinetics, &mut keep);
            }
            Signal::Pulses(parts) => {
                let log = Log::new(&pulses(offer, parts), ocv)?;
                let train = Train {
                    logs: Vec::new(),
                    sweeps: Vec::new(),
                    lag_s: 0.0,
                    scales: self.fitted.fit.scales,
                    ocv,
                };
                let weight = |stands_s: f64, soc: f64| train.weight(stands_s, soc);
                design.add_log(&log, 0.0, &self.kinetics, weight, &mut keep);
            }
        }
        let count = kept.iter().map(DMatrix::nrows).sum();
        let mut all = DMatrix::zeros(count, design.count());
        let mut from = 0;
        for rows in kept {
            all.rows_mut(from, rows.nrows()).copy_from(&rows);
            from += rows.nrows();
        }
        Ok(Rows::of(&all))
    }

    /// A spectrum at a place with the impedance that the map has there.
    fn spectrum(&self, offer: &Offer, freqs_hz: &[f64]) -> MapSpectrum {
        let map = &self.fitted.fit.map;
        let erm = map.model_at(offer.soc, offer.temperature_degc);
        let points = freqs_hz.iter().map(|freq_hz| MapPoint {
            freq_hz: *freq_hz,
            z_ohm: erm.impedance(*freq_hz),
            sigma_ohm: None,
        });
        MapSpectrum {
            name: "next".to_owned(),
            role: Role::Train,
            soc: offer.soc,
            temperature_degc: offer.temperature_degc,
            points: points.collect(),
        }
    }

    /// Bench time of a measurement with the way to its place, min.
    fn minutes(&self, offer: &Offer) -> f64 {
        let place = place_of(offer);
        if self.taken.contains(&place) {
            return offer.minutes;
        }
        let same_degc = |other: &&Wanted| other.temperature_degc == place.temperature_degc;
        let here = || self.taken.iter().filter(same_degc);
        let from = here().map(|other| other.soc).chain([1.0]);
        let way = from.map(|soc| (soc - place.soc).abs()).fold(1.0, f64::min);
        let hours = way * self.fitted.ocv.capacity_ah / self.choices.travel_a;
        let held = if here().next().is_none() {
            self.choices.temperature_min
        } else {
            0.0
        };
        offer.minutes + 60.0 * hours + held + self.choices.rest_min
    }
}

fn place_of(offer: &Offer) -> Wanted {
    Wanted {
        soc: offer.soc,
        temperature_degc: offer.temperature_degc,
    }
}

/// Pulses and rests, with rows that lie closer after each edge.
fn pulses(offer: &Offer, parts: &[PulsePart]) -> MapLog {
    let (mut time_s, mut current_a) = (vec![0.0], vec![0.0]);
    let mut from_s = BEFORE_S;
    for part in parts {
        let before_a = current_a[current_a.len() - 1];
        time_s.push(from_s);
        current_a.push(before_a);
        let mut after_s = 1e-3;
        while after_s < part.duration_s {
            time_s.push(from_s + after_s);
            current_a.push(part.current_a);
            after_s += (0.5 * after_s).max(PULSE_STEP_S);
        }
        from_s += part.duration_s;
    }
    log_of(&Load {
        name: "next".to_owned(),
        time_s,
        current_a,
        soc: offer.soc,
        temperature_degc: offer.temperature_degc,
    })
}

/// A log of a current whose voltage nothing depends on.
fn log_of(load: &Load) -> MapLog {
    MapLog {
        series: TimeSeries {
            name: load.name.clone(),
            time_s: load.time_s.clone(),
            current_a: load.current_a.clone(),
            voltage_v: vec![0.0; load.time_s.len()],
            temperature_degc: None,
        },
        soc_start: Some(load.soc),
        net_ah: None,
        temperature_degc: Some(load.temperature_degc),
        role: Role::Train,
    }
}
