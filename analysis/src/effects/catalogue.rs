//! The catalogue: one line per effect.

use super::Effect;
use super::{current_offset, rc_slow, self_heating, time_skew};

static CATALOGUE: &[&dyn Effect] = &[&rc_slow::RcSlow, &self_heating::SelfHeating, &time_skew::TimeSkew, &current_offset::CurrentOffset];

/// All effects, cells' first.
pub fn catalogue() -> &'static [&'static dyn Effect] {
    CATALOGUE
}

/// The effect of a name.
pub fn find(name: &str) -> Option<&'static dyn Effect> {
    CATALOGUE.iter().copied().find(|e| e.card().name == name)
}
