//! Treatment of the slope of the open-circuit voltage in spectra that are to be fitted.

use super::options::Objective;
use analysis_model::ocv::SLOPE_SHARE;
use analysis_signal::spectrum::{OcvSlope, Spectrum};

/// Treatment of the slope of the open-circuit voltage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Slope {
    /// It stays in the impedances.
    Left,
    /// A known slope, which is subtracted.
    Known(OcvSlope),
    /// It is fitted with a prior for each spectrum.
    Fitted,
}

/// Reason why a slope was refused. The text goes on after the argument's name.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SlopeError {
    /// A fit of the slope with an objective that does not support it.
    #[error(" fit: expected --objective complex, found {objective}")]
    Objective {
        /// The objective.
        objective: Objective,
    },
    /// The text is not a slope.
    #[error(": expected `fit`, `none` or a slope in V/C, found {met:?}")]
    Text {
        /// The text met.
        met: String,
    },
}

impl Slope {
    /// Treatment by its name: `fit`, `none`, or a slope in V/C. Without one it is fitted where the
    /// objective has room for it.
    ///
    /// # Errors
    /// [`SlopeError`].
    pub fn asked(text: Option<&str>, objective: Objective) -> Result<Self, SlopeError> {
        let complex = objective == Objective::Complex;
        match text {
            None | Some("fit") if complex => Ok(Self::Fitted),
            None | Some("none") => Ok(Self::Left),
            Some("fit") => Err(SlopeError::Objective { objective }),
            Some(text) => {
                let number = text.trim().trim_end_matches("V/C").trim().parse::<f64>();
                let v_per_coulomb = number.ok().filter(|v| v.is_finite() && *v >= 0.0);
                let v_per_coulomb = v_per_coulomb.ok_or_else(|| SlopeError::Text {
                    met: text.to_owned(),
                })?;
                Ok(Self::Known(OcvSlope {
                    v_per_coulomb,
                    sigma_v_per_coulomb: SLOPE_SHARE * v_per_coulomb,
                }))
            }
        }
    }

    /// A spectrum as it is to be fitted.
    pub fn less(&self, spectrum: &Spectrum) -> Spectrum {
        match self {
            Self::Left => spectrum.clone(),
            Self::Known(slope) => spectrum.less_charge_storage(*slope),
            Self::Fitted => OcvSlope::prior(spectrum).map_or_else(
                || spectrum.clone(),
                |slope| spectrum.less_charge_storage(slope),
            ),
        }
    }
}
