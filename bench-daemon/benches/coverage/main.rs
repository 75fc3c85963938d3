//! Coverage of stated uncertainties: runs a shipped experiment on the simulated bench over many
//! seeds and counts how often the truth lies within the stated 68 % and 95 % intervals, per
//! frequency and per parameter. Fails if the seeds refute a 95 % interval. The drills run a share
//! of it.
//!
//! `cargo bench --profile dev -p bench-daemon --bench coverage -- demo accurate multisine thesis
//! campaign joint --seeds 100 --from 1`

mod played;
mod synthetic;
mod tally;

use std::path::PathBuf;

use played::Played;
use tally::Tally;

/// The experiments that are run if none is named.
const ALL: [&str; 6] = [
    "demo",
    "thesis",
    "accurate",
    "multisine",
    "campaign",
    "joint",
];

/// Arguments of the command line.
struct Options {
    names: Vec<String>,
    seeds: u64,
    from: u64,
    /// Whether harness and slope of the open-circuit voltage are drawn again for each seed.
    drawn: bool,
    /// Folder for the deviations of each table.
    out: Option<PathBuf>,
}

fn given() -> Result<Options, Box<dyn std::error::Error>> {
    let mut given = Options {
        names: Vec::new(),
        seeds: 20,
        from: 1,
        drawn: false,
        out: None,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--seeds" => given.seeds = words.next().ok_or("--seeds: expected a number")?.parse()?,
            "--from" => given.from = words.next().ok_or("--from: expected a seed")?.parse()?,
            "--out" => given.out = Some(words.next().ok_or("--out: expected a folder")?.into()),
            "--drawn" => given.drawn = true,
            "--bench" => {}
            name if ALL.contains(&name) => given.names.push(name.to_owned()),
            other => {
                return Err(format!(
                    "expected one of {ALL:?}, --seeds N, --from SEED, --drawn \
            or --out FOLDER, met {other:?}"
                )
                .into());
            }
        }
    }
    if given.names.is_empty() {
        given.names = ALL.map(str::to_owned).to_vec();
    }
    Ok(given)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let given = given()?;
    let seeds: Vec<u64> = (given.from..given.from + given.seeds).collect();
    let mut refuted = Vec::new();
    for name in &given.names {
        let tally: Tally = if name == "joint" {
            synthetic::play(&seeds)
        } else {
            played::play(
                &Played {
                    configs: &configs(),
                    name,
                    drawn: given.drawn,
                },
                &seeds,
            )?
        };
        eprintln!(
            "{}",
            tally.table(&format!(
                "{name}, {} seeds from {}",
                given.seeds, given.from
            ))
        );
        if let Some(folder) = &given.out {
            std::fs::create_dir_all(folder)?;
            std::fs::write(folder.join(format!("{name}.csv")), csv(&tally))?;
        }
        refuted.extend(
            tally
                .refuted()
                .into_iter()
                .map(|row| format!("{name}: {row}")),
        );
    }
    if refuted.is_empty() {
        Ok(())
    } else {
        Err(format!(
            "95 % intervals that these seeds refute: {}",
            refuted.join("; ")
        )
        .into())
    }
}

/// Returns the deviations over their standard deviations, one quantity per line in the order of
/// the seeds.
fn csv(tally: &Tally) -> String {
    let line = |(name, deviations): (&str, &[f64])| {
        let values: Vec<String> = deviations.iter().map(|d| format!("{d:.4}")).collect();
        format!("\"{name}\",{}\n", values.join(","))
    };
    tally.rows().map(line).collect()
}

fn configs() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../configs"))
}
