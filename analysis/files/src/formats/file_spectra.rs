//! Spectra of a file, with remarks on how they were read.

use analysis_signal::spectrum::SourcedSpectrum;

/// The spectra of a file, and remarks on how they were read, which whoever asked for them ought to
/// see.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FileSpectra {
    /// The spectra, in the order of their first row.
    pub spectra: Vec<SourcedSpectrum>,
    /// Sentences that begin with the file's name: by what spectra were told apart, what was left
    /// out or taken for granted.
    pub notes: Vec<String>,
}
