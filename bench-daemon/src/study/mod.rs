//! The blind study of the discrepancy workflow: hidden effects from `fixtures`, diagnosed without
//! labels, scored.
//!
//! The labels stay in [`trial`]; the diagnosis gets runs, the bench's history and a model, nothing
//! else.

pub mod convert;
pub mod names;
pub mod settle;
pub mod tally;
pub mod trial;
