//! Tests whether a spectrum can come from a linear, causal system that did not change during the
//! measurement. It serves everybody who wants to fit a spectrum and asks first whether it is valid.
//!
//! [`kramers_kronig`] and [`z_hit`] test one spectrum, [`linearity`] sweeps of different amplitude,
//! [`stationarity`] repeats. [`assess`] does all of it for the spectra of one cell and states in
//! words which points are valid. Every test judges by the noise ([`Noise`]) and has a stated rate
//! of false alarms: of a hundred valid spectra at most one is called bad.

mod assess;
mod ceiling;
mod flaws;
mod kramers_kronig;
mod ladder;
mod linearity;
mod noise;
mod record;
mod signs;
mod smooth;
mod stationarity;
pub mod tail;
mod thin;
mod verdict;
mod z_hit;

pub use assess::{Assessed, Assessment, assess, assess_by};
pub use flaws::{Flaws, flaws};
pub use kramers_kronig::{FEWEST_POINTS, KkOutcome, KkPoint, KramersKronig, kramers_kronig};
pub use linearity::{Linearity, LinearityPoint, linearity};
pub use noise::{FEWEST_REPEATS, Noise, NoiseSource};
pub use record::{Harmonic, Record, beyond_noise};
pub use signs::{
    LoopBand, inductive_from_hz, sign_remarks, slow_loop_band, slow_loop_remarks,
    wrong_sign_remarks,
};
pub use stationarity::{Drift, DriftShape, Stationarity, StationarityPoint, stationarity};
pub use thin::{MOST_POINTS, thinned};
pub use verdict::{Grade, PointVerdict, SpectrumVerdict};
pub use z_hit::{ZHit, ZHitPoint, z_hit};

use analysis_signal::spectrum::{Spectrum, SpectrumError};

/// Share of valid spectra that may be called bad.
pub const FALSE_ALARM_RATE: f64 = 0.01;
/// Share of valid spectra in which something may be called doubtful by chance.
pub const DOUBTFUL_RATE: f64 = 0.05;

/// Reason why spectra cannot be judged.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ValidityError {
    /// The numbers are not a valid spectrum.
    #[error(transparent)]
    Spectrum(#[from] SpectrumError),
    /// A point that nothing can be measured against.
    #[error(
        "spectrum {spectrum:?}, point {number} ({freq_hz} Hz): expected an impedance other than 0 \
        Ω, met 0 Ω"
    )]
    Zero {
        /// Its name.
        spectrum: String,
        /// Number of the point, from 1.
        number: usize,
        /// Its frequency, Hz.
        freq_hz: f64,
    },
    /// Nothing to judge by.
    #[error("spectrum {spectrum:?}: expected at least {expected} points to judge it by, met {met}")]
    TooFewPoints {
        /// Its name.
        spectrum: String,
        /// Points needed.
        expected: usize,
        /// Points met.
        met: usize,
    },
}

/// Both have the same frequencies, to a part in a thousand.
fn same_grid(a: &Spectrum, b: &Spectrum) -> bool {
    let equal = |(a, b): (&f64, &f64)| (a / b - 1.0).abs() < 1e-3;
    let freqs = |s: &Spectrum| s.points.iter().map(|p| p.freq_hz).collect::<Vec<_>>();
    a.points.len() == b.points.len() && freqs(a).iter().zip(&freqs(b)).all(equal)
}

#[cfg(test)]
mod tests;
