//! Phasors of the four probe channels, and complex impedances with their uncertainty.
//!
//! A phasor `p` stands for the signal Re{p · exp(jωt)}; all phasors of one point share the same
//! time zero. The voltage pair is channel 4 minus channel 3, the current pair channel 2 minus
//! channel 1 over the shunt (thesis 3.3.1).

mod error;
mod frozen;
mod phasors;
mod shared;
mod sourced;

use analysis_numeric::Covariance2;
use analysis_plot::{Series, SeriesPoint};
use num_complex::Complex64;

pub use error::SpectrumError;
pub use frozen::at_one_time;
pub use phasors::{ChannelPhasors, PhasorVariance};
pub use shared::{OCV_SLOPE, OcvSlope, SharedError};
pub use sourced::cell_in_name;
pub use sourced::{FlaggedPoint, Origin, SourcedSpectrum};

/// A complex impedance at one frequency with the covariance of its parts.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ImpedancePoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Impedance, Ω.
    pub z_ohm: Complex64,
    /// Covariance of (Re, Im), Ω².
    pub covariance: Covariance2,
    /// Amplitude of the current, A (zero to peak); NaN if a file does not state it.
    pub amplitude_a: f64,
}

/// Impedance over frequency of one fixture in one run.
///
/// ```
/// use analysis_numeric::Covariance2;
/// use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
/// use num_complex::Complex64;
///
/// // 10 mΩ in series with 20 mΩ beside 8 F: time constant 160 ms, corner near 1 Hz.
/// let point = |freq_hz: f64| ImpedancePoint {
///     freq_hz,
///     z_ohm: 0.01 + 0.02 / Complex64::new(1.0, std::f64::consts::TAU * freq_hz * 0.16),
///     covariance: Covariance2::circular(1e-10),
///     amplitude_a: 1.0,
/// };
/// let points = [1000.0, 1.0, 0.001].map(point).to_vec();
/// let mut spectrum = Spectrum { name: "cell0_0".to_owned(), points, ..Spectrum::default() };
/// spectrum.sort();
/// spectrum.validate()?;
/// assert!((spectrum.points[0].magnitude_ohm() - 0.03).abs() < 1e-6);
/// assert!(spectrum.points[1].phase_rad() < -0.3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Spectrum {
    /// Origin of the spectrum: a file name, a run.
    pub name: String,
    /// The points, by rising frequency.
    pub points: Vec<ImpedancePoint>,
    /// Errors that the points have in common. The covariance of a point holds its share of each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared: Vec<SharedError>,
    /// Slope of the open-circuit voltage whose contribution was subtracted from the points; `None`
    /// if they are as measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub less: Option<OcvSlope>,
}

/// Returns the impedance from the voltage pair over the current pair, (V₄ − V₃)/(V₂ − V₁) ·
/// R_shunt, without any correction, with the covariance from the noise of the four channels. It is
/// not finite without a current.
///
/// The quotient is analytic in every channel, so a derivative rotates and scales the covariance of
/// its phasor: R/(V₂ − V₁) for V₄ and −V₃, and Z/(V₂ − V₁) for V₁ and −V₂.
///
/// ```
/// use analysis_numeric::Covariance2;
/// use analysis_signal::spectrum::{ChannelPhasors, PhasorVariance, raw_impedance};
/// use num_complex::Complex64;
///
/// // 2 A through a shunt of 10 mΩ and a cell of 15 − 5j mΩ, with 1 µV of noise per channel.
/// let cell_v = 2.0 * Complex64::new(0.015, -0.005);
/// let variance = PhasorVariance {
///     noise: Covariance2::circular(1e-12),
///     quantisation: Covariance2::ZERO,
///     drift: Covariance2::ZERO,
/// };
/// let volts = [0.0.into(), 0.02.into(), 0.02.into(), cell_v + 0.02];
/// let phasors = ChannelPhasors { freq_hz: 10.0, volts, variance: [variance; 4] };
/// let point = raw_impedance(&phasors, 0.01);
/// assert!((point.z_ohm - Complex64::new(0.015, -0.005)).norm() < 1e-12);
/// assert!((point.amplitude_a - 2.0).abs() < 1e-12);
/// assert!(point.magnitude_sigma_ohm() < 2e-6);
/// ```
pub fn raw_impedance(phasors: &ChannelPhasors, shunt_ohm: f64) -> ImpedancePoint {
    let [v1, v2, v3, v4] = phasors.volts;
    let across_shunt = v2 - v1;
    let z_ohm = (v4 - v3) / across_shunt * shunt_ohm;
    let by_voltage = Complex64::from(shunt_ohm) / across_shunt;
    let by_current = z_ohm / across_shunt;
    let [n1, n2, n3, n4] = phasors.totals();
    let noise = (n3 + n4).scaled(by_voltage) + (n1 + n2).scaled(by_current);
    ImpedancePoint {
        freq_hz: phasors.freq_hz,
        z_ohm,
        covariance: noise,
        amplitude_a: across_shunt.norm() / shunt_ohm.abs(),
    }
}

impl ImpedancePoint {
    /// Returns the magnitude |Z|, Ω.
    pub fn magnitude_ohm(&self) -> f64 {
        self.z_ohm.norm()
    }

    /// Returns the standard deviation of the magnitude, Ω, to first order.
    pub fn magnitude_sigma_ohm(&self) -> f64 {
        self.covariance.variance_along(self.z_ohm.arg()).sqrt()
    }

    /// Returns the phase arg Z, rad, −π…π.
    pub fn phase_rad(&self) -> f64 {
        self.z_ohm.arg()
    }

    /// Returns the standard deviation of the phase, rad, to first order; at most π/√3, the value
    /// for an unknown phase.
    pub fn phase_sigma_rad(&self) -> f64 {
        let across = self
            .covariance
            .variance_along(self.z_ohm.arg() + std::f64::consts::FRAC_PI_2)
            .sqrt();
        let sigma = across / self.z_ohm.norm();
        if sigma.is_nan() {
            sigma
        } else {
            sigma.min(std::f64::consts::PI / 3f64.sqrt())
        }
    }

    /// Fault of the numbers of this point: the value expected and the value found.
    fn fault(&self) -> Option<(&'static str, String)> {
        if !(self.freq_hz > 0.0 && self.freq_hz.is_finite()) {
            return Some(("a frequency above 0 Hz", format!("{} Hz", self.freq_hz)));
        }
        if !(self.z_ohm.re.is_finite() && self.z_ohm.im.is_finite()) {
            return Some(("a finite impedance", format!("{} Ω", self.z_ohm)));
        }
        let Covariance2 {
            re_re,
            re_im,
            im_im,
        } = self.covariance;
        let unknown = re_re.is_nan() && re_im.is_nan() && im_im.is_nan();
        if !unknown && !self.covariance.is_valid() {
            return Some((
                "a covariance of positive variances, or none",
                format!("{re_re}, {re_im}, {im_im} Ω²"),
            ));
        }
        if self.amplitude_a < 0.0 || self.amplitude_a.is_infinite() {
            return Some((
                "an amplitude of 0 A or more, or none",
                format!("{} A", self.amplitude_a),
            ));
        }
        None
    }
}

impl Spectrum {
    /// Returns the spectrum as points with 2σ, its name in the legend.
    pub fn series(&self, colour: usize) -> Series {
        let point = |p: &ImpedancePoint| SeriesPoint {
            freq_hz: p.freq_hz,
            z_ohm: p.z_ohm,
            covariance: p.covariance,
        };
        Series::data(&self.name, self.points.iter().map(point).collect(), colour)
    }

    /// Checks that there are points, that their frequencies rise, and that their numbers are
    /// usable. An unknown covariance or amplitude (not a number) is allowed.
    ///
    /// # Errors
    /// [`SpectrumError::Empty`] or [`SpectrumError::Point`] with the first point that is wrong.
    pub fn validate(&self) -> Result<(), SpectrumError> {
        if self.points.is_empty() {
            return Err(SpectrumError::Empty {
                name: self.name.clone(),
            });
        }
        let mut last_hz = 0.0;
        for (index, point) in self.points.iter().enumerate() {
            let falling = point.freq_hz <= last_hz && point.freq_hz > 0.0;
            let fault = point.fault().or_else(|| {
                falling.then(|| {
                    (
                        "rising frequencies",
                        format!("{} Hz after {last_hz} Hz", point.freq_hz),
                    )
                })
            });
            if let Some((expected, found)) = fault {
                return Err(SpectrumError::Point {
                    name: self.name.clone(),
                    number: index + 1,
                    freq_hz: point.freq_hz,
                    expected,
                    found,
                });
            }
            last_hz = point.freq_hz;
        }
        if let Some(error) = self
            .shared
            .iter()
            .find(|error| error.at_ohm.len() != self.points.len())
        {
            return Err(SpectrumError::Shared {
                name: self.name.clone(),
                error: error.name.clone(),
                points: self.points.len(),
                found: error.at_ohm.len(),
            });
        }
        Ok(())
    }

    /// Sorts the points by rising frequency.
    pub fn sort(&mut self) {
        let mut order: Vec<usize> = (0..self.points.len()).collect();
        order.sort_by(|a, b| self.points[*a].freq_hz.total_cmp(&self.points[*b].freq_hz));
        self.points = order.iter().map(|k| self.points[*k]).collect();
        for error in &mut self.shared {
            error.at_ohm = order
                .iter()
                .filter_map(|k| error.at_ohm.get(*k).copied())
                .collect();
        }
    }
}
