//! The trend of a voltage before a pulse, continued into the pulse.
//!
//! A cell relaxes by exponentials, and by diffusion with the root of time. The trend is a mean of shapes
//! a + b f(t), f a straight line, an exponential of several time constants or an inverse root of the time
//! since the load before, each weighted by how well it follows the rows before the pulse. Where the rows
//! do not decide between the shapes, their difference is part of the uncertainty.

use crate::loads::Estimate;

/// Time constants of the exponentials, as parts of the window.
const TAU_PARTS: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];
/// Fewest rows of a straight line.
const FEWEST_OF_LINE: usize = 3;
/// Fewest rows of an exponential.
const FEWEST_OF_CURVE: usize = 4;
/// Standard deviations of a variance's estimate beyond which the rows scatter more than the log does.
const SURE: f64 = 3.0;

/// Noise of one row of a channel.
#[derive(Debug, Clone, Copy)]
pub(super) struct RowNoise {
    /// Variance of a row with the error of its code.
    pub(super) variance: f64,
    /// Variance that rows share because the codes hide their noise.
    pub(super) shared: f64,
}

impl RowNoise {
    /// Combines the scatter of some rows with the noise of the log: it is the noise of the log unless
    /// the rows scatter more than chance allows. `None` if neither is known.
    pub(super) fn of(local: Option<Scatter>, log: Option<f64>, code: Option<f64>) -> Option<Self> {
        let of_code = code.map_or(0.0, |code| code * code / 12.0);
        let of_log = log.map(|sigma| sigma * sigma + of_code);
        let found = match (local, of_log) {
            (Some(local), Some(log)) => {
                let most = log * (1.0 + SURE * (2.0 / local.freedom).sqrt());
                if local.variance > most {
                    local.variance
                } else {
                    log
                }
            }
            (Some(local), None) => local.variance.max(of_code),
            (None, log) => log?,
        };
        let dithered = found >= 2.0 * of_code;
        Some(Self {
            variance: found.max(of_code),
            shared: if dithered { 0.0 } else { of_code },
        })
        .filter(|noise| noise.variance > 0.0)
    }

    /// Noise of the voltage.
    pub(super) fn of_voltage(local: Option<Scatter>, log: &Estimate) -> Option<Self> {
        let hidden = log.voltage_noise_hidden;
        let sigma = log.voltage_noise_v.filter(|_| !hidden);
        // Hidden noise is less than the error of the codes.
        let sigma = sigma.or(log.voltage_resolution_v.filter(|_| hidden).map(|_| 0.0));
        Self::of(local, sigma, log.voltage_resolution_v)
    }

    /// Noise of the current.
    pub(super) fn of_current(local: Option<Scatter>, log: &Estimate) -> Option<Self> {
        let hidden = log.current_noise_hidden;
        let sigma = log.current_noise_a.filter(|_| !hidden);
        let sigma = sigma.or(log.current_resolution_a.filter(|_| hidden).map(|_| 0.0));
        Self::of(local, sigma, log.current_resolution_a)
    }
}

/// Scatter of rows about their trend.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scatter {
    pub(super) variance: f64,
    pub(super) freedom: f64,
}

/// A voltage that the trend has at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Level {
    pub(super) v: f64,
    /// Its variance, V²; `None` if the noise is not known.
    pub(super) variance: Option<f64>,
}

/// How a voltage goes on.
#[derive(Debug, Clone, Copy)]
enum Form {
    Line,
    /// With a time constant, s.
    Exponential(f64),
    /// After a load that ended this time before the pulse, s.
    Diffusion(f64),
}

impl Form {
    fn at(self, age_s: f64) -> f64 {
        match self {
            Self::Line => age_s,
            Self::Exponential(tau_s) => (-age_s / tau_s).exp(),
            Self::Diffusion(rest_s) => (rest_s + age_s).sqrt().recip(),
        }
    }
}

/// One shape, fitted.
#[derive(Debug)]
struct Shape {
    form: Form,
    a: f64,
    b: f64,
    squares: f64,
    /// Variances and covariance of a and b for a row's variance of 1.
    spread: [f64; 3],
    freedom: f64,
}

/// The trend of some rows.
#[derive(Debug)]
pub(super) struct Trend {
    shapes: Vec<Shape>,
    /// Noise of a row; `None` if it is not known.
    pub(super) noise: Option<RowNoise>,
}

impl Trend {
    /// Fits the rows before a pulse; ages are negative, in s from its start. `rest_s`: time since the load
    /// before, s.
    pub(super) fn of(age_s: &[f64], voltage_v: &[f64], rest_s: f64, log: &Estimate) -> Self {
        let window_s = age_s.first().map_or(0.0, |first| -first);
        let mut forms = vec![Form::Line];
        if age_s.len() >= FEWEST_OF_CURVE {
            forms.extend(TAU_PARTS.map(|part| Form::Exponential(part * window_s)));
            if rest_s > window_s {
                forms.push(Form::Diffusion(rest_s));
            }
        }
        let fit = |form| fitted(age_s, voltage_v, form);
        let shapes: Vec<Shape> = forms.into_iter().map(fit).collect();
        let best = shapes
            .iter()
            .min_by(|a, b| a.squares.total_cmp(&b.squares))
            .filter(|best| best.freedom > 0.0);
        let local = best.map(|best| Scatter {
            variance: best.squares / best.freedom,
            freedom: best.freedom,
        });
        let noise = RowNoise::of_voltage(local, log);
        Self { shapes, noise }
    }

    /// The voltage at an age.
    pub(super) fn at(&self, age_s: f64) -> Level {
        let least = self.shapes.iter().map(|shape| shape.squares);
        let least = least.fold(f64::INFINITY, f64::min);
        let weight = |shape: &Shape| match self.noise {
            Some(noise) => (-0.5 * (shape.squares - least) / noise.variance).exp(),
            None => f64::from(u8::from(shape.squares == least)),
        };
        let total: f64 = self.shapes.iter().map(weight).sum();
        let mean = |of: &dyn Fn(&Shape) -> f64| {
            let all = self.shapes.iter().map(|shape| weight(shape) * of(shape));
            all.sum::<f64>() / total
        };
        let v = mean(&|shape| shape.at(age_s));
        let variance = self.noise.map(|noise| {
            let between = mean(&|shape| (shape.at(age_s) - v).powi(2));
            between + noise.variance * mean(&|shape| shape.variance(age_s)) + noise.shared
        });
        Level { v, variance }
    }
}

impl Shape {
    fn at(&self, age_s: f64) -> f64 {
        self.a + self.b * self.form.at(age_s)
    }

    /// Variance at an age for a row's variance of 1.
    fn variance(&self, age_s: f64) -> f64 {
        let f = self.form.at(age_s);
        let [aa, ab, bb] = self.spread;
        aa + 2.0 * ab * f + bb * f * f
    }
}

/// Least squares of a + b f(t); a alone if there are too few rows.
fn fitted(age_s: &[f64], voltage_v: &[f64], form: Form) -> Shape {
    #[expect(clippy::cast_precision_loss, reason = "a number of rows")]
    let count = age_s.len() as f64;
    let f: Vec<f64> = age_s.iter().map(|age| form.at(*age)).collect();
    let mean = |all: &[f64]| all.iter().sum::<f64>() / count;
    let (f0, v0) = (mean(&f), mean(voltage_v));
    let sum = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
        f.iter()
            .zip(voltage_v)
            .map(|(f, v)| of(f - f0, v - v0))
            .sum()
    };
    let spread = sum(&|f, _| f * f);
    let has_slope = age_s.len() >= FEWEST_OF_LINE && spread > 0.0;
    let b = if has_slope {
        sum(&|f, v| f * v) / spread
    } else {
        0.0
    };
    let bb = if has_slope { 1.0 / spread } else { 0.0 };
    Shape {
        form,
        a: v0 - b * f0,
        b,
        squares: sum(&|f, v| (v - b * f).powi(2)),
        spread: [1.0 / count + bb * f0 * f0, -bb * f0, bb],
        freedom: count - 1.0 - f64::from(u8::from(has_slope)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rows of a rest of 40 s after a load, one every 4 s, with noise of 20 µV.
    #[test]
    fn a_few_rows_of_a_relaxation_by_diffusion_are_continued_within_the_stated_error() {
        let truth_v = |age_s: f64| 3.7 - 0.03 / (40.0 + age_s).sqrt();
        let age_s: Vec<f64> = (1..=5).rev().map(|k| -4.0 * f64::from(k)).collect();
        let voltage_v: Vec<f64> = age_s.iter().map(|age_s| truth_v(*age_s)).collect();
        let log = Estimate {
            voltage_noise_v: Some(2e-5),
            ..Estimate::default()
        };
        let level = Trend::of(&age_s, &voltage_v, 40.0, &log).at(10.0);
        let sigma_v = level.variance.unwrap().sqrt();
        assert!((level.v - truth_v(10.0)).abs() < 2.0 * sigma_v, "{level:?}");
        let line = fitted(&age_s, &voltage_v, Form::Line);
        let line_v = (line.at(10.0) - truth_v(10.0)).abs();
        assert!(
            (level.v - truth_v(10.0)).abs() < 0.5 * line_v,
            "{level:?} {line_v}"
        );
        assert!(sigma_v < line_v, "{sigma_v} {line_v}");
    }
}
