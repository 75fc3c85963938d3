//! One table of results of many: `--table` of `fit`, `kk`, `simulate` and `diagnose`.

pub mod paths;
mod plots;
mod source;
mod spectra;
mod work;

pub use plots::Plots;
pub use source::Choice;
pub use spectra::{Batch, work_on_spectra};
pub use work::{Items, Job, work};

use std::path::{Path, PathBuf};

use bench_core::safety::failure::Failure;

/// Arguments of commands that make a table of many spectra.
#[derive(Debug, Clone, clap::Args)]
pub struct TableArgs {
    /// Write one table of results, .parquet or .csv: a row for each spectrum of files, folders and
    /// tables in long form (Parquet or CSV with `spectrum_id,freq_hz,z_re_ohm,z_im_ohm`). If
    /// the call is interrupted, the next call with the same arguments continues it.
    #[arg(long, value_name = "FILE")]
    pub table: Option<PathBuf>,
    /// Spectra that are drawn into --out: `none`, `failed` (no result, or one with warnings) or
    /// `all` [default: all, above 20 spectra none]
    #[arg(long, value_name = "none|failed|all")]
    pub plots: Option<Plots>,
}

impl TableArgs {
    /// Folder of the pictures of a table and which are drawn; none by default.
    ///
    /// # Errors
    /// Pictures without a folder.
    pub fn pictures<'a>(
        &self,
        out: Option<&'a Path>,
    ) -> Result<Option<(&'a Path, Plots)>, Failure> {
        let plots = self.plots.unwrap_or(Plots::None);
        match out {
            Some(folder) => Ok(Some((folder, plots))),
            None if plots == Plots::None => Ok(None),
            None => Err(Failure::Usage(
                "--plots: expected --out with the folder of the pictures, found none".to_owned(),
            )),
        }
    }
}
