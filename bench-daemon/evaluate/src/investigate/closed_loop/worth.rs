//! Which measurements of a map are worth their time.

use crate::investigate::cell_map::loads::Demands;

/// What an investigation for a map is to reach.
#[derive(Debug, Clone)]
pub struct Aims {
    /// The loads.
    pub demands: Demands,
    /// Predicted error of their voltage at which it ends, one standard deviation, V.
    pub error_v: f64,
    /// Least fall of this error for an hour on the bench, V/h.
    pub least_v_per_h: f64,
}

/// A measurement after those before it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    /// Its time, min.
    pub(super) minutes: f64,
    /// Predicted error of the loads after it, V.
    pub(super) after_v: f64,
}

/// The measurements that are worth their time.
#[derive(Debug, PartialEq)]
pub(super) struct Worth {
    /// Number of measurements to make; 0 if none lowers the error.
    pub(super) count: usize,
    /// Time of those that take most off the error per minute, min.
    pub(super) minutes: f64,
    /// What they take off, V.
    pub(super) gain_v: f64,
}

impl Worth {
    /// Judges measurements, up to the one that reaches the aim. The
    /// first ones that take most off the error per minute count together, because the first measurement at
    /// a place carries the way to it; further ones are added while each is worth its own time.
    pub(super) fn of(steps: &[Step], before_v: f64, aims: &Aims) -> Self {
        let reaching = steps.iter().position(|step| step.after_v <= aims.error_v);
        let steps = reaching.map_or(steps, |last| &steps[..=last]);
        let mut best = Self {
            count: 0,
            minutes: 0.0,
            gain_v: 0.0,
        };
        let mut minutes = 0.0;
        for (count, step) in (1..).zip(steps) {
            minutes += step.minutes;
            let gain_v = before_v - step.after_v;
            if gain_v > 0.0 && gain_v * best.minutes >= best.gain_v * minutes {
                best = Self {
                    count,
                    minutes,
                    gain_v,
                };
            }
        }
        let mut last_v = before_v - best.gain_v;
        for step in steps.iter().skip(best.count) {
            if best.count == 0 || 60.0 * (last_v - step.after_v) < aims.least_v_per_h * step.minutes
            {
                break;
            }
            last_v = step.after_v;
            best.count += 1;
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(list: &[[f64; 2]]) -> Vec<Step> {
        let step = |[minutes, after_v]: &[f64; 2]| Step {
            minutes: *minutes,
            after_v: *after_v,
        };
        list.iter().map(step).collect()
    }

    #[test]
    fn the_first_measurement_and_those_beside_it_are_judged_together() {
        let aims = |error_mv: f64, least_mv_per_h: f64| Aims {
            demands: Demands {
                under: Vec::new(),
                at_degc: Vec::new(),
                series: 1,
                parallel: 1,
            },
            error_v: 1e-3 * error_mv,
            least_v_per_h: 1e-3 * least_mv_per_h,
        };
        // The way to a place takes most of an hour; what is beside it is cheap.
        let near = steps(&[
            [60.0, 9.8e-3],
            [10.0, 9.0e-3],
            [30.0, 8.9e-3],
            [60.0, 8.88e-3],
        ]);
        let of = |error_mv, least| Worth::of(&near, 10.0e-3, &aims(error_mv, least));
        let worth = of(0.0, 0.5);
        assert_eq!((worth.count, worth.minutes), (2, 70.0));
        assert!((worth.gain_v - 1.0e-3).abs() < 1e-12);
        assert_eq!(of(0.0, 0.1).count, 3);
        assert_eq!(of(9.9, 0.5).count, 1);
        let none = steps(&[[5.0, 10.0e-3]]);
        assert_eq!(Worth::of(&none, 10.0e-3, &aims(0.0, 0.0)).count, 0);
    }
}
