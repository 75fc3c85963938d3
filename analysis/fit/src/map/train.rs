//! The data of a fit.

use super::log::Log;
use super::sweep::Sweep;
use analysis_model::ocv::OcvCurve;
use analysis_signal::series::Role;
use serde::Serialize;

/// Error of the model that the weights assume, V, and the time over which it is correlated, s.
pub(super) const ERROR_V: f64 = 0.01;
pub(super) const CORRELATION_S: f64 = 10.0;
/// Error of the counted charge, as SOC: where the OCV is steep, the voltage says less.
pub(super) const SOC_ERROR: f64 = 0.005;

/// Least fall of the cost by one more unknown, as a part of the cost and as a multiple of that of one
/// independent value: the data must show it, and it must matter.
const LEAST_GAIN: f64 = 0.03;
const LEAST_OF_ONE: f64 = 10.0;

/// Factors on the errors that the weights assume: 10 mV over 10 s of a log, 2 % of an impedance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Scales {
    /// That of the logs.
    pub logs: f64,
    /// That of the spectra.
    pub spectra: f64,
}

impl Default for Scales {
    fn default() -> Self {
        Self {
            logs: 1.0,
            spectra: 1.0,
        }
    }
}

/// Logs and spectra that are fitted.
#[derive(Debug, Clone)]
pub(super) struct Train<'a> {
    pub(super) logs: Vec<&'a Log>,
    pub(super) sweeps: Vec<&'a Sweep>,
    /// Time by which the voltage of the logs lags their current, s.
    pub(super) lag_s: f64,
    pub(super) scales: Scales,
    pub(super) ocv: &'a OcvCurve,
}

impl<'a> Train<'a> {
    /// Takes the logs and spectra that are fitted.
    pub(super) fn new(logs: &'a [Log], sweeps: &'a [Sweep], ocv: &'a OcvCurve) -> Self {
        Self {
            logs: logs.iter().filter(|log| log.role == Role::Train).collect(),
            sweeps: sweeps.iter().filter(|sweep| sweep.is_fitted()).collect(),
            lag_s: 0.0,
            scales: Scales::default(),
            ocv,
        }
    }

    /// Returns the error of the model that the weights of the logs assume at a SOC, V.
    pub(super) fn error_v(&self, soc: f64) -> f64 {
        ERROR_V.hypot(SOC_ERROR * self.ocv.slope_v(soc))
    }

    /// Returns the weight of a row of a log that stands for a time, s, up to the correlation time.
    pub(super) fn weight(&self, stands_s: f64, soc: f64) -> f64 {
        let stands = stands_s.min(CORRELATION_S) / CORRELATION_S;
        stands.sqrt() / (self.error_v(soc) * self.scales.logs)
    }

    /// Number of independent values that the weights assume.
    pub(super) fn independent(&self) -> f64 {
        let of_log = |log: &&Log| {
            let step_s = log.step_s() * log.every() as f64;
            log.rows() as f64 * (step_s.min(CORRELATION_S) / CORRELATION_S)
        };
        let of_sweeps = self
            .sweeps
            .iter()
            .map(|sweep| 2 * sweep.fitted().len())
            .sum::<usize>();
        self.logs.iter().map(of_log).sum::<f64>() + of_sweeps as f64
    }

    /// Returns whether a cost with one more unknown is so much lower that the data show it.
    pub(super) fn shows_more(&self, cost_with: f64, cost_without: f64) -> bool {
        let of_one = cost_without / self.independent();
        cost_without - cost_with > (LEAST_GAIN * cost_without).max(LEAST_OF_ONE * of_one)
    }

    /// Largest current of the logs, A; `None` without logs.
    pub(super) fn most_current_a(&self) -> Option<f64> {
        let currents_a = self.logs.iter().flat_map(|log| &log.samples.current_a);
        currents_a.map(|current_a| current_a.abs()).reduce(f64::max)
    }

    /// Highest angular frequency of the fitted spectra without their inductive points, rad/s; `None` without
    /// spectra.
    pub(super) fn highest_omega(&self) -> Option<f64> {
        let highest = self.sweeps.iter().filter_map(|sweep| sweep.fitted().last());
        highest.map(|point| point.omega).reduce(f64::max)
    }

    /// Shortest step of the logs, s; infinite without logs.
    pub(super) fn shortest_step_s(&self) -> f64 {
        let steps_s = self.logs.iter().map(|log| log.step_s());
        steps_s.fold(f64::INFINITY, f64::min)
    }

    /// Lowest and highest SOC.
    pub(super) fn range_of_soc(&self) -> (f64, f64) {
        let of_logs = self.logs.iter().flat_map(|log| &log.samples.soc).copied();
        let all = of_logs.chain(self.sweeps.iter().map(|sweep| sweep.soc));
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| {
            (low.min(z), high.max(z))
        })
    }

    /// Returns whether a log or a spectrum shows a branch of this time constant. A log shows one of at
    /// least two of its steps, because a faster one looks like a lag of the voltage.
    pub(super) fn shows(&self, tau_s: f64) -> bool {
        self.log_shows(tau_s) || self.sweeps.iter().any(|sweep| sweep.shows(tau_s))
    }

    /// Returns whether a log shows a branch of this time constant.
    pub(super) fn log_shows(&self, tau_s: f64) -> bool {
        let log = |log: &&Log| tau_s >= 2.0 * log.step_s() && tau_s <= log.longest_s();
        self.logs.iter().any(log)
    }
}
