//! Terms that a fit models beside the sinusoid.

/// Terms that a fit models, and samples that it leaves out.
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// Slow change fitted besides the offset.
    pub drift: Drift,
    /// Orders of harmonics fitted besides the sinusoid; 2 is twice its frequency.
    pub harmonics: Vec<u32>,
    /// Other frequencies fitted, Hz: mains pick-up, a neighbour's switching. See
    /// [`FitOptions::with_mains`].
    pub also_hz: Vec<f64>,
    /// Time constants of the fitted relaxations, s: the remainder of a change of the current before
    /// the record. See [`relaxations`].
    pub decays_s: Vec<f64>,
    /// Change of the sinusoid over the record, fitted besides it. Only for a known frequency.
    pub varying: Varying,
    /// Leaves clipped samples out; otherwise they are fitted as valid samples and only counted.
    pub exclude_clipped: bool,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            drift: Drift::Linear,
            harmonics: Vec::new(),
            also_hz: Vec::new(),
            decays_s: Vec::new(),
            varying: Varying::None,
            exclude_clipped: true,
        }
    }
}

impl FitOptions {
    /// Adds the pick-up of the mains: its frequency (50 or 60 Hz) and its harmonics up to an order.
    /// The fit leaves out a tone that the record cannot separate from the sinusoid or is too short
    /// for, and reports this in its notes.
    #[must_use]
    pub fn with_mains(mut self, mains_hz: f64, orders: u32) -> Self {
        self.also_hz
            .extend((1..=orders).map(|order| f64::from(order) * mains_hz));
        self
    }
}

/// Returns the time constants, s, whose exponentials with a straight line span the relaxation of a
/// linear system over a record of `length_s`, whatever its own time constants are.
///
/// Of a single exponential of any time constant from 1.5 % to 8 lengths that began a tenth of a
/// length or more before the record, a fit of at least four periods leaves at most
/// [`RELAXATION_LEFT`] in the phasor (computed for 18 numbers of periods from 4 to 30, 5 delays and
/// 40 time constants). Faster ones have died away; slower ones are straight lines.
pub fn relaxations(length_s: f64) -> Vec<f64> {
    [0.03, 0.12, 0.4].map(|share| share * length_s).to_vec()
}

/// Greatest share of a relaxation that [`relaxations`] leave in a phasor.
pub const RELAXATION_LEFT: f64 = 8.0e-4;

/// Change of the amplitude and phase of the sinusoid over the record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Varying {
    /// The sinusoid is the same throughout.
    None,
    /// The phasor moves along a straight line. The fitted phasor is that of the middle of the record.
    /// Needs 3 periods, or it is left out.
    Linear,
}

/// Slow change of a channel, as a polynomial of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drift {
    /// Only the offset.
    None,
    /// A straight line.
    Linear,
    /// A parabola. Needs 2 periods, or it is left out.
    Quadratic,
}

impl Drift {
    pub(super) const fn degree(self) -> usize {
        match self {
            Self::None => 0,
            Self::Linear => 1,
            Self::Quadratic => 2,
        }
    }
}
