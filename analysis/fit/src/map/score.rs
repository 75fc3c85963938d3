//! Error of a map on a log.

use super::log::Log;
use super::sweep::{Sweep, SweepPoint};
use super::train::{CORRELATION_S, Scales, Train};
use analysis_model::map::{BranchStep, CellMap, Drive, ErrorSource, Outside};
use analysis_signal::series::Role;
use num_complex::Complex64;
use serde::Serialize;

/// Lowest SOC that counts for the error of a log: below it the OCV is steep, and an error of charge
/// of 1 % is some ten millivolts.
pub(super) const LEAST_SOC: f64 = 0.1;
/// Width of the bands of SOC in which the error is stated.
const BAND: f64 = 0.1;
/// Rows of a band at least.
const LEAST_ROWS: usize = 20;

/// Error of the predicted voltage on one log, under its own current and temperature.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LogScore {
    /// Name of the log.
    pub name: String,
    /// Whether it was fitted.
    pub role: Role,
    /// Mean temperature, °C.
    pub temperature_degc: f64,
    /// Root of the mean squared error above SOC 0.1, V; NaN if the log lies below.
    pub rms_v: f64,
    /// Mean error (measured less predicted) above SOC 0.1, V.
    pub bias_v: f64,
    /// Root of the mean squared error above SOC 0.1, V, of maps that are fitted without the piece of the
    /// log that they predict; `None` if held-out logs show the error.
    pub left_out_rms_v: Option<f64>,
    /// Share of the samples above SOC 0.1 within the band of 95 % that the other unseen logs show; `None`
    /// without others, and for a fitted log beside held-out ones.
    pub covered: Option<f64>,
    /// Band of 0.1 SOC with the largest error: its lower end and its error, V; of the left-out pieces, if
    /// the log has some.
    pub worst: Option<(f64, f64)>,
    /// Farthest distance from the measured range.
    pub outside: Outside,
}

impl LogScore {
    /// Returns the error on a log that its fit has not seen, V: of the whole log, or piece by piece.
    pub fn unseen_v(&self) -> Option<f64> {
        match self.role {
            Role::HeldOut => Some(self.rms_v),
            Role::Train => self.left_out_rms_v,
        }
    }
}

/// What maps miss of a log, V at each sample.
pub(super) struct LogErrors {
    /// Measured less predicted voltage of the map.
    pub(super) of_map: Vec<f64>,
    /// [`Predicted::lasting_v`] of the map.
    pub(super) lasting_v: Vec<f64>,
    /// That of maps that are fitted without the piece that they predict.
    pub(super) left_out: Option<Vec<f64>>,
    /// Share of the samples in the band that the other unseen logs show.
    pub(super) covered: Option<f64>,
}

impl LogErrors {
    pub(super) fn new(of_map: Predicted) -> Self {
        Self {
            of_map: of_map.residual_v,
            lasting_v: of_map.lasting_v,
            left_out: None,
            covered: None,
        }
    }

    /// Returns what maps miss of a log that they have not seen; `None` if the source of the error does
    /// not contain the log.
    pub(super) fn unseen(&self, from: ErrorSource, log: &Log) -> Option<&[f64]> {
        match from {
            ErrorSource::HeldOut => (log.role == Role::HeldOut).then_some(&*self.of_map),
            ErrorSource::LeftOut => self.left_out.as_deref(),
        }
    }
}

impl LogScore {
    pub(super) fn new(map: &CellMap, log: &Log, errors: &LogErrors) -> Self {
        let chosen = |errors_v: &[f64], low: f64, high: f64| -> Vec<f64> {
            let rows = log.samples.soc.iter().zip(errors_v);
            rows.filter(|(z, e)| **z > low && **z <= high && e.is_finite())
                .map(|(_, e)| *e)
                .collect()
        };
        let counted = chosen(&errors.of_map, LEAST_SOC, f64::INFINITY);
        let left_out = errors.left_out.as_deref();
        let unseen = left_out.unwrap_or(&errors.of_map);
        let bands = (1..10).map(|k| {
            let low = BAND * f64::from(k);
            (low, chosen(unseen, low, low + BAND))
        });
        let worst = bands
            .filter(|(_, rows)| rows.len() >= LEAST_ROWS)
            .map(|(low, rows)| (low, rms(&rows)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let places = log.samples.soc.iter().zip(&log.samples.temperature_degc);
        let outside = places
            .map(|(soc, degc)| map.place(*soc, *degc).outside)
            .fold(Outside::default(), Outside::farther);
        Self {
            name: log.name.clone(),
            role: log.role,
            temperature_degc: log.mean_degc(),
            rms_v: rms(&counted),
            bias_v: counted.iter().sum::<f64>() / counted.len() as f64,
            left_out_rms_v: left_out
                .map(|errors_v| rms(&chosen(errors_v, LEAST_SOC, f64::INFINITY)))
                .filter(|rms_v| rms_v.is_finite()),
            covered: errors.covered,
            worst,
            outside,
        }
    }
}

/// Root of the mean square.
fn rms(rows: &[f64]) -> f64 {
    (rows.iter().map(|e| e * e).sum::<f64>() / rows.len() as f64).sqrt()
}

/// Error of the predicted impedance of one spectrum.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpectrumScore {
    /// Name of the spectrum.
    pub name: String,
    /// Whether it was fitted.
    pub role: Role,
    /// State of charge.
    pub soc: f64,
    /// Temperature, °C.
    pub temperature_degc: f64,
    /// Root of the mean squared error over its points, as a part of the modulus.
    pub rms_part: f64,
    /// What a map misses that is fitted to everything but this spectrum.
    pub left_out: Option<LeftOutScore>,
    /// Distance from the measured range.
    pub outside: Outside,
}

/// What a map misses of a spectrum that it has not seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LeftOutScore {
    /// Root of the mean squared error over its points, as a part of the modulus.
    pub part: f64,
    /// Standard deviation that the map and the scatter of the other spectra state for that error.
    pub sigma_part: f64,
    /// Share of its real and imaginary parts within the band of 95 %.
    pub inside: f64,
}

/// Returns the errors on all spectra; `left_out` is that of a map without one.
pub(super) fn spectra(
    map: &CellMap,
    sweeps: &[Sweep],
    inductance_h: f64,
    left_out: impl Fn(&Sweep) -> Option<LeftOutScore>,
) -> Vec<SpectrumScore> {
    let score = |sweep: &Sweep| SpectrumScore {
        name: sweep.name.clone(),
        role: sweep.role,
        soc: sweep.soc,
        temperature_degc: sweep.temperature_degc,
        rms_part: error_part(map, sweep, inductance_h, 0),
        left_out: left_out(sweep),
        outside: map.place(sweep.soc, sweep.temperature_degc).outside,
    };
    sweeps.iter().map(score).collect()
}

/// Root of the mean squared error of the impedance over the points of a spectrum without the first
/// `low`, as a part of the modulus.
pub(super) fn error_part(map: &CellMap, sweep: &Sweep, inductance_h: f64, low: usize) -> f64 {
    let squares = errors(map, sweep, inductance_h)
        .skip(low)
        .map(|(point, error)| error.norm_sqr() / point.z_ohm.norm_sqr());
    (squares.sum::<f64>() / (sweep.points.len() - low) as f64).sqrt()
}

/// Measured less predicted impedance of each point of a spectrum, Ω.
pub(super) fn errors<'a>(
    map: &CellMap,
    sweep: &'a Sweep,
    inductance_h: f64,
) -> impl Iterator<Item = (&'a SweepPoint, Complex64)> {
    let at = map.place(sweep.soc, sweep.temperature_degc);
    let branches: Vec<(f64, f64)> = map
        .branches
        .iter()
        .map(|branch| (map.resistance_ohm(&branch.resistance, &at), branch.tau_s))
        .collect();
    let series_ohm = map.resistance_ohm(&map.series, &at);
    sweep.points.iter().map(move |point| {
        let own = Complex64::new(series_ohm, point.omega * inductance_h);
        let of = |(r_ohm, tau_s): &(f64, f64)| r_ohm / Complex64::new(1.0, point.omega * tau_s);
        (
            point,
            point.z_ohm - own - branches.iter().map(of).sum::<Complex64>(),
        )
    })
}

/// Least factor on the error of a spectrum: fixed time constants describe none better.
const LEAST_OF_SPECTRA: f64 = 0.5;
/// Least factor on the error of a log.
const LEAST_OF_LOGS: f64 = 0.02;

/// Factors on the errors that the weights assume, from what the map leaves.
pub(super) fn scales(
    map: &CellMap,
    train: &Train,
    residuals: &[&Vec<f64>],
    inductance_h: f64,
) -> Scales {
    let correlation_s = correlation_s(&train.logs, residuals);
    let (mut square, mut count) = (0.0, 0.0);
    for (log, residuals) in train.logs.iter().zip(residuals) {
        // The weights count a row for its time up to the correlation time that they assume; it counts
        // for the correlation time that is found, and at most once.
        let step_s = log.step_s() * log.every() as f64;
        let counted = correlation_s.max(step_s) / CORRELATION_S.max(step_s);
        let errors = log.samples.soc.iter().map(|soc| train.error_v(*soc));
        let own: f64 = residuals
            .iter()
            .zip(errors)
            .map(|(r, e)| (r / e).powi(2))
            .sum();
        square += counted * own;
        count += log.len() as f64;
    }
    let logs = if count > 0.0 {
        (square / count).sqrt().max(LEAST_OF_LOGS)
    } else {
        1.0
    };
    let squares = train.sweeps.iter().map(|sweep| {
        let errors = errors(map, sweep, inductance_h);
        errors
            .skip(sweep.low())
            .map(|(point, error)| (error.norm_sqr() / 2.0) / point.error_ohm.powi(2))
            .sum::<f64>()
    });
    let points = train
        .sweeps
        .iter()
        .map(|sweep| sweep.fitted().len())
        .sum::<usize>();
    let spectra = if points > 0 {
        (squares.sum::<f64>() / points as f64)
            .sqrt()
            .max(LEAST_OF_SPECTRA)
    } else {
        1.0
    };
    Scales { logs, spectra }
}

/// Measured less predicted voltage, V, at each sample of a log whose voltage lags its current.
pub(super) fn residuals(map: &CellMap, log: &Log, lag_s: f64) -> Vec<f64> {
    predict(map, log, lag_s).residual_v
}

/// What a map predicts of a log.
pub(super) struct Predicted {
    /// Measured less predicted voltage at each sample, V.
    pub(super) residual_v: Vec<f64>,
    /// Overpotential at each sample without signs, V: that of the series resistance, and of each branch
    /// the largest so far, which fades with its time constant.
    pub(super) lasting_v: Vec<f64>,
}

/// Predicts a log whose voltage lags its current.
pub(super) fn predict(map: &CellMap, log: &Log, lag_s: f64) -> Predicted {
    let samples = &log.samples;
    let current_a = log.lagged_a(lag_s);
    let count = map.branches.len();
    let (mut v, mut branch_ohm) = (vec![0.0; count], vec![0.0; count]);
    let mut before = vec![Drive::new(None, 0.0, 0.0); count];
    let (mut residual_v, mut lasting_v) = (Vec::new(), Vec::new());
    let mut largest_v = vec![0.0_f64; count];
    for k in 0..log.len() {
        let (soc, degc, i) = (samples.soc[k], samples.temperature_degc[k], current_a[k]);
        let values = map.values(soc, degc, &mut branch_ohm);
        let branches = map.branches.iter().zip(&branch_ohm);
        let states = v.iter_mut().zip(&mut before).zip(&mut largest_v);
        for (((v, before), largest_v), (branch, r_ohm)) in states.zip(branches) {
            let drive = values.drive(branch.tau_s, *r_ohm, i);
            if log.begins_at(k) {
                *v = 0.0;
                *largest_v = 0.0;
            } else {
                let step_s = samples.time_s[k] - samples.time_s[k - 1];
                *v = BranchStep::new(step_s, branch.tau_s)
                    .bent_end(*v, *before, drive)
                    .v;
                *largest_v = (*largest_v * (-step_s / branch.tau_s).exp()).max(v.abs());
            }
            *before = drive;
        }
        let ocv_v = samples.ocv_v[k] + values.correction_v;
        let predicted_v = ocv_v - values.r_ohm * i - v.iter().sum::<f64>();
        residual_v.push(samples.voltage_v[k] - predicted_v);
        lasting_v.push((values.r_ohm * i).abs() + largest_v.iter().sum::<f64>());
    }
    Predicted {
        residual_v,
        lasting_v,
    }
}

/// Time over which residuals are correlated, s: twice the integral of their autocorrelation up to
/// its first zero, the mean over the logs.
pub(super) fn correlation_s(logs: &[&Log], residuals: &[&Vec<f64>]) -> f64 {
    let times = logs.iter().zip(residuals).map(|(log, residuals)| {
        let n = residuals.len();
        let mean = residuals.iter().sum::<f64>() / n as f64;
        let step_s = (log.samples.time_s[n - 1] - log.samples.time_s[0]) / (n - 1) as f64;
        let product = |lag: usize| {
            let pairs = residuals.iter().zip(&residuals[lag..]);
            pairs.map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>()
        };
        let whole = product(0);
        if whole <= 0.0 {
            return step_s;
        }
        // Lags grow, so that slow residuals are seen as well as fast ones.
        let (mut lag, mut last, mut integral_s) = (0_usize, 1.0, 0.0);
        while lag < n / 2 {
            let next = (lag + 1).max(lag * 5 / 4);
            let share = product(next.min(n - 1)) / whole;
            let width_s = (next - lag) as f64 * step_s;
            integral_s += 0.5 * width_s * (last + share.max(0.0));
            if share <= 0.0 {
                break;
            }
            (lag, last) = (next, share);
        }
        2.0 * integral_s
    });
    times.sum::<f64>() / logs.len().max(1) as f64
}
