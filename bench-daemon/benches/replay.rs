//! Speed of the repeated analysis of a campaign's captures. The speeds of the disk and of the
//! decoder for the same files are stated for comparison.
//!
//! `cargo bench --profile dev -p bench-daemon` first runs the campaign of
//! `configs/experiments/campaign.toml`; `-- FOLDER` uses an existing run.

use std::path::PathBuf;

use bench_daemon::command::{replay::rates, run::run_experiment};
use bench_plan::config::load_experiment;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let named = std::env::args()
        .skip(1)
        .find(|word| !word.starts_with('-'))
        .map(PathBuf::from);
    let scratch = std::env::temp_dir().join(format!("eis-bench-bench-{}", std::process::id()));
    let folder = match &named {
        Some(folder) => folder.clone(),
        None => {
            let file = PathBuf::from(concat!(
                env!("CARGO_MANIFEST_DIR"),
                "/../configs/experiments/campaign.toml"
            ));
            run_experiment(&load_experiment(&file, None)?, &scratch)?;
            scratch.clone()
        }
    };
    let found = rates(&folder);
    if named.is_none() {
        std::fs::remove_dir_all(&scratch)?;
    }
    for line in found? {
        eprintln!("{line}");
    }
    Ok(())
}
