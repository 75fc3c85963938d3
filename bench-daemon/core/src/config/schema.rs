//! JSON Schemas of the files, which are part of the program.

use clap::ValueEnum;

/// Text of a schema of the repository's `docs/schema`.
macro_rules! schema {
    ($name:literal) => {
        include_str!(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../docs/schema/",
            $name,
            ".json"
        ))
    };
}

/// Kind of a file.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum Kind {
    /// Course of a measurement.
    Experiment,
    /// Instruments and wiring.
    Bench,
    /// Limits of a cell, and facts of it.
    Cell,
    /// Truth of a simulated bench.
    Scenario,
    /// A server.
    Server,
    /// A data set for `diagnose`.
    Dataset,
    /// A campaign over cells and benches.
    Campaign,
}

impl Kind {
    /// The schema of such a file.
    pub fn schema(self) -> &'static str {
        match self {
            Self::Experiment => schema!("experiment"),
            Self::Bench => schema!("bench"),
            Self::Cell => schema!("cell"),
            Self::Scenario => schema!("scenario"),
            Self::Server => schema!("server"),
            Self::Dataset => schema!("dataset"),
            Self::Campaign => schema!("campaign"),
        }
    }
}
