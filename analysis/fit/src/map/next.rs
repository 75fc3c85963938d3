//! What to measure next: the spectra and pulses that take most off the predicted error of a load, per
//! minute of bench time.
//!
//! Rows and priors of the fit give the covariance Σ of its unknowns. Under a load profile the voltage
//! is X·x, so that its variance is the mean of the diagonal of X·Σ·Xᵀ. A measurement at a place adds
//! rows that are known before it is made, and with them a smaller Σ. Places are chosen one after the
//! other, each with the largest fall of the error per minute.

use super::design::Design;
use super::log::Log;
use super::nodes::Wanted;
use super::options::{MapFitError, MapLog, MapOptions, MapPoint, MapSpectrum};
use super::solve::Kinetics;
use super::sweep::Sweep;
use super::train::Train;
use super::{MapData, MapFit};
use analysis_model::ocv::OcvCurve;
use analysis_signal::series::{Role, TimeSeries};
use nalgebra::DMatrix;
use serde::Serialize;

/// Points of a spectrum that is not yet measured.
const POINTS: usize = 20;
/// Periods of each of its points, with those before the record.
const PERIODS: f64 = 14.0;
/// Time between two points, s.
const BETWEEN_S: f64 = 3.0;
/// Shortest time between two rows of a pulse, s.
const PULSE_STEP_S: f64 = 0.1;

/// What may be measured at a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Measurement {
    /// A spectrum.
    Spectrum,
    /// Pulses in both directions.
    Pulses,
}

/// Places, measurements and times of a bench.
#[derive(Debug, Clone, PartialEq)]
pub struct Choices {
    /// States of charge, 0…1.
    pub soc: Vec<f64>,
    /// Temperatures, °C.
    pub temperature_degc: Vec<f64>,
    /// Lowest and highest frequency of a spectrum, Hz.
    pub band_hz: (f64, f64),
    /// Current of a pulse, A.
    pub pulse_a: f64,
    /// Duration of a pulse, s; the rest after it is four times as long.
    pub pulse_s: f64,
    /// Rest before a measurement, min.
    pub rest_min: f64,
    /// Time to change the temperature and to hold it, min.
    pub temperature_min: f64,
    /// Current from one state of charge to the next, A.
    pub travel_a: f64,
}

impl Choices {
    /// Returns choices for a cell of a capacity, Ah: every 10 % of charge at given temperatures,
    /// spectra from 0.1 to 300 Hz, pulses of 2C and 10 s.
    pub fn new(capacity_ah: f64, temperature_degc: Vec<f64>) -> Self {
        Self {
            soc: (1..10).map(|k| f64::from(k) / 10.0).collect(),
            temperature_degc,
            band_hz: (0.1, 300.0),
            pulse_a: 2.0 * capacity_ah,
            pulse_s: 10.0,
            rest_min: 30.0,
            temperature_min: 60.0,
            travel_a: 0.5 * capacity_ah,
        }
    }

    /// Duration of a measurement, min, without the way to its place.
    fn minutes(&self, what: Measurement) -> f64 {
        let seconds: f64 = match what {
            Measurement::Spectrum => self
                .frequencies()
                .map(|freq_hz| PERIODS / freq_hz + BETWEEN_S)
                .sum(),
            Measurement::Pulses => 10.0 * self.pulse_s,
        };
        seconds / 60.0
    }

    fn frequencies(&self) -> impl Iterator<Item = f64> {
        let (low, high) = self.band_hz;
        let ratio = (high / low).powf(1.0 / (POINTS - 1) as f64);
        (0..POINTS).map(move |k| low * ratio.powi(k as i32))
    }
}

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
    while next.len() < count {
        let Some(best) = planner.best()? else { break };
        next.push(planner.take(&best)?);
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
    taken: Vec<(Wanted, Measurement)>,
}

/// A measurement that may be chosen, with its bench time, min, and the fall of the error per minute.
struct Candidate {
    place: Wanted,
    what: Measurement,
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
            .map(|s| Sweep::new(s, ocv))
            .collect::<Result<Vec<_>, _>>()?;
        let train = Train {
            logs: logs.iter().collect(),
            sweeps: sweeps.iter().collect(),
            lag_s: fit.lag_s,
            scales: fit.scales,
            ocv,
        };
        let places = places(choices);
        let of_loads = loads.iter().map(|load| Wanted {
            soc: load.soc,
            temperature_degc: load.temperature_degc,
        });
        let wanted: Vec<Wanted> = places.into_iter().chain(of_loads).collect();
        let design = Design::new(&train, &wanted, options)?;
        let kinetics = Kinetics {
            series: fit.map.series.activation_j_per_mol,
            branches: fit
                .map
                .branches
                .first()
                .map_or(0.0, |b| b.resistance.activation_j_per_mol),
            exchange_a: fit.map.charge_transfer.map(|law| law.exchange_current_a),
        };
        let covariance = design.equations(&train, kinetics).covariance();
        let covariance = covariance.ok_or(MapFitError::Singular("no place is determined"))?;
        let mut goal = DMatrix::zeros(design.count(), design.count());
        for load in loads {
            let log = Log::new(&log_of(load), ocv)?;
            let duration_s = log.longest_s() * loads.len() as f64;
            design.add_log(
                &log,
                0.0,
                kinetics,
                |stands_s, _| (stands_s / duration_s).sqrt(),
                &mut |rows, _| {
                    goal.gemm(1.0, &rows.transpose(), rows, 1.0);
                },
            );
        }
        Ok(Self {
            fitted,
            choices,
            design,
            kinetics,
            goal,
            covariance,
            taken: Vec::new(),
        })
    }

    /// Predicted error of the voltage under the loads, V.
    fn error_v(&self) -> f64 {
        self.covariance.dot(&self.goal).max(0.0).sqrt()
    }

    /// Finds the measurement with the largest fall of the error per minute.
    fn best(&self) -> Result<Option<Candidate>, MapFitError> {
        let variance = self.covariance.dot(&self.goal);
        let seen = &self.covariance * &self.goal * &self.covariance;
        let mut best: Option<Candidate> = None;
        for place in places(self.choices) {
            for what in [Measurement::Spectrum, Measurement::Pulses] {
                if self.taken.contains(&(place, what)) {
                    continue;
                }
                let rows = self.rows(place, what)?;
                let Some(inverse) = self.innovation(&rows) else {
                    continue;
                };
                let removed = (&rows * &seen * rows.transpose()).dot(&inverse);
                let left = (variance - removed).max(0.0);
                let minutes = self.minutes(place, what);
                let per_minute_v = (variance.sqrt() - left.sqrt()) / minutes;
                if best.as_ref().is_none_or(|b| per_minute_v > b.per_minute_v) {
                    best = Some(Candidate {
                        place,
                        what,
                        minutes,
                        per_minute_v,
                    });
                }
            }
        }
        Ok(best.filter(|candidate| candidate.per_minute_v > 0.0))
    }

    /// Returns (1 + X·Σ·Xᵀ)⁻¹ of the rows of a measurement.
    fn innovation(&self, rows: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let mut matrix = rows * &self.covariance * rows.transpose();
        (0..matrix.nrows()).for_each(|k| matrix[(k, k)] += 1.0);
        matrix.cholesky().map(|factor| factor.inverse())
    }

    /// Takes a measurement as made.
    fn take(&mut self, candidate: &Candidate) -> Result<Next, MapFitError> {
        let Candidate {
            place,
            what,
            minutes,
            ..
        } = *candidate;
        let rows = self.rows(place, what)?;
        if let Some(inverse) = self.innovation(&rows) {
            let gain = &self.covariance * rows.transpose();
            self.covariance -= &gain * inverse * gain.transpose();
        }
        self.taken.push((place, what));
        Ok(Next {
            soc: place.soc,
            temperature_degc: place.temperature_degc,
            what,
            minutes,
            error_v: self.error_v(),
        })
    }

    /// Weighted rows of a measurement that is not yet made.
    fn rows(&self, place: Wanted, what: Measurement) -> Result<DMatrix<f64>, MapFitError> {
        let (design, ocv) = (&self.design, self.fitted.ocv);
        let mut kept = Vec::new();
        let mut keep = |rows: &DMatrix<f64>, _: &_| kept.push(rows.clone());
        match what {
            Measurement::Spectrum => {
                let sweep = Sweep::new(&self.spectrum(place), ocv)?;
                let scale = self.fitted.fit.scales.spectra;
                design.add_sweep(&sweep, scale, self.kinetics, &mut keep);
            }
            Measurement::Pulses => {
                let log = Log::new(&self.pulses(place), ocv)?;
                let train = Train {
                    logs: Vec::new(),
                    sweeps: Vec::new(),
                    lag_s: 0.0,
                    scales: self.fitted.fit.scales,
                    ocv,
                };
                let weight = |stands_s: f64, soc: f64| train.weight(stands_s, soc);
                design.add_log(&log, 0.0, self.kinetics, weight, &mut keep);
            }
        }
        let count = kept.iter().map(DMatrix::nrows).sum();
        let mut all = DMatrix::zeros(count, design.count());
        let mut from = 0;
        for rows in kept {
            all.rows_mut(from, rows.nrows()).copy_from(&rows);
            from += rows.nrows();
        }
        Ok(all)
    }

    /// A spectrum at a place with the impedance that the map has there.
    fn spectrum(&self, place: Wanted) -> MapSpectrum {
        let erm = self
            .fitted
            .fit
            .map
            .model_at(place.soc, place.temperature_degc);
        let points = self.choices.frequencies().map(|freq_hz| MapPoint {
            freq_hz,
            z_ohm: erm.impedance(freq_hz),
            sigma_ohm: None,
        });
        MapSpectrum {
            name: "next".to_owned(),
            role: Role::Train,
            soc: place.soc,
            temperature_degc: place.temperature_degc,
            points: points.collect(),
        }
    }

    /// A discharge, a rest, a charge and a rest, with rows that lie closer after each edge.
    fn pulses(&self, place: Wanted) -> MapLog {
        let (pulse_a, pulse_s) = (self.choices.pulse_a, self.choices.pulse_s);
        let (mut time_s, mut current_a) = (vec![0.0], vec![0.0]);
        let mut from_s = 1.0;
        for (amps, length_s) in [
            (pulse_a, pulse_s),
            (0.0, 4.0 * pulse_s),
            (-pulse_a, pulse_s),
            (0.0, 4.0 * pulse_s),
        ] {
            let before_a = current_a[current_a.len() - 1];
            time_s.push(from_s);
            current_a.push(before_a);
            let mut after_s = 1e-3;
            while after_s < length_s {
                time_s.push(from_s + after_s);
                current_a.push(amps);
                after_s += (0.5 * after_s).max(PULSE_STEP_S);
            }
            from_s += length_s;
        }
        log_of(&Load {
            name: "next".to_owned(),
            time_s,
            current_a,
            soc: place.soc,
            temperature_degc: place.temperature_degc,
        })
    }

    /// Bench time of a measurement with the way to its place, min.
    fn minutes(&self, place: Wanted, what: Measurement) -> f64 {
        let own = self.choices.minutes(what);
        let same_degc =
            |(other, _): &&(Wanted, Measurement)| other.temperature_degc == place.temperature_degc;
        if self.taken.iter().any(|(other, _)| *other == place) {
            return own;
        }
        let here = || self.taken.iter().filter(same_degc);
        let from = here().map(|(other, _)| other.soc).chain([1.0]);
        let way = from.map(|soc| (soc - place.soc).abs()).fold(1.0, f64::min);
        let hours = way * self.fitted.ocv.capacity_ah / self.choices.travel_a;
        let held = if here().next().is_none() {
            self.choices.temperature_min
        } else {
            0.0
        };
        own + 60.0 * hours + held + self.choices.rest_min
    }
}

fn places(choices: &Choices) -> Vec<Wanted> {
    let at = |temperature_degc: &f64| {
        let temperature_degc = *temperature_degc;
        choices.soc.iter().map(move |soc| Wanted {
            soc: *soc,
            temperature_degc,
        })
    };
    choices.temperature_degc.iter().flat_map(at).collect()
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
