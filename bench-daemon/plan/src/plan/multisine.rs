//! A multisine as data: one band of lines that are driven at once, and its record.

use std::fmt;

use analysis_signal::multisine::{Design, Disturbed};

use instruments::units::{Amps, Hertz, Seconds};

use super::minutes;
use crate::{interlock::Limits, measure::quality::Quality};

/// One band.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Its number, from 1.
    pub number: usize,
    /// Base frequency, Hz: the inverse of the period.
    pub base_hz: Hertz,
    /// Lines and phases.
    pub design: Design,
    /// Steps of one period in the generator.
    pub steps: usize,
    /// Peak of the current, A.
    pub peak_a: Amps,
    /// Wait before the record, s.
    pub settle_s: Seconds,
    /// Length of the record, whole periods, s.
    pub span_s: Seconds,
    /// Points in the scope's memory per channel.
    pub memory_points: u64,
    /// Points downloaded per channel.
    pub record_points: u64,
    /// Requested harmonics, and those that replaced them because images of the generator's steps
    /// would have fallen onto the requested ones.
    pub moved: Vec<(usize, usize)>,
    /// The line that images disturb most in theory; `None` if no image falls onto a line.
    pub disturbed: Option<Disturbed>,
    /// The quality gate.
    pub quality: Option<Quality>,
}

impl Band {
    /// Returns the greatest mean magnitude of the current, A: its effective value.
    pub fn mean_a(&self) -> Amps {
        self.peak_a / self.design.crest_factor
    }

    /// Returns the number of periods in the record.
    pub fn periods(&self) -> f64 {
        self.span_s * self.base_hz
    }

    /// Returns the expected duration, s; the upper bound is separate.
    pub(super) fn expected_s(&self) -> Seconds {
        self.settle_s + self.span_s
    }

    /// Returns an error if the band could exceed the limits of the cell.
    pub(super) fn check(&self, limits: &Limits) -> Result<(), String> {
        let greatest_a = limits.charge_a.min(limits.discharge_a);
        if !(self.peak_a > Amps::ZERO && self.peak_a <= greatest_a) {
            return Err(format!(
                "expected a peak above 0 A, at most {greatest_a}, found {}",
                self.peak_a
            ));
        }
        let sound = !self.design.harmonics.is_empty()
            && self.base_hz > Hertz::ZERO
            && (self.periods() - self.periods().round()).abs() < 1.0e-6;
        sound.then_some(()).ok_or_else(|| {
            format!(
                "expected lines and a record of whole periods, found {} of {:.4}",
                self.design.harmonics.len(),
                self.periods()
            )
        })
    }
}

impl fmt::Display for Band {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let hertz = |harmonic: Option<&usize>| {
            harmonic.map_or(Hertz::NAN, |harmonic| *harmonic as f64 * self.base_hz)
        };
        let (first, last) = (
            hertz(self.design.harmonics.first()),
            hertz(self.design.harmonics.last()),
        );
        write!(
            f,
            "multisine {}: {} lines from {first:.4} to {last:.4}, peak {}, {:.3} A each \
            (crest factor {:.2}), settle {}, {:.0} periods in {}",
            self.number,
            self.design.harmonics.len(),
            self.peak_a,
            (self.design.amplitude * self.peak_a).0,
            self.design.crest_factor,
            minutes(self.settle_s),
            self.periods(),
            minutes(self.span_s)
        )?;
        self.fmt_images(f)
    }
}

impl Band {
    /// Formats the images of the generator's steps, as the plan prints them.
    fn fmt_images(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let hertz = |harmonic: usize| harmonic as f64 * self.base_hz;
        write!(
            f,
            "; {} steps and {:.0} points a period",
            self.steps,
            self.record_points as f64 / self.periods()
        )?;
        for (from, to) in &self.moved {
            write!(
                f,
                ", {:.4} Hz moved to {:.4} Hz",
                hertz(*from).0,
                hertz(*to).0
            )?;
        }
        let Some(Disturbed { image, error_ohm }) = self.disturbed else {
            return write!(f, ", no image of a step on a line");
        };
        write!(
            f,
            ", images of the steps on lines at most about {:.1} µΩ, on {:.4} Hz that of {:.4} Hz \
            at {:.0} kHz",
            1.0e6 * error_ohm,
            hertz(image.onto).0,
            hertz(image.of).0,
            1.0e-3 * hertz(image.at).0
        )
    }
}
