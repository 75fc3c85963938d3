//! Options of a diagnosis.

use super::experiment::{BenchLimits, Playable};
use super::findings::FindingKind;
use super::given::ByHand;
use super::progress::Progress;
use analysis_effects::{contract::Effect, effects::catalogue};
use analysis_fit::fit::Addition;

/// Options of a diagnosis.
#[derive(Clone)]
pub struct DiagnosisOptions {
    /// Candidates; by default all effects of the catalogue.
    pub candidates: Vec<&'static dyn Effect>,
    /// Limits of a recommended run; by default those of the data.
    pub limits: Option<BenchLimits>,
    /// Filter of the planned runs that may be recommended; by default all.
    pub playable: Option<Playable>,
    /// Whether a recommended run will be measured at once, so that no prediction is made without it.
    pub next_run_first: bool,
    /// Receives progress reports; by default they are discarded.
    pub progress: Progress,
    /// Findings whose correction replaces the raw data; by default none.
    pub accept: Vec<FindingKind>,
    /// Additions of the judged model, which belong to its base; by default none.
    pub given: Vec<Addition>,
    /// Effects put in or left out by hand; by default none.
    pub by_hand: ByHand,
}

impl DiagnosisOptions {
    /// Returns the options whose candidates lack what is left out by hand.
    pub(super) fn without_left_out(&self) -> Self {
        let mut options = self.clone();
        let without = &self.by_hand.without;
        let candidates = &mut options.candidates;
        candidates.retain(|effect| !without.contains(&effect.card().name));
        options
    }
}

impl Default for DiagnosisOptions {
    fn default() -> Self {
        Self {
            candidates: catalogue().to_vec(),
            limits: None,
            playable: None,
            next_run_first: false,
            progress: Progress::default(),
            accept: Vec::new(),
            given: Vec::new(),
            by_hand: ByHand::default(),
        }
    }
}
