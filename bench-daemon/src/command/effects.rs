//! `eis-bench effects`: the catalogue of effects that a model may lack.

use analysis::effects::{Card, Group, catalogue};

use super::Failure;
use crate::terminal::say;

/// Arguments of `effects`.
#[derive(Debug, clap::Args)]
pub struct EffectsArgs {
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Prints the catalogue.
///
/// # Errors
/// None but a mistake of the program.
pub fn effects(args: &EffectsArgs) -> Result<(), Failure> {
    let cards: Vec<&Card> = catalogue().iter().map(|effect| effect.card()).collect();
    if args.json {
        let text = serde_json::to_string_pretty(&cards).map_err(|error| Failure::Analysis(error.to_string()))?;
        say!("{text}");
        return Ok(());
    }
    for (title, group) in [("In the cell", Group::Cell), ("On the bench", Group::Bench)] {
        say!("{title}:");
        cards.iter().filter(|card| card.group == group).for_each(|card| print(card));
    }
    Ok(())
}

fn print(card: &Card) {
    say!("  {}: {}", card.name, card.title);
    let confounders = if card.confounders.is_empty() { "none".to_owned() } else { card.confounders.join(", ") };
    for (what, text) in [
        ("mechanism", card.mechanism),
        ("in time", card.state_equation),
        ("impedance", card.impedance),
        ("signature", card.signature),
        ("looks like", confounders.as_str()),
        ("decided by", card.experiment),
        ("source", card.source),
    ] {
        say!("    {what:<11}{text}");
    }
}
