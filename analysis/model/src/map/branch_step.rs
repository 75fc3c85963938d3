//! Step of a branch with a fixed time constant.

/// Largest voltage of a branch over its bend.
const MOST_BEND: f64 = 20.0;

/// What drives a branch in one state of the cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// Voltage that a branch without charge transfer would settle at, R·i, V.
    pub driven_v: f64,
    /// Voltage over which the branch bends, 2·i₀·R, V; infinite for a branch without charge transfer.
    pub bend_v: f64,
}

impl Drive {
    /// Smallest resistance of a branch in its bend and its heat, Ω: below it, the voltage belongs to
    /// another state.
    pub const LEAST_OHM: f64 = 1e-5;

    /// Returns the drive of a branch of a resistance, Ω, under a current, A. `exchange_a`: the exchange
    /// current of a branch of charge transfer, A.
    #[inline]
    pub fn new(exchange_a: Option<f64>, r_ohm: f64, current_a: f64) -> Self {
        let bend = |exchange_a: f64| 2.0 * exchange_a * r_ohm.max(Self::LEAST_OHM);
        Self {
            driven_v: r_ohm * current_a,
            bend_v: exchange_a.map_or(f64::INFINITY, bend),
        }
    }

    /// Returns the voltage at which the branch settles, V.
    pub fn settled_v(&self) -> f64 {
        if self.bend_v.is_infinite() {
            return self.driven_v;
        }
        self.bend_v * (self.driven_v / self.bend_v).asinh()
    }

    /// Returns the power that a branch of a voltage, V, and a resistance, Ω, turns into heat, W.
    #[inline]
    pub fn lost_w(&self, v: f64, r_ohm: f64) -> f64 {
        v * self.leaking_v(v) / r_ohm.max(Self::LEAST_OHM)
    }

    /// Returns the change of a settled voltage of the branch, V, with the logarithm of its bend at the same
    /// current: v − bend·tanh(v/bend), zero without charge transfer.
    #[inline]
    pub fn fallen_v(&self, v: f64) -> f64 {
        if self.bend_v.is_infinite() {
            return 0.0;
        }
        v - self.bend_v * (v / self.bend_v).tanh()
    }

    /// Returns the change of [`Self::leaking_v`] with the voltage of the branch.
    pub fn leaking_slope(&self, v: f64) -> f64 {
        if self.bend_v.is_infinite() {
            return 1.0;
        }
        (v / self.bend_v).clamp(-MOST_BEND, MOST_BEND).cosh()
    }

    /// Returns the voltage that the current through the resistance of the branch would have without
    /// charge transfer, V, at a voltage of the branch, V: bend·sinh(v/bend).
    #[inline]
    pub fn leaking_v(&self, v: f64) -> f64 {
        if self.bend_v.is_infinite() {
            return v;
        }
        self.bend_v * (v / self.bend_v).clamp(-MOST_BEND, MOST_BEND).sinh()
    }
}

/// A step of a branch, τ·dv/dt = R·i − bend·sinh(v/bend).
///
/// Without charge transfer the step is exact for a driving voltage R·i that is linear over it. With it,
/// the step is exact for a mean of the driving voltage in which its end weighs as much as it does
/// without, and for the mean bend: of second order, and stable for steps of any length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BranchStep {
    /// Factor on the voltage of the branch at the start.
    pub decay: f64,
    /// Factor on the driving voltage at the start.
    pub start: f64,
    /// Factor on the driving voltage at the end.
    pub end: f64,
    /// Length of the step over the time constant.
    pub ratio: f64,
    /// Share of the end in the mean driving voltage.
    pub end_share: f64,
}

/// End of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BranchEnd {
    /// Voltage of the branch, V.
    pub v: f64,
    /// Change of that voltage with the driving voltage at the end.
    pub slope: f64,
}

impl BranchStep {
    /// Returns the factors of a step of a branch with a time constant, s.
    pub fn new(step_s: f64, tau_s: f64) -> Self {
        let ratio = step_s / tau_s;
        let decay = (-ratio).exp();
        let is_short = ratio <= 1e-9;
        let mean = if is_short {
            1.0 - 0.5 * ratio
        } else {
            -(-ratio).exp_m1() / ratio
        };
        let end = 1.0 - mean;
        Self {
            decay,
            start: mean - decay,
            end,
            ratio,
            end_share: if is_short { 0.5 } else { end / (1.0 - decay) },
        }
    }

    /// Returns the step with factors on the current of a branch without charge transfer and of a
    /// resistance, Ω, in the place of factors on its driving voltage.
    #[must_use]
    pub fn of_current(self, r_ohm: f64) -> Self {
        Self {
            start: r_ohm * self.start,
            end: r_ohm * self.end,
            ..self
        }
    }

    /// Returns the voltage of a branch without charge transfer at the end of the step, V.
    #[inline]
    pub fn end_v(self, v: f64, driven_start_v: f64, driven_end_v: f64) -> f64 {
        self.decay * v + self.start * driven_start_v + self.end * driven_end_v
    }

    /// Returns the end of the step of a branch of a voltage, V, from its drives at start and end.
    ///
    /// With a constant drive a and in units of the bend, tanh(x/2) of the voltage x obeys Riccati's
    /// equation: its distance from the fixed point a/(1 + s), s² = 1 + a², falls by Bernoulli's law.
    #[inline]
    pub fn bent_end(self, v: f64, start: Drive, end: Drive) -> BranchEnd {
        let bend_v = 0.5 * (start.bend_v + end.bend_v);
        if bend_v.is_infinite() {
            return BranchEnd {
                v: self.end_v(v, start.driven_v, end.driven_v),
                slope: self.end,
            };
        }
        let mean_v = start.driven_v + self.end_share * (end.driven_v - start.driven_v);
        let a = mean_v / bend_v;
        let s = 1.0_f64.hypot(a);
        let settled = a / (1.0 + s);
        let decay = (-self.ratio * s).exp();
        let most = (0.5 * MOST_BEND).tanh();
        // What lies beyond the largest bend decays as in a linear branch.
        let near = (v / bend_v).clamp(-MOST_BEND, MOST_BEND);
        let away = (0.5 * near).tanh() - settled;
        let bent = 1.0 + 0.5 * a / s * away * (1.0 - decay);
        let ended = (settled + away * decay / bent).clamp(-most, most);
        // The derivatives of the same terms with a.
        let settled_slope = 1.0 / (s * (1.0 + s));
        let decay_slope = -self.ratio * decay * a / s;
        let away_slope = -settled_slope;
        let bent_slope = 0.5 * (away / s.powi(3) + a / s * away_slope) * (1.0 - decay)
            - 0.5 * a / s * away * decay_slope;
        let ended_slope = settled_slope + (away_slope * decay + away * decay_slope) / bent
            - away * decay * bent_slope / (bent * bent);
        BranchEnd {
            v: bend_v * ((1.0 + ended) / (1.0 - ended)).ln() + (v - bend_v * near) * self.decay,
            slope: self.end_share * 2.0 * ended_slope / (1.0 - ended * ended),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runge–Kutta's method of fourth order with many small steps, for a drive and a bend that are
    /// linear in time.
    fn reference_v(mut v: f64, tau_s: f64, step_s: f64, from: Drive, to: Drive) -> f64 {
        let parts = 20_000;
        let h = step_s / f64::from(parts);
        let rate = |at: f64, v: f64| {
            let drive = Drive {
                driven_v: from.driven_v + at * (to.driven_v - from.driven_v),
                bend_v: from.bend_v + at * (to.bend_v - from.bend_v),
            };
            (drive.driven_v - drive.leaking_v(v)) / tau_s
        };
        for part in 0..parts {
            let at = |half: f64| (f64::from(part) + half) / f64::from(parts);
            let k1 = rate(at(0.0), v);
            let k2 = rate(at(0.5), v + 0.5 * h * k1);
            let k3 = rate(at(0.5), v + 0.5 * h * k2);
            let k4 = rate(at(1.0), v + h * k3);
            v += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
        }
        v
    }

    fn drive(driven_v: f64, bend_v: f64) -> Drive {
        Drive { driven_v, bend_v }
    }

    #[test]
    fn a_step_with_a_constant_drive_is_exact() {
        for (v, driven_v, step_s) in [
            (0.0, 0.4, 0.3),
            (0.15, -0.2, 0.7),
            (-0.1, 0.0, 5.0),
            (0.02, 0.03, 1e-3),
            (0.2, 2.0, 40.0),
        ] {
            let held = drive(driven_v, 0.05);
            let met = BranchStep::new(step_s, 0.8).bent_end(v, held, held);
            let expected = reference_v(v, 0.8, step_s, held, held);
            assert!(
                (met.v - expected).abs() < 1e-9,
                "{v} {driven_v} {step_s}: {met:?} {expected}"
            );
        }
    }

    #[test]
    fn halved_steps_quarter_the_error_under_a_ramp() {
        let at = |share: f64| drive(0.05 + 0.3 * share, 0.05 - 0.01 * share);
        let run = |parts: u32| {
            let step = BranchStep::new(1.0 / f64::from(parts), 0.8);
            (0..parts).fold(0.01, |v, k| {
                let share = |k: u32| f64::from(k) / f64::from(parts);
                step.bent_end(v, at(share(k)), at(share(k + 1))).v
            })
        };
        let expected = reference_v(0.01, 0.8, 1.0, at(0.0), at(1.0));
        let (coarse, fine) = ((run(8) - expected).abs(), (run(16) - expected).abs());
        assert!((3.5..4.5).contains(&(coarse / fine)), "{coarse:e} {fine:e}");
        assert!(coarse < 2e-4, "{coarse:e}");
    }

    #[test]
    fn a_bend_far_above_the_voltage_is_a_linear_branch() {
        for ratio in [1e-12, 1e-4, 0.3, 20.0] {
            let step = BranchStep::new(ratio, 1.0);
            let (from, to) = (drive(0.02, 1e4), drive(-0.03, 1e4));
            let met = step.bent_end(0.01, from, to);
            let linear = step.bent_end(
                0.01,
                Drive::new(None, 1.0, 0.02),
                Drive::new(None, 1.0, -0.03),
            );
            assert!(
                (met.v - linear.v).abs() < 1e-11,
                "{ratio}: {met:?} {linear:?}"
            );
            assert!(
                (met.slope - linear.slope).abs() < 1e-9,
                "{ratio}: {met:?} {linear:?}"
            );
        }
    }

    #[test]
    fn the_slope_of_a_step_is_its_derivative() {
        for (v, driven_v, step_s) in [(0.0, 0.4, 0.3), (0.15, -0.2, 0.7), (-0.1, 0.01, 5.0)] {
            let step = BranchStep::new(step_s, 0.8);
            let from = drive(0.1, 0.05);
            let end = |driven_v: f64| step.bent_end(v, from, drive(driven_v, 0.06));
            let by = 1e-6;
            let expected = (end(driven_v + by).v - end(driven_v - by).v) / (2.0 * by);
            let met = end(driven_v).slope;
            assert!(
                (met - expected).abs() < 1e-7,
                "{v} {driven_v}: {met} {expected}"
            );
        }
    }

    #[test]
    fn a_settled_voltage_moves_with_the_bend_as_stated() {
        for driven_v in [0.01, 0.4, -2.0] {
            let settled_v = |bend_v: f64| bend_v * (driven_v / bend_v).asinh();
            let by = 1e-6_f64;
            let expected =
                (settled_v(0.05 * by.exp()) - settled_v(0.05 * (-by).exp())) / (2.0 * by);
            let met = drive(driven_v, 0.05).fallen_v(settled_v(0.05));
            assert!(
                (met - expected).abs() < 1e-9,
                "{driven_v}: {met} {expected}"
            );
        }
        assert_eq!(Drive::new(None, 1.0, 2.0).fallen_v(2.0), 0.0);
    }

    #[test]
    fn an_extreme_drive_keeps_a_finite_voltage() {
        let end = BranchStep::new(10.0, 0.1).bent_end(0.0, drive(1e6, 1e-9), drive(1e6, 1e-9));
        assert!(end.v.is_finite() && end.slope.is_finite(), "{end:?}");
        // Far beyond the bend, against the drive, for longer than the branch remembers.
        let held = drive(-50.0, 0.05);
        let end = BranchStep::new(10.0, 0.1).bent_end(2.0, held, held);
        assert!((end.v + 0.05 * 1000.0_f64.asinh()).abs() < 1e-6, "{end:?}");
        let still = BranchStep::new(0.0, 0.1).bent_end(2.0, held, held);
        assert!((still.v - 2.0).abs() < 1e-6, "{still:?}");
    }
}
