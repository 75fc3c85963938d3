//! The mean of a periodic current, from readings that follow it.

use std::collections::VecDeque;

use instruments::units::{Amps, Seconds};

use super::allowance::Mean;

/// Least number of readings in a period that give its mean.
pub(super) const FEWEST: f64 = 4.0;

/// Bench times, s, and currents, A, of one period of the present sinusoid.
#[derive(Debug, Default)]
pub(super) struct Period(VecDeque<(Seconds, Amps)>);

impl Period {
    /// Drops the readings so far, because they do not belong to one signal or their times are
    /// unknown.
    pub(super) fn lose(&mut self) {
        self.0.clear();
    }

    /// Adds a reading, and drops those before the last period.
    pub(super) fn take(&mut self, mean: &Mean, time_s: Seconds, current_a: Amps) {
        self.0.push_back((time_s, current_a));
        let from_s = time_s - mean.period_s;
        while self.0.get(1).is_some_and(|(time_s, _)| *time_s <= from_s) {
            self.0.pop_front();
        }
    }

    /// Returns the mean of a function of the current over the last period, by the trapezoidal
    /// rule, as soon as a complete period was read.
    pub(super) fn mean_of(&self, mean: &Mean, of: impl Fn(Amps) -> f64) -> Option<f64> {
        let pairs = || self.0.iter().zip(self.0.iter().skip(1));
        let from_s = self.0.back()?.0 - mean.period_s;
        // Readings that are too rare do not define a mean.
        let apart_s = pairs()
            .map(|(one, other)| other.0 - one.0)
            .fold(Seconds::ZERO, Seconds::max);
        if self.0.front().is_none_or(|(time_s, _)| *time_s > from_s)
            || apart_s > mean.period_s / FEWEST
        {
            return None;
        }
        let part = |(&(t0, a0), &(t1, a1)): (&(Seconds, Amps), &(Seconds, Amps))| {
            // The first pair begins before the period does.
            let start_s = t0.max(from_s);
            let start_a = a0 + (a1 - a0) * (start_s - t0) / (t1 - t0);
            0.5 * (of(start_a) + of(a1)) * (t1 - start_s).value()
        };
        Some(pairs().map(part).sum::<f64>() / mean.period_s.value())
    }
}
