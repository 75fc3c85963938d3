//! Loads of the links of a pack over a run.

use super::{Link, Links};
use serde::Serialize;

/// Load of a link over a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LinkLoad {
    /// One node.
    pub from: String,
    /// The other node.
    pub to: String,
    /// Resistance, Ω.
    pub r_ohm: f64,
    /// Largest current, A, without sign.
    pub largest_a: f64,
    /// Heat, J.
    pub heat_j: f64,
    /// Its temperature rise if no heat leaves it, K; `None` without a heat capacity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rise_k: Option<f64>,
}

/// Loads of the links of a pack over a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LinkLoads {
    /// Of every link, in the order of the table.
    pub links: Vec<LinkLoad>,
    /// Largest current of the pack, A, without sign.
    pub largest_a: f64,
    /// Nodes of the hottest path at that instant: of all that follow the current from `pack-` to `pack+`, the
    /// one whose links have the most heat together.
    pub hottest_path: Vec<String>,
}

/// Record of the loads of the links.
#[derive(Debug, Clone)]
pub(in crate::forward::pack) struct LinkWatch<'a> {
    links: &'a Links,
    before_a: Vec<f64>,
    heat_j: Vec<f64>,
    link_a: Vec<f64>,
    most_a: f64,
    /// Currents of cells and links at the largest current of the pack, A.
    at_most: (Vec<f64>, Vec<f64>),
}

impl<'a> LinkWatch<'a> {
    pub(in crate::forward::pack) fn new(links: &'a Links) -> Self {
        let zeros = vec![0.0; links.count()];
        Self {
            links,
            before_a: zeros.clone(),
            heat_j: zeros.clone(),
            at_most: (vec![0.0; links.cells.len()], zeros.clone()),
            link_a: zeros,
            most_a: 0.0,
        }
    }

    /// Begins a step.
    pub(in crate::forward::pack) fn begin(&mut self, link_a: &[f64]) {
        self.before_a.copy_from_slice(link_a);
    }

    /// Adds up the heat of the step that ends.
    pub(in crate::forward::pack) fn passed(&mut self, step_s: f64, link_a: &[f64]) {
        let heats = self.heat_j.iter_mut().zip(&self.links.links);
        for ((heat_j, link), (before_a, now_a)) in heats.zip(self.before_a.iter().zip(link_a)) {
            *heat_j += 0.5 * step_s * link.r_ohm * (before_a * before_a + now_a * now_a);
        }
    }

    /// Takes an instant into the largest currents.
    pub(in crate::forward::pack) fn see(&mut self, pack_a: f64, cell_a: &[f64], link_a: &[f64]) {
        for (most, now) in self.link_a.iter_mut().zip(link_a) {
            *most = most.max(now.abs());
        }
        if pack_a.abs() > self.most_a {
            self.most_a = pack_a.abs();
            self.at_most.0.copy_from_slice(cell_a);
            self.at_most.1.copy_from_slice(link_a);
        }
    }

    /// Returns the loads.
    pub(in crate::forward::pack) fn close(self) -> LinkLoads {
        let of_links = self
            .links
            .links
            .iter()
            .zip(self.heat_j.iter().zip(&self.link_a));
        let load = |(link, (heat_j, largest_a)): (&Link, (&f64, &f64))| LinkLoad {
            from: link.from.clone(),
            to: link.to.clone(),
            r_ohm: link.r_ohm,
            largest_a: *largest_a,
            heat_j: *heat_j,
            rise_k: link.heat_j_per_k.map(|capacity| heat_j / capacity),
        };
        let path = self.links.hottest_path(&self.at_most.0, &self.at_most.1);
        LinkLoads {
            links: of_links.map(load).collect(),
            largest_a: self.most_a,
            hottest_path: path
                .into_iter()
                .map(|node| self.links.nodes[node].clone())
                .collect(),
        }
    }
}
