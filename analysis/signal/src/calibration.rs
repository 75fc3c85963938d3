//! Correction of the harness by the measured control impedances.
//!
//! Along the loop, from earth: return wire – C1 | current shunt | C2 – wire – C3 | thing in the
//! jig | C4, every channel single-ended. Channel k shows cₖ = aₖ·exp(−jωτₖ) times the potential of
//! its tip, relative to channel 1 (c₁ = 1), and the loop of the voltage leads picks up jωM·i at C4:
//!
//! * i = (V₂/c₂ − V₁)/(R_s + jωL_s)
//! * u = V₄/c₄ − V₃/c₃ − jωM·i
//! * Z = u/i
//!
//! Since the potential that C3 and C4 share is several times the voltage between them, a mismatch
//! of their gains *adds* an error to Z that is proportional to that shared potential. No factor on
//! Z can remove it, and a factor found on the shunt is wrong on the cell.
//!
//! Controls determine the parameters, each as far as it was measured: the voltage probes on the
//! shunt (V₃/c₃ = V₁; V₄/c₄ − V₂/c₂ = jωM_shunt·i), a fake cell and a short of known impedance in
//! the jig (u = (R + jωL)·i), and an open jig, whose stray admittance Y carries the current Y·u
//! past the cell: Z = u/(i − Y·u). Every parameter has a Gaussian prior, so that an unmeasured
//! parameter stays as uncertain as it was, and the uncertainty of the correction travels with every
//! impedance. Combinations that the controls cannot separate, such as a skew of C4 and the pick-up,
//! share their prior uncertainty; if they also act alike on the cell, that uncertainty cancels.
//!
//! Purpose of each control: the shunt equates C3 with C1 and C4 with C2. The short shows the effect
//! of the shared potential at a voltage near zero. The fake cell differs from the short by a known
//! voltage. So only both together separate the skew of C2, which turns the current, from the
//! pick-up. With the fake cell alone that skew stays as uncertain as its prior. The open bounds a
//! leak beside the cell, which no other control detects.
//!
//! Sources: the estimate is linear in the errors of the priors and the noise of the controls, and
//! with C the covariance in units of the priors the error of prior k enters as C·eₖ, the noise of
//! the controls as C − C². These parts add up to C exactly, whatever the parameters' correlations:
//! [`Correction::parts`].
//!
//! Reads no file and fits no sinusoids: its input is phasors with their noise.

mod controls;
mod correction;
mod model;
mod modes;
mod solve;
mod verdict;

use num_complex::Complex64;

use crate::spectrum::{ChannelPhasors, ImpedancePoint};
use analysis_numeric::{
    Covariance2,
    linalg::{cholesky, cholesky_substitute},
};
pub use controls::{CalibrationError, Controls, KnownImpedance, Priors, Source, StrayAdmittance};
pub use correction::Correction;
use model::{COUNT, Harness, Slope};
pub use modes::CorrectionModes;
pub use verdict::{ControlTolerance, ControlVerdict, check_control, check_short};

/// Independent errors that a correction leaves.
pub const COMMON: usize = 5;

/// Common error of all impedances corrected together. It consists of a few independent errors,
/// given as one standard deviation each. Each makes Z of a cell wrong by jω·(τ·Z + L) + ω²·q, and Z
/// of the shunt by jω·L′ + ω²·q′. Repeats do not show them, and no mean makes them smaller. The
/// squares matter beyond the frequencies of the controls.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommonError {
    /// Delay τ of each error, s.
    pub skew_s: [f64; COMMON],
    /// Inductance L of each error, H.
    pub inductance_h: [f64; COMMON],
    /// Coefficient q of each error, Ω·s².
    pub square_ohm_s2: [f64; COMMON],
    /// Inductance L′ of each error, H: with the voltage probes on the shunt.
    pub at_shunt_h: [f64; COMMON],
    /// Coefficient q′ of each error, Ω·s²: with the voltage probes on the shunt.
    pub at_shunt_ohm_s2: [f64; COMMON],
}

impl CommonError {
    /// Returns whether all are numbers.
    pub fn is_finite(&self) -> bool {
        let all = [
            self.skew_s,
            self.inductance_h,
            self.square_ohm_s2,
            self.at_shunt_h,
            self.at_shunt_ohm_s2,
        ];
        all.iter().flatten().all(|v| v.is_finite())
    }

    /// Returns the change of an impedance by one standard deviation of the error with this number,
    /// Ω, at a frequency (Hz). The impedance is that of the cell or that of the shunt.
    pub fn at(&self, error: usize, freq_hz: f64, z_ohm: Complex64, is_cell: bool) -> Complex64 {
        let omega = std::f64::consts::TAU * freq_hz;
        if is_cell {
            Complex64::new(0.0, omega) * (self.skew_s[error] * z_ohm + self.inductance_h[error])
                + omega * omega * self.square_ohm_s2[error]
        } else {
            Complex64::new(
                omega * omega * self.at_shunt_ohm_s2[error],
                omega * self.at_shunt_h[error],
            )
        }
    }
}

/// Units in which skews, inductances and squares are found, s, H and Ω·s².
const SKEW_UNIT_S: f64 = 1e-6;
const INDUCTANCE_UNIT_H: f64 = 1e-9;
const SQUARE_UNIT: f64 = 1e-12;

/// Sensitivity of an inductance (H), a square (Ω·s²) and, with four columns, a skew (s) to each
/// parameter: least squares of relative errors, with a gain beside them.
fn follow(points: impl Iterator<Item = (f64, Slope)>, count: usize) -> Option<[[f64; COUNT]; 3]> {
    let mut normal = vec![0.0; count * count];
    let mut sides = vec![[0.0; COUNT]; count];
    let along = |a: Complex64, b: Complex64| a.re * b.re + a.im * b.im;
    for (freq_hz, impedance) in points {
        let (z, j_omega) = (
            impedance.value,
            Complex64::new(0.0, std::f64::consts::TAU * freq_hz),
        );
        let columns = [
            Complex64::ONE,
            INDUCTANCE_UNIT_H * j_omega / z,
            -SQUARE_UNIT * j_omega * j_omega / z,
            SKEW_UNIT_S * j_omega,
        ];
        let slopes = impedance.by_parameters();
        for (row, a) in columns[..count].iter().enumerate() {
            columns[..count]
                .iter()
                .enumerate()
                .for_each(|(column, b)| normal[row * count + column] += along(*a, *b));
            slopes
                .iter()
                .zip(&mut sides[row])
                .for_each(|(slope, side)| *side += along(*a, slope / z));
        }
    }
    let solvable = cholesky(&mut normal, count);
    let mut found = [[0.0; COUNT]; 3];
    for k in 0..COUNT {
        let mut x: Vec<f64> = sides.iter().map(|side| side[k]).collect();
        cholesky_substitute(&normal, count, &mut x);
        let units = [INDUCTANCE_UNIT_H, SQUARE_UNIT, SKEW_UNIT_S];
        found
            .iter_mut()
            .zip(x[1..].iter().zip(units))
            .for_each(|(found, (x, unit))| found[k] = unit * x);
    }
    solvable.then_some(found)
}

/// Returns independent errors, the columns, that have this covariance: the lower triangle L of
/// L·Lᵀ, with zeros where no variance remains.
fn independent(covariance: &[[f64; COMMON]; COMMON]) -> [[f64; COMMON]; COMMON] {
    let mut l = [[0.0; COMMON]; COMMON];
    for i in 0..COMMON {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
            let left = covariance[i][j] - known;
            l[i][j] = if i != j {
                if l[j][j] > 0.0 { left / l[j][j] } else { 0.0 }
            } else if left > ROUNDING * covariance[i][i] {
                left.sqrt()
            } else {
                // A row that follows from the ones before it leaves only rounding.
                0.0
            };
        }
    }
    l
}

/// Part of a variance that is rounding.
const ROUNDING: f64 = 1e-12;

/// A parameter of the harness.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct HarnessParameter {
    /// Name.
    pub name: &'static str,
    /// Value, in `unit`.
    pub value: f64,
    /// Standard deviation, in `unit`.
    pub sigma: f64,
    /// SI unit; `1` for a pure number.
    pub unit: &'static str,
}

impl Correction {
    /// Finds the harness that explains the controls best, by weighted least squares with priors.
    ///
    /// If the controls scatter significantly more than their stated noise, the noise is increased
    /// accordingly.
    ///
    /// # Errors
    /// [`CalibrationError`] for unusable input, or if the parameters do not converge.
    ///
    /// # Examples
    /// ```
    /// use analysis_signal::calibration::{
    ///     CalibrationError, Controls, Correction, KnownImpedance, Priors,
    /// };
    /// use analysis_signal::spectrum::{ChannelPhasors, PhasorVariance, raw_impedance};
    ///
    /// // 1 A flows through a return wire of 17 mΩ and a shunt of 10 mΩ.
    /// // Channel 4 reads 0.4 % too much.
    /// let read = |v3: f64, v4: f64| ChannelPhasors {
    ///     freq_hz: 10.0,
    ///     volts: [0.017, 0.027, v3, 1.004 * v4].map(num_complex::Complex64::from),
    ///     variance: [PhasorVariance::circular(1e-14); 4],
    /// };
    /// let known = |r_ohm: f64| KnownImpedance {
    ///     r_ohm,
    ///     r_sigma_ohm: 1e-4 * r_ohm,
    ///     l_h: 0.0,
    ///     l_sigma_h: 1e-9,
    /// };
    /// let correction = Correction::fit(&Controls {
    ///     current_shunt: known(0.010),
    ///     shunt: &[read(0.017, 0.027)],
    ///     fake_cell: Some((known(0.004), &[read(0.039, 0.043)])),
    ///     short: None,
    ///     open: None,
    ///     priors: Priors::default(),
    /// })?;
    /// // A cell of 6 mΩ in the jig.
    /// let cell = read(0.039, 0.045);
    /// assert!((raw_impedance(&cell, 0.010).z_ohm.re - 6e-3).abs() > 1e-4);
    /// assert!((correction.apply(&cell).z_ohm.re - 6e-3).abs() < 1e-5);
    /// # Ok::<(), CalibrationError>(())
    /// ```
    pub fn fit(controls: &Controls<'_>) -> Result<Self, CalibrationError> {
        solve::check(controls)?;
        solve::fit(controls)
    }

    /// Returns the correction without any measurement: the current shunt as given, and everything
    /// else at the default [`Priors`] with their uncertainty.
    pub fn none(current_shunt: KnownImpedance) -> Self {
        let controls = Controls {
            current_shunt,
            shunt: &[],
            fake_cell: None,
            short: None,
            open: None,
            priors: Priors::default(),
        };
        solve::unmeasured(&controls)
    }

    /// Returns the corrected impedance, with the combined covariance from the noise of the phasors
    /// and the uncertainty of the correction. It is not finite without a current.
    pub fn apply(&self, phasors: &ChannelPhasors) -> ImpedancePoint {
        let harness = Harness::new(&self.values, phasors);
        let (current, impedance) = (harness.current(), harness.impedance());
        let covariance = impedance.noise(&phasors.totals()) + impedance.carried(&self.covariance);
        ImpedancePoint {
            freq_hz: phasors.freq_hz,
            z_ohm: impedance.value,
            covariance,
            amplitude_a: current.value.norm(),
        }
    }

    /// As [`Self::apply`], of records with the voltage probes on the current shunt: the leads lie
    /// otherwise there than at the jig, and nothing is beside it.
    pub fn apply_at_shunt(&self, phasors: &ChannelPhasors) -> ImpedancePoint {
        let harness = Harness::new(&self.values, phasors);
        let (current, impedance) = (harness.current(), harness.impedance_at_shunt());
        let covariance = impedance.noise(&phasors.totals()) + impedance.carried(&self.covariance);
        ImpedancePoint {
            freq_hz: phasors.freq_hz,
            z_ohm: impedance.value,
            covariance,
            amplitude_a: current.value.norm(),
        }
    }

    /// Returns the phasor of the current through the shunt, A.
    pub fn current(&self, phasors: &ChannelPhasors) -> Complex64 {
        Harness::new(&self.values, phasors).current().value
    }

    /// Returns the voltage across the jig, V, without what an impedance in it makes of the current, with
    /// the covariance by the noise of the phasors and by the correction.
    pub fn rest(&self, phasors: &ChannelPhasors, z_ohm: Complex64) -> (Complex64, Covariance2) {
        let rest = Harness::new(&self.values, phasors).rest(z_ohm);
        let covariance = rest.noise(&phasors.totals()) + rest.carried(&self.covariance);
        (rest.value, covariance)
    }

    /// Returns the direct current through the shunt, A, and the direct voltage across the jig, V,
    /// from the four channels, V, less their readings without a current: offsets do not belong to
    /// the harness. A gain that all channels share affects both and is not detected.
    pub fn direct(&self, volts: [f64; 4]) -> (f64, f64) {
        model::direct(&self.values, volts)
    }

    /// Part of the covariance of [`Self::apply`] that comes from the uncertainty of the correction,
    /// Ω². It is common to all measurements corrected so: averaging them does not lower it.
    pub fn carried_covariance(&self, phasors: &ChannelPhasors) -> Covariance2 {
        Harness::new(&self.values, phasors)
            .impedance()
            .carried(&self.covariance)
    }

    /// Parts of the covariance of [`Self::apply`] that the noise of the phasors, their rounding and
    /// their drift have, Ω².
    pub fn measured_parts(&self, phasors: &ChannelPhasors) -> [Covariance2; 3] {
        let impedance = Harness::new(&self.values, phasors).impedance();
        [
            impedance.noise(&phasors.variance.map(|variance| variance.noise)),
            impedance.noise(&phasors.variance.map(|variance| variance.quantisation)),
            impedance.noise(&phasors.variance.map(|variance| variance.drift)),
        ]
    }

    /// Parts of [`Self::carried_covariance`] by source, Ω²; they add up to it.
    pub fn parts(&self, phasors: &ChannelPhasors) -> Vec<(Source, Covariance2)> {
        let impedance = Harness::new(&self.values, phasors).impedance();
        let slopes = impedance.by_parameters();
        let along = |prior: usize| {
            let direction: Complex64 = slopes
                .iter()
                .zip(&self.covariance)
                .map(|(slope, row)| *slope * row[prior])
                .sum();
            Covariance2::along(direction / self.prior_sigmas[prior])
        };
        let of = |source: Source| {
            let known =
                |prior: &usize| model::NAMES[*prior].2 == source && self.prior_sigmas[*prior] > 0.0;
            (0..COUNT).filter(known).map(along).sum::<Covariance2>()
        };
        let mut parts: Vec<(Source, Covariance2)> = Source::ALL
            .into_iter()
            .map(|source| (source, of(source)))
            .collect();
        let explained: Covariance2 = parts.iter().map(|(_, part)| *part).sum();
        let rest = impedance.carried(&self.covariance) + explained.times(-1.0);
        if let Some((_, noise)) = parts
            .iter_mut()
            .find(|(source, _)| *source == Source::ControlNoise)
        {
            // Rounding must not leave a negative variance if the controls contain no information.
            *noise = Covariance2 {
                re_re: rest.re_re.max(0.0),
                im_im: rest.im_im.max(0.0),
                ..rest
            };
        }
        parts
    }

    /// Returns the common error that the uncertainty of the correction adds to all impedances
    /// corrected with it. The derivatives by the parameters of the harness are split by least
    /// squares into a gain, which is left out, a skew, an inductance and a resistance that grows as
    /// the square of the frequency. `jig` are points of the cell. `shunt` are points with the
    /// voltage probes on the shunt; empty if that is never measured again. Returns `None` for fewer
    /// than two points of the cell.
    pub fn common_error(
        &self,
        jig: &[ChannelPhasors],
        shunt: &[ChannelPhasors],
    ) -> Option<CommonError> {
        if jig.len() < 2 {
            return None;
        }
        let of = |points: &[ChannelPhasors], at_shunt: bool| -> Option<[[f64; COUNT]; 3]> {
            let impedance = |phasors: &ChannelPhasors| {
                let harness = Harness::new(&self.values, phasors);
                if at_shunt {
                    harness.impedance_at_shunt()
                } else {
                    harness.impedance()
                }
            };
            // On a resistance a skew and an inductance are one.
            let count = if at_shunt { 3 } else { 4 };
            follow(
                points
                    .iter()
                    .map(|phasors| (phasors.freq_hz, impedance(phasors))),
                count,
            )
        };
        let [inductance, square, skew] = of(jig, false)?;
        let [at_shunt, square_at_shunt, _] = if shunt.len() < 2 {
            [[0.0; COUNT]; 3]
        } else {
            of(shunt, true)?
        };
        let rows = [skew, inductance, square, at_shunt, square_at_shunt];
        let between = |a: &[f64; COUNT], b: &[f64; COUNT]| -> f64 {
            self.covariance
                .iter()
                .zip(a)
                .map(|(row, a)| a * row.iter().zip(b).map(|(c, b)| c * b).sum::<f64>())
                .sum()
        };
        let parts = independent(&std::array::from_fn(|i| {
            std::array::from_fn(|j| between(&rows[i], &rows[j]))
        }));
        let [
            skew_s,
            inductance_h,
            square_ohm_s2,
            at_shunt_h,
            at_shunt_ohm_s2,
        ] = parts;
        Some(CommonError {
            skew_s,
            inductance_h,
            square_ohm_s2,
            at_shunt_h,
            at_shunt_ohm_s2,
        })
        .filter(CommonError::is_finite)
    }

    /// Returns the parameters with standard deviations.
    pub fn parameters(&self) -> Vec<HarnessParameter> {
        let parameter = |index: usize| {
            let (name, unit, _) = model::NAMES[index];
            HarnessParameter {
                name,
                value: self.values[index],
                sigma: self.covariance[index][index].sqrt(),
                unit,
            }
        };
        (0..COUNT)
            .filter(|index| self.known[*index])
            .map(parameter)
            .collect()
    }
}
