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
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
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
    /// Returns the kind of a file from the keys of its text; `None` if they do not show it.
    pub fn of(text: &str) -> Option<Self> {
        let table: toml::Table = text.parse().ok()?;
        let has = |key: &str| table.contains_key(key);
        let kinds = [
            (has("cell") && has("bench"), Self::Experiment),
            (has("instruments"), Self::Bench),
            (has("listen"), Self::Server),
            (has("experiment") && has("benches"), Self::Campaign),
            (has("benches"), Self::Server),
            (has("runs"), Self::Dataset),
            (has("capacity") && has("voltage_min"), Self::Cell),
            (
                table.get("cell").is_some_and(toml::Value::is_str),
                Self::Experiment,
            ),
            (
                table.get("cell").is_some_and(toml::Value::is_table),
                Self::Scenario,
            ),
        ];
        let found = kinds.into_iter().find(|(is, _)| *is)?;
        Some(found.1)
    }

    /// Returns the kind with its article, for messages.
    pub fn phrase(self) -> &'static str {
        match self {
            Self::Experiment => "an experiment",
            Self::Bench => "a bench",
            Self::Cell => "a cell",
            Self::Scenario => "a scenario",
            Self::Server => "a server",
            Self::Dataset => "a data set",
            Self::Campaign => "a campaign",
        }
    }

    /// Returns what to do about a file that is not of this kind, after a semicolon.
    pub(super) fn hint(self, found: &str) -> &'static str {
        match (self, found) {
            (Self::Experiment, "a bench") => {
                "; an experiment names its bench, and --bench gives it another one: `eis-bench run \
                EXPERIMENT --bench BENCH`; `eis-bench config new DIR` writes files to begin with"
            }
            (Self::Experiment, "a cell") => {
                "; an experiment names its cell; `eis-bench config new DIR` writes files to begin \
                with"
            }
            (Self::Dataset, "another file") => {
                " (a data set is a folder with dataset.toml, or a run folder); `eis-bench dataset \
                init FILE --out DIR` makes one of logs and spectra"
            }
            _ => "",
        }
    }

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
