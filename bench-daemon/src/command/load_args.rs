//! Arguments that give loads for which a map is to be good.

use std::path::PathBuf;

use bench_evaluate::investigate::cell_map::loads::Demands;

/// Loads, and the pack that they are for.
#[derive(Debug, Clone, clap::Args)]
pub struct LoadArgs {
    /// A load whose voltage a map is to predict, as `simulate` reads profiles; may be given several
    /// times. It starts at 90, 50 and 20 % of charge and at each of --at-degc, and is repeated for ten
    /// minutes.
    #[arg(long, value_name = "PROFILE")]
    pub under: Vec<PathBuf>,
    /// Temperatures at which the loads flow, °C, separated by commas [default: those of the [map] of
    /// the experiment, else those of the fitted map]
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        allow_hyphen_values = true,
        requires = "under"
    )]
    pub at_degc: Vec<f64>,
    /// Cells in series of the pack that the loads are for.
    #[arg(long, default_value_t = 1, value_name = "N", requires = "under")]
    pub series: u32,
    /// Cells in parallel of that pack.
    #[arg(long, default_value_t = 1, value_name = "N", requires = "under")]
    pub parallel: u32,
}

impl LoadArgs {
    /// Returns the loads.
    pub fn demands(&self) -> Demands {
        Demands {
            under: self.under.clone(),
            at_degc: self.at_degc.clone(),
            series: self.series,
            parallel: self.parallel,
        }
    }
}
