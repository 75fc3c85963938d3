//! Effects that a model may lack.
//!
//! [`contract`] defines an effect, [`augmented`] simulates a base model with any set of them,
//! [`effects`] is the catalogue, one file per effect.

pub mod augmented;
pub mod contract;
pub mod effects;
