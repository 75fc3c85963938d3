//! Effects that a model may lack.
//!
//! [`contract`] says what an effect is, [`augmented`] plays a base model with any set of them,
//! [`effects`] is the catalogue, one file per effect.

pub mod augmented;
pub mod contract;
pub mod effects;
