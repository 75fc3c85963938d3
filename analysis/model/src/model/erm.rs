//! The extended Randles model (ERM): one resistance in series with parallel RC branches
//! (thesis 3.2.3, figure 3.6).
//!
//! The impedance is Z(ω) = R + Σₖ Rₖ / (1 + jωRₖCₖ), whose imaginary part is −Σₖ ωRₖ²Cₖ / (1 +
//! ω²Rₖ²Cₖ²).
//!
//! *Erratum:* equation 3.1 (and 3.2) of the thesis prints −ωR₁C₁ in that numerator, which lacks a
//! factor R₁ and is not in Ω. The physics is implemented here.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A resistance in parallel with a capacitance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RcBranch {
    /// Resistance, Ω, above zero.
    pub r_ohm: f64,
    /// Capacitance, F, above zero.
    pub c_f: f64,
}

impl RcBranch {
    /// Returns the time constant RC, s.
    pub fn time_constant_s(&self) -> f64 {
        self.r_ohm * self.c_f
    }

    /// Returns the impedance at a frequency, Ω.
    pub fn impedance(&self, freq_hz: f64) -> Complex64 {
        self.r_ohm * self.shape(freq_hz)
    }

    /// 1/(1 + jωRC): the impedance over the resistance.
    fn shape(&self, freq_hz: f64) -> Complex64 {
        Complex64::new(1.0, TAU * freq_hz * self.time_constant_s()).inv()
    }
}

/// The extended Randles model: a resistance in series with any number of RC branches.
///
/// # Examples
/// ```
/// use analysis_model::model::{Erm, RcBranch};
///
/// let cell = Erm {
///     r_ohm: 5e-3,
///     branches: vec![RcBranch { r_ohm: 3e-3, c_f: 10.0 }],
/// };
/// assert!((cell.dc_resistance_ohm() - 8e-3).abs() < 1e-12);
/// // At 1/(2πRC) the branch has half of its resistance, and the same reactance.
/// let corner_hz = 1.0 / (std::f64::consts::TAU * 0.03);
/// let z_ohm = cell.impedance(corner_hz);
/// assert!((z_ohm.re - 6.5e-3).abs() < 1e-12 && (z_ohm.im + 1.5e-3).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Erm {
    /// Series resistance, Ω, above zero: the impedance at infinite frequency.
    pub r_ohm: f64,
    /// RC branches; fits deliver them by rising time constant.
    pub branches: Vec<RcBranch>,
}

/// A value that cannot be a component of a passive cell.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// A resistance or a capacitance that is not a positive finite number.
    #[error("{parameter} of the ERM: expected a positive finite number in {unit}, met {met}")]
    NotPositive {
        /// Name as in the thesis: R, R1, C1, …
        parameter: String,
        /// Unit of the parameter.
        unit: &'static str,
        /// The value met.
        met: f64,
    },
    /// A list of logarithms whose length fits no ERM.
    #[error(
        "logarithmic parameters of an ERM: expected an odd number of them (ln R, then ln R and ln \
        C per branch), met {met}"
    )]
    ParameterCount {
        /// The number met.
        met: usize,
    },
}

impl Erm {
    /// Returns the impedance at a frequency in Hz (zero and above), Ω.
    pub fn impedance(&self, freq_hz: f64) -> Complex64 {
        self.branches
            .iter()
            .fold(Complex64::new(self.r_ohm, 0.0), |z, b| {
                z + b.impedance(freq_hz)
            })
    }

    /// Returns the resistance at zero frequency, Ω: R + ΣRₖ.
    pub fn dc_resistance_ohm(&self) -> f64 {
        self.r_ohm + self.branches.iter().map(|b| b.r_ohm).sum::<f64>()
    }

    /// Returns the time constants RₖCₖ in the order of the branches, s.
    pub fn time_constants_s(&self) -> Vec<f64> {
        self.branches
            .iter()
            .map(RcBranch::time_constant_s)
            .collect()
    }

    /// Returns the same model with its branches by rising time constant. The impedance does not
    /// change.
    #[must_use]
    pub fn ordered(mut self) -> Self {
        self.branches
            .sort_by(|a, b| a.time_constant_s().total_cmp(&b.time_constant_s()));
        self
    }

    /// Returns the number of free parameters: 1 + 2 per branch.
    pub fn parameter_count(&self) -> usize {
        1 + 2 * self.branches.len()
    }

    /// Natural logarithms of the parameters in SI units: ln R, ln R₁, ln C₁, ln R₂, ln C₂, …
    pub fn log_parameters(&self) -> Vec<f64> {
        let branches = self
            .branches
            .iter()
            .flat_map(|b| [b.r_ohm.ln(), b.c_f.ln()]);
        std::iter::once(self.r_ohm.ln()).chain(branches).collect()
    }

    /// Returns the model of a list as [`Erm::log_parameters`] makes it.
    ///
    /// # Errors
    /// [`ModelError::ParameterCount`] for an even number of values, [`ModelError::NotPositive`] if
    /// a logarithm overflows or is not a number.
    pub fn from_log_parameters(log_parameters: &[f64]) -> Result<Self, ModelError> {
        let count_error = ModelError::ParameterCount {
            met: log_parameters.len(),
        };
        let Some((r, rest)) = log_parameters.split_first() else {
            return Err(count_error);
        };
        let (pairs, []) = rest.as_chunks::<2>() else {
            return Err(count_error);
        };
        let branches = pairs
            .iter()
            .map(|[r, c]| RcBranch {
                r_ohm: r.exp(),
                c_f: c.exp(),
            })
            .collect();
        let erm = Self {
            r_ohm: r.exp(),
            branches,
        };
        erm.validate()?;
        Ok(erm)
    }

    /// Derivatives of the impedance with respect to [`Erm::log_parameters`], in that order, Ω.
    ///
    /// With u = 1/(1 + jωRC): ∂Z/∂ln R = R·u² and ∂Z/∂ln C = R·(u² − u) for a branch.
    pub fn log_gradient(&self, freq_hz: f64) -> Vec<Complex64> {
        let mut gradient = Vec::with_capacity(self.parameter_count());
        gradient.push(Complex64::new(self.r_ohm, 0.0));
        for branch in &self.branches {
            let u = branch.shape(freq_hz);
            gradient.push(branch.r_ohm * u * u);
            gradient.push(branch.r_ohm * (u * u - u));
        }
        gradient
    }

    /// Returns the name of each entry of [`Erm::log_parameters`], as in the thesis: R, R1, C1, …
    pub fn parameter_names(&self) -> Vec<String> {
        let branches = (1..=self.branches.len()).flat_map(|k| [format!("R{k}"), format!("C{k}")]);
        std::iter::once("R".to_owned()).chain(branches).collect()
    }

    /// Checks that every component is a positive finite number.
    ///
    /// # Errors
    /// [`ModelError::NotPositive`] for the first that is not.
    pub fn validate(&self) -> Result<(), ModelError> {
        let branches = self
            .branches
            .iter()
            .flat_map(|b| [(b.r_ohm, "Ω"), (b.c_f, "F")]);
        let values = std::iter::once((self.r_ohm, "Ω")).chain(branches);
        for (parameter, (met, unit)) in self.parameter_names().into_iter().zip(values) {
            if !(met.is_finite() && met > 0.0) {
                return Err(ModelError::NotPositive {
                    parameter,
                    unit,
                    met,
                });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Spoil = fn(&mut Erm);

    /// Appendix A of the thesis, 4 RC circuits, in the thesis' order.
    fn appendix_a4() -> Erm {
        let rc = |r_ohm, c_f| RcBranch { r_ohm, c_f };
        Erm {
            r_ohm: 0.006_428_631_596_419_841,
            branches: vec![
                rc(0.001_509_241_605_820_766_5, 0.552_812_237_531_678_4),
                rc(0.000_404_065_512_686_373_3, 663.816_518_993_211_5),
                rc(0.004_774_060_802_661_011, 1_084.243_067_567_011_2),
                rc(0.000_662_796_507_418_388_8, 6.979_849_139_650_129),
            ],
        }
    }

    /// Returns the same circuit by real arithmetic only: conductance and susceptance of each branch
    /// in parallel, turned into an impedance.
    fn by_admittance(erm: &Erm, freq_hz: f64) -> (f64, f64) {
        let w = 2.0 * std::f64::consts::PI * freq_hz;
        erm.branches.iter().fold((erm.r_ohm, 0.0), |(re, im), b| {
            let (g, s) = (1.0 / b.r_ohm, w * b.c_f);
            (re + g / (g * g + s * s), im - s / (g * g + s * s))
        })
    }

    #[test]
    fn appendix_a_has_the_magnitudes_of_the_thesis() {
        let erm = appendix_a4();
        for (freq_hz, expected_mohm) in [(0.1, 9.51), (300.0, 6.91)] {
            let met = erm.impedance(freq_hz).norm() * 1e3;
            assert!(
                (met - expected_mohm).abs() < 0.005,
                "|Z| at {freq_hz} Hz: expected {expected_mohm} mΩ, met {met} mΩ"
            );
        }
        assert!((erm.dc_resistance_ohm() - 0.013_778_796_025_006_38).abs() < 1e-12);
        let tau = erm.ordered().time_constants_s();
        for (met, expected) in tau
            .iter()
            .zip([0.000_834_327, 0.004_626_22, 0.268_225, 5.176_242])
        {
            assert!(
                (met / expected - 1.0).abs() < 1e-5,
                "expected {expected} s, met {met} s"
            );
        }
    }

    #[test]
    fn agrees_with_an_independent_evaluation() {
        let erm = appendix_a4();
        for i in 0..200 {
            let freq_hz = 1e-3 * 10f64.powf(f64::from(i) * 0.04);
            let (re, im) = by_admittance(&erm, freq_hz);
            let error = (erm.impedance(freq_hz) - Complex64::new(re, im)).norm() / re.hypot(im);
            assert!(error < 1e-12, "{error} at {freq_hz} Hz");
        }
    }

    #[test]
    fn refuses_what_no_cell_has() {
        let cases: [(Spoil, &str); 3] = [
            (
                |e| e.r_ohm = 0.0,
                "R of the ERM: expected a positive finite number in Ω, met 0",
            ),
            (
                |e| e.branches[1].r_ohm = -1.0,
                "R2 of the ERM: expected a positive finite number in Ω, met -1",
            ),
            (
                |e| e.branches[3].c_f = f64::NAN,
                "C4 of the ERM: expected a positive finite number in F, met NaN",
            ),
        ];
        for (spoil, message) in cases {
            let mut erm = appendix_a4();
            spoil(&mut erm);
            assert_eq!(erm.validate().unwrap_err().to_string(), message);
        }
        assert!(
            Erm::from_log_parameters(&[0.0, 1.0])
                .unwrap_err()
                .to_string()
                .ends_with("met 2")
        );
        assert!(
            Erm::from_log_parameters(&[])
                .unwrap_err()
                .to_string()
                .ends_with("met 0")
        );
        assert!(
            Erm::from_log_parameters(&[1e4])
                .unwrap_err()
                .to_string()
                .ends_with("met inf")
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn gradient_is_the_difference_quotient(
            logs in prop::collection::vec(-7.0..7.0f64, 0..4)
                .prop_map(|v| v.into_iter().flat_map(|x| [x - 6.0, -x]).collect::<Vec<_>>()),
            r in -7.0..0.0f64,
            log_f in -3.0..4.0f64,
        ) {
            let x: Vec<f64> = std::iter::once(r).chain(logs).collect();
            let freq_hz = 10f64.powf(log_f);
            let z = |x: &[f64]| Erm::from_log_parameters(x).unwrap().impedance(freq_hz);
            let gradient = Erm::from_log_parameters(&x).unwrap().log_gradient(freq_hz);
            prop_assert_eq!(gradient.len(), x.len());
            for (i, g) in gradient.iter().enumerate() {
                let h = 1e-5;
                let (mut up, mut down) = (x.clone(), x.clone());
                up[i] += h;
                down[i] -= h;
                let quotient = (z(&up) - z(&down)) / (2.0 * h);
                prop_assert!(
                    (quotient - g).norm() <= 1e-8 * x[i].exp().max(z(&x).norm()),
                    "parameter {}: {} against {}",
                    i,
                    g,
                    quotient
                );
            }
        }
    }
}
