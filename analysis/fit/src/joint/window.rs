//! A pulse as the likelihood sees it: means over bins that grow with the time since the edge, and
//! their covariance.
//!
//! The voltage is offset + OCV(SOC(t)) − g·Σⱼ ΔIⱼ·S(t − tⱼ). The offset is free (its prior is ±20
//! mV); the OCV's course over the window may be wrong by a factor 1 ± 20 %, for the curve comes
//! from another discharge and its slope is known worst. Both are linear with normal priors, so they
//! are not fitted but put into the covariance of the bins. The cell is taken to be in the steady
//! state of the current before the pulse.

use super::noise::NoiseModel;
use super::pulse::Pulse;
use super::response::{add_step, step_resistance_ohm};
use analysis_model::{model::Erm, ocv::OcvCurve};
use analysis_numeric::linalg;
use analysis_signal::series::TimeSeries;

/// Prior of the offset, V.
const OFFSET_V: f64 = 0.02;
/// Length of a bin over the time since its edge.
const GROWTH: f64 = 0.3;

/// Options of the part of a pulse that is used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowOptions {
    /// Steady current before the pulse, s.
    pub before_s: f64,
    /// Relaxation after it, s.
    pub after_s: f64,
    /// Relative uncertainty of the OCV's slope.
    pub slope_sigma: f64,
}

impl Default for WindowOptions {
    /// 30 s before, 120 s after, OCV slope within 20 %.
    fn default() -> Self {
        Self {
            before_s: 30.0,
            after_s: 120.0,
            slope_sigma: 0.2,
        }
    }
}

/// Mean over neighbouring samples.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Bin {
    pub(super) times_s: Vec<f64>,
    pub(super) voltage_v: f64,
    /// Course of the OCV since the start of the window, V.
    pub(super) ocv_v: f64,
}

/// Pulse, bins and what whitens them.
#[derive(Debug, Clone, PartialEq)]
pub struct PulseWindow {
    /// Number of the pulse in its series, from 1.
    pub number: usize,
    /// The pulse.
    pub pulse: Pulse,
    /// SOC at the edge.
    pub soc: f64,
    /// OCV at the edge, V.
    pub ocv_v: f64,
    pub(super) bins: Vec<Bin>,
    /// Cholesky factor of the bins' covariance, row-major.
    factor: Vec<f64>,
}

impl PulseWindow {
    /// Creates the window of a pulse, its state of charge from the voltage before it plus the drop
    /// over `dcir_ohm`; `None` if the OCV curve does not reach it or the pulse has too few samples.
    pub fn new(
        series: &TimeSeries,
        noise: &NoiseModel,
        curve: &OcvCurve,
        number: usize,
        pulse: Pulse,
        dcir_ohm: f64,
        options: &WindowOptions,
    ) -> Option<Self> {
        let edge = pulse.before.end - 1;
        let base = pulse.before.end.saturating_sub(16).max(pulse.before.start)..pulse.before.end;
        let mean = base.clone().map(|k| series.voltage_v[k]).sum::<f64>() / base.len() as f64;
        let ocv_v = mean + pulse.current_a[0] * dcir_ohm;
        let soc = curve.soc_at(ocv_v)?;
        let charge = series.charge_coulomb();
        let course = |k: usize| {
            curve.voltage_v(soc - (charge[k] - charge[edge]) / (3600.0 * curve.capacity_ah)) - ocv_v
        };
        let groups = groups(series, &pulse, options);
        let bins: Vec<Bin> = groups
            .iter()
            .map(|g| {
                let mean = |f: &dyn Fn(usize) -> f64| {
                    g.iter().map(|k| f(*k)).sum::<f64>() / g.len() as f64
                };
                let times_s = g.iter().map(|k| series.time_s[*k]).collect();
                Bin {
                    times_s,
                    voltage_v: mean(&|k| series.voltage_v[k]),
                    ocv_v: mean(&course),
                }
            })
            .collect();
        let n = bins.len();
        let mut factor = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..n {
                factor[i * n + j] = OFFSET_V * OFFSET_V
                    + options.slope_sigma * options.slope_sigma * bins[i].ocv_v * bins[j].ocv_v;
            }
            factor[i * n + i] += noise.variance_v2(groups[i].len());
        }
        let enough = n >= 8 && linalg::cholesky(&mut factor, n);
        enough.then_some(Self {
            number,
            pulse,
            soc,
            ocv_v,
            bins,
            factor,
        })
    }

    /// Number of bins.
    pub fn bins(&self) -> usize {
        self.bins.len()
    }

    /// Model voltage of each bin but for the offset, V, and its derivatives with respect to the
    /// logarithmic parameters, ln g and the edge's place.
    pub(super) fn model(&self, erm: &Erm, gain: f64, edge: f64) -> Vec<(f64, Vec<f64>)> {
        let parameters = erm.parameter_count();
        let one = |bin: &Bin| {
            let mut slopes = vec![0.0; parameters + 2];
            let share = 1.0 / bin.times_s.len() as f64;
            let mut lost = 0.0;
            for time_s in &bin.times_s {
                for (j, (last, first)) in self.pulse.edges_s.iter().enumerate() {
                    let step = self.pulse.current_a[j + 1] - self.pulse.current_a[j];
                    if time_s < first {
                        continue;
                    }
                    let gap = first - last;
                    let weight = -gain * step * share;
                    let (value, rate) =
                        add_step(erm, time_s - last - edge * gap, weight, &mut slopes);
                    lost += value;
                    slopes[parameters + 1] -= rate * gap;
                }
            }
            slopes[parameters] = lost;
            (bin.ocv_v + lost, slopes)
        };
        self.bins.iter().map(one).collect()
    }

    /// Model voltage of each bin alone, V: what a search mostly asks for.
    pub(super) fn voltages(&self, erm: &Erm, gain: f64, edge: f64) -> Vec<f64> {
        let lost = |time_s: &f64| {
            let steps = self
                .pulse
                .edges_s
                .iter()
                .enumerate()
                .filter(|(_, (_, first))| time_s >= first);
            let one = |(j, (last, first)): (usize, &(f64, f64))| {
                let step = self.pulse.current_a[j + 1] - self.pulse.current_a[j];
                step * step_resistance_ohm(erm, time_s - last - edge * (first - last))
            };
            steps.map(one).sum::<f64>()
        };
        self.bins
            .iter()
            .map(|b| {
                b.ocv_v - gain * b.times_s.iter().map(lost).sum::<f64>() / b.times_s.len() as f64
            })
            .collect()
    }

    /// Turns a vector over the bins into one whose errors are independent and of variance 1.
    pub(super) fn whiten(&self, values: &mut [f64]) {
        let n = self.bins.len();
        for i in 0..n {
            let dot: f64 = (0..i).map(|k| self.factor[i * n + k] * values[k]).sum();
            values[i] = (values[i] - dot) / self.factor[i * n + i];
        }
    }
}

/// Samples of each bin: of 10 s before the pulse, growing with the time since the edge during and
/// after it.
fn groups(series: &TimeSeries, pulse: &Pulse, options: &WindowOptions) -> Vec<Vec<usize>> {
    let time = |k: &usize| series.time_s[*k];
    let mut found: Vec<Vec<usize>> = Vec::new();
    let start = pulse.edges_s[0].0;
    let before = pulse
        .before
        .clone()
        .filter(|k| start - time(k) <= options.before_s);
    let mut last = f64::NEG_INFINITY;
    for k in before {
        if time(&k) - last > 10.0 {
            last = time(&k);
            found.push(Vec::new());
        }
        found
            .iter_mut()
            .next_back()
            .into_iter()
            .for_each(|g| g.push(k));
    }
    let after_edge = |edge: f64, range: std::ops::Range<usize>| {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        let mut until = f64::NEG_INFINITY;
        for k in range {
            let since = time(&k) - edge;
            if since >= until {
                groups.push(Vec::new());
                until = since * (1.0 + GROWTH);
            }
            groups
                .iter_mut()
                .next_back()
                .into_iter()
                .for_each(|g| g.push(k));
        }
        groups
    };
    found.extend(after_edge(start, pulse.during.clone()));
    let end = pulse.edges_s[1].0;
    let stop = pulse
        .after
        .clone()
        .find(|k| time(k) - end > options.after_s)
        .unwrap_or(pulse.after.end);
    found.extend(after_edge(end, pulse.after.start..stop));
    found
}
