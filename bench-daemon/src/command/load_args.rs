//! Arguments that give loads for which a map is to be good.

use std::{fmt::Write as _, path::PathBuf};

use bench_evaluate::investigate::cell_map::loads::Demands;
use bench_plan::support::quoted::quoted;

/// Loads, and the pack that they are for.
#[derive(Debug, Clone, clap::Args)]
pub struct LoadArgs {
    /// A load whose voltage a map is to predict, as `simulate` reads profiles; may be given several
    /// times. It starts at 90, 50 and 20 % of charge and at each of --at-degc, and is repeated for ten
    /// minutes.
    #[arg(long, value_name = "PROFILE")]
    pub under: Vec<PathBuf>,
    /// Temperatures at which the loads flow, °C, separated by commas [default: those of the
    /// experiment's map, else those of the fitted map]
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
    /// The loads as words of a command line.
    pub fn words(&self) -> String {
        let mut words = String::new();
        for path in &self.under {
            // Writing into a string cannot fail.
            let _ = write!(words, "--under {} ", quoted(path));
        }
        if !self.at_degc.is_empty() {
            let degc: Vec<String> = self.at_degc.iter().map(f64::to_string).collect();
            let _ = write!(words, "--at-degc={} ", degc.join(","));
        }
        let _ = write!(
            words,
            "--series {} --parallel {}",
            self.series, self.parallel
        );
        words
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_of_loads_can_be_pasted() {
        let loads = LoadArgs {
            under: vec!["my loads/a.csv".into(), "b.csv".into()],
            at_degc: vec![-10.0, 25.0],
            series: 16,
            parallel: 3,
        };
        assert_eq!(
            loads.words(),
            "--under 'my loads/a.csv' --under b.csv --at-degc=-10,25 --series 16 --parallel 3"
        );
    }
}
