//! Store and forward: uploads finished runs to an object store, and their rows as Parquet.
//!
//! A run is uploaded file by file. Each file is addressed by its hash, sent only if it is absent,
//! and read back. Its rows follow, and finally its list, which makes the run visible in the store.
//! Every operation can be repeated at any point with an identical result. This crate has no clock
//! and waits only for the store; the caller schedules operations and retries them.
//!
//! In reading order: [`layout`] (paths and lists), [`store`] (folder or S3), `objects` (bytes,
//! verified), [`snapshot`] (a run folder), [`receipt`] (the state of a run), [`push`], [`verify`],
//! [`fetch`], [`thin`].

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
