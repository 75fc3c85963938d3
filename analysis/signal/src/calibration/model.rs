//! The equations of the harness, with exact derivatives.
//!
//! Everything is analytic in the four phasors and linear or exponential in the parameters, so each
//! quantity carries its complex derivatives along (forward differentiation) and no derivative has
//! to be written twice by hand.

use std::array;
use std::ops::{Add, Div, Mul, Sub};

use num_complex::Complex64;

use super::Source;
use crate::spectrum::ChannelPhasors;
use analysis_numeric::Covariance2;

/// Number of parameters.
pub(super) const COUNT: usize = 16;

const GAIN: usize = 0;
const SKEW: usize = 3;
const MUTUAL_SHUNT: usize = 6;
const MUTUAL_JIG: usize = 7;
const SHUNT_R: usize = 8;
const SHUNT_L: usize = 9;
const FAKE_R: usize = 10;
const FAKE_L: usize = 11;
const SHORT_R: usize = 12;
const SHORT_L: usize = 13;
const STRAY_G: usize = 14;
const STRAY_C: usize = 15;

/// Names, units, and the source of each uncertainty.
pub(super) const NAMES: [(&str, &str, Source); COUNT] = [
    ("gain_c2", "1", Source::Gain),
    ("gain_c3", "1", Source::Gain),
    ("gain_c4", "1", Source::Gain),
    ("skew_c2", "s", Source::Skew),
    ("skew_c3", "s", Source::Skew),
    ("skew_c4", "s", Source::Skew),
    ("mutual_shunt", "H", Source::Mutual),
    ("mutual_jig", "H", Source::Mutual),
    ("shunt_r", "Ω", Source::Shunt),
    ("shunt_l", "H", Source::Shunt),
    ("fake_cell_r", "Ω", Source::FakeCell),
    ("fake_cell_l", "H", Source::FakeCell),
    ("short_r", "Ω", Source::Short),
    ("short_l", "H", Source::Short),
    ("stray_g", "S", Source::Open),
    ("stray_c", "F", Source::Open),
];

const SLOPES: usize = 4 + COUNT;

/// A complex quantity with its derivatives towards the four phasors, then the parameters.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slope {
    pub(super) value: Complex64,
    slopes: [Complex64; SLOPES],
}

impl Slope {
    fn variable(value: Complex64, index: usize, slope: Complex64) -> Self {
        let mut slopes = [Complex64::default(); SLOPES];
        slopes[index] = slope;
        Self { value, slopes }
    }

    /// Derivatives towards the phasors.
    pub(super) fn by_volts(&self) -> [Complex64; 4] {
        array::from_fn(|k| self.slopes[k])
    }

    /// Derivatives towards the parameters.
    pub(super) fn by_parameters(&self) -> [Complex64; COUNT] {
        array::from_fn(|k| self.slopes[4 + k])
    }

    /// Returns the covariance from that of the phasors.
    pub(super) fn noise(&self, covariances: &[Covariance2; 4]) -> Covariance2 {
        self.by_volts()
            .into_iter()
            .zip(covariances)
            .map(|(slope, covariance)| covariance.scaled(slope))
            .sum()
    }

    /// Returns the covariance from that of the parameters.
    pub(super) fn carried(&self, covariance: &[[f64; COUNT]; COUNT]) -> Covariance2 {
        let slopes = self.by_parameters();
        let mut sum = Covariance2::ZERO;
        for (a, row) in slopes.iter().zip(covariance) {
            for (b, element) in slopes.iter().zip(row) {
                sum.re_re += a.re * element * b.re;
                sum.re_im += a.re * element * b.im;
                sum.im_im += a.im * element * b.im;
            }
        }
        sum
    }
}

impl Add for Slope {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            slopes: array::from_fn(|k| self.slopes[k] + other.slopes[k]),
        }
    }
}

impl Sub for Slope {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self {
            value: self.value - other.value,
            slopes: array::from_fn(|k| self.slopes[k] - other.slopes[k]),
        }
    }
}

#[expect(clippy::suspicious_arithmetic_impl, reason = "the product rule adds")]
impl Mul for Slope {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let slope = |k: usize| self.slopes[k] * other.value + self.value * other.slopes[k];
        Self {
            value: self.value * other.value,
            slopes: array::from_fn(slope),
        }
    }
}

#[expect(
    clippy::suspicious_arithmetic_impl,
    reason = "the quotient rule subtracts and multiplies"
)]
impl Div for Slope {
    type Output = Self;

    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        Self {
            value,
            slopes: array::from_fn(|k| (self.slopes[k] - value * other.slopes[k]) / other.value),
        }
    }
}

/// The harness at one frequency, with what its channels showed.
#[derive(Debug)]
pub(super) struct Harness<'a> {
    values: &'a [f64; COUNT],
    j_omega: Complex64,
    tips: [Slope; 4],
}

impl<'a> Harness<'a> {
    pub(super) fn new(values: &'a [f64; COUNT], phasors: &ChannelPhasors) -> Self {
        let j_omega = Complex64::new(0.0, std::f64::consts::TAU * phasors.freq_hz);
        let tips = array::from_fn(|channel| tip(values, j_omega, phasors.volts[channel], channel));
        Self {
            values,
            j_omega,
            tips,
        }
    }

    /// Returns the current through the shunt, A.
    pub(super) fn current(&self) -> Slope {
        let [v1, v2, ..] = self.tips;
        (v2 - v1) / self.impedance_of(SHUNT_R, SHUNT_L)
    }

    /// Returns the voltage across the jig, V, without what an impedance `z_ohm` in it makes of the current.
    pub(super) fn rest(&self, z_ohm: Complex64) -> Slope {
        let [.., v3, v4] = self.tips;
        let i = self.current();
        let u = v4 - v3 - self.reactance(MUTUAL_JIG) * i;
        let z = Slope {
            value: z_ohm,
            slopes: [Complex64::default(); SLOPES],
        };
        u - z * (i - self.stray() * u)
    }

    /// Returns the impedance of the fixture in the jig, Ω.
    pub(super) fn impedance(&self) -> Slope {
        let [.., v3, v4] = self.tips;
        let (i, u) = (self.current(), v4 - v3);
        let u = u - self.reactance(MUTUAL_JIG) * i;
        u / (i - self.stray() * u)
    }

    /// Returns the impedance between the voltage probes when they are on the shunt, Ω.
    pub(super) fn impedance_at_shunt(&self) -> Slope {
        let [.., v3, v4] = self.tips;
        let i = self.current();
        (v4 - v3 - self.reactance(MUTUAL_SHUNT) * i) / i
    }

    /// Residuals with the voltage probes on the shunt, V; zero for a perfect harness model.
    pub(super) fn shunt_residuals(&self) -> [Slope; 2] {
        let [v1, v2, v3, v4] = self.tips;
        [
            v3 - v1,
            v4 - v2 - self.reactance(MUTUAL_SHUNT) * self.current(),
        ]
    }

    /// Returns the residual with the fake cell in the jig, V; zero for a perfect harness model.
    pub(super) fn fake_cell_residual(&self) -> Slope {
        self.load_residual(FAKE_R, FAKE_L)
    }

    /// Returns the residual with the short in the jig, V; zero for a perfect harness model.
    pub(super) fn short_residual(&self) -> Slope {
        self.load_residual(SHORT_R, SHORT_L)
    }

    fn load_residual(&self, r: usize, l: usize) -> Slope {
        let [.., v3, v4] = self.tips;
        let i = self.current();
        let u = v4 - v3 - self.reactance(MUTUAL_JIG) * i;
        u - self.impedance_of(r, l) * (i - self.stray() * u)
    }

    /// Returns the admittance in parallel with the fixture in the jig, S.
    fn stray(&self) -> Slope {
        Slope::variable(self.values[STRAY_G].into(), 4 + STRAY_G, 1.0.into())
            + self.reactance(STRAY_C)
    }

    fn impedance_of(&self, r: usize, l: usize) -> Slope {
        Slope::variable(self.values[r].into(), 4 + r, 1.0.into()) + self.reactance(l)
    }

    /// jω times a parameter.
    fn reactance(&self, index: usize) -> Slope {
        Slope::variable(self.j_omega * self.values[index], 4 + index, self.j_omega)
    }
}

/// Returns the current through the shunt, A, and the voltage across the jig, V, for direct
/// currents: skews and inductances have no effect on them.
pub(super) fn direct(values: &[f64; COUNT], volts: [f64; 4]) -> (f64, f64) {
    let [v1, v2, v3, v4] = volts;
    let [gain_2, gain_3, gain_4] = [values[GAIN], values[GAIN + 1], values[GAIN + 2]];
    (
        (v2 / gain_2 - v1) / values[SHUNT_R],
        v4 / gain_4 - v3 / gain_3,
    )
}

/// Returns the potential of a channel's tip from its reading: V/c.
fn tip(values: &[f64; COUNT], j_omega: Complex64, shown: Complex64, channel: usize) -> Slope {
    let shown_volts = Slope::variable(shown, channel, 1.0.into());
    let Some(other) = channel.checked_sub(1) else {
        return shown_volts;
    };
    let (gain, skew_s) = (values[GAIN + other], values[SKEW + other]);
    let ahead = (j_omega * skew_s).exp();
    let gain = Slope::variable(gain.into(), 4 + GAIN + other, 1.0.into());
    shown_volts * Slope::variable(ahead, 4 + SKEW + other, j_omega * ahead) / gain
}
