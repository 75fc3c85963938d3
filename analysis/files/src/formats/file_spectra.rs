//! Spectra of a file, with remarks on how they were read.

use analysis_signal::spectrum::SourcedSpectrum;

/// The spectra of a file, and remarks on how they were read, which the caller must show to the
/// user.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FileSpectra {
    /// The spectra, in the order of their first row.
    pub spectra: Vec<SourcedSpectrum>,
    /// Sentences that begin with the file's name: how spectra were separated, what was left out,
    /// and which assumptions were made.
    pub notes: Vec<String>,
}
