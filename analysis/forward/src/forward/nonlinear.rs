//! The additions of a model that no linear branch can represent.

use super::error::ForwardError;
use analysis_effects::{
    augmented::{Added, Augmented, network},
    contract::{Base, Dynamics, Network, Record},
};
use analysis_model::model::Erm;

/// Laws of a model beyond the ERM.
#[derive(Debug, PartialEq)]
pub(crate) struct Laws {
    pub(super) cell: Augmented,
    /// One cell's network, with the branches of the ERM in its order.
    pub(super) network: Network,
}

impl Laws {
    /// Creates a cell's ERM with its linear additions, and the laws of the other additions.
    ///
    /// # Errors
    /// [`ForwardError::Additions`] for an effect of the cell that changes readings and not the
    /// cell.
    pub(super) fn of(cell: &Augmented) -> Result<(Erm, Option<Self>), ForwardError> {
        let added = cell.of_the_cell();
        if let Some(a) = added.iter().find(|a| changes_readings(&cell.base, a)) {
            let expected = "effects that act within the cell";
            return Err(ForwardError::Additions {
                what: "simulation",
                expected,
                names: a.effect.card().name.to_owned(),
            });
        }
        let mut network = network(&cell.base, &added);
        network.branches.retain(|b| b.r_ohm != 0.0);
        let erm = network.linearised();
        let laws = added.iter().any(|a| is_law(&cell.base, a)).then(|| Self {
            cell: cell.clone(),
            network,
        });
        Ok((erm, laws))
    }

    /// Returns the names of the additions that need this, with commas.
    pub(super) fn names(&self) -> String {
        let added = self.cell.of_the_cell();
        let names: Vec<&str> = added
            .iter()
            .filter(|a| is_law(&self.cell.base, a))
            .map(|a| a.effect.card().name)
            .collect();
        names.join(", ")
    }

    pub(super) fn dynamics(&self, soc: f64) -> Vec<Box<dyn Dynamics>> {
        let (base, record) = (&self.cell.base, now(&self.cell.base, soc));
        self.cell
            .of_the_cell()
            .iter()
            .filter_map(|a| a.effect.dynamics(a.p, base, &record))
            .collect()
    }
}

/// The cell as it was at the end of the campaign that found the additions.
fn now(base: &Base, soc: f64) -> Record<'static> {
    let f = &base.facts;
    Record {
        time_s: &[],
        current_a: &[],
        soc,
        temperature_degc: f.temperature_degc,
        order: f.orders,
        start_s: f.span_s,
        is_cell: true,
        before: &[],
    }
}

fn is_law(base: &Base, added: &Added<'_>) -> bool {
    let moves = added
        .effect
        .dynamics(added.p, base, &now(base, base.facts.soc))
        .is_some();
    moves
        || network(base, std::slice::from_ref(added))
            .branches
            .iter()
            .any(|b| !b.is_linear())
}

fn changes_readings(base: &Base, added: &Added<'_>) -> bool {
    let (time_s, current_a, voltage_v) = ([0.0, 1.0, 3.0], [1.0, -2.0, 0.0], [3.6, 3.7, 3.65]);
    let record = Record {
        time_s: &time_s,
        current_a: &current_a,
        ..now(base, base.facts.soc)
    };
    let (mut i, mut v) = (current_a, voltage_v);
    added.effect.current(added.p, &record, &mut i);
    added.effect.voltage(added.p, &record, &mut v);
    i != current_a || v != voltage_v || added.effect.clock(added.p) != 1.0
}
