//! Choice of the spectra that are drawn.

/// Maximum number of spectra that are all drawn by default: one picture takes longer than a
/// hundred fits.
const DRAWN_UNASKED: usize = 20;

/// Spectra that are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Plots {
    /// None.
    None,
    /// Those without a result, and those with warnings.
    Failed,
    /// All.
    All,
}

impl Plots {
    /// Returns the requested choice, or the default for this number of spectra.
    pub fn chosen(asked: Option<Self>, spectra: usize) -> Self {
        let unasked = if spectra > DRAWN_UNASKED {
            Self::None
        } else {
            Self::All
        };
        asked.unwrap_or(unasked)
    }

    /// Returns whether a spectrum is drawn, given whether it needs inspection.
    pub fn draws(self, needs_a_look: bool) -> bool {
        match self {
            Self::None => false,
            Self::Failed => needs_a_look,
            Self::All => true,
        }
    }
}
