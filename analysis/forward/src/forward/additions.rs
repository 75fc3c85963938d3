//! Additions that no linear branch stands for: branches with a law of their own, and states that
//! move resistances or add voltages.
//!
//! All cells are equal, so that one is integrated, at I/P, and the terminals follow: E = S·(U −
//! Σv + Σadditions), R = S/P·f·R₀ + interconnect, where f is the additions' factor; the current is
//! the root of [`super::law`] with these. A step is Strang's: additions half a step, branches and
//! charge, additions half a step, with currents that see the additions of the middle: second order,
//! and exact for branches under a prescribed current. The steps grow from a part of the shortest
//! time constant after every change of the demand; the whole run is repeated with halved steps
//! until no row moves by more than the tolerance.

mod run;

use super::law::Beyond;
use super::model::{ForwardError, SimModel, SimState};
use super::profile::Profile;
use super::simulate::{Method, SimOptions, Simulation};
use analysis_effects::{
    augmented::{Added, Augmented, network},
    contract::{Base, Dynamics, Network, Record},
};
use analysis_model::model::Erm;
use run::Run;

/// Two runs, one with half the steps of the other, must agree at every row within this, V per cell
/// and volt of overpotential above one.
const AGREE_V: f64 = 2e-6;
/// Halvings at most.
const MOST_HALVINGS: u32 = 8;

/// What a model has besides an ERM.
#[derive(Debug, PartialEq)]
pub(crate) struct Laws {
    cell: Augmented,
    /// One cell's network, with the branches of the ERM in its order.
    network: Network,
}

impl Laws {
    /// A cell's ERM with its linear additions, and what is left of the others.
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

    /// Names of the additions that need this, with commas.
    pub(super) fn names(&self) -> String {
        let added = self.cell.of_the_cell();
        let names: Vec<&str> = added
            .iter()
            .filter(|a| is_law(&self.cell.base, a))
            .map(|a| a.effect.card().name)
            .collect();
        names.join(", ")
    }

    fn dynamics(&self, soc: f64) -> Vec<Box<dyn Dynamics>> {
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
        temperature_c: f.temperature_c,
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

/// As [`super::simulate`], which has checked state and options.
pub(super) fn simulate(
    (model, laws): (&SimModel, &Laws),
    state: &SimState,
    profile: &Profile,
    options: &SimOptions,
) -> Result<Simulation, ForwardError> {
    if options.method == Method::Thesis {
        model.linear_only("explicit Euler")?;
    }
    let play = |halvings: u32| Run::play((model, laws), state, profile, (options, halvings));
    let series = f64::from(model.pack.series);
    let (mut coarse, mut met_v, mut tolerance_v) = (play(0)?, f64::NAN, AGREE_V);
    for halvings in 1..=MOST_HALVINGS {
        let fine = play(halvings)?;
        // A run that stops where power ends is as good as the instant at which it stops.
        let stopped =
            options.beyond == Beyond::Stop && !fine.summary.feasible && !coarse.summary.feasible;
        let rows = fine.trace.ccv_v.iter().zip(&coarse.trace.ccv_v);
        met_v = rows.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs())) / series;
        let moved = fine.trace.ccv_v.iter().zip(&fine.trace.ocv_v);
        tolerance_v = AGREE_V
            * moved.fold(1.0, |most: f64, (v, ocv)| {
                most.max((ocv - v).abs() / series)
            });
        if stopped || (met_v <= tolerance_v && fine.trace.ccv_v.len() == coarse.trace.ccv_v.len()) {
            return Ok(fine);
        }
        coarse = fine;
    }
    Err(ForwardError::Unresolved {
        names: laws.names(),
        tolerance_v,
        met_v,
    })
}
