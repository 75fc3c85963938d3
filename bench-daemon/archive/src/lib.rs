//! Store and forward: finished runs to an object store, and their rows as Parquet.
//!
//! A run goes up file by file, each addressed by its hash, sent only where it is absent, and read back.
//! Its rows follow, then its list, which makes it exist in the store. What is done at any point can be
//! done again: the store is the same afterwards. This crate has no clock and waits for nothing but the
//! store; who calls it says when, and tries again.
//!
//! In reading order: [`layout`] (where things lie), [`store`] (folder or S3), `objects` (bytes, verified),
//! [`snapshot`] (a run folder), [`receipt`] (what became of a run), [`push`], [`verify`], [`fetch`],
//! [`thin`].

mod error;
pub mod fetch;
mod hash;
pub mod layout;
mod objects;
pub mod push;
pub mod receipt;
pub mod snapshot;
pub mod store;
mod tables;
pub mod thin;
pub mod verify;

pub use error::ArchiveError;
pub use store::Store;
