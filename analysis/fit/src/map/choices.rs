//! Measurements that a bench can make next, and their times.

use serde::Serialize;

/// Lowest and highest frequency of a spectrum, Hz, and number of its points, if a bench states none.
const BAND_HZ: (f64, f64) = (0.1, 300.0);
const POINTS: usize = 20;
/// Periods of each of its points, with those before the record.
const PERIODS: f64 = 14.0;
/// Time between two points, s.
const BETWEEN_S: f64 = 3.0;
/// Duration of a pulse, s, and of the rest after it, as a multiple.
const PULSE_S: f64 = 10.0;
const REST_PARTS: f64 = 4.0;

/// What may be measured at a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Measurement {
    /// A spectrum.
    Spectrum,
    /// Pulses in both directions.
    Pulses,
}

/// Part of a record of pulses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PulsePart {
    /// Current, A, discharge positive; zero for a rest.
    pub current_a: f64,
    /// Duration, s.
    pub duration_s: f64,
}

/// A measurement as the bench makes it.
#[derive(Debug, Clone, PartialEq)]
pub enum Signal {
    /// A spectrum.
    Spectrum {
        /// Its frequencies, Hz.
        freqs_hz: Vec<f64>,
    },
    /// Pulses and rests.
    Pulses(Vec<PulsePart>),
}

/// A measurement that a bench can make.
#[derive(Debug, Clone, PartialEq)]
pub struct Offer {
    /// State of charge, 0…1.
    pub soc: f64,
    /// Temperature, °C.
    pub temperature_degc: f64,
    /// What is measured.
    pub signal: Signal,
    /// Duration without the way to its place, min.
    pub minutes: f64,
}

impl Offer {
    /// Its kind.
    pub fn measurement(&self) -> Measurement {
        match self.signal {
            Signal::Spectrum { .. } => Measurement::Spectrum,
            Signal::Pulses(_) => Measurement::Pulses,
        }
    }
}

/// Measurements to choose from, and the times of a bench.
#[derive(Debug, Clone, PartialEq)]
pub struct Choices {
    /// The measurements.
    pub offers: Vec<Offer>,
    /// Rest before the first measurement at a place, min.
    pub rest_min: f64,
    /// Time to change the temperature and to hold it, with what the bench does before it, min.
    pub temperature_min: f64,
    /// Current from one state of charge to the next, A.
    pub travel_a: f64,
}

impl Choices {
    /// States of charge to choose from if nothing else is stated: every 10 %.
    pub const SOC: [f64; 9] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9];

    /// Returns the choices of an unknown bench for a cell of a capacity, Ah: spectra of 20 points from
    /// 0.1 to 300 Hz and pulses of 2C and 10 s both ways at each state of charge and temperature, °C.
    pub fn new(capacity_ah: f64, socs: &[f64], temperatures_degc: &[f64]) -> Self {
        let signals = [spectrum(), pulses(2.0 * capacity_ah)];
        let mut offers = Vec::new();
        for temperature_degc in temperatures_degc {
            for soc in socs {
                offers.extend(signals.iter().map(|(signal, minutes)| Offer {
                    soc: *soc,
                    temperature_degc: *temperature_degc,
                    signal: signal.clone(),
                    minutes: *minutes,
                }));
            }
        }
        Self {
            offers,
            rest_min: 30.0,
            temperature_min: 60.0,
            travel_a: 0.5 * capacity_ah,
        }
    }
}

/// A spectrum, and its duration, min.
fn spectrum() -> (Signal, f64) {
    let (low, high) = BAND_HZ;
    let ratio = (high / low).powf(1.0 / (POINTS - 1) as f64);
    let freqs_hz: Vec<f64> = (0..POINTS).map(|k| low * ratio.powi(k as i32)).collect();
    let spans_s = freqs_hz.iter().map(|freq_hz| PERIODS / freq_hz + BETWEEN_S);
    let minutes = spans_s.sum::<f64>() / 60.0;
    (Signal::Spectrum { freqs_hz }, minutes)
}

/// A discharge, a rest, a charge and a rest, and their duration, min.
fn pulses(pulse_a: f64) -> (Signal, f64) {
    let part = |current_a: f64, parts: f64| PulsePart {
        current_a,
        duration_s: parts * PULSE_S,
    };
    let parts = vec![
        part(pulse_a, 1.0),
        part(0.0, REST_PARTS),
        part(-pulse_a, 1.0),
        part(0.0, REST_PARTS),
    ];
    let seconds: f64 = parts.iter().map(|part| part.duration_s).sum();
    (Signal::Pulses(parts), seconds / 60.0)
}
