//! Catalogue of run folders: runs, cells, spectra, fits, diagnoses and trips, queried across runs.
//!
//! [`Catalog::scan`] reads run folders into one SQLite file, [`Catalog::open`] opens it for
//! queries. The run folders remain the only source of truth: a catalogue may be deleted at any
//! time, and a rebuilt one gives the same replies. The catalogue never writes into a run folder.
//!
//! In reading order: [`record`] (the contents of a run folder), `folder` and `journal` (how it is
//! read), `schema` (tables), `catalog` (the file), `store` (records into tables), `walk` and
//! [`scan`], `question`, `columns`, [`query`], [`ageing`], [`export`], [`rows`] (one run folder as
//! tables, without a catalogue).

pub mod ageing;
mod catalog;
mod columns;
mod error;
pub mod export;
mod folder;
mod journal;
pub mod query;
mod question;
pub mod record;
pub mod rows;
pub mod scan;
mod schema;
mod store;
mod walk;

pub use catalog::Catalog;
pub use error::CatalogError;
pub use schema::VERSION;
