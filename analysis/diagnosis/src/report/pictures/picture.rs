//! Picture of a report, and the colours of its series.

use analysis_plot::Drawing;

use crate::outcome::Diagnosis;

/// Indices of colours.
pub(super) const AFTER: usize = 0;
pub(super) const BEFORE: usize = 1;
pub(super) const NOISE: usize = 2;
pub(super) const ALONE: usize = 6;

/// Kind of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Gap of one held-out run.
    HeldOut,
    /// Blocks of residuals and their misfit.
    Map,
    /// Residuals of a record over time.
    Time,
    /// Residuals of a spectrum over frequency.
    Spectrum,
    /// Scores of the candidates.
    Ranking,
    /// Gaps of the held-out runs.
    Gap,
    /// Matrix of effects that can be separated.
    Matrix,
}

/// A picture with its texts.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// File name without extension.
    pub name: String,
    /// Kind of the picture.
    pub kind: Kind,
    /// A sentence below it.
    pub caption: String,
    /// The picture.
    pub drawing: Drawing,
}

/// Returns a name with nothing in it that a file name cannot have.
pub(super) fn file_name(name: &str) -> String {
    let fit = |c: char| {
        if c.is_alphanumeric() || c == '-' {
            c
        } else {
            '_'
        }
    };
    name.chars().map(fit).collect()
}

/// Returns true if there is more to show than the base model.
pub(super) fn has_after(d: &Diagnosis) -> bool {
    !d.effects.is_empty()
}

/// Returns the named effects, short enough for a legend.
pub(super) fn effect_names(d: &Diagnosis) -> String {
    d.effects
        .iter()
        .map(|e| e.name)
        .collect::<Vec<_>>()
        .join(" + ")
}
