//! Arguments of `catalog`.

use std::path::PathBuf;

use analysis::catalog::{query::Filter, record::CatalogVerdict};
use clap::{Args, Subcommand, ValueEnum};

use bench_plan::support::calendar::unix_s;

/// Arguments of `catalog`.
#[derive(Debug, Args)]
pub struct CatalogArgs {
    #[command(subcommand)]
    pub(super) act: Act,
}

#[derive(Debug, Subcommand)]
pub(super) enum Act {
    /// Read new and changed run folders into a catalogue. The folders are not changed.
    Scan(ScanArgs),
    /// List runs that meet every condition, the latest first.
    Find(FindArgs),
    /// List the cells of the runs that meet every condition, with the number of these runs.
    Cells(CellsArgs),
    /// Print everything that is known about a run.
    Show(ShowArgs),
    /// Write spectra, runs, fits or diagnoses as one table.
    Export(ExportArgs),
    /// Print a cell over its runs: resistances and diffusion over time, with uncertainty.
    Ageing(AgeingArgs),
}

#[derive(Debug, Args)]
pub(super) struct ScanArgs {
    /// The catalogue; created if it does not exist.
    #[arg(value_name = "DB")]
    pub(super) catalog: PathBuf,
    /// Folders with run folders at any depth [default: those of the scans before]
    #[arg(value_name = "ROOT")]
    pub(super) roots: Vec<PathBuf>,
    /// Remove runs whose folders no longer exist, instead of marking them.
    #[arg(long)]
    pub(super) forget_missing: bool,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

/// Conditions on runs and what they have measured.
#[derive(Debug, Clone, Args)]
pub(super) struct FilterArgs {
    /// Name, serial number or barcode of a cell.
    #[arg(long, value_name = "TEXT")]
    cell: Option<String>,
    /// Serial number of a cell, from the experiment or read by a person, or its barcode.
    #[arg(long, value_name = "TEXT")]
    serial: Option<String>,
    /// Batch of a cell.
    #[arg(long, value_name = "TEXT")]
    batch: Option<String>,
    /// Name of an experiment.
    #[arg(long, value_name = "NAME")]
    experiment: Option<String>,
    /// Name of a bench.
    #[arg(long, value_name = "NAME")]
    bench: Option<String>,
    /// Started at this time or later: 2026-11-28, 2026-11-28T12:00:00Z, or s since 1970.
    #[arg(long, value_name = "TIME", value_parser = unix_s)]
    from: Option<f64>,
    /// Started before this time.
    #[arg(long, value_name = "TIME", value_parser = unix_s)]
    to: Option<f64>,
    /// Verdict of the run.
    #[arg(long)]
    verdict: Option<Verdict>,
    /// Runs that the interlock ended, also if they were resumed afterwards.
    #[arg(long)]
    trip: bool,
    /// Runs that have fitted a map over charge and temperature.
    #[arg(long)]
    map: bool,
    /// Words in the name, bench, experiment, operator, end or cells of the run.
    #[arg(long, value_name = "WORDS")]
    text: Option<String>,
}

/// Verdict of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Verdict {
    /// Finished; no point was refused.
    Good,
    /// Finished, with refused points or a missed state of charge.
    Doubtful,
    /// A person stopped it before it finished.
    Stopped,
    /// Ended early for another reason.
    Failed,
    /// The journal has no end entry.
    Unfinished,
    /// A file of the run folder cannot be read.
    Damaged,
}

impl Verdict {
    fn of_catalog(self) -> CatalogVerdict {
        match self {
            Self::Good => CatalogVerdict::Good,
            Self::Doubtful => CatalogVerdict::Doubtful,
            Self::Stopped => CatalogVerdict::Stopped,
            Self::Failed => CatalogVerdict::Failed,
            Self::Unfinished => CatalogVerdict::Unfinished,
            Self::Damaged => CatalogVerdict::Damaged,
        }
    }
}

impl FilterArgs {
    /// Returns the conditions, with a start position and a maximum length.
    pub(super) fn filter(&self, after: Option<String>, most: usize) -> Filter {
        Filter {
            cell: self.cell.clone(),
            serial: self.serial.clone(),
            batch: self.batch.clone(),
            experiment: self.experiment.clone(),
            bench: self.bench.clone(),
            from_unix_s: self.from,
            to_unix_s: self.to,
            verdict: self.verdict.map(Verdict::of_catalog),
            trip: self.trip,
            map: self.map,
            tag: None,
            text: self.text.clone(),
            after,
            most,
        }
    }

    /// Whether no cell is named.
    pub(super) fn names_no_cell(&self) -> bool {
        self.cell.is_none() && self.serial.is_none()
    }

    /// Whether a serial number is named.
    pub(super) fn names_serial(&self) -> bool {
        self.serial.is_some()
    }
}

/// Part of a long answer.
#[derive(Debug, Clone, Args)]
pub(super) struct PageArgs {
    /// Continue after the previous answer: the text that it ended with.
    #[arg(long, value_name = "TEXT")]
    pub(super) after: Option<String>,
    /// Maximum number of results.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub(super) most: usize,
}

#[derive(Debug, Args)]
pub(super) struct FindArgs {
    /// The catalogue.
    #[arg(value_name = "DB")]
    pub(super) catalog: PathBuf,
    #[command(flatten)]
    pub(super) filter: FilterArgs,
    #[command(flatten)]
    pub(super) page: PageArgs,
    /// Print JSON.
    #[arg(long, conflicts_with = "csv")]
    pub(super) json: bool,
    /// Print CSV.
    #[arg(long)]
    pub(super) csv: bool,
}

#[derive(Debug, Args)]
pub(super) struct CellsArgs {
    /// The catalogue.
    #[arg(value_name = "DB")]
    pub(super) catalog: PathBuf,
    #[command(flatten)]
    pub(super) filter: FilterArgs,
    #[command(flatten)]
    pub(super) page: PageArgs,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, Args)]
pub(super) struct ShowArgs {
    /// The catalogue.
    #[arg(value_name = "DB")]
    pub(super) catalog: PathBuf,
    /// Identity, folder or name of the run.
    #[arg(value_name = "RUN")]
    pub(super) run: String,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

/// Table that is exported.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Table {
    /// Corrected spectra of cells in long form: one row for each point.
    Spectra,
    /// Runs.
    Runs,
    /// Fitted models.
    Fits,
    /// Diagnoses.
    Diagnoses,
}

#[derive(Debug, Args)]
pub(super) struct ExportArgs {
    /// The catalogue.
    #[arg(value_name = "DB")]
    pub(super) catalog: PathBuf,
    /// The table: Parquet if its name ends in `.parquet`, otherwise CSV.
    #[arg(long, value_name = "FILE")]
    pub(super) out: PathBuf,
    /// Rows of the table.
    #[arg(long, default_value = "spectra")]
    pub(super) table: Table,
    #[command(flatten)]
    pub(super) filter: FilterArgs,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, Args)]
pub(super) struct AgeingArgs {
    /// The catalogue.
    #[arg(value_name = "DB")]
    pub(super) catalog: PathBuf,
    #[command(flatten)]
    pub(super) filter: FilterArgs,
    /// Number of RC pairs of the models [default: the greatest that every run of the cell has]
    #[arg(long, value_name = "N")]
    pub(super) rc: Option<u32>,
    /// Write `ageing.csv`, `ageing.svg` and `ageing.png` into this folder.
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}
