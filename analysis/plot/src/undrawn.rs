//! Replaces the backend if the feature `draw` is off: plots can be described, and drawing one is an
//! error.

use super::PlotError;
use super::scene::Scene;
use std::path::Path;

/// Width of a letter of DejaVu Sans in em, about: the mean of its lower-case letters.
const LETTER_EM: f64 = 0.58;

impl Scene {
    /// Fails.
    pub(super) fn write(&self, _path: &Path) -> Result<(), PlotError> {
        self.to_svg().map(|_| ())
    }

    /// Fails.
    pub(super) fn to_svg(&self) -> Result<String, PlotError> {
        Err(PlotError::NoBackend {
            title: self.title.clone(),
        })
    }
}

/// Returns the width of a text in logical pixels, about.
pub(super) fn text_width(text: &str, size: f64) -> Result<f64, PlotError> {
    Ok(text.chars().count() as f64 * size * LETTER_EM)
}
