//! `eis-bench study`: the blind study of the discrepancy workflow.

use std::path::PathBuf;

use clap::Args;
use fixtures::hidden::{EffectKind, Spec, Stratum};
use rayon::prelude::*;

use crate::{
    failure::Failure,
    files,
    study::{
        tally,
        trial::{Score, play, strength_for},
    },
    terminal::say,
};

/// λ of the strengths of each effect.
const LADDER: [f64; 9] = [5.0, 10.0, 20.0, 40.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0];

/// Arguments of `study`.
#[derive(Debug, Args)]
pub struct StudyArgs {
    /// Trials with nothing hidden.
    #[arg(long, default_value_t = 40)]
    pub nulls: u64,
    /// Trials per effect and strength.
    #[arg(long, default_value_t = 1)]
    pub singles: u64,
    /// Trials with two effects.
    #[arg(long, default_value_t = 20)]
    pub pairs: u64,
    /// Trials with three effects.
    #[arg(long, default_value_t = 0)]
    pub triples: u64,
    /// Trials with an effect outside the catalogue.
    #[arg(long, default_value_t = 20)]
    pub outside: u64,
    /// Trials with noise that the workflow does not model.
    #[arg(long, default_value_t = 0)]
    pub strange_noise: u64,
    /// Trials with damaged files.
    #[arg(long, default_value_t = 0)]
    pub corrupted: u64,
    /// The recommended runs are played for one in so many trials that end ambiguous, 0 for none;
    /// they cost more than all else.
    #[arg(long, default_value_t = 1)]
    pub follow_up_every: usize,
    /// Recommended runs that are played one after the other at most.
    #[arg(long, default_value_t = 3)]
    pub follow_ups: usize,
    /// Only this effect in the place of the single ones, by its name in labels; one outside the
    /// catalogue too.
    #[arg(long)]
    pub only: Option<String>,
    /// First seed.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder for `scores.json`.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// A trial: where it comes from, the effect and λ whose strength is yet to be found, and the rest.
type Trial = (Stratum, Option<(EffectKind, f64)>, Spec);

/// Runs the study.
///
/// # Errors
/// A trial that cannot be played.
pub fn study(args: &StudyArgs) -> Result<(), Failure> {
    let strata = [
        (Stratum::Null, args.nulls),
        (Stratum::Pair, args.pairs),
        (Stratum::Triple, args.triples),
        (Stratum::Outside, args.outside),
        (Stratum::StrangeNoise, args.strange_noise),
        (Stratum::Corrupted, args.corrupted),
    ];
    let drawn = strata
        .iter()
        .flat_map(|(s, count)| (0..*count).map(move |k| (*s, s.draw(args.seed + 1_000_003 * k))));
    let mut trials: Vec<Trial> = drawn.map(|(s, spec)| (s, None, spec)).collect();
    let only = |kind: &&EffectKind| {
        args.only
            .as_deref()
            .map_or(EffectKind::NAMED.contains(kind), |only| kind.name() == only)
    };
    for kind in EffectKind::NAMED
        .iter()
        .chain(&EffectKind::OUTSIDE)
        .filter(only)
    {
        for (step, lambda) in LADDER.iter().enumerate() {
            for k in 0..args.singles {
                let seed = args.seed + 7919 * (k * 9 + step as u64) + 104_729 * (*kind as u64);
                trials.push((
                    Stratum::Single,
                    Some((*kind, *lambda)),
                    Spec::single(seed, *kind, 0.0),
                ));
            }
        }
    }
    let started = std::sync::atomic::AtomicUsize::new(0);
    let scores: Vec<Score> = trials
        .par_iter()
        .enumerate()
        .map(|(index, (stratum, single, spec))| {
            let n = started.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            if n.is_multiple_of(200) {
                tracing::info!("{n} of {} trials", trials.len());
            }
            let spec = match single {
                Some((kind, lambda)) => {
                    Spec::single(spec.seed, *kind, strength_for(spec.seed, *kind, *lambda)?)
                }
                None => spec.clone(),
            };
            let asked = args.follow_up_every != 0 && index.is_multiple_of(args.follow_up_every);
            play(*stratum, &spec, if asked { args.follow_ups } else { 0 })
        })
        .collect::<anyhow::Result<_>>()
        .map_err(|e| Failure::Analysis(format!("{e:#}")))?;
    if let Some(folder) = &args.out {
        let text =
            serde_json::to_string_pretty(&scores).map_err(|e| Failure::Analysis(e.to_string()))?;
        files::make_folder(folder)?;
        files::write_text(folder, "scores.json", &text)?;
    }
    say!("{}", tally::tables(&scores));
    Ok(())
}
