//! Arguments for reading a profile's file, shared by `simulate` and `pack simulate`.

use analysis::{
    formats::ReadOptions,
    forward::{Demand, Interpolation, Profile},
};
use clap::Args;

/// Properties of a profile that its file may not state.
#[derive(Debug, Clone, Copy, Args)]
pub struct ProfileArgs {
    /// Quantity of the second column, if no header states it [default: power].
    #[arg(long, value_enum)]
    pub kind: Option<Kind>,
    /// Interpolation between rows.
    #[arg(long, value_enum, default_value_t = Between::Hold)]
    pub interpolation: Between,
    /// The profile counts charge as positive.
    #[arg(long)]
    pub charge_positive: bool,
}

/// Kinds of profiles.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum Kind {
    /// W.
    Power,
    /// A.
    Current,
    /// Ω across the terminals.
    Resistance,
}

/// Course between rows.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum Between {
    /// The value of a row holds until the next row.
    Hold,
    /// The value is linear from row to row.
    Linear,
}

impl ProfileArgs {
    /// As the analysis wants it.
    pub(super) fn options(self) -> ReadOptions {
        let demand = self.kind.map(|kind| match kind {
            Kind::Power => Demand::Power,
            Kind::Current => Demand::Current,
            Kind::Resistance => Demand::Resistance,
        });
        let interpolation = match self.interpolation {
            Between::Hold => Interpolation::Hold,
            Between::Linear => Interpolation::Linear,
        };
        ReadOptions {
            demand,
            interpolation,
            charge_positive: self.charge_positive,
        }
    }
}

/// Describes the interpretation of a profile.
pub(super) fn taken(profile: &Profile) -> String {
    let kind = match profile.demand {
        Demand::Power => "power in W",
        Demand::Current => "current in A",
        Demand::Resistance => return format!("{}: load resistance in Ω", profile.name),
    };
    let sign = if profile.negated {
        "its file counts charge as positive"
    } else {
        "positive is discharge"
    };
    format!("{}: {kind}, {sign}", profile.name)
}
