//! Multisine: many sinusoids at once, so that one record gives the impedance at all of them, its
//! noise and its nonlinear distortion. (Pintelon and Schoukens, *System Identification: A Frequency
//! Domain Approach*, 2nd ed. 2012, chapters 4 and 5.)
//!
//! [`odd_grid`] chooses odd harmonics of one frequency and leaves some of them out as detection
//! lines. [`design()`] gives them phases with a low crest factor. [`analyse`] evaluates a record of
//! several whole periods. A linear system responds at the excited harmonics only. A response at
//! even harmonics comes from even powers of the current. A response at odd harmonics that were left
//! out comes from odd powers. Everything between the harmonics is noise.
//!
//! Numbers in, numbers out: contains no generator and no scope.

mod analyse;
mod changing;
mod crest;
mod grid;
mod images;
mod measured_images;
mod placement;

pub use analyse::{
    Line, MultisineError, MultisineFit, analyse, analyse_changing, analyse_played, clock_offset,
    nonlinear, with_distortion,
};
pub use changing::Change;
pub use crest::{Design, design};
pub use grid::odd_grid;
pub use images::{Excited, Image, Sampling, images};
pub use measured_images::Proof;
pub use placement::{Choice, Disturbed, Path, Placement, place};
