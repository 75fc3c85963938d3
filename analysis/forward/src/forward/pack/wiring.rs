//! Wiring of a pack: cells in parallel share a voltage, groups in series share a current.
//!
//! At an instant every cell is a source Eₖ behind Rₖ. A group is then a source ΣGₖEₖ/ΣGₖ behind
//! 1/ΣGₖ with Gₖ = 1/Rₖ, the pack the sum of its groups and the interconnect, and the law of
//! [`crate::forward::Drive`] gives its current. The current of each cell follows as (Eₖ − V)/Rₖ.
//! With [`Links`] between the cells the same law holds for the voltages of their nodes.

use super::links::{Links, Recent};
use super::thermal::ThermalNetwork;
use crate::forward::{Beyond, Demand, Drive};

/// Wiring between the cells.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wiring<'a> {
    pub(super) parallel: usize,
    /// Between the cells; without them the cells of a group share their busbars.
    pub(super) links: Option<&'a Links>,
    /// Between a cell and the busbar of its group, Ω.
    pub(super) tab_ohm: f64,
    /// In series with all groups, Ω.
    pub(super) interconnect_ohm: f64,
}

/// The pack at an instant.
#[derive(Debug, Clone, Default)]
pub(super) struct Look {
    pub(super) current_a: f64,
    pub(super) ccv_v: f64,
    /// The requested power exceeded the available power.
    pub(super) infeasible: bool,
    pub(super) cell_a: Vec<f64>,
    /// At the cells' own terminals, before the tab.
    pub(super) cell_v: Vec<f64>,
    /// Joule heat in each cell, W.
    pub(super) heat_w: Vec<f64>,
    /// In each link, from its first node to its second, A.
    pub(super) link_a: Vec<f64>,
}

impl Look {
    /// Of a number of cells, without a current.
    pub(super) fn new(cells: usize, wiring: &Wiring<'_>) -> Self {
        Self {
            cell_a: vec![0.0; cells],
            cell_v: vec![0.0; cells],
            heat_w: vec![0.0; cells],
            link_a: vec![0.0; wiring.links.map_or(0, Links::count)],
            ..Self::default()
        }
    }
}

/// Sources of all cells, group by group.
#[derive(Debug, Clone)]
pub(super) struct Sources {
    pub(super) e_v: Vec<f64>,
    pub(super) behind_ohm: Vec<f64>,
    /// Solutions of the links for the last resistances.
    recent: Recent,
}

impl Sources {
    /// Of a number of cells.
    pub(super) fn new(cells: usize) -> Self {
        Self {
            e_v: vec![0.0; cells],
            behind_ohm: vec![0.0; cells],
            recent: Recent::default(),
        }
    }
}

impl Wiring<'_> {
    /// Computes the currents of all cells under a demand. Returns false if the pack has no voltage
    /// left.
    pub(super) fn share(
        &self,
        sources: &mut Sources,
        demand: Demand,
        value: f64,
        look: &mut Look,
    ) -> bool {
        if let Some(links) = self.links {
            let Sources {
                e_v: sources_v,
                behind_ohm,
                recent,
            } = sources;
            let Some(solved) = links.solve(recent, sources_v, behind_ohm) else {
                return false;
            };
            let (e_v, r_ohm) = solved.source();
            let r_ohm = r_ohm + self.interconnect_ohm;
            let sound = self.apply_demand(e_v, r_ohm, demand, value, look);
            if sound {
                let (cell_a, link_a) = (&mut look.cell_a, &mut look.link_a);
                links.write_currents(solved, sources_v, look.current_a, cell_a, link_a);
            }
            return sound;
        }
        let width = self.parallel;
        let groups = || {
            let e_v = sources.e_v.chunks(width);
            e_v.zip(sources.behind_ohm.chunks(width))
        };
        let whole = groups().map(|(e, r)| group(e, r));
        let (e_v, r_ohm) = whole.fold((0.0, self.interconnect_ohm), |(e, r), g| (e + g.0, r + g.1));
        if !self.apply_demand(e_v, r_ohm, demand, value, look) {
            return false;
        }
        let current = look.current_a;
        for ((e, r), i) in groups().zip(look.cell_a.chunks_mut(width)) {
            let (source, inner) = group(e, r);
            let v = source - current * inner;
            for ((i, e), r) in i.iter_mut().zip(e).zip(r) {
                *i = (e - v) / r;
            }
        }
        true
    }

    /// Writes current and voltage of the pack, from its voltage without current, V, and its resistance, Ω.
    /// Returns false if it has no voltage left.
    fn apply_demand(
        &self,
        e_v: f64,
        r_ohm: f64,
        demand: Demand,
        value: f64,
        look: &mut Look,
    ) -> bool {
        if e_v.is_nan() || e_v <= 0.0 {
            return false;
        }
        let reply = Drive {
            demand,
            beyond: Beyond::Clamp,
            r_ohm,
        }
        .reply(e_v, value);
        look.current_a = reply.current_a;
        look.ccv_v = e_v - reply.current_a * r_ohm;
        look.infeasible = reply.infeasible;
        true
    }

    /// Returns the heat of the interconnect and of all tabs, W.
    pub(super) fn wires_w(&self, look: &Look) -> f64 {
        let tabs = look.cell_a.iter().map(|i| self.tab_ohm * i * i);
        self.interconnect_w(look) + tabs.sum::<f64>()
    }

    fn interconnect_w(&self, look: &Look) -> f64 {
        let links = self.links.map_or(0.0, |links| links.heat_w(&look.link_a));
        look.current_a * look.current_a * self.interconnect_ohm + links
    }

    /// Writes the mean heat of each cell and its tab over a step, W, from its start and end. Returns
    /// the mean heat of the interconnect, W.
    pub(super) fn mean_heat_w(&self, ends: [&Look; 2], cell_w: &mut [f64]) -> f64 {
        let of = |look: &Look, k: usize| look.heat_w[k] + self.tab_ohm * look.cell_a[k].powi(2);
        for (k, mean) in cell_w.iter_mut().enumerate() {
            *mean = 0.5 * (of(ends[0], k) + of(ends[1], k));
        }
        0.5 * (self.interconnect_w(ends[0]) + self.interconnect_w(ends[1]))
    }
}

/// Sources in parallel as one: its voltage, V, and its resistance, Ω.
fn group(e_v: &[f64], r_ohm: &[f64]) -> (f64, f64) {
    let (weighted, conductance) = e_v
        .iter()
        .zip(r_ohm)
        .fold((0.0, 0.0), |(e, g), (&ek, &rk)| (e + ek / rk, g + 1.0 / rk));
    (weighted / conductance, 1.0 / conductance)
}

/// Cells in their wiring under a load.
pub(super) trait Cells {
    /// Computes all currents and voltages under a demand in the present state. Returns false if the
    /// pack has no voltage left.
    fn look(&mut self, demand: Demand, value: f64) -> bool;

    /// Advances the state by a step, from the demand of the last [`Cells::look`] to this one at its
    /// end, and evaluates the cells there. Returns false if the pack has no voltage left.
    fn advance(&mut self, step_s: f64, demand: Demand, value: f64) -> bool;

    /// Returns the result of the last evaluation.
    fn now(&self) -> &Look;

    /// Returns the states of charge.
    fn soc(&self) -> &[f64];

    /// Returns the temperatures.
    fn thermal(&self) -> &ThermalNetwork;

    /// Returns the largest distance outside the range of a map, with the cells; `None` without a map.
    fn left(&self) -> Option<Left>;

    /// Returns the number of steps whose equations were not solved to their tolerance.
    fn unsettled(&self) -> u64;
}

/// Largest distance outside the range of a map, and the cells that go there.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Left {
    pub(super) soc: f64,
    pub(super) soc_cell: usize,
    pub(super) temperature_k: f64,
    pub(super) temperature_cell: usize,
}
