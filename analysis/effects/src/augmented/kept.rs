//! A base model with the effects that it keeps, as a model file holds it and a simulation takes it.

use super::Added;
use crate::contract::{Base, Effect, Group};

/// A base and its additions.
#[derive(Debug, Clone, PartialEq)]
pub struct Augmented {
    /// The base model.
    pub base: Base,
    /// Its additions.
    pub kept: Vec<Kept>,
}

/// An effect of the catalogue with the values of its parameters.
#[derive(Clone)]
pub struct Kept {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Values in the order of [`Effect::parameters`].
    pub p: Vec<f64>,
}

impl std::fmt::Debug for Kept {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Kept")
            .field("effect", &self.effect.card().name)
            .field("p", &self.p)
            .finish()
    }
}

impl PartialEq for Kept {
    fn eq(&self, other: &Self) -> bool {
        self.effect.card().name == other.effect.card().name && self.p == other.p
    }
}

impl Augmented {
    /// Returns the additions that belong into a prediction: those of the cell.
    pub fn of_the_cell(&self) -> Vec<Added<'_>> {
        let cell = self
            .kept
            .iter()
            .filter(|k| k.effect.card().group == Group::Cell);
        cell.map(|k| Added {
            effect: k.effect,
            p: &k.p,
        })
        .collect()
    }

    /// Titles of the additions that explain a measurement and no prediction: those of the bench.
    pub fn left_out(&self) -> Vec<&'static str> {
        self.kept
            .iter()
            .map(|k| k.effect.card())
            .filter(|card| card.group == Group::Bench)
            .map(|card| card.title)
            .collect()
    }
}
